//! Elements: how vertices make a deformation gradient.

pub mod blend;
pub mod constant_strain;
pub mod kernel;
pub mod nodal_averaged;
pub mod tetrahedra;

use crate::law::response::Law;
use crate::model::tensor_mass::Lane;
use kernel::Kernel;
use nodal_averaged::NodalAveraged;
use tetrahedra::{Extent, Tetrahedra};

/// Tissue with a non-linear law.
#[derive(Clone, Debug, PartialEq)]
pub enum Elements {
    ConstantStrain(Tetrahedra),
    /// The tetrahedra tell how far each of them is deformed, which averages hide.
    NodalAveraged(Box<NodalAveraged>, Tetrahedra),
}

impl Elements {
    pub fn law(&self) -> Law {
        self.tetrahedra().law
    }

    /// k of [`crate::law::volume_penalty`] \[Pa\].
    pub fn penalty(&self) -> f64 {
        self.tetrahedra().penalty
    }

    pub fn set_penalty(&mut self, penalty: f64) {
        self.tetrahedra_mut().penalty = penalty;
        if let Elements::NodalAveraged(own, _) = self {
            own.penalty = penalty;
        }
    }

    pub fn tetrahedra(&self) -> &Tetrahedra {
        match self {
            Elements::ConstantStrain(own) | Elements::NodalAveraged(_, own) => own,
        }
    }

    pub(crate) fn tetrahedra_mut(&mut self) -> &mut Tetrahedra {
        match self {
            Elements::ConstantStrain(own) | Elements::NodalAveraged(_, own) => own,
        }
    }

    /// Adds dW/du \[N\] at displacements u to what there is. Returns W \[J\] and how far tissue is deformed.
    pub fn add_forces(&self, u: &[Lane], to: &mut [Lane]) -> (f64, Extent) {
        match self {
            Elements::ConstantStrain(own) => own.add_forces(u, to),
            Elements::NodalAveraged(own, _) => own.add_forces(u, to),
        }
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &Elements) {
        self.tetrahedra_mut().copy_from(other.tetrahedra());
        if let (Elements::NodalAveraged(own, _), Elements::NodalAveraged(other, _)) = (self, other)
        {
            own.copy_from(other);
        }
    }

    pub fn bytes(&self) -> usize {
        match self {
            Elements::ConstantStrain(own) => own.bytes(),
            Elements::NodalAveraged(own, each) => own.bytes() + each.bytes(),
        }
    }
}
