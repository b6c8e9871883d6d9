//! Scenes that several tests share.
#![allow(dead_code)] // each test binary uses a part

use std::path::Path;
use std::sync::Arc;

use tissue::model::Model;
use tissue::simulation::Simulation;

pub fn model(text: &str) -> Arc<Model> {
    let scene = tissue::scene::parse(text, "scene.json").unwrap();
    Arc::new(tissue::prepared::prepare(scene, Path::new("scene.json")).unwrap())
}

pub fn simulation(text: &str) -> Simulation {
    Simulation::new(model(text))
}

/// A bar of 0.1 x 0.02 x 0.02 m along x, held at x = 0, with a probe above its middle, a grasper at its
/// free end and a cautery beside it.
pub const BAR: &str = r#"{
  "name": "bar", "mesh": {"box": {"size": [0.1, 0.02, 0.02], "cells": [15, 3, 3]}},
  "materials": [{"where": {"all": true}, "youngModulus": 500000, "poissonRatio": 0.4, "density": 1000}],
  "fixed": [{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}],
  "tools": [
    {"name": "probe", "kind": "probe", "shape": {"sphere": {"radius": 0.006}}, "position": [0.04, 0.01, 0.05]},
    {"name": "grasper", "kind": "grasper", "shape": {"capsule": {"radius": 0.004, "length": 0.1}},
     "activeLength": 0.01, "position": [0.1, 0.01, 0.01], "orientation": [0.7071067811865476, 0, -0.7071067811865476, 0]},
    {"name": "cautery", "kind": "cautery", "shape": {"capsule": {"radius": 0.002, "length": 0.1}},
     "activeLength": 0.03, "position": [0.06, -0.02, -0.01], "orientation": [0, 1, 0, 0]}],
  "outputs": {"triangles": true}
}"#;

/// [`BAR`] with another scheme: softer and damped for explicit Euler, which would take a microsecond at a
/// time.
pub fn bar_with(scheme: &str) -> String {
    let (more, young_modulus) = match scheme {
        "euler" => (r#", "damping": 1000"#, "50000"),
        _ => ("", "500000"),
    };
    let integration = format!(r#""integration": {{"scheme": "{scheme}"{more}}}, "tools""#);
    BAR.replace("500000", young_modulus)
        .replace("\"tools\"", &integration)
}

/// Poses and switches of [`BAR`]'s tools at a time: settle, press and lift, grasp and pull, cut off, drop.
pub fn script(simulation: &mut Simulation, time: f64) {
    let ramp = |from: f64, to: f64| ((time - from) / (to - from)).clamp(0.0, 1.0);
    let sag = -0.004 * ramp(0.0, 0.2);
    let probe = 0.05 - 0.028 * ramp(0.1, 0.25) + 0.028 * ramp(0.3, 0.4);
    simulation.set_pose_input(0, 2, probe);
    simulation.set_pose_input(1, 0, 0.1 + 0.006 * ramp(0.5, 0.6));
    simulation.set_pose_input(1, 2, 0.01 + sag + 0.006 * ramp(0.5, 0.6));
    simulation.set_active(1, (0.45..1.0).contains(&time));
    simulation.set_pose_input(2, 1, -0.02 + 0.05 * ramp(0.6, 0.9));
    simulation.set_active(2, (0.6..0.9).contains(&time));
}
