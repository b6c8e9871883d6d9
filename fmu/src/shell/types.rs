//! C types of FMI 2.0 and its status codes. Enumerations cross the boundary as `c_int`, because a
//! number that a Rust enum does not know would be undefined behaviour.

use std::ffi::{c_char, c_int, c_void};

/// `fmi2CallbackLogger`: environment, instance name, status, category, message and its arguments.
pub type LogCallback =
    unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);

/// `fmi2CallbackFunctions`. A host may pass any of them as null.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct CallbackFunctions {
    pub logger: Option<LogCallback>,
    pub allocate_memory: Option<unsafe extern "C" fn(usize, usize) -> *mut c_void>,
    pub free_memory: Option<unsafe extern "C" fn(*mut c_void)>,
    pub step_finished: Option<unsafe extern "C" fn(*mut c_void, c_int)>,
    pub environment: *mut c_void,
}

/// `fmi2Type` of a slave.
pub const CO_SIMULATION: c_int = 1;

/// `fmi2StatusKind`: how the last step ended.
pub const DO_STEP_STATUS: c_int = 0;
/// `fmi2StatusKind`: what a pending step waits for. None is ever pending here.
pub const PENDING_STATUS: c_int = 1;
/// `fmi2StatusKind`: time up to which the last step got \[s\].
pub const LAST_SUCCESSFUL_TIME: c_int = 2;
/// `fmi2StatusKind`: whether the slave wants to end the simulation.
pub const TERMINATED: c_int = 3;

/// `fmi2Status`, without `fmi2Pending`: no step is asynchronous.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    Ok = 0,
    Warning = 1,
    Discard = 2,
    Error = 3,
    Fatal = 4,
}

impl Status {
    pub fn code(self) -> c_int {
        self as c_int
    }

    pub fn from_code(code: u64) -> Option<Status> {
        use Status::{Discard, Error, Fatal, Ok, Warning};
        [Ok, Warning, Discard, Error, Fatal]
            .into_iter()
            .find(|s| *s as u64 == code)
    }
}

/// Why a call was refused; it has changed nothing. Becomes one log line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    pub status: Status,
    pub message: String,
}

/// What a call comes to.
pub type Outcome<T = ()> = Result<T, Refusal>;

/// The call was wrong.
pub fn error(message: impl ToString) -> Refusal {
    Refusal {
        status: Status::Error,
        message: message.to_string(),
    }
}

/// The call was right, but a value or a step in it cannot be taken.
pub fn discard(message: impl ToString) -> Refusal {
    Refusal {
        status: Status::Discard,
        message: message.to_string(),
    }
}
