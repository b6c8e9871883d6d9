"""Force error of the product's elements on the six studies at about 7 000 tetrahedra (slow; by hand).

    TISSUE_FMU=/path/to/tissue-fmu python tests/harness/elements.py [--element NAME] [study ...]

Writes elements.csv beside this file: each element's contact force or torque against the converged
quadratic one in quadratic.csv, in per cent, on two mesh patterns. Twist and shear were used to choose
nothing. With one element or some studies it only prints their rows.
"""

import csv
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import meshes
import numpy as np
from studies import STUDIES

HERE = Path(__file__).parent
ELEMENTS = {
    "constantStrain": {"element": "constantStrain"},
    "nodalPressure": {"element": "nodalPressure"},
    "nodalAveraged": {"element": "nodalAveraged"},
    "nodalAveraged c=0.25": {"element": "nodalAveraged", "hourglass": 0.25},
}
PATTERNS = {"five": meshes.five, "six": meshes.six}
LAWS = ["stableNeoHookean", "stVenantKirchhoff"]
COLUMNS = ["scene", "nu", "law", "pattern", "element", "tetrahedra", "error %", "reference +- %"]


def converged():
    """(scene, nu, law) -> force or torque, and the error it has left."""
    with open(HERE / "quadratic.csv") as file:
        rows = [row for row in csv.DictReader(file) if row["quantity"] != "energy"]
    left = "estimated remaining error"
    return {
        (row["scene"], float(row["nu"]), row["law"]): (float(row["value"]), float(row[left]))
        for row in rows
    }


def reference(scene):
    """What the reference command says of a scene; None where it finds no equilibrium."""
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder, "scene.json"), Path(folder, "out.json")
        path.write_text(json.dumps(scene))
        command = [os.environ["TISSUE_FMU"], "reference", path, "-o", out]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            print(done.stderr.strip(), file=sys.stderr)
            return None
        return json.loads(out.read_text())


def error(study, law, poisson, pattern, element, truth):
    problem = study.problem(1, law, poisson, PATTERNS[pattern], **ELEMENTS[element])
    found = reference(problem.scene)
    count = len(problem.tetrahedra)
    if found is None:
        return count, None
    reaction = np.zeros(problem.nodes.shape)
    for node, value in found["reaction"].items():
        reaction[int(node)] = value
    force = study.measured(problem.nodes, np.array(found["displacement"]), reaction)
    return count, 100 * (force / truth - 1)


def main(names):
    elements = list(ELEMENTS)
    if names[:1] == ["--element"]:
        elements, names = [names[1]], names[2:]
    truths = converged()
    rows = []
    for make in STUDIES:
        study = make()
        if names and study.name not in names:
            continue
        for law in LAWS:
            for poisson in [0.45, 0.499]:
                if (study.name, poisson, law) not in truths:
                    continue
                truth, left = truths[study.name, poisson, law]
                for pattern in PATTERNS:
                    for element in elements:
                        count, off = error(study, law, poisson, pattern, element, truth)
                        shown = "none" if off is None else f"{off:.1f}"
                        row = [study.name, poisson, law, pattern, element, count, shown]
                        rows.append([*row, f"{100 * left:.1f}"])
                        print(*rows[-1], sep=",", flush=True)
    if not names and elements == list(ELEMENTS):
        with open(HERE / "elements.csv", "w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


if __name__ == "__main__":
    main(sys.argv[1:])
