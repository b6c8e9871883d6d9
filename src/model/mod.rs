//! A scene made ready: everything that never changes while it runs, shared by all instances.

pub mod boundary;
pub mod critical_step;
pub mod dense;
pub mod edge_list;
pub mod element_sweep;
pub mod guyan;
pub mod order;
pub mod parts;
pub mod precomputed;
pub mod scheme;
pub mod spectrum;
pub mod spring_mass;
pub mod spring_sweep;
pub mod stiffness;
pub mod store;
pub mod sweep;
pub mod tensor_mass;

use crate::contact::shape::ToolShape;
use crate::element::Elements;
use crate::element::constant_strain::Shape;
use crate::element::tetrahedra::{self, Extent};
use crate::law::linear::Hooke;
use crate::law::response::Law;
use crate::live::LiveMesh;
use crate::mesh::check::MeshReport;
use crate::mesh::topology::{Face, NONE, Topology};
use crate::mesh::{self, MeshError, TetMesh, Vec3};
use crate::pieces::{Pieces, Tissue, free_modes};
use crate::scene::{
    Connection, CutRule, Elasticity, Element, Form, Incompressibility, InterfaceMass, ModelKind,
    ModelSettings, OutputVertices, Scene, SceneError, Scheme, Selector, Start, ToolKind,
    select_tetrahedra,
};
use crate::star::Worklist;
use crate::statics::StaticsError;
use boundary::Boundary;
use guyan::GuyanMass;
use parts::{Partition, Parts};
use precomputed::{Precomputed, Progress, Sizes};
use spectrum::Spectrum;
use spring_mass::{EDGES, Springs};
use stiffness::Stiffness;
use store::Numbers;
use tensor_mass::{Pattern, Tensors};

/// Meshes of up to so many nodes are factored for their lowest frequency (some tenths of a GB); larger
/// ones are iterated on.
const DIRECT_NODES: usize = 12_000;

/// Averaged elements compute with no larger ratio: from there to 0.5 forces change by a few per cent, and what they
/// still lock by grows, as does the number of substeps.
pub const MOST_POISSON_RATIO: f64 = 0.49;

/// Elementary deformations of all that tools could touch are computed unasked up to so much memory.
const MOST_ELEMENTARY_BYTES: usize = 500_000_000;

/// One entry of the scene's materials.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaterialLaw {
    pub law: Hooke,
    /// \[kg/m³\]
    pub density: f64,
}

/// Tetrahedra to be removed at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct ScriptedCut {
    /// \[s\] from the start.
    pub time: f64,
    pub tetrahedra: Vec<u32>,
}

/// Why a scene makes no model.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("{0}: mesh: {1}")]
    Mesh(String, MeshError),
    #[error("{0}: {1}")]
    Statics(String, StaticsError),
}

/// How many vertices cuts may split.
fn spare_vertices(scene: &Scene, dynamic_nodes: usize) -> usize {
    match (scene.cutting.rule, scene.cutting.spare_vertices) {
        (CutRule::Remove, _) => 0,
        (CutRule::Duplicate, Some(count)) => count,
        (CutRule::Duplicate, None) => dynamic_nodes.div_ceil(2),
    }
}

/// What an earlier build of the same scene has found.
#[derive(Debug, Default)]
pub struct Known {
    pub spectrum: Option<Spectrum>,
    /// Of the pre-computed part.
    pub numbers: Option<Numbers>,
}

/// The immutable part. Nodes are in an order of their own (reverse Cuthill-McKee); tetrahedra are in
/// the scene's order.
#[derive(Debug)]
pub struct Model {
    pub scene: Scene,
    /// Name used in messages.
    pub file: String,
    pub mesh: TetMesh,
    pub report: MeshReport,
    /// Scene number of each node, [`NONE`] for spares. Two nodes have the same where the parts of a hybrid are not connected.
    pub scene_node: Vec<u32>,
    /// Node of each scene number, the moving one of two.
    pub node: Vec<u32>,
    pub parts: Parts,
    pub topology: Topology,
    /// Of the moving nodes.
    pub pattern: Pattern,
    /// A tetrahedron each.
    pub shape: Vec<Shape>,
    /// rho V / 4 of a tetrahedron each: what it adds to the mass of its nodes \[kg\].
    pub quarter: Vec<f64>,
    material_of: Vec<u32>,
    materials: Vec<MaterialLaw>,
    pub boundary: Boundary,
    /// What the tetrahedra that are not dynamic amount to.
    pub precomputed: Option<Precomputed>,
    /// Tells apart what is stored of it.
    pub precomputed_key: u64,
    /// Of the interface, where the scene asks for it.
    pub guyan: Option<GuyanMass>,
    /// The mesh before any cut.
    pub whole: LiveMesh,
    pub spectrum: Spectrum,
    scheme: Scheme,
    /// Rigid motions that nothing holds, over all pieces.
    pub rigid_modes: usize,
    /// Somewhere parts hang together by a vertex alone.
    pub is_pinched: bool,
    /// By time.
    pub cuts: Vec<ScriptedCut>,
    /// One each.
    pub tools: Vec<ToolShape>,
    /// Nodes shown as `surface.vertex`, ascending by scene number.
    pub surface_nodes: Vec<u32>,
    /// Longest rest edge \[m\].
    pub longest_edge: f64,
    /// Of the edges of all tetrahedra, a shared one as often as it is shared \[m\].
    pub mean_edge: f64,
    /// Diagonal of the box around the nodes at rest \[m\].
    pub size: f64,
    /// Displacement of the known nodes at time 0 \[m\].
    pub start_displacement: Vec<Vec3>,
    /// Tells saved states of different models apart.
    pub fingerprint: u64,
}

impl Model {
    pub fn new(scene: Scene, mesh: TetMesh, file: &str) -> Result<Model, ModelError> {
        Model::build(scene, mesh, file, Known::default(), &|_| {})
    }

    /// What is `known` from an earlier build is not computed again.
    pub fn build(
        scene: Scene,
        mut mesh: TetMesh,
        file: &str,
        known: Known,
        progress: Progress,
    ) -> Result<Model, ModelError> {
        let report =
            mesh::check::repair(&mut mesh).map_err(|e| ModelError::Mesh(file.to_string(), e))?;
        let (materials, material_of) = assign_materials(&scene, &mesh, file)?;
        let mut boundary = Boundary::new(&scene, &mesh, file)?;
        if scene.start == Start::Equilibrium {
            boundary.end_ramps();
        }
        let mut cuts = Vec::new();
        for (k, cut) in scene.cuts.iter().enumerate() {
            let path = format!("cuts[{k}].where");
            cuts.push(ScriptedCut {
                time: cut.time,
                tetrahedra: chosen(&cut.selector, &mesh, file, path)?,
            });
        }
        cuts.sort_by(|a, b| a.time.total_cmp(&b.time));

        let scene_nodes = mesh.nodes.len();
        let key = precomputed_key(&scene, &mesh);
        let fingerprint = fingerprint(&scene, &mesh);
        let partition = Partition::new(&scene, mesh, file)?;
        let (order, mut parts) = partition.order(&scene, file)?;
        let spares = spare_vertices(&scene, parts.moving);
        parts.spares = spares;
        parts.moving += spares;
        parts.known += spares;
        let mut node = vec![0; order.len()];
        for (new, old) in order.iter().enumerate() {
            node[*old as usize] = (spares + new) as u32;
        }
        // Spares lie somewhere.
        let somewhere = partition.mesh.nodes.first().copied();
        let mesh = TetMesh {
            nodes: std::iter::repeat_n(somewhere.unwrap_or_default(), spares)
                .chain(order.iter().map(|old| partition.mesh.nodes[*old as usize]))
                .collect(),
            tetrahedra: (partition.mesh.tetrahedra.iter())
                .map(|t| t.map(|v| node[v as usize]))
                .collect(),
        };
        let scene_node: Vec<u32> = std::iter::repeat_n(NONE, spares)
            .chain(order.iter().map(|old| partition.origin[*old as usize]))
            .collect();
        node.truncate(scene_nodes);
        let boundary = boundary.renumbered(&node, &scene_node);
        let topology = Topology::new(&mesh);
        let moves = |t: &usize| parts.dynamic[*t];
        let dynamic: Vec<[u32; 4]> = (0..mesh.tetrahedra.len())
            .filter(moves)
            .map(|t| mesh.tetrahedra[t])
            .collect();
        let pattern = Pattern::with_spares(spares, parts.moving, &dynamic);
        let shape: Vec<Shape> = mesh
            .tetrahedra
            .iter()
            .map(|t| Shape::new(t.map(|v| mesh.nodes[v as usize])))
            .collect();
        let quarter = (shape.iter().zip(&material_of))
            .map(|(shape, m)| materials[*m as usize].density * shape.volume / 4.0)
            .collect();
        let lengths = || {
            let edges = (mesh.tetrahedra.iter()).flat_map(|t| EDGES.map(|(a, b)| (t[a], t[b])));
            edges.map(|(a, b)| (mesh.nodes[a as usize] - mesh.nodes[b as usize]).norm())
        };
        let longest_edge = lengths().fold(0.0, f64::max);
        let mean_edge = lengths().sum::<f64>() / (6 * mesh.tetrahedra.len()) as f64;
        let (low, high) = (mesh.nodes.iter()).fold(
            (Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY)),
            |(low, high), x| (low.inf(x), high.sup(x)),
        );
        let mut model = Model {
            file: file.to_string(),
            report,
            scene_node,
            node,
            topology,
            pattern,
            shape,
            quarter,
            material_of,
            materials,
            boundary,
            precomputed: None,
            precomputed_key: key,
            guyan: None,
            whole: LiveMesh::default(),
            spectrum: Spectrum {
                lowest: 0.0,
                highest: 0.0,
                element_bound: 0.0,
            },
            scheme: Scheme::SymplecticEuler,
            rigid_modes: 0,
            is_pinched: false,
            cuts,
            tools: scene.tools.iter().map(ToolShape::new).collect(),
            surface_nodes: Vec::new(),
            longest_edge,
            mean_edge,
            size: (high - low).norm(),
            start_displacement: vec![Vec3::zeros(); parts.known],
            parts,
            fingerprint,
            mesh,
            scene,
        };
        // A node without tetrahedra has nothing to move.
        for v in 0..model.mesh.nodes.len() {
            if model.topology.star(v).is_empty() {
                model.boundary.free[v] = [false; 3];
            } else if model.boundary.free[v] != [true; 3] {
                model.boundary.supported.push(v as u32);
            }
        }
        model.whole = LiveMesh::whole(&model);
        model.is_pinched = Worklist::default().is_pinched(&model, &model.whole);
        model.surface_nodes = model.shown_nodes();
        model.rigid_modes = model.whole.pieces.rigid_modes;
        model.check_cuts()?;
        if model.parts.has_precomputed() {
            model.precompute(known.numbers, progress)?;
        }
        model.spectrum = match known.spectrum {
            Some(spectrum) => spectrum,
            None => model.compute_spectrum()?,
        };
        model.scheme = model.choose_scheme()?;
        model.start_displacement = model.displacement_at_start()?;
        Ok(model)
    }

    /// The mesh with the scene's numbers.
    pub fn scene_mesh(&self) -> TetMesh {
        TetMesh {
            nodes: self
                .node
                .iter()
                .map(|k| self.mesh.nodes[*k as usize])
                .collect(),
            tetrahedra: (self.mesh.tetrahedra.iter())
                .map(|t| t.map(|v| self.scene_node[v as usize]))
                .collect(),
        }
    }

    /// The same mesh with another scene.
    pub fn with_scene(&self, scene: Scene) -> Result<Model, ModelError> {
        let mesh = self.scene_mesh();
        let same = precomputed_key(&scene, &mesh) == self.precomputed_key;
        let known = Known {
            numbers: self
                .precomputed
                .as_ref()
                .filter(|_| same)
                .map(|p| p.shared()),
            ..Known::default()
        };
        Model::build(scene, mesh, &self.file, known, &|_| {})
    }

    /// K on the moving nodes with the tensors of a live mesh.
    pub fn stiffness<'a>(&'a self, tensors: &'a Tensors) -> Stiffness<'a> {
        let part = self.precomputed.as_ref();
        Stiffness {
            pattern: &self.pattern,
            tensors,
            interface: part.map(|p| (&p.interface, self.parts.connected_from())),
        }
    }

    pub fn has_guyan_mass(&self) -> bool {
        self.scene.model.interface_mass == InterfaceMass::Guyan && self.parts.connection > 0
    }

    /// Only what is dynamic can be cut.
    fn check_cuts(&self) -> Result<(), SceneError> {
        for (k, cut) in self.scene.cuts.iter().enumerate() {
            let path = format!("cuts[{k}].where");
            let scene_mesh = self.scene_mesh();
            let chosen = chosen(&cut.selector, &scene_mesh, &self.file, path.clone())?;
            let fixed = chosen.iter().filter(|t| !self.parts.dynamic[**t as usize]);
            let count = fixed.count();
            if count > 0 {
                return Err(SceneError::at(
                    &self.file,
                    path,
                    format!(
                        "selects {count} tetrahedra of the pre-computed part; must select dynamic ones only"
                    ),
                ));
            }
        }
        Ok(())
    }

    /// Bytes of elementary deformations.
    pub fn elementary_bytes(&self) -> usize {
        let sizes = Sizes::of(self);
        8 * sizes.lengths().iter().sum::<usize>()
    }

    fn precompute(&mut self, known: Option<Numbers>, progress: Progress) -> Result<(), ModelError> {
        let bytes = self.elementary_bytes();
        if self.scene.model.touchable.is_none() && bytes > MOST_ELEMENTARY_BYTES {
            return Err(SceneError::at(
                &self.file,
                "model.touchable",
                format!(
                    "is needed: elementary deformations of all {} surface nodes of the pre-computed part would take {:.1} GB; must select the nodes that tools can touch",
                    self.parts.touchable,
                    bytes as f64 / 1e9
                ),
            )
            .into());
        }
        if self.precomputed_rigid_modes(true) > 0 {
            let (path, what) = match self.scene.model.connection {
                Connection::Nodes(_) => (
                    "model.connection.nodes",
                    "lets a pre-computed piece turn or come off; must connect at least three nodes of each that are not in line, or the piece must be fixed",
                ),
                Connection::Full => (
                    "fixed",
                    "a pre-computed piece is not held against every rigid motion; must fix at least three nodes of it that are not in line",
                ),
            };
            return Err(SceneError::at(&self.file, path, what).into());
        }
        let stored = known.and_then(|numbers| Precomputed::from_numbers(self, numbers));
        let part = match stored {
            Some(part) => part,
            None => {
                let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
                let numbers = precomputed::compute(self, threads, progress)
                    .map_err(|e| ModelError::Statics(self.file.clone(), e))?;
                Precomputed::from_numbers(self, numbers.into())
                    .ok_or_else(|| ModelError::Statics(self.file.clone(), StaticsError::Memory))?
            }
        };
        self.guyan = part.guyan.as_ref().map(|mass| GuyanMass::new(self, mass));
        self.precomputed = Some(part);
        Ok(())
    }

    /// Of springs: the highest frequencies are bounds at any stretch, the lowest is that at rest.
    fn compute_spectrum(&self) -> Result<Spectrum, ModelError> {
        let (live, moving) = (&self.whole, self.parts.moving);
        let (mass, free) = (&live.mass[..moving], &self.boundary.free[..moving]);
        let springs = (live.springs.as_ref()).map(|springs| {
            let (bound, rest) = (Springs::tangent_bound, Springs::tangent_at_rest);
            (bound(springs, &self.pattern), rest(springs, &self.pattern))
        });
        let tangent = live.elements.as_ref().map(|_| live.tangent_at_rest(self));
        let at_rest = match &tangent {
            None => self.stiffness(&live.tensors),
            Some((pattern, tensors)) => Stiffness {
                pattern,
                ..self.stiffness(tensors)
            },
        };
        let (stiffest, stiffness) = match &springs {
            Some((bound, rest)) => (self.stiffness(bound), self.stiffness(rest)),
            None => (at_rest, at_rest),
        };
        let highest = spectrum::highest(stiffest, mass, free);
        let lowest = if moving <= DIRECT_NODES {
            let lowest = |loose| spectrum::lowest(stiffness, mass, free, highest, loose);
            match lowest(self.rigid_modes) {
                // Hinges are no rigid motions, but loose all the same.
                Err(StaticsError::NotHeld) if springs.is_some() => lowest(self.rigid_modes.max(1)),
                found => found,
            }
            .map_err(|e| ModelError::Statics(self.file.clone(), e))?
        } else if self.scene.integration.damping.is_some() {
            0.0
        } else if self.rigid_modes > 0 {
            return Err(SceneError::at(
                &self.file,
                "integration.damping",
                format!(
                    "is needed for loose tissue of over {DIRECT_NODES} nodes; its default takes the lowest frequency, which is too dear to find"
                ),
            )
            .into());
        } else {
            spectrum::lowest_held(stiffness, mass, free)
        };
        // Condensed tissue is softer than what it stands for, so that every tetrahedron that moves, or
        // moves connection nodes, bounds.
        let bounds = |t: &usize| {
            let nodes = &self.mesh.tetrahedra[*t];
            nodes.iter().any(|v| (*v as usize) < moving)
        };
        let penalty = live.penalty();
        let element_bound = (0..self.shape.len())
            .filter(bounds)
            .map(|t| {
                let (shape, MaterialLaw { law, density }) = (&self.shape[t], self.material(t));
                match self.scene.model.kind {
                    ModelKind::SpringMass => {
                        let rest = self.rest_positions(t);
                        spring_mass::largest_eigenvalue(law, shape.volume, &rest, *density)
                    }
                    _ => {
                        let law = law.with_penalty(penalty).at_rest();
                        // Means are below what they are taken of, and above where lambda is negative.
                        let law = match self.element() {
                            Element::NodalPressure if law.lambda < 0.0 => law.without_lambda(),
                            _ => law,
                        };
                        let own = shape.largest_eigenvalue(&law, *density);
                        // The hourglass term comes on top.
                        let hourglass = match self.is_averaged() {
                            true => self.scene.model.hourglass * law.mu,
                            false => 0.0,
                        };
                        let gradients: f64 = shape.gradient.iter().map(|a| a.norm_squared()).sum();
                        own + hourglass * gradients * 4.0 / density
                    }
                }
            })
            .fold(0.0, f64::max)
            .sqrt();
        Ok(Spectrum {
            lowest,
            highest,
            element_bound,
        })
    }

    /// Of the vertices of tetrahedron `t` \[m\].
    pub fn rest_positions(&self, t: usize) -> [Vec3; 4] {
        self.mesh.tetrahedra[t].map(|v| self.mesh.nodes[v as usize])
    }

    /// Internal force \[N\] and elastic energy \[J\] of dynamic tetrahedron `t`, a vertex each.
    pub(crate) fn tetrahedron_force(
        &self,
        live: &LiveMesh,
        t: usize,
        u: &[Vec3; 4],
    ) -> ([Vec3; 4], [f64; 4]) {
        let (shape, law) = (&self.shape[t], &live.material(self, t));
        match self.scene.model.kind {
            ModelKind::SpringMass => {
                spring_mass::tetrahedron_force(law, shape.volume, &self.rest_positions(t), u)
            }
            _ if self.is_adaptive() => {
                let mut force = shape.linear_force(law, u);
                let mut energy = std::array::from_fn(|k| 0.5 * u[k].dot(&force[k]));
                if let Some(blend) = &live.blend {
                    let (extra, own, _) = blend.force(law, shape, u);
                    for k in 0..4 {
                        force[k] += extra[k];
                        energy[k] += 0.25 * own;
                    }
                }
                (force, energy)
            }
            _ => match self.law() {
                None => {
                    let force = shape.linear_force(law, u);
                    (force, std::array::from_fn(|k| 0.5 * u[k].dot(&force[k])))
                }
                Some(kind) => {
                    let law = match self.element() {
                        Element::ConstantStrain => *law,
                        // The rest is that of its vertices.
                        Element::NodalPressure => law.without_lambda(),
                        // As all but the guard.
                        Element::NodalAveraged => {
                            let (force, energy) = live.guard_force(self, t, u);
                            return (force, [0.25 * energy; 4]);
                        }
                    };
                    let (force, energy) = tetrahedra::force(kind, &law, shape, u);
                    (force, [0.25 * energy; 4])
                }
            },
        }
    }

    /// Of the dynamic tetrahedra, where elements have it; none where tensors or springs do.
    pub fn law(&self) -> Option<Law> {
        law(&self.scene)
    }

    /// Whether the dynamic tetrahedra have a law for large deformation.
    pub fn is_nonlinear(&self) -> bool {
        is_nonlinear(&self.scene)
    }

    /// The dynamic tetrahedra as elements, or the others.
    pub(crate) fn elements(&self, law: Law, dynamic: bool) -> Elements {
        let of = |t: usize| {
            let t = Some(t).filter(|t| self.parts.dynamic[*t] == dynamic)?;
            let number = self.material_number(t);
            Some((&self.shape[t], &self.material(t).law, number))
        };
        Elements::new(law, &self.scene.model, &self.mesh.tetrahedra, of)
    }

    /// The pre-computed tetrahedra, where vertices have points.
    pub(crate) fn elements_inside(&self) -> Option<Elements> {
        let has_points = self.element() != Element::ConstantStrain;
        (self.parts.has_precomputed() && has_points).then(|| self.elements(Law::Linear, false))
    }

    /// Bound of the largest eigenvalue of M^-1 K of tissue so deformed, relative to that at rest.
    pub fn stiffening(&self, extent: &Extent, penalty: f64) -> f64 {
        let Some(law) = self.law() else {
            return 1.0;
        };
        let each = self.materials.iter().map(|m| {
            let at_rest = m.law.with_penalty(self.whole.penalty());
            law.stiffening(&at_rest, &m.law.with_penalty(penalty), extent)
        });
        each.fold(1.0, f64::max)
    }

    /// The scene's volume penalty k \[Pa\].
    pub(crate) fn scene_penalty(&self) -> f64 {
        match self.scene.model.incompressibility {
            Incompressibility::Pressure(penalty) => penalty,
            Incompressibility::BulkModulus => {
                let dynamic = (0..self.shape.len()).filter(|t| self.parts.dynamic[*t]);
                let (mut sum, mut volume) = (0.0, 0.0);
                for t in dynamic {
                    sum += self.shape[t].volume * self.material(t).law.bulk_modulus();
                    volume += self.shape[t].volume;
                }
                sum / volume
            }
        }
    }

    /// Whether tissue has the linear law where it hardly deforms.
    pub fn is_adaptive(&self) -> bool {
        is_adaptive(&self.scene)
    }

    /// Whether there may be a volume penalty.
    pub fn takes_penalty(&self) -> bool {
        let is_sum = self.scene.model.form == Form::PerTetrahedron;
        self.is_nonlinear() && !self.is_adaptive() && is_sum
    }

    /// How vertices make its deformation gradients.
    pub fn element(&self) -> Element {
        self.scene.model.element()
    }

    /// Whether a vertex has one deformation gradient for all its tetrahedra.
    pub fn is_averaged(&self) -> bool {
        is_averaged(&self.scene)
    }

    /// Of tetrahedron `t`, among the scene's materials.
    pub(crate) fn material_number(&self, t: usize) -> u32 {
        self.material_of[t]
    }

    /// Whether a tetrahedron's energy is a quadratic form: then schemes' accounts close to round-off.
    pub fn is_quadratic(&self) -> bool {
        self.scene.model.kind != ModelKind::SpringMass && !self.is_nonlinear()
    }

    /// Of tetrahedron `t`.
    pub fn material(&self, t: usize) -> &MaterialLaw {
        &self.materials[self.material_of[t] as usize]
    }

    /// Index into the scene's `materials` of tetrahedron `t`.
    pub fn material_index(&self, t: usize) -> usize {
        self.material_of[t] as usize
    }

    /// Whether any tetrahedron can ever be removed.
    pub fn can_be_cut(&self) -> bool {
        !self.cuts.is_empty()
            || self.scene.tearing.is_some()
            || self.scene.tools.iter().any(|t| t.kind == ToolKind::Cautery)
    }

    /// By scene number, a moving node before its copy.
    fn shown_nodes(&self) -> Vec<u32> {
        let mut shown = vec![false; self.parts.known];
        let cuttable = self.can_be_cut();
        match self.scene.outputs.vertices {
            OutputVertices::None => {}
            OutputVertices::All => shown[self.parts.spares..].fill(true),
            OutputVertices::Surface => {
                for v in 0..self.parts.moving {
                    shown[v] = cuttable && self.whole.star_count[v] > 0;
                }
                let on_boundary = |f: &&Face| f.tetrahedra[1] == NONE;
                for face in self.topology.faces.iter().filter(on_boundary) {
                    face.vertices.iter().for_each(|v| shown[*v as usize] = true);
                }
            }
        }
        let mut nodes: Vec<u32> = (0..self.parts.known as u32)
            .filter(|v| shown[*v as usize])
            .collect();
        nodes.sort_by_key(|v| self.shown_key(*v));
        if self.scene.outputs.vertices != OutputVertices::None {
            // In the order in which they are used.
            nodes.extend((0..self.parts.spares as u32).rev());
        }
        nodes
    }

    fn shown_key(&self, node: u32) -> (u32, u32) {
        match self.scene_node[node as usize] {
            NONE => (NONE, self.parts.spares as u32 - node),
            scene_node => (
                scene_node,
                u32::from(self.node[scene_node as usize] != node),
            ),
        }
    }

    /// Place of a node among the shown ones, or -1.
    pub fn shown_index(&self, node: u32) -> i32 {
        self.surface_nodes
            .binary_search_by_key(&self.shown_key(node), |n| self.shown_key(*n))
            .map_or(-1, |k| k as i32)
    }

    fn displacement_at_start(&self) -> Result<Vec<Vec3>, ModelError> {
        match self.scene.start {
            Start::Rest => Ok(vec![Vec3::zeros(); self.parts.known]),
            Start::Equilibrium => crate::reference::equilibrium(self, &self.whole)
                .map(|solution| {
                    let mut u = solution.displacement;
                    u.truncate(self.parts.known);
                    u
                })
                .map_err(|e| ModelError::Statics(self.file.clone(), e)),
        }
    }

    /// Faces that can ever be exposed.
    pub fn exposable_faces(&self) -> usize {
        if !self.can_be_cut() {
            return self.whole.surface.len();
        }
        let may_go = |t: &u32| *t == NONE || self.parts.dynamic[*t as usize];
        (self.topology.faces.iter())
            .filter(|f| f.tetrahedra.iter().any(may_go))
            .count()
    }

    /// Rigid motions that nothing holds, of the pieces of the pre-computed part alone, its connection nodes free or
    /// held.
    pub fn precomputed_rigid_modes(&self, connection_held: bool) -> usize {
        let inside: Vec<bool> = self.parts.dynamic.iter().map(|d| !d).collect();
        let tissue = Tissue {
            tetrahedra: &self.mesh.tetrahedra,
            alive: &inside,
            star_count: &[],
            origin: &[],
        };
        let pieces = Pieces::whole(self, &tissue);
        let moving = self.parts.moving;
        let modes = |label: usize| {
            let nodes = (0..pieces.label.len()).filter(|v| pieces.label[*v] as usize == label);
            free_modes(nodes.map(|v| match v < moving && connection_held {
                true => (self.mesh.nodes[v], [false; 3]),
                false => (self.mesh.nodes[v], self.boundary.free[v]),
            }))
        };
        let labels = (0..pieces.label.len()).filter(|v| pieces.label[*v] as usize == *v);
        labels.map(modes).sum()
    }
}

fn chosen(
    selector: &Selector,
    mesh: &TetMesh,
    file: &str,
    path: String,
) -> Result<Vec<u32>, SceneError> {
    select_tetrahedra(selector, mesh).map_err(|e| SceneError::at(file, path, e))
}

fn law(scene: &Scene) -> Option<Law> {
    let has_points = scene.model.element() != Element::ConstantStrain;
    match (scene.model.kind, scene.model.elasticity) {
        (ModelKind::SpringMass, _) => None,
        (_, Elasticity::Linear) => has_points.then_some(Law::Linear),
        (_, Elasticity::StVenantKirchhoff) => Some(Law::StVenantKirchhoff),
        (_, Elasticity::StableNeoHookean) => Some(Law::StableNeoHookean),
    }
}

fn is_nonlinear(scene: &Scene) -> bool {
    law(scene).is_some_and(|law| law != Law::Linear)
}

fn is_adaptive(scene: &Scene) -> bool {
    is_nonlinear(scene) && scene.model.nonlinear_threshold > 0.0
}

fn is_averaged(scene: &Scene) -> bool {
    law(scene).is_some() && scene.model.element() == Element::NodalAveraged
}

fn assign_materials(
    scene: &Scene,
    mesh: &TetMesh,
    file: &str,
) -> Result<(Vec<MaterialLaw>, Vec<u32>), SceneError> {
    let mut of = vec![NONE; mesh.tetrahedra.len()];
    let mut laws = Vec::new();
    for (k, material) in scene.materials.iter().enumerate() {
        for t in chosen(
            &material.selector,
            mesh,
            file,
            format!("materials[{k}].where"),
        )? {
            of[t as usize] = k as u32;
        }
        let most = match is_averaged(scene) {
            true => MOST_POISSON_RATIO,
            false => 0.5,
        };
        let mut law = Hooke::new(material.young_modulus, material.poisson_ratio.min(most));
        if let Some(fibre) = &material.fibre {
            law = law.with_fibre(Vec3::from(fibre.direction), fibre.lambda, fibre.mu);
        }
        if !law.is_stable() {
            return Err(SceneError::at(
                file,
                format!("materials[{k}].fibre"),
                "makes some strains release energy; lambda and mu along the fibre must be larger",
            ));
        }
        laws.push(MaterialLaw {
            law,
            density: material.density,
        });
    }
    let bare = of.iter().filter(|m| **m == NONE).count();
    if let Some(first) = of.iter().position(|m| *m == NONE) {
        return Err(SceneError::at(
            file,
            "materials",
            format!(
                "{bare} tetrahedra have no material (the first is {first}); let one entry select {{\"all\": true}}"
            ),
        ));
    }
    Ok((laws, of))
}

fn neighbours(mesh: &TetMesh) -> Vec<Vec<u32>> {
    let mut neighbours = vec![Vec::new(); mesh.nodes.len()];
    for t in &mesh.tetrahedra {
        for a in t {
            neighbours[*a as usize].extend(t.iter().filter(|b| *b != a));
        }
    }
    for list in &mut neighbours {
        list.sort_unstable();
        list.dedup();
    }
    neighbours
}

/// Grows with every change of node order or of what is stored.
const KEY_VERSION: u32 = 2;

/// FNV-1a over what the pre-computed part follows from.
pub fn precomputed_key(scene: &Scene, mesh: &TetMesh) -> u64 {
    let mut hash = Fnv::default();
    hash.write(&KEY_VERSION.to_le_bytes());
    // Nothing stored depends on the modes in use.
    let model = ModelSettings {
        interface_modes: None,
        ..scene.model.clone()
    };
    let parts = (
        (
            &scene.materials,
            &scene.fixed,
            &scene.prescribed,
            &scene.loads,
        ),
        (&model, scene.integration.mass, scene.outputs.vertices),
        scene.start == Start::Equilibrium,
        scene.tools.is_empty(),
    );
    if let Ok(text) = serde_json::to_vec(&parts) {
        hash.write(&text);
    }
    hash.mesh(mesh);
    hash.0
}

/// FNV-1a over the scene as written and the mesh.
pub fn fingerprint(scene: &Scene, mesh: &TetMesh) -> u64 {
    let mut hash = Fnv::default();
    // Gravity is the host's to change, and part of the state.
    let scene = Scene {
        gravity: [0.0; 3],
        ..scene.clone()
    };
    if let Ok(text) = serde_json::to_vec(&scene) {
        hash.write(&text);
    }
    hash.mesh(mesh);
    hash.0
}

/// FNV-1a, 64 bits.
pub struct Fnv(pub u64);

impl Default for Fnv {
    fn default() -> Fnv {
        Fnv(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    fn mesh(&mut self, mesh: &TetMesh) {
        for p in &mesh.nodes {
            p.iter()
                .for_each(|x| self.write(&x.to_bits().to_le_bytes()));
        }
        mesh.tetrahedra
            .iter()
            .flatten()
            .for_each(|v| self.write(&v.to_le_bytes()));
    }

    pub fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3);
        }
    }
}
