"""A frictionless ball pressed 6 mm into a block: the converged force, and errors on the product's mesh (slow; by hand).

    OMP_NUM_THREADS=1 python tests/harness/pressed.py [--contact]

The block is the 6 cm cube of the studies, nu = 0.45, linear, held at its bottom; the ball comes down on the middle of
its top. Writes pressed.csv: the force by quadratic tetrahedra and bricks on a quarter of it, on graded meshes of
`level` times as many cells a side. With --contact writes pressed_contact.csv instead: the force on the product's mesh
(cells into five) by its elements' stiffness, sought here with contact at vertices, at seven points a triangle and, of
the smaller ball, wherever a triangle is nearest; so each element's error stands apart from that of the contact.
"""

import csv
import sys
from pathlib import Path

import contact
import meshes
import numpy as np
from bricks import bricks
from geometry import exposed
from indenter import SEVEN, SEVEN_WEIGHT, Condensed, Quadratic, on_bricks, on_triangles
from laws import lame
from nonlinear import Body, Material, quadratic
from scenes import Problem

TABLE = Path(__file__).with_suffix(".csv")
CONTACT = TABLE.with_stem("pressed_contact")
COLUMNS = ["radius mm", "element", "level", "degrees of freedom", "force N"]
CONTACT_COLUMNS = ["radius mm", "element", "contact", "force N"]

YOUNG, POISSON, SIZE, DEPTH = 6000.0, 0.45, 0.06, 0.006
CELLS = (12, 12, 10)
PATTERNS = {"five": meshes.five, "kuhn": meshes.six}
RADII = [0.02, 0.06]
LEVELS = [1, 2, 3, 4]
# Planes of the coarsest cells from the middle outward and from the top downward; contact ends within the third.
PLANES = {
    0.02: ([0, 0.0055, 0.0115, 0.019, 0.03], [0, 0.006, 0.015, 0.031, 0.06]),
    0.06: ([0, 0.0095, 0.019, 0.0245, 0.03], [0, 0.008, 0.019, 0.036, 0.06]),
}
PENALTY = (1e9, 1e10)
STAGES = 6


def divided(planes, level):
    return np.interp(np.arange(level * (len(planes) - 1) + 1) / level, np.arange(len(planes)), planes)


def way(radius, middle):
    return [np.array([*middle, SIZE + radius - DEPTH * k / STAGES]) for k in range(1, STAGES + 1)]


def converged(radius, element, level):
    """Degrees of freedom and force [N] of the whole block."""
    across, down = (divided(planes, level) for planes in PLANES[radius])
    lines, near = [across, across, SIZE - down[::-1]], PLANES[radius][0][2] - 1e-9
    material = Material("linear", *lame(YOUNG, POISSON))
    if element == "bricks":
        nodes, cells = bricks(lines)
        body = Quadratic(nodes, cells, material)
        places = on_bricks(nodes, cells[np.hypot(*nodes[cells[:, 0], :2].T) < near])
    else:
        count = [len(line) - 1 for line in lines]
        nodes, cells = quadratic(*meshes.oriented(*meshes.on_lines(meshes.six(count, count), lines)))
        body = Body(nodes, cells, material)
        # Faces opposite to a corner, with the numbers of their nodes in the middles of edges.
        corners = ([1, 2, 3, 5, 9, 8], [0, 2, 3, 6, 9, 7], [0, 1, 3, 4, 8, 7], [0, 1, 2, 4, 5, 6])
        faces = np.concatenate([cells[:, f] for f in corners])
        faces = faces[np.abs(nodes[faces][:, :, 2] - SIZE).max(axis=1) < 1e-12]
        places = on_triangles(nodes, faces[np.hypot(*nodes[faces].min(axis=1)[:, :2].T) < near])
    held = np.abs(nodes) < 1e-12
    held[held[:, 2]] = True
    stiffness = body.stiffness(np.zeros(nodes.shape))
    force, _ = Condensed(nodes, stiffness, held, places).press(way(radius, (0, 0)), radius, PENALTY)
    return nodes.size, 4 * force[2]


def problem(radius, pattern, element):
    """The product's scene, the ball just above the block."""
    mesh = PATTERNS[pattern]((SIZE, SIZE, SIZE), CELLS)
    problem = Problem("pressed", mesh, gravity=[0.0, 0.0, 0.0])
    problem.fix(problem.face(2, 0.0))
    problem.tissue.element = element
    problem.set(model={"element": element}, integration={"scheme": "symplecticEuler"})
    problem.tool("ball", "probe", (SIZE / 2, SIZE / 2, SIZE + radius + 1e-4), radius=radius)
    problem.scene["tools"][0]["friction"] = 0.0
    return problem


def on_its_mesh(radius, pattern, element):
    """(contact, force [N]) on the product's mesh; `nearest`: each triangle's own nearest place, by contact.py."""
    own = problem(radius, pattern, element)
    faces = exposed(own.tetrahedra)
    corners = own.nodes[faces]
    near = np.hypot(*(corners[:, :, :2] - SIZE / 2).transpose(2, 0, 1)).min(axis=1) < 1.05 * PLANES[radius][0][2]
    faces = faces[near & (np.abs(corners[:, :, 2] - SIZE).max(axis=1) < 1e-12)]
    stages, stiffness = way(radius, (SIZE / 2, SIZE / 2)), own.tissue.stiffness().tocsr()
    for name, rule in (("vertices", (np.eye(3), np.full(3, 1 / 3))), ("seven points", (SEVEN, SEVEN_WEIGHT))):
        body = Condensed(own.nodes, stiffness, own.held, on_triangles(own.nodes, faces, *rule))
        yield name, body.press(stages, radius, PENALTY)[0][2]
    if radius > RADII[0]:
        # So many places touch then that the active sets take far too long.
        return
    start = stages[0] + [0, 0, DEPTH / STAGES]
    yield "nearest", contact.pressed(own.tissue, own.held, own.force, start, stages[-1], radius)[1][2]


def values():
    """Radius [m] to the converged force [N] by bricks, and what it may be off: the last change or the other element's."""
    with TABLE.open() as file:
        rows = list(csv.DictReader(file))
    known = {(float(r["radius mm"]) / 1e3, r["element"], int(r["level"])): float(r["force N"]) for r in rows}
    last = max(level for _, _, level in known)
    return {
        radius: (known[radius, "bricks", last], max(
            abs(known[radius, "bricks", last] - other)
            for other in (known[radius, "bricks", last - 1], known[radius, "tetrahedra", last])))
        for radius in RADII
    }


def written(table, columns, rows):
    with table.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in rows:
            print(*row, sep=",", flush=True)
            writer.writerow(row)


def ladder():
    for radius in RADII:
        for element in ("tetrahedra", "bricks"):
            for level in LEVELS:
                size, force = converged(radius, element, level)
                yield round(1e3 * radius), element, level, size, f"{force:.6f}"


def contacts():
    for radius in RADII:
        for element in ("nodalAveraged", "constantStrain"):
            for name, force in on_its_mesh(radius, "five", element):
                yield round(1e3 * radius), element, name, f"{force:.6f}"


if __name__ == "__main__":
    if sys.argv[1:] == ["--contact"]:
        written(CONTACT, CONTACT_COLUMNS, contacts())
    else:
        written(TABLE, COLUMNS, ladder())
