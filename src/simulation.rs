//! A model, its state and what a host does with them: set inputs, step, read outputs.

use std::sync::Arc;

use nalgebra::Matrix3;

use crate::couple::Before;
use crate::element::tetrahedra::Extent;
use crate::energy::{self, Energy};
use crate::haptics::tangent::Column;
use crate::haptics::{Haptics, HapticsError};
use crate::mesh::Vec3;
use crate::model::tensor_mass::Lane;
use crate::model::{Model, ModelError};
use crate::scene::{Scene, Start};
use crate::snapshot::{self, SnapshotError};
use crate::state::{Parameters, State, ToolState};
use crate::step::{self, StepError, Workspace};

/// One running instance. Instances share nothing but the immutable model.
#[derive(Debug)]
pub struct Simulation {
    model: Arc<Model>,
    state: State,
    work: Workspace,
    scratch: energy::Scratch,
    /// Evaluated when first read after a change.
    energy: Option<Energy>,
    /// Displacements inside the pre-computed part, brought up to date when first looked at.
    inside: Option<Vec<Lane>>,
    /// Likewise velocities.
    inside_velocity: Option<Vec<Lane>>,
    haptics: Haptics,
    halvings: u32,
    /// As built, for [`Simulation::reset`].
    original: Arc<Model>,
    /// Changed by parameters that need a new model, until [`Simulation::rebuild`].
    pending: Option<Box<Scene>>,
}

/// What a host may change of a material before the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Material {
    YoungModulus,
    PoissonRatio,
    Density,
}

impl Simulation {
    pub fn new(model: Arc<Model>) -> Simulation {
        let state = State::new(&model);
        let work = Workspace::new(&model, &state);
        let scratch = energy::Scratch::new(&model);
        Simulation {
            original: model.clone(),
            model,
            state,
            work,
            scratch,
            energy: None,
            inside: None,
            inside_velocity: None,
            haptics: Haptics::default(),
            halvings: 0,
            pending: None,
        }
    }

    /// The scene with the changes made so far.
    pub fn pending_scene(&self) -> &Scene {
        self.pending.as_deref().unwrap_or(&self.model.scene)
    }

    /// A change that takes effect with [`Simulation::rebuild`].
    pub fn change_scene(&mut self, change: impl FnOnce(&mut Scene)) {
        let scene = self
            .pending
            .get_or_insert_with(|| Box::new(self.model.scene.clone()));
        change(scene);
    }

    pub fn material(&self, k: usize, which: Material) -> f64 {
        let material = &self.pending_scene().materials[k];
        match which {
            Material::YoungModulus => material.young_modulus,
            Material::PoissonRatio => material.poisson_ratio,
            Material::Density => material.density,
        }
    }

    /// Makes the model anew where the scene was changed, keeping inputs and parameters that were set.
    /// Returns whether it had to.
    pub fn rebuild(&mut self) -> Result<bool, ModelError> {
        let gravity = self.state.parameters.gravity;
        let starts_settled = self.model.scene.start == Start::Equilibrium;
        if starts_settled && self.pending_scene().gravity != gravity {
            self.change_scene(|scene| scene.gravity = gravity);
        }
        let Some(scene) = self.pending.take() else {
            return Ok(false);
        };
        if *scene == self.model.scene {
            return Ok(false);
        }
        let model = Arc::new(self.model.with_scene(*scene)?);
        let old = std::mem::replace(&mut self.state, State::new(&model));
        self.work = Workspace::new(&model, &self.state);
        self.model = model;
        self.haptics = Haptics::default();
        self.forget();
        for (new, old) in self.state.tools.iter_mut().zip(&old.tools) {
            new.input = old.input;
            new.input_active = old.input_active;
        }
        for axis in 0..3 {
            self.set_gravity(axis, old.parameters.gravity[axis]);
        }
        if old.parameters.damping_set {
            self.set_damping(old.parameters.damping);
        }
        self.set_tearing_threshold(old.parameters.tearing_threshold);
        if old.parameters.incompressibility_set {
            self.set_incompressibility(old.parameters.incompressibility);
        }
        if old.parameters.nonlinear_threshold_set {
            self.set_nonlinear_threshold(old.parameters.nonlinear_threshold);
        }
        Ok(true)
    }

    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    pub fn state(&self) -> &State {
        &self.state
    }

    /// Back to time 0, inputs and parameters at their start values.
    pub fn reset(&mut self) {
        self.pending = None;
        self.work.spared = false;
        self.halvings = 0;
        if !Arc::ptr_eq(&self.model, &self.original) {
            self.model = self.original.clone();
            self.work = Workspace::new(&self.model, &State::new(&self.model));
            self.haptics = Haptics::default();
        }
        self.state = State::new(&self.model);
        self.work.forget();
        self.haptics.forget_all();
        self.forget();
    }

    /// Places the tools where the inputs say, before the first step. One whose orientation is zero
    /// stays; the error names the first such.
    pub fn place_tools(&mut self) -> Result<(), StepError> {
        self.state.sleep.wake();
        self.haptics.forget();
        let mut outcome = Ok(());
        for (k, tool) in self.state.tools.iter_mut().enumerate() {
            match tool.input.pose() {
                Some(pose) => tool.pose = pose,
                None => outcome = outcome.and(Err(StepError::Orientation(k + 1))),
            }
            tool.lines = [None; 3];
            // No way was made.
            (tool.burned, tool.allowance) = (None, 0.0);
        }
        outcome
    }

    /// Advances by `length` \[s\]; on an error nothing has changed.
    pub fn step(&mut self, length: f64) -> Result<(), StepError> {
        let before = self.state.length;
        let stable = step::stable(&self.model, &self.state, length).unwrap_or(0);
        let foreseen = stable.max(step::hasty(&self.model, &self.state, length));
        let outcome = step::step(&self.model, &mut self.state, &mut self.work, length);
        // What was evaluated of tissue that slept on is still so; the tangent is that of a step as long.
        if !(self.work.slept && outcome.is_ok() && self.state.length == before) {
            self.forget();
        }
        let halvings = outcome?;
        self.halvings = match halvings > foreseen {
            true => halvings,
            false => stable,
        };
        Ok(())
    }

    /// How often the last step had to halve its substep to be stable.
    pub fn halvings(&self) -> u32 {
        self.halvings
    }

    /// The smallest volume ratio of tetrahedra with a non-linear law, where one is inside out now.
    pub fn inverted(&self) -> Option<f64> {
        Some(self.state.extent.least).filter(|ratio| *ratio <= 0.0)
    }

    /// Share of the dynamic tetrahedra whose law is not the linear one.
    pub fn nonlinear_fraction(&self) -> f64 {
        if let Some(blend) = &self.state.live.blend {
            let live = &self.state.live;
            let count = (live.alive.iter().zip(&self.model.parts.dynamic))
                .filter(|(alive, dynamic)| **alive && **dynamic)
                .count();
            return blend.share(&self.state.displacement, count);
        }
        if self.model.is_nonlinear() { 1.0 } else { 0.0 }
    }

    /// Whether a cautery has touched pre-computed tissue, which cannot be cut.
    pub fn spared(&self) -> bool {
        self.work.spared
    }

    /// Whether pre-computed tissue has come loose, which swells as it turns.
    pub fn has_frameless(&self) -> bool {
        self.state.live.pieces.has_frameless
    }

    /// Whether a cut has needed more vertices than there were spares.
    pub fn lacks_spares(&self) -> bool {
        self.work.cut.lacks_spares
    }

    fn forget(&mut self) {
        self.energy = None;
        self.inside = None;
        self.inside_velocity = None;
        self.haptics.forget();
    }

    /// Seconds from the start.
    pub fn time(&self) -> f64 {
        self.state.clock.time()
    }

    pub fn tool(&self, k: usize) -> &ToolState {
        &self.state.tools[k]
    }

    /// Component 0..3 of the position \[m\], 3..7 of the quaternion w x y z. Used by the next step.
    pub fn set_pose_input(&mut self, tool: usize, component: usize, value: f64) {
        let input = &mut self.state.tools[tool].input;
        input.value[component] = value;
        self.haptics.forget();
    }

    /// First time derivative of a pose component; used for one step, then forgotten.
    pub fn set_pose_rate(&mut self, tool: usize, component: usize, rate: f64) {
        self.state.tools[tool].input.rate[component] = Some(rate);
        self.haptics.forget();
    }

    pub fn set_active(&mut self, tool: usize, active: bool) {
        self.state.tools[tool].input_active = active;
    }

    pub fn parameters(&self) -> &Parameters {
        &self.state.parameters
    }

    /// \[m/s²\]. The change of the potential counts as work of the supports.
    pub fn set_gravity(&mut self, axis: usize, value: f64) {
        let change = value - self.state.parameters.gravity[axis];
        self.wake_if(change != 0.0);
        let half = 0.5 * self.state.clock.lag;
        let State {
            live,
            displacement,
            velocity,
            ..
        } = &self.state;
        // As for a load: at the displacement half a substep ago.
        let moving = self.model.parts.moving;
        let nodes = displacement[..moving].iter().zip(velocity);
        let moment: f64 = (live.weight.iter().zip(nodes))
            .map(|(m, (u, v))| m * (u.0[axis] - half * v.0[axis]))
            .sum();
        self.state.account.support_work -= change * moment;
        self.state.parameters.gravity[axis] = value;
        let mut before = Before::with_room(&self.model);
        before.remember(&self.model, &self.state.coupling);
        let (gravity, time) = (self.state.parameters.gravity, self.state.clock.time());
        if self
            .state
            .coupling
            .set_amplitudes(&self.model, &gravity, time)
        {
            let State {
                coupling,
                displacement,
                ..
            } = &mut self.state;
            coupling.solve(&self.model, displacement);
            let mut impulse = vec![Vec3::zeros(); self.state.tools.len()];
            let gained = step::gained(&self.model, &mut self.state, &before, &mut impulse);
            self.state.account.support_work += gained;
        }
        for node in 0..self.model.parts.moving {
            self.state.refresh_external(&self.model, node);
        }
        self.forget();
        self.restart_account();
    }

    /// \[1/s\]; the substep follows its critical value.
    pub fn set_damping(&mut self, value: f64) {
        self.wake_if(value != self.state.parameters.damping);
        self.state.parameters.damping_set = true;
        let change = self
            .model
            .lagging_damping(value - self.state.parameters.damping);
        let State { live, velocity, .. } = &self.state;
        // Loose pieces book their damping by trapezoids.
        let held = (0..self.model.parts.moving).filter(|i| !live.pieces.is_loose(*i));
        let mut twice_kinetic: f64 = held
            .map(|i| live.mass[i] * velocity[i].xyz().norm_squared())
            .sum();
        if let Some(guyan) = &self.model.guyan {
            twice_kinetic += guyan.excess(&self.model, &self.state);
        }
        self.state.account.dissipated += 0.5 * self.state.clock.lag * change * twice_kinetic;
        self.state.parameters.damping = value;
        self.state.refactor();
        self.renew_substep();
        self.forget();
        self.restart_account();
    }

    /// Volume penalty \[Pa\]; the substep follows its critical value.
    pub fn set_incompressibility(&mut self, value: f64) {
        self.wake_if(value != self.state.parameters.incompressibility);
        self.change_law(|state| {
            state.parameters.incompressibility = value;
            state.parameters.incompressibility_set = true;
            state.live.set_penalty(value);
        });
        self.renew_substep();
    }

    /// Of adaptive tissue, above 0 \[m\].
    pub fn set_nonlinear_threshold(&mut self, value: f64) {
        self.wake_if(value != self.state.parameters.nonlinear_threshold);
        self.change_law(|state| {
            state.parameters.nonlinear_threshold = value;
            state.parameters.nonlinear_threshold_set = true;
            state.live.set_threshold(value);
        });
    }

    /// What that makes of energy where tissue is deformed is support work.
    fn change_law(&mut self, change: impl FnOnce(&mut State)) {
        let before = self.energy().balance();
        change(&mut self.state);
        self.forget();
        let points = &mut self.work.points;
        self.state.extent = self.state.live.extent(&self.state.displacement, points);
        self.state.account.support_work += self.energy().balance() - before;
        self.forget();
        self.restart_account();
    }

    /// Relative change of volume or length above which tetrahedra tear, above 0 \[1\].
    pub fn set_tearing_threshold(&mut self, value: f64) {
        self.wake_if(value != self.state.parameters.tearing_threshold);
        self.state.parameters.tearing_threshold = value;
    }

    /// Hosts may set what is set already.
    fn wake_if(&mut self, changes: bool) {
        if changes {
            self.state.sleep.wake();
        }
    }

    /// That of tissue at rest with the parameters as they are.
    fn renew_substep(&mut self) {
        let parameters = &self.state.parameters;
        let ratio = (self.model).stiffening(&Extent::default(), parameters.incompressibility);
        self.state.nominal_substep = self.model.substep_at(parameters.damping, ratio);
        if self.state.clock.total == 0 {
            self.state.clock.substep = self.state.nominal_substep;
            self.state.clock.lag = self.model.lag(self.state.nominal_substep);
        }
    }

    /// Before the first step the account starts with the parameters as they are.
    fn restart_account(&mut self) {
        if self.state.clock.total == 0 {
            self.state.account = Default::default();
            self.state.account.start = self.state.energy(&self.model).balance();
        }
    }

    pub fn energy(&mut self) -> Energy {
        if let Some(energy) = self.energy {
            return energy;
        }
        let energy = energy::evaluate(&self.model, &self.state, &mut self.scratch);
        *self.energy.insert(energy)
    }

    /// d force \[N\] and d torque \[N m\] of tool `of` at the end of the next step by a component of that step's pose of
    /// tool `by`: 0..3 its position \[m\], 3..7 its quaternion w x y z as set. Evaluated when first asked for; see
    /// [`crate::haptics::tangent`].
    pub fn tangent(
        &mut self,
        of: usize,
        by: usize,
        component: usize,
    ) -> Result<Column, HapticsError> {
        (self.haptics).tangent(&self.model, &self.state, &mut self.work, of, by, component)
    }

    /// Minus d force / d position of tool k \[N/m\] after everything has settled, symmetric. Evaluated when first asked for;
    /// see [`crate::haptics::settled`].
    pub fn static_stiffness(&mut self, k: usize) -> Result<Matrix3<f64>, HapticsError> {
        (self.haptics).static_stiffness(&self.model, &self.state, &mut self.work.loose, k)
    }

    /// Current position of shown vertex j \[m\].
    pub fn surface_vertex(&mut self, j: usize) -> Vec3 {
        let node = self.shown_node(j);
        self.state.live.rest[node] + self.displacement(node)
    }

    fn shown_node(&self, j: usize) -> usize {
        let node = self.model.surface_nodes[j] as usize;
        if node < self.state.live.pattern(&self.model).first {
            // A spare that is not in use lies on the first vertex.
            return self.model.surface_nodes[0] as usize;
        }
        node
    }

    /// Velocity of shown vertex j \[m/s\]: its way in the last substep over the length of that, with the schemes whose
    /// velocities are of half steps; with the others that at the end of the substep.
    pub fn surface_velocity(&mut self, j: usize) -> Vec3 {
        let node = self.shown_node(j);
        if node < self.model.parts.moving {
            return self.state.velocity[node].xyz();
        }
        let inside = self.inside_velocity.get_or_insert_with(|| {
            let mut known = self.state.velocity.clone();
            let State {
                coupling,
                held,
                parameters,
                clock,
                ..
            } = &self.state;
            let (gravity, time) = (&parameters.gravity, clock.time());
            coupling.update_velocities(&self.model, &mut known, held, gravity, time, clock.substep);
            known
        });
        inside[node].xyz()
    }

    /// Present displacement of a known node \[m\].
    pub fn displacement(&mut self, node: usize) -> Vec3 {
        if node < self.model.parts.moving {
            return self.state.displacement[node].xyz();
        }
        let inside = self.inside.get_or_insert_with(|| {
            let mut known = self.state.displacement.clone();
            let held = &self.state.held;
            self.state
                .coupling
                .update_all(&self.model, &mut known, held);
            known
        });
        inside[node].xyz()
    }

    /// Row j of the exposed triangles, as indices into the shown vertices, outward; -1 past their number.
    pub fn surface_triangle(&self, j: usize) -> [i32; 3] {
        let Some(face) = self.state.live.surface.get(j) else {
            return [-1; 3];
        };
        self.state
            .live
            .triangle(&self.model, *face)
            .map(|v| self.model.shown_index(v))
    }

    pub fn surface_triangle_count(&self) -> usize {
        self.state.live.surface.len()
    }

    /// Connected pieces of tissue.
    pub fn pieces(&self) -> usize {
        self.state.live.pieces.count
    }

    /// Largest stable substep at the present damping \[s\]; 1e9 where nothing can move.
    pub fn critical_substep(&self) -> f64 {
        step::critical_substep(&self.model, &self.state).min(1e9)
    }

    /// Substep in use \[s\].
    pub fn substep(&self) -> f64 {
        self.state.clock.substep
    }

    /// Smallest det F over live tetrahedra; 1 where none is left.
    /// (Inside the pre-computed part: over those whose nodes are all known.)
    pub fn minimum_volume_ratio(&mut self) -> f64 {
        if self.model.parts.known > self.model.parts.moving {
            self.displacement(self.model.parts.moving);
        }
        let known = self.inside.as_ref().unwrap_or(&self.state.displacement);
        minimum_volume_ratio(&self.model, &self.state, known)
    }

    pub fn save(&self) -> State {
        self.state.clone()
    }

    pub fn restore(&mut self, saved: &State) {
        self.state.copy_from(&self.model, saved);
        self.work.forget();
        self.haptics.forget_all();
        self.forget();
    }

    /// Bytes from which another process restores the state of the same model, to the bit.
    pub fn serialise(&self, state: &State) -> Vec<u8> {
        snapshot::write(&self.model, state)
    }

    pub fn deserialise(&self, bytes: &[u8]) -> Result<State, SnapshotError> {
        snapshot::read(&self.model, bytes)
    }
}

fn minimum_volume_ratio(model: &Model, state: &State, known: &[Lane]) -> f64 {
    let ratio = state
        .live
        .tetrahedra
        .iter()
        .enumerate()
        .filter(|(t, nodes)| {
            state.live.alive[*t] && nodes.iter().all(|v| (*v as usize) < known.len())
        })
        .map(|(t, nodes)| {
            let u = nodes.map(|v| known[v as usize].xyz());
            model.shape[t].deformation_gradient(&u).determinant()
        })
        .fold(f64::INFINITY, f64::min);
    if ratio.is_finite() { ratio } else { 1.0 }
}
