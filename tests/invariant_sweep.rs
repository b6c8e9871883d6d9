//! The fused sweep equals its plain form and the papers' edge list.

mod common;

use tissue::model::edge_list::EdgeList;
use tissue::model::sweep::{Advance, Motion, plain, sweep};
use tissue::model::tensor_mass::Lane;

#[derive(Clone)]
struct Fields {
    displacement: Vec<Lane>,
    velocity: Vec<Lane>,
    residual: Vec<Lane>,
    partial: Vec<Lane>,
}

#[test]
fn fused_equals_plain_equals_edge_list() {
    let model = common::model(common::BAR);
    let state = tissue::state::State::new(&model);
    let n = model.mesh.nodes.len();
    let mut fields: Vec<Fields> = vec![
        Fields {
            displacement: (0..n)
                .map(|k| Lane([
                    1e-3 * (k as f64).sin(),
                    1e-3 * (2.0 * k as f64).cos(),
                    1e-4 * k as f64 / n as f64,
                    0.0
                ]))
                .collect(),
            velocity: (0..n)
                .map(|k| Lane([0.01 * (k as f64).cos(), 0.0, 0.02, 0.0]))
                .collect(),
            residual: vec![Lane::default(); n],
            partial: vec![Lane::default(); n],
        };
        3
    ];
    let (h, c) = (1e-4, 7.0);
    let list = EdgeList::new(&model.pattern, &state.live.tensors);
    for _ in 0..50 {
        let mut sums = Vec::new();
        for (k, f) in fields.iter_mut().enumerate() {
            let mut motion = Motion {
                displacement: &mut f.displacement,
                velocity: &mut f.velocity,
                residual: &mut f.residual,
                partial: &mut f.partial,
                external: &state.external,
                inverse_mass: &state.inverse_mass,
                mass: &state.live.mass,
                listed: None,
            };
            match k {
                0 => sums.push(sweep(
                    &model.pattern,
                    &state.live.tensors,
                    &mut motion,
                    &Advance::symplectic_euler(h, h, c),
                )),
                1 => sums.push(plain(
                    &model.pattern,
                    &state.live.tensors,
                    &mut motion,
                    &Advance::symplectic_euler(h, h, c),
                )),
                _ => list.step(&mut motion, h, c),
            }
        }
        let (a, b) = (sums[0], sums[1]);
        for (x, y) in [
            (a.elastic, b.elastic),
            (a.kinetic, b.kinetic),
            (a.damping, b.damping),
            (a.external, b.external),
            (a.lagging, b.lagging),
        ] {
            assert!(
                (x - y).abs() <= 1e-12 * (a.elastic.abs() + a.kinetic.abs()),
                "{x} {y}"
            );
        }
    }
    let scale = fields[0]
        .displacement
        .iter()
        .map(|u| u.xyz().amax())
        .fold(0.0, f64::max);
    for other in &fields[1..] {
        for (x, y) in fields[0].displacement.iter().zip(&other.displacement) {
            assert!((x.xyz() - y.xyz()).amax() < 1e-12 * scale);
        }
    }
    assert!(fields[0].partial.iter().all(|p| *p == Lane::default()));
}

#[test]
fn row_products_are_rows_of_the_product() {
    let model = common::model(common::BAR);
    let tensors = &model.whole.tensors;
    let n = model.mesh.nodes.len();
    let u: Vec<Lane> = (0..n)
        .map(|k| Lane([(k as f64).sin(), (3.0 * k as f64).cos(), 0.1, 0.0]))
        .collect();
    let mut all = vec![tissue::mesh::Vec3::zeros(); n];
    tensors.product(&model.pattern, &u, &mut all);
    let scale = all.iter().map(|f| f.amax()).fold(0.0, f64::max);
    for (i, f) in all.iter().enumerate() {
        assert!((tensors.row_product(&model.pattern, i, &u) - f).amax() < 1e-14 * scale);
    }
    let nodes: Vec<u32> = (0..n as u32).collect();
    let mut to = vec![Lane([1.0; 4]); n];
    tensors.products_among(&model.pattern, &nodes, &u, &mut to);
    for (to, f) in to.iter().zip(&all) {
        assert!((to.xyz() - f).amax() < 1e-14 * scale);
    }
}
