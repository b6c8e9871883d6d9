//! What came out: a table, lines of advice, a CSV, a picture, the scene.

use std::fmt::Write;

use tissue::scene::{MeshSource, Scene};

use super::error::Off;
use super::search::{MARGIN, Outcome, Row, Search};
use crate::chart::front::front;
use crate::chart::settings::Family;
use crate::chart::sheet::{color, rounded, short, three, two};
use crate::picture::chart::{CARD, INK, MUTED};
use crate::picture::scatter::{Mark, Point, Scatter, mark};
use crate::picture::svg::{escape, hex, px, text_width};
use crate::picture::{Axis, Scale};

/// Rows in pictures and tables: cost \[kflop a ms\] and error \[%\] of what was run.
fn run(rows: &[Row]) -> Vec<(usize, [f64; 2])> {
    let point = |(k, r): (usize, &Row)| Some((k, [r.work?, 100.0 * r.off?.most()]));
    rows.iter().enumerate().filter_map(point).collect()
}

/// Of these the ones that nothing beats; errors are told apart by two digits.
fn best(points: &[(usize, [f64; 2])]) -> Vec<usize> {
    let told_apart = |(_, [work, error]): &(usize, [f64; 2])| [*work, rounded(*error, 1)];
    front(&points.iter().map(told_apart).collect::<Vec<_>>())
}

fn name(search: &Search, row: &Row) -> String {
    format!(
        "{}, {}",
        row.setting.name,
        search.places[row.grid].grid.label()
    )
}

fn percent(off: f64) -> String {
    format!("{} %", two(100.0 * off))
}

/// What nothing beats, and the advice, by work.
pub fn table(search: &Search, rows: &[Row], advised: Option<usize>) -> String {
    let points = run(rows);
    let mut shown: Vec<usize> = best(&points).into_iter().map(|k| points[k].0).collect();
    shown.extend(advised.filter(|k| !shown.contains(k)));
    let work = |k: &usize| rows[*k].work.unwrap_or(f64::INFINITY);
    shown.sort_by(|a, b| work(a).total_cmp(&work(b)));
    let widest = shown.iter().map(|k| name(search, &rows[*k]).len()).max();
    let width = widest.unwrap_or(0).max("setting".len());
    let mut text = format!(
        "{:width$}  {:>10}  {:>9}  {:>9}  {:>7}  {:>7}  verdict",
        "setting", "kflop a ms", "us, 50 %", "us, 99 %", "force", "surface"
    );
    for k in shown {
        let row = &rows[k];
        let number = |v: Option<f64>| v.map_or(String::new(), three);
        let Off { force, surface } = row.off.unwrap_or_default();
        let verdict = if advised == Some(k) {
            "advised"
        } else {
            row.outcome.text()
        };
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "\n{:width$}  {:>10}  {:>9}  {:>9}  {:>7}  {:>7}  {verdict}",
            name(search, row),
            number(row.work),
            number(row.median),
            number(row.step_99),
            percent(force),
            percent(surface)
        );
    }
    text
}

/// One line of advice or of why there is none, then what it rests on.
pub fn advice(search: &Search, rows: &[Row], advised: Option<usize>) -> Vec<String> {
    let wish = &search.wish;
    let wanted = format!("{} at {} Hz", percent(wish.tolerance), three(wish.rate));
    let mut lines = Vec::new();
    match advised {
        Some(k) => {
            let row = &rows[k];
            lines.push(format!(
                "advice for {wanted}: {}: {} off, {} kflop a ms, {} of {} us a step",
                name(search, row),
                percent(row.off.unwrap_or_default().most()),
                three(row.work.unwrap_or_default()),
                three(row.step_99.unwrap_or_default()),
                three(1e6 / wish.rate)
            ));
            lines.extend(cheaper(search, rows, row));
            lines.extend(lucky(search, rows, row));
            if let (Some(safest), Some(work)) = (search.safest(), row.work) {
                lines.push(format!(
                    "St Venant-Kirchhoff all over, {}, at the substep of the bound by elements: {} kflop a ms, {} times as much",
                    search.places[0].grid.label(),
                    three(safest),
                    three(safest / work)
                ));
            }
        }
        None => lines.push(nearest(search, rows, &wanted)),
    }
    lines.push(match search.reference() {
        Some(grid) => format!(
            "compared with the stable neo-Hookean law on nodal-averaged elements, {}: on the scene's own mesh that is {} off",
            grid.label(),
            percent(search.off_of_mesh().most())
        ),
        None => "compared with the stable neo-Hookean law on nodal-averaged elements on the scene's own mesh: what the mesh itself is off by is not in it".into(),
    });
    lines
}

/// The best of what costs less.
fn cheaper(search: &Search, rows: &[Row], advised: &Row) -> Option<String> {
    let most = advised.work?;
    let points = run(rows);
    let is_off = |r: &Row| r.outcome == Outcome::Off;
    let (row, [work, error]) = (points.iter())
        .filter(|(k, [work, _])| *work < most && is_off(&rows[*k]))
        .min_by(|a, b| a.1[1].total_cmp(&b.1[1]))
        .map(|(k, point)| (&rows[*k], point))?;
    let within = match *error <= 100.0 * search.wish.tolerance {
        true => ": within the tolerance, but too near to it for other motions",
        false => "",
    };
    Some(format!(
        "{} would be {} times cheaper, but is {} % off{within}",
        name(search, row),
        three(most / work),
        two(*error)
    ))
}

/// The cheapest of what is right by luck and costs less.
fn lucky(search: &Search, rows: &[Row], advised: &Row) -> Option<String> {
    let work = |r: &Row| r.work.unwrap_or(f64::INFINITY);
    let row = (rows.iter())
        .filter(|r| r.outcome == Outcome::Luck && work(r) < work(advised))
        .min_by(|a, b| work(a).total_cmp(&work(b)))?;
    Some(format!(
        "{} would be {} times cheaper and is {} off, but by luck: the full law on its mesh and element is off by more than the tolerance",
        name(search, row),
        three(work(advised) / work(row)),
        percent(row.off.unwrap_or_default().most())
    ))
}

fn nearest(search: &Search, rows: &[Row], wanted: &str) -> String {
    let slow = rows.iter().filter(|r| r.outcome == Outcome::Slow);
    let time = |r: &&Row| r.step_99.unwrap_or(f64::INFINITY);
    if let Some(row) = slow.min_by(|a, b| time(a).total_cmp(&time(b))) {
        return format!(
            "none for {wanted}; the nearest is {}: {} off, but 99 % of its steps take up to {} us of {} us",
            name(search, row),
            percent(row.off.unwrap_or_default().most()),
            three(time(&row)),
            three(1e6 / search.wish.rate)
        );
    }
    let off = |r: &Row| r.off.map_or(f64::INFINITY, |o| o.most());
    match rows.iter().min_by(|a, b| off(a).total_cmp(&off(b))) {
        Some(row) if off(row).is_finite() => {
            let found = row.off.unwrap_or_default();
            let (of, measure) = match found.force > found.surface {
                true => (found.force, "force"),
                false => (found.surface, "surface"),
            };
            let mesh = search.off_of_mesh().most();
            let because = match mesh > MARGIN * search.wish.tolerance {
                true => format!(
                    "the mesh is too coarse: on it the full law itself is {} off; refine it, or ask with --same-mesh what the model alone is off by",
                    percent(mesh)
                ),
                false => format!(
                    "no more than {} is advised, so that motions like this one are within the tolerance, too",
                    percent(MARGIN * search.wish.tolerance)
                ),
            };
            format!(
                "none for {wanted}; the nearest is {}: its {measure} is {} off, because {because}",
                name(search, row),
                percent(of)
            )
        }
        _ => format!("none for {wanted}: no setting runs this motion to its end"),
    }
}

/// A row a candidate.
pub fn csv(search: &Search, rows: &[Row], advised: Option<usize>) -> String {
    let mut text = String::from(
        "setting,family,size,tetrahedra,dynamicTetrahedra,substeps,predicted_kflop,work_kflop,stepMedian_us,step99_us,forceError_percent,surfaceError_percent,worstForceError_percent,worstSurfaceError_percent,outcome,advised\n",
    );
    for (k, row) in rows.iter().enumerate() {
        let grid = &search.places[row.grid].grid;
        let number = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.6}"));
        let hundred = |v: Option<f64>| number(v.map(|v| 100.0 * v));
        let (own, off) = (row.own, row.off);
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
            quoted(row.setting.name),
            row.setting.family.name(),
            grid.label(),
            grid.mesh.tetrahedra.len(),
            row.dynamic,
            number(row.substeps),
            number(row.predicted),
            number(row.work),
            number(row.median),
            number(row.step_99),
            hundred(own.map(|o| o.force)),
            hundred(own.map(|o| o.surface)),
            hundred(off.map(|o| o.force)),
            hundred(off.map(|o| o.surface)),
            quoted(row.outcome.text()),
            advised == Some(k)
        );
    }
    text
}

fn quoted(text: &str) -> String {
    match text.contains([',', '"', '\n']) {
        true => format!("\"{}\"", text.replace('"', "\"\"").replace('\n', " ")),
        false => text.into(),
    }
}

const WIDTH: f64 = 860.0;
const LEFT: f64 = 16.0;
const PANEL: f64 = 380.0;
const HEAD: f64 = 92.0;
const LINE: f64 = 17.0;
const MARKS: [Mark; 3] = [Mark::Circle, Mark::Square, Mark::Triangle];

/// Meshes from coarse to fine: round, square, pointed.
fn shape(search: &Search, grid: usize) -> Mark {
    MARKS[(search.places.len() - 1 - grid).min(2)]
}

/// Error against work of all that was run, the tolerance, and what nothing beats, by name.
pub fn svg(search: &Search, rows: &[Row], advised: Option<usize>, title: &str) -> String {
    let points = run(rows);
    let front = best(&points);
    let scatter = Scatter {
        title: "error against work",
        x: Axis {
            label: "work, counted",
            unit: "kflop a ms",
            scale: Scale::Logarithmic,
        },
        y: Axis {
            label: "error: the larger of force and surface",
            unit: "%",
            scale: Scale::Logarithmic,
        },
        points: (points.iter())
            .map(|(k, [x, y])| Point {
                x: *x,
                y: y.max(1e-3),
                mark: shape(search, rows[*k].grid),
                color: color(rows[*k].setting.family),
            })
            .collect(),
        front: front.clone(),
        limit: None,
        floor: Some((100.0 * search.wish.tolerance, "tolerance")),
    };
    let mut body = String::new();
    let mut y = HEAD + PANEL + 18.0;
    // An advice that luck beats is on no front.
    let beside =
        (0..points.len()).find(|place| advised == Some(points[*place].0) && !front.contains(place));
    for (number, place) in front.iter().chain(&beside).enumerate() {
        let (k, [work, error]) = points[*place];
        let weight = if advised == Some(k) { "700" } else { "400" };
        let told = match &rows[k].outcome {
            _ if advised == Some(k) => ": advised",
            Outcome::Luck => ": by luck",
            Outcome::Slow => ": too slow",
            _ => "",
        };
        let number = if front.contains(place) {
            (number + 1).to_string()
        } else {
            String::new()
        };
        // Writing to a String cannot fail.
        let _ = writeln!(
            body,
            "<text x=\"{0}\" y=\"{1}\" font-weight=\"700\" text-anchor=\"end\">{2}</text>\
             <text x=\"{3}\" y=\"{1}\" font-weight=\"{weight}\">{4}</text>\
             <text x=\"{5}\" y=\"{1}\" text-anchor=\"end\" fill=\"{MUTED}\">{6} kflop, {7} µs, {8} %</text>",
            px(LEFT + 20.0),
            px(y),
            number,
            px(LEFT + 28.0),
            escape(&format!("{}{told}", name(search, &rows[k]))),
            px(WIDTH - LEFT),
            three(work),
            rows[k].median.map_or("".into(), three),
            two(error)
        );
        y += LINE;
    }
    let mut head = String::new();
    let mut x = LEFT + 5.0;
    for family in Family::ALL {
        if !points
            .iter()
            .any(|(k, _)| rows[*k].setting.family == family)
        {
            continue;
        }
        let look = format!("fill=\"{}\"", hex(color(family)));
        let _ = writeln!(
            head,
            "{}<text x=\"{}\" y=\"72\">{}</text>",
            mark(Mark::Circle, x, 68.0, 4.5, &look),
            px(x + 8.0),
            escape(family.name())
        );
        x += 24.0 + text_width(family.name(), 12.0);
    }
    x += 10.0;
    for (grid, place) in search.places.iter().enumerate().rev() {
        let look = format!("fill=\"none\" stroke=\"{INK}\" stroke-width=\"1.3\"");
        let label = place.grid.label();
        let _ = writeln!(
            head,
            "{}<text x=\"{}\" y=\"72\">{label}</text>",
            mark(shape(search, grid), x, 68.0, 4.5, &look),
            px(x + 9.0)
        );
        x += 24.0 + text_width(&label, 12.0);
    }
    let sentence = advice(search, rows, advised).swap_remove(0);
    let (w, h) = (px(WIDTH), px(y + 4.0));
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
         font-family=\"system-ui, sans-serif\" role=\"img\">\n\
         <rect width=\"{w}\" height=\"{h}\" rx=\"10\" fill=\"{CARD}\"/>\n\
         <text x=\"{0}\" y=\"26\" font-size=\"16\" font-weight=\"600\" fill=\"{INK}\">Advice: {1}</text>\n\
         <text x=\"{0}\" y=\"45\" font-size=\"12\" fill=\"{MUTED}\">{2}</text>\n\
         <g font-size=\"12\" fill=\"{INK}\">\n{head}</g>\n\
         <g transform=\"translate({3} {4})\">\n{5}</g>\n<g font-size=\"12\" fill=\"{INK}\">\n{body}</g>\n</svg>\n",
        px(LEFT),
        escape(title),
        escape(&short(&sentence).replace(" us ", " µs ")),
        px(LEFT - 8.0),
        px(HEAD),
        scatter.group(WIDTH - 2.0 * LEFT + 16.0, PANEL)
    )
}

/// A scene as a file: a key a line, so that it can be read and compared.
pub fn scene(scene: &Scene) -> Result<String, serde_json::Error> {
    let value = serde_json::to_value(scene)?;
    let keys = [
        "name",
        "description",
        "mesh",
        "materials",
        "fixed",
        "prescribed",
        "loads",
        "gravity",
        "start",
        "model",
        "integration",
        "cutting",
        "cuts",
        "tearing",
        "tools",
        "outputs",
    ];
    let lines: Vec<String> = (keys.iter())
        .filter_map(|key| Some((key, value.get(key)?)))
        .map(|(key, value)| format!("  \"{key}\": {value}"))
        .collect();
    Ok(format!("{{\n{}\n}}\n", lines.join(",\n")))
}

/// Where a mesh file is, when the scene moves to another folder.
pub fn moved(scene: &mut Scene, from: &std::path::Path) {
    if let MeshSource::File { file, .. } = &mut scene.mesh {
        let whole = from.join(&*file);
        *file = whole.canonicalize().unwrap_or(whole).display().to_string();
    }
}

#[cfg(test)]
mod tests {
    /// No key of a scene is forgotten.
    #[test]
    fn scenes_are_written_whole() {
        let text = include_str!("../../../examples/torn_cylinder.json");
        let scene = tissue::scene::parse(text, "a").unwrap();
        let again = super::scene(&scene).unwrap();
        assert_eq!(tissue::scene::parse(&again, "b").unwrap(), scene);
        let text = include_str!("../../../examples/hybrid_liver.json");
        let scene = tissue::scene::parse(text, "a").unwrap();
        let again = super::scene(&scene).unwrap();
        assert_eq!(tissue::scene::parse(&again, "b").unwrap(), scene);
    }
}
