//! The C functions as a host calls them.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::ptr::{null, null_mut};
use std::sync::Mutex;

use model_description::{TABLE, Value, count, exists, reference};
use tissue::model::Model;
use tissue::prepared;

use crate::instance::Instance;
use crate::order::{Function, Mode, ORDER};
use crate::types::{CO_SIMULATION, CallbackFunctions, LogCallback};
use crate::*;

const OK: c_int = 0;
const DISCARD: c_int = 2;
const ERROR: c_int = 3;
const FATAL: c_int = 4;

/// Communication step \[s\].
const H: f64 = 1e-3;

/// A soft beam, held at x = 0, under a probe, a cautery and a grasper.
const SCENE: &str = r#"{
    "name": "beam",
    "mesh": {"box": {"size": [0.1, 0.02, 0.02], "cells": [5, 2, 2]}},
    "materials": [{"where": {"all": true}, "youngModulus": 20000, "poissonRatio": 0.4, "density": 1000}],
    "fixed": [{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}],
    "tools": [
        {"name": "probe", "kind": "probe", "shape": {"sphere": {"radius": 0.008}},
         "position": [0.05, 0.01, 0.035]},
        {"name": "cautery", "kind": "cautery", "shape": {"capsule": {"radius": 0.003, "length": 0.1}},
         "activeLength": 0.01, "position": [0.085, 0.01, 0.04], "orientation": [0, 1, 0, 0]},
        {"name": "grasper", "kind": "grasper", "shape": {"capsule": {"radius": 0.004, "length": 0.1}},
         "activeLength": 0.01, "position": [0.02, 0.01, 0.022], "orientation": [0, 1, 0, 0]}
    ],
    "outputs": {"triangles": true}
}"#;

/// Status, category, message.
type Line = (c_int, String, String);

/// What the host's `componentEnvironment` points to.
#[derive(Default)]
struct Log {
    lines: Mutex<Vec<Line>>,
    /// To be called back from inside the logger.
    component: Mutex<usize>,
}

extern "C" fn record(
    environment: *mut c_void,
    _name: *const c_char,
    status: c_int,
    category: *const c_char,
    message: *const c_char,
) {
    let text = |p| unsafe { CStr::from_ptr(p) }.to_string_lossy().into_owned();
    let log = unsafe { &*environment.cast::<Log>() };
    log.lines
        .lock()
        .unwrap()
        .push((status, text(category), text(message)));
    let component = *log.component.lock().unwrap();
    if component != 0 {
        let c = std::ptr::with_exposed_provenance_mut(component);
        assert_eq!(unsafe { fmi2Terminate(c) }, ERROR);
        unsafe { fmi2FreeInstance(c) };
    }
}

fn callbacks(log: &Log) -> CallbackFunctions {
    // Passed its five arguments, a variadic function is called as one that has just those.
    let logger = unsafe {
        std::mem::transmute::<
            extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char),
            LogCallback,
        >(record)
    };
    CallbackFunctions {
        logger: Some(logger),
        allocate_memory: None,
        free_memory: None,
        step_finished: None,
        environment: std::ptr::from_ref(log).cast_mut().cast(),
    }
}

/// Writes the scene's resources; returns the model.
fn write_resources(folder: &Path) -> Model {
    let scene = tissue::scene::parse(SCENE, "beam.json").unwrap();
    let model = prepared::prepare(scene, Path::new("beam.json")).unwrap();
    std::fs::create_dir_all(folder).unwrap();
    for (name, bytes) in prepared::resources(&model).unwrap() {
        std::fs::write(folder.join(name), bytes).unwrap();
    }
    model
}

fn uri(folder: &Path) -> String {
    url::Url::from_directory_path(folder).unwrap().to_string()
}

/// Resources in a folder of their own.
struct Unpacked {
    _dir: tempfile::TempDir,
    folder: PathBuf,
    model: Model,
}

impl Unpacked {
    fn new() -> Unpacked {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("resources");
        let model = write_resources(&folder);
        Unpacked {
            _dir: dir,
            folder,
            model,
        }
    }

    fn host(&self) -> Host<'_> {
        let log = Box::<Log>::default();
        let guid = model_description::guid(&self.model);
        let c = instantiate(&log, "a", CO_SIMULATION, &guid, &uri(&self.folder), true);
        assert!(!c.is_null(), "{:?}", log.lines);
        Host {
            c,
            log,
            model: &self.model,
            steps: 0,
        }
    }

    /// Up to the first step.
    fn started(&self) -> Host<'_> {
        let host = self.host();
        host.start();
        host
    }
}

fn instantiate(
    log: &Log,
    name: &str,
    kind: c_int,
    guid: &str,
    location: &str,
    on: bool,
) -> *mut c_void {
    let [name, guid, location] = [name, guid, location].map(|s| CString::new(s).unwrap());
    let callbacks = callbacks(log);
    unsafe {
        fmi2Instantiate(
            name.as_ptr(),
            kind,
            guid.as_ptr(),
            location.as_ptr(),
            &callbacks,
            0,
            on.into(),
        )
    }
}

/// An instance and who drives it.
struct Host<'a> {
    c: *mut c_void,
    log: Box<Log>,
    model: &'a Model,
    steps: u32,
}

impl Drop for Host<'_> {
    fn drop(&mut self) {
        unsafe { fmi2FreeInstance(self.c) }
    }
}

impl Host<'_> {
    fn start(&self) {
        unsafe {
            assert_eq!(fmi2SetupExperiment(self.c, 0, 0.0, 0.0, 0, 0.0), OK);
            assert_eq!(fmi2EnterInitializationMode(self.c), OK);
            assert_eq!(
                fmi2ExitInitializationMode(self.c),
                OK,
                "{:?}",
                self.log.lines
            );
        }
    }

    fn instance(&mut self) -> &mut Instance {
        unsafe { (*self.c.cast::<Component>()).instance.get_mut() }
    }

    /// Lines since the last time.
    fn lines(&self) -> Vec<Line> {
        std::mem::take(&mut self.log.lines.lock().unwrap())
    }

    /// The one line since the last time; it must name `what`.
    fn complaint(&self, category: &str, what: &str) {
        let lines = self.lines();
        assert_eq!(lines.len(), 1, "{lines:?}");
        assert_eq!(lines[0].1, category, "{lines:?}");
        assert!(lines[0].2.contains(what), "{lines:?} lacks {what}");
    }

    fn reference(&self, name: &str) -> u32 {
        for row in TABLE.iter().filter(|row| exists(row, self.model)) {
            for item in 0..count(row.group, self.model) {
                for (k, component) in row.components.iter().enumerate() {
                    if row.name.replace('#', &(item + 1).to_string()) + component == name {
                        return reference(row, item, k);
                    }
                }
            }
        }
        panic!("no variable {name}")
    }

    fn references(&self, names: &[&str]) -> Vec<u32> {
        names.iter().map(|name| self.reference(name)).collect()
    }

    fn try_real(&self, names: &[&str], values: &[f64]) -> c_int {
        let vr = self.references(names);
        unsafe { fmi2SetReal(self.c, vr.as_ptr(), vr.len(), values.as_ptr()) }
    }

    fn set_real(&self, name: &str, value: f64) {
        assert_eq!(self.try_real(&[name], &[value]), OK, "{:?}", self.lines());
    }

    fn set_boolean(&self, name: &str, value: bool) {
        let (vr, value) = (self.reference(name), c_int::from(value));
        assert_eq!(unsafe { fmi2SetBoolean(self.c, &vr, 1, &value) }, OK);
    }

    fn real(&self, name: &str) -> f64 {
        let (vr, mut value) = (self.reference(name), f64::NAN);
        assert_eq!(unsafe { fmi2GetReal(self.c, &vr, 1, &mut value) }, OK);
        value
    }

    fn integer(&self, name: &str) -> c_int {
        let (vr, mut value) = (self.reference(name), -7);
        assert_eq!(unsafe { fmi2GetInteger(self.c, &vr, 1, &mut value) }, OK);
        value
    }

    fn boolean(&self, name: &str) -> c_int {
        let (vr, mut value) = (self.reference(name), -7);
        assert_eq!(unsafe { fmi2GetBoolean(self.c, &vr, 1, &mut value) }, OK);
        value
    }

    fn time(&self) -> f64 {
        f64::from(self.steps) * H
    }

    fn try_step(&self) -> c_int {
        unsafe { fmi2DoStep(self.c, self.time(), H, 1) }
    }

    fn step(&mut self) {
        assert_eq!(self.try_step(), OK, "{:?}", self.lines());
        self.steps += 1;
    }

    /// The probe presses and lets go, the cautery burns off the end, the grasper pulls.
    fn drive(&mut self, steps: u32) {
        for _ in 0..steps {
            let k = f64::from(self.steps);
            let press = if k < 30.0 { k } else { 60.0 - k };
            self.set_real("tool[1].position.z", 0.035 - 0.0005 * press);
            self.set_real("tool[2].position.z", 0.04 - 0.0005 * k);
            self.set_boolean("tool[2].active", k > 20.0);
            self.set_boolean("tool[3].active", k > 5.0);
            self.set_real("tool[3].position.x", 0.02 + 0.0001 * k);
            self.step();
        }
    }

    /// Everything there is to read, to the bit.
    fn outputs(&self) -> Vec<u64> {
        let mut bits = Vec::new();
        for row in TABLE.iter().filter(|row| exists(row, self.model)) {
            for item in 0..count(row.group, self.model) {
                for component in 0..row.components.len() {
                    let vr = reference(row, item, component);
                    let (mut real, mut whole) = (0.0, 0);
                    let status = unsafe {
                        match row.value {
                            Value::Real { .. } | Value::Evaluated { .. } => {
                                fmi2GetReal(self.c, &vr, 1, &mut real)
                            }
                            Value::Integer { .. } => fmi2GetInteger(self.c, &vr, 1, &mut whole),
                            Value::Boolean { .. } => fmi2GetBoolean(self.c, &vr, 1, &mut whole),
                        }
                    };
                    assert_eq!(status, OK);
                    assert!(real.is_finite(), "{}", row.name);
                    bits.push(real.to_bits() ^ whole as u64);
                }
            }
        }
        bits
    }

    fn save(&self) -> *mut c_void {
        let mut state = null_mut();
        assert_eq!(unsafe { fmi2GetFMUstate(self.c, &mut state) }, OK);
        assert!(!state.is_null());
        state
    }

    fn bytes(&self, state: *mut c_void) -> Vec<u8> {
        let mut size = 0;
        unsafe {
            assert_eq!(fmi2SerializedFMUstateSize(self.c, state, &mut size), OK);
            let mut bytes = vec![0u8; size];
            let to = bytes.as_mut_ptr().cast();
            assert_eq!(fmi2SerializeFMUstate(self.c, state, to, size), OK);
            bytes
        }
    }

    fn load(&self, bytes: &[u8]) -> (c_int, *mut c_void) {
        let mut state = null_mut();
        let from = bytes.as_ptr().cast();
        let status = unsafe { fmi2DeSerializeFMUstate(self.c, from, bytes.len(), &mut state) };
        (status, state)
    }
}

#[test]
fn full_life() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.host();
    unsafe {
        assert_eq!(CStr::from_ptr(fmi2GetVersion()), c"2.0");
        assert_eq!(CStr::from_ptr(fmi2GetTypesPlatform()), c"default");
    }
    assert_eq!(host.real("gravity.z"), -9.81);
    host.start();
    host.drive(60);
    assert!(host.integer("topology.removedTetrahedra") > 0);
    assert_eq!(host.boolean("tool[3].inContact"), 1);
    assert!(host.real("tool[3].force.x") < 0.0);
    let mut time = 0.0;
    let (mut status, mut ended) = (-1, -1);
    unsafe {
        assert_eq!(fmi2GetRealStatus(host.c, 2, &mut time), OK);
        assert_eq!(fmi2GetStatus(host.c, 0, &mut status), OK);
        assert_eq!(fmi2GetBooleanStatus(host.c, 3, &mut ended), OK);
    }
    assert!((time - 0.06).abs() < 1e-12);
    assert_eq!((status, ended), (OK, 0));
    assert_eq!(unsafe { fmi2Terminate(host.c) }, OK);
    assert!(host.real("energy.elastic") > 0.0);
    // Cuts are told as events; nothing else was.
    let lines = host.lines();
    assert!(!lines.is_empty());
    assert!(
        lines
            .iter()
            .all(|l| l.1 == "logEvents" && l.2.contains("removed")),
        "{lines:?}"
    );
}

#[test]
fn the_xml_declares_the_log_categories() {
    let unpacked = Unpacked::new();
    let model = std::sync::Arc::new(prepared::open(&unpacked.folder).unwrap());
    let xml = model_description::write(&mut tissue::simulation::Simulation::new(model));
    assert_eq!(xml.matches("<Category ").count(), log::CATEGORIES.len());
    for (_, name) in log::CATEGORIES {
        assert!(xml.contains(&format!("<Category name={name:?}")));
    }
}

#[test]
fn resources_are_found_by_every_form_of_uri() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("a b ü+%20%/resources");
    let model = write_resources(&folder);
    let guid = model_description::guid(&model);
    let log = Log::default();
    let whole = uri(&folder);
    let bare = whole.strip_suffix('/').unwrap();
    let four = bare.replace("file:///", "file:////");
    for (location, guid) in [
        (whole.as_str(), guid.clone()),
        (bare, format!("{{{guid}}}")),
        (&four, guid.to_uppercase()),
    ] {
        let c = instantiate(&log, "a", CO_SIMULATION, &guid, location, true);
        assert!(!c.is_null(), "{location}: {:?}", log.lines);
        unsafe { fmi2FreeInstance(c) };
    }
    assert!(log.lines.lock().unwrap().is_empty());
    let c = instantiate(
        &log,
        "a",
        CO_SIMULATION,
        &guid,
        folder.to_str().unwrap(),
        true,
    );
    assert!(!c.is_null());
    unsafe { fmi2FreeInstance(c) };
    let lines = log.lines.lock().unwrap();
    assert_eq!(lines.len(), 1, "{lines:?}");
    assert!(
        lines[0].1 == "logStatusWarning" && lines[0].2.contains("%%20%%"),
        "{lines:?}"
    );
}

#[test]
fn bad_instantiations_return_null_and_one_line() {
    let unpacked = Unpacked::new();
    let guid = model_description::guid(&unpacked.model);
    let location = uri(&unpacked.folder);
    let log = Log::default();
    let complaint = |c: *mut c_void, what: &str| {
        assert!(c.is_null());
        let lines = std::mem::take(&mut *log.lines.lock().unwrap());
        assert_eq!(lines.len(), 1, "{lines:?}");
        assert_eq!((lines[0].0, lines[0].1.as_str()), (ERROR, "logStatusError"));
        assert!(lines[0].2.contains(what), "{lines:?} lacks {what}");
    };
    let with = |name: &str, kind, guid: &str, location: &str| {
        instantiate(&log, name, kind, guid, location, false)
    };
    complaint(with("", 1, &guid, &location), "instanceName");
    complaint(with("a", 0, &guid, &location), "fmi2CoSimulation");
    complaint(with("a", 7, &guid, &location), "fmuType");
    complaint(with("a", 1, "x%s", &location), "x%%s");
    complaint(with("a", 1, &guid, ""), "file:///");
    complaint(with("a", 1, &guid, "http://x/y"), "http");
    complaint(
        with("a", 1, &guid, "file:///nowhere/at/all"),
        "/nowhere/at/all/scene.json",
    );
    let names = [c"a".as_ptr(), null()];
    let callbacks = callbacks(&log);
    let guid_c = CString::new(guid.clone()).unwrap();
    let location_c = CString::new(location.clone()).unwrap();
    for (name, guid, location, what) in [
        (
            names[1],
            guid_c.as_ptr(),
            location_c.as_ptr(),
            "instanceName",
        ),
        (names[0], null(), location_c.as_ptr(), "fmuGUID"),
        (names[0], guid_c.as_ptr(), null(), "fmuResourceLocation"),
    ] {
        complaint(
            unsafe { fmi2Instantiate(name, 1, guid, location, &callbacks, 0, 0) },
            what,
        );
    }
    let bad = c"file:///\xff".as_ptr();
    complaint(
        unsafe { fmi2Instantiate(names[0], 1, guid_c.as_ptr(), bad, &callbacks, 0, 0) },
        "UTF-8",
    );
    let c = unsafe {
        fmi2Instantiate(
            names[0],
            1,
            guid_c.as_ptr(),
            location_c.as_ptr(),
            null(),
            0,
            0,
        )
    };
    assert!(c.is_null());
    for (file, text) in [
        (prepared::PRECOMPUTED, "{"),
        (prepared::SCENE, "{\"name\": 1"),
        (prepared::SCENE, ""),
    ] {
        std::fs::write(unpacked.folder.join(file), text).unwrap();
        complaint(with("a", 1, &guid, &location), file);
    }
}

#[test]
fn no_logger_is_fine() {
    let unpacked = Unpacked::new();
    let guid = CString::new(model_description::guid(&unpacked.model)).unwrap();
    let location = CString::new(uri(&unpacked.folder)).unwrap();
    let none = CallbackFunctions {
        logger: None,
        allocate_memory: None,
        free_memory: None,
        step_finished: None,
        environment: null_mut(),
    };
    unsafe {
        let name = c"a".as_ptr();
        let c = fmi2Instantiate(name, 1, guid.as_ptr(), location.as_ptr(), &none, 0, 1);
        assert_eq!(fmi2DoStep(c, 0.0, H, 0), ERROR);
        fmi2FreeInstance(c);
        assert!(fmi2Instantiate(name, 0, guid.as_ptr(), location.as_ptr(), &none, 0, 1).is_null());
    }
}

/// A harmless call of each function.
fn call(host: &Host, function: Function) -> c_int {
    use Function as F;
    let c = host.c;
    let (mut whole, mut real, mut size, mut text) = (0, 0.0, 0, null());
    let mut state = null_mut();
    unsafe {
        match function {
            F::SetDebugLogging => fmi2SetDebugLogging(c, 1, 0, null()),
            F::SetupExperiment => fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0),
            F::EnterInitializationMode => fmi2EnterInitializationMode(c),
            F::ExitInitializationMode => fmi2ExitInitializationMode(c),
            F::Terminate => fmi2Terminate(c),
            F::Reset => fmi2Reset(c),
            F::GetReal => fmi2GetReal(c, null(), 0, null_mut()),
            F::GetInteger => fmi2GetInteger(c, null(), 0, null_mut()),
            F::GetBoolean => fmi2GetBoolean(c, null(), 0, null_mut()),
            F::GetString => fmi2GetString(c, null(), 0, null_mut()),
            F::SetReal => fmi2SetReal(c, null(), 0, null()),
            F::SetInteger => fmi2SetInteger(c, null(), 0, null()),
            F::SetBoolean => fmi2SetBoolean(c, null(), 0, null()),
            F::SetString => fmi2SetString(c, null(), 0, null()),
            F::GetFmuState => fmi2GetFMUstate(c, &mut state),
            F::SetFmuState => fmi2SetFMUstate(c, null_mut()),
            F::FreeFmuState => fmi2FreeFMUstate(c, &mut state),
            F::SerializedFmuStateSize => fmi2SerializedFMUstateSize(c, null_mut(), &mut size),
            F::SerializeFmuState => fmi2SerializeFMUstate(c, null_mut(), null_mut(), 0),
            F::DeSerializeFmuState => fmi2DeSerializeFMUstate(c, null(), 0, &mut state),
            F::GetDirectionalDerivative => {
                fmi2GetDirectionalDerivative(c, null(), 0, null(), 0, null(), null_mut())
            }
            F::SetRealInputDerivatives => fmi2SetRealInputDerivatives(c, null(), 0, null(), null()),
            F::GetRealOutputDerivatives => {
                fmi2GetRealOutputDerivatives(c, null(), 0, null(), null_mut())
            }
            F::DoStep => fmi2DoStep(c, host.time(), -H, 0),
            F::CancelStep => fmi2CancelStep(c),
            F::GetStatus => fmi2GetStatus(c, 0, &mut whole),
            F::GetRealStatus => fmi2GetRealStatus(c, 2, &mut real),
            F::GetIntegerStatus => fmi2GetIntegerStatus(c, 1, &mut whole),
            F::GetBooleanStatus => fmi2GetBooleanStatus(c, 3, &mut whole),
            F::GetStringStatus => fmi2GetStringStatus(c, 1, &mut text),
        }
    }
}

#[test]
fn every_function_keeps_the_order() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.host();
    for mode in (0..7).map_while(Mode::from_code) {
        for (function, name, legal) in ORDER {
            *host.instance().mode() = mode;
            let status = call(&host, function);
            let refused = |lines: &[Line]| lines.iter().any(|l| l.2.contains("may not be called"));
            if legal.contains(&mode) {
                let lines = host.lines();
                assert!(!refused(&lines), "{name} in {mode:?}: {lines:?}");
                assert_eq!(status > 1, !lines.is_empty(), "{name}: {status} {lines:?}");
            } else {
                assert_eq!(status, ERROR, "{name} in {mode:?}");
                assert_eq!(*host.instance().mode(), mode, "{name}");
                let lines = host.lines();
                assert!(lines.len() == 1 && refused(&lines), "{name}: {lines:?}");
                assert!(lines[0].1 == "logStatusError" && lines[0].2.starts_with(name));
            }
        }
    }
}

#[test]
fn null_and_foreign_components_are_refused() {
    let unpacked = Unpacked::new();
    let mut noise = [0u64; 64];
    let noise = noise.as_mut_ptr().cast::<c_void>();
    for c in [null_mut(), noise, noise.wrapping_byte_add(3)] {
        let host = Host {
            c,
            log: Box::default(),
            model: &unpacked.model,
            steps: 0,
        };
        for (function, ..) in ORDER {
            assert_eq!(call(&host, function), ERROR);
        }
    }
}

#[test]
fn null_arrays_are_refused() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    let c = host.c;
    let (vr, mut real, mut whole) = (host.reference("gravity.x"), 0.0, 0);
    let odd = std::ptr::from_mut(&mut real).wrapping_byte_add(1);
    let order = 1;
    unsafe {
        let refused = [
            fmi2GetReal(c, null(), 1, &mut real),
            fmi2GetReal(c, &vr, 1, null_mut()),
            fmi2GetReal(c, &vr, 1, odd),
            fmi2GetReal(c, &vr, usize::MAX, &mut real),
            fmi2SetReal(c, null(), 1, &real),
            fmi2SetReal(c, &vr, 1, null()),
            fmi2GetInteger(c, null(), 1, &mut whole),
            fmi2GetInteger(c, &vr, 1, null_mut()),
            fmi2SetInteger(c, null(), 1, &whole),
            fmi2SetInteger(c, &vr, 1, null()),
            fmi2GetBoolean(c, null(), 1, &mut whole),
            fmi2GetBoolean(c, &vr, 1, null_mut()),
            fmi2SetBoolean(c, null(), 1, &whole),
            fmi2SetBoolean(c, &vr, 1, null()),
            fmi2GetString(c, null(), 1, null_mut()),
            fmi2SetString(c, null(), 1, null()),
            fmi2SetRealInputDerivatives(c, null(), 1, &order, &real),
            fmi2SetRealInputDerivatives(c, &vr, 1, null(), &real),
            fmi2SetRealInputDerivatives(c, &vr, 1, &order, null()),
            fmi2GetRealOutputDerivatives(c, &vr, 1, &order, &mut real),
            fmi2GetDirectionalDerivative(c, &vr, 1, &vr, 1, &real, &mut real),
            fmi2SetDebugLogging(c, 1, 1, null()),
            fmi2SetDebugLogging(c, 1, 1, &null()),
            fmi2GetFMUstate(c, null_mut()),
            fmi2SetFMUstate(c, null_mut()),
            fmi2SerializedFMUstateSize(c, null_mut(), null_mut()),
            fmi2SerializeFMUstate(c, null_mut(), null_mut(), 8),
            fmi2DeSerializeFMUstate(c, null(), 8, null_mut()),
            fmi2GetStatus(c, 0, null_mut()),
            fmi2GetRealStatus(c, 2, null_mut()),
            fmi2GetIntegerStatus(c, 1, null_mut()),
            fmi2GetBooleanStatus(c, 3, null_mut()),
            fmi2GetStringStatus(c, 1, null_mut()),
        ];
        assert_eq!(refused, [ERROR; 33]);
        let lines = host.lines();
        assert_eq!(lines.len(), refused.len(), "{lines:#?}");
        assert!(lines.iter().all(|l| l.1 == "logStatusError"), "{lines:#?}");
        assert_eq!(fmi2FreeFMUstate(c, null_mut()), OK);
        for kind in [0, 1, 2, 3] {
            assert_eq!(fmi2GetIntegerStatus(c, kind, &mut whole), DISCARD);
        }
        assert_eq!(fmi2GetRealStatus(c, 9, &mut real), ERROR);
    }
    host.step();
}

#[test]
fn refused_values_leave_all_as_it_was() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    host.drive(5);
    host.lines();
    let before = host.outputs();
    let z = "tool[1].position.z";
    for (names, values, status, what) in [
        (
            vec![z, "tool[1].position.x"],
            vec![1.0, f64::NAN],
            DISCARD,
            "tool[1].position.x",
        ),
        (
            vec![z, "gravity.y"],
            vec![1.0, f64::INFINITY],
            DISCARD,
            "gravity.y",
        ),
        (
            vec![z, "tool[1].force.x"],
            vec![1.0, 1.0],
            ERROR,
            "tool[1].force.x is calculated",
        ),
        (
            vec!["gravity.x", "surface.vertex[2].y"],
            vec![1.0, 1.0],
            ERROR,
            "surface.vertex[2].y",
        ),
        (
            vec![z, "tool[2].active"],
            vec![1.0, 1.0],
            ERROR,
            "fmi2SetBoolean",
        ),
        (
            vec![z, "material[1].density"],
            vec![1.0, 900.0],
            ERROR,
            "fixed parameter",
        ),
        (
            vec![z, "integration.damping"],
            vec![1.0, -1.0],
            ERROR,
            "at least 0 1/s",
        ),
        // An error outweighs a discard.
        (
            vec![z, "energy.load"],
            vec![f64::NAN, 1.0],
            ERROR,
            "energy.load",
        ),
    ] {
        assert_eq!(host.try_real(&names, &values), status, "{names:?}");
        let category = if status == DISCARD {
            "logStatusDiscard"
        } else {
            "logStatusError"
        };
        host.complaint(category, what);
        assert!(host.outputs() == before, "{names:?}");
    }
    let unknown = [host.reference(z), 999];
    let (whole, mut integer) = ([1, 1], 0);
    unsafe {
        assert_eq!(
            fmi2SetReal(host.c, unknown.as_ptr(), 2, [1.0, 1.0].as_ptr()),
            ERROR
        );
        host.complaint("logStatusError", "999");
        let count = host.reference("surface.triangleCount");
        assert_eq!(fmi2SetInteger(host.c, &count, 1, whole.as_ptr()), ERROR);
        host.complaint("logStatusError", "surface.triangleCount is calculated");
        let active = host.references(&["tool[1].active", "tool[1].inContact"]);
        assert_eq!(
            fmi2SetBoolean(host.c, active.as_ptr(), 2, whole.as_ptr()),
            ERROR
        );
        host.complaint("logStatusError", "tool[1].inContact");
        assert_eq!(
            fmi2GetInteger(host.c, active.as_ptr(), 1, &mut integer),
            ERROR
        );
        host.complaint("logStatusError", "fmi2GetBoolean");
        for vr in [999, 1300, 100_010, 99_999_999, 199_999_999, u32::MAX] {
            assert_eq!(fmi2GetReal(host.c, &vr, 1, &mut 0.0), ERROR);
            host.complaint("logStatusError", &vr.to_string());
        }
    }
    assert!(host.outputs() == before);
    host.drive(5);
}

#[test]
fn parameters_are_undone_together() {
    let unpacked = Unpacked::new();
    let host = unpacked.host();
    let before = host.outputs();
    let names = [
        "gravity.x",
        "material[1].density",
        "material[1].youngModulus",
        "tool[1].position.x",
    ];
    assert_eq!(host.try_real(&names, &[1.0, 500.0, 0.0, 0.3]), ERROR);
    host.complaint(
        "logStatusError",
        "material[1].youngModulus = 0: must be above 0",
    );
    assert!(host.outputs() == before);
    assert_eq!(host.try_real(&["integration.hapticRate"], &[2e5]), ERROR);
    host.complaint("logStatusError", "at least 1 Hz and at most 100000 Hz");
}

#[test]
fn fixed_parameters_are_built_in_at_the_end_of_initialization() {
    let unpacked = Unpacked::new();
    let mut soft = unpacked.started();
    soft.drive(25);
    let mut stiff = unpacked.host();
    stiff.set_real("material[1].youngModulus", 60_000.0);
    stiff.set_real("tool[1].position.x", 0.05);
    assert_eq!(unsafe { fmi2EnterInitializationMode(stiff.c) }, OK);
    stiff.set_real("material[1].poissonRatio", 0.3);
    stiff.set_real("gravity.z", 0.0);
    assert_eq!(unsafe { fmi2ExitInitializationMode(stiff.c) }, OK);
    stiff.complaint("logEvents", "pre-computation");
    assert_eq!(stiff.real("material[1].youngModulus"), 60_000.0);
    assert_eq!(stiff.real("gravity.z"), 0.0);
    stiff.drive(25);
    assert!(stiff.real("tool[1].force.z") > 1.5 * soft.real("tool[1].force.z"));

    // The bytes carry the parameters: a fresh instance goes on.
    let bytes = stiff.bytes(stiff.save());
    let mut other = unpacked.host();
    let (status, state) = other.load(&bytes);
    assert_eq!(status, OK, "{:?}", other.lines());
    assert_eq!(unsafe { fmi2SetFMUstate(other.c, state) }, OK);
    other.steps = stiff.steps;
    stiff.drive(10);
    other.drive(10);
    assert!(stiff.outputs() == other.outputs());

    assert_eq!(unsafe { fmi2Reset(stiff.c) }, OK);
    assert_eq!(stiff.real("material[1].youngModulus"), 20_000.0);
    stiff.steps = 0;
    stiff.start();
    stiff.drive(25);
    assert!(stiff.outputs() == soft.outputs());
}

#[test]
fn a_state_of_initialization_takes_its_parameters_back() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.host();
    host.set_real("material[1].youngModulus", 40_000.0);
    host.set_real("integration.damping", 30.0);
    let state = host.save();
    let bytes = host.bytes(state);
    host.set_real("material[1].youngModulus", 50_000.0);
    assert_eq!(unsafe { fmi2SetFMUstate(host.c, state) }, OK);
    let mut other = unpacked.started();
    other.drive(3);
    let (_, state) = other.load(&bytes);
    assert_eq!(unsafe { fmi2SetFMUstate(other.c, state) }, OK);
    other.steps = 0;
    for host in [&mut host, &mut other] {
        assert_eq!(host.real("material[1].youngModulus"), 40_000.0);
        host.start();
        assert_eq!(host.real("integration.damping"), 30.0);
        host.drive(10);
    }
    assert!(host.outputs() == other.outputs());
}

#[test]
fn reset_gives_the_same_bits() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    host.drive(60);
    let first = host.outputs();
    assert_eq!(unsafe { fmi2Reset(host.c) }, OK);
    host.steps = 0;
    host.start();
    host.drive(60);
    assert!(host.outputs() == first);
}

#[test]
fn restored_is_never_interrupted() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    // Mid-contact, and after a cut.
    for _ in 0..2 {
        host.drive(25);
        let state = host.save();
        let bytes = host.bytes(state);
        let steps = host.steps;
        host.drive(10);
        let expected = host.outputs();
        host.drive(5);
        assert_eq!(unsafe { fmi2SetFMUstate(host.c, state) }, OK);
        host.steps = steps;
        host.drive(10);
        assert!(host.outputs() == expected);

        let mut other = unpacked.host();
        let (status, mut copy) = other.load(&bytes);
        assert_eq!(status, OK, "{:?}", other.lines());
        assert_eq!(other.bytes(copy), bytes);
        assert_eq!(unsafe { fmi2SetFMUstate(other.c, copy) }, OK);
        other.steps = steps;
        other.drive(10);
        assert!(other.outputs() == expected);
        // Reused, not leaked.
        let held = copy;
        unsafe {
            assert_eq!(fmi2GetFMUstate(other.c, &mut copy), OK);
            assert_eq!(copy, held);
            let from = bytes.as_ptr().cast();
            assert_eq!(
                fmi2DeSerializeFMUstate(other.c, from, bytes.len(), &mut copy),
                OK
            );
            assert_eq!(copy, held);
        }
        assert_eq!(other.bytes(copy), bytes);
    }
    assert!(host.integer("topology.removedTetrahedra") > 0);
}

#[test]
fn bad_states_are_refused() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    host.drive(20);
    host.lines();
    let mut state = host.save();
    let bytes = host.bytes(state);
    let stranger = unpacked.started();
    let (mut size, mut small) = (0, vec![0u8; bytes.len() - 1]);
    let to = small.as_mut_ptr().cast();
    unsafe {
        assert_eq!(fmi2SetFMUstate(stranger.c, state), ERROR);
        stranger.complaint("logStatusError", "FMUstate");
        assert_eq!(fmi2GetFMUstate(stranger.c, &mut state), ERROR);
        assert_eq!(fmi2FreeFMUstate(stranger.c, &mut state), ERROR);
        assert_eq!(fmi2SerializeFMUstate(host.c, state, to, small.len()), ERROR);
        host.complaint("logStatusError", &bytes.len().to_string());
        let freed = state;
        assert_eq!(fmi2FreeFMUstate(host.c, &mut state), OK);
        assert!(state.is_null());
        assert_eq!(fmi2FreeFMUstate(host.c, &mut state), OK);
        assert_eq!(fmi2SerializedFMUstateSize(host.c, freed, &mut size), ERROR);
        host.complaint("logStatusError", "FMUstate");
    }
    for length in [0, 7, 8, 40, 100, bytes.len() - 1] {
        let (status, state) = host.load(&bytes[..length]);
        assert_eq!((status, state), (ERROR, null_mut()), "{length}");
        host.complaint("logStatusError", "saved state");
    }
    let mut longer = bytes.clone();
    longer.push(0);
    assert_eq!(host.load(&longer).0, ERROR);
    for at in (0..bytes.len()).step_by(37).chain([8, 16, 48, 56]) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x40;
        let (status, state) = host.load(&damaged);
        assert_eq!((status, state), (ERROR, null_mut()), "byte {at}");
    }
    host.drive(5);
}

#[test]
fn a_zero_quaternion_is_refused_by_the_step() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    host.drive(20);
    let before = host.outputs();
    host.set_real("tool[1].orientation.w", 0.0);
    host.lines();
    assert_eq!(host.try_step(), DISCARD);
    host.complaint("logStatusDiscard", "tool[1].orientation");
    let (mut time, mut status, mut ended) = (0.0, 0, 1);
    unsafe {
        assert_eq!(fmi2GetRealStatus(host.c, 2, &mut time), OK);
        assert_eq!(fmi2GetStatus(host.c, 0, &mut status), OK);
        assert_eq!(fmi2GetBooleanStatus(host.c, 3, &mut ended), OK);
    }
    assert_eq!((time, status, ended), (host.time(), DISCARD, 0));
    host.set_real("tool[1].orientation.w", 1.0);
    assert!(host.outputs() == before);
    host.drive(5);

    let mut other = unpacked.started();
    other.drive(25);
    assert!(host.outputs() == other.outputs());
}

#[test]
fn a_zero_quaternion_in_initialization_does_not_end_the_run() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.host();
    host.set_real("tool[1].orientation.w", 0.0);
    host.start();
    host.complaint("logStatusWarning", "tool[1].orientation");
    assert_eq!(host.try_step(), DISCARD);
    host.set_real("tool[1].orientation.w", 1.0);
    host.step();
}

#[test]
fn a_step_that_fails_can_be_tried_again() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    host.drive(10);
    let state = host.save();
    let before = host.outputs();
    host.set_real("tool[3].position.z", 1e200);
    host.lines();
    assert_eq!(host.try_step(), DISCARD);
    host.complaint(
        "logStatusDiscard",
        "the state is that of the start of the step",
    );
    assert_eq!(unsafe { fmi2SetFMUstate(host.c, state) }, OK);
    assert!(host.outputs() == before);
    host.step();
}

#[test]
fn bad_steps_are_refused() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.host();
    unsafe {
        assert_eq!(fmi2SetupExperiment(host.c, 0, 0.0, f64::NAN, 0, 0.0), ERROR);
        assert_eq!(fmi2SetupExperiment(host.c, 0, 0.0, 1.0, 1, 0.5), ERROR);
        assert_eq!(fmi2SetupExperiment(host.c, 1, 1e-6, 1.0, 1, 1.0105), OK);
        assert_eq!(fmi2EnterInitializationMode(host.c), OK);
        assert_eq!(fmi2ExitInitializationMode(host.c), OK);
        host.lines();
        for (point, length, what) in [
            (1.0, 0.0, "must be positive"),
            (1.0, -H, "must be positive"),
            (1.0, f64::NAN, "must be positive"),
            (1.0, f64::INFINITY, "must be positive"),
            (0.0, H, "expected 1"),
            (f64::NAN, H, "expected 1"),
            (1.0, 0.011, "stopTime"),
        ] {
            assert_eq!(fmi2DoStep(host.c, point, length, 0), ERROR);
            host.complaint("logStatusError", what);
        }
        let mut time = 1.0;
        for _ in 0..10 {
            assert_eq!(fmi2DoStep(host.c, time, H, 0), OK, "{:?}", host.lines());
            time += H;
        }
        assert_eq!(fmi2DoStep(host.c, time, 1.0105 - time + 1e-12, 0), OK);
        let mut last = 0.0;
        assert_eq!(fmi2GetRealStatus(host.c, 2, &mut last), OK);
        assert!((last - 1.0105).abs() < 1e-10);
        assert!((host.instance().simulation().time() - 0.0105).abs() < 1e-10);
    }
}

#[test]
fn without_setup_the_first_step_says_what_time_it_is() {
    let unpacked = Unpacked::new();
    let host = unpacked.host();
    unsafe {
        assert_eq!(fmi2EnterInitializationMode(host.c), OK);
        assert_eq!(fmi2ExitInitializationMode(host.c), OK);
        assert_eq!(fmi2DoStep(host.c, 5.0, H, 0), OK);
        assert_eq!(fmi2DoStep(host.c, 5.0, H, 0), ERROR);
        assert_eq!(fmi2DoStep(host.c, 5.0 + H, H, 0), OK);
    }
}

impl Host<'_> {
    fn derivative(&self, unknown: &[&str], known: &[&str], dv: &[f64], out: &mut [f64]) -> c_int {
        let (unknown, known) = (self.references(unknown), self.references(known));
        assert!(dv.len() == known.len() && out.len() == unknown.len());
        unsafe {
            fmi2GetDirectionalDerivative(
                self.c,
                unknown.as_ptr(),
                unknown.len(),
                known.as_ptr(),
                known.len(),
                dv.as_ptr(),
                out.as_mut_ptr(),
            )
        }
    }

    fn slope(&self, names: &[&str], order: c_int, out: &mut [f64]) -> c_int {
        let (vr, orders) = (self.references(names), vec![order; names.len()]);
        unsafe {
            let (vr, orders) = (vr.as_ptr(), orders.as_ptr());
            fmi2GetRealOutputDerivatives(self.c, vr, names.len(), orders, out.as_mut_ptr())
        }
    }
}

#[test]
fn directional_derivatives() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.host();
    unsafe {
        assert_eq!(fmi2SetupExperiment(host.c, 0, 0.0, 0.0, 0, 0.0), OK);
        assert_eq!(fmi2EnterInitializationMode(host.c), OK);
    }
    // Legal, and zero before any contact.
    let force = ["tool[3].force.x", "tool[3].force.y", "tool[3].force.z"];
    let mut column = [f64::NAN; 3];
    let by = ["tool[3].position.x"];
    assert_eq!(host.derivative(&force, &by, &[1.0], &mut column), OK);
    assert_eq!(column, [0.0; 3]);
    assert_eq!(unsafe { fmi2ExitInitializationMode(host.c) }, OK);
    host.drive(15);
    let before = host.outputs();
    // Columns are the stiffness; a direction is their sum; orders of references do not matter.
    for (k, axis) in ["x", "y", "z"].iter().enumerate() {
        let by = format!("tool[3].position.{axis}");
        assert_eq!(host.derivative(&force, &[&by], &[2.0], &mut column), OK);
        for (j, x) in column.iter().enumerate() {
            let name = format!("tool[3].stiffness[{},{}]", j + 1, k + 1);
            assert_eq!(*x, 2.0 * host.real(&name), "{name}");
        }
    }
    assert!(host.real("tool[3].stiffness[1,1]") < 0.0);
    assert!(host.real("tool[3].staticStiffness[1,1]") > 0.0);
    let mut sum = [f64::NAN; 2];
    let unknown = ["tool[3].torque.y", "tool[3].force.z"];
    let known = ["tool[3].orientation.y", "tool[3].position.x"];
    assert_eq!(
        host.derivative(&unknown, &known, &[0.5, -1e-3], &mut sum),
        OK
    );
    let mut parts = [[f64::NAN; 2]; 2];
    for (part, by) in parts.iter_mut().zip(known) {
        assert_eq!(host.derivative(&unknown, &[by], &[1.0], part), OK);
    }
    for k in 0..2 {
        let expected = 0.5 * parts[0][k] - 1e-3 * parts[1][k];
        assert!(
            (sum[k] - expected).abs() <= 1e-12 * expected.abs(),
            "{sum:?} {parts:?}"
        );
    }
    assert_eq!(host.derivative(&[], &[], &[], &mut []), OK);
    assert_eq!(host.outputs(), before);
    assert!(host.lines().iter().all(|l| l.0 == OK));
    // Everything else is refused.
    for name in [
        "tool[1].meanForce.x",
        "tool[1].position.x",
        "tool[1].stiffness[1,1]",
        "energy.elastic",
        "surface.vertex[1].x",
        "tool[1].inContact",
        "topology.revision",
    ] {
        let mut out = [0.0];
        assert_eq!(host.derivative(&[name], &by, &[1.0], &mut out), ERROR);
        host.complaint("logStatusError", name);
    }
    for name in [
        "tool[1].force.x",
        "tool[1].active",
        "gravity.x",
        "integration.damping",
    ] {
        assert_eq!(host.derivative(&force, &[name], &[1.0], &mut column), ERROR);
        host.complaint("logStatusError", name);
    }
    assert_eq!(
        host.derivative(&force, &by, &[f64::NAN], &mut column),
        DISCARD
    );
    host.complaint("logStatusDiscard", "tool[3].position.x");
    // What cannot be stepped has no tangent.
    let zero = ["tool[3].orientation.x", "tool[3].orientation.w"];
    assert_eq!(host.try_real(&zero, &[0.0, 0.0]), OK);
    assert_eq!(host.derivative(&force, &by, &[1.0], &mut column), DISCARD);
    host.complaint("logStatusDiscard", "orientation is zero");
    let (vr, mut value) = (host.reference("tool[3].stiffness[2,2]"), 0.0);
    assert_eq!(unsafe { fmi2GetReal(host.c, &vr, 1, &mut value) }, DISCARD);
    host.complaint("logStatusDiscard", "tool[3].stiffness[2,2]");
    assert_eq!(unsafe { fmi2SetReal(host.c, &vr, 1, &value) }, ERROR);
    host.complaint("logStatusError", "calculated");
}

#[test]
fn output_derivatives() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    let mut slope = [f64::NAN];
    assert_eq!(host.slope(&["tool[3].force.x"], 1, &mut slope), OK);
    assert_eq!(slope, [0.0]);
    host.drive(15);
    let names = ["tool[3].force.x", "tool[3].torque.y", "surface.vertex[7].z"];
    let before = names.map(|name| host.real(name));
    host.drive(1);
    let mut slopes = [f64::NAN; 3];
    assert_eq!(host.slope(&names, 1, &mut slopes), OK);
    for k in 0..2 {
        let expected = (host.real(names[k]) - before[k]) / H;
        assert!((slopes[k] - expected).abs() <= 1e-9 * expected.abs());
    }
    assert!(slopes[2].is_finite());
    for name in [
        "energy.elastic",
        "tool[1].meanForce.x",
        "tool[1].stiffness[1,1]",
        "gravity.x",
    ] {
        assert_eq!(host.slope(&[name], 1, &mut slope), ERROR);
        host.complaint("logStatusError", name);
    }
    for order in [0, 2, -1] {
        assert_eq!(host.slope(&["tool[3].force.x"], order, &mut slope), ERROR);
        host.complaint("logStatusError", "only order 1");
    }
}

#[test]
fn input_derivatives() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    let vr = host.references(&["tool[1].position.x", "tool[1].position.z"]);
    let set = |host: &Host, vr: &[u32], order: &[c_int], value: &[f64]| unsafe {
        fmi2SetRealInputDerivatives(
            host.c,
            vr.as_ptr(),
            vr.len(),
            order.as_ptr(),
            value.as_ptr(),
        )
    };
    host.set_real("tool[1].position.z", 0.034);
    assert_eq!(set(&host, &vr, &[1, 1], &[0.0, -2.0]), OK);
    for (order, value, status, category, what) in [
        ([1, 2], [1.0, 1.0], ERROR, "logStatusError", "order 2"),
        ([1, 0], [1.0, 1.0], ERROR, "logStatusError", "order 0"),
        (
            [1, 1],
            [1.0, f64::NAN],
            DISCARD,
            "logStatusDiscard",
            "tool[1].position.z",
        ),
    ] {
        assert_eq!(set(&host, &vr, &order, &value), status);
        host.complaint(category, what);
    }
    for name in ["tool[1].active", "gravity.x", "tool[1].force.x"] {
        let vr = [vr[0], host.reference(name)];
        assert_eq!(set(&host, &vr, &[1, 1], &[1.0, 1.0]), ERROR);
        host.complaint("logStatusError", name);
    }
    host.step();
    let pose = host.instance().simulation().tool(0).pose;
    assert!((pose.position.x - 0.05).abs() < 1e-15);
    assert!((pose.position.z - 0.032).abs() < 1e-15);
    assert_eq!(
        set(
            &host,
            &host.references(&["tool[1].orientation.x"]),
            &[1],
            &[100.0]
        ),
        OK
    );
    host.step();
    let turned = host.instance().simulation().tool(0).pose.orientation;
    assert!((turned.i - turned.w * 0.1).abs() < 1e-12);
}

#[test]
fn logging_is_switched_by_category() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    let categories = [c"logEvents".as_ptr(), c"no%such".as_ptr()];
    let names = categories.as_ptr();
    let wrong = |host: &Host| assert_eq!(host.try_real(&["energy.load"], &[1.0]), ERROR);
    unsafe {
        assert_eq!(fmi2SetDebugLogging(host.c, 1, 2, names), ERROR);
        host.complaint("logStatusError", "no%%such");
        assert_eq!(fmi2SetDebugLogging(host.c, 1, 1, names), OK);
        wrong(&host);
        assert!(host.lines().is_empty());
        host.drive(60);
        assert!(host.lines().iter().all(|l| l.1 == "logEvents"));
        assert_eq!(fmi2SetDebugLogging(host.c, 1, 0, null()), OK);
        wrong(&host);
        host.complaint("logStatusError", "energy.load");
        assert_eq!(fmi2SetDebugLogging(host.c, 0, 0, null()), OK);
        wrong(&host);
        assert!(host.lines().is_empty());
    }
}

#[test]
fn a_panic_is_fatal_and_stays_inside() {
    let unpacked = Unpacked::new();
    let host = unpacked.started();
    let status = unsafe { enter(host.c, Function::GetReal, |_| panic!("at 100 %")) };
    assert_eq!(status, FATAL);
    host.complaint("logStatusFatal", "at 100 %%");
    assert_eq!(host.try_step(), ERROR);
    host.complaint("logStatusError", "fatal");
}

#[test]
fn calls_from_inside_the_logger_are_refused() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.started();
    *host.log.component.lock().unwrap() = host.c.expose_provenance();
    assert_eq!(host.try_real(&["energy.load"], &[1.0]), ERROR);
    *host.log.component.lock().unwrap() = 0;
    host.step();
}

#[test]
fn instances_in_threads_do_not_interfere() {
    let unpacked = Unpacked::new();
    let mut alone = unpacked.started();
    alone.drive(30);
    let expected = alone.outputs();
    std::thread::scope(|scope| {
        for _ in 0..50 {
            scope.spawn(|| {
                let mut host = unpacked.started();
                host.drive(30);
                assert!(host.outputs() == expected);
            });
        }
    });
}

#[test]
fn many_lives() {
    let unpacked = Unpacked::new();
    for k in 0..200 {
        let mut host = unpacked.host();
        if k % 10 == 0 {
            host.start();
            host.step();
            // Not freed by the host: goes with the instance.
            host.save();
        }
    }
}

#[test]
fn three_thousand_values_are_read_at_once() {
    let unpacked = Unpacked::new();
    let host = unpacked.started();
    let first = host.reference("surface.vertex[1].x");
    let known = 3 * unpacked.model.surface_nodes.len() as u32;
    let vr: Vec<u32> = (0..3000).map(|k| first + k % known).collect();
    let mut values = vec![f64::NAN; vr.len()];
    let best = (0..50)
        .map(|_| {
            let begin = std::time::Instant::now();
            let status = unsafe { fmi2GetReal(host.c, vr.as_ptr(), vr.len(), values.as_mut_ptr()) };
            assert_eq!(status, OK);
            begin.elapsed()
        })
        .min()
        .unwrap();
    println!("{best:?}");
    assert!(best < std::time::Duration::from_millis(1), "{best:?}");
    for (k, value) in values.iter().enumerate().take(known as usize) {
        let name = format!("surface.vertex[{}].{}", k / 3 + 1, ["x", "y", "z"][k % 3]);
        assert_eq!(host.real(&name), *value);
    }
}

/// Random calls with random arguments: any status, but never fatal, and never NaN.
#[test]
fn no_call_is_fatal() {
    let unpacked = Unpacked::new();
    let mut host = unpacked.host();
    let mut seed = 1u64;
    let mut random = |n: u64| {
        seed = seed
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (seed >> 33) % n
    };
    let special = [
        0.0,
        1.0,
        -1.0,
        0.02,
        1e-3,
        1e30,
        1e200,
        -1e308,
        1e-320,
        f64::NAN,
        f64::INFINITY,
    ];
    let mut state = null_mut();
    let mut bytes = Vec::new();
    let mut steps = 0;
    for round in 0..20_000 {
        let n = random(4) as usize;
        let vr: Vec<u32> = (0..n)
            .map(|_| match random(8) {
                0 => random(1 << 32) as u32,
                1 => random(50) as u32,
                2 => 100_000 + random(4) as u32,
                3 => 1_000_000 + random(200) as u32,
                _ => 1000 + 100 * random(4) as u32 + random(22) as u32,
            })
            .collect();
        let real: Vec<f64> = (0..n)
            .map(|_| match random(3) {
                0 => special[random(special.len() as u64) as usize],
                _ => random(1000) as f64 * 5e-5,
            })
            .collect();
        let whole: Vec<c_int> = (0..n).map(|_| random(4) as c_int - 1).collect();
        let (mut reals, mut wholes) = ([0.0; 4], [0; 4]);
        let c = host.c;
        let time = host.instance().simulation().time();
        let status = unsafe {
            match random(23) {
                0..4 => fmi2SetReal(c, vr.as_ptr(), n, real.as_ptr()),
                4..6 => fmi2SetBoolean(c, vr.as_ptr(), n, whole.as_ptr()),
                6 => fmi2GetReal(c, vr.as_ptr(), n, reals.as_mut_ptr()),
                7 => fmi2GetInteger(c, vr.as_ptr(), n, wholes.as_mut_ptr()),
                8 => fmi2GetBoolean(c, vr.as_ptr(), n, wholes.as_mut_ptr()),
                9..13 => fmi2DoStep(c, time, H, 0),
                13 => fmi2DoStep(c, time, real.first().map_or(H, |t| t.min(0.01)), 0),
                14 => fmi2SetRealInputDerivatives(c, vr.as_ptr(), n, whole.as_ptr(), real.as_ptr()),
                15 => fmi2GetFMUstate(c, &mut state),
                16 if !state.is_null() => fmi2SetFMUstate(c, state),
                17 if !state.is_null() && round % 7 == 0 => {
                    bytes = host.bytes(state);
                    OK
                }
                18 if !bytes.is_empty() => {
                    let at = random(bytes.len() as u64) as usize;
                    bytes[at] ^= (random(4) / 3) as u8;
                    fmi2DeSerializeFMUstate(c, bytes.as_ptr().cast(), bytes.len(), &mut state)
                }
                18 => fmi2GetRealOutputDerivatives(
                    c,
                    vr.as_ptr(),
                    n,
                    whole.as_ptr(),
                    reals.as_mut_ptr(),
                ),
                19..22 => {
                    let split = random(n as u64 + 1) as usize;
                    let (unknown, known) = vr.split_at(split);
                    let (k, dv) = (known.len(), real.as_ptr());
                    let out = reals.as_mut_ptr();
                    fmi2GetDirectionalDerivative(
                        c,
                        unknown.as_ptr(),
                        split,
                        known.as_ptr(),
                        k,
                        dv,
                        out,
                    )
                }
                _ => call(&host, ORDER[random(ORDER.len() as u64) as usize].0),
            }
        };
        assert!((OK..FATAL).contains(&status), "{:?}", host.lines());
        steps += u32::from(host.instance().simulation().time() > time);
        if *host.instance().mode() == Mode::Terminated && random(10) == 0 {
            assert_eq!(unsafe { fmi2Reset(c) }, OK);
        }
        assert!(reals.iter().all(|v| !v.is_nan()), "{vr:?}");
        host.lines();
    }
    println!("{steps} steps");
    assert!(steps > 100);
}
