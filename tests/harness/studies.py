"""Six scenes on which elements are judged: the same body and grips for the oracle and the product.

Boxes cut along planes; every grip ends on planes that all meshes of a scene share. For the oracle a
mesh is graded towards the edges of the grips, where stress has no bound, and ends at the planes of
symmetry: quadratic tetrahedra, or bricks in layers where those are not good enough. The product gets
the whole body and even cells.
"""

from dataclasses import dataclass
from typing import Callable

import numpy as np
from scipy.ndimage import map_coordinates

import meshes
from bricks import Bricks, bricks, halved
from laws import lame
from nonlinear import Body, Material, quadratic, solve
from scenes import Problem

YOUNG = 6000.0
TINY = 1e-9


@dataclass(frozen=True)
class Grip:
    """Nodes of the plane `axis` = `at`, in a window of other axes; how they move (nan: free)."""

    axis: int
    at: float
    move: object = (0.0, 0.0, 0.0)
    window: tuple = ()

    def nodes(self, points):
        chosen = np.abs(points[:, self.axis] - self.at) < TINY
        for axis, low, high in self.window:
            chosen &= (points[:, axis] > low - TINY) & (points[:, axis] < high + TINY)
        return np.flatnonzero(chosen)

    def displacement(self, points):
        """Of its nodes, n x 3."""
        mine = points[self.nodes(points)]
        return self.move(mine) if callable(self.move) else np.tile(self.move, (len(mine), 1))


@dataclass(frozen=True)
class Axis:
    """Planes all meshes share, cells between them for the product, and the planes where grips end.

    `half`: the plane of symmetry; `fine`: cells of the oracle's coarsest tetrahedra up to there.
    """

    planes: tuple
    cells: tuple
    fine: tuple = ()
    sharp: tuple = ()
    half: float | None = None

    def even(self, level):
        """Coordinates for the product."""
        counts = [max(1, round(n * level)) for n in self.cells]
        return joined(self.planes, counts, lambda a, b, t: t)

    def graded(self, level):
        """Coordinates for the oracle."""
        planes = self.planes
        if self.half is not None:
            planes = (*(p for p in planes if p < self.half - TINY), self.half)
        return joined(planes, [n * level for n in self.fine], self._grade)

    def _grade(self, a, b, t):
        first, last = a in self.sharp, b in self.sharp
        if first and last:
            return np.where(t < 0.5, 2 * t**2, 1 - 2 * (1 - t) ** 2)
        return t**2 if first else 1 - (1 - t) ** 2 if last else t


def layers(start, end, count, ratio):
    """Coordinates whose cells shrink by `ratio` from start to end."""
    return end + (start - end) * np.append(ratio ** np.arange(count), 0)


def joined(planes, counts, grade):
    parts = [np.array(planes[:1])]
    for a, b, n in zip(planes, planes[1:], counts):
        parts.append(a + (b - a) * grade(a, b, np.arange(1, n + 1) / n))
    return np.concatenate(parts)


@dataclass(frozen=True)
class Study:
    """A body, its grips, and the last one's reaction, measured along `along`.

    `levels`: of the ladder of graded meshes; `guess`: a displacement near the answer; `layered`:
    lines of the oracle's bricks, by the level, which is then the layers of cells at an edge.
    """

    name: str
    axes: tuple
    grips: tuple
    along: int
    levels: tuple
    shape: Callable = lambda nodes: nodes
    torque: bool = False
    guess: Callable | None = None
    layered: Callable | None = None

    @property
    def share(self):
        """How many times the oracle's mesh makes the whole."""
        return 2 ** sum(axis.half is not None for axis in self.axes)

    def mesh(self, level, pattern=meshes.five):
        """Even, whole; level 1 has about 7 000 tetrahedra in the pattern of five."""
        return self._mesh([axis.even(level) for axis in self.axes], pattern)

    def graded(self, level, pattern=meshes.six):
        return self._mesh([axis.graded(level) for axis in self.axes], pattern)

    def own(self, level):
        """The oracle's mesh, and its element."""
        if self.layered is not None:
            return *bricks(self.layered(level)), Bricks
        return *quadratic(*self.graded(level)), Body

    def _mesh(self, lines, pattern):
        cells = [len(line) - 1 for line in lines]
        nodes, tetrahedra = meshes.on_lines(pattern(cells, cells), lines)
        return meshes.oriented(self.shape(nodes), tetrahedra)

    def lattice(self, level):
        """Whole-number places of the nodes of the oracle's quadratic mesh, and the last one."""
        cells = [level * sum(axis.fine) for axis in self.axes]
        nodes, _ = quadratic(*meshes.six(cells, cells))
        return np.rint(2 * nodes).astype(int), 2 * np.array(cells)

    def carried(self, displacement, coarse, level):
        """A displacement of the oracle's mesh `coarse` on that of `level`."""
        if self.layered is not None:
            old, new = (list(map(halved, self.layered(n))) for n in (coarse, level))
            grid = displacement.reshape(*map(len, old), 3)
            places = [np.interp(b, a, np.arange(len(a))) for a, b in zip(old, new)]
            where = np.stack(np.meshgrid(*places, indexing="ij")).reshape(3, -1)
            return self._drawn(grid, where)
        at, size = self.lattice(coarse)
        to, fine = self.lattice(level)
        grid = np.zeros((*(size + 1), 3))
        grid[tuple(at.T)] = displacement
        return self._drawn(grid, (to * (size / fine)).T)

    @staticmethod
    def _drawn(grid, where):
        parts = [map_coordinates(grid[..., k], where, order=2, mode="nearest") for k in range(3)]
        return np.stack(parts, axis=1)

    def supports(self, nodes):
        """held, value: n x 3; planes of symmetry included where the mesh ends there."""
        held, value = np.zeros(nodes.shape, bool), np.zeros(nodes.shape)
        for grip in self.grips:
            mine, move = grip.nodes(nodes), grip.displacement(nodes)
            held[mine] |= ~np.isnan(move)
            value[mine] = np.where(np.isnan(move), value[mine], move)
        for k, axis in enumerate(self.axes):
            if axis.half is not None and nodes[:, k].max() < axis.half + TINY:
                held[np.abs(nodes[:, k] - axis.half) < TINY, k] = True
        return held, value

    def measured(self, nodes, displacement, reaction):
        """Force [N] of the last grip along its way, or its torque [N m] about the axis `along`."""
        mine = self.grips[-1].nodes(nodes)
        if self.torque:
            return np.cross((nodes + displacement)[mine], reaction[mine]).sum(axis=0)[self.along]
        way = np.sign(self.grips[-1].displacement(nodes)[0, self.along])
        return way * reaction[mine, self.along].sum()

    def oracle(self, level, law, poisson, mesh=None, **options):
        """Force or torque and energy of the whole, on the oracle's own mesh or on a whole one."""
        nodes, cells, options["element"] = (*mesh, Body) if mesh else self.own(level)
        share = 1 if mesh else self.share
        material = Material(law, *lame(YOUNG, poisson))
        if self.guess is not None:
            options["start"] = self.guess(nodes)
        found = solve(nodes, cells, material, *self.supports(nodes), **options)
        force = self.measured(nodes, found.displacement, found.reaction)
        return share * force, share * found.energy, found

    def problem(self, level, law, poisson, pattern=meshes.five, **model):
        """The product's scene (`.scene`) of the whole; `model`: element, hourglass and the like."""
        problem = Problem(self.name, self.mesh(level, pattern), gravity=[0.0, 0.0, 0.0])
        problem.tissue.poisson = np.full(len(problem.tetrahedra), poisson)
        problem.scene["materials"][0] |= {"youngModulus": YOUNG, "poissonRatio": poisson}
        problem.set(model={"kind": "tensorMass", "elasticity": law} | model)
        for grip in self.grips:
            nodes, moves = grip.nodes(problem.nodes), grip.displacement(problem.nodes)
            if not np.any(moves):
                problem.fix(nodes)
                continue
            moves = np.where(np.isnan(moves), np.inf, moves)
            for move in np.unique(moves, axis=0):
                alike = np.all(moves == move, axis=1)
                way = [float(x) if np.isfinite(x) else None for x in move]
                problem.prescribe(nodes[alike], way)
        return problem


FREE = np.nan


def plate():
    """Clamped at both ends, a patch of 4 cm pressed in by 6 mm."""
    axes = (
        Axis((0, 0.09, 0.13, 0.22), (11, 5, 11), (6, 2), (0, 0.09), 0.11),
        Axis((0, 0.03, 0.07, 0.1), (4, 5, 4), (3, 2), (0.03,), 0.05),
        Axis((0, 0.02), (4,), (2,), (0.02,)),
    )
    patch = Grip(2, 0.02, (0, 0, -0.006), ((0, 0.09, 0.13), (1, 0.03, 0.07)))
    return Study("plate", axes, (Grip(0, 0), Grip(0, 0.22), patch), 2, (1, 2, 3))


def block(ratio=0.25, levels=(2, 3, 4)):
    """6 cm, on the table, a patch of 2 cm pressed in by 12 mm.

    Tissue folds within half a millimetre of the patch's edge, and the force falls by some per cent
    once cells are small enough to fold: `ratio` is that of the size of one layer to the last.
    """
    side = Axis((0, 0.02, 0.04, 0.06), (4, 4, 4), half=0.03)
    axes = (side, side, Axis((0, 0.06), (10,)))
    patch = Grip(2, 0.06, (0, 0, -0.012), ((0, 0.02, 0.04), (1, 0.02, 0.04)))

    def layered(count):
        inner = layers(0.03, 0.02, count, ratio)[-2::-1]
        line = np.concatenate([layers(0, 0.02, count + 1, ratio), inner])
        return [line, line, np.append([0, 0.0075], layers(0.03, 0.06, count + 1, ratio))]

    return Study("block", axes, (Grip(2, 0), patch), 2, levels, layered=layered)


def tapered(nodes):
    """A box 48 x 44 mm drawn out to Cook's panel."""
    x, y = nodes[:, 0] / 0.048, nodes[:, 1] / 0.044
    return np.stack([nodes[:, 0], 0.044 * x + (0.044 - 0.028 * x) * y, nodes[:, 2]], axis=1)


def cook():
    """Cook's membrane, 6 mm thick, clamped on the left, its right face moved up by 8 mm."""
    axes = (
        Axis((0, 0.048), (24,), (4,), (0, 0.048)),
        Axis((0, 0.044), (20,), (4,), (0, 0.044)),
        Axis((0, 0.006), (3,), (1,), (0,), 0.003),
    )
    grips = (Grip(0, 0), Grip(0, 0.048, (FREE, 0.008, FREE)))
    return Study("cook", axes, grips, 1, (2, 3, 4), tapered)


def beam():
    """10 x 2 x 2 cm, clamped, its tip face moved down by 3 cm."""
    axes = (
        Axis((0, 0.1), (40,), (10,), (0, 0.1)),
        Axis((0, 0.02), (6,), (1,), (0,), 0.01),
        Axis((0, 0.02), (6,), (2,), (0, 0.02)),
    )
    return Study("beam", axes, (Grip(0, 0), Grip(0, 0.1, (FREE, FREE, -0.03))), 2, (2, 3, 4))


def quarter_turn(nodes):
    """About the line x = y = 1 cm, by 90 degrees."""
    x, y = nodes[:, 0] - 0.01, nodes[:, 1] - 0.01
    return np.stack([-y - x, x - y, 0 * x], axis=1)


def helix(nodes):
    """The turn spread evenly along the bar: keeps the volume."""
    x, y = nodes[:, 0] - 0.01, nodes[:, 1] - 0.01
    c, s = np.cos(np.pi / 2 * nodes[:, 2] / 0.1), np.sin(np.pi / 2 * nodes[:, 2] / 0.1)
    return np.stack([c * x - s * y - x, s * x + c * y - y, 0 * x], axis=1)


def twist():
    """Held out: a bar 2 x 2 x 10 cm, its end faces turned by 90 degrees."""
    side = Axis((0, 0.02), (6,), (2,), (0, 0.02))
    axes = (side, side, Axis((0, 0.1), (40,), (6,), (0, 0.1)))
    grips = (Grip(2, 0), Grip(2, 0.1, quarter_turn))
    return Study("twist", axes, grips, 2, (3, 4, 5), torque=True, guess=helix)


def shear():
    """Held out: 4 cm, the top face moved sideways by 16 mm."""
    axes = (
        Axis((0, 0.04), (12,), (3,), (0, 0.04)),
        Axis((0, 0.04), (12,), (2,), (0,), 0.02),
        Axis((0, 0.04), (10,), (3,), (0, 0.04)),
    )
    return Study("shear", axes, (Grip(2, 0), Grip(2, 0.04, (0.016, 0, 0))), 0, (2, 3, 4))


STUDIES = [plate, block, cook, beam, twist, shear]
