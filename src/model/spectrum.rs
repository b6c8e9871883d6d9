//! The two ends of the spectrum: the highest frequency limits the substep, the lowest sets damping.

use nalgebra::{DMatrix, SymmetricEigen};
use serde::{Deserialize, Serialize};

use super::tensor_mass::{Lane, Pattern, Tensors};
use crate::mesh::Vec3;
use crate::statics::{Factor, Numbering, StaticsError};

/// Angular frequencies of M^-1 K on the free degrees of freedom \[1/s\].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spectrum {
    /// The lowest that is not a rigid motion.
    pub lowest: f64,
    /// The highest: above the truth by at most 0.05 %.
    pub highest: f64,
    /// No assembly of any of the tetrahedra exceeds it (lumped mass).
    pub element_bound: f64,
}

/// Highest angular frequency by Lanczos with full reorthogonalisation; the residual is added, so that
/// the result is an upper bound of the eigenvalue found.
pub fn highest(pattern: &Pattern, tensors: &Tensors, mass: &[f64], free: &[[bool; 3]]) -> f64 {
    let n = mass.len();
    // Inverse square roots of the masses; zero where not free.
    let scale: Vec<Vec3> = (0..n)
        .map(|i| {
            Vec3::from_fn(|a, _| {
                if free[i][a] && mass[i] > 0.0 {
                    mass[i].powf(-0.5)
                } else {
                    0.0
                }
            })
        })
        .collect();
    let dofs = free.iter().flatten().filter(|f| **f).count();
    let mut basis: Vec<Vec<Vec3>> = Vec::new();
    // A fixed start with all modes in it.
    let mut seed = 0x9e37_79b9_7f4a_7c15_u64;
    let mut next: Vec<Vec3> = (0..n)
        .map(|i| {
            Vec3::from_fn(|a, _| {
                seed ^= seed << 13;
                seed ^= seed >> 7;
                seed ^= seed << 17;
                if scale[i][a] > 0.0 {
                    (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
                } else {
                    0.0
                }
            })
        })
        .collect();
    let (mut alpha, mut beta) = (Vec::new(), Vec::new());
    let (mut input, mut output) = (vec![Lane::default(); n], vec![Vec3::zeros(); n]);
    let mut estimate = 0.0f64;
    for step in 0..dofs.min(240) {
        let norm = dot(&next, &next).sqrt();
        if norm == 0.0 {
            break;
        }
        next.iter_mut().for_each(|v| *v /= norm);
        for i in 0..n {
            input[i] = next[i].component_mul(&scale[i]).into();
        }
        tensors.product(pattern, &input, &mut output);
        for i in 0..n {
            output[i].component_mul_assign(&scale[i]);
        }
        alpha.push(dot(&next, &output));
        basis.push(std::mem::replace(&mut next, output.clone()));
        for _ in 0..2 {
            for q in &basis {
                let share = dot(q, &next);
                next.iter_mut().zip(q).for_each(|(v, q)| *v -= q * share);
            }
        }
        beta.push(dot(&next, &next).sqrt());
        if step % 8 == 7 || step + 1 == dofs.min(240) {
            let k = alpha.len();
            let small = DMatrix::from_fn(k, k, |r, c| {
                if r == c {
                    alpha[r]
                } else if r.abs_diff(c) == 1 {
                    beta[r.min(c)]
                } else {
                    0.0
                }
            });
            let eigen = SymmetricEigen::new(small);
            let top = eigen.eigenvalues.imax();
            let residual = beta[k - 1] * eigen.eigenvectors[(k - 1, top)].abs();
            let value = eigen.eigenvalues[top];
            estimate = value + residual;
            if residual < 5e-4 * value {
                break;
            }
        }
    }
    estimate.max(0.0).sqrt()
}

/// Lowest non-rigid angular frequency by subspace iteration on (K + shift M)^-1 M.
pub fn lowest(
    pattern: &Pattern,
    tensors: &Tensors,
    mass: &[f64],
    free: &[[bool; 3]],
    highest: f64,
    rigid_modes: usize,
) -> Result<f64, StaticsError> {
    // A degree of freedom without mass (a node without tetrahedra) is no unknown.
    let numbering = Numbering::new(
        free.iter()
            .zip(mass)
            .map(|(f, m)| if *m > 0.0 { *f } else { [false; 3] }),
    );
    let size = numbering.unknowns();
    if size == 0 {
        return Ok(0.0);
    }
    let rigid_limit = 1e-9 * highest * highest;
    // With nothing loose the matrix itself is positive definite; else a shift far below any
    // elastic mode makes it so.
    let shift = if rigid_modes > 0 {
        1e-6 * highest * highest
    } else {
        0.0
    };
    let factor = Factor::new(pattern, tensors, &numbering, Some((shift, mass)))?;
    let count = (rigid_modes + 6).min(size);
    let mut seed = 0x2545_f491_4f6c_dd1d_u64;
    let mut columns: Vec<f64> = (0..count * size)
        .map(|_| {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        })
        .collect();
    let mut masses = vec![0.0; size];
    let as_vectors: Vec<Vec3> = mass.iter().map(|m| Vec3::repeat(*m)).collect();
    numbering.gather(&as_vectors, &mut masses);
    let mut found = 0.0f64;
    for round in 0..60 {
        let before: Vec<f64> = columns
            .chunks(size)
            .flat_map(|c| c.iter().zip(&masses).map(|(x, m)| x * m))
            .collect();
        columns.copy_from_slice(&before);
        factor.solve(&mut columns);
        // Rayleigh-Ritz: X^T (K + shift M) X = X^T M x_before, X^T M X.
        let x = |c: usize| &columns[c * size..(c + 1) * size];
        let stiff = DMatrix::from_fn(count, count, |r, c| {
            x(r).iter()
                .zip(&before[c * size..(c + 1) * size])
                .map(|(a, b)| a * b)
                .sum::<f64>()
        });
        let weigh = DMatrix::from_fn(count, count, |r, c| {
            x(r).iter()
                .zip(x(c))
                .zip(&masses)
                .map(|((a, b), m)| a * b * m)
                .sum::<f64>()
        });
        let stiff = (&stiff + stiff.transpose()) * 0.5;
        let Some(cholesky) = weigh.cholesky() else {
            break;
        };
        let inverse = cholesky
            .l()
            .try_inverse()
            .unwrap_or_else(|| DMatrix::identity(count, count));
        let eigen = SymmetricEigen::new(&inverse * stiff * inverse.transpose());
        let turn = inverse.transpose() * &eigen.eigenvectors;
        let old = columns.clone();
        for c in 0..count {
            for row in 0..size {
                columns[c * size + row] =
                    (0..count).map(|k| old[k * size + row] * turn[(k, c)]).sum();
            }
        }
        let value = eigen
            .eigenvalues
            .iter()
            .map(|v| v - shift)
            .filter(|v| *v > rigid_limit)
            .fold(f64::INFINITY, f64::min);
        if !value.is_finite() {
            break;
        }
        let settled = (value - found).abs() < 1e-7 * value;
        found = value;
        if settled && round > 2 {
            break;
        }
    }
    Ok(found.max(0.0).sqrt())
}

fn dot(a: &[Vec3], b: &[Vec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}
