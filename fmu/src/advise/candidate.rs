//! A scene with a setting of the chart, on a mesh of some size.

use std::path::Path;
use std::sync::Arc;

use tissue::model::{Model, critical_step, scheme};
use tissue::prepared::{self, PrepareError};
use tissue::scene::{
    Elasticity, Element, Form, Incompressibility, ModelKind, ModelSettings, Scene, Scheme,
};

use super::track;
use crate::chart::settings::{Family, SETTINGS, SettingRow};
use crate::chart::site::Site;

/// What may be advised, what is likely to be cheap first.
pub fn settings() -> Vec<&'static SettingRow> {
    let mut rows: Vec<&SettingRow> = SETTINGS.iter().filter(|s| !s.compared).collect();
    rows.sort_by_key(|s| match s.family {
        Family::QuasiStatic => 0,
        Family::Hybrid => 1,
        Family::TensorMass => 2,
        _ => 3,
    });
    rows
}

pub fn setting(name: &str) -> Option<&'static SettingRow> {
    SETTINGS.iter().find(|s| s.name == name)
}

/// Keeps what the scene says of its tissue, not of how that is computed.
pub fn scene(
    base: &Scene,
    mesh: &tissue::scene::MeshSource,
    site: &Site,
    setting: &SettingRow,
) -> Scene {
    let mut scene = base.clone();
    scene.mesh = mesh.clone();
    scene.model = ModelSettings {
        touchable: base.model.touchable.clone(),
        interface_mass: base.model.interface_mass,
        ..ModelSettings::default()
    };
    (scene.integration.scheme, scene.integration.substep) = (None, None);
    (setting.apply)(&mut scene, site);
    let model = &mut scene.model;
    if !matches!(model.kind, ModelKind::QuasiStatic | ModelKind::Hybrid) {
        model.touchable = None;
    }
    if model.elasticity != Elasticity::Linear
        && model.nonlinear_threshold == 0.0
        && model.form == Form::PerTetrahedron
    {
        model.incompressibility = base.model.incompressibility;
    }
    scene
}

/// Its model; the scene is given the substep that the setting asks for. What a file could not say is refused.
pub fn model(
    scene: &mut Scene,
    setting: &SettingRow,
    path: &Path,
) -> Result<Arc<Model>, PrepareError> {
    let text = serde_json::to_string(scene).unwrap_or_default();
    tissue::scene::parse(&text, &path.display().to_string())?;
    let model = setting.divided(prepared::prepare(scene.clone(), path)?)?;
    if setting.substeps != 1.0 {
        scene.integration = model.scene.integration.clone();
    }
    Ok(Arc::new(model))
}

/// Of a millisecond before it is run, of tissue at rest: stretched it takes more substeps \[flop\].
pub fn predicted(model: &Model, held: f64) -> Option<f64> {
    let period = 1.0 / model.scene.integration.haptic_rate;
    let substeps = (period / model.substep(model.damping())).round();
    track::counted(model, 0.0, held, substeps)
}

/// Work of a millisecond of what is right for sure on this mesh: St Venant and Kirchhoff's law all over, at a substep
/// within the bound by elements \[flop\]. Of tissue at rest.
pub fn safest(
    base: &Scene,
    mesh: &tissue::scene::MeshSource,
    site: &Site,
    path: &Path,
    held: f64,
) -> Option<f64> {
    let mut scene = scene(base, mesh, site, setting("St Venant-Kirchhoff")?);
    scene.model.incompressibility = Incompressibility::Pressure(0.0);
    debug_assert!(scene.model.kind == ModelKind::TensorMass);
    debug_assert!(scene.model.element == Some(Element::ConstantStrain));
    let model = prepared::prepare(scene, path).ok()?;
    let period = 1.0 / model.scene.integration.haptic_rate;
    let damping = model.damping();
    let bound = critical_step::of(
        Scheme::SymplecticEuler,
        model.spectrum.element_bound,
        damping,
    );
    let chosen = (period / model.substep(damping)).round();
    let substeps = (period / (scheme::STEP_MARGIN * bound)).ceil().max(chosen);
    track::counted(&model, 0.0, held, substeps)
}
