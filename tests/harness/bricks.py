"""Quadratic bricks with their own pressure, for what is pressed hard and is almost incompressible.

27 nodes a brick, sides along the axes; stable neo-Hookean. The volume ratio J counts by its part
that is linear over the brick: W = sum psi(F) - lam'/2 (J - alpha)^2 + lam'/2 (J_1 - alpha)^2.
"""

from itertools import product

import numpy as np
from laws import cofactor, cofactor_rate, determinant, outer, over, smith
from nonlinear import Body
from numpy.polynomial.legendre import leggauss

POINTS, WEIGHTS = leggauss(3)
THREE = list(product(range(3), repeat=3))


def halved(line):
    return np.sort(np.concatenate([line, (line[1:] + line[:-1]) / 2]))


def bricks(lines):
    """Nodes and bricks of a box divided at these coordinates along each axis."""
    lines = list(map(halved, lines))
    counts = [len(line) for line in lines]
    nodes = np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape(counts)
    at = np.array(list(product(*(range(0, n - 1, 2) for n in counts))))[:, None] + THREE
    return nodes, number[tuple(at.transpose(2, 0, 1))]


def shape():
    """dN_a / dx on a unit brick, points x a x 3; weights; what keeps the linear part of values."""
    x = POINTS
    values = np.stack([x * (x - 1) / 2, 1 - x**2, x * (x + 1) / 2], axis=1)
    rates = np.stack([2 * x - 1, -4 * x, 2 * x + 1], axis=1)
    along = [[rates if k == axis else values for k in range(3)] for axis in range(3)]
    slopes = [np.einsum("ai,bj,ck->abcijk", *each).reshape(27, 27) for each in along]
    weight = np.prod(WEIGHTS[THREE], axis=1) / 8
    linear = np.insert(POINTS[THREE], 0, 1, axis=1)
    part = linear @ np.linalg.solve(linear.T * weight @ linear, linear.T * weight)
    return np.stack(slopes, -1), weight, part


class Bricks(Body):
    def _geometry(self):
        sides = self.points[self.tetrahedra[:, -1]] - self.points[self.tetrahedra[:, 0]]
        slopes, weight, self.part = shape()
        if np.any(self.material.law != "stableNeoHookean") or np.any(self.material.kap):
            raise ValueError("bricks are for the stable neo-Hookean law alone")
        self.gradient = slopes / sides[:, None, None]
        self.weight = np.prod(sides, axis=1)[:, None] * weight

    def _volumes(self, F, part):
        """lam', alpha, J and its linear part."""
        material = self.material.at(part)
        _, lam, alpha = smith(material.lam[:, None], material.mu[:, None])
        J = determinant(F)
        return lam, alpha, J, J @ self.part.T

    def _energy(self, F, part):
        lam, alpha, J, mean = self._volumes(F, part)
        return super()._energy(F, part) + lam / 2 * (mean - J) * (mean + J - 2 * alpha)

    def _stress(self, F, part):
        lam, _, J, mean = self._volumes(F, part)
        return super()._stress(F, part) + over(lam * (mean - J), 2) * cofactor(F)

    def _tangent(self, F, part):
        lam, _, J, mean = self._volumes(F, part)
        swollen = over(lam * (mean - J), 4) * cofactor_rate(F)
        squeezed = over(lam, 4) * outer(cofactor(F), cofactor(F))
        return super()._tangent(F, part) + swollen - squeezed

    def _stiffness(self, u, part, share):
        F = self.deformation(u, part)
        rate = np.einsum("tqiJ,tqaJ->tqai", cofactor(F), self.gradient[part])
        rate = rate.reshape(*F.shape[:2], -1)
        lam = self._volumes(F, part)[0]
        weighted = rate * (lam * self.weight[part])[..., None]
        added = weighted.swapaxes(-1, -2) @ (self.part @ rate)
        shares = super()._stiffness(u, part, share)
        return shares + added.reshape(shares.shape)
