//! Methods: alternative algorithms for a pipeline stage, which the user chooses by name.

/// An enum of alternatives that the user chooses by name, such as the methods of a pipeline stage. Each variant has a
/// name and a line of help.
///
/// The name is the same in options files, on the command line and in reports.
pub trait Method: Copy + Default + PartialEq + Send + Sync + 'static {
    /// All methods, from the cheapest to the most expensive.
    const ALL: &'static [Self];

    /// Returns the method's name: lower-case words joined by hyphens.
    fn name(self) -> &'static str;

    /// Returns one line of help, which describes the method.
    fn help(self) -> &'static str;

    /// Returns the method with this name. `None` if no method has this name.
    fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|method| method.name() == name)
    }

    /// Returns the names of all methods, from the cheapest to the most expensive.
    fn names() -> Vec<&'static str> {
        Self::ALL.iter().map(|method| method.name()).collect()
    }
}

/// Implements [`Method`] for an enum. Each line of the argument gives a variant, its name and its help. Variants are
/// listed from the cheapest to the most expensive.
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
