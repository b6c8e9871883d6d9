//! Constitutive laws: what one point of tissue answers to a strain.

pub mod linear;
