"""Equilibrium of hyperelastic tetrahedra by Newton's method: shares no code with the product.

The mesh says which element: four nodes a tetrahedron are constant strain, ten (from `quadratic`)
are quadratic with straight sides. Total Lagrangian; loads are dead.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import LinearOperator, cg
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from dissection import Plan
from laws import LAWS, determinant, fibre_energy, fibre_stress, fibre_tangent
from laws import lame, volume_energy, volume_stress, volume_tangent

EDGES = np.array([(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)])
DEGREE = 6
CHUNK = 1000
SHARES = 0.5 ** np.arange(12)


class NoEquilibrium(ArithmeticError):
    """Newton's method finds no equilibrium without inverted tetrahedra."""


@dataclass
class Material:
    """A law's name and its constants [Pa], one for all tetrahedra or one each.

    `kap`, `a0`: fibre term; `penalty`: k of k/2 (V/V0 - 1)^2, for constant strain only.
    """

    law: object = "stableNeoHookean"
    lam: object = 0.0
    mu: object = 0.0
    kap: object = 0.0
    a0: object = (0.0, 0.0, 1.0)
    penalty: object = 0.0

    @classmethod
    def engineering(cls, law, young, poisson, **options):
        """From Young's modulus [Pa] and Poisson's ratio."""
        return cls(law, *lame(young, poisson), **options)

    def spread(self, count):
        """The same with a value for each of `count` tetrahedra."""
        values = [np.broadcast_to(v, count) for v in (self.law, self.lam, self.mu, self.kap)]
        a0 = np.broadcast_to(np.asarray(self.a0, float), (count, 3))
        return Material(*values, a0, np.broadcast_to(self.penalty, count))

    def at(self, chosen):
        """Of these tetrahedra."""
        names = ("law", "lam", "mu", "kap", "a0", "penalty")
        return Material(*(getattr(self, name)[chosen] for name in names))

    def energy(self, F):
        """psi at F, tetrahedra x points x 3 x 3."""
        return self._sum(F, 0, (fibre_energy, volume_energy))

    def stress(self, F):
        return self._sum(F, 1, (fibre_stress, volume_stress))

    def tangent(self, F):
        return self._sum(F, 2, (fibre_tangent, volume_tangent))

    def _sum(self, F, part, extra):
        total = np.zeros(F.shape[:2] + (3, 3) * part, F.dtype)
        for name in np.unique(self.law):
            mine = np.flatnonzero(self.law == name)
            total[mine] = LAWS[name][part](F[mine], self.lam[mine, None], self.mu[mine, None])
        if np.any(self.kap):
            total += extra[0](F, self.kap[:, None], self.a0[:, None])
        if np.any(self.penalty):
            total += extra[1](F, self.penalty[:, None])
        return total


def quadratic(nodes, tetrahedra):
    """The mesh with a node in the middle of each edge: new nodes follow the old ones."""
    ends = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    middle = len(nodes) + number.reshape(-1, 6)
    points = np.concatenate([nodes, nodes[edges].mean(axis=1)])
    return points, np.hstack([tetrahedra, middle])


def shape_slopes(order):
    """dN_a / d(barycentric coordinate k), points x a x k, and the points' weights."""
    if order == 1:
        return np.eye(4)[None], np.ones(1)
    x, weight = get_quadrature(RefTet, DEGREE)
    b = np.concatenate([1 - x.sum(axis=0, keepdims=True), x]).T
    slopes = np.zeros((len(b), 10, 4))
    for k in range(4):
        slopes[:, k, k] = 4 * b[:, k] - 1
    for a, (i, j) in enumerate(EDGES, 4):
        slopes[:, a, i], slopes[:, a, j] = 4 * b[:, j], 4 * b[:, i]
    return slopes, weight / weight.sum()


def lifted(tangent):
    """What makes it positive: tangents x points x 3 x 3 x 3 x 3, indexed as in laws.py."""
    value, vector = np.linalg.eigh(tangent.reshape(-1, 9, 9))
    short = np.maximum(-value, 0)[:, None]
    return (vector * short @ vector.swapaxes(-1, -2)).reshape(tangent.shape)


class Body:
    """Energy, forces and stiffness of a mesh of one material law a tetrahedron."""

    def __init__(self, nodes, tetrahedra, material):
        self.points, self.count = nodes, len(nodes)
        self.tetrahedra = np.asarray(tetrahedra)
        self.material = material.spread(len(self.tetrahedra))
        self._geometry()
        if self.weight.min() <= 0:
            raise ValueError("a tetrahedron of the mesh is flat or inverted")
        self.used = np.zeros(self.count, bool)
        self.used[self.tetrahedra] = True
        self._pairs()

    def _geometry(self):
        """dN_a/dX of each tetrahedron and point, and the points' volumes."""
        nodes = self.points
        order = {4: 1, 10: 2}[self.tetrahedra.shape[1]]
        if order == 2 and np.any(self.material.penalty):
            raise ValueError("the volume penalty is one of constant strain")
        sides = nodes[self.tetrahedra[:, 1:4]] - nodes[self.tetrahedra[:, :1]]
        inner = np.linalg.inv(sides).transpose(0, 2, 1)
        barycentric = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
        slopes, weight = shape_slopes(order)
        self.gradient = slopes @ barycentric[:, None]
        self.weight = np.linalg.det(sides)[:, None] / 6 * weight

    def _pairs(self):
        width = self.tetrahedra.shape[1]
        row = np.repeat(self.tetrahedra, width, axis=1).ravel()
        column = np.tile(self.tetrahedra, (1, width)).ravel()
        pairs, self.pair = np.unique(row * self.count + column, return_inverse=True)
        self.columns = pairs % self.count
        self.starts = np.searchsorted(pairs // self.count, np.arange(self.count + 1))
        ones = np.ones(len(pairs))
        self.graph = sparse.csr_matrix((ones, self.columns, self.starts), (self.count,) * 2)

    @property
    def noise(self):
        """Rounding in `force` [N]: stress is a difference of numbers like the moduli."""
        moduli = np.abs(self.material.lam) + 2 * self.material.mu + np.abs(self.material.kap)
        areas = np.einsum("tq,tqaJ->taJ", self.weight, np.abs(self.gradient))
        return 4 * np.finfo(float).eps * np.linalg.norm(moduli[:, None, None] * areas)

    def chunks(self):
        return [slice(k, k + CHUNK) for k in range(0, len(self.tetrahedra), CHUNK)]

    def deformation(self, u, part=slice(None)):
        """F of some tetrahedra, at each point."""
        moved = u[self.tetrahedra[part]].transpose(0, 2, 1)[:, None]
        return np.eye(3) + moved @ self.gradient[part]

    def volume_ratio(self, u):
        """The smallest det F."""
        return min(determinant(self.deformation(u, part)).min() for part in self.chunks())

    def energy(self, u):
        """W [J]."""
        return sum(
            np.sum(self.weight[part] * self._energy(self.deformation(u, part), part))
            for part in self.chunks()
        )

    def force(self, u):
        """dW/du, n x 3 [N]."""
        shares = np.empty(self.tetrahedra.shape + (3,))
        for part in self.chunks():
            stress = self._stress(self.deformation(u, part), part)
            weighted = self.weight[part][..., None, None] * stress
            shares[part] = (self.gradient[part] @ weighted.swapaxes(-1, -2)).sum(axis=1)
        nodes = self.tetrahedra.ravel()
        columns = shares.reshape(-1, 3).T
        return np.stack([np.bincount(nodes, c, self.count) for c in columns], axis=1)

    def _energy(self, F, part):
        return self.material.at(part).energy(F)

    def _stress(self, F, part):
        return self.material.at(part).stress(F)

    def _tangent(self, F, part):
        return self.material.at(part).tangent(F)

    def stiffness(self, u, share=0.0):
        """d2W/du2, 3n x 3n [N/m]; without this share of what is negative in a point's tangent."""
        width = self.tetrahedra.shape[1]
        shares = np.empty((len(self.tetrahedra), width, 3, width, 3))
        for part in self.chunks():
            shares[part] = self._stiffness(u, part, share)
        entries = shares.transpose(0, 1, 3, 2, 4).reshape(-1, 9)
        blocks = np.stack([np.bincount(self.pair, entries[:, k]) for k in range(9)], axis=1)
        blocks = blocks.reshape(-1, 3, 3)
        size = 3 * self.count
        return sparse.bsr_matrix((blocks, self.columns, self.starts), (size, size)).tocsr()

    def _stiffness(self, u, part, share):
        tangent = self._tangent(self.deformation(u, part), part)
        if share:
            tangent += share * lifted(tangent)
        tangent *= self.weight[part][..., None, None, None, None]
        gradient = self.gradient[part]
        t, q, a, _ = gradient.shape
        half = tangent.reshape(t, q, 27, 3) @ gradient.swapaxes(-1, -2)
        half = half.reshape(t, q, 3, 3, 3, a).transpose(0, 1, 3, 2, 5, 4).reshape(t, 3 * q, 9 * a)
        whole = gradient.transpose(0, 2, 1, 3).reshape(t, a, 3 * q) @ half
        return whole.reshape(t, a, 3, a, 3)


@dataclass
class Solution:
    """Displacement [m] and reaction of the supports [N], n x 3; `residual` is relative."""

    displacement: np.ndarray
    reaction: np.ndarray
    minimum_volume_ratio: float
    residual: float
    iterations: int
    energy: float


class Tangent:
    """Solves with the stiffness: by its factor, or by conjugate gradients with an earlier one."""

    def __init__(self, body, free):
        self.plan = Plan(body.points, body.graph, free)
        self.factor, self.share = None, 0.0

    def solve(self, matrix, right, stiffer):
        """matrix^-1 right on the free degrees of freedom, n x 3; zero elsewhere.

        `stiffer`: the matrix of a share, for where it is not positive definite.
        """
        x = np.zeros(right.size)
        dofs = self.plan.dofs
        x[dofs] = self._solve(matrix[dofs][:, dofs], right.ravel()[dofs], stiffer)
        return x.reshape(-1, 3)

    def _solve(self, matrix, right, stiffer):
        if self.factor is not None and not self.share:
            scaled = LinearOperator(matrix.shape, self.factor.solve, dtype=float)
            x, missed = cg(matrix, right, rtol=1e-5, maxiter=15, M=scaled)
            if not missed:
                return x
        self.factor = None
        self.factor = self._definite(matrix, stiffer)
        return self.factor.solve(right)

    def _definite(self, matrix, stiffer):
        """The factor with the smallest share that does; a quarter of the last one is tried first."""
        less = self.share / 4 if self.share > 0.02 else 0.0
        dofs = self.plan.dofs
        for self.share in sorted({less, self.share or 0.3, 1.0}):
            if self.share:
                matrix = stiffer(self.share)[dofs][:, dofs]
            try:
                return self.plan.factor(matrix)
            except np.linalg.LinAlgError:
                continue
        raise NoEquilibrium("the stiffness is not positive definite")


class Statics:
    """A body, its supports and its loads; `load` is the share of them that acts."""

    def __init__(self, body, held, value, force, tolerance, floor):
        self.body, self.value, self.external = body, value, force
        self.held, self.tolerance, self.floor = held, tolerance, floor
        self.free = ~held & body.used[:, None]
        self.tangent = Tangent(body, self.free) if self.free.any() else None
        self.noise = body.noise
        self.iterations = 0

    def lack(self, u, load):
        """Force on the free nodes, and its size beside the internal and external ones.

        Below rounding it counts as none.
        """
        internal = self.body.force(u)
        lack = np.where(self.free, load * self.external - internal, 0)
        scale = max(np.linalg.norm(internal), np.linalg.norm(load * self.external))
        size = np.linalg.norm(lack)
        return lack, size / scale if size > self.noise else 0.0

    def direction(self, u, right, jump=None):
        self.iterations += 1
        if self.tangent is None:
            return np.zeros(u.shape)
        matrix = self.body.stiffness(u)
        if jump is not None:
            right = right - (matrix @ jump.ravel()).reshape(-1, 3)
        return self.tangent.solve(matrix, right, lambda share: self.body.stiffness(u, share))

    def equilibrium(self, u, load, most=30):
        """Displacement under `load` and the relative residual, from the displacement under less."""
        jump = np.where(self.held, load * self.value - u, 0)
        u = u + jump + self.direction(u, self.lack(u, load)[0], jump)
        if self.body.volume_ratio(u) <= self.floor:
            raise NoEquilibrium("the first step inverts a tetrahedron")
        for _ in range(most):
            lack, relative = self.lack(u, load)
            if relative <= self.tolerance:
                return u, relative
            u = self.search(u, self.direction(u, lack), lack, load)
        raise NoEquilibrium(f"the residual stays at {relative:.1e}")

    def attempt(self, u):
        """The same under the whole load, or None."""
        try:
            return self.equilibrium(u, 1.0, 200)
        except NoEquilibrium:
            return None

    def potential(self, u, load):
        return self.body.energy(u) - load * np.sum(self.external * u)

    def search(self, u, direction, lack, load):
        """Along the direction, until residual or potential falls and nothing is inverted."""
        start, slope = self.potential(u, load), -np.sum(lack * direction)
        for share in SHARES:
            trial = u + share * direction
            if self.body.volume_ratio(trial) <= self.floor:
                continue
            if np.linalg.norm(self.lack(trial, load)[0]) < 0.9 * np.linalg.norm(lack):
                return trial
            if self.potential(trial, load) < start + 1e-4 * share * slope:
                return trial
        raise NoEquilibrium("no step along the search direction helps")


def brought_on(statics, u, steps, smallest):
    """Equilibrium under the whole load, from the displacement u under none."""
    load, step, residual = 0.0, 1 / steps, 0.0
    while load < 1:
        target = 1.0 if load + step > 1 - 1e-9 else load + step
        try:
            u, residual = statics.equilibrium(u, target)
        except NoEquilibrium:
            step /= 2
            if step < smallest / steps:
                raise
        else:
            load = target
    return u, residual


def solve(nodes, tetrahedra, material, held, value=None, force=None, steps=1, tolerance=1e-10,
          smallest=1e-3, start=None, floor=0.0, element=Body):
    """Static equilibrium; loads and prescribed displacements come on in `steps`, halved as needed.

    `held`: n x 3 of bool; `value`: n x 3, displacement where held; `force`: n x 3 [N]. Nodes
    without tetrahedra stay. `smallest`: share of a step under which it gives up, with
    NoEquilibrium. `start`: a displacement near the answer, tried first. `floor`: what det F stays
    above at every point; -inf lets tetrahedra invert, for a law that is made for it. `element`: Body
    or Bricks.
    """
    body = element(nodes, tetrahedra, material)
    zero = np.zeros(nodes.shape)
    value = zero if value is None else np.where(held, value, 0)
    force = zero if force is None else force
    statics = Statics(body, held, value, force, tolerance, floor)
    found = None if start is None else statics.attempt(start)
    u, residual = found or brought_on(statics, zero, steps, smallest)
    reaction = np.where(held & body.used[:, None], body.force(u) - force, 0)
    u = np.where(body.used[:, None], u, 0)
    ratio, energy = body.volume_ratio(u), body.energy(u)
    return Solution(u, reaction, ratio, residual, statics.iterations, energy)
