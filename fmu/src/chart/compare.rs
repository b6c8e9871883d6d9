//! Shapes and forces of different meshes, side by side.

use tissue::mesh::{TetMesh, Vec3};

/// Points of a body's surface at rest, with the share of the area that each stands for: the centroids of the triangles
/// of its coarsest mesh.
pub struct Points {
    at: Vec<Vec3>,
    share: Vec<f64>,
}

/// Where the points lie on a mesh: in a triangle, with barycentric coordinates.
pub struct Places(Vec<([u32; 3], [f64; 3])>);

impl Points {
    pub fn new(mesh: &TetMesh, surface: &[[u32; 3]]) -> Points {
        let corners = |t: &[u32; 3]| t.map(|v| mesh.nodes[v as usize]);
        let areas: Vec<f64> = (surface.iter().map(corners))
            .map(|[a, b, c]| 0.5 * (b - a).cross(&(c - a)).norm())
            .collect();
        let total: f64 = areas.iter().sum();
        Points {
            at: (surface.iter().map(corners))
                .map(|[a, b, c]| (a + b + c) / 3.0)
                .collect(),
            share: areas.iter().map(|area| area / total).collect(),
        }
    }

    /// The nearest triangle of a mesh to each.
    pub fn on(&self, mesh: &TetMesh, surface: &[[u32; 3]]) -> Places {
        let triangles: Vec<([Vec3; 3], Vec3, f64)> = (surface.iter())
            .map(|t| {
                let corners = t.map(|v| mesh.nodes[v as usize]);
                let middle = corners.iter().sum::<Vec3>() / 3.0;
                let reach = corners.iter().map(|p| (p - middle).norm());
                (corners, middle, reach.fold(0.0, f64::max))
            })
            .collect();
        let place = |p: &Vec3| {
            let mut best = (f64::INFINITY, 0, [1.0, 0.0, 0.0]);
            for (k, (corners, middle, reach)) in triangles.iter().enumerate() {
                if (p - middle).norm() - reach >= best.0 {
                    continue;
                }
                let shares = nearest(corners, p);
                let found: Vec3 = (0..3).map(|j| corners[j] * shares[j]).sum();
                let distance = (found - p).norm();
                if distance < best.0 {
                    best = (distance, k, shares);
                }
            }
            (surface[best.1], best.2)
        };
        Places(self.at.iter().map(place).collect())
    }

    /// Root of the mean over the area \[m\] of what both know.
    pub fn distance_of_known(&self, a: &[Option<Vec3>], b: &[Option<Vec3>]) -> f64 {
        let (mut sum, mut area) = (0.0, 0.0);
        for ((a, b), share) in a.iter().zip(b).zip(&self.share) {
            if let (Some(a), Some(b)) = (a, b) {
                sum += (a - b).norm_squared() * share;
                area += share;
            }
        }
        if area > 0.0 { (sum / area).sqrt() } else { 0.0 }
    }

    /// Root of the mean over the area of the squared distance, and the largest distance \[m\].
    pub fn distance(&self, a: &[Vec3], b: &[Vec3]) -> (f64, f64) {
        let squares = || a.iter().zip(b).map(|(a, b)| (a - b).norm_squared());
        let mean: f64 = squares().zip(&self.share).map(|(d, share)| d * share).sum();
        (mean.sqrt(), squares().fold(0.0, f64::max).sqrt())
    }
}

impl Places {
    /// Nodes of the triangles and shares of them.
    pub fn triangles(&self) -> impl Iterator<Item = &([u32; 3], [f64; 3])> {
        self.0.iter()
    }

    /// Displacement of the points \[m\] by that of nodes.
    pub fn displacement(&self, mut of: impl FnMut(u32) -> Vec3) -> Vec<Vec3> {
        (self.0.iter())
            .map(|(nodes, shares)| (0..3).map(|j| of(nodes[j]) * shares[j]).sum())
            .collect()
    }
}

/// Barycentric coordinates of a triangle's nearest point (Ericson, Real-Time Collision Detection, 2005, section 5.1.5).
fn nearest([a, b, c]: &[Vec3; 3], p: &Vec3) -> [f64; 3] {
    let (ab, ac) = (b - a, c - a);
    let (ap, bp, cp) = (p - a, p - b, p - c);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3);
        return [1.0 - v, v, 0.0];
    }
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6);
        return [1.0 - w, 0.0, w];
    }
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - w, w];
    }
    let sum = va + vb + vc;
    [va / sum, vb / sum, vc / sum]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against a search over a fine grid of the triangle.
    #[test]
    fn the_nearest_point_is_nearest() {
        let corners = [
            Vec3::new(0.1, 0.0, 0.3),
            Vec3::new(1.0, 0.2, 0.0),
            Vec3::new(0.2, 0.9, -0.4),
        ];
        let at = |s: [f64; 3]| -> Vec3 { (0..3).map(|j| corners[j] * s[j]).sum() };
        for k in 0..200 {
            let x = f64::from(k);
            let p = Vec3::new((x * 0.7).sin(), (x * 1.3).cos(), (x * 0.37).sin()) * 1.5;
            let shares = nearest(&corners, &p);
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            assert!(shares.iter().all(|s| *s >= -1e-12));
            let found = (at(shares) - p).norm();
            for i in 0..=60 {
                for j in 0..=60 - i {
                    let (v, w) = (f64::from(i) / 60.0, f64::from(j) / 60.0);
                    assert!(found <= (at([1.0 - v - w, v, w]) - p).norm() + 1e-12);
                }
            }
        }
    }
}
