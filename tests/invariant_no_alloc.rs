//! Nothing allocates in a step: not in substeps, nor in contact, nor while cutting or tearing.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    /// Of this thread: the test harness has one of its own, which tells of slow tests.
    static CALLS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: hands everything to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.set(CALLS.get() + 1);
        // SAFETY: as called.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as called.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_step_allocates_nothing() {
    let hybrid = r#"{"model": {"kind": "hybrid", "dynamic":
        {"halfSpace": {"point": [0.05, 0, 0], "normal": [1, 0, 0]}}},"#;
    let springs = r#"{"model": {"kind": "springMass"},"#;
    let venant = r#"{"model": {"elasticity": "stVenantKirchhoff", "element": "constantStrain"},"#;
    let hookean = r#"{"model": {"elasticity": "stableNeoHookean", "element": "constantStrain"},"#;
    let averaged = r#"{"model": {"elasticity": "stableNeoHookean"},"#;
    let polynomial = r#"{"model": {"elasticity": "stVenantKirchhoff", "form": "polynomial"},"#;
    let pressed = r#"{"model": {"elasticity": "stVenantKirchhoff", "element": "nodalPressure"},"#;
    let duplicate = r#"{"model": {"element": "nodalAveraged"}, "cutting": {"rule": "duplicate"},"#;
    let pressed_duplicate = r#"{"model": {"elasticity": "stVenantKirchhoff", "element": "nodalPressure"},
        "cutting": {"rule": "duplicate"},"#;
    let adaptive =
        r#"{"model": {"elasticity": "stVenantKirchhoff", "nonlinearThreshold": 0.0003},"#;
    let tearing = r#"{"tearing": {"criterion": "maximumElongation", "threshold": 0.052},"#;
    let torn = r#"{"model": {"kind": "springMass"}, "tearing": {"criterion": "maximumElongation", "threshold": 0.052},"#;
    for (scheme, model) in [
        ("symplecticEuler", "{"),
        ("centralDifference", "{"),
        ("euler", "{"),
        ("rungeKutta4", "{"),
        ("implicitEuler", "{"),
        ("symplecticEuler", hybrid),
        ("symplecticEuler", springs),
        ("rungeKutta4", springs),
        ("rungeKutta4", hybrid),
        ("implicitEuler", hybrid),
        ("symplecticEuler", venant),
        ("symplecticEuler", averaged),
        ("symplecticEuler", polynomial),
        ("symplecticEuler", pressed),
        ("symplecticEuler", duplicate),
        ("rungeKutta4", pressed_duplicate),
        ("symplecticEuler", adaptive),
        ("rungeKutta4", hookean),
        ("symplecticEuler", tearing),
        ("rungeKutta4", torn),
    ] {
        let mut s = common::simulation(&common::bar_with(scheme).replacen('{', model, 1));
        let (mut contacts, mut worst, mut factors, mut removed) = (0, 0, 0, 0);
        let mut factored = None;
        for k in 0..1200 {
            common::script(&mut s, f64::from(k) * 1e-3);
            let before = CALLS.get();
            s.step(1e-3).unwrap();
            let calls = CALLS.get() - before;
            // A new factor is the exception.
            if scheme == "implicitEuler"
                && factored.replace(s.state().factored.removed) != Some(s.state().factored.removed)
            {
                factors += 1;
            } else {
                worst = worst.max(calls);
            }
            contacts += u32::from(s.tool(0).in_contact || s.tool(1).in_contact);
            if k == 590 {
                removed = s.state().live.removed.len();
            }
        }
        println!(
            "{scheme}: {worst} calls, {factors} factors, {removed} torn before the cautery is on"
        );
        assert_eq!(removed > 0, model.contains("tearing"));
        assert_eq!(worst, 0, "{scheme}");
        assert!(factors < 60 && contacts > 100 && s.state().live.removed.len() > 10);
    }
}

/// Nor does a haptic loop that asks for stiffness and slopes at every step, once it has asked with this contact.
#[test]
fn a_tangent_allocates_nothing() {
    let hybrid = r#"{"model": {"kind": "hybrid", "dynamic":
        {"halfSpace": {"point": [0.05, 0, 0], "normal": [1, 0, 0]}}},"#;
    let venant = r#"{"model": {"elasticity": "stVenantKirchhoff"},"#;
    for (scheme, model) in [
        ("symplecticEuler", "{"),
        ("rungeKutta4", hybrid),
        ("implicitEuler", "{"),
        ("symplecticEuler", venant),
    ] {
        let mut s = common::simulation(&common::bar_with(scheme).replacen('{', model, 1));
        for k in 0..40 {
            s.set_active(1, true);
            s.set_pose_input(1, 0, 0.1 + 1e-5 * f64::from(k));
            s.step(1e-3).unwrap();
            let before = CALLS.get();
            for component in 0..7 {
                let column = s.tangent(1, 1, component).unwrap();
                assert!(column.iter().any(|x| *x != 0.0));
            }
            s.step(1e-3).unwrap();
            let calls = CALLS.get() - before;
            assert!(calls == 0 || k == 0, "{scheme} {model}: {calls} at {k}");
        }
    }
}

/// Nor does a tool that slides, on tissue with mass or without.
#[test]
fn what_slides_allocates_nothing() {
    let hybrid = r#"{"model": {"kind": "hybrid", "dynamic":
        {"halfSpace": {"point": [0.05, 0, 0], "normal": [1, 0, 0]}}},"#;
    let quasi_static = r#"{"model": {"kind": "quasiStatic"},"#;
    for model in ["{", hybrid, quasi_static] {
        let text = common::bar_with("symplecticEuler")
            .replacen('{', model, 1)
            .replace(
                r#""probe", "shape""#,
                r#""probe", "friction": 0.3, "shape""#,
            );
        let mut s = common::simulation(&text);
        let (mut worst, mut touches) = (0, 0);
        for k in 0..400 {
            common::script(&mut s, f64::from(k) * 1e-3);
            let before = CALLS.get();
            s.step(1e-3).unwrap();
            worst = worst.max(CALLS.get() - before);
            touches += u32::from(s.tool(0).in_contact);
        }
        println!("{model}: {worst} calls, {touches} steps in contact");
        assert!(worst == 0 && touches > 40, "{model} {worst} {touches}");
    }
}

/// Nor does it allocate to fall asleep, to sleep or to wake.
#[test]
fn sleep_allocates_nothing() {
    let hybrid = r#"{"model": {"kind": "hybrid", "dynamic":
        {"halfSpace": {"point": [0.05, 0, 0], "normal": [1, 0, 0]}}},"#;
    for model in ["{", hybrid] {
        let mut s = common::simulation(&common::BAR.replacen('{', model, 1));
        s.step(1e-3).unwrap();
        let (mut asleep, before) = (0, CALLS.get());
        for _ in 0..1200 {
            s.step(1e-3).unwrap();
            asleep += u32::from(s.state().sleep.asleep);
        }
        s.set_pose_input(0, 0, 0.041);
        s.step(1e-3).unwrap();
        assert!(asleep > 100 && !s.state().sleep.asleep);
        assert_eq!(CALLS.get(), before);
    }
}
