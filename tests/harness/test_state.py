"""fmi2GetFMUstate and its kin: restored is never interrupted, to the bit."""

import hashlib
import subprocess
import sys
from ctypes import byref, c_char, c_size_t, c_void_p
from pathlib import Path

import pytest
from fmu import OK, WARNING, Instance
from scenes import plate, three_tools
from test_determinism import operate

MOMENTS = {"start": 0, "pressed": 20, "grasped": 29, "cutting": 50, "cut": 79}


@pytest.mark.parametrize("moment", MOMENTS.values(), ids=MOMENTS)
def test_saved_and_restored_is_never_interrupted(moment, build):
    """Get, go on, set, go on again: the same bits, in contact and after cuts; serialised likewise."""
    fmu = build(three_tools().scene)
    with Instance(fmu) as instance, Instance(fmu, name="other") as other:
        operate(instance, moment)
        time, here = instance.time, instance.snapshot()
        state, data = instance.slave.getFMUstate(), instance.serialised()
        onwards = operate(instance, 80, moment)
        for _ in range(2):
            instance.slave.setFMUstate(state)
            instance.time = time
            assert instance.snapshot() == here
            assert operate(instance, 80, moment) == onwards
        instance.slave.freeFMUstate(state)
        instance.restore(data, time)
        assert instance.snapshot() == here
        assert operate(instance, 80, moment) == onwards
        operate(other, 33)
        other.restore(data, time)
        assert other.snapshot() == here
        assert other.serialised() == data
        assert operate(other, 80, moment) == onwards


@pytest.mark.parametrize("moment", ["grasped", "cut"])
def test_another_process_goes_on(moment, build, tmp_path):
    """A state serialised in contact, or after cuts, goes on in another process with the same bits."""
    fmu = build(three_tools().scene)
    offset = MOMENTS[moment]
    with Instance(fmu) as instance:
        operate(instance, offset)
        time = instance.time
        file = tmp_path / "state"
        file.write_bytes(instance.serialised())
        seen = [instance.snapshot(), *operate(instance, offset + 15, offset)]
    worker = Path(__file__).with_name("worker.py")
    done = subprocess.run([sys.executable, worker, fmu.path, file, repr(time), str(offset), str(offset + 15)],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == hashlib.sha256(b"".join(seen)).hexdigest()


def test_a_state_survives_reset(build):
    """A saved state can be set again after fmi2Reset."""
    fmu = build(three_tools().scene)
    with Instance(fmu) as instance:
        operate(instance, 60)
        time, here = instance.time, instance.snapshot()
        state = instance.slave.getFMUstate()
        instance.slave.reset()
        instance.initialise()
        instance.slave.setFMUstate(state)
        instance.time = time
        assert instance.snapshot() == here
        instance.slave.freeFMUstate(state)
        assert operate(instance, 65, 60)


def test_inputs_and_parameters_are_part_of_the_state(build):
    """Tuned parameters and inputs that wait for the next step come back with the state."""
    fmu = build(three_tools().scene)
    with Instance(fmu) as instance:
        instance.step(0.01)
        instance.set("gravity.x", 2.0)
        instance.set("integration.damping", 44.0)
        instance.place(1, (0.045, 0.025, 0.022))
        data, time = instance.serialised(), instance.time
        instance.step(0.01)
        onwards = instance.snapshot()
        instance.set("gravity.x", -1.0)
        instance.place(1, (0.0, 0.0, 1.0))
        instance.step(0.01)
        instance.restore(data, time)
        assert instance.get("gravity.x", "integration.damping", "tool[1].position.z") == [2.0, 44.0, 0.022]
        instance.step(0.01)
        assert instance.snapshot() == onwards


def test_a_state_with_changed_materials_moves_on(build):
    """A state of an instance with changed materials goes on in another that was given the same ones."""
    fmu = build(three_tools().scene)
    values = {"material[1].youngModulus": 7000.0, "integration.hapticRate": 500.0}
    with Instance(fmu, values=values) as instance, Instance(fmu, values=values) as other:
        operate(instance, 50)
        data, time = instance.serialised(), instance.time
        onwards = operate(instance, 60, 50)
        other.restore(data, time)
        assert operate(other, 60, 50) == onwards


def refused(instance, data):
    state = c_void_p()
    buffer = (c_char * max(len(data), 1)).from_buffer_copy(data or b"\0")
    status = instance.status("fmi2DeSerializeFMUstate", buffer, c_size_t(len(data)), byref(state))
    return status > WARNING and not state.value


def test_damaged_bytes_are_refused(build):
    """Cut short, altered, empty or of another model: an error and a log line, and the instance goes on as it was."""
    fmu, stranger = build(three_tools().scene), build(plate("stranger").scene)
    with Instance(fmu) as instance, Instance(stranger) as other:
        operate(instance, 60)
        data, here = instance.serialised(), instance.snapshot()
        assert len(data) > 1000
        damaged = [b"", data[:7], data[: len(data) // 2], data[:-1], data + b"x", b"\xff" * len(data), b"\0" * len(data)]
        for at in range(0, len(data), max(1, len(data) // 60)):
            damaged.append(data[:at] + bytes([data[at] ^ 0x40]) + data[at + 1 :])
        for bad in damaged:
            lines = len(instance.log)
            assert refused(instance, bad)
            assert len(instance.log) > lines
        assert refused(other, data)
        assert instance.snapshot() == here
        assert instance.try_step(0.001) == OK
