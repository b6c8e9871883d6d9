//! `run`: simulate a scene or an FMU through the FMU's C interface.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use super::{bar, is_fmu, say, spinner};
use crate::drive::Host;
use crate::error::Error;
use crate::motion::Motion;
use crate::pack::pack;
use crate::rates;
use crate::recorder::{Series, SurfaceReader, Table};

/// Frames for ParaView, at most.
const FRAMES: u64 = 100;

pub fn run(
    path: &Path,
    motion: Option<&Path>,
    stop: Option<f64>,
    step: Option<f64>,
    with_rates: bool,
    output: &Path,
) -> Result<(), Error> {
    let positive = |name: &str, value: Option<f64>| match value {
        Some(v) if !(v > 0.0 && v.is_finite()) => Err(Error::Simulation(format!(
            "--{name} {v}: must be a positive number of seconds"
        ))),
        _ => Ok(()),
    };
    positive("stop", stop)?;
    positive("step", step)?;
    // Dropped, and so removed, when the run is over.
    let folder = tempfile::tempdir().map_err(|e| Error::File(output.to_path_buf(), e))?;
    let fmu = if is_fmu(path) {
        path.to_path_buf()
    } else {
        let mut scene = tissue::scene::read(path).map_err(tissue::prepared::PrepareError::from)?;
        scene.outputs.triangles = true;
        let progress = spinner(format!("preparing {}", path.display()));
        let model = tissue::prepared::prepare(scene, path)?;
        progress.finish_and_clear();
        let fmu = folder.path().join(format!("{}.fmu", model.scene.name));
        pack(&Arc::new(model), &fmu)?;
        fmu
    };
    let mut host = Host::start(&fmu)?;
    let motion = motion.map(|m| Motion::read(m, &host)).transpose()?;
    if let Some(motion) = &motion {
        motion.apply(&host, 0.0, 0.0)?;
    }
    host.initialised()?;
    let step = step.unwrap_or(host.default_step());
    let stop = stop
        .or(motion.as_ref().map(Motion::end).filter(|end| *end > 0.0))
        .unwrap_or(1.0);
    let steps = (stop / step - 1e-9).ceil().max(1.0) as u64;
    let every = steps.div_ceil(FRAMES);
    let name = fmu
        .file_stem()
        .map_or("model".into(), |n| n.to_string_lossy().into_owned());
    let (reader, mut series, mut table) = (
        SurfaceReader::new(&host),
        Series::new(output, &name),
        Table::new(&host),
    );
    series.add(0.0, &reader.read(&host)?)?;
    table.record(&host)?;
    let progress = bar(steps, "simulating");
    let start = Instant::now();
    let mut each = Vec::new();
    for k in 1..=steps {
        let end = (k as f64 * step).min(stop);
        if let Some(motion) = &motion {
            motion.apply(&host, host.time(), end)?;
        }
        let begun = Instant::now();
        host.step_to(end)?;
        each.push(begun.elapsed().as_secs_f64());
        table.record(&host)?;
        if k % every == 0 || k == steps {
            series.add(end, &reader.read(&host)?)?;
        }
        progress.inc(1);
    }
    let seconds = start.elapsed().as_secs_f64();
    progress.finish_and_clear();
    host.finish()?;
    let results = output.join("results.csv");
    table.write(&results)?;
    if with_rates {
        rates::write(&output.join("rates.csv"), &rates::rates(&table, &each))?;
    }
    series.finish()?;
    say(&format!(
        "{}: {steps} steps of {} ms in {seconds:.2} s, {:.1} times real time",
        results.display(),
        1e3 * step,
        stop / seconds
    ))
}
