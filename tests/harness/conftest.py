"""The command under test comes from TISSUE_FMU, else target/release; FMUs are built once a session."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from fmu import Fmu  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def command():
    """Runs tissue-fmu with arguments; returns the finished process."""
    binary = Path(os.environ.get("TISSUE_FMU", ROOT / "target/release/tissue-fmu"))
    assert binary.exists(), f"{binary} is not built"

    def run(*arguments, timeout=120, **options):
        line = [str(binary), *(str(a) for a in arguments)]
        return subprocess.run(line, capture_output=True, text=True, timeout=timeout, **options)

    run.binary = str(binary)
    return run


@pytest.fixture(scope="session")
def written(tmp_path_factory):
    """A scene's file."""
    folder = tmp_path_factory.mktemp("scenes")
    known = {}

    def write(scene):
        text = json.dumps(scene)
        if text not in known:
            known[text] = folder / f"{scene['name']}_{len(known)}.json"
            known[text].write_text(text)
        return known[text]

    return write


@pytest.fixture(scope="session")
def build(command, written):
    """A scene's FMU, unpacked."""
    known = {}

    def make(scene):
        source = written(scene)
        if source not in known:
            target = source.with_suffix(".fmu")
            done = command("build", source, "-o", target)
            assert done.returncode == 0, done.stderr
            known[source] = Fmu(target, folder=source.with_suffix(""))
        return known[source]

    return make


@pytest.fixture(scope="session")
def reference(command, written):
    """What the `reference` command says of a scene."""

    def solve(scene, *flags):
        source = written(scene)
        target = source.with_suffix(".reference.json")
        done = command("reference", source, *flags, "-o", target)
        assert done.returncode == 0, done.stderr
        return json.loads(target.read_text())

    return solve


@pytest.fixture(scope="session")
def inspect(command, written):
    """What `inspect --json` says of a scene."""

    def look(scene):
        done = command("inspect", written(scene), "--json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return look
