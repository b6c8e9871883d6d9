//! One command a file.

pub mod advise;
pub mod build;
pub mod chart;
pub mod demo;
pub mod inspect;
pub mod reference;
pub mod run;

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use tissue::model::store::Numbers;
use tissue::model::{Known, Model};

use tissue::prepared;
use zip::result::ZipError;

use crate::error::{Error, file};

/// Prints to standard output.
fn say(text: &str) -> Result<(), Error> {
    writeln!(std::io::stdout(), "{text}").map_err(Error::Output)
}

/// A spinner with a message; silent in a pipe.
fn spinner(message: String) -> ProgressBar {
    let bar = ProgressBar::new_spinner().with_message(message);
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

/// A bar over `total` steps; silent in a pipe.
fn bar(total: u64, message: &str) -> ProgressBar {
    ProgressBar::new(total)
        .with_style(bar_style())
        .with_message(message.to_string())
}

fn bar_style() -> ProgressStyle {
    ProgressStyle::with_template("{msg} [{bar:32}] {percent:>3} % {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .progress_chars("=> ")
}

fn prepare(scene: &Path) -> Result<Arc<Model>, Error> {
    prepare_known(scene, |_| Known::default())
}

/// The same with what an earlier build has found.
fn prepare_known(scene: &Path, known: impl FnOnce(u64) -> Known) -> Result<Arc<Model>, Error> {
    let progress = spinner(format!("preparing {}", scene.display()));
    let shown = |share: f64| {
        if progress.length().is_none() {
            progress.set_style(bar_style());
            progress.set_length(1000);
        }
        progress.set_position((1000.0 * share) as u64);
    };
    let model = tissue::prepared::read_with(scene, known, &shown)?;
    progress.finish_and_clear();
    Ok(Arc::new(model))
}

fn is_fmu(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("fmu"))
}

/// What the FMU that is to be replaced knows already. Nothing where there is none or it is another's.
fn known_of(fmu: &Path, key: u64) -> Known {
    let numbers = || -> Option<Numbers> {
        let mut archive = zip::ZipArchive::new(std::fs::File::open(fmu).ok()?).ok()?;
        let name = format!("resources/{}", prepared::ELEMENTARY);
        let mut entry = archive.by_name(&name).ok()?;
        let folder = tempfile::tempdir().ok()?;
        let mut out = std::fs::File::create(folder.path().join(prepared::ELEMENTARY)).ok()?;
        std::io::copy(&mut entry, &mut out).ok()?;
        prepared::elementary(folder.path(), key).ok()?
    };
    Known {
        numbers: numbers(),
        ..Known::default()
    }
}

/// The model inside an FMU.
fn open_fmu(path: &Path) -> Result<Model, Error> {
    let wrong = |e: String| {
        Error::Content(
            path.to_path_buf(),
            format!("is no FMU of this program: {e}"),
        )
    };
    let archive = std::fs::File::open(path).map_err(file(path))?;
    let mut archive = zip::ZipArchive::new(archive).map_err(|e| wrong(e.to_string()))?;
    let folder = tempfile::tempdir().map_err(file(path))?;
    for name in [prepared::SCENE, prepared::PRECOMPUTED, prepared::ELEMENTARY] {
        let mut entry = match archive.by_name(&format!("resources/{name}")) {
            Err(ZipError::FileNotFound) if name == prepared::ELEMENTARY => continue,
            entry => entry.map_err(|e| wrong(format!("resources/{name}: {e}")))?,
        };
        let target = folder.path().join(name);
        let mut out = std::fs::File::create(&target).map_err(file(&target))?;
        std::io::copy(&mut entry, &mut out).map_err(file(path))?;
    }
    Ok(prepared::open(folder.path())?)
}

pub fn schema() -> Result<(), Error> {
    say(&format!("{:#}", tissue::scene::schema()))
}
