//! Tetrahedral meshes: made, read, checked.

pub mod box_mesh;
pub mod check;
pub mod cylinder;
pub mod gmsh;
pub mod liver;
pub mod load;
pub mod quality;
mod smooth;
mod stuffing;
pub mod topology;

pub use check::{MeshError, MeshReport, repair};

/// A point or vector in metres.
pub type Vec3 = nalgebra::Vector3<f64>;

/// Nodes \[m\] and tetrahedra, 0-based. After [`check::repair`] each tetrahedron (a, b, c, d) has
/// det(b-a, c-a, d-a) > 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TetMesh {
    pub nodes: Vec<Vec3>,
    pub tetrahedra: Vec<[u32; 4]>,
}

/// The most nodes a generator makes; asked for more, it returns an empty mesh, which
/// [`check::repair`] refuses.
pub const MAXIMUM_NODES: usize = 10_000_000;
