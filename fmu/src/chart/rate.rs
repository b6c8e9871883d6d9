//! How much tissue runs at 1 kHz: a liver that is pulled, cut and left at rest, stepped through the FMU's C interface.
//!
//! One step is all that a host does in a millisecond: poses set, `fmi2DoStep`, forces read.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use indicatif::ProgressBar;
use tissue::calibration::Calibration;
use tissue::prepared::{self, PrepareError};

use super::measure::quantile;
use crate::drive::Host;
use crate::error::Error;
use crate::motion::Motion;
use crate::pack::pack;

/// Communication step \[s\].
const STEP: f64 = 1e-3;
/// Runs of a scene, the same to the bit: what the machine did beside a step is in one of them, the step in all.
const RUNS: usize = 3;
/// Sizes are taken from a ladder: edges from one step to the next, so that tetrahedra are a tenth more.
const FINER: f64 = 0.9686;

/// A model whose largest mesh is sought.
pub struct RateRow {
    pub name: &'static str,
    /// `model` of the scene.
    pub model: &'static str,
    /// Edges with which it surely holds and with which it surely does not \[m\].
    pub from: f64,
    pub to: f64,
}

const TIP: &str = r#""dynamic": {"halfSpace": {"point": [0.094, 0, 0], "normal": [1, 0, 0]}}, "touchable": {"sphere": {"center": [0.094, 0, 0], "radius": 0.03}}"#;

/// `TIP` stands for the tip of the left lobe, the only part that tools reach.
pub const RATES: [RateRow; 5] = [
    RateRow {
        name: "linear",
        model: "",
        from: 0.013,
        to: 0.0065,
    },
    RateRow {
        name: "St Venant-Kirchhoff, averaged",
        model: r#""elasticity": "stVenantKirchhoff""#,
        from: 0.016,
        to: 0.0095,
    },
    RateRow {
        name: "neo-Hookean, averaged",
        model: r#""elasticity": "stableNeoHookean""#,
        from: 0.016,
        to: 0.0095,
    },
    RateRow {
        name: "hybrid, linear tip",
        model: r#""kind": "hybrid", TIP"#,
        from: 0.008,
        to: 0.0045,
    },
    RateRow {
        name: "hybrid, linear tip, 60 modes",
        model: r#""kind": "hybrid", "interfaceModes": 60, TIP"#,
        from: 0.008,
        to: 0.0045,
    },
];

/// What a scene took.
pub struct Rate {
    pub name: String,
    pub vertices: usize,
    pub tetrahedra: usize,
    pub dynamic: usize,
    /// A step, in the mean.
    pub substeps: f64,
    pub removed: i32,
    pub steps: usize,
    /// Wall time of a step \[s\]: the middle one, and what 99 and 99.9 % stay below, of each step the shortest of all runs.
    pub median: f64,
    pub p99: f64,
    pub p999: f64,
    pub longest: f64,
    /// 99.9 % of one run, the middle one of the runs.
    pub single: f64,
    /// \[s\]
    pub calibration: f64,
    pub verdict: String,
}

pub const HEADER: &str = "what,vertices,tetrahedra,dynamic,substeps,removed,steps,median_us,p99_us,p999_us,longest_us,p999OfOneRun_us,calibration_us,verdict";

impl Rate {
    pub fn holds(&self) -> bool {
        self.p999 < STEP
    }

    /// For people.
    pub fn line(&self) -> String {
        format!(
            "{}: {} tetrahedra, {:.2} us, 99.9 % below {:.2} us, {} removed: {}",
            self.name,
            self.tetrahedra,
            1e6 * self.median,
            1e6 * self.p999,
            self.removed,
            self.verdict
        )
    }

    pub fn csv(&self) -> String {
        let us = [
            self.median,
            self.p99,
            self.p999,
            self.longest,
            self.single,
            self.calibration,
        ]
        .map(|s| format!("{:.4}", 1e6 * s));
        format!(
            "\"{}\",{},{},{},{:.3},{},{},{},\"{}\"\n",
            self.name,
            self.vertices,
            self.tetrahedra,
            self.dynamic,
            self.substeps,
            self.removed,
            self.steps,
            us.join(","),
            self.verdict
        )
    }
}

/// The liver of 6 kPa, without weight, held at the middle of its back.
fn scene(edge: f64, model: &str, vertices: &str) -> String {
    let model = model.replace("TIP", TIP);
    format!(
        r#"{{"name": "organ", "mesh": {{"liver": {{"edgeLength": {edge}}}}},
        "materials": [{{"where": {{"all": true}}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}}],
        "fixed": [{{"box": {{"min": [-0.1, 0.02, 0.0], "max": [0.03, 0.2, 0.2]}}}}], "gravity": [0, 0, 0],
        "integration": {{"damping": 20}}, "model": {{{model}}}, "outputs": {{"vertices": "{vertices}"}},
        "tools": [
        {{"name": "grasper", "kind": "grasper", "shape": {{"capsule": {{"radius": 0.004, "length": 0.25}}}}, "activeLength": 0.012,
        "position": [0.17, -0.04, 0.06], "orientation": [0.366351, -0.382972, -0.848009, 0]}},
        {{"name": "cautery", "kind": "cautery", "shape": {{"capsule": {{"radius": 0.003, "length": 0.25}}}}, "activeLength": 0.12,
        "position": [0.15, -0.17, 0.05], "orientation": [0.126074, -0.870891, 0.475031, 0]}}]}}"#
    )
}

/// The grasper takes the tip of the left lobe and pulls; the cautery goes through between it and the rest, and is taken away.
const MOTION: &str = "\
time,tool[1].position.x,tool[1].position.y,tool[1].position.z,tool[1].active,tool[2].position.x,tool[2].position.y,tool[2].position.z,tool[2].active
0,0.17,-0.04,0.06,false,0.15,-0.17,0.05,false
0.5,0.124,-0.018,-0.004,false,0.15,-0.17,0.05,false
0.6,0.124,-0.018,-0.004,true,0.15,-0.17,0.05,false
1.5,0.128,-0.02,0.008,true,0.114,-0.1,-0.04,false
1.7,0.128,-0.02,0.008,true,0.114,-0.085,-0.04,true
4.2,0.13,-0.02,0.01,true,0.114,0.06,-0.04,true
4.3,0.13,-0.02,0.01,true,0.114,0.065,-0.04,false
5.0,0.14,-0.03,0.03,true,0.114,0.1,0.06,false
";

/// Of [`MOTION`] \[s\].
const END: f64 = 5.0;

/// An FMU of a scene, in a folder of its own.
struct Packed {
    folder: tempfile::TempDir,
    vertices: usize,
    tetrahedra: usize,
    dynamic: usize,
}

impl Packed {
    fn new(text: &str) -> Result<Packed, Error> {
        let scene = tissue::scene::parse(text, "organ").map_err(PrepareError::from)?;
        let model = Arc::new(prepared::prepare(scene, Path::new("organ"))?);
        let folder = tempfile::tempdir().map_err(|e| Error::File("organ".into(), e))?;
        pack(&model, &folder.path().join("organ.fmu"))?;
        Ok(Packed {
            vertices: model.mesh.nodes.len(),
            tetrahedra: model.shape.len(),
            dynamic: model.parts.dynamic.iter().filter(|d| **d).count(),
            folder,
        })
    }

    fn start(&self) -> Result<Host, Error> {
        Host::start(&self.folder.path().join("organ.fmu"))
    }
}

/// One run: wall time of each step \[s\], substeps and tetrahedra removed.
fn drive(packed: &Packed, motion: &str, stop: f64) -> Result<(Vec<f64>, i32, i32), Error> {
    let mut host = packed.start()?;
    let motion = Motion::from_text(motion, &host)
        .map_err(|e| Error::Content("motion of the liver".into(), e))?;
    motion.apply(&host, 0.0, 0.0)?;
    host.initialised()?;
    let forces = references(&host, |name| name.contains("].force."));
    let mut read = vec![0.0; forces.len()];
    let steps = (stop / STEP).round() as usize;
    let mut times = Vec::with_capacity(steps);
    for k in 1..=steps {
        let begun = Instant::now();
        let end = STEP * k as f64;
        motion.apply(&host, host.time(), end)?;
        host.step_to(end)?;
        host.reals(&forces, &mut read)?;
        times.push(begun.elapsed().as_secs_f64());
    }
    let substeps = count(&host, "diagnostics.substeps")?;
    let removed = count(&host, "topology.removedTetrahedra")?;
    host.finish()?;
    Ok((times, substeps, removed))
}

fn count(host: &Host, name: &str) -> Result<i32, Error> {
    let mut value = [0];
    host.integers(&references(host, |n| n == name), &mut value)?;
    Ok(value[0])
}

fn references(host: &Host, which: impl Fn(&str) -> bool) -> Vec<u32> {
    let of = host.variables().iter().filter(|v| which(&v.name));
    of.map(|v| v.reference).collect()
}

/// A model on a mesh of such edges, all runs.
fn measure(row: &RateRow, edge: f64, runs: usize) -> Result<Rate, Error> {
    let packed = Packed::new(&scene(edge, row.model, "surface"))?;
    let mut calibration = Calibration::default();
    let (mut each, mut singles, mut machine) = (Vec::new(), Vec::new(), Vec::new());
    let (mut substeps, mut removed) = (0, 0);
    for _ in 0..runs {
        machine.push(calibration.seconds(101));
        let times;
        (times, substeps, removed) = drive(&packed, MOTION, END)?;
        singles.push(quantile(&times, 0.999));
        match each.is_empty() {
            true => each = times,
            false => (each.iter_mut().zip(times)).for_each(|(a, b): (&mut f64, _)| *a = a.min(b)),
        }
    }
    let p999 = quantile(&each, 0.999);
    Ok(Rate {
        name: row.name.into(),
        vertices: packed.vertices,
        tetrahedra: packed.tetrahedra,
        dynamic: packed.dynamic,
        substeps: f64::from(substeps) / each.len() as f64,
        removed,
        steps: each.len(),
        median: quantile(&each, 0.5),
        p99: quantile(&each, 0.99),
        p999,
        longest: quantile(&each, 1.0),
        single: quantile(&singles, 0.5),
        calibration: quantile(&machine, 0.5),
        verdict: if p999 < STEP { "holds" } else { "too slow" }.into(),
    })
}

/// All trials of the search for the largest mesh of each model, told as they come.
pub fn largest(
    quick: bool,
    progress: &ProgressBar,
    mut found: impl FnMut(Rate) -> Result<(), Error>,
) -> Result<(), Error> {
    for row in &RATES {
        progress.set_message(row.name);
        if quick {
            found(measure(row, 0.015, 1)?)?;
            progress.inc(1);
            continue;
        }
        // By halving, on the ladder.
        let rungs = ((row.to / row.from).ln() / FINER.ln()).round() as i32;
        let (mut low, mut high) = (-1, rungs);
        while high - low > 1 {
            let middle = (low + high) / 2;
            let edge = row.from * FINER.powi(middle);
            let rate = measure(row, edge, RUNS)?;
            match rate.holds() {
                true => low = middle,
                false => high = middle,
            }
            found(rate)?;
        }
        progress.inc(1);
    }
    Ok(())
}

/// Trials of a timing, and steps in each.
const ROUNDS: usize = 201;
const REPEATS: usize = 20;

/// Scenes at rest: asleep; and kept awake, with vertices among the variables that nobody reads, and with all of them read.
pub fn at_rest(quick: bool) -> Result<Vec<Rate>, Error> {
    let of = |vertices: &str| Packed::new(&scene(0.015, "", vertices));
    let (none, surface, all) = (of("none")?, of("surface")?, of("all")?);
    let cases = [
        ("asleep", &all, false),
        ("awake, no vertices", &none, false),
        ("awake, surface unread", &surface, false),
        ("awake, all vertices unread", &all, false),
        ("awake, all vertices read", &all, true),
    ];
    let mut hosts = Vec::new();
    for (name, packed, is_read) in cases {
        let mut host = packed.start()?;
        host.initialised()?;
        let damping = host.variable("integration.damping").cloned();
        let damping = damping.filter(|_| name != "asleep");
        let read = references(&host, |name| is_read && name.contains(".vertex["));
        // Until it sleeps.
        for k in 1..=20 {
            host.step_to(0.1 * f64::from(k))?;
        }
        hosts.push((host, damping, read));
    }
    let mut calibration = Calibration::default();
    let mut machine = Vec::new();
    let rounds = if quick { 21 } else { ROUNDS };
    let mut times = vec![Vec::with_capacity(rounds); hosts.len()];
    for round in 0..rounds {
        machine.push(calibration.seconds(3));
        for ((host, damping, read), times) in hosts.iter_mut().zip(&mut times) {
            let mut values = vec![0.0; read.len()];
            let begun = Instant::now();
            for k in 0..REPEATS {
                if let Some(damping) = damping {
                    let other = 20.0 + ((round * REPEATS + k) % 2) as f64;
                    host.set(damping, other)?;
                }
                host.step_to(host.time() + STEP)?;
                if !read.is_empty() {
                    host.reals(read, &mut values)?;
                }
            }
            times.push(begun.elapsed().as_secs_f64() / REPEATS as f64);
        }
    }
    let mut rates = Vec::new();
    for ((name, packed, _), times) in cases.iter().zip(&times) {
        rates.push(Rate {
            name: (*name).into(),
            vertices: packed.vertices,
            tetrahedra: packed.tetrahedra,
            dynamic: packed.dynamic,
            substeps: 0.0,
            removed: 0,
            steps: rounds * REPEATS,
            median: quantile(times, 0.5),
            p99: quantile(times, 0.99),
            p999: quantile(times, 0.999),
            longest: quantile(times, 1.0),
            single: quantile(times, 0.999),
            calibration: quantile(&machine, 0.5),
            verdict: "at rest".into(),
        });
    }
    for (host, ..) in hosts {
        host.finish()?;
    }
    Ok(rates)
}
