//! Cutting: tetrahedra go, and the account books what goes with them.

use crate::contact::geometry::boxes_meet;
use crate::contact::hold::{self, Held, Released};
use crate::loose;
use crate::model::Model;
use crate::pieces::Search;
use crate::star::{Repair, Worklist};
use crate::state::State;

/// Reused from cut to cut.
#[derive(Debug, Default)]
pub struct Scratch {
    worklist: Worklist,
    lost: Vec<u32>,
    search: Search,
    /// Of what has been removed.
    nodes: Vec<u32>,
    /// A vertex has had to be split when no spare was left.
    pub lacks_spares: bool,
}

impl Scratch {
    pub fn new(model: &Model) -> Scratch {
        let mut scratch = Scratch::default();
        if model.can_be_cut() {
            scratch.worklist.reserve(model);
            scratch.lost.reserve(model.mesh.tetrahedra.len());
            scratch.search = Search::new(model);
            let spares = model.parts.spares;
            (scratch.nodes).reserve(4 * model.mesh.tetrahedra.len() + 2 * spares);
        }
        scratch
    }
}

/// Removes tetrahedra at a substep boundary, then what hangs by a vertex or an edge alone (the star rule), and
/// brings all that depends on them up to date.
pub fn event(
    model: &Model,
    state: &mut State,
    scratch: &mut Scratch,
    loose: &mut loose::Scratch,
    chosen: &[u32],
) {
    let first = state.live.removed.len();
    let before = loose.before(model, state, chosen);
    let splits = state.live.splits.len();
    let spares = state.live.pattern(model).first;
    let mut severs = false;
    for t in chosen {
        severs |= remove(model, state, &mut scratch.worklist, *t);
    }
    if severs {
        let cut = state.live.removed.len();
        let Scratch {
            worklist,
            lost,
            lacks_spares,
            ..
        } = scratch;
        while let Some(repair) = worklist.next(model, &state.live, lost) {
            let new = match repair {
                Repair::Split(node) => split(model, state, worklist, node, lost),
                Repair::Lose => None,
            };
            *lacks_spares |= new.is_none() && repair != Repair::Lose;
            if new.is_none() {
                for t in lost.iter() {
                    remove(model, state, worklist, *t);
                }
            }
        }
        state.live.cleaned += state.live.removed.len() - cut;
        for t in &state.live.removed[cut..] {
            state.live.cleaned_volume += model.shape[*t as usize].volume;
        }
    }
    scratch.nodes.clear();
    scratch.nodes.extend(state.live.split_nodes(splits));
    let opened = state.live.pattern(model).first..spares;
    (scratch.nodes).extend(opened.clone().map(|new| new as u32));
    settle(model, state, first, &mut scratch.nodes);
    (state.live).find_pieces(model, first, severs, &mut scratch.search);
    for at in first..state.live.removed.len() {
        for node in state.live.tetrahedra[state.live.removed[at] as usize] {
            state.refresh_node(model, node as usize);
            state.refresh_external(model, node as usize);
        }
    }
    for new in opened {
        let origin = state.live.origin[new] as usize;
        for t in model.topology.star(origin) {
            // Beside connection nodes there is pre-computed tissue.
            let nodes = state.live.tetrahedra[*t as usize];
            for node in nodes.map(|v| v as usize) {
                if node < model.parts.moving {
                    state.refresh_node(model, node);
                    state.refresh_external(model, node);
                }
            }
        }
    }
    state.account.dissipated -= loose.gained(model, state, before, &scratch.search.changed);
}

/// Brings forces up to date after removals, those from the `first` on, and books what points of elements lose, those of
/// the given `nodes` that have been split or made among them. Nodes of which nothing is left are at rest and let go.
fn settle(model: &Model, state: &mut State, first: usize, nodes: &mut Vec<u32>) {
    for t in &state.live.removed[first..] {
        nodes.extend_from_slice(&state.live.tetrahedra[*t as usize]);
    }
    nodes.sort_unstable();
    nodes.dedup();
    let share = |state: &State| (state.live).share(nodes, &state.displacement, &state.velocity);
    let before = share(state);
    state.live.settle(model);
    let after = share(state);
    let half = 0.5 * state.clock.lag;
    state.account.dissipated += before.0 - after.0 - half * (before.1 - after.1);
    for node in nodes.iter() {
        let i = *node as usize;
        if state.live.star_count[i] == 0 {
            state.velocity[i] = Default::default();
            hold::release(model, state, |held| held.node as usize == i);
        }
    }
}

/// Splits a node for some tetrahedra of its star. Nothing moves; what holds it holds both. None where no spare is left.
fn split(
    model: &Model,
    state: &mut State,
    worklist: &mut Worklist,
    node: u32,
    moved: &[u32],
) -> Option<u32> {
    let new = state.live.split(model, node, moved)?;
    worklist.note_split(node, new);
    let (i, from) = (new as usize, node as usize);
    state.displacement[i] = state.displacement[from];
    state.velocity[i] = state.velocity[from];
    for at in (0..state.held.len()).rev() {
        let held = state.held[at];
        if held.node == node {
            state.held.insert(at + 1, Held { node: new, ..held });
        }
    }
    for at in (0..state.released.len()).rev() {
        let released = state.released[at];
        if released.node == node {
            state.released.push(Released {
                node: new,
                ..released
            });
        }
    }
    for node in [from, i] {
        state.refresh_node(model, node);
        state.refresh_external(model, node);
    }
    Some(new)
}

/// Removes one tetrahedron. Its elastic energy, the kinetic and potential energy
/// of the mass that goes with it, and what its force lacks in the half-step account, count as
/// dissipated, so that the balance is the same before and after to round-off. Whether a star has split.
fn remove(model: &Model, state: &mut State, worklist: &mut Worklist, t: u32) -> bool {
    if !state.live.alive[t as usize] {
        return false;
    }
    let nodes = state.live.tetrahedra[t as usize].map(|v| v as usize);
    let u = nodes.map(|i| state.displacement[i].xyz());
    let v = nodes.map(|i| state.velocity[i].xyz());
    let (internal, elastic) = model.tetrahedron_force(&state.live, t as usize, &u);
    let mass = nodes.map(|i| state.live.mass[i]);
    let external = nodes.map(|i| state.external[i].xyz());
    state.live.remove(model, t);
    let h = state.clock.lag;
    let is_loose = state.live.pieces.is_loose(nodes[0]);
    let c = match is_loose {
        false => model.lagging_damping(state.parameters.damping),
        true => 0.0,
    };
    let mut lost = 0.0;
    for k in 0..4 {
        let i = nodes[k];
        state.refresh_external(model, i);
        let mass_gone = mass[k] - state.live.mass[i];
        let external_gone = external[k] - state.external[i].xyz();
        let force_gained = internal[k] + v[k] * (c * mass_gone) - external_gone;
        lost += elastic[k] + 0.5 * mass_gone * v[k].norm_squared()
            - 0.5 * h * v[k].dot(&force_gained)
            - external_gone.dot(&u[k]);
    }
    // The frame of a loose piece changes: what it loses is found afterwards.
    if !is_loose || state.live.is_objective() {
        state.account.dissipated += lost;
    }
    worklist.note(model, &state.live, t)
}

/// Whether the active tip of cautery `k` touches pre-computed tissue, which cannot be cut.
pub fn spares(model: &Model, state: &State, k: usize) -> bool {
    if model.parts.touchable == 0 {
        return false;
    }
    let shape = model.tools[k].active_at(&state.tools[k].pose);
    state.live.surface.iter().any(|face| {
        let vertices = state.live.triangle(model, *face);
        let [first, second] = model.topology.faces[*face as usize].tetrahedra;
        let owner = if state.live.alive[first as usize] {
            first
        } else {
            second
        };
        if model.parts.dynamic[owner as usize] {
            return false;
        }
        let corners = vertices.map(|v| state.position(v));
        shape.clone().any(|capsule| {
            let (low, high) = capsule.bounds(0.0);
            boxes_meet(&corners, &low, &high) && capsule.touches(&corners)
        })
    })
}
