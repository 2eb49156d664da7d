//! Changes of the cameras' gains over their recordings, by automatic exposure and white balance.
//!
//! A few sampled frames of each camera decide whether its gains change, and only then more frames are sampled. Since
//! cameras stand still, two frames of a camera are compared pixel by pixel, in small blocks. A block is used if it has
//! texture, and if its textures in both frames are strongly correlated, so that nothing moved there. The gains of all
//! sampled frames are then estimated from the ratios of light between many pairs of them, by weighted least squares.
//!
//! If the gains of all cameras change alike, the light of the scene changes, or one exposure control governs all
//! cameras. In both cases, the images of the cameras agree at every instant, and nothing is corrected.
//!
//! Known limits: the gains of a single camera are not corrected. A change that is shorter than the time between two
//! sampled frames is missed or smoothed. The middle frame must have still texture that is neither black nor clipped.

use super::gain_curve::{GainCurve, GainKnot};
use super::gain_ratios::{
    LogGain, MIN_DIFFERENCE, MIN_SAMPLES, Ratio, USABLE, shrunk, solve_log_gains,
};
use crate::capture::Capture;
use crate::raster::{Image, linear_from_encoded};
use rayon::prelude::*;

/// Number of sampled frames that decide whether a camera's gains change.
const FEW: usize = 5;
/// Maximum number of sampled frames of a camera whose gains change.
const MAX_FRAMES: usize = 64;
/// Maximum number of knots of a camera's gain curve: one per sampled frame. The middle frame is sampled in addition to
/// [`MAX_FRAMES`] evenly spread frames.
pub(super) const MAX_KNOTS: usize = MAX_FRAMES + 1;
/// Time in seconds between sampled frames of a camera whose gains change. In a short recording it is shorter, to give
/// [`FEW`] frames. In a long recording it is longer, to give at most [`MAX_FRAMES`] frames.
const INTERVAL_S: f64 = 0.5;
/// Maximum width of the images that are compared, in pixels. The size of a larger image is halved repeatedly.
const WIDTH_PX: usize = 125;
/// Side of a block, in pixels of the reduced images. Smaller: more chance correlations of moving bodies. Larger: fewer
/// still blocks between moving bodies.
const BLOCK_PX: usize = 7;
/// Minimum number of pixels of a block with values in [`USABLE`] in both frames. Other blocks aren't compared.
const MIN_PIXELS: usize = BLOCK_PX * BLOCK_PX / 2;
/// Minimum standard deviation of the logarithm of linear light within a block. A block with less has no texture and is
/// not used. Smaller: noise counts as texture.
const MIN_CONTRAST: f64 = 0.05;
/// Minimum correlation between a block's textures in two frames. A block with at least this correlation is still:
/// nothing moves there. Smaller: moving bodies count as still. Larger: noisy images have no still blocks.
const MIN_CORRELATION: f64 = 0.9;
/// Minimum fraction of still blocks among a frame pair's blocks with texture. Below this fraction, the pair is not
/// used, because chance correlations of moving bodies may outnumber still blocks.
const MIN_STILL_FRACTION: f64 = 0.2;

/// Estimates the change of each camera's gains over its recording. Returns one curve per camera. Frames that can't be
/// read are left out. The read error is reported later, when the frame is used.
pub(super) fn gain_curves(capture: &Capture) -> Vec<GainCurve> {
    let count = capture.cameras.len();
    let mut curves = vec![GainCurve::default(); count];
    if count < 2 {
        return curves;
    }
    let measure = |camera: usize| MeasuredGains::measure(capture, camera, FEW);
    let few: Vec<MeasuredGains> = (0..count).into_par_iter().map(measure).collect();
    let refined = changing(&few).into_par_iter().map(|camera| {
        let times_s = &capture.cameras[camera].clock.times_s;
        let duration_s = times_s[times_s.len() - 1] - times_s[0];
        // For a very long recording, the conversion saturates.
        let frames = (duration_s / INTERVAL_S).ceil() as usize;
        let frames = frames.saturating_add(1).clamp(FEW, MAX_FRAMES);
        (camera, MeasuredGains::measure(capture, camera, frames).curve())
    });
    for (camera, curve) in refined.collect::<Vec<_>>() {
        curves[camera] = curve;
    }
    curves
}

/// Returns the indices of the cameras whose gains change significantly, and differently from those of at least one
/// other camera.
fn changing(all: &[MeasuredGains]) -> Vec<usize> {
    let differs = |c: usize| (0..all.len()).any(|d| d != c && all[c].differs(&all[d]));
    (0..all.len()).filter(|&c| all[c].changes() && differs(c)).collect()
}

/// The gains of a camera at one sampled frame, relative to its middle frame.
#[derive(Clone, Debug)]
struct SampledGains {
    /// Time of the frame, in seconds on the camera's own clock.
    time_s: f64,
    /// Logarithms of the gains of red, green and blue.
    gains: [LogGain; 3],
}

/// The gains of a camera at sampled frames, in order of time. Frames whose gains can't be measured are left out.
#[derive(Clone, Debug)]
struct MeasuredGains(Vec<SampledGains>);

impl MeasuredGains {
    /// Measures the gains at about `count` frames of a camera, spread over its recording.
    fn measure(capture: &Capture, camera: usize, count: usize) -> Self {
        let filmed = &capture.cameras[camera];
        let (frames, middle) = spread(filmed.frames.len(), count);
        let read = |&frame: &usize| {
            let image = capture.read_frame(camera, frame).ok()?;
            Some(LogImage::new(&shrunk(image, WIDTH_PX)))
        };
        let samples: Vec<Option<LogImage>> = frames.par_iter().map(read).collect();
        let times_s = frames.iter().map(|&frame| filmed.clock.times_s[frame]);
        Self::solve(&samples, middle, &times_s.collect::<Vec<f64>>())
    }

    /// Computes the gains of sampled frames relative to sample `middle`. The ratios of light between successive
    /// samples, and between each sample and the middle one, are used. `None` in `samples` is a frame that can't be
    /// read.
    fn solve(samples: &[Option<LogImage>], middle: usize, times_s: &[f64]) -> Self {
        let successive = (1..samples.len()).map(|k| [k - 1, k]);
        let others = (0..samples.len()).filter(|k| k.abs_diff(middle) > 1);
        let ratio = |images: [usize; 2]| {
            let [a, b] = images.map(|k| samples[k].as_ref());
            Ratio::of_samples(images, &still_ratios(a?, b?))
        };
        let pairs = successive.chain(others.map(|k| [middle, k]));
        let ratios: Vec<Ratio> = pairs.filter_map(ratio).collect();
        let gains = solve_log_gains(samples.len(), middle, &ratios);
        let sampled = gains.iter().zip(times_s).filter_map(|(gains, &time_s)| {
            let [Some(r), Some(g), Some(b)] = *gains else { return None };
            let gains = [r, g, b];
            gains
                .iter()
                .all(|g| g.std_err <= MIN_DIFFERENCE)
                .then_some(SampledGains { time_s, gains })
        });
        Self(sampled.collect())
    }

    fn channel(&self, channel: usize) -> Vec<LogGain> {
        self.0.iter().map(|sample| sample.gains[channel]).collect()
    }

    /// Returns whether the gain of any channel changes significantly.
    fn changes(&self) -> bool {
        (0..3).any(|c| LogGain::vary(&self.channel(c)))
    }

    /// Returns whether the ratio of this camera's gain to another camera's gain changes significantly, in any channel.
    /// The offset between the two cameras' clocks is not yet known and is assumed to be 0.
    fn differs(&self, other: &Self) -> bool {
        let (Some(first), Some(last)) = (other.0.first(), other.0.last()) else { return false };
        let within = |s: &&SampledGains| (first.time_s..=last.time_s).contains(&s.time_s);
        let knots: GainCurve = other.curve_of([true; 3]);
        (0..3).any(|c| {
            let of_other = other.0.iter().map(|s| s.gains[c].std_err).fold(0.0, f64::max);
            let relative = |s: &SampledGains| LogGain {
                log: s.gains[c].log - knots.log_at(s.time_s)[c],
                std_err: s.gains[c].std_err.hypot(of_other),
            };
            LogGain::vary(&self.0.iter().filter(within).map(relative).collect::<Vec<_>>())
        })
    }

    /// Returns the gain curve. Channels whose gains don't change significantly are constant in it. The whole curve is
    /// constant if no channel's gain changes significantly.
    fn curve(&self) -> GainCurve {
        let change = [0, 1, 2].map(|c| LogGain::vary(&self.channel(c)));
        if change.contains(&true) { self.curve_of(change) } else { GainCurve::default() }
    }

    /// Returns the curve with one knot per sampled frame. Channels that aren't selected by `channels` are constant in
    /// the curve.
    fn curve_of(&self, channels: [bool; 3]) -> GainCurve {
        let log = |s: &SampledGains, c: usize| if channels[c] { s.gains[c].log } else { 0.0 };
        let knot =
            |s: &SampledGains| GainKnot { time_s: s.time_s, log: [0, 1, 2].map(|c| log(s, c)) };
        GainCurve::new(self.0.iter().map(knot).collect())
    }
}

/// Selects about `count` frames of a recording of `frames` frames. They are spread evenly and include the first, the
/// middle and the last frame. Returns the indices of the selected frames, ascending, and the position of the middle
/// frame in this list.
fn spread(frames: usize, count: usize) -> (Vec<usize>, usize) {
    let last = frames.saturating_sub(1);
    let steps = count.saturating_sub(1).max(1);
    let mut chosen: Vec<usize> = (0..=steps).map(|k| k * last / steps).collect();
    chosen.push(frames / 2);
    chosen.sort_unstable();
    chosen.dedup();
    let middle = chosen.partition_point(|&k| k < frames / 2);
    (chosen, middle)
}

/// The logarithms of the light in a frame of a camera. The frame is reduced to a width of at most [`WIDTH_PX`].
struct LogImage {
    width: usize,
    height: usize,
    channels: usize,
    /// The natural logarithm of each pixel's linear light, row by row, channels interleaved. All channels of a pixel
    /// are NaN if one of its values is outside [`USABLE`].
    logs: Vec<f32>,
}

impl LogImage {
    fn new(image: &Image) -> Self {
        let (width, height, channels) = (image.width(), image.height(), image.channels());
        let mut logs = Vec::with_capacity(image.data().len());
        for pixel in image.data().chunks_exact(channels) {
            let is_usable = pixel.iter().all(|v| USABLE.contains(v));
            let log = |v: &f32| if is_usable { linear_from_encoded(*v).ln() } else { f32::NAN };
            logs.extend(pixel.iter().map(log));
        }
        Self { width, height, channels, logs }
    }

    /// Returns the pixels of a block of the image, each as a slice of its channels. `x` and `y` are the block's column
    /// and row in the grid of blocks.
    fn block(&self, [x, y]: [usize; 2]) -> impl Iterator<Item = &[f32]> {
        let row = move |dy: usize| {
            let first = self.channels * ((y * BLOCK_PX + dy) * self.width + x * BLOCK_PX);
            self.logs[first..first + self.channels * BLOCK_PX].chunks_exact(self.channels)
        };
        (0..BLOCK_PX).flat_map(row)
    }
}

/// Returns, for each still block, the natural logarithm of the ratio of its light in frame `b` to its light in frame
/// `a`, by channel. Both are frames of one camera. The result is empty if too few blocks are still.
fn still_ratios(a: &LogImage, b: &LogImage) -> Vec<[f64; 3]> {
    let [columns, rows] = [a.width / BLOCK_PX, a.height / BLOCK_PX];
    let places = (0..rows * columns).map(|k| [k % columns, k / columns]);
    let textured: Vec<BlockRatio> =
        places.filter_map(|at| BlockRatio::with_texture(a, b, at)).collect();
    let still = textured.iter().filter(|block| block.correlation >= MIN_CORRELATION);
    let logs: Vec<[f64; 3]> = still.map(|block| block.log).collect();
    let min = (MIN_STILL_FRACTION * textured.len() as f64).max(MIN_SAMPLES as f64);
    if logs.len() as f64 >= min { logs } else { Vec::new() }
}

/// Comparison of a block of pixels between two frames of one camera.
struct BlockRatio {
    /// Mean logarithm of the ratio of light in the second frame to light in the first, by channel. For grey frames, the
    /// three values are equal.
    log: [f64; 3],
    /// Correlation between the two frames of the logarithms of light, over all pixels and channels of the block. Each
    /// channel's mean is subtracted first.
    correlation: f64,
}

impl BlockRatio {
    /// Compares a block of two frames. Returns `None` if the block lacks texture in one of the frames, or if fewer than
    /// [`MIN_PIXELS`] pixels are usable in both frames.
    fn with_texture(a: &LogImage, b: &LogImage, at: [usize; 2]) -> Option<Self> {
        let both =
            || a.block(at).zip(b.block(at)).filter(|(a, b)| !a[0].is_nan() && !b[0].is_nan());
        let count = both().count();
        if count < MIN_PIXELS {
            return None;
        }
        let n = count as f64;
        let mut log = [0.0; 3];
        let (mut squares, mut products) = ([0.0; 2], 0.0);
        for c in 0..a.channels {
            let values = || both().map(|(a, b)| [f64::from(a[c]), f64::from(b[c])]);
            let mean = values().fold([0.0; 2], |sum, v| [sum[0] + v[0] / n, sum[1] + v[1] / n]);
            for [p, q] in values().map(|v| [v[0] - mean[0], v[1] - mean[1]]) {
                squares = [squares[0] + p * p, squares[1] + q * q];
                products += p * q;
            }
            log[c] = mean[1] - mean[0];
        }
        let values = n * a.channels as f64;
        let has_texture = squares.iter().all(|s| *s >= values * MIN_CONTRAST * MIN_CONTRAST);
        let correlation = products / (squares[0] * squares[1]).sqrt();
        let log = if a.channels == 1 { [log[0]; 3] } else { log };
        has_texture.then_some(Self { log, correlation })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::raster::encoded_from_linear;

    const W: usize = 160;
    const H: usize = 120;
    const FRAMES: usize = 9;
    const FRAME_S: f64 = 1.0 / 30.0;

    /// A recording of a textured wall, `FRAMES` frames long.
    #[derive(Clone, Copy)]
    struct FilmedWall {
        channels: usize,
        /// The logarithm of the gain of a channel at a time in seconds.
        log: fn(f64, usize) -> f64,
        /// Width of a textured body that moves by 9 pixels a frame, as a fraction of the image.
        body: f64,
        /// Brightness of the body relative to the wall.
        body_light: f64,
        /// Phase offset of the body's texture, radians.
        seed: f64,
        /// Standard deviation of the noise of encoded values.
        noise: f64,
    }

    const STEADY: FilmedWall = FilmedWall {
        channels: 3,
        log: |_, _| 0.0,
        body: 0.0,
        body_light: 1.0,
        seed: 40.0,
        noise: 0.004,
    };

    fn ramp(time_s: f64, channel: usize) -> f64 {
        [0.4, 0.2, -0.3][channel] * (time_s / (8.0 * FRAME_S) - 0.5)
    }

    /// Linear light of a wall or a body at a pixel.
    fn texture(x: f64, y: f64, seed: f64) -> f64 {
        let wave = |a: f64, b: f64| (a * x + b * y + seed).sin();
        0.2 + 0.05 * (wave(0.31, 0.17) + wave(-0.22, 0.41) + wave(0.57, -0.36))
    }

    impl FilmedWall {
        fn frame(&self, k: usize) -> Image {
            let mut random = Random::new(1 + k as u64);
            let mut data = Vec::with_capacity(W * H * self.channels);
            let left = 9.0 * k as f64;
            for at in 0..W * H {
                let (x, y) = ((at % W) as f64, (at / W) as f64);
                let is_body = (left..left + self.body * W as f64).contains(&x);
                let light = match is_body {
                    true => self.body_light * texture(x - left, y, self.seed),
                    false => texture(x, y, 0.0),
                };
                for c in 0..self.channels {
                    let gain = (self.log)(k as f64 * FRAME_S, c).exp();
                    let value = encoded_from_linear(gain * light) + self.noise * random.gaussian();
                    data.push(((255.0 * value.clamp(0.0, 1.0)).round() / 255.0) as f32);
                }
            }
            Image::from_data(W, H, self.channels, data)
        }

        fn series(&self, frames: &[usize], middle: usize) -> MeasuredGains {
            let sample = |&k: &usize| Some(LogImage::new(&shrunk(self.frame(k), WIDTH_PX)));
            let times_s: Vec<f64> = frames.iter().map(|k| *k as f64 * FRAME_S).collect();
            MeasuredGains::solve(&frames.iter().map(sample).collect::<Vec<_>>(), middle, &times_s)
        }

        fn measured(&self) -> MeasuredGains {
            let (frames, middle) = spread(FRAMES, FEW);
            self.series(&frames, middle)
        }
    }

    fn assert_ramp(curve: &GainCurve, channels: usize) {
        assert!(!curve.is_constant());
        for k in 0..FRAMES {
            let time_s = k as f64 * FRAME_S;
            for (c, log) in curve.log_at(time_s).into_iter().enumerate() {
                let expected = ramp(time_s, c % channels) - ramp(4.0 * FRAME_S, c % channels);
                assert!((log - expected).abs() < 0.006, "frame {k} channel {c}: {log} {expected}");
            }
        }
    }

    #[test]
    fn a_ramp_is_recovered_in_spite_of_noise_and_a_moving_body() {
        let ramped = FilmedWall { log: ramp, ..STEADY };
        assert_ramp(&ramped.measured().curve(), 3);
        assert_ramp(&FilmedWall { noise: 0.015, ..ramped }.measured().curve(), 3);
        let hidden = FilmedWall { body: 0.5, body_light: 0.4, ..ramped };
        assert_ramp(&hidden.measured().curve(), 3);
        assert_ramp(&FilmedWall { channels: 1, ..hidden }.measured().curve(), 1);
    }

    #[test]
    fn noise_and_moving_bodies_are_no_change() {
        for (body, body_light, noise) in [(0.0, 1.0, 0.02), (0.5, 0.4, 0.004), (0.8, 2.0, 0.004)] {
            let measured = FilmedWall { body, body_light, noise, ..STEADY }.measured();
            assert!(measured.0.len() > 1 || body > 0.5, "{body}: {} samples", measured.0.len());
            assert!(!measured.changes() && measured.curve().is_constant(), "{body} {noise}");
        }
        // Bodies that fill the images.
        for k in 0..20 {
            let filled = FilmedWall { body: 9.0, seed: f64::from(k), ..STEADY };
            assert!(!filled.measured().changes(), "{k}");
        }
    }

    #[test]
    fn only_the_channels_that_change_are_corrected() {
        let reddening = |time_s: f64, c: usize| if c == 0 { time_s } else { 0.0 };
        let curve = FilmedWall { log: reddening, ..STEADY }.measured().curve();
        let [r, g, b] = curve.log_at(8.0 * FRAME_S);
        assert!((r - 4.0 * FRAME_S).abs() < 0.006 && (g, b) == (0.0, 0.0), "{r} {g} {b}");
        // The change is too small to be corrected.
        let slight = |time_s: f64, _: usize| 0.08 * time_s;
        assert!(FilmedWall { log: slight, ..STEADY }.measured().curve().is_constant());
    }

    #[test]
    fn one_frame_has_no_change_and_two_have_one() {
        let ramped = FilmedWall { log: ramp, ..STEADY };
        assert!(ramped.series(&[3], 0).curve().is_constant());
        let curve = ramped.series(&[0, 8], 1).curve();
        let log = curve.log_at(4.0 * FRAME_S)[0];
        assert!((log + 0.2).abs() < 0.006, "{log}");
        assert!(STEADY.series(&[0, 8], 1).curve().is_constant());
    }

    #[test]
    fn frames_without_usable_pixels_are_left_out() {
        let ramped = FilmedWall { log: ramp, ..STEADY };
        let frames = [0, 2, 4, 6, 8];
        let times_s = frames.map(|k| k as f64 * FRAME_S);
        let samples = |unusable: &[usize], value: f32| -> Vec<Option<LogImage>> {
            let image = |k: usize| match unusable.contains(&k) {
                true => Image::filled(W, H, 3, value),
                false => ramped.frame(k),
            };
            frames.iter().map(|&k| Some(LogImage::new(&shrunk(image(k), WIDTH_PX)))).collect()
        };
        for value in [0.0, 0.5, 1.0] {
            let series = MeasuredGains::solve(&samples(&[2, 8], value), 2, &times_s);
            assert_eq!(series.0.len(), 3);
            let log = series.curve().log_at(2.0 * FRAME_S)[0];
            assert!((log + 0.1).abs() < 0.006, "{log}");
            // Nothing is compared with the middle frame.
            let series = MeasuredGains::solve(&samples(&[4], value), 2, &times_s);
            assert!(series.curve().is_constant());
            assert!(
                MeasuredGains::solve(&samples(&frames, value), 2, &times_s).curve().is_constant()
            );
        }
        let mut unread = samples(&[], 0.0);
        unread[1] = None;
        assert_eq!(MeasuredGains::solve(&unread, 2, &times_s).0.len(), 4);
    }

    #[test]
    fn a_change_of_all_cameras_alike_is_that_of_the_light() {
        let ramped = FilmedWall { log: ramp, ..STEADY }.measured();
        let steady = STEADY.measured();
        let other = FilmedWall { log: |t, c| 0.5 * ramp(t, c), ..STEADY }.measured();
        let all = |series: &[&MeasuredGains]| {
            changing(&series.iter().map(|s| (*s).clone()).collect::<Vec<_>>())
        };
        assert_eq!(all(&[&ramped, &ramped, &ramped]), [0; 0]);
        assert_eq!(all(&[&steady, &ramped, &steady]), [1]);
        assert_eq!(all(&[&ramped, &other]), [0, 1]);
        assert_eq!(all(&[&ramped]), [0; 0]);
        let unmeasured = MeasuredGains(Vec::new());
        assert_eq!(all(&[&ramped, &unmeasured]), [0; 0]);
        // A light that changes, and a camera that compensates for it.
        assert_eq!(all(&[&ramped, &ramped, &steady]), [0, 1]);
    }

    #[test]
    fn samples_are_spread_with_the_middle_frame() {
        assert_eq!(spread(1, FEW), (vec![0], 0));
        assert_eq!(spread(2, FEW), (vec![0, 1], 1));
        assert_eq!(spread(9, FEW), (vec![0, 2, 4, 6, 8], 2));
        let (frames, middle) = spread(10_000, MAX_FRAMES);
        assert!(frames.len() <= MAX_KNOTS && frames[middle] == 5000);
        assert_eq!((frames[0], frames[frames.len() - 1]), (0, 9999));
    }
}
