//! `chart`: speed against accuracy of every setting, and maps of where methods fail.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use super::{bar, say};
use crate::chart::{map_sheet, maps, random_run, rate, record, sheet, study};
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

/// `--rate`: what scenes at rest cost, and the largest mesh of each model that keeps up with 1 kHz.
pub fn run_rate(quick: bool, output: &Path) -> Result<(), Error> {
    let path = output.join("rate.csv");
    let progress = bar(rate::RATES.len() as u64, "scenes at rest");
    let start = Instant::now();
    let mut text = format!("{}\n", rate::HEADER);
    for found in rate::at_rest(quick)? {
        progress.suspend(|| say(&found.line()))?;
        text += &found.csv();
    }
    let mut best: Vec<rate::Rate> = Vec::new();
    rate::largest(quick, &progress, |found| {
        progress.suspend(|| say(&found.line()))?;
        text += &found.csv();
        let known = best.iter_mut().find(|b| b.name == found.name);
        match known {
            _ if !found.holds() => {}
            Some(known) if found.tetrahedra < known.tetrahedra => {}
            Some(known) => *known = found,
            None => best.push(found),
        }
        Ok(())
    })?;
    write::whole(&path, |out| out.write_all(text.as_bytes()))?;
    progress.finish_and_clear();
    for found in &best {
        say(&format!(
            "largest at 1 kHz: {}, {} tetrahedra",
            found.name, found.tetrahedra
        ))?;
    }
    let seconds = start.elapsed().as_secs_f64();
    say(&format!("{}: measured in {seconds:.0} s", path.display()))
}

/// `--random`: scenes drawn at random, each run to its end; an error where one failed.
pub fn run_random(
    seed: u64,
    first: u64,
    count: u64,
    threads: Option<usize>,
    output: &Path,
) -> Result<(), Error> {
    std::fs::create_dir_all(output).map_err(file(output))?;
    let cores = || std::thread::available_parallelism().map_or(1, |n| n.get());
    let progress = bar(count, "running");
    let start = Instant::now();
    let threads = threads.unwrap_or_else(cores);
    let ended = random_run::run(seed, first, count, threads, || progress.inc(1));
    progress.finish_and_clear();
    let put = |path: &Path, text: &str| write::whole(path, |out| out.write_all(text.as_bytes()));
    let path = output.join("random.csv");
    put(&path, &random_run::csv(seed, &ended))?;
    let failed: Vec<_> = ended.iter().filter(|e| !e.holds()).collect();
    say(&format!(
        "{}\n{}",
        random_run::region(),
        random_run::summary(&ended)
    ))?;
    let gave_way: Vec<_> = ended.iter().filter(|e| e.gave_way()).collect();
    for e in failed.iter().chain(&gave_way) {
        say(&format!("seed {seed}, scene {}: {}", e.index, e.symptom))?;
    }
    let verdict = format!(
        "{count} scenes run in {:.0} s, {} stopped at det F = 0 with the state kept, {} failed",
        start.elapsed().as_secs_f64(),
        gave_way.len(),
        failed.len()
    );
    match failed.is_empty() {
        true => say(&format!("{}: {verdict}", path.display())),
        false => Err(Error::Simulation(format!("{}: {verdict}", path.display()))),
    }
}
