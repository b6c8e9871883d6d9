//! A map as a sheet of cells, coloured by outcome, its region outlined.

use std::fmt::Write;

use super::maps::{Cell, Found, MapRow, Outcome};
use crate::picture::chart::{CARD, INK, MUTED};
use crate::picture::svg::{escape, px, text_width};

const WIDTH: f64 = 1000.0;
const MARGIN: f64 = 16.0;
const HEAD: f64 = 116.0;
/// Between panels in px.
const GAP: f64 = 16.0;
const CELL: f64 = 26.0;
const TICK: f64 = 11.0;
/// Cells that are narrower carry no number.
const ROOM: f64 = 34.0;

fn fill(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Stable => "#bfe3d3",
        Outcome::Halved => "#a9cdea",
        Outcome::Discarded => "#f3cf8e",
        Outcome::Refused => "#d5d8dd",
        Outcome::Failed => "#e58e6a",
    }
}

fn sentence(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Stable => "stable as asked",
        Outcome::Halved => "stable, substep halved",
        Outcome::Discarded => "step discarded, state kept",
        Outcome::Refused => "scene refused",
        Outcome::Failed => "failed",
    }
}

/// What a viewer shows of a cell that is pointed at.
fn tip(cell: &Cell) -> String {
    match cell.symptom.as_str() {
        "" => String::new(),
        symptom => format!("<title>{}</title>", escape(symptom)),
    }
}

/// Two or three digits, as short as can be.
fn short(value: f64) -> String {
    let text = match value.abs() {
        a if a >= 1000.0 => format!("{value:.0e}"),
        a if a >= 10.0 => format!("{value:.0}"),
        a if a >= 1.0 => format!("{value:.1}"),
        a if a >= 0.01 => format!("{value:.2}"),
        0.0 => "0".into(),
        a if a < 5e-7 => "~0".into(),
        _ => format!("{value:.0e}"),
    };
    match text.as_str() {
        "-0.00" | "0.00" => "0".into(),
        _ => text,
    }
}

/// One map as an SVG file.
pub fn svg(map: &MapRow, found: &[Found], quick: bool) -> String {
    let (xs, ys) = (map.x.places(quick), map.y.places(quick));
    let names: Vec<String> = ys.iter().map(|y| map.y.name(*y)).collect();
    let widest = names
        .iter()
        .map(|n| text_width(n, TICK))
        .fold(0.0, f64::max);
    let left = MARGIN + 20.0 + widest + 8.0;
    let columns = map.columns as f64;
    let wide = ((WIDTH - left - MARGIN + GAP) / columns - GAP) / xs.len() as f64;
    let wide = wide.min(150.0);
    let tall = ys.len() as f64 * CELL;
    let panel_height = 22.0 + tall + 44.0;
    let rows = map.panels.len().div_ceil(map.columns);
    let height = HEAD + rows as f64 * panel_height;
    let mut text = head(map, found, height);
    for (panel, name) in map.panels.iter().enumerate() {
        let column = panel % map.columns;
        let x0 = left + column as f64 * (xs.len() as f64 * wide + GAP);
        let y0 = HEAD + 22.0 + (panel / map.columns) as f64 * panel_height;
        // The first value is lowest.
        let place = |x: usize, y: usize| {
            let row = (ys.len() - 1 - y) as f64;
            (x0 + x as f64 * wide, y0 + row * CELL)
        };
        let at = |x: usize, y: usize| -> Option<&Cell> {
            let is = |f: &&Found| (f.panel, f.x, f.y) == (panel, xs[x], ys[y]);
            found.iter().find(is).map(|f| &f.cell)
        };
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "<text x=\"{}\" y=\"{}\" font-size=\"{}\" font-weight=\"600\" fill=\"{INK}\">{}</text>",
            px(x0),
            px(y0 - 8.0),
            if map.columns > 2 { 11 } else { 12 },
            escape(name)
        );
        let _ = writeln!(text, "<g stroke=\"{CARD}\">");
        let mut outline = String::new();
        let mut numbers = String::new();
        for y in 0..ys.len() {
            for x in 0..xs.len() {
                let Some(cell) = at(x, y) else { continue };
                let (cx, cy) = place(x, y);
                let _ = writeln!(
                    text,
                    "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"{}\">{}</rect>",
                    px(cx),
                    px(cy),
                    px(wide),
                    px(CELL),
                    fill(cell.outcome),
                    tip(cell)
                );
                if let Some(value) = cell
                    .value
                    .filter(|_| wide >= ROOM && !map.measure.is_empty())
                {
                    let _ = writeln!(
                        numbers,
                        "<text x=\"{}\" y=\"{}\">{}</text>",
                        px(cx + 0.5 * wide),
                        px(cy + 0.5 * CELL + 4.0),
                        short(value)
                    );
                }
                if !cell.safe {
                    continue;
                }
                let safe = |x: Option<usize>, y: Option<usize>| {
                    let inside = x.zip(y).filter(|(x, y)| *x < xs.len() && *y < ys.len());
                    inside.and_then(|(x, y)| at(x, y)).is_some_and(|c| c.safe)
                };
                let sides = [
                    (x.checked_sub(1), Some(y), [0.0, 0.0, 0.0, CELL]),
                    (Some(x + 1), Some(y), [wide, 0.0, wide, CELL]),
                    (Some(x), Some(y + 1), [0.0, 0.0, wide, 0.0]),
                    (Some(x), y.checked_sub(1), [0.0, CELL, wide, CELL]),
                ];
                for (nx, ny, [ax, ay, bx, by]) in sides {
                    if !safe(nx, ny) {
                        let _ = write!(
                            outline,
                            "M{} {}L{} {}",
                            px(cx + ax),
                            px(cy + ay),
                            px(cx + bx),
                            px(cy + by)
                        );
                    }
                }
            }
        }
        let _ = writeln!(
            text,
            "</g>\n<g font-size=\"{TICK}\" text-anchor=\"middle\" fill=\"{INK}\">\n{numbers}</g>"
        );
        if !outline.is_empty() {
            let _ = writeln!(
                text,
                "<path d=\"{outline}\" fill=\"none\" stroke=\"{INK}\" stroke-width=\"2.2\" stroke-linecap=\"square\"/>"
            );
        }
        let _ = writeln!(text, "<g font-size=\"{TICK}\" fill=\"{MUTED}\">");
        let mut free = f64::NEG_INFINITY;
        for (k, x) in xs.iter().enumerate() {
            let name = map.x.name(*x);
            let (middle, half) = (place(k, 0).0 + 0.5 * wide, 0.5 * text_width(&name, TICK));
            if middle - half < free {
                continue;
            }
            free = middle + half + 4.0;
            let _ = writeln!(
                text,
                "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                px(middle),
                px(y0 + tall + 14.0),
                escape(&name)
            );
        }
        let _ = writeln!(
            text,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\" fill=\"{INK}\">{}</text>",
            px(x0 + 0.5 * wide * xs.len() as f64),
            px(y0 + tall + 30.0),
            escape(map.x.label)
        );
        if column == 0 {
            for (k, name) in names.iter().enumerate() {
                let _ = writeln!(
                    text,
                    "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>",
                    px(x0 - 6.0),
                    px(place(0, k).1 + 0.5 * CELL + 4.0),
                    escape(name)
                );
            }
            let (lx, ly) = (px(MARGIN + 8.0), px(y0 + 0.5 * tall));
            let _ = writeln!(
                text,
                "<text x=\"{lx}\" y=\"{ly}\" transform=\"rotate(-90 {lx} {ly})\" text-anchor=\"middle\" fill=\"{INK}\">{}</text>",
                escape(map.y.label)
            );
        }
        text += "</g>\n";
    }
    text + "</svg>\n"
}

fn head(map: &MapRow, found: &[Found], height: f64) -> String {
    let (w, h) = (px(WIDTH), px(height));
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
         font-family=\"system-ui, sans-serif\" role=\"img\">\n\
         <rect width=\"{w}\" height=\"{h}\" rx=\"10\" fill=\"{CARD}\"/>\n"
    );
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "<text x=\"{0}\" y=\"26\" font-size=\"16\" font-weight=\"600\" fill=\"{INK}\">{1}</text>\n\
         <text x=\"{0}\" y=\"45\" font-size=\"12\" fill=\"{MUTED}\">{2}</text>\n\
         <g font-size=\"12\" fill=\"{INK}\">",
        px(MARGIN),
        escape(map.title),
        escape(map.sentence)
    );
    let mut x = MARGIN;
    let there = |o: &Outcome| found.iter().any(|f| f.cell.outcome == *o);
    for outcome in Outcome::ALL.into_iter().filter(there) {
        let name = match outcome {
            Outcome::Failed => format!("failed: {}", map.failed),
            _ => sentence(outcome).to_string(),
        };
        let _ = writeln!(
            text,
            "<rect x=\"{}\" y=\"58\" width=\"14\" height=\"12\" fill=\"{}\"/><text x=\"{}\" y=\"68\">{}</text>",
            px(x),
            fill(outcome),
            px(x + 19.0),
            escape(&name)
        );
        x += 42.0 + text_width(&name, 12.0);
    }
    let _ = writeln!(
        text,
        "<rect x=\"{}\" y=\"80\" width=\"13\" height=\"11\" fill=\"none\" stroke=\"{INK}\" stroke-width=\"2.2\"/><text x=\"{}\" y=\"90\">{}</text>",
        px(MARGIN + 1.0),
        px(MARGIN + 19.0),
        escape(map.region)
    );
    if !map.measure.is_empty() {
        let _ = writeln!(
            text,
            "<text x=\"{}\" y=\"90\" text-anchor=\"end\" fill=\"{MUTED}\">numbers: {}</text>",
            px(WIDTH - MARGIN),
            escape(map.measure)
        );
    }
    text + "</g>\n"
}

#[cfg(test)]
mod tests {
    use super::super::maps::MAPS;
    use super::*;

    /// With all outcomes in the key, and beside the region the measure.
    #[test]
    fn heads_fit() {
        for map in &MAPS {
            let names = Outcome::ALL.map(|o| match o {
                Outcome::Failed => format!("failed: {}", map.failed),
                _ => sentence(o).to_string(),
            });
            let wide = |name: &String| 42.0 + text_width(name, 12.0);
            // All five are in the map of substeps alone.
            let shown = if map.name == "substep" { 0 } else { 2 };
            let key: f64 = names[shown..].iter().map(wide).sum();
            assert!(MARGIN + key - 23.0 < WIDTH, "{}: {key}", map.name);
            let below = text_width(map.region, 12.0) + text_width(map.measure, 12.0) + 60.0;
            assert!(below + 3.0 * MARGIN < WIDTH, "{}: {below}", map.name);
            let sentence = text_width(map.sentence, 12.0);
            assert!(sentence + 2.0 * MARGIN < WIDTH, "{}: {sentence}", map.name);
        }
    }

    #[test]
    fn numbers_are_short() {
        let cases = [
            (775.87, "776"),
            (0.0, "0"),
            (-0.101, "-0.10"),
            (2.5e-4, "3e-4"),
            (1.36, "1.4"),
        ];
        for (value, text) in cases {
            assert_eq!(short(value), text);
        }
    }
}
