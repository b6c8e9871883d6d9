//! Faces of the surface that a tool may touch before long: looked for when tool and tissue have moved so far that there may be
//! others, as neighbours of molecules are (Verlet 1967). Only what is found is looked at in each haptic period.

use super::geometry::Capsule;
use super::shape::ToolShape;
use crate::lanes::most_moved;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::tensor_mass::Lane;
use crate::pose::Pose;
use crate::state::State;

/// How far they are looked for beyond what is in reach, in rest lengths of the longest edge.
const SLACK: f64 = 0.5;

/// Of all tools. Whatever it holds, results are the same.
#[derive(Debug, Default)]
pub struct Nearby {
    tools: Vec<Listed>,
    /// u \[m\] at some time, in which mesh, and how far any node was from there at which substep.
    seen: Vec<Lane>,
    revision: u64,
    moved: f64,
    at: Option<u64>,
}

/// Of one tool.
#[derive(Debug, Default)]
struct Listed {
    faces: Vec<u32>,
    /// Of each capsule, where its faces end.
    ends: Vec<usize>,
    /// Where the tool was when they were looked for, how far away \[m\], and [`Nearby::moved`] then. No tool: nothing is known.
    pose: Option<Pose>,
    slack: f64,
    moved: f64,
}

impl Nearby {
    pub fn with_room(model: &Model) -> Nearby {
        let one = |tool: &ToolShape| Listed {
            faces: Vec::with_capacity(tool.capsules() * model.topology.faces.len()),
            ends: Vec::with_capacity(tool.capsules()),
            ..Listed::default()
        };
        Nearby {
            tools: model.tools.iter().map(one).collect(),
            seen: vec![Lane::default(); model.parts.known],
            ..Nearby::default()
        }
    }

    /// Nothing is known any more.
    pub fn forget(&mut self) {
        self.at = None;
        self.tools.iter_mut().for_each(|tool| tool.pose = None);
    }

    /// Brings up to date which faces come nearer to a capsule of tool `k` than `reach`, and maybe others.
    pub fn refresh(&mut self, model: &Model, state: &State, k: usize, reach: f64) {
        let (shape, pose) = (&model.tools[k], &state.tools[k].pose);
        let more = SLACK * model.longest_edge;
        self.look(model, state, more);
        let (tool, moved) = (&mut self.tools[k], self.moved);
        if let Some(seen) = &tool.pose {
            // A face's middle goes as far as its corners, its size changes by twice that.
            let need = 3.0 * (tool.moved + moved) + shape.way(seen, pose) + reach;
            if need <= tool.slack && tool.slack <= reach + 2.0 * more {
                return;
            }
        }
        let reachable = (model.parts.moving + model.parts.touchable) as u32;
        tool.slack = reach + more;
        (tool.pose, tool.moved) = (Some(*pose), moved);
        tool.faces.clear();
        tool.ends.clear();
        for capsule in shape.at(pose) {
            // Where vertices are that nothing can touch may not be known.
            let near = |face: &&u32| {
                let nodes = state.live.triangle(model, **face);
                nodes.iter().all(|v| *v < reachable)
                    && is_near(&capsule, &corners(state, &nodes), tool.slack)
            };
            tool.faces.extend(state.live.surface.iter().filter(near));
            tool.ends.push(tool.faces.len());
        }
    }

    /// How far nodes have moved.
    fn look(&mut self, model: &Model, state: &State, more: f64) {
        let now = state.clock.total;
        let same = self.revision == state.live.revision;
        // What is pre-computed may jump at any time.
        if same && self.at == Some(now) && model.parts.touchable == 0 {
            return;
        }
        let u = &state.displacement[..self.seen.len()];
        let known = same && self.at.is_some();
        self.moved = match known {
            true => most_moved(&self.seen, u),
            false => f64::INFINITY,
        };
        self.at = Some(now);
        if self.moved > more / 8.0 {
            self.forget();
            self.seen.copy_from_slice(u);
            (self.revision, self.moved, self.at) = (state.live.revision, 0.0, Some(now));
        }
    }

    /// Of any capsule of tool `k`, maybe several times.
    pub fn all(&self, k: usize) -> &[u32] {
        &self.tools[k].faces
    }

    /// Of a capsule of tool `k`.
    pub fn faces(&self, k: usize, capsule: usize) -> &[u32] {
        let tool = &self.tools[k];
        let start = capsule.checked_sub(1).map_or(0, |last| tool.ends[last]);
        &tool.faces[start..tool.ends[capsule]]
    }
}

/// Where nodes are.
fn corners(state: &State, nodes: &[u32; 3]) -> [Vec3; 3] {
    nodes.map(|v| state.live.rest[v as usize] + state.displacement[v as usize].xyz())
}

/// Whether a capsule comes within `reach` \[m\] of the smallest ball about the corners' mean that holds them.
pub fn is_near(capsule: &Capsule, corners: &[Vec3; 3], reach: f64) -> bool {
    let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
    let each = corners.iter().map(|x| (x - middle).norm_squared());
    let size = each.fold(0.0, f64::max).sqrt();
    capsule.axis_distance(&middle) <= capsule.radius + reach + size
}
