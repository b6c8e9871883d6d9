//! One run: a grip moved and held, each step timed, force and shape read on the way.

use std::sync::Arc;
use std::time::Instant;

use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::simulation::Simulation;

use super::compare::Places;
use super::scenes::{MOTION, way};

/// Communication step \[s\].
const STEP: f64 = 1e-3;
/// Steps in which the grasper closes and caches fill; they are not counted.
const BEFORE: usize = 5;
/// Steps from one look at the shape to the next.
pub const EVERY: usize = 50;

/// What a run shows.
pub struct Run {
    /// Wall time of each step in which tissue did not sleep \[s\], pose set and force read included.
    pub steps: Vec<f64>,
    /// Wall time of reading all surface vertices once \[s\], the middle one.
    pub reading: f64,
    /// Of the tissue on the grasper after each step \[N\].
    pub force: Vec<Vec3>,
    /// Displacement of the points \[m\] after every [`EVERY`] steps; the last one settled.
    pub shape: Vec<Vec<Vec3>>,
    /// A step, in the mean.
    pub substeps: f64,
    /// Share of the dynamic tetrahedra whose law is not linear: the mean over the looks.
    pub nonlinear: f64,
    /// Smallest det F over the looks.
    pub least_volume: f64,
    /// Largest change of the energy balance over the looks, relative to the largest work of the tool.
    pub drift: f64,
    pub held: usize,
}

/// Moves the grip by `reach` \[m\] and holds it for `hold` steps. The error tells why a step was not made.
pub fn run(model: &Arc<Model>, places: &Places, reach: Vec3, hold: usize) -> Result<Run, String> {
    let mut simulation = Simulation::new(model.clone());
    simulation.set_active(0, true);
    for _ in 0..BEFORE {
        simulation.step(STEP).map_err(|e| e.to_string())?;
    }
    let steps = MOTION + hold;
    let mut run = Run {
        steps: Vec::with_capacity(steps),
        reading: 0.0,
        force: Vec::with_capacity(steps),
        shape: Vec::new(),
        substeps: 0.0,
        nonlinear: 0.0,
        least_volume: f64::INFINITY,
        drift: 0.0,
        held: simulation.state().held.len(),
    };
    let before = simulation.state().clock.total;
    let start = simulation.energy().balance();
    let (mut work, mut change) = (0.0f64, 0.0f64);
    let mut readings = Vec::new();
    for k in 1..=steps {
        let position = reach * way(k);
        let begun = Instant::now();
        for axis in 0..3 {
            simulation.set_pose_input(0, axis, position[axis]);
        }
        simulation
            .step(STEP)
            .map_err(|e| format!("at {k} ms: {e}"))?;
        run.force.push(simulation.tool(0).force);
        let taken = begun.elapsed().as_secs_f64();
        // What has come to rest costs next to nothing, whatever the setting.
        if !simulation.state().sleep.asleep {
            run.steps.push(taken);
        }
        if k % EVERY != 0 && k != steps {
            continue;
        }
        let begun = Instant::now();
        let sum: Vec3 = (0..model.surface_nodes.len())
            .map(|j| simulation.surface_vertex(j))
            .sum();
        readings.push(begun.elapsed().as_secs_f64());
        if !sum.norm().is_finite() {
            return Err(format!("at {k} ms: positions are not finite"));
        }
        run.shape.push(
            places.displacement(|node| simulation.displacement(model.node[node as usize] as usize)),
        );
        run.least_volume = run.least_volume.min(simulation.minimum_volume_ratio());
        run.nonlinear += simulation.nonlinear_fraction();
        let energy = simulation.energy();
        work = work.max(energy.tool_work.abs());
        change = change.max((energy.balance() - start).abs());
    }
    readings.sort_by(f64::total_cmp);
    run.reading = readings[readings.len() / 2];
    run.nonlinear /= run.shape.len() as f64;
    run.drift = change / work;
    run.substeps = (simulation.state().clock.total - before) as f64 / steps as f64;
    Ok(run)
}

/// The value that such a share of the times stay below.
pub fn quantile(times: &[f64], share: f64) -> f64 {
    let mut sorted = times.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = (share * (sorted.len() - 1) as f64).round() as usize;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::super::body::Body;
    use super::super::compare::Points;
    use super::super::scenes::SCENES;
    use super::super::settings::{FULL, SETTINGS};
    use super::*;
    use tissue::scene::{Prescribed, Region, Selector};

    /// A grip ends where Newton's method has the equilibrium of the same nodes displaced, force and shape; and holds these
    /// nodes alone.
    #[test]
    fn a_run_settles_in_equilibrium() {
        let full = SETTINGS.iter().find(|s| s.name == FULL).unwrap();
        for row in &SCENES {
            let body = Body::new(row, row.sizes[0]).unwrap();
            let points = Points::new(&body.mesh, &body.surface);
            let places = points.on(&body.mesh, &body.surface);
            let reach = 0.5 * Vec3::from(row.reach);
            let found = run(&body.prepare(full).unwrap(), &places, reach, row.hold).unwrap();
            assert_eq!(found.held, body.patch.len());
            let mut scene = body.with(full);
            scene.tools.clear();
            scene.prescribed = vec![Prescribed {
                selector: Selector {
                    optional: false,
                    region: Region::Nodes(body.patch.clone()),
                },
                displacement: [Some(reach.x), Some(reach.y), Some(reach.z)],
                ramp: 0.0,
            }];
            let model = tissue::prepared::prepare(scene, std::path::Path::new(row.name)).unwrap();
            let known = tissue::reference::solve(&model, false).unwrap();
            let force: Vec3 = (body.patch.iter())
                .map(|v| -Vec3::from(known.reaction[v]))
                .sum();
            let off = (found.force.last().unwrap() - force).norm() / force.norm();
            let shape = places.displacement(|v| known.displacement[v as usize].into());
            let (surface, _) = points.distance(found.shape.last().unwrap(), &shape);
            println!(
                "{}: force {off:.1e}, surface {:.1e}",
                row.name,
                surface / reach.norm()
            );
            assert!(off < 1e-3 && surface < 1e-3 * reach.norm(), "{}", row.name);
        }
    }
}
