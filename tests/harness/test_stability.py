"""`chart --maps --quick`: what the maps say, and that what they outline holds. `chart --random`: so do scenes at random."""

import csv
from pathlib import Path
from xml.etree import ElementTree

import pytest

MAPS = (
    "substep", "compression", "poisson", "speed", "threshold", "tearing",
    "quality", "interface", "delay", "contact", "fragments",
)
OUTCOMES = {"stable", "halved", "discarded", "refused", "failed"}
DOCS = Path(__file__).resolve().parents[2] / "docs"


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def maps(command, tmp_path_factory):
    folder = tmp_path_factory.mktemp("some maps")
    done = command("chart", "--maps", "--quick", "-o", folder)
    assert done.returncode == 0, done.stderr
    assert str(folder / "stability.csv") in done.stdout
    return folder, read(folder / "stability.csv")


def of(rows, name, **where):
    return [r for r in rows if r["map"] == name and all(r[k] == v for k, v in where.items())]


def check(rows):
    """Every map is there; what is outlined holds; what is wrong says how it shows."""
    assert {r["map"] for r in rows} == set(MAPS)
    for row in rows:
        assert row["outcome"] in OUTCOMES and row["safe"] in ("true", "false")
        if row["value"]:
            assert abs(float(row["value"])) < 1e4
        if row["safe"] == "true":
            assert row["outcome"] == "stable" or (row["map"] in ("compression", "speed", "contact", "fragments") and row["outcome"] == "halved"), row
        if row["outcome"] != "stable":
            assert row["symptom"]
    assert {r["map"] for r in rows if r["safe"] == "true"} == set(MAPS)


def test_quick_maps(maps):
    check(maps[1])


def test_committed_maps():
    """Those behind docs/stability.md: the same rules on the whole grids, and a picture each."""
    rows = read(DOCS / "stability.csv")
    check(rows)
    assert len(rows) > 1000
    # The critical substep is no shorter than it need be: past it no scheme alone holds.
    past = [r for r in of(rows, "substep", safe="false") if r["panel"].endswith("alone")]
    assert len(past) > 200 and {r["outcome"] for r in past} == {"failed", "refused"}
    for name in MAPS:
        ElementTree.parse(DOCS / f"stability_{name}.svg")
        assert f"(stability_{name}.svg)" in (DOCS / "stability.md").read_text()


def test_pictures(maps):
    folder, rows = maps
    for name in MAPS:
        picture = (folder / f"stability_{name}.svg").read_text()
        ElementTree.fromstring(picture)
        assert "NaN" not in picture and "<path" in picture
        assert picture.count('height="26"') == len(of(rows, name))


def test_a_quick_point_is_the_committed_one(maps):
    """The maps are of runs that repeat: a coarse grid finds what the fine one found."""
    known = {(r["map"], r["panel"], r["x"], r["y"]): r for r in read(DOCS / "stability.csv")}
    for row in maps[1]:
        committed = known[row["map"], row["panel"], row["x"], row["y"]]
        assert row["outcome"] == committed["outcome"], row


def test_past_the_critical_substep(maps):
    """A scheme alone runs away; stepped, its substep is halved and it ends where it ought to."""
    for scheme in ("symplecticEuler", "centralDifference", "rungeKutta4"):
        alone = of(maps[1], "substep", panel=f"{scheme}, alone", x="8", y="0")
        stepped = of(maps[1], "substep", panel=f"{scheme}, stepped", x="8", y="0")
        assert [r["outcome"] for r in alone + stepped] == ["failed", "halved"]
        # A sudden load swings tissue to twice its static displacement, and no further.
        assert 1.5 < float(stepped[0]["value"]) < 2.2


def test_remedies(maps):
    """The other law, element, rule and budget hold where the first ones do not."""
    rows = maps[1]
    half = {r["y"]: r["outcome"] for r in of(rows, "compression", x="0.5")}
    assert half["stVenantKirchhoff, constantStrain"] == "discarded"
    assert half["stableNeoHookean, constantStrain"] == "stable" and half["stableNeoHookean, nodalAveraged"] == "halved"
    locked = {r["y"]: abs(float(r["value"])) for r in of(rows, "poisson", panel="force", x="0.4999")}
    assert locked["constantStrain"] > 500 and locked["nodalAveraged"] < 6
    assert {r["outcome"] for r in of(rows, "threshold", panel="perVertex")} == {"discarded"}
    assert all(float(r["value"]) < 1 for r in of(rows, "threshold", panel="blend"))
    chosen = of(rows, "quality", panel="substep chosen")
    given = of(rows, "quality", panel="substep of the regular mesh", x="2", y="64")
    assert {r["outcome"] for r in chosen} == {"stable"} and given[0]["outcome"] == "discarded"
    late = {r["x"]: r["outcome"] for r in of(rows, "delay")}
    assert late == {"0": "stable", "1": "failed", "8": "failed"}
    few, many = (of(rows, "interface", panel="lumped", x=x)[0] for x in ("0", "24"))
    assert few["outcome"] == "failed" and abs(float(many["value"])) < 1
    assert all(float(r["value"]) < 0.1 for r in of(rows, "fragments"))
    loss = {r["x"]: float(r["value"]) for r in of(rows, "tearing", y="0.1")}
    assert loss["4"] < 30 and loss["any"] > 50


def test_random_scenes(command, tmp_path):
    """The first 150 of the documentation's 10 000 scenes: none diverges, none ends inside out."""
    done = command("chart", "--random", "150", "--seed", "11", "-o", tmp_path)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    rows = read(tmp_path / "random.csv")
    assert len(rows) == 150 and {r["outcome"] for r in rows} <= {"stable", "halved"}
    assert min(float(r["last"]) for r in rows) > 0
    assert len({(r["law"], r["element"], r["kind"]) for r in rows}) > 15


def test_a_random_scene_is_the_same_alone(command, tmp_path):
    """A scene follows from the seed and its number, whatever runs beside it."""
    for count, first, threads in ((6, 0, 2), (1, 4, 1)):
        folder = tmp_path / str(count)
        done = command("chart", "--random", count, "--first", first, "--threads", threads, "--seed", "11", "-o", folder)
        assert done.returncode == 0, done.stdout + done.stderr
    both = [{k: v for k, v in r.items() if k != "seconds"} for n in (6, 1) for r in read(tmp_path / str(n) / "random.csv")]
    assert both[6] == both[4]
