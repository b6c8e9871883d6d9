//! Node order for cache and bandwidth: reverse Cuthill-McKee.

/// `order[new] = old`. Components one after the other, each from a pseudo-peripheral node; ties by
/// old number, so that the result is the same everywhere.
pub fn reverse_cuthill_mckee(neighbours: &[Vec<u32>]) -> Vec<u32> {
    let n = neighbours.len();
    let mut order = Vec::with_capacity(n);
    let mut placed = vec![false; n];
    for seed in 0..n {
        if placed[seed] {
            continue;
        }
        let start = peripheral(neighbours, seed);
        let first = order.len();
        placed[start] = true;
        order.push(start as u32);
        let mut at = first;
        while at < order.len() {
            let node = order[at] as usize;
            at += 1;
            let from = order.len();
            for &other in &neighbours[node] {
                if !placed[other as usize] {
                    placed[other as usize] = true;
                    order.push(other);
                }
            }
            order[from..].sort_unstable_by_key(|&k| (neighbours[k as usize].len(), k));
        }
    }
    order.reverse();
    order
}

/// A node of the last level of a breadth-first search, repeated while the depth grows.
fn peripheral(neighbours: &[Vec<u32>], seed: usize) -> usize {
    let (mut node, mut depth) = (seed, 0);
    let mut level = std::collections::HashMap::new();
    for _ in 0..8 {
        level.clear();
        level.insert(node as u32, 0usize);
        let mut queue = vec![node as u32];
        let mut at = 0;
        while at < queue.len() {
            let here = queue[at];
            let next = level[&here] + 1;
            at += 1;
            for &other in &neighbours[here as usize] {
                if let std::collections::hash_map::Entry::Vacant(e) = level.entry(other) {
                    e.insert(next);
                    queue.push(other);
                }
            }
        }
        let deepest = level[&queue[queue.len() - 1]];
        if deepest <= depth {
            break;
        }
        depth = deepest;
        node = queue
            .iter()
            .filter(|k| level[*k] == deepest)
            .min_by_key(|k| (neighbours[**k as usize].len(), **k))
            .map_or(node, |k| *k as usize);
    }
    node
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shuffled_chain_gets_bandwidth_one() {
        // 0-3-1-4-2
        let chain = [0u32, 3, 1, 4, 2];
        let mut neighbours = vec![Vec::new(); 5];
        for pair in chain.windows(2) {
            neighbours[pair[0] as usize].push(pair[1]);
            neighbours[pair[1] as usize].push(pair[0]);
        }
        let order = reverse_cuthill_mckee(&neighbours);
        let mut place = [0usize; 5];
        for (new, old) in order.iter().enumerate() {
            place[*old as usize] = new;
        }
        for pair in chain.windows(2) {
            assert_eq!(place[pair[0] as usize].abs_diff(place[pair[1] as usize]), 1);
        }
    }
}
