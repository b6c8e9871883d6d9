//! How far one run is from another.

use tissue::mesh::Vec3;

use super::track::Track;
use crate::chart::compare::Points;

/// Both relative \[1\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Off {
    /// Over the whole motion, all tools: root of the mean square of the difference of the vectors over the largest true one.
    pub force: f64,
    /// Largest L2 over the surface at any look, over the largest true displacement.
    pub surface: f64,
}

impl Off {
    /// What the tolerance is for.
    pub fn most(&self) -> f64 {
        self.force.max(self.surface)
    }

    pub fn worst(self, other: Off) -> Off {
        Off {
            force: self.force.max(other.force),
            surface: self.surface.max(other.surface),
        }
    }
}

/// Of a run from the true one, on the same points and with steps of the same length. What is gone in either is compared
/// with nothing.
pub fn off(points: &Points, run: &Track, truth: &Track) -> Off {
    let tools = truth.tools.max(1);
    let squares = |of: &mut dyn Iterator<Item = Vec3>| -> Vec<f64> {
        let each: Vec<f64> = of.map(|f| f.norm_squared()).collect();
        each.chunks(tools).map(|step| step.iter().sum()).collect()
    };
    let wrong = squares(&mut run.force.iter().zip(&truth.force).map(|(a, b)| a - b));
    let most = squares(&mut truth.force.iter().copied());
    let most = most.iter().copied().fold(0.0, f64::max).sqrt();
    let mean = wrong.iter().sum::<f64>() / wrong.len().max(1) as f64;
    let far = (truth.shape.iter().flatten().flatten()).map(Vec3::norm);
    let far = far.fold(0.0, f64::max);
    let looks = run.shape.iter().zip(&truth.shape);
    let worst = looks.map(|(a, b)| points.distance_of_known(a, b));
    Off {
        force: relative(mean.sqrt(), most),
        surface: relative(worst.fold(0.0, f64::max), far),
    }
}

/// Of nothing, nothing is off.
fn relative(wrong: f64, most: f64) -> f64 {
    if wrong == 0.0 { 0.0 } else { wrong / most }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tissue::mesh::box_mesh;

    fn track(force: &[[f64; 3]], tools: usize, shape: Vec<Vec<Option<Vec3>>>) -> Track {
        Track {
            force: force.iter().map(|f| Vec3::from(*f)).collect(),
            tools,
            shape,
            steps: Vec::new(),
            substeps: 1.0,
            work: None,
            gone: Vec::new(),
            touched: Vec::new(),
            met: Vec::new(),
            held: 0.0,
        }
    }

    /// Two steps of two tools: 3 N and 4 N make 5 N at most; one of four vectors is off by 1 N. A surface moved by 2 mm at most
    /// is off by 1 mm all over; what is gone in one run is not compared.
    #[test]
    fn errors_are_relative_to_the_largest() {
        let mesh = box_mesh::five([1.0; 3], [1; 3], [0.0; 3]);
        let surface = tissue::mesh::check::surface(&mesh.tetrahedra).unwrap();
        let points = Points::new(&mesh, &surface);
        let all = |u: f64| vec![Some(Vec3::new(0.0, 0.0, u)); surface.len()];
        let mut shifted = all(0.003);
        shifted[0] = None;
        let truth = track(
            &[[0.0; 3], [0.0; 3], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]],
            2,
            vec![all(0.001), all(0.002)],
        );
        let run = track(
            &[[0.0; 3], [0.0; 3], [3.0, 0.0, 1.0], [0.0, 4.0, 0.0]],
            2,
            vec![all(0.001), shifted],
        );
        let found = off(&points, &run, &truth);
        assert!((found.force - 0.5f64.sqrt() / 5.0).abs() < 1e-12);
        assert!((found.surface - 0.5).abs() < 1e-12 && found.most() == found.surface);
        assert_eq!(off(&points, &truth, &truth), Off::default());
    }
}
