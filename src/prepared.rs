//! Between a scene file and a model that an FMU carries: the scene with its mesh inside, and what was
//! computed from it.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::mesh::{self, TetMesh, Vec3};
use crate::model::spectrum::Spectrum;
use crate::model::{Model, ModelError};
use crate::scene::{self, MeshSource, SceneError};

/// The scene with its mesh inline.
pub const SCENE: &str = "scene.json";
/// What the build computed.
pub const PRECOMPUTED: &str = "precomputed.json";

#[derive(Serialize, Deserialize)]
struct Precomputed {
    /// Of the model it belongs to; anything else is computed anew.
    fingerprint: u64,
    spectrum: Spectrum,
}

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
pub enum PrepareError {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("{0}: mesh: {1}")]
    Mesh(String, mesh::load::LoadError),
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error("{0}: {1}")]
    Resource(String, String),
}

/// The model of a scene file.
pub fn read(path: &Path) -> Result<Model, PrepareError> {
    prepare(scene::read(path)?, path)
}

/// The model of a scene; `path` names it in messages, and its folder is where mesh files are.
pub fn prepare(mut scene: scene::Scene, path: &Path) -> Result<Model, PrepareError> {
    let file = path.display().to_string();
    let base = path.parent().unwrap_or(Path::new("."));
    let mut mesh =
        mesh::load::load(&scene.mesh, base).map_err(|e| PrepareError::Mesh(file.clone(), e))?;
    let report = mesh::repair(&mut mesh).map_err(|e| ModelError::Mesh(file.clone(), e))?;
    scene.mesh = MeshSource::Inline {
        nodes: mesh.nodes.iter().map(|p| (*p).into()).collect(),
        tetrahedra: mesh.tetrahedra.clone(),
    };
    let mut model = Model::new(scene, mesh, &file)?;
    model.report.flipped = report.flipped;
    Ok(model)
}

/// Files for the FMU's `resources/`.
pub fn resources(model: &Model) -> Result<[(&'static str, Vec<u8>); 2], serde_json::Error> {
    let precomputed = Precomputed {
        fingerprint: model.fingerprint,
        spectrum: model.spectrum,
    };
    Ok([
        (SCENE, serde_json::to_vec(&model.scene)?),
        (PRECOMPUTED, serde_json::to_vec(&precomputed)?),
    ])
}

/// The model from an unpacked FMU's `resources/`.
pub fn open(resources: &Path) -> Result<Model, PrepareError> {
    let scene = scene::read(&resources.join(SCENE))?;
    let MeshSource::Inline { nodes, tetrahedra } = &scene.mesh else {
        return Err(PrepareError::Resource(
            SCENE.into(),
            "has no inline mesh; build the FMU again".into(),
        ));
    };
    let mesh = TetMesh {
        nodes: nodes.iter().map(|p| Vec3::from(*p)).collect(),
        tetrahedra: tetrahedra.clone(),
    };
    let path = resources.join(PRECOMPUTED);
    let damaged = |e: String| PrepareError::Resource(PRECOMPUTED.into(), e);
    let text = std::fs::read(&path).map_err(|e| damaged(format!("cannot be read: {e}")))?;
    let known: Precomputed =
        serde_json::from_slice(&text).map_err(|e| damaged(format!("is damaged: {e}")))?;
    let matches = |model: &Model| model.fingerprint == known.fingerprint;
    let model = Model::with_spectrum(scene.clone(), mesh.clone(), SCENE, Some(known.spectrum))?;
    if matches(&model) {
        Ok(model)
    } else {
        Ok(Model::new(scene, mesh, SCENE)?)
    }
}
