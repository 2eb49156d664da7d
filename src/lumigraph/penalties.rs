//! Reprojection of a row of the view into each source, and the penalties of [`super::blend`].
//!
//! A pixel with the ray r = (x, y, 1) and the inverse depth ρ shows the point `r / ρ`. All vectors are
//! multiplied by ρ, so that they are finite for points at infinity too. Quantities that are constant over the
//! view are computed in f64. Rows are f32, whose rounding moves positions by less than 1e-3 px in images up
//! to 4000 px wide.

use super::depth_map::DepthMap;
use super::rays::ViewBounds;
use super::source::{BlendOptions, Source};
use super::weights::{BlendMethod, SPAN_PX, SourceSpan};
use crate::camera::{Camera, CameraModel};
use crate::simd::multiversion;
use nalgebra::{Matrix3, Point2, Vector3};

/// Width of the zone along an image's border in which a camera's weight falls to 0, pixels.
const FEATHER_PX: f32 = 4.0;
/// Minimum distance in depth between an occluded point and the surface in front of it, as a fraction of the
/// surface's depth.
pub(super) const OCCLUSION_FRACTION: f32 = 0.03;
/// Cameras whose distance from the view's centre is below this fraction of the farthest camera's count as
/// standing at the centre.
const SAME_CENTER_FRACTION: f64 = 1e-6;
/// Factor on the confidence in an occluded point. It is so small that the point contributes only if it is
/// occluded in all sources.
const OCCLUDED_CONFIDENCE: f32 = 1e-3;
/// Factor on the confidence in a point beside a nearer surface, where pixels are mixtures of both.
const OUTLINE_CONFIDENCE: f32 = 0.25;
/// Margin around the cone of a camera's border rays, as a fraction of its radius. Points outside count as
/// outside the image, since the lens polynomial might map them into it.
const CONE_MARGIN: f64 = 0.02;
/// Factor on a lower bound that allows for f32 rounding.
const ROUNDING: f32 = 0.999;
/// Amount that is subtracted from a difference of sines to allow for f32 rounding.
const SINE_ROUNDING: f32 = 1e-6;

/// A range of pixels of a row of the view, in the view's camera frame.
pub(super) struct TargetRow<'a> {
    /// The x of the rays (x, y, 1).
    pub x: &'a [f32],
    /// The y of the rays (x, y, 1).
    pub y: &'a [f32],
    /// Lengths of the rays.
    pub length: &'a [f32],
    /// Inverse depths, 1/m; 0 where there is no proxy.
    pub inverse_depth: &'a [f32],
}

/// A cone that contains the rays of a range of pixels.
pub(super) struct RayCone {
    axis: Vector3<f32>,
    /// Sine of the largest angle between a ray and the axis.
    sine: f32,
    /// Cosine of the largest angle between a ray and the axis.
    cosine: f32,
    /// Length of the longest ray.
    longest: f32,
    /// Smallest inverse depth of the pixels, 1/m.
    farthest: f32,
}

impl RayCone {
    /// The cone of the rays of at least one pixel, around the ray in the middle. For a pinhole, only the
    /// first and the last ray are tested: they are the longest and at the largest angle from the middle.
    pub fn around(row: &TargetRow, is_pinhole: bool) -> Self {
        let n = row.x.len();
        let unit = |k: usize| Vector3::new(row.x[k], row.y[k], 1.0) / row.length[k];
        let axis = unit(n / 2);
        let (mut sine, mut longest) = (0.0_f32, 0.0_f32);
        for k in (0..n).step_by(if is_pinhole { (n - 1).max(1) } else { 1 }) {
            let ray = unit(k);
            // For angles over 90° there is no bound.
            sine = if ray.dot(&axis) > 0.0 { sine.max(ray.cross(&axis).norm()) } else { 1.0 };
            longest = longest.max(row.length[k]);
        }
        let farthest = row.inverse_depth.iter().copied().fold(f32::INFINITY, f32::min);
        Self { axis, sine, cosine: (1.0 - sine * sine).max(0.0).sqrt(), longest, farthest }
    }
}

multiversion! {
    /// Computes the positions, penalties and confidences of a row's points in a source. `pixel` projects a
    /// point of the plane z = 1.
    fn measure_row[P: Fn(f32, f32) -> (f32, f32)](
        reprojection: &Reprojection,
        row: &TargetRow,
        span: &mut SourceSpan,
        pixel: P,
    ) = measure_row_by
}

#[inline(always)]
fn measure_row_by(
    reprojection: &Reprojection,
    row: &TargetRow,
    span: &mut SourceSpan,
    pixel: impl Fn(f32, f32) -> (f32, f32),
) {
    let n = row.x.len();
    // Slices of one length let the loop run without bounds checks.
    let (xs, ys, lengths, inverse) =
        (&row.x[..n], &row.y[..n], &row.length[..n], &row.inverse_depth[..n]);
    let (out_x, out_y) = (&mut span.x[..n], &mut span.y[..n]);
    let (penalty, confidence) = (&mut span.penalty[..n], &mut span.confidence[..n]);
    let at_center = reprojection.at_center();
    let d = reprojection.shift_target;
    for k in 0..n {
        let (x, y, length, inverse) = (xs[k], ys[k], lengths[k], inverse[k]);
        let q = reprojection.direction(x, y, inverse);
        let (px, py, border) = reprojection.project(q, &pixel);

        // tan(θ/2) = |a × b| / (|a||b| + a · b), with a and b the directions from the view's and the source's
        // centre. Since b = a + shift, a × b = a × shift, which avoids cancellation.
        let cross = Vector3::new(y * d.z - d.y, d.x - x * d.z, x * d.y - y * d.x);
        let cross = (cross.x * cross.x + cross.y * cross.y + cross.z * cross.z).sqrt();
        let dot = length * length + inverse * (x * d.x + y * d.y + d.z);
        let q_length = (q.x * q.x + q.y * q.y + q.z * q.z).sqrt();
        // The denominator is 0 only where θ is 180° or the point is the source's centre. Then the angle is ∞
        // or NaN, and the camera has no weight.
        let angle = 2.0 * inverse * cross / (length * q_length + dot);
        let coarseness = (q_length * reprojection.focal_ratio / length - 1.0).max(0.0);

        let counts = ((inverse > 0.0) | at_center) & (angle < f32::INFINITY) & (border > 0.0);
        let raised = angle * (1.0 + coarseness) / border;
        out_x[k] = px;
        out_y[k] = py;
        penalty[k] = if counts { raised } else { f32::INFINITY };
        confidence[k] = if counts { border } else { 0.0 };
    }
}

multiversion! {
    /// [`measure_row`] without penalties.
    fn place_row[P: Fn(f32, f32) -> (f32, f32)](
        reprojection: &Reprojection,
        row: &TargetRow,
        span: &mut SourceSpan,
        pixel: P,
    ) = place_row_by
}

#[inline(always)]
fn place_row_by(
    reprojection: &Reprojection,
    row: &TargetRow,
    span: &mut SourceSpan,
    pixel: impl Fn(f32, f32) -> (f32, f32),
) {
    let n = row.x.len();
    let (xs, ys, inverse) = (&row.x[..n], &row.y[..n], &row.inverse_depth[..n]);
    let (out_x, out_y) = (&mut span.x[..n], &mut span.y[..n]);
    let confidence = &mut span.confidence[..n];
    let at_center = reprojection.at_center();
    for k in 0..n {
        let q = reprojection.direction(xs[k], ys[k], inverse[k]);
        let (px, py, border) = reprojection.project(q, &pixel);
        (out_x[k], out_y[k]) = (px, py);
        confidence[k] = if (inverse[k] > 0.0) | at_center { border } else { 0.0 };
    }
}

/// One source's pose relative to the view, and its lens.
pub(super) struct Reprojection {
    /// Rotation from the view's to the source's axes.
    rotation: Matrix3<f32>,
    /// The view's centre minus the source's, in the source's axes.
    shift: Vector3<f32>,
    /// The view's centre minus the source's, in the view's axes.
    shift_target: Vector3<f32>,
    model: CameraModel,
    width: f32,
    height: f32,
    /// Ratio of the view's focal length to the source's.
    focal_ratio: f32,
    /// Largest squared distance from the optical axis at which a point can be in the image, on the plane z =
    /// 1.
    max_radius2: f32,
    /// Penalty angle per pixel of interpolation error; 0 if time has no weight.
    error_angle_rad: f32,
}

impl Reprojection {
    /// The reprojections into all sources, in their order.
    pub fn of_all(sources: &[Source], target: &Camera, options: &BlendOptions) -> Vec<Self> {
        let center = target.center();
        let extent =
            sources.iter().map(|s| (s.camera.center() - center).norm()).fold(0.0, f64::max);
        sources.iter().map(|s| Self::new(s.camera, target, extent, options)).collect()
    }

    fn new(camera: &Camera, target: &Camera, extent: f64, options: &BlendOptions) -> Self {
        let mut shift_world = target.center() - camera.center();
        if shift_world.norm() <= SAME_CENTER_FRACTION * extent {
            shift_world = Vector3::zeros();
        }
        let target_axes = target.cam_from_world.rotation;
        let rotation = camera.cam_from_world.rotation * target_axes.inverse();
        let widen = (1.0 + CONE_MARGIN).powi(2);
        let radius2 = ViewBounds::of(camera).map_or(0.0, |b| b.max_radius2() * widen);
        Self {
            rotation: rotation.to_rotation_matrix().into_inner().cast(),
            shift: (camera.cam_from_world.rotation * shift_world).cast(),
            shift_target: (target_axes * shift_world).cast(),
            model: camera.model,
            width: camera.width as f32,
            height: camera.height as f32,
            focal_ratio: (target.focal_px() / camera.focal_px()) as f32,
            max_radius2: radius2 as f32,
            error_angle_rad: match options.method {
                BlendMethod::SpaceTime => options.error_angle_rad.max(0.0) as f32,
                BlendMethod::Lumigraph | BlendMethod::Uniform => 0.0,
            },
        }
    }

    /// Whether the source stands at the view's centre. Then the positions of points in the source don't
    /// depend on depth.
    pub fn at_center(&self) -> bool {
        self.shift_target == Vector3::zeros()
    }

    /// Whether a source's penalties change smoothly over a surface, so that weights may be interpolated
    /// between nodes.
    pub fn is_smooth(&self, source: &Source) -> bool {
        source.depth.is_none()
            && (self.error_angle_rad == 0.0 || source.interpolation_error_px.is_none())
    }

    /// Lower bound of the penalties at the pixels of a cone, from the angle alone. NaN if the cone's axis is
    /// NaN.
    ///
    /// With r the ray, ρ the inverse depth, d the view's centre minus the source's and q = r + ρd, the
    /// penalty `2ρ|r × d| / (|r||q| + r·q)` is at least `ρ|r × d| / (|r|(|r| + ρ|d|))`, which increases with
    /// ρ. The angle between r and d differs from that between the axis and d by at most the cone's angle.
    pub fn min_angle(&self, cone: &RayCone) -> f32 {
        let (d, axis) = (self.shift_target, cone.axis);
        let length = d.norm();
        let sine = (axis.cross(&d).norm() * cone.cosine - axis.dot(&d).abs() * cone.sine)
            - SINE_ROUNDING * length;
        // Lengths of rays are at least 1. `max` would drop a NaN.
        let sine = if sine < 0.0 { 0.0 } else { sine };
        ROUNDING * sine * cone.farthest / (cone.longest + cone.farthest * length)
    }

    /// The projection of points of the plane z = 1 by a pinhole, to pixels.
    fn pinhole(&self) -> impl Fn(f32, f32) -> (f32, f32) + use<> {
        let (fx, fy, cx, cy) = self.model.intrinsics();
        let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|v| v as f32);
        move |nx, ny| (fx * nx + cx, fy * ny + cy)
    }

    /// Projects a point of the plane z = 1 by any lens, to pixels.
    fn distorted(&self, nx: f32, ny: f32) -> (f32, f32) {
        let normalized = Point2::new(f64::from(nx), f64::from(ny));
        let pixel = self.model.pixel_from_normalized(&normalized);
        (pixel.x as f32, pixel.y as f32)
    }

    /// Computes the points' positions in the source, and their confidences without occlusion.
    pub fn place(&self, row: &TargetRow, span: &mut SourceSpan) {
        if self.model.is_pinhole() {
            place_row(self, row, span, self.pinhole());
        } else {
            place_row_by(self, row, span, |nx, ny| self.distorted(nx, ny));
        }
    }

    /// Computes the positions, penalties and confidences of a row's points in `source`, to which this
    /// reprojection belongs. Sets `visible` to true at points that the source sees, and leaves the others
    /// unchanged.
    pub fn measure(
        &self,
        row: &TargetRow,
        source: &Source,
        span: &mut SourceSpan,
        visible: &mut [bool; SPAN_PX],
    ) {
        if self.model.is_pinhole() {
            measure_row(self, row, span, self.pinhole());
        } else {
            measure_row_by(self, row, span, |nx, ny| self.distorted(nx, ny));
        }
        if self.error_angle_rad > 0.0 {
            self.add_interpolation_error(source, row.x.len(), span);
        }
        // A source at the view's centre has the same rays as the view: no visible point is occluded in it.
        match source.depth {
            Some(map) if !self.at_center() => self.occlude(row, map, span, visible),
            _ => {
                let visible = visible.iter_mut().zip(&span.confidence);
                visible.for_each(|(visible, c)| *visible |= *c > 0.0);
            }
        }
    }

    /// Projects a direction in the source's axes to its pixel, x and y, and `border`. `border` is 1 inside
    /// the image, falls to 0 at its border, and is 0 outside the image and behind the source.
    #[inline(always)]
    fn project(&self, q: Vector3<f32>, pixel: impl Fn(f32, f32) -> (f32, f32)) -> (f32, f32, f32) {
        // Behind the source q.z is not positive, and the results are discarded below.
        let inverse_z = 1.0 / q.z;
        let (nx, ny) = (q.x * inverse_z, q.y * inverse_z);
        let (px, py) = pixel(nx, ny);
        let inside = px.min(self.width - px).min(py.min(self.height - py));
        let is_visible = (q.z > 0.0) & (nx * nx + ny * ny <= self.max_radius2) & (inside > 0.0);
        let t = (inside / FEATHER_PX).min(1.0);
        let border = t * t * (3.0 - 2.0 * t);
        (px, py, if is_visible { border } else { 0.0 })
    }

    /// The vector from the source to the pixel's point, times the point's inverse depth, in the source's
    /// axes.
    #[inline(always)]
    fn direction(&self, x: f32, y: f32, inverse_depth: f32) -> Vector3<f32> {
        let (m, s) = (&self.rotation, &self.shift);
        Vector3::new(
            m[(0, 0)] * x + m[(0, 1)] * y + m[(0, 2)] + inverse_depth * s.x,
            m[(1, 0)] * x + m[(1, 1)] * y + m[(1, 2)] + inverse_depth * s.y,
            m[(2, 0)] * x + m[(2, 1)] * y + m[(2, 2)] + inverse_depth * s.z,
        )
    }

    /// Adds the expected interpolation error to the penalties. It is independent of the proxy's error, so
    /// that their squares add.
    fn add_interpolation_error(&self, source: &Source, count: usize, span: &mut SourceSpan) {
        let Some(error_px) = source.interpolation_error_px else { return };
        let (w, h) = (source.camera.width, source.camera.height);
        for k in 0..count {
            if span.confidence[k] > 0.0 {
                // Where the confidence is positive, the position is inside the image.
                let (x, y) = (span.x[k] as usize, span.y[k] as usize);
                let angle = self.error_angle_rad * error_px[y.min(h - 1) * w + x.min(w - 1)];
                span.penalty[k] = span.penalty[k].hypot(angle / span.confidence[k]);
            }
        }
    }

    /// Lowers the confidence in points behind the surface that the source sees. With the point's distance
    /// from the surface, as a fraction of the surface's depth, the confidence falls from 1 at
    /// [`OCCLUSION_FRACTION`] to [`OCCLUDED_CONFIDENCE`] at twice this fraction.
    fn occlude(
        &self,
        row: &TargetRow,
        map: &DepthMap,
        span: &mut SourceSpan,
        visible: &mut [bool; SPAN_PX],
    ) {
        for (k, visible) in visible.iter_mut().enumerate().take(row.x.len()) {
            if span.confidence[k] > 0.0 {
                let inverse = row.inverse_depth[k];
                let depth = self.direction(row.x[k], row.y[k], inverse).z / inverse;
                let beyond = |surface: f32| (depth / surface - 1.0) / OCCLUSION_FRACTION - 1.0;
                // If the source has no depth there, this is NaN, and the point is not occluded.
                let behind = beyond(map.farthest_around(span.x[k], span.y[k]));
                if behind > 0.0 {
                    let factor = (1.0 - behind).max(OCCLUDED_CONFIDENCE);
                    *visible |= factor > OCCLUDED_CONFIDENCE;
                    span.confidence[k] *= factor;
                    span.penalty[k] /= factor;
                    continue;
                }
                *visible = true;
                if beyond(map.nearest_around(span.x[k], span.y[k])) > 0.0 {
                    span.confidence[k] *= OUTLINE_CONFIDENCE;
                    span.penalty[k] /= OUTLINE_CONFIDENCE;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::rays::RayRow;
    use super::super::tests::Random;
    use super::*;
    use crate::camera::tests::pinhole_at;
    use nalgebra::UnitQuaternion;

    /// A range of a row's pixels: x and y of the rays, their lengths, and inverse depths.
    type RowPart = [Vec<f32>; 4];

    fn row(part: &RowPart) -> TargetRow<'_> {
        let [x, y, length, inverse_depth] = part;
        TargetRow { x, y, length, inverse_depth }
    }

    /// The positions of the points in a source (x and y), their penalties, and their confidences.
    fn measured(
        reprojection: &Reprojection,
        part: &RowPart,
        measure: impl Fn(&Reprojection, &TargetRow, &mut SourceSpan),
    ) -> [Vec<f32>; 4] {
        let mut span = SourceSpan::ZERO;
        measure(reprojection, &row(part), &mut span);
        [span.x, span.y, span.penalty, span.confidence].map(|v| v[..part[0].len()].to_vec())
    }

    fn bent(mut camera: Camera) -> Camera {
        let (fx, fy, cx, cy) = camera.model.intrinsics();
        let (k1, k2, p1, p2) = (-0.2, 0.05, 1e-3, -1e-3);
        camera.model = CameraModel::OpenCv { fx, fy, cx, cy, k1, k2, p1, p2 };
        camera
    }

    /// Calls `each` with random parts of a view's rows and the reprojection of a random source.
    fn problems(mut each: impl FnMut(&Camera, &RowPart, &Reprojection)) {
        let mut random = Random::new(51);
        let mut number = |low, high| random.in_range(low, high);
        for k in 0..400 {
            let target = if k % 2 == 0 { pinhole_at([0.0; 3]) } else { bent(pinhole_at([0.0; 3])) };
            let (y, from) = (number(0.0, 479.0) as usize, number(0.0, 600.0) as usize);
            let columns = from..(from + 1 + number(0.0, 63.0) as usize).min(640);
            let mut rays = RayRow::new(&target);
            rays.set(y);
            let narrow =
                |v: &[f64]| v[columns.clone()].iter().map(|v| *v as f32).collect::<Vec<_>>();
            let (x, y) = (narrow(&rays.x), narrow(&rays.y));
            let length = x.iter().zip(&y).map(|(x, y)| (x * x + y * y + 1.0).sqrt()).collect();
            let inverse_depth = x.iter().map(|_| number(0.1, 3.0) as f32).collect();
            let mut source = pinhole_at([number(-0.5, 0.5), number(-0.3, 0.3), number(-0.8, 0.3)]);
            source.cam_from_world.rotation =
                UnitQuaternion::from_euler_angles(number(-0.2, 0.2), number(-0.2, 0.2), 0.1);
            let reprojection = Reprojection::new(&source, &target, 1.0, &BlendOptions::default());
            each(&target, &[x, y, length, inverse_depth], &reprojection);
        }
    }

    #[test]
    fn a_cone_s_bound_is_below_every_penalty() {
        let mut positive = 0;
        problems(|target, part, reprojection| {
            let cone = RayCone::around(&row(part), target.model.is_pinhole());
            let bound = reprojection.min_angle(&cone);
            let [_, _, penalty, _] = measured(reprojection, part, |r, row, span| {
                measure_row(r, row, span, |x, y| (500.0 * x + 320.0, 500.0 * y + 240.0));
            });
            assert!(penalty.iter().all(|p| *p >= bound), "{bound} {penalty:?}");
            positive += usize::from(bound > 0.0);
        });
        assert!(positive > 300, "{positive}");
    }

    #[test]
    fn points_are_placed_where_they_are_measured() {
        problems(|_, part, reprojection| {
            let [x, y, _, confidence] = measured(reprojection, part, |r, row, span| {
                measure_row(r, row, span, r.pinhole());
            });
            for place in [place_row, place_row_by] {
                let [px, py, _, border] = measured(reprojection, part, |r, row, span| {
                    place(r, row, span, r.pinhole());
                });
                assert_eq!([px, py, border], [x.clone(), y.clone(), confidence.clone()]);
            }
        });
    }

    #[test]
    fn points_are_measured_alike_with_and_without_avx2() {
        problems(|_, part, reprojection| {
            let [a, b] = [measure_row, measure_row_by]
                .map(|f| measured(reprojection, part, |r, row, span| f(r, row, span, r.pinhole())));
            let bits =
                |all: [Vec<f32>; 4]| all.map(|v| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>());
            assert_eq!(bits(a), bits(b));
        });
    }
}
