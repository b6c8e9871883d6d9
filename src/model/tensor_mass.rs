//! The papers' tensor-mass form of a linear stiffness matrix: one 3x3 tensor a vertex and one an edge.
//!
//! Upper-half block CSR: row i holds its vertex tensor K_ii, then the edge tensors K_ij of its
//! neighbours j > i, ascending. The other direction is the transpose, K_ji = K_ij^T, so the order of
//! an edge's ends never matters. (Cotin, Delingette, Ayache 1998, section 5.)

use nalgebra::Matrix3;

use crate::element::constant_strain::Shape;
use crate::lanes::{self, Four, Plain};
use crate::law::linear::Hooke;
use crate::mesh::Vec3;
use crate::mesh::topology::NONE;

/// Three numbers and a zero, aligned for a 32-byte load.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
pub struct Lane(pub [f64; 4]);

impl Lane {
    pub fn xyz(&self) -> Vec3 {
        Vec3::new(self.0[0], self.0[1], self.0[2])
    }
}

impl From<Vec3> for Lane {
    fn from(v: Vec3) -> Lane {
        Lane([v.x, v.y, v.z, 0.0])
    }
}

/// Which vertices share an edge. Shared by all instances, but where cuts split vertices: then each has its own.
///
/// The first nodes may be spares for vertices that split. They are used from the last to the first, each with a
/// row of all its neighbours, so that rows stay sorted and a sweep begins at the newest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pattern {
    /// Row i is `row_start[i]..row_start[i + 1]` of `column`; its first entry is i itself. Rows of spares
    /// that are not in use are empty.
    pub row_start: Vec<u32>,
    pub column: Vec<u32>,
    /// First row in use.
    pub first: usize,
    /// Of rows that were opened: the last entry (row, place, entry before) with each node as its column.
    opened_last: Vec<u32>,
    opened: Vec<[u32; 3]>,
    /// Entries (row, place in `column`) with column i and row < i: what row i holds as transposes.
    lower_start: Vec<u32>,
    lower: Vec<(u32, u32)>,
}

/// Places that a spare row has, on the average.
const SPARE_ROW: usize = 14;

impl Pattern {
    pub fn new(nodes: usize, tetrahedra: &[[u32; 4]]) -> Pattern {
        Pattern::with_spares(0, nodes, tetrahedra)
    }

    /// The first `spares` of the nodes belong to no tetrahedron.
    pub fn with_spares(spares: usize, nodes: usize, tetrahedra: &[[u32; 4]]) -> Pattern {
        let mut edges: Vec<(u32, u32)> = Vec::with_capacity(6 * tetrahedra.len());
        for t in tetrahedra {
            for a in 0..4 {
                for b in a + 1..4 {
                    edges.push((t[a].min(t[b]), t[a].max(t[b])));
                }
            }
        }
        Pattern::of_edges(spares, nodes, edges)
    }

    /// `edges`: pairs i <= j, in any order and as often as there are.
    fn of_edges(spares: usize, nodes: usize, mut edges: Vec<(u32, u32)>) -> Pattern {
        edges.extend((spares as u32..nodes as u32).map(|i| (i, i)));
        edges.sort_unstable();
        edges.dedup();
        let pool = SPARE_ROW * spares;
        let mut row_start = vec![0u32; nodes + 1];
        row_start[0] = pool as u32;
        let mut lower_start = vec![0u32; nodes + 1];
        for (i, j) in &edges {
            row_start[*i as usize + 1] += 1;
            if i != j {
                lower_start[*j as usize + 1] += 1;
            }
        }
        for i in 0..nodes {
            row_start[i + 1] += row_start[i];
            lower_start[i + 1] += lower_start[i];
        }
        let mut next = lower_start.clone();
        let mut lower = vec![(0, 0); edges.len() - (nodes - spares)];
        for (place, (i, j)) in edges.iter().enumerate() {
            if i != j {
                lower[next[*j as usize] as usize] = (*i, (pool + place) as u32);
                next[*j as usize] += 1;
            }
        }
        let mut column = vec![0; pool];
        column.extend(edges.into_iter().map(|e| e.1));
        Pattern {
            row_start,
            column,
            first: spares,
            opened_last: if spares > 0 {
                vec![NONE; nodes]
            } else {
                Vec::new()
            },
            opened: Vec::with_capacity(pool),
            lower_start,
            lower,
        }
    }

    pub fn nodes(&self) -> usize {
        self.row_start.len() - 1
    }

    pub fn edges(&self) -> usize {
        self.column.len() - self.row_start[self.first] as usize - (self.nodes() - self.first)
    }

    /// Gives the next spare a row. `neighbours` ascend. None where there is no room.
    pub(crate) fn open(&mut self, neighbours: &[u32]) -> Option<u32> {
        let row = self.first.checked_sub(1)?;
        let end = self.row_start[self.first] as usize;
        let start = end.checked_sub(1 + neighbours.len())?;
        self.column[start] = row as u32;
        self.column[start + 1..end].copy_from_slice(neighbours);
        for (k, j) in neighbours.iter().enumerate() {
            let before =
                std::mem::replace(&mut self.opened_last[*j as usize], self.opened.len() as u32);
            self.opened
                .push([row as u32, (start + 1 + k) as u32, before]);
        }
        self.row_start[..=row].fill(start as u32);
        self.first = row;
        Some(row as u32)
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &Pattern) {
        self.row_start.clone_from(&other.row_start);
        self.column.clone_from(&other.column);
        self.first = other.first;
        self.opened_last.clone_from(&other.opened_last);
        self.opened.clone_from(&other.opened);
        self.lower_start.clone_from(&other.lower_start);
        self.lower.clone_from(&other.lower);
    }

    /// Entries that rows to be opened can have in all.
    pub(crate) fn spare_places(&self) -> usize {
        self.row_start[self.first] as usize
    }

    /// Room for all rows that can be opened.
    pub(crate) fn reserve(&mut self) {
        self.opened.reserve(self.row_start[self.first] as usize);
    }

    pub(super) fn row(&self, i: usize) -> std::ops::Range<usize> {
        self.row_start[i] as usize..self.row_start[i + 1] as usize
    }

    /// Neighbours j < i of node i, each with the place of (j, i).
    pub(super) fn lower(&self, i: usize) -> impl Iterator<Item = (u32, u32)> + '_ {
        let own = &self.lower[self.lower_start[i] as usize..self.lower_start[i + 1] as usize];
        let mut next = self.opened_last.get(i).copied().unwrap_or(NONE);
        let opened = std::iter::from_fn(move || {
            let [row, place, before] = *self.opened.get(next as usize)?;
            next = before;
            Some((row, place))
        });
        own.iter().copied().chain(opened)
    }

    /// Place of the tensor of (i, j), i <= j.
    pub(super) fn place(&self, i: u32, j: u32) -> Option<usize> {
        let row = self.row(i as usize);
        self.column[row.clone()]
            .binary_search(&j)
            .ok()
            .map(|k| row.start + k)
    }
}

/// The tensors \[N/m\]: 9 numbers a place of [`Pattern::column`], by rows, and padding so that a
/// four-wide load of any row stays inside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensors(pub(crate) Vec<f64>);

impl Tensors {
    pub fn zeros(pattern: &Pattern) -> Tensors {
        Tensors(vec![0.0; 9 * pattern.column.len() + 3])
    }

    /// Of parts (i, j, K_ij), i <= j, in a pattern of their own.
    pub fn assemble(nodes: usize, parts: &[(usize, usize, Matrix3<f64>)]) -> (Pattern, Tensors) {
        let edges = parts.iter().map(|(i, j, _)| (*i as u32, *j as u32));
        let pattern = Pattern::of_edges(0, nodes, edges.collect());
        let mut tensors = Tensors::zeros(&pattern);
        for (i, j, block) in parts {
            if let Some(place) = pattern.place(*i as u32, *j as u32) {
                tensors.add(place, block);
            }
        }
        (pattern, tensors)
    }

    /// Adds one tetrahedron: four vertex tensors, six edge tensors.
    pub fn accumulate(&mut self, pattern: &Pattern, nodes: &[u32; 4], shape: &Shape, law: &Hooke) {
        for j in 0..4 {
            for k in 0..4 {
                if nodes[j] > nodes[k] {
                    continue;
                }
                let Some(place) = pattern.place(nodes[j], nodes[k]) else {
                    continue;
                };
                let block =
                    law.stiffness_block(shape.volume, &shape.gradient[j], &shape.gradient[k]);
                self.add(place, &block);
            }
        }
    }

    pub(super) fn add(&mut self, place: usize, block: &Matrix3<f64>) {
        let stored = &mut self.0[9 * place..9 * place + 9];
        for row in 0..3 {
            for column in 0..3 {
                stored[3 * row + column] += block[(row, column)];
            }
        }
    }

    /// The tensor of (i, j), either order; zero where they share no edge.
    pub fn block(&self, pattern: &Pattern, i: u32, j: u32) -> Matrix3<f64> {
        match pattern.place(i.min(j), i.max(j)) {
            None => Matrix3::zeros(),
            Some(place) if i <= j => self.at(place),
            Some(place) => self.at(place).transpose(),
        }
    }

    /// Replaces the tensor of i (with i = j) or of an edge, given as that from the lower to the higher node.
    pub(crate) fn set(&mut self, pattern: &Pattern, i: u32, j: u32, block: &Matrix3<f64>) {
        if let Some(place) = pattern.place(i.min(j), i.max(j)) {
            let stored = &mut self.0[9 * place..9 * place + 9];
            for (k, number) in stored.iter_mut().enumerate() {
                *number = block[(k / 3, k % 3)];
            }
        }
    }

    /// K_ii = - sum_j K_ij, in the order of the pattern: a translation strains nothing.
    pub(crate) fn close(&mut self, pattern: &Pattern, i: usize) {
        let row = pattern.row(i);
        let mut sum = [0.0; 9];
        for (_, place) in pattern.lower(i) {
            let block = &self.0[9 * place as usize..9 * place as usize + 9];
            for k in 0..9 {
                sum[k] -= block[3 * (k % 3) + k / 3];
            }
        }
        for place in row.start + 1..row.end {
            let block = &self.0[9 * place..9 * place + 9];
            for k in 0..9 {
                sum[k] -= block[k];
            }
        }
        if !row.is_empty() {
            self.0[9 * row.start..9 * row.start + 9].copy_from_slice(&sum);
        }
    }

    /// Numbers `from` to `from` + 3.
    ///
    /// # Safety
    /// As [`Four`]; `from` is in a place of the pattern, behind the last of which is padding.
    #[inline(always)]
    unsafe fn quad<V: Four>(&self, from: usize) -> V {
        debug_assert!(from + 4 <= self.0.len());
        // SAFETY: the caller's; an array of four f64 has the alignment of one.
        unsafe { V::load(&*self.0.as_ptr().add(from).cast()) }
    }

    fn at(&self, place: usize) -> Matrix3<f64> {
        Matrix3::from_row_slice(&self.0[9 * place..9 * place + 9])
    }

    /// Tensors K_ij of row i with j >= i.
    pub fn upper_row<'a>(
        &'a self,
        pattern: &'a Pattern,
        i: usize,
    ) -> impl Iterator<Item = (usize, Matrix3<f64>)> + 'a {
        let row = pattern.row(i);
        row.map(|place| (pattern.column[place] as usize, self.at(place)))
    }

    /// (K u)_i \[N\], alone: for the few vertices whose reaction is wanted.
    pub fn row_product(&self, pattern: &Pattern, i: usize, u: &[Lane]) -> Vec3 {
        let mut sum = Vec3::zeros();
        for place in pattern.row(i) {
            sum += self.at(place) * u[pattern.column[place] as usize].xyz();
        }
        for (j, place) in pattern.lower(i) {
            sum += self.at(place as usize).tr_mul(&u[j as usize].xyz());
        }
        sum
    }

    /// K u \[N\] of nodes that share tensors with each other alone, which `to` gets; its fourth lane is undefined.
    pub fn products_among(&self, pattern: &Pattern, nodes: &[u32], u: &[Lane], to: &mut [Lane]) {
        assert!(self.0.len() == 9 * pattern.column.len() + 3);
        #[cfg(target_arch = "x86_64")]
        if lanes::has_avx2() {
            // SAFETY: it is there; the length is checked.
            return unsafe { avx2_among(self, pattern, nodes, u, to) };
        }
        // SAFETY: plain code needs no machine; the length is checked.
        unsafe { among::<Plain>(self, pattern, nodes, u, to) }
    }

    /// K u \[N\], plain. Also the oracle of the fused sweep.
    pub fn product(&self, pattern: &Pattern, u: &[Lane], out: &mut [Vec3]) {
        out.fill(Vec3::zeros());
        for i in 0..pattern.nodes() {
            let u_i = u[i].xyz();
            for place in pattern.row(i) {
                let j = pattern.column[place] as usize;
                let block = self.at(place);
                out[i] += block * u[j].xyz();
                if j != i {
                    out[j] += block.tr_mul(&u_i);
                }
            }
        }
    }

    /// Places (i, j, K_ij), i <= j, for a sparse factorisation.
    pub fn entries<'a>(
        &'a self,
        pattern: &'a Pattern,
    ) -> impl Iterator<Item = (usize, usize, Matrix3<f64>)> + 'a {
        (0..pattern.nodes()).flat_map(move |i| {
            pattern
                .row(i)
                .map(move |place| (i, pattern.column[place] as usize, self.at(place)))
        })
    }

    pub fn bytes(&self) -> usize {
        8 * self.0.len()
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2_among(t: &Tensors, pattern: &Pattern, nodes: &[u32], u: &[Lane], to: &mut [Lane]) {
    // SAFETY: the caller's.
    unsafe { among::<lanes::Avx2>(t, pattern, nodes, u, to) }
}

/// # Safety
/// As [`Four`]; tensors are as many as places.
#[inline(always)]
unsafe fn among<V: Four>(
    tensors: &Tensors,
    pattern: &Pattern,
    nodes: &[u32],
    u: &[Lane],
    to: &mut [Lane],
) {
    for i in nodes {
        to[*i as usize] = Lane::default();
    }
    for i in nodes.iter().map(|i| *i as usize) {
        // SAFETY: the caller's; places are the pattern's.
        unsafe {
            let zero = V::splat(0.0);
            let mut row = [zero; 3];
            let by = [u[i].0[0], u[i].0[1], u[i].0[2]].map(|x| V::splat(x));
            let own = pattern.row(i);
            for place in own.clone() {
                let j = pattern.column[place] as usize;
                let u = V::load(&u[j].0);
                let mut back = V::load(&to[j].0);
                for k in 0..3 {
                    let numbers = tensors.quad::<V>(9 * place + 3 * k);
                    row[k] = numbers.mul_add(u, row[k]);
                    back = numbers.mul_add(by[k], back);
                }
                if place > own.start {
                    to[j].0 = back.store();
                }
            }
            let turned = V::transpose([row[0], row[1], row[2], zero]);
            let sum = turned[0].add(turned[1]).add(turned[2]);
            to[i].0 = sum.add(V::load(&to[i].0)).store();
        }
    }
}
