//! `build`: scene to FMU.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::{known_of, prepare_known, say};
use crate::error::Error;
use crate::pack::pack;

pub fn run(scene: &Path, output: Option<PathBuf>) -> Result<(), Error> {
    let begun = Instant::now();
    let old = match &output {
        Some(output) => output.clone(),
        None => tissue::scene::read(scene)
            .map(|s| PathBuf::from(format!("{}.fmu", s.name)))
            .unwrap_or_default(),
    };
    let model = prepare_known(scene, |key| known_of(&old, key))?;
    for warning in tissue::inspect::warnings(&model) {
        eprintln!("warning: {warning}");
    }
    let output = output.unwrap_or_else(|| PathBuf::from(format!("{}.fmu", model.scene.name)));
    pack(&model, &output)?;
    say(&format!(
        "{}: {} nodes, {} tetrahedra, substep {:.4} ms, prepared in {:.1} s",
        output.display(),
        model.mesh.nodes.len(),
        model.mesh.tetrahedra.len(),
        1e3 * model.substep(model.damping()),
        begun.elapsed().as_secs_f64()
    ))
}
