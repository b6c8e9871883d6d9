//! Between a scene file and a model that an FMU carries: the scene with its mesh inside, and what was
//! computed from it.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::mesh::{self, TetMesh, Vec3};
use crate::model::precomputed::Progress;
use crate::model::spectrum::Spectrum;
use crate::model::store::{self, Numbers};
use crate::model::{Known, Model, ModelError, fingerprint, precomputed_key};
use crate::scene::{self, MeshSource, SceneError};

/// The scene with its mesh inline.
pub const SCENE: &str = "scene.json";
/// What the build computed.
pub const PRECOMPUTED: &str = "precomputed.json";
/// Elementary deformations and the like, where there is a pre-computed part.
pub const ELEMENTARY: &str = "elementary.bin";

#[derive(Serialize, Deserialize)]
struct Found {
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
    read_with(path, |_| Known::default(), &|_| {})
}

/// The same with what an earlier build has found, by its key, and word of the progress.
pub fn read_with(
    path: &Path,
    known: impl FnOnce(u64) -> Known,
    progress: Progress,
) -> Result<Model, PrepareError> {
    prepare_with(scene::read(path)?, path, known, progress)
}

/// The model of a scene; `path` names it in messages, and its folder is where mesh files are.
pub fn prepare(scene: scene::Scene, path: &Path) -> Result<Model, PrepareError> {
    prepare_with(scene, path, |_| Known::default(), &|_| {})
}

fn prepare_with(
    mut scene: scene::Scene,
    path: &Path,
    known: impl FnOnce(u64) -> Known,
    progress: Progress,
) -> Result<Model, PrepareError> {
    let file = path.display().to_string();
    let base = path.parent().unwrap_or(Path::new("."));
    let mut mesh =
        mesh::load::load(&scene.mesh, base).map_err(|e| PrepareError::Mesh(file.clone(), e))?;
    let report = mesh::repair(&mut mesh).map_err(|e| ModelError::Mesh(file.clone(), e))?;
    scene.mesh = MeshSource::Inline {
        nodes: mesh.nodes.iter().map(|p| (*p).into()).collect(),
        tetrahedra: mesh.tetrahedra.clone(),
    };
    let known = known(precomputed_key(&scene, &mesh));
    let mut model = Model::build(scene, mesh, &file, known, progress)?;
    model.report.flipped = report.flipped;
    Ok(model)
}

/// Files for the FMU's `resources/`.
pub fn resources(model: &Model) -> Result<Vec<(&'static str, Vec<u8>)>, serde_json::Error> {
    let found = Found {
        fingerprint: model.fingerprint,
        spectrum: model.spectrum,
    };
    let mut files = vec![
        (SCENE, serde_json::to_vec(&model.scene)?),
        (PRECOMPUTED, serde_json::to_vec(&found)?),
    ];
    if let Some(part) = &model.precomputed {
        files.push((
            ELEMENTARY,
            store::bytes(model.precomputed_key, part.numbers()),
        ));
    }
    Ok(files)
}

/// The pre-computed part in an unpacked FMU's `resources/`, if it has one of this key.
pub fn elementary(resources: &Path, key: u64) -> Result<Option<Numbers>, PrepareError> {
    let path = resources.join(ELEMENTARY);
    if !path.exists() {
        return Ok(None);
    }
    store::open(&path, key).map_err(|e| PrepareError::Resource(ELEMENTARY.into(), e.to_string()))
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
    let found: Found =
        serde_json::from_slice(&text).map_err(|e| damaged(format!("is damaged: {e}")))?;
    let known = Known {
        spectrum: (found.fingerprint == fingerprint(&scene, &mesh)).then_some(found.spectrum),
        numbers: elementary(resources, precomputed_key(&scene, &mesh))?,
    };
    Ok(Model::build(scene, mesh, SCENE, known, &|_| {})?)
}
