//! Sliding contact with pre-computed tissue.
//!
//! It has no mass: what a tool does to it shows at once, by the compliance G of the nodes that it touches. Places stay where they are on
//! it: a face that turns under a tool would send its nearest one to and fro for ever, where nothing has inertia. There are so many
//! that hardly anything enters between them. With the cones of [`super::slide`], C = G_ff - G_fh G_hh^-1 G_hf what others hold of it (h) staying where they hold it, u' the
//! displacements that there would be without any contact, B the weights of the places and f = B^T lambda,
//!
//! u = u' + C f,  W = B C B^T,
//!
//! and lambda such that at the end of the substep no place is inside the tool, none is pulled, and each sticks or rubs: the same
//! iteration, in displacements. The interface feels f in the next substep, as it feels what is held. Potential energy is
//! quadratic, so that the trapezoid of forces along displacements is all that the tissue takes up; the rest of what the tool
//! does is friction.

use super::slide::{Contact, Place, Scratch, Substep};
use super::solve::within_cone;
use crate::couple::Coupling;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::dense::{add_scaled, dot};
use crate::state::State;

/// Passes through the places at most.
const MOST_PASSES: usize = 300;
/// Passes end when no force changes by more than this share of the largest.
const SETTLED: f64 = 1e-11;
/// Times that it is looked what touches, and how, where tissue has gone.
const ROUNDS: u32 = 3;
/// Places that are at most this far away, in radii, are followed from substep to substep.
const FOLLOWED: f64 = 0.02;
/// Places are so near each other that what enters between them does so by this share of an edge at most, and no farther apart than
/// this share of the radius.
const SAGITTA: f64 = 0.005;
const SPACING: f64 = 0.3;
/// Parts that an edge is divided into.
const LEAST_PARTS: f64 = 2.0;
const MOST_PARTS: f64 = 100.0;
/// Room for nodes and places without allocating.
const NODES: usize = 96;
const PLACES: usize = 128;

/// That an edge is divided into: between three places s apart a ball of radius R comes in by s²/6R.
fn parts(length: f64, radius: f64) -> u32 {
    let spacing = (6.0 * SAGITTA * radius * length)
        .sqrt()
        .min(SPACING * radius);
    (length / spacing).ceil().clamp(LEAST_PARTS, MOST_PARTS) as u32
}

/// Places of a triangle, by their weights.
pub(super) fn places(rest: &[Vec3; 3], radius: f64, mut add: impl FnMut([f64; 3])) {
    for k in 0..3 {
        add([0, 1, 2].map(|l| f64::from(u8::from(k == l))));
    }
    let mut most = 0;
    for (k, l) in [(0, 1), (1, 2), (0, 2)] {
        let n = parts((rest[l] - rest[k]).norm(), radius);
        most = most.max(n);
        for m in 1..n {
            let share = f64::from(m) / f64::from(n);
            let mut weight = [0.0; 3];
            (weight[k], weight[l]) = (1.0 - share, share);
            add(weight);
        }
    }
    for k in 1..most {
        for l in 1..most - k {
            let [second, third] = [k, l].map(|k| f64::from(k) / f64::from(most));
            add([1.0 - second - third, second, third]);
        }
    }
}

/// The same place of the vertex or the edge that it lies on, whatever triangle it was found by.
pub(super) fn compact(nodes: [u32; 3], weight: [f64; 3]) -> ([u32; 3], [f64; 3]) {
    let (mut own, mut share, mut count) = (nodes, [0.0; 3], 0);
    for (node, b) in nodes.into_iter().zip(weight).filter(|(_, b)| *b != 0.0) {
        (own[count], share[count]) = (node, b);
        count += 1;
    }
    let last = own[count - 1];
    own[count..].fill(last);
    (own, share)
}

/// A force on pre-computed tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pressed {
    pub tool: u32,
    /// b_i, which sum to 1.
    pub nodes: [u32; 3],
    pub weight: [f64; 3],
    /// sum b_i x_i \[m\].
    pub place: Vec3,
    /// Of the tool on tissue \[N\].
    pub force: Vec3,
}

/// A place that touches in a substep.
#[derive(Clone, Copy, Debug)]
struct Touch {
    contact: usize,
    tool: u32,
    /// In [`Press::nodes`].
    nodes: [usize; 3],
    weight: [f64; 3],
    normal: Vec3,
    /// Of the place as it was and the tool at the end of the substep \[m\].
    gap: f64,
    /// Of the place if nothing touched, and of the tool there, in the substep \[m\].
    free: Vec3,
    way: Vec3,
    /// n . W n, and no less than the largest eigenvalue of W \[m/N\].
    along: f64,
    across: f64,
    friction: f64,
    force: Vec3,
}

/// Reused from substep to substep.
#[derive(Debug, Default)]
pub struct Press {
    /// Followed, in rising order.
    nodes: Vec<u32>,
    /// A node each, at the start of the substep and without contact \[m\].
    old: Vec<Vec3>,
    free: Vec<Vec3>,
    /// At its end, as far as that is known \[m\].
    now: Vec<Vec3>,
    /// f \[N\] a node.
    force: Vec<Vec3>,
    before: Vec<Pressed>,
    touches: Vec<Touch>,
    /// C, three numbers a node square \[m/N\], of these nodes and what was held then.
    compliance: Vec<f64>,
    of: Vec<u32>,
    held: Vec<u32>,
    /// G_hh^-1 G_h of one column.
    column: Vec<f64>,
    /// W, three numbers a place square \[m/N\].
    response: Vec<f64>,
    /// lambda, three numbers a place \[N\].
    lambda: Vec<f64>,
}

impl Press {
    pub fn with_room(model: &Model) -> Press {
        let (nodes, places) = (NODES.min(model.parts.touchable), PLACES);
        if nodes == 0 {
            return Press::default();
        }
        Press {
            nodes: Vec::with_capacity(4 * nodes),
            old: Vec::with_capacity(nodes),
            free: Vec::with_capacity(nodes),
            now: Vec::with_capacity(nodes),
            force: Vec::with_capacity(nodes),
            before: Vec::with_capacity(places),
            touches: Vec::with_capacity(places),
            compliance: Vec::with_capacity(9 * nodes * nodes),
            of: Vec::with_capacity(nodes),
            held: Vec::with_capacity(3 * nodes),
            column: Vec::with_capacity(3 * nodes),
            response: Vec::with_capacity(9 * places * places),
            lambda: Vec::with_capacity(3 * places),
        }
    }

    /// C of the nodes as they are, unless it is known.
    fn find_compliance(&mut self, model: &Model, coupling: &Coupling) {
        if self.of == self.nodes && self.held == coupling.held_inside() {
            return;
        }
        self.of.clone_from(&self.nodes);
        self.held.clear();
        self.held.extend_from_slice(coupling.held_inside());
        let Some(part) = &model.precomputed else {
            return;
        };
        let size = 3 * self.nodes.len();
        let from = self
            .nodes
            .partition_point(|v| (*v as usize) < model.parts.moving);
        let dof = |k: usize| 3 * (self.nodes[k / 3] as usize - model.parts.moving) + k % 3;
        self.compliance.clear();
        self.compliance.resize(size * size, 0.0);
        let rows = self.compliance.chunks_mut(size.max(1)).enumerate();
        for (k, row) in rows.skip(3 * from) {
            let g = part.compliance(dof(k));
            for (l, c) in row.iter_mut().enumerate().skip(3 * from) {
                *c = g[dof(l)];
            }
            if self.held.is_empty() {
                continue;
            }
            self.column.clear();
            (self.column).extend(self.held.iter().map(|h| g[*h as usize]));
            coupling.yield_to(&mut self.column);
            for (l, c) in row.iter_mut().enumerate().skip(3 * from) {
                let g = part.compliance(dof(l));
                let pairs = self.held.iter().zip(&self.column);
                *c -= pairs.map(|(h, y)| g[*h as usize] * y).sum::<f64>();
            }
        }
    }

    /// The 3 x 3 numbers of C by which a force on one node moves another.
    fn block(&self, of: usize, by: usize) -> nalgebra::Matrix3<f64> {
        let size = 3 * self.nodes.len();
        nalgebra::Matrix3::from_fn(|a, b| self.compliance[(3 * by + b) * size + 3 * of + a])
    }

    /// W of all that touches.
    fn find_response(&mut self) {
        let size = 3 * self.touches.len();
        let mut response = std::mem::take(&mut self.response);
        response.clear();
        response.resize(size * size, 0.0);
        for (p, at) in self.touches.iter().enumerate() {
            for (q, by) in self.touches.iter().enumerate().take(p + 1) {
                let mut w = nalgebra::Matrix3::zeros();
                for (i, b) in at.nodes.iter().zip(at.weight).filter(|(_, b)| *b != 0.0) {
                    for (k, d) in by.nodes.iter().zip(by.weight).filter(|(_, d)| *d != 0.0) {
                        w += self.block(*i, *k) * (b * d);
                    }
                }
                for a in 0..3 {
                    for b in 0..3 {
                        response[(3 * p + a) * size + 3 * q + b] = w[(a, b)];
                        response[(3 * q + b) * size + 3 * p + a] = w[(a, b)];
                    }
                }
            }
        }
        for (p, touch) in self.touches.iter_mut().enumerate() {
            let own = |a: usize, b: usize| response[(3 * p + a) * size + 3 * p + b];
            let n = touch.normal;
            touch.along = (0..9)
                .map(|k| n[k / 3] * own(k / 3, k % 3) * n[k % 3])
                .sum();
            let row = |a: usize| (0..3).map(|b| own(a, b).abs()).sum::<f64>();
            touch.across = row(0).max(row(1)).max(row(2));
        }
        self.response = response;
    }

    /// Forces of all that touches.
    fn solve(&mut self) {
        let size = 3 * self.touches.len();
        self.lambda.clear();
        for touch in &mut self.touches {
            // Normals turn; the cone is kept.
            let pressed = touch.force.dot(&touch.normal).max(0.0);
            touch.force = within_cone(&touch.normal, touch.friction, touch.force, pressed);
            self.lambda.extend_from_slice(touch.force.as_slice());
        }
        for _ in 0..MOST_PASSES {
            let (mut change, mut largest) = (0.0f64, 0.0f64);
            for (p, touch) in self.touches.iter_mut().enumerate() {
                if touch.along <= 0.0 {
                    continue;
                }
                let moved = |a: usize| {
                    let row = (3 * p + a) * size;
                    dot(&self.response[row..row + size], &self.lambda)
                };
                let d = touch.free + Vec3::new(moved(0), moved(1), moved(2));
                let n = touch.normal;
                let pressed =
                    (touch.force.dot(&n) - (touch.gap + n.dot(&d)) / touch.along).max(0.0);
                let sticking = touch.force - (d - touch.way) / touch.across;
                let force = within_cone(&n, touch.friction, sticking, pressed);
                change = change.max((force - touch.force).amax());
                largest = largest.max(force.amax());
                touch.force = force;
                self.lambda[3 * p..3 * p + 3].copy_from_slice(force.as_slice());
            }
            if change <= SETTLED * largest {
                break;
            }
        }
    }
}

impl Press {
    /// f = B^T lambda
    fn sum(&mut self) {
        self.force.fill(Vec3::zeros());
        for touch in &self.touches {
            for (i, b) in touch.nodes.iter().zip(touch.weight) {
                self.force[*i] += touch.force * b;
            }
        }
    }

    /// u = u' + C f
    fn yields(&mut self) {
        let size = 3 * self.nodes.len();
        self.column.clear();
        self.column.resize(size, 0.0);
        for (row, compliance) in self.compliance.chunks(size.max(1)).enumerate() {
            let f = self.force[row / 3][row % 3];
            if f != 0.0 {
                add_scaled(&mut self.column, f, compliance);
            }
        }
        self.now.clear();
        let moved = self.column.chunks(3).map(|u| Vec3::new(u[0], u[1], u[2]));
        let ends = self.free.iter().zip(moved).map(|(free, more)| free + more);
        self.now.extend(ends);
    }
}

/// At the end of a substep, when all that moves has moved and tools are where they end: pre-computed tissue takes its place under
/// what slides on it. Books work, friction and impulse. Leaves the coupling solved.
pub fn press(
    model: &Model,
    state: &mut State,
    work: &mut Scratch,
    substep: &Substep,
    impulse: &mut [Vec3],
) {
    if state.coupling.pressed.is_empty() && !state.contacts.iter().any(Contact::stays) {
        state.coupling.solve(model, &state.displacement);
        return;
    }
    follow(model, state, work, substep);
    let press = &mut work.press;
    // As they are, then as they would be.
    let known = |v: u32, pressed: &[Pressed]| pressed.iter().any(|p| p.nodes.contains(&v));
    press.before.clone_from(&state.coupling.pressed);
    press.old.clear();
    for v in &press.nodes {
        if !known(*v, &press.before) {
            refresh(model, state, *v);
        }
        let i = *v as usize;
        // What moves has moved.
        let back = match i < model.parts.moving {
            true => state.velocity[i].xyz() * substep.by.substep,
            false => Vec3::zeros(),
        };
        press.old.push(state.displacement[i].xyz() - back);
    }
    state.coupling.leave(model, &state.displacement);
    press.free.clear();
    for v in &press.nodes {
        refresh(model, state, *v);
        press.free.push(state.displacement[*v as usize].xyz());
    }
    press.find_compliance(model, &state.coupling);
    start(state, &mut work.press);
    for _ in 0..ROUNDS {
        touch(model, state, work, substep);
        work.press.find_response();
        work.press.solve();
        work.press.sum();
        work.press.yields();
        for touch in &work.press.touches {
            state.contacts[touch.contact].force = touch.force;
        }
    }
    give(model, state, &work.press);
    book(state, &work.press, substep, impulse);
}

/// As if the forces were those of the substep before.
fn start(state: &State, press: &mut Press) {
    press.force.clear();
    press.force.resize(press.nodes.len(), Vec3::zeros());
    for contact in state.contacts.iter().filter(|c| c.force != Vec3::zeros()) {
        let Place::At(weight) = contact.place else {
            continue;
        };
        for (v, b) in contact.nodes.iter().zip(weight) {
            if let Ok(k) = press.nodes.binary_search(v) {
                press.force[k] += contact.force * b;
            }
        }
    }
    press.yields();
}

/// Which nodes may be touched in this substep.
fn follow(model: &Model, state: &State, work: &mut Scratch, substep: &Substep) {
    let (press, shape) = (&mut work.press, &mut work.shape);
    press.nodes.clear();
    let periods = 1.0 / (model.scene.integration.haptic_rate * substep.by.substep);
    let (mut of, mut slack) = (u32::MAX, 0.0);
    for contact in state.contacts.iter().filter(|c| c.stays()) {
        let k = contact.tool as usize;
        if contact.tool != of {
            of = contact.tool;
            shape.clear();
            shape.extend(model.tools[k].at(&state.tools[k].pose));
            slack = 2.0 * periods * model.tools[k].way(&substep.from[k], &state.tools[k].pose);
        }
        let capsule = &shape[contact.capsule as usize];
        let x = contact.nodes.map(|v| state.position(v));
        let is_near = contact.weights(capsule, &x).is_some_and(|(b, on_axis)| {
            let place = x[0] * b[0] + x[1] * b[1] + x[2] * b[2];
            (place - on_axis).norm() <= (1.0 + FOLLOWED) * capsule.radius + slack
        });
        if is_near || contact.force != Vec3::zeros() {
            press.nodes.extend(contact.nodes);
        }
    }
    for pressed in &state.coupling.pressed {
        press.nodes.extend(pressed.nodes);
    }
    press.nodes.sort_unstable();
    press.nodes.dedup();
}

/// Brings a node up to date.
fn refresh(model: &Model, state: &mut State, node: u32) {
    let State {
        coupling,
        displacement,
        held,
        ..
    } = state;
    if let Some(inside) = (node as usize).checked_sub(model.parts.moving) {
        coupling.update(model, displacement, held, inside..inside + 1);
    }
}

/// After pre-computed tissue has jumped, its forces being as they were: brings what is pressed up to date.
pub(crate) fn follow_jump(model: &Model, state: &mut State) {
    for at in 0..state.coupling.pressed.len() {
        for v in state.coupling.pressed[at].nodes {
            refresh(model, state, v);
        }
    }
}

/// What touches at the end of the substep, or did in the one before.
fn touch(model: &Model, state: &mut State, work: &mut Scratch, substep: &Substep) {
    let (press, shape) = (&mut work.press, &mut work.shape);
    press.touches.clear();
    let mut of = u32::MAX;
    for (at, contact) in state.contacts.iter_mut().enumerate() {
        if !contact.stays() {
            continue;
        }
        let k = contact.tool as usize;
        let pose = &state.tools[k].pose;
        if contact.tool != of {
            of = contact.tool;
            shape.clear();
            shape.extend(model.tools[k].at(pose));
        }
        let last = std::mem::take(&mut contact.force);
        let capsule = &shape[contact.capsule as usize];
        let Ok(own) = press.nodes.binary_search(&contact.nodes[0]) else {
            continue;
        };
        let find = |v: u32| press.nodes.binary_search(&v).unwrap_or(own);
        let nodes = contact.nodes.map(find);
        let rest = contact.nodes.map(|v| state.live.rest[v as usize]);
        let x = [0, 1, 2].map(|c| rest[c] + press.now[nodes[c]]);
        let Some((weight, on_axis)) = contact.weights(capsule, &x) else {
            continue;
        };
        let pairs = || nodes.iter().zip(weight);
        let place = x[0] * weight[0] + x[1] * weight[1] + x[2] * weight[2];
        let away = place - on_axis;
        let distance = away.norm();
        let is_apart = distance >= capsule.radius && last == Vec3::zeros();
        if distance == 0.0 || is_apart {
            continue;
        }
        let (gap, normal) = (distance - capsule.radius, away / distance);
        let mean = |of: &[Vec3]| -> Vec3 { pairs().map(|(i, b)| of[*i] * b).sum() };
        let free = mean(&press.free) - mean(&press.old);
        // Of where it was.
        let gap = gap.max(-super::slide::MOST_DEPTH * capsule.radius)
            - normal.dot(&(mean(&press.now) - mean(&press.old)));
        press.touches.push(Touch {
            contact: at,
            tool: contact.tool,
            nodes,
            weight,
            normal,
            gap,
            free,
            way: place - substep.from[k].point(&pose.local(&place)),
            along: 0.0,
            across: 0.0,
            friction: super::slide::coefficient(model, k).unwrap_or(0.0),
            force: last,
        });
    }
}

/// Puts the forces where they act.
fn give(model: &Model, state: &mut State, press: &Press) {
    let mut work = 0.0;
    for (k, v) in press.nodes.iter().enumerate() {
        work += press.force[k].dot(&(press.now[k] - press.free[k]));
        state.displacement[*v as usize] = press.now[k].into();
    }
    let (live, displacement) = (&state.live, &state.displacement);
    let position = |v: u32| live.rest[v as usize] + displacement[v as usize].xyz();
    let touches = press.touches.iter().filter(|t| t.force != Vec3::zeros());
    let pressed = touches.map(|touch| {
        let nodes = touch.nodes.map(|i| press.nodes[i]);
        let places = nodes
            .iter()
            .zip(touch.weight)
            .map(|(v, b)| position(*v) * b);
        Pressed {
            tool: touch.tool,
            nodes,
            weight: touch.weight,
            place: places.sum(),
            force: touch.force,
        }
    });
    state.coupling.press(model, pressed, work);
}

/// Half of what the forces before and now do in the substep each.
fn book(state: &mut State, press: &Press, substep: &Substep, impulse: &mut [Vec3]) {
    let half = 0.5 * substep.by.substep;
    let (mut by_tools, mut on_tissue) = (0.0, 0.0);
    let moved = |p: &Pressed| -> Vec3 {
        let each = p.nodes.iter().zip(p.weight).map(|(v, b)| {
            let k = press.nodes.binary_search(v).unwrap_or(0);
            (state.displacement[*v as usize].xyz() - press.old[k]) * b
        });
        each.sum()
    };
    for pressed in &press.before {
        let k = pressed.tool as usize;
        let local = substep.from[k].local(&pressed.place);
        let way = state.tools[k].pose.point(&local) - pressed.place;
        by_tools += 0.5 * pressed.force.dot(&way);
        on_tissue += 0.5 * pressed.force.dot(&moved(pressed));
        impulse[k] -= pressed.force * half;
    }
    for pressed in &state.coupling.pressed {
        let k = pressed.tool as usize;
        let local = state.tools[k].pose.local(&pressed.place);
        let way = pressed.place - substep.from[k].point(&local);
        by_tools += 0.5 * pressed.force.dot(&way);
        on_tissue += 0.5 * pressed.force.dot(&moved(pressed));
        impulse[k] -= pressed.force * half;
    }
    state.account.tool_work += by_tools;
    state.account.dissipated += by_tools - on_tissue;
}

/// Adds what presses at the end of a step to force and torque of each tool.
pub fn read_forces(state: &mut State) {
    for pressed in &state.coupling.pressed {
        let tool = &mut state.tools[pressed.tool as usize];
        tool.force -= pressed.force;
        tool.torque -= (pressed.place - tool.pose.position).cross(&pressed.force);
        tool.in_contact = true;
    }
}
