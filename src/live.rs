//! The live mesh: what cuts have left of the tissue, its tensors or springs, masses and surface.

use nalgebra::Matrix3;

use crate::mesh::Vec3;
use crate::mesh::topology::NONE;
use crate::model::spring_mass::{self, Springs};
use crate::model::sweep::{Advance, Motion, Sums, sweep};
use crate::model::tensor_mass::{Lane, Tensors};
use crate::model::{Model, spring_sweep};
use crate::pieces::{Pieces, Search};
use crate::scene::{CutMass, Mass, ModelKind};

/// Everything that a cut changes. A pure function of the model and of the list of removals in their
/// order, to the bit: that list is what a saved state holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiveMesh {
    /// A tetrahedron each.
    pub alive: Vec<bool>,
    /// In order of removal.
    pub removed: Vec<u32>,
    /// Rest volume of those \[m³\].
    pub removed_volume: f64,
    /// Those among them that nobody cut: lost because they hung by a vertex or an edge alone. Their volume \[m³\].
    pub cleaned: usize,
    pub cleaned_volume: f64,
    /// Grows with every change.
    pub revision: u64,
    /// Live tetrahedra round each vertex; a vertex at 0 is retired.
    pub star_count: Vec<u32>,
    /// Empty where there are springs.
    pub tensors: Tensors,
    /// Of model kind `springMass`.
    pub springs: Option<Springs>,
    /// Inertial mass a node \[kg\].
    pub mass: Vec<f64>,
    /// Gravitational mass a node \[kg\]: a quarter of each of its tetrahedra, whatever `integration.mass`.
    pub weight: Vec<f64>,
    /// Exposed faces, in no order that means anything.
    pub surface: Vec<u32>,
    pub pieces: Pieces,
    /// Place of each face in `surface`, or [`NONE`].
    surface_slot: Vec<u32>,
}

impl LiveMesh {
    /// The whole mesh of a model under construction.
    pub(crate) fn whole(model: &Model) -> LiveMesh {
        let nodes = model.mesh.nodes.len();
        let (tensors, springs) = match model.scene.model.kind {
            ModelKind::SpringMass => {
                let springs = Springs::new(&model.pattern, &model.mesh.nodes);
                (Tensors::default(), Some(springs))
            }
            _ => (Tensors::zeros(&model.pattern), None),
        };
        let mut live = LiveMesh {
            alive: vec![true; model.mesh.tetrahedra.len()],
            star_count: vec![0; nodes],
            tensors,
            springs,
            mass: vec![0.0; nodes],
            weight: vec![0.0; nodes],
            surface_slot: vec![NONE; model.topology.faces.len()],
            pieces: Pieces::whole(model, &vec![true; model.mesh.tetrahedra.len()]),
            ..LiveMesh::default()
        };
        for (t, tetrahedron) in model.mesh.tetrahedra.iter().enumerate() {
            let material = model.material(t);
            let shape = &model.shape[t];
            if model.parts.dynamic[t] {
                live.accumulate(model, t);
            }
            for node in tetrahedron {
                live.star_count[*node as usize] += 1;
                live.weight[*node as usize] += material.density * shape.volume / 4.0;
            }
        }
        match model.scene.integration.mass {
            Mass::Lumped => live.mass.clone_from(&live.weight),
            Mass::Uniform => {
                let used = live.star_count.iter().filter(|c| **c > 0).count();
                let share = live.weight.iter().sum::<f64>() / used as f64;
                for (mass, count) in live.mass.iter_mut().zip(&live.star_count) {
                    *mass = if *count > 0 { share } else { 0.0 };
                }
            }
        }
        for (f, face) in model.topology.faces.iter().enumerate() {
            if face.tetrahedra[1] == NONE {
                live.expose(f as u32);
            }
        }
        live
    }

    /// Tensors or springs of dynamic tetrahedron `t`.
    fn accumulate(&mut self, model: &Model, t: usize) {
        let (pattern, nodes) = (&model.pattern, &model.mesh.tetrahedra[t]);
        let (shape, law) = (&model.shape[t], &model.material(t).law);
        match &mut self.springs {
            Some(springs) => {
                let rest = model.rest_positions(t);
                springs.accumulate(pattern, nodes, &rest, shape.volume, law);
            }
            None => self.tensors.accumulate(pattern, nodes, shape, law),
        }
    }

    /// One substep of the moving nodes.
    pub fn sweep(&self, model: &Model, motion: &mut Motion, by: &Advance) -> Sums {
        match &self.springs {
            Some(springs) => spring_sweep::sweep(springs, motion, by),
            None => sweep(&model.pattern, &self.tensors, motion, by),
        }
    }

    /// Internal force on node i \[N\], without that of a pre-computed part.
    pub fn internal_force(&self, model: &Model, i: usize, u: &[Lane]) -> Vec3 {
        match &self.springs {
            Some(springs) => springs.force(&model.pattern, i, u),
            None => self.tensors.row_product(&model.pattern, i, u),
        }
    }

    /// Of tensors or springs.
    pub fn bytes(&self) -> usize {
        self.tensors.bytes() + self.springs.as_ref().map_or(0, Springs::bytes)
    }

    /// Removes one live tetrahedron: its four masses and four faces. Its tensors or springs stay until
    /// [`LiveMesh::sum_again`]. Does nothing to a dead one. Dynamic ones only. Returns whether it was alive.
    pub(crate) fn remove(&mut self, model: &Model, t: u32) -> bool {
        let index = t as usize;
        if !std::mem::replace(&mut self.alive[index], false) {
            return false;
        }
        self.removed.push(t);
        self.revision += 1;
        let shape = &model.shape[index];
        self.removed_volume += shape.volume;
        let share = model.material(index).density * shape.volume / 4.0;
        for node in &model.mesh.tetrahedra[index] {
            let n = *node as usize;
            let [weight_goes, mass_goes] = goes(model, n);
            self.star_count[n] -= 1;
            if self.star_count[n] == 0 {
                self.weight[n] = 0.0;
                self.mass[n] = 0.0;
            } else {
                self.weight[n] -= if weight_goes { share } else { 0.0 };
                self.mass[n] -= if mass_goes { share } else { 0.0 };
            }
        }
        for f in model.topology.tetrahedron_faces[index] {
            if self.surface_slot[f as usize] == NONE {
                self.expose(f)
            } else {
                self.cover(f)
            }
        }
        true
    }

    /// What removed tetrahedron `t` had a share in, summed again over what is left: ten tensors or six springs, four
    /// masses. In the order of a fresh assembly, so that it equals one to the bit, and exactly zero where
    /// nothing is left.
    pub(crate) fn sum_again(&mut self, model: &Model, t: u32) {
        let nodes = &model.mesh.tetrahedra[t as usize];
        for j in 0..4 {
            let mut weight = 0.0;
            let mut blocks = [Matrix3::zeros(); 4];
            let mut springs = [0.0; 4];
            for other in model.topology.star(nodes[j] as usize) {
                let other = *other as usize;
                if !self.alive[other] {
                    continue;
                }
                let (shape, material) = (&model.shape[other], model.material(other));
                weight += material.density * shape.volume / 4.0;
                if !model.parts.dynamic[other] {
                    continue;
                }
                let corners = &model.mesh.tetrahedra[other];
                let place = |node: u32| corners.iter().position(|c| *c == node);
                let Some(own) = place(nodes[j]) else { continue };
                for k in j..4 {
                    let Some(to) = place(nodes[k]) else { continue };
                    if self.springs.is_some() {
                        if k > j {
                            let edge = model.mesh.nodes[nodes[k] as usize]
                                - model.mesh.nodes[nodes[j] as usize];
                            springs[k] += spring_mass::share(&material.law, shape.volume, &edge);
                        }
                        continue;
                    }
                    let (low, high) = if nodes[j] <= nodes[k] {
                        (own, to)
                    } else {
                        (to, own)
                    };
                    let gradient = &shape.gradient;
                    blocks[k] +=
                        material
                            .law
                            .stiffness_block(shape.volume, &gradient[low], &gradient[high]);
                }
            }
            for k in j..4 {
                match &mut self.springs {
                    Some(all) => all.set(&model.pattern, nodes[j], nodes[k], springs[k]),
                    None => self
                        .tensors
                        .set(&model.pattern, nodes[j], nodes[k], &blocks[k]),
                }
            }
            let n = nodes[j] as usize;
            let [weight_goes, mass_goes] = goes(model, n);
            if weight_goes {
                self.weight[n] = weight;
            }
            if mass_goes {
                self.mass[n] = weight;
            }
        }
    }

    /// After removals, those from the `first` on: which pieces are left.
    pub(crate) fn find_pieces(
        &mut self,
        model: &Model,
        first: usize,
        severs: bool,
        search: &mut Search,
    ) {
        let removed = &self.removed[first..];
        let (alive, count) = (&self.alive, &self.star_count);
        (self.pieces).update(model, alive, count, removed, severs, search);
    }

    /// Removes tetrahedra that are known to leave a good mesh, but for what they do to the pieces.
    fn remove_all(&mut self, model: &Model, chosen: &[u32]) {
        let first = self.removed.len();
        for t in chosen {
            self.remove(model, *t);
        }
        for at in first..self.removed.len() {
            self.sum_again(model, self.removed[at]);
        }
    }

    /// The whole mesh after removals that are known to leave a good one.
    pub(crate) fn after(model: &Model, removed: &[u32]) -> LiveMesh {
        let mut live = model.whole.clone();
        live.reserve(model);
        live.remove_all(model, removed);
        live.pieces = Pieces::whole(model, &live.alive);
        live
    }

    fn expose(&mut self, face: u32) {
        self.surface_slot[face as usize] = self.surface.len() as u32;
        self.surface.push(face);
    }

    fn cover(&mut self, face: u32) {
        let slot = std::mem::replace(&mut self.surface_slot[face as usize], NONE);
        self.surface.swap_remove(slot as usize);
        if let Some(moved) = self.surface.get(slot as usize) {
            self.surface_slot[*moved as usize] = slot;
        }
    }

    /// Vertices of an exposed face, counter-clockwise from outside.
    pub fn triangle(&self, model: &Model, face: u32) -> [u32; 3] {
        let face = &model.topology.faces[face as usize];
        let [a, b, c] = face.vertices;
        if self.alive[face.tetrahedra[0] as usize] {
            [a, b, c]
        } else {
            [a, c, b]
        }
    }

    /// Brings an older copy of the same history up to date by the removals it lacks; otherwise copies.
    /// Either way the result equals `newer` to the bit.
    pub(crate) fn catch_up(&mut self, model: &Model, newer: &LiveMesh) {
        if newer.removed.starts_with(&self.removed) {
            self.remove_all(model, &newer.removed[self.removed.len()..]);
            self.cleaned = newer.cleaned;
            self.cleaned_volume = newer.cleaned_volume;
            self.pieces.copy_from(&newer.pieces);
        } else {
            self.copy_from(newer);
        }
    }

    /// Room for every removal, so that none allocates.
    pub(crate) fn reserve(&mut self, model: &Model) {
        self.removed.reserve(model.mesh.tetrahedra.len());
        self.pieces.reserve();
        self.surface.reserve(model.topology.faces.len());
    }

    /// Keeps the room that there is.
    fn copy_from(&mut self, other: &LiveMesh) {
        self.alive.clone_from(&other.alive);
        self.removed.clone_from(&other.removed);
        self.removed_volume = other.removed_volume;
        self.cleaned = other.cleaned;
        self.cleaned_volume = other.cleaned_volume;
        self.pieces.copy_from(&other.pieces);
        self.revision = other.revision;
        self.star_count.clone_from(&other.star_count);
        self.tensors.0.clone_from(&other.tensors.0);
        self.springs.clone_from(&other.springs);
        self.mass.clone_from(&other.mass);
        self.weight.clone_from(&other.weight);
        self.surface.clone_from(&other.surface);
        self.surface_slot.clone_from(&other.surface_slot);
    }
}

/// Whether weight and mass of a node go with its tetrahedra.
fn goes(model: &Model, node: usize) -> [bool; 2] {
    let weight = model.scene.cutting.mass == CutMass::Removed;
    let keeps = model.has_guyan_mass() && node >= model.parts.connected_from();
    let mass = weight && model.scene.integration.mass == Mass::Lumped && !keeps;
    [weight, mass]
}
