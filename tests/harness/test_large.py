"""Large deformation: steps, `reference` and a Newton solver that shares no code with either agree."""

from functools import lru_cache

import meshes
import nonlinear
import numpy as np
import pytest
from fmu import WARNING, Instance, settle
from laws import kappa, lame
from nonlinear import Material
from scenes import Problem
from test_equilibrium import close

LAWS = ["stVenantKirchhoff", "stableNeoHookean"]
SIZE = (0.10, 0.02, 0.02)
CELLS = (8, 2, 2)
FIBRE = {"direction": [0.8, 0.0, 0.6], "lambda": 3e4, "mu": 6e3}
UP = (0, 1, 0, 0)


def bar(name, law, gravity=(0.0, 0.0, 0.0)):
    """Clamped at x = 0."""
    problem = Problem(name, meshes.kuhn(SIZE, CELLS, jitter=0.2), gravity=list(gravity))
    problem.set(model={"elasticity": law, "element": "constantStrain"})
    return problem.fix(problem.face(0, 0.0))


def pulled(name, law, displacement, ramp=1.0):
    problem = bar(name, law)
    return problem.prescribe(problem.face(0, SIZE[0]), displacement, ramp)


def moderate(law):
    """About 10 % of strain, pulled and bent."""
    return pulled("moderate", law, [0.008, None, -0.012])


def sideways(law):
    return pulled("sideways", law, [0.0, 0.0, -0.06])


def stretched(law):
    return pulled("stretched", law, [0.06, 0.0, 0.0])


def fibrous(law):
    problem = pulled("fibrous", law, [0.03, 0.0, -0.02])
    problem.scene["materials"][0]["fibre"] = FIBRE
    return problem


def layered(law):
    """Two materials under weight and an end load."""
    problem = bar("layered", law, gravity=[0.0, 0.0, -4.0])
    c = meshes.centroids(*problem.mesh)
    problem.material(np.flatnonzero(c[:, 2] < 0.01), 2.4e4, 0.3, 900)
    return problem.load(problem.face(0, SIZE[0]), [0.0, 0.001, 0.0], ramp=0.5)


def slit(law):
    """Cut half through while it is pulled."""
    problem = pulled("slit", law, [0.03, 0.0, -0.01])
    c = meshes.centroids(*problem.mesh)
    cut = (np.abs(c[:, 0] - 0.44 * SIZE[0]) < 0.06 * SIZE[0]) & (c[:, 2] > 0.01)
    return problem.cut(np.flatnonzero(cut), time=0.4)


def penalised(law):
    """Fibres, and a volume penalty of several bulk moduli."""
    problem = fibrous(law)
    problem.scene["model"]["incompressibility"] = 1e5
    return problem


CASES = [moderate, sideways, stretched, fibrous, penalised, layered, slit]
each_case = pytest.mark.parametrize("case", CASES, ids=lambda f: f.__name__)
each_law = pytest.mark.parametrize("law", LAWS)


def material(problem, law, tissue):
    lam, mu = lame(tissue.young, tissue.poisson)
    made = Material(law, lam, mu)
    fibre = problem.scene["materials"][0].get("fibre")
    if fibre is not None:
        made = Material(law, lam, mu, kappa(lam, mu, fibre["lambda"], fibre["mu"]), fibre["direction"])
    made.penalty = problem.scene["model"].get("incompressibility", 0.0)
    return made


@lru_cache
def solved(case, law):
    """The problem, its equilibrium and the nodes that still have tissue."""
    problem = case(law)
    cut = [t for entry in problem.scene.get("cuts", []) for t in entry["where"]["tetrahedra"]]
    left = problem.tissue.without(cut)
    weight = left.weight(problem.gravity)
    found = nonlinear.solve(left.nodes, left.tetrahedra, material(problem, law, left), problem.held,
                            problem.value, weight + problem.loads, steps=4, tolerance=1e-12)
    return problem, found, np.isin(np.arange(len(problem.nodes)), left.used)


@each_law
@each_case
def test_reference_is_newtons_answer(case, law, reference):
    """Displacement and reactions of every node, and the smallest volume ratio."""
    problem, truth, _ = solved(case, law)
    found = reference(problem.scene, *(["--after-cuts"] if "cuts" in problem.scene else []))
    close(found["displacement"], truth.displacement, 1e-8)
    held = problem.held.any(axis=1)
    close([found["reaction"][str(k)] for k in np.flatnonzero(held)], truth.reaction[held], 1e-8)
    assert found["minimumVolumeRatio"] == pytest.approx(truth.minimum_volume_ratio, rel=1e-6)
    assert found["residual"] < 1e-9


@each_law
@each_case
def test_steps_reach_newtons_answer(case, law, build):
    """Displacement of every node; elastic energy; a critical step that follows the deformation."""
    problem, truth, used = solved(case, law)
    with Instance(build(problem.scene)) as instance:
        critical = instance.get("diagnostics.criticalSubstep")
        assert instance.get("diagnostics.nonlinearFraction") == 1
        moved = settle(instance, problem.nodes)
        close(moved[used], truth.displacement[used])
        assert instance.get("energy.elastic") == pytest.approx(truth.energy, rel=1e-6)
        ratio = instance.get("diagnostics.minimumVolumeRatio")
        assert ratio == pytest.approx(truth.minimum_volume_ratio, rel=1e-5)
        assert instance.get("diagnostics.criticalSubstep") < critical
        assert instance.get("diagnostics.substep") <= instance.get("diagnostics.criticalSubstep")


@each_law
def test_a_grasper_feels_newtons_reaction(law, build):
    """Force and torque on a grasper that has pulled the end of the bar by half its length."""
    problem = bar("grasped", law)
    tip = np.array([0.10, 0.01, 0.01])
    problem.tool("grasper", "grasper", tip, radius=0.012, length=0.1, orientation=UP, active=0.002)
    way = np.array([0.03, 0.01, 0.04])
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        instance.step(0.001)
        for k in range(1000):
            instance.place(1, tip + way * (k + 1) / 1000)
            instance.step(0.001)
        moved = settle(instance, problem.nodes)
        force, torque = instance.vector("tool[1].force"), instance.vector("tool[1].torque")
    taken = np.linalg.norm(moved - way, axis=1) < 1e-12
    assert 4 < taken.sum() < 30
    held, value = problem.held.copy(), problem.value.copy()
    held[taken], value[taken] = True, way
    truth = nonlinear.solve(problem.nodes, problem.tetrahedra, material(problem, law, problem.tissue), held, value,
                            steps=4, tolerance=1e-12)
    close(moved, truth.displacement)
    reaction = -truth.reaction[taken]
    close(force, reaction.sum(axis=0))
    close(torque, np.cross(problem.nodes[taken] + way - (tip + way), reaction).sum(axis=0))


def test_start_at_equilibrium_is_newtons_answer(build):
    """"start": "equilibrium" begins there and stays."""
    problem, truth, _ = solved(layered, LAWS[1])
    with Instance(build(problem.scene | {"start": "equilibrium", "name": "settled"})) as instance:
        for _ in range(2):
            close(instance.positions() - problem.nodes, truth.displacement, 1e-8)
            instance.step(0.2)


@each_law
def test_a_threshold_leads_from_one_law_to_the_other(law, build):
    """Adaptive tissue with a tiny threshold settles where the law does, and with a huge one where the linear law does."""
    problem, truth, _ = solved(moderate, law)
    linear = nonlinear.solve(problem.nodes, problem.tetrahedra, material(problem, "linear", problem.tissue),
                             problem.held, problem.value, problem.loads, steps=1, tolerance=1e-12)
    scene = problem.scene | {"name": "adaptive"}
    scene["model"] = scene["model"] | {"nonlinearThreshold": 1e-7}
    with Instance(build(scene)) as instance:
        close(settle(instance, problem.nodes), truth.displacement)
        assert instance.get("diagnostics.nonlinearFraction") == 1
        instance.set("model.nonlinearThreshold", 1.0)
        close(settle(instance, problem.nodes), linear.displacement)
        assert instance.get("diagnostics.nonlinearFraction") == 0


def test_linear_tissue_has_no_nonlinear_share(build):
    with Instance(build(bar("plain", "linear").scene)) as instance:
        assert instance.get("diagnostics.nonlinearFraction") == 0


def test_inversion_and_shorter_substeps_are_told_of(build):
    """A node pushed out through the floor and drawn up again: a warning line each time something begins."""
    problem = bar("pushed", LAWS[1])
    problem.scene["fixed"] = []
    problem.fix(problem.face(2, 0.0))
    tip = np.array([0.05, 0.01, 0.02])
    problem.tool("needle", "grasper", tip, radius=0.0005, length=0.1, active=0.0004)
    ways = [0.012, -0.025, 0.0]
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        instance.step(0.001)
        ratios, substeps, before = [], [], 0.0
        for way in ways:
            for k in range(200):
                instance.place(1, tip + [0, 0, before + (way - before) * (k + 1) / 200])
                instance.step(0.001)
                ratios.append(instance.get("diagnostics.minimumVolumeRatio"))
                substeps.append(instance.get("diagnostics.substep"))
            before = way
        assert np.isfinite(instance.positions()).all()
        settle(instance, problem.nodes - 1.0)
        assert instance.get("diagnostics.minimumVolumeRatio") > 0.9
        warned = [line[2] for line in instance.log if line[0] == WARNING]
    ratios, substeps = np.array(ratios), np.array(substeps)
    begun = np.count_nonzero((ratios[1:] <= 0) & (ratios[:-1] > 0))
    changed = np.count_nonzero(np.diff(substeps))
    print(begun, changed, *warned, sep="\n")
    assert begun > 0 and begun == len([line for line in warned if "inside out" in line])
    assert changed > 0 and changed == len([line for line in warned if "substep" in line])
