//! Methods of a stage: alternatives that a user chooses by name.

/// Implemented by an enum of alternatives, such as a stage's methods. Each variant has a name and a line of help.
///
/// The name is the same in options files, on the command line and in reports.
pub trait Method: Copy + Default + PartialEq + Send + Sync + 'static {
    /// All methods, cheapest first.
    const ALL: &'static [Self];

    /// The method's name: lower case, words joined by hyphens.
    fn name(self) -> &'static str;

    /// What the method does, in one line.
    fn help(self) -> &'static str;

    /// The method of this name; `None` if no method has it.
    fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|method| method.name() == name)
    }

    /// The names of all methods, cheapest first.
    fn names() -> Vec<&'static str> {
        Self::ALL.iter().map(|method| method.name()).collect()
    }
}

/// Implements [`Method`] for an enum from a table of its variants.
macro_rules! methods {
    ($name:ty { $($variant:ident = $text:literal: $help:literal,)+ }) => {
        impl $crate::method::Method for $name {
            const ALL: &'static [Self] = &[$(Self::$variant),+];

            fn name(self) -> &'static str {
                match self { $(Self::$variant => $text),+ }
            }

            fn help(self) -> &'static str {
                match self { $(Self::$variant => $help),+ }
            }
        }
    };
}
pub(crate) use methods;
