//! Line and scatter charts as SVG: nice ticks, direct labels, event marks, its own light card.

use super::svg::{escape, hex, px, text_width};
use std::fmt::Write;

/// Okabe and Ito's colours for all kinds of colour vision, darkened where text needs contrast.
pub const PALETTE: [[u8; 3]; 7] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 140, 105],
    [170, 68, 153],
    [176, 122, 0],
    [40, 140, 190],
    [60, 64, 72],
];

pub const INK: &str = "#1d2430";
pub const MUTED: &str = "#5b6472";
pub const CARD: &str = "#fcfcfb";
pub(super) const GRID: &str = "#e4e6ea";
pub(super) const MARK: &str = "#8a93a1";
const TEXT: f64 = 13.0;
/// Height of a row of event labels in px.
const ROW: f64 = 17.0;
/// Least room right of the plot in px: half a tick label.
const NARROW: f64 = 16.0;
/// Values beyond are left out, so that differences of two stay finite.
const HUGE: f64 = 1e300;
const LEFT: f64 = 62.0;
const BOTTOM: f64 = 46.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(dead_code)] // a choice of two, whichever the commands draw
pub enum Scale {
    Linear,
    /// Values that are not positive are left out.
    Logarithmic,
}

#[derive(Clone, Copy, Debug)]
pub struct Axis<'a> {
    pub label: &'a str,
    /// Empty: without unit.
    pub unit: &'a str,
    pub scale: Scale,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(dead_code)] // a choice of three, whichever the commands draw
pub enum Style {
    Line,
    Markers,
    LineAndMarkers,
}

#[derive(Clone, Debug)]
pub struct Series<'a> {
    pub name: &'a str,
    /// A non-finite value breaks the line.
    pub points: Vec<[f64; 2]>,
    pub style: Style,
    pub color: [u8; 3],
}

/// A vertical mark at `x` with a label above the plot.
#[derive(Clone, Copy, Debug)]
pub struct Event<'a> {
    pub x: f64,
    pub label: &'a str,
}

#[derive(Clone, Debug)]
pub struct Chart<'a> {
    /// Empty: none.
    pub title: &'a str,
    pub x: Axis<'a>,
    pub y: Axis<'a>,
    pub series: Vec<Series<'a>>,
    pub events: Vec<Event<'a>>,
    /// Numbered from 1, small discs on the x axis: where the panels of a figure stand.
    pub stations: Vec<f64>,
}

impl Chart<'_> {
    /// The chart alone, `width` by `height` px, as an SVG file.
    #[allow(dead_code)] // charts that stand alone
    pub fn svg(&self, width: f64, height: f64) -> String {
        let (width, height) = (sane(width), sane(height));
        let (w, h) = (px(width), px(height));
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"system-ui, sans-serif\" role=\"img\">\n\
             <rect width=\"{w}\" height=\"{h}\" rx=\"10\" fill=\"{CARD}\"/>\n\
             <g transform=\"translate(14 12)\">\n{}</g>\n</svg>\n",
            self.group(width - 28.0, height - 24.0)
        )
    }

    /// The chart's SVG elements, in a box of `width` by `height` px at the origin.
    pub(super) fn group(&self, width: f64, height: f64) -> String {
        let name = |s: &Series| text_width(s.name, TEXT) + 18.0;
        let room = self
            .series
            .iter()
            .map(name)
            .fold(NARROW, f64::max)
            .min(0.3 * width);
        let mut plot = self.layout(width, height, room);
        let mut names = self.names(&plot);
        if !names.iter().any(|(_, rect)| rect.at_end) {
            plot = self.layout(width, height, NARROW);
            names = self.names(&plot);
        }
        let mut svg = String::new();
        // Writing to a String cannot fail.
        let _ = self.axes(&mut svg, &plot);
        let _ = self.event_marks(&mut svg, &plot);
        let _ = self.curves(&mut svg, &plot);
        let _ = self.labels(&mut svg, &names);
        let _ = self.station_discs(&mut svg, &plot);
        svg
    }

    fn layout(&self, width: f64, height: f64, room: f64) -> Plot {
        let points = || self.series.iter().flat_map(|s| &s.points);
        let x = Range::tight(points().map(|p| p[0]), self.x.scale);
        let heading = if self.title.is_empty() { 4.0 } else { 28.0 };
        let mut plot = Plot {
            left: LEFT,
            right: (width - room).max(LEFT + 1.0),
            room,
            top: heading,
            bottom: (height - BOTTOM).max(heading + 1.0),
            x,
            y: x,
        };
        plot.x.reach_near_tick(plot.x_ticks());
        let rows = self.event_rows(&plot);
        let highest = rows.iter().map(|&(_, row)| row + 1).max().unwrap_or(0);
        plot.top = (heading + 6.0 + ROW * f64::from(highest)).min(plot.bottom - 1.0);
        plot.y = Range::rounded(points().map(|p| p[1]), self.y.scale, plot.y_ticks());
        plot
    }

    fn axes(&self, svg: &mut String, plot: &Plot) -> std::fmt::Result {
        let Plot {
            left,
            right,
            top,
            bottom,
            ..
        } = *plot;
        if !self.title.is_empty() {
            writeln!(
                svg,
                "<text x=\"0\" y=\"14\" font-size=\"15\" font-weight=\"600\" fill=\"{INK}\">{}</text>",
                escape(self.title)
            )?;
        }
        writeln!(svg, "<g font-size=\"12\" fill=\"{MUTED}\">")?;
        for (value, label) in plot.y.ticks(plot.y_ticks()) {
            let y = plot.at_y(value);
            let zero = self.y.scale == Scale::Linear && value == 0.0;
            let stroke = if zero { MARK } else { GRID };
            writeln!(
                svg,
                "<path d=\"M{} {}H{}\" stroke=\"{stroke}\"/><text x=\"{}\" y=\"{}\" text-anchor=\"end\">{label}</text>",
                px(left),
                px(y),
                px(right),
                px(left - 8.0),
                px(y + 4.0),
            )?;
        }
        for (value, label) in plot.x.ticks(plot.x_ticks()) {
            let x = plot.at_x(value);
            writeln!(
                svg,
                "<path d=\"M{0} {1}v5\" stroke=\"{MARK}\"/><text x=\"{0}\" y=\"{2}\" text-anchor=\"middle\">{label}</text>",
                px(x),
                px(bottom),
                px(bottom + 19.0),
            )?;
            if self.x.scale == Scale::Logarithmic {
                writeln!(
                    svg,
                    "<path d=\"M{} {}V{}\" stroke=\"{GRID}\"/>",
                    px(x),
                    px(top),
                    px(bottom)
                )?;
            }
        }
        writeln!(
            svg,
            "<path d=\"M{} {}H{}\" stroke=\"{MARK}\"/>\n<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>\n\
             <text transform=\"translate(14 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>\n</g>",
            px(left),
            px(bottom),
            px(right),
            px((left + right) / 2.0),
            px(bottom + 40.0),
            self.x.caption(),
            px((top + bottom) / 2.0),
            self.y.caption(),
        )
    }

    /// The row of each event's label, counted up from the plot, with the event's place in px.
    ///
    /// From right to left, each label lies above every later event whose line it would cross.
    fn event_rows(&self, plot: &Plot) -> Vec<(Placed, u32)> {
        let mut order: Vec<usize> = (0..self.events.len())
            .filter(|&i| plot.x.holds(self.events[i].x))
            .collect();
        order.sort_by(|&a, &b| self.events[b].x.total_cmp(&self.events[a].x));
        let mut rows: Vec<(Placed, u32)> = Vec::new();
        for event in order {
            let x = plot.at_x(self.events[event].x);
            let end = x + text_width(self.events[event].label, 12.0) + 12.0;
            let crossed = rows
                .iter()
                .filter(|(later, _)| later.x < end)
                .map(|&(_, row)| row + 1);
            let row = crossed.max().unwrap_or(0);
            rows.push((Placed { event, x }, row));
        }
        rows
    }

    fn event_marks(&self, svg: &mut String, plot: &Plot) -> std::fmt::Result {
        writeln!(svg, "<g font-size=\"12\" fill=\"{INK}\">")?;
        for (placed, row) in self.event_rows(plot) {
            let y = plot.top - 6.0 - ROW * f64::from(row);
            writeln!(
                svg,
                "<path d=\"M{0} {1}V{2}\" stroke=\"{MARK}\" stroke-dasharray=\"3 3\"/>\
                 <circle cx=\"{0}\" cy=\"{3}\" r=\"2.5\" fill=\"{MARK}\"/>\
                 <text x=\"{4}\" y=\"{5}\">{6}</text>",
                px(placed.x),
                px(y - 4.0),
                px(plot.bottom),
                px(y - 4.0),
                px(placed.x + 6.0),
                px(y),
                escape(self.events[placed.event].label),
            )?;
        }
        writeln!(svg, "</g>")
    }

    fn curves(&self, svg: &mut String, plot: &Plot) -> std::fmt::Result {
        for series in &self.series {
            let color = hex(series.color);
            let runs = plot.runs(&series.points);
            if series.style != Style::Markers {
                let mut path = String::new();
                for run in &runs {
                    for (i, [x, y]) in thin(run).into_iter().enumerate() {
                        write!(
                            path,
                            "{}{} {}",
                            if i == 0 { 'M' } else { 'L' },
                            px(x),
                            px(y)
                        )?;
                    }
                }
                writeln!(
                    svg,
                    "<path d=\"{path}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\" \
                     stroke-linejoin=\"round\" stroke-linecap=\"round\"/>"
                )?;
            }
            if series.style != Style::Line {
                for [x, y] in runs.iter().flatten() {
                    writeln!(
                        svg,
                        "<circle cx=\"{}\" cy=\"{}\" r=\"4\" fill=\"{color}\" stroke=\"{CARD}\" stroke-width=\"1.5\"/>",
                        px(*x),
                        px(*y)
                    )?;
                }
            }
        }
        Ok(())
    }

    /// Each series' name where its curve is furthest from the others and from other names.
    fn names(&self, plot: &Plot) -> Vec<(usize, Rect)> {
        let all: Vec<Vec<[f64; 2]>> = self
            .series
            .iter()
            .map(|s| plot.runs(&s.points).concat())
            .collect();
        let marks: Vec<f64> = self
            .event_rows(plot)
            .into_iter()
            .map(|(placed, _)| placed.x)
            .collect();
        let mut names: Vec<(usize, Rect)> = Vec::new();
        for (i, series) in self.series.iter().enumerate() {
            let width = text_width(series.name, TEXT);
            let best = candidates(&all[i], width, plot)
                .into_iter()
                .map(|rect| (rect.merit(&all, i, &names, &marks), rect))
                .reduce(|best, next| if next.0 > best.0 + 1e-9 { next } else { best });
            names.extend(best.map(|(_, rect)| (i, rect)));
        }
        names
    }

    fn labels(&self, svg: &mut String, names: &[(usize, Rect)]) -> std::fmt::Result {
        for (i, rect) in names {
            let series = &self.series[*i];
            if let Some([x, y]) = rect.leader {
                writeln!(
                    svg,
                    "<path d=\"M{} {}L{} {}\" stroke=\"{}\"/>",
                    px(x),
                    px(y),
                    px(rect.left - 2.0),
                    px(rect.top + TEXT / 2.0),
                    hex(series.color)
                )?;
            }
            writeln!(
                svg,
                "<text x=\"{}\" y=\"{}\" font-size=\"{TEXT}\" font-weight=\"600\" fill=\"{}\" \
                 stroke=\"{CARD}\" stroke-width=\"4\" stroke-linejoin=\"round\" paint-order=\"stroke\">{}</text>",
                px(rect.left),
                px(rect.top + TEXT - 2.0),
                hex(series.color),
                escape(series.name)
            )?;
        }
        Ok(())
    }

    fn station_discs(&self, svg: &mut String, plot: &Plot) -> std::fmt::Result {
        for (i, &station) in self.stations.iter().enumerate() {
            if plot.x.holds(station) {
                svg.push_str(&disc(i + 1, plot.at_x(station), plot.bottom));
            }
        }
        Ok(())
    }
}

/// A numbered disc.
pub(super) fn disc(number: usize, x: f64, y: f64) -> String {
    format!(
        "<circle cx=\"{0}\" cy=\"{1}\" r=\"9\" fill=\"{INK}\" stroke=\"{CARD}\" stroke-width=\"2\"/>\
         <text x=\"{0}\" y=\"{2}\" text-anchor=\"middle\" font-size=\"11\" font-weight=\"700\" fill=\"#ffffff\">{number}</text>\n",
        px(x),
        px(y),
        px(y + 4.0)
    )
}

impl Axis<'_> {
    pub(super) fn caption(&self) -> String {
        if self.unit.is_empty() {
            escape(self.label)
        } else {
            format!("{} ({})", escape(self.label), escape(self.unit))
        }
    }
}

fn sane(length: f64) -> f64 {
    if length.is_finite() {
        length.clamp(120.0, 1e5)
    } else {
        800.0
    }
}

#[derive(Clone, Copy)]
struct Placed {
    event: usize,
    x: f64,
}

/// The interval an axis shows; of logarithms where the axis is logarithmic.
#[derive(Clone, Copy, Debug)]
pub(super) struct Range {
    pub(super) low: f64,
    pub(super) high: f64,
    scale: Scale,
}

impl Range {
    pub(super) fn tight(values: impl Iterator<Item = f64>, scale: Scale) -> Self {
        let mut low = f64::INFINITY;
        let mut high = f64::NEG_INFINITY;
        for value in values.filter_map(|v| transformed(v, scale)) {
            low = low.min(value);
            high = high.max(value);
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        // A constant, or values whose spread drowns in rounding.
        if high - low <= 1e-9 * low.abs().max(high.abs()) {
            let pad = match scale {
                Scale::Linear if low != 0.0 => 0.5 * low.abs(),
                _ => 1.0,
            };
            (low, high) = (low - pad, high + pad);
        }
        Self { low, high, scale }
    }

    /// Widened to whole ticks, and to zero where zero is near.
    fn rounded(values: impl Iterator<Item = f64>, scale: Scale, ticks: f64) -> Self {
        let mut range = Self::tight(values, scale);
        if scale == Scale::Linear {
            if range.low > 0.0 && range.low < 0.6 * range.high {
                range.low = 0.0;
            } else if range.high < 0.0 && range.high > 0.6 * range.low {
                range.high = 0.0;
            }
        }
        let step = range.step(ticks);
        range.low = (range.low / step + 1e-6).floor() * step;
        range.high = (range.high / step - 1e-6).ceil() * step;
        range
    }

    /// Ends at a tick that the values only just miss.
    fn reach_near_tick(&mut self, ticks: f64) {
        let step = self.step(ticks);
        let end = (self.high / step).ceil() * step;
        if end - self.high < 0.02 * (self.high - self.low) {
            self.high = end;
        }
    }

    fn holds(&self, value: f64) -> bool {
        transformed(value, self.scale).is_some_and(|v| (self.low..=self.high).contains(&v))
    }

    /// Distance of ticks: 1, 2 or 5 times a power of ten, at most about `count` of them.
    fn step(&self, count: f64) -> f64 {
        let rough = ((self.high - self.low) / count.max(1.0)).max(f64::MIN_POSITIVE);
        let power = 10.0_f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .map(|factor| factor * power)
            .into_iter()
            .find(|&step| step >= 0.999 * rough)
            .unwrap_or(rough);
        let step = if self.scale == Scale::Logarithmic {
            step.ceil()
        } else {
            step
        };
        if step.is_normal() { step } else { 1.0 }
    }

    /// Ticks (value, label) inside the range.
    pub(super) fn ticks(&self, count: f64) -> Vec<(f64, String)> {
        let step = self.step(count);
        let first = (self.low / step - 1e-6).ceil();
        let number = ((self.high - self.low) / step + 1.001).clamp(0.0, 200.0) as usize;
        let places = |i: usize| (first + i as f64) * step;
        let inside = (0..number)
            .map(places)
            .filter(|&v| v <= self.high + 1e-6 * step);
        match self.scale {
            Scale::Linear => {
                let decimals = (-step.log10().floor()).max(0.0) as usize;
                inside.map(|v| (v + 0.0, plain(v, decimals))).collect()
            }
            // Within one decade: its 1, 2 and 5.
            Scale::Logarithmic if self.high - self.low < 1.5 => {
                let decade = self.low.floor() as i32;
                (decade..decade + 4)
                    .flat_map(|d| [1.0, 2.0, 5.0].map(|factor| factor * 10.0_f64.powi(d)))
                    .filter(|&v| self.holds(v))
                    .map(|v| (v, power_label(v)))
                    .collect()
            }
            Scale::Logarithmic => inside
                .map(|v| 10.0_f64.powf(v))
                .filter(|v| v.is_normal())
                .map(|v| (v, power_label(v)))
                .collect(),
        }
    }
}

fn transformed(value: f64, scale: Scale) -> Option<f64> {
    match scale {
        Scale::Linear => Some(value),
        Scale::Logarithmic => (value > 0.0).then(|| value.log10()),
    }
    .filter(|v| v.abs() <= HUGE)
}

fn plain(value: f64, decimals: usize) -> String {
    if decimals > 5 || value.abs() >= 1e6 {
        return format!("{value:.1e}").replace('-', "\u{2212}");
    }
    let text = format!("{:.decimals$}", value + 0.0);
    let zero = text.chars().all(|c| "-0.".contains(c));
    if zero {
        text.replace('-', "")
    } else {
        text.replace('-', "\u{2212}")
    }
}

/// 0.01 to 9999 in full, powers of ten beyond.
pub(super) fn power_label(value: f64) -> String {
    let exponent = (value.log10() + 1e-9).floor();
    if (-2.0..4.0).contains(&exponent) {
        return plain(value, (-exponent).max(0.0) as usize);
    }
    let superscript: String = format!("{exponent:.0}")
        .chars()
        .filter_map(|c| match c {
            '-' => Some('\u{207b}'),
            _ => c
                .to_digit(10)
                .and_then(|d| "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth(d as usize)),
        })
        .collect();
    match (value / 10.0_f64.powf(exponent)).round() {
        1.0 => format!("10{superscript}"),
        factor => format!("{factor:.0}·10{superscript}"),
    }
}

/// The plot's frame in px and the ranges it shows.
struct Plot {
    left: f64,
    right: f64,
    /// Right of the plot, for names.
    room: f64,
    top: f64,
    bottom: f64,
    x: Range,
    y: Range,
}

impl Plot {
    fn x_ticks(&self) -> f64 {
        ((self.right - self.left) / 80.0).floor().max(2.0)
    }

    fn y_ticks(&self) -> f64 {
        ((self.bottom - self.top) / 38.0).floor().max(2.0)
    }

    fn at_x(&self, value: f64) -> f64 {
        let share = transformed(value, self.x.scale).unwrap_or(self.x.low) - self.x.low;
        self.left + (self.right - self.left) * share / (self.x.high - self.x.low)
    }

    fn at_y(&self, value: f64) -> f64 {
        let share = transformed(value, self.y.scale).unwrap_or(self.y.low) - self.y.low;
        self.bottom - (self.bottom - self.top) * share / (self.y.high - self.y.low)
    }

    /// The unbroken runs of a series, in px.
    fn runs(&self, points: &[[f64; 2]]) -> Vec<Vec<[f64; 2]>> {
        let shown = |p: &[f64; 2]| {
            transformed(p[0], self.x.scale).is_some() && transformed(p[1], self.y.scale).is_some()
        };
        points
            .split(|p| !shown(p))
            .filter(|run| !run.is_empty())
            .map(|run| {
                run.iter()
                    .map(|p| [self.at_x(p[0]), self.at_y(p[1])])
                    .collect()
            })
            .collect()
    }
}

/// Keeps the first, lowest, highest and last point of each px column: looks the same, is small.
fn thin(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut kept = Vec::new();
    for column in points.chunk_by(|a, b| a[0].floor() == b[0].floor()) {
        let by_height = |a: &usize, b: &usize| column[*a][1].total_cmp(&column[*b][1]);
        let lowest = (0..column.len()).min_by(by_height).unwrap_or(0);
        let highest = (0..column.len()).max_by(by_height).unwrap_or(0);
        let mut picks = [0, lowest, highest, column.len() - 1];
        picks.sort_unstable();
        for (i, &pick) in picks.iter().enumerate() {
            if i == 0 || picks[i - 1] != pick {
                kept.push(column[pick]);
            }
        }
    }
    kept
}

#[derive(Clone, Copy)]
struct Rect {
    left: f64,
    top: f64,
    width: f64,
    /// Right of the last point.
    at_end: bool,
    /// Where a thin line leads from the name to its curve, if it stands apart.
    leader: Option<[f64; 2]>,
    /// Preferred by so many px of room.
    bonus: f64,
}

/// Where a name may stand: right of the curve's end, and above or below it along the curve.
fn candidates(curve: &[[f64; 2]], width: f64, plot: &Plot) -> Vec<Rect> {
    let Some(&[x, y]) = curve.last() else {
        return Vec::new();
    };
    let mut rects: Vec<Rect> = [0.0, -1.0, 1.0, -2.0, 2.0, -3.0, 3.0]
        .into_iter()
        .map(|rows| Rect {
            left: x + 9.0,
            top: y - TEXT / 2.0 + 16.0 * rows,
            width,
            at_end: true,
            leader: (rows != 0.0).then_some([x, y]),
            bonus: 4.0 - 6.0 * f64::abs(rows),
        })
        .collect();
    for i in 0..120 {
        let [x, y] = curve[(curve.len() - 1) * i / 119];
        for (shift_x, shift_y) in [
            (-width / 2.0, -TEXT - 8.0),
            (-width / 2.0, 8.0),
            (8.0, -TEXT / 2.0),
            (-8.0 - width, -TEXT / 2.0),
        ] {
            let (left, top) = (x + shift_x, y + shift_y);
            let height = (plot.bottom - y) / (plot.bottom - plot.top);
            rects.push(Rect {
                left,
                top,
                width,
                at_end: false,
                leader: None,
                bonus: 8.0 * height,
            });
        }
    }
    rects.retain(|r| {
        let right = plot.right + if r.at_end { plot.room } else { 0.0 };
        r.left >= plot.left
            && r.left + r.width <= right
            && r.top >= plot.top
            && r.top + TEXT <= plot.bottom + 8.0
    });
    rects
}

impl Rect {
    /// Distance in px to curves, names and marks, up to where more room helps no more; negative
    /// on overlap.
    fn merit(
        &self,
        curves: &[Vec<[f64; 2]>],
        own: usize,
        names: &[(usize, Rect)],
        marks: &[f64],
    ) -> f64 {
        let mut nearest = 30.0_f64;
        for (i, curve) in curves.iter().enumerate() {
            // The own curve may pass close by, but not through.
            let wanted = if i == own { 26.0 } else { 0.0 };
            let single = curve.len() == 1;
            let distances = curve
                .windows(2)
                .map(|w| self.segment_distance(w[0], w[1]))
                .chain(single.then(|| self.segment_distance(curve[0], curve[0])));
            for distance in distances {
                nearest = nearest.min(if distance < 3.0 {
                    distance - 40.0
                } else {
                    distance + wanted
                });
            }
        }
        for (_, other) in names {
            let gap_x =
                (other.left - self.left - self.width).max(self.left - other.left - other.width);
            let gap_y = (other.top - self.top - TEXT).max(self.top - other.top - TEXT);
            let gap = gap_x.max(gap_y);
            nearest = nearest.min(if gap < 2.0 { gap - 80.0 } else { gap + 14.0 });
        }
        for &mark in marks {
            if mark > self.left - 3.0 && mark < self.left + self.width + 3.0 {
                nearest = nearest.min(6.0);
            }
        }
        nearest + self.bonus
    }

    /// Distance to a segment, sampled finely enough for a name; 0 inside.
    fn segment_distance(&self, a: [f64; 2], b: [f64; 2]) -> f64 {
        let (low, high) = (a[0].min(b[0]), a[0].max(b[0]));
        if low > self.left + self.width + 60.0 || high < self.left - 60.0 {
            return 60.0;
        }
        let steps = ((b[0] - a[0]).hypot(b[1] - a[1]) / 4.0).clamp(1.0, 400.0) as usize;
        (0..=steps)
            .map(|i| {
                let t = i as f64 / steps as f64;
                let (x, y) = (a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t);
                let gap_x = (self.left - x).max(x - self.left - self.width).max(0.0);
                let gap_y = (self.top - y).max(y - self.top - TEXT).max(0.0);
                gap_x.hypot(gap_y)
            })
            .fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<[f64; 2]>, scale: Scale) -> Chart<'static> {
        let axis = Axis {
            label: "a",
            unit: "N",
            scale,
        };
        Chart {
            title: "t < u",
            x: axis,
            y: axis,
            series: vec![Series {
                name: "s",
                points,
                style: Style::LineAndMarkers,
                color: PALETTE[0],
            }],
            events: vec![
                Event {
                    x: 1.0,
                    label: "one",
                },
                Event {
                    x: 1.01,
                    label: "two",
                },
            ],
            stations: vec![1.0],
        }
    }

    #[test]
    fn hard_input_gives_finite_coordinates() {
        let cases = [
            vec![],
            vec![[1.0, 2.0]],
            vec![[1.0, 0.0], [1.0, 0.0]],
            vec![[0.0, f64::NAN], [f64::INFINITY, 1.0]],
            vec![[1.0, -1e-300], [2.0, 1e300]],
            vec![[1.0, f64::MIN], [2.0, f64::MAX]],
            vec![[0.0, 5.0], [1.0, f64::NAN], [2.0, 7.0]],
        ];
        for points in cases {
            for scale in [Scale::Linear, Scale::Logarithmic] {
                let svg = chart(points.clone(), scale).svg(600.0, 300.0);
                assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
                assert!(svg.contains("t &lt; u") && svg.len() < 20_000);
            }
        }
    }

    #[test]
    fn ticks_are_round() {
        let labels = |low, high, scale| -> Vec<String> {
            let range = Range { low, high, scale };
            range
                .ticks(6.0)
                .into_iter()
                .map(|(_, label)| label)
                .collect()
        };
        assert_eq!(
            labels(-0.1, 0.31, Scale::Linear),
            ["\u{2212}0.1", "0.0", "0.1", "0.2", "0.3"]
        );
        assert_eq!(labels(0.0, 4.0, Scale::Linear), ["0", "1", "2", "3", "4"]);
        assert_eq!(
            labels(-6.0, -1.0, Scale::Logarithmic),
            ["10⁻⁶", "10⁻⁵", "10⁻⁴", "10⁻³", "0.01", "0.1"]
        );
        assert_eq!(labels(0.0, 1.0, Scale::Logarithmic), ["1", "2", "5", "10"]);
    }

    #[test]
    fn event_labels_do_not_collide() {
        let mut chart = chart(vec![[0.0, 0.0], [10.0, 1.0]], Scale::Linear);
        let xs = [1.0, 1.2, 3.0, 3.1, 3.2, 9.9];
        chart.events = xs
            .iter()
            .map(|&x| Event {
                x,
                label: "an event",
            })
            .collect();
        let plot = chart.layout(700.0, 300.0, 60.0);
        let rows = chart.event_rows(&plot);
        assert_eq!(rows.len(), xs.len());
        let width = text_width("an event", 12.0);
        for (placed, row) in &rows {
            for (other, other_row) in &rows {
                let over = other.x > placed.x && other.x < placed.x + width;
                assert!(!over || other_row < row);
            }
        }
    }

    #[test]
    fn thinning_keeps_extremes() {
        let points: Vec<[f64; 2]> = (0..10_000)
            .map(|i| [f64::from(i) * 0.01, f64::from(i * 37 % 101)])
            .collect();
        let kept = thin(&points);
        assert!(kept.len() <= 404);
        assert!(kept.iter().any(|p| p[1] == 0.0) && kept.iter().any(|p| p[1] == 100.0));
        assert_eq!((kept.first(), kept.last()), (points.first(), points.last()));
    }
}
