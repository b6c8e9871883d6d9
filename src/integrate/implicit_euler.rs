//! Linearly implicit Euler (Baraff and Witkin 1998): forces at the end of the substep,
//!
//! M (v_+ - v) = h (f_+ - K u_+ - c M v_+),  u_+ = u + h v_+.
//!
//! With A = K + (1 + c h)/h² M and the force r* at u* = u + h v, v, the change of velocity x solves A x = r*/h
//! on what is free. Stable at any h; of first order, and fast modes are damped, which is booked:
//!
//! E_+ - E = -|v_+ - v|_M²/2 - |u_+ - u|_K²/2 - h c |v_+|_M² + h lambda_+ . v_+
//!
//! The solver is conjugate gradients. Its preconditioner is a Cholesky factor of A of the tissue as it was at
//! some removal, bordered by what tools hold: C x = 0 for moving nodes, and for held nodes inside the
//! pre-computed part the answer of their pressure, so that
//!
//! z = A^-1 (r + C^T mu),  (C A^-1 C^T + D) mu = -C A^-1 r,
//!
//! rows of C unit vectors (D = 0) or influences Phi_t (D = G_tt). While the factor is that of the tissue as it
//! is, this is the solution, found in one iteration. Each cut makes it an approximation; once the extra
//! iterations have cost as much as a factor, there is a new one. Which removals a factor contains is part of
//! the state, so that results do not depend on when a process began.

use super::{book, evaluate, take_velocity};
use crate::contact::hold::Held;
use crate::energy::inject;
use crate::live::LiveMesh;
use crate::loose;
use crate::mesh::topology::NONE;
use crate::model::Model;
use crate::model::dense::{Packed, add_scaled, dot};
use crate::model::precomputed::Precomputed;
use crate::model::sweep::{Advance, Motion, sweep};
use crate::model::tensor_mass::Lane;
use crate::scene::Scheme;
use crate::state::State;
use crate::statics::{Factor, Numbering, Room, StaticsError};
use crate::step::{StepError, Workspace, update_loads, watch};

/// Residual of the solution relative to the right side.
const TOLERANCE: f64 = 1e-11;
/// Iterations before what is there must do.
const MOST_ITERATIONS: u64 = 500;
/// Iterations after which a new factor is worth what it costs: as much as 8 to 18 of them, and all at once.
const RENEWAL: u64 = 20;
/// Held degrees of freedom there is room for without allocating.
const ROOM: usize = 384;

/// What a factor was made of.
#[derive(Debug, Default, PartialEq)]
struct Key {
    substep: f64,
    damping: f64,
    removed: Vec<u32>,
    splits: Vec<u32>,
}

/// Empty with other schemes.
#[derive(Default)]
pub(crate) struct Scratch {
    numbering: Option<Numbering>,
    /// 3 node + axis of each unknown.
    dof: Vec<u32>,
    /// Unknown of each 3 node + axis, or [`NONE`].
    unknown: Vec<u32>,
    key: Key,
    factor: Option<(Factor, Room)>,
    /// Degrees of freedom held of late, 3 node + axis, and A^-1 of their rows of C: a tool that comes back
    /// to one need not solve again.
    known: Vec<u32>,
    columns: Vec<f64>,
    /// Those held now, each its place in `known`; the factor of C A^-1 C^T + D.
    held: Vec<u32>,
    place: Vec<u32>,
    border: Packed,
    push: Vec<f64>,
    /// Conjugate gradients, an unknown each.
    residual: Vec<f64>,
    correction: Vec<f64>,
    direction: Vec<f64>,
    product: Vec<f64>,
    solution: Vec<f64>,
    /// A moving node each.
    swept: Vec<Lane>,
    still: Vec<Lane>,
    unloaded: Vec<Lane>,
    /// f - K u and the pressures of what is held inside, at the start of the substep.
    start: Vec<Lane>,
    pressure: Vec<f64>,
}

impl std::fmt::Debug for Scratch {
    fn fmt(&self, out: &mut std::fmt::Formatter) -> std::fmt::Result {
        out.debug_struct("Scratch").field("key", &self.key).finish()
    }
}

impl Scratch {
    pub fn new(model: &Model) -> Scratch {
        if model.scheme() != Scheme::ImplicitEuler {
            return Scratch::default();
        }
        let moving = model.parts.moving;
        // Spares may be needed.
        let free = |i: usize| match i < model.parts.spares {
            true => [true; 3],
            false => model.boundary.free[i].map(|f| f && model.whole.mass[i] > 0.0),
        };
        let dof: Vec<u32> = (0..3 * moving)
            .filter(|dof| free(dof / 3)[dof % 3])
            .map(|dof| dof as u32)
            .collect();
        let mut unknown = vec![NONE; 3 * moving];
        for (k, dof) in dof.iter().enumerate() {
            unknown[*dof as usize] = k as u32;
        }
        let numbers = || vec![0.0; dof.len()];
        let lanes = || vec![Lane::default(); moving];
        let mut border = Packed::default();
        border.reserve(ROOM);
        Scratch {
            numbering: Some(Numbering::new((0..moving).map(free))),
            key: Key {
                removed: Vec::with_capacity(model.mesh.tetrahedra.len()),
                ..Key::default()
            },
            factor: None,
            known: Vec::with_capacity(ROOM),
            held: Vec::with_capacity(ROOM),
            place: Vec::with_capacity(ROOM),
            // Only taken from the system as tools take hold.
            columns: Vec::with_capacity(ROOM * dof.len()),
            border,
            push: Vec::with_capacity(ROOM),
            residual: numbers(),
            correction: numbers(),
            direction: numbers(),
            product: numbers(),
            solution: numbers(),
            swept: lanes(),
            still: lanes(),
            unloaded: lanes(),
            start: lanes(),
            pressure: Vec::with_capacity(ROOM),
            unknown,
            dof,
        }
    }

    /// Makes the factor that the state asks for, unless it is there.
    fn factorise(&mut self, model: &Model, state: &State, h: f64) -> Result<(), StaticsError> {
        let damping = state.parameters.damping;
        let removed = &state.live.removed[..state.factored.removed];
        let splits = state.live.splits_before(removed.len());
        let Some(numbering) = &self.numbering else {
            return Ok(());
        };
        let is_there = self.factor.is_some()
            && (self.key.substep, self.key.damping) == (h, damping)
            && self.key.removed == removed
            && self.key.splits == splits;
        if is_there {
            return Ok(());
        }
        self.factor = None;
        let mut then = None;
        if removed.len() < state.live.removed.len() {
            then = Some(LiveMesh::after(model, removed, splits));
        }
        let live = then.as_ref().unwrap_or(&state.live);
        // What tissue has left altogether stays an unknown, alone.
        let mass: Vec<f64> = (live.mass.iter().zip(&model.whole.mass))
            .take(model.parts.moving)
            .map(|(now, whole)| match (*now > 0.0, *whole > 0.0) {
                (true, _) => *now,
                (_, true) => *whole,
                _ => 1.0,
            })
            .collect();
        let shift = (1.0 + damping * h) / (h * h);
        let entries = live.stiffness(model).entries();
        let factor = Factor::new(entries, numbering, Some((shift, &mass)))?;
        let room = factor.room(1);
        self.factor = Some((factor, room));
        self.key.substep = h;
        self.key.damping = damping;
        self.key.removed.clear();
        self.key.removed.extend_from_slice(removed);
        self.key.splits.clear();
        self.key.splits.extend_from_slice(splits);
        self.held.clear();
        self.place.clear();
        self.known.clear();
        self.columns.clear();
        self.border.truncate(0);
        Ok(())
    }

    /// Borders the factor by what tools hold.
    fn take_hold(&mut self, model: &Model, state: &State) {
        let Some((factor, room)) = &mut self.factor else {
            return;
        };
        let dofs = || {
            // Loose tissue is turned: what is held of it is left to the iterations.
            let fits = |h: &&Held| h.tool.is_some() && !state.live.pieces.is_loose(h.node as usize);
            let held = state.held.iter().filter(fits);
            held.flat_map(|h| {
                let axes = (0..3).filter(|a| h.axes[*a]);
                axes.map(move |a| 3 * h.node + a as u32)
            })
        };
        if self.known.len() > (ROOM - 48).max(2 * dofs().count()) {
            // Full of what was held long ago.
            self.known.clear();
            self.columns.clear();
            self.held.clear();
        }
        let same = dofs().zip(&self.held).take_while(|(a, b)| a == *b).count();
        let size = self.dof.len();
        self.held.truncate(same);
        self.place.truncate(same);
        self.border.truncate(same);
        let part = model.precomputed.as_ref();
        let inside = |dof: u32| (dof as usize).checked_sub(3 * model.parts.moving);
        for dof in dofs().skip(same) {
            let row = self.held.len();
            let place = match self.known.iter().position(|d| *d == dof) {
                Some(place) => place,
                None => {
                    let place = self.known.len();
                    self.columns.resize((place + 1) * size, 0.0);
                    let column = &mut self.columns[place * size..];
                    constraint(model, part, &self.unknown, dof, |k, c| column[k] = c);
                    factor.solve_with(room, column);
                    self.known.push(dof);
                    place
                }
            };
            self.held.push(dof);
            self.place.push(place as u32);
            let (held, places) = (&self.held, &self.place);
            let (columns, unknown) = (&self.columns, &self.unknown);
            self.border.push(row, |k| {
                let mut sum = 0.0;
                let from = places[k] as usize * size;
                let column = &columns[from..from + size];
                constraint(model, part, unknown, dof, |k, c| sum += c * column[k]);
                if let (Some(part), Some(own), Some(other)) = (part, inside(dof), inside(held[k])) {
                    sum += part.compliance(own)[other];
                }
                sum
            });
        }
    }

    /// z from r: the bordered factor on what is free now.
    fn precondition(&mut self, model: &Model, state: &State, loose: &loose::Scratch) {
        self.correction.copy_from_slice(&self.residual);
        self.turn(state, loose, false);
        let Some((factor, room)) = &mut self.factor else {
            return;
        };
        factor.solve_with(room, &mut self.correction);
        let part = model.precomputed.as_ref();
        self.push.clear();
        for dof in &self.held {
            let mut sum = 0.0;
            let z = &self.correction;
            constraint(model, part, &self.unknown, *dof, |k, c| sum += c * z[k]);
            self.push.push(-sum);
        }
        self.border.solve(&mut self.push);
        let size = self.dof.len();
        for (push, place) in self.push.iter().zip(&self.place) {
            let from = *place as usize * size;
            add_scaled(
                &mut self.correction,
                *push,
                &self.columns[from..from + size],
            );
        }
        self.turn(state, loose, true);
        for (z, dof) in self.correction.iter_mut().zip(&self.dof) {
            if !moves(state, *dof) {
                *z = 0.0;
            }
        }
    }
}

impl Scratch {
    /// Turns loose nodes' parts of the correction into their frames, or back.
    fn turn(&mut self, state: &State, loose: &loose::Scratch, back: bool) {
        let nodes = state.live.pieces.loose_nodes();
        let dofs = || nodes.iter().flat_map(|i| [3 * i, 3 * i + 1, 3 * i + 2]);
        for dof in dofs() {
            let unknown = self.unknown[dof as usize];
            self.swept[dof as usize / 3].0[dof as usize % 3] = match unknown {
                NONE => 0.0,
                k => self.correction[k as usize],
            };
        }
        loose.turn(state, back, &mut self.swept);
        for dof in dofs() {
            let unknown = self.unknown[dof as usize];
            if unknown != NONE {
                let turned = self.swept[dof as usize / 3].0[dof as usize % 3];
                self.correction[unknown as usize] = turned;
            }
        }
    }
}

/// Entries of a held degree of freedom's row of C, by unknown.
fn constraint(
    model: &Model,
    part: Option<&Precomputed>,
    unknown: &[u32],
    dof: u32,
    mut each: impl FnMut(usize, f64),
) {
    let moving = 3 * model.parts.moving;
    match (dof as usize).checked_sub(moving) {
        None => each(unknown[dof as usize] as usize, 1.0),
        Some(inside) => {
            let from = 3 * model.parts.connected_from();
            let row = part.map_or(&[][..], |part| part.influence(inside));
            for (unknown, c) in unknown[from..].iter().zip(row) {
                if *unknown != NONE {
                    each(*unknown as usize, *c);
                }
            }
        }
    }
}

fn moves(state: &State, dof: u32) -> bool {
    state.inverse_mass[dof as usize / 3].0[dof as usize % 3] > 0.0
}

pub(super) fn substep(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    h: f64,
    tick: bool,
) -> Result<(), StepError> {
    let time = state.clock.next();
    update_loads(model, state, &mut work.before, &mut work.impulse, time);
    take_velocity(model, state, &mut work.impulse);
    if state.factored.spent >= RENEWAL {
        state.refactor();
    }
    work.implicit
        .factorise(model, state, h)
        .map_err(StepError::Factor)?;
    work.implicit.take_hold(model, state);

    let before = state.account;
    let sums = evaluate(model, state, work, 0.0);
    watch(model, state, &before, &sums, 0.5 * sums.kinetic, 0.0, tick)?;
    work.implicit.start.copy_from_slice(&work.residual);
    work.implicit.pressure.clone_from(&state.coupling.pressure);

    // With velocities as they are, loose pieces but for their motion as a whole.
    work.loose.take_off(model, state, h);
    let damping = state.parameters.damping;
    for i in 0..model.parts.moving {
        for axis in 0..3 {
            state.displacement[i].0[axis] += h * state.velocity[i].0[axis];
        }
    }
    for held in &state.held {
        let i = held.node as usize;
        if work.loose.flies(state, i) {
            continue;
        }
        for axis in (0..3).filter(|a| held.axes[*a]) {
            state.displacement[i].0[axis] = held.target[axis];
        }
    }
    // A loose piece's is no matrix: damped as much, from the start.
    work.loose.brake = 1.0 / (1.0 + damping * h);
    evaluate(model, state, work, damping);
    work.loose.brake = 1.0;
    work.loose.add_inertia(state, &mut work.residual);
    work.iterations = solve(model, state, work, h);
    if state.factored.removed < state.live.removed.len() {
        state.factored.spent += work.iterations.saturating_sub(1);
    }
    let mut twice_lost = 0.0;
    for (dof, x) in work.implicit.dof.iter().zip(&work.implicit.solution) {
        let (i, axis) = (*dof as usize / 3, *dof as usize % 3);
        state.velocity[i].0[axis] += x;
        state.displacement[i].0[axis] += h * x;
        twice_lost += state.live.mass[i] * x * x;
    }
    for (i, _) in work.loose.flying(state) {
        // What they lose is found from their energy.
        work.implicit.start[i] = Lane::default();
        for axis in 0..3 {
            let unknown = work.implicit.unknown[3 * i + axis];
            if unknown != NONE {
                let x = work.implicit.solution[unknown as usize];
                twice_lost -= state.live.mass[i] * x * x;
            }
        }
    }

    work.loose.land(state, h);
    evaluate(model, state, work, state.parameters.damping);
    let (lost, braked) = work.loose.lost(model, state, &work.residual, h);
    work.damped -= braked;
    state.account.dissipated += lost;
    book(model, state, work, h);
    // |u_+ - u|_K² from the forces at both ends.
    let mut power = -work.damped;
    for (i, _) in work.loose.flying(state) {
        work.residual[i] = Lane::default();
    }
    for i in 0..model.parts.moving {
        let change = work.implicit.start[i].xyz() - work.residual[i].xyz();
        power += state.velocity[i].xyz().dot(&change);
    }
    for (held, axis, k) in inside_held(model, state) {
        let change = state.coupling.pressure[k] - work.implicit.pressure[k];
        power += held.velocity[axis] * change;
    }
    state.account.dissipated += 0.5 * (twice_lost + h * power);
    Ok(())
}

/// What is held inside the pre-computed part: axis by axis, in the order of its pressures.
fn inside_held<'a>(
    model: &'a Model,
    state: &'a State,
) -> impl Iterator<Item = (&'a crate::contact::hold::Held, usize, usize)> {
    let moving = model.parts.moving;
    let inside = (state.held.iter()).filter(move |h| h.node as usize >= moving);
    inside
        .flat_map(|h| (0..3).filter(|a| h.axes[*a]).map(move |a| (h, a)))
        .enumerate()
        .map(|(k, (held, axis))| (held, axis, k))
}

/// Conjugate gradients for A x = r/h, r being `work.residual`; zero where not free. Returns the number of
/// iterations.
fn solve(model: &Model, state: &mut State, work: &mut Workspace, h: f64) -> u64 {
    let Workspace {
        implicit: s,
        residual: force,
        partial,
        loose,
        ..
    } = work;
    for (r, dof) in s.residual.iter_mut().zip(&s.dof) {
        let (i, axis) = (*dof as usize / 3, *dof as usize % 3);
        *r = if moves(state, *dof) {
            force[i].0[axis] / h
        } else {
            0.0
        };
    }
    s.solution.fill(0.0);
    s.direction.fill(0.0);
    let goal = TOLERANCE * TOLERANCE * dot(&s.residual, &s.residual);
    let shift = (1.0 + state.parameters.damping * h) / (h * h);
    let undamped = 1.0 / (h * h);
    let moving = model.parts.moving;
    let mut before = 0.0;
    for iteration in 0..MOST_ITERATIONS {
        if dot(&s.residual, &s.residual) <= goal {
            return iteration;
        }
        s.precondition(model, state, loose);
        let now = dot(&s.residual, &s.correction);
        let share = if iteration == 0 { 0.0 } else { now / before };
        before = now;
        for (p, z) in s.direction.iter_mut().zip(&s.correction) {
            *p = z + share * *p;
        }
        // A p by a sweep that moves nothing.
        for node in state.live.pieces.loose_nodes() {
            s.swept[*node as usize] = Lane::default();
        }
        for (p, dof) in s.direction.iter().zip(&s.dof) {
            s.swept[*dof as usize / 3].0[*dof as usize % 3] = *p;
        }
        loose.turn(state, false, &mut s.swept);
        state.coupling.respond(model, &s.swept);
        inject(model, &state.coupling, partial);
        let motion = &mut Motion {
            displacement: &mut s.swept,
            velocity: &mut s.still,
            residual: force,
            partial,
            external: &s.unloaded,
            inverse_mass: &state.inverse_mass[..moving],
            mass: &state.live.mass[..moving],
            listed: None,
        };
        let still = Advance::symplectic_euler(0.0, 0.0, 0.0);
        sweep(
            state.live.pattern(model),
            &state.live.tensors,
            motion,
            &still,
        );
        loose.turn(state, true, force);
        for k in 0..s.dof.len() {
            let (i, axis) = (s.dof[k] as usize / 3, s.dof[k] as usize % 3);
            s.product[k] = if moves(state, s.dof[k]) {
                let shift = match state.live.pieces.is_loose(i) {
                    false => shift,
                    true => undamped,
                };
                shift * state.live.mass[i] * s.direction[k] - force[i].0[axis]
            } else {
                0.0
            };
        }
        let along = now / dot(&s.direction, &s.product);
        add_scaled(&mut s.solution, along, &s.direction);
        add_scaled(&mut s.residual, -along, &s.product);
    }
    MOST_ITERATIONS
}
