//! What rows are compared with: the reference, and the full law on the same mesh.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use tissue::calibration::Calibration;
use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::prepared::PrepareError;

use super::body::Body;
use super::compare::{Places, Points};
use super::measure::{self, Run, quantile};
use super::record::Record;
use super::scenes::GestureRow;
use super::settings::{FULL, SETTINGS, SettingRow, full_law};
use super::study::{Plan, VERSION};
use super::work;

/// Runs of the calibration, of which the middle one counts.
const CALIBRATIONS: usize = 51;

/// A model, or why there is none, and how long it took \[s\].
pub struct Prepared {
    pub model: Result<Arc<Model>, String>,
    seconds: f64,
}

impl Prepared {
    pub fn new(body: &Body, setting: &SettingRow) -> Prepared {
        let start = Instant::now();
        Prepared {
            model: body.prepare(setting).map_err(|e| e.to_string()),
            seconds: start.elapsed().as_secs_f64(),
        }
    }
}

/// Where a gesture ends, and how it goes there.
struct Path {
    force: Vec<Vec3>,
    shape: Vec<Vec<Vec3>>,
}

impl Path {
    fn of(run: Run) -> Path {
        Path {
            force: run.force,
            shape: run.shape,
        }
    }

    /// Settled \[N\].
    fn end(&self) -> Vec3 {
        self.force.last().copied().unwrap_or_default()
    }

    fn last(&self) -> &[Vec3] {
        self.shape.last().map_or(&[], |s| s)
    }
}

/// What rows of one scene are compared with.
pub struct Desk<'a> {
    plan: &'a Plan,
    points: Points,
    /// By gesture.
    reference: HashMap<&'static str, Path>,
    /// Share of the force, and of the surface \[m\], that the reference may still be off, by gesture.
    remaining: HashMap<&'static str, (f64, f64)>,
    /// Of the full law by size, element's row and gesture; none where a step was not made.
    full: HashMap<(u64, &'static str, &'static str), Option<Path>>,
}

impl<'a> Desk<'a> {
    pub fn new(plan: &'a Plan, points: Points) -> Desk<'a> {
        Desk {
            plan,
            points,
            reference: HashMap::new(),
            remaining: HashMap::new(),
            full: HashMap::new(),
        }
    }

    /// The full law on the reference's mesh; what a finer one would change is estimated from the finest charted one, as of
    /// an error that falls with the first power of the size: that of patches with edges.
    pub fn find_reference(&mut self, finest: &Body) -> Result<(), PrepareError> {
        let plan = self.plan;
        let body = Body::new(plan.scene, plan.reference)?;
        let Some(full) = SETTINGS.iter().find(|s| s.name == FULL) else {
            return Ok(());
        };
        let places = self.points.on(&body.mesh, &body.surface);
        let model = body.prepare(full)?;
        for gesture in &plan.gestures {
            let run = measure::run(&model, &places, plan.reach(gesture), plan.scene.hold);
            if let Ok(run) = run {
                self.reference.insert(gesture.name, Path::of(run));
            }
        }
        for gesture in &plan.gestures {
            self.learn(finest, full, gesture)?;
            let check = self.full.get(&(finest.size.to_bits(), FULL, gesture.name));
            let (Some(Some(check)), Some(path)) = (check, self.reference.get(gesture.name)) else {
                continue;
            };
            let ratio = finest.size / plan.reference - 1.0;
            let force = (check.end() - path.end()).norm() / path.end().norm();
            let (surface, _) = self.points.distance(check.last(), path.last());
            (self.remaining).insert(gesture.name, (force / ratio, surface / ratio));
        }
        Ok(())
    }

    /// Runs the full law on a body, once.
    fn learn(
        &mut self,
        body: &Body,
        setting: &'static SettingRow,
        gesture: &'static GestureRow,
    ) -> Result<(), PrepareError> {
        let key = (body.size.to_bits(), setting.name, gesture.name);
        if self.full.contains_key(&key) {
            return Ok(());
        }
        let model = body.prepare(setting)?;
        let places = self.points.on(&body.mesh, &body.surface);
        let plan = self.plan;
        let run = measure::run(&model, &places, plan.reach(gesture), plan.scene.hold);
        self.full.insert(key, run.ok().map(Path::of));
        Ok(())
    }

    pub fn measure(
        &mut self,
        body: &Body,
        setting: &'static SettingRow,
        gesture: &'static GestureRow,
        prepared: &Prepared,
    ) -> Result<Record, PrepareError> {
        let places: Places = self.points.on(&body.mesh, &body.surface);
        let calibration = Calibration::default().seconds(CALIBRATIONS);
        let plan = self.plan;
        let run = prepared
            .model
            .as_ref()
            .map_err(String::clone)
            .and_then(|m| {
                let run = measure::run(m, &places, plan.reach(gesture), plan.scene.hold)?;
                Ok((m, run))
            });
        let mut record = Record {
            version: VERSION.into(),
            scene: plan.scene.name.into(),
            gesture: gesture.name.into(),
            setting: setting.name.into(),
            family: setting.family.name().into(),
            size: 1e3 * body.size,
            vertices: body.mesh.nodes.len(),
            tetrahedra: body.mesh.tetrahedra.len(),
            patch_nodes: body.patch.len(),
            outcome: "done".into(),
            preparation: Some(prepared.seconds),
            ..Record::default()
        };
        let (model, run) = match run {
            Ok(found) => found,
            Err(reason) => {
                record.outcome = reason;
                return Ok(record);
            }
        };
        debug_assert_eq!(run.held, body.patch.len());
        let flop = work::substep(model, run.nonlinear, run.held);
        record.substeps = Some(run.substeps);
        record.step_median = Some(1e6 * quantile(&run.steps, 0.5));
        record.step_99 = Some(1e6 * quantile(&run.steps, 0.99));
        record.step_worst = Some(1e6 * quantile(&run.steps, 1.0));
        record.steps = Some(run.steps.len());
        record.reading = Some(1e6 * run.reading);
        record.calibration = Some(1e6 * calibration);
        record.work = flop.map(|f| 1e-3 * f * run.substeps);
        record.drift = Some(100.0 * run.drift);
        record.least_volume = Some(run.least_volume);
        record.nonlinear_share = Some(run.nonlinear);
        let path = Path::of(run);
        let force = path.end();
        (record.force_x, record.force_y, record.force_z) =
            (Some(force.x), Some(force.y), Some(force.z));
        self.compare(&mut record, &path, body, gesture, full_law(model.element()))?;
        let key = (body.size.to_bits(), setting.name, gesture.name);
        if setting.name == full_law(model.element()) {
            self.full.insert(key, Some(path));
        }
        Ok(record)
    }

    /// With the reference, and with the full law on the same mesh and element.
    fn compare(
        &mut self,
        record: &mut Record,
        path: &Path,
        body: &Body,
        gesture: &'static GestureRow,
        full: &'static str,
    ) -> Result<(), PrepareError> {
        if record.setting != full
            && let Some(row) = SETTINGS.iter().find(|s| s.name == full)
        {
            self.learn(body, row, gesture)?;
        }
        let Some(reference) = self.reference.get(gesture.name) else {
            return Ok(());
        };
        let size = reference.end().norm();
        let percent = |a: Vec3, b: Vec3| 100.0 * (a - b).norm() / size;
        let (mean, largest) = self.points.distance(path.last(), reference.last());
        record.force_error = Some(percent(path.end(), reference.end()));
        if let [.., before, _] = &path.force[..path.force.len().saturating_sub(measure::EVERY - 1)]
        {
            record.settling = Some(percent(path.end(), *before));
        }
        record.surface_l2 = Some(1e3 * mean);
        record.surface_largest = Some(1e3 * largest);
        let most = (reference.force.iter()).map(Vec3::norm).fold(0.0, f64::max);
        let squares =
            (path.force.iter().zip(&reference.force)).map(|(a, b)| (a - b).norm_squared());
        let mean_square = squares.sum::<f64>() / path.force.len() as f64;
        record.path_force = Some(100.0 * mean_square.sqrt() / most);
        let looks = path.shape.iter().zip(&reference.shape);
        let worst = looks.map(|(a, b)| self.points.distance(a, b).0);
        record.path_surface = Some(1e3 * worst.fold(0.0, f64::max));
        record.reference_force = Some(size);
        record.reference_size = Some(1e3 * self.plan.reference);
        if let Some((force, surface)) = self.remaining.get(gesture.name) {
            record.reference_force_error = Some(100.0 * force);
            record.reference_surface_error = Some(1e3 * surface);
        }
        let own = match record.setting == full {
            true => Some(path),
            false => {
                (self.full.get(&(body.size.to_bits(), full, gesture.name))).and_then(Option::as_ref)
            }
        };
        if let Some(own) = own {
            record.modelling_force = Some(percent(path.end(), own.end()));
            record.modelling_surface = Some(1e3 * self.points.distance(path.last(), own.last()).0);
            record.discretisation_force = Some(percent(own.end(), reference.end()));
            record.discretisation_surface =
                Some(1e3 * self.points.distance(own.last(), reference.last()).0);
        }
        Ok(())
    }
}
