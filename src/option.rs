//! Declaration of options. The macro `options!` declares each option once, with its type, default, range, unit and help
//! text. The range checks, the list of all options, the JSON Schema and the command line's help are derived from this
//! declaration.

use crate::method::Method;
use serde::Serialize;
use serde_json::{Value, json};
use std::ops::RangeInclusive;

/// The error for an option whose value is out of its range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field}: is {value:?}, must be from {min:?} to {max:?}")]
pub struct OptionError {
    /// The option's path in an options file, such as `registration.levels`.
    pub field: String,
    pub value: f64,
    pub min: f64,
    pub max: f64,
}

/// The type of an option's value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum OptionKind {
    #[default]
    Number,
    Integer,
    Boolean,
    /// A name from a fixed list.
    Choice,
}

/// A name that an option of kind [`OptionKind::Choice`] can have as its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct OptionChoice {
    pub name: &'static str,
    pub help: &'static str,
}

/// An option's declaration, and the value that the option has in one particular struct of options.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DeclaredOption {
    /// The option's path in an options file, such as `blend.cameras`.
    pub name: String,
    /// Help text of one or two sentences.
    pub help: String,
    pub kind: OptionKind,
    pub default: Value,
    #[serde(skip)]
    pub value: Value,
    /// Smallest and largest allowed value of a numeric option, in this order; `None` for other options.
    pub range: Option<[f64; 2]>,
    /// Unit of a numeric option, such as `px`. If the option is a count, the noun for the counted things, such as
    /// `cameras`.
    pub unit: Option<&'static str>,
    /// Allowed names of an option of kind [`OptionKind::Choice`], from the cheapest to the most expensive method. Empty
    /// for other options.
    pub choices: Vec<OptionChoice>,
    /// The option's value if it is a number. It may be NaN, which `value` can't represent because JSON has no NaN.
    #[serde(skip)]
    number: Option<f64>,
}

impl DeclaredOption {
    /// Creates an option that has only a name and a help text. Line breaks in `help` become spaces.
    pub fn new(name: String, help: &str) -> Self {
        let help = help.split_whitespace().collect::<Vec<_>>().join(" ");
        Self { name, help, ..Self::default() }
    }

    /// Returns an error if the option's value is NaN or a number out of its range.
    pub fn check(&self) -> Result<(), OptionError> {
        let (Some(value), Some([min, max])) = (self.number, self.range) else { return Ok(()) };
        if (min..=max).contains(&value) {
            return Ok(());
        }
        Err(OptionError { field: self.name.clone(), value, min, max })
    }

    /// Returns the JSON Schema of the option's value.
    fn schema(&self) -> Value {
        let kind = match self.kind {
            OptionKind::Choice => json!("string"),
            kind => json!(kind),
        };
        let mut schema = json!({"description": self.help, "type": kind, "default": self.default});
        if self.default.is_null() {
            schema["type"] = json!([kind, "null"]);
        }
        if let Some([min, max]) = self.range {
            (schema["minimum"], schema["maximum"]) = (json!(min), json!(max));
        }
        if !self.choices.is_empty() {
            schema["enum"] = self.choices.iter().map(|choice| choice.name).collect();
        }
        schema
    }
}

/// Returns the JSON Schema of an object with these options as fields. An option's name, such as `blend.cameras`, is the
/// path of its field. All fields are optional, and unknown fields are errors.
pub fn options_schema(options: &[DeclaredOption]) -> Value {
    let group = || json!({"type": "object", "properties": {}, "additionalProperties": false});
    let mut root = group();
    for option in options {
        let mut path: Vec<&str> = option.name.split('.').collect();
        let leaf = path.pop().unwrap_or_default();
        let mut at = &mut root["properties"];
        for name in path {
            if at.get(name).is_none() {
                at[name] = group();
            }
            at = &mut at[name]["properties"];
        }
        at[leaf] = option.schema();
    }
    root
}

/// Implemented by the types of options' values, and by structs that group options.
pub trait OptionValue {
    /// Declares a value as an option: appends `option` to `options`, with the kind of the value's type, the default
    /// `default` and the value `self`. For a struct that groups options, appends one option per field instead.
    fn declare(&self, default: &Self, option: DeclaredOption, options: &mut Vec<DeclaredOption>);
}

/// Converts an option's value to JSON, in the form that it has in an options file. An `f32` is written with the fewest
/// decimal digits that identify it.
fn in_json(value: &impl Serialize) -> Value {
    serde_json::to_string(value).and_then(|text| serde_json::from_str(&text)).unwrap_or_default()
}

macro_rules! option_values {
    ($($type:ty: $kind:ident, $number:expr;)*) => { $(
        impl OptionValue for $type {
            fn declare(&self, default: &Self, option: DeclaredOption, options: &mut Vec<DeclaredOption>) {
                let kind = OptionKind::$kind;
                let [value, default] = [self, default].map(in_json);
                let number: fn(&Self) -> Option<f64> = $number;
                let number = number(self);
                options.push(DeclaredOption { kind, default, value, number, ..option });
            }
        }
    )* };
}
option_values! {
    f64: Number, |v| Some(*v);
    f32: Number, |v| Some(f64::from(*v));
    Option<f64>: Number, |v| *v;
    usize: Integer, |v| Some(*v as f64);
    bool: Boolean, |_| None;
}

impl<M: Method> OptionValue for M {
    fn declare(&self, default: &Self, option: DeclaredOption, options: &mut Vec<DeclaredOption>) {
        let [value, default] = [self, default].map(|method| method.name().into());
        let (kind, choices) = (OptionKind::Choice, choices::<M>());
        options.push(DeclaredOption { kind, default, value, choices, ..option });
    }
}

/// Returns the names and help texts of all methods of the enum `M`, from the cheapest to the most expensive.
pub fn choices<M: Method>() -> Vec<OptionChoice> {
    M::ALL.iter().map(|m| OptionChoice { name: m.name(), help: m.help() }).collect()
}

/// Returns the smallest and the largest value of a range, in this order.
pub fn limits<T: Into<f64>>(range: RangeInclusive<T>) -> [f64; 2] {
    let (min, max) = range.into_inner();
    [min.into(), max.into()]
}

/// Declares a struct of options. A line such as `cameras: usize [1..=1000, "cameras"] = 3,` declares an option with its
/// type, range, unit and default. The comment above the line becomes the option's help text.
///
/// A field of an enum type or of type `bool` has no range. A field whose type is another struct of options has no
/// default.
macro_rules! options {
    (
        $(#[doc = $about:literal])*
        pub struct $name:ident { $(
            $(#[doc = $help:literal])*
            $field:ident: $type:ty $([$range:expr, $unit:literal])? $(= $default:expr)?,
        )* }
    ) => {
        $(#[doc = $about])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $name {
            $($(#[doc = $help])* pub $field: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $crate::option::options!(@ $($default)?),)* }
            }
        }

        impl $crate::option::OptionValue for $name {
            fn declare(
                &self,
                default: &Self,
                group: $crate::option::DeclaredOption,
                options: &mut Vec<$crate::option::DeclaredOption>,
            ) {
                let dot = if group.name.is_empty() { "" } else { "." };
                $(
                    #[allow(unused_mut)]
                    let mut option = $crate::option::DeclaredOption::new(
                        format!("{}{dot}{}", group.name, stringify!($field)),
                        concat!($($help, "\n"),*),
                    );
                    $(
                        option.range = Some($crate::option::limits($range));
                        option.unit = Some($unit);
                    )?
                    $crate::option::OptionValue::declare(&self.$field, &default.$field, option, options);
                )*
            }
        }
    };
    (@) => { Default::default() };
    (@ $default:expr) => { $default };
}
pub(crate) use options;
