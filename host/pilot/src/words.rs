//! Enumerations whose values have one word each.

/// Declares an enumeration: each value once, with its word.
macro_rules! words {
    (
        $(#[$about:meta])*
        pub enum $name:ident {
            $( $(#[$value_about:meta])* $value:ident = $word:literal, )*
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $( $(#[$value_about])* $value, )*
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
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                formatter.write_str(self.name())
            }
        }
    };
}

pub(crate) use words;
