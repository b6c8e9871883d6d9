//! From the scene file's text to a [`Scene`]: one function a noun, its keys on top.

use std::path::Path;

use super::error::SceneError;
use super::json::{Node, Result};
use super::refuse::refuse;
use super::tree::tree;
use super::types::*;

/// Reads and checks a scene file.
pub fn read(path: &Path) -> Result<Scene, SceneError> {
    let file = path.display().to_string();
    let wrong = |message: String| SceneError::at(&file, "", message);
    let bytes = std::fs::read(path).map_err(|error| {
        wrong(format!(
            "cannot be read: {error}; must be a readable scene file"
        ))
    })?;
    let text = String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        wrong(format!(
            "not UTF-8 text from byte {at} on; must be saved as UTF-8"
        ))
    })?;
    parse(&text, &file)
}

/// Checks a scene; `file` is only named in errors.
pub fn parse(text: &str, file: &str) -> Result<Scene, SceneError> {
    let scene = whole_contract(text).and_then(|scene| refuse(&scene).map(|()| scene));
    scene.map_err(|error| error.in_file(file))
}

/// JSON Schema of the scene file, for editors.
pub fn schema() -> serde_json::Value {
    let mut schema = schemars::schema_for!(Scene).to_value();
    if let Some(keys) = schema
        .get_mut("properties")
        .and_then(serde_json::Value::as_object_mut)
    {
        keys.insert("$schema".into(), serde_json::json!({"type": "string"}));
    }
    schema
}

/// All that a scene file may say, whether this version can do it or not.
fn whole_contract(text: &str) -> Result<Scene> {
    scene(&Node::root(&tree(text.trim_start_matches('\u{feff}'))?))
}

fn scene(node: &Node) -> Result<Scene> {
    #[rustfmt::skip]
    let [
        schema, name, description, mesh, materials, fixed, prescribed, loads, gravity, start,
        model, integration, cutting, cuts, tearing, tools, outputs,
    ] = node.keys([
        "$schema", "name", "description", "mesh", "materials", "fixed", "prescribed", "loads",
        "gravity", "start", "model", "integration", "cutting", "cuts", "tearing", "tools",
        "outputs",
    ])?;
    schema.maybe(|n| n.text("the address of the scene's JSON Schema", |_| true))?;
    Ok(Scene {
        name: name
            .text(
                "a name of letters, digits and _, not starting with a digit",
                is_identifier,
            )?
            .into(),
        description: description.or("", |n| n.text("a string", |_| true))?.into(),
        mesh: mesh_source(&mesh)?,
        materials: materials.filled("materials", material)?,
        fixed: fixed.or(vec![], |n| n.list("selectors", self::fixed))?,
        prescribed: prescribed.or(vec![], |n| {
            n.list("prescribed displacements", self::prescribed)
        })?,
        loads: loads.or(vec![], |n| n.list("loads", load))?,
        gravity: gravity.or(default_gravity(), |n| {
            n.array("numbers", |n| {
                n.number_in("from -1e6 to 1e6", |x| x.abs() <= MOST_GRAVITY)
            })
        })?,
        start: start.or(Start::default(), Node::choice)?,
        model: model.or(ModelSettings::default(), model_settings)?,
        integration: integration.or(Integration::default(), self::integration)?,
        cutting: cutting.or(Cutting::default(), self::cutting)?,
        cuts: cuts.or(vec![], |n| n.list("cuts", cut))?,
        tearing: tearing.maybe(self::tearing)?,
        tools: tools.or(vec![], self::tools)?,
        outputs: outputs.or(Outputs::default(), self::outputs)?,
    })
}

fn is_identifier(text: &str) -> bool {
    let word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.chars().all(word) && text.starts_with(|c: char| word(c) && !c.is_ascii_digit())
}

/// Largest damping \[1/s\] and acceleration \[m/s²\]; far beyond tissue, far from overflow.
pub const MOST_DAMPING: f64 = 1e6;
pub const MOST_GRAVITY: f64 = 1e6;

/// Pa, of a volume penalty.
pub const MOST_PRESSURE: f64 = 1e12;

/// Above this a mesh is a mistake rather than a model for real time.
const MOST_CELLS: f64 = 1e7;

#[rustfmt::skip]
const MESH: [&str; 7] = ["box", "cylinder", "liver", "file", "nodes", "scale", "tetrahedra"];

fn mesh_source(node: &Node) -> Result<MeshSource> {
    let [.., scale, tetrahedra] = node.keys(MESH)?;
    let (kind, source) = node.one_of(&MESH[..5])?;
    for (key, stray, owner) in [
        ("scale", &scale, "file"),
        ("tetrahedra", &tetrahedra, "nodes"),
    ] {
        if node.has(key) && kind != owner {
            return Err(stray.wrong(
                &format!("belongs to {owner:?}, not to {kind:?}"),
                "remove it",
            ));
        }
    }
    Ok(match kind {
        "box" => {
            let [size, cells, origin, pattern] =
                source.keys(["size", "cells", "origin", "pattern"])?;
            let count = cells.array::<u32, 3>("whole numbers", |n| n.whole(1))?;
            let nodes = crate::mesh::box_mesh::node_count(count.map(|n| n as usize));
            if nodes.is_none_or(|n| n > crate::mesh::MAXIMUM_NODES) {
                return Err(cells.wrong(
                    "too many cells",
                    "must be so few that they have at most 10 million corners in all",
                ));
            }
            MeshSource::Box {
                size: size.array("numbers", |n| n.positive())?,
                cells: count.map(|n| n as usize),
                origin: origin.or([0.0; 3], Node::vector)?,
                pattern: pattern.or(BoxPattern::default(), Node::choice)?,
            }
        }
        "cylinder" => {
            let [radius, height, edge] = source.keys(["radius", "height", "edgeLength"])?;
            let (r, h, edge_length) = (radius.positive()?, height.positive()?, edge.positive()?);
            let cells = std::f64::consts::PI * (r / edge_length).powi(2) * (h / edge_length);
            if cells > MOST_CELLS {
                let least = edge_length * (cells / MOST_CELLS).cbrt();
                return Err(edge.wrong(
                    &format!("{edge_length:?} makes more than 10 million cells"),
                    &format!("must be {least:.1e} or more"),
                ));
            }
            MeshSource::Cylinder {
                radius: r,
                height: h,
                edge_length,
            }
        }
        "liver" => {
            let [edge] = source.keys(["edgeLength"])?;
            let edge = edge.or(default_liver_edge(), |n| {
                n.number_in("0.003 to 0.03", |x| {
                    crate::mesh::liver::EDGE_LENGTH.contains(&x)
                })
            });
            MeshSource::Liver { edge_length: edge? }
        }
        "file" => MeshSource::File {
            file: source
                .text(
                    "a mesh file (.msh, .vtk, .vtu, .mesh, .node or .ele)",
                    |file| {
                        let known = ["msh", "vtk", "vtu", "mesh", "node", "ele"];
                        known
                            .iter()
                            .any(|known| extension(file).eq_ignore_ascii_case(known))
                    },
                )?
                .into(),
            scale: scale.or(default_scale(), Node::positive)?,
        },
        _ => {
            let nodes = source.filled("nodes", |n| n.vector())?;
            let count = nodes.len();
            let tetrahedra = tetrahedra.filled("tetrahedra", |n| tetrahedron(n, count))?;
            MeshSource::Inline { nodes, tetrahedra }
        }
    })
}

/// Four different nodes of `count`.
fn tetrahedron(node: &Node, count: usize) -> Result<[u32; 4]> {
    let corners = node.array("node numbers", |n| match n.index()? {
        i if (i as usize) < count => Ok(i),
        i => Err(n.wrong(&format!("no node {i}"), &format!("must be below {count}"))),
    })?;
    match (0..4).find(|&k| corners[..k].contains(&corners[k])) {
        None => Ok(corners),
        Some(k) => {
            let what = format!("names node {} twice", corners[k]);
            Err(node.wrong(&what, "must be 4 different nodes"))
        }
    }
}

/// What follows the last dot of a file's name.
pub(super) fn extension(file: &str) -> &str {
    Path::new(file)
        .extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or_default()
}

/// What a selector selects where it stands.
#[derive(Clone, Copy, PartialEq)]
enum Of {
    Nodes,
    Tetrahedra,
}

#[rustfmt::skip]
const SELECTOR: [&str; 9] =
    ["all", "nodes", "tetrahedra", "box", "sphere", "halfSpace", "any", "not", "optional"];

fn selector(node: &Node, of: Of) -> Result<Selector> {
    let [.., optional] = node.keys(SELECTOR)?;
    let (kind, region) = node.one_of(&SELECTOR[..8])?;
    let region = match kind {
        "all" => match region.boolean()? {
            true => Region::All,
            false => return Err(region.expected("true")),
        },
        "nodes" => Region::Nodes(region.list("node numbers", |n| n.index())?),
        "tetrahedra" if of == Of::Nodes => {
            return Err(region.wrong(
                "selects tetrahedra where nodes are selected",
                "must be \"nodes\" or a region of space",
            ));
        }
        "tetrahedra" => Region::Tetrahedra(region.list("tetrahedron numbers", |n| n.index())?),
        "box" => {
            let [low, high] = region.keys(["min", "max"])?;
            let (min, max) = (low.vector::<3>()?, high.vector::<3>()?);
            if let Some(k) = (0..3).find(|&k| min[k] > max[k]) {
                let axis = ["x", "y", "z"][k];
                let what = format!(
                    "empty along {axis}: min {:?} is above max {:?}",
                    min[k], max[k]
                );
                return Err(region.wrong(&what, "must have min at most max along each axis"));
            }
            Region::Box { min, max }
        }
        "sphere" => {
            let [center, radius] = region.keys(["center", "radius"])?;
            Region::Sphere {
                center: center.vector()?,
                radius: radius.positive()?,
            }
        }
        "halfSpace" => {
            let [point, normal] = region.keys(["point", "normal"])?;
            Region::HalfSpace {
                point: point.vector()?,
                normal: normal.direction()?,
            }
        }
        "any" => Region::Any(region.list("selectors", |n| selector(n, of))?),
        _ => Region::Not(Box::new(selector(&region, of)?)),
    };
    Ok(Selector {
        optional: optional.or(false, Node::boolean)?,
        region,
    })
}

fn material(node: &Node) -> Result<Material> {
    let [place, young_modulus, poisson_ratio, density, fibre] =
        node.keys(["where", "youngModulus", "poissonRatio", "density", "fibre"])?;
    Ok(Material {
        selector: selector(&place, Of::Tetrahedra)?,
        young_modulus: young_modulus.positive()?,
        poisson_ratio: poisson_ratio
            .number_in("above -1 and below 0.5", |x| -1.0 < x && x < 0.5)?,
        density: density.positive()?,
        fibre: fibre.maybe(|n| {
            let [direction, lambda, mu] = n.keys(["direction", "lambda", "mu"])?;
            Ok(Fibre {
                direction: direction.direction()?,
                lambda: lambda.not_negative()?,
                mu: mu.not_negative()?,
            })
        })?,
    })
}

fn fixed(node: &Node) -> Result<Fixed> {
    node.known(&[&SELECTOR[..], &["where", "axes"]].concat())?;
    if !node.has("where") && !node.has("axes") {
        return Ok(Fixed {
            selector: selector(node, Of::Nodes)?,
            axes: [true; 3],
        });
    }
    let [place, axes] = node.keys(["where", "axes"])?;
    let axes = axes.or("xyz", |n| {
        n.text("one, two or all of x, y and z, such as \"xy\"", |axes| {
            let times = |axis| axes.matches(axis).count();
            !axes.is_empty()
                && ['x', 'y', 'z'].map(times).iter().all(|&n| n <= 1)
                && axes.chars().all(|c| "xyz".contains(c))
        })
    })?;
    Ok(Fixed {
        selector: selector(&place, Of::Nodes)?,
        axes: ['x', 'y', 'z'].map(|axis| axes.contains(axis)),
    })
}

fn prescribed(node: &Node) -> Result<Prescribed> {
    let [place, displacement, ramp] = node.keys(["where", "displacement", "ramp"])?;
    let along = displacement.array("numbers or nulls", |n| n.maybe(Node::number))?;
    if along == [None; 3] {
        return Err(displacement.wrong("leaves every axis free", "must hold a number or more"));
    }
    Ok(Prescribed {
        selector: selector(&place, Of::Nodes)?,
        displacement: along,
        ramp: ramp.or(0.0, Node::not_negative)?,
    })
}

fn load(node: &Node) -> Result<Load> {
    let [place, force, ramp] = node.keys(["where", "force", "ramp"])?;
    Ok(Load {
        selector: selector(&place, Of::Nodes)?,
        force: force.vector()?,
        ramp: ramp.or(0.0, Node::not_negative)?,
    })
}

fn model_settings(node: &Node) -> Result<ModelSettings> {
    #[rustfmt::skip]
    let [
        kind, dynamic, touchable, connection, interface_modes, interface_mass, elasticity, form, adaptive,
        nonlinear_threshold, incompressibility, element, hourglass,
    ] = node.keys([
        "kind", "dynamic", "touchable", "connection", "interfaceModes", "interfaceMass", "elasticity",
        "form", "adaptive", "nonlinearThreshold", "incompressibility", "element", "hourglass",
    ])?;
    let default = ModelSettings::default();
    let settings = ModelSettings {
        kind: kind.or(default.kind, Node::choice)?,
        touchable: touchable.maybe(|n| selector(n, Of::Nodes))?,
        dynamic: dynamic.maybe(|n| selector(n, Of::Tetrahedra))?,
        connection: connection.or(default.connection.clone(), |n| match n.is_object() {
            true => {
                let [nodes] = n.keys(["nodes"])?;
                Ok(Connection::Nodes(
                    nodes.list("node numbers", |n| n.index())?,
                ))
            }
            false if n.is_text("full") => Ok(Connection::Full),
            false => Err(n.expected("\"full\" or {\"nodes\": [..]}")),
        })?,
        interface_modes: interface_modes.maybe(|n| Ok(n.whole(0)? as usize))?,
        interface_mass: interface_mass.or(default.interface_mass, Node::choice)?,
        elasticity: elasticity.or(default.elasticity, Node::choice)?,
        form: form.or(default.form, Node::choice)?,
        adaptive: adaptive.or(default.adaptive, Node::choice)?,
        nonlinear_threshold: nonlinear_threshold
            .or(default.nonlinear_threshold, Node::not_negative)?,
        incompressibility: incompressibility.or(default.incompressibility, |n| {
            match n.is_number() {
                true => Ok(Incompressibility::Pressure(
                    n.number_in("0 to 1e12", |x| (0.0..=MOST_PRESSURE).contains(&x))?,
                )),
                false if n.is_text("bulkModulus") => Ok(Incompressibility::BulkModulus),
                false => Err(n.expected("a number 0 or more or \"bulkModulus\"")),
            }
        })?,
        element: element.maybe(Node::choice)?,
        hourglass: hourglass.or(default.hourglass, |n| {
            n.number_in("0.2 or more", |c| c >= 0.2)
        })?,
    };
    let hybrid = settings.kind == ModelKind::Hybrid;
    if hybrid && settings.dynamic.is_none() {
        return Err(kind.wrong(
            "names no dynamic part",
            "must stand beside \"dynamic\": SELECTOR",
        ));
    }
    let precomputed = hybrid || settings.kind == ModelKind::QuasiStatic;
    let (of_hybrid, of_both) = ("\"hybrid\"", "\"hybrid\" or \"quasiStatic\"");
    let misplaced = [
        (!hybrid && settings.dynamic.is_some(), &dynamic, of_hybrid),
        (
            !hybrid && settings.connection != default.connection,
            &connection,
            of_hybrid,
        ),
        (
            !hybrid && settings.interface_modes.is_some(),
            &interface_modes,
            of_hybrid,
        ),
        (
            !hybrid && settings.interface_mass != default.interface_mass,
            &interface_mass,
            of_hybrid,
        ),
        (
            !precomputed && settings.touchable.is_some(),
            &touchable,
            of_both,
        ),
    ];
    match misplaced.into_iter().find(|(wrong, ..)| *wrong) {
        Some((_, key, kind)) => Err(key.wrong(
            "belongs to another kind of model",
            &format!("must stand beside \"kind\": {kind}"),
        )),
        None => Ok(settings),
    }
}

fn integration(node: &Node) -> Result<Integration> {
    let [scheme, haptic_rate, substep, damping, mass] =
        node.keys(["scheme", "hapticRate", "substep", "damping", "mass"])?;
    let default = Integration::default();
    let rate = haptic_rate.or(default.haptic_rate, |n| {
        n.number_in("from 1 to 100000", |x| (1.0..=1e5).contains(&x))
    })?;
    Ok(Integration {
        scheme: scheme.maybe(Node::choice)?,
        haptic_rate: rate,
        substep: substep.maybe(|n| whole_divisor(n, 1.0 / rate))?,
        damping: damping.maybe(|n| {
            n.not_negative()?;
            n.number_in("at most 1e6", |x| x <= MOST_DAMPING)
        })?,
        mass: mass.or(default.mass, Node::choice)?,
    })
}

/// A substep \[s\]: n of them make the haptic period, within 1e-9.
fn whole_divisor(node: &Node, period: f64) -> Result<f64> {
    let substep = node.positive()?;
    let count = period / substep;
    let what = match count {
        ..1.0 => "is longer than",
        1e6.. => "is less than a millionth of",
        _ => "does not divide",
    };
    if (count - count.round()).abs() <= 1e-9 * count && (0.5..=1e6).contains(&count) {
        return Ok(substep);
    }
    let n = count.clamp(1.0, 1e6).ceil();
    let near = period / n;
    Err(node.wrong(
        &format!("{substep:?} {what} the haptic period {period:?}"),
        &format!("must be that over a whole number n, such as {near:?} (n = {n})"),
    ))
}

fn cutting(node: &Node) -> Result<Cutting> {
    let [rule, mass, spare] = node.keys(["rule", "mass", "spareVertices"])?;
    Ok(Cutting {
        rule: rule.or(CutRule::default(), Node::choice)?,
        mass: mass.or(CutMass::default(), Node::choice)?,
        spare_vertices: spare.maybe(|n| Ok(n.whole(1)? as usize))?,
    })
}

fn cut(node: &Node) -> Result<Cut> {
    let [time, place] = node.keys(["time", "where"])?;
    Ok(Cut {
        time: time.not_negative()?,
        selector: selector(&place, Of::Tetrahedra)?,
    })
}

fn tearing(node: &Node) -> Result<Tearing> {
    let [criterion, threshold, budget] = node.keys(["criterion", "threshold", "budget"])?;
    Ok(Tearing {
        criterion: criterion.choice()?,
        threshold: threshold.positive()?,
        budget: budget.or(default_budget(), |n| Ok(n.whole(1)? as usize))?,
    })
}

fn tools(node: &Node) -> Result<Vec<Tool>> {
    let seen = std::cell::RefCell::new(Vec::<String>::new());
    node.list("tools", |n| {
        let tool = tool(n)?;
        let mut seen = seen.borrow_mut();
        if let Some(first) = seen.iter().position(|name| *name == tool.name) {
            let [name, ..] = n.keys(TOOL)?;
            let what = format!("{:?} is the name of tools[{first}] too", tool.name);
            return Err(name.wrong(&what, "must be unique"));
        }
        seen.push(tool.name.clone());
        Ok(tool)
    })
}

#[rustfmt::skip]
const TOOL: [&str; 8] =
    ["name", "kind", "shape", "activeLength", "friction", "slipForce", "position", "orientation"];

fn tool(node: &Node) -> Result<Tool> {
    let [
        name,
        kind,
        shape,
        active_length,
        friction,
        slip_force,
        position,
        orientation,
    ] = node.keys(TOOL)?;
    Ok(Tool {
        name: name
            .text("a string, not empty", |name| !name.is_empty())?
            .into(),
        kind: kind.choice()?,
        shape: self::shape(&shape)?,
        active_length: active_length.maybe(Node::positive)?,
        friction: friction.or(Friction::Stick, |n| match n.is_number() {
            true => Ok(Friction::Coulomb(n.not_negative()?)),
            false if n.is_text("stick") => Ok(Friction::Stick),
            false => Err(n.expected("\"stick\" or a number 0 or more")),
        })?,
        slip_force: slip_force.maybe(Node::positive)?,
        position: position.vector()?,
        orientation: orientation.or(default_orientation(), quaternion)?,
    })
}

fn shape(node: &Node) -> Result<Shape> {
    node.known(&["sphere", "capsule", "compound"])?;
    Ok(match node.one_of(&["sphere", "capsule", "compound"])? {
        ("sphere", n) => {
            let [radius] = n.keys(["radius"])?;
            Shape::Sphere {
                radius: radius.positive()?,
            }
        }
        ("capsule", n) => {
            let [radius, length] = n.keys(["radius", "length"])?;
            Shape::Capsule {
                radius: radius.positive()?,
                length: length.positive()?,
            }
        }
        (_, n) => Shape::Compound(n.filled("shapes", part)?),
    })
}

fn part(node: &Node) -> Result<Part> {
    let [shape, position, orientation] = node.keys(["shape", "position", "orientation"])?;
    Ok(Part {
        shape: self::shape(&shape)?,
        position: position.or([0.0; 3], Node::vector)?,
        orientation: orientation.or(default_orientation(), quaternion)?,
    })
}

/// w x y z, normalised; left as it is when it is a unit quaternion to rounding, so that reading is idempotent.
fn quaternion(node: &Node) -> Result<[f64; 4]> {
    let q = node.vector::<4>()?;
    let square = |q: [f64; 4]| q.map(|x| x * x).iter().sum::<f64>();
    let largest = q.iter().fold(0.0_f64, |largest, x| largest.max(x.abs()));
    if largest == 0.0 {
        return Err(node.wrong(
            "has length 0",
            "must be a quaternion w x y z, such as [1, 0, 0, 0]",
        ));
    }
    if (square(q) - 1.0).abs() < 1e-14 {
        return Ok(q);
    }
    let scaled = q.map(|x| x / largest);
    let length = square(scaled).sqrt();
    Ok(scaled.map(|x| x / length))
}

fn outputs(node: &Node) -> Result<Outputs> {
    let [vertices, causality, triangles] = node.keys(["vertices", "causality", "triangles"])?;
    Ok(Outputs {
        vertices: vertices.or(OutputVertices::default(), Node::choice)?,
        causality: causality.or(OutputCausality::default(), Node::choice)?,
        triangles: triangles.or(false, Node::boolean)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What [`refuse`] would not let through today.
    const LATER: &str = r#"{
        "name": "_later2",
        "mesh": {"file": "liver.vtk", "scale": 0.001},
        "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060,
            "fibre": {"direction": [0, 0, 0.1], "lambda": 8e4, "mu": 0}}],
        "model": {"kind": "hybrid", "dynamic": {"box": {"min": [0, 0, 0], "max": [1, 1, 0]}},
            "connection": {"nodes": [4, 2]}, "interfaceModes": 12, "interfaceMass": "guyan",
            "elasticity": "stableNeoHookean", "form": "polynomial", "adaptive": "perVertex",
            "nonlinearThreshold": 0.003, "incompressibility": 1e5, "element": "nodalPressure", "hourglass": 0.2},
        "integration": {"scheme": "centralDifference"},
        "cutting": {"rule": "duplicate"},
        "tearing": {"criterion": "maximumElongation", "threshold": 0.35},
        "tools": [{"name": "hook", "kind": "probe", "friction": 0.3, "slipForce": 2, "position": [0, 0, 0], "shape":
            {"compound": [{"shape": {"sphere": {"radius": 0.1}}},
                {"shape": {"compound": [{"shape": {"capsule": {"radius": 1, "length": 2}}}]},
                    "position": [1, 2, 3], "orientation": [0.3, -0.2, 0.7, 0.1]}]}}]
    }"#;

    #[test]
    fn the_whole_contract_is_read_and_written_back() {
        let scene = whole_contract(LATER).unwrap();
        assert_eq!(scene.model.connection, Connection::Nodes(vec![4, 2]));
        assert_eq!(scene.tearing.as_ref().unwrap().budget, 4);
        assert_eq!(scene.tools[0].friction, Friction::Coulomb(0.3));
        let text = serde_json::to_string(&scene).unwrap();
        assert_eq!(whole_contract(&text).unwrap(), scene, "{text}");
        assert!(refuse(&scene).is_err());
    }

    #[test]
    fn a_byte_order_mark_is_ignored() {
        assert_eq!(
            whole_contract(&format!("\u{feff}{LATER}")),
            whole_contract(LATER)
        );
    }

    #[test]
    fn quaternions_are_normalised_once() {
        for q in [
            "[1e-200, 2e-200, 0, 0]",
            "[3e300, -1e300, 1, 7]",
            "[0.1, 0.2, 0.3, 0.4]",
            "[5e-324, 0, 0, 0]",
        ] {
            let read = |text: &str| quaternion(&Node::root(&tree(text).unwrap())).unwrap();
            let once = read(q);
            assert!((once.map(|x| x * x).iter().sum::<f64>() - 1.0).abs() < 1e-14);
            assert_eq!(read(&serde_json::to_string(&once).unwrap()), once);
        }
    }
}
