//! The one table of variables: name, reference, unit, getter, setter.
//!
//! A row is a scalar, or an array over tools, materials, vertices or triangles, each item with the
//! components that its name lists. References of an array are consecutive, item by item; they depend on
//! nothing but the row and the item, so they stay the same from build to build.

use tissue::model::Model;
use tissue::scene::{MOST_DAMPING, MOST_GRAVITY, MOST_PRESSURE, OutputCausality, OutputVertices};
use tissue::simulation::{Material, Simulation};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    Single,
    Tool,
    Material,
    Vertex,
    VertexNode,
    Triangle,
}

/// First reference of each group and the room of one item.
const fn place(group: Group) -> (u32, u32) {
    match group {
        Group::Single => (0, 1000),
        Group::Tool => (1000, 100),
        Group::Material => (100_000, 10),
        Group::Vertex => (1_000_000, 3),
        Group::VertexNode => (100_000_000, 1),
        Group::Triangle => (200_000_000, 3),
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Causality {
    Input,
    Output,
    Local,
    Parameter,
    /// Output or local, as the scene's `outputs.causality` says.
    AsScene,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variability {
    Continuous,
    Discrete,
    Tunable,
    Fixed,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Initial {
    Exact,
    Calculated,
    /// Inputs have none.
    None,
}

/// Item and component, both from 0.
pub type Get<T> = fn(&mut Simulation, usize, usize) -> T;
/// The error says what would be right.
pub type Set<T> = fn(&mut Simulation, usize, usize, T) -> Result<(), String>;
/// The error says why there is no value now.
pub type Try<T> = fn(&mut Simulation, usize, usize) -> Result<T, String>;

#[derive(Clone, Copy)]
pub enum Value {
    Real {
        unit: &'static str,
        get: Get<f64>,
        set: Option<Set<f64>>,
        /// First time derivative.
        rate: Option<Get<f64>>,
        min: Option<f64>,
        max: Option<f64>,
    },
    /// A Real that takes work, and may fail.
    Evaluated {
        unit: &'static str,
        get: Try<f64>,
    },
    Integer {
        get: Get<i32>,
    },
    Boolean {
        get: Get<bool>,
        set: Option<Set<bool>>,
    },
}

#[derive(Clone, Copy)]
pub struct Row {
    pub group: Group,
    /// `#` stands for the item, from 1.
    pub name: &'static str,
    /// Suffixes, one a component.
    pub components: &'static [&'static str],
    /// Of the first component, within the item.
    pub offset: u32,
    pub value: Value,
    pub causality: Causality,
    pub variability: Variability,
    pub initial: Initial,
    pub description: &'static str,
}

const ONE: &[&str] = &[""];
const XYZ: &[&str] = &[".x", ".y", ".z"];
const WXYZ: &[&str] = &[".w", ".x", ".y", ".z"];
const MATRIX: &[&str] = &[
    "[1,1]", "[1,2]", "[1,3]", "[2,1]", "[2,2]", "[2,3]", "[3,1]", "[3,2]", "[3,3]",
];
const ROW3: &[&str] = &[",1]", ",2]", ",3]"];

const fn real(unit: &'static str, get: Get<f64>) -> Value {
    Value::Real {
        unit,
        get,
        set: None,
        rate: None,
        min: None,
        max: None,
    }
}

const fn changing(unit: &'static str, get: Get<f64>, rate: Get<f64>) -> Value {
    Value::Real {
        unit,
        get,
        set: None,
        rate: Some(rate),
        min: None,
        max: None,
    }
}

const fn settable(unit: &'static str, get: Get<f64>, set: Set<f64>) -> Value {
    Value::Real {
        unit,
        get,
        set: Some(set),
        rate: None,
        min: None,
        max: None,
    }
}

const fn ranged(
    unit: &'static str,
    get: Get<f64>,
    set: Set<f64>,
    min: f64,
    max: Option<f64>,
) -> Value {
    Value::Real {
        unit,
        get,
        set: Some(set),
        rate: None,
        min: Some(min),
        max,
    }
}

const fn output(
    group: Group,
    offset: u32,
    name: &'static str,
    components: &'static [&'static str],
    value: Value,
    variability: Variability,
    description: &'static str,
) -> Row {
    Row {
        group,
        name,
        components,
        offset,
        value,
        causality: Causality::Output,
        variability,
        initial: Initial::Calculated,
        description,
    }
}

const fn input(
    offset: u32,
    name: &'static str,
    components: &'static [&'static str],
    value: Value,
    variability: Variability,
    description: &'static str,
) -> Row {
    Row {
        group: Group::Tool,
        name,
        components,
        offset,
        value,
        causality: Causality::Input,
        variability,
        initial: Initial::None,
        description,
    }
}

const fn parameter(
    group: Group,
    offset: u32,
    name: &'static str,
    components: &'static [&'static str],
    value: Value,
    variability: Variability,
    description: &'static str,
) -> Row {
    Row {
        group,
        name,
        components,
        offset,
        value,
        causality: Causality::Parameter,
        variability,
        initial: Initial::Exact,
        description,
    }
}

const fn local(
    group: Group,
    offset: u32,
    name: &'static str,
    components: &'static [&'static str],
    value: Value,
    variability: Variability,
    description: &'static str,
) -> Row {
    Row {
        group,
        name,
        components,
        offset,
        value,
        causality: Causality::Local,
        variability,
        initial: Initial::Calculated,
        description,
    }
}

use Group::{Material as PerMaterial, Single, Tool, Triangle, Vertex, VertexNode};
use Variability::{Continuous, Discrete, Fixed, Tunable};

/// Every variable there is, in the order of the XML.
#[rustfmt::skip]
pub const TABLE: &[Row] = &[
    input(0, "tool[#].position", XYZ, settable("m", |s, k, c| s.tool(k).input.value[c],
        |s, k, c, v| { s.set_pose_input(k, c, v); Ok(()) }), Continuous,
        "position of the tool's tip in the world"),
    input(3, "tool[#].orientation", WXYZ, settable("1", |s, k, c| s.tool(k).input.value[3 + c],
        |s, k, c, v| { s.set_pose_input(k, 3 + c, v); Ok(()) }), Continuous,
        "orientation of the tool, a quaternion; normalised when used"),
    input(7, "tool[#].active", ONE, Value::Boolean { get: |s, k, _| s.tool(k).input_active,
        set: Some(|s, k, _, v| { s.set_active(k, v); Ok(()) }) }, Discrete,
        "grasper closed, cautery current on"),
    output(Tool, 10, "tool[#].force", XYZ, changing("N", |s, k, c| s.tool(k).force[c],
        |s, k, c| s.tool(k).force_rate[c]), Continuous,
        "force of the tissue on the tool at the end of the step, without the inertia of the contact nodes"),
    output(Tool, 13, "tool[#].torque", XYZ, changing("N.m", |s, k, c| s.tool(k).torque[c],
        |s, k, c| s.tool(k).torque_rate[c]), Continuous,
        "moment of that force about the tool's position"),
    output(Tool, 16, "tool[#].meanForce", XYZ, real("N", |s, k, c| s.tool(k).mean_force[c]), Continuous,
        "impulse of the tissue on the tool over the step, divided by its length"),
    output(Tool, 19, "tool[#].inContact", ONE, Value::Boolean { get: |s, k, _| s.tool(k).in_contact,
        set: None }, Discrete, "the tool holds tissue"),
    local(Tool, 20, "tool[#].stiffness", MATRIX, Value::Evaluated { unit: "N/m", get: stiffness }, Continuous,
        "d force_j / d position_k of the next step, contact held; evaluated when read"),
    local(Tool, 30, "tool[#].staticStiffness", MATRIX, Value::Evaluated { unit: "N/m", get: static_stiffness },
        Continuous, "- d force_j / d position_k after everything has settled; evaluated when read"),
    output(Single, 0, "topology.revision", ONE,
        Value::Integer { get: |s, _, _| whole(s.state().live.revision) }, Discrete,
        "grows with every change of the mesh"),
    output(Single, 1, "topology.removedTetrahedra", ONE,
        Value::Integer { get: |s, _, _| whole(s.state().live.removed.len() as u64) }, Discrete,
        "tetrahedra removed since the start"),
    output(Single, 2, "topology.pieces", ONE, Value::Integer { get: |s, _, _| whole(s.pieces() as u64) },
        Discrete, "connected pieces of tissue"),
    output(Single, 3, "topology.removedVolume", ONE, real("m3", |s, _, _| s.state().live.removed_volume),
        Discrete, "rest volume removed since the start"),
    output(Single, 4, "topology.cleanedTetrahedra", ONE,
        Value::Integer { get: |s, _, _| whole(s.state().live.cleaned as u64) }, Discrete,
        "of those removed, the ones that nobody cut: they hung by a vertex or an edge alone"),
    output(Single, 5, "topology.cleanedVolume", ONE, real("m3", |s, _, _| s.state().live.cleaned_volume),
        Discrete, "rest volume of those"),
    output(Single, 10, "energy.elastic", ONE, real("J", |s, _, _| s.energy().elastic), Continuous,
        "elastic energy"),
    output(Single, 11, "energy.kinetic", ONE, real("J", |s, _, _| s.energy().kinetic), Continuous,
        "kinetic energy, of half-step velocities"),
    output(Single, 12, "energy.gravity", ONE, real("J", |s, _, _| s.energy().gravity), Continuous,
        "potential of gravity, zero at rest"),
    output(Single, 13, "energy.load", ONE, real("J", |s, _, _| s.energy().load), Continuous,
        "potential of the nodal loads, zero at rest"),
    output(Single, 14, "energy.toolWork", ONE, real("J", |s, _, _| s.energy().tool_work), Continuous,
        "work of the tools on the tissue since the start"),
    output(Single, 15, "energy.supportWork", ONE, real("J", |s, _, _| s.energy().support_work), Continuous,
        "work of prescribed nodes, load ramps and changes of gravity since the start"),
    output(Single, 16, "energy.dissipated", ONE, real("J", |s, _, _| s.energy().dissipated), Continuous,
        "lost to damping, cuts and attaches since the start"),
    output(Single, 20, "diagnostics.substeps", ONE,
        Value::Integer { get: |s, _, _| whole(s.state().clock.total) }, Discrete,
        "substeps taken since the start"),
    output(Single, 21, "diagnostics.substep", ONE, real("s", |s, _, _| s.substep()), Discrete,
        "substep in use"),
    output(Single, 22, "diagnostics.criticalSubstep", ONE, real("s", |s, _, _| s.critical_substep()), Discrete,
        "largest stable substep"),
    output(Single, 23, "diagnostics.minimumVolumeRatio", ONE, real("1", |s, _, _| s.minimum_volume_ratio()),
        Continuous, "smallest det F over live tetrahedra; negative: inverted"),
    output(Single, 24, "diagnostics.nonlinearFraction", ONE, real("1", |s, _, _| s.nonlinear_fraction()), Continuous,
        "share of the dynamic tetrahedra whose law is not the linear one"),
    parameter(Single, 30, "gravity", XYZ, ranged("m/s2", |s, _, c| s.parameters().gravity[c],
        |s, _, c, v| { s.set_gravity(c, v); Ok(()) }, -MOST_GRAVITY, Some(MOST_GRAVITY)), Tunable,
        "acceleration of gravity"),
    parameter(Single, 33, "integration.damping", ONE, ranged("1/s", |s, _, _| s.parameters().damping,
        |s, _, _, v| { s.set_damping(v); Ok(()) }, 0.0, Some(MOST_DAMPING)), Tunable,
        "mass-proportional damping; the substep follows its critical value"),
    parameter(Single, 34, "integration.hapticRate", ONE, ranged("Hz",
        |s, _, _| s.pending_scene().integration.haptic_rate,
        |s, _, _, v| { s.change_scene(|scene| scene.integration.haptic_rate = v); Ok(()) }, 1.0, Some(1e5)),
        Fixed, "rate of contact and cutting"),
    parameter(Single, 35, TEARING, ONE, ranged("1", |s, _, _| s.parameters().tearing_threshold,
        |s, _, _, v| set_tearing_threshold(s, v), 0.0, None), Tunable,
        "relative change of volume or length, above 0, past which tetrahedra tear"),
    parameter(Single, 36, INCOMPRESSIBILITY, ONE, ranged("Pa", |s, _, _| s.parameters().incompressibility,
        |s, _, _, v| { s.set_incompressibility(v); Ok(()) }, 0.0, Some(MOST_PRESSURE)), Tunable,
        "volume penalty; the substep follows its critical value"),
    parameter(Single, 37, THRESHOLD, ONE, ranged("m", |s, _, _| s.parameters().nonlinear_threshold,
        |s, _, _, v| above(v).map(|()| s.set_nonlinear_threshold(v)), 0.0, None), Tunable,
        "deformation, above 0, past which tissue has another law than the linear one"),
    parameter(PerMaterial, 0, "material[#].youngModulus", ONE, ranged("Pa",
        |s, k, _| s.material(k, Material::YoungModulus),
        |s, k, _, v| set_material(s, k, Material::YoungModulus, v), 0.0, Some(1e15)), Fixed,
        "Young's modulus, above 0"),
    parameter(PerMaterial, 1, "material[#].poissonRatio", ONE, ranged("1",
        |s, k, _| s.material(k, Material::PoissonRatio),
        |s, k, _, v| set_material(s, k, Material::PoissonRatio, v), -1.0, Some(0.5)), Fixed,
        "Poisson's ratio, between -1 and 0.5"),
    parameter(PerMaterial, 2, "material[#].density", ONE, ranged("kg/m3",
        |s, k, _| s.material(k, Material::Density), |s, k, _, v| set_material(s, k, Material::Density, v), 0.0,
        Some(1e9)), Fixed, "density, above 0"),
    output(Single, 40, "surface.triangleCount", ONE,
        Value::Integer { get: |s, _, _| whole(s.surface_triangle_count() as u64) }, Discrete,
        "exposed triangles"),
    Row { group: Vertex, name: "surface.vertex[#]", components: XYZ, offset: 0, value: changing("m",
        |s, j, c| s.surface_vertex(j)[c], |s, j, c| s.surface_velocity(j)[c]), causality: Causality::AsScene, variability: Continuous,
        initial: Initial::Calculated, description: "current position" },
    local(VertexNode, 0, "surface.node[#]", ONE, Value::Integer { get: |s, j, _| scene_node(s, j) }, Fixed,
        "node of the scene's mesh, from 0"),
    local(Triangle, 0, "surface.triangle[#", ROW3, Value::Integer { get: |s, j, c| s.surface_triangle(j)[c] },
        Discrete,
        "corner of an exposed triangle, outward, an index into surface.vertex from 0; -1: no such triangle now"),
];

/// Only of scenes with tearing.
const TEARING: &str = "tearing.threshold";

/// Only of scenes with a threshold.
const THRESHOLD: &str = "model.nonlinearThreshold";

/// Only of scenes with a law for large deformation all over.
const INCOMPRESSIBILITY: &str = "model.incompressibility";

fn set_tearing_threshold(s: &mut Simulation, value: f64) -> Result<(), String> {
    above(value).map(|()| s.set_tearing_threshold(value))
}

/// For what may not be 0.
fn above(value: f64) -> Result<(), String> {
    match value > 0.0 {
        true => Ok(()),
        false => Err("must be above 0".to_string()),
    }
}

fn whole(value: u64) -> i32 {
    i32::try_from(value).unwrap_or(i32::MAX)
}

fn scene_node(s: &Simulation, j: usize) -> i32 {
    let model = s.model();
    // Spares show none.
    model.scene_node[model.surface_nodes[j] as usize] as i32
}

/// Open ends of the ranges, which a `min` cannot say.
fn set_material(s: &mut Simulation, k: usize, which: Material, value: f64) -> Result<(), String> {
    let (holds, range) = match which {
        Material::YoungModulus | Material::Density => (value > 0.0, "above 0"),
        Material::PoissonRatio => (value > -1.0 && value < 0.5, "above -1 and below 0.5"),
    };
    if !holds {
        return Err(format!("must be {range}"));
    }
    s.change_scene(|scene| match which {
        Material::YoungModulus => scene.materials[k].young_modulus = value,
        Material::PoissonRatio => scene.materials[k].poisson_ratio = value,
        Material::Density => scene.materials[k].density = value,
    });
    Ok(())
}

fn stiffness(s: &mut Simulation, k: usize, c: usize) -> Result<f64, String> {
    let column = s.tangent(k, k, c % 3).map_err(|e| e.to_string())?;
    Ok(column[c / 3])
}

fn static_stiffness(s: &mut Simulation, k: usize, c: usize) -> Result<f64, String> {
    let stiffness = s.static_stiffness(k).map_err(|e| e.to_string())?;
    Ok(stiffness[(c / 3, c % 3)])
}

/// Which component of (force, torque) a component of a tool's row is, if any: what has directional derivatives.
pub fn felt(row: &Row, component: usize) -> Option<usize> {
    let is_felt = matches!(row.value, Value::Real { rate: Some(_), .. });
    let at = (row.offset as usize + component).checked_sub(10)?;
    (row.group == Tool && is_felt && at < 6).then_some(at)
}

/// Which component of the pose, position before orientation, a component of a tool's row is, if any.
pub fn posed(row: &Row, component: usize) -> Option<usize> {
    let is_real = matches!(row.value, Value::Real { .. });
    let at = row.offset as usize + component;
    (row.group == Tool && is_real && row.causality == Causality::Input).then_some(at)
}

/// Items of a group in a model.
pub fn count(group: Group, model: &Model) -> usize {
    match group {
        Group::Single => 1,
        Group::Tool => model.scene.tools.len(),
        Group::Material => model.scene.materials.len(),
        Group::Vertex | Group::VertexNode => model.surface_nodes.len(),
        Group::Triangle if model.scene.outputs.triangles => model.exposable_faces(),
        Group::Triangle => 0,
    }
}

/// Whether a model has a row's variables at all.
pub fn exists(row: &Row, model: &Model) -> bool {
    let vertices = model.scene.outputs.vertices != OutputVertices::None;
    count(row.group, model) > 0
        && (row.name != TEARING || model.scene.tearing.is_some())
        && (row.name != INCOMPRESSIBILITY || model.takes_penalty())
        && (row.name != THRESHOLD || model.is_adaptive())
        && (row.group == Group::Single
            || row.group == Group::Tool
            || row.group == Group::Material
            || vertices)
}

/// Causality as the XML says it.
pub(crate) fn causality(row: &Row, model: &Model) -> Causality {
    match row.causality {
        Causality::AsScene => match model.scene.outputs.causality {
            OutputCausality::Output => Causality::Output,
            OutputCausality::Local => Causality::Local,
        },
        known => known,
    }
}

/// Value reference of a component of an item.
pub fn reference(row: &Row, item: usize, component: usize) -> u32 {
    let (first, stride) = place(row.group);
    first + stride * item as u32 + row.offset + component as u32
}

/// Row, item and component of a value reference.
pub fn resolve(reference: u32, model: &Model) -> Option<(&'static Row, usize, usize)> {
    let group = match reference {
        0..1000 => Group::Single,
        1000..100_000 => Group::Tool,
        100_000..1_000_000 => Group::Material,
        1_000_000..100_000_000 => Group::Vertex,
        100_000_000..200_000_000 => Group::VertexNode,
        _ => Group::Triangle,
    };
    let (first, stride) = place(group);
    let (item, within) = ((reference - first) / stride, (reference - first) % stride);
    if item as usize >= count(group, model) {
        return None;
    }
    let row = TABLE.iter().find(|row| {
        row.group == group
            && (row.offset..row.offset + row.components.len() as u32).contains(&within)
    })?;
    exists(row, model).then_some((row, item as usize, (within - row.offset) as usize))
}
