//! The pre-computed part while a scene runs: what moves it, what it answers.
//!
//! Everything here follows from displacements, held nodes and amplitudes:
//!
//! G_tt lambda = u_t - sum_k a_k w_k,t - Phi_t u_c,
//! force on c = sum_k a_k g_k - S u_c + Phi_t^T lambda.
//!
//! S u_c is evaluated in every substep: a coupling force that is held for a while is negative damping.
//! Its potential is quadratic in (u_c, u_t, a), so the trapezoid closes the energy account to round-off.

use crate::contact::hold::Held;
use crate::contact::press::Pressed;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::dense::{Packed, add_scaled, dot};
use crate::model::precomputed::Precomputed;
use crate::model::tensor_mass::Lane;

/// Contact degrees of freedom there is room for without allocating.
const ROOM: usize = 384;
/// Nodes brought up to date at once.
const RUN: usize = 64;
/// How much farther than what moves it a point inside may move: 1 for a rigid motion.
const DRIFT: f64 = 2.0;

/// Where the energy of the pre-computed part is \[J\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stored {
    pub elastic: f64,
    /// Of gravity and of loads on the nodes inside: -f . u.
    pub gravity: f64,
    pub load: f64,
}

impl Stored {
    pub fn total(&self) -> f64 {
        self.elastic + self.gravity + self.load
    }
}

/// A coupling as it was before something changed at once.
#[derive(Clone, Debug, Default)]
pub struct Before {
    potential: f64,
    force: Vec<f64>,
    pressure: Vec<f64>,
    held: Vec<u32>,
}

impl Before {
    pub fn with_room(model: &Model) -> Before {
        Before {
            potential: 0.0,
            force: Vec::with_capacity(3 * model.parts.connection),
            pressure: Vec::with_capacity(ROOM),
            held: Vec::with_capacity(ROOM),
        }
    }

    /// Must come before the change; [`Before::gained`] after it.
    pub fn remember(&mut self, model: &Model, coupling: &Coupling) {
        self.potential = coupling.energy(model).total();
        self.force.clone_from(&coupling.force);
        self.pressure.clone_from(&coupling.pressure);
        self.held.clone_from(&coupling.held);
    }

    /// Energy that the event has put into the account \[J\]: change of the potential, and of the kinetic
    /// energy between half steps, lag/2 v_c . change of force.
    pub fn gained(&self, model: &Model, now: &Coupling, velocity: &[Lane], lag: f64) -> f64 {
        let from = model.parts.connected_from();
        let mut power = 0.0;
        for (dof, (now, before)) in now.force.iter().zip(&self.force).enumerate() {
            power += velocity[from + dof / 3].0[dof % 3] * (now - before);
        }
        now.energy(model).total() - self.potential + 0.5 * lag * power
    }

    /// Degrees of freedom held then.
    pub fn held(&self) -> &[u32] {
        &self.held
    }

    /// lambda then \[N\].
    pub fn pressure_at(&self, dof: u32) -> f64 {
        let at = self.held.iter().position(|d| *d == dof);
        at.map_or(0.0, |k| self.pressure[k])
    }
}

/// All but `drift` and `seen` follows from the rest of a state. Empty where nothing is pre-computed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coupling {
    /// a_k
    amplitude: Vec<f64>,
    /// Held degrees of freedom inside, 3 node + axis counted from the first such node, in order of
    /// attachment; and the Cholesky factor of G_tt.
    held: Vec<u32>,
    factor: Packed,
    /// G_tt lambda \[m\] and lambda \[N\], of tools on tissue.
    gap: Vec<f64>,
    pub pressure: Vec<f64>,
    /// u_c and S u_c, padded.
    moved: Vec<f64>,
    elastic: Vec<f64>,
    /// On connection nodes \[N\].
    pub force: Vec<f64>,
    /// Bound of how far any node inside can have moved since the start \[m\], and what it was when each
    /// touchable node was last brought up to date.
    pub drift: f64,
    pub seen: Vec<f64>,
    /// What slides on it, and f . G f of those forces \[N m\].
    pub pressed: Vec<Pressed>,
    pub yielded: f64,
    /// G_h f \[m\].
    given: Vec<f64>,
    /// Nothing drives the part, amplitudes being zero and staying so: a trial of [`crate::haptics`].
    is_still: bool,
}

impl Coupling {
    pub fn new(model: &Model) -> Coupling {
        let Some(part) = &model.precomputed else {
            return Coupling::default();
        };
        let padded = (3 * part.connection).next_multiple_of(4);
        let mut coupling = Coupling {
            amplitude: vec![0.0; part.drives.len()],
            moved: vec![0.0; padded],
            elastic: vec![0.0; padded],
            force: vec![0.0; 3 * part.connection],
            seen: vec![0.0; part.touchable],
            ..Coupling::default()
        };
        coupling.reserve();
        coupling
    }

    /// Room for contacts; a copy has none.
    pub fn reserve(&mut self) {
        if self.amplitude.is_empty() {
            return;
        }
        self.factor.reserve(ROOM);
        self.gap.reserve(ROOM);
        self.pressure.reserve(ROOM);
        self.held.reserve(ROOM);
        self.given.reserve(ROOM);
        self.pressed.reserve(ROOM / 3);
    }

    /// Keeps the room that there is.
    pub fn copy_from(&mut self, other: &Coupling) {
        self.amplitude.clone_from(&other.amplitude);
        self.held.clone_from(&other.held);
        self.factor.copy_from(&other.factor);
        self.gap.clone_from(&other.gap);
        self.pressure.clone_from(&other.pressure);
        self.moved.clone_from(&other.moved);
        self.elastic.clone_from(&other.elastic);
        self.force.clone_from(&other.force);
        self.drift = other.drift;
        self.seen.clone_from(&other.seen);
        self.is_still = other.is_still;
        self.pressed.clone_from(&other.pressed);
        self.yielded = other.yielded;
        self.given.clone_from(&other.given);
    }

    /// From here on nothing drives the part.
    pub(crate) fn still(&mut self) {
        self.amplitude.fill(0.0);
        self.is_still = true;
    }

    /// Whether any amplitude is another then.
    pub fn amplitudes_change(&self, model: &Model, gravity: &[f64; 3], time: f64) -> bool {
        let drives = model.precomputed.iter().flat_map(|part| &part.drives);
        !self.is_still
            && (drives.zip(&self.amplitude))
                .any(|(source, a)| source.amplitude(gravity, time) != *a)
    }

    /// Whether any amplitude has changed.
    pub fn set_amplitudes(&mut self, model: &Model, gravity: &[f64; 3], time: f64) -> bool {
        let Some(part) = model.precomputed.as_ref().filter(|_| !self.is_still) else {
            return false;
        };
        let mut changed = false;
        for (k, source) in part.drives.iter().enumerate() {
            let now = source.amplitude(gravity, time);
            let change = now - self.amplitude[k];
            changed |= change != 0.0;
            self.drift += change.abs() * part.farthest(k);
            self.amplitude[k] = now;
        }
        changed
    }

    /// Whether a tool holds a degree of freedom inside.
    pub fn holds(&self, dof: u32) -> bool {
        self.held.contains(&dof)
    }

    /// Takes over which nodes inside are held. Whether that has changed.
    pub fn set_held(&mut self, model: &Model, held: &[Held]) -> bool {
        let Some(part) = &model.precomputed else {
            return false;
        };
        let moving = model.parts.moving;
        let dofs = || {
            let inside = held.iter().filter(|h| h.node as usize >= moving);
            inside.flat_map(|h| {
                let first = 3 * (h.node - moving as u32);
                (0..3).filter(|a| h.axes[*a]).map(move |a| first + a as u32)
            })
        };
        let same = dofs().zip(&self.held).take_while(|(a, b)| a == *b).count();
        let count = dofs().count();
        if same == count && same == self.held.len() {
            return false;
        }
        self.held.truncate(same);
        self.factor.truncate(same);
        for dof in dofs().skip(same) {
            let column = part.compliance(dof as usize);
            let row = self.held.len();
            self.held.push(dof);
            let held = &self.held;
            self.factor.push(row, |k| column[held[k] as usize]);
        }
        self.gap.resize(count, 0.0);
        self.pressure.resize(count, 0.0);
        self.given.resize(count, 0.0);
        true
    }

    /// Held degrees of freedom.
    pub(crate) fn held_inside(&self) -> &[u32] {
        &self.held
    }

    /// Of what is held: G_hh^-1 x in place of x.
    pub(crate) fn yield_to(&self, x: &mut [f64]) {
        self.factor.solve(x);
    }

    /// Everything at the present displacements, nothing sliding on the part any more.
    pub(crate) fn leave(&mut self, model: &Model, displacement: &[Lane]) {
        self.pressed.clear();
        self.yielded = 0.0;
        self.answer(model, displacement, true);
    }

    /// After [`Coupling::leave`]: what slides on it now, f . C f being given \[N m\].
    pub(crate) fn press(
        &mut self,
        model: &Model,
        pressed: impl Iterator<Item = Pressed>,
        work: f64,
    ) {
        self.pressed.extend(pressed);
        let more = self.add_pressed(model);
        self.yielded = work + more;
    }

    /// Superposes the forces of what slides. Returns G_h f . G_hh^-1 G_h f \[N m\].
    fn add_pressed(&mut self, model: &Model) -> f64 {
        self.given.fill(0.0);
        let Some(part) = model
            .precomputed
            .as_ref()
            .filter(|_| !self.pressed.is_empty())
        else {
            return 0.0;
        };
        for pressed in &self.pressed {
            for (node, b) in pressed.nodes.iter().zip(pressed.weight) {
                for axis in (0..3).filter(|a| b * pressed.force[*a] != 0.0) {
                    let f = b * pressed.force[axis];
                    let Some(inside) = (*node as usize).checked_sub(model.parts.moving) else {
                        let k = *node as usize - model.parts.connected_from();
                        self.force[3 * k + axis] += f;
                        continue;
                    };
                    let dof = 3 * inside + axis;
                    add_scaled(&mut self.force, f, part.influence(dof));
                    let column = part.compliance(dof);
                    for (given, held) in self.given.iter_mut().zip(&self.held) {
                        *given += f * column[*held as usize];
                    }
                }
            }
        }
        if self.held.is_empty() {
            return 0.0;
        }
        let before = dot(&self.pressure, &self.given);
        self.add_held(part, -1.0);
        for ((pressure, gap), given) in (self.pressure.iter_mut().zip(&self.gap)).zip(&self.given) {
            *pressure = gap - given;
        }
        self.factor.solve(&mut self.pressure);
        self.add_held(part, 1.0);
        before - dot(&self.pressure, &self.given)
    }

    /// Phi_h^T lambda.
    fn add_held(&mut self, part: &Precomputed, sign: f64) {
        for (dof, pressure) in self.held.iter().zip(&self.pressure) {
            let influence = part.influence(*dof as usize);
            add_scaled(&mut self.force, sign * pressure, influence);
        }
    }

    /// Everything at the present displacements.
    pub fn solve(&mut self, model: &Model, displacement: &[Lane]) {
        self.answer(model, displacement, true);
        self.add_pressed(model);
    }

    /// Only the answer to displacements of the connection nodes, what is held inside staying where it is
    /// and nothing else pushing. [`Coupling::solve`] must come after it.
    pub fn respond(&mut self, model: &Model, displacement: &[Lane]) {
        self.answer(model, displacement, false);
    }

    fn answer(&mut self, model: &Model, displacement: &[Lane], driven: bool) {
        let Some(part) = &model.precomputed else {
            return;
        };
        let (from, moving) = (model.parts.connected_from(), model.parts.moving);
        let size = 3 * part.connection;
        for (packed, u) in self.moved.chunks_mut(3).zip(&displacement[from..moving]) {
            packed.copy_from_slice(&u.0[..3]);
        }
        part.interface.product(&self.moved, &mut self.elastic);
        for (force, elastic) in self.force.iter_mut().zip(&self.elastic) {
            *force = -elastic;
        }
        for (k, a) in self.amplitude.iter().enumerate() {
            if driven && *a != 0.0 {
                add_scaled(&mut self.force, *a, part.push(k));
            }
        }
        for row in 0..self.held.len() {
            let dof = self.held[row] as usize;
            let followed = dot(part.influence(dof), &self.moved[..size]);
            self.gap[row] = if driven {
                let target = displacement[moving + dof / 3].0[dof % 3];
                target - (self.driven(part, dof, true) + followed)
            } else {
                -followed
            };
        }
        self.pressure.copy_from_slice(&self.gap);
        self.factor.solve(&mut self.pressure);
        self.add_held(part, 1.0);
    }

    /// sum_k a_k w_k at a degree of freedom inside; only of forces where not `all`.
    fn driven(&self, part: &Precomputed, dof: usize, all: bool) -> f64 {
        let drives = self.amplitude.iter().zip(&part.drives).enumerate();
        drives
            .filter(|(_, (a, source))| **a != 0.0 && (all || source.is_force()))
            .map(|(k, (a, _))| a * part.field(k)[dof])
            .sum()
    }

    /// u_c . force on c
    pub fn virial(&self) -> f64 {
        dot(&self.moved[..self.force.len()], &self.force)
    }

    pub fn energy(&self, model: &Model) -> Stored {
        let Some(part) = &model.precomputed else {
            return Stored::default();
        };
        let size = 3 * part.connection;
        let moved = &self.moved[..size];
        let mut stored = Stored {
            elastic: 0.5 * dot(moved, &self.elastic[..size])
                + 0.5 * dot(&self.pressure, &self.gap)
                + 0.5 * (self.yielded + dot(&self.pressure, &self.given)),
            ..Stored::default()
        };
        for (k, a) in self.amplitude.iter().enumerate() {
            if *a == 0.0 {
                continue;
            }
            let pushed = dot(part.push(k), moved);
            let held = self.held.iter().zip(&self.pressure);
            let pressed: f64 = held
                .map(|(dof, p)| p * part.field(k)[*dof as usize])
                .sum::<f64>()
                + self.pressed_along(model, part.field(k));
            let (mut own, mut given) = (0.0, 0.0);
            for (l, b) in self.amplitude.iter().enumerate() {
                own += b * part.stored(k, l);
                given += b * part.potential(k, l);
            }
            stored.elastic += 0.5 * a * own;
            if !part.drives[k].is_force() {
                stored.elastic -= a * pushed;
                continue;
            }
            stored.elastic += a * pressed;
            let potential = -a * (pushed + given + pressed);
            match part.drives[k] {
                crate::model::precomputed::Source::Gravity(_) => stored.gravity += potential,
                _ => stored.load += potential,
            }
        }
        stored
    }

    /// f . w of what slides.
    fn pressed_along(&self, model: &Model, field: &[f64]) -> f64 {
        let along = |p: &Pressed| -> f64 {
            let each = p.nodes.iter().zip(p.weight).map(|(node, b)| {
                let inside = (*node as usize).checked_sub(model.parts.moving);
                inside.map_or(0.0, |k| {
                    b * dot(p.force.as_slice(), &field[3 * k..3 * k + 3])
                })
            });
            each.sum()
        };
        self.pressed.iter().map(along).sum()
    }

    /// lambda on a node inside, counted from the first such \[N\].
    pub fn pressure_on(&self, node: usize) -> Vec3 {
        self.of_node(node, &self.pressure)
    }

    /// G lambda on such a node \[m\].
    pub fn gap_on(&self, node: usize) -> Vec3 {
        self.of_node(node, &self.gap)
    }

    /// A node's part of what held degrees of freedom have.
    fn of_node(&self, node: usize, values: &[f64]) -> Vec3 {
        let mut sum = Vec3::zeros();
        for (dof, value) in self.held.iter().zip(values) {
            if *dof as usize / 3 == node {
                sum[*dof as usize % 3] = *value;
            }
        }
        sum
    }

    /// On a moving node \[N\]; zero off the interface.
    pub fn force_on(&self, model: &Model, node: usize) -> Vec3 {
        match node.checked_sub(model.parts.connected_from()) {
            Some(k) if 3 * k < self.force.len() => Vec3::new(
                self.force[3 * k],
                self.force[3 * k + 1],
                self.force[3 * k + 2],
            ),
            _ => Vec3::zeros(),
        }
    }

    /// Brings the known displacements of some nodes inside up to date; what is held is where it is held,
    /// to the bit.
    pub(crate) fn update(
        &self,
        model: &Model,
        displacement: &mut [Lane],
        held: &[Held],
        nodes: std::ops::Range<usize>,
    ) {
        let Some(part) = &model.precomputed else {
            return;
        };
        let mut room = [0.0; 3 * RUN];
        let moved = &self.moved[..3 * part.connection];
        let mut first = nodes.start;
        while first < nodes.end {
            let end = nodes.end.min(first + RUN);
            let dofs = 3 * first..3 * end;
            let now = &mut room[..dofs.len()];
            for (now, dof) in now.iter_mut().zip(dofs.clone()) {
                *now = dot(part.influence(dof), moved);
            }
            for (k, a) in self
                .amplitude
                .iter()
                .enumerate()
                .filter(|(_, a)| **a != 0.0)
            {
                add_scaled(now, *a, &part.field(k)[dofs.clone()]);
            }
            for (held, pressure) in self.held.iter().zip(&self.pressure) {
                let column = part.compliance(*held as usize);
                add_scaled(now, *pressure, &column[dofs.clone()]);
            }
            for pressed in &self.pressed {
                for (node, b) in pressed.nodes.iter().zip(pressed.weight) {
                    let Some(inside) = (*node as usize).checked_sub(model.parts.moving) else {
                        continue;
                    };
                    for axis in (0..3).filter(|a| b * pressed.force[*a] != 0.0) {
                        let column = part.compliance(3 * inside + axis);
                        add_scaled(now, b * pressed.force[axis], &column[dofs.clone()]);
                    }
                }
            }
            let from = model.parts.moving + first;
            let upto = model.parts.moving + end;
            for h in held
                .iter()
                .filter(|h| (from..upto).contains(&(h.node as usize)))
            {
                let at = h.node as usize;
                for axis in (0..3).filter(|a| h.axes[*a]) {
                    now[3 * (at - from) + axis] = displacement[at].0[axis];
                }
            }
            for (known, now) in displacement[from..upto].iter_mut().zip(now.chunks(3)) {
                *known = Lane([now[0], now[1], now[2], 0.0]);
            }
            first = end;
        }
    }

    /// All known displacements inside.
    pub fn update_all(&self, model: &Model, displacement: &mut [Lane], held: &[Held]) {
        let count = model.parts.known - model.parts.moving;
        self.update(model, displacement, held, 0..count);
    }

    /// All known velocities inside, from those of what moves the part; amplitudes as they grew in the `seconds` before
    /// `time`. (Everything here is linear.)
    pub fn update_velocities(
        &self,
        model: &Model,
        velocity: &mut [Lane],
        held: &[Held],
        gravity: &[f64; 3],
        time: f64,
        seconds: f64,
    ) {
        let mut rates = self.clone();
        // How the forces of what slides grow is not known.
        rates.pressed.clear();
        rates.yielded = 0.0;
        let drives = model.precomputed.iter().flat_map(|part| &part.drives);
        for (rate, source) in rates.amplitude.iter_mut().zip(drives) {
            let growth =
                source.amplitude(gravity, time) - source.amplitude(gravity, time - seconds);
            *rate = growth / seconds;
        }
        rates.solve(model, velocity);
        rates.update_all(model, velocity, held);
    }

    /// Those of touchable nodes that may be within `reach` of where `distance` is measured from \[m\]: by
    /// the position last known, and as far as tissue can have drifted since.
    pub fn update_near(
        &mut self,
        model: &Model,
        displacement: &mut [Lane],
        held: &[Held],
        reach: f64,
        distance: impl Fn(&Vec3) -> f64,
    ) {
        let moving = model.parts.moving;
        for node in 0..self.seen.len() {
            let at = model.mesh.nodes[moving + node] + displacement[moving + node].xyz();
            if distance(&at) <= reach + (self.drift - self.seen[node]) {
                self.update(model, displacement, held, node..node + 1);
                self.seen[node] = self.drift;
            }
        }
    }

    /// What moves the part has moved for `seconds` at these velocities.
    pub fn drifts(&mut self, model: &Model, velocity: &[Lane], held: &[Held], seconds: f64) {
        let moving = model.parts.moving;
        let interface = velocity[model.parts.connected_from()..moving].iter();
        let inside = held.iter().filter(|h| h.node as usize >= moving);
        let fastest = interface
            .chain(inside.map(|h| &velocity[h.node as usize]))
            .map(|v| v.xyz().norm_squared())
            .fold(0.0, f64::max)
            .sqrt();
        self.drift += DRIFT * seconds * fastest;
    }

    /// A node that was let go springs back.
    pub fn springs_back(
        &mut self,
        model: &Model,
        displacement: &mut [Lane],
        held: &[Held],
        node: usize,
    ) {
        let at = model.parts.moving + node;
        let before = displacement[at].xyz();
        self.update(model, displacement, held, node..node + 1);
        self.drift += DRIFT * (displacement[at].xyz() - before).norm();
    }
}
