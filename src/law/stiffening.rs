//! By how much a deformation stiffens tissue at most: what the critical substep follows.
//!
//! With s the largest singular value of F and S the second Piola stress, the second derivative of a tetrahedron's
//! energy along du is at most K_max |F^T du|² + V S_max |grad du|²: that of Hooke's law times s², and the stress.
//! K_max >= V g (lambda + 2 mu), g the largest eigenvalue of the a_j . a_k, so that relative to K_max the stress counts
//! S_max / (lambda + 2 mu).

use super::linear::{Fibre, Hooke};
use super::response::{Law, Response};
use super::stable_neo_hookean::StableNeoHookean;
use crate::element::tetrahedra::Extent;

impl Law {
    /// Bound of the largest eigenvalue of any tetrahedron deformed so far, relative to that `at_rest`, a material
    /// that may have another volume penalty; 1 or more. The penalty k adds at most k (x² + |J - 1| s), x the largest
    /// product of two singular values.
    ///
    /// Stable neo-Hookean tissue: relative to the same bound at rest, which is above the truth there (by 12 % at
    /// nu = .45).
    pub fn stiffening(self, at_rest: &Hooke, material: &Hooke, extent: &Extent) -> f64 {
        let square = extent.trace + 3.0;
        let (stretch, area) = (largest_stretch(extent), largest_area(extent));
        let (lambda, mu) = (material.lambda, material.mu);
        let kappa = material
            .fibre
            .map_or(0.0, |Fibre { kappa, .. }| kappa.max(0.0));
        // 2 E at most.
        let strain = (stretch * stretch - 1.0).max(0.0);
        let change = (extent.most - 1.0).max(1.0 - extent.least);
        let penalty = material.penalty * (area * area + change * stretch);
        let ratio = match self {
            Law::Linear => 1.0,
            Law::StVenantKirchhoff => {
                let stress = 0.5 * lambda * extent.trace.max(0.0) + (mu + kappa) * strain;
                let own = lambda + 2.0 * mu;
                (own * stretch * stretch + stress + penalty) / (own + at_rest.penalty)
            }
            Law::StableNeoHookean => {
                let [m, l] = StableNeoHookean::parameters(material);
                let bound = |square: f64, area: f64, stretch: f64, pressure: f64| {
                    m * (1.0 - 1.0 / (square + 1.0))
                        + 2.0 * m * square / ((square + 1.0) * (square + 1.0))
                        + l * area * area
                        + pressure * stretch
                };
                let pressure = |j: f64| (l * (j - 1.0) - 0.75 * m).abs();
                let largest = pressure(extent.least).max(pressure(extent.most));
                let rest = bound(3.0, 1.0, 1.0, 0.75 * m) + at_rest.penalty;
                (bound(square, area, stretch, largest) + penalty) / rest
                    + 3.0 * kappa * strain / (lambda + 2.0 * mu)
            }
        };
        ratio.max(1.0)
    }
}

/// Largest singular value s of F: with J = det F the others give s² + 2 J/s <= F:F at least.
fn largest_stretch(extent: &Extent) -> f64 {
    let (square, ratio) = (extent.trace + 3.0, extent.least.max(0.0));
    // Newton from above, where s³ - (F:F) s + 2 J is convex, stays above the largest root.
    let mut s = square.max(0.0).sqrt();
    for _ in 0..64 {
        let slope = 3.0 * s * s - square;
        if slope <= 0.0 {
            break;
        }
        s -= (s * s * s - square * s + 2.0 * ratio) / slope;
    }
    s
}

/// Largest product x of two singular values: 2 x + J²/x² <= F:F.
fn largest_area(extent: &Extent) -> f64 {
    let (square, ratio) = (extent.trace + 3.0, extent.least.max(0.0));
    let mut x = 0.5 * square;
    for _ in 0..64 {
        let slope = 6.0 * x * x - 2.0 * square * x;
        if slope <= 0.0 {
            break;
        }
        x -= (2.0 * x * x * x - square * x * x + ratio * ratio) / slope;
    }
    x
}
