//! Hooke's law, isotropic: W = lambda/2 (tr eps)^2 + mu eps:eps  \[J/m³\].

use nalgebra::Matrix3;

use crate::mesh::Vec3;

/// Lame's parameters \[Pa\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lame {
    pub lambda: f64,
    pub mu: f64,
}

impl Lame {
    /// lambda = E nu / ((1 + nu)(1 - 2 nu)), mu = E / (2 (1 + nu)).
    pub fn new(young_modulus: f64, poisson_ratio: f64) -> Lame {
        Lame {
            lambda: young_modulus * poisson_ratio
                / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio)),
            mu: young_modulus / (2.0 * (1.0 + poisson_ratio)),
        }
    }

    /// Stiffness block of two vertices of a constant-strain tetrahedron of rest volume V \[m³\] with
    /// shape gradients a_j, a_k \[1/m\]:
    ///
    /// K_jk = V \[lambda a_j a_k^T + mu a_k a_j^T + mu (a_j . a_k) I\]  \[N/m\], K_jk = K_kj^T.
    ///
    /// Cotin, Delingette, Ayache 1998, eq. 5, corrected: the outer products are transposed there.
    pub fn stiffness_block(&self, volume: f64, a_j: &Vec3, a_k: &Vec3) -> Matrix3<f64> {
        let mut block = a_j * a_k.transpose() * (volume * self.lambda)
            + a_k * a_j.transpose() * (volume * self.mu);
        let shear = volume * self.mu * a_j.dot(a_k);
        for axis in 0..3 {
            block[(axis, axis)] += shear;
        }
        block
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lame_parameters_of_liver() {
        let lame = Lame::new(6000.0, 0.45);
        assert!((lame.lambda - 18_620.689_655_172_413).abs() < 1e-9);
        assert!((lame.mu - 2_068.965_517_241_379).abs() < 1e-9);
    }

    #[test]
    fn blocks_transpose_into_each_other() {
        let (a, b) = (Vec3::new(1.0, 2.0, -3.0), Vec3::new(0.5, -4.0, 2.0));
        let lame = Lame {
            lambda: 3.0,
            mu: 2.0,
        };
        let forth = lame.stiffness_block(0.7, &a, &b);
        let back = lame.stiffness_block(0.7, &b, &a).transpose();
        assert!((forth - back).norm() < 1e-15 * forth.norm());
    }
}
