"""A host: one instance of an FMU with names for its variables, statuses and log lines."""

from ctypes import c_double, c_uint

import numpy as np
from fmpy import calloc, extract, free, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2LastSuccessfulTime,
)

OK, WARNING, DISCARD, ERROR = range(4)
POSE = [f"position.{a}" for a in "xyz"] + [f"orientation.{a}" for a in "wxyz"]


class Fmu:
    """An unpacked FMU."""

    def __init__(self, path, folder=None):
        self.path = str(path)
        self.description = read_model_description(self.path, validate=False)
        self.folder = extract(self.path, unzipdir=folder)
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.reference = {name: v.valueReference for name, v in self.variables.items()}
        vertices = [n for n in self.reference if n.startswith("surface.vertex[") and n.endswith(".x")]
        self.vertex_references = (c_uint * (3 * len(vertices)))(
            *(self.reference[f"surface.vertex[{j + 1}].{a}"] for j in range(len(vertices)) for a in "xyz")
        )


class Instance:
    """Instantiated and, unless `raw`, initialised; `values` are set before that."""

    def __init__(self, fmu, name="instance", raw=False, values=None, log=True, start_time=0.0):
        self.fmu = fmu
        self.log = []
        self.callbacks = fmi2CallbackFunctions()
        self.callbacks.logger = fmi2CallbackLoggerTYPE(self._logged)
        self.callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
        self.callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
        description = fmu.description
        self.slave = FMU2Slave(
            instanceName=name,
            guid=description.guid,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=str(fmu.folder),
        )
        self.slave.instantiate(callbacks=self.callbacks, loggingOn=log)
        self.start_time = start_time
        self.time = start_time
        if not raw:
            self.initialise(values)

    def _logged(self, _environment, name, status, category, message):
        self.log.append((status, category.decode(), message.decode(), name.decode()))

    def initialise(self, values=None):
        self.time = self.start_time
        self.slave.setupExperiment(startTime=self.start_time)
        for name, value in (values or {}).items():
            self.set(name, value)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.slave.freeInstance()

    def status(self, function, *arguments):
        """Of a call that may be refused."""
        try:
            return getattr(self.slave, function)(self.slave.component, *arguments)
        except FMICallException as error:
            return error.status

    def set(self, name, value):
        kind = self.fmu.variables[name].type
        getattr(self.slave, f"set{kind}")([self.fmu.reference[name]], [value])

    def try_set(self, name, value):
        """Status of fmi2SetReal."""
        return self.status("fmi2SetReal", (c_uint * 1)(self.fmu.reference[name]), 1, (c_double * 1)(value))

    def get(self, *names):
        """One variable, or a list where several are named; Reals, Integers and Booleans may be mixed."""
        values = {}
        for kind in ("Real", "Integer", "Boolean"):
            chosen = [n for n in names if self.fmu.variables[n].type == kind]
            if chosen:
                read = getattr(self.slave, f"get{kind}")([self.fmu.reference[n] for n in chosen])
                values.update(zip(chosen, read))
        return values[names[0]] if len(names) == 1 else [values[n] for n in names]

    def vector(self, name):
        return np.array(self.get(*(f"{name}.{a}" for a in "xyz")))

    def place(self, tool, position=None, orientation=None):
        """Sets the pose input of a tool, from 1."""
        if position is not None:
            self.slave.setReal([self.fmu.reference[f"tool[{tool}].{n}"] for n in POSE[:3]], list(position))
        if orientation is not None:
            self.slave.setReal([self.fmu.reference[f"tool[{tool}].{n}"] for n in POSE[3:]], list(orientation))

    def move(self, tool, velocity):
        """Sets the first derivatives of a tool's position inputs."""
        references = [self.fmu.reference[f"tool[{tool}].{n}"] for n in POSE[:3]]
        self.slave.setRealInputDerivatives(references, [1, 1, 1], list(velocity))

    def try_step(self, length):
        """Status of fmi2DoStep; time goes on where it was made."""
        status = self.status("fmi2DoStep", self.time, length, 1)
        if status <= WARNING:
            self.time += length
        return status

    def step(self, length):
        status = self.try_step(length)
        assert status == OK, (status, self.log[-3:])

    def positions(self):
        """Of the surface vertices, n x 3 [m]."""
        count = len(self.fmu.vertex_references)
        buffer = (c_double * count)()
        self.slave.fmi2GetReal(self.slave.component, self.fmu.vertex_references, count, buffer)
        return np.array(buffer).reshape(-1, 3)

    def triangles(self):
        """Exposed faces as rows of vertices, from 0."""
        rows = self.get("surface.triangleCount")
        first = self.fmu.reference["surface.triangle[1,1]"]
        return np.array(self.slave.getInteger(list(range(first, first + 3 * rows))), int).reshape(-1, 3)

    def energies(self):
        return np.array(self.get(*(f"energy.{n}" for n in ENERGIES)))

    def last_successful_time(self):
        return self.slave.getRealStatus(fmi2LastSuccessfulTime)

    def snapshot(self):
        """Everything that can be read, as bytes: equal bits or not."""
        variables = self.fmu.description.modelVariables
        parts = [self.positions().tobytes()]
        for kind, dtype in (("Real", float), ("Integer", np.int32), ("Boolean", np.int32)):
            names = [
                v.valueReference for v in variables
                if v.type == kind and not v.name.startswith("surface.vertex[") and "Stiffness" not in v.name
            ]
            parts.append(np.array(getattr(self.slave, f"get{kind}")(names), dtype).tobytes())
        return b"".join(parts)

    def serialised(self):
        state = self.slave.getFMUstate()
        data = self.slave.serializeFMUstate(state)
        self.slave.freeFMUstate(state)
        return data

    def restore(self, data, time):
        state = self.slave.deSerializeFMUstate(data)
        self.slave.setFMUstate(state)
        self.slave.freeFMUstate(state)
        self.time = time


ENERGIES = ["elastic", "kinetic", "gravity", "load", "dissipated", "toolWork", "supportWork"]
SIGNS = np.array([1, 1, 1, 1, 1, -1, -1])


def settle(instance, rest, tolerance=1e-10, window=0.25, longest=60.0):
    """Steps until the vertices have stood still for two windows [s]; returns their displacement from `rest`."""
    before = instance.positions()
    calm = 0
    for _ in range(int(longest / window)):
        instance.step(window)
        after = instance.positions()
        calm = calm + 1 if np.abs(after - before).max() <= tolerance * np.abs(after - rest).max() else 0
        if calm == 2:
            return after - rest
        before = after
    raise AssertionError("does not settle")
