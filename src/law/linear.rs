//! Hooke's law, isotropic or transversely isotropic:
//!
//! W = lambda/2 (tr eps)² + mu eps:eps + kappa (a0 . eps a0)²  \[J/m³\], a0 the unit fibre direction.
//!
//! (Picinbono, Delingette, Ayache 2003, linear part of the transversely isotropic law.)

use nalgebra::{Cholesky, Const, Matrix3, Matrix6, Vector6};

use super::response::{Point, Response};
use crate::lanes::{Four, Square, dot};
use crate::mesh::Vec3;

/// A linear material \[Pa\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hooke {
    /// Lame's parameters.
    pub lambda: f64,
    pub mu: f64,
    pub fibre: Option<Fibre>,
    /// k of [`super::volume_penalty`]; laws for large deformation alone have it.
    pub penalty: f64,
}

/// Extra stiffness along one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fibre {
    /// a0, of length 1.
    pub direction: Vec3,
    /// kappa = (lambda_L - lambda)/2 + mu_L - mu \[Pa\].
    pub kappa: f64,
}

impl Hooke {
    /// lambda = E nu / ((1 + nu)(1 - 2 nu)), mu = E / (2 (1 + nu)).
    pub fn new(young_modulus: f64, poisson_ratio: f64) -> Hooke {
        Hooke {
            lambda: young_modulus * poisson_ratio
                / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio)),
            mu: young_modulus / (2.0 * (1.0 + poisson_ratio)),
            fibre: None,
            penalty: 0.0,
        }
    }

    /// lambda + 2 mu/3.
    pub fn bulk_modulus(&self) -> f64 {
        self.lambda + 2.0 / 3.0 * self.mu
    }

    pub fn with_penalty(self, penalty: f64) -> Hooke {
        Hooke { penalty, ..self }
    }

    /// With other parameters lambda_L, mu_L \[Pa\] along a direction of any length but zero.
    pub fn with_fibre(self, direction: Vec3, lambda: f64, mu: f64) -> Hooke {
        let kappa = (lambda - self.lambda) / 2.0 + mu - self.mu;
        Hooke {
            fibre: Some(Fibre {
                direction: direction.normalize(),
                kappa,
            }),
            ..self
        }
    }

    /// Without penalty, of the same stiffness at rest.
    pub fn at_rest(&self) -> Hooke {
        Hooke {
            lambda: self.lambda + self.penalty,
            penalty: 0.0,
            ..*self
        }
    }

    /// Stiffness block of two vertices of a constant-strain tetrahedron of rest volume V \[m³\] with
    /// shape gradients a_j, a_k \[1/m\], s_j = a0 . a_j:
    ///
    /// K_jk = V \[lambda a_j a_k^T + mu a_k a_j^T + mu (a_j . a_k) I + 2 kappa s_j s_k a0 a0^T\]  \[N/m\],
    /// K_jk = K_kj^T.
    ///
    /// Cotin, Delingette, Ayache 1998, eq. 5, corrected: the outer products are transposed there.
    pub fn stiffness_block(&self, volume: f64, a_j: &Vec3, a_k: &Vec3) -> Matrix3<f64> {
        let mut block = a_j * a_k.transpose() * (volume * self.lambda)
            + a_k * a_j.transpose() * (volume * self.mu);
        let shear = volume * self.mu * a_j.dot(a_k);
        for axis in 0..3 {
            block[(axis, axis)] += shear;
        }
        if let Some(Fibre { direction, kappa }) = &self.fibre {
            let both = direction.dot(a_j) * direction.dot(a_k);
            block += direction * direction.transpose() * (2.0 * volume * kappa * both);
        }
        block
    }

    /// sigma = lambda tr(eps) I + 2 mu eps + 2 kappa (a0 . eps a0) a0 a0^T \[Pa\].
    pub fn stress(&self, strain: &Matrix3<f64>) -> Matrix3<f64> {
        let mut stress = strain * (2.0 * self.mu);
        let pressure = self.lambda * strain.trace();
        for axis in 0..3 {
            stress[(axis, axis)] += pressure;
        }
        if let Some(Fibre { direction, kappa }) = &self.fibre {
            let stretch = direction.dot(&(strain * direction));
            stress += direction * direction.transpose() * (2.0 * kappa * stretch);
        }
        stress
    }

    /// C in Mandel's notation (xx yy zz, sqrt 2 times yz zx xy) \[Pa\]; positive definite for a stable
    /// material.
    pub fn mandel(&self) -> Matrix6<f64> {
        let mut c = Matrix6::identity() * (2.0 * self.mu);
        for row in 0..3 {
            for column in 0..3 {
                c[(row, column)] += self.lambda;
            }
        }
        if let Some(Fibre {
            direction: a,
            kappa,
        }) = &self.fibre
        {
            let m = dyad(a);
            c += m * m.transpose() * (2.0 * kappa);
        }
        c
    }

    /// Young's modulus along a unit direction \[Pa\]: 1/E(n) = (n (x) n) : C^-1 : (n (x) n).
    pub fn young_modulus_along(&self, n: &Vec3) -> f64 {
        if self.fibre.is_none() {
            return self.mu * (3.0 * self.lambda + 2.0 * self.mu) / (self.lambda + self.mu);
        }
        let m = dyad(n);
        let compliance = |c: Cholesky<f64, Const<6>>| m.dot(&c.solve(&m));
        self.mandel()
            .cholesky()
            .map_or(0.0, |c| 1.0 / compliance(c))
    }

    /// Whether every strain costs energy.
    pub fn is_stable(&self) -> bool {
        self.mandel().cholesky().is_some()
    }
}

/// eps, the symmetric part of F - I.
pub fn strain(f: &Matrix3<f64>) -> Matrix3<f64> {
    (f + f.transpose()) * 0.5 - Matrix3::identity()
}

/// W \[J/m³\].
pub fn energy(law: &Hooke, f: &Matrix3<f64>) -> f64 {
    let strain = strain(f);
    0.5 * law.stress(&strain).component_mul(&strain).sum()
}

/// [`Hooke::stress`] of four points, but for the fibre.
pub(crate) struct Linear;

impl Response for Linear {
    const IS_LINEAR: bool = true;

    fn parameters(law: &Hooke) -> [f64; 2] {
        [law.lambda, law.mu]
    }

    #[inline(always)]
    unsafe fn respond<V: Four>(point: &Point<V>, [lambda, mu]: [V; 2]) -> (Square<V>, V) {
        // SAFETY: the caller's.
        unsafe {
            let g = &point.g;
            let trace = g[0][0].add(g[1][1]).add(g[2][2]);
            let (pressure, twice) = (lambda.mul(trace), mu.add(mu));
            let xx = twice.mul_add(g[0][0], pressure);
            let yy = twice.mul_add(g[1][1], pressure);
            let zz = twice.mul_add(g[2][2], pressure);
            let (yz, zx) = (g[1][2].add(g[2][1]), g[2][0].add(g[0][2]));
            let xy = g[0][1].add(g[1][0]);
            let (s_yz, s_zx, s_xy) = (mu.mul(yz), mu.mul(zx), mu.mul(xy));
            let own = dot([xx, yy, zz], [g[0][0], g[1][1], g[2][2]]);
            let shear = dot([s_yz, s_zx, s_xy], [yz, zx, xy]);
            (
                [[xx, s_xy, s_zx], [s_xy, yy, s_yz], [s_zx, s_yz, zz]],
                V::splat(0.5).mul(own.add(shear)),
            )
        }
    }

    /// kappa (a0 . eps a0)².
    #[inline(always)]
    unsafe fn add_fibre<V: Four>(
        point: &Point<V>,
        a0: [V; 3],
        kappa: V,
        stress: &mut Square<V>,
        energy: &mut V,
    ) {
        // SAFETY: the caller's.
        unsafe {
            let g = &point.g;
            let stretch = dot(a0, [dot(g[0], a0), dot(g[1], a0), dot(g[2], a0)]);
            let pull = kappa.mul(stretch);
            *energy = pull.mul_add(stretch, *energy);
            let twice = pull.add(pull);
            for k in 0..3 {
                let pull = twice.mul(a0[k]);
                stress[k][0] = pull.mul_add(a0[0], stress[k][0]);
                stress[k][1] = pull.mul_add(a0[1], stress[k][1]);
                stress[k][2] = pull.mul_add(a0[2], stress[k][2]);
            }
        }
    }
}

/// a (x) a in Mandel's notation.
fn dyad(a: &Vec3) -> Vector6<f64> {
    let root = std::f64::consts::SQRT_2;
    Vector6::new(
        a.x * a.x,
        a.y * a.y,
        a.z * a.z,
        root * a.y * a.z,
        root * a.z * a.x,
        root * a.x * a.y,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lame_parameters_of_liver() {
        let law = Hooke::new(6000.0, 0.45);
        assert!((law.lambda - 18_620.689_655_172_413).abs() < 1e-9);
        assert!((law.mu - 2_068.965_517_241_379).abs() < 1e-9);
    }

    #[test]
    fn blocks_transpose_into_each_other() {
        let (a, b) = (Vec3::new(1.0, 2.0, -3.0), Vec3::new(0.5, -4.0, 2.0));
        let law = Hooke::new(3.0, 0.3).with_fibre(Vec3::new(1.0, 1.0, 0.2), 9.0, 4.0);
        let forth = law.stiffness_block(0.7, &a, &b);
        let back = law.stiffness_block(0.7, &b, &a).transpose();
        assert!((forth - back).norm() < 1e-15 * forth.norm());
    }

    /// Along the fibre lambda_L + 2 mu_L, across it lambda + 2 mu: confined stretches.
    #[test]
    fn fibre_stiffens_its_own_direction_only() {
        let law = Hooke::new(6000.0, 0.3).with_fibre(Vec3::new(0.0, 0.0, 2.0), 9000.0, 7000.0);
        let along = law.stress(&Matrix3::from_diagonal(&Vec3::z()));
        let across = law.stress(&Matrix3::from_diagonal(&Vec3::x()));
        assert!((along[(2, 2)] - (9000.0 + 2.0 * 7000.0)).abs() < 1e-9);
        assert!((along[(0, 0)] - law.lambda).abs() < 1e-9);
        assert!((across[(0, 0)] - (law.lambda + 2.0 * law.mu)).abs() < 1e-9);
    }

    /// sigma = E(n) n (x) n is what strain C^-1 sigma answers, of which n . eps n = 1.
    #[test]
    fn young_modulus_along_is_that_of_a_free_pull() {
        let plain = Hooke::new(6000.0, 0.3);
        assert!((plain.young_modulus_along(&Vec3::x()) - 6000.0).abs() < 1e-9);
        // Without kappa both forms must agree; with it the fibre direction must be stiffer.
        let zero = plain.with_fibre(Vec3::z(), plain.lambda, plain.mu);
        let n = Vec3::new(0.48, -0.6, 0.64);
        assert!((zero.young_modulus_along(&n) - 6000.0).abs() < 1e-9);
        let law = plain.with_fibre(Vec3::new(1.0, 2.0, -1.0), 4e4, 9e3);
        let strain = Vector6::from(law.mandel().cholesky().unwrap().solve(&dyad(&n)));
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let (yz, zx, xy) = (half * strain[3], half * strain[4], half * strain[5]);
        let strain = Matrix3::new(strain[0], xy, zx, xy, strain[1], yz, zx, yz, strain[2]);
        let modulus = 1.0 / n.dot(&(strain * n));
        assert!((law.young_modulus_along(&n) - modulus).abs() < 1e-9 * modulus);
        let stress = law.stress(&(strain * modulus));
        assert!((stress - n * n.transpose() * modulus).norm() < 1e-9 * modulus);
        let along = Vec3::new(1.0, 2.0, -1.0).normalize();
        assert!(law.young_modulus_along(&along) > 12_000.0);
    }

    #[test]
    fn a_fibre_softer_than_nothing_is_unstable() {
        let law = Hooke::new(6000.0, 0.3);
        assert!(law.is_stable() && law.with_fibre(Vec3::x(), 0.0, 2000.0).is_stable());
        assert!(!law.with_fibre(Vec3::x(), -9000.0, 100.0).is_stable());
    }
}
