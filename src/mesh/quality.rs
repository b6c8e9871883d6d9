//! The shape of one tetrahedron, its corners given in metres.

use super::{TetMesh, Vec3};

/// The local corners of the six edges, in the order of [`dihedral_angles`].
pub const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Local corners of the face opposite each corner, outward where the volume is positive.
pub const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// The corners of a tetrahedron whose node numbers are in range.
pub fn corners(mesh: &TetMesh, tetrahedron: [u32; 4]) -> [Vec3; 4] {
    tetrahedron.map(|node| mesh.nodes[node as usize])
}

/// Signed volume det(b-a, c-a, d-a) / 6 \[m³\].
pub fn volume([a, b, c, d]: [Vec3; 4]) -> f64 {
    (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0
}

/// Longest edge \[m\].
pub fn longest_edge(p: [Vec3; 4]) -> f64 {
    EDGES
        .iter()
        .map(|&[i, j]| (p[i] - p[j]).norm_squared())
        .fold(0.0, f64::max)
        .sqrt()
}

/// Cosines of the dihedral angles at the edges in the order of [`EDGES`]; NaN where a face has no area.
pub fn dihedral_cosines(p: [Vec3; 4]) -> [f64; 6] {
    let normal = FACES.map(|[i, j, k]| (p[j] - p[i]).cross(&(p[k] - p[i])).normalize());
    // The faces at edge (i, j) are those opposite the two other corners.
    [[2, 3], [1, 3], [1, 2], [0, 3], [0, 2], [0, 1]]
        .map(|[k, l]: [usize; 2]| (-normal[k].dot(&normal[l])).clamp(-1.0, 1.0))
}

/// Dihedral angles \[rad\] at the edges in the order of [`EDGES`]; all are arccos(1/3) where the
/// tetrahedron is regular.
pub fn dihedral_angles(p: [Vec3; 4]) -> [f64; 6] {
    dihedral_cosines(p).map(f64::acos)
}

/// Mean ratio 12 (3 V)^(2/3) / sum of squared edges: 1 where regular, 0 where flat, negative where
/// inverted (Liu and Joe 1994).
pub fn mean_ratio(p: [Vec3; 4]) -> f64 {
    let squares: f64 = EDGES
        .iter()
        .map(|&[i, j]| (p[i] - p[j]).norm_squared())
        .sum();
    let cube_root = (3.0 * volume(p)).cbrt();
    12.0 * cube_root * cube_root.abs() / squares
}

/// Radius ratio 3 r / R of the inscribed and the circumscribed sphere: 1 where regular, 0 where
/// flat, negative where inverted.
pub fn radius_ratio(p: [Vec3; 4]) -> f64 {
    let [u, v, w] = [p[1] - p[0], p[2] - p[0], p[3] - p[0]];
    let area: f64 = FACES
        .iter()
        .map(|&[i, j, k]| (p[j] - p[i]).cross(&(p[k] - p[i])).norm() / 2.0)
        .sum();
    // R = |u² v×w + v² w×u + w² u×v| / (12 V), r = 3 V / area
    let volume = volume(p);
    let moment = v.cross(&w) * u.norm_squared()
        + w.cross(&u) * v.norm_squared()
        + u.cross(&v) * w.norm_squared();
    108.0 * volume * volume.abs() / (area * moment.norm())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn regular() -> [Vec3; 4] {
        [
            Vec3::new(1.0, 1.0, 1.0),
            Vec3::new(-1.0, 1.0, -1.0),
            Vec3::new(1.0, -1.0, -1.0),
            Vec3::new(-1.0, -1.0, 1.0),
        ]
    }

    #[test]
    fn regular_tetrahedron_is_perfect() {
        let p = regular();
        let edge = 8f64.sqrt();
        assert!((volume(p) - edge.powi(3) / (6.0 * 2f64.sqrt())).abs() < 1e-14);
        assert!((longest_edge(p) - edge).abs() < 1e-14);
        assert!((mean_ratio(p) - 1.0).abs() < 1e-14);
        assert!((radius_ratio(p) - 1.0).abs() < 1e-14);
        for angle in dihedral_angles(p) {
            assert!((angle - (1.0f64 / 3.0).acos()).abs() < 1e-14);
        }
    }

    #[test]
    fn corner_of_a_cube_has_its_angles_in_edge_order() {
        let p = [Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()];
        let slanted = (1.0 / 3f64.sqrt()).acos().to_degrees();
        let expected = [90.0, 90.0, 90.0, slanted, slanted, slanted];
        for (angle, expected) in dihedral_angles(p).iter().zip(expected) {
            assert!((angle.to_degrees() - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn mirrored_is_negative_and_flat_is_zero() {
        let [a, b, c, d] = regular();
        let mirrored = [b, a, c, d];
        assert!((mean_ratio(mirrored) + 1.0).abs() < 1e-14);
        assert!((radius_ratio(mirrored) + 1.0).abs() < 1e-14);
        let flat = [a, b, c, (a + b + c) / 3.0];
        assert!(mean_ratio(flat).abs() < 1e-9);
        assert!(radius_ratio(flat).abs() < 1e-9);
    }
}
