//! What one removal costs, on the demo's liver and on the papers' plate: `cargo bench -p tissue --bench cut`.
//!
//! Tetrahedra go one at a time, clean-up, pieces and energy account included: plane by plane as in a cut through, or
//! scattered, which leaves dust. The whole is done again in a fresh state several times; of each removal the shortest time
//! counts, which leaves out what the machine did meanwhile. Prints CSV with a substep of the same run to compare by.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use tissue::cut;
use tissue::loose;
use tissue::model::Model;
use tissue::simulation::Simulation;

const PLATE: &str = include_str!("../../examples/plate_cut.json");
const LIVER: &str = include_str!("../../examples/hepatectomy.json");
const RUNS: usize = 15;

fn main() {
    println!("mesh,what,microseconds");
    for (name, text) in [("plate", PLATE), ("liver", LIVER)] {
        let scene = tissue::scene::parse(text, "bench.json").expect("a scene of this file");
        let model = Arc::new(
            tissue::prepared::prepare(scene, Path::new("bench.json"))
                .expect("a scene of this file"),
        );
        substep(name, &model);
        loose_half(name, &model);
        for (order, through, share) in [
            ("scattered to a tenth", false, 0.1),
            ("scattered to half", false, 0.5),
            ("through", true, 0.5),
        ] {
            removals(name, order, &model, through, share);
        }
    }
}

fn substep(name: &str, model: &Arc<Model>) {
    let mut s = Simulation::new(model.clone());
    let substeps = (1e-3 / s.substep()).round();
    let mut times: Vec<f64> = (0..20 * RUNS)
        .map(|k| {
            // Tissue that cannot tear takes no notice of it but wakes.
            s.set_tearing_threshold(if k % 2 == 0 { 1.0 } else { 2.0 });
            let start = Instant::now();
            s.step(1e-3).expect("a step");
            start.elapsed().as_secs_f64() / substeps
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!("{name},substep,{:.2}", 1e6 * times[times.len() / 2]);
}

/// A substep when a slice across the mesh has gone, so that what is loose moves in its frame.
fn loose_half(name: &str, model: &Arc<Model>) {
    let middle = model.report.bounds[0] * 0.35 + model.report.bounds[1] * 0.65;
    let through = |t: &u32| {
        let at = model.mesh.tetrahedra[*t as usize].map(|v| model.mesh.nodes[v as usize].x);
        (at.iter().sum::<f64>() / 4.0 - middle.x).abs() < 0.7 * model.longest_edge
    };
    let chosen: Vec<u32> = (0..model.mesh.tetrahedra.len() as u32)
        .filter(through)
        .collect();
    let mut s = Simulation::new(model.clone());
    s.step(0.02).expect("a step");
    let mut state = s.save();
    state.reserve(model);
    let mut scratch = cut::Scratch::new(model);
    let mut loose = loose::Scratch::new(model);
    cut::event(model, &mut state, &mut scratch, &mut loose, &chosen);
    s.restore(&state);
    let length = 100.0 * s.substep();
    let mut times: Vec<f64> = (0..RUNS)
        .map(|_| {
            let start = Instant::now();
            s.step(length).expect("a step");
            start.elapsed().as_secs_f64() / 100.0
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let nodes = s.state().live.pieces.loose_nodes().len();
    println!(
        "{name},substep with {nodes} of {} vertices loose,{:.2}",
        model.mesh.nodes.len(),
        1e6 * times[RUNS / 2]
    );
}

/// Scattered over the mesh, or plane by plane through it, until a share of it is chosen.
fn removals(name: &str, how: &str, model: &Arc<Model>, through: bool, share: f64) {
    let count = model.mesh.tetrahedra.len();
    let mut order: Vec<u32> = (0..count as u32).collect();
    if through {
        let at = |t: &u32| {
            let nodes = model.mesh.tetrahedra[*t as usize];
            let middle = nodes.map(|v| model.mesh.nodes[v as usize]);
            middle
                .iter()
                .map(|p| (p.x * 1000.0 / 5.0).floor() * 1000.0 + p.y)
                .sum::<f64>()
        };
        order.sort_by(|a, b| at(a).total_cmp(&at(b)));
    } else {
        let mut seed = 7u64;
        for k in (1..count).rev() {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            order.swap(k, (seed >> 33) as usize % (k + 1));
        }
    }
    order.truncate((count as f64 * share) as usize);
    let mut start = Simulation::new(model.clone());
    start.step(0.02).expect("a step");
    let saved = start.save();
    let mut best: Vec<f64> = Vec::new();
    let mut lost = Vec::new();
    for run in 0..RUNS {
        let mut state = saved.clone();
        state.reserve(model);
        let mut scratch = cut::Scratch::new(model);
        let mut loose = loose::Scratch::new(model);
        let mut at = 0;
        for t in &order {
            if !state.live.alive[*t as usize] {
                continue;
            }
            let before = state.live.removed.len();
            let clock = Instant::now();
            cut::event(model, &mut state, &mut scratch, &mut loose, &[*t]);
            let time = clock.elapsed().as_secs_f64();
            if run == 0 {
                best.push(time);
                lost.push(state.live.removed.len() - before);
            } else {
                best[at] = best[at].min(time);
            }
            at += 1;
        }
    }
    let worst = (0..best.len())
        .max_by(|a, b| best[*a].total_cmp(&best[*b]))
        .unwrap_or(0);
    println!(
        "# the dearest removal of {name}, {how}: {} tetrahedra went, event {worst} of {}",
        lost[worst],
        best.len()
    );
    let each: Vec<f64> = best.iter().zip(&lost).map(|(t, n)| t / *n as f64).collect();
    for (unit, mut sorted) in [("removal", best), ("tetrahedron that went", each)] {
        sorted.sort_by(f64::total_cmp);
        for (what, share) in [("median", 0.5), ("p99", 0.99), ("worst", 1.0)] {
            let k = ((sorted.len() - 1) as f64 * share) as usize;
            println!("{name},{how}: {what} a {unit},{:.2}", 1e6 * sorted[k]);
        }
    }
}
