//! The stiffness that the moving nodes feel: tensors of the dynamic tetrahedra, and the condensed
//! interface of a pre-computed part.

use nalgebra::Matrix3;

use super::precomputed::Interface;
use super::tensor_mass::{Lane, Pattern, Tensors};
use crate::mesh::Vec3;

/// K on the moving nodes.
#[derive(Clone, Copy)]
pub struct Stiffness<'a> {
    pub pattern: &'a Pattern,
    pub tensors: &'a Tensors,
    /// S and the first connection node.
    pub interface: Option<(&'a Interface, usize)>,
}

impl<'a> Stiffness<'a> {
    /// K u \[N\].
    pub fn product(&self, u: &[Lane], out: &mut [Vec3]) {
        self.tensors.product(self.pattern, u, out);
        let Some((interface, from)) = self.interface else {
            return;
        };
        let mut packed: Vec<f64> = u[from..]
            .iter()
            .flat_map(|u| [u.0[0], u.0[1], u.0[2]])
            .collect();
        packed.resize(packed.len().next_multiple_of(4), 0.0);
        let mut force = vec![0.0; packed.len()];
        interface.product(&packed, &mut force);
        for (out, force) in out[from..].iter_mut().zip(force.chunks(3)) {
            *out += Vec3::new(force[0], force[1], force[2]);
        }
    }

    /// Places (i, j, K_ij), each pair once or in parts that add up, for a sparse factorisation.
    pub fn entries(self) -> impl Iterator<Item = (usize, usize, Matrix3<f64>)> + 'a {
        let condensed = self.interface.into_iter().flat_map(|(interface, from)| {
            let count = self.pattern.nodes() - from;
            (0..count).flat_map(move |i| {
                (i..count).map(move |j| (from + i, from + j, interface.block(i, j)))
            })
        });
        self.tensors.entries(self.pattern).chain(condensed)
    }
}
