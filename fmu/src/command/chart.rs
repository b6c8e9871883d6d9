//! `chart`: speed against accuracy of every setting, and maps of where methods fail.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use super::{bar, say};
use crate::chart::{map_sheet, maps, record, sheet, study};
use crate::error::{Error, file};
use crate::write;

pub fn run(quick: bool, output: &Path) -> Result<(), Error> {
    std::fs::create_dir_all(output).map_err(file(output))?;
    let path = output.join("chart.csv");
    let known = match std::fs::read_to_string(&path) {
        Ok(text) => record::parse(&text),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Vec::new(),
        Err(e) => return Err(Error::File(path, e)),
    };
    let plans = study::plans(quick);
    let rows: usize = plans.iter().map(study::Plan::rows).sum();
    let progress = bar(rows as u64, "measuring");
    let start = Instant::now();
    let put = |path: &Path, text: &str| write::whole(path, |out| out.write_all(text.as_bytes()));
    let (records, made) = study::run(&plans, known, &progress, |records| {
        put(&path, &record::text(records))
    })?;
    progress.finish_and_clear();
    for plan in &plans {
        let name = format!("chart_{}.svg", plan.scene.name);
        put(&output.join(name), &sheet::svg(plan, &records))?;
    }
    put(&output.join("front.md"), &sheet::table(&plans, &records))?;
    let failed = records.iter().filter(|r| r.outcome != "done").count();
    say(&format!(
        "{}: {made} rows measured in {:.0} s, {} known, {failed} without a result",
        path.display(),
        start.elapsed().as_secs_f64(),
        rows - made
    ))
}

/// `--maps`: runs each map, one thread, and draws it.
pub fn run_maps(quick: bool, output: &Path) -> Result<(), Error> {
    std::fs::create_dir_all(output).map_err(file(output))?;
    let count = |map: &maps::MapRow| {
        map.panels.len() * map.x.places(quick).len() * map.y.places(quick).len()
    };
    let points: usize = maps::MAPS.iter().map(count).sum();
    let progress = bar(points as u64, "running");
    let start = Instant::now();
    let put = |path: &Path, text: &str| write::whole(path, |out| out.write_all(text.as_bytes()));
    let mut text = format!("{}\n", maps::HEADER);
    let mut failed = 0;
    for map in &maps::MAPS {
        let found = maps::run(map, quick, || progress.inc(1));
        failed += (found.iter())
            .filter(|f| f.cell.outcome == maps::Outcome::Failed)
            .count();
        text += &maps::csv(map, &found);
        let name = format!("stability_{}.svg", map.name);
        put(&output.join(name), &map_sheet::svg(map, &found, quick))?;
    }
    let path = output.join("stability.csv");
    put(&path, &text)?;
    progress.finish_and_clear();
    say(&format!(
        "{}: {points} points run in {:.0} s, {failed} failed",
        path.display(),
        start.elapsed().as_secs_f64()
    ))
}
