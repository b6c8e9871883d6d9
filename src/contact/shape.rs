//! Shapes of tools: capsules placed in the tool's frame.

use nalgebra::{Quaternion, UnitQuaternion};

use super::geometry::Capsule;
use crate::mesh::Vec3;
use crate::pose::Pose;
use crate::scene::{self, Part, Shape};

/// One tool's: all of it, and the part that grasps or burns, of each capsule what is within `activeLength` of its own tip.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolShape {
    whole: Vec<Capsule>,
    active: Vec<Capsule>,
}

impl ToolShape {
    pub fn new(tool: &scene::Tool) -> ToolShape {
        let mut whole = Vec::new();
        let origin = Pose {
            position: Vec3::zeros(),
            orientation: UnitQuaternion::identity(),
        };
        add(&tool.shape, &origin, &mut whole);
        let active = whole.iter().map(|c| c.within(tool.active_length));
        ToolShape {
            active: active.collect(),
            whole,
        }
    }

    /// At a pose.
    pub fn at(&self, pose: &Pose) -> impl Iterator<Item = Capsule> + Clone + '_ {
        let pose = *pose;
        self.whole.iter().map(move |c| c.placed(&pose))
    }

    pub fn active_at(&self, pose: &Pose) -> impl Iterator<Item = Capsule> + Clone + '_ {
        let pose = *pose;
        self.active.iter().map(move |c| c.placed(&pose))
    }

    /// How long the part is that grasps, or how thick where it is a ball \[m\].
    pub fn grip(&self) -> f64 {
        let lengths = self
            .active
            .iter()
            .map(|c| (c.end - c.tip).norm() + 2.0 * c.radius);
        lengths.fold(0.0, f64::max)
    }

    /// How many.
    pub fn capsules(&self) -> usize {
        self.whole.len()
    }

    /// How far any point of an axis moves between two poses \[m\].
    pub fn way(&self, from: &Pose, to: &Pose) -> f64 {
        let moved = |c: &Capsule| {
            let (a, b) = (c.placed(from), c.placed(to));
            (b.tip - a.tip).norm().max((b.end - a.end).norm())
        };
        self.whole.iter().map(moved).fold(0.0, f64::max)
    }

    /// Of the thickest capsule \[m\].
    pub fn most_radius(&self) -> f64 {
        self.whole.iter().map(|c| c.radius).fold(0.0, f64::max)
    }

    /// Of the thinnest capsule \[m\].
    pub fn least_radius(&self) -> f64 {
        self.whole
            .iter()
            .map(|c| c.radius)
            .fold(f64::INFINITY, f64::min)
    }
}

/// The axis of a capsule runs from its place along its -z.
fn add(shape: &Shape, at: &Pose, to: &mut Vec<Capsule>) {
    let (radius, length) = match shape {
        Shape::Sphere { radius } => (*radius, 0.0),
        Shape::Capsule { radius, length } => (*radius, *length),
        Shape::Compound(parts) => {
            for Part {
                shape,
                position,
                orientation: [w, x, y, z],
            } in parts
            {
                let turn = UnitQuaternion::from_quaternion(Quaternion::new(*w, *x, *y, *z));
                let place = Pose {
                    position: at.point(&Vec3::from(*position)),
                    orientation: at.orientation * turn,
                };
                add(shape, &place, to);
            }
            return;
        }
    };
    to.push(Capsule {
        tip: at.position,
        end: at.point(&Vec3::new(0.0, 0.0, -length)),
        radius,
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball, and a rod of 0.2 m in a compound of its own, turned to point along y.
    #[test]
    fn parts_are_placed_in_each_other() {
        let turn = std::f64::consts::FRAC_1_SQRT_2;
        let rod = Part {
            shape: Shape::Capsule {
                radius: 0.01,
                length: 0.2,
            },
            position: [0.0, 0.0, 0.1],
            orientation: [2.0 * turn, 2.0 * turn, 0.0, 0.0],
        };
        let nested = Part {
            shape: Shape::Compound(vec![rod]),
            position: [0.0, 0.0, 0.4],
            orientation: [1.0, 0.0, 0.0, 0.0],
        };
        let ball = Part {
            shape: Shape::Sphere { radius: 0.03 },
            position: [0.5, 0.0, 0.0],
            orientation: [1.0, 0.0, 0.0, 0.0],
        };
        let tool = scene::Tool {
            name: "hook".into(),
            kind: scene::ToolKind::Grasper,
            shape: Shape::Compound(vec![ball, nested]),
            active_length: Some(0.05),
            friction: scene::Friction::Stick,
            slip_force: None,
            position: [0.0; 3],
            orientation: [1.0, 0.0, 0.0, 0.0],
        };
        let shape = ToolShape::new(&tool);
        let frame = Pose {
            position: Vec3::new(0.0, 1.0, 0.0),
            orientation: UnitQuaternion::identity(),
        };
        let whole: Vec<Capsule> = shape.at(&frame).collect();
        let near = |a: Vec3, b: [f64; 3]| (a - Vec3::from(b)).norm() < 1e-15;
        assert_eq!((whole.len(), shape.capsules()), (2, 2));
        assert!(near(whole[0].tip, [0.5, 1.0, 0.0]) && whole[0].tip == whole[0].end);
        assert!(near(whole[1].tip, [0.0, 1.0, 0.5]) && near(whole[1].end, [0.0, 1.2, 0.5]));
        let active: Vec<Capsule> = shape.active_at(&frame).collect();
        assert!(near(active[1].end, [0.0, 1.05, 0.5]) && active[0] == whole[0]);
        assert!((shape.least_radius() - 0.01).abs() < 1e-15);
        assert!((shape.grip() - 0.07).abs() < 1e-15);
    }
}
