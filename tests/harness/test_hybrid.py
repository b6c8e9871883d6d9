"""Pre-computed and hybrid models through the FMU are scikit-fem's monolithic solution at rest."""

import json
import zipfile

import meshes
import numpy as np
import oracle
import pytest
from fmu import SIGNS, WARNING, Instance, settle
from scenes import SIZE, plate, slit
from test_contact import TIP, UP, grasped, jaws, product, pull, quaternion, rotated
from test_equilibrium import bridge, close, layered, rollers

EXACT = 1e-8


def half(x, sign):
    return {"halfSpace": {"point": [x, 0, 0], "normal": [sign, 0, 0]}}


# Held end, free end, a block inside, and two pieces.
SPLITS = {
    "held_end": half(0.05, -1),
    "free_end": half(0.05, 1),
    "inside": {"box": {"min": [0.03, 0.01, 0], "max": [0.07, 0.04, 0.02]}},
    "pieces": {"any": [half(0.08, 1), {"box": {"min": [0.02, 0, 0], "max": [0.05, 0.03, 0.02]}}]},
}
MODELS = {name: {"kind": "hybrid", "dynamic": dynamic} for name, dynamic in SPLITS.items()}
MODELS["whole"] = {"kind": "quasiStatic"}
every = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


@every
@pytest.mark.parametrize("problem", [layered, bridge, rollers], ids=lambda f: f.__name__)
def test_statics_are_those_of_the_whole(problem, model, build):
    """Different tissues, prescribed nodes, rollers and loads on both sides: displacement and energies."""
    problem = problem()
    problem.scene["model"] = model
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held, problem.value)
    with Instance(build(problem.scene)) as instance:
        close(settle(instance, problem.nodes, tolerance=1e-13), u, EXACT)
        elastic, _, gravity, load, *_ = instance.energies()
    assert elastic == pytest.approx(0.5 * u.ravel() @ problem.tissue.stiffness() @ u.ravel(), rel=EXACT)
    assert gravity == pytest.approx(-(problem.tissue.weight(problem.gravity) * u).sum(), rel=EXACT)
    assert load == pytest.approx(-(problem.loads * u).sum(), rel=EXACT, abs=1e-15)


@pytest.mark.parametrize("element", ["nodalPressure", "nodalAveraged"])
@pytest.mark.parametrize("name", ["held_end", "whole"])
def test_elements_that_share_points(name, element, build):
    """Their statics too, each part taking means of its own, by an assembly from their energy."""
    problem = layered()
    problem.scene["model"] = MODELS[name] | {"element": element}
    problem.tissue.element = element
    if name == "held_end":
        problem.tissue.part = meshes.centroids(*problem.mesh)[:, 0] <= 0.05
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held, problem.value)
    with Instance(build(problem.scene)) as instance:
        close(settle(instance, problem.nodes, tolerance=1e-13), u, EXACT)
        elastic = instance.energies()[0]
    assert elastic == pytest.approx(0.5 * u.ravel() @ problem.tissue.stiffness() @ u.ravel(), rel=EXACT)


@every
def test_a_settled_grasp_has_scikit_fems_reactions(model, build):
    """Jaws that hold nodes of either part, pulled and turned: displacement, force, torque."""
    problem = grasped(gravity=[0.0, 0.0, 0.0])
    problem.scene["model"] = model
    held = jaws(problem)
    turn = quaternion([0.2, 0.3, 1.0], 0.3)
    end = TIP + [-0.002, 0.003, 0.008]
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        pull(instance, 1, TIP, end, 0.2)
        instance.place(1, end, product(turn, np.array([0, 1.0, 0, 0])))
        instance.step(0.1)
        u = settle(instance, problem.nodes, tolerance=1e-13)
        force, torque = (instance.vector(f"tool[1].{n}") for n in ("force", "torque"))
        energies = instance.energies()
    problem.held[held] = True
    problem.value[held] = end + rotated(turn, problem.nodes[held] - TIP) - problem.nodes[held]
    expected, reaction = oracle.statics(problem.tissue, problem.force, problem.held, problem.value)
    close(u, expected, EXACT)
    close(force, -reaction[held].sum(axis=0), EXACT)
    arms = problem.nodes[held] + expected[held] - end
    close(torque, -np.cross(arms, reaction[held]).sum(axis=0), EXACT)
    assert abs(SIGNS @ energies) < 1e-11 * np.abs(energies).max()


@pytest.mark.parametrize("name", ["held_end", "free_end", "pieces"])
def test_cut_in_the_dynamic_part(name, build):
    """After a scripted slit the rest point is scikit-fem's on what is left."""
    problem = plate("slit")
    cell = SIZE[0] / 8
    dynamic = {"box": {"min": [2.9 * cell, 0, 0], "max": [4.1 * cell, 1, 1]}}
    problem.scene["model"] = {"kind": "hybrid", "dynamic": {"any": [SPLITS[name], dynamic]}}
    removed = slit(problem)
    problem.cut(removed, time=0.1)
    u, _ = oracle.statics(problem.tissue.without(removed),
                          problem.tissue.without(removed).weight(problem.gravity), problem.held)
    with Instance(build(problem.scene)) as instance:
        close(settle(instance, problem.nodes, tolerance=1e-13), u, EXACT)
        assert instance.get("topology.removedTetrahedra") == len(removed)


def test_incomplete_connection(build):
    """Figure 4 of the papers: the parts share four nodes, elsewhere their surfaces come apart."""
    problem = plate("four_nodes")
    centre = meshes.centroids(*problem.mesh)
    dynamic = centre[:, 0] >= 0.05
    shared = np.intersect1d(problem.tetrahedra[dynamic], problem.tetrahedra[~dynamic])
    corners = [int(i) for i in shared if {*map(float, problem.nodes[i, 1:])} <= {0.0, 0.05, 0.02}][:4]
    assert len(corners) == 4 < len(shared)
    problem.scene["model"] = {"kind": "hybrid", "dynamic": SPLITS["free_end"], "connection": {"nodes": corners}}
    # The same by hand: the held part gets nodes of its own.
    copies = {int(i): len(problem.nodes) + k for k, i in enumerate(np.setdiff1d(shared, corners))}
    tetrahedra = problem.tetrahedra.copy()
    tetrahedra[~dynamic] = np.vectorize(lambda i: copies.get(int(i), int(i)))(tetrahedra[~dynamic])
    nodes = np.vstack([problem.nodes, problem.nodes[list(copies)]])
    split = oracle.Tissue(nodes, tetrahedra)
    held = np.vstack([problem.held, problem.held[list(copies)]])
    u, _ = oracle.statics(split, split.weight(problem.gravity), held)
    with Instance(build(problem.scene)) as instance:
        count = sum(n.startswith("surface.node[") for n in instance.fmu.variables)
        shown = np.array(instance.get(*(f"surface.node[{j + 1}]" for j in range(count))))
        assert count == len(nodes) and sorted(shown) == sorted([*range(len(problem.nodes)), *copies])
        found = settle(instance, problem.nodes[shown], tolerance=1e-13)
    # Of two vertices that show one node, the dynamic one comes first.
    order = [copies[i] if k and shown[k - 1] == i else int(i) for k, i in enumerate(shown)]
    close(found, u[order], EXACT)


def test_interface_modes_say_their_error(build, inspect):
    """Fewer modes, larger error; `inspect` states it, and it is the FMU's."""
    problem = plate("modes")
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held)
    stated = []
    for modes in (8, 16, 32):
        problem.scene["model"] = MODELS["free_end"] | {"interfaceModes": modes}
        with Instance(build(problem.scene)) as instance:
            found = settle(instance, problem.nodes, tolerance=1e-12)
        moving = problem.nodes[:, 0] > 0.05
        true = np.linalg.norm((found - u)[moving]) / np.linalg.norm(u[moving])
        stated.append(inspect(problem.scene)["interfaceError"])
        assert stated[-1] == pytest.approx(true, rel=0.3)
    assert stated[0] > stated[1] > stated[2] and stated[1] < 0.02


def test_first_frequency_for_both_masses(build, inspect):
    """Lumped mass forgets what moves inside the pre-computed part; Guyan's does not."""
    problem = plate("ringing", gravity=[0.0, 0.0, 0.0])
    tip = problem.face(0, SIZE[0])
    truth = np.sqrt(oracle.modes(problem.tissue, problem.held, 1)[0]) / (2 * np.pi)
    found = {}
    for mass in ("lumped", "guyan"):
        problem.scene["model"] = {"kind": "hybrid", "dynamic": half(0.075, 1), "interfaceMass": mass}
        problem.scene["integration"] = {"damping": 0.0, "scheme": "centralDifference"}
        problem.scene["loads"] = [{"where": {"nodes": [int(i) for i in tip]}, "force": [0, 0, -1e-4]}]
        with Instance(build(problem.scene)) as instance:
            step, heights = 1 / 1000, []
            for _ in range(4000):
                instance.step(step)
                heights.append(instance.positions()[tip, 2].mean())
        signal = np.array(heights) - np.mean(heights)
        spectrum = np.abs(np.fft.rfft(signal * np.hanning(len(signal)), 16 * len(signal)))
        found[mass] = np.argmax(spectrum) / (16 * len(signal) * step)
    print({mass: f / truth - 1 for mass, f in found.items()})
    assert abs(found["guyan"] / truth - 1) < 0.005
    assert found["lumped"] / truth - 1 > 0.1


def test_a_cautery_spares_pre_computed_tissue_and_says_so_once(build):
    problem = plate("spared", gravity=[0.0, 0.0, 0.0])
    problem.scene["model"] = MODELS["held_end"]
    problem.tool("cautery", "cautery", (0.0875, 0.025, -0.01), radius=0.002, length=0.1, orientation=UP, active=0.09)
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        for _ in range(50):
            instance.step(0.001)
        assert instance.get("topology.removedTetrahedra") == 0
        warned = [line for line in instance.log if "pre-computed" in line[2]]
        assert len(warned) == 1 and warned[0][0] == WARNING
        instance.place(1, (0.03, 0.025, -0.01))
        instance.step(0.2)
        assert instance.get("topology.removedTetrahedra") > 0


def test_a_step_of_a_quasi_static_fmu_is_algebraic(build):
    """One long step or many short ones: the same rest point at once."""
    problem = grasped(gravity=[0.0, 0.0, -2.0])
    problem.scene["model"] = {"kind": "quasiStatic"}
    fmu = build(problem.scene)
    results = []
    for steps in (1, 10):
        with Instance(fmu, values={"tool[1].active": True}) as instance:
            pull(instance, 1, TIP, TIP + [0, 0, 0.004], 0.1, step=0.1 / steps)
            results.append((instance.positions(), instance.vector("tool[1].force")))
    close(results[0][0], results[1][0], 1e-12)
    close(results[0][1], results[1][1], 1e-9)


def test_a_saved_state_goes_on_in_a_new_instance(build):
    problem = grasped()
    problem.scene["model"] = MODELS["pieces"]
    fmu = build(problem.scene)
    with Instance(fmu, values={"tool[1].active": True}) as instance:
        pull(instance, 1, TIP, TIP + [0, 0, 0.004], 0.05)
        data, time = instance.serialised(), instance.time
        instance.step(0.05)
        truth = instance.snapshot()
    with Instance(fmu) as other:
        other.restore(data, time)
        other.step(0.05)
        assert other.snapshot() == truth


def test_elementary_deformations_are_stored_checked_and_reused(tmp_path, command):
    """The FMU carries them; building again takes them over; another tissue does not."""
    problem = plate("stored")
    problem.tool("probe", "probe", (0.05, 0.025, 0.03))
    problem.scene["model"] = {"kind": "quasiStatic"}
    path, out = tmp_path / "stored.json", tmp_path / "stored.fmu"

    def built():
        path.write_text(json.dumps(problem.scene))
        assert command("build", path, "-o", out).returncode == 0
        with zipfile.ZipFile(out) as archive:
            return archive.read("resources/elementary.bin")

    first = built()
    problem.scene["tools"][0]["position"] = [0.06, 0.025, 0.03]
    assert built() == first
    problem.scene["materials"][0]["youngModulus"] = 7000
    assert built()[64:] != first[64:]
    # A damaged file is told of, not used.
    with zipfile.ZipFile(out) as archive:
        names = {n: archive.read(n) for n in archive.namelist()}
    bad = bytearray(names["resources/elementary.bin"])
    bad[1000] ^= 1
    names["resources/elementary.bin"] = bytes(bad)
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in names.items():
            archive.writestr(name, data)
    told = command("inspect", out)
    assert told.returncode == 1 and "elementary.bin: is damaged" in told.stderr


def test_nothing_holds_the_pre_computed_part(command, tmp_path):
    """A line that says what is wrong."""
    problem = plate("adrift", clamp=False)
    problem.scene["model"] = {"kind": "quasiStatic"}
    path = tmp_path / "adrift.json"
    path.write_text(json.dumps(problem.scene))
    told = command("build", path)
    assert told.returncode == 1 and "fixed: a pre-computed piece is not held" in told.stderr
    assert len(told.stderr.splitlines()) == 1
    problem = plate("hinged")
    problem.scene["model"] = MODELS["held_end"] | {"connection": {"nodes": [int(i) for i in problem.face(0, 0.05)[:2]]}}
    path.write_text(json.dumps(problem.scene))
    told = command("build", path)
    assert told.returncode == 1 and "model.connection.nodes: lets a pre-computed piece turn" in told.stderr


def test_a_probe_feels_tissue_that_moves_to_it(build):
    """The dynamic end is lifted; the pre-computed part, far from any tool's last look, comes up to a still probe."""
    problem = plate("late", mesh=meshes.kuhn((0.10, 0.05, 0.05), (12, 8, 8)), gravity=[0.0, 0.0, 0.0])
    problem.scene["model"] = {"kind": "hybrid", "dynamic": half(0.075, 1)}
    problem.tool("grasper", "grasper", (0.10, 0.025, 0.025), radius=0.02)
    problem.tool("probe", "probe", (0.06, 0.025, 0.066), radius=0.004)
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        for k in range(600):
            instance.place(1, (0.10, 0.025, 0.025 + 0.0002 * k))
            instance.step(0.001)
            found = instance.positions()
            inside = np.linalg.norm(found - [0.06, 0.025, 0.066], axis=1) < 0.004
            if inside.any() or instance.get("tool[2].inContact"):
                break
        # The triangles between the vertices are felt first; a vertex inside is a tick late at most.
        instance.step(0.001)
        assert k < 599 and instance.get("tool[2].inContact")


