//! The energy account closes through contact, grasp, cut and release.

mod common;

use tissue::energy::Energy;

fn largest(e: &Energy) -> f64 {
    [
        e.elastic,
        e.kinetic,
        e.gravity,
        e.load,
        e.tool_work,
        e.support_work,
        e.dissipated,
    ]
    .iter()
    .fold(0.0, |m, x| m.max(x.abs()))
}

#[test]
fn balance_closes_to_round_off_through_press_grasp_cut_and_drop() {
    for element in ["constantStrain", "nodalPressure", "nodalAveraged"] {
        for scheme in ["symplecticEuler", "centralDifference"] {
            press_grasp_cut_and_drop(element, scheme, 1e-11);
        }
    }
    // But for the last substep, which is longer where vertices share more.
    press_grasp_cut_and_drop("constantStrain", "rungeKutta4", 1e-3);
    press_grasp_cut_and_drop("nodalAveraged", "rungeKutta4", 2e-3);
    // Up to the residual of its equations.
    press_grasp_cut_and_drop("constantStrain", "implicitEuler", 1e-9);
}

fn press_grasp_cut_and_drop(element: &str, scheme: &str, tolerance: f64) {
    let integration = format!(
        r#""model": {{"element": "{element}"}}, "integration": {{"scheme": "{scheme}"}}, "tools""#
    );
    let mut s = common::simulation(&common::BAR.replace("\"tools\"", &integration));
    let (mut scale, mut touched, mut grasped) = (0.0f64, 0, 0);
    for k in 0..1200 {
        common::script(&mut s, f64::from(k) * 1e-3);
        s.step(1e-3).unwrap();
        let energy = s.energy();
        scale = scale.max(largest(&energy));
        let residual = energy.balance() - s.state().account.start;
        // The law is linear until a piece turns in its own frame.
        let is_linear = s.state().live.pieces.loose_nodes().is_empty();
        let tolerance = if is_linear {
            tolerance
        } else {
            tolerance.max(1e-5)
        };
        assert!(
            residual.abs() < tolerance * scale,
            "{element} {scheme}: {residual:e} J of {scale:e} J at step {k}"
        );
        touched += u32::from(s.tool(0).in_contact);
        grasped += u32::from(s.tool(1).in_contact);
    }
    assert!(touched > 50 && grasped > 300, "{touched} {grasped}");
    assert!(s.state().live.removed.len() > 10 && s.pieces() >= 2);
}

#[test]
fn balance_closes_with_loads_prescribed_nodes_uniform_mass_and_uneven_steps() {
    for (mass, kept, scheme) in [
        ("lumped", "removed", "symplecticEuler"),
        ("uniform", "removed", "symplecticEuler"),
        ("lumped", "kept", "symplecticEuler"),
        ("lumped", "removed", "centralDifference"),
        ("lumped", "removed", "implicitEuler"),
        ("uniform", "kept", "implicitEuler"),
    ] {
        let text = common::BAR.replace(
            "\"tools\"",
            &format!(
                r#""prescribed": [{{"where": {{"box": {{"min": [0.1, 0, 0], "max": [0.1, 1, 0]}}}},
                "displacement": [null, null, 0.002], "ramp": 0.1}}],
                "loads": [{{"where": {{"box": {{"min": [0.1, 0, 0.02], "max": [0.1, 1, 0.02]}}}},
                "force": [0, 0.001, 0.002], "ramp": 0.15}}],
                "cuts": [{{"time": 0.1, "where": {{"box": {{"min": [0.03, 0, 0.015], "max": [0.035, 1, 1]}}}}}}],
                "integration": {{"mass": "{mass}", "damping": 4, "scheme": "{scheme}"}}, "cutting": {{"mass": "{kept}"}}, "tools""#
            ),
        );
        let mut s = common::simulation(&text);
        let mut scale = 0.0f64;
        for k in 0..300 {
            s.step([1e-3, 0.7e-3, 1.9e-3, 2e-5][k % 4]).unwrap();
            if k == 150 {
                s.set_gravity(2, -3.0);
                s.set_damping(9.0);
            }
            let energy = s.energy();
            scale = scale.max(largest(&energy));
            let residual = energy.balance() - s.state().account.start;
            assert!(
                residual.abs() < 1e-11 * scale
                    || scheme == "implicitEuler" && residual.abs() < 1e-9 * scale,
                "{scheme}: {residual:e} J of {scale:e} J at step {k}"
            );
        }
        assert!(s.state().live.removed.len() > 2 && s.energy().support_work != 0.0);
    }
}

/// The tool's work is what its force does along its path.
#[test]
fn tool_work_is_force_times_path() {
    let mut s = common::simulation(common::BAR);
    let (mut work, mut before) = (0.0, 0.0);
    for k in 0..900 {
        common::script(&mut s, f64::from(k) * 1e-3);
        let path: Vec<_> = (0..3).map(|t| s.tool(t).pose.position).collect();
        s.step(1e-3).unwrap();
        for (t, from) in path.iter().enumerate() {
            work -= s.tool(t).mean_force.dot(&(s.tool(t).pose.position - from));
        }
        let energy = s.energy();
        before = energy.tool_work;
    }
    assert!(
        (work - before).abs() < 0.02 * before.abs(),
        "{work} {before}"
    );
}
