//! An FMU driven through its C interface, by fmi-rs.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use fmi_rs::fmi2::builder::FMU2Builder;
use fmi_rs::fmi2::types::fmi2Status;
use fmi_rs::fmi2::{CS, FMU2};
use fmi_rs::model_description::fmi2::{Causality, VariableType};

use crate::error::Error;

/// Type of a variable, as far as it matters to a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Real,
    Integer,
    Boolean,
}

/// One variable of the FMU.
#[derive(Clone, Debug)]
pub struct Variable {
    pub name: String,
    pub reference: u32,
    pub kind: Kind,
    pub is_input: bool,
    pub is_output: bool,
}

/// A loaded FMU with one running instance.
pub struct Host {
    // Before the builder, whose drop removes the unpacked files.
    instance: Arc<FMU2<CS>>,
    builder: FMU2Builder,
    variables: Vec<Variable>,
    by_name: HashMap<String, usize>,
    time: f64,
}

impl Host {
    /// Unpacks, checks, instantiates and initialises.
    pub fn start(path: &Path) -> Result<Host, Error> {
        let wrong = |text: String| Error::Content(path.to_path_buf(), text);
        let builder = FMU2Builder::new(&path)
            .map_err(|e| wrong(format!("is no FMU that loads: {e}")))?
            .loggingOn(false);
        let problems = builder.model_description.validate();
        if let Some(first) = problems.first() {
            return Err(wrong(format!("its description is not valid: {first:?}")));
        }
        let instance = builder
            .instantiate_cs("tissue")
            .map_err(|e| wrong(format!("cannot be instantiated: {e}")))?;
        let mut variables = Vec::new();
        for v in &builder.model_description.modelVariables {
            let kind = match v.variableType {
                VariableType::Real { .. } => Kind::Real,
                VariableType::Boolean { .. } => Kind::Boolean,
                _ => Kind::Integer,
            };
            variables.push(Variable {
                name: v.name.clone(),
                reference: v.valueReference,
                kind,
                is_input: v.causality == Causality::Input,
                is_output: v.causality == Causality::Output,
            });
        }
        let by_name = variables
            .iter()
            .enumerate()
            .map(|(k, v)| (v.name.clone(), k))
            .collect();
        let host = Host {
            instance,
            builder,
            variables,
            by_name,
            time: 0.0,
        };
        host.check(
            "fmi2SetupExperiment",
            host.instance.setupExperiment(None, 0.0, None),
        )?;
        host.check(
            "fmi2EnterInitializationMode",
            host.instance.enterInitializationMode(),
        )?;
        Ok(host)
    }

    /// Ends initialisation, in which inputs may be set.
    pub fn initialised(&mut self) -> Result<(), Error> {
        self.check(
            "fmi2ExitInitializationMode",
            self.instance.exitInitializationMode(),
        )
    }

    pub fn variables(&self) -> &[Variable] {
        &self.variables
    }

    pub fn variable(&self, name: &str) -> Option<&Variable> {
        self.by_name.get(name).map(|k| &self.variables[*k])
    }

    /// Communication step of the default experiment \[s\].
    pub fn default_step(&self) -> f64 {
        let experiment = self.builder.model_description.defaultExperiment.as_ref();
        experiment
            .and_then(|e| e.stepSize.as_ref())
            .and_then(|s| s.parse().ok())
            .filter(|s: &f64| *s > 0.0)
            .unwrap_or(1e-3)
    }

    /// \[s\]
    pub fn time(&self) -> f64 {
        self.time
    }

    pub fn set(&self, variable: &Variable, value: f64) -> Result<(), Error> {
        let reference = [variable.reference];
        let status = match variable.kind {
            Kind::Real => self.instance.setReal(&reference, &[value]),
            Kind::Boolean => self
                .instance
                .setBoolean(&reference, &[i32::from(value != 0.0)]),
            Kind::Integer => self.instance.setInteger(&reference, &[value as i32]),
        };
        self.check_with(|| format!("setting {} to {value}", variable.name), status)
    }

    pub fn reals(&self, references: &[u32], values: &mut [f64]) -> Result<(), Error> {
        self.check("fmi2GetReal", self.instance.getReal(references, values))
    }

    pub fn integers(&self, references: &[u32], values: &mut [i32]) -> Result<(), Error> {
        self.check(
            "fmi2GetInteger",
            self.instance.getInteger(references, values),
        )
    }

    pub fn booleans(&self, references: &[u32], values: &mut [i32]) -> Result<(), Error> {
        self.check(
            "fmi2GetBoolean",
            self.instance.getBoolean(references, values),
        )
    }

    /// One communication step to `end` \[s\].
    pub fn step_to(&mut self, end: f64) -> Result<(), Error> {
        let status = self.instance.doStep(self.time, end - self.time, 1);
        self.check_with(|| format!("the step at {} s", self.time), status)?;
        self.time = end;
        Ok(())
    }

    pub fn finish(self) -> Result<(), Error> {
        self.check("fmi2Terminate", self.instance.terminate())
    }

    fn check(&self, what: &str, status: fmi2Status) -> Result<(), Error> {
        self.check_with(|| what.to_string(), status)
    }

    /// Names what was done only where it failed: steps are timed.
    fn check_with(&self, what: impl FnOnce() -> String, status: fmi2Status) -> Result<(), Error> {
        match status {
            fmi2Status::Ok | fmi2Status::Warning => Ok(()),
            other => Err(Error::Simulation(format!(
                "{} failed ({other:?}); see the FMU's log lines above",
                what()
            ))),
        }
    }
}
