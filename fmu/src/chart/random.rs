//! Scenes drawn at random from a region that shall hold.
//!
//! A scene follows from a seed and its number alone: number k of one seed is the same scene in a run of ten as in one of
//! ten thousand, on one thread or on many.

use serde_json::{Value, json};
use tissue::contact::geometry::Capsule;
use tissue::mesh::check::surface;
use tissue::mesh::quality::{corners, dihedral_angles, volume};
use tissue::mesh::{TetMesh, Vec3, box_mesh, cylinder};

/// What is inside, whatever the law. Ranges are drawn from end to end.
pub struct Region {
    /// \[Pa\]
    pub young_modulus: [f64; 2],
    pub poisson_ratio: [f64; 2],
    /// \[kg/m³\]
    pub density: [f64; 2],
    /// Longest side or height \[m\].
    pub size: [f64; 2],
    /// About: cells are rounded.
    pub tetrahedra: [usize; 2],
    /// Smallest one of the mesh \[degrees\].
    pub dihedral: [f64; 2],
    /// Of tools \[m/s\].
    pub speed: [f64; 2],
    /// Communication step \[s\].
    pub step: [f64; 2],
    /// Simulated \[s\].
    pub length: [f64; 2],
}

pub const REGION: Region = Region {
    young_modulus: [500.0, 200e3],
    poisson_ratio: [0.0, 0.49],
    density: [900.0, 1100.0],
    size: [0.01, 0.2],
    tetrahedra: [100, 1500],
    dihedral: [8.0, 30.0],
    speed: [0.005, 0.5],
    step: [1e-4, 0.02],
    length: [0.1, 0.5],
};

/// A law and an element, and how far tissue of them may be deformed.
pub struct LawRow {
    pub law: &'static str,
    pub element: &'static str,
    /// From where a tool touches to where it stops, or a grasper from where it closes, in its radius or the mean edge of the
    /// mesh, whichever is less.
    pub way: f64,
    /// Change of height between two plates, of the height.
    pub squeeze: f64,
    /// Strain that weight makes at a support, were it put on slowly.
    pub weight: f64,
}

const fn row(law: &'static str, element: &'static str, [way, squeeze, weight]: [f64; 3]) -> LawRow {
    LawRow {
        law,
        element,
        way,
        squeeze,
        weight,
    }
}

/// `adaptive` is `stVenantKirchhoff` past a threshold.
pub const LAWS: [LawRow; 12] = [
    row("linear", "constantStrain", [0.15, 0.2, 0.05]),
    row("linear", "nodalPressure", [0.15, 0.2, 0.05]),
    row("linear", "nodalAveraged", [0.15, 0.2, 0.05]),
    row("stVenantKirchhoff", "constantStrain", [0.08, 0.1, 0.05]),
    row("stVenantKirchhoff", "nodalPressure", [0.05, 0.1, 0.05]),
    row("stVenantKirchhoff", "nodalAveraged", [0.05, 0.1, 0.05]),
    row("stableNeoHookean", "constantStrain", [0.3, 0.3, 0.3]),
    row("stableNeoHookean", "nodalPressure", [0.15, 0.1, 0.1]),
    row("stableNeoHookean", "nodalAveraged", [0.3, 0.3, 0.3]),
    row("adaptive", "constantStrain", [0.08, 0.1, 0.05]),
    row("polynomial", "constantStrain", [0.08, 0.1, 0.05]),
    row("springs", "constantStrain", [0.01, 0.02, 0.01]),
];

/// Numbers that follow from a seed, the number of a scene and a count alone (Steele, Lea and Flood 2014, SplitMix64).
struct Draw {
    key: u64,
    count: u64,
}

impl Draw {
    fn new(seed: u64, index: u64) -> Draw {
        let key = mix(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ mix(index));
        Draw { key, count: 0 }
    }

    /// From 0 to below 1.
    fn unit(&mut self) -> f64 {
        self.count += 1;
        let bits = mix(self.key ^ self.count.wrapping_mul(0xd134_2543_de82_ef95));
        (bits >> 11) as f64 / (1u64 << 53) as f64
    }

    fn uniform(&mut self, [low, high]: [f64; 2]) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Each order of magnitude as likely.
    fn scale(&mut self, [low, high]: [f64; 2]) -> f64 {
        low * (high / low).powf(self.unit())
    }

    fn chance(&mut self, share: f64) -> bool {
        self.unit() < share
    }

    fn below(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// By weights.
    fn pick<T: Copy>(&mut self, of: &[(T, f64)]) -> T {
        let mut rest = self.unit() * of.iter().map(|(_, w)| w).sum::<f64>();
        for (value, weight) in of {
            rest -= weight;
            if rest < 0.0 {
                return *value;
            }
        }
        of[of.len() - 1].0
    }

    fn direction(&mut self) -> Vec3 {
        loop {
            let v = Vec3::from_fn(|_, _| self.uniform([-1.0, 1.0]));
            if (0.01..1.0).contains(&v.norm_squared()) {
                return v.normalize();
            }
        }
    }
}

/// Its finaliser.
fn mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Where a tool is at a time \[s, m\], and whether it is closed or its current on, from then on.
pub struct Key {
    pub time: f64,
    pub position: Vec3,
    pub active: bool,
}

/// A scene, and what is done with it.
pub struct Drawn {
    pub law: usize,
    pub kind: &'static str,
    pub scheme: &'static str,
    /// As a scene file.
    pub scene: Value,
    pub tools: Vec<Vec<Key>>,
    /// Simulated, and of a communication step \[s\].
    pub length: f64,
    pub step: f64,
    /// For the CSV: what was drawn, in the order of [`FACTS`].
    pub facts: [f64; FACTS.len()],
    /// And what happens.
    pub story: String,
    /// Further than this nothing can go \[m\].
    pub horizon: f64,
}

pub const KINDS: [&str; 4] = ["tensorMass", "hybrid", "quasiStatic", "springMass"];

pub const FACTS: [&str; 12] = [
    "young_modulus",
    "poisson_ratio",
    "size",
    "tetrahedra",
    "dihedral",
    "speed",
    "way",
    "step",
    "length",
    "weight",
    "squeeze",
    "radius",
];

/// A mesh whose nodes were moved at random.
struct Body {
    mesh: TetMesh,
    /// Rest positions before they were moved: what is fixed is chosen by them.
    plain: Vec<Vec3>,
    /// A cylinder, which is held at its flat ends.
    round: bool,
    bounds: [Vec3; 2],
    edge: f64,
    /// Least \[degrees\].
    dihedral: f64,
    /// Of a tetrahedron \[m\].
    least_height: f64,
}

/// Smallest dihedral angle \[degrees\]; 0 where a tetrahedron is inside out.
pub fn least_dihedral(mesh: &TetMesh) -> f64 {
    let of = |t: &[u32; 4]| {
        let p = corners(mesh, *t);
        match volume(p) > 0.0 {
            true => dihedral_angles(p).into_iter().fold(f64::MAX, f64::min),
            false => 0.0,
        }
    };
    let least = mesh.tetrahedra.iter().map(of).fold(f64::MAX, f64::min);
    least.to_degrees()
}

fn body(draw: &mut Draw, size: f64, count: f64) -> Body {
    let round = draw.chance(0.3);
    let mut mesh = if round {
        let slim = draw.uniform([0.15, 0.5]);
        let volume = std::f64::consts::PI * slim * slim * size.powi(3);
        let edge = (6.0 * std::f64::consts::SQRT_2 * volume / count).cbrt();
        cylinder::generate(slim * size, size, edge.min(slim * size))
    } else {
        let mut sides = [1.0, draw.uniform([0.25, 1.0]), draw.uniform([0.25, 1.0])];
        sides.rotate_left(draw.below(3));
        let sides = sides.map(|s| s * size);
        let kuhn = draw.chance(0.4);
        let each = if kuhn { 6.0 } else { 5.0 };
        let cell = (sides.iter().product::<f64>() * each / count).cbrt();
        let cells = sides.map(|s| ((s / cell).round() as usize).max(1));
        let make = if kuhn { box_mesh::kuhn } else { box_mesh::five };
        make(sides, cells, [0.0; 3])
    };
    let plain = mesh.nodes.clone();
    let mut edge = 0.0;
    for t in &mesh.tetrahedra {
        let p = corners(&mesh, *t);
        edge += (volume(p) * 6.0 * std::f64::consts::SQRT_2).cbrt();
    }
    let edge = edge / mesh.tetrahedra.len() as f64;
    let moves: Vec<Vec3> = plain.iter().map(|_| draw.direction() * edge).collect();
    let wanted = draw.scale(REGION.dihedral);
    let (mut low, mut high) = (0.0, 0.6);
    let put = |mesh: &mut TetMesh, share: f64| {
        for ((node, at), way) in mesh.nodes.iter_mut().zip(&plain).zip(&moves) {
            *node = at + way * share;
        }
    };
    for _ in 0..10 {
        let middle = 0.5 * (low + high);
        put(&mut mesh, middle);
        match least_dihedral(&mesh) >= wanted {
            true => low = middle,
            false => high = middle,
        }
    }
    put(&mut mesh, low);
    let mut bounds = [plain[0]; 2];
    for at in &plain {
        bounds = [bounds[0].inf(at), bounds[1].sup(at)];
    }
    let height = |t: &[u32; 4]| {
        let p = corners(&mesh, *t);
        let faces = tissue::mesh::quality::FACES;
        let areas = faces.map(|[i, j, k]| 0.5 * (p[j] - p[i]).cross(&(p[k] - p[i])).norm());
        3.0 * volume(p) / areas.into_iter().fold(0.0, f64::max)
    };
    let least_height = mesh.tetrahedra.iter().map(height).fold(f64::MAX, f64::min);
    let dihedral = least_dihedral(&mesh);
    Body {
        plain,
        round,
        bounds,
        edge,
        dihedral,
        least_height,
        mesh,
    }
}

/// Work that a run may take, in tetrahedra times substeps: so that ten thousand end in minutes.
const MOST_WORK: f64 = 8e6;

/// What a cut leaves may be a tenth of what carried the weight: laws that do not bring tetrahedra back carry as much less.
const LEFT_BY_CUTS: f64 = 0.1;

/// Scene `index` of `seed`.
pub fn draw(seed: u64, index: u64) -> Drawn {
    let draw = &mut Draw::new(seed, index);
    let kind = draw.pick(&[
        ("tensorMass", 5.0),
        ("hybrid", 2.5),
        ("quasiStatic", 1.2),
        ("springMass", 1.3),
    ]);
    let law = match kind {
        "springMass" => LAWS.len() - 1,
        "quasiStatic" => draw.below(3),
        "hybrid" => draw.below(LAWS.len() - 3),
        _ => draw.below(LAWS.len() - 1),
    };
    let limits = &LAWS[law];
    let implicit = law == 0 && kind != "springMass";
    let mut scheme = draw.pick(&[
        ("symplecticEuler", 5.0),
        ("centralDifference", 2.0),
        ("rungeKutta4", 1.5),
        ("euler", 0.5),
        ("implicitEuler", if implicit { 3.0 } else { 0.0 }),
    ]);
    let young = draw.scale(REGION.young_modulus);
    // Near the upper end, where tissue is.
    let nu = REGION.poisson_ratio[1] * draw.unit().powf(0.4);
    let density = draw.uniform(REGION.density);
    let size = draw.scale(REGION.size);
    let step = draw.scale(REGION.step);
    let mut length = draw.uniform(REGION.length);
    let lame = young / (1.0 + nu);
    let wave = (lame * (1.0 - nu) / (1.0 - 2.0 * nu) / density).sqrt();
    let [least, most] = REGION.tetrahedra.map(|n| n as f64);
    let mut count = draw.scale([1.5 * least, 0.8 * most]);
    // Of a substep, and of a law, beside symplectic Euler and the linear one.
    let passes = match scheme {
        "rungeKutta4" => 2.5,
        "euler" => 4.0,
        _ => 1.0,
    } * match limits.law {
        "linear" => 1.0,
        "polynomial" => 6.0,
        _ => 2.0,
    };
    let body = loop {
        let body = body(draw, size, count);
        let work = passes * length * wave / body.least_height * body.mesh.tetrahedra.len() as f64;
        if work <= MOST_WORK || implicit && scheme == "implicitEuler" {
            break body;
        }
        length = (length * MOST_WORK / work).max(REGION.length[0]);
        if count <= 1.6 * least {
            break body;
        }
        count = (0.7 * count).max(1.5 * least);
    };
    let frequency = 2.0 * wave / body.least_height;
    if scheme == "euler" && frequency > 2e4 {
        scheme = "symplecticEuler";
    }
    let damping = match scheme {
        "euler" => json!(frequency),
        _ => match draw.below(3) {
            0 => json!(null),
            1 if kind != "quasiStatic" => json!(0),
            _ => json!(draw.scale([1.0, 200.0])),
        },
    };
    let [low, high] = body.bounds;
    let extent = high - low;
    let scale = extent.max();
    let near = 1e-6 * scale;
    let nodes = |of: &dyn Fn(&Vec3) -> bool| -> Vec<usize> {
        (0..body.plain.len())
            .filter(|i| of(&body.plain[*i]))
            .collect()
    };
    // What holds it: axis 0 to 2 and one end or both; or nothing.
    let held = draw.pick(&[("end", 6.0), ("ends", 2.5), ("none", 0.7)]);
    let held = if kind == "tensorMass" || held != "none" {
        held
    } else {
        "end"
    };
    let axis = if body.round { 2 } else { draw.below(3) };
    let low_end = nodes(&|p| p[axis] <= low[axis] + near);
    let high_end = nodes(&|p| p[axis] >= high[axis] - near);
    let mut fixed = match held {
        "none" => vec![],
        _ => low_end.clone(),
    };
    let mut story = vec![held];
    let mut scene = json!({});
    // Between plates the other end is moved.
    let plates = held == "ends" && draw.chance(0.4);
    let mut squeeze = 0.0f64;
    if plates {
        story.push("plates");
        let share = limits.squeeze * draw.uniform([-1.0, 1.0]);
        squeeze = share * extent[axis];
        let mut moved = [0.0; 3];
        moved[axis] = squeeze;
        let speed = draw.scale(REGION.speed);
        // A shear wave has the time to go there and back.
        let shear = (0.5 * lame / density).sqrt();
        let ramp = (squeeze.abs() / speed).max(2.0 * extent[axis] / shear);
        scene["prescribed"] =
            json!([{"where": {"nodes": high_end}, "displacement": moved, "ramp": ramp}]);
        squeeze = share;
    } else if held == "ends" {
        fixed.extend(&high_end);
    }
    fixed.sort_unstable();
    fixed.dedup();
    // Bending by its weight, or standing.
    let across = (0..3)
        .filter(|a| *a != axis)
        .map(|a| extent[a])
        .fold(f64::MAX, f64::min);
    let down = draw.direction();
    let reach = if held == "ends" { 0.5 } else { 1.0 } * extent[axis];
    let lean = (down - Vec3::ith(axis, down[axis])).norm();
    let strain =
        density * 9.81 / young * (reach * down[axis].abs() + 3.0 * reach * reach / across * lean);
    let mut weight = if held == "none" || draw.chance(0.3) {
        0.0
    } else {
        (limits.weight * draw.uniform([0.2, 1.0])).min(strain)
    };
    let falls = held == "none" && draw.chance(0.5);
    let gravity = match falls {
        true => 9.81,
        false => 9.81 * weight / strain,
    };
    let mut gravity: [f64; 3] = (down * gravity).into();
    let settled = held != "none" && kind != "springMass" && draw.chance(0.1);
    if settled {
        story.push("equilibrium");
        scene["start"] = json!("equilibrium");
    }
    // What is touched: outer triangles with no fixed corner.
    let skin = surface(&body.mesh.tetrahedra).unwrap_or_default();
    let place = |f: &[u32; 3]| f.map(|n| body.mesh.nodes[n as usize]);
    let outside: Vec<[Vec3; 3]> = skin.iter().map(place).collect();
    let is_fixed = |n: &u32| {
        let n = *n as usize;
        fixed.binary_search(&n).is_ok() || plates && high_end.binary_search(&n).is_ok()
    };
    let free: Vec<[u32; 3]> = (skin.into_iter())
        .filter(|f| !f.iter().any(is_fixed))
        .collect();
    let can_cut = kind != "quasiStatic" && kind != "springMass";
    let mut tools = vec![];
    let mut keys: Vec<Vec<Key>> = vec![];
    let (mut speed, mut way, mut broad) = (0.0f64, 0.0f64, 0.0f64);
    // What moves by itself comes no further to tools than they go.
    let wanted = match free.is_empty() || plates || falls || settled {
        true => 0,
        false => draw.pick(&[(0, 1.0), (1, 4.0), (2, 2.0)]),
    };
    for _ in 0..wanted {
        let face = place(&free[draw.below(free.len())]);
        let at = (face[0] + face[1] + face[2]) / 3.0;
        let inward = -(face[1] - face[0]).cross(&(face[2] - face[0])).normalize();
        let inward = (inward + 0.4 * draw.direction()).normalize();
        let radius = body.edge * draw.scale([0.4, 2.0]);
        let first = keys.first().and_then(|k| k.last());
        if first.is_some_and(|k| (k.position - at).norm() < 6.0 * (radius + body.edge)) {
            continue;
        }
        let slides = scheme == "symplecticEuler" || scheme == "centralDifference";
        let rubs = slides && kind == "tensorMass";
        let tool = draw.pick(&[
            ("grasper", 3.0),
            ("stick", 3.0),
            ("slide", if rubs { 3.0 } else { 0.0 }),
            ("cautery", if can_cut { 1.5 } else { 0.0 }),
        ]);
        story.push(tool);
        let v = draw.scale(REGION.speed);
        speed = speed.max(v);
        let reach = limits.way * radius.min(body.edge) * draw.uniform([0.1, 1.0]);
        let shaft = if draw.chance(0.5) { 0.0 } else { 4.0 * radius };
        let touches = |tip: Vec3| {
            let end = tip - inward * shaft;
            let capsule = Capsule { tip, end, radius };
            (outside.iter()).any(|t| capsule.may_touch(t) && capsule.touches(t))
        };
        let Some(near) = first_touch(at, inward, radius, touches) else {
            continue;
        };
        let far = near - inward * (0.3 * radius);
        let mut path = Trace::from(far, v, tool == "cautery");
        match tool {
            "grasper" => {
                path.to(near + inward * (0.4 * radius));
                path.active = true;
                path.rest(draw.uniform([0.002, 0.02]));
                path.play(draw, reach);
                if draw.chance(0.4) {
                    path.active = false;
                    path.rest(0.01);
                    path.to(far);
                }
            }
            "cautery" => {
                path.to(near + inward * (radius * draw.uniform([0.5, 4.0])));
                let aside = inward.cross(&draw.direction());
                path.to(path.position() + aside * (radius * draw.uniform([0.0, 6.0])));
                path.active = draw.chance(0.5);
            }
            _ => {
                path.to(near + inward * reach);
                path.rest(draw.uniform([0.0, 0.02]));
                match draw.below(3) {
                    0 => path.to(far),
                    1 => path.play(draw, 0.5 * reach),
                    _ => {}
                }
            }
        }
        if tool != "cautery" {
            way = way.max(reach / radius.min(body.edge));
            broad = broad.max(radius / body.edge);
        }
        let shape = match shaft {
            0.0 => json!({"sphere": {"radius": radius}}),
            _ => json!({"capsule": {"radius": radius, "length": shaft}}),
        };
        // The shaft, along -z, points out of the tissue.
        let turn = nalgebra::UnitQuaternion::rotation_between(&Vec3::z(), &inward)
            .unwrap_or_else(nalgebra::UnitQuaternion::identity);
        let friction = match tool {
            "slide" => json!(draw.uniform([0.0, 0.8])),
            _ => json!("stick"),
        };
        let kind = match tool {
            "grasper" | "cautery" => tool,
            _ => "probe",
        };
        let start: [f64; 3] = far.into();
        let mut tool = json!({"name": format!("tool{}", tools.len() + 1), "kind": kind, "shape": shape,
            "friction": friction, "position": start, "orientation": [turn.w, turn.i, turn.j, turn.k]});
        if kind == "grasper" && slides && draw.chance(0.3) {
            tool["slipForce"] = json!(young * radius * radius * draw.scale([0.01, 1.0]));
        }
        tools.push(tool);
        keys.push(path.keys);
    }
    let middles: Vec<Vec3> = (body.mesh.tetrahedra.iter())
        .map(|t| corners(&body.mesh, *t).iter().sum::<Vec3>() / 4.0)
        .collect();
    let all: Vec<usize> = (0..middles.len()).collect();
    let dynamic = if kind == "hybrid" {
        let point = middles[draw.below(all.len())];
        let normal = draw.direction();
        // What is pre-computed has supports of its own: cut off it could not fall.
        let is_held = |t: &usize| {
            let nodes = body.mesh.tetrahedra[*t];
            (nodes.iter()).any(|n| fixed.binary_search(&(*n as usize)).is_ok())
        };
        let beyond = |normal: &Vec3, t: &usize| (middles[*t] - point).dot(normal) >= 0.0;
        let standing = all.iter().any(|t| !beyond(&normal, t) && is_held(t));
        let normal = if standing { normal } else { -normal };
        (all.iter().copied())
            .filter(|t| beyond(&normal, t))
            .collect()
    } else {
        all
    };
    if can_cut && draw.chance(0.3) {
        story.push("cuts");
        // A ball, or a slit through all of it.
        let middle = middles[dynamic[draw.below(dynamic.len())]];
        let ball = draw.chance(0.5);
        let reach = body.edge * draw.uniform([0.3, 2.0]);
        let across = draw.direction();
        let goes = |t: &usize| {
            let r = middles[*t] - middle;
            match ball {
                true => r.norm() <= reach,
                false => r.dot(&across).abs() <= 0.25 * reach,
            }
        };
        let gone: Vec<usize> = dynamic.iter().copied().filter(goes).collect();
        let time = length * draw.uniform([0.0, 0.8]);
        if limits.law != "stableNeoHookean" {
            gravity = gravity.map(|g| LEFT_BY_CUTS * g);
            weight *= LEFT_BY_CUTS;
        }
        scene["cuts"] = json!([{"time": time, "where": {"tetrahedra": gone}}]);
    }
    if can_cut && draw.chance(0.2) {
        story.push("tears");
        let criterion = draw.pick(&[
            ("maximumElongation", 2.0),
            ("meanElongation", 1.0),
            ("volume", 1.0),
        ]);
        scene["tearing"] = json!({"criterion": criterion, "threshold": draw.uniform([0.05, 0.4]),
            "budget": 1 + draw.below(8)});
    }
    let polynomial = limits.law == "polynomial";
    if can_cut && !polynomial && draw.chance(0.3) {
        story.push("duplicate");
        scene["cutting"] = json!({"rule": "duplicate"});
    }
    let mut model = match limits.law {
        "polynomial" => {
            json!({"kind": kind, "elasticity": "stVenantKirchhoff", "form": "polynomial", "element": "constantStrain"})
        }
        "adaptive" => {
            json!({"kind": kind, "elasticity": "stVenantKirchhoff", "nonlinearThreshold": body.edge * draw.scale([0.01, 0.2])})
        }
        "springs" => json!({"kind": kind}),
        law => json!({"kind": kind, "elasticity": law, "element": limits.element}),
    };
    if kind == "hybrid" {
        model["dynamic"] = json!({"tetrahedra": dynamic});
        if draw.chance(0.3) {
            model["interfaceModes"] = json!(6 + draw.below(60));
        }
    }
    let nodes: Vec<[f64; 3]> = body.mesh.nodes.iter().map(|p| (*p).into()).collect();
    scene["name"] = json!("random");
    scene["mesh"] = json!({"nodes": nodes, "tetrahedra": body.mesh.tetrahedra});
    scene["materials"] = json!([{"where": {"all": true}, "youngModulus": young, "poissonRatio": nu, "density": density}]);
    if !fixed.is_empty() {
        scene["fixed"] = json!([{"nodes": fixed}]);
    }
    scene["gravity"] = json!(gravity);
    scene["model"] = model;
    scene["integration"] = json!({"scheme": scheme, "damping": damping});
    scene["tools"] = json!(tools);
    let dihedral = body.dihedral;
    Drawn {
        law,
        kind,
        scheme,
        scene,
        tools: keys,
        length,
        step,
        facts: [
            young,
            nu,
            size,
            body.mesh.tetrahedra.len() as f64,
            dihedral,
            speed,
            way,
            step,
            length,
            weight,
            squeeze,
            broad,
        ],
        story: story.join(" "),
        // A piece that flies off is no faster than what was stored of it.
        horizon: 5.0 * scale + 5.0 * length * length + length * (0.5 + 0.2 * wave),
    }
}

/// Where a tool that goes straight for a point first touches tissue; none where it does so from the start.
fn first_touch(
    at: Vec3,
    inward: Vec3,
    radius: f64,
    touches: impl Fn(Vec3) -> bool,
) -> Option<Vec3> {
    let place = |k: f64| at - inward * (0.1 * k * radius);
    let mut free = 30.0;
    if touches(place(free)) {
        return None;
    }
    while free > 0.0 && !touches(place(free - 1.0)) {
        free -= 1.0;
    }
    let (mut free, mut touching) = (free, free - 1.0);
    for _ in 0..6 {
        let middle = 0.5 * (free + touching);
        match touches(place(middle)) {
            true => touching = middle,
            false => free = middle,
        }
    }
    Some(place(free))
}

/// A tool that goes to and fro rests so long before it turns \[s\]: hands do not shake faster.
pub const STROKE: f64 = 0.025;

/// The path of a tool, made point by point at one speed.
struct Trace {
    keys: Vec<Key>,
    speed: f64,
    active: bool,
}

impl Trace {
    fn from(position: Vec3, speed: f64, active: bool) -> Trace {
        let key = Key {
            time: 0.0,
            position,
            active,
        };
        Trace {
            keys: vec![key],
            speed,
            active,
        }
    }

    fn position(&self) -> Vec3 {
        self.keys.last().map_or_else(Vec3::zeros, |k| k.position)
    }

    fn push(&mut self, position: Vec3, lasts: f64) {
        let time = self.keys.last().map_or(0.0, |k| k.time) + lasts;
        self.keys.push(Key {
            time,
            position,
            active: self.active,
        });
    }

    fn to(&mut self, position: Vec3) {
        let lasts = (position - self.position()).norm() / self.speed;
        self.push(position, lasts);
    }

    fn rest(&mut self, lasts: f64) {
        self.push(self.position(), lasts);
    }

    /// Somewhere within reach, and rest; or to and fro.
    fn play(&mut self, draw: &mut Draw, reach: f64) {
        let (middle, way) = (self.position(), draw.direction() * reach);
        self.to(middle + way);
        if draw.chance(0.5) {
            for _ in 0..draw.below(20) {
                self.rest(STROKE);
                self.to(middle - way);
                self.rest(STROKE);
                self.to(middle + way);
            }
        }
        if draw.chance(0.3) {
            self.to(middle);
        }
    }
}
