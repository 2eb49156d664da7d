//! The methods of a stage: what a user chooses among by name.

/// One stage's methods (or another choice among few), each with its name and a line of help.
///
/// The name is what stands in option files, on the command line and in reports. Serde's names are the
/// same; [`crate::options`] tests that.
pub trait Method: Copy + Default + PartialEq + Send + Sync + 'static {
    /// All of them, the cheapest first.
    const ALL: &'static [Self];

    /// The name: lower case, words joined by hyphens.
    fn name(self) -> &'static str;

    /// One line that says what the method does.
    fn help(self) -> &'static str;

    /// The method of that name; `None` if there is none.
    fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|method| method.name() == name)
    }

    /// All names, the cheapest method's first.
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
