//! Packing: description, binary, resources and a page of documentation into one FMU.

use std::io::{Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tissue::model::Model;
use tissue::simulation::Simulation;
use zip::write::SimpleFileOptions;

use crate::error::{Error, file};
use crate::write;

/// FMI 2.0's folder for this machine's binaries.
const PLATFORM: &str = if cfg!(target_os = "windows") {
    "win64"
} else if cfg!(target_os = "macos") {
    "darwin64"
} else {
    "linux64"
};

/// Writes the FMU of a model.
pub fn pack(model: &Arc<Model>, path: &Path) -> Result<(), Error> {
    let library = library()?;
    let binary = std::fs::read(&library).map_err(file(&library))?;
    let name = &model.scene.name;
    let description = model_description::write(&mut Simulation::new(model.clone()));
    let resources = tissue::prepared::resources(model)
        .map_err(|e| Error::Content(path.to_path_buf(), e.to_string()))?;
    write::whole(path, |out| {
        let mut zip = zip::ZipWriter::new(out);
        add(
            &mut zip,
            model_description::MODEL_DESCRIPTION,
            description.as_bytes(),
        )?;
        let suffix = std::env::consts::DLL_SUFFIX;
        add(
            &mut zip,
            &format!("binaries/{PLATFORM}/{name}{suffix}"),
            &binary,
        )?;
        for (file, bytes) in &resources {
            add(&mut zip, &format!("resources/{file}"), bytes)?;
        }
        add(
            &mut zip,
            "documentation/index.html",
            documentation(model).as_bytes(),
        )?;
        zip.finish()?;
        Ok(())
    })
}

/// No time stamps: the same scene gives the same file.
fn add(
    zip: &mut zip::ZipWriter<impl Write + Seek>,
    name: &str,
    bytes: &[u8],
) -> std::io::Result<()> {
    // Elementary deformations do not get smaller.
    let method = match name.ends_with(".bin") {
        true => zip::CompressionMethod::Stored,
        false => zip::CompressionMethod::Deflated,
    };
    let options = SimpleFileOptions::default()
        .compression_method(method)
        .large_file(bytes.len() >= 1 << 31)
        .last_modified_time(zip::DateTime::default())
        .unix_permissions(0o755);
    zip.start_file(name, options)?;
    zip.write_all(bytes)
}

/// The C shell beside this program, or where TISSUE_FMU_LIBRARY says.
fn library() -> Result<PathBuf, Error> {
    if let Some(path) = std::env::var_os("TISSUE_FMU_LIBRARY") {
        return Ok(path.into());
    }
    let name = format!(
        "{}tissue_fmu{}",
        std::env::consts::DLL_PREFIX,
        std::env::consts::DLL_SUFFIX
    );
    let program = std::env::current_exe().unwrap_or_default();
    let beside = program.parent().unwrap_or(Path::new(".")).join(&name);
    if beside.is_file() {
        Ok(beside)
    } else {
        Err(Error::NoLibrary(beside))
    }
}

fn documentation(model: &Model) -> String {
    let scene = &model.scene;
    let tools: String = (scene.tools.iter().enumerate())
        .map(|(k, tool)| {
            format!(
                "<li>tool[{}]: {} ({:?})</li>",
                k + 1,
                escape(&tool.name),
                tool.kind
            )
        })
        .collect();
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>{name}</title>\
         <h1>{name}</h1><p>{description}</p>\
         <p>Soft tissue by tissue-fmu {version}: {nodes} nodes, {tetrahedra} tetrahedra. \
         Set the tools' poses, step, read forces and surface. All units are SI.</p><ul>{tools}</ul>\
         <p>Without input derivatives a tool ramps from its last pose to the new one over each \
         communication step. Linear elasticity: large rotations of loose or slender parts swell them.</p></html>\n",
        name = escape(&scene.name),
        description = escape(&scene.description),
        version = env!("CARGO_PKG_VERSION"),
        nodes = model.mesh.nodes.len(),
        tetrahedra = model.mesh.tetrahedra.len(),
    )
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}
