//! A procedural liver: a large right lobe and a left one that tapers to a thin edge, a notch between
//! them at the falciform ligament, hollow underneath.

use std::ops::RangeInclusive;

use super::{TetMesh, Vec3, smooth, stuffing};

/// The edge lengths [`generate`] takes \[m\]: a coarser liver has no lobes, a finer one more than
/// 140 000 nodes.
pub const EDGE_LENGTH: RangeInclusive<f64> = 0.003..=0.03;

/// Lowest and highest corner of a box round the liver \[m\].
const BOUNDS: [[f64; 3]; 2] = [[-0.14, -0.09, -0.09], [0.14, 0.1, 0.08]];

/// The liver with interior edges of `edge_length` and 0.87 `edge_length` \[m\]; at 0.015 m 1558
/// nodes and 6714 tetrahedra.
///
/// 0.26 m wide, 1.7 litres. x runs from its right lobe to its left, -y to its front, z up to its
/// dome. One piece, dihedral angles above 10 degrees, the same mesh from call to call. Empty where
/// `edge_length` is outside [`EDGE_LENGTH`].
pub fn generate(edge_length: f64) -> TetMesh {
    if !EDGE_LENGTH.contains(&edge_length) {
        return TetMesh::default();
    }
    let mut mesh = stuffing::fill(liver, BOUNDS.map(Vec3::from), edge_length);
    smooth::smooth(&mut mesh, liver);
    mesh
}

/// About the distance to the surface \[m\], positive inside.
fn liver(p: Vec3) -> f64 {
    let right = ellipsoid(p, [-0.050, 0.004, -0.004], [0.077, 0.074, 0.070]);
    let left = ellipsoid(p, [0.040, -0.010, 0.024], [0.092, 0.056, 0.032]);
    let hollow = ellipsoid(p, [0.040, -0.006, -0.084], [0.120, 0.110, 0.090]);
    let notch = ellipsoid(p, [0.030, -0.084, 0.02], [0.015, 0.038, 0.09]);
    let lobes = join(right, left, 0.05);
    cut(cut(lobes, hollow, 0.04), notch, 0.015)
}

/// About the distance to an ellipsoid, positive inside, exact on it (Quilez 2008).
fn ellipsoid(p: Vec3, centre: [f64; 3], radii: [f64; 3]) -> f64 {
    let (p, radii) = (p - Vec3::from(centre), Vec3::from(radii));
    let scaled = p.component_div(&radii);
    let slope = scaled.component_div(&radii).norm();
    if slope == 0.0 {
        radii.min()
    } else {
        (1.0 - scaled.norm()) * scaled.norm() / slope
    }
}

/// Both together, the seam rounded over `width` \[m\].
fn join(one: f64, other: f64, width: f64) -> f64 {
    let overlap = (1.0 - (one - other).abs() / width).max(0.0);
    one.max(other) + overlap * overlap * width / 4.0
}

/// What `tool` leaves of `body`, the rim rounded over `width` \[m\].
fn cut(body: f64, tool: f64, width: f64) -> f64 {
    -join(-body, tool, width)
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn default_is_a_liver_in_size_and_number() {
        let mut mesh = generate(0.015);
        assert_eq!((mesh.nodes.len(), mesh.tetrahedra.len()), (1558, 6714));
        let report = check::repair(&mut mesh).unwrap();
        let size = report.bounds[1] - report.bounds[0];
        assert!(
            (0.22..0.28).contains(&size.x) && (0.13..0.18).contains(&size.y),
            "{size}"
        );
        assert!((0.10..0.16).contains(&size.z), "{size}");
        assert!(
            (1.4e-3..1.8e-3).contains(&report.volume),
            "{}",
            report.volume
        );
        assert_eq!(generate(0.015), generate(0.015));
    }

    #[test]
    fn whole_closed_and_well_shaped_at_any_edge_length() {
        for edge in [0.008, 0.0101, 0.0133, 0.015, 0.0171, 0.0209, 0.0254, 0.03] {
            let mesh = generate(edge);
            let mut repaired = mesh.clone();
            let report = check::repair(&mut repaired).unwrap();
            assert_eq!(repaired, mesh, "nothing to flip");
            assert_eq!(
                (report.pieces, report.hinge_edges, report.coincident),
                (1, 0, 0)
            );
            assert_eq!(report.unreferenced, Vec::<u32>::new());
            assert!(report.minimum_dihedral_degrees > 25.0, "{edge}: {report:?}");

            let surface = check::surface(&mesh.tetrahedra).unwrap();
            let mut nodes: Vec<u32> = surface.iter().flatten().copied().collect();
            nodes.sort_unstable();
            nodes.dedup();
            // Euler: a sphere has V - E + F = 2, with E = 3 F / 2.
            assert_eq!(
                2 * nodes.len(),
                surface.len() + 4,
                "one surface, without handles"
            );
            for &node in &nodes {
                assert!(liver(mesh.nodes[node as usize]).abs() < 1e-4 * edge);
            }
        }
    }

    #[test]
    fn a_left_lobe_thinner_than_the_right_and_a_hollow_beneath() {
        let thickness = |x: f64, y: f64| {
            (-900..900)
                .filter(|&z| liver(Vec3::new(x, y, f64::from(z) * 1e-4)) > 0.0)
                .count() as f64
                * 1e-4
        };
        assert!(thickness(-0.06, 0.0) > 0.1);
        assert!((0.01..0.05).contains(&thickness(0.09, 0.0)));
        let floor = |x: f64| {
            (-900..900)
                .map(|z| f64::from(z) * 1e-4)
                .find(|&z| liver(Vec3::new(x, 0.0, z)) > 0.0)
        };
        assert!(floor(0.03) > floor(-0.06).map(|z| z + 0.04));
        assert!(liver(Vec3::new(0.03, -0.06, 0.02)) < 0.0, "the notch");
        assert!(liver(Vec3::new(0.06, -0.045, 0.02)) > 0.0);
    }

    #[test]
    fn no_liver_outside_the_range() {
        for edge in [0.0, -1.0, 0.0029, 0.031, f64::NAN, f64::INFINITY] {
            assert_eq!(generate(edge), TetMesh::default());
        }
    }
}
