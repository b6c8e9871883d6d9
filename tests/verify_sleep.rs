//! Tissue at rest sleeps: nothing is lost by it, and it wakes to the bit.

mod common;

use tissue::simulation::Simulation;

/// One at a time, of [`common::BAR`].
const CASES: [(&str, &str, &str); 10] = [
    ("stick", "", ""),
    ("friction", "", "probe"),
    (
        "central difference",
        r#""integration": {"scheme": "centralDifference"},"#,
        "",
    ),
    (
        "Runge-Kutta",
        r#""integration": {"scheme": "rungeKutta4"},"#,
        "",
    ),
    (
        "implicit",
        r#""integration": {"scheme": "implicitEuler"},"#,
        "",
    ),
    (
        "hybrid",
        r#""model": {"kind": "hybrid", "dynamic": {"halfSpace": {"point": [0.05, 0, 0], "normal": [1, 0, 0]}}},"#,
        "",
    ),
    (
        "hybrid, friction",
        r#""model": {"kind": "hybrid", "dynamic": {"halfSpace": {"point": [0.05, 0, 0], "normal": [1, 0, 0]}}},"#,
        "probe",
    ),
    ("pre-computed", r#""model": {"kind": "quasiStatic"},"#, ""),
    (
        "neo-Hookean",
        r#""model": {"elasticity": "stableNeoHookean"},"#,
        "",
    ),
    ("springs", r#""model": {"kind": "springMass"},"#, ""),
];

fn scene(more: &str, slides: &str) -> String {
    let bar = match slides {
        "" => common::BAR.to_string(),
        name => common::BAR.replace(
            &format!(r#""name": "{name}","#),
            &format!(r#""name": "{name}", "friction": 0.4,"#),
        ),
    };
    bar.replacen('{', &format!("{{{more}"), 1)
}

/// Presses the probe some millimetres deep in 0.1 s.
fn press(s: &mut Simulation) {
    for k in 0..100 {
        s.set_pose_input(0, 2, 0.0275 - 6e-3 * f64::from(k + 1) / 100.0);
        s.step(1e-3).unwrap();
    }
}

fn pressed(scene: &str) -> Simulation {
    let mut s = common::simulation(scene);
    s.set_pose_input(0, 2, 0.0275);
    s.place_tools().unwrap();
    press(&mut s);
    s
}

/// Steps of 1 ms until it sleeps.
fn sleeps(s: &mut Simulation, most: u32) -> Option<u32> {
    (1..=most).find(|_| {
        s.step(1e-3).unwrap();
        s.state().sleep.asleep
    })
}

/// Keeps tissue that cannot tear awake, and changes nothing else.
fn nudge(s: &mut Simulation) {
    let now = s.parameters().tearing_threshold;
    s.set_tearing_threshold(if now == 1.0 { 2.0 } else { 1.0 });
}

fn bits(s: &Simulation) -> Vec<u64> {
    let state = s.state();
    let each = state.displacement.iter().chain(&state.velocity);
    let mut all: Vec<u64> = each
        .flat_map(|l| [l.0[0], l.0[1], l.0[2]])
        .map(f64::to_bits)
        .collect();
    for tool in &state.tools {
        all.extend(
            tool.force
                .iter()
                .chain(tool.torque.iter())
                .map(|x| x.to_bits()),
        );
    }
    let account = state.account;
    all.extend([account.dissipated, account.tool_work, account.support_work].map(f64::to_bits));
    all.extend([
        state.clock.total,
        state.clock.time().to_bits(),
        state.since_haptic.to_bits(),
    ]);
    all
}

/// Beside a twin that is kept awake: the same force to 1e-9 of it, the same places to 1e-9 of an edge, the same clocks to the bit;
/// and the account goes on as if nothing had happened.
#[test]
fn what_is_pressed_settles_and_sleeps() {
    for (name, more, slides) in CASES {
        let text = scene(more, slides);
        let (mut s, mut awake) = (pressed(&text), pressed(&text));
        let (mut steps, mut before) = (0, s.energy());
        while !s.state().sleep.asleep {
            before = s.energy();
            s.step(1e-3).unwrap();
            steps += 1;
            assert!(steps < 1500, "{name} does not sleep");
        }
        let energy = s.energy();
        let jump = (energy.balance() - before.balance()).abs();
        let size = energy.elastic + energy.tool_work.abs() + energy.gravity.abs();
        let force = s.tool(0).force;
        assert!(force.z > 0.1 && s.tool(0).in_contact, "{name}: {force}");
        assert!(jump <= 1e-12 * size, "{name}: {jump:e} of {size:e} J");
        assert_eq!(energy.kinetic, 0.0, "{name}");
        for _ in 0..300 {
            s.step(1e-3).unwrap();
            assert!(s.state().sleep.asleep);
        }
        assert_eq!(
            (s.tool(0).force, s.tool(0).mean_force),
            (force, force),
            "{name}"
        );
        assert_eq!(s.tool(0).force_rate.norm(), 0.0);
        assert_eq!(s.energy(), energy, "{name}");
        for _ in 0..steps + 300 {
            nudge(&mut awake);
            awake.step(1e-3).unwrap();
        }
        assert!(!awake.state().sleep.asleep);
        let off = (force - awake.tool(0).force).norm() / force.norm();
        let pairs = s
            .state()
            .displacement
            .iter()
            .zip(&awake.state().displacement);
        let way = pairs
            .map(|(a, b)| (a.xyz() - b.xyz()).norm())
            .fold(0.0, f64::max);
        let way = way / s.model().mean_edge;
        println!(
            "{name}: asleep after {steps} ms, force off by {off:.1e}, places by {way:.1e} edges, account by {:.1e}",
            jump / size
        );
        assert!(off < 1e-9 && way < 1e-9, "{name}: {off:e}, {way:e}");
        let clock = |s: &Simulation| (s.state().clock, s.state().since_haptic);
        assert_eq!(clock(&s), clock(&awake), "{name}");
    }
}

type Change = (&'static str, fn(&mut Simulation));

/// Each wakes it.
const CHANGES: [Change; 9] = [
    ("a last digit of a position", |s| {
        let x = s.tool(0).input.value[0];
        s.set_pose_input(0, 0, f64::from_bits(x.to_bits() + 1));
    }),
    ("an orientation", |s| s.set_pose_input(1, 5, -0.7)),
    ("a rate", |s| s.set_pose_rate(2, 1, 1e-3)),
    ("jaws", |s| s.set_active(1, true)),
    ("current", |s| s.set_active(2, true)),
    ("gravity", |s| s.set_gravity(0, 0.1)),
    ("damping", |s| s.set_damping(50.0)),
    ("a threshold", |s| s.set_tearing_threshold(0.3)),
    ("a place", |s| {
        s.set_pose_input(0, 2, 0.0225);
        s.place_tools().unwrap();
    }),
];

/// It goes on as what was restored from bytes of it does, and the same change twice is none.
#[test]
fn every_change_wakes_to_the_bit() {
    let hybrid = r#""model": {"kind": "hybrid", "dynamic": {"halfSpace": {"point": [0.05, 0, 0], "normal": [1, 0, 0]}}},"#;
    for text in [scene("", ""), scene("", "probe"), scene(hybrid, "")] {
        let mut s = pressed(&text);
        assert!(sleeps(&mut s, 1500).is_some());
        let saved = s.save();
        let bytes = s.serialise(&saved);
        assert_eq!(bytes.len(), tissue::snapshot::size(&saved));
        let model = s.model().clone();
        for (what, change) in CHANGES {
            s.restore(&saved);
            s.step(0.05).unwrap();
            assert!(s.state().sleep.asleep, "before {what}");
            let mut twin = Simulation::new(model.clone());
            let restored = twin.deserialise(&bytes).unwrap();
            assert_eq!(restored.sleep, saved.sleep);
            twin.restore(&restored);
            for _ in 0..50 {
                twin.step(1e-3).unwrap();
            }
            assert_eq!(bits(&s), bits(&twin), "before {what}");
            for s in [&mut s, &mut twin] {
                change(s);
                s.step(1e-3).unwrap();
                assert!(!s.state().sleep.asleep, "{what}");
                for _ in 0..20 {
                    s.step(1e-3).unwrap();
                }
            }
            assert_eq!(bits(&s), bits(&twin), "{what}");
        }
        s.restore(&saved);
        let (g, c, x) = (
            s.parameters().gravity[0],
            s.parameters().damping,
            s.tool(0).input.value[0],
        );
        s.set_gravity(0, g);
        s.set_damping(c);
        s.set_pose_input(0, 0, x);
        s.set_pose_rate(0, 0, 0.0);
        s.set_active(1, false);
        s.step(1e-3).unwrap();
        assert!(s.state().sleep.asleep);
    }
}

/// Awake or asleep: pressed, held still until it sleeps, pressed on; a cut on the way.
#[test]
fn splitting_time_changes_no_bit() {
    let cut = r#""cuts": [{"time": 1.2345, "where": {"box": {"min": [0.09, 0, 0], "max": [0.1, 0.02, 0.02]}}}],"#;
    let mut results = Vec::new();
    for length in [1, 7, 25, 700] {
        let mut s = pressed(&scene(cut, ""));
        let mut slept = 0;
        for ms in (0..2100).step_by(length) {
            if s.state().sleep.asleep && ms < 1300 {
                slept += length;
            }
            s.step(length as f64 * 1e-3).unwrap();
        }
        assert!(s.state().live.removed.len() > 10 && (slept > 300 || length == 700));
        for _ in 0..10 {
            s.step(1e-3).unwrap();
        }
        let asleep = s.state().sleep;
        results.push((bits(&s), asleep.asleep, asleep.calm));
    }
    assert!(results.iter().all(|r| *r == results[0]));
}

/// Nothing that moves sleeps: undamped tissue, what creeps, what is still loaded, what is cut off.
#[test]
fn what_moves_does_not_sleep() {
    let undamped = r#""integration": {"damping": 0},"#;
    let mut s = pressed(&scene(undamped, ""));
    assert_eq!(sleeps(&mut s, 3000), None);
    let creeping = r#""integration": {"damping": 20000},"#;
    let mut s = pressed(&scene(creeping, ""));
    let (force, time) = (s.tool(0).force.z, s.time());
    assert_eq!(sleeps(&mut s, 3000), None);
    assert!((s.tool(0).force.z / force - 1.0).abs() > 1e-3 && s.time() > time + 2.9);
    // Its load has grown to nothing worth a motion for most of the time.
    let load = r#""loads": [{"where": {"nodes": [15]}, "force": [0, 0, 1e-30], "ramp": 2.5}],"#;
    let prescribed = r#""prescribed": [{"where": {"nodes": [15]}, "displacement": [0, 0, 1e-30], "ramp": 2.5}],"#;
    for ramp in [load, prescribed] {
        let mut s = pressed(&scene(ramp, ""));
        let steps = sleeps(&mut s, 4000).unwrap();
        assert!((2400..2410).contains(&steps), "{steps}");
    }
    let cut = r#""cuts": [{"time": 0.3, "where": {"box": {"min": [0.05, 0, 0], "max": [0.06, 0.02, 0.02]}}}],"#;
    let mut s = pressed(&scene(cut, ""));
    assert_eq!(sleeps(&mut s, 1500), None);
    // A cautery that is on.
    let mut s = pressed(&scene("", ""));
    s.set_active(2, true);
    assert_eq!(sleeps(&mut s, 1500), None);
    s.set_active(2, false);
    assert!(sleeps(&mut s, 1500).is_some());
}
