//! Enumerations whose values have a word each: in a file, a message, a record or a page. Crates
//! that do not depend on this one have the same file.

/// Declares an enumeration: each value once, with its word.
///
/// ```text
/// words! {
///     /// How a car stops.
///     pub enum Stop {
///         /// It rolls out.
///         Coast = 1 "coast",
///         /// It brakes.
///         Brake = 2 "brake",
///     }
/// }
///
/// assert_eq!(Stop::ALL.map(Stop::name), ["coast", "brake"]);
/// assert_eq!(Stop::named("brake"), Some(Stop::Brake));
/// assert_eq!(Stop::Brake as u8, 2);
/// assert_eq!(Stop::Brake.documentation().trim(), "It brakes.");
/// ```
///
/// From it follow `ALL`, `name`, `named`, `documentation`, and
/// [`Display`](core::fmt::Display). The numbers may be left out.
///
/// `enum Stop: serde` reads and writes the words with serde, which the crate must depend on. The values
/// may have other attributes than their documentation.
#[doc(hidden)]
#[macro_export]
macro_rules! words {
    (
        $(#[$about:meta])*
        $vis:vis enum $name:ident {
            $( $(#[$($attribute:tt)*])* $value:ident = $word:literal, )+
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        $vis enum $name {
            $( $(#[$($attribute)*])* $value, )+
        }

        $crate::words! { @words $vis $name $( $(#[$($attribute)*])* $value = $word, )+ }
    };

    (
        $(#[$about:meta])*
        $vis:vis enum $name:ident {
            $( $(#[$($attribute:tt)*])* $value:ident = $number:literal $word:literal, )+
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        $vis enum $name {
            $( $(#[$($attribute)*])* $value = $number, )+
        }

        $crate::words! { @words $vis $name $( $(#[$($attribute)*])* $value = $word, )+ }
    };

    (
        $(#[$about:meta])*
        $vis:vis enum $name:ident: serde {
            $( $(#[$($attribute:tt)*])* $value:ident = $word:literal, )+
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        $vis enum $name {
            $( $(#[$($attribute)*])* #[serde(rename = $word)] $value, )+
        }

        $crate::words! { @words $vis $name $( $(#[$($attribute)*])* $value = $word, )+ }
    };

    (
        @words $vis:vis $name:ident
        $( $(#[$($attribute:tt)*])* $value:ident = $word:literal, )+
    ) => {
        impl $name {
            /// All values, in the order of their declaration.
            $vis const ALL: [Self; [$($name::$value),+].len()] = [$(Self::$value),+];

            /// The word for this value in status, log, record and documentation.
            #[must_use]
            $vis const fn name(self) -> &'static str {
                match self {
                    $(Self::$value => $word,)+
                }
            }

            /// The value with this word.
            #[must_use]
            $vis fn named(word: &str) -> Option<Self> {
                Self::ALL.into_iter().find(|value| value.name() == word)
            }

            /// The documentation of this value, in Markdown.
            #[must_use]
            #[allow(dead_code, reason = "not every enumeration is documented to a reader")]
            $vis const fn documentation(self) -> &'static str {
                match self {
                    $(Self::$value => concat!($($crate::words!(@line $($attribute)*)),*),)+
                }
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                formatter.write_str(self.name())
            }
        }
    };

    (@line doc = $line:literal) => { concat!($line, "\n") };
    (@line $($other:tt)*) => { "" };
}
