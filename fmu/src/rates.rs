//! The update rate over a run: how many substeps a second of wall time, tenth by tenth of a second simulated.

use std::io::Write;
use std::path::Path;

use crate::error::Error;
use crate::recorder::Table;
use crate::write;

/// Simulated time of a row \[s\], to whole communication steps.
const WINDOW: f64 = 0.1;

/// One window of the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Its end, simulated \[s\].
    pub time: f64,
    pub steps: usize,
    pub substeps: f64,
    /// Wall time in the FMU's steps \[s\].
    pub seconds: f64,
    /// Wall time of its longest step \[s\].
    pub longest: f64,
    /// Tetrahedra gone by its end.
    pub removed: f64,
    /// Share of the tetrahedra with a law that is not linear, at its end.
    pub nonlinear: f64,
}

/// From a table with a row more than there are steps, and the wall time of each step \[s\].
pub fn rates(table: &Table, seconds: &[f64]) -> Vec<Rate> {
    let [substeps, removed, nonlinear] = [
        "diagnostics.substeps",
        "topology.removedTetrahedra",
        "diagnostics.nonlinearFraction",
    ]
    .map(|name| table.column(name));
    let value = |column: &[[f64; 2]], row: usize| column.get(row).map_or(f64::NAN, |v| v[1]);
    let length = substeps.get(1).map_or(WINDOW, |row| row[0]);
    let steps = (WINDOW / length).round().max(1.0) as usize;
    (seconds.chunks(steps).enumerate())
        .map(|(k, own)| {
            let (first, last) = (k * steps, k * steps + own.len());
            Rate {
                time: substeps.get(last).map_or(f64::NAN, |row| row[0]),
                steps: own.len(),
                substeps: value(&substeps, last) - value(&substeps, first),
                seconds: own.iter().sum(),
                longest: own.iter().copied().fold(0.0, f64::max),
                removed: value(&removed, last),
                nonlinear: value(&nonlinear, last),
            }
        })
        .collect()
}

pub fn write(path: &Path, rates: &[Rate]) -> Result<(), Error> {
    write::whole(path, |out| {
        writeln!(
            out,
            "time,steps,substeps,seconds,substepsPerSecond,longestStep,removedTetrahedra,nonlinearFraction"
        )?;
        for r in rates {
            writeln!(
                out,
                "{:.6},{},{},{:.6},{:.0},{:.6},{},{:.4}",
                r.time,
                r.steps,
                r.substeps,
                r.seconds,
                r.substeps / r.seconds,
                r.longest,
                r.removed,
                r.nonlinear
            )?;
        }
        Ok(())
    })
}
