//! Speed of one linear substep and of one of springs, beside the machine's own limits in the same run.
//!
//! `cargo bench -p tissue --bench step`. Prints CSV: what, median and best, so that ratios travel from
//! machine to machine. Medians of interleaved runs; nothing here fails on time.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use tissue::model::edge_list::EdgeList;
use tissue::model::sweep::{Advance, Motion, plain, sweep};
use tissue::model::tensor_mass::Lane;
use tissue::model::{Model, spring_sweep};
use tissue::scene::{ModelKind, Start};
use tissue::simulation::Simulation;

const PLATE: &str = r#"{"name": "plate", "mesh": {"box": {"size": [0.22, 0.1, 0.02], "cells": [22, 10, 2]}},
  "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}],
  "fixed": [{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}]}"#;
const LIVER: &str = include_str!("../../examples/hepatectomy.json");

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
    do_step();
}

/// 1 ms steps of the liver with the grasper holding its edge.
fn do_step() {
    let mut simulation = Simulation::new(model(LIVER));
    let start = tissue::mesh::Vec3::from(simulation.model().scene.tools[0].position);
    let nearest = (simulation.model().surface_nodes.iter())
        .map(|n| simulation.state().position(simulation.model(), *n))
        .min_by(|a, b| (a - start).norm().total_cmp(&(b - start).norm()))
        .expect("a surface");
    for axis in 0..3 {
        simulation.set_pose_input(0, axis, nearest[axis]);
    }
    simulation.place_tools().expect("a pose");
    simulation.set_active(0, true);
    let mut times: Vec<f64> = (0..2000)
        .map(|k| {
            simulation.set_pose_input(0, 2, nearest.z + 1e-5 * f64::from(k));
            let start = Instant::now();
            simulation.step(1e-3).expect("a step");
            start.elapsed().as_secs_f64()
        })
        .collect();
    assert!(simulation.tool(0).in_contact);
    times.sort_by(f64::total_cmp);
    println!(
        "liver step of 1 ms in contact,{:.1},{:.1},us",
        1e6 * times[1000],
        1e6 * times[0]
    );
    println!(
        "liver step of 1 ms in contact p99.9,{:.1},,us",
        1e6 * times[1998]
    );
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
