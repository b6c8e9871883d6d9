//! Where a tool is inside a communication step.
//!
//! Without input derivatives the pose ramps from the last one to the new one, reached at the end. With
//! them, s from 0 to H: p(s) = u + u' s + (p_last - u)(1 - s/H). Orientation by slerp.

use nalgebra::{Quaternion, UnitQuaternion};

use crate::mesh::Vec3;

/// Tip position \[m\] and orientation of a tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    pub position: Vec3,
    pub orientation: UnitQuaternion<f64>,
}

impl Pose {
    /// World position of a point given in the tool's frame.
    pub fn point(&self, local: &Vec3) -> Vec3 {
        self.position + self.orientation * local
    }

    /// Tool-frame position of a point given in the world.
    pub fn local(&self, world: &Vec3) -> Vec3 {
        self.orientation
            .inverse_transform_vector(&(world - self.position))
    }

    /// After a share of the straight way to another pose.
    pub fn towards(&self, other: &Pose, share: f64) -> Pose {
        Pose {
            position: self.position.lerp(&other.position, share),
            orientation: slerp(&self.orientation, &other.orientation, share),
        }
    }
}

/// What the host has set: seven numbers, x y z and w x y z, and their rates where given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseInput {
    pub value: [f64; 7],
    /// \[1/s\]; used for one step, then forgotten.
    pub rate: [Option<f64>; 7],
}

impl PoseInput {
    /// Of the pose set, or none where the quaternion is zero.
    pub fn pose(&self) -> Option<Pose> {
        let [x, y, z, qw, qx, qy, qz] = self.value;
        let orientation = unit([qw, qx, qy, qz])?;
        Some(Pose {
            position: Vec3::new(x, y, z),
            orientation,
        })
    }
}

fn unit([w, x, y, z]: [f64; 4]) -> Option<UnitQuaternion<f64>> {
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-150)
}

/// A straight path in one coordinate that goes on over several communication steps, counted in
/// substeps from its origin, so that it has the same bits however the host splits time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    pub origin: f64,
    pub rate: f64,
    pub substep: f64,
    /// Substeps since the origin at the start of the communication step.
    pub ticks: u64,
}

#[derive(Clone, Copy, Debug)]
enum Coordinate {
    Line(Line),
    /// u + u' s + (last - u)(1 - s/H): a derivative is given, and u is not where the path was.
    Blend {
        last: f64,
        value: f64,
        rate: f64,
    },
    Ramp {
        last: f64,
        value: f64,
    },
}

/// The path of one tool over one communication step of `count` substeps of length h.
#[derive(Clone, Copy, Debug)]
pub struct Path {
    coordinate: [Coordinate; 3],
    first: UnitQuaternion<f64>,
    last: UnitQuaternion<f64>,
    count: u64,
    substep: f64,
}

/// Two numbers that a host means to be equal: apart by no more than the round-off of numbers of a
/// size that led to them.
fn same(a: f64, b: f64, size: f64) -> bool {
    (a - b).abs() <= 1e-12 * (a.abs() + b.abs() + size)
}

impl Path {
    /// `lines` are those of the step before; the new ones replace them when the step is accepted.
    /// None where the quaternion is zero.
    pub fn new(
        last: &Pose,
        input: &PoseInput,
        lines: &[Option<Line>; 3],
        count: u64,
        substep: f64,
    ) -> Option<Path> {
        let length = count as f64 * substep;
        let coordinate = std::array::from_fn(|axis| {
            let (last, value) = (last.position[axis], input.value[axis]);
            let Some(rate) = input.rate[axis] else {
                return Coordinate::Ramp { last, value };
            };
            let line = match lines[axis] {
                Some(line) if line.rate == rate && line.substep == substep => line,
                _ => Line {
                    origin: last,
                    rate,
                    substep,
                    ticks: 0,
                },
            };
            if same(last, value, line.origin.abs() + (rate * length).abs()) {
                Coordinate::Line(line)
            } else {
                Coordinate::Blend { last, value, rate }
            }
        });
        let mut end = [
            input.value[3],
            input.value[4],
            input.value[5],
            input.value[6],
        ];
        for (q, rate) in end.iter_mut().zip(&input.rate[3..]) {
            *q += rate.unwrap_or(0.0) * length;
        }
        unit([
            input.value[3],
            input.value[4],
            input.value[5],
            input.value[6],
        ])?;
        Some(Path {
            coordinate,
            first: last.orientation,
            last: unit(end)?,
            count,
            substep,
        })
    }

    /// After `k` of the substeps.
    pub fn at(&self, k: u64) -> Pose {
        let share = k as f64 / self.count as f64;
        let position = Vec3::from_fn(|axis, _| match self.coordinate[axis] {
            Coordinate::Line(line) => {
                line.origin + line.rate * ((line.ticks + k) as f64 * line.substep)
            }
            Coordinate::Blend { last, value, rate } => {
                let s = k as f64 * self.substep;
                value + rate * s + (last - value) * (1.0 - share)
            }
            Coordinate::Ramp { value, .. } if k == self.count => value,
            Coordinate::Ramp { last, value } => last + (value - last) * share,
        });
        Pose {
            position,
            orientation: slerp(&self.first, &self.last, share),
        }
    }

    /// Whether the tool is there, to the bit, all the way.
    pub fn stays_at(&self, pose: &Pose) -> bool {
        let stays = |axis: usize| match self.coordinate[axis] {
            Coordinate::Line(line) => line.rate == 0.0 && line.origin == pose.position[axis],
            Coordinate::Blend { .. } => false,
            Coordinate::Ramp { last, value } => last == value && value == pose.position[axis],
        };
        let end = slerp(&self.first, &self.last, 1.0);
        (0..3).all(stays)
            && self.first.coords == end.coords
            && end.coords == pose.orientation.coords
    }

    /// What the next step may continue.
    pub fn lines(&self) -> [Option<Line>; 3] {
        self.coordinate.map(|c| match c {
            Coordinate::Line(line) => Some(Line {
                ticks: line.ticks + self.count,
                ..line
            }),
            _ => None,
        })
    }
}

/// Shortest way; exact at both ends and where they agree.
fn slerp(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>, t: f64) -> UnitQuaternion<f64> {
    let b = if a.coords.dot(&b.coords) < 0.0 {
        UnitQuaternion::new_unchecked(-b.into_inner())
    } else {
        *b
    };
    if *a == b || t == 0.0 {
        return *a;
    }
    if t == 1.0 {
        return b;
    }
    a.try_slerp(&b, t, 1e-12).unwrap_or_else(|| a.nlerp(&b, t))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rest() -> Pose {
        Pose {
            position: Vec3::new(0.1, 0.2, 0.3),
            orientation: UnitQuaternion::identity(),
        }
    }

    fn input(value: [f64; 3], rate: [Option<f64>; 3]) -> PoseInput {
        PoseInput {
            value: [value[0], value[1], value[2], 1.0, 0.0, 0.0, 0.0],
            rate: [rate[0], rate[1], rate[2], None, None, None, None],
        }
    }

    #[test]
    fn ramp_ends_at_the_new_value() {
        let path = Path::new(
            &rest(),
            &input([0.4, 0.2, 0.3], [None; 3]),
            &[None; 3],
            4,
            0.25,
        )
        .unwrap();
        assert_eq!(path.at(4).position, Vec3::new(0.4, 0.2, 0.3));
        assert!((path.at(1).position.x - 0.175).abs() < 1e-16);
        assert_eq!(path.at(3).position.y, 0.2);
    }

    #[test]
    fn a_straight_path_has_the_same_bits_however_it_is_split() {
        let (rate, h) = (0.0371, 1e-3 / 3.0);
        let whole = Path::new(
            &rest(),
            &input([0.1, 0.2, 0.3], [Some(rate), None, None]),
            &[None; 3],
            30,
            h,
        )
        .unwrap();
        let (mut pose, mut lines) = (rest(), [None; 3]);
        for step in 0..10u64 {
            let x = 0.1 + rate * (step as f64 * 1e-3);
            let path = Path::new(
                &pose,
                &input([x, 0.2, 0.3], [Some(rate), None, None]),
                &lines,
                3,
                h,
            )
            .unwrap();
            for k in 1..=3 {
                assert_eq!(path.at(k), whole.at(3 * step + k));
            }
            (pose, lines) = (path.at(3), path.lines());
        }
    }

    #[test]
    fn derivative_path_is_continuous_and_ends_ahead() {
        let path = Path::new(
            &rest(),
            &input([0.2, 0.2, 0.3], [Some(0.5), None, None]),
            &[None; 3],
            10,
            0.01,
        )
        .unwrap();
        assert_eq!(path.at(0).position.x, 0.1);
        assert!((path.at(10).position.x - 0.25).abs() < 1e-15);
    }

    #[test]
    fn a_zero_quaternion_is_refused() {
        let mut bad = input([0.0; 3], [None; 3]);
        bad.value[3] = 0.0;
        assert!(bad.pose().is_none());
        assert!(Path::new(&rest(), &bad, &[None; 3], 1, 1.0).is_none());
    }
}
