//! Mass of the pre-computed part condensed on the connection nodes (Guyan 1965): M_c + Phi^T M_s Phi.
//!
//! The sweep moves connection nodes by their lumped mass; here they are moved again, by the dense one.

use nalgebra::DMatrix;

use super::Model;
use super::dense::{Packed, add_scaled, dot};
use super::sweep::{Advance, Sums};
use super::tensor_mass::Lane;
use crate::state::State;

/// Dense mass of the connection nodes. What is cut beside them does not change it.
#[derive(Debug)]
pub struct GuyanMass {
    size: usize,
    /// \[kg\], 3 connection numbers square.
    mass: Vec<f64>,
    /// \[1/kg\] without the fixed degrees of freedom, zero there.
    inverse: Vec<f64>,
}

impl GuyanMass {
    pub fn new(model: &Model, mass: &[f64]) -> GuyanMass {
        let size = 3 * model.parts.connection;
        let from = model.parts.connected_from();
        let moves: Vec<usize> = (0..size)
            .filter(|dof| !model.boundary.fixed[from + dof / 3][dof % 3])
            .collect();
        let own = DMatrix::from_fn(moves.len(), moves.len(), |r, c| {
            mass[moves[r] * size + moves[c]]
        });
        let mut inverse = vec![0.0; size * size];
        // Positive definite: lumped masses plus a Gram matrix.
        if let Some(cholesky) = own.cholesky() {
            let small = cholesky.inverse();
            for (r, row) in moves.iter().enumerate() {
                for (c, column) in moves.iter().enumerate() {
                    inverse[row * size + column] = small[(r, c)];
                }
            }
        }
        GuyanMass {
            size,
            mass: mass.to_vec(),
            inverse,
        }
    }

    fn product(&self, matrix: &[f64], x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        for (row, x) in matrix.chunks(self.size.max(1)).zip(x) {
            add_scaled(y, *x, row);
        }
    }

    /// M^-1 f of the connection nodes, zero where `held`.
    pub fn acceleration(&self, force: &[f64], held: impl Fn(usize) -> bool) -> Vec<f64> {
        let mut a = vec![0.0; self.size];
        self.product(&self.inverse, force, &mut a);
        let held: Vec<usize> = (0..self.size)
            .filter(|k| held(*k) && self.inverse[k * self.size + k] > 0.0)
            .collect();
        let mut factor = Packed::default();
        for (row, dof) in held.iter().enumerate() {
            factor.push(row, |k| self.inverse[dof * self.size + held[k]]);
        }
        let mut push: Vec<f64> = held.iter().map(|dof| -a[*dof]).collect();
        factor.solve(&mut push);
        for (dof, push) in held.iter().zip(&push) {
            let row = &self.inverse[dof * self.size..(dof + 1) * self.size];
            add_scaled(&mut a, *push, row);
        }
        held.iter().for_each(|dof| a[*dof] = 0.0);
        a
    }

    /// v . M v less the same by lumped masses.
    pub fn excess(&self, model: &Model, state: &State) -> f64 {
        let from = model.parts.connected_from();
        let v: Vec<f64> = state.velocity[from..model.parts.moving]
            .iter()
            .flat_map(|v| [v.0[0], v.0[1], v.0[2]])
            .collect();
        let mut p = vec![0.0; self.size];
        self.product(&self.mass, &v, &mut p);
        (0..self.size)
            .map(|dof| v[dof] * (p[dof] - state.live.mass[from + dof / 3] * v[dof]))
            .sum()
    }
}

/// Room for one substep; empty without Guyan mass.
#[derive(Debug, Default)]
pub struct Scratch {
    displacement: Vec<Lane>,
    v: Vec<f64>,
    v_new: Vec<f64>,
    momentum: Vec<f64>,
    force: Vec<f64>,
    /// Held degrees of freedom, the factor of the inverse mass there, their force.
    held: Vec<u32>,
    factor: Packed,
    push: Vec<f64>,
}

impl Scratch {
    pub fn new(model: &Model) -> Scratch {
        let size = match &model.guyan {
            Some(guyan) => guyan.size,
            None => return Scratch::default(),
        };
        let zeros = || vec![0.0; size];
        let mut factor = Packed::default();
        factor.reserve(size);
        Scratch {
            displacement: vec![Lane::default(); size / 3],
            v: zeros(),
            v_new: zeros(),
            momentum: zeros(),
            force: zeros(),
            held: Vec::with_capacity(size),
            factor,
            push: Vec::with_capacity(size),
        }
    }

    /// Before the sweep.
    pub fn keep(&mut self, model: &Model, state: &State) {
        if model.guyan.is_none() {
            return;
        }
        let range = model.parts.connected_from()..model.parts.moving;
        self.displacement
            .copy_from_slice(&state.displacement[range.clone()]);
        for (kept, v) in self.v.chunks_mut(3).zip(&state.velocity[range]) {
            kept.copy_from_slice(&v.0[..3]);
        }
    }

    /// After the sweep: v_+ = v + gain (M^-1 (f - K u + lambda) - c v), lambda such that what is held
    /// has its given velocity. Leaves held nodes to be carried, with a residual from which their force
    /// comes out right.
    pub fn advance(
        &mut self,
        model: &Model,
        state: &mut State,
        residual: &mut [Lane],
        by: &Advance,
        sums: &mut Sums,
    ) {
        let Some(guyan) = &model.guyan else {
            return;
        };
        let (from, size) = (model.parts.connected_from(), guyan.size);
        for dof in 0..size {
            let node = from + dof / 3;
            let damping = by.damping * state.live.mass[node] * self.v[dof];
            self.force[dof] = residual[node].0[dof % 3] + damping;
        }
        guyan.product(&guyan.inverse, &self.force, &mut self.v_new);
        self.held.clear();
        self.push.clear();
        self.factor.truncate(0);
        for held in state
            .held
            .iter()
            .filter(|h| (from..model.parts.moving).contains(&(h.node as usize)))
        {
            for axis in (0..3).filter(|a| held.axes[*a]) {
                let dof = 3 * (held.node as usize - from) + axis;
                let wanted =
                    (held.velocity[axis] - self.v[dof]) / by.gain + by.damping * self.v[dof];
                self.push.push(wanted - self.v_new[dof]);
                let row = self.held.len();
                self.held.push(dof as u32);
                let listed = &self.held;
                self.factor
                    .push(row, |k| guyan.inverse[dof * size + listed[k] as usize]);
            }
        }
        self.factor.solve(&mut self.push);
        for (dof, push) in self.held.iter().zip(&self.push) {
            let row = &guyan.inverse[*dof as usize * size..(*dof as usize + 1) * size];
            add_scaled(&mut self.v_new, *push, row);
        }
        for dof in 0..size {
            let a = self.v_new[dof] - by.damping * self.v[dof];
            self.v_new[dof] = self.v[dof] + by.gain * a;
        }
        guyan.product(&guyan.mass, &self.v, &mut self.momentum);
        let (before, across) = (
            dot(&self.v, &self.momentum),
            dot(&self.v_new, &self.momentum),
        );
        guyan.product(&guyan.mass, &self.v_new, &mut self.momentum);
        let after = dot(&self.v_new, &self.momentum);
        sums.lagging += before;
        sums.kinetic += across;
        sums.damping += across + after;
        for dof in 0..size {
            let (node, axis) = (from + dof / 3, dof % 3);
            let mass = state.live.mass[node];
            let (v, swept) = (self.v[dof], state.velocity[node].0[axis]);
            sums.lagging -= mass * v * v;
            sums.kinetic -= mass * v * swept;
            sums.damping -= mass * swept * (v + swept);
            let v_new = self.v_new[dof];
            match self.held.iter().position(|d| *d as usize == dof) {
                // What carrying it will add.
                Some(k) => {
                    sums.kinetic -= mass * v * (v_new - v);
                    sums.damping -= mass * (v_new * (v + v_new) - 2.0 * v * v);
                    residual[node].0[axis] = mass * (v_new - v) / by.gain - self.push[k];
                }
                None => {
                    state.velocity[node].0[axis] = v_new;
                    state.displacement[node].0[axis] =
                        self.displacement[dof / 3].0[axis] + by.substep * v_new;
                }
            }
        }
    }
}
