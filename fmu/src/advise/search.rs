//! Runs candidates, and leaves out what cannot be cheaper than one that will do.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::prepared::PrepareError;
use tissue::scene::Scene;

use super::candidate;
use super::error::{Off, off};
use super::grid::{Grid, Spots};
use super::neighbour::{NEIGHBOURS, SWEEPS, changed};
use super::track::{self, Track};
use crate::chart::compare::Points;
use crate::chart::measure::quantile;
use crate::chart::settings::{FULL, Family, SettingRow, full_law};
use crate::chart::site::Site;
use crate::motion::Motion;

/// Share of the tolerance that an advice may use: the rest is for motions that were not tried.
pub const MARGIN: f64 = 0.9;
/// Runs of what is right enough, for its wall time: of each step the shortest counts, as others may use the machine.
const RUNS: usize = 3;
/// Of what tools touch, so many places say what is near.
const SEEDS: usize = 300;

/// What is asked for.
#[derive(Clone, Copy, Debug)]
pub struct Wish {
    /// \[1\]
    pub tolerance: f64,
    /// Steps a second.
    pub rate: f64,
    /// Nothing is left out.
    pub exhaustive: bool,
    /// For the motion itself, not for others like it.
    pub alone: bool,
}

/// What became of a candidate.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    Meets,
    /// Not right enough.
    Off,
    /// Right enough on these motions, but by errors that cancel: the full law on the same mesh and element is not.
    Luck,
    /// Right enough, but 99 % of the steps are longer than the period allows.
    Slow,
    /// Not run: cannot be cheaper than one that will do.
    Dearer,
    /// Why there is no such model, or why a step was not made.
    Refused(String),
}

impl Outcome {
    pub fn text(&self) -> &str {
        match self {
            Outcome::Meets => "meets",
            Outcome::Off => "off",
            Outcome::Luck => "luck",
            Outcome::Slow => "slow",
            Outcome::Dearer => "dearer",
            Outcome::Refused(why) => why,
        }
    }
}

/// A setting on a mesh.
#[derive(Clone)]
pub struct Row {
    pub setting: &'static SettingRow,
    pub grid: usize,
    pub scene: Scene,
    pub dynamic: usize,
    /// Of a millisecond \[kflop\]: before it was run, and counted.
    pub predicted: Option<f64>,
    pub work: Option<f64>,
    pub substeps: Option<f64>,
    /// Wall time of a step \[us\].
    pub median: Option<f64>,
    pub step_99: Option<f64>,
    /// On the motion itself, and the worst of all motions that were tried.
    pub own: Option<Off>,
    pub off: Option<Off>,
    pub outcome: Outcome,
}

/// A body's mesh with what the full law does on it.
pub struct Place {
    pub grid: Grid,
    pub site: Site,
    spots: Spots,
    scout: Track,
    /// Whether tissue goes.
    cuts: bool,
}

/// A motion, and the true run of it.
struct Truth {
    motion: Option<Motion>,
    stop: f64,
    track: Track,
}

pub struct Search<'a> {
    base: Scene,
    path: &'a Path,
    pub wish: Wish,
    points: Points,
    /// From fine to coarse; the first is the scene's own.
    pub places: Vec<Place>,
    reference: Option<(Grid, Spots)>,
    truths: Vec<Truth>,
    /// What the full law is off by, by place and the name of the row with its element; none where it was not run to the end.
    full: HashMap<(usize, &'static str), Option<Off>>,
    motion: Option<Motion>,
    stop: f64,
}

/// Why there is nothing to compare with.
#[derive(Debug, thiserror::Error)]
pub enum SearchError {
    #[error(transparent)]
    Prepare(#[from] PrepareError),
    #[error("{0}: no reference to compare with: by the full law {1}")]
    Reference(String, String),
    #[error("{0}: nothing moves in this scene: needs a --motion that meets tissue")]
    Still(String),
}

impl<'a> Search<'a> {
    /// Runs the full law on all meshes and the reference. The scene is computed with one damping, that of the full law where
    /// none is said, by all candidates.
    pub fn new(
        mut base: Scene,
        path: &'a Path,
        wish: Wish,
        grids: (Vec<Grid>, Option<Grid>),
        motion: Option<Motion>,
        stop: f64,
        tick: impl Fn(),
    ) -> Result<Search<'a>, SearchError> {
        base.integration.haptic_rate = wish.rate;
        let (grids, finer) = grids;
        let full = candidate::setting(FULL).ok_or_else(|| no_reference(path, "is none"))?;
        let coarsest = &grids[grids.len() - 1];
        let points = Points::new(&coarsest.mesh, &coarsest.surface);
        let mut places: Vec<Place> = Vec::new();
        for grid in grids {
            let spots = grid.spots(&points);
            let site = Site::new(&grid.mesh, |_| 0.0, &[]);
            let found = scout(
                &base,
                &grid,
                &site,
                full,
                path,
                &spots,
                motion.as_ref(),
                stop,
            );
            tick();
            let (model, scout) = match found {
                Ok(found) => found,
                // Of a coarser mesh nothing is needed.
                Err(_) if !places.is_empty() => continue,
                Err(why) => return Err(why),
            };
            if base.integration.damping.is_none() {
                base.integration.damping = Some(model.damping());
            }
            let cuts = scout.gone.contains(&true);
            let mut gone = scout.gone.clone();
            if let (true, Some(motion)) = (cuts && !wish.alone, &motion) {
                for change in &SWEEPS {
                    let other = changed(motion, &base, &scout.met, change);
                    // One that cannot be run to its end cuts no more than is known.
                    if let Ok(run) = track::run(&model, &spots, Some(&other), stop) {
                        gone.iter_mut().zip(&run.gone).for_each(|(a, b)| *a |= b);
                    }
                }
            }
            let site = region(&grid, &spots, &scout, &gone);
            places.push(Place {
                grid,
                site,
                spots,
                scout,
                cuts,
            });
        }
        let reference = finer.map(|grid| {
            let spots = grid.spots(&points);
            (grid, spots)
        });
        let mut search = Search {
            base,
            path,
            wish,
            points,
            places,
            reference,
            truths: Vec::new(),
            full: HashMap::new(),
            motion,
            stop,
        };
        search.learn(0)?;
        tick();
        let moved = |u: &Option<Vec3>| u.is_some_and(|u| u.norm() > 0.0);
        if !search.truths[0].track.shape.iter().flatten().any(moved) {
            return Err(SearchError::Still(path.display().to_string()));
        }
        Ok(search)
    }

    /// Motions that an advice must hold for: the given one, and its neighbours where a tool meets tissue.
    pub fn motions(&self) -> usize {
        let met = self.places[0].scout.met.iter().any(Option::is_some);
        match self.motion {
            Some(_) if met && !self.wish.alone => 1 + NEIGHBOURS.len(),
            _ => 1,
        }
    }

    /// The true run of motion `k`, once.
    fn learn(&mut self, k: usize) -> Result<(), SearchError> {
        if self.truths.len() > k {
            return Ok(());
        }
        let (motion, stop) = match (k, &self.motion) {
            (1.., Some(motion)) => {
                let change = &NEIGHBOURS[k - 1];
                let met = &self.places[0].scout.met;
                let motion = changed(motion, &self.base, met, change);
                (Some(motion), self.stop / change.speed)
            }
            _ => (self.motion.clone(), self.stop),
        };
        let full = candidate::setting(FULL).ok_or_else(|| no_reference(self.path, "is none"))?;
        let own = (&self.places[0].grid, &self.places[0].spots);
        let (grid, spots) = self.reference.as_ref().map_or(own, |(g, s)| (g, s));
        let site = Site::new(&grid.mesh, |_| 0.0, &[]);
        let (_, track) = scout(
            &self.base,
            grid,
            &site,
            full,
            self.path,
            spots,
            motion.as_ref(),
            stop,
        )?;
        self.truths.push(Truth {
            motion,
            stop,
            track,
        });
        Ok(())
    }

    /// What the full law is off by on the scene's own mesh: what no setting on it is freed from.
    pub fn off_of_mesh(&self) -> Off {
        off(&self.points, &self.places[0].scout, &self.truths[0].track)
    }

    pub fn reference(&self) -> Option<&Grid> {
        self.reference.as_ref().map(|(grid, _)| grid)
    }

    /// Work of what is right for sure, on the scene's mesh \[kflop\].
    pub fn safest(&self) -> Option<f64> {
        let place = &self.places[0];
        let source = &place.grid.source;
        candidate::safest(&self.base, source, &place.site, self.path, place.scout.held)
            .map(|flop| 1e-3 * flop)
    }

    /// Rows from coarse to fine, and which of them is the advice.
    pub fn run(&mut self, tick: impl Fn()) -> Result<(Vec<Row>, Option<usize>), SearchError> {
        let mut rows: Vec<Row> = Vec::new();
        let mut best: Option<usize> = None;
        // By setting, on the mesh before: finer is never cheaper.
        let mut known: HashMap<&str, f64> = HashMap::new();
        for grid in (0..self.places.len()).rev() {
            for setting in candidate::settings() {
                let most = best.and_then(|k| rows[k].work).unwrap_or(f64::INFINITY);
                let least = known.get(setting.name).copied().unwrap_or(0.0);
                let row = match !self.wish.exhaustive && least >= most {
                    true => self.unknown(setting, grid, Outcome::Dearer),
                    false => self.row(setting, grid, most)?,
                };
                tick();
                // A part that grows with what is cut can come out the same.
                if rows.iter().any(|r| r.grid == grid && r.scene == row.scene) {
                    continue;
                }
                if let Some(work) = row.predicted {
                    known.insert(setting.name, work);
                }
                if row.outcome == Outcome::Meets && row.work.is_some_and(|w| w < most) {
                    best = Some(rows.len());
                }
                rows.push(row);
            }
        }
        Ok((rows, best))
    }

    fn unknown(&self, setting: &'static SettingRow, grid: usize, outcome: Outcome) -> Row {
        let place = &self.places[grid];
        Row {
            setting,
            grid,
            scene: candidate::scene(&self.base, &place.grid.source, &place.site, setting),
            dynamic: 0,
            predicted: None,
            work: None,
            substeps: None,
            median: None,
            step_99: None,
            own: None,
            off: None,
            outcome,
        }
    }

    /// Builds it, and runs it where it may be cheaper than `most` \[kflop\].
    fn row(
        &mut self,
        setting: &'static SettingRow,
        grid: usize,
        most: f64,
    ) -> Result<Row, SearchError> {
        let place = &self.places[grid];
        let mut row = self.unknown(setting, grid, Outcome::Dearer);
        let can_cut = place.cuts || !self.base.cuts.is_empty();
        if can_cut && setting.family == Family::QuasiStatic {
            row.outcome = Outcome::Refused("what is cut must be dynamic".into());
            return Ok(row);
        }
        let model = match candidate::model(&mut row.scene, setting, self.path) {
            Ok(model) => model,
            Err(why) => {
                row.outcome = Outcome::Refused(why.to_string());
                return Ok(row);
            }
        };
        row.dynamic = model.parts.dynamic.iter().filter(|d| **d).count();
        row.predicted = candidate::predicted(&model, place.scout.held).map(|flop| 1e-3 * flop);
        match row.predicted {
            None => row.outcome = Outcome::Refused("its work is not counted".into()),
            Some(work) if work >= most && !self.wish.exhaustive => {}
            Some(_) => self.measure(&mut row, &model)?,
        }
        Ok(row)
    }

    /// Runs it along the motions as long as it is right enough, and times it.
    fn measure(&mut self, row: &mut Row, model: &Arc<Model>) -> Result<(), SearchError> {
        row.outcome = Outcome::Off;
        let allowed = MARGIN * self.wish.tolerance;
        let mut steps = Vec::new();
        for k in 0..self.motions() {
            self.learn(k)?;
            let truth = &self.truths[k];
            let spots = &self.places[row.grid].spots;
            let run = match track::run(model, spots, truth.motion.as_ref(), truth.stop) {
                Ok(run) => run,
                Err(why) => {
                    row.outcome = Outcome::Refused(why);
                    return Ok(());
                }
            };
            let found = off(&self.points, &run, &truth.track);
            if k == 0 {
                row.own = Some(found);
                row.work = run.work.map(|flop| 1e-3 * flop);
                row.substeps = Some(run.substeps);
                timed(row, &run.steps);
                steps = run.steps;
            }
            row.off = Some(row.off.map_or(found, |o| o.worst(found)));
            if row.off.is_none_or(|o| o.most() > allowed) && !self.wish.exhaustive {
                return Ok(());
            }
        }
        if row.off.is_none_or(|o| o.most() > allowed) {
            return Ok(());
        }
        let full = self.off_of_full(row.grid, full_law(model.element()));
        if full.is_none_or(|off| off.most() > self.wish.tolerance) {
            row.outcome = Outcome::Luck;
            return Ok(());
        }
        let keeps_up = |row: &Row| row.step_99.is_some_and(|time| time <= 1e6 / self.wish.rate);
        if !keeps_up(row) {
            timed(row, &self.shortest(row.grid, model, steps));
        }
        row.outcome = match keeps_up(row) {
            true => Outcome::Meets,
            false => Outcome::Slow,
        };
        Ok(())
    }

    /// Of each step of the motion, over some runs.
    fn shortest(&self, grid: usize, model: &Arc<Model>, mut steps: Vec<f64>) -> Vec<f64> {
        let truth = &self.truths[0];
        let spots = &self.places[grid].spots;
        for _ in 1..RUNS {
            if let Ok(run) = track::run(model, spots, truth.motion.as_ref(), truth.stop) {
                steps
                    .iter_mut()
                    .zip(&run.steps)
                    .for_each(|(a, b)| *a = a.min(*b));
            }
        }
        steps
    }

    /// Of the full law on a place, with the element of a row, along the motion alone; once.
    fn off_of_full(&mut self, grid: usize, name: &'static str) -> Option<Off> {
        if let Some(known) = self.full.get(&(grid, name)) {
            return *known;
        }
        let place = &self.places[grid];
        let truth = &self.truths[0];
        let run = || {
            let setting = candidate::setting(name)?;
            let mut scene = candidate::scene(&self.base, &place.grid.source, &place.site, setting);
            let model = candidate::model(&mut scene, setting, self.path).ok()?;
            let run = track::run(&model, &place.spots, truth.motion.as_ref(), truth.stop).ok()?;
            Some(off(&self.points, &run, &truth.track))
        };
        let found = match name == FULL {
            true => Some(off(&self.points, &place.scout, &truth.track)),
            false => run(),
        };
        self.full.insert((grid, name), found);
        found
    }

    /// Another scene of the same body, along the motion alone.
    pub fn check(
        &self,
        other: &Scene,
        path: &Path,
    ) -> Result<(Off, Option<f64>, f64), SearchError> {
        let wrong = |why: String| SearchError::Reference(path.display().to_string(), why);
        let mut other = other.clone();
        other.integration.haptic_rate = self.wish.rate;
        let grid = Grid::new(other.mesh.clone(), path)?;
        let spots = grid.spots(&self.points);
        let model = Arc::new(tissue::prepared::prepare(other, path)?);
        let truth = &self.truths[0];
        let run = track::run(&model, &spots, truth.motion.as_ref(), truth.stop).map_err(wrong)?;
        let found = off(&self.points, &run, &truth.track);
        let work = run.work.map(|flop| 1e-3 * flop);
        Ok((found, work, 1e6 * quantile(&run.steps, 0.99)))
    }
}

fn timed(row: &mut Row, steps: &[f64]) {
    row.median = Some(1e6 * quantile(steps, 0.5));
    row.step_99 = Some(1e6 * quantile(steps, 0.99));
}

fn no_reference(path: &Path, why: &str) -> SearchError {
    SearchError::Reference(path.display().to_string(), why.into())
}

#[expect(clippy::too_many_arguments, reason = "a run is of all of these")]
fn scout(
    base: &Scene,
    grid: &Grid,
    site: &Site,
    full: &SettingRow,
    path: &Path,
    spots: &Spots,
    motion: Option<&Motion>,
    stop: f64,
) -> Result<(Arc<Model>, Track), SearchError> {
    let mut scene = candidate::scene(base, &grid.source, site, full);
    let model = candidate::model(&mut scene, full, path)?;
    let track = track::run(&model, spots, motion, stop);
    Ok((model, track.map_err(|why| no_reference(path, &why))?))
}

/// From what is cut, with a ring round it, and what tools touch outwards; where they touch nothing, from what moves most.
fn region(grid: &Grid, spots: &Spots, scout: &Track, gone: &[bool]) -> Site {
    let mesh = &grid.mesh;
    let mut cut = gone.to_vec();
    let mut is_near = vec![false; mesh.nodes.len()];
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        if gone[t] {
            nodes.iter().for_each(|v| is_near[*v as usize] = true);
        }
    }
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        cut[t] |= nodes.iter().any(|v| is_near[*v as usize]);
    }
    let lost = (0..mesh.nodes.len())
        .filter(|v| is_near[*v])
        .map(|v| mesh.nodes[v]);
    let mut seeds: Vec<Vec3> = scout.touched.iter().copied().chain(lost).collect();
    if seeds.is_empty() {
        seeds = moving_most(grid, spots, scout);
    }
    let every = seeds.len().div_ceil(SEEDS).max(1);
    let seeds: Vec<Vec3> = seeds.into_iter().step_by(every).collect();
    let distance = |p: &Vec3| {
        let squares = seeds.iter().map(|s| (p - s).norm_squared());
        squares.fold(f64::INFINITY, f64::min)
    };
    Site::new(mesh, distance, &cut)
}

/// Places that move by half of the largest displacement or more, at rest.
fn moving_most(grid: &Grid, spots: &Spots, scout: &Track) -> Vec<Vec3> {
    let Some(last) = scout.shape.last() else {
        return Vec::new();
    };
    let far = |u: &Option<Vec3>| u.map_or(0.0, |u| u.norm());
    let most = last.iter().map(far).fold(0.0, f64::max);
    let nodes = &grid.mesh.nodes;
    let place = |(t, shares): &(u32, [f64; 4])| -> Vec3 {
        let corners = grid.mesh.tetrahedra[*t as usize];
        (0..4).map(|j| nodes[corners[j] as usize] * shares[j]).sum()
    };
    let moved = last.iter().zip(spots).filter(|(u, _)| far(u) >= 0.5 * most);
    moved.map(|(_, spot)| place(spot)).collect()
}
