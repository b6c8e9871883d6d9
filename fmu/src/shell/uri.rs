//! From `fmuResourceLocation` to a folder.

use std::path::{Path, PathBuf};

use url::Url;

/// The folder, and whether it came as a plain path instead of a URI.
///
/// Known forms: `file:///a/b/resources`, with a trailing slash, `file:/a`, `file:////a`,
/// percent-encoded. The error says what would be right.
pub fn folder(location: &str) -> Result<(PathBuf, bool), String> {
    if location.is_empty() {
        return Err("it is empty".into());
    }
    match Url::parse(location) {
        Ok(url) if url.scheme() == "file" => url
            .to_file_path()
            .map(|path| (path, false))
            .map_err(|()| format!("{location:?} is on another machine")),
        Err(url::ParseError::RelativeUrlWithoutBase) => Ok((Path::new(location).into(), true)),
        Ok(url) => Err(format!("{location:?} has the scheme {:?}", url.scheme())),
        Err(e) => Err(format!("{location:?} is not a URI: {e}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_forms() {
        for (location, path) in [
            ("file:///a/b/resources", "/a/b/resources"),
            ("file:///a/b/resources/", "/a/b/resources/"),
            ("file:/a/b", "/a/b"),
            ("FILE:///a/b", "/a/b"),
            ("file:////a/b", "/a/b"),
            ("file://localhost/a/b", "/a/b"),
            ("file:///a%20b%20%C3%BC%2B%2520/c", "/a b ü+%20/c"),
            ("file:///a b/ü", "/a b/ü"),
            ("file:///50%/c", "/50%/c"),
        ] {
            let (got, plain) = folder(location).unwrap();
            assert_eq!(
                (got.as_os_str().to_str(), plain),
                (Some(path), false),
                "{location}"
            );
        }
        assert_eq!(folder("/a b/ü%20").unwrap(), ("/a b/ü%20".into(), true));
        assert_eq!(folder("a/b").unwrap(), ("a/b".into(), true));
    }

    #[test]
    fn others_are_refused() {
        for location in ["", "http://host/a", "file://host/a", "file://[/a"] {
            assert!(folder(location).is_err(), "{location}");
        }
    }
}
