//! From what the scene says of its mesh to the mesh.

use std::path::Path;

use super::{MeshError, TetMesh, Vec3, box_mesh, cylinder, gmsh, liver};
use crate::scene::{BoxPattern, MeshSource};

/// Why there is no mesh.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    #[error("{0}: cannot be read: {1}")]
    Read(String, std::io::Error),
    #[error("{0}: {1}")]
    Format(String, MeshError),
}

/// Makes or reads the mesh; files are relative to `base`, the scene file's folder. Not yet repaired.
pub fn load(source: &MeshSource, base: &Path) -> Result<TetMesh, LoadError> {
    Ok(match source {
        MeshSource::Box {
            size,
            cells,
            origin,
            pattern,
        } => match pattern {
            BoxPattern::Five => box_mesh::five(*size, *cells, *origin),
            BoxPattern::Kuhn => box_mesh::kuhn(*size, *cells, *origin),
        },
        MeshSource::Cylinder {
            radius,
            height,
            edge_length,
        } => cylinder::generate(*radius, *height, *edge_length),
        MeshSource::Liver { edge_length } => liver::generate(*edge_length),
        MeshSource::File { file, scale } => {
            let bytes =
                std::fs::read(base.join(file)).map_err(|e| LoadError::Read(file.clone(), e))?;
            let mut mesh = gmsh::parse(&String::from_utf8_lossy(&bytes))
                .map_err(|e| LoadError::Format(file.clone(), e))?;
            mesh.nodes.iter_mut().for_each(|p| *p *= *scale);
            mesh
        }
        MeshSource::Inline { nodes, tetrahedra } => TetMesh {
            nodes: nodes.iter().map(|p| Vec3::from(*p)).collect(),
            tetrahedra: tetrahedra.clone(),
        },
    })
}
