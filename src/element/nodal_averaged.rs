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
use crate::lanes::{self, Four, Square};
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

/// One neighbour of a point: D_jk \[m²\] and c mu L_jk \[N/m\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
struct Entry([f64; 4]);

/// Points in the order of their vertices; those of vertices that cuts have made behind them.
#[derive(Clone, Debug)]
pub struct NodalAveraged {
    pub law: Law,
    /// c \[1\]
    hourglass: f64,
    has_fibre: bool,
    /// k of [`crate::law::volume_penalty`] \[Pa\]; the materials' own do not count.
    pub penalty: f64,
    group: Vec<Group>,
    /// A place of a group each: the vertex; its entries are `start[p]..end[p]`, with D_jj in the first.
    node: Vec<u32>,
    start: Vec<u32>,
    end: Vec<u32>,
    column: Vec<u32>,
    entry: Vec<Entry>,
    /// A point each: its material, what the scene counts that as, and how many entries it has room for.
    material: Vec<Hooke>,
    number: Vec<u32>,
    room: Vec<u32>,
    /// A vertex each: the first of its points, and past the last.
    range: Vec<[u32; 2]>,
    /// Scratch, left empty.
    around: Vec<u32>,
}

/// Where entries are is of no account.
impl PartialEq for NodalAveraged {
    fn eq(&self, other: &NodalAveraged) -> bool {
        let row = |of: &NodalAveraged, p: usize| {
            let row = of.row(p);
            (of.column[row.clone()].to_vec(), of.entry[row].to_vec())
        };
        (self.law, self.hourglass, self.has_fibre, self.penalty)
            == (other.law, other.hourglass, other.has_fibre, other.penalty)
            && (
                &self.group,
                &self.node,
                &self.material,
                &self.number,
                &self.range,
            ) == (
                &other.group,
                &other.node,
                &other.material,
                &other.number,
                &other.range,
            )
            && (0..self.node.len()).all(|p| row(self, p) == row(other, p))
    }
}

/// What a tetrahedron adds to its corner j for its corner k.
fn entry(shape: &Shape, material: &Hooke, c: f64, j: usize, k: usize) -> Entry {
    let d = shape.gradient[k] * (shape.volume / 4.0);
    let l = shape.volume * shape.gradient[j].dot(&shape.gradient[k]);
    let l = if j == k { 0.0 } else { c * material.mu * l };
    Entry([d.x, d.y, d.z, l])
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
        let mut pairs: Vec<(u32, u32, u32, Entry)> = Vec::new();
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
            start: Vec::new(),
            end: Vec::new(),
            column: Vec::new(),
            entry: Vec::new(),
            material: Vec::new(),
            number: Vec::new(),
            room: Vec::new(),
            range: vec![[0; 2]; nodes as usize],
            around: Vec::new(),
        };
        let points = pairs.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1));
        let same = volumes.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1));
        for (point, own) in points.zip(same) {
            let volume: f64 = own.iter().map(|p| p.2).sum();
            let p = made.add_point(own[0].0, volume, &own[0].3, own[0].1);
            for entries in point.chunk_by(|a, b| a.2 == b.2) {
                made.column.push(entries[0].2);
                let sum = |axis: usize| entries.iter().map(|e| e.3.0[axis]).sum::<f64>();
                made.entry.push(Entry([sum(0), sum(1), sum(2), sum(3)]));
            }
            made.end[p] = made.column.len() as u32;
            made.room[p] = made.end[p] - made.start[p];
        }
        made
    }

    /// Its place; without entries.
    fn add_point(&mut self, node: u32, volume: f64, material: &Hooke, number: u32) -> usize {
        let p = self.material.len();
        let lane = p % 4;
        if lane == 0 {
            self.node.extend([node; 4]);
            self.start.extend([0; 4]);
            self.end.extend([0; 4]);
            self.group.push(Group {
                parameters: Default::default(),
                volume: Default::default(),
                inverse: Default::default(),
                hourglass: Default::default(),
                direction: Default::default(),
                kappa: Default::default(),
            });
        }
        // What is left of the group is no point yet.
        self.node[p..].fill(node);
        self.start[p] = self.column.len() as u32;
        self.end[p] = self.start[p];
        self.material.push(*material);
        self.number.push(number);
        self.room.push(0);
        let range = &mut self.range[node as usize];
        if range[1] == 0 {
            range[0] = p as u32;
        }
        range[1] = p as u32 + 1;
        let group = &mut self.group[p / 4];
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

    /// Gives a vertex that a cut makes points as another has, with nothing in them yet.
    pub(crate) fn open(&mut self, new: u32, from: u32) {
        for p in self.points_of(from) {
            let (material, number) = (self.material[p], self.number[p]);
            self.add_point(new, 0.0, &material, number);
        }
    }

    /// Room for so many vertices that cuts make, which have so many neighbours in all: none allocates. A row that
    /// outgrows its place gets one of twice the size, so that four times what there ever was is enough.
    pub(crate) fn reserve(&mut self, vertices: usize, neighbours: usize) {
        let most = self.range.iter().map(|[from, to]| to - from).max();
        let each = most.unwrap_or(0) as usize;
        let points = each * vertices;
        self.group.reserve(points / 4 + 1);
        self.material.reserve(points);
        self.number.reserve(points);
        self.room.reserve(points);
        for places in [&mut self.node, &mut self.start, &mut self.end] {
            places.reserve(points + 4);
        }
        if vertices > 0 {
            let entries = 3 * self.column.len() + 6 * each * neighbours;
            self.column.reserve(entries);
            self.entry.reserve(entries);
        }
        let longest = self.room.iter().max().copied().unwrap_or(0) as usize;
        self.around.reserve(16 * longest);
    }

    fn row(&self, p: usize) -> std::ops::Range<usize> {
        self.start[p] as usize..self.end[p] as usize
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
        let [x, y, z, _] = self.entry[at].0;
        Vec3::new(x, y, z)
    }

    /// G_j, alone.
    fn gradient(&self, p: usize, u: &[Lane]) -> Matrix3<f64> {
        let own = u[self.node[p] as usize].xyz();
        let mut sum = Matrix3::zeros();
        for at in self.row(p) {
            let w = u[self.column[at] as usize].xyz() - own;
            sum += w * self.d(at).transpose();
        }
        sum / self.volume(p)
    }

    /// Places p of points of a vertex.
    fn points_of(&self, node: u32) -> std::ops::Range<usize> {
        let [from, to] = self.range[node as usize];
        from as usize..to as usize
    }

    /// dW/du_i \[N\], alone: for the few vertices whose reaction is wanted.
    pub fn node_force(&self, i: usize, u: &[Lane]) -> Vec3 {
        let node = i as u32;
        let mut sum = Vec3::zeros();
        let own = self.points_of(node);
        for p in own.clone() {
            for at in self.row(p) {
                let other = self.column[at];
                sum += (u[other as usize].xyz() - u[i].xyz()) * self.entry[at].0[3];
                // A neighbour in several materials counts once.
                let seen = |before: usize| self.column[self.row(before)].contains(&other);
                if !(own.start..p).any(seen) {
                    sum += self.pull_of(other, node, u);
                }
            }
        }
        sum
    }

    /// What the points of a vertex do to another.
    fn pull_of(&self, from: u32, node: u32, u: &[Lane]) -> Vec3 {
        let mut sum = Vec3::zeros();
        for p in self.points_of(from) {
            let at = self.row(p).find(|at| self.column[*at] == node);
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
        for p in self.points_of(node).filter(|p| self.volume(*p) > 0.0) {
            let (g, rate) = (self.gradient(p, u), self.gradient(p, v));
            let (volume, c) = (self.volume(p), self.hourglass(p));
            let f = Matrix3::identity() + g;
            let stress = self.law.stress(&self.material(p), &f) - g * c;
            energy += volume * self.law.energy(&self.material(p), &f);
            energy -= 0.5 * c * volume * g.norm_squared();
            power += volume * stress.component_mul(&rate).sum();
            for at in self.row(p) {
                let k = self.column[at] as usize;
                let (w, apart) = (u[k].xyz() - u[i].xyz(), v[k].xyz() - v[i].xyz());
                energy -= 0.25 * self.entry[at].0[3] * w.norm_squared();
                power -= 0.5 * self.entry[at].0[3] * w.dot(&apart);
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
        for p in self.points_of(node) {
            let (material, number) = (self.material[p], self.number[p]);
            let star = star.clone().filter(|(.., own)| *own == number);
            let row = self.renew_row(p, star.clone().flat_map(|(nodes, ..)| *nodes));
            let mut volume = 0.0;
            for (nodes, shape, _) in star {
                volume += shape.volume / 4.0;
                let own = nodes.iter().position(|v| *v == node).unwrap_or(0);
                for (k, other) in nodes.iter().enumerate() {
                    let Some(at) = row.clone().find(|at| self.column[*at] == *other) else {
                        continue;
                    };
                    let Entry(add) = entry(shape, &material, self.hourglass, own, k);
                    for (sum, add) in self.entry[at].0.iter_mut().zip(add) {
                        *sum += add;
                    }
                }
            }
            let (group, lane) = (&mut self.group[p / 4], p % 4);
            group.volume[lane] = volume;
            group.inverse[lane] = if volume > 0.0 { 1.0 / volume } else { 0.0 };
        }
    }

    /// Gives a point these neighbours, itself among them, and entries of zero.
    fn renew_row(
        &mut self,
        p: usize,
        neighbours: impl Iterator<Item = u32>,
    ) -> std::ops::Range<usize> {
        let own = self.node[p];
        self.around.extend(neighbours);
        self.around.sort_unstable_by_key(|v| (*v != own, *v));
        self.around.dedup();
        let count = self.around.len();
        if count > self.room[p] as usize {
            self.start[p] = self.column.len() as u32;
            self.room[p] = 2 * count as u32;
            let end = self.column.len() + 2 * count;
            self.column.resize(end, own);
            self.entry.resize(end, Entry::default());
        }
        self.end[p] = self.start[p] + count as u32;
        let row = self.row(p);
        self.column[row.clone()].copy_from_slice(&self.around);
        self.entry[row.clone()].fill(Entry::default());
        self.around.clear();
        row
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &NodalAveraged) {
        self.penalty = other.penalty;
        self.group.clone_from(&other.group);
        self.node.clone_from(&other.node);
        self.start.clone_from(&other.start);
        self.end.clone_from(&other.end);
        self.column.clone_from(&other.column);
        self.entry.clone_from(&other.entry);
        self.material.clone_from(&other.material);
        self.number.clone_from(&other.number);
        self.room.clone_from(&other.room);
        self.range.clone_from(&other.range);
    }

    /// Second derivatives of W \[N/m\]: parts (i, j, block) of the upper half.
    pub fn tangent(&self, u: &[Lane]) -> Vec<(usize, usize, Matrix3<f64>)> {
        let mut entries = Vec::new();
        for p in (0..self.material.len()).filter(|p| self.volume(*p) > 0.0) {
            let f = Matrix3::identity() + self.gradient(p, u);
            let (volume, c) = (self.volume(p), self.hourglass(p));
            let own = self.node[p] as usize;
            for k in self.row(p) {
                let d_k = self.d(k);
                let change = |axis: usize| {
                    let df = Vec3::ith(axis, 1.0) * d_k.transpose() / volume;
                    self.law.tangent(&self.material(p), &f, &df)
                };
                let change = [0, 1, 2].map(change);
                for j in self.row(p) {
                    let (i, other) = (self.column[j] as usize, self.column[k] as usize);
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
                let half = Matrix3::identity() * (0.5 * self.entry[k].0[3]);
                let other = self.column[k] as usize;
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
            + size_of_val(&self.start[..])
            + size_of_val(&self.end[..])
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
            let zero = V::splat(0.0);
            let (mut sum, mut variance) = (zero, zero);
            let mut reach = Reach::<V>::rest();
            let penalty = V::splat(self.penalty);
            for (k, group) in self.group.iter().enumerate() {
                // Rows of the transpose of G, a point each; the fourth axis is zero.
                let mut columns = [[zero; 4]; 3];
                for lane in 0..4 {
                    let p = 4 * k + lane;
                    let own = *self.node.get_unchecked(p) as usize;
                    let u_j = V::load(&u.get_unchecked(own).0);
                    let (mut x, mut y, mut z, mut hourglass) = (zero, zero, zero, zero);
                    let end = *self.end.get_unchecked(p) as usize;
                    for at in *self.start.get_unchecked(p) as usize..end {
                        let other = *self.column.get_unchecked(at) as usize;
                        let [d0, d1, d2, l] = self.entry.get_unchecked(at).0;
                        let w = V::load(&u.get_unchecked(other).0).sub(u_j);
                        x = w.mul_add(V::splat(d0), x);
                        y = w.mul_add(V::splat(d1), y);
                        z = w.mul_add(V::splat(d2), z);
                        let pull = w.mul(V::splat(l));
                        hourglass = hourglass.add(pull);
                        variance = pull.mul_add(w, variance);
                    }
                    let inverse = V::splat(group.inverse[lane]);
                    columns[0][lane] = x.mul(inverse);
                    columns[1][lane] = y.mul(inverse);
                    columns[2][lane] = z.mul(inverse);
                    let force = &mut to.get_unchecked_mut(own).0;
                    *force = V::load(force).add(hourglass).store();
                }
                let x = V::transpose(columns[0]);
                let y = V::transpose(columns[1]);
                let z = V::transpose(columns[2]);
                let g: Square<V> = [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]];
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
                let half = V::splat(-0.5).mul(c);
                sum = half
                    .mul_add(square, energy)
                    .mul_add(V::load(&group.volume), sum);
                let minus = zero.sub(c);
                let mut q = stress;
                for row in 0..3 {
                    q[row][0] = minus.mul_add(g[row][0], stress[row][0]);
                    q[row][1] = minus.mul_add(g[row][1], stress[row][1]);
                    q[row][2] = minus.mul_add(g[row][2], stress[row][2]);
                }
                let x = V::transpose([q[0][0], q[1][0], q[2][0], zero]);
                let y = V::transpose([q[0][1], q[1][1], q[2][1], zero]);
                let z = V::transpose([q[0][2], q[1][2], q[2][2], zero]);
                for lane in 0..4 {
                    let p = 4 * k + lane;
                    let end = *self.end.get_unchecked(p) as usize;
                    for at in *self.start.get_unchecked(p) as usize..end {
                        let other = *self.column.get_unchecked(at) as usize;
                        let [d0, d1, d2, _] = self.entry.get_unchecked(at).0;
                        let force = &mut to.get_unchecked_mut(other).0;
                        let sum = x[lane].mul_add(V::splat(d0), V::load(force));
                        let sum = y[lane].mul_add(V::splat(d1), sum);
                        *force = z[lane].mul_add(V::splat(d2), sum).store();
                    }
                }
            }
            let [a, b, c, d] = sum.store();
            let [x, y, z, _] = variance.store();
            // Each edge has been seen from both ends.
            let energy = (a + b) + (c + d) - 0.25 * ((x + y) + z);
            (energy, reach.extent())
        }
    }
}
