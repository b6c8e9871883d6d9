//! Symplectic Euler and central difference: velocities at half steps, one fused sweep a substep.

use super::{add_inside, sweep};
use crate::contact::hold::{self, Held};
use crate::contact::press;
use crate::contact::slide::{self, Substep};
use crate::loose;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::sweep::{Advance, Sums};
use crate::scene::Scheme;
use crate::state::{State, ToolState};
use crate::step::{StepError, Workspace, watch};

/// The equations are those of [`crate::model::sweep`].
pub(super) fn substep(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    h: f64,
    tick: bool,
) -> Result<(), StepError> {
    let central = model.scheme() == Scheme::CentralDifference;
    let by = model.advance(state.clock.lag, h, state.parameters.damping);
    work.interface.keep(model, state);
    let [mut sums, loose] = sweep(model, state, work, &by);
    let (lag, braked) = (state.clock.lag, work.loose.braked);
    add_inside(model, state, &mut sums);
    work.interface
        .advance(model, state, &mut work.residual, &by, &mut sums);
    let before = state.account;
    let mut sums = [sums, loose];
    let substep = Substep {
        from: &work.from,
        residual: &work.residual,
        by: &by,
    };
    let pushed = slide::push(
        model,
        state,
        &mut work.slide,
        &substep,
        &mut work.impulse,
        &mut sums,
    );
    let ([mut sums, loose], trailing, given) = carry_held(model, state, work, sums, &by);
    let trailing = trailing + pushed;
    let (mut behind, mut ahead) = damped(&sums, lag, &by, central);
    behind += 0.5 * lag * braked;
    ahead += work.loose.taken(state, 0.5 * h);
    sums += loose;
    let kinetic = kinetic(&sums, lag, h);
    let substep = Substep {
        from: &work.from,
        residual: &work.residual,
        by: &by,
    };
    press::press(model, state, &mut work.slide, &substep, &mut work.impulse);
    watch(
        model,
        state,
        &before,
        &sums,
        kinetic,
        trailing - behind,
        tick,
    )?;
    let made = made(&sums, lag, h) - given;
    state.account.made += made;
    state.account.dissipated += behind + ahead - made;
    Ok(())
}

/// v_{n-1/2} lies half of `lag` before this point, v_{n+1/2} half of h behind it:
/// T_n = v_- . M v_- / 2 + lag/2 v_- . F_n, F_n = M (v_+ - v_-)/kick. v_- . M v_+ / 2 for equal lengths.
fn kinetic(sums: &Sums, lag: f64, h: f64) -> f64 {
    0.5 * (sums.lagging + 2.0 * lag / (lag + h) * (sums.kinetic - sums.lagging))
}

/// Energy gained where the substep changes: (lag - h)/4 F_n . M^-1 F_n kick.
fn made(sums: &Sums, lag: f64, h: f64) -> f64 {
    0.5 * (lag - h) / (lag + h) * (sums.damping - 3.0 * sums.kinetic + sums.lagging)
}

/// What damping takes at this point, trailing and leading half \[J\].
fn damped(sums: &Sums, lag: f64, by: &Advance, central: bool) -> (f64, f64) {
    if central {
        // c M (v_- + v_+)/2 along v_- lag/2 and v_+ h/2.
        (
            0.25 * lag * by.damping * (sums.lagging + sums.kinetic),
            0.25 * by.substep * by.damping * sums.damping,
        )
    } else {
        // c M v_- now and c M v_+ at the end, along the whole of v_+ h.
        (0.0, 0.5 * by.substep * by.damping * sums.damping)
    }
}

/// Central difference is of second order if the velocity before the start is half a substep behind:
/// v_{-1/2} = -h/2 M^-1 (f_ext - K u). The account's kinetic energy of that is booked.
pub(crate) fn half_step_back(model: &Model, state: &mut State, loose: &mut loose::Scratch, h: f64) {
    loose.measure(model, state);
    for i in 0..model.parts.moving {
        let force = if state.live.pieces.is_loose(i) {
            loose.residual(state, i)
        } else {
            let internal = state.live.internal_force(model, i, &state.displacement);
            state.external[i].xyz() - internal + state.coupling.force_on(model, i)
        };
        for axis in 0..3 {
            let gain = state.inverse_mass[i].0[axis];
            state.velocity[i].0[axis] = -0.5 * h * gain * force[axis];
            state.account.dissipated += 0.125 * h * h * gain * force[axis] * force[axis];
        }
    }
    let Some(guyan) = &model.guyan else {
        return;
    };
    let from = model.parts.connected_from();
    let mut force = Vec::new();
    for i in from..model.parts.moving {
        let mass = state.live.mass[i];
        for axis in 0..3 {
            let f = -2.0 * mass / h * state.velocity[i].0[axis];
            state.account.dissipated -= 0.25 * h * h * 0.5 / mass * f * f;
            force.push(f);
        }
    }
    let is_held = |dof: usize| state.inverse_mass[from + dof / 3].0[dof % 3] == 0.0;
    let acceleration = guyan.acceleration(&force, is_held);
    for (dof, a) in acceleration.iter().enumerate() {
        state.velocity[from + dof / 3].0[dof % 3] = -0.5 * h * a;
        state.account.dissipated += 0.125 * h * h * a * force[dof];
    }
}

/// Moves held nodes to their targets and books impulse and work. Returns the sums, those of loose nodes
/// apart, with held nodes in,
/// the trailing half of the work of tools and supports at this point, and the part of theirs that
/// [`made`] counts too.
fn carry_held(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    mut sums: [Sums; 2],
    by: &Advance,
) -> ([Sums; 2], f64, f64) {
    let (mut trailing, mut given) = (0.0, 0.0);
    let (lag, h) = (state.clock.lag, by.substep);
    let kick = 0.5 * (lag + h);
    let moving = model.parts.moving;
    find_borne(model, state, work, by);
    for held in &mut state.held {
        let i = held.node as usize;
        let share = held.tool.map_or(1.0, |tool| {
            let most = model.scene.tools[tool as usize].slip_force;
            most.map_or(1.0, |most| hold::share(&work.borne[tool as usize], most))
        });
        let tool_velocity = held.velocity;
        if let Some(inside) = i.checked_sub(moving) {
            let lambda = state.coupling.pressure_on(inside);
            if share < 1.0 {
                // G lambda is what it is away from where it would be: that much less.
                held.target -= state.coupling.gap_on(inside) * (1.0 - share);
                held.velocity = (held.target - state.displacement[i].xyz()) / h;
                slip(&mut state.tools, held, state.live.rest[i], tool_velocity, h);
                let lost = 0.5 * h * (tool_velocity - held.velocity).dot(&lambda);
                state.account.tool_work += lost;
                state.account.dissipated += lost;
            }
            let (v, v_new) = (state.velocity[i].xyz(), held.velocity);
            let behind = 0.5 * lag * v.dot(&lambda);
            trailing += behind;
            state.account.tool_work += behind + 0.5 * h * v_new.dot(&lambda);
            if let Some(tool) = held.tool {
                work.impulse[tool as usize] -= lambda * kick;
            }
            held.fresh = false;
            for axis in (0..3).filter(|a| held.axes[*a]) {
                state.velocity[i].0[axis] = v_new[axis];
                state.displacement[i].0[axis] = held.target[axis];
            }
            continue;
        }
        let mass = state.live.mass[i];
        let residual = &work.residual[i].0;
        let (sums, gain) = match state.live.pieces.is_loose(i) {
            false => (&mut sums[0], by.gain),
            true => (&mut sums[1], by.kick),
        };
        let mut lambda = Vec3::zeros();
        let (mut behind, mut ahead, mut jump) = (0.0, 0.0, 0.0);
        for axis in 0..3 {
            if !held.axes[axis] {
                continue;
            }
            let (v, mut v_new) = (state.velocity[i].0[axis], held.velocity[axis]);
            lambda[axis] = mass * (v_new - v) / gain - residual[axis];
            if share < 1.0 {
                lambda[axis] *= share;
                v_new = v + gain / mass * (residual[axis] + lambda[axis]);
                held.velocity[axis] = v_new;
                // The sweep has moved it on by v.
                held.target[axis] = state.displacement[i].0[axis] + h * (v_new - v);
            }
            behind += 0.5 * lag * v * lambda[axis];
            ahead += 0.5 * h * v_new * lambda[axis];
            jump += 0.5 * mass * (v_new - v) * (v_new - v);
            sums.kinetic += mass * v * (v_new - v);
            sums.damping += mass * (v_new * (v + v_new) - 2.0 * v * v);
            state.velocity[i].0[axis] = v_new;
            state.displacement[i].0[axis] = held.target[axis];
        }
        if share < 1.0 {
            slip(&mut state.tools, held, state.live.rest[i], tool_velocity, h);
            let lost = 0.5 * h * (tool_velocity - held.velocity).dot(&lambda);
            state.account.tool_work += lost;
            state.account.dissipated += lost;
        }
        trailing += behind;
        // Its own part of what uneven substeps would make: whoever leads it gives that.
        let extra = jump * (lag - h) / (lag + h);
        given += extra;
        ahead += extra;
        let Some(tool) = held.tool else {
            state.account.support_work += behind + ahead;
            continue;
        };
        state.account.tool_work += behind + ahead;
        work.impulse[tool as usize] -= lambda * kick;
        if std::mem::replace(&mut held.fresh, false) {
            // The tool's impulse acts at the tool's velocity; what the node does not gain is lost.
            state.account.tool_work += jump;
            state.account.dissipated += jump;
        }
    }
    (sums, trailing, given)
}

/// What each tool that may slip would have to bear if all it holds followed it \[N\].
fn find_borne(model: &Model, state: &State, work: &mut Workspace, by: &Advance) {
    work.borne.fill(Vec3::zeros());
    for held in &state.held {
        let Some(tool) = held.tool.map(|tool| tool as usize) else {
            continue;
        };
        if model.scene.tools[tool].slip_force.is_none() {
            continue;
        }
        let i = held.node as usize;
        work.borne[tool] += match i.checked_sub(model.parts.moving) {
            Some(inside) => state.coupling.pressure_on(inside),
            None => {
                let gain = match state.live.pieces.is_loose(i) {
                    false => by.gain,
                    true => by.kick,
                };
                let pull = (held.velocity - state.velocity[i].xyz()) * (state.live.mass[i] / gain);
                let lambda = pull - work.residual[i].xyz();
                Vec3::from_fn(|a, _| if held.axes[a] { lambda[a] } else { 0.0 })
            }
        };
    }
}

/// Where what has slipped is in the tool's frame now, `target` being where it is.
fn slip(tools: &mut [ToolState], held: &mut Held, rest: Vec3, tool_velocity: Vec3, h: f64) {
    let Some(tool) = held.tool else { return };
    let tool = &mut tools[tool as usize];
    held.local = tool.pose.local(&(rest + held.target));
    held.slipped += h * (tool_velocity - held.velocity).norm();
    tool.slips = true;
}
