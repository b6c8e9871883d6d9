//! Which scheme a model is integrated by, and with what substep.

use super::sweep::Advance;
use super::{Model, critical_step};
use crate::contact::slide;
use crate::scene::{CutMass, EULER_UNDAMPED, Mass, SceneError, Scheme};

/// Share of the guaranteed critical step that a chosen substep may use.
pub const STEP_MARGIN: f64 = 0.9;

/// Share of the mesh's own critical step that it may use where velocities are half a step behind. Hosts
/// change their communication step, and with it the substep: two lengths a, b in turn feed a mode where
/// (omega a + omega b)² - (omega a omega b)² > 4, far below the critical step; at half of it no pattern
/// of two does.
pub const UNEVEN_STEP_MARGIN: f64 = 0.5;

/// Sweeps over the tensors that one substep of implicit Euler costs (23 on a plate of 759 nodes, 33 on a
/// liver of 1 558). Where symplectic Euler needs more of them in a haptic period, implicit Euler is the
/// default.
const IMPLICIT_SWEEPS: f64 = 30.0;

/// The same where tissue can be cut: a new factor costs as much as 300 to 900 sweeps, at a bad moment.
const IMPLICIT_SWEEPS_CUT: f64 = 100.0;

/// Default damping in units of the lowest angular frequency: fastest to equilibrium
/// (0.75 of critical; see the equations of the manual).
pub const DAMPING_IN_LOWEST_FREQUENCIES: f64 = 1.5;

impl Model {
    /// The angular frequency that limits the substep \[1/s\]: where lumped mass goes with what is cut the
    /// bound by elements, else the highest of the whole mesh (which cuts can only lower).
    pub fn limiting_frequency(&self) -> f64 {
        let mass_goes = self.scene.cutting.mass == CutMass::Removed
            && self.scene.integration.mass == Mass::Lumped;
        // Where a vertex splits, a constraint goes.
        if self.can_be_cut() && (mass_goes || self.parts.spares > 0) {
            // Reduced interface modes are not bounded by elements.
            self.spectrum.element_bound.max(self.spectrum.highest)
        } else {
            self.spectrum.highest
        }
    }

    /// Mass-proportional damping at the start \[1/s\].
    pub fn damping(&self) -> f64 {
        self.scene
            .integration
            .damping
            .unwrap_or(DAMPING_IN_LOWEST_FREQUENCIES * self.spectrum.lowest)
    }

    /// The scheme in use.
    pub fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// The scene's, or the cheapest that is stable.
    pub(super) fn choose_scheme(&self) -> Result<Scheme, SceneError> {
        if self.parts.moving == 0 {
            // Nothing is integrated.
            return Ok(Scheme::SymplecticEuler);
        }
        let integration = &self.scene.integration;
        match integration.scheme {
            Some(Scheme::Euler) if self.damping() == 0.0 && self.spectrum.highest > 0.0 => {
                let path = "integration.damping";
                Err(SceneError::at(&self.file, path, EULER_UNDAMPED))
            }
            Some(scheme) => Ok(scheme),
            // Who gives a substep asks for what takes it.
            None if integration.substep.is_some()
                || self.has_guyan_mass()
                || self.law().is_some()
                || self.tools_slide()
                || !self.is_quadratic() =>
            {
                Ok(Scheme::SymplecticEuler)
            }
            None => {
                let sweeps = self.substeps_in_period(Scheme::SymplecticEuler, self.damping(), 1.0);
                let most = if self.can_be_cut() {
                    IMPLICIT_SWEEPS_CUT
                } else {
                    IMPLICIT_SWEEPS
                };
                Ok(if sweeps > most {
                    Scheme::ImplicitEuler
                } else {
                    Scheme::SymplecticEuler
                })
            }
        }
    }

    /// Whether any tool has a friction coefficient.
    fn tools_slide(&self) -> bool {
        (0..self.tools.len()).any(|k| slide::coefficient(self, k).is_some())
    }

    /// Whether velocities live half a substep behind.
    pub fn is_staggered(&self) -> bool {
        matches!(
            self.scheme,
            Scheme::SymplecticEuler | Scheme::CentralDifference
        )
    }

    /// What `Clock::lag` is after a substep of length `h` \[s\].
    pub(crate) fn lag(&self, h: f64) -> f64 {
        if self.is_staggered() { h } else { 0.0 }
    }

    /// Largest stable substep \[s\] at a damping \[1/s\].
    pub fn critical_step(&self, damping: f64) -> f64 {
        self.critical_step_at(self.limiting_frequency(), damping)
    }

    /// The same for a mesh of another highest angular frequency \[1/s\].
    pub(crate) fn critical_step_at(&self, omega: f64, damping: f64) -> f64 {
        critical_step::of(self.scheme, omega, damping)
    }

    /// The part of damping \[1/s\] that acts on the lagging velocity alone: all of symplectic Euler's.
    pub(crate) fn lagging_damping(&self, damping: f64) -> f64 {
        match self.scheme {
            Scheme::SymplecticEuler => damping,
            _ => 0.0,
        }
    }

    /// One substep by a staggered scheme after one of length `before` \[s\].
    pub(crate) fn advance(&self, before: f64, substep: f64, damping: f64) -> Advance {
        match self.scheme {
            Scheme::CentralDifference => Advance::central_difference(before, substep, damping),
            _ => Advance::symplectic_euler(before, substep, damping),
        }
    }

    /// The scene's substep, or the longest whole divisor of the haptic period that is stable with both
    /// margins \[s\].
    pub fn substep(&self, damping: f64) -> f64 {
        self.substep_at(damping, 1.0)
    }

    /// The same where the largest eigenvalue is that of the model times a `ratio`.
    pub(crate) fn substep_at(&self, damping: f64, ratio: f64) -> f64 {
        let period = 1.0 / self.scene.integration.haptic_rate;
        let parts = match self.scene.integration.substep {
            Some(substep) => (period / substep).round().max(1.0),
            None => self.substeps_in_period(self.scheme, damping, ratio.sqrt()),
        };
        period / parts
    }

    /// In a haptic period, chosen by a scheme's margins, of frequencies so many times faster.
    fn substeps_in_period(&self, scheme: Scheme, damping: f64, faster: f64) -> f64 {
        let period = 1.0 / self.scene.integration.haptic_rate;
        let critical = |omega: f64| critical_step::of(scheme, faster * omega, damping);
        let mut limit = STEP_MARGIN * critical(self.limiting_frequency());
        if matches!(scheme, Scheme::SymplecticEuler | Scheme::CentralDifference) {
            limit = limit.min(UNEVEN_STEP_MARGIN * critical(self.spectrum.highest));
        }
        // Some number even where no substep is stable.
        (period / limit - 1e-9).ceil().clamp(1.0, 1e9)
    }
}
