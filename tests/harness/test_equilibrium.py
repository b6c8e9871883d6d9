"""Equilibria reached through doStep, by `reference` and by scikit-fem are the same."""

import json
import zipfile

import meshes
import numpy as np
import oracle
import pytest
from fmu import Instance, settle
from scenes import SIZE, Problem, plate, scene, slit

RATE = 1e-6


def close(a, b, tolerance=RATE):
    size = np.abs(b).max()
    worst = np.abs(np.asarray(a) - b).max()
    assert worst <= tolerance * size, f"{worst / size:.2e} of {size:.3e}"


def hanging():
    return plate("hanging")


def layered():
    problem = plate("layered", mesh=meshes.kuhn(SIZE, (8, 4, 2), jitter=0.2))
    c = meshes.centroids(*problem.mesh)
    problem.material(np.flatnonzero(c[:, 2] > 0.01), 2.4e4, 0.3, 900)
    return problem.material(np.flatnonzero(c[:, 0] > 0.07), 3e3, 0.49, 1300)


def bridge():
    """Clamped at one end, moved at the other along x and z, free to slide along y."""
    problem = plate("bridge", mesh=meshes.tensor(SIZE, (8, 3, 2)))
    return problem.prescribe(problem.face(0, SIZE[0]), [0.004, None, -0.006], ramp=0.5)


def rollers():
    """Held by the three planes through a corner, an axis each, and loaded on top."""
    problem = plate("rollers", clamp=False, mesh=meshes.delaunay(SIZE, (7, 4, 2)))
    for axis, name in enumerate("xyz"):
        problem.fix(problem.face(axis, 0.0), name)
    top = problem.face(2, SIZE[2])
    problem.load(top[::3], [0.001, 0.0, -0.004], ramp=0.3)
    return problem.load(top[:5], [0.0, 0.002, 0.001])


def block():
    problem = Problem("block", meshes.refined((0.05, 0.05, 0.05)), gravity=[2.0, -1.0, -9.81])
    problem.fix(problem.face(2, 0.0)[:-4]).fix(problem.face(2, 0.0)[-4:], "xz")
    return problem.prescribe(problem.face(2, 0.05)[:2], [None, 0.002, None], ramp=0.0)


def even_mass():
    return plate("even_mass", mesh=meshes.delaunay(SIZE, (6, 3, 2))).set(integration={"mass": "uniform"})


def slow_rate():
    problem = plate("slow_rate", cells=(6, 3, 2))
    return problem.set(integration={"hapticRate": 100, "damping": 40})


def cut_open():
    problem = plate("cut_open", gravity=[0.0, 0.0, -0.5])
    return problem.cut(slit(problem), time=0.1)


PROBLEMS = [hanging, layered, bridge, rollers, block, even_mass, slow_rate]


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda f: f.__name__)
def test_reference_equals_scikit_fem(problem, reference):
    """`reference` gives scikit-fem's displacements and reactions."""
    problem = problem()
    u, reaction = oracle.statics(problem.tissue, problem.force, problem.held, problem.value)
    found = reference(problem.scene)
    close(found["nodes"], problem.nodes, 1e-14)
    close(found["displacement"], u, 1e-8)
    assert sorted(int(k) for k in found["reaction"]) == list(np.flatnonzero(problem.held.any(axis=1)))
    close([found["reaction"][str(k)] for k in np.flatnonzero(problem.held.any(axis=1))],
          reaction[problem.held.any(axis=1)], 1e-8)
    assert found["residual"] < 1e-9
    gradient = np.einsum("tki,tkj->tij", u[problem.tetrahedra[:, 1:]] - u[problem.tetrahedra[:, :1]],
                         np.linalg.inv(problem.nodes[problem.tetrahedra[:, 1:]] - problem.nodes[problem.tetrahedra[:, :1]])
                         .transpose(0, 2, 1))
    smallest = np.linalg.det(np.eye(3) + gradient).min()
    assert found["minimumVolumeRatio"] == pytest.approx(smallest, rel=1e-6)


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda f: f.__name__)
def test_steps_reach_equilibrium(problem, build):
    """Stepping until all is still gives scikit-fem's displacements."""
    problem = problem()
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held, problem.value)
    with Instance(build(problem.scene)) as instance:
        close(settle(instance, problem.nodes), u)
        assert instance.get("diagnostics.minimumVolumeRatio") > 0


@pytest.mark.parametrize("element", ["nodalPressure", "nodalAveraged"])
@pytest.mark.parametrize("problem", [layered, rollers, cut_open], ids=lambda f: f.__name__)
def test_elements_that_share_points(problem, element, reference, build):
    """`reference` and settled tissue are where the energy of its elements, assembled from its definition, says."""
    problem = problem()
    problem.set(model={"element": element})
    problem.tissue.element = element
    removed = [t for cut in problem.scene.get("cuts", []) for t in cut["where"]["tetrahedra"]]
    tissue = problem.tissue.without(removed)
    force = tissue.weight(problem.gravity) + problem.loads
    u, reaction = oracle.statics(tissue, force, problem.held, problem.value)
    found = reference(problem.scene, "--after-cuts")
    held = np.flatnonzero(problem.held.any(axis=1))
    close(found["displacement"], u, 1e-8)
    close([found["reaction"][str(k)] for k in held], reaction[held], 1e-8)
    with Instance(build(problem.scene)) as instance:
        close(settle(instance, problem.nodes), u)
        assert instance.energies()[0] == pytest.approx(0.5 * u.ravel() @ tissue.stiffness() @ u.ravel(), rel=1e-6)


@pytest.mark.parametrize("problem", [layered, rollers, bridge], ids=lambda f: f.__name__)
def test_energies_at_equilibrium(problem, build):
    """Elastic, gravity and load energies at rest are those of scikit-fem's solution; kinetic is none."""
    problem = problem()
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held, problem.value)
    with Instance(build(problem.scene)) as instance:
        settle(instance, problem.nodes)
        elastic, kinetic, gravity, load, *_ = instance.energies()
    assert elastic == pytest.approx(0.5 * u.ravel() @ problem.tissue.stiffness() @ u.ravel(), rel=1e-6)
    assert gravity == pytest.approx(-(problem.tissue.weight(problem.gravity) * u).sum(), rel=1e-6)
    assert load == pytest.approx(-(problem.loads * u).sum(), rel=1e-6, abs=1e-15)
    assert abs(kinetic) < 1e-12 * elastic


@pytest.mark.parametrize("problem", [layered, rollers, block], ids=lambda f: f.__name__)
def test_start_at_equilibrium_stays(problem, build):
    """"start": "equilibrium" begins at scikit-fem's solution and does not move from it."""
    problem = problem()
    problem.scene["start"] = "equilibrium"
    for entry in problem.scene.get("loads", []) + problem.scene.get("prescribed", []):
        entry["ramp"] = 0.0
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held, problem.value)
    with Instance(build(problem.scene)) as instance:
        close(instance.positions() - problem.nodes, u, 1e-8)
        for _ in range(20):
            instance.step(0.01)
        close(instance.positions() - problem.nodes, u, 1e-8)


@pytest.mark.parametrize("problem", [bridge, rollers], ids=lambda f: f.__name__)
def test_start_at_equilibrium_has_no_ramps_left(problem, build):
    """"start": "equilibrium" means full prescribed values and loads before time 0: ramps are over."""
    problem = problem()
    problem.scene["start"] = "equilibrium"
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held, problem.value)
    with Instance(build(problem.scene)) as instance:
        close(instance.positions() - problem.nodes, u, 1e-8)
        for _ in range(20):
            instance.step(0.01)
        close(instance.positions() - problem.nodes, u, 1e-8)


@pytest.mark.parametrize("mesh", [
    {"box": {"size": [0.08, 0.03, 0.02], "cells": [6, 2, 2], "origin": [-0.01, 0.02, 0.3], "pattern": "five"}},
    {"box": {"size": [0.08, 0.03, 0.02], "cells": [6, 2, 2], "pattern": "kuhn"}},
    {"cylinder": {"radius": 0.02, "height": 0.06, "edgeLength": 0.012}},
    {"liver": {"edgeLength": 0.03}},
], ids=["five", "kuhn", "cylinder", "liver"])
def test_generated_meshes(mesh, build, reference):
    """Whatever mesh the product makes, its equilibrium is scikit-fem's on the mesh the FMU carries."""
    anywhere = scene("generated", mesh)
    nodes = np.array(reference(anywhere | {"fixed": [{"all": True}]})["nodes"])
    axis = 0 if "box" in mesh else 2
    end = nodes[:, axis] < nodes[:, axis].min() + 0.15 * np.ptp(nodes[:, axis])
    stiff = [anywhere["materials"][0] | {"youngModulus": 3e4}]
    anywhere |= {"fixed": [{"nodes": np.flatnonzero(end).tolist()}], "materials": stiff}
    fmu = build(anywhere)
    with zipfile.ZipFile(fmu.path) as archive:
        carried = json.loads(archive.read("resources/scene.json"))["mesh"]
    tissue = oracle.Tissue(np.array(carried["nodes"]), np.array(carried["tetrahedra"]), 3e4)
    assert meshes.volumes(tissue.nodes, tissue.tetrahedra).min() > 0
    u, _ = oracle.statics(tissue, tissue.weight([0, 0, -9.81]), np.repeat(end[:, None], 3, axis=1))
    close(reference(anywhere)["displacement"], u, 1e-8)
    with Instance(fmu) as instance:
        close(settle(instance, tissue.nodes), u)


def test_surface_vertices_name_their_nodes(build):
    """With "surface", each vertex says which node it shows, and exactly the surface is shown."""
    import geometry

    problem = plate("skin", mesh=meshes.kuhn(SIZE, (5, 4, 3)))
    problem.scene["outputs"] = {"vertices": "surface", "triangles": True}
    surface = geometry.exposed(problem.tetrahedra)
    with Instance(build(problem.scene)) as instance:
        shown = [v for v in instance.fmu.variables if v.startswith("surface.node[")]
        node = np.array(instance.get(*shown))
        assert list(node) == list(np.unique(surface))
        close(instance.positions(), problem.nodes[node], 1e-14)
        count = instance.get("surface.triangleCount")
        rows = np.array([instance.get(*(f"surface.triangle[{j + 1},{k}]" for k in (1, 2, 3))) for j in range(count)])
        turned = {tuple(np.roll(t, -np.argmin(t))) for t in node[rows]}
        assert turned == {tuple(np.roll(t, -np.argmin(t))) for t in surface}


def test_gravity_and_damping_can_be_tuned(build):
    """Gravity turned while it runs gives the equilibrium of the new gravity."""
    problem = plate("tuned")
    with Instance(build(problem.scene)) as instance:
        instance.step(0.1)
        for axis, value in zip("xyz", (3.0, -2.0, 4.0)):
            instance.set(f"gravity.{axis}", value)
        instance.set("integration.damping", 30.0)
        instance.step(0.05)
        problem.gravity = [3.0, -2.0, 4.0]
        u, _ = oracle.statics(problem.tissue, problem.force, problem.held)
        close(settle(instance, problem.nodes), u)


def test_material_parameters_take_effect(build):
    """Young's modulus, Poisson's ratio and density set before initialisation are those of the equilibrium."""
    problem = plate("materials")
    problem.material(np.arange(100), 1e4, 0.4, 1000)
    values = {"material[1].youngModulus": 9e3, "material[2].poissonRatio": 0.2, "material[2].density": 1500.0}
    with Instance(build(problem.scene), values=values) as instance:
        found = settle(instance, problem.nodes)
        instance.slave.reset()
        instance.initialise()
        again = settle(instance, problem.nodes)
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held)
    close(again, u)
    problem.tissue.young = np.where(np.arange(len(problem.tetrahedra)) < 100, 1e4, 9e3)
    problem.tissue.poisson = np.where(np.arange(len(problem.tetrahedra)) < 100, 0.2, 0.45)
    problem.tissue.density = np.where(np.arange(len(problem.tetrahedra)) < 100, 1500.0, 1060.0)
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held)
    close(found, u)


def test_a_load_ramp_is_a_ramp(build):
    """Half-way up a slow ramp the load's potential shows half the force."""
    problem = plate("ramped", gravity=[0.0, 0.0, 0.0])
    tip = problem.face(0, SIZE[0])
    problem.load(tip, [0.0, 0.0, -0.002], ramp=2.0)
    with Instance(build(problem.scene)) as instance:
        for share in (0.25, 0.5, 1.0):
            instance.step(2.0 * share - instance.time)
            moved = (instance.positions() - problem.nodes)[tip, 2].sum()
            assert instance.get("energy.load") == pytest.approx(share * 0.002 * moved, rel=1e-3)


def test_flipped_tetrahedra_and_lone_nodes(build, reference):
    """Tetrahedra numbered inside out are put right; a node without tetrahedra keeps its number and its place."""
    problem = plate("repaired")
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held)
    mesh = problem.scene["mesh"]
    for t in range(0, len(problem.tetrahedra), 7):
        mesh["tetrahedra"][t][:2] = mesh["tetrahedra"][t][1::-1]
    mesh["nodes"].insert(0, [0.5, 0.5, 0.5])
    mesh["tetrahedra"] = (np.array(mesh["tetrahedra"]) + 1).tolist()
    problem.scene["fixed"][0]["nodes"] = [i + 1 for i in problem.scene["fixed"][0]["nodes"]]
    close(reference(problem.scene)["displacement"][1:], u, 1e-8)
    rest = np.array(mesh["nodes"])
    with Instance(build(problem.scene)) as instance:
        found = settle(instance, rest)
        assert np.array_equal(found[0], np.zeros(3))
        close(found[1:], u)


def test_haptic_rate_can_be_set(build):
    """integration.hapticRate set before initialisation changes the substep, which divides its period."""
    problem = plate("rated")
    with Instance(build(problem.scene), values={"integration.hapticRate": 2000.0}) as instance:
        count = 1 / 2000 / instance.get("diagnostics.substep")
        assert count == pytest.approx(round(count), rel=1e-9) and count >= 0.999
        u, _ = oracle.statics(problem.tissue, problem.force, problem.held)
        close(settle(instance, problem.nodes), u)
