//! One command a file.

pub mod build;
pub mod demo;
pub mod inspect;
pub mod reference;
pub mod run;

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use tissue::model::Model;

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
    let style = ProgressStyle::with_template("{msg} [{bar:32}] {percent:>3} % {eta} left");
    ProgressBar::new(total)
        .with_style(
            style
                .unwrap_or_else(|_| ProgressStyle::default_bar())
                .progress_chars("=> "),
        )
        .with_message(message.to_string())
}

fn prepare(scene: &Path) -> Result<Arc<Model>, Error> {
    let progress = spinner(format!("preparing {}", scene.display()));
    let model = tissue::prepared::read(scene)?;
    progress.finish_and_clear();
    Ok(Arc::new(model))
}

fn is_fmu(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("fmu"))
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
    for name in [tissue::prepared::SCENE, tissue::prepared::PRECOMPUTED] {
        let mut entry = archive
            .by_name(&format!("resources/{name}"))
            .map_err(|e| wrong(format!("resources/{name}: {e}")))?;
        let target = folder.path().join(name);
        let mut out = std::fs::File::create(&target).map_err(file(&target))?;
        std::io::copy(&mut entry, &mut out).map_err(file(path))?;
    }
    Ok(tissue::prepared::open(folder.path())?)
}

pub fn schema() -> Result<(), Error> {
    say(&format!("{:#}", tissue::scene::schema()))
}
