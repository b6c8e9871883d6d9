//! Elements: how vertices make a deformation gradient.

pub mod constant_strain;
pub mod nodal_averaged;
pub mod tetrahedra;
