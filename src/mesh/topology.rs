//! Who touches whom: faces and their tetrahedra, stars of vertices. Made once, never changed.

use super::TetMesh;

/// No tetrahedron, no place.
pub const NONE: u32 = u32::MAX;

/// A triangle between two tetrahedra, or on the boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Seen from outside `tetrahedra[0]`, counter-clockwise.
    pub vertices: [u32; 3],
    /// The second is [`NONE`] on the boundary.
    pub tetrahedra: [u32; 2],
}

/// Adjacency of a mesh whose tetrahedra are positively oriented.
#[derive(Clone, Debug)]
pub struct Topology {
    pub faces: Vec<Face>,
    /// Faces of each tetrahedron; the j-th lies opposite its vertex j.
    pub tetrahedron_faces: Vec<[u32; 4]>,
    /// Tetrahedra behind those faces, or [`NONE`].
    pub neighbour: Vec<[u32; 4]>,
    /// Edges of each tetrahedron, in the order of [`EDGES`].
    pub tetrahedron_edges: Vec<[u32; 6]>,
    star_start: Vec<u32>,
    star: Vec<u32>,
    edge_start: Vec<u32>,
    edge_star: Vec<u32>,
}

/// Ends of each edge of a tetrahedron, and the two corners that are not on it.
pub const EDGES: [[usize; 4]; 6] = [
    [0, 1, 2, 3],
    [0, 2, 1, 3],
    [0, 3, 1, 2],
    [1, 2, 0, 3],
    [1, 3, 0, 2],
    [2, 3, 0, 1],
];

/// Vertices of the face opposite vertex j, outward.
const OPPOSITE: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

impl Topology {
    pub fn new(mesh: &TetMesh) -> Topology {
        // Sort face keys: the two sides of a face become neighbours. Order of `faces` is that of
        // first appearance, so that it does not depend on the sort.
        let mut sides: Vec<([u32; 3], u32, u8)> = Vec::with_capacity(4 * mesh.tetrahedra.len());
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            for (j, corner) in OPPOSITE.iter().enumerate() {
                let mut key = corner.map(|c| nodes[c]);
                key.sort_unstable();
                sides.push((key, t as u32, j as u8));
            }
        }
        sides.sort_unstable();
        let mut partner = vec![[NONE; 4]; mesh.tetrahedra.len()];
        for pair in sides.windows(2) {
            if pair[0].0 == pair[1].0 {
                partner[pair[0].1 as usize][pair[0].2 as usize] = pair[1].1;
                partner[pair[1].1 as usize][pair[1].2 as usize] = pair[0].1;
            }
        }
        let mut faces = Vec::new();
        let mut tetrahedron_faces = vec![[NONE; 4]; mesh.tetrahedra.len()];
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            for (j, corner) in OPPOSITE.iter().enumerate() {
                if tetrahedron_faces[t][j] != NONE {
                    continue;
                }
                let other = partner[t][j];
                let id = faces.len() as u32;
                let vertices = corner.map(|c| nodes[c]);
                faces.push(Face {
                    vertices,
                    tetrahedra: [t as u32, other],
                });
                tetrahedron_faces[t][j] = id;
                if other != NONE {
                    let opposite = mesh.tetrahedra[other as usize]
                        .iter()
                        .position(|node| !vertices.contains(node))
                        .unwrap_or(0);
                    tetrahedron_faces[other as usize][opposite] = id;
                }
            }
        }
        let mut star_start = vec![0u32; mesh.nodes.len() + 1];
        for node in mesh.tetrahedra.iter().flatten() {
            star_start[*node as usize + 1] += 1;
        }
        for i in 0..mesh.nodes.len() {
            star_start[i + 1] += star_start[i];
        }
        let mut next = star_start.clone();
        let mut star = vec![0u32; 4 * mesh.tetrahedra.len()];
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            for node in nodes {
                star[next[*node as usize] as usize] = t as u32;
                next[*node as usize] += 1;
            }
        }
        let mut ends: Vec<([u32; 2], u32, u8)> = Vec::with_capacity(6 * mesh.tetrahedra.len());
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            for (k, [a, b, ..]) in EDGES.iter().enumerate() {
                let (a, b) = (nodes[*a], nodes[*b]);
                ends.push(([a.min(b), a.max(b)], t as u32, k as u8));
            }
        }
        ends.sort_unstable();
        let mut tetrahedron_edges = vec![[0; 6]; mesh.tetrahedra.len()];
        let mut edge_start = Vec::new();
        for (at, (key, t, k)) in ends.iter().enumerate() {
            if at == 0 || ends[at - 1].0 != *key {
                edge_start.push(at as u32);
            }
            tetrahedron_edges[*t as usize][*k as usize] = edge_start.len() as u32 - 1;
        }
        edge_start.push(ends.len() as u32);
        Topology {
            faces,
            tetrahedron_faces,
            neighbour: partner,
            tetrahedron_edges,
            star_start,
            star,
            edge_start,
            edge_star: ends.into_iter().map(|(_, t, _)| t).collect(),
        }
    }

    /// Tetrahedra round an edge, ascending.
    pub fn edge_star(&self, edge: u32) -> &[u32] {
        let (start, end) = (edge as usize, edge as usize + 1);
        &self.edge_star[self.edge_start[start] as usize..self.edge_start[end] as usize]
    }

    /// Tetrahedra round a vertex, ascending.
    pub fn star(&self, vertex: usize) -> &[u32] {
        &self.star[self.star_start[vertex] as usize..self.star_start[vertex + 1] as usize]
    }
}
