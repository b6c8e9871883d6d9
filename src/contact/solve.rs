//! Forces of all that touches in a substep: Gauss and Seidel's passes, and Newton's steps on what they have found to leave, to stick
//! and to slip.
//!
//! A force changes velocities of its place and of those that share nodes with it, v_p = v_p' + sum_q W_pq lambda_q, W_pq diagonal.
//! With y what it yields, p_n = n . lambda, d the direction of lambda_t, t across it in the plane, s = v - v_t the slip,
//!
//! - what leaves has lambda = 0;
//! - what sticks has n . v + y p_n = -g/h and s_t + y lambda_t = 0;
//! - what slips has n . v + y p_n = -g/h, |lambda_t| = mu p_n, and s antiparallel to lambda_t, that is lambda_d s_t = lambda_t s_d.
//!
//! Passes alone turn the direction of friction by a little each: lambda_t - s/W is hardly another one where W is large.

use crate::mesh::Vec3;
use crate::model::tensor_mass::Lane;

/// Passes through the places of a substep at most.
const MOST_PASSES: usize = 100;
/// Unknowns in Newton's steps at most.
const UNKNOWN: usize = 24;
/// A step is kept that leaves the next pass no more to change than this share of what the last one did.
const GAIN: f64 = 0.5;
/// Passes end when no force changes by more than this share of the largest.
const SETTLED: f64 = 1e-11;
/// Share of the largest number of the equations that is added to their diagonal: more places may touch than there are ways to move.
const SOFT: f64 = 1e-6;
/// What presses on the cone by as much as this share of it slips.
const ON_CONE: f64 = 1e-9;

/// A contact in a substep.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    pub at: usize,
    pub nodes: [usize; 3],
    /// b_i, which sum to 1.
    pub weight: [f64; 3],
    pub place: Vec3,
    pub normal: Vec3,
    /// Of the place as it was at the start of the substep and the tool at its end \[m\].
    pub gap: f64,
    /// v_t \[m/s\], and in the substep before.
    pub tool: Vec3,
    pub before: Vec3,
    /// n . W n, and the largest of W \[m/(s N)\].
    pub along: f64,
    pub across: f64,
    /// How far it gives way to its force, where it is held \[m/(s N)\].
    pub yields: f64,
    pub friction: f64,
    pub force: Vec3,
    /// gain b_i / m_i of each node, and how many there are.
    pub push: [Lane; 3],
    pub count: usize,
    /// Before the last of Newton's steps.
    pub before_step: Vec3,
    /// Of the force, in the last pass, and the direction of the passes so far.
    pub change: Vec3,
    pub along_way: Vec3,
}

impl Touch {
    #[inline(always)]
    pub fn give(&self, force: &Vec3, velocity: &mut [Lane]) {
        for (i, push) in self.nodes[..self.count].iter().zip(&self.push) {
            let v = &mut velocity[*i].0;
            for axis in 0..3 {
                v[axis] += push.0[axis] * force[axis];
            }
        }
    }

    #[inline(always)]
    pub fn velocity(&self, velocity: &[Lane]) -> Vec3 {
        let mut sum = [0.0; 3];
        for (i, b) in self.nodes[..self.count].iter().zip(self.weight) {
            for axis in 0..3 {
                sum[axis] += b * velocity[*i].0[axis];
            }
        }
        Vec3::from(sum)
    }

    /// W_pq, the diagonal.
    fn response(&self, by: &Touch) -> Vec3 {
        let mut sum = Vec3::zeros();
        for (i, b) in self.nodes[..self.count].iter().zip(self.weight) {
            for (k, push) in by.nodes[..by.count].iter().zip(&by.push) {
                if i == k {
                    sum += push.xyz() * b;
                }
            }
        }
        sum
    }
}

/// The nearest to a force of those with a given part along the normal n.
pub(super) fn within_cone(n: &Vec3, friction: f64, force: Vec3, pressed: f64) -> Vec3 {
    let across = force - n * force.dot(n);
    let (size, most) = (across.norm(), friction * pressed);
    match size > most {
        true => n * pressed + across * (most / size),
        false => n * pressed + across,
    }
}

/// Forces of all that touches, and the velocities they lead to. Where there are no steps of Newton's, conjugate directions help as
/// long as the passes change ever less. (Silcowitz, Niebe, Erleben 2010.)
pub(super) fn solve(touches: &mut [Touch], h: f64, velocity: &mut [Lane]) {
    for touch in touches.iter_mut() {
        // Normals turn; the cone is kept.
        let pressed = touch.force.dot(&touch.normal).max(0.0);
        touch.force = within_cone(&touch.normal, touch.friction, touch.force, pressed);
        touch.give(&touch.force, velocity);
    }
    let (mut before, mut last) = (f64::INFINITY, f64::INFINITY);
    let (mut next, mut wait) = (0, 2);
    for pass in 0..MOST_PASSES {
        let (mut change, mut largest, mut square) = (0.0f64, 0.0f64, 0.0);
        for touch in touches.iter_mut() {
            let v = touch.velocity(velocity);
            let n = touch.normal;
            let gap = touch.gap / h + n.dot(&v);
            let yields = touch.yields;
            let pressed = (touch.force.dot(&n) * touch.along - gap) / (touch.along + yields);
            let pressed = pressed.max(0.0);
            let sticking =
                (touch.force * touch.across - (v - touch.tool)) / (touch.across + yields);
            let force = within_cone(&n, touch.friction, sticking, pressed);
            touch.change = force - touch.force;
            touch.force = force;
            touch.give(&touch.change, velocity);
            square += touch.change.norm_squared();
            change = change.max(touch.change.amax());
            largest = largest.max(force.amax());
        }
        if change <= SETTLED * largest {
            break;
        }
        if pass + 1 == MOST_PASSES {
            break;
        }
        if change > GAIN * last {
            // Worse than before the step: back to there.
            for touch in touches.iter_mut() {
                let back = touch.before_step - touch.force;
                touch.force = touch.before_step;
                touch.give(&back, velocity);
            }
            (before, last, wait) = (f64::INFINITY, f64::INFINITY, 2 * wait);
            next = pass + wait;
            continue;
        }
        last = f64::INFINITY;
        if pass >= next {
            touches.iter_mut().for_each(|t| t.before_step = t.force);
            if newton(touches, h, velocity) {
                (before, last) = (f64::INFINITY, change);
                continue;
            }
        }
        let share = square / before;
        before = square;
        for touch in touches.iter_mut() {
            if share > 1.0 {
                touch.along_way = Vec3::zeros();
                continue;
            }
            let more = touch.along_way * share;
            touch.along_way = more + touch.change;
            touch.force += more;
            touch.give(&more, velocity);
        }
    }
}

/// A force that is looked for, by its direction, and the equation for it: of the velocity along `row`.
#[derive(Clone, Copy)]
struct Unknown {
    touch: usize,
    direction: Vec3,
    row: Vec3,
    right: f64,
    /// Of this force and of the one before.
    own: f64,
    last: f64,
}

/// One of Newton's steps. False if there is none.
fn newton(touches: &mut [Touch], h: f64, velocity: &mut [Lane]) -> bool {
    let none = Unknown {
        touch: 0,
        direction: Vec3::zeros(),
        row: Vec3::zeros(),
        right: 0.0,
        own: 0.0,
        last: 0.0,
    };
    let (mut unknown, mut count) = ([none; UNKNOWN], 0);
    for (at, touch) in touches.iter().enumerate() {
        let (n, f) = (touch.normal, touch.force);
        let pressed = f.dot(&n);
        if pressed <= 0.0 {
            continue;
        }
        if count + 3 > UNKNOWN {
            return false;
        }
        let v = touch.velocity(velocity);
        let slip = v - touch.tool;
        let slip = slip - n * slip.dot(&n);
        let enters = touch.gap / h + n.dot(&v);
        let across = f - n * pressed;
        let rubbing = across.norm();
        let one = Unknown { touch: at, ..none };
        let most = touch.friction * pressed;
        if rubbing < (1.0 - ON_CONE) * most {
            let miss = slip + n * enters + f * touch.yields;
            for (axis, e) in [Vec3::x(), Vec3::y(), Vec3::z()].into_iter().enumerate() {
                unknown[count + axis] = Unknown {
                    direction: e,
                    row: e,
                    right: -miss[axis],
                    own: touch.yields,
                    ..one
                };
            }
            count += 3;
            continue;
        }
        let along = match most > 0.0 {
            true => across / rubbing,
            false => Vec3::zeros(),
        };
        unknown[count] = Unknown {
            direction: n + along * touch.friction,
            row: n,
            right: -enters - touch.yields * pressed,
            own: touch.yields,
            ..one
        };
        count += 1;
        if most > 0.0 {
            let aside = n.cross(&along);
            let drift = slip.dot(&aside);
            unknown[count] = Unknown {
                direction: aside,
                row: aside,
                right: -drift,
                own: (-slip.dot(&along)).max(0.0) / rubbing,
                last: drift * touch.friction / rubbing,
                ..one
            };
            count += 1;
        }
    }
    let unknown = &unknown[..count];
    let mut equations = [[0.0; UNKNOWN + 1]; UNKNOWN];
    let equations = &mut equations[..count];
    let of_one_touch = |a: &Unknown, b: &Unknown| a.touch == b.touch;
    let mut r = 0;
    for rows in unknown.chunk_by(of_one_touch) {
        let mut c = 0;
        for columns in unknown.chunk_by(of_one_touch) {
            let response = touches[rows[0].touch].response(&touches[columns[0].touch]);
            if response != Vec3::zeros() {
                for (equation, of) in equations[r..].iter_mut().zip(rows) {
                    let answer = of.row.component_mul(&response);
                    for (a, one) in equation[c..].iter_mut().zip(columns) {
                        *a = answer.dot(&one.direction);
                    }
                }
            }
            c += columns.len();
        }
        r += rows.len();
    }
    for (r, of) in unknown.iter().enumerate() {
        equations[r][r] += of.own;
        if of.last != 0.0 {
            equations[r][r - 1] += of.last;
        }
        equations[r][UNKNOWN] = of.right;
    }
    if !eliminate(equations) {
        return false;
    }
    for (one, equation) in unknown.iter().zip(equations) {
        let touch = &mut touches[one.touch];
        let more = one.direction * equation[UNKNOWN];
        touch.force += more;
        touch.give(&more, velocity);
    }
    true
}

/// Solves equations of which the last number is the right side; the solution takes its place. False if they are singular.
fn eliminate(equations: &mut [[f64; UNKNOWN + 1]]) -> bool {
    let count = equations.len();
    let each = equations.iter().flat_map(|e| &e[..count]);
    let soft = SOFT * each.fold(0.0f64, |most, a| most.max(a.abs()));
    for (k, equation) in equations.iter_mut().enumerate() {
        equation[k] += soft;
    }
    for k in 0..count {
        let by = |r: &usize, q: &usize| equations[*r][k].abs().total_cmp(&equations[*q][k].abs());
        let Some(best) = (k..count).max_by(by) else {
            return false;
        };
        equations.swap(k, best);
        let (above, below) = equations.split_at_mut(k + 1);
        let pivot = &above[k];
        if pivot[k].is_nan() || pivot[k] == 0.0 {
            return false;
        }
        for equation in below {
            let share = equation[k] / pivot[k];
            if share == 0.0 {
                continue;
            }
            for (a, b) in equation[k..count].iter_mut().zip(&pivot[k..count]) {
                *a -= share * b;
            }
            equation[UNKNOWN] -= share * pivot[UNKNOWN];
        }
    }
    for k in (0..count).rev() {
        let (above, below) = equations.split_at_mut(k + 1);
        let equation = &mut above[k];
        let others = equation[k + 1..count].iter().zip(below);
        let by_others: f64 = others.map(|(a, other)| a * other[UNKNOWN]).sum();
        equation[UNKNOWN] = (equation[UNKNOWN] - by_others) / equation[k];
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places on few nodes, some of which are held along an axis, driven together: forces are in their cones, what is pressed
    /// does not enter, and what lies within the cone does not slip.
    #[test]
    fn forces_are_in_their_cones() {
        let mut seed = 7u64;
        let mut random = move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 33) as f64 / f64::from(1u32 << 30) - 1.0
        };
        let (mut sticks, mut slides, mut leaves) = (0, 0, 0);
        for round in 0..100 {
            let count = 12;
            let inverse_mass: Vec<Lane> = (0..count)
                .map(|i| match i % 5 {
                    0 => Lane([0.0, 1e4, 1e4, 0.0]),
                    _ => Lane([8e3; 4]),
                })
                .collect();
            let velocity: Vec<Lane> = (0..count)
                .map(|_| Lane([random(), random(), random() + 0.5, 0.0]))
                .collect();
            let friction = [0.0, 0.3, 1.5][round % 3];
            let mut touches: Vec<Touch> = (0..6)
                .map(|k| {
                    let nodes = [2 * k, 2 * k + 1, (2 * k + 2) % count];
                    let weight = [0.2, 0.3, 0.5];
                    let tilt = Vec3::new(0.2 * random(), 0.2 * random(), -1.0);
                    let normal = tilt.normalize();
                    let gain = 1e-4;
                    let (mut w, mut push) = (Vec3::zeros(), [Lane::default(); 3]);
                    for (k, (i, b)) in nodes.iter().zip(weight).enumerate() {
                        for axis in 0..3 {
                            push[k].0[axis] = b * gain * inverse_mass[*i].0[axis];
                            w[axis] += b * push[k].0[axis];
                        }
                    }
                    Touch {
                        at: k,
                        nodes,
                        weight,
                        place: Vec3::zeros(),
                        normal,
                        gap: 1e-5 * random(),
                        tool: Vec3::new(0.3 * random(), 0.0, 0.0),
                        before: Vec3::zeros(),
                        along: normal.dot(&normal.component_mul(&w)),
                        across: w.max(),
                        yields: 0.0,
                        friction,
                        force: Vec3::zeros(),
                        push,
                        count: 3,
                        before_step: Vec3::zeros(),
                        change: Vec3::zeros(),
                        along_way: Vec3::zeros(),
                    }
                })
                .collect();
            let mut after = velocity;
            solve(&mut touches, 1e-4, &mut after);
            for touch in &touches {
                let n = touch.normal;
                let pressed = touch.force.dot(&n);
                let rubbed = (touch.force - n * pressed).norm();
                assert!(pressed >= 0.0 && rubbed <= friction * pressed * (1.0 + 1e-12) + 1e-12);
                let nodes = touch.nodes.iter().zip(touch.weight);
                let v: Vec3 = nodes.map(|(i, b)| after[*i].xyz() * b).sum();
                let gap = touch.gap / 1e-4 + n.dot(&v);
                assert!(gap > -1e-6, "{gap}");
                let slip = v - touch.tool;
                let slip = (slip - n * slip.dot(&n)).norm();
                if pressed == 0.0 {
                    leaves += 1;
                } else if rubbed < 0.99 * friction * pressed {
                    assert!(slip < 1e-6, "{slip}");
                    sticks += 1;
                } else {
                    slides += 1;
                }
            }
        }
        println!("{sticks} stick, {slides} slide, {leaves} leave");
        assert!(sticks > 20 && slides > 100 && leaves > 20);
    }
}
