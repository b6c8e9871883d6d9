"""What a haptic device asks beside the force: stiffness, directional derivatives, slopes for extrapolation."""

from ctypes import c_double, c_int, c_uint

import numpy as np
import pytest
from fmpy import read_model_description
from fmu import DISCARD, ERROR, OK, POSE, Instance
from test_contact import TIP, UP, grasped, pull, quaternion

FORCES = [f"{kind}.{a}" for kind in ("force", "torque") for a in "xyz"]


def two_graspers(name="pair", **options):
    """A plate with a grasper at its free end and one half way."""
    problem = grasped(name, **options)
    return problem.tool("second", "grasper", (0.05, 0.025, 0.023), radius=0.0045, length=0.1, orientation=UP,
                        active=0.006)


def references(fmu, names):
    return (c_uint * len(names))(*(fmu.reference[n] for n in names))


def derivative(instance, unknown, known, direction):
    """Status and values of fmi2GetDirectionalDerivative."""
    values = (c_double * len(unknown))(*([np.nan] * len(unknown)))
    status = instance.status("fmi2GetDirectionalDerivative", references(instance.fmu, unknown), len(unknown),
                             references(instance.fmu, known), len(known),
                             (c_double * len(known))(*direction), values)
    return status, np.array(values)


def slopes(instance, names, order=1):
    """Status and values of fmi2GetRealOutputDerivatives."""
    values = (c_double * len(names))(*([np.nan] * len(names)))
    status = instance.status("fmi2GetRealOutputDerivatives", references(instance.fmu, names), len(names),
                             (c_int * len(names))(*([order] * len(names))), values)
    return status, np.array(values)


def stiffness(instance, tool, name="stiffness"):
    return np.array(instance.get(*(f"tool[{tool}].{name}[{j},{k}]" for j in (1, 2, 3) for k in (1, 2, 3)))).reshape(3, 3)


def perturbed(instance, unknown, known, d, length):
    """(F(x + d) - F(x - d)) / 2d by perturb, step, restore."""
    start, time = instance.get(known), instance.time
    state = instance.slave.getFMUstate()
    felt = []
    for value in (start + d, start - d):
        instance.set(known, value)
        instance.step(length)
        felt.append(np.array(instance.get(*unknown)))
        instance.slave.setFMUstate(state)
        instance.time = time
    instance.slave.freeFMUstate(state)
    return (felt[0] - felt[1]) / (2 * d)


MODELS = {
    "linear": {},
    "rungeKutta4": {"integration": {"scheme": "rungeKutta4"}},
    "implicitEuler": {"integration": {"scheme": "implicitEuler"}},
    "quasiStatic": {"model": {"kind": "quasiStatic"}},
    "hybrid": {"model": {"kind": "hybrid", "dynamic": {"box": {"min": [0, 0, 0], "max": [0.06, 1, 1]}}}},
    "stVenantKirchhoff": {"model": {"elasticity": "stVenantKirchhoff"}},
}


@pytest.mark.parametrize("length", [0.001, 0.003])
@pytest.mark.parametrize("model", MODELS)
def test_derivatives_equal_perturb_step_restore(model, length, build):
    """Force and torque of either tool by every component of either pose, mid-motion, to 1e-6; nothing changes."""
    problem = two_graspers(gravity=[0.0, 0.0, 0.0]).set(**MODELS[model])
    values = {"tool[1].active": True, "tool[2].active": True}
    with Instance(build(problem.scene), values=values) as instance:
        turn = quaternion([1.0, 0.2, 0.1], 0.1)
        for k in range(20):
            instance.place(1, TIP + np.array([1e-4, -5e-5, 1e-4]) * k)
            instance.place(2, np.array([0.05, 0.025, 0.023]) + np.array([0.0, 5e-5, 1e-4]) * k)
            instance.step(length)
        instance.place(1, TIP + np.array([0.0021, -0.001, 0.0021]))
        instance.place(2, orientation=np.array(UP) + 0.05 * turn)
        before = instance.serialised()
        unknown = [f"tool[{i}].{n}" for i in (1, 2) for n in FORCES]
        found, expected = [], []
        for known in (f"tool[{k}].{n}" for k in (1, 2) for n in POSE):
            status, column = derivative(instance, unknown, [known], [1.0])
            assert status == OK
            found.append(column)
        assert instance.serialised() == before
        for known in (f"tool[{k}].{n}" for k in (1, 2) for n in POSE):
            expected.append(perturbed(instance, unknown, known, 2e-6 if "position" in known else 1e-4, length))
        found, expected = np.array(found).reshape(2, 7, 2, 2, 3), np.array(expected).reshape(2, 7, 2, 2, 3)
        for rows in (slice(0, 3), slice(3, 7)):
            for kind in (0, 1):
                off = np.abs(found - expected)[:, rows, :, kind].max()
                assert off < 1e-6 * np.abs(expected[:, rows, :, kind]).max()
        # The stiffness is the block of one tool's force by its own position.
        assert np.array_equal(stiffness(instance, 1), found[0, :3, 0, 0].T)
        instance.step(length)


def test_description_says_so(build):
    """The flags are set, and stiffness is local, continuous and in N/m."""
    fmu = build(grasped().scene)
    description = read_model_description(fmu.path)
    assert description.coSimulation.providesDirectionalDerivative
    assert description.coSimulation.maxOutputDerivativeOrder == 1
    for name in ("stiffness", "staticStiffness"):
        for j in (1, 2, 3):
            for k in (1, 2, 3):
                variable = fmu.variables[f"tool[1].{name}[{j},{k}]"]
                assert (variable.causality, variable.variability, variable.unit) == ("local", "continuous", "N/m")
    # No dependencies are declared: every output may depend on every input.
    assert all(unknown.dependencies is None for unknown in description.outputs)


def test_static_stiffness_is_what_settles(build):
    """Moved a little and settled, the force answers by minus the static stiffness; it is symmetric and positive."""
    problem = two_graspers("settles").set(integration={"scheme": "implicitEuler"})
    values = {"tool[1].active": True, "tool[2].active": True}
    with Instance(build(problem.scene), values=values) as instance:
        pull(instance, 1, TIP, TIP + [0.001, 0.0, 0.003], 0.05)
        found = stiffness(instance, 1, "staticStiffness")
        end, expected = TIP + [0.001, 0.0, 0.003], []
        for axis in np.eye(3):
            settled = []
            for d in (1e-4, -1e-4):
                instance.place(1, end + d * axis)
                for _ in range(150):
                    instance.step(0.1)
                settled.append(instance.vector("tool[1].force"))
            expected.append((settled[1] - settled[0]) / 2e-4)
        expected = np.array(expected).T
        assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
        assert np.array_equal(found, found.T) and np.linalg.eigvalsh(found).min() > 0
        assert np.array_equal(stiffness(instance, 1, "staticStiffness"), found)
        assert np.linalg.eigvalsh(-stiffness(instance, 1)).min() > np.linalg.eigvalsh(found).min()


def test_a_loose_plate_has_no_static_stiffness(build):
    """Held by the tool alone it follows: zeros, not an error."""
    problem = grasped("free", clamp=False, gravity=[0.0, 0.0, 0.0])
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        assert not stiffness(instance, 1).any() and not stiffness(instance, 1, "staticStiffness").any()
        pull(instance, 1, TIP, TIP + [0.001, 0.0, 0.003], 0.05)
        assert np.abs(stiffness(instance, 1, "staticStiffness")).max() < 1e-6
        assert np.isfinite(stiffness(instance, 1)).all() and stiffness(instance, 1).any()


def test_slopes_extrapolate_the_force(build):
    """F(t) + F'(t) dt is nearer to what comes than F(t); velocities are differences of positions."""
    problem = grasped("slopes")
    names = [f"tool[1].{n}" for n in FORCES]
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        status, zeros = slopes(instance, names)
        assert status == OK and not zeros.any()
        held, led = 0.0, 0.0
        forces, at = [], []
        for k in range(120):
            instance.place(1, TIP + np.array([0.0, 0.0, 0.004]) * np.sin(0.03 * k) ** 2)
            instance.step(0.001)
            force = instance.get(*names)
            status, slope = slopes(instance, names)
            assert status == OK
            if k > 20:
                held += np.abs(np.array(force) - forces[-1])[2]
                led += np.abs(np.array(force) - at[-1])[2]
                assert np.abs(slope - (np.array(force) - forces[-1]) / 0.001).max() <= 1e-9 * np.abs(slope).max()
            forces.append(np.array(force))
            at.append(forces[-1] + slope * 0.001)
        assert led < 0.5 * held
        substep = instance.get("diagnostics.substep")
        before = instance.positions()
        instance.step(substep)
        velocity = (instance.positions() - before) / substep
        vertices = [f"surface.vertex[{j + 1}].{a}" for j in range(len(before)) for a in "xyz"]
        status, found = slopes(instance, vertices)
        assert status == OK
        assert np.abs(found.reshape(-1, 3) - velocity).max() < 1e-9 * np.abs(velocity).max()


def test_restored_slopes_are_never_interrupted(build):
    """A serialised state brings stiffness and slopes along, to the bit."""
    problem = grasped("carried")
    fmu = build(problem.scene)
    names = [f"tool[1].{n}" for n in FORCES]
    with Instance(fmu, values={"tool[1].active": True}) as instance, Instance(fmu) as other:
        pull(instance, 1, TIP, TIP + [0.001, 0.0, 0.003], 0.05)
        other.restore(instance.serialised(), instance.time)
        assert np.array_equal(slopes(instance, names)[1], slopes(other, names)[1])
        assert np.array_equal(stiffness(instance, 1), stiffness(other, 1))
        assert np.array_equal(stiffness(instance, 1, "staticStiffness"), stiffness(other, 1, "staticStiffness"))


def test_what_has_no_derivative_is_refused(build):
    """Other unknowns, knowns, outputs and orders: fmi2Error and one line that names them."""
    problem = grasped("refused")
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        pull(instance, 1, TIP, TIP + [0.001, 0.0, 0.003], 0.01)
        force, position = "tool[1].force.x", "tool[1].position.x"
        for unknown, known, named in [
            ("energy.elastic", position, "energy.elastic"),
            ("tool[1].meanForce.x", position, "tool[1].meanForce.x"),
            ("surface.vertex[1].x", position, "surface.vertex[1].x"),
            (force, "gravity.x", "gravity.x"),
            (force, force, force),
        ]:
            lines = len(instance.log)
            assert derivative(instance, [unknown], [known], [1.0])[0] == ERROR
            assert len(instance.log) == lines + 1 and named in instance.log[-1][2]
        assert derivative(instance, [force], [position], [np.nan])[0] == DISCARD
        for name, order in (("energy.elastic", 1), (force, 2), (force, 0)):
            lines = len(instance.log)
            assert slopes(instance, [name], order)[0] == ERROR
            assert len(instance.log) == lines + 1 and name in instance.log[-1][2]
        instance.step(0.001)
