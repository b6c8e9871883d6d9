//! Connected pieces of live tissue, kept up to date cut by cut, and which of them are loose.
//!
//! A piece comes apart only where a star has split (see [`crate::star`]), or beside pre-computed tissue. Then a search goes out from all
//! tetrahedra next to the cut at once, a few steps each in turn, and ends when all that still search have met:
//! what has run out of tissue before is a piece of its own. Its cost is that of the smaller parts.
//!
//! A piece is loose when supports leave it a rigid motion, whatever tools hold: 6 less the rank of the held axes'
//! rows (e_a, r x e_a), which leaves 6, 3, 1 or 0 for no, one, collinear, or three fixed nodes. Loose pieces move
//! in a frame of their own ([`crate::loose`]).

use nalgebra::{Matrix6, SymmetricEigen, Vector6};

use crate::mesh::Vec3;
use crate::mesh::topology::NONE;
use crate::model::Model;

/// A pure function of which tetrahedra are alive.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pieces {
    /// Highest node of each node's piece, or [`NONE`] where no tissue is left.
    pub label: Vec<u32>,
    pub count: usize,
    /// Rigid motions that nothing holds, over all pieces.
    pub rigid_modes: usize,
    /// Pre-computed tissue has come loose.
    pub has_frameless: bool,
    /// Those of the piece labelled by each node, and whether that moves in a frame of its own.
    modes: Vec<u8>,
    is_loose: Vec<bool>,
    /// Nodes of loose pieces, piece by piece in the order of labels, ascending; the end of each.
    nodes: Vec<u32>,
    ends: Vec<u32>,
}

/// What pieces are found from.
pub struct Tissue<'a> {
    /// A tetrahedron each.
    pub tetrahedra: &'a [[u32; 4]],
    pub alive: &'a [bool],
    /// A node each: live tetrahedra round it.
    pub star_count: &'a [u32],
    /// A spare each: the node it comes from, or [`NONE`].
    pub origin: &'a [u32],
}

impl Tissue<'_> {
    /// Connection nodes of `t`. What hangs by one alone stays, as pre-computed tissue does not go.
    fn connections(&self, model: &Model, t: u32) -> impl Iterator<Item = u32> {
        let range = model.parts.connected_from()..model.parts.moving;
        let nodes = self.tetrahedra[t as usize].into_iter();
        nodes.filter(move |v| range.contains(&(*v as usize)))
    }

    /// Live tetrahedra round a connection node.
    fn star<'a>(&'a self, model: &'a Model, node: u32) -> impl Iterator<Item = u32> + 'a {
        let star = model.topology.star(node as usize).iter().copied();
        star.filter(move |t| {
            self.alive[*t as usize] && self.tetrahedra[*t as usize].contains(&node)
        })
    }

    fn free(&self, model: &Model, node: u32) -> [bool; 3] {
        match self.origin.get(node as usize).copied().unwrap_or(node) {
            NONE => [true; 3],
            origin => model.boundary.free[origin as usize],
        }
    }
}

/// Tetrahedra that a group visits before it is the next one's turn.
const TURN: usize = 8;
/// A claim of several groups.
const DISPUTED: u32 = NONE - 1;

/// Room for a search.
#[derive(Debug, Default)]
pub struct Search {
    /// A tetrahedron each: the group that reached it, or [`NONE`]; the one behind it in that group's queue.
    group: Vec<u32>,
    behind: Vec<u32>,
    reached: Vec<u32>,
    /// A group each: the ends of its queue, a group it has met, its piece, the highest node of what it reached,
    /// whether it has somewhere to go.
    head: Vec<u32>,
    tail: Vec<u32>,
    met: Vec<u32>,
    piece: Vec<u32>,
    highest: Vec<u32>,
    runs: Vec<bool>,
    /// Whether that piece was loose.
    before: Vec<bool>,
    /// A node each: the one group that still searches the piece with that label, or [`NONE`]; the group that
    /// reached it first, or [`NONE`].
    claim: Vec<u32>,
    at_node: Vec<u32>,
    /// As they were, where all are found afresh.
    pieces: Pieces,
    /// Nodes of loose pieces, ascending.
    loose: Vec<u32>,
    /// Labels of the pieces that are new or another now, and whether what they come from was loose.
    pub(crate) changed: Vec<(u32, bool)>,
}

impl Search {
    pub fn new(model: &Model) -> Search {
        if !model.can_be_cut() {
            return Search::default();
        }
        let count = model.mesh.tetrahedra.len();
        let room = || Vec::with_capacity(count);
        let mut pieces = Pieces::default();
        if model.is_pinched {
            pieces.copy_from(&model.whole.pieces);
            pieces.reserve();
        }
        Search {
            pieces,
            loose: vec![0; model.mesh.nodes.len()],
            group: vec![NONE; count],
            behind: vec![NONE; count],
            reached: room(),
            head: room(),
            tail: room(),
            met: room(),
            piece: room(),
            highest: room(),
            runs: Vec::with_capacity(count),
            before: Vec::with_capacity(count),
            claim: vec![NONE; model.mesh.nodes.len()],
            at_node: vec![NONE; model.mesh.nodes.len()],
            changed: Vec::with_capacity(count),
        }
    }

    fn note(&mut self, label: u32, was_loose: bool) {
        if !self.changed.iter().any(|c| c.0 == label) {
            self.changed.push((label, was_loose));
        }
    }

    /// The group that stands for all that a group has met.
    fn root(&mut self, mut group: u32) -> u32 {
        while self.met[group as usize] != group {
            let up = self.met[self.met[group as usize] as usize];
            self.met[group as usize] = up;
            group = up;
        }
        group
    }

    fn groups(&self) -> std::ops::Range<u32> {
        0..self.met.len() as u32
    }

    /// A group of its own for `t` of a piece.
    fn start(&mut self, tissue: &Tissue, t: u32, piece: u32) {
        let group = self.met.len() as u32;
        self.met.push(group);
        self.piece.push(piece);
        self.head.push(NONE);
        self.tail.push(NONE);
        self.highest.push(0);
        self.runs.push(false);
        self.queue(tissue, group, t);
    }

    /// Stars are good, so that groups which reach the same node have met.
    fn queue(&mut self, tissue: &Tissue, group: u32, t: u32) {
        for node in tissue.tetrahedra[t as usize] {
            let there = self.at_node[node as usize];
            if there == NONE {
                self.at_node[node as usize] = group;
            } else if there != group {
                self.meet(there, group);
            }
        }
        self.group[t as usize] = group;
        self.behind[t as usize] = NONE;
        self.reached.push(t);
        let tail = std::mem::replace(&mut self.tail[group as usize], t);
        if self.head[group as usize] == NONE {
            self.head[group as usize] = t;
        } else {
            self.behind[tail as usize] = t;
        }
    }

    /// Goes on until in each piece all groups that still have somewhere to go have met. Whether in one there are groups
    /// that have not.
    fn run(&mut self, model: &Model, tissue: &Tissue) -> bool {
        loop {
            let mut disputed = false;
            for group in self.groups() {
                if self.head[group as usize] != NONE {
                    let root = self.root(group);
                    disputed |= self.claim(group, root);
                }
            }
            for group in self.groups() {
                let piece = self.piece[group as usize] as usize;
                if self.claim[piece] == DISPUTED {
                    self.spread(model, tissue, group);
                }
            }
            self.release();
            if !disputed {
                break;
            }
        }
        let mut several = false;
        for group in self.groups() {
            let root = self.root(group);
            self.runs[root as usize] |= self.head[group as usize] != NONE;
            several |= self.claim(group, root);
        }
        // Disputed pieces are those that have come apart.
        several
    }

    /// Claims a group's piece for its root. Whether another has.
    fn claim(&mut self, group: u32, root: u32) -> bool {
        let claim = &mut self.claim[self.piece[group as usize] as usize];
        if *claim == NONE {
            *claim = root;
        } else if *claim != root {
            *claim = DISPUTED;
        }
        *claim == DISPUTED
    }

    fn release(&mut self) {
        for piece in &self.piece {
            self.claim[*piece as usize] = NONE;
        }
    }

    fn meet(&mut self, one: u32, other: u32) {
        let (a, b) = (self.root(one), self.root(other));
        self.met[a.max(b) as usize] = a.min(b);
    }

    fn spread(&mut self, model: &Model, tissue: &Tissue, group: u32) {
        for _ in 0..TURN {
            let t = self.head[group as usize];
            if t == NONE {
                break;
            }
            self.head[group as usize] = self.behind[t as usize];
            for other in model.topology.neighbour[t as usize] {
                let is_new = other != NONE && self.group[other as usize] == NONE;
                if is_new && tissue.alive[other as usize] {
                    self.queue(tissue, group, other);
                }
            }
            for node in tissue.connections(model, t) {
                for other in tissue.star(model, node) {
                    if self.group[other as usize] == NONE {
                        self.queue(tissue, group, other);
                    }
                }
            }
        }
    }

    /// Whether `t` is of a part that has come off: not of what still searched when the others were done.
    fn is_off(&mut self, t: u32) -> Option<usize> {
        let root = self.root(self.group[t as usize]) as usize;
        let piece = self.piece[root] as usize;
        (self.claim[piece] == DISPUTED && !self.runs[root]).then_some(root)
    }

    fn clear(&mut self, tissue: &Tissue) {
        self.release();
        for t in &self.reached {
            self.group[*t as usize] = NONE;
            for node in tissue.tetrahedra[*t as usize] {
                self.at_node[node as usize] = NONE;
            }
        }
        self.reached.clear();
        self.head.clear();
        self.tail.clear();
        self.met.clear();
        self.piece.clear();
        self.highest.clear();
        self.runs.clear();
    }
}

impl Pieces {
    /// Of all that is alive.
    pub fn whole(model: &Model, tissue: &Tissue) -> Pieces {
        let mut pieces = Pieces::default();
        pieces.find_all(model, tissue, &mut Vec::new());
        pieces
    }

    /// A vertex that has been split from another belongs to the same piece, as its lowest node.
    pub(crate) fn join(&mut self, new: u32, other: u32) {
        let label = self.label[other as usize];
        self.label[new as usize] = label;
        if let Some((at, piece)) = self.loose_piece(label) {
            self.nodes.insert(piece.start, new);
            self.ends[at..].iter_mut().for_each(|end| *end += 1);
        }
    }

    /// A node goes that does not name its piece. Whether that was listed.
    fn leave(&mut self, node: u32, label: u32) -> bool {
        let Some((at, piece)) = self.loose_piece(label) else {
            return false;
        };
        let Ok(place) = self.nodes[piece.clone()].binary_search(&node) else {
            return false;
        };
        self.nodes.remove(piece.start + place);
        self.ends[at..].iter_mut().for_each(|end| *end -= 1);
        true
    }

    /// Room for any division.
    pub(crate) fn reserve(&mut self) {
        self.nodes.reserve(self.label.len());
        self.ends.reserve(self.label.len());
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &Pieces) {
        self.label.clone_from(&other.label);
        self.count = other.count;
        self.rigid_modes = other.rigid_modes;
        self.has_frameless = other.has_frameless;
        self.modes.clone_from(&other.modes);
        self.is_loose.clone_from(&other.is_loose);
        self.nodes.clone_from(&other.nodes);
        self.ends.clone_from(&other.ends);
    }

    fn find_all(&mut self, model: &Model, tissue: &Tissue, loose: &mut Vec<u32>) {
        let nodes = model.mesh.nodes.len();
        self.label.clear();
        self.label.resize(nodes, NONE);
        self.modes.clear();
        self.modes.resize(nodes, 0);
        self.is_loose.clear();
        self.is_loose.resize(nodes, false);
        (self.count, self.rigid_modes) = (0, 0);
        // Each node's label leads to a higher node of its piece, the highest to itself.
        let label = &mut self.label;
        let live = tissue.tetrahedra.iter().zip(tissue.alive);
        for (corners, _) in live.filter(|(_, alive)| **alive) {
            let mut top = 0;
            for node in corners {
                if label[*node as usize] == NONE {
                    label[*node as usize] = *node;
                }
                top = top.max(top_of(label, *node));
            }
            for node in corners {
                let own = top_of(label, *node);
                label[own as usize] = top;
            }
        }
        for v in (0..nodes).rev() {
            if label[v] != NONE {
                label[v] = label[label[v] as usize];
                self.count += usize::from(label[v] == v as u32);
            }
        }
        for v in 0..nodes as u32 {
            if self.label[v as usize] == v {
                self.count_modes(model, tissue, v);
            }
        }
        self.list(model, loose);
    }

    /// Rigid motions that supports leave a piece.
    fn count_modes(&mut self, model: &Model, tissue: &Tissue, label: u32) {
        let split = (0..)
            .zip(tissue.origin)
            .filter(|(_, origin)| **origin != NONE);
        let own = model.boundary.supported.iter().map(|v| (*v, v));
        let held = own.chain(split);
        let held = held.filter(|(v, _)| self.label[*v as usize] == label);
        let free = free_modes(
            held.map(|(v, origin)| (model.mesh.nodes[*origin as usize], tissue.free(model, v))),
        );
        self.set_modes(label, free);
    }

    fn set_modes(&mut self, label: u32, modes: usize) {
        let before = std::mem::replace(&mut self.modes[label as usize], modes as u8);
        self.rigid_modes = self.rigid_modes + modes - usize::from(before);
        self.is_loose[label as usize] = modes > 0;
    }

    /// Lists the nodes of loose pieces. One with pre-computed tissue in it has no frame.
    fn list(&mut self, model: &Model, found: &mut Vec<u32>) {
        self.nodes.clear();
        self.ends.clear();
        self.has_frameless = false;
        for v in model.parts.connected_from()..self.label.len() {
            if self.label[v] != NONE {
                let label = self.label[v] as usize;
                self.has_frameless |= self.modes[label] > 0;
                self.is_loose[label] = false;
            }
        }
        // Without branches: which nodes are loose follows no pattern.
        let label = &self.label;
        found.resize(label.len(), 0);
        let mut count = 0;
        for v in 0..model.parts.moving {
            let own = label[v];
            let is_loose = (own != NONE) & self.is_loose[(own as usize).min(label.len() - 1)];
            found[count] = v as u32;
            count += usize::from(is_loose);
        }
        let found = &found[..count];
        // How many each has, where it starts, and as nodes take their places where it ends.
        self.ends.resize(label.len(), 0);
        for v in found {
            self.ends[label[*v as usize] as usize] += 1;
        }
        let mut from = 0;
        for end in &mut self.ends {
            from += std::mem::replace(end, from);
        }
        self.nodes.resize(count, 0);
        for v in found {
            let end = &mut self.ends[label[*v as usize] as usize];
            self.nodes[*end as usize] = *v;
            *end += 1;
        }
        let mut pieces = 0;
        for v in found.iter().filter(|v| label[**v as usize] == **v) {
            self.ends[pieces] = self.ends[*v as usize];
            pieces += 1;
        }
        self.ends.truncate(pieces);
    }

    /// Nodes of loose pieces.
    pub fn loose_nodes(&self) -> &[u32] {
        &self.nodes
    }

    /// Ranges of [`Pieces::loose_nodes`], one a piece.
    pub fn loose(&self) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        let start = |k: usize| k.checked_sub(1).map_or(0, |k| self.ends[k] as usize);
        (0..self.ends.len()).map(move |k| start(k)..self.ends[k] as usize)
    }

    /// Place of the loose piece with a label among them, and its range.
    pub(crate) fn loose_piece(&self, label: u32) -> Option<(usize, std::ops::Range<usize>)> {
        let last = |end: &u32| self.label[self.nodes[*end as usize - 1] as usize];
        let at = self.ends.binary_search_by_key(&label, last).ok()?;
        let start = at.checked_sub(1).map_or(0, |k| self.ends[k] as usize);
        Some((at, start..self.ends[at] as usize))
    }

    /// Whether a node belongs to a loose piece.
    pub fn is_loose(&self, node: usize) -> bool {
        !self.nodes.is_empty()
            && self.label[node] != NONE
            && self.is_loose[self.label[node] as usize]
    }

    /// After `removed` went: `severs` if a star has split on the way.
    pub(crate) fn update(
        &mut self,
        model: &Model,
        tissue: &Tissue,
        removed: &[u32],
        severs: bool,
        search: &mut Search,
    ) {
        search.changed.clear();
        if model.is_pinched {
            // Vertices that hold parts together do not show in stars.
            let mut before = std::mem::take(&mut search.pieces);
            before.copy_from(self);
            self.find_all(model, tissue, &mut search.loose);
            for node in self
                .nodes
                .iter()
                .filter(|v| self.label[**v as usize] == **v)
            {
                let old = before.label[*node as usize];
                let was_loose = before.is_loose[old as usize];
                if !was_loose || old != *node {
                    search.note(*node, was_loose);
                }
            }
            search.pieces = before;
            return;
        }
        let mut lists = false;
        for v in removed.iter().flat_map(|t| tissue.tetrahedra[*t as usize]) {
            let label = self.label[v as usize];
            if tissue.star_count[v as usize] > 0 || label == NONE {
                continue;
            }
            let was_loose = self.is_loose[label as usize];
            lists |= was_loose && (lists || label == v || !self.leave(v, label));
            self.label[v as usize] = NONE;
            let mut name = label;
            if label == v {
                name = self.rename(v);
                let renamed = search.changed.iter_mut().filter(|c| c.0 == v);
                renamed.for_each(|c| c.0 = name);
            }
            let supported = tissue.free(model, v) != [true; 3];
            if name != NONE && (supported || (name != label && was_loose)) {
                search.note(name, was_loose);
            }
        }
        // What hung together by a connection node does not show in stars either.
        let connects = |t: &u32| tissue.connections(model, *t).next().is_some();
        if severs || removed.iter().any(connects) {
            self.divide(model, tissue, removed, search);
        }
        for (label, was_loose) in &search.changed {
            if *label != NONE && self.label[*label as usize] == *label {
                self.count_modes(model, tissue, *label);
                lists |= *was_loose || self.is_loose[*label as usize];
            }
        }
        if lists {
            self.list(model, &mut search.loose);
        }
    }

    /// The piece that was named after node `old` has lost it: its new name, or [`NONE`] where nothing of it is
    /// left.
    fn rename(&mut self, old: u32) -> u32 {
        let mut new = NONE;
        for v in (0..self.label.len()).rev() {
            if self.label[v] == old {
                new = if new == NONE { v as u32 } else { new };
                self.label[v] = new;
            }
        }
        let modes = usize::from(self.modes[old as usize]);
        self.set_modes(old, 0);
        if new == NONE {
            self.count -= 1;
        } else {
            self.set_modes(new, modes);
        }
        new
    }

    /// Finds which pieces the cut has divided. Those that are new, or lost some, are noted as changed.
    fn divide(&mut self, model: &Model, tissue: &Tissue, removed: &[u32], search: &mut Search) {
        let mut start = |t: u32| {
            if search.group[t as usize] == NONE {
                let node = tissue.tetrahedra[t as usize][0];
                search.start(tissue, t, self.label[node as usize]);
            }
        };
        for removed in removed {
            for t in model.topology.neighbour[*removed as usize] {
                if t != NONE && tissue.alive[t as usize] {
                    start(t);
                }
            }
            for node in tissue.connections(model, *removed) {
                tissue.star(model, node).take(1).for_each(&mut start);
            }
        }
        if search.run(model, tissue) {
            self.part(tissue, search);
        }
        search.clear(tissue);
    }

    /// Names what a search has found to be apart.
    fn part(&mut self, tissue: &Tissue, search: &mut Search) {
        for k in 0..search.reached.len() {
            let t = search.reached[k];
            let Some(root) = search.is_off(t) else {
                continue;
            };
            for node in tissue.tetrahedra[t as usize] {
                search.highest[root] = search.highest[root].max(node);
                self.label[node as usize] = NONE;
            }
        }
        // What there is of changes so far has names from before.
        search.before.clear();
        for group in search.groups() {
            let old = search.piece[group as usize];
            search.before.push(self.is_loose[old as usize]);
        }
        for group in search.groups() {
            let old = search.piece[group as usize];
            let was_loose = search.before[group as usize];
            let is_root = search.met[group as usize] == group;
            if !is_root || search.claim[old as usize] != DISPUTED {
                continue;
            }
            self.count += 1;
            if search.runs[group as usize] {
                // The rest, which keeps the name if it has the node.
                self.count -= 1;
                let rest = match self.label[old as usize] {
                    NONE => self.rename(old),
                    name => name,
                };
                search.note(rest, was_loose);
            } else {
                // What is noted of the whole has this name, too.
                let highest = search.highest[group as usize];
                search.note(highest, was_loose);
            }
        }
        for k in 0..search.reached.len() {
            let t = search.reached[k];
            if let Some(root) = search.is_off(t) {
                for node in tissue.tetrahedra[t as usize] {
                    self.label[node as usize] = search.highest[root];
                }
            }
        }
        // Pieces of which no part still searched.
        for group in search.groups() {
            let old = search.piece[group as usize];
            let has_rest = |g: u32| search.runs[g as usize] && search.piece[g as usize] == old;
            if search.claim[old as usize] == DISPUTED && !search.groups().any(has_rest) {
                search.claim[old as usize] = NONE;
                self.count -= 1;
            }
        }
    }
}

/// The highest node that a node's label leads to.
fn top_of(label: &[u32], mut node: u32) -> u32 {
    while label[node as usize] != node {
        node = label[node as usize];
    }
    node
}

/// 6 less the rank of the held axes' rows in the six rigid motions, of nodes at positions \[m\] with their
/// free axes.
pub fn free_modes(held: impl Iterator<Item = (Vec3, [bool; 3])> + Clone) -> usize {
    if holds_all(held.clone()) {
        return 0;
    }
    let count = held.clone().count();
    if count == 0 {
        return 6;
    }
    let middle = held.clone().map(|(at, _)| at).sum::<Vec3>() / count as f64;
    let size = (held.clone())
        .map(|(at, _)| (at - middle).norm())
        .fold(f64::MIN_POSITIVE, f64::max);
    let mut gram = Matrix6::zeros();
    for (at, free) in held {
        let r = (at - middle) / size;
        for axis in (0..3).filter(|a| !free[*a]) {
            let e = Vec3::ith(axis, 1.0);
            let turn = r.cross(&e);
            let row = Vector6::new(e.x, e.y, e.z, turn.x, turn.y, turn.z);
            gram += row * row.transpose();
        }
    }
    let limit = 1e-10 * gram.trace();
    let eigenvalues = SymmetricEigen::new(gram).eigenvalues;
    6 - eigenvalues.iter().filter(|e| **e > limit).count()
}

/// Whether there are three nodes held on all axes that are clearly not in line.
fn holds_all(held: impl Iterator<Item = (Vec3, [bool; 3])>) -> bool {
    let mut fixed = held
        .filter(|(_, free)| *free == [false; 3])
        .map(|(at, _)| at);
    let Some(first) = fixed.next() else {
        return false;
    };
    let mut along = Vec3::zeros();
    for at in fixed {
        let from = at - first;
        if along.cross(&from).norm() > 1e-2 * along.norm() * from.norm() {
            return true;
        }
        if from.norm() > along.norm() {
            along = from;
        }
    }
    false
}
