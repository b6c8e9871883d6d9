//! Sparse direct solution, the only place that knows faer.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Conj, Mat, MatMut, Par, Side, Spec};

use nalgebra::Matrix3;

use crate::mesh::Vec3;
use crate::model::tensor_mass::{Pattern, Tensors};

/// Why there is no solution.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StaticsError {
    #[error(
        "the stiffness matrix is not positive definite: some tissue is not held against every rigid motion; fix at least three nodes of each piece that are not in line"
    )]
    NotHeld,
    #[error("not enough memory for the factor")]
    Memory,
    #[error(
        "no equilibrium was found beyond {:.1} % of the load and of what supports prescribe: tissue buckles there, or its law does not hold for so large a deformation", 100.0 * .0
    )]
    Lost(f64),
    #[error(
        "model.adaptive perVertex has forces without an energy, and no equilibrium to find; use blend"
    )]
    NoEnergy,
}

/// Systems of more unknowns are ordered by dissection where positions are known.
const DISSECTED: usize = 10_000;

/// Which degrees of freedom are unknowns.
pub struct Numbering {
    /// 3 node + axis -> unknown, or none.
    unknown: Vec<Option<u32>>,
    count: usize,
}

impl Numbering {
    /// `free` an axis of each node.
    pub fn new(free: impl Iterator<Item = [bool; 3]>) -> Numbering {
        let mut count = 0;
        let unknown = free
            .flatten()
            .map(|is_free| {
                is_free.then(|| {
                    count += 1;
                    count as u32 - 1
                })
            })
            .collect();
        Numbering { unknown, count }
    }

    pub fn unknowns(&self) -> usize {
        self.count
    }

    /// Copies the unknowns out of a vector a node.
    pub fn gather(&self, from: &[Vec3], to: &mut [f64]) {
        for (dof, unknown) in self.unknown.iter().enumerate() {
            if let Some(unknown) = unknown {
                to[*unknown as usize] = from[dof / 3][dof % 3];
            }
        }
    }

    /// Writes the unknowns into a vector a node, leaving the others as they are.
    pub fn scatter(&self, from: &[f64], to: &mut [Vec3]) {
        for (dof, unknown) in self.unknown.iter().enumerate() {
            if let Some(unknown) = unknown {
                to[dof / 3][dof % 3] = from[*unknown as usize];
            }
        }
    }
}

impl Numbering {
    /// Nested dissection by position, `order[new] = old` unknown: halves along the longest side, then
    /// the nodes between them.
    fn dissected(&self, edges: &[(u32, u32)], positions: &[Vec3]) -> Vec<usize> {
        let mut start = vec![0u32; positions.len() + 1];
        for (i, j) in edges {
            start[*i as usize + 1] += 1;
            start[*j as usize + 1] += 1;
        }
        for i in 0..positions.len() {
            start[i + 1] += start[i];
        }
        let (mut next, mut neighbour) = (start.clone(), vec![0u32; 2 * edges.len()]);
        for (i, j) in edges.iter().flat_map(|(i, j)| [(*i, *j), (*j, *i)]) {
            neighbour[next[i as usize] as usize] = j;
            next[i as usize] += 1;
        }
        let neighbours =
            |v: u32| &neighbour[start[v as usize] as usize..start[v as usize + 1] as usize];
        let mut order = Vec::with_capacity(positions.len());
        let mut nodes: Vec<u32> = (0..positions.len() as u32).collect();
        // Last to first: a region's separator goes to the end, then its halves before it.
        let mut side = vec![0u32; positions.len()];
        let mut regions = vec![std::mem::take(&mut nodes)];
        let mut stamp = 0;
        while let Some(mut region) = regions.pop() {
            if region.len() <= 32 {
                order.extend(region.into_iter().rev());
                continue;
            }
            let bounds = region.iter().map(|v| positions[*v as usize]).fold(
                (Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY)),
                |(low, high), p| (low.inf(&p), high.sup(&p)),
            );
            let axis = (bounds.1 - bounds.0).imax();
            let middle = region.len() / 2;
            region.select_nth_unstable_by(middle, |a, b| {
                let at = |v: &u32| positions[*v as usize][axis];
                at(a).total_cmp(&at(b)).then(a.cmp(b))
            });
            let right = region.split_off(middle);
            stamp += 1;
            right.iter().for_each(|v| side[*v as usize] = stamp);
            let (between, left): (Vec<u32>, Vec<u32>) = region
                .into_iter()
                .partition(|v| neighbours(*v).iter().any(|w| side[*w as usize] == stamp));
            order.extend(between);
            regions.push(left);
            regions.push(right);
        }
        order.reverse();
        let of = |v: u32| (0..3).filter_map(move |a| self.unknown[3 * v as usize + a]);
        order.into_iter().flat_map(of).map(|u| u as usize).collect()
    }
}

/// Eigenvalues, ascending, and eigenvectors one after the other, of a symmetric matrix.
pub fn eigen(size: usize, at: impl Fn(usize, usize) -> f64) -> (Vec<f64>, Vec<f64>) {
    let matrix = Mat::from_fn(size, size, at);
    match matrix.self_adjoint_eigen(Side::Lower) {
        Ok(found) => (
            found.S().column_vector().iter().copied().collect(),
            (0..size)
                .flat_map(|c| (0..size).map(move |r| (r, c)))
                .map(|(r, c)| found.U()[(r, c)])
                .collect(),
        ),
        // Only non-finite numbers do not converge.
        Err(_) => (vec![f64::NAN; size], vec![f64::NAN; size * size]),
    }
}

/// Scratch of a solution.
pub struct Room(MemBuffer);

/// Cholesky factor of K + shift M on the unknowns.
pub struct Factor {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
    size: usize,
}

impl Factor {
    /// `entries`: node i, node j, K_ij for each pair once, either triangle. `shifted`: shift
    /// \[1/s²\] and the masses \[kg\] a node.
    pub fn new(
        entries: impl Iterator<Item = (usize, usize, Matrix3<f64>)>,
        numbering: &Numbering,
        shifted: Option<(f64, &[f64])>,
    ) -> Result<Factor, StaticsError> {
        Factor::ordered(entries, numbering, shifted, None)
    }

    /// Cholesky factor of K, large meshes in an order by their node positions.
    pub fn within(
        entries: impl Iterator<Item = (usize, usize, Matrix3<f64>)>,
        numbering: &Numbering,
        positions: &[Vec3],
    ) -> Result<Factor, StaticsError> {
        Factor::ordered(entries, numbering, None, Some(positions))
    }

    fn ordered(
        entries: impl Iterator<Item = (usize, usize, Matrix3<f64>)>,
        numbering: &Numbering,
        shifted: Option<(f64, &[f64])>,
        positions: Option<&[Vec3]>,
    ) -> Result<Factor, StaticsError> {
        let mut lower = Vec::new();
        let mut edges = Vec::new();
        for (i, j, block) in entries {
            if i != j && numbering.count > DISSECTED {
                edges.push((i as u32, j as u32));
            }
            for a in 0..3 {
                for b in 0..3 {
                    let (Some(p), Some(q)) =
                        (numbering.unknown[3 * i + a], numbering.unknown[3 * j + b])
                    else {
                        continue;
                    };
                    if i == j && p > q {
                        continue;
                    }
                    let (row, column) = (p.max(q) as usize, p.min(q) as usize);
                    lower.push(Triplet::new(row, column, block[(a, b)]));
                }
            }
        }
        // Once a node: its entry may come in parts.
        if let Some((shift, mass)) = shifted {
            for (dof, unknown) in numbering.unknown.iter().enumerate() {
                if let Some(p) = unknown {
                    let p = *p as usize;
                    lower.push(Triplet::new(p, p, shift * mass[dof / 3]));
                }
            }
        }
        let size = numbering.count;
        let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(size, size, &lower)
            .map_err(|_| StaticsError::Memory)?;
        drop(lower);
        let order = positions
            .filter(|_| numbering.count > DISSECTED)
            .map(|positions| numbering.dissected(&edges, positions));
        let inverse = order.as_ref().map_or(Vec::new(), |order| {
            let mut inverse = vec![0; order.len()];
            order
                .iter()
                .enumerate()
                .for_each(|(new, old)| inverse[*old] = new);
            inverse
        });
        let ordering = match &order {
            Some(order) => SymmetricOrdering::Custom(PermRef::new_checked(order, &inverse, size)),
            None => SymmetricOrdering::Amd,
        };
        let symbolic = factorize_symbolic_cholesky(
            matrix.symbolic(),
            Side::Lower,
            ordering,
            CholeskySymbolicParams {
                supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
                ..Default::default()
            },
        )
        .map_err(|_| StaticsError::Memory)?;
        let mut values = Vec::new();
        values
            .try_reserve_exact(symbolic.len_val())
            .map_err(|_| StaticsError::Memory)?;
        values.resize(symbolic.len_val(), 0.0);
        let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default());
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| StaticsError::Memory)?;
        symbolic
            .factorize_numeric_llt(
                &mut values,
                matrix.as_ref(),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Spec::default(),
            )
            .map_err(|_| StaticsError::NotHeld)?;
        Ok(Factor {
            symbolic,
            values,
            size,
        })
    }

    /// Scratch for [`Factor::solve_with`] of so many right sides at once.
    pub fn room(&self, count: usize) -> Room {
        Room(MemBuffer::new(
            self.symbolic.solve_in_place_scratch::<f64>(count, Par::Seq),
        ))
    }

    /// Solves in place for right sides stored one after the other.
    pub fn solve(&self, columns: &mut [f64]) {
        let count = columns.len() / self.size.max(1);
        self.solve_with(&mut self.room(count), columns);
    }

    /// The same without allocating.
    pub fn solve_with(&self, room: &mut Room, columns: &mut [f64]) {
        if self.size == 0 {
            return;
        }
        let count = columns.len() / self.size;
        let factor = LltRef::new(&self.symbolic, &self.values);
        let Room(memory) = room;
        let columns = MatMut::from_column_major_slice_mut(columns, self.size, count);
        factor.solve_in_place_with_conj(Conj::No, columns, Par::Seq, MemStack::new(memory));
    }
}

/// Displacement \[m\] at rest under `external` \[N\], with `displacement` given where not free.
/// Refined once or twice on the residual, which is returned relative to the largest force.
pub fn solve(
    pattern: &Pattern,
    tensors: &Tensors,
    free: &[[bool; 3]],
    external: &[Vec3],
    displacement: &mut [Vec3],
) -> Result<f64, StaticsError> {
    let numbering = Numbering::new(free.iter().copied());
    let factor = Factor::new(tensors.entries(pattern), &numbering, None)?;
    let lanes = |u: &[Vec3]| u.iter().map(|v| (*v).into()).collect::<Vec<_>>();
    let mut internal = vec![Vec3::zeros(); displacement.len()];
    let mut right = vec![0.0; numbering.unknowns()];
    let mut correction = vec![Vec3::zeros(); displacement.len()];
    let mut residual = f64::INFINITY;
    for _ in 0..4 {
        tensors.product(pattern, &lanes(displacement), &mut internal);
        let scale = external
            .iter()
            .chain(&internal)
            .map(|f| f.amax())
            .fold(0.0, f64::max);
        let rest: Vec<Vec3> = external.iter().zip(&internal).map(|(f, k)| f - k).collect();
        numbering.gather(&rest, &mut right);
        let now = right.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
        let now = if scale > 0.0 { now / scale } else { 0.0 };
        if now == 0.0 || now > 0.5 * residual {
            residual = residual.min(now);
            break;
        }
        residual = now;
        factor.solve(&mut right);
        correction.fill(Vec3::zeros());
        numbering.scatter(&right, &mut correction);
        for (u, d) in displacement.iter_mut().zip(&correction) {
            *u += d;
        }
    }
    // A singular matrix can slip through Cholesky by round-off: it shows as a huge solution.
    if !displacement.iter().all(|u| u.iter().all(|x| x.is_finite())) || residual > 1e-6 {
        return Err(StaticsError::NotHeld);
    }
    Ok(residual)
}
