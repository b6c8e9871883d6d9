//! What nothing beats: no other point costs as little or less and errs as little or less.

/// Numbers of the points \[cost, error\] on the Pareto front, by cost. Points that are not finite are on none; of equal
/// ones the first is.
pub fn front(points: &[[f64; 2]]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len())
        .filter(|k| points[*k].iter().all(|x| x.is_finite()))
        .collect();
    order.sort_by(|a, b| {
        let (p, q) = (points[*a], points[*b]);
        p[0].total_cmp(&q[0]).then(p[1].total_cmp(&q[1]))
    });
    let mut least = f64::INFINITY;
    order.retain(|k| {
        let better = points[*k][1] < least;
        least = least.min(points[*k][1]);
        better
    });
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_is_what_nothing_beats() {
        // A fixed sequence that looks random.
        let number = |k: u64| (k.wrapping_mul(6_364_136_223_846_793_005) >> 40) as f64 % 97.0;
        let mut points: Vec<[f64; 2]> = (1..200).map(|k| [number(k), number(7919 * k)]).collect();
        points.push([f64::NAN, 0.0]);
        points.push([0.0, f64::INFINITY]);
        let found = front(&points);
        let beaten = |p: &[f64; 2]| {
            let better = |q: &[f64; 2]| q[0] <= p[0] && q[1] <= p[1] && q != p;
            points
                .iter()
                .any(|q| q.iter().all(|x| x.is_finite()) && better(q))
        };
        for (k, p) in points.iter().enumerate() {
            let earlier = points[..k].contains(p);
            let on_it = p.iter().all(|x| x.is_finite()) && !beaten(p) && !earlier;
            assert_eq!(found.contains(&k), on_it, "{k} {p:?}");
        }
        assert!(found.windows(2).all(|w| points[w[0]][0] < points[w[1]][0]));
    }
}
