//! Time integration of M dv/dt = f(t) - K u - c M v, du/dt = v: one scheme a file.
//!
//! M lumped mass \[kg\], K stiffness with the condensed pre-computed part \[N/m\], c damping \[1/s\]. Nodes that
//! something holds go straight to their target during a substep; what that takes is their reaction.

pub(crate) mod euler;
pub(crate) mod implicit_euler;
pub(crate) mod leapfrog;
pub(crate) mod runge_kutta_4;

use crate::energy::inject;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::sweep::{Advance, Motion, Sums};
use crate::scene::Scheme;
use crate::state::State;
use crate::step::{StepError, Workspace};

/// One substep of length `h` \[s\]; held nodes have their targets, `tick` says whether contact was looked
/// at just now.
pub(crate) fn substep(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    h: f64,
    tick: bool,
) -> Result<(), StepError> {
    match model.scheme() {
        Scheme::SymplecticEuler | Scheme::CentralDifference => {
            leapfrog::substep(model, state, work, h, tick)
        }
        Scheme::Euler => euler::substep(model, state, work, h, tick),
        Scheme::RungeKutta4 => runge_kutta_4::substep(model, state, work, h, tick),
        Scheme::ImplicitEuler => implicit_euler::substep(model, state, work, h, tick),
    }
}

/// r = f - K u - c M v \[N\] into `work.residual`, at displacements, velocities and loads as they are: a
/// sweep that moves nothing.
fn evaluate(model: &Model, state: &mut State, work: &mut Workspace, damping: f64) -> Sums {
    state.coupling.solve(model, &state.displacement);
    let by = Advance::symplectic_euler(0.0, 0.0, damping);
    let [mut sums, loose] = sweep(model, state, work, &by);
    work.damped = damping * sums.kinetic + work.loose.braked;
    sums += loose;
    add_inside(model, state, &mut sums);
    sums
}

/// The moving nodes under the force of the pre-computed part as it was last solved. Sums of those that supports
/// hold and of the loose ones; elastic energy is all in the first.
fn sweep(model: &Model, state: &mut State, work: &mut Workspace, by: &Advance) -> [Sums; 2] {
    let moving = model.parts.moving;
    work.loose.set_aside(state);
    inject(model, &state.coupling, &mut work.partial);
    if let Some(listed) = &mut work.listed {
        let (live, u) = (&state.live, &state.displacement[..moving]);
        listed.refresh(
            live.elements.as_ref(),
            live.blend.as_ref(),
            live.revision,
            u,
        );
    }
    let mut motion = Motion {
        displacement: &mut state.displacement[..moving],
        velocity: &mut state.velocity[..moving],
        residual: &mut work.residual,
        partial: &mut work.partial,
        external: &state.external[..moving],
        inverse_mass: &state.inverse_mass[..moving],
        mass: &state.live.mass[..moving],
        listed: work.listed.as_ref(),
    };
    let sums = state.live.sweep(model, &mut motion, &mut work.points, by);
    let Workspace {
        loose,
        residual,
        partial,
        ..
    } = work;
    [sums, loose.carry(model, state, residual, partial, by)]
}

/// Energies inside the pre-computed part, in place of the work of its force.
fn add_inside(model: &Model, state: &State, sums: &mut Sums) {
    let inside = state.coupling.energy(model);
    sums.elastic += state.coupling.virial() + 2.0 * inside.elastic;
    sums.external -= inside.gravity + inside.load;
}

/// Held nodes take the velocity of what holds them. The impulse that takes acts at the mean of the two
/// velocities; where a tool has just taken hold it acts at the tool's, and what the node does not gain is
/// lost.
fn take_velocity(model: &Model, state: &mut State, impulse: &mut [Vec3]) {
    for held in &mut state.held {
        let i = held.node as usize;
        // What is inside the pre-computed part has no inertia.
        let mass = if i < model.parts.moving {
            state.live.mass[i]
        } else {
            0.0
        };
        let (mut gained, mut lost, mut push) = (0.0, 0.0, Vec3::zeros());
        for axis in (0..3).filter(|a| held.axes[*a]) {
            let v_new = held.velocity[axis];
            let v = std::mem::replace(&mut state.velocity[i].0[axis], v_new);
            gained += 0.5 * mass * (v_new * v_new - v * v);
            lost += 0.5 * mass * (v_new - v) * (v_new - v);
            push[axis] = mass * (v_new - v);
        }
        let Some(tool) = held.tool else {
            state.account.support_work += gained;
            continue;
        };
        state.account.tool_work += gained;
        impulse[tool as usize] -= push;
        if std::mem::replace(&mut held.fresh, false) {
            state.account.tool_work += lost;
            state.account.dissipated += lost;
        }
    }
}

/// Puts held nodes where they are after the share `s` of the substep.
fn place_held(state: &mut State, s: f64, h: f64) {
    for held in &state.held {
        let i = held.node as usize;
        for axis in (0..3).filter(|a| held.axes[*a]) {
            state.displacement[i].0[axis] = held.target[axis] - (1.0 - s) * h * held.velocity[axis];
        }
    }
}

/// Books what damping, tools and supports do in `seconds` at the forces just evaluated: c v.Mv, and
/// lambda.v with lambda = -r of what is held.
fn book(model: &Model, state: &mut State, work: &mut Workspace, seconds: f64) {
    state.account.dissipated += seconds * work.damped;
    for held in &state.held {
        let i = held.node as usize;
        let all = match i.checked_sub(model.parts.moving) {
            Some(inside) => state.coupling.pressure_on(inside),
            None => -work.residual[i].xyz(),
        };
        let lambda = Vec3::from_fn(|axis, _| if held.axes[axis] { all[axis] } else { 0.0 });
        let done = seconds * held.velocity.dot(&lambda);
        match held.tool {
            Some(tool) => {
                state.account.tool_work += done;
                work.impulse[tool as usize] -= lambda * seconds;
            }
            None => state.account.support_work += done,
        }
    }
}
