//! Elements: how vertices make a deformation gradient.

pub mod blend;
pub mod constant_strain;
pub mod guard;
pub mod kernel;
pub mod listed;
pub mod nodal_averaged;
pub mod nodal_pressure;
pub mod polynomial;
pub mod tetrahedra;

use nalgebra::Matrix3;

use crate::law::linear::Hooke;
use crate::law::response::Law;
use crate::model::tensor_mass::Lane;
use crate::scene::{Element, Form, ModelSettings};
use constant_strain::Shape;
use guard::{Guard, Rows};
use kernel::Kernel;
use listed::Listed;
use nodal_averaged::NodalAveraged;
use nodal_pressure::NodalPressure;
use polynomial::Polynomial;
use tetrahedra::{Extent, Tetrahedra};

/// Tissue with a non-linear law, or of which vertices have more than their tetrahedra.
#[derive(Clone, Debug, PartialEq)]
pub enum Elements {
    ConstantStrain(Tetrahedra),
    NodalPressure(Box<NodalPressure>),
    /// The tetrahedra tell how far each of them is deformed, which averages hide, and may be guarded.
    NodalAveraged(Box<NodalAveraged>, Tetrahedra),
    /// Constant-strain tetrahedra that tell how far they are deformed, their forces in the papers' form.
    Polynomial(Box<Polynomial>, Tetrahedra),
}

impl Elements {
    /// Of those tetrahedra of a mesh that `of` gives shape, material and its number of.
    pub fn new<'a>(
        law: Law,
        settings: &ModelSettings,
        tetrahedra: &[[u32; 4]],
        of: impl Fn(usize) -> Option<(&'a Shape, &'a Hooke, u32)>,
    ) -> Elements {
        let alone = |t: usize| of(t).map(|(shape, material, _)| (shape, material));
        let each = || Tetrahedra::new(law, tetrahedra, alone);
        match settings.element() {
            Element::ConstantStrain if settings.form == Form::Polynomial => {
                Elements::Polynomial(Box::new(Polynomial::new(tetrahedra, alone)), each())
            }
            Element::ConstantStrain => Elements::ConstantStrain(each()),
            Element::NodalPressure => {
                Elements::NodalPressure(Box::new(NodalPressure::new(law, tetrahedra, of)))
            }
            Element::NodalAveraged => {
                let own = NodalAveraged::new(law, settings.hourglass, tetrahedra, &of);
                Elements::NodalAveraged(Box::new(own), each())
            }
        }
    }

    pub fn law(&self) -> Law {
        self.tetrahedra().law
    }

    /// Keeps tetrahedra that need it from turning inside out, of so many of so many vertices.
    pub(crate) fn guard(&mut self, tetrahedra: usize, nodes: usize) {
        if let Elements::NodalAveraged(own, each) = self
            && own.law == Law::StableNeoHookean
        {
            each.guard = Some(Box::new(Guard::new(each, tetrahedra, nodes)));
        }
    }

    /// Those that are.
    pub fn guarded(&self) -> Option<&Tetrahedra> {
        Some(self.tetrahedra()).filter(|each| each.guard.is_some())
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
            Elements::NodalPressure(own) => &own.each,
        }
    }

    fn tetrahedra_mut(&mut self) -> &mut Tetrahedra {
        match self {
            Elements::ConstantStrain(own)
            | Elements::NodalAveraged(_, own)
            | Elements::Polynomial(_, own) => own,
            Elements::NodalPressure(own) => &mut own.each,
        }
    }

    /// Takes a dead tetrahedron out. Points are to be summed again.
    pub(crate) fn remove(&mut self, t: usize) {
        match self {
            Elements::NodalPressure(own) => own.remove(t),
            _ => self.tetrahedra_mut().remove(t),
        }
    }

    /// Gives a tetrahedron other nodes. Points are to be summed again.
    pub(crate) fn rename(&mut self, t: usize, nodes: &[u32; 4]) {
        match self {
            Elements::NodalPressure(own) => own.rename(t, nodes),
            _ => self.tetrahedra_mut().rename(t, nodes),
        }
    }

    /// Readies a vertex that a cut makes of another.
    pub(crate) fn open(&mut self, new: u32, from: u32) {
        match self {
            Elements::ConstantStrain(_) | Elements::Polynomial(..) => {}
            Elements::NodalPressure(own) => own.open(new, from),
            Elements::NodalAveraged(own, _) => own.open(new, from),
        }
    }

    /// Room for so many vertices that cuts make, which have so many neighbours in all: none allocates.
    pub(crate) fn reserve(&mut self, vertices: usize, neighbours: usize) {
        match self {
            Elements::ConstantStrain(_) | Elements::Polynomial(..) => {}
            Elements::NodalPressure(own) => own.reserve(vertices),
            Elements::NodalAveraged(own, _) => own.reserve(vertices, neighbours),
        }
    }

    /// How many numbers [`Elements::add_forces`] needs room for.
    pub fn points(&self) -> usize {
        match self {
            Elements::NodalPressure(own) => own.points(),
            _ => {
                let guard = self.tetrahedra().guard.as_ref();
                guard.map_or(0, |guard| guard.nodes())
            }
        }
    }

    /// Adds dW/du \[N\] at displacements u to what there is. Returns W \[J\] and how far tissue is deformed. `points` is
    /// scratch, zero before and after. Of what is guarded only the `listed` is looked at; or all. `mass` of vertices \[kg\].
    pub fn add_forces(
        &self,
        listed: Option<&Listed>,
        u: &[Lane],
        to: &mut [Lane],
        points: &mut [f64],
        mass: &[f64],
    ) -> (f64, Extent) {
        match self {
            Elements::ConstantStrain(own) => own.add_forces(u, to),
            Elements::NodalPressure(own) => own.add_forces(u, to, points),
            Elements::NodalAveraged(own, each) => {
                let (energy, mut extent) = own.add_forces(u, to);
                let rows = Rows { sum: points, mass };
                let more = each.resist(listed.and_then(Listed::guard), u, to, rows);
                extent.guard = more.rate;
                (energy + more.energy, extent)
            }
            Elements::Polynomial(own, each) => (own.add_forces(u, to), each.extent(u)),
        }
    }

    /// How far single tetrahedra are deformed. `points` and `mass` as above.
    pub fn extent(&self, u: &[Lane], points: &mut [f64], mass: &[f64]) -> Extent {
        let mut extent = self.tetrahedra().extent(u);
        if extent.least < guard::LEAST {
            let rows = Rows { sum: points, mass };
            extent.guard = self.tetrahedra().resistance(u, rows).rate;
        }
        extent
    }

    /// What the points of a vertex have of W \[J\], and the power of their forces at velocities v \[W\].
    pub(crate) fn share(&self, node: u32, u: &[Lane], v: &[Lane]) -> (f64, f64) {
        match self {
            Elements::ConstantStrain(_) | Elements::Polynomial(..) => (0.0, 0.0),
            Elements::NodalPressure(own) => own.share(node, u, v),
            Elements::NodalAveraged(own, _) => own.share(node, u, v),
        }
    }

    /// Second derivatives of W \[N/m\], parts (i, j, block) of the upper half. None where they are those of single
    /// tetrahedra.
    pub fn tangent(&self, u: &[Lane]) -> Option<Vec<(usize, usize, Matrix3<f64>)>> {
        match self {
            Elements::ConstantStrain(_) | Elements::Polynomial(..) => None,
            Elements::NodalPressure(own) => Some(own.tangent(u)),
            Elements::NodalAveraged(own, each) => {
                let mut entries = own.tangent(u);
                each.add_resistance(u, &mut entries);
                Some(entries)
            }
        }
    }

    /// Keeps the room that there is.
    pub(crate) fn copy_from(&mut self, other: &Elements) {
        match (self, other) {
            (Elements::NodalPressure(own), Elements::NodalPressure(other)) => own.copy_from(other),
            (Elements::NodalAveraged(own, each), Elements::NodalAveraged(other, others)) => {
                own.copy_from(other);
                each.copy_from(others);
            }
            (Elements::Polynomial(own, each), Elements::Polynomial(other, others)) => {
                own.copy_from(other);
                each.copy_from(others);
            }
            (own, other) => own.tetrahedra_mut().copy_from(other.tetrahedra()),
        }
    }

    pub fn bytes(&self) -> usize {
        match self {
            Elements::ConstantStrain(own) => own.bytes(),
            Elements::NodalPressure(own) => own.bytes(),
            Elements::NodalAveraged(own, each) => own.bytes() + each.bytes(),
            Elements::Polynomial(own, each) => own.bytes() + each.bytes(),
        }
    }
}
