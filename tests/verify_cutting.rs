//! After a cut tissue settles where the direct solution of what is left says, whatever the rule, scheme and model.

mod common;

use tissue::mesh::Vec3;

const BLOCK: &str = r#"{"name": "block", "mesh": {"box": {"size": [0.12, 0.06, 0.03], "cells": [8, 4, 2]}},
  "materials": [{"where": {"all": true}, "youngModulus": 20000, "poissonRatio": 0.4, "density": 1000},
    {"where": {"box": {"min": [0, 0, 0], "max": [0.06, 0.03, 0.03]}}, "youngModulus": 40000, "poissonRatio": 0.3, "density": 1100}],
  "fixed": [{"box": {"min": [0, 0, 0], "max": [0.12, 0.06, 0]}}], "gravity": [3, 1, -9.81], SETTINGS}"#;

/// Every seventh tetrahedron of the upper half goes, in three events.
fn cuts() -> String {
    let list = |k: usize| -> String {
        // The second of two layers of cells.
        let chosen: Vec<String> = (160..320)
            .filter(|t| t % 21 == 7 * k)
            .map(|t| t.to_string())
            .collect();
        format!(
            r#"{{"time": {}, "where": {{"tetrahedra": [{}]}}}}"#,
            0.01 * (k + 1) as f64,
            chosen.join(",")
        )
    };
    format!(r#""cuts": [{}, {}, {}]"#, list(0), list(1), list(2))
}

#[test]
fn tissue_settles_where_the_direct_solution_says() {
    for rule in ["remove", "duplicate"] {
        for mass in ["removed", "kept"] {
            for (scheme, model) in [
                ("symplecticEuler", r#"{"kind": "tensorMass"}"#),
                ("centralDifference", r#"{"kind": "tensorMass"}"#),
                ("rungeKutta4", r#"{"kind": "tensorMass"}"#),
                ("implicitEuler", r#"{"kind": "tensorMass"}"#),
                (
                    "symplecticEuler",
                    r#"{"kind": "hybrid", "dynamic": {"halfSpace": {"point": [0, 0, 0.015], "normal": [0, 0, 1]}}}"#,
                ),
            ] {
                let cuts = cuts();
                let settings = format!(
                    r#""cutting": {{"rule": "{rule}", "mass": "{mass}"}}, "model": {model},
                       "integration": {{"scheme": "{scheme}"}}, {cuts}"#
                );
                let text = BLOCK.replace("SETTINGS", &settings);
                let model = common::model(&text);
                let reference = tissue::reference::solve(&model, true).unwrap();
                let mut s = tissue::simulation::Simulation::new(model.clone());
                for _ in 0..150 {
                    s.step(0.01).unwrap();
                }
                let live = &s.state().live;
                let (mut worst, mut size) = (0.0f64, 0.0f64);
                for (k, node) in model.node.iter().enumerate() {
                    let i = *node as usize;
                    if i < model.parts.known && live.star_count[i] > 0 {
                        let exact = Vec3::from(reference.displacement[k]);
                        worst = worst.max((s.state().displacement[i].xyz() - exact).norm());
                        size = size.max(exact.norm());
                    }
                }
                let made = model.parts.spares - live.pattern(&model).first;
                println!(
                    "{rule} {mass} {scheme}: {} removed, {} of them cleaned, {made} vertices made, {:.1e}",
                    live.removed.len(),
                    live.cleaned,
                    worst / size
                );
                assert!(
                    worst < 1e-6 * size,
                    "{rule} {mass} {scheme}: {worst:e} of {size:e}"
                );
                assert_eq!(made > 0, rule == "duplicate");
                assert_eq!(s.pieces(), 1);
            }
        }
    }
}
