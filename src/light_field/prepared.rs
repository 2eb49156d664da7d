//! Registered frame pairs on disk: `CAPTURE/.stlfr/registered/KEY/CAMERA-FRAME.tracks`, and beside them the cameras'
//! `gains`, written by [`LightField::prepare`] and read by every later view.
//!
//! KEY is a hash of all that registration depends on: the capture's content, the clocks, the options, the
//! program's version. A file holds a checksum of its name, the key and what follows, then the tracks or gains as numbers
//! of eight bytes, little-endian, so that views are the same bytes as without it. What is missing or damaged is
//! registered anew. The folder may be deleted at any time.
//!
//! Known limits: folders of earlier contents and options stay. A checksum tells damage, not a forger. What another
//! kind of processor wrote is used, though it may differ in the last bits.

use super::{LightField, RenderError};
use crate::host::{link_within, read_bytes, remove_special, write_atomically};
use crate::registration::{FlowDirection, Gains, Track};
use nalgebra::{Matrix2, Point2};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

/// Part of the key: changed whenever the same frames are registered to other tracks, or files hold them otherwise.
const REGISTRATION: &[u8] = b"stlfr-tracks-2";

/// The folder of all prepared pairs inside a capture.
const FOLDER: &str = ".stlfr/registered";

/// The file of the cameras' gains.
const GAINS: &str = "gains";

/// Largest file, bytes: half a million tracks. Larger: what stands in a file's place fills the memory. Smaller:
/// pairs of very many features are registered anew.
const MAX_BYTES: u64 = 64 << 20;

/// Eight-byte numbers of a track: its direction, four positions, its deformation, and two errors.
const NUMBERS: usize = 1 + 8 + 4 + 2;
const TRACK_BYTES: usize = NUMBERS * size_of::<f64>();

/// Where one light field's registered pairs are.
#[derive(Clone, Debug)]
pub(super) struct Store {
    folder: PathBuf,
    key: String,
}

/// What [`LightField::prepare`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Prepared {
    /// Frame pairs in which something moves.
    pub pairs: usize,
    /// How many of them were there already.
    pub found: usize,
    /// The size of all of them, and of the gains, bytes.
    pub bytes: u64,
}

impl Store {
    /// `None` if a frame can't be read, or if the folder would be elsewhere, behind a link.
    fn of(field: &LightField) -> Option<Self> {
        let capture = field.capture();
        let mut hasher = blake3::Hasher::new();
        hasher.update(REGISTRATION);
        hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
        hasher.update(capture.content_hash().ok()?.as_bytes());
        let options = serde_json::to_string(field.frames.options()).ok()?;
        hasher.update(options.as_bytes());
        for times in &field.times_s {
            let times = times.as_deref().unwrap_or_default();
            hasher.update(&(times.len() as u64).to_le_bytes());
            times.iter().for_each(|t| {
                hasher.update(&t.to_bits().to_le_bytes());
            });
        }
        let key = hasher.finalize().to_hex().to_string();
        let folder = capture.folder.join(FOLDER).join(&key[..32]);
        link_within(&capture.folder, &folder).is_none().then_some(Self { folder, key })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn checksum(&self, name: &str, content: &[u8]) -> [u8; blake3::OUT_LEN] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.key.as_bytes());
        hasher.update(name.as_bytes());
        // A name has no such byte.
        hasher.update(&[0]);
        hasher.update(content);
        hasher.finalize().into()
    }

    /// What a file holds after its checksum, if it is there as it was written.
    fn read(&self, name: &str) -> Option<Vec<u8>> {
        let mut bytes = read_bytes(&self.path(name), MAX_BYTES).ok()?;
        let (checksum, content) = bytes.split_first_chunk::<{ blake3::OUT_LEN }>()?;
        let is_whole = *checksum == self.checksum(name, content);
        is_whole.then(|| bytes.split_off(blake3::OUT_LEN))
    }

    /// Writes numbers to a file; how many bytes that is.
    fn write(&self, name: &str, numbers: impl Iterator<Item = f64>) -> std::io::Result<u64> {
        let content: Vec<u8> = numbers.flat_map(f64::to_le_bytes).collect();
        let bytes = [&self.checksum(name, &content)[..], &content].concat();
        let path = self.path(name);
        remove_special(&path)?;
        write_atomically(&path, &bytes)?;
        Ok(bytes.len() as u64)
    }

    /// The gains of this many cameras, if they are there as they were written.
    fn load_gains(&self, cameras: usize) -> Option<Gains> {
        let content = self.read(GAINS)?;
        let (numbers, rest) = content.as_chunks::<8>();
        let numbers: Vec<f64> = numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
        rest.is_empty().then(|| Gains::from_numbers(cameras, &numbers)).flatten()
    }

    /// Writes the gains unless they are there; how many bytes that is.
    fn keep_gains(&self, gains: &Gains) -> std::io::Result<u64> {
        let cameras = gains.cameras();
        if self.load_gains(cameras).as_ref() == Some(gains) {
            return Ok((size_of::<f64>() * Gains::numbers_of(cameras) + blake3::OUT_LEN) as u64);
        }
        self.write(GAINS, gains.numbers())
    }

    /// The tracks of a pair, if they are there as they were written.
    pub fn load(&self, pair: (usize, usize)) -> Option<Vec<Track>> {
        let content = self.read(&tracks_file(pair))?;
        let (tracks, rest) = content.as_chunks::<TRACK_BYTES>();
        rest.is_empty().then_some(())?;
        tracks.iter().map(decoded).collect()
    }

    /// Writes the tracks of a pair; how many bytes that is.
    fn save(&self, pair: (usize, usize), tracks: &[Track]) -> std::io::Result<u64> {
        self.write(&tracks_file(pair), tracks.iter().flat_map(encoded))
    }
}

fn tracks_file((camera, k): (usize, usize)) -> String {
    format!("{camera}-{k}.tracks")
}

/// NaN stands for what was not found.
fn encoded(track: &Track) -> [f64; NUMBERS] {
    let direction = match track.direction {
        FlowDirection::Forward => 0.0,
        FlowDirection::Backward => 1.0,
        FlowDirection::Both => 2.0,
    };
    let nowhere = Point2::new(f64::NAN, f64::NAN);
    let [before, after] = [track.before, track.after].map(|p| p.unwrap_or(nowhere));
    let (earlier, later, d) = (track.earlier, track.later, &track.deformation);
    [
        direction,
        before.x,
        before.y,
        earlier.x,
        earlier.y,
        later.x,
        later.y,
        after.x,
        after.y,
        d[(0, 0)],
        d[(0, 1)],
        d[(1, 0)],
        d[(1, 1)],
        track.residual,
        track.forward_backward_error_px,
    ]
}

/// `None` for numbers that no track has.
fn decoded(bytes: &[u8; TRACK_BYTES]) -> Option<Track> {
    let (chunks, _) = bytes.as_chunks::<8>();
    let mut numbers = [0.0; NUMBERS];
    numbers.iter_mut().zip(chunks).for_each(|(n, bytes)| *n = f64::from_le_bytes(*bytes));
    let direction = match numbers[0] {
        0.0 => FlowDirection::Forward,
        1.0 => FlowDirection::Backward,
        2.0 => FlowDirection::Both,
        _ => return None,
    };
    let point = |k: usize| Point2::new(numbers[k], numbers[k + 1]);
    let found = |k: usize| Some(point(k)).filter(|p| p.x.is_finite() && p.y.is_finite());
    let rest = &numbers[9..];
    rest.iter().all(|n| n.is_finite()).then_some(())?;
    Some(Track {
        direction,
        before: found(1),
        earlier: found(3)?,
        later: found(5)?,
        after: found(7),
        deformation: Matrix2::new(rest[0], rest[1], rest[2], rest[3]),
        residual: rest[4],
        forward_backward_error_px: rest[5],
    })
}

impl LightField {
    /// The registered pairs on disk, if any were ever prepared for this capture: otherwise nothing is hashed. Gains on disk
    /// are those of the frames from then on, unless some were known before.
    pub(super) fn store(&self) -> Option<&Store> {
        let open = || {
            let any = self.capture().folder.join(FOLDER).is_dir();
            let store = any.then(|| Store::of(self)).flatten()?;
            if let Some(gains) = store.load_gains(self.times_s.len()) {
                self.frames.know_gains(gains);
            }
            Some(store)
        };
        self.store.get_or_init(open).as_ref()
    }

    /// How many frame pairs there are, and the most bytes that they take on disk.
    pub fn preparation_size(&self) -> (usize, u64) {
        let pairs: usize =
            (0..self.times_s.len()).map(|c| self.times(c).len().saturating_sub(1)).sum();
        let tracks = 2 * self.frames.options().corners.max_corners;
        let gains = size_of::<f64>() * Gains::numbers_of(self.times_s.len()) + blake3::OUT_LEN;
        (pairs, (pairs * (tracks * TRACK_BYTES + blake3::OUT_LEN) + gains) as u64)
    }

    /// Registers all frame pairs and keeps them on disk, so that views need not; those that are there are left as
    /// they are. `progress` is told how many pairs are done.
    ///
    /// A pair goes without registration if none of its blocks changes by more than `still_change`
    /// ([`crate::interpolation::InterpolationOptions`]).
    ///
    /// # Errors
    /// [`RenderError::Capture`] if a frame can't be read, [`RenderError::Prepare`] if nothing can be written.
    pub fn prepare(
        &self,
        still_change: f32,
        progress: impl Fn(usize) + Sync,
    ) -> Result<Prepared, RenderError> {
        let folder = self.capture().folder.join(FOLDER);
        let wrong = |path: &Path| {
            let path = path.to_owned();
            move |source| RenderError::Prepare { path, source }
        };
        std::fs::create_dir_all(&folder).map_err(wrong(&folder))?;
        let refused = || std::io::Error::other("it is reached through a link");
        let store = Store::of(self).ok_or_else(refused).map_err(wrong(&folder))?;
        std::fs::create_dir_all(&store.folder).map_err(wrong(&store.folder))?;
        let gains_bytes = store.keep_gains(self.gains()).map_err(wrong(&store.path(GAINS)))?;
        let frames = (0..self.times_s.len()).map(|c| self.times(c).len()).max().unwrap_or(0);
        let (done, found) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let (pairs, bytes) = (AtomicUsize::new(0), AtomicU64::new(gains_bytes));
        // By time, so that pairs share the frames that are decoded.
        for k in 0..frames.saturating_sub(1) {
            (0..self.times_s.len()).into_par_iter().try_for_each(|camera| {
                let pair = (camera, k);
                if k + 1 >= self.times(camera).len() {
                    return Ok(());
                }
                if !self.is_still(camera, k, still_change)? {
                    let size = match store.load(pair) {
                        Some(tracks) => {
                            found.fetch_add(1, Ordering::Relaxed);
                            (tracks.len() * TRACK_BYTES + blake3::OUT_LEN) as u64
                        }
                        None => {
                            let tracks = self.tracks(camera, k)?;
                            store
                                .save(pair, &tracks)
                                .map_err(wrong(&store.path(&tracks_file(pair))))?
                        }
                    };
                    pairs.fetch_add(1, Ordering::Relaxed);
                    bytes.fetch_add(size, Ordering::Relaxed);
                }
                progress(done.fetch_add(1, Ordering::Relaxed) + 1);
                Ok::<(), RenderError>(())
            })?;
        }
        let [pairs, found] = [pairs, found].map(AtomicUsize::into_inner);
        Ok(Prepared { pairs, found, bytes: bytes.into_inner() })
    }
}

/// Deletes what [`LightField::prepare`] wrote for a capture, whatever its options; whether there was something.
///
/// # Errors
/// If it can't be deleted, or is reached through a link.
pub fn delete_prepared(capture: &Path) -> std::io::Result<bool> {
    let folder = capture.join(FOLDER);
    if link_within(capture, &folder).is_some() {
        return Err(std::io::Error::other("it is reached through a link"));
    }
    match std::fs::remove_dir_all(&folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(false),
        result => result.map(|()| true),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::Capture;
    use crate::offset::Offsets;
    use crate::raster::{BitDepth, Image, write_image};
    use crate::registration::RegistrationOptions;
    use std::sync::Arc;

    /// Two black cameras.
    fn filmed(folder: &Path) -> Arc<Capture> {
        let camera = |c: usize| {
            let image = Image::filled(64, 48, 1, 0.0);
            let path = folder.join(format!("cam{c}/0.png"));
            write_image(&path, &image, None, BitDepth::Eight).unwrap();
            format!(
                r#"{{"id": "cam{c}", "frames": "cam{c}/%d.png", "width": 64, "height": 48, "model": "PINHOLE",
                "params": [64, 64, 32, 24], "clock": {{"rate_hz": 30, "first_s": 0, "shared": true}},
                "cam_from_world": {{"rotation_wxyz": [1, 0, 0, 0], "translation": [{c}, 0, 0]}}}}"#
            )
        };
        let cameras = [camera(0), camera(1)].join(",");
        let text = format!(
            r#"{{"format": "stlfr-capture", "version": 1, "name": "black", "cameras": [{cameras}]}}"#
        );
        std::fs::write(folder.join("capture.json"), text).unwrap();
        Arc::new(Capture::open(folder).unwrap())
    }

    #[test]
    fn gains_on_disk_are_read_if_they_are_plausible() {
        let folder = tempfile::tempdir().unwrap();
        let capture = filmed(folder.path());
        let opened = || {
            let offsets = Offsets::known(&capture);
            LightField::new(capture.clone(), offsets, &RegistrationOptions::default())
        };
        let equal = Gains::equal(2);
        assert_eq!(*opened().gains(), equal);
        opened().prepare(0.0, |_| ()).unwrap();
        let store = Store::of(&opened()).unwrap();
        let written = |numbers: [f64; 8]| {
            store.write(GAINS, numbers.into_iter()).unwrap();
            opened().gains().clone()
        };
        let found = written([1.0, 1.0, 1.0, 2.0, 3.0, 0.5, 0.7, 0.1]);
        assert_eq!((found.of(1), found.largest_difference()), ([2.0, 3.0, 0.5], (0.7, 0.1)));
        for wrong in [0.0, -1.0, 1e-300, 1e300, f64::INFINITY, f64::NAN] {
            assert_eq!(written([1.0, 1.0, 1.0, wrong, 3.0, 0.5, 0.7, 0.1]), equal, "{wrong}");
        }
        for wrong in [-1.0, f64::INFINITY, f64::NAN] {
            assert_eq!(written([1.0, 1.0, 1.0, 2.0, 3.0, 0.5, wrong, 0.1]), equal, "{wrong}");
        }
        // What is whole is left as it is.
        opened().prepare(0.0, |_| ()).unwrap();
        let before = std::fs::metadata(store.path(GAINS)).unwrap().modified().unwrap();
        opened().prepare(0.0, |_| ()).unwrap();
        assert_eq!(std::fs::metadata(store.path(GAINS)).unwrap().modified().unwrap(), before);
    }
}
