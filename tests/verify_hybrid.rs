//! A hybrid's statics are the monolithic ones, and its energy account closes.

mod common;

use tissue::mesh::Vec3;
use tissue::simulation::Simulation;

/// [`common::BAR`] with another model.
fn bar(model: &str) -> String {
    let text = common::BAR.replacen('{', &format!("{{ \"model\": {model},"), 1);
    assert_ne!(text, common::BAR);
    text
}

const SPLITS: [&str; 4] = [
    r#"{"kind": "hybrid", "dynamic": {"halfSpace": {"point": [0.05, 0, 0], "normal": [1, 0, 0]}}}"#,
    r#"{"kind": "hybrid", "dynamic": {"halfSpace": {"point": [0.03, 0, 0], "normal": [-1, 0, 0]}}}"#,
    r#"{"kind": "hybrid", "dynamic": {"box": {"min": [0.03, 0, 0], "max": [0.07, 0.02, 0.01]}}}"#,
    r#"{"kind": "hybrid", "dynamic": {"any": [
        {"box": {"min": [0.01, 0, 0], "max": [0.03, 0.02, 0.02]}},
        {"box": {"min": [0.06, 0, 0], "max": [0.08, 0.02, 0.02]}}]}}"#,
];

fn displacements(s: &mut Simulation) -> Vec<Vec3> {
    (0..s.model().surface_nodes.len())
        .map(|j| {
            let node = s.model().surface_nodes[j] as usize;
            s.surface_vertex(j) - s.model().mesh.nodes[node]
        })
        .collect()
}

#[test]
fn at_rest_every_split_is_the_whole() {
    let scheme = |model: &str, scheme: &str| {
        let integration = format!(r#""integration": {{"scheme": "{scheme}"}}, "tools""#);
        bar(model).replace("\"tools\"", &integration)
    };
    let mut scenes: Vec<String> = SPLITS.iter().map(|m| bar(m)).collect();
    scenes.extend(SPLITS.iter().map(|m| scheme(m, "implicitEuler")));
    scenes.push(scheme(SPLITS[2], "rungeKutta4"));
    for scene in scenes {
        let mut s = common::simulation(&scene);
        println!(
            "{:?}",
            (
                s.model().parts.moving,
                s.model().parts.connection,
                s.model().parts.touchable,
                s.model().parts.known
            )
        );
        for _ in 0..3000 {
            s.step(1e-3).unwrap();
        }
        let reference = tissue::reference::solve(s.model(), false).unwrap();
        let found = displacements(&mut s);
        let mut worst = 0.0f64;
        let mut size = 0.0f64;
        for (j, u) in found.iter().enumerate() {
            let k = s.model().scene_node[s.model().surface_nodes[j] as usize] as usize;
            let truth = Vec3::from(reference.displacement[k]);
            worst = worst.max((u - truth).norm());
            size = size.max(truth.norm());
        }
        let e = s.energy();
        println!(
            "{worst:e} of {size:e}, balance {:e} of {:e}",
            e.balance() - s.state().account.start,
            e.elastic
        );
        assert!(worst < 1e-9 * size);
    }
}

#[test]
fn the_account_closes_whatever_happens() {
    let quasi_static = r#"{"kind": "quasiStatic"}"#;
    let scenes = SPLITS.iter().chain([&quasi_static]).map(|m| bar(m));
    let implicit = |text: &str| {
        text.replace(
            "\"tools\"",
            r#""integration": {"scheme": "implicitEuler"}, "tools""#,
        )
    };
    let scenes: Vec<String> = scenes.flat_map(|text| [implicit(&text), text]).collect();
    for scene in scenes {
        let mut s = common::simulation(&scene);
        let (mut worst, mut size) = (0.0f64, 0.0f64);
        for k in 0..1200 {
            common::script(&mut s, 1e-3 * k as f64);
            s.step(1e-3).unwrap();
            let e = s.energy();
            let off = e.balance() - s.state().account.start;
            worst = worst.max(off.abs());
            size = size.max(e.elastic.abs() + e.tool_work.abs());
            if k % 100 == 0 {
                println!(
                    "{k} {off:e} {e:?} {:?} {}",
                    s.tool(0).force,
                    s.state().held.len()
                );
            }
        }
        println!("{worst:e} of {size:e}");
        assert!(worst < 1e-9 * size);
    }
}
