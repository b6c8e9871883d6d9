//! Each scheme's order and critical step, on a mesh.

mod common;

use tissue::mesh::Vec3;
use tissue::model::{Model, critical_step};
use tissue::scene::Scheme;
use tissue::simulation::Simulation;
use tissue::state::{Factored, State};
use tissue::step::{Workspace, advance};

/// The bar without cautery, so that its substep is limited by its own spectrum.
fn bar(scheme: &str, damping: f64, substep: f64) -> Simulation {
    let cautery = common::BAR.find(r#"{"name": "cautery""#).unwrap();
    let end = common::BAR.find("],\n  \"outputs\"").unwrap();
    let text = format!(
        "{}{}",
        common::BAR[..cautery].trim_end().trim_end_matches(','),
        &common::BAR[end..]
    );
    let rate = 1.0 / (2.0 * substep);
    common::simulation(&text.replace(
        "\"tools\"",
        &format!(
            r#""integration": {{"scheme": "{scheme}", "damping": {damping}, "substep": {substep:e}, "hapticRate": {rate:e}}}, "tools""#
        ),
    ))
}

fn displacement(s: &Simulation) -> Vec<Vec3> {
    s.state().displacement.iter().map(|u| u.xyz()).collect()
}

/// Falling into its sag: at 10 ms, against the shortest substep that the haptic rate's range allows, extrapolated.
#[test]
fn observed_orders() {
    for (scheme, order) in [("symplecticEuler", 1.0), ("centralDifference", 2.0)] {
        let at = |parts: u32| {
            let mut s = bar(scheme, 30.0, 1e-4 / f64::from(parts));
            for _ in 0..100 * parts / 2 {
                s.step(2e-4 / f64::from(parts)).unwrap();
            }
            assert!((s.time() - 0.01).abs() < 1e-12);
            displacement(&s)
        };
        let (near, nearer) = (at(10), at(20));
        let weight = f64::from(1 << order as u32);
        let exact: Vec<Vec3> = (near.iter().zip(&nearer))
            .map(|(a, b)| b + (b - a) / (weight - 1.0))
            .collect();
        let error = |parts: u32| {
            let u = at(parts);
            u.iter()
                .zip(&exact)
                .map(|(a, b)| (a - b).norm())
                .fold(0.0, f64::max)
        };
        let (coarse, fine) = (error(2), error(4));
        let observed = (coarse / fine).log2();
        assert!((observed - order).abs() < 0.15, "{scheme}: {observed}");
    }
}

/// Past where symplectic Euler's limit falls with damping, central difference keeps 2/omega.
#[test]
fn central_difference_keeps_its_limit_under_damping() {
    let omega = bar("centralDifference", 1.0, 1e-5).model().spectrum.highest;
    let damping = 0.6 * omega;
    let limit = critical_step::central_difference(omega);
    assert!(critical_step::symplectic_euler(omega, damping) < 0.8 * limit);
    let mut s = bar("centralDifference", damping, 0.999 * limit);
    let length = 2.0 * s.state().nominal_substep;
    for _ in 0..5000 {
        s.step(length).unwrap();
        assert_eq!(s.halvings(), 0);
    }
    assert!(displacement(&s).iter().all(|u| u.norm() < 0.02));
    let mut s = bar("centralDifference", damping, 1.01 * limit);
    s.step(2.0 * s.state().nominal_substep).unwrap();
    assert_eq!(s.halvings(), 1);
}

/// Communication steps of changing length feed no mode: the plate settles all the same.
#[test]
fn uneven_steps_stay_stable() {
    let plate = r#"{"name": "plate", "mesh": {"box": {"size": [0.22, 0.1, 0.02], "cells": [22, 10, 2]}},
        "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}],
        "gravity": [0, 0, -1], "fixed": [{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}},
        {"box": {"min": [0.22, 0, 0], "max": [0.22, 1, 1]}}]}"#;
    let reference = tissue::reference::solve(&common::model(plate), false).unwrap();
    let patterns: [&[f64]; 5] = [
        &[1e-3, 1.5e-3],
        &[1e-3, 0.7e-3, 0.8e-3],
        &[1e-3, 0.4e-3],
        &[1e-3, 0.75e-3, 0.75e-3],
        &[],
    ];
    for pattern in patterns {
        let mut s = common::simulation(plate);
        let mut seed = 7u64;
        for k in 0..6000 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let random = 0.5e-3 + 2.5e-3 * (seed >> 40) as f64 / (1u64 << 24) as f64;
            s.step(
                pattern
                    .get(k % pattern.len().max(1))
                    .copied()
                    .unwrap_or(random),
            )
            .unwrap();
            assert_eq!(s.halvings(), 0);
        }
        let energy = s.energy();
        let residual = energy.balance() - s.state().account.start;
        assert!(
            residual.abs() < 1e-10 * energy.dissipated,
            "{pattern:?}: {residual:e}"
        );
        let (mut worst, mut scale) = (0.0f64, 0.0f64);
        for (k, node) in s.model().node.iter().enumerate() {
            let exact = Vec3::from(reference.displacement[k]);
            worst = worst.max((s.state().displacement[*node as usize].xyz() - exact).norm());
            scale = scale.max(exact.norm());
        }
        assert!(
            worst < 1e-6 * scale,
            "{pattern:?}: {worst:e} of {scale:e} m"
        );
    }
}

/// A scene's own substep of 0.9 of the critical one is fed by steps of two lengths: the watchdog says so
/// before the tissue is anywhere near leaving the room.
#[test]
fn what_uneven_steps_make_trips_the_watchdog() {
    let plate = |integration: &str| {
        format!(
            r#"{{"name": "plate", "mesh": {{"box": {{"size": [0.22, 0.1, 0.02], "cells": [22, 10, 2]}}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}}],
            "gravity": [0, 0, -1], "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}]{integration}}}"#
        )
    };
    let critical = critical_step::central_difference(common::model(&plate("")).spectrum.highest);
    let substep = 0.9 * critical;
    let rate = 1.0 / substep;
    let mut s = common::simulation(&plate(&format!(
        r#", "integration": {{"substep": {substep:e}, "hapticRate": {rate:e}, "damping": 0}}"#
    )));
    let mut told = false;
    for k in 0..4000 {
        let outcome = s.step(if k % 2 == 0 { substep } else { 1.5 * substep });
        told |= outcome.is_err() || s.halvings() > 0;
        let farthest = displacement(&s)
            .iter()
            .map(|u| u.norm())
            .fold(0.0, f64::max);
        assert!(farthest < 3.0, "{farthest} m at step {k}, told: {told}");
        if outcome.is_err() {
            break;
        }
    }
    assert!(told);
}

/// Contact and cutting at the haptic rate or faster, whatever the communication step.
#[test]
fn haptic_ticks_never_fall_behind() {
    for length in [1e-3, 0.99e-3, 0.9e-3, 0.37e-3, 2.3e-3] {
        let mut s = common::simulation(common::BAR);
        let (mut ticks, mut before) = (0, f64::INFINITY);
        // A step of less than a substep each, so that each tick is seen.
        let part = length / (length / s.state().nominal_substep).ceil();
        for _ in 0..((0.1 / part) as u32) {
            s.step(part).unwrap();
            let since = s.state().since_haptic;
            ticks += u32::from(since <= before);
            before = since;
        }
        assert!(
            f64::from(ticks) >= 0.1 / 1e-3 - 1.0,
            "{length}: {ticks} in 0.1 s"
        );
    }
}

/// A short bar, held at one end, nothing pulling: integration and model as given.
fn block(scheme: &str, more: &str) -> std::sync::Arc<Model> {
    common::model(&format!(
        r#"{{"name": "block", "mesh": {{"box": {{"size": [0.08, 0.02, 0.02], "cells": [8, 2, 2]}}}},
        "materials": [{{"where": {{"all": true}}, "youngModulus": 20000, "poissonRatio": 0.3, "density": 1000}}],
        "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}], "start": "equilibrium",
        "integration": {{"scheme": "{scheme}", "damping": 8}}{more}}}"#
    ))
}

const HYBRID: &str = r#", "model": {"kind": "hybrid", "dynamic":
    {"halfSpace": {"point": [0.04, 0, 0], "normal": [1, 0, 0]}}}"#;

/// Let go from its sag, gravity gone, at a time \[s\] after so many substeps.
fn let_go(model: &Model, time: f64, substeps: u64) -> State {
    let mut state = State::new(model);
    state.parameters.gravity = [0.0; 3];
    state.refresh_all(model);
    state.account.start = state.energy(model).balance();
    let mut work = Workspace::new(model, &state);
    advance(
        model,
        &mut state,
        &mut work,
        substeps,
        time / substeps as f64,
    )
    .unwrap();
    state
}

fn distance(model: &Model, a: &State, b: &State) -> f64 {
    (a.displacement.iter().zip(&b.displacement))
        .take(model.parts.moving)
        .map(|(a, b)| (a.xyz() - b.xyz()).norm())
        .fold(0.0, f64::max)
}

/// Free vibration over a third of the slowest period, whole and hybrid.
#[test]
fn orders_of_free_vibration() {
    for (scheme, order, parts) in [
        ("euler", 1.0, 16_000),
        ("symplecticEuler", 1.0, 1000),
        ("implicitEuler", 1.0, 8000),
        ("centralDifference", 2.0, 500),
        ("rungeKutta4", 4.0, 500),
    ] {
        for more in ["", HYBRID] {
            let model = block(scheme, more);
            let exact = let_go(&block("rungeKutta4", more), 0.05, 4000);
            let error = |n: u64| distance(&model, &let_go(&model, 0.05, n), &exact);
            let size = error(1).max(1e-3);
            let (coarse, fine) = (error(parts), error(2 * parts));
            let observed = (coarse / fine).log2();
            println!("{scheme}{more}: {observed} ({coarse:e}, {fine:e} of {size:e})");
            assert!(
                (observed - order).abs() < 0.15,
                "{scheme}{more}: {observed} ({coarse:e}, {fine:e})"
            );
        }
    }
}

/// Whether the mesh runs away at a share of the critical step, all modes having been set going.
fn runs_away(model: &Model, zeta: f64, share: f64) -> bool {
    let omega = model.spectrum.highest;
    let damping = 2.0 * zeta * omega;
    let h = share * critical_step::of(model.scheme(), omega, damping);
    let mut state = State::new(model);
    state.parameters.gravity = [0.0; 3];
    state.parameters.damping = damping;
    let mut seed = 11u64;
    for i in 0..model.parts.moving {
        for axis in (0..3).filter(|a| model.boundary.free[i][*a]) {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            state.displacement[i].0[axis] =
                1e-6 * ((seed >> 40) as f64 / (1u64 << 24) as f64 - 0.5);
        }
    }
    state.refresh_all(model);
    state.clock.substep = h;
    state.clock.lag = if model.is_staggered() { h } else { 0.0 };
    state.account.start = state.energy(model).balance();
    let mut work = Workspace::new(model, &state);
    for _ in 0..40 {
        if advance(model, &mut state, &mut work, 1000, h).is_err() {
            return true;
        }
        let largest = (state.displacement.iter())
            .map(|u| u.xyz().norm())
            .fold(0.0, f64::max);
        if largest > 1e-3 {
            return true;
        }
    }
    false
}

/// The table of limits: what the functions say is what a mesh does.
#[test]
fn critical_steps_are_those_of_the_mesh() {
    for scheme in [
        "euler",
        "symplecticEuler",
        "centralDifference",
        "rungeKutta4",
    ] {
        let model = block(scheme, "");
        for zeta in [0.0, 0.14, 0.35, 0.5, 0.8, 1.0] {
            if scheme == "euler" && zeta == 0.0 {
                continue;
            }
            assert!(!runs_away(&model, zeta, 0.99), "{scheme}, zeta {zeta}");
            assert!(runs_away(&model, zeta, 1.01), "{scheme}, zeta {zeta}");
        }
    }
    // Any step will do: a second where the slowest mode takes a seventh of one.
    let model = block("implicitEuler", "");
    for zeta in [0.0, 0.35] {
        let omega = model.spectrum.highest;
        let mut state = let_go(&model, 0.01, 1);
        state.parameters.damping = 2.0 * zeta * omega;
        let mut work = Workspace::new(&model, &state);
        let before = state.energy(&model).elastic;
        advance(&model, &mut state, &mut work, 100, 1000.0 / omega).unwrap();
        assert!(state.energy(&model).elastic < before);
    }
}

/// "Runge-Kutta 4 takes steps ten times Euler's, a speed-up of two": near zeta = .14 alone.
#[test]
fn where_runge_kutta_4_is_worth_it() {
    let omega = 700.0;
    let limits = |zeta: f64| {
        let of = |scheme| critical_step::of(scheme, omega, 2.0 * zeta * omega);
        (
            of(Scheme::RungeKutta4),
            of(Scheme::Euler),
            of(Scheme::SymplecticEuler),
        )
    };
    let (fourth, first, symplectic) = limits(0.14);
    let ratio = fourth / first;
    assert!(
        (ratio - 10.5).abs() < 0.1 && (ratio / 4.0 - 2.6).abs() < 0.05,
        "{ratio}"
    );
    // Symplectic Euler beats it for each force evaluation.
    assert!(symplectic / (fourth / 4.0) > 2.2);
    let (fourth, first, symplectic) = limits(0.001);
    assert!(fourth / first > 1000.0);
    let gain = symplectic / (fourth / 4.0);
    assert!((2.7..2.9).contains(&gain), "{gain}");
    let (fourth, first, _) = limits(0.5);
    assert!(fourth / first / 4.0 < 0.7);
}

/// Runge-Kutta 4 books damping, supports and growing loads to its own order.
#[test]
fn the_account_of_runge_kutta_4_closes_to_fourth_order() {
    let moved = r#", "prescribed": [{"where": {"box": {"min": [0.08, 0, 0], "max": [0.08, 1, 0]}},
        "displacement": [null, null, 0.002], "ramp": 0.064}],
        "loads": [{"where": {"box": {"min": [0.04, 0, 0.02], "max": [0.08, 1, 0.02]}}, "force": [0, 0.001, 0.002],
        "ramp": 0.064}, {"where": {"box": {"min": [0.01, 0, 0.02], "max": [0.03, 1, 0.02]}}, "force": [0, 0, 0.004],
        "ramp": 0.064}]"#;
    for more in [moved.to_string(), format!("{moved}{HYBRID}")] {
        // From rest: equilibrium would end the ramps.
        let scene = |kind: &str| block(kind, &more).scene.clone();
        let scene = tissue::scene::Scene {
            start: tissue::scene::Start::Rest,
            ..scene("rungeKutta4")
        };
        let model = block("rungeKutta4", &more).with_scene(scene).unwrap();
        let off = |n: u64| {
            let state = let_go(&model, 0.064, n);
            let energy = state.energy(&model);
            assert!(energy.support_work.abs() > 1e-6);
            assert!(energy.dissipated > 1e-6);
            // All that the substeps before have missed, and the last one.
            let missed = energy.balance() - state.account.start;
            (state.account.made + missed).abs()
        };
        let (coarse, fine) = (off(256), off(512));
        let order = (coarse / fine).log2();
        println!("{coarse:e} {fine:e} {order}");
        assert!(order > 3.7, "{coarse:e} {fine:e}: {order}");
    }
}

/// After a cut the old factor and iterations give what a new factor gives.
#[test]
fn an_old_factor_solves_for_cut_tissue() {
    let cut = r#", "cuts": [{"time": 0.02, "where": {"box": {"min": [0.03, 0, 0.01], "max": [0.04, 1, 1]}}},
        {"time": 0.03, "where": {"box": {"min": [0.06, 0, 0.01], "max": [0.07, 0.01, 1]}}}]"#;
    for more in [
        cut.to_string(),
        format!(
            "{}{HYBRID}",
            cut.replace("0.03, 0, 0.01", "0.045, 0, 0.01")
                .replace("0.04, 1, 1", "0.055, 1, 1")
        ),
    ] {
        let model = block("implicitEuler", &more);
        let mut old = State::new(&model);
        let mut work = Workspace::new(&model, &old);
        advance(&model, &mut old, &mut work, 31, 1e-3).unwrap();
        let removed = old.live.removed.len();
        assert!(
            removed > 10 && old.factored.removed < removed,
            "{:?} {removed}",
            old.factored
        );
        let mut new = old.clone();
        new.factored = Factored { removed, spent: 0 };
        let mut fresh = Workspace::new(&model, &new);
        let mut compared = 0;
        while old.factored.removed < removed {
            let spent = old.factored.spent;
            advance(&model, &mut old, &mut work, 1, 1e-3).unwrap();
            advance(&model, &mut new, &mut fresh, 1, 1e-3).unwrap();
            if old.factored.removed == removed {
                break;
            }
            assert!(old.factored.spent >= spent + 2, "{:?}", old.factored);
            assert_eq!((new.factored.spent, fresh.iterations), (0, 1));
            assert!(work.iterations > 2);
            let size = distance(&model, &old, &State::new(&model));
            let off = distance(&model, &old, &new);
            assert!(off < 1e-8 * size, "{off:e} of {size:e}");
            compared += 1;
        }
        println!("compared {compared}, {:?}", old.factored);
        assert!(compared > 0);
        // In time a new factor is worth it, and then one iteration does.
        advance(&model, &mut old, &mut work, 60, 1e-3).unwrap();
        assert_eq!(old.factored, Factored { removed, spent: 0 });
    }
}

/// Stiff tissue runs by default, and settles where it should.
#[test]
fn stiff_tissue_runs_by_default() {
    let stiff = |modulus: f64| common::BAR.replace("500000", &format!("{modulus}"));
    for (text, scheme) in [
        (common::BAR.to_string(), Scheme::SymplecticEuler),
        (stiff(1e8), Scheme::ImplicitEuler),
        (stiff(1e10), Scheme::ImplicitEuler),
    ] {
        let mut s = common::simulation(&text);
        assert_eq!(s.model().scheme(), scheme);
        if scheme != Scheme::ImplicitEuler {
            continue;
        }
        assert_eq!(s.state().nominal_substep, 1e-3);
        for _ in 0..200 {
            s.step(1e-3).unwrap();
            assert_eq!(s.halvings(), 0);
        }
        let reference = tissue::reference::solve(s.model(), false).unwrap();
        for (k, node) in s.model().node.iter().enumerate() {
            let exact = Vec3::from(reference.displacement[k]);
            let off = (s.state().displacement[*node as usize].xyz() - exact).norm();
            assert!(off < 1e-6 * 0.1, "{off:e}");
        }
        // Pressed, grasped, cut and dropped.
        for k in 0..1200 {
            common::script(&mut s, f64::from(k) * 1e-3);
            s.step(1e-3).unwrap();
        }
        assert!(s.state().live.removed.len() > 10);
    }
}
