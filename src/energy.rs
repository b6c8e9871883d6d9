//! The energy account.
//!
//! Velocities live at half steps, so the account that closes to round-off is
//!
//! kinetic_n = v_{n-1/2}^T M v_{n+1/2} / 2,  elastic_n = u_n^T K u_n / 2,
//!
//! work of tools and supports by the trapezoid, h/2 (v_{n-1/2} + v_{n+1/2}) . lambda_n a point, with
//! lambda_n = M (v_{n+1/2} - v_{n-1/2})/h - r_n the force that holds a node on its path. At the end of a
//! step v_{n+1/2} is not known yet for held nodes; any lambda_n gives the same balance there, and the
//! one without inertia, -r_n, is used.

use crate::mesh::Vec3;
use crate::model::Model;
use crate::state::State;

/// Running sums \[J\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Account {
    /// By tools on tissue, up to the trailing half of the current point.
    pub tool_work: f64,
    /// By prescribed nodes, load ramps and changes of gravity; likewise.
    pub support_work: f64,
    /// By damping, and what cuts and attaches lose.
    pub dissipated: f64,
    /// The balance at the start.
    pub start: f64,
    /// Haptic ticks in a row on which the residual was too large.
    pub strikes: u32,
}

/// Where the energy is, now \[J\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    pub elastic: f64,
    pub kinetic: f64,
    /// -sum m g . u, zero at rest position.
    pub gravity: f64,
    /// -sum f . u of the nodal loads.
    pub load: f64,
    pub tool_work: f64,
    pub support_work: f64,
    pub dissipated: f64,
}

impl Energy {
    /// Constant but for the error of the method.
    pub fn balance(&self) -> f64 {
        self.elastic + self.kinetic + self.gravity + self.load + self.dissipated
            - self.tool_work
            - self.support_work
    }
}

/// Evaluates the account; `internal` is scratch for K u.
pub fn evaluate(model: &Model, state: &State, internal: &mut [Vec3]) -> Energy {
    let tensors = &state.live.tensors;
    tensors.product(&model.pattern, &state.displacement, internal);
    let half = 0.5 * state.clock.substep;
    let gravity = Vec3::from(state.parameters.gravity);
    let mut energy = Energy {
        tool_work: state.account.tool_work,
        support_work: state.account.support_work,
        dissipated: state.account.dissipated,
        ..Energy::default()
    };
    for i in 0..internal.len() {
        let (u, v) = (state.displacement[i].xyz(), state.velocity[i].xyz());
        let external = state.external[i].xyz();
        let mass = state.live.mass[i];
        let r = external - internal[i] - v * (state.parameters.damping * mass);
        energy.elastic += 0.5 * u.dot(&internal[i]);
        energy.kinetic += 0.5 * mass * v.norm_squared();
        for axis in 0..3 {
            if state.inverse_mass[i].0[axis] > 0.0 {
                energy.kinetic += half * v[axis] * r[axis];
            }
        }
        let weight = gravity * state.live.weight[i];
        energy.gravity -= weight.dot(&u);
        energy.load -= (external - weight).dot(&u);
    }
    for held in &state.held {
        let i = held.node as usize;
        let v = state.velocity[i].xyz();
        let r = state.external[i].xyz()
            - internal[i]
            - v * (state.parameters.damping * state.live.mass[i]);
        let trailing: f64 = (0..3)
            .filter(|a| held.axes[*a])
            .map(|a| -half * v[a] * r[a])
            .sum();
        match held.tool {
            Some(_) => energy.tool_work += trailing,
            None => energy.support_work += trailing,
        }
    }
    energy
}
