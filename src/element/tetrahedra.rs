//! Constant-strain tetrahedra with a law that is right under rotation, four at a time.
//!
//! F = I + sum_j (u_j - u_0) a_j^T,  dW/du_j = V P a_j,  dW/du_0 = - sum_j dW/du_j  (j = 1, 2, 3)
//!
//! so that forces balance to round-off, and a translation gives none at all. (Picinbono, Delingette, Ayache 2003, section 3; form (a) of
//! equation 13, not gathered on vertices and edges.)

use nalgebra::Matrix3;

use super::constant_strain::Shape;
use super::guard::Guard;
use super::kernel::{Kernel, parameters};
use crate::lanes::{self, Four, Plain, Square, Three, load3, product, sub3};
use crate::law::linear::Hooke;
use crate::law::response::{Law, Point, Response};
use crate::law::volume_penalty;
use crate::mesh::Vec3;
use crate::mesh::topology::NONE;
use crate::model::tensor_mass::Lane;

/// Four tetrahedra side by side. A place that holds none, or a dead one, has neither gradients nor stiffness.
#[derive(Clone, Debug, PartialEq)]
#[repr(C, align(32))]
pub(super) struct Group {
    /// a_1, a_2, a_3 \[1/m\], an axis each.
    pub gradient: [[[f64; 4]; 3]; 3],
    /// Of [`Response::parameters`], times V \[J\].
    pub parameters: [[f64; 4]; 2],
    /// A corner each.
    pub node: [[u32; 4]; 4],
}

/// What only some tissue needs.
#[derive(Clone, Debug, PartialEq)]
#[repr(C, align(32))]
struct Extra {
    direction: [[f64; 4]; 3],
    /// kappa V \[J\]
    kappa: [f64; 4],
    /// V \[m³\]
    volume: [f64; 4],
}

/// Live tetrahedra, each lane in the order of their lowest node.
#[derive(Clone, Debug, PartialEq)]
pub struct Tetrahedra {
    pub law: Law,
    pub(super) group: Vec<Group>,
    extra: Vec<Extra>,
    has_fibre: bool,
    /// k of [`crate::law::volume_penalty`] \[Pa\]; the materials' own do not count.
    pub penalty: f64,
    /// Of each tetrahedron of the mesh, four times its group and its lane; or [`NONE`].
    place: Vec<u32>,
    /// Where they are guarded.
    pub(super) guard: Option<Box<Guard>>,
}

/// How far tissue is deformed, over all its tetrahedra.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Largest F:F - 3.
    pub trace: f64,
    /// Smallest and largest det F.
    pub least: f64,
    pub most: f64,
    /// What guards add to the square of the highest frequency at most \[1/s²\].
    pub guard: f64,
}

impl Extent {
    /// Of both.
    pub fn join(&mut self, other: &Extent) {
        self.trace = self.trace.max(other.trace);
        self.least = self.least.min(other.least);
        self.most = self.most.max(other.most);
        self.guard = self.guard.max(other.guard);
    }
}

impl Default for Extent {
    /// At rest.
    fn default() -> Extent {
        Extent {
            trace: 0.0,
            least: 1.0,
            most: 1.0,
            guard: 0.0,
        }
    }
}

impl Tetrahedra {
    /// Of those tetrahedra of a mesh that `of` gives shape and material of.
    pub fn new<'a>(
        law: Law,
        tetrahedra: &[[u32; 4]],
        of: impl Fn(usize) -> Option<(&'a Shape, &'a Hooke)>,
    ) -> Tetrahedra {
        let mut order: Vec<u32> = (0..tetrahedra.len() as u32)
            .filter(|t| of(*t as usize).is_some())
            .collect();
        order.sort_by_key(|t| tetrahedra[*t as usize].iter().min().copied());
        let has_fibre = |t: &u32| of(*t as usize).is_some_and(|(_, law)| law.fibre.is_some());
        let has_fibre = order.iter().any(has_fibre);
        let mut place = vec![NONE; tetrahedra.len()];
        let (mut group, mut extra) = (Vec::new(), Vec::new());
        // Each lane goes through a quarter of its own: neighbours, which add to the same nodes, are not in one group,
        // where they would wait for each other.
        let quarter = order.len().div_ceil(4);
        for k in 0..quarter {
            let four: [Option<&u32>; 4] = std::array::from_fn(|lane| order.get(lane * quarter + k));
            for (lane, t) in four.iter().enumerate() {
                if let Some(t) = t {
                    place[**t as usize] = (4 * k + lane) as u32;
                }
            }
            // Places past the end have another's nodes.
            let each = |lane: usize| match four[lane] {
                Some(t) => (tetrahedra[*t as usize], of(*t as usize)),
                None => (tetrahedra[order[k] as usize], None),
            };
            let mut own = Group {
                gradient: Default::default(),
                parameters: Default::default(),
                node: Default::default(),
            };
            let mut more = Extra {
                direction: Default::default(),
                kappa: Default::default(),
                volume: Default::default(),
            };
            for lane in 0..4 {
                let (nodes, tissue) = each(lane);
                for (corner, node) in nodes.iter().enumerate() {
                    own.node[corner][lane] = *node;
                }
                let Some((shape, material)) = tissue else {
                    continue;
                };
                for (to, a) in own.gradient.iter_mut().zip(&shape.gradient[1..]) {
                    for axis in 0..3 {
                        to[axis][lane] = a[axis];
                    }
                }
                let parameters = parameters(law, material);
                for (to, p) in own.parameters.iter_mut().zip(parameters) {
                    to[lane] = shape.volume * p;
                }
                if let Some(fibre) = &material.fibre {
                    for axis in 0..3 {
                        more.direction[axis][lane] = fibre.direction[axis];
                    }
                    more.kappa[lane] = shape.volume * fibre.kappa;
                }
                more.volume[lane] = shape.volume;
            }
            group.push(own);
            extra.push(more);
        }
        Tetrahedra {
            law,
            group,
            extra,
            has_fibre,
            penalty: 0.0,
            place,
            guard: None,
        }
    }

    /// Takes a dead tetrahedron out.
    pub(crate) fn remove(&mut self, t: usize) {
        let Some((group, lane)) = self.find(t) else {
            return;
        };
        for row in self.group[group].gradient.as_flattened_mut() {
            row[lane] = 0.0;
        }
        for row in &mut self.group[group].parameters {
            row[lane] = 0.0;
        }
        self.extra[group].kappa[lane] = 0.0;
        self.extra[group].volume[lane] = 0.0;
    }

    /// Gives a tetrahedron other nodes.
    pub(crate) fn rename(&mut self, t: usize, nodes: &[u32; 4]) {
        if let Some((group, lane)) = self.find(t) {
            for (to, node) in self.group[group].node.iter_mut().zip(nodes) {
                to[lane] = *node;
            }
        }
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &Tetrahedra) {
        self.group.clone_from(&other.group);
        self.extra.clone_from(&other.extra);
        self.penalty = other.penalty;
    }

    pub(super) fn find(&self, t: usize) -> Option<(usize, usize)> {
        let place = self.place[t] as usize;
        (self.place[t] != NONE).then_some((place / 4, place % 4))
    }

    /// How far displacements u deform.
    pub fn extent(&self, u: &[Lane]) -> Extent {
        #[cfg(target_arch = "x86_64")]
        if lanes::has_avx2() {
            // SAFETY: it is there; nodes are below the number of moving nodes, and so of `u`, by construction.
            return unsafe { self.extent_avx2(u) };
        }
        // SAFETY: plain code has no needs.
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
            let mut reach = Reach::<V>::rest();
            for group in &self.group {
                reach.include(&group.point(u).0);
            }
            reach.extent()
        }
    }

    /// Fibres and volume penalty of a group.
    #[inline(always)]
    pub(super) unsafe fn add_extra<V: Four, R: Response>(
        &self,
        k: usize,
        point: &Point<V>,
        stress: &mut Square<V>,
        energy: &mut V,
    ) {
        // SAFETY: the caller's.
        unsafe {
            let extra = self.extra.get_unchecked(k);
            let a0 = load3(&extra.direction);
            R::add_fibre(point, a0, V::load(&extra.kappa), stress, energy);
            let penalty = V::splat(self.penalty).mul(V::load(&extra.volume));
            volume_penalty::add(point, penalty, stress, energy);
        }
    }

    pub fn bytes(&self) -> usize {
        size_of_val(&self.group[..])
            + size_of_val(&self.extra[..])
            + size_of_val(&self.place[..])
            + self.guard.as_ref().map_or(0, |guard| guard.bytes())
    }
}

impl Kernel for Tetrahedra {
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
        // SAFETY: the caller's.
        unsafe {
            let mut sum = V::splat(0.0);
            let mut reach = Reach::<V>::rest();
            let Some(first) = self.group.first() else {
                return (0.0, Extent::default());
            };
            // A group is a long chain of steps that wait for each other. So the next one's differences are taken before it,
            // and its forces are added beside the next one's steps.
            let mut ahead = differences::<V>(u, &first.node);
            let mut late = [[V::splat(0.0); 3]; 4];
            for (k, group) in self.group.iter().enumerate() {
                if k > 0 {
                    add_forces(&late, &self.group.get_unchecked(k - 1).node, to);
                }
                let d = ahead;
                let next = (k + 1).min(self.group.len() - 1);
                ahead = differences(u, &self.group.get_unchecked(next).node);
                let a = group.gradients();
                let point = Point::new(gradient(&d, &a));
                let parameters = [V::load(&group.parameters[0]), V::load(&group.parameters[1])];
                let (mut stress, mut energy) = R::respond(&point, parameters);
                if EXTRA {
                    self.add_extra::<V, R>(k, &point, &mut stress, &mut energy);
                }
                sum = sum.add(energy);
                if !R::IS_LINEAR {
                    reach.include(&point);
                }
                late = corner_forces(&stress, &a);
            }
            add_forces(
                &late,
                &self.group.get_unchecked(self.group.len() - 1).node,
                to,
            );
            let [a, b, c, d] = sum.store();
            ((a + b) + (c + d), reach.extent())
        }
    }
}

impl Group {
    /// a_1, a_2, a_3.
    #[inline(always)]
    unsafe fn gradients<V: Four>(&self) -> Square<V> {
        // SAFETY: the caller's.
        unsafe {
            [
                load3(&self.gradient[0]),
                load3(&self.gradient[1]),
                load3(&self.gradient[2]),
            ]
        }
    }

    /// Deformation, and a_1, a_2, a_3.
    #[inline(always)]
    pub unsafe fn point<V: Four>(&self, u: &[Lane]) -> (Point<V>, Square<V>) {
        // SAFETY: the caller's.
        unsafe {
            let a = self.gradients();
            (Point::new(gradient(&differences(u, &self.node), &a)), a)
        }
    }

    /// Of P times V at these a_j.
    #[inline(always)]
    pub unsafe fn add_forces<V: Four>(&self, stress: &Square<V>, a: &Square<V>, to: &mut [Lane]) {
        // SAFETY: the caller's.
        unsafe { add_forces(&corner_forces(stress, a), &self.node, to) }
    }
}

/// u_j - u_0 of four tetrahedra, j = 1, 2, 3.
///
/// # Safety
/// As [`Four`]; so in all of these.
#[inline(always)]
pub(super) unsafe fn differences<V: Four>(u: &[Lane], node: &[[u32; 4]; 4]) -> Square<V> {
    // SAFETY: the caller's.
    unsafe {
        let first = V::gather(u, node[0]);
        [
            sub3(V::gather(u, node[1]), first),
            sub3(V::gather(u, node[2]), first),
            sub3(V::gather(u, node[3]), first),
        ]
    }
}

/// G = sum_j (u_j - u_0) a_j^T of such differences.
#[inline(always)]
pub(super) unsafe fn gradient<V: Four>(d: &Square<V>, a: &Square<V>) -> Square<V> {
    // SAFETY: the caller's.
    unsafe {
        let mut g = *a;
        for k in 0..3 {
            let (x, y, z) = (d[0][k], d[1][k], d[2][k]);
            g[k][0] = x.mul_add(a[0][0], y.mul_add(a[1][0], z.mul(a[2][0])));
            g[k][1] = x.mul_add(a[0][1], y.mul_add(a[1][1], z.mul(a[2][1])));
            g[k][2] = x.mul_add(a[0][2], y.mul_add(a[1][2], z.mul(a[2][2])));
        }
        g
    }
}

/// V P a_j of the four corners, the first minus the sum of the others.
#[inline(always)]
pub(super) unsafe fn corner_forces<V: Four>(stress: &Square<V>, a: &Square<V>) -> [Three<V>; 4] {
    // SAFETY: the caller's.
    unsafe {
        let others = [
            product(stress, a[0]),
            product(stress, a[1]),
            product(stress, a[2]),
        ];
        let zero = [V::splat(0.0); 3];
        let first = sub3(sub3(sub3(zero, others[0]), others[1]), others[2]);
        [first, others[0], others[1], others[2]]
    }
}

#[inline(always)]
unsafe fn add_forces<V: Four>(force: &[Three<V>; 4], node: &[[u32; 4]; 4], to: &mut [Lane]) {
    // SAFETY: the caller's.
    unsafe {
        V::scatter(force[0], to, node[0]);
        V::scatter(force[1], to, node[1]);
        V::scatter(force[2], to, node[2]);
        V::scatter(force[3], to, node[3]);
    }
}

/// [`Extent`] in the making, a lane each.
pub(super) struct Reach<V> {
    trace: V,
    least: V,
    most: V,
}

impl<V: Four> Reach<V> {
    #[inline(always)]
    pub unsafe fn rest() -> Reach<V> {
        // SAFETY: the caller's; so in all of them.
        unsafe {
            Reach {
                trace: V::splat(0.0),
                least: V::splat(1.0),
                most: V::splat(1.0),
            }
        }
    }

    #[inline(always)]
    pub unsafe fn include(&mut self, point: &Point<V>) {
        unsafe { self.include_values(point.trace, point.volume_ratio) }
    }

    #[inline(always)]
    pub unsafe fn include_values(&mut self, trace: V, volume_ratio: V) {
        unsafe {
            self.trace = self.trace.max(trace);
            self.least = self.least.min(volume_ratio);
            self.most = self.most.max(volume_ratio);
        }
    }

    #[inline(always)]
    pub unsafe fn extent(self) -> Extent {
        unsafe {
            let [a, b, c, d] = self.trace.store();
            let [e, f, g, h] = self.least.store();
            let [i, j, k, l] = self.most.store();
            Extent {
                trace: a.max(b).max(c.max(d)),
                least: e.min(f).min(g.min(h)),
                most: i.max(j).max(k.max(l)),
                guard: 0.0,
            }
        }
    }
}

/// dW/du \[N\] of the four vertices and W \[J\] of one tetrahedron, without lanes.
pub fn force(law: Law, material: &Hooke, shape: &Shape, u: &[Vec3; 4]) -> ([Vec3; 4], f64) {
    let from_first = u.map(|u_j| u_j - u[0]);
    let f: Matrix3<f64> = shape.deformation_gradient(&from_first);
    let stress = law.stress(material, &f) * shape.volume;
    let mut force = shape.gradient.map(|a| stress * a);
    force[0] = -(force[1] + force[2] + force[3]);
    (force, law.energy(material, &f) * shape.volume)
}
