//! `chart`: speed against accuracy of every setting.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use super::{bar, say};
use crate::chart::{record, sheet, study};
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
