//! Enumerations whose values have one word each.

/// Declares an enumeration: each value once, with its word. The documentation of a value is data: what
/// it means to an operator is there, before `Effect:` and `Remedy:`.
macro_rules! words {
    (
        $(#[$about:meta])*
        pub enum $name:ident {
            $( $(#[doc = $documentation:literal])+ $value:ident = $word:literal, )*
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name {
            $( $(#[doc = $documentation])+ $value, )*
        }

        impl $name {
            /// All values.
            pub const ALL: [Self; [$($name::$value,)*].len()] = [$(Self::$value,)*];

            /// The word for this value in status, log, record and documentation.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$value => $word,)*
                }
            }

            /// The documentation of this value, in Markdown.
            #[must_use]
            pub const fn documentation(self) -> &'static str {
                match self {
                    $(Self::$value => concat!($($documentation, "\n"),+),)*
                }
            }
        }
    };
}

pub(crate) use words;
