//! What the local model of the force costs beside a step, on the demo's liver with its grasper closed.
//!
//! `cargo bench -p tissue --bench haptics`. Microseconds, median of many; nothing here fails on time.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use tissue::model::Model;
use tissue::simulation::Simulation;

const LIVER: &str = include_str!("../../examples/hepatectomy.json");
const HYBRID: &str = include_str!("../../examples/hybrid_liver.json");

fn main() {
    let with = |model: &str| {
        let head = format!("{{ \"gravity\": [0, 0, 0], \"model\": {model},");
        LIVER
            .replacen('{', &head, 1)
            .replace("\"start\": \"equilibrium\",", "")
            .replace("\"radius\": 0.004", "\"radius\": 0.012")
    };
    let scheme = r#"{"integration": {"scheme": "implicitEuler"},"#;
    for (name, text) in [
        ("liver, linear", LIVER.to_string()),
        (
            "liver, linear, implicitEuler",
            LIVER.replacen('{', scheme, 1),
        ),
        ("liver, hybrid", HYBRID.to_string()),
        (
            "liver, stableNeoHookean",
            with(r#"{"elasticity": "stableNeoHookean"}"#),
        ),
        ("liver, springMass", with(r#"{"kind": "springMass"}"#)),
    ] {
        run(name, &text);
    }
}

fn run(name: &str, text: &str) {
    let scene = tissue::scene::parse(text, "bench.json").expect("a scene of this file");
    let model: Model =
        tissue::prepared::prepare(scene, Path::new("bench.json")).expect("a scene of this file");
    let mut s = Simulation::new(Arc::new(model));
    // Where the demo closes it.
    let start = [0.124, -0.018, -0.004];
    (0..3).for_each(|axis| s.set_pose_input(0, axis, start[axis]));
    s.place_tools().expect("a good orientation");
    s.set_active(0, true);
    let (mut step, mut first, mut next, mut turned, mut settled) =
        (vec![], vec![], vec![], vec![], vec![]);
    for k in 0..200u32 {
        let place = start[2] + 2e-4 * f64::from(k.min(50));
        s.set_pose_input(0, 2, place);
        step.push(time(|| s.step(1e-3).expect("a stable step")));
        let three = |s: &mut Simulation| {
            (0..3).for_each(|c| {
                black_box(s.tangent(0, 0, c).expect("a stable step"));
            });
        };
        next.push(time(|| three(&mut s)));
        turned.push(time(|| {
            (3..7).for_each(|c| {
                black_box(s.tangent(0, 0, c).expect("a stable step"));
            });
        }));
        if k % 20 == 0 {
            // All that is known is forgotten.
            let saved = s.save();
            s.restore(&saved);
            first.push(time(|| three(&mut s)));
            settled.push(time(|| {
                black_box(s.static_stiffness(0).expect("stable tissue"));
            }));
        }
    }
    assert!(s.tool(0).in_contact);
    let vertices = s.state().held.iter().filter(|h| h.tool.is_some()).count();
    let mean = |mut all: Vec<f64>| {
        all.sort_by(f64::total_cmp);
        1e6 * all[all.len() / 2]
    };
    println!(
        "{name}: {vertices} vertices held; step {:.1} us, stiffness when first asked {:.1}, at later steps {:.1}, by orientation {:.1}, static stiffness {:.0}",
        mean(step),
        mean(first),
        mean(next),
        mean(turned),
        mean(settled)
    );
}

fn time(run: impl FnOnce()) -> f64 {
    let start = Instant::now();
    run();
    start.elapsed().as_secs_f64()
}
