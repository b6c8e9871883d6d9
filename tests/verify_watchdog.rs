//! A substep past the critical one is halved, and given up only when that does not help.

mod common;

use tissue::simulation::Simulation;
use tissue::step::StepError;

fn pulled(substeps_per_critical: f64) -> Simulation {
    let model = common::model(common::BAR);
    let critical =
        tissue::model::critical_step::symplectic_euler(model.spectrum.highest, model.damping());
    // A haptic period of a whole number of substeps.
    let substep = substeps_per_critical * critical;
    let rate = 1.0 / (4.0 * substep);
    let text = common::BAR.replace(
        "\"tools\"",
        &format!(r#""integration": {{"substep": {substep:e}, "hapticRate": {rate:e}, "damping": {}}}, "tools""#, model.damping()),
    );
    common::simulation(&text)
}

/// Runs 0.3 s; the number of steps that were halved, or the error.
fn run(s: &mut Simulation) -> Result<u32, StepError> {
    let length = 4.0 * s.state().nominal_substep;
    let mut halved = 0;
    while s.time() < 0.3 {
        s.step(length)?;
        halved += s.halvings().min(1);
        assert!(
            s.energy().balance().is_finite() && s.surface_vertex(5).iter().all(|x| x.is_finite())
        );
    }
    Ok(halved)
}

#[test]
fn below_the_critical_step_nothing_is_halved() {
    assert_eq!(run(&mut pulled(0.999)), Ok(0));
}

#[test]
fn twice_the_critical_step_is_put_right_by_halving() {
    let mut s = pulled(2.0);
    let halved = run(&mut s).unwrap();
    assert!(halved > 100, "{halved}");
    let reference = tissue::reference::solve(s.model(), false).unwrap();
    // Still on the way to the right place: no energy was made.
    let sag = reference
        .displacement
        .iter()
        .map(|u| u[2])
        .fold(0.0, f64::min);
    let lowest = s
        .state()
        .displacement
        .iter()
        .map(|u| u.0[2])
        .fold(0.0, f64::min);
    assert!(lowest > 2.1 * sag, "{lowest} {sag}");
}

#[test]
fn a_hopeless_substep_is_discarded_with_the_state_kept() {
    let mut s = pulled(100.0);
    let length = 4.0 * s.state().nominal_substep;
    let mut refused = None;
    for _ in 0..2 {
        let before = s.save();
        if let Err(error) = s.step(length) {
            assert!(
                s.serialise(s.state()) == s.serialise(&before),
                "the state changed"
            );
            refused = Some(error);
            break;
        }
    }
    assert!(
        matches!(refused, Some(StepError::Unstable(..))),
        "{refused:?}"
    );
    // The host may try a shorter step; that one is well below the critical step.
    for _ in 0..50 {
        s.step(length / 1000.0).unwrap();
    }
}

#[test]
fn steps_that_are_no_steps_are_refused() {
    let mut s = common::simulation(common::BAR);
    for length in [0.0, -1e-3, f64::NAN, f64::INFINITY] {
        assert!(matches!(s.step(length), Err(StepError::Length(_))));
    }
    assert!(matches!(s.step(1e9), Err(StepError::TooLong(..))));
    s.set_pose_input(1, 3, 0.0);
    s.set_pose_input(1, 5, 0.0);
    assert_eq!(s.step(1e-3), Err(StepError::Orientation(2)));
    assert_eq!(s.time(), 0.0);
}

/// Nothing can move: no limit, no number that is none.
#[test]
fn a_scene_that_is_held_all_over_runs() {
    let text = common::BAR.replace(
        r#"{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}"#,
        r#"{"all": true}"#,
    );
    let mut s = common::simulation(&text);
    s.step(1e-3).unwrap();
    assert!(s.critical_substep().is_finite() && s.energy().balance() == 0.0);
    let inspection = tissue::inspect::inspect(s.model());
    assert_eq!(inspection.critical_step["symplecticEuler"], None);
}

/// Without damping explicit Euler has no stable substep, and says so.
#[test]
fn explicit_euler_without_damping_is_refused() {
    let mut s = common::simulation(&common::bar_with("euler"));
    s.step(1e-4).unwrap();
    s.set_damping(0.0);
    assert_eq!(s.critical_substep(), 0.0);
    let before = s.save();
    assert!(matches!(s.step(1e-4), Err(StepError::Unstable(..))));
    assert!(s.state() == &before);
    s.set_damping(1000.0);
    s.step(1e-4).unwrap();
}
