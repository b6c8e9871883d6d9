"""Linear elasticity assembled by scikit-fem and solved by scipy: shares no code with the product.

Degrees of freedom are 3 node + axis. Damping is mass-proportional: M a + c M v + K u = f.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh, splu
from skfem import Basis, BilinearForm, ElementTetP0, ElementTetP1, ElementVector, MeshTet
from skfem.helpers import ddot, eye, sym_grad, trace

import averaged
from meshes import volumes


@BilinearForm
def elasticity(u, v, w):
    strain = sym_grad(u)
    stress = 2 * w.mu * strain + eye(w.lam * trace(strain), 3)
    return ddot(stress, sym_grad(v))


@dataclass
class Tissue:
    """Nodes, tetrahedra, and a value of E, nu and rho for each tetrahedron (or one for all).

    Elements that take means take them within a `part`.
    """

    nodes: np.ndarray
    tetrahedra: np.ndarray
    young: object = 6000.0
    poisson: object = 0.45
    density: object = 1060.0
    element: str = "constantStrain"
    part: object = 0

    def __post_init__(self):
        count = len(self.tetrahedra)
        for name in ("young", "poisson", "density", "part"):
            setattr(self, name, np.broadcast_to(np.asarray(getattr(self, name), float), count))

    def without(self, removed):
        """What is left when these tetrahedra are gone; node numbers stay."""
        keep = np.setdiff1d(np.arange(len(self.tetrahedra)), removed)
        each = (self.young, self.poisson, self.density)
        return Tissue(self.nodes, self.tetrahedra[keep], *(of[keep] for of in each), self.element, self.part[keep])

    @property
    def used(self):
        """Nodes with tetrahedra, sorted."""
        return np.unique(self.tetrahedra)

    def stiffness(self):
        """K [N/m], 3n x 3n; rows of unused nodes are empty."""
        if self.element != "constantStrain":
            return averaged.stiffness(self).tocsr()
        used = self.used
        local = np.searchsorted(used, self.tetrahedra)
        mesh = MeshTet(self.nodes[used].T.copy(), local.T.copy(), sort_t=False)
        basis = Basis(mesh, ElementVector(ElementTetP1()))
        constant = basis.with_element(ElementTetP0())
        lam = self.young * self.poisson / ((1 + self.poisson) * (1 - 2 * self.poisson))
        mu = self.young / (2 * (1 + self.poisson))
        matrix = elasticity.assemble(basis, lam=constant.interpolate(lam), mu=constant.interpolate(mu)).tocoo()
        place = np.empty(basis.N, int)
        for axis in range(3):
            place[basis.nodal_dofs[axis]] = 3 * used + axis
        size = 3 * len(self.nodes)
        return sparse.csr_matrix((matrix.data, (place[matrix.row], place[matrix.col])), shape=(size, size))

    def mass(self):
        """Lumped, a quarter of each tetrahedron's [kg]."""
        share = self.density * volumes(self.nodes, self.tetrahedra) / 4
        return np.bincount(self.tetrahedra.ravel(), np.repeat(share, 4), minlength=len(self.nodes))

    def weight(self, gravity):
        """n x 3 [N]."""
        return self.mass()[:, None] * np.asarray(gravity, float)


def statics(tissue, force, held, value=None):
    """Displacement [m] and reaction of the supports [N], n x 3.

    `force`: n x 3; `held`: n x 3 of bool; `value`: n x 3, displacement where held. Unused nodes stay.
    """
    count = len(tissue.nodes)
    matrix = tissue.stiffness()
    u = np.zeros(3 * count)
    fixed = held.ravel().copy()
    if value is not None:
        u[fixed] = np.asarray(value).ravel()[fixed]
    used = np.zeros(count, bool)
    used[tissue.used] = True
    free = np.flatnonzero(~fixed & np.repeat(used, 3))
    f = np.asarray(force, float).ravel()
    inner = matrix[free][:, free].tocsc()
    factor = splu(inner)
    for _ in range(3):
        u[free] += factor.solve((f - matrix @ u)[free])
    reaction = np.where(fixed & np.repeat(used, 3), matrix @ u - f, 0)
    u[~np.repeat(used, 3)] = 0
    return u.reshape(-1, 3), reaction.reshape(-1, 3)


def highest_frequency(tissue, held, mass=None):
    """sqrt of the largest eigenvalue of M^-1 K on the free degrees of freedom [1/s]."""
    mass = tissue.mass() if mass is None else mass
    free = np.flatnonzero(~held.ravel() & np.repeat(mass > 0, 3))
    root = sparse.diags(1 / np.sqrt(np.repeat(mass, 3)[free]))
    matrix = root @ tissue.stiffness()[free][:, free] @ root
    return np.sqrt(eigsh(matrix, k=1, which="LA", tol=1e-8, return_eigenvectors=False)[0])


def modal_history(tissue, damping, force, held, start, times, mass=None):
    """Exact motion under a constant force from rest at `start`: displacement at `times`, t x n x 3."""
    count = len(tissue.nodes)
    mass = np.repeat(tissue.mass() if mass is None else mass, 3)
    free = np.flatnonzero(~held.ravel() & (mass > 0))
    root = np.sqrt(mass[free])
    matrix = tissue.stiffness()[free][:, free].toarray() / root[:, None] / root
    value, vector = eigh(matrix)
    settled = vector.T @ (np.asarray(force, float).ravel()[free] / root) / value
    offset = vector.T @ (np.asarray(start, float).ravel()[free] * root) - settled
    half = damping / 2
    spread = np.sqrt((value - half**2).astype(complex))
    history = np.zeros((len(times), 3 * count))
    for k, t in enumerate(times):
        shape = (np.exp(-half * t) * (np.cos(spread * t) + half * t * np.sinc(spread * t / np.pi))).real
        history[k, free] = (vector @ (settled + offset * shape)) / root
    return history.reshape(len(times), count, 3)


def driven_history(tissue, damping, force, held, path, speed, times, mass=None):
    """Motion from rest while held degrees follow `path(t)` (n x 3) at `speed(t)`; `force(t)`: n x 3.

    DOP853, rtol 1e-10. Returns displacement t x n x 3.
    """
    mass = np.repeat(tissue.mass() if mass is None else mass, 3)
    fixed = held.ravel()
    free = np.flatnonzero(~fixed & (mass > 0))
    matrix = tissue.stiffness()
    inner, outer = matrix[free][:, free], matrix[free][:, np.flatnonzero(fixed)]

    def rate(t, y):
        u, v = np.split(y, 2)
        pulled = outer @ path(t).ravel()[fixed]
        a = (force(t).ravel()[free] - inner @ u - pulled) / mass[free] - damping * v
        return np.concatenate([v, a])

    y0 = np.zeros(2 * len(free))
    solved = solve_ivp(rate, (0, times[-1]), y0, "DOP853", t_eval=times, rtol=1e-10, atol=1e-13)
    history = np.zeros((len(times), 3 * len(tissue.nodes)))
    history[:, free] = solved.y[: len(free)].T
    for k, t in enumerate(times):
        history[k, fixed] = path(t).ravel()[fixed]
    return history.reshape(len(times), -1, 3)


def modes(tissue, held, count):
    """The lowest eigenvalues omega^2 of M^-1 K [1/s2]."""
    free = np.flatnonzero(~np.asarray(held).ravel() & np.repeat(tissue.mass() > 0, 3))
    stiffness = tissue.stiffness()[free][:, free].tocsc()
    mass = sparse.diags(np.repeat(tissue.mass(), 3)[free]).tocsc()
    return np.sort(eigsh(stiffness, count, mass, sigma=0, return_eigenvectors=False))
