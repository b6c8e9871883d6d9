//! From triangle meshes and tool poses to facets with normals, in the camera frame.
//!
//! Normals are area-weighted means over the triangles around a vertex that are joined by smooth
//! edges. Each triangle is then drawn as a curved point-normal triangle (Vlachos et al. 2001), so
//! that a coarse mesh has a round outline; edges at creases stay straight, so no gaps open.

use super::view::View;
use super::{Surface, Tint, ToolLook, ToolPose};
use nalgebra::Vector3;
use std::collections::HashMap;
use std::f64::consts::TAU;

type V3 = Vector3<f32>;

/// Cosine of the angle between faces above which an edge stays sharp: 60 degrees.
const CREASE_COSINE: f32 = 0.5;
/// The same among raw triangles, where removed tetrahedra leave steps: 80 degrees.
const RAW_CREASE_COSINE: f32 = 0.17;
/// Passes that even out normals within smooth regions.
const NORMAL_PASSES: usize = 2;
/// Facets one surface is refined towards.
const FACET_BUDGET: usize = 120_000;
/// Largest number of pieces per triangle edge.
const FINEST: usize = 5;

/// How a facet takes the light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Finish {
    Tissue,
    Steel,
    Plastic,
    /// Shines by itself.
    Glow,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    pub position: V3,
    pub normal: V3,
    pub tint: f32,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Facet {
    pub corners: [Corner; 3],
    pub finish: Finish,
    /// sRGB; not used by tissue.
    pub color: [u8; 3],
}

/// The facets of an organ.
pub(super) fn surface_facets(surface: &Surface, view: &View) -> Vec<Facet> {
    facets(surface, view, Finish::Tissue, [0; 3])
}

fn facets(surface: &Surface, view: &View, finish: Finish, color: [u8; 3]) -> Vec<Facet> {
    let mesh = Mesh::new(surface, view);
    let pieces = ((FACET_BUDGET / mesh.triangles.len().max(1)) as f64).sqrt() as usize;
    let pieces = pieces.clamp(1, FINEST);
    let mut facets = Vec::with_capacity(mesh.triangles.len() * pieces * pieces);
    for triangle in mesh.curved_triangles() {
        let corner =
            |i: usize, j: usize| triangle.at(i as f32 / pieces as f32, j as f32 / pieces as f32);
        for i in 0..pieces {
            for j in 0..pieces - i {
                let (a, b, c) = (corner(i, j), corner(i + 1, j), corner(i, j + 1));
                facets.push(Facet {
                    corners: [a, b, c],
                    finish,
                    color,
                });
                if i + j + 1 < pieces {
                    facets.push(Facet {
                        corners: [b, corner(i + 1, j + 1), c],
                        finish,
                        color,
                    });
                }
            }
        }
    }
    facets
}

/// The valid triangles of a surface with one normal per corner.
struct Mesh {
    triangles: Vec<[Corner; 3]>,
    /// Whether the edge from corner k to corner k + 1 is sharp.
    sharp: Vec<[bool; 3]>,
}

impl Mesh {
    fn new(surface: &Surface, view: &View) -> Self {
        let mut indices: Vec<[u32; 3]> = Vec::new();
        let mut triangles: Vec<[Corner; 3]> = Vec::new();
        let mut areas: Vec<V3> = Vec::new();
        let get = |tints: &[f32], i: usize| {
            tints
                .get(i)
                .copied()
                .filter(|t| t.is_finite())
                .unwrap_or(0.0)
                .clamp(0.0, 1.0)
        };
        for (t, triangle) in surface.triangles.iter().enumerate() {
            let Some(p) = corners_of(surface, triangle, view) else {
                continue;
            };
            let area = (p[1] - p[0]).cross(&(p[2] - p[0]));
            if area.norm() < 1e-12 {
                continue;
            }
            indices.push(*triangle);
            areas.push(area);
            triangles.push([0, 1, 2].map(|k| Corner {
                position: p[k],
                normal: area,
                tint: match surface.tint {
                    Tint::None => 0.0,
                    Tint::Vertices(tints) => get(tints, triangle[k] as usize),
                    Tint::Triangles(tints) => get(tints, t),
                },
            }));
        }
        let sharp = smooth_normals(&indices, &areas, &mut triangles);
        Self { triangles, sharp }
    }

    fn curved_triangles(&self) -> impl Iterator<Item = CurvedTriangle> {
        self.triangles
            .iter()
            .zip(&self.sharp)
            .map(|(c, s)| CurvedTriangle::new(c, s))
    }
}

fn corners_of(surface: &Surface, triangle: &[u32; 3], view: &View) -> Option<[V3; 3]> {
    let mut corners = [V3::zeros(); 3];
    for (corner, &vertex) in corners.iter_mut().zip(triangle) {
        *corner = view.place(surface.vertices.get(vertex as usize)?);
        if !corner.iter().all(|x| x.is_finite() && x.abs() < 1e6) {
            return None;
        }
    }
    Some(corners)
}

/// Replaces each corner's normal by the mean over its fan of smoothly joined triangles and tells
/// which edges are sharp: those of other than two triangles, folded by more than the crease
/// angle, or where the tint jumps.
fn smooth_normals(
    indices: &[[u32; 3]],
    areas: &[V3],
    triangles: &mut [[Corner; 3]],
) -> Vec<[bool; 3]> {
    let mut edges: HashMap<[u32; 2], Vec<(usize, usize)>> = HashMap::new();
    for (t, triangle) in indices.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
            edges.entry([a.min(b), a.max(b)]).or_default().push((t, k));
        }
    }
    let mut sharp = vec![[true; 3]; indices.len()];
    let mut fan: Vec<usize> = (0..3 * indices.len()).collect();
    for (t, triangle) in indices.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
            let Some(&[first, second]) = edges.get(&[a.min(b), a.max(b)]).map(Vec::as_slice) else {
                continue;
            };
            let (u, j) = if first == (t, k) { second } else { first };
            let cosine = areas[t].normalize().dot(&areas[u].normalize());
            let (tint, other) = (mean_tint(&triangles[t]), mean_tint(&triangles[u]));
            let jump = (tint - other).abs();
            let crease = if tint.min(other) > 0.5 {
                RAW_CREASE_COSINE
            } else {
                CREASE_COSINE
            };
            if u == t || cosine < crease || jump > 0.5 || indices[u][j] != b {
                continue;
            }
            sharp[t][k] = false;
            join(&mut fan, 3 * t + k, 3 * u + (j + 1) % 3);
            join(&mut fan, 3 * t + (k + 1) % 3, 3 * u + j);
        }
    }
    let fans: Vec<usize> = (0..fan.len())
        .map(|corner| root(&mut fan, corner))
        .collect();
    let mut normals = areas.to_vec();
    for _ in 0..=NORMAL_PASSES {
        let mut sums = vec![V3::zeros(); fans.len()];
        for (corner, &fan) in fans.iter().enumerate() {
            sums[fan] += normals[corner / 3];
        }
        for (t, triangle) in triangles.iter_mut().enumerate() {
            let flat = areas[t].normalize();
            for (k, corner) in triangle.iter_mut().enumerate() {
                corner.normal = sums[fans[3 * t + k]].try_normalize(1e-12).unwrap_or(flat);
            }
            normals[t] = triangle.iter().map(|c| c.normal).sum::<V3>() * areas[t].norm();
        }
    }
    sharp
}

fn mean_tint(triangle: &[Corner; 3]) -> f32 {
    triangle.iter().map(|c| c.tint).sum::<f32>() / 3.0
}

fn root(parents: &mut [usize], mut node: usize) -> usize {
    while parents[node] != node {
        parents[node] = parents[parents[node]];
        node = parents[node];
    }
    node
}

fn join(parents: &mut [usize], a: usize, b: usize) {
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a.max(b)] = a.min(b);
}

/// A cubic point-normal triangle.
struct CurvedTriangle {
    corners: [Corner; 3],
    /// `edge[k][0]` next to corner k, `edge[k][1]` next to corner k + 1.
    edge: [[V3; 2]; 3],
    middle: V3,
}

impl CurvedTriangle {
    fn new(corners: &[Corner; 3], sharp: &[bool; 3]) -> Self {
        let p = corners.map(|c| c.position);
        let towards = |from: usize, to: usize, sharp: bool| {
            let along = p[to] - p[from];
            let limit = 0.4 * along.norm();
            let rise = along.dot(&corners[from].normal).clamp(-limit, limit);
            let bend = if sharp {
                V3::zeros()
            } else {
                corners[from].normal * rise
            };
            p[from] + (along - bend) / 3.0
        };
        let edge = [0, 1, 2].map(|k| {
            let next = (k + 1) % 3;
            [towards(k, next, sharp[k]), towards(next, k, sharp[k])]
        });
        let edge_mean = edge.iter().flatten().sum::<V3>() / 6.0;
        let corner_mean = p.iter().sum::<V3>() / 3.0;
        Self {
            corners: *corners,
            edge,
            middle: edge_mean + (edge_mean - corner_mean) / 2.0,
        }
    }

    /// At barycentric coordinates (1 - u - v, u, v).
    fn at(&self, u: f32, v: f32) -> Corner {
        let w = (1.0 - u - v).max(0.0);
        let [a, b, c] = &self.corners;
        let [ab, bc, ca] = &self.edge;
        let position = a.position * (w * w * w)
            + b.position * (u * u * u)
            + c.position * (v * v * v)
            + ab[0] * (3.0 * w * w * u)
            + ab[1] * (3.0 * w * u * u)
            + bc[0] * (3.0 * u * u * v)
            + bc[1] * (3.0 * u * v * v)
            + ca[0] * (3.0 * v * v * w)
            + ca[1] * (3.0 * v * w * w)
            + self.middle * (6.0 * u * v * w);
        let normal = a.normal * w + b.normal * u + c.normal * v;
        Corner {
            position,
            normal: normal.try_normalize(1e-9).unwrap_or(a.normal),
            tint: a.tint * w + b.tint * u + c.tint * v,
        }
    }
}

/// The facets of a tool: tip parts in steel, a plastic sheath, a ring in the accent colour.
pub(super) fn tool_facets(tool: &ToolPose, view: &View) -> Vec<Facet> {
    let finite = tool
        .position
        .iter()
        .chain(&tool.axis)
        .all(|x| x.is_finite());
    let sized = tool.radius.is_finite() && tool.radius > 0.0 && tool.length.is_finite();
    let Some(axis) = Vector3::from(tool.axis)
        .try_normalize(1e-12)
        .filter(|_| finite && sized)
    else {
        return Vec::new();
    };
    // Jaws open across the line of sight, where they show.
    let side = axis
        .cross(&view.back())
        .try_normalize(1e-6)
        .or_else(|| axis.cross(&Vector3::x()).try_normalize(1e-6))
        .unwrap_or(Vector3::y());
    let frame = Frame {
        origin: tool.position.into(),
        side,
        depth: axis.cross(&side),
        axis,
    };
    // A shaft longer than the scene leaves the picture anyway.
    let r = tool.radius.min(view.radius());
    let end = tool
        .length
        .clamp(r, 20.0 * view.radius().max(r))
        .max(2.0 * r);
    let steel = (Finish::Steel, [208, 212, 218]);
    let sheath = (Finish::Plastic, [44, 48, 56]);
    let ring = (Finish::Plastic, tool.accent);
    let mut parts: Vec<(Solid, (Finish, [u8; 3]))> = Vec::new();
    let shaft = |parts: &mut Vec<(Solid, _)>, start: f64, body| {
        let cuts = [start, start + 1.6 * r, start + 3.4 * r, end].map(|z| z.min(end));
        parts.push((frame.tube(cuts[0], cuts[1], 0.94 * r), steel));
        parts.push((frame.tube(cuts[1], cuts[2], 1.04 * r), ring));
        parts.push((frame.tube(cuts[2], cuts[3], r), body));
    };
    match tool.look {
        ToolLook::Probe => {
            parts.push((frame.lathe(&dome(r, (2.0 * r).min(end))), steel));
            shaft(&mut parts, 2.0 * r, steel);
        }
        ToolLook::Grasper => {
            let open = if tool.active { 0.0 } else { 0.32 };
            parts.push((frame.jaw(1.0, open, r), steel));
            parts.push((frame.jaw(-1.0, open, r), steel));
            shaft(&mut parts, 6.5 * r, sheath);
        }
        ToolLook::Cautery => {
            let tip = if tool.active {
                (Finish::Glow, [255, 138, 40])
            } else {
                steel
            };
            parts.push((frame.lathe(&dome(0.38 * r, 1.6 * r)), tip));
            parts.push((frame.tube(1.6 * r, 5.0 * r, 0.38 * r), steel));
            let collar = [
                [5.0 * r, 0.0],
                [5.0 * r, 0.55 * r],
                [6.5 * r, 0.94 * r],
                [6.5 * r, 0.0],
            ];
            parts.push((frame.lathe(&collar), (Finish::Plastic, [236, 232, 222])));
            shaft(&mut parts, 6.5 * r, sheath);
        }
    }
    parts
        .iter()
        .flat_map(|(solid, (finish, color))| {
            let surface = Surface {
                vertices: &solid.vertices,
                triangles: &solid.triangles,
                tint: Tint::None,
            };
            facets(&surface, view, *finish, *color)
        })
        .collect()
}

/// Profile (height, radius) of a rounded tip from the axis to a cylinder that ends at `height`.
fn dome(radius: f64, height: f64) -> Vec<[f64; 2]> {
    let steps = 8;
    let mut profile: Vec<[f64; 2]> = (0..=steps)
        .map(|i| (f64::from(i) / f64::from(steps) * TAU / 4.0).sin_cos())
        .map(|(sin, cos)| [radius * (1.0 - cos), radius * sin])
        .collect();
    profile.push([height.max(radius * 1.01), radius]);
    profile
}

struct Frame {
    origin: Vector3<f64>,
    side: Vector3<f64>,
    depth: Vector3<f64>,
    axis: Vector3<f64>,
}

#[derive(Default)]
struct Solid {
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl Frame {
    fn point(&self, side: f64, depth: f64, height: f64) -> [f64; 3] {
        (self.origin + self.side * side + self.depth * depth + self.axis * height).into()
    }

    fn tube(&self, from: f64, to: f64, radius: f64) -> Solid {
        self.lathe(&[[from, 0.0], [from, radius], [to, radius], [to, 0.0]])
    }

    /// A profile (height, radius) turned about the axis.
    fn lathe(&self, profile: &[[f64; 2]]) -> Solid {
        self.loft(
            profile
                .iter()
                .map(|&[height, radius]| (height, 0.0, [radius, radius])),
            32,
        )
    }

    /// One jaw of a grasper: a half-elliptic bar from the hinge at 6.5 r to a blunt tip.
    fn jaw(&self, sign: f64, open: f64, r: f64) -> Solid {
        let steps = 14;
        let rings = (0..=steps).map(|i| {
            let s = f64::from(i) / f64::from(steps);
            let height = 6.6 * r * s;
            let blunt = (1.0 - (1.0 - (s * 5.0).min(1.0)).powi(2)).sqrt();
            let thick = r * (0.20 + 0.22 * s) * blunt;
            let wide = r * (0.55 + 0.35 * s) * blunt;
            let gap = r * (0.24 + 0.20 * s) + open * (6.6 * r - height);
            (height, sign * gap, [thick, wide])
        });
        self.loft(rings, 20)
    }

    /// Ellipses (height, offset to the side, half axes) joined to a closed skin.
    fn loft(&self, rings: impl Iterator<Item = (f64, f64, [f64; 2])>, around: u32) -> Solid {
        let mut solid = Solid::default();
        let mut below: Option<Vec<u32>> = None;
        let mut top = Vec::new();
        for (height, offset, [a, b]) in rings {
            let first = solid.vertices.len() as u32;
            let corners = if a * b == 0.0 { 1 } else { around };
            for i in 0..corners {
                let (sin, cos) = (f64::from(i) / f64::from(around) * TAU).sin_cos();
                solid
                    .vertices
                    .push(self.point(offset + a * cos, b * sin, height));
            }
            let ring: Vec<u32> = (0..around).map(|i| first + i % corners).collect();
            match below.replace(ring.clone()) {
                Some(low) => {
                    for i in 0..around as usize {
                        let next = (i + 1) % around as usize;
                        solid.triangles.push([low[i], low[next], ring[next]]);
                        solid.triangles.push([low[i], ring[next], ring[i]]);
                    }
                }
                None => solid
                    .triangles
                    .extend(ring.windows(2).map(|w| [ring[0], w[1], w[0]])),
            }
            top = ring;
        }
        solid
            .triangles
            .extend(top.windows(2).map(|w| [top[0], w[0], w[1]]));
        solid
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        View::framing(
            [0.0, -1.0, 0.3],
            [0.0, 0.0, 1.0],
            1.0,
            &[[0.0; 3], [1.0; 3]],
        )
    }

    const CUBE: [[f64; 3]; 8] = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, 0.0, 1.0],
        [1.0, 1.0, 1.0],
        [0.0, 1.0, 1.0],
    ];
    const FACES: [[u32; 3]; 12] = [
        [0, 2, 1],
        [0, 3, 2],
        [4, 5, 6],
        [4, 6, 7],
        [0, 1, 5],
        [0, 5, 4],
        [1, 2, 6],
        [1, 6, 5],
        [2, 3, 7],
        [2, 7, 6],
        [3, 0, 4],
        [3, 4, 7],
    ];

    #[test]
    fn a_cube_keeps_flat_faces_and_sharp_edges() {
        let surface = Surface {
            vertices: &CUBE,
            triangles: &FACES,
            tint: Tint::None,
        };
        let mesh = Mesh::new(&surface, &view());
        assert_eq!(mesh.sharp.iter().flatten().filter(|&&s| s).count(), 24);
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|c| c.position);
            let flat = (b - a).cross(&(c - a)).normalize();
            for corner in triangle {
                assert!((corner.normal - flat).norm() < 1e-5);
            }
        }
    }

    #[test]
    fn a_tint_jump_is_a_crease_and_bad_triangles_are_left_out() {
        let mut tints = [0.0; 12];
        tints[0] = 1.0;
        let mut faces = FACES.to_vec();
        faces.extend([[0, 1, 99], [1, 1, 2]]);
        let surface = Surface {
            vertices: &CUBE,
            triangles: &faces,
            tint: Tint::Triangles(&tints),
        };
        let mesh = Mesh::new(&surface, &view());
        assert_eq!(mesh.triangles.len(), 12);
        assert_eq!(mesh.sharp.iter().flatten().filter(|&&s| s).count(), 26);
    }

    #[test]
    fn tools_are_closed_and_outward() {
        let frame = Frame {
            origin: Vector3::zeros(),
            side: Vector3::x(),
            depth: Vector3::y(),
            axis: Vector3::z(),
        };
        for solid in [
            frame.tube(0.0, 2.0, 0.5),
            frame.lathe(&dome(0.5, 2.0)),
            frame.jaw(1.0, 0.3, 0.5),
        ] {
            let p = |i: u32| Vector3::from(solid.vertices[i as usize]);
            let volume: f64 = solid
                .triangles
                .iter()
                .map(|&[a, b, c]| p(a).dot(&p(b).cross(&p(c))) / 6.0)
                .sum();
            assert!(volume > 0.0, "volume {volume}");
        }
    }

    #[test]
    fn impossible_tools_vanish() {
        let tool = ToolPose {
            look: ToolLook::Grasper,
            position: [0.0; 3],
            axis: [0.0; 3],
            radius: 0.1,
            length: 1.0,
            active: false,
            accent: [0; 3],
        };
        assert!(tool_facets(&tool, &view()).is_empty());
        let tool = ToolPose {
            axis: [0.0, 0.0, 1.0],
            radius: f64::NAN,
            ..tool
        };
        assert!(tool_facets(&tool, &view()).is_empty());
    }
}
