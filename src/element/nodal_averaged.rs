//! The nodal-averaged tetrahedron with an hourglass term: one deformation gradient a vertex, which neither locks nor
//! lets short waves go.
//!
//! With V_j = sum_t V_t/4 and D_jk = sum_t (V_t/4) a_k over the tetrahedra t with vertices j and k (k = j included),
//!
//! G_j = 1/V_j sum_k (u_k - u_j) D_jk^T,  F_j = I + G_j,  L_jk = sum_t V_t a_j . a_k
//! W = sum_j V_j psi(F_j) + c mu/2 \[sum_t V_t |G_t|² - sum_j V_j |G_j|²\],  sum_t V_t |G_t|² = - sum_{j<k} L_jk |u_k - u_j|²
//! dW/du_k = sum_j Q_j D_jk + c mu sum_j L_kj (u_j - u_k),  Q_j = P(F_j) - c mu G_j
//!
//! G_j is the mean of the G_t, so that the bracket is their variance: never negative, zero for any linear field,
//! unchanged by rotation. (After Bonet and Burton 1998, and Puso and Solberg 2006; the hourglass term is ours.) The D_jk of a
//! vertex sum to zero, as the a_k do: differences, so that a translation gives no force.
//!
//! Tissue of several materials averages each over its own tetrahedra: a vertex has a point for each.

use nalgebra::Matrix3;

use super::constant_strain::Shape;
use super::kernel::{Kernel, parameters};
use super::tetrahedra::{Extent, Reach};
use crate::lanes::{self, Four, Square, Three, product, scale};
use crate::law::linear::Hooke;
use crate::law::response::{Law, Point, Response};
use crate::law::volume_penalty;
use crate::mesh::Vec3;
use crate::model::tensor_mass::Lane;

/// Four points side by side; past the last one some of no stiffness.
#[derive(Clone, Debug, PartialEq)]
#[repr(C, align(32))]
struct Group {
    /// Of [`Response::parameters`] \[Pa\].
    parameters: [[f64; 4]; 2],
    /// V_j \[m³\]
    volume: [f64; 4],
    /// 1/V_j
    inverse: [f64; 4],
    /// c mu \[Pa\]
    hourglass: [f64; 4],
    direction: [[f64; 4]; 3],
    kappa: [f64; 4],
}

/// One neighbour of each of four points: the axes of D_jk \[m²\] and c mu L_jk \[N/m\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
struct Entries([[f64; 4]; 4]);

/// So many points, in the order of their vertices, are near each other. Among these they are sorted by how many entries they
/// have, as four side by side take as long as the longest row.
const NEAR: usize = 64;

/// Where the entries of a group are: `start..end`, as many as its longest row has; there is room for more.
#[derive(Clone, Copy, Debug)]
struct Block {
    start: u32,
    end: u32,
    room: u32,
}

/// Points, near ones side by side; those of vertices that cuts have made behind them.
#[derive(Clone, Debug)]
pub struct NodalAveraged {
    pub law: Law,
    /// c \[1\]
    hourglass: f64,
    has_fibre: bool,
    /// k of [`crate::law::volume_penalty`] \[Pa\]; the materials' own do not count.
    pub penalty: f64,
    group: Vec<Group>,
    /// A place of a group each: the vertex.
    node: Vec<[u32; 4]>,
    block: Vec<Block>,
    /// D_jj comes first. Past the end of a row come zeros, for the vertex itself, as far as its block has room.
    column: Vec<[u32; 4]>,
    entry: Vec<Entries>,
    /// A point each: its material, what the scene counts that as, and how many entries it has.
    material: Vec<Hooke>,
    number: Vec<u32>,
    count: Vec<u32>,
    /// Places of the points, those of a vertex together.
    place: Vec<u32>,
    /// A vertex each: the first of its points in `place`, and past the last.
    range: Vec<[u32; 2]>,
    /// Scratch, left empty.
    around: Vec<u32>,
}

/// Where entries are is of no account.
impl PartialEq for NodalAveraged {
    fn eq(&self, other: &NodalAveraged) -> bool {
        let alike = |p: usize| {
            let (own, others) = (self.row(p), other.row(p));
            let own = own.map(|at| (self.neighbour(at), self.numbers(at)));
            own.eq(others.map(|at| (other.neighbour(at), other.numbers(at))))
        };
        (self.law, self.hourglass, self.has_fibre, self.penalty)
            == (other.law, other.hourglass, other.has_fibre, other.penalty)
            && (&self.group, &self.node, &self.material, &self.number)
                == (&other.group, &other.node, &other.material, &other.number)
            && (&self.count, &self.place, &self.range) == (&other.count, &other.place, &other.range)
            && (0..self.count.len()).all(alike)
    }
}

/// What a tetrahedron adds to its corner j for its corner k: D_jk and c mu L_jk.
fn entry(shape: &Shape, material: &Hooke, c: f64, j: usize, k: usize) -> [f64; 4] {
    let d = shape.gradient[k] * (shape.volume / 4.0);
    let l = shape.volume * shape.gradient[j].dot(&shape.gradient[k]);
    let l = if j == k { 0.0 } else { c * material.mu * l };
    [d.x, d.y, d.z, l]
}

impl NodalAveraged {
    /// Of those tetrahedra of a mesh that `of` gives shape, material and its number of; `c` \[1\].
    pub fn new<'a>(
        law: Law,
        c: f64,
        tetrahedra: &[[u32; 4]],
        of: impl Fn(usize) -> Option<(&'a Shape, &'a Hooke, u32)>,
    ) -> NodalAveraged {
        // (vertex, material, neighbour or the vertex itself first)
        let mut pairs: Vec<(u32, u32, u32, [f64; 4])> = Vec::new();
        let mut volumes: Vec<(u32, u32, f64, Hooke)> = Vec::new();
        for (t, nodes) in tetrahedra.iter().enumerate() {
            let Some((shape, material, number)) = of(t) else {
                continue;
            };
            let quarter = shape.volume / 4.0;
            for (j, node) in nodes.iter().enumerate() {
                volumes.push((*node, number, quarter, *material));
                for (k, other) in nodes.iter().enumerate() {
                    pairs.push((*node, number, *other, entry(shape, material, c, j, k)));
                }
            }
        }
        // Stable: sums in the order of the tetrahedra.
        pairs.sort_by_key(|(node, number, other, _)| (*node, *number, other != node, *other));
        volumes.sort_by_key(|(node, number, ..)| (*node, *number));
        let nodes = tetrahedra.iter().flatten().max().map_or(0, |v| v + 1);
        let mut made = NodalAveraged {
            law,
            hourglass: c,
            has_fibre: volumes.iter().any(|(.., m)| m.fibre.is_some()),
            penalty: 0.0,
            group: Vec::new(),
            node: Vec::new(),
            block: Vec::new(),
            column: Vec::new(),
            entry: Vec::new(),
            material: Vec::new(),
            number: Vec::new(),
            count: Vec::new(),
            place: Vec::new(),
            range: vec![[0; 2]; nodes as usize],
            around: Vec::new(),
        };
        let rows: Vec<_> = (pairs.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)))
            .map(|point| {
                let each = point.chunk_by(|a, b| a.2 == b.2).map(|entries| {
                    let sum = |axis: usize| entries.iter().map(|e| e.3[axis]).sum::<f64>();
                    (entries[0].2, [sum(0), sum(1), sum(2), sum(3)])
                });
                each.collect::<Vec<_>>()
            })
            .collect();
        let points: Vec<_> = volumes.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).collect();
        let mut order: Vec<usize> = (0..points.len()).collect();
        for near in order.chunks_mut(NEAR) {
            near.sort_by_key(|at| rows[*at].len());
        }
        made.place.resize(points.len(), 0);
        for (at, point) in (0..).zip(&points) {
            let range = &mut made.range[point[0].0 as usize];
            range[0] = if range[1] == 0 { at } else { range[0] };
            range[1] = at + 1;
        }
        for four in order.chunks(4) {
            let longest = four.iter().map(|at| rows[*at].len()).max().unwrap_or(1);
            for at in four {
                let (node, number, _, material) = &points[*at][0];
                let volume: f64 = points[*at].iter().map(|p| p.2).sum();
                let p = made.add_point(*node, volume, material, *number, longest as u32);
                made.place[*at] = p as u32;
                made.count[p] = rows[*at].len() as u32;
                for (at, (other, numbers)) in made.row(p).zip(&rows[*at]) {
                    made.column[at / 4][at % 4] = *other;
                    made.add(at, numbers);
                }
            }
        }
        made
    }

    /// Its place; without entries. A new group gets room for so many.
    fn add_point(
        &mut self,
        node: u32,
        volume: f64,
        material: &Hooke,
        number: u32,
        room: u32,
    ) -> usize {
        let p = self.material.len();
        let (g, lane) = (p / 4, p % 4);
        if lane == 0 {
            self.group.push(Group {
                parameters: Default::default(),
                volume: Default::default(),
                inverse: Default::default(),
                hourglass: Default::default(),
                direction: Default::default(),
                kappa: Default::default(),
            });
            self.node.push([node; 4]);
            let block = self.new_block(room, [node; 4]);
            self.block.push(block);
        }
        // Places that are no point yet have nodes that there are.
        self.node[g][lane..].fill(node);
        let Block { start, room, .. } = self.block[g];
        for column in &mut self.column[start as usize..][..room as usize] {
            column[lane..].fill(node);
        }
        self.material.push(*material);
        self.number.push(number);
        self.count.push(0);
        let group = &mut self.group[g];
        let [first, second] = parameters(self.law, material);
        group.parameters[0][lane] = first;
        group.parameters[1][lane] = second;
        group.volume[lane] = volume;
        group.inverse[lane] = if volume > 0.0 { 1.0 / volume } else { 0.0 };
        group.hourglass[lane] = self.hourglass * material.mu;
        if let Some(fibre) = &material.fibre {
            for axis in 0..3 {
                group.direction[axis][lane] = fibre.direction[axis];
            }
            group.kappa[lane] = fibre.kappa;
        }
        p
    }

    /// Behind all others, full of zeros for these nodes.
    fn new_block(&mut self, room: u32, nodes: [u32; 4]) -> Block {
        let start = self.column.len() as u32;
        let end = start + room;
        self.column.resize(end as usize, nodes);
        self.entry.resize(end as usize, Entries::default());
        Block { start, end, room }
    }

    /// Gives a vertex that a cut makes points as another has, with nothing in them yet.
    pub(crate) fn open(&mut self, new: u32, from: u32) {
        let first = self.place.len() as u32;
        for at in self.points_of(from) {
            let p = self.place[at] as usize;
            let (material, number) = (self.material[p], self.number[p]);
            let p = self.add_point(new, 0.0, &material, number, 1);
            self.place.push(p as u32);
        }
        self.range[new as usize] = [first, self.place.len() as u32];
    }

    /// Room for so many vertices that cuts make, which have so many neighbours in all when they are made, themselves
    /// among them: none allocates.
    ///
    /// An edge that a cut makes is among these neighbours, and gives an entry to the points of either end, `each` at
    /// most. At worst each such entry makes a group of its own longer by one: the longest that groups ever are sum to no
    /// more than the room that blocks have now and 2 `each` `neighbours`. A group of length w that outgrows its block
    /// gets one of 2 w; that block was shorter than w, the one before it than w/2, and so on, which is less than 4 w.
    /// So there never is more than four times that sum, of which what there is now need not be added.
    pub(crate) fn reserve(&mut self, vertices: usize, neighbours: usize) {
        let most = self.range.iter().map(|[from, to]| to - from).max();
        let each = most.unwrap_or(0) as usize;
        let points = each * vertices;
        self.group.reserve(points / 4 + 1);
        self.node.reserve(points / 4 + 1);
        self.block.reserve(points / 4 + 1);
        self.material.reserve(points);
        self.number.reserve(points);
        self.count.reserve(points);
        self.place.reserve(points);
        if vertices > 0 {
            let entries = 3 * self.column.len() + 8 * each * neighbours;
            self.column.reserve(entries);
            self.entry.reserve(entries);
        }
        // Four corners a tetrahedron, of which a star has fewer than twice its vertices, as a sphere has triangles.
        let longest = self.count.iter().max().copied().unwrap_or(0) as usize;
        self.around.reserve(16 * longest);
    }

    /// Places of a point's entries: four times that of [`Entries`], and the lane.
    fn row(&self, p: usize) -> impl Iterator<Item = usize> + Clone + use<> {
        let (first, count) = (self.block[p / 4].start as usize, self.count[p] as usize);
        (first..first + count).map(move |at| 4 * at + p % 4)
    }

    fn numbers(&self, at: usize) -> [f64; 4] {
        self.entry[at / 4].0.map(|row| row[at % 4])
    }

    fn add(&mut self, at: usize, numbers: &[f64; 4]) {
        for (row, add) in self.entry[at / 4].0.iter_mut().zip(numbers) {
            row[at % 4] += add;
        }
    }

    fn neighbour(&self, at: usize) -> u32 {
        self.column[at / 4][at % 4]
    }

    fn vertex(&self, p: usize) -> u32 {
        self.node[p / 4][p % 4]
    }

    fn volume(&self, p: usize) -> f64 {
        self.group[p / 4].volume[p % 4]
    }

    fn hourglass(&self, p: usize) -> f64 {
        self.group[p / 4].hourglass[p % 4]
    }

    fn material(&self, p: usize) -> Hooke {
        self.material[p].with_penalty(self.penalty)
    }

    fn d(&self, at: usize) -> Vec3 {
        let [x, y, z, _] = self.numbers(at);
        Vec3::new(x, y, z)
    }

    /// G_j, alone.
    fn gradient(&self, p: usize, u: &[Lane]) -> Matrix3<f64> {
        let own = u[self.vertex(p) as usize].xyz();
        let mut sum = Matrix3::zeros();
        for at in self.row(p) {
            let w = u[self.neighbour(at) as usize].xyz() - own;
            sum += w * self.d(at).transpose();
        }
        sum / self.volume(p)
    }

    /// Where the places of a vertex's points are in `place`.
    fn points_of(&self, node: u32) -> std::ops::Range<usize> {
        let [from, to] = self.range[node as usize];
        from as usize..to as usize
    }

    /// dW/du_i \[N\], alone: for the few vertices whose reaction is wanted.
    pub fn node_force(&self, i: usize, u: &[Lane]) -> Vec3 {
        let node = i as u32;
        let mut sum = Vec3::zeros();
        let own = &self.place[self.points_of(node)];
        for (before, p) in own.iter().enumerate() {
            let p = *p as usize;
            for at in self.row(p) {
                let other = self.neighbour(at);
                sum += (u[other as usize].xyz() - u[i].xyz()) * self.numbers(at)[3];
                // A neighbour in several materials counts once.
                let has = |p: &u32| self.row(*p as usize).any(|at| self.neighbour(at) == other);
                if !own[..before].iter().any(has) {
                    sum += self.pull_of(other, node, u);
                }
            }
        }
        sum
    }

    /// What the points of a vertex do to another.
    fn pull_of(&self, from: u32, node: u32, u: &[Lane]) -> Vec3 {
        let mut sum = Vec3::zeros();
        for p in &self.place[self.points_of(from)] {
            let p = *p as usize;
            let at = self.row(p).find(|at| self.neighbour(*at) == node);
            if let Some(at) = at.filter(|_| self.volume(p) > 0.0) {
                let g = self.gradient(p, u);
                let f = Matrix3::identity() + g;
                let stress = self.law.stress(&self.material(p), &f);
                sum += (stress - g * self.hourglass(p)) * self.d(at);
            }
        }
        sum
    }

    /// W \[J\] of a vertex's points, and the power of their forces at velocities v \[W\]. An edge counts by half at
    /// either end.
    pub(crate) fn share(&self, node: u32, u: &[Lane], v: &[Lane]) -> (f64, f64) {
        let (mut energy, mut power) = (0.0, 0.0);
        let i = node as usize;
        let places = self.place[self.points_of(node)].iter().map(|p| *p as usize);
        for p in places.filter(|p| self.volume(*p) > 0.0) {
            let (g, rate) = (self.gradient(p, u), self.gradient(p, v));
            let (volume, c) = (self.volume(p), self.hourglass(p));
            let f = Matrix3::identity() + g;
            let stress = self.law.stress(&self.material(p), &f) - g * c;
            energy += volume * self.law.energy(&self.material(p), &f);
            energy -= 0.5 * c * volume * g.norm_squared();
            power += volume * stress.component_mul(&rate).sum();
            for at in self.row(p) {
                let k = self.neighbour(at) as usize;
                let (w, apart) = (u[k].xyz() - u[i].xyz(), v[k].xyz() - v[i].xyz());
                energy -= 0.25 * self.numbers(at)[3] * w.norm_squared();
                power -= 0.5 * self.numbers(at)[3] * w.dot(&apart);
            }
        }
        (energy, power)
    }

    /// Sums the points of a vertex again over what is left of its star, in the order of a fresh start, which it equals:
    /// `star` gives nodes, shape and number of the material.
    pub(crate) fn sum_again<'a>(
        &mut self,
        node: u32,
        star: impl Iterator<Item = (&'a [u32; 4], &'a Shape, u32)> + Clone,
    ) {
        for at in self.points_of(node) {
            let p = self.place[at] as usize;
            let (material, number) = (self.material[p], self.number[p]);
            let star = star.clone().filter(|(.., own)| *own == number);
            self.renew_row(p, star.clone().flat_map(|(nodes, ..)| *nodes));
            let mut volume = 0.0;
            for (nodes, shape, _) in star {
                volume += shape.volume / 4.0;
                let own = nodes.iter().position(|v| *v == node).unwrap_or(0);
                for (k, other) in nodes.iter().enumerate() {
                    if let Some(at) = self.row(p).find(|at| self.neighbour(*at) == *other) {
                        self.add(at, &entry(shape, &material, self.hourglass, own, k));
                    }
                }
            }
            let (group, lane) = (&mut self.group[p / 4], p % 4);
            group.volume[lane] = volume;
            group.inverse[lane] = if volume > 0.0 { 1.0 / volume } else { 0.0 };
        }
    }

    /// Gives a point these neighbours, itself among them, and entries of zero.
    fn renew_row(&mut self, p: usize, neighbours: impl Iterator<Item = u32>) {
        let (own, g, lane) = (self.vertex(p), p / 4, p % 4);
        self.around.extend(neighbours);
        self.around.sort_unstable_by_key(|v| (*v != own, *v));
        self.around.dedup();
        self.count[p] = self.around.len() as u32;
        // The kernel looks at one entry at least.
        let all = self.count.chunks(4).nth(g).into_iter().flatten();
        let longest = all.fold(1, |most, count| most.max(*count));
        if longest > self.block[g].room {
            self.move_block(g, 2 * longest);
        }
        let block = &mut self.block[g];
        block.end = block.start + longest;
        let (start, room) = (block.start as usize, block.room as usize);
        for k in 0..room {
            let neighbour = self.around.get(k).copied();
            self.column[start + k][lane] = neighbour.unwrap_or(own);
            let Entries(rows) = &mut self.entry[start + k];
            rows.iter_mut().for_each(|row| row[lane] = 0.0);
        }
        self.around.clear();
    }

    /// Gives a group room for so many entries, behind all others.
    fn move_block(&mut self, g: usize, room: u32) {
        let old = self.block[g];
        let new = self.new_block(room, self.node[g]);
        let from = old.start as usize..old.end as usize;
        self.column.copy_within(from.clone(), new.start as usize);
        self.entry.copy_within(from, new.start as usize);
        self.block[g] = new;
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &NodalAveraged) {
        self.penalty = other.penalty;
        self.group.clone_from(&other.group);
        self.node.clone_from(&other.node);
        self.block.clone_from(&other.block);
        self.column.clone_from(&other.column);
        self.entry.clone_from(&other.entry);
        self.material.clone_from(&other.material);
        self.number.clone_from(&other.number);
        self.count.clone_from(&other.count);
        self.place.clone_from(&other.place);
        self.range.clone_from(&other.range);
    }

    /// V_j G_j and the hourglass force of four points.
    #[inline(always)]
    unsafe fn sums<V: Four>(&self, k: usize, u: &[Lane]) -> (Square<V>, Three<V>) {
        // SAFETY: the caller's.
        unsafe {
            let zero = V::splat(0.0);
            let own = V::gather(u, *self.node.get_unchecked(k));
            let (mut g, mut pull) = ([[zero; 3]; 3], [zero; 3]);
            // The first is the vertex itself.
            let block = self.block.get_unchecked(k);
            for at in block.start as usize + 1..block.end as usize {
                let w = lanes::sub3(V::gather(u, *self.column.get_unchecked(at)), own);
                // One number after the other, each with all of w: then there are registers for all the sums.
                let Entries(entries) = self.entry.get_unchecked(at);
                for axis in 0..3 {
                    let d = V::load(&entries[axis]);
                    g[0][axis] = w[0].mul_add(d, g[0][axis]);
                    g[1][axis] = w[1].mul_add(d, g[1][axis]);
                    g[2][axis] = w[2].mul_add(d, g[2][axis]);
                }
                let l = V::load(&entries[3]);
                pull[0] = w[0].mul_add(l, pull[0]);
                pull[1] = w[1].mul_add(l, pull[1]);
                pull[2] = w[2].mul_add(l, pull[2]);
            }
            (g, pull)
        }
    }

    /// Q_j D_jk of four points.
    #[inline(always)]
    unsafe fn force<V: Four>(&self, q: &Square<V>, at: usize) -> Three<V> {
        // SAFETY: the caller's.
        unsafe {
            let Entries([x, y, z, _]) = self.entry.get_unchecked(at);
            product(q, [V::load(x), V::load(y), V::load(z)])
        }
    }

    /// Second derivatives of W \[N/m\]: parts (i, j, block) of the upper half.
    pub fn tangent(&self, u: &[Lane]) -> Vec<(usize, usize, Matrix3<f64>)> {
        let mut entries = Vec::new();
        for p in (0..self.material.len()).filter(|p| self.volume(*p) > 0.0) {
            let f = Matrix3::identity() + self.gradient(p, u);
            let (volume, c) = (self.volume(p), self.hourglass(p));
            let own = self.vertex(p) as usize;
            for k in self.row(p) {
                let d_k = self.d(k);
                let change = |axis: usize| {
                    let df = Vec3::ith(axis, 1.0) * d_k.transpose() / volume;
                    self.law.tangent(&self.material(p), &f, &df)
                };
                let change = [0, 1, 2].map(change);
                for j in self.row(p) {
                    let (i, other) = (self.neighbour(j) as usize, self.neighbour(k) as usize);
                    if i > other {
                        continue;
                    }
                    let d_j = self.d(j);
                    let mut block = Matrix3::from_columns(&change.map(|s| s * d_j));
                    for axis in 0..3 {
                        block[(axis, axis)] -= c * d_j.dot(&d_k) / volume;
                    }
                    entries.push((i, other, block));
                }
                let half = Matrix3::identity() * (0.5 * self.numbers(k)[3]);
                let other = self.neighbour(k) as usize;
                if other != own {
                    entries.push((own, own, -half));
                    entries.push((other, other, -half));
                    entries.push((own.min(other), own.max(other), half));
                }
            }
        }
        entries
    }

    pub fn bytes(&self) -> usize {
        size_of_val(&self.group[..])
            + size_of_val(&self.entry[..])
            + size_of_val(&self.column[..])
            + size_of_val(&self.node[..])
            + size_of_val(&self.block[..])
            + size_of_val(&self.count[..])
            + size_of_val(&self.place[..])
    }
}

impl Kernel for NodalAveraged {
    fn law(&self) -> Law {
        self.law
    }

    fn has_extra(&self) -> bool {
        self.has_fibre || self.penalty > 0.0
    }

    #[allow(private_bounds)] // as the trait
    #[inline(always)]
    unsafe fn kernel<V: Four, R: Response, const EXTRA: bool>(
        &self,
        u: &[Lane],
        to: &mut [Lane],
    ) -> (f64, Extent) {
        // SAFETY: the caller's; places are in range by construction.
        unsafe {
            if self.group.is_empty() {
                return (0.0, Extent::default());
            }
            let half = V::splat(0.5);
            let mut sum = V::splat(0.0);
            let mut reach = Reach::<V>::rest();
            let penalty = V::splat(self.penalty);
            // Hourglass forces balance, so that their work, 1/2 sum_j u_j . force, may be counted from any displacement: from
            // one of the tissue's own a shift takes no digits.
            let Lane([x, y, z, _]) = *u.get_unchecked(self.node[0][0] as usize);
            let origin = [V::splat(x), V::splat(y), V::splat(z)];
            let mut ahead = self.sums(0, u);
            for (k, group) in self.group.iter().enumerate() {
                let (g, pull) = ahead;
                let own = V::gather(u, *self.node.get_unchecked(k));
                let work = lanes::dot(lanes::sub3(own, origin), pull);
                sum = half.mul_add(work, sum);
                let inverse = V::load(&group.inverse);
                let g: Square<V> = [
                    scale(g[0], inverse),
                    scale(g[1], inverse),
                    scale(g[2], inverse),
                ];
                let point = Point::new(g);
                let parameters = [V::load(&group.parameters[0]), V::load(&group.parameters[1])];
                let (mut stress, mut energy) = R::respond(&point, parameters);
                if EXTRA {
                    let a0 = lanes::load3(&group.direction);
                    R::add_fibre(&point, a0, V::load(&group.kappa), &mut stress, &mut energy);
                    volume_penalty::add(&point, penalty, &mut stress, &mut energy);
                }
                if !R::IS_LINEAR {
                    reach.include(&point);
                }
                let c = V::load(&group.hourglass);
                let square = lanes::dot(g[0], g[0])
                    .add(lanes::dot(g[1], g[1]))
                    .add(lanes::dot(g[2], g[2]));
                let less = half.mul(c).mul(square);
                sum = energy.sub(less).mul_add(V::load(&group.volume), sum);
                let minus = V::splat(0.0).sub(c);
                let mut q = stress;
                for row in 0..3 {
                    q[row][0] = minus.mul_add(g[row][0], stress[row][0]);
                    q[row][1] = minus.mul_add(g[row][1], stress[row][1]);
                    q[row][2] = minus.mul_add(g[row][2], stress[row][2]);
                }
                // The next points' sums fill the time that the forces wait for the law.
                if k + 1 < self.group.len() {
                    ahead = self.sums(k + 1, u);
                }
                let block = self.block.get_unchecked(k);
                let (first, end) = (block.start as usize, block.end as usize);
                let force = self.force(&q, first);
                let force = [
                    force[0].add(pull[0]),
                    force[1].add(pull[1]),
                    force[2].add(pull[2]),
                ];
                V::scatter(force, to, *self.column.get_unchecked(first));
                for at in first + 1..end {
                    V::scatter(self.force(&q, at), to, *self.column.get_unchecked(at));
                }
            }
            let [a, b, c, d] = sum.store();
            ((a + b) + (c + d), reach.extent())
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::element::Elements;
    use crate::live::LiveMesh;
    use crate::{prepared, scene};

    fn averaged(live: &LiveMesh) -> &NodalAveraged {
        match &live.elements {
            Some(Elements::NodalAveraged(own, _)) => own,
            _ => unreachable!(),
        }
    }

    /// Summed after each cut or once after all, in the same places or not: the same to the bit. Nothing has allocated.
    #[test]
    fn rows_that_outgrow_their_places_are_as_good_as_fresh_ones() {
        let text = r#"{"name": "block", "mesh": {"box": {"size": [0.05, 0.04, 0.03], "cells": [5, 4, 3]}},
            "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1000},
              {"where": {"box": {"min": [0, 0, 0], "max": [0.025, 0.025, 1]}},
               "youngModulus": 20000, "poissonRatio": 0.3, "density": 1000}],
            "fixed": [{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}],
            "model": {"elasticity": "stVenantKirchhoff", "element": "nodalAveraged"},
            "cutting": {"rule": "duplicate"}}"#;
        let scene = scene::parse(text, "scene.json").unwrap();
        let model = prepared::prepare(scene, Path::new("scene.json")).unwrap();
        let whole = || LiveMesh::after(&model, &[], &[]);
        let room = |live: &LiveMesh| {
            let own = averaged(live);
            let points = [
                own.number.capacity(),
                own.count.capacity(),
                own.place.capacity(),
            ];
            let groups = [
                own.group.capacity(),
                own.node.capacity(),
                own.block.capacity(),
            ];
            let entries = [
                own.column.capacity(),
                own.entry.capacity(),
                own.around.capacity(),
            ];
            (points, groups, entries, own.material.capacity())
        };
        let mut live = whole();
        let before = room(&live);
        let blocks = averaged(&live).block.len();
        let mut round = 0;
        // Until there is no spare left.
        'all: loop {
            for t in 0..model.shape.len() as u32 {
                let node = live.tetrahedra[t as usize][round % 4];
                let star: Vec<u32> = live.star(&model, node).collect();
                if t % 5 == 0 && live.alive[t as usize] {
                    live.remove(&model, t);
                } else if star.len() > 1 {
                    let half = &star[..star.len() / 2];
                    if live.split(&model, node, half).is_none() {
                        break 'all;
                    }
                }
                live.settle(&model);
            }
            round += 1;
        }
        live.settle(&model);
        let at_once = LiveMesh::after(&model, &live.removed, &live.splits);
        let (own, other) = (averaged(&live), averaged(&at_once));
        assert!(own == other && before == room(&live) && before == room(&at_once));
        let moved = |own: &NodalAveraged| {
            let first = averaged(&whole()).column.len() as u32;
            own.block[..blocks]
                .iter()
                .filter(|b| b.start >= first)
                .count()
        };
        println!(
            "{} of {blocks} groups moved, {} new, {} of {} entries used",
            moved(own),
            own.block.len() - blocks,
            own.column.len(),
            own.column.capacity()
        );
        assert!(moved(own) > 10 && moved(other) > 10 && own.block.len() > blocks + 5);
        assert!(own.column.len() != other.column.len());
        let u: Vec<Lane> = (0..live.rest.len())
            .map(|i| [1.1, 1.7, 2.3].map(|n| 1e-3 * (n * i as f64).sin()))
            .map(|[x, y, z]| Lane([x, y, z, 0.0]))
            .collect();
        let forces = |own: &NodalAveraged| {
            let mut to = vec![Lane::default(); u.len()];
            let (energy, _) = own.add_forces(&u, &mut to);
            (energy, to)
        };
        assert!(forces(own) == forces(other));
        let fresh = NodalAveraged::new(own.law, own.hourglass, &live.tetrahedra, |t| {
            let law = &model.material(t).law;
            live.alive[t].then(|| (&model.shape[t], law, model.material_number(t)))
        });
        let ((energy, own), (fresh_energy, fresh)) = (forces(own), forces(&fresh));
        assert!((energy / fresh_energy - 1.0).abs() < 1e-13);
        let most = own.iter().map(|f| f.xyz().norm()).fold(0.0, f64::max);
        for (a, b) in own.iter().zip(&fresh) {
            assert!((a.xyz() - b.xyz()).norm() < 1e-13 * most);
        }
    }
}
