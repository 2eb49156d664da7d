//! Computes the time from a pixel of one frame to a pixel of another frame, or to an instant. With rolling shutters,
//! this time depends on the image rows of both pixels.

use super::element::Element;
use super::frame::FlowFrame;
use super::geometry::Projection;

/// Time at which an image row is exposed, relative to the frame's time. It is a linear function of the row.
#[derive(Clone, Copy, Debug)]
struct Rows {
    /// Time from one row to the next, in frame periods of the reference camera; 0 for a global shutter.
    per_px: f32,
    middle_px: f32,
}

impl Rows {
    fn of(frame: &FlowFrame) -> Self {
        Self { per_px: frame.row_time as f32, middle_px: 0.5 * frame.view.height as f32 }
    }

    #[inline(always)]
    fn offset(self, y: f32) -> f32 {
        self.per_px * (y - self.middle_px)
    }
}

/// Time from a pixel of one frame to a pixel of another frame, in frame periods of the reference camera.
#[derive(Clone, Copy, Debug)]
pub struct TimeBetween {
    /// Time from the middle row of the first frame to the middle row of the other frame, in frame periods of the
    /// reference camera.
    frames: f32,
    own: Rows,
    other: Rows,
    is_global: bool,
}

impl TimeBetween {
    /// Prepares the computation of times from the pixels of frame `of` to the pixels of frame `by`.
    pub fn new(of: &FlowFrame, by: &FlowFrame) -> Self {
        let frames = (by.time - of.time) as f32;
        let is_global = of.row_time == 0.0 && by.row_time == 0.0;
        Self { frames, own: Rows::of(of), other: Rows::of(by), is_global }
    }

    /// Returns whether both frames have global shutters.
    pub fn is_global(&self) -> bool {
        self.is_global
    }

    /// Returns the time from the middle row of the first frame to the middle row of the other frame, in frame periods
    /// of the reference camera.
    #[inline(always)]
    pub fn frames(&self) -> f32 {
        self.frames
    }

    /// Returns the time from the exposure of the surface element at pixel `(x, y)` in the first frame to its exposure
    /// in the other frame, in frame periods of the reference camera.
    ///
    /// With a rolling shutter, the row at which the other frame sees the element depends on the time, and the time
    /// depends on the row. One secant step solves for both. The step is exact if that row changes linearly with time.
    #[inline(always)]
    pub fn of_element(&self, e: &Element, (x, y): (f32, f32), projection: &Projection) -> f32 {
        if self.is_global {
            return self.frames;
        }
        let start = self.frames - self.own.offset(y);
        if self.other.per_px == 0.0 {
            return start;
        }
        let after = |dt: f32| {
            let [mx, my, q] = e.moved(x, y, dt);
            let [_, v, _] = projection.project(mx, my, q);
            // The row is clamped to the image. Outside, the other frame doesn't see the element at all.
            start + self.other.offset(v.clamp(0.0, 2.0 * self.other.middle_px))
        };
        let first = after(start);
        let second = after(first);
        // If the first change is 0, the second change is 0 too. The slope is then NaN, and adds nothing.
        let slope = (second - first) / (first - start);
        let change = (second - first) * if slope.abs() < 0.5 { slope / (1.0 - slope) } else { 0.0 };
        second + change
    }
}

/// Returns the time from row `y`, pixels, of a frame to the instant `time`, in frame periods of the reference camera.
pub fn until(frame: &FlowFrame, time: f64, y: f32) -> f32 {
    if frame.row_time == 0.0 {
        return (time - frame.time) as f32;
    }
    (time - frame.time) as f32 - Rows::of(frame).offset(y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, CameraModel};
    use crate::raster::Image;
    use nalgebra::Isometry3;

    fn frame(x_m: f64, y_m: f64, time: f64, row_time: f64) -> FlowFrame {
        let camera = Camera {
            width: 64,
            height: 48,
            model: CameraModel::Pinhole { fx: 64.0, fy: 64.0, cx: 32.0, cy: 24.0 },
            cam_from_world: Isometry3::translation(-x_m, -y_m, 0.0),
        };
        FlowFrame::new(&camera, &Image::filled(64, 48, 3, 0.5), time).with_row_time(row_time)
    }

    #[test]
    fn global_shutters_have_the_time_between_the_frames() {
        let (of, by) = (frame(0.0, 0.0, 1.25, 0.0), frame(0.06, 0.02, 1.5, 0.0));
        let time = TimeBetween::new(&of, &by);
        let projection = Projection::new(&of.view, &by.view).unwrap();
        let e = Element { inverse_depth: 0.5, velocity: [3.0, 8.0], ..Element::default() };
        assert_eq!(time.of_element(&e, (10.5, 20.5), &projection), 0.25);
        assert_eq!((time.frames(), until(&of, 2.0, 7.0)), (0.25, 0.75));
    }

    /// At the computed time, the surface element is at the row of the other frame that is exposed at this time.
    #[test]
    fn the_time_is_that_of_the_row_that_sees_the_element() {
        let (of, by) = (frame(0.0, 0.0, 0.0, 0.012), frame(0.06, 0.05, 0.3, 0.015));
        let time = TimeBetween::new(&of, &by);
        let projection = Projection::new(&of.view, &by.view).unwrap();
        for (vy, y) in [(0.0, 3.5), (8.0, 20.5), (-9.0, 40.5), (14.0, 25.5)] {
            let e = Element { inverse_depth: 0.5, velocity: [3.0, vy], ..Element::default() };
            let dt = time.of_element(&e, (30.5, y), &projection);
            let [mx, my, q] = e.moved(30.5, y, dt);
            let [_, v, _] = projection.project(mx, my, q);
            let expected = 0.3 + 0.015 * (v - 24.0) - 0.012 * (y - 24.0);
            assert!((dt - expected).abs() < 1e-5, "{vy}: {dt} {expected}");
        }
        assert!((until(&of, 0.5, 34.0) - (0.5 - 0.12)).abs() < 1e-6);
    }
}
