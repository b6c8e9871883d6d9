//! Moves nodes, never the connections, so that tetrahedra become rounder and the surface even.
//!
//! A node's quality is the least sine of a dihedral angle at its tetrahedra. It first goes to the
//! middle of its neighbours where that leaves it good, then climbs by trial (after Freitag and
//! Ollivier-Gooch 1997). Surface nodes stay on the surface.

use super::quality::{EDGES, FACES};
use super::{TetMesh, Vec3, check};

/// Sweeps towards the middle of the neighbours, then sweeps of trial steps.
const AVERAGING_SWEEPS: usize = 4;
const CLIMBING_SWEEPS: usize = 6;

/// Averaging may lower a node's quality to this, the sine of 35 degrees, and climbing ends there.
const GOOD: f64 = 0.57;

/// Trial steps, in mean distances to the neighbours.
const STEPS: [f64; 3] = [0.2, 0.1, 0.05];

/// Newton steps from a trial point to the surface.
const PROJECTIONS: usize = 3;

/// Smooths a mesh of positive tetrahedra whose surface is where `shape`, about the distance to it,
/// is 0. No node's quality falls, unless it stays above 0.57.
pub fn smooth(mesh: &mut TetMesh, shape: impl Fn(Vec3) -> f64) {
    let Ok(surface) = check::surface(&mesh.tetrahedra) else {
        return;
    };
    let nodes = &mut mesh.nodes;
    let along_surface = neighbours(nodes.len(), &surface);
    let all = neighbours(nodes.len(), &mesh.tetrahedra);
    let mut stars = vec![Vec::new(); nodes.len()];
    for tetrahedron in &mesh.tetrahedra {
        for &node in tetrahedron {
            stars[node as usize].push(*tetrahedron);
        }
    }

    for sweep in 0..AVERAGING_SWEEPS + CLIMBING_SWEEPS {
        for node in 0..nodes.len() {
            let outer = !along_surface[node].is_empty();
            let round = if outer {
                &along_surface[node]
            } else {
                &all[node]
            };
            let star = &stars[node];
            let start = nodes[node];
            let mut quality = star_quality(nodes, star);
            let place = |to: Vec3| if outer { project(to, &shape) } else { to };
            let mean = |of: &dyn Fn(Vec3) -> Vec3| {
                let sum: Vec3 = round.iter().map(|&other| of(nodes[other as usize])).sum();
                sum / round.len() as f64
            };
            if sweep < AVERAGING_SWEEPS {
                let middle = mean(&|other| other);
                for share in [1.0, 0.5, 0.25] {
                    nodes[node] = place(start.lerp(&middle, share));
                    if star_quality(nodes, star) >= quality.min(GOOD) {
                        break;
                    }
                    nodes[node] = start;
                }
                continue;
            }
            let distance = mean(&|other| Vec3::repeat((other - start).norm())).x;
            for step in STEPS {
                for direction in DIRECTIONS {
                    if quality > GOOD {
                        break;
                    }
                    let from = nodes[node];
                    nodes[node] =
                        place(from + Vec3::from(direction).normalize() * (step * distance));
                    let trial = star_quality(nodes, star);
                    if trial > quality {
                        quality = trial;
                    } else {
                        nodes[node] = from;
                    }
                }
            }
        }
    }
}

/// To the faces and to the corners of a cube.
const DIRECTIONS: [[f64; 3]; 14] = [
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, -1.0],
    [1.0, 1.0, 1.0],
    [-1.0, -1.0, -1.0],
    [-1.0, 1.0, 1.0],
    [1.0, -1.0, -1.0],
    [1.0, -1.0, 1.0],
    [-1.0, 1.0, -1.0],
    [1.0, 1.0, -1.0],
    [-1.0, -1.0, 1.0],
];

/// The nodes each node shares an element with, ascending.
fn neighbours<const N: usize>(count: usize, elements: &[[u32; N]]) -> Vec<Vec<u32>> {
    let mut neighbours = vec![Vec::new(); count];
    for element in elements {
        for &node in element {
            neighbours[node as usize].extend(element.iter().filter(|&&other| other != node));
        }
    }
    for list in &mut neighbours {
        list.sort_unstable();
        list.dedup();
    }
    neighbours
}

/// Least sine of a dihedral angle, negative where a tetrahedron is inverted.
fn star_quality(nodes: &[Vec3], star: &[[u32; 4]]) -> f64 {
    let mut least = f64::INFINITY;
    for tetrahedron in star {
        let p = tetrahedron.map(|node| nodes[node as usize]);
        let squares = FACES.map(|[i, j, k]| (p[j] - p[i]).cross(&(p[k] - p[i])).norm_squared());
        let six_volumes = (p[1] - p[0]).cross(&(p[2] - p[0])).dot(&(p[3] - p[0]));
        // sin = 6 V l / (2A 2B) at an edge l between faces A and B, opposite the other two corners.
        let mut smallest = f64::INFINITY;
        for ([i, j], [k, l]) in EDGES.into_iter().zip(EDGES.into_iter().rev()) {
            smallest = smallest.min((p[i] - p[j]).norm_squared() / (squares[k] * squares[l]));
        }
        least = least.min(six_volumes * smallest.sqrt());
    }
    least
}

/// A point near the surface, moved onto it down the gradient.
fn project(mut point: Vec3, shape: &impl Fn(Vec3) -> f64) -> Vec3 {
    const DIFFERENCE: f64 = 1e-6;
    for _ in 0..PROJECTIONS {
        let gradient = Vec3::from([0, 1, 2].map(|axis| {
            let mut ahead = Vec3::zeros();
            ahead[axis] = DIFFERENCE;
            (shape(point + ahead) - shape(point - ahead)) / (2.0 * DIFFERENCE)
        }));
        point -= gradient * (shape(point) / gradient.norm_squared().max(0.1));
    }
    point
}

#[cfg(test)]
mod tests {
    use super::super::{quality, stuffing};
    use super::*;

    fn ball(p: Vec3) -> f64 {
        1.0 - p.norm()
    }

    #[test]
    fn quality_is_the_least_dihedral_sine() {
        let nodes = [
            [0.0, 0.0, 0.0],
            [1.0, 0.1, 0.0],
            [0.2, 1.3, 0.1],
            [0.4, 0.3, 0.9],
        ]
        .map(Vec3::from);
        let least = quality::dihedral_angles(nodes)
            .map(f64::sin)
            .into_iter()
            .fold(1.0, f64::min);
        assert!((star_quality(&nodes, &[[0, 1, 2, 3]]) - least).abs() < 1e-14);
        assert!(star_quality(&nodes, &[[0, 1, 3, 2]]) < 0.0);
    }

    #[test]
    fn raises_the_least_angle_and_keeps_the_surface() {
        let mut mesh = stuffing::fill(ball, [Vec3::repeat(-1.0), Vec3::repeat(1.0)], 0.37);
        let before = star_quality(&mesh.nodes, &mesh.tetrahedra);
        let surface = check::surface(&mesh.tetrahedra).unwrap();
        smooth(&mut mesh, ball);
        assert!(star_quality(&mesh.nodes, &mesh.tetrahedra) > before);
        assert_eq!(check::surface(&mesh.tetrahedra).unwrap(), surface);
        for node in surface.iter().flatten() {
            assert!(ball(mesh.nodes[*node as usize]).abs() < 1e-9);
        }
    }
}
