//! Sliding contact: what a tool with a Coulomb coefficient touches may not enter it, may leave it, and rubs.
//!
//! A place of the surface is x_c = sum b_i x_i. Of dynamic tissue: a vertex, the point of an edge or of a face that is nearest to
//! the axis of a capsule: of a flat triangle against a capsule one of these is always the deepest. (Of pre-computed tissue see
//! [`super::press`].) With n from the axis to x_c, R the
//! radius and v_t the velocity of the tool there, the forces lambda_c of the tool on tissue are those with
//!
//! g_c = |x_c - axis| - R >= 0 at the end of the substep,  n . lambda_c >= 0,  g_c (n . lambda_c) = 0,
//! |lambda_t| <= mu n . lambda_c, against the slip v_c - v_t, or as large as keeps it from slipping.
//!
//! A force lambda_c moves the nodes by v_i += b_i gain / m_i lambda_c in the substep, so that each place answers to itself by
//! W = sum b_i² gain / m_i, and to others by the nodes that they share. Beside held nodes, where b_i of the others is small, W has
//! a least value, by which the place yields: a small force there would throw a light vertex far. `solve` finds the
//! forces from those of the substep before. (The papers hold vertices instead; this is the unilateral constraint at velocity level of
//! the manual's section 11.)

use std::cmp::Ordering;

use super::geometry::Capsule;
use super::hold;
use super::nearby::{self, Nearby};
use super::press::{self, Press};
use super::shape::ToolShape;
use super::solve::{Touch, solve};
use crate::loose;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::sweep::{Advance, Sums};
use crate::model::tensor_mass::Lane;
use crate::pose::Pose;
use crate::scene::{Friction, ToolKind};
use crate::state::State;

/// What is nearer than this share of the radius at a haptic tick, and what tool and tissue can move until the next one,
/// is looked at.
const MARGIN: f64 = 0.25;
/// Longest that an edge may be, in rest lengths of the longest.
pub(crate) const STRETCH: f64 = 1.25;
/// Weight of pre-computed vertices in a place of a face that belongs to both parts, at least: with less, the others would be held
/// by however little these give.
const LEAST_INSIDE: f64 = 0.7;
/// Depth, in radii, that a substep makes good at most: what is deeper comes out over several.
pub(super) const MOST_DEPTH: f64 = 0.1;
/// The same of dynamic tissue, beside what the tool moves in the substep: what is thrown out keeps its speed.
const MOST_THROW: f64 = 0.01;
/// Weight of vertices that may move in a place beside held ones, at least, up to which it answers to its force as it is. With
/// less it yields as if this were their weight, or they would be thrown by a lever of any length.
const LEAST_LEVER: f64 = 0.3;

/// Of a vertex, an edge or a face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// What is nearest to the axis; of a face, to its tip.
    Nearest,
    /// Of a face what is nearest to the far end of the axis.
    NearestEnd,
    /// b_i, which sum to 1.
    At([f64; 3]),
}

/// A place that a capsule of a tool may touch before the next haptic tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    pub tool: u32,
    /// Which of its capsules.
    pub capsule: u32,
    /// In rising order; of a vertex three times the same, of an edge the second one twice.
    pub nodes: [u32; 3],
    pub place: Place,
    /// Of the tool on tissue in the last substep \[N\].
    pub force: Vec3,
    /// v_t in the last substep \[m/s\], where there was a force.
    pub velocity: Vec3,
}

/// A place of a tool, in the order in which they are listed: which capsule, which nodes, and whether it is nearest to the far end of
/// the axis; of tissue without mass not yet where.
type Name = u128;
/// Of tissue without mass, which comes first.
const STAYS: Name = 0;
const MOVES: Name = 1 << 127;

fn name(capsule: u32, nodes: [u32; 3], place: &Place) -> Name {
    let part = match place {
        Place::At(_) => STAYS,
        Place::Nearest => MOVES,
        Place::NearestEnd => MOVES | 1,
    };
    let each = nodes.into_iter();
    part | each.fold(Name::from(capsule), |all, v| all << 32 | Name::from(v)) << 1
}

impl Contact {
    /// Nothing is known of it but where it is.
    fn new(tool: u32, capsule: u32, nodes: [u32; 3], place: Place) -> Contact {
        Contact {
            tool,
            capsule,
            nodes,
            place,
            force: Vec3::zeros(),
            velocity: Vec3::zeros(),
        }
    }

    /// Of a name of tissue with mass.
    fn named(tool: u32, name: Name) -> Contact {
        let part = |k: u32| (name >> (32 * k + 1)) as u32;
        let place = match name & 1 {
            0 => Place::Nearest,
            _ => Place::NearestEnd,
        };
        let capsule = part(3) & (u32::MAX >> 2);
        Contact::new(tool, capsule, [part(2), part(1), part(0)], place)
    }

    /// Of one tool.
    fn order(&self, other: &Contact) -> Ordering {
        let names = [self, other].map(|c| name(c.capsule, c.nodes, &c.place));
        names[0]
            .cmp(&names[1])
            .then_with(|| match (self.place, other.place) {
                (Place::At(a), Place::At(b)) => a.map(f64::to_bits).cmp(&b.map(f64::to_bits)),
                _ => Ordering::Equal,
            })
    }

    /// Whether it is on tissue without mass.
    pub(crate) fn stays(&self) -> bool {
        matches!(self.place, Place::At(_))
    }

    /// Weights of the nodes, at x, and the point of the axis that are nearest to each other; none where another place is
    /// nearer.
    pub(super) fn weights(&self, capsule: &Capsule, x: &[Vec3; 3]) -> Option<([f64; 3], Vec3)> {
        let end = match self.place {
            Place::At(b) => {
                let place = x[0] * b[0] + x[1] * b[1] + x[2] * b[2];
                return Some((b, capsule.on_axis(&place)));
            }
            Place::Nearest => capsule.tip,
            Place::NearestEnd => capsule.end,
        };
        if self.nodes[0] == self.nodes[1] {
            return Some(([1.0, 0.0, 0.0], capsule.on_axis(&x[0])));
        }
        if self.nodes[1] == self.nodes[2] {
            let (share, on_axis) = capsule.nearest_on_edge(&x[0], &x[1])?;
            return Some(([1.0 - share, share, 0.0], on_axis));
        }
        let (a, b) = (x[1] - x[0], x[2] - x[0]);
        let normal = a.cross(&b);
        let area = normal.norm_squared();
        if area == 0.0 {
            return None;
        }
        let to = end - x[0];
        let second = to.cross(&b).dot(&normal) / area;
        let third = a.cross(&to).dot(&normal) / area;
        let first = 1.0 - second - third;
        (first > 0.0 && second > 0.0 && third > 0.0).then_some(([first, second, third], end))
    }
}

/// Reused from substep to substep.
#[derive(Debug, Default)]
pub struct Scratch {
    pub(super) press: Press,
    touches: Vec<Touch>,
    /// Unit vectors along which contacts, by their places in the list, were last found apart from what they are of. Any will do.
    apart: Vec<Vec3>,
    before: Vec<Contact>,
    names: Vec<Name>,
    nodes: Vec<u32>,
    pub(super) shape: Vec<Capsule>,
    /// A node each, of old where nothing touches: velocities as the sweep has left them, or accelerations.
    swept: Vec<Lane>,
}

impl Scratch {
    pub fn new(model: &Model) -> Scratch {
        if !(0..model.scene.tools.len()).any(|k| coefficient(model, k).is_some()) {
            return Scratch::default();
        }
        let room = room(model);
        Scratch {
            press: Press::with_room(model),
            touches: Vec::with_capacity(room),
            apart: Vec::with_capacity(room),
            before: Vec::with_capacity(room),
            names: Vec::with_capacity(room),
            nodes: Vec::with_capacity(3 * room),
            shape: Vec::with_capacity(model.tools.iter().map(ToolShape::capsules).sum()),
            swept: vec![Lane::default(); model.parts.known],
        }
    }
}

/// Places there is room for without allocating.
pub fn room(model: &Model) -> usize {
    let capsules: usize = (0..model.scene.tools.len())
        .filter(|k| coefficient(model, *k).is_some())
        .map(|k| model.tools[k].capsules())
        .sum();
    capsules * (4 * model.topology.faces.len()).min(8192)
}

/// mu of a tool that slides.
pub fn coefficient(model: &Model, k: usize) -> Option<f64> {
    match model.scene.tools[k].friction {
        Friction::Stick => None,
        Friction::Coulomb(mu) => Some(mu),
    }
}

/// From the surface of tool `k`, places nearer than this are listed \[m\]: none of a tool that holds what it touches.
pub fn reach(model: &Model, k: usize, way: f64) -> f64 {
    match coefficient(model, k) {
        Some(_) => MARGIN * model.tools[k].most_radius() + way,
        None => 0.0,
    }
}

/// At a haptic tick: which places tool `k` may touch until the next, on a `way` so long \[m\].
pub fn find(
    model: &Model,
    state: &mut State,
    k: usize,
    way: f64,
    work: &mut Scratch,
    nearby: &mut Nearby,
) {
    if coefficient(model, k).is_none() {
        return;
    }
    work.before.clear();
    let tool = k as u32;
    work.before.extend(
        state
            .contacts
            .iter()
            .filter(|c| c.tool == tool && c.force != Vec3::zeros()),
    );
    state.contacts.retain(|c| c.tool != tool);
    let burns = model.scene.tools[k].kind == ToolKind::Cautery && state.tools[k].active;
    if burns {
        return;
    }
    let first = state.contacts.len();
    work.names.clear();
    nearby.refresh(model, state, k, MARGIN * model.tools[k].most_radius() + way);
    for (c, capsule) in model.tools[k].at(&state.tools[k].pose).enumerate() {
        let faces = nearby.faces(k, c);
        let names = &mut work.names;
        find_near(model, state, faces, (tool, c as u32), &capsule, way, names);
    }
    let contacts = &mut state.contacts;
    contacts[first..].sort_unstable_by(Contact::order);
    work.names.sort_unstable();
    work.names.dedup();
    contacts.extend(work.names.iter().map(|name| Contact::named(tool, *name)));
    // Equal ones of tissue without mass are side by side.
    let mut count = first;
    for at in first..contacts.len() {
        let mut contact = contacts[at];
        if count > first && contacts[count - 1].order(&contact).is_eq() {
            continue;
        }
        if let Ok(found) = work.before.binary_search_by(|c| c.order(&contact)) {
            contact.force = work.before[found].force;
            contact.velocity = work.before[found].velocity;
        }
        contacts[count] = contact;
        count += 1;
    }
    contacts.truncate(count);
}

/// Of these faces. Adds `names` of dynamic tissue, contacts of what has no mass, each as often as faces share it.
fn find_near(
    model: &Model,
    state: &mut State,
    faces: &[u32],
    (tool, c): (u32, u32),
    capsule: &Capsule,
    way: f64,
    names: &mut Vec<Name>,
) {
    let beyond = MARGIN * capsule.radius + way;
    let reach = capsule.radius + beyond;
    // What is in reach has its vertices within an edge of it.
    let known = reach + STRETCH * model.longest_edge;
    let State {
        live,
        contacts,
        displacement,
        ..
    } = state;
    let moving = model.parts.moving as u32;
    let touchable = moving + model.parts.touchable as u32;
    let mut add = |nodes, place| names.push(name(c, nodes, &place));
    for face in faces {
        let nodes = live.triangle(model, *face);
        if nodes.iter().any(|v| *v >= touchable) {
            continue;
        }
        let x = nodes.map(|v| live.rest[v as usize] + displacement[v as usize].xyz());
        if !nearby::is_near(capsule, &x, beyond)
            || x.iter().any(|x| capsule.axis_distance(x) > known)
        {
            continue;
        }
        let middle = (x[0] + x[1] + x[2]) / 3.0;
        let normal = (x[1] - x[0]).cross(&(x[2] - x[0]));
        let nearest = capsule.on_axis(&middle);
        // Only what faces the axis can be pushed away from it.
        if (nearest - middle).dot(&normal) <= 0.0 {
            continue;
        }
        let mut sorted = nodes;
        sorted.sort_unstable();
        let at = sorted.map(|v| live.rest[v as usize] + displacement[v as usize].xyz());
        if sorted[2] >= moving {
            let rest = sorted.map(|v| live.rest[v as usize]);
            press::places(&rest, capsule.radius, |weight| {
                let place = at[0] * weight[0] + at[1] * weight[1] + at[2] * weight[2];
                let inside = sorted.iter().zip(weight).filter(|(v, _)| **v >= moving);
                let is_inside = inside.map(|(_, b)| b).sum::<f64>() >= LEAST_INSIDE;
                if is_inside && capsule.axis_distance(&place) <= reach {
                    let (nodes, weight) = press::compact(sorted, weight);
                    contacts.push(Contact::new(tool, c, nodes, Place::At(weight)));
                }
            });
        }
        let above = |x: &Vec3| (x - middle).dot(&normal).abs() <= reach * normal.norm();
        if above(&capsule.tip) && sorted[2] < moving {
            add(sorted, Place::Nearest);
        }
        if capsule.tip != capsule.end && above(&capsule.end) && sorted[2] < moving {
            add(sorted, Place::NearestEnd);
        }
        let distance = at.map(|x| capsule.axis_distance(&x));
        for (a, b) in [(0, 1), (1, 2), (0, 2)] {
            let between = capsule
                .nearest_on_edge(&at[a], &at[b])
                .map(|(share, on_axis)| (at[a] + (at[b] - at[a]) * share - on_axis).norm());
            let nearest = between.unwrap_or(distance[a].min(distance[b]));
            if nearest <= reach && sorted[b] < moving {
                add([sorted[a], sorted[b], sorted[b]], Place::Nearest);
            }
        }
        for (v, distance) in sorted.into_iter().zip(distance) {
            if distance <= reach && v < moving {
                add([v; 3], Place::Nearest);
            }
        }
    }
}

/// Where tools were, and what there is of the substep.
pub struct Substep<'a> {
    pub from: &'a [Pose],
    pub residual: &'a [Lane],
    pub by: &'a Advance,
}

/// After the sweep of a substep, tools being where they end: pushes out what has entered, and rubs. Books work, friction
/// and impulse, brings the sums up to date, those of loose nodes apart, and returns the trailing half of what the
/// contacts do at this point \[J\].
pub fn push(
    model: &Model,
    state: &mut State,
    work: &mut Scratch,
    substep: &Substep,
    impulse: &mut [Vec3],
    sums: &mut [Sums; 2],
) -> f64 {
    let by = substep.by;
    touch(model, state, work, by, Some(substep.from));
    if work.touches.is_empty() {
        return 0.0;
    }
    for node in &work.nodes {
        work.swept[*node as usize] = state.velocity[*node as usize];
    }
    solve(&mut work.touches, by.substep, &mut state.velocity);
    let (lag, h) = (state.clock.lag, by.substep);
    for node in &work.nodes {
        let i = *node as usize;
        let gain = gain(state, i, by);
        let w = Vec3::from_fn(|a, _| state.inverse_mass[i].0[a] * gain);
        let (swept, v) = (work.swept[i].xyz(), state.velocity[i].xyz());
        let before = swept - w.component_mul(&substep.residual[i].xyz());
        let m = state.live.mass[i];
        let sums = &mut sums[usize::from(state.live.pieces.is_loose(i))];
        sums.kinetic += m * before.dot(&(v - swept));
        sums.damping += m * (v.dot(&(before + v)) - swept.dot(&(before + swept)));
        state.displacement[i] = (state.displacement[i].xyz() + (v - swept) * h).into();
        work.swept[i] = before.into();
    }
    let mut trailing = 0.0;
    for touch in &work.touches {
        let mean = |of: &[Lane]| -> Vec3 {
            let nodes = touch.nodes.iter().zip(touch.weight);
            nodes.map(|(i, b)| of[*i].xyz() * b).sum()
        };
        let behind = 0.5 * lag * mean(&work.swept).dot(&touch.force);
        let ahead = 0.5 * h * mean(&state.velocity).dot(&touch.force);
        let way = touch.before * (0.5 * lag) + touch.tool * (0.5 * h);
        let by_tool = way.dot(&touch.force);
        let contact = &mut state.contacts[touch.at];
        (contact.force, contact.velocity) = (touch.force, touch.tool);
        state.account.tool_work += by_tool;
        // What does not move the tissue along is friction, or a blow.
        state.account.dissipated += by_tool - behind - ahead;
        impulse[contact.tool as usize] -= touch.force * by.kick;
        trailing += behind;
    }
    trailing
}

/// Loose nodes are advanced with the damping of their own motion.
fn gain(state: &State, node: usize, by: &Advance) -> f64 {
    match state.live.pieces.is_loose(node) {
        true => by.kick,
        false => by.gain,
    }
}

/// What touches at the end of the substep, or did in the one before; without `from`, what does now.
fn touch(
    model: &Model,
    state: &mut State,
    work: &mut Scratch,
    by: &Advance,
    from: Option<&[Pose]>,
) {
    work.touches.clear();
    work.nodes.clear();
    work.apart.resize(state.contacts.len(), Vec3::zeros());
    let mut of = u32::MAX;
    for at in 0..state.contacts.len() {
        let contact = &mut state.contacts[at];
        if contact.stays() {
            continue;
        }
        let last = match from {
            Some(_) => std::mem::take(&mut contact.force),
            None => contact.force,
        };
        let is_new = last == Vec3::zeros();
        if is_new && from.is_none() {
            continue;
        }
        let (k, contact) = (contact.tool as usize, *contact);
        let pose = &state.tools[k].pose;
        if contact.tool != of {
            of = contact.tool;
            work.shape.clear();
            work.shape.extend(model.tools[k].at(pose));
        }
        let capsule = &work.shape[contact.capsule as usize];
        let nodes = contact.nodes.map(|v| v as usize);
        // The sweep has moved them on, as if nothing held them.
        let back = from.map_or(0.0, |_| by.substep);
        let stands = |i: usize| {
            let u = state.displacement[i].xyz() - state.velocity[i].xyz() * back;
            state.live.rest[i] + u
        };
        let first = stands(nodes[0]);
        let x = match nodes[0] == nodes[2] {
            true => [first; 3],
            false => [first, stands(nodes[1]), stands(nodes[2])],
        };
        if is_new && stays_apart(&work.apart[at], capsule, &x) > back * fastest(state, &nodes) {
            continue;
        }
        let Some((weight, on_axis)) = contact.weights(capsule, &x) else {
            continue;
        };
        let place = x[0] * weight[0] + x[1] * weight[1] + x[2] * weight[2];
        let away = place - on_axis;
        let distance = away.norm();
        if distance == 0.0 {
            continue;
        }
        let (gap, normal) = (distance - capsule.radius, away / distance);
        work.apart[at] = normal;
        let mean = nodes
            .iter()
            .zip(weight)
            .map(|(i, b)| state.velocity[*i].xyz() * b);
        let enters = from.is_some() && gap + back * normal.dot(&mean.sum::<Vec3>()) < 0.0;
        if !enters && is_new {
            continue;
        }
        let gain = gain(state, nodes[0], by);
        let (mut w, mut push, mut count) = (Vec3::zeros(), [Lane::default(); 3], 0);
        for (k, (i, b)) in nodes.iter().zip(weight).enumerate() {
            if b != 0.0 {
                count = k + 1;
            }
            for axis in 0..3 {
                push[k].0[axis] = gain * b * state.inverse_mass[*i].0[axis];
                w[axis] += b * push[k].0[axis];
            }
        }
        let along = normal.dot(&normal.component_mul(&w));
        if along <= 0.0 {
            // Others hold it.
            continue;
        }
        let moved = from.map(|from| place - from[k].point(&pose.local(&place)));
        let tool = moved.map_or(Vec3::zeros(), |way| way / by.substep);
        let ease = |i: &usize| normal.dot(&normal.component_mul(&state.inverse_mass[*i].xyz()));
        let eases = nodes.iter().map(ease);
        let yields = match eases.clone().fold(f64::MAX, f64::min) == 0.0 {
            true => gain * LEAST_LEVER * LEAST_LEVER * eases.fold(0.0, f64::max),
            false => 0.0,
        };
        let by_tool = moved.map_or(0.0, |way| normal.dot(&way).max(0.0));
        work.nodes.extend(contact.nodes);
        work.touches.push(Touch {
            at,
            nodes,
            weight,
            place,
            normal,
            gap: gap.max(-MOST_THROW * capsule.radius - by_tool),
            tool,
            // What has just come is struck.
            before: if is_new { tool } else { contact.velocity },
            along,
            across: w.max(),
            yields: (yields - along).max(0.0),
            friction: coefficient(model, k).unwrap_or(0.0),
            force: last,
            push,
            count,
            before_step: Vec3::zeros(),
            change: Vec3::zeros(),
            along_way: Vec3::zeros(),
        });
    }
    work.nodes.sort_unstable();
    work.nodes.dedup();
}

/// How far corners are from a capsule along a unit vector, less what rounding may add \[m\]: no point between them is nearer.
fn stays_apart(along: &Vec3, capsule: &Capsule, corners: &[Vec3; 3]) -> f64 {
    let nearest = corners
        .iter()
        .map(|x| along.dot(x))
        .fold(f64::MAX, f64::min);
    let farthest = along.dot(&capsule.tip).max(along.dot(&capsule.end));
    nearest - farthest - capsule.radius * (1.0 + 1e-9)
}

/// No node is faster \[m/s\].
fn fastest(state: &State, nodes: &[usize; 3]) -> f64 {
    let speed = |i: &usize| state.velocity[*i].xyz().abs().sum();
    nodes.iter().map(speed).fold(0.0, f64::max)
}

/// Force \[N\] and torque \[N m\] of what slides on each tool at the end of a step, without inertia: of the forces that keep
/// what touches from being accelerated. `loose` has been measured. Adds them.
pub fn read_forces(model: &Model, state: &mut State, loose: &loose::Scratch, work: &mut Scratch) {
    let by = Advance::symplectic_euler(1.0, 1.0, 0.0);
    touch(model, state, work, &by, None);
    for node in &work.nodes {
        let i = *node as usize;
        let r = hold::residual(model, state, loose, i);
        let a = Vec3::from_fn(|axis, _| r[axis] * state.inverse_mass[i].0[axis]);
        work.swept[i] = a.into();
    }
    for touch in &mut work.touches {
        touch.gap = 0.0;
    }
    solve(&mut work.touches, 1.0, &mut work.swept);
    for touch in &work.touches {
        let tool = &mut state.tools[state.contacts[touch.at].tool as usize];
        tool.force -= touch.force;
        tool.torque -= (touch.place - tool.pose.position).cross(&touch.force);
        tool.in_contact = true;
    }
    press::read_forces(state);
}
