//! After any cuts the live mesh is that of a fresh assembly to the bit, all stars are good, and its surface is
//! closed.

mod common;

use std::collections::HashMap;

use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::model::tensor_mass::Tensors;
use tissue::simulation::Simulation;
use tissue::star::Worklist;
use tissue::state::State;

fn fresh(model: &Model, state: &State) -> (Tensors, Vec<f64>) {
    let mut tensors = Tensors::zeros(&model.pattern);
    let mut mass = vec![0.0; model.mesh.nodes.len()];
    for (t, nodes) in model
        .mesh
        .tetrahedra
        .iter()
        .enumerate()
        .filter(|(t, _)| state.live.alive[*t])
    {
        let material = model.material(t);
        tensors.accumulate(&model.pattern, nodes, &model.shape[t], &material.law);
        for v in nodes {
            mass[*v as usize] += material.density * model.shape[t].volume / 4.0;
        }
    }
    (tensors, mass)
}

fn check(s: &Simulation) {
    let (model, state) = (s.model(), s.state());
    let (tensors, mass) = fresh(model, state);
    let mut live = state.live.tensors.entries(&model.pattern);
    for (i, j, block) in tensors.entries(&model.pattern) {
        assert!(live.next().unwrap().2 == block, "tensor of {i} {j}");
    }
    for (v, m) in mass.iter().enumerate() {
        assert!(state.live.mass[v] == *m, "mass of {v}");
    }
    assert!(Worklist::default().all_good(model, &state.live));
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
        let p: [Vec3; 3] = t.map(|v| model.mesh.nodes[v as usize]);
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
