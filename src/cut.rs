//! Cutting: tetrahedra go, and the account books what goes with them.

use crate::contact::geometry::{Capsule, boxes_meet};
use crate::contact::hold;
use crate::model::Model;
use crate::state::State;

/// Removes one tetrahedron at a substep boundary. Its elastic energy, the kinetic and potential energy
/// of the mass that goes with it, and what its force lacks in the half-step account, count as
/// dissipated, so that the balance is the same before and after to round-off.
pub fn remove(model: &Model, state: &mut State, t: u32) {
    if !state.live.alive[t as usize] {
        return;
    }
    let nodes = model.mesh.tetrahedra[t as usize].map(|v| v as usize);
    let u = nodes.map(|i| state.displacement[i].xyz());
    let v = nodes.map(|i| state.velocity[i].xyz());
    let (internal, elastic) = model.tetrahedron_force(t as usize, &u);
    let mass = nodes.map(|i| state.live.mass[i]);
    let external = nodes.map(|i| state.external[i].xyz());
    state.live.remove(model, t);
    let h = state.clock.lag;
    let c = model.lagging_damping(state.parameters.damping);
    let mut lost = 0.0;
    for k in 0..4 {
        let i = nodes[k];
        state.refresh_node(model, i);
        state.refresh_external(model, i);
        let mass_gone = mass[k] - state.live.mass[i];
        let external_gone = external[k] - state.external[i].xyz();
        let force_gained = internal[k] + v[k] * (c * mass_gone) - external_gone;
        lost += elastic[k] + 0.5 * mass_gone * v[k].norm_squared()
            - 0.5 * h * v[k].dot(&force_gained)
            - external_gone.dot(&u[k]);
        if state.live.star_count[i] == 0 {
            state.velocity[i] = Default::default();
            hold::release(model, state, |held| held.node as usize == i);
        }
    }
    state.account.dissipated += lost;
}

/// Whether the active tip of cautery `k` touches pre-computed tissue, which cannot be cut.
pub fn spares(model: &Model, state: &State, k: usize) -> bool {
    if model.parts.touchable == 0 {
        return false;
    }
    let tool = &model.scene.tools[k];
    let capsule = Capsule::of(&tool.shape, &state.tools[k].pose, tool.active_length);
    let (low, high) = capsule.bounds(0.0);
    state.live.surface.iter().any(|face| {
        let vertices = state.live.triangle(model, *face);
        let [first, second] = model.topology.faces[*face as usize].tetrahedra;
        let owner = if state.live.alive[first as usize] {
            first
        } else {
            second
        };
        if model.parts.dynamic[owner as usize] {
            return false;
        }
        let corners = vertices.map(|v| state.position(model, v));
        boxes_meet(&corners, &low, &high) && capsule.touches(&corners)
    })
}
