//! `modelDescription.xml` of FMI 2.0 for co-simulation.

use std::fmt::Write;

use tissue::model::{Fnv, Model};
use tissue::simulation::Simulation;

use crate::table::{
    Causality, Initial, Row, TABLE, Value, Variability, causality, count, exists, reference,
};

/// Name of the file in the FMU.
pub const MODEL_DESCRIPTION: &str = "modelDescription.xml";

/// Units used by the table: name, exponents of kg, m, s.
const UNITS: &[(&str, [i32; 3])] = &[
    ("1", [0, 0, 0]),
    ("m", [0, 1, 0]),
    ("s", [0, 0, 1]),
    ("m3", [0, 3, 0]),
    ("N", [1, 1, -2]),
    ("N.m", [1, 2, -2]),
    ("N/m", [1, 0, -2]),
    ("J", [1, 2, -2]),
    ("Pa", [1, -1, -2]),
    ("kg/m3", [1, -3, 0]),
    ("m/s2", [0, 1, -2]),
    ("1/s", [0, 0, -1]),
    ("Hz", [0, 0, -1]),
];

/// What hosts can switch on and off.
pub const LOG_CATEGORIES: &[(&str, &str)] = &[
    ("logEvents", "cuts and pre-computation"),
    (
        "logStatusWarning",
        "something unexpected that was put right",
    ),
    (
        "logStatusDiscard",
        "a value or step that was refused; the state is as before",
    ),
    ("logStatusError", "a call that was wrong"),
    ("logStatusFatal", "the instance is lost"),
];

/// Ties the XML to the binary's idea of the model: of the scene, the mesh and this version's table.
pub fn guid(model: &Model) -> String {
    let mut low = Fnv::default();
    low.write(env!("CARGO_PKG_VERSION").as_bytes());
    for g in model.scene.gravity {
        low.write(&g.to_bits().to_le_bytes());
    }
    for row in TABLE {
        low.write(row.name.as_bytes());
        low.write(&row.offset.to_le_bytes());
    }
    let (a, b) = (model.fingerprint, low.0);
    format!(
        "{:08x}-{:04x}-{:04x}-{:04x}-{:012x}",
        a >> 32,
        a >> 16 & 0xffff,
        a & 0xffff,
        b >> 48,
        b & 0xffff_ffff_ffff
    )
}

/// The whole file. Start values are those of a fresh simulation.
pub fn write(simulation: &mut Simulation) -> String {
    let model = simulation.model().clone();
    let name = &model.scene.name;
    let mut xml = String::new();
    let period = 1.0 / model.scene.integration.haptic_rate;
    // Writing to a String cannot fail.
    let _ = write!(
        xml,
        r#"<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{guid}" description="{description}" generationTool="tissue-fmu {version}" variableNamingConvention="structured" numberOfEventIndicators="0">
  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true" canInterpolateInputs="true" maxOutputDerivativeOrder="1" canGetAndSetFMUstate="true" canSerializeFMUstate="true" providesDirectionalDerivative="true"/>
  <UnitDefinitions>
"#,
        guid = guid(&model),
        description = escape(&model.scene.description),
        version = env!("CARGO_PKG_VERSION"),
    );
    for (unit, exponents) in UNITS {
        let mut base = String::new();
        for (symbol, exponent) in ["kg", "m", "s"].iter().zip(exponents) {
            if *exponent != 0 {
                let _ = write!(base, " {symbol}=\"{exponent}\"");
            }
        }
        let _ = writeln!(xml, "    <Unit name=\"{unit}\"><BaseUnit{base}/></Unit>");
    }
    xml.push_str("  </UnitDefinitions>\n  <LogCategories>\n");
    for (category, meaning) in LOG_CATEGORIES {
        let _ = writeln!(
            xml,
            "    <Category name=\"{category}\" description=\"{meaning}\"/>"
        );
    }
    let _ = writeln!(
        xml,
        "  </LogCategories>\n  <DefaultExperiment startTime=\"0\" stopTime=\"1\" stepSize=\"{period}\"/>\n  <ModelVariables>"
    );
    let mut outputs = Vec::new();
    let mut unknowns = Vec::new();
    let mut index = 0;
    for row in TABLE.iter().filter(|row| exists(row, &model)) {
        let causality = causality(row, &model);
        for item in 0..count(row.group, &model) {
            for component in 0..row.components.len() {
                index += 1;
                variable(&mut xml, simulation, row, causality, item, component);
                if causality == Causality::Output {
                    outputs.push(index);
                    if row.initial == Initial::Calculated {
                        unknowns.push(index);
                    }
                }
            }
        }
    }
    xml.push_str("  </ModelVariables>\n  <ModelStructure>\n");
    for (element, list) in [("Outputs", &outputs), ("InitialUnknowns", &unknowns)] {
        if !list.is_empty() {
            let _ = writeln!(xml, "    <{element}>");
            for index in list {
                let _ = writeln!(xml, "      <Unknown index=\"{index}\"/>");
            }
            let _ = writeln!(xml, "    </{element}>");
        }
    }
    xml.push_str("  </ModelStructure>\n</fmiModelDescription>\n");
    xml
}

fn variable(
    xml: &mut String,
    simulation: &mut Simulation,
    row: &Row,
    causality: Causality,
    item: usize,
    component: usize,
) {
    let name = row.name.replace('#', &(item + 1).to_string()) + row.components[component];
    let reference = reference(row, item, component);
    let causality_name = match causality {
        Causality::Input => "input",
        Causality::Output => "output",
        Causality::Parameter => "parameter",
        Causality::Local | Causality::AsScene => "local",
    };
    let variability = match row.variability {
        Variability::Continuous => "continuous",
        Variability::Discrete => "discrete",
        Variability::Tunable => "tunable",
        Variability::Fixed => "fixed",
    };
    let initial = match row.initial {
        Initial::Exact => " initial=\"exact\"",
        Initial::Calculated => " initial=\"calculated\"",
        Initial::None => "",
    };
    let _ = write!(
        xml,
        "    <ScalarVariable name=\"{name}\" valueReference=\"{reference}\" causality=\"{causality_name}\" variability=\"{variability}\"{initial} description=\"{}\">",
        escape(row.description)
    );
    let starts = row.initial != Initial::Calculated;
    let _ = match row.value {
        Value::Real {
            unit,
            get,
            min,
            max,
            ..
        } => {
            let bound = |name: &str, value: Option<f64>| {
                value.map_or(String::new(), |v| format!(" {name}=\"{v}\""))
            };
            let start = starts.then(|| get(simulation, item, component));
            write!(
                xml,
                "<Real unit=\"{unit}\"{}{}{}/>",
                bound("min", min),
                bound("max", max),
                bound("start", start)
            )
        }
        Value::Evaluated { unit, .. } => write!(xml, "<Real unit=\"{unit}\"/>"),
        Value::Integer { .. } => write!(xml, "<Integer/>"),
        Value::Boolean { get, .. } if starts => {
            write!(
                xml,
                "<Boolean start=\"{}\"/>",
                get(simulation, item, component)
            )
        }
        Value::Boolean { .. } => write!(xml, "<Boolean/>"),
    };
    xml.push_str("</ScalarVariable>\n");
}

/// Text for an attribute.
fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\n' | '\r' | '\t' => out.push(' '),
            // Not characters of XML.
            c if c.is_control() || matches!(c, '\u{FFFE}' | '\u{FFFF}') => {}
            c => out.push(c),
        }
    }
    out
}
