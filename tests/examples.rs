//! Every scene in `examples/` makes a model, and the committed schema is that of the types.

use std::path::PathBuf;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn examples_make_models_without_warnings() {
    let mut count = 0;
    for entry in std::fs::read_dir(root().join("examples")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "json") {
            let model = tissue::prepared::read(&path).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(
                tissue::inspect::warnings(&model),
                Vec::<String>::new(),
                "{}",
                path.display()
            );
            assert_eq!(
                Some(model.scene.name.as_str()),
                path.file_stem().and_then(|s| s.to_str())
            );
            count += 1;
        }
    }
    assert!(count >= 4);
}

/// The numbers that the examples' descriptions promise.
#[test]
fn plate_and_cantilever_settle_where_the_direct_solution_says() {
    for (name, after_cuts, seconds) in [("cantilever", false, 1.5), ("plate_cut", true, 4.0)] {
        let path = root().join(format!("examples/{name}.json"));
        let model = std::sync::Arc::new(tissue::prepared::read(&path).unwrap());
        let reference = tissue::reference::solve(&model, after_cuts).unwrap();
        let mut s = tissue::simulation::Simulation::new(model.clone());
        while s.time() < seconds {
            s.step(0.01).unwrap();
        }
        let (mut worst, mut scale) = (0.0f64, 0.0f64);
        for (k, node) in model.node.iter().enumerate() {
            if s.state().live.star_count[*node as usize] > 0 {
                let exact = tissue::mesh::Vec3::from(reference.displacement[k]);
                worst = worst.max((s.state().displacement[*node as usize].xyz() - exact).norm());
                scale = scale.max(exact.norm());
            }
        }
        assert!(worst < 1e-6 * scale, "{name}: {worst:e} of {scale:e}");
        assert_eq!(!s.state().live.removed.is_empty(), after_cuts);
    }
}

/// `UPDATE=1 cargo test -p tissue --test examples` writes it.
#[test]
fn committed_schema_is_current() {
    let path = root().join("modelDescription/scene.schema.json");
    let text = format!("{:#}\n", tissue::scene::schema());
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    assert!(
        std::fs::read_to_string(&path).unwrap() == text,
        "run UPDATE=1 cargo test -p tissue --test examples"
    );
}
