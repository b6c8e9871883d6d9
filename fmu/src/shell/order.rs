//! Which function may be called in which mode: the state machine of FMI 2.0 for co-simulation slaves.
//!
//! Three things are more lenient than the standard asks: variables may be read from instantiation on;
//! after a discarded step inputs may be set and the step tried again; and a call that is refused with
//! `fmi2Error` has changed nothing, not even the mode.

/// Where an instance is in its life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    Instantiated,
    Initialisation,
    StepComplete,
    /// The last step was refused with `fmi2Discard`; the state is that of its start.
    StepDiscarded,
    Terminated,
    /// The model could not be built with the parameters set.
    Error,
    /// A call has panicked.
    Fatal,
}

use Mode::{Error, Fatal, Initialisation, Instantiated, StepComplete, StepDiscarded, Terminated};

/// Modes and how log lines call them.
const MODES: [(Mode, &str); 7] = [
    (Instantiated, "instantiated"),
    (Initialisation, "initialization mode"),
    (StepComplete, "step complete"),
    (StepDiscarded, "step discarded"),
    (Terminated, "terminated"),
    (Error, "error"),
    (Fatal, "fatal"),
];

impl Mode {
    pub fn name(self) -> &'static str {
        MODES[self as usize].1
    }

    pub fn from_code(code: u64) -> Option<Mode> {
        Some(MODES.get(usize::try_from(code).ok()?)?.0)
    }

    /// Whether the model may still be built anew.
    pub fn before_start(self) -> bool {
        matches!(self, Instantiated | Initialisation)
    }
}

/// Functions that take an instance, all but `fmi2FreeInstance`, which is always legal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Function {
    SetDebugLogging,
    SetupExperiment,
    EnterInitializationMode,
    ExitInitializationMode,
    Terminate,
    Reset,
    GetReal,
    GetInteger,
    GetBoolean,
    GetString,
    SetReal,
    SetInteger,
    SetBoolean,
    SetString,
    GetFmuState,
    SetFmuState,
    FreeFmuState,
    SerializedFmuStateSize,
    SerializeFmuState,
    DeSerializeFmuState,
    GetDirectionalDerivative,
    SetRealInputDerivatives,
    GetRealOutputDerivatives,
    DoStep,
    CancelStep,
    GetStatus,
    GetRealStatus,
    GetIntegerStatus,
    GetBooleanStatus,
    GetStringStatus,
}

const ALIVE: &[Mode] = &[
    Instantiated,
    Initialisation,
    StepComplete,
    StepDiscarded,
    Terminated,
    Error,
];
const SETTABLE: &[Mode] = &[Instantiated, Initialisation, StepComplete, StepDiscarded];
const STEPPING: &[Mode] = &[StepComplete, StepDiscarded];
const STARTED: &[Mode] = &[StepComplete, StepDiscarded, Terminated, Error];
const STEPPED: &[Mode] = &[StepComplete, StepDiscarded, Terminated];
const INITIALISED: &[Mode] = &[
    Initialisation,
    StepComplete,
    StepDiscarded,
    Terminated,
    Error,
];

/// The table: function, name, modes.
pub const ORDER: [(Function, &str, &[Mode]); 30] = {
    use Function as F;
    [
        (F::SetDebugLogging, "fmi2SetDebugLogging", ALIVE),
        (F::SetupExperiment, "fmi2SetupExperiment", &[Instantiated]),
        (
            F::EnterInitializationMode,
            "fmi2EnterInitializationMode",
            &[Instantiated],
        ),
        (
            F::ExitInitializationMode,
            "fmi2ExitInitializationMode",
            &[Initialisation],
        ),
        (F::Terminate, "fmi2Terminate", STEPPING),
        (F::Reset, "fmi2Reset", ALIVE),
        (F::GetReal, "fmi2GetReal", ALIVE),
        (F::GetInteger, "fmi2GetInteger", ALIVE),
        (F::GetBoolean, "fmi2GetBoolean", ALIVE),
        (F::GetString, "fmi2GetString", ALIVE),
        (F::SetReal, "fmi2SetReal", SETTABLE),
        (F::SetInteger, "fmi2SetInteger", SETTABLE),
        (F::SetBoolean, "fmi2SetBoolean", SETTABLE),
        (F::SetString, "fmi2SetString", SETTABLE),
        (F::GetFmuState, "fmi2GetFMUstate", ALIVE),
        (F::SetFmuState, "fmi2SetFMUstate", ALIVE),
        (F::FreeFmuState, "fmi2FreeFMUstate", ALIVE),
        (
            F::SerializedFmuStateSize,
            "fmi2SerializedFMUstateSize",
            ALIVE,
        ),
        (F::SerializeFmuState, "fmi2SerializeFMUstate", ALIVE),
        (F::DeSerializeFmuState, "fmi2DeSerializeFMUstate", ALIVE),
        (
            F::GetDirectionalDerivative,
            "fmi2GetDirectionalDerivative",
            INITIALISED,
        ),
        (
            F::SetRealInputDerivatives,
            "fmi2SetRealInputDerivatives",
            SETTABLE,
        ),
        (
            F::GetRealOutputDerivatives,
            "fmi2GetRealOutputDerivatives",
            STARTED,
        ),
        (F::DoStep, "fmi2DoStep", STEPPING),
        (F::CancelStep, "fmi2CancelStep", &[]),
        (F::GetStatus, "fmi2GetStatus", STEPPED),
        (F::GetRealStatus, "fmi2GetRealStatus", STEPPED),
        (F::GetIntegerStatus, "fmi2GetIntegerStatus", STEPPED),
        (F::GetBooleanStatus, "fmi2GetBooleanStatus", STEPPED),
        (F::GetStringStatus, "fmi2GetStringStatus", STEPPED),
    ]
};

impl Function {
    pub fn name(self) -> &'static str {
        ORDER[self as usize].1
    }

    /// The error says where the function is legal.
    pub fn check(self, mode: Mode) -> Result<(), String> {
        let legal = ORDER[self as usize].2;
        if legal.contains(&mode) {
            return Ok(());
        }
        let list: Vec<&str> = legal.iter().map(|m| m.name()).collect();
        let list = match list.as_slice() {
            [] => "while a step is pending, and no step ever is".into(),
            list => format!("in: {}", list.join(", ")),
        };
        Err(format!(
            "may not be called now (mode: {}); it is legal {list}",
            mode.name()
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_are_in_the_order_of_their_enums() {
        for (k, (function, name, _)) in ORDER.iter().enumerate() {
            assert_eq!(*function as usize, k);
            assert_eq!(
                name.to_lowercase(),
                format!("fmi2{function:?}").to_lowercase()
            );
        }
        for (k, (mode, _)) in MODES.iter().enumerate() {
            assert_eq!(*mode as usize, k);
            assert_eq!(Mode::from_code(k as u64), Some(*mode));
        }
        assert_eq!(Mode::from_code(7), None);
    }

    #[test]
    fn a_refusal_says_where_the_function_is_legal() {
        let message = Function::DoStep.check(Mode::Instantiated).unwrap_err();
        assert!(
            message.contains("instantiated") && message.contains("step complete"),
            "{message}"
        );
        assert!(Function::CancelStep.check(Mode::StepComplete).is_err());
        assert!(
            ORDER
                .iter()
                .all(|(function, ..)| function.check(Mode::Fatal).is_err())
        );
    }
}
