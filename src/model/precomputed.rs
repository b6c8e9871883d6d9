//! The pre-computed part: everything about it that never changes, condensed to what moves it and what
//! is seen of it. (Cotin, Delingette, Ayache 1999 and 2000: elementary deformations, hybrid model;
//! in the corrected form of docs/model.md.)
//!
//! Nodes: c connection, s inside, of those t touched by tools. With K of the pre-computed tetrahedra,
//!
//! Phi = -K_ss^-1 K_sc,  S = K_cc + K_cs Phi,  G = K_ss^-1\[:, t\],
//! u_s = Phi u_c + sum_k a_k w_k + G lambda,
//! force on c = sum_k a_k g_k - S u_c + Phi_t^T lambda.
//!
//! A drive k is a given force field or prescribed displacement d_k of amplitude a_k(t): gravity along
//! each axis, loads and prescribed nodes by their ramps. w_k is its displacement with c held (d_k where
//! prescribed), g_k = -(K w_k)_c.

use super::Model;
use super::boundary::ramp;
use super::dense::{Symmetric, add_scaled, dot};
use super::store::Numbers;
use super::tensor_mass::{Lane, Pattern, Tensors};
use crate::mesh::Vec3;
use crate::statics::{Factor, Numbering, StaticsError};
use nalgebra::Matrix3;

/// Right sides solved at once.
const BLOCK: usize = 64;

/// Told the share done, 0 to 1.
pub type Progress<'a> = &'a (dyn Fn(f64) + Sync);

/// What a drive's amplitude is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source {
    /// Gravity along an axis \[m/s²\].
    Gravity(usize),
    /// Nodal forces whose ramp is so long \[s\]; amplitude 0 to 1.
    Loads(f64),
    /// Prescribed displacements whose ramp is so long \[s\]; amplitude 0 to 1.
    Prescribed(f64),
}

impl Source {
    pub fn amplitude(&self, gravity: &[f64; 3], time: f64) -> f64 {
        match self {
            Source::Gravity(axis) => gravity[*axis],
            Source::Loads(length) | Source::Prescribed(length) => ramp(time, *length),
        }
    }

    pub fn is_force(&self) -> bool {
        !matches!(self, Source::Prescribed(_))
    }
}

/// S, or its softest modes.
#[derive(Clone, Debug, PartialEq)]
pub enum Interface {
    Full(Symmetric),
    /// S = shift D + sum_m (value_m - shift) q_m q_m^T with D the diagonal of S, S q_m = value_m D q_m and
    /// q_m^T D^-1 q_n = 1 where m = n, else 0 (q_m stands for D q_m).
    Modes {
        /// shift D
        diagonal: Vec<f64>,
        /// value_m - shift
        values: Vec<f64>,
        /// q_m, one after the other.
        vectors: Vec<f64>,
    },
}

impl Interface {
    pub fn size(&self) -> usize {
        match self {
            Interface::Full(matrix) => matrix.size(),
            Interface::Modes { diagonal, .. } => diagonal.len(),
        }
    }

    /// S u \[N\]; room for the size rounded up to a multiple of four, zeros behind the end of u.
    pub fn product(&self, u: &[f64], out: &mut [f64]) {
        match self {
            Interface::Full(matrix) => matrix.product(u, out),
            Interface::Modes {
                diagonal,
                values,
                vectors,
            } => {
                let size = diagonal.len();
                let (u, out) = (&u[..size], &mut out[..size]);
                for ((out, u), d) in out.iter_mut().zip(u).zip(diagonal) {
                    *out = d * u;
                }
                for (value, q) in values.iter().zip(vectors.chunks(size)) {
                    add_scaled(out, value * dot(q, u), q);
                }
            }
        }
    }

    pub fn at(&self, row: usize, column: usize) -> f64 {
        match self {
            Interface::Full(matrix) => matrix.at(row, column),
            Interface::Modes {
                diagonal,
                values,
                vectors,
            } => {
                let modes = values.iter().zip(vectors.chunks(diagonal.len()));
                let sum: f64 = modes.map(|(v, q)| v * q[row] * q[column]).sum();
                sum + if row == column { diagonal[row] } else { 0.0 }
            }
        }
    }

    /// Of connection nodes i and j.
    pub fn block(&self, i: usize, j: usize) -> Matrix3<f64> {
        Matrix3::from_fn(|a, b| self.at(3 * i + a, 3 * j + b))
    }

    pub fn bytes(&self) -> usize {
        match self {
            Interface::Full(matrix) => matrix.bytes(),
            Interface::Modes {
                values, vectors, ..
            } => 8 * (values.len() + vectors.len()),
        }
    }

    /// The n softest modes, and the mean of the other eigenvalues for the rest.
    pub fn reduced(&self, modes: usize) -> Interface {
        let size = self.size();
        if modes >= size {
            return self.clone();
        }
        // S of a node goes with its size: relative to its diagonal all nodes are alike.
        let root: Vec<f64> = (0..size).map(|k| self.at(k, k).sqrt()).collect();
        let scaled = |r: usize, c: usize| self.at(r, c) / (root[r] * root[c]);
        let (values, mut vectors) = crate::statics::eigen(size, scaled);
        let shift = values[modes..].iter().sum::<f64>() / (size - modes) as f64;
        vectors.truncate(modes * size);
        for q in vectors.chunks_mut(size) {
            q.iter_mut().zip(&root).for_each(|(q, root)| *q *= root);
        }
        Interface::Modes {
            diagonal: root.iter().map(|r| shift * r * r).collect(),
            values: values[..modes].iter().map(|v| v - shift).collect(),
            vectors,
        }
    }
}

/// Three numbers a node throughout; "kept" nodes are those inside whose displacement is ever known.
#[derive(Debug)]
pub struct Precomputed {
    pub interface: Interface,
    /// Nodes: connection, touchable, kept.
    pub connection: usize,
    pub touchable: usize,
    pub kept: usize,
    /// Phi: 3 kept rows of 3 connection numbers.
    influence: Numbers,
    /// G: 3 touchable columns of 3 kept numbers \[m/N\].
    compliance: Numbers,
    pub drives: Vec<Source>,
    /// w_k: drives times 3 kept numbers.
    field: Vec<f64>,
    /// Largest |w_k| of a node.
    farthest: Vec<f64>,
    /// g_k: drives times 3 connection numbers.
    push: Vec<f64>,
    /// w_k . K w_l, drives times drives.
    stored: Vec<f64>,
    /// f_k . w_l, drives times drives; zero rows for prescribed k.
    potential: Vec<f64>,
    /// M_c + Phi^T M_s Phi on the connection nodes, full; where the scene asks for it.
    pub guyan: Option<Vec<f64>>,
    /// All of it as stored.
    numbers: Numbers,
}

/// The counts that a stored part must agree with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    pub connection: usize,
    pub touchable: usize,
    pub kept: usize,
    pub drives: usize,
    pub guyan: bool,
}

impl Sizes {
    pub fn of(model: &Model) -> Sizes {
        Sizes {
            connection: model.parts.connection,
            touchable: model.parts.touchable,
            kept: model.parts.known - model.parts.moving,
            drives: sources(model).len(),
            guyan: model.has_guyan_mass(),
        }
    }

    /// Lengths of: S, Phi, G, w, g, stored, potential, Guyan mass.
    pub fn lengths(&self) -> [usize; 8] {
        let (c, t, k, d) = (
            3 * self.connection,
            3 * self.touchable,
            3 * self.kept,
            self.drives,
        );
        [
            c * c,
            k * c,
            t * k,
            d * k,
            d * c,
            d * d,
            d * d,
            if self.guyan { c * c } else { 0 },
        ]
    }
}

impl Precomputed {
    /// From stored numbers, in the order of [`Sizes::lengths`].
    pub fn from_numbers(model: &Model, numbers: Numbers) -> Option<Precomputed> {
        let sizes = Sizes::of(model);
        let mut parts = numbers.split(&sizes.lengths())?.into_iter();
        let mut next = || parts.next().unwrap_or_default();
        let interface = Interface::Full(Symmetric::new(3 * sizes.connection, &next()));
        let interface = match model.scene.model.interface_modes {
            Some(modes) => interface.reduced(modes),
            None => interface,
        };
        let (influence, compliance, field) = (next(), next(), next().to_vec());
        let mut farthest: Vec<f64> = (field.chunks((3 * sizes.kept).max(1)))
            .map(|w| w.chunks(3).map(|u| dot(u, u)).fold(0.0, f64::max).sqrt())
            .collect();
        farthest.resize(sizes.drives, 0.0);
        Some(Precomputed {
            interface,
            connection: sizes.connection,
            touchable: sizes.touchable,
            kept: sizes.kept,
            drives: sources(model),
            influence,
            compliance,
            field,
            push: next().to_vec(),
            stored: next().to_vec(),
            potential: next().to_vec(),
            guyan: sizes.guyan.then(|| next().to_vec()),
            farthest,
            numbers,
        })
    }

    /// Row of S as computed, whatever the interface in use.
    pub fn whole_interface(&self, dof: usize) -> &[f64] {
        let size = 3 * self.connection;
        &self.numbers[dof * size..(dof + 1) * size]
    }

    pub fn shared(&self) -> Numbers {
        self.numbers.clone()
    }

    pub fn numbers(&self) -> &[f64] {
        &self.numbers
    }

    pub fn bytes(&self) -> usize {
        let large = self.influence.len() + self.compliance.len() + self.field.len();
        self.interface.bytes() + 8 * (large + self.push.len())
    }

    /// Row of Phi: 3 connection numbers.
    pub fn influence(&self, dof: usize) -> &[f64] {
        let size = 3 * self.connection;
        &self.influence[dof * size..(dof + 1) * size]
    }

    /// Column of G: 3 kept numbers \[m/N\].
    pub fn compliance(&self, dof: usize) -> &[f64] {
        let size = 3 * self.kept;
        &self.compliance[dof * size..(dof + 1) * size]
    }

    /// w_k: 3 kept numbers.
    pub fn field(&self, drive: usize) -> &[f64] {
        let size = 3 * self.kept;
        &self.field[drive * size..(drive + 1) * size]
    }

    /// Largest |w_k| of a kept node.
    pub fn farthest(&self, drive: usize) -> f64 {
        self.farthest[drive]
    }

    /// g_k: 3 connection numbers.
    pub fn push(&self, drive: usize) -> &[f64] {
        let size = 3 * self.connection;
        &self.push[drive * size..(drive + 1) * size]
    }

    /// w_k . K w_l
    pub fn stored(&self, k: usize, l: usize) -> f64 {
        self.stored[k * self.drives.len() + l]
    }

    /// f_k . w_l
    pub fn potential(&self, k: usize, l: usize) -> f64 {
        self.potential[k * self.drives.len() + l]
    }
}

/// The drives of a scene: gravity, then loads and prescribed nodes inside by their ramps.
fn sources(model: &Model) -> Vec<Source> {
    let inside = |node: u32| node as usize >= model.parts.moving;
    let mut sources: Vec<Source> = (0..3).map(Source::Gravity).collect();
    let loads = (model.boundary.loads.iter())
        .filter(|l| inside(l.node))
        .map(|l| Source::Loads(l.ramp));
    let prescribed = (model.boundary.prescribed.iter())
        .filter(|p| inside(p.node))
        .flat_map(|p| {
            (0..3)
                .filter(|a| p.axes[*a])
                .map(|a| Source::Prescribed(p.ramp[a]))
        });
    for source in loads.chain(prescribed) {
        if !sources.contains(&source) {
            sources.push(source);
        }
    }
    sources
}

/// One right side.
#[derive(Clone, Copy)]
enum Column {
    /// Unit displacement of a connection degree of freedom.
    Connection(usize),
    /// Unit force on a touchable degree of freedom.
    Touch(usize),
}

/// K of the pre-computed part, on all nodes.
fn stiffness(model: &Model) -> (Pattern, Tensors) {
    let nodes = model.mesh.nodes.len();
    if let Some(elements) = model.elements_inside() {
        let parts = elements.tangent(&vec![Lane::default(); nodes]);
        return Tensors::assemble(nodes, &parts.unwrap_or_default());
    }
    let inside = |t: &usize| !model.parts.dynamic[*t];
    let all = &model.mesh.tetrahedra;
    let tetrahedra: Vec<[u32; 4]> = (0..all.len()).filter(inside).map(|t| all[t]).collect();
    let pattern = Pattern::new(nodes, &tetrahedra);
    let mut tensors = Tensors::zeros(&pattern);
    for t in (0..all.len()).filter(inside) {
        let (shape, law) = (&model.shape[t], &model.material(t).law);
        tensors.accumulate(&pattern, &all[t], shape, law);
    }
    (pattern, tensors)
}

/// Factors the pre-computed part and solves for everything that is kept, on `threads` threads.
/// Returns the numbers in the order of [`Sizes::lengths`].
pub fn compute(
    model: &Model,
    threads: usize,
    progress: Progress,
) -> Result<Vec<f64>, StaticsError> {
    let (moving, from) = (model.parts.moving, model.parts.connected_from());
    let nodes = model.mesh.nodes.len();
    let mut inside_mass = vec![0.0; nodes];
    for (t, tetrahedron) in model.mesh.tetrahedra.iter().enumerate() {
        if !model.parts.dynamic[t] {
            for node in tetrahedron {
                inside_mass[*node as usize] += model.quarter[t];
            }
        }
    }
    let (pattern, tensors) = stiffness(model);
    let solves = |v: usize| v >= moving && model.whole.star_count[v] > 0;
    let numbering = Numbering::new((0..nodes).map(|v| {
        if solves(v) {
            model.boundary.free[v]
        } else {
            [false; 3]
        }
    }));
    let factor = Factor::within(tensors.entries(&pattern), &numbering, &model.mesh.nodes)?;
    progress(0.3);

    let sizes = Sizes::of(model);
    let [c, k] = [3 * sizes.connection, 3 * sizes.kept];
    let mut out = sizes.lengths().map(|length| vec![0.0; length]);
    let multiply = |u: &[Vec3]| {
        let lanes: Vec<Lane> = u.iter().map(|u| (*u).into()).collect();
        let mut force = vec![Vec3::zeros(); nodes];
        tensors.product(&pattern, &lanes, &mut force);
        force
    };
    let kept = |field: &[Vec3], to: &mut [f64]| {
        for (to, from) in to.chunks_mut(3).zip(&field[moving..]) {
            to.copy_from_slice(from.as_slice());
        }
    };

    // Drives, one at a time: they are few.
    let drives = sources(model);
    let (mut fields, mut forces, mut internals) = (Vec::new(), Vec::new(), Vec::new());
    for (index, source) in drives.iter().enumerate() {
        let (mut given, mut force) = (vec![Vec3::zeros(); nodes], vec![Vec3::zeros(); nodes]);
        match source {
            Source::Gravity(axis) => {
                for v in (moving..nodes).filter(|v| solves(*v)) {
                    force[v][*axis] = inside_mass[v];
                }
            }
            Source::Loads(length) => {
                for load in model.boundary.loads.iter().filter(|l| l.ramp == *length) {
                    if solves(load.node as usize) {
                        force[load.node as usize] += load.force;
                    }
                }
            }
            Source::Prescribed(length) => {
                for p in &model.boundary.prescribed {
                    for axis in 0..3 {
                        if p.axes[axis] && p.ramp[axis] == *length && solves(p.node as usize) {
                            given[p.node as usize][axis] = p.displacement[axis];
                        }
                    }
                }
            }
        }
        let right: Vec<Vec3> = multiply(&given)
            .iter()
            .zip(&force)
            .map(|(k, f)| f - k)
            .collect();
        let mut column = vec![0.0; numbering.unknowns()];
        numbering.gather(&right, &mut column);
        factor.solve(&mut column);
        numbering.scatter(&column, &mut given);
        let internal = multiply(&given);
        kept(&given, &mut out[3][index * k..(index + 1) * k]);
        for (to, from) in out[4][index * c..(index + 1) * c]
            .chunks_mut(3)
            .zip(&internal[from..moving])
        {
            to.copy_from_slice((-from).as_slice());
        }
        fields.push(given);
        forces.push(force);
        internals.push(internal);
    }
    for k in 0..drives.len() {
        for l in 0..drives.len() {
            let sum = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
            out[5][k * drives.len() + l] = sum(&fields[k], &internals[l]);
            out[6][k * drives.len() + l] = sum(&forces[k], &fields[l]);
        }
    }

    // Columns of Phi and G, in blocks, by threads.
    let columns: Vec<Column> = (0..c)
        .map(Column::Connection)
        .chain((0..3 * sizes.touchable).map(Column::Touch))
        .collect();
    let blocks: Vec<&[Column]> = columns.chunks(BLOCK).collect();
    let done = std::sync::atomic::AtomicUsize::new(0);
    let work = |first: usize| {
        let mut solved = Vec::new();
        let mut right = vec![0.0; BLOCK * numbering.unknowns()];
        let (mut field, mut lanes) = (vec![Vec3::zeros(); nodes], vec![Lane::default(); nodes]);
        for block in blocks.iter().skip(first).step_by(threads) {
            let right = &mut right[..block.len() * numbering.unknowns()];
            for (column, right) in block
                .iter()
                .zip(right.chunks_mut(numbering.unknowns().max(1)))
            {
                field.fill(Vec3::zeros());
                match column {
                    Column::Connection(dof) => {
                        let row = from + dof / 3;
                        // K_sc e = the transposes of row c, which come before any s.
                        for (j, tensor) in tensors.upper_row(&pattern, row) {
                            field[j] = -tensor.row(dof % 3).transpose();
                        }
                    }
                    Column::Touch(dof) => field[moving + dof / 3][dof % 3] = 1.0,
                }
                numbering.gather(&field, right);
            }
            factor.solve(right);
            for (at, column) in block.iter().enumerate() {
                let unknowns = numbering.unknowns();
                field.fill(Vec3::zeros());
                numbering.scatter(&right[at * unknowns..(at + 1) * unknowns], &mut field);
                let mut rows = vec![0.0; k];
                kept(&field, &mut rows);
                let mut interface = Vec::new();
                let mut mass = Vec::new();
                if let Column::Connection(dof) = column {
                    field[from + dof / 3][dof % 3] = 1.0;
                    lanes
                        .iter_mut()
                        .zip(&field)
                        .for_each(|(l, u)| *l = (*u).into());
                    for row in from..moving {
                        interface.extend_from_slice(
                            tensors.row_product(&pattern, row, &lanes).as_slice(),
                        );
                    }
                    if sizes.guyan {
                        mass = field[moving..]
                            .iter()
                            .flat_map(|u| [u.x, u.y, u.z])
                            .collect();
                    }
                }
                solved.push((*column, rows, interface, mass));
            }
            let done = 1 + done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            progress(0.3 + 0.7 * done as f64 / blocks.len() as f64);
        }
        solved
    };
    let threads = threads.max(1);
    let solved: Vec<_> = std::thread::scope(|scope| {
        let work = &work;
        let others: Vec<_> = (1..threads)
            .map(|first| scope.spawn(move || work(first)))
            .collect();
        let mut solved = work(0);
        for other in others {
            solved.extend(other.join().unwrap_or_default());
        }
        solved
    });
    let mut shapes: Vec<(usize, Vec<f64>)> = Vec::new();
    for (column, rows, interface, mass) in solved {
        match column {
            Column::Connection(dof) => {
                for (row, value) in rows.iter().enumerate() {
                    out[1][row * c + dof] = *value;
                }
                for (row, value) in interface.iter().enumerate() {
                    out[0][row * c + dof] = *value;
                }
                if sizes.guyan {
                    shapes.push((dof, mass));
                }
            }
            Column::Touch(dof) => out[2][dof * k..(dof + 1) * k].copy_from_slice(&rows),
        }
    }
    if sizes.guyan {
        let heavy: Vec<f64> = inside_mass[moving..].iter().flat_map(|m| [*m; 3]).collect();
        for (p, a) in &shapes {
            let weighed: Vec<f64> = a.iter().zip(&heavy).map(|(a, m)| a * m).collect();
            for (q, b) in &shapes {
                out[7][p * c + q] = dot(&weighed, b);
            }
        }
        for dof in 0..c {
            out[7][dof * c + dof] += model.whole.mass[from + dof / 3];
        }
    }
    Ok(out.concat())
}
