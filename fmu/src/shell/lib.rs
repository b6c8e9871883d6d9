//! FMI 2.0 for co-simulation: the C functions of the FMU.
//!
//! This file holds all that is unsafe: pointers are checked and become slices, then `instance` does
//! the work. No function unwinds into the host: a panic is `fmi2Fatal` and one log line.
//!
//! # Safety
//! As the standard has it: pointers are null or point to as many values as the call says; a component
//! is one that `fmi2Instantiate` returned and `fmi2FreeInstance` has not taken. Null, foreign and freed
//! components are refused as far as a number at their head can tell.
#![allow(non_snake_case, clippy::missing_safety_doc, clippy::too_many_arguments)]

mod instance;
mod log;
mod order;
mod saved;
#[cfg(test)]
mod tests;
mod types;
mod uri;
mod variables;

use std::any::Any;
use std::cell::UnsafeCell;
use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::mem::MaybeUninit;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;
use std::sync::atomic::{AtomicBool, Ordering};

use instance::{Instance, Request};
use log::{Logger, Sink};
use order::Function;
use types::{CallbackFunctions, Outcome, Status, error};

const MAGIC: u64 = 0x7469_7373_7565_464d;

/// What an `fmi2Component` points to.
#[repr(C)]
struct Component {
    magic: u64,
    /// Set while a call runs: one from inside the logger, or from another thread, is refused.
    busy: AtomicBool,
    instance: UnsafeCell<Instance>,
}

unsafe fn component<'a>(c: *mut c_void) -> Option<&'a Component> {
    let pointer = c.cast::<Component>();
    if pointer.is_null() || !pointer.is_aligned() {
        return None;
    }
    let magic = unsafe { pointer.cast::<u64>().read_volatile() };
    (magic == MAGIC).then(|| unsafe { &*pointer })
}

/// Every call on an instance comes through here.
unsafe fn enter(
    c: *mut c_void,
    function: Function,
    action: impl FnOnce(&mut Instance) -> Outcome,
) -> c_int {
    let Some(component) = (unsafe { component(c) }) else {
        return Status::Error.code();
    };
    if component.busy.swap(true, Ordering::Acquire) {
        return Status::Error.code();
    }
    let instance = unsafe { &mut *component.instance.get() };
    let status = catch_unwind(AssertUnwindSafe(|| instance.call(function, action))).unwrap_or_else(
        |panic| {
            instance.lose(function, reason(&*panic));
            Status::Fatal
        },
    );
    component.busy.store(false, Ordering::Release);
    status.code()
}

fn reason(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("unknown")
}

/// `count` values to be read; null is fine for none.
unsafe fn list<'a, T>(pointer: *const T, count: usize, name: &str) -> Outcome<&'a [T]> {
    if count == 0 {
        return Ok(&[]);
    }
    usable(pointer, count, name)?;
    Ok(unsafe { std::slice::from_raw_parts(pointer, count) })
}

/// `count` values to be written; null is fine for none.
unsafe fn room<'a, T>(
    pointer: *mut T,
    count: usize,
    name: &str,
) -> Outcome<&'a mut [MaybeUninit<T>]> {
    if count == 0 {
        return Ok(&mut []);
    }
    usable(pointer, count, name)?;
    Ok(unsafe { std::slice::from_raw_parts_mut(pointer.cast(), count) })
}

/// One value to be written.
unsafe fn place<'a, T>(pointer: *mut T, name: &str) -> Outcome<&'a mut MaybeUninit<T>> {
    usable(pointer, 1, name)?;
    Ok(unsafe { &mut *pointer.cast() })
}

fn usable<T>(pointer: *const T, count: usize, name: &str) -> Outcome {
    if pointer.is_null() {
        return Err(error(format!(
            "{name} is null; it must hold {count} values"
        )));
    }
    if !pointer.is_aligned() || count > isize::MAX as usize / size_of::<T>() {
        return Err(error(format!(
            "{name} cannot hold {count} values of its type"
        )));
    }
    Ok(())
}

unsafe fn text<'a>(pointer: *const c_char) -> Option<&'a CStr> {
    (!pointer.is_null()).then(|| unsafe { CStr::from_ptr(pointer) })
}

fn sink(callbacks: &CallbackFunctions, name: Option<&CStr>) -> Option<Sink> {
    let logger = callbacks.logger?;
    let environment = callbacks.environment;
    let name = name.unwrap_or_default().to_owned();
    Some(Box::new(move |status, category, message| unsafe {
        logger(
            environment,
            name.as_ptr(),
            status.code(),
            category.as_ptr(),
            message.as_ptr(),
        );
    }))
}

#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetTypesPlatform() -> *const c_char {
    c"default".as_ptr()
}

#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetVersion() -> *const c_char {
    c"2.0".as_ptr()
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Instantiate(
    instanceName: *const c_char,
    fmuType: c_int,
    fmuGUID: *const c_char,
    fmuResourceLocation: *const c_char,
    functions: *const CallbackFunctions,
    _visible: c_int,
    loggingOn: c_int,
) -> *mut c_void {
    if functions.is_null() || !functions.is_aligned() {
        return ptr::null_mut();
    }
    // A copy: the host's may be gone when this returns.
    let callbacks = unsafe { functions.read() };
    let request = unsafe {
        Request {
            name: text(instanceName),
            kind: fmuType,
            guid: text(fmuGUID),
            location: text(fmuResourceLocation),
        }
    };
    let logger = Logger::new(sink(&callbacks, request.name), loggingOn != 0);
    match catch_unwind(AssertUnwindSafe(|| instance::load(&request, &logger))) {
        Ok(Ok(simulation)) => Box::into_raw(Box::new(Component {
            magic: MAGIC,
            busy: AtomicBool::new(false),
            instance: UnsafeCell::new(Instance::new(simulation, logger)),
        }))
        .cast(),
        Ok(Err(refusal)) => {
            logger.log(
                refusal.status,
                &format!("fmi2Instantiate: {}", refusal.message),
            );
            ptr::null_mut()
        }
        Err(panic) => {
            let line = format!("fmi2Instantiate: internal error: {}", reason(&*panic));
            logger.log(Status::Error, &line);
            ptr::null_mut()
        }
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeInstance(c: *mut c_void) {
    let Some(component) = (unsafe { component(c) }) else {
        return;
    };
    if component.busy.swap(true, Ordering::Acquire) {
        return;
    }
    let pointer = c.cast::<Component>();
    unsafe { pointer.cast::<u64>().write_volatile(0) };
    let component = unsafe { Box::from_raw(pointer) };
    // Nothing in here is known to panic; if it did, the host must not see it.
    let _ = catch_unwind(AssertUnwindSafe(|| drop(component)));
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetDebugLogging(
    c: *mut c_void,
    loggingOn: c_int,
    nCategories: usize,
    categories: *const *const c_char,
) -> c_int {
    unsafe {
        enter(c, Function::SetDebugLogging, |instance| {
            let names: Option<Vec<&CStr>> = list(categories, nCategories, "categories")?
                .iter()
                .map(|name| text(*name))
                .collect();
            let names = names.ok_or_else(|| error("a category is null"))?;
            instance.set_debug_logging(loggingOn != 0, &names)
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetupExperiment(
    c: *mut c_void,
    _toleranceDefined: c_int,
    _tolerance: f64,
    startTime: f64,
    stopTimeDefined: c_int,
    stopTime: f64,
) -> c_int {
    unsafe {
        enter(c, Function::SetupExperiment, |instance| {
            instance.setup_experiment(startTime, (stopTimeDefined != 0).then_some(stopTime))
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2EnterInitializationMode(c: *mut c_void) -> c_int {
    unsafe {
        enter(
            c,
            Function::EnterInitializationMode,
            Instance::enter_initialisation,
        )
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2ExitInitializationMode(c: *mut c_void) -> c_int {
    unsafe {
        enter(
            c,
            Function::ExitInitializationMode,
            Instance::exit_initialisation,
        )
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Terminate(c: *mut c_void) -> c_int {
    unsafe { enter(c, Function::Terminate, Instance::terminate) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Reset(c: *mut c_void) -> c_int {
    unsafe { enter(c, Function::Reset, Instance::reset) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetReal(
    c: *mut c_void,
    vr: *const c_uint,
    nvr: usize,
    value: *mut f64,
) -> c_int {
    unsafe {
        enter(c, Function::GetReal, |instance| {
            instance.get_real(list(vr, nvr, "vr")?, room(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetInteger(
    c: *mut c_void,
    vr: *const c_uint,
    nvr: usize,
    value: *mut c_int,
) -> c_int {
    unsafe {
        enter(c, Function::GetInteger, |instance| {
            instance.get_integer(list(vr, nvr, "vr")?, room(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetBoolean(
    c: *mut c_void,
    vr: *const c_uint,
    nvr: usize,
    value: *mut c_int,
) -> c_int {
    unsafe {
        enter(c, Function::GetBoolean, |instance| {
            instance.get_boolean(list(vr, nvr, "vr")?, room(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetString(
    c: *mut c_void,
    _vr: *const c_uint,
    nvr: usize,
    _value: *mut *const c_char,
) -> c_int {
    unsafe { enter(c, Function::GetString, |instance| instance.strings(nvr)) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetReal(
    c: *mut c_void,
    vr: *const c_uint,
    nvr: usize,
    value: *const f64,
) -> c_int {
    unsafe {
        enter(c, Function::SetReal, |instance| {
            instance.set_real(list(vr, nvr, "vr")?, list(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetInteger(
    c: *mut c_void,
    vr: *const c_uint,
    nvr: usize,
    value: *const c_int,
) -> c_int {
    unsafe {
        enter(c, Function::SetInteger, |instance| {
            list(value, nvr, "value")?;
            instance.set_integer(list(vr, nvr, "vr")?)
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetBoolean(
    c: *mut c_void,
    vr: *const c_uint,
    nvr: usize,
    value: *const c_int,
) -> c_int {
    unsafe {
        enter(c, Function::SetBoolean, |instance| {
            instance.set_boolean(list(vr, nvr, "vr")?, list(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetString(
    c: *mut c_void,
    _vr: *const c_uint,
    nvr: usize,
    _value: *const *const c_char,
) -> c_int {
    unsafe { enter(c, Function::SetString, |instance| instance.strings(nvr)) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetFMUstate(c: *mut c_void, FMUstate: *mut *mut c_void) -> c_int {
    unsafe {
        enter(c, Function::GetFmuState, |instance| {
            usable(FMUstate, 1, "FMUstate")?;
            let address = instance.save_state((*FMUstate).addr())?;
            *FMUstate = ptr::without_provenance_mut(address);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetFMUstate(c: *mut c_void, FMUstate: *mut c_void) -> c_int {
    unsafe {
        enter(c, Function::SetFmuState, |instance| {
            instance.restore_state(FMUstate.addr())
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeFMUstate(c: *mut c_void, FMUstate: *mut *mut c_void) -> c_int {
    unsafe {
        enter(c, Function::FreeFmuState, |instance| {
            if FMUstate.is_null() {
                return Ok(());
            }
            usable(FMUstate, 1, "FMUstate")?;
            instance.free_state((*FMUstate).addr())?;
            *FMUstate = ptr::null_mut();
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SerializedFMUstateSize(
    c: *mut c_void,
    FMUstate: *mut c_void,
    size: *mut usize,
) -> c_int {
    unsafe {
        enter(c, Function::SerializedFmuStateSize, |instance| {
            place(size, "size")?.write(instance.state_size(FMUstate.addr())?);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SerializeFMUstate(
    c: *mut c_void,
    FMUstate: *mut c_void,
    serializedState: *mut c_char,
    size: usize,
) -> c_int {
    unsafe {
        enter(c, Function::SerializeFmuState, |instance| {
            let bytes = room(serializedState.cast::<u8>(), size, "serializedState")?;
            instance.serialise(FMUstate.addr(), bytes)
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2DeSerializeFMUstate(
    c: *mut c_void,
    serializedState: *const c_char,
    size: usize,
    FMUstate: *mut *mut c_void,
) -> c_int {
    unsafe {
        enter(c, Function::DeSerializeFmuState, |instance| {
            usable(FMUstate, 1, "FMUstate")?;
            let before = (*FMUstate).addr();
            if !instance.is_state(before) {
                *FMUstate = ptr::null_mut();
            }
            let bytes = list(serializedState.cast::<u8>(), size, "serializedState")?;
            let address = instance.deserialise(bytes, before)?;
            *FMUstate = ptr::without_provenance_mut(address);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetDirectionalDerivative(
    c: *mut c_void,
    vUnknown_ref: *const c_uint,
    nUnknown: usize,
    vKnown_ref: *const c_uint,
    nKnown: usize,
    dvKnown: *const f64,
    dvUnknown: *mut f64,
) -> c_int {
    unsafe {
        enter(c, Function::GetDirectionalDerivative, |instance| {
            instance.directional_derivative(
                list(vUnknown_ref, nUnknown, "vUnknown_ref")?,
                list(vKnown_ref, nKnown, "vKnown_ref")?,
                list(dvKnown, nKnown, "dvKnown")?,
                room(dvUnknown, nUnknown, "dvUnknown")?,
            )
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetRealInputDerivatives(
    c: *mut c_void,
    vr: *const c_uint,
    nvr: usize,
    order: *const c_int,
    value: *const f64,
) -> c_int {
    unsafe {
        enter(c, Function::SetRealInputDerivatives, |instance| {
            instance.set_input_derivatives(
                list(vr, nvr, "vr")?,
                list(order, nvr, "order")?,
                list(value, nvr, "value")?,
            )
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetRealOutputDerivatives(
    c: *mut c_void,
    vr: *const c_uint,
    nvr: usize,
    order: *const c_int,
    value: *mut f64,
) -> c_int {
    unsafe {
        enter(c, Function::GetRealOutputDerivatives, |instance| {
            instance.get_output_derivatives(
                list(vr, nvr, "vr")?,
                list(order, nvr, "order")?,
                room(value, nvr, "value")?,
            )
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2DoStep(
    c: *mut c_void,
    currentCommunicationPoint: f64,
    communicationStepSize: f64,
    _noSetFMUStatePriorToCurrentPoint: c_int,
) -> c_int {
    unsafe {
        enter(c, Function::DoStep, |instance| {
            instance.do_step(currentCommunicationPoint, communicationStepSize)
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2CancelStep(c: *mut c_void) -> c_int {
    unsafe { enter(c, Function::CancelStep, |_| Ok(())) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetStatus(c: *mut c_void, s: c_int, value: *mut c_int) -> c_int {
    unsafe {
        enter(c, Function::GetStatus, |instance| {
            place(value, "value")?.write(instance.status(s)?.code());
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetRealStatus(c: *mut c_void, s: c_int, value: *mut f64) -> c_int {
    unsafe {
        enter(c, Function::GetRealStatus, |instance| {
            place(value, "value")?.write(instance.real_status(s)?);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetIntegerStatus(
    c: *mut c_void,
    s: c_int,
    value: *mut c_int,
) -> c_int {
    unsafe {
        enter(c, Function::GetIntegerStatus, |instance| {
            usable(value, 1, "value")?;
            instance.no_status(s)
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetBooleanStatus(
    c: *mut c_void,
    s: c_int,
    value: *mut c_int,
) -> c_int {
    unsafe {
        enter(c, Function::GetBooleanStatus, |instance| {
            place(value, "value")?.write(instance.boolean_status(s)?.into());
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetStringStatus(
    c: *mut c_void,
    s: c_int,
    value: *mut *const c_char,
) -> c_int {
    unsafe {
        enter(c, Function::GetStringStatus, |instance| {
            usable(value, 1, "value")?;
            instance.no_status(s)
        })
    }
}
