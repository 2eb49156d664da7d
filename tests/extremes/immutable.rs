//! A light field doesn't change: a view is a function of what was asked for. Views with different
//! options, asked of one light field in any order and from several threads, equal those of light
//! fields that were asked for nothing else, to the bit.

use crate::common::wall::{FRAME_S, Scene, by_plane, by_proxy, estimate, field_of, open, view};
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::capture::Capture;
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::{Context, LightField, Request, Viewpoint, render};
use stlfr::method::Method;
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};

/// How many threads ask one light field at once, each in an order of its own.
const THREADS: usize = 4;

/// One view of the capture.
struct Question {
    what: &'static str,
    target: Target,
    time_s: f64,
    options: RenderOptions,
}

enum Target {
    /// A view from anywhere.
    Free(Camera),
    /// A filming camera's own image.
    Filmed(usize),
}

impl Question {
    /// The bits of the image's values, and which pixels are covered.
    fn answer(&self, field: &LightField) -> (Vec<u32>, Vec<bool>) {
        let viewpoint = match &self.target {
            Target::Free(camera) => Viewpoint::View(camera),
            Target::Filmed(camera) => Viewpoint::Like(*camera),
        };
        let seen = render(
            field,
            &Request::new(viewpoint, self.time_s, &self.options),
            &Context::unattended(),
        )
        .unwrap();
        (seen.image.data().iter().map(|v| v.to_bits()).collect(), seen.coverage)
    }
}

type Change = fn(&mut RenderOptions);

/// Two values of each option that a cached value could depend on, and of place and time.
fn requests(scene: &Scene) -> Vec<Question> {
    let free = |place_m| Target::Free(view(&scene.camera(place_m)));
    let (place_m, time_s) = ([0.021, 0.007, 0.1], 1.6 * FRAME_S);
    let mut requests = Vec::new();
    let mut of = |what, target, time_s, options| {
        requests.push(Question { what, target, time_s, options });
    };
    let defaults = RenderOptions::default;
    for &method in ProxyMethod::ALL {
        of(method.name(), free(place_m), time_s, by_proxy(method));
        let changes: [(&str, Change); 3] = [
            ("other cameras", |o| o.proxy.cameras = 1),
            ("other partners", |o| o.proxy.partners = 1),
            ("no still pairs", |o| o.interpolation.still_change = 1.0),
        ];
        for (what, change) in changes {
            let mut options = by_proxy(method);
            change(&mut options);
            of(what, free(place_m), time_s, options);
        }
    }
    of("another place", free([-0.02, 0.0, 0.0]), time_s, defaults());
    of("another time", free(place_m), 2.3 * FRAME_S, defaults());
    of("a set depth", free(place_m), time_s, by_plane(1.5));
    let mut blended = defaults();
    blended.blend.cameras = 1;
    of("one camera blended", free(place_m), time_s, blended);
    for &sync in SyncMethod::ALL {
        of(sync.name(), Target::Filmed(1), time_s, defaults().with_sync(sync));
    }
    let mut still = defaults();
    still.interpolation.still_change = 1.0;
    of("a still pair", Target::Filmed(1), time_s, still);
    let mut trail = defaults();
    (trail.trail.duration_s, trail.trail.instants) = (1.2 * FRAME_S, 3);
    of("a trail", Target::Filmed(1), 2.9 * FRAME_S, trail);
    requests
}

fn fresh(capture: &Arc<Capture>, offsets: &Offsets) -> LightField {
    field_of(capture, offsets.clone())
}

#[test]
fn views_are_those_of_light_fields_of_their_own() {
    let scene = Scene { board: Some([-1.5, -0.8]), ..Scene::default() };
    let folder = scene.film();
    let capture = open(&folder);
    let offsets = estimate(&capture);
    let requests = requests(&scene);
    let expected: Vec<_> = requests.iter().map(|r| r.answer(&fresh(&capture, &offsets))).collect();
    // The options matter, so that a cache whose key lacks one of them would show.
    for (k, a) in requests.iter().enumerate() {
        for (j, b) in requests.iter().enumerate().take(k) {
            let alike = (b.what, a.what) == ("crossfade", "a still pair");
            assert_eq!(expected[k] == expected[j], alike, "{} and {}", b.what, a.what);
        }
    }

    let shared = fresh(&capture, &offsets);
    std::thread::scope(|scope| {
        for thread in 0..THREADS {
            let (requests, expected, shared) = (&requests, &expected, &shared);
            scope.spawn(move || {
                let count = requests.len();
                for n in 0..count {
                    // All of them, from another start in every thread, forwards or backwards.
                    let n = n + thread * count / THREADS;
                    let k = if thread % 2 == 0 { n % count } else { count - 1 - n % count };
                    let what = requests[k].what;
                    assert!(requests[k].answer(shared) == expected[k], "{what}, thread {thread}");
                }
            });
        }
    });
}
