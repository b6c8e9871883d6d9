//! Which tetrahedra move and which are pre-computed, and the order of the nodes that follows.
//!
//! Nodes in their order: those of dynamic tetrahedra, the shared ones ("connection nodes") last among
//! them; then those inside the pre-computed part: what tools can touch, what else is shown, the rest.
//! Each kind of node is one range, so that a state holds the first `known` nodes and a substep sweeps
//! over the first `moving` ones.

use super::order::reverse_cuthill_mckee;
use crate::mesh::TetMesh;
use crate::mesh::topology::{NONE, Topology};
use crate::scene::{
    Connection, ModelKind, OutputVertices, Scene, SceneError, select_nodes, select_tetrahedra,
};

/// Counts along the node order, and the kind of each tetrahedron.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parts {
    /// A tetrahedron each: has mass and tensors of its own. The others are pre-computed.
    pub dynamic: Vec<bool>,
    /// The first nodes: spares for vertices that cuts split.
    pub spares: usize,
    /// Nodes that are integrated, spares among them, connection nodes being the last of them.
    pub moving: usize,
    pub connection: usize,
    /// Pre-computed nodes after the moving ones that tools can touch.
    pub touchable: usize,
    /// Nodes whose displacement is ever known; those behind them only carry force.
    pub known: usize,
}

impl Parts {
    /// First connection node.
    pub fn connected_from(&self) -> usize {
        self.moving - self.connection
    }

    pub fn has_precomputed(&self) -> bool {
        self.dynamic.contains(&false)
    }
}

/// A mesh cut in two parts that share only connection nodes.
pub struct Partition {
    pub mesh: TetMesh,
    pub dynamic: Vec<bool>,
    /// Scene number of each node of `mesh`: copies of nodes that are shared but not connected come
    /// after the scene's own, and belong to the pre-computed part.
    pub origin: Vec<u32>,
}

impl Partition {
    pub fn new(scene: &Scene, mut mesh: TetMesh, file: &str) -> Result<Partition, SceneError> {
        let count = mesh.tetrahedra.len();
        let mut dynamic = vec![scene.model.kind != ModelKind::QuasiStatic; count];
        if let (ModelKind::Hybrid, Some(selector)) = (scene.model.kind, &scene.model.dynamic) {
            dynamic.fill(false);
            let selected = select_tetrahedra(selector, &mesh)
                .map_err(|e| SceneError::at(file, "model.dynamic", e))?;
            for t in selected {
                dynamic[t as usize] = true;
            }
        }
        let nodes = mesh.nodes.len();
        let mut origin: Vec<u32> = (0..nodes as u32).collect();
        if let Connection::Nodes(listed) = &scene.model.connection {
            let [own, other] = touched(&mesh, &dynamic);
            let mut connected = vec![false; nodes];
            for (k, node) in listed.iter().enumerate() {
                let i = *node as usize;
                if i >= nodes || !(own[i] && other[i]) {
                    return Err(SceneError::at(
                        file,
                        format!("model.connection.nodes[{k}]"),
                        format!(
                            "node {node} is not shared by the dynamic and the pre-computed part; connection nodes must be"
                        ),
                    ));
                }
                connected[i] = true;
            }
            let mut copy = vec![NONE; nodes];
            for (t, tetrahedron) in mesh.tetrahedra.iter_mut().enumerate() {
                if dynamic[t] {
                    continue;
                }
                for node in tetrahedron {
                    let i = *node as usize;
                    if own[i] && other[i] && !connected[i] {
                        if copy[i] == NONE {
                            copy[i] = origin.len() as u32;
                            origin.push(*node);
                            mesh.nodes.push(mesh.nodes[i]);
                        }
                        *node = copy[i];
                    }
                }
            }
        }
        Ok(Partition {
            mesh,
            dynamic,
            origin,
        })
    }

    /// Node order, `order[new] = old`, and the counts along it.
    pub fn order(&self, scene: &Scene, file: &str) -> Result<(Vec<u32>, Parts), SceneError> {
        let [own, other] = touched(&self.mesh, &self.dynamic);
        let nodes = self.mesh.nodes.len();
        let mut boundary = vec![false; nodes];
        for face in &Topology::new(&self.mesh).faces {
            if face.tetrahedra[1] == NONE {
                face.vertices
                    .iter()
                    .for_each(|v| boundary[*v as usize] = true);
            }
        }
        let mut reach = vec![!scene.tools.is_empty(); nodes];
        if let Some(selector) = &scene.model.touchable {
            reach.fill(false);
            let selected = select_nodes(selector, &self.mesh)
                .map_err(|e| SceneError::at(file, "model.touchable", e))?;
            for node in selected {
                reach[node as usize] = true;
            }
        }
        let shown = |v: usize| match scene.outputs.vertices {
            OutputVertices::All => true,
            OutputVertices::Surface => boundary[v],
            OutputVertices::None => false,
        };
        let kind: Vec<u8> = (0..nodes)
            .map(|v| match (own[v], other[v]) {
                (_, false) => 0,
                (true, true) => 1,
                _ if boundary[v] && reach[v] => 2,
                _ if shown(v) => 3,
                _ => 4,
            })
            .collect();
        let neighbours = super::neighbours(&self.mesh);
        let mut order = reverse_cuthill_mckee(&neighbours);
        order.sort_by_key(|v| kind[*v as usize]);
        let upto = |last: u8| kind.iter().filter(|k| **k <= last).count();
        let parts = Parts {
            dynamic: self.dynamic.clone(),
            spares: 0,
            moving: upto(1),
            connection: upto(1) - upto(0),
            touchable: upto(2) - upto(1),
            known: upto(3),
        };
        Ok((order, parts))
    }
}

/// Which nodes belong to dynamic tetrahedra, and which to others.
fn touched(mesh: &TetMesh, dynamic: &[bool]) -> [Vec<bool>; 2] {
    let mut of = [vec![false; mesh.nodes.len()], vec![false; mesh.nodes.len()]];
    for (tetrahedron, is_dynamic) in mesh.tetrahedra.iter().zip(dynamic) {
        for node in tetrahedron {
            of[usize::from(!is_dynamic)][*node as usize] = true;
        }
    }
    of
}
