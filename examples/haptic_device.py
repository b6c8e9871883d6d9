"""A haptic device with one degree of freedom presses on the tissue of an FMU, in a loop closed at 1 kHz.

    python examples/haptic_device.py [--seconds 4] [--stiffness 300] [--damping 0.05] [--delay 0]

The device and the hand that holds it, along the world's z; f, held from tick to tick, is what the coupling pulls with:

    (m + m_h) x'' = -f - b x' - c sgn(x') + k_h (p - x) + b_h (p' - x')

p is the path that the hand intends. Ten implicit midpoint steps a tick, whose energy balance is exact. The coupling and
the tool that it leads, at each tick, F being the tissue's force on the tool:

    e = x - y,   f = K e + B (e - e_last) / T,   m_t (v - v_last) / T = f + F,   v = (y - y_last) / T

A tick reads x, solves for y and f, steps the FMU to y, and holds f. F is that of the tick before (delay 0); with delay 1
it is one tick older, as where a master steps device and tissue side by side: there it is the pose that comes a tick later,
which is the same to the loop.

The sampled loop gives no hand energy where b > K T / 2 + |B| (Colgate and Brown, of a wall behind the coupling); how near that
is with tissue behind it, co_design.py measures.

Needs fmpy, and the program: TISSUE_FMU, or target/release/tissue-fmu.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from ctypes import c_double, c_uint
from dataclasses import dataclass
from pathlib import Path

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "examples/soft_block.json"
TICK = 1e-3  # s
SUBSTEPS = 10  # of the device, a tick
START = 0.042  # m: the ball hangs 2 mm above the block


@dataclass
class Device:
    mass: float = 0.06  # kg
    damping: float = 0.3  # N s/m
    friction: float = 0.0  # N


@dataclass
class Hand:
    mass: float = 0.1  # kg
    stiffness: float = 300.0  # N/m
    damping: float = 3.0  # N s/m
    start: float = START  # m
    low: float = 0.034  # m
    high: float = 0.041  # m
    period: float = 1.0  # s
    rest: float = float("inf")  # s: from then on the path stays where it is
    release: float = float("inf")  # s: from then on there is no hand

    def path(self, time):
        """Where the hand wants to be: from `start` to `low`, then strokes between `low` and `high`."""
        stroke = 2.0 * min(time, self.rest) / self.period
        whole = int(stroke)
        u = stroke - whole
        smooth = u * u * (3.0 - 2.0 * u)
        top = self.start if whole == 0 else self.high
        return top + (self.low - top) * (smooth if whole % 2 == 0 else 1.0 - smooth)


@dataclass
class Coupling:
    stiffness: float = 300.0  # N/m
    damping: float = 0.05  # N s/m
    mass: float = 0.01  # kg, of the tool


class Tissue:
    """An instance of the FMU, one axis of one tool; forces [N] are those of the tissue on the tool."""

    ENERGIES = ["elastic", "kinetic", "gravity", "load", "dissipated", "toolWork", "supportWork"]

    def __init__(self, path, tool=1, axis="z"):
        description = read_model_description(str(path), validate=False)
        self.folder = tempfile.mkdtemp()
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        self.fmu = FMU2Slave(guid=description.guid, unzipDirectory=extract(str(path), unzipdir=self.folder),
                             modelIdentifier=description.coSimulation.modelIdentifier, instanceName="tissue")
        self.fmu.instantiate()
        self.position = self.references(f"tool[{tool}].position.{axis}")
        self.forces = self.references(f"tool[{tool}].force.{axis}", f"tool[{tool}].meanForce.{axis}")
        row = "xyz".index(axis) + 1
        self.slope = self.references(f"tool[{tool}].stiffness[{row},{row}]")
        self.held = [self.reference[f"tool[{tool}].inContact"]]
        self.set, self.two, self.one = (c_double * 1)(), (c_double * 2)(), (c_double * 1)()
        self.begin()

    def references(self, *names):
        return (c_uint * len(names))(*(self.reference[n] for n in names))

    def begin(self):
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.time = 0.0

    def reset(self):
        self.fmu.reset()
        self.begin()

    def step(self, y, length=TICK):
        """Moves the tool to y; the force at the end of the step, and its mean over it."""
        fmu = self.fmu
        self.set[0] = y
        fmu.fmi2SetReal(fmu.component, self.position, 1, self.set)
        fmu.fmi2DoStep(fmu.component, self.time, length, 1)
        self.time += length
        fmu.fmi2GetReal(fmu.component, self.forces, 2, self.two)
        return self.two[0], self.two[1]

    def stiffness(self):
        """d force / d y of the next step [N/m]: below 0 in contact, 0 out of it."""
        self.fmu.fmi2GetReal(self.fmu.component, self.slope, 1, self.one)
        return self.one[0]

    def in_contact(self):
        return bool(self.fmu.getBoolean(self.held)[0])

    def get(self, *names):
        values = self.fmu.getReal([self.reference[n] for n in names])
        return values[0] if len(names) == 1 else values

    def save(self):
        return self.fmu.getFMUstate(), self.time

    def restore(self, saved):
        self.fmu.setFMUstate(saved[0])
        self.time = saved[1]

    def energies(self):
        return dict(zip(self.ENERGIES, self.get(*(f"energy.{n}" for n in self.ENERGIES))))

    def close(self):
        self.fmu.terminate()
        self.fmu.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


class Loop:
    """Device, hand and coupling. `tick` gives the tool's position; `move` goes on to the next tick. Energies in J."""

    def __init__(self, device=None, hand=None, coupling=None, delay=0):
        self.device, self.hand, self.coupling = device or Device(), hand or Hand(), coupling or Coupling()
        self.delay = delay
        self.k = 0
        self.v = 0.0
        self.x = self.y = self.y_last = self.hand.start
        self.stretch = 0.0
        self.pull = 0.0
        self.forces = [0.0] * (delay + 1)  # of late, the oldest first
        self.path_work = self.hand_heat = self.device_heat = 0.0
        self.coupling_work = self.coupling_heat = self.tool_work = 0.0

    def tick(self):
        """Where the tool goes from here, and what the coupling pulls with until the next tick."""
        stiffness, rate = self.coupling.stiffness, self.coupling.damping / TICK
        inertia = self.coupling.mass / (TICK * TICK)
        apart = self.x - self.y
        push = inertia * (self.y - self.y_last) + stiffness * apart + rate * (apart - self.stretch) + self.forces[0]
        y = self.y + push / (inertia + stiffness + rate)
        stretch = self.x - y
        self.pull = stiffness * stretch + rate * (stretch - self.stretch)
        self.coupling_heat += rate * (stretch - self.stretch) ** 2
        self.stretch = stretch
        self.y, self.y_last = y, self.y
        return y

    def tell(self, force, mean=0.0):
        """What the tissue answers at the tool's last position, and its mean on the way there."""
        self.tool_work -= mean * (self.y - self.y_last)
        self.forces = self.forces[1:] + [force]

    def move(self):
        """The device and the hand for one tick, by implicit midpoint steps."""
        device, hand, h = self.device, self.hand, TICK / SUBSTEPS
        time = self.k * TICK
        held = time < hand.release
        if held:
            mass = device.mass + hand.mass
            spring, damper = hand.stiffness, hand.damping
            begin, end = hand.path(time), hand.path((self.k + 1) * TICK)
        else:
            mass, spring, damper, begin, end = device.mass, 0.0, 0.0, 0.0, 0.0
        rate = (end - begin) / TICK
        inertia = 2.0 * mass / h
        whole = inertia + device.damping + damper + spring * h / 2.0
        x, v, pull, friction = self.x, self.v, self.pull, device.friction
        device_heat = hand_heat = path_work = 0.0
        for s in range(SUBSTEPS):
            p = begin + rate * ((s + 0.5) * h)
            push = inertia * v - pull + spring * (p - x) + damper * rate
            # Coulomb friction: the mean speed is 0 unless more than the friction pushes.
            mean = (push - friction if push > friction else push + friction if push < -friction else 0.0) / whole
            slip = rate - mean
            path_work += (spring * (p - x - mean * h / 2.0) + damper * slip) * rate
            hand_heat += damper * slip * slip
            device_heat += device.damping * mean * mean + friction * abs(mean)
            x += mean * h
            v = 2.0 * mean - v
        self.coupling_work += pull * (x - self.x)
        self.path_work += path_work * h
        self.hand_heat += hand_heat * h
        self.device_heat += device_heat * h
        self.x, self.v = x, v
        self.k += 1

    def stored(self):
        """Energy of the hand, the device, the coupling's spring and the tool now."""
        time = self.k * TICK
        held = time < self.hand.release
        apart = self.hand.path(time) - self.x if held else 0.0
        hand = 0.5 * self.hand.mass * self.v**2 + 0.5 * self.hand.stiffness * apart**2 if held else 0.0
        speed = (self.y - self.y_last) / TICK
        return (hand, 0.5 * self.device.mass * self.v**2, 0.5 * self.coupling.stiffness * self.stretch**2,
                0.5 * self.coupling.mass * speed**2)

    def passive(self):
        """What the coupling has taken from the device, and the device's own damping has turned to heat: the sampled
        loop is passive as long as this is not below zero, whatever the hand does."""
        return self.coupling_work + self.device_heat


def close_loop(loop, tissue, seconds, watch=None):
    """Runs for so long; `watch(loop)` is called at each tick."""
    for _ in range(round(seconds / TICK)):
        loop.tell(*tissue.step(loop.tick()))
        loop.move()
        if watch:
            watch(loop)


def bound(coupling):
    """Damping that a device must have beside this coupling, K T / 2 + |B| [N s/m]."""
    return coupling.stiffness * TICK / 2 + abs(coupling.damping)


def build(scene, folder):
    """The FMU of a scene."""
    program = os.environ.get("TISSUE_FMU", ROOT / "target/release/tissue-fmu")
    if not Path(program).exists():
        sys.exit(f"{program}: is not there; must be built with cargo build --release, or be named by TISSUE_FMU")
    path = Path(folder) / (Path(scene).stem + ".fmu")
    done = subprocess.run([program, "build", scene, "-o", path], capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr.strip())
    return path


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--stiffness", type=float, default=300.0, help="K of the coupling, N/m")
    parser.add_argument("--damping", type=float, default=0.05, help="B of the coupling, N s/m")
    parser.add_argument("--friction", type=float, default=0.0, help="Coulomb friction of the device, N")
    parser.add_argument("--delay", type=int, default=0, choices=(0, 1), help="ticks")
    chosen = parser.parse_args(arguments)
    if not (chosen.seconds > 0 and chosen.stiffness > 0 and chosen.damping >= 0 and chosen.friction >= 0):
        parser.error("seconds and stiffness must be above 0, damping and friction 0 or more")
    coupling = Coupling(chosen.stiffness, chosen.damping)
    loop = Loop(Device(friction=chosen.friction), Hand(), coupling, chosen.delay)
    seen = {"force": 0.0, "stiffness": 0.0, "static": 0.0, "least": 0.0, "jump": 0.0, "last": 0.0, "contacts": 0,
            "held": False}
    with tempfile.TemporaryDirectory() as folder, Tissue(build(SCENE, folder)) as tissue:

        def watch(loop):
            force = loop.forces[-1]
            held = tissue.in_contact()
            if held and not seen["held"]:
                seen["contacts"] += 1
            elif held:
                seen["jump"] = max(seen["jump"], abs(force - seen["last"]))
            seen["held"], seen["last"] = held, force
            seen["force"] = max(seen["force"], force)
            if held and -tissue.stiffness() > seen["stiffness"]:
                seen["stiffness"], seen["static"] = -tissue.stiffness(), tissue.get("tool[1].staticStiffness[3,3]")
            seen["least"] = min(seen["least"], loop.passive())

        close_loop(loop, tissue, chosen.seconds, watch)
        energy = tissue.energies()
    hand, device, spring, tool = loop.stored()
    inside = sum(energy[n] for n in ("elastic", "kinetic", "gravity", "load", "dissipated"))
    # What was taken from the device and is neither kept, nor heat, nor handed on: lost or, below 0, made by sampling.
    sampling = loop.coupling_work - loop.coupling_heat - spring - tool - energy["toolWork"]
    residual = loop.path_work - hand - loop.hand_heat - device - loop.device_heat - loop.coupling_work
    result = {
        "force": seen["force"], "jump": seen["jump"], "contacts": seen["contacts"],
        "stiffness": seen["stiffness"], "static": seen["static"],
        "needed": bound(coupling), "damping": loop.device.damping, "least": seen["least"],
        "path": loop.path_work, "hand": hand, "hand heat": loop.hand_heat, "device": device,
        "device heat": loop.device_heat, "coupling": spring, "coupling heat": loop.coupling_heat,
        "tool": tool, "sampling": sampling,
        "tissue": inside, "work": energy["toolWork"], "tool work": loop.tool_work,
        "tissue residual": inside - energy["toolWork"] - energy["supportWork"], "device residual": residual,
    }
    if __name__ == "__main__":
        report(result, loop, chosen.seconds)
    return result


def report(result, loop, seconds):
    print(f"{seconds:g} s at 1 kHz, coupling {loop.coupling.stiffness:g} N/m and {loop.coupling.damping:g} N s/m, "
          f"delay {loop.delay}")
    print(f"force        {result['force']:.3f} N at most, {result['jump']:.4f} N from tick to tick; "
          f"{result['contacts']} contacts")
    print(f"stiffness    {result['stiffness']:.0f} N/m within a tick, {result['static']:.0f} N/m settled")
    print(f"damping      {result['needed']:.3f} N s/m is needed, the device has {result['damping']:g}: "
          f"{'passive' if result['needed'] < result['damping'] else 'passivity is not assured'}")
    print(f"passivity    {result['least']:.1e} J: the least that coupling and friction had taken from the hand")
    print("energy, mJ")
    for name, key in [("work of the hand's intent", "path"), ("hand: motion and spring", "hand"),
                      ("hand: damping", "hand heat"), ("device: motion", "device"), ("device: friction", "device heat"),
                      ("coupling: spring", "coupling"), ("coupling: damping", "coupling heat"),
                      ("tool: motion", "tool"),
                      ("sampling", "sampling"), ("tissue, dissipated included", "tissue")]:
        print(f"  {name:29}{1e3 * result[key]:10.4f}")
    print(f"  residuals: device {1e3 * result['device residual']:.1e}, FMU {1e3 * result['tissue residual']:.1e}, "
          f"tool work against meanForce {1e3 * (result['work'] - result['tool work']):.1e}")


if __name__ == "__main__":
    main()
