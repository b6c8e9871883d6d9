"""What hosts do: odd folders, bad values, failed steps, many lives, three simulators."""

import math
import os
import subprocess
import sys
from ctypes import c_double, c_uint

import numpy as np
import oracle
import pytest
from fmpy import simulate_fmu
from fmu import DISCARD, ERROR, OK, WARNING, Fmu, Instance
from scenes import plate, three_tools
from test_contact import TIP, grasped


@pytest.mark.parametrize("folder", ["with space", "Umläute ßé 肝", "100%25 20%", "a+b#c?d&e=f", "it's {1} $HOME"])
def test_odd_folders(folder, build, tmp_path):
    """The FMU opens and steps wherever it is unpacked."""
    fmu = Fmu(build(plate("anywhere", cells=(3, 2, 1)).scene).path, folder=str(tmp_path / folder))
    with Instance(fmu) as instance:
        instance.step(0.01)


def test_damaged_resources_are_refused(build, tmp_path):
    """With damaged resources fmi2Instantiate gives nothing."""
    fmu = Fmu(build(plate("bare", cells=(2, 1, 1)).scene).path, folder=str(tmp_path / "bare"))
    for file in (tmp_path / "bare/resources").iterdir():
        file.write_bytes(file.read_bytes()[:10])
    with pytest.raises(Exception, match="instantiate"):
        Instance(fmu)


def test_a_wrong_guid_is_refused(build):
    """fmi2Instantiate compares the GUID."""
    import copy

    fmu = copy.copy(build(plate("guid", cells=(2, 1, 1)).scene))
    fmu.description = copy.copy(fmu.description)
    fmu.description.guid = "00000000-0000-0000-0000-000000000000"
    with pytest.raises(Exception, match="instantiate"):
        Instance(fmu)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_inputs_that_are_no_numbers_are_discarded(value, build):
    """NaN and infinity on an input or parameter: fmi2Discard, a log line, the old value, and life goes on."""
    with Instance(build(three_tools().scene)) as instance:
        instance.step(0.01)
        for name in ("tool[1].position.x", "tool[2].orientation.w", "gravity.y", "integration.damping"):
            before, lines = instance.get(name), len(instance.log)
            assert instance.try_set(name, value) == DISCARD
            assert instance.get(name) == before
            status, category, message, _ = instance.log[lines]
            assert status == DISCARD and category == "logStatusDiscard" and "%" not in message
            assert name.split(".")[0] in message
        instance.step(0.01)
        assert np.isfinite(instance.positions()).all()


def test_values_out_of_range_are_refused(build):
    """A negative damping or an impossible material is not taken, and the old value stays."""
    with Instance(build(plate("ranges").scene), raw=True) as instance:
        instance.slave.setupExperiment()
        for name, value in (("integration.damping", -1.0), ("material[1].youngModulus", 0.0),
                            ("material[1].poissonRatio", 0.5), ("material[1].density", -3.0),
                            ("integration.hapticRate", 0.0)):
            before = instance.get(name)
            assert instance.try_set(name, value) > WARNING, name
            assert instance.get(name) == before, name
        instance.slave.enterInitializationMode()
        instance.slave.exitInitializationMode()
        instance.step(0.01)


def test_unknown_references_are_errors(build):
    """Reading or setting what does not exist is fmi2Error, and setting an output is refused."""
    with Instance(build(three_tools().scene)) as instance:
        one, value = (c_uint * 1)(999_999_999), (c_double * 1)(1.0)
        assert instance.status("fmi2GetReal", one, 1, value) == ERROR
        assert instance.status("fmi2SetReal", one, 1, value) == ERROR
        force = (c_uint * 1)(instance.fmu.reference["tool[1].force.x"])
        assert instance.status("fmi2SetReal", force, 1, value) >= DISCARD
        assert instance.try_step(0.001) == OK or instance.slave.reset() == 0


def test_a_zero_quaternion_is_refused_at_the_step(build):
    """Zero set component by component is taken, refused by doStep, and can be put right."""
    with Instance(build(three_tools().scene)) as instance:
        instance.step(0.01)
        before = instance.positions()
        for axis in "wxyz":
            assert instance.try_set(f"tool[2].orientation.{axis}", 0.0) == OK
        assert instance.try_step(0.001) == DISCARD
        assert any("orientation" in message for _, _, message, _ in instance.log)
        assert np.array_equal(instance.positions(), before)
        assert instance.last_successful_time() == pytest.approx(instance.time, abs=1e-15)
        instance.place(2, orientation=(0, 2.0, 0, 0))
        instance.step(0.001)


def test_calls_out_of_order_are_errors(build):
    """Stepping before initialisation, or initialising twice, is fmi2Error with a log line; fmi2Reset heals."""
    with Instance(build(plate("order", cells=(2, 1, 1)).scene), raw=True) as instance:
        assert instance.try_step(0.001) == ERROR
        assert instance.status("fmi2ExitInitializationMode") == ERROR
        assert any(category == "logStatusError" for _, category, _, _ in instance.log)
        instance.slave.reset()
        instance.initialise()
        assert instance.status("fmi2EnterInitializationMode") == ERROR
        instance.slave.reset()
        instance.initialise()
        instance.step(0.001)
        assert instance.status("fmi2Terminate") == OK
        assert instance.try_step(0.001) == ERROR


@pytest.mark.parametrize("length", [0.0, -0.001, 1e300, math.nan, math.inf])
def test_steps_of_no_length_are_refused(length, build):
    """A step that is not positive and finite is refused and changes nothing."""
    with Instance(build(plate("lengths").scene)) as instance:
        instance.step(0.01)
        before = instance.snapshot()
        assert instance.try_step(length) > WARNING
        assert instance.snapshot() == before


def unstable(times_critical, inspect, **options):
    problem = plate("unstable", **options)
    step = times_critical * inspect(problem.scene)["criticalStep"]["symplecticEuler"]
    return problem.set(integration={"substep": step, "hapticRate": 1 / step, "damping": 5.0}), step


@pytest.mark.parametrize("times_critical", [1.2, 3.0])
def test_a_step_too_long_is_tried_again_shorter(times_critical, build, inspect):
    """Past the critical step the retry succeeds, says so, and the equilibrium is still the right one to 1e-6."""
    problem, step = unstable(times_critical, inspect)
    u, _ = oracle.statics(problem.tissue, problem.force, problem.held)
    with Instance(build(problem.scene)) as instance:
        statuses = set()
        for _ in range(int(8.0 / step)):
            statuses.add(instance.try_step(step))
            found = instance.positions() - problem.nodes
            assert np.abs(found).max() < 3 * np.abs(u).max()
        assert statuses <= {OK, WARNING}
        assert np.abs(found - u).max() < 1e-6 * np.abs(u).max()
        assert [line for line in instance.log if line[0] == WARNING or line[1] == "logStatusWarning"]


def test_a_hopeless_step_is_discarded(build, inspect):
    """Far past the critical step doStep gives fmi2Discard, the state of its start, and its time; never NaN."""
    problem, step = unstable(60.0, inspect)
    with Instance(build(problem.scene)) as instance:
        for _ in range(4000):
            before, time = instance.snapshot(), instance.time
            status = instance.try_step(step)
            assert np.isfinite(instance.positions()).all() and np.isfinite(instance.energies()).all()
            if status > WARNING:
                break
        assert status == DISCARD
        assert instance.snapshot() == before
        assert instance.last_successful_time() == pytest.approx(time, abs=1e-12)
        u, _ = oracle.statics(problem.tissue, problem.force, problem.held)
        assert np.abs(instance.positions() - problem.nodes).max() < 10 * np.abs(u).max()
        lines = [line for line in instance.log if line[0] == DISCARD]
        assert lines and "substep" in lines[-1][2]
        # The host may try again with less.
        assert instance.try_step(step / 60) <= WARNING


def test_log_lines_arrive_with_categories(build):
    """Lines carry the instance's name, a declared category and no placeholder."""
    problem = plate("talks").cut([1, 2, 3], 0.01)
    with Instance(build(problem.scene), name="left liver") as instance:
        instance.slave.setDebugLogging(True, ["logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError"])
        instance.step(0.1)
        instance.try_set("gravity.x", math.nan)
        declared = {c for c in ("logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")}
        assert {category for _, category, _, _ in instance.log} <= declared
        assert {name for *_, name in instance.log} == {"left liver"}
        assert any(category == "logStatusDiscard" for _, category, _, _ in instance.log)
        assert all("%" not in message and "{}" not in message for _, _, message, _ in instance.log)


def test_log_lines_of_a_category_can_be_switched_off(build):
    """Only the categories asked for arrive; all switched off, none."""
    with Instance(build(plate("quiet", cells=(2, 1, 1)).scene), log=False) as instance:
        instance.step(0.001)
        assert instance.log == []
        instance.slave.setDebugLogging(False, [])
        instance.try_set("gravity.x", math.nan)
        assert instance.log == []
        instance.slave.setDebugLogging(True, ["logStatusError"])
        instance.try_set("gravity.x", math.nan)
        assert instance.log == []
        instance.slave.setDebugLogging(True, ["logStatusDiscard"])
        instance.try_set("gravity.x", math.nan)
        assert len(instance.log) == 1


def memory():
    """Resident set [bytes]."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_three_hundred_lives_leave_no_trace(build):
    """Instantiate, step, save, free, three hundred times: memory and threads do not grow."""
    fmu = build(three_tools("lives").scene)

    def live(count):
        for _ in range(count):
            with Instance(fmu) as instance:
                instance.set("tool[2].active", True)
                instance.step(0.002)
                instance.serialised()

    keep = Instance(fmu)  # The library stays loaded.
    live(50)
    before, threads = memory(), len(os.listdir("/proc/self/task"))
    live(250)
    grown = memory() - before
    keep.slave.freeInstance()
    assert grown < 4e6, f"{grown / 250:.0f} bytes a life"
    assert len(os.listdir("/proc/self/task")) == threads


def test_simulate_fmu_with_inputs(build):
    """FMPy's own loop, with an input table and chosen outputs, lifts a grasped plate as our own does."""
    problem = grasped("simulated")
    fmu = build(problem.scene)
    times = np.linspace(0, 0.3, 301)
    height = TIP[2] + 0.02 * times
    inputs = np.array(list(zip(times, height, times >= 0)),
                      dtype=[("time", float), ("tool[1].position.z", float), ("tool[1].active", bool)])
    output = ["tool[1].force.z", "energy.elastic", "surface.vertex[1].z", "tool[1].inContact"]
    result = simulate_fmu(fmu.path, stop_time=0.3, step_size=1e-3, output_interval=1e-3, input=inputs, output=output,
                          start_values={"tool[1].position.z": TIP[2], "tool[1].active": True})
    assert list(result.dtype.names) == ["time", *output]
    assert len(result) == 301 and result["tool[1].inContact"][1:].all()
    with Instance(fmu, values={"tool[1].active": True}) as instance:
        for k in range(300):
            instance.place(1, (TIP[0], TIP[1], height[k]))
            instance.step(0.001)
        assert instance.get("tool[1].force.z") == pytest.approx(result["tool[1].force.z"][-1], rel=0.02)


ECOS = """
import sys
from ecospy import EcosSimulation, EcosSimulationStructure
structure = EcosSimulationStructure()
structure.add_model("tissue", sys.argv[1])
with EcosSimulation(structure=structure, step_size=1e-3) as simulation:
    simulation.init()
    simulation.step(200)
    print("value", simulation.get_real("tissue::energy.gravity"))
"""

COSIM = """
import sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave
execution = CosimExecution.from_step_size(1_000_000)
slave = execution.add_local_slave(CosimLocalSlave(fmu_path=sys.argv[1], instance_name="tissue"))
observer = CosimObserver.create_last_value()
execution.add_observer(observer)
assert execution.step(200)
print("value", observer.last_real_values(slave, [int(sys.argv[2])])[0])
"""


@pytest.mark.parametrize("host", [ECOS, COSIM], ids=["ecos", "libcosim"])
def test_other_hosts(host, build):
    """Ecos and libcosim run the FMU and read what FMPy reads."""
    fmu = build(plate("hosted").scene)
    with Instance(fmu) as instance:
        for _ in range(200):
            instance.step(0.001)
        expected = instance.get("energy.gravity")
    libraries = os.path.join(sys.prefix, "lib")
    environment = os.environ | {"LD_LIBRARY_PATH": libraries + ":" + os.environ.get("LD_LIBRARY_PATH", "")}
    done = subprocess.run([sys.executable, "-c", host, fmu.path, str(fmu.reference["energy.gravity"])],
                          capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    line = [x for x in done.stdout.splitlines() if x.startswith("value ")][-1]
    assert float(line.split()[1]) == pytest.approx(expected, rel=1e-9)
