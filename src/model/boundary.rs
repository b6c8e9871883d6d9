//! What the scene holds, moves and pulls: fixed, prescribed and loaded nodes.

use crate::mesh::{TetMesh, Vec3};
use crate::scene::{Scene, SceneError, select_nodes};

/// A node that follows a ramp on some of its axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrescribedNode {
    pub node: u32,
    pub axes: [bool; 3],
    /// Full displacement \[m\].
    pub displacement: Vec3,
    /// \[s\] an axis.
    pub ramp: [f64; 3],
}

impl PrescribedNode {
    /// Displacement at a time \[s\] from the start.
    pub fn at(&self, time: f64) -> Vec3 {
        Vec3::from_fn(|axis, _| self.displacement[axis] * ramp(time, self.ramp[axis]))
    }
}

/// A load that grows over a ramp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadedNode {
    pub node: u32,
    /// \[N\]
    pub force: Vec3,
    /// \[s\]
    pub ramp: f64,
}

/// 0 at time 0, 1 from `length` on.
pub fn ramp(time: f64, length: f64) -> f64 {
    if time >= length {
        1.0
    } else {
        (time / length).max(0.0)
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Boundary {
    /// Axes of each node that neither fixed nor prescribed entries hold.
    pub free: Vec<[bool; 3]>,
    /// Nodes held at rest on some axis.
    pub fixed: Vec<[bool; 3]>,
    pub prescribed: Vec<PrescribedNode>,
    /// Nodes that are not free on all axes, ascending.
    pub supported: Vec<u32>,
    /// By node.
    pub loads: Vec<LoadedNode>,
}

impl Boundary {
    /// Node numbers as in `mesh`.
    pub fn new(scene: &Scene, mesh: &TetMesh, file: &str) -> Result<Boundary, SceneError> {
        let count = mesh.nodes.len();
        let mut boundary = Boundary {
            free: vec![[true; 3]; count],
            fixed: vec![[false; 3]; count],
            ..Boundary::default()
        };
        for (k, entry) in scene.fixed.iter().enumerate() {
            let nodes = select_nodes(&entry.selector, mesh)
                .map_err(|e| SceneError::at(file, format!("fixed[{k}]"), e))?;
            for node in nodes {
                for axis in 0..3 {
                    if entry.axes[axis] {
                        boundary.free[node as usize][axis] = false;
                        boundary.fixed[node as usize][axis] = true;
                    }
                }
            }
        }
        let mut moved: std::collections::BTreeMap<u32, PrescribedNode> = Default::default();
        for (k, entry) in scene.prescribed.iter().enumerate() {
            let path = || format!("prescribed[{k}]");
            let nodes = select_nodes(&entry.selector, mesh)
                .map_err(|e| SceneError::at(file, format!("{}.where", path()), e))?;
            for node in nodes {
                let target = moved.entry(node).or_insert(PrescribedNode {
                    node,
                    axes: [false; 3],
                    displacement: Vec3::zeros(),
                    ramp: [0.0; 3],
                });
                for axis in 0..3 {
                    let Some(value) = entry.displacement[axis] else {
                        continue;
                    };
                    let name = ["x", "y", "z"][axis];
                    if boundary.fixed[node as usize][axis] || target.axes[axis] {
                        let other = if target.axes[axis] {
                            "prescribed twice"
                        } else {
                            "fixed, too"
                        };
                        return Err(SceneError::at(
                            file,
                            path(),
                            format!(
                                "node {node} is {other} along {name}; hold each axis of a node once"
                            ),
                        ));
                    }
                    boundary.free[node as usize][axis] = false;
                    target.axes[axis] = true;
                    target.displacement[axis] = value;
                    target.ramp[axis] = entry.ramp;
                }
            }
        }
        boundary.prescribed = moved.into_values().collect();
        for (k, entry) in scene.loads.iter().enumerate() {
            let nodes = select_nodes(&entry.selector, mesh)
                .map_err(|e| SceneError::at(file, format!("loads[{k}].where"), e))?;
            boundary
                .loads
                .extend(nodes.into_iter().map(|node| LoadedNode {
                    node,
                    force: Vec3::from(entry.force),
                    ramp: entry.ramp,
                }));
        }
        Ok(boundary)
    }

    /// Full values from time 0: what an equilibrium at the start is that of.
    pub fn end_ramps(&mut self) {
        self.prescribed.iter_mut().for_each(|p| p.ramp = [0.0; 3]);
        self.loads.iter_mut().for_each(|l| l.ramp = 0.0);
    }

    /// Loads on one node.
    pub fn loads_on(&self, node: u32) -> &[LoadedNode] {
        let from = self.loads.partition_point(|l| l.node < node);
        let count = self.loads[from..].partition_point(|l| l.node == node);
        &self.loads[from..from + count]
    }

    /// The same with other node numbers, `new_number[old]` and `old_number[new]`. Where two new nodes
    /// have the same old number both are held, but only the first named carries the load.
    pub fn renumbered(self, new_number: &[u32], old_number: &[u32]) -> Boundary {
        // Spares have no old number.
        let axes = |of: &[[bool; 3]], old: u32| of.get(old as usize).copied().unwrap_or_default();
        let held = |of: &[[bool; 3]]| old_number.iter().map(|old| axes(of, *old)).collect();
        let mut loads: Vec<LoadedNode> = (self.loads.iter())
            .map(|l| LoadedNode {
                node: new_number[l.node as usize],
                ..*l
            })
            .collect();
        loads.sort_by_key(|l| l.node);
        let mut prescribed = Vec::new();
        for p in &self.prescribed {
            let first = new_number[p.node as usize];
            prescribed.push(PrescribedNode { node: first, ..*p });
        }
        for (new, old) in old_number.iter().enumerate() {
            let is_copy = new_number
                .get(*old as usize)
                .is_some_and(|first| *first as usize != new);
            if let Some(p) = self.prescribed.iter().find(|p| is_copy && p.node == *old) {
                prescribed.push(PrescribedNode {
                    node: new as u32,
                    ..*p
                });
            }
        }
        Boundary {
            free: held(&self.free),
            fixed: held(&self.fixed),
            prescribed,
            supported: Vec::new(),
            loads,
        }
    }
}
