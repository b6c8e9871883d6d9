"""Motion in time against an exact modal solution and DOP853; the critical step against scipy."""

import meshes
import numpy as np
import oracle
import pytest
import star
from fmu import Instance, settle
from scenes import SIZE, plate
from test_contact import TIP, grasped, jaws


def fine(problem, damping, rate=1000, parts=50):
    """Steps so short that the method's own error is below what is tested."""
    return problem.set(integration={"damping": damping, "hapticRate": rate, "substep": 1 / rate / parts})


def recorded(instance, problem, times):
    history = []
    for t in times:
        if t > instance.time:
            instance.step(t - instance.time)
        history.append(instance.positions() - problem.nodes)
    return np.array(history)


def worst(found, exact):
    return np.abs(found - exact).max() / np.abs(exact).max()


@pytest.mark.parametrize("mass", ["lumped", "uniform"])
def test_free_vibration_of_a_damped_beam(mass, build):
    """Released from its sag when gravity is switched off, a beam swings as the exact modal solution does."""
    problem = plate("beam", cells=(8, 2, 2))
    fine(problem, damping=3.0).set(start="equilibrium").set(integration={"mass": mass})
    sag, _ = oracle.statics(problem.tissue, problem.force, problem.held)
    masses = problem.tissue.mass()
    masses = masses if mass == "lumped" else np.full_like(masses, masses.mean())
    times = np.arange(0, 0.5001, 0.01)
    exact = oracle.modal_history(problem.tissue, 3.0, np.zeros(sag.shape), problem.held, sag, times, masses)
    assert (exact[:, -1, 2] > 0.2 * np.abs(sag).max()).any(), "it swings through"
    with Instance(build(problem.scene)) as instance:
        instance.set("gravity.z", 0.0)
        assert worst(recorded(instance, problem, times), exact) < 1e-3


def test_step_response_with_materials(build):
    """A stiff and a soft half under sudden gravity move as the exact modal solution does."""
    problem = fine(plate("halves", cells=(6, 3, 2)), damping=10.0)
    problem.material(np.flatnonzero(meshes.centroids(*problem.mesh)[:, 0] < 0.05), 3e4, 0.3, 2000)
    times = np.arange(0, 0.3001, 0.01)
    exact = oracle.modal_history(problem.tissue, 10.0, problem.force, problem.held, 0 * problem.nodes, times)
    with Instance(build(problem.scene)) as instance:
        assert worst(recorded(instance, problem, times), exact) < 1e-3


def test_driven_motion(build):
    """Prescribed nodes on a ramp and a growing load drive the rest as DOP853 says."""
    problem = fine(plate("driven", cells=(6, 2, 1)), damping=20.0)
    moved, loaded = problem.face(0, SIZE[0]), problem.at((0.04, 0, SIZE[2]), (0.06, SIZE[1], SIZE[2]))
    problem.prescribe(moved, [None, 0.003, 0.006], ramp=0.1)
    problem.load(loaded, [0.0, 0.0, -0.01], ramp=0.05)
    times = np.arange(0, 0.2001, 0.01)
    exact = oracle.driven_history(
        problem.tissue, 20.0,
        lambda t: problem.tissue.weight(problem.gravity) + problem.loads * min(t / 0.05, 1),
        problem.held, lambda t: problem.value * min(t / 0.1, 1), None, times)
    with Instance(build(problem.scene)) as instance:
        assert worst(recorded(instance, problem, times), exact) < 1e-3


def test_tool_driven_motion_and_force(build):
    """A grasper moved at constant speed drives the tissue, and feels the force, that DOP853 gives."""
    problem = fine(grasped("towed", cells=(8, 4, 1), gravity=[0.0, 0.0, 0.0]), damping=20.0)
    held = jaws(problem)
    speed = np.array([0.0, 0.01, 0.05])
    nodes = problem.held.copy()
    nodes[held] = True
    way = np.zeros(nodes.shape)
    way[held] = 1.0
    times = np.arange(0, 0.1001, 0.01)
    exact = oracle.driven_history(problem.tissue, 20.0, lambda t: 0 * way, nodes, lambda t: way * speed * t, None, times)
    internal = np.array([(problem.tissue.stiffness() @ u.ravel()).reshape(-1, 3)[held].sum(axis=0) for u in exact])
    damped = 20.0 * problem.tissue.mass()[held].sum() * speed
    found, forces = [], []
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        for t in times:
            if t > 0:
                instance.place(1, TIP + speed * t)
                instance.step(t - instance.time)
                forces.append(instance.vector("tool[1].force"))
            found.append(instance.positions() - problem.nodes)
    assert worst(np.array(found), exact) < 1e-3
    assert worst(np.array(forces), -(internal + damped)[1:]) < 2e-3


def test_kinetic_energy_is_that_of_the_half_steps(build):
    """energy.kinetic is v_-^T M v_+ / 2 of the velocities seen in the vertices."""
    problem = plate("kinetic").set(integration={"damping": 0.0})
    mass = problem.tissue.mass()[:, None]
    with Instance(build(problem.scene)) as instance:
        h = instance.get("diagnostics.substep")
        for _ in range(40):
            instance.step(h)
        seen, booked = [instance.positions()], []
        for _ in range(10):
            booked.append(instance.get("energy.kinetic"))
            instance.step(h)
            seen.append(instance.positions())
    v = np.diff(seen, axis=0) / h
    expected = 0.5 * (mass * v[:-1] * v[1:]).sum(axis=(1, 2))
    assert np.allclose(booked[1:], expected, rtol=1e-8)


@pytest.mark.parametrize("mesh", ["kuhn", "tensor", "delaunay"])
@pytest.mark.parametrize("mass", ["lumped", "uniform"])
def test_critical_step(mesh, mass, inspect):
    """criticalStep is scipy's 2/omega, never above it by more than 0.1 %, and not below by more than 5 %."""
    problem = plate(f"critical_{mesh}", mesh=getattr(meshes, mesh)(SIZE, (6, 3, 2)))
    problem.material(np.arange(50), 2e4, 0.3, 1000).set(integration={"mass": mass})
    masses = problem.tissue.mass()
    used = problem.tissue.used
    masses = masses if mass == "lumped" else np.where(np.isin(np.arange(len(masses)), used), masses.sum() / len(used), 0)
    omega = oracle.highest_frequency(problem.tissue, problem.held, masses)
    found = inspect(problem.scene)
    limit = {"symplecticEuler": 2.0, "centralDifference": 2.0, "rungeKutta4": 8**0.5}
    for scheme, factor in limit.items():
        assert 0.95 <= found["criticalStep"][scheme] * omega / factor <= 1.001, scheme
    assert found["substep"] < found["criticalStep"]["symplecticEuler"]


def test_critical_step_holds_after_any_cut(inspect, build):
    """In a scene that can be cut the substep holds for what is left, where a cut makes the limit shorter, too."""
    problem = plate("cut_limit", mesh=meshes.shaken(meshes.delaunay(SIZE, (6, 3, 2)), 1e-5))
    c = meshes.centroids(*problem.mesh)
    gone = np.flatnonzero((c[:, 0] > 0.04) & (c[:, 1] > 0.02) & (np.arange(len(c)) % 3 > 0))
    truth = star.Tissue(*problem.mesh).event(gone)
    largest, *loose = sorted(star.pieces(truth.tetrahedra, truth.left), key=len, reverse=True)
    # What has come loose would fall for ever.
    loose = np.concatenate(loose)
    problem.cut(gone, 0.01).cut(loose, 0.011)
    left = problem.tissue.without(truth.event(loose).gone)
    assert len(left.tetrahedra) == len(largest)
    omega = oracle.highest_frequency(left, problem.held)
    assert omega > oracle.highest_frequency(problem.tissue, problem.held)
    assert inspect(problem.scene)["substep"] < 2 / omega
    with Instance(build(problem.scene)) as instance:
        assert instance.get("diagnostics.substep") < 2 / omega
        instance.step(0.02)
        assert instance.get("diagnostics.criticalSubstep") <= 1.001 * 2 / omega
        settle(instance, problem.nodes)
