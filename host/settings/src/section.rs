//! One declaration for each section: what a key is called, its type, default, range and
//! meaning stand once.
//!
//! From [`section!`](crate::section) follow the struct, its reading (unknown keys are refused), its
//! defaults, the check of its ranges, the conversion to the struct that it is for, and the
//! description, from which come example files, pages and the list of keys that take a restart.
//!
//! Serde reads a section whose `kind` says which keys it has as an enumeration by itself, but its
//! messages then lack line and key. So all keys are read first, into a section of optional keys,
//! which is converted.

use core::{fmt::Display, marker::PhantomData};

use serde::{
    Deserialize, Deserializer, Serialize,
    de::{self, DeserializeOwned},
};
use toml::{Table, Value};

use crate::ValueError;

/// What a section of the configuration is.
#[derive(Clone, Copy, Debug)]
pub struct Section {
    /// Its name in the file, as `motion_capture.pose`.
    pub name: &'static str,
    /// What it is for.
    pub help: &'static str,
    /// Whether a change of any of its keys takes a restart.
    pub restart: bool,
    /// Its keys, in the order of the file.
    pub keys: &'static [Key],
}

/// What a key of the configuration is.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Its name in the section.
    pub name: &'static str,
    /// Its type in Rust.
    pub kind: &'static str,
    /// The words that it may be; empty if it is not an enumeration.
    pub words: fn() -> Vec<&'static str>,
    /// Its range, as written in the declaration; empty if the type is the limit.
    pub range: &'static str,
    /// What it means.
    pub help: &'static str,
    /// Whether a change takes a restart.
    pub restart: bool,
    /// Whether the section needs it.
    pub mandatory: bool,
    /// Its default; none if the key is mandatory or left out by default.
    pub default: fn() -> Option<Value>,
    /// Its value in the example file, if that is not the default.
    pub example: fn() -> Option<Value>,
}

/// What [`section!`](crate::section) declares.
pub trait Declared {
    /// The description.
    const SECTION: Section;

    /// Refuses a value outside its range.
    ///
    /// # Errors
    ///
    /// The first such value.
    fn check(&self) -> Result<(), ValueError>;
}

/// A section that stands for the struct `T` of another crate.
pub trait Maps<T> {
    /// The struct with the values of this section, and the others as they are.
    fn apply_to(&self, inner: T) -> T;
}

/// A default or an example as TOML; none for a key that is left out.
pub fn toml_value<T: Serialize>(value: Option<T>) -> Option<Value> {
    value.and_then(|value| Value::try_from(value).ok())
}

/// The value that is written, or else the default.
///
/// # Errors
///
/// There is neither.
pub fn or_default<T, E: de::Error>(
    written: Option<T>,
    default: Option<T>,
    key: &'static str,
) -> Result<T, E> {
    written.or(default).ok_or_else(|| E::missing_field(key))
}

/// A `T` that is read as a `K`.
#[derive(Debug)]
pub struct Via<K, T>(pub T, PhantomData<K>);

impl<'de, K: Deserialize<'de>, T: TryFrom<K, Error: Display>> Deserialize<'de> for Via<K, T> {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        let value = T::try_from(K::deserialize(source)?).map_err(de::Error::custom)?;
        Ok(Self(value, PhantomData))
    }
}

/// Declares a section.
///
/// ```text
/// section! {
///     /// What the section is for.
///     "name", restart => pub NameSection: Copy;   // a change of any key takes a restart
///     [maps Inner = Inner::paper()];              // converts from and to this struct
///
///     /// What the key means.
///     @restart hold_ms: u32 = 300 => hold, in 20..=900, example 200;
/// }
/// ```
///
/// A key's default stands after `=`, or is that of the inner struct's field after `=>`; a key
/// with neither is mandatory. A range may name other keys of the section; a range that other
/// code checks is a `text`. `otherwise` states the default of an optional key that some kinds
/// of the section have, `words E` that the key is the enumeration `E`, and `from K` that it is read
/// as the section `K` and converted. The second line may
/// instead be `[maps Inner]` (no defaults from there), `[default]` (implements `Default`),
/// `[new]` (a constructor from the mandatory keys), or `[]`.
#[macro_export]
macro_rules! section {
    (
        $(#[doc = $help:literal])+
        $name:literal $(, $restart:ident)? => $vis:vis $section:ident $(: $($derive:ident),+)?;
        $extra:tt;
        $(
            $(#[doc = $key_help:literal])+
            $(@$key_restart:ident)? $key:ident: $type:ty $(= $default:expr)? $(=> $inner:ident)?
            $(, from $from:ident)? $(, in $range:expr)? $(, text $text:literal)?
            $(, words $words:ident)? $(, otherwise $otherwise:expr)?
            $(, example $example:expr)?;
        )+
    ) => {
        $(#[doc = $help])+
        #[derive(Clone, Debug, PartialEq, serde::Serialize, $($($derive),+)?)]
        $vis struct $section {
            $($(#[doc = $key_help])+ $vis $key: $type,)+
        }

        const _: () = {
            use $crate::*;

            impl<'de> serde::Deserialize<'de> for $section {
                fn deserialize<D: serde::Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
                    let written = {
                        // Of the same name, which a message about the type states.
                        #[derive(serde::Deserialize)]
                        #[serde(deny_unknown_fields)]
                        struct $section {
                            $($key: Option<$crate::section!(@written $type $(, $from)?)>,)+
                        }
                        $section::deserialize(source)?
                    };
                    Ok(Self {
                        $($key: or_default(
                            $crate::section!(@read (written.$key) $(, $from)?),
                            $crate::section!(@default $extra [$($default)?] [$($inner)?] $key),
                            stringify!($key),
                        )?,)+
                    })
                }
            }

            impl Declared for $section {
                const SECTION: Section = Section {
                    name: $name,
                    help: concat!($($help),+),
                    restart: $crate::section!(@is $($restart)?),
                    keys: &[$(Key {
                        name: stringify!($key),
                        kind: stringify!($type),
                        words: || $crate::section!(@words $($words)?),
                        range: concat!($(stringify!($range),)? $($text)?),
                        help: concat!($($key_help),+),
                        restart: $crate::section!(@is $($key_restart)?),
                        mandatory: $crate::section!(@mandatory $extra [$($default)?] [$($inner)?]),
                        default: || {
                            let default: Option<$type> =
                                $crate::section!(@default $extra [$($default)?] [$($inner)?] $key);
                            toml_value(default)$(.or(toml_value(Some($otherwise))))?
                        },
                        example: || None$(.or(toml_value(Some($example))))?,
                    }),+],
                };

                #[allow(clippy::clone_on_copy, reason = "not every section is Copy")]
                fn check(&self) -> Result<(), ValueError> {
                    // The names that a range may refer to.
                    let Self { $($key),+ } = self.clone();
                    $($crate::section!(@check concat!($name, ".", stringify!($key)), $key $(, $range)?);)+
                    Ok(())
                }
            }

            $crate::section! { @extra $extra $section $($key: $type, [$($default)?] [$($inner)?];)+ }
        };
    };

    // What is read of a key, and its value.
    (@written $type:ty) => { $type };
    (@written $type:ty, $from:ident) => { Via<$from, $type> };
    (@read ($written:expr)) => { $written };
    (@read ($written:expr), $from:ident) => { $written.map(|via| via.0) };

    // A default as an option: what is written here, the inner struct's, or none.
    (@default $extra:tt [$default:expr] $inner:tt $key:ident) => { Some($default) };
    (@default [maps $type:ty = $base:expr] [] [$inner:ident] $key:ident) => {
        Some(Convert::from_inner($base.$inner, stringify!($key)))
    };
    (@default $extra:tt [] $inner:tt $key:ident) => { None };

    (@mandatory $extra:tt [$default:expr] $inner:tt) => { false };
    (@mandatory [maps $type:ty = $base:expr] [] [$inner:ident]) => { false };
    (@mandatory $extra:tt [] $inner:tt) => { true };

    (@check $path:expr, $key:ident) => { let _ = $key; };
    (@check $path:expr, $key:ident, $range:expr) => { check($path, &$key, &$range)?; };

    (@words) => { Vec::new() };
    (@words $words:ident) => { $words::ALL.map($words::name).to_vec() };

    (@is) => { false };
    (@is restart) => { true };

    // What the second line asks for.
    (@extra [] $($rest:tt)+) => {};
    (@extra [default] $section:ident $($key:ident: $type:ty, [$default:expr] [];)+) => {
        impl Default for $section {
            fn default() -> Self {
                Self { $($key: $default,)+ }
            }
        }
    };
    (@extra [maps $type:ty = $base:expr] $section:ident
        $($key:ident: $t:ty, [$($default:expr)?] [$($inner:ident)?];)+
    ) => {
        impl Default for $section {
            fn default() -> Self {
                let base = $base;
                Self { $($key: $crate::section!(@initial base [$($default)?] [$($inner)?] $key),)+ }
            }
        }

        impl Maps<$type> for $section {
            fn apply_to(&self, mut inner: $type) -> $type {
                $($(inner.$inner = Convert::to_inner(self.$key, stringify!($key));)?)+
                inner
            }
        }
    };
    (@initial $base:ident [$default:expr] [] $key:ident) => { $default };
    (@initial $base:ident [] [$inner:ident] $key:ident) => {
        Convert::from_inner($base.$inner, stringify!($key))
    };
    (@extra [maps $type:ident] $section:ident
        $($key:ident: $t:ty, [$($default:expr)?] [$inner:ident];)+
    ) => {
        impl Convert<$type> for $section {
            fn to_inner(self, _: &str) -> $type {
                $type { $($inner: Convert::to_inner(self.$key, stringify!($key)),)+ }
            }

            fn from_inner(inner: $type, _: &str) -> Self {
                Self { $($key: Convert::from_inner(inner.$inner, stringify!($key)),)+ }
            }
        }
    };
    // A constructor: its parameters are the keys without a default.
    (@extra [new] $section:ident $($keys:tt)+) => {
        $crate::section! { @new $section [] [] $($keys)+ }
    };
    (@new $section:ident [$($parameters:tt)*] [$($fields:tt)*]
        $key:ident: $type:ty, [] []; $($rest:tt)*
    ) => {
        $crate::section! {
            @new $section [$($parameters)* $key: impl Into<$type>,] [$($fields)* $key: $key.into(),]
            $($rest)*
        }
    };
    (@new $section:ident $parameters:tt [$($fields:tt)*]
        $key:ident: $type:ty, [$default:expr] []; $($rest:tt)*
    ) => {
        $crate::section! { @new $section $parameters [$($fields)* $key: $default,] $($rest)* }
    };
    (@new $section:ident [$($parameters:tt)+] [$($fields:tt)+]) => {
        impl $section {
            /// The section with its mandatory keys, and the default of every other.
            pub fn new($($parameters)+) -> Self {
                Self { $($fields)+ }
            }
        }
    };
}

/// The keys that are written, of a section `T` of optional keys.
#[derive(Debug)]
pub struct Written {
    section: &'static str,
    keys: Table,
}

impl Written {
    /// The keys of this section.
    ///
    /// # Errors
    ///
    /// A path is not UTF-8.
    pub fn of<T: Declared + Serialize>(section: &T) -> Result<Self, String> {
        Ok(Self {
            section: T::SECTION.name,
            keys: Table::try_from(section).map_err(|error| error.to_string())?,
        })
    }

    fn kind(&self) -> &str {
        let kind = self.keys.get("kind").and_then(Value::as_str);
        kind.unwrap_or_default()
    }

    /// A key that the kind has.
    ///
    /// # Errors
    ///
    /// It is missing.
    pub fn need<T>(&self, key: &str, value: Option<T>) -> Result<T, String> {
        value.ok_or_else(|| {
            let (section, kind) = (self.section, self.kind());
            format!("{section}.{key} is missing: kind = \"{kind}\" needs it")
        })
    }

    /// The settings of a kind, whose keys are those of `T`, of all those of `Keys`.
    ///
    /// # Errors
    ///
    /// The first other key.
    pub fn settings<Keys, T>(mut self) -> Result<T, String>
    where
        Keys: Declared,
        T: Default + Serialize + DeserializeOwned,
    {
        self.only_of::<Keys>(T::default())?;
        self.keys.remove("kind");
        self.keys.try_into().map_err(|error| error.to_string())
    }

    /// Refuses a key of `T` that the section as converted does not have.
    ///
    /// # Errors
    ///
    /// The first such key.
    pub fn only_of<T: Declared>(&self, converted: impl Serialize) -> Result<(), String> {
        let known = Table::try_from(converted).map_err(|error| error.to_string())?;
        let surplus =
            |key: &str| key != "kind" && self.keys.contains_key(key) && !known.contains_key(key);
        match T::SECTION.keys.iter().find(|key| surplus(key.name)) {
            Some(key) => Err(format!(
                "{}.{} is no key of kind = \"{}\": remove it, or choose another kind",
                self.section,
                key.name,
                self.kind()
            )),
            None => Ok(()),
        }
    }
}

/// Refuses values outside their ranges in `T`, from which the section was converted.
///
/// # Errors
///
/// The first such value.
pub fn check_kind<T: Declared + DeserializeOwned>(
    converted: impl Serialize,
) -> Result<(), ValueError> {
    match Value::try_from(converted).map(Value::try_into::<T>) {
        Ok(Ok(keys)) => keys.check(),
        // A path that is not UTF-8: all else was read from such a value.
        _ => Ok(()),
    }
}
