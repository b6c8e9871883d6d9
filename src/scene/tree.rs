//! From text to a JSON tree, or to what is wrong with the text.

use serde::de::{Deserialize, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde_json::error::Category;
use serde_json::{Map, Value};
use serde_path_to_error::Segment;

use super::error::SceneError;
use super::json::{Result, join, quoted};

/// The text as a tree. Errors: syntax, a number that overflows, a key that stands twice in one object.
pub(super) fn tree(text: &str) -> Result<Value> {
    if text.trim().is_empty() {
        return Err(SceneError::at(
            "",
            "",
            "empty; must be a JSON object with \"name\", \"mesh\" and \"materials\"",
        ));
    }
    let mut json = serde_json::Deserializer::from_str(text);
    let mut track = serde_path_to_error::Track::new();
    let tree = Tree::deserialize(serde_path_to_error::Deserializer::new(
        &mut json, &mut track,
    ));
    let error = match tree.and_then(|Tree(value)| json.end().map(|()| value)) {
        Ok(value) => return Ok(value),
        Err(error) => error,
    };
    let (line, column) = (error.line(), error.column());
    let full = error.to_string();
    let what = full
        .strip_suffix(&format!(" at line {line} column {column}"))
        .unwrap_or(&full);
    let path = track
        .path()
        .iter()
        .fold(String::new(), |path, step| match step {
            Segment::Map { key } => join(&path, key),
            Segment::Seq { index } => format!("{path}[{index}]"),
            _ => path,
        });
    Err(match (error.classify(), what) {
        (Category::Data, key) => {
            let message = format!(
                "key {} stands twice, again in line {line}; remove one",
                quoted(key)
            );
            SceneError::at("", join(&path, key), message)
        }
        (_, "number out of range") => {
            let message =
                format!("number out of range in line {line}; must be between -1.7e308 and 1.7e308");
            SceneError::at("", path, message)
        }
        (_, what) => syntax(text, what, line, column),
    })
}

fn syntax(text: &str, what: &str, line: usize, column: usize) -> SceneError {
    let of = |line: usize| text.lines().nth(line.saturating_sub(1)).unwrap_or_default();
    // A line break is column 0 of the next line.
    let (line, column) = match column {
        0 if line > 1 => (line - 1, of(line - 1).len() + 1),
        _ => (line, column),
    };
    let start = of(line);
    let rest = start.get(column.saturating_sub(1)..).unwrap_or_default();
    let message = match what {
        _ if rest.starts_with('/') => "found a comment; JSON has none, remove it".into(),
        _ if rest.starts_with('\'') => "found a single quote; must be a double quote".into(),
        _ if rest.starts_with("NaN") || rest.starts_with("Infinity") => {
            "found a number that is not finite; must be finite".into()
        }
        "trailing characters" => "text after the scene; must end with its closing brace".into(),
        "trailing comma" => "trailing comma; remove it".into(),
        "key must be a string" => "found no key; must be a name in double quotes".into(),
        "recursion limit exceeded" => "nested too deeply; must be less than 128 deep".into(),
        _ if what.starts_with("control character") => {
            "line break or control character in a string; must be closed, or written \\n".into()
        }
        _ if what.starts_with("EOF while parsing ") => {
            let inside = what.trim_start_matches("EOF while parsing ");
            format!("the file ends inside {inside}; must be closed")
        }
        _ if what.starts_with("expected `") => format!("{what}; one is missing before this place"),
        _ => format!("{what}; must be JSON"),
    };
    SceneError::at("", format!("line {line}, column {column}"), message)
}

struct Tree(Value);

impl<'de> Deserialize<'de> for Tree {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(TreeVisitor).map(Tree)
    }
}

struct TreeVisitor;

impl<'de> Visitor<'de> for TreeVisitor {
    type Value = Value;

    fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("JSON")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E>(self, value: f64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Value, A::Error> {
        let mut items = Vec::new();
        while let Some(Tree(item)) = seq.next_element()? {
            items.push(item);
        }
        Ok(items.into())
    }

    /// Fails with the key as message where one stands twice.
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Value, A::Error> {
        let mut object = Map::new();
        while let Some(key) = map.next_key::<String>()? {
            if object.contains_key(&key) {
                return Err(A::Error::custom(key));
            }
            let Tree(value) = map.next_value()?;
            object.insert(key, value);
        }
        Ok(object.into())
    }
}
