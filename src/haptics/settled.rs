//! Static stiffness: how the force on a tool answers to a change of its position after everything has settled.
//!
//! With the tangent stiffness K of all the tissue as it is now (what is pre-computed is linear), h the vertices that
//! the tool holds, R their translation with it, f all that is free, and the rest (supports, vertices of other tools)
//! staying where it is,
//!
//! K_s = R^T (K_hh - K_hf K_ff^-1 K_fh) R = - d force / d position \[N/m\].
//!
//! It is the stiffness of the spring that the tool feels: symmetric, and positive semi-definite where the tissue is
//! stable. A piece that nothing but the tool holds follows it and adds nothing. What may turn about the vertices held
//! leaves K_ff singular, but forces that do no work on that motion: then K_ff + s I is factored, and refined until K_ff
//! is solved for.

use nalgebra::Matrix3;

use super::{Haptics, HapticsError};
use crate::loose;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::newton;
use crate::scene::Adaptive;
use crate::state::State;
use crate::statics::{Factor, Numbering, StaticsError};

/// s, as a part of the largest stiffness of a vertex.
const SHIFT: f64 = 1e-6;
/// Residual relative to the largest force at which refinement ends, and that which will do.
const GOAL: f64 = 1e-14;
const ENOUGH: f64 = 1e-9;
const MOST_REFINEMENTS: usize = 60;
/// A unit translation that moves anything further \[1\] has met a singular matrix.
const FARTHEST: f64 = 1e4;

type Entries = [(usize, usize, Matrix3<f64>)];

/// A tool each, as found last.
#[derive(Debug, Default)]
pub(super) struct Settled {
    known: Vec<Option<Matrix3<f64>>>,
    /// Those of linear tissue depend on this alone: cuts, and what tools hold on which axes.
    revision: u64,
    held: Vec<(u32, u32, [bool; 3])>,
    linear: Vec<Option<Matrix3<f64>>>,
}

impl Settled {
    pub fn forget(&mut self) {
        self.known.clear();
    }

    pub fn forget_all(&mut self) {
        self.forget();
        self.linear.clear();
    }
}

impl Haptics {
    /// K_s of tool k; zero where it holds nothing.
    pub(crate) fn static_stiffness(
        &mut self,
        model: &Model,
        state: &State,
        scratch: &mut loose::Scratch,
        k: usize,
    ) -> Result<Matrix3<f64>, HapticsError> {
        if !state.held.iter().any(|h| h.tool == Some(k as u32)) {
            return Ok(Matrix3::zeros());
        }
        let settled = &mut self.settled;
        let is_linear = !model.is_nonlinear() && !state.live.is_objective();
        let found = match is_linear && state.live.pieces.loose_nodes().is_empty() {
            true => settled.linear(state),
            false => &mut settled.known,
        };
        found.resize(state.tools.len(), None);
        if let Some(known) = found[k] {
            return Ok(known);
        }
        let stiffness = evaluate(model, state, scratch, k)?;
        found[k] = Some(stiffness);
        Ok(stiffness)
    }
}

impl Settled {
    /// What is known of linear tissue, if it still is the same.
    fn linear(&mut self, state: &State) -> &mut Vec<Option<Matrix3<f64>>> {
        let held = || (state.held.iter()).filter_map(|h| Some((h.node, h.tool?, h.axes)));
        if self.revision != state.live.revision || !held().eq(self.held.iter().copied()) {
            self.linear.clear();
            self.revision = state.live.revision;
            self.held.clear();
            self.held.extend(held());
        }
        &mut self.linear
    }
}

fn evaluate(
    model: &Model,
    state: &State,
    scratch: &mut loose::Scratch,
    k: usize,
) -> Result<Matrix3<f64>, HapticsError> {
    if (state.live.blend.as_ref()).is_some_and(|blend| blend.rule == Adaptive::PerVertex) {
        return Err(HapticsError::Statics(StaticsError::NoEnergy));
    }
    let entries = tangent(model, state, scratch);
    let live = &state.live;
    let nodes = model.mesh.nodes.len();
    let own = || state.held.iter().filter(|h| h.tool == Some(k as u32));
    // What is of another piece does not feel the tool.
    let mut is_near = vec![false; nodes];
    own().for_each(|h| is_near[live.pieces.label[h.node as usize] as usize] = true);
    let mut free: Vec<[bool; 3]> = (0..nodes)
        .map(
            |i| match live.star_count[i] > 0 && is_near[live.pieces.label[i] as usize] {
                true => live.free(model, i),
                false => [false; 3],
            },
        )
        .collect();
    for held in state.held.iter().filter(|h| h.tool.is_some()) {
        for axis in (0..3).filter(|a| held.axes[*a]) {
            free[held.node as usize][axis] = false;
        }
    }
    let problem = Problem {
        entries: &entries,
        numbering: Numbering::new(free.into_iter()),
        nodes,
    };
    let mut follow = [0, 1, 2].map(|_| vec![Vec3::zeros(); nodes]);
    for held in own() {
        for axis in (0..3).filter(|a| held.axes[*a]) {
            follow[axis][held.node as usize][axis] = 1.0;
        }
    }
    let plain = Factor::within(
        entries.iter().copied(),
        &problem.numbering,
        &model.mesh.nodes,
    );
    let plain = plain.and_then(|factor| problem.settle(&factor, &follow));
    let [x, y, z] = match plain {
        Err(StaticsError::NotHeld) => problem.shifted().and_then(|f| problem.settle(&f, &follow)),
        found => found,
    }
    .map_err(|error| match error {
        StaticsError::NotHeld => HapticsError::Unstable,
        error => HapticsError::Statics(error),
    })?;
    let mut stiffness = Matrix3::zeros();
    for (column, moved) in [x, y, z].iter().enumerate() {
        let force = problem.product(moved);
        for held in own() {
            for axis in (0..3).filter(|a| held.axes[*a]) {
                stiffness[(axis, column)] += force[held.node as usize][axis];
            }
        }
    }
    Ok((stiffness + stiffness.transpose()) * 0.5)
}

/// K in parts; of loose pieces turned as they are.
fn tangent(
    model: &Model,
    state: &State,
    scratch: &mut loose::Scratch,
) -> Vec<(usize, usize, Matrix3<f64>)> {
    let mut u = vec![Vec3::zeros(); model.mesh.nodes.len()];
    for (to, u) in u.iter_mut().zip(&state.displacement) {
        *to = u.xyz();
    }
    let turns = !state.live.is_objective() && !state.live.pieces.loose_nodes().is_empty();
    let mut rotation = Vec::new();
    if turns {
        scratch.measure(model, state);
        rotation.resize(u.len(), None);
        for (nodes, turn) in scratch.turned(state) {
            for node in nodes {
                u[*node as usize] = scratch.local(*node);
                rotation[*node as usize] = Some(turn);
            }
        }
    }
    let mut entries = newton::tangent(model, &state.live, &u);
    if turns {
        for (i, _, block) in &mut entries {
            if let Some(turn) = rotation[*i] {
                *block = turn * *block * turn.transpose();
            }
        }
    }
    entries
}

struct Problem<'a> {
    entries: &'a Entries,
    numbering: Numbering,
    nodes: usize,
}

impl Problem<'_> {
    /// K u \[N\] a node.
    fn product(&self, u: &[Vec3]) -> Vec<Vec3> {
        let mut force = vec![Vec3::zeros(); self.nodes];
        for (i, j, block) in self.entries {
            force[*i] += block * u[*j];
            if i != j {
                force[*j] += block.tr_mul(&u[*i]);
            }
        }
        force
    }

    fn shifted(&self) -> Result<Factor, StaticsError> {
        let diagonal = self.entries.iter().filter(|(i, j, _)| i == j);
        let largest = diagonal
            .map(|(_, _, block)| block.amax())
            .fold(0.0, f64::max);
        let ones = vec![1.0; self.nodes];
        let shift = Some((SHIFT * largest, &ones[..]));
        Factor::new(self.entries.iter().copied(), &self.numbering, shift)
    }

    /// Where everything is when some nodes have been moved and the free ones have settled; refined on K itself, not on
    /// what `factor` is of.
    fn settle(
        &self,
        factor: &Factor,
        moved: &[Vec<Vec3>; 3],
    ) -> Result<[Vec<Vec3>; 3], StaticsError> {
        let mut settled = moved.clone();
        let mut right = vec![0.0; self.numbering.unknowns()];
        let mut change = vec![Vec3::zeros(); self.nodes];
        for (u, moved) in settled.iter_mut().zip(moved) {
            let scale = (self.product(moved).iter())
                .map(|f| f.amax())
                .fold(0.0, f64::max);
            let mut before = f64::INFINITY;
            for _ in 0..MOST_REFINEMENTS {
                let force = self.product(u);
                self.numbering.gather(&force, &mut right);
                let left = right.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
                if left <= GOAL * scale || left >= 0.9 * before && left <= ENOUGH * scale {
                    before = left;
                    break;
                }
                before = left;
                factor.solve(&mut right);
                change.fill(Vec3::zeros());
                self.numbering.scatter(&right, &mut change);
                for (u, d) in u.iter_mut().zip(&change) {
                    *u -= d;
                }
            }
            let is_near = u.iter().all(|u| u.amax() < FARTHEST);
            if !(before <= ENOUGH * scale && is_near) {
                return Err(StaticsError::NotHeld);
            }
        }
        Ok(settled)
    }
}
