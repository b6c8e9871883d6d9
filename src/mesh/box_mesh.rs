//! A box of equal cells, each cut into tetrahedra.
//!
//! Nodes and cells run along x fastest, then y, then z: node (i, j, k) of a box of (nx, ny, nz)
//! cells has number i + (nx+1) (j + (ny+1) k). Corner c of a cell is its node
//! (i + bit 0, j + bit 1, k + bit 2).

use super::{MAXIMUM_NODES, TetMesh, Vec3};

/// The regular tetrahedron in the middle and the four corners round it.
const FIVE: [[usize; 4]; 5] = [
    [0, 3, 6, 5],
    [1, 3, 0, 5],
    [2, 0, 3, 6],
    [4, 0, 6, 5],
    [7, 3, 5, 6],
];

/// Kuhn's six round the diagonal 0-7: one for each order in which the axes are walked.
const KUHN: [[usize; 4]; 6] = [
    [0, 1, 3, 7],
    [0, 3, 2, 7],
    [0, 2, 6, 7],
    [0, 6, 4, 7],
    [0, 4, 5, 7],
    [0, 5, 1, 7],
];

/// Five tetrahedra a cell, mirrored along x where i + j + k is odd so that the mesh conforms.
///
/// `size` and `origin` (the lowest corner) in metres. Empty where a size is not positive, `cells`
/// has a 0, or the mesh would have more than [`MAXIMUM_NODES`] nodes.
pub fn five(size: [f64; 3], cells: [usize; 3], origin: [f64; 3]) -> TetMesh {
    fill(size, cells, origin, &FIVE, |[i, j, k]| (i + j + k) % 2)
}

/// Six tetrahedra a cell round its diagonal (Kuhn 1960), mirrored along each axis in every second
/// cell so that the mesh conforms and has no preferred diagonal.
///
/// Arguments as for [`five`].
pub fn kuhn(size: [f64; 3], cells: [usize; 3], origin: [f64; 3]) -> TetMesh {
    fill(size, cells, origin, &KUHN, |[i, j, k]| {
        (i % 2) + 2 * (j % 2) + 4 * (k % 2)
    })
}

/// Fills each cell with `pattern`, reflected along the axes whose bit is set in `mirror`.
fn fill(
    size: [f64; 3],
    cells: [usize; 3],
    origin: [f64; 3],
    pattern: &[[usize; 4]],
    mirror: fn([usize; 3]) -> usize,
) -> TetMesh {
    let fits = node_count(cells).is_some_and(|count| count <= MAXIMUM_NODES);
    if !fits || cells.contains(&0) || size.iter().any(|&length| length.is_nan() || length <= 0.0) {
        return TetMesh::default();
    }
    let [nx, ny, nz] = cells;
    let at = |axis: usize, i: usize| origin[axis] + size[axis] * i as f64 / cells[axis] as f64;
    let number = |i: usize, j: usize, k: usize| i + (nx + 1) * (j + (ny + 1) * k);

    let mut mesh = TetMesh::default();
    for k in 0..=nz {
        for j in 0..=ny {
            for i in 0..=nx {
                mesh.nodes.push(Vec3::new(at(0, i), at(1, j), at(2, k)));
            }
        }
    }
    for k in 0..nz {
        for j in 0..ny {
            for i in 0..nx {
                let mask = mirror([i, j, k]);
                for &tetrahedron in pattern {
                    let mut nodes = tetrahedron.map(|corner| {
                        let c = corner ^ mask;
                        number(i + (c % 2), j + (c / 2 % 2), k + (c / 4)) as u32
                    });
                    if mask.count_ones() % 2 == 1 {
                        nodes.swap(2, 3);
                    }
                    mesh.tetrahedra.push(nodes);
                }
            }
        }
    }
    mesh
}

/// Nodes of a box of `cells`, or `None` where they are too many to count.
pub fn node_count(cells: [usize; 3]) -> Option<usize> {
    cells
        .iter()
        .try_fold(1usize, |product, n| product.checked_mul(n.checked_add(1)?))
}

#[cfg(test)]
mod tests {
    use super::super::{check, quality};
    use super::*;

    const SIZE: [f64; 3] = [0.3, 0.2, 0.1];

    #[test]
    fn fills_its_box_in_positive_conforming_tetrahedra() {
        for (make, each) in [(five as fn(_, _, _) -> _, 5), (kuhn, 6)] {
            for cells in [[1, 1, 1], [2, 1, 1], [3, 4, 5], [4, 2, 2]] {
                let mesh: TetMesh = make(SIZE, cells, [-1.0, 0.5, 2.0]);
                let count: usize = cells.iter().product();
                assert_eq!(mesh.tetrahedra.len(), each * count);
                assert_eq!(Some(mesh.nodes.len()), node_count(cells));

                let mut repaired = mesh.clone();
                let report = check::repair(&mut repaired).unwrap();
                assert_eq!(repaired, mesh, "nothing to flip");
                assert!((report.volume - 0.006).abs() < 1e-15);
                let [nx, ny, nz] = cells;
                assert_eq!(
                    report.surface_triangles,
                    4 * (nx * ny + ny * nz + nz * nx),
                    "interior faces are shared by two"
                );
                assert_eq!(report.pieces, 1);
                assert_eq!(report.unreferenced, Vec::<u32>::new());
                let [low, high] = report.bounds;
                assert!((low - Vec3::new(-1.0, 0.5, 2.0)).norm() < 1e-15);
                assert!((high - Vec3::new(-0.7, 0.7, 2.1)).norm() < 1e-15);
            }
        }
    }

    #[test]
    fn nodes_and_cells_run_along_x_first() {
        let mesh = five([2.0, 3.0, 4.0], [2, 3, 4], [0.0; 3]);
        assert_eq!(mesh.nodes[1 + 3 * (2 + 4 * 3)], Vec3::new(1.0, 2.0, 3.0));
        let centroid = |t: usize| {
            quality::corners(&mesh, mesh.tetrahedra[t])
                .iter()
                .sum::<Vec3>()
                / 4.0
        };
        assert!((centroid(0) - Vec3::repeat(0.5)).norm() < 1e-15);
        assert!((centroid(5) - Vec3::new(1.5, 0.5, 0.5)).norm() < 1e-15);
        assert!((centroid(10) - Vec3::new(0.5, 1.5, 0.5)).norm() < 1e-15);
    }

    #[test]
    fn cube_cells_have_known_angles() {
        for (mut mesh, least) in [
            (five([1.0; 3], [2; 3], [0.0; 3]), (1.0 / 3f64.sqrt()).acos()),
            (kuhn([1.0; 3], [2; 3], [0.0; 3]), 45f64.to_radians()),
        ] {
            let report = check::repair(&mut mesh).unwrap();
            assert!((report.minimum_dihedral_degrees - least.to_degrees()).abs() < 1e-9);
        }
    }

    #[test]
    fn impossible_boxes_are_empty() {
        assert_eq!(five(SIZE, [0, 1, 1], [0.0; 3]), TetMesh::default());
        assert_eq!(kuhn(SIZE, [usize::MAX; 3], [0.0; 3]), TetMesh::default());
        assert_eq!(
            five(SIZE, [4_000_000_000, 1, 1], [0.0; 3]),
            TetMesh::default()
        );
        assert_eq!(five([0.1, 0.0, 0.1], [1; 3], [0.0; 3]), TetMesh::default());
        assert_eq!(
            five([0.1, f64::NAN, 0.1], [1; 3], [0.0; 3]),
            TetMesh::default()
        );
    }
}
