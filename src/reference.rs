//! The same scene's equilibrium by sparse direct solutions: no substeps, no tools.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::cut;
use crate::live::LiveMesh;
use crate::loose;
use crate::mesh::Vec3;
use crate::mesh::topology::NONE;
use crate::model::Model;
use crate::model::dense::dot;
use crate::model::precomputed::Interface;
use crate::model::stiffness::Stiffness;
use crate::model::tensor_mass::{Pattern, Tensors};
use crate::newton::{self, Solution};
use crate::scene::Element;
use crate::state::State;
use crate::statics::{self, Factor, Numbering, StaticsError};

/// Node order and tetrahedra as in the scene's mesh.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Reference {
    /// Rest positions \[m\].
    pub nodes: Vec<[f64; 3]>,
    /// \[m\]; 0 for nodes without tetrahedra.
    pub displacement: Vec<[f64; 3]>,
    /// Force of the supports on each node that is held on some axis \[N\].
    pub reaction: BTreeMap<u32, [f64; 3]>,
    /// Smallest det F.
    pub minimum_volume_ratio: f64,
    /// Largest force out of balance relative to the largest force.
    pub residual: f64,
    pub iterations: usize,
}

/// Why a scene has no equilibrium.
#[derive(Debug, thiserror::Error)]
pub enum ReferenceError {
    #[error("{0}: {1}")]
    Statics(String, StaticsError),
    #[error(
        "{0}: in equilibrium {1} tetrahedra are inverted (smallest volume ratio {2:.3}); the linear law does not hold for so large a deformation: use less load or stiffer tissue"
    )]
    Inverted(String, usize, f64),
}

/// Prescribed displacements and loads at full value; all scripted cuts made first where `after_cuts`.
pub fn solve(model: &Model, after_cuts: bool) -> Result<Reference, ReferenceError> {
    let live = if after_cuts {
        let mut state = State::new(model);
        let mut scratch = cut::Scratch::new(model);
        let mut pieces = loose::Scratch::new(model);
        for scripted in &model.cuts {
            cut::event(
                model,
                &mut state,
                &mut scratch,
                &mut pieces,
                &scripted.tetrahedra,
            );
        }
        state.live
    } else {
        model.whole.clone()
    };
    let Solution {
        displacement: u,
        residual,
        corrections,
    } = equilibrium(model, &live).map_err(|e| ReferenceError::Statics(model.file.clone(), e))?;
    let mut smallest = f64::INFINITY;
    let mut inverted = 0;
    for (t, nodes) in live.tetrahedra.iter().enumerate() {
        if live.alive[t] {
            let f = model.shape[t].deformation_gradient(&nodes.map(|v| u[v as usize]));
            smallest = smallest.min(f.determinant());
            inverted += usize::from(f.determinant() <= 0.0);
        }
    }
    if inverted > 0 {
        return Err(ReferenceError::Inverted(
            model.file.clone(),
            inverted,
            smallest,
        ));
    }
    let internal = newton::internal_forces(model, &live, &u);
    let external = external(model, &live);
    let mut reaction = BTreeMap::new();
    for (scene_node, node) in model.node.iter().enumerate() {
        let i = *node as usize;
        // With what has been split from it.
        let spares = (0..live.origin.len()).filter(|k| live.origin[*k] == *node);
        let rows = spares.chain([i]).filter(|k| live.star_count[*k] > 0);
        if rows.clone().next().is_some() && model.boundary.free[i] != [true; 3] {
            let force: Vec3 = rows.map(|k| internal[k] - external[k]).sum();
            let held = Vec3::from_fn(|a, _| {
                if model.boundary.free[i][a] {
                    0.0
                } else {
                    force[a]
                }
            });
            reaction.insert(scene_node as u32, held.into());
        }
    }
    let by_scene = |of: &dyn Fn(usize) -> Vec3| -> Vec<[f64; 3]> {
        model
            .node
            .iter()
            .map(|node| of(*node as usize).into())
            .collect()
    };
    Ok(Reference {
        nodes: by_scene(&|i| model.mesh.nodes[i]),
        displacement: by_scene(&|i| {
            if live.star_count[i] > 0 {
                u[i]
            } else {
                Vec3::zeros()
            }
        }),
        reaction,
        minimum_volume_ratio: if smallest.is_finite() { smallest } else { 1.0 },
        residual,
        iterations: corrections,
    })
}

/// Of what is left, with prescribed displacements and loads at full value.
pub fn equilibrium(model: &Model, live: &LiveMesh) -> Result<Solution, StaticsError> {
    if live.pieces.rigid_modes > 0 {
        return Err(StaticsError::NotHeld);
    }
    let mut u = vec![Vec3::zeros(); model.mesh.nodes.len()];
    for prescribed in &model.boundary.prescribed {
        for axis in 0..3 {
            if prescribed.axes[axis] {
                u[prescribed.node as usize][axis] = prescribed.displacement[axis];
            }
        }
    }
    let free: Vec<[bool; 3]> = (live.star_count.iter().enumerate())
        .map(|(i, stars)| {
            if *stars > 0 {
                live.free(model, i)
            } else {
                [false; 3]
            }
        })
        .collect();
    for (new, origin) in live.origin.iter().enumerate() {
        if *origin != NONE {
            u[new] = u[*origin as usize];
        }
    }
    let external = external(model, live);
    if model.is_nonlinear() {
        return newton::solve(model, live, &free, &u, &external);
    }
    let (pattern, tensors) = assemble(model, live);
    let residual = statics::solve(&pattern, &tensors, &free, &external, &mut u)?;
    Ok(Solution {
        displacement: u,
        residual,
        corrections: 1,
    })
}

/// By how much reduced interface modes move the equilibrium: difference relative to the displacement of the
/// moving nodes, both as norms. None with all modes, or where nothing loads the scene.
///
/// With u in equilibrium and S_n in the place of S, (K + S_n) d = (S - S_n) u_c.
pub fn interface_error(model: &Model) -> Result<Option<f64>, StaticsError> {
    let Some(part) = &model.precomputed else {
        return Ok(None);
    };
    let Interface::Modes { .. } = part.interface else {
        return Ok(None);
    };
    let u = equilibrium(model, &model.whole)?.displacement;
    let (from, moving) = (model.parts.connected_from(), model.parts.moving);
    let mut packed: Vec<f64> = u[from..moving]
        .iter()
        .flat_map(|u| [u.x, u.y, u.z])
        .collect();
    let size = packed.len();
    packed.resize(size.next_multiple_of(4), 0.0);
    let mut reduced = packed.clone();
    part.interface.product(&packed, &mut reduced);
    let mut right = vec![Vec3::zeros(); moving];
    for dof in 0..size {
        let whole = dot(part.whole_interface(dof), &packed[..size]);
        right[from + dof / 3][dof % 3] = whole - reduced[dof];
    }
    let free = (0..moving).map(|i| {
        let used = model.whole.star_count[i] > 0;
        model.boundary.free[i].map(|f| f && used)
    });
    let numbering = Numbering::new(free);
    let (pattern, at_rest) = model.whole.tangent_at_rest(model);
    let stiffness = Stiffness {
        pattern: &pattern,
        ..model.stiffness(&at_rest)
    };
    let factor = Factor::new(stiffness.entries(), &numbering, None)?;
    let mut column = vec![0.0; numbering.unknowns()];
    numbering.gather(&right, &mut column);
    factor.solve(&mut column);
    let norm = u[..moving]
        .iter()
        .map(|u| u.norm_squared())
        .sum::<f64>()
        .sqrt();
    let off = dot(&column, &column).sqrt();
    Ok((norm > 0.0).then_some(off / norm))
}

/// All that is alive in one matrix, whoever computes it in real time.
fn assemble(model: &Model, live: &LiveMesh) -> (Pattern, Tensors) {
    let nodes = model.mesh.nodes.len();
    if model.element() != Element::ConstantStrain {
        return Tensors::assemble(nodes, &newton::tangent_at_rest(model, live));
    }
    let pattern = Pattern::new(nodes, &live.tetrahedra);
    let mut tensors = Tensors::zeros(&pattern);
    for (t, nodes) in live.tetrahedra.iter().enumerate() {
        if live.alive[t] {
            let law = &model.material(t).law;
            tensors.accumulate(&pattern, nodes, &model.shape[t], law);
        }
    }
    (pattern, tensors)
}

/// Gravity and loads at full value \[N\] a node.
fn external(model: &Model, live: &LiveMesh) -> Vec<Vec3> {
    let gravity = Vec3::from(model.scene.gravity);
    let mut external: Vec<Vec3> = live.weight.iter().map(|m| gravity * *m).collect();
    for load in &model.boundary.loads {
        if live.star_count[load.node as usize] > 0 {
            external[load.node as usize] += load.force;
        }
    }
    external
}
