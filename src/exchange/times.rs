//! Tables of frame times with one row per frame: caliscope's `timestamps.csv`, and similar CSV files.

use super::csv::{nanoseconds, read_columns};
use super::pairing::numbers;
use super::{ExchangeError, check_count};
use crate::text::short;
use std::collections::BTreeMap;
use std::path::Path;

/// Name of the table of frame times that is read by default if it is beside the images.
pub(super) const TIMES_FILE: &str = "timestamps.csv";

/// Accepted names of the column that identifies the camera in a table of frame times.
const CAMERA: &[&str] = &["camera", "cam_id", "camera_id", "cam", "port"];
/// Accepted names of the column that has the time in a table of frame times.
const TIME: &[&str] = &[
    "time_s",
    "frame_time",
    "time",
    "timestamp",
    "timestamp_s",
    "time_ms",
    "timestamp_ms",
    "time_us",
    "timestamp_us",
    "time_ns",
    "t_ns",
    "timestamp_ns",
];

/// Times of each camera's frames, in nanoseconds and ascending, by the camera's name in the table.
pub type RecordingTimes = BTreeMap<String, Vec<i64>>;

/// Reads the frame times of all cameras from a CSV table. The rows may have any order. The name of the time column
/// gives the unit: milliseconds for `time_ms`, microseconds for `time_us`, nanoseconds for `time_ns`, and otherwise
/// seconds.
pub fn read_times(path: &Path) -> Result<RecordingTimes, ExchangeError> {
    let mut times = RecordingTimes::new();
    read_columns(path, [CAMERA, TIME], |[_, name], [camera, time]| {
        let digits = match name.rsplit('_').next() {
            Some("ms") => 6,
            Some("us") => 3,
            Some("ns") => 0,
            _ => 9,
        };
        let time_ns = nanoseconds(time, digits)?;
        match times.get_mut(camera) {
            Some(times) => times.push(time_ns),
            None => {
                check_count(times.len() + 1, "cameras")?;
                times.insert(camera.to_owned(), vec![time_ns]);
            }
        }
        Ok(())
    })?;
    times.values_mut().for_each(|times| times.sort_unstable());
    Ok(times)
}

/// Returns the frame times of a camera, nanoseconds. They are listed under the camera's id, or else under the only name
/// with the same numbers as the id, such as `0` for `cam_0`. The caller adds the file's name to the error message.
pub(super) fn times_of<'a>(times: &'a RecordingTimes, id: &str) -> Result<&'a [i64], String> {
    if let Some(times) = times.get(id) {
        return Ok(times);
    }
    let is_alike = |name: &str| !numbers(id).is_empty() && numbers(name) == numbers(id);
    let mut alike = times.iter().filter(|(name, _)| is_alike(name));
    match (alike.next(), alike.next()) {
        (Some((_, times)), None) => Ok(times),
        _ => Err(format!("has no times of {}", short(id))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<RecordingTimes, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        std::fs::write(&path, text).unwrap();
        read_times(&path).map_err(|e| e.to_string())
    }

    #[test]
    fn rows_of_any_order_and_unit() {
        let found = read("sync_index,cam_id,frame_time\n1,1,0.2\n0,1,0.1\n0,0,0.15\n").unwrap();
        assert_eq!(times_of(&found, "cam_1").unwrap(), [100_000_000, 200_000_000]);
        assert_eq!(times_of(&found, "0").unwrap(), [150_000_000]);
        assert!(times_of(&found, "cam_2").unwrap_err().contains("no times of cam_2"));
        assert_eq!(read("camera,time_ms\na,0.001\n").unwrap()["a"], [1000]);
        assert_eq!(read("camera,t_ns\na,17\n").unwrap()["a"], [17]);
        assert!(read("camera,time_s\na,b\n").unwrap_err().contains("line 2: 'b' is no time"));
    }

    #[test]
    fn names_with_the_same_numbers_are_not_chosen_from() {
        let found = read("camera,time_s\nleft1,0\nright1,1\n").unwrap();
        assert!(times_of(&found, "cam1").is_err());
        assert!(times_of(&found, "left").is_err());
        assert_eq!(times_of(&found, "right1").unwrap(), [1_000_000_000]);
    }
}
