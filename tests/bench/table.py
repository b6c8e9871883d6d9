"""All benchmarks into one table: docs/bench.csv, to which README.md's "Speed" points.

`python3 tests/bench/table.py [OUT.csv]`: a quarter of an hour on an idle machine, some GB for the large organs; without OUT to
standard output. What runs more than once counts by the median of its runs. `target/venv/bin/python` also measures how long an FMU takes to
be ready.
"""

import csv
import statistics
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# Benchmark, its argument, runs.
RUNS = [
    ("force", None, 5),
    ("step", "--contact", 9),
    ("step", None, 3),
    ("cut", None, 3),
    ("step", "--large", 1),
]


def output(bench, argument):
    line = ["cargo", "bench", "--quiet", "-p", "tissue", "--bench", bench]
    done = subprocess.run(line + (["--", argument] if argument else []), cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(line)} failed:\n{done.stderr[-2000:]}")
    return done.stdout


def rows(text):
    """(what, median, best, unit) of what a benchmark prints."""
    header, *lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    # Names have commas, and nothing round them.
    for line in lines:
        if header.startswith("what"):
            yield tuple(line.rsplit(",", 3))
        else:
            what, middle = line.rsplit(",", 1)
            yield what.replace(",", ": ", 1), middle, "", "us"


def median(values):
    numbers = [float(v) for v in values if v]
    return f"{statistics.median(numbers):.6g}" if numbers else ""


def main():
    out = open(sys.argv[1], "w", newline="") if sys.argv[1:] else sys.stdout
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["benchmark", "what", "median", "best", "unit"])
    for bench, argument, runs in RUNS:
        found = defaultdict(list)
        for run in range(runs):
            print(f"{bench} {argument or ''}: {run + 1} of {runs}", file=sys.stderr)
            for what, middle, best, unit in rows(output(bench, argument)):
                found[what, unit].append((middle, best))
        name = f"{bench} {argument}" if argument else bench
        for (what, unit), values in found.items():
            writer.writerow([name, what, median(v for v, _ in values), median(v for _, v in values), unit])
        out.flush()
    try:
        line = [sys.executable, ROOT / "tests/bench/instantiate.py"]
        text = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for row in list(csv.reader(io.StringIO(text)))[1:]:
            writer.writerow(["instantiate", f"{row[0]}: ready", row[2], row[3], "s"])
    except subprocess.CalledProcessError:
        print("how long an FMU takes to be ready: only with target/venv/bin/python, after ./check", file=sys.stderr)


if __name__ == "__main__":
    main()
