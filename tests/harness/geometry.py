"""Distances between a tool's capsule and triangles or tetrahedra, by plain formulas."""

import numpy as np


def point_segment(p, a, b):
    along = b - a
    s = np.clip(np.dot(p - a, along) / max(np.dot(along, along), 1e-300), 0, 1)
    return np.linalg.norm(p - a - s * along)


def point_triangle(p, corners):
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    area = np.dot(normal, normal)
    foot = [np.dot(np.cross(q - p, r - p), normal) / area for q, r in ((b, c), (c, a), (a, b))]
    if min(foot) >= 0:
        return abs(np.dot(p - a, normal)) / np.sqrt(area)
    return min(point_segment(p, q, r) for q, r in ((a, b), (b, c), (c, a)))


def nearest_on_triangles(p, corners):
    """Of each of n x 3 x 3 corners the point nearest to p, and the corners' weights."""
    a, b, c = (corners[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.einsum("ti,ti->t", normal, normal)
    inner = [np.einsum("ti,ti->t", np.cross(q - p, r - p), normal) / area for q, r in ((b, c), (c, a), (a, b))]
    weights = [np.stack(inner, axis=1)]
    for first, second in ((0, 1), (1, 2), (2, 0)):
        along = corners[:, second] - corners[:, first]
        share = np.einsum("ti,ti->t", p - corners[:, first], along) / np.einsum("ti,ti->t", along, along)
        edge = np.zeros((len(corners), 3))
        edge[:, second] = np.clip(share, 0, 1)
        edge[:, first] = 1 - edge[:, second]
        weights.append(edge)
    places = [np.einsum("tk,tki->ti", w, corners) for w in weights]
    distances = np.stack([np.linalg.norm(place - p, axis=1) for place in places])
    distances[0, weights[0].min(axis=1) < 0] = np.inf
    best = distances.argmin(axis=0), np.arange(len(corners))
    return np.stack(places)[best], np.stack(weights)[best]


def segment_segment(p, q, a, b):
    d, e, w = q - p, b - a, p - a
    dd, de, ee = np.dot(d, d), np.dot(d, e), np.dot(e, e)
    best = min(point_segment(p, a, b), point_segment(q, a, b), point_segment(a, p, q), point_segment(b, p, q))
    flat = dd * ee - de * de
    if flat > 1e-14 * dd * ee:
        s = (de * np.dot(e, w) - ee * np.dot(d, w)) / flat
        t = (dd * np.dot(e, w) - de * np.dot(d, w)) / flat
        if 0 <= s <= 1 and 0 <= t <= 1:
            best = min(best, np.linalg.norm(w + s * d - t * e))
    return best


def crosses(p, q, corners):
    """Whether a segment goes through a triangle."""
    a, b, c = corners
    matrix = np.stack([b - a, c - a, p - q], axis=1)
    if abs(np.linalg.det(matrix)) < 1e-30:
        return False
    x, y, s = np.linalg.solve(matrix, p - a)
    return x >= 0 and y >= 0 and x + y <= 1 and 0 <= s <= 1


def segment_triangle(p, q, corners):
    if crosses(p, q, corners):
        return 0.0
    a, b, c = corners
    edges = ((a, b), (b, c), (c, a))
    ends = min(point_triangle(p, corners), point_triangle(q, corners))
    return min(ends, *(segment_segment(p, q, r, s) for r, s in edges))


def segment_tetrahedron(p, q, corners):
    inside = np.linalg.solve((corners[1:] - corners[0]).T, p - corners[0])
    if inside.min() >= 0 and inside.sum() <= 1:
        return 0.0
    return min(segment_triangle(p, q, corners[list(f)]) for f in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)))


def exposed(tetrahedra):
    """Faces of one tetrahedron only, outward where the tetrahedra have positive volume."""
    faces = tetrahedra[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def segments_touched(points, cells, p, q, radius, distance):
    """Numbers of the cells (triangles or tetrahedra) closer to the segment than the radius."""
    p, q = np.asarray(p, float), np.asarray(q, float)
    low, high = np.minimum(p, q) - radius, np.maximum(p, q) + radius
    corners = points[cells]
    near = np.all((corners.max(1) >= low) & (corners.min(1) <= high), axis=1)
    return np.array([k for k in np.flatnonzero(near) if distance(p, q, corners[k]) < radius], int)
