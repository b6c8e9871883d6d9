//! One run of a model along a motion: forces, shapes, what was touched and cut, work and wall time.

use std::sync::Arc;
use std::time::Instant;

use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::scene::ToolKind;
use tissue::simulation::Simulation;

use super::grid::Spots;
use crate::chart::work;
use crate::motion::Motion;

/// Looks at the shape, at most; and how far apart they are at least \[s\].
const LOOKS: usize = 40;
const LOOK: f64 = 0.02;

pub struct Track {
    /// Of the tissue on each tool \[N\], all tools of a step one after the other.
    pub force: Vec<Vec3>,
    pub tools: usize,
    /// Displacement of the points \[m\] at each look; none where the tissue is gone.
    pub shape: Vec<Vec<Option<Vec3>>>,
    /// Wall time of each step \[s\].
    pub steps: Vec<f64>,
    /// A step, in the mean.
    pub substeps: f64,
    /// Counted, of a millisecond \[flop\]; none where work is not counted.
    pub work: Option<f64>,
    /// A tetrahedron each: whether it is gone in the end.
    pub gone: Vec<bool>,
    /// Rest positions of what tools held or slid on \[m\].
    pub touched: Vec<Vec3>,
    /// When each tool first met tissue \[s\]: held it, slid on it, burnt it.
    pub met: Vec<Option<f64>>,
    /// Nodes held by tools, in the mean.
    pub held: f64,
}

/// The error tells why a step was not made, in one line.
pub fn run(
    model: &Arc<Model>,
    spots: &Spots,
    motion: Option<&Motion>,
    stop: f64,
) -> Result<Track, String> {
    let period = 1.0 / model.scene.integration.haptic_rate;
    let steps = (stop / period - 1e-9).ceil().max(1.0) as usize;
    let every = steps.div_ceil(LOOKS).max((LOOK / period).ceil() as usize);
    let mut simulation = Simulation::new(model.clone());
    let tools = model.scene.tools.len();
    let mut track = Track {
        force: Vec::with_capacity(steps * tools),
        tools,
        shape: Vec::new(),
        steps: Vec::with_capacity(steps),
        substeps: 0.0,
        work: None,
        gone: Vec::new(),
        touched: Vec::new(),
        met: vec![None; tools],
        held: 0.0,
    };
    if let Some(motion) = motion {
        motion.steer(&mut simulation, 0.0, 0.0);
        simulation.place_tools().map_err(|e| e.to_string())?;
    }
    let burns = |simulation: &Simulation, tool: usize| {
        model.scene.tools[tool].kind == ToolKind::Cautery && simulation.tool(tool).active
    };
    let (mut nonlinear, mut removed) = (0.0, 0);
    let mut is_touched = vec![false; model.mesh.nodes.len()];
    for k in 1..=steps {
        let (now, end) = ((k - 1) as f64 * period, k as f64 * period);
        let begun = Instant::now();
        if let Some(motion) = motion {
            motion.steer(&mut simulation, now, end);
        }
        simulation
            .step(period)
            .map_err(|e| format!("at {:.0} ms: {e}", 1e3 * end))?;
        track
            .force
            .extend((0..tools).map(|tool| simulation.tool(tool).force));
        track.steps.push(begun.elapsed().as_secs_f64());
        let state = simulation.state();
        for held in state.held.iter().filter(|h| h.tool.is_some()) {
            track.held += 1.0;
            is_touched[held.node as usize] = true;
        }
        for contact in &state.contacts {
            contact
                .nodes
                .iter()
                .for_each(|v| is_touched[*v as usize] = true);
        }
        let is_cut = simulation.state().live.removed.len() > removed;
        removed = simulation.state().live.removed.len();
        for (tool, met) in track.met.iter_mut().enumerate() {
            let meets = simulation.tool(tool).in_contact || (is_cut && burns(&simulation, tool));
            if met.is_none() && meets {
                *met = Some(now);
            }
        }
        if simulation.spared() {
            return Err(format!(
                "at {:.0} ms: its pre-computed part would be cut",
                1e3 * end
            ));
        }
        if k % every == 0 || k == steps {
            nonlinear += simulation.nonlinear_fraction();
            let shape: Vec<_> = spots.iter().map(|s| moved(&mut simulation, s)).collect();
            if shape.iter().flatten().any(|u| !u.norm().is_finite()) {
                return Err(format!("at {:.0} ms: positions are not finite", 1e3 * end));
            }
            track.shape.push(shape);
        }
    }
    track.held /= steps as f64;
    track.substeps = simulation.state().clock.total as f64 / steps as f64;
    let nonlinear = nonlinear / track.shape.len() as f64;
    track.work = counted(model, nonlinear, track.held, track.substeps);
    track.gone = simulation.state().live.alive.iter().map(|a| !a).collect();
    track.touched = (0..is_touched.len())
        .filter(|v| is_touched[*v])
        .map(|v| simulation.state().live.rest[v])
        .collect();
    Ok(track)
}

/// Of a millisecond \[flop\]. Tissue that is pre-computed as a whole and that nothing holds does no work; one operation
/// stands for it.
pub fn counted(model: &Model, nonlinear: f64, held: f64, substeps: f64) -> Option<f64> {
    let substep = work::substep(model, nonlinear, held.round() as usize)?;
    Some((substep * substeps * model.scene.integration.haptic_rate / 1000.0).max(1.0))
}

/// Displacement of a point of the surface. Corners of a tetrahedron change where vertices split.
fn moved(simulation: &mut Simulation, (t, shares): &(u32, [f64; 4])) -> Option<Vec3> {
    let live = &simulation.state().live;
    if !live.alive[*t as usize] {
        return None;
    }
    let nodes = live.tetrahedra[*t as usize];
    let corners = (0..4).filter(|j| shares[*j] > 0.0);
    Some(
        corners
            .map(|j| simulation.displacement(nodes[j] as usize) * shares[j])
            .sum(),
    )
}
