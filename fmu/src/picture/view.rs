//! One camera for several panels: orientation from the caller, place and scale from the framing.

use nalgebra::Vector3;

/// Tangent of half the vertical angle of view.
const HALF_HEIGHT: f64 = 0.22;
/// Free border, as a share of half the picture.
const MARGIN: f64 = 0.07;

/// A perspective camera that sees given points, in a frame of its own.
///
/// Camera frame: origin at the centre of the framed points, x right, y up, z towards the eye,
/// the unit of length half the diagonal of their bounding box. The eye stands at `eye`.
#[derive(Clone, Debug)]
pub struct View {
    center: Vector3<f64>,
    radius: f64,
    axes: [Vector3<f64>; 3],
    pub(super) eye: Vector3<f32>,
    /// Tangents of half the horizontal and vertical angle of view.
    pub(super) half: [f32; 2],
    /// World up in the camera frame.
    pub(super) up: Vector3<f32>,
    /// Height of the ground plane along `up`: just below the lowest framed point.
    pub(super) ground: f32,
}

impl View {
    /// The closest camera that sees all finite `points` when looking against `eye_direction`
    /// (from the organ towards the eye), in a picture `aspect` times as wide as high.
    ///
    /// Frame the surfaces of all panels and the tips of their tools; shafts may leave the picture.
    pub fn framing<'a>(
        eye_direction: [f64; 3],
        up: [f64; 3],
        aspect: f64,
        points: impl IntoIterator<Item = &'a [f64; 3]>,
    ) -> Self {
        let points: Vec<Vector3<f64>> = points
            .into_iter()
            .filter(|p| p.iter().all(|x| x.is_finite()))
            .map(|&p| p.into())
            .collect();
        let unit =
            |v: [f64; 3], otherwise| Vector3::from(v).try_normalize(1e-12).unwrap_or(otherwise);
        let up = unit(up, Vector3::z());
        let back = unit(eye_direction, -Vector3::y());
        let right = up
            .cross(&back)
            .try_normalize(1e-9)
            .or_else(|| Vector3::x().cross(&back).try_normalize(1e-9))
            .unwrap_or(Vector3::y());
        let axes = [right, back.cross(&right), back];

        let first = points.first().copied().unwrap_or_default();
        let low = points.iter().fold(first, |a, b| a.inf(b));
        let high = points.iter().fold(first, |a, b| a.sup(b));
        let center = (low + high) / 2.0;
        let radius = Some((high - low).norm() / 2.0)
            .filter(|r| r.is_normal())
            .unwrap_or(1.0);

        let aspect = if aspect.is_normal() {
            aspect.abs()
        } else {
            1.0
        };
        let half = [HALF_HEIGHT * aspect, HALF_HEIGHT];
        let mut view = Self {
            center,
            radius,
            axes,
            eye: Vector3::zeros(),
            half: half.map(|h| h as f32),
            up: Vector3::from(axes.map(|a| a.dot(&up) as f32)),
            ground: 0.0,
        };
        let local: Vec<Vector3<f64>> = points.iter().map(|p| view.local(p)).collect();
        // A point (x, z) is inside |x - e| <= t (d - z) for all points: the smallest distance d
        // and the eye's offset e follow from the two extreme slanted supports.
        let mut eye = Vector3::zeros();
        for i in 0..2 {
            let slope = half[i] * (1.0 - MARGIN);
            let support = |sign: f64| {
                local
                    .iter()
                    .map(|p| sign * p[i] + slope * p.z)
                    .fold(f64::NEG_INFINITY, f64::max)
            };
            let (a, b) = if local.is_empty() {
                (1.0, 1.0)
            } else {
                (support(1.0), support(-1.0))
            };
            eye[i] = (a - b) / 2.0;
            eye.z = f64::max(eye.z, (a + b) / (2.0 * slope));
        }
        eye.z = eye.z.max(1.5);
        view.eye = eye.cast();
        let lowest = points
            .iter()
            .map(|p| (p - center).dot(&up) / radius)
            .fold(0.0, f64::min);
        view.ground = lowest as f32 - 0.015;
        view
    }

    /// Width over height.
    pub fn aspect(&self) -> f64 {
        f64::from(self.half[0] / self.half[1])
    }

    /// Metres of a unit length of the camera frame.
    pub(super) fn radius(&self) -> f64 {
        self.radius
    }

    /// World direction from the organ towards the eye.
    pub(super) fn back(&self) -> Vector3<f64> {
        self.axes[2]
    }

    /// A world position in the camera frame.
    pub(super) fn place(&self, position: &[f64; 3]) -> Vector3<f32> {
        self.local(&Vector3::from(*position)).cast()
    }

    fn local(&self, position: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from(
            self.axes
                .map(|a| a.dot(&(position - self.center)) / self.radius),
        )
    }

    /// Picture coordinates, -1 to 1 right and up, and the inverse distance along the view axis.
    pub(super) fn project(&self, p: &Vector3<f32>) -> [f32; 3] {
        let inverse = 1.0 / (self.eye.z - p.z);
        [
            (p.x - self.eye.x) * inverse / self.half[0],
            (p.y - self.eye.y) * inverse / self.half[1],
            inverse,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn framed_points_are_inside_and_touch_the_border() {
        let points = [
            [0.0, 0.0, 0.0],
            [0.2, 0.1, 0.05],
            [-0.1, 0.3, 0.0],
            [0.0, 0.0, 0.1],
        ];
        let view = View::framing([0.3, -1.0, 0.5], [0.0, 0.0, 1.0], 1.3, &points);
        let reach = points
            .iter()
            .flat_map(|p| view.project(&view.place(p)).into_iter().take(2))
            .fold(0.0_f32, |a, b| a.max(b.abs()));
        assert!((reach - 0.93).abs() < 1e-4, "reach {reach}");
    }

    #[test]
    fn degenerate_framings_are_finite() {
        let up = [0.0, 0.0, 1.0];
        let nan = [[f64::NAN, 0.0, 0.0]];
        let one = [[1.0, 2.0, 3.0]];
        for view in [
            View::framing([0.0; 3], [0.0; 3], 0.0, &[]),
            View::framing(up, up, f64::NAN, &nan),
            View::framing([1.0, 0.0, 0.0], up, 1.5, &one),
        ] {
            assert!(view.eye.iter().chain(view.up.iter()).all(|x| x.is_finite()));
            assert!(view.ground.is_finite() && view.aspect() > 0.0);
            assert!(
                view.project(&view.place(&[0.0; 3]))
                    .iter()
                    .all(|x| x.is_finite())
            );
        }
    }
}
