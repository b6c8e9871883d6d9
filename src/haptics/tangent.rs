//! The tangent of the next step: d (force, torque) / d pose, what every tool holds staying held.
//!
//! By central differences of two trial steps for each component of a pose, of the length of the last step (before any
//! step: the haptic period), made on a copy of the state:
//!
//! dF/dx = (F(x + d) - F(x - d)) / 2d.
//!
//! A trial does what the step would do, its halvings included, but nothing attaches, lets go, is cut, burns or tears.
//! d is a ten-thousandth of the mean edge, for a component of a quaternion what turns the farthest vertex held as far:
//! the curvature of the laws then adds 1e-8 or so, round-off less. Linear tissue that is stuck to its tools has no
//! curvature, and no memory of its state: see [`super::response`].

use super::HapticsError;
use super::response::Response;
use super::settled::Settled;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::tensor_mass::Lane;
use crate::state::State;
use crate::step::{self, Workspace};

/// Perturbation of a position, in mean edges, and the largest of a unit quaternion.
const SMALL: f64 = 1e-4;
/// The same where something slides: friction turns with the way.
const SMALL_RUBBING: f64 = 4e-6;
/// Components of a pose: x y z, w x y z.
const POSE: usize = 7;

/// d force \[N\] and d torque \[N m\] of a tool by a component of a pose.
pub type Column = [f64; 6];

/// What has been asked for since something changed, and room for more.
#[derive(Debug, Default)]
pub struct Haptics {
    /// For trials; made when first needed.
    spare: Option<Box<State>>,
    /// By the tool moved, the component of its pose, the tool that feels it.
    columns: Vec<Column>,
    known: Vec<bool>,
    response: Response,
    pub(super) settled: Settled,
}

impl Haptics {
    /// The state, an input or a parameter is another one.
    pub(crate) fn forget(&mut self) {
        self.known.fill(false);
        self.settled.forget();
    }

    /// The history of cuts may be another one, too.
    pub(crate) fn forget_all(&mut self) {
        self.forget();
        self.response.forget();
        self.settled.forget_all();
    }

    /// Of the tool `of`, by a component of the pose of the tool `by`.
    pub(crate) fn tangent(
        &mut self,
        model: &Model,
        state: &State,
        work: &mut Workspace,
        of: usize,
        by: usize,
        component: usize,
    ) -> Result<Column, HapticsError> {
        let tools = state.tools.len();
        if !state.is_felt_by(of) || !state.is_felt_by(by) {
            return Ok([0.0; 6]);
        }
        if self.known.is_empty() {
            self.known.resize(tools * POSE, false);
            self.columns.resize(tools * POSE * tools, [0.0; 6]);
        }
        let at = by * POSE + component;
        if !self.known[at] {
            self.find(model, state, work, by, component)?;
            let columns = &self.columns[at * tools..(at + 1) * tools];
            if !columns.iter().flatten().all(|x| x.is_finite()) {
                return Err(HapticsError::NonFinite);
            }
            self.known[at] = true;
        }
        Ok(self.columns[at * tools + of])
    }

    /// The columns of all tools.
    fn find(
        &mut self,
        model: &Model,
        state: &State,
        work: &mut Workspace,
        by: usize,
        component: usize,
    ) -> Result<(), HapticsError> {
        let tools = state.tools.len();
        let spare = self.spare.get_or_insert_with(|| {
            let mut spare = Box::new(state.clone());
            spare.reserve(model);
            spare
        });
        let at = (by * POSE + component) * tools;
        let columns = &mut self.columns[at..at + tools];
        let iterations = work.iterations;
        work.frozen = true;
        let mut outcome = Ok(false);
        if component < 3 {
            outcome = (self.response).columns(model, state, spare, work, by, component, columns);
        }
        if !matches!(outcome, Ok(true)) {
            work.partial.fill(Lane::default());
            outcome = differences(model, state, spare, work, by, component, columns).map(|()| true);
        }
        if outcome.is_err() {
            work.partial.fill(Lane::default());
            work.forget();
        }
        work.frozen = false;
        work.iterations = iterations;
        outcome.map(|_| ()).map_err(HapticsError::Trial)
    }
}

/// Length of the next step \[s\], as far as it is known.
pub(super) fn length(model: &Model, state: &State) -> f64 {
    match state.length > 0.0 {
        true => state.length,
        false => 1.0 / model.scene.integration.haptic_rate,
    }
}

/// Columns by differences.
fn differences(
    model: &Model,
    state: &State,
    spare: &mut State,
    work: &mut Workspace,
    by: usize,
    component: usize,
    columns: &mut [Column],
) -> Result<(), step::StepError> {
    let length = length(model, state);
    let change = perturbation(model, state, by, component);
    let perturb = |spare: &mut State, change: f64| {
        spare.copy_from(model, state);
        let value = &mut spare.tools[by].input.value[component];
        *value += change;
        *value
    };
    let above = perturb(spare, change);
    let halvings = step::step(model, spare, work, length)?;
    for (column, tool) in columns.iter_mut().zip(&spare.tools) {
        *column = felt(&tool.force, &tool.torque);
    }
    let below = perturb(spare, -change);
    let (n, h) = step::halved(spare, length, halvings);
    step::advance(model, spare, work, n, h)?;
    for (column, tool) in columns.iter_mut().zip(&spare.tools) {
        for (x, below_x) in column.iter_mut().zip(felt(&tool.force, &tool.torque)) {
            *x = (*x - below_x) / (above - below);
        }
    }
    Ok(())
}

pub(super) fn felt(force: &Vec3, torque: &Vec3) -> Column {
    [force.x, force.y, force.z, torque.x, torque.y, torque.z]
}

/// d \[m\], or as a part of the quaternion \[1\].
fn perturbation(model: &Model, state: &State, by: usize, component: usize) -> f64 {
    let slides = state.contacts.iter().any(|c| c.force != Vec3::zeros());
    let small = if slides { SMALL_RUBBING } else { SMALL };
    let distance = small * model.mean_edge;
    if component < 3 {
        return distance;
    }
    let held = state.held.iter().filter(|h| h.tool == Some(by as u32));
    let touched = state.contacts.iter().filter(|c| c.tool == by as u32);
    let pose = &state.tools[by].pose;
    let away = |v: u32| pose.local(&state.position(v)).norm();
    let all = held.map(|h| h.local.norm());
    let farthest = all
        .chain(touched.map(|c| away(c.nodes[0])))
        .fold(0.0, f64::max);
    let [_, _, _, w, x, y, z] = state.tools[by].input.value;
    let size = (w * w + x * x + y * y + z * z).sqrt();
    // A change of q turns by twice as much.
    size * (0.5 * distance / farthest).min(small)
}
