//! `build`: scene to FMU.

use std::path::{Path, PathBuf};

use super::{prepare, say};
use crate::error::Error;
use crate::pack::pack;

pub fn run(scene: &Path, output: Option<PathBuf>) -> Result<(), Error> {
    let model = prepare(scene)?;
    for warning in tissue::inspect::warnings(&model) {
        eprintln!("warning: {warning}");
    }
    let output = output.unwrap_or_else(|| PathBuf::from(format!("{}.fmu", model.scene.name)));
    pack(&model, &output)?;
    say(&format!(
        "{}: {} nodes, {} tetrahedra, substep {:.4} ms",
        output.display(),
        model.mesh.nodes.len(),
        model.mesh.tetrahedra.len(),
        1e3 * model.substep(model.damping())
    ))
}
