//! Prerequisites of the checks. Each is tested by using it: an installed package
//! may be too old, and a program may have been installed without a package.

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
pub(crate) use catalogue::{
    IMAGE, ODROID, PACKAGE, PACKAGE_ARM64, PACKAGE_ARMHF, PROGRAMMER, of_parts,
};

use catalogue::{ARM64_COMPILER, IMAGE_CLIPPY, IMAGE_COMPILER, ODROID_COMPILER};

/// An optional part of the checks, with its prerequisites.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// The Arduino's image, and the simulated Arduino that runs it.
    Uno,
    /// The build for the Odroid, emulated.
    Odroid,
    /// The Python readers of records.
    Readers,
    /// The Python package.
    Python,
    /// ROS 2 in Python.
    Ros,
    /// Octave, for MATLAB's language.
    Octave,
    /// The daemon's page in a browser.
    Browser,
    /// Campaigns on a cluster.
    Slurm,
    /// systemd's verification of the service.
    Units,
    /// The Debian package.
    Debian,
}

impl Part {
    pub(crate) const ALL: [Self; 10] = [
        Self::Uno,
        Self::Odroid,
        Self::Readers,
        Self::Python,
        Self::Ros,
        Self::Octave,
        Self::Browser,
        Self::Slurm,
        Self::Units,
        Self::Debian,
    ];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Uno => "uno",
            Self::Odroid => "odroid",
            Self::Readers => "readers",
            Self::Python => "python",
            Self::Ros => "ros",
            Self::Octave => "octave",
            Self::Browser => "browser",
            Self::Slurm => "slurm",
            Self::Units => "units",
            Self::Debian => "debian",
        }
    }
}

/// A capability that a machine must have.
#[derive(Clone, Copy)]
pub(crate) struct Prerequisite {
    name: &'static str,
    /// Description for the message.
    needed: &'static str,
    /// Its packages in Debian 12.
    packages: &'static [&'static str],
    /// How to get it without such a package.
    otherwise: &'static str,
    /// The part that needs it; `None` if every check does.
    part: Option<Part>,
    /// The test: a description of what was found, or the reason of failure.
    attempt: fn(&Machine) -> Result<String, String>,
}

/// A prerequisite that is not met.
struct Shortfall {
    prerequisite: Prerequisite,
    found: String,
}

/// Tests all prerequisites, installs or upgrades packages for the failed ones, and
/// tests those again. Fails with one message about all that remain. Descriptions
/// are passed to `report`.
pub(crate) fn ensure(
    machine: &Machine,
    required: &[Prerequisite],
    report: &mut dyn FnMut(&str),
) -> Result<(), Failure> {
    let mut tried = Vec::new();
    let short = shortfalls(machine, required, &mut |_| {});
    if !packages(machine, &short).is_empty() {
        match Apt::find(machine) {
            Ok(mut apt) => tried = install(machine, required, &mut apt, &short),
            Err(why) => tried.push(why),
        }
    }
    // Installed packages are tested again.
    let short = shortfalls(machine, required, report);
    if short.is_empty() {
        return Ok(());
    }
    Err(Failure::new(message(
        machine,
        required.len(),
        &short,
        &tried,
    )))
}

/// Installs the packages of failed prerequisites; if they still fail, once more
/// with refreshed lists. Returns the errors.
fn install(
    machine: &Machine,
    required: &[Prerequisite],
    apt: &mut Apt<'_>,
    short: &[Shortfall],
) -> Vec<String> {
    for one in short {
        eprintln!("{}: {}", one.prerequisite.name, one.found);
    }
    let missing = packages(machine, short);
    eprintln!("Installing Debian packages: {}", missing.join(" "));
    let mut result = apt.install(&missing);
    let left = shortfalls(machine, required, &mut |_| {});
    let missing = packages(machine, &left);
    if !missing.is_empty() && !apt.was_refreshed() {
        apt.refresh();
        result = apt.install(&missing);
    }
    if let Err(failure) = &result
        && failure.to_string().contains("Unable to locate package")
    {
        // A package that this distribution lacks must not prevent the others.
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
    required: &[Prerequisite],
    report: &mut dyn FnMut(&str),
) -> Vec<Shortfall> {
    required
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

/// The distinct packages that would help.
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
    /// Whether its Debian packages help on this machine.
    fn comes_with_packages(&self, machine: &Machine) -> bool {
        let is = |others: &[Self]| others.iter().any(|other| other.name == self.name);
        // A named compiler is not replaced by another.
        let compilers = [
            IMAGE_COMPILER,
            IMAGE_CLIPPY,
            ODROID_COMPILER,
            ARM64_COMPILER,
        ];
        if machine.named_compiler.is_some() && is(&compilers) {
            return false;
        }
        // Debian's clippy works only with Debian's compiler.
        if is(&[IMAGE_CLIPPY])
            && compiler::find(machine, AVR).is_ok_and(|found| !found.is_debians())
        {
            return false;
        }
        !self.packages.is_empty()
    }
}

/// The message: what was found, what is needed, how to get it.
fn message(machine: &Machine, required: usize, short: &[Shortfall], tried: &[String]) -> String {
    let mut text = format!("{} of {required} prerequisites are not met\n", short.len());
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
        "\npackaging/Containerfile describes a Debian 12 image with all of them, and its use.\n",
    );
    if !parts.is_empty() {
        let _ = writeln!(
            text,
            "To skip the checks that need them: cargo verify --without {}",
            parts.join(",")
        );
    }
    text
}
