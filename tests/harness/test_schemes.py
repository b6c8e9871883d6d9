"""Every integrator and the springs through the FMU, against exact modal motion and a network of their own."""

import itertools

import meshes
import numpy as np
import oracle
import pytest
from fmu import Instance, settle
from scenes import SIZE, plate
from test_equilibrium import close
from test_motion import recorded, worst

SCHEMES = ["symplecticEuler", "centralDifference", "euler", "rungeKutta4", "implicitEuler"]
# Largest error over half a second of free vibration, at 4 substeps a millisecond (explicit Euler: 100).
ERROR = {"symplecticEuler": 3e-3, "centralDifference": 1e-5, "euler": 1e-5, "rungeKutta4": 1e-8, "implicitEuler": 1e-2}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_each_scheme_swings_like_the_exact_solution(scheme, build):
    """Released from its sag when gravity is switched off: the error is that of the scheme's order."""
    problem = plate("swing", cells=(5, 2, 1)).set(start="equilibrium")
    # Explicit Euler needs the damping to be stable at all.
    damping, substep = (300.0, 1e-5) if scheme == "euler" else (3.0, 2.5e-4)
    problem.set(integration={"scheme": scheme, "damping": damping, "substep": substep})
    sag, _ = oracle.statics(problem.tissue, problem.force, problem.held)
    times = np.arange(0, 0.5001, 0.01)
    exact = oracle.modal_history(problem.tissue, damping, np.zeros(sag.shape), problem.held, sag, times)
    with Instance(build(problem.scene)) as instance:
        instance.set("gravity.z", 0.0)
        found = worst(recorded(instance, problem, times), exact)
    print(scheme, found)
    assert found < ERROR[scheme]


@pytest.mark.parametrize("model", [{"kind": "tensorMass"}, {"kind": "hybrid", "dynamic": {
    "halfSpace": {"point": [0.05, 0, 0], "normal": [1, 0, 0]}}}], ids=["whole", "hybrid"])
@pytest.mark.parametrize("scheme", ["centralDifference", "rungeKutta4", "implicitEuler"])
def test_each_scheme_settles_where_scikit_fem_says(scheme, model, build):
    problem = plate("rest").set(model=model, integration={"scheme": scheme, "damping": 40.0})
    problem.load(problem.face(0, SIZE[0]), [0.0, 0.002, 0.003], ramp=0.2)
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held)
    with Instance(build(problem.scene)) as instance:
        close(settle(instance, problem.nodes, tolerance=1e-11), u, 1e-8)


def test_stiff_tissue_runs_by_default(build, inspect):
    """E of 100 MPa: no scheme named, none of the substeps refused, the right place in the end."""
    problem = plate("stiff", gravity=[0.0, 0.0, -9.81])
    problem.tissue.young = np.full(len(problem.tetrahedra), 1e8)
    problem.scene["materials"][0]["youngModulus"] = 1e8
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held)
    assert inspect(problem.scene)["scheme"] == "implicitEuler"
    with Instance(build(problem.scene)) as instance:
        close(settle(instance, problem.nodes, tolerance=1e-9), u, 1e-6)


def springs(problem):
    """Edges, rest lengths and Van Gelder's stiffness sum E V / l^2."""
    known = {}
    volume = meshes.volumes(*problem.mesh)
    for t, corners in enumerate(problem.tetrahedra):
        for edge in itertools.combinations(sorted(int(v) for v in corners), 2):
            length = np.linalg.norm(problem.nodes[edge[0]] - problem.nodes[edge[1]])
            known[edge] = known.get(edge, 0.0) + problem.tissue.young[t] * volume[t] / length**2
    edges = np.array(list(known))
    rest = np.linalg.norm(problem.nodes[edges[:, 0]] - problem.nodes[edges[:, 1]], axis=1)
    return edges, rest, np.array(list(known.values()))


@pytest.mark.parametrize("scheme", ["symplecticEuler", "rungeKutta4"])
def test_springs_balance_in_a_network_of_our_own(scheme, build):
    """Settled under gravity and a large pull: every free node is in balance, and the energy is the springs'."""
    problem = plate("springs").set(model={"kind": "springMass"}, integration={"scheme": scheme})
    problem.material(np.arange(60), 2.4e4, 0.3, 900)
    problem.prescribe(problem.face(0, SIZE[0]), [0.02, 0.005, 0.0])
    edges, rest, stiffness = springs(problem)
    with Instance(build(problem.scene)) as instance:
        at = problem.nodes + settle(instance, problem.nodes, tolerance=1e-12)
        elastic = instance.energies()[0]
    span = at[edges[:, 1]] - at[edges[:, 0]]
    length = np.linalg.norm(span, axis=1)
    pull = (stiffness * (length - rest) / length)[:, None] * span
    force = problem.force.copy()
    np.add.at(force, edges[:, 0], pull)
    np.add.at(force, edges[:, 1], -pull)
    assert np.abs(force[~problem.held]).max() < 1e-8 * np.abs(pull).max()
    assert elastic == pytest.approx(0.5 * (stiffness * (length - rest) ** 2).sum(), rel=1e-8)
