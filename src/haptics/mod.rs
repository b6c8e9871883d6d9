//! What a haptic device needs beside the force: a local model of it.
//!
//! - [`tangent`]: how the force at the end of the next step answers to that step's pose;
//! - [`response`]: the same of linear tissue, once for as long as what is held stays the same;
//! - [`settled`]: how the force answers to a pose that is kept;
//! - [`slope`]: how fast the force changes.

pub mod response;
pub mod settled;
pub mod slope;
pub mod tangent;

pub use tangent::Haptics;

use crate::statics::StaticsError;
use crate::step::StepError;

/// Why there is no stiffness now.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum HapticsError {
    #[error("the tangent is that of the next step, which fails: {0}")]
    Trial(StepError),
    #[error("the tangent of the next step is not finite")]
    NonFinite,
    #[error(
        "the tissue is in no stable state: its stiffness is not positive definite, so no force would settle"
    )]
    Unstable,
    #[error("no static stiffness: {0}")]
    Statics(StaticsError),
}
