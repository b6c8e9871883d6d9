"""Figures of README.md and docs/chart.md are those of committed tables; `chart --rate` makes one of them."""

import csv
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
# Tables of medians in microseconds unless a row has a unit, and the column of a row's name.
TABLES = {"bench.csv": "what", "rate.csv": "what", "chart.csv": "key"}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def values(table, name):
    """What a row says: numbers in seconds where they are times, else as they are."""
    found = [r for r in read(DOCS / table) if r[TABLES[table]] == name]
    assert found, f"no row {name!r} in {table}"
    numbers = []
    for row in found:
        for key, text in row.items():
            try:
                value = float(text)
            except (TypeError, ValueError):
                continue
            unit = row["unit"] if key in ("median", "best") else key.rsplit("_", 1)[-1]
            numbers.append(value * SECONDS.get(unit, 1.0))
    return numbers


def rows_of_speed():
    """Lines of README.md's "Speed": what, the figures, and the rows that they come from."""
    part = (ROOT / "README.md").read_text().split("\n## Speed\n")[1].split("\n## ")[0]
    for line in part.splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|"))]
        if line.startswith("| ") and cells[0] != "what":
            yield cells


def agree(text, unit, number):
    """To the digits that are written."""
    written = text.replace(" ", "")
    if unit in SECONDS:
        number /= SECONDS[unit]
    digits = len(written.split(".")[1]) if "." in written else 0
    return abs(float(written) - number) <= 0.5001 * 10**-digits


@pytest.mark.parametrize("cells", list(rows_of_speed()), ids=lambda cells: cells[0][:40])
def test_each_figure_of_the_readme_is_a_row(cells):
    what, figures, rows = cells
    known = []
    for table, names in re.findall(r"([a-z]+\.csv)\)?: ((?:`[^`]+`(?:, )?)+)", rows):
        for name in re.findall(r"`([^`]+)`", names):
            known += values(table, name)
    assert known, what
    found = re.findall(r"(\d[\d ]*(?:\.\d+)?)\s*(us|ms|s|times|tetrahedra|GB)\b", figures)
    assert found, figures
    for text, unit in found:
        assert any(agree(text, unit, number) for number in known), f"{what}: {text} {unit} is in none of {rows}"


def test_rate(command, tmp_path):
    done = command("chart", "--rate", "--quick", "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    rows = read(tmp_path / "rate.csv")
    committed = read(DOCS / "rate.csv")
    assert list(rows[0]) == list(committed[0]) and {r["what"] for r in rows} == {r["what"] for r in committed}
    for row in rows:
        assert row["tetrahedra"] == "6714"
        assert 0 < float(row["median_us"]) <= float(row["p99_us"]) <= float(row["p999_us"]) <= float(row["longest_us"])
        if row["verdict"] != "at rest":
            assert int(row["removed"]) > 0 and float(row["substeps"]) >= 1 and int(row["steps"]) == 5000


def test_the_largest_meshes_are_those_of_the_table():
    """docs/chart.md has the largest mesh of each model that held, and nothing larger held."""
    rows = [r for r in read(DOCS / "rate.csv") if r["verdict"] != "at rest"]
    part = (DOCS / "chart.md").read_text().split("## How large at 1 kHz?")[1].split("\n## ")[0]
    for name in {r["what"] for r in rows}:
        held = [r for r in rows if r["what"] == name and r["verdict"] == "holds"]
        best = max(held, key=lambda r: int(r["tetrahedra"]))
        line = next(line for line in part.splitlines() if line.startswith(f"| {name} |"))
        assert f"{int(best['tetrahedra']):,}".replace(",", " ") in line
        assert float(best["p999_us"]) < 1000 and int(best["removed"]) > 100
