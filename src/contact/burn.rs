//! Cautery: an active tip burns its way through tissue, no faster than it travels.
//!
//! At each haptic tick the live dynamic tetrahedra that the tip touches anywhere on its way since the
//! last tick are burnt, the nearest to its axis first, as long as its allowance \[m³\] is above 0. Each takes
//! its rest volume from the allowance, which may so fall below 0 and is paid back. A way s adds to it
//!
//! 2 (r + e) (L + 2 (r + e)) s,
//!
//! r the tip's radius, L its active length, e the mesh's mean edge: what a blade of that area, and as thick as
//! whole tetrahedra make it, sweeps. So what is burnt depends on the way, not on how many ticks it takes, and
//! a tip that stands still burns no further. What is left over when tissue has been thin is kept up to a
//! way of r + e. When the current comes on, all that the tip touches burns at once.
//!
//! s is the longer of the ways of the two ends of the active axis, less the mean motion of the tissue
//! touched: tissue that is drawn over a hook is cut, too.

use super::geometry::{Capsule, boxes_meet};
use super::shape::ToolShape;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::state::State;

/// Samples of a way lie no further apart than this, in radii: what the tip touches between two of them by
/// more than 3 % of its radius it touches at one of them.
const SPACING: f64 = 0.5;
/// Of one way; a longer one, of 128 radii a tick, has wider gaps.
const MOST_SAMPLES: f64 = 256.0;

/// Lists, reused from tick to tick.
#[derive(Debug)]
pub struct Scratch {
    path: Vec<Capsule>,
    near: Vec<u32>,
    /// With the distance of its centroid from the axis \[m\].
    touched: Vec<(f64, u32)>,
    burnt: Vec<u32>,
}

impl Scratch {
    pub fn new(model: &Model) -> Scratch {
        let count = model.mesh.tetrahedra.len();
        let capsules = model.tools.iter().map(ToolShape::capsules).max();
        let capsules = capsules.unwrap_or(0);
        Scratch {
            path: Vec::with_capacity(MOST_SAMPLES as usize * capsules),
            near: Vec::with_capacity(4 * count),
            touched: Vec::with_capacity(count),
            burnt: Vec::with_capacity(count),
        }
    }

    /// Found last.
    pub fn burnt(&self) -> &[u32] {
        &self.burnt
    }
}

/// Finds what the active tip of cautery `k` burns at a haptic tick, `seconds` after the last.
pub fn burn(model: &Model, state: &mut State, k: usize, seconds: f64, work: &mut Scratch) {
    let shape = &model.tools[k];
    let pose = state.tools[k].pose;
    let last = state.tools[k].burned.replace(pose);
    let from = last.unwrap_or(pose);
    let ways = || shape.active_at(&from).zip(shape.active_at(&pose));
    let samples = ways()
        .map(|(start, end)| way(&start, &end, &Vec3::zeros()) / (SPACING * end.radius))
        .fold(1.0f64, |most, count| most.max(count.ceil()))
        .min(MOST_SAMPLES);
    work.path.clear();
    for n in 1..=samples as u32 {
        let pose = from.towards(&pose, f64::from(n) / samples);
        work.path.extend(shape.active_at(&pose));
    }
    find(model, state, work);

    let mut allowance = f64::INFINITY;
    if last.is_some() {
        let motion = mean_motion(state, seconds, &work.touched);
        let (mut most, mut more) = (0.0, 0.0);
        for (start, end) in ways() {
            let length = (end.end - end.tip).norm();
            let half = end.radius + model.mean_edge;
            let area = 2.0 * half * (length + 2.0 * half);
            most += area * half;
            more += area * way(&start, &end, &motion);
        }
        allowance = state.tools[k].allowance.min(most) + more;
    }
    work.burnt.clear();
    for (_, t) in &work.touched {
        if allowance <= 0.0 {
            break;
        }
        allowance -= model.shape[*t as usize].volume;
        work.burnt.push(*t);
    }
    state.tools[k].allowance = if last.is_some() { allowance } else { 0.0 };
}

/// Of a cautery whose current is off.
pub fn cool(state: &mut State, k: usize) {
    state.tools[k].burned = None;
    state.tools[k].allowance = 0.0;
}

/// The longer of the ways of the two ends of an axis relative to what moves by `motion` \[m\].
fn way(from: &Capsule, to: &Capsule, motion: &Vec3) -> f64 {
    let (tip, end) = (to.tip - from.tip - motion, to.end - from.end - motion);
    tip.norm().max(end.norm())
}

/// Of the tissue touched, in `seconds` \[m\].
fn mean_motion(state: &State, seconds: f64, touched: &[(f64, u32)]) -> Vec3 {
    let nodes = |t: u32| state.live.tetrahedra[t as usize].iter();
    let velocity = |node: &u32| state.velocity[*node as usize].xyz();
    let sum: Vec3 = (touched.iter())
        .flat_map(|(_, t)| nodes(*t).map(velocity))
        .sum();
    sum * (seconds / (4 * touched.len()).max(1) as f64)
}

/// What can burn and is touched along `work.path`, the nearest to the axis first, then the lowest number.
fn find(model: &Model, state: &State, work: &mut Scratch) {
    // A touched tetrahedron has all its vertices within its longest edge of the capsule; twice the
    // longest rest edge leaves room for stretch.
    let reach = 2.0 * model.longest_edge;
    let (mut low, mut high) = (Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY));
    for capsule in &work.path {
        let (from, to) = capsule.bounds(reach);
        (low, high) = (low.inf(&from), high.sup(&to));
    }
    work.near.clear();
    for node in (0..model.parts.moving).filter(|i| state.live.star_count[*i] > 0) {
        let at = state.position(node as u32);
        let in_box = (0..3).all(|axis| low[axis] <= at[axis] && at[axis] <= high[axis]);
        let is_near = |c: &Capsule| c.axis_distance(&at) <= c.radius + reach;
        if in_box && work.path.iter().any(is_near) {
            let can_burn = |t: &u32| model.parts.dynamic[*t as usize];
            let star = state.live.star(model, node as u32);
            work.near.extend(star.filter(can_burn));
        }
    }
    work.near.sort_unstable();
    work.near.dedup();
    work.touched.clear();
    for t in &work.near {
        let corners = state.live.tetrahedra[*t as usize].map(|v| state.position(v));
        let touches = |c: &Capsule| {
            let (low, high) = c.bounds(0.0);
            boxes_meet(&corners, &low, &high)
                && c.may_touch(&corners)
                && c.touches_tetrahedron(&corners)
        };
        if work.path.iter().any(touches) {
            let middle = corners.iter().sum::<Vec3>() / 4.0;
            let distances = work.path.iter().map(|c| c.axis_distance(&middle));
            work.touched
                .push((distances.fold(f64::INFINITY, f64::min), *t));
        }
    }
    (work.touched).sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
}
