//! Reprojection of a row of the view into each source camera, and the sources' penalties by the formula of
//! [`super::blend`].
//!
//! A pixel with the ray r = (x, y, 1) and the inverse depth ρ shows the point `r / ρ`. All vectors are multiplied by ρ,
//! so that they are finite for points at infinity too. Quantities that are constant over the view are computed in f64.
//! Quantities per pixel are computed in f32. Their rounding moves positions by less than 1e-3 px in images up to 4000
//! px wide.

use super::depth_map::DepthMap;
use super::rays::ViewBounds;
use super::source::{BlendOptions, Source};
use super::weights::{BlendMethod, SPAN_PX, SourceSpan};
use crate::camera::{Camera, CameraModel};
use crate::simd::multiversion;
use nalgebra::{Matrix3, Point2, Vector3};

/// Width of the zone along an image's border in which a camera's weight falls to 0, pixels.
const FEATHER_PX: f32 = 4.0;
/// Minimum depth difference between an occluded point and the surface that occludes it, as a fraction of the surface's
/// depth. Points that are less far behind a surface count as points of the surface.
pub(super) const OCCLUSION_FRACTION: f32 = 0.03;
/// Maximum distance from the view's centre at which a camera counts as standing at this centre, as a fraction of the
/// distance between the view's centre and the farthest camera.
const SAME_CENTER_FRACTION: f64 = 1e-6;
/// Factor by which a source's confidence in a point ([`SourceSpan::confidence`]) is multiplied if the point is occluded
/// in the source. The factor is so small that the source contributes only if the point is occluded in all sources.
const OCCLUDED_CONFIDENCE: f32 = 1e-3;
/// Factor by which a source's confidence in a point ([`SourceSpan::confidence`]) is multiplied next to the outline of a
/// nearer surface, where pixels mix the colours of both surfaces.
const OUTLINE_CONFIDENCE: f32 = 0.25;
/// Margin around the cone of a camera's border rays, as a fraction of the cone's radius. Points beyond the margin count
/// as outside the image. The lens polynomial is not valid for them, and might map them into the image.
const CONE_MARGIN: f64 = 0.02;
/// Factor that lowers the bound of [`Reprojection::min_angle`] slightly, to allow for f32 rounding.
const ROUNDING: f32 = 0.999;
/// Amount that is subtracted from the lower bound of an angle's sine, to allow for f32 rounding.
const SINE_ROUNDING: f32 = 1e-6;

/// Rays and inverse depths of a range of pixels in one row of the view, in the view's camera frame.
pub(super) struct TargetRow<'a> {
    /// The x components of the rays (x, y, 1).
    pub x: &'a [f32],
    /// The y components of the rays (x, y, 1).
    pub y: &'a [f32],
    /// Lengths of the rays (x, y, 1).
    pub length: &'a [f32],
    /// Inverse depths of the pixels, 1/m; 0 where the depth is unknown.
    pub inverse_depth: &'a [f32],
}

/// A cone that contains the rays of a range of pixels, and bounds of the rays' lengths and inverse depths.
pub(super) struct RayCone {
    axis: Vector3<f32>,
    /// Sine of the largest angle between one of the rays and the cone's axis.
    sine: f32,
    /// Cosine of the largest angle between one of the rays and the cone's axis.
    cosine: f32,
    /// Length of the longest of the rays (x, y, 1) in the cone.
    longest: f32,
    /// Smallest inverse depth of the pixels whose rays the cone contains, 1/m.
    farthest: f32,
}

impl RayCone {
    /// Returns a cone that contains the rays of all pixels of a row. The cone's axis is the middle pixel's ray. The row
    /// must not be empty. For a pinhole camera, the opening angle is computed from the first and the last ray alone:
    /// these two have the largest angles to the axis.
    pub fn around(row: &TargetRow, is_pinhole: bool) -> Self {
        let n = row.x.len();
        let unit = |k: usize| Vector3::new(row.x[k], row.y[k], 1.0) / row.length[k];
        let axis = unit(n / 2);
        let (mut sine, mut longest) = (0.0_f32, 0.0_f32);
        for k in (0..n).step_by(if is_pinhole { (n - 1).max(1) } else { 1 }) {
            let ray = unit(k);
            // For an angle over 90°, the bound of the sine is 1.
            sine = if ray.dot(&axis) > 0.0 { sine.max(ray.cross(&axis).norm()) } else { 1.0 };
            longest = longest.max(row.length[k]);
        }
        let farthest = row.inverse_depth.iter().copied().fold(f32::INFINITY, f32::min);
        Self { axis, sine, cosine: (1.0 - sine * sine).max(0.0).sqrt(), longest, farthest }
    }
}

multiversion! {
    /// Computes the positions, penalties and confidences, in a source, of the surface points that a row's pixels show.
    /// `pixel` projects a point of the plane z = 1 to a pixel of the source.
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

        // tan(θ/2) = |a × b| / (|a||b| + a · b), where a and b are the vectors to the point from the view's centre and
        // from the source's centre. Since b = a + shift, a × b equals a × shift, which avoids cancellation.
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
    /// Computes the positions and confidences, in a source, of the surface points that a row's pixels show. Unlike
    /// [`measure_row`], computes no penalties.
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

/// Projection of the view's points into one source: the source's pose relative to the view, and its lens.
pub(super) struct Reprojection {
    /// Rotation from the view's axes to the source's axes.
    rotation: Matrix3<f32>,
    /// Vector from the source's centre to the view's centre, in the source's axes, metres.
    shift: Vector3<f32>,
    /// Vector from the source's centre to the view's centre, in the view's axes, metres.
    shift_target: Vector3<f32>,
    model: CameraModel,
    width: f32,
    height: f32,
    /// Ratio of the view's focal length to the source's focal length.
    focal_ratio: f32,
    /// Largest squared distance from the optical axis, on the plane z = 1, at which a point can be in the source's
    /// image.
    max_radius2: f32,
    /// Penalty per pixel of interpolation error, radians. 0 if the method ignores interpolation errors.
    error_angle_rad: f32,
}

impl Reprojection {
    /// Returns the reprojections into all sources, in the order of the sources.
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

    /// Returns whether the source stands at the view's centre. In such a source, the position of a view's pixel doesn't
    /// depend on the pixel's depth.
    pub fn at_center(&self) -> bool {
        self.shift_target == Vector3::zeros()
    }

    /// Returns whether the source's penalties change smoothly over a surface. If so, weights may be interpolated
    /// between the nodes of a grid over the view.
    pub fn is_smooth(&self, source: &Source) -> bool {
        source.depth.is_none()
            && (self.error_angle_rad == 0.0 || source.interpolation_error_px.is_none())
    }

    /// Returns a lower bound of the source's penalties at the pixels whose rays the cone contains. The bound is
    /// computed from the angle between rays alone. NaN if the cone's axis is NaN.
    ///
    /// Let r be a ray, ρ its inverse depth, d the vector from the source's centre to the view's centre, and q = r + ρd.
    /// The penalty `2ρ|r × d| / (|r||q| + r·q)` is at least `ρ|r × d| / (|r|(|r| + ρ|d|))`. This bound increases with
    /// ρ. The angle between r and d differs from the angle between the cone's axis and d by at most the angle between
    /// the axis and the cone's surface.
    pub fn min_angle(&self, cone: &RayCone) -> f32 {
        let (d, axis) = (self.shift_target, cone.axis);
        let length = d.norm();
        let sine = (axis.cross(&d).norm() * cone.cosine - axis.dot(&d).abs() * cone.sine)
            - SINE_ROUNDING * length;
        // The divisor is positive, since a ray's length is at least 1. `max` is not used, since it would turn a NaN
        // into 0.
        let sine = if sine < 0.0 { 0.0 } else { sine };
        ROUNDING * sine * cone.farthest / (cone.longest + cone.farthest * length)
    }

    /// Returns the pinhole projection of points of the plane z = 1 to pixels of the source.
    fn pinhole(&self) -> impl Fn(f32, f32) -> (f32, f32) + use<> {
        let (fx, fy, cx, cy) = self.model.intrinsics();
        let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|v| v as f32);
        move |nx, ny| (fx * nx + cx, fy * ny + cy)
    }

    /// Projects a point of the plane z = 1 to a pixel of the source, with any lens model.
    fn distorted(&self, nx: f32, ny: f32) -> (f32, f32) {
        let normalized = Point2::new(f64::from(nx), f64::from(ny));
        let pixel = self.model.pixel_from_normalized(&normalized);
        (pixel.x as f32, pixel.y as f32)
    }

    /// Computes the positions, in the source, of the surface points that a row's pixels show, and the source's
    /// confidences in these points. Occlusion is ignored.
    pub fn place(&self, row: &TargetRow, span: &mut SourceSpan) {
        if self.model.is_pinhole() {
            place_row(self, row, span, self.pinhole());
        } else {
            place_row_by(self, row, span, |nx, ny| self.distorted(nx, ny));
        }
    }

    /// Computes the positions, penalties and confidences, in `source`, of the surface points that a row's pixels show.
    /// `source` must be the source of this reprojection. Elements of `visible` become true at points that the source
    /// sees; its other elements are unchanged.
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

    /// Projects a direction `q` in the source's axes to the source's image. Returns the pixel's x, its y, and `border`.
    /// `border` is 1 inside the image, falls to 0 at the image's border, and is 0 outside the image and behind the
    /// source.
    #[inline(always)]
    fn project(&self, q: Vector3<f32>, pixel: impl Fn(f32, f32) -> (f32, f32)) -> (f32, f32, f32) {
        // Behind the source, q.z is not positive. The pixel is then meaningless, and `border` is 0.
        let inverse_z = 1.0 / q.z;
        let (nx, ny) = (q.x * inverse_z, q.y * inverse_z);
        let (px, py) = pixel(nx, ny);
        let inside = px.min(self.width - px).min(py.min(self.height - py));
        let is_visible = (q.z > 0.0) & (nx * nx + ny * ny <= self.max_radius2) & (inside > 0.0);
        let t = (inside / FEATHER_PX).min(1.0);
        let border = t * t * (3.0 - 2.0 * t);
        (px, py, if is_visible { border } else { 0.0 })
    }

    /// Returns the vector from the source's centre to a point on the view's ray (x, y, 1), multiplied by the point's
    /// inverse depth. The vector is in the source's axes.
    #[inline(always)]
    fn direction(&self, x: f32, y: f32, inverse_depth: f32) -> Vector3<f32> {
        let (m, s) = (&self.rotation, &self.shift);
        Vector3::new(
            m[(0, 0)] * x + m[(0, 1)] * y + m[(0, 2)] + inverse_depth * s.x,
            m[(1, 0)] * x + m[(1, 1)] * y + m[(1, 2)] + inverse_depth * s.y,
            m[(2, 0)] * x + m[(2, 1)] * y + m[(2, 2)] + inverse_depth * s.z,
        )
    }

    /// Adds the source's expected interpolation error to its penalties. This error is independent of the geometry
    /// proxy's error, so that the squares of both are added.
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

    /// Lowers the confidence in points that lie behind the surface that the source sees, and in points beside a nearer
    /// surface. For a point behind the surface, let the distance be its depth minus the surface's depth, as a fraction
    /// of the surface's depth. The factor on the confidence falls from 1 at the distance [`OCCLUSION_FRACTION`] to
    /// [`OCCLUDED_CONFIDENCE`] at twice that distance. Elements of `visible` become true for points with a factor above
    /// [`OCCLUDED_CONFIDENCE`].
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
                // If the source has no depth at this position, `behind` is NaN, and the point counts as not occluded.
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

    /// For a range of a row's pixels: the x and the y of the rays, the lengths of the rays, and the inverse depths.
    type RowPart = [Vec<f32>; 4];

    fn row(part: &RowPart) -> TargetRow<'_> {
        let [x, y, length, inverse_depth] = part;
        TargetRow { x, y, length, inverse_depth }
    }

    /// Returns the x and the y of a row's points in a source, their penalties, and their confidences.
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

    /// Calls `each` with random test cases: a view, a random part of one of its rows, and the reprojection into a
    /// random source.
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
