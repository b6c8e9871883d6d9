//! Largest stable substep of each scheme \[s\], with mass-proportional damping c = 2 zeta omega \[1/s\].
//!
//! For a mesh, whose lowest modes lie far below omega, the highest frequency. Infinite where nothing
//! can move (omega = 0).

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

/// Runge-Kutta 4, undamped: omega h < sqrt(8).
pub fn runge_kutta_4(omega: f64) -> f64 {
    8f64.sqrt() / omega
}

#[cfg(test)]
mod tests {
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
