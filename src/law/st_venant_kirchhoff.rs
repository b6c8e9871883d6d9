//! St Venant and Kirchhoff's law: Hooke's on Green's strain, right under any rotation.
//!
//! W = lambda/2 (tr E)² + mu E:E + kappa (a0 . E a0)²,  E = (F^T F - I)/2  \[J/m³\]
//! P = F S,  S = lambda tr(E) I + 2 mu E + 2 kappa (a0 . E a0) a0 a0^T  \[Pa\]
//!
//! (Picinbono, Delingette, Ayache 2003, section 3.) Compressed below 1/sqrt(3) of its length it softens, and what is
//! mirrored is at rest again.

use nalgebra::Matrix3;

use super::linear::{Fibre, Hooke};
use super::response::{Point, Response};
use crate::lanes::{Four, Square, product};

/// W \[J/m³\].
pub fn energy(law: &Hooke, f: &Matrix3<f64>) -> f64 {
    let strain = green(f);
    let mut energy =
        0.5 * law.lambda * strain.trace().powi(2) + law.mu * strain.component_mul(&strain).sum();
    if let Some(Fibre { direction, kappa }) = &law.fibre {
        energy += kappa * direction.dot(&(strain * direction)).powi(2);
    }
    energy
}

/// P \[Pa\].
pub fn stress(law: &Hooke, f: &Matrix3<f64>) -> Matrix3<f64> {
    f * law.stress(&green(f))
}

/// Change of P with F: dP = dF S + F dS, dS = Hooke's of the symmetric part of F^T dF.
pub fn tangent(law: &Hooke, f: &Matrix3<f64>, df: &Matrix3<f64>) -> Matrix3<f64> {
    let rate = f.transpose() * df;
    df * law.stress(&green(f)) + f * law.stress(&((rate + rate.transpose()) * 0.5))
}

/// E = (F^T F - I)/2.
pub fn green(f: &Matrix3<f64>) -> Matrix3<f64> {
    (f.transpose() * f - Matrix3::identity()) * 0.5
}

/// [`stress`] of four points, but for the fibre.
pub(crate) struct StVenantKirchhoff;

impl Response for StVenantKirchhoff {
    fn parameters(law: &Hooke) -> [f64; 2] {
        [law.lambda, law.mu]
    }

    #[inline(always)]
    unsafe fn respond<V: Four>(point: &Point<V>, [lambda, mu]: [V; 2]) -> (Square<V>, V) {
        // SAFETY: the caller's.
        unsafe {
            let (f, d) = (&point.f, &point.twice_strain);
            let half = V::splat(0.5);
            let pressure = half.mul(lambda).mul(point.trace);
            let [d00, d11, d22, d12, d20, d01] = *d;
            let s00 = mu.mul_add(d00, pressure);
            let s11 = mu.mul_add(d11, pressure);
            let s22 = mu.mul_add(d22, pressure);
            let (s12, s20, s01) = (mu.mul(d12), mu.mul(d20), mu.mul(d01));
            let s = [[s00, s01, s20], [s01, s11, s12], [s20, s12, s22]];
            // W = S : D / 4.
            let own = s00.mul_add(d00, s11.mul_add(d11, s22.mul(d22)));
            let shear = s12.mul_add(d12, s20.mul_add(d20, s01.mul(d01)));
            let energy = V::splat(0.25).mul(shear.add(shear).add(own));
            (
                [product(&s, f[0]), product(&s, f[1]), product(&s, f[2])],
                energy,
            )
        }
    }
}
