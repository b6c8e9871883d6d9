//! The cheapest setting of a scene that is as right as is asked and as fast.
//!
//! [`gesture`] makes a motion where none is given, [`neighbour`] others like it. [`grid`] is the scene's body on a mesh of
//! one size; [`track`] runs a model along a motion, [`error`](mod@error) compares two runs. [`candidate`] makes a scene of a
//! setting of the chart and a grid, [`search`] runs candidates until nothing cheaper can be found, [`report`] says what
//! came out.

pub mod candidate;
pub mod error;
pub mod gesture;
pub mod grid;
pub mod neighbour;
pub mod report;
pub mod search;
pub mod track;
