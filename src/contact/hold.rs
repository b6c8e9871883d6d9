//! Stick contact: a tool holds the vertices of the triangles it touches, and they follow its pose.
//!
//! No penalty spring: held vertices are prescribed, the force is read back as their reaction. A probe
//! lets a vertex go when its reaction turns to pull; a grasper when its jaws open. (The papers'
//! infinite friction.)

use super::geometry::{Capsule, boxes_meet};
use super::nearby::Nearby;
use super::slide;
use crate::loose;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::scene::ToolKind;
use crate::state::State;

/// A node that follows a path on some axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Held {
    pub node: u32,
    /// Tool index, or none for a prescribed node of the scene.
    pub tool: Option<u32>,
    /// Which prescribed node of the scene, where no tool holds it.
    pub support: u32,
    pub axes: [bool; 3],
    /// In the tool's frame \[m\].
    pub local: Vec3,
    /// Outward normal of the tissue at attachment, in the tool's frame.
    pub normal: Vec3,
    /// To be let go.
    pub pulls: bool,
    /// Not yet carried through a substep.
    pub fresh: bool,
    /// Way that it has slipped along the tool \[m\].
    pub slipped: f64,
    /// Displacement at the end of the substep \[m\], and the velocity that takes \[m/s\].
    pub target: Vec3,
    pub velocity: Vec3,
}

impl Held {
    pub fn by_support(support: u32, node: u32, axes: [bool; 3]) -> Held {
        Held {
            node,
            tool: None,
            support,
            axes,
            local: Vec3::zeros(),
            normal: Vec3::zeros(),
            pulls: false,
            fresh: false,
            slipped: 0.0,
            target: Vec3::zeros(),
            velocity: Vec3::zeros(),
        }
    }
}

/// A vertex that a probe has let go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Released {
    pub node: u32,
    pub tool: u32,
    /// Where it was then, in the tool's frame \[m\], and its outward normal there.
    pub local: Vec3,
    pub normal: Vec3,
}

/// How far, in radii, a vertex that was let go must come at the probe before it is held again. Zero
/// lets stick and pull chatter at rest; one lets the probe sink in.
const REATTACH_DEPTH: f64 = 0.05;

/// Force of the tissue on whatever holds a node \[N\]: elastic, damping, external; no inertia.
/// `loose` has been measured if the node belongs to a loose piece.
pub fn reaction(model: &Model, state: &State, loose: &loose::Scratch, held: &Held) -> Vec3 {
    let i = held.node as usize;
    if let Some(inside) = i.checked_sub(model.parts.moving) {
        return -state.coupling.pressure_on(inside);
    }
    let force = residual(model, state, loose, i);
    Vec3::from_fn(|axis, _| if held.axes[axis] { force[axis] } else { 0.0 })
}

/// f - dW/dx - drag on a moving node \[N\]. `loose` has been measured if it belongs to a loose piece.
pub fn residual(model: &Model, state: &State, loose: &loose::Scratch, i: usize) -> Vec3 {
    if state.live.pieces.is_loose(i) {
        return loose.residual(state, i);
    }
    let internal = state.live.internal_force(model, i, &state.displacement)
        - state.coupling.force_on(model, i);
    let damping = state.velocity[i].xyz() * (state.parameters.damping * state.live.mass[i]);
    state.external[i].xyz() - internal - damping
}

/// Share of a tool's forces that a grip of `most` \[N\] can bear, `total` being what it would take to follow the tool.
pub fn share(total: &Vec3, most: f64) -> f64 {
    let size = total.norm();
    if size > most { most / size } else { 1.0 }
}

/// Whether [`update`] will ask what tool `k` touches.
pub fn feels(model: &Model, state: &State, k: usize) -> bool {
    let (was, is) = (state.tools[k].active, state.tools[k].input_active);
    model.scene.tools[k].kind != ToolKind::Grasper || (is && !was)
}

/// Updates what tool `k` holds. `loose` has been measured where it holds loose tissue; `touched` is scratch. True where pre-computed tissue has been let go: it
/// springs back at once, so that what is touched then must be asked again.
#[must_use]
pub fn update(
    model: &Model,
    state: &mut State,
    k: usize,
    loose: &loose::Scratch,
    touched: &mut Vec<(u32, [u32; 3])>,
    nearby: &mut Nearby,
) -> bool {
    let tool = &model.scene.tools[k];
    let was_active = state.tools[k].active;
    let active = state.tools[k].input_active;
    state.tools[k].active = active;
    match tool.kind {
        ToolKind::Grasper if active && !was_active => {
            nearby.refresh(model, state, k, 0.0);
            touch(model, state, k, true, touched, nearby.all(k));
            attach(model, state, k, touched);
        }
        ToolKind::Grasper if !active && was_active => {
            release(model, state, |h| h.tool == Some(k as u32))
        }
        // What has slipped through is out.
        ToolKind::Grasper => {
            let length = model.tools[k].grip();
            release(model, state, |h| {
                h.tool == Some(k as u32) && h.slipped > length
            });
        }
        _ if slide::coefficient(model, k).is_some() => {}
        ToolKind::Cautery if active => release(model, state, |h| h.tool == Some(k as u32)),
        ToolKind::Probe | ToolKind::Cautery => {
            nearby.refresh(model, state, k, 0.0);
            touch(model, state, k, false, touched, nearby.all(k));
            if let_go(model, state, k, loose, touched) {
                return true;
            }
            attach(model, state, k, touched);
        }
    }
    false
}

/// Of these faces those that the tool touches, or its active part.
fn touch(
    model: &Model,
    state: &State,
    k: usize,
    active: bool,
    touched: &mut Vec<(u32, [u32; 3])>,
    faces: &[u32],
) {
    touched.clear();
    let (shape, pose) = (&model.tools[k], &state.tools[k].pose);
    let reach = (model.parts.moving + model.parts.touchable) as u32;
    for face in faces {
        let vertices = state.live.triangle(model, *face);
        if vertices.iter().any(|v| *v >= reach) {
            continue;
        }
        let corners = vertices.map(|v| state.position(v));
        let touches = |capsule: Capsule| {
            let (low, high) = capsule.bounds(0.0);
            boxes_meet(&corners, &low, &high)
                && capsule.may_touch(&corners)
                && capsule.touches(&corners)
        };
        let is_touched = match active {
            true => shape.active_at(pose).any(touches),
            false => shape.at(pose).any(touches),
        };
        if is_touched {
            touched.push((*face, vertices));
        }
    }
    // The order of the surface list depends on the history of cuts; that of contacts shall not.
    touched.sort_unstable();
    touched.dedup();
}

/// A probe lets go of vertices that pull, and forgets those it has let go once they are apart. Whether
/// any of them is pre-computed.
fn let_go(
    model: &Model,
    state: &mut State,
    k: usize,
    loose: &loose::Scratch,
    touched: &[(u32, [u32; 3])],
) -> bool {
    let tool = k as u32;
    state.released.retain(|r| {
        r.tool != tool
            || touched
                .iter()
                .any(|(_, vertices)| vertices.contains(&r.node))
    });
    let mut inside = false;
    for at in 0..state.held.len() {
        let held = state.held[at];
        if held.tool != Some(tool) {
            continue;
        }
        let normal = state.tools[k].pose.orientation * held.normal;
        if reaction(model, state, loose, &held).dot(&normal) < 0.0 {
            state
                .released
                .retain(|r| r.tool != tool || r.node != held.node);
            let (local, normal) = (held.local, held.normal);
            state.released.push(Released {
                node: held.node,
                tool,
                local,
                normal,
            });
            inside |= held.node as usize >= model.parts.moving;
            state.held[at].pulls = true;
        }
    }
    release(model, state, |h| h.pulls);
    inside
}

/// Holds every vertex of the touched triangles that nobody holds yet.
fn attach(model: &Model, state: &mut State, k: usize, touched: &[(u32, [u32; 3])]) {
    let tool = k as u32;
    let depth = REATTACH_DEPTH * model.tools[k].least_radius();
    for (_, vertices) in touched {
        let corners = vertices.map(|v| state.position(v));
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let Some(normal) = normal.try_normalize(0.0) else {
            continue;
        };
        for node in vertices {
            let i = *node as usize;
            // What anybody holds has no inverse mass.
            let axes = state.inverse_mass[i].0.map(|w| w > 0.0);
            let axes = [axes[0], axes[1], axes[2]];
            if axes == [false; 3] {
                continue;
            }
            let pose = state.tools[k].pose;
            let local = pose.local(&state.position(*node));
            let came = |r: &Released| (local - r.local).dot(&r.normal);
            let let_go = state
                .released
                .iter()
                .find(|r| r.tool == tool && r.node == *node);
            if let_go.is_some_and(|r| came(r) < depth) {
                continue;
            }
            state.held.push(Held {
                node: *node,
                tool: Some(tool),
                support: 0,
                axes,
                local,
                normal: pose.orientation.inverse_transform_vector(&normal),
                pulls: false,
                fresh: true,
                slipped: 0.0,
                target: state.displacement[i].xyz(),
                velocity: Vec3::zeros(),
            });
            for axis in 0..3 {
                if axes[axis] {
                    state.inverse_mass[i].0[axis] = 0.0;
                }
            }
        }
    }
}

/// Lets go of all that `which` names; the nodes keep their velocity.
pub fn release(model: &Model, state: &mut State, which: impl Fn(&Held) -> bool) {
    let State {
        held,
        inverse_mass,
        live,
        ..
    } = state;
    held.retain(|h| {
        let goes = which(h);
        if goes {
            // One tool holds a node at most; what supports hold is not free.
            let i = h.node as usize;
            let free = live.free(model, i);
            for axis in 0..3 {
                let moves = free[axis] && live.mass[i] > 0.0;
                inverse_mass[i].0[axis] = if moves { 1.0 / live.mass[i] } else { 0.0 };
            }
        }
        !goes
    });
}
