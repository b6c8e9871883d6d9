//! Equilibria with exact answers.

mod common;

use tissue::mesh::Vec3;
use tissue::reference::{Reference, ReferenceError, solve};

const E: f64 = 6000.0;
const NU: f64 = 0.45;

fn reference(text: &str) -> Reference {
    solve(&common::model(text), false).unwrap()
}

fn reaction(r: &Reference, holds: impl Fn(&[f64; 3]) -> bool) -> Vec3 {
    (r.reaction
        .iter()
        .filter(|(n, _)| holds(&r.nodes[**n as usize])))
    .map(|(_, f)| Vec3::from(*f))
    .sum()
}

/// A linear field prescribed on the boundary of an irregular mesh is met inside to round-off.
#[test]
fn patch_test_on_the_liver() {
    let base = r#"{"name": "patch", "mesh": {"liver": {"edgeLength": 0.03}}, "gravity": [0, 0, 0],
        "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}]"#;
    let model = common::model(&format!("{base}}}"));
    let field = |p: &Vec3| {
        Vec3::new(
            0.01 * p.x - 0.02 * p.y + 0.03 * p.z,
            0.02 * p.x + 0.01 * p.z,
            0.03 * p.y - 0.02 * p.z,
        )
    };
    let surface: std::collections::BTreeSet<u32> = (model.whole.surface.iter())
        .flat_map(|f| model.topology.faces[*f as usize].vertices)
        .collect();
    let moved: Vec<String> = (surface.iter())
        .map(|v| {
            let u = field(&model.mesh.nodes[*v as usize]);
            format!(
                r#"{{"where": {{"nodes": [{}]}}, "displacement": [{:e}, {:e}, {:e}]}}"#,
                model.scene_node[*v as usize], u.x, u.y, u.z
            )
        })
        .collect();
    let r = reference(&format!("{base}, \"prescribed\": [{}]}}", moved.join(",")));
    assert!(r.nodes.len() > surface.len() + 20);
    for (p, u) in r.nodes.iter().zip(&r.displacement) {
        let exact = field(&Vec3::from(*p));
        assert!((Vec3::from(*u) - exact).norm() < 1e-10 * exact.norm().max(1e-3));
    }
}

/// Stretch along x with free sides: sigma = E eps, lateral strain -nu eps; with held sides lambda + 2 mu.
#[test]
fn stretched_and_confined_block() {
    let lame = tissue::law::linear::Hooke::new(E, NU);
    let free = r#""fixed": [{"where": {"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}, "axes": "x"},
        {"where": {"box": {"min": [0, 0, 0], "max": [1, 0, 1]}}, "axes": "y"},
        {"where": {"box": {"min": [0, 0, 0], "max": [1, 1, 0]}}, "axes": "z"}]"#;
    let confined = r#""fixed": [{"where": {"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}, "axes": "x"},
        {"where": {"all": true}, "axes": "yz"}]"#;
    for (sides, modulus, lateral) in [(free, E, -NU), (confined, lame.lambda + 2.0 * lame.mu, 0.0)]
    {
        for pattern in ["five", "kuhn"] {
            let r = reference(&format!(
                r#"{{"name": "block", "mesh": {{"box": {{"size": [0.05, 0.02, 0.03], "cells": [5, 2, 3], "pattern": "{pattern}"}}}},
                "materials": [{{"where": {{"all": true}}, "youngModulus": {E}, "poissonRatio": {NU}, "density": 1060}}],
                "gravity": [0, 0, 0], {sides},
                "prescribed": [{{"where": {{"box": {{"min": [0.05, 0, 0], "max": [0.05, 1, 1]}}}}, "displacement": [0.0005, null, null]}}]}}"#
            ));
            let strain = 0.01;
            let force = reaction(&r, |p| p[0] > 0.0499).x;
            let exact = modulus * strain * 0.02 * 0.03;
            assert!(
                (force - exact).abs() < 1e-10 * exact,
                "{pattern}: {force} {exact}"
            );
            for (p, u) in r.nodes.iter().zip(&r.displacement) {
                assert!((u[1] - lateral * strain * p[1]).abs() < 1e-12);
            }
        }
    }
}

/// Stretch along x with free sides and fibres askew: sigma = eps / (C^-1)_xx. The uniform stress shears
/// the block, so its ends are held along x only.
#[test]
fn stretched_block_with_fibres() {
    for direction in [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 2.0, -0.5]] {
        let r = reference(&format!(
            r#"{{"name": "block", "mesh": {{"box": {{"size": [0.05, 0.02, 0.03], "cells": [5, 2, 3]}}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": {E}, "poissonRatio": 0.3, "density": 1060,
              "fibre": {{"direction": {direction:?}, "lambda": 9000, "mu": 8000}}}}],
            "gravity": [0, 0, 0],
            "fixed": [{{"where": {{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}, "axes": "x"}},
              {{"where": {{"nodes": [0]}}, "axes": "yz"}}, {{"where": {{"nodes": [12]}}, "axes": "z"}}],
            "prescribed": [{{"where": {{"box": {{"min": [0.05, 0, 0], "max": [0.05, 1, 1]}}}}, "displacement": [0.0005, null, null]}}]}}"#
        ));
        let law =
            tissue::law::linear::Hooke::new(E, 0.3).with_fibre(direction.into(), 9000.0, 8000.0);
        let modulus = 1.0 / law.mandel().try_inverse().unwrap()[(0, 0)];
        let force = reaction(&r, |p| p[0] > 0.0499).x;
        let exact = modulus * 0.01 * 0.02 * 0.03;
        assert!(
            (force - exact).abs() < 1e-9 * exact,
            "{direction:?}: {force} {exact}"
        );
    }
}

/// A confined column under its own weight: u = -rho g (H z - z^2/2) / (lambda + 2 mu).
#[test]
fn confined_column_under_its_weight() {
    let lame = tissue::law::linear::Hooke::new(E, NU);
    let r = reference(&format!(
        r#"{{"name": "column", "mesh": {{"box": {{"size": [0.02, 0.02, 0.1], "cells": [2, 2, 10], "pattern": "kuhn"}}}},
        "materials": [{{"where": {{"all": true}}, "youngModulus": {E}, "poissonRatio": {NU}, "density": 1060}}],
        "fixed": [{{"where": {{"all": true}}, "axes": "xy"}}, {{"where": {{"box": {{"min": [0, 0, 0], "max": [1, 1, 0]}}}}, "axes": "z"}}]}}"#
    ));
    for z in 1..=10 {
        let z = f64::from(z) * 0.01;
        let exact = -1060.0 * 9.81 * (0.1 * z - 0.5 * z * z) / (lame.lambda + 2.0 * lame.mu);
        let level: Vec<f64> = (r.nodes.iter().zip(&r.displacement))
            .filter(|(p, _)| (p[2] - z).abs() < 1e-9)
            .map(|(_, u)| u[2])
            .collect();
        // Nodes of a level carry uneven shares of the weight and so differ a little.
        let mean = level.iter().sum::<f64>() / level.len() as f64;
        assert!(
            (mean - exact).abs() < 0.02 * exact.abs(),
            "{z}: {mean} {exact}"
        );
    }
    let weight = reaction(&r, |_| true).z;
    assert!((weight - 1060.0 * 9.81 * 0.02 * 0.02 * 0.1).abs() < 1e-10 * weight);
}

/// Two stiffnesses in series: the same stress, strains in inverse proportion.
#[test]
fn stiff_and_soft_in_series() {
    let r = reference(
        r#"{"name": "series", "mesh": {"box": {"size": [0.04, 0.01, 0.01], "cells": [8, 2, 2]}},
        "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0, "density": 1},
          {"where": {"halfSpace": {"point": [0.02, 0, 0], "normal": [1, 0, 0]}}, "youngModulus": 18000, "poissonRatio": 0, "density": 1}],
        "gravity": [0, 0, 0], "fixed": [{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}],
        "prescribed": [{"where": {"box": {"min": [0.04, 0, 0], "max": [0.04, 1, 1]}}, "displacement": [0.0004, 0, 0]}]}"#,
    );
    let force = reaction(&r, |p| p[0] > 0.0399).x;
    // 0.0004 = s (0.02/6000 + 0.02/18000)
    let stress = 0.0004 / (0.02 / 6000.0 + 0.02 / 18000.0);
    assert!((force - stress * 1e-4).abs() < 1e-10 * force);
}

/// Timoshenko's cantilever P L^3/(3 E I) + P L/(kappa G A): approached from below as h^2.
#[test]
fn cantilever_converges() {
    let tip = |n: usize| {
        let (cells, end) = ([10 * n, n, n], 1e-3 / ((n + 1) * (n + 1)) as f64);
        let r = reference(&format!(
            r#"{{"name": "beam", "mesh": {{"box": {{"size": [0.1, 0.01, 0.01], "cells": {cells:?}, "pattern": "kuhn"}}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": 50000, "poissonRatio": 0, "density": 1}}],
            "gravity": [0, 0, 0], "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}],
            "loads": [{{"where": {{"box": {{"min": [0.1, 0, 0], "max": [0.1, 1, 1]}}}}, "force": [0, 0, {end}]}}]}}"#
        ));
        let end: Vec<f64> = (r.nodes.iter().zip(&r.displacement))
            .filter(|(p, _)| p[0] > 0.0999)
            .map(|(_, u)| u[2])
            .collect();
        end.iter().sum::<f64>() / end.len() as f64
    };
    let inertia = 0.01f64.powi(4) / 12.0;
    let exact = 1e-3 * 1e-3 / (3.0 * 50000.0 * inertia) + 1e-3 * 0.1 / (5.0 / 6.0 * 25000.0 * 1e-4);
    let errors = [2, 4, 8].map(|n| 1.0 - tip(n) / exact);
    assert!(
        errors.iter().all(|e| *e > 0.0) && errors[2] < 0.045,
        "{errors:?}"
    );
    // 2.7 on the coarsest pair, where two cells lie across the beam; 3.5 on the next; 4 in the limit.
    assert!(
        errors[0] / errors[1] > 2.5 && errors[1] / errors[2] > 3.3,
        "{errors:?}"
    );
}

/// 6 less what the held axes take: floor on z 3, rollers on three faces 0, a hinged edge 1, a node 3.
#[test]
fn rigid_motions_are_counted_by_rank() {
    let floor = r#"{"where": {"box": {"min": [0, 0, 0], "max": [1, 1, 0]}}, "axes": "z"}"#;
    let sides = r#"{"where": {"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}, "axes": "x"},
        {"where": {"box": {"min": [0, 0, 0], "max": [1, 0, 1]}}, "axes": "y"}"#;
    for (fixed, modes) in [
        (String::new(), 6),
        (floor.to_string(), 3),
        (format!("{floor}, {sides}"), 0),
        (
            r#"{"box": {"min": [0, 0, 0], "max": [1, 0, 0]}}"#.to_string(),
            1,
        ),
        (r#"{"nodes": [0]}"#.to_string(), 3),
    ] {
        for (cells, young) in [([4, 4, 2], 6000), ([7, 5, 3], 7000)] {
            let model = common::model(&format!(
                r#"{{"name": "b", "mesh": {{"box": {{"size": [0.05, 0.04, 0.03], "cells": {cells:?}}}}},
                "materials": [{{"where": {{"all": true}}, "youngModulus": {young}, "poissonRatio": 0.3, "density": 1000}}],
                "fixed": [{fixed}]}}"#
            ));
            assert_eq!(model.rigid_modes, modes, "{fixed}");
            assert_eq!(solve(&model, false).is_ok(), modes == 0, "{fixed}");
        }
    }
}

/// The iteration that serves large meshes finds what the factor finds.
#[test]
fn lowest_frequency_without_a_factor() {
    for text in [common::BAR, include_str!("../examples/hepatectomy.json")] {
        let model = common::model(text);
        let whole = &model.whole;
        let found = tissue::model::spectrum::lowest_held(
            model.stiffness(&whole.tensors),
            &whole.mass,
            &model.boundary.free,
        );
        let exact = model.spectrum.lowest;
        assert!((found - exact).abs() < 1e-3 * exact, "{found} {exact}");
    }
}

#[test]
fn what_is_not_held_or_inverted_has_no_equilibrium() {
    let loose = common::BAR
        .replace("\"fixed\"", "\"gravity\": [0, 0, -1], \"fixed\"")
        .replace(
            r#""fixed": [{"box": {"min": [0, 0, 0], "max": [0, 1, 1]}}],"#,
            "",
        );
    let error = solve(&common::model(&loose), false).unwrap_err();
    assert!(matches!(error, ReferenceError::Statics(..)), "{error}");
    assert!(error.to_string().starts_with(
        "scene.json: the stiffness matrix is not positive definite: some tissue is not held"
    ));
    let limp = common::BAR.replace("500000", "300");
    let error = solve(&common::model(&limp), false).unwrap_err();
    assert!(matches!(error, ReferenceError::Inverted(..)), "{error}");
}

/// `start: equilibrium` is that of the gravity and the ramps' ends that the host starts with.
#[test]
fn a_start_in_equilibrium_stays_there() {
    let text = common::BAR.replace(
        "\"tools\"",
        r#""start": "equilibrium",
        "prescribed": [{"where": {"box": {"min": [0.1, 0, 0], "max": [0.1, 1, 0]}}, "displacement": [null, null, 0.002], "ramp": 0.5}],
        "loads": [{"where": {"nodes": [40]}, "force": [0, 0.01, 0], "ramp": 0.3}], "tools""#,
    );
    let mut s = common::simulation(&text);
    s.set_gravity(2, -3.0);
    assert!(s.rebuild().unwrap());
    let start = s.state().displacement.clone();
    let before = s.energy();
    for _ in 0..100 {
        s.step(1e-3).unwrap();
    }
    let moved =
        (start.iter().zip(&s.state().displacement)).map(|(a, b)| (a.xyz() - b.xyz()).norm());
    assert!(moved.fold(0.0, f64::max) < 1e-12);
    assert!(before.elastic > 0.0 && s.energy().kinetic < 1e-20);
}
