//! Speed of one linear substep and of one of springs, beside the machine's own limits in the same run.
//!
//! `cargo bench -p tissue --bench step`, `-- --large` for organs of 100 000 tetrahedra and more, `-- --tearing` for tearing alone,
//! `-- --contact` for tools that slide, `-- --idle` for scenes at rest. Prints CSV: what, median and best, so that ratios travel from
//! machine to machine. Medians of interleaved runs; nothing here fails on time.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use tissue::loose::Scratch;
use tissue::model::edge_list::EdgeList;
use tissue::model::precomputed::compute;
use tissue::model::sweep::{Advance, Motion, plain, sweep};
use tissue::model::tensor_mass::Lane;
use tissue::model::{Model, spring_sweep};
use tissue::scene::{Friction, ModelKind, OutputVertices, Scheme, Shape, Start, Tool, ToolKind};
use tissue::simulation::Simulation;
use tissue::tear::Tears;

const PLATE: &str = r#"{"name": "plate", "mesh": {"box": {"size": [0.22, 0.1, 0.02], "cells": [22, 10, 2]}},
  "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}],
  "fixed": [{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}]}"#;
const LIVER: &str = include_str!("../../examples/hepatectomy.json");
const HYBRID: &str = include_str!("../../examples/hybrid_liver.json");

fn model(text: &str) -> Arc<Model> {
    let path = Path::new("bench.json");
    let scene = tissue::scene::parse(text, "bench.json").expect("a scene of this file");
    Arc::new(tissue::prepared::prepare(scene, path).expect("a scene of this file"))
}

struct Fields {
    displacement: Vec<Lane>,
    velocity: Vec<Lane>,
    residual: Vec<Lane>,
    partial: Vec<Lane>,
    external: Vec<Lane>,
    inverse_mass: Vec<Lane>,
    mass: Vec<f64>,
}

impl Fields {
    fn new(model: &Model) -> Fields {
        let state = Simulation::new(Arc::new(model_clone(model))).save();
        let zeros = vec![Lane::default(); state.displacement.len()];
        Fields {
            displacement: state.displacement,
            velocity: state.velocity,
            residual: zeros.clone(),
            partial: zeros,
            external: state.external,
            inverse_mass: state.inverse_mass,
            mass: state.live.mass,
        }
    }

    fn motion(&mut self) -> Motion<'_> {
        Motion {
            displacement: &mut self.displacement,
            velocity: &mut self.velocity,
            residual: &mut self.residual,
            partial: &mut self.partial,
            external: &self.external,
            inverse_mass: &self.inverse_mass,
            mass: &self.mass,
            listed: None,
        }
    }
}

fn model_clone(model: &Model) -> Model {
    model
        .with_scene(model.scene.clone())
        .expect("the same scene")
}

/// Runs the cases in turn, `rounds` times, `repeats` calls a timing; median and best seconds a call.
fn interleaved(
    rounds: usize,
    repeats: usize,
    cases: &mut [(&str, &mut dyn FnMut())],
) -> Vec<(String, f64, f64)> {
    let mut times = vec![Vec::with_capacity(rounds); cases.len()];
    for _ in 0..rounds {
        for (k, (_, run)) in cases.iter_mut().enumerate() {
            let start = Instant::now();
            for _ in 0..repeats {
                run();
            }
            times[k].push(start.elapsed().as_secs_f64() / repeats as f64);
        }
    }
    (cases.iter().zip(&mut times))
        .map(|((name, _), times)| {
            times.sort_by(f64::total_cmp);
            ((*name).to_string(), times[times.len() / 2], times[0])
        })
        .collect()
}

fn main() {
    println!("what,median,best,unit");
    calibration();
    if std::env::args().any(|a| a == "--tearing") {
        tearing("liver", LIVER);
        return;
    }
    if std::env::args().any(|a| a == "--contact") {
        contact();
        return;
    }
    if std::env::args().any(|a| a == "--idle") {
        idle();
        return;
    }
    if std::env::args().any(|a| a == "--large-deformation") {
        large_deformation();
        return;
    }
    if std::env::args().any(|a| a == "--large") {
        large();
        return;
    }
    for (name, text) in [("plate", PLATE), ("liver", LIVER)] {
        let model = model(text);
        let tensors = &model.whole.tensors;
        let (h, c) = (model.substep(model.damping()), model.damping());
        let by = Advance::symplectic_euler(h, h, c);
        let list = EdgeList::new(&model.pattern, tensors);
        let mut scene = model.scene.clone();
        (scene.model.kind, scene.start) = (ModelKind::SpringMass, Start::Rest);
        let network = model.with_scene(scene).expect("the same mesh");
        let springs = network.whole.springs.as_ref().expect("springs");
        let (mut a, mut b, mut d, mut e, mut f) = (
            Fields::new(&model),
            Fields::new(&model),
            Fields::new(&model),
            Fields::new(&network),
            Fields::new(&network),
        );
        let results = interleaved(
            201,
            20,
            &mut [
                ("fused", &mut || {
                    black_box(sweep(&model.pattern, tensors, &mut a.motion(), &by));
                }),
                ("fused plain", &mut || {
                    black_box(plain(&model.pattern, tensors, &mut b.motion(), &by));
                }),
                ("edge list", &mut || list.step(&mut d.motion(), h, c)),
                ("springs", &mut || {
                    black_box(spring_sweep::sweep(springs, &mut e.motion(), &by));
                }),
                ("springs plain", &mut || {
                    black_box(spring_sweep::plain(springs, &mut f.motion(), &by));
                }),
            ],
        );
        let size = format!(
            "{} {} vertices {} tetrahedra",
            name,
            model.mesh.nodes.len(),
            model.shape.len()
        );
        for (what, median, best) in &results {
            println!("{size}: {what},{:.2},{:.2},us", 1e6 * median, 1e6 * best);
        }
        println!(
            "{size}: edge list / fused,{:.2},{:.2},ratio",
            results[2].1 / results[0].1,
            results[2].2 / results[0].2
        );
    }
    do_step("liver", LIVER, 1e-3);
    tearing("liver", LIVER);
    idle();
    do_step("hybrid liver", HYBRID, 1e-3);
    large_deformation();
    let statics = quasi_static(LIVER, 0.018);
    do_step("quasi-static liver", &statics, 5e-5);
    precompute("hybrid liver", HYBRID);
    precompute("quasi-static liver", &statics);
}

/// The third paper's scene: a liver of 2 000 tetrahedra of its stiffness with a grasper on it, which ran at 25 Hz in 2000; by law
/// and element.
fn large_deformation() {
    for (what, settings) in [
        ("linear", "{}"),
        (
            "StVK",
            r#"{"elasticity": "stVenantKirchhoff", "element": "constantStrain"}"#,
        ),
        (
            "StVK nodal-averaged",
            r#"{"elasticity": "stVenantKirchhoff"}"#,
        ),
        (
            "stable neo-Hookean nodal-averaged",
            r#"{"elasticity": "stableNeoHookean"}"#,
        ),
        (
            "StVK beyond 2 mm",
            r#"{"elasticity": "stVenantKirchhoff", "nonlinearThreshold": 0.002}"#,
        ),
    ] {
        let text = LIVER
            .replace(r#""edgeLength": 0.015"#, r#""edgeLength": 0.0225"#)
            .replacen(r#""start""#, &format!(r#""model": {settings}, "start""#), 1);
        let count = model(&text).shape.len();
        do_step(&format!("liver of {count} {what}"), &text, 1e-3);
    }
}

/// Scenes in which nothing moves, asleep and kept awake; and what it costs to have vertices among the variables that nobody reads.
fn idle() {
    let name = "liver";
    let mut asleep = Simulation::new(model(LIVER));
    let whole = asleep.model().clone();
    let mut steps = 0;
    while !asleep.state().sleep.asleep {
        asleep.step(1e-3).expect("a step");
        steps += 1;
        assert!(steps < 20_000, "{name} does not sleep");
    }
    println!("{name}: asleep after,{steps},,ms");
    let with = |vertices| {
        let mut scene = whole.scene.clone();
        scene.outputs.vertices = vertices;
        Simulation::new(Arc::new(whole.with_scene(scene).expect("the same mesh")))
    };
    // Tissue that cannot tear takes no notice of it but wakes.
    let awake = |s: &mut Simulation| {
        let now = s.parameters().tearing_threshold;
        s.set_tearing_threshold(if now == 1.0 { 2.0 } else { 1.0 });
        s.step(1e-3).expect("a step");
    };
    let (mut none, mut surface, mut all, mut read) = (
        with(OutputVertices::None),
        with(OutputVertices::Surface),
        with(OutputVertices::All),
        with(OutputVertices::All),
    );
    let results = interleaved(
        201,
        20,
        &mut [
            ("asleep", &mut || asleep.step(1e-3).expect("a step")),
            ("awake, all vertices", &mut || awake(&mut all)),
            ("awake, surface", &mut || awake(&mut surface)),
            ("awake, no vertices", &mut || awake(&mut none)),
            ("awake, all vertices read", &mut || {
                awake(&mut read);
                for j in 0..read.model().surface_nodes.len() {
                    black_box(read.surface_vertex(j));
                }
            }),
        ],
    );
    for (what, median, best) in &results {
        println!(
            "{name}: step of 1 ms {what},{:.3},{:.3},us",
            1e6 * median,
            1e6 * best
        );
    }
}

/// Two capsules press on the liver and slide to and fro; beside the same scene without them, kept awake by an open
/// grasper.
fn contact() {
    let whole = model(LIVER);
    let mut tops: Vec<_> = whole
        .surface_nodes
        .iter()
        .map(|v| whole.mesh.nodes[*v as usize])
        .collect();
    tops.sort_by(|a, b| b.z.total_cmp(&a.z));
    let first = tops[0];
    let second = tops.iter().find(|x| (**x - first).xy().norm() > 0.05);
    let places = [first, *second.expect("a liver is larger")];
    let tools = (0..2)
        .map(|k| Tool {
            name: format!("probe {k}"),
            kind: ToolKind::Probe,
            shape: Shape::Capsule {
                radius: 0.005,
                length: 0.25,
            },
            active_length: None,
            friction: Friction::Coulomb(0.3),
            slip_force: None,
            position: [places[k].x, places[k].y, places[k].z + 0.05],
            // Its shaft up, aslant.
            orientation: [0.3, 1.0, 0.0, 0.0],
        })
        .collect();
    let model = with_tools(&whole, tools);
    let open = Tool {
        name: "open".into(),
        kind: ToolKind::Grasper,
        ..model.scene.tools[0].clone()
    };
    let mut bare = Simulation::new(with_tools(&whole, vec![open]));
    let mut near = Simulation::new(model);
    let mut times = [Vec::new(), Vec::new()];
    let mut touching = 0;
    for step in 0..3000 {
        let t = 1e-3 * f64::from(step);
        for (k, place) in places.iter().enumerate() {
            let x = place.x + 0.01 * (2.0 * t).sin();
            let z = place.z + 0.005 + 0.045 * (1.0 - t).max(0.0) - 0.012 * t.min(1.0);
            near.set_pose_input(k, 0, x);
            near.set_pose_input(k, 2, z);
            bare.set_pose_input(0, 0, x);
        }
        for (s, times) in [&mut near, &mut bare].into_iter().zip(&mut times) {
            let start = Instant::now();
            s.step(1e-3).expect("a stable step");
            if step >= 1000 {
                times.push(start.elapsed().as_secs_f64());
            }
        }
        let active = near
            .state()
            .contacts
            .iter()
            .filter(|c| c.force.norm() > 0.0);
        touching = touching.max(active.count());
    }
    let substeps = (1e-3 / near.substep()).round();
    let [near_time, bare_time] = times.each_mut().map(|times| {
        times.sort_by(f64::total_cmp);
        [times[times.len() / 2], times[0]].map(|t| 1e6 * t / substeps)
    });
    println!("substeps a ms,{substeps},{substeps},");
    println!("places that touch at most,{touching},{touching},");
    println!("places that may,{0},{0},", near.state().contacts.len());
    println!(
        "substep without tools,{:.2},{:.2},us",
        bare_time[0], bare_time[1]
    );
    println!(
        "substep in contact,{:.2},{:.2},us",
        near_time[0], near_time[1]
    );
    let more = [near_time[0] - bare_time[0], near_time[1] - bare_time[1]];
    println!("contact,{:.2},{:.2},us", more[0], more[1]);
    println!("force,{0:.2},{0:.2},N", near.tool(0).force.norm());
}

fn with_tools(model: &Model, tools: Vec<Tool>) -> Arc<Model> {
    let mut scene = model.scene.clone();
    (scene.tools, scene.tearing) = (tools, None);
    scene.cuts.clear();
    scene.integration.scheme = Some(Scheme::SymplecticEuler);
    Arc::new(model.with_scene(scene).expect("the same mesh"))
}

/// All pre-computed, at 20 kHz, with a grasper so thick that it holds twenty nodes.
fn quasi_static(text: &str, radius: f64) -> String {
    let model =
        r#""model": {"kind": "quasiStatic"}, "integration": {"hapticRate": 20000}, "start""#;
    let thick = format!(r#""radius": {radius}, "length": 0.25}}}}, "activeLength": 0.012"#);
    let thin = r#""radius": 0.004, "length": 0.25}}, "activeLength": 0.012"#;
    text.replace(r#""start""#, model).replace(thin, &thick)
}

/// Factor and solutions, on one thread.
fn precompute(name: &str, text: &str) {
    let model = model(text);
    let mut times: Vec<f64> = (0..5)
        .map(|_| {
            let start = Instant::now();
            black_box(compute(&model, 1, &|_| {}).expect("held tissue"));
            start.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let columns = 3 * (model.parts.connection + model.parts.touchable);
    println!(
        "{name}: pre-computation of {columns} columns on one thread,{:.3},{:.3},s",
        times[2], times[0]
    );
}

/// 100 000 tetrahedra with 5 000 dynamic ones, and 160 000 to pre-compute. Minutes, and some GB. The host's
/// steps are even, so that the scene may ask for a substep past the margin for uneven ones.
fn large() {
    let tool = r#"[{"name": "grasper", "kind": "grasper", "shape": {"sphere": {"radius": 0.008}}, "position": [0.1, 0, 0.03]}]"#;
    let scene = |edge: f64, dynamic: f64| {
        format!(
            r#"{{"name": "organ", "mesh": {{"liver": {{"edgeLength": {edge}}}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}}],
            "fixed": [{{"box": {{"min": [-0.1, 0.02, 0.0], "max": [0.03, 0.2, 0.2]}}}}],
            "integration": {{"damping": 20, "substep": 0.00025}},
            "model": {{"kind": "hybrid", "dynamic": {{"halfSpace": {{"point": [{dynamic}, 0, 0], "normal": [1, 0, 0]}}}},
                "touchable": {{"sphere": {{"center": [{dynamic}, 0, 0], "radius": 0.03}}}}}},
            "outputs": {{"vertices": "none"}}, "tools": {tool}}}"#
        )
    };
    let small = scene(0.0059, 0.0895);
    precompute_large("organ", &small);
    do_step("organ", &small, 1e-3);
    for modes in [60, 120] {
        let key = format!(r#""interfaceModes": {modes}, "touchable""#);
        let reduced = small.replace(r#""touchable""#, &key);
        let name = format!("organ with {modes} modes");
        precompute_large(&name, &reduced);
        do_step(&name, &reduced, 1e-3);
    }
    if !std::env::args().any(|a| a == "--one") {
        precompute_large("large organ", &scene(0.005, 0.077));
    }
}

fn precompute_large(name: &str, text: &str) {
    let start = Instant::now();
    let model = model(text);
    let dynamic = model.parts.dynamic.iter().filter(|d| **d).count();
    println!(
        "{name}: {} tetrahedra {dynamic} dynamic {} connection {} touchable nodes: model,{:.1},,s",
        model.shape.len(),
        model.parts.connection,
        model.parts.touchable,
        start.elapsed().as_secs_f64()
    );
    let critical = model.critical_step(model.damping());
    println!("{name}: critical substep,{:.4},,ms", 1e3 * critical);
    println!("{name}: peak memory,{:.2},,GB", peak_memory());
    let part = model.precomputed.as_ref().expect("a pre-computed part");
    let size = part.interface.size().next_multiple_of(4);
    let (u, mut force) = (vec![1e-3; size], vec![0.0; size]);
    let mut product = || part.interface.product(black_box(&u), &mut force);
    let result = interleaved(101, 10, &mut [("interface", &mut product)]);
    if let Ok(Some(error)) = tissue::reference::interface_error(&model) {
        println!("{name}: equilibrium off by,{error:.1e},,1");
    }
    println!(
        "{name}: interface of {size},{:.1},{:.1},us",
        1e6 * result[0].1,
        1e6 * result[0].2
    );
}

/// Of this process so far; 0 where the system does not say.
fn peak_memory() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|l| l.trim().trim_end_matches(" kB").parse().ok());
    kilobytes.map_or(0.0, |kb: f64| kb * 1e-6)
}

/// Steps with the grasper holding the surface node nearest to its place.
fn do_step(name: &str, text: &str, length: f64) {
    let mut simulation = Simulation::new(model(text));
    let start = tissue::mesh::Vec3::from(simulation.model().scene.tools[0].position);
    let reach = simulation.model().parts.moving + simulation.model().parts.touchable;
    let nearest = (simulation.model().whole.surface.iter())
        .flat_map(|f| simulation.model().topology.faces[*f as usize].vertices)
        .filter(|v| (*v as usize) < reach)
        .map(|v| simulation.state().position(v))
        .min_by(|a, b| (a - start).norm().total_cmp(&(b - start).norm()))
        .expect("a surface");
    for axis in 0..3 {
        simulation.set_pose_input(0, axis, nearest[axis]);
    }
    simulation.place_tools().expect("a pose");
    simulation.set_active(0, true);
    let count = 10_000;
    let mut times: Vec<f64> = (0..count)
        .map(|k| {
            // Up and down, 10 mm/s.
            let up = f64::from(1000 - (k % 2000 - 1000_i32).abs());
            simulation.set_pose_input(0, 2, nearest.z + 1e-2 * length * up);
            let start = Instant::now();
            simulation.step(length).expect("a step");
            start.elapsed().as_secs_f64()
        })
        .collect();
    assert!(simulation.tool(0).in_contact);
    times.sort_by(f64::total_cmp);
    let (median, best) = (1e6 * times[times.len() / 2], 1e6 * times[0]);
    let substeps = (length / simulation.substep()).round();
    let held = simulation.state().held.len();
    println!("{name}: step of {length} s with {held} nodes held,{median:.1},{best:.1},us");
    println!(
        "{name}: a substep of it ({substeps} a step),{:.1},{:.1},us",
        median / substeps,
        best / substeps
    );
    for share in [0.99, 0.999, 1.0] {
        let at = ((share * f64::from(count)) as usize).min(times.len() - 1);
        println!("{name}: step p{},{:.1},,us", 100.0 * share, 1e6 * times[at]);
    }
}

/// Finding what tears, at each tick of 1 ms, beside the substeps of that tick, while a probe presses the
/// liver by 10 mm at 20 mm/s and lets go. Nothing tears.
fn tearing(name: &str, text: &str) {
    for criterion in ["volume", "meanElongation", "maximumElongation"] {
        let tearing =
            format!(r#""tearing": {{"criterion": "{criterion}", "threshold": 0.35}}, "start""#);
        let scene = text.replace(r#""start""#, &tearing);
        let mut simulation = Simulation::new(model(
            &scene.replace(r#""kind": "grasper""#, r#""kind": "probe""#),
        ));
        // The highest vertex of the left lobe.
        let top = (simulation.model().whole.surface.iter())
            .flat_map(|f| simulation.model().topology.faces[*f as usize].vertices)
            .map(|v| simulation.state().position(v))
            .filter(|p| p.x > 0.09)
            .max_by(|a, b| a.z.total_cmp(&b.z))
            .expect("a surface");
        let place = |simulation: &mut Simulation, depth: f64| {
            for (axis, at) in [top.x, top.y, top.z + 0.004 - depth]
                .into_iter()
                .enumerate()
            {
                simulation.set_pose_input(0, axis, at);
            }
            for (axis, at) in [0.0, 1.0, 0.0, 0.0].into_iter().enumerate() {
                simulation.set_pose_input(0, 3 + axis, at);
            }
        };
        place(&mut simulation, 0.0);
        simulation.place_tools().expect("a pose");
        let (count, mut contacts) = (4000, 0);
        let loose = Scratch::new(simulation.model());
        let mut tears = Tears::new(simulation.model());
        let (mut finding, mut stepping) = (Vec::new(), Vec::new());
        for k in 0..count {
            let phase = f64::from(k % 1000) * 1e-3;
            place(&mut simulation, 0.02 * phase.min(1.0 - phase));
            let start = Instant::now();
            let found = black_box(tears.find(simulation.model(), simulation.state(), &loose)).len();
            finding.push(start.elapsed().as_secs_f64());
            assert_eq!(found, 0);
            let start = Instant::now();
            simulation.step(1e-3).expect("a step");
            stepping.push(start.elapsed().as_secs_f64());
            contacts += u32::from(simulation.tool(0).in_contact);
        }
        assert!(contacts > 1000, "{contacts}");
        let share =
            tears.looked_at as f64 / (f64::from(count) * simulation.model().shape.len() as f64);
        let mean = finding.iter().sum::<f64>() / stepping.iter().sum::<f64>();
        finding.sort_by(f64::total_cmp);
        stepping.sort_by(f64::total_cmp);
        let median = |times: &[f64]| times[times.len() / 2];
        println!(
            "{name}: tearing by {criterion} a tick,{:.2},{:.2},us",
            1e6 * median(&finding),
            1e6 * finding[0]
        );
        println!(
            "{name}: p99 and most of it,{:.2},{:.2},us",
            1e6 * finding[finding.len() * 99 / 100],
            1e6 * finding[finding.len() - 1]
        );
        println!(
            "{name}: of the tick's step, median and mean,{:.4},{mean:.4},1",
            median(&finding) / median(&stepping)
        );
        println!("{name}: tetrahedra looked at,{share:.4},,1");
    }
}

/// Independent fused multiply-adds and a streaming sum, on one core.
fn calibration() {
    let mut data = vec![1.0f64; 1 << 15];
    let mut large = vec![1.0f64; 1 << 25];
    let results = interleaved(
        31,
        1,
        &mut [
            ("fma", &mut || {
                black_box(fma_chain());
            }),
            ("l2", &mut || {
                for _ in 0..256 {
                    black_box(stream(black_box(&mut data)));
                }
            }),
            ("dram", &mut || {
                black_box(stream(black_box(&mut large)));
            }),
        ],
    );
    println!(
        "machine FMA f64,{:.1},{:.1},GFLOP/s",
        FMAS * 2e-9 / results[0].1,
        FMAS * 2e-9 / results[0].2
    );
    let gb = |bytes: f64, s: f64| bytes * 1e-9 / s;
    let l2 = 256.0 * 8.0 * (1 << 15) as f64;
    println!(
        "machine read 256 kB,{:.1},{:.1},GB/s",
        gb(l2, results[1].1),
        gb(l2, results[1].2)
    );
    let dram = 8.0 * (1 << 25) as f64;
    println!(
        "machine read 256 MB,{:.1},{:.1},GB/s",
        gb(dram, results[2].1),
        gb(dram, results[2].2)
    );
}

const FMAS: f64 = 4.0 * 12.0 * 200_000.0;

#[cfg(target_arch = "x86_64")]
fn fma_chain() -> f64 {
    #[target_feature(enable = "avx2,fma")]
    fn run() -> f64 {
        use std::arch::x86_64::*;
        let (a, b) = (_mm256_set1_pd(0.999_999), _mm256_set1_pd(1e-9));
        let mut x = [_mm256_set1_pd(1.0); 12];
        for _ in 0..200_000 {
            for v in &mut x {
                *v = _mm256_fmadd_pd(*v, a, b);
            }
        }
        let mut sum = x[0];
        for v in &x[1..] {
            sum = _mm256_add_pd(sum, *v);
        }
        _mm256_cvtsd_f64(sum)
    }
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the features are there.
        unsafe { run() }
    } else {
        0.0
    }
}

#[cfg(not(target_arch = "x86_64"))]
fn fma_chain() -> f64 {
    let mut x = [1.0f64; 48];
    for _ in 0..200_000 {
        for v in &mut x {
            *v = v.mul_add(0.999_999, 1e-9);
        }
    }
    x.iter().sum()
}

#[cfg(target_arch = "x86_64")]
fn stream(data: &mut [f64]) -> f64 {
    #[target_feature(enable = "avx2")]
    fn run(data: &[f64]) -> f64 {
        let mut sum = [0.0; 32];
        for chunk in data.as_chunks::<32>().0 {
            for (s, x) in sum.iter_mut().zip(chunk) {
                *s += x;
            }
        }
        sum.iter().sum()
    }
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the feature is there.
        return unsafe { run(data) };
    }
    data.iter().sum()
}

#[cfg(not(target_arch = "x86_64"))]
fn stream(data: &mut [f64]) -> f64 {
    data.iter().sum()
}
