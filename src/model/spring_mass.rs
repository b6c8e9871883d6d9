//! Mass points and springs along the mesh's edges: what the papers compare tensor-mass with.
//!
//! The spring along edge ij has its rest length l_0 and the stiffness of Van Gelder (1998), a sum over
//! the tetrahedra t round the edge, with Young's modulus E_t along it:
//!
//! k_ij = sum_t E_t V_t / l_0²  \[N/m\]
//!
//! W = k (l - l_0)² / 2, force on i = k (l - l_0) n, n the unit vector from i to j. (Cotin, Delingette,
//! Ayache 1998, eq. 7.) Rotations cost nothing; Poisson's ratio has no effect, and nothing but its edges
//! holds a tetrahedron against turning inside out.
//!
//! With r the rest vector from i to j, w = u_j - u_i and q = l² - l_0² = (2 r + w) . w, so that nothing
//! cancels at small strain,
//!
//! dW/du_j = s (r + w),  s = k (l - l_0)/l = k q / (l (l + l_0)).
//!
//! The tangent stiffness k (n n^T + (1 - l_0/l) (I - n n^T)) never exceeds k I: the network of k I bounds
//! the frequencies at any stretch.

use nalgebra::{Matrix3, Matrix4, SymmetricEigen};

use super::tensor_mass::{Lane, Pattern, Tensors};
use crate::law::linear::Hooke;
use crate::mesh::Vec3;

/// Edges of a tetrahedron.
pub const EDGES: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];

/// Share of l_0² below which l² is taken for it: a spring of no length has no direction and no force.
pub(super) const COLLAPSED: f64 = 1e-24;

/// Four springs of one row, side by side for the sweep. Places past the row's end hold springs of no
/// stiffness from the row's node to itself.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(32))]
pub(super) struct Four {
    /// r \[m\], an axis each.
    pub rest: [[f64; 4]; 3],
    /// l_0 \[m\]
    pub length: [f64; 4],
    /// k \[N/m\]
    pub stiffness: [f64; 4],
    /// j, above the row's i.
    pub node: [u32; 4],
}

/// Springs of an edge pattern, each in the row of its lower node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Springs {
    /// Row i is `row_start[i]..row_start[i + 1]` of `four`; rows of spares are as in [`Pattern`].
    pub(super) row_start: Vec<u32>,
    pub(super) first: usize,
    pub(super) four: Vec<Four>,
}

impl Springs {
    /// Without stiffness yet; `rest` holds the rest positions \[m\].
    pub fn new(pattern: &Pattern, rest: &[Vec3]) -> Springs {
        let pool = SPARE_FOURS * pattern.first;
        let mut springs = Springs {
            row_start: vec![pool as u32; pattern.first + 1],
            first: pattern.first,
            four: vec![Four::unused(0); pool],
        };
        for i in pattern.first..pattern.nodes() {
            // The row's first entry is the node itself.
            for chunk in pattern.column[pattern.row(i)][1..].chunks(4) {
                springs.four.push(Four::new(i, chunk, rest));
            }
            springs.row_start.push(springs.four.len() as u32);
        }
        springs
    }

    /// Whether there is a spare row for so many neighbours.
    pub(crate) fn has_room(&self, neighbours: usize) -> bool {
        self.row_start[self.first] as usize >= neighbours.div_ceil(4)
    }

    /// Gives the next spare a row, as [`Pattern::open`].
    pub(crate) fn open(&mut self, neighbours: &[u32], rest: &[Vec3]) {
        let row = self.first - 1;
        let end = self.row_start[self.first] as usize;
        let start = end - neighbours.len().div_ceil(4);
        for (four, chunk) in self.four[start..end].iter_mut().zip(neighbours.chunks(4)) {
            *four = Four::new(row, chunk, rest);
        }
        self.row_start[..=row].fill(start as u32);
        self.first = row;
    }

    /// Adds the six springs of one tetrahedron of rest positions `rest`.
    pub fn accumulate(
        &mut self,
        pattern: &Pattern,
        nodes: &[u32; 4],
        rest: &[Vec3; 4],
        volume: f64,
        law: &Hooke,
    ) {
        for (a, b) in EDGES {
            if let Some(stiffness) = self.stiffness_mut(pattern, nodes[a], nodes[b]) {
                *stiffness += share(law, volume, &(rest[b] - rest[a]));
            }
        }
    }

    /// Replaces k of an edge; a node alone has none.
    pub(crate) fn set(&mut self, pattern: &Pattern, i: u32, j: u32, k: f64) {
        if let Some(stiffness) = self.stiffness_mut(pattern, i, j) {
            *stiffness = k;
        }
    }

    fn stiffness_mut(&mut self, pattern: &Pattern, i: u32, j: u32) -> Option<&mut f64> {
        let (four, lane) = self.find(pattern, i, j)?;
        Some(&mut self.four[four].stiffness[lane])
    }

    /// Where the spring of edge (i, j), either order, is.
    fn find(&self, pattern: &Pattern, i: u32, j: u32) -> Option<(usize, usize)> {
        let (low, high) = (i.min(j), i.max(j));
        self.at(pattern, low as usize, pattern.place(low, high)?)
    }

    /// Where the spring at a place of [`Pattern::column`] in row i is; the place of i itself has none.
    fn at(&self, pattern: &Pattern, i: usize, place: usize) -> Option<(usize, usize)> {
        let along = (place - pattern.row(i).start).checked_sub(1)?;
        Some((self.row_start[i] as usize + along / 4, along % 4))
    }

    /// k of edge (i, j), either order \[N/m\]; zero where there is none.
    pub fn stiffness(&self, pattern: &Pattern, i: u32, j: u32) -> f64 {
        self.find(pattern, i, j)
            .map_or(0.0, |(four, lane)| self.four[four].stiffness[lane])
    }

    /// dW/du_i \[N\], alone: for the few vertices whose reaction is wanted.
    pub fn force(&self, pattern: &Pattern, i: usize, u: &[Lane]) -> Vec3 {
        let u_i = u[i].xyz();
        let mut sum = Vec3::zeros();
        for four in self.row(i) {
            for lane in 0..4 {
                let w = u[four.node[lane] as usize].xyz() - u_i;
                sum -= four.pull(lane, &w).0;
            }
        }
        for (j, place) in pattern.lower(i) {
            if let Some((four, lane)) = self.at(pattern, j as usize, place as usize) {
                let w = u_i - u[j as usize].xyz();
                sum += self.four[four].pull(lane, &w).0;
            }
        }
        sum
    }

    pub(super) fn row(&self, i: usize) -> &[Four] {
        &self.four[self.row_start[i] as usize..self.row_start[i + 1] as usize]
    }

    /// The tangent at displacements u in parts, each pair once: K_jj of either end and K_ij of an edge.
    pub fn tangent(&self, pattern: &Pattern, u: &[Lane]) -> Vec<(usize, usize, Matrix3<f64>)> {
        let mut entries = Vec::new();
        for i in pattern.first..pattern.nodes() {
            for four in self.row(i) {
                for lane in (0..4).filter(|lane| four.stiffness[*lane] != 0.0) {
                    let j = four.node[lane] as usize;
                    let now = four.rest_vector(lane) + (u[j].xyz() - u[i].xyz());
                    let least = COLLAPSED.sqrt() * four.length[lane];
                    let l = now.norm().max(least);
                    let across = 1.0 - four.length[lane] / l;
                    let along = now * now.transpose() / (l * l);
                    let block = (along * (1.0 - across) + Matrix3::identity() * across)
                        * four.stiffness[lane];
                    entries.extend([(i, i, block), (j, j, block), (i, j, -block)]);
                }
            }
        }
        entries
    }

    /// The tangent at rest, k n n^T an edge, as a linear law.
    pub fn tangent_at_rest(&self, pattern: &Pattern) -> Tensors {
        self.network(pattern, |k, n| n * n.transpose() * k)
    }

    /// k I an edge: no tangent exceeds it.
    pub fn tangent_bound(&self, pattern: &Pattern) -> Tensors {
        self.network(pattern, |k, _| Matrix3::identity() * k)
    }

    /// Linear springs with a stiffness matrix of k and n each.
    fn network(&self, pattern: &Pattern, of: impl Fn(f64, &Vec3) -> Matrix3<f64>) -> Tensors {
        let mut tensors = Tensors::zeros(pattern);
        for i in pattern.first..pattern.nodes() {
            let row = pattern.row(i);
            for place in row.start + 1..row.end {
                let Some((four, lane)) = self.at(pattern, i, place) else {
                    continue;
                };
                let four = &self.four[four];
                let block = of(
                    four.stiffness[lane],
                    &(four.rest_vector(lane) / four.length[lane]),
                );
                tensors.add(row.start, &block);
                tensors.add(pattern.row(pattern.column[place] as usize).start, &block);
                tensors.add(place, &-block);
            }
        }
        tensors
    }

    pub fn bytes(&self) -> usize {
        size_of_val(&self.four[..]) + size_of_val(&self.row_start[..])
    }
}

/// Room that a spare row has, on the average.
const SPARE_FOURS: usize = 4;

impl Four {
    fn unused(i: usize) -> Four {
        Four {
            rest: [[0.0; 4]; 3],
            length: [1.0; 4],
            stiffness: [0.0; 4],
            node: [i as u32; 4],
        }
    }

    /// Springs from i to up to four others, without stiffness yet.
    fn new(i: usize, others: &[u32], rest: &[Vec3]) -> Four {
        let mut four = Four::unused(i);
        for (lane, j) in others.iter().enumerate() {
            let r = rest[*j as usize] - rest[i];
            for axis in 0..3 {
                four.rest[axis][lane] = r[axis];
            }
            four.length[lane] = r.norm();
            four.node[lane] = *j;
        }
        four
    }

    fn rest_vector(&self, lane: usize) -> Vec3 {
        Vec3::new(self.rest[0][lane], self.rest[1][lane], self.rest[2][lane])
    }

    /// dW/du_j \[N\] and 2 W \[J\] of one spring, w = u_j - u_i.
    pub(super) fn pull(&self, lane: usize, w: &Vec3) -> (Vec3, f64) {
        pull(
            self.stiffness[lane],
            self.length[lane],
            &self.rest_vector(lane),
            w,
        )
    }
}

fn pull(k: f64, length: f64, r: &Vec3, w: &Vec3) -> (Vec3, f64) {
    let now = r + w;
    let q = w.dot(&(r + now));
    let square = length * length;
    let l_square = (square + q).max(COLLAPSED * square);
    let l = l_square.sqrt();
    let x = q / (l * (l + length));
    (now * (k * x), k * x * x * l_square)
}

/// What a tetrahedron adds to the stiffness of its edge \[N/m\].
pub(crate) fn share(law: &Hooke, volume: f64, edge: &Vec3) -> f64 {
    law.young_modulus_along(&edge.normalize()) * volume / edge.norm_squared()
}

/// What one tetrahedron's springs do: dW/du \[N\] and energy \[J\] a vertex, half a spring's at either end.
pub fn tetrahedron_force(
    law: &Hooke,
    volume: f64,
    rest: &[Vec3; 4],
    u: &[Vec3; 4],
) -> ([Vec3; 4], [f64; 4]) {
    let (mut force, mut energy) = ([Vec3::zeros(); 4], [0.0; 4]);
    for (a, b) in EDGES {
        let r = rest[b] - rest[a];
        let (f, twice) = pull(share(law, volume, &r), r.norm(), &r, &(u[b] - u[a]));
        force[a] -= f;
        force[b] += f;
        energy[a] += 0.25 * twice;
        energy[b] += 0.25 * twice;
    }
    (force, energy)
}

/// Largest eigenvalue of M^-1 K of one tetrahedron's springs at any stretch, a quarter of its mass on
/// each vertex \[1/s²\]. The largest over all tetrahedra bounds that of any assembly of them.
pub fn largest_eigenvalue(law: &Hooke, volume: f64, rest: &[Vec3; 4], density: f64) -> f64 {
    let mut network = Matrix4::<f64>::zeros();
    for (a, b) in EDGES {
        let k = share(law, volume, &(rest[b] - rest[a]));
        network[(a, a)] += k;
        network[(b, b)] += k;
        network[(a, b)] -= k;
        network[(b, a)] -= k;
    }
    SymmetricEigen::new(network).eigenvalues.max() / (density * volume / 4.0)
}
