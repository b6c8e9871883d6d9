//! A motion for a scene that has none: each tool is led to the nearest tissue, and from rest to rest into it or away.

use tissue::contact::shape::ToolShape;
use tissue::mesh::{TetMesh, Vec3};
use tissue::pose::PoseInput;
use tissue::scene::{Scene, Tool, ToolKind};

use crate::chart::scenes::{GESTURES, GestureRow};
use crate::motion::Motion;

/// How far the strong gesture goes, of the cube root of the body's volume.
const REACH: f64 = 0.15;
/// Length of the way to the tissue, of the gesture, and of the rest after it \[s\].
const PHASES: [f64; 3] = [0.2, 0.4, 0.2];
/// From row to row \[s\].
const ROW: f64 = 0.002;

/// By its name, such as `moderate`.
pub fn named(name: &str) -> Option<&'static GestureRow> {
    GESTURES.iter().find(|g| g.name == name)
}

/// Where a tool goes, and when it becomes active.
struct Lead {
    tool: usize,
    start: [f64; 7],
    /// To the tissue \[m\].
    approach: Vec3,
    /// From there \[m\].
    reach: Vec3,
    /// Of a grasper: closes when it is there.
    closes: bool,
}

/// Probes press along the inward normal, graspers pull along the outward one. Cauteries stay: what they burn only a
/// motion can say. None where no tool moves.
pub fn motion(
    scene: &Scene,
    mesh: &TetMesh,
    surface: &[[u32; 3]],
    gesture: &GestureRow,
) -> Option<Motion> {
    let volume: f64 = (mesh.tetrahedra.iter())
        .map(|t| {
            let [a, b, c, d] = t.map(|v| mesh.nodes[v as usize]);
            (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0
        })
        .sum();
    let reach = REACH * volume.cbrt() * gesture.share;
    let leads: Vec<Lead> = (scene.tools.iter().enumerate())
        .filter(|(_, tool)| tool.kind != ToolKind::Cautery)
        .filter_map(|(k, tool)| lead(k, tool, mesh, surface, reach))
        .collect();
    if leads.is_empty() {
        return None;
    }
    let moves = |l: &Lead| l.approach.norm() > 0.0;
    let [before, during, after] = PHASES;
    let before = if leads.iter().any(moves) { before } else { 0.0 };
    let count = ((before + during + after) / ROW).round() as usize;
    let time: Vec<f64> = (0..=count).map(|k| k as f64 * ROW).collect();
    let row = |t: &f64| {
        let at = |l: &Lead| {
            let there = if before > 0.0 {
                least_jerk(t / before)
            } else {
                1.0
            };
            let moved = l.approach * there + l.reach * least_jerk((t - before) / during);
            let mut inputs = [0.0; 8];
            inputs[..7].copy_from_slice(&l.start);
            (0..3).for_each(|axis| inputs[axis] += moved[axis]);
            inputs[7] = f64::from(l.closes && *t >= before - 1e-9);
            inputs
        };
        leads.iter().map(at).collect::<Vec<_>>()
    };
    let rows: Vec<Vec<[f64; 8]>> = time.iter().map(row).collect();
    let tools: Vec<usize> = leads.iter().map(|l| l.tool).collect();
    Some(Motion::of_tools(time, &tools, &rows))
}

fn least_jerk(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

fn lead(k: usize, tool: &Tool, mesh: &TetMesh, surface: &[[u32; 3]], reach: f64) -> Option<Lead> {
    let ([x, y, z], [w, a, b, c]) = (tool.position, tool.orientation);
    let start = [x, y, z, w, a, b, c];
    let pose = PoseInput {
        value: start,
        rate: [None; 7],
    }
    .pose()?;
    let shape = ToolShape::new(tool);
    let grasps = tool.kind == ToolKind::Grasper;
    // Of a grasper the jaws alone.
    let capsules: Vec<_> = match grasps {
        true => shape.active_at(&pose).collect(),
        false => shape.at(&pose).collect(),
    };
    let corners = |t: &[u32; 3]| t.map(|v| mesh.nodes[v as usize]);
    let normal = |[a, b, c]: [Vec3; 3]| (b - a).cross(&(c - a));
    let touched = |t: &&[u32; 3]| capsules.iter().any(|c| c.touches(&corners(t)));
    let near: Vec<&[u32; 3]> = surface.iter().filter(touched).collect();
    let (approach, outward) = if near.is_empty() {
        let gap = |p: &Vec3| {
            let from = capsules.iter().map(|c| (p - c.on_axis(p), c.radius));
            from.min_by(|a, b| (a.0.norm() - a.1).total_cmp(&(b.0.norm() - b.1)))
        };
        let places = surface.iter().filter_map(|t| {
            let middle = corners(t).iter().sum::<Vec3>() / 3.0;
            gap(&middle).map(|(way, radius)| (way, radius, normal(corners(t))))
        });
        let (way, radius, normal) =
            places.min_by(|a, b| (a.0.norm() - a.1).total_cmp(&(b.0.norm() - b.1)))?;
        // A grasper's axis goes to the surface, a probe stops where it touches.
        let share = match grasps {
            true => 1.0,
            false => 1.0 - radius / way.norm(),
        };
        (way * share, normal.normalize())
    } else {
        let sum: Vec3 = near.iter().map(|t| normal(corners(t))).sum();
        (Vec3::zeros(), sum.try_normalize(1e-30)?)
    };
    Some(Lead {
        tool: k,
        start,
        approach,
        reach: if grasps {
            outward * reach
        } else {
            -outward * reach
        },
        closes: grasps,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball above a block presses down, by its share of the block's size below where it touches; a grasper that touches pulls up.
    #[test]
    fn probes_press_and_graspers_pull() {
        let text = r#"{"name": "b", "mesh": {"box": {"size": [0.06, 0.06, 0.03], "cells": [6, 6, 3]}},
            "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}],
            "tools": [
              {"name": "p", "kind": "probe", "shape": {"sphere": {"radius": 0.01}}, "position": [0.03, 0.03, 0.045]},
              {"name": "g", "kind": "grasper", "shape": {"sphere": {"radius": 0.01}}, "position": [0.03, 0.03, 0.035]},
              {"name": "c", "kind": "cautery", "shape": {"sphere": {"radius": 0.01}}, "position": [0.03, 0.03, 0.2]}]}"#;
        let scene = tissue::scene::parse(text, "b").unwrap();
        let mesh = tissue::mesh::load::load(&scene.mesh, std::path::Path::new(".")).unwrap();
        let surface = tissue::mesh::check::surface(&mesh.tetrahedra).unwrap();
        let motion = motion(&scene, &mesh, &surface, named("strong").unwrap()).unwrap();
        assert_eq!(motion.tools(), [0, 1]);
        let reach = 0.15 * (0.06f64 * 0.06 * 0.03).cbrt();
        let [start, end] = [0.0, motion.end()].map(|t| motion.at(&scene, 0, t));
        assert_eq!(start, [0.03, 0.03, 0.045, 1.0, 0.0, 0.0, 0.0, 0.0]);
        // The centroids of a cell's triangles are a third of it aside.
        assert!((end[2] - (0.04 - reach)).abs() < 0.002, "{end:?}");
        let [open, end] = [0.1, motion.end()].map(|t| motion.at(&scene, 1, t));
        assert!((end[2] - (0.035 + reach)).abs() < 1e-9 && end[7] == 1.0 && open[7] == 0.0);
    }
}
