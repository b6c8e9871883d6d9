//! What keeps single tetrahedra of averaged elements from turning inside out.
//!
//! A vertex's mean hides what one tetrahedron of its star does: in tissue that is strongly compressed some turn inside out
//! while each mean is sound. So each tetrahedron of stable neo-Hookean tissue has, where J = det F_t of its own is below J_0,
//!
//! W_t = V k/2 (J_0 - J)²,  dW_t/du_j = - V k (J_0 - J) cof(F_t) a_j,  k = 10 (lambda + 5 mu/6),  J_0 = 0.3
//!
//! J_0 is where averaged and constant-strain tissue differ anyway; what is compressed less has no such term. A block pressed to
//! 20 % of its height has none inside out (map `compression` of docs/stability.md).
//!
//! Its second derivative by u_i and u_j is, with g_i = cof(F) a_i, at most V k (|g_i| |g_j| + (J_0 - J) |F (a_i x a_j)|), the last
//! for i != j alone. Summed over j and the tetrahedra of a vertex, over its mass, that is at the most of all vertices what
//! guards add to the square of the highest frequency at most (Gershgorin): one that stands alone adds little.

use nalgebra::Matrix3;

use super::constant_strain::Shape;
use super::tetrahedra::Tetrahedra;
use crate::lanes::{self, Four, Plain, cofactors};
use crate::law::linear::Hooke;
use crate::law::response::Response;
use crate::law::stable_neo_hookean::{StableNeoHookean, cofactor, cofactor_change};
use crate::mesh::Vec3;
use crate::model::tensor_mass::Lane;

/// J_0.
pub(super) const LEAST: f64 = 0.3;
/// k in units of lambda + 5 mu/6.
const STIFFNESS: f64 = 10.0;
/// Listed is what may come below J_0 as vertices move by this share of the mean of 1 / sum_j |a_j|.
const NEAR: f64 = 0.05;

/// What tetrahedra that are guarded have beside their own, a group of [`Tetrahedra`] each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Guard {
    size: Vec<Sizes>,
    /// How far vertices may move before any that is not listed counts, at least \[m\].
    near: f64,
    nodes: usize,
}

/// 1 / sum_j |a_j|, j from 0 to 3 \[m\].
type Sizes = [f64; 4];

/// Where rates are summed, and the masses of vertices \[kg\].
pub(super) struct Rows<'a> {
    /// \[N/m\] a vertex; zero before and after.
    pub sum: &'a mut [f64],
    pub mass: &'a [f64],
}

/// What the guard does at some displacements.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Resistance {
    /// \[J\]
    pub energy: f64,
    /// What it adds to the square of the highest frequency at most \[1/s²\].
    pub rate: f64,
}

impl Guard {
    /// Of live tetrahedra, so many of so many vertices.
    pub fn new(of: &Tetrahedra, tetrahedra: usize, nodes: usize) -> Guard {
        // Places that hold none never count.
        let mut size = vec![[f64::MAX; 4]; of.group.len()];
        let (mut sum, mut count) = (0.0, 0);
        for t in 0..tetrahedra {
            let Some((group, lane)) = of.find(t) else {
                continue;
            };
            let a = of.group[group]
                .gradient
                .map(|a| Vec3::from(a.map(|axis| axis[lane])));
            let first = -(a[0] + a[1] + a[2]);
            let own = 1.0 / (first.norm() + a.iter().map(|a| a.norm()).sum::<f64>());
            size[group][lane] = own;
            sum += own;
            count += 1;
        }
        Guard {
            size,
            near: NEAR * sum / f64::from(count.max(1)),
            nodes,
        }
    }

    /// Vertices, of each of which rates are summed.
    pub fn nodes(&self) -> usize {
        self.nodes
    }

    pub fn bytes(&self) -> usize {
        size_of_val(&self.size[..])
    }
}

impl Tetrahedra {
    /// Adds what the guard does to forces dW/du \[N\] at displacements u. Only groups that are `listed` are looked at; or all.
    pub(super) fn resist(
        &self,
        listed: Option<&Listed>,
        u: &[Lane],
        to: &mut [Lane],
        rows: Rows,
    ) -> Resistance {
        self.guard_at::<true>(listed, u, to, rows)
    }

    /// What it does, without forces.
    pub(super) fn resistance(&self, u: &[Lane], rows: Rows) -> Resistance {
        self.guard_at::<false>(None, u, &mut [], rows)
    }

    fn guard_at<const FORCES: bool>(
        &self,
        listed: Option<&Listed>,
        u: &[Lane],
        to: &mut [Lane],
        rows: Rows,
    ) -> Resistance {
        let Some(guard) = self.guard.as_deref() else {
            return Resistance::default();
        };
        #[cfg(target_arch = "x86_64")]
        if lanes::has_avx2() {
            // SAFETY: it is there; nodes are below the number of moving nodes, and so of `u`, by construction.
            return unsafe { self.guard_avx2::<FORCES>(guard, listed, u, to, rows) };
        }
        // SAFETY: plain code needs no machine.
        unsafe { self.guard_all::<Plain, FORCES>(guard, listed, u, to, rows) }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn guard_avx2<const FORCES: bool>(
        &self,
        guard: &Guard,
        listed: Option<&Listed>,
        u: &[Lane],
        to: &mut [Lane],
        rows: Rows,
    ) -> Resistance {
        // SAFETY: the caller's.
        unsafe { self.guard_all::<lanes::Avx2, FORCES>(guard, listed, u, to, rows) }
    }

    #[inline(always)]
    unsafe fn guard_all<V: Four, const FORCES: bool>(
        &self,
        guard: &Guard,
        listed: Option<&Listed>,
        u: &[Lane],
        to: &mut [Lane],
        rows: Rows,
    ) -> Resistance {
        let mut energy = 0.0;
        // SAFETY: the caller's.
        unsafe {
            let mut one =
                |k: usize| energy += self.guard_group::<V, FORCES>(k, u, to, &mut *rows.sum);
            match listed {
                None => (0..guard.size.len()).for_each(&mut one),
                Some(listed) => (listed.groups.iter()).for_each(|k| one(*k as usize)),
            }
        }
        let mut rate = 0.0f64;
        if energy != 0.0 {
            for (row, mass) in rows.sum.iter_mut().zip(rows.mass) {
                let row = std::mem::take(row);
                rate = if row > 0.0 {
                    rate.max(row / mass)
                } else {
                    rate
                };
            }
        }
        Resistance { energy, rate }
    }

    /// One tetrahedron after the other, so that results do not depend on what is listed: those above J_0 change no bit.
    #[inline(always)]
    unsafe fn guard_group<V: Four, const FORCES: bool>(
        &self,
        k: usize,
        u: &[Lane],
        to: &mut [Lane],
        rows: &mut [f64],
    ) -> f64 {
        // SAFETY: the caller's.
        unsafe {
            let group = &self.group[k];
            let (point, a) = group.point::<V>(u);
            if point.volume_ratio.is_above(V::splat(LEAST)) {
                return 0.0;
            }
            let ratio = point.volume_ratio.store();
            let f = point.f.map(|row| row.map(|x| x.store()));
            let cof = cofactors(&point.f);
            let others = [
                lanes::product(&cof, a[0]),
                lanes::product(&cof, a[1]),
                lanes::product(&cof, a[2]),
            ];
            let others = others.map(|of| of.map(|axis| axis.store()));
            let gradient = a.map(|of| of.map(|axis| axis.store()));
            let mut energy = 0.0;
            for lane in 0..4 {
                let missing = LEAST - ratio[lane];
                // What is not a number counts, and is found out.
                if missing <= 0.0 {
                    continue;
                }
                let stiffness = STIFFNESS * group.parameters[1][lane];
                energy += 0.5 * stiffness * missing * missing;
                let of_lane = |of: &[[f64; 4]; 3]| Vec3::from(of.map(|axis| axis[lane]));
                let g = others.map(|of| of_lane(&of));
                let g = [-(g[0] + g[1] + g[2]), g[0], g[1], g[2]];
                let nodes = group.node.map(|of| of[lane] as usize);
                let length = g.map(|g| g.norm());
                let all: f64 = length.iter().sum();
                let bends = bends(
                    &Matrix3::from_fn(|row, column| f[row][column][lane]),
                    &gradient.map(|of| of_lane(&of)),
                );
                for corner in 0..4 {
                    let row = stiffness * (length[corner] * all + missing * bends[corner]);
                    rows[nodes[corner]] += row;
                    if FORCES {
                        let at = &mut to[nodes[corner]];
                        *at = (at.xyz() + g[corner] * (-stiffness * missing)).into();
                    }
                }
            }
            energy
        }
    }

    /// Second derivatives of it \[N/m\], parts (i, j, block) of the upper half.
    pub(super) fn add_resistance(
        &self,
        u: &[Lane],
        entries: &mut Vec<(usize, usize, Matrix3<f64>)>,
    ) {
        if self.guard.is_none() {
            return;
        }
        for group in &self.group {
            for lane in 0..4 {
                let a = group.gradient.map(|a| Vec3::from(a.map(|axis| axis[lane])));
                let a = [-(a[0] + a[1] + a[2]), a[0], a[1], a[2]];
                let nodes = group.node.map(|of| of[lane] as usize);
                let mut f = Matrix3::identity();
                for (node, a) in nodes.iter().zip(&a) {
                    f += (u[*node].xyz() - u[nodes[0]].xyz()) * a.transpose();
                }
                let missing = LEAST - f.determinant();
                if missing <= 0.0 {
                    continue;
                }
                let (stiffness, cof) = (STIFFNESS * group.parameters[1][lane], cofactor(&f));
                for k in 0..4 {
                    let change = |axis: usize| {
                        let df = Vec3::ith(axis, 1.0) * a[k].transpose();
                        let along = cof * cof.component_mul(&df).sum();
                        (along - cofactor_change(&f, &df) * missing) * stiffness
                    };
                    let change = [0, 1, 2].map(change);
                    for j in (0..4).filter(|j| nodes[*j] <= nodes[k]) {
                        let block = Matrix3::from_columns(&change.map(|s| s * a[j]));
                        entries.push((nodes[j], nodes[k], block));
                    }
                }
            }
        }
    }

    /// Groups of which any tetrahedron may come below J_0 soon, and how far \[m\] vertices may move until others do.
    ///
    /// With D the change of F, |D| <= x, |det(F + D) - J| <= x (|F|²/sqrt 3 + |F| + 1) while x <= 1, and |D| is at most how far
    /// vertices move times sum_j |a_j|; |F| <= (|F|² + 3) / (2 sqrt 3).
    #[inline(always)]
    unsafe fn scan<V: Four>(&self, guard: &Guard, u: &[Lane], found: &mut Vec<u32>) -> f64 {
        // SAFETY: the caller's.
        unsafe {
            let third = 1.0 / 3f64.sqrt();
            let (one, least) = (V::splat(1.0), V::splat(LEAST));
            let (slope, constant) = (V::splat(1.5 * third), V::splat(1.0 + 6.0 * third));
            let near = V::splat(guard.near);
            let mut calm = V::splat(f64::MAX);
            for (k, (group, size)) in self.group.iter().zip(&guard.size).enumerate() {
                let (point, _) = group.point::<V>(u);
                let bound = slope.mul_add(point.trace, constant);
                let share = point.volume_ratio.sub(least).div(bound).min(one);
                let may = share.mul(V::load(size));
                // What is not a number is listed.
                match may.is_above(near) {
                    true => calm = calm.min(may),
                    false => found.push(k as u32),
                }
            }
            let [a, b, c, d] = calm.store();
            a.min(b).min(c.min(d))
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn scan_avx2(&self, guard: &Guard, u: &[Lane], found: &mut Vec<u32>) -> f64 {
        // SAFETY: the caller's.
        unsafe { self.scan::<lanes::Avx2>(guard, u, found) }
    }

    fn find_near(&self, guard: &Guard, u: &[Lane], found: &mut Vec<u32>) -> f64 {
        found.clear();
        #[cfg(target_arch = "x86_64")]
        if lanes::has_avx2() {
            // SAFETY: it is there; nodes are below the number of moving nodes, and so of `u`, by construction.
            return unsafe { self.scan_avx2(guard, u, found) };
        }
        // SAFETY: plain code needs no machine.
        unsafe { self.scan::<Plain>(guard, u, found) }
    }
}

/// Groups that have to be looked at. The others have nothing to add until something has moved too far.
#[derive(Debug, Default)]
pub struct Listed {
    groups: Vec<u32>,
    /// u \[m\] when it was made, and how far any node may move from there; negative: nothing is known.
    seen: Vec<Lane>,
    calm: f64,
    /// Of the live mesh.
    revision: u64,
}

impl Listed {
    pub fn new(of: &Tetrahedra, nodes: usize) -> Listed {
        Listed {
            groups: Vec::with_capacity(of.group.len()),
            seen: vec![Lane::default(); nodes],
            calm: -1.0,
            revision: 0,
        }
    }

    /// Nothing is known any more.
    pub fn forget(&mut self) {
        self.calm = -1.0;
    }

    /// Lists anew if nodes may have moved too far since.
    pub fn refresh(&mut self, of: &Tetrahedra, revision: u64, u: &[Lane]) {
        let Some(guard) = of.guard.as_deref() else {
            return;
        };
        let same = revision == self.revision && self.calm > 0.0;
        if same && lanes::most_moved(&self.seen, u) < self.calm {
            return;
        }
        self.revision = revision;
        self.seen.copy_from_slice(u);
        self.calm = of.find_near(guard, u, &mut self.groups);
    }
}

/// sum_j |F (a_i x a_j)| of the four corners, of the gradients of the last three.
fn bends(f: &Matrix3<f64>, a: &[Vec3; 3]) -> [f64; 4] {
    let [p, q, r] = [(0, 1), (1, 2), (2, 0)].map(|(i, j)| f * a[i].cross(&a[j]));
    // With a_0 = -(a_1 + a_2 + a_3).
    let first = [p - r, q - p, r - q].map(|x| x.norm());
    let [p, q, r] = [p, q, r].map(|x| x.norm());
    [
        first.iter().sum(),
        first[0] + p + r,
        first[1] + p + q,
        first[2] + q + r,
    ]
}

/// That of one tetrahedron: forces dW/du \[N\] and energy \[J\].
pub fn force(material: &Hooke, shape: &Shape, u: &[Vec3; 4]) -> ([Vec3; 4], f64) {
    let f = shape.deformation_gradient(&u.map(|u_j| u_j - u[0]));
    let missing = LEAST - f.determinant();
    if missing <= 0.0 {
        return ([Vec3::zeros(); 4], 0.0);
    }
    let [_, l] = StableNeoHookean::parameters(material);
    let stiffness = STIFFNESS * l * shape.volume;
    let cof = cofactor(&f) * (-stiffness * missing);
    let mut force = shape.gradient.map(|a| cof * a);
    force[0] = -(force[1] + force[2] + force[3]);
    (force, 0.5 * stiffness * missing * missing)
}
