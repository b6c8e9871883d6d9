//! Files that are whole or not there: written aside, then renamed.

use std::io::{BufWriter, Write};
use std::path::Path;

use crate::error::{Error, file};

/// Calls `fill` with the file to be.
pub fn whole(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<std::fs::File>) -> std::io::Result<()>,
) -> Result<(), Error> {
    let folder = folder_of(path);
    std::fs::create_dir_all(folder).map_err(file(folder))?;
    let aside = tempfile::Builder::new()
        .prefix(".tissue-fmu-")
        .tempfile_in(folder)
        .map_err(file(folder))?;
    let mut out = BufWriter::new(aside.as_file().try_clone().map_err(file(path))?);
    fill(&mut out)
        .and_then(|()| out.flush())
        .map_err(file(path))?;
    drop(out);
    // A temporary file is private; what it becomes shall be as readable as its folder.
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = std::fs::Permissions::from_mode(0o644);
        aside.as_file().set_permissions(mode).map_err(file(path))?;
    }
    aside
        .persist(path)
        .map_err(|e| Error::File(path.to_path_buf(), e.error))?;
    Ok(())
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}
