//! Motions like a given one: in another direction, faster, not as far. An advice must hold for them, too.

use nalgebra::{Rotation3, Unit};
use tissue::mesh::Vec3;
use tissue::scene::Scene;

use crate::motion::Motion;

/// How a motion is changed from where a tool first meets tissue.
pub struct Change {
    /// Of the direction \[degrees\].
    pub tilt: f64,
    /// Round the direction of the motion: to which side it is tilted \[degrees\].
    pub side: f64,
    pub speed: f64,
}

/// What is tried besides the motion itself: the edge of what the advice is for.
pub const NEIGHBOURS: [Change; 2] = [
    Change {
        tilt: 30.0,
        side: 0.0,
        speed: 1.5,
    },
    Change {
        tilt: 30.0,
        side: 180.0,
        speed: 1.0,
    },
];

/// Where tissue is cut: what any of them cuts must be dynamic.
pub const SWEEPS: [Change; 4] = [
    Change {
        tilt: 30.0,
        side: 0.0,
        speed: 1.0,
    },
    Change {
        tilt: 15.0,
        side: 0.0,
        speed: 1.0,
    },
    Change {
        tilt: 15.0,
        side: 180.0,
        speed: 1.0,
    },
    Change {
        tilt: 30.0,
        side: 180.0,
        speed: 1.0,
    },
];

/// Of a tool: from when \[s\] and where \[m\] its way is turned, and how.
struct Turn {
    from: f64,
    place: Vec3,
    turn: Rotation3<f64>,
}

/// `met`: when each tool first meets tissue \[s\]. One that never does keeps its way.
pub fn changed(motion: &Motion, scene: &Scene, met: &[Option<f64>], change: &Change) -> Motion {
    let tools = motion.tools();
    let mut time = motion.times().to_vec();
    time.extend(met.iter().flatten().filter(|t| **t < motion.end()));
    time.sort_by(f64::total_cmp);
    time.dedup();
    let turns: Vec<Option<Turn>> = (tools.iter())
        .map(|k| {
            let from = met[*k]?;
            let position = |t: f64| Vec3::from_column_slice(&motion.at(scene, *k, t)[..3]);
            let ways = time.iter().map(|t| position(t.max(from)) - position(from));
            let way = ways.max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
            let way = Unit::try_new(way, 1e-9)?;
            let axis = Unit::new_normalize(across(&way));
            let side = Rotation3::from_axis_angle(&way, change.side.to_radians());
            let turn = Rotation3::from_axis_angle(&(side * axis), change.tilt.to_radians());
            Some(Turn {
                from,
                place: position(from),
                turn,
            })
        })
        .collect();
    let row = |t: &f64| {
        let inputs = |(k, turn): (&usize, &Option<Turn>)| {
            let mut inputs = motion.at(scene, *k, *t);
            if let Some(Turn { from, place, turn }) = turn
                && t >= from
            {
                let way = turn * (Vec3::from_column_slice(&inputs[..3]) - place);
                (0..3).for_each(|axis| inputs[axis] = place[axis] + way[axis]);
            }
            inputs
        };
        tools.iter().zip(&turns).map(inputs).collect::<Vec<_>>()
    };
    let rows: Vec<_> = time.iter().map(row).collect();
    let time = time.iter().map(|t| t / change.speed).collect();
    Motion::of_tools(time, &tools, &rows)
}

/// Some direction at right angles.
fn across(way: &Vec3) -> Vec3 {
    let axis = way.iamin();
    way.cross(&Vec3::from_fn(|k, _| f64::from(k == axis)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Straight down to the tissue, then aside by the tilt, as long a way, in less time.
    #[test]
    fn the_way_turns_where_tissue_is_met() {
        let text = r#"{"name": "b", "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
            "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}],
            "tools": [{"name": "p", "kind": "probe", "shape": {"sphere": {"radius": 0.01}}, "position": [0, 0, 3]}]}"#;
        let scene = tissue::scene::parse(text, "b").unwrap();
        let mut rows = vec![vec![motion_row(3.0)], vec![motion_row(1.0)]];
        rows.push(vec![motion_row(1.0)]);
        let motion = Motion::of_tools(vec![0.0, 1.0, 2.0], &[0], &rows);
        let change = &NEIGHBOURS[0];
        let found = changed(&motion, &scene, &[Some(0.5)], change);
        assert!((found.end() - 2.0 / 1.5).abs() < 1e-12);
        let at = |t: f64| Vec3::from_column_slice(&found.at(&scene, 0, t / 1.5)[..3]);
        assert!((at(0.5) - Vec3::new(0.0, 0.0, 2.0)).norm() < 1e-12);
        let way = at(1.0) - at(0.5);
        assert!(
            (way.norm() - 1.0).abs() < 1e-12 && (way.z + 30f64.to_radians().cos()).abs() < 1e-12
        );
        let other = changed(&motion, &scene, &[Some(0.5)], &NEIGHBOURS[1]);
        let aside = Vec3::from_column_slice(&other.at(&scene, 0, 1.0)[..3]) - at(0.5);
        assert!((aside.xy() + way.xy()).norm() < 1e-12);
        // Of a tool that meets nothing the way stays.
        let kept = changed(&motion, &scene, &[None], change);
        assert_eq!(kept.at(&scene, 0, 1.0)[2], motion.at(&scene, 0, 1.5)[2]);
    }

    fn motion_row(z: f64) -> [f64; 8] {
        [0.0, 0.0, z, 1.0, 0.0, 0.0, 0.0, 0.0]
    }
}
