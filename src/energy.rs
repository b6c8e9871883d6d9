//! The energy account.
//!
//! Where velocities live at full steps kinetic = v^T M v / 2, and each scheme books what its substep does.
//! Symplectic Euler's and central difference's live at half steps, so the account that closes to round-off is
//!
//! kinetic_n = v_{n-1/2}^T M v_{n+1/2} / 2,  elastic_n = u_n^T K u_n / 2,
//!
//! work of tools and supports by the trapezoid, h/2 (v_{n-1/2} + v_{n+1/2}) . lambda_n a point, with
//! lambda_n = M (v_{n+1/2} - v_{n-1/2})/h - r_n the force that holds a node on its path.
//! With central difference damping is booked by the trapezoid, too. At the end of a
//! step v_{n+1/2} is not known yet for held nodes; any lambda_n gives the same balance there, and the
//! one without inertia, -r_n, is used.
//!
//! Springs are no linear law: elastic_n is their energy sum k (l - l_0)²/2, of which the force at both ends
//! of a substep takes the trapezoid. What that misses, of the order h², is booked nowhere: it shows in
//! the balance, and the watchdog judges it.

use crate::couple::Coupling;
use crate::loose;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::sweep::{Advance, Motion};
use crate::model::tensor_mass::Lane;
use crate::scene::Scheme;
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
    /// Net gain of energy by substeps of changing length, or by Runge-Kutta 4, booked in `dissipated` with the sign turned.
    pub made: f64,
    /// The balance at the start.
    pub start: f64,
    /// Largest elastic and kinetic energy at a haptic tick.
    pub most: f64,
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

/// Room for an evaluation.
#[derive(Debug)]
pub struct Scratch {
    displacement: Vec<Lane>,
    velocity: Vec<Lane>,
    residual: Vec<Lane>,
    partial: Vec<Lane>,
    points: Vec<f64>,
    loose: loose::Scratch,
}

impl Scratch {
    pub fn new(model: &Model) -> Scratch {
        let zeros = vec![Lane::default(); model.parts.moving];
        Scratch {
            displacement: zeros.clone(),
            velocity: zeros.clone(),
            residual: zeros.clone(),
            partial: zeros,
            points: vec![0.0; model.whole.points()],
            loose: loose::Scratch::new(model),
        }
    }
}

/// Puts the force of the pre-computed part into the partial internal forces that a sweep starts from.
pub fn inject(model: &Model, coupling: &Coupling, partial: &mut [Lane]) {
    let from = model.parts.connected_from();
    for (partial, force) in partial[from..].iter_mut().zip(coupling.force.chunks(3)) {
        *partial = Lane([-force[0], -force[1], -force[2], 0.0]);
    }
}

/// Evaluates the account: a sweep of length zero over a copy gives K u and the sums.
pub fn evaluate(model: &Model, state: &State, scratch: &mut Scratch) -> Energy {
    let moving = model.parts.moving;
    scratch
        .displacement
        .copy_from_slice(&state.displacement[..moving]);
    scratch.velocity.copy_from_slice(&state.velocity[..moving]);
    let Scratch {
        loose,
        displacement,
        residual,
        ..
    } = scratch;
    loose.measure(model, state);
    let nodes = state.live.pieces.loose_nodes();
    let framed = !state.live.is_objective();
    if framed {
        // Their tensors are for another frame.
        nodes
            .iter()
            .for_each(|i| displacement[*i as usize] = Lane::default());
    }
    inject(model, &state.coupling, &mut scratch.partial);
    let mut sums = state.live.sweep(
        model,
        &mut Motion {
            displacement,
            velocity: &mut scratch.velocity,
            residual,
            partial: &mut scratch.partial,
            external: &state.external[..moving],
            inverse_mass: &state.inverse_mass[..moving],
            mass: &state.live.mass[..moving],
            listed: None,
        },
        &mut scratch.points,
        &Advance::symplectic_euler(0.0, 0.0, state.parameters.damping),
    );
    let mut lagging = sums.lagging;
    for i in nodes {
        let i = *i as usize;
        residual[i] = loose.residual(state, i).into();
        lagging -= state.live.mass[i] * state.velocity[i].xyz().norm_squared();
    }
    if framed {
        let (elastic, external) = loose.sums(state);
        sums.elastic += elastic;
        sums.external += external;
    }
    let half = 0.5 * state.clock.lag;
    // Power of the residual on free degrees of freedom, and gravity's moment.
    let (mut power, mut moment) = (0.0, Vec3::zeros());
    for i in 0..residual.len() {
        let (v, r) = (&state.velocity[i].0, &residual[i].0);
        for axis in 0..3 {
            if state.inverse_mass[i].0[axis] > 0.0 {
                power += v[axis] * r[axis];
            }
            moment[axis] += state.live.weight[i] * state.displacement[i].0[axis];
        }
    }
    let inside = state.coupling.energy(model);
    let gravity = if model.boundary.loads.is_empty() {
        -sums.external
    } else {
        -Vec3::from(state.parameters.gravity).dot(&moment)
    };
    if let Some(guyan) = &model.guyan {
        let excess = guyan.excess(model, state);
        sums.kinetic += excess;
        lagging += excess;
        power -= state.parameters.damping * excess;
    }
    let mut energy = Energy {
        elastic: 0.5 * (sums.elastic + state.coupling.virial()) + inside.elastic,
        kinetic: 0.5 * sums.kinetic + half * power,
        gravity: gravity + inside.gravity,
        load: -sums.external - gravity + inside.load,
        tool_work: state.account.tool_work,
        support_work: state.account.support_work,
        dissipated: state.account.dissipated,
    };
    // The trailing half of what damping takes at this point.
    energy.dissipated += loose.taken(state, half);
    if model.scheme() == Scheme::CentralDifference {
        energy.dissipated += half * state.parameters.damping * lagging;
    }
    for held in &state.held {
        let i = held.node as usize;
        let lambda = match i.checked_sub(moving) {
            Some(inside) => state.coupling.pressure_on(inside),
            None => -residual[i].xyz(),
        };
        let v = &state.velocity[i].0;
        let trailing: f64 = (0..3)
            .filter(|a| held.axes[*a])
            .map(|a| half * v[a] * lambda[a])
            .sum();
        match held.tool {
            Some(_) => energy.tool_work += trailing,
            None => energy.support_work += trailing,
        }
    }
    energy
}
