//! A cylinder: a disc of concentric rings of triangles, swept into prisms of three tetrahedra.

use std::f64::consts::TAU;

use super::{MAXIMUM_NODES, TetMesh, Vec3};

/// A cylinder round the z axis, its base at z = 0, of tetrahedra with edges near `edge_length`.
///
/// All in metres. Ring r of R = round(radius / `edge_length`) has 6 r nodes, those of ring R lie on
/// the cylinder; layers are height / `edge_length`, rounded; at least one of each. The surface is a
/// prism of 6 R sides, so the volume is short of the cylinder's by a share of about 0.18 / R².
/// Empty where an argument is not positive or the mesh would have more than [`MAXIMUM_NODES`] nodes.
pub fn generate(radius: f64, height: f64, edge_length: f64) -> TetMesh {
    let positive = |x: f64| x.is_finite() && x > 0.0;
    if ![radius, height, edge_length].into_iter().all(positive) {
        return TetMesh::default();
    }
    let steps = |length: f64| (length / edge_length).round().max(1.0);
    let (rings, layers) = (steps(radius), steps(height));
    if (1.0 + 3.0 * rings * (rings + 1.0)) * (layers + 1.0) > MAXIMUM_NODES as f64 {
        return TetMesh::default();
    }
    let (rings, layers) = (rings as usize, layers as usize);

    let mut mesh = TetMesh::default();
    for layer in 0..=layers {
        let z = height * layer as f64 / layers as f64;
        mesh.nodes.push(Vec3::new(0.0, 0.0, z));
        for ring in 1..=rings {
            let r = radius * ring as f64 / rings as f64;
            for step in 0..6 * ring {
                let (sine, cosine) = (TAU * step as f64 / (6 * ring) as f64).sin_cos();
                mesh.nodes.push(Vec3::new(r * cosine, r * sine, z));
            }
        }
    }
    let triangles = disc(rings);
    let size = first_of_ring(rings + 1) as u32;
    for layer in 0..layers as u32 {
        // Every second layer is swept downwards: the mirror image.
        let up = layer % 2 == 0;
        let (from, to) = if up {
            (layer, layer + 1)
        } else {
            (layer + 1, layer)
        };
        for &(triangle, counter_clockwise) in &triangles {
            let ends = [from, to].map(|level| triangle.map(|node| level * size + node));
            for mut tetrahedron in split_prism(ends[0], ends[1]) {
                if counter_clockwise != up {
                    tetrahedron.swap(2, 3);
                }
                mesh.tetrahedra.push(tetrahedron);
            }
        }
    }
    mesh
}

/// Three tetrahedra of the prism between triangles `from` and `to`, positive where `from` is
/// counter-clockwise seen from `to`. Each side is cut from its earlier corner in `from` to its later
/// corner in `to`, so prisms conform where all corners are in one order.
pub(super) fn split_prism([a, b, c]: [u32; 3], [d, e, f]: [u32; 3]) -> [[u32; 4]; 3] {
    [[a, b, c, f], [a, b, f, e], [a, d, e, f]]
}

/// Nodes inside `ring`: the number of its first node.
fn first_of_ring(ring: usize) -> usize {
    if ring == 0 {
        0
    } else {
        1 + 3 * ring * (ring - 1)
    }
}

/// The triangles of a triangular lattice drawn onto circles, each in the order of the lattice's
/// three colours, and whether that order is counter-clockwise.
fn disc(rings: usize) -> Vec<([u32; 3], bool)> {
    let mut triangles = Vec::with_capacity(6 * rings * rings);
    let mut add = |corners: [[usize; 2]; 3]| {
        let nodes =
            corners.map(|[ring, step]| (first_of_ring(ring) + step % (6 * ring).max(1)) as u32);
        let colours = corners.map(|[ring, step]| colour(ring, step));
        let mut order = [0, 1, 2];
        order.sort_by_key(|&corner| colours[corner]);
        triangles.push((
            order.map(|corner| nodes[corner]),
            (order[0] + 1) % 3 == order[1],
        ));
    };
    for ring in 1..=rings {
        for sector in 0..6 {
            let outer = |step| [ring, sector * ring + step];
            let inner = |step| [ring - 1, sector * (ring - 1) + step];
            for step in 0..ring {
                add([inner(step), outer(step), outer(step + 1)]);
            }
            for step in 0..ring - 1 {
                add([inner(step), outer(step + 1), inner(step + 1)]);
            }
        }
    }
    triangles
}

/// The colour 0, 1 or 2 of a lattice node; neighbours differ.
fn colour(ring: usize, step: usize) -> i64 {
    const CORNERS: [[i64; 2]; 7] = [[1, 0], [0, 1], [-1, 1], [-1, 0], [0, -1], [1, -1], [1, 0]];
    if ring == 0 {
        return 0;
    }
    let (sector, along) = (step / ring % 6, (step % ring) as i64);
    let [[px, py], [qx, qy]] = [CORNERS[sector], CORNERS[sector + 1]];
    let rest = ring as i64 - along;
    ((rest * px + along * qx) - (rest * py + along * qy)).rem_euclid(3)
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn fills_its_prism_in_good_positive_conforming_tetrahedra() {
        for (rings, layers) in [(1, 1), (2, 10), (3, 4), (5, 2), (8, 30)] {
            let (radius, edge) = (0.02, 0.02 / rings as f64);
            let height = edge * layers as f64;
            let mesh = generate(radius, height, edge);
            assert_eq!(
                mesh.nodes.len(),
                (1 + 3 * rings * (rings + 1)) * (layers + 1)
            );
            assert_eq!(mesh.tetrahedra.len(), 18 * rings * rings * layers);

            let mut repaired = mesh.clone();
            let report = check::repair(&mut repaired).unwrap();
            assert_eq!(repaired, mesh, "nothing to flip");
            let sides = 6.0 * rings as f64;
            let area = sides / 2.0 * radius * radius * (TAU / sides).sin();
            assert!((report.volume / (area * height) - 1.0).abs() < 1e-12);
            assert_eq!(
                report.surface_triangles,
                2 * 6 * rings * rings + 2 * 6 * rings * layers,
                "interior faces are shared by two"
            );
            assert_eq!((report.pieces, report.hinge_edges), (1, 0));
            assert!(report.minimum_dihedral_degrees > 30.0, "{report:?}");
        }
    }

    #[test]
    fn outermost_ring_lies_on_the_cylinder() {
        let (radius, height) = (0.05, 0.1);
        let mesh = generate(radius, height, 0.01);
        let size = first_of_ring(6);
        for (n, node) in mesh.nodes.iter().enumerate() {
            let r = node.xy().norm();
            if n % size >= first_of_ring(5) {
                assert!((r - radius).abs() < 1e-16);
            } else {
                assert!(r < radius - 0.009);
            }
            assert!((0.0..=height).contains(&node.z));
        }
    }

    #[test]
    fn coarse_and_impossible_cylinders() {
        let coarse = generate(0.01, 0.01, 1.0);
        assert_eq!((coarse.nodes.len(), coarse.tetrahedra.len()), (14, 18));
        for [radius, height, edge] in [
            [0.0, 1.0, 0.1],
            [1.0, -1.0, 0.1],
            [1.0, 1.0, f64::NAN],
            [1.0, 1.0, 1e-9],
            [1e300, 1.0, 1e-300],
        ] {
            assert_eq!(generate(radius, height, edge), TetMesh::default());
        }
    }
}
