//! The queue of picture requests. It holds only the latest request of each viewer.

use super::{Level, LiveError, Picture, PictureRequest};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use tokio::sync::oneshot;

/// Maximum number of requests that wait in the queue.
const MAX_WAITING: usize = 32;

/// Answer to a request: a picture, or the reason why the picture can't be rendered.
pub(super) type Answer = Result<Picture, LiveError>;

/// A request for a picture, with flags that are set when a later request of the same viewer replaces the request.
pub(super) struct Asked {
    pub request: PictureRequest,
    is_outdated: AtomicBool,
    /// Whether a later request of the same viewer has another time or other methods than this request. False if only
    /// the viewpoint differs, or if there is no later request.
    is_instant_outdated: AtomicBool,
}

/// A request, and the channel to which its answer is sent.
pub(super) struct Job {
    pub asked: Arc<Asked>,
    reply: oneshot::Sender<Answer>,
}

impl Asked {
    /// Returns whether the viewer still looks at the time of this request, rendered with the methods of this request.
    /// The viewpoint may have changed.
    pub fn is_instant_wanted(&self) -> bool {
        !self.is_instant_outdated.load(Ordering::Relaxed)
    }

    /// Returns whether the request `other` has another time or other methods than this request.
    fn differs(&self, other: &PictureRequest) -> bool {
        let of = |r: &PictureRequest| (r.time_s, r.method, r.sync, r.proxy);
        of(&self.request) != of(other)
    }

    /// Returns whether a later request of `viewer` replaces this request. A request to save a picture is never
    /// replaced.
    fn is_replaceable_by(&self, viewer: &str) -> bool {
        self.request.level != Level::Saved && self.request.viewer == viewer
    }
}

impl Job {
    /// Returns whether the viewer still waits for the picture of this request.
    pub fn is_wanted(&self) -> bool {
        !self.asked.is_outdated.load(Ordering::Relaxed) && !self.reply.is_closed()
    }

    /// Sends the answer, and returns the request. As long as the returned value exists, the request counts as running,
    /// and a later request can mark it as replaced.
    pub fn answer(self, answer: Answer) -> Arc<Asked> {
        // An error means that the viewer has disconnected.
        let _ = self.reply.send(answer);
        self.asked
    }
}

/// Waiting requests in order of arrival, and running requests.
#[derive(Default)]
pub(super) struct Queue {
    state: Mutex<QueueState>,
    changed: Condvar,
}

#[derive(Default)]
struct QueueState {
    waiting: VecDeque<Job>,
    running: Vec<Weak<Asked>>,
    is_closed: bool,
}

impl Queue {
    /// Adds a request, which replaces the earlier request of the same viewer. If the earlier request is waiting, it is
    /// removed, and its receiver is closed. If it is running, it is marked, so that rendering stops. A request to save
    /// a picture replaces no other request.
    ///
    /// Returns the receiver of the answer.
    ///
    /// # Errors
    /// [`LiveError::Busy`] if [`MAX_WAITING`] requests are waiting.
    pub fn submit(&self, request: PictureRequest) -> Result<oneshot::Receiver<Answer>, LiveError> {
        let (reply, receiver) = oneshot::channel();
        let mut state = self.lock();
        let replaces = request.level != Level::Saved && !request.viewer.is_empty();
        let is_replaced = |asked: &Asked| replaces && asked.is_replaceable_by(&request.viewer);
        state.waiting.retain(Job::is_wanted);
        // This is checked before any request is replaced, so that a refused viewer still gets the picture that is being
        // rendered.
        if state.waiting.iter().filter(|job| !is_replaced(&job.asked)).count() >= MAX_WAITING {
            return Err(LiveError::Busy);
        }
        state.waiting.retain(|job| !is_replaced(&job.asked));
        for asked in state.running.iter().filter_map(Weak::upgrade).filter(|a| is_replaced(a)) {
            asked.is_outdated.store(true, Ordering::Relaxed);
            if asked.differs(&request) {
                asked.is_instant_outdated.store(true, Ordering::Relaxed);
            }
        }
        let [is_outdated, is_instant_outdated] = Default::default();
        let asked = Arc::new(Asked { request, is_outdated, is_instant_outdated });
        state.waiting.push_back(Job { asked, reply });
        drop(state);
        self.changed.notify_all();
        Ok(receiver)
    }

    /// Waits for the next request, and removes it from the queue. If `is_quick` is true, it is a request for a quick
    /// picture, otherwise for a picture of full quality. Each kind has its own worker threads, so that quick requests
    /// never wait for slow requests. `None` after the queue is closed.
    pub fn take(&self, is_quick: bool) -> Option<Job> {
        let mut state = self.lock();
        loop {
            if state.is_closed {
                return None;
            }
            let next = state.waiting.iter().position(|j| j.asked.request.is_quick() == is_quick);
            if let Some(job) = next.and_then(|at| state.waiting.remove(at)) {
                state.running.retain(|asked| asked.strong_count() > 0);
                state.running.push(Arc::downgrade(&job.asked));
                return Some(job);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Returns whether a request for a picture of full quality is waiting that has another time or other methods than
    /// `asked`.
    pub fn has_apart(&self, asked: &Asked) -> bool {
        let mut state = self.lock();
        state.waiting.retain(Job::is_wanted);
        let mut waiting = state.waiting.iter().map(|job| &job.asked.request);
        waiting.any(|other| !other.is_quick() && asked.differs(other))
    }

    /// Closes the queue. All workers end after their current requests.
    pub fn close(&self) {
        self.lock().is_closed = true;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, QueueState> {
        // A poisoned lock can be used, because no operation on the state can panic halfway.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::oneshot::error::TryRecvError;

    fn request(viewer: &str, level: &str) -> PictureRequest {
        PictureRequest::parse(&format!("w=64&h=48&viewer={viewer}&level={level}")).unwrap()
    }

    #[test]
    fn a_viewers_latest_request_takes_the_place_of_all_before() {
        let queue = Queue::default();
        let mut first = queue.submit(request("a", "quick")).unwrap();
        let _other = queue.submit(request("b", "quick")).unwrap();
        let mut second = queue.submit(request("a", "full")).unwrap();
        assert!(matches!(first.try_recv(), Err(TryRecvError::Closed)));
        let job = queue.take(false).unwrap();
        assert!(job.is_wanted());
        let _third = queue.submit(request("a", "quick")).unwrap();
        assert!(!job.is_wanted(), "a newer one came while it was worked on");
        let asked = job.answer(Err(LiveError::Superseded));
        assert!(second.try_recv().is_ok());
        assert!(asked.is_instant_wanted(), "it is of the same time and method");
        let later = PictureRequest { time_s: 1.0, ..request("a", "quick") };
        let _third = queue.submit(later).unwrap();
        assert!(!asked.is_instant_wanted());
        drop(asked);
        assert_eq!(queue.take(true).unwrap().asked.request.viewer, "b.");
        assert_eq!(queue.take(true).unwrap().asked.request.viewer, "a.");
    }

    #[test]
    fn what_is_saved_is_stopped_by_nobody_but_who_asked() {
        let queue = Queue::default();
        let saved = queue.submit(request("a", "saved")).unwrap();
        let _next = queue.submit(request("a", "quick")).unwrap();
        let job = queue.take(false).unwrap();
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
        assert!(matches!(waiting[0].try_recv(), Err(TryRecvError::Closed)));
        waiting.pop();
        assert!(ask(MAX_WAITING).is_ok(), "one who has gone makes room");
        queue.close();
        assert!(queue.take(true).is_none());
    }

    #[test]
    fn who_is_refused_keeps_the_picture_that_is_worked_on() {
        let queue = Queue::default();
        let _first = queue.submit(request("a", "full")).unwrap();
        let job = queue.take(false).unwrap();
        let ask = |k: usize| queue.submit(request(&format!("v{k}"), "quick")).unwrap();
        let mut waiting: Vec<_> = (0..MAX_WAITING).map(ask).collect();
        assert!(matches!(queue.submit(request("a", "quick")), Err(LiveError::Busy)));
        assert!(job.is_wanted());
        waiting.pop();
        let _second = queue.submit(request("a", "quick")).unwrap();
        assert!(!job.is_wanted());
    }
}
