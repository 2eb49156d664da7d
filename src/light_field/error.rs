//! Errors of rendering.

use crate::capture::CaptureError;

/// Reason why an image can't be rendered. Every message is one sentence.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error("{camera} has no frames around {}", outside(*.time_s, *.first_s, *.last_s, "it covers"))]
    CameraTime { camera: String, time_s: f64, first_s: f64, last_s: f64 },
    #[error("{camera}'s clock is unknown: {reason}")]
    CameraClock { camera: String, reason: String },
    #[error("no camera has frames around {}", outside(*.time_s, *.first_s, *.last_s, "they cover"))]
    Time { time_s: f64, first_s: f64, last_s: f64 },
    #[error(
        "no frames can be around {}",
        outside(*.time_s, *.first_s, *.last_s, &format!("whatever the offsets, {of} filmed within"))
    )]
    Beyond { time_s: f64, of: String, first_s: f64, last_s: f64 },
    #[error("no camera of this capture has a known clock")]
    NoClock,
    #[error(
        "no point before this view could be triangulated; the plane proxy with proxy.plane_depth_m focuses by hand"
    )]
    NoPoints,
    #[error("no camera sees any pixel of this view")]
    NothingSeen,
    #[error("rendering was stopped")]
    Stopped,
}

/// Number of decimals with which messages show seconds.
const DECIMALS: usize = 4;

/// Formats a time that lies outside of the span from `first_s` to `last_s`, and this span, for an error message. An
/// example with `they cover` as `covered` is `0.2 s: they cover 0 to 0.15 s`. More decimals are shown if the rounded
/// time would lie inside the span.
fn outside(time_s: f64, first_s: f64, last_s: f64, covered: &str) -> String {
    let rounded = |t: f64, decimals: usize| format!("{t:.decimals$}").parse().unwrap_or(t);
    let is_within = |decimals: &usize| {
        let [time_s, first_s, last_s] = [time_s, first_s, last_s].map(|t| rounded(t, *decimals));
        (first_s..=last_s).contains(&time_s)
    };
    let decimals = (DECIMALS..f64::DIGITS as usize).find(|d| !is_within(d));
    let shown = |t: f64| {
        let t = decimals.map_or(t, |d| rounded(t, d)) + 0.0; // no -0
        if t.abs() < 1e9 { t.to_string() } else { format!("{t:e}") }
    };
    format!("{} s: {covered} {} to {} s", shown(time_s), shown(first_s), shown(last_s))
}

impl RenderError {
    /// Returns whether rendering may succeed at another instant after this error.
    pub(super) fn may_succeed_at_another_time(&self) -> bool {
        matches!(
            self,
            Self::Time { .. }
                | Self::CameraTime { .. }
                | Self::Beyond { .. }
                | Self::NoPoints
                | Self::NothingSeen
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_rounded_and_never_read_as_covered() {
        let message = |time_s: f64| {
            let (first_s, last_s) = (-0.0, 0.266_666_666_666_666_7);
            RenderError::Time { time_s, first_s, last_s }.to_string()
        };
        let around = "no camera has frames around";
        assert_eq!(
            message(-0.019_292_000_681_161_88),
            format!("{around} -0.0193 s: they cover 0 to 0.2667 s")
        );
        assert_eq!(
            message(0.266_666_67),
            format!("{around} 0.26666667 s: they cover 0 to 0.266666667 s")
        );
        assert_eq!(message(-1e-7), format!("{around} -0.0000001 s: they cover 0 to 0.2666667 s"));
        assert_eq!(message(1e300), format!("{around} 1e300 s: they cover 0 to 0.2667 s"));
    }
}
