"""Cutting: what is left behaves like a mesh that never had the rest."""

import geometry
import meshes
import numpy as np
import oracle
import pytest
from fmu import Instance, settle
from scenes import SIZE, plate, slit
from test_equilibrium import close


@pytest.mark.parametrize("mass", ["removed", "kept"])
@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_scripted_cut_reaches_the_equilibrium_of_what_is_left(mass, jitter, build, reference):
    """A plate slit at 0.2 s settles where scikit-fem puts the mesh without the slit; `reference --after-cuts` too."""
    problem = plate("slit", mesh=meshes.kuhn(SIZE, (8, 4, 2), jitter=jitter)).set(cutting={"mass": mass})
    gone = slit(problem)
    problem.cut(gone[::2], 0.2).cut(gone[1::2], 0.3)
    left = problem.tissue.without(gone)
    weight = (left if mass == "removed" else problem.tissue).weight(problem.gravity)
    u, _ = oracle.statics(left, weight, problem.held)
    close(reference(problem.scene, "--after-cuts")["displacement"], u, 1e-8)
    whole, _ = oracle.statics(problem.tissue, problem.force, problem.held)
    close(reference(problem.scene)["displacement"], whole, 1e-8)
    assert np.abs(u - whole).max() > 0.05 * np.abs(whole).max()
    with Instance(build(problem.scene)) as instance:
        instance.step(0.19)
        assert instance.get("topology.removedTetrahedra") == 0
        instance.step(0.06)
        assert instance.get("topology.removedTetrahedra") == len(gone[::2])
        close(settle(instance, problem.nodes), u)
        assert instance.get("topology.removedTetrahedra") == len(gone)
        assert instance.get("topology.pieces") == 1
        volume = meshes.volumes(problem.nodes, problem.tetrahedra[gone]).sum()
        assert instance.get("topology.removedVolume") == pytest.approx(volume, rel=1e-12)
        surface = geometry.exposed(left.tetrahedra)
        assert instance.get("surface.triangleCount") == len(surface)


def test_cut_through_makes_pieces_that_fall(build):
    """A plate cut in two is two pieces; the loose one falls as a stone does, for all the damping."""
    problem = plate("severed").set(integration={"damping": 8.0})
    problem.cut(slit(problem, share=1.0), 0.0)
    left = problem.tissue.without(slit(problem, share=1.0))
    loose = np.array([i for i in left.used if problem.nodes[i, 0] > 0.05])
    with Instance(build(problem.scene)) as instance:
        instance.step(0.001)
        assert instance.get("topology.pieces") == 2
        for _ in range(20):
            instance.step(0.01)
        share = left.mass()[loose]
        fallen = (share * (instance.positions() - problem.nodes)[loose, 2]).sum() / share.sum()
        # n substeps of symplectic Euler: g h^2 (1 + 2 + .. + n).
        t, h = instance.time, instance.get("diagnostics.substep")
        assert fallen == pytest.approx(-9.81 / 2 * t * (t + h), rel=1e-9)


def test_nodes_without_tissue_stay_where_they_were(build):
    """A vertex that loses its last tetrahedron stays at its last place, finite."""
    problem = plate("corner")
    corner = problem.at((SIZE[0], SIZE[1], SIZE[2]), SIZE)[0]
    problem.cut(np.flatnonzero((problem.tetrahedra == corner).any(axis=1)), 0.1)
    with Instance(build(problem.scene)) as instance:
        instance.step(0.1)
        there = instance.positions()[corner]
        instance.step(0.1)
        first = instance.positions()[corner]
        settle(instance, problem.nodes)
        assert np.array_equal(instance.positions()[corner], first)
        assert np.abs(first - there).max() < 1e-3


def test_cautery_burns_what_it_touches(build):
    """The tetrahedra that an active tip touches, found by an independent distance, are those that go."""
    problem = plate("burnt", gravity=[0.0, 0.0, 0.0])
    problem.tool("cautery", "cautery", (0.0625, -0.02, 0.010), radius=0.0015, length=0.1,
                 orientation=(np.sqrt(0.5), -np.sqrt(0.5), 0, 0), active=0.03)
    problem.scene["outputs"] = {"vertices": "all", "triangles": True}
    tip = np.array([0.0625, 0.021, 0.0107])
    with Instance(build(problem.scene), values={"tool[1].position.y": 0.021, "tool[1].position.z": 0.0107,
                                                "tool[1].active": True}) as instance:
        instance.step(0.001)
        left = np.arange(len(problem.tetrahedra))
        gone = geometry.segments_touched(problem.nodes, problem.tetrahedra, tip, tip - [0, 0.03, 0], 0.0015,
                                         geometry.segment_tetrahedron)
        left = np.setdiff1d(left, gone)
        assert len(gone) > 5
        assert instance.get("topology.removedTetrahedra") == len(gone)
        rows = instance.get("surface.triangleCount")
        found = np.array([instance.get(*(f"surface.triangle[{j + 1},{k}]" for k in (1, 2, 3))) for j in range(rows)])
        expected = geometry.exposed(problem.tetrahedra[left])
        assert {tuple(sorted(t)) for t in found} == {tuple(sorted(t)) for t in expected}
        instance.set("tool[1].active", False)
        instance.place(1, (0.0625, -0.2, 0.01))
        instance.step(0.001)
        for axis, value in zip("xyz", (0.0, 0.0, -9.81)):
            instance.set(f"gravity.{axis}", value)
        remains = problem.tissue.without(gone)
        u, _ = oracle.statics(remains, remains.weight([0, 0, -9.81]), problem.held)
        # What burning let go keeps no trace: retired nodes aside, all settles where scikit-fem says.
        close(settle(instance, problem.nodes)[remains.used], u[remains.used])


def test_a_cut_path_burns_its_sweep(build):
    """A cautery drawn through still tissue removes what it passes, and the account stays closed."""
    problem = plate("drawn", gravity=[0.0, 0.0, 0.0]).set(integration={"damping": 500.0})
    problem.tool("cautery", "cautery", (0.0625, -0.02, 0.010), radius=0.0015, length=0.1,
                 orientation=(np.sqrt(0.5), -np.sqrt(0.5), 0, 0), active=0.05)
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        removed = []
        for k in range(60):
            instance.place(1, (0.0625, -0.02 + 0.001 * (k + 1), 0.010))
            instance.step(0.001)
            removed.append(instance.get("topology.removedTetrahedra"))
        assert removed == sorted(removed) and removed[0] == 0
        # At each haptic tick the tip is where the step began.
        tip, tail = np.array([0.0625, 0.039, 0.010]), np.array([0.0625, -0.011, 0.010])
        gone = geometry.segments_touched(problem.nodes, problem.tetrahedra, tip, tail, 0.0015,
                                         geometry.segment_tetrahedron)
        assert removed[-1] == len(gone)
        assert instance.get("diagnostics.minimumVolumeRatio") == pytest.approx(1.0, abs=1e-6)
