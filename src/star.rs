//! The star rule: what a cut leaves hangs together by faces.
//!
//! A vertex (an edge) is good if its live star is connected through live faces that contain it. A star that has
//! split keeps its component of the largest rest volume (ties: the one with the lowest tetrahedron) and loses the
//! others; that may split other stars, so a worklist goes on until all are good.
//!
//! Where a tetrahedron goes, stars split only if an edge star does: two of its neighbours that share an
//! edge with it stay linked round that edge, or that edge's star falls in two. So six walks round edges tell
//! whether there is anything to do, and also whether a piece of tissue can have come apart.
//!
//! With `"rule": "duplicate"` a vertex star loses nothing: each further component gets a vertex of its own, as long as
//! there are spares. An edge whose star has split while those of its ends have not is still repaired
//! by losing.
//!
//! What is pre-computed cannot go: where a star holds any, the components with some of it stay, and if none of
//! those has a dynamic tetrahedron (the two parts share but vertices), the largest dynamic one, too.

use crate::live::LiveMesh;
use crate::mesh::topology::{EDGES, NONE};
use crate::model::Model;

/// Volumes closer to each other than this, relatively, are equal: on regular meshes round-off shall not decide.
const TIE: f64 = 1e-9;

/// What a star that is not good needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repair {
    /// Tetrahedra go.
    Lose,
    /// They get a vertex of their own in place of this one.
    Split(u32),
}

/// Stars still to be looked at. Scratch, reused from cut to cut.
#[derive(Clone, Debug, Default)]
pub struct Worklist {
    vertices: Queue<u32>,
    /// Ends, and the edge that they belonged to before any split.
    edges: Queue<([u32; 2], u32)>,
    /// The star in hand: its live tetrahedra, the component of each, and room to walk.
    star: Vec<u32>,
    component: Vec<u32>,
    stack: Vec<u32>,
    /// A tetrahedron each: its place in the star in hand, or [`NONE`].
    place: Vec<u32>,
    /// Volume of each component, and whether it must stay.
    volume: Vec<f64>,
    stays: Vec<bool>,
}

/// First in, first out; never gives its room back.
#[derive(Clone, Debug)]
struct Queue<T> {
    items: Vec<T>,
    next: usize,
}

impl<T> Default for Queue<T> {
    fn default() -> Queue<T> {
        Queue {
            items: Vec::new(),
            next: 0,
        }
    }
}

impl<T: Copy + PartialEq> Queue<T> {
    fn push(&mut self, item: T) {
        if !self.items[self.next..].contains(&item) {
            self.items.push(item);
        }
    }

    fn pop(&mut self) -> Option<T> {
        let item = self.items.get(self.next).copied();
        self.next += 1;
        if item.is_none() {
            self.items.clear();
            self.next = 0;
        }
        item
    }
}

impl Worklist {
    /// Room for large cuts.
    pub fn reserve(&mut self, model: &Model) {
        let most = model.mesh.tetrahedra.len();
        self.place.resize(most, NONE);
        self.vertices.items.reserve(most);
        self.edges.items.reserve(most);
        let largest = (0..model.mesh.nodes.len())
            .map(|v| model.topology.star(v).len())
            .max()
            .unwrap_or(0);
        self.star.reserve(largest);
        self.component.reserve(largest);
        self.stack.reserve(largest);
        self.volume.reserve(largest);
        self.stays.reserve(largest);
    }

    /// Notes the stars that the removal of tetrahedron `t`, which is dead by now, has split. Whether there
    /// are any.
    pub fn note(&mut self, model: &Model, live: &LiveMesh, t: u32) -> bool {
        let mut splits = false;
        let nodes = &live.tetrahedra[t as usize];
        let own = &model.topology.tetrahedron_edges[t as usize];
        for ([a, b, c, d], edge) in EDGES.into_iter().zip(own) {
            if !linked_round(model, live, t, [a, b], [c, d]) {
                splits = true;
                self.edges.push(([nodes[a], nodes[b]], *edge));
                self.vertices.push(nodes[a]);
                self.vertices.push(nodes[b]);
            }
        }
        splits
    }

    /// What to do for the next star that is not good, and with which tetrahedra; none when all are good.
    pub fn next(&mut self, model: &Model, live: &LiveMesh, which: &mut Vec<u32>) -> Option<Repair> {
        which.clear();
        // Vertices first: whatever hangs by one goes whole.
        while let Some(v) = self.vertices.pop() {
            self.star.clear();
            self.star.extend(live.star(model, v));
            if !self.split(model, live, [v, v]) {
                continue;
            }
            if model.parts.spares == 0 {
                self.lose(model, which);
                return Some(Repair::Lose);
            }
            // One component after the other.
            let leaves = self.leaving(model);
            self.vertices.push(v);
            if let Some(leaves) = leaves {
                let own = self.star.iter().zip(&self.component);
                which.extend(own.filter(|(_, c)| **c == leaves).map(|(t, _)| t));
                return Some(Repair::Split(v));
            }
            self.vertices.items.pop();
        }
        while let Some((ends, edge)) = self.edges.pop() {
            self.star.clear();
            for t in model.topology.edge_star(edge) {
                let nodes = &live.tetrahedra[*t as usize];
                if live.alive[*t as usize] && ends.iter().all(|end| nodes.contains(end)) {
                    self.star.push(*t);
                }
            }
            if self.split(model, live, ends) {
                self.lose(model, which);
                return Some(Repair::Lose);
            }
        }
        None
    }

    /// After node `old` has been split: edges still to be looked at may have gone with the new one.
    pub fn note_split(&mut self, old: u32, new: u32) {
        for at in self.edges.next..self.edges.items.len() {
            let (ends, edge) = self.edges.items[at];
            if ends.contains(&old) {
                let ends = ends.map(|v| if v == old { new } else { v });
                self.edges.push((ends, edge));
            }
        }
    }

    /// Components of the star in hand, of an edge or of a vertex named twice. Whether there are several.
    fn split(&mut self, model: &Model, live: &LiveMesh, edge: [u32; 2]) -> bool {
        self.component.clear();
        self.component.resize(self.star.len(), NONE);
        self.place.resize(model.mesh.tetrahedra.len(), NONE);
        for (k, t) in self.star.iter().enumerate() {
            self.place[*t as usize] = k as u32;
        }
        let mut count = 0;
        for seed in 0..self.star.len() {
            if self.component[seed] != NONE {
                continue;
            }
            self.component[seed] = count;
            self.stack.push(seed as u32);
            while let Some(at) = self.stack.pop() {
                let t = self.star[at as usize] as usize;
                let nodes = &live.tetrahedra[t];
                for (node, other) in nodes.iter().zip(&model.topology.neighbour[t]) {
                    // The face opposite a node of the edge does not contain the edge.
                    if *other == NONE || edge.contains(node) {
                        continue;
                    }
                    let place = self.place[*other as usize];
                    if place != NONE && self.component[place as usize] == NONE {
                        self.component[place as usize] = count;
                        self.stack.push(place);
                    }
                }
            }
            count += 1;
        }
        for t in &self.star {
            self.place[*t as usize] = NONE;
        }
        self.volume.clear();
        self.volume.resize(count as usize, 0.0);
        count > 1
    }

    /// All but what stays of the star in hand.
    fn lose(&mut self, model: &Model, lost: &mut Vec<u32>) {
        self.choose(model);
        let gone = |(_, c): &(&u32, &u32)| !self.stays[**c as usize];
        lost.extend(
            (self.star.iter().zip(&self.component))
                .filter(gone)
                .map(|(t, _)| t),
        );
    }

    /// The first component that does not stay.
    fn leaving(&mut self, model: &Model) -> Option<u32> {
        self.choose(model);
        self.stays.iter().position(|s| !s).map(|k| k as u32)
    }

    /// Which components of the star in hand stay.
    fn choose(&mut self, model: &Model) {
        let count = self.volume.len();
        self.stays.clear();
        self.stays.resize(count, false);
        let mut moves = 0;
        for (t, component) in self.star.iter().zip(&self.component) {
            let (t, component) = (*t as usize, *component as usize);
            if model.parts.dynamic[t] {
                self.volume[component] += model.shape[t].volume;
            } else {
                self.stays[component] = true;
            }
        }
        for (volume, stays) in self.volume.iter().zip(&self.stays) {
            moves += usize::from(*stays && *volume > 0.0);
        }
        if moves == 0 {
            // Components are in the order of their lowest tetrahedra.
            let mut largest = 0;
            for k in 1..count {
                if self.volume[k] > self.volume[largest] * (1.0 + TIE) {
                    largest = k;
                }
            }
            self.stays[largest] = true;
        }
    }

    /// Whether some live vertex star is not good.
    pub fn is_pinched(&mut self, model: &Model, live: &LiveMesh) -> bool {
        let used = (0..model.mesh.nodes.len() as u32).filter(|v| live.star_count[*v as usize] > 0);
        used.into_iter().any(|v| self.split(model, live, [v, v]))
    }

    /// Whether every live star of the mesh is good, vertices and edges.
    pub fn all_good(&mut self, model: &Model, live: &LiveMesh) -> bool {
        let vertices = !self.is_pinched(model, live);
        let mut edge = |t: &[u32; 4], [a, b, ..]: [usize; 4]| self.split(model, live, [t[a], t[b]]);
        vertices
            && (live.tetrahedra.iter().zip(&live.alive))
                .filter(|(_, alive)| **alive)
                .all(|(t, _)| EDGES.iter().all(|e| !edge(t, *e)))
    }
}

/// Whether the two neighbours of dead `t` at one of its edges, corners `ends`, are linked by live tetrahedra round
/// that edge; or one is missing. `off` are the corners off the edge.
fn linked_round(model: &Model, live: &LiveMesh, t: u32, ends: [usize; 2], off: [usize; 2]) -> bool {
    let neighbour = &model.topology.neighbour;
    let is_alive = |t: u32| t != NONE && live.alive[t as usize];
    let nodes = &model.mesh.tetrahedra[t as usize];
    let [from, to] = [neighbour[t as usize][off[0]], neighbour[t as usize][off[1]]];
    if !is_alive(from) || !is_alive(to) {
        return true;
    }
    let (a, b) = (nodes[ends[0]], nodes[ends[1]]);
    // Through the face opposite off[0], which holds the other one; out through that opposite it.
    let (mut at, mut behind) = (from, nodes[off[1]]);
    while at != to {
        let nodes = &model.mesh.tetrahedra[at as usize];
        let (mut out, mut ahead) = (0, NONE);
        for (k, node) in nodes.iter().enumerate() {
            if *node == behind {
                out = k;
            } else if *node != a && *node != b {
                ahead = *node;
            }
        }
        at = neighbour[at as usize][out];
        behind = ahead;
        if !is_alive(at) {
            return false;
        }
    }
    true
}
