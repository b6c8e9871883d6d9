//! A scene made ready: everything that never changes while it runs, shared by all instances.

pub mod boundary;
pub mod critical_step;
pub mod edge_list;
pub mod order;
pub mod spectrum;
pub mod sweep;
pub mod tensor_mass;

use crate::element::constant_strain::Shape;
use crate::law::linear::Hooke;
use crate::live::{LiveMesh, component_labels};
use crate::mesh::check::MeshReport;
use crate::mesh::topology::{NONE, Topology};
use crate::mesh::{self, MeshError, TetMesh, Vec3};
use crate::scene::{
    CutMass, Mass, OutputVertices, Scene, SceneError, Scheme, Selector, Start, ToolKind,
    select_tetrahedra,
};
use crate::statics::StaticsError;
use boundary::Boundary;
use nalgebra::{Matrix6, SymmetricEigen, Vector6};
use spectrum::Spectrum;
use sweep::Advance;
use tensor_mass::Pattern;

/// Share of the guaranteed critical step that a chosen substep may use.
pub const STEP_MARGIN: f64 = 0.9;

/// Share of the mesh's own critical step that it may use. Hosts change their communication step, and
/// with it the substep: two lengths a, b in turn feed a mode where
/// (omega a + omega b)² - (omega a omega b)² > 4, far below the critical step; at half of it no pattern
/// of two does.
pub const UNEVEN_STEP_MARGIN: f64 = 0.5;

/// Meshes of up to so many nodes are factored for their lowest frequency (some tenths of a GB); larger
/// ones are iterated on.
const DIRECT_NODES: usize = 12_000;

/// Default damping in units of the lowest angular frequency: fastest to equilibrium
/// (0.75 of critical; see the equations of the manual).
pub const DAMPING_IN_LOWEST_FREQUENCIES: f64 = 1.5;

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

/// The immutable part. Nodes are in an order of their own (reverse Cuthill-McKee); tetrahedra are in
/// the scene's order.
#[derive(Debug)]
pub struct Model {
    pub scene: Scene,
    /// Name used in messages.
    pub file: String,
    pub mesh: TetMesh,
    pub report: MeshReport,
    /// Scene number of each node.
    pub scene_node: Vec<u32>,
    /// Node of each scene number.
    pub node: Vec<u32>,
    pub topology: Topology,
    pub pattern: Pattern,
    /// A tetrahedron each.
    pub shape: Vec<Shape>,
    material_of: Vec<u32>,
    materials: Vec<MaterialLaw>,
    pub boundary: Boundary,
    /// The mesh before any cut.
    pub whole: LiveMesh,
    pub spectrum: Spectrum,
    /// Rigid motions that nothing holds, over all pieces.
    pub rigid_modes: usize,
    /// By time.
    pub cuts: Vec<ScriptedCut>,
    /// Nodes shown as `surface.vertex`, ascending by scene number.
    pub surface_nodes: Vec<u32>,
    /// Longest rest edge \[m\].
    pub longest_edge: f64,
    /// Displacement at time 0 \[m\].
    pub start_displacement: Vec<Vec3>,
    /// Tells saved states of different models apart.
    pub fingerprint: u64,
}

impl Model {
    /// `spectrum`: known from an earlier build of the same scene, or computed.
    pub fn new(scene: Scene, mesh: TetMesh, file: &str) -> Result<Model, ModelError> {
        Model::with_spectrum(scene, mesh, file, None)
    }

    pub fn with_spectrum(
        scene: Scene,
        mut mesh: TetMesh,
        file: &str,
        known: Option<Spectrum>,
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

        let scene_node = order::reverse_cuthill_mckee(&neighbours(&mesh));
        let mut node = vec![0; scene_node.len()];
        for (new, old) in scene_node.iter().enumerate() {
            node[*old as usize] = new as u32;
        }
        mesh = TetMesh {
            nodes: scene_node
                .iter()
                .map(|old| mesh.nodes[*old as usize])
                .collect(),
            tetrahedra: mesh
                .tetrahedra
                .iter()
                .map(|t| t.map(|v| node[v as usize]))
                .collect(),
        };
        let boundary = boundary.renumbered(&node);
        let topology = Topology::new(&mesh);
        let pattern = Pattern::new(mesh.nodes.len(), &mesh.tetrahedra);
        let shape: Vec<Shape> = mesh
            .tetrahedra
            .iter()
            .map(|t| Shape::new(t.map(|v| mesh.nodes[v as usize])))
            .collect();
        let longest_edge = mesh
            .tetrahedra
            .iter()
            .flat_map(|t| {
                [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)].map(|(a, b)| (t[a], t[b]))
            })
            .map(|(a, b)| (mesh.nodes[a as usize] - mesh.nodes[b as usize]).norm_squared())
            .fold(0.0, f64::max)
            .sqrt();
        let fingerprint = fingerprint(&scene, &mesh);
        let mut model = Model {
            file: file.to_string(),
            report,
            scene_node,
            node,
            topology,
            pattern,
            shape,
            material_of,
            materials,
            boundary,
            whole: LiveMesh::default(),
            spectrum: Spectrum {
                lowest: 0.0,
                highest: 0.0,
                element_bound: 0.0,
            },
            rigid_modes: 0,
            cuts,
            surface_nodes: Vec::new(),
            longest_edge,
            start_displacement: vec![Vec3::zeros(); mesh.nodes.len()],
            fingerprint,
            mesh,
            scene,
        };
        model.whole = LiveMesh::whole(&model);
        // A node without tetrahedra has nothing to move.
        for (free, stars) in model.boundary.free.iter_mut().zip(&model.whole.star_count) {
            if *stars == 0 {
                *free = [false; 3];
            }
        }
        model.surface_nodes = model.shown_nodes();
        model.rigid_modes = model.count_rigid_modes(&model.whole.alive);
        model.spectrum = match known {
            Some(spectrum) => spectrum,
            None => model.compute_spectrum()?,
        };
        model.start_displacement = model.displacement_at_start()?;
        Ok(model)
    }

    /// The same mesh with another scene.
    pub fn with_scene(&self, scene: Scene) -> Result<Model, ModelError> {
        let mesh = TetMesh {
            nodes: self
                .node
                .iter()
                .map(|k| self.mesh.nodes[*k as usize])
                .collect(),
            tetrahedra: (self.mesh.tetrahedra.iter())
                .map(|t| t.map(|v| self.scene_node[v as usize]))
                .collect(),
        };
        Model::new(scene, mesh, &self.file)
    }

    fn compute_spectrum(&self) -> Result<Spectrum, ModelError> {
        let (pattern, live, free) = (&self.pattern, &self.whole, &self.boundary.free);
        let highest = spectrum::highest(pattern, &live.tensors, &live.mass, free);
        let lowest = if self.mesh.nodes.len() <= DIRECT_NODES {
            spectrum::lowest(
                pattern,
                &live.tensors,
                &live.mass,
                free,
                highest,
                self.rigid_modes,
            )
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
            spectrum::lowest_held(pattern, &live.tensors, &live.mass, free)
        };
        let element_bound = (0..self.shape.len())
            .map(|t| {
                let material = self.material(t);
                self.shape[t].largest_eigenvalue(&material.law, material.density)
            })
            .fold(0.0, f64::max)
            .sqrt();
        Ok(Spectrum {
            lowest,
            highest,
            element_bound,
        })
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
        !self.cuts.is_empty() || self.scene.tools.iter().any(|t| t.kind == ToolKind::Cautery)
    }

    /// The angular frequency that limits the substep \[1/s\]: where lumped mass goes with what is cut the
    /// bound by elements, else the highest of the whole mesh (which cuts can only lower).
    pub fn limiting_frequency(&self) -> f64 {
        let mass_goes = self.scene.cutting.mass == CutMass::Removed
            && self.scene.integration.mass == Mass::Lumped;
        if self.can_be_cut() && mass_goes {
            self.spectrum.element_bound
        } else {
            self.spectrum.highest
        }
    }

    /// Mass-proportional damping at the start \[1/s\].
    pub fn damping(&self) -> f64 {
        self.scene
            .integration
            .damping
            .unwrap_or(DAMPING_IN_LOWEST_FREQUENCIES * self.spectrum.lowest)
    }

    /// Largest stable substep \[s\] at a damping \[1/s\].
    pub fn critical_step(&self, damping: f64) -> f64 {
        self.critical_step_at(self.limiting_frequency(), damping)
    }

    /// The same for a mesh of another highest angular frequency \[1/s\].
    pub(crate) fn critical_step_at(&self, omega: f64, damping: f64) -> f64 {
        match self.scene.integration.scheme {
            Scheme::CentralDifference => critical_step::central_difference(omega),
            _ => critical_step::symplectic_euler(omega, damping),
        }
    }

    /// The part of damping \[1/s\] that acts on the lagging velocity alone: none of central
    /// difference's.
    pub(crate) fn lagging_damping(&self, damping: f64) -> f64 {
        match self.scene.integration.scheme {
            Scheme::CentralDifference => 0.0,
            _ => damping,
        }
    }

    /// One substep by the scene's scheme after one of length `before` \[s\].
    pub(crate) fn advance(&self, before: f64, substep: f64, damping: f64) -> Advance {
        match self.scene.integration.scheme {
            Scheme::CentralDifference => Advance::central_difference(before, substep, damping),
            _ => Advance::symplectic_euler(before, substep, damping),
        }
    }

    /// The scene's substep, or the longest whole divisor of the haptic period that is stable with both
    /// margins \[s\].
    pub fn substep(&self, damping: f64) -> f64 {
        let period = 1.0 / self.scene.integration.haptic_rate;
        let own = self.critical_step_at(self.spectrum.highest, damping);
        let limit = (STEP_MARGIN * self.critical_step(damping)).min(UNEVEN_STEP_MARGIN * own);
        let parts = match self.scene.integration.substep {
            Some(substep) => (period / substep).round(),
            None => (period / limit - 1e-9).ceil(),
        };
        period / parts.max(1.0)
    }

    fn shown_nodes(&self) -> Vec<u32> {
        let mut shown = vec![false; self.mesh.nodes.len()];
        match self.scene.outputs.vertices {
            OutputVertices::None => {}
            OutputVertices::All => shown.fill(true),
            OutputVertices::Surface if self.can_be_cut() => {
                for (scene_node, node) in self.node.iter().enumerate() {
                    shown[scene_node] = self.whole.star_count[*node as usize] > 0;
                }
            }
            OutputVertices::Surface => {
                for face in self
                    .topology
                    .faces
                    .iter()
                    .filter(|f| f.tetrahedra[1] == NONE)
                {
                    for v in face.vertices {
                        shown[self.scene_node[v as usize] as usize] = true;
                    }
                }
            }
        }
        (0..shown.len())
            .filter(|k| shown[*k])
            .map(|k| self.node[k])
            .collect()
    }

    /// Place of a node among the shown ones, or -1.
    pub fn shown_index(&self, node: u32) -> i32 {
        let key = self.scene_node[node as usize];
        self.surface_nodes
            .binary_search_by_key(&key, |n| self.scene_node[*n as usize])
            .map_or(-1, |k| k as i32)
    }

    fn displacement_at_start(&self) -> Result<Vec<Vec3>, ModelError> {
        match self.scene.start {
            Start::Rest => Ok(vec![Vec3::zeros(); self.mesh.nodes.len()]),
            Start::Equilibrium => crate::reference::equilibrium(self, &self.whole)
                .map(|(u, _)| u)
                .map_err(|e| ModelError::Statics(self.file.clone(), e)),
        }
    }

    /// Faces that can ever be exposed.
    pub fn exposable_faces(&self) -> usize {
        if self.can_be_cut() {
            self.topology.faces.len()
        } else {
            self.whole.surface.len()
        }
    }

    /// Rigid motions that nothing holds, over all pieces of what is alive: for each piece 6 less the rank
    /// of the held axes' rows (e_a, (r x e_a)/size) in the six motions.
    pub(crate) fn count_rigid_modes(&self, alive: &[bool]) -> usize {
        let (count, label) = component_labels(self, alive);
        let bounds = &self.report.bounds;
        let (middle, size) = (
            (bounds[0] + bounds[1]) * 0.5,
            (bounds[1] - bounds[0]).norm(),
        );
        let mut held = vec![Matrix6::zeros(); count];
        for (v, free) in self.boundary.free.iter().enumerate() {
            if label[v] == NONE {
                continue;
            }
            let r = (self.mesh.nodes[v] - middle) / size;
            for axis in (0..3).filter(|a| !free[*a]) {
                let e = Vec3::ith(axis, 1.0);
                let turn = r.cross(&e);
                let row = Vector6::new(e.x, e.y, e.z, turn.x, turn.y, turn.z);
                held[label[v] as usize] += row * row.transpose();
            }
        }
        held.into_iter()
            .map(|gram| {
                let limit = 1e-10 * gram.trace().max(1.0);
                let rank = SymmetricEigen::new(gram)
                    .eigenvalues
                    .iter()
                    .filter(|e| **e > limit)
                    .count();
                6 - rank
            })
            .sum()
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
        let mut law = Hooke::new(material.young_modulus, material.poisson_ratio);
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

/// FNV-1a over the scene as written and the mesh.
fn fingerprint(scene: &Scene, mesh: &TetMesh) -> u64 {
    let mut hash = Fnv::default();
    // Gravity is the host's to change, and part of the state.
    let scene = Scene {
        gravity: [0.0; 3],
        ..scene.clone()
    };
    if let Ok(text) = serde_json::to_vec(&scene) {
        hash.write(&text);
    }
    for p in &mesh.nodes {
        p.iter()
            .for_each(|x| hash.write(&x.to_bits().to_le_bytes()));
    }
    mesh.tetrahedra
        .iter()
        .flatten()
        .for_each(|v| hash.write(&v.to_le_bytes()));
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
    pub fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3);
        }
    }
}
