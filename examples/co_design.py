"""Which couplings are stable, which are transparent: a map beside the bound of Colgate and Brown.

    python examples/co_design.py [--quick] [-o DIR]      # co_design.csv and co_design.svg

The loop of haptic_device.py, the ball stuck to the block 4 mm deep, T = 1 ms. For couplings K, B:

needed      damping [N s/m] that the device must have so that no hand gets energy from the sampled loop. Measured: the
            device is shaken along samples x_k = a sin(theta k), its speed constant from tick to tick, which is what takes
            the least friction; the coupling then gives -sum f_k (x_{k+1} - x_k), friction takes b sum (x_{k+1} - x_k)^2 / T.
bound       K T / 2 + |B|: what a wall behind the coupling needs.
exact       max over theta of T / 2 Re{(1 - e^{-i theta}) H} / (1 - cos theta) (Colgate and Schenkel), H from x to f with
            the tissue's response to one step of the tool, which the FMU gives.
returned    held by a hand without any damping, a spring at which the device swings with 200 Hz, and struck: the most that
            the coupling gives back beyond friction, over all that device, hand, coupling, tool and tissue had then.
            More than 1: it swings up.
error       |H - H_true| / |H_true|, the largest from 1 to 5 Hz: what is felt beside the tissue itself. Part of it is
            K in series with the tissue, the rest the tool's mass.

Needs numpy beside what haptic_device.py needs.
"""

import argparse
import csv
import math
import sys
import tempfile
from pathlib import Path

import numpy as np
from chart import FAINT, Chart, Panel
from haptic_device import SCENE, START, TICK, Coupling, Device, Hand, Loop, Tissue, bound, build, close_loop

DEPTH = 0.036  # m: the ball's centre, 4 mm into the block
DAMPING = 0.3  # N s/m, of the device on the map
THETA = np.pi * np.array([0.02, 0.1, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.98])


def settled(tissue):
    """The tissue's state with the tool at rest at DEPTH, and its force there."""
    tissue.reset()
    for k in range(2000):
        force, _ = tissue.step(START + (DEPTH - START) * min(1.0, (k + 1) / 500))
    return tissue.save(), force


def resting(coupling, rest, tissue, device=None, hand=None, delay=0):
    """A loop in equilibrium there."""
    state, force = rest
    tissue.restore(state)
    loop = Loop(device or Device(), hand or Hand(), coupling, delay)
    loop.x, loop.y, loop.y_last = DEPTH - force / coupling.stiffness, DEPTH, DEPTH
    loop.stretch = loop.x - DEPTH
    loop.forces = [force] * (delay + 1)
    return loop


def follow(loop, tissue, places):
    """Moves the device through places a tick apart at constant speed; the sum of squares of its ways."""
    squares = 0.0
    for place in places:
        loop.tell(*tissue.step(loop.tick()))
        way = place - loop.x
        loop.coupling_work += loop.pull * way
        squares += way * way
        loop.x = place
        loop.v = way / TICK
        loop.k += 1
    return squares


def needed(tissue, coupling, rest, delay=0, thetas=THETA, ticks=400):
    """Damping that shaking calls for, at each angle a tick [N s/m]."""
    found = []
    for theta in thetas:
        loop = resting(coupling, rest, tissue, delay=delay)
        amplitude = 1e-5 / (2 * math.sin(theta / 2))
        places = loop.x + amplitude * np.sin(theta * np.arange(1, ticks + ticks // 2 + 1))
        follow(loop, tissue, places[: ticks // 2])
        before = loop.coupling_work
        squares = follow(loop, tissue, places[ticks // 2 :])
        found.append((before - loop.coupling_work) / (squares / TICK))
    return np.array(found)


def needed_without(tissue, rest, delay=0, thetas=THETA, ticks=400):
    """The same with neither coupling nor tool: the device's position is the tool's, the tissue's force the device's."""
    state, force = rest
    found = []
    for theta in thetas:
        tissue.restore(state)
        places = DEPTH + 1e-5 / (2 * math.sin(theta / 2)) * np.sin(theta * np.arange(ticks + ticks // 2 + 1))
        felt = [force] * delay + [tissue.step(place)[0] for place in places]
        ways = np.diff(places)[ticks // 2 :]
        found.append(np.array(felt[ticks // 2 :][: len(ways)]) @ ways / (ways @ ways / TICK))
    return np.array(found)


def response(tissue, rest, ticks=4096):
    """Force after a tick of the tool of unit length, and after each tick that follows [N/m]."""
    state, force = rest
    tissue.restore(state)
    step = np.array([tissue.step(DEPTH - 1e-5)[0] - force for _ in range(ticks)]) / -1e-5
    return np.diff(step, prepend=0.0)


def transfer(pulse, theta):
    """From the tool's position to the tissue's force on it, at angles a tick."""
    k = np.arange(len(pulse))
    return np.array([pulse @ np.exp(-1j * angle * k) for angle in theta])


def felt(coupling, tissue, theta, delay=0):
    """H: from the device's position to the coupling's pull, with the tissue's transfer."""
    back = np.exp(-1j * theta)
    lead = coupling.stiffness + coupling.damping * (1 - back) / TICK
    inertia = coupling.mass * (1 - back) ** 2 / TICK**2
    return lead * (1 - lead / (inertia + lead - tissue * back ** (1 + delay)))


def exact(coupling, tissue, theta, delay=0):
    """Damping that the device needs, at each angle [N s/m]."""
    h = felt(coupling, tissue, theta, delay)
    return TICK / 2 * np.real((1 - np.exp(-1j * theta)) * h) / (1 - np.cos(theta))


def returned(tissue, coupling, rest, damping=DAMPING, hertz=200.0, seconds=4.0, delay=0):
    """The most that the coupling gives back beyond the device's friction, over all that is stored after a blow."""
    device = Device(damping=damping)
    spring = device.mass * (2 * math.pi * hertz) ** 2
    loop = resting(coupling, rest, tissue, device, delay=delay)
    # A hand that pulls as the coupling does, and stays.
    place = loop.x + coupling.stiffness * loop.stretch / spring
    loop.hand = Hand(0.0, spring, 0.0, place, place, place)
    loop.v = 0.05
    energy = tissue.energies()
    held = sum(loop.stored()) + energy["elastic"] + energy["kinetic"]
    most = 0.0
    for _ in range(round(seconds / 0.1)):
        close_loop(loop, tissue, 0.1)
        most = max(most, -loop.passive())
        if most > held:
            break
    return most / held


def transparency(coupling, tissue, delay=0, hertz=(1.0, 2.0, 3.0, 4.0, 5.0)):
    """Largest relative error of the impedance, and the ratio of stiffness felt to true at the lowest frequency."""
    theta = 2 * np.pi * np.array(hertz) * TICK
    true = -transfer(tissue, theta)
    found = felt(coupling, -true, theta, delay)
    return np.abs(found / true - 1).max(), abs(found[0] / true[0])


def sweep(tissue, stiffnesses, dampings, theta=np.linspace(0.01, np.pi, 400)):
    rest = settled(tissue)
    pulse = response(tissue, rest)
    whole = transfer(pulse, theta)
    rows = []
    for stiffness in stiffnesses:
        for damping in dampings:
            coupling = Coupling(float(stiffness), float(damping))
            error, ratio = transparency(coupling, pulse)
            rows.append({"stiffness": float(f"{stiffness:.6g}"), "damping": float(f"{damping:.6g}"),
                         "needed": needed(tissue, coupling, rest).max(), "bound": bound(coupling),
                         "exact": exact(coupling, whole, theta).max(), "returned": returned(tissue, coupling, rest),
                         "error": error, "ratio": ratio})
    return rows


PASSIVE, ACTIVE, UNSTABLE = "#cfe3d4", "#f3dfb8", "#dd8a6a"


def draw(rows, path):
    """Left the map of passivity, right what is felt."""
    chart = Chart(920, 420)
    stiffness = sorted({row["stiffness"] for row in rows})
    damping = sorted({row["damping"] for row in rows})
    step, gap = (stiffness[1] / stiffness[0]) ** 0.5, (damping[1] - damping[0]) / 2
    panel = Panel(chart, (70, 50, 370, 300), (stiffness[0] / step, stiffness[-1] * step, True),
                  (damping[0] - gap, damping[-1] + gap, False), (50, 100, 200, 500, 1000, 2000, 5000),
                  (0, 0.1, 0.2, 0.3, 0.4), "coupling stiffness K, N/m", "coupling damping B, N s/m",
                  f"A device with b = {DAMPING} N s/m")
    for row in rows:
        colour = UNSTABLE if row["returned"] >= 1 else ACTIVE if row["needed"] > DAMPING else PASSIVE
        panel.cell((row["stiffness"] / step, row["stiffness"] * step), (row["damping"] - gap, row["damping"] + gap), colour)
    edge = [(k, DAMPING - k * TICK / 2) for k in np.geomspace(stiffness[0] / step, 2 * (DAMPING + gap) / TICK, 100)]
    panel.line(edge, width=2.5)
    panel.text(285, 0.06, "b = K T/2 + |B|", 13, "end")
    panel.axes()
    for x, colour, words in ((70, PASSIVE, "passive however it is shaken"), (268, ACTIVE, "can give energy to the hand"),
                             (470, UNSTABLE, "swings up in a hand that is a stiff spring")):
        chart.box(x, 402, 12, 12, colour)
        chart.text(x + 17, 412, words, 12)
    plain = [row for row in rows if row["damping"] == damping[0]]
    panel = Panel(chart, (530, 50, 370, 300), (stiffness[0] / step, stiffness[-1] * step, True), (0, 1, False),
                  (50, 100, 200, 500, 1000, 2000, 5000), (0, 0.2, 0.4, 0.6, 0.8, 1), "coupling stiffness K, N/m",
                  "", "What is felt of the tissue")
    for b, words in ((DAMPING, f"b = {DAMPING}"), (1.0, "b = 1 N s/m")):
        panel.line([(2 * b / TICK, 0), (2 * b / TICK, 1)], FAINT, 1.5, "5 4")
        panel.text(2 * b / TICK, 0.0, words, 12, "end", "#777777", dx=-5, dy=-8)
    for key, colour, words, place in (("ratio", "#2b6ca3", "felt / true stiffness, 1 Hz", (4900, 0.70)),
                                      ("error", "#b0472a", "error, 1 to 5 Hz", (66, 0.82))):
        panel.line([(row["stiffness"], row[key]) for row in plain], colour, 2.2)
        for row in plain:
            panel.chart.dot(*panel.at(row["stiffness"], row[key]), colour)
        panel.text(*place, words, 13, "end" if key == "ratio" else "start", colour)
    panel.axes()
    chart.write(path)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a few couplings")
    parser.add_argument("-o", default="results", metavar="DIR")
    chosen = parser.parse_args(arguments)
    stiffnesses = np.geomspace(50, 5000, 3 if chosen.quick else 21)
    dampings = np.linspace(0.0, 0.4, 2 if chosen.quick else 17)
    with tempfile.TemporaryDirectory() as folder, Tissue(build(SCENE, folder)) as tissue:
        rows = sweep(tissue, stiffnesses, dampings)
        alone = [needed_without(tissue, settled(tissue), delay).max() for delay in (0, 1)]
        static, within = tissue.get("tool[1].staticStiffness[3,3]"), -tissue.stiffness()
    place = Path(chosen.o)
    place.mkdir(parents=True, exist_ok=True)
    with open(place / "co_design.csv", "w", newline="") as file:
        table = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        table.writeheader()
        table.writerows({k: f"{v:.4g}" for k, v in row.items()} for row in rows)
    draw(rows, place / "co_design.svg")
    share = [row["needed"] / row["bound"] for row in rows]
    off = max(abs(row["exact"] / row["needed"] - 1) for row in rows)
    print(f"tissue       {within:.0f} N/m within a tick, {static:.0f} N/m settled")
    print(f"no coupling  {alone[0]:.2f} N s/m are needed, {alone[1]:.2f} with a delay of a tick; K T / 2 would say "
          f"{within * TICK / 2:.2f} of the stiffness within a tick, {static * TICK / 2:.2f} of the settled one")
    print(f"couplings    {len(rows)}: they need {min(share):.2f} to {max(share):.3f} of the bound, "
          f"and what the exact criterion says to {100 * off:.1f} %")
    for damping in dampings[:: len(dampings) - 1]:
        print(f"B = {damping:g} N s/m\n     K, N/m   needed    bound   exact   felt/true   error 1-5 Hz   returned")
        for row in rows:
            if row["damping"] == damping:
                print("{stiffness:11.0f}{needed:9.3f}{bound:9.3f}{exact:8.3f}{ratio:12.3f}{error:15.3f}{returned:11.2g}"
                      .format(**row))
    print(f"written to {place / 'co_design.csv'} and {place / 'co_design.svg'}")
    return rows, alone, within, static


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
