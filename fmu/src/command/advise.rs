//! `advise`: the cheapest setting of a scene that is as right and as fast as is asked.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use tissue::prepared::PrepareError;
use tissue::scene::{Connection, Scene};

use super::{bar, say};
use crate::advise::search::{Search, Wish};
use crate::advise::{candidate, gesture, grid, report};
use crate::error::{Error, file};
use crate::motion::Motion;
use crate::write;

/// What stands on the command line beside the scene.
pub struct Request {
    pub tolerance: f64,
    /// \[Hz\]; none: the scene's haptic rate.
    pub rate: Option<f64>,
    pub motion: Option<PathBuf>,
    pub gesture: String,
    pub same_mesh: bool,
    pub exhaustive: bool,
    pub alone: bool,
    pub check: Option<PathBuf>,
    /// None: the scene's folder.
    pub output: Option<PathBuf>,
}

/// Rest after what a scene does by itself \[s\].
const REST: f64 = 0.3;

pub fn run(path: &Path, request: &Request) -> Result<(), Error> {
    let start = Instant::now();
    let scene = tissue::scene::read(path).map_err(PrepareError::from)?;
    let wrong = |what: &str| Error::Content(path.to_path_buf(), what.to_string());
    if scene.model.connection != Connection::Full {
        return Err(wrong(
            "model.connection: parts that hold together at some nodes are no choice of how to compute; must be \"full\"",
        ));
    }
    let grids = grid::grids(&scene, path, request.same_mesh)?;
    let own = &grids.0[0];
    let (motion, stop) = match &request.motion {
        Some(file) => {
            let motion = Motion::of_scene(file, &scene)?;
            let end = motion.end();
            (Some(motion), end)
        }
        None => {
            let row = gesture::named(&request.gesture).ok_or_else(|| wrong("no such gesture"))?;
            let motion = gesture::motion(&scene, &own.mesh, &own.surface, row);
            let end = motion.as_ref().map_or(alone(&scene), Motion::end);
            (motion, end)
        }
    };
    if stop <= 0.0 {
        return Err(wrong(
            "the motion ends at 0 s; must have a row later than that",
        ));
    }
    let wish = Wish {
        tolerance: request.tolerance,
        rate: request.rate.unwrap_or(scene.integration.haptic_rate),
        exhaustive: request.exhaustive,
        alone: request.alone,
    };
    let meshes = grids.0.len();
    let settings = candidate::settings().len();
    let progress = bar((meshes * (settings + 1) + 1) as u64, "measuring");
    let tick = || progress.inc(1);
    let mut search = Search::new(scene.clone(), path, wish, grids, motion.clone(), stop, tick)?;
    if let Some(other) = &request.check {
        let checked = tissue::scene::read(other).map_err(PrepareError::from)?;
        let (off, work, time) = search.check(&checked, other)?;
        progress.finish_and_clear();
        return say(&format!(
            "{}: force {:.4} % off, surface {:.4} % off, {} kflop a ms, {:.1} us a step (99 %)",
            other.display(),
            100.0 * off.force,
            100.0 * off.surface,
            work.map_or("no".into(), |w| format!("{w:.4}")),
            time
        ));
    }
    let (rows, advised) = search.run(tick)?;
    progress.finish_and_clear();

    let stem = path
        .file_stem()
        .map_or("scene".into(), |s| s.to_string_lossy());
    let home = path.parent().unwrap_or(Path::new(""));
    let folder = request.output.as_deref().unwrap_or(home);
    if !folder.as_os_str().is_empty() {
        std::fs::create_dir_all(folder).map_err(file(folder))?;
    }
    let put = |ending: &str, text: &str| {
        let path = folder.join(format!("{stem}.advised.{ending}"));
        write::whole(&path, |out| out.write_all(text.as_bytes())).map(|()| path)
    };
    put("csv", &report::csv(&search, &rows, advised))?;
    put("svg", &report::svg(&search, &rows, advised, &stem))?;
    if let (None, Some(motion)) = (&request.motion, &motion) {
        put("motion.csv", &motion.text())?;
    }
    say(&report::table(&search, &rows, advised))?;
    for line in report::advice(&search, &rows, advised) {
        say(&line)?;
    }
    let known = rows.iter().filter(|r| r.off.is_some()).count();
    let seconds = start.elapsed().as_secs_f64();
    let ran = format!("{known} of {} candidates run in {seconds:.0} s", rows.len());
    match advised {
        Some(k) => {
            let mut chosen = rows[k].scene.clone();
            if request.output.is_some() {
                report::moved(&mut chosen, home);
            }
            let text = report::scene(&chosen).map_err(|e| wrong(&e.to_string()))?;
            // What is written is read first.
            tissue::scene::parse(&text, &path.display().to_string()).map_err(PrepareError::from)?;
            let written = put("json", &text)?;
            say(&format!("{}: {ran}", written.display()))
        }
        None => say(&ran),
    }
}

/// How long a scene without tools does something \[s\].
fn alone(scene: &Scene) -> f64 {
    let ramps = (scene.prescribed.iter().map(|p| p.ramp)).chain(scene.loads.iter().map(|l| l.ramp));
    let last = ramps
        .chain(scene.cuts.iter().map(|c| c.time))
        .fold(0.0, f64::max);
    last + if last > 0.0 { REST } else { 1.0 }
}
