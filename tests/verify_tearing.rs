//! Tearing, against measures computed another way and against looking at every tetrahedron on every tick.
//! (Cotin, Delingette, Ayache 1998, section 5.5 and figure 3.)

mod common;

use nalgebra::Matrix3;
use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::simulation::Simulation;
use tissue::state::State;
use tissue::tear::{self, Tears};

const CRITERIA: [&str; 3] = ["volume", "meanElongation", "maximumElongation"];
const KINDS: [&str; 2] = ["tensorMass", "springMass"];

/// Every node of a bar of 6 x 2 x 2 cells displaced by `gradient` x, from time 0 on.
fn affine(kind: &str, gradient: &Matrix3<f64>, criterion: &str, threshold: f64) -> String {
    let (cells, size) = ([6usize, 2, 2], [0.06, 0.02, 0.02]);
    let mut prescribed = Vec::new();
    for k in 0..=cells[2] {
        for j in 0..=cells[1] {
            for i in 0..=cells[0] {
                let node = i + (cells[0] + 1) * (j + (cells[1] + 1) * k);
                let share = |n: usize, axis: usize| n as f64 / cells[axis] as f64 * size[axis];
                let u = gradient * Vec3::new(share(i, 0), share(j, 1), share(k, 2));
                prescribed.push(format!(
                    r#"{{"where": {{"nodes": [{node}]}}, "displacement": [{:e}, {:e}, {:e}]}}"#,
                    u.x, u.y, u.z
                ));
            }
        }
    }
    format!(
        r#"{{"name": "affine", "mesh": {{"box": {{"size": {size:?}, "cells": {cells:?}}}}},
        "materials": [{{"where": {{"all": true}}, "youngModulus": 5000, "poissonRatio": 0.3, "density": 1000}}],
        "prescribed": [{}], "gravity": [0, 0, 0], "model": {{"kind": "{kind}"}},
        "tearing": {{"criterion": "{criterion}", "threshold": {threshold:e}, "budget": 1000}}}}"#,
        prescribed.join(",")
    )
}

/// The measure of a tetrahedron under a displacement gradient, by lengths and volumes.
fn oracle(model: &Model, t: usize, g: &Matrix3<f64>, kind: &str, criterion: &str) -> f64 {
    let rest = model.rest_positions(t);
    let strain = (g + g.transpose()) * 0.5;
    let stretch = g + Matrix3::identity();
    let springs = kind == "springMass";
    if criterion == "volume" {
        let volume = |p: [Vec3; 4]| (p[1] - p[0]).cross(&(p[2] - p[0])).dot(&(p[3] - p[0]));
        return if springs {
            volume(rest.map(|x| stretch * x)) / volume(rest) - 1.0
        } else {
            strain.trace()
        };
    }
    let mut elongation = Vec::new();
    for a in 0..4 {
        for b in 0..a {
            let r = rest[b] - rest[a];
            elongation.push(if springs {
                (stretch * r).norm() / r.norm() - 1.0
            } else {
                r.normalize().dot(&(strain * r.normalize()))
            });
        }
    }
    match criterion {
        "meanElongation" => elongation.iter().sum::<f64>() / 6.0,
        _ => elongation.into_iter().fold(f64::NEG_INFINITY, f64::max),
    }
}

/// Uniform strain, stretched, sheared and turned: exactly what is past the threshold goes.
#[test]
fn uniform_strain_tears_at_the_threshold() {
    let gradient = Matrix3::new(0.3, 0.05, 0.0, -0.1, -0.1, 0.02, 0.0, 0.07, 0.1);
    for kind in KINDS {
        for criterion in CRITERIA {
            let model = common::model(&affine(kind, &gradient, criterion, 1.0));
            let of = |t: usize| oracle(&model, t, &gradient, kind, criterion);
            let largest = (0..model.shape.len()).map(of).fold(0.0, f64::max);
            println!("{kind} {criterion}: {largest}");
            let torn = |threshold: f64| {
                let mut s = common::simulation(&affine(kind, &gradient, criterion, threshold));
                s.step(1e-3).unwrap();
                let live = &s.state().live;
                let torn = live.removed.len() - live.cleaned;
                let mut torn = live.removed[..torn].to_vec();
                torn.sort_unstable();
                torn
            };
            assert!(torn(largest * (1.0 + 1e-9)).is_empty());
            for threshold in [largest * (1.0 - 1e-9), 0.7 * largest] {
                let past: Vec<u32> = (0..model.shape.len() as u32)
                    .filter(|t| of(*t as usize) > threshold)
                    .collect();
                assert!(!past.is_empty());
                assert_eq!(torn(threshold), past, "{kind} {criterion} {threshold}");
            }
        }
    }
}

/// u = omega x X of 40 degrees: edges are longer by up to 1/cos 40 - 1 = 31 %, the volume by 70 %; the
/// strain is zero. Squeezed tissue does not tear either.
#[test]
fn linear_rotation_and_compression_do_not_tear() {
    let turn = 40f64.to_radians().tan();
    let rotation = Matrix3::new(0.0, -turn, 0.0, turn, 0.0, 0.0, 0.0, 0.0, 0.0);
    let squeeze = Matrix3::from_diagonal(&Vec3::new(-0.4, -0.3, -0.3));
    for criterion in CRITERIA {
        for (gradient, threshold) in [(&rotation, 0.1), (&squeeze, 0.1), (&rotation, 1e-12)] {
            let mut s = common::simulation(&affine("tensorMass", gradient, criterion, threshold));
            s.step(1e-3).unwrap();
            assert!(s.state().live.removed.is_empty(), "{criterion} {threshold}");
        }
        let mut s = common::simulation(&affine("springMass", &rotation, criterion, 0.1));
        s.step(1e-3).unwrap();
        assert!(!s.state().live.removed.is_empty(), "{criterion}");
    }
}

/// A bar held at x = 0, pulled at its other end and bent by gravity, faster than it can follow.
fn pulled(kind: &str, criterion: &str, threshold: f64, more: &str) -> String {
    format!(
        r#"{{"name": "pulled", "mesh": {{"box": {{"size": [0.1, 0.02, 0.02], "cells": [15, 3, 3]}}}},
        "materials": [{{"where": {{"all": true}}, "youngModulus": 20000, "poissonRatio": 0.4, "density": 1000}}],
        "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0.014, 1, 1]}}}}],
        "prescribed": [{{"where": {{"box": {{"min": [0.086, 0, 0], "max": [0.1, 1, 1]}}}}, "displacement": [0.08, 0, null], "ramp": 3}}],
        "model": {{"kind": "{kind}"}}, "gravity": [0, 1, -2], "integration": {{"damping": 40}},
        "tearing": {{"criterion": "{criterion}", "threshold": {threshold}, "budget": 3}}{more}}}"#
    )
}

const THRESHOLDS: [f64; 3] = [0.25, 0.1, 0.4];

/// What shall go at a tick, by looking at everything.
fn plain(model: &Model, state: &State) -> Vec<u32> {
    let mut past = tear::past_threshold(model, state);
    past.sort_by(|a, b| b.0.partial_cmp(&a.0).unwrap().then(a.1.cmp(&b.1)));
    past.iter().map(|(_, t)| *t).take(3).collect()
}

/// At each tick exactly the three largest go, or fewer, though few tetrahedra are looked at; and the bar
/// is torn in two.
#[test]
fn tears_what_looking_at_everything_finds() {
    for kind in KINDS {
        for (criterion, threshold) in CRITERIA.into_iter().zip(THRESHOLDS) {
            for scheme in ["symplecticEuler", "rungeKutta4"] {
                let integration = format!(r#""integration": {{"scheme": "{scheme}","#);
                let text = pulled(kind, criterion, threshold, "");
                let mut s = common::simulation(&text.replace(r#""integration": {"#, &integration));
                let model = s.model().clone();
                let mut tears = Tears::new(&model);
                let (mut full, mut saved, mut ticks) = (0, None, 0u64);
                for k in 0..2500 {
                    let expected = plain(&model, s.state());
                    let mut loose = tissue::loose::Scratch::new(&model);
                    loose.locate(s.state());
                    assert_eq!(
                        tears.find(&model, s.state(), &loose),
                        expected,
                        "{kind} {criterion} {k}"
                    );
                    let before = s.state().live.removed.len();
                    s.step(1e-3).unwrap();
                    // What is cleaned up comes after.
                    assert!(
                        s.state().live.removed[before..].starts_with(&expected),
                        "{kind} {criterion} {k}"
                    );
                    full += u32::from(expected.len() == 3);
                    ticks += 1;
                    // More and less strength, and back in time by some ticks.
                    let factor = [1.0, 1.3, 0.9][k / 40 % 3];
                    s.set_tearing_threshold(factor * threshold);
                    match k % 30 {
                        7 => saved = Some(s.save()),
                        10 => {
                            s.restore(saved.as_ref().unwrap());
                            tears.forget();
                        }
                        _ => {}
                    }
                }
                let share = tears.looked_at as f64 / (ticks * model.shape.len() as u64) as f64;
                let (torn, pieces) = (s.state().live.removed.len(), s.pieces());
                println!(
                    "{kind} {criterion} {scheme}: {torn} torn, {pieces} pieces, {full} full ticks, looked at {share:.3}"
                );
                // Springs that have been turned inside out hang together by shreds.
                assert!(full > 0 && torn < model.shape.len() / 2);
                assert!(pieces >= 2 || kind == "springMass");
                // Loose tissue is looked at each time.
                assert!(share < 0.85, "{share}");
            }
        }
    }
}

/// The account closes through it.
#[test]
fn energy_closes_through_a_tear() {
    for (kind, limit) in KINDS.into_iter().zip([1e-5, 1e-2]) {
        for (criterion, threshold) in CRITERIA.into_iter().zip(THRESHOLDS) {
            let mut s = common::simulation(&pulled(kind, criterion, threshold, ""));
            let start = s.energy().balance();
            let mut worst = 0.0f64;
            for _ in 0..2500 {
                s.step(1e-3).unwrap();
                let e = s.energy();
                let scale = e.elastic + e.kinetic + e.dissipated + e.support_work.abs();
                worst = worst.max((e.balance() - start).abs() / scale.max(1e-4));
            }
            println!(
                "{kind} {criterion}: {worst:e}, {} torn",
                s.state().live.removed.len()
            );
            assert!(
                worst < limit && s.state().live.removed.len() > 40,
                "{worst:e}"
            );
        }
    }
}

fn bits(s: &Simulation) -> Vec<u64> {
    let state = s.state();
    let lanes = state.displacement.iter().chain(&state.velocity);
    let mut all: Vec<u64> = lanes.flat_map(|l| l.0.map(f64::to_bits)).collect();
    all.extend(state.live.removed.iter().map(|t| u64::from(*t)));
    all.push(state.account.dissipated.to_bits());
    all
}

/// However the host splits time, saves and restores, also into another process.
#[test]
fn tears_alike_however_time_is_split_and_states_are_restored() {
    for kind in KINDS {
        let text = pulled(kind, "maximumElongation", 0.4, "");
        let run = |s: &mut Simulation, split: &[u32]| {
            split
                .iter()
                .for_each(|ms| s.step(f64::from(*ms) * 1e-3).unwrap());
        };
        let mut whole = common::simulation(&text);
        run(&mut whole, &[1; 2000]);
        let torn = whole.state().live.removed.len();
        for split in [&[10; 200][..], &[7, 3, 20, 1, 1, 68, 100, 1800]] {
            let mut s = common::simulation(&text);
            run(&mut s, split);
            assert_eq!(bits(&s), bits(&whole), "{kind}");
        }
        let mut s = common::simulation(&text);
        while s.state().live.removed.len() < torn / 2 {
            run(&mut s, &[1]);
        }
        let ms = (s.time() * 1e3).round() as usize;
        let bytes = s.serialise(s.state());
        assert_eq!(bytes.len(), tissue::snapshot::size(s.state()));
        let saved = s.save();
        run(&mut s, &vec![1; 2000 - ms]);
        assert_eq!(bits(&s), bits(&whole), "{kind}");
        s.restore(&saved);
        run(&mut s, &vec![1; 2000 - ms]);
        assert_eq!(bits(&s), bits(&whole), "{kind} restored");
        let mut other = common::simulation(&text);
        run(&mut other, &[1; 20]);
        let restored = other.deserialise(&bytes).unwrap();
        assert!(other.serialise(&restored) == bytes);
        other.restore(&restored);
        run(&mut other, &vec![1; 2000 - ms]);
        assert_eq!(bits(&other), bits(&whole), "{kind} deserialised");
        s.reset();
        run(&mut s, &[1; 2000]);
        assert_eq!(bits(&s), bits(&whole), "{kind} reset");
    }
}

/// One corner is pulled out and torn off, the rest stands still. With a restored state it is back, and goes
/// again.
#[test]
fn what_a_restored_state_brings_back_tears_again() {
    let text = r#"{"name": "corner", "mesh": {"box": {"size": [0.02, 0.02, 0.02], "cells": [2, 2, 2]}},
        "materials": [{"where": {"all": true}, "youngModulus": 5000, "poissonRatio": 0.3, "density": 1000}],
        "fixed": [{"not": {"nodes": [26]}}], "prescribed": [{"where": {"nodes": [26]}, "displacement": [0.01, 0.01, 0.01]}],
        "tearing": {"criterion": "maximumElongation", "threshold": 0.5, "budget": 1}}"#;
    let mut s = common::simulation(text);
    let saved = s.save();
    let mut torn = || {
        (0..20).for_each(|_| s.step(1e-3).unwrap());
        let torn = s.state().live.removed.clone();
        s.restore(&saved);
        torn
    };
    let first = torn();
    assert!(!first.is_empty() && first.len() < 10, "{first:?}");
    assert_eq!(torn(), first);
    (0..20).for_each(|_| s.step(1e-3).unwrap());
    s.reset();
    (0..20).for_each(|_| s.step(1e-3).unwrap());
    assert_eq!(s.state().live.removed, first);
}

/// With a substep that has to be halved, too, what goes first is what was past the threshold at the start.
#[test]
fn halved_substeps_tear_the_same() {
    // Far above the critical step: halved each time.
    let text = pulled("tensorMass", "maximumElongation", 0.4, "")
        .replace(r#""damping": 40"#, r#""damping": 40, "substep": 0.001"#);
    let mut s = common::simulation(&text);
    let model = s.model().clone();
    let (mut halved, mut torn) = (0, 0);
    for _ in 0..2500 {
        let expected = plain(&model, s.state());
        let before = s.state().live.removed.len();
        s.step(1e-3).unwrap();
        assert!(s.state().live.removed[before..].starts_with(&expected));
        halved += s.halvings();
        torn += expected.len();
    }
    assert!(halved > 0 && torn > 10, "{halved} {torn}");
}

/// The parameter is the state's: saved, kept over a rebuild, back at the scene's value on reset.
#[test]
fn the_threshold_is_a_parameter() {
    let mut s = common::simulation(&pulled("tensorMass", "maximumElongation", 0.4, ""));
    s.set_tearing_threshold(0.2);
    let saved = s.deserialise(&s.serialise(s.state())).unwrap();
    assert_eq!(saved.parameters.tearing_threshold, 0.2);
    s.change_scene(|scene| scene.integration.haptic_rate = 500.0);
    assert!(s.rebuild().unwrap());
    assert_eq!(s.parameters().tearing_threshold, 0.2);
    for _ in 0..500 {
        s.step(4e-3).unwrap();
    }
    let torn = s.state().live.removed.len();
    s.reset();
    assert_eq!(s.parameters().tearing_threshold, 0.4);
    for _ in 0..500 {
        s.step(4e-3).unwrap();
    }
    assert_ne!(torn, s.state().live.removed.len());
    let none = common::simulation(common::BAR);
    assert_eq!(none.parameters().tearing_threshold, f64::INFINITY);
}

/// Only dynamic tissue tears; a user is told where none is, and of what is past the threshold at once.
#[test]
fn a_user_is_warned() {
    let warnings = |text: &str| tissue::inspect::warnings(&common::model(text));
    let none = pulled("tensorMass", "volume", 0.25, "");
    assert_eq!(warnings(&none), Vec::<String>::new());
    let stretched = none.replace(r#""ramp": 3"#, r#""ramp": 0"#);
    let found = warnings(&stretched);
    assert!(
        found[0].ends_with("are past tearing.threshold at the start and tear at once"),
        "{found:?}"
    );
    let inside = none.replace("tensorMass", "quasiStatic");
    assert_eq!(
        warnings(&inside),
        ["nothing can tear: all tissue is pre-computed"]
    );
    let hybrid = pulled(
        "hybrid\", \"dynamic\": {\"halfSpace\": {\"point\": [0.05, 0, 0], \"normal\": [1, 0, 0]}}, \"connection\": \"full",
        "volume",
        0.25,
        "",
    );
    let mut s = common::simulation(&hybrid);
    for _ in 0..2500 {
        s.step(1e-3).unwrap();
    }
    let state = s.state();
    assert!(state.live.removed.len() > 3);
    assert!(
        state
            .live
            .removed
            .iter()
            .all(|t| s.model().parts.dynamic[*t as usize])
    );
}

/// What the example's description says.
#[test]
fn the_cylinder_tears_off_below_its_clamp() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/torn_cylinder.json");
    let mut s = common::simulation(&std::fs::read_to_string(path).unwrap());
    let model = s.model().clone();
    let counts = (model.mesh.nodes.len(), model.shape.len());
    assert_eq!(counts, (247, 864));
    let start = s.energy().balance();
    let mut torn = 0;
    for k in 0..500 {
        s.step(1e-3).unwrap();
        let now = s.state().live.removed.len() - s.state().live.cleaned;
        assert!(now - torn <= 4);
        torn = now;
        let e = s.energy();
        let scale = e.elastic + e.kinetic + e.dissipated;
        assert!((e.balance() - start).abs() <= 0.01 * scale, "{k} {e:?}");
        assert!(k < 200 || s.pieces() >= 2);
    }
    let state = s.state();
    assert!(
        state
            .displacement
            .iter()
            .all(|u| u.0.iter().all(|x| x.is_finite()))
    );
    // What is below the clamp and has fallen by more than its own height.
    let fallen = |t: &usize| {
        let nodes = model.mesh.tetrahedra[*t];
        state.live.alive[*t]
            && nodes
                .iter()
                .all(|v| state.displacement[*v as usize].0[2] < -0.12)
    };
    let off: f64 = (0..model.shape.len())
        .filter(fallen)
        .map(|t| model.shape[t].volume)
        .sum();
    let share = off / model.report.volume;
    println!("{torn} torn, {share:.3} of the volume off");
    assert!(share > 0.75 && torn > 20 && torn < 130, "{share} {torn}");
    assert!(state.live.removed_volume < 0.15 * model.report.volume);
    // Right below the clamp.
    let low = (state.live.removed.iter())
        .map(|t| model.rest_positions(*t as usize).iter().sum::<Vec3>().z / 4.0)
        .fold(1.0, f64::min);
    assert!(low > 0.09, "{low}");
}

/// A cut that sets a stretched piece loose, and vertices that split, change what is measured at once: nothing that
/// tears is overlooked.
#[test]
fn tears_what_a_cut_has_changed() {
    for rule in ["remove", "duplicate"] {
        for criterion in CRITERIA {
            let more = format!(
                r#", "cutting": {{"rule": "{rule}"}}, "cuts": [
                {{"time": 1.0, "where": {{"tetrahedra": [301, 322, 343, 364, 385, 406, 427, 448, 469, 490]}}}},
                {{"time": 1.2, "where": {{"box": {{"min": [0.02, 0, 0], "max": [0.034, 1, 1]}}}}}}]"#
            );
            // Just strong enough for what it bears until then.
            let text = pulled("tensorMass", criterion, 0.27, &more);
            let mut s = common::simulation(&text);
            let model = s.model().clone();
            let mut torn = 0;
            for k in 0..1500 {
                let expected = plain(&model, s.state());
                let before = s.state().live.removed.len();
                s.step(1e-3).unwrap();
                let went = &s.state().live.removed[before..];
                if k != 1000 && k != 1200 {
                    assert!(went.starts_with(&expected), "{rule} {criterion} {k}");
                    assert!(
                        !expected.is_empty() || went.is_empty(),
                        "{rule} {criterion} {k}"
                    );
                    torn += expected.len();
                }
            }
            let live = &s.state().live;
            println!(
                "{rule} {criterion}: {torn} torn, {} loose vertices, {} split",
                live.pieces.loose_nodes().len(),
                model.parts.spares - live.pattern(&model).first
            );
            assert!(!live.pieces.loose_nodes().is_empty());
        }
    }
}

/// A bar that is stretched and turned: what its supports see of the strain is less than what its frame sees once they are
/// cut off, and though nothing moves all of it tears at once.
#[test]
fn what_comes_loose_is_looked_at() {
    for rule in ["remove", "duplicate"] {
        let text = format!(
            r#"{{"name": "bar", "mesh": {{"box": {{"size": [0.08, 0.02, 0.02], "cells": [8, 2, 2]}}}},
  "materials": [{{"where": {{"all": true}}, "youngModulus": 1, "poissonRatio": 0.4, "density": 1000}}],
  "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}], "gravity": [0, 0, 0], "cutting": {{"rule": "{rule}"}},
  "integration": {{"damping": 1, "substep": 0.001}},
  "tearing": {{"criterion": "maximumElongation", "threshold": 0.35, "budget": 10000}},
  "cuts": [{{"time": 0.004, "where": {{"box": {{"min": [0, 0, 0], "max": [0.01, 1, 1]}}}}}}]}}"#
        );
        let mut s = common::simulation(&text);
        let (model, mut state) = (s.model().clone(), s.save());
        let (sin, cos) = 0.7f64.sin_cos();
        for i in 0..model.parts.moving {
            let at = model.mesh.nodes[i];
            let x = 1.4 * at.x;
            if state.inverse_mass[i].0[0] > 0.0 {
                let now = Vec3::new(cos * x - sin * at.z, at.y, sin * x + cos * at.z);
                state.displacement[i] = (now - at).into();
            }
        }
        state.account.start = state.energy(&model).balance();
        s.restore(&state);
        for k in 0..8 {
            s.step(1e-3).unwrap();
            let past = tear::past_threshold(&model, s.state()).len();
            assert_eq!(past, 0, "{rule} {k}");
        }
        assert!(s.state().live.removed.len() > 100);
    }
}
