"""The loop of haptic_device.py as two FMUs, the device's and the tissue's, under masters that know of neither.

    python examples/two_fmus.py [--seconds 4]

The device's FMU is made from haptic_device/device.c by the C compiler (CC, or cc): device, hand, coupling and tool. Two
connections: tool[1].force.z goes to tissueForce.z, toolPosition.z to tool[1].position.z. All masters here are of the
Jacobi kind: each millisecond both FMUs step at once, with what the other gave at the end of the step before. So

    at tick k the device reads x_k, and finds y_k with F(y_{k-2});   in the step to k + 1 the tissue moves to y_k

which is the Python loop with delay 1: a force that is one tick older than where one master asks one after the other.
The same is run by FMPy, by Ecos and by libcosim, and must give what the Python loop gives.

Needs fmpy, ecospy with tbb, libcosimpy, a C compiler, and the program: TISSUE_FMU, or target/release/tissue-fmu.
"""

import argparse
import ctypes
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import haptic_device
from fmpy import extract, platform, read_model_description, sharedLibraryExtension
from fmpy.fmi2 import FMU2Slave
from haptic_device import ROOT, SCENE, TICK, Loop, Tissue, close_loop

SOURCE = ROOT / "examples/haptic_device"
SEEN = [("device", "position.z"), ("device", "toolPosition.z"), ("device", "passivity"), ("tissue", "tool[1].force.z"),
        ("tissue", "energy.toolWork")]
CONNECTIONS = [("tissue", "tool[1].force.z", "device", "tissueForce.z"),
               ("device", "toolPosition.z", "tissue", "tool[1].position.z")]


def build_device(folder):
    """The device's FMU, for the platform at hand."""
    library = Path(folder) / f"haptic_device{sharedLibraryExtension}"
    # Products are not contracted into sums, so that each operation rounds as Python's does.
    line = [*shlex.split(os.environ.get("CC", "cc")), "-std=c99", "-Wall", "-Wextra", "-O2", "-ffp-contract=off", "-fPIC", "-shared",
            "-fvisibility=hidden", SOURCE / "device.c", "-o", library]
    if not shutil.which(line[0]):
        sys.exit(f"{line[0]}: is not there; must be a C compiler, or CC must name one")
    done = subprocess.run(line, capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr.strip())
    path = Path(folder) / "haptic_device.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(SOURCE / "modelDescription.xml", "modelDescription.xml")
        archive.write(library, f"binaries/{platform}/{library.name}")
        archive.write(SOURCE / "device.c", "sources/device.c")
    return path


def python(tissue, ticks):
    """No device FMU: the Python loop with delay 1. Rows of SEEN after each step."""
    rows, loop = [], Loop(delay=1)

    def watch(loop):
        # The tissue has come to y; the device is a tick further, and so is what it sends.
        rows.append([loop.x, loop.y, loop.passive(), loop.forces[-1], instance.get("energy.toolWork")])

    with Tissue(tissue) as instance:
        close_loop(loop, instance, ticks * TICK, watch)
        rows = [[*row[:1], after[1], *row[2:]] for row, after in zip(rows, rows[1:] + [[0, loop.tick()]])]
    return rows


def fmpy(fmus, ticks):
    """FMPy steps one after the other, and passes on only when both have stepped."""
    rows, slaves, reference = [], {}, {}
    with tempfile.TemporaryDirectory() as folder:
        for name, path in fmus.items():
            description = read_model_description(str(path), validate=False)
            reference[name] = {v.name: v.valueReference for v in description.modelVariables}
            slave = FMU2Slave(guid=description.guid, unzipDirectory=extract(str(path), unzipdir=f"{folder}/{name}"),
                              modelIdentifier=description.coSimulation.modelIdentifier, instanceName=name)
            slaves[name] = slave
            slave.instantiate()
            slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
            slave.exitInitializationMode()

        def read(name, variable):
            return slaves[name].getReal([reference[name][variable]])[0]

        for k in range(ticks):
            passed = [read(source, variable) for source, variable, _, _ in CONNECTIONS]
            for (_, _, sink, variable), value in zip(CONNECTIONS, passed):
                slaves[sink].setReal([reference[sink][variable]], [value])
            for slave in slaves.values():
                slave.doStep(k * TICK, TICK)
            rows.append([read(*variable) for variable in SEEN])
        for slave in slaves.values():
            slave.terminate()
            slave.freeInstance()
    return rows


def ecos(fmus, ticks):
    # Its wheel does not say where the wheel of tbb has put its library.
    for library in sorted((Path(sys.prefix) / "lib").glob("libtbb.so*"))[:1]:
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    from ecospy import EcosSimulation, EcosSimulationStructure

    structure = EcosSimulationStructure()
    for name, path in fmus.items():
        structure.add_model(name, str(path))
    for source, output, sink, inlet in CONNECTIONS:
        structure.make_real_connection(f"{source}::{output}", f"{sink}::{inlet}")
    rows = []
    with EcosSimulation(structure=structure, step_size=TICK) as simulation:
        simulation.init()
        for _ in range(ticks):
            simulation.step()
            rows.append([simulation.get_real(f"{name}::{variable}") for name, variable in SEEN])
    return rows


def libcosim(fmus, ticks):
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.WARNING)
    with tempfile.TemporaryDirectory() as folder:
        simulators = "".join(f'<Simulator name="{name}" source="{path}" stepSize="{TICK}"/>'
                             for name, path in fmus.items())
        wires = "".join(
            f'<VariableConnection><Variable simulator="{source}" name="{output}"/>'
            f'<Variable simulator="{sink}" name="{inlet}"/></VariableConnection>'
            for source, output, sink, inlet in CONNECTIONS)
        (Path(folder) / "OspSystemStructure.xml").write_text(
            '<OspSystemStructure xmlns="http://opensimulationplatform.com/MSMI/OSPSystemStructure" version="0.1">'
            f"<StartTime>0.0</StartTime><BaseStepSize>{TICK}</BaseStepSize><Algorithm>fixedStep</Algorithm>"
            f"<Simulators>{simulators}</Simulators><Connections>{wires}</Connections></OspSystemStructure>")
        execution = CosimExecution.from_osp_config_file(folder)
        observer = CosimObserver.create_last_value()
        execution.add_observer(observer)
        index = {name: execution.slave_index_from_instance_name(name) for name in fmus}
        reference = {name: {v.name: v.valueReference for v in
                            read_model_description(str(path), validate=False).modelVariables}
                     for name, path in fmus.items()}
        rows = []
        for _ in range(ticks):
            assert execution.step(), "libcosim does not step"
            rows.append([observer.last_real_values(index[name], [reference[name][variable]])[0]
                         for name, variable in SEEN])
    return rows


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=4.0)
    ticks = round(parser.parse_args(arguments).seconds / TICK)
    with tempfile.TemporaryDirectory() as folder:
        fmus = {"device": build_device(folder), "tissue": haptic_device.build(SCENE, folder)}
        expected = python(fmus["tissue"], ticks)
        result = {"force": max(row[3] for row in expected)}
        print(f"{'largest difference from the Python loop':40}" + "".join(f"{name:>17}" for _, name in SEEN))
        for name, host in (("FMPy", fmpy), ("Ecos", ecos), ("libcosim", libcosim)):
            found = host(fmus, ticks)
            off = [max(abs(row[i] - other[i]) for row, other in zip(found, expected)) for i in range(len(SEEN))]
            print(f"{name:40}" + "".join(f"{value:17.1e}" for value in off))
            result[name] = off
    return result


if __name__ == "__main__":
    main()
