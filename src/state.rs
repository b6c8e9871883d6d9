//! Everything that changes while a scene runs. Its copy is a saved state.

use crate::contact::hold::{Held, Released};
use crate::contact::slide::{self, Contact};
use crate::couple::Coupling;
use crate::element::tetrahedra::Extent;
use crate::energy::{Account, Scratch};
use crate::live::LiveMesh;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::boundary::ramp;
use crate::model::tensor_mass::Lane;
use crate::pose::{Line, Pose, PoseInput};
use crate::sleep::Sleep;

/// Time, counted in substeps; it is never summed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clock {
    /// \[s\] from the start, where the present substep length began to hold.
    pub anchor: f64,
    /// Substeps since then.
    pub ticks: u64,
    /// Length of the present, or last, substep h \[s\].
    pub substep: f64,
    /// Length of the substep that was last made \[s\]; velocities are half of it behind. 0 for schemes
    /// whose velocities are of the same time as displacements.
    pub lag: f64,
    /// Substeps since the start.
    pub total: u64,
}

impl Clock {
    /// \[s\] from the start, at the end of the present substep.
    pub fn next(&self) -> f64 {
        self.anchor + (self.ticks + 1) as f64 * self.substep
    }

    /// \[s\] from the start.
    pub fn time(&self) -> f64 {
        self.anchor + self.ticks as f64 * self.substep
    }
}

/// Which factor implicit Euler solves with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Factored {
    /// How many of the removals it contains.
    pub removed: usize,
    /// Iterations that those it lacks have cost.
    pub spent: u64,
}

/// What a host may change at any time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// \[m/s²\]
    pub gravity: [f64; 3],
    /// \[1/s\], mass-proportional.
    pub damping: f64,
    /// Whether the host has set it: then it outlives a change of the model.
    pub damping_set: bool,
    /// Measure above which tetrahedra tear \[1\]; infinite where nothing tears.
    pub tearing_threshold: f64,
    /// Volume penalty \[Pa\]; what the elements have is its copy.
    pub incompressibility: f64,
    /// As that of damping.
    pub incompressibility_set: bool,
    /// Of adaptive tissue \[m\]; likewise a copy, and likewise set.
    pub nonlinear_threshold: f64,
    pub nonlinear_threshold_set: bool,
}

/// One tool: what the host says, where it is, what it feels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolState {
    pub input: PoseInput,
    /// Jaws closed, current on: as set by the host.
    pub input_active: bool,
    /// Where it is at the end of the last step.
    pub pose: Pose,
    pub lines: [Option<Line>; 3],
    /// As it was acted on last.
    pub active: bool,
    /// Of the tissue on the tool \[N\].
    pub force: Vec3,
    /// About the tool's position \[N m\].
    pub torque: Vec3,
    /// Impulse over the last step divided by its length \[N\].
    pub mean_force: Vec3,
    pub in_contact: bool,
    /// Tissue has slipped through its grip in the last step.
    pub slips: bool,
    /// Slopes of force \[N/s\] and torque \[N m/s\] at the end of the last step: see [`crate::haptics::slope`].
    pub force_rate: Vec3,
    pub torque_rate: Vec3,
    /// Of a cautery: where it was when it burnt last, none while the current is off.
    pub burned: Option<Pose>,
    /// Volume that it may burn \[m³\].
    pub allowance: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct State {
    pub clock: Clock,
    /// u \[m\] a known node. Inside a pre-computed part only of what tools hold is it of now: what is near a
    /// tool is of the last haptic tick, the rest older.
    pub displacement: Vec<Lane>,
    /// v \[m/s\] a known node, `clock.lag` / 2 behind; zero inside unless held by a tool.
    pub velocity: Vec<Lane>,
    pub live: LiveMesh,
    /// Of the pre-computed part. Follows from the rest but for how old positions are.
    pub coupling: Coupling,
    /// How far what has a non-linear law is deformed. Follows from the rest.
    pub extent: Extent,
    /// Gravity and loads \[N\] a node. Follows from the rest.
    pub external: Vec<Lane>,
    /// \[1/kg\] an axis, 0 where something holds it. Follows from the rest.
    pub inverse_mass: Vec<Lane>,
    /// Supports first, then what tools hold, in order of attachment.
    pub held: Vec<Held>,
    /// Lately let go by a probe.
    pub released: Vec<Released>,
    /// Where tools that slide may touch, by tool and place.
    pub contacts: Vec<Contact>,
    pub tools: Vec<ToolState>,
    pub account: Account,
    pub parameters: Parameters,
    /// Scripted cuts done.
    pub cuts_done: usize,
    /// Time since the last haptic tick \[s\].
    pub since_haptic: f64,
    /// Substep that steps are divided by \[s\].
    pub nominal_substep: f64,
    /// Of the last communication step \[s\]; 0 before the first.
    pub length: f64,
    pub factored: Factored,
    pub sleep: Sleep,
}

impl State {
    /// At time 0.
    pub fn new(model: &Model) -> State {
        let nodes = model.parts.known;
        let parameters = Parameters {
            gravity: model.scene.gravity,
            damping: model.damping(),
            damping_set: false,
            tearing_threshold: model
                .scene
                .tearing
                .as_ref()
                .map_or(f64::INFINITY, |t| t.threshold),
            incompressibility: model.whole.penalty(),
            incompressibility_set: false,
            nonlinear_threshold: model.scene.model.nonlinear_threshold,
            nonlinear_threshold_set: false,
        };
        let nominal_substep = model.substep(parameters.damping);
        let mut state = State {
            clock: Clock {
                substep: nominal_substep,
                lag: model.lag(nominal_substep),
                ..Clock::default()
            },
            displacement: model
                .start_displacement
                .iter()
                .map(|u| Lane::from(*u))
                .collect(),
            velocity: vec![Lane::default(); nodes],
            live: model.whole.clone(),
            coupling: Coupling::new(model),
            extent: Extent::default(),
            external: vec![Lane::default(); nodes],
            inverse_mass: vec![Lane::default(); nodes],
            held: Vec::new(),
            released: Vec::new(),
            contacts: Vec::new(),
            tools: model.scene.tools.iter().map(ToolState::new).collect(),
            account: Account::default(),
            parameters,
            cuts_done: 0,
            since_haptic: f64::INFINITY,
            nominal_substep,
            length: 0.0,
            factored: Factored::default(),
            sleep: Sleep::default(),
        };
        state.reserve(model);
        for (k, prescribed) in model.boundary.prescribed.iter().enumerate() {
            let i = prescribed.node as usize;
            if i >= model.parts.moving || state.live.star_count[i] == 0 {
                continue;
            }
            let start = prescribed.at(0.0);
            for axis in 0..3 {
                if prescribed.axes[axis] {
                    state.displacement[i].0[axis] = start[axis];
                }
            }
            state
                .held
                .push(Held::by_support(k as u32, prescribed.node, prescribed.axes));
        }
        state.refresh_all(model);
        let State {
            coupling,
            displacement,
            held,
            ..
        } = &mut state;
        coupling.update_all(model, displacement, held);
        coupling.seen.fill(coupling.drift);
        state.account.start = state.energy(model).balance();
        state
    }

    /// Room for all that a step may add, so that none allocates.
    pub fn reserve(&mut self, model: &Model) {
        let nodes = self.displacement.len();
        self.held.reserve(2 * nodes);
        self.released.reserve(nodes * model.scene.tools.len());
        self.contacts.reserve(slide::room(model));
        self.live.reserve(model);
        self.coupling.reserve();
    }

    pub fn energy(&self, model: &Model) -> crate::energy::Energy {
        crate::energy::evaluate(model, self, &mut Scratch::new(model))
    }

    /// Recomputes what follows from the rest.
    pub fn refresh_all(&mut self, model: &Model) {
        for node in 0..self.displacement.len() {
            self.refresh_inverse_mass(model, node);
        }
        for node in 0..model.parts.moving {
            self.refresh_external(model, node);
        }
        for held in &self.held {
            for axis in 0..3 {
                if held.axes[axis] {
                    self.inverse_mass[held.node as usize].0[axis] = 0.0;
                }
            }
        }
        let mut points = vec![0.0; self.live.points()];
        self.extent = self.live.extent(&self.displacement, &mut points);
        let (gravity, time) = (&self.parameters.gravity, self.clock.time());
        self.coupling.set_amplitudes(model, gravity, time);
        self.coupling.set_held(model, &self.held);
        self.coupling.solve(model, &self.displacement);
    }

    /// The next factor contains all that is removed by now.
    pub(crate) fn refactor(&mut self) {
        self.factored = Factored {
            removed: self.live.removed.len(),
            spent: 0,
        };
    }

    /// After a change of mass or of what holds the node.
    pub fn refresh_node(&mut self, model: &Model, node: usize) {
        self.refresh_inverse_mass(model, node);
        for held in self.held.iter().filter(|h| h.node as usize == node) {
            for axis in 0..3 {
                if held.axes[axis] {
                    self.inverse_mass[node].0[axis] = 0.0;
                }
            }
        }
    }

    fn refresh_inverse_mass(&mut self, model: &Model, node: usize) {
        let mass = self.live.mass[node];
        let free = self.live.free(model, node);
        for axis in 0..3 {
            let moves = free[axis] && mass > 0.0;
            self.inverse_mass[node].0[axis] = if moves { 1.0 / mass } else { 0.0 };
        }
    }

    /// Gravity and the node's loads at the present time.
    pub fn refresh_external(&mut self, model: &Model, node: usize) {
        self.refresh_external_at(model, node, self.clock.time());
    }

    /// The same at another time \[s\].
    pub(crate) fn refresh_external_at(&mut self, model: &Model, node: usize, time: f64) {
        let mut force = Vec3::from(self.parameters.gravity) * self.live.weight[node];
        if self.live.star_count[node] > 0 {
            for load in model.boundary.loads_on(node as u32) {
                force += load.force * ramp(time, load.ramp);
            }
        }
        self.external[node] = force.into();
    }

    /// Whether tool `k` holds or touches anything.
    pub(crate) fn is_felt_by(&self, k: usize) -> bool {
        let k = k as u32;
        self.held.iter().any(|h| h.tool == Some(k))
            || (self.contacts.iter()).any(|c| c.tool == k && c.force != Vec3::zeros())
    }

    /// Current position \[m\]; of a node that is never known, its rest position.
    pub fn position(&self, node: u32) -> Vec3 {
        let displacement = self.displacement.get(node as usize);
        self.live.rest[node as usize] + displacement.map_or(Vec3::zeros(), Lane::xyz)
    }

    /// Copies without allocating where the vectors are large enough; the live mesh by the removals
    /// that this one lacks.
    pub fn copy_from(&mut self, model: &Model, other: &State) {
        self.clock = other.clock;
        self.displacement.clone_from(&other.displacement);
        self.velocity.clone_from(&other.velocity);
        self.live.catch_up(model, &other.live);
        self.coupling.copy_from(&other.coupling);
        self.extent = other.extent;
        self.external.clone_from(&other.external);
        self.inverse_mass.clone_from(&other.inverse_mass);
        self.held.clone_from(&other.held);
        self.released.clone_from(&other.released);
        self.contacts.clone_from(&other.contacts);
        self.tools.clone_from(&other.tools);
        self.account = other.account;
        self.parameters = other.parameters;
        // Copies of them, which are no part of the history of cuts.
        self.live.set_penalty(self.parameters.incompressibility);
        (self.live).set_threshold(self.parameters.nonlinear_threshold);
        self.cuts_done = other.cuts_done;
        self.since_haptic = other.since_haptic;
        self.nominal_substep = other.nominal_substep;
        self.length = other.length;
        self.factored = other.factored;
        self.sleep = other.sleep;
    }
}

impl ToolState {
    fn new(tool: &crate::scene::Tool) -> ToolState {
        let [x, y, z] = tool.position;
        let [qw, qx, qy, qz] = tool.orientation;
        let input = PoseInput {
            value: [x, y, z, qw, qx, qy, qz],
            rate: [None; 7],
        };
        // The scene refuses a zero quaternion.
        let pose = input.pose().unwrap_or(Pose {
            position: Vec3::from(tool.position),
            orientation: nalgebra::UnitQuaternion::identity(),
        });
        ToolState {
            input,
            input_active: false,
            pose,
            lines: [None; 3],
            active: false,
            force: Vec3::zeros(),
            torque: Vec3::zeros(),
            mean_force: Vec3::zeros(),
            in_contact: false,
            slips: false,
            force_rate: Vec3::zeros(),
            torque_rate: Vec3::zeros(),
            burned: None,
            allowance: 0.0,
        }
    }
}
