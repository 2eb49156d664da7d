//! Minimization of an energy of binary variables by a minimum cut (Kolmogorov and Zabih, PAMI 26(2),
//! 2004), found by Dinic's algorithm.
//!
//! Known limit: terms that are not submodular are replaced by upper bounds. The labels then have a low
//! energy, not always the minimum.

/// An energy of binary variables: a sum of terms of one, two and three variables.
#[derive(Clone)]
pub struct Energy {
    /// By variable: the cost of the label 1.
    unary: Vec<f64>,
    /// Two variables, and the cost of the label 1 for the first and 0 for the second.
    edges: Vec<(usize, usize, f64)>,
}

/// The energies of three variables' labels: `[x][y][z]`.
pub type TripleCosts = [[[f64; 2]; 2]; 2];

/// The cost of a forbidden label: more than the sum of all other terms.
const FORBIDDEN: f64 = 1e7;
/// The capacity up to which an edge counts as saturated; above rounding errors.
const SATURATED: f64 = 1e-9;

impl Energy {
    pub fn new(variables: usize) -> Self {
        Self { unary: vec![0.0; variables], edges: Vec::new() }
    }

    /// Fixes the label of a variable.
    pub fn fix(&mut self, variable: usize, label: bool) {
        self.unary[variable] += if label { -FORBIDDEN } else { FORBIDDEN };
    }

    /// Adds a cost of the label 1 for a variable.
    pub fn add_unary(&mut self, variable: usize, cost: f64) {
        self.unary[variable] += cost;
    }

    /// Adds a cost of the label 1 for x and 0 for y; it must not be negative.
    pub fn add_edge(&mut self, x: usize, y: usize, cost: f64) {
        self.edges.push((x, y, cost));
    }

    /// Forbids the label 1 for x and 0 for y.
    pub fn forbid(&mut self, x: usize, y: usize) {
        self.edges.push((x, y, FORBIDDEN));
    }

    /// Adds the term `coefficient · x · y`; the coefficient must not be positive.
    fn add_product(&mut self, x: usize, y: usize, coefficient: f64) {
        self.unary[x] += coefficient;
        if x != y {
            self.edges.push((x, y, -coefficient));
        }
    }

    /// Adds a term of three variables, which need not be distinct.
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
        // The cubic term is a minimum over an auxiliary variable w: of −2cw + cw (x + y + z) if it is
        // negative, otherwise of cw − cw (x + y + z) + c (xy + xz + yz).
        if cubic.abs() > SATURATED {
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
                // The product is not submodular: a cost of the dearer variable bounds it.
                let dearer = if single[i] > single[j] { i } else { j };
                self.unary[variables[dearer]] += coefficient;
            }
        }
    }

    /// Minimizes the energy, and returns the labels of the first `count` variables. Among several minima
    /// it is the one with the fewest labels of 1.
    pub fn minimize(&self, count: usize) -> Vec<bool> {
        let (source, sink) = (self.unary.len(), self.unary.len() + 1);
        let mut network = Network::new(sink + 1);
        for (variable, &cost) in self.unary.iter().enumerate() {
            if cost > 0.0 {
                network.add_edge(variable, sink, cost);
            } else if cost < 0.0 {
                network.add_edge(source, variable, -cost);
            }
        }
        for &(x, y, cost) in &self.edges {
            network.add_edge(x, y, cost);
        }
        let levels = network.saturate(source, sink);
        levels[..count].iter().map(Option::is_some).collect()
    }
}

/// A flow network in which edge `2n + 1` is the reverse of edge `2n`.
struct Network {
    /// By node: its edges.
    leaving: Vec<Vec<usize>>,
    /// By edge: the node that it leads to.
    to: Vec<usize>,
    /// By edge: its residual capacity.
    capacity: Vec<f64>,
}

impl Network {
    fn new(nodes: usize) -> Self {
        Self { leaving: vec![Vec::new(); nodes], to: Vec::new(), capacity: Vec::new() }
    }

    fn add_edge(&mut self, from: usize, to: usize, capacity: f64) {
        for (from, to, capacity) in [(from, to, capacity), (to, from, 0.0)] {
            self.leaving[from].push(self.to.len());
            self.to.push(to);
            self.capacity.push(capacity);
        }
    }

    /// Sends the maximum flow, and returns the levels of the nodes that the source still reaches.
    fn saturate(&mut self, source: usize, sink: usize) -> Vec<Option<usize>> {
        loop {
            let levels = self.levels(source);
            if levels[sink].is_none() {
                return levels;
            }
            let mut next = vec![0; self.leaving.len()];
            while self.augment(&levels, &mut next, source, sink) {}
        }
    }

    /// By node: its distance from the source along edges with capacity.
    fn levels(&self, source: usize) -> Vec<Option<usize>> {
        let mut levels = vec![None; self.leaving.len()];
        levels[source] = Some(0);
        let mut queue = std::collections::VecDeque::from([(source, 0)]);
        while let Some((node, level)) = queue.pop_front() {
            for &edge in &self.leaving[node] {
                let to = self.to[edge];
                if self.capacity[edge] > SATURATED && levels[to].is_none() {
                    levels[to] = Some(level + 1);
                    queue.push_back((to, level + 1));
                }
            }
        }
        levels
    }

    /// Sends flow along one path of ascending levels, and returns whether there was one. `next` holds each
    /// node's first edge that may still lead to the sink.
    fn augment(
        &mut self,
        levels: &[Option<usize>],
        next: &mut [usize],
        source: usize,
        sink: usize,
    ) -> bool {
        let mut path: Vec<usize> = Vec::new();
        let mut node = source;
        while node != sink {
            let Some(&edge) = self.leaving[node].get(next[node]) else {
                // A dead end: one step back.
                let Some(edge) = path.pop() else { return false };
                node = self.to[edge ^ 1];
                next[node] += 1;
                continue;
            };
            let to = self.to[edge];
            if self.capacity[edge] > SATURATED && levels[to] == levels[node].map(|l| l + 1) {
                path.push(edge);
                node = to;
            } else {
                next[node] += 1;
            }
        }
        let flow = path.iter().map(|e| self.capacity[*e]).fold(f64::INFINITY, f64::min);
        for edge in path {
            self.capacity[edge] -= flow;
            self.capacity[edge ^ 1] += flow;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Random energies of up to eight variables whose triples are all truncated distances between two
    /// of their variables, as submodular ones are: the labels have the minimum energy of all.
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
        energy.fix(0, true);
        energy.fix(3, false);
        energy.forbid(0, 1);
        energy.add_edge(1, 2, 0.5);
        energy.add_unary(2, 0.4);
        assert_eq!(energy.minimize(4), [true, true, true, false]);
        energy.add_unary(2, 0.2);
        assert_eq!(energy.minimize(4), [true, true, false, false]);
    }
}
