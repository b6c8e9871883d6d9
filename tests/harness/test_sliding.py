"""Tools that slide: settled forces and shapes against an equilibrium found by active sets."""

import contact
import meshes
import numpy as np
import pytest
from fmu import Instance, settle
from scenes import Problem

RADIUS = 0.012
SIZE = (0.06, 0.06, 0.03)
PLACE = np.array([0.031, 0.0295])


def block(element, mesh, kind="tensorMass"):
    problem = Problem("block", mesh, gravity=[0.0, 0.0, 0.0])
    problem.fix(problem.face(2, 0.0))
    problem.set(model={"kind": kind, "element": element})
    problem.set(integration={"scheme": "symplecticEuler"})
    problem.tissue.element = element
    problem.tool("ball", "probe", (*PLACE, SIZE[2] + RADIUS + 1e-4), radius=RADIUS)
    problem.scene["tools"][0]["friction"] = 0.0
    return problem


MESHES = [meshes.kuhn(SIZE, (8, 8, 4), jitter=0.15), meshes.five(SIZE, (9, 9, 5))]


@pytest.mark.parametrize("mesh", MESHES, ids=["kuhn", "five"])
@pytest.mark.parametrize("element", ["constantStrain", "nodalAveraged"])
@pytest.mark.parametrize("depth", [0.001, 0.005])
def test_a_ball_without_friction(element, mesh, depth, build):
    problem = block(element, mesh)
    centre = np.array([*PLACE, SIZE[2] + RADIUS - depth])
    start = centre + [0, 0, depth]
    u, force = contact.pressed(problem.tissue, problem.held, problem.force, start, centre, RADIUS)
    with Instance(build(problem.scene)) as instance:
        for k in range(300):
            instance.place(1, [*PLACE, SIZE[2] + RADIUS - depth * (k + 1) / 300])
            instance.step(1e-3)
        found = settle(instance, problem.nodes, tolerance=1e-5)
        felt = instance.vector("tool[1].force")
        mean = instance.vector("tool[1].meanForce")
    size = np.linalg.norm(force)
    assert np.linalg.norm(felt - force) < 2e-3 * size, (felt, force)
    assert np.linalg.norm(mean - force) < 2e-3 * size
    assert np.abs(found - u).max() < 2e-3 * np.abs(u).max()


@pytest.mark.parametrize("mesh", MESHES, ids=["kuhn", "five"])
@pytest.mark.parametrize("element", ["constantStrain", "nodalAveraged"])
@pytest.mark.parametrize("dynamic, bound", [(None, 0.03), (0.05, 0.03), (0.04, 0.15)])
def test_a_ball_on_precomputed_tissue(dynamic, bound, element, mesh, build):
    """Its places stay where they are on the tissue: hardly anything enters between them. Where it presses across the
    interface (0.04 m) some of the triangles are touched at their vertices only."""
    depth = 0.005
    problem = block(element, mesh, "quasiStatic" if dynamic is None else "hybrid")
    if dynamic:
        half = {"halfSpace": {"point": [dynamic, 0, 0], "normal": [1, 0, 0]}}
        problem.scene["model"]["dynamic"] = half
    centre = np.array([*PLACE, SIZE[2] + RADIUS - depth])
    start = centre + [0, 0, depth]
    whole = block(element, mesh)
    u, force = contact.pressed(whole.tissue, whole.held, whole.force, start, centre, RADIUS)
    with Instance(build(problem.scene)) as instance:
        for k in range(100):
            instance.place(1, [*PLACE, SIZE[2] + RADIUS - depth * (k + 1) / 100])
            instance.step(1e-3)
        instance.step(1.0)
        felt = instance.vector("tool[1].force")
    assert np.linalg.norm(felt - force) < bound * np.linalg.norm(force), (felt, force)
