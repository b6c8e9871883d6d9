//! Points of two magnitudes on logarithmic axes, the best of them numbered and joined.

use std::fmt::Write;

use super::chart::{Axis, CARD, GRID, INK, MARK, MUTED, Range, power_label};
use super::svg::{escape, hex, px, text_width};

const LEFT: f64 = 50.0;
const RIGHT: f64 = 10.0;
const BOTTOM: f64 = 42.0;
/// Size of a mark in px: about its radius.
const SIZE: f64 = 4.0;
/// Room round the points, in decades.
const PAD: f64 = 0.12;

/// Shape of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    Circle,
    Square,
    Triangle,
}

#[derive(Clone, Copy, Debug)]
pub struct Point {
    pub x: f64,
    pub y: f64,
    pub mark: Mark,
    pub color: [u8; 3],
}

#[derive(Clone, Debug)]
pub struct Scatter<'a> {
    pub title: &'a str,
    /// Both logarithmic.
    pub x: Axis<'a>,
    pub y: Axis<'a>,
    /// Ones that are not positive are left out.
    pub points: Vec<Point>,
    /// Of the points, from left to right: numbered from 1 and joined by steps.
    pub front: Vec<usize>,
    /// A vertical line, where it is in range.
    pub limit: Option<(f64, &'a str)>,
    /// A horizontal one below which differences mean nothing.
    pub floor: Option<(f64, &'a str)>,
}

/// Of up to `most` decades also the twos and fives.
fn ticks(range: &Range, most: f64) -> Vec<(f64, String)> {
    let factors: &[f64] = match range.high - range.low {
        span if span < 0.4 * most => &[1.0, 2.0, 5.0],
        _ => &[1.0],
    };
    let mut ticks = Vec::new();
    for decade in range.low.floor() as i32..=range.high.ceil() as i32 {
        for value in factors.iter().map(|f| f * 10.0_f64.powi(decade)) {
            if (range.low..=range.high).contains(&value.log10()) {
                let label = match decade {
                    -4..0 => format!("{value:.*}", -decade as usize),
                    _ => power_label(value),
                };
                ticks.push((value, label));
            }
        }
    }
    ticks
}

struct Frame {
    right: f64,
    top: f64,
    bottom: f64,
    x: Range,
    y: Range,
}

impl Frame {
    fn at(&self, x: f64, y: f64) -> [f64; 2] {
        let share = |v: f64, range: &Range| (v.log10() - range.low) / (range.high - range.low);
        [
            LEFT + (self.right - LEFT) * share(x, &self.x),
            self.bottom - (self.bottom - self.top) * share(y, &self.y),
        ]
    }
}

impl Scatter<'_> {
    /// SVG elements in a box of `width` by `height` px at the origin.
    pub fn group(&self, width: f64, height: f64) -> String {
        let padded = |mut range: Range| {
            range.low -= PAD;
            range.high += PAD;
            range
        };
        let floor = self.floor.map(|(y, _)| y).filter(|y| *y > 0.0);
        let values = |of: fn(&Point) -> f64| self.points.iter().map(of);
        let low = values(|p| p.y).fold(f64::INFINITY, f64::min);
        // A floor far below the points is not drawn.
        let floor = floor.filter(|y| *y > 0.2 * low);
        let frame = Frame {
            right: width - RIGHT,
            top: 36.0,
            bottom: height - BOTTOM,
            x: padded(Range::tight(values(|p| p.x), self.x.scale)),
            y: padded(Range::tight(values(|p| p.y).chain(floor), self.y.scale)),
        };
        let mut svg = String::new();
        // Writing to a String cannot fail.
        let _ = self.axes(&mut svg, &frame);
        let _ = self.lines(&mut svg, &frame, floor);
        let _ = self.marks(&mut svg, &frame);
        let _ = self.numbers(&mut svg, &frame);
        svg
    }

    fn axes(&self, svg: &mut String, frame: &Frame) -> std::fmt::Result {
        let (left, right) = (px(LEFT), px(frame.right));
        let (top, bottom) = (px(frame.top), px(frame.bottom));
        writeln!(
            svg,
            "<text x=\"{left}\" y=\"14\" font-size=\"13\" font-weight=\"600\" fill=\"{INK}\">{}</text>\n\
             <g font-size=\"11\" fill=\"{MUTED}\">",
            escape(self.title)
        )?;
        let narrow = (frame.right - LEFT) / 60.0;
        for (value, label) in ticks(&frame.x, narrow.max(2.0)) {
            let x = px(frame.at(value, 1.0)[0]);
            writeln!(
                svg,
                "<path d=\"M{x} {top}V{bottom}\" stroke=\"{GRID}\"/><text x=\"{x}\" y=\"{}\" text-anchor=\"middle\">{label}</text>",
                px(frame.bottom + 15.0)
            )?;
        }
        for (value, label) in ticks(&frame.y, 6.0) {
            let y = frame.at(1.0, value)[1];
            writeln!(
                svg,
                "<path d=\"M{left} {0}H{right}\" stroke=\"{GRID}\"/><text x=\"{1}\" y=\"{2}\" text-anchor=\"end\">{label}</text>",
                px(y),
                px(LEFT - 6.0),
                px(y + 4.0)
            )?;
        }
        writeln!(
            svg,
            "<path d=\"M{left} {top}V{bottom}H{right}\" fill=\"none\" stroke=\"{MARK}\"/>\n\
             <text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>\n\
             <text transform=\"translate(12 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>\n</g>",
            px((LEFT + frame.right) / 2.0),
            px(frame.bottom + 33.0),
            self.x.caption(),
            px((frame.top + frame.bottom) / 2.0),
            self.y.caption()
        )
    }

    fn lines(&self, svg: &mut String, frame: &Frame, floor: Option<f64>) -> std::fmt::Result {
        let (top, bottom) = (px(frame.top), px(frame.bottom));
        if let Some((x, label)) = self.limit
            && (frame.x.low..frame.x.high).contains(&x.log10())
        {
            let x = frame.at(x, 1.0)[0];
            writeln!(
                svg,
                "<path d=\"M{0} {top}V{bottom}\" stroke=\"{MARK}\" stroke-dasharray=\"4 3\"/>\
                 <text x=\"{1}\" y=\"{2}\" font-size=\"11\" fill=\"{MUTED}\" text-anchor=\"middle\" stroke=\"{CARD}\" stroke-width=\"3\" stroke-linejoin=\"round\" paint-order=\"stroke\">{3}</text>",
                px(x),
                px(x),
                px(frame.top - 5.0),
                escape(label)
            )?;
        }
        if let (Some(y), Some((_, label))) = (floor, self.floor) {
            let y = frame.at(1.0, y)[1];
            writeln!(
                svg,
                "<path d=\"M{LEFT} {0}H{1}\" stroke=\"{MARK}\" stroke-dasharray=\"1 3\"/>\
                 <text x=\"{2}\" y=\"{3}\" font-size=\"11\" fill=\"{MUTED}\" stroke=\"{CARD}\" stroke-width=\"3\" stroke-linejoin=\"round\" paint-order=\"stroke\">{4}</text>",
                px(y),
                px(frame.right),
                px(LEFT + 5.0),
                px(y - 4.0),
                escape(label)
            )?;
        }
        // To the right and up of it everything is beaten.
        let mut path = String::new();
        for (k, at) in self.on_front(frame).into_iter().enumerate() {
            let [x, y] = at.map(px);
            match k {
                0 => write!(path, "M{x} {top}V{y}")?,
                _ => write!(path, "H{x}V{y}")?,
            }
        }
        if !path.is_empty() {
            write!(path, "H{}", px(frame.right))?;
            writeln!(
                svg,
                "<path d=\"{path}\" fill=\"none\" stroke=\"{INK}\" stroke-width=\"1.5\" stroke-linejoin=\"round\"/>"
            )?;
        }
        Ok(())
    }

    fn on_front(&self, frame: &Frame) -> Vec<[f64; 2]> {
        let point = |k: &usize| &self.points[*k];
        self.front
            .iter()
            .map(point)
            .map(|p| frame.at(p.x, p.y))
            .collect()
    }

    fn shown(&self) -> impl Iterator<Item = (usize, &Point)> {
        let positive = |v: f64| v > 0.0 && v.is_finite();
        let points = self.points.iter().enumerate();
        points.filter(move |(_, p)| positive(p.x) && positive(p.y))
    }

    /// Those on the front last, so that none covers them.
    fn marks(&self, svg: &mut String, frame: &Frame) -> std::fmt::Result {
        for first in [true, false] {
            for (k, p) in self.shown() {
                let best = self.front.contains(&k);
                if best == first {
                    continue;
                }
                let [x, y] = frame.at(p.x, p.y);
                let s = if best { SIZE + 1.0 } else { SIZE };
                let look = match best {
                    true => format!(
                        "fill=\"{}\" stroke=\"{INK}\" stroke-width=\"1.2\"",
                        hex(p.color)
                    ),
                    false => format!(
                        "fill=\"{}\" fill-opacity=\"0.7\" stroke=\"{CARD}\" stroke-width=\"0.8\"",
                        hex(p.color)
                    ),
                };
                writeln!(svg, "{}", mark(p.mark, x, y, s, &look))?;
            }
        }
        Ok(())
    }

    /// Each beside its point, where it covers neither a mark nor another number.
    fn numbers(&self, svg: &mut String, frame: &Frame) -> std::fmt::Result {
        let marks: Vec<[f64; 2]> = self.shown().map(|(_, p)| frame.at(p.x, p.y)).collect();
        let mut taken: Vec<[f64; 2]> = Vec::new();
        for (k, [x, y]) in self.on_front(frame).into_iter().enumerate() {
            let number = (k + 1).to_string();
            let half = 0.5 * text_width(&number, 12.0);
            let places = (0..48).map(|i| {
                let (turn, far) = (f64::from(i % 12), f64::from(i / 12));
                let angle = (7.5 + turn) * std::f64::consts::TAU / 12.0;
                let radius = 13.0 + 7.0 * far;
                ([x + radius * angle.cos(), y + radius * angle.sin()], far)
            });
            let cost = |[cx, cy]: [f64; 2], far: f64| {
                let gap = |p: &[f64; 2], want: f64| {
                    let (dx, dy) = ((p[0] - cx).abs() - half, p[1] - cy);
                    (want - dx.max(0.0).hypot(dy)).max(0.0)
                };
                let outside = cx < LEFT + half + 2.0
                    || cx > frame.right - half - 2.0
                    || cy < frame.top + 6.0
                    || cy > frame.bottom - 7.0;
                let covered: f64 = marks.iter().map(|p| gap(p, 11.0)).sum();
                let crowded: f64 = taken.iter().map(|p| 20.0 * gap(p, 15.0)).sum();
                covered + crowded + 2.0 * far + if outside { 1e3 } else { 0.0 }
            };
            let best = places
                .map(|(at, far)| (cost(at, far), at, far))
                .reduce(|best, next| if next.0 < best.0 - 1e-9 { next } else { best });
            let Some((_, at, far)) = best else {
                continue;
            };
            taken.push(at);
            if far > 0.0 {
                writeln!(
                    svg,
                    "<path d=\"M{} {}L{} {}\" stroke=\"{INK}\" stroke-width=\"0.7\"/>",
                    px(x),
                    px(y),
                    px(at[0]),
                    px(at[1])
                )?;
            }
            writeln!(
                svg,
                "<text x=\"{}\" y=\"{}\" font-size=\"12\" font-weight=\"700\" text-anchor=\"middle\" fill=\"{INK}\" \
                 stroke=\"{CARD}\" stroke-width=\"3.5\" stroke-linejoin=\"round\" paint-order=\"stroke\">{number}</text>",
                px(at[0]),
                px(at[1] + 4.3)
            )?;
        }
        Ok(())
    }
}

/// A mark of radius `s` px with the attributes `look`.
pub fn mark(mark: Mark, x: f64, y: f64, s: f64, look: &str) -> String {
    match mark {
        Mark::Circle => format!(
            "<circle cx=\"{}\" cy=\"{}\" r=\"{}\" {look}/>",
            px(x),
            px(y),
            px(s)
        ),
        Mark::Square => {
            let a = 0.88 * s;
            let (x, y, side) = (px(x - a), px(y - a), px(2.0 * a));
            format!("<rect x=\"{x}\" y=\"{y}\" width=\"{side}\" height=\"{side}\" {look}/>")
        }
        Mark::Triangle => {
            let (a, up, down) = (1.15 * s, y - 1.2 * s, y + 0.8 * s);
            let corner = |x: f64, y: f64| format!("{} {}", px(x), px(y));
            format!(
                "<path d=\"M{}L{}L{}Z\" {look}/>",
                corner(x, up),
                corner(x + a, down),
                corner(x - a, down)
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::chart::Scale;
    use super::*;

    fn scatter(points: &[[f64; 2]], front: Vec<usize>) -> String {
        let axis = |label| Axis {
            label,
            unit: "us",
            scale: Scale::Logarithmic,
        };
        let point = |p: &[f64; 2]| Point {
            x: p[0],
            y: p[1],
            mark: Mark::Triangle,
            color: [1, 2, 3],
        };
        Scatter {
            title: "a <b>",
            x: axis("x"),
            y: axis("y"),
            points: points.iter().map(point).collect(),
            front,
            limit: Some((1000.0, "1 ms")),
            floor: Some((0.5, "reference")),
        }
        .group(300.0, 250.0)
    }

    #[test]
    fn hard_points_give_finite_coordinates() {
        let hard = [[f64::NAN, 1.0], [0.0, 2.0], [1.0, -1.0], [5.0, 5.0]];
        for points in [&hard[..], &hard[..2], &[], &[[3.0, 3.0]; 4]] {
            let svg = scatter(points, Vec::new());
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            assert!(svg.contains("a &lt;b&gt;"));
        }
    }

    /// As many numbers as there are points on the front, far enough apart to be read.
    #[test]
    fn numbers_do_not_lie_on_each_other() {
        let points: Vec<[f64; 2]> = (0..9)
            .map(|k| [10.0 + 0.3 * f64::from(k), 9.0 - 0.2 * f64::from(k)])
            .chain([[1000.0, 0.1], [1.0, 100.0]])
            .collect();
        let svg = scatter(&points, (0..9).collect());
        let places: Vec<[f64; 2]> = svg
            .lines()
            .filter(|l| l.contains("font-weight=\"700\""))
            .map(|l| {
                let number = |key: &str| -> f64 {
                    let from = l.find(key).unwrap() + key.len();
                    l[from..].split('"').next().unwrap().parse().unwrap()
                };
                [number(" x=\""), number(" y=\"")]
            })
            .collect();
        assert_eq!(places.len(), 9);
        for (i, a) in places.iter().enumerate() {
            for b in &places[..i] {
                assert!((a[0] - b[0]).hypot(a[1] - b[1]) > 10.0, "{a:?} {b:?}");
            }
        }
    }
}
