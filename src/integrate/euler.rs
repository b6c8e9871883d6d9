//! Explicit Euler: both from the start of the substep,
//!
//! u_{n+1} = u_n + h v_n,  v_{n+1} = v_n + h M^-1 (f_n - K u_n - c M v_n).
//!
//! Stable for omega h < min(2 zeta, 1/zeta) only, and of first order: here for comparison. Its energy account
//! misses h²/2 (|a|_M² + |v|_K²) a substep.

use super::{book, evaluate, place_held, take_velocity};
use crate::model::Model;
use crate::state::State;
use crate::step::{StepError, Workspace, watch};

pub(super) fn substep(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    h: f64,
    tick: bool,
) -> Result<(), StepError> {
    take_velocity(model, state, &mut work.impulse);
    let before = state.account;
    let sums = evaluate(model, state, work, state.parameters.damping);
    watch(model, state, &before, &sums, 0.5 * sums.kinetic, 0.0, tick)?;
    book(model, state, work, h);
    for i in 0..model.parts.moving {
        for axis in 0..3 {
            let v = state.velocity[i].0[axis];
            state.displacement[i].0[axis] += h * v;
            state.velocity[i].0[axis] +=
                h * state.inverse_mass[i].0[axis] * work.residual[i].0[axis];
        }
    }
    place_held(state, 1.0, h);
    state.coupling.solve(model, &state.displacement);
    Ok(())
}
