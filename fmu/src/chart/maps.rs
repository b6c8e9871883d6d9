//! Where methods fail: maps of real runs over two axes, a table of them, and what each point found.

use std::path::Path;
use std::sync::Arc;

use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::reference;
use tissue::simulation::Simulation;
use tissue::state::State;
use tissue::step::{StepError, Workspace, advance};

use super::map_points;

/// How a point ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// As asked.
    Stable,
    /// With shorter substeps than asked for.
    Halved,
    /// A step was given up, its state kept.
    Discarded,
    /// The scene was refused before the start.
    Refused,
    /// Wrong, and not stopped: the symptom says how it shows.
    Failed,
}

impl Outcome {
    pub const ALL: [Outcome; 5] = [
        Outcome::Stable,
        Outcome::Halved,
        Outcome::Discarded,
        Outcome::Refused,
        Outcome::Failed,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Outcome::Stable => "stable",
            Outcome::Halved => "halved",
            Outcome::Discarded => "discarded",
            Outcome::Refused => "refused",
            Outcome::Failed => "failed",
        }
    }
}

/// What a point found.
pub struct Cell {
    pub outcome: Outcome,
    /// The map's measure, where the run came to its end.
    pub value: Option<f64>,
    /// Inside the map's region.
    pub safe: bool,
    /// Empty where nothing shows.
    pub symptom: String,
}

pub struct MapAxis {
    pub label: &'static str,
    /// Names of the values, where they are no numbers.
    pub names: &'static [&'static str],
    pub values: &'static [f64],
    /// Places of the values that a quick run takes.
    pub quick: &'static [usize],
}

pub struct MapRow {
    pub name: &'static str,
    pub title: &'static str,
    pub sentence: &'static str,
    /// What is drawn as an outline.
    pub region: &'static str,
    /// What counts as failed.
    pub failed: &'static str,
    /// What the numbers are.
    pub measure: &'static str,
    pub panels: &'static [&'static str],
    pub columns: usize,
    pub x: MapAxis,
    pub y: MapAxis,
    pub run: fn(&str, f64, f64) -> Cell,
}

pub const MAPS: [MapRow; 11] = [
    MapRow {
        name: "substep",
        title: "Substep and damping",
        sentence: "a cantilever under a sudden load: 2 000 substeps of the scheme alone, and 400 steps of five as the FMU makes them",
        region: "substep up to the critical one: run as asked",
        failed: "past ten times the static displacement",
        measure: "",
        panels: &[
            "symplecticEuler, alone",
            "centralDifference, alone",
            "rungeKutta4, alone",
            "euler, alone",
            "implicitEuler, alone",
            "symplecticEuler, stepped",
            "centralDifference, stepped",
            "rungeKutta4, stepped",
            "euler, stepped",
            "implicitEuler, stepped",
        ],
        columns: 5,
        x: MapAxis {
            label: "substep × highest frequency",
            names: &[],
            values: &[
                0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 1.95, 2.05, 2.25, 2.5, 2.75, 3.0, 4.0, 8.0,
            ],
            quick: &[1, 7, 8, 14],
        },
        y: MapAxis {
            label: "damping ratio of the highest mode",
            names: &[],
            values: &[0.0, 0.05, 0.14, 0.35, 0.45, 0.7, 0.95],
            quick: &[0, 3],
        },
        run: substep,
    },
    MapRow {
        name: "compression",
        title: "Compression",
        sentence: "a block stuck between two plates, nu = 0.4, pressed in 0.3 s to a share of its height",
        region: "range to stay in: stableNeoHookean averaged everywhere, else down to 0.5; stVenantKirchhoff down to 0.75",
        failed: "a tetrahedron inside out, and not stopped",
        measure: "smallest det F",
        panels: &["pressed block"],
        columns: 1,
        x: MapAxis {
            label: "height, of that at rest",
            names: &[],
            values: &[
                0.9, 0.8, 0.75, 0.7, 0.65, 0.6, 0.55, 0.5, 0.45, 0.4, 0.3, 0.2,
            ],
            quick: &[0, 2, 7, 9],
        },
        y: MapAxis {
            label: "law and element",
            names: &[
                "linear, constantStrain",
                "linear, nodalAveraged",
                "stVenantKirchhoff, constantStrain",
                "stVenantKirchhoff, nodalPressure",
                "stVenantKirchhoff, nodalAveraged",
                "stableNeoHookean, constantStrain",
                "stableNeoHookean, nodalPressure",
                "stableNeoHookean, nodalAveraged",
            ],
            values: &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0],
            quick: &[0, 2, 5, 7],
        },
        run: compression,
    },
    MapRow {
        name: "poisson",
        title: "Poisson's ratio",
        sentence: "statics of a block of 8 x 8 x 6 cells stuck between two plates, pressed by 1 %, against nodal-averaged elements of half the size (past 0.49 as of 0.49)",
        region: "nodalAveraged: the default of laws for large deformation",
        failed: "force off by over 10 %, or substep below a quarter",
        measure: "force: its error in %; substep: the critical one, of constantStrain's at 0.3",
        panels: &["force", "substep"],
        columns: 2,
        x: MapAxis {
            label: "Poisson's ratio",
            names: &[],
            values: &[0.3, 0.4, 0.45, 0.49, 0.499, 0.4999],
            quick: &[0, 5],
        },
        y: MapAxis {
            label: "element",
            names: &["constantStrain", "nodalPressure", "nodalAveraged"],
            values: &[0.0, 1.0, 2.0],
            quick: &[0, 2],
        },
        run: poisson,
    },
    MapRow {
        name: "speed",
        title: "Communication step and speed of a tool",
        sentence: "a ball of 3 mm radius, 1.5 mm above a sheet of 4 mm, moved 12 mm down; stable neo-Hookean, 6 kPa, constant strain",
        region: "range to stay in: up to 1 m/s",
        failed: "a tetrahedron inside out, or tissue a quarter radius deep",
        measure: "deepest penetration in radii",
        panels: &["stick", "slide, friction 0.3"],
        columns: 2,
        x: MapAxis {
            label: "way of the ball in a communication step, in its radius",
            names: &[],
            values: &[0.1, 0.25, 0.5, 1.0, 2.0, 4.0],
            quick: &[2, 5],
        },
        y: MapAxis {
            label: "speed in m/s",
            names: &[],
            values: &[0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0],
            quick: &[3, 6],
        },
        run: speed,
    },
    MapRow {
        name: "threshold",
        title: "Threshold of adaptive tissue",
        sentence: "a cantilever swinging under its weight for 2 s without damping, linear below the threshold, St Venant-Kirchhoff above",
        region: "blend, substeps up to half of the critical one: what is chosen",
        failed: "energy balance off by over 5 %",
        measure: "change of the energy balance, % of the most energy there was",
        panels: &["blend", "perVertex"],
        columns: 2,
        x: MapAxis {
            label: "substep, of the critical one at rest",
            names: &[],
            values: &[0.1, 0.25, 0.5, 0.75, 0.9],
            quick: &[1, 2],
        },
        y: MapAxis {
            label: "threshold in mm",
            names: &[],
            values: &[0.5, 1.0, 1.5, 3.0, 8.0],
            quick: &[2],
        },
        run: threshold,
    },
    MapRow {
        name: "tearing",
        title: "Tear cascades",
        sentence: "a linear bar of 20 kPa held at one end and pulled off by a grasper at the other, torn past an elongation of 0.35",
        region: "a budget up to 4, which is the default",
        failed: "over half of the force lost in 1 ms",
        measure: "largest loss of force in 1 ms, % of the largest force",
        panels: &["pulled bar"],
        columns: 1,
        x: MapAxis {
            label: "budget in tetrahedra a haptic tick",
            names: &["1", "2", "4", "8", "16", "32", "any"],
            values: &[1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 1e6],
            quick: &[2, 6],
        },
        y: MapAxis {
            label: "speed in m/s",
            names: &[],
            values: &[0.05, 0.1, 0.2, 0.5, 1.0],
            quick: &[1],
        },
        run: tearing,
    },
    MapRow {
        name: "quality",
        title: "Stiffness and mesh quality",
        sentence: "a bar under its weight, its nodes moved at random, one half of it stiffer than the other (6 kPa); linear, constant strain",
        region: "substep chosen by the product",
        failed: "a tetrahedron inside out",
        measure: "critical substep, % of that of the regular mesh of one stiffness",
        panels: &["substep chosen", "substep of the regular mesh"],
        columns: 2,
        x: MapAxis {
            label: "smallest dihedral angle in degrees",
            names: &[],
            values: &[1.0, 2.0, 4.0, 8.0, 15.0, 30.0, map_points::REGULAR],
            quick: &[1, 3, 6],
        },
        y: MapAxis {
            label: "ratio of stiffness",
            names: &[],
            values: &[1.0, 4.0, 16.0, 64.0, 256.0],
            quick: &[0, 3],
        },
        run: map_points::quality,
    },
    MapRow {
        name: "interface",
        title: "Interface of a hybrid",
        sentence: "a cantilever under its weight for 3 s, its held half pre-computed, coupled each substep by all interface modes or the softest ones",
        region: "all modes: the default",
        failed: "equilibrium off by over 5 %",
        measure: "error of the mean deflection of the end, %",
        panels: &["lumped", "guyan"],
        columns: 2,
        x: MapAxis {
            label: "interface modes",
            names: &["0", "3", "6", "12", "24", "36", "all"],
            values: &[0.0, 3.0, 6.0, 12.0, 24.0, 36.0, 48.0],
            quick: &[0, 4, 6],
        },
        y: MapAxis {
            label: "damping in 1/s",
            names: &[],
            values: &[0.0, 1.0, 10.0, 100.0],
            quick: &[2],
        },
        run: map_points::interface,
    },
    MapRow {
        name: "delay",
        title: "Coupling delay of a hybrid",
        sentence: "the same cantilever let go, 1 s: the force of the pre-computed half is some substeps old at each substep, or kept for so many more",
        region: "no delay: coupled in each substep, as the product does",
        failed: "past ten times the static displacement, or the energy balance off",
        measure: "largest displacement, of the static one",
        panels: &["late", "kept"],
        columns: 2,
        x: MapAxis {
            label: "substeps",
            names: &[],
            values: &[0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0],
            quick: &[0, 1, 4],
        },
        y: MapAxis {
            label: "damping in 1/s",
            names: &[],
            values: &[0.0, 1.0, 10.0, 100.0, 1000.0],
            quick: &[2],
        },
        run: map_points::delay,
    },
    MapRow {
        name: "contact",
        title: "Sliding contact",
        sentence: "a ball of 6 mm radius pressed 2 mm into a block of linear tissue and drawn along it to where the block is held",
        region: "range to stay in: slower than shear waves (0.4 m/s at 500 Pa)",
        failed: "over 5 % of the work made by contact, or inside out",
        measure: "energy made by contact, % of the work",
        panels: &["friction 0", "friction 0.3", "friction 1"],
        columns: 3,
        x: MapAxis {
            label: "speed in m/s",
            names: &[],
            values: &[0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0],
            quick: &[2, 3, 6],
        },
        y: MapAxis {
            label: "Young's modulus in Pa",
            names: &[],
            values: &[500.0, 2000.0, 6000.0, 20000.0, 60000.0, 200000.0],
            quick: &[0, 2],
        },
        run: map_points::contact,
    },
    MapRow {
        name: "fragments",
        title: "Fragments",
        sentence: "some tetrahedra cut off the end of a bar that swings under its weight, falling for 0.24 s; as heavy as the bar, or a hundredth",
        region: "everywhere",
        failed: "momentum off by over 0.1 %, or inside out",
        measure: "momentum against weight times time, error in %",
        panels: &["as heavy", "light"],
        columns: 2,
        x: MapAxis {
            label: "tetrahedra",
            names: &[],
            values: &[1.0, 2.0, 3.0, 5.0, 10.0, 20.0],
            quick: &[0, 3, 5],
        },
        y: MapAxis {
            label: "law and element",
            names: &[
                "linear, constantStrain",
                "linear, nodalAveraged",
                "stVenantKirchhoff, constantStrain",
                "stVenantKirchhoff, nodalPressure",
                "stVenantKirchhoff, nodalAveraged",
                "stableNeoHookean, constantStrain",
                "stableNeoHookean, nodalPressure",
                "stableNeoHookean, nodalAveraged",
            ],
            values: &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0],
            quick: &[0, 5],
        },
        run: map_points::fragments,
    },
];

impl MapAxis {
    /// The values of a run, by their places.
    pub fn places(&self, quick: bool) -> Vec<usize> {
        match quick {
            true => self.quick.to_vec(),
            false => (0..self.values.len()).collect(),
        }
    }

    pub fn name(&self, place: usize) -> String {
        let value = || format!("{}", self.values[place]);
        self.names.get(place).map_or_else(value, |n| n.to_string())
    }
}

impl Cell {
    pub fn of(outcome: Outcome, safe: bool, symptom: impl Into<String>) -> Cell {
        Cell {
            outcome,
            value: None,
            safe,
            symptom: symptom.into(),
        }
    }

    /// A run that came to its end after so many halvings of a step, with a symptom or none.
    pub fn ended(halvings: u32, value: f64, safe: bool, symptom: Option<String>) -> Cell {
        Cell {
            outcome: match (&symptom, halvings) {
                (Some(_), _) => Outcome::Failed,
                (None, 0) => Outcome::Stable,
                (None, _) => Outcome::Halved,
            },
            value: Some(value),
            safe,
            symptom: match symptom {
                Some(symptom) => symptom,
                None if halvings > 0 => format!("halved up to {halvings} times"),
                None => String::new(),
            },
        }
    }
}

pub fn model(text: &str) -> Result<Arc<Model>, String> {
    let scene = tissue::scene::parse(text, "map").map_err(|e| e.to_string())?;
    let model = tissue::prepared::prepare(scene, Path::new("map")).map_err(|e| e.to_string())?;
    Ok(Arc::new(model))
}

/// What a watchdog says, as far as it differs from point to point.
pub fn stopped(error: &StepError) -> String {
    match error {
        StepError::Unstable(..) => "substep out of reach of four halvings".into(),
        StepError::NonFinite(at) => format!("not finite at {:.0} ms", 1e3 * at),
        StepError::Energy(at, _) => format!("energy balance off at {:.0} ms", 1e3 * at),
        StepError::Inverted(at, ratio) => format!("det F {ratio:.3} at {:.0} ms", 1e3 * at),
        other => other.to_string(),
    }
}

/// A cell of what cannot be run, else of what was.
pub fn cell(found: Result<Cell, String>) -> Cell {
    found.unwrap_or_else(|e| Cell::of(Outcome::Refused, false, e))
}

/// Displacements past so many times the static ones are growth, not swinging: a mode swings to twice.
pub const GROWN: f64 = 10.0;

fn substep(panel: &str, omega_h: f64, zeta: f64) -> Cell {
    let (scheme, how) = panel.split_once(", ").unwrap_or((panel, ""));
    let text = |integration: &str| {
        format!(
            r#"{{"name": "bar", "mesh": {{"box": {{"size": [0.1, 0.02, 0.02], "cells": [10, 2, 2]}}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": 20000, "poissonRatio": 0.45, "density": 1000}}],
            "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}], "gravity": [0, 0, 0],
            "loads": [{{"where": {{"sphere": {{"center": [0.1, 0, 0], "radius": 1e-4}}}}, "force": [0.001, -0.002, 0.005]}}],
            "integration": {{{integration}}}}}"#
        )
    };
    cell((|| {
        let plain = model(&text(r#""scheme": "centralDifference""#))?;
        let omega = plain.spectrum.highest;
        let (h, damping) = (omega_h / omega, 2.0 * zeta * omega);
        let model = model(&text(&format!(
            r#""scheme": "{scheme}", "damping": {damping:e}, "substep": {h:e}, "hapticRate": {:e}"#,
            1.0 / h
        )))?;
        let safe = h <= model.critical_step(damping);
        let at_rest = reference::solve(&plain, false).map_err(|e| e.to_string())?;
        let largest = |u: &mut dyn Iterator<Item = Vec3>| u.map(|u| u.norm()).fold(0.0, f64::max);
        let scale = largest(&mut at_rest.displacement.iter().map(|u| Vec3::from(*u)));
        if how == "stepped" {
            let mut s = Simulation::new(model);
            let mut halvings = 0;
            let mut most = 0.0f64;
            for _ in 0..400 {
                if let Err(e) = s.step(5.0 * h) {
                    return Ok(Cell::of(Outcome::Discarded, safe, stopped(&e)));
                }
                halvings = halvings.max(s.halvings());
                most = most.max(largest(&mut s.state().displacement.iter().map(|u| u.xyz())));
            }
            let grown = (most >= GROWN * scale).then(|| format!("grew to {:.1e}", most / scale));
            return Ok(Cell::ended(halvings, most / scale, safe, grown));
        }
        let mut state = State::new(&model);
        let mut work = Workspace::new(&model, &state);
        let mut most = 0.0f64;
        for k in 0..100 {
            if let Err(e) = advance(&model, &mut state, &mut work, 20, h) {
                let symptom = format!("within {} substeps: {}", 20 * (k + 1), stopped(&e));
                return Ok(Cell::of(Outcome::Failed, safe, symptom));
            }
            most = most.max(largest(&mut state.displacement.iter().map(|u| u.xyz())));
            if most.is_nan() || most >= GROWN * scale {
                let symptom = format!("grew to {:.1e} in {} substeps", most / scale, 20 * (k + 1));
                return Ok(Cell::of(Outcome::Failed, safe, symptom));
            }
        }
        Ok(Cell::ended(0, most / scale, safe, None))
    })())
}

pub const LAWS: [[&str; 2]; 8] = [
    ["linear", "constantStrain"],
    ["linear", "nodalAveraged"],
    ["stVenantKirchhoff", "constantStrain"],
    ["stVenantKirchhoff", "nodalPressure"],
    ["stVenantKirchhoff", "nodalAveraged"],
    ["stableNeoHookean", "constantStrain"],
    ["stableNeoHookean", "nodalPressure"],
    ["stableNeoHookean", "nodalAveraged"],
];

/// A block of 40 x 40 x 30 mm between two plates, the upper one moved down.
fn block(
    cells: [usize; 3],
    nu: f64,
    [law, element]: [&str; 2],
    down: f64,
    ramp: f64,
) -> Result<Arc<Model>, String> {
    model(&format!(
        r#"{{"name": "block", "mesh": {{"box": {{"size": [0.04, 0.04, 0.03], "cells": {cells:?}}}}},
        "materials": [{{"where": {{"all": true}}, "youngModulus": 6000, "poissonRatio": {nu}, "density": 1060}}],
        "fixed": [{{"box": {{"min": [0, 0, 0], "max": [1, 1, 0]}}}}], "gravity": [0, 0, 0],
        "prescribed": [{{"where": {{"box": {{"min": [0, 0, 0.03], "max": [1, 1, 0.03]}}}}, "displacement": [0, 0, {}], "ramp": {ramp}}}],
        "integration": {{"scheme": "symplecticEuler"}},
        "model": {{"elasticity": "{law}", "element": "{element}"}}}}"#,
        -down
    ))
}

fn compression(_: &str, height: f64, row: f64) -> Cell {
    cell((|| {
        let kind = LAWS[row as usize];
        let safe = match kind[0] {
            "stableNeoHookean" => height >= 0.5 || kind[1] == "nodalAveraged",
            "stVenantKirchhoff" => height >= 0.75,
            _ => false,
        };
        let model = block([8, 8, 6], 0.4, kind, 0.03 * (1.0 - height), 0.3)?;
        let mut s = Simulation::new(model);
        let (mut least, mut halvings) = (1.0f64, 0);
        for _ in 0..400 {
            if let Err(e) = s.step(1e-3) {
                return Ok(Cell::of(Outcome::Discarded, safe, stopped(&e)));
            }
            least = least.min(s.minimum_volume_ratio());
            halvings = halvings.max(s.halvings());
        }
        let inverted = (least <= 0.0).then(|| format!("minimumVolumeRatio {least:.2}"));
        Ok(Cell::ended(halvings, least, safe, inverted))
    })())
}

/// Errors of the force past so many per cent count as locking.
const LOCKED: f64 = 10.0;

fn poisson(panel: &str, nu: f64, row: f64) -> Cell {
    let elements = ["constantStrain", "nodalPressure", "nodalAveraged"];
    let element = elements[row as usize];
    let safe = element == "nodalAveraged";
    cell((|| {
        let of = |cells, nu, element| block(cells, nu, ["linear", element], 3e-4, 0.0);
        let (coarse, fine) = ([8, 8, 6], [16, 16, 12]);
        let model = of(coarse, nu, element)?;
        if panel == "substep" {
            let longest = of(coarse, 0.3, elements[0])?;
            let share = model.critical_step(0.0) / longest.critical_step(0.0);
            let short =
                (share < 0.25).then(|| format!("critical substep {share:.3} times as long"));
            return Ok(Cell::ended(0, share, safe, short));
        }
        let force = |model: &Model| -> Result<f64, String> {
            let found = reference::solve(model, false).map_err(|e| e.to_string())?;
            let mesh = model.scene_mesh();
            let above = (found.reaction.iter()).filter(|(v, _)| mesh.nodes[**v as usize].z > 0.015);
            Ok(above.map(|(_, f)| f[2]).sum())
        };
        // What constant strain has no limit for, averaged elements compute with 0.49.
        let truth = force(&*of(fine, nu, elements[2])?)?;
        let error = 100.0 * (force(&model)? / truth - 1.0);
        let locked = (error.abs() > LOCKED).then(|| format!("force off by {error:+.1} %"));
        Ok(Cell::ended(0, error, safe, locked))
    })())
}

/// Of the ball \[m\].
const RADIUS: f64 = 0.003;

fn speed(panel: &str, way: f64, speed: f64) -> Cell {
    let friction = if panel == "stick" { "\"stick\"" } else { "0.3" };
    let step = way * RADIUS / speed;
    cell((|| {
        let model = model(&format!(
            r#"{{"name": "sheet", "mesh": {{"box": {{"size": [0.06, 0.06, 0.004], "cells": [20, 20, 2]}}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}}],
            "fixed": [{{"not": {{"box": {{"min": [0.001, 0.001, -1], "max": [0.059, 0.059, 1]}}}}}}],
            "gravity": [0, 0, 0], "model": {{"elasticity": "stableNeoHookean", "element": "constantStrain"}},
            "tools": [{{"name": "probe", "kind": "probe", "shape": {{"sphere": {{"radius": {RADIUS}}}}},
            "friction": {friction}, "position": [0.0307, 0.0302, 0.0085]}}]}}"#
        ))?;
        let safe = speed <= 1.0;
        let mut s = Simulation::new(model);
        let (mut deep, mut least, mut halvings) = (0.0f64, 1.0f64, 0);
        for k in 1..=(4.0 / way).round() as u32 {
            s.set_pose_input(0, 2, 0.0085 - way * RADIUS * f64::from(k));
            if let Err(e) = s.step(step) {
                return Ok(Cell::of(Outcome::Discarded, safe, stopped(&e)));
            }
            deep = deep.max(deepest(&s, RADIUS) / RADIUS);
            least = least.min(s.minimum_volume_ratio());
            halvings = halvings.max(s.halvings());
        }
        let symptom = if least <= 0.0 {
            Some(format!("minimumVolumeRatio {least:.2}"))
        } else if deep > 0.25 {
            Some(format!("tissue {deep:.2} radii inside the tool"))
        } else {
            None
        };
        Ok(Cell::ended(halvings, deep, safe, symptom))
    })())
}

/// Of any vertex or middle of a triangle of the surface \[m\].
pub fn deepest(s: &Simulation, radius: f64) -> f64 {
    let (model, state) = (s.model(), s.state());
    let centre = state.tools[0].pose.position;
    let mut deepest = 0.0f64;
    for face in &state.live.surface {
        let x = state.live.triangle(model, *face).map(|v| state.position(v));
        let middle = (x[0] + x[1] + x[2]) / 3.0;
        for place in x.iter().chain([&middle]) {
            deepest = deepest.max(radius - (place - centre).norm());
        }
    }
    deepest
}

fn threshold(panel: &str, share: f64, threshold: f64) -> Cell {
    let text = |more: &str| {
        format!(
            r#"{{"name": "bar", "mesh": {{"box": {{"size": [0.1, 0.02, 0.02], "cells": [10, 2, 2]}}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": 20000, "poissonRatio": 0.4, "density": 1000}}],
            "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}], "gravity": [0, 0, -4],
            "model": {{"elasticity": "stVenantKirchhoff", "adaptive": "{panel}", "nonlinearThreshold": {}}},
            "integration": {{"damping": 0{more}}}}}"#,
            1e-3 * threshold
        )
    };
    cell((|| {
        let critical = model(&text(""))?.critical_step(0.0);
        let h = share * critical;
        let model = model(&text(&format!(
            r#", "substep": {h:e}, "hapticRate": {:e}"#,
            0.5 / h
        )))?;
        let safe = panel == "blend" && share <= 0.5;
        let mut s = Simulation::new(model);
        let (mut scale, mut drift, mut halvings) = (0.0f64, 0.0f64, 0);
        while s.time() < 2.0 {
            if let Err(e) = s.step(20.0 * h) {
                return Ok(Cell::of(Outcome::Discarded, safe, stopped(&e)));
            }
            let energy = s.energy();
            scale = scale.max(energy.elastic + energy.kinetic);
            drift = drift.max((energy.balance() - s.state().account.start).abs());
            halvings = halvings.max(s.halvings());
        }
        let percent = 100.0 * drift / scale;
        let off = (percent > 5.0).then(|| format!("energy balance {percent:.1} % off"));
        Ok(Cell::ended(halvings, percent, safe, off))
    })())
}

/// Losing more than this share of the force in a millisecond is a cascade \[%\].
const CASCADE: f64 = 50.0;

fn tearing(_: &str, budget: f64, speed: f64) -> Cell {
    cell((|| {
        let model = model(&format!(
            r#"{{"name": "bar", "mesh": {{"box": {{"size": [0.1, 0.02, 0.02], "cells": [15, 3, 3]}}}},
            "materials": [{{"where": {{"all": true}}, "youngModulus": 20000, "poissonRatio": 0.4, "density": 1000}}],
            "fixed": [{{"box": {{"min": [0, 0, 0], "max": [0, 1, 1]}}}}], "gravity": [0, 0, 0],
            "tearing": {{"criterion": "maximumElongation", "threshold": 0.35, "budget": {budget}}},
            "tools": [{{"name": "grasper", "kind": "grasper", "shape": {{"sphere": {{"radius": 0.02}}}},
            "position": [0.112, 0.01, 0.01]}}]}}"#
        ))?;
        let safe = budget <= 4.0;
        let mut s = Simulation::new(model);
        s.set_active(0, true);
        let (mut force, mut most, mut loss) = (0.0f64, 0.0f64, 0.0f64);
        let (mut removed, mut cascade, mut halvings) = (0, 0, 0);
        let steps = (0.08 / (1e-3 * speed)).ceil() as u32;
        for k in 0..steps {
            s.set_pose_input(0, 0, 0.112 + speed * 1e-3 * f64::from(k));
            if let Err(e) = s.step(1e-3) {
                return Ok(Cell::of(Outcome::Discarded, safe, stopped(&e)));
            }
            let now = s.tool(0).force.norm();
            (most, loss) = (most.max(now), loss.max(force - now));
            force = now;
            let gone = s.state().live.removed.len();
            (cascade, removed) = (cascade.max(gone - removed), gone);
            halvings = halvings.max(s.halvings());
        }
        let percent = 100.0 * loss / most;
        let jump = (percent > CASCADE)
            .then(|| format!("{percent:.0} % of the force lost in 1 ms, {cascade} tetrahedra"));
        let mut cell = Cell::ended(halvings, percent, safe, jump);
        if cell.outcome == Outcome::Stable {
            cell.symptom = format!("{cascade} tetrahedra in 1 ms at most, {removed} in all");
        }
        Ok(cell)
    })())
}

/// A point of a map, by the places of its values.
pub struct Found {
    pub panel: usize,
    pub x: usize,
    pub y: usize,
    pub cell: Cell,
}

/// Runs a map.
pub fn run(map: &MapRow, quick: bool, mut done: impl FnMut()) -> Vec<Found> {
    let mut found = Vec::new();
    for (panel, name) in map.panels.iter().enumerate() {
        for y in map.y.places(quick) {
            for x in map.x.places(quick) {
                let cell = (map.run)(name, map.x.values[x], map.y.values[y]);
                found.push(Found { panel, x, y, cell });
                done();
            }
        }
    }
    found
}

pub const HEADER: &str = "map,panel,x,y,outcome,value,safe,symptom";

/// Rows of the CSV.
pub fn csv(map: &MapRow, found: &[Found]) -> String {
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let row = |f: &Found| {
        let cell = &f.cell;
        let value = cell.value.map_or(String::new(), |v| format!("{v:.4e}"));
        format!(
            "{},{},{},{},{},{value},{},{}\n",
            map.name,
            quoted(map.panels[f.panel]),
            quoted(&map.x.name(f.x)),
            quoted(&map.y.name(f.y)),
            cell.outcome.name(),
            cell.safe,
            quoted(&cell.symptom)
        )
    };
    found.iter().map(row).collect()
}
