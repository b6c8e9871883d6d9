//! What can go wrong in a command: one line for the user.

use std::path::{Path, PathBuf};

use tissue::prepared::PrepareError;
use tissue::reference::ReferenceError;

use crate::advise::search::SearchError;

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error(transparent)]
    Prepare(#[from] PrepareError),
    #[error(transparent)]
    Reference(#[from] ReferenceError),
    #[error(transparent)]
    Search(#[from] SearchError),
    #[error("{path}: {1}", path = .0.display())]
    File(PathBuf, std::io::Error),
    /// File, what is wrong and what would be right.
    #[error("{path}: {1}", path = .0.display())]
    Content(PathBuf, String),
    #[error("the FMU's binary {path} is missing; build it with `cargo build --release` or name it in TISSUE_FMU_LIBRARY", path = .0.display())]
    NoLibrary(PathBuf),
    #[error("{0}")]
    Simulation(String),
    #[error("standard output: {0}")]
    Output(std::io::Error),
}

impl Error {
    pub fn is_closed_pipe(&self) -> bool {
        matches!(self, Error::Output(e) if e.kind() == std::io::ErrorKind::BrokenPipe)
    }
}

/// For `map_err`.
pub fn file(path: &Path) -> impl Fn(std::io::Error) -> Error + '_ {
    |e| Error::File(path.to_path_buf(), e)
}
