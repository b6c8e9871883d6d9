//! One page: a title, shaded panels that share a camera, and a chart below them.

use super::base64;
use super::chart::{CARD, INK, MUTED, disc};
use super::svg::{escape, px};
use super::{Chart, Surface, ToolPose, View, render};
use std::fmt::Write;

const WIDTH: f64 = 1200.0;
const EDGE: f64 = 28.0;
const GAP: f64 = 14.0;
const CHART_HEIGHT: f64 = 330.0;
/// Picture px per page px.
const DENSITY: f64 = 1.5;

/// A moment of the experiment.
#[derive(Clone, Copy, Debug)]
pub struct Panel<'a> {
    pub surface: Surface<'a>,
    pub tools: &'a [ToolPose],
    pub caption: &'a str,
    /// Second line of the caption, such as the time; empty: none.
    pub note: &'a str,
}

#[derive(Clone, Debug)]
pub struct Figure<'a> {
    pub title: &'a str,
    pub subtitle: &'a str,
    /// Its aspect is that of the panels.
    pub view: View,
    pub panels: &'a [Panel<'a>],
    pub chart: Chart<'a>,
}

impl Figure<'_> {
    /// The page as one self-contained SVG file.
    ///
    /// # Errors
    /// When a panel cannot be written as PNG.
    pub fn svg(&self) -> Result<String, png::EncodingError> {
        let count = self.panels.len().max(1) as f64;
        let panel_width = (WIDTH - 2.0 * EDGE - (count - 1.0) * GAP) / count;
        let panel_height = (panel_width / self.view.aspect()).clamp(1.0, 1000.0);
        let panel_top = 92.0;
        let caption_top = panel_top
            + if self.panels.is_empty() {
                0.0
            } else {
                panel_height + 58.0
            };
        let chart_top = caption_top + 10.0;
        let height = chart_top + CHART_HEIGHT + 22.0;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"system-ui, sans-serif\" role=\"img\" aria-label=\"{title}\">\n\
             <defs><radialGradient id=\"studio\" cx=\"0.5\" cy=\"0.38\" r=\"0.75\">\
             <stop offset=\"0\" stop-color=\"#f7f8fa\"/><stop offset=\"0.55\" stop-color=\"#e3e7ec\"/>\
             <stop offset=\"1\" stop-color=\"#c3cad4\"/></radialGradient></defs>\n\
             <rect width=\"{w}\" height=\"{h}\" rx=\"14\" fill=\"{CARD}\"/>\n\
             <text x=\"{EDGE}\" y=\"48\" font-size=\"27\" font-weight=\"700\" fill=\"{INK}\">{title}</text>\n\
             <text x=\"{EDGE}\" y=\"74\" font-size=\"15\" fill=\"{MUTED}\">{subtitle}</text>\n",
            w = px(WIDTH),
            h = px(height),
            title = escape(self.title),
            subtitle = escape(self.subtitle),
        );
        for (i, panel) in self.panels.iter().enumerate() {
            let left = EDGE + i as f64 * (panel_width + GAP);
            svg.push_str(&panel.svg(
                &self.view,
                i + 1,
                [left, panel_top, panel_width, panel_height],
            )?);
        }
        // Writing to a String cannot fail.
        let _ = write!(
            svg,
            "<g transform=\"translate({} {})\">\n{}</g>\n</svg>\n",
            px(EDGE),
            px(chart_top),
            self.chart.group(WIDTH - 2.0 * EDGE, CHART_HEIGHT)
        );
        Ok(svg)
    }
}

impl Panel<'_> {
    fn svg(
        &self,
        view: &View,
        number: usize,
        [left, top, width, height]: [f64; 4],
    ) -> Result<String, png::EncodingError> {
        let pixels = |length: f64| (length * DENSITY).round() as usize;
        let image = render(
            view,
            &self.surface,
            self.tools,
            pixels(width),
            pixels(height),
        );
        let data = base64::encode(&image.png()?);
        let [x, y, w, h] = [left, top, width, height].map(px);
        Ok(format!(
            "<clipPath id=\"panel{number}\"><rect x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" rx=\"9\"/></clipPath>\n\
             <g clip-path=\"url(#panel{number})\"><rect x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" fill=\"url(#studio)\"/>\
             <image x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" preserveAspectRatio=\"none\" \
             href=\"data:image/png;base64,{data}\"/></g>\n{disc}\
             <text x=\"{tx}\" y=\"{ty}\" font-size=\"15\" font-weight=\"600\" fill=\"{INK}\">{caption}</text>\n\
             <text x=\"{tx}\" y=\"{ny}\" font-size=\"13\" fill=\"{MUTED}\">{note}</text>\n",
            disc = disc(number, left + 11.0, top + height + 21.0),
            tx = px(left + 28.0),
            ty = px(top + height + 26.0),
            ny = px(top + height + 45.0),
            caption = escape(self.caption),
            note = escape(self.note),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Axis, Scale, Tint};
    use super::*;

    #[test]
    fn an_empty_figure_is_still_a_page() {
        let axis = Axis {
            label: "",
            unit: "",
            scale: Scale::Linear,
        };
        let surface = Surface {
            vertices: &[],
            triangles: &[],
            tint: Tint::None,
        };
        let panel = Panel {
            surface,
            tools: &[],
            caption: "a & b",
            note: "",
        };
        for panels in [&[][..], &[panel; 2][..]] {
            let figure = Figure {
                title: "t",
                subtitle: "",
                view: View::framing([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], 1.3, &[]),
                panels,
                chart: Chart {
                    title: "",
                    x: axis,
                    y: axis,
                    series: vec![],
                    events: vec![],
                    stations: vec![],
                },
            };
            let svg = figure.svg().unwrap();
            assert!(svg.starts_with("<svg") && svg.ends_with("</svg>\n") && !svg.contains("NaN"));
            assert_eq!(svg.matches("<image").count(), panels.len());
        }
    }
}
