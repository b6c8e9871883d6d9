"""The command line: exit status, one line of blame, whole files or none."""

import json
import zipfile

import numpy as np
import pytest
from meshes import volumes
from scenes import plate, slit, three_tools

KEYS = ["vertices", "edges", "tetrahedra", "surfaceTriangles", "volume", "mass", "dynamicTetrahedra", "connectionNodes",
        "criticalStep", "substep", "memoryBytes", "warnings"]


def test_inspect_counts(inspect, build, command):
    """inspect --json has all its keys, and the counts, volume and mass are right, for the scene and for its FMU."""
    import geometry

    problem = plate("counted")
    problem.material(np.arange(30), 6000, 0.45, 2000)
    found = inspect(problem.scene)
    assert [k for k in KEYS if k not in found] == []
    edges = {tuple(sorted((t[a], t[b]))) for t in problem.tetrahedra for a in range(4) for b in range(a)}
    assert found["vertices"] == len(problem.nodes)
    assert found["edges"] == len(edges)
    assert found["tetrahedra"] == found["dynamicTetrahedra"] == len(problem.tetrahedra)
    assert found["surfaceTriangles"] == len(geometry.exposed(problem.tetrahedra))
    assert found["volume"] == pytest.approx(volumes(*problem.mesh).sum(), rel=1e-12)
    assert found["mass"] == pytest.approx(problem.tissue.mass().sum(), rel=1e-12)
    assert found["connectionNodes"] == 0 and found["memoryBytes"] > 1000
    assert all(isinstance(w, str) for w in found["warnings"])
    packed = command("inspect", build(problem.scene).path, "--json")
    assert packed.returncode == 0, packed.stderr
    again = json.loads(packed.stdout)
    assert {k: again[k] for k in KEYS} == {k: found[k] for k in KEYS}


def test_inspect_warns_of_loose_and_turned_tissue(inspect):
    """Nothing that holds the tissue, flipped tetrahedra and nodes without tetrahedra are warned of."""
    loose = plate("loose", clamp=False)
    assert inspect(loose.scene)["warnings"]
    turned = plate("turned", cells=(3, 2, 1))
    turned.scene["mesh"]["tetrahedra"][5] = turned.scene["mesh"]["tetrahedra"][5][::-1]
    turned.scene["mesh"]["tetrahedra"][7][:2] = turned.scene["mesh"]["tetrahedra"][7][1::-1]
    assert inspect(turned.scene)["warnings"]
    alone = plate("alone", cells=(3, 2, 1))
    alone.scene["mesh"]["nodes"].append([1.0, 1.0, 1.0])
    found = inspect(alone.scene)
    assert found["warnings"] and found["volume"] == pytest.approx(volumes(*alone.mesh).sum())


WRONG = {
    "unknown key": lambda s: s.update(gravty=[0, 0, 0]),
    "no material": lambda s: s.update(materials=[]),
    "bad ratio": lambda s: s["materials"][0].update(poissonRatio=0.5),
    "empty selection": lambda s: s.update(fixed=[{"sphere": {"center": [9, 9, 9], "radius": 0.1}}]),
    "node out of range": lambda s: s.update(fixed=[{"nodes": [100000]}]),
    "bad name": lambda s: s.update(name="no-good"),
    "flat tetrahedron": lambda s: s["mesh"]["tetrahedra"].append([0, 0, 1, 2]),
    "vertex out of range": lambda s: s["mesh"]["tetrahedra"].append([0, 1, 2, 100000]),
    "held twice": lambda s: s.update(prescribed=[{"where": {"nodes": [0]}, "displacement": [0, 0, 0.1]}]),
    "substep no divisor": lambda s: s.update(integration={"substep": 0.0007}),
    "zero quaternion": lambda s: s.update(tools=[{"name": "t", "kind": "probe", "shape": {"sphere": {"radius": 0.01}},
                                                  "position": [0, 0, 1], "orientation": [0, 0, 0, 0]}]),
    "not here yet": lambda s: s.update(mesh={"file": "liver.vtu"}),
}


def one_line(done, *mentions):
    assert done.returncode == 1, (done.returncode, done.stdout, done.stderr)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    for text in ("panicked", "backtrace", "RUST_"):
        assert text not in done.stderr
    for text in mentions:
        assert text in lines[0], lines[0]


@pytest.mark.parametrize("verb", ["build", "inspect", "reference"])
@pytest.mark.parametrize("wrong", WRONG, ids=lambda w: w.replace(" ", "_"))
def test_wrong_scenes(verb, wrong, command, tmp_path):
    """A wrong scene: exit 1, one line that names the file, and no file written."""
    scene = json.loads(json.dumps(plate("wrong", cells=(3, 2, 1)).scene))
    WRONG[wrong](scene)
    file, target = tmp_path / "wrong scene.json", tmp_path / "out"
    file.write_text(json.dumps(scene))
    more = ["--json"] if verb == "inspect" else ["-o", target]
    one_line(command(verb, file, *more), "wrong scene.json")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["wrong scene.json"]


@pytest.mark.parametrize("text", [b"", b"{", b"[1, 2]", b'{"name": "a",}', b"\xff\xfe", b'{"name": "a", "name": "b"}'], ids=repr)
def test_files_that_are_no_scene(text, command, tmp_path):
    """Broken JSON is told in one line with its place."""
    file = tmp_path / "broken.json"
    file.write_bytes(text)
    one_line(command("build", file, "-o", tmp_path / "x.fmu"), "broken.json")
    assert not (tmp_path / "x.fmu").exists()


def test_missing_files(command, tmp_path):
    """A scene, an FMU or a folder that is not there: exit 1, one line that names it."""
    one_line(command("build", tmp_path / "none.json"), "none.json")
    one_line(command("inspect", tmp_path / "none.fmu"), "none.fmu")
    file = tmp_path / "fine.json"
    file.write_text(json.dumps(plate("fine", cells=(2, 1, 1)).scene))
    one_line(command("build", file, "-o", file / "x.fmu"), "fine.json")
    (tmp_path / "bad.fmu").write_bytes(b"PK\x03\x04 not a zip")
    one_line(command("inspect", tmp_path / "bad.fmu"), "bad.fmu")


@pytest.mark.parametrize("line", [[], ["bild"], ["build"], ["build", "a.json", "--nonsense"], ["run", "a.json", "--stop"]], ids=str)
def test_wrong_command_lines(line, command):
    """A wrong command line: exit 2 and a word of help."""
    done = command(*line)
    assert done.returncode == 2
    assert done.stderr.strip() and "panicked" not in done.stderr


def test_an_existing_file_survives_failure(command, tmp_path):
    """A failed build leaves the old FMU as it was."""
    file, target = tmp_path / "scene.json", tmp_path / "old.fmu"
    target.write_bytes(b"old")
    file.write_text("{")
    assert command("build", file, "-o", target).returncode == 1
    assert target.read_bytes() == b"old"


def test_default_output_name(command, tmp_path):
    """Without -o, build writes next to where it is called, under a name that tells the scene."""
    (tmp_path / "liver.json").write_text(json.dumps(plate("named", cells=(2, 1, 1)).scene))
    assert command("build", "liver.json", cwd=tmp_path).returncode == 0
    made = [p for p in tmp_path.iterdir() if p.suffix == ".fmu"]
    assert len(made) == 1 and made[0].stem in ("liver", "named")
    assert zipfile.is_zipfile(made[0])


def test_tissue_that_nothing_holds_has_no_reference(command, written):
    """Statics without supports: exit 1 with a line that says what to do, not a huge displacement."""
    one_line(command("reference", written(plate("unheld", clamp=False).scene)), "held")
    severed = plate("severed_reference")
    severed.cut(slit(severed, share=1.0))
    one_line(command("reference", written(severed.scene), "--after-cuts"), "held")


def test_inverted_equilibrium_is_an_error(command, written):
    """An equilibrium with inverted tetrahedra is refused and says so."""
    problem = plate("inverted", gravity=[0.0, 0.0, -500.0])
    one_line(command("reference", written(problem.scene)), "invert")


def test_run_writes_its_results(command, written, tmp_path):
    """run steps a scene with a motion table and writes results.csv and what ParaView opens."""
    motion = tmp_path / "motion.csv"
    rows = ["time,tool[1].position.z"] + [f"{k / 100},{0.03 - 0.001 * k}" for k in range(6)]
    motion.write_text("\n".join(rows) + "\n")
    done = command("run", written(three_tools("runs").scene), "--motion", motion, "--stop", "0.05", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    lines = (tmp_path / "out/results.csv").read_text().splitlines()
    header = lines[0].replace('"', "").split(",")
    assert header[0] == "time" and len(lines) > 10
    assert any("tool[1].force" in name for name in header)
    assert any(p.suffix == ".pvd" for p in (tmp_path / "out").rglob("*"))
