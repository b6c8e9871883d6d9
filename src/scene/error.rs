//! What is wrong with a scene, in one line.

/// `FILE: PLACE: what is wrong; what would be right`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneError {
    /// The scene file, as the user named it.
    pub file: String,
    /// JSON path such as `materials[0].density`, or line and column; empty: the file as a whole.
    pub place: String,
    /// What is wrong; what would be right.
    pub message: String,
}

impl SceneError {
    /// An error at a JSON path, for what is only found out after reading (a selector that selects nothing).
    pub fn at(file: &str, path: impl Into<String>, message: impl Into<String>) -> Self {
        Self {
            file: file.into(),
            place: path.into(),
            message: message.into(),
        }
    }

    pub(super) fn in_file(self, file: &str) -> Self {
        Self {
            file: file.into(),
            ..self
        }
    }
}

impl std::fmt::Display for SceneError {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        for part in [&self.file, &self.place] {
            if !part.is_empty() {
                write!(f, "{part}: ")?;
            }
        }
        f.write_str(&self.message)
    }
}

impl std::error::Error for SceneError {}
