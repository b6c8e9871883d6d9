"""Indentation: a flat punch and a ball on a drum of a half-space against closed forms, and a ball on a block.

A drum of a half-space has the half-space's own displacement on its wall and bottom, so that inside the closed form is exact:
no layer's correction, no guess of how far is far enough. Its mesh is rings about the contact.
"""

import csv

import halfspace
import meshes
import numpy as np
import pressed
import pytest
from fmu import Instance
from scenes import Problem
from scipy.optimize import brentq
from scipy.sparse import diags
from scipy.sparse.linalg import cg

YOUNG, POISSON = 6000.0, 0.45
ELEMENTS = ["constantStrain", "nodalAveraged"]


def growing(first, count, length):
    """Sums of a geometric series of `count` terms from `first` that ends at `length`."""
    ratio = brentq(lambda q: first * np.sum(q ** np.arange(count)) - length, 1 + 1e-9, 10)
    return np.append(np.cumsum(first * ratio ** np.arange(count - 1)), length)


def drum(name, contact, rings, outer, layers, field, element, ramp=0.0, size=3.0):
    """Cells as fine as the last of the `rings` at the contact grow to `size` of its radius; `field`: of the half-space."""
    fine, far = rings[-1] - rings[-2], size * contact
    radii = np.append(rings, rings[-1] + growing(fine, outer, far - rings[-1]))
    counts = [6 * k for k in range(1, len(rings) + 1)] + [6 * len(rings)] * outer
    heights = -np.append(growing(fine, layers, far)[::-1], 0)
    problem = Problem(name, meshes.drum(radii, counts, heights), gravity=[0.0, 0.0, 0.0])
    problem.tissue.element = element
    problem.set(model={"element": element})
    r, z = np.hypot(*problem.nodes[:, :2].T), problem.nodes[:, 2]
    wall = np.flatnonzero((r > far - 1e-9) | (z < 1e-9 - far))
    for node, u in zip(wall, field(problem.nodes[wall])):
        problem.prescribe([node], u.tolist(), ramp)
    return problem


def top(problem, radius):
    r = np.hypot(*problem.nodes[:, :2].T)
    return np.flatnonzero((r < radius + 1e-9) & (problem.nodes[:, 2] > -1e-12))


PUNCH, SINK = 0.01, 0.001


def punched(element, count=6, ramp=0.0):
    """Its rings grow finer towards the edge of a flat punch, which is one of them."""
    rings = PUNCH * (1 - (1 - np.arange(1, count + 1) / count) ** 1.5)

    def field(points):
        return halfspace.below_punch(points, POISSON, PUNCH, SINK)

    return drum("punched", PUNCH, rings, count + 1, count + count // 2, field, element, ramp)


def same(found, known):
    """Displacements are equal to 1e-6 of the largest."""
    assert np.abs(found - known).max() < 1e-6 * np.abs(known).max()


def test_the_closed_form():
    """Under a punch all is at its depth, outside as Boussinesq says; inside div sigma = 0."""
    r = np.array([0.0, 0.003, 0.0099, 0.011, 0.02, 0.5])
    flat = np.column_stack([r, 0 * r, 0 * r])
    u = halfspace.below_punch(flat, POISSON, PUNCH, SINK)
    assert np.abs(u[:, 2] + 2 / np.pi * SINK * np.arcsin(np.minimum(PUNCH / np.maximum(r, 1e-9), 1))).max() < 1e-9
    assert halfspace.punch_force(1, 0.499999, 1, 1) == pytest.approx(halfspace.bonded_force(1, 0.499999, 1, 1), rel=1e-5)
    at, h = np.array([0.007, 0.002, -0.006]), 2e-4
    steps = h * np.stack(np.meshgrid(*3 * [[-1, 0, 1]], indexing="ij"), -1).reshape(-1, 3)
    for below, size in ((halfspace.below_punch, PUNCH), (halfspace.below_ball, 0.03)):
        u = below(at + steps, POISSON, size, SINK).T.reshape(3, 3, 3, 3)

        def second(k, i, j):
            part = u[k]
            if i == j:
                line = np.moveaxis(part, i, 0)[:, 1, 1]
                return (line[0] - 2 * line[1] + line[2]) / h**2
            plane = part.take(1, 3 - i - j)
            return (plane[2, 2] - plane[2, 0] - plane[0, 2] + plane[0, 0]) / (4 * h**2)

        # (1 - 2 nu) laplace u + grad div u = 0
        laplace = np.array([sum(second(k, i, i) for i in range(3)) for k in range(3)])
        swell = np.array([sum(second(k, i, k) for k in range(3)) for i in range(3)])
        assert np.abs((1 - 2 * POISSON) * laplace + swell).max() < 1e-2 * np.abs(swell).max()


def close(force, exact, low, high):
    """Its relative error; a test's bounds are not far from what was seen, so that one which gets better shows, too."""
    error = force / exact - 1
    print(f"{100 * error:+.2f} %")
    assert low < error < high


def statics(problem, held, value):
    """Displacement and reactions of the oracle's stiffness, by conjugate gradients."""
    matrix = problem.tissue.stiffness()
    free = np.flatnonzero(~held.ravel())
    u = np.where(held, value, 0).ravel()
    inner = matrix[free][:, free]
    missed = 1
    u[free], missed = cg(inner, -(matrix @ u)[free], rtol=1e-11, M=diags(1 / inner.diagonal()))
    assert not missed
    return u.reshape(-1, 3), np.where(held.ravel(), matrix @ u, 0).reshape(-1, 3)


def agrees(problem, found, force, held):
    """Vertices and force are those of the oracle with these nodes displaced as found, to 1e-6."""
    given, value = problem.held.copy(), problem.value.copy()
    given[held], value[held] = True, found[held]
    u, reaction = statics(problem, given, value)
    same(found, u)
    known = -reaction[held].sum(axis=0)
    assert np.linalg.norm(force - known) < 1e-6 * np.linalg.norm(known)


@pytest.mark.parametrize("element, low, high", [("nodalAveraged", -0.01, 0.01), ("constantStrain", 0.1, 0.14)])
def test_a_flat_punch_without_friction(element, low, high, reference):
    """`prescribed` along z alone."""
    problem = punched(element)
    under = top(problem, PUNCH)
    problem.prescribe(under, [None, None, -SINK], 0.0)
    found = reference(problem.scene)
    force = -sum(found["reaction"][str(i)][2] for i in under)
    u, known = statics(problem, problem.held, problem.value)
    same(np.array(found["displacement"]), u)
    assert force == pytest.approx(-known[under, 2].sum(), rel=1e-6)
    close(force, halfspace.punch_force(YOUNG, POISSON, PUNCH, SINK), low, high)


def test_a_flat_punch_on_finer_cells(reference):
    """Constant strain errs by the size of its cells."""
    problem = punched("constantStrain", 8)
    under = top(problem, PUNCH)
    problem.prescribe(under, [None, None, -SINK], 0.0)
    found = reference(problem.scene)
    force = -sum(found["reaction"][str(i)][2] for i in under)
    close(force, halfspace.punch_force(YOUNG, POISSON, PUNCH, SINK), 0.07, 0.09)


@pytest.mark.parametrize("element, low, high", [("nodalAveraged", -0.01, 0.01), ("constantStrain", 0.1, 0.14)])
def test_a_flat_punch_that_sticks(element, low, high, build):
    """A grasper takes a round patch and goes down.

    Wall and bottom have the field of a punch that slides. From drums of 2, 3 and 4.5 radii either punch's error is the same to
    0.1 %.
    """
    problem = punched(element, ramp=0.05)
    inside = np.unique(np.round(np.hypot(*problem.nodes[top(problem, PUNCH)][:, :2].T), 9))[-2]
    chord = PUNCH * np.cos(np.pi / 36)
    radius, reach = 0.03, (inside + chord) / 2
    height = np.sqrt(radius**2 - reach**2)
    problem.set(model={"kind": "quasiStatic", "touchable": {"nodes": top(problem, 1.2 * PUNCH).tolist()}})
    problem.tool("punch", "grasper", (0, 0, height), radius=radius)
    with Instance(build(problem.scene)) as instance:
        instance.set("tool[1].active", True)
        for k in range(1, 51):
            instance.place(1, [0, 0, height - SINK * k / 50])
            instance.step(1e-3)
        instance.step(1e-3)
        found = instance.positions() - problem.nodes
        force = instance.vector("tool[1].force")
    held = np.flatnonzero(np.abs(found[:, 2] + SINK) < 1e-9)
    assert set(held) == set(top(problem, PUNCH))
    agrees(problem, found, force, held)
    close(force[2], halfspace.bonded_force(YOUNG, POISSON, PUNCH, SINK), low, high)


BALL, DEPTH = 0.03, 0.0012
CONTACT = np.sqrt(BALL * DEPTH)


def balled(element, friction, ramp, count=6, outer=4, layers=7):
    """Even rings a little further than the contact, which is of 6 mm."""
    rings = 1.25 * CONTACT * np.arange(1, count + 1) / count

    def field(points):
        return halfspace.below_ball(points, POISSON, BALL, DEPTH)

    problem = drum("balled", CONTACT, rings, outer, layers, field, element, ramp)
    problem.tool("ball", "probe", (0, 0, BALL + 1e-6), radius=BALL)
    problem.scene["tools"][0]["friction"] = friction
    return problem


def lowered(instance, ticks):
    for k in range(1, ticks + 1):
        instance.place(1, [0, 0, BALL - DEPTH * k / ticks])
        instance.step(1e-3)


@pytest.mark.parametrize("element, low, high", [("nodalAveraged", -0.01, 0.01), ("constantStrain", 0.07, 0.1)])
def test_a_ball_that_slides(element, low, high, build):
    problem = balled(element, 0.0, 0.0)
    problem.set(start="equilibrium", integration={"scheme": "symplecticEuler"})
    with Instance(build(problem.scene)) as instance:
        lowered(instance, 50)
        instance.step(0.2)
        instance.step(0.1)
        # Where hundreds of places touch `force` jitters by a per cent; what the tissue has been given does not.
        force = instance.vector("tool[1].meanForce")[2]
    close(force, halfspace.ball_force(YOUNG, POISSON, BALL, DEPTH), low, high)


@pytest.mark.parametrize("element, low, high", [("nodalAveraged", 0.09, 0.12), ("constantStrain", 0.17, 0.2)])
def test_a_ball_that_sticks(element, low, high, build):
    """All three vertices of a triangle that is touched are held, so that the patch is larger than the contact."""
    problem = balled(element, "stick", 0.1)
    problem.set(model={"kind": "quasiStatic", "touchable": {"nodes": top(problem, 1.6 * CONTACT).tolist()}})
    with Instance(build(problem.scene)) as instance:
        lowered(instance, 100)
        instance.step(1e-3)
        found = instance.positions() - problem.nodes
        force = instance.vector("tool[1].force")
        instance.place(1, [0, 0, BALL - DEPTH - 1e-7])
        instance.step(1e-3)
        moved = instance.positions() - problem.nodes - found
    held = np.flatnonzero(np.abs(moved - [0, 0, -1e-7]).max(axis=1) < 1e-13)
    agrees(problem, found, force, held)
    close(force[2], halfspace.ball_force(YOUNG, POISSON, BALL, DEPTH), low, high)


BLOCKS = [
    (0.02, "five", "nodalAveraged", -0.02, 0.02),
    (0.02, "kuhn", "nodalAveraged", -0.02, 0.02),
    (0.06, "five", "nodalAveraged", -0.02, 0.02),
    (0.06, "kuhn", "nodalAveraged", -0.02, 0.02),
    (0.02, "five", "constantStrain", 0.1, 0.14),
    (0.06, "five", "constantStrain", 0.03, 0.06),
]


@pytest.mark.parametrize("radius, pattern, element, low, high", BLOCKS)
def test_a_ball_on_a_block(radius, pattern, element, low, high, build):
    """6 mm into about 7 000 tetrahedra, without friction, against converged quadratic bricks."""
    problem = pressed.problem(radius, pattern, element)
    force, left = pressed.values()[radius]
    assert left < 0.003 * force
    centre = problem.scene["tools"][0]["position"][:2]
    with Instance(build(problem.scene)) as instance:
        for k in range(1, 151):
            instance.place(1, [*centre, pressed.SIZE + radius - pressed.DEPTH * k / 150])
            instance.step(1e-3)
        instance.step(0.3)
        instance.step(0.1)
        found = instance.vector("tool[1].meanForce")[2]
    close(found, force, low, high)


@pytest.mark.parametrize("radius", pressed.RADII)
@pytest.mark.parametrize("element", ["tetrahedra", "bricks"])
def test_the_converged_values(radius, element):
    """The coarse end of the ladder is what the table says."""
    with pressed.TABLE.open() as file:
        known = [r for r in csv.DictReader(file) if (r["radius mm"], r["element"]) == (f"{1e3 * radius:.0f}", element)]
    size, force = pressed.converged(radius, element, 1)
    assert known[0]["degrees of freedom"] == str(size)
    assert float(known[0]["force N"]) == pytest.approx(force, rel=1e-5)
