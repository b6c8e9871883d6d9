//! The scene file: what a user writes, and nothing that is computed from it.
//!
//! [`Scene`] is the validated form. [`read`] and [`parse`] make one from JSON, strictly: every error
//! carries the file, the JSON path, what is wrong and what would be right ([`SceneError`]).
//! Everything is SI: m, kg, s, N, Pa, J.

mod error;
mod json;
mod parse;
mod refuse;
mod select;
mod tree;
mod types;

pub use error::SceneError;
pub use parse::{MOST_DAMPING, MOST_GRAVITY, MOST_PRESSURE, parse, read, schema};
pub use refuse::EULER_UNDAMPED;
pub use select::{select_nodes, select_tetrahedra};
pub use types::*;
