//! What a run leaves: a table of all scalar outputs, and the surface over time for ParaView.

use std::io::Write;
use std::path::{Path, PathBuf};

use crate::drive::{Host, Kind};
use crate::error::{Error, file};
use crate::vtu::{Cells, write_pvd, write_vtu};
use crate::write;

/// The tissue's surface at one time.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// \[m\]
    pub vertices: Vec<[f64; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

/// References of the surface arrays.
#[derive(Debug, Default)]
pub struct SurfaceReader {
    vertices: Vec<u32>,
    triangles: Vec<u32>,
    count: Option<u32>,
}

impl SurfaceReader {
    pub fn new(host: &Host) -> SurfaceReader {
        let of = |prefix: &str| {
            host.variables()
                .iter()
                .filter(|v| v.name.starts_with(prefix))
                .map(|v| v.reference)
                .collect()
        };
        SurfaceReader {
            vertices: of("surface.vertex["),
            triangles: of("surface.triangle["),
            count: host.variable("surface.triangleCount").map(|v| v.reference),
        }
    }

    pub fn read(&self, host: &Host) -> Result<Frame, Error> {
        let mut vertices = vec![0.0; self.vertices.len()];
        host.reals(&self.vertices, &mut vertices)?;
        let mut count = [0];
        if let Some(reference) = self.count {
            host.integers(&[reference], &mut count)?;
        }
        let shown = (3 * count[0].max(0) as usize).min(self.triangles.len());
        let mut triangles = vec![0; shown];
        host.integers(&self.triangles[..shown], &mut triangles)?;
        Ok(Frame {
            vertices: vertices.as_chunks().0.to_vec(),
            triangles: triangles
                .as_chunks()
                .0
                .iter()
                .map(|t| t.map(|k: i32| k.max(0) as u32))
                .collect(),
        })
    }
}

/// A row a communication step.
pub struct Table {
    names: Vec<String>,
    reals: Vec<u32>,
    integers: Vec<u32>,
    booleans: Vec<u32>,
    rows: Vec<(f64, Vec<f64>)>,
}

impl Table {
    /// Inputs and outputs, arrays over the surface left out.
    pub fn new(host: &Host) -> Table {
        let mut table = Table {
            names: Vec::new(),
            reals: Vec::new(),
            integers: Vec::new(),
            booleans: Vec::new(),
            rows: Vec::new(),
        };
        for kind in [Kind::Real, Kind::Integer, Kind::Boolean] {
            for v in host.variables() {
                let shown = (v.is_input || v.is_output) && !v.name.starts_with("surface.vertex[");
                if shown && v.kind == kind {
                    table.names.push(v.name.clone());
                    match kind {
                        Kind::Real => table.reals.push(v.reference),
                        Kind::Integer => table.integers.push(v.reference),
                        Kind::Boolean => table.booleans.push(v.reference),
                    }
                }
            }
        }
        table
    }

    pub fn record(&mut self, host: &Host) -> Result<(), Error> {
        let mut row = vec![0.0; self.reals.len()];
        host.reals(&self.reals, &mut row)?;
        for (references, is_boolean) in [(&self.integers, false), (&self.booleans, true)] {
            let mut values = vec![0; references.len()];
            if is_boolean {
                host.booleans(references, &mut values)?;
            } else {
                host.integers(references, &mut values)?;
            }
            row.extend(values.iter().map(|v| f64::from(*v)));
        }
        self.rows.push((host.time(), row));
        Ok(())
    }

    /// A column by its name, as (time, value).
    pub fn column(&self, name: &str) -> Vec<[f64; 2]> {
        let Some(k) = self.names.iter().position(|n| n == name) else {
            return Vec::new();
        };
        self.rows.iter().map(|(t, row)| [*t, row[k]]).collect()
    }

    /// Names with a comma in them are quoted.
    pub fn write(&self, path: &Path) -> Result<(), Error> {
        write::whole(path, |out| {
            write!(out, "time")?;
            for name in &self.names {
                write!(
                    out,
                    ",{}",
                    if name.contains(',') {
                        format!("\"{name}\"")
                    } else {
                        name.clone()
                    }
                )?;
            }
            writeln!(out)?;
            for (time, row) in &self.rows {
                write!(out, "{time}")?;
                for value in row {
                    write!(out, ",{value}")?;
                }
                writeln!(out)?;
            }
            Ok(())
        })
    }
}

/// ParaView files: one VTU a frame, one PVD that lists them with their times.
pub struct Series {
    folder: PathBuf,
    name: String,
    entries: Vec<(f64, String)>,
    start: Vec<[f64; 3]>,
}

impl Series {
    /// Frames go to `folder/surface/`.
    pub fn new(folder: &Path, name: &str) -> Series {
        Series {
            folder: folder.to_path_buf(),
            name: name.to_string(),
            entries: Vec::new(),
            start: Vec::new(),
        }
    }

    pub fn add(&mut self, time: f64, frame: &Frame) -> Result<(), Error> {
        if frame.vertices.is_empty() {
            return Ok(());
        }
        if self.entries.is_empty() {
            self.start.clone_from(&frame.vertices);
            // Frames of an earlier, longer run would stay behind.
            let old = self.folder.join("surface");
            if old.is_dir() {
                std::fs::remove_dir_all(&old).map_err(file(&old))?;
            }
        }
        let name = format!("surface/{}_{:04}.vtu", self.name, self.entries.len());
        let moved: Vec<[f64; 3]> = (frame.vertices.iter().zip(&self.start))
            .map(|(x, start)| [0, 1, 2].map(|a| x[a] - start[a]))
            .collect();
        let cells = if frame.triangles.is_empty() {
            Cells::Vertices
        } else {
            Cells::Triangles(&frame.triangles)
        };
        write::whole(&self.folder.join(&name), |out| {
            write_vtu(out, &frame.vertices, cells, &[("displacement", &moved)])
        })?;
        self.entries.push((time, name));
        Ok(())
    }

    pub fn finish(self) -> Result<(), Error> {
        if self.entries.is_empty() {
            return Ok(());
        }
        let path = self.folder.join(format!("{}.pvd", self.name));
        write::whole(&path, |out| write_pvd(out, &self.entries))
    }
}
