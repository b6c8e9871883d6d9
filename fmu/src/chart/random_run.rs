//! Runs of scenes drawn at random: what came of each, and a table of all.

use std::fmt::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use tissue::mesh::Vec3;
use tissue::simulation::Simulation;

use super::maps::{Outcome, stopped};
use super::random::{Drawn, FACTS, KINDS, Key, LAWS, REGION, STROKE, draw};

/// What came of a scene.
pub struct Ended {
    pub index: u64,
    pub law: usize,
    pub kind: &'static str,
    pub scheme: &'static str,
    pub facts: [f64; FACTS.len()],
    pub story: String,
    pub outcome: Outcome,
    pub symptom: String,
    /// Smallest det F on the way, and at the end.
    pub least: f64,
    pub last: f64,
    /// Residual of the energy account, of the most there was.
    pub residual: f64,
    pub seconds: f64,
}

/// Share of the energy in play that the account may miss: what the watchdog allows.
const RESIDUAL: f64 = 0.05;
/// And of what is booked, where the law is not linear or pieces turn.
const BOOKED: f64 = 0.01;
/// Energies below this \[J\] are not compared.
const FLOOR: f64 = 1e-9;

fn position(keys: &[Key], time: f64) -> (Vec3, bool) {
    let next = keys.partition_point(|k| k.time <= time + 1e-12);
    let Some(before) = next.checked_sub(1).map(|k| &keys[k]) else {
        return (keys[0].position, keys[0].active);
    };
    let Some(after) = keys.get(next) else {
        return (before.position, before.active);
    };
    let share = (time - before.time) / (after.time - before.time);
    (before.position.lerp(&after.position, share), before.active)
}

struct Found {
    outcome: Outcome,
    symptom: String,
    least: f64,
    last: f64,
    residual: f64,
}

/// Runs a scene to its end.
fn simulate(drawn: &Drawn) -> Found {
    let found = |outcome, symptom: String, least, last, residual| Found {
        outcome,
        symptom,
        least,
        last,
        residual,
    };
    let refused = |e: String| found(Outcome::Refused, e, 1.0, 1.0, 0.0);
    let scene = match tissue::scene::parse(&drawn.scene.to_string(), "random") {
        Ok(scene) => scene,
        Err(e) => return refused(e.to_string()),
    };
    let model = match tissue::prepared::prepare(scene, Path::new("random")) {
        Ok(model) => Arc::new(model),
        Err(e) => return refused(e.to_string()),
    };
    let euler = drawn.scheme == "euler";
    let mut s = Simulation::new(model);
    let (mut least, mut halvings, mut strikes) = (1.0f64, 0, 0);
    let (mut most, mut worst) = (0.0f64, 0.0f64);
    let steps = (drawn.length / drawn.step).ceil() as u64;
    let looks = (steps / 40).max(1);
    for k in 1..=steps {
        let time = drawn.step * k as f64;
        for (tool, keys) in drawn.tools.iter().enumerate() {
            let (at, active) = position(keys, time);
            for axis in 0..3 {
                s.set_pose_input(tool, axis, at[axis]);
            }
            s.set_active(tool, active);
        }
        if let Err(e) = s.step(drawn.step) {
            let last = s.minimum_volume_ratio();
            return found(
                Outcome::Discarded,
                stopped(&e),
                least.min(last),
                last,
                worst,
            );
        }
        halvings = halvings.max(s.halvings());
        let energy = s.energy();
        let residual = (energy.balance() - s.state().account.start).abs();
        let stored = energy.elastic + energy.kinetic;
        most = most.max(stored);
        let tools = s.state().tools.iter();
        let force: f64 = tools.map(|t| t.force.norm() + t.torque.norm()).sum();
        if !(residual + stored + force).is_finite() {
            let symptom = format!("not finite at {:.0} ms", 1e3 * time);
            return found(Outcome::Failed, symptom, least, least, worst);
        }
        let booked = energy.dissipated.abs() + energy.support_work.abs() + energy.gravity.abs();
        let limit =
            RESIDUAL * (stored + energy.tool_work.abs()).max(FLOOR) + BOOKED * booked + 1e-4 * most;
        worst = worst.max(residual / (most + energy.tool_work.abs()).max(FLOOR));
        strikes = if residual > limit && !euler {
            strikes + 1
        } else {
            0
        };
        if strikes >= 2 || strikes == 1 && k == steps {
            let symptom = format!(
                "energy off by {residual:.1e} J of {stored:.1e} at {:.0} ms",
                1e3 * time
            );
            return found(Outcome::Failed, symptom, least, least, worst);
        }
        if k % looks == 0 {
            least = least.min(s.minimum_volume_ratio());
            let far = (s.state().displacement.iter()).map(|u| u.xyz().norm());
            let far = far.fold(0.0, f64::max);
            if far > drawn.horizon {
                let symptom = format!("{far:.1e} m away at {:.0} ms", 1e3 * time);
                return found(Outcome::Failed, symptom, least, least, worst);
            }
        }
    }
    let last = s.minimum_volume_ratio();
    least = least.min(last);
    if last <= 0.0 {
        let symptom = format!("ends with det F {last:.3}");
        return found(Outcome::Failed, symptom, least, last, worst);
    }
    match halvings {
        0 => found(Outcome::Stable, String::new(), least, last, worst),
        n => found(
            Outcome::Halved,
            format!("halved up to {n} times"),
            least,
            last,
            worst,
        ),
    }
}

/// One scene.
pub fn one(seed: u64, index: u64) -> Ended {
    let start = std::time::Instant::now();
    let drawn = draw(seed, index);
    let found = catch_unwind(AssertUnwindSafe(|| simulate(&drawn))).unwrap_or_else(|_| Found {
        outcome: Outcome::Failed,
        symptom: "panicked".into(),
        least: 1.0,
        last: 1.0,
        residual: 0.0,
    });
    Ended {
        index,
        law: drawn.law,
        kind: drawn.kind,
        scheme: drawn.scheme,
        facts: drawn.facts,
        story: drawn.story,
        outcome: found.outcome,
        symptom: found.symptom,
        least: found.least,
        last: found.last,
        residual: found.residual,
        seconds: start.elapsed().as_secs_f64(),
    }
}

/// Scenes `first` to below `first + count` of `seed`, in their order.
pub fn run(
    seed: u64,
    first: u64,
    count: u64,
    threads: usize,
    done: impl Fn() + Sync,
) -> Vec<Ended> {
    let next = AtomicU64::new(0);
    let work = || {
        let mut ended = vec![];
        loop {
            let k = next.fetch_add(1, Ordering::Relaxed);
            if k >= count {
                return ended;
            }
            ended.push(one(seed, first + k));
            done();
        }
    };
    let mut all: Vec<Ended> = thread::scope(|scope| {
        let threads: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(work)).collect();
        let joined = threads.into_iter().flat_map(|t| t.join());
        joined.flatten().collect()
    });
    all.sort_by_key(|e| e.index);
    all
}

impl Ended {
    pub fn holds(&self) -> bool {
        matches!(self.outcome, Outcome::Stable | Outcome::Halved) || self.gave_way()
    }

    /// St Venant and Kirchhoff's law, which cannot bring a tetrahedron back, stopped at det F = 0, the state kept.
    pub fn gave_way(&self) -> bool {
        let law = LAWS[self.law].law;
        let stops = matches!(law, "stVenantKirchhoff" | "adaptive" | "polynomial");
        stops && self.outcome == Outcome::Discarded && self.symptom.starts_with("det F")
    }
}

/// What is drawn, as Markdown.
pub fn region() -> String {
    let r = &REGION;
    let range = |[low, high]: [f64; 2]| format!("{low} to {high}");
    let rows = [
        ("Young's modulus, Pa", range(r.young_modulus)),
        ("Poisson's ratio", range(r.poisson_ratio)),
        ("density, kg/m3", range(r.density)),
        ("longest side, m", range(r.size)),
        ("tetrahedra, about", range(r.tetrahedra.map(|n| n as f64))),
        ("smallest dihedral angle, degrees", range(r.dihedral)),
        ("speed of tools, m/s", range(r.speed)),
        ("rest of tools before they turn, s", STROKE.to_string()),
        ("communication step, s", range(r.step)),
        ("simulated, s", range(r.length)),
    ];
    let mut text = String::from("| whatever the law | |\n|---|---|\n");
    for (name, values) in rows {
        text += &format!("| {name} | {values} |\n");
    }
    text += "\n| law | element | way of a tool | change of height | strain by weight |\n|---|---|---|---|---|\n";
    for row in &LAWS {
        text += &format!(
            "| {} | {} | {} | {} | {} |\n",
            row.law, row.element, row.way, row.squeeze, row.weight
        );
    }
    text
}

/// Counts by law, element and kind, as Markdown.
pub fn summary(ended: &[Ended]) -> String {
    let mut text = String::from(
        "| law | element | kind | runs | halved | discarded | refused | failed | smallest det F | at the end |\n|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for (law, row) in LAWS.iter().enumerate() {
        for kind in KINDS {
            let of: Vec<&Ended> = (ended.iter())
                .filter(|e| e.law == law && e.kind == kind)
                .collect();
            if of.is_empty() {
                continue;
            }
            let count = |o| of.iter().filter(|e| e.outcome == o).count();
            let least = |f: fn(&Ended) -> f64| of.iter().map(|e| f(e)).fold(1.0, f64::min);
            text += &format!(
                "| {} | {} | {kind} | {} | {} | {} | {} | {} | {:.2} | {:.2} |\n",
                row.law,
                row.element,
                of.len(),
                count(Outcome::Halved),
                count(Outcome::Discarded),
                count(Outcome::Refused),
                count(Outcome::Failed),
                least(|e| e.least),
                least(|e| e.last),
            );
        }
    }
    text
}

/// Of the runs, a row each.
pub fn csv(seed: u64, ended: &[Ended]) -> String {
    let mut text = format!(
        "seed,index,law,element,kind,scheme,{},story,outcome,least,last,residual,seconds,symptom\n",
        FACTS.join(",")
    );
    for e in ended {
        let facts = e.facts.map(|f| format!("{f:.4e}")).join(",");
        let law = &LAWS[e.law];
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{seed},{},{},{},{},{},{facts},{},{},{:.4},{:.4},{:.1e},{:.4},\"{}\"",
            e.index,
            law.law,
            law.element,
            e.kind,
            e.scheme,
            e.story,
            e.outcome.name(),
            e.least,
            e.last,
            e.residual,
            e.seconds,
            e.symptom.replace('"', "\"\"")
        );
    }
    text
}
