//! A row of the CSV.

use std::fmt::Write;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// One setting on one body of one size, moved by one gesture. Errors are those of the settled state unless said otherwise,
/// forces as vectors, relative to the reference's.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Record {
    /// Of the product.
    pub version: String,
    /// Of all that the row follows from.
    pub key: String,
    pub scene: String,
    pub gesture: String,
    pub setting: String,
    pub family: String,
    /// Of cells or edges.
    #[serde(rename = "size_mm")]
    pub size: f64,
    pub vertices: usize,
    pub tetrahedra: usize,
    pub patch_nodes: usize,
    /// `done`, or why a step was not made; then nothing else is known.
    pub outcome: String,
    /// In a step of 1 ms, in the mean.
    pub substeps: Option<f64>,
    /// Wall time of a step.
    #[serde(rename = "stepMedian_us")]
    pub step_median: Option<f64>,
    #[serde(rename = "step99_us")]
    pub step_99: Option<f64>,
    #[serde(rename = "stepWorst_us")]
    pub step_worst: Option<f64>,
    /// Steps that were timed.
    pub steps: Option<usize>,
    /// Wall time of reading all surface vertices once; in no other time.
    #[serde(rename = "reading_us")]
    pub reading: Option<f64>,
    /// Of 40 960 multiply-adds on this machine just before.
    #[serde(rename = "calibration_us")]
    pub calibration: Option<f64>,
    #[serde(rename = "work_kflop")]
    pub work: Option<f64>,
    #[serde(rename = "forceX_N")]
    pub force_x: Option<f64>,
    #[serde(rename = "forceY_N")]
    pub force_y: Option<f64>,
    #[serde(rename = "forceZ_N")]
    pub force_z: Option<f64>,
    #[serde(rename = "forceError_percent")]
    pub force_error: Option<f64>,
    #[serde(rename = "surfaceL2_mm")]
    pub surface_l2: Option<f64>,
    #[serde(rename = "surfaceLargest_mm")]
    pub surface_largest: Option<f64>,
    /// Against the full law on the same mesh and element.
    #[serde(rename = "modellingForceError_percent")]
    pub modelling_force: Option<f64>,
    #[serde(rename = "modellingSurfaceL2_mm")]
    pub modelling_surface: Option<f64>,
    /// Of the full law on the same mesh and element.
    #[serde(rename = "discretisationForceError_percent")]
    pub discretisation_force: Option<f64>,
    #[serde(rename = "discretisationSurfaceL2_mm")]
    pub discretisation_surface: Option<f64>,
    /// Over the whole motion: root of the mean square relative to the largest force of the reference.
    #[serde(rename = "pathForceError_percent")]
    pub path_force: Option<f64>,
    /// Largest surface L2 at any look.
    #[serde(rename = "pathSurfaceL2_mm")]
    pub path_surface: Option<f64>,
    #[serde(rename = "referenceForce_N")]
    pub reference_force: Option<f64>,
    #[serde(rename = "referenceSize_mm")]
    pub reference_size: Option<f64>,
    /// What the reference itself is still off, estimated.
    #[serde(rename = "referenceForceError_percent")]
    pub reference_force_error: Option<f64>,
    #[serde(rename = "referenceSurfaceL2_mm")]
    pub reference_surface_error: Option<f64>,
    /// Change of the force over the last 50 ms: what is left to settle.
    #[serde(rename = "settling_percent")]
    pub settling: Option<f64>,
    #[serde(rename = "energyDrift_percent")]
    pub drift: Option<f64>,
    /// Smallest det F.
    pub least_volume: Option<f64>,
    /// Share of the dynamic tetrahedra whose law is not linear.
    pub nonlinear_share: Option<f64>,
    /// Build of the model.
    #[serde(rename = "preparation_s")]
    pub preparation: Option<f64>,
}

/// In the order of the file.
const COLUMNS: [&str; 39] = [
    "version",
    "key",
    "scene",
    "gesture",
    "setting",
    "family",
    "size_mm",
    "vertices",
    "tetrahedra",
    "patchNodes",
    "outcome",
    "substeps",
    "stepMedian_us",
    "step99_us",
    "stepWorst_us",
    "steps",
    "reading_us",
    "calibration_us",
    "work_kflop",
    "forceX_N",
    "forceY_N",
    "forceZ_N",
    "forceError_percent",
    "surfaceL2_mm",
    "surfaceLargest_mm",
    "modellingForceError_percent",
    "modellingSurfaceL2_mm",
    "discretisationForceError_percent",
    "discretisationSurfaceL2_mm",
    "pathForceError_percent",
    "pathSurfaceL2_mm",
    "referenceForce_N",
    "referenceSize_mm",
    "referenceForceError_percent",
    "referenceSurfaceL2_mm",
    "settling_percent",
    "energyDrift_percent",
    "leastVolume",
    "nonlinearShare",
];
/// Last column; a build's time is no result, but tells what a choice costs before it runs.
const LAST: &str = "preparation_s";

fn columns() -> impl Iterator<Item = &'static str> {
    COLUMNS.into_iter().chain([LAST])
}

/// The whole file.
pub fn text(records: &[Record]) -> String {
    let mut text = columns().collect::<Vec<_>>().join(",") + "\n";
    for record in records {
        let Ok(Value::Object(fields)) = serde_json::to_value(record) else {
            continue;
        };
        for (k, column) in columns().enumerate() {
            let comma = if k > 0 { "," } else { "" };
            // Writing to a String cannot fail.
            let _ = match &fields[column] {
                Value::Null => write!(text, "{comma}"),
                Value::String(s) if s.contains([',', '"']) => {
                    write!(text, "{comma}\"{}\"", s.replace('"', "\"\""))
                }
                Value::String(s) => write!(text, "{comma}{s}"),
                Value::Number(n) if n.is_f64() => {
                    write!(text, "{comma}{}", short(n.as_f64().unwrap_or(f64::NAN)))
                }
                value => write!(text, "{comma}{value}"),
            };
        }
        text.push('\n');
    }
    text
}

/// Six digits.
fn short(value: f64) -> String {
    let rounded: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    match rounded.abs() {
        a if a == 0.0 || (1e-4..1e9).contains(&a) => format!("{rounded}"),
        _ => format!("{rounded:e}"),
    }
}

/// Rows of a file that [`text`] has written; none of them where its columns are others.
pub fn parse(text: &str) -> Vec<Record> {
    let mut lines = text.lines();
    let header = lines.next().map(fields).unwrap_or_default();
    if !header.iter().map(String::as_str).eq(columns()) {
        return Vec::new();
    }
    lines.filter_map(|line| row(&fields(line))).collect()
}

fn row(values: &[String]) -> Option<Record> {
    if values.len() != COLUMNS.len() + 1 {
        return None;
    }
    let text = [
        "version", "key", "scene", "gesture", "setting", "family", "outcome",
    ];
    let whole = ["vertices", "tetrahedra", "patchNodes", "steps"];
    let mut object = Map::new();
    for (column, value) in columns().zip(values) {
        let value = match value {
            v if text.contains(&column) => Value::from(v.as_str()),
            v if v.is_empty() => Value::Null,
            v if whole.contains(&column) => Value::from(v.parse::<u64>().ok()?),
            v => Value::from(v.parse::<f64>().ok()?),
        };
        object.insert(column.to_string(), value);
    }
    serde_json::from_value(Value::Object(object)).ok()
}

/// Of a line; quoted ones may hold commas, and quotes twice.
fn fields(line: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut quoted = false;
    let mut characters = line.chars().peekable();
    while let Some(c) = characters.next() {
        let Some(field) = fields.last_mut() else {
            break;
        };
        match c {
            '"' if quoted && characters.peek() == Some(&'"') => {
                characters.next();
                field.push('"');
            }
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(String::new()),
            c => field.push(c),
        }
    }
    fields
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_again() {
        let bare = Record {
            setting: "linear, \"quoted\"".into(),
            outcome: "at 3 ms: no".into(),
            size: 10.0,
            ..Record::default()
        };
        let full = Record {
            outcome: "done".into(),
            vertices: 759,
            steps: Some(800),
            size: 3.33333,
            step_median: Some(12.25),
            drift: Some(1.5e-13),
            force_z: Some(-0.0622154),
            ..Record::default()
        };
        let records = vec![bare, full];
        assert_eq!(parse(&text(&records)), records);
        assert!(
            text(&records)
                .lines()
                .all(|l| fields(l).len() == COLUMNS.len() + 1)
        );
    }

    /// A file that was cut off loses its last row alone.
    #[test]
    fn other_files_have_no_rows() {
        let two = text(&[Record::default(), Record::default()]);
        assert_eq!(parse(&two[..two.len() - 9]).len(), 1);
        assert!(parse("").is_empty());
        assert!(parse("time,x\n1,2\n").is_empty());
    }
}
