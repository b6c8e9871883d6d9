//! What a substep computes, in floating-point operations: a count that no machine changes.
//!
//! Additions, multiplications, quotients and roots count one each, as the formulas of docs/model.md have them; kernels
//! that sum side by side do the same work. Contact that is sought and outputs that are read are not in it.

use tissue::model::Model;
use tissue::model::precomputed::Interface;
use tissue::scene::{Elasticity, Element, Form, ModelKind, Scheme};

/// A vertex: diagonal tensor times u (15), residual f - K u - c m v (9), v += h r/m (6), u += h v (6), energy sums
/// u . K u, v . M v and u . f (20).
const VERTEX: f64 = 56.0;
/// An edge of the tensors: K_ij u_j and K_ij^T u_i, nine products and nine sums each.
const EDGE: f64 = 36.0;
/// A spring: w (3), 2 r + w (3), (2 r + w) . w (5), length (2), extension (2), k over length (2), force (6), both ends
/// (6), energy (3).
const SPRING: f64 = 32.0;
/// A tetrahedron's gradient: three differences (9), three outer products summed (45).
const GRADIENT: f64 = 54.0;
/// P a_j of three vertices (45), the fourth (6), added to the vertices (12).
const SPREAD: f64 = 63.0;
/// F = I + G (3), F:F (17), det F (14): what bounds the substep.
const EXTENT: f64 = 34.0;
/// F^T F (30), E (12), trace and 2 mu E + lambda tr E I (12), P = F S (45), energy (17).
const ST_VENANT_KIRCHHOFF: f64 = 116.0;
/// cof F (27), factors (12), m F + l cof F (27), energy with its logarithm (12).
const STABLE_NEO_HOOKEAN: f64 = 78.0;
/// eps (9), trace (2), lambda tr eps I + 2 mu eps (12), energy (17).
const HOOKE: f64 = 40.0;
/// Averaged, a directed edge: difference (3), outer product on G_j (18), Q_j D_jk (18), c mu L (u_j - u_k) (6).
const NEIGHBOUR: f64 = 45.0;
/// Averaged, a vertex: P - c mu G (18), its energy (19).
const POINT: f64 = 37.0;
/// Of a blend on top of the law: the linear force (40 and the same gradient) and the weight (20).
const WEIGHT: f64 = 60.0;

/// Operations of one substep \[flop\]; none where they are not counted: a sparse solution, the polynomial form.
///
/// `nonlinear`: share of the tetrahedra beyond an adaptive threshold; `held`: nodes in the grip.
pub fn substep(model: &Model, nonlinear: f64, held: usize) -> Option<f64> {
    let settings = &model.scene.model;
    if settings.form == Form::Polynomial || model.scheme() == Scheme::ImplicitEuler {
        return None;
    }
    let tetrahedra = model.parts.dynamic.iter().filter(|d| **d).count() as f64;
    let vertices = model.parts.moving as f64;
    let edges = model.pattern.edges() as f64;
    let law = match settings.elasticity {
        Elasticity::Linear => HOOKE,
        Elasticity::StVenantKirchhoff => ST_VENANT_KIRCHHOFF + EXTENT,
        Elasticity::StableNeoHookean => STABLE_NEO_HOOKEAN + EXTENT,
    };
    let tensors = edges * EDGE;
    let force = match (settings.kind, model.law()) {
        (ModelKind::SpringMass, _) => edges * SPRING,
        (_, None) => tensors,
        (_, Some(_)) if model.is_adaptive() => {
            tensors + nonlinear * tetrahedra * (GRADIENT + law + WEIGHT + SPREAD)
        }
        (_, Some(_)) => match model.element() {
            Element::ConstantStrain => tetrahedra * (GRADIENT + law + SPREAD),
            Element::NodalAveraged => vertices * (law + POINT) + 2.0 * edges * NEIGHBOUR,
            // Gradient and theta, shared among four vertices; gradient and law again with the mean pressure.
            Element::NodalPressure => {
                tetrahedra * ((GRADIENT + EXTENT + 8.0) + (GRADIENT + law + 35.0 + SPREAD))
                    + 2.0 * vertices
            }
        },
    };
    let stages = match model.scheme() {
        // Slopes are added up besides.
        Scheme::RungeKutta4 => 4.0,
        _ => 1.0,
    };
    Some(stages * (force + vertices * VERTEX + precomputed(model, held)))
}

/// S u_c of the interface, and what is held inside: u_t - Phi_t u_c, the factor of G_tt forward and back, Phi_t^T lambda.
fn precomputed(model: &Model, held: usize) -> f64 {
    let Some(part) = &model.precomputed else {
        return 0.0;
    };
    let connection = 3.0 * model.parts.connection as f64;
    let interface = match &part.interface {
        Interface::Full(_) => 2.0 * connection * connection,
        Interface::Modes { values, .. } => connection * (1.0 + 4.0 * values.len() as f64),
    };
    // The patch is either in the dynamic part or in this one, but for what both share.
    let inside = 3.0 * held.min(model.parts.touchable) as f64;
    interface + inside * (4.0 * connection + 2.0 * inside)
}
