//! Tearing: dynamic tetrahedra that are stretched past a threshold go, the most stretched first.
//!
//! What is compared with the threshold (Cotin, Delingette, Ayache 1998, section 5.5), r an edge's rest
//! vector from a to b, w = u_b - u_a:
//!
//! |  | linear law | springs, non-linear laws |
//! |---|---|---|
//! | relative change of volume | tr eps | det F - 1 |
//! | relative elongation of an edge | r . eps r / r² = r . w / r² | (l - l_0)/l_0 |
//!
//! and of the six edges the mean or the largest. *Different*: for the linear law the strain, not the true
//! change of volume or length, which a rotation feigns: u = omega x X swells but has eps = 0. Compression
//! does not tear.
//!
//! Not every tetrahedron is looked at on every tick. A measure that changes by no more than L times the
//! way of any of its vertices cannot reach the threshold before they have gone far enough:
//! L = sum_j |a_j| for tr eps, 2/|r| for an edge; and det(F + H) - det F <= H (|cof F| + H |F| + H²) for
//! H = sum_j |a_j| times the way. What is found is the same to the bit.

use crate::cut;
use crate::element::constant_strain::Shape;
use crate::loose;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::spring_mass::EDGES;
use crate::model::tensor_mass::Lane;
use crate::scene::TearCriterion;
use crate::state::State;

/// Tetrahedra that are looked at together.
const BLOCK: usize = 64;
/// Nodes whose ways are known as one, the longest.
const CHUNK: usize = 64;
/// Largest H that is looked ahead to.
const FARTHEST: f64 = 0.1;
/// Far above the relative round-off of a measure and of a way.
const ROUND_OFF: f64 = 1e-9;

/// What the scene's criterion says of tetrahedron `t`, displaced by `u` as its law sees it \[1\].
pub fn measure(model: &Model, t: usize, u: &[Vec3; 4]) -> f64 {
    let Some(tearing) = &model.scene.tearing else {
        return f64::NEG_INFINITY;
    };
    let springs = !model.is_quadratic();
    if tearing.criterion == TearCriterion::Volume {
        let shape = &model.shape[t];
        return if springs {
            shape.deformation_gradient(u).determinant() - 1.0
        } else {
            // The a_j sum to zero: differences, so that a far way fallen cancels.
            (1..4)
                .map(|j| shape.gradient[j].dot(&(u[j] - u[0])))
                .sum::<f64>()
        };
    }
    let rest = model.rest_positions(t);
    let (mut part, mut whole) = ([0.0; 6], [0.0; 6]);
    for (k, (a, b)) in EDGES.into_iter().enumerate() {
        let (r, w) = (rest[b] - rest[a], u[b] - u[a]);
        let square = r.norm_squared();
        (part[k], whole[k]) = if springs {
            // l² - l_0² = q, so that nothing cancels.
            let q = w.dot(&(r + r + w));
            (q, square + (square * (square + q).max(0.0)).sqrt())
        } else {
            (r.dot(&w), square)
        };
    }
    let elongation: [f64; 6] = std::array::from_fn(|k| part[k] / whole[k]);
    match tearing.criterion {
        TearCriterion::MeanElongation => elongation.iter().sum::<f64>() / 6.0,
        _ => elongation[1..]
            .iter()
            .fold(elongation[0], |a, e| if *e > a { *e } else { a }),
    }
}

/// The displacements that [`measure`] is asked about: of a loose piece in its frame, `loose` having located it.
pub fn displacements(state: &State, loose: &loose::Scratch, t: usize) -> [Vec3; 4] {
    let nodes = state.live.tetrahedra[t];
    if turns(state, nodes[0]) {
        return nodes.map(|v| loose.local(v));
    }
    nodes.map(|v| state.displacement[v as usize].xyz())
}

/// Whether a node's displacement is another in its frame.
fn turns(state: &State, node: u32) -> bool {
    !state.live.is_objective() && state.live.pieces.is_loose(node as usize)
}

/// Whether the way of its vertices is known: not in a turning frame, nor where one has been split.
fn is_followed(model: &Model, state: &State, t: u32) -> bool {
    let nodes = state.live.tetrahedra[t as usize];
    nodes == model.mesh.tetrahedra[t as usize] && !turns(state, nodes[0])
}

/// Live dynamic tetrahedra past the threshold and their measures, by looking at all of them.
pub fn past_threshold(model: &Model, state: &State) -> Vec<(f64, u32)> {
    let mut loose = loose::Scratch::new(model);
    loose.locate(state);
    let threshold = state.parameters.tearing_threshold;
    (0..model.shape.len())
        .filter(|t| model.parts.dynamic[*t] && state.live.alive[*t])
        .map(|t| {
            let u = displacements(state, &loose, t);
            (measure(model, t, &u), t as u32)
        })
        .filter(|(measure, _)| *measure > threshold)
        .collect()
}

/// At a haptic tick: removes what is past the threshold, `budget` tetrahedra at most.
pub fn tear(
    model: &Model,
    state: &mut State,
    tears: &mut Tears,
    scratch: &mut cut::Scratch,
    loose: &mut loose::Scratch,
) {
    if model.scene.tearing.is_none() {
        return;
    }
    loose.locate(state);
    let list = tears.find(model, state, loose);
    if !list.is_empty() {
        cut::event(model, state, scratch, loose, list);
    }
}

/// Tetrahedra that are near each other in the node order, and how far they are from tearing.
#[derive(Clone, Copy, Debug)]
struct Block {
    /// First and last chunk of nodes that they use.
    chunks: [u32; 2],
    /// How far their nodes may still go before one of them can tear \[m\].
    room: f64,
}

/// Finds what tears. No part of the state: whatever it has seen before, it finds the same.
#[derive(Debug, Default)]
pub struct Tears {
    /// Of the displacements seen last, a moving node each \[m\].
    seen: Vec<Lane>,
    /// No shorter than any way since then in each chunk of them \[m\]: of the longest along each axis.
    way: Vec<f64>,
    /// Dynamic tetrahedra, by their lowest node; [`BLOCK`] of them a block.
    tetrahedra: Vec<u32>,
    /// 1/L a tetrahedron, in the same order \[m\].
    reach: Vec<f64>,
    blocks: Vec<Block>,
    /// That the rooms are of: threshold, and state of the mesh.
    threshold: f64,
    revision: u64,
    found: Vec<(f64, u32)>,
    list: Vec<u32>,
    /// Tetrahedra looked at so far.
    pub looked_at: u64,
}

impl Tears {
    /// Empty where nothing can tear.
    pub fn new(model: &Model) -> Tears {
        if model.scene.tearing.is_none() {
            return Tears::default();
        }
        let lowest = |t: u32| model.mesh.tetrahedra[t as usize].iter().min().copied();
        let mut tetrahedra: Vec<u32> = (0..model.shape.len() as u32)
            .filter(|t| model.parts.dynamic[*t as usize])
            .collect();
        tetrahedra.sort_by_key(|t| lowest(*t));
        let block = |list: &[u32]| {
            let nodes = || list.iter().flat_map(|t| model.mesh.tetrahedra[*t as usize]);
            let chunk = |node: Option<u32>| node.unwrap_or(0) / CHUNK as u32;
            Block {
                chunks: [chunk(nodes().min()), chunk(nodes().max())],
                room: 0.0,
            }
        };
        Tears {
            seen: vec![Lane::default(); model.parts.moving],
            way: vec![0.0; model.parts.moving.div_ceil(CHUNK)],
            blocks: tetrahedra.chunks(BLOCK).map(block).collect(),
            reach: (tetrahedra.iter().map(|t| 1.0 / slope(model, *t as usize))).collect(),
            threshold: f64::NAN,
            revision: 0,
            found: Vec::with_capacity(tetrahedra.len()),
            list: Vec::with_capacity(tetrahedra.len()),
            tetrahedra,
            looked_at: 0,
        }
    }

    /// After the state has been replaced: tetrahedra may be back that were gone when their block was
    /// looked at.
    pub fn forget(&mut self) {
        self.threshold = f64::NAN;
    }

    /// What tears now, the largest measure first, of equal ones the lowest number first.
    pub fn find(&mut self, model: &Model, state: &State, loose: &loose::Scratch) -> &[u32] {
        self.list.clear();
        let Some(tearing) = &model.scene.tearing else {
            return &self.list;
        };
        self.go_on(model, state);
        let threshold = state.parameters.tearing_threshold;
        self.found.clear();
        let nearly = threshold - ROUND_OFF * threshold.max(1.0);
        let lists = self.tetrahedra.chunks(BLOCK).zip(self.reach.chunks(BLOCK));
        for (block, (tetrahedra, reach)) in self.blocks.iter_mut().zip(lists) {
            if block.room > 0.0 {
                continue;
            }
            block.room = f64::INFINITY;
            for (t, reach) in tetrahedra.iter().zip(reach) {
                if !state.live.alive[*t as usize] {
                    continue;
                }
                let u = displacements(state, loose, *t as usize);
                let measure = measure(model, *t as usize, &u);
                if measure > threshold {
                    self.found.push((measure, *t));
                }
                let allowed = allowed(model, *t as usize, &u, nearly - measure);
                let reach = if is_followed(model, state, *t) {
                    *reach
                } else {
                    0.0
                };
                block.room = block.room.min(reach * allowed);
            }
            self.looked_at += tetrahedra.len() as u64;
        }
        self.found
            .sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let count = self.found.len().min(tearing.budget);
        self.list
            .extend(self.found[..count].iter().map(|(_, t)| *t));
        &self.list
    }

    /// Takes from each block's room what the way of its nodes since the last tick may have used of it.
    fn go_on(&mut self, model: &Model, state: &State) {
        let now = state.displacement[..self.seen.len()].chunks(CHUNK);
        for ((now, seen), way) in now.zip(self.seen.chunks_mut(CHUNK)).zip(&mut self.way) {
            let mut square = [0.0; 4];
            for (now, seen) in now.iter().zip(seen) {
                for axis in 0..4 {
                    let d = now.0[axis] - seen.0[axis];
                    square[axis] = if d * d > square[axis] {
                        d * d
                    } else {
                        square[axis]
                    };
                }
                *seen = *now;
            }
            *way = (1.0 + ROUND_OFF) * (square[0] + square[1] + square[2]).sqrt();
        }
        // Reaches are below the longest edge, and taking a way from one errs by half of this.
        let round_off = f64::EPSILON * model.longest_edge;
        let all = self.threshold != state.parameters.tearing_threshold;
        let cut = self.revision != state.live.revision;
        self.revision = state.live.revision;
        let other = |t: &u32| !is_followed(model, state, *t);
        let others = !state.live.pieces.loose_nodes().is_empty() || !state.live.splits.is_empty();
        self.threshold = state.parameters.tearing_threshold;
        for (block, tetrahedra) in self.blocks.iter_mut().zip(self.tetrahedra.chunks(BLOCK)) {
            let [first, last] = block.chunks.map(|c| c as usize);
            let way = self.way[first..=last]
                .iter()
                .fold(0.0, |a, w| if *w > a { *w } else { a });
            block.room -= way + round_off;
            // A cut may have set loose or split what the room was of.
            if all || (cut && others && tetrahedra.iter().any(other)) {
                block.room = 0.0;
            }
        }
    }
}

/// L of a measure that is linear in the displacements, or in the edges' lengths \[1/m\].
fn slope(model: &Model, t: usize) -> f64 {
    let rest = model.rest_positions(t);
    let edges = EDGES.map(|(a, b)| 2.0 / (rest[b] - rest[a]).norm());
    match model.scene.tearing.as_ref().map(|t| t.criterion) {
        Some(TearCriterion::Volume) => sum_of_gradients(&model.shape[t]),
        Some(TearCriterion::MeanElongation) => edges.iter().sum::<f64>() / 6.0,
        _ => edges.iter().fold(0.0, |a, e| a.max(*e)),
    }
}

fn sum_of_gradients(shape: &Shape) -> f64 {
    shape.gradient.iter().map(|a| a.norm()).sum()
}

/// How far, in units of 1/[`slope`], the vertices may go before the measure has grown by `growth`.
fn allowed(model: &Model, t: usize, u: &[Vec3; 4], growth: f64) -> f64 {
    let criterion = model.scene.tearing.as_ref().map(|t| t.criterion);
    let springs = !model.is_quadratic();
    if !springs || criterion != Some(TearCriterion::Volume) {
        return growth.min(1.0);
    }
    let f = model.shape[t].deformation_gradient(u);
    let cofactor = |j: usize| f.column((j + 1) % 3).cross(&f.column((j + 2) % 3));
    let cofactors = (0..3)
        .map(|j| cofactor(j).norm_squared())
        .sum::<f64>()
        .sqrt();
    let steepness = cofactors + FARTHEST * (f.norm() + FARTHEST);
    (growth / steepness).min(FARTHEST)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::parse;

    /// The largest growth found, as a share of what is allowed for, stays below 1 and comes near it.
    #[test]
    fn measures_grow_no_faster_than_is_said() {
        for (kind, criterion, near) in [
            ("tensorMass", "volume", 0.99),
            ("tensorMass", "meanElongation", 0.2),
            ("tensorMass", "maximumElongation", 0.99),
            ("springMass", "volume", 0.5),
            ("springMass", "meanElongation", 0.2),
            ("springMass", "maximumElongation", 0.95),
        ] {
            let text = format!(
                r#"{{"name": "one", "mesh": {{"nodes": [[0, 0, 0], [1, 0, 0.1], [0.1, 1.2, 0], [0.2, 0.3, 0.8]], "tetrahedra": [[0, 1, 2, 3]]}},
                "materials": [{{"where": {{"all": true}}, "youngModulus": 1, "poissonRatio": 0, "density": 1}}],
                "fixed": [{{"nodes": [0, 1, 2]}}], "model": {{"kind": "{kind}"}},
                "tearing": {{"criterion": "{criterion}", "threshold": 1}}}}"#
            );
            let scene = parse(&text, "one").unwrap();
            let model = crate::prepared::prepare(scene, std::path::Path::new(".")).unwrap();
            let mut seed = 1u64;
            let mut random = move || {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (seed >> 33) as f64 / f64::from(1u32 << 30) - 1.0
            };
            let mut most = 0.0f64;
            for k in 0..300 {
                // From slightly displaced to far beyond.
                let size = [0.01, 0.3, 2.0][k % 3];
                let mut u = [Vec3::zeros(); 4].map(|v| v.map(|_| size * random()));
                let (before, growth) = (measure(&model, 0, &u), 0.3 * (1.0 + random()));
                let way = allowed(&model, 0, &u, growth) / slope(&model, 0);
                // Steepest ascent, in steps.
                for _ in 0..20 {
                    let at = u;
                    for (j, u_j) in u.iter_mut().enumerate() {
                        let slope = Vec3::from_fn(|axis, _| {
                            let (mut up, mut down) = (at, at);
                            up[j][axis] += 1e-6;
                            down[j][axis] -= 1e-6;
                            measure(&model, 0, &up) - measure(&model, 0, &down)
                        });
                        *u_j += slope.try_normalize(1e-12).unwrap_or_default() * (way / 20.0);
                    }
                }
                most = most.max((measure(&model, 0, &u) - before) / growth);
            }
            println!("{kind} {criterion}: {most}");
            assert!(
                most <= 1.0 + 1e-6 && most > near,
                "{kind} {criterion}: {most}"
            );
        }
    }
}
