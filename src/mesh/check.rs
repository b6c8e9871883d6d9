//! Is it a mesh? Refuses what no element can be built on, turns inverted tetrahedra, and reports.

use super::gmsh::GmshFault;
use super::quality::{self, EDGES, FACES};
use super::{TetMesh, Vec3};

/// A tetrahedron of no more than this times the cube of its longest edge is flat: what rounding
/// leaves of coplanar nodes at a distance of up to some thousand edges from the origin. A regular
/// one has 0.118.
pub const FLAT: f64 = 1e-11;

/// What [`repair`] found. Edges, faces and volumes are those after flipping.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshReport {
    /// Tetrahedra that were inverted.
    pub flipped: usize,
    /// Nodes of no tetrahedron, ascending.
    pub unreferenced: Vec<u32>,
    /// Referenced nodes at the very place of an earlier one: unconnected tissue that seems to touch.
    pub coincident: usize,
    /// \[m³\]
    pub volume: f64,
    /// Faces of one tetrahedron only.
    pub surface_triangles: usize,
    /// Edges of more than two surface triangles: tissue that hangs together by an edge alone.
    pub hinge_edges: usize,
    /// Smallest angle between two faces of a tetrahedron \[degrees\].
    pub minimum_dihedral_degrees: f64,
    /// Largest angle between two faces of a tetrahedron \[degrees\].
    pub maximum_dihedral_degrees: f64,
    /// Smallest [`quality::mean_ratio`].
    pub minimum_quality: f64,
    /// The tetrahedron of `minimum_quality`.
    pub worst_tetrahedron: u32,
    /// \[m\]
    pub shortest_edge: f64,
    /// \[m\]
    pub longest_edge: f64,
    /// Parts that share no node.
    pub pieces: usize,
    /// Lowest and highest corner of the referenced nodes' bounding box \[m\].
    pub bounds: [Vec3; 2],
}

/// Why there is no mesh. Nodes and tetrahedra are 0-based, lines 1-based.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshError {
    #[error("the mesh has no tetrahedra; at least one is needed")]
    Empty,
    #[error("node {node} is at ({}, {}, {}); its coordinates must be finite", position.x, position.y, position.z)]
    NonFinite { node: usize, position: Vec3 },
    #[error("tetrahedron {tetrahedron} names node {node}, but {}", numbered(*.count))]
    OutOfRange {
        tetrahedron: usize,
        node: u32,
        count: usize,
    },
    #[error("tetrahedron {tetrahedron} (nodes {}) names a node twice; four different nodes are needed", list(.nodes))]
    Repeated { tetrahedron: usize, nodes: [u32; 4] },
    #[error("tetrahedron {tetrahedron} (nodes {}) is flat: its volume is {volume:.3e} m³ at a longest edge of {longest_edge:.3e} m; its nodes must not lie in one plane", list(.nodes))]
    Flat {
        tetrahedron: usize,
        nodes: [u32; 4],
        volume: f64,
        longest_edge: f64,
    },
    #[error("tetrahedra {} and {} are the same (nodes {}); one must go", .tetrahedra[0], .tetrahedra[1], list(.nodes))]
    Duplicate {
        tetrahedra: [usize; 2],
        nodes: [u32; 4],
    },
    #[error("tetrahedra {} share the face {}; at most two may", list(.tetrahedra), list(.face))]
    SharedFace {
        tetrahedra: [usize; 3],
        face: [u32; 3],
    },
    #[error("tetrahedra {} and {} lie on the same side of their face {}, so they overlap; neighbours lie on either side", .tetrahedra[0], .tetrahedra[1], list(.face))]
    Overlap {
        tetrahedra: [usize; 2],
        face: [u32; 3],
    },
    #[error("line {line}: {fault}")]
    Gmsh { line: usize, fault: GmshFault },
}

fn list(numbers: &[impl ToString]) -> String {
    let words: Vec<_> = numbers.iter().map(ToString::to_string).collect();
    words.join(" ")
}

fn numbered(count: usize) -> String {
    match count {
        0 => "the mesh has no nodes".into(),
        1 => "the mesh has node 0 alone".into(),
        _ => format!("the mesh has nodes 0 to {}", count - 1),
    }
}

/// Turns inverted tetrahedra (their last two nodes are swapped) and reports on the mesh.
///
/// Refuses, in this order: no tetrahedra; a coordinate that is not finite; a node out of range; a
/// node named twice; a tetrahedron flatter than [`FLAT`]; two tetrahedra of the same nodes, three
/// at one face, two on the same side of a face. A refused mesh may have had tetrahedra turned.
pub fn repair(mesh: &mut TetMesh) -> Result<MeshReport, MeshError> {
    check_indices(mesh)?;
    let flipped = orient(mesh)?;
    let surface = surface(&mesh.tetrahedra)?;
    let mut referenced = vec![false; mesh.nodes.len()];
    for &node in mesh.tetrahedra.iter().flatten() {
        referenced[node as usize] = true;
    }

    let mut report = MeshReport {
        flipped,
        unreferenced: (0u32..)
            .zip(&referenced)
            .filter_map(|(node, &used)| (!used).then_some(node))
            .collect(),
        coincident: coincident(&mesh.nodes, &referenced),
        volume: 0.0,
        surface_triangles: surface.len(),
        hinge_edges: hinge_edges(&surface),
        minimum_dihedral_degrees: 180.0,
        maximum_dihedral_degrees: 0.0,
        minimum_quality: f64::INFINITY,
        worst_tetrahedron: 0,
        shortest_edge: f64::INFINITY,
        longest_edge: 0.0,
        pieces: pieces(mesh, &referenced),
        bounds: [Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY)],
    };
    let mut cosines = [1.0f64, -1.0f64];
    let mut squares = [f64::INFINITY, 0.0f64];
    for (t, &tetrahedron) in (0u32..).zip(&mesh.tetrahedra) {
        let p = quality::corners(mesh, tetrahedron);
        report.volume += quality::volume(p);
        for cosine in quality::dihedral_cosines(p) {
            cosines = [cosines[0].min(cosine), cosines[1].max(cosine)];
        }
        for [i, j] in EDGES {
            let square = (p[i] - p[j]).norm_squared();
            squares = [squares[0].min(square), squares[1].max(square)];
        }
        let ratio = quality::mean_ratio(p);
        if ratio < report.minimum_quality {
            report.minimum_quality = ratio;
            report.worst_tetrahedron = t;
        }
    }
    report.minimum_dihedral_degrees = cosines[1].acos().to_degrees();
    report.maximum_dihedral_degrees = cosines[0].acos().to_degrees();
    [report.shortest_edge, report.longest_edge] = squares.map(f64::sqrt);
    for (node, _) in mesh
        .nodes
        .iter()
        .zip(&referenced)
        .filter(|(_, used)| **used)
    {
        report.bounds = [report.bounds[0].inf(node), report.bounds[1].sup(node)];
    }
    Ok(report)
}

/// The faces of one tetrahedron only, outward where tetrahedra are positive.
///
/// Refuses duplicate tetrahedra, faces of three or more, and neighbours on one side of a face.
pub fn surface(tetrahedra: &[[u32; 4]]) -> Result<Vec<[u32; 3]>, MeshError> {
    // Sorted nodes of the face, then its tetrahedron and local number, packed to sort fast.
    let mut faces: Vec<(u128, u8)> = Vec::with_capacity(4 * tetrahedra.len());
    for (t, tetrahedron) in tetrahedra.iter().enumerate() {
        for (local, corners) in (0u8..).zip(FACES) {
            let mut face = corners.map(|corner| tetrahedron[corner]);
            face.sort_unstable();
            let key = face
                .iter()
                .fold(0, |key, &node| key << 32 | u128::from(node));
            faces.push((key << 32 | t as u128, local));
        }
    }
    faces.sort_unstable();

    let mut surface = Vec::new();
    for run in faces.chunk_by(|one, other| one.0 >> 32 == other.0 >> 32) {
        let owner = |n: usize| run[n].0 as u32 as usize;
        let outward =
            |n: usize| FACES[run[n].1 as usize].map(|corner| tetrahedra[owner(n)][corner]);
        let apex = |n: usize| tetrahedra[owner(n)][run[n].1 as usize];
        if let [_] = run {
            surface.push(outward(0));
            continue;
        }
        for second in 1..run.len() {
            if let Some(first) = (0..second).find(|&first| apex(first) == apex(second)) {
                return Err(MeshError::Duplicate {
                    tetrahedra: [owner(first), owner(second)],
                    nodes: tetrahedra[owner(first)],
                });
            }
        }
        if run.len() > 2 {
            return Err(MeshError::SharedFace {
                tetrahedra: [owner(0), owner(1), owner(2)],
                face: outward(0),
            });
        }
        let [a, b, c] = outward(0);
        let neighbour = outward(1);
        if [[a, b, c], [b, c, a], [c, a, b]].contains(&neighbour) {
            return Err(MeshError::Overlap {
                tetrahedra: [owner(0), owner(1)],
                face: neighbour,
            });
        }
    }
    Ok(surface)
}

fn check_indices(mesh: &TetMesh) -> Result<(), MeshError> {
    if mesh.tetrahedra.is_empty() {
        return Err(MeshError::Empty);
    }
    for (node, &position) in mesh.nodes.iter().enumerate() {
        if !position.iter().all(|coordinate| coordinate.is_finite()) {
            return Err(MeshError::NonFinite { node, position });
        }
    }
    let count = mesh.nodes.len();
    for (tetrahedron, &nodes) in mesh.tetrahedra.iter().enumerate() {
        if let Some(&node) = nodes.iter().find(|&&node| node as usize >= count) {
            return Err(MeshError::OutOfRange {
                tetrahedron,
                node,
                count,
            });
        }
        if EDGES.iter().any(|&[i, j]| nodes[i] == nodes[j]) {
            return Err(MeshError::Repeated { tetrahedron, nodes });
        }
    }
    Ok(())
}

/// Turns inverted tetrahedra, refuses flat ones; the number turned.
fn orient(mesh: &mut TetMesh) -> Result<usize, MeshError> {
    let mut flipped = 0;
    for tetrahedron in 0..mesh.tetrahedra.len() {
        let nodes = mesh.tetrahedra[tetrahedron];
        let p = quality::corners(mesh, nodes);
        let (volume, longest_edge) = (quality::volume(p), quality::longest_edge(p));
        // Not `<=`: a volume that is not a number is refused too.
        let solid = volume.abs() > FLAT * longest_edge.powi(3);
        if !solid {
            return Err(MeshError::Flat {
                tetrahedron,
                nodes,
                volume,
                longest_edge,
            });
        }
        if volume < 0.0 {
            mesh.tetrahedra[tetrahedron].swap(2, 3);
            flipped += 1;
        }
    }
    Ok(flipped)
}

fn coincident(nodes: &[Vec3], referenced: &[bool]) -> usize {
    let mut places: Vec<[f64; 3]> = nodes
        .iter()
        .zip(referenced)
        .filter_map(|(node, &used)| used.then_some((*node).into()))
        .collect();
    let order = |p: &[f64; 3], q: &[f64; 3]| p.partial_cmp(q).unwrap_or(std::cmp::Ordering::Equal);
    places.sort_unstable_by(order);
    places.windows(2).filter(|pair| pair[0] == pair[1]).count()
}

fn hinge_edges(surface: &[[u32; 3]]) -> usize {
    let mut edges: Vec<[u32; 2]> = surface
        .iter()
        .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    edges.sort_unstable();
    edges
        .chunk_by(|one, other| one == other)
        .filter(|run| run.len() > 2)
        .count()
}

fn pieces(mesh: &TetMesh, referenced: &[bool]) -> usize {
    let mut parent: Vec<u32> = (0..mesh.nodes.len() as u32).collect();
    let root = |parent: &mut [u32], mut node: u32| {
        while parent[node as usize] != node {
            parent[node as usize] = parent[parent[node as usize] as usize];
            node = parent[node as usize];
        }
        node
    };
    let mut pieces = referenced.iter().filter(|used| **used).count();
    for &[a, rest @ ..] in &mesh.tetrahedra {
        for node in rest {
            let (one, other) = (root(&mut parent, a), root(&mut parent, node));
            if one != other {
                parent[other as usize] = one;
                pieces -= 1;
            }
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::super::box_mesh;
    use super::*;

    #[test]
    fn turns_inverted_tetrahedra_and_counts_them() {
        let straight = box_mesh::five([1.0; 3], [2, 2, 2], [0.0; 3]);
        let mut mesh = straight.clone();
        for t in [0, 7, 39] {
            mesh.tetrahedra[t].swap(2, 3);
        }
        let report = repair(&mut mesh).unwrap();
        assert_eq!(report.flipped, 3);
        assert_eq!(mesh, straight);
        assert_eq!(
            repair(&mut mesh),
            Ok(MeshReport {
                flipped: 0,
                ..report
            })
        );
    }

    #[test]
    fn reports_measures_pieces_and_spare_nodes() {
        let mut mesh = box_mesh::kuhn([1.0, 2.0, 3.0], [1, 2, 3], [0.0; 3]);
        let apart = box_mesh::kuhn([1.0; 3], [1; 3], [1.0, 2.0, 3.0]);
        mesh.nodes.push(Vec3::repeat(99.0));
        let start = mesh.nodes.len() as u32;
        mesh.nodes.extend(&apart.nodes);
        mesh.tetrahedra
            .extend(apart.tetrahedra.iter().map(|t| t.map(|node| node + start)));

        let report = repair(&mut mesh).unwrap();
        assert_eq!(report.unreferenced, [24]);
        assert_eq!(report.pieces, 2);
        assert_eq!(report.coincident, 1, "the two boxes' common corner");
        assert!((report.volume - 7.0).abs() < 1e-14);
        assert_eq!(report.surface_triangles, 2 * 22 + 12);
        assert_eq!(report.bounds, [Vec3::zeros(), Vec3::new(2.0, 3.0, 4.0)]);
        assert!((report.shortest_edge - 1.0).abs() < 1e-15);
        assert!((report.longest_edge - 3f64.sqrt()).abs() < 1e-15);
        assert!((report.minimum_dihedral_degrees - 45.0).abs() < 1e-9);
        assert!((report.maximum_dihedral_degrees - 90.0).abs() < 1e-9);
        // V = 1/6, squared edges 1 1 1 2 2 3
        assert!((report.minimum_quality - 12.0 * 0.25f64.cbrt() / 10.0).abs() < 1e-14);
    }

    #[test]
    fn counts_hinges() {
        let nodes = [
            [0, 0, 0],
            [0, 0, 1],
            [1, 0, 0],
            [0, 1, 0],
            [-1, 0, 0],
            [0, -1, 0],
        ];
        let mut mesh = TetMesh {
            nodes: nodes.map(|node| Vec3::from(node.map(f64::from))).to_vec(),
            tetrahedra: vec![[0, 1, 2, 3], [0, 1, 4, 5]],
        };
        let report = repair(&mut mesh).unwrap();
        assert_eq!((report.hinge_edges, report.pieces), (1, 1));
        mesh.tetrahedra.push([0, 1, 3, 4]);
        assert_eq!(repair(&mut mesh).unwrap().hinge_edges, 0);
    }

    #[test]
    fn surface_faces_outward() {
        let mesh = box_mesh::five([1.0; 3], [3, 2, 2], [0.0; 3]);
        let centre = Vec3::repeat(0.5);
        for triangle in surface(&mesh.tetrahedra).unwrap() {
            let [a, b, c] = triangle.map(|node| mesh.nodes[node as usize]);
            assert!((b - a).cross(&(c - a)).dot(&(a - centre)) > 0.0);
        }
    }
}
