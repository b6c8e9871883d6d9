//! What keeps tetrahedra of averaged elements from turning inside out: its forces, its frequency, its account.

mod common;

use std::sync::Arc;

use nalgebra::{DMatrix, Rotation3};
use tissue::element::Elements;
use tissue::element::guard;
use tissue::element::kernel::Kernel;
use tissue::element::listed::Listed;
use tissue::live::LiveMesh;
use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::model::tensor_mass::Lane;
use tissue::simulation::Simulation;

/// J_0.
const LEAST: f64 = 0.3;

/// A block of two materials between plates that press it to a share of its height.
fn scene(share: f64, more: &str) -> String {
    format!(
        r#"{{"name": "block", "mesh": {{"box": {{"size": [0.04, 0.03, 0.02], "cells": [5, 4, 3]}}}},
  "materials": [{{"where": {{"all": true}}, "youngModulus": 6000, "poissonRatio": 0.4, "density": 1060}},
    {{"where": {{"box": {{"min": [0.02, 0, 0], "max": [1, 1, 1]}}}}, "youngModulus": 15000, "poissonRatio": 0.3, "density": 1060}}],
  "fixed": [{{"box": {{"min": [0, 0, 0], "max": [1, 1, 0]}}}}],
  "prescribed": [{{"where": {{"box": {{"min": [0, 0, 0.02], "max": [1, 1, 0.02]}}}}, "displacement": [0, 0, {}], "ramp": 1}}],
  "gravity": [0, 0, 0], {more}
  "model": {{"elasticity": "stableNeoHookean", "element": "nodalAveraged"}}}}"#,
        -0.02 * (1.0 - share)
    )
}

fn model() -> Arc<Model> {
    common::model(&scene(0.4, ""))
}

fn elements(live: &LiveMesh) -> &Elements {
    live.elements.as_ref().unwrap()
}

/// Pressed to about a share of the height, with noise.
fn pressed(model: &Model, share: f64) -> Vec<Lane> {
    let mut seed = 3u64;
    let mut random = move || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (seed >> 33) as f64 / f64::from(1u32 << 30) - 1.0
    };
    let each = model.mesh.nodes.iter().map(|x| {
        let wide = 1.0 + 0.3 * (1.0 - share);
        let to = Vec3::new(x.x * wide, x.y * wide, x.z * share);
        Lane::from(to - x + Vec3::new(random(), random(), random()) * 1e-3)
    });
    each.collect()
}

fn ratio(model: &Model, t: usize, u: &[Lane]) -> f64 {
    let own = model.mesh.tetrahedra[t].map(|v| u[v as usize].xyz());
    model.shape[t].deformation_gradient(&own).determinant()
}

/// Energy \[J\], forces \[N\] and the guard's rate \[1/s²\].
type Evaluated = (f64, Vec<Lane>, f64);

fn forces(live: &LiveMesh, u: &[Lane]) -> Evaluated {
    let mut to = vec![Lane::default(); u.len()];
    let mut rows = vec![0.0; live.points()];
    let (energy, extent) = elements(live).add_forces(None, u, &mut to, &mut rows, &live.mass);
    assert!(rows.iter().all(|row| *row == 0.0));
    (energy, to, extent.guard)
}

/// What the guard has of them.
fn alone(live: &LiveMesh, u: &[Lane]) -> (f64, Vec<Vec3>) {
    let Elements::NodalAveraged(own, _) = elements(live) else {
        unreachable!()
    };
    let (energy, to, _) = forces(live, u);
    let mut less = vec![Lane::default(); u.len()];
    let (other, _) = own.add_forces(u, &mut less);
    let rest = to.iter().zip(&less).map(|(a, b)| a.xyz() - b.xyz());
    (energy - other, rest.collect())
}

#[test]
fn only_tetrahedra_below_its_limit_are_guarded() {
    let model = model();
    let live = &model.whole;
    for (share, active) in [(1.0, 0), (0.7, 0), (0.35, 10), (0.2, 100)] {
        let u = pressed(&model, share);
        let own = |t: &usize| ratio(&model, *t, &u) < LEAST;
        let found: Vec<usize> = (0..model.shape.len()).filter(own).collect();
        assert!(found.len() >= active && (active > 0 || found.is_empty()));
        let (energy, rest) = alone(live, &u);
        let (mut sum, mut single) = (0.0, vec![Vec3::zeros(); u.len()]);
        for t in found {
            let (law, shape) = (&model.material(t).law, &model.shape[t]);
            let nodes = model.mesh.tetrahedra[t];
            let (force, own) = guard::force(law, shape, &nodes.map(|v| u[v as usize].xyz()));
            let l = law.lambda + 5.0 / 6.0 * law.mu;
            let missing = LEAST - ratio(&model, t, &u);
            let truth = 0.5 * 10.0 * l * shape.volume * missing * missing;
            assert!((own - truth).abs() < 1e-12 * truth);
            for (v, f) in nodes.iter().zip(force) {
                single[*v as usize] += f;
            }
            sum += own;
        }
        let (all, ..) = forces(live, &u);
        assert!((energy - sum).abs() <= 1e-13 * all);
        let (_, to, _) = forces(live, &u);
        let scale = to.iter().map(|f| f.xyz().norm()).fold(0.0, f64::max);
        for (a, b) in rest.iter().zip(&single) {
            assert!((a - b).norm() <= 1e-13 * scale);
        }
        for i in 0..u.len() {
            let own = live.internal_force(&model, i, &u);
            assert!((own - to[i].xyz()).norm() <= 1e-12 * scale);
        }
    }
}

#[test]
fn forces_and_tangent_are_derivatives() {
    let model = model();
    let live = &model.whole;
    let u = pressed(&model, 0.3);
    // No limit is crossed on the way.
    let near = |t: usize| (ratio(&model, t, &u) - LEAST).abs();
    let nearest = (0..model.shape.len()).map(near).fold(1.0, f64::min);
    let (_, f, _) = forces(live, &u);
    let scale = f.iter().map(|f| f.xyz().norm()).fold(0.0, f64::max);
    let h = 2e-8;
    assert!(nearest > 2.0 * h * 2000.0, "{nearest}");
    let along = |direction: &[Vec3], h: f64| {
        let each = u.iter().zip(direction);
        let moved: Vec<Lane> = each.map(|(u, d)| Lane::from(u.xyz() + d * h)).collect();
        forces(live, &moved)
    };
    let entries = elements(live).tangent(&u).unwrap();
    for k in 0..6 {
        let wave = |i: usize, n: f64| (n * i as f64 + k as f64).sin();
        let direction: Vec<Vec3> = (0..u.len())
            .map(|i| Vec3::new(wave(i, 1.1), wave(i, 1.7), wave(i, 2.3)))
            .collect();
        let [a, b, c, d] = [h, -h, 2.0 * h, -2.0 * h].map(|h| along(&direction, h));
        let slope = |of: &dyn Fn(&Evaluated) -> f64| {
            (8.0 * (of(&a) - of(&b)) - of(&c) + of(&d)) / (12.0 * h)
        };
        let power: f64 = f.iter().zip(&direction).map(|(f, d)| f.xyz().dot(d)).sum();
        let most: f64 = f.iter().map(|f| f.xyz().norm()).sum();
        let off = (slope(&|at| at.0) - power).abs();
        assert!(off < 1e-9 * most, "{off:e} of {most:e}");
        let mut product = vec![Vec3::zeros(); u.len()];
        for (i, j, block) in &entries {
            product[*i] += block * direction[*j];
            if i != j {
                product[*j] += block.tr_mul(&direction[*i]);
            }
        }
        let most = product.iter().map(|p| p.norm()).fold(0.0, f64::max);
        for (i, product) in product.iter().enumerate() {
            let rate = Vec3::from_fn(|axis, _| slope(&|at| at.1[i].0[axis]));
            let off = (rate - product).norm();
            assert!(off < 1e-7 * most, "{i}: {off:e} of {most:e}");
        }
    }
    let (mut sum, mut moment) = (Vec3::zeros(), Vec3::zeros());
    for (i, f) in f.iter().enumerate() {
        sum += f.xyz();
        moment += (model.mesh.nodes[i] + u[i].xyz()).cross(&f.xyz());
    }
    assert!(sum.norm() < 1e-12 * scale && moment.norm() < 1e-13 * scale);
    let turn = Rotation3::new(Vec3::new(1.5, -0.7, 2.0));
    let turned: Vec<Lane> = (model.mesh.nodes.iter().zip(&u))
        .map(|(x, u)| Lane::from(turn * (x + u.xyz()) - x))
        .collect();
    for (f, g) in f.iter().zip(&forces(live, &turned).1) {
        assert!((turn * f.xyz() - g.xyz()).norm() < 1e-12 * scale);
    }
}

/// However far what is listed is behind, and however tissue is pressed.
#[test]
fn what_is_listed_is_all_that_counts() {
    let model = model();
    let live = &model.whole;
    let own = elements(live);
    let mut listed = Listed::new(Some(own), None, model.mesh.nodes.len()).unwrap();
    let (mut behind, mut counts) = (0, 0);
    let mut rows = vec![0.0; live.points()];
    for k in 0..400 {
        let share = 0.6 + 0.4 * (0.05 * f64::from(k)).cos();
        let u = pressed(&model, share);
        let before = format!("{listed:?}");
        listed.refresh(Some(own), None, 0, &u);
        behind += usize::from(before == format!("{listed:?}"));
        let [mut some, mut all] = [(), ()].map(|()| vec![Lane::default(); u.len()]);
        let a = own.add_forces(Some(&listed), &u, &mut some, &mut rows, &live.mass);
        let b = own.add_forces(None, &u, &mut all, &mut rows, &live.mass);
        assert!(a == b && some == all);
        assert!(live.extent(&u, &mut rows).guard == a.1.guard);
        counts += usize::from(a.1.guard > 0.0);
    }
    println!("{behind} of 400 times nothing was looked for, {counts} times some counted");
    assert!(behind > 20 && counts > 50);
}

/// The square of the highest frequency grows by no more than is said.
#[test]
fn frequencies_are_bounded() {
    let model = model();
    let live = &model.whole;
    let mass = |i: usize| live.mass[i / 3].sqrt();
    let highest = |u: &[Lane], guarded: bool| {
        let Elements::NodalAveraged(own, _) = elements(live) else {
            unreachable!()
        };
        let entries = match guarded {
            true => elements(live).tangent(u).unwrap(),
            false => own.tangent(u),
        };
        let n = 3 * u.len();
        let mut k = DMatrix::<f64>::zeros(n, n);
        for (i, j, block) in entries {
            for (row, column) in (0..9).map(|at| (at / 3, at % 3)) {
                let (a, b) = (3 * i + row, 3 * j + column);
                let part = block[(row, column)] / (mass(a) * mass(b));
                k[(a, b)] += part;
                if i != j {
                    k[(b, a)] += part;
                }
            }
        }
        k
    };
    let mut rows = vec![0.0; live.points()];
    for share in [0.5, 0.4, 0.3, 0.2, 0.1] {
        let u = pressed(&model, share);
        let (with, without) = (highest(&u, true), highest(&u, false));
        // nalgebra finds no eigenvalues of a matrix that is mostly zero; shifted it does.
        let shift = DMatrix::identity(with.nrows(), with.nrows()) * 1e7;
        let own = (&with - &without + shift).symmetric_eigenvalues().max() - 1e7;
        let bound = live.extent(&u, &mut rows).guard;
        println!(
            "pressed to {share}: highest without {:.3e}, with {:.3e}, of the guard alone {own:.3e}, bound {bound:.3e} 1/s²",
            without.symmetric_eigenvalues().max(),
            with.symmetric_eigenvalues().max()
        );
        assert!(own <= bound && bound < 4.0 * own);
    }
}

/// A block that is pressed is cut through where it is guarded.
fn cut(integration: &str) -> Simulation {
    let more = format!(
        r#""integration": {{"damping": 60{integration}}},
           "cuts": [{{"time": 1.2, "where": {{"box": {{"min": [0, 0, 0], "max": [0.008, 1, 1]}}}}}}],"#
    );
    common::simulation(&scene(0.35, &more))
}

/// What the account misses when guarded tetrahedra go is what it misses of any motion: of the order h².
#[test]
fn cuts_through_what_is_guarded_are_booked() {
    let nominal = cut("").substep();
    let off = [4.0, 16.0].map(|parts| {
        let mut s = cut(&format!(r#", "substep": {:e}"#, nominal / parts));
        let gone = |s: &mut Simulation, until: u32| {
            let mut found = (0.0f64, 0.0f64);
            while s.state().clock.next() < 1e-3 * f64::from(until) {
                s.step(1e-3).unwrap();
                let e = s.energy();
                let off = (e.balance() - s.state().account.start).abs();
                found = (found.0.max(off), found.1.max(e.elastic + e.kinetic));
            }
            found
        };
        let (before, energy) = gone(&mut s, 1199);
        assert!(s.state().extent.guard > 0.0 && s.state().live.removed.is_empty());
        let u = s.state().displacement.clone();
        let (off, _) = gone(&mut s, 1203);
        let removed = &s.state().live.removed;
        let booked: f64 = removed.iter().map(|t| {
            let (law, shape) = (&s.model().material(*t as usize).law, &s.model().shape[*t as usize]);
            let nodes = s.model().mesh.tetrahedra[*t as usize];
            guard::force(law, shape, &nodes.map(|v| u[v as usize].xyz())).1
        }).sum();
        println!("substep {:.1e} s: {} cut, off by {before:.1e} J before and {off:.1e} J after, of {energy:.1e} J; guard of what is cut {booked:.1e} J", s.substep(), removed.len());
        assert!(off < 1e-3 * energy && booked > 10.0 * off);
        off
    });
    assert!(off[0] > 8.0 * off[1]);
}

#[test]
fn guarded_tissue_settles_where_newtons_method_says() {
    let mut s = cut("");
    let mut least = 1.0f64;
    for _ in 0..3000 {
        s.step(1e-3).unwrap();
        least = least.min(s.minimum_volume_ratio());
    }
    let model = s.model().clone();
    let reference = tissue::reference::solve(&model, true).unwrap();
    assert!(least > 0.0 && s.state().live.removed.len() > 10);
    assert!(reference.residual < 1e-10 && reference.minimum_volume_ratio < LEAST);
    let (mut off, mut most) = (0.0f64, 0.0f64);
    for (scene_node, node) in model.node.iter().enumerate() {
        let i = *node as usize;
        if s.state().live.star_count[i] > 0 {
            let u = Vec3::from(reference.displacement[scene_node]);
            off = off.max((s.state().displacement[i].xyz() - u).norm());
            most = most.max(u.norm());
        }
    }
    println!(
        "least det F {least:.2}; settled {:.1e} from where Newton's method says",
        off / most
    );
    assert!(off < 1e-6 * most);
}
