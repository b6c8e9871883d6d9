//! Sparse direct solution, the only place that knows faer.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Conj, MatMut, Par, Side, Spec};

use crate::mesh::Vec3;
use crate::model::tensor_mass::{Pattern, Tensors};

/// Why there is no solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StaticsError {
    #[error(
        "the stiffness matrix is not positive definite: some tissue is not held against every rigid motion; fix at least three nodes of each piece that are not in line"
    )]
    NotHeld,
    #[error("not enough memory for the factor")]
    Memory,
}

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

/// Cholesky factor of K + shift M on the unknowns.
pub struct Factor {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
    size: usize,
}

impl Factor {
    /// `shifted`: shift \[1/s²\] and the masses \[kg\] a node.
    pub fn new(
        pattern: &Pattern,
        tensors: &Tensors,
        numbering: &Numbering,
        shifted: Option<(f64, &[f64])>,
    ) -> Result<Factor, StaticsError> {
        let mut lower = Vec::new();
        for (i, j, block) in tensors.entries(pattern) {
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
                    let diagonal = match shifted {
                        Some((shift, mass)) if p == q => shift * mass[i],
                        _ => 0.0,
                    };
                    let (row, column) = (p.max(q) as usize, p.min(q) as usize);
                    lower.push(Triplet::new(row, column, block[(a, b)] + diagonal));
                }
            }
        }
        let size = numbering.count;
        let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(size, size, &lower)
            .map_err(|_| StaticsError::Memory)?;
        drop(lower);
        let symbolic = factorize_symbolic_cholesky(
            matrix.symbolic(),
            Side::Lower,
            SymmetricOrdering::Amd,
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

    /// Solves in place for right sides stored one after the other.
    pub fn solve(&self, columns: &mut [f64]) {
        if self.size == 0 {
            return;
        }
        let count = columns.len() / self.size;
        let factor = LltRef::new(&self.symbolic, &self.values);
        let mut memory = MemBuffer::new(
            factor
                .symbolic()
                .solve_in_place_scratch::<f64>(count, Par::Seq),
        );
        let columns = MatMut::from_column_major_slice_mut(columns, self.size, count);
        factor.solve_in_place_with_conj(Conj::No, columns, Par::Seq, MemStack::new(&mut memory));
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
    let factor = Factor::new(pattern, tensors, &numbering, None)?;
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
