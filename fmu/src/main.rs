//! `tissue-fmu`: from a scene file to a running FMU.

mod advise;
mod chart;
mod command;
mod drive;
mod error;
mod motion;
mod pack;
mod picture;
mod rates;
mod recorder;
mod vtu;
mod write;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Soft tissue you can press, pull and cut at haptic rate, as an FMI 2.0 co-simulation FMU.
#[derive(Parser)]
#[command(version, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Build the hepatectomy scene's FMU and drive it through a scripted grasp, pull and cut.
    Demo {
        /// Folder for the FMU, table, picture and ParaView files.
        #[arg(short, long, default_value = "target/demo")]
        output: PathBuf,
    },
    /// Check a scene, precompute, pack the FMU.
    Build {
        scene: PathBuf,
        /// Default: NAME.fmu in the current folder, NAME as in the scene.
        #[arg(short, long)]
        output: Option<PathBuf>,
    },
    /// Simulate a scene or an FMU.
    Run {
        /// SCENE.json or MODEL.fmu
        model: PathBuf,
        /// CSV: a column `time` and columns named as the FMU's inputs, interpolated linearly.
        #[arg(long)]
        motion: Option<PathBuf>,
        /// Stop time in s; default: the end of the motion, else 1.
        #[arg(long)]
        stop: Option<f64>,
        /// Communication step in s; default: the haptic period.
        #[arg(long)]
        step: Option<f64>,
        /// Also write rates.csv: substeps a second of wall time, over each 100 ms simulated.
        #[arg(long)]
        rates: bool,
        /// Folder for results.csv and the ParaView files.
        #[arg(short, long, default_value = "results")]
        output: PathBuf,
    },
    /// The cheapest setting that is right enough and fast enough on a motion: measured, and written as SCENE.advised.json.
    Advise {
        scene: PathBuf,
        /// Error that may be left: the larger of force and surface, relative, such as 0.05.
        #[arg(long, value_parser = tolerance)]
        tolerance: f64,
        /// Steps a second that it must keep up with; default: the scene's haptic rate.
        #[arg(long, value_parser = rate)]
        rate: Option<f64>,
        /// CSV as for `run`; default: a gesture, scaled to the scene.
        #[arg(long, conflicts_with = "gesture")]
        motion: Option<PathBuf>,
        /// How far tools press or pull where there is no motion.
        #[arg(long, default_value = "moderate", value_parser = ["light", "moderate", "strong"])]
        gesture: String,
        /// Compare with the full law on the scene's own mesh, not on a finer one, and keep the mesh.
        #[arg(long)]
        same_mesh: bool,
        /// Run all candidates, also those that cannot be the cheapest.
        #[arg(long)]
        exhaustive: bool,
        /// For this motion itself, not for others like it as well.
        #[arg(long)]
        alone: bool,
        /// Instead of a search: what this scene is off by along the motion.
        #[arg(long, value_name = "OTHER.json")]
        check: Option<PathBuf>,
        /// Folder for the advised scene, table and picture; default: the scene's.
        #[arg(short, long)]
        output: Option<PathBuf>,
    },
    /// Measure every setting's speed and accuracy on the shipped scenes. What is measured already is not measured again.
    Chart {
        /// Two scenes, two mesh sizes, one gesture: less than two minutes.
        #[arg(long)]
        quick: bool,
        /// Instead: maps of where methods fail, each point a run; with --quick on coarse grids.
        #[arg(long)]
        maps: bool,
        /// Instead: what scenes at rest cost, and the largest mesh of each model that keeps up with 1 kHz; with --quick one size.
        #[arg(long, conflicts_with_all = ["maps", "random"])]
        rate: bool,
        /// Instead: so many scenes drawn at random from a region that shall hold, each run to its end.
        #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "10000", conflicts_with = "maps")]
        random: Option<u64>,
        /// Of --random: another seed draws other scenes.
        #[arg(long, default_value_t = 1, requires = "random")]
        seed: u64,
        /// Of --random: number of the first scene.
        #[arg(long, default_value_t = 0, requires = "random")]
        first: u64,
        /// Of --random; default: as many as the machine has cores.
        #[arg(long, requires = "random")]
        threads: Option<usize>,
        /// Folder for chart.csv, front.md and the pictures; of maps for stability.csv and theirs; of --rate for rate.csv, of --random for random.csv.
        #[arg(short, long, default_value = "target/chart")]
        output: PathBuf,
    },
    /// Counts, masses, critical steps, time per substep, warnings.
    Inspect {
        /// SCENE.json or MODEL.fmu
        model: PathBuf,
        #[arg(long)]
        json: bool,
    },
    /// The scene's equilibrium by a sparse direct solution, tools ignored.
    Reference {
        scene: PathBuf,
        /// Apply the scene's scripted cuts first.
        #[arg(long)]
        after_cuts: bool,
        /// JSON file; default: standard output.
        #[arg(short, long)]
        output: Option<PathBuf>,
    },
    /// Print the JSON Schema of scene files.
    Schema,
}

fn tolerance(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|v| *v > 0.0 && *v < 1.0);
    value.ok_or_else(|| "must be a number above 0 and below 1, such as 0.05".into())
}

fn rate(text: &str) -> Result<f64, String> {
    let range = 1.0..=100_000.0;
    let value = text.parse::<f64>().ok().filter(|v| range.contains(v));
    value.ok_or_else(|| "must be from 1 to 100000 Hz".into())
}

fn main() -> ExitCode {
    // Output into a closed pipe (`| head`) ends quietly, below.
    let outcome = match Arguments::parse().command {
        Command::Demo { output } => command::demo::run(&output),
        Command::Build { scene, output } => command::build::run(&scene, output),
        Command::Run {
            model,
            motion,
            stop,
            step,
            rates,
            output,
        } => command::run::run(&model, motion.as_deref(), stop, step, rates, &output),
        Command::Advise {
            scene,
            tolerance,
            rate,
            motion,
            gesture,
            same_mesh,
            exhaustive,
            alone,
            check,
            output,
        } => command::advise::run(
            &scene,
            &command::advise::Request {
                tolerance,
                rate,
                motion,
                gesture,
                same_mesh,
                exhaustive,
                alone,
                check,
                output,
            },
        ),
        Command::Chart {
            quick,
            maps: true,
            output,
            ..
        } => command::chart::run_maps(quick, &output),
        Command::Chart {
            quick,
            rate: true,
            output,
            ..
        } => command::chart::run_rate(quick, &output),
        Command::Chart {
            random: Some(count),
            seed,
            first,
            threads,
            output,
            ..
        } => command::chart::run_random(seed, first, count, threads, &output),
        Command::Chart { quick, output, .. } => command::chart::run(quick, &output),
        Command::Inspect { model, json } => command::inspect::run(&model, json),
        Command::Reference {
            scene,
            after_cuts,
            output,
        } => command::reference::run(&scene, after_cuts, output.as_deref()),
        Command::Schema => command::schema(),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is_closed_pipe() => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(1)
        }
    }
}
