//! What a setting asks of a mesh: how long its edges are, and which of its tetrahedra come first.

use tissue::mesh::{TetMesh, Vec3};

pub struct Site {
    /// Mean length of the tetrahedra's edges \[m\].
    pub edge: f64,
    /// All tetrahedra, from the nearest to what tools touch.
    order: Vec<u32>,
    /// So many from the front must be dynamic: what is cut.
    must: usize,
}

impl Site {
    /// Ordered by the distance \[m\] of centroids, what is 0 m away comes first by number; all of `cut` come before them.
    pub fn new(mesh: &TetMesh, distance: impl Fn(&Vec3) -> f64, cut: &[bool]) -> Site {
        let edges = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
        let lengths = (mesh.tetrahedra.iter()).flat_map(|t| {
            edges.map(|(a, b)| (mesh.nodes[t[a] as usize] - mesh.nodes[t[b] as usize]).norm())
        });
        let edge = lengths.sum::<f64>() / (6 * mesh.tetrahedra.len()) as f64;
        let far = |t: &[u32; 4]| {
            let middle = t.map(|v| mesh.nodes[v as usize]).iter().sum::<Vec3>() / 4.0;
            distance(&middle)
        };
        let is_cut = |t: usize| cut.get(t).copied().unwrap_or(false);
        let mut order: Vec<(bool, f64, u32)> = (mesh.tetrahedra.iter().enumerate())
            .map(|(k, t)| (!is_cut(k), far(t), k as u32))
            .collect();
        order.sort_by(|a, b| {
            (a.0.cmp(&b.0))
                .then(a.1.total_cmp(&b.1))
                .then(a.2.cmp(&b.2))
        });
        Site {
            edge,
            order: order.into_iter().map(|(.., t)| t).collect(),
            must: cut.iter().filter(|c| **c).count(),
        }
    }

    /// Such a share of the tetrahedra, those that come first, ascending; never less than what is cut.
    pub fn nearest(&self, share: f64) -> Vec<u32> {
        let count = (share * self.order.len() as f64).round() as usize;
        let mut chosen = self.order[..count.max(self.must)].to_vec();
        chosen.sort_unstable();
        chosen
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tissue::mesh::box_mesh;

    /// The nearest quarter of a bar is its end; what is cut elsewhere belongs to any share.
    #[test]
    fn what_is_cut_comes_first() {
        let mesh = box_mesh::kuhn([0.08, 0.01, 0.01], [8, 1, 1], [0.0; 3]);
        let plain = Site::new(&mesh, |p| p.x, &[]);
        assert_eq!(plain.nearest(0.25), (0..12).collect::<Vec<u32>>());
        assert_eq!(plain.nearest(1.0).len(), 48);
        let cut: Vec<bool> = (0..48).map(|t| t >= 45).collect();
        let site = Site::new(&mesh, |p| p.x, &cut);
        assert_eq!(site.nearest(0.0), [45, 46, 47]);
        let chosen = site.nearest(0.25);
        assert_eq!((chosen.len(), &chosen[9..]), (12, &[45, 46, 47][..]));
    }
}
