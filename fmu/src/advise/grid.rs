//! A scene's body on a mesh of one size.

use std::collections::HashMap;
use std::path::Path;

use tissue::mesh::{self, TetMesh};
use tissue::model::ModelError;
use tissue::prepared::PrepareError;
use tissue::scene::{Fixed, MeshSource, Region, Scene, Selector};

use crate::chart::compare::Points;

/// The reference's mesh has no more tetrahedra.
const MOST_TETRAHEDRA: usize = 80_000;
/// Edges of coarser meshes, in those of the scene's; of finer ones, that of the reference, the finest first.
const COARSER: [f64; 3] = [3.0, 2.0, 1.5];
const FINER: [f64; 3] = [2.0, 1.5, 4.0 / 3.0];

pub struct Grid {
    pub source: MeshSource,
    pub mesh: TetMesh,
    /// Outward.
    pub surface: Vec<[u32; 3]>,
}

/// Where points of the surface are: in a tetrahedron, with shares of its corners.
pub type Spots = Vec<(u32, [f64; 4])>;

impl Grid {
    pub fn new(source: MeshSource, path: &Path) -> Result<Grid, PrepareError> {
        let file = path.display().to_string();
        let base = path.parent().unwrap_or(Path::new("."));
        let mut mesh =
            mesh::load::load(&source, base).map_err(|e| PrepareError::Mesh(file.clone(), e))?;
        let wrong = |e| PrepareError::Model(ModelError::Mesh(file.clone(), e));
        mesh::repair(&mut mesh).map_err(wrong)?;
        let surface = mesh::check::surface(&mesh.tetrahedra).map_err(wrong)?;
        Ok(Grid {
            source,
            mesh,
            surface,
        })
    }

    /// Where points lie on it.
    pub fn spots(&self, points: &Points) -> Spots {
        let mut owner: HashMap<[u32; 3], u32> = HashMap::new();
        for (k, t) in self.mesh.tetrahedra.iter().enumerate() {
            for opposite in 0..4 {
                owner.insert(face(t, opposite), k as u32);
            }
        }
        let places = points.on(&self.mesh, &self.surface);
        let spot = |(nodes, shares): &([u32; 3], [f64; 3])| {
            let mut key = *nodes;
            key.sort_unstable();
            let tetrahedron = owner[&key];
            let corners = self.mesh.tetrahedra[tetrahedron as usize];
            let share = |v: u32| {
                let of = nodes.iter().zip(shares).find(|(node, _)| **node == v);
                of.map_or(0.0, |(_, share)| *share)
            };
            (tetrahedron, corners.map(share))
        };
        places.triangles().map(spot).collect()
    }

    /// "10 mm"
    pub fn label(&self) -> String {
        match edge(&self.source) {
            Some(edge) => format!("{} mm", crate::chart::sheet::three(1e3 * edge)),
            None => "as given".into(),
        }
    }
}

fn face(t: &[u32; 4], opposite: usize) -> [u32; 3] {
    let mut nodes = [0; 3];
    let others = t.iter().enumerate().filter(|(k, _)| *k != opposite);
    (nodes.iter_mut().zip(others)).for_each(|(to, (_, v))| *to = *v);
    nodes.sort_unstable();
    nodes
}

/// What says how fine a generated mesh is \[m\]: the longest side of a cell, or the edge.
fn edge(source: &MeshSource) -> Option<f64> {
    match source {
        MeshSource::Box { size, cells, .. } => {
            let sides = (0..3).map(|k| size[k] / cells[k] as f64);
            Some(sides.fold(0.0, f64::max))
        }
        MeshSource::Cylinder { edge_length, .. } | MeshSource::Liver { edge_length } => {
            Some(*edge_length)
        }
        MeshSource::File { .. } | MeshSource::Inline { .. } => None,
    }
}

/// With edges so many times as long; none where there is no such mesh: of a box whole numbers of cells must come out, so
/// that what is selected keeps its outline.
fn scaled(source: &MeshSource, ratio: f64) -> Option<MeshSource> {
    let mut source = source.clone();
    match &mut source {
        MeshSource::Box { cells, .. } => {
            for count in cells {
                let wanted = *count as f64 / ratio;
                if wanted < 0.99 || (wanted - wanted.round()).abs() > 1e-6 {
                    return None;
                }
                *count = wanted.round() as usize;
            }
        }
        MeshSource::Cylinder {
            edge_length,
            radius,
            ..
        } => {
            *edge_length *= ratio;
            // A disc of one ring is no disc.
            if *radius < 1.5 * *edge_length {
                return None;
            }
        }
        MeshSource::Liver { edge_length } => {
            *edge_length *= ratio;
            if !mesh::liver::EDGE_LENGTH.contains(edge_length) {
                return None;
            }
        }
        MeshSource::File { .. } | MeshSource::Inline { .. } => return None,
    }
    Some(source)
}

/// The scene's own mesh, then coarser ones, from fine to coarse; and that of the reference, none where the scene's is the
/// finest there can be.
pub fn grids(
    scene: &Scene,
    path: &Path,
    same_mesh: bool,
) -> Result<(Vec<Grid>, Option<Grid>), PrepareError> {
    let own = Grid::new(scene.mesh.clone(), path)?;
    if same_mesh || counts_nodes(scene) {
        return Ok((vec![own], None));
    }
    let tetrahedra = own.mesh.tetrahedra.len() as f64;
    let finer = (FINER.iter())
        .filter(|f| tetrahedra * f.powi(3) <= MOST_TETRAHEDRA as f64)
        .find_map(|f| scaled(&scene.mesh, 1.0 / f));
    let reference = finer.map(|source| Grid::new(source, path));
    let mut found = vec![own];
    for ratio in COARSER.iter().rev() {
        if let Some(source) = scaled(&scene.mesh, *ratio) {
            found.push(Grid::new(source, path)?);
        }
    }
    Ok((found, reference.transpose()?))
}

/// Whether it names nodes or tetrahedra by their numbers, which are another mesh's on another mesh.
pub fn counts_nodes(scene: &Scene) -> bool {
    let fixed = scene.fixed.iter().map(|Fixed { selector, .. }| selector);
    let all = (scene.materials.iter().map(|m| &m.selector))
        .chain(fixed)
        .chain(scene.prescribed.iter().map(|p| &p.selector))
        .chain(scene.loads.iter().map(|l| &l.selector))
        .chain(scene.cuts.iter().map(|c| &c.selector))
        .chain(&scene.model.touchable);
    let mut all = all;
    // A load is one on each node: on another mesh it is another one.
    !scene.loads.is_empty() || all.any(numbered)
}

fn numbered(selector: &Selector) -> bool {
    match &selector.region {
        Region::Nodes(_) | Region::Tetrahedra(_) => true,
        Region::Any(parts) => parts.iter().any(numbered),
        Region::Not(part) => numbered(part),
        Region::All | Region::Box { .. } | Region::Sphere { .. } | Region::HalfSpace { .. } => {
            false
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tissue::scene::BoxPattern;

    fn cells(cells: [usize; 3]) -> MeshSource {
        MeshSource::Box {
            size: [0.04, 0.04, 0.02],
            cells,
            origin: [0.0; 3],
            pattern: BoxPattern::Five,
        }
    }

    #[test]
    fn boxes_keep_whole_cells() {
        assert_eq!(scaled(&cells([4, 4, 2]), 2.0), Some(cells([2, 2, 1])));
        assert_eq!(scaled(&cells([4, 4, 2]), 0.5), Some(cells([8, 8, 4])));
        assert_eq!(scaled(&cells([4, 4, 2]), 1.5), None);
        assert_eq!(scaled(&cells([3, 3, 1]), 3.0), None);
    }

    /// The points of the coarse surface, on the fine one: in tetrahedra that have them.
    #[test]
    fn spots_are_where_their_points_are() {
        let [coarse, fine] =
            [[4, 4, 2], [8, 8, 4]].map(|n| Grid::new(cells(n), Path::new("a.json")).unwrap());
        let points = Points::new(&coarse.mesh, &coarse.surface);
        for (k, (t, shares)) in fine.spots(&points).iter().enumerate() {
            let corners = fine.mesh.tetrahedra[*t as usize].map(|v| fine.mesh.nodes[v as usize]);
            let at: mesh::Vec3 = (0..4).map(|j| corners[j] * shares[j]).sum();
            let wanted = coarse.surface[k].map(|v| coarse.mesh.nodes[v as usize]);
            let wanted = wanted.iter().sum::<mesh::Vec3>() / 3.0;
            assert!((at - wanted).norm() < 1e-12);
        }
    }
}
