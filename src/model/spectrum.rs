//! The two ends of the spectrum: the highest frequency limits the substep, the lowest sets damping.

use nalgebra::{DMatrix, Matrix3, SymmetricEigen};
use serde::{Deserialize, Serialize};

use super::stiffness::Stiffness;
use super::tensor_mass::Lane;
use crate::mesh::Vec3;
use crate::statics::{Factor, Numbering, StaticsError};

/// Angular frequencies of M^-1 K on the free degrees of freedom \[1/s\]. K of springs: for the lowest the
/// tangent at rest, for the others what bounds the tangent at any stretch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spectrum {
    /// The lowest that is not a rigid motion; 0 where it was not needed and too dear to find.
    pub lowest: f64,
    /// The highest: above the truth by at most 0.05 %.
    pub highest: f64,
    /// No assembly of any of the tetrahedra exceeds it (lumped mass).
    pub element_bound: f64,
}

/// Highest angular frequency by Lanczos; the residual is added, so that the result is an upper bound of
/// the eigenvalue found. Without reorthogonalisation: copies of the largest do no harm, and two vectors
/// are all the memory.
pub fn highest(stiffness: Stiffness, mass: &[f64], free: &[[bool; 3]]) -> f64 {
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
    let most = free.iter().flatten().filter(|f| **f).count().min(240);
    // A fixed start with all modes in it.
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let mut next: Vec<Vec3> = (scale.iter())
        .map(|s| s.map(|s| if s > 0.0 { random.next() - 0.5 } else { 0.0 }))
        .collect();
    let mut before = vec![Vec3::zeros(); n];
    let (mut alpha, mut beta) = (Vec::new(), Vec::new());
    let (mut input, mut output) = (vec![Lane::default(); n], vec![Vec3::zeros(); n]);
    let mut norm = dot(&next, &next).sqrt();
    let mut estimate = 0.0f64;
    for step in 1..=most {
        if norm == 0.0 {
            break;
        }
        for i in 0..n {
            next[i] /= norm;
            input[i] = next[i].component_mul(&scale[i]).into();
        }
        stiffness.product(&input, &mut output);
        let last = beta.last().copied().unwrap_or(0.0);
        for i in 0..n {
            output[i].component_mul_assign(&scale[i]);
            output[i] -= before[i] * last;
        }
        let share = dot(&next, &output);
        for i in 0..n {
            output[i] -= next[i] * share;
        }
        alpha.push(share);
        norm = dot(&output, &output).sqrt();
        beta.push(norm);
        std::mem::swap(&mut before, &mut next);
        next.copy_from_slice(&output);
        if step % 12 == 0 || step == most {
            let small = DMatrix::from_fn(step, step, |r, c| match r.abs_diff(c) {
                0 => alpha[r],
                1 => beta[r.min(c)],
                _ => 0.0,
            });
            let eigen = SymmetricEigen::new(small);
            let top = eigen.eigenvalues.imax();
            let residual = norm * eigen.eigenvectors[(step - 1, top)].abs();
            estimate = eigen.eigenvalues[top] + residual;
            if residual < 5e-4 * eigen.eigenvalues[top] {
                break;
            }
        }
    }
    estimate.max(0.0).sqrt()
}

/// Lowest angular frequency of tissue that is held against every rigid motion, by locally optimal
/// conjugate gradients on the Rayleigh quotient with the vertex tensors as preconditioner (Knyazev
/// 2001): no factor, so it serves meshes whose factor would not fit.
pub fn lowest_held(stiffness: Stiffness, mass: &[f64], free: &[[bool; 3]]) -> f64 {
    let n = mass.len();
    let mut inverse = vec![Matrix3::zeros(); n];
    for (i, j, block) in stiffness.entries() {
        if i == j {
            inverse[i] += block;
        }
    }
    for (i, block) in inverse.iter_mut().enumerate() {
        for axis in (0..3).filter(|a| !free[i][*a]) {
            block.row_mut(axis).fill(0.0);
            block.column_mut(axis).fill(0.0);
            block[(axis, axis)] = 1.0;
        }
        *block = block.try_inverse().unwrap_or_else(Matrix3::zeros);
    }
    let only_free = |v: &mut [Vec3]| {
        for (v, free) in v.iter_mut().zip(free) {
            *v = Vec3::from_fn(|a, _| if free[a] { v[a] } else { 0.0 });
        }
    };
    let mut lanes = vec![Lane::default(); n];
    let mut product = |x: &[Vec3]| {
        lanes.iter_mut().zip(x).for_each(|(l, x)| *l = (*x).into());
        let mut kx = vec![Vec3::zeros(); n];
        stiffness.product(&lanes, &mut kx);
        only_free(&mut kx);
        kx
    };
    let weigh = |a: &[Vec3], b: &[Vec3]| -> f64 {
        a.iter()
            .zip(b)
            .zip(mass)
            .map(|((a, b), m)| m * a.dot(b))
            .sum()
    };
    let mut x = vec![Vec3::repeat(1.0); n];
    only_free(&mut x);
    let norm = weigh(&x, &x).sqrt();
    if norm == 0.0 {
        return 0.0;
    }
    x.iter_mut().for_each(|x| *x /= norm);
    let mut kx = product(&x);
    let mut value = dot(&x, &kx);
    let (mut p, mut kp): (Vec<Vec3>, Vec<Vec3>) = (Vec::new(), Vec::new());
    let mut settled = 0;
    for _ in 0..4000 {
        let mut w: Vec<Vec3> = (0..n)
            .map(|i| inverse[i] * (kx[i] - x[i] * (value * mass[i])))
            .collect();
        only_free(&mut w);
        let norm = weigh(&w, &w).sqrt();
        if norm == 0.0 {
            break;
        }
        w.iter_mut().for_each(|w| *w /= norm);
        let kw = product(&w);
        let (basis, images) = if p.is_empty() {
            (vec![&x, &w], vec![&kx, &kw])
        } else {
            (vec![&x, &w, &p], vec![&kx, &kw, &kp])
        };
        let size = basis.len();
        let stiff = DMatrix::from_fn(size, size, |r, c| dot(basis[r], images[c]));
        let heavy = DMatrix::from_fn(size, size, |r, c| weigh(basis[r], basis[c]));
        let Some(root) = heavy.cholesky().and_then(|c| c.l().try_inverse()) else {
            break;
        };
        let small = &root * (&stiff + stiff.transpose()) * root.transpose() * 0.5;
        let eigen = SymmetricEigen::new(small);
        let low = eigen.eigenvalues.imin();
        let share = root.transpose() * eigen.eigenvectors.column(low);
        let combine = |of: &[&Vec<Vec3>], from: usize| -> Vec<Vec3> {
            (0..n)
                .map(|i| (from..size).map(|k| of[k][i] * share[k]).sum())
                .collect()
        };
        let (new_p, new_kp) = (combine(&basis, 1), combine(&images, 1));
        let (new_x, new_kx) = (combine(&basis, 0), combine(&images, 0));
        let found = eigen.eigenvalues[low];
        settled = if (value - found).abs() < 1e-6 * found {
            settled + 1
        } else {
            0
        };
        (x, kx, value) = (new_x, new_kx, found);
        // Of unit mass, so that the three stay of one size.
        let norm = weigh(&new_p, &new_p).sqrt();
        p = new_p.into_iter().map(|v| v / norm).collect();
        kp = new_kp.into_iter().map(|v| v / norm).collect();
        if settled >= 5 {
            break;
        }
    }
    value.max(0.0).sqrt()
}

/// Numbers in 0..1 that look random and are the same everywhere (xorshift).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Lowest non-rigid angular frequency by subspace iteration on (K + shift M)^-1 M.
pub fn lowest(
    stiffness: Stiffness,
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
    let factor = Factor::new(stiffness.entries(), &numbering, Some((shift, mass)))?;
    let count = (rigid_modes + 6).min(size);
    let mut random = Random(0x2545_f491_4f6c_dd1d);
    let mut columns: Vec<f64> = (0..count * size).map(|_| random.next() - 0.5).collect();
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
