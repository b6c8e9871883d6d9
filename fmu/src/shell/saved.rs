//! A saved state of an instance, and its bytes: what the shell knows, then the simulation's own.
//!
//! Little-endian words: magic, mode, start time (present, value), last time, status of the last step,
//! number of fixed parameters and their values, FNV-1a of these; then [`tissue::snapshot`].

use std::sync::Arc;

use tissue::model::{Fnv, Model};
use tissue::simulation::Simulation;
use tissue::snapshot::{self, SnapshotError};
use tissue::state::State;

use crate::order::Mode;
use crate::types::{Outcome, Status, error};
use crate::variables;

const MAGIC: &[u8; 8] = b"tissueF1";

pub struct Saved {
    pub mode: Mode,
    /// Host time of the model's time 0 \[s\].
    pub start_time: Option<f64>,
    /// Host time up to which steps have got \[s\].
    pub last_time: f64,
    pub last_step: Status,
    /// Values of the fixed parameters, set but not yet built in before the start.
    pub fixed: Vec<f64>,
    pub model: Arc<Model>,
    pub state: State,
}

impl Saved {
    pub fn size(&self) -> usize {
        8 * (8 + self.fixed.len()) + snapshot::size(&self.state)
    }

    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let mut word = |value: u64| bytes.extend_from_slice(&value.to_le_bytes());
        word(self.mode as u64);
        word(u64::from(self.start_time.is_some()));
        word(self.start_time.unwrap_or(0.0).to_bits());
        word(self.last_time.to_bits());
        word(self.last_step as u64);
        word(self.fixed.len() as u64);
        self.fixed.iter().for_each(|value| word(value.to_bits()));
        let check = checksum(&bytes);
        bytes.extend_from_slice(&check.to_le_bytes());
        bytes.extend(snapshot::write(&self.model, &self.state));
        bytes
    }

    /// `original` is the model as shipped, `current` the one in use; where fixed parameters were
    /// others when the state was saved, the model of those is built again.
    pub fn read(bytes: &[u8], original: &Arc<Model>, current: &Arc<Model>) -> Outcome<Saved> {
        let mut rest = bytes
            .strip_prefix(MAGIC)
            .ok_or_else(|| error(SnapshotError::Version))?;
        let mut word = || -> Outcome<u64> {
            let (head, tail) = rest.split_first_chunk::<8>().ok_or_else(damaged)?;
            rest = tail;
            Ok(u64::from_le_bytes(*head))
        };
        let mode = Mode::from_code(word()?).ok_or_else(damaged)?;
        let (started, start_time) = (word()? == 1, f64::from_bits(word()?));
        let last_time = f64::from_bits(word()?);
        let last_step = Status::from_code(word()?).ok_or_else(damaged)?;
        let count = word()?;
        let mut fixed = Vec::new();
        for _ in 0..count {
            fixed.push(f64::from_bits(word()?));
        }
        let check = word()?;
        let header = bytes.len() - rest.len() - 8;
        if checksum(&bytes[..header]) != check {
            return Err(damaged());
        }
        let model = if mode.before_start() {
            original.clone()
        } else {
            model_with(&fixed, original, current)?
        };
        let state = snapshot::read(&model, rest).map_err(error)?;
        Ok(Saved {
            mode,
            start_time: started.then_some(start_time),
            last_time,
            last_step,
            fixed,
            model,
            state,
        })
    }

    /// A simulation in this state.
    pub fn simulation(&self) -> Outcome<Simulation> {
        let mut simulation = Simulation::new(self.model.clone());
        if self.mode.before_start() {
            variables::set_fixed(&mut simulation, &self.fixed)?;
            // What was set stays set when the model is built anew.
            if self.state.parameters.damping_set {
                simulation.set_damping(self.state.parameters.damping);
            }
        }
        simulation.restore(&self.state);
        Ok(simulation)
    }
}

fn model_with(fixed: &[f64], original: &Arc<Model>, current: &Arc<Model>) -> Outcome<Arc<Model>> {
    let mut simulation = Simulation::new(original.clone());
    variables::set_fixed(&mut simulation, fixed)?;
    if *simulation.pending_scene() == current.scene {
        return Ok(current.clone());
    }
    simulation.rebuild().map_err(error)?;
    Ok(simulation.model().clone())
}

fn damaged() -> crate::types::Refusal {
    error(SnapshotError::Damaged)
}

fn checksum(bytes: &[u8]) -> u64 {
    let mut sum = Fnv::default();
    sum.write(bytes);
    sum.0
}
