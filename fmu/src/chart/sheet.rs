//! A scene's rows as panels, and the fronts as a table.

use std::fmt::Write;

use super::front::front;
use super::record::Record;
use super::settings::{Family, SETTINGS};
use super::study::Plan;
use crate::picture::chart::{CARD, INK, MUTED};
use crate::picture::scatter::{Mark, Point, Scatter, mark};
use crate::picture::svg::{escape, hex, px, text_width};
use crate::picture::{Axis, PALETTE, Scale};

const WIDTH: f64 = 1000.0;
const MARGIN: f64 = 16.0;
/// Of a panel in px.
const PANEL: f64 = 280.0;
/// Of a line of the key in px.
const LINE: f64 = 15.0;
/// Size of its letters.
const KEY: f64 = 11.0;
/// From the top to the first panels in px.
const HEAD: f64 = 84.0;
/// Where errors are drawn that are smaller: so many times what the reference is still off.
const BELOW: f64 = 0.7;
/// A millisecond takes a millisecond \[us\].
const REAL_TIME: f64 = 1000.0;

/// An error that is charted.
pub struct Measure {
    pub title: &'static str,
    unit: &'static str,
    of: fn(&Record) -> Option<f64>,
    /// What the reference is still off.
    floor: fn(&Record) -> Option<f64>,
}

pub const MEASURES: [Measure; 2] = [
    Measure {
        title: "error of the force",
        unit: "%",
        of: |r| r.force_error,
        floor: |r| r.reference_force_error,
    },
    Measure {
        title: "error of the surface, L2",
        unit: "mm",
        of: |r| r.surface_l2,
        floor: |r| r.reference_surface_error,
    },
];

/// Rows of one gesture, with cost and error, that were run to the end.
fn charted<'a>(
    records: &'a [Record],
    scene: &str,
    gesture: &str,
    measure: &Measure,
) -> Vec<(&'a Record, [f64; 2])> {
    let of = |r: &&Record| r.scene == scene && r.gesture == gesture;
    let rows = records.iter().filter(of);
    rows.filter_map(|r| Some((r, [r.step_median?, (measure.of)(r)?])))
        .collect()
}

/// Points as fronts see them: errors are told apart by two digits, and not below what the reference is still off.
fn told_apart(rows: &[(&Record, [f64; 2])], measure: &Measure) -> Vec<[f64; 2]> {
    let floor = |r: &Record| (measure.floor)(r).unwrap_or(0.0);
    (rows.iter())
        .map(|(r, [cost, error])| [*cost, rounded(error.max(floor(r)), 1)])
        .collect()
}

/// Those that nothing beats, by cost.
pub fn best<'a>(
    records: &'a [Record],
    scene: &str,
    gesture: &str,
    measure: &Measure,
) -> Vec<(&'a Record, [f64; 2])> {
    let rows = charted(records, scene, gesture, measure);
    let points = told_apart(&rows, measure);
    front(&points).into_iter().map(|k| rows[k]).collect()
}

/// One scene's sheet as an SVG file: a column a gesture, a row a measure.
pub fn svg(plan: &Plan, records: &[Record]) -> String {
    let columns = plan.gestures.len() as f64;
    let width = (WIDTH - MARGIN) / columns;
    let mut body = String::new();
    let mut top = HEAD;
    for measure in &MEASURES {
        let mut longest = 0;
        for (k, gesture) in plan.gestures.iter().enumerate() {
            let rows = charted(records, plan.scene.name, gesture.name, measure);
            let front = front(&told_apart(&rows, measure));
            longest = longest.max(front.len());
            let title = format!("{}: {}", gesture.name, measure.title);
            let scatter = Scatter {
                title: &title,
                x: Axis {
                    label: "cost: wall time of 1 ms",
                    unit: "µs",
                    scale: Scale::Logarithmic,
                },
                y: Axis {
                    label: "error",
                    unit: measure.unit,
                    scale: Scale::Logarithmic,
                },
                points: (rows.iter())
                    .map(|(r, [cost, error])| {
                        let least = BELOW * (measure.floor)(r).unwrap_or(0.0);
                        point(plan, r, [*cost, error.max(least)])
                    })
                    .collect(),
                limit: Some((REAL_TIME, "real time")),
                floor: (rows.first())
                    .and_then(|(r, _)| (measure.floor)(r))
                    .map(|y| (y, "reference ±")),
                front: front.clone(),
            };
            let left = 0.5 * MARGIN + width * k as f64;
            // Writing to a String cannot fail.
            let _ = writeln!(
                body,
                "<g transform=\"translate({} {})\">\n{}{}</g>",
                px(left),
                px(top),
                scatter.group(width - 8.0, PANEL),
                key(
                    &front.iter().map(|k| rows[*k]).collect::<Vec<_>>(),
                    measure,
                    width
                )
            );
        }
        top += PANEL + 10.0 + LINE * longest as f64 + 22.0;
    }
    let (w, h) = (px(WIDTH), px(top));
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
         font-family=\"system-ui, sans-serif\" role=\"img\">\n\
         <rect width=\"{w}\" height=\"{h}\" rx=\"10\" fill=\"{CARD}\"/>\n{}{body}</svg>\n",
        head(plan, records)
    )
}

fn head(plan: &Plan, records: &[Record]) -> String {
    let mut calibration: Vec<f64> = (records.iter())
        .filter(|r| r.scene == plan.scene.name)
        .filter_map(|r| r.calibration)
        .collect();
    calibration.sort_by(f64::total_cmp);
    let machine = calibration
        .get(calibration.len() / 2)
        .map_or(String::new(), |c| {
            format!("40 960 multiply-adds: {} µs", three(*c))
        });
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "<text x=\"{0}\" y=\"26\" font-size=\"16\" font-weight=\"600\" fill=\"{INK}\">Speed and accuracy: {1}</text>\n\
         <text x=\"{0}\" y=\"45\" font-size=\"12\" fill=\"{MUTED}\">{2}</text>\n\
         <text x=\"{3}\" y=\"26\" font-size=\"12\" fill=\"{MUTED}\" text-anchor=\"end\">{4}</text>\n\
         <g font-size=\"12\" fill=\"{INK}\">",
        px(MARGIN),
        plan.scene.name,
        escape(plan.scene.sentence),
        px(WIDTH - MARGIN),
        escape(&machine)
    );
    let mut x = MARGIN + 5.0;
    for family in Family::ALL {
        let look = format!("fill=\"{}\"", hex(color(family)));
        let _ = writeln!(
            text,
            "{}<text x=\"{}\" y=\"68\">{}</text>",
            mark(Mark::Circle, x, 64.0, 4.5, &look),
            px(x + 8.0),
            family.name()
        );
        x += 24.0 + text_width(family.name(), 12.0);
    }
    x += 10.0;
    let mut sizes = plan.sizes.clone();
    sizes.sort_by(|a, b| b.total_cmp(a));
    for size in sizes {
        let look = format!("fill=\"none\" stroke=\"{INK}\" stroke-width=\"1.3\"");
        let name = millimetres(1e3 * size);
        let _ = writeln!(
            text,
            "{}<text x=\"{}\" y=\"68\">{name}</text>",
            mark(shape(plan, 1e3 * size), x, 64.0, 4.5, &look),
            px(x + 9.0)
        );
        x += 24.0 + text_width(&name, 12.0);
    }
    text + "</g>\n"
}

/// What the numbers of a panel mean, below it.
fn key(best: &[(&Record, [f64; 2])], measure: &Measure, width: f64) -> String {
    let mut text = format!("<g font-size=\"{KEY}\" fill=\"{INK}\">\n");
    for (k, (record, [cost, error])) in best.iter().enumerate() {
        let y = PANEL + 14.0 + LINE * k as f64;
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "<text x=\"22\" y=\"{0}\" font-weight=\"700\" text-anchor=\"end\">{1}</text>\
             <text x=\"28\" y=\"{0}\">{2}</text>\
             <text x=\"{3}\" y=\"{0}\" text-anchor=\"end\" fill=\"{MUTED}\">{4} µs, {5} {6}</text>",
            px(y),
            k + 1,
            escape(&format!(
                "{}, {}",
                short(&record.setting),
                millimetres(record.size)
            )),
            px(width.min(400.0) - 14.0),
            three(*cost),
            escape(&stated(record, *error, measure)),
            measure.unit
        );
    }
    text + "</g>\n"
}

/// A setting's name where there is little room.
pub fn short(name: &str) -> String {
    let words = [
        ("St Venant-Kirchhoff", "StVK"),
        ("neo-Hookean", "NH"),
        ("central difference", "CD"),
        ("nodal pressure", "NP"),
        ("Runge-Kutta 4", "RK4"),
        ("averaged", "avg"),
        ("substep", "h"),
    ];
    (words.iter()).fold(name.to_string(), |text, (from, to)| text.replace(from, to))
}

fn point(plan: &Plan, record: &Record, [x, y]: [f64; 2]) -> Point {
    let family = Family::ALL.into_iter().find(|f| f.name() == record.family);
    Point {
        x,
        y,
        mark: shape(plan, record.size),
        color: family.map_or([0; 3], color),
    }
}

pub fn color(family: Family) -> [u8; 3] {
    match family {
        Family::SpringMass => PALETTE[6],
        Family::QuasiStatic => PALETTE[2],
        Family::TensorMass => [24, 72, 168],
        Family::Hybrid => [46, 176, 214],
        Family::Adaptive => PALETTE[4],
        Family::StVenantKirchhoff => PALETTE[3],
        Family::StableNeoHookean => PALETTE[1],
    }
}

/// Coarse meshes have round marks, fine ones pointed.
fn shape(plan: &Plan, size: f64) -> Mark {
    let near = |s: &&f64| (1e3 * **s / size - 1.0).abs() < 1e-3;
    let at = plan.scene.sizes.iter().position(|s| near(&s));
    match at {
        Some(0) => Mark::Circle,
        Some(1) => Mark::Square,
        _ => Mark::Triangle,
    }
}

/// "3.33 mm"
fn millimetres(size: f64) -> String {
    format!("{} mm", three(size))
}

/// An error by two digits; where it is smaller than what the reference is still off, that it is.
fn stated(record: &Record, error: f64, measure: &Measure) -> String {
    match (measure.floor)(record) {
        Some(floor) if error < floor => format!("< {}", two(floor)),
        _ => two(error),
    }
}

/// To so many digits after the first.
pub fn rounded(value: f64, digits: usize) -> f64 {
    format!("{value:.digits$e}").parse().unwrap_or(value)
}

/// Three digits, without an exponent.
pub fn three(value: f64) -> String {
    format!("{}", rounded(value, 2))
}

/// The fronts, and what the settings are, as Markdown.
pub fn table(plans: &[Plan], records: &[Record]) -> String {
    let mut text = String::new();
    for plan in plans {
        for measure in &MEASURES {
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "### {}: {}\n\n| gesture | setting | size | µs a ms, median | 99 % | worst | error | of the model | of the mesh | work, kflop a ms | smallest det F |\n|---|---|---|---|---|---|---|---|---|---|---|",
                plan.scene.name, measure.title
            );
            for gesture in &plan.gestures {
                for (r, [cost, error]) in best(records, plan.scene.name, gesture.name, measure) {
                    let (model, mesh) = match measure.unit {
                        "%" => (r.modelling_force, r.discretisation_force),
                        _ => (r.modelling_surface, r.discretisation_surface),
                    };
                    let unit = measure.unit;
                    let shown =
                        |v: Option<f64>| v.map_or("".into(), |v| format!("{} {unit}", two(v)));
                    let _ = writeln!(
                        text,
                        "| {} | {} | {} | {} | {} | {} | {} {unit} | {} | {} | {} | {} |",
                        gesture.name,
                        r.setting,
                        millimetres(r.size),
                        three(cost),
                        r.step_99.map_or("".into(), three),
                        r.step_worst.map_or("".into(), three),
                        stated(r, error, measure),
                        shown(model),
                        shown(mesh),
                        r.work.map_or("not counted".into(), three),
                        r.least_volume.map_or("".into(), |v| format!("{v:.2}"))
                    );
                }
            }
            text.push('\n');
        }
    }
    text += "### Settings\n\n| setting | what it is |\n|---|---|\n";
    for setting in SETTINGS {
        let _ = writeln!(text, "| {} | {} |", setting.name, setting.sentence);
    }
    text
}

/// Two digits, without an exponent; 0 where it is next to nothing.
pub fn two(value: f64) -> String {
    if value < 1e-4 {
        return "0".into();
    }
    format!("{}", rounded(value, 1))
}

#[cfg(test)]
mod tests {
    use super::super::scenes::SCENES;
    use super::*;

    /// In the narrowest key a name leaves room for its number, cost and error.
    #[test]
    fn keys_fit() {
        let width = (WIDTH - MARGIN) / 3.0;
        for setting in SETTINGS {
            for size in SCENES
                .iter()
                .flat_map(|scene| &scene.sizes[..setting.sizes])
            {
                let name = format!("{}, {}", short(setting.name), millimetres(1e3 * size));
                let left = 28.0 + text_width(&name, KEY);
                let right = width - 14.0 - text_width("16700 µs, < 0.023 mm", KEY);
                assert!(left < right, "{name}: {left} to {right}");
            }
        }
    }
}
