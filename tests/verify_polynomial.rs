//! The papers' polynomial form against the same law tetrahedron by tetrahedron: forces, cuts, motion.

mod common;

use nalgebra::Rotation3;
use tissue::cut;
use tissue::element::Elements;
use tissue::element::constant_strain::Shape;
use tissue::element::kernel::Kernel;
use tissue::element::polynomial::Polynomial;
use tissue::element::tetrahedra::Tetrahedra;
use tissue::law::linear::Hooke;
use tissue::law::response::Law;
use tissue::live::LiveMesh;
use tissue::loose;
use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::model::tensor_mass::Lane;
use tissue::simulation::Simulation;
use tissue::state::State;

/// Between -1 and 1.
fn noise(mut seed: u64) -> impl FnMut() -> f64 {
    move || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (seed >> 33) as f64 / f64::from(1u32 << 30) - 1.0
    }
}

/// A bar of two materials, one with fibres or neither, of an odd number of tetrahedra.
struct Bar {
    nodes: Vec<Vec3>,
    tetrahedra: Vec<[u32; 4]>,
    shape: Vec<Shape>,
    material: Vec<Hooke>,
}

impl Bar {
    fn new(fibres: bool) -> Bar {
        let model = common::model(common::BAR);
        let mut tetrahedra = model.mesh.tetrahedra.clone();
        tetrahedra.pop();
        let (soft, hard) = (Hooke::new(6000.0, 0.45), Hooke::new(20_000.0, 0.3));
        let threads = soft.with_fibre(Vec3::new(1.0, 0.3, -0.2), 8e4, 2e4);
        let each = |t: usize| match (t % 3, fibres) {
            (0, _) => hard,
            (1, true) => threads,
            _ => soft,
        };
        Bar {
            shape: model.shape.clone(),
            nodes: model.mesh.nodes.clone(),
            material: (0..tetrahedra.len()).map(each).collect(),
            tetrahedra,
        }
    }

    fn of(&self, t: usize) -> Option<(&Shape, &Hooke)> {
        Some((&self.shape[t], &self.material[t]))
    }

    fn polynomial(&self) -> Polynomial {
        Polynomial::new(&self.tetrahedra, |t| self.of(t))
    }

    fn each(&self) -> Tetrahedra {
        Tetrahedra::new(Law::StVenantKirchhoff, &self.tetrahedra, |t| self.of(t))
    }

    /// A smooth field and noise, of up to `size` m.
    fn displaced(&self, size: f64) -> Vec<Lane> {
        let mut random = noise(1);
        let smooth = |x: &Vec3| Vec3::new(x.x * x.z, 8.0 * x.x * x.x, -4.0 * x.x * x.y) * 10.0;
        (self.nodes.iter())
            .map(|x| {
                let other = Vec3::new(random(), random(), random());
                Lane::from((smooth(x) + other) * (0.5 * size))
            })
            .collect()
    }
}

fn of_polynomial(own: &Polynomial, u: &[Lane]) -> (Vec<Lane>, f64) {
    let mut out = vec![Lane::default(); u.len()];
    let energy = own.add_forces(u, &mut out);
    (out, energy)
}

fn of_each(own: &Tetrahedra, u: &[Lane]) -> (Vec<Lane>, f64) {
    let mut out = vec![Lane::default(); u.len()];
    let (energy, _) = own.add_forces(u, &mut out);
    (out, energy)
}

fn largest(forces: &[Lane]) -> f64 {
    forces.iter().map(|f| f.xyz().norm()).fold(0.0, f64::max)
}

fn apart(a: &[Lane], b: &[Lane]) -> f64 {
    (a.iter().zip(b))
        .map(|(a, b)| (a.xyz() - b.xyz()).norm())
        .fold(0.0, f64::max)
}

/// What cancels \[N\]: the largest force that a vertex moved alone as far as it is would bear. Round-off is in
/// proportion to that, of the order lambda V |a|² |u| (1 + |a||u|)², and not to what is left.
fn at_stake(own: &Polynomial, u: &[Lane]) -> f64 {
    let mut alone = vec![Lane::default(); u.len()];
    let mut most = 0.0f64;
    for k in (0..u.len()).step_by(5) {
        alone[k] = u[k];
        most = most.max(of_polynomial(own, &alone).0[k].xyz().norm());
        alone[k] = Lane::default();
    }
    most
}

#[test]
fn forces_and_energy_are_those_of_each_tetrahedron() {
    for fibres in [false, true] {
        let bar = Bar::new(fibres);
        let (polynomial, each) = (bar.polynomial(), bar.each());
        // Cells are of 6.7 mm.
        for size in [1e-8, 1e-4, 1e-3, 1e-2, 1e-1] {
            let u = bar.displaced(size);
            let (own, energy) = of_polynomial(&polynomial, &u);
            let (other, truth) = of_each(&each, &u);
            let off = apart(&own, &other) / largest(&other);
            let energy_off = (energy / truth - 1.0).abs();
            println!("fibres {fibres}, {size} m: forces {off:.1e}, energy {energy_off:.1e}");
            assert!(off < 1e-12, "{off:e}");
            assert!(energy_off < 1e-12, "{energy_off:e}");
        }
    }
}

/// The energy is of degree four, for which these differences are exact.
#[test]
fn forces_are_the_derivatives_of_the_energy() {
    let bar = Bar::new(true);
    let polynomial = bar.polynomial();
    let u = bar.displaced(1e-2);
    let (f, _) = of_polynomial(&polynomial, &u);
    let scale = largest(&f);
    for k in (0..u.len()).step_by(17) {
        for axis in 0..3 {
            let at = |h: f64| {
                let mut moved = u.clone();
                moved[k].0[axis] += h;
                of_polynomial(&polynomial, &moved).1
            };
            let h = 1e-3;
            let slope = (8.0 * (at(h) - at(-h)) - at(2.0 * h) + at(-2.0 * h)) / (12.0 * h);
            let off = (slope - f[k].0[axis]).abs();
            assert!(off < 1e-9 * scale, "{k} {axis}: {off:e} of {scale:e}");
        }
    }
}

#[test]
fn rotations_give_no_force_and_momentum_is_balanced() {
    let turn = Rotation3::new(Vec3::new(1.5, -0.7, 2.0));
    for fibres in [false, true] {
        let bar = Bar::new(fibres);
        let polynomial = bar.polynomial();
        let turned: Vec<Lane> = (bar.nodes.iter())
            .map(|x| Lane::from(turn * x - x + Vec3::new(0.03, -0.02, 0.01)))
            .collect();
        let scale = at_stake(&polynomial, &turned);
        let off = largest(&of_polynomial(&polynomial, &turned).0) / scale;
        println!("fibres {fibres}: turned {off:.1e} of {scale:.1e} N");
        assert!(off < 1e-12, "{off:e}");
        // Small strain on the way round.
        let strained: Vec<Lane> = (turned.iter().zip(bar.displaced(1e-4)))
            .map(|(u, other)| Lane::from(u.xyz() + turn * other.xyz()))
            .collect();
        let (own, _) = of_polynomial(&polynomial, &strained);
        let (other, _) = of_each(&bar.each(), &strained);
        let off = apart(&own, &other) / scale;
        println!(
            "strained {off:.1e}, of forces up to {:.1e} N",
            largest(&other)
        );
        assert!(off < 1e-12, "{off:e}");
        for size in [1e-4, 1e-2] {
            let u = bar.displaced(size);
            let (f, _) = of_polynomial(&polynomial, &u);
            let scale = at_stake(&polynomial, &u);
            let (mut sum, mut moment) = (Vec3::zeros(), Vec3::zeros());
            for (k, f) in f.iter().enumerate() {
                sum += f.xyz();
                moment += (bar.nodes[k] + u[k].xyz()).cross(&f.xyz());
            }
            let (sum, moment) = (sum.norm() / scale, moment.norm() / (0.1 * scale));
            println!("fibres {fibres}, {size} m: sum {sum:.1e}, moment {moment:.1e}");
            assert!(sum < 1e-12 && moment < 1e-12, "{sum:e} {moment:e}");
        }
    }
}

/// Of two materials and some thousand tetrahedra that can all be cut.
const TISSUE: &str = r#"{
  "name": "bar", "mesh": {"box": {"size": [0.1, 0.02, 0.02], "cells": [40, 6, 6]}},
  "materials": [
    {"where": {"all": true}, "youngModulus": 200000, "poissonRatio": 0.4, "density": 1000},
    {"where": {"box": {"min": [0, 0, 0], "max": [0.06, 1, 0.01]}}, "youngModulus": 80000, "poissonRatio": 0.45,
     "density": 1000, "fibre": {"direction": [1, 0.3, -0.2], "lambda": 800000, "mu": 80000}}],
  "fixed": [{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}],
  "model": {"elasticity": "stVenantKirchhoff", "form": "polynomial"},
  "cuts": [{"time": 9, "where": {"all": true}}]
}"#;

/// What is left is to the bit what a start with it would be, and to round-off what its tetrahedra are.
fn is_what_is_left(model: &Model, live: &LiveMesh, u: &[Lane]) -> f64 {
    let left = |t: usize| live.alive[t].then(|| (&model.shape[t], &model.material(t).law));
    let Some(Elements::Polynomial(own, _)) = &live.elements else {
        panic!("no polynomial");
    };
    let (forces, energy) = of_polynomial(own, u);
    let fresh = Polynomial::new(&live.tetrahedra, left);
    assert!(of_polynomial(&fresh, u) == (forces.clone(), energy));
    let each = Tetrahedra::new(Law::StVenantKirchhoff, &live.tetrahedra, left);
    let (other, truth) = of_each(&each, u);
    let off = apart(&forces, &other) / largest(&other);
    assert!((energy / truth - 1.0).abs() < 1e-12);
    assert!(off < 1e-12, "{off:e}");
    for (v, f) in forces.iter().enumerate() {
        assert!(live.star_count[v] > 0 || f.0 == [0.0; 4], "{v}");
        let alone = live.internal_force(model, v, u);
        assert!((alone - f.xyz()).norm() < 1e-12 * largest(&other));
    }
    off
}

#[test]
fn cuts_leave_what_a_fresh_start_would_have() {
    let model = common::model(TISSUE);
    let simulation = Simulation::new(model.clone());
    let mut state: State = simulation.save();
    state.reserve(&model);
    let mut random = noise(7);
    for u in &mut state.displacement {
        *u = Lane::from(Vec3::new(random(), random(), random()) * 1e-3);
    }
    let mut scratch = cut::Scratch::new(&model);
    let mut loose = loose::Scratch::new(&model);
    let count = model.shape.len();
    let (mut cuts, mut worst) = (0, 0.0f64);
    while cuts < 1000 {
        let t = ((random() + 1.0) * 0.5 * count as f64) as usize;
        if state.live.alive[t] {
            cut::event(&model, &mut state, &mut scratch, &mut loose, &[t as u32]);
            cuts += 1;
            if cuts % 100 == 0 {
                worst = worst.max(is_what_is_left(&model, &state.live, &state.displacement));
            }
        }
    }
    let removed = state.live.removed.len();
    println!("{removed} of {count} removed, {worst:.1e}");
    assert!(removed >= 1000 && count > removed + 500);
    // All at once is the same.
    let mut again = simulation.save();
    again.displacement.clone_from(&state.displacement);
    let all = state.live.removed.clone();
    cut::event(&model, &mut again, &mut scratch, &mut loose, &all);
    assert!(again.live.elements == state.live.elements);
    // And once nothing is left there is nothing.
    let rest: Vec<u32> = (0..count as u32).collect();
    cut::event(&model, &mut state, &mut scratch, &mut loose, &rest);
    let Some(Elements::Polynomial(own, _)) = &state.live.elements else {
        panic!("no polynomial");
    };
    assert_eq!(
        of_polynomial(own, &state.displacement),
        (vec![Lane::default(); state.displacement.len()], 0.0)
    );
}

const HYBRID: &str =
    r#""kind": "hybrid", "dynamic": {"halfSpace": {"point": [0.03, 0, 0], "normal": [1, 0, 0]}}, "#;

/// Sagging, pressed, cut through; its end falls.
#[test]
fn tissue_moves_as_it_does_tetrahedron_by_tetrahedron() {
    for (scheme, kind) in [
        ("symplecticEuler", ""),
        ("rungeKutta4", ""),
        ("symplecticEuler", HYBRID),
    ] {
        let text = |form: &str| {
            let settings = format!(
                r#"{{"model": {{{kind}"elasticity": "stVenantKirchhoff", "element": "constantStrain", "form": "{form}"}},
                     "cuts": [{{"time": 0.12, "where": {{"box": {{"min": [0.069, 0, 0], "max": [0.078, 1, 1]}}}}}}],"#
            );
            common::bar_with(scheme).replacen('{', &settings, 1)
        };
        let [mut own, mut other] =
            ["polynomial", "perTetrahedron"].map(|form| common::simulation(&text(form)));
        let (mut off, mut most, mut held) = (0.0f64, 0.0f64, 0);
        let (mut energy_off, mut energy) = (0.0f64, 0.0f64);
        for k in 0..200 {
            for s in [&mut own, &mut other] {
                common::script(s, f64::from(k) * 2e-3);
                s.step(1e-3).unwrap();
            }
            let (a, b) = (&own.state().displacement, &other.state().displacement);
            off = off.max(apart(a, b));
            most = most.max(largest(b));
            let (a, b) = (own.energy(), other.energy());
            energy_off = energy_off.max((a.elastic - b.elastic).abs());
            energy = energy.max(b.elastic);
            held += usize::from(own.tool(0).in_contact);
        }
        let pieces = own.pieces();
        println!(
            "{scheme} {kind}: {off:.1e} of {most:.1e} m, {energy_off:.1e} of {energy:.1e} J, {held} steps in contact, {pieces} pieces"
        );
        assert!(off < 1e-9 * most);
        // Of what falls all but a part of (|a| u)^-4 cancels.
        assert!(energy_off < 1e-8 * energy);
        assert!(held > 20 && pieces > 1 && own.substep() == other.substep());
        let bytes = own.serialise(own.state());
        assert!(own.deserialise(&bytes).unwrap() == *own.state());
    }
}

/// Newton's method, which knows tetrahedra, finds where the polynomial is at rest.
#[test]
fn equilibrium_is_kept() {
    let text = TISSUE.replacen('{', r#"{"start": "equilibrium", "#, 1);
    let mut s = common::simulation(&text);
    let before = s.state().displacement.clone();
    for _ in 0..50 {
        s.step(1e-3).unwrap();
    }
    let off = apart(&before, &s.state().displacement);
    println!("{off:.1e} of {:.1e} m", largest(&before));
    assert!(largest(&before) > 1e-3 && off < 1e-9 * largest(&before));
}
