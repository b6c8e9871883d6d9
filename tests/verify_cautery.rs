//! Cautery: what a tip burns follows from its way through the tissue, not from how many ticks that takes.

mod common;

use tissue::contact::geometry::Capsule;
use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::simulation::Simulation;

const RADIUS: f64 = 0.001;
const ACTIVE: f64 = 0.012;

/// A block of 0.1 x 0.02 x 0.02 m in cells of 4 mm, and a cautery whose shaft runs along -y from its tip, beside it.
/// `more` is put into the scene, `integration` into that part of it.
fn block(gravity: f64, integration: &str, more: &str) -> Simulation {
    common::simulation(&format!(
        r#"{{"name": "block", "mesh": {{"box": {{"size": [0.1, 0.02, 0.02], "cells": [25, 5, 5]}}}},
        "materials": [{{"where": {{"all": true}}, "youngModulus": 20000, "poissonRatio": 0.4, "density": 1000}}],
        "gravity": [0, 0, {gravity}], "integration": {{"damping": 20{integration}}}{more},
        "tools": [{{"name": "cautery", "kind": "cautery", "shape": {{"capsule": {{"radius": {RADIUS}, "length": 0.1}}}},
            "activeLength": {ACTIVE}, "position": [-0.01, 0.015, 0.01], "orientation": [0.7071067811865476, -0.7071067811865476, 0, 0]}}]}}"#
    ))
}

const HELD: &str = r#", "fixed": [{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}]"#;

fn place(s: &mut Simulation, tip: Vec3) {
    for axis in 0..3 {
        s.set_pose_input(0, axis, tip[axis]);
    }
}

/// Puts the tip there and switches the current on.
fn start(s: &mut Simulation, tip: Vec3) {
    place(s, tip);
    s.place_tools().unwrap();
    s.set_active(0, true);
}

/// What a way of 1 m burns at most \[m²\].
fn area(model: &Model) -> f64 {
    let half = RADIUS + model.mean_edge;
    2.0 * half * (ACTIVE + 2.0 * half)
}

/// Volume that the tip took \[m³\], without what was cleaned up after it.
fn burnt(s: &Simulation) -> f64 {
    s.state().live.removed_volume - s.state().live.cleaned_volume
}

fn count(s: &Simulation) -> usize {
    s.state().live.removed.len() - s.state().live.cleaned
}

/// Through the middle of tissue at rest, round a curve that crosses itself, to a stop: the allowance is what it
/// should be at each tick, and nothing burns without.
#[test]
fn each_tick_takes_what_the_way_allows() {
    let mut s = block(0.0, "", HELD);
    let model = s.model().clone();
    start(&mut s, Vec3::new(0.02, 0.015, 0.01));
    let (area, cap) = (area(&model), area(&model) * (RADIUS + model.mean_edge));
    let mut owing = 0;
    let mut last = s.tool(0).pose;
    for k in 0..1500 {
        // Slowly at first.
        let time = (f64::from(k.min(1200)) * 1e-3).powi(3);
        let x = 0.02 + 0.03 * (3.0 * time).sin();
        let (before, pose) = (burnt(&s), s.tool(0).pose);
        let (allowance, was) = (s.tool(0).allowance, s.tool(0).burned);
        s.set_active(0, k < 1400);
        place(
            &mut s,
            Vec3::new(x, 0.015, 0.01 + 0.003 * (7.0 * time).sin()),
        );
        s.step(1e-3).unwrap();
        let now = burnt(&s) - before;
        // The tick is at the start of the step.
        assert_eq!(s.tool(0).burned, Some(pose).filter(|_| s.tool(0).active));
        let way = (pose.position - last.position).norm();
        last = pose;
        match was {
            Some(_) if s.tool(0).active => {
                // Nothing else moves.
                let grown = allowance.min(cap) + area * way;
                assert!(
                    (s.tool(0).allowance - (grown - now)).abs() < 1e-9 * cap,
                    "{k}"
                );
                assert!(grown > 0.0 || now == 0.0);
                owing += u32::from(grown <= 0.0);
            }
            _ => assert_eq!(s.tool(0).allowance, 0.0),
        }
    }
    println!(
        "{owing} ticks owing, {:.3} of the block burnt",
        burnt(&s) / model.report.volume
    );
    assert!(owing > 5 && burnt(&s) > 0.05 * model.report.volume);
}

/// At rest, loaded, stretched and squeezed: after the first tick next to nothing.
#[test]
fn a_tip_that_stands_still_stops() {
    let end = |x: f64| {
        format!(
            r#"{HELD}, "start": "equilibrium", "prescribed": [{{"where": {{"box": {{"min": [0.1, 0, 0], "max": [0.1, 1, 1]}}}}, "displacement": [{x}, 0, 0]}}]"#
        )
    };
    for (what, gravity, more) in [
        ("at rest", 0.0, HELD.to_string()),
        ("held at both ends", -9.81, end(0.0)),
        ("stretched", -9.81, end(0.01)),
        ("squeezed", -9.81, end(-0.01)),
    ] {
        let mut s = block(gravity, "", &more);
        start(&mut s, Vec3::new(0.05, 0.015, 0.01));
        s.step(1e-3).unwrap();
        let first = count(&s);
        let mut half = 0;
        for k in 0..1000 {
            s.step(1e-3).unwrap();
            if k == 500 {
                half = count(&s);
            }
        }
        let after = count(&s) - first;
        println!("{what}: {first}, then {after} in 1 s");
        assert!(first > 10 && after <= first / 4, "{what}: {first} {after}");
        assert_eq!(count(&s), half, "{what}");
        assert!(gravity != 0.0 || after == 0);
    }
}

/// Tissue that is drawn over a hook that stands still is cut as if the hook were drawn through it.
#[test]
fn tissue_drawn_over_a_hook_is_cut() {
    let mut drawn = block(
        0.0,
        "",
        r#", "prescribed": [{"where": {"all": true}, "displacement": [0.02, 0, 0], "ramp": 0.4}]"#,
    );
    start(&mut drawn, Vec3::new(0.05, 0.015, 0.01));
    let mut cut = block(0.0, "", r#", "fixed": [{"all": true}]"#);
    start(&mut cut, Vec3::new(0.05, 0.015, 0.01));
    for k in 1..=400 {
        place(
            &mut cut,
            Vec3::new(0.05 - 0.02 * f64::from(k) / 400.0, 0.015, 0.01),
        );
        drawn.step(1e-3).unwrap();
        cut.step(1e-3).unwrap();
    }
    let ratio = burnt(&drawn) / burnt(&cut);
    println!("{ratio}, {} tetrahedra", cut.state().live.removed.len());
    assert!(
        cut.state().live.removed.len() > 100 && (ratio - 1.0).abs() < 0.1,
        "{ratio}"
    );
}

/// The same way at 500, 1000 and 2000 Hz.
#[test]
fn the_haptic_rate_matters_little() {
    for gravity in [0.0, -9.81] {
        for speed in [0.02, 0.1, 0.5] {
            let volume = [500, 1000, 2000].map(|rate| {
                let mut s = block(gravity, &format!(r#", "hapticRate": {rate}"#), HELD);
                start(&mut s, Vec3::new(0.09, 0.015, 0.01));
                let steps = (0.04 / speed * 1e3) as u32;
                for k in 1..=steps {
                    let x = 0.09 - 0.04 * f64::from(k) / f64::from(steps);
                    place(&mut s, Vec3::new(x, 0.015, 0.01));
                    s.step(1e-3).unwrap();
                }
                burnt(&s)
            });
            let off = volume.map(|v| v / volume[1] - 1.0);
            println!(
                "{gravity} m/s2, {speed} m/s: {:.2e} m3, {off:.3?}",
                volume[1]
            );
            assert!(
                volume[1] > 5e-7 && off.iter().all(|o| o.abs() < 0.15),
                "{off:?}"
            );
        }
    }
}

/// Ticks are at the same times, and so is what they burn, however the host splits time.
#[test]
fn communication_steps_do_not_matter() {
    let splits: [&[u32]; 3] = [&[1; 200], &[10; 20], &[3, 7, 20, 1, 1, 68, 100]];
    let burnt = splits.map(|split| {
        let mut s = block(-9.81, "", HELD);
        start(&mut s, Vec3::new(0.09, 0.015, 0.01));
        let mut ms = 0;
        for length in split {
            place(
                &mut s,
                Vec3::new(0.09 - 0.2 * (f64::from(ms) * 1e-3), 0.015, 0.01),
            );
            s.set_pose_rate(0, 0, -0.2);
            s.step(f64::from(*length) * 1e-3).unwrap();
            ms += length;
        }
        assert!(s.state().live.removed.len() > 100);
        (
            s.state().live.removed.clone(),
            s.tool(0).allowance.to_bits(),
            s.state().displacement.clone(),
        )
    });
    assert!(burnt[1] == burnt[0] && burnt[2] == burnt[0]);
}

/// Saved while it owes, and restored into another instance.
#[test]
fn a_restored_cautery_burns_on() {
    let go = |s: &mut Simulation, from: u32, to: u32| {
        for k in from..to {
            place(s, Vec3::new(0.09 - 5e-4 * f64::from(k), 0.015, 0.01));
            s.step(1e-3).unwrap();
        }
    };
    let mut whole = block(-9.81, "", HELD);
    start(&mut whole, Vec3::new(0.09, 0.015, 0.01));
    go(&mut whole, 0, 50);
    let bytes = whole.serialise(whole.state());
    assert_eq!(bytes.len(), tissue::snapshot::size(whole.state()));
    assert!(whole.tool(0).burned.is_some() && whole.tool(0).allowance != 0.0);
    let mut other = block(-9.81, "", HELD);
    let state = other.deserialise(&bytes).unwrap();
    assert_eq!(&state.tools, &whole.state().tools);
    other.restore(&state);
    go(&mut whole, 50, 100);
    go(&mut other, 50, 100);
    assert_eq!(whole.state(), other.state());
}

/// Ways of a fifth of a radius to ten radii a tick, straight and turning: what a capsule of 0.96 radii has touched at any time
/// on the way is gone, and what one of 1.01 radii has not is still there.
#[test]
fn a_sweep_leaves_no_island() {
    for radii in [0.2, 1.0, 3.0, 10.0] {
        for turning in [false, true] {
            let mut s = block(0.0, "", HELD);
            let model = s.model().clone();
            start(&mut s, Vec3::new(0.095, 0.015, 0.01));
            let steps = (0.07 / (radii * RADIUS)).round() as usize;
            let mut poses = Vec::new();
            for k in 0..=steps {
                poses.push(s.tool(0).pose);
                let share = (k + 1) as f64 / steps as f64;
                place(&mut s, Vec3::new(0.095 - 0.07 * share, 0.015, 0.01));
                if turning {
                    // About x, by up to 60 degrees, from pointing along y.
                    let half = -0.5 * (0.5 + share / 3.0) * std::f64::consts::PI;
                    s.set_pose_input(0, 3, half.cos());
                    s.set_pose_input(0, 4, half.sin());
                }
                s.step(1e-3).unwrap();
            }
            let shape = &model.tools[0];
            let samples = (20.0 * radii) as u32;
            let dense: Vec<Capsule> = (poses.windows(2))
                .flat_map(|pair| {
                    (0..=samples)
                        .map(|n| pair[0].towards(&pair[1], f64::from(n) / f64::from(samples)))
                })
                .flat_map(|pose| shape.active_at(&pose).collect::<Vec<_>>())
                .collect();
            let touched = |t: usize, share: f64| {
                let corners = model.rest_positions(t);
                dense.iter().any(|c| {
                    let c = Capsule {
                        radius: share * c.radius,
                        ..*c
                    };
                    c.may_touch(&corners) && c.touches_tetrahedron(&corners)
                })
            };
            let alive = &s.state().live.alive;
            let islands = (0..alive.len())
                .filter(|t| alive[*t] && touched(*t, 0.96))
                .count();
            let spared = (0..alive.len())
                .filter(|t| !alive[*t] && !touched(*t, 1.01))
                .count();
            println!(
                "{radii} radii a tick, turning {turning}: {islands} islands, {spared} too many of {}",
                s.state().live.removed.len()
            );
            // Some hung by a vertex or an edge alone.
            assert!(islands == 0 && spared <= s.state().live.cleaned);
            assert!(s.state().live.removed.len() > 300);
        }
    }
}
