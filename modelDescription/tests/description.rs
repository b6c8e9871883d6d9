//! The description that hosts read: committed for one example, and right where validators do not look.

use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::sync::Arc;

use model_description::{Causality, Row, TABLE, Value, count, exists, reference, resolve, write};
use tissue::simulation::Simulation;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn simulation(example: &str, change: impl Fn(String) -> String) -> Simulation {
    let path = root().join(format!("../examples/{example}.json"));
    let text = change(std::fs::read_to_string(&path).unwrap());
    let scene = tissue::scene::parse(&text, example).unwrap();
    Simulation::new(Arc::new(tissue::prepared::prepare(scene, &path).unwrap()))
}

/// Attribute of a line of XML.
fn attribute<'a>(line: &'a str, name: &str) -> Option<&'a str> {
    let start = line.find(&format!(" {name}=\""))? + name.len() + 3;
    Some(&line[start..start + line[start..].find('"')?])
}

/// `UPDATE=1 cargo test -p model-description` writes it.
#[test]
fn committed_description_is_current() {
    let path = root().join("bar.xml");
    let text = write(&mut simulation("bar", |t| t));
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    assert!(
        std::fs::read_to_string(&path).unwrap() == text,
        "run UPDATE=1 cargo test -p model-description"
    );
}

#[test]
fn references_are_unique_and_resolve_to_their_row() {
    for example in ["bar", "plate_cut", "hepatectomy", "torn_cylinder"] {
        let s = simulation(example, |t| t);
        let model = s.model();
        let mut seen = HashSet::new();
        for row in TABLE.iter().filter(|row| exists(row, model)) {
            for item in 0..count(row.group, model) {
                for component in 0..row.components.len() {
                    let reference = reference(row, item, component);
                    assert!(seen.insert(reference), "{} twice", row.name);
                    let (found, i, c) = resolve(reference, model).unwrap();
                    assert_eq!((found.name, i, c), (row.name, item, component));
                }
            }
        }
        assert!(
            (0..3000)
                .filter(|r| resolve(*r, model).is_some())
                .all(|r| seen.contains(&r))
        );
    }
}

#[test]
fn every_variable_is_complete() {
    let local = |t: String| {
        t.replace(
            "\"triangles\": true",
            "\"triangles\": true, \"causality\": \"local\"",
        )
    };
    for (example, text) in [
        ("bar", write(&mut simulation("bar", |t| t))),
        ("bar, local", write(&mut simulation("bar", local))),
        ("cantilever", write(&mut simulation("cantilever", |t| t))),
    ] {
        let units: HashSet<&str> = text
            .lines()
            .filter(|l| l.contains("<Unit "))
            .filter_map(|l| attribute(l, "name"))
            .collect();
        let unknown: Vec<&str> = text
            .lines()
            .filter(|l| l.contains("<Unknown "))
            .filter_map(|l| attribute(l, "index"))
            .collect();
        let mut uses: HashMap<&str, u32> = HashMap::new();
        for index in unknown {
            *uses.entry(index).or_default() += 1;
        }
        let (mut names, mut index) = (HashSet::new(), 0);
        for line in text.lines().filter(|l| l.contains("<ScalarVariable ")) {
            index += 1;
            let name = attribute(line, "name").unwrap();
            assert!(names.insert(name), "{example}: {name} twice");
            let causality = attribute(line, "causality").unwrap();
            assert!(
                attribute(line, "variability").is_some()
                    && attribute(line, "description").is_some()
            );
            let initial = attribute(line, "initial");
            let start = attribute(line, "start");
            match causality {
                "input" => assert!(initial.is_none() && start.is_some(), "{name}"),
                "parameter" => assert!(initial == Some("exact") && start.is_some(), "{name}"),
                _ => assert!(initial == Some("calculated") && start.is_none(), "{name}"),
            }
            // An output stands in Outputs and in InitialUnknowns, nothing else does.
            let wanted = if causality == "output" { 2 } else { 0 };
            assert_eq!(
                uses.get(index.to_string().as_str()).copied().unwrap_or(0),
                wanted,
                "{name}"
            );
            if let Some(unit) = attribute(line, "unit") {
                assert!(units.contains(unit), "{name}: {unit}");
            }
            if line.contains("<Real") && start.is_some() {
                let number = |a: &str| attribute(line, a).map(|v| v.parse::<f64>().unwrap());
                let start = number("start").unwrap();
                assert!(
                    number("min").is_none_or(|m| m <= start)
                        && number("max").is_none_or(|m| m >= start),
                    "{name}"
                );
            }
        }
        assert!(index > 40 && names.contains("tool[1].position.x") == (example != "cantilever"));
    }
}

/// The threshold is there where there is tearing, and refuses what the scene would.
#[test]
fn a_threshold_needs_tearing() {
    let row = |row: &&Row| row.name == "tearing.threshold";
    let row = TABLE.iter().find(row).unwrap();
    let bar = simulation("bar", |t| t);
    assert!(!exists(row, bar.model()) && resolve(35, bar.model()).is_none());
    let mut torn = simulation("torn_cylinder", |t| t);
    assert!(exists(row, torn.model()));
    assert!(write(&mut torn).contains(r#"name="tearing.threshold" valueReference="35""#));
    let Value::Real { set: Some(set), .. } = row.value else {
        panic!("no number that can be set");
    };
    assert_eq!(
        set(&mut torn, 0, 0, 0.0),
        Err("must be above 0".to_string())
    );
    assert_eq!(torn.parameters().tearing_threshold, 0.25);
}

/// What is written is read back, and inputs and parameters are all that can be written.
#[test]
fn setters_set_what_getters_get() {
    let mut s = simulation("bar", |t| t);
    let model = s.model().clone();
    for row in TABLE.iter().filter(|row| exists(row, &model)) {
        let writable = matches!(row.causality, Causality::Input | Causality::Parameter);
        match row.value {
            Value::Real { get, set, .. } => {
                assert_eq!(set.is_some(), writable, "{}", row.name);
                for c in 0..row.components.len() {
                    if let Some(set) = set {
                        let value = get(&mut s, 0, c) * 0.5 + 0.125;
                        set(&mut s, 0, c, value).unwrap();
                        assert_eq!(get(&mut s, 0, c), value, "{}", row.name);
                    }
                }
            }
            Value::Boolean { get, set } => {
                assert_eq!(set.is_some(), writable, "{}", row.name);
                if let Some(set) = set {
                    set(&mut s, 0, 0, true).unwrap();
                    assert!(get(&mut s, 0, 0));
                }
            }
            Value::Integer { .. } | Value::Evaluated { .. } => assert!(!writable, "{}", row.name),
        }
    }
}
