//! The threads that answer requests.

use super::queue::{Answer, Job, Lane, Stale};
use super::{Level, LiveError, PictureRequest, Queue, Studio};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::Scope;

/// Number of threads for quick requests.
const QUICK_WORKERS: usize = 2;
/// Niceness of threads for full quality, so that quick pictures have priority.
const FULL_NICENESS: i32 = 5;
/// Largest number of instants that wait to be prepared.
const MAX_AHEAD: usize = 8;

/// Requests whose instants are to be prepared in advance.
type Ahead = VecDeque<(PictureRequest, Arc<Stale>)>;

/// Starts the threads, which end when the queue is closed. Quick and full pictures have threads of their own, so
/// that what is quick never waits in a full picture's line.
///
/// # Errors
/// If the system gives no threads.
pub(super) fn start<'scope, 'env>(
    scope: &'scope Scope<'scope, 'env>,
    studio: &'env Studio<'_>,
    queue: &'env Queue,
) -> std::io::Result<()> {
    for (lane, workers) in [(Lane::Quick, QUICK_WORKERS), (Lane::Full, 1)] {
        let pool = Arc::new(pool(lane)?);
        for _ in 0..workers {
            let pool = pool.clone();
            scope.spawn(move || work(studio, queue, lane, &pool));
        }
    }
    Ok(())
}

fn pool(lane: Lane) -> std::io::Result<ThreadPool> {
    let builder = ThreadPoolBuilder::new().start_handler(move |_| {
        if lane == Lane::Full {
            stand_back();
        }
    });
    builder.build().map_err(std::io::Error::other)
}

/// Lowers the priority of the calling thread.
#[cfg(target_os = "linux")]
fn stand_back() {
    // SAFETY: on Linux, process 0 is the calling thread; no memory is involved. If it is refused, the thread
    // keeps its priority.
    unsafe {
        let own = libc::getpriority(libc::PRIO_PROCESS, 0);
        libc::setpriority(libc::PRIO_PROCESS, 0, own + FULL_NICENESS);
    }
}

#[cfg(not(target_os = "linux"))]
fn stand_back() {
    let _ = FULL_NICENESS;
}

fn work(studio: &Studio, queue: &Queue, lane: Lane, pool: &ThreadPool) {
    let mut ahead = Ahead::new();
    loop {
        prepare(studio, queue, &mut ahead, pool);
        let Some(job) = queue.take(lane) else { return };
        let request = job.request.clone();
        let answer = answer(studio, &job, pool);
        let is_shown = answer.is_ok() && request.level == Level::Full && !request.viewer.is_empty();
        let stale = queue.answer(job, answer);
        if is_shown {
            // The viewer looks at the picture now, and may look around from there.
            plan(queue, &mut ahead, (request, stale));
        } else {
            queue.finish(&stale);
        }
    }
}

/// Appends a request; the oldest is dropped beyond [`MAX_AHEAD`].
fn plan(queue: &Queue, ahead: &mut Ahead, shown: (PictureRequest, Arc<Stale>)) {
    ahead.push_back(shown);
    if ahead.len() > MAX_AHEAD
        && let Some((_, oldest)) = ahead.pop_front()
    {
        queue.finish(&oldest);
    }
}

/// Prepares the viewers' instants until a full picture of another instant is requested.
fn prepare(studio: &Studio, queue: &Queue, ahead: &mut Ahead, pool: &ThreadPool) {
    while let Some((request, stale)) = ahead.pop_front() {
        let is_free = || !queue.has_apart(Lane::Full, &request);
        let proceed = || stale.is_instant_wanted() && is_free();
        unwound(|| pool.install(|| studio.prepare(&request, &proceed)));
        if stale.is_instant_wanted() && !is_free() {
            ahead.push_front((request, stale));
            return;
        }
        queue.finish(&stale);
    }
}

fn answer(studio: &Studio, job: &Job, pool: &ThreadPool) -> Answer {
    if !job.is_wanted() {
        return Err(LiveError::Superseded);
    }
    let picture = || pool.install(|| studio.picture(&job.request, &|| job.is_wanted()));
    unwound(picture).unwrap_or(Err(LiveError::Panicked))
}

/// The result, `None` after a panic. Caches hold complete values only, so that a panic can't damage them.
fn unwound<T>(of: impl FnOnce() -> T) -> Option<T> {
    catch_unwind(AssertUnwindSafe(of)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_planned_is_bounded_and_the_oldest_is_forgotten() {
        let (queue, mut ahead) = (Queue::default(), Ahead::new());
        let ask = |viewer: usize, time_s: f64| {
            let query = format!("w=64&h=48&viewer=v{viewer}&t={time_s}");
            queue.submit(PictureRequest::parse(&query).unwrap()).unwrap()
        };
        for viewer in 0..=MAX_AHEAD {
            let _receiver = ask(viewer, 0.0);
            let job = queue.take(Lane::Full).unwrap();
            let request = job.request.clone();
            let stale = queue.answer(job, Err(LiveError::Superseded));
            plan(&queue, &mut ahead, (request, stale.clone()));
        }
        let viewers: Vec<&str> = ahead.iter().map(|(r, _)| r.viewer.as_str()).collect();
        assert_eq!((viewers.len(), viewers[0]), (MAX_AHEAD, "v1."));
        assert_eq!(queue.running(), MAX_AHEAD);
    }
}
