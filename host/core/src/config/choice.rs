//! Keys whose value is one of a few texts.

/// Declares the texts that a key may have, as an enumeration, and with `=>` that of the
/// same variants that it converts from and to.
macro_rules! choice {
    (
        $(#[doc = $help:literal])+
        $vis:vis $name:ident $(=> $inner:ident)?;
        $($(#[doc = $variant_help:literal])+ $variant:ident = $text:literal $(or $alias:literal)?;)+
    ) => {
        $(#[doc = $help])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        $vis enum $name {
            $(
                $(#[doc = $variant_help])+
                #[serde(rename = $text)]
                $(#[serde(alias = $alias)])?
                $variant,
            )+
        }

        impl $crate::config::value::Typed for $name {
            const TYPE: &'static str = concat!($(", \"", $text, "\""),+);
        }

        choice! { @convert [$($inner)?] $name $($variant)+ }
    };
    (@convert [] $($rest:tt)+) => {};
    (@convert [$inner:ident] $name:ident $($variant:ident)+) => {
        impl $crate::config::value::Convert<$inner> for $name {
            fn to_inner(self, _: &str) -> $inner {
                match self {
                    $(Self::$variant => $inner::$variant,)+
                }
            }

            fn from_inner(inner: $inner, _: &str) -> Self {
                match inner {
                    $($inner::$variant => Self::$variant,)+
                }
            }
        }
    };
}

pub(super) use choice;
