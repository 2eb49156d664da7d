//! Jump moves (Veksler 1999): some images of some cameras move by whole frames, all others stay. A minimum
//! cut finds a move of low cost among all sets of images, those of several cameras included: the move of
//! lowest cost where all terms are submodular.
//!
//! Block-coordinate descent changes one camera at a time. Where neighbours lose frames at about the
//! same time, a better model differs from a worse one in all of them at once. A move of negative cost
//! is an improvement. The cost of a given image's move bounds that image's min-marginal (Kohli and Torr,
//! CVIU 112(1), 2008) from above: where it costs next to nothing, the image's time is undecided.
//!
//! Known limits: offsets within a frame and rates stay as they are. Observations that contradict each other give
//! terms that are not submodular ([`super::min_cut`]), and a move through them may be missed.

use super::fit::{gap_penalty, robust_loss};
use super::min_cut::{Energy, Triple};
use super::{ClockModel, NominalClock, TimingObservation};
use std::ops::Range;

/// Images of a camera that move together: from `image` up to that of the camera's next node.
struct Node {
    camera: usize,
    image: usize,
    /// The frames missing between the camera's previous node and this one; 0 at the first.
    lost: u32,
}

/// A set of nodes that move.
pub struct Move {
    moves: Vec<bool>,
    /// By how much it changes the objective.
    pub cost: f64,
}

/// The problem: a component's models and observations.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    pub clocks: &'a [NominalClock<'a>],
    /// By camera; `None` for those of other components.
    pub models: &'a [Option<ClockModel>],
    /// The component's, each once.
    pub observations: &'a [TimingObservation],
    /// The camera whose first image keeps its time.
    pub origin: usize,
    /// The penalty of one lost frame, in outliers.
    pub loss_penalty: f64,
}

/// The moves of a component by one number of frames.
pub struct Jumps<'a> {
    problem: Problem<'a>,
    nodes: Vec<Node>,
    /// By camera: its nodes, ascending by image.
    of_camera: Vec<Range<usize>>,
    /// The nodes of each observation's three images, and its cost by which of them move.
    terms: Vec<([usize; 3], Triple)>,
    /// By how many frames nodes move.
    frames: i32,
}

impl<'a> Jumps<'a> {
    pub fn new(problem: Problem<'a>, frames: i32) -> Self {
        let (nodes, of_camera) = nodes(&problem);
        let mut jumps = Self { problem, nodes, of_camera, terms: Vec::new(), frames };
        jumps.terms = problem.observations.iter().filter_map(|o| jumps.term(o)).collect();
        jumps
    }

    /// The node of a camera's image; `None` for a camera without nodes.
    fn node(&self, camera: usize, image: usize) -> Option<usize> {
        let range = self.of_camera[camera].clone();
        let within = self.nodes[range.clone()].partition_point(|n| n.image <= image);
        (!range.is_empty()).then(|| range.start + within.saturating_sub(1))
    }

    /// An observation's nodes and costs.
    fn term(&self, o: &TimingObservation) -> Option<([usize; 3], Triple)> {
        let ([a, b], [k, m]) = (o.cameras, o.images);
        let [clock_a, clock_b] = o.cameras.map(|c| &self.problem.clocks[c]);
        let [model_a, model_b] = o.cameras.map(|c| self.problem.models[c].as_ref());
        let (start_s, end_s) = (model_a?.time_s(clock_a, k)?, model_a?.time_s(clock_a, k + 1)?);
        let image_s = model_b?.time_s(clock_b, m)?;
        let [step_a_s, step_b_s] = [clock_a, clock_b].map(|c| f64::from(self.frames) * c.frame_s);
        let cost = |moved: [usize; 3]| {
            let [x, y, z] = moved.map(|x| x as f64);
            let (start_s, end_s) = (start_s + x * step_a_s, end_s + y * step_a_s);
            let expected_s = start_s + o.fraction * (end_s - start_s);
            let residual_s = expected_s - image_s - z * step_b_s;
            robust_loss(residual_s / clock_b.frame_s, (end_s - start_s) / clock_a.frame_s)
        };
        let costs = std::array::from_fn(|x| {
            std::array::from_fn(|y| std::array::from_fn(|z| cost([x, y, z])))
        });
        Some(([self.node(a, k)?, self.node(a, k + 1)?, self.node(b, m)?], costs))
    }

    /// The nodes whose times decide on a camera: its first and last ones, and those on both sides of
    /// each of its lost frames.
    pub fn decisive_nodes(&self, camera: usize) -> Vec<usize> {
        let range = self.of_camera[camera].clone();
        let at_loss = range.clone().filter(|n| self.nodes[*n].lost > 0);
        let mut decisive: Vec<usize> = at_loss.flat_map(|n| [n - 1, n]).collect();
        decisive.extend(range.clone().next());
        decisive.extend(range.last());
        decisive.sort_unstable();
        decisive.dedup();
        decisive
    }

    /// A move of low cost, of those that contain a node if one is given; `None` if nothing moves, or all such
    /// moves are impossible.
    pub fn cheapest(&self, containing: Option<usize>) -> Option<Move> {
        let mut energy = Energy::new(self.nodes.len());
        energy.fix(self.of_camera[self.problem.origin].start, false);
        if let Some(node) = containing {
            energy.fix(node, true);
        }
        for (nodes, costs) in &self.terms {
            energy.add_triple(*nodes, costs);
        }
        for (before, after) in self.neighbours() {
            // The time between the two grows where the first of these moves alone.
            let (up, down) = if self.frames > 0 { (after, before) } else { (before, after) };
            let (lost, frames) = (self.nodes[after].lost, self.frames.unsigned_abs());
            if let Some(less) = lost.checked_sub(frames) {
                let penalty = self.penalty(lost) - self.penalty(less);
                energy.add_unary(up, penalty);
                energy.add_unary(down, -penalty);
            } else {
                energy.add_edge(up, down, self.penalty(lost + frames) - self.penalty(lost));
                energy.forbid(down, up);
            }
        }
        let moves = energy.minimize(self.nodes.len());
        let cost = self.cost(&moves)?;
        let contains = containing.is_none_or(|node| moves[node]);
        let origin = moves[self.of_camera[self.problem.origin].start];
        (moves.contains(&true) && contains && !origin).then_some(Move { moves, cost })
    }

    /// Pairs of a camera's successive nodes.
    fn neighbours(&self) -> impl Iterator<Item = (usize, usize)> {
        let same_camera = |n: &usize| self.nodes[*n].camera == self.nodes[n + 1].camera;
        (0..self.nodes.len().saturating_sub(1)).filter(same_camera).map(|n| (n, n + 1))
    }

    /// By how much a move changes the objective; `None` if a loss count would descend.
    fn cost(&self, moves: &[bool]) -> Option<f64> {
        let mut cost = 0.0;
        for ([x, y, z], costs) in &self.terms {
            let [x, y, z] = [x, y, z].map(|n| usize::from(moves[*n]));
            cost += costs[x][y][z] - costs[0][0][0];
        }
        for pair in self.neighbours() {
            let lost = self.nodes[pair.1].lost;
            let after = lost.checked_add_signed(self.further_losses(moves, pair))?;
            cost += self.penalty(after) - self.penalty(lost);
        }
        Some(cost)
    }

    fn penalty(&self, lost: u32) -> f64 {
        gap_penalty(lost, self.problem.loss_penalty)
    }

    /// By how much a move changes the number of frames lost between two neighbours.
    fn further_losses(&self, moves: &[bool], (before, after): (usize, usize)) -> i32 {
        self.frames * (i32::from(moves[after]) - i32::from(moves[before]))
    }

    /// The cameras with images that move, ascending.
    pub fn moved_cameras(&self, of: &Move) -> Vec<usize> {
        let moves = |range: &Range<usize>| of.moves[range.clone()].contains(&true);
        let cameras = self.of_camera.iter().enumerate();
        cameras.filter(|(_, range)| moves(range)).map(|(c, _)| c).collect()
    }

    /// The models after a move.
    pub fn apply(&self, of: &Move) -> Vec<Option<ClockModel>> {
        let mut models = self.problem.models.to_vec();
        for (c, range) in self.of_camera.iter().enumerate() {
            let Some(model) = models[c].as_mut() else { continue };
            if of.moves[range.clone()].first() == Some(&true) {
                model.offset_s += f64::from(self.frames) * self.problem.clocks[c].frame_s;
            }
        }
        for pair in self.neighbours() {
            let (before, after) = (&self.nodes[pair.0], &self.nodes[pair.1]);
            let Some(model) = models[after.camera].as_mut() else { continue };
            let lost_before = &mut model.lost_before;
            let further = self.further_losses(&of.moves, pair);
            for _ in 0..further {
                lost_before.push(after.image);
            }
            for _ in further..0 {
                let between = |n: &usize| *n > before.image && *n <= after.image;
                if let Some(at) = lost_before.iter().position(between) {
                    lost_before.remove(at);
                }
            }
            lost_before.sort_unstable();
        }
        models
    }
}

/// The nodes of all cameras, and their ranges by camera. A camera that loses no frames moves as a whole;
/// of another one, each image with an observation is a node, and the first and last ones that others
/// could observe.
fn nodes(problem: &Problem) -> (Vec<Node>, Vec<Range<usize>>) {
    let mut images: Vec<Vec<usize>> = vec![Vec::new(); problem.models.len()];
    for o in problem.observations {
        let ([a, b], [k, m]) = (o.cameras, o.images);
        images[a].extend([k, k + 1]);
        images[b].push(m);
    }
    for (images, model) in images.iter_mut().zip(problem.models) {
        // Between the image before a loss and that after it no other one may hide.
        let lost_before = model.iter().flat_map(|m| &m.lost_before);
        images.extend(lost_before.flat_map(|n| [n.saturating_sub(1), *n]));
    }
    let ends = observable_ends(problem);
    let (mut nodes, mut of_camera) = (Vec::new(), Vec::new());
    for (camera, images) in images.iter_mut().enumerate() {
        let start = nodes.len();
        images.extend(&ends[camera]);
        images.sort_unstable();
        images.dedup();
        if !problem.clocks[camera].may_lose_frames {
            images.truncate(1);
        }
        if let Some(model) = &problem.models[camera] {
            for (n, &image) in images.iter().enumerate() {
                let between = |lost: &&usize| n > 0 && **lost > images[n - 1] && **lost <= image;
                let lost = model.lost_before.iter().filter(between).count();
                nodes.push(Node { camera, image, lost: lost as u32 });
            }
        }
        of_camera.push(start..nodes.len());
    }
    (nodes, of_camera)
}

/// By camera: the first and the last image within a frame of another camera's image, if there is any, of
/// those cameras that the observations connect it with.
fn observable_ends(problem: &Problem) -> Vec<Vec<usize>> {
    let times: Vec<Vec<f64>> = (problem.models.iter().zip(problem.clocks))
        .map(|(model, clock)| model.as_ref().map_or_else(Vec::new, |m| m.times_s(clock)))
        .collect();
    let mut spans_s: Vec<Option<[f64; 2]>> = vec![None; times.len()];
    for o in problem.observations {
        let [a, b] = o.cameras;
        for (c, other) in [(a, b), (b, a)] {
            let [Some(first), Some(last)] = [times[other].first(), times[other].last()] else {
                continue;
            };
            let [start_s, end_s] = spans_s[c].unwrap_or([f64::INFINITY, f64::NEG_INFINITY]);
            spans_s[c] = Some([start_s.min(*first), end_s.max(*last)]);
        }
    }
    let end = |c: usize| {
        let [start_s, end_s] = spans_s[c]?;
        let frame_s = problem.clocks[c].frame_s;
        let first = times[c].partition_point(|t| *t <= start_s - frame_s);
        let last = times[c].partition_point(|t| *t < end_s + frame_s).checked_sub(1)?;
        (first <= last).then(|| vec![first, last])
    };
    (0..times.len()).map(|c| end(c).unwrap_or_default()).collect()
}
