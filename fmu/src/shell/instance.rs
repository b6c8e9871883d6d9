//! One instance: what the C functions do, in safe Rust. Instances share nothing.
//!
//! Time: the model's time 0 is the host's start time of `fmi2SetupExperiment`; where that was never
//! called, the first communication point. From then on a communication point must agree with the time
//! stepped so far, within 1e-9 max(1 s, |t|) + 1e-3 H, because hosts sum up time.

use std::collections::BTreeMap;
use std::ffi::{CStr, c_int};
use std::mem::MaybeUninit;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use tissue::model::Model;
use tissue::simulation::Simulation;
use tissue::step::StepError;

use crate::log::Logger;
use crate::order::{Function, Mode};
use crate::saved::Saved;
use crate::types::{self, Outcome, Status, discard, error};
use crate::{uri, variables};

pub struct Instance {
    logger: Logger,
    mode: Mode,
    /// As shipped.
    original: Arc<Model>,
    simulation: Simulation,
    /// Host time of the model's time 0 \[s\].
    start_time: Option<f64>,
    stop_time: Option<f64>,
    /// Host time up to which steps have got \[s\].
    last_time: f64,
    last_step: Status,
    /// By address, which is what the host holds. It is looked up here and never followed.
    saved: BTreeMap<usize, Box<Saved>>,
}

/// What `fmi2Instantiate` was given.
pub struct Request<'a> {
    pub name: Option<&'a CStr>,
    pub kind: c_int,
    pub guid: Option<&'a CStr>,
    pub location: Option<&'a CStr>,
}

/// Checks what the host gave and loads the model.
pub fn load(request: &Request, logger: &Logger) -> Outcome<Simulation> {
    let name = request
        .name
        .ok_or_else(|| error("instanceName is null; a name is needed"))?;
    if name.to_bytes().trim_ascii().is_empty() {
        return Err(error("instanceName is empty; a name is needed"));
    }
    if request.kind != types::CO_SIMULATION {
        return Err(error(format!(
            "fmuType is {}; only fmi2CoSimulation ({}) is provided",
            request.kind,
            types::CO_SIMULATION
        )));
    }
    let guid = request
        .guid
        .ok_or_else(|| error("fmuGUID is null; that of modelDescription.xml is needed"))?
        .to_string_lossy();
    let needed = "fmuResourceLocation must be the URI of the unpacked resources folder, such as file:///tmp/fmu/resources";
    let location = request
        .location
        .ok_or_else(|| error(format!("{needed}; it is null")))?
        .to_str()
        .map_err(|_| error(format!("{needed}; it is not UTF-8")))?;
    let (folder, plain) =
        uri::folder(location).map_err(|reason| error(format!("{needed}; {reason}")))?;
    let model = open(&folder)?;
    let expected = model_description::guid(&model);
    let given = guid.trim().trim_start_matches('{').trim_end_matches('}');
    if !given.eq_ignore_ascii_case(&expected) {
        return Err(error(format!(
            "fmuGUID is {given:?}, but {} needs {expected:?}; modelDescription.xml and resources are of different builds",
            folder.display()
        )));
    }
    if plain {
        logger.log(
            Status::Warning,
            &format!("fmi2Instantiate: {needed}; {location:?} is taken as a path"),
        );
    }
    Ok(Simulation::new(Arc::new(model)))
}

fn open(folder: &Path) -> Outcome<Model> {
    tissue::prepared::open(folder)
        .map_err(|e| error(format!("resources in {}: {e}", folder.display())))
}

/// What a step may run into; each is told of once.
const LIMITS: [&str; 3] = [
    "a cautery has touched pre-computed tissue, which cannot be cut; only the dynamic part can",
    "a piece with pre-computed tissue has come loose; it has no moving frame and swells as it turns",
    "a cut needed a vertex when no spare was left, and removed tissue instead; cutting.spareVertices must be larger",
];

impl Instance {
    pub fn new(simulation: Simulation, logger: Logger) -> Instance {
        Instance {
            logger,
            mode: Mode::Instantiated,
            original: simulation.model().clone(),
            simulation,
            start_time: None,
            stop_time: None,
            last_time: 0.0,
            last_step: Status::Ok,
            saved: BTreeMap::new(),
        }
    }

    /// Runs one call: order first; a refusal becomes one log line.
    pub fn call(
        &mut self,
        function: Function,
        action: impl FnOnce(&mut Instance) -> Outcome,
    ) -> Status {
        let outcome = match function.check(self.mode) {
            Ok(()) => action(self),
            Err(message) => Err(error(message)),
        };
        match outcome {
            Ok(()) => Status::Ok,
            Err(refusal) => {
                let line = format!("{}: {}", function.name(), refusal.message);
                self.logger.log(refusal.status, &line);
                refusal.status
            }
        }
    }

    /// After a panic: nothing but freeing is left.
    pub fn lose(&mut self, function: Function, reason: &str) {
        self.mode = Mode::Fatal;
        let line = format!(
            "{}: internal error: {reason}; the instance is lost",
            function.name()
        );
        self.logger.log(Status::Fatal, &line);
    }

    pub fn set_debug_logging(&mut self, on: bool, categories: &[&CStr]) -> Outcome {
        self.logger.switch(on, categories).map_err(error)
    }

    pub fn setup_experiment(&mut self, start: f64, stop: Option<f64>) -> Outcome {
        if !start.is_finite() {
            return Err(error(format!("startTime is {start}; it must be finite")));
        }
        // A stop time of infinity limits nothing.
        if let Some(stop) = stop.filter(|stop| stop.is_nan() || *stop < start) {
            return Err(error(format!(
                "stopTime is {stop}; it must be no less than startTime = {start}"
            )));
        }
        self.start_time = Some(start);
        self.stop_time = stop;
        self.last_time = start;
        Ok(())
    }

    pub fn enter_initialisation(&mut self) -> Outcome {
        self.mode = Mode::Initialisation;
        Ok(())
    }

    /// Builds the model anew where fixed parameters were changed, and places the tools.
    pub fn exit_initialisation(&mut self) -> Outcome {
        let begin = Instant::now();
        match self.simulation.rebuild() {
            Ok(false) => {}
            Ok(true) => {
                let line = format!(
                    "fmi2ExitInitializationMode: pre-computation with changed parameters took {:.3} s",
                    begin.elapsed().as_secs_f64()
                );
                self.logger.log(Status::Ok, &line);
            }
            Err(e) => {
                self.mode = Mode::Error;
                return Err(error(format!(
                    "the model cannot be built with the parameters set: {e}"
                )));
            }
        }
        if let Err(e) = self.simulation.place_tools() {
            // The step will refuse it. fmi2Warning as a status would end the run in some hosts.
            let line = format!("fmi2ExitInitializationMode: {e}");
            self.logger.log(Status::Warning, &line);
        }
        self.mode = Mode::StepComplete;
        Ok(())
    }

    pub fn terminate(&mut self) -> Outcome {
        self.mode = Mode::Terminated;
        Ok(())
    }

    /// As instantiated. Saved states stay valid, and so do the log settings.
    pub fn reset(&mut self) -> Outcome {
        self.simulation = Simulation::new(self.original.clone());
        self.mode = Mode::Instantiated;
        self.start_time = None;
        self.stop_time = None;
        self.last_time = 0.0;
        self.last_step = Status::Ok;
        Ok(())
    }

    pub fn get_real(&mut self, references: &[u32], values: &mut [MaybeUninit<f64>]) -> Outcome {
        variables::get_real(&mut self.simulation, references, values)
    }

    pub fn get_integer(
        &mut self,
        references: &[u32],
        values: &mut [MaybeUninit<c_int>],
    ) -> Outcome {
        variables::get_integer(&mut self.simulation, references, values)
    }

    pub fn get_boolean(
        &mut self,
        references: &[u32],
        values: &mut [MaybeUninit<c_int>],
    ) -> Outcome {
        variables::get_boolean(&mut self.simulation, references, values)
    }

    pub fn set_real(&mut self, references: &[u32], values: &[f64]) -> Outcome {
        let before_start = self.mode.before_start();
        variables::set_real(&mut self.simulation, before_start, references, values)
    }

    pub fn set_integer(&mut self, references: &[u32]) -> Outcome {
        variables::set_integer(&mut self.simulation, self.mode.before_start(), references)
    }

    pub fn set_boolean(&mut self, references: &[u32], values: &[c_int]) -> Outcome {
        let before_start = self.mode.before_start();
        variables::set_boolean(&mut self.simulation, before_start, references, values)
    }

    /// `fmi2GetString` and `fmi2SetString`.
    pub fn strings(&mut self, count: usize) -> Outcome {
        match count {
            0 => Ok(()),
            _ => Err(error("there are no String variables")),
        }
    }

    pub fn set_input_derivatives(
        &mut self,
        references: &[u32],
        orders: &[c_int],
        values: &[f64],
    ) -> Outcome {
        variables::set_input_derivatives(&mut self.simulation, references, orders, values)
    }

    pub fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        direction: &[f64],
        values: &mut [MaybeUninit<f64>],
    ) -> Outcome {
        let simulation = &mut self.simulation;
        variables::directional_derivative(simulation, unknowns, knowns, direction, values)
    }

    pub fn get_output_derivatives(
        &mut self,
        references: &[u32],
        orders: &[c_int],
        values: &mut [MaybeUninit<f64>],
    ) -> Outcome {
        variables::get_output_derivatives(&mut self.simulation, references, orders, values)
    }

    /// The step from `point` to `point + length` \[s\]. Refused with `fmi2Error` where the call is
    /// wrong, with `fmi2Discard` where it is right but the step fails; the state is then as before.
    pub fn do_step(&mut self, point: f64, length: f64) -> Outcome {
        if !(length > 0.0 && length.is_finite()) {
            return Err(error(StepError::Length(length)));
        }
        let time = self.simulation.time();
        let start = self.start_time.unwrap_or(point - time);
        let expected = start + time;
        let round_off = 1e-9 * expected.abs().max(1.0);
        let apart = (point - expected).abs();
        if apart.is_nan() || apart > round_off + 1e-3 * length {
            return Err(error(format!(
                "currentCommunicationPoint is {point}, expected {expected}"
            )));
        }
        let end = point + length;
        if let Some(stop) = self
            .stop_time
            .filter(|stop| end > stop + round_off + 1e-6 * length)
        {
            return Err(error(format!(
                "the step would end at {end}, past the stopTime {stop} of fmi2SetupExperiment"
            )));
        }
        let removed = self.simulation.state().live.removed.len();
        let halvings = self.simulation.halvings();
        let told = self.limits_met();
        let was_inverted = self.simulation.inverted().is_some();
        let slipped = self.slips();
        let outcome = self.simulation.step(length);
        if let Err(e @ (StepError::Length(_) | StepError::TooLong(..))) = outcome {
            return Err(error(e));
        }
        self.start_time = Some(start);
        if let Err(e) = outcome {
            self.mode = Mode::StepDiscarded;
            self.last_time = point;
            self.last_step = Status::Discard;
            return Err(discard(format!(
                "{e}; the state is that of the start of the step"
            )));
        }
        self.mode = Mode::StepComplete;
        self.last_time = end;
        self.last_step = Status::Ok;
        for (now, (before, what)) in self
            .limits_met()
            .into_iter()
            .zip(told.into_iter().zip(LIMITS))
        {
            if now && !before && self.logger.wants(Status::Warning) {
                let line = format!("fmi2DoStep: before {end} s {what}");
                self.logger.log(Status::Warning, &line);
            }
        }
        if let (false, Some(ratio)) = (was_inverted, self.simulation.inverted())
            && self.logger.wants(Status::Warning)
        {
            let line = format!(
                "fmi2DoStep: before {end} s tissue was turned inside out (volume ratio {ratio:.3}); stableNeoHookean brings it back where the tissue has room"
            );
            self.logger.log(Status::Warning, &line);
        }
        self.report(end, removed, halvings);
        self.report_slips(end, slipped);
        Ok(())
    }

    /// Whether each of [`LIMITS`] has been met.
    fn limits_met(&self) -> [bool; 3] {
        [
            self.simulation.spared(),
            self.simulation.has_frameless(),
            self.simulation.lacks_spares(),
        ]
    }

    /// What is worth a line after a step. Its status stays `fmi2OK`, because some hosts take
    /// `fmi2Warning` for a failure.
    /// Halving is told of when its number changes, not every step.
    fn report(&self, time: f64, removed_before: usize, halvings_before: u32) {
        let halvings = self.simulation.halvings();
        if halvings != halvings_before && self.logger.wants(Status::Warning) {
            let line = match halvings {
                0 => format!("fmi2DoStep: in the step to {time} s the substep was whole again"),
                _ => format!(
                    "fmi2DoStep: in the step to {time} s the substep had to be halved {halvings} times to be stable; it was {:.3e} s",
                    self.simulation.substep()
                ),
            };
            self.logger.log(Status::Warning, &line);
        }
        let removed = self.simulation.state().live.removed.len();
        if removed > removed_before && self.logger.wants(Status::Ok) {
            let line = format!(
                "fmi2DoStep: {} tetrahedra removed in the step to {time} s, {removed} in all",
                removed - removed_before
            );
            self.logger.log(Status::Ok, &line);
        }
    }

    /// Which tools' grips slip, a bit each of the first 64.
    fn slips(&self) -> u64 {
        let tools = self.simulation.state().tools.iter().take(64);
        let bits = tools
            .enumerate()
            .map(|(k, tool)| u64::from(tool.slips) << k);
        bits.sum()
    }

    /// A line when a grip begins to slip.
    fn report_slips(&self, time: f64, before: u64) {
        let begun = self.slips() & !before;
        if begun == 0 || !self.logger.wants(Status::Ok) {
            return;
        }
        let tools = &self.simulation.model().scene.tools;
        for (k, tool) in tools.iter().take(64).enumerate() {
            if begun >> k & 1 == 1 {
                let line = format!(
                    "fmi2DoStep: in the step to {time} s tissue began to slip through the grip of {:?}",
                    tool.name
                );
                self.logger.log(Status::Ok, &line);
            }
        }
    }

    /// The status that `fmi2GetStatus` tells of.
    pub fn status(&self, kind: c_int) -> Outcome<Status> {
        match kind {
            types::DO_STEP_STATUS => Ok(self.last_step),
            _ => self.no_status(kind),
        }
    }

    pub fn real_status(&self, kind: c_int) -> Outcome<f64> {
        match kind {
            types::LAST_SUCCESSFUL_TIME => Ok(self.last_time),
            _ => self.no_status(kind),
        }
    }

    /// The slave never asks to end the simulation.
    pub fn boolean_status(&self, kind: c_int) -> Outcome<bool> {
        match kind {
            types::TERMINATED => Ok(false),
            _ => self.no_status(kind),
        }
    }

    pub fn no_status<T>(&self, kind: c_int) -> Outcome<T> {
        let function = match kind {
            types::DO_STEP_STATUS => "fmi2GetStatus tells fmi2DoStepStatus",
            types::PENDING_STATUS => "no step is ever pending",
            types::LAST_SUCCESSFUL_TIME => "fmi2GetRealStatus tells fmi2LastSuccessfulTime",
            types::TERMINATED => "fmi2GetBooleanStatus tells fmi2Terminated",
            _ => return Err(error(format!("there is no fmi2StatusKind {kind}"))),
        };
        Err(discard(format!("not available here: {function}")))
    }

    /// Saves into the state of that address, or into a new one where it is 0. Returns the address.
    pub fn save_state(&mut self, address: usize) -> Outcome<usize> {
        let fixed = variables::fixed_values(&mut self.simulation);
        let model = self.simulation.model();
        if address != 0 {
            let saved = self.saved.get_mut(&address).ok_or_else(foreign)?;
            if Arc::ptr_eq(&saved.model, model) {
                saved.state.copy_from(model, self.simulation.state());
            } else {
                saved.model = model.clone();
                saved.state = self.simulation.save();
            }
            saved.mode = self.mode;
            saved.start_time = self.start_time;
            saved.last_time = self.last_time;
            saved.last_step = self.last_step;
            saved.fixed = fixed;
            return Ok(address);
        }
        let saved = Saved {
            mode: self.mode,
            start_time: self.start_time,
            last_time: self.last_time,
            last_step: self.last_step,
            fixed,
            model: model.clone(),
            state: self.simulation.save(),
        };
        Ok(self.keep(saved))
    }

    fn keep(&mut self, saved: Saved) -> usize {
        let saved = Box::new(saved);
        let address = std::ptr::from_ref(&*saved).addr();
        self.saved.insert(address, saved);
        address
    }

    fn known(&self, address: usize) -> Outcome<&Saved> {
        let saved = self.saved.get(&address).ok_or_else(foreign)?;
        Ok(saved)
    }

    /// Also goes back to the mode in which the state was saved. The stop time stays the host's.
    pub fn restore_state(&mut self, address: usize) -> Outcome {
        let saved = self.saved.get(&address).ok_or_else(foreign)?;
        let same_model = Arc::ptr_eq(&saved.model, self.simulation.model());
        if same_model && !saved.mode.before_start() && !self.mode.before_start() {
            self.simulation.restore(&saved.state);
        } else {
            self.simulation = saved.simulation()?;
        }
        self.mode = saved.mode;
        self.start_time = saved.start_time;
        self.last_time = saved.last_time;
        self.last_step = saved.last_step;
        Ok(())
    }

    /// 0 is fine.
    pub fn free_state(&mut self, address: usize) -> Outcome {
        if address != 0 {
            self.saved.remove(&address).ok_or_else(foreign)?;
        }
        Ok(())
    }

    pub fn state_size(&self, address: usize) -> Outcome<usize> {
        Ok(self.known(address)?.size())
    }

    pub fn serialise(&self, address: usize, bytes: &mut [MaybeUninit<u8>]) -> Outcome {
        let saved = self.known(address)?;
        let needed = saved.size();
        if bytes.len() != needed {
            return Err(error(format!(
                "size is {}; fmi2SerializedFMUstateSize says {needed}",
                bytes.len()
            )));
        }
        for (to, from) in bytes.iter_mut().zip(saved.bytes()) {
            to.write(from);
        }
        Ok(())
    }

    /// Into the state of that address where there is one, else into a new one. Returns the address.
    pub fn deserialise(&mut self, bytes: &[u8], address: usize) -> Outcome<usize> {
        let read = Saved::read(bytes, &self.original, self.simulation.model())?;
        if let Some(saved) = self.saved.get_mut(&address) {
            **saved = read;
            return Ok(address);
        }
        Ok(self.keep(read))
    }

    pub fn is_state(&self, address: usize) -> bool {
        self.saved.contains_key(&address)
    }

    #[cfg(test)]
    pub fn mode(&mut self) -> &mut Mode {
        &mut self.mode
    }

    #[cfg(test)]
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }
}

fn foreign() -> types::Refusal {
    error("FMUstate is not one that this instance has handed out and not freed")
}
