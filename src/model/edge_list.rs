//! The papers' own loop, as a yardstick: one visit an edge, scalar, then an integration loop.

use super::sweep::Motion;
use super::tensor_mass::{Lane, Pattern, Tensors};

/// Edge list with its own copy of the tensors.
pub struct EdgeList {
    vertex: Vec<[f64; 9]>,
    edge: Vec<(u32, u32, [f64; 9])>,
}

impl EdgeList {
    pub fn new(pattern: &Pattern, tensors: &Tensors) -> EdgeList {
        let mut list = EdgeList {
            vertex: vec![[0.0; 9]; pattern.nodes()],
            edge: Vec::new(),
        };
        for (i, j, block) in tensors.entries(pattern) {
            let block: [f64; 9] = std::array::from_fn(|k| block[(k / 3, k % 3)]);
            if i == j {
                list.vertex[i] = block;
            } else {
                list.edge.push((i as u32, j as u32, block));
            }
        }
        list
    }

    /// The same substep as [`super::sweep::sweep`], without the energy account.
    pub fn step(&self, m: &mut Motion, h: f64, c: f64) {
        for (i, k) in self.vertex.iter().enumerate() {
            let u = m.displacement[i].0;
            for row in 0..3 {
                m.partial[i].0[row] =
                    k[3 * row] * u[0] + k[3 * row + 1] * u[1] + k[3 * row + 2] * u[2];
            }
        }
        for (i, j, k) in &self.edge {
            let (i, j) = (*i as usize, *j as usize);
            let (u_i, u_j) = (m.displacement[i].0, m.displacement[j].0);
            for row in 0..3 {
                m.partial[i].0[row] +=
                    k[3 * row] * u_j[0] + k[3 * row + 1] * u_j[1] + k[3 * row + 2] * u_j[2];
                m.partial[j].0[row] += k[row] * u_i[0] + k[3 + row] * u_i[1] + k[6 + row] * u_i[2];
            }
        }
        for i in 0..m.displacement.len() {
            for axis in 0..3 {
                let v = m.velocity[i].0[axis];
                let r = m.external[i].0[axis] - m.partial[i].0[axis] - c * m.mass[i] * v;
                let v = v + h * m.inverse_mass[i].0[axis] * r;
                m.velocity[i].0[axis] = v;
                m.displacement[i].0[axis] += h * v;
            }
            m.partial[i] = Lane::default();
        }
    }
}
