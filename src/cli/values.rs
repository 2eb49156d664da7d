//! Values of the command line that are more than a number or a name.

use std::str::FromStr;

/// `320x240`: width and height in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    pub width: u32,
    pub height: u32,
}

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let size = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
        match size {
            Some((width @ 8..=99_999, height @ 8..=99_999)) => Ok(Self { width, height }),
            _ => Err("is no size like 320x240, at least 8x8".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!("320x240".parse(), Ok(Size { width: 320, height: 240 }));
        for wrong in ["320", "0x240", "320x", "320X240", "-1x5", "4x4", "320x240x3"] {
            assert!(wrong.parse::<Size>().is_err(), "{wrong}");
        }
    }
}
