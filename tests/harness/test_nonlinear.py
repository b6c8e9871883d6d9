"""The non-linear oracle itself, before it judges anything."""

import laws
import meshes
import numpy as np
import nonlinear
import oracle
import pytest
from bricks import Bricks, bricks
from nonlinear import Material

LAWS = ["linear", "stVenantKirchhoff", "stableNeoHookean"]
BOX = ((0.1, 0.02, 0.02), (4, 2, 2))


def material(law, count, seed=3):
    """Different constants and fibres in each tetrahedron."""
    random = np.random.default_rng(seed)
    a0 = random.normal(size=(count, 3))
    a0 /= np.linalg.norm(a0, axis=1, keepdims=True)
    lam, mu, kap, k = random.uniform(1, 5, (4, count))
    return Material(law, lam, mu, kap, a0, k).spread(count)


def bent(count, seed=4):
    """Deformation gradients of positive determinant, far from a rotation."""
    F = np.eye(3) + np.random.default_rng(seed).uniform(-0.45, 0.45, (count, 2, 3, 3))
    return F[laws.determinant(F).min(axis=1) > 0.05]


def complex_step(function, F):
    """d function / dF; the indices of F come last."""
    columns = []
    for axes in np.ndindex(3, 3):
        step = F.astype(complex)
        step[(..., *axes)] += 1e-30j
        columns.append(function(step).imag / 1e-30)
    rate = np.stack(columns, -1)
    return rate.reshape(rate.shape[:-1] + (3, 3))


def box(order, mesh=meshes.kuhn, jitter=0.2):
    nodes, tetrahedra = mesh(*BOX, jitter=jitter)
    return nonlinear.quadratic(nodes, tetrahedra) if order == 2 else (nodes, tetrahedra)


@pytest.mark.parametrize("law", LAWS)
def test_stress_and_tangent_are_derivatives(law):
    """P = dpsi/dF and dP/dF by complex steps, fibre and volume penalty included."""
    F = bent(40)
    some = material(law, len(F))
    stress, tangent = some.stress(F), some.tangent(F)
    assert np.abs(stress - complex_step(some.energy, F)).max() < 1e-12 * np.abs(stress).max()
    assert np.abs(tangent - complex_step(some.stress, F)).max() < 1e-12 * np.abs(tangent).max()


@pytest.mark.parametrize("law", LAWS)
def test_laws_start_as_hooke(law):
    """At F = I: no energy, no stress, and Hooke's tangent with the same lam and mu."""
    F = np.eye(3)[None, None]
    some = Material(law, 7.0, 3.0).spread(1)
    hooke = Material("linear", 7.0, 3.0).spread(1)
    assert np.abs(some.energy(F)).max() < 1e-14
    assert np.abs(some.stress(F)).max() < 1e-14
    assert np.abs(some.tangent(F) - hooke.tangent(F)).max() < 1e-14


@pytest.mark.parametrize("law", LAWS[1:])
@pytest.mark.parametrize("order", [1, 2])
def test_force_and_stiffness_are_derivatives(law, order):
    """Of the energy of a bent bar, by central differences."""
    nodes, tetrahedra = box(order)
    count = len(tetrahedra)
    some = material(law, count)
    some.penalty = 0.0 if order == 2 else some.penalty
    body = nonlinear.Body(nodes, tetrahedra, some)
    random = np.random.default_rng(5)
    u = random.uniform(-3e-4, 3e-4, nodes.shape)
    d = random.normal(size=nodes.shape)
    h = 1e-8
    force, stiffness = body.force(u), body.stiffness(u)
    slope = (body.energy(u + h * d) - body.energy(u - h * d)) / (2 * h)
    assert np.sum(force * d) == pytest.approx(slope, rel=1e-6)
    rate = (body.force(u + h * d) - body.force(u - h * d)) / (2 * h)
    assert np.abs(stiffness @ d.ravel() - rate.ravel()).max() < 1e-6 * np.abs(rate).max()
    assert np.abs(stiffness - stiffness.T).max() < 1e-13 * np.abs(stiffness).max()


def squeezed_box():
    lines = [np.array([0, 0.03, 0.1]), np.array([0, 0.015, 0.02]), np.array([0, 0.02])]
    some = Material.engineering("stableNeoHookean", 6e3, 0.499)
    return Bricks(*bricks(lines), some)


def test_bricks_forces_are_derivatives_and_fields_exact():
    """Also where points are inverted; a linear field has the law's energy, and no force inside."""
    body = squeezed_box()
    nodes, random = body.points, np.random.default_rng(5)
    u, d = random.uniform(-2e-3, 2e-3, nodes.shape), random.normal(size=nodes.shape)
    h = 1e-8
    force, stiffness = body.force(u), body.stiffness(u)
    assert body.volume_ratio(u) < 0
    slope = (body.energy(u + h * d) - body.energy(u - h * d)) / (2 * h)
    assert np.sum(force * d) == pytest.approx(slope, rel=1e-6)
    rate = (body.force(u + h * d) - body.force(u - h * d)) / (2 * h)
    assert np.abs(stiffness @ d.ravel() - rate.ravel()).max() < 1e-6 * np.abs(rate).max()
    F = np.eye(3) + random.uniform(-0.2, 0.2, (3, 3))
    u = nodes @ (F - np.eye(3)).T
    density = laws.neo_hookean_energy(F, *laws.lame(6e3, 0.499))
    assert body.energy(u) == pytest.approx(4e-5 * density, rel=1e-10)
    inner = np.all((nodes > nodes.min(axis=0)) & (nodes < nodes.max(axis=0)), axis=1)
    assert np.abs(body.force(u)[inner]).max() < 1e-12 * np.abs(body.force(u)).max()


def test_bricks_meet_tetrahedra():
    """A bar of little compressibility, bent: the same force within 2 %."""
    lines = [np.linspace(0, 0.1, 9), np.linspace(0, 0.02, 3), np.linspace(0, 0.02, 3)]
    forces = []
    for nodes, cells, element in [
        (*bricks(lines), Bricks),
        (*nonlinear.quadratic(*meshes.six((0.1, 0.02, 0.02), (16, 4, 4))), nonlinear.Body),
    ]:
        held = np.abs(nodes[:, :1]) < 1e-12
        end = np.abs(nodes[:, 0] - 0.1) < 1e-12
        some = Material.engineering("stableNeoHookean", 6e3, 0.45)
        value = np.where(end[:, None], [0, 0, -0.01], 0)
        found = nonlinear.solve(nodes, cells, some, np.tile(held | end[:, None], 3), value, element=element)
        forces.append(found.reaction[end, 2].sum())
    assert forces[0] == pytest.approx(forces[1], rel=0.02)


@pytest.mark.parametrize("law", LAWS[1:])
@pytest.mark.parametrize("order", [1, 2])
def test_forces_balance_and_ignore_rotation(law, order):
    """No net force or torque in a bent state; forces turn with the body; a rotation makes none."""
    nodes, tetrahedra = box(order)
    body = nonlinear.Body(nodes, tetrahedra, Material.engineering(law, 6e3, 0.45, kap=1e4))
    u = np.random.default_rng(6).uniform(-3e-4, 3e-4, nodes.shape)
    force = body.force(u)
    size = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * size
    assert np.abs(np.cross(nodes + u, force).sum(axis=0)).max() < 1e-13 * size
    turn, _ = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    turned = (nodes + u) @ turn.T - nodes
    assert np.abs(body.force(turned) - force @ turn.T).max() < 1e-12 * np.abs(force).max()
    assert np.abs(body.force(nodes @ turn.T - nodes)).max() < 1e-12 * np.abs(force).max()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("stretch", [1.3, 0.8])
def test_st_venant_kirchhoff_bar_in_closed_form(order, stretch):
    """nu = 0, sides free: nominal stress E s (s^2 - 1) / 2."""
    nodes, tetrahedra = box(order)
    held = np.abs(nodes) < 1e-12
    end = np.abs(nodes[:, 0] - 0.1) < 1e-12
    held[end, 0] = True
    value = np.where(end[:, None], [0.1 * (stretch - 1), 0, 0], 0)
    some = Material.engineering("stVenantKirchhoff", 6e3, 0.0)
    found = nonlinear.solve(nodes, tetrahedra, some, held, value)
    nominal = 6e3 * stretch * (stretch**2 - 1) / 2
    assert found.reaction[end, 0].sum() / 4e-4 == pytest.approx(nominal, rel=1e-8)
    assert np.abs(found.displacement - nodes * [stretch - 1, 0, 0]).max() < 1e-10
    assert found.minimum_volume_ratio == pytest.approx(stretch, rel=1e-8)


def test_neo_hookean_bar_in_closed_form():
    """Sides free: the cross-section whose lateral stress vanishes gives the nominal stress."""
    nodes, tetrahedra = box(1)
    held = np.abs(nodes) < 1e-12
    end = np.abs(nodes[:, 0] - 0.1) < 1e-12
    held[end, 0] = True
    some = Material.engineering("stableNeoHookean", 6e3, 0.45)
    found = nonlinear.solve(nodes, tetrahedra, some, held, np.where(end[:, None], [0.04, 0, 0], 0))
    side = 1 + found.displacement[nodes[:, 1] > 0.0199, 1].mean() / 0.02
    stress = some.spread(1).stress(np.diag([1.4, side, side])[None, None])[0, 0]
    assert np.abs(stress[1:, 1:]).max() < 1e-7 * stress[0, 0]
    assert found.reaction[end, 0].sum() / 4e-4 == pytest.approx(stress[0, 0], rel=1e-8)


def hanging(scale, law, mesh):
    nodes, tetrahedra = mesh
    tissue = oracle.Tissue(nodes, tetrahedra, np.linspace(4e3, 9e3, len(tetrahedra)), 0.45)
    held = np.repeat(np.abs(nodes[:, :1]) < 1e-12, 3, axis=1)
    force = tissue.weight([0, 0, -9.81 * scale])
    some = Material.engineering(law, tissue.young, tissue.poisson)
    found = nonlinear.solve(nodes, tetrahedra, some, held, force=force)
    return found, oracle.statics(tissue, force, held)


@pytest.mark.parametrize("law", LAWS)
def test_small_loads_meet_the_linear_oracle(law):
    """Displacement and reactions of a heterogeneous bar under next to none of its weight."""
    scale, rate = (1e-3, 1e-9) if law == "linear" else (1e-6, 3e-6)
    found, (u, reaction) = hanging(scale, law, box(1))
    assert np.abs(found.displacement - u).max() < rate * np.abs(u).max()
    assert np.abs(found.reaction - reaction).max() < rate * np.abs(reaction).max()


def test_what_is_cut_off_stays():
    """Tetrahedra left out, nodes without any: the linear oracle's answer on what is left."""
    nodes, tetrahedra = meshes.kuhn(*BOX)
    left = tetrahedra[meshes.centroids(nodes, tetrahedra)[:, 0] < 0.07]
    found, (u, _) = hanging(1e-3, "linear", (nodes, left))
    assert np.abs(found.displacement - u).max() < 1e-9 * np.abs(u).max()
    assert not found.displacement[nodes[:, 0] > 0.08].any()


def test_supports_carry_the_load():
    """Bent far by its own weight: the reactions balance force and torque."""
    nodes, tetrahedra = box(1)
    found, _ = hanging(1.0, "stableNeoHookean", (nodes, tetrahedra))
    weight = oracle.Tissue(nodes, tetrahedra).weight([0, 0, -9.81])
    total = found.reaction + weight
    assert found.residual < 1e-10
    assert 0 < found.minimum_volume_ratio < 1
    assert np.abs(total.sum(axis=0)).max() < 1e-9 * np.abs(weight).sum()
    arm = nodes + found.displacement
    assert np.abs(np.cross(arm, total).sum(axis=0)).max() < 1e-9 * np.abs(weight).sum()


@pytest.mark.parametrize("law", LAWS[1:])
@pytest.mark.parametrize("order", [1, 2])
def test_affine_boundary_gives_a_homogeneous_deformation(law, order):
    nodes, tetrahedra = box(order)
    size = np.array(BOX[0])
    boundary = np.any((nodes < 1e-12) | (nodes > size - 1e-12), axis=1)
    H = np.array([[0.2, 0.1, 0], [-0.05, 0.1, 0.15], [0.1, 0, -0.1]])
    held = np.repeat(boundary[:, None], 3, axis=1)
    some = Material.engineering(law, 6e3, 0.45)
    found = nonlinear.solve(nodes, tetrahedra, some, held, nodes @ H.T)
    assert np.abs(found.displacement - nodes @ H.T).max() < 1e-11
    assert found.minimum_volume_ratio == pytest.approx(np.linalg.det(np.eye(3) + H), rel=1e-9)


def test_no_state_with_inverted_tetrahedra():
    """25 times its weight in one step or in eight is the same; 30 times are refused."""
    nodes, tetrahedra = box(1)
    held = np.repeat(np.abs(nodes[:, 2:]) < 1e-12, 3, axis=1)
    problem = nodes, tetrahedra, Material.engineering("stableNeoHookean", 6e3, 0.3), held
    weight = oracle.Tissue(nodes, tetrahedra).weight([0, 0, -250.0])
    one = nonlinear.solve(*problem, force=weight)
    eight = nonlinear.solve(*problem, force=weight, steps=8)
    assert np.abs(one.displacement - eight.displacement).max() < 1e-10
    assert one.minimum_volume_ratio < 0.2
    with pytest.raises(nonlinear.NoEquilibrium):
        nonlinear.solve(*problem, force=1.2 * weight)


def test_mixed_laws_share_a_body():
    """Two halves of different laws at small strain are one linear body."""
    nodes, tetrahedra = box(1)
    laws_of = np.where(meshes.centroids(nodes, tetrahedra)[:, 0] < 0.05, *LAWS[1:])
    found, (u, _) = hanging(1e-6, laws_of, (nodes, tetrahedra))
    assert np.abs(found.displacement - u).max() < 3e-6 * np.abs(u).max()
