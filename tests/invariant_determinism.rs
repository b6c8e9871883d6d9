//! The same inputs give the same bits, however the host splits time, saves, restores or resets.

mod common;

use tissue::simulation::Simulation;

fn bits(s: &mut Simulation) -> Vec<u64> {
    let e = s.energy();
    let state = s.state();
    let mut all: Vec<u64> = (state.displacement.iter().chain(&state.velocity))
        .flat_map(|l| [l.0[0], l.0[1], l.0[2]].map(f64::to_bits))
        .collect();
    for tool in &state.tools {
        all.extend(
            tool.force
                .iter()
                .chain(tool.torque.iter())
                .map(|x| x.to_bits()),
        );
    }
    all.extend([e.elastic, e.kinetic, e.dissipated, e.tool_work].map(f64::to_bits));
    all.push(
        state
            .live
            .surface
            .iter()
            .fold(0u64, |h, f| h.wrapping_mul(31).wrapping_add(u64::from(*f))),
    );
    all
}

fn run(s: &mut Simulation, from: u32, to: u32) {
    for k in from..to {
        common::script(s, f64::from(k) * 1e-3);
        s.step(1e-3).unwrap();
    }
}

#[test]
fn reset_and_rerun_give_the_same_bits() {
    let mut s = common::simulation(common::BAR);
    run(&mut s, 0, 800);
    let first = bits(&mut s);
    s.reset();
    run(&mut s, 0, 800);
    assert_eq!(first, bits(&mut s));
}

/// Saved in contact, mid-cut, and restored into the same and into another instance.
#[test]
fn restored_equals_never_interrupted() {
    restored(common::BAR);
    for scheme in ["euler", "rungeKutta4", "implicitEuler"] {
        restored(&common::bar_with(scheme));
    }
    restored(&adaptive());
}

/// A part of it beyond the threshold.
fn adaptive() -> String {
    let model = r#"{"model": {"elasticity": "stVenantKirchhoff", "nonlinearThreshold": 0.0005},"#;
    common::BAR.replacen('{', model, 1)
}

fn restored(scene: &str) {
    let mut whole = common::simulation(scene);
    run(&mut whole, 0, 1100);
    let end = bits(&mut whole);
    for stop in [200, 480, 700, 760] {
        let mut s = common::simulation(scene);
        run(&mut s, 0, stop);
        let saved = s.save();
        let bytes = s.serialise(&saved);
        assert_eq!(bytes.len(), tissue::snapshot::size(&saved));
        run(&mut s, stop, 1000);
        s.restore(&saved);
        run(&mut s, stop, 1100);
        assert_eq!(end, bits(&mut s), "restored at {stop}");
        let mut other = common::simulation(scene);
        let restored = other.deserialise(&bytes).unwrap();
        assert!(other.serialise(&restored) == bytes);
        other.restore(&restored);
        run(&mut other, stop, 1100);
        assert_eq!(end, bits(&mut other), "deserialised at {stop}");
    }
}

/// Implicit Euler solves with a factor of the tissue before the last cuts: it is made again from the state.
#[test]
fn an_old_factor_is_restored() {
    let whole = common::bar_with("implicitEuler");
    let model = r#"{"model": {"kind": "hybrid", "dynamic":
        {"halfSpace": {"point": [0.03, 0, 0], "normal": [1, 0, 0]}}},"#;
    for scene in [whole.replacen('{', model, 1), whole] {
        let mut s = common::simulation(&scene);
        let mut stop = 0;
        let is_old = |s: &Simulation| s.state().factored.removed < s.state().live.removed.len();
        while stop < 900 && !(is_old(&s) && s.state().factored.removed > 0) {
            run(&mut s, stop, stop + 1);
            stop += 1;
        }
        assert!(is_old(&s));
        let bytes = s.serialise(s.state());
        let mut other = common::simulation(&scene);
        let restored = other.deserialise(&bytes).unwrap();
        other.restore(&restored);
        run(&mut s, stop, stop + 100);
        run(&mut other, stop, stop + 100);
        assert_eq!(bits(&mut s), bits(&mut other), "restored at {stop}");
    }
}

/// Parameters of the law that were changed since come back with the state, in forces as well.
#[test]
fn restored_parameters_act() {
    let penalised = r#"{"model": {"elasticity": "stVenantKirchhoff"},"#;
    let penalised = common::BAR.replacen('{', penalised, 1);
    for scene in [penalised, adaptive()] {
        let (mut s, mut left) = (common::simulation(&scene), common::simulation(&scene));
        run(&mut left, 0, 60);
        run(&mut s, 0, 30);
        let saved = s.save();
        match s.model().is_adaptive() {
            true => s.set_nonlinear_threshold(1e-5),
            false => s.set_incompressibility(1e5),
        }
        run(&mut s, 30, 40);
        s.restore(&saved);
        run(&mut s, 30, 60);
        assert_eq!(bits(&mut s), bits(&mut left));
    }
}

#[test]
fn damaged_bytes_are_refused() {
    use tissue::snapshot::SnapshotError::{Damaged, OtherModel, Version};
    let mut s = common::simulation(common::BAR);
    run(&mut s, 0, 700);
    let bytes = s.serialise(s.state());
    assert_eq!(s.deserialise(&[]), Err(Version));
    for cut in [9, 100, bytes.len() - 1] {
        assert_eq!(s.deserialise(&bytes[..cut]), Err(Damaged));
    }
    for place in [20, 1000, bytes.len() - 300] {
        let mut bad = bytes.clone();
        bad[place] ^= 1;
        assert_eq!(s.deserialise(&bad), Err(Damaged));
    }
    let other = common::simulation(&common::BAR.replace("500000", "500001"));
    assert_eq!(other.deserialise(&bytes), Err(OtherModel));
}

/// One straight path by derivatives, and rest: 10 x 1 ms = 1 x 10 ms = mixed.
#[test]
fn splitting_time_changes_no_bit() {
    split(common::BAR);
    split(&adaptive());
}

fn split(scene: &str) {
    let splits: [&[u32]; 3] = [&[1; 60], &[10; 6], &[3, 7, 20, 1, 1, 28]];
    let mut results = Vec::new();
    for split in splits {
        let mut s = common::simulation(scene);
        // Down at 0.2 m/s into the tissue, from 0.036 m.
        s.set_pose_input(0, 2, 0.036);
        s.place_tools().unwrap();
        let mut ms = 0;
        for length in split {
            s.set_pose_input(0, 2, 0.036 - 0.2 * (f64::from(ms) * 1e-3));
            s.set_pose_rate(0, 2, -0.2);
            s.step(f64::from(*length) * 1e-3).unwrap();
            ms += length;
        }
        assert_eq!(ms, 60);
        assert!(s.tool(0).in_contact && s.tool(0).force.z > 0.0);
        results.push(bits(&mut s));
    }
    assert!(results.iter().all(|r| *r == results[0]));
}

/// Where the host's step is no whole number of substeps, n substeps of H/n are taken.
#[test]
fn steps_are_divided_as_the_contract_says() {
    use tissue::step::division;
    assert_eq!(division(1e-3, 2.5e-4), (4, 2.5e-4));
    assert_eq!(division(1e-3 * (1.0 + 1e-13), 2.5e-4), (4, 2.5e-4));
    assert_eq!(division(1.1e-3, 2.5e-4), (5, 1.1e-3 / 5.0));
    assert_eq!(division(1e-5, 2.5e-4), (1, 1e-5));
}
