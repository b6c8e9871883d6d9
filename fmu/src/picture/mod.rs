//! Pictures without a window: shaded surfaces with tools, line charts, and one figure of both.
//!
//! `view` places one camera for all panels, `shape` turns surfaces and tools into facets with
//! normals, `raster` and `light` turn them into pixels, `chart` draws curves and `scatter` points as SVG, and `figure` puts
//! panels and chart on one page. Everything is a pure function of its arguments: the same input
//! gives the same bytes. Empty, non-finite or zero-range input gives an emptier picture.

pub mod base64;
pub mod chart;
pub mod figure;
mod light;
pub mod raster;
pub mod scatter;
mod shape;
pub mod svg;
pub mod view;

pub use chart::{Axis, Chart, Event, PALETTE, Scale, Series, Style};
pub use figure::{Figure, Panel};
#[allow(unused_imports)] // pictures that stand alone
pub use raster::{Image, render};
pub use view::View;

/// A closed triangle surface, outward oriented, positions in m.
///
/// A triangle with an index out of range or a non-finite corner is left out.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    pub vertices: &'a [[f64; 3]],
    pub triangles: &'a [[u32; 3]],
    pub tint: Tint<'a>,
}

/// How far, from 0 to 1, the colour moves from the organ's skin to raw tissue.
///
/// Missing entries count as 0. Triangle tints keep the border of a cut crisp: normals are not
/// smoothed over an edge where the tint jumps by more than one half.
#[derive(Clone, Copy, Debug)]
#[allow(dead_code)] // a choice of three, whichever the commands draw
pub enum Tint<'a> {
    None,
    Vertices(&'a [f32]),
    Triangles(&'a [f32]),
}

/// What a tool looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(dead_code)] // the kinds of the scene file, whichever the commands draw
pub enum ToolLook {
    Probe,
    Grasper,
    Cautery,
}

/// A tool where it stands, in m.
#[derive(Clone, Copy, Debug)]
pub struct ToolPose {
    pub look: ToolLook,
    /// The outermost point of the tip.
    pub position: [f64; 3],
    /// From the tip towards the shaft; any length but 0.
    pub axis: [f64; 3],
    pub radius: f64,
    pub length: f64,
    /// Grasper closed, cautery glowing.
    pub active: bool,
    /// sRGB of the ring on the shaft: the colour of the tool's curve in the chart.
    pub accent: [u8; 3],
}
