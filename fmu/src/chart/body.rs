//! A scene's tissue on a mesh of one size, and the grip that moves its patch.

use std::path::Path;
use std::sync::Arc;

use tissue::mesh::{self, TetMesh, Vec3};
use tissue::model::Model;
use tissue::prepared::{self, PrepareError};
use tissue::scene::{
    Friction, MeshSource, ModelKind, ModelSettings, Outputs, Part, Region, Scene, SceneError,
    Selector, Shape, Tool, ToolKind, select_nodes,
};

use super::scenes::SceneRow;
use super::settings::SettingRow;
use super::site::Site;

/// Radius of the balls that a grip is made of, in edges of the triangle that each touches.
const BALL: f64 = 1e-3;

pub struct Body {
    pub row: &'static SceneRow,
    /// Of cells or edges, as asked for \[m\].
    pub size: f64,
    /// Linear, dynamic, of constant strain, with a grasper on the patch.
    pub scene: Scene,
    pub mesh: TetMesh,
    /// Outward.
    pub surface: Vec<[u32; 3]>,
    /// Nodes that the grasper holds, ascending.
    pub patch: Vec<u32>,
    /// Tetrahedra in order of their distance from the middle of the patch.
    pub site: Site,
}

impl Body {
    pub fn new(row: &'static SceneRow, size: f64) -> Result<Body, PrepareError> {
        let file = row.name.to_string();
        let mut scene = tissue::scene::parse(row.text, row.name)?;
        scene.mesh = (row.mesh)(size);
        let mut mesh = mesh::load::load(&scene.mesh, Path::new("."))
            .map_err(|e| PrepareError::Mesh(file.clone(), e))?;
        let wrong = |e| tissue::model::ModelError::Mesh(file.clone(), e);
        mesh::repair(&mut mesh).map_err(wrong)?;
        let surface = mesh::check::surface(&mesh.tetrahedra).map_err(wrong)?;
        // By their centroids: whole triangles are as often too many as too few.
        let middles = TetMesh {
            nodes: (surface.iter())
                .map(|t| t.iter().map(|v| mesh.nodes[*v as usize]).sum::<Vec3>() / 3.0)
                .collect(),
            ..TetMesh::default()
        };
        let within = select_nodes(&selector((row.patch)()), &middles)
            .map_err(|e| SceneError::at(&file, "patch", e))?;
        let held: Vec<[u32; 3]> = within.iter().map(|k| surface[*k as usize]).collect();
        let mut patch: Vec<u32> = held.iter().flatten().copied().collect();
        patch.sort_unstable();
        patch.dedup();
        scene.mesh = MeshSource::Inline {
            nodes: mesh.nodes.iter().map(|p| (*p).into()).collect(),
            tetrahedra: mesh.tetrahedra.clone(),
        };
        scene.gravity = [0.0; 3];
        scene.loads.clear();
        scene.prescribed.clear();
        scene.model = ModelSettings::default();
        scene.integration.damping = Some(row.damping);
        scene.outputs = Outputs::default();
        scene.tools = vec![grasper(&mesh, &held)];
        let nodes = patch.iter().map(|v| mesh.nodes[*v as usize]);
        let middle = nodes.sum::<Vec3>() / patch.len() as f64;
        let site = Site::new(&mesh, |p| (p - middle).norm(), &[]);
        Ok(Body {
            row,
            size,
            scene,
            mesh,
            surface,
            patch,
            site,
        })
    }

    /// The scene with a setting. Of what is pre-computed tools touch the patch alone.
    pub fn with(&self, setting: &SettingRow) -> Scene {
        let mut scene = self.scene.clone();
        (setting.apply)(&mut scene, &self.site);
        if matches!(scene.model.kind, ModelKind::QuasiStatic | ModelKind::Hybrid) {
            scene.model.touchable = Some(selector(Region::Nodes(self.patch.clone())));
        }
        scene
    }

    /// Its model.
    pub fn prepare(&self, setting: &SettingRow) -> Result<Arc<Model>, PrepareError> {
        let model = prepared::prepare(self.with(setting), Path::new(self.row.name))?;
        Ok(Arc::new(setting.divided(model)?))
    }
}

fn selector(region: Region) -> Selector {
    Selector {
        optional: false,
        region,
    }
}

/// Touches these triangles and no others: a ball in the middle of each. So it holds what lies within the same lines on
/// every mesh, where a tool of one shape would round the patch up to whole triangles.
fn grasper(mesh: &TetMesh, triangles: &[[u32; 3]]) -> Tool {
    let part = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.nodes[v as usize]);
        Part {
            shape: Shape::Sphere {
                radius: BALL * (b - a).norm(),
            },
            position: ((a + b + c) / 3.0).into(),
            orientation: [1.0, 0.0, 0.0, 0.0],
        }
    };
    Tool {
        name: "grasper".into(),
        kind: ToolKind::Grasper,
        shape: Shape::Compound(triangles.iter().map(part).collect()),
        active_length: None,
        friction: Friction::Stick,
        slip_force: None,
        position: [0.0; 3],
        orientation: [1.0, 0.0, 0.0, 0.0],
    }
}

#[cfg(test)]
mod tests {
    use super::super::scenes::SCENES;
    use super::*;

    /// Area of the triangles that a body's grip has a ball in \[m²\].
    fn footprint(body: &Body) -> f64 {
        let Shape::Compound(parts) = &body.scene.tools[0].shape else {
            panic!("a grip of balls");
        };
        let corners = |t: &[u32; 3]| t.map(|v| body.mesh.nodes[v as usize]);
        let held = |[a, b, c]: &[Vec3; 3]| {
            let middle: [f64; 3] = ((a + b + c) / 3.0).into();
            parts.iter().any(|p| p.position == middle)
        };
        let area = |[a, b, c]: [Vec3; 3]| 0.5 * (b - a).cross(&(c - a)).norm();
        (body.surface.iter().map(corners).filter(held).map(area)).sum()
    }

    /// On boxes the grip covers the same area at every size; that of the liver, whose meshes have no common lines, is
    /// within a hundredth; the end of a cylinder is a polygon, a twentieth smaller on the coarsest mesh.
    #[test]
    fn a_patch_is_the_same_on_every_mesh() {
        for row in &SCENES {
            let sizes = row.sizes.iter().chain([&row.reference]);
            let bodies: Vec<Body> = sizes.map(|s| Body::new(row, *s).unwrap()).collect();
            assert!(bodies[0].patch.len() >= 9, "{}", row.name);
            let last = footprint(&bodies[3]);
            for (k, body) in bodies.iter().enumerate() {
                let off = footprint(body) / last - 1.0;
                let allowed = match row.name {
                    "liver" => 0.01,
                    "cylinder" => 0.05,
                    _ => 1e-9,
                };
                println!(
                    "{}: {} nodes, {} tetrahedra, patch of {} nodes, area {:+.2} %",
                    row.name,
                    body.mesh.nodes.len(),
                    body.mesh.tetrahedra.len(),
                    body.patch.len(),
                    100.0 * off
                );
                assert!(off.abs() <= allowed, "{}: {off}", row.name);
                assert!(k == 0 || body.site.edge < bodies[k - 1].site.edge);
            }
        }
    }
}
