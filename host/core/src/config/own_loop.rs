//! Outer loops of other crates: which a program links, and which one `[outer_loop]` names.

use core::fmt::Debug;
use std::sync::OnceLock;

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use singletrack_control::{BoxedLoop, OuterLoop};
use singletrack_settings::{Declared, ValueError, explain_table};
use toml::Table;

use super::{ConfigError, LoopModel};

/// An outer loop of another crate, which `[outer_loop]` of kind "own" names.
pub trait OwnLoop: OuterLoop + Clone + Debug + PartialEq + Send + Sync + 'static {
    /// Its name, in configurations and comparisons.
    const NAME: &'static str;

    /// Its version, which is in every record: no other one repeats the drive. As a rule
    /// `env!("CARGO_PKG_VERSION")`.
    const VERSION: &'static str;

    /// The keys of `[outer_loop.own]`, declared with [`section!`](singletrack_settings::section).
    /// In comparisons each has its default.
    type Settings: Declared + DeserializeOwned;

    /// The loop with these settings, whose ranges have been checked, around the rest of the
    /// controller.
    ///
    /// # Errors
    ///
    /// A value with which it can't drive.
    fn new(settings: Self::Settings, model: &LoopModel<'_>) -> Result<Self, ValueError>;
}

/// The type of an [`OwnLoop`], as a value.
#[derive(Clone, Copy, Debug)]
pub struct OwnLoopKind {
    /// See [`OwnLoop::NAME`].
    pub name: &'static str,
    /// See [`OwnLoop::VERSION`].
    pub version: &'static str,
    make: fn(&Table, &LoopModel<'_>) -> Result<BoxedLoop, ConfigError>,
}

impl OwnLoopKind {
    /// The kind of this loop.
    pub const fn of<L: OwnLoop>() -> Self {
        Self {
            name: L::NAME,
            version: L::VERSION,
            make: make::<L>,
        }
    }
}

fn make<L: OwnLoop>(keys: &Table, model: &LoopModel<'_>) -> Result<BoxedLoop, ConfigError> {
    let settings: Result<L::Settings, _> = keys.clone().try_into();
    let settings = settings
        .map_err(|error| ConfigError::Text(format!("outer_loop.own.{}", explain_table(&error))))?;
    settings.check()?;
    Ok(BoxedLoop::new(L::new(settings, model)?))
}

/// What this process has linked. A configuration is read in many places, from the start of the daemon to
/// the drives of a campaign, and means the same in all of them.
static LINKED: OnceLock<Vec<OwnLoopKind>> = OnceLock::new();

/// Makes loops of other crates known to every configuration that this process reads. Only the first
/// call has an effect: it is the first thing that `main` does.
pub fn link_own_loops(kinds: impl Into<Vec<OwnLoopKind>>) {
    LINKED.get_or_init(|| kinds.into());
}

/// The loops of other crates that this process has linked.
pub fn own_loops() -> &'static [OwnLoopKind] {
    LINKED.get().map_or(&[], Vec::as_slice)
}

/// A loop of another crate, as `[outer_loop]` names it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OwnLoopSection {
    /// Its name.
    pub name: String,
    /// Its version; empty if this program does not have it.
    pub version: String,
    /// Its settings, as far as they are given.
    pub own: Table,
}

impl OwnLoopSection {
    /// The loop of this name in this program, with these settings. Without a version it is the
    /// program's.
    pub fn new(name: String, version: Option<String>, own: Option<Table>) -> Self {
        let known = || own_loops().iter().find(|kind| kind.name == name);
        let version = version.or_else(|| Some(known()?.version.to_owned()));
        Self {
            version: version.unwrap_or_default(),
            own: own.unwrap_or_default(),
            name,
        }
    }

    pub(super) fn make(&self, model: &LoopModel<'_>) -> Result<BoxedLoop, ConfigError> {
        let Self { name, version, own } = self;
        let wanted = format!("{name} {version}");
        let wanted = wanted.trim_end();
        let Some(kind) = own_loops().iter().find(|kind| kind.name == name) else {
            let known: Vec<_> = own_loops().iter().map(|kind| kind.name).collect();
            let known = match known.as_slice() {
                [] => "no loop of another crate".to_owned(),
                known => format!("only {}", known.join(", ")),
            };
            let fix = format!("this program has {known}; use the one that was built with {wanted}");
            return Err(ConfigError::value("outer_loop.name", name, fix));
        };
        if kind.version != version {
            let fix = format!(
                "this program has {name} {}; use the one that was built with {wanted}, or leave \
                 the key out of a file to drive with this one",
                kind.version
            );
            return Err(ConfigError::value("outer_loop.version", version, fix));
        }
        (kind.make)(own, model)
    }
}
