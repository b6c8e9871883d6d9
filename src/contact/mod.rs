//! Tools against tissue: who touches whom, and who holds whom.

pub mod burn;
pub mod geometry;
pub mod hold;
pub mod nearby;
pub mod press;
pub mod shape;
pub mod slide;
mod solve;
