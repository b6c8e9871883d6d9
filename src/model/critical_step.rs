//! Largest stable substep of each scheme \[s\], with mass-proportional damping c = 2 zeta omega \[1/s\].
//!
//! For a mesh, whose lowest modes lie far below omega, the highest frequency. Infinite where nothing
//! can move (omega = 0).

use crate::scene::Scheme;

/// Symplectic Euler with explicit damping: omega h < 2 (sqrt(1 + zeta²) - zeta).
pub fn symplectic_euler(omega: f64, damping: f64) -> f64 {
    if omega == 0.0 {
        return f64::INFINITY;
    }
    let zeta = damping / (2.0 * omega);
    // sqrt(1 + zeta²) - zeta without cancellation or overflow.
    2.0 / (zeta.hypot(1.0) + zeta) / omega
}

/// Explicit Euler: omega h < min(2 zeta, 1/zeta); zero without damping.
pub fn euler(omega: f64, damping: f64) -> f64 {
    if omega == 0.0 {
        return f64::INFINITY;
    }
    let zeta = damping / (2.0 * omega);
    (2.0 * zeta).min(1.0 / zeta) / omega
}

/// Central difference: omega h < 2, whatever the damping.
pub fn central_difference(omega: f64) -> f64 {
    2.0 / omega
}

/// Runge-Kutta 4: the largest h with |R(h lambda)| <= 1 for every mode of frequency 0 to omega,
/// R(z) = 1 + z + z²/2 + z³/6 + z⁴/24, lambda = -c/2 +- sqrt(c²/4 - w²). omega h = 2.83 undamped, 2.96 at
/// zeta = .14, 2.62 at .5. Slow modes are the fastest to decay, lambda = -c, so that from zeta = .53 on
/// c h < 2.785 is what counts (a single oscillator goes on to 2.79 at .8).
pub fn runge_kutta_4(omega: f64, damping: f64) -> f64 {
    if omega == 0.0 {
        return f64::INFINITY;
    }
    let half = 0.5 * damping / omega;
    let real = RUNGE_KUTTA_4_REAL / (2.0 * half);
    if half >= 1.0 {
        return real / omega;
    }
    // Oscillating modes lie on a line upward from -zeta; the limit of each lies between these.
    let top = (1.0 - half * half).sqrt();
    let is_stable = |h: f64| {
        (0..=SAMPLES).all(|k| {
            let y = h * top * f64::from(k) / f64::from(SAMPLES);
            runge_kutta_4_gain(-h * half, y) <= 1.0 + 1e-12
        })
    };
    let (mut low, mut high) = (2.5f64.min(real), 3.0f64.min(real));
    if is_stable(high) {
        return high / omega;
    }
    for _ in 0..16 {
        let middle = 0.5 * (low + high);
        if is_stable(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low / omega
}

/// End of Runge-Kutta 4's stability region on the real axis.
const RUNGE_KUTTA_4_REAL: f64 = 2.785_293_563;

/// Modes looked at; the limit between them is missed by less than 1e-4 of itself.
const SAMPLES: u32 = 128;

/// |R(x + iy)|²
fn runge_kutta_4_gain(x: f64, y: f64) -> f64 {
    // Horner's rule: R = 1 + z (1 + z/2 (1 + z/3 (1 + z/4))).
    let (mut real, mut imaginary) = (1.0, 0.0);
    for k in [4.0, 3.0, 2.0, 1.0] {
        (real, imaginary) = (
            1.0 + (real * x - imaginary * y) / k,
            (real * y + imaginary * x) / k,
        );
    }
    real * real + imaginary * imaginary
}

/// Of a scheme at a highest angular frequency \[1/s\] and a damping \[1/s\].
pub fn of(scheme: Scheme, omega: f64, damping: f64) -> f64 {
    match scheme {
        Scheme::SymplecticEuler => symplectic_euler(omega, damping),
        Scheme::CentralDifference => central_difference(omega),
        Scheme::Euler => euler(omega, damping),
        Scheme::RungeKutta4 => runge_kutta_4(omega, damping),
        Scheme::ImplicitEuler => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    /// Every mode is stable up to the limit, and one grows just past it: by taking steps, mode by mode.
    #[test]
    fn runge_kutta_4_limit_is_sharp() {
        let omega = 3.0;
        let grows = |w: f64, c: f64, h: f64| {
            let rate = |u: f64, v: f64| (v, -w * w * u - c * v);
            let (mut u, mut v) = (1.0f64, 0.3f64);
            for _ in 0..4000 {
                let (a, b) = rate(u, v);
                let (p, q) = rate(u + 0.5 * h * a, v + 0.5 * h * b);
                let (r, s) = rate(u + 0.5 * h * p, v + 0.5 * h * q);
                let (x, y) = rate(u + h * r, v + h * s);
                u += h / 6.0 * (a + 2.0 * p + 2.0 * r + x);
                v += h / 6.0 * (b + 2.0 * q + 2.0 * s + y);
            }
            // At the limit a mode neither grows nor decays.
            let size = u.abs() + v.abs();
            size.is_nan() || size > 20.0
        };
        let table = [
            (0.0, 2.83),
            (0.14, 2.96),
            (0.35, 2.77),
            (0.5, 2.62),
            (0.8, 1.74),
            (1.0, 1.39),
            (3.0, 0.464),
        ];
        for (zeta, printed) in table {
            let c = 2.0 * zeta * omega;
            let limit = super::runge_kutta_4(omega, c);
            assert!(
                (limit * omega - printed).abs() < 0.006,
                "{zeta}: {}",
                limit * omega
            );
            let modes = |h: f64| (1..=400).any(|k| grows(omega * f64::from(k) / 400.0, c, h));
            assert!(!modes(0.9995 * limit), "zeta {zeta}");
            assert!(modes(1.002 * limit), "zeta {zeta}");
        }
    }

    /// The limit is where the larger root of the one-mode recursion reaches -1.
    #[test]
    fn symplectic_euler_limit_is_sharp() {
        for damping in [0.0, 1.0, 30.0] {
            let omega = 20.0;
            let limit = super::symplectic_euler(omega, damping);
            for (h, stays) in [(0.999 * limit, true), (1.001 * limit, false)] {
                let (mut u, mut v) = (1.0f64, 0.0f64);
                for _ in 0..20_000 {
                    v += h * (-omega * omega * u - damping * v);
                    u += h * v;
                }
                // Just below the limit an undamped mode swings to 1/sqrt(1 - (omega h/2)^2) = 22.
                assert_eq!(u.abs() < 30.0, stays, "damping {damping}, h {h}");
            }
        }
    }
}
