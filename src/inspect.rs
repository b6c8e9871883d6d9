//! What a scene amounts to, before it runs.

use std::collections::BTreeMap;
use std::time::Instant;

use serde::Serialize;

use crate::couple::Coupling;
use crate::model::sweep::{Advance, Motion};
use crate::model::tensor_mass::{Lane, Pattern};
use crate::model::{MOST_POISSON_RATIO, Model, critical_step};
use crate::scene::{InterfaceMass, ModelKind, Scheme, ToolKind};
use crate::state::State;
use crate::step::{Workspace, advance, division};
use crate::tear;

/// Keys as `inspect --json` writes them.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Inspection {
    pub name: String,
    pub vertices: usize,
    pub edges: usize,
    pub tetrahedra: usize,
    pub surface_triangles: usize,
    pub pieces: usize,
    /// \[m³\]
    pub volume: f64,
    /// \[kg\]
    pub mass: f64,
    pub materials: Vec<Share>,
    pub fixed_nodes: usize,
    pub prescribed_nodes: usize,
    pub loaded_nodes: usize,
    pub dynamic_tetrahedra: usize,
    pub connection_nodes: usize,
    /// Surface nodes of the pre-computed part that tools can touch.
    pub touchable_nodes: usize,
    /// What a choice of interface modes changes of the equilibrium, relative to its displacement; `null`: nothing.
    pub interface_error: Option<f64>,
    /// Scheme to seconds; undamped where the scheme allows it, else at the scene's damping. `null`: no
    /// limit, for the scheme or because nothing can move.
    pub critical_step: BTreeMap<&'static str, Option<f64>>,
    /// In use.
    pub scheme: Scheme,
    /// In use \[s\].
    pub substep: f64,
    /// \[1/s\]
    pub damping: f64,
    /// Lowest frequency \[Hz\]; `null` where it was not needed and too dear to find.
    pub lowest_frequency: Option<f64>,
    /// \[degrees\]
    pub minimum_dihedral: f64,
    /// Measured here and now, without contact \[s\].
    pub seconds_per_substep: f64,
    /// Where the time of a substep goes; `null` with schemes of several sweeps a substep.
    pub substep_shares: Option<SubstepShares>,
    /// Tensors, positions and the like of one instance.
    pub memory_bytes: usize,
    pub warnings: Vec<String>,
}

/// Parts of the time of a substep of tissue at rest that no tool touches, measured here and now, haptic ticks spread over their
/// period \[1\]. They sum to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct SubstepShares {
    /// Forces, integration and energy sums.
    pub sweep: f64,
    /// What the pre-computed part answers.
    pub coupling: f64,
    /// To seek it.
    pub contact: f64,
    /// Loads, held vertices, watchdog, forces on tools.
    pub rest: f64,
}

/// What one entry of the scene's materials covers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Share {
    pub tetrahedra: usize,
    /// \[m³\]
    pub volume: f64,
    /// \[kg\]
    pub mass: f64,
}

pub fn inspect(model: &Model) -> Inspection {
    let mut materials = vec![
        Share {
            tetrahedra: 0,
            volume: 0.0,
            mass: 0.0
        };
        model.scene.materials.len()
    ];
    for (t, shape) in model.shape.iter().enumerate() {
        let share = &mut materials[model.material_index(t)];
        share.tetrahedra += 1;
        share.volume += shape.volume;
        share.mass += shape.volume * model.material(t).density;
    }
    let (omega, damping) = (model.spectrum.highest, model.damping());
    let used = model.whole.star_count.iter().filter(|c| **c > 0).count();
    let limit = |step: f64| step.is_finite().then_some(step);
    let loaded: std::collections::BTreeSet<u32> =
        model.boundary.loads.iter().map(|l| l.node).collect();
    Inspection {
        name: model.scene.name.clone(),
        vertices: model.mesh.nodes.len() - model.parts.spares,
        edges: Pattern::new(model.mesh.nodes.len(), &model.mesh.tetrahedra).edges(),
        tetrahedra: model.mesh.tetrahedra.len(),
        surface_triangles: model.whole.surface.len(),
        pieces: model.report.pieces,
        volume: materials.iter().map(|m| m.volume).sum(),
        mass: materials.iter().map(|m| m.mass).sum(),
        materials,
        fixed_nodes: model
            .boundary
            .fixed
            .iter()
            .filter(|f| **f != [false; 3])
            .count(),
        prescribed_nodes: model.boundary.prescribed.len(),
        loaded_nodes: loaded.len(),
        dynamic_tetrahedra: model.parts.dynamic.iter().filter(|d| **d).count(),
        connection_nodes: model.parts.connection,
        touchable_nodes: model.parts.touchable,
        interface_error: crate::reference::interface_error(model).unwrap_or_default(),
        critical_step: BTreeMap::from([
            ("euler", limit(critical_step::euler(omega, damping))),
            (
                "symplecticEuler",
                limit(critical_step::symplectic_euler(omega, 0.0)),
            ),
            (
                "centralDifference",
                limit(critical_step::central_difference(omega)),
            ),
            (
                "rungeKutta4",
                limit(critical_step::runge_kutta_4(omega, 0.0)),
            ),
            ("implicitEuler", None),
        ]),
        scheme: model.scheme(),
        substep: model.substep(damping),
        damping,
        lowest_frequency: Some(model.spectrum.lowest / std::f64::consts::TAU).filter(|f| *f > 0.0),
        minimum_dihedral: model.report.minimum_dihedral_degrees,
        seconds_per_substep: time_substep(model),
        substep_shares: model.is_staggered().then(|| time_shares(model)),
        memory_bytes: model.whole.bytes()
            + model.parts.known.min(used) * 8 * (6 * 4 + 2)
            + model.precomputed.as_ref().map_or(0, |p| p.bytes()),
        warnings: warnings(model),
    }
}

/// Things a user should know, one line each.
pub fn warnings(model: &Model) -> Vec<String> {
    let mut warnings = Vec::new();
    let report = &model.report;
    if report.flipped > 0 {
        warnings.push(format!(
            "{} tetrahedra were inverted and have been turned",
            report.flipped
        ));
    }
    let nearly = (model.scene.materials.iter())
        .map(|m| m.poisson_ratio)
        .fold(0.0, f64::max);
    if model.is_averaged() && nearly > MOST_POISSON_RATIO {
        warnings.push(format!(
            "nodalAveraged computes with a Poisson's ratio of {MOST_POISSON_RATIO} in place of {nearly}: forces change by a few per cent, and substeps are longer"
        ));
    }
    if let Some(first) = report.unreferenced.first() {
        let count = report.unreferenced.len();
        warnings.push(format!("{count} nodes belong to no tetrahedron (the first is {first}); they stay where they are"));
    }
    if report.coincident > 0 {
        warnings.push(format!(
            "{} nodes lie exactly on another: the tissue there touches but does not hold together",
            report.coincident
        ));
    }
    if report.hinge_edges > 0 {
        warnings.push(format!(
            "{} edges hold tissue together like hinges",
            report.hinge_edges
        ));
    }
    if report.minimum_dihedral_degrees < 5.0 {
        warnings.push(format!(
            "tetrahedron {} has a dihedral angle of {:.1} degrees or less in its neighbourhood; slivers shorten the substep",
            report.worst_tetrahedron, report.minimum_dihedral_degrees
        ));
    }
    let springs = model.scene.model.kind == ModelKind::SpringMass;
    if springs {
        warnings.push(
            "forces of springMass are not those of the material: Poisson's ratio has no effect, and stiffness depends on the mesh"
                .to_string(),
        );
    }
    if model.rigid_modes > 0 {
        // All other pieces move in frames of their own.
        let turning = if springs || !model.parts.has_precomputed() {
            ""
        } else {
            ", and where some of it is pre-computed the linear law swells it when it turns"
        };
        warnings.push(format!(
            "{} rigid motions are not held: tissue that nothing fixes falls{turning}",
            model.rigid_modes
        ));
    }
    let lumped = model.scene.model.interface_mass == InterfaceMass::Lumped;
    if model.parts.connection > 0 && lumped && model.precomputed_rigid_modes(false) > 0 {
        warnings.push(
            "a pre-computed piece is held by the dynamic part alone: without inertia of its own it swings and falls too fast; use \"interfaceMass\": \"guyan\", or make it dynamic"
                .to_string(),
        );
    }
    if let Ok(Some(error)) = crate::reference::interface_error(model)
        && error > 0.05
    {
        warnings.push(format!(
            "so few interface modes move the equilibrium by {:.0} %",
            100.0 * error
        ));
    }
    let cauteries = (model.scene.tools.iter()).any(|t| t.kind == ToolKind::Cautery);
    if cauteries && !model.parts.dynamic.contains(&true) {
        warnings.push("a cautery has nothing to cut: all tissue is pre-computed".to_string());
    }
    if model.scene.tearing.is_some() {
        if !model.parts.dynamic.contains(&true) {
            warnings.push("nothing can tear: all tissue is pre-computed".to_string());
        }
        let past = tear::past_threshold(model, &State::new(model)).len();
        if past > 0 {
            warnings.push(format!(
                "{past} tetrahedra are past tearing.threshold at the start and tear at once"
            ));
        }
    }
    let (damping, critical) = (model.damping(), model.critical_step(model.damping()));
    let substep = model.substep(damping);
    if substep > critical {
        warnings.push(format!(
            "the substep of {substep:.3e} s is above the critical {critical:.3e} s; steps will be halved or discarded"
        ));
    }
    warnings
}

/// Median of a few substeps \[s\]; of sweeps alone where the scheme is one sweep a substep.
fn time_substep(model: &Model) -> f64 {
    let mut run: Box<dyn FnMut()> = if model.is_staggered() {
        Box::new(sweeping(model, true))
    } else {
        let mut state = State::new(model);
        let mut work = Workspace::new(model, &state);
        let h = state.nominal_substep;
        Box::new(move || {
            state.sleep.wake();
            // What it comes to does not matter.
            let _ = advance(model, &mut state, &mut work, 1, h);
        })
    };
    median_time(&mut run)
}

/// Of 21 runs \[s\].
fn median_time(run: &mut dyn FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..21)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// Steps as long as a haptic period, with and without the search for contact, beside their sweeps.
fn time_shares(model: &Model) -> SubstepShares {
    let state = State::new(model);
    let (count, h) = division(
        1.0 / model.scene.integration.haptic_rate,
        state.nominal_substep,
    );
    let step = |frozen: bool| {
        let mut state = state.clone();
        state.reserve(model);
        let mut work = Workspace::new(model, &state);
        work.frozen = frozen;
        median_time(&mut || {
            state.sleep.wake();
            let _ = advance(model, &mut state, &mut work, count, h);
        }) / count as f64
    };
    let (all, frozen) = (step(false), step(true));
    let both = median_time(&mut sweeping(model, true));
    let sweep = median_time(&mut sweeping(model, false)).min(both);
    let parts = [
        sweep,
        both - sweep,
        (all - frozen).max(0.0),
        (frozen - both).max(0.0),
    ];
    let sum: f64 = parts.iter().sum();
    let [sweep, coupling, contact, rest] = parts.map(|t| t / sum);
    SubstepShares {
        sweep,
        coupling,
        contact,
        rest,
    }
}

fn sweeping(model: &Model, coupled: bool) -> impl FnMut() + '_ {
    let nodes = model.parts.moving;
    let zeros = move || vec![Lane::default(); nodes];
    let (mut displacement, mut velocity, mut residual, mut partial) =
        (zeros(), zeros(), zeros(), zeros());
    let (external, inverse_mass) = (zeros(), zeros());
    let mut points = vec![0.0; model.whole.points()];
    let mut coupling = Coupling::new(model);
    move || {
        if coupled {
            coupling.solve(model, &displacement);
        }
        let mut motion = Motion {
            displacement: &mut displacement,
            velocity: &mut velocity,
            residual: &mut residual,
            partial: &mut partial,
            external: &external,
            inverse_mass: &inverse_mass,
            mass: &model.whole.mass[..nodes],
            listed: None,
        };
        model.whole.sweep(
            model,
            &mut motion,
            &mut points,
            &Advance::symplectic_euler(1e-3, 1e-3, 1.0),
        );
    }
}
