//! Loose pieces: each moves in a frame of its own, so that it falls, turns and swings without swelling.
//!
//! The linear law knows no rotations. A piece that may turn freely is therefore measured in the frame that fits it
//! best: with masses m_i, rest positions X_i and positions x_i, both from their centres of mass,
//!
//! R = polar factor of sum m_i x_i X_i^T,  w_i = R^T x_i - X_i,  W = w . K w / 2.
//!
//! R follows from positions, so W is a potential that no rigid motion changes. Its gradient, with g_i = R (K w)_i,
//!
//! dW/dx_i = g_i - m_i a x R X_i,  a = H^-1 sum x_i x g_i,  H = sum m_i ((x_i . R X_i) I - R X_i x_i^T),
//!
//! has neither net force nor net torque: momenta are kept to round-off. (The moving frame of the manual's
//! section 11, with the torque taken out.) Springs need no frame.
//!
//! Mass-proportional damping would brake the fall of a loose piece, too; here it acts on what is left of the
//! velocity when the rigid motion of the same momenta is taken from it:
//!
//! drag_i = c m_i (v_i - v - omega x x_i),  sum m_i (x_i x v_i) = sum m_i x_i x (omega x x_i).

use nalgebra::{Matrix3, Rotation3};

use crate::live::LiveMesh;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::sweep::{Advance, Motion, Sums, advance_node};
use crate::model::tensor_mass::Lane;
use crate::state::State;

/// A node of a loose piece, as it is put aside during a sweep.
#[derive(Clone, Copy, Debug, Default)]
struct Aside {
    displacement: Lane,
    velocity: Lane,
    external: Lane,
    inverse_mass: Lane,
}

/// Scratch; what is in it holds for the state that was looked at last.
#[derive(Debug, Default)]
pub struct Scratch {
    frames: Vec<Frame>,
    /// A loose node each, in the order of [`crate::pieces::Pieces::loose_nodes`].
    aside: Vec<Aside>,
    /// dW/dx and the force of damping \[N\], both against the motion.
    force: Vec<Vec3>,
    drag: Vec<Vec3>,
    /// K w \[N\] as measured, a moving node each; of old where not loose.
    inner: Vec<Lane>,
    /// Energy of the loose pieces \[J\]; of tensors only.
    elastic: f64,
    /// Power that damping takes from them \[W\].
    pub braked: f64,
    /// w \[m\] a moving node; of old where not loose.
    local: Vec<Lane>,
    /// Labels of the loose pieces that a cut goes through.
    touched: Vec<u32>,
    /// Share of its damping that acts in a sweep; 1 but for implicit Euler's.
    pub(crate) brake: f64,
    /// A piece each, while implicit Euler solves for how it deforms.
    flights: Vec<Flight>,
}

/// How a piece moves as a whole in a substep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Flight {
    now: Vec3,
    velocity: Vec3,
    spin: Vec3,
    /// In the whole substep.
    turn: Rotation3<f64>,
    is_held: bool,
    /// Momenta at the end if nothing holds it, about where the centre is then.
    momentum: Vec3,
    turning: Vec3,
    /// Elastic and kinetic energy, and potential of outer forces, at the start \[J\].
    energy: f64,
}

impl Scratch {
    pub fn new(model: &Model) -> Scratch {
        if !model.can_be_cut() && model.whole.pieces.loose_nodes().is_empty() {
            return Scratch {
                brake: 1.0,
                ..Scratch::default()
            };
        }
        let moving = model.parts.moving;
        Scratch {
            frames: Vec::with_capacity(moving),
            aside: Vec::with_capacity(moving),
            force: Vec::with_capacity(moving),
            drag: Vec::with_capacity(moving),
            inner: vec![Lane::default(); moving],
            local: vec![Lane::default(); moving],
            touched: Vec::with_capacity(moving),
            flights: Vec::with_capacity(moving),
            brake: 1.0,
            ..Scratch::default()
        }
    }

    /// Puts loose nodes aside for a sweep, which then finds them at w in their frames, and still.
    pub(crate) fn set_aside(&mut self, state: &mut State) {
        self.frames.clear();
        self.aside.clear();
        let State {
            live,
            displacement,
            velocity,
            external,
            inverse_mass,
            ..
        } = state;
        let nodes = live.pieces.loose_nodes();
        for piece in live.pieces.loose() {
            let frame = Frame::of(live, &nodes[piece.clone()], |i| {
                (displacement[i].xyz(), velocity[i].xyz())
            });
            for node in &nodes[piece] {
                let i = *node as usize;
                let zero = Lane::default();
                let local = match live.is_objective() {
                    true => displacement[i],
                    false => frame.local(&live.rest[i], &displacement[i].xyz()).into(),
                };
                self.aside.push(Aside {
                    displacement: std::mem::replace(&mut displacement[i], local),
                    velocity: std::mem::replace(&mut velocity[i], zero),
                    external: std::mem::replace(&mut external[i], zero),
                    inverse_mass: std::mem::replace(&mut inverse_mass[i], zero),
                });
            }
            self.frames.push(frame);
        }
    }

    /// Puts them back and advances them: `residual` holds minus the internal forces in their frames, and
    /// gets what is left of all forces. Their sums but the elastic one.
    pub(crate) fn carry(
        &mut self,
        model: &Model,
        state: &mut State,
        residual: &mut [Lane],
        partial: &mut [Lane],
        by: &Advance,
    ) -> Sums {
        self.make_room(state);
        self.braked = 0.0;
        let nodes = state.live.pieces.loose_nodes().iter();
        for ((node, aside), force) in nodes.zip(&self.aside).zip(&mut self.force) {
            let i = *node as usize;
            state.displacement[i] = aside.displacement;
            state.velocity[i] = aside.velocity;
            state.external[i] = aside.external;
            state.inverse_mass[i] = aside.inverse_mass;
            *force = -residual[i].xyz();
        }
        for (at, piece) in state.live.pieces.loose().enumerate() {
            let frame = self.frames[at];
            self.turn_back(state, piece.clone(), &frame);
            self.drag(state, piece, &frame, self.brake * by.damping);
        }
        let moving = model.parts.moving;
        let mut motion = Motion {
            displacement: &mut state.displacement[..moving],
            velocity: &mut state.velocity[..moving],
            residual,
            partial,
            external: &state.external[..moving],
            inverse_mass: &state.inverse_mass[..moving],
            mass: &state.live.mass[..moving],
            listed: None,
        };
        let by = Advance {
            gain: by.kick,
            damping: 0.0,
            ..*by
        };
        let mut sums = Sums::default();
        let forces = self.force.iter().zip(&self.drag);
        for (node, (force, drag)) in state.live.pieces.loose_nodes().iter().zip(forces) {
            let internal = force + drag;
            advance_node(
                &mut motion,
                *node as usize,
                internal.as_slice(),
                &by,
                &mut sums,
            );
        }
        sums
    }

    /// Frames, forces and energy as they are, by rows: for what is asked between substeps.
    pub fn measure(&mut self, model: &Model, state: &State) {
        self.frames.clear();
        self.elastic = 0.0;
        self.braked = 0.0;
        self.make_room(state);
        for piece in state.live.pieces.loose() {
            let (frame, elastic) = self.measure_piece(model, state, piece.clone());
            self.drag(state, piece, &frame, state.parameters.damping);
            self.frames.push(frame);
            self.elastic += elastic;
        }
    }

    /// Where loose nodes are in their frames.
    pub fn locate(&mut self, state: &State) {
        for piece in state.live.pieces.loose() {
            self.locate_piece(state, piece);
        }
    }

    /// w of a loose node \[m\], as located.
    pub fn local(&self, node: u32) -> Vec3 {
        self.local[node as usize].xyz()
    }

    fn locate_piece(&mut self, state: &State, piece: std::ops::Range<usize>) -> Frame {
        let nodes = &state.live.pieces.loose_nodes()[piece];
        let frame = Frame::of(&state.live, nodes, |i| {
            (state.displacement[i].xyz(), state.velocity[i].xyz())
        });
        for node in nodes {
            let i = *node as usize;
            let u = &state.displacement[i];
            self.local[i] = match state.live.is_objective() {
                true => *u,
                false => frame.local(&state.live.rest[i], &u.xyz()).into(),
            };
        }
        frame
    }

    fn make_room(&mut self, state: &State) {
        let count = state.live.pieces.loose_nodes().len();
        self.force.resize(count, Vec3::zeros());
        self.drag.resize(count, Vec3::zeros());
    }

    /// Its frame and elastic energy \[J\].
    fn measure_piece(
        &mut self,
        model: &Model,
        state: &State,
        piece: std::ops::Range<usize>,
    ) -> (Frame, f64) {
        let live = &state.live;
        let nodes = &live.pieces.loose_nodes()[piece.clone()];
        let frame = self.locate_piece(state, piece.clone());
        let mut elastic = 0.0;
        live.internal_forces(model, nodes, &self.local, &mut self.inner);
        for (k, node) in piece.clone().zip(nodes) {
            let force = self.inner[*node as usize].xyz();
            elastic += 0.5 * force.dot(&self.local[*node as usize].xyz());
            self.force[k] = force;
        }
        elastic += live.not_quadratic(model, nodes, &self.local);
        self.turn_back(state, piece, &frame);
        (frame, elastic)
    }

    /// Forces of a piece from its frame to the world.
    fn turn_back(&mut self, state: &State, piece: std::ops::Range<usize>, frame: &Frame) {
        if !state.live.is_objective() {
            let nodes = &state.live.pieces.loose_nodes()[piece.clone()];
            frame.turn_back(state, nodes, &mut self.force[piece]);
        }
    }

    /// Its drags by damping \[1/s\].
    fn drag(&mut self, state: &State, piece: std::ops::Range<usize>, frame: &Frame, damping: f64) {
        let nodes = &state.live.pieces.loose_nodes()[piece.clone()];
        for (k, node) in piece.zip(nodes) {
            let i = *node as usize;
            let at = state.live.rest[i] + state.displacement[i].xyz();
            let v = state.velocity[i].xyz();
            let drag = frame.relative(&at, &v) * (damping * state.live.mass[i]);
            self.braked += v.dot(&drag);
            self.drag[k] = drag;
        }
    }

    /// Turns the loose nodes' vectors into their frames, or back.
    pub(crate) fn turn(&self, state: &State, back: bool, vectors: &mut [Lane]) {
        if state.live.is_objective() {
            return;
        }
        let nodes = state.live.pieces.loose_nodes();
        for (piece, frame) in state.live.pieces.loose().zip(&self.frames) {
            for node in &nodes[piece] {
                let vector = &mut vectors[*node as usize];
                *vector = match back {
                    false => frame.rotation.tr_mul(&vector.xyz()),
                    true => frame.rotation * vector.xyz(),
                }
                .into();
            }
        }
    }

    /// Nodes of each loose piece with its rotation, as measured.
    pub(crate) fn turned<'a>(
        &'a self,
        state: &'a State,
    ) -> impl Iterator<Item = (&'a [u32], Matrix3<f64>)> {
        let pieces = &state.live.pieces;
        let turned = pieces.loose().zip(&self.frames);
        turned.map(|(piece, frame)| (&pieces.loose_nodes()[piece], frame.rotation))
    }

    /// Takes the motion as a whole out of the velocities: what is left can be solved for. Nodes that something
    /// holds get the velocity that leads to their place at the end, as seen by who moves along. `seconds` are
    /// what the solution is for. (A piece of which nodes are held on some axes only keeps its velocities.)
    pub(crate) fn take_off(&mut self, model: &Model, state: &mut State, seconds: f64) {
        self.flights.clear();
        if state.live.pieces.loose_nodes().is_empty() || state.live.is_objective() {
            return;
        }
        self.measure(model, state);
        for at in 0..self.frames.len() {
            let mut frame = self.frames[at];
            let Some(piece) = state.live.pieces.loose().nth(at) else {
                break;
            };
            let node = |k: usize| state.live.pieces.loose_nodes()[k] as usize;
            let axes_held = |k: usize| {
                let moves = state.inverse_mass[node(k)].0[..3].iter();
                moves.filter(|w| **w == 0.0).count()
            };
            if piece.clone().any(|k| [1, 2].contains(&axes_held(k))) {
                frame.velocity = Vec3::zeros();
                frame.spin = Vec3::zeros();
            }
            let mut flight = Flight {
                now: frame.now,
                velocity: frame.velocity,
                turn: Rotation3::new(frame.spin * seconds),
                spin: frame.spin,
                momentum: Vec3::zeros(),
                turning: Vec3::zeros(),
                energy: self.energy(state, piece.clone()),
                is_held: piece.clone().any(|k| axes_held(k) > 0),
            };
            for k in piece {
                let i = state.live.pieces.loose_nodes()[k] as usize;
                let rest = state.live.rest[i];
                let at = rest + state.displacement[i].xyz() - frame.now;
                let (m, v, f) = (
                    state.live.mass[i],
                    state.velocity[i].xyz(),
                    state.external[i].xyz(),
                );
                flight.momentum += v * m + f * seconds;
                flight.turning += at.cross(&((v - frame.velocity) * m + f * seconds));
                let left = if axes_held(k) < 3 {
                    v - frame.velocity - frame.spin.cross(&at)
                } else {
                    let end = rest + led(state, i as u32).0;
                    let seen =
                        flight.turn.inverse() * (end - flight.now - flight.velocity * seconds);
                    (seen - at) / seconds
                };
                state.velocity[i] = left.into();
            }
            self.flights.push(flight);
        }
    }

    /// Adds centrifugal and Coriolis forces of the motion that was taken out.
    pub(crate) fn add_inertia(&self, state: &State, residual: &mut [Lane]) {
        for (i, flight) in self.flying(state) {
            let at = state.live.rest[i] + state.displacement[i].xyz() - flight.now;
            let spin = &flight.spin;
            let a = spin.cross(&(spin.cross(&at) + state.velocity[i].xyz() * 2.0));
            residual[i] = (residual[i].xyz() - a * state.live.mass[i]).into();
        }
    }

    /// Puts it back: a translation and a rotation. Momenta of what nothing holds are right to round-off.
    pub(crate) fn land(&mut self, state: &mut State, seconds: f64) {
        let nodes = state.live.pieces.loose_nodes();
        for (piece, flight) in state.live.pieces.loose().zip(&self.flights) {
            let own = &nodes[piece];
            for node in own {
                let i = *node as usize;
                let rest = state.live.rest[i];
                let at = flight.turn * (rest + state.displacement[i].xyz() - flight.now);
                let v = flight.turn * state.velocity[i].xyz()
                    + flight.spin.cross(&at)
                    + flight.velocity;
                state.displacement[i] = (at + flight.now + flight.velocity * seconds - rest).into();
                state.velocity[i] = v.into();
            }
            if flight.is_held {
                for node in own {
                    let i = *node as usize;
                    let (u, v) = led(state, *node);
                    for axis in (0..3).filter(|a| state.inverse_mass[i].0[*a] == 0.0) {
                        state.displacement[i].0[axis] = u[axis];
                        state.velocity[i].0[axis] = v[axis];
                    }
                }
                continue;
            }
            let frame = Frame::of(&state.live, own, |i| {
                (state.displacement[i].xyz(), state.velocity[i].xyz())
            });
            let slip = flight.momentum / frame.mass - frame.velocity;
            let twist = frame.uninert * flight.turning - frame.spin;
            for node in own {
                let i = *node as usize;
                let at = state.live.rest[i] + state.displacement[i].xyz() - frame.now;
                let v = state.velocity[i].xyz() + slip + twist.cross(&at);
                state.velocity[i] = v.into();
            }
        }
    }

    /// What pieces have lost since they took off \[J\], and the power that damping takes from
    /// them now \[W\]. `residual` is minus what holds them.
    pub(crate) fn lost(
        &mut self,
        model: &Model,
        state: &State,
        residual: &[Lane],
        seconds: f64,
    ) -> (f64, f64) {
        if self.flights.is_empty() {
            return (0.0, 0.0);
        }
        self.measure(model, state);
        let (mut lost, mut braked) = (0.0, 0.0);
        for (piece, flight) in state.live.pieces.loose().zip(&self.flights) {
            for k in piece.clone() {
                let i = state.live.pieces.loose_nodes()[k] as usize;
                let v = state.velocity[i].xyz();
                braked += v.dot(&self.drag[k]);
                for axis in (0..3).filter(|a| state.inverse_mass[i].0[*a] == 0.0) {
                    lost -= seconds * v[axis] * residual[i].0[axis];
                }
            }
            lost += flight.energy - self.energy(state, piece);
        }
        (lost, braked)
    }

    /// Nodes of pieces that have taken off, each with its piece's flight.
    pub(crate) fn flying(&self, state: &State) -> impl Iterator<Item = (usize, &Flight)> {
        let pieces = &state.live.pieces;
        let flights = pieces.loose().zip(&self.flights);
        flights.flat_map(|(piece, flight)| {
            let nodes = pieces.loose_nodes()[piece].iter();
            nodes.map(move |node| (*node as usize, flight))
        })
    }

    /// Whether a node's piece has taken off.
    pub(crate) fn flies(&self, state: &State, node: usize) -> bool {
        state.live.pieces.is_loose(node) && self.flying(state).any(|(i, _)| i == node)
    }

    /// Elastic and kinetic energy and potential of one piece, as measured \[J\].
    fn energy(&self, state: &State, piece: std::ops::Range<usize>) -> f64 {
        let mut sum = 0.0;
        for k in piece {
            let i = state.live.pieces.loose_nodes()[k] as usize;
            sum += 0.5 * self.inner[i].xyz().dot(&self.local[i].xyz())
                + 0.5 * state.live.mass[i] * state.velocity[i].xyz().norm_squared()
                - state.external[i].xyz().dot(&state.displacement[i].xyz());
        }
        sum
    }

    /// Place of a node among the loose ones.
    fn place(state: &State, node: usize) -> Option<usize> {
        let pieces = &state.live.pieces;
        let key = |v: u32| (pieces.label[v as usize], v);
        let nodes = pieces.loose_nodes();
        nodes
            .binary_search_by_key(&key(node as u32), |v| key(*v))
            .ok()
    }

    /// Force f - dW/dx - drag on a loose node \[N\], as measured.
    pub fn residual(&self, state: &State, node: usize) -> Vec3 {
        Self::place(state, node).map_or(Vec3::zeros(), |k| {
            state.external[node].xyz() - self.force[k] - self.drag[k]
        })
    }

    /// Work of damping along present velocities for some time \[J\], at the drags found last.
    pub fn taken(&self, state: &State, seconds: f64) -> f64 {
        let nodes = state.live.pieces.loose_nodes().iter().zip(&self.drag);
        nodes
            .map(|(node, drag)| seconds * state.velocity[*node as usize].xyz().dot(drag))
            .sum()
    }

    /// Where tensors are, what a sweep of all but the loose nodes lacks: twice the elastic energy, and f . u
    /// \[J\], as measured.
    pub fn sums(&self, state: &State) -> (f64, f64) {
        let nodes = state.live.pieces.loose_nodes().iter();
        let external = nodes
            .map(|i| {
                let i = *i as usize;
                state.external[i].xyz().dot(&state.displacement[i].xyz())
            })
            .sum();
        (2.0 * self.elastic, external)
    }

    /// Before a cut: what the loose pieces among the `chosen` tetrahedra have in the energy account \[J\].
    pub(crate) fn before(&mut self, model: &Model, state: &State, chosen: &[u32]) -> f64 {
        self.touched.clear();
        let pieces = &state.live.pieces;
        if pieces.loose_nodes().is_empty() {
            return 0.0;
        }
        let mut sum = 0.0;
        for t in chosen.iter().filter(|t| state.live.alive[**t as usize]) {
            let node = state.live.tetrahedra[*t as usize][0] as usize;
            let label = pieces.label[node];
            if pieces.is_loose(node) && !self.touched.contains(&label) {
                self.touched.push(label);
                sum += self.balance(model, state, label);
            }
        }
        sum
    }

    /// What the cut has added to the account of these and of those that have just come loose: they find
    /// themselves in a frame. `changed` are labels, and whether what they name was loose.
    pub(crate) fn gained(
        &mut self,
        model: &Model,
        state: &State,
        before: f64,
        changed: &[(u32, bool)],
    ) -> f64 {
        let mut sum = -before;
        for at in 0..self.touched.len() {
            let label = self.touched[at];
            if !changed.iter().any(|(other, _)| *other == label) {
                sum += self.balance(model, state, label);
            }
        }
        for (label, was_loose) in changed {
            sum += self.balance(model, state, *label);
            if !was_loose {
                sum -= attached(model, state, *label);
            }
        }
        sum
    }

    /// Of one loose piece; 0 where there is none of that label.
    fn balance(&mut self, model: &Model, state: &State, label: u32) -> f64 {
        let Some((_, piece)) = state.live.pieces.loose_piece(label) else {
            return 0.0;
        };
        if state.live.is_objective() {
            // Each tetrahedron books its own.
            return 0.0;
        }
        self.make_room(state);
        let (_, mut sum) = self.measure_piece(model, state, piece.clone());
        let half = 0.5 * state.clock.lag;
        for k in piece {
            let i = state.live.pieces.loose_nodes()[k] as usize;
            let (u, v) = (state.displacement[i].xyz(), state.velocity[i].xyz());
            let external = state.external[i].xyz();
            sum += 0.5 * state.live.mass[i] * v.norm_squared()
                + half * v.dot(&(external - self.force[k]))
                - external.dot(&u);
        }
        sum
    }
}

/// Where a node is led by all that holds it, each along its own axes, and how fast: nowhere along the axes that are
/// fixed.
fn led(state: &State, node: u32) -> (Vec3, Vec3) {
    let (mut u, mut v) = (Vec3::zeros(), Vec3::zeros());
    for held in state.held.iter().filter(|h| h.node == node) {
        for axis in (0..3).filter(|a| held.axes[*a]) {
            u[axis] = held.target[axis];
            v[axis] = held.velocity[axis];
        }
    }
    (u, v)
}

/// What a piece that is loose now has in the account as long as it has no frame \[J\].
fn attached(model: &Model, state: &State, label: u32) -> f64 {
    let half = 0.5 * state.clock.lag;
    let lagging = model.lagging_damping(state.parameters.damping);
    let Some((_, piece)) = state.live.pieces.loose_piece(label) else {
        return 0.0;
    };
    let nodes = &state.live.pieces.loose_nodes()[piece];
    let mut sum = (state.live).not_quadratic(model, nodes, &state.displacement);
    for node in nodes {
        let i = *node as usize;
        let (m, u, v) = (
            state.live.mass[i],
            state.displacement[i].xyz(),
            state.velocity[i].xyz(),
        );
        sum -= half * lagging * m * v.norm_squared();
        if !state.live.is_objective() {
            let f = state.live.internal_force(model, i, &state.displacement);
            let external = state.external[i].xyz();
            sum += 0.5 * f.dot(&u) + 0.5 * m * v.norm_squared() + half * v.dot(&(external - f))
                - external.dot(&u);
        }
    }
    sum
}

/// Where a piece is and how it moves as a whole.
#[derive(Clone, Copy, Debug)]
struct Frame {
    /// \[kg\]
    mass: f64,
    /// Centres of mass, at rest and now \[m\].
    rest: Vec3,
    now: Vec3,
    rotation: Matrix3<f64>,
    /// H^-1 \[1/(kg m²)\]; zero where the piece is too degenerate to have one.
    unspin: Matrix3<f64>,
    /// Inverse of the tensor of inertia \[1/(kg m²)\]; likewise.
    uninert: Matrix3<f64>,
    /// v \[m/s\], omega \[1/s\]
    velocity: Vec3,
    spin: Vec3,
}

impl Frame {
    /// `motion` gives displacement and velocity of a node.
    fn of(live: &LiveMesh, nodes: &[u32], motion: impl Fn(usize) -> (Vec3, Vec3)) -> Frame {
        let of = |node: &u32| {
            let i = *node as usize;
            let (u, v) = motion(i);
            (live.mass[i], live.rest[i], live.rest[i] + u, v)
        };
        let zero = Vec3::zeros();
        let (mut total, mut rest, mut now, mut momentum) = (0.0, zero, zero, zero);
        for (m, p, x, v) in nodes.iter().map(of) {
            total += m;
            rest += p * m;
            now += x * m;
            momentum += v * m;
        }
        rest /= total;
        now /= total;
        let velocity = momentum / total;
        let (mut spread, mut inertia, mut turning) = (Matrix3::zeros(), Matrix3::zeros(), zero);
        for (m, p, x, v) in nodes.iter().map(of) {
            let (p, x) = (p - rest, x - now);
            spread += x * p.transpose() * m;
            inertia += (Matrix3::identity() * x.norm_squared() - x * x.transpose()) * m;
            turning += x.cross(&v) * m;
        }
        let rotation = polar(&spread);
        // sum m x (R X)^T; symmetric but for round-off.
        let turned = spread * rotation.transpose();
        let h = Matrix3::identity() * turned.trace() - turned.transpose();
        let uninert = inverse(&inertia);
        Frame {
            mass: total,
            rest,
            now,
            rotation,
            unspin: inverse(&h),
            uninert,
            velocity,
            spin: uninert * turning,
        }
    }

    /// w of a node at rest position `rest` and displacement u.
    fn local(&self, rest: &Vec3, u: &Vec3) -> Vec3 {
        let at = rest - self.rest;
        self.rotation.tr_mul(&(rest + u - self.now)) - at
    }

    /// What is left of the velocity of a point when the rigid motion is taken from it.
    fn relative(&self, at: &Vec3, velocity: &Vec3) -> Vec3 {
        velocity - self.velocity - self.spin.cross(&(at - self.now))
    }

    /// Forces K w to the world, without their net torque.
    fn turn_back(&self, state: &State, nodes: &[u32], force: &mut [Vec3]) {
        let mut torque = Vec3::zeros();
        for (node, force) in nodes.iter().zip(force.iter_mut()) {
            let i = *node as usize;
            *force = self.rotation * *force;
            let at = state.live.rest[i] + state.displacement[i].xyz() - self.now;
            torque += at.cross(force);
        }
        let a = self.unspin * torque;
        for (node, force) in nodes.iter().zip(force) {
            let i = *node as usize;
            let rest = self.rotation * (state.live.rest[i] - self.rest);
            *force -= a.cross(&rest) * state.live.mass[i];
        }
    }
}

/// Zero for a matrix that has none.
fn inverse(m: &Matrix3<f64>) -> Matrix3<f64> {
    let size = m.norm();
    match m.try_inverse() {
        Some(inverse) if inverse.norm() * size < 1e12 => inverse,
        _ => Matrix3::zeros(),
    }
}

/// Rotation R of A = R S, S symmetric: nearest to A, of determinant 1. By Newton's iteration with Higham's
/// scaling, Q <- (g Q + Q^-T / g)/2, g² = |Q^-1| / |Q|; by singular values where A is nearly flat or inside out.
fn polar(a: &Matrix3<f64>) -> Matrix3<f64> {
    let size = a.norm();
    let mut q = *a;
    if a.determinant() > 1e-9 * size.powi(3) {
        for _ in 0..30 {
            let Some(inverse) = q.try_inverse() else {
                break;
            };
            let g = (inverse.norm() / q.norm()).sqrt();
            let next = (q * g + inverse.transpose() / g) * 0.5;
            let change = (next - q).norm();
            q = next;
            if change < 1e-8 {
                // The next one would be of its square.
                return q;
            }
        }
    }
    let svd = a.svd(true, true);
    let (Some(mut u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Matrix3::identity();
    };
    if (u * v_t).determinant() < 0.0 {
        let least = svd.singular_values.imin();
        u.column_mut(least).neg_mut();
    }
    u * v_t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polar_is_a_rotation_that_leaves_a_symmetric_factor() {
        for k in 0..200 {
            let f = |n: f64| (f64::from(k) * n).sin();
            let stretch = Matrix3::from_diagonal(&Vec3::new(1e-4, 1e-5 * (2.0 + f(1.1)), 1e-6));
            let turn = Rotation3::new(Vec3::new(3.0 * f(1.3), 3.0 * f(2.1), 3.0 * f(0.7)));
            let skew = Matrix3::from_fn(|i, j| 1e-7 * f((3 * i + j) as f64 + 0.5));
            let a = turn * (stretch + skew);
            let r = polar(&a);
            let s = r.transpose() * a;
            assert!((r.transpose() * r - Matrix3::identity()).norm() < 1e-14);
            assert!((r.determinant() - 1.0).abs() < 1e-14);
            assert!((s - s.transpose()).norm() < 1e-14 * a.norm());
        }
        // Flat, and inside out.
        for last in [0.0, -1e-3] {
            let r = polar(&Matrix3::from_diagonal(&Vec3::new(1.0, 2.0, last)));
            assert!((r - Matrix3::identity()).norm() < 1e-12);
        }
    }
}
