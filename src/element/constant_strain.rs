//! The linear tetrahedron: one gradient a tetrahedron.

use nalgebra::{Matrix3, SMatrix, SymmetricEigen};

use crate::law::linear::Hooke;
use crate::mesh::Vec3;

/// A tetrahedron at rest.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Rest volume V = det(P1-P0, P2-P0, P3-P0)/6 > 0 \[m³\].
    pub volume: f64,
    /// a_j = gradient of barycentric coordinate j \[1/m\]; a_j = (-1)^{j+1} M_j / (6V) with M_j of the
    /// papers, sign corrected. They sum to zero.
    pub gradient: [Vec3; 4],
}

impl Shape {
    /// Of four rest positions, positively oriented.
    pub fn new(p: [Vec3; 4]) -> Shape {
        let edges = Matrix3::from_columns(&[p[1] - p[0], p[2] - p[0], p[3] - p[0]]);
        let six_volume = edges.determinant();
        let a1 = edges.column(1).cross(&edges.column(2)) / six_volume;
        let a2 = edges.column(2).cross(&edges.column(0)) / six_volume;
        let a3 = edges.column(0).cross(&edges.column(1)) / six_volume;
        Shape {
            volume: six_volume / 6.0,
            gradient: [-(a1 + a2 + a3), a1, a2, a3],
        }
    }

    /// F = I + sum_j u_j a_j^T.
    pub fn deformation_gradient(&self, u: &[Vec3; 4]) -> Matrix3<f64> {
        let mut f = Matrix3::identity();
        for (u_j, a_j) in u.iter().zip(&self.gradient) {
            f += u_j * a_j.transpose();
        }
        f
    }

    /// Internal forces K u \[N\] of the four vertices.
    pub fn linear_force(&self, law: &Hooke, u: &[Vec3; 4]) -> [Vec3; 4] {
        let grad = self.deformation_gradient(u) - Matrix3::identity();
        let stress = law.stress(&((grad + grad.transpose()) * 0.5));
        self.gradient.map(|a| stress * a * self.volume)
    }

    /// Largest eigenvalue of M^-1 K of this tetrahedron alone, a quarter of its mass on each vertex
    /// \[1/s²\]. The largest over all tetrahedra bounds that of any assembly of them
    /// (lumped mass), hence of what any cut leaves.
    pub fn largest_eigenvalue(&self, law: &Hooke, density: f64) -> f64 {
        // K = V B^T C B has the non-zero eigenvalues of V L^T B B^T L, C = L L^T, 6 x 6.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let mut strain = SMatrix::<f64, 6, 12>::zeros();
        for (j, a) in self.gradient.iter().enumerate() {
            for axis in 0..3 {
                let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                strain[(axis, 3 * j + axis)] = a[axis];
                strain[(3 + c, 3 * j + axis)] = half * a[b];
                strain[(3 + b, 3 * j + axis)] = half * a[c];
            }
        }
        let Some(root) = law.mandel().cholesky() else {
            return f64::INFINITY;
        };
        let scaled = root.l().transpose() * strain;
        let gram = scaled * scaled.transpose() * self.volume;
        let largest = SymmetricEigen::new(gram).eigenvalues.max();
        largest / (density * self.volume / 4.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape() -> Shape {
        Shape::new([
            Vec3::new(0.0, 0.1, 0.0),
            Vec3::new(1.0, 0.0, 0.2),
            Vec3::new(0.1, 1.2, 0.0),
            Vec3::new(0.3, 0.2, 0.9),
        ])
    }

    #[test]
    fn gradients_reproduce_a_linear_field() {
        let p = [Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()];
        let shape = Shape::new(p);
        let g = Matrix3::new(0.1, 0.2, 0.3, -0.4, 0.5, 0.6, 0.7, -0.8, 0.9);
        let f = shape.deformation_gradient(&p.map(|x| g * x));
        assert!((f - g - Matrix3::identity()).norm() < 1e-15);
        assert!((shape.volume - 1.0 / 6.0).abs() < 1e-16);
    }

    #[test]
    fn stress_form_equals_stiffness_blocks() {
        let (shape, law) = (
            shape(),
            Hooke::new(6000.0, 0.45).with_fibre(Vec3::new(1.0, 2.0, -1.0), 4e4, 9e3),
        );
        let u = [
            Vec3::new(0.01, -0.02, 0.03),
            Vec3::new(0.02, 0.01, 0.0),
            Vec3::new(-0.03, 0.0, 0.01),
            Vec3::new(0.0, 0.02, -0.01),
        ];
        let f = shape.linear_force(&law, &u);
        for j in 0..4 {
            let mut sum = Vec3::zeros();
            for k in 0..4 {
                sum += law.stiffness_block(shape.volume, &shape.gradient[j], &shape.gradient[k])
                    * u[k];
            }
            assert!((sum - f[j]).norm() < 1e-13 * f[j].norm());
        }
    }

    #[test]
    fn reduced_eigenvalue_equals_that_of_the_full_matrix() {
        let (shape, law) = (
            shape(),
            Hooke::new(6000.0, 0.45).with_fibre(Vec3::new(1.0, 2.0, -1.0), 4e4, 9e3),
        );
        let mut k = SMatrix::<f64, 12, 12>::zeros();
        for i in 0..4 {
            for j in 0..4 {
                let block =
                    law.stiffness_block(shape.volume, &shape.gradient[i], &shape.gradient[j]);
                k.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&block);
            }
        }
        let full = SymmetricEigen::new(k).eigenvalues.max() / (1000.0 * shape.volume / 4.0);
        let reduced = shape.largest_eigenvalue(&law, 1000.0);
        assert!((full - reduced).abs() < 1e-12 * full);
    }
}
