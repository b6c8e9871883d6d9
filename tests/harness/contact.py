"""A frictionless ball pressed on linear tissue: equilibrium by active sets, sharing no code with the product.

The surface is flat triangles; the ball may touch each of them where it is nearest. Linearised places, a dense compliance
of their normals and non-negative least squares, again until nothing moves.
"""

import numpy as np
from scipy.optimize import nnls
from scipy.sparse.linalg import splu

from geometry import exposed, nearest_on_triangles


def pressed(tissue, held, force, start, centre, radius, stages=10, most=100):
    """Displacement n x 3 [m] and the force on the ball [N] at rest, where it has come from `start` in some stages."""
    nodes, count = tissue.nodes, len(tissue.nodes)
    matrix = tissue.stiffness().tocsc()
    free = np.flatnonzero(~held.ravel())
    factor = splu(matrix[free][:, free])
    alone = np.zeros(3 * count)
    alone[free] = factor.solve(np.asarray(force).ravel()[free])
    faces = exposed(tissue.tetrahedra)
    u, known = alone.copy(), {}

    def column(rows):
        """K^-1 of unit forces on a few degrees of freedom, kept."""
        right = np.zeros((3 * count, len(rows)))
        right[rows, range(len(rows))] = 1
        solved = np.zeros_like(right)
        solved[free] = factor.solve(right[free])
        known.update(zip(rows, solved.T))

    for stage in range(1, stages + 1):
        at = np.asarray(start) + (np.asarray(centre) - start) * (stage / stages)
        for k in range(most):
            x = nodes + u.reshape(-1, 3)
            place, weight = nearest_on_triangles(at, x[faces])
            away = place - at
            gap = np.linalg.norm(away, axis=1) - radius
            near = np.flatnonzero(gap < 0.2 * radius)
            normal = away[near] / np.linalg.norm(away[near], axis=1)[:, None]
            # A node that several triangles share is one place.
            _, one = np.unique(np.round(place[near] / radius, 9), axis=0, return_index=True)
            near, normal = near[one], normal[one]
            rows = np.zeros((len(near), 3 * count))
            for row, face in enumerate(faces[near]):
                for node, w in zip(face, weight[near[row]]):
                    rows[row, 3 * node : 3 * node + 3] += w * normal[row]
            used = np.flatnonzero(np.abs(rows).sum(axis=0) > 0)
            missing = [dof for dof in used if dof not in known]
            if missing:
                column(missing)
            answer = sum(np.outer(rows[:, dof], known[dof]) for dof in used)
            compliance = rows @ answer.T
            apart = gap[near] + rows @ (alone - u)
            root = np.linalg.cholesky(compliance + 1e-10 * np.trace(compliance) * np.eye(len(near)))
            pushed, _ = nnls(root.T, -np.linalg.solve(root, apart), maxiter=10000)
            moved = alone + pushed @ answer
            change = np.abs(moved - u).max()
            # Places jump from triangle to triangle: ever shorter steps.
            u = u + (moved - u) / (2 + k / 5)
            if change < 1e-4 * np.abs(moved).max():
                break
        else:
            raise AssertionError(f"still moves by {change:.1e} m")
    return u.reshape(-1, 3), -(pushed[:, None] * normal).sum(axis=0)
