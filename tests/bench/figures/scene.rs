//! A filmed scene: its light field, and the truth beside it.

use crate::Error;
use crate::draw::Part;
use crate::rig::{self, Purpose};
use nalgebra::Point2;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::capture::{Capture, Truth, TruthView, read_array};
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::LightField;
use stlfr::lumigraph::DepthMap;
use stlfr::metrics::moving_part;
use stlfr::offset::{Offsets, estimate};
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::progress::Reporter;
use stlfr::raster::{Image, read_image};
use stlfr::registration::{FrameStore, RegistrationOptions};
use stlfr::toolchain::{FilmOptions, FilmedScene as Source, ensure_environment, film};

/// The filmed size, pixels, and frames a camera.
const SIZE_PX: (u32, u32) = (640, 480);
const FRAMES: u32 = 9;

/// Where the offsets come from.
#[derive(Clone, Copy, PartialEq)]
pub enum Clocks {
    True,
    Estimated,
}

/// A scene's light field and its truth.
pub struct Scene {
    pub field: LightField,
    pub capture: Arc<Capture>,
    pub truth: Truth,
    /// The instants with truth, seconds from the capture's start.
    pub instants_s: Vec<f64>,
}

/// A true view.
pub struct TrueView {
    pub camera: Camera,
    pub image: Image,
    pub depth: DepthMap,
    pub moving: Vec<bool>,
}

impl TrueView {
    /// Depth of what moves, metres: what the plane is focused on.
    pub fn focus_m(&self) -> f64 {
        let moving = self.depth.data().iter().zip(&self.moving).filter(|(_, moves)| **moves);
        let mut depths: Vec<f32> = moving.map(|(z, _)| *z).filter(|z| z.is_finite()).collect();
        depths.sort_by(f32::total_cmp);
        // The dilated part holds some background, which is farther.
        depths.get(depths.len() / 3).map_or(2.0, |z| f64::from(*z))
    }

    /// PSNR of an image's pixels that count, dB.
    fn psnr_db(&self, image: &Image, counts: impl Fn(bool) -> bool) -> f64 {
        let pixels = image.data().chunks(3).zip(self.image.data().chunks(3)).zip(&self.moving);
        let (mut sum, mut n) = (0.0, 0.0);
        for ((a, b), _) in pixels.filter(|(_, moves)| counts(**moves)) {
            sum += a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            n += 3.0;
        }
        -10.0 * (sum / f64::max(n, 1.0)).log10()
    }

    /// How good the moving part of an image is, in words.
    pub fn score(&self, image: &Image) -> String {
        format!("moving part {:.1} dB", self.psnr_db(image, |moves| moves))
    }

    /// The same of the whole image and of its moving part.
    pub fn both_scores(&self, image: &Image) -> String {
        format!("whole {:.1} dB, {}", self.psnr_db(image, |_| true), self.score(image))
    }

    /// The part of a size at the upper end of what moves.
    pub fn top_of_moving(&self, [width, height]: [usize; 2]) -> Part {
        /// Above what moves.
        const MARGIN_PX: usize = 20;
        let (w, h) = (self.image.width(), self.image.height());
        let moving = || self.moving.iter().enumerate().filter(|(_, m)| **m).map(|(k, _)| k);
        let top = moving().next().map_or(0, |k| k / w);
        let mut columns: Vec<usize> =
            moving().take_while(|k| k / w < top + height).map(|k| k % w).collect();
        columns.sort_unstable();
        let middle = columns.get(columns.len() / 2).copied().unwrap_or(w / 2);
        let left = middle.saturating_sub(width / 2).min(w - width);
        Part([left, top.saturating_sub(MARGIN_PX).min(h - height), width, height])
    }

    /// The part of a size in whose middle lies what moves.
    pub fn around_moving(&self, [width, height]: [usize; 2]) -> Part {
        let (w, h) = (self.image.width(), self.image.height());
        let moving = || self.moving.iter().enumerate().filter(|(_, m)| **m).map(|(k, _)| k);
        let start = |of: &dyn Fn(usize) -> usize, size: usize, room: usize| {
            let low = moving().map(of).min().unwrap_or(0);
            let high = moving().map(of).max().unwrap_or(room);
            ((low + high) / 2).saturating_sub(size / 2).min(room - size)
        };
        Part([start(&|k| k % w, width, w), start(&|k| k / w, height, h), width, height])
    }
}

impl Scene {
    /// The scene of that name, filmed if it is not there yet.
    pub fn open(
        name: &str,
        clocks: Clocks,
        registration: &RegistrationOptions,
    ) -> Result<Self, Error> {
        let folder = filmed(name)?;
        let capture = Arc::new(Capture::open(&folder)?);
        let truth = Truth::open(&folder)?.ok_or("has no truth")?;
        let frames = FrameStore::new(capture.clone(), registration);
        let offsets = match clocks {
            Clocks::True => {
                let mut offsets = Offsets::known(&capture);
                for camera in &mut offsets.cameras {
                    camera.offset_s = truth.offset_s(&camera.id);
                }
                offsets
            }
            Clocks::Estimated => {
                let options = RenderOptions::default().offset;
                estimate(&frames, &options, &Reporter::silent())?.offsets
            }
        };
        let mut instants_s: Vec<f64> =
            truth.views.iter().map(|v| v.time_s - capture.time_origin_s).collect();
        instants_s.dedup();
        let field = LightField::with_frames(&frames, offsets);
        Ok(Self { field, capture, truth, instants_s })
    }

    /// The scene with true clocks and the default registration.
    pub fn with_true_clocks(name: &str) -> Result<Self, Error> {
        Self::open(name, Clocks::True, &RegistrationOptions::default())
    }

    /// A true view at the instant of that number, by its name in the rig or as a camera of the array.
    pub fn true_view(&self, instant: usize, id: &str) -> Result<TrueView, Error> {
        let time_s = self.instants_s[instant] + self.capture.time_origin_s;
        let is_it = |v: &&TruthView| {
            v.time_s == time_s
                && (v.like.as_deref() == Some(id) || v.id.ends_with(&format!("-{id}")))
        };
        let view = self.truth.views.iter().find(is_it).ok_or(format!("the truth lacks {id}"))?;
        let (width, height, depths) = read_array(&self.truth.file(&view.depth)?)?;
        let (w, _, motion) = read_array(&self.truth.file(&view.motion)?)?;
        Ok(TrueView {
            camera: view.camera.camera()?,
            image: read_image(&self.truth.file(&view.image)?)?.0.to_rgb(),
            depth: DepthMap::from_data(width, height, depths),
            moving: moving_part(&motion, w, 0.5, 2),
        })
    }

    /// A view at a time.
    pub fn view(
        &self,
        camera: &Camera,
        time_s: f64,
        options: &RenderOptions,
    ) -> Result<Image, Error> {
        Ok(self.field.view(camera, time_s, options)?.image)
    }

    /// Every camera's frame times, seconds from the capture's start.
    pub fn times_s(&self) -> Vec<Option<Vec<f64>>> {
        self.field.offsets().common_times_s(&self.capture)
    }

    /// The camera for which an instant is nearest to the middle between two frames, and the earlier of
    /// these frames.
    pub fn farthest_from_frames(&self, time_s: f64) -> Option<(usize, usize)> {
        let times_s = self.times_s();
        let place = |c: usize| {
            let times = times_s[c].as_ref()?;
            let k = times.partition_point(|t| *t <= time_s).checked_sub(1)?;
            let fraction = (time_s - times[k]) / (times.get(k + 1)? - times[k]);
            Some((c, k, (fraction - 0.5).abs()))
        };
        let places = (0..times_s.len()).filter_map(place);
        places.min_by(|a, b| a.2.total_cmp(&b.2)).map(|(c, k, _)| (c, k))
    }
}

/// Options of a view over the plane at a depth.
pub fn over_plane(depth_m: f64, sync: SyncMethod) -> RenderOptions {
    let mut options = RenderOptions { sync, ..RenderOptions::default() };
    options.proxy.method = ProxyMethod::Plane;
    options.proxy.plane_depth_m = Some(depth_m);
    options
}

/// The centre of a pixel.
pub fn center_of(x: usize, y: usize) -> Point2<f64> {
    Point2::new(x as f64 + 0.5, y as f64 + 0.5)
}

/// The capture's folder, filmed unless it is there.
fn filmed(name: &str) -> Result<PathBuf, Error> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = root.join(".captures/views").join(name);
    if folder.join("capture.json").exists() && folder.join("truth/truth.json").exists() {
        return Ok(folder);
    }
    let views = root.join(".captures/views.json");
    let linear8 = root.join("rigs/linear8.json");
    let [from, to] = [&linear8, &views].map(|p| p.to_str().ok_or("the folder's name is no text"));
    rig::write(from?, to?, Purpose::Views)?;
    let reporter = Reporter::new(false);
    let environment = ensure_environment(root, &reporter)?;
    reporter.note(&format!("Filming the scene {name} into {}.", folder.display()));
    let options = FilmOptions {
        rig: views,
        scene: Source::Named(name.to_owned()),
        capture: folder.clone(),
        size_px: Some(SIZE_PX),
        frames: Some(FRAMES),
        samples: None,
        engine: Some("workbench".to_owned()),
        instants: None,
        instants_s: Vec::new(),
        tracks: None,
        truth_video: None,
        truth: true,
        video: false,
        part: None,
        silence_s: None,
    };
    film(&environment, &options, &reporter)?;
    Ok(folder)
}
