//! Points of the maps of meshes, interfaces, contact and fragments.

use tissue::mesh::box_mesh;
use tissue::mesh::{TetMesh, Vec3};
use tissue::model::tensor_mass::Lane;
use tissue::reference;
use tissue::simulation::Simulation;
use tissue::state::State;
use tissue::step::{Workspace, advance};

use super::maps::{Cell, GROWN, LAWS, Outcome, cell, model, stopped};
use super::random::least_dihedral;

/// A bar of 60 x 30 x 30 mm whose nodes were moved, each its own way, until the smallest dihedral angle \[degrees\] is so small.
fn moved(dihedral: f64) -> TetMesh {
    let mut mesh = box_mesh::five([0.06, 0.03, 0.03], [8, 4, 4], [0.0; 3]);
    let plain = mesh.nodes.clone();
    // Directions that repeat, by the golden ratio.
    let way = |k: usize| {
        let turn = |g: f64| 2.0 * (k as f64 * g).fract() - 1.0;
        Vec3::new(turn(0.618_034), turn(0.754_878), turn(0.569_840)) * 0.0075
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..20 {
        let share = 0.5 * (low + high);
        for (k, node) in mesh.nodes.iter_mut().enumerate() {
            *node = plain[k] + way(k) * share;
        }
        match least_dihedral(&mesh) >= dihedral {
            true => low = share,
            false => high = share,
        }
    }
    for (k, node) in mesh.nodes.iter_mut().enumerate() {
        *node = plain[k] + way(k) * low;
    }
    mesh
}

/// Of the regular mesh \[degrees\].
pub const REGULAR: f64 = 54.0;

pub fn quality(panel: &str, dihedral: f64, ratio: f64) -> Cell {
    let chosen = panel == "substep chosen";
    let text = |mesh: &TetMesh, ratio: f64, more: &str| {
        let nodes: Vec<[f64; 3]> = mesh.nodes.iter().map(|p| (*p).into()).collect();
        format!(
            r#"{{"name": "bar", "mesh": {{"nodes": {nodes:?}, "tetrahedra": {:?}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}},
            {{"where": {{"halfSpace": {{"point": [0.03, 0, 0], "normal": [1, 0, 0]}}}}, "youngModulus": {}, "poissonRatio": 0.45, "density": 1060}}],
            "fixed": [{{"nodes": [0, 9, 18, 27, 36, 45, 54, 63, 72, 81, 90, 99, 108, 117, 126, 135, 144, 153, 162, 171, 180, 189, 198, 207, 216]}}],
            "gravity": [0, 0, -2], "integration": {{"scheme": "symplecticEuler"{more}}}}}"#,
            mesh.tetrahedra,
            6000.0 * ratio
        )
    };
    cell((|| {
        let regular = model(&text(&moved(REGULAR), 1.0, ""))?.critical_step(0.0);
        let mesh = moved(dihedral);
        let h = 0.5 * regular;
        let given = format!(r#", "substep": {h:e}, "hapticRate": {:e}"#, 1.0 / h);
        let model = model(&text(&mesh, ratio, if chosen { "" } else { &given }))?;
        let share = model.critical_step(0.0) / regular;
        let mut s = Simulation::new(model);
        let mut halvings = 0;
        while s.time() < 0.05 {
            if let Err(e) = s.step(1e-3) {
                return Ok(Cell::of(Outcome::Discarded, chosen, stopped(&e)));
            }
            halvings = halvings.max(s.halvings());
        }
        let least = s.minimum_volume_ratio();
        let inverted = (least <= 0.0).then(|| format!("minimumVolumeRatio {least:.2}"));
        Ok(Cell::ended(halvings, 100.0 * share, chosen, inverted))
    })())
}

/// Equilibria that are off by more than this \[%\] are another tissue's.
const SHIFTED: f64 = 5.0;

/// A cantilever that is let go under its weight, with settings of its model.
fn cantilever(damping: f64, kind: &str) -> String {
    format!(
        r#"{{"name": "bar", "mesh": {{"box": {{"size": [0.1, 0.03, 0.03], "cells": [10, 3, 3]}}}},
        "materials": [{{"where": {{"all": true}}, "youngModulus": 20000, "poissonRatio": 0.4, "density": 1000}}],
        "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}], "gravity": [0, 0, -2],
        "integration": {{"scheme": "symplecticEuler", "damping": {damping}}}, "model": {{{kind}}}}}"#
    )
}

/// The half that moves by itself; the held one is pre-computed.
const OUTER_HALF: &str =
    r#""kind": "hybrid", "dynamic": {"halfSpace": {"point": [0.05, 0, 0], "normal": [1, 0, 0]}}"#;

pub fn interface(panel: &str, modes: f64, damping: f64) -> Cell {
    cell((|| {
        let whole = model(&cantilever(damping, r#""kind": "tensorMass""#))?;
        let truth = reference::solve(&whole, false).map_err(|e| e.to_string())?;
        let modes = match modes < 48.0 {
            true => format!("{modes}"),
            false => "null".into(),
        };
        let safe = modes == "null";
        let kind =
            format!(r#"{OUTER_HALF}, "interfaceModes": {modes}, "interfaceMass": "{panel}""#);
        let model = model(&cantilever(damping, &kind))?;
        let mut s = Simulation::new(model.clone());
        let mut halvings = 0;
        let end = model
            .scene_mesh()
            .nodes
            .iter()
            .position(|p| p.x > 0.0999 && p.y < 1e-6 && p.z < 1e-6);
        let end = end.ok_or("no such node")?;
        let at = (0..s.state().live.rest.len())
            .find(|i| (s.state().live.rest[*i] - model.scene_mesh().nodes[end]).norm() < 1e-9)
            .ok_or("no such node")?;
        // The mean over whole swings is the equilibrium, damped or not.
        let (mut sum, mut count) = (0.0, 0.0);
        for k in 0..3000 {
            if let Err(e) = s.step(1e-3) {
                return Ok(Cell::of(Outcome::Discarded, safe, stopped(&e)));
            }
            halvings = halvings.max(s.halvings());
            if k >= 1000 {
                sum += s.displacement(at).z;
                count += 1.0;
            }
        }
        let off = 100.0 * (sum / count / truth.displacement[end][2] - 1.0);
        let shifted = (off.abs() > SHIFTED).then(|| format!("equilibrium off by {off:+.1} %"));
        Ok(Cell::ended(halvings, off, safe, shifted))
    })())
}

/// The pre-computed half answers to where the interface was some substeps ago, in place of where it is.
pub fn delay(panel: &str, late: f64, damping: f64) -> Cell {
    let (late, held) = (late as usize, panel == "kept");
    cell((|| {
        let model = model(&cantilever(damping, OUTER_HALF))?;
        let at_rest = reference::solve(&model, false).map_err(|e| e.to_string())?;
        let length = |u: &[f64; 3]| Vec3::from(*u).norm();
        let scale = at_rest.displacement.iter().map(length).fold(0.0, f64::max);
        let h = 0.5 * model.critical_step(damping);
        let mut state = State::new(&model);
        let mut work = Workspace::new(&model, &state);
        let interface = model.parts.connected_from()..model.parts.moving;
        let weight: Vec<Vec3> = (interface.clone().map(|i| state.external[i].xyz())).collect();
        let forces = |state: &State| -> Vec<Vec3> {
            let mut coupling = state.coupling.clone();
            coupling.solve(&model, &state.displacement);
            (interface.clone().map(|i| coupling.force_on(&model, i))).collect()
        };
        // Forces on the interface, the oldest first.
        let mut known = std::collections::VecDeque::new();
        let (mut most, safe) = (0.0f64, late == 0);
        let steps = (1.0 / h).ceil() as usize;
        for k in 0..steps {
            let now = forces(&state);
            known.push_back(now.clone());
            let kept = if held { k % (late + 1) } else { late };
            let old = known[known.len() - 1 - kept.min(known.len() - 1)].clone();
            if known.len() > late {
                known.pop_front();
            }
            for (node, i) in interface.clone().enumerate() {
                let force = weight[node] + old[node] - now[node];
                let change = force - state.external[i].xyz();
                let u =
                    state.displacement[i].xyz() - state.velocity[i].xyz() * (0.5 * state.clock.lag);
                state.account.support_work -= change.dot(&u);
                state.external[i] = Lane::from(force);
            }
            if let Err(e) = advance(&model, &mut state, &mut work, 1, h) {
                let symptom = format!("after {:.0} ms: {}", 1e3 * h * k as f64, stopped(&e));
                return Ok(Cell::of(Outcome::Failed, safe, symptom));
            }
            let moved = state.displacement.iter().map(|u| u.xyz().norm());
            most = most.max(moved.fold(0.0, f64::max));
            if most.is_nan() || most >= GROWN * scale {
                let symptom = format!(
                    "grew to {:.0} times in {:.0} ms",
                    most / scale,
                    1e3 * h * k as f64
                );
                return Ok(Cell::of(Outcome::Failed, safe, symptom));
            }
        }
        Ok(Cell::ended(0, most / scale, safe, None))
    })())
}

/// Energy that contact may make, of all work \[%\].
const GIVEN_BACK: f64 = 5.0;

/// Of the ball \[m\].
const RADIUS: f64 = 0.006;

pub fn contact(panel: &str, speed: f64, young: f64) -> Cell {
    let friction: f64 = panel.trim_start_matches("friction ").parse().unwrap_or(0.0);
    cell((|| {
        let model = model(&format!(
            r#"{{"name": "block", "mesh": {{"box": {{"size": [0.06, 0.03, 0.015], "cells": [12, 6, 3]}}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": {young}, "poissonRatio": 0.45, "density": 1060}}],
            "fixed": [{{"box": {{"min": [0, 0, 0], "max": [1, 1, 0]}}}}, {{"box": {{"min": [0.06, 0, 0], "max": [1, 1, 1]}}}}],
            "gravity": [0, 0, 0], "integration": {{"scheme": "symplecticEuler"}},
            "tools": [{{"name": "ball", "kind": "probe", "shape": {{"sphere": {{"radius": {RADIUS}}}}},
            "friction": {friction}, "position": [0.015, 0.0151, 0.0215]}}]}}"#
        ))?;
        // No faster than shear waves.
        let safe = speed <= 0.2 || speed <= 0.5 && young >= 2000.0;
        let mut s = Simulation::new(model);
        let (down, along) = (0.002, 0.043);
        let (mut halvings, mut made, mut heat) = (0, 0.0f64, 0.0f64);
        let step = (1e-3f64).min(0.1 * RADIUS / speed);
        let steps = ((down + along) / speed / step).ceil() as u32;
        for k in 1..=steps {
            let way = speed * step * f64::from(k);
            s.set_pose_input(0, 2, 0.0215 - way.min(down));
            s.set_pose_input(0, 0, 0.015 + (way - down).clamp(0.0, along));
            if let Err(e) = s.step(step) {
                return Ok(Cell::of(Outcome::Discarded, safe, stopped(&e)));
            }
            halvings = halvings.max(s.halvings());
            let dissipated = s.energy().dissipated;
            heat = heat.max(dissipated);
            made = made.max(heat - dissipated);
        }
        let work = s.energy().tool_work.abs().max(heat).max(1e-12);
        let least = s.minimum_volume_ratio();
        let percent = 100.0 * made / work;
        let symptom = if percent > GIVEN_BACK {
            Some(format!("{percent:.0} % of the work made by contact"))
        } else if least <= 0.0 {
            Some(format!("minimumVolumeRatio {least:.2}"))
        } else {
            None
        };
        Ok(Cell::ended(halvings, percent, safe, symptom))
    })())
}

/// Momentum that is off by more than this \[%\] is not kept.
const LOST: f64 = 0.1;

pub fn fragments(panel: &str, count: f64, row: f64) -> Cell {
    let density = if panel == "as heavy" { 1000 } else { 10 };
    let [law, element] = LAWS[row as usize];
    // A fragment of a cell is its middle tetrahedron and some of the corners.
    let count = count as usize;
    let cells = count.div_ceil(5);
    let first = 60 - 5 * cells;
    let kept = first..first + count.max(5 * (cells - 1) + (count - 1) % 5 + 1);
    let gone: Vec<usize> = (first - 5..60).filter(|t| !kept.contains(t)).collect();
    cell((|| {
        let model = model(&format!(
            r#"{{"name": "bar", "mesh": {{"box": {{"size": [0.06, 0.005, 0.005], "cells": [12, 1, 1]}}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": 20000, "poissonRatio": 0.45, "density": 1000}},
            {{"where": {{"box": {{"min": [{}, 0, 0], "max": [1, 1, 1]}}}}, "youngModulus": 20000, "poissonRatio": 0.45, "density": {density}}}],
            "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}], "gravity": [0, 0, -9.81],
            "integration": {{"scheme": "symplecticEuler"}},
            "cuts": [{{"time": 0.05, "where": {{"tetrahedra": {gone:?}}}}}],
            "model": {{"elasticity": "{law}", "element": "{element}"}}}}"#,
            0.005 * (12 - cells) as f64
        ))?;
        let edge = 0.005 * (12 - cells) as f64 - 1e-6;
        let mut s = Simulation::new(model);
        let mut halvings = 0;
        let mut at_cut = None;
        let (mut mass, mut momentum) = (0.0, Vec3::zeros());
        for k in 1..=300 {
            if let Err(e) = s.step(1e-3) {
                return Ok(Cell::of(Outcome::Discarded, true, stopped(&e)));
            }
            halvings = halvings.max(s.halvings());
            let state = s.state();
            (mass, momentum) = (0.0, Vec3::zeros());
            for i in 0..state.live.mass.len() {
                if state.live.rest[i].x > edge && state.live.star_count[i] > 0 {
                    mass += state.live.mass[i];
                    momentum += state.velocity[i].xyz() * state.live.mass[i];
                }
            }
            if k == 60 {
                at_cut = Some(momentum);
            }
        }
        let fall = Vec3::new(0.0, 0.0, -9.81 * 0.24 * mass);
        let lost = momentum - at_cut.unwrap_or_default() - fall;
        let percent = 100.0 * lost.norm() / fall.norm();
        let least = s.minimum_volume_ratio();
        let symptom = if least <= 0.0 {
            Some(format!("minimumVolumeRatio {least:.2}"))
        } else if percent.is_nan() || percent > LOST {
            Some(format!("momentum off by {percent:.1} %"))
        } else {
            None
        };
        Ok(Cell::ended(halvings, percent, true, symptom))
    })())
}
