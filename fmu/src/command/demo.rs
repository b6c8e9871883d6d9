//! `demo`: the papers' experiment in small, through the FMU's C interface.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use super::{bar, say, spinner};
use crate::drive::Host;
use crate::error::Error;
use crate::motion::Motion;
use crate::pack::pack;
use crate::picture::{
    Axis, Chart, Event, Figure, PALETTE, Panel, Scale, Series as Line, Style, Surface, Tint,
    ToolLook, ToolPose, View,
};
use crate::recorder::{Frame, Series, SurfaceReader, Table};
use crate::write;

const SCENE: &str = include_str!("../../../examples/hepatectomy.json");
const MOTION: &str = include_str!("../../../examples/hepatectomy.csv");
/// Communication step \[s\].
const STEP: f64 = 1e-3;
/// Steps from one ParaView frame to the next.
const EVERY: u64 = 50;
/// Times of the three panels \[s\].
const PANELS: [f64; 3] = [0.2, 2.7, 5.0];
const CAPTIONS: [&str; 3] = ["Before", "Pulled and cut", "Segment in the grasper"];

/// What is drawn of a tool.
struct Look {
    look: ToolLook,
    radius: f64,
    /// Of the shaft in the world.
    axis: [f64; 3],
}

pub fn run(output: &Path) -> Result<(), Error> {
    let progress = spinner("preparing the liver".to_string());
    let scene = tissue::scene::parse(SCENE, "hepatectomy.json")
        .map_err(tissue::prepared::PrepareError::from)?;
    let looks = [
        look(&scene.tools[0], ToolLook::Grasper),
        look(&scene.tools[1], ToolLook::Cautery),
    ];
    let model = Arc::new(tissue::prepared::prepare(
        scene,
        Path::new("hepatectomy.json"),
    )?);
    let fmu = output.join("hepatectomy.fmu");
    pack(&model, &fmu)?;
    progress.finish_and_clear();

    let mut host = Host::start(&fmu)?;
    let motion = Motion::from_text(MOTION, &host).map_err(Error::Simulation)?;
    motion.apply(&host, 0.0, 0.0)?;
    host.initialised()?;
    let (reader, mut table) = (SurfaceReader::new(&host), Table::new(&host));
    let mut series = Series::new(output, "hepatectomy");
    let steps = (motion.end() / STEP).round() as u64;
    let panel_steps = PANELS.map(|t| (t / STEP).round() as u64);
    let mut panels: Vec<(Frame, Vec<[f64; 3]>)> = Vec::new();
    let first = reader.read(&host)?;
    series.add(0.0, &first)?;
    table.record(&host)?;
    let progress = bar(steps, "simulating");
    let mut seconds = 0.0;
    for k in 1..=steps {
        let end = k as f64 * STEP;
        motion.apply(&host, host.time(), end)?;
        let start = Instant::now();
        host.step_to(end)?;
        seconds += start.elapsed().as_secs_f64();
        table.record(&host)?;
        if k % EVERY == 0 {
            series.add(end, &reader.read(&host)?)?;
        }
        if panel_steps.contains(&k) {
            panels.push((reader.read(&host)?, tips(&host, looks.len())?));
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    host.finish()?;
    table.write(&output.join("results.csv"))?;
    series.finish()?;
    let progress = spinner("drawing".to_string());
    let picture = draw(&looks, &first, &panels, &table, model.shape.len())
        .map_err(|e| Error::Simulation(e.to_string()))?;
    let path = output.join("hepatectomy.svg");
    write::whole(&path, |out| {
        std::io::Write::write_all(out, picture.as_bytes())
    })?;
    progress.finish_and_clear();
    say(&summary(output, &table, steps, seconds))
}

fn look(tool: &tissue::scene::Tool, look: ToolLook) -> Look {
    let radius = match tool.shape {
        tissue::scene::Shape::Capsule { radius, .. } | tissue::scene::Shape::Sphere { radius } => {
            radius
        }
        tissue::scene::Shape::Compound(_) => 0.003,
    };
    let [w, x, y, z] = tool.orientation;
    let turn = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
    Look {
        look,
        radius,
        axis: (turn * -nalgebra::Vector3::z()).into(),
    }
}

/// Positions of the tools.
fn tips(host: &Host, count: usize) -> Result<Vec<[f64; 3]>, Error> {
    (1..=count)
        .map(|k| {
            let mut tip = [0.0; 3];
            for (axis, value) in ["x", "y", "z"].iter().zip(&mut tip) {
                if let Some(v) = host.variable(&format!("tool[{k}].position.{axis}")) {
                    host.reals(&[v.reference], std::slice::from_mut(value))?;
                }
            }
            Ok(tip)
        })
        .collect()
}

fn draw(
    looks: &[Look],
    first: &Frame,
    panels: &[(Frame, Vec<[f64; 3]>)],
    table: &Table,
    tetrahedra: usize,
) -> Result<String, png::EncodingError> {
    let key = |t: &[u32; 3]| {
        let mut key = *t;
        key.sort_unstable();
        key
    };
    let skin: std::collections::HashSet<[u32; 3]> = first.triangles.iter().map(key).collect();
    let tints: Vec<Vec<f32>> = panels
        .iter()
        .map(|(frame, _)| {
            frame
                .triangles
                .iter()
                .map(|t| if skin.contains(&key(t)) { 0.0 } else { 1.0 })
                .collect()
        })
        .collect();
    let active = [1, 2].map(|k| table.column(&format!("tool[{k}].active")));
    let tools: Vec<Vec<ToolPose>> = (panels.iter().zip(PANELS))
        .map(|((_, tips), time)| {
            (looks.iter().zip(tips).zip(&active).enumerate())
                .map(|(k, ((look, tip), active))| ToolPose {
                    look: look.look,
                    position: *tip,
                    axis: look.axis,
                    radius: look.radius,
                    length: 0.25,
                    active: active
                        .iter()
                        .any(|[t, on]| (t - time).abs() < 0.5 * STEP && *on > 0.5),
                    accent: PALETTE[k],
                })
                .collect()
        })
        .collect();
    // The organ, the grasper's tip and a little of its shaft fill the frame.
    let mut shown: Vec<[f64; 3]> = first
        .triangles
        .iter()
        .flatten()
        .map(|v| first.vertices[*v as usize])
        .collect();
    for (_, tips) in panels {
        shown.push(tips[0]);
        shown.push([0, 1, 2].map(|a| tips[0][a] + 0.03 * looks[0].axis[a]));
    }
    let view = View::framing([0.45, -1.0, 0.5], [0.0, 0.0, 1.0], 9.0 / 7.0, &shown);
    let notes: Vec<String> = PANELS.iter().map(|t| format!("t = {t} s")).collect();
    let panels: Vec<Panel> = (0..panels.len())
        .map(|k| Panel {
            surface: Surface {
                vertices: &panels[k].0.vertices,
                triangles: &panels[k].0.triangles,
                tint: Tint::Triangles(&tints[k]),
            },
            tools: &tools[k],
            caption: CAPTIONS[k],
            note: &notes[k],
        })
        .collect();
    let subtitle = format!(
        "{tetrahedra} tetrahedra, linear tensor-mass model, contact and cutting at 1 kHz, driven through the FMU's C interface"
    );
    Figure {
        title: "A liver segment grasped, pulled and cut off",
        subtitle: &subtitle,
        view,
        panels: &panels,
        chart: chart(table),
    }
    .svg()
}

fn chart(table: &Table) -> Chart<'static> {
    let events = events(table);
    Chart {
        title: "Force of the tissue on the grasper",
        x: Axis {
            label: "time",
            unit: "s",
            scale: Scale::Linear,
        },
        y: Axis {
            label: "force",
            unit: "N",
            scale: Scale::Linear,
        },
        // The cautery burns what it touches and so feels nothing.
        series: vec![Line {
            name: "grasper",
            points: force(table, 1),
            style: Style::Line,
            color: PALETTE[0],
        }],
        events: events
            .into_iter()
            .map(|(x, label)| Event { x, label })
            .collect(),
        stations: PANELS.to_vec(),
    }
}

/// Magnitude of the force on a tool over time.
fn force(table: &Table, tool: usize) -> Vec<[f64; 2]> {
    let [x, y, z] = ["x", "y", "z"].map(|a| table.column(&format!("tool[{tool}].force.{a}")));
    (0..x.len())
        .map(|i| [x[i][0], x[i][1].hypot(y[i][1]).hypot(z[i][1])])
        .collect()
}

/// First grasp, first and last removal, release.
fn events(table: &Table) -> Vec<(f64, &'static str)> {
    let changes = |name: &str| -> Vec<f64> {
        let column = table.column(name);
        column
            .windows(2)
            .filter(|w| w[0][1] != w[1][1])
            .map(|w| w[1][0])
            .collect()
    };
    let (grasps, cuts) = (
        changes("tool[1].inContact"),
        changes("topology.removedTetrahedra"),
    );
    [
        (grasps.first(), "grasp"),
        (cuts.first(), "cut begins"),
        (cuts.last(), "cut through"),
        (grasps.get(1..).and_then(<[f64]>::last), "release"),
    ]
    .into_iter()
    .filter_map(|(time, label)| Some((*time?, label)))
    .collect()
}

fn summary(output: &Path, table: &Table, steps: u64, seconds: f64) -> String {
    let last = |name: &str| table.column(name).last().map_or(0.0, |v| v[1]);
    let most = force(table, 1).iter().map(|p| p[1]).fold(0.0, f64::max);
    let balance = last("energy.elastic")
        + last("energy.kinetic")
        + last("energy.gravity")
        + last("energy.dissipated")
        - last("energy.toolWork")
        - last("energy.supportWork");
    let start = table.column("energy.elastic")[0][1] + table.column("energy.gravity")[0][1];
    format!(
        "{folder}/\n  hepatectomy.fmu   the FMU that was simulated\n  hepatectomy.svg   the picture\n  \
         results.csv       {rows} rows of all outputs\n  hepatectomy.pvd   the surface over time, for ParaView\n\
         largest force on the grasper {grasper:.2} N; {removed} tetrahedra removed; {pieces} pieces at the end\n\
         energy residual {residual:.1e} J of {dissipated:.2e} J dissipated\n\
         {steps} steps of 1 ms in {seconds:.2} s: {each:.0} us a step, {ratio:.1} times real time",
        folder = output.display(),
        rows = steps + 1,
        grasper = most,
        removed = last("topology.removedTetrahedra"),
        pieces = last("topology.pieces"),
        residual = balance - start,
        dissipated = last("energy.dissipated"),
        each = 1e6 * seconds / steps as f64,
        ratio = steps as f64 * STEP / seconds,
    )
}
