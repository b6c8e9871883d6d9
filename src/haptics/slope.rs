//! How fast the force on a tool changes, for a device that extrapolates between communication points:
//! F(t + s) = F(t) + F'(t) s.
//!
//! F'(t) = (F(t) - F(t - T)) / T, T the longest whole number of substeps, one at least, in the last step and in one
//! haptic period. F is that at the end of a substep, so nothing is known late. Where what the tool holds has changed
//! in that time the force has jumped, and a jump is not to be extrapolated: F'(t) is 0 then. The torque's is alike.

use crate::mesh::Vec3;
use crate::model::{Fnv, Model};
use crate::state::State;

/// A tool each, as it was at t - T.
#[derive(Debug)]
pub struct Slopes(Vec<Before>);

#[derive(Clone, Copy, Debug)]
struct Before {
    force: Vec3,
    torque: Vec3,
    /// What it held.
    contact: u64,
}

/// Substeps in T, of `n` substeps of `h` \[s\] with haptic ticks every `period` \[s\].
pub(crate) fn span(n: u64, h: f64, period: f64) -> u64 {
    // What is more than n is n; a number too large for an integer becomes the largest.
    ((period / h) as u64).clamp(1, n)
}

impl Slopes {
    pub fn new(model: &Model) -> Slopes {
        Slopes(Vec::with_capacity(model.scene.tools.len()))
    }

    /// At t - T, forces being those of then.
    pub(crate) fn begin(&mut self, state: &State) {
        self.0.clear();
        self.0
            .extend((state.tools.iter().enumerate()).map(|(k, tool)| Before {
                force: tool.force,
                torque: tool.torque,
                contact: contact(state, k),
            }));
    }

    /// At t, `seconds` later.
    pub(crate) fn end(&self, state: &mut State, seconds: f64) {
        for (k, before) in self.0.iter().enumerate() {
            let share = match contact(state, k) == before.contact {
                true => 1.0 / seconds,
                false => 0.0,
            };
            let tool = &mut state.tools[k];
            tool.force_rate = (tool.force - before.force) * share;
            tool.torque_rate = (tool.torque - before.torque) * share;
        }
    }
}

/// Tells what a tool holds apart.
fn contact(state: &State, k: usize) -> u64 {
    let mut sum = Fnv::default();
    for held in state.held.iter().filter(|h| h.tool == Some(k as u32)) {
        sum.write(&held.node.to_le_bytes());
    }
    sum.0
}
