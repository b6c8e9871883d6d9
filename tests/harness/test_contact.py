"""Tools: forces against scikit-fem's reactions, the energy account, action and reaction."""

import geometry
import numpy as np
import oracle
import pytest
from fmu import ENERGIES, SIGNS, Instance, settle
from scenes import SIZE, plate, three_tools
from test_equilibrium import close

UP = (0, 1, 0, 0)
TIP = np.array([0.0875, 0.025, 0.023])


def grasped(name="grasped", **options):
    problem = plate(name, **options)
    return problem.tool("grasper", "grasper", TIP, radius=0.0045, length=0.1, orientation=UP, active=0.006)


def jaws(problem, radius=0.0045, tip=TIP, active=0.006):
    """Nodes of the exposed triangles that the closed jaws touch at rest."""
    surface = geometry.exposed(problem.tetrahedra)
    touched = geometry.segments_touched(problem.nodes, surface, tip, tip + [0, 0, active], radius,
                                        geometry.segment_triangle)
    return np.unique(surface[touched])


def pull(instance, tool, start, end, seconds, step=0.001):
    """Moves a tool on a straight line in equal steps."""
    count = round(seconds / step)
    for k in range(count):
        instance.place(tool, start + (np.asarray(end) - start) * ((k + 1) / count))
        instance.step(step)


def quaternion(axis, angle):
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])


def product(p, q):
    p, q = np.asarray(p, float), np.asarray(q, float)
    return np.array([p[0] * q[0] - p[1:] @ q[1:], *(p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:]))])


def rotated(q, x):
    matrix = np.array([product(product(q, [0, *e]), q * [1, -1, -1, -1])[1:] for e in np.eye(3)]).T
    return x @ matrix.T


@pytest.mark.parametrize("gravity", [[0.0, 0.0, 0.0], [0.0, 0.0, -9.81]], ids=["weightless", "heavy"])
def test_a_settled_grasp_pulls_with_scikit_fems_reactions(gravity, build):
    """Grasp, lift, turn and wait: displacement, force and torque are those of the same prescribed nodes."""
    problem = grasped(gravity=gravity)
    held = jaws(problem)
    assert 4 <= len(held) <= 12
    turn = quaternion([0.2, 0.3, 1.0], 0.3)
    end = TIP + [-0.002, 0.003, 0.008]
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        pull(instance, 1, TIP, end, 0.2)
        instance.place(1, end, 2.5 * product(turn, np.array([0, 1.0, 0, 0])))
        instance.step(0.1)
        u = settle(instance, problem.nodes)
        force, torque, mean = (instance.vector(f"tool[1].{n}") for n in ("force", "torque", "meanForce"))
        assert instance.get("tool[1].inContact")
    # The jaws close at the first haptic tick, before anything has moved.
    problem.held[held] = True
    problem.value[held] = end + rotated(turn, problem.nodes[held] - TIP) - problem.nodes[held]
    expected, reaction = oracle.statics(problem.tissue, problem.force, problem.held, problem.value)
    close(u, expected)
    close(force, -reaction[held].sum(axis=0))
    close(mean, force)
    arms = problem.nodes[held] + expected[held] - end
    close(torque, -np.cross(arms, reaction[held]).sum(axis=0))


def test_action_equals_reaction(build):
    """Settled: what the tool feels, the clamps' reaction by K u of the vertices read, and the weight cancel."""
    problem = grasped("balance")
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        pull(instance, 1, TIP, TIP + [0.003, -0.004, 0.01], 0.2)
        u = settle(instance, problem.nodes)
        force = instance.vector("tool[1].force")
    internal = (problem.tissue.stiffness() @ u.ravel()).reshape(-1, 3)
    weight = problem.tissue.weight(problem.gravity)
    clamps = (internal - weight)[problem.held[:, 0]].sum(axis=0)
    assert np.abs(clamps - force + weight.sum(axis=0)).max() < 1e-6 * np.abs(weight.sum(axis=0)).max()


def test_impulse_is_the_change_of_momentum(build):
    """A free block jerked by a tool: meanForce x time, summed, is minus the momentum gained, attach included."""
    problem = plate("afloat", clamp=False, gravity=[0.0, 0.0, 0.0]).set(integration={"damping": 0.0})
    problem.tool("grasper", "grasper", TIP, radius=0.0045, length=0.1, orientation=UP, active=0.006)
    mass = problem.tissue.mass()[:, None]
    with Instance(build(problem.scene)) as instance:
        instance.step(0.001)
        substep = instance.get("diagnostics.substep")
        impulse = np.zeros(3)
        instance.set("tool[1].active", True)
        for k in range(30):
            instance.place(1, TIP + np.array([0.1, 0.05, 0.2]) * 0.001 * (k + 1))
            length = 0.001 if k % 3 else 0.0015
            instance.step(length)
            impulse += instance.vector("tool[1].meanForce") * length
        before = instance.positions()
        instance.step(substep)
        impulse += instance.vector("tool[1].meanForce") * substep
        momentum = (mass * (instance.positions() - before) / substep).sum(axis=0)
    close(impulse, -momentum, 1e-9)


def test_mean_force_adds_up_over_steps(build):
    """The impulse of ten small steps is that of one large step along the same path."""
    problem = grasped("summed")
    impulses = []
    for parts in (1, 10):
        with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
            instance.step(0.001)
            total = np.zeros(3)
            for k in range(parts):
                instance.place(1, TIP + np.array([0.0, 0.0, 0.004]) * ((k + 1) / parts))
                instance.step(0.02 / parts)
                total += instance.vector("tool[1].meanForce") * 0.02 / parts
            impulses.append(total)
    close(impulses[1], impulses[0], 1e-9)


def closes(instance, start, largest, limit=0.01):
    terms = instance.energies()
    assert np.isfinite(terms).all()
    largest[:] = np.maximum(largest, np.abs(terms))
    residual = abs((terms * SIGNS).sum() - start)
    assert residual <= limit * np.abs(terms).max() + 1e-12, (instance.time, dict(zip(ENERGIES, terms)), residual)


def test_energy_closes_through_a_whole_operation(build):
    """Press, grasp, pull, cut free, let go: the account closes to 1 % of its largest term at every step."""
    problem = three_tools()
    largest = np.zeros(len(ENERGIES))
    with Instance(build(problem.scene)) as instance:
        start = (instance.energies() * SIGNS).sum()

        def go(steps, probe=None, grasper=None, cautery=None):
            ways = [(k, np.array(w[0], float), np.array(w[1], float))
                    for k, w in ((1, probe), (2, grasper), (3, cautery)) if w]
            for k in range(steps):
                for tool, here, there in ways:
                    instance.place(tool, here + (there - here) * ((k + 1) / steps))
                instance.step(0.002)
                closes(instance, start, largest)

        rest, pressed = (0.045, 0.025, 0.030), (0.045, 0.025, 0.0175)
        go(500)
        go(200, probe=(rest, pressed))
        go(800)
        under = problem.at((0.0874, 0.0249, SIZE[2]), (0.0876, 0.0251, SIZE[2]))[0]
        above = instance.positions()[under] + TIP - problem.nodes[under]
        go(20, grasper=(TIP, above))
        assert instance.get("tool[1].inContact") and np.linalg.norm(instance.vector("tool[1].force")) > 1e-3
        instance.set("tool[2].active", True)
        lifted = above + [0.0, 0.0, 0.02]
        go(100, grasper=(above, lifted))
        assert instance.get("tool[2].inContact") and instance.vector("tool[2].force")[2] < -1e-3
        instance.set("tool[3].active", True)
        go(100, probe=(pressed, rest), cautery=((0.0625, -0.02, -0.03), (0.0625, 0.07, -0.03)))
        assert instance.get("topology.removedTetrahedra") > 20 and instance.get("topology.pieces") == 2
        assert not instance.get("tool[1].inContact")
        instance.set("tool[3].active", False)
        instance.set("tool[2].active", False)
        go(100, cautery=((0.0625, 0.07, -0.03), (0.0625, 0.2, -0.03)))
        assert not instance.get("tool[2].inContact")
        assert np.array_equal(instance.vector("tool[2].force"), np.zeros(3))
    assert (largest[[0, 1, 2, 4, 5]] > 1e-7).all(), dict(zip(ENERGIES, largest))


def test_energy_closes_with_prescribed_nodes_and_ramps(build):
    """Moving supports, growing loads and a scripted cut keep the account closed."""
    problem = plate("supports")
    problem.prescribe(problem.face(0, SIZE[0]), [0.002, None, 0.005], ramp=0.2)
    problem.load(problem.face(2, SIZE[2])[::4], [0.0, 0.0, -0.003], ramp=0.15)
    problem.cut(np.arange(40, 70), 0.1)
    largest = np.zeros(len(ENERGIES))
    with Instance(build(problem.scene)) as instance:
        start = (instance.energies() * SIGNS).sum()
        for k in range(200):
            instance.step(0.002 if k % 2 else 0.00137)
            closes(instance, start, largest)
    assert largest[-1] > 1e-6 and largest[3] > 1e-6


def test_tool_work_is_force_times_way(build):
    """For a slow pull the work booked is the integral of the force read."""
    problem = grasped("work", gravity=[0.0, 0.0, 0.0])
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        instance.step(0.001)
        work, last = 0.0, instance.vector("tool[1].force")
        for k in range(400):
            instance.place(1, TIP + np.array([0.0, 0.0, 0.006]) * ((k + 1) / 400))
            instance.step(0.005)
            now = instance.vector("tool[1].force")
            work += -0.5 * (last + now)[2] * 0.006 / 400
            last = now
        booked = instance.get("energy.toolWork")
    assert booked == pytest.approx(work, rel=0.01)


def test_a_probe_only_pushes(build):
    """A pressed probe feels a force away from the tissue; withdrawn, it feels none, and the plate swings back."""
    problem = plate("pushed", gravity=[0.0, 0.0, 0.0])
    problem.fix(problem.face(0, SIZE[0]))
    start = np.array([0.05, 0.025, 0.0245])
    problem.tool("probe", "probe", start, radius=0.004)
    with Instance(build(problem.scene)) as instance:
        pull(instance, 1, start, start - [0, 0, 0.004], 0.2)
        for _ in range(100):
            instance.step(0.01)
        pressed = instance.vector("tool[1].force")
        assert pressed[2] > 1e-3
        u = instance.positions() - problem.nodes
        internal = (problem.tissue.stiffness() @ u.ravel()).reshape(-1, 3)
        touched = np.abs(internal).max(axis=1) > 1e-6 * np.abs(internal).max()
        touched &= ~problem.held[:, 0]
        close(-internal[touched].sum(axis=0), pressed, 1e-3)
        pull(instance, 1, start - [0, 0, 0.004], start + [0, 0, 0.02], 0.1)
        assert np.array_equal(instance.vector("tool[1].force"), np.zeros(3))
        assert not instance.get("tool[1].inContact")
        for _ in range(100):
            instance.step(0.01)
        close(instance.positions(), problem.nodes, 1e-6)


def test_a_scene_can_begin_inside_contact(build):
    """A tool that starts in the tissue, or moves a long way in one step, gives finite forces and a closed account."""
    problem = plate("begins_inside")
    problem.tool("probe", "probe", (0.05, 0.025, 0.019), radius=0.004)
    with Instance(build(problem.scene)) as instance:
        start = (instance.energies() * SIGNS).sum()
        largest = np.zeros(len(ENERGIES))
        for x, z in ((0.05, 0.019), (0.05, 0.016), (0.09, 0.05), (0.04, 0.018)):
            instance.place(1, (x, 0.025, z))
            for _ in range(10):
                instance.step(0.005)
                closes(instance, start, largest)
            assert np.isfinite(instance.vector("tool[1].force")).all()


def test_a_grasp_of_partly_held_nodes(build):
    """Jaws on nodes that slide on a plane, or that a support moves, take the free axes only; the account closes."""
    problem = plate("shared", gravity=[0.0, 0.0, 0.0])
    top = problem.face(2, SIZE[2])
    lifted = top[(top % 2 == 0) & (problem.nodes[top, 0] > 0)]
    problem.prescribe(lifted, [None, None, 0.002], ramp=0.05)
    free = problem.at((0.06, 0, 0), (0.1, SIZE[1], 0))
    problem.fix(free, "z")
    problem.tool("grasper", "grasper", TIP, radius=0.0045, length=0.1, orientation=UP, active=0.006)
    largest = np.zeros(len(ENERGIES))
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        start = (instance.energies() * SIGNS).sum()
        for k in range(150):
            instance.place(1, TIP + np.array([0.00005, 0.0, 0.00002]) * k)
            instance.set("tool[1].active", k < 100)
            instance.step(0.001)
            closes(instance, start, largest)
            moved = instance.positions() - problem.nodes
            assert np.abs(moved[free, 2]).max() == 0.0
        assert np.allclose(moved[lifted, 2], 0.002, atol=1e-15)


def test_two_graspers_share_tissue(build):
    """Two graspers on the same spot hold each node once; the forces of both and the clamps balance."""
    problem = grasped("pair")
    problem.tool("second", "grasper", TIP + [0.002, 0, 0], radius=0.0045, length=0.1, orientation=UP, active=0.006)
    with Instance(build(problem.scene), values={"tool[1].active": True, "tool[2].active": True}) as instance:
        for k in range(200):
            instance.place(1, TIP + np.array([0, 0, 0.00003]) * (k + 1))
            instance.place(2, TIP + [0.002, 0, 0] + np.array([0, 0, 0.00003]) * (k + 1))
            instance.step(0.001)
        u = settle(instance, problem.nodes)
        force = instance.vector("tool[1].force") + instance.vector("tool[2].force")
    internal = (problem.tissue.stiffness() @ u.ravel()).reshape(-1, 3)
    weight = problem.tissue.weight(problem.gravity)
    clamps = (internal - weight)[problem.held[:, 0]].sum(axis=0)
    assert np.abs(clamps - force + weight.sum(axis=0)).max() < 1e-6 * np.abs(weight.sum(axis=0)).max()


def test_tissue_cut_away_in_the_jaws(build):
    """Where all tissue in the jaws is removed by a scripted cut, the grasp ends and the account closes."""
    problem = grasped("snatched")
    inside = jaws(problem)
    problem.cut(np.flatnonzero(np.isin(problem.tetrahedra, inside).any(axis=1)), 0.1)
    largest = np.zeros(len(ENERGIES))
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        start = (instance.energies() * SIGNS).sum()
        for k in range(200):
            instance.place(1, TIP + np.array([0.0, 0.0, 0.00005]) * (k + 1))
            instance.step(0.001)
            closes(instance, start, largest)
            assert instance.get("tool[1].inContact") == (k < 100)
        assert np.array_equal(instance.vector("tool[1].force"), np.zeros(3))


@pytest.mark.parametrize("seed", range(6))
def test_any_motion_keeps_the_account(seed, build):
    """Tools on random walks, switched at random, with gravity and damping tuned: finite, accepted, closed."""
    random = np.random.default_rng(seed)
    scene = three_tools("random").scene
    place = [np.array(tool["position"]) for tool in scene["tools"]]
    middle = np.array([0.06, 0.025, 0.01])
    largest = np.zeros(len(ENERGIES))
    with Instance(build(scene)) as instance:
        start = (instance.energies() * SIGNS).sum()
        for _ in range(300):
            for k in range(3):
                place[k] = place[k] + random.normal(0, 0.002, 3)
                if np.linalg.norm(place[k] - middle) > 0.06:
                    place[k] = 0.9 * place[k] + 0.1 * middle
                instance.place(k + 1, place[k], (0, 1, 0, 0) + random.normal(0, 0.05, 4))
                if random.random() < 0.05:
                    instance.set(f"tool[{k + 1}].active", bool(random.random() < 0.5))
            if random.random() < 0.02:
                instance.set("gravity.z", float(random.normal(0, 5)))
            if random.random() < 0.02:
                instance.set("integration.damping", float(random.uniform(0, 60)))
            instance.step(float(random.choice([0.001, 0.002, 0.0003, 0.005])))
            closes(instance, start, largest)
            assert np.isfinite(instance.positions()).all()


@pytest.mark.parametrize("scheme", ["symplecticEuler", "centralDifference"])
@pytest.mark.parametrize("pattern", [[5e-4, 1e-4, 2.3e-3], [1e-3, 1e-4]], ids=str)
def test_uneven_steps_carry_what_tools_hold(scheme, pattern, build):
    """A grasp that moves on at once, under steps of very different lengths: what that takes comes from the tool, not
    from the scheme, so no step is refused and nothing but damping dissipates."""
    problem = plate("uneven", gravity=[0.0, 0.0, -2.0]).set(integration={"scheme": scheme, "damping": 20.0})
    start = np.array([0.09, 0.025, 0.022])
    problem.tool("grasper", "grasper", start, radius=0.006)
    with Instance(build(problem.scene), values={"tool[1].active": True}) as instance:
        for k in range(60):
            instance.place(1, start + [0, 0, 0.003 * np.sin(40 * instance.time)])
            instance.step(pattern[k % len(pattern)])
            energies = instance.energies()
            assert energies[4] > -1e-3 * np.abs(energies).max()
            assert abs(SIGNS @ energies) < 1e-11 * np.abs(energies).max()
