//! The bodies, where each is gripped, and how far it is moved.

use tissue::scene::{BoxPattern, MeshSource, Region};

/// A shipped scene, its mesh at any size, and the patch of its surface that a grasper moves.
pub struct SceneRow {
    pub name: &'static str,
    pub sentence: &'static str,
    /// The scene file: material and supports are its.
    pub text: &'static str,
    /// With cells or edges of so many metres.
    pub mesh: fn(f64) -> MeshSource,
    /// Sizes that are charted \[m\], coarsest first. All share the edges of the patch.
    pub sizes: [f64; 3],
    /// Size of the reference \[m\].
    pub reference: f64,
    /// Surface nodes that the grasper holds.
    pub patch: fn() -> Region,
    /// Where it moves them in the strong gesture \[m\].
    pub reach: [f64; 3],
    /// Mass-proportional, about twice the lowest angular frequency of the body with the patch held: settles fastest \[1/s\].
    pub damping: f64,
    /// Time that it rests after the motion, so that less than a thousandth of the motion is left \[steps of 1 ms\].
    pub hold: usize,
}

/// How far of a scene's reach.
pub struct GestureRow {
    pub name: &'static str,
    pub share: f64,
}

/// Length of the motion \[steps of 1 ms\].
pub const MOTION: usize = 300;

pub const GESTURES: [GestureRow; 3] = [
    GestureRow {
        name: "light",
        share: 1.0 / 6.0,
    },
    GestureRow {
        name: "moderate",
        share: 0.5,
    },
    GestureRow {
        name: "strong",
        share: 1.0,
    },
];

/// Share of the way after `step` steps: rest to rest with the least jerk (Flash and Hogan 1985).
pub fn way(step: usize) -> f64 {
    let s = (step as f64 / MOTION as f64).min(1.0);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

pub const SCENES: [SceneRow; 5] = [
    SceneRow {
        name: "plate",
        sentence: "pressed_plate: 220 x 100 x 20 mm, held at two ends, a patch of 40 x 40 mm pressed in by up to 12 mm",
        text: include_str!("../../../examples/pressed_plate.json"),
        mesh: |size| cells([0.22, 0.1, 0.02], size, BoxPattern::Five),
        sizes: [0.01, 0.005, 0.01 / 3.0],
        reference: 0.0025,
        patch: || within([0.09, 0.03, 0.02], [0.13, 0.07, 0.02]),
        reach: [0.0, 0.0, -0.012],
        damping: 40.0,
        hold: 350,
    },
    SceneRow {
        name: "block",
        sentence: "squeezed_block: 40 x 40 x 30 mm, stuck between two plates, the upper one moved down by up to 9 mm and aside by up to 6 mm",
        text: include_str!("../../../examples/squeezed_block.json"),
        mesh: |size| cells([0.04, 0.04, 0.03], size, BoxPattern::Five),
        sizes: [0.01, 0.005, 0.0025],
        reference: 0.00125,
        patch: || within([0.0, 0.0, 0.03], [0.04, 0.04, 0.03]),
        reach: [0.006, 0.0, -0.009],
        damping: 250.0,
        hold: 150,
    },
    SceneRow {
        name: "cantilever",
        sentence: "cantilever: 100 x 20 x 20 mm of two stiffnesses, held at one end, the other one moved aside by up to 30 mm without turning",
        text: include_str!("../../../examples/cantilever.json"),
        mesh: |size| cells([0.1, 0.02, 0.02], size, BoxPattern::Kuhn),
        sizes: [0.01, 0.005, 0.0025],
        reference: 0.01 / 6.0,
        patch: || within([0.1, 0.0, 0.0], [0.1, 0.02, 0.02]),
        reach: [-0.004, 0.0, -0.03],
        damping: 330.0,
        hold: 150,
    },
    SceneRow {
        name: "cylinder",
        sentence: "pulled_cylinder: 38 x 100 mm, clamped at its base, its top pulled aside by up to 30 mm and up by up to 10 mm without turning",
        text: include_str!("../../../examples/pulled_cylinder.json"),
        mesh: |edge_length| MeshSource::Cylinder {
            radius: 0.019,
            height: 0.1,
            edge_length,
        },
        sizes: [0.01, 0.006, 0.004],
        reference: 0.003,
        patch: || within([-1.0, -1.0, 0.1], [1.0, 1.0, 0.1]),
        reach: [0.03, 0.0, 0.01],
        damping: 200.0,
        hold: 200,
    },
    SceneRow {
        name: "liver",
        sentence: "pulled_lobe: a liver held at the middle of its back, the end of its right lobe pulled up and forward by up to 40 mm",
        text: include_str!("../../../examples/pulled_lobe.json"),
        mesh: |edge_length| MeshSource::Liver { edge_length },
        sizes: [0.02, 0.015, 0.01],
        reference: 0.006,
        patch: || within([-1.0, -1.0, -1.0], [-0.1, 1.0, 1.0]),
        reach: [0.0, -0.018, 0.036],
        damping: 28.0,
        hold: 500,
    },
];

fn cells(size: [f64; 3], cell: f64, pattern: BoxPattern) -> MeshSource {
    MeshSource::Box {
        size,
        cells: size.map(|length| (length / cell).round() as usize),
        origin: [0.0; 3],
        pattern,
    }
}

fn within(min: [f64; 3], max: [f64; 3]) -> Region {
    Region::Box { min, max }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_goes_from_rest_to_rest() {
        assert_eq!((way(0), way(MOTION), way(2 * MOTION)), (0.0, 1.0, 1.0));
        assert!((way(MOTION / 2) - 0.5).abs() < 1e-15);
        assert!(way(1) < 1e-6 && 1.0 - way(MOTION - 1) < 1e-6);
        assert!((1..MOTION).all(|k| way(k) < way(k + 1)));
    }
}
