"""The shipped scenes."""

import numpy as np
import pytest
from conftest import ROOT
from fmu import SIGNS, Fmu, Instance

EXAMPLES = sorted(
    path for path in (ROOT / "examples").glob("*.json") if not path.name.endswith("schema.json")
)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_a_shipped_scene_runs(path, command, tmp_path):
    """Each example builds without a warning and steps 0.1 s with its account closed."""
    done = command("build", path, "-o", tmp_path / "example.fmu")
    assert done.returncode == 0 and done.stderr == "", done.stderr
    with Instance(Fmu(tmp_path / "example.fmu", tmp_path / "open")) as instance:
        start = (instance.energies() * SIGNS).sum()
        for _ in range(100):
            instance.step(0.001)
        terms = instance.energies()
        assert np.isfinite(terms).all()
        assert abs((terms * SIGNS).sum() - start) < 0.01 * np.abs(terms).max() + 1e-12


def test_there_are_examples():
    """Nobody moved them away unnoticed."""
    assert EXAMPLES
