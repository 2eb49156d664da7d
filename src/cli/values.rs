//! Values of the command line that are more than a number or a name.

use clap::ValueEnum;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::str::FromStr;

/// A rung, or what the capture requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice<T> {
    Auto,
    Rung(T),
}

impl<T: Copy> Choice<T> {
    /// The rung, if it is one.
    pub fn rung(&self) -> Option<T> {
        match self {
            Self::Auto => None,
            Self::Rung(rung) => Some(*rung),
        }
    }
}

const AUTO: &str = "auto";

/// A ladder's rungs, and `auto`.
pub fn choice<T: ValueEnum + Clone + Send + Sync + 'static>()
-> impl TypedValueParser<Value = Choice<T>> {
    let auto =
        PossibleValue::new(AUTO).help("The lowest that this capture requires: see stlfr plan");
    let rungs = T::value_variants().iter().filter_map(T::to_possible_value);
    PossibleValuesParser::new(std::iter::once(auto).chain(rungs)).try_map(|name| {
        if name == AUTO { Ok(Choice::Auto) } else { T::from_str(&name, false).map(Choice::Rung) }
    })
}

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
    fn rungs_and_auto() {
        use clap::{Arg, Command};
        use stlfr::render::ProxyRung;
        let command = || Command::new("c").arg(Arg::new("p").value_parser(choice::<ProxyRung>()));
        let parsed = |text: &str| {
            let found = command().try_get_matches_from(["c", text]).ok()?;
            found.get_one::<Choice<ProxyRung>>("p").copied()
        };
        assert_eq!(parsed("auto"), Some(Choice::Auto));
        assert_eq!(parsed("plane"), Some(Choice::Rung(ProxyRung::Plane)));
        assert_eq!(parsed("sphere"), None);
    }

    #[test]
    fn sizes() {
        assert_eq!("320x240".parse(), Ok(Size { width: 320, height: 240 }));
        for wrong in ["320", "0x240", "320x", "320X240", "-1x5", "4x4", "320x240x3"] {
            assert!(wrong.parse::<Size>().is_err(), "{wrong}");
        }
    }
}
