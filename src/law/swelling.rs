//! By how much a law takes tissue to have swollen, theta: what lambda resists.
//!
//! psi = lambda/2 theta² + psi at lambda = 0  \[J/m³\]
//! linear: theta = tr eps, dtheta/dF = I
//! St Venant and Kirchhoff: theta = tr E, dtheta/dF = F
//! stable neo-Hookean: theta = det F - 1, dtheta/dF = cof F
//!
//! Each is div u at small strain.

use nalgebra::Matrix3;

use super::linear::{Hooke, Linear};
use super::response::{Law, Point};
use super::st_venant_kirchhoff::{self, StVenantKirchhoff};
use super::stable_neo_hookean::{self, StableNeoHookean};
use crate::lanes::{Four, Square, cofactors};

impl Law {
    /// theta
    pub fn swelling(self, f: &Matrix3<f64>) -> f64 {
        match self {
            Law::Linear => f.trace() - 3.0,
            Law::StVenantKirchhoff => st_venant_kirchhoff::green(f).trace(),
            Law::StableNeoHookean => f.determinant() - 1.0,
        }
    }

    /// dtheta/dF
    pub fn swelling_rate(self, f: &Matrix3<f64>) -> Matrix3<f64> {
        match self {
            Law::Linear => Matrix3::identity(),
            Law::StVenantKirchhoff => *f,
            Law::StableNeoHookean => stable_neo_hookean::cofactor(f),
        }
    }

    /// d²theta/dF² : dF
    pub fn swelling_change(self, f: &Matrix3<f64>, df: &Matrix3<f64>) -> Matrix3<f64> {
        match self {
            Law::Linear => Matrix3::zeros(),
            Law::StVenantKirchhoff => *df,
            Law::StableNeoHookean => stable_neo_hookean::cofactor_change(f, df),
        }
    }
}

impl Hooke {
    /// What is left at lambda = 0, with the same kappa.
    pub fn without_lambda(&self) -> Hooke {
        Hooke {
            lambda: 0.0,
            ..*self
        }
    }
}

/// theta in four lanes.
pub(crate) trait Swelling {
    /// # Safety
    /// As [`Four`].
    unsafe fn swelling<V: Four>(point: &Point<V>) -> V;

    /// dtheta/dF
    ///
    /// # Safety
    /// As [`Four`].
    unsafe fn swelling_rate<V: Four>(point: &Point<V>) -> Square<V>;
}

impl Swelling for Linear {
    #[inline(always)]
    unsafe fn swelling<V: Four>(point: &Point<V>) -> V {
        // SAFETY: the caller's.
        unsafe { point.g[0][0].add(point.g[1][1]).add(point.g[2][2]) }
    }

    #[inline(always)]
    unsafe fn swelling_rate<V: Four>(_: &Point<V>) -> Square<V> {
        // SAFETY: the caller's.
        unsafe {
            let (one, zero) = (V::splat(1.0), V::splat(0.0));
            [[one, zero, zero], [zero, one, zero], [zero, zero, one]]
        }
    }
}

impl Swelling for StVenantKirchhoff {
    #[inline(always)]
    unsafe fn swelling<V: Four>(point: &Point<V>) -> V {
        // SAFETY: the caller's.
        unsafe { V::splat(0.5).mul(point.trace) }
    }

    #[inline(always)]
    unsafe fn swelling_rate<V: Four>(point: &Point<V>) -> Square<V> {
        point.f
    }
}

impl Swelling for StableNeoHookean {
    #[inline(always)]
    unsafe fn swelling<V: Four>(point: &Point<V>) -> V {
        // SAFETY: the caller's.
        unsafe { point.volume_ratio.sub(V::splat(1.0)) }
    }

    #[inline(always)]
    unsafe fn swelling_rate<V: Four>(point: &Point<V>) -> Square<V> {
        // SAFETY: the caller's.
        unsafe { cofactors(&point.f) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Vec3;

    #[test]
    fn lambda_resists_nothing_else() {
        let f = Matrix3::new(1.2, -0.1, 0.3, 0.4, 0.7, 0.1, -0.2, 0.25, 1.15);
        let d = Matrix3::new(0.3, -0.5, 0.2, 0.7, 0.1, -0.4, 0.6, -0.2, 0.8);
        let material = Hooke::new(6000.0, 0.45).with_fibre(Vec3::new(1.0, 2.0, -1.0), 8e4, 2e4);
        let (lambda, rest) = (material.lambda, material.without_lambda());
        for law in [Law::Linear, Law::StVenantKirchhoff, Law::StableNeoHookean] {
            let (theta, rate) = (law.swelling(&f), law.swelling_rate(&f));
            let energy = 0.5 * lambda * theta * theta;
            let off = law.energy(&material, &f) - law.energy(&rest, &f) - energy;
            assert!(off.abs() < 1e-12 * energy, "{law:?} {off}");
            let stress = rate * (lambda * theta);
            let off = law.stress(&material, &f) - law.stress(&rest, &f) - stress;
            assert!(off.norm() < 1e-12 * stress.norm(), "{law:?} {off}");
            let bent = law.swelling_change(&f, &d) * theta;
            let tangent = (rate * rate.component_mul(&d).sum() + bent) * lambda;
            let off = law.tangent(&material, &f, &d) - law.tangent(&rest, &f, &d) - tangent;
            assert!(off.norm() < 1e-12 * tangent.norm(), "{law:?} {off}");
        }
    }
}
