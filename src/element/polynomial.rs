//! St Venant and Kirchhoff's law on constant-strain tetrahedra as a polynomial in displacements, gathered on vertices,
//! edges, faces and tetrahedra: the papers' non-linear tensor-mass.
//!
//! W = sum_jk U_j . B_jk U_k + sum_jkl (U_j . C_jkl)(U_k . U_l) + sum_jklm D_jklm (U_j . U_k)(U_l . U_m),  s_j = a0 . a_j
//!
//! B_jk = V \[lambda/2 a_j a_k^T + mu/2 (a_k a_j^T + (a_j . a_k) I) + kappa s_j s_k a0 a0^T\]  \[N/m\]
//! C_jkl = V \[lambda/2 a_j (a_k . a_l) + mu/2 (a_l (a_j . a_k) + a_k (a_j . a_l)) + kappa s_j s_k s_l a0\]  \[N/m²\]
//! D_jklm = V \[lambda/8 (a_j . a_k)(a_l . a_m) + mu/4 (a_j . a_m)(a_k . a_l) + kappa/4 s_j s_k s_l s_m\]  \[N/m³\]
//!
//! (Picinbono, Delingette, Ayache 2003, equations 8 and 9, appendix B, corrected: a factor V, C_pjk for C_ppk, and two of
//! the edge's scalars, which are printed twice.) A term belongs to the vertices that it names: one, two, three or all four.
//! Terms that are equal, by B_jk = B_kj^T, C_jkl = C_jlk, D_jklm = D_lmjk = D_kjml, are one here:
//!
//! | of | matrix | vectors | scalars | numbers | the paper's |
//! |---|---|---|---|---|---|
//! | a vertex | symmetric | 1 | 1 | 10 | 13 |
//! | an edge | 1 | 4 | 4 | 25 | 26 |
//! | a face | | 3 | 6 | 15 | 18 |
//! | a tetrahedron | | | 3 | 3 | |
//!
//! So a lone tetrahedron has 253, where the paper counts 280 and leaves out the six of the tetrahedron itself.
//!
//! Forces are sums of terms in U that cancel where tissue moves as a whole: round-off is 1e-16 lambda V |a|² |U| (1 + |a||U|)².

use nalgebra::Matrix3;

use super::constant_strain::Shape;
use crate::law::linear::{Fibre, Hooke};
use crate::mesh::Vec3;
use crate::model::tensor_mass::Lane;

/// How many numbers there are of each.
const VERTEX: usize = 10;
const EDGE: usize = 25;
const FACE: usize = 15;
const TETRAHEDRON: usize = 3;

/// Corners of a tetrahedron, one, two, three and four at a time.
const VERTICES: [[usize; 1]; 4] = [[0], [1], [2], [3]];
const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]];
const ALL: [[usize; 4]; 1] = [[0, 1, 2, 3]];

/// A tetrahedron.
#[derive(Clone, Copy)]
pub(crate) struct Tissue<'a> {
    pub nodes: &'a [u32; 4],
    pub shape: &'a Shape,
    pub material: &'a Hooke,
}

/// One coefficient for each monomial that names these vertices and no others.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Simplex<const N: usize, const K: usize> {
    /// Ascending.
    node: [u32; N],
    number: [f64; K],
}

/// Each list in the order of its vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct Polynomial {
    vertex: Vec<Simplex<1, VERTEX>>,
    edge: Vec<Simplex<2, EDGE>>,
    face: Vec<Simplex<3, FACE>>,
    tetrahedron: Vec<Simplex<4, TETRAHEDRON>>,
}

impl Tissue<'_> {
    /// s_j and kappa.
    fn fibre(&self, j: usize) -> Option<(f64, &Fibre)> {
        let fibre = self.material.fibre.as_ref()?;
        Some((fibre.direction.dot(&self.shape.gradient[j]), fibre))
    }

    /// a_j . a_k.
    fn dot(&self, j: usize, k: usize) -> f64 {
        self.shape.gradient[j].dot(&self.shape.gradient[k])
    }

    /// 2 B_jk, which is Hooke's stiffness.
    fn twice_b(&self, j: usize, k: usize) -> Matrix3<f64> {
        let a = &self.shape.gradient;
        (self.material).stiffness_block(self.shape.volume, &a[j], &a[k])
    }

    /// C_jkl.
    fn c(&self, j: usize, k: usize, l: usize) -> Vec3 {
        let (a, Hooke { lambda, mu, .. }) = (&self.shape.gradient, self.material);
        let mut c = a[j] * (0.5 * lambda * self.dot(k, l))
            + (a[l] * self.dot(j, k) + a[k] * self.dot(j, l)) * (0.5 * mu);
        if let [Some((s_j, fibre)), Some((s_k, _)), Some((s_l, _))] =
            [j, k, l].map(|j| self.fibre(j))
        {
            c += fibre.direction * (fibre.kappa * s_j * s_k * s_l);
        }
        c * self.shape.volume
    }

    /// D_jklm.
    fn d(&self, j: usize, k: usize, l: usize, m: usize) -> f64 {
        let Hooke { lambda, mu, .. } = self.material;
        let mut d = lambda / 8.0 * self.dot(j, k) * self.dot(l, m)
            + mu / 4.0 * self.dot(j, m) * self.dot(k, l);
        if let [
            Some((s_j, fibre)),
            Some((s_k, _)),
            Some((s_l, _)),
            Some((s_m, _)),
        ] = [j, k, l, m].map(|j| self.fibre(j))
        {
            d += 0.25 * fibre.kappa * s_j * s_k * s_l * s_m;
        }
        d * self.shape.volume
    }

    /// K (xx, yy, zz, yz, zx, xy), c, d of W = u . K u / 2 + (u . c) u² + d u⁴.
    fn vertex(&self, [p]: [usize; 1]) -> [f64; VERTEX] {
        let k = self.twice_b(p, p);
        let c = self.c(p, p, p);
        let d = self.d(p, p, p, p);
        [k.m11, k.m22, k.m33, k.m23, k.m31, k.m12, c.x, c.y, c.z, d]
    }

    /// K by columns, c_1 to c_4, d_1 to d_4 of W = u . K v + (v . c_1) u² + (u . c_2 + v . c_3) u . v + (u . c_4) v²
    /// + (d_1 u² + d_2 u . v + d_3 v²) u . v + d_4 u² v².
    fn edge(&self, [p, q]: [usize; 2]) -> [f64; EDGE] {
        let mut all = [0.0; EDGE];
        all[..9].copy_from_slice(self.twice_b(p, q).as_slice());
        let c = [
            self.c(q, p, p),
            self.c(p, p, q) * 2.0,
            self.c(q, q, p) * 2.0,
            self.c(p, q, q),
        ];
        for (to, c) in all[9..21].chunks_exact_mut(3).zip(&c) {
            to.copy_from_slice(c.as_slice());
        }
        all[21..].copy_from_slice(&[
            4.0 * self.d(p, p, p, q),
            2.0 * (self.d(p, q, p, q) + self.d(p, q, q, p)),
            4.0 * self.d(q, q, q, p),
            2.0 * self.d(p, p, q, q),
        ]);
        all
    }

    /// Of W = (u . c_1 + d_1 u²) x + (v . c_2 + d_2 v²) y + (w . c_3 + d_3 w²) z + d_4 y z + d_5 z x + d_6 x y,
    /// x = v . w, y = w . u, z = u . v.
    fn face(&self, [p, q, r]: [usize; 3]) -> [f64; FACE] {
        let mut all = [0.0; FACE];
        let turns = [[p, q, r], [q, r, p], [r, p, q]];
        for (k, [p, q, r]) in turns.into_iter().enumerate() {
            let c = self.c(p, q, r) * 2.0;
            all[3 * k..3 * k + 3].copy_from_slice(c.as_slice());
            all[9 + k] = 4.0 * self.d(p, p, q, r);
            all[12 + k] = 4.0 * (self.d(p, q, p, r) + self.d(q, p, p, r));
        }
        all
    }

    /// Of W = d_1 (u_p . u_q)(u_r . u_s) + d_2 (u_p . u_r)(u_q . u_s) + d_3 (u_p . u_s)(u_q . u_r).
    fn tetrahedron(&self, [p, q, r, s]: [usize; 4]) -> [f64; TETRAHEDRON] {
        [
            4.0 * (self.d(p, q, r, s) + self.d(q, p, r, s)),
            4.0 * (self.d(p, r, q, s) + self.d(r, p, q, s)),
            4.0 * (self.d(p, s, q, r) + self.d(s, p, q, r)),
        ]
    }
}

impl<const N: usize, const K: usize> Simplex<N, K> {
    /// Over the tetrahedra round it, in their order.
    fn sum<'a>(
        &mut self,
        star: impl Iterator<Item = Tissue<'a>>,
        share: fn(&Tissue<'a>, [usize; N]) -> [f64; K],
    ) {
        self.number = [0.0; K];
        for tissue in star {
            let corner = |node: u32| tissue.nodes.iter().position(|v| *v == node);
            let add = share(&tissue, self.node.map(|v| corner(v).unwrap_or(0)));
            for (sum, add) in self.number.iter_mut().zip(add) {
                *sum += add;
            }
        }
    }

    #[inline(always)]
    fn vec3(&self, at: usize) -> Vec3 {
        Vec3::new(self.number[at], self.number[at + 1], self.number[at + 2])
    }
}

/// All simplices of one kind.
fn gather<'a, const N: usize, const K: usize>(
    tetrahedra: &'a [[u32; 4]],
    of: &impl Fn(usize) -> Option<Tissue<'a>>,
    corners: &[[usize; N]],
    share: fn(&Tissue<'a>, [usize; N]) -> [f64; K],
) -> Vec<Simplex<N, K>> {
    let mut found: Vec<([u32; N], usize)> = Vec::new();
    for (t, nodes) in tetrahedra.iter().enumerate() {
        if of(t).is_some() {
            found.extend(
                corners
                    .iter()
                    .map(|own| (ascending(own.map(|c| nodes[c])), t)),
            );
        }
    }
    found.sort_unstable();
    let each = found.chunk_by(|a, b| a.0 == b.0).map(|same| {
        let mut simplex = Simplex {
            node: same[0].0,
            number: [0.0; K],
        };
        simplex.sum(same.iter().filter_map(|(_, t)| of(*t)), share);
        simplex
    });
    each.collect()
}

fn ascending<const N: usize>(mut nodes: [u32; N]) -> [u32; N] {
    nodes.sort_unstable();
    nodes
}

fn find<const N: usize, const K: usize>(
    all: &mut [Simplex<N, K>],
    nodes: [u32; N],
) -> Option<&mut Simplex<N, K>> {
    let at = all
        .binary_search_by_key(&ascending(nodes), |s| s.node)
        .ok()?;
    all.get_mut(at)
}

impl Polynomial {
    /// Of those tetrahedra of a mesh that `of` gives shape and material of.
    pub fn new<'a>(
        tetrahedra: &'a [[u32; 4]],
        of: impl Fn(usize) -> Option<(&'a Shape, &'a Hooke)>,
    ) -> Polynomial {
        let of = |t: usize| {
            let (shape, material) = of(t)?;
            Some(Tissue {
                nodes: &tetrahedra[t],
                shape,
                material,
            })
        };
        Polynomial {
            vertex: gather(tetrahedra, &of, &VERTICES, Tissue::vertex),
            edge: gather(tetrahedra, &of, &EDGES, Tissue::edge),
            face: gather(tetrahedra, &of, &FACES, Tissue::face),
            tetrahedron: gather(tetrahedra, &of, &ALL, Tissue::tetrahedron),
        }
    }

    /// Sums again over what is left round one to four vertices, in the order of a fresh start: equal to one to the bit, and
    /// zero where nothing is left.
    pub(crate) fn sum_again<'a>(&mut self, nodes: &[u32], left: impl Iterator<Item = Tissue<'a>>) {
        match *nodes {
            [p] => find(&mut self.vertex, [p]).map(|own| own.sum(left, Tissue::vertex)),
            [p, q] => find(&mut self.edge, [p, q]).map(|own| own.sum(left, Tissue::edge)),
            [p, q, r] => find(&mut self.face, [p, q, r]).map(|own| own.sum(left, Tissue::face)),
            [p, q, r, s] => find(&mut self.tetrahedron, [p, q, r, s])
                .map(|own| own.sum(left, Tissue::tetrahedron)),
            _ => None,
        };
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &Polynomial) {
        self.vertex.clone_from(&other.vertex);
        self.edge.clone_from(&other.edge);
        self.face.clone_from(&other.face);
        self.tetrahedron.clone_from(&other.tetrahedron);
    }

    pub fn bytes(&self) -> usize {
        size_of_val(&self.vertex[..])
            + size_of_val(&self.edge[..])
            + size_of_val(&self.face[..])
            + size_of_val(&self.tetrahedron[..])
    }

    /// Adds dW/du \[N\] at displacements u \[m\], a moving node each, to what there is. Returns W \[J\].
    pub fn add_forces(&self, u: &[Lane], to: &mut [Lane]) -> f64 {
        assert!(u.len() == to.len());
        let mut energy = 0.0;
        for own in &self.vertex {
            energy += own.add_force(u, to);
        }
        for own in &self.edge {
            energy += own.add_force(u, to);
        }
        for own in &self.face {
            energy += own.add_force(u, to);
        }
        for own in &self.tetrahedron {
            energy += own.add_force(u, to);
        }
        energy
    }
}

#[inline(always)]
fn at(u: &[Lane], node: u32) -> Vec3 {
    u[node as usize].xyz()
}

#[inline(always)]
fn add(to: &mut [Lane], node: u32, force: Vec3) {
    let Lane(to) = &mut to[node as usize];
    to[0] += force.x;
    to[1] += force.y;
    to[2] += force.z;
}

impl Simplex<1, VERTEX> {
    #[inline(always)]
    fn add_force(&self, u: &[Lane], to: &mut [Lane]) -> f64 {
        let [p] = self.node;
        let u = at(u, p);
        let [xx, yy, zz, yz, zx, xy, .., d] = self.number;
        let c = self.vec3(6);
        let linear = Vec3::new(
            xx * u.x + xy * u.y + zx * u.z,
            xy * u.x + yy * u.y + yz * u.z,
            zx * u.x + yz * u.y + zz * u.z,
        );
        let (uu, along) = (u.dot(&u), u.dot(&c));
        let force = linear + c * uu + u * (2.0 * along + 4.0 * d * uu);
        add(to, p, force);
        0.5 * u.dot(&linear) + (along + d * uu) * uu
    }
}

impl Simplex<2, EDGE> {
    #[inline(always)]
    fn add_force(&self, u: &[Lane], to: &mut [Lane]) -> f64 {
        let [p, q] = self.node;
        let (u, v) = (at(u, p), at(u, q));
        let k = Matrix3::from_column_slice(&self.number[..9]);
        let (c1, c2) = (self.vec3(9), self.vec3(12));
        let (c3, c4) = (self.vec3(15), self.vec3(18));
        let [.., d1, d2, d3, d4] = self.number;
        let (uu, uv, vv) = (u.dot(&u), u.dot(&v), v.dot(&v));
        let (v1, u2, v3, u4) = (v.dot(&c1), u.dot(&c2), v.dot(&c3), u.dot(&c4));
        // Of W by u², u . v and v².
        let by_uu = v1 + d1 * uv + d4 * vv;
        let by_uv = u2 + v3 + d1 * uu + 2.0 * d2 * uv + d3 * vv;
        let by_vv = u4 + d3 * uv + d4 * uu;
        let linear = k * v;
        let on_u = linear + u * (2.0 * by_uu) + v * by_uv + c2 * uv + c4 * vv;
        let on_v = k.tr_mul(&u) + v * (2.0 * by_vv) + u * by_uv + c3 * uv + c1 * uu;
        add(to, p, on_u);
        add(to, q, on_v);
        u.dot(&linear) + by_uu * uu + (u2 + v3 + d2 * uv + d3 * vv) * uv + u4 * vv
    }
}

impl Simplex<3, FACE> {
    #[inline(always)]
    fn add_force(&self, u: &[Lane], to: &mut [Lane]) -> f64 {
        let [p, q, r] = self.node;
        let (u, v, w) = (at(u, p), at(u, q), at(u, r));
        let (c1, c2, c3) = (self.vec3(0), self.vec3(3), self.vec3(6));
        let [.., d1, d2, d3, d4, d5, d6] = self.number;
        let (x, y, z) = (v.dot(&w), w.dot(&u), u.dot(&v));
        let own_x = u.dot(&c1) + d1 * u.dot(&u);
        let own_y = v.dot(&c2) + d2 * v.dot(&v);
        let own_z = w.dot(&c3) + d3 * w.dot(&w);
        // Of W by x, y and z.
        let by_x = own_x + d5 * z + d6 * y;
        let by_y = own_y + d4 * z + d6 * x;
        let by_z = own_z + d4 * y + d5 * x;
        add(to, p, (u * (2.0 * d1) + c1) * x + w * by_y + v * by_z);
        add(to, q, (v * (2.0 * d2) + c2) * y + u * by_z + w * by_x);
        add(to, r, (w * (2.0 * d3) + c3) * z + v * by_x + u * by_y);
        own_x * x + own_y * y + own_z * z + d4 * y * z + d5 * z * x + d6 * x * y
    }
}

impl Simplex<4, TETRAHEDRON> {
    #[inline(always)]
    fn add_force(&self, u: &[Lane], to: &mut [Lane]) -> f64 {
        let [p, q, r, s] = self.node;
        let (u_p, u_q, u_r, u_s) = (at(u, p), at(u, q), at(u, r), at(u, s));
        let [d1, d2, d3] = self.number;
        let (pq, rs) = (u_p.dot(&u_q), u_r.dot(&u_s));
        let (pr, qs) = (u_p.dot(&u_r), u_q.dot(&u_s));
        let (ps, qr) = (u_p.dot(&u_s), u_q.dot(&u_r));
        let (by_pq, by_rs) = (d1 * rs, d1 * pq);
        let (by_pr, by_qs) = (d2 * qs, d2 * pr);
        let (by_ps, by_qr) = (d3 * qr, d3 * ps);
        add(to, p, u_q * by_pq + u_r * by_pr + u_s * by_ps);
        add(to, q, u_p * by_pq + u_s * by_qs + u_r * by_qr);
        add(to, r, u_s * by_rs + u_p * by_pr + u_q * by_qr);
        add(to, s, u_r * by_rs + u_q * by_qs + u_p * by_ps);
        by_pq * pq + by_pr * pr + by_ps * ps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lone_tetrahedron_has_253_numbers() {
        let corners = [Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()];
        let (shape, law) = (Shape::new(corners), Hooke::new(6000.0, 0.45));
        let nodes = [[7, 3, 1, 4]];
        let made = Polynomial::new(&nodes, |_| Some((&shape, &law)));
        let numbers = made.vertex.len() * VERTEX
            + made.edge.len() * EDGE
            + made.face.len() * FACE
            + made.tetrahedron.len() * TETRAHEDRON;
        assert_eq!(numbers, 253);
        assert_eq!(made.edge[1].node, [1, 4]);
    }
}
