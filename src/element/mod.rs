//! Elements: how vertices make a deformation gradient.

pub mod blend;
pub mod constant_strain;
pub mod kernel;
pub mod nodal_averaged;
pub mod polynomial;
pub mod tetrahedra;

use crate::law::response::Law;
use crate::model::tensor_mass::Lane;
use kernel::Kernel;
use nodal_averaged::NodalAveraged;
use polynomial::Polynomial;
use tetrahedra::{Extent, Tetrahedra};

/// Tissue with a non-linear law.
#[derive(Clone, Debug, PartialEq)]
pub enum Elements {
    ConstantStrain(Tetrahedra),
    /// The tetrahedra tell how far each of them is deformed, which averages hide.
    NodalAveraged(Box<NodalAveraged>, Tetrahedra),
    /// Constant-strain tetrahedra that tell how far they are deformed, their forces in the papers' form.
    Polynomial(Box<Polynomial>, Tetrahedra),
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
            Elements::ConstantStrain(own)
            | Elements::NodalAveraged(_, own)
            | Elements::Polynomial(_, own) => own,
        }
    }

    pub(crate) fn tetrahedra_mut(&mut self) -> &mut Tetrahedra {
        match self {
            Elements::ConstantStrain(own)
            | Elements::NodalAveraged(_, own)
            | Elements::Polynomial(_, own) => own,
        }
    }

    /// Adds dW/du \[N\] at displacements u to what there is. Returns W \[J\] and how far tissue is deformed.
    pub fn add_forces(&self, u: &[Lane], to: &mut [Lane]) -> (f64, Extent) {
        match self {
            Elements::ConstantStrain(own) => own.add_forces(u, to),
            Elements::NodalAveraged(own, _) => own.add_forces(u, to),
            Elements::Polynomial(own, each) => (own.add_forces(u, to), each.extent(u)),
        }
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &Elements) {
        self.tetrahedra_mut().copy_from(other.tetrahedra());
        match (self, other) {
            (Elements::NodalAveraged(own, _), Elements::NodalAveraged(other, _)) => {
                own.copy_from(other);
            }
            (Elements::Polynomial(own, _), Elements::Polynomial(other, _)) => own.copy_from(other),
            _ => {}
        }
    }

    pub fn bytes(&self) -> usize {
        match self {
            Elements::ConstantStrain(own) => own.bytes(),
            Elements::NodalAveraged(own, each) => own.bytes() + each.bytes(),
            Elements::Polynomial(own, each) => own.bytes() + each.bytes(),
        }
    }
}
