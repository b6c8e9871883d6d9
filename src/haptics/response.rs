//! The tangent of linear tissue that is stuck to its tools.
//!
//! Its motion is linear in the poses, so that of the change is the motion of tissue at rest that nothing else drives:
//! one trial of the step from rest, the tool going one metre, gives a column, exactly. It depends on what is held, on
//! the mesh and on the substeps alone, not on displacements, so it is kept until one of those changes: a grasper pays
//! once for all the time that it holds.
//!
//! Forces f_v on each vertex v held are kept; the torque of a tool is sum r_v x f_v, r_v from its position at the end of
//! the step.

use super::tangent::{Column, felt, length};
use crate::contact::hold::{self, Held};
use crate::integrate;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::tensor_mass::Lane;
use crate::pose::Path;
use crate::scene::Friction;
use crate::state::{Clock, Factored, State};
use crate::step::{StepError, Workspace, foreseen, halved};

/// Vertices held that there is room for without allocating.
const ROOM: usize = 384;
/// \[s\]: when every ramp is over.
const LATE: f64 = 1e300;

/// What it depends on, beside what is held.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Key {
    substeps: u64,
    substep: f64,
    lag: f64,
    damping: f64,
    revision: u64,
    factored: Factored,
}

#[derive(Debug, Default)]
pub(super) struct Response {
    key: Option<Key>,
    /// Node and tool.
    held: Vec<(u32, u32)>,
    /// Whether a tool's way along an axis has been tried.
    known: Vec<bool>,
    /// By that tool and axis: the force of the tissue on each vertex held \[N/m\].
    force: Vec<Vec3>,
}

impl Response {
    pub fn forget(&mut self) {
        self.key = None;
    }

    /// False where the tissue is not of that kind.
    #[allow(clippy::too_many_arguments)]
    pub fn columns(
        &mut self,
        model: &Model,
        state: &State,
        spare: &mut State,
        work: &mut Workspace,
        by: usize,
        axis: usize,
        columns: &mut [Column],
    ) -> Result<bool, StepError> {
        if !is_linear(model, state) {
            return Ok(false);
        }
        let length = length(model, state);
        let (n, h) = halved(state, length, foreseen(model, state, length)?);
        self.keep(model, state, n, h);
        let (way, count) = (3 * by + axis, self.held.len());
        let range = way * count..(way + 1) * count;
        if !self.known[way] {
            try_way(model, state, spare, work, (n, h), by, axis)?;
            let forces =
                tool_held(spare).map(|(held, _)| hold::reaction(model, spare, &work.loose, held));
            for (to, force) in self.force[range.clone()].iter_mut().zip(forces) {
                *to = force;
            }
            self.known[way] = true;
        }
        for (k, (column, tool)) in columns.iter_mut().zip(&state.tools).enumerate() {
            let path = Path::new(&tool.pose, &tool.input, &tool.lines, n, h);
            let end = path.ok_or(StepError::Orientation(k + 1))?.at(n);
            let (mut force, mut torque) = (Vec3::zeros(), Vec3::zeros());
            let own = tool_held(state).zip(&self.force[range.clone()]);
            for ((held, _), f) in own.filter(|((_, tool), _)| *tool as usize == k) {
                force += f;
                torque += (end.orientation * held.local).cross(f);
            }
            *column = felt(&force, &torque);
        }
        Ok(true)
    }

    /// Drops what is of other tissue, contact or substeps.
    fn keep(&mut self, model: &Model, state: &State, substeps: u64, substep: f64) {
        let key = Key {
            substeps,
            substep,
            lag: lag(model, state, substep),
            damping: state.parameters.damping,
            revision: state.live.revision,
            factored: state.factored,
        };
        let now = || tool_held(state).map(|(held, tool)| (held.node, tool));
        if self.key == Some(key) && now().eq(self.held.iter().copied()) {
            return;
        }
        self.key = Some(key);
        let ways = 3 * state.tools.len();
        self.held.clear();
        self.held.reserve(ROOM);
        self.held.extend(now());
        self.known.clear();
        self.known.resize(ways, false);
        self.force.clear();
        self.force.reserve(ways * ROOM);
        self.force.resize(ways * self.held.len(), Vec3::zeros());
    }
}

fn tool_held(state: &State) -> impl Iterator<Item = (&Held, u32)> {
    state.held.iter().filter_map(|h| Some((h, h.tool?)))
}

/// As the next step begins.
fn lag(model: &Model, state: &State, substep: f64) -> f64 {
    match state.clock.total {
        0 => model.lag(substep),
        _ => state.clock.lag,
    }
}

/// Hooke's law, no turning frames, and vertices that follow their tools on all axes wherever they pull.
fn is_linear(model: &Model, state: &State) -> bool {
    let sticks = |(held, _): (&Held, u32)| {
        held.axes == [true; 3] && !state.live.pieces.is_loose(held.node as usize)
    };
    !model.is_nonlinear()
        && !state.live.is_objective()
        && (model.scene.tools.iter())
            .all(|tool| tool.friction == Friction::Stick && tool.slip_force.is_none())
        && tool_held(state).all(sticks)
}

/// `spare` becomes what tissue at rest comes to when tool `by` goes 1 m along `axis` in the n substeps of h \[s\].
fn try_way(
    model: &Model,
    state: &State,
    spare: &mut State,
    work: &mut Workspace,
    (n, h): (u64, f64),
    by: usize,
    axis: usize,
) -> Result<(), StepError> {
    spare.copy_from(model, state);
    spare.displacement.fill(Lane::default());
    spare.velocity.fill(Lane::default());
    spare.external.fill(Lane::default());
    spare.account = Default::default();
    spare.clock = Clock {
        anchor: LATE,
        ticks: 0,
        substep: h,
        lag: lag(model, state, h),
        total: 1,
    };
    spare.coupling.still();
    spare.coupling.solve(model, &spare.displacement);
    work.impulse.fill(Vec3::zeros());
    for k in 0..n {
        for held in &mut spare.held {
            let mut target = Vec3::zeros();
            if held.tool == Some(by as u32) {
                target[axis] = (k + 1) as f64 / n as f64;
            }
            held.velocity = (target - spare.displacement[held.node as usize].xyz()) / h;
            held.target = target;
        }
        integrate::substep(model, spare, work, h, false)?;
        spare.clock.lag = model.lag(h);
        spare.clock.ticks += 1;
        spare.clock.total += 1;
    }
    Ok(())
}
