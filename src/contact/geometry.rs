//! Distances between tool shapes and triangles, the only place that knows parry.

use parry3d_f64::math::{Pose as Isometry, Vector};
use parry3d_f64::query::PointQuery;
use parry3d_f64::query::details::distance_support_map_support_map;
use parry3d_f64::shape::{Segment, Triangle};

use crate::mesh::Vec3;
use crate::pose::Pose;

/// A swept sphere in the world: all points within `radius` of the segment from `tip` to `end`
/// (equal for a sphere) \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    pub tip: Vec3,
    pub end: Vec3,
    pub radius: f64,
}

impl Capsule {
    /// No longer than `length` from the tip.
    pub fn within(&self, length: Option<f64>) -> Capsule {
        let axis = self.end - self.tip;
        let share = length.map_or(1.0, |l| l / axis.norm());
        let end = match share < 1.0 {
            true => self.tip + axis * share,
            false => self.end,
        };
        Capsule { end, ..*self }
    }

    /// Given in a frame, where that is.
    pub fn placed(&self, frame: &Pose) -> Capsule {
        Capsule {
            tip: frame.point(&self.tip),
            end: frame.point(&self.end),
            ..*self
        }
    }

    /// Lowest and highest corner of its box, grown by `margin` \[m\].
    pub fn bounds(&self, margin: f64) -> (Vec3, Vec3) {
        let grow = Vec3::repeat(self.radius + margin);
        (
            self.tip.inf(&self.end) - grow,
            self.tip.sup(&self.end) + grow,
        )
    }

    /// Whether it reaches the smallest ball about the points' mean that holds them: what it does not
    /// reach it cannot touch.
    pub fn may_touch(&self, points: &[Vec3]) -> bool {
        let middle = points.iter().sum::<Vec3>() / points.len() as f64;
        let reach = points
            .iter()
            .map(|p| (p - middle).norm_squared())
            .fold(0.0, f64::max)
            .sqrt();
        self.axis_distance(&middle) <= self.radius + reach
    }

    /// From its axis to a point \[m\].
    pub fn axis_distance(&self, point: &Vec3) -> f64 {
        (point - self.on_axis(point)).norm()
    }

    /// The point of its axis that is nearest to another.
    pub fn on_axis(&self, point: &Vec3) -> Vec3 {
        let (axis, from) = (self.end - self.tip, point - self.tip);
        let length = axis.norm_squared();
        let share = if length > 0.0 {
            (from.dot(&axis) / length).clamp(0.0, 1.0)
        } else {
            0.0
        };
        self.tip + axis * share
    }

    /// Of the point of an edge that is nearest to the axis, its share of the way from `a` to `b` and the point of the
    /// axis; none where that is an end of the edge. (Ericson 2005, section 5.1.9.)
    pub fn nearest_on_edge(&self, a: &Vec3, b: &Vec3) -> Option<(f64, Vec3)> {
        let (edge, axis, apart) = (b - a, self.end - self.tip, a - self.tip);
        let (e, f, c) = (edge.norm_squared(), axis.norm_squared(), edge.dot(&axis));
        if e == 0.0 {
            return None;
        }
        let (d, g) = (edge.dot(&apart), axis.dot(&apart));
        // Where the lines are nearest, then within the axis.
        let cross = e * f - c * c;
        let on_edge = match cross > 1e-12 * e * f {
            true => ((c * g - d * f) / cross).clamp(0.0, 1.0),
            false => 0.5,
        };
        let on_axis = match f > 0.0 {
            true => ((c * on_edge + g) / f).clamp(0.0, 1.0),
            false => 0.0,
        };
        let share = (c * on_axis - d) / e;
        (share > 0.0 && share < 1.0).then(|| (share, self.tip + axis * on_axis))
    }

    /// Whether it touches a triangle.
    pub fn touches(&self, corners: &[Vec3; 3]) -> bool {
        let [a, b, c] = corners.map(vector);
        let triangle = Triangle::new(a, b, c);
        let distance = if self.tip == self.end {
            triangle.distance_to_local_point(vector(self.tip), true)
        } else {
            let axis = Segment::new(vector(self.tip), vector(self.end));
            distance_support_map_support_map(&Isometry::IDENTITY, &axis, &triangle)
        };
        distance < self.radius
    }

    /// Whether it touches a tetrahedron, inside or out.
    pub fn touches_tetrahedron(&self, p: &[Vec3; 4]) -> bool {
        let side = |a: usize, b: usize, c: usize| {
            (p[b] - p[a]).cross(&(p[c] - p[a])).dot(&(self.tip - p[a]))
        };
        let sides = [side(1, 2, 3), side(0, 3, 2), side(0, 1, 3), side(0, 2, 1)];
        let inside = sides.iter().all(|s| *s <= 0.0) || sides.iter().all(|s| *s >= 0.0);
        inside
            || [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]
                .iter()
                .any(|f| self.touches(&f.map(|k: usize| p[k])))
    }
}

fn vector(v: Vec3) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

/// Whether the box of some points meets the box from `low` to `high`.
pub fn boxes_meet(points: &[Vec3], low: &Vec3, high: &Vec3) -> bool {
    (0..3).all(|axis| {
        points.iter().any(|p| p[axis] >= low[axis]) && points.iter().any(|p| p[axis] <= high[axis])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLOOR: [Vec3; 3] = [
        Vec3::new(0.0, 0.0, 0.0),
        Vec3::new(1.0, 0.0, 0.0),
        Vec3::new(0.0, 1.0, 0.0),
    ];

    fn capsule(tip: [f64; 3], end: [f64; 3], radius: f64) -> Capsule {
        Capsule {
            tip: tip.into(),
            end: end.into(),
            radius,
        }
    }

    #[test]
    fn a_sphere_touches_at_its_radius() {
        assert!(capsule([0.2, 0.2, 0.1], [0.2, 0.2, 0.1], 0.1001).touches(&FLOOR));
        assert!(!capsule([0.2, 0.2, 0.1], [0.2, 0.2, 0.1], 0.0999).touches(&FLOOR));
    }

    #[test]
    fn a_shaft_between_the_vertices_touches() {
        assert!(capsule([0.3, 0.3, -1.0], [0.3, 0.3, 1.0], 0.001).touches(&FLOOR));
        assert!(!capsule([0.8, 0.8, -1.0], [0.8, 0.8, 1.0], 0.001).touches(&FLOOR));
    }

    #[test]
    fn what_touches_may_touch() {
        for k in 0..200 {
            let f = |n: f64| (f64::from(k) * n).sin();
            let capsule = capsule([f(1.3), f(2.1), f(0.7)], [f(3.3), f(1.7), f(5.1)], 0.1);
            assert!(capsule.may_touch(&FLOOR) || !capsule.touches(&FLOOR));
        }
        assert!(!capsule([3.0, 0.0, 0.0], [4.0, 0.0, 0.0], 0.1).may_touch(&FLOOR));
    }

    #[test]
    fn a_small_tip_inside_a_tetrahedron_touches_it() {
        let p = [FLOOR[0], FLOOR[1], FLOOR[2], Vec3::z()];
        assert!(capsule([0.2, 0.2, 0.2], [0.2, 0.2, 0.2], 1e-4).touches_tetrahedron(&p));
        assert!(!capsule([0.5, 0.5, 0.5], [0.5, 0.5, 0.5], 1e-4).touches_tetrahedron(&p));
    }
}
