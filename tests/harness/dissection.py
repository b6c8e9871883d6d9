"""Sparse Cholesky factor: dissection of a mesh (George 1973), dense fronts (Duff, Reid 1983).

scipy has neither a Cholesky factor nor a dissection; its LU needs far more memory and time.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.blas import dgemm

LEAF = 60
QUANTILES = (0.4, 0.45, 0.5, 0.55, 0.6)


def separated(points, graph, nodes):
    """Low, high and what separates them, the smallest of some cuts across the longest side."""
    axis = np.argmax(np.ptp(points[nodes], axis=0))
    along = points[nodes, axis]
    best = None
    for cut in np.unique(np.quantile(along, QUANTILES, method="lower")):
        low = along <= cut + 1e-12
        high = np.zeros(graph.shape[0])
        high[nodes[~low]] = 1
        between = nodes[low][graph[nodes[low]] @ high > 0]
        if not len(between):
            between = nodes[low][:1]
        if best is None or len(between) < len(best[2]):
            best = np.setdiff1d(nodes[low], between), nodes[~low], between
    return best


def dissect(points, graph, nodes):
    """Fronts (nodes to eliminate, numbers of the fronts below), each after its children."""
    fronts = []

    def visit(nodes):
        children = []
        if len(nodes) > LEAF:
            low, high, between = separated(points, graph, nodes)
            if len(low) and len(high):
                children, nodes = [visit(low), visit(high)], between
        fronts.append((nodes, children))
        return len(fronts) - 1

    visit(nodes)
    return fronts


@dataclass
class Front:
    """Rows of the factor, in its order: the first `pivots` end here, the rest are passed on."""

    rows: np.ndarray
    pivots: int
    children: list


class Plan:
    """Order and structure of the factor for the free degrees of freedom of a mesh."""

    def __init__(self, points, graph, free):
        """`graph`: nodes by nodes; `free`: n x 3 of bool."""
        fronts = dissect(points, graph, np.flatnonzero(free.any(axis=1)))
        order = np.concatenate([nodes for nodes, _ in fronts])
        place = np.full(len(points), len(order))
        place[order] = np.arange(len(order))
        share = free[order].sum(axis=1)
        self.dofs = (3 * order[:, None] + np.arange(3))[free[order]]
        first = np.concatenate([[0], np.cumsum(share)])
        self.fronts, passed, done = [], [], 0
        for nodes, children in fronts:
            done += len(nodes)
            near = [place[graph[nodes].indices], *(passed[c] for c in children)]
            later = np.unique(np.concatenate(near))
            passed.append(later[(later >= done) & (later < len(order))])
            used = np.concatenate([np.arange(done - len(nodes), done), passed[-1]])
            rows = np.concatenate([np.arange(first[k], first[k + 1]) for k in used])
            self.fronts.append(Front(rows, first[done] - first[done - len(nodes)], children))

    def factor(self, matrix):
        """Of a matrix in the order of `dofs`; LinAlgError if it is not positive definite."""
        return Factor(self, matrix.tocsc())


class Factor:
    def __init__(self, plan, matrix):
        self.plan, self.panels, passed = plan, [], {}
        for number, front in enumerate(plan.fronts):
            children = [(plan.fronts[c], passed.pop(c, None)) for c in front.children]
            dense, p = gathered(matrix, front, children), front.pivots
            corner = cholesky(dense[:p, :p], lower=True, check_finite=False)
            below = solve_triangular(corner, dense[p:, :p].T, lower=True, check_finite=False).T
            below = np.asfortranarray(below)
            if below.size:
                rest = np.asfortranarray(dense[p:, p:])
                passed[number] = dgemm(-1, below, below, 1, rest, trans_b=True, overwrite_c=True)
            self.panels.append((corner, below))

    @property
    def entries(self):
        return sum(corner.size + below.size for corner, below in self.panels)

    def solve(self, right):
        """x of matrix x = right, in the order of plan.dofs."""
        x = right.astype(float)
        for front, (corner, below) in zip(self.plan.fronts, self.panels):
            mine, later = np.split(front.rows, [front.pivots])
            x[mine] = solve_triangular(corner, x[mine], lower=True, check_finite=False)
            x[later] -= below @ x[mine]
        for front, (corner, below) in zip(self.plan.fronts[::-1], self.panels[::-1]):
            mine, later = np.split(front.rows, [front.pivots])
            rest = x[mine] - below.T @ x[later]
            x[mine] = solve_triangular(corner, rest, lower=True, trans=1, check_finite=False)
        return x


def gathered(matrix, front, children):
    """The front's dense matrix: its columns of the sparse one, and what its children pass on."""
    dense = np.zeros((len(front.rows),) * 2, order="F")
    first, last = front.rows[0], front.rows[front.pivots - 1]
    starts = matrix.indptr[first:last + 2]
    column = np.repeat(np.arange(front.pivots), np.diff(starts))
    row, data = matrix.indices[starts[0]:starts[-1]], matrix.data[starts[0]:starts[-1]]
    mine = row >= first
    dense[np.searchsorted(front.rows, row[mine]), column[mine]] = data[mine]
    for child, rest in children:
        if rest is not None:
            where = np.searchsorted(front.rows, child.rows[child.pivots:])
            dense.T[where[:, None], where] += rest.T
    return dense
