//! After any cuts the live mesh is that of a fresh assembly, all stars are good, and its surface is
//! closed.

mod common;

use std::collections::HashMap;

use tissue::mesh::Vec3;
use tissue::model::tensor_mass::Tensors;
use tissue::model::{Model, spectrum};
use tissue::simulation::Simulation;
use tissue::star::Worklist;
use tissue::state::State;

fn fresh(model: &Model, state: &State) -> (Tensors, Vec<f64>) {
    let pattern = state.live.pattern(model);
    let mut tensors = Tensors::zeros(pattern);
    let mut mass = vec![0.0; model.mesh.nodes.len()];
    for (t, nodes) in state
        .live
        .tetrahedra
        .iter()
        .enumerate()
        .filter(|(t, _)| state.live.alive[*t])
    {
        let material = model.material(t);
        tensors.accumulate(pattern, nodes, &model.shape[t], &material.law);
        for v in nodes {
            mass[*v as usize] += material.density * model.shape[t].volume / 4.0;
        }
    }
    (tensors, mass)
}

fn check(s: &Simulation) {
    let (model, state) = (s.model(), s.state());
    let (tensors, mass) = fresh(model, state);
    let pattern = state.live.pattern(model);
    let mut live = state.live.tensors.entries(pattern);
    for (i, j, block) in tensors.entries(pattern) {
        let own = live.next().unwrap().2;
        // A vertex tensor is the sum over its edges there, and over its tetrahedra here.
        let off = if i == j { 1e-13 * block.norm() } else { 0.0 };
        assert!((own - block).norm() <= off, "tensor of {i} {j}");
    }
    for (v, m) in mass.iter().enumerate() {
        assert!(state.live.mass[v] == *m, "mass of {v}");
    }
    assert!(Worklist::default().all_good(model, &state.live));
    assert!(state.live.pieces == state.live.whole_pieces(model));
    // Closed: each edge has two faces, which run along it in opposite directions. Volume enclosed = volume left.
    let mut edges: HashMap<(u32, u32), (u32, i32)> = HashMap::new();
    let mut enclosed = 0.0;
    for face in &state.live.surface {
        let t = state.live.triangle(model, *face);
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            let (faces, turns) = edges.entry((a.min(b), a.max(b))).or_default();
            *faces += 1;
            *turns += if a < b { 1 } else { -1 };
        }
        let p: [Vec3; 3] = t.map(|v| state.live.rest[v as usize]);
        enclosed += p[0].dot(&p[1].cross(&p[2])) / 6.0;
    }
    assert!(edges.values().all(|n| n.0 == 2 && n.1 == 0));
    let left: f64 = (0..model.shape.len())
        .filter(|t| state.live.alive[*t])
        .map(|t| model.shape[t].volume)
        .sum();
    assert!((enclosed - left).abs() < 1e-12 * model.report.volume);
    assert!(
        (model.report.volume - left - state.live.removed_volume).abs()
            < 1e-12 * model.report.volume
    );
}

#[test]
fn cautery_cuts_equal_a_fresh_assembly() {
    let mut s = common::simulation(common::BAR);
    for k in 0..1000 {
        common::script(&mut s, f64::from(k) * 1e-3);
        s.step(1e-3).unwrap();
        if k % 50 == 0 {
            check(&s);
        }
    }
    check(&s);
    assert!(s.state().live.removed.len() > 10);
}

/// The same where vertices are split: nothing is lost but what hangs by an edge.
#[test]
fn split_vertices_equal_a_fresh_assembly() {
    for (kind, scheme) in [
        ("tensorMass", "symplecticEuler"),
        ("tensorMass", "implicitEuler"),
        ("springMass", "symplecticEuler"),
        ("nodalPressure", "symplecticEuler"),
        ("nodalAveraged", "symplecticEuler"),
        ("nodalAveraged", "centralDifference"),
    ] {
        let model = match kind.starts_with("nodal") {
            true => format!(r#"{{"element": "{kind}"}}"#),
            false => format!(r#"{{"kind": "{kind}"}}"#),
        };
        let count = common::model(common::BAR).shape.len();
        let cuts: Vec<String> = (0..200)
            .map(|k| {
                format!(
                    r#"{{"time": {}, "where": {{"tetrahedra": [{}]}}}}"#,
                    2e-3 * k as f64,
                    k * 337 % count
                )
            })
            .collect();
        let settings = format!(
            r#""cuts": [{}], "cutting": {{"rule": "duplicate"}}, "model": {model},
               "integration": {{"scheme": "{scheme}"}}, "tools""#,
            cuts.join(",")
        );
        let mut s = common::simulation(&common::BAR.replace("\"tools\"", &settings));
        let mut worst = 0.0f64;
        for k in 0..450 {
            common::script(&mut s, f64::from(k) * 1e-3);
            s.step(1e-3).unwrap();
            let energy = s.energy();
            let off = energy.balance() - s.state().account.start;
            worst = worst.max(off.abs() / (energy.elastic + energy.dissipated + energy.kinetic));
            if k % 50 == 0 && kind == "tensorMass" {
                check(&s);
            }
        }
        let (model, live) = (s.model(), &s.state().live);
        let made = model.parts.spares - live.pattern(model).first;
        let left: f64 = (0..count)
            .filter(|t| live.alive[*t])
            .map(|t| 1000.0 * model.shape[t].volume)
            .sum();
        let mass: f64 = live.mass.iter().sum();
        println!(
            "{kind} {scheme}: {made} vertices made, {} of {} removed not asked for, energy {worst:.1e}",
            live.cleaned,
            live.removed.len()
        );
        assert!(made > 20 && live.cleaned < 20, "{made} {}", live.cleaned);
        assert!((mass - left).abs() < 1e-12 * mass);
        assert!(worst < 1e-3, "{worst:e}");
        // Bytes bring back the same, and both go on alike.
        let saved = s.save();
        let bytes = s.serialise(&saved);
        let restored = s.deserialise(&bytes).unwrap();
        assert!(restored == saved);
        s.step(2e-3).unwrap();
        let end = s.save();
        let mut other = Simulation::new(model_of(&s));
        other.restore(&restored);
        other.step(2e-3).unwrap();
        assert!(other.save() == end);
    }
}

fn model_of(s: &Simulation) -> std::sync::Arc<Model> {
    s.model().clone()
}

/// Scripted removal of everything, in a scrambled order over time.
#[test]
fn removing_all_leaves_exact_zeros() {
    let count = common::model(common::BAR).shape.len();
    let cuts: Vec<String> = (0..count)
        .map(|k| {
            format!(
                r#"{{"time": {}, "where": {{"tetrahedra": [{}]}}}}"#,
                1e-4 * k as f64,
                k * 337 % count
            )
        })
        .collect();
    let text = common::BAR.replace(
        "\"tools\"",
        &format!("\"cuts\": [{}], \"tools\"", cuts.join(",")),
    );
    let mut s = common::simulation(&text);
    for k in 0..(count / 10 + 5) {
        s.step(1e-3).unwrap();
        if k % 20 == 0 {
            check(&s);
        }
    }
    assert_eq!(s.state().live.removed.len(), count);
    assert_eq!(
        (
            s.surface_triangle_count(),
            s.pieces(),
            s.minimum_volume_ratio()
        ),
        (0, 0, 1.0)
    );
    let model = s.model().clone();
    assert!(
        s.state()
            .live
            .tensors
            .entries(&model.pattern)
            .all(|(_, _, b)| b.amax() == 0.0)
    );
    assert!(
        s.state()
            .live
            .mass
            .iter()
            .chain(&s.state().live.weight)
            .all(|m| *m == 0.0)
    );
    s.step(1e-3).unwrap();
}

/// 10 000 tetrahedra of a block of 20 480 in random order, pressed by a probe and held by a grasper.
#[test]
fn random_removals_leave_a_good_mesh() {
    let count = 20_480u64;
    // A full cycle: odd factor, 4 k + 1 and odd increment modulo a power of two, less what is out of range.
    let mut at = 12_345u64;
    let order: Vec<u64> = std::iter::repeat_with(|| {
        at = (at * 20_693 + 12_347) % 32_768;
        at
    })
    .filter(|t| *t < count)
    .take(10_000)
    .collect();
    let cuts: Vec<String> = (order.iter().enumerate())
        .map(|(k, t)| {
            let time = 0.05 + 1e-4 * k as f64;
            format!(r#"{{"time": {time}, "where": {{"tetrahedra": [{t}]}}}}"#)
        })
        .collect();
    let text = format!(
        r#"{{"name": "block", "mesh": {{"box": {{"size": [0.32, 0.16, 0.08], "cells": [32, 16, 8]}}}},
  "materials": [{{"where": {{"all": true}}, "youngModulus": 20000, "poissonRatio": 0.4, "density": 1000}},
    {{"where": {{"box": {{"min": [0, 0, 0], "max": [0.16, 0.08, 0.08]}}}}, "youngModulus": 30000, "poissonRatio": 0.3, "density": 1100}}],
  "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0.32, 0.16, 0]}}}}], "cuts": [{}],
  "tools": [
    {{"name": "probe", "kind": "probe", "shape": {{"sphere": {{"radius": 0.02}}}}, "position": [0.1, 0.08, 0.12]}},
    {{"name": "grasper", "kind": "grasper", "shape": {{"sphere": {{"radius": 0.02}}}}, "position": [0.24, 0.08, 0.08]}}]}}"#,
        cuts.join(",")
    );
    let mut s = common::simulation(&text);
    s.set_active(1, true);
    for k in 0..1060 {
        s.set_pose_input(0, 2, 0.12 - 0.03 * (f64::from(k) / 50.0).min(1.0));
        s.set_pose_input(1, 2, 0.08 + 0.01 * (f64::from(k) / 50.0).min(1.0));
        s.step(1e-3).unwrap();
        if k < 60 {
            assert!(k < 50 || s.tool(0).in_contact && s.tool(1).in_contact);
        }
        if k % 100 == 99 {
            check(&s);
            let state = s.state();
            assert!(
                state
                    .displacement
                    .iter()
                    .chain(&state.velocity)
                    .all(|x| x.0[0].is_finite())
            );
            let model = s.model();
            let free = &model.boundary.free[..model.parts.moving];
            let stiffness = model.stiffness(&state.live.tensors);
            let highest = spectrum::highest(stiffness, &state.live.mass, free);
            // Lanczos adds its residual.
            let limit = model.limiting_frequency() * (1.0 + 1e-3);
            assert!(
                s.substep() * highest < 2.0 && highest <= limit,
                "{k}: {highest} of {limit}"
            );
            println!(
                "{} removed, {:.1} % of the volume cleaned, {} pieces, {:.3} of the critical step",
                state.live.removed.len(),
                100.0 * state.live.cleaned_volume / model.report.volume,
                s.pieces(),
                s.substep() * highest / 2.0
            );
        }
    }
}

fn scattered_cuts(tetrahedra: &[usize], count: usize, interval: f64) -> String {
    let cuts: Vec<String> = (0..count)
        .map(|k| {
            let t = tetrahedra[k * 337 % tetrahedra.len()];
            let time = interval * k as f64;
            format!(r#"{{"time": {time}, "where": {{"tetrahedra": [{t}]}}}}"#)
        })
        .collect();
    cuts.join(",")
}

/// A block that nothing fixes is loose from the start; vertices that split in it are loose, too.
#[test]
fn vertices_split_in_loose_pieces() {
    for scheme in [
        "symplecticEuler",
        "centralDifference",
        "implicitEuler",
        "rungeKutta4",
    ] {
        let all: Vec<usize> = (0..360).collect();
        let text = format!(
            r#"{{"name": "block", "mesh": {{"box": {{"size": [0.08, 0.03, 0.03], "cells": [8, 3, 3]}}}},
  "materials": [{{"where": {{"all": true}}, "youngModulus": 40000, "poissonRatio": 0.4, "density": 1000}}],
  "cutting": {{"rule": "duplicate"}}, "integration": {{"scheme": "{scheme}", "damping": 20}}, "cuts": [{}]}}"#,
            scattered_cuts(&all, 100, 2e-3)
        );
        let mut s = common::simulation(&text);
        for _ in 0..250 {
            s.step(1e-3).unwrap();
            check(&s);
            let energy = s.energy();
            let off = energy.balance() - s.state().account.start;
            assert!(off.abs() < 1e-12 * energy.kinetic.max(1e-9), "{off:e}");
        }
        assert!(s.state().live.splits.len() > 100 && s.pieces() > 1);
    }
}

/// Beside pre-computed tissue, which stays, all dynamic tissue goes: what hangs by a connection node belongs to the
/// same piece.
#[test]
fn pieces_are_right_beside_precomputed_tissue() {
    for rule in ["remove", "duplicate"] {
        let scene = |cuts: &str| {
            let settings = format!(
                r#""cutting": {{"rule": "{rule}"}}, "model": {{"kind": "hybrid", "dynamic":
                {{"halfSpace": {{"point": [0.05, 0, 0], "normal": [1, 0, 0]}}}}}}{cuts}, "tools""#
            );
            common::BAR.replace("\"tools\"", &settings)
        };
        let whole = common::model(&scene(""));
        let dynamic: Vec<usize> = (0..whole.shape.len())
            .filter(|t| whole.parts.dynamic[*t])
            .collect();
        let cuts = scattered_cuts(&dynamic, dynamic.len(), 1e-3);
        let mut s = common::simulation(&scene(&format!(r#", "cuts": [{cuts}]"#)));
        for k in 0..dynamic.len() + 5 {
            s.step(1e-3).unwrap();
            let (model, live) = (s.model(), &s.state().live);
            assert!(live.pieces == live.whole_pieces(model), "{rule} {k}");
        }
        assert_eq!(s.state().live.removed.len(), dynamic.len());
    }
}

/// The same tetrahedra may go at once, or one after the other with splits in between: a copy of the one history is
/// not brought up to date by what the other has on top.
#[test]
fn copies_of_another_history_are_replaced() {
    use tissue::{cut, loose};
    let rule = r#""cutting": {"rule": "duplicate"}, "tools""#;
    let model = common::model(&common::BAR.replace("\"tools\"", rule));
    let mut cutting = cut::Scratch::new(&model);
    let mut pieces = loose::Scratch::new(&model);
    let mut event = |state: &mut State, chosen: &[u32]| {
        cut::event(&model, state, &mut cutting, &mut pieces, chosen);
    };
    let count = model.shape.len();
    let mut found = 0;
    for seed in 0..40 {
        let mut one = State::new(&model);
        let mut next = (0..40).map(|k| ((seed + k) * 337 * (seed + 1) % count) as u32);
        while one.live.splits.is_empty() {
            let Some(t) = next.next() else { break };
            event(&mut one, &[t]);
        }
        let [_, _, 1, alone, ..] = one.live.splits[..] else {
            continue;
        };
        event(&mut one, &[alone]);
        // The last two at once: then there is nothing to split.
        let mut other = State::new(&model);
        let (first, last) = one.live.removed.split_at(one.live.removed.len() - 2);
        first.iter().for_each(|t| event(&mut other, &[*t]));
        event(&mut other, last);
        if other.live.removed == one.live.removed && other.live.splits.is_empty() {
            found += 1;
            other.copy_from(&model, &one);
            assert!(other == one);
        }
    }
    assert!(found > 5, "{found}");
}

/// Bytes that are whole but tell of what cannot have been are refused.
#[test]
fn impossible_histories_are_refused() {
    let rule = r#""cutting": {"rule": "duplicate"}, "tools""#;
    let s = common::simulation(&common::BAR.replace("\"tools\"", rule));
    let (model, whole) = (s.model().clone(), s.save());
    let tetrahedron = model.mesh.tetrahedra[7];
    let star: Vec<u32> = model.topology.star(tetrahedron[0] as usize).to_vec();
    let own = |node: u32| [vec![0, node, 1], vec![7]].concat();
    let cases: [(&str, Vec<u32>, Vec<u32>); 8] = [
        ("twice removed", vec![3, 3], vec![]),
        ("no corner", vec![], own(model.mesh.tetrahedra[200][0])),
        ("spare", vec![], own(0)),
        ("twice moved", vec![], vec![0, tetrahedron[0], 2, 7, 7]),
        ("dead", vec![7], vec![1, tetrahedron[0], 1, 7]),
        ("none", vec![], vec![0, tetrahedron[0], 0]),
        ("too late", vec![], vec![1, tetrahedron[0], 1, 7]),
        (
            "too often",
            vec![],
            star.iter()
                .cycle()
                .take(3000)
                .flat_map(|t| vec![0, tetrahedron[0], 1, *t])
                .collect(),
        ),
    ];
    for (name, removed, splits) in cases {
        let mut state = whole.clone();
        (state.live.removed, state.live.splits) = (removed, splits);
        let bytes = s.serialise(&state);
        assert!(s.deserialise(&bytes).is_err(), "{name}");
    }
    let mut state = whole.clone();
    state.live.splits = own(tetrahedron[0]);
    assert!(s.deserialise(&s.serialise(&state)).is_ok());
}
