//! The queue of requests, which keeps only the latest of each viewer.

use super::{Level, LiveError, Picture, PictureRequest};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use tokio::sync::oneshot;

/// Largest number of waiting requests.
const MAX_WAITING: usize = 32;

/// A picture, or why it can't be made.
pub type Answer = Result<Picture, LiveError>;

/// A request that a worker has taken.
pub(super) struct Job {
    pub request: PictureRequest,
    reply: oneshot::Sender<Answer>,
    stale: Arc<Stale>,
}

/// Which parts of a request are outdated by its viewer's next one.
#[derive(Default)]
pub(super) struct Stale {
    picture: AtomicBool,
    /// Whether the time or the method is outdated, not only the viewpoint.
    instant: AtomicBool,
}

impl Stale {
    /// Whether the viewer is still at the instant, from any viewpoint.
    pub fn is_instant_wanted(&self) -> bool {
        !self.instant.load(Ordering::Relaxed)
    }
}

impl Job {
    /// Whether a viewer still waits for the picture.
    pub fn is_wanted(&self) -> bool {
        !self.stale.picture.load(Ordering::Relaxed) && !self.reply.is_closed()
    }

    fn is_of(&self, viewer: &str) -> bool {
        self.request.level != Level::Saved && self.request.viewer == viewer
    }
}

/// Waiting requests in order of arrival, and running ones.
#[derive(Default)]
pub struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    waiting: VecDeque<Job>,
    running: Vec<(PictureRequest, Arc<Stale>)>,
    is_closed: bool,
}

/// A kind of requests with its own workers, so that quick ones never wait for slow ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lane {
    Quick,
    Full,
}

impl Lane {
    fn of(level: Level) -> Self {
        match level {
            Level::Quick => Self::Quick,
            Level::Full | Level::Saved => Self::Full,
        }
    }
}

impl Queue {
    /// Replaces the viewer's earlier request: a waiting one is answered with [`LiveError::Superseded`], a running
    /// one is stopped. A request to save replaces none.
    ///
    /// # Errors
    /// [`LiveError::Busy`] if too many wait.
    pub fn submit(&self, request: PictureRequest) -> Result<oneshot::Receiver<Answer>, LiveError> {
        let (reply, receiver) = oneshot::channel();
        let mut state = self.lock();
        state.waiting.retain(Job::is_wanted);
        let overtakes = request.level != Level::Saved && !request.viewer.is_empty();
        let stays = |job: &&Job| !(overtakes && job.is_of(&request.viewer));
        // Whoever is refused keeps the picture that is worked on.
        if state.waiting.iter().filter(stays).count() >= MAX_WAITING {
            return Err(LiveError::Busy);
        }
        if overtakes {
            state.overtake(&request);
        }
        state.waiting.push_back(Job { request, reply, stale: Arc::default() });
        drop(state);
        self.changed.notify_all();
        Ok(receiver)
    }

    /// Waits for the next request of a lane. `None` once the queue is closed.
    pub(super) fn take(&self, lane: Lane) -> Option<Job> {
        let mut state = self.lock();
        loop {
            if state.is_closed {
                return None;
            }
            let next = state.waiting.iter().position(|j| Lane::of(j.request.level) == lane);
            if let Some(job) = next.and_then(|at| state.waiting.remove(at)) {
                state.running.push((job.request.clone(), job.stale.clone()));
                return Some(job);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Answers a running request. The worker may continue with its instant, until [`Self::finish`].
    pub(super) fn answer(&self, job: Job, answer: Answer) -> Arc<Stale> {
        // Whoever waited may have gone.
        let _ = job.reply.send(answer);
        job.stale
    }

    /// Removes a running request.
    pub(super) fn finish(&self, stale: &Arc<Stale>) {
        self.lock().running.retain(|(_, other)| !Arc::ptr_eq(other, stale));
    }

    /// Whether a request with another instant or method waits in a lane.
    pub(super) fn has_apart(&self, lane: Lane, own: &PictureRequest) -> bool {
        let is_apart = |r: &PictureRequest| (r.time_s, r.method) != (own.time_s, own.method);
        let mut state = self.lock();
        state.waiting.retain(Job::is_wanted);
        state.waiting.iter().any(|j| Lane::of(j.request.level) == lane && is_apart(&j.request))
    }

    /// Number of running requests.
    #[cfg(test)]
    pub(super) fn running(&self) -> usize {
        self.lock().running.len()
    }

    /// Ends all workers after their current requests.
    pub fn close(&self) {
        self.lock().is_closed = true;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // No operation panics half-way.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Drops the viewer's waiting request, and marks the running one as outdated.
    fn overtake(&mut self, next: &PictureRequest) {
        while let Some(at) = self.waiting.iter().position(|job| job.is_of(&next.viewer)) {
            if let Some(job) = self.waiting.remove(at) {
                // Whoever waited may have gone.
                let _ = job.reply.send(Err(LiveError::Superseded));
            }
        }
        let is_older = |r: &PictureRequest| r.level != Level::Saved && r.viewer == next.viewer;
        for (request, stale) in self.running.iter().filter(|(request, _)| is_older(request)) {
            stale.picture.store(true, Ordering::Relaxed);
            if (request.time_s, request.method) != (next.time_s, next.method) {
                stale.instant.store(true, Ordering::Relaxed);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(viewer: &str, level: &str) -> PictureRequest {
        PictureRequest::parse(&format!("w=64&h=48&viewer={viewer}&level={level}")).unwrap()
    }

    #[test]
    fn a_viewers_latest_request_takes_the_place_of_all_before() {
        let queue = Queue::default();
        let mut first = queue.submit(request("a", "quick")).unwrap();
        let _other = queue.submit(request("b", "quick")).unwrap();
        let mut second = queue.submit(request("a", "full")).unwrap();
        assert!(matches!(first.try_recv(), Ok(Err(LiveError::Superseded))));
        let job = queue.take(Lane::Full).unwrap();
        assert!(job.is_wanted());
        let _third = queue.submit(request("a", "quick")).unwrap();
        assert!(!job.is_wanted(), "a newer one came while it was worked on");
        let stale = queue.answer(job, Err(LiveError::Superseded));
        assert!(second.try_recv().is_ok());
        assert!(stale.is_instant_wanted(), "it is of the same time and method");
        let later = PictureRequest { time_s: 1.0, ..request("a", "quick") };
        let _third = queue.submit(later).unwrap();
        assert!(!stale.is_instant_wanted());
        queue.finish(&stale);
        assert_eq!(queue.take(Lane::Quick).unwrap().request.viewer, "b.");
        assert_eq!(queue.take(Lane::Quick).unwrap().request.viewer, "a.");
    }

    #[test]
    fn what_is_saved_is_stopped_by_nobody_but_who_asked() {
        let queue = Queue::default();
        let saved = queue.submit(request("a", "saved")).unwrap();
        let _next = queue.submit(request("a", "quick")).unwrap();
        let job = queue.take(Lane::Full).unwrap();
        let _after = queue.submit(request("a", "full")).unwrap();
        assert!(job.is_wanted());
        drop(saved);
        assert!(!job.is_wanted(), "nobody waits for it");
    }

    #[test]
    fn there_are_not_more_than_can_be_answered() {
        let queue = Queue::default();
        let ask = |k: usize| queue.submit(request(&format!("v{k}"), "quick"));
        let mut waiting: Vec<_> = (0..MAX_WAITING).map(|k| ask(k).unwrap()).collect();
        assert!(matches!(ask(MAX_WAITING), Err(LiveError::Busy)));
        assert!(ask(0).is_ok(), "a newer request takes no more room than the older");
        assert!(matches!(waiting[0].try_recv(), Ok(Err(LiveError::Superseded))));
        waiting.pop();
        assert!(ask(MAX_WAITING).is_ok(), "one who has gone makes room");
        queue.close();
        assert!(queue.take(Lane::Quick).is_none());
    }

    #[test]
    fn who_is_refused_keeps_the_picture_that_is_worked_on() {
        let queue = Queue::default();
        let _first = queue.submit(request("a", "full")).unwrap();
        let job = queue.take(Lane::Full).unwrap();
        let ask = |k: usize| queue.submit(request(&format!("v{k}"), "quick")).unwrap();
        let mut waiting: Vec<_> = (0..MAX_WAITING).map(ask).collect();
        assert!(matches!(queue.submit(request("a", "quick")), Err(LiveError::Busy)));
        assert!(job.is_wanted());
        waiting.pop();
        let _second = queue.submit(request("a", "quick")).unwrap();
        assert!(!job.is_wanted());
    }
}
