//! Adaptive non-linearity: the linear law where tissue hardly deforms, one that is right under rotation where it does.
//!
//! The linear tensors stand for all tetrahedra. Where h |G| exceeds a threshold tau \[m\], h the edge of a regular tetrahedron of
//! the same volume and G the displacement gradient, there comes on top, with W_N the other law's energy and W_L the linear one's,
//!
//! V w(x) (W_N - W_L),  x = h² |G|² / tau²,  w = s² (3 - 2 s),  s = (x - 1)/3 within 0 and 1
//! P = w (P_N - P_L) + 2 s (1 - s) 2 h²/tau² (W_N - W_L) G
//!
//! so that one smooth energy gives all forces: they balance, and no energy comes from tetrahedra that change law. The cost
//! is that of the tetrahedra beyond the threshold.
//!
//! The papers' rule (Picinbono, Delingette, Ayache 2003, section 4) instead gives each vertex that has moved by more than tau the
//! other law's force, and each other one the linear law's. Those have no energy and do not balance: it is here to be
//! compared with.

use nalgebra::Matrix3;

use super::constant_strain::Shape;
use super::tetrahedra::{Extent, Reach, corner_forces, differences, gradient};
use crate::lanes::{self, Four, Plain, Square, Three, dot, product, sub3};
use crate::law::linear::Hooke;
use crate::law::response::{Law, Point, Response};
use crate::law::st_venant_kirchhoff::StVenantKirchhoff;
use crate::law::stable_neo_hookean::StableNeoHookean;
use crate::mesh::Vec3;
use crate::mesh::topology::NONE;
use crate::model::tensor_mass::Lane;
use crate::scene::Adaptive;

/// Share of the threshold from which a tetrahedron is listed: what is not may move on for a while.
const LISTED: f64 = 0.9;

/// Rows of a [`Group`] after the gradients' nine.
const PARAMETERS: usize = 9;
const LAME: usize = 11;
const SQUARE: usize = 13;
const DIRECTION: usize = 14;
const KAPPA: usize = 17;
const ROWS: usize = 18;

/// Four tetrahedra side by side. A place that holds none, or a dead one, has neither gradients nor stiffness.
#[derive(Clone, Debug, Default, PartialEq)]
#[repr(C, align(64))]
struct Group {
    /// A corner each.
    node: [[u32; 4]; 4],
    /// a_1, a_2, a_3 \[1/m\], an axis each; numbers of [`Response::parameters`] and Lame's, times V \[J\]; h² \[m²\]; direction of
    /// the fibre and kappa V \[J\].
    row: [[f64; 4]; ROWS],
}

impl Group {
    fn fill(&mut self, lane: usize, law: Law, shape: &Shape, material: &Hooke) {
        let (v, size) = (shape.volume, size(shape));
        let gradients = shape.gradient[1..].iter().flat_map(|a| [a.x, a.y, a.z]);
        let parameters = super::kernel::parameters(law, material).map(|p| v * p);
        let fibre = material.fibre.map_or([0.0; 4], |fibre| {
            let a0 = fibre.direction;
            [a0.x, a0.y, a0.z, v * fibre.kappa]
        });
        let numbers = gradients
            .chain(parameters)
            .chain([v * material.lambda, v * material.mu])
            .chain([size * size])
            .chain(fibre);
        for (row, number) in self.row.iter_mut().zip(numbers) {
            row[lane] = number;
        }
    }

    /// Takes a lane of another. Places past the end have nodes that there are.
    #[inline(always)]
    fn take(&mut self, lane: usize, from: &Group, other: usize) {
        for k in 0..ROWS {
            self.row[k][lane] = from.row[k][other];
        }
        for k in 0..4 {
            self.node[k][lane..].fill(from.node[k][other]);
        }
    }

    fn clear(&mut self, lane: usize) {
        self.row.iter_mut().for_each(|row| row[lane] = 0.0);
    }

    #[inline(always)]
    unsafe fn two<V: Four>(&self, row: usize) -> [V; 2] {
        // SAFETY: the caller's.
        unsafe { [V::load(&self.row[row]), V::load(&self.row[row + 1])] }
    }

    #[inline(always)]
    unsafe fn three<V: Four>(&self, row: usize) -> [V; 3] {
        // SAFETY: the caller's.
        unsafe {
            [
                V::load(&self.row[row]),
                V::load(&self.row[row + 1]),
                V::load(&self.row[row + 2]),
            ]
        }
    }

    /// G.
    #[inline(always)]
    unsafe fn deformation<V: Four>(&self, u: &[Lane]) -> Square<V> {
        // SAFETY: the caller's.
        unsafe { gradient(&differences(u, &self.node), &self.gradients()) }
    }

    /// a_1, a_2, a_3.
    #[inline(always)]
    unsafe fn gradients<V: Four>(&self) -> Square<V> {
        // SAFETY: the caller's.
        unsafe { [self.three(0), self.three(3), self.three(6)] }
    }

    /// One tetrahedron after the other, so that results do not depend on what is listed: those that add nothing change no
    /// bit.
    #[inline(always)]
    unsafe fn add_forces<V: Four>(&self, force: &[Three<V>; 4], to: &mut [Lane]) {
        // SAFETY: the caller's.
        unsafe {
            let rows = [
                V::lanes(force[0]),
                V::lanes(force[1]),
                V::lanes(force[2]),
                V::lanes(force[3]),
            ];
            for lane in 0..4 {
                for corner in 0..4 {
                    let at = to.get_unchecked_mut(self.node[corner][lane] as usize);
                    at.0 = V::load(&at.0).add(rows[corner][lane]).store();
                }
            }
        }
    }
}

/// Dynamic tetrahedra of a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Blend {
    pub law: Law,
    pub rule: Adaptive,
    /// tau \[m\], above 0.
    pub threshold: f64,
    has_fibre: bool,
    group: Vec<Group>,
    /// A group each: 1 / (h sum_j |a_j|), j from 0 to 3: by how much of the threshold vertices may move until h |G| has grown by
    /// all of it.
    calm: Vec<[f64; 4]>,
    /// Of each tetrahedron of the mesh, four times its group and its lane; or [`NONE`].
    place: Vec<u32>,
}

/// What comes on top of the linear tensors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Excess {
    /// \[J\]
    pub energy: f64,
    /// u . dW/du of it \[J\].
    pub virial: f64,
    /// Of tetrahedra beyond the threshold.
    pub extent: Extent,
}

impl Blend {
    /// Of those tetrahedra of a mesh that `of` gives shape and material of.
    pub fn new<'a>(
        law: Law,
        rule: Adaptive,
        threshold: f64,
        tetrahedra: &[[u32; 4]],
        of: impl Fn(usize) -> Option<(&'a Shape, &'a Hooke)>,
    ) -> Blend {
        let mut order: Vec<u32> = (0..tetrahedra.len() as u32)
            .filter(|t| of(*t as usize).is_some())
            .collect();
        order.sort_by_key(|t| tetrahedra[*t as usize].iter().min().copied());
        // Not neighbour after neighbour: a node's force would wait for the sum before.
        let order: Vec<u32> = order
            .chunks(256)
            .flat_map(|near| (0..16).flat_map(|k| near.iter().skip(k).step_by(16)))
            .copied()
            .collect();
        let mut place = vec![NONE; tetrahedra.len()];
        let mut group = vec![Group::default(); order.len().div_ceil(4)];
        let mut calm = vec![[f64::MAX; 4]; group.len()];
        for (k, t) in order.iter().enumerate() {
            place[*t as usize] = k as u32;
            let (own, lane) = (&mut group[k / 4], k % 4);
            if let Some((shape, material)) = of(*t as usize) {
                own.fill(lane, law, shape, material);
                let sum: f64 = shape.gradient.iter().map(|a| a.norm()).sum();
                calm[k / 4][lane] = 1.0 / (size(shape) * sum);
            }
            // Places past the end have nodes that there are.
            for (to, node) in own.node.iter_mut().zip(tetrahedra[*t as usize]) {
                to[lane..].fill(node);
            }
        }
        Blend {
            law,
            rule,
            threshold,
            has_fibre: group.iter().any(|g| g.row[KAPPA] != [0.0; 4]),
            group,
            calm,
            place,
        }
    }

    /// Takes a dead tetrahedron out.
    pub(crate) fn remove(&mut self, t: usize) {
        if self.place[t] != NONE {
            let k = self.place[t] as usize;
            self.group[k / 4].clear(k % 4);
        }
    }

    /// Gives a tetrahedron other nodes.
    pub(crate) fn rename(&mut self, t: usize, nodes: &[u32; 4]) {
        if self.place[t] != NONE {
            let k = self.place[t] as usize;
            for (to, node) in self.group[k / 4].node.iter_mut().zip(nodes) {
                to[k % 4] = *node;
            }
        }
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &Blend) {
        self.group.clone_from(&other.group);
        self.threshold = other.threshold;
    }

    pub fn bytes(&self) -> usize {
        size_of_val(&self.group[..]) + size_of_val(&self.calm[..]) + size_of_val(&self.place[..])
    }

    /// Adds the force on top of the linear tensors' \[N\] at displacements u \[m\], a moving node each, to what there is. Only
    /// what is `listed` is looked at, which covers u; or all.
    pub fn add_forces(&self, listed: Option<&Listed>, u: &[Lane], to: &mut [Lane]) -> Excess {
        assert!(u.len() == to.len() && listed.is_none_or(|l| l.seen.len() == u.len()));
        let groups = listed.map_or(&self.group, |l| &l.group);
        #[cfg(target_arch = "x86_64")]
        if lanes::has_avx2() {
            // SAFETY: it is there; nodes are below the number of moving nodes, and so of `u`, by construction.
            return unsafe { self.avx2(groups, u, to) };
        }
        // SAFETY: plain code needs no machine.
        unsafe { self.dispatch::<Plain>(groups, u, to) }
    }

    /// The same of all in plain code, as the fast form's oracle.
    pub fn add_forces_plain(&self, u: &[Lane], to: &mut [Lane]) -> Excess {
        assert!(u.len() == to.len());
        // SAFETY: plain code needs no machine.
        unsafe { self.dispatch::<Plain>(&self.group, u, to) }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn avx2(&self, groups: &[Group], u: &[Lane], to: &mut [Lane]) -> Excess {
        // SAFETY: the caller's.
        unsafe { self.dispatch::<lanes::Avx2>(groups, u, to) }
    }

    #[inline(always)]
    unsafe fn dispatch<V: Four>(&self, groups: &[Group], u: &[Lane], to: &mut [Lane]) -> Excess {
        // SAFETY: the caller's.
        unsafe {
            match self.law {
                // It is the one below the threshold, too.
                Law::Linear => Excess::default(),
                Law::StVenantKirchhoff => self.by_rule::<V, StVenantKirchhoff>(groups, u, to),
                Law::StableNeoHookean => self.by_rule::<V, StableNeoHookean>(groups, u, to),
            }
        }
    }

    #[inline(always)]
    unsafe fn by_rule<V: Four, R: Response>(
        &self,
        groups: &[Group],
        u: &[Lane],
        to: &mut [Lane],
    ) -> Excess {
        // SAFETY: the caller's.
        unsafe {
            match (self.rule, self.has_fibre) {
                (Adaptive::Blend, false) => self.kernel::<V, R, false, false>(groups, u, to),
                (Adaptive::Blend, true) => self.kernel::<V, R, false, true>(groups, u, to),
                (Adaptive::PerVertex, _) => self.kernel::<V, R, true, true>(groups, u, to),
            }
        }
    }

    #[inline(always)]
    unsafe fn kernel<V: Four, R: Response, const VERTEX: bool, const FIBRE: bool>(
        &self,
        groups: &[Group],
        u: &[Lane],
        to: &mut [Lane],
    ) -> Excess {
        // SAFETY: the caller's.
        unsafe {
            let (zero, one, two) = (V::splat(0.0), V::splat(1.0), V::splat(2.0));
            let third = V::splat(1.0 / 3.0);
            let half = V::splat(0.5);
            let inverse = V::splat(1.0 / (self.threshold * self.threshold));
            let mut sum = Excess::default();
            let mut reach = Reach::<V>::rest();
            let Some(first) = groups.first() else {
                return sum;
            };
            // Forces are added while the next group's are computed, and its differences are taken before: either would
            // wait.
            let mut ahead = differences::<V>(u, &first.node);
            let mut late: Option<(&Group, [Three<V>; 4])> = None;
            for (k, group) in groups.iter().enumerate() {
                let d = ahead;
                ahead = differences(u, &groups.get_unchecked((k + 1).min(groups.len() - 1)).node);
                lanes::prefetch(groups, k + 4);
                let a = group.gradients();
                let g = gradient(&d, &a);
                let square = dot(g[0], g[0]).add(dot(g[1], g[1])).add(dot(g[2], g[2]));
                let scale = V::load(&group.row[SQUARE]).mul(inverse);
                let x = scale.mul(square);
                // Neighbours are often all below; what is not a number is not.
                if !VERTEX && one.is_above(x) {
                    continue;
                }
                if let Some((group, force)) = &late {
                    group.add_forces(force, to);
                }
                let point = Point::new(g);
                let parameters = group.two(PARAMETERS);
                let (mut stress, mut energy) = R::respond(&point, parameters);
                // Less the linear law's: its stress is symmetric.
                let [lambda, mu] = group.two::<V>(LAME);
                let pressure = lambda.mul(g[0][0].add(g[1][1]).add(g[2][2]));
                let twice = mu.add(mu);
                let mut xx = twice.mul_add(g[0][0], pressure);
                let mut yy = twice.mul_add(g[1][1], pressure);
                let mut zz = twice.mul_add(g[2][2], pressure);
                let mut yz = mu.mul(g[1][2].add(g[2][1]));
                let mut zx = mu.mul(g[2][0].add(g[0][2]));
                let mut xy = mu.mul(g[0][1].add(g[1][0]));
                if FIBRE {
                    let (a0, kappa) = (group.three(DIRECTION), V::load(&group.row[KAPPA]));
                    R::add_fibre(&point, a0, kappa, &mut stress, &mut energy);
                    let pull = two.mul(kappa).mul(dot(product(&g, a0), a0));
                    let drawn = [pull.mul(a0[0]), pull.mul(a0[1]), pull.mul(a0[2])];
                    xx = drawn[0].mul_add(a0[0], xx);
                    yy = drawn[1].mul_add(a0[1], yy);
                    zz = drawn[2].mul_add(a0[2], zz);
                    yz = drawn[1].mul_add(a0[2], yz);
                    zx = drawn[2].mul_add(a0[0], zx);
                    xy = drawn[0].mul_add(a0[1], xy);
                }
                let linear = [[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]];
                let mut work = zero;
                for row in 0..3 {
                    work = dot(linear[row], g[row]).add(work);
                    stress[row] = sub3(stress[row], linear[row]);
                }
                energy = energy.sub(half.mul(work));
                // By the share of it that counts.
                let mut force: [[V; 3]; 4];
                let active;
                let mut virial = zero;
                if VERTEX {
                    force = corner_forces(&stress, &a);
                    let mut share = zero;
                    for (corner, force) in force.iter_mut().enumerate() {
                        let own = V::gather(u, group.node[corner]);
                        let moved = dot(own, own).mul(inverse).above(one);
                        share = share.add(moved);
                        force[0] = moved.mul(force[0]);
                        force[1] = moved.mul(force[1]);
                        force[2] = moved.mul(force[2]);
                        virial = virial.add(dot(*force, own));
                    }
                    energy = V::splat(0.25).mul(share).mul(energy);
                    active = share.above(zero);
                } else {
                    let s = x.sub(one).mul(third).max(zero).min(one);
                    let weight = s.mul(s).mul(V::splat(3.0).sub(s.add(s)));
                    // dw/dx 2 h²/tau² (W_N - W_L)
                    let rate = two.mul(s).mul(one.sub(s));
                    let slope = rate.mul(scale.add(scale)).mul(energy);
                    for row in 0..3 {
                        stress[row][0] = weight.mul_add(stress[row][0], slope.mul(g[row][0]));
                        stress[row][1] = weight.mul_add(stress[row][1], slope.mul(g[row][1]));
                        stress[row][2] = weight.mul_add(stress[row][2], slope.mul(g[row][2]));
                        virial = virial.add(dot(stress[row], g[row]));
                    }
                    energy = weight.mul(energy);
                    force = corner_forces(&stress, &a);
                    active = s.above(zero);
                }
                // What is not beyond the threshold does not count: results shall not depend on what is listed.
                reach.include_values(
                    active.mul(point.trace),
                    active.mul_add(point.volume_ratio.sub(one), one),
                );
                let (energy, virial) = (energy.store(), virial.store());
                for lane in 0..4 {
                    sum.energy += energy[lane];
                    sum.virial += virial[lane];
                }
                late = Some((group, force));
            }
            if let Some((group, force)) = &late {
                group.add_forces(force, to);
            }
            sum.extent = reach.extent();
            sum
        }
    }

    /// How far displacements u deform what is beyond the threshold.
    pub fn extent(&self, u: &[Lane]) -> Extent {
        #[cfg(target_arch = "x86_64")]
        if lanes::has_avx2() {
            // SAFETY: it is there; nodes are below the number of moving nodes, and so of `u`, by construction.
            return unsafe { self.extent_avx2(u) };
        }
        // SAFETY: plain code needs no machine.
        unsafe { self.deformed::<Plain>(u) }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn extent_avx2(&self, u: &[Lane]) -> Extent {
        // SAFETY: the caller's.
        unsafe { self.deformed::<lanes::Avx2>(u) }
    }

    #[inline(always)]
    unsafe fn deformed<V: Four>(&self, u: &[Lane]) -> Extent {
        // SAFETY: the caller's.
        unsafe {
            let one = V::splat(1.0);
            let mut reach = Reach::<V>::rest();
            for group in &self.group {
                let point = Point::new(group.deformation::<V>(u));
                let active = self.reach::<V>(group, u).above(one);
                reach.include_values(
                    active.mul(point.trace),
                    active.mul_add(point.volume_ratio.sub(one), one),
                );
            }
            reach.extent()
        }
    }

    /// That of one tetrahedron: forces \[N\], energy \[J\] and u . force.
    pub fn force(&self, material: &Hooke, shape: &Shape, u: &[Vec3; 4]) -> ([Vec3; 4], f64, f64) {
        force(self.law, self.rule, self.threshold, material, shape, u)
    }

    /// Share of the tetrahedra that `count` and are beyond the threshold.
    pub fn share(&self, u: &[Lane], count: usize) -> f64 {
        let beyond = |group: &Group| {
            // SAFETY: plain code needs no machine.
            let x = unsafe { self.reach::<Plain>(group, u).store() };
            x.iter().filter(|x| **x > 1.0).count()
        };
        let sum: usize = self.group.iter().map(beyond).sum();
        sum as f64 / count.max(1) as f64
    }

    /// Of four tetrahedra the square of what is compared with the threshold, relative to its square.
    #[inline(always)]
    unsafe fn reach<V: Four>(&self, group: &Group, u: &[Lane]) -> V {
        // SAFETY: the caller's.
        unsafe {
            let inverse = V::splat(1.0 / (self.threshold * self.threshold));
            if self.rule == Adaptive::PerVertex {
                let mut most = V::splat(0.0);
                for nodes in group.node {
                    let own = V::gather(u, nodes);
                    most = most.max(dot(own, own).mul(inverse));
                }
                // Dead ones do not count.
                return most.mul(V::load(&group.row[SQUARE]).above(V::splat(0.0)));
            }
            let g = group.deformation::<V>(u);
            let square = dot(g[0], g[0]).add(dot(g[1], g[1])).add(dot(g[2], g[2]));
            V::load(&group.row[SQUARE]).mul(inverse).mul(square)
        }
    }

    /// Places that are to be listed, and how far \[m\] any node may move until others must be.
    #[inline(always)]
    unsafe fn scan<V: Four>(&self, u: &[Lane], found: &mut Vec<u32>) -> f64 {
        let mut least = f64::MAX;
        for (at, group) in self.group.iter().enumerate() {
            // SAFETY: the caller's.
            let x = unsafe { self.reach::<V>(group, u).store() };
            for (lane, x) in x.into_iter().enumerate() {
                // NaN is listed, and found out there.
                if x < LISTED * LISTED {
                    let calm = match self.rule {
                        Adaptive::Blend => self.calm[at][lane],
                        Adaptive::PerVertex => 1.0,
                    };
                    // sqrt x <= (x + b²) / 2b
                    let root = (x + LISTED * LISTED) / (2.0 * LISTED);
                    least = least.min(calm * (1.0 - root));
                } else {
                    found.push((4 * at + lane) as u32);
                }
            }
        }
        least * self.threshold
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn scan_avx2(&self, u: &[Lane], found: &mut Vec<u32>) -> f64 {
        // SAFETY: the caller's.
        unsafe { self.scan::<lanes::Avx2>(u, found) }
    }

    fn find(&self, u: &[Lane], found: &mut Vec<u32>) -> f64 {
        found.clear();
        #[cfg(target_arch = "x86_64")]
        if lanes::has_avx2() {
            // SAFETY: it is there; nodes are below the number of moving nodes, and so of `u`, by construction.
            return unsafe { self.scan_avx2(u, found) };
        }
        // SAFETY: plain code needs no machine.
        unsafe { self.scan::<Plain>(u, found) }
    }
}

/// h \[m\]: the edge of a regular tetrahedron of the same volume.
pub fn size(shape: &Shape) -> f64 {
    (6.0 * std::f64::consts::SQRT_2 * shape.volume).cbrt()
}

/// Tetrahedra that are beyond the threshold or near it. Those that are not have nothing to add until something has moved
/// too far.
#[derive(Debug, Default)]
pub struct Listed {
    group: Vec<Group>,
    /// Their places in the whole.
    found: Vec<u32>,
    /// u \[m\] when it was made, and how far any node may move from there; negative: nothing is known.
    seen: Vec<Lane>,
    calm: f64,
    /// Of the live mesh, and its threshold.
    revision: u64,
    threshold: f64,
}

impl Listed {
    pub fn new(blend: &Blend, nodes: usize) -> Listed {
        Listed {
            group: Vec::with_capacity(blend.group.len()),
            found: Vec::with_capacity(4 * blend.group.len()),
            seen: vec![Lane::default(); nodes],
            calm: -1.0,
            revision: 0,
            threshold: blend.threshold,
        }
    }

    /// Places that are looked at, four at a time.
    pub fn places(&self) -> usize {
        4 * self.group.len()
    }

    /// Nothing is known any more.
    pub fn forget(&mut self) {
        self.calm = -1.0;
    }

    /// Lists anew if nodes may have moved too far since.
    pub fn refresh(&mut self, blend: &Blend, revision: u64, u: &[Lane]) {
        let same = (revision, blend.threshold) == (self.revision, self.threshold);
        if same && self.calm > 0.0 && lanes::most_moved(&self.seen, u) < self.calm {
            return;
        }
        (self.revision, self.threshold) = (revision, blend.threshold);
        self.seen.copy_from_slice(u);
        self.calm = blend.find(u, &mut self.found);
        self.group.clear();
        for four in self.found.chunks(4) {
            let mut own = Group::default();
            for (lane, place) in four.iter().enumerate() {
                let (from, other) = (*place as usize / 4, *place as usize % 4);
                own.take(lane, &blend.group[from], other);
            }
            self.group.push(own);
        }
    }
}

/// Energy density on top of the linear law's and its derivative, of one tetrahedron of size h \[m\] and gradient G.
pub fn excess(
    law: Law,
    material: &Hooke,
    threshold: f64,
    size: f64,
    g: &Matrix3<f64>,
) -> (f64, Matrix3<f64>) {
    let Weight { w, slope, .. } = weight(threshold, size, g);
    if w == 0.0 {
        return (0.0, Matrix3::zeros());
    }
    let (energy, stress) = difference(law, material, g);
    (w * energy, stress * w + g * (slope * energy))
}

/// Change of [`excess`]'s derivative with G.
pub fn excess_tangent(
    law: Law,
    material: &Hooke,
    threshold: f64,
    size: f64,
    g: &Matrix3<f64>,
    dg: &Matrix3<f64>,
) -> Matrix3<f64> {
    let (energy, stress) = difference(law, material, g);
    let f = Matrix3::identity() + g;
    let linear = material.stress(&((dg + dg.transpose()) * 0.5));
    let change = law.tangent(material, &f, dg) - linear;
    let Weight { w, slope, bend } = weight(threshold, size, g);
    let (along, work) = (g.component_mul(dg).sum(), stress.component_mul(dg).sum());
    change * w
        + stress * (slope * along)
        + g * (bend * along * energy + slope * work)
        + dg * (slope * energy)
}

/// W_N - W_L and its derivative.
fn difference(law: Law, material: &Hooke, g: &Matrix3<f64>) -> (f64, Matrix3<f64>) {
    let f = Matrix3::identity() + g;
    let linear = material.stress(&((g + g.transpose()) * 0.5));
    let energy = law.energy(material, &f) - 0.5 * linear.component_mul(g).sum();
    (energy, law.stress(material, &f) - linear)
}

/// w, and with it dw/dG = slope G, d slope = bend G : dG.
struct Weight {
    w: f64,
    slope: f64,
    bend: f64,
}

fn weight(threshold: f64, size: f64, g: &Matrix3<f64>) -> Weight {
    let scale = (size / threshold).powi(2);
    let s = ((scale * g.norm_squared() - 1.0) / 3.0).clamp(0.0, 1.0);
    let inside = s > 0.0 && s < 1.0;
    Weight {
        w: s * s * (3.0 - 2.0 * s),
        slope: 4.0 * s * (1.0 - s) * scale,
        bend: if inside {
            8.0 / 3.0 * (1.0 - 2.0 * s) * scale * scale
        } else {
            0.0
        },
    }
}

/// Forces of one tetrahedron on top of the linear law's \[N\], their energy \[J\] and u . force.
pub fn force(
    law: Law,
    rule: Adaptive,
    threshold: f64,
    material: &Hooke,
    shape: &Shape,
    u: &[Vec3; 4],
) -> ([Vec3; 4], f64, f64) {
    let g = shape.deformation_gradient(&u.map(|u_j| u_j - u[0])) - Matrix3::identity();
    let on = |stress: Matrix3<f64>| {
        let mut force = shape.gradient.map(|a| stress * a * shape.volume);
        force[0] = -(force[1] + force[2] + force[3]);
        force
    };
    if rule == Adaptive::Blend {
        let (energy, stress) = excess(law, material, threshold, size(shape), &g);
        let virial = shape.volume * stress.component_mul(&g).sum();
        return (on(stress), shape.volume * energy, virial);
    }
    let (energy, stress) = difference(law, material, &g);
    let moved = u.map(|u| f64::from(u8::from(u.norm_squared() > threshold * threshold)));
    let mut force = on(stress);
    let mut virial = 0.0;
    for k in 0..4 {
        force[k] *= moved[k];
        virial += force[k].dot(&u[k]);
    }
    let share = 0.25 * moved.iter().sum::<f64>();
    (force, share * shape.volume * energy, virial)
}
