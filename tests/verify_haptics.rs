//! The local model that a haptic device has of the tissue: derivatives equal perturb, step, restore through the public
//! interface; static stiffness is that of the settled tissue; slopes are differences.

mod common;

use nalgebra::Matrix3;
use tissue::mesh::Vec3;
use tissue::simulation::Simulation;

/// Components of a pose.
const POSE: usize = 7;

/// A soft block fixed at its bottom, one grasper at its top and one at its side.
fn block(model: &str, integration: &str) -> String {
    format!(
        r#"{{
  "name": "block", "mesh": {{"box": {{"size": [0.06, 0.05, 0.03], "cells": [6, 5, 3]}}}},
  "materials": [{{"where": {{"all": true}}, "youngModulus": 8000, "poissonRatio": 0.4, "density": 1060}}],
  "fixed": [{{"box": {{"min": [0, 0, 0], "max": [1, 1, 0]}}}}],
  "gravity": [0, 0, -2], "model": {model}, "integration": {integration},
  "tools": [
    {{"name": "upper", "kind": "grasper", "shape": {{"capsule": {{"radius": 0.006, "length": 0.1}}}},
     "activeLength": 0.01, "position": [0.031, 0.024, 0.033], "orientation": [1, 0, 0, 0]}},
    {{"name": "lower", "kind": "grasper", "shape": {{"capsule": {{"radius": 0.006, "length": 0.1}}}},
     "activeLength": 0.01, "position": [0.062, 0.026, 0.018], "orientation": [0.7071067811865476, 0, 0.7071067811865476, 0]}},
    {{"name": "probe", "kind": "probe", "shape": {{"sphere": {{"radius": 0.008}}}}, "position": [0.01, 0.01, 0.05]}}],
  "outputs": {{"vertices": "all"}}
}}"#
    )
}

const LINEAR: &str = r#"{"kind": "tensorMass"}"#;
const VENANT: &str = r#"{"elasticity": "stVenantKirchhoff"}"#;
/// Both graspers take hold inside the pre-computed part.
const HYBRID: &str =
    r#"{"kind": "hybrid", "dynamic": {"box": {"min": [0, 0, 0], "max": [0.011, 1, 1]}}}"#;
/// One does.
const MIXED: &str = r#"{"kind": "hybrid", "dynamic": {"halfSpace": {"point": [0.05, 0, 0], "normal": [-1, 0, 0]}}}"#;
/// With the mass of what is pre-computed, and some of its modes.
const GUYAN: &str = r#"{"kind": "hybrid", "interfaceMass": "guyan", "interfaceModes": 20, "dynamic": {"halfSpace": {"point": [0.05, 0, 0], "normal": [-1, 0, 0]}}}"#;

fn scheme(name: &str) -> String {
    format!(r#"{{"scheme": "{name}"}}"#)
}

/// Both graspers close, pull and turn; the probe presses into a corner.
fn drive(s: &mut Simulation, k: u32) {
    let t = f64::from(k) * 1e-3;
    let ramp = |from: f64, to: f64| ((t - from) / (to - from)).clamp(0.0, 1.0);
    s.set_active(0, true);
    s.set_active(1, true);
    s.set_pose_input(0, 0, 0.031 + 0.003 * ramp(0.0, 0.05));
    s.set_pose_input(0, 2, 0.033 + 0.004 * ramp(0.0, 0.05));
    s.set_pose_input(0, 5, 0.2 * ramp(0.01, 0.06));
    s.set_pose_input(1, 1, 0.026 - 0.004 * ramp(0.0, 0.04));
    s.set_pose_input(2, 2, 0.05 - 0.014 * ramp(0.0, 0.03));
}

/// Mid-motion, everything held.
fn driven(text: &str, length: f64) -> Simulation {
    let mut s = common::simulation(text);
    for k in 1..=45 {
        drive(&mut s, k);
        s.step(length).unwrap();
    }
    drive(&mut s, 46);
    assert!(s.tool(0).in_contact && s.tool(1).in_contact);
    s
}

fn felt(s: &Simulation) -> Vec<[f64; 6]> {
    let each = s.state().tools.iter();
    each.map(|t| {
        let (f, m) = (t.force, t.torque);
        [f.x, f.y, f.z, m.x, m.y, m.z]
    })
    .collect()
}

/// The same from outside: (F(x + d) - F(x - d)) / 2d, d as large as the curvature lets it be.
fn perturbed(
    s: &mut Simulation,
    by: usize,
    component: usize,
    length: f64,
    d: f64,
) -> Vec<[f64; 6]> {
    let saved = s.save();
    let start = s.tool(by).input.value[component];
    let mut at = |value: f64| {
        s.set_pose_input(by, component, value);
        s.step(length).unwrap();
        let found = felt(s);
        s.restore(&saved);
        found
    };
    let (above, below) = (at(start + d), at(start - d));
    let tools = above.iter().zip(&below);
    tools
        .map(|(a, b)| std::array::from_fn(|c| (a[c] - b[c]) / (2.0 * d)))
        .collect()
}

/// Largest difference of derivatives by one kind of component relative to the largest of that kind.
fn compare(s: &mut Simulation, length: f64, d: f64, what: &str) {
    let before = s.save();
    let tools = s.state().tools.len();
    let mut worst: f64 = 0.0;
    for by in 0..tools {
        for kind in [0..3, 3..POSE] {
            let (mut off, mut size) = ([0.0f64; 2], [0.0f64; 2]);
            for component in kind {
                // A radian is some edges.
                let d = if component < 3 { d } else { 50.0 * d };
                let outside = perturbed(s, by, component, length, d);
                for of in 0..tools {
                    let inside = s.tangent(of, by, component).unwrap();
                    for c in 0..6 {
                        off[c / 3] = off[c / 3].max((inside[c] - outside[of][c]).abs());
                        size[c / 3] = size[c / 3].max(outside[of][c].abs());
                    }
                }
            }
            for c in 0..2 {
                assert!(
                    off[c] <= 1e-6 * size[c],
                    "{what}: {off:?} of {size:?}, tool {by}"
                );
                if size[c] > 0.0 {
                    worst = worst.max(off[c] / size[c]);
                }
            }
        }
    }
    println!("{what}: {worst:.1e}");
    assert!(*s.state() == before, "{what}: the state has changed");
}

#[test]
fn derivatives_equal_perturb_step_restore() {
    for (model, name) in [
        (LINEAR, "symplecticEuler"),
        (LINEAR, "rungeKutta4"),
        (LINEAR, "implicitEuler"),
        (LINEAR, "centralDifference"),
        (HYBRID, "symplecticEuler"),
        (HYBRID, "implicitEuler"),
        (MIXED, "rungeKutta4"),
        (GUYAN, "symplecticEuler"),
        (r#"{"element": "nodalAveraged"}"#, "symplecticEuler"),
        (VENANT, "symplecticEuler"),
        (VENANT, "rungeKutta4"),
        (
            r#"{"elasticity": "stVenantKirchhoff", "element": "constantStrain"}"#,
            "symplecticEuler",
        ),
        (r#"{"kind": "springMass"}"#, "symplecticEuler"),
    ] {
        for length in [1e-3, 3e-3] {
            let mut s = driven(&block(model, &scheme(name)), length);
            compare(&mut s, length, 2e-6, &format!("{model} {name} {length}"));
        }
    }
}

/// Nodes that a support holds on one axis do not follow the tool on it.
/// Where no place comes or goes, and what rubs goes on rubbing.
#[test]
fn derivatives_of_what_slides() {
    const QUASI_STATIC: &str = r#"{"kind": "quasiStatic"}"#;
    for model in [LINEAR, VENANT, QUASI_STATIC, MIXED] {
        for friction in ["0", "0.3"] {
            let sliding = format!(r#""probe", "friction": {friction}, "shape": {{"sphere""#);
            let text = block(model, "{}").replace(r#""probe", "shape": {"sphere""#, &sliding);
            let mut s = driven(&text, 1e-3);
            assert!(s.tool(2).in_contact);
            let stiffness = s.tangent(2, 2, 2).unwrap()[2];
            assert!(stiffness.abs() > 10.0, "{stiffness}");
            // What has hardly begun to slip has no derivative.
            for k in 1..=6 {
                s.set_pose_input(2, 0, 0.01 + 2e-4 * f64::from(k));
                if k < 6 {
                    s.step(1e-3).unwrap();
                }
            }
            compare(&mut s, 1e-3, 5e-8, &format!("{model} friction {friction}"));
        }
    }
}

#[test]
fn derivatives_of_what_supports_hold_too() {
    let text = block(LINEAR, &scheme("symplecticEuler")).replace(
        r#""fixed": ["#,
        r#""fixed": [{"where": {"box": {"min": [0.029, 0.019, 0.03], "max": [0.041, 0.03, 0.03]}}, "axes": "z"}, "#,
    );
    let mut s = driven(&text, 1e-3);
    compare(&mut s, 1e-3, 2e-6, "supports");
}

/// The device's path may be told by derivatives; the step that is differentiated then has them, too.
#[test]
fn derivatives_with_input_derivatives() {
    let mut s = driven(&block(LINEAR, &scheme("symplecticEuler")), 1e-3);
    let give = |s: &mut Simulation| {
        for (component, rate) in [(0, 0.1), (1, -0.05), (2, 0.02), (5, 1.0)] {
            s.set_pose_rate(0, component, rate);
        }
    };
    give(&mut s);
    let inside: Vec<_> = (0..POSE).map(|c| s.tangent(0, 0, c).unwrap()).collect();
    let saved = s.save();
    for (c, inside) in inside.iter().enumerate() {
        let d = if c < 3 { 2e-6 } else { 1e-4 };
        let outside = perturbed(&mut s, 0, c, 1e-3, d)[0];
        assert!(*s.state() == saved);
        let size = outside.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        for (a, b) in inside.iter().zip(outside) {
            assert!((a - b).abs() <= 1e-6 * size, "{c}: {a} {b}");
        }
    }
}

/// A stiffness that is asked for at every step leaves no bit another, in any scheme.
#[test]
fn asking_leaves_no_trace() {
    let adaptive = r#"{"elasticity": "stVenantKirchhoff", "nonlinearThreshold": 0.001}"#;
    for (model, name) in [
        (LINEAR, "symplecticEuler"),
        (LINEAR, "euler"),
        (LINEAR, "implicitEuler"),
        (HYBRID, "rungeKutta4"),
        (VENANT, "symplecticEuler"),
        (adaptive, "symplecticEuler"),
    ] {
        let integration = match name {
            "euler" => r#"{"scheme": "euler", "damping": 1000}"#.to_string(),
            name => scheme(name),
        };
        let text = block(model, &integration);
        let (mut asked, mut left) = (common::simulation(&text), common::simulation(&text));
        for k in 1..=60 {
            for s in [&mut asked, &mut left] {
                drive(s, k);
                s.set_active(1, k < 50);
            }
            for by in 0..2 {
                for c in 0..POSE {
                    asked.tangent(0, by, c).unwrap();
                }
            }
            asked.static_stiffness(0).unwrap();
            asked.surface_velocity(3);
            asked.step(1e-3).unwrap();
            left.step(1e-3).unwrap();
            assert!(asked.state() == left.state(), "{model} {name} {k}");
        }
        // Whenever it was asked for first, it has the same bits.
        let mut other = common::simulation(&text);
        let bytes = asked.serialise(asked.state());
        let restored = other.deserialise(&bytes).unwrap();
        other.restore(&restored);
        for c in 0..POSE {
            let (a, b) = (asked.tangent(0, 0, c), other.tangent(0, 0, c));
            assert_eq!(a.unwrap().map(f64::to_bits), b.unwrap().map(f64::to_bits));
        }
        assert_eq!(asked.static_stiffness(0), other.static_stiffness(0));
        for j in 0..asked.model().surface_nodes.len() {
            assert_eq!(asked.surface_velocity(j), other.surface_velocity(j));
        }
    }
}

#[test]
fn nothing_held_has_no_stiffness() {
    let mut s = common::simulation(&block(LINEAR, &scheme("symplecticEuler")));
    for step in 0..2 {
        assert_eq!(s.tangent(0, 0, 0).unwrap(), [0.0; 6]);
        assert_eq!(s.tangent(0, 1, 4).unwrap(), [0.0; 6]);
        assert_eq!(s.static_stiffness(2).unwrap(), Matrix3::zeros());
        assert_eq!(s.tool(0).force_rate, Vec3::zeros());
        if step == 0 {
            s.step(1e-3).unwrap();
        }
    }
    // A trial that fails says why, and what is next is right again.
    drive(&mut s, 1);
    s.step(1e-3).unwrap();
    s.set_pose_input(0, 3, 0.0);
    s.set_pose_input(0, 5, 0.0);
    let refused = s.tangent(0, 0, 0).unwrap_err().to_string();
    assert!(refused.contains("orientation is zero"), "{refused}");
    s.set_pose_input(0, 3, 1.0);
    assert!(s.tangent(0, 0, 0).unwrap()[0] < 0.0);
}

/// A substep above the critical one is halved in the trial as in the step.
#[test]
fn trials_are_halved_as_the_step_is() {
    let text = block(LINEAR, &scheme("symplecticEuler"));
    let length = 1.7 * common::simulation(&text).critical_substep();
    for model in [LINEAR, VENANT] {
        let long = format!(r#"{{"substep": {length}, "hapticRate": {}}}"#, 1.0 / length);
        let mut s = common::simulation(&block(model, &long));
        for k in 1..=20 {
            drive(&mut s, k);
            s.step(length).unwrap();
        }
        drive(&mut s, 21);
        assert!(s.halvings() > 0);
        compare(&mut s, length, 2e-6, "halved");
    }
}

/// K_s by waiting for some seconds: the settled force at two places of the tool.
fn waited(s: &mut Simulation, k: usize, d: f64, (steps, length): (u32, f64)) -> Matrix3<f64> {
    let saved = s.save();
    let start = s.tool(k).input.value;
    let mut stiffness = Matrix3::zeros();
    for axis in 0..3 {
        let mut at = |value: f64| {
            s.set_pose_input(k, axis, value);
            for _ in 0..steps {
                s.step(length).unwrap();
            }
            let force = s.tool(k).force;
            s.restore(&saved);
            force
        };
        let (above, below) = (at(start[axis] + d), at(start[axis] - d));
        stiffness.set_column(axis, &((below - above) / (2.0 * d)));
    }
    stiffness
}

#[test]
fn static_stiffness_is_that_of_the_settled_tissue() {
    let implicit = r#"{"scheme": "implicitEuler", "substep": 0.005, "hapticRate": 200}"#;
    let cases = [
        (LINEAR, 1e-6),
        (HYBRID, 1e-6),
        (MIXED, 1e-6),
        (VENANT, 1e-5),
    ];
    for (model, tolerance) in cases {
        let is_linear = model != VENANT;
        let integration = if is_linear { implicit } else { "{}" };
        let length = if is_linear { 5e-3 } else { 1e-3 };
        let mut s = common::simulation(&block(model, integration));
        for k in 1..=45 {
            drive(&mut s, k);
            s.set_pose_input(2, 2, 0.05);
            s.step(length).unwrap();
        }
        if !is_linear {
            // The tangent is that of the state.
            (0..2000).for_each(|_| s.step(length).unwrap());
        }
        for k in 0..2 {
            let found = s.static_stiffness(k).unwrap();
            let wait = if is_linear { (400, 0.05) } else { (100, 0.02) };
            let truth = waited(&mut s, k, 1e-5, wait);
            let off = (found - truth).amax() / truth.amax();
            println!("{model}: {off:.1e}, {:.1} N/m", truth.amax());
            assert!(off < tolerance, "{found} {truth}");
            assert!(found == found.transpose());
            let least = found.symmetric_eigenvalues().min();
            assert!(least > 0.0, "{least}");
            // Quickly met it is stiffer, and the other sign.
            let quick = -Matrix3::from_fn(|j, c| s.tangent(k, k, c).unwrap()[j]);
            let quick = (quick + quick.transpose()) * 0.5;
            assert!(quick.symmetric_eigenvalues().min() > found.symmetric_eigenvalues().min());
        }
    }
}

/// Along a bar of no Poisson's ratio, whose end is grasped all over, it is E A / L.
#[test]
fn static_stiffness_of_a_bar() {
    let text = common::BAR
        .replace("[15, 3, 3]", "[15, 1, 1]")
        .replace("\"poissonRatio\": 0.4", "\"poissonRatio\": 0")
        .replace("\"radius\": 0.004", "\"radius\": 0.05")
        .replace("[0.1, 0.01, 0.01]", "[0.147, 0.01, 0.01]")
        .replacen('{', r#"{"gravity": [0, 0, 0], "model": {"elasticity": "LAW", "element": "constantStrain"},"#, 1);
    for (law, stretch) in [
        ("linear", 0.0),
        ("linear", 0.01),
        ("stVenantKirchhoff", 0.0),
    ] {
        let mut s = common::simulation(&text.replace("LAW", law));
        s.set_active(1, true);
        for k in 0..20 {
            s.set_pose_input(1, 0, 0.147 + stretch * f64::from(k) / 20.0);
            s.step(1e-3).unwrap();
        }
        let held = s.state().held.iter().map(|h| h.node as usize);
        let held: Vec<f64> = held.map(|i| s.model().mesh.nodes[i].x).collect();
        let length = held.iter().copied().fold(0.1, f64::min);
        let layers = ((0.1 - length) / (0.1 / 15.0)).round() as usize + 1;
        assert!(length > 0.08 && held.len() == 4 * layers, "{held:?}");
        let stiffness = s.static_stiffness(1).unwrap();
        let exact = 500_000.0 * 0.02 * 0.02 / length;
        let off = stiffness[(0, 0)] / exact - 1.0;
        println!("{law}: {off:.1e}");
        let tolerance = if law == "linear" { 1e-12 } else { 1e-9 };
        assert!(off.abs() < tolerance, "{stiffness}");
    }
}

/// Two tetrahedra that share a vertex; the one is grasped, the other hangs from it, or is a rod to a fixed vertex that
/// may still turn about its axis.
#[test]
fn hinged_tissue_has_the_stiffness_of_a_rod() {
    let text = r#"{"name": "hinge", "mesh": {"nodes": [[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0.003, 0.003, 0.01],
        [0.02, 0.001, 0], [0.02, 0, 0.005], [0.03, 0, 0.001]], "tetrahedra": [[0, 1, 2, 3], [1, 4, 5, 6]]},
      "materials": [{"where": {"all": true}, "youngModulus": 9000, "poissonRatio": 0.3, "density": 1000}],
      "gravity": [0, 0, 0], FIXED
      "tools": [{"name": "grasper", "kind": "grasper", "shape": {"sphere": {"radius": 0.004}},
        "activeLength": 0.01, "position": [0.002, 0.002, -0.0035]}]}"#;
    for fixed in ["", r#""fixed": [{"nodes": [6]}],"#] {
        let mut s = common::simulation(&text.replace("FIXED", fixed));
        s.set_active(0, true);
        s.step(1e-3).unwrap();
        let held: Vec<u32> = s.state().held.iter().map(|h| h.node).collect();
        assert!(held.len() >= 3, "{held:?}");
        let stiffness = s.static_stiffness(0).unwrap();
        if fixed.is_empty() {
            assert!(stiffness.amax() < 1e-6, "{stiffness}");
            continue;
        }
        let axis = Vec3::new(0.02, 0.0, 0.001).normalize();
        let along = stiffness.trace();
        assert!(along > 0.1, "{stiffness}");
        let off = (stiffness - axis * axis.transpose() * along).amax() / along;
        println!("rod: {along:.2} N/m, {off:.1e}");
        assert!(off < 1e-8, "{stiffness}");
    }
}

/// A piece that nothing but a tool holds follows it: zero, and never an error, however few vertices are held.
#[test]
fn loose_pieces_have_no_static_stiffness() {
    for model in [LINEAR, VENANT, r#"{"kind": "springMass"}"#] {
        for radius in ["0.006", "0.0005"] {
            let loose = block(model, &scheme("symplecticEuler"))
                .replace(
                    r#""fixed": [{"box": {"min": [0, 0, 0], "max": [1, 1, 0]}}],"#,
                    "",
                )
                .replace("[0, 0, -2]", "[0, 0, 0]")
                .replace("[0.031, 0.024, 0.033]", "[0.03, 0.02, 0.0301]")
                .replace("\"radius\": 0.006", &format!("\"radius\": {radius}"));
            let mut s = common::simulation(&loose);
            s.set_active(0, true);
            for k in 0..30 {
                s.set_pose_input(0, 0, 0.03 + 1e-4 * f64::from(k));
                s.step(1e-3).unwrap();
            }
            assert!(s.tool(0).in_contact);
            let stiffness = s.static_stiffness(0).unwrap();
            println!("{model} {radius}: {:.1e} N/m", stiffness.amax());
            assert!(stiffness.amax() < 1e-6, "{stiffness}");
            for c in 0..3 {
                assert!(s.tangent(0, 0, c).unwrap().iter().all(|x| x.is_finite()));
            }
        }
    }
}

/// Of loose tissue frames turn with it: the derivative is that of the turning piece.
#[test]
fn derivatives_of_a_loose_piece() {
    let loose = block(LINEAR, &scheme("symplecticEuler")).replace(
        r#""fixed": [{"box": {"min": [0, 0, 0], "max": [1, 1, 0]}}],"#,
        "",
    );
    let mut s = driven(&loose, 1e-3);
    compare(&mut s, 1e-3, 2e-6, "loose");
}

/// F' is the slope over the last haptic period or step, and 0 where what is held has changed in it.
#[test]
fn slopes_are_differences() {
    let text = block(LINEAR, &scheme("symplecticEuler"));
    for length in [1e-3, 5e-4] {
        let mut s = common::simulation(&text);
        let mut last = Vec3::zeros();
        for k in 1..=40 {
            drive(&mut s, k);
            s.step(length).unwrap();
            let (force, rate) = (s.tool(0).force, s.tool(0).force_rate);
            if k == 1 {
                assert!(
                    rate == Vec3::zeros() && force != rate,
                    "taken hold of just now"
                );
            } else {
                assert!((rate - (force - last) / length).norm() <= 1e-12 * rate.norm());
            }
            last = force;
        }
    }
    // Tools at rest: one long step ends as three of a haptic period do.
    let mut s = driven(&text, 1e-3);
    s.step(1e-3).unwrap();
    let mut fine = common::simulation(&text);
    fine.restore(&s.save());
    s.step(3e-3).unwrap();
    let mut before = (Vec3::zeros(), Vec3::zeros());
    for _ in 0..3 {
        before = (fine.tool(0).force, fine.tool(0).torque);
        fine.step(1e-3).unwrap();
    }
    let (force, torque) = (fine.tool(0).force, fine.tool(0).torque);
    for s in [&s, &fine] {
        let by_hand = (force - before.0) / 1e-3;
        let off = s.tool(0).force_rate - by_hand;
        assert!(off.norm() <= 1e-9 * by_hand.norm(), "{off} {by_hand}");
        let by_hand = (torque - before.1) / 1e-3;
        let off = s.tool(0).torque_rate - by_hand;
        assert!(off.norm() <= 1e-9 * by_hand.norm(), "{off} {by_hand}");
    }
}

/// Velocities of vertices are differences of positions, inside the pre-computed part as well.
#[test]
fn velocities_are_differences() {
    let more = r#""loads": [{"where": {"box": {"min": [0.029, 0.04, 0.02], "max": [0.031, 0.05, 0.03]}}, "force": [0.01, 0, 0.02], "ramp": 0.5}], "model""#;
    for (model, name) in [
        (LINEAR, "symplecticEuler"),
        (HYBRID, "symplecticEuler"),
        (MIXED, "centralDifference"),
        (HYBRID, "rungeKutta4"),
    ] {
        let text = block(model, &scheme(name)).replace("\"model\"", more);
        let mut s = driven(&text, 1e-3);
        let count = s.model().surface_nodes.len();
        let all =
            |s: &mut Simulation| -> Vec<Vec3> { (0..count).map(|j| s.surface_vertex(j)).collect() };
        let (h, saved) = (s.substep(), s.save());
        let before = all(&mut s);
        s.step(h).unwrap();
        let after = all(&mut s);
        let end: Vec<Vec3> = (0..count).map(|j| s.surface_velocity(j)).collect();
        s.restore(&saved);
        let start: Vec<Vec3> = (0..count).map(|j| s.surface_velocity(j)).collect();
        let largest = end.iter().map(|v| v.amax()).fold(0.0, f64::max);
        // Of the substep, or of its ends.
        let (tolerance, weight) = if name == "rungeKutta4" {
            (0.05, 0.5)
        } else {
            (1e-9, 1.0)
        };
        for j in 0..count {
            let slope = (after[j] - before[j]) / h;
            let velocity = end[j] * weight + start[j] * (1.0 - weight);
            assert!(
                (slope - velocity).amax() <= tolerance * largest,
                "{model} {name} {j}: {slope} {velocity}"
            );
        }
    }
}
