//! Minimizes an energy of binary variables by a minimum cut (Kolmogorov and Zabih, PAMI 26(2), 2004). Dinic's
//! algorithm finds the cut.
//!
//! Known limit: terms that are not submodular are replaced by upper bounds. The resulting labels have a low energy,
//! but not always the minimum.

use petgraph::Direction;
use petgraph::algo::dinics;
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::EdgeRef;

/// Energy of binary variables (labels 0 and 1): a sum of terms of one, two and three variables.
pub struct Energy {
    /// The cost of the label 1 for each variable; the label 0 costs 0.
    unary: Vec<f64>,
    /// The terms of two variables, as (x, y, cost). The cost applies if variable x has the label 1 and variable y has
    /// the label 0.
    edges: Vec<(usize, usize, f64)>,
}

/// Cost of each combination of three variables' labels x, y and z, as `[x][y][z]`.
pub type TripleCosts = [[[f64; 2]; 2]; 2];

/// The cost of a forbidden label, or of a forbidden pair of labels. It is larger than the sum of all other
/// terms.
pub const FORBIDDEN: f64 = 1e7;
/// The edge capacity that represents a cost of 1. Capacities are integers, so that flows are exact.
const UNITS: f64 = (1_u64 << 30) as f64;

impl Energy {
    pub fn new(variables: usize) -> Self {
        Self { unary: vec![0.0; variables], edges: Vec::new() }
    }

    /// Adds a cost for the label 1 of a variable. The cost may be negative.
    pub fn add_unary(&mut self, variable: usize, cost: f64) {
        self.unary[variable] += cost;
    }

    /// Adds a cost that applies if variable x has the label 1 and variable y has the label 0. The cost must not be
    /// negative.
    pub fn add_edge(&mut self, x: usize, y: usize, cost: f64) {
        self.edges.push((x, y, cost));
    }

    /// Adds the term `coefficient · x · y`. The coefficient must not be positive.
    fn add_product(&mut self, x: usize, y: usize, coefficient: f64) {
        self.unary[x] += coefficient;
        if x != y {
            self.edges.push((x, y, -coefficient));
        }
    }

    /// Adds a term of three variables. `e` is its cost for each combination of their labels. Some of the variables
    /// may be the same.
    pub fn add_triple(&mut self, [x, y, z]: [usize; 3], e: &TripleCosts) {
        let variables = [x, y, z];
        let single = [e[1][0][0], e[0][1][0], e[0][0][1]].map(|v| v - e[0][0][0]);
        let product = |both: f64, i: usize, j: usize| both - e[0][0][0] - single[i] - single[j];
        let products = [
            (0, 1, product(e[1][1][0], 0, 1)),
            (0, 2, product(e[1][0][1], 0, 2)),
            (1, 2, product(e[0][1][1], 1, 2)),
        ];
        let sum = single.iter().sum::<f64>() + products.iter().map(|p| p.2).sum::<f64>();
        let cubic = e[1][1][1] - e[0][0][0] - sum;
        for (variable, cost) in variables.into_iter().zip(single) {
            self.unary[variable] += cost;
        }
        // The cubic term c·xyz is replaced by the minimum, over an auxiliary binary variable w, of −2cw + cw (x + y +
        // z) if c is negative, and of cw − cw (x + y + z) + c (xy + xz + yz) otherwise.
        if cubic.abs() > 1.0 / UNITS {
            let further = self.unary.len();
            self.unary.push(if cubic < 0.0 { -2.0 * cubic } else { cubic });
            for variable in variables {
                self.add_product(further, variable, -cubic.abs());
            }
        }
        for (i, j, coefficient) in products {
            let coefficient = coefficient + cubic.max(0.0);
            if coefficient <= 0.0 {
                self.add_product(variables[i], variables[j], coefficient);
            } else {
                // The product is not submodular. It is replaced by an upper bound: its coefficient becomes a cost of
                // the variable whose own cost is higher.
                let dearer = if single[i] > single[j] { i } else { j };
                self.unary[variables[dearer]] += coefficient;
            }
        }
    }

    /// Minimizes the energy, and returns the labels of the first `count` variables; `true` is the label 1. Of several
    /// minima, the one with the fewest labels 1 is returned.
    pub fn minimize(&self, count: usize) -> Vec<bool> {
        let (source, sink) = (self.unary.len(), self.unary.len() + 1);
        let terminal = |(variable, &cost): (usize, &f64)| match cost > 0.0 {
            true => (variable, sink, cost),
            false => (source, variable, -cost),
        };
        // An edge of capacity 0 makes sure that both terminals, source and sink, exist.
        let edges = std::iter::once((source, sink, 0.0))
            .chain(self.unary.iter().enumerate().map(terminal))
            .chain(self.edges.iter().copied())
            .map(|(x, y, cost)| (x as u32, y as u32, (UNITS * cost).round() as u64));
        let network = DiGraph::<(), u64>::from_edges(edges);
        let (_, flow) = dinics(&network, NodeIndex::new(source), NodeIndex::new(sink));
        // The variables that can be reached from the source in the residual network have the label 1.
        let mut reached = vec![false; network.node_count()];
        let mut open = vec![NodeIndex::new(source)];
        while let Some(node) = open.pop() {
            if !std::mem::replace(&mut reached[node.index()], true) {
                let onward = network.edges_directed(node, Direction::Outgoing);
                let onward = onward.filter(|e| flow[e.id().index()] < *e.weight());
                let back = network.edges_directed(node, Direction::Incoming);
                let back = back.filter(|e| flow[e.id().index()] > 0);
                open.extend(onward.map(|e| e.target()).chain(back.map(|e| e.source())));
            }
        }
        reached.truncate(count);
        reached
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Random energies of up to eight variables. All terms of three variables are truncated squared distances between
    /// one variable and a weighted mean of the other two, which are submodular. The labels must have the minimum
    /// energy.
    #[test]
    fn the_minimum_of_submodular_energies_is_found() {
        let random = &mut Random::new(4);
        for _ in 0..300 {
            let count = 3 + (random.unit() * 6.0) as usize;
            let mut energy = Energy::new(count);
            let unary: Vec<f64> = (0..count).map(|_| random.signed()).collect();
            unary.iter().enumerate().for_each(|(n, cost)| energy.add_unary(n, *cost));
            let mut triples = Vec::new();
            for _ in 0..2 * count {
                let variables = [0; 3].map(|_| (random.unit() * count as f64) as usize);
                let f = random.unit();
                let table: TripleCosts = std::array::from_fn(|x| {
                    std::array::from_fn(|y| {
                        std::array::from_fn(|z| {
                            let moved = (1.0 - f) * x as f64 + f * y as f64 - z as f64;
                            (moved * moved / 0.06).min(1.0)
                        })
                    })
                });
                energy.add_triple(variables, &table);
                triples.push((variables, table));
            }
            let value = |labels: &[usize]| {
                let single: f64 = unary.iter().zip(labels).map(|(u, l)| u * *l as f64).sum();
                let of = |([x, y, z], t): &([usize; 3], TripleCosts)| {
                    t[labels[*x]][labels[*y]][labels[*z]]
                };
                single + triples.iter().map(of).sum::<f64>()
            };
            let lowest = (0..1 << count)
                .map(|bits: usize| (0..count).map(|n| bits >> n & 1).collect::<Vec<_>>())
                .map(|labels| value(&labels))
                .fold(f64::INFINITY, f64::min);
            let found: Vec<usize> = energy.minimize(count).into_iter().map(usize::from).collect();
            assert!(value(&found) < lowest + 1e-6, "{} {lowest}", value(&found));
        }
    }

    #[test]
    fn fixed_variables_and_forbidden_pairs_hold() {
        let mut energy = Energy::new(4);
        energy.add_unary(0, -FORBIDDEN);
        energy.add_unary(3, FORBIDDEN);
        energy.add_edge(0, 1, FORBIDDEN);
        energy.add_edge(1, 2, 0.5);
        energy.add_unary(2, 0.4);
        assert_eq!(energy.minimize(4), [true, true, true, false]);
        energy.add_unary(2, 0.2);
        assert_eq!(energy.minimize(4), [true, true, false, false]);
    }
}
