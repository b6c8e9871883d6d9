//! Each scheme's order and critical step, on a mesh.

mod common;

use tissue::mesh::Vec3;
use tissue::model::critical_step;
use tissue::simulation::Simulation;

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
