//! Values of the command line that are more than a number or a name.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::str::FromStr;
use stlfr::method::Method;

/// A method, or what the capture requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MethodChoice<T> {
    Auto,
    Method(T),
}

impl<T: Copy> MethodChoice<T> {
    /// The method, if it is one.
    pub fn method(&self) -> Option<T> {
        match self {
            Self::Auto => None,
            Self::Method(method) => Some(*method),
        }
    }
}

const AUTO: &str = "auto";

fn possible<T: Method>() -> impl Iterator<Item = PossibleValue> {
    T::ALL.iter().map(|m| PossibleValue::new(m.name()).help(m.help()))
}

fn named<T: Method>(name: &str) -> Result<T, String> {
    T::from_name(name).ok_or_else(|| format!("'{name}' is none of {}", T::names().join(", ")))
}

/// A stage's methods.
pub fn method<T: Method>() -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(possible::<T>()).try_map(|name| named(&name))
}

/// A stage's methods, and `auto`.
pub fn method_or_auto<T: Method>() -> impl TypedValueParser<Value = MethodChoice<T>> {
    let auto =
        PossibleValue::new(AUTO).help("The cheapest that this capture requires: see stlfr plan");
    PossibleValuesParser::new(std::iter::once(auto).chain(possible::<T>())).try_map(|name| {
        if name == AUTO { Ok(MethodChoice::Auto) } else { named(&name).map(MethodChoice::Method) }
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
    fn methods_and_auto() {
        use clap::{Arg, Command};
        use stlfr::options::ProxyMethod;
        let command =
            || Command::new("c").arg(Arg::new("p").value_parser(method_or_auto::<ProxyMethod>()));
        let parsed = |text: &str| {
            let found = command().try_get_matches_from(["c", text]).ok()?;
            found.get_one::<MethodChoice<ProxyMethod>>("p").copied()
        };
        assert_eq!(parsed("auto"), Some(MethodChoice::Auto));
        assert_eq!(parsed("plane"), Some(MethodChoice::Method(ProxyMethod::Plane)));
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
