//! What one evaluation of the non-linear forces costs on the demo's liver, beside the machine's own limit and the linear
//! tensors in the same run: `cargo bench -p tissue --bench force`.
//!
//! Medians of interleaved runs, and the shortest. Prints CSV; nothing here fails on time.

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use tissue::calibration::Calibration;
use tissue::element::Elements;
use tissue::element::blend::{self, Blend};
use tissue::element::kernel::Kernel;
use tissue::element::listed::Listed;
use tissue::element::nodal_averaged::NodalAveraged;
use tissue::element::nodal_pressure::NodalPressure;
use tissue::element::polynomial::Polynomial;
use tissue::element::tetrahedra::Tetrahedra;
use tissue::law::response::Law;
use tissue::mesh::Vec3;
use tissue::model::sweep::{Advance, Motion, sweep};
use tissue::model::tensor_mass::Lane;
use tissue::scene::{Adaptive, Elasticity};

const LIVER: &str = include_str!("../../examples/hepatectomy.json");
const ROUNDS: usize = 201;
const REPEATS: usize = 10;

fn main() {
    let scene = tissue::scene::parse(LIVER, "bench.json").expect("a scene of this file");
    let model = tissue::prepared::prepare(scene, Path::new("bench.json")).expect("a scene");
    let n = model.parts.moving;
    println!("what,median,best,unit");
    println!(
        "tetrahedra,{0},{0},\nvertices,{1},{1},",
        model.mesh.tetrahedra.len(),
        n
    );
    let u: Vec<Lane> = (model.mesh.nodes[..n].iter())
        .map(|x| Lane::from(Vec3::new(x.y * x.z, -0.3 * x.x, x.x * x.x)))
        .collect();
    let make = |law, fibre: bool| {
        let with: Vec<_> = (0..model.mesh.tetrahedra.len())
            .map(|t| {
                let material = model.material(t).law;
                match fibre {
                    true => material.with_fibre(Vec3::z(), 8e4, 2e4),
                    false => material,
                }
            })
            .collect();
        Tetrahedra::new(law, &model.mesh.tetrahedra, |t| {
            Some((&model.shape[t], &with[t]))
        })
    };
    let venant = make(Law::StVenantKirchhoff, false);
    let fibres = make(Law::StVenantKirchhoff, true);
    let hookean = make(Law::StableNeoHookean, false);
    let averaged = |law| {
        NodalAveraged::new(law, 0.3, &model.mesh.tetrahedra, |t| {
            Some((&model.shape[t], &model.material(t).law, 0))
        })
    };
    let averaged_venant = averaged(Law::StVenantKirchhoff);
    // With its guard, as the product has it.
    let mut scene = model.scene.clone();
    scene.model.elasticity = Elasticity::StableNeoHookean;
    let guarded = model.with_scene(scene).expect("the same mesh");
    let guarded = guarded.whole.elements.as_ref();
    let averaged_hookean = guarded.expect("elements of another law");
    assert!(matches!(averaged_hookean, Elements::NodalAveraged(..)));
    let mut near = Listed::new(guarded, None, n).expect("a guard");
    let mut rows = vec![0.0; averaged_hookean.points()];
    let averaged_linear = averaged(Law::Linear);
    // Pressed in at one vertex; a tenth of the tetrahedra beyond the threshold.
    let at = model.mesh.nodes[model.surface_nodes[0] as usize];
    let poked: Vec<Lane> = (model.mesh.nodes[..n].iter())
        .map(|x| Lane::from(Vec3::new(0.0, 0.0, -0.01) * (-(x - at).norm() / 0.02).exp()))
        .collect();
    let mut blend = Blend::new(
        Law::StVenantKirchhoff,
        Adaptive::Blend,
        1.0,
        &model.mesh.tetrahedra,
        |t| Some((&model.shape[t], &model.material(t).law)),
    );
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..50 {
        blend.threshold = 0.5 * (low + high);
        match blend.share(&poked, model.mesh.tetrahedra.len()) > 0.1 {
            true => low = blend.threshold,
            false => high = blend.threshold,
        }
    }
    let mut listed = blend::Listed::new(&blend, n);
    let zeros = vec![Lane::default(); n];
    let (mut v, mut w) = (zeros.clone(), u.clone());
    let (mut residual, mut partial) = (zeros.clone(), zeros.clone());
    let by = Advance::symplectic_euler(0.0, 0.0, 0.0);
    let polynomial = Polynomial::new(&model.mesh.tetrahedra, |t| {
        Some((&model.shape[t], &model.material(t).law))
    });
    for (what, bytes) in [
        ("StVK memory", venant.bytes()),
        ("StVK polynomial memory", polynomial.bytes()),
    ] {
        println!("{what},{0},{0},bytes", bytes);
    }
    let pressed = |law| {
        NodalPressure::new(law, &model.mesh.tetrahedra, |t| {
            Some((&model.shape[t], &model.material(t).law, 0))
        })
    };
    let pressed_venant = pressed(Law::StVenantKirchhoff);
    let pressed_hookean = pressed(Law::StableNeoHookean);
    let mut points = vec![0.0; pressed_venant.points()];
    let mut out = vec![Lane::default(); n];
    let mut linear = vec![Vec3::zeros(); n];
    let mut calibration = Calibration::default();
    let mut times = vec![Vec::new(); 16];
    for _ in 0..ROUNDS {
        let mut run = |k: usize, f: &mut dyn FnMut()| {
            let start = Instant::now();
            for _ in 0..REPEATS {
                f();
            }
            times[k].push(start.elapsed().as_secs_f64() / REPEATS as f64);
        };
        run(0, &mut || calibration.work());
        run(1, &mut || {
            model.whole.tensors.product(&model.pattern, &u, &mut linear);
        });
        run(2, &mut || {
            black_box(venant.add_forces(&u, &mut out));
        });
        run(3, &mut || {
            black_box(venant.add_forces_plain(&u, &mut out));
        });
        run(4, &mut || {
            black_box(fibres.add_forces(&u, &mut out));
        });
        run(5, &mut || {
            black_box(hookean.add_forces(&u, &mut out));
        });
        run(6, &mut || {
            black_box(averaged_venant.add_forces(&u, &mut out));
        });
        run(7, &mut || {
            black_box(averaged_venant.add_forces_plain(&u, &mut out));
        });
        run(8, &mut || {
            near.refresh(guarded, None, 0, &u);
            black_box(averaged_hookean.add_forces(
                Some(&near),
                &u,
                &mut out,
                &mut rows,
                &model.whole.mass,
            ));
        });
        let mut substep = |partial: &mut [Lane]| {
            let mut motion = Motion {
                displacement: &mut w,
                velocity: &mut v,
                residual: &mut residual,
                partial,
                external: &zeros,
                inverse_mass: &zeros,
                mass: &model.whole.mass[..n],
                listed: None,
            };
            let tensors = &model.whole.tensors;
            black_box(sweep(&model.pattern, tensors, &mut motion, &by));
        };
        run(9, &mut || substep(&mut partial));
        run(10, &mut || {
            listed.refresh(&blend, 0, &poked);
            black_box(blend.add_forces(Some(&listed), &poked, &mut partial));
            substep(&mut partial);
        });
        run(11, &mut || {
            black_box(polynomial.add_forces(&u, &mut out));
        });
        run(12, &mut || {
            black_box(pressed_venant.add_forces(&u, &mut out, &mut points));
        });
        run(13, &mut || {
            black_box(pressed_venant.add_forces_plain(&u, &mut out, &mut points));
        });
        run(14, &mut || {
            black_box(pressed_hookean.add_forces(&u, &mut out, &mut points));
        });
        run(15, &mut || {
            black_box(averaged_linear.add_forces(&u, &mut out));
        });
    }
    println!("blend looks at,{},,", listed.places());
    let names = [
        "calibration",
        "linear plain",
        "StVK",
        "StVK plain",
        "StVK fibres",
        "stable neo-Hookean",
        "StVK nodal-averaged",
        "StVK nodal-averaged plain",
        "stable neo-Hookean nodal-averaged",
        "linear substep",
        "StVK blend of a 10 % share substep",
        "StVK polynomial",
        "StVK nodal-pressure",
        "StVK nodal-pressure plain",
        "stable neo-Hookean nodal-pressure",
        "linear nodal-averaged",
    ];
    for (name, times) in names.iter().zip(&mut times) {
        times.sort_by(f64::total_cmp);
        let (median, best) = (1e6 * times[times.len() / 2], 1e6 * times[0]);
        println!("{name},{median:.2},{best:.2},us");
    }
}
