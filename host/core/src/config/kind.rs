//! Sections whose `kind` says which keys they have.
//!
//! Serde can read such a section by itself, but then says neither where nor at
//! which key it is wrong. So all keys are read first, and sorted out here.

use core::fmt::Display;

/// The keys of one kind.
pub(super) struct Keys<'a> {
    pub(super) section: &'static str,
    pub(super) kind: &'a str,
}

impl Keys<'_> {
    /// A key that the kind has.
    pub(super) fn need<T>(&self, key: &str, value: Option<T>) -> Result<T, String> {
        let Self { section, kind } = self;
        value.ok_or_else(|| format!("{section}.{key} is missing: kind = \"{kind}\" needs it"))
    }

    /// A key that the kind has not.
    pub(super) fn refuse<T>(&self, key: impl Display, value: Option<&T>) -> Result<(), String> {
        let Self { section, kind } = self;
        match value {
            None => Ok(()),
            Some(_) => Err(format!(
                "{section}.{key} is no key of kind = \"{kind}\": remove it, or choose another kind"
            )),
        }
    }
}
