"""Indentation: a flat punch and a ball on a drum of a half-space against closed forms, and a ball on a block.

A drum of a half-space has the half-space's own displacement on its wall and bottom, so that inside the closed form is exact:
no layer's correction, no guess of how far is far enough. Its mesh is rings about the contact.
"""

import csv
from pathlib import Path

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


@pytest.mark.parametrize("element, count, bound", [("nodalAveraged", 6, 0.01), ("constantStrain", 6, 0.14), ("constantStrain", 13, 0.05)])
def test_a_flat_punch_without_friction(element, count, bound, reference):
    """`prescribed` along z alone. Constant strain errs by its cells: 3.6 mm/n."""
    problem = punched(element, count)
    under = top(problem, PUNCH)
    problem.prescribe(under, [None, None, -SINK], 0.0)
    found = reference(problem.scene)
    force = -sum(found["reaction"][str(i)][2] for i in under)
    if count == 6:
        u, known = statics(problem, problem.held, problem.value)
        same(np.array(found["displacement"]), u)
        assert force == pytest.approx(-known[under, 2].sum(), rel=1e-6)
    print(element, force / halfspace.punch_force(YOUNG, POISSON, PUNCH, SINK) - 1)
    assert force == pytest.approx(halfspace.punch_force(YOUNG, POISSON, PUNCH, SINK), rel=bound)


@pytest.mark.parametrize("element, bound", [("nodalAveraged", 0.01), ("constantStrain", 0.14)])
def test_a_flat_punch_that_sticks(element, bound, build):
    """A grasper takes a round patch and goes down. On wall and bottom a punch that sticks is as good as one that slides."""
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
    print(element, force[2] / halfspace.bonded_force(YOUNG, POISSON, PUNCH, SINK) - 1)
    assert force[2] == pytest.approx(halfspace.bonded_force(YOUNG, POISSON, PUNCH, SINK), rel=bound)


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


@pytest.mark.parametrize("element", ELEMENTS)
def test_a_ball_that_slides(element, build):
    """Vertices that touch are nowhere in the ball; the mean force over a tenth of a second."""
    problem = balled(element, 0.0, 0.0)
    problem.set(start="equilibrium", integration={"scheme": "symplecticEuler"})
    with Instance(build(problem.scene)) as instance:
        lowered(instance, 50)
        instance.step(0.2)
        instance.step(0.1)
        felt, mean = instance.vector("tool[1].force")[2], instance.vector("tool[1].meanForce")[2]
    exact = halfspace.ball_force(YOUNG, POISSON, BALL, DEPTH)
    print(element, len(problem.tetrahedra), felt / exact - 1, mean / exact - 1)


@pytest.mark.parametrize("element", ELEMENTS)
def test_a_ball_that_sticks(element, build):
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
    exact = halfspace.ball_force(YOUNG, POISSON, BALL, DEPTH)
    print(element, len(held), np.hypot(*problem.nodes[held][:, :2].T).max() / CONTACT, force[2] / exact - 1)
