//! What a user reads when a scene is wrong: the whole line, for each mistake.

use std::path::Path;

use serde_json::{Value, json};
use tissue::mesh::{TetMesh, Vec3};
use tissue::scene::*;

/// Says everything that this version can do and a box mesh allows.
const PLATE: &str = r#"{
  "$schema": "scene.schema.json",
  "name": "plate",
  "description": "A plate \"of tissue\".",
  "mesh": {"box": {"size": [0.22, 0.1, 0.02], "cells": [22, 10, 2], "origin": [0, -0.05, 0], "pattern": "kuhn"}},
  "materials": [
    {"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060, "fibre": null},
    {"where": {"tetrahedra": [0, 7], "optional": true}, "youngModulus": 1e4, "poissonRatio": -0.2, "density": 999.9}
  ],
  "fixed": [
    {"nodes": [0, 1, 2]},
    {"where": {"box": {"min": [0, 0, 0], "max": [0, 0.1, 0.02]}}, "axes": "zx"}
  ],
  "prescribed": [{"where": {"sphere": {"center": [0.2, 0.05, 0.01], "radius": 0.02}}, "displacement": [0, null, -0.002], "ramp": 0.5}],
  "loads": [{"where": {"any": [{"nodes": [5]}, {"not": {"halfSpace": {"point": [0, 0, 0], "normal": [0, 0, 3]}}}]}, "force": [0, 0, -0.5], "ramp": 0.1}],
  "gravity": [0, 0.1, -3.7],
  "start": "equilibrium",
  "model": {"kind": "tensorMass", "dynamic": null, "connection": "full", "interfaceModes": null, "interfaceMass": "lumped",
    "elasticity": "linear", "form": "perTetrahedron", "adaptive": "blend", "nonlinearThreshold": 0.0, "incompressibility": 0,
    "element": "constantStrain", "hourglass": 0.25},
  "integration": {"scheme": "symplecticEuler", "hapticRate": 500, "substep": 0.0001, "damping": 3.25, "mass": "uniform"},
  "cutting": {"rule": "remove", "mass": "kept"},
  "cuts": [{"time": 0.5, "where": {"sphere": {"center": [0.1, 0, 0], "radius": 0.01}}}],
  "tearing": null,
  "tools": [
    {"name": "grasper", "kind": "grasper", "shape": {"capsule": {"radius": 0.003, "length": 0.3}}, "activeLength": 0.006,
      "friction": "stick", "slipForce": null, "position": [0, 0, 0.2], "orientation": [1, 2, 3, 4]},
    {"name": "knife", "kind": "cautery", "shape": {"sphere": {"radius": 0.003}}, "position": [0, 0, 0.3]}
  ],
  "outputs": {"vertices": "all", "causality": "local", "triangles": true}
}"#;

const LEAST: &str = r#"{"name": "plate",
  "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
  "materials": [{"where": {"all": true}, "youngModulus": 1, "poissonRatio": 0, "density": 1}]}"#;

/// The plate with one value set (made, where it was not there), or taken away where `value` is empty.
fn edited(pointer: &str, value: &str) -> String {
    let mut scene: Value = serde_json::from_str(PLATE).unwrap();
    let (parent, key) = pointer.rsplit_once('/').unwrap_or_default();
    let value = (!value.is_empty()).then(|| serde_json::from_str(value).unwrap());
    match (scene.pointer_mut(parent).unwrap(), value) {
        (Value::Object(object), Some(value)) => _ = object.insert(key.into(), value),
        (Value::Object(object), None) => _ = object.remove(key).unwrap(),
        (Value::Array(items), Some(value)) => items[key.parse::<usize>().unwrap()] = value,
        _ => unreachable!(),
    }
    scene.to_string()
}

fn line(text: &str) -> String {
    parse(text, "plate.json").expect_err(text).to_string()
}

#[test]
fn what_is_gathered_is_not_split() {
    let model = r#"{"elasticity": "stVenantKirchhoff", "form": "polynomial"}"#;
    let mut scene: Value = serde_json::from_str(&edited("/model", model)).unwrap();
    scene["cutting"]["rule"] = "duplicate".into();
    scene["integration"]["mass"] = "lumped".into();
    assert_eq!(
        line(&scene.to_string()),
        "plate.json: cutting.rule: duplicate with polynomial is not available in this version; use remove"
    );
}

#[test]
fn each_mistake_has_its_line() {
    #[rustfmt::skip]
    let table = [
        ("/gravty", "[0,0,0]", r#"gravty: unknown key "gravty"; did you mean "gravity"?"#),
        ("/nme", r#""x""#, r#"nme: unknown key "nme"; did you mean "name"?"#),
        ("/materials/0/youngsModulus", "1", r#"materials[0].youngsModulus: unknown key "youngsModulus"; did you mean "youngModulus"?"#),
        ("/materials/0/young_modulus", "1", r#"materials[0].young_modulus: unknown key "young_modulus"; did you mean "youngModulus"?"#),
        ("/materials/0/smell", "1", r#"materials[0].smell: unknown key "smell"; did you mean "where"? known here: "where", "youngModulus", "poissonRatio", "density" and "fibre""#),
        ("/materials/0/where/al", "true", r#"materials[0].where.al: unknown key "al"; did you mean "all"?"#),
        ("/fixed/0/nods", "[1]", r#"fixed[0].nods: unknown key "nods"; did you mean "nodes"?"#),
        ("/fixed/0/wher", "{}", r#"fixed[0].wher: unknown key "wher"; did you mean "where"?"#),
        ("/fixed/1/axis", r#""x""#, r#"fixed[1].axis: unknown key "axis"; did you mean "axes"?"#),
        ("/fixed/1/where/box/mim", "[0,0,0]", r#"fixed[1].where.box.mim: unknown key "mim"; did you mean "min"?"#),
        ("/loads/0/where/any/1/not/halfSpace/centre", "[0,0,0]", r#"loads[0].where.any[1].not.halfSpace.centre: unknown key "centre"; did you mean "point"? known here: "point" and "normal""#),
        ("/tools/0/shape/capsule/lenght", "1", r#"tools[0].shape.capsule.lenght: unknown key "lenght"; did you mean "length"?"#),
        ("/tools/1/shape/box", "{}", r#"tools[1].shape.box: unknown key "box"; did you mean "sphere"? known here: "sphere", "capsule" and "compound""#),
        ("/tools/1/colour\nof it", "1", r#"tools[1]["colour\nof it"]: unknown key "colour\nof it"; did you mean "slipForce"? known here: "name", "kind", "shape", "activeLength", "friction", "slipForce", "position" and "orientation""#),
        ("/integration/hapticrate", "1", r#"integration.hapticrate: unknown key "hapticrate"; did you mean "hapticRate"?"#),
        ("/mesh/box/cell", "[1,1,1]", r#"mesh.box.cell: unknown key "cell"; did you mean "cells"?"#),
        ("/name", "", "name: missing; must be a name of letters, digits and _, not starting with a digit"),
        ("/mesh", "", r#"mesh: missing; must be an object with keys among "box", "cylinder", "liver", "file", "nodes", "scale" and "tetrahedra""#),
        ("/materials", "", "materials: missing; must be a list of materials"),
        ("/materials/0/density", "", "materials[0].density: missing; must be a number above 0"),
        ("/materials/0/where", "", r#"materials[0].where: missing; must be an object with keys among "all", "nodes", "tetrahedra", "box", "sphere", "halfSpace", "any", "not" and "optional""#),
        ("/materials/0/where/all", "", r#"materials[0].where: holds none; must hold exactly one of "all", "nodes", "tetrahedra", "box", "sphere", "halfSpace", "any" and "not""#),
        ("/tools/0/kind", "", r#"tools[0].kind: missing; must be "probe", "grasper" or "cautery""#),
        ("/tools/1/position", "", "tools[1].position: missing; must be a list of 3 numbers"),
        ("/tools/0/shape", "", r#"tools[0].shape: missing; must be an object with keys among "sphere", "capsule" and "compound""#),
        ("/cuts/0/time", "", "cuts[0].time: missing; must be a number 0 or more"),
        ("/prescribed/0/displacement", "", "prescribed[0].displacement: missing; must be a list of 3 numbers or nulls"),
        ("/mesh/box/cells", "", "mesh.box.cells: missing; must be a list of 3 whole numbers"),
        ("/name", r#""2plates""#, r#"name: found the string "2plates"; must be a name of letters, digits and _, not starting with a digit"#),
        ("/name", r#""plate-2""#, r#"name: found the string "plate-2"; must be a name of letters, digits and _, not starting with a digit"#),
        ("/name", r#""""#, r#"name: found the string ""; must be a name of letters, digits and _, not starting with a digit"#),
        ("/name", "7", "name: found the number 7; must be a name of letters, digits and _, not starting with a digit"),
        ("/mesh", "{}", r#"mesh: holds none; must hold exactly one of "box", "cylinder", "liver", "file" and "nodes""#),
        ("/mesh", r#""box""#, r#"mesh: found the string "box"; must be an object with keys among "box", "cylinder", "liver", "file", "nodes", "scale" and "tetrahedra""#),
        ("/mesh/liver", "{}", r#"mesh: holds both "box" and "liver"; must hold exactly one of "box", "cylinder", "liver", "file" and "nodes""#),
        ("/mesh/scale", "2", r#"mesh.scale: belongs to "file", not to "box"; remove it"#),
        ("/mesh", r#"{"tetrahedra": [[0, 1, 2, 3]]}"#, r#"mesh: holds none; must hold exactly one of "box", "cylinder", "liver", "file" and "nodes""#),
        ("/mesh", r#"{"liver": {"edgeLength": 0.0001}}"#, "mesh.liver.edgeLength: 0.0001 is out of range; must be 0.003 to 0.03"),
        ("/mesh", r#"{"cylinder": {"radius": 0.02, "height": 0.1, "edgeLength": 1e-6}}"#, "mesh.cylinder.edgeLength: 1e-6 makes more than 10 million cells; must be 2.3e-4 or more"),
        ("/mesh", r#"{"cylinder": {"radius": 0, "height": 0.1, "edgeLength": 0.01}}"#, "mesh.cylinder.radius: 0 is out of range; must be above 0"),
        ("/mesh", r#"{"file": "liver.stl"}"#, r#"mesh.file: found the string "liver.stl"; must be a mesh file (.msh, .vtk, .vtu, .mesh, .node or .ele)"#),
        ("/mesh", r#"{"file": "liver.msh", "scale": 0}"#, "mesh.scale: 0 is out of range; must be above 0"),
        ("/mesh/box/size", "[0.22, 0, 0.02]", "mesh.box.size[1]: 0 is out of range; must be above 0"),
        ("/mesh/box/size", "0.22", "mesh.box.size: found the number 0.22; must be a list of 3 numbers"),
        ("/mesh/box/cells", "[22, 0, 2]", "mesh.box.cells[1]: found the number 0; must be a whole number, 1 or more"),
        ("/mesh/box/cells", "[22, 1.5, 2]", "mesh.box.cells[1]: found the number 1.5; must be a whole number, 1 or more"),
        ("/mesh/box/cells", "[1000, 1000, 11]", "mesh.box.cells: too many cells; must be so few that they have at most 10 million corners in all"),
        ("/mesh/box/pattern", r#""six""#, r#"mesh.box.pattern: unknown value "six"; did you mean "five"? must be "five" or "kuhn""#),
        ("/materials", "[]", "materials: found an empty list; must be a list of materials, at least one"),
        ("/materials", "{}", "materials: found an object; must be a list of materials"),
        ("/materials/0", "[1]", r#"materials[0]: found a list of 1; must be an object with keys among "where", "youngModulus", "poissonRatio", "density" and "fibre""#),
        ("/materials/0/youngModulus", "0", "materials[0].youngModulus: 0 is out of range; must be above 0"),
        ("/materials/0/youngModulus", r#""soft""#, r#"materials[0].youngModulus: found the string "soft"; must be a number above 0"#),
        ("/materials/0/youngModulus", "null", "materials[0].youngModulus: found null; must be a number above 0"),
        ("/materials/0/poissonRatio", "0.6", "materials[0].poissonRatio: 0.6 is out of range; must be above -1 and below 0.5"),
        ("/materials/0/poissonRatio", "-1", "materials[0].poissonRatio: -1 is out of range; must be above -1 and below 0.5"),
        ("/materials/1/density", "-1060", "materials[1].density: -1060 is out of range; must be above 0"),
        ("/materials/0/where/all", "false", "materials[0].where.all: found false; must be true"),
        ("/materials/0/where/optional", "1", "materials[0].where.optional: found the number 1; must be true or false"),
        ("/materials/0/where", r#""all""#, r#"materials[0].where: found the string "all"; must be an object with keys among "all", "nodes", "tetrahedra", "box", "sphere", "halfSpace", "any", "not" and "optional""#),
        ("/fixed/0/nodes", "[0, -1]", "fixed[0].nodes[1]: found the number -1; must be a whole number, 0 or more"),
        ("/fixed/0/nodes", "[0, 1.5]", "fixed[0].nodes[1]: found the number 1.5; must be a whole number, 0 or more"),
        ("/fixed/0/nodes", "[0, 4294967296]", "fixed[0].nodes[1]: found the number 4294967296; must be a whole number, 4294967295 or less"),
        ("/fixed/0/nodes", "3", "fixed[0].nodes: found the number 3; must be a list of node numbers"),
        ("/fixed/0/all", "true", r#"fixed[0]: holds both "all" and "nodes"; must hold exactly one of "all", "nodes", "tetrahedra", "box", "sphere", "halfSpace", "any" and "not""#),
        ("/fixed/0", r#"{"tetrahedra": [1]}"#, r#"fixed[0].tetrahedra: selects tetrahedra where nodes are selected; must be "nodes" or a region of space"#),
        ("/fixed/1/where", r#"{"any": [{"tetrahedra": [1]}]}"#, r#"fixed[1].where.any[0].tetrahedra: selects tetrahedra where nodes are selected; must be "nodes" or a region of space"#),
        ("/prescribed/0/where", r#"{"not": {"tetrahedra": [1]}}"#, r#"prescribed[0].where.not.tetrahedra: selects tetrahedra where nodes are selected; must be "nodes" or a region of space"#),
        ("/loads/0/where", r#"{"tetrahedra": [1]}"#, r#"loads[0].where.tetrahedra: selects tetrahedra where nodes are selected; must be "nodes" or a region of space"#),
        ("/fixed/1/axes", r#""xw""#, r#"fixed[1].axes: found the string "xw"; must be one, two or all of x, y and z, such as "xy""#),
        ("/fixed/1/axes", r#""""#, r#"fixed[1].axes: found the string ""; must be one, two or all of x, y and z, such as "xy""#),
        ("/fixed/1/axes", r#""xx""#, r#"fixed[1].axes: found the string "xx"; must be one, two or all of x, y and z, such as "xy""#),
        ("/fixed/1/axes", r#"["x"]"#, r#"fixed[1].axes: found a list of 1; must be one, two or all of x, y and z, such as "xy""#),
        ("/fixed/1/where", "", r#"fixed[1].where: missing; must be an object with keys among "all", "nodes", "tetrahedra", "box", "sphere", "halfSpace", "any", "not" and "optional""#),
        ("/fixed/1/where/box/min", "[0, 0.2, 0]", "fixed[1].where.box: empty along y: min 0.2 is above max 0.1; must have min at most max along each axis"),
        ("/prescribed/0/where/sphere/radius", "0", "prescribed[0].where.sphere.radius: 0 is out of range; must be above 0"),
        ("/prescribed/0/where/sphere/center", "[0, 0]", "prescribed[0].where.sphere.center: found a list of 2; must be a list of 3 numbers"),
        ("/loads/0/where/any/1/not/halfSpace/normal", "[0, 0, 0]", "loads[0].where.any[1].not.halfSpace.normal: has length 0; must point somewhere, such as [0, 0, 1]"),
        ("/prescribed/0/displacement", "[null, null, null]", "prescribed[0].displacement: leaves every axis free; must hold a number or more"),
        ("/prescribed/0/displacement", r#"[0, "free", 0]"#, r#"prescribed[0].displacement[1]: found the string "free"; must be a number"#),
        ("/prescribed/0/ramp", "-1", "prescribed[0].ramp: -1 is out of range; must be 0 or more"),
        ("/loads/0/force", r#"[0, 0, "down"]"#, r#"loads[0].force[2]: found the string "down"; must be a number"#),
        ("/loads/0/force", "[0, 0, -1, 0]", "loads[0].force: found a list of 4; must be a list of 3 numbers"),
        ("/loads/0/ramp", "-0.5", "loads[0].ramp: -0.5 is out of range; must be 0 or more"),
        ("/gravity", "-9.81", "gravity: found the number -9.81; must be a list of 3 numbers"),
        ("/gravity", "[0, 0]", "gravity: found a list of 2; must be a list of 3 numbers"),
        ("/start", r#""statics""#, r#"start: unknown value "statics"; did you mean "rest"? must be "rest" or "equilibrium""#),
        ("/start", r#""equilibrum""#, r#"start: unknown value "equilibrum"; did you mean "equilibrium"? must be "rest" or "equilibrium""#),
        ("/start", "null", r#"start: found null; must be "rest" or "equilibrium""#),
        ("/model/kind", r#""hybird""#, r#"model.kind: unknown value "hybird"; did you mean "hybrid"? must be "quasiStatic", "tensorMass", "hybrid" or "springMass""#),
        ("/model/connection", r#""ful""#, r#"model.connection: found the string "ful"; must be "full" or {"nodes": [..]}"#),
        ("/model/interfaceModes", "-1", "model.interfaceModes: found the number -1; must be a whole number, 0 or more"),
        ("/model/elasticity", "3", r#"model.elasticity: found the number 3; must be "linear", "stVenantKirchhoff" or "stableNeoHookean""#),
        ("/model/nonlinearThreshold", "-1", "model.nonlinearThreshold: -1 is out of range; must be 0 or more"),
        ("/model/incompressibility", "-1", "model.incompressibility: -1 is out of range; must be 0 to 1e12"),
        ("/model/hourglass", "0.1", "model.hourglass: 0.1 is out of range; must be 0.2 or more"),
        ("/integration/scheme", r#""implicit""#, r#"integration.scheme: unknown value "implicit"; did you mean "implicitEuler"? must be "symplecticEuler", "euler", "rungeKutta4", "centralDifference" or "implicitEuler""#),
        ("/integration/hapticRate", "0.5", "integration.hapticRate: 0.5 is out of range; must be from 1 to 100000"),
        ("/integration/hapticRate", "1e6", "integration.hapticRate: 1000000.0 is out of range; must be from 1 to 100000"),
        ("/integration/substep", "0", "integration.substep: 0 is out of range; must be above 0"),
        ("/integration/substep", "0.005", "integration.substep: 0.005 is longer than the haptic period 0.002; must be that over a whole number n, such as 0.002 (n = 1)"),
        ("/integration/substep", "0.0003", "integration.substep: 0.0003 does not divide the haptic period 0.002; must be that over a whole number n, such as 0.00028571428571428574 (n = 7)"),
        ("/integration/substep", "1e-12", "integration.substep: 1e-12 is less than a millionth of the haptic period 0.002; must be that over a whole number n, such as 2e-9 (n = 1000000)"),
        ("/integration/substep", "1e-320", "integration.substep: 1e-320 is less than a millionth of the haptic period 0.002; must be that over a whole number n, such as 2e-9 (n = 1000000)"),
        ("/integration/damping", "-1", "integration.damping: -1 is out of range; must be 0 or more"),
        ("/cutting/rule", r#""removed""#, r#"cutting.rule: unknown value "removed"; did you mean "remove"? must be "remove" or "duplicate""#),
        ("/cutting/mass", r#""remove""#, r#"cutting.mass: unknown value "remove"; did you mean "removed"? must be "removed" or "kept""#),
        ("/cuts/0/time", "-0.1", "cuts[0].time: -0.1 is out of range; must be 0 or more"),
        ("/cuts", r#"{"time": 1}"#, "cuts: found an object; must be a list of cuts"),
        ("/tearing", r#"{"criterion": "elongation", "threshold": 0.3}"#, r#"tearing.criterion: unknown value "elongation"; did you mean "meanElongation"? must be "volume", "meanElongation" or "maximumElongation""#),
        ("/tearing", r#"{"criterion": "volume", "threshold": 0}"#, "tearing.threshold: 0 is out of range; must be above 0"),
        ("/tearing", r#"{"criterion": "volume", "threshold": 0.3, "budget": 0}"#, "tearing.budget: found the number 0; must be a whole number, 1 or more"),
        ("/tools/0/name", r#""knife""#, r#"tools[1].name: "knife" is the name of tools[0] too; must be unique"#),
        ("/tools/0/name", r#""""#, r#"tools[0].name: found the string ""; must be a string, not empty"#),
        ("/tools/0/kind", r#""grapser""#, r#"tools[0].kind: unknown value "grapser"; did you mean "grasper"? must be "probe", "grasper" or "cautery""#),
        ("/tools/1/shape/sphere/radius", "-0.003", "tools[1].shape.sphere.radius: -0.003 is out of range; must be above 0"),
        ("/tools/0/shape/capsule/length", "0", "tools[0].shape.capsule.length: 0 is out of range; must be above 0"),
        ("/tools/0/shape/sphere", r#"{"radius": 1}"#, r#"tools[0].shape: holds both "sphere" and "capsule"; must hold exactly one of "sphere", "capsule" and "compound""#),
        ("/tools/0/shape", "{}", r#"tools[0].shape: holds none; must hold exactly one of "sphere", "capsule" and "compound""#),
        ("/tools/0/shape", r#"{"compound": []}"#, "tools[0].shape.compound: found an empty list; must be a list of shapes, at least one"),
        ("/tools/0/activeLength", "0", "tools[0].activeLength: 0 is out of range; must be above 0"),
        ("/tools/0/friction", "-0.1", "tools[0].friction: -0.1 is out of range; must be 0 or more"),
        ("/tools/0/friction", r#""slip""#, r#"tools[0].friction: found the string "slip"; must be "stick" or a number 0 or more"#),
        ("/tools/0/slipForce", "0", "tools[0].slipForce: 0 is out of range; must be above 0"),
        ("/tools/0/orientation", "[0, 0, 0, 0]", "tools[0].orientation: has length 0; must be a quaternion w x y z, such as [1, 0, 0, 0]"),
        ("/tools/0/orientation", "[0, 0, 1]", "tools[0].orientation: found a list of 3; must be a list of 4 numbers"),
        ("/outputs/vertices", r#""surfaces""#, r#"outputs.vertices: unknown value "surfaces"; did you mean "surface"? must be "surface", "all" or "none""#),
        ("/outputs/triangles", r#""yes""#, r#"outputs.triangles: found the string "yes"; must be true or false"#),
        ("/model/kind", r#""hybrid""#, r#"model.kind: names no dynamic part; must stand beside "dynamic": SELECTOR"#),
        ("/model/dynamic", r#"{"all": true}"#, r#"model.dynamic: belongs to another kind of model; must stand beside "kind": "hybrid""#),
        ("/model/connection", r#"{"nodes": [1, 2]}"#, r#"model.connection: belongs to another kind of model; must stand beside "kind": "hybrid""#),
        ("/model/interfaceModes", "10", r#"model.interfaceModes: belongs to another kind of model; must stand beside "kind": "hybrid""#),
        ("/model/interfaceMass", r#""guyan""#, r#"model.interfaceMass: belongs to another kind of model; must stand beside "kind": "hybrid""#),
        ("/model/touchable", r#"{"all": true}"#, r#"model.touchable: belongs to another kind of model; must stand beside "kind": "hybrid" or "quasiStatic""#),
        ("/model/kind", r#""springMass""#, "start: equilibrium with springMass is not available in this version; use rest"),
        ("/model", r#"{"elasticity": "stVenantKirchhoff", "kind": "springMass"}"#, "model.elasticity: springMass has a law of its own; must be linear"),
        ("/model", r#"{"elasticity": "stVenantKirchhoff", "kind": "quasiStatic"}"#, "model.elasticity: what is pre-computed is linear; quasiStatic must have linear"),
        ("/model/form", r#""polynomial""#, "model.form: polynomial needs stVenantKirchhoff; must be perTetrahedron with linear"),
        ("/model", r#"{"elasticity": "stableNeoHookean", "form": "polynomial"}"#, "model.form: polynomial needs stVenantKirchhoff; must be perTetrahedron with stableNeoHookean"),
        ("/model", r#"{"elasticity": "stVenantKirchhoff", "form": "polynomial", "element": "nodalAveraged"}"#, "model.element: nodalAveraged has no polynomial form; must be constantStrain"),
        ("/model/adaptive", r#""perVertex""#, "model.adaptive: perVertex needs model.nonlinearThreshold above 0"),
        ("/model/nonlinearThreshold", "0.001", "model.nonlinearThreshold: has no law beyond it; needs model.elasticity stVenantKirchhoff or stableNeoHookean"),
        ("/model", r#"{"elasticity": "stVenantKirchhoff", "nonlinearThreshold": 0.001, "element": "nodalAveraged"}"#, "model.element: nodalAveraged knows no threshold; must be constantStrain with model.nonlinearThreshold"),
        ("/model", r#"{"elasticity": "stVenantKirchhoff", "nonlinearThreshold": 0.001, "incompressibility": 1000}"#, "model.incompressibility: a volume penalty with a non-linear threshold is not available in this version; use 0"),
        ("/model/incompressibility", "1000", "model.incompressibility: measures volumes of large deformation; needs model.elasticity stVenantKirchhoff or stableNeoHookean"),
        ("/model/incompressibility", r#""water""#, r#"model.incompressibility: found the string "water"; must be a number 0 or more or "bulkModulus""#),
        ("/model", r#"{"elasticity": "stVenantKirchhoff", "form": "polynomial", "nonlinearThreshold": 0.001}"#, "model.form: polynomial with a non-linear threshold is not available in this version; use perTetrahedron"),
        ("/model", r#"{"elasticity": "stVenantKirchhoff", "form": "polynomial", "incompressibility": 1000}"#, "model.incompressibility: a volume penalty with polynomial is not available in this version; use 0"),
        ("/model", r#"{"kind": "springMass", "element": "nodalAveraged"}"#, "model.element: springMass has edges alone; must be constantStrain"),
        ("/integration/damping", "2e6", "integration.damping: 2000000.0 is out of range; must be at most 1e6"),
        ("/gravity", "[0, 0, -1e9]", "gravity[2]: -1000000000.0 is out of range; must be from -1e6 to 1e6"),
        ("/mesh", r#"{"box": {"size": [1, 1, 1], "cells": [3000000, 1, 1]}}"#, "mesh.box.cells: too many cells; must be so few that they have at most 10 million corners in all"),
        ("/cutting/rule", r#""duplicate""#, "cutting.rule: duplicate needs integration.mass lumped"),
        ("/cutting/spareVertices", "100", "cutting.spareVertices: only duplicate makes vertices; cutting.rule must be duplicate"),
        ("/cutting/spareVertices", "0", "cutting.spareVertices: found the number 0; must be a whole number, 1 or more"),
        ("/mesh", r#"{"file": "liver.vtu"}"#, "mesh.file: the mesh format .vtu is not available in this version; use .msh"),
        ("/tools/0/friction", "0.3", r#"tools[0].friction: belongs to what pushes; a grasper holds, and must have "stick""#),
        ("/tools/1/slipForce", "2", "tools[1].slipForce: a slip force is not available in this version; use null"),
    ];
    assert!(table.len() >= 60);
    for (pointer, value, message) in table {
        assert_eq!(
            line(&edited(pointer, value)),
            format!("plate.json: {message}"),
            "{pointer}"
        );
    }
}

#[test]
fn each_mistake_of_syntax_has_its_line() {
    #[rustfmt::skip]
    let table = [
        (r#""ramp": 0.5"#, r#""ramp": 0.5, "ramp": 1"#, r#"prescribed[0].ramp: key "ramp" stands twice, again in line 14; remove one"#),
        (r#""gravity": [0, 0.1, -3.7]"#, r#""gravity": [0, 0.1, -3.7], "name": "twice""#, r#"name: key "name" stands twice, again in line 16; remove one"#),
        (r#"{"nodes": [0, 1, 2]}"#, r#"{"nodes": [0, 1, 2], "nodes": [3]}"#, r#"fixed[0].nodes: key "nodes" stands twice, again in line 11; remove one"#),
        (r#""density": 999.9"#, r#""density": 1e999"#, "materials[1].density: number out of range in line 8; must be between -1.7e308 and 1.7e308"),
        (r#""density": 999.9"#, r#""density": NaN"#, "line 8, column 111: found a number that is not finite; must be finite"),
        (r#""density": 999.9"#, r#""density": -Infinity"#, "line 8, column 112: found a number that is not finite; must be finite"),
        (r#""density": 999.9"#, r#""density": 1."#, "line 8, column 113: invalid number; must be JSON"),
        (r#""density": 999.9"#, r#""density": 999.9,"#, "line 8, column 117: trailing comma; remove it"),
        (r#""gravity": [0, 0.1, -3.7]"#, r#""gravity": [0, 0.1, -3.7,]"#, "line 16, column 28: trailing comma; remove it"),
        (r#""start": "equilibrium","#, r#""start": "equilibrium""#, "line 18, column 3: expected `,` or `}`; one is missing before this place"),
        (r#""start": "equilibrium""#, r#""start": 'rest'"#, "line 17, column 12: found a single quote; must be a double quote"),
        (r#""start": "equilibrium""#, r#"start: "rest""#, "line 17, column 3: found no key; must be a name in double quotes"),
        (r#""start": "equilibrium""#, r#""start": "rest"#, r#"line 17, column 18: line break or control character in a string; must be closed, or written \n"#),
        (r#""start": "equilibrium","#, r#""start": "equilibrium", // at rest"#, "line 17, column 27: found a comment; JSON has none, remove it"),
        (r#""start": "equilibrium","#, r#"/* at rest */ "start": "equilibrium","#, "line 17, column 3: found a comment; JSON has none, remove it"),
        ("\"triangles\": true}\n}", "\"triangles\": true}\n} end", "line 31, column 3: text after the scene; must end with its closing brace"),
        ("\"triangles\": true}\n}", r#""triangles": true}"#, "line 30, column 73: the file ends inside an object; must be closed"),
    ];
    for (good, bad, message) in table {
        assert_eq!(PLATE.matches(good).count(), 1, "{good}");
        assert_eq!(
            line(&PLATE.replacen(good, bad, 1)),
            format!("plate.json: {message}"),
            "{bad}"
        );
    }
    #[rustfmt::skip]
    let whole = [
        ("", r#"empty; must be a JSON object with "name", "mesh" and "materials""#),
        ("  \n", r#"empty; must be a JSON object with "name", "mesh" and "materials""#),
        ("[1, 2]", "found a list of 2; must be an object"),
        ("null", "found null; must be an object"),
        (r#""plate""#, r#"found the string "plate"; must be an object"#),
        ("{", "line 1, column 1: the file ends inside an object; must be closed"),
        ("{}", "name: missing; must be a name of letters, digits and _, not starting with a digit"),
        ("[]{}", "line 1, column 3: text after the scene; must end with its closing brace"),
        (r#"{"a\nb": [{"x": 1, "x": 1}]}"#, r#"["a\nb"][0].x: key "x" stands twice, again in line 1; remove one"#),
        (r#"{"a" 1}"#, "line 1, column 6: expected `:`; one is missing before this place"),
        (r#"{"name": "\x"}"#, "line 1, column 12: invalid escape; must be JSON"),
        ("// plate", "line 1, column 1: found a comment; JSON has none, remove it"),
        (&"[".repeat(200), "line 1, column 128: nested too deeply; must be less than 128 deep"),
    ];
    for (text, message) in whole {
        assert_eq!(line(text), format!("plate.json: {message}"));
    }
}

#[test]
fn an_inline_mesh_is_checked() {
    let nodes = "[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]";
    #[rustfmt::skip]
    let table = [
        (r#"{"nodes": NODES}"#, "mesh.tetrahedra: missing; must be a list of tetrahedra"),
        (r#"{"nodes": NODES, "tetrahedra": []}"#, "mesh.tetrahedra: found an empty list; must be a list of tetrahedra, at least one"),
        (r#"{"nodes": [], "tetrahedra": [[0, 1, 2, 3]]}"#, "mesh.nodes: found an empty list; must be a list of nodes, at least one"),
        (r#"{"nodes": NODES, "tetrahedra": [[0, 1, 2, 3], [0, 1, 2, 4]]}"#, "mesh.tetrahedra[1][3]: no node 4; must be below 4"),
        (r#"{"nodes": NODES, "tetrahedra": [[0, 1, 2, 1]]}"#, "mesh.tetrahedra[0]: names node 1 twice; must be 4 different nodes"),
        (r#"{"nodes": NODES, "tetrahedra": [[0, 1, 2]]}"#, "mesh.tetrahedra[0]: found a list of 3; must be a list of 4 node numbers"),
        (r#"{"nodes": NODES, "tetrahedra": [[0, 1, 2, -3]]}"#, "mesh.tetrahedra[0][3]: found the number -3; must be a whole number, 0 or more"),
        (r#"{"nodes": NODES, "tetrahedra": [[0, 1, 2, 2.5]]}"#, "mesh.tetrahedra[0][3]: found the number 2.5; must be a whole number, 0 or more"),
        (r#"{"nodes": [[0, 0]], "tetrahedra": [[0, 1, 2, 3]]}"#, "mesh.nodes[0]: found a list of 2; must be a list of 3 numbers"),
        (r#"{"nodes": [[0, 0, null]], "tetrahedra": [[0, 1, 2, 3]]}"#, "mesh.nodes[0][2]: found null; must be a number"),
        (r#"{"nodes": NODES, "tetrahedra": [[0, 1, 2, 3]], "file": "a.msh"}"#, r#"mesh: holds both "file" and "nodes"; must hold exactly one of "box", "cylinder", "liver", "file" and "nodes""#),
        (r#"{"nodes": NODES, "tetrahedra": [[0, 1, 2, 3]], "scale": 1}"#, r#"mesh.scale: belongs to "file", not to "nodes"; remove it"#),
    ];
    for (mesh, message) in table {
        let mesh = mesh.replace("NODES", nodes);
        assert_eq!(
            line(&edited("/mesh", &mesh)),
            format!("plate.json: {message}")
        );
    }
}

#[test]
fn a_file_that_cannot_be_read_is_named() {
    let error = read(Path::new("no/such/scene.json"))
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("no/such/scene.json: cannot be read: "),
        "{error}"
    );
    assert!(
        error.ends_with("; must be a readable scene file"),
        "{error}"
    );
    let path = std::env::temp_dir().join(format!("tissue-{}-latin1.json", std::process::id()));
    std::fs::write(&path, b"{\"name\": \"\xe9\"}").unwrap();
    let error = read(&path).unwrap_err();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(
        error.message,
        "not UTF-8 text from byte 10 on; must be saved as UTF-8"
    );
}

#[test]
fn a_full_scene_is_read_and_written_back() {
    let scene = parse(PLATE, "plate.json").unwrap();
    assert_eq!(
        scene.materials[1].selector.region,
        Region::Tetrahedra(vec![0, 7])
    );
    assert!(scene.materials[1].selector.optional && !scene.materials[0].selector.optional);
    assert_eq!(scene.fixed[0].axes, [true; 3]);
    assert_eq!(scene.fixed[1].axes, [true, false, true]);
    assert_eq!(
        scene.prescribed[0].displacement,
        [Some(0.0), None, Some(-0.002)]
    );
    assert_eq!(scene.integration.substep, Some(1e-4));
    assert_eq!(scene.cuts[0].time, 0.5);
    let norm = scene.tools[0]
        .orientation
        .map(|x| x * x)
        .iter()
        .sum::<f64>();
    assert!((norm - 1.0).abs() < 1e-15);
    assert_eq!(scene.tools[1].orientation, [1.0, 0.0, 0.0, 0.0]);
    assert_round_trip(&scene);
}

fn assert_round_trip(scene: &Scene) {
    let text = serde_json::to_string(scene).unwrap();
    assert_eq!(&parse(&text, "again.json").unwrap(), scene, "{text}");
    assert_valid(&serde_json::from_str(&text).unwrap());
}

#[test]
fn each_mesh_source_is_read_and_written_back() {
    let edge_length = 0.015;
    let corners = vec![
        [0.0; 3],
        [0.1, 0.0, 0.0],
        [0.0, 1.0 / 3.0, 0.0],
        [0.0, 0.0, 1e-300],
    ];
    let table = [
        (r#"{"liver": {}}"#, MeshSource::Liver { edge_length }),
        (
            r#"{"cylinder": {"radius": 0.02, "height": 0.1, "edgeLength": 0.015}}"#,
            MeshSource::Cylinder {
                radius: 0.02,
                height: 0.1,
                edge_length,
            },
        ),
        (
            r#"{"file": "a.b/l.MSH"}"#,
            MeshSource::File {
                file: "a.b/l.MSH".into(),
                scale: 1.0,
            },
        ),
        (
            r#"{"file": "l.msh", "scale": 1e-3}"#,
            MeshSource::File {
                file: "l.msh".into(),
                scale: 0.001,
            },
        ),
        (
            r#"{"nodes": [[0, 0, 0], [0.1, 0, 0], [0, 0.3333333333333333, 0], [0, 0, 1e-300]], "tetrahedra": [[3, 1, 2, 0]]}"#,
            MeshSource::Inline {
                nodes: corners,
                tetrahedra: vec![[3, 1, 2, 0]],
            },
        ),
    ];
    for (text, mesh) in table {
        let scene = parse(&edited("/mesh", text), "plate.json").unwrap();
        assert_eq!(scene.mesh, mesh);
        assert_round_trip(&scene);
    }
}

#[test]
fn the_defaults_are_those_of_the_contract() {
    let scene = parse(LEAST, "plate.json").unwrap();
    let full = json!({
        "name": "plate", "description": "",
        "mesh": {"box": {"size": [1.0, 1.0, 1.0], "cells": [1, 1, 1], "origin": [0.0, 0.0, 0.0], "pattern": "five"}},
        "materials": [{"where": {"all": true}, "youngModulus": 1.0, "poissonRatio": 0.0, "density": 1.0}],
        "fixed": [], "prescribed": [], "loads": [], "gravity": [0.0, 0.0, -9.81], "start": "rest",
        "model": {
            "kind": "tensorMass", "connection": "full", "interfaceModes": null, "interfaceMass": "lumped",
            "elasticity": "linear", "form": "perTetrahedron", "adaptive": "blend", "nonlinearThreshold": 0.0,
            "incompressibility": 0.0, "hourglass": 0.3
        },
        "integration": {"scheme": null, "hapticRate": 1000.0, "substep": null, "damping": null, "mass": "lumped"},
        "cutting": {"rule": "remove", "mass": "removed"}, "cuts": [], "tools": [],
        "outputs": {"vertices": "surface", "causality": "output", "triangles": false}
    });
    assert_eq!(serde_json::to_value(&scene).unwrap(), full);
    assert_round_trip(&scene);
    let tool = r#"[{"name": "t", "kind": "probe", "shape": {"sphere": {"radius": 1}}, "position": [0, 0, 0]}]"#;
    let tool = parse(&edited("/tools", tool), "plate.json")
        .unwrap()
        .tools
        .remove(0);
    let expected = Tool {
        name: "t".into(),
        kind: ToolKind::Probe,
        shape: Shape::Sphere { radius: 1.0 },
        active_length: None,
        friction: Friction::Stick,
        slip_force: None,
        position: [0.0; 3],
        orientation: [1.0, 0.0, 0.0, 0.0],
    };
    assert_eq!(tool, expected);
    let bare = edited("/loads/0/ramp", "");
    assert_eq!(parse(&bare, "plate.json").unwrap().loads[0].ramp, 0.0);
}

#[test]
fn a_large_inline_mesh_is_read_quickly() {
    let nodes: Vec<[f64; 3]> = (0..30_000)
        .map(|i| [f64::from(i) * 0.1, 0.3, 1e-7])
        .collect();
    let tetrahedra: Vec<[u32; 4]> = (0..150_000)
        .map(|i| [0, 1, 2, 3].map(|k| i % 29_000 + k))
        .collect();
    let text = json!({"nodes": nodes, "tetrahedra": tetrahedra}).to_string();
    let text = edited("/mesh", &text);
    let start = std::time::Instant::now();
    let scene = parse(&text, "plate.json").unwrap();
    assert!(start.elapsed().as_secs_f64() < 1.0, "{:?}", start.elapsed());
    assert_eq!(scene.mesh, MeshSource::Inline { nodes, tetrahedra });
}

// The schema: enough of JSON Schema to judge scenes by it.

fn assert_valid(scene: &Value) {
    let schema = schema();
    assert_eq!(violation(scene, &schema, &schema), None);
}

/// Where and why `value` does not follow `schema`.
fn violation(value: &Value, schema: &Value, root: &Value) -> Option<String> {
    let one = |schema: &Value| violation(value, schema, root);
    let wrong = |why: &str| Some(format!("{value}: {why}"));
    if let Some(name) = schema["$ref"]
        .as_str()
        .and_then(|r| r.strip_prefix("#/$defs/"))
        && let Some(why) = one(&root["$defs"][name])
    {
        return Some(why);
    }
    for (key, needed) in [("oneOf", 1..2), ("anyOf", 1..99)] {
        if let Some(schemas) = schema[key].as_array()
            && !needed.contains(&schemas.iter().filter(|s| one(s).is_none()).count())
        {
            return wrong(key);
        }
    }
    if schema.get("const").is_some_and(|c| c != value) {
        return wrong("const");
    }
    let kinds = match &schema["type"] {
        Value::String(kind) => vec![kind.as_str()],
        Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).collect(),
        _ => vec![],
    };
    let is = |kind: &&str| match *kind {
        "null" => value.is_null(),
        "integer" => value.is_u64() || value.is_i64(),
        "number" => value.is_number(),
        "boolean" => value.is_boolean(),
        "string" => value.is_string(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        _ => false,
    };
    if !kinds.is_empty() && !kinds.iter().any(is) {
        return wrong("type");
    }
    if let Some(x) = value.as_f64() {
        let bound = |key: &str| schema[key].as_f64();
        if bound("minimum").is_some_and(|b| x < b)
            || bound("maximum").is_some_and(|b| x > b)
            || bound("exclusiveMinimum").is_some_and(|b| x <= b)
            || bound("exclusiveMaximum").is_some_and(|b| x >= b)
        {
            return wrong("range");
        }
    }
    if let Value::Array(items) = value {
        let count = items.len() as u64;
        if schema["minItems"]
            .as_u64()
            .is_some_and(|least| count < least)
            || schema["maxItems"].as_u64().is_some_and(|most| count > most)
        {
            return wrong("length");
        }
        return items
            .iter()
            .find_map(|item| violation(item, &schema["items"], root));
    }
    let object = value.as_object()?;
    let closed = schema["additionalProperties"] == json!(false)
        || schema["unevaluatedProperties"] == json!(false);
    let branches = schema["oneOf"].as_array().cloned().unwrap_or_default();
    for (key, value) in object {
        match schema["properties"].get(key) {
            Some(schema) => {
                if let Some(why) = violation(value, schema, root) {
                    return Some(format!("{key}: {why}"));
                }
            }
            None if closed && !branches.iter().any(|b| b["properties"].get(key).is_some()) => {
                return wrong(&format!("unknown {key}"));
            }
            None => {}
        }
    }
    let required = schema["required"].as_array()?;
    required
        .iter()
        .filter_map(Value::as_str)
        .find(|key| !object.contains_key(*key))
        .map(|key| format!("no {key}"))
}

#[test]
fn the_schema_agrees_with_the_reader() {
    for text in [PLATE, LEAST] {
        assert_valid(&serde_json::from_str(text).unwrap());
    }
    let schema = schema();
    #[rustfmt::skip]
    let bad = [
        ("/gravty", "1"), ("/name", ""), ("/name", "3"), ("/materials", "[]"), ("/materials/0/density", "0"),
        ("/materials/0/youngsModulus", "1"), ("/materials/0/poissonRatio", "0.5"), ("/gravity", "[0, 0]"),
        ("/fixed/0/sphere", r#"{"center": [0, 0, 0], "radius": 1}"#), ("/fixed/0/nods", "[1]"),
        ("/fixed/0", r#"{"all": false}"#), ("/fixed/1/axis", "1"), ("/mesh/scale", "1"), ("/mesh", "{}"),
        ("/model/kind", "\"hybird\""), ("/integration/hapticRate", "0"), ("/tools/0/shape/sphere", r#"{"radius": 1}"#),
        ("/tools/0/position", ""), ("/cuts/0/time", "-1"), ("/outputs/triangles", "1"),
    ];
    for (pointer, value) in bad {
        let text = edited(pointer, value);
        assert!(
            violation(&serde_json::from_str(&text).unwrap(), &schema, &schema).is_some(),
            "{pointer} {value}"
        );
        line(&text);
    }
    assert_eq!(
        schema["$schema"],
        "https://json-schema.org/draft/2020-12/schema"
    );
}

// Selectors on a mesh.

/// The unit cube's corners, node i at its bits (x lowest), a node nothing refers to, and two tetrahedra.
fn cube() -> TetMesh {
    let corner = |i: u32| {
        Vec3::new(
            f64::from(i & 1),
            f64::from(i >> 1 & 1),
            f64::from(i >> 2 & 1),
        )
    };
    let mut nodes: Vec<_> = (0..8).map(corner).collect();
    nodes.push(Vec3::new(0.5, 0.5, 0.5));
    TetMesh {
        nodes,
        tetrahedra: vec![[0, 1, 2, 4], [7, 6, 5, 3]],
    }
}

fn selector(text: &str) -> Selector {
    let text = edited("/materials/0/where", text);
    parse(&text, "plate.json")
        .unwrap()
        .materials
        .remove(0)
        .selector
}

#[test]
fn selectors_select_nodes_and_tetrahedra() {
    #[rustfmt::skip]
    let table: [(&str, &[u32], &[u32]); 10] = [
        (r#"{"all": true}"#, &[0, 1, 2, 3, 4, 5, 6, 7, 8], &[0, 1]),
        (r#"{"nodes": [4, 2, 1, 0, 2]}"#, &[0, 1, 2, 4], &[0]),
        (r#"{"box": {"min": [1.0000000017, 0, 0], "max": [2, 1, 1]}, "optional": true}"#, &[1, 3, 5, 7], &[]),
        (r#"{"box": {"min": [1.0000000018, 0, 0], "max": [2, 1, 1]}, "optional": true}"#, &[], &[]),
        (r#"{"sphere": {"center": [0, 0, 0], "radius": 0.9999999999}}"#, &[0, 1, 2, 4, 8], &[0]),
        (r#"{"halfSpace": {"point": [0.5, 0.5, 0.5], "normal": [1e-200, 1e-200, 1e-200]}}"#, &[3, 5, 6, 7, 8], &[1]),
        (r#"{"not": {"nodes": [0, 1, 2, 4]}}"#, &[3, 5, 6, 7, 8], &[1]),
        (r#"{"any": [{"nodes": [0, 1, 2, 4]}, {"sphere": {"center": [1, 1, 1], "radius": 0.5}}]}"#, &[0, 1, 2, 4, 7], &[0, 1]),
        (r#"{"any": [{"all": true}, {"sphere": {"center": [9, 9, 9], "radius": 0.1}, "optional": true}]}"#, &[0, 1, 2, 3, 4, 5, 6, 7, 8], &[0, 1]),
        (r#"{"not": {"any": []}, "optional": true}"#, &[0, 1, 2, 3, 4, 5, 6, 7, 8], &[0, 1]),
    ];
    let mesh = cube();
    for (text, nodes, tetrahedra) in table {
        let selector = selector(text);
        assert_eq!(
            select_nodes(&selector, &mesh).as_deref(),
            Ok(nodes),
            "{text}"
        );
        assert_eq!(
            select_tetrahedra(&selector, &mesh).as_deref(),
            Ok(tetrahedra),
            "{text}"
        );
    }
    let listed = selector(r#"{"tetrahedra": [1]}"#);
    assert_eq!(select_tetrahedra(&listed, &mesh), Ok(vec![1]));
}

#[test]
fn selectors_that_miss_the_mesh_say_so() {
    let nothing = "must select at least one, or say \"optional\": true";
    #[rustfmt::skip]
    let table = [
        (r#"{"nodes": [9]}"#, "no node 9 in the mesh; must be below 9".into(), "no node 9 in the mesh; must be below 9".into()),
        (r#"{"nodes": [9], "optional": true}"#, "no node 9 in the mesh; must be below 9".into(), "no node 9 in the mesh; must be below 9".into()),
        (r#"{"tetrahedra": [2]}"#, "selects tetrahedra where nodes are selected; must be \"nodes\" or a region of space".into(), "no tetrahedron 2 in the mesh; must be below 2".to_string()),
        (r#"{"not": {"all": true}}"#, format!("selects no node; {nothing}"), format!("selects no tetrahedron; {nothing}")),
        (r#"{"any": [{"all": true}, {"not": {"nodes": []}}]}"#, format!("any[1]: not: selects no node; {nothing}"), format!("any[1]: not: selects no tetrahedron; {nothing}")),
        (r#"{"any": []}"#, format!("selects no node; {nothing}"), format!("selects no tetrahedron; {nothing}")),
    ];
    let mesh = cube();
    for (text, nodes, tetrahedra) in table {
        let selector = selector(text);
        assert_eq!(select_nodes(&selector, &mesh), Err(nodes), "{text}");
        assert_eq!(
            select_tetrahedra(&selector, &mesh),
            Err(tetrahedra),
            "{text}"
        );
    }
    let error = SceneError::at(
        "plate.json",
        "fixed[0].where",
        format!("selects no node; {nothing}"),
    );
    assert_eq!(
        error.to_string(),
        format!("plate.json: fixed[0].where: selects no node; {nothing}")
    );
    let empty = TetMesh::default();
    assert!(select_nodes(&selector(r#"{"all": true}"#), &empty).is_err());
}

#[test]
fn schemes_that_cannot_run_are_refused() {
    let refused = |integration: &str, model: &str| {
        let text = LEAST.replacen(
            '{',
            &format!("{{\"integration\": {integration}, \"model\": {model},"),
            1,
        );
        parse(&text, "plate.json").map_err(|e| e.to_string()).err()
    };
    let whole = r#"{"kind": "tensorMass"}"#;
    let hybrid = r#"{"kind": "hybrid", "dynamic": {"all": true}, "interfaceMass": "guyan"}"#;
    let euler = r#"{"scheme": "euler", "damping": 0}"#;
    assert_eq!(
        refused(euler, whole).as_deref(),
        Some(
            "plate.json: integration.damping: is 0, at which euler is unstable at any substep; must be more, or another scheme"
        )
    );
    for scheme in ["euler", "rungeKutta4", "implicitEuler"] {
        let integration = format!(r#"{{"scheme": "{scheme}", "damping": 1}}"#);
        assert_eq!(refused(&integration, whole), None);
        assert_eq!(
            refused(&integration, hybrid).as_deref(),
            Some(
                "plate.json: model.interfaceMass: guyan needs integration.scheme symplecticEuler or centralDifference"
            )
        );
    }
    for scheme in ["null", "\"symplecticEuler\"", "\"centralDifference\""] {
        let integration = format!(r#"{{"scheme": {scheme}, "damping": 0}}"#);
        assert_eq!(refused(&integration, whole), None);
        assert_eq!(refused(&integration, hybrid), None);
    }
}
