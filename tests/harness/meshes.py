"""Meshes made here, so that nobody's mesher is trusted: (nodes, tetrahedra), metres, from 0."""

from itertools import permutations

import numpy as np
from scipy.spatial import Delaunay
from skfem import MeshTet


def volumes(nodes, tetrahedra):
    a, b, c, d = (nodes[tetrahedra[:, k]] for k in range(4))
    return np.einsum("ti,ti->t", np.cross(b - a, c - a), d - a) / 6


def oriented(nodes, tetrahedra):
    """The same tetrahedra, all of positive volume."""
    tetrahedra = np.array(tetrahedra)
    flip = volumes(nodes, tetrahedra) < 0
    tetrahedra[flip, :2] = tetrahedra[flip, 1::-1]
    return nodes, tetrahedra


def kuhn(size, cells, jitter=0.0, seed=1):
    """A box, six tetrahedra a cell; inner nodes moved by `jitter` of a cell."""
    nx, ny, nz = cells
    axes = [np.linspace(0, s, n + 1) for s, n in zip(size, cells)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape(nx + 1, ny + 1, nz + 1)
    corner = number[:-1, :-1, :-1].ravel()
    stride = [(ny + 1) * (nz + 1), nz + 1, 1]
    tetrahedra = []
    for order in permutations(range(3)):
        walk = np.cumsum([0] + [stride[axis] for axis in order])
        tetrahedra.append(corner[:, None] + walk)
    if jitter:
        inner = np.all((nodes > 0) & (nodes < np.array(size)), axis=1)
        spread = jitter * np.array(size) / np.array(cells)
        nodes[inner] += np.random.default_rng(seed).uniform(-1, 1, (inner.sum(), 3)) * spread
    return oriented(nodes, np.concatenate(tetrahedra))


def shaken(mesh, amount, seed=1):
    """The same box with its nodes moved, those of its faces within them, so that no two volumes are the same."""
    nodes, tetrahedra = mesh
    inner = (nodes > nodes.min(axis=0)) & (nodes < nodes.max(axis=0))
    moved = nodes + inner * np.random.default_rng(seed).uniform(-amount, amount, nodes.shape)
    assert volumes(moved, tetrahedra).min() > 0
    return moved, tetrahedra


def five(size, cells):
    """A box, five tetrahedra a cell, mirrored from cell to cell."""
    nodes, _ = kuhn(size, cells)
    number = np.arange(len(nodes)).reshape(np.array(cells) + 1)
    tetrahedra = []
    for cell in np.ndindex(*cells):
        odd = sum(cell) % 2
        corner = {
            (x, y, z): number[cell[0] + (x ^ odd), cell[1] + y, cell[2] + z] for x, y, z in np.ndindex(2, 2, 2)
        }
        middle = [(0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)]
        tetrahedra.append([corner[c] for c in middle])
        for x, y, z in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]:
            ends = [(x ^ 1, y, z), (x, y ^ 1, z), (x, y, z ^ 1)]
            tetrahedra.append([corner[(x, y, z)], *(corner[c] for c in ends)])
    return oriented(nodes, np.array(tetrahedra))


def six(size, cells):
    """A box, six tetrahedra a cell round its diagonal, mirrored from cell to cell."""
    nodes, _ = kuhn(size, cells)
    cell = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), -1).reshape(-1, 3)
    stride = np.array([(cells[1] + 1) * (cells[2] + 1), cells[2] + 1, 1])
    start, way = (cell + cell % 2) @ stride, stride * (1 - 2 * (cell % 2))
    tetrahedra = []
    for order in permutations(range(3)):
        walk = np.cumsum(way[:, order], axis=1)
        tetrahedra.append(start[:, None] + np.insert(walk, 0, 0, axis=1))
    return oriented(nodes, np.concatenate(tetrahedra))


def on_lines(mesh, lines):
    """A box of unit cells, its planes moved to these coordinates along each axis."""
    nodes, tetrahedra = mesh
    cell = np.rint(nodes).astype(int)
    return np.stack([np.asarray(lines[k])[cell[:, k]] for k in range(3)], axis=1), tetrahedra


def tube(inner, outer, height, cells):
    """Round the z axis from z = 0: cells around (an even number), through the wall and along, six tetrahedra each."""
    around, through, along = cells
    nodes, tetrahedra = six((1, 1, 1), cells)
    # The last plane of nodes is the first one again.
    first = (through + 1) * (along + 1)
    tetrahedra = tetrahedra % (first * around)
    turn, share, z = nodes[: first * around].T
    radius = inner + (outer - inner) * share
    at = [radius * np.cos(2 * np.pi * turn), radius * np.sin(2 * np.pi * turn), height * z]
    return oriented(np.stack(at, axis=1), tetrahedra)


def in_a_row(mesh, count, distance):
    """Copies of a mesh along x."""
    nodes, tetrahedra = mesh
    rows = np.arange(count)[:, None, None]
    return (
        (nodes + rows * [distance, 0, 0]).reshape(-1, 3),
        (tetrahedra + rows * len(nodes)).reshape(-1, 4),
    )


def gmsh(nodes, tetrahedra):
    """The text of a Gmsh file of version 2.2, coordinates in mm to a micrometre."""
    rows = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", len(nodes)]
    rows += [" ".join([str(k), *(f"{round(1e3 * x, 3) + 0.0:.3f}" for x in at)]) for k, at in enumerate(nodes, 1)]
    rows += ["$EndNodes", "$Elements", len(tetrahedra)]
    rows += [" ".join(map(str, [k, 4, 0, *own])) for k, own in enumerate((tetrahedra + 1).tolist(), 1)]
    return "\n".join(map(str, [*rows, "$EndElements"])) + "\n"


def tensor(size, cells):
    """A box by scikit-fem's own division of a cell."""
    mesh = MeshTet.init_tensor(*(np.linspace(0, s, n + 1) for s, n in zip(size, cells)))
    return oriented(mesh.p.T.copy(), mesh.t.T.copy())


def delaunay(size, cells, seed=2):
    """A box of irregular tetrahedra, flat ones left out."""
    nodes, _ = kuhn(size, cells, jitter=0.25, seed=seed)
    nodes, tetrahedra = oriented(nodes, Delaunay(nodes, qhull_options="QJ Pp").simplices.astype(int))
    cell = np.prod(np.array(size) / np.array(cells))
    return nodes, tetrahedra[volumes(nodes, tetrahedra) > 0.01 * cell]


def refined(size):
    """One cube divided twice by scikit-fem: nodes of very different stars."""
    mesh = MeshTet().refined(2)
    return oriented(mesh.p.T * np.array(size), mesh.t.T.copy())


def inside(points, low, high, tolerance=1e-9):
    """Numbers of the points in a box."""
    low, high = np.array(low) - tolerance, np.array(high) + tolerance
    return np.flatnonzero(np.all((points >= low) & (points <= high), axis=1))


def centroids(nodes, tetrahedra):
    return nodes[tetrahedra].mean(axis=1)


def drum(radii, counts, heights):
    """Round the z axis: rings of points about its middle, on planes at these heights, three tetrahedra a prism.

    `counts`: points on each ring; from ring to ring of as many the points are turned by half a gap.
    """
    points, angles, turn = [np.zeros((1, 2))], [np.zeros(1)], 0.0
    for k, (radius, count) in enumerate(zip(radii, counts)):
        turn = 0.5 - turn if k and count == counts[k - 1] else 0.0
        angles.append(2 * np.pi * (np.arange(count) + turn) / count)
        points.append(radius * np.stack([np.cos(angles[-1]), np.sin(angles[-1])], axis=1))
    first = np.cumsum([0, 1, *counts])
    triangles = [[0, 1 + k, 1 + (k + 1) % counts[0]] for k in range(counts[0])]
    for ring in range(1, len(counts)):
        inner, outer = (np.append(each, each[0] + 2 * np.pi) for each in angles[ring : ring + 2])
        i, j, last = 0, 0, (len(inner) - 1, len(outer) - 1)
        while (i, j) != last:
            a, b = first[ring] + i % last[0], first[ring + 1] + j % last[1]
            # The shorter of the two diagonals.
            if i == last[0] or (j < last[1] and outer[j + 1] - inner[i] <= inner[i + 1] - outer[j] + 1e-9):
                j += 1
                triangles.append([a, b, first[ring + 1] + j % last[1]])
            else:
                i += 1
                triangles.append([a, b, first[ring] + i % last[0]])
    plane, low = np.concatenate(points), np.sort(triangles, axis=1)
    nodes = np.concatenate([np.column_stack([plane, np.full(len(plane), h)]) for h in heights])
    tetrahedra = []
    for k in range(len(heights) - 1):
        # From the lower node below to the higher one above, or the other way round in every other layer.
        (a, b, c), (d, e, f) = (low.T + (k + side) * len(plane) for side in ((0, 1), (1, 0))[k % 2])
        tetrahedra += [np.stack(each, axis=1) for each in ((a, b, c, f), (a, b, e, f), (a, d, e, f))]
    return oriented(nodes, np.concatenate(tetrahedra))
