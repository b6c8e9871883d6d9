//! Mass points and springs: closed forms, invariances, cuts, energy, stability.

mod common;

use std::path::Path;

use nalgebra::{Matrix3, Rotation3};
use tissue::live::LiveMesh;
use tissue::mesh::Vec3;
use tissue::model::critical_step::{central_difference, symplectic_euler};
use tissue::model::spring_mass::{Springs, tetrahedron_force};
use tissue::model::sweep::{Advance, Motion, Sums};
use tissue::model::tensor_mass::Lane;
use tissue::model::{Model, spring_sweep};
use tissue::simulation::Simulation;
use tissue::state::State;

/// [`common::BAR`] of springs, with more keys before its tools.
fn bar(keys: &str) -> String {
    let keys = format!(r#""model": {{"kind": "springMass"}}, {keys} "tools""#);
    common::BAR.replace("\"tools\"", &keys)
}

fn springs(live: &LiveMesh) -> &Springs {
    live.springs.as_ref().unwrap()
}

/// A deformation of some tens of per cent, different at each node.
fn wild(model: &Model, size: f64) -> Vec<Lane> {
    (0..model.mesh.nodes.len())
        .map(|k| {
            let k = k as f64;
            Vec3::new((1.7 * k).sin(), (2.3 * k).cos(), (0.9 * k + 1.0).sin()) * size
        })
        .map(Lane::from)
        .collect()
}

fn forces(model: &Model, live: &LiveMesh, u: &[Lane]) -> Vec<Vec3> {
    (0..u.len())
        .map(|i| live.internal_force(model, i, u))
        .collect()
}

fn largest(forces: &[Vec3]) -> f64 {
    forces.iter().map(|f| f.norm()).fold(0.0, f64::max)
}

/// \[J\], by a sweep of no length.
fn energy(model: &Model, live: &LiveMesh, u: &[Lane]) -> f64 {
    0.5 * run(
        model,
        live,
        &mut Fields::of(u),
        0.0,
        0.0,
        spring_sweep::sweep,
    )
    .elastic
}

#[derive(Clone)]
struct Fields {
    displacement: Vec<Lane>,
    velocity: Vec<Lane>,
    residual: Vec<Lane>,
    partial: Vec<Lane>,
}

impl Fields {
    fn of(u: &[Lane]) -> Fields {
        let zeros = vec![Lane::default(); u.len()];
        Fields {
            displacement: u.to_vec(),
            velocity: zeros.clone(),
            residual: zeros.clone(),
            partial: zeros,
        }
    }
}

type Sweep = fn(&Springs, &mut Motion, &Advance) -> Sums;

fn run(model: &Model, live: &LiveMesh, f: &mut Fields, h: f64, c: f64, by: Sweep) -> Sums {
    let state = State::new(model);
    let mut motion = Motion {
        displacement: &mut f.displacement,
        velocity: &mut f.velocity,
        residual: &mut f.residual,
        partial: &mut f.partial,
        external: &state.external,
        inverse_mass: &state.inverse_mass,
        mass: &live.mass,
        listed: None,
    };
    by(
        springs(live),
        &mut motion,
        &Advance::symplectic_euler(h, h, c),
    )
}

/// One tetrahedron: six springs of k = E V / l_0² and nothing else.
#[test]
fn springs_of_one_tetrahedron_are_van_gelders() {
    let text = r#"{"name": "one", "mesh": {"nodes": [[0, 0, 0], [0.02, 0, 0], [0.003, 0.03, 0], [0.001, 0.004, 0.05]],
      "tetrahedra": [[0, 1, 2, 3]]},
      "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.3, "density": 1000}],
      "fixed": [{"nodes": [0, 1, 2]}], "gravity": [0, 0, 0], "model": {"kind": "springMass"}}"#;
    let model = common::model(text);
    let volume = 0.02 * 0.03 * 0.05 / 6.0;
    let (a, b) = (model.node[0], model.node[1]);
    let k = 6000.0 * volume / (0.02 * 0.02);
    let found = springs(&model.whole).stiffness(&model.pattern, a, b);
    assert!((found - k).abs() < 1e-12 * k, "{found} {k}");
    // Node 1 drawn 3 mm away: its three springs pull, the other three must not.
    let mut u = vec![Lane::default(); 4];
    u[b as usize] = Vec3::new(0.003, 0.0, 0.0).into();
    let pull = |from: [f64; 3], to: [f64; 3], moved: [f64; 3]| {
        let (r, d) = (
            Vec3::from(to) - Vec3::from(from),
            Vec3::from(moved) - Vec3::from(from),
        );
        let k = 6000.0 * volume / r.norm_squared();
        d.normalize() * (k * (d.norm() - r.norm()))
    };
    let moved = [0.023, 0.0, 0.0];
    let expected = [[0.0, 0.0, 0.0], [0.003, 0.03, 0.0], [0.001, 0.004, 0.05]]
        .map(|from| pull(from, [0.02, 0.0, 0.0], moved));
    let found = forces(&model, &model.whole, &u);
    let scale = largest(&found);
    for (scene_node, f) in [0, 2, 3].into_iter().zip(expected) {
        let other = found[model.node[scene_node] as usize];
        assert!((other + f).norm() < 1e-13 * scale, "{other} {f}");
    }
    let sum: Vec3 = expected.iter().sum();
    assert!((found[b as usize] - sum).norm() < 1e-13 * scale);
}

#[test]
fn a_fibre_stiffens_the_springs_along_it() {
    let fibre =
        r#""density": 1000, "fibre": {"direction": [0, 0, 1], "lambda": 900000, "mu": 900000}"#;
    let plain = common::model(&bar(""));
    let model = common::model(&bar("").replace(r#""density": 1000"#, fibre));
    let stretched = |model: &Model, axis: usize| {
        let by = |p: &Vec3| Lane::from(Vec3::ith(axis, 1e-3 * p[axis]));
        let u: Vec<Lane> = model.mesh.nodes.iter().map(by).collect();
        energy(model, &model.whole, &u)
    };
    let (along, across) = (
        stretched(&model, 2) / stretched(&plain, 2),
        stretched(&model, 0) / stretched(&plain, 0),
    );
    assert!(
        along > 2.0 && across > 1.0 && across < 1.5,
        "{along} {across}"
    );
}

#[test]
fn force_is_the_gradient_of_the_energy() {
    let model = common::model(&bar(""));
    let u = wild(&model, 1e-3);
    let force = forces(&model, &model.whole, &u);
    let scale = largest(&force);
    for node in [0, 17, 100, u.len() - 1] {
        for axis in 0..3 {
            let at = |step: f64| {
                let mut u = u.clone();
                u[node].0[axis] += step;
                energy(&model, &model.whole, &u)
            };
            // Fourth order.
            let h = 2e-6;
            let slope = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
            assert!(
                (slope - force[node][axis]).abs() < 1e-8 * scale,
                "{slope} {}",
                force[node][axis]
            );
        }
    }
}

#[test]
fn rigid_motions_cost_nothing() {
    let model = common::model(&bar(""));
    let turn = Rotation3::from_euler_angles(0.7, -1.9, 2.5);
    let moved = |a: &Matrix3<f64>| -> Vec<Lane> {
        let by = |p: &Vec3| Lane::from(a * p - p + Vec3::new(0.2, -0.1, 0.3));
        model.mesh.nodes.iter().map(by).collect()
    };
    let stretch = Matrix3::from_diagonal(&Vec3::new(1.1, 1.0, 0.9));
    let scale = largest(&forces(&model, &model.whole, &moved(&stretch)));
    let turned = moved(turn.matrix());
    assert!(largest(&forces(&model, &model.whole, &turned)) < 1e-12 * scale);
    assert!(energy(&model, &model.whole, &turned) < 1e-20);
    // Linear tensors read the same rotation as a strain.
    let linear = common::model(common::BAR);
    let by = |p: &Vec3| Lane::from(turn * p - p);
    let u: Vec<Lane> = linear.mesh.nodes.iter().map(by).collect();
    assert!(largest(&forces(&linear, &linear.whole, &u)) > scale);
}

#[test]
fn springs_keep_momentum() {
    let model = common::model(&bar(""));
    let u = wild(&model, 2e-3);
    let force = forces(&model, &model.whole, &u);
    let (mut net, mut torque) = (Vec3::zeros(), Vec3::zeros());
    for (i, f) in force.iter().enumerate() {
        net += f;
        torque += (model.mesh.nodes[i] + u[i].xyz()).cross(f);
    }
    let scale = largest(&force);
    assert!(net.norm() < 1e-12 * scale && torque.norm() < 1e-13 * scale);
}

#[test]
fn a_collapsed_spring_has_no_force_and_no_nan() {
    let model = common::model(&bar(""));
    let (i, j) = (0, model.pattern.column[1] as usize);
    let mut u = vec![Lane::default(); model.mesh.nodes.len()];
    u[j] = (model.mesh.nodes[i] - model.mesh.nodes[j]).into();
    for by in [spring_sweep::sweep as Sweep, spring_sweep::plain] {
        let mut f = Fields::of(&u);
        let sums = run(&model, &model.whole, &mut f, 1e-4, 1.0, by);
        assert!(sums.elastic.is_finite() && f.residual[j].xyz().norm().is_finite());
    }
}

#[test]
fn fused_sweep_equals_plain_and_rows() {
    let model = common::model(&bar(""));
    let u = wild(&model, 1e-3);
    let mut fast = Fields::of(&u);
    fast.velocity = wild(&model, 0.1);
    let mut slow = fast.clone();
    let force = forces(&model, &model.whole, &u);
    let critical = symplectic_euler(model.spectrum.highest, 7.0);
    for step in 0..20 {
        let a = run(
            &model,
            &model.whole,
            &mut fast,
            0.5 * critical,
            7.0,
            spring_sweep::sweep,
        );
        let b = run(
            &model,
            &model.whole,
            &mut slow,
            0.5 * critical,
            7.0,
            spring_sweep::plain,
        );
        let scale = a.elastic.abs() + a.kinetic.abs();
        for (x, y) in [
            (a.elastic, b.elastic),
            (a.kinetic, b.kinetic),
            (a.damping, b.damping),
            (a.external, b.external),
            (a.lagging, b.lagging),
        ] {
            assert!((x - y).abs() <= 1e-13 * scale, "{x} {y} at {step}");
        }
        if step == 0 {
            let state = State::new(&model);
            let scale = largest(&force);
            for i in 0..u.len() {
                let damping = wild(&model, 0.1)[i].xyz() * (7.0 * model.whole.mass[i]);
                let expected = state.external[i].xyz() - force[i] - damping;
                assert!((slow.residual[i].xyz() - expected).norm() < 1e-13 * scale);
            }
        }
    }
    for (x, y) in fast.displacement.iter().zip(&slow.displacement) {
        assert!((x.xyz() - y.xyz()).amax() < 1e-13 * 0.01);
    }
    assert!(fast.partial.iter().all(|p| *p == Lane::default()));
}

#[test]
fn removals_leave_what_a_rebuild_makes() {
    let cuts = |list: &str| {
        bar(&format!(
            r#""cuts": [{{"time": 0, "where": {{"tetrahedra": [{list}]}}}}],"#
        ))
    };
    let count = common::model(&bar("")).shape.len();
    let gone: Vec<String> = (0..60).map(|k| (k * 337 % count).to_string()).collect();
    let mut s = common::simulation(&cuts(&gone.join(",")));
    s.step(1e-3).unwrap();
    let (model, live) = (s.model().clone(), s.state().live.clone());
    assert!(live.removed.len() >= 60);
    let mut fresh = Springs::new(&model.pattern, &model.mesh.nodes);
    for t in (0..count).filter(|t| live.alive[*t]) {
        let (nodes, law) = (&model.mesh.tetrahedra[t], &model.material(t).law);
        let rest = model.rest_positions(t);
        fresh.accumulate(&model.pattern, nodes, &rest, model.shape[t].volume, law);
    }
    let edges = || {
        (0..model.pattern.nodes()).flat_map(|i| {
            let row =
                model.pattern.row_start[i] as usize + 1..model.pattern.row_start[i + 1] as usize;
            model.pattern.column[row]
                .iter()
                .map(move |j| (i as u32, *j))
        })
    };
    let scale = edges()
        .map(|(i, j)| fresh.stiffness(&model.pattern, i, j))
        .fold(0.0, f64::max);
    let mut zeros = 0;
    for (i, j) in edges() {
        let (now, new) = (
            springs(&live).stiffness(&model.pattern, i, j),
            fresh.stiffness(&model.pattern, i, j),
        );
        assert!((now - new).abs() < 1e-14 * scale, "{now} {new}");
        assert!(new > 0.0 || now == 0.0, "edge {i} {j} is not exactly zero");
        zeros += u32::from(new == 0.0);
    }
    assert!(zeros > 0);
}

/// What is booked with a removed tetrahedron is what the springs lose.
#[test]
fn one_tetrahedrons_force_and_energy_are_what_its_removal_takes() {
    let text = bar(r#""cuts": [{"time": 0, "where": {"tetrahedra": [51]}}],"#);
    let mut s = common::simulation(&text);
    s.step(1e-3).unwrap();
    let (model, live) = (s.model(), &s.state().live);
    let u = wild(model, 1e-3);
    let nodes = model.mesh.tetrahedra[51];
    let (force, energy_share) = tetrahedron_force(
        &model.material(51).law,
        model.shape[51].volume,
        &model.rest_positions(51),
        &nodes.map(|v| u[v as usize].xyz()),
    );
    let lost = energy(model, &model.whole, &u) - energy(model, live, &u);
    assert!((lost - energy_share.iter().sum::<f64>()).abs() < 1e-12 * energy(model, live, &u));
    let (before, after) = (forces(model, &model.whole, &u), forces(model, live, &u));
    for (v, f) in nodes.into_iter().zip(force) {
        let v = v as usize;
        assert!((before[v] - after[v] - f).norm() < 1e-13 * largest(&before));
    }
}

/// Largest miss of the balance over a free undamped vibration, as a share of the energy.
fn account_miss(share_of_critical: f64) -> f64 {
    let model = common::model(&bar(""));
    let substep = share_of_critical * central_difference(model.spectrum.highest);
    let integration = format!(
        r#""integration": {{"scheme": "centralDifference", "damping": 0, "substep": {substep:e}, "hapticRate": {:e}}},"#,
        1.0 / substep
    );
    // Ten times its weight: swings by its own length.
    let mut s = common::simulation(&bar(&integration));
    s.set_gravity(2, -100.0);
    let (mut miss, mut scale) = (0.0f64, 0.0f64);
    while s.time() < 0.3 {
        s.step(substep).unwrap();
        let energy = s.energy();
        miss = miss.max((energy.balance() - s.state().account.start).abs());
        scale = scale.max(energy.elastic.max(energy.kinetic));
    }
    miss / scale
}

#[test]
fn the_account_of_a_free_vibration_misses_little_and_less_with_h_squared() {
    let (coarse, fine) = (account_miss(0.9), account_miss(0.45));
    assert!(coarse < 0.01, "{coarse}");
    assert!(fine < coarse / 3.5 && coarse > 1e-4, "{coarse} {fine}");
}

/// Springs drawn to more than twice their length are stable at 0.9 of the critical step, without halving.
#[test]
fn strong_stretch_is_stable_below_the_critical_step() {
    let model = common::model(&bar(""));
    let substep = 0.9 * symplectic_euler(model.spectrum.highest, 0.0);
    let text = bar(&format!(
        r#""integration": {{"damping": 0, "substep": {substep:e}, "hapticRate": {:e}}},
        "prescribed": [{{"where": {{"box": {{"min": [0.1, 0, 0], "max": [0.1, 1, 1]}}}}, "displacement": [0.12, 0, 0], "ramp": 0.05}}],"#,
        1.0 / substep
    ));
    let mut s = common::simulation(&text);
    let mut most = 0.0f64;
    while s.time() < 0.5 {
        s.step(substep).unwrap();
        assert_eq!(s.halvings(), 0);
        let energy = s.energy();
        assert!(energy.elastic < 1.5 * energy.support_work.abs().max(1e-3));
        if s.time() > 0.05 {
            most = most.max(energy.kinetic.abs() / energy.elastic);
        }
    }
    assert!(most < 0.5, "{most}");
}

/// The tangent at any deformation lies below the bound that the critical step is taken from.
#[test]
fn spectrum_bounds_every_tangent() {
    let model = common::model(&bar(""));
    let n = model.mesh.nodes.len();
    for size in [0.0, 1e-3, 1e-2, 0.1] {
        let u = wild(&model, size);
        let at = |x: &[Vec3], step: f64| -> Vec<Vec3> {
            let moved: Vec<Lane> = (u.iter().zip(x))
                .map(|(u, x)| Lane::from(u.xyz() + x * step))
                .collect();
            forces(&model, &model.whole, &moved)
        };
        // Power iteration on M^-1 K by differences.
        let mut x: Vec<Vec3> = wild(&model, 1.0).iter().map(Lane::xyz).collect();
        let mut found = 0.0;
        for _ in 0..60 {
            let norm = (0..n)
                .map(|i| model.whole.mass[i] * x[i].norm_squared())
                .sum::<f64>()
                .sqrt();
            x.iter_mut().for_each(|x| *x /= norm);
            let step = 1e-6 / x.iter().map(|x| x.amax()).fold(0.0, f64::max);
            let (up, down) = (at(&x, step), at(&x, -step));
            let kx: Vec<Vec3> = (0..n).map(|i| (up[i] - down[i]) / (2.0 * step)).collect();
            found = (0..n).map(|i| x[i].dot(&kx[i])).sum::<f64>();
            x = (0..n)
                .map(|i| {
                    let free = model.boundary.free[i];
                    Vec3::from_fn(|a, _| {
                        if free[a] {
                            kx[i][a] / model.whole.mass[i]
                        } else {
                            0.0
                        }
                    })
                })
                .collect();
        }
        let bound = model.spectrum.highest.powi(2);
        assert!(found < bound, "{found} {bound}");
        assert!(size < 0.05 || found > 0.3 * bound, "{found} {bound}");
        assert!(model.spectrum.highest < model.spectrum.element_bound);
    }
}

/// Grasp, pull, cut and drop: runs, keeps its account, and a saved state goes on to the bit.
#[test]
fn grasp_pull_cut_and_drop() {
    let mut s = common::simulation(&bar(""));
    let mut other: Option<Simulation> = None;
    let (mut scale, mut miss, mut grasped, mut force) = (0.0f64, 0.0f64, 0, 0.0f64);
    for k in 0..1200 {
        if k == 700 {
            let bytes = s.serialise(s.state());
            let mut twin = Simulation::new(s.model().clone());
            let state = twin.deserialise(&bytes).unwrap();
            twin.restore(&state);
            other = Some(twin);
        }
        for s in std::iter::once(&mut s).chain(&mut other) {
            common::script(s, f64::from(k) * 1e-3);
            s.step(1e-3).unwrap();
        }
        let energy = s.energy();
        scale = scale.max(energy.elastic + energy.kinetic + energy.tool_work.abs());
        miss = miss.max((energy.balance() - s.state().account.start).abs());
        grasped += u32::from(s.tool(1).in_contact);
        force = force.max(s.tool(1).force.norm());
    }
    assert!(s.state().live.removed.len() > 10 && s.pieces() >= 2 && grasped > 300);
    assert!(force > 0.05, "{force}");
    assert!(miss < 1e-3 * scale, "{miss} {scale}");
    let twin = other.unwrap();
    let (a, b) = (s.state(), twin.state());
    assert!(a.live.removed.len() > b.live.removed.len() / 2 && a.live == b.live);
    assert_eq!(a.displacement, b.displacement);
    assert_eq!(a.velocity, b.velocity);
    assert_eq!(s.serialise(a), twin.serialise(b));
}

/// Two tetrahedra that share an edge turn about it freely: no failure, and no damping from that.
#[test]
fn hinges_do_not_stop_the_build() {
    let text = r#"{"name": "hinge", "mesh": {"nodes": [[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01], [0, -0.01, 0.001], [0.002, -0.001, -0.01]],
      "tetrahedra": [[0, 1, 2, 3], [0, 1, 4, 5]]},
      "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.3, "density": 1000}],
      "fixed": [{"nodes": [1, 2, 3]}], "model": {"kind": "springMass"}}"#;
    let model = common::model(text);
    assert!(model.spectrum.highest > 0.0 && model.damping() < model.spectrum.highest);
    let mut s = Simulation::new(model);
    for _ in 0..500 {
        s.step(1e-3).unwrap();
    }
    // It swings about the edge and does not stretch.
    assert!(s.state().displacement.iter().any(|u| u.xyz().norm() > 1e-3));
    assert!(s.minimum_volume_ratio() > 0.9);
}

#[test]
fn inspection_says_what_springs_are_not() {
    let model = common::model(&bar(""));
    let inspection = tissue::inspect::inspect(&model);
    assert!(inspection.warnings.iter().any(|w| w.contains("Poisson")));
    assert!(inspection.memory_bytes > 40 * model.pattern.edges());
    assert!(tissue::inspect::warnings(&common::model(common::BAR)).is_empty());
}

/// Sag of the cantilever example's end against the FEM of its own mesh: what docs/model.md says.
#[test]
fn the_cantilever_sags_as_the_manual_says() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/cantilever.json");
    let mut scene = tissue::scene::read(&path).unwrap();
    scene.model.kind = tissue::scene::ModelKind::SpringMass;
    let model = std::sync::Arc::new(tissue::prepared::prepare(scene, &path).unwrap());
    let reference = tissue::reference::solve(&model, false).unwrap();
    let mut s = Simulation::new(model.clone());
    while s.time() < 1.5 {
        s.step(0.01).unwrap();
    }
    let (mut sag, mut exact) = (0.0, 0.0);
    for (k, node) in model.node.iter().enumerate() {
        if reference.nodes[k][0] > 0.0999 {
            sag += s.state().displacement[*node as usize].0[2];
            exact += reference.displacement[k][2];
        }
    }
    let ratio = sag / exact;
    assert!((ratio - 0.857).abs() < 1e-3, "{ratio}");
}
