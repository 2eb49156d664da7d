//! The worker threads, which render the requested pictures.

use super::queue::{Answer, Asked, Job};
use super::{Level, LiveError, Queue, Studio};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::Scope;

/// Number of worker threads for quick requests.
const QUICK_WORKERS: usize = 2;
/// Increase of the niceness of the threads that render pictures of full quality. Quick pictures thus have priority.
const FULL_NICENESS: i32 = 5;
/// Maximum length of [`Ahead`], the list of answered requests for whose instants results are computed in advance.
const MAX_AHEAD: usize = 8;

/// Answered requests, oldest first. The cameras' images and depth maps at the instants of these requests are to be
/// computed in advance, so that views from other viewpoints at the same instants are rendered quickly.
type Ahead = VecDeque<Arc<Asked>>;

/// Starts the worker threads, which end when the queue is closed. Quick pictures and pictures of full quality have
/// separate threads, so that a quick picture never waits for one of full quality.
///
/// # Errors
/// If a thread can't be started.
pub(super) fn start<'scope, 'env>(
    scope: &'scope Scope<'scope, 'env>,
    studio: &'env Studio<'_>,
    queue: &'env Queue,
) -> std::io::Result<()> {
    for (is_quick, workers) in [(true, QUICK_WORKERS), (false, 1)] {
        let on_start = move |_| {
            if !is_quick {
                stand_back();
            }
        };
        let pool = ThreadPoolBuilder::new().start_handler(on_start).build();
        let pool = Arc::new(pool.map_err(std::io::Error::other)?);
        for _ in 0..workers {
            let pool = pool.clone();
            scope.spawn(move || work(studio, queue, is_quick, &pool));
        }
    }
    Ok(())
}

/// Lowers the scheduling priority of the calling thread.
#[cfg(target_os = "linux")]
fn stand_back() {
    // SAFETY: on Linux, process 0 is the calling thread, and no memory is accessed. If the change is refused,
    // the thread keeps its priority.
    unsafe {
        let own = libc::getpriority(libc::PRIO_PROCESS, 0);
        libc::setpriority(libc::PRIO_PROCESS, 0, own + FULL_NICENESS);
    }
}

#[cfg(not(target_os = "linux"))]
fn stand_back() {
    let _ = FULL_NICENESS;
}

fn work(studio: &Studio, queue: &Queue, is_quick: bool, pool: &ThreadPool) {
    let mut ahead = Ahead::new();
    loop {
        prepare(studio, queue, &mut ahead, pool);
        let Some(job) = queue.take(is_quick) else { return };
        let answer = answer(studio, &job, pool);
        let is_shown = answer.is_ok();
        let asked = job.answer(answer);
        let request = &asked.request;
        if is_shown && request.level == Level::Full && !request.viewer.is_empty() {
            // The viewer sees the picture now, and may look around from there.
            plan(&mut ahead, asked);
        }
    }
}

/// Appends the request `shown`, whose picture the viewer sees, to `ahead`. If there are then more than [`MAX_AHEAD`]
/// requests, removes the oldest.
fn plan(ahead: &mut Ahead, shown: Arc<Asked>) {
    ahead.push_back(shown);
    if ahead.len() > MAX_AHEAD {
        ahead.pop_front();
    }
}

/// Computes the cameras' images and depth maps at the instants of the requests in `ahead`, so that views from other
/// viewpoints at these instants are rendered quickly. Stops when a picture of full quality with another time or other
/// methods is requested.
fn prepare(studio: &Studio, queue: &Queue, ahead: &mut Ahead, pool: &ThreadPool) {
    while let Some(asked) = ahead.pop_front() {
        let is_free = || !queue.has_apart(&asked);
        let proceed = || asked.is_instant_wanted() && is_free();
        unwound(|| pool.install(|| studio.prepare(&asked.request, &proceed)));
        if asked.is_instant_wanted() && !is_free() {
            ahead.push_front(asked);
            return;
        }
    }
}

fn answer(studio: &Studio, job: &Job, pool: &ThreadPool) -> Answer {
    if !job.is_wanted() {
        return Err(LiveError::Superseded);
    }
    let picture = || pool.install(|| studio.picture(&job.asked.request, &|| job.is_wanted()));
    unwound(picture).unwrap_or(Err(LiveError::Panicked))
}

/// Calls a function, and returns its result. `None` if the function panics. The caches stay valid after a panic,
/// because they hold only complete values.
fn unwound<T>(of: impl FnOnce() -> T) -> Option<T> {
    catch_unwind(AssertUnwindSafe(of)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::PictureRequest;

    #[test]
    fn what_is_planned_is_bounded_and_the_oldest_is_forgotten() {
        let (queue, mut ahead) = (Queue::default(), Ahead::new());
        let ask = |viewer: usize, time_s: f64| {
            let query = format!("w=64&h=48&viewer=v{viewer}&t={time_s}");
            queue.submit(PictureRequest::parse(&query).unwrap()).unwrap()
        };
        let mut asked_of = Vec::new();
        for viewer in 0..=MAX_AHEAD {
            let _receiver = ask(viewer, 0.0);
            let job = queue.take(false).unwrap();
            let asked = job.answer(Err(LiveError::Superseded));
            asked_of.push(Arc::downgrade(&asked));
            plan(&mut ahead, asked);
        }
        let viewers: Vec<&str> = ahead.iter().map(|a| a.request.viewer.as_str()).collect();
        assert_eq!((viewers.len(), viewers[0]), (MAX_AHEAD, "v1."));
        let running = asked_of.iter().filter(|asked| asked.strong_count() > 0);
        assert_eq!(running.count(), MAX_AHEAD);
    }
}
