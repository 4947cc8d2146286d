//! What the checks need of a machine. Each prerequisite is judged by trying it: a package
//! that is installed may be too old, and what a package has elsewhere may have come
//! without one.

mod attempt;
mod catalogue;
#[cfg(test)]
mod tests;

use std::fmt::Write as _;

use crate::{
    compiler::{self, AVR},
    debian::{self, Apt},
    machine::Machine,
    process::Failure,
};

pub(crate) use attempt::python;
pub(crate) use catalogue::{IMAGE, ODROID, PROGRAMMER, of_parts};

use catalogue::{IMAGE_CLIPPY, IMAGE_COMPILER, ODROID_COMPILER};

/// A part of the checks that can be left out, with all that it needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// The Arduino's image, and the simulated Arduino that runs it.
    Uno,
    /// The build for the Odroid, emulated.
    Odroid,
    /// The Python readers of records.
    Readers,
    /// systemd's judgement of the service.
    Units,
}

impl Part {
    pub(crate) const ALL: [Self; 4] = [Self::Uno, Self::Odroid, Self::Readers, Self::Units];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Uno => "uno",
            Self::Odroid => "odroid",
            Self::Readers => "readers",
            Self::Units => "units",
        }
    }
}

/// One thing that a machine must be able to do.
#[derive(Clone, Copy)]
pub(crate) struct Prerequisite {
    name: &'static str,
    /// What it must do, for the message.
    needed: &'static str,
    /// Debian 12's packages of it.
    packages: &'static [&'static str],
    /// How to get it where there is no such package.
    otherwise: &'static str,
    /// The part that needs it; `None`: every check does.
    part: Option<Part>,
    /// What was found: in working order, or why not.
    attempt: fn(&Machine) -> Result<String, String>,
}

/// A prerequisite that is not met.
struct Shortfall {
    prerequisite: Prerequisite,
    found: String,
}

/// Tries all of them, installs or upgrades what falls short, tries again, and refuses in
/// one message what still falls short. What was found goes to `report`.
pub(crate) fn ensure(
    machine: &Machine,
    wanted: &[Prerequisite],
    report: &mut dyn FnMut(&str),
) -> Result<(), Failure> {
    let mut tried = Vec::new();
    let short = shortfalls(machine, wanted, &mut |_| {});
    if !packages(machine, &short).is_empty() {
        match Apt::find(machine) {
            Ok(mut apt) => tried = install(machine, wanted, &mut apt, &short),
            Err(why) => tried.push(why),
        }
    }
    // Nothing that was installed is believed.
    let short = shortfalls(machine, wanted, report);
    if short.is_empty() {
        return Ok(());
    }
    Err(Failure::new(message(machine, wanted.len(), &short, &tried)))
}

/// Installs the packages of what falls short; if it still does, once more with the newest
/// lists. Returns what went wrong.
fn install(
    machine: &Machine,
    wanted: &[Prerequisite],
    apt: &mut Apt<'_>,
    short: &[Shortfall],
) -> Vec<String> {
    for one in short {
        eprintln!("{}: {}", one.prerequisite.name, one.found);
    }
    let missing = packages(machine, short);
    eprintln!("Installing Debian packages: {}", missing.join(" "));
    let mut result = apt.install(&missing);
    let left = shortfalls(machine, wanted, &mut |_| {});
    let missing = packages(machine, &left);
    if !missing.is_empty() && !apt.was_refreshed() {
        apt.refresh();
        result = apt.install(&missing);
    }
    if let Err(failure) = &result
        && failure.to_string().contains("Unable to locate package")
    {
        // One that this distribution lacks must not keep the others from coming.
        for one in &left {
            let some = packages(machine, std::slice::from_ref(one));
            if !some.is_empty() {
                let _ = apt.install(&some);
            }
        }
    }
    apt.refresh_error()
        .map(str::to_owned)
        .into_iter()
        .chain(result.err().map(|failure| failure.to_string()))
        .collect()
}

fn shortfalls(
    machine: &Machine,
    wanted: &[Prerequisite],
    report: &mut dyn FnMut(&str),
) -> Vec<Shortfall> {
    wanted
        .iter()
        .filter_map(|one| match (one.attempt)(machine) {
            Ok(found) => {
                report(&format!("{}: {found}", one.name));
                None
            }
            Err(found) => Some(Shortfall {
                prerequisite: *one,
                found,
            }),
        })
        .collect()
}

/// The packages that would help, each once.
fn packages(machine: &Machine, short: &[Shortfall]) -> Vec<&'static str> {
    let mut packages = Vec::new();
    for one in short {
        if !one.prerequisite.comes_with_packages(machine) {
            continue;
        }
        for package in one.prerequisite.packages {
            if !packages.contains(package) {
                packages.push(*package);
            }
        }
    }
    packages
}

impl Prerequisite {
    /// Whether Debian's packages of it help on this machine.
    fn comes_with_packages(&self, machine: &Machine) -> bool {
        let is = |others: &[Self]| others.iter().any(|other| other.name == self.name);
        // A named compiler is not replaced by another.
        if machine.named_compiler.is_some() && is(&[IMAGE_COMPILER, IMAGE_CLIPPY, ODROID_COMPILER])
        {
            return false;
        }
        // Debian's clippy is of no other compiler than Debian's.
        if is(&[IMAGE_CLIPPY])
            && compiler::find(machine, AVR).is_ok_and(|found| !found.is_debians())
        {
            return false;
        }
        !self.packages.is_empty()
    }
}

/// What was found, what is needed, how to get it.
fn message(machine: &Machine, wanted: usize, short: &[Shortfall], tried: &[String]) -> String {
    let mut text = format!("{} of {wanted} prerequisites fall short\n", short.len());
    let indented = |text: &str| text.replace('\n', "\n             ");
    for Shortfall {
        prerequisite,
        found,
    } in short
    {
        let _ = write!(
            text,
            "\n  {}\n    found    {}\n    needed   {}\n",
            prerequisite.name,
            indented(found),
            indented(prerequisite.needed)
        );
        if prerequisite.comes_with_packages(machine) {
            if let Some(installed) = debian::installed(machine, prerequisite.packages) {
                let _ = writeln!(text, "    packages {installed}");
            }
            let _ = writeln!(
                text,
                "    get it   apt-get update && apt-get install {}   (Debian 12)",
                prerequisite.packages.join(" ")
            );
        }
        if !prerequisite.otherwise.is_empty() {
            let _ = writeln!(text, "    get it   {}", indented(prerequisite.otherwise));
        }
    }
    for tried in tried {
        let _ = write!(text, "\n{tried}\n");
    }
    let parts: Vec<&str> = Part::ALL
        .into_iter()
        .filter(|part| short.iter().any(|one| one.prerequisite.part == Some(*part)))
        .map(Part::name)
        .collect();
    text.push_str(
        "\npackaging/Containerfile describes a Debian 12 that has all of it, and how to use it.\n",
    );
    if !parts.is_empty() {
        let _ = writeln!(
            text,
            "Checks that need it can be left out: cargo verify --without {}",
            parts.join(",")
        );
    }
    text
}
