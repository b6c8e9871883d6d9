"""The star rule, plainly: a vertex (an edge) is good if its live star hangs together by faces that contain it.

Corners of a tetrahedron are as in the scene; all have positive volume.
"""

from collections import deque
from itertools import combinations

import numpy as np
from meshes import volumes


def components(star, tetrahedra, core):
    """A star's tetrahedra in groups joined by shared faces that contain `core`; lowest member first."""
    groups = []
    left = set(star)
    while left:
        group, front = [], [min(left)]
        left.remove(front[0])
        while front:
            here = front.pop()
            group.append(here)
            for there in sorted(left):
                shared = set(tetrahedra[here]) & set(tetrahedra[there])
                if len(shared) == 3 and core <= shared:
                    left.remove(there)
                    front.append(there)
        groups.append(sorted(group))
    return groups


def bad_stars(tetrahedra, left):
    """Vertices and edges whose star among the tetrahedra `left` has split."""
    stars = {}
    for t in left:
        corners = [int(v) for v in tetrahedra[t]]
        for size in (1, 2):
            for core in combinations(sorted(corners), size):
                stars.setdefault(core, []).append(int(t))
    sets = [frozenset(int(v) for v in t) for t in tetrahedra]
    return [core for core, star in stars.items() if len(components(star, sets, set(core))) > 1]


def pieces(tetrahedra, left):
    """The tetrahedra `left` in groups that share faces."""
    owner, root = {}, {int(t): int(t) for t in left}

    def find(t):
        while root[t] != t:
            root[t] = root[root[t]]
            t = root[t]
        return t

    for t in root:
        for face in combinations(sorted(int(v) for v in tetrahedra[t]), 3):
            root[find(owner.setdefault(face, t))] = find(t)
    groups = {}
    for t in root:
        groups.setdefault(find(t), []).append(t)
    return list(groups.values())


class Tissue:
    """What events leave of a mesh: their tetrahedra go in ascending order, then what is not good.

    The order of the clean-up: vertices before edges, first in, first out. A removal brings in the edges round which
    it has parted its two neighbours, each with its ends. What is `spared` (pre-computed) cannot go: groups with some of
    it stay, and if these are nothing else, the largest of the others, too.
    """

    def __init__(self, nodes, tetrahedra, spared=()):
        self.spared = set(map(int, spared))
        self.volume = volumes(nodes, tetrahedra)
        self.tetrahedra = [tuple(int(v) for v in t) for t in tetrahedra]
        self.sets = [frozenset(t) for t in self.tetrahedra]
        self.alive = np.ones(len(tetrahedra), bool)
        self.stars = [[] for _ in nodes]
        owners = {}
        for t, corners in enumerate(self.tetrahedra):
            for k, v in enumerate(corners):
                self.stars[v].append(t)
                owners.setdefault(self.sets[t] - {v}, []).append(t)
        self.owners = owners

    @property
    def left(self):
        """Numbers of the tetrahedra that are alive."""
        return np.flatnonzero(self.alive)

    @property
    def gone(self):
        return np.flatnonzero(~self.alive)

    def across(self, t, face):
        """The live neighbour at a face, or None."""
        for other in self.owners[face]:
            if other != t and self.alive[other]:
                return other
        return None

    def parted(self, t, edge):
        """Whether the dead t has two live neighbours at the edge that no live tetrahedra link round it."""
        off = self.sets[t] - edge
        sides = [self.across(t, edge | {v}) for v in sorted(off)]
        if None in sides:
            return False
        star = [s for s in self.stars[min(edge)] if self.alive[s] and edge <= self.sets[s]]
        return not any(set(sides) <= set(group) for group in components(star, self.sets, edge))

    def largest(self, groups):
        """Of the largest volume; of volumes within 1e-9 of it, the one with the lowest tetrahedron."""
        groups = sorted(groups, key=min)
        best = groups[0]
        for group in groups[1:]:
            if self.volume[group].sum() > self.volume[best].sum() * (1 + 1e-9):
                best = group
        return best

    def event(self, chosen):
        """Removes these, then cleans up."""
        vertices, edges = deque(), deque()

        def note(queue, core):
            if core not in queue:
                queue.append(core)

        def remove(t):
            if not self.alive[t]:
                return
            self.alive[t] = False
            for ends in combinations(self.tetrahedra[t], 2):
                edge = frozenset(ends)
                if self.parted(t, edge):
                    note(edges, edge)
                    for v in ends:
                        note(vertices, frozenset([v]))

        for t in sorted(chosen):
            remove(t)
        while vertices or edges:
            core = (vertices or edges).popleft()
            star = [t for t in self.stars[min(core)] if self.alive[t] and core <= self.sets[t]]
            groups = components(star, self.sets, core)
            if len(groups) > 1:
                stays = [group for group in groups if self.spared & set(group)]
                if all(self.spared >= set(group) for group in stays):
                    others = [group for group in groups if group not in stays]
                    if others:
                        stays.append(self.largest(others))
                for t in star:
                    if not any(t in group for group in stays):
                        remove(t)
        return self
