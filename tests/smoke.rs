use std::sync::Arc;
use tissue::model::Model;
use tissue::simulation::Simulation;

#[test]
fn gravity_equilibrium() {
    let text = r#"{"name":"beam","mesh":{"box":{"size":[0.1,0.02,0.02],"cells":[10,2,2]}},
    "materials":[{"where":{"all":true},"youngModulus":50000,"poissonRatio":0.4,"density":1000}],
    "fixed":[{"box":{"min":[0,0,0],"max":[0,1,1]}}],
    "tools":[{"name":"p","kind":"probe","shape":{"sphere":{"radius":0.01}},"position":[0.05,0.01,0.05]}]}"#;
    let scene = tissue::scene::parse(text, "beam.json").unwrap();
    let model = Arc::new(tissue::prepared::prepare(scene, std::path::Path::new("beam.json")).unwrap());
    println!("{:?} substep {} damping {}", model.spectrum, model.substep(model.damping()), model.damping());
    let reference = tissue::reference::solve(&model, false).unwrap();
    let mut s = Simulation::new(model.clone());
    for k in 0..3000 { s.step(1e-3).unwrap();
      if k % 300 == 0 { let e = s.energy(); println!("{:?} {:e}", e, e.balance() - s.state().account.start); } }
    let mut worst = 0f64;
    let mut scale = 0f64;
    for (k, n) in model.node.iter().enumerate() {
        let u = s.state().displacement[*n as usize].xyz();
        worst = worst.max((u - tissue::mesh::Vec3::from(reference.displacement[k])).norm());
        scale = scale.max(u.norm());
    }
    println!("worst {worst:e} of {scale:e} residual {:e}", reference.residual);
    for k in 0..40 { s.set_pose_input(0, 2, 0.05 - 0.001 * k as f64); s.step(1e-3).unwrap(); 
      let e = s.energy(); println!("{k} {:?} {:?} {:e} vol {}", s.tool(0).force, s.tool(0).mean_force, e.balance() - s.state().account.start, s.minimum_volume_ratio()); }
    for k in 0..40 { s.set_pose_input(0, 2, 0.01 + 0.001 * k as f64); s.step(1e-3).unwrap(); 
      let e = s.energy(); println!("{k} {:?} {} {:e}", s.tool(0).force, s.state().held.len(), e.balance() - s.state().account.start); }
    let r = s.model().clone();
    let b = s.serialise(s.state()); 
    assert_eq!(b.len(), tissue::snapshot::size(s.state()));
    assert_eq!(&s.deserialise(&b).unwrap(), s.state());
    drop(r);
}
