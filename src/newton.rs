//! Equilibrium of tissue with a non-linear law: Newton's method on the whole of it, with the exact tangent.
//!
//! Supports and loads grow together; a share of them that Newton's method does not reach is halved. Each correction
//! is followed as far as it lowers the energy and turns nothing inside out.

use nalgebra::Matrix3;

use crate::element::{Elements, blend, tetrahedra};
use crate::law::response::Law;
use crate::live::LiveMesh;
use crate::mesh::Vec3;
use crate::model::Model;
use crate::model::tensor_mass::Lane;
use crate::scene::Adaptive;
use crate::statics::{Factor, Numbering, StaticsError};

/// Largest force out of balance, relative to the largest force.
const TOLERANCE: f64 = 1e-10;
/// Corrections at one share of the load.
const MOST_CORRECTIONS: usize = 40;
/// Smallest growth of the share that is tried.
const SMALLEST_STEP: f64 = 1.0 / 512.0;
/// Parts of a correction that are tried.
const HALVINGS: u32 = 12;
/// Parts of the largest vertex stiffness that are added where the tangent is not positive definite.
const SHIFTS: [f64; 6] = [0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1];

/// Displacement \[m\] a node, relative residual, corrections.
pub struct Solution {
    pub displacement: Vec<Vec3>,
    pub residual: f64,
    pub corrections: usize,
}

/// Tissue at displacements u.
struct At {
    /// dW/du \[N\]
    internal: Vec<Vec3>,
    /// W \[J\]
    energy: f64,
    /// Smallest det F.
    least: f64,
}

/// All that is alive, what is pre-computed by the linear law.
struct Tissue<'a> {
    model: &'a Model,
    live: &'a LiveMesh,
    /// The pre-computed part, where vertices have points.
    inside: Option<Elements>,
}

/// dW/du \[N\].
pub fn internal_forces(model: &Model, live: &LiveMesh, u: &[Vec3]) -> Vec<Vec3> {
    Tissue::new(model, live).evaluate(u).internal
}

/// d²W/du² \[N/m\] at rest in parts, each pair once.
pub fn tangent_at_rest(model: &Model, live: &LiveMesh) -> Vec<(usize, usize, Matrix3<f64>)> {
    Tissue::new(model, live).tangent(&vec![Vec3::zeros(); model.mesh.nodes.len()])
}

/// d²W/du² \[N/m\] at displacements u \[m\], a node of the mesh each; what is pre-computed is linear.
pub fn tangent(model: &Model, live: &LiveMesh, u: &[Vec3]) -> Vec<(usize, usize, Matrix3<f64>)> {
    if let Some(springs) = &live.springs {
        return springs.tangent(live.pattern(model), &lanes(u));
    }
    Tissue::new(model, live).tangent(u)
}

fn law_of(model: &Model, t: usize) -> Option<Law> {
    let uniform = model.law().filter(|_| !model.is_adaptive());
    uniform.filter(|_| model.parts.dynamic[t])
}

impl<'a> Tissue<'a> {
    fn new(model: &'a Model, live: &'a LiveMesh) -> Tissue<'a> {
        Tissue {
            model,
            live,
            inside: model.elements_inside(),
        }
    }

    /// Elements of which no tetrahedron stands alone: the dynamic ones, and the others.
    fn with_points(&self) -> [Option<&Elements>; 2] {
        let alone = |e: &&Elements| matches!(e, Elements::ConstantStrain(_));
        [
            self.live.elements.as_ref().filter(|e| !alone(e)),
            self.inside.as_ref(),
        ]
    }
    fn evaluate(&self, u: &[Vec3]) -> At {
        let Tissue { model, live, .. } = *self;
        let mut at = At {
            internal: vec![Vec3::zeros(); u.len()],
            energy: 0.0,
            least: f64::INFINITY,
        };
        let with_points = self.with_points();
        for elements in with_points.into_iter().flatten() {
            let mut forces = vec![Lane::default(); u.len()];
            let mut points = vec![0.0; elements.points()];
            let u = lanes(u);
            let (energy, _) = elements.add_forces(None, &u, &mut forces, &mut points, &live.mass);
            at.energy += energy;
            for (to, force) in at.internal.iter_mut().zip(&forces) {
                *to += force.xyz();
            }
        }
        for (t, nodes) in live.tetrahedra.iter().enumerate() {
            if !live.alive[t] {
                continue;
            }
            let (shape, material) = (&model.shape[t], &live.material(model, t));
            let own = nodes.map(|v| u[v as usize]);
            at.least = at.least.min(shape.deformation_gradient(&own).determinant());
            if with_points[usize::from(!model.parts.dynamic[t])].is_some() {
                continue;
            }
            let (force, energy) = match law_of(model, t) {
                Some(law) => tetrahedra::force(law, material, shape, &own),
                None => {
                    let force = shape.linear_force(material, &own);
                    let twice: f64 = own.iter().zip(&force).map(|(u, f)| u.dot(f)).sum();
                    (force, 0.5 * twice)
                }
            };
            for (v, f) in nodes.iter().zip(force) {
                at.internal[*v as usize] += f;
            }
            at.energy += energy;
            if let Some(blend) = live.blend.as_ref().filter(|_| model.parts.dynamic[t]) {
                let (force, energy, _) = blend.force(material, shape, &own);
                for (v, f) in nodes.iter().zip(force) {
                    at.internal[*v as usize] += f;
                }
                at.energy += energy;
            }
        }
        at
    }

    /// K_jk in parts, each pair once.
    fn tangent(&self, u: &[Vec3]) -> Vec<(usize, usize, Matrix3<f64>)> {
        let Tissue { model, live, .. } = *self;
        let with_points = self.with_points().map(|e| e?.tangent(&lanes(u)));
        let has_points = with_points.each_ref().map(Option::is_some);
        let mut entries: Vec<_> = with_points.into_iter().flatten().flatten().collect();
        for (t, nodes) in live.tetrahedra.iter().enumerate() {
            if !live.alive[t] || has_points[usize::from(!model.parts.dynamic[t])] {
                continue;
            }
            let (shape, material) = (&model.shape[t], &live.material(model, t));
            let f = shape.deformation_gradient(&nodes.map(|v| u[v as usize]));
            for k in 0..4 {
                let change = |axis: usize| {
                    let df = Vec3::ith(axis, 1.0) * shape.gradient[k].transpose();
                    match law_of(model, t) {
                        Some(law) => law.tangent(material, &f, &df),
                        None => {
                            let linear = material.stress(&((df + df.transpose()) * 0.5));
                            linear + beyond(model, live, t, &f, &df)
                        }
                    }
                };
                let stress = [0, 1, 2].map(change);
                for j in 0..=k {
                    let a = shape.gradient[j] * shape.volume;
                    let block = Matrix3::from_columns(&stress.map(|s| s * a));
                    entries.push((nodes[j] as usize, nodes[k] as usize, block));
                }
            }
        }
        entries
    }
}

fn lanes(u: &[Vec3]) -> Vec<Lane> {
    u.iter().map(|u| Lane::from(*u)).collect()
}

/// Of adaptive tissue on top of Hooke's law: change of stress \[Pa\] with F.
fn beyond(
    model: &Model,
    live: &LiveMesh,
    t: usize,
    f: &Matrix3<f64>,
    df: &Matrix3<f64>,
) -> Matrix3<f64> {
    let Some(blend) = live.blend.as_ref().filter(|_| model.parts.dynamic[t]) else {
        return Matrix3::zeros();
    };
    let size = blend::size(&model.shape[t]);
    let (law, material) = (blend.law, &model.material(t).law);
    let g = f - Matrix3::identity();
    blend::excess_tangent(law, material, blend.threshold, size, &g, df)
}

/// `free` an axis of each node, `held` \[m\] where it is not, `external` \[N\] at full value.
pub fn solve(
    model: &Model,
    live: &LiveMesh,
    free: &[[bool; 3]],
    held: &[Vec3],
    external: &[Vec3],
) -> Result<Solution, StaticsError> {
    if (live.blend.as_ref()).is_some_and(|blend| blend.rule == Adaptive::PerVertex) {
        return Err(StaticsError::NoEnergy);
    }
    let problem = Problem {
        tissue: Tissue::new(model, live),
        free,
        held,
        external,
        numbering: Numbering::new(free.iter().copied()),
    };
    let mut u = vec![Vec3::zeros(); held.len()];
    let (mut share, mut step, mut corrections) = (0.0, 1.0f64, 0);
    let mut residual = 0.0;
    while share < 1.0 {
        let next = (share + step).min(1.0);
        match problem.reach(&u, next, &mut corrections) {
            Ok((found, left)) => {
                (u, residual, share) = (found, left, next);
                step *= 2.0;
            }
            Err(_) if step > SMALLEST_STEP => step *= 0.5,
            Err(StaticsError::NotHeld) if share == 0.0 => return Err(StaticsError::NotHeld),
            Err(_) => return Err(StaticsError::Lost(share)),
        }
    }
    Ok(Solution {
        displacement: u,
        residual,
        corrections,
    })
}

struct Problem<'a> {
    tissue: Tissue<'a>,
    free: &'a [[bool; 3]],
    held: &'a [Vec3],
    external: &'a [Vec3],
    numbering: Numbering,
}

impl Problem<'_> {
    /// From an equilibrium to that at another share of the load.
    fn reach(
        &self,
        from: &[Vec3],
        share: f64,
        corrections: &mut usize,
    ) -> Result<(Vec<Vec3>, f64), StaticsError> {
        let mut u = from.to_vec();
        let mut at = self.tissue.evaluate(&u);
        for k in 0..MOST_CORRECTIONS {
            let residual = self.residual(&at, share);
            if k > 0 && residual < TOLERANCE {
                return Ok((u, residual));
            }
            *corrections += 1;
            let way = self.correction(&u, &at, share)?;
            // Supports go all the way at first, or the share is too large.
            let (moved, found) = match k {
                0 => self.moved(&u, &way, 1.0).filter(|(_, at)| at.least > 0.0),
                _ => self.descend(&u, &at, &way, share),
            }
            .ok_or(StaticsError::Lost(share))?;
            (u, at) = (moved, found);
        }
        Err(StaticsError::Lost(share))
    }

    fn out_of_balance(&self, at: &At, share: f64) -> Vec<Vec3> {
        (self.external.iter().zip(&at.internal))
            .map(|(f, k)| f * share - k)
            .collect()
    }

    fn residual(&self, at: &At, share: f64) -> f64 {
        let scale = (self.external.iter().map(|f| f * share))
            .chain(at.internal.iter().copied())
            .map(|f| f.amax())
            .fold(0.0, f64::max);
        let left = (self.out_of_balance(at, share).iter().zip(self.free))
            .flat_map(|(r, free)| (0..3).filter(|a| free[*a]).map(|a| r[a].abs()))
            .fold(0.0, f64::max);
        if scale > 0.0 { left / scale } else { 0.0 }
    }

    /// K du = r on what is free, du what supports lack where it is not.
    fn correction(&self, u: &[Vec3], at: &At, share: f64) -> Result<Vec<Vec3>, StaticsError> {
        let entries = self.tissue.tangent(u);
        let mut way: Vec<Vec3> = (0..u.len())
            .map(|i| {
                Vec3::from_fn(|a, _| match self.free[i][a] {
                    true => 0.0,
                    false => self.held[i][a] * share - u[i][a],
                })
            })
            .collect();
        let mut right = self.out_of_balance(at, share);
        let mut largest = 0.0f64;
        for (i, j, block) in &entries {
            right[*i] -= block * way[*j];
            if i != j {
                right[*j] -= block.tr_mul(&way[*i]);
            } else {
                largest = largest.max(block.amax());
            }
        }
        let mut columns = vec![0.0; self.numbering.unknowns()];
        self.numbering.gather(&right, &mut columns);
        let ones = vec![1.0; u.len()];
        let factor = SHIFTS.into_iter().find_map(|shift| {
            let shifted = (shift > 0.0).then_some((shift * largest, &ones[..]));
            match Factor::new(entries.iter().copied(), &self.numbering, shifted) {
                Err(StaticsError::NotHeld) => None,
                found => Some(found),
            }
        });
        factor.ok_or(StaticsError::NotHeld)??.solve(&mut columns);
        if !columns.iter().all(|x| x.is_finite()) {
            return Err(StaticsError::NotHeld);
        }
        self.numbering.scatter(&columns, &mut way);
        Ok(way)
    }

    fn moved(&self, u: &[Vec3], way: &[Vec3], part: f64) -> Option<(Vec<Vec3>, At)> {
        let moved: Vec<Vec3> = u.iter().zip(way).map(|(u, d)| u + d * part).collect();
        let at = self.tissue.evaluate(&moved);
        at.energy.is_finite().then_some((moved, at))
    }

    /// The longest part of the way, by halves, along which the potential falls or the residual does.
    fn descend(&self, u: &[Vec3], at: &At, way: &[Vec3], share: f64) -> Option<(Vec<Vec3>, At)> {
        let slope: f64 = -(self.out_of_balance(at, share).iter().zip(way))
            .map(|(r, d)| r.dot(d))
            .sum::<f64>();
        let before = self.residual(at, share);
        (0..HALVINGS).find_map(|k| {
            let part = 0.5f64.powi(k as i32);
            let (moved, found) = self.moved(u, way, part).filter(|(_, at)| at.least > 0.0)?;
            let work: f64 = (self.external.iter().zip(way))
                .map(|(f, d)| f.dot(d) * share * part)
                .sum();
            let falls = found.energy - at.energy - work <= 1e-4 * part * slope;
            (falls || self.residual(&found, share) < 0.5 * before).then_some((moved, found))
        })
    }
}
