//! The scene's nouns, one field a key of the scene file (same names, camelCase there).
//!
//! The doc comments are what an editor shows through the JSON Schema, so they speak to who writes scenes.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize, Serializer};

/// A whole scene: a piece of soft tissue, what holds and loads it, how it is simulated, and the tools.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Scene {
    /// Letters, digits and `_`, not starting with a digit: FMU `modelName` and `modelIdentifier`.
    #[schemars(extend("pattern" = "^[A-Za-z_][A-Za-z0-9_]*$"))]
    pub name: String,
    /// Free text, shown by hosts.
    #[serde(default)]
    pub description: String,
    /// Where the tetrahedra come from.
    pub mesh: MeshSource,
    /// At least one; later entries override earlier ones where they select.
    #[schemars(extend("minItems" = 1))]
    pub materials: Vec<Material>,
    /// Nodes that do not move.
    #[serde(default)]
    pub fixed: Vec<Fixed>,
    /// Nodes moved by a given displacement.
    #[serde(default)]
    pub prescribed: Vec<Prescribed>,
    /// Nodal forces.
    #[serde(default)]
    pub loads: Vec<Load>,
    /// m/s², default `[0, 0, -9.81]`.
    #[serde(default = "default_gravity")]
    pub gravity: [f64; 3],
    /// State at time 0.
    #[serde(default)]
    pub start: Start,
    /// What is solved.
    #[serde(default)]
    pub model: ModelSettings,
    /// How it is integrated in time.
    #[serde(default)]
    pub integration: Integration,
    /// What cutting does to the mesh.
    #[serde(default)]
    pub cutting: Cutting,
    /// Scripted cuts.
    #[serde(default)]
    pub cuts: Vec<Cut>,
    /// Absent or `null`: no tearing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tearing: Option<Tearing>,
    /// Numbered from 1 in this order in the FMU; names are unique.
    #[serde(default)]
    pub tools: Vec<Tool>,
    /// What the FMU shows of the tissue.
    #[serde(default)]
    pub outputs: Outputs,
}

pub(super) fn default_gravity() -> [f64; 3] {
    [0.0, 0.0, -9.81]
}

/// One of the keys `box`, `cylinder`, `liver`, `file` (with `scale`), or `nodes` with `tetrahedra`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(
    rename_all = "camelCase",
    rename_all_fields = "camelCase",
    deny_unknown_fields
)]
pub enum MeshSource {
    /// A box along the axes, cut into cells.
    Box {
        /// m, above 0.
        size: [f64; 3],
        /// Along each axis, 1 or more.
        cells: [usize; 3],
        /// m, the lowest corner; default 0.
        #[serde(default)]
        origin: [f64; 3],
        /// How a cell is divided into tetrahedra.
        #[serde(default)]
        pattern: BoxPattern,
    },
    /// Axis along z, base at z = 0, centred on x = y = 0.
    Cylinder {
        /// m, above 0.
        radius: f64,
        /// m, above 0.
        height: f64,
        /// m, above 0: wanted length of the tetrahedra's edges.
        edge_length: f64,
    },
    /// Procedural liver-like organ.
    Liver {
        /// m, 0.003 to 0.03: wanted length of the tetrahedra's edges; default 0.015.
        #[serde(default = "default_liver_edge")]
        #[schemars(extend("minimum" = 0.003, "maximum" = 0.03))]
        edge_length: f64,
    },
    /// A mesh file.
    #[serde(untagged)]
    File {
        /// Path, relative to the scene file.
        file: String,
        /// Coordinates times this are metres; default 1.
        #[serde(default = "default_scale")]
        scale: f64,
    },
    /// The mesh itself.
    #[serde(untagged)]
    Inline {
        /// m.
        nodes: Vec<[f64; 3]>,
        /// Four node numbers each, from 0.
        tetrahedra: Vec<[u32; 4]>,
    },
}

pub(super) fn default_liver_edge() -> f64 {
    0.015
}

pub(super) fn default_scale() -> f64 {
    1.0
}

/// How a box cell is divided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum BoxPattern {
    /// 5 tetrahedra a cell, mirrored from cell to cell. The default.
    #[default]
    Five,
    /// 6 tetrahedra a cell round its diagonal, mirrored from cell to cell.
    Kuhn,
}

/// A set of rest nodes, or of tetrahedra by their centroids: exactly one region. Spatial tests are
/// inclusive within 1e-9 of the mesh's size.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Selector {
    /// A selector that selects nothing is an error unless this is true. It covers what stands inside it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub optional: bool,
    #[serde(flatten)]
    pub region: Region,
}

/// What a [`Selector`] selects.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub enum Region {
    /// Everything.
    #[serde(serialize_with = "serialize_true")]
    #[schemars(schema_with = "schema_true")]
    All,
    /// These nodes, from 0; where tetrahedra are selected, those with all four nodes listed.
    Nodes(Vec<u32>),
    /// These tetrahedra, from 0. Only where tetrahedra are selected.
    Tetrahedra(Vec<u32>),
    /// A box along the axes, m.
    Box { min: [f64; 3], max: [f64; 3] },
    /// A ball, m.
    Sphere { center: [f64; 3], radius: f64 },
    /// The side of a plane that `normal` points to; the plane goes through `point`, m.
    HalfSpace { point: [f64; 3], normal: [f64; 3] },
    /// What at least one of these selects.
    Any(Vec<Selector>),
    /// What this does not select.
    Not(Box<Selector>),
}

fn serialize_true<S: Serializer>(serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bool(true)
}

fn schema_true(_: &mut SchemaGenerator) -> Schema {
    json_schema!({"const": true})
}

/// Isotropic linear elasticity and density of the selected tetrahedra.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Material {
    /// Which tetrahedra.
    #[serde(rename = "where")]
    pub selector: Selector,
    /// Young's modulus E in Pa, above 0.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub young_modulus: f64,
    /// Poisson's ratio, above -1 and below 0.5.
    #[schemars(extend("exclusiveMinimum" = -1, "exclusiveMaximum" = 0.5))]
    pub poisson_ratio: f64,
    /// kg/m³, above 0.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub density: f64,
    /// Optional transversal isotropy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fibre: Option<Fibre>,
}

/// Extra stiffness along one direction (transversal isotropy).
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Fibre {
    /// Any length but 0.
    pub direction: [f64; 3],
    /// Pa, 0 or more.
    #[schemars(extend("minimum" = 0))]
    pub lambda: f64,
    /// Pa, 0 or more.
    #[schemars(extend("minimum" = 0))]
    pub mu: f64,
}

/// Nodes that do not move along `axes`. In the file a bare selector (all axes) or
/// `{"where": SELECTOR, "axes": "xy"}`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(from = "FixedInFile", into = "FixedInFile")]
pub struct Fixed {
    pub selector: Selector,
    /// x, y, z.
    pub axes: [bool; 3],
}

/// A bare selector (all axes), or a selector with axes.
#[derive(Serialize, JsonSchema)]
#[serde(untagged)]
enum FixedInFile {
    Along(FixedAlong),
    All(Selector),
}

#[derive(Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct FixedAlong {
    /// Which nodes.
    #[serde(rename = "where")]
    selector: Selector,
    /// One, two or all of x, y and z; default `xyz`.
    #[serde(default = "all_axes")]
    #[schemars(extend("pattern" = "^[xyz]{1,3}$"))]
    axes: String,
}

fn all_axes() -> String {
    "xyz".into()
}

impl From<Fixed> for FixedInFile {
    fn from(Fixed { selector, axes }: Fixed) -> Self {
        if axes == [true; 3] {
            return Self::All(selector);
        }
        let axes = "xyz"
            .chars()
            .zip(axes)
            .filter_map(|(axis, held)| held.then_some(axis));
        Self::Along(FixedAlong {
            selector,
            axes: axes.collect(),
        })
    }
}

/// Nodes moved by a given displacement.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Prescribed {
    /// Which nodes.
    #[serde(rename = "where")]
    pub selector: Selector,
    /// m along each axis; `null`: the axis is free. At least one number.
    pub displacement: [Option<f64>; 3],
    /// s from time 0 to the full value; default 0: full at time 0.
    #[serde(default)]
    #[schemars(extend("minimum" = 0))]
    pub ramp: f64,
}

/// A force on each selected node.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Load {
    /// Which nodes.
    #[serde(rename = "where")]
    pub selector: Selector,
    /// N on each selected node.
    pub force: [f64; 3],
    /// s from time 0 to the full value; default 0: full at time 0.
    #[serde(default)]
    #[schemars(extend("minimum" = 0))]
    pub ramp: f64,
}

/// State at time 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Start {
    /// The rest shape, at rest. The default.
    #[default]
    Rest,
    /// Static equilibrium, tools ignored, prescribed displacements and loads at full value.
    Equilibrium,
}

/// What is solved.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
pub struct ModelSettings {
    /// Who moves how; default `tensorMass`.
    pub kind: ModelKind,
    /// Hybrid: the selected tetrahedra are tensor-mass, the rest pre-computed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dynamic: Option<Selector>,
    /// Pre-computed part: which of its surface nodes tools can touch; absent: all, where memory allows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub touchable: Option<Selector>,
    /// Hybrid: which shared nodes are connected; default `full`.
    pub connection: Connection,
    /// Hybrid: `null`: all; n: the n softest interface modes plus a constant shift.
    pub interface_modes: Option<usize>,
    /// Hybrid: mass of the interface; default `lumped`.
    pub interface_mass: InterfaceMass,
    /// Material law of the dynamic part; default `linear`.
    pub elasticity: Elasticity,
    /// How the forces of a non-linear law are computed; default `perTetrahedron`.
    pub form: Form,
    /// How linear and non-linear regions meet; default `blend`.
    pub adaptive: Adaptive,
    /// m of displacement from which the law is non-linear; default 0: non-linear everywhere.
    #[schemars(extend("minimum" = 0))]
    pub nonlinear_threshold: f64,
    /// Pa, volume penalty; default 0.
    #[schemars(extend("minimum" = 0))]
    pub incompressibility: f64,
    /// Absent: `constantStrain` where elasticity is linear, else `nodalAveraged`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub element: Option<Element>,
    /// `nodalAveraged`: stabilisation c, 0.2 or more; default 0.3.
    #[schemars(extend("minimum" = 0.2))]
    pub hourglass: f64,
}

impl ModelSettings {
    /// The scene's, or what suits the law.
    pub fn element_in_use(&self) -> Element {
        self.element.unwrap_or(match self.elasticity {
            Elasticity::Linear => Element::ConstantStrain,
            Elasticity::StVenantKirchhoff | Elasticity::StableNeoHookean => Element::NodalAveraged,
        })
    }
}

impl Default for ModelSettings {
    fn default() -> Self {
        Self {
            kind: ModelKind::TensorMass,
            dynamic: None,
            touchable: None,
            connection: Connection::Full,
            interface_modes: None,
            interface_mass: InterfaceMass::Lumped,
            elasticity: Elasticity::Linear,
            form: Form::PerTetrahedron,
            adaptive: Adaptive::Blend,
            nonlinear_threshold: 0.0,
            incompressibility: 0.0,
            element: None,
            hourglass: 0.3,
        }
    }
}

/// Who moves how.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum ModelKind {
    /// Pre-computed compliance, no inertia.
    QuasiStatic,
    /// Mass points and linear tetrahedra. The default.
    #[default]
    TensorMass,
    /// A pre-computed part and a tensor-mass part that can be cut.
    Hybrid,
    /// Mass points and springs along the edges, for comparison; starts at rest only.
    SpringMass,
}

/// `"full"`, or `{"nodes": [..]}`: only these shared nodes are connected.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Connection {
    /// All shared nodes. The default.
    #[default]
    Full,
    /// Only these.
    Nodes(Vec<u32>),
}

/// Mass of the interface of a hybrid model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum InterfaceMass {
    /// The nodes' own. The default.
    #[default]
    Lumped,
    /// The pre-computed part's, condensed.
    Guyan,
}

/// Material law.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Elasticity {
    /// Small strain. The default.
    #[default]
    Linear,
    /// Green strain, large rotations.
    StVenantKirchhoff,
    /// Survives inversion.
    StableNeoHookean,
}

/// How the forces of a non-linear law are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Form {
    /// Stress of each tetrahedron. The default.
    #[default]
    PerTetrahedron,
    /// The papers' stiffness parameters.
    Polynomial,
}

/// How linear and non-linear regions meet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Adaptive {
    /// Smoothly. The default.
    #[default]
    Blend,
    /// The papers' rule.
    PerVertex,
}

/// How vertices make a deformation gradient.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Element {
    /// The linear tetrahedron.
    ConstantStrain,
    /// Volume change averaged at the nodes.
    NodalPressure,
    /// Deformation gradient averaged at the nodes.
    NodalAveraged,
}

/// How the model is integrated in time.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
pub struct Integration {
    /// `null`: the cheapest that is stable, `symplecticEuler` unless its substeps in a haptic period cost
    /// more than a solution of `implicitEuler`.
    pub scheme: Option<Scheme>,
    /// Hz, 1 to 100 000; contact forces are computed at this rate or faster. Default 1000.
    #[schemars(extend("minimum" = 1, "maximum" = 100_000))]
    pub haptic_rate: f64,
    /// s, a whole divisor of the haptic period; `null`: chosen from the critical time step.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub substep: Option<f64>,
    /// 1/s, at most 1e6, mass-proportional; `null`: 1.5 times the lowest frequency (fastest to equilibrium).
    #[schemars(extend("minimum" = 0, "maximum" = 1_000_000))]
    pub damping: Option<f64>,
    /// Default `lumped`.
    pub mass: Mass,
}

impl Default for Integration {
    fn default() -> Self {
        Self {
            scheme: None,
            haptic_rate: 1000.0,
            substep: None,
            damping: None,
            mass: Mass::Lumped,
        }
    }
}

/// Time integration scheme.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Scheme {
    /// Velocity first, then position.
    SymplecticEuler,
    /// Explicit; needs damping.
    Euler,
    /// Explicit, fourth order.
    RungeKutta4,
    /// Explicit, second order.
    CentralDifference,
    /// Linearly implicit, stable at any substep; one sparse solution each.
    ImplicitEuler,
}

/// How mass is given to the nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Mass {
    /// A quarter of each tetrahedron's. The default.
    #[default]
    Lumped,
    /// The same on every node: the papers' choice.
    Uniform,
}

/// What cutting does to the mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
pub struct Cutting {
    /// Default `remove`.
    pub rule: CutRule,
    /// Default `removed`.
    pub mass: CutMass,
    /// How many vertices `duplicate` may make; default: half as many as the dynamic tissue has. When none is
    /// left it removes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spare_vertices: Option<usize>,
}

/// What happens to a cut tetrahedron.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum CutRule {
    /// It is gone. The default.
    #[default]
    Remove,
    /// Its vertices are split; no tissue is lost.
    Duplicate,
}

/// What happens to the mass of a removed tetrahedron.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum CutMass {
    /// It goes with the tetrahedron. The default.
    #[default]
    Removed,
    /// It stays on the nodes.
    Kept,
}

/// A scripted cut: these tetrahedra go at the first substep boundary at or after `time`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Cut {
    /// s, 0 or more.
    #[schemars(extend("minimum" = 0))]
    pub time: f64,
    /// Which tetrahedra.
    #[serde(rename = "where")]
    pub selector: Selector,
}

/// Tetrahedra tear when they deform too much.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Tearing {
    /// What is compared with the threshold.
    pub criterion: TearCriterion,
    /// Relative change, above 0.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub threshold: f64,
    /// Tetrahedra a haptic tick, 1 or more; default 4.
    #[serde(default = "default_budget")]
    #[schemars(extend("minimum" = 1))]
    pub budget: usize,
}

pub(super) fn default_budget() -> usize {
    4
}

/// What makes a tetrahedron tear.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum TearCriterion {
    /// Relative change of volume.
    Volume,
    /// Mean relative change of the six edges' lengths.
    MeanElongation,
    /// Largest relative change of an edge's length.
    MaximumElongation,
}

/// An instrument moved by the host.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Tool {
    /// Unique among the tools.
    #[schemars(extend("minLength" = 1))]
    pub name: String,
    /// What it does when active.
    pub kind: ToolKind,
    /// The tip is at the tool's position, the shaft along its -z.
    pub shape: Shape,
    /// m from the tip, above 0: the part that grasps or burns. Absent: the whole shape.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub active_length: Option<f64>,
    /// Default `stick`.
    #[serde(default)]
    pub friction: Friction,
    /// N at which a grasp slips, above 0; `null`: never.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub slip_force: Option<f64>,
    /// m, start position of the tip.
    pub position: [f64; 3],
    /// Start orientation: a quaternion w x y z, normalised on reading; default `[1, 0, 0, 0]`.
    #[serde(default = "default_orientation")]
    pub orientation: [f64; 4],
}

pub(super) fn default_orientation() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

/// What a tool does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum ToolKind {
    /// Pushes: holds what it touches until that pulls.
    Probe,
    /// Holds what it touches at the moment its jaws close, until they open; open, it touches nothing.
    Grasper,
    /// Burns what its active part touches on its way while the current is on, no faster than it travels; pushes like a
    /// probe while it is off.
    Cautery,
}

/// A capsule's axis runs from the tip's centre (0, 0, 0) to (0, 0, -length); a sphere is centred on the position.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub enum Shape {
    /// m, above 0.
    Sphere { radius: f64 },
    /// m, above 0.
    Capsule { radius: f64, length: f64 },
    /// Several shapes, each placed in the tool's frame.
    Compound(Vec<Part>),
}

/// A shape of a compound.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Part {
    /// What is placed.
    pub shape: Shape,
    /// m, in the tool's frame; default 0.
    #[serde(default)]
    pub position: [f64; 3],
    /// In the tool's frame: a quaternion w x y z, normalised on reading; default `[1, 0, 0, 0]`.
    #[serde(default = "default_orientation")]
    pub orientation: [f64; 4],
}

/// `"stick"`, or a Coulomb coefficient.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Friction {
    /// What touches sticks. The default.
    #[default]
    Stick,
    /// 0 or more.
    #[serde(untagged)]
    Coulomb(f64),
}

/// What the FMU shows of the tissue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
pub struct Outputs {
    /// Which vertices are variables; default `surface`.
    pub vertices: OutputVertices,
    /// Default `output`.
    pub causality: OutputCausality,
    /// Adds `surface.triangle`; default false.
    pub triangles: bool,
}

/// Which vertices are variables.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum OutputVertices {
    /// Those that are, or by cutting can become, part of the surface. The default.
    #[default]
    Surface,
    /// All.
    All,
    /// None.
    None,
}

/// What the vertices are to a host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum OutputCausality {
    /// Connectors. The default.
    #[default]
    Output,
    /// Readable and recordable, but no connector.
    Local,
}
