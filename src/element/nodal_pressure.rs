//! The tetrahedron of average nodal pressure: each tetrahedron keeps its shape, its vertices keep their volume.
//!
//! With theta how much the law takes tissue to have swollen ([`crate::law::swelling`]) and a point p of a vertex,
//!
//! s_p = sum_t (V_t/4) theta(F_t) over the tetrahedra of the vertex  \[m³\],  V_p = sum_t V_t/4
//! W = sum_t V_t psi(F_t) at lambda = 0 + sum_p lambda/(2 V_p) s_p²
//! dW/du_j = sum_t \[V_t P(F_t) at lambda = 0 + (V_t/4) (sum over its points of lambda/V_p s_p) dtheta/dF_t\] a_j
//!
//! lambda/V_p s_p is a pressure \[Pa\]. The mean of squares is no less than the square of the mean, so that no state has
//! more energy than with constant strain (lambda >= 0). What is left at lambda = 0 is mu eps:eps at small strain, so that
//! no mode comes free. (After Bonet and Burton 1998 and Joldes, Wittek and Miller 2009, from an energy.)
//!
//! Tissue of several materials averages each over its own tetrahedra: a vertex has a point for each.

use std::cell::Cell;

use nalgebra::Matrix3;

use super::constant_strain::Shape;
use super::kernel::Kernel;
use super::tetrahedra::{Extent, Reach, Tetrahedra, force};
use crate::lanes::Four;
use crate::law::linear::Hooke;
use crate::law::response::{Law, Response};
use crate::mesh::Vec3;
use crate::model::tensor_mass::Lane;

/// Of the tetrahedra of one group.
#[derive(Clone, Debug, PartialEq)]
#[repr(C, align(32))]
struct Corners {
    /// V_t/4 \[m³\]; 0 where there is none.
    quarter: [f64; 4],
    /// A corner each.
    point: [[u32; 4]; 4],
}

/// Points in the order of their vertices; those of vertices that cuts have made behind them.
#[derive(Clone, Debug, PartialEq)]
pub struct NodalPressure {
    /// At lambda = 0.
    pub each: Tetrahedra,
    /// One a group of those.
    corners: Vec<Corners>,
    /// A point each: its vertex, its material, lambda/V_p \[Pa/m³\].
    node: Vec<u32>,
    material: Vec<Hooke>,
    stiffness: Vec<f64>,
    /// What the scene counts the material as.
    number: Vec<u32>,
    /// Its tetrahedra before any cut, by their places in the groups: `place[star[p][0]..star[p][1]]`. Of a vertex that a
    /// cut has made, those of the one that it was part of.
    star: Vec<[u32; 2]>,
    place: Vec<u32>,
    /// A vertex each: the first of its points, and past the last.
    range: Vec<[u32; 2]>,
    /// How many points there can be.
    most: usize,
}

impl NodalPressure {
    /// Of those tetrahedra of a mesh that `of` gives shape, material and its number of.
    pub fn new<'a>(
        law: Law,
        tetrahedra: &[[u32; 4]],
        of: impl Fn(usize) -> Option<(&'a Shape, &'a Hooke, u32)>,
    ) -> NodalPressure {
        let soft: Vec<Option<Hooke>> = (0..tetrahedra.len())
            .map(|t| of(t).map(|(_, material, _)| material.without_lambda()))
            .collect();
        let each = Tetrahedra::new(law, tetrahedra, |t| Some((of(t)?.0, soft[t].as_ref()?)));
        // (vertex, material, tetrahedron, corner)
        let mut pairs: Vec<(u32, u32, usize, usize)> = Vec::new();
        for (t, nodes) in tetrahedra.iter().enumerate() {
            if let Some((.., number)) = of(t) {
                pairs.extend((0..4).map(|corner| (nodes[corner], number, t, corner)));
            }
        }
        pairs.sort_unstable();
        let nodes = tetrahedra.iter().flatten().max().map_or(0, |v| v + 1);
        let none = Corners {
            quarter: [0.0; 4],
            point: [[0; 4]; 4],
        };
        let mut made = NodalPressure {
            corners: vec![none; each.group.len()],
            each,
            node: Vec::new(),
            material: Vec::new(),
            stiffness: Vec::new(),
            number: Vec::new(),
            star: Vec::new(),
            place: Vec::new(),
            range: vec![[0; 2]; nodes as usize],
            most: 0,
        };
        for star in pairs.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let Some((_, material, number)) = of(star[0].2) else {
                continue;
            };
            let first = made.place.len() as u32;
            let last = first + star.len() as u32;
            let p = made.add_point(star[0].0, *material, number, [first, last]);
            for (_, _, t, corner) in star {
                let (Some((shape, ..)), Some((group, lane))) = (of(*t), made.each.find(*t)) else {
                    continue;
                };
                made.corners[group].quarter[lane] = shape.volume / 4.0;
                made.corners[group].point[*corner][lane] = p as u32;
                made.place.push((4 * group + lane) as u32);
            }
            made.sum(p);
        }
        made.most = made.node.len();
        made
    }

    fn add_point(&mut self, node: u32, material: Hooke, number: u32, star: [u32; 2]) -> usize {
        let p = self.node.len();
        self.node.push(node);
        self.material.push(material);
        self.number.push(number);
        self.stiffness.push(0.0);
        self.star.push(star);
        let range = &mut self.range[node as usize];
        if range[1] == 0 {
            range[0] = p as u32;
        }
        range[1] = p as u32 + 1;
        p
    }

    /// Gives a vertex that a cut makes points as another has, with nothing in them yet.
    pub(crate) fn open(&mut self, new: u32, from: u32) {
        for p in self.points_of(from) {
            self.add_point(new, self.material[p], self.number[p], self.star[p]);
        }
    }

    /// Gives a tetrahedron other nodes, which have points already. All of them are to be summed again.
    pub(crate) fn rename(&mut self, t: usize, nodes: &[u32; 4]) {
        let Some((group, lane)) = self.each.find(t) else {
            return;
        };
        self.each.rename(t, nodes);
        for (corner, node) in nodes.iter().enumerate() {
            let number = self.number[self.corners[group].point[corner][lane] as usize];
            let mut points = self.points_of(*node);
            if let Some(p) = points.find(|p| self.number[*p] == number) {
                self.corners[group].point[corner][lane] = p as u32;
            }
        }
    }

    /// Room for the points of so many vertices that cuts make.
    pub(crate) fn reserve(&mut self, vertices: usize) {
        let more = vertices * self.most_points();
        self.most = self.most.max(self.node.len() + more);
        self.node.reserve(more);
        self.material.reserve(more);
        self.number.reserve(more);
        self.stiffness.reserve(more);
        self.star.reserve(more);
    }

    /// Of a vertex.
    fn most_points(&self) -> usize {
        let counts = self.range.iter().map(|[from, to]| to - from);
        counts.max().unwrap_or(0) as usize
    }

    pub fn law(&self) -> Law {
        self.each.law
    }

    /// How many there can be.
    pub fn points(&self) -> usize {
        self.most
    }

    /// Takes a dead tetrahedron out; its points are to be summed again.
    pub(crate) fn remove(&mut self, t: usize) {
        self.each.remove(t);
        if let Some((group, lane)) = self.each.find(t) {
            self.corners[group].quarter[lane] = 0.0;
        }
    }

    /// Sums the points of a vertex again over what is left of its star, in the order of a fresh start.
    pub(crate) fn sum_again(&mut self, node: u32) {
        for p in self.points_of(node) {
            self.sum(p);
        }
    }

    fn sum(&mut self, p: usize) {
        let volume: f64 = self.star(p).map(|place| self.quarter(place)).sum();
        self.stiffness[p] = match volume > 0.0 {
            true => self.material[p].lambda / volume,
            false => 0.0,
        };
    }

    /// What is left to a tetrahedron.
    fn soft(&self, p: usize) -> Hooke {
        self.material[p]
            .without_lambda()
            .with_penalty(self.each.penalty)
    }

    fn points_of(&self, node: u32) -> std::ops::Range<usize> {
        let [from, to] = self.range[node as usize];
        from as usize..to as usize
    }

    /// Its tetrahedra, dead ones among them.
    fn star(&self, p: usize) -> impl Iterator<Item = u32> + Clone + '_ {
        let [from, to] = self.star[p].map(|at| at as usize);
        let own = move |place: &u32| {
            let point = &self.corners[*place as usize / 4].point;
            point.iter().any(|of| of[*place as usize % 4] == p as u32)
        };
        self.place[from..to].iter().copied().filter(own)
    }

    fn quarter(&self, place: u32) -> f64 {
        self.corners[place as usize / 4].quarter[place as usize % 4]
    }

    /// Nodes and points of the corners of a tetrahedron.
    fn corners(&self, place: u32) -> [(usize, usize); 4] {
        let (group, lane) = (place as usize / 4, place as usize % 4);
        let (node, point) = (&self.each.group[group].node, &self.corners[group].point);
        std::array::from_fn(|k| (node[k][lane] as usize, point[k][lane] as usize))
    }

    fn shape(&self, place: u32) -> Shape {
        let gradient = &self.each.group[place as usize / 4].gradient;
        let a = gradient.map(|a| Vec3::from(a.map(|axis| axis[place as usize % 4])));
        Shape {
            volume: 4.0 * self.quarter(place),
            gradient: [-(a[0] + a[1] + a[2]), a[0], a[1], a[2]],
        }
    }

    /// F of a tetrahedron, from differences to its first corner.
    fn gradient(&self, place: u32, u: &[Lane]) -> Matrix3<f64> {
        let own = self.corners(place).map(|(node, _)| u[node].xyz());
        self.shape(place)
            .deformation_gradient(&own.map(|u_j| u_j - own[0]))
    }

    /// lambda/V_p s_p \[Pa\], alone.
    fn pressure(&self, p: usize, u: &[Lane]) -> f64 {
        let of = |place: u32| self.quarter(place) * self.law().swelling(&self.gradient(place, u));
        self.stiffness[p] * self.star(p).map(of).sum::<f64>()
    }

    /// dW/du \[N\] at displacements u \[m\], a moving node each, is added to what there is. Returns W \[J\] and how far
    /// tissue is deformed. `points` is scratch, one number each.
    pub fn add_forces(&self, u: &[Lane], to: &mut [Lane], points: &mut [f64]) -> (f64, Extent) {
        self.evaluation(points).add_forces(u, to)
    }

    /// The same in plain code.
    pub fn add_forces_plain(
        &self,
        u: &[Lane],
        to: &mut [Lane],
        points: &mut [f64],
    ) -> (f64, Extent) {
        self.evaluation(points).add_forces_plain(u, to)
    }

    fn evaluation<'a>(&'a self, points: &'a mut [f64]) -> Evaluation<'a> {
        let points = &mut points[..self.node.len()];
        Evaluation {
            own: self,
            points: Cell::from_mut(points).as_slice_of_cells(),
        }
    }

    /// dW/du_i \[N\], alone: for the few vertices whose reaction is wanted.
    pub fn node_force(&self, i: usize, u: &[Lane]) -> Vec3 {
        let mut sum = Vec3::zeros();
        for own in self.points_of(i as u32) {
            let (star, material) = (self.star(own), self.soft(own));
            for (at, place) in star.clone().enumerate() {
                let corners = self.corners(place);
                let local = corners.map(|(node, _)| u[node].xyz());
                let (forces, _) = force(self.law(), &material, &self.shape(place), &local);
                for ((node, p), force) in corners.iter().zip(forces) {
                    if *node == i {
                        sum += force;
                    }
                    // A point of several of them counts once.
                    let has = |place: &u32| self.corners(*place).iter().any(|(_, q)| q == p);
                    if !star.clone().take(at).any(|place| has(&place)) {
                        let around = star.clone().skip(at).filter(has);
                        sum += self.pull(i, around, u) * self.pressure(*p, u);
                    }
                }
            }
        }
        sum
    }

    /// Change of these tetrahedra's share in s_p with u_i \[m²\].
    fn pull(&self, i: usize, star: impl Iterator<Item = u32>, u: &[Lane]) -> Vec3 {
        let mut sum = Vec3::zeros();
        for place in star {
            let rate = self.law().swelling_rate(&self.gradient(place, u));
            let shape = self.shape(place);
            for ((node, _), a) in self.corners(place).iter().zip(shape.gradient) {
                if *node == i {
                    sum += rate * a * self.quarter(place);
                }
            }
        }
        sum
    }

    /// What the points of a vertex have of W \[J\], and the power of their pressures at velocities v \[W\].
    pub(crate) fn share(&self, node: u32, u: &[Lane], v: &[Lane]) -> (f64, f64) {
        let (mut energy, mut power) = (0.0, 0.0);
        for p in self.points_of(node) {
            let (mut swelling, mut rate) = (0.0, 0.0);
            for place in self.star(p) {
                let (f, quarter) = (self.gradient(place, u), self.quarter(place));
                let change = self.gradient(place, v) - Matrix3::identity();
                swelling += quarter * self.law().swelling(&f);
                rate += quarter * self.law().swelling_rate(&f).component_mul(&change).sum();
            }
            energy += 0.5 * self.stiffness[p] * swelling * swelling;
            power += self.stiffness[p] * swelling * rate;
        }
        (energy, power)
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &NodalPressure) {
        self.each.copy_from(&other.each);
        self.corners.clone_from(&other.corners);
        self.node.clone_from(&other.node);
        self.material.clone_from(&other.material);
        self.stiffness.clone_from(&other.stiffness);
        self.number.clone_from(&other.number);
        self.star.clone_from(&other.star);
        self.range.clone_from(&other.range);
    }

    /// Second derivatives of W \[N/m\]: parts (i, j, block) of the upper half, of a tetrahedron each, and
    /// lambda/V_p g g^T of a point each, g = ds_p/du.
    pub fn tangent(&self, u: &[Lane]) -> Vec<(usize, usize, Matrix3<f64>)> {
        let mut entries = Vec::new();
        let pressure: Vec<f64> = (0..self.node.len()).map(|p| self.pressure(p, u)).collect();
        for place in 0..4 * self.corners.len() as u32 {
            if self.quarter(place) > 0.0 {
                self.add_tangent(place, u, &pressure, &mut entries);
            }
        }
        let mut slope: Vec<(usize, Vec3)> = Vec::new();
        for p in (0..self.node.len()).filter(|p| self.stiffness[*p] != 0.0) {
            slope.clear();
            for place in self.star(p) {
                let rate = self.law().swelling_rate(&self.gradient(place, u));
                let shape = self.shape(place);
                for ((node, _), a) in self.corners(place).iter().zip(shape.gradient) {
                    let part = rate * a * self.quarter(place);
                    match slope.iter_mut().find(|(v, _)| v == node) {
                        Some((_, sum)) => *sum += part,
                        None => slope.push((*node, part)),
                    }
                }
            }
            for (i, g) in &slope {
                for (j, h) in slope.iter().filter(|(j, _)| i <= j) {
                    entries.push((*i, *j, g * h.transpose() * self.stiffness[p]));
                }
            }
        }
        entries
    }

    /// That of a tetrahedron under the pressures of its points.
    fn add_tangent(
        &self,
        place: u32,
        u: &[Lane],
        pressure: &[f64],
        entries: &mut Vec<(usize, usize, Matrix3<f64>)>,
    ) {
        let (law, f, shape) = (self.law(), self.gradient(place, u), self.shape(place));
        let corners = self.corners(place);
        let material = self.soft(corners[0].1);
        let mean = corners.iter().map(|(_, p)| pressure[*p]).sum::<f64>() / 4.0;
        for (k, (other, _)) in corners.iter().enumerate() {
            let change = |axis: usize| {
                let df = Vec3::ith(axis, 1.0) * shape.gradient[k].transpose();
                law.tangent(&material, &f, &df) + law.swelling_change(&f, &df) * mean
            };
            let change = [0, 1, 2].map(change);
            for ((i, _), a) in corners.iter().zip(shape.gradient) {
                if i <= other {
                    let a = a * shape.volume;
                    entries.push((*i, *other, Matrix3::from_columns(&change.map(|s| s * a))));
                }
            }
        }
    }

    pub fn bytes(&self) -> usize {
        self.each.bytes()
            + size_of_val(&self.corners[..])
            + size_of_val(&self.node[..])
            + size_of_val(&self.material[..])
            + size_of_val(&self.stiffness[..])
            + size_of_val(&self.star[..])
            + size_of_val(&self.place[..])
    }
}

/// Elements with room for what their points sum.
struct Evaluation<'a> {
    own: &'a NodalPressure,
    /// s_p \[m³\], then the pressures \[Pa\].
    points: &'a [Cell<f64>],
}

impl Kernel for Evaluation<'_> {
    fn law(&self) -> Law {
        self.own.law()
    }

    fn has_extra(&self) -> bool {
        self.own.each.has_extra()
    }

    #[allow(private_bounds)] // as the trait
    #[inline(always)]
    unsafe fn kernel<V: Four, R: Response, const EXTRA: bool>(
        &self,
        u: &[Lane],
        to: &mut [Lane],
    ) -> (f64, Extent) {
        let NodalPressure { each, corners, .. } = self.own;
        // SAFETY: the caller's; points and places are in range by construction.
        unsafe {
            for sum in self.points {
                sum.set(0.0);
            }
            for (k, group) in each.group.iter().enumerate() {
                let corners = corners.get_unchecked(k);
                let (point, _) = group.point::<V>(u);
                let change = V::load(&corners.quarter).mul(R::swelling(&point)).store();
                for points in &corners.point {
                    for lane in 0..4 {
                        let sum = self.points.get_unchecked(points[lane] as usize);
                        sum.set(sum.get() + change[lane]);
                    }
                }
            }
            let mut swollen = 0.0;
            for (sum, stiffness) in self.points.iter().zip(&self.own.stiffness) {
                let pressure = stiffness * sum.get();
                swollen += pressure * sum.get();
                sum.set(pressure);
            }
            let mut energy = V::splat(0.0);
            let mut reach = Reach::<V>::rest();
            for (k, group) in each.group.iter().enumerate() {
                let corners = corners.get_unchecked(k);
                let (point, a) = group.point::<V>(u);
                let parameters = [V::load(&group.parameters[0]), V::load(&group.parameters[1])];
                let (mut stress, mut own) = R::respond(&point, parameters);
                if EXTRA {
                    each.add_extra::<V, R>(k, &point, &mut stress, &mut own);
                }
                energy = energy.add(own);
                if !R::IS_LINEAR {
                    reach.include(&point);
                }
                let mut pressure = [0.0; 4];
                for points in &corners.point {
                    for lane in 0..4 {
                        pressure[lane] += self.points.get_unchecked(points[lane] as usize).get();
                    }
                }
                let weight = V::load(&corners.quarter).mul(V::load(&pressure));
                let rate = R::swelling_rate(&point);
                for row in 0..3 {
                    stress[row][0] = weight.mul_add(rate[row][0], stress[row][0]);
                    stress[row][1] = weight.mul_add(rate[row][1], stress[row][1]);
                    stress[row][2] = weight.mul_add(rate[row][2], stress[row][2]);
                }
                group.add_forces(&stress, &a, to);
            }
            let [a, b, c, d] = energy.store();
            ((a + b) + (c + d) + 0.5 * swollen, reach.extent())
        }
    }
}
