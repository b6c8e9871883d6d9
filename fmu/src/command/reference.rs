//! `reference`: the scene's equilibrium, directly.

use std::io::Write;
use std::path::Path;

use super::{prepare, say};
use crate::error::Error;
use crate::write;

pub fn run(scene: &Path, after_cuts: bool, output: Option<&Path>) -> Result<(), Error> {
    let model = prepare(scene)?;
    let reference = tissue::reference::solve(&model, after_cuts)?;
    let text = serde_json::to_string(&reference)
        .map_err(|e| Error::Content(scene.to_path_buf(), e.to_string()))?;
    match output {
        Some(path) => write::whole(path, |out| writeln!(out, "{text}")),
        None => say(&text),
    }
}
