//! Loose pieces of tissue keep their momenta and their volume, however they turn; hinges and graspers let them swing.

mod common;

use tissue::mesh::Vec3;
use tissue::simulation::Simulation;

/// `element` may stand for a kind.
fn model_of(element: &str) -> String {
    match element {
        "springMass" => r#"{"kind": "springMass"}"#.to_string(),
        _ => format!(r#"{{"element": "{element}"}}"#),
    }
}

/// A block of 0.06 x 0.02 x 0.02 m whose support is cut off at the start.
fn flight(element: &str, scheme: &str, damping: f64) -> Simulation {
    let model = model_of(element);
    let text = format!(
        r#"{{"name": "flight", "mesh": {{"box": {{"size": [0.08, 0.02, 0.02], "cells": [8, 2, 2]}}}},
  "materials": [{{"where": {{"all": true}}, "youngModulus": 40000, "poissonRatio": 0.45, "density": 1000}}],
  "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}], "gravity": [0, 0, 0],
  "model": {model}, "integration": {{"scheme": "{scheme}", "damping": {damping}}},
  "cuts": [{{"time": 0, "where": {{"box": {{"min": [0, 0, 0], "max": [0.02, 1, 1]}}}}}}]}}"#
    );
    let mut s = common::simulation(&text);
    s.step(1e-3).unwrap();
    assert_eq!((s.pieces(), s.state().live.pieces.rigid_modes), (1, 6));
    s
}

/// Sets a rigid motion; the account starts anew.
fn launch(s: &mut Simulation, velocity: Vec3, spin: Vec3) {
    let (model, mut state) = (s.model().clone(), s.save());
    for i in 0..model.parts.moving {
        if state.live.star_count[i] > 0 {
            let at = state.position(i as u32);
            state.velocity[i] = (velocity + spin.cross(&at)).into();
        }
    }
    state.account = Default::default();
    state.account.start = state.energy(&model).balance();
    s.restore(&state);
}

/// Linear and angular momentum about the origin, and the volume.
fn motion(s: &Simulation) -> (Vec3, Vec3, f64) {
    let (model, state) = (s.model(), s.state());
    let (mut momentum, mut turning, mut volume) = (Vec3::zeros(), Vec3::zeros(), 0.0);
    for i in 0..model.parts.moving {
        let p = state.velocity[i].xyz() * state.live.mass[i];
        momentum += p;
        turning += state.position(i as u32).cross(&p);
    }
    for (t, nodes) in model.mesh.tetrahedra.iter().enumerate() {
        if state.live.alive[t] {
            let u = nodes.map(|v| state.displacement[v as usize].xyz());
            let ratio = model.shape[t].deformation_gradient(&u).determinant();
            volume += model.shape[t].volume * ratio;
        }
    }
    (momentum, turning, volume)
}

/// Ten turns at 20 rad/s, damped or not. Runge-Kutta 4 and explicit Euler keep angular momentum to their
/// own order only.
#[test]
fn a_piece_in_free_flight_keeps_momenta_and_volume_over_ten_turns() {
    for (element, scheme, damping, tolerance) in [
        ("constantStrain", "symplecticEuler", 0.0, 1e-9),
        ("constantStrain", "symplecticEuler", 100.0, 1e-9),
        ("constantStrain", "centralDifference", 0.0, 1e-9),
        ("constantStrain", "centralDifference", 100.0, 1e-9),
        ("constantStrain", "implicitEuler", 0.0, 1e-9),
        ("constantStrain", "implicitEuler", 100.0, 1e-9),
        ("constantStrain", "rungeKutta4", 0.0, 1e-6),
        ("nodalPressure", "symplecticEuler", 0.0, 1e-9),
        ("nodalAveraged", "symplecticEuler", 0.0, 1e-9),
        ("nodalAveraged", "centralDifference", 100.0, 1e-9),
        ("nodalAveraged", "rungeKutta4", 0.0, 1e-6),
        ("constantStrain", "euler", 100.0, 2e-2),
        ("springMass", "symplecticEuler", 0.0, 1e-9),
        ("springMass", "symplecticEuler", 100.0, 1e-9),
    ] {
        let mut s = flight(element, scheme, damping);
        launch(&mut s, Vec3::new(0.1, 0.2, 0.3), Vec3::new(3.0, 19.0, -5.0));
        let (p, l, v) = motion(&s);
        let kinetic = s.energy().kinetic;
        let mut swollen = 0.0f64;
        for k in 0..3142 {
            s.step(1e-3).unwrap();
            if k % 50 == 0 {
                swollen = swollen.max((motion(&s).2 / v - 1.0).abs());
            }
        }
        assert_eq!(s.halvings(), 0);
        let (p_now, l_now, _) = motion(&s);
        let off = [(p_now - p).norm() / p.norm(), (l_now - l).norm() / l.norm()];
        let energy = (s.energy().balance() - s.state().account.start) / kinetic;
        println!(
            "{element} {scheme} {damping}: {off:?}, volume {swollen:.1e}, energy {energy:.1e}"
        );
        assert!(off[0] < 1e-9 && off[1] < tolerance, "{scheme}: {off:?}");
        // Springs are softer across.
        let limit = if element == "springMass" { 5e-3 } else { 1e-3 };
        assert!(swollen < limit, "{scheme}: {swollen:e}");
        assert!(energy.abs() < 1e-2, "{scheme}: {energy:e}");
    }
}

/// A loose piece falls as a stone does: damping does not brake it.
#[test]
fn a_loose_piece_falls_freely() {
    let mut s = flight("constantStrain", "symplecticEuler", 100.0);
    launch(&mut s, Vec3::zeros(), Vec3::zeros());
    s.set_gravity(2, -10.0);
    let middle = |s: &Simulation| {
        let (model, state) = (s.model(), s.state());
        let weighted = |i: usize| state.position(i as u32) * state.live.mass[i];
        let all = 0..model.parts.moving;
        let mass: f64 = state.live.mass[all.clone()].iter().sum();
        all.map(weighted).sum::<Vec3>() / mass
    };
    let from = middle(&s);
    for _ in 0..500 {
        s.step(1e-3).unwrap();
    }
    // Symplectic Euler is half a substep ahead.
    let fallen = (middle(&s) - from).z;
    let exact = -0.5 * 10.0 * 0.5 * (0.5 + s.substep());
    assert!(
        (fallen - exact).abs() < 1e-3 * exact.abs(),
        "{fallen} {exact}"
    );
}

/// A bar that keeps two fixed nodes swings about the line through them like a rigid pendulum, by half a turn,
/// without swelling.
#[test]
fn a_hinged_piece_swings_without_swelling() {
    for scheme in ["symplecticEuler", "implicitEuler", "rungeKutta4"] {
        let text = format!(
            r#"{{"name": "hinge", "mesh": {{"box": {{"size": [0.06, 0.01, 0.01], "cells": [6, 1, 1]}}}},
  "materials": [{{"where": {{"all": true}}, "youngModulus": 200000, "poissonRatio": 0.4, "density": 1000}}],
  "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 0]}}}}], "gravity": [0, 0, -10],
  "integration": {{"scheme": "{scheme}", "damping": 50}}}}"#
        );
        let mut s = common::simulation(&text);
        assert_eq!(s.model().rigid_modes, 1);
        let (_, _, volume) = motion(&s);
        let (mut deepest, mut swollen, mut highest) = (0.0f64, 0.0f64, -1.0f64);
        let model = s.model().clone();
        let tip = (0..model.parts.moving)
            .max_by(|a, b| model.mesh.nodes[*a].x.total_cmp(&model.mesh.nodes[*b].x))
            .unwrap() as u32;
        for _ in 0..400 {
            s.step(1e-3).unwrap();
            let at = s.state().position(tip);
            deepest = deepest.min(at.z);
            if at.x < -0.03 {
                highest = highest.max(at.z);
            }
            swollen = swollen.max((motion(&s).2 / volume - 1.0).abs());
        }
        println!(
            "{scheme}: down to {deepest:.4} m, up to {highest:.4} m beyond, volume {swollen:.1e}"
        );
        assert!(deepest < -0.058 && deepest > -0.065, "{scheme}: {deepest}");
        assert!(highest > -0.02, "{scheme}: {highest}");
        assert!(swollen < 1e-2, "{scheme}: {swollen:e}");
    }
}

/// What a grasper holds and a cut sets free hangs in its jaws: the force is the weight.
#[test]
fn a_piece_that_is_cut_off_hangs_in_the_grasper() {
    for element in ["constantStrain", "nodalAveraged", "springMass"] {
        let model = model_of(element);
        for scheme in ["symplecticEuler", "implicitEuler"] {
            if element != "constantStrain" && scheme == "implicitEuler" {
                continue;
            }
            let settings = format!(
                r#""model": {model}, "integration": {{"scheme": "{scheme}", "damping": 60}},
                   "cuts": [{{"time": 0.1, "where": {{"box": {{"min": [0.04, 0, 0], "max": [0.06, 1, 1]}}}}}}], "tools""#
            );
            let mut s = common::simulation(&common::BAR.replace("\"tools\"", &settings));
            s.set_active(1, true);
            // It swings: the mean of a second.
            let mut force = Vec3::zeros();
            for k in 0..3000 {
                s.step(1e-3).unwrap();
                if k >= 2000 {
                    force += s.tool(1).force * 1e-3;
                }
            }
            assert_eq!(s.pieces(), 2);
            let state = s.state();
            let weight: f64 = state
                .live
                .pieces
                .loose_nodes()
                .iter()
                .map(|i| 9.81 * state.live.weight[*i as usize])
                .sum();
            println!("{element} {scheme}: {force:?} of {weight}");
            assert!(
                weight > 0.1 && (force + Vec3::z() * weight).norm() < 0.02 * weight,
                "{force} {weight}"
            );
        }
    }
}

/// A grasper takes a free axis of nodes that supports hold on the others: each leads along its own axes.
#[test]
fn a_grasper_beside_supports_that_hold_some_axes() {
    for supports in [
        r#""prescribed": [{"where": {"box": {"min": [0.04, 0, 0], "max": [0.08, 1, 0]}}, "displacement": [null, 0.001, 0.002], "ramp": 0.05}]"#,
        r#""fixed": [{"where": {"box": {"min": [0.04, 0, 0], "max": [0.08, 1, 0]}}, "axes": "yz"}]"#,
    ] {
        // What Runge-Kutta's own damping takes from the fastest modes at the release is in no account.
        for (scheme, bound) in [
            ("symplecticEuler", 1e-3),
            ("implicitEuler", 1e-9),
            ("rungeKutta4", 0.05),
        ] {
            let text = format!(
                r#"{{"name": "rail", "mesh": {{"box": {{"size": [0.08, 0.02, 0.02], "cells": [8, 2, 2]}}}},
  "materials": [{{"where": {{"all": true}}, "youngModulus": 100000, "poissonRatio": 0.4, "density": 1000}}],
  {supports}, "gravity": [1, 0, -5], "integration": {{"scheme": "{scheme}", "damping": 30}},
  "tools": [{{"name": "grasper", "kind": "grasper", "shape": {{"sphere": {{"radius": 0.012}}}}, "position": [0.08, 0.01, 0]}}]}}"#
            );
            let mut s = common::simulation(&text);
            assert!(s.model().rigid_modes > 0);
            let mut scale = 0.0f64;
            for k in 0..300 {
                s.set_active(0, (100..250).contains(&k));
                s.set_pose_input(0, 0, 0.08 + 1e-4 * f64::from(k - 100).clamp(0.0, 50.0));
                s.set_pose_input(0, 2, -1e-4 * f64::from(k - 100).clamp(0.0, 20.0));
                s.step(1e-3).unwrap();
                let energy = s.energy();
                scale = scale.max(energy.elastic + energy.kinetic);
                let off = (energy.balance() - s.state().account.start).abs();
                assert!(off < bound * scale, "{scheme} {k}: {off:e} of {scale:e}");
            }
            let (model, state) = (s.model(), s.state());
            for v in &model.boundary.supported {
                let u = state.displacement[*v as usize];
                let fixed = model.boundary.fixed[*v as usize];
                assert!((0..3).all(|a| !fixed[a] || u.0[a] == 0.0), "{scheme}");
            }
        }
    }
}
