//! A saved state as bytes: self-contained, versioned, checked.
//!
//! The live mesh is written as the list of removals in their order; replaying it gives the same bits.
//! Little-endian throughout.

use nalgebra::{Quaternion, UnitQuaternion};

use crate::contact::hold::{Held, Released};
use crate::contact::press::Pressed;
use crate::contact::slide::{Contact, Place};
use crate::energy::Account;
use crate::live::LiveMesh;
use crate::mesh::Vec3;
use crate::model::tensor_mass::Lane;
use crate::model::{Fnv, Model};
use crate::pose::{Line, Pose, PoseInput};
use crate::sleep::Sleep;
use crate::state::{Clock, Factored, Parameters, State, ToolState};

const MAGIC: &[u8; 8] = b"tissueSb";

/// Why bytes are not a state of this model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SnapshotError {
    #[error("these bytes are not a saved state of this version")]
    Version,
    #[error("the saved state belongs to another scene or mesh")]
    OtherModel,
    #[error("the saved state is damaged or cut short")]
    Damaged,
}

/// Numbers one after the other; the same calls in the same order read what was written.
struct Out(Vec<u8>);

impl Out {
    fn int(&mut self, value: u64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn real(&mut self, value: f64) {
        self.int(value.to_bits());
    }

    fn reals<const N: usize>(&mut self, values: [f64; N]) {
        values.iter().for_each(|v| self.real(*v));
    }

    fn option(&mut self, value: Option<f64>) {
        self.int(u64::from(value.is_some()));
        self.real(value.unwrap_or(0.0));
    }

    fn axes(&mut self, axes: [bool; 3]) {
        self.int(
            axes.iter()
                .enumerate()
                .map(|(k, a)| u64::from(*a) << k)
                .sum(),
        );
    }

    fn pose(&mut self, pose: &Pose) {
        self.reals(pose.position.into());
        let q = pose.orientation.into_inner();
        self.reals([q.w, q.i, q.j, q.k]);
    }

    fn xyz(&mut self, lanes: &[Lane]) {
        lanes
            .iter()
            .for_each(|l| self.reals([l.0[0], l.0[1], l.0[2]]));
    }
}

struct In<'a>(&'a [u8]);

impl In<'_> {
    fn int(&mut self) -> Result<u64, SnapshotError> {
        let (head, tail) = self
            .0
            .split_first_chunk::<8>()
            .ok_or(SnapshotError::Damaged)?;
        self.0 = tail;
        Ok(u64::from_le_bytes(*head))
    }

    /// A number below `limit`.
    fn index(&mut self, limit: usize) -> Result<usize, SnapshotError> {
        let value = self.int()? as usize;
        if value < limit {
            Ok(value)
        } else {
            Err(SnapshotError::Damaged)
        }
    }

    fn flag(&mut self) -> Result<bool, SnapshotError> {
        Ok(self.index(2)? == 1)
    }

    fn real(&mut self) -> Result<f64, SnapshotError> {
        Ok(f64::from_bits(self.int()?))
    }

    fn reals<const N: usize>(&mut self) -> Result<[f64; N], SnapshotError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.real()?;
        }
        Ok(values)
    }

    fn vector(&mut self) -> Result<Vec3, SnapshotError> {
        Ok(Vec3::from(self.reals::<3>()?))
    }

    fn option(&mut self) -> Result<Option<f64>, SnapshotError> {
        let some = self.flag()?;
        let value = self.real()?;
        Ok(some.then_some(value))
    }

    fn axes(&mut self) -> Result<[bool; 3], SnapshotError> {
        let bits = self.index(8)?;
        Ok([0, 1, 2].map(|k| bits >> k & 1 == 1))
    }

    fn pose(&mut self) -> Result<Pose, SnapshotError> {
        let position = self.vector()?;
        let [w, x, y, z] = self.reals()?;
        Ok(Pose {
            position,
            orientation: UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
        })
    }

    fn xyz(&mut self, lanes: &mut [Lane]) -> Result<(), SnapshotError> {
        for lane in lanes {
            *lane = self.vector()?.into();
        }
        Ok(())
    }
}

pub fn write(model: &Model, state: &State) -> Vec<u8> {
    let mut out = Out(Vec::with_capacity(size(state)));
    out.0.extend_from_slice(MAGIC);
    out.int(model.fingerprint);
    let clock = state.clock;
    out.reals([clock.anchor, clock.substep]);
    out.int(clock.ticks);
    out.int(clock.total);
    out.xyz(&state.displacement);
    out.xyz(&state.velocity);
    out.int(state.live.removed.len() as u64);
    state
        .live
        .removed
        .iter()
        .for_each(|t| out.int(u64::from(*t)));
    out.int(state.live.splits.len() as u64);
    (state.live.splits.iter()).for_each(|k| out.int(u64::from(*k)));
    out.int(state.live.cleaned as u64);
    out.real(state.live.cleaned_volume);
    out.int(state.held.len() as u64);
    for held in &state.held {
        out.int(u64::from(held.node));
        out.int(held.tool.map_or(0, |t| u64::from(t) + 1));
        out.int(u64::from(held.support));
        out.axes(held.axes);
        out.reals(held.local.into());
        out.reals(held.normal.into());
        out.int(u64::from(held.fresh));
        out.real(held.slipped);
    }
    out.int(state.released.len() as u64);
    for released in &state.released {
        out.int(u64::from(released.node));
        out.int(u64::from(released.tool));
        out.reals(released.local.into());
        out.reals(released.normal.into());
    }
    out.int(state.contacts.len() as u64);
    for contact in &state.contacts {
        out.int(u64::from(contact.tool));
        out.int(u64::from(contact.capsule));
        (contact.nodes.iter()).for_each(|v| out.int(u64::from(*v)));
        let (kind, weight) = match contact.place {
            Place::Nearest => (0, [0.0; 3]),
            Place::NearestEnd => (1, [0.0; 3]),
            Place::At(weight) => (2, weight),
        };
        out.int(kind);
        out.reals(weight);
        out.reals(contact.force.into());
        out.reals(contact.velocity.into());
    }
    out.int(state.coupling.pressed.len() as u64);
    for pressed in &state.coupling.pressed {
        out.int(u64::from(pressed.tool));
        (pressed.nodes.iter()).for_each(|v| out.int(u64::from(*v)));
        out.reals(pressed.weight);
        out.reals(pressed.place.into());
        out.reals(pressed.force.into());
    }
    out.real(state.coupling.yielded);
    for tool in &state.tools {
        out.reals(tool.input.value);
        tool.input.rate.iter().for_each(|r| out.option(*r));
        out.int(u64::from(tool.input_active));
        out.pose(&tool.pose);
        for line in &tool.lines {
            out.int(u64::from(line.is_some()));
            let line = line.unwrap_or(Line {
                origin: 0.0,
                rate: 0.0,
                substep: 0.0,
                ticks: 0,
            });
            out.reals([line.origin, line.rate, line.substep]);
            out.int(line.ticks);
        }
        out.int(u64::from(tool.active));
        out.reals(tool.force.into());
        out.reals(tool.torque.into());
        out.reals(tool.mean_force.into());
        out.int(u64::from(tool.in_contact));
        out.int(u64::from(tool.slips));
        out.reals(tool.force_rate.into());
        out.reals(tool.torque_rate.into());
        out.int(u64::from(tool.burned.is_some()));
        out.pose(&tool.burned.unwrap_or(tool.pose));
        out.real(tool.allowance);
    }
    let account = state.account;
    out.reals([
        account.tool_work,
        account.support_work,
        account.dissipated,
        account.made,
        account.start,
        account.most,
    ]);
    out.int(u64::from(account.strikes));
    out.reals(state.parameters.gravity);
    out.real(state.parameters.damping);
    out.int(u64::from(state.parameters.damping_set));
    out.real(state.parameters.tearing_threshold);
    out.real(state.parameters.incompressibility);
    out.int(u64::from(state.parameters.incompressibility_set));
    out.real(state.parameters.nonlinear_threshold);
    out.int(u64::from(state.parameters.nonlinear_threshold_set));
    out.int(state.cuts_done as u64);
    out.real(state.coupling.drift);
    state.coupling.seen.iter().for_each(|d| out.real(*d));
    out.reals([state.since_haptic, state.nominal_substep, state.length]);
    out.int(state.factored.removed as u64);
    out.int(state.factored.spent);
    out.int(u64::from(state.sleep.asleep));
    out.int(state.sleep.calm);
    let mut check = Fnv::default();
    check.write(&out.0);
    out.int(check.0);
    out.0
}

/// Length of what [`write()`] makes.
pub fn size(state: &State) -> usize {
    let words = 1
        + 1
        + 4
        + 6 * state.displacement.len()
        + 1
        + state.live.removed.len()
        + 1
        + state.live.splits.len()
        + 2
        + 1
        + 12 * state.held.len()
        + 1
        + 8 * state.released.len()
        + 1
        + 15 * state.contacts.len()
        + 1
        + 13 * state.coupling.pressed.len()
        + 1
        + (7 + 14 + 1 + 7 + 15 + 1 + 9 + 1 + 1 + 6 + 9) * state.tools.len()
        + 7
        + 10
        + 2
        + 3
        + 2
        + 2
        + state.coupling.seen.len()
        + 1;
    8 * words
}

pub fn read(model: &Model, bytes: &[u8]) -> Result<State, SnapshotError> {
    let rest = bytes
        .strip_prefix(MAGIC.as_slice())
        .ok_or(SnapshotError::Version)?;
    let (body, check) = bytes
        .split_last_chunk::<8>()
        .ok_or(SnapshotError::Damaged)?;
    let mut sum = Fnv::default();
    sum.write(body);
    if sum.0 != u64::from_le_bytes(*check) {
        return Err(SnapshotError::Damaged);
    }
    let mut input = In(&rest[..rest.len() - 8]);
    if input.int()? != model.fingerprint {
        return Err(SnapshotError::OtherModel);
    }
    let nodes = model.parts.known;
    let tools = model.scene.tools.len();
    let mut state = State::new(model);
    let [anchor, substep] = input.reals()?;
    state.clock = Clock {
        anchor,
        substep,
        lag: model.lag(substep),
        ticks: input.int()?,
        total: input.int()?,
    };
    input.xyz(&mut state.displacement)?;
    input.xyz(&mut state.velocity)?;
    let mut removed = Vec::new();
    for _ in 0..input.index(model.mesh.tetrahedra.len() + 1)? {
        removed.push(input.index(model.mesh.tetrahedra.len())? as u32);
    }
    let mut splits = Vec::new();
    for _ in 0..input.index(4 * (model.mesh.tetrahedra.len() + nodes) + 1)? {
        splits.push(input.index(u32::MAX as usize)? as u32);
    }
    if !is_history(model, &removed, &splits) {
        return Err(SnapshotError::Damaged);
    }
    state.live = LiveMesh::after(model, &removed, &splits);
    if state.live.splits != splits {
        return Err(SnapshotError::Damaged);
    }
    state.live.cleaned = input.index(removed.len() + 1)?;
    state.live.cleaned_volume = input.real()?;
    let supports = model.boundary.prescribed.len();
    state.held.clear();
    for _ in 0..input.index(2 * nodes + 1)? {
        let node = input.index(nodes)? as u32;
        let tool = input.index(tools + 1)?;
        let support = input.index(supports.max(1))? as u32;
        if tool == 0 && supports == 0 {
            return Err(SnapshotError::Damaged);
        }
        state.held.push(Held {
            tool: tool.checked_sub(1).map(|t| t as u32),
            axes: input.axes()?,
            local: input.vector()?,
            normal: input.vector()?,
            fresh: input.flag()?,
            slipped: input.real()?,
            ..Held::by_support(support, node, [false; 3])
        });
    }
    state.released.clear();
    for _ in 0..input.index(nodes * tools + 1)? {
        state.released.push(Released {
            node: input.index(nodes)? as u32,
            tool: input.index(tools)? as u32,
            local: input.vector()?,
            normal: input.vector()?,
        });
    }
    state.contacts.clear();
    for _ in 0..input.index(usize::MAX)? {
        let tool = input.index(tools)?;
        let capsule = input.index(model.tools[tool].capsules())? as u32;
        let mut touched = [0; 3];
        for node in &mut touched {
            *node = input.index(nodes)? as u32;
        }
        state.contacts.push(Contact {
            tool: tool as u32,
            capsule,
            nodes: touched,
            place: match (input.index(3)?, input.reals()?) {
                (0, _) => Place::Nearest,
                (1, _) => Place::NearestEnd,
                (_, weight) => Place::At(weight),
            },
            force: input.vector()?,
            velocity: input.vector()?,
        });
    }
    state.coupling.pressed.clear();
    for _ in 0..input.index(usize::MAX)? {
        let tool = input.index(tools)? as u32;
        let mut touched = [0; 3];
        for touched in &mut touched {
            let node = input.index(model.parts.moving + model.parts.touchable)?;
            if node < model.parts.connected_from() {
                return Err(SnapshotError::Damaged);
            }
            *touched = node as u32;
        }
        state.coupling.pressed.push(Pressed {
            tool,
            nodes: touched,
            weight: input.reals()?,
            place: input.vector()?,
            force: input.vector()?,
        });
    }
    state.coupling.yielded = input.real()?;
    for tool in &mut state.tools {
        *tool = read_tool(&mut input)?;
    }
    let [tool_work, support_work, dissipated, made, start, most] = input.reals()?;
    let strikes = input.int()? as u32;
    state.account = Account {
        tool_work,
        support_work,
        dissipated,
        made,
        start,
        most,
        strikes,
    };
    state.parameters = Parameters {
        gravity: input.reals()?,
        damping: input.real()?,
        damping_set: input.flag()?,
        tearing_threshold: input.real()?,
        incompressibility: input.real()?,
        incompressibility_set: input.flag()?,
        nonlinear_threshold: input.real()?,
        nonlinear_threshold_set: input.flag()?,
    };
    state.live.set_penalty(state.parameters.incompressibility);
    (state.live).set_threshold(state.parameters.nonlinear_threshold);
    state.cuts_done = input.index(model.cuts.len() + 1)?;
    let drift = input.real()?;
    for seen in &mut state.coupling.seen {
        *seen = input.real()?;
    }
    [state.since_haptic, state.nominal_substep, state.length] = input.reals()?;
    state.factored = Factored {
        removed: input.index(state.live.removed.len() + 1)?,
        spent: input.int()?,
    };
    state.sleep = Sleep {
        asleep: input.flag()?,
        calm: input.int()?,
    };
    if !input.0.is_empty() {
        return Err(SnapshotError::Damaged);
    }
    state.refresh_all(model);
    state.coupling.drift = drift;
    Ok(state)
}

/// Whether what goes and what splits is there at the time, so that going through it fails nowhere (but for want of
/// room).
fn is_history(model: &Model, removed: &[u32], mut splits: &[u32]) -> bool {
    let mut tetrahedra = model.mesh.tetrahedra.clone();
    let mut can_go = model.parts.dynamic.clone();
    let mut spare = model.parts.spares as u32;
    for at in 0..=removed.len() {
        while let [before, node, count, rest @ ..] = splits
            && *before as usize == at
        {
            let count = *count as usize;
            if spare == 0 || count == 0 || count > rest.len() {
                return false;
            }
            spare -= 1;
            for t in &rest[..count] {
                let t = *t as usize;
                let corner = (tetrahedra.get_mut(t))
                    .filter(|_| can_go[t])
                    .and_then(|corners| corners.iter_mut().find(|v| *v == node));
                let Some(corner) = corner else {
                    return false;
                };
                *corner = spare;
            }
            splits = &rest[count..];
        }
        let went = removed.get(at).map(|t| &mut can_go[*t as usize]);
        if went.is_some_and(|goes| !std::mem::replace(goes, false)) {
            return false;
        }
    }
    splits.is_empty()
}

fn read_tool(input: &mut In) -> Result<ToolState, SnapshotError> {
    let value = input.reals()?;
    let mut rate = [None; 7];
    for r in &mut rate {
        *r = input.option()?;
    }
    let input_active = input.flag()?;
    let pose = input.pose()?;
    let mut lines = [None; 3];
    for line in &mut lines {
        let some = input.flag()?;
        let [origin, rate, substep] = input.reals()?;
        let ticks = input.int()?;
        *line = some.then_some(Line {
            origin,
            rate,
            substep,
            ticks,
        });
    }
    let mut tool = ToolState {
        input: PoseInput { value, rate },
        input_active,
        pose,
        lines,
        active: input.flag()?,
        force: input.vector()?,
        torque: input.vector()?,
        mean_force: input.vector()?,
        in_contact: input.flag()?,
        slips: input.flag()?,
        force_rate: input.vector()?,
        torque_rate: input.vector()?,
        burned: None,
        allowance: 0.0,
    };
    let some = input.flag()?;
    tool.burned = Some(input.pose()?).filter(|_| some);
    tool.allowance = input.real()?;
    Ok(tool)
}
