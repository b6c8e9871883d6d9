"""A rigid frictionless ball pressed on linear tissue, by a penalty at points of the surface: shares no code with the product.

The pressure at a point is k times its depth in the ball, where it is in it. With many points a face, and k so large that
depths are nothing, this is unilateral contact of the surface as it is; with fewer points it is what programs do. The ball
meets displaced points, so that contact is not linear; Newton's method, on the stiffness condensed to the nodes of the points.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.polynomial.legendre import leggauss
from scipy.linalg import cho_factor, cho_solve

from bricks import Bricks, shape
from dissection import Plan
from nonlinear import Body

# Radon's points of degree 5 in a triangle: weights of the corners, and of the points.
NEAR, FAR = (6 - 15**0.5) / 21, (6 + 15**0.5) / 21
SEVEN = np.array([[1 / 3] * 3] + [np.roll([1 - 2 * s, s, s], k) for s in (NEAR, FAR) for k in range(3)])
SEVEN_WEIGHT = np.repeat([9 / 40, (155 - 15**0.5) / 1200, (155 + 15**0.5) / 1200], [1, 3, 3])


class Quadratic(Bricks):
    """Bricks of 27 nodes for any law, without a pressure of their own."""

    def _geometry(self):
        sides = self.points[self.tetrahedra[:, -1]] - self.points[self.tetrahedra[:, 0]]
        slopes, weight, _ = shape()
        self.gradient = slopes / sides[:, None, None]
        self.weight = np.prod(sides, axis=1)[:, None] * weight

    _energy, _stress, _tangent, _stiffness = Body._energy, Body._stress, Body._tangent, Body._stiffness


@dataclass
class Places:
    """Points of a surface: their weights on its nodes, points x nodes, and their areas [m2]."""

    weight: sparse.csr_matrix
    area: np.ndarray


def spread(count, faces, values, shares, area):
    """The same points on each face: values points x nodes of a face, shares of its area."""
    row = np.repeat(np.arange(len(faces) * len(shares)), faces.shape[1])
    column = np.repeat(faces, len(shares), axis=0).ravel()
    weight = sparse.csr_matrix((np.tile(values.ravel(), len(faces)), (row, column)), (len(faces) * len(shares), count))
    return Places(weight, np.outer(area, shares).ravel())


def on_bricks(nodes, cells, count=4):
    """On the highest faces of bricks of 27 nodes: count x count points of Gauss's rule each."""
    faces = cells[np.abs(nodes[cells[:, -1], 2] - nodes[:, 2].max()) < 1e-12][:, 2::3]
    x, w = leggauss(count)
    line = np.stack([x * (x - 1) / 2, 1 - x**2, x * (x + 1) / 2], axis=1)
    values = np.einsum("ai,bj->abij", line, line).reshape(count**2, 9)
    sides = nodes[faces[:, -1]] - nodes[faces[:, 0]]
    return spread(len(nodes), faces, values, np.outer(w, w).ravel() / 4, sides[:, 0] * sides[:, 1])


def on_triangles(nodes, faces, points=SEVEN, shares=SEVEN_WEIGHT):
    """On triangles of three nodes, or of six (those of the edges 01, 12 and 20 last)."""
    a, b, c = (nodes[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    values = points
    if faces.shape[1] == 6:
        values = np.hstack([points * (2 * points - 1), 4 * points * np.roll(points, -1, axis=1)])
    return spread(len(nodes), faces, values, shares, area)


class Condensed:
    """The stiffness that the nodes of some places have, all others being free or held at 0."""

    def __init__(self, nodes, matrix, held, places):
        part = matrix.tocoo()
        graph = sparse.csr_matrix((np.ones(part.nnz), (part.row // 3, part.col // 3)), (len(nodes),) * 2)
        free = ~held & (np.diff(graph.indptr) > 0)[:, None]
        plan = Plan(nodes, graph, free)
        used = np.unique(places.weight.indices)
        self.nodes, self.free = nodes[used], free[used]
        dofs = (3 * used[:, None] + np.arange(3))[self.free]
        mine = np.argsort(plan.dofs)[np.searchsorted(np.sort(plan.dofs), dofs)]
        unit = np.zeros((len(plan.dofs), len(mine)))
        unit[mine, range(len(mine))] = 1
        compliance = plan.factor(matrix[plan.dofs][:, plan.dofs]).solve(unit)[mine]
        self.matrix = np.linalg.inv((compliance + compliance.T) / 2)
        self.places = Places(places.weight[:, used], places.area)
        # Of a point's displacement along each axis to the free ones.
        own = np.flatnonzero(self.free.ravel())
        self.axes = [sparse.csr_matrix(sparse.kron(self.places.weight, np.eye(1, 3, a)))[:, own] for a in range(3)]

    def press(self, centres, radius, stiffness, most=60):
        """Force on the ball [N] and the greatest depth in it [m] at the last of `centres`, reached through the others.

        `stiffness`: of the penalty [Pa/m], one after the other at the last centre.
        """
        where, area = self.places.weight @ self.nodes, self.places.area
        u = np.zeros(len(self.matrix))

        def gaps(u, centre):
            away = where + np.stack([axis @ u for axis in self.axes], axis=1) - centre
            distance = np.linalg.norm(away, axis=1)
            return distance - radius, away / distance[:, None]

        def potential(u, centre, k):
            return u @ self.matrix @ u / 2 + k / 2 * area @ np.minimum(gaps(u, centre)[0], 0) ** 2

        stages = [(c, stiffness[0]) for c in centres] + [(centres[-1], k) for k in stiffness[1:]]
        for centre, k in stages:
            for _ in range(most):
                gap, normal = gaps(u, centre)
                at = np.flatnonzero(gap < 0)
                rate = sum(sparse.diags(normal[at, a]) @ self.axes[a][at] for a in range(3))
                push, inner = -k * area[at] * gap[at], self.matrix @ u
                force = rate.T @ push - inner
                if np.linalg.norm(force) <= 1e-8 * np.linalg.norm(inner):
                    break
                tangent = self.matrix + (rate.T @ sparse.diags(k * area[at]) @ rate).toarray()
                move, share = cho_solve(cho_factor(tangent), force), 1.0
                start = potential(u, centre, k)
                while share > 1e-6 and potential(u + share * move, centre, k) > start - 1e-4 * share * (force @ move):
                    share /= 2
                u = u + share * move
            else:
                raise ArithmeticError("the contact does not settle")
        self.displacement = u
        return -push @ normal[at], -gap.min()
