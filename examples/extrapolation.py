"""The tissue is asked 50 to 1000 times a second, the device's loop runs at 1 kHz: what it takes the force to be meanwhile.

    python examples/extrapolation.py [--quick]

Each H seconds the FMU steps to the tool's position y_c and gives F_c. Until the next time the loop of haptic_device.py
uses one of

    hold        F_c
    slope       F_c + F' s                of fmi2GetRealOutputDerivatives, s since then
    local       F_c + S (y - y_c)         S = tool[1].stiffness: how the end of the next step of length H answers
    static      F_c - K_s (y - y_c)       K_s = tool[1].staticStiffness

Open loop: all follow the tool's path of the loop at 1 kHz; error of the force against it, and how far it jumps when a
new F_c arrives. Closed loop: each leads its own tool; the error is that of the coupling's pull on the hand. In both the
hand strokes in and out of contact for 4 s, then rests on the tissue for a second. `swings` is the device's largest
speed in the last half of it: a loop that has settled stands still; one that swings up is left at 1 m/s. `least` is what the coupling and the device's friction
had taken from the hand at worst: below 0 the loop is not passive.

Needs what haptic_device.py needs.
"""

import argparse
import sys
import tempfile
from ctypes import c_double, c_int
from dataclasses import dataclass
from math import inf, isinf

from haptic_device import SCENE, TICK, Coupling, Device, Hand, Loop, Tissue, build, close_loop

METHODS = ("hold", "slope", "local", "static")


class Seldom:
    """A tissue that is asked every `every` ticks; between, the force is made up."""

    def __init__(self, tissue, every, method):
        self.tissue, self.every, self.method = tissue, every, method
        tissue.reset()
        self.k = 0
        self.force, self.place, self.slope, self.stiffness = 0.0, 0.0, 0.0, 0.0
        self.made_up = 0.0
        self.jumps = []

    def step(self, y):
        if self.k % self.every == 0:
            before = self.guess(y, self.every)
            self.force, mean = self.tissue.step(y, self.every * TICK)
            self.place = y
            if self.k:
                self.jumps.append(self.force - before)
            if self.method == "slope":
                self.slope = derivative(self.tissue)
            elif self.method == "local":
                self.stiffness = self.tissue.stiffness()
            elif self.method == "static":
                self.stiffness = -self.tissue.get("tool[1].staticStiffness[3,3]") if self.tissue.in_contact() else 0.0
        found = self.guess(y, self.k % self.every)
        self.k += 1
        return found, 0.0

    def guess(self, y, ticks):
        return self.force + self.slope * ticks * TICK + self.stiffness * (y - self.place)


def derivative(tissue):
    """dF/dt [N/s]."""
    fmu, value = tissue.fmu, (c_double * 1)()
    fmu.fmi2GetRealOutputDerivatives(fmu.component, tissue.forces, 1, (c_int * 1)(1), value)
    return value[0]


@dataclass
class Found:
    forces: list
    pulls: list
    places: list
    swings: float
    least: float
    jump: float


def run(seldom, coupling, hand, seconds, places=None):
    """Closed loop, or with the tool along `places`."""
    found = Found([], [], [], 0.0, 0.0, 0.0)
    if places:
        found.forces = [seldom.step(y)[0] for y in places]
    else:
        loop = Loop(Device(), hand, coupling)

        def watch(loop):
            found.forces.append(loop.forces[-1])
            found.places.append(loop.y)
            found.pulls.append(loop.pull)
            found.least = min(found.least, loop.passive())
            if loop.k * TICK > seconds - 0.5:
                found.swings = max(found.swings, abs(loop.v))

        while loop.k * TICK < seconds - TICK / 2 and abs(loop.v) < 1.0:
            close_loop(loop, seldom, TICK, watch)
        if abs(loop.v) >= 1.0:
            found.swings = inf
    found.jump = max((abs(jump) for jump in seldom.jumps), default=0.0)
    return found


def errors(found, true):
    """Root mean square and largest difference."""
    apart = [abs(a - b) for a, b in zip(found, true)]
    return (sum(a * a for a in apart) / len(apart)) ** 0.5, max(apart)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="100 Hz only")
    parser.add_argument("--stiffness", type=float, default=500.0, help="K of the coupling, N/m")
    chosen = parser.parse_args(arguments)
    if not chosen.stiffness > 0:
        parser.error("stiffness must be above 0")
    coupling = Coupling(chosen.stiffness, 0.04)
    rest = 2.25 if chosen.quick else 4.25
    hand, seconds = Hand(rest=rest), rest + 1.25
    table = []
    with tempfile.TemporaryDirectory() as folder, Tissue(build(SCENE, folder)) as tissue:
        true = run(Seldom(tissue, 1, "hold"), coupling, hand, seconds)
        print(f"strokes of 1 Hz, {max(true.forces):.3f} N at most; coupling {coupling.stiffness:g} N/m; forces in mN")
        print("                          tool led: error       jump     closed loop: error    swings       least")
        print("                          rms   largest                   rms   largest        mm/s          mJ")
        for every in (10,) if chosen.quick else (1, 5, 10, 20):
            for method in METHODS:
                led = run(Seldom(tissue, every, method), coupling, hand, seconds, true.places)
                own = run(Seldom(tissue, every, method), coupling, hand, seconds)
                row = (1 / (every * TICK), method, *errors(led.forces, true.forces), led.jump,
                       *errors(own.pulls, true.pulls), own.swings, own.least)
                table.append(row)
                print("{:6.0f} Hz  {:8}{:14.2f}{:10.1f}{:11.1f}".format(*row[:2], *(1e3 * v for v in row[2:5])), end="")
                print("   swings up" if isinf(own.swings) else
                      "{:11.2f}{:10.1f}{:12.3f}{:12.4f}".format(*(1e3 * v for v in row[5:])))
    return table


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
