"""Same inputs, same bits: run again, reset, split in time, many at once."""

from concurrent.futures import ThreadPoolExecutor

import meshes
import numpy as np
import pytest
from fmu import Instance
from scenes import SIZE, plate, three_tools
from test_contact import TIP, grasped

PRESS = np.array([0.045, 0.025, 0.0245])


def operate(instance, steps=80, offset=0):
    """Press, grasp, cut: a run that goes through contact and cutting. Returns what was seen."""
    seen = []
    for k in range(offset, steps):
        instance.place(1, (0.045, 0.025, 0.030 - 0.00015 * k))
        instance.place(2, TIP + np.array([0.0, 0.0, 0.0002 * max(0, k - 20)]))
        instance.set("tool[2].active", k >= 20)
        instance.place(3, (0.0625, -0.02 + 0.0007 * k, -0.03))
        instance.set("tool[3].active", k >= 30)
        instance.step((0.001, 0.002, 0.0007)[k % 3])
        seen.append(instance.snapshot())
    return seen


def test_a_run_repeats_to_the_bit(build):
    """Two instances, and one after fmi2Reset, see the same bits at every step of an operation."""
    fmu = build(three_tools().scene)
    with Instance(fmu) as one, Instance(fmu, name="other") as two:
        first = operate(one)
        assert operate(two) == first
        assert one.get("topology.removedTetrahedra") > 10 and one.get("tool[2].inContact")
        assert one.slave.reset() == 0
        one.initialise()
        assert one.get("topology.removedTetrahedra") == 0
        assert operate(one) == first


def test_reset_restores_start_values(build):
    """After fmi2Reset inputs, parameters and outputs are those of a fresh instance."""
    fmu = build(three_tools().scene)
    with Instance(fmu) as fresh, Instance(fmu) as used:
        used.set("gravity.x", 5.0)
        used.set("integration.damping", 99.0)
        operate(used, 40)
        used.slave.reset()
        used.initialise()
        assert used.snapshot() == fresh.snapshot()


def splits():
    """Ways to spend 60 ms [ms]."""
    return {"ones": [1] * 60, "tens": [10] * 6, "mixed": [1, 10, 3, 7, 1, 1, 20, 2, 5, 10], "whole": [60]}


@pytest.mark.parametrize("split", list(splits()))
def test_constant_inputs_however_split(split, build):
    """A settling plate with resting tools has the same bits however the host splits 60 ms."""
    problem = three_tools("resting")
    problem.scene["tools"][0]["position"] = [0.045, 0.025, 0.0235]
    fmu = build(problem.scene)
    ends = []
    for parts in (splits()["ones"], splits()[split]):
        with Instance(fmu, values={"tool[2].active": True}) as instance:
            ticks = 0
            for part in parts:
                instance.time = ticks / 1000
                instance.step(part / 1000)
                ticks += part
            assert instance.get("tool[2].inContact")
            ends.append((instance.positions().tobytes(), instance.vector("tool[2].force").tobytes(),
                         instance.energies().tobytes(), instance.get("diagnostics.substeps")))
    assert ends[0] == ends[1]


@pytest.mark.parametrize("speed", [(0.05, 0.02, 0.1), (0.0, 0.0, -0.3), (-1.5, 0.0, 0.0), (0.0, -0.7, 1 / 3)], ids=str)
@pytest.mark.parametrize("split", list(splits()))
def test_straight_paths_however_split(speed, split, build):
    """A straight path told by input derivatives has the same bits however the host splits 60 ms."""
    fmu = build(grasped("towed_straight").scene)
    speed = np.array(speed)
    ends = []
    for parts in (splits()["ones"], splits()[split]):
        with Instance(fmu, values={"tool[1].active": True}) as instance:
            ticks = 0
            for part in parts:
                instance.time = ticks / 1000
                instance.place(1, TIP + speed * (ticks / 1000))
                instance.move(1, speed)
                instance.step(part / 1000)
                ticks += part
            ends.append((instance.positions().tobytes(), instance.vector("tool[1].force").tobytes(),
                         instance.energies().tobytes()))
    assert ends[0] == ends[1]


@pytest.mark.parametrize("start, speed", [(-0.03, 1.0), (-0.0156, 1.2), (-0.010728, 0.298)])
def test_a_straight_path_through_zero(start, speed, build):
    """The bits agree, too, where a coordinate of the path passes zero, and its round-off is not relative."""
    problem = plate("through_zero", mesh=shifted(-0.01), clamp=False, gravity=[0.0, 0.0, 0.0])
    problem.fix(problem.face(0, SIZE[0] - 0.01))
    problem.tool("probe", "probe", (start, 0.025, 0.0235), radius=0.004)
    fmu = build(problem.scene)
    ends = []
    for parts in ([1] * 60, [7, 3, 10, 1, 1, 8, 30], [30, 1, 1, 28], [60]):
        with Instance(fmu) as instance:
            ticks = 0
            for part in parts:
                instance.time = ticks / 1000
                instance.place(1, (start + speed * (ticks / 1000), 0.025, 0.0235))
                instance.move(1, (speed, 0.0, 0.0))
                instance.step(part / 1000)
                ticks += part
            assert np.abs(instance.positions() - problem.nodes).max() > 1e-4
            ends.append((instance.positions().tobytes(), instance.energies().tobytes()))
    assert len(set(ends)) == 1


def shifted(x):
    nodes, tetrahedra = meshes.kuhn(SIZE, (8, 4, 2))
    return nodes + [x, 0, 0], tetrahedra


def test_jittering_and_summed_times_change_no_bit(build):
    """Steps that a host computes as differences of summed times are the same steps."""
    fmu = build(plate("jitter").scene)
    ends = []
    for jitter in (False, True):
        with Instance(fmu) as instance:
            now = 0.0
            for k in range(300):
                following = now + 0.001 if jitter else (k + 1) / 1000
                instance.time = now
                instance.step(following - now if jitter else 0.001)
                now = following
            ends.append(instance.snapshot())
    assert ends[0] == ends[1]


def test_a_start_time_other_than_zero_changes_no_bit(build):
    """A run that starts at 1000 s is the same run."""
    fmu = build(plate("late").cut([3, 4, 5], 0.05).scene)
    ends = []
    for start in (0.0, 1000.0):
        with Instance(fmu, start_time=start) as instance:
            for k in range(100):
                instance.time = start + k / 1000
                instance.step(0.001)
            ends.append(instance.snapshot())
    assert ends[0] == ends[1]


def test_variable_steps_agree_with_even_ones(build):
    """Steps that are no multiples of the substep give the same motion but for the method's error."""
    fmu = build(plate("uneven").scene)
    random = np.random.default_rng(3)
    ends = []
    for uneven in (False, True):
        with Instance(fmu) as instance:
            while instance.time < 0.3 - 1e-12:
                length = min(random.uniform(1e-4, 5e-3) if uneven else 0.001, 0.3 - instance.time)
                instance.step(length)
            assert instance.time == pytest.approx(0.3)
            ends.append(instance.positions())
    rest = ends[0] - plate("uneven").nodes
    assert np.abs(ends[1] - ends[0]).max() < 0.02 * np.abs(rest).max()


def test_substep_division(build):
    """n = max(1, ceil(H / substep - 1e-6)) substeps of H / n."""
    with Instance(build(plate("division").scene)) as instance:
        nominal = instance.get("diagnostics.substep")
        total = 0
        for length in (0.001, nominal, 0.3 * nominal, 1.5 * nominal, 7.2 * nominal, 0.01):
            instance.step(length)
            count = max(1, int(np.ceil(length / nominal - 1e-6)))
            total += count
            assert instance.get("diagnostics.substeps") == total
            assert instance.get("diagnostics.substep") == pytest.approx(length / count, rel=1e-12)


def test_fifty_instances_side_by_side(build):
    """Fifty instances stepped by eight threads see what one alone sees, each with its own inputs."""
    fmu = build(three_tools().scene)

    def run(instance, k):
        instance.set("gravity.x", 0.1 * (k % 5))
        return operate(instance, 40)[-1]

    alone = []
    for k in range(5):
        with Instance(fmu) as instance:
            alone.append(run(instance, k))
    assert len(set(alone)) == 5
    many = [Instance(fmu, name=f"instance {k}") for k in range(50)]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(run, many, range(50)))
    for instance in many:
        instance.slave.freeInstance()
    assert found == [alone[k % 5] for k in range(50)]
