//! The classical Runge-Kutta scheme of fourth order (Kutta 1901) on (u, v): slopes at the start, twice in
//! the middle and at the end, weighted 1/6, 1/3, 1/3, 1/6. The papers' choice.
//!
//! Damping, tools, supports and growing loads are booked by the same weights. What the account then misses, of
//! fourth order in slow modes and mostly numerical damping in fast ones, is booked as made, or dissipated with
//! the sign turned, at the start of the next substep. No watchdog looks at it: the limit of the step is known.

use super::{book, evaluate, place_held, take_velocity};
use crate::energy::Account;
use crate::model::Model;
use crate::model::boundary::ramp;
use crate::model::tensor_mass::Lane;
use crate::scene::Scheme;
use crate::state::State;
use crate::step::{StepError, Workspace, watch};

/// Time of a stage and its weight, as shares of the substep.
const STAGES: [(f64, f64); 4] = [
    (0.0, 1.0 / 6.0),
    (0.5, 1.0 / 3.0),
    (0.5, 1.0 / 3.0),
    (1.0, 1.0 / 6.0),
];

/// A moving node each; empty with other schemes.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// At the start of the substep.
    displacement: Vec<Lane>,
    velocity: Vec<Lane>,
    /// Weighted slopes so far.
    mean_velocity: Vec<Lane>,
    mean_acceleration: Vec<Lane>,
}

impl Scratch {
    pub fn new(model: &Model) -> Scratch {
        if model.scheme() != Scheme::RungeKutta4 {
            return Scratch::default();
        }
        let zeros = || vec![Lane::default(); model.parts.moving];
        Scratch {
            displacement: zeros(),
            velocity: zeros(),
            mean_velocity: zeros(),
            mean_acceleration: zeros(),
        }
    }
}

pub(super) fn substep(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    h: f64,
    tick: bool,
) -> Result<(), StepError> {
    take_velocity(model, state, &mut work.impulse);
    let moving = model.parts.moving;
    work.stages
        .displacement
        .copy_from_slice(&state.displacement[..moving]);
    work.stages
        .velocity
        .copy_from_slice(&state.velocity[..moving]);
    work.stages.mean_velocity.fill(Lane::default());
    work.stages.mean_acceleration.fill(Lane::default());
    for (stage, (at, weight)) in STAGES.into_iter().enumerate() {
        let growing = weight * growth(model, state);
        state.account.support_work += growing;
        set_loads(model, state, at);
        let sums = evaluate(model, state, work, state.parameters.damping);
        if stage == 0 {
            let account = &mut state.account;
            let energy = 0.5 * (sums.elastic + sums.kinetic) - sums.external;
            let work_done = account.tool_work + account.support_work - growing;
            let made = energy + account.dissipated - work_done - account.start;
            account.made += made;
            account.dissipated -= made;
            let before = Account {
                support_work: account.support_work - growing,
                ..*account
            };
            watch(model, state, &before, &sums, 0.5 * sums.kinetic, 0.0, tick)?;
        }
        book(model, state, work, weight * h);
        let next = STAGES.get(stage + 1).map(|(next, _)| next * h);
        let Workspace {
            stages, residual, ..
        } = work;
        for i in 0..moving {
            for axis in 0..3 {
                let v = state.velocity[i].0[axis];
                let a = state.inverse_mass[i].0[axis] * residual[i].0[axis];
                stages.mean_velocity[i].0[axis] += weight * v;
                stages.mean_acceleration[i].0[axis] += weight * a;
                let (length, v, a) = match next {
                    Some(next) => (next, v, a),
                    None => (
                        h,
                        stages.mean_velocity[i].0[axis],
                        stages.mean_acceleration[i].0[axis],
                    ),
                };
                state.displacement[i].0[axis] = stages.displacement[i].0[axis] + length * v;
                state.velocity[i].0[axis] = stages.velocity[i].0[axis] + length * a;
            }
        }
        place_held(state, STAGES.get(stage + 1).map_or(1.0, |(at, _)| *at), h);
    }
    state.coupling.solve(model, &state.displacement);
    Ok(())
}

fn time(state: &State, share: f64) -> f64 {
    if share == 1.0 {
        // To the bit what the clock will say.
        return state.clock.next();
    }
    state.clock.time() + share * state.clock.substep
}

/// Loads and amplitudes after a share of the substep.
fn set_loads(model: &Model, state: &mut State, share: f64) {
    let time = time(state, share);
    let gravity = state.parameters.gravity;
    state.coupling.set_amplitudes(model, &gravity, time);
    for load in &model.boundary.loads {
        let i = load.node as usize;
        let grows = load.ramp > 0.0 && time <= load.ramp + 2.0 * state.clock.substep;
        if grows && i < model.parts.moving {
            state.refresh_external_at(model, i, time);
        }
    }
}

/// What the growth of loads and amplitudes in the whole substep adds to the potential at the present
/// displacements \[J\]. It is quadratic in the amplitudes, so that their rate may stand outside the stages.
fn growth(model: &Model, state: &mut State) -> f64 {
    let (start, end) = (time(state, 0.0), time(state, 1.0));
    let mut sum = 0.0;
    for load in &model.boundary.loads {
        let i = load.node as usize;
        if i < model.parts.moving && state.live.star_count[i] > 0 {
            let share = ramp(end, load.ramp) - ramp(start, load.ramp);
            sum -= share * load.force.dot(&state.displacement[i].xyz());
        }
    }
    let gravity = state.parameters.gravity;
    state.coupling.set_amplitudes(model, &gravity, start);
    if state.coupling.set_amplitudes(model, &gravity, end) {
        state.coupling.solve(model, &state.displacement);
        sum += state.coupling.energy(model).total();
        state.coupling.set_amplitudes(model, &gravity, start);
        state.coupling.solve(model, &state.displacement);
        sum -= state.coupling.energy(model).total();
    }
    sum
}
