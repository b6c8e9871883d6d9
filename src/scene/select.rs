//! Which nodes or tetrahedra a [`Selector`] means.

use super::types::{Region, Selector};
use crate::mesh::{TetMesh, Vec3};

/// Node numbers, ascending. Errors (the text after the path): a number the mesh does not have, or
/// nothing selected.
pub fn select_nodes(selector: &Selector, mesh: &TetMesh) -> Result<Vec<u32>, String> {
    Ground {
        mesh,
        points: mesh.nodes.clone(),
        tetrahedra: false,
    }
    .numbers(selector)
}

/// Tetrahedron numbers, ascending; a `nodes` region selects tetrahedra with all four nodes listed.
/// Errors as in [`select_nodes`].
pub fn select_tetrahedra(selector: &Selector, mesh: &TetMesh) -> Result<Vec<u32>, String> {
    let centroid =
        |corners: &[u32; 4]| corners.map(|i| mesh.nodes[i as usize]).iter().sum::<Vec3>() / 4.0;
    let points = mesh.tetrahedra.iter().map(centroid).collect();
    Ground {
        mesh,
        points,
        tetrahedra: true,
    }
    .numbers(selector)
}

/// What is selected from: nodes, or tetrahedra by their centroids.
struct Ground<'a> {
    mesh: &'a TetMesh,
    points: Vec<Vec3>,
    tetrahedra: bool,
}

impl Ground<'_> {
    fn numbers(&self, selector: &Selector) -> Result<Vec<u32>, String> {
        let mask = self.mask(selector, false)?;
        Ok((0..)
            .zip(mask)
            .filter_map(|(i, selected)| selected.then_some(i))
            .collect())
    }

    fn mask(&self, selector: &Selector, optional: bool) -> Result<Vec<bool>, String> {
        let optional = optional || selector.optional;
        let tolerance = 1e-9 * diagonal(&self.mesh.nodes);
        let mask = match &selector.region {
            Region::All => vec![true; self.points.len()],
            Region::Nodes(list) => {
                let nodes = listed(list, self.mesh.nodes.len(), "node")?;
                let inside = |corners: &[u32; 4]| corners.iter().all(|&i| nodes[i as usize]);
                match self.tetrahedra {
                    true => self.mesh.tetrahedra.iter().map(inside).collect(),
                    false => nodes,
                }
            }
            Region::Tetrahedra(_) if !self.tetrahedra => {
                return Err("selects tetrahedra where nodes are selected; must be \"nodes\" or a region of space".into());
            }
            Region::Tetrahedra(list) => listed(list, self.points.len(), "tetrahedron")?,
            Region::Box { min, max } => self.where_point(|p| {
                (0..3).all(|k| min[k] - tolerance <= p[k] && p[k] <= max[k] + tolerance)
            }),
            Region::Sphere { center, radius } => {
                let center = Vec3::from(*center);
                self.where_point(|p| (p - center).norm() <= radius + tolerance)
            }
            Region::HalfSpace { point, normal } => {
                let (point, normal) = (Vec3::from(*point), Vec3::from(*normal));
                let normal = (normal / normal.amax()).normalize();
                self.where_point(|p| (p - point).dot(&normal) >= -tolerance)
            }
            Region::Any(members) => {
                let mut mask = vec![false; self.points.len()];
                for (i, member) in members.iter().enumerate() {
                    let member = self
                        .mask(member, optional)
                        .map_err(|e| format!("any[{i}]: {e}"))?;
                    mask.iter_mut()
                        .zip(member)
                        .for_each(|(all, one)| *all |= one);
                }
                mask
            }
            Region::Not(inner) => {
                let inner = self
                    .mask(inner, optional)
                    .map_err(|e| format!("not: {e}"))?;
                inner.into_iter().map(|selected| !selected).collect()
            }
        };
        if optional || mask.contains(&true) {
            return Ok(mask);
        }
        let what = if self.tetrahedra {
            "tetrahedron"
        } else {
            "node"
        };
        Err(format!(
            "selects no {what}; must select at least one, or say \"optional\": true"
        ))
    }

    fn where_point(&self, holds: impl Fn(&Vec3) -> bool) -> Vec<bool> {
        self.points.iter().map(holds).collect()
    }
}

fn listed(list: &[u32], count: usize, what: &str) -> Result<Vec<bool>, String> {
    let mut mask = vec![false; count];
    for &i in list {
        let Some(selected) = mask.get_mut(i as usize) else {
            return Err(format!("no {what} {i} in the mesh; must be below {count}"));
        };
        *selected = true;
    }
    Ok(mask)
}

/// Of the bounding box \[m\].
fn diagonal(nodes: &[Vec3]) -> f64 {
    let Some(first) = nodes.first() else {
        return 0.0;
    };
    let (low, high) = nodes
        .iter()
        .fold((*first, *first), |(low, high), p| (low.inf(p), high.sup(p)));
    (high - low).norm()
}
