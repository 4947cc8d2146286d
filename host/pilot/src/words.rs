//! Enumerations whose values have one word each.

/// Declares an enumeration: each value once, with its number in records, which never changes its
/// meaning, and its word. The documentation of a value is data: what a reason means to an operator
/// is there, before `Effect:` and `Remedy:`.
#[macro_export]
#[doc(hidden)]
macro_rules! words {
    (
        $(#[$about:meta])*
        pub enum $name:ident {
            $( $(#[doc = $documentation:literal])+ $value:ident = $number:literal $word:literal, )*
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $( $(#[doc = $documentation])+ $value = $number, )*
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

        impl core::fmt::Display for $name {
            fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                formatter.write_str(self.name())
            }
        }
    };
}

pub(crate) use words;
