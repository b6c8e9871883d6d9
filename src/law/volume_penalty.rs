//! A penalty on changes of volume: tissue that hardly changes its volume at forces that its shear modulus decides.
//!
//! W = k/2 (J - 1)²,  P = k (J - 1) cof F,  J = det F; k a pressure \[Pa\].
//!
//! It pulls a vertex in where tissue has swollen and pushes it out where it is squeezed: k (J - 1) A_p n_p / 3 towards
//! the face opposite. (Picinbono, Delingette, Ayache 2003, section 4; corrected, see docs: the papers' square of the change
//! pushes the same way in both cases.)

use nalgebra::{Matrix3, Vector3};

use super::response::Point;
use crate::lanes::{Four, Square, cofactors};

/// W \[J/m³\].
pub fn energy(k: f64, f: &Matrix3<f64>) -> f64 {
    0.5 * k * (f.determinant() - 1.0).powi(2)
}

/// P \[Pa\].
pub fn stress(k: f64, f: &Matrix3<f64>) -> Matrix3<f64> {
    cofactor(f) * (k * (f.determinant() - 1.0))
}

/// Change of P with F.
pub fn tangent(k: f64, f: &Matrix3<f64>, df: &Matrix3<f64>) -> Matrix3<f64> {
    let cof = cofactor(f);
    // cof is quadratic.
    let change = (cofactor(&(f + df)) - cofactor(&(f - df))) * 0.5;
    (cof * cof.component_mul(df).sum() + change * (f.determinant() - 1.0)) * k
}

/// dJ/dF: J F^-T where F has an inverse.
fn cofactor(f: &Matrix3<f64>) -> Matrix3<f64> {
    let row = |i: usize| -> Vector3<f64> { f.row(i).transpose() };
    let (x, y, z) = (row(0), row(1), row(2));
    Matrix3::from_rows(&[y.cross(&z), z.cross(&x), x.cross(&y)].map(|r| r.transpose()))
}

/// Adds stress and energy of four points, both times what k has been multiplied by.
///
/// # Safety
/// As [`Four`].
#[inline(always)]
pub(crate) unsafe fn add<V: Four>(point: &Point<V>, k: V, stress: &mut Square<V>, energy: &mut V) {
    // SAFETY: the caller's.
    unsafe {
        let change = point.volume_ratio.sub(V::splat(1.0));
        let pressure = k.mul(change);
        *energy = V::splat(0.5).mul(pressure).mul_add(change, *energy);
        let cof = cofactors(&point.f);
        for row in 0..3 {
            stress[row][0] = pressure.mul_add(cof[row][0], stress[row][0]);
            stress[row][1] = pressure.mul_add(cof[row][1], stress[row][1]);
            stress[row][2] = pressure.mul_add(cof[row][2], stress[row][2]);
        }
    }
}
