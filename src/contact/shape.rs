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

    /// How many.
    pub fn capsules(&self) -> usize {
        self.whole.len()
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
