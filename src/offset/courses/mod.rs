//! Which frames each camera lost, from what all pairs saw together.
//!
//! A camera's course is its time on a common clock: its own clock's, an offset, a rate where clocks
//! drift, and a frame more from each image on before which one is missing. A sighting says that an
//! image of one camera was taken a share of the way between two of another. Courses are fitted one
//! after the other, each to all others, until none changes; where a camera's losses are, for an
//! offset and a rate, is a shortest path, so that none better is overlooked. Its cost is the sum of
//! truncated squares: what was seen wrongly costs its bound on any course, and a loss has to save
//! that of several sightings. What only some of that many say leaves the course in doubt.

mod path;

use nalgebra::Vector2;
use path::{Fitted, Search, Seen, cost};

/// Image `images[1]` of camera `cameras[1]` was taken this share of the way from image `images[0]`
/// of camera `cameras[0]` to its next one; a little beyond 0 and 1, too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    pub cameras: [usize; 2],
    pub images: [usize; 2],
    pub share: f64,
}

/// A camera's clock as it was told.
#[derive(Clone, Copy, Debug)]
pub struct Told<'a> {
    pub times_s: &'a [f64],
    pub frame_s: f64,
    pub loses: bool,
    pub drifts: bool,
}

/// A camera's time on the common clock.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// At the camera's first image,
    pub offset_s: f64,
    /// and how it grows, seconds a second.
    pub rate: f64,
    /// The images before which a frame is missing, one entry for each.
    pub lost_before: Vec<usize>,
    /// Whether some images say that there are other losses, and not enough of them; or most of what
    /// was seen doesn't fit.
    pub doubtful: bool,
    /// Cameras whose courses depend on each other have the same number.
    pub group: usize,
}

impl Course {
    /// When an image was taken, on the common clock; `None` beyond the last.
    pub fn time_s(&self, told: &Told, image: usize) -> Option<f64> {
        let time_s = *told.times_s.get(image)?;
        let lost = self.lost_before.iter().filter(|n| **n <= image).count() as f64;
        let own_s = time_s + lost * told.frame_s;
        Some(own_s + self.offset_s + self.rate * (own_s - told.times_s[0]))
    }

    /// When all were.
    pub fn times_s(&self, told: &Told) -> Vec<f64> {
        (0..told.times_s.len()).map_while(|image| self.time_s(told, image)).collect()
    }
}

/// Sightings that are wrong without a loss and right with it, for it to be believed. Larger leaves
/// frames that were lost near a film's ends unfound; smaller makes some up where motion repeats.
const SUPPORT: f64 = 1.8;
/// With this many it may be one, and the camera's course is in doubt.
const DOUBT: f64 = 1.2;
/// Of fitting each to all others, and the losses to the line.
const ROUNDS: usize = 12;

/// The cameras' courses, on the clock of the first of each group of them that saw each other, which
/// is the reference if it is one of them. `None` for one that saw nothing.
pub fn courses(told: &[Told], reference: usize, sightings: &[Sighting]) -> Vec<Option<Course>> {
    let mut all = Fits::new(told, sightings);
    let mut group = 0;
    for root in std::iter::once(reference).chain(0..told.len()) {
        if all.courses[root].is_some() || all.sightings[root].is_empty() {
            continue;
        }
        all.courses[root] = Some(Course { group, ..Course::default() });
        while let Some(next) = all.next() {
            all.add(next, group);
        }
        all.settle(group);
        all.doubt(group);
        all.start_at(root, group);
        group += 1;
    }
    all.courses
}

struct Fits<'a> {
    told: &'a [Told<'a>],
    /// By camera: each is both of its cameras'.
    sightings: Vec<Vec<Sighting>>,
    courses: Vec<Option<Course>>,
}

impl<'a> Fits<'a> {
    fn new(told: &'a [Told<'a>], sightings: &[Sighting]) -> Self {
        let mut of_camera = vec![Vec::new(); told.len()];
        for sighting in sightings {
            for c in sighting.cameras {
                of_camera[c].push(*sighting);
            }
        }
        Self { told, sightings: of_camera, courses: vec![None; told.len()] }
    }

    /// The camera without a course that those with one saw most; those that lose no frames first.
    fn next(&self) -> Option<usize> {
        let seen = |c: usize| {
            let with_one = |s: &&Sighting| s.cameras.iter().any(|c| self.courses[*c].is_some());
            self.sightings[c].iter().filter(with_one).count()
        };
        (0..self.told.len())
            .filter(|&c| self.courses[c].is_none())
            .map(|c| (seen(c), c))
            .filter(|(seen, _)| *seen > 0)
            .max_by_key(|&(seen, c)| (!self.told[c].loses, seen, std::cmp::Reverse(c)))
            .map(|(_, c)| c)
    }

    /// Gives a camera a course beside those that have one. Where it seems to go back by a frame, all
    /// of these may have lost one; that stays if it explains more.
    fn add(&mut self, camera: usize, group: usize) {
        let support = SUPPORT;
        let free = self.fit(camera, Search { support, falls: true });
        let before = self.courses.clone();
        self.courses[camera] =
            Some(Course { group, ..self.fit(camera, Search::of(support)).course });
        if free.falls.is_empty() {
            return;
        }
        self.settle(group);
        let (cost, plain) = (self.cost(group), std::mem::replace(&mut self.courses, before));
        let own = Course { group, ..free.course };
        // Where the others are a frame behind, after each fall by one more.
        let told = &self.told[camera];
        let fell = |(n, image): (usize, &usize)| {
            Some(own.time_s(told, *image)? - (n + 1) as f64 * told.frame_s)
        };
        let falls: Vec<f64> = free.falls.iter().enumerate().filter_map(fell).collect();
        for c in self.members(group) {
            let Some(course) = self.courses[c].as_mut().filter(|_| self.told[c].loses) else {
                continue;
            };
            let times = course.times_s(&self.told[c]);
            // Its first image there; one before it is as late as it was.
            let late = |t: &f64| times.partition_point(|own| own < t).min(times.len() - 1);
            course.lost_before.extend(falls.iter().map(late));
            course.lost_before.sort_unstable();
        }
        self.courses[camera] = Some(own);
        self.settle(group);
        if self.cost(group) >= cost {
            self.courses = plain;
        }
    }

    fn members(&self, group: usize) -> Vec<usize> {
        let is_in = |c: &usize| self.courses[*c].as_ref().is_some_and(|c| c.group == group);
        (0..self.told.len()).filter(is_in).collect()
    }

    /// Fits each to the others until none changes.
    fn settle(&mut self, group: usize) {
        let members = self.members(group);
        for _ in 0..ROUNDS {
            let mut rests = true;
            for &c in &members {
                let course = Course { group, ..self.fit(c, Search::of(SUPPORT)).course };
                let before = self.courses[c].replace(course.clone()).unwrap_or_default();
                rests &= course.lost_before == before.lost_before
                    && (course.offset_s - before.offset_s).abs() < 1e-3 * self.told[c].frame_s;
            }
            if rests {
                break;
            }
        }
    }

    /// Says which courses would be others if less were asked of a loss, or fit less than half of what
    /// is seen.
    fn doubt(&mut self, group: usize) {
        for c in self.members(group) {
            let doubted = self.fit(c, Search::of(DOUBT));
            let seen = self.sightings[c].len() as f64;
            if let Some(course) = &mut self.courses[c] {
                let losses = DOUBT * course.lost_before.len() as f64;
                course.doubtful = doubted.course.lost_before != course.lost_before
                    || doubted.cost - losses > 0.5 * seen;
            }
        }
    }

    /// Of all sightings and losses of a group.
    fn cost(&self, group: usize) -> f64 {
        let of_one = |c: usize| {
            let line = self.courses[c].as_ref().map_or_else(Vector2::zeros, |course| {
                Vector2::new(course.offset_s / self.told[c].frame_s, course.rate)
            });
            let lost = |s: &Seen| {
                let before = self.courses[c].iter().flat_map(|c| &c.lost_before);
                before.filter(|n| **n <= s.image).count() as i32
            };
            let own = self.sightings[c].iter().filter(|s| s.cameras[1] == c);
            let seen = own.filter_map(|s| self.seen(c, s));
            let losses = self.courses[c].as_ref().map_or(0, |c| c.lost_before.len());
            let sum: f64 = seen.map(|s| cost(s.residual(&line, [lost(&s); 2]))).sum();
            sum + SUPPORT * losses as f64
        };
        self.members(group).into_iter().map(of_one).sum()
    }

    /// Makes one camera's clock the common one.
    fn start_at(&mut self, root: usize, group: usize) {
        let Some(start) = self.courses[root].clone() else { return };
        for c in self.members(group) {
            if let Some(course) = &mut self.courses[c] {
                course.offset_s -= start.offset_s;
                course.rate -= start.rate;
            }
        }
    }

    /// A camera's course, given those of all others.
    fn fit(&self, camera: usize, search: Search) -> Fitted {
        let told = &self.told[camera];
        let seen: Vec<Seen> =
            self.sightings[camera].iter().filter_map(|s| self.seen(camera, s)).collect();
        path::fit(&seen, told, search)
    }

    /// What a sighting says of one of its cameras.
    fn seen(&self, camera: usize, sighting: &Sighting) -> Option<Seen> {
        let [a, b] = sighting.cameras;
        let [k, m] = sighting.images;
        let told = &self.told[camera];
        let (image, share, time_s) = if b == camera {
            let time_s = self.time_s(a, k)?;
            (m, 0.0, time_s + sighting.share * (self.time_s(a, k + 1)? - time_s))
        } else if a == camera {
            (k, sighting.share, self.time_s(b, m)?)
        } else {
            return None;
        };
        let own_s = match told.times_s.get(image + 1) {
            Some(next_s) => told.times_s[image] + share * (next_s - told.times_s[image]),
            None => told.times_s[image],
        };
        Some(Seen {
            image,
            share,
            frames: (time_s - own_s) / told.frame_s,
            since: (own_s - told.times_s[0]) / told.frame_s,
        })
    }

    /// When an image was taken, on the common clock.
    fn time_s(&self, camera: usize, image: usize) -> Option<f64> {
        self.courses[camera].as_ref()?.time_s(&self.told[camera], image)
    }
}

#[cfg(test)]
mod tests {
    use super::path::BOUND;
    use super::*;
    use crate::random::Random;

    const FRAME_S: f64 = 1.0 / 30.0;

    /// Cameras in a row that film for as long, each seen by the two next to it on either side.
    struct Film {
        times_s: Vec<Vec<f64>>,
        truth: Vec<Course>,
        drifts: bool,
    }

    impl Film {
        fn new(
            random: &mut Random,
            lost_before: Vec<Vec<usize>>,
            count: usize,
            drifts: bool,
        ) -> Self {
            let truth: Vec<Course> = lost_before
                .into_iter()
                .enumerate()
                .map(|(c, lost_before)| Course {
                    offset_s: if c == 0 { 0.0 } else { 0.9 * random.signed() * FRAME_S },
                    rate: if c == 0 || !drifts { 0.0 } else { 3e-4 * random.gaussian() },
                    lost_before,
                    ..Course::default()
                })
                .collect();
            let images = |c: &Course| count - c.lost_before.len();
            let times = |c: &Course| (0..images(c)).map(|n| n as f64 * FRAME_S).collect();
            Self { times_s: truth.iter().map(times).collect(), truth, drifts }
        }

        fn told(&self) -> Vec<Told<'_>> {
            (self.times_s.iter().enumerate())
                .map(|(c, times_s)| Told {
                    times_s,
                    frame_s: FRAME_S,
                    loses: true,
                    drifts: self.drifts && c != 0,
                })
                .collect()
        }

        /// With a share of them up to two frames off.
        fn sightings(&self, random: &mut Random, wrong: f64) -> Vec<Sighting> {
            let told = self.told();
            let all: Vec<Vec<f64>> =
                self.truth.iter().zip(&told).map(|(c, told)| c.times_s(told)).collect();
            let mut seen = Vec::new();
            for a in 0..all.len() {
                for b in (0..all.len()).filter(|b| *b != a && b.abs_diff(a) < 3) {
                    for k in 0..all[a].len() - 1 {
                        let (start, end) = (all[a][k], all[a][k + 1]);
                        let Some(m) = all[b].iter().position(|t| *t >= start && *t <= end) else {
                            continue;
                        };
                        let mistake = match random.unit() < wrong {
                            true => (4.0 * random.unit()).floor() - 2.0,
                            false => 0.0,
                        };
                        let share = (all[b][m] - start) / (end - start)
                            + mistake
                            + 0.02 * random.gaussian();
                        seen.push(Sighting { cameras: [a, b], images: [k, m], share });
                    }
                }
            }
            seen
        }

        fn found(&self, sightings: &[Sighting]) -> Vec<Option<Course>> {
            courses(&self.told(), 0, sightings)
        }
    }

    #[test]
    fn hundreds_of_films_with_mistakes_make_up_no_loss() {
        let random = &mut Random::new(8);
        for n in 0..300 {
            let cameras = 2 + n % 4;
            let film = Film::new(random, vec![Vec::new(); cameras], 8 + n % 40, n % 2 == 0);
            let sightings = film.sightings(random, 0.03);
            for (found, truth) in film.found(&sightings).into_iter().zip(&film.truth) {
                let found = found.unwrap();
                // With two cameras both of an end's sightings may be wrong alike.
                assert!(found.lost_before.is_empty() || found.doubtful, "{n}: {found:?}");
                let error = (found.offset_s - truth.offset_s) / FRAME_S;
                assert!(error.abs() < 0.1, "{n}: {error} frame");
            }
        }
    }

    /// The reference camera too; five frames apart, since what two cameras lose at once they don't see
    /// in each other.
    #[test]
    fn hundreds_of_films_show_what_every_camera_lost() {
        let random = &mut Random::new(9);
        let (mut lost_frames, mut doubtful) = (0, 0);
        for n in 0..300 {
            let (cameras, count) = (2 + n % 4, 16 + n % 30);
            let mut lost = vec![Vec::new(); cameras];
            for frame in (3..count - 4).step_by(5) {
                let c = (1.5 * cameras as f64 * random.unit()) as usize;
                if c < cameras {
                    let before = frame - lost[c].len();
                    lost[c].push(before);
                }
            }
            let film = Film::new(random, lost, count, n % 2 == 0);
            let sightings = film.sightings(random, 0.03);
            for (found, truth) in film.found(&sightings).into_iter().zip(&film.truth) {
                let found = found.unwrap();
                lost_frames += truth.lost_before.len();
                doubtful += usize::from(found.doubtful);
                let right = found.lost_before == truth.lost_before;
                assert!(right || found.doubtful, "{n}: {found:?}, {truth:?}");
            }
        }
        assert!(lost_frames > 500 && doubtful < 30, "{lost_frames} {doubtful}");
    }

    #[test]
    fn two_at_once_and_a_camera_that_saw_nothing() {
        let random = &mut Random::new(10);
        let film = Film::new(random, vec![vec![7, 7], vec![], vec![4]], 20, false);
        let mut sightings = film.sightings(random, 0.0);
        let lost = |found: &[Option<Course>]| -> Vec<Option<Vec<usize>>> {
            found.iter().map(|c| c.as_ref().map(|c| c.lost_before.clone())).collect()
        };
        let all = film.found(&sightings);
        assert_eq!(lost(&all), [Some(vec![7, 7]), Some(vec![]), Some(vec![4])]);
        sightings.retain(|s| s.cameras.iter().all(|c| *c < 2));
        assert_eq!(lost(&film.found(&sightings)), [Some(vec![7, 7]), Some(vec![]), None]);
        assert_eq!(film.found(&[]), [None, None, None]);
    }

    /// One sighting is too few to believe in a loss, two are enough; if one of these is half off, that
    /// is not enough, nor little enough to rule it out.
    #[test]
    fn what_few_images_say_leaves_a_course_in_doubt() {
        let times_s: Vec<f64> = (0..20).map(|n| f64::from(n) * FRAME_S).collect();
        let told = Told { times_s: &times_s, frame_s: FRAME_S, loses: false, drifts: false };
        let told = [told, Told { loses: true, ..told }];
        let found = |late: &[f64]| {
            let in_time = (0..10).map(|n| (n, 0.0));
            let late = (0..).zip(late).map(|(n, late)| (10 + n, *late));
            let seen = in_time.chain(late).map(|(n, late)| Sighting {
                cameras: [0, 1],
                images: [n, n],
                share: 0.3 + late,
            });
            courses(&told, 0, &seen.collect::<Vec<_>>())[1].clone().unwrap()
        };
        let none = |course: &Course| course.lost_before.is_empty() && !course.doubtful;
        assert!(none(&found(&[])) && none(&found(&[1.0])));
        assert!(found(&[1.0, 1.0 + 0.6 * BOUND]).doubtful);
        let sure = found(&[1.0, 1.0]);
        assert!(sure.lost_before == [10] && !sure.doubtful, "{sure:?}");
    }
}
