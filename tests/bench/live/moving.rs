//! A viewpoint that stands still and instants that move: views of a capture that is prepared, and of one that is not.

use super::{median, middle_s, peer};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use stlfr::camera::Camera;
use stlfr::capture::Capture;
use stlfr::host::DiskCache;
use stlfr::light_field::{LightField, PREPARED};
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};

/// One that may come from another thread.
type Error = Box<dyn std::error::Error + Send + Sync>;

/// Instants that are timed: spread over two frame intervals, so that three of the cameras' frames take turns.
const INSTANTS: usize = 24;
/// The same for views that take seconds.
const SLOW_INSTANTS: usize = 4;

fn delete_prepared(folder: &Path) -> Result<(), Error> {
    let cache = DiskCache::new(folder, |_| ());
    for kind in PREPARED {
        cache.delete(Some(kind))?;
    }
    Ok(())
}

/// The capture opened anew, with nothing in memory.
fn opened(folder: &str) -> Result<LightField, Error> {
    let capture = Arc::new(Capture::open(folder.as_ref())?);
    // Clocks as recorded: times don't depend on how right they are.
    let mut offsets = Offsets::known(&capture);
    offsets.cameras.iter_mut().for_each(|c| c.offset_s = Some(c.offset_s.unwrap_or(0.0)));
    Ok(LightField::new(capture, offsets))
}

/// Milliseconds.
fn timed<T>(f: impl FnOnce() -> Result<T, Error>) -> Result<(f64, T), Error> {
    let start = Instant::now();
    let value = f()?;
    Ok((1000.0 * start.elapsed().as_secs_f64(), value))
}

fn threads(count: usize) -> Result<ThreadPool, Error> {
    Ok(ThreadPoolBuilder::new().num_threads(count).build()?)
}

/// One method's views of a capture that is prepared.
struct Scrub<'a> {
    field: &'a LightField,
    view: &'a Camera,
    options: &'a RenderOptions,
}

impl Scrub<'_> {
    /// The median of a view at instants whose frames were used before, milliseconds.
    fn view_ms(&self) -> Result<f64, Error> {
        let (capture, options) = (self.field.capture(), self.options);
        let clock = &capture.cameras[capture.reference].clock.times_s;
        let (middle_s, interval_s) = (middle_s(capture), clock[1] - clock[0]);
        let is_slow = options.proxy.method == ProxyMethod::Depth;
        let count = if is_slow { SLOW_INSTANTS } else { INSTANTS };
        let times = |shift: f64| {
            (0..count).map(move |k| {
                middle_s + interval_s * (2.0 * (k as f64 + shift) / count as f64 - 1.0)
            })
        };
        for time_s in times(0.25) {
            self.field.view(self.view, time_s, options)?;
        }
        let of = |time_s| Ok(timed(|| Ok(self.field.view(self.view, time_s, options)?))?.0);
        Ok(median(times(0.5).map(of).collect::<Result<_, Error>>()?))
    }
}

/// The table of all methods.
pub fn bench(
    folder: &str,
    view: &Camera,
    methods: &[(&'static str, RenderOptions)],
) -> Result<(), Error> {
    if Path::new(folder).join(".stlfr/cache/tracks").exists() {
        return Err("is prepared, which this benchmark would delete: copy the capture".into());
    }
    println!(
        "| method | unprepared: first view | prepared: first view | a view | views a second | one thread |"
    );
    println!("|---|---|---|---|---|---|");
    for (name, options) in methods {
        delete_prepared(Path::new(folder))?;
        let first = || {
            timed(|| {
                let field = opened(folder)?;
                field.view(view, middle_s(field.capture()), options)?;
                Ok(field)
            })
        };
        let (cold_ms, field) = first()?;
        field.prepare(options, |_| ())?;
        drop(field);
        let (first_ms, field) = first()?;
        let scrub = Scrub { field: &field, view, options };
        let [one_ms, view_ms] =
            [1, 2].map(|n| threads(n).and_then(|p| p.install(|| scrub.view_ms())));
        let (one_ms, view_ms) = (one_ms?, view_ms?);
        println!(
            "| {name} | {cold_ms:.0} ms | {first_ms:.0} ms | {view_ms:.1} ms | {:.1} | {:.2} of the speed |",
            1000.0 / view_ms,
            view_ms / one_ms
        );
    }
    preparation(folder, &methods[methods.len() - 1].1)
}

/// What the preparation of all pairs takes, beside DIS in both directions.
fn preparation(folder: &str, options: &RenderOptions) -> Result<(), Error> {
    delete_prepared(Path::new(folder))?;
    let field = opened(folder)?;
    let mut took = Vec::new();
    for count in [1, 2] {
        delete_prepared(Path::new(folder))?;
        let field = opened(folder)?;
        let prepare = || timed(|| Ok(field.prepare(options, |_| ())?));
        took.push(threads(count)?.install(prepare)?);
    }
    let (ms, prepared) = took[1];
    println!(
        "Preparation: {} pairs, {} maps, {:.1} s on two threads, {:.1} s on one, {:.1} MB",
        prepared.pairs,
        prepared.maps,
        1e-3 * ms,
        1e-3 * took[0].0,
        1e-6 * prepared.bytes as f64
    );
    delete_prepared(Path::new(folder))?;
    if let Some(seconds) = peer::dis_s(field.capture()).map_err(|e| e.to_string())? {
        println!("OpenCV's DIS, medium, of the same pairs in both directions: {seconds:.1} s");
    }
    Ok(())
}
