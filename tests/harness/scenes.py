"""Scenes and, for each, the same problem for the oracle."""

from dataclasses import dataclass, field

import numpy as np

import meshes
from oracle import Tissue

G = [0.0, 0.0, -9.81]


def inline(nodes, tetrahedra):
    return {"nodes": np.asarray(nodes).tolist(), "tetrahedra": np.asarray(tetrahedra).tolist()}


def scene(name, mesh, **keys):
    """A scene of one soft material whose FMU shows all vertices."""
    base = {
        "name": name,
        "mesh": inline(*mesh) if isinstance(mesh, tuple) else mesh,
        "materials": [{"where": {"all": True}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}],
        "outputs": {"vertices": "all"},
    }
    return base | keys


@dataclass
class Problem:
    """A scene next to what the oracle needs; conditions are entered once and go to both."""

    name: str
    mesh: tuple
    gravity: list = field(default_factory=lambda: list(G))

    def __post_init__(self):
        self.nodes, self.tetrahedra = self.mesh
        self.scene = scene(self.name, self.mesh, gravity=self.gravity)
        self.tissue = Tissue(self.nodes, self.tetrahedra)
        self.held = np.zeros(self.nodes.shape, bool)
        self.value = np.zeros(self.nodes.shape)
        self.loads = np.zeros(self.nodes.shape)

    @property
    def force(self):
        return self.tissue.weight(self.gravity) + self.loads

    def at(self, low, high):
        return meshes.inside(self.nodes, low, high)

    def face(self, axis, value):
        return np.flatnonzero(np.abs(self.nodes[:, axis] - value) < 1e-9)

    def material(self, tetrahedra, young, poisson, density):
        for name, value in (("young", young), ("poisson", poisson), ("density", density)):
            changed = getattr(self.tissue, name).copy()
            changed[tetrahedra] = value
            setattr(self.tissue, name, changed)
        self.scene["materials"].append({
            "where": {"tetrahedra": [int(t) for t in tetrahedra]},
            "youngModulus": young, "poissonRatio": poisson, "density": density,
        })
        return self

    def fix(self, nodes, axes="xyz"):
        where = {"nodes": [int(i) for i in nodes]}
        entry = where if axes == "xyz" else {"where": where, "axes": axes}
        self.scene.setdefault("fixed", []).append(entry)
        for axis in axes:
            self.held[nodes, "xyz".index(axis)] = True
        return self

    def prescribe(self, nodes, displacement, ramp=0.5):
        self.scene.setdefault("prescribed", []).append({
            "where": {"nodes": [int(i) for i in nodes]}, "displacement": displacement, "ramp": ramp})
        for axis, value in enumerate(displacement):
            if value is not None:
                self.held[nodes, axis] = True
                self.value[nodes, axis] = value
        return self

    def load(self, nodes, force, ramp=0.0):
        self.scene.setdefault("loads", []).append({
            "where": {"nodes": [int(i) for i in nodes]}, "force": force, "ramp": ramp})
        self.loads[nodes] += force
        return self

    def cut(self, tetrahedra, time=0.0):
        self.scene.setdefault("cuts", []).append({
            "time": time, "where": {"tetrahedra": [int(t) for t in tetrahedra]}})
        return self

    def tool(self, name, kind, position, radius=0.004, length=None, orientation=(1, 0, 0, 0), active=None):
        shape = {"sphere": {"radius": radius}} if length is None else {"capsule": {"radius": radius, "length": length}}
        entry = {"name": name, "kind": kind, "shape": shape, "position": list(position),
                 "orientation": list(orientation)}
        if active is not None:
            entry["activeLength"] = active
        self.scene.setdefault("tools", []).append(entry)
        return self

    def set(self, **keys):
        for key, value in keys.items():
            known = self.scene.get(key)
            self.scene[key] = known | value if isinstance(known, dict) and isinstance(value, dict) else value
        return self


SIZE = (0.10, 0.05, 0.02)


def plate(name="plate", cells=(8, 4, 2), mesh=None, clamp=True, **options):
    """A small plate, clamped at x = 0."""
    problem = Problem(name, mesh or meshes.kuhn(SIZE, cells), **options)
    return problem.fix(problem.face(0, 0.0)) if clamp else problem


def slit(problem, share=0.5):
    """Tetrahedra of a slit across the plate from y = 0, one cell wide."""
    c = meshes.centroids(problem.nodes, problem.tetrahedra)
    cell = SIZE[0] / 8
    return np.flatnonzero((np.abs(c[:, 0] - 3.5 * cell) < 0.5 * cell) & (c[:, 1] < share * SIZE[1]))


def three_tools(name="theatre"):
    """A plate that sags a little, and a probe, a grasper and a cautery round it."""
    problem = plate(name, gravity=[0.0, 0.0, -0.5])
    problem.tool("probe", "probe", (0.045, 0.025, 0.030), radius=0.004)
    problem.tool("grasper", "grasper", (0.0875, 0.025, 0.023), radius=0.0045, length=0.1,
                 orientation=(0, 1, 0, 0), active=0.006)
    problem.tool("cautery", "cautery", (0.0625, -0.02, -0.03), radius=0.0015, length=0.1,
                 orientation=(0, 1, 0, 0), active=0.09)
    return problem
