"""`chart --quick`: interrupted and taken up again, its rows, and what it says nothing beats."""

import csv
import re
import subprocess
import time
from xml.etree import ElementTree

import pytest

SETTINGS = {
    "neo-Hookean, averaged", "neo-Hookean", "neo-Hookean, nodal pressure", "St Venant-Kirchhoff, averaged",
    "St Venant-Kirchhoff", "adaptive, 1/10", "linear", "linear, averaged", "springs", "pre-computed",
    "pre-computed, averaged", "hybrid 25 %", "hybrid 25 %, neo-Hookean",
}
MEASURES = {
    "error of the force": ("forceError_percent", "referenceForceError_percent"),
    "error of the surface, L2": ("surfaceL2_mm", "referenceSurfaceL2_mm"),
}


def rows_of(folder):
    with open(folder / "chart.csv", newline="") as file:
        return list(csv.DictReader(file))


def counts(done):
    assert done.returncode == 0, done.stderr
    found = re.search(r"(\d+) rows measured in \d+ s, (\d+) known, (\d+) without a result", done.stdout)
    return [int(n) for n in found.groups()]


@pytest.fixture(scope="module")
def chart(command, tmp_path_factory):
    """Killed when some rows are there, then run to its end: the folder, the rows before, the counts of the second run."""
    folder = tmp_path_factory.mktemp("a chart")
    line = [command.binary, "chart", "--quick", "-o", folder]
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    give_up = time.monotonic() + 300
    while not (folder / "chart.csv").exists() or len(rows_of(folder)) < 5:
        assert process.poll() is None and time.monotonic() < give_up
        time.sleep(0.05)
    process.kill()
    process.wait()
    before = rows_of(folder)
    return folder, before, counts(command("chart", "--quick", "-o", folder, timeout=600))


def test_an_interrupted_study_is_taken_up(chart, command):
    """What was measured stays as it is; nothing is measured twice, and nothing at all when all is known."""
    folder, before, (measured, known, _) = chart
    rows = rows_of(folder)
    assert known == len(before) and measured == len(rows) - len(before)
    assert rows[: len(before)] == before
    assert len({row["key"] for row in rows}) == len(rows)
    kept = (folder / "chart.csv").read_bytes()
    assert counts(command("chart", "--quick", "-o", folder)) == [0, len(rows), 0]
    assert (folder / "chart.csv").read_bytes() == kept


def test_a_damaged_row_is_measured_again(chart, command, tmp_path):
    """A file that ends in the middle of a row, and has a row of another version: only these are made anew."""
    lines = (chart[0] / "chart.csv").read_text().splitlines()
    other = lines[1].replace(lines[1].split(",")[0], "0.0.0", 1)
    lines[1] = other
    damaged = "\n".join([*lines[:-1], lines[-1][:60]])
    folder = tmp_path / "damaged"
    folder.mkdir()
    (folder / "chart.csv").write_text(damaged)
    assert counts(command("chart", "--quick", "-o", folder, timeout=300)) == [2, len(lines) - 3, 0]
    assert {r["key"] for r in rows_of(folder)} == {r["key"] for r in rows_of(chart[0])}


def test_rows(chart):
    """Each setting on two bodies and two sizes, all done; numbers where there must be, and such as can be."""
    rows = rows_of(chart[0])
    found = {(r["scene"], r["size_mm"], r["setting"]) for r in rows}
    sizes = {(scene, size) for scene in ("plate", "block") for size in ("10", "5")}
    assert found == {(*where, setting) for where in sizes for setting in SETTINGS}
    for row in rows:
        assert row["outcome"] == "done" and int(row["steps"]) >= 300 and int(row["patchNodes"]) >= 9
        number = {k: float(v) for k, v in row.items() if k.rsplit("_", 1)[-1] in ("us", "mm", "percent", "N") and v}
        assert 0 < number["stepMedian_us"] <= number["step99_us"] <= number["stepWorst_us"]
        assert number["calibration_us"] > 0 and float(row["work_kflop"]) > 0
        assert number["settling_percent"] < 1 and number["energyDrift_percent"] < 5
        # Errors of the model and of the mesh make up the whole one, at most.
        for whole, model, mesh in [
            ("forceError_percent", "modellingForceError_percent", "discretisationForceError_percent"),
            ("surfaceL2_mm", "modellingSurfaceL2_mm", "discretisationSurfaceL2_mm"),
        ]:
            parts = number[model], number[mesh]
            assert abs(parts[0] - parts[1]) * 0.9999 <= number[whole] <= sum(parts) * 1.0001
        assert number["surfaceL2_mm"] <= number["surfaceLargest_mm"]
        assert number["surfaceL2_mm"] <= number["pathSurfaceL2_mm"] * 1.0001


def test_settings_differ(chart):
    """Springs are no linear tissue; of pre-computed and dynamic linear tissue only the way differs, not its end."""
    by = {(r["scene"], r["size_mm"], r["setting"]): r for r in rows_of(chart[0])}
    for scene in ("plate", "block"):
        for size in ("10", "5"):
            force = {s: float(by[scene, size, s]["forceZ_N"]) for s in SETTINGS}
            assert abs(force["springs"] / force["linear"] - 1) > 0.05
            assert force["pre-computed"] == pytest.approx(force["linear"], rel=1e-3)
            assert force["hybrid 25 %"] == pytest.approx(force["linear"], rel=1e-3)
            way = [float(by[scene, size, s]["pathForceError_percent"]) for s in ("pre-computed", "linear")]
            assert abs(way[0] - way[1]) > 0.1


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize("scene", ["plate", "block"])
def test_the_front_is_what_nothing_beats(scene, measure, chart):
    """front.md has the rows that no other one beats, by two digits of the error, and only these; those below the reference's own are equal."""
    folder = chart[0]
    text = (folder / "front.md").read_text()
    part = text.split(f"### {scene}: {measure}\n")[1].split("###")[0]
    shown = [tuple(cell.strip() for cell in line.split("|")[1:4]) for line in part.splitlines() if line.startswith("| moderate")]
    error, floor = MEASURES[measure]
    points = {}
    for row in rows_of(folder):
        if row["scene"] == scene:
            name = ("moderate", row["setting"], f"{float(row['size_mm']):.3g} mm")
            told_apart = float(f"{max(float(row[error]), float(row[floor])):.1e}")
            points[name] = (float(row["stepMedian_us"]), told_apart)

    def beaten(p):
        return any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points.values())

    best = sorted((p, name) for name, p in points.items() if not beaten(p))
    assert shown == [name for _, name in best] and len(shown) >= 2
    picture = (folder / f"chart_{scene}.svg").read_text()
    ElementTree.fromstring(picture)
    assert picture.count('font-weight="600"') == 3 and "NaN" not in picture
    assert all(f">{n}</text>" in picture for n in range(1, len(shown) + 1))


def test_a_folder_that_cannot_be(command, tmp_path):
    """-o below a file, or where chart.csv is a folder: exit 1, one line that names it."""
    (tmp_path / "file").write_text("")
    (tmp_path / "out" / "chart.csv").mkdir(parents=True)
    for folder, name in [(tmp_path / "file" / "x", "file"), (tmp_path / "out", "chart.csv")]:
        done = command("chart", "--quick", "-o", folder)
        assert done.returncode == 1 and name in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1 and "panicked" not in done.stderr
