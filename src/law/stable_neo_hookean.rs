//! The stable neo-Hookean law: rubber that stands any compression and comes back when it is turned inside out.
//!
//! W = m/2 (I - 3) - m/2 ln((I + 1)/4) - 3 m/4 (J - 1) + l/2 (J - 1)²,  I = F:F, J = det F  \[J/m³\]
//! P = m (1 - 1/(I + 1)) F + (l (J - 1) - 3 m/4) cof F  \[Pa\]
//!
//! m = 4 mu/3 and l = lambda + 5 mu/6 make it Hooke's law at small strain. (Smith, de Goes, Kim 2018, eqs 14 and 16, with W = 0 at
//! rest.) A fibre adds kappa (a0 . E a0)², as in St Venant and Kirchhoff's law.

use nalgebra::Matrix3;

use super::linear::{Fibre, Hooke};
use super::response::{Point, Response};
use super::st_venant_kirchhoff::green;
use crate::lanes::{Four, Square, cofactors};

/// W \[J/m³\].
pub fn energy(law: &Hooke, f: &Matrix3<f64>) -> f64 {
    let [m, l] = StableNeoHookean::parameters(law);
    let (strain, j) = (green(f), f.determinant() - 1.0);
    // I - 3 = 2 tr E.
    let trace = 2.0 * strain.trace();
    let mut energy = 0.5 * m * (trace - (0.25 * trace).ln_1p()) - 0.75 * m * j + 0.5 * l * j * j;
    if let Some(Fibre { direction, kappa }) = &law.fibre {
        energy += kappa * direction.dot(&(strain * direction)).powi(2);
    }
    energy
}

/// P \[Pa\].
pub fn stress(law: &Hooke, f: &Matrix3<f64>) -> Matrix3<f64> {
    let [m, l] = StableNeoHookean::parameters(law);
    let share = 1.0 - 1.0 / (f.norm_squared() + 1.0);
    let pressure = l * (f.determinant() - 1.0) - 0.75 * m;
    let mut stress = f * (m * share) + cofactor(f) * pressure;
    if let Some(Fibre { direction, kappa }) = &law.fibre {
        let stretch = direction.dot(&(green(f) * direction));
        stress += f * direction * direction.transpose() * (2.0 * kappa * stretch);
    }
    stress
}

/// Change of P with F.
pub fn tangent(law: &Hooke, f: &Matrix3<f64>, df: &Matrix3<f64>) -> Matrix3<f64> {
    let [m, l] = StableNeoHookean::parameters(law);
    let reach = f.norm_squared() + 1.0;
    let cof = cofactor(f);
    let pressure = l * (f.determinant() - 1.0) - 0.75 * m;
    let mut change = df * (m * (1.0 - 1.0 / reach))
        + f * (2.0 * m * f.component_mul(df).sum() / (reach * reach))
        + cof * (l * cof.component_mul(df).sum())
        + cofactor_change(f, df) * pressure;
    if let Some(Fibre { direction, kappa }) = &law.fibre {
        let stretch = direction.dot(&(green(f) * direction));
        let rate = (f * direction).dot(&(df * direction));
        let dyad = direction * direction.transpose() * (2.0 * kappa);
        change += df * dyad * stretch + f * dyad * rate;
    }
    change
}

/// dJ/dF: its columns are the cross products of the other two.
pub fn cofactor(f: &Matrix3<f64>) -> Matrix3<f64> {
    let column = |k: usize| f.column((k + 1) % 3).cross(&f.column((k + 2) % 3));
    Matrix3::from_columns(&[column(0), column(1), column(2)])
}

/// Change of the cofactors with F.
pub fn cofactor_change(f: &Matrix3<f64>, df: &Matrix3<f64>) -> Matrix3<f64> {
    let column = |k: usize| {
        let (a, b) = ((k + 1) % 3, (k + 2) % 3);
        f.column(a).cross(&df.column(b)) + df.column(a).cross(&f.column(b))
    };
    Matrix3::from_columns(&[column(0), column(1), column(2)])
}

/// [`stress`] of four points, but for the fibre.
pub(crate) struct StableNeoHookean;

impl Response for StableNeoHookean {
    /// m, l.
    fn parameters(law: &Hooke) -> [f64; 2] {
        [4.0 / 3.0 * law.mu, law.lambda + 5.0 / 6.0 * law.mu]
    }

    #[inline(always)]
    unsafe fn respond<V: Four>(point: &Point<V>, [m, l]: [V; 2]) -> (Square<V>, V) {
        // SAFETY: the caller's.
        unsafe {
            let one = V::splat(1.0);
            let j = point.volume_ratio.sub(one);
            let share = m.sub(m.div(point.trace.add(V::splat(4.0))));
            let m34 = V::splat(0.75).mul(m);
            let pressure = l.mul(j).sub(m34);
            let cof = cofactors(&point.f);
            let mut stress = cof;
            for k in 0..3 {
                stress[k][0] = share.mul_add(point.f[k][0], pressure.mul(cof[k][0]));
                stress[k][1] = share.mul_add(point.f[k][1], pressure.mul(cof[k][1]));
                stress[k][2] = share.mul_add(point.f[k][2], pressure.mul(cof[k][2]));
            }
            let half = V::splat(0.5);
            let log = V::splat(0.25).mul_add(point.trace, one).ln();
            let shape = half.mul(m).mul(point.trace.sub(log));
            let volume = half.mul(l).mul(j).sub(m34).mul(j);
            (stress, shape.add(volume))
        }
    }
}
