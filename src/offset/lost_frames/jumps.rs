//! Jump moves (Veksler 1999). A jump move shifts the times of some images, of one camera or of several, by the same
//! number of frames, and leaves all other image times unchanged. Its cost is the increase of the objective of
//! [`super::descent`]. Among all sets of images, a minimum cut finds a set whose move has a low cost. If all terms
//! are submodular, this cost is the minimum.
//!
//! Block-coordinate descent changes one camera's model at a time. If neighbouring cameras lose frames at about the
//! same time, a better solution may require simultaneous changes of several models, which only a jump move makes. A
//! move of negative cost is an improvement. The lowest cost of all moves that shift a given image is the image's
//! min-marginal (Kohli and Torr, CVIU 112(1), 2008). The cost of the move that the minimum cut finds is an upper
//! bound of the min-marginal. If this bound is near 0, the image's time is undecided.
//!
//! Known limits: moves change offsets only by whole frames, and leave rates unchanged. Observations that contradict
//! each other give terms that are not submodular ([`super::min_cut`]), so a move of lower cost may be missed.

use super::TimingObservation;
use super::fit::{gap_penalty, robust_loss};
use super::min_cut::{Energy, FORBIDDEN, TripleCosts};
use crate::offset::clock::{ClockModel, NominalClock};
use std::ops::Range;

/// Cameras of one connected component, with their clock models. Two cameras are connected if they have common
/// observations.
pub struct Component<'a> {
    pub clocks: &'a [NominalClock<'a>],
    /// The timing observations of each camera, by camera. An observation of two cameras is listed for each of them.
    pub observations: &'a [Vec<TimingObservation>],
    /// The index of the camera whose first image keeps its time, which fixes the common clock.
    pub root: usize,
    /// The clock model of each camera. `None` for a camera of another component, and for a camera that is not fitted
    /// yet.
    pub models: Vec<Option<ClockModel>>,
    /// The penalty of one lost frame, as a multiple of an outlier's cost.
    pub loss_penalty: f64,
}

impl Component<'_> {
    /// Returns the indices of the cameras that have a clock model, ascending.
    pub fn members(&self) -> Vec<usize> {
        (0..self.clocks.len()).filter(|&c| self.models[c].is_some()).collect()
    }

    /// Returns each timing observation whose camera b has a fitted clock model. No observation is repeated, although
    /// `observations` has each of them twice: under its camera a and under its camera b.
    pub fn fitted_observations(&self) -> impl Iterator<Item = &TimingObservation> {
        let as_second = |c: usize| self.observations[c].iter().filter(move |o| o.cameras[1] == c);
        self.members().into_iter().flat_map(as_second)
    }
}

/// Node of the graph of jump moves: successive images of one camera, whose times a jump move shifts together or not
/// at all. The images extend from `image` to the image before the next node's `image`.
struct MoveNode {
    camera: usize,
    image: usize,
    /// The number of frames lost between the `image` of the camera's previous node and this node's `image`; 0 for the
    /// camera's first node.
    lost: u32,
}

/// Jump move: shifts the image times of a set of nodes by [`Jumps::frames`].
pub struct Move {
    /// Whether each node's image times are shifted, in the order of [`Jumps::nodes`].
    moves: Vec<bool>,
    /// The increase of the objective by the jump move, as a multiple of an outlier's cost.
    pub cost: f64,
}

/// Graph of a component's jump moves (shifts of some image times) by a given number of frames. Each node has a binary
/// label: 1 if its image times are shifted.
pub struct Jumps<'a> {
    component: &'a Component<'a>,
    nodes: Vec<MoveNode>,
    /// The range of each camera's nodes in `nodes`, by camera. The nodes of a camera ascend by image.
    of_camera: Vec<Range<usize>>,
    /// The energy term of each timing observation: the nodes of its three images, and its cost for each combination of
    /// their labels (1 for a shifted node), as a multiple of an outlier's cost.
    terms: Vec<([usize; 3], TripleCosts)>,
    /// The shift of image times by a jump move, in frame periods of each camera. A positive shift makes times later.
    frames: i32,
}

impl<'a> Jumps<'a> {
    pub fn new(component: &'a Component<'a>, frames: i32) -> Self {
        let (nodes, of_camera) = nodes(component);
        let mut jumps = Self { component, nodes, of_camera, terms: Vec::new(), frames };
        jumps.terms = component.fitted_observations().filter_map(|o| jumps.term(o)).collect();
        jumps
    }

    /// Returns the index of the node (a group of images, [`MoveNode`]) that contains a camera's image. `None` if the
    /// camera has no nodes.
    fn node(&self, camera: usize, image: usize) -> Option<usize> {
        let range = self.of_camera[camera].clone();
        let within = self.nodes[range.clone()].partition_point(|n| n.image <= image);
        (!range.is_empty()).then(|| range.start + within.saturating_sub(1))
    }

    /// Returns the energy term of a timing observation: the nodes of its three images, and its cost for each
    /// combination of their labels (1 for a shifted node). `None` if one of its cameras has no model.
    fn term(&self, o: &TimingObservation) -> Option<([usize; 3], TripleCosts)> {
        let ([a, b], [k, m]) = (o.cameras, o.images);
        let [clock_a, clock_b] = o.cameras.map(|c| &self.component.clocks[c]);
        let [model_a, model_b] = o.cameras.map(|c| self.component.models[c].as_ref());
        let start_s = model_a?.image_time_s(clock_a, k)?;
        let end_s = model_a?.image_time_s(clock_a, k + 1)?;
        let image_s = model_b?.image_time_s(clock_b, m)?;
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

    /// Returns the nodes that decide whether a camera's lost frames are certain: its first and last node, and the nodes
    /// on both sides of each lost frame. A jump move that changes the camera's lost frames shifts at least one of these
    /// nodes. If all such moves have a high cost, the lost frames are certain.
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

    /// Returns the jump move of lowest cost that the minimum cut finds. If `containing` is given, the move must shift
    /// this node. The first node of [`Component::root`] is never shifted. `None` if the minimum cut finds no move
    /// that meets these conditions.
    pub fn cheapest(&self, containing: Option<usize>) -> Option<Move> {
        let mut energy = Energy::new(self.nodes.len());
        let origin = self.of_camera[self.component.root].start;
        energy.add_unary(origin, FORBIDDEN);
        if let Some(node) = containing {
            energy.add_unary(node, -FORBIDDEN);
        }
        for (nodes, costs) in &self.terms {
            energy.add_triple(*nodes, costs);
        }
        for (before, after) in self.neighbours() {
            // The number of frames lost between the two nodes increases if only `up` is shifted, and decreases if
            // only `down` is shifted.
            let (up, down) = if self.frames > 0 { (after, before) } else { (before, after) };
            let (lost, frames) = (self.nodes[after].lost, self.frames.unsigned_abs());
            if let Some(less) = lost.checked_sub(frames) {
                let penalty = self.penalty(lost) - self.penalty(less);
                energy.add_unary(up, penalty);
                energy.add_unary(down, -penalty);
            } else {
                energy.add_edge(up, down, self.penalty(lost + frames) - self.penalty(lost));
                energy.add_edge(down, up, FORBIDDEN);
            }
        }
        let moves = energy.minimize(self.nodes.len());
        let cost = self.cost(&moves)?;
        let contains = containing.is_none_or(|node| moves[node]);
        let is_move = moves.contains(&true) && contains && !moves[origin];
        is_move.then_some(Move { moves, cost })
    }

    /// Returns all pairs of successive nodes of the same camera, as indices into `nodes`.
    fn neighbours(&self) -> impl Iterator<Item = (usize, usize)> {
        let same_camera = |n: &usize| self.nodes[*n].camera == self.nodes[n + 1].camera;
        (0..self.nodes.len().saturating_sub(1)).filter(same_camera).map(|n| (n, n + 1))
    }

    /// Returns the increase of the objective, as a multiple of an outlier's cost, if every node n with `moves[n]` is
    /// shifted. `None` if the number of frames lost between two successive nodes would become negative.
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
        gap_penalty(lost, self.component.loss_penalty)
    }

    /// Returns the change of the number of frames lost between two successive nodes, if every node n with `moves[n]`
    /// is shifted.
    fn further_losses(&self, moves: &[bool], (before, after): (usize, usize)) -> i32 {
        self.frames * (i32::from(moves[after]) - i32::from(moves[before]))
    }

    /// Sets `marked[c]` to true for every camera c with at least one node that the move shifts.
    pub fn mark_moved(&self, of: &Move, marked: &mut [bool]) {
        for (range, marked) in self.of_camera.iter().zip(marked) {
            *marked |= of.moves[range.clone()].contains(&true);
        }
    }

    /// Returns the clock model of each camera after a jump move.
    pub fn apply(&self, of: &Move) -> Vec<Option<ClockModel>> {
        let mut models = self.component.models.clone();
        for (c, range) in self.of_camera.iter().enumerate() {
            let Some(model) = models[c].as_mut() else { continue };
            if of.moves[range.clone()].first() == Some(&true) {
                model.offset_s += f64::from(self.frames) * self.component.clocks[c].frame_s;
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

/// Divides the images of all cameras into nodes ([`MoveNode`]). Returns the nodes, and the range of each camera's
/// nodes.
///
/// A camera that cannot lose frames has a single node. For any other camera, a node starts at each observed image, at
/// the images on both sides of each lost frame, and at the camera's two [`observable_ends`].
fn nodes(component: &Component) -> (Vec<MoveNode>, Vec<Range<usize>>) {
    let mut images: Vec<Vec<usize>> = vec![Vec::new(); component.models.len()];
    for o in component.fitted_observations() {
        let ([a, b], [k, m]) = (o.cameras, o.images);
        images[a].extend([k, k + 1]);
        images[b].push(m);
    }
    for (images, model) in images.iter_mut().zip(&component.models) {
        // A node starts at each of the two images around a lost frame, so that the loss lies between successive
        // nodes.
        let lost_before = model.iter().flat_map(|m| &m.lost_before);
        images.extend(lost_before.flat_map(|n| [n.saturating_sub(1), *n]));
    }
    let ends = observable_ends(component);
    let (mut nodes, mut of_camera) = (Vec::new(), Vec::new());
    for (camera, images) in images.iter_mut().enumerate() {
        let start = nodes.len();
        images.extend(ends[camera].into_iter().flatten());
        images.sort_unstable();
        images.dedup();
        if !component.clocks[camera].may_lose_frames {
            images.truncate(1);
        }
        if let Some(model) = &component.models[camera] {
            for (n, &image) in images.iter().enumerate() {
                let between = |lost: &&usize| n > 0 && **lost > images[n - 1] && **lost <= image;
                let lost = model.lost_before.iter().filter(between).count();
                nodes.push(MoveNode { camera, image, lost: lost as u32 });
            }
        }
        of_camera.push(start..nodes.len());
    }
    (nodes, of_camera)
}

/// Returns, for each camera, the indices of the first and the last image that other cameras could observe.
///
/// The partners of a camera are the cameras with which it has common observations. The two images are the first and the
/// last one between the start of the partners' first recording and the end of their last recording, extended by one
/// frame period on both sides. `None` if there is no such image.
fn observable_ends(component: &Component) -> Vec<Option<[usize; 2]>> {
    let image_times_s = |(model, clock): (&Option<ClockModel>, &NominalClock)| {
        model.as_ref().map_or_else(Vec::new, |m| m.image_times_s(clock))
    };
    let times: Vec<Vec<f64>> =
        component.models.iter().zip(component.clocks).map(image_times_s).collect();
    let mut spans_s = vec![[f64::INFINITY, f64::NEG_INFINITY]; times.len()];
    for o in component.fitted_observations() {
        let [a, b] = o.cameras;
        for (c, other) in [(a, b), (b, a)] {
            for time_s in times[other].first().into_iter().chain(times[other].last()) {
                spans_s[c] = [spans_s[c][0].min(*time_s), spans_s[c][1].max(*time_s)];
            }
        }
    }
    let end = |(c, [start_s, end_s]): (usize, [f64; 2])| {
        let frame_s = component.clocks[c].frame_s;
        let first = times[c].partition_point(|t| *t <= start_s - frame_s);
        let last = times[c].partition_point(|t| *t < end_s + frame_s).checked_sub(1)?;
        (first <= last).then_some([first, last])
    };
    spans_s.into_iter().enumerate().map(end).collect()
}
