//! Adaptive non-linearity: the smooth blend against its energy, the laws at either end and time; the papers' rule beside it.

mod common;

use nalgebra::{DMatrix, DVector, Matrix3};
use tissue::element::blend::{self, Blend, Listed};
use tissue::element::kernel::Kernel;
use tissue::element::tetrahedra::Tetrahedra;
use tissue::law::linear::Hooke;
use tissue::law::response::Law;
use tissue::mesh::Vec3;
use tissue::model::Model;
use tissue::model::tensor_mass::Lane;
use tissue::scene::Adaptive;
use tissue::simulation::Simulation;

const LAWS: [Law; 2] = [Law::StVenantKirchhoff, Law::StableNeoHookean];

/// Of two materials, one with fibres.
struct Tissue {
    model: std::sync::Arc<Model>,
    material: Vec<Hooke>,
}

impl Tissue {
    fn new() -> Tissue {
        let model = common::model(common::BAR);
        let soft = Hooke::new(6000.0, 0.45).with_fibre(Vec3::new(1.0, 0.3, -0.2), 8e4, 2e4);
        let hard = Hooke::new(20_000.0, 0.3);
        let material = (0..model.shape.len())
            .map(|t| if t % 3 == 0 { hard } else { soft })
            .collect();
        Tissue { model, material }
    }

    fn blend(&self, law: Law, rule: Adaptive, threshold: f64) -> Blend {
        Blend::new(law, rule, threshold, &self.model.mesh.tetrahedra, |t| {
            Some((&self.model.shape[t], &self.material[t]))
        })
    }

    /// Bent, the more the farther out, with noise.
    fn displaced(&self, size: f64) -> Vec<Lane> {
        let mut seed = 1u64;
        let mut random = move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 33) as f64 / f64::from(1u32 << 30) - 1.0
        };
        (self.model.mesh.nodes.iter())
            .map(|x| {
                let bend = Vec3::new(3.0 * x.x * x.z, 20.0 * x.x * x.x, -10.0 * x.x * x.y);
                let noise = Vec3::new(random(), random(), random()) * 4e-4;
                Lane::from((bend + noise) * size * (10.0 * x.x).powi(2))
            })
            .collect()
    }

    /// By tetrahedra: force, energy, u . force.
    fn plainly(&self, blend: &Blend, u: &[Lane]) -> (Vec<Vec3>, f64, f64) {
        let (mut forces, mut energy, mut virial) = (vec![Vec3::zeros(); u.len()], 0.0, 0.0);
        for (t, nodes) in self.model.mesh.tetrahedra.iter().enumerate() {
            let own = nodes.map(|v| u[v as usize].xyz());
            let (f, w, v) = blend.force(&self.material[t], &self.model.shape[t], &own);
            (0..4).for_each(|k| forces[nodes[k] as usize] += f[k]);
            energy += w;
            virial += v;
        }
        (forces, energy, virial)
    }
}

fn zeros(n: usize) -> Vec<Lane> {
    vec![Lane::default(); n]
}

fn largest(forces: &[Lane]) -> f64 {
    forces.iter().map(|f| f.xyz().norm()).fold(0.0, f64::max)
}

#[test]
fn fast_plain_listed_and_single_tetrahedra_agree() {
    let tissue = Tissue::new();
    for law in LAWS {
        for rule in [Adaptive::Blend, Adaptive::PerVertex] {
            let threshold = if rule == Adaptive::Blend { 1e-3 } else { 8e-3 };
            let blend = tissue.blend(law, rule, threshold);
            let u = tissue.displaced(1.0);
            let count = tissue.model.shape.len();
            let share = blend.share(&u, count);
            assert!((0.2..0.8).contains(&share), "{share}");
            let mut fast = zeros(u.len());
            let all = blend.add_forces(None, &u, &mut fast);
            let mut plain = zeros(u.len());
            let other = blend.add_forces_plain(&u, &mut plain);
            let (single, energy, virial) = tissue.plainly(&blend, &u);
            let mut listed = Listed::new(&blend, u.len());
            listed.refresh(&blend, 0, &u);
            let mut short = zeros(u.len());
            let some = blend.add_forces(Some(&listed), &u, &mut short);
            let scale = largest(&fast);
            for i in 0..u.len() {
                assert!((fast[i].xyz() - plain[i].xyz()).norm() < 1e-12 * scale);
                assert!((fast[i].xyz() - single[i]).norm() < 1e-12 * scale);
                assert!((fast[i].xyz() - short[i].xyz()).norm() < 1e-13 * scale);
            }
            for (a, b) in [
                (all.energy, other.energy),
                (all.energy, energy),
                (all.energy, some.energy),
                (all.virial, other.virial),
                (all.virial, virial),
                (all.virial, some.virial),
            ] {
                assert!((a - b).abs() < 1e-12 * a.abs(), "{law:?} {rule:?} {a} {b}");
            }
            assert!((all.extent.least - other.extent.least).abs() < 1e-13);
            assert_eq!(all.extent, some.extent);
            let extent = blend.extent(&u);
            assert!((all.extent.least - extent.least).abs() < 1e-13);
            assert!((all.extent.trace - extent.trace).abs() < 1e-12);
        }
    }
}

/// Nothing that is not listed has anything to add, however tissue moves between two looks at it.
#[test]
fn what_is_listed_is_all_that_counts() {
    let tissue = Tissue::new();
    for rule in [Adaptive::Blend, Adaptive::PerVertex] {
        let blend = tissue.blend(LAWS[0], rule, 2e-3);
        let still = tissue.displaced(1.0);
        let mut listed = Listed::new(&blend, still.len());
        for k in 0..400 {
            // To and fro, with steps of a fiftieth of the threshold and of ten times as much.
            let step = if k % 40 == 0 { 0.3 } else { 0.03 };
            let size = (f64::from(k) * step).sin();
            let u: Vec<Lane> = (still.iter()).map(|u| Lane::from(u.xyz() * size)).collect();
            listed.refresh(&blend, 0, &u);
            let (mut all, mut some) = (zeros(u.len()), zeros(u.len()));
            let a = blend.add_forces(None, &u, &mut all);
            let b = blend.add_forces(Some(&listed), &u, &mut some);
            let scale = largest(&all);
            assert!((a.energy - b.energy).abs() <= 1e-13 * a.energy.abs());
            assert_eq!(a.extent, b.extent);
            for (a, b) in all.iter().zip(&some) {
                assert!((a.xyz() - b.xyz()).norm() <= 1e-13 * scale);
            }
        }
    }
}

#[test]
fn forces_are_the_derivatives_of_the_energy_and_balance() {
    let tissue = Tissue::new();
    for law in LAWS {
        let blend = tissue.blend(law, Adaptive::Blend, 1e-3);
        let u = tissue.displaced(1.0);
        let mut f = zeros(u.len());
        let excess = blend.add_forces(None, &u, &mut f);
        let scale = largest(&f);
        let sum: Vec3 = f.iter().map(|f| f.xyz()).sum();
        assert!(sum.norm() < 1e-12 * scale, "{}", sum.norm() / scale);
        let virial: f64 = f.iter().zip(&u).map(|(f, u)| f.xyz().dot(&u.xyz())).sum();
        assert!((virial - excess.virial).abs() < 1e-12 * virial.abs());
        for k in (0..u.len()).step_by(7) {
            for axis in 0..3 {
                let at = |h: f64| {
                    let mut moved = u.clone();
                    moved[k].0[axis] += h;
                    tissue.plainly(&blend, &moved).1
                };
                let h = 2e-6;
                let slope = (8.0 * (at(h) - at(-h)) - at(2.0 * h) + at(-2.0 * h)) / (12.0 * h);
                let off = (slope - f[k].0[axis]).abs();
                assert!(
                    off < 1e-9 * scale,
                    "{law:?} {k} {axis}: {off:e} of {scale:e}"
                );
            }
        }
        // The papers' rule does not balance.
        let rule = tissue.blend(law, Adaptive::PerVertex, 8e-3);
        let mut f = zeros(u.len());
        rule.add_forces(None, &u, &mut f);
        let sum: Vec3 = f.iter().map(|f| f.xyz()).sum();
        println!(
            "{law:?}, per vertex: net force {:.2} of the largest",
            sum.norm() / largest(&f)
        );
        assert!(sum.norm() > 1e-3 * largest(&f));
    }
}

#[test]
fn tangents_are_derivatives() {
    let g = Matrix3::new(0.2, -0.1, 0.3, 0.4, -0.3, 0.1, -0.2, 0.25, 0.15);
    let d = Matrix3::new(0.3, -0.5, 0.2, 0.7, 0.1, -0.4, 0.6, -0.2, 0.8);
    let material = Hooke::new(6000.0, 0.45).with_fibre(Vec3::new(1.0, 2.0, -1.0), 8e4, 2e4);
    for law in LAWS {
        // Below, between and beyond: |G| = .72.
        for threshold in [0.8, 0.5, 0.3] {
            let stress = |h: f64| blend::excess(law, &material, threshold, 1.0, &(g + d * h));
            let h = 1e-4;
            let [a, b, c, e] = [h, -h, 2.0 * h, -2.0 * h].map(stress);
            let change = blend::excess_tangent(law, &material, threshold, 1.0, &g, &d);
            let slope = ((a.1 - b.1) * 8.0 - c.1 + e.1) / (12.0 * h);
            let scale = material.lambda;
            assert!(
                (slope - change).norm() < 1e-9 * scale,
                "{law:?} {threshold}"
            );
            let work = ((a.0 - b.0) * 8.0 - c.0 + e.0) / (12.0 * h);
            let along = stress(0.0).1.component_mul(&d).sum();
            assert!((work - along).abs() < 1e-9 * scale);
            assert_eq!(change == Matrix3::zeros(), threshold == 0.8);
        }
    }
}

/// The critical substep follows what is beyond the threshold: bound and truth of the highest frequency.
#[test]
fn stiffening_is_foreseen() {
    let tissue = Tissue::new();
    let n = tissue.model.mesh.nodes.len();
    let mut mass = DVector::<f64>::zeros(3 * n);
    for (nodes, shape) in tissue.model.mesh.tetrahedra.iter().zip(&tissue.model.shape) {
        for v in nodes {
            (0..3).for_each(|axis| mass[3 * *v as usize + axis] += 250.0 * shape.volume);
        }
    }
    for law in LAWS {
        let highest = |threshold: f64, u: &[Lane]| {
            let mut k = DMatrix::<f64>::zeros(3 * n, 3 * n);
            for (t, nodes) in tissue.model.mesh.tetrahedra.iter().enumerate() {
                let (shape, material) = (&tissue.model.shape[t], &tissue.material[t]);
                let own = nodes.map(|v| u[v as usize].xyz());
                let g = shape.deformation_gradient(&own) - Matrix3::identity();
                for (j, node) in nodes.iter().enumerate() {
                    for axis in 0..3 {
                        let dg = Vec3::ith(axis, 1.0) * shape.gradient[j].transpose();
                        let linear = material.stress(&((dg + dg.transpose()) * 0.5));
                        let size = blend::size(shape);
                        let more = blend::excess_tangent(law, material, threshold, size, &g, &dg);
                        let stress = (linear + more) * shape.volume;
                        for (other, a) in nodes.iter().zip(&shape.gradient) {
                            let force = stress * a;
                            for row in 0..3 {
                                let at = (3 * *other as usize + row, 3 * *node as usize + axis);
                                k[at] += force[row];
                            }
                        }
                    }
                }
            }
            for row in 0..3 * n {
                for column in 0..3 * n {
                    k[(row, column)] /= (mass[row] * mass[column]).sqrt();
                }
            }
            k.symmetric_eigenvalues().max().sqrt()
        };
        let rest = highest(1.0, &zeros(n));
        for threshold in [3e-4, 1e-3, 3e-3] {
            for size in [0.03, 0.1, 0.3, 1.0] {
                let u = tissue.displaced(size);
                let blend = tissue.blend(law, Adaptive::Blend, threshold);
                let extent = blend.extent(&u);
                let bound = (tissue.material.iter())
                    .map(|m| law.stiffening(m, m, &extent))
                    .fold(1.0, f64::max)
                    .sqrt();
                let truth = highest(threshold, &u) / rest;
                let share = blend.share(&u, tissue.model.shape.len());
                println!(
                    "{law:?} {threshold} {size}: {truth:.3} bound {bound:.3} share {share:.2}"
                );
                assert!(truth < bound * 1.001);
            }
        }
    }
}

/// A tiny threshold gives the other law, a huge one the linear.
#[test]
fn either_end_is_a_law() {
    let tissue = Tissue::new();
    let u = tissue.displaced(1.0);
    for law in LAWS {
        let full = Tetrahedra::new(law, &tissue.model.mesh.tetrahedra, |t| {
            Some((&tissue.model.shape[t], &tissue.material[t]))
        });
        let mut truth = zeros(u.len());
        let (energy, _) = full.add_forces(&u, &mut truth);
        for (rule, threshold) in [(Adaptive::Blend, 1e-9), (Adaptive::PerVertex, 1e-9)] {
            let mut own = zeros(u.len());
            let blend = tissue.blend(law, rule, threshold);
            let mut sum = blend.add_forces(None, &u, &mut own).energy;
            for (t, nodes) in tissue.model.mesh.tetrahedra.iter().enumerate() {
                let moved = nodes.map(|v| u[v as usize].xyz());
                let shape = &tissue.model.shape[t];
                let linear = shape.linear_force(&tissue.material[t], &moved);
                for k in 0..4 {
                    let at = nodes[k] as usize;
                    own[at] = Lane::from(own[at].xyz() + linear[k]);
                    sum += 0.5 * linear[k].dot(&moved[k]);
                }
            }
            for (i, (a, b)) in own.iter().zip(&truth).enumerate() {
                // Nodes that are held have not moved, and keep the linear force by the papers' rule.
                if rule == Adaptive::Blend || u[i].xyz().norm() > threshold {
                    let off = (a.xyz() - b.xyz()).norm();
                    assert!(off < 1e-11 * largest(&truth), "{law:?} {rule:?} {off:e}");
                }
            }
            assert!(rule == Adaptive::PerVertex || (sum / energy - 1.0).abs() < 1e-11);
        }
        let mut own = zeros(u.len());
        let excess = tissue
            .blend(law, Adaptive::Blend, 1e3)
            .add_forces(None, &u, &mut own);
        assert!(largest(&own) == 0.0 && excess == blend::Excess::default());
    }
}

fn scene(rule: &str, threshold: f64, more: &str) -> String {
    common::BAR.replace("500000", "20000").replacen(
        '{',
        &format!(
            r#"{{"model": {{"elasticity": "stVenantKirchhoff", "adaptive": "{rule}", "nonlinearThreshold": {threshold}}}, {more}"#
        ),
        1,
    )
}

/// Ten seconds of undamped swinging under weight at half the critical substep: the blend keeps its energy to 1 %, the
/// papers' rule does not, and is stopped by the watchdog or has doubled it.
#[test]
fn swinging_tissue_keeps_its_energy() {
    let weight = r#""gravity": [0, 0, -4], "integration": {"damping": 0}, "#;
    let run = |rule: &str, threshold: f64| {
        let critical = common::simulation(&scene(rule, threshold, weight)).critical_substep();
        let parts = (1e-3 / (0.5 * critical)).ceil();
        let text = scene(rule, threshold, weight).replace(
            r#""damping": 0"#,
            &format!(r#""damping": 0, "substep": {}"#, 1e-3 / parts),
        );
        let mut s = common::simulation(&text);
        let (mut scale, mut drift, mut least, mut most) = (0.0f64, 0.0f64, 1.0f64, 0.0f64);
        for k in 0..2000 {
            if let Err(e) = s.step(5e-3) {
                return Err(format!("after {:.3} s: {e}", 5e-3 * f64::from(k)));
            }
            let e = s.energy();
            scale = scale.max(e.elastic + e.kinetic);
            drift = drift.max((e.balance() - s.state().account.start).abs() / scale);
            let share = s.nonlinear_fraction();
            (least, most) = (least.min(share), most.max(share));
        }
        Ok((drift, least, most))
    };
    let (drift, least, most) = run("blend", 1.5e-3).unwrap();
    println!("blend: drift {drift:.1e}, share from {least:.2} to {most:.2}");
    assert!(drift < 0.01 && least < 0.1 && most > 0.2);
    match run("perVertex", 8e-3) {
        Ok((drift, ..)) => {
            println!("perVertex: drift {drift:.1e}");
            assert!(drift > 0.05);
        }
        Err(e) => println!("perVertex: {e}"),
    }
}

const HYBRID: &str =
    r#""kind": "hybrid", "dynamic": {"halfSpace": {"point": [0.03, 0, 0], "normal": [1, 0, 0]}}, "#;

fn settled(text: &str) -> Simulation {
    let mut s = common::simulation(text);
    for k in 0..12 {
        s.set_pose_input(k % 3, 2, 1.0);
    }
    for _ in 0..3000 {
        s.step(1e-3).unwrap();
    }
    s
}

/// Settled tissue is where Newton's method says: whole, hybrid, after cuts.
#[test]
fn tissue_settles_where_newtons_method_says() {
    for kind in ["", HYBRID] {
        let text = scene(
            "blend",
            1e-3,
            r#""gravity": [0, 0, -2], "integration": {"damping": 16},
               "cuts": [{"time": 0.1, "where": {"box": {"min": [0.05, 0, 0.013], "max": [0.06, 1, 1]}}}],"#,
        )
        .replacen(r#"{"elasticity""#, &format!(r#"{{{kind}"elasticity""#), 1);
        let mut s = settled(&text);
        let share = s.nonlinear_fraction();
        assert!(share > 0.05, "{share}");
        let model = s.model().clone();
        let reference = tissue::reference::solve(&model, true).unwrap();
        assert!(reference.residual < 1e-10);
        let (mut off, mut most) = (0.0f64, 0.0f64);
        for (scene_node, node) in model.node.iter().enumerate() {
            let i = *node as usize;
            if i < model.parts.moving && s.state().live.star_count[i] > 0 {
                let u = Vec3::from(reference.displacement[scene_node]);
                off = off.max((s.state().displacement[i].xyz() - u).norm());
                most = most.max(u.norm());
            }
        }
        println!("{kind}: {:.1e}, share {share:.2}", off / most);
        assert!(off < 1e-6 * most);
        let e = s.energy();
        let start = s.state().account.start;
        assert!((e.balance() - start).abs() < 1e-3 * e.elastic);
    }
}

/// A host may change the threshold at any time: the account stays, and the share follows.
#[test]
fn thresholds_are_tunable() {
    let weight = r#""gravity": [0, 0, -2], "integration": {"damping": 16}, "#;
    let mut s = common::simulation(&scene("blend", 1e-3, weight));
    let start = s.state().account.start;
    let mut shares = Vec::new();
    for threshold in [1e-3, 1e-1, 1e-5] {
        s.set_nonlinear_threshold(threshold);
        for _ in 0..300 {
            s.step(1e-3).unwrap();
        }
        let bytes = s.serialise(s.state());
        assert_eq!(s.deserialise(&bytes).unwrap().live, s.state().live);
        let e = s.energy();
        let off = (e.balance() - start).abs() / (e.elastic + e.kinetic);
        println!("{threshold} m: account off by {off:.1e}");
        // From linear to St Venant and Kirchhoff's at once shakes it.
        assert!(off < 0.02);
        shares.push(s.nonlinear_fraction());
    }
    println!("shares {shares:?}");
    assert!(shares[0] > 0.1 && shares[1] == 0.0 && shares[2] > 0.99);
}

/// Press, grasp, pull, cut off, drop: with the account open, and the same to the bit from saved bytes.
#[test]
fn all_that_is_done_to_tissue() {
    for (scheme, rule, bound) in [
        ("symplecticEuler", "remove", 5e-3),
        ("centralDifference", "duplicate", 5e-3),
        ("rungeKutta4", "remove", 0.05),
    ] {
        let text = scene(
            "blend",
            1e-3,
            &format!(
                r#""integration": {{"scheme": "{scheme}", "damping": 30}}, "cutting": {{"rule": "{rule}"}},
                   "cuts": [{{"time": 0.1, "where": {{"box": {{"min": [0.05, 0, 0.013], "max": [0.06, 1, 1]}}}}}},
                            {{"time": 0.95, "where": {{"box": {{"min": [0.069, 0, 0], "max": [0.078, 1, 1]}}}}}}],"#
            ),
        );
        let mut s = common::simulation(&text);
        let mut other = common::simulation(&text);
        let (mut scale, mut worst) = (0.0f64, 0.0f64);
        for k in 0..1200 {
            let time = f64::from(k) * 1e-3;
            if k == 700 {
                let bytes = s.serialise(s.state());
                let state = other.deserialise(&bytes).unwrap();
                other.restore(&state);
            }
            common::script(&mut s, time);
            s.step(1e-3).unwrap();
            if k >= 700 {
                common::script(&mut other, time);
                other.step(1e-3).unwrap();
                assert!(other.state().displacement == s.state().displacement, "{k}");
            }
            let e = s.energy();
            scale = scale.max(e.elastic + e.kinetic);
            worst = worst.max((e.balance() - s.state().account.start).abs());
        }
        println!(
            "{scheme} {rule}: {:.1e}, {} removed, {} pieces",
            worst / scale,
            s.state().live.removed.len(),
            s.pieces()
        );
        assert!(worst < bound * scale);
        assert!(s.pieces() > 1);
    }
}
