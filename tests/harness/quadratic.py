"""Converged quadratic references for the six studies: slow, run by hand.

    OMP_NUM_THREADS=1 python tests/harness/quadratic.py [study ...]

Prints each mesh's force (torque) and energy, and the limit. With graded tetrahedra this is Richardson's
extrapolation of the last three. With bricks in layers it is the last value, and its error how far a
second road, of layers of another ratio, ends from it, or the last change if that is more. Writes
quadratic.csv, keeping the rows of studies not asked for.

Stress has no bound along the edges of a grip, and there a neo-Hookean point may invert however fine
the mesh; the law is made for that, so it is let, and the table shows the smallest det F. St
Venant-Kirchhoff's is not, and the ladder ends where it has no equilibrium.
"""

import csv
import sys
import time
from math import inf
from pathlib import Path

from scipy.optimize import brentq

from nonlinear import NoEquilibrium
from studies import STUDIES, block

TABLE = Path(__file__).with_suffix(".csv")
COLUMNS = ["scene", "nu", "law", "quantity", "value", "levels used", "estimated remaining error"]
LAWS = ["stableNeoHookean", "stVenantKirchhoff"]
FLOOR = {"stableNeoHookean": -inf, "stVenantKirchhoff": 0.0}
RATIOS = [0.45, 0.499]
# On the way to the last one bricks pass the others, each from the equilibrium of the one before.
WAYS = {0.45: [0.45], 0.499: [0.45, 0.47, 0.485, 0.493, 0.4965, 0.499]}
SECOND = {"block": block(0.35, (2, 3, 4))}


def extrapolated(levels, values):
    """Limit and relative error from v + C level^-p through the last three.

    Without such a p between 1/2 and 6: the last value, and the last change as its error. Else the
    error is what was extrapolated, and never under half of the last change.
    """
    (a, b, c), (x, y, z) = levels[-3:], values[-3:]

    def miss(p):
        return (x - y) * (b**-p - c**-p) - (y - z) * (a**-p - b**-p)

    limit = z
    if (x - y) * (y - z) > 0 and miss(0.5) * miss(6) < 0:
        p = brentq(miss, 0.5, 6)
        limit = z + (z - y) * c**-p / (b**-p - c**-p)
    least = abs(z - y) if limit == z else abs(z - y) / 2
    return limit, max(abs(limit - z), least) / abs(limit)


def ladder(study, law, poisson):
    """(level, force, energy) of each mesh, as far as there is an equilibrium."""
    way = WAYS[poisson] if study.layered else [poisson]
    # After 1e-4 only folded bricks still move: the force by 0.01 %.
    tolerance = 1e-4 if study.layered else 1e-8
    rows, options = [], {"smallest": 1 / 8, "tolerance": tolerance, "floor": FLOOR[law]}
    for level in study.levels:
        begun = time.monotonic()
        if rows and study.guess is None:
            options["start"] = study.carried(first.displacement, rows[-1][0], level)
        try:
            force, energy, found = study.oracle(level, law, way[0], **options)
            first = found
            for ratio in way[1:]:
                options["start"] = found.displacement
                force, energy, found = study.oracle(level, law, ratio, **options)
        except NoEquilibrium as reason:
            print(f"  {level:>5}  {reason}", flush=True)
            break
        rows.append((level, force, energy))
        print(
            f"  {level:>5} {found.displacement.size:>7} {force:>12.6f} {1e3 * energy:>12.6f}"
            f" {found.minimum_volume_ratio:>7.3f} {found.residual:>8.0e} {found.iterations:>4}"
            f" {time.monotonic() - begun:>6.0f}", flush=True)
    return rows


def limits(study, law, poisson):
    """Rows of the table."""
    print(f"{study.name}, nu {poisson}, {law}")
    print("  level     dof     N or N m           mJ min det residual iterations s")
    if study.layered is not None and law == "stVenantKirchhoff":
        print("  pressed so hard, it has no equilibrium")
        return []
    rows = ladder(study, law, poisson)
    second = ladder(SECOND[study.name], law, poisson) if study.layered else None
    if len(rows) < 3:
        return []
    levels = [row[0] for row in rows]
    table = []
    for k, quantity in enumerate(["torque" if study.torque else "force", "energy"], 1):
        values = [row[k] for row in rows]
        if second:
            limit = values[-1]
            error = max(abs(values[-2] - limit), abs(second[-1][k] - limit)) / abs(limit)
        else:
            limit, error = extrapolated(levels, values)
        print(f"  {quantity}: {limit:.6g}, error about {100 * error:.2g} %")
        used = " ".join(map(str, levels))
        found = [quantity, f"{limit:.6g}", used, f"{error:.1e}"]
        table.append([study.name, str(poisson), law, *found])
    return table


def renew(study, law, poisson):
    """One ladder, and its rows of the table."""
    known = list(csv.reader(TABLE.open()))[1:] if TABLE.exists() else []
    same = [study.name, str(poisson), law]
    known = [row for row in known if row[:3] != same] + limits(study, law, poisson)
    with TABLE.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *known])


def main(names):
    for law in LAWS:
        for make in STUDIES:
            for poisson in RATIOS:
                if not names or make.__name__ in names:
                    renew(make(), law, poisson)


if __name__ == "__main__":
    main(sys.argv[1:])
