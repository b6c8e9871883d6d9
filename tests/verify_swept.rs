//! Fast tools: what they meet they take along, or tear, and do not pass through.

mod common;

use tissue::mesh::Vec3;
use tissue::simulation::Simulation;

const RADIUS: f64 = 0.003;
const SPEED: f64 = 2.0;

/// A sheet of 4 mm held at its rim, a ball 10 mm above it.
fn sheet(young_modulus: u32, friction: &str, settings: &str) -> Simulation {
    let text = format!(
        r#"{{"name": "sheet", "mesh": {{"box": {{"size": [0.06, 0.06, 0.004], "cells": [24, 24, 2]}}}},
  "materials": [{{"where": {{"all": true}}, "youngModulus": {young_modulus}, "poissonRatio": 0.45, "density": 1060}}],
  "fixed": [{{"not": {{"box": {{"min": [0.001, 0.001, -1], "max": [0.059, 0.059, 1]}}}}}}], {settings}
  "tools": [{{"name": "probe", "kind": "probe", "shape": {{"sphere": {{"radius": {RADIUS}}}}}, "friction": {friction},
    "position": [0.0307, 0.0302, 0.014]}}]}}"#
    );
    common::simulation(&text)
}

/// Of any point of the surface that can be deepest, and where [m].
fn deepest(s: &Simulation) -> f64 {
    let (model, state) = (s.model(), s.state());
    let centre = state.tools[0].pose.position;
    let mut deepest = 0.0f64;
    for face in &state.live.surface {
        let x = state.live.triangle(model, *face).map(|v| state.position(v));
        for k in 0..=10 {
            for l in 0..=10 - k {
                let [a, b] = [f64::from(k) / 10.0, f64::from(l) / 10.0];
                let place: Vec3 = x[0] * (1.0 - a - b) + x[1] * a + x[2] * b;
                deepest = deepest.max(RADIUS - (place - centre).norm());
            }
        }
    }
    deepest
}

/// Through a sheet at 2 m/s, in communication steps of 10 ms and in such of 1 ms to see more of it. Faster than shear waves, so
/// that a frictionless ball leaves one tetrahedron of averaged elements at det F = -0.001.
#[test]
fn nothing_passes_through_a_sheet() {
    const TEAR: &str = r#""tearing": {"criterion": "maximumElongation", "threshold": 0.6},"#;
    let (constant, averaged) = ("constantStrain", "nodalAveraged");
    for (young_modulus, law, element, friction, tear) in [
        (6000, "stableNeoHookean", constant, "0", ""),
        (6000, "stableNeoHookean", constant, "0.3", ""),
        (6000, "stableNeoHookean", averaged, "0.3", ""),
        (6000, "stableNeoHookean", constant, "0", TEAR),
        (20000, "stableNeoHookean", constant, "\"stick\"", ""),
        (6000, "linear", constant, "\"stick\"", TEAR),
    ] {
        for step in [1e-2, 1e-3] {
            let settings =
                format!(r#""model": {{"elasticity": "{law}", "element": "{element}"}}, {tear}"#);
            let mut s = sheet(young_modulus, friction, &settings);
            let (mut most, mut least, mut moved) = (0.0f64, 1.0f64, 0.0f64);
            // 22 mm past the sheet's upper side.
            for k in 0..(0.015 / step) as u32 {
                s.set_pose_input(0, 2, 0.014 - SPEED * f64::from(k) * step);
                s.set_pose_rate(0, 2, -SPEED);
                s.step(step).unwrap();
                most = most.max(deepest(&s) / RADIUS);
                least = least.min(s.minimum_volume_ratio());
                let down = s.state().displacement.iter().map(|u| -u.0[2]);
                moved = moved.max(down.fold(0.0, f64::max));
            }
            let removed = s.state().live.removed.len();
            println!(
                "{young_modulus} Pa {law} {element} {friction} {step} s: {most:.3} R deep, det F {least:.3}, moved {:.1} mm, {removed} torn",
                1e3 * moved
            );
            assert!(most < 0.1 && least > 0.0, "{most} {least}");
            let way = SPEED * (0.015 / step).floor() * step - 0.01 - RADIUS;
            assert!(moved > 0.8 * way, "{moved}");
            assert_eq!(removed > 0, !tear.is_empty());
        }
    }
}
