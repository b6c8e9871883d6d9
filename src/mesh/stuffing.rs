//! Isosurface stuffing (Labelle and Shewchuk 2007): a body-centred cubic lattice, its vertices near
//! the surface moved onto it, its tetrahedra across the surface cut by fixed stencils. Whatever the
//! shape, dihedral angles stay between about 10.8 and 164.8 degrees; inside they are 60 and 90.

use std::collections::HashMap;

use super::cylinder::split_prism;
use super::{TetMesh, Vec3, quality};

/// A cut nearer to a vertex than this share of its long or short edge draws the vertex onto it.
const NEAR: [f64; 2] = [0.24999, 0.41189];

/// Halvings when the surface is sought along an edge.
const HALVINGS: usize = 40;

/// Tetrahedra of the region `shape` > 0 within `bounds`, cut from a lattice with edges `spacing`
/// and 0.87 `spacing` \[m\]. Surface nodes lie where `shape` = 0.
pub fn fill(shape: impl Fn(Vec3) -> f64, bounds: [Vec3; 2], spacing: f64) -> TetMesh {
    let mut lattice = Lattice::new(&shape, bounds, spacing);
    let cuts = lattice.cuts(&shape);
    lattice.warp(&cuts);
    let mut stencils = Stencils {
        lattice: &lattice,
        cuts: &cuts,
        numbers: HashMap::new(),
        mesh: TetMesh::default(),
    };
    for tetrahedron in lattice.tetrahedra() {
        stencils.cut(tetrahedron);
    }
    stencils.mesh
}

/// The place of a vertex in the grid.
type Vertex = usize;

/// Where the surface cuts the edge from a vertex inside to one outside.
type Cuts = HashMap<[Vertex; 2], Vec3>;

/// Vertices at integer coordinates all even or all odd, in units of half a spacing. Long edges join
/// two even or two odd vertices, short ones an even and an odd.
struct Lattice {
    size: [usize; 3],
    positions: Vec<Vec3>,
    /// `shape` at the vertices; 0 at those drawn onto the surface. NaN where there is no vertex.
    values: Vec<f64>,
}

impl Lattice {
    fn new(shape: &impl Fn(Vec3) -> f64, [low, high]: [Vec3; 2], spacing: f64) -> Self {
        let size = [0, 1, 2].map(|axis| {
            // A cell round the bounds, and a last vertex of either kind.
            2 * ((high[axis] - low[axis]) / spacing).ceil() as usize + 6
        });
        let mut lattice = Lattice {
            size,
            positions: Vec::new(),
            values: Vec::new(),
        };
        for k in 0..size[2] {
            for j in 0..size[1] {
                for i in 0..size[0] {
                    let steps = Vec3::new(i as f64, j as f64, k as f64) / 2.0 - Vec3::repeat(1.0);
                    let position = low + spacing * steps;
                    let vertex = i % 2 == j % 2 && j % 2 == k % 2;
                    lattice.positions.push(position);
                    lattice
                        .values
                        .push(if vertex { shape(position) } else { f64::NAN });
                }
            }
        }
        lattice
    }

    fn coordinates(&self, vertex: Vertex) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [vertex % nx, vertex / nx % ny, vertex / (nx * ny)]
    }

    /// The vertex `step` away, where it is in the grid.
    fn neighbour(&self, vertex: Vertex, step: [isize; 3]) -> Option<Vertex> {
        let place = self.coordinates(vertex);
        let mut at = [0; 3];
        for axis in 0..3 {
            at[axis] = place[axis].checked_add_signed(step[axis])?;
            if at[axis] >= self.size[axis] {
                return None;
            }
        }
        Some(at[0] + self.size[0] * (at[1] + self.size[1] * at[2]))
    }

    fn neighbours(&self, vertex: Vertex) -> impl Iterator<Item = Vertex> {
        const STEPS: [[isize; 3]; 14] = [
            [2, 0, 0],
            [-2, 0, 0],
            [0, 2, 0],
            [0, -2, 0],
            [0, 0, 2],
            [0, 0, -2],
            [1, 1, 1],
            [-1, 1, 1],
            [1, -1, 1],
            [-1, -1, 1],
            [1, 1, -1],
            [-1, 1, -1],
            [1, -1, -1],
            [-1, -1, -1],
        ];
        STEPS
            .iter()
            .filter_map(move |&step| self.neighbour(vertex, step))
    }

    fn is_long(&self, one: Vertex, other: Vertex) -> bool {
        one % self.size[0] % 2 == other % self.size[0] % 2
    }

    fn cuts(&self, shape: &impl Fn(Vec3) -> f64) -> Cuts {
        let mut cuts = Cuts::new();
        let inside = (0..self.values.len()).filter(|&vertex| self.values[vertex] > 0.0);
        for positive in inside {
            for negative in self.neighbours(positive).filter(|&n| self.values[n] < 0.0) {
                let (mut inner, mut outer) = (self.positions[positive], self.positions[negative]);
                for _ in 0..HALVINGS {
                    let middle = (inner + outer) / 2.0;
                    if shape(middle) > 0.0 {
                        inner = middle;
                    } else {
                        outer = middle;
                    }
                }
                cuts.insert([positive, negative], (inner + outer) / 2.0);
            }
        }
        cuts
    }

    /// Draws each vertex that has a near cut onto the nearest; its edges are then no longer cut.
    fn warp(&mut self, cuts: &Cuts) {
        for vertex in 0..self.values.len() {
            let value = self.values[vertex];
            let start = self.positions[vertex];
            let mut nearest: Option<(f64, Vec3)> = None;
            for neighbour in self.neighbours(vertex) {
                let edge = if value > 0.0 {
                    [vertex, neighbour]
                } else {
                    [neighbour, vertex]
                };
                if value * self.values[neighbour] >= 0.0 {
                    continue;
                }
                let Some(&cut) = cuts.get(&edge) else {
                    continue;
                };
                let length = (self.positions[neighbour] - start).norm();
                let near = NEAR[usize::from(!self.is_long(vertex, neighbour))];
                let share = (cut - start).norm() / (near * length);
                if share < nearest.map_or(1.0, |(share, _)| share) {
                    nearest = Some((share, cut));
                }
            }
            if let Some((_, cut)) = nearest {
                self.positions[vertex] = cut;
                self.values[vertex] = 0.0;
            }
        }
    }

    /// Four round each long edge between even vertices.
    fn tetrahedra(&self) -> Vec<[Vertex; 4]> {
        let mut tetrahedra = Vec::new();
        for p in 0..self.values.len() {
            if self.coordinates(p).iter().any(|c| c % 2 == 1) {
                continue;
            }
            for axis in 0..3 {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let step = |along: isize, across: [isize; 2]| {
                    let mut step = [0; 3];
                    step[axis] = along;
                    [step[u], step[v]] = across;
                    self.neighbour(p, step)
                };
                let ring = [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(|across| step(1, across));
                for side in 0..4 {
                    if let (Some(q), Some(r), Some(s)) =
                        (step(2, [0, 0]), ring[side], ring[(side + 1) % 4])
                    {
                        tetrahedra.push([p, q, r, s]);
                    }
                }
            }
        }
        tetrahedra
    }
}

struct Stencils<'a> {
    lattice: &'a Lattice,
    cuts: &'a Cuts,
    /// Of the nodes so far: a vertex is given twice, a cut by the ends of its edge.
    numbers: HashMap<[Vertex; 2], u32>,
    mesh: TetMesh,
}

impl Stencils<'_> {
    /// Adds the part of a lattice tetrahedron inside the surface.
    fn cut(&mut self, tetrahedron: [Vertex; 4]) {
        let value = |vertex: &Vertex| self.lattice.values[*vertex];
        let mut inside: Vec<_> = tetrahedron.into_iter().filter(|v| value(v) > 0.0).collect();
        let on: Vec<_> = tetrahedron
            .into_iter()
            .filter(|v| value(v) == 0.0)
            .collect();
        let outside: Vec<_> = tetrahedron.into_iter().filter(|v| value(v) < 0.0).collect();
        match (&inside[..], &on[..], &outside[..]) {
            ([], ..) => {}
            (_, _, []) => {
                let nodes = tetrahedron.map(|v| self.node([v, v]));
                self.add(nodes);
            }
            (&[a], ..) => {
                let cuts = outside.iter().map(|&d| [a, d]);
                let keys: Vec<_> = [[a, a]]
                    .into_iter()
                    .chain(on.iter().map(|&v| [v, v]))
                    .chain(cuts)
                    .collect();
                let nodes = [0, 1, 2, 3].map(|n| self.node(keys[n]));
                self.add(nodes);
            }
            (&[a, b], &[c], &[d]) => {
                let [a, b] = if self.is_from(a, b, d) {
                    [a, b]
                } else {
                    [b, a]
                };
                let [na, nb, nc] = [a, b, c].map(|v| self.node([v, v]));
                let [cut_a, cut_b] = [a, b].map(|v| self.node([v, d]));
                self.add([na, nb, nc, cut_b]);
                self.add([na, cut_b, nc, cut_a]);
            }
            (&[..], _, &[d]) => {
                // Each rail of the prism before those to whose cuts diagonals run from it.
                let rails = [inside[0], inside[1], inside[2]];
                inside.sort_by_key(|&a| {
                    rails
                        .iter()
                        .filter(|&&b| b != a && self.is_from(b, a, d))
                        .count()
                });
                let rails = [inside[0], inside[1], inside[2]];
                let from = rails.map(|v| self.node([v, v]));
                let to = rails.map(|v| self.node([v, d]));
                split_prism(from, to)
                    .into_iter()
                    .for_each(|nodes| self.add(nodes));
            }
            (&[a, b], _, &[c, d]) => self.wedge([a, b], [c, d]),
            _ => {}
        }
    }

    /// The prism between the triangle at `a` and that at `b`; its face on the surface may be cut
    /// either way.
    fn wedge(&mut self, [a, b]: [Vertex; 2], [c, d]: [Vertex; 2]) {
        let [over_c, over_d] = [c, d].map(|v| self.is_from(a, b, v));
        let [first, c_rail, d_rail] = [[[a, a], [b, b]], [[a, c], [b, c]], [[a, d], [b, d]]]
            .map(|rail| rail.map(|key| self.node(key)));
        let length = |from: u32, to: u32| {
            (self.mesh.nodes[from as usize] - self.mesh.nodes[to as usize]).norm()
        };
        let c_before_d = length(c_rail[0], d_rail[1]) < length(d_rail[0], c_rail[1]);
        let rails = match (over_c, over_d, c_before_d) {
            (true, true, true) => [first, c_rail, d_rail],
            (true, true, false) => [first, d_rail, c_rail],
            (false, false, true) => [c_rail, d_rail, first],
            (false, false, false) => [d_rail, c_rail, first],
            (true, false, _) => [d_rail, first, c_rail],
            (false, true, _) => [c_rail, first, d_rail],
        };
        let [from, to] = [0, 1].map(|end| rails.map(|rail| rail[end]));
        split_prism(from, to)
            .into_iter()
            .for_each(|nodes| self.add(nodes));
    }

    /// Whether the face of `a` and `b` inside and `d` outside is cut from `a` to the cut of (b, d),
    /// rather than from `b` to that of (a, d): the choice both its tetrahedra make.
    fn is_from(&self, a: Vertex, b: Vertex, d: Vertex) -> bool {
        if self.lattice.is_long(a, d) {
            return true;
        }
        if self.lattice.is_long(b, d) {
            return false;
        }
        // The parity rule: d is between a and b on one axis, so that just one of them says yes.
        let (a, d) = (self.lattice.coordinates(a), self.lattice.coordinates(d));
        (0..3).filter(|&axis| a[axis] > d[axis]).count() % 2 == 0
    }

    fn node(&mut self, key: [Vertex; 2]) -> u32 {
        let position = || match key {
            [one, other] if one == other => self.lattice.positions[one],
            _ => self.cuts[&key],
        };
        *self.numbers.entry(key).or_insert_with(|| {
            self.mesh.nodes.push(position());
            self.mesh.nodes.len() as u32 - 1
        })
    }

    fn add(&mut self, mut nodes: [u32; 4]) {
        if quality::volume(quality::corners(&self.mesh, nodes)) < 0.0 {
            nodes.swap(2, 3);
        }
        self.mesh.tetrahedra.push(nodes);
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn ball_at_any_size_is_closed_whole_and_within_the_proven_angles() {
        let mut least = 180f64;
        let mut most = 0f64;
        for n in 0..40 {
            let radius = 1.0 + 0.05 * n as f64;
            let centre = Vec3::new(0.37, 0.11, 0.73) * n as f64;
            let bounds = [centre.add_scalar(-radius), centre.add_scalar(radius)];
            let mut mesh = fill(|p| radius - (p - centre).norm(), bounds, 0.8);
            let report = check::repair(&mut mesh).unwrap();
            assert_eq!(
                (report.pieces, report.hinge_edges, report.flipped),
                (1, 0, 0)
            );
            least = least.min(report.minimum_dihedral_degrees);
            most = most.max(report.maximum_dihedral_degrees);
        }
        assert!(least > 10.7 && most < 164.8, "{least} {most}");
    }
}
