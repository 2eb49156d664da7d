//! Connects the clocks of all cameras by the most reliable rough offsets.

/// The minimum agreement (fraction of inliers) of a reliable rough offset, as a fraction of the median agreement of all
/// pairs. All pairs of a capture have similar agreements. An offset that is wrong by a period of the motion has about
/// half of this agreement.
const RELIABLE_FRACTION: f64 = 0.75;

/// Rough offset between two clocks, estimated from one pair of cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// The indices of the two clocks.
    pub clocks: [usize; 2],
    /// The offset of the second clock minus the offset of the first one, seconds.
    pub offset_s: f64,
    /// The agreement of the images with this offset (fraction of inliers), 0 to 1.
    pub agreement: f64,
}

/// Returns the minimum agreement (fraction of inliers) of a reliable rough offset, given the agreements of all pairs; 0
/// without pairs.
pub fn reliable_agreement(mut agreements: Vec<f64>) -> f64 {
    agreements.sort_by(f64::total_cmp);
    agreements.get(agreements.len() / 2).map_or(0.0, |median| RELIABLE_FRACTION * median)
}

/// Maximum spanning forest of the clocks: the links with the largest agreements that connect as many clocks as
/// possible without a loop.
pub struct Forest {
    /// For each clock, the index of its connected component, and its offset relative to the component's first clock,
    /// seconds.
    clocks: Vec<(usize, f64)>,
    /// For each link, whether it belongs to the forest.
    pub uses: Vec<bool>,
}

impl Forest {
    /// Computes the forest of `count` clocks by Kruskal's algorithm. Of links with equal agreements, the first one is
    /// preferred.
    pub fn new(count: usize, links: &[Link]) -> Self {
        let mut order: Vec<usize> = (0..links.len()).collect();
        order.sort_by(|&x, &y| links[y].agreement.total_cmp(&links[x].agreement).then(x.cmp(&y)));
        let mut forest = Self {
            clocks: (0..count).map(|clock| (clock, 0.0)).collect(),
            uses: vec![false; links.len()],
        };
        for n in order {
            forest.uses[n] = forest.join(&links[n]);
        }
        forest
    }

    /// Joins the components of a link's two clocks. Returns whether the components were separate before.
    fn join(&mut self, link: &Link) -> bool {
        let [(i, of_i), (j, of_j)] = link.clocks.map(|clock| self.clocks[clock]);
        if i == j {
            return false;
        }
        let change = of_i + link.offset_s - of_j;
        for (component, offset_s) in &mut self.clocks {
            if *component == j {
                (*component, *offset_s) = (i, *offset_s + change);
            }
        }
        true
    }

    /// Returns the index of the connected component that contains a clock.
    pub fn component(&self, clock: usize) -> usize {
        self.clocks[clock].0
    }

    /// Returns the offset of clock j minus the offset of clock i, seconds. `None` if no chain of links connects the
    /// clocks.
    pub fn offset_s(&self, [i, j]: [usize; 2]) -> Option<f64> {
        let [(in_i, of_i), (in_j, of_j)] = [self.clocks[i], self.clocks[j]];
        (in_i == in_j).then_some(of_j - of_i)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn link(clocks: [usize; 2], offset_s: f64, agreement: f64) -> Link {
        Link { clocks, offset_s, agreement }
    }

    #[test]
    fn the_weakest_link_of_a_loop_is_left_out() {
        let links = [link([0, 1], 1.0, 0.9), link([1, 2], 7.0, 0.5), link([2, 0], -3.0, 0.8)];
        let forest = Forest::new(4, &links);
        assert_eq!(forest.uses, [true, false, true]);
        assert_eq!(forest.offset_s([1, 2]), Some(2.0));
        assert_eq!(forest.offset_s([3, 3]), Some(0.0));
        assert_eq!(forest.offset_s([0, 3]), None);
    }

    #[test]
    fn offsets_of_consistent_links_are_those_of_the_clocks() {
        let random = &mut Random::new(8);
        for _ in 0..200 {
            let offsets_s: Vec<f64> = (0..9).map(|_| random.unit()).collect();
            let links: Vec<Link> = (0..30)
                .map(|_| {
                    let [i, j] = [(); 2].map(|()| (9.0 * random.unit()) as usize);
                    link([i, j], offsets_s[j] - offsets_s[i], random.unit())
                })
                .collect();
            let forest = Forest::new(9, &links);
            for l in &links {
                let offset_s = forest.offset_s(l.clocks).unwrap();
                assert!((offset_s - l.offset_s).abs() < 1e-12);
            }
            let joined = forest.uses.iter().filter(|used| **used).count();
            let distinct: std::collections::BTreeSet<_> =
                (0..9).map(|c| forest.component(c)).collect();
            assert_eq!(joined, 9 - distinct.len());
        }
    }

    #[test]
    fn half_of_the_median_is_not_reliable() {
        assert!(reliable_agreement(vec![0.9, 0.45, 0.95]) > 0.45);
        assert_eq!(reliable_agreement(Vec::new()), 0.0);
    }
}
