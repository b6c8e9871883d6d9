"""Linear stiffness of elements that share points at their vertices, from their energies by sparse products.

Shares no code with the product: gradients G_t are rows of one matrix, means over the stars of vertices another.
"""

import numpy as np
import scipy.sparse as sparse

from meshes import volumes

HOURGLASS = 0.3
MOST_POISSON_RATIO = 0.49


def gradients(nodes, tetrahedra):
    """9 t x 3 n: displacement gradients, row 9 t + 3 i + j being du_i/dx_j of tetrahedron t."""
    edges = nodes[tetrahedra[:, 1:]] - nodes[tetrahedra[:, :1]]
    shapes = np.linalg.inv(edges).transpose(0, 2, 1)
    shapes = np.concatenate([-shapes.sum(axis=1, keepdims=True), shapes], axis=1)
    t, corner, i, j = np.meshgrid(*map(np.arange, (len(tetrahedra), 4, 3, 3)), indexing="ij")
    places = (9 * t + 3 * i + j).ravel(), (3 * tetrahedra[t, corner] + i).ravel()
    return sparse.csr_matrix((shapes[t, corner, j].ravel(), places), (9 * len(tetrahedra), 3 * len(nodes)))


def stiffness(tissue):
    """K [N/m], 3 n x 3 n, of `tissue.element`; means go over tetrahedra of one material and one `part`."""
    averaged = tissue.element == "nodalAveraged"
    poisson = np.minimum(tissue.poisson, MOST_POISSON_RATIO) if averaged else tissue.poisson
    lam = tissue.young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    mu = tissue.young / (2 * (1 + poisson))
    count, tetrahedra = len(tissue.tetrahedra), tissue.tetrahedra
    volume = volumes(tissue.nodes, tetrahedra)
    kinds = np.stack([tissue.young, tissue.poisson, tissue.density, np.broadcast_to(tissue.part, count)])
    kind = np.unique(kinds, axis=1, return_inverse=True)[1].ravel()
    keys = np.stack([tetrahedra.ravel(), np.repeat(kind, 4)])
    points, point = np.unique(keys, axis=1, return_inverse=True)
    point, star = point.ravel(), np.repeat(np.arange(count), 4)
    share = volume[star] / 4
    size = np.bincount(point, share)
    mean = sparse.csr_matrix((share / size[point], (point, star)), (points.shape[1], count))
    # Of any tetrahedron of the point: they have the same.
    law = np.zeros(points.shape[1], int)
    law[point] = star
    every = gradients(tissue.nodes, tetrahedra)
    means = sparse.kron(mean, sparse.identity(9)) @ every

    def energy(rows, weight, lam, mu):
        """sum weight (lam tr(eps)^2 + 2 mu eps:eps), twice the energy."""
        trace = np.eye(3).ravel()
        turn = np.eye(9)[[0, 3, 6, 1, 4, 7, 2, 5, 8]]
        strain = (np.eye(9) + turn) / 2
        blocks = lam[:, None, None] * np.outer(trace, trace) + 2 * mu[:, None, None] * strain
        return rows.T @ sparse.block_diag(list(weight[:, None, None] * blocks), "csr") @ rows

    none = np.zeros(points.shape[1])
    if not averaged:
        whole = energy(every, volume, np.zeros(count), mu)
        return whole + energy(means, size, lam[law], none)
    hourglass = sparse.diags(np.repeat(volume * mu, 9)), sparse.diags(np.repeat(size * mu[law], 9))
    variance = every.T @ hourglass[0] @ every - means.T @ hourglass[1] @ means
    return energy(means, size, lam[law], mu[law]) + HOURGLASS * variance
