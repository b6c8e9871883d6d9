//! What a law is to a kernel: four points at once, each with its own parameters.

use nalgebra::Matrix3;

use super::linear::Hooke;
use super::swelling::Swelling;
use super::{linear, st_venant_kirchhoff, stable_neo_hookean, volume_penalty};
use crate::lanes::{Four, Square, cross, dot, product};

/// What answers a deformation gradient. All but the linear one are right under rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// Hooke's, of the symmetric part of F - I; knows no volume penalty.
    Linear,
    StVenantKirchhoff,
    StableNeoHookean,
}

impl Law {
    /// W \[J/m³\] of a deformation gradient.
    pub fn energy(self, material: &Hooke, f: &Matrix3<f64>) -> f64 {
        let own = match self {
            Law::Linear => return linear::energy(material, f),
            Law::StVenantKirchhoff => st_venant_kirchhoff::energy(material, f),
            Law::StableNeoHookean => stable_neo_hookean::energy(material, f),
        };
        own + volume_penalty::energy(material.penalty, f)
    }

    /// P = dW/dF \[Pa\].
    pub fn stress(self, material: &Hooke, f: &Matrix3<f64>) -> Matrix3<f64> {
        let own = match self {
            Law::Linear => return material.stress(&linear::strain(f)),
            Law::StVenantKirchhoff => st_venant_kirchhoff::stress(material, f),
            Law::StableNeoHookean => stable_neo_hookean::stress(material, f),
        };
        own + volume_penalty::stress(material.penalty, f)
    }

    /// dP = d²W/dF² : dF \[Pa\].
    pub fn tangent(self, material: &Hooke, f: &Matrix3<f64>, df: &Matrix3<f64>) -> Matrix3<f64> {
        let own = match self {
            Law::Linear => return material.stress(&((df + df.transpose()) * 0.5)),
            Law::StVenantKirchhoff => st_venant_kirchhoff::tangent(material, f, df),
            Law::StableNeoHookean => stable_neo_hookean::tangent(material, f, df),
        };
        own + volume_penalty::tangent(material.penalty, f, df)
    }
}

/// Deformation of four points.
pub(crate) struct Point<V> {
    /// F - I.
    pub g: Square<V>,
    pub f: Square<V>,
    /// 2 E: xx, yy, zz, yz, zx, xy.
    pub twice_strain: [V; 6],
    /// 2 tr E = F:F - 3.
    pub trace: V,
    /// det F.
    pub volume_ratio: V,
}

impl<V: Four> Point<V> {
    /// Of displacement gradients G = F - I. 2 E = G + G^T + G^T G, so that nothing cancels at small strain.
    ///
    /// # Safety
    /// As [`Four`].
    #[inline(always)]
    pub unsafe fn new(g: Square<V>) -> Point<V> {
        // SAFETY: the caller's.
        unsafe {
            let one = V::splat(1.0);
            let [x, y, z] = [
                [g[0][0], g[1][0], g[2][0]],
                [g[0][1], g[1][1], g[2][1]],
                [g[0][2], g[1][2], g[2][2]],
            ];
            let twice_strain = [
                x[0].add(x[0]).add(dot(x, x)),
                y[1].add(y[1]).add(dot(y, y)),
                z[2].add(z[2]).add(dot(z, z)),
                y[2].add(z[1]).add(dot(y, z)),
                z[0].add(x[2]).add(dot(z, x)),
                x[1].add(y[0]).add(dot(x, y)),
            ];
            let f = [
                [g[0][0].add(one), g[0][1], g[0][2]],
                [g[1][0], g[1][1].add(one), g[1][2]],
                [g[2][0], g[2][1], g[2][2].add(one)],
            ];
            Point {
                g,
                f,
                twice_strain,
                trace: twice_strain[0].add(twice_strain[1]).add(twice_strain[2]),
                volume_ratio: dot(f[0], cross(f[1], f[2])),
            }
        }
    }

    /// Adds kappa (a0 . E a0)² to stress and energy.
    ///
    /// # Safety
    /// As [`Four`].
    #[inline(always)]
    pub unsafe fn add_fibre(&self, a0: [V; 3], kappa: V, stress: &mut Square<V>, energy: &mut V) {
        // SAFETY: the caller's.
        unsafe {
            let [xx, yy, zz, yz, zx, xy] = self.twice_strain;
            let strained = [
                dot([xx, xy, zx], a0),
                dot([xy, yy, yz], a0),
                dot([zx, yz, zz], a0),
            ];
            // 2 a0 . E a0
            let stretch = dot(strained, a0);
            let pull = kappa.mul(stretch);
            *energy = V::splat(0.25).mul(pull).mul_add(stretch, *energy);
            let along = product(&self.f, a0);
            for k in 0..3 {
                let pull = pull.mul(along[k]);
                stress[k][0] = pull.mul_add(a0[0], stress[k][0]);
                stress[k][1] = pull.mul_add(a0[1], stress[k][1]);
                stress[k][2] = pull.mul_add(a0[2], stress[k][2]);
            }
        }
    }
}

/// A law in four lanes.
pub(crate) trait Response: Swelling {
    /// Whether forces are proportional to displacements, so that how far tissue is deformed changes nothing.
    const IS_LINEAR: bool = false;

    /// Two numbers \[Pa\], of which stress and energy are linear functions.
    fn parameters(material: &Hooke) -> [f64; 2];

    /// P and W, both times what the parameters have been multiplied by.
    ///
    /// # Safety
    /// As [`Four`].
    unsafe fn respond<V: Four>(point: &Point<V>, parameters: [V; 2]) -> (Square<V>, V);

    /// Adds what a fibre a0 of stiffness kappa does to both.
    ///
    /// # Safety
    /// As [`Four`].
    #[inline(always)]
    unsafe fn add_fibre<V: Four>(
        point: &Point<V>,
        a0: [V; 3],
        kappa: V,
        stress: &mut Square<V>,
        energy: &mut V,
    ) {
        // SAFETY: the caller's.
        unsafe { point.add_fibre(a0, kappa, stress, energy) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Vec3;

    fn materials() -> [Hooke; 3] {
        let plain = Hooke::new(6000.0, 0.45);
        let fibre = plain.with_fibre(Vec3::new(1.0, 2.0, -1.0), 8e4, 2e4);
        [plain, fibre, fibre.with_penalty(3e4)]
    }

    fn gradients() -> Vec<Matrix3<f64>> {
        let g = Matrix3::new(0.2, -0.1, 0.3, 0.4, -0.3, 0.1, -0.2, 0.25, 0.15);
        let turn = nalgebra::Rotation3::new(Vec3::new(0.5, -1.0, 0.3)).into_inner();
        let mirrored = Matrix3::from_diagonal(&Vec3::new(1.1, -0.6, 0.9));
        vec![
            Matrix3::identity() + g * 1e-3,
            Matrix3::identity() + g,
            turn * (Matrix3::identity() + g * 2.0),
            mirrored + g * 0.2,
        ]
    }

    const LAWS: [Law; 2] = [Law::StVenantKirchhoff, Law::StableNeoHookean];

    /// (8 (f(h) - f(-h)) - f(2h) + f(-2h)) / 12 h: exact for polynomials of degree four.
    fn derivative(f: impl Fn(f64) -> f64) -> f64 {
        let h = 1e-3;
        (8.0 * (f(h) - f(-h)) - f(2.0 * h) + f(-2.0 * h)) / (12.0 * h)
    }

    #[test]
    fn stress_and_tangent_are_derivatives() {
        for law in LAWS.into_iter().chain([Law::Linear]) {
            for material in materials() {
                for f in gradients() {
                    let stress = law.stress(&material, &f);
                    let d = Matrix3::new(0.3, -0.5, 0.2, 0.7, 0.1, -0.4, 0.6, -0.2, 0.8);
                    let tangent = law.tangent(&material, &f, &d);
                    let scale = tangent.norm();
                    for k in 0..9 {
                        let mut along = Matrix3::zeros();
                        along[k] = 1.0;
                        let slope = derivative(|h| law.energy(&material, &(f + along * h)));
                        assert!(
                            (slope - stress[k]).abs() < 1e-9 * scale,
                            "{law:?} {slope} {}",
                            stress[k]
                        );
                        let slope = derivative(|h| law.stress(&material, &(f + d * h))[k]);
                        assert!(
                            (slope - tangent[k]).abs() < 1e-9 * scale,
                            "{law:?} {slope} {}",
                            tangent[k]
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn both_are_hookes_at_rest() {
        let d = Matrix3::new(0.3, -0.5, 0.2, 0.7, 0.1, -0.4, 0.6, -0.2, 0.8);
        for law in LAWS {
            for material in materials() {
                let rest = Matrix3::identity();
                assert!(law.stress(&material, &rest).norm() < 1e-12 * material.lambda);
                assert_eq!(law.energy(&material, &rest), 0.0);
                let penalty = Matrix3::identity() * (material.penalty * d.trace());
                let linear = material.stress(&((d + d.transpose()) * 0.5)) + penalty;
                let off = law.tangent(&material, &rest, &d) - linear;
                assert!(off.norm() < 1e-12 * linear.norm(), "{law:?} {off}");
            }
        }
    }

    #[test]
    fn rotations_cost_nothing() {
        let turn = nalgebra::Rotation3::new(Vec3::new(0.5, -2.0, 0.3)).into_inner();
        for law in LAWS {
            for material in materials() {
                assert!(law.stress(&material, &turn).norm() < 1e-12 * material.lambda);
                let f = gradients()[1];
                let (here, there) = (
                    law.energy(&material, &f),
                    law.energy(&material, &(turn * f)),
                );
                assert!((here - there).abs() < 1e-12 * here);
            }
        }
    }
}
