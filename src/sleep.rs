//! Tissue at rest sleeps: substeps that could change nothing are counted, not computed.
//!
//! It falls asleep at the first substep of a haptic period, when at all ticks of the last 4/c seconds, c the damping \[1/s\],
//!
//! - every tool has stood still since the tick before, with its switch and all parameters as they were, and no current is on;
//! - no vertex has moved by more than 1e-14 of the size of the tissue in the substep: the round-off of positions in motion;
//! - the forces of what slides on pre-computed tissue, which no inertia shows, have changed by no more than 1e-11 of themselves;
//! - no piece is loose, and no load and no support is on its ramp.
//!
//! A vertex that stands still for a moment, where it turns, does not do so for 4/c: modes of omega > c/2 swing by two radians
//! in that time, slower ones do not swing. What creeps is asleep when it would take h 1e14 seconds, h the substep, to go as far as it is
//! long. Without damping nothing ever sleeps. Tissue without inertia, all of it being pre-computed, needs no 4/c, but two ticks.
//!
//! What kinetic energy is left, some 1e-24 J, is dissipated. What sleeps wakes at the first substep in which any of this differs, from the
//! state as it was when it fell asleep.

use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::tensor_mass::Lane;
use crate::pose::Path;
use crate::scene::ToolKind;
use crate::state::State;

/// Way in a substep that counts as none, in sizes of the tissue.
const STILL: f64 = 1e-14;
/// In 1/c.
const CALM: f64 = 4.0;
/// Ticks that tissue without inertia needs.
const LEAST_TICKS: f64 = 2.0;
/// Relative change in a substep of the forces of what slides on pre-computed tissue.
const SETTLED: f64 = 1e-11;

/// Part of the state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sleep {
    pub asleep: bool,
    /// Haptic ticks in a row at which nothing moved.
    pub calm: u64,
}

impl Sleep {
    pub fn wake(&mut self) {
        *self = Sleep::default();
    }
}

/// Whether a tool moves or is switched in this step.
pub(crate) fn is_stirred(state: &State, paths: &[Path]) -> bool {
    (state.tools.iter().zip(paths))
        .any(|(tool, path)| tool.active != tool.input_active || !path.stays_at(&tool.pose))
}

/// Whether a scripted cut is due before the end of `seconds` from now.
pub(crate) fn is_cut_due(model: &Model, state: &State, seconds: f64) -> bool {
    (model.cuts.get(state.cuts_done)).is_some_and(|cut| cut.time <= state.clock.time() + seconds)
}

/// Sum of the forces of what slides, and of their sizes \[N\].
pub(crate) fn pressing(state: &State) -> (Vec3, f64) {
    let none = (Vec3::zeros(), 0.0);
    (state.contacts.iter()).fold(none, |(sum, size), c| {
        (sum + c.force, size + c.force.norm())
    })
}

/// One substep of `h` \[s\] goes by, with haptic ticks every `period` \[s\].
pub(crate) fn pass(model: &Model, state: &mut State, h: f64, period: f64) {
    if state.since_haptic + h > period {
        state.since_haptic = 0.0;
    }
    state.clock.lag = model.lag(h);
    state.clock.ticks += 1;
    state.clock.total += 1;
    state.since_haptic += h;
}

/// After the substep of `h` \[s\] at a haptic tick, `before` being what [`pressing`] said at its start. Whether it falls asleep: what
/// depends on velocities must be found anew then.
pub(crate) fn falls_asleep(model: &Model, state: &mut State, h: f64, before: (Vec3, f64)) -> bool {
    if !is_calm(model, state, h, before) {
        state.sleep.calm = 0;
        return false;
    }
    state.sleep.calm += 1;
    let period = h.max(1.0 / model.scene.integration.haptic_rate);
    let needed = match model.parts.moving {
        0 => LEAST_TICKS,
        _ => CALM / (state.parameters.damping * period),
    };
    if (state.sleep.calm as f64) < needed || ramps(model, state, h) {
        return false;
    }
    let moving = state.live.mass.iter().zip(&state.velocity);
    let twice_kinetic: f64 = (moving.take(model.parts.moving))
        .map(|(m, v)| m * v.xyz().norm_squared())
        .sum();
    state.account.dissipated += 0.5 * twice_kinetic;
    state.velocity.fill(Lane::default());
    state.sleep.asleep = true;
    true
}

/// Cheap where anything moves: it ends at the first vertex that does.
fn is_calm(model: &Model, state: &State, h: f64, before: (Vec3, f64)) -> bool {
    let most = STILL * model.size / h;
    let burns = |(k, tool): (usize, &crate::scene::Tool)| {
        tool.kind == ToolKind::Cautery && state.tools[k].active
    };
    let (sum, size) = pressing(state);
    let change = (sum - before.0).norm() + (size - before.1).abs();
    state.live.pieces.loose_nodes().is_empty()
        && change <= SETTLED * size
        && !model.scene.tools.iter().enumerate().any(burns)
        && (state.velocity.iter()).all(|v| v.xyz().norm_squared() <= most * most)
}

/// Whether a load or a support is still on its way.
fn ramps(model: &Model, state: &State, h: f64) -> bool {
    let boundary = &model.boundary;
    let loads = boundary.loads.iter().map(|load| load.ramp);
    let supports = boundary.prescribed.iter().flat_map(|p| p.ramp);
    // The last change is made up to two substeps after the end.
    state.clock.time() <= loads.chain(supports).fold(0.0, f64::max) + 2.0 * h
}
