//! Constitutive laws: what one point of tissue answers to a strain.

pub mod linear;
pub mod response;
pub mod st_venant_kirchhoff;
pub mod stable_neo_hookean;
pub mod stiffening;
pub mod swelling;
pub mod volume_penalty;
