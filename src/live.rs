//! The live mesh: what cuts have left of the tissue, its tensors or springs, masses and surface.

use nalgebra::Matrix3;

use crate::element::Elements;
use crate::element::blend::Blend;
use crate::element::guard;
use crate::element::listed::Listed;
use crate::element::polynomial;
use crate::element::tetrahedra::{self, Extent};
use crate::law::linear::Hooke;
use crate::law::response::Law;
use crate::mesh::Vec3;
use crate::mesh::topology::{EDGES, NONE};
use crate::model::spring_mass::{self, Springs};
use crate::model::stiffness::Stiffness;
use crate::model::sweep::{Advance, Motion, Sums, sweep};
use crate::model::tensor_mass::{Lane, Pattern, Tensors};
use crate::model::{Model, element_sweep, spring_sweep};
use crate::pieces::{Pieces, Search, Tissue};
use crate::scene::{CutMass, Mass, ModelKind};

/// Everything that a cut changes. A pure function of the model and of the list of removals in their
/// order, to the bit: that list is what a saved state holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiveMesh {
    /// A tetrahedron each: its nodes, which change where vertices split, and whether it is alive.
    pub tetrahedra: Vec<[u32; 4]>,
    pub alive: Vec<bool>,
    /// Rest position \[m\] a node; of a spare that is not in use, of some other.
    pub rest: Vec<Vec3>,
    /// A spare each: the node that it was split from in the first place, or [`NONE`].
    pub origin: Vec<u32>,
    /// Splits in their order, one after the other: removals before it, the node, how many tetrahedra go
    /// to the new one, which.
    pub splits: Vec<u32>,
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
    /// Where there are spares; otherwise the model's.
    pattern: Option<Box<Pattern>>,
    /// Empty where there are springs or elements.
    pub tensors: Tensors,
    /// Of model kind `springMass`.
    pub springs: Option<Springs>,
    /// Where tensors do not serve.
    pub elements: Option<Elements>,
    /// On top of the tensors, where tissue is adaptive.
    pub blend: Option<Blend>,
    /// Inertial mass a node \[kg\].
    pub mass: Vec<f64>,
    /// Gravitational mass a node \[kg\]: a quarter of each of its tetrahedra, whatever `integration.mass`.
    pub weight: Vec<f64>,
    /// Exposed faces, in no order that means anything.
    pub surface: Vec<u32>,
    pub pieces: Pieces,
    /// Corners of tetrahedra that have changed: what is summed of them is old. Empty but during a cut.
    dirty: Vec<(u32, [u32; 4])>,
    /// Scratch, left empty, as what is the same shall compare so: nodes to look at; edges to sum again, by their ends
    /// and what they are in the topology.
    around: Vec<u32>,
    edges: Vec<([u32; 2], u32)>,
    /// Place of each face in `surface`, or [`NONE`].
    surface_slot: Vec<u32>,
}

impl LiveMesh {
    /// The whole mesh of a model under construction.
    pub(crate) fn whole(model: &Model) -> LiveMesh {
        let nodes = model.mesh.nodes.len();
        let springs = (model.scene.model.kind == ModelKind::SpringMass)
            .then(|| Springs::new(&model.pattern, &model.mesh.nodes));
        let adaptive = model.law().filter(|_| model.is_adaptive());
        let blend = adaptive.map(|law| {
            let settings = &model.scene.model;
            let (rule, threshold) = (settings.adaptive, settings.nonlinear_threshold);
            Blend::new(law, rule, threshold, &model.mesh.tetrahedra, |t| {
                let t = Some(t).filter(|t| model.parts.dynamic[*t])?;
                Some((&model.shape[t], &model.material(t).law))
            })
        });
        let uniform = model.law().filter(|_| !model.is_adaptive());
        let mut elements = uniform.map(|law| model.elements(law, true));
        if let Some(elements) = &mut elements {
            elements.set_penalty(model.scene_penalty());
            elements.reserve(model.parts.spares, model.pattern.spare_places());
        }
        let is_linear = springs.is_none() && elements.is_none();
        let tensors = match is_linear {
            true => Tensors::zeros(&model.pattern),
            false => Tensors::default(),
        };
        let spares = model.parts.spares;
        let mut live = LiveMesh {
            tetrahedra: model.mesh.tetrahedra.clone(),
            rest: model.mesh.nodes.clone(),
            origin: vec![NONE; spares],
            pattern: (spares > 0).then(|| Box::new(model.pattern.clone())),
            alive: vec![true; model.mesh.tetrahedra.len()],
            star_count: vec![0; nodes],
            tensors,
            springs,
            elements,
            blend,
            mass: vec![0.0; nodes],
            weight: vec![0.0; nodes],
            surface_slot: vec![NONE; model.topology.faces.len()],
            ..LiveMesh::default()
        };
        for (t, tetrahedron) in model.mesh.tetrahedra.iter().enumerate() {
            if model.parts.dynamic[t] && live.elements.is_none() {
                live.accumulate(model, t);
            }
            for node in tetrahedron {
                live.star_count[*node as usize] += 1;
                live.weight[*node as usize] += model.quarter[t];
            }
        }
        if is_linear {
            for node in 0..model.pattern.nodes() {
                live.tensors.close(&model.pattern, node);
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
        if let Some(elements) = &mut live.elements {
            elements.guard(live.tetrahedra.len(), nodes);
        }
        for (f, face) in model.topology.faces.iter().enumerate() {
            if face.tetrahedra[1] == NONE {
                live.expose(f as u32);
            }
        }
        live.pieces = live.whole_pieces(model);
        live
    }

    /// Which vertices share an edge.
    pub fn pattern<'a>(&'a self, model: &'a Model) -> &'a Pattern {
        self.pattern.as_deref().unwrap_or(&model.pattern)
    }

    /// K on the moving nodes.
    pub fn stiffness<'a>(&'a self, model: &'a Model) -> Stiffness<'a> {
        Stiffness {
            pattern: self.pattern(model),
            ..model.stiffness(&self.tensors)
        }
    }

    /// The node of the mesh before any cut that a node in use comes from.
    pub fn origin(&self, node: u32) -> u32 {
        self.origin.get(node as usize).copied().unwrap_or(node)
    }

    /// Axes of a node that no support holds.
    pub fn free(&self, model: &Model, node: usize) -> [bool; 3] {
        match self.origin(node as u32) {
            NONE => [false; 3],
            origin => model.boundary.free[origin as usize],
        }
    }

    /// Live tetrahedra round a node in use, ascending.
    pub fn star<'a>(&'a self, model: &'a Model, node: u32) -> impl Iterator<Item = u32> + 'a {
        let star = model.topology.star(self.origin(node) as usize).iter();
        let is_split = self.origin.len() > self.pattern(model).first;
        star.copied().filter(move |t| {
            self.alive[*t as usize] && (!is_split || self.tetrahedra[*t as usize].contains(&node))
        })
    }

    fn tissue(&self) -> Tissue<'_> {
        Tissue {
            tetrahedra: &self.tetrahedra,
            alive: &self.alive,
            star_count: &self.star_count,
            origin: &self.origin,
        }
    }

    /// The pieces, found afresh.
    pub fn whole_pieces(&self, model: &Model) -> Pieces {
        Pieces::whole(model, &self.tissue())
    }

    /// Tensors or springs of dynamic tetrahedron `t`.
    fn accumulate(&mut self, model: &Model, t: usize) {
        // Nothing is split yet.
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

    /// Whether forces are right under any rotation, so that loose pieces need no frames.
    pub fn is_objective(&self) -> bool {
        let elements = self.elements.as_ref();
        self.springs.is_some() || elements.is_some_and(|e| e.law() != Law::Linear)
    }

    /// Whether the linear law is in tensors.
    fn has_tensors(&self) -> bool {
        self.springs.is_none() && self.elements.is_none()
    }

    /// How far what has a non-linear law is deformed. `points` is scratch.
    pub fn extent(&self, u: &[Lane], points: &mut [f64]) -> Extent {
        match (&self.elements, &self.blend) {
            (Some(elements), _) if elements.law() == Law::Linear => Extent::default(),
            (Some(elements), _) => elements.extent(u, points, &self.mass),
            (_, Some(blend)) => blend.extent(u),
            _ => Extent::default(),
        }
    }

    /// Tensors of the elements at rest, as a linear law; those with points reach further than edges.
    pub fn tangent_at_rest(&self, model: &Model) -> (Pattern, Tensors) {
        let pattern = self.pattern(model);
        let at_rest = |e: &Elements| e.tangent(&vec![Lane::default(); pattern.nodes()]);
        if let Some(entries) = self.elements.as_ref().and_then(at_rest) {
            return Tensors::assemble(pattern.nodes(), &entries);
        }
        let mut tensors = Tensors::zeros(pattern);
        for (t, nodes) in self.tetrahedra.iter().enumerate() {
            if self.alive[t] && model.parts.dynamic[t] {
                let material = self.material(model, t).at_rest();
                tensors.accumulate(pattern, nodes, &model.shape[t], &material);
            }
        }
        (pattern.clone(), tensors)
    }

    /// One substep of adaptive tissue: what is beyond the threshold starts the sweep.
    fn adaptive_sweep(&self, pattern: &Pattern, motion: &mut Motion, by: &Advance) -> Sums {
        let excess = self.blend.as_ref().map_or_else(Default::default, |blend| {
            let listed = motion.listed.and_then(Listed::blend);
            blend.add_forces(listed, motion.displacement, motion.partial)
        });
        let mut sums = sweep(pattern, &self.tensors, motion, by);
        // It has found u . force of both.
        sums.elastic += 2.0 * excess.energy - excess.virial;
        sums.extent = excess.extent;
        sums
    }

    /// Numbers that a sweep needs room for.
    pub fn points(&self) -> usize {
        self.elements.as_ref().map_or(0, Elements::points)
    }

    /// One substep of the moving nodes. `points` is scratch.
    pub fn sweep(
        &self,
        model: &Model,
        motion: &mut Motion,
        points: &mut [f64],
        by: &Advance,
    ) -> Sums {
        let pattern = self.pattern(model);
        match (&self.springs, &self.elements) {
            (Some(springs), _) => spring_sweep::sweep(springs, motion, by),
            _ if self.blend.is_some() => self.adaptive_sweep(pattern, motion, by),
            (_, Some(elements)) => {
                let used = pattern.first..model.parts.connected_from();
                element_sweep::sweep(elements, used, motion, points, by)
            }
            _ => sweep(pattern, &self.tensors, motion, by),
        }
    }

    /// Internal force on node i \[N\], without that of a pre-computed part.
    pub fn internal_force(&self, model: &Model, i: usize, u: &[Lane]) -> Vec3 {
        match (&self.springs, &self.elements) {
            (Some(springs), _) => springs.force(self.pattern(model), i, u),
            (_, Some(Elements::ConstantStrain(own) | Elements::Polynomial(_, own))) => {
                self.star_force(model, own.law, i, u)
            }
            (_, Some(Elements::NodalPressure(own))) => own.node_force(i, u),
            (_, Some(Elements::NodalAveraged(own, _))) => {
                own.node_force(i, u) + self.resistance(model, i, u)
            }
            _ => {
                let linear = self.tensors.row_product(self.pattern(model), i, u);
                linear + self.beyond(model, i, u)
            }
        }
    }

    /// Volume penalty \[Pa\], which only elements have.
    pub fn penalty(&self) -> f64 {
        self.elements.as_ref().map_or(0.0, Elements::penalty)
    }

    pub fn set_penalty(&mut self, penalty: f64) {
        if let Some(elements) = &mut self.elements {
            elements.set_penalty(penalty);
        }
    }

    /// Of adaptive tissue \[m\].
    pub fn set_threshold(&mut self, threshold: f64) {
        if let Some(blend) = &mut self.blend {
            blend.threshold = threshold;
        }
    }

    /// Of tetrahedron `t`, with the present volume penalty.
    pub fn material(&self, model: &Model, t: usize) -> Hooke {
        model.material(t).law.with_penalty(self.penalty())
    }

    /// Those on the nodes of whole pieces, which `to` gets.
    pub(crate) fn internal_forces(
        &self,
        model: &Model,
        nodes: &[u32],
        u: &[Lane],
        to: &mut [Lane],
    ) {
        if self.has_tensors() {
            (self.tensors).products_among(self.pattern(model), nodes, u, to);
            return self.each_beyond(model, nodes, u, |nodes, (force, ..)| {
                for (node, force) in nodes.iter().zip(force) {
                    let to = &mut to[*node as usize];
                    *to = (to.xyz() + force).into();
                }
            });
        }
        for node in nodes {
            to[*node as usize] = self.internal_force(model, *node as usize, u).into();
        }
    }

    /// Force of adaptive tissue on top of the tensors' at a node \[N\].
    fn beyond(&self, model: &Model, i: usize, u: &[Lane]) -> Vec3 {
        let Some(blend) = &self.blend else {
            return Vec3::zeros();
        };
        self.sum_round(model, i, u, |t, u| {
            blend.force(&model.material(t).law, &model.shape[t], u).0
        })
    }

    /// Energy of whole pieces that half of u . force is not \[J\]: adaptive tissue's.
    pub(crate) fn not_quadratic(&self, model: &Model, nodes: &[u32], u: &[Lane]) -> f64 {
        let mut sum = 0.0;
        self.each_beyond(model, nodes, u, |_, (_, energy, virial)| {
            sum += energy - 0.5 * virial;
        });
        sum
    }

    /// What adaptive tissue has on top of the tensors, a tetrahedron of whole pieces each: forces \[N\], energy \[J\] and u . force.
    fn each_beyond(
        &self,
        model: &Model,
        nodes: &[u32],
        u: &[Lane],
        mut give: impl FnMut(&[u32; 4], ([Vec3; 4], f64, f64)),
    ) {
        let Some(blend) = &self.blend else {
            return;
        };
        for i in nodes.iter().filter(|i| self.star_count[**i as usize] > 0) {
            for t in self.star(model, *i).map(|t| t as usize) {
                let own = &self.tetrahedra[t];
                if model.parts.dynamic[t] && own.iter().min() == Some(i) {
                    let u = own.map(|v| u[v as usize].xyz());
                    let material = &model.material(t).law;
                    give(own, blend.force(material, &model.shape[t], &u));
                }
            }
        }
    }

    /// That of the tetrahedra round a node.
    fn star_force(&self, model: &Model, law: Law, i: usize, u: &[Lane]) -> Vec3 {
        self.sum_round(model, i, u, |t, u| {
            let material = self.material(model, t);
            tetrahedra::force(law, &material, &model.shape[t], u).0
        })
    }

    /// That of the guard round a node.
    fn resistance(&self, model: &Model, i: usize, u: &[Lane]) -> Vec3 {
        self.sum_round(model, i, u, |t, u| self.guard_force(model, t, u).0)
    }

    /// Forces dW/du \[N\] of a tetrahedron's guard, and its energy \[J\].
    pub(crate) fn guard_force(&self, model: &Model, t: usize, u: &[Vec3; 4]) -> ([Vec3; 4], f64) {
        match self.elements.as_ref().and_then(Elements::guarded) {
            Some(_) => guard::force(&model.material(t).law, &model.shape[t], u),
            None => Default::default(),
        }
    }

    /// What dynamic tetrahedra round a node do to it, of the forces on the corners of each.
    fn sum_round(
        &self,
        model: &Model,
        i: usize,
        u: &[Lane],
        forces: impl Fn(usize, &[Vec3; 4]) -> [Vec3; 4],
    ) -> Vec3 {
        let mut sum = Vec3::zeros();
        if self.star_count[i] == 0 {
            return sum;
        }
        let own = |t: &u32| model.parts.dynamic[*t as usize];
        for t in self.star(model, i as u32).filter(own) {
            let nodes = self.tetrahedra[t as usize];
            let force = forces(t as usize, &nodes.map(|v| u[v as usize].xyz()));
            let corner = nodes.iter().position(|v| *v as usize == i);
            sum += corner.map_or(Vec3::zeros(), |k| force[k]);
        }
        sum
    }

    /// Of tensors, springs or elements.
    pub fn bytes(&self) -> usize {
        self.tensors.bytes()
            + self.springs.as_ref().map_or(0, Springs::bytes)
            + self.elements.as_ref().map_or(0, Elements::bytes)
            + self.blend.as_ref().map_or(0, Blend::bytes)
    }

    /// Removes one live tetrahedron: its four masses and four faces. Its tensors or springs stay until
    /// [`LiveMesh::settle`]. Does nothing to a dead one. Dynamic ones only. Returns whether it was alive.
    pub(crate) fn remove(&mut self, model: &Model, t: u32) -> bool {
        let index = t as usize;
        if !std::mem::replace(&mut self.alive[index], false) {
            return false;
        }
        self.removed.push(t);
        self.revision += 1;
        let shape = &model.shape[index];
        self.removed_volume += shape.volume;
        let share = model.quarter[index];
        let nodes = self.tetrahedra[index];
        self.dirty.push((t, nodes));
        for node in &nodes {
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

    /// Splits a node: the `moved` tetrahedra of its star get the next spare in its place, with their share of the
    /// mass. None where no spare is left. Tensors are as after [`LiveMesh::remove`].
    pub(crate) fn split(&mut self, model: &Model, node: u32, moved: &[u32]) -> Option<u32> {
        self.around.clear();
        for t in moved {
            for other in self.tetrahedra[*t as usize] {
                if other != node && !self.around.contains(&other) {
                    self.around.push(other);
                }
            }
        }
        self.around.sort_unstable();
        if let Some(springs) = &self.springs
            && !springs.has_room(self.around.len())
        {
            self.around.clear();
            return None;
        }
        let Some(new) = self.pattern.as_mut().and_then(|p| p.open(&self.around)) else {
            self.around.clear();
            return None;
        };
        let (n, from) = (new as usize, node as usize);
        self.rest[n] = self.rest[from];
        self.origin[n] = self.origin(node);
        if let Some(springs) = &mut self.springs {
            springs.open(&self.around, &self.rest);
        }
        if let Some(elements) = &mut self.elements {
            elements.open(new, node);
        }
        let header = [self.removed.len() as u32, node, moved.len() as u32];
        self.splits.extend(header.iter().chain(moved));
        self.revision += 1;
        let mut share = 0.0;
        for t in moved {
            let index = *t as usize;
            share += model.quarter[index];
            self.dirty.push((*t, self.tetrahedra[index]));
            for corner in &mut self.tetrahedra[index] {
                if *corner == node {
                    *corner = new;
                }
            }
            self.dirty.push((*t, self.tetrahedra[index]));
        }
        self.star_count[n] = moved.len() as u32;
        self.star_count[from] -= moved.len() as u32;
        self.weight[n] = share;
        self.weight[from] -= share;
        self.mass[n] = share;
        self.mass[from] -= share;
        self.pieces.join(new, node);
        self.around.clear();
        Some(new)
    }

    /// Brings up to date what tetrahedra that have changed have or had a share in, summed again over what is left: vertex
    /// and edge tensors or springs, masses. In the order of a fresh assembly, so that it equals one to the
    /// bit, and exactly zero where nothing is left.
    pub(crate) fn settle(&mut self, model: &Model) {
        let mut edges = std::mem::take(&mut self.edges);
        let mut nodes = std::mem::take(&mut self.around);
        for (t, corners) in &self.dirty {
            if let Some(elements) = &mut self.elements {
                let t = *t as usize;
                elements.rename(t, &self.tetrahedra[t]);
                if !self.alive[t] {
                    elements.remove(t);
                }
            }
            if let Some(blend) = &mut self.blend {
                let t = *t as usize;
                blend.rename(t, &self.tetrahedra[t]);
                if !self.alive[t] {
                    blend.remove(t);
                }
            }
            let own = model.topology.tetrahedron_edges[*t as usize];
            for ([a, b, ..], edge) in EDGES.iter().zip(own) {
                let (a, b) = (corners[*a], corners[*b]);
                edges.push(([a.min(b), a.max(b)], edge));
            }
            nodes.extend(corners);
        }
        if self.dirty.len() > 1 {
            edges.sort_unstable();
            edges.dedup();
            nodes.sort_unstable();
            nodes.dedup();
        }
        match self.elements {
            None => {
                for (ends, edge) in &edges {
                    self.sum_edge(model, *ends, *edge);
                }
            }
            Some(Elements::Polynomial(..)) => self.sum_polynomial(model, &nodes, &edges),
            // Not gathered on edges.
            Some(_) => {}
        }
        for node in &nodes {
            self.sum_node(model, *node as usize);
        }
        edges.clear();
        nodes.clear();
        self.dirty.clear();
        (self.edges, self.around) = (edges, nodes);
    }

    /// The tensor or the spring of an edge, from its lower to its higher node.
    fn sum_edge(&mut self, model: &Model, ends: [u32; 2], edge: u32) {
        let mut block = Matrix3::zeros();
        let mut spring = 0.0;
        for t in model.topology.edge_star(edge) {
            let t = *t as usize;
            if !self.alive[t] || !model.parts.dynamic[t] {
                continue;
            }
            let [a, b] = ends.map(|end| self.tetrahedra[t].iter().position(|c| *c == end));
            // Of what an edge was before it split, only its own.
            let (Some(a), Some(b)) = (a, b) else {
                continue;
            };
            let (shape, law) = (&model.shape[t], &model.material(t).law);
            if self.springs.is_some() {
                let edge = self.rest[ends[1] as usize] - self.rest[ends[0] as usize];
                spring += spring_mass::share(law, shape.volume, &edge);
            } else {
                block += law.stiffness_block(shape.volume, &shape.gradient[a], &shape.gradient[b]);
            }
        }
        let pattern = self.pattern.as_deref().unwrap_or(&model.pattern);
        match &mut self.springs {
            Some(springs) => springs.set(pattern, ends[0], ends[1], spring),
            None => self.tensors.set(pattern, ends[0], ends[1], &block),
        }
    }

    /// Those of the papers' parameters that have lost a tetrahedron.
    fn sum_polynomial(&mut self, model: &Model, nodes: &[u32], edges: &[([u32; 2], u32)]) {
        let Some(Elements::Polynomial(own, _)) = &mut self.elements else {
            return;
        };
        let (topology, dynamic, alive) = (&model.topology, &model.parts.dynamic, &self.alive);
        let left = |t: &u32| {
            let t = Some(*t as usize).filter(|t| *t < alive.len() && alive[*t] && dynamic[*t])?;
            Some(polynomial::Tissue {
                nodes: &self.tetrahedra[t],
                shape: &model.shape[t],
                material: &model.material(t).law,
            })
        };
        for node in nodes {
            let star = topology.star(*node as usize).iter();
            own.sum_again(&[*node], star.filter_map(left));
        }
        for (ends, edge) in edges {
            own.sum_again(ends, topology.edge_star(*edge).iter().filter_map(left));
        }
        for (t, corners) in &self.dirty {
            for face in topology.tetrahedron_faces[*t as usize] {
                let face = &topology.faces[face as usize];
                own.sum_again(&face.vertices, face.tetrahedra.iter().filter_map(left));
            }
            own.sum_again(corners, left(t).into_iter());
        }
    }

    /// What the points of elements at these nodes have of W \[J\], and the power of their forces \[W\]: no tetrahedron
    /// has that of its own.
    pub(crate) fn share(&self, nodes: &[u32], u: &[Lane], v: &[Lane]) -> (f64, f64) {
        let mut sum = (0.0, 0.0);
        if let Some(elements) = &self.elements {
            // What is loose and has a frame is looked at as a whole.
            let framed = |node: u32| !self.is_objective() && self.pieces.is_loose(node as usize);
            for node in nodes.iter().filter(|node| !framed(**node)) {
                let (energy, power) = elements.share(*node, u, v);
                sum = (sum.0 + energy, sum.1 + power);
            }
        }
        sum
    }

    /// The points of elements at a node.
    fn sum_points(&mut self, model: &Model, node: u32) {
        let origin = self.origin(node) as usize;
        let own = match &mut self.elements {
            None | Some(Elements::ConstantStrain(_) | Elements::Polynomial(..)) => return,
            Some(Elements::NodalPressure(own)) => return own.sum_again(node),
            Some(Elements::NodalAveraged(own, _)) => own,
        };
        let star = model.topology.star(origin).iter();
        let left = star.filter(|t| {
            let t = **t as usize;
            self.alive[t] && model.parts.dynamic[t] && self.tetrahedra[t].contains(&node)
        });
        let tissue = left.map(|t| {
            let t = *t as usize;
            (
                &self.tetrahedra[t],
                &model.shape[t],
                model.material_number(t),
            )
        });
        own.sum_again(node, tissue);
    }

    /// The tensor of a node, of those of its edges; its mass.
    fn sum_node(&mut self, model: &Model, node: usize) {
        self.sum_points(model, node as u32);
        if self.has_tensors() {
            let pattern = self.pattern.as_deref().unwrap_or(&model.pattern);
            self.tensors.close(pattern, node);
        }
        let [weight_goes, mass_goes] = goes(model, node);
        if !weight_goes {
            return;
        }
        let mut weight = 0.0;
        for t in self.star(model, node as u32) {
            weight += model.quarter[t as usize];
        }
        self.weight[node] = weight;
        if mass_goes {
            self.mass[node] = weight;
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
        let tissue = Tissue {
            tetrahedra: &self.tetrahedra,
            alive: &self.alive,
            star_count: &self.star_count,
            origin: &self.origin,
        };
        (self.pieces).update(model, &tissue, &self.removed[first..], severs, search);
    }

    /// Goes through a history from where this one ends, but for what it does to the pieces. Splits end where there is
    /// no room for one.
    fn replay(&mut self, model: &Model, removed: &[u32], splits: &[u32]) {
        let mut splits = &splits[self.splits.len()..];
        for at in self.removed.len()..=removed.len() {
            while let [before, node, count, rest @ ..] = splits
                && *before as usize == at
            {
                let (moved, later) = rest.split_at(*count as usize);
                splits = later;
                if self.split(model, *node, moved).is_none() {
                    // Nobody's history: there was no room.
                    splits = &[];
                }
            }
            if let Some(t) = removed.get(at) {
                self.remove(model, *t);
            }
        }
        self.settle(model);
    }

    /// The whole mesh after a history.
    pub(crate) fn after(model: &Model, removed: &[u32], splits: &[u32]) -> LiveMesh {
        let mut live = model.whole.clone();
        live.reserve(model);
        live.replay(model, removed, splits);
        live.pieces = live.whole_pieces(model);
        live
    }

    /// Nodes that have been split, from a place in the list of splits on.
    pub(crate) fn split_nodes(&self, from: usize) -> impl Iterator<Item = u32> + '_ {
        let mut rest = &self.splits[from..];
        std::iter::from_fn(move || {
            let [_, node, count, later @ ..] = rest else {
                return None;
            };
            rest = &later[*count as usize..];
            Some(*node)
        })
    }

    /// The part of the splits that came before the first so many removals were complete.
    pub(crate) fn splits_before(&self, removals: usize) -> &[u32] {
        let mut end = 0;
        while let [before, _, count, ..] = self.splits[end..]
            && before as usize <= removals
        {
            end += 3 + count as usize;
        }
        &self.splits[..end]
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
        let (owner, vertices) = match self.alive[face.tetrahedra[0] as usize] {
            true => (face.tetrahedra[0], [a, b, c]),
            false => (face.tetrahedra[1], [a, c, b]),
        };
        if self.splits.is_empty() {
            return vertices;
        }
        let (then, now) = (
            &model.mesh.tetrahedra[owner as usize],
            &self.tetrahedra[owner as usize],
        );
        vertices.map(|v| {
            let corner = then.iter().position(|c| *c == v);
            corner.map_or(v, |c| now[c])
        })
    }

    /// Brings an older copy of the same history up to date by the removals it lacks; otherwise copies.
    /// Either way the result equals `newer` to the bit.
    pub(crate) fn catch_up(&mut self, model: &Model, newer: &LiveMesh) {
        let later = newer.splits.get(self.splits.len());
        // What was cut at once here may have been cut, and split, one after the other there.
        let goes_on = newer.removed.starts_with(&self.removed)
            && newer.splits.starts_with(&self.splits)
            && later.is_none_or(|before| *before as usize >= self.removed.len());
        if goes_on {
            self.replay(model, &newer.removed, &newer.splits);
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
        if let Some(pattern) = &mut self.pattern {
            pattern.reserve();
            self.splits.reserve(4 * model.mesh.tetrahedra.len());
        }
        if let Some(elements) = &mut self.elements {
            let spares = self.pattern.as_ref().map(|p| (p.first, p.spare_places()));
            let (vertices, neighbours) = spares.unwrap_or_default();
            elements.reserve(vertices, neighbours);
        }
        self.around.reserve(12 * model.mesh.tetrahedra.len());
        self.edges.reserve(18 * model.mesh.tetrahedra.len());
        self.dirty.reserve(3 * model.mesh.tetrahedra.len());
        self.surface.reserve(model.topology.faces.len());
    }

    /// Keeps the room that there is.
    fn copy_from(&mut self, other: &LiveMesh) {
        self.tetrahedra.clone_from(&other.tetrahedra);
        self.rest.clone_from(&other.rest);
        self.origin.clone_from(&other.origin);
        self.splits.clone_from(&other.splits);
        if let (Some(pattern), Some(other)) = (&mut self.pattern, &other.pattern) {
            pattern.copy_from(other);
        }
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
        if let (Some(own), Some(other)) = (&mut self.blend, &other.blend) {
            own.copy_from(other);
        }
        if let (Some(own), Some(other)) = (&mut self.elements, &other.elements) {
            own.copy_from(other);
        }
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
