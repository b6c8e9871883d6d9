//! Which rows there are, which are known, and what makes the others.

use std::collections::HashMap;

use indicatif::ProgressBar;
use tissue::mesh::Vec3;
use tissue::model::Fnv;
use tissue::prepared::PrepareError;

use super::body::Body;
use super::compare::Points;
use super::desk::{Desk, Prepared};
use super::record::Record;
use super::scenes::{GESTURES, GestureRow, MOTION, SCENES, SceneRow};
use super::settings::{SETTINGS, SettingRow};

/// Of the product.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// What is charted of a scene.
pub struct Plan {
    pub scene: &'static SceneRow,
    pub gestures: Vec<&'static GestureRow>,
    /// From the finest to the coarsest \[m\].
    pub sizes: Vec<f64>,
    /// \[m\]
    pub reference: f64,
    quick: bool,
}

/// All of it, or two bodies, two sizes and one gesture, measured against the third size.
pub fn plans(quick: bool) -> Vec<Plan> {
    let scenes = SCENES.iter().take(if quick { 2 } else { SCENES.len() });
    let plan = |scene: &'static SceneRow| {
        let [coarse, middle, fine] = scene.sizes;
        match quick {
            true => Plan {
                scene,
                gestures: vec![&GESTURES[1]],
                sizes: vec![middle, coarse],
                reference: fine,
                quick,
            },
            false => Plan {
                scene,
                gestures: GESTURES.iter().collect(),
                sizes: vec![fine, middle, coarse],
                reference: scene.reference,
                quick,
            },
        }
    };
    scenes.map(plan).collect()
}

impl Plan {
    /// Settings at a size.
    fn settings(&self, size: f64) -> Vec<&'static SettingRow> {
        let at = self.scene.sizes.iter().position(|s| *s == size);
        let charted = |s: &&SettingRow| at.is_some_and(|k| k < s.sizes) && (s.quick || !self.quick);
        SETTINGS.iter().filter(charted).collect()
    }

    /// Rows of it.
    pub fn rows(&self) -> usize {
        let settings = self.sizes.iter().map(|size| self.settings(*size).len());
        settings.sum::<usize>() * self.gestures.len()
    }

    /// Of all that a row follows from.
    fn key(&self, body: &Body, setting: &SettingRow, gesture: &GestureRow) -> String {
        let mut scene = body.with(setting);
        scene.mesh = (self.scene.mesh)(body.size);
        let mut hash = Fnv::default();
        hash.write(&serde_json::to_vec(&scene).unwrap_or_default());
        let numbers = [
            setting.substeps,
            gesture.share,
            self.scene.hold as f64,
            MOTION as f64,
            self.reference,
        ];
        for x in numbers.iter().chain(&self.scene.reach) {
            hash.write(&x.to_bits().to_le_bytes());
        }
        hash.write(VERSION.as_bytes());
        format!("{:016x}", hash.0)
    }

    /// Where a gesture moves the grip \[m\].
    pub fn reach(&self, gesture: &GestureRow) -> Vec3 {
        Vec3::from(self.scene.reach) * gesture.share
    }
}

/// Rows of the same version stay; known ones are not run again. `keep` is told all rows whenever there are new ones.
/// The rows of the plans, and how many of them were run.
pub fn run<E: From<PrepareError>>(
    plans: &[Plan],
    known: Vec<Record>,
    progress: &ProgressBar,
    mut keep: impl FnMut(&[Record]) -> Result<(), E>,
) -> Result<(Vec<Record>, usize), E> {
    let mut records: Vec<Record> = (known.into_iter())
        .filter(|r| r.version == VERSION)
        .collect();
    let mut planned = Vec::new();
    let mut count = 0;
    for plan in plans {
        let bodies = (plan.sizes.iter())
            .map(|size| Body::new(plan.scene, *size))
            .collect::<Result<Vec<Body>, _>>()?;
        let rows = || {
            bodies.iter().flat_map(|body| {
                let settings = plan.settings(body.size).into_iter();
                settings.flat_map(move |s| plan.gestures.iter().map(move |g| (body, s, *g)))
            })
        };
        let keys: Vec<String> = rows().map(|(b, s, g)| plan.key(b, s, g)).collect();
        let is_known = |records: &[Record], key: &String| records.iter().any(|r| r.key == *key);
        planned.extend(keys.iter().cloned());
        if keys.iter().all(|key| is_known(&records, key)) {
            progress.inc(keys.len() as u64);
            continue;
        }
        let coarsest = bodies.last().unwrap_or(&bodies[0]);
        let mut desk = Desk::new(plan, Points::new(&coarsest.mesh, &coarsest.surface));
        desk.find_reference(&bodies[0])?;
        let mut models: Option<(f64, &str, Prepared)> = None;
        for ((body, setting, gesture), key) in rows().zip(keys) {
            if !is_known(&records, &key) {
                let same = |m: &(f64, &str, Prepared)| m.0 == body.size && m.1 == setting.name;
                if !models.as_ref().is_some_and(same) {
                    models = Some((body.size, setting.name, Prepared::new(body, setting)));
                }
                if let Some((.., prepared)) = &models {
                    let mut record = desk.measure(body, setting, gesture, prepared)?;
                    record.key = key;
                    records.push(record);
                    keep(&records)?;
                    count += 1;
                }
            }
            progress.inc(1);
        }
    }
    let place: HashMap<&String, usize> = planned.iter().zip(0..).collect();
    records.sort_by_key(|r| place.get(&r.key).copied().unwrap_or(usize::MAX));
    if count > 0 {
        keep(&records)?;
    }
    records.retain(|r| place.contains_key(&r.key));
    Ok((records, count))
}
