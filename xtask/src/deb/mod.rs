//! `cargo deb`: Debian packages for this machine and for ARM computers.

mod inspect;
mod pack;

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use pack::Compression::{Fast, Small};

use crate::{
    image::{self, Image},
    prerequisites::{ARM64, EMULATOR, ODROID, PACKAGE},
    process::{Failure, check, output},
    release::Release,
    target,
    toolchain::{AARCH64, ARMHF, Target},
    workspace::{cargo, root},
};

pub(crate) const USAGE: &str = "\
usage: cargo deb [--target ARCHITECTURE]

Build the Debian package, check it with lintian, run its programs, and print its path in
target/debian/. Installs missing Debian packages.

  --target ARCHITECTURE   amd64, arm64 or armhf [default: that of this machine]; programs for
                          another architecture run in an emulator
  -h, --help              print this help
";

/// The programs of the package. Their names, and the packages of the workspace.
const PROGRAMS: [(&str, &str); 4] = [
    ("singletrackd", "singletrackd"),
    ("singletrack", "singletrack"),
    ("singletrack-sim", "singletrack-sim"),
    ("singletrack-newcomer", "singletrack-hil"),
];

/// What a package is made for.
#[derive(Clone, Copy)]
enum Architecture {
    /// This machine; Debian's name.
    Native(&'static str),
    Foreign(Target),
}

/// Debian's names of the architectures.
const NAMES: [&str; 3] = ["amd64", "arm64", "armhf"];

impl Architecture {
    /// The one of this name, or that of this machine.
    fn find(name: Option<&str>) -> Result<Self, Failure> {
        let this = output(Command::new("dpkg").arg("--print-architecture"))?;
        let this = String::from_utf8_lossy(&this).trim().to_owned();
        let name = name.unwrap_or(&this);
        let name = NAMES
            .into_iter()
            .find(|known| *known == name)
            .ok_or_else(|| {
                Failure::new(format!(
                    "no package for {name:?}: the architectures are {}",
                    NAMES.join(", ")
                ))
            })?;
        if name == this {
            return Ok(Self::Native(name));
        }
        [ARMHF, AARCH64]
            .into_iter()
            .find(|foreign| foreign.architecture == name)
            .map(Self::Foreign)
            .ok_or_else(|| Failure::new(format!("a package for {name} is made on {name} only")))
    }

    fn name(self) -> &'static str {
        match self {
            Self::Native(name) => name,
            Self::Foreign(foreign) => foreign.architecture,
        }
    }

    /// A command that runs a program for it.
    fn run(self, program: &Path) -> Command {
        match self {
            Self::Native(_) => Command::new(program),
            Self::Foreign(foreign) => foreign.emulated(program),
        }
    }

    fn triple(self) -> Option<&'static str> {
        match self {
            Self::Native(_) => None,
            Self::Foreign(foreign) => Some(foreign.triple),
        }
    }

    /// Builds the programs and returns their folder.
    fn build(self) -> Result<PathBuf, Failure> {
        let (mut cargo, folder) = match self {
            Self::Native(_) => {
                let mut cargo = cargo();
                cargo.args(["build", "--release"]);
                (cargo, target::folder()?.join("release"))
            }
            Self::Foreign(foreign) => foreign.cargo_build("release")?,
        };
        for (program, package) in PROGRAMS {
            cargo.args(["--package", package, "--bin", program]);
        }
        check(cargo.stdout(Stdio::null()))?;
        Ok(folder)
    }
}

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    let Some(name) = parse(arguments)? else {
        print!("{USAGE}");
        return Ok(());
    };
    let architecture = Architecture::find(name)?;
    let mut required = PACKAGE.to_vec();
    match architecture.name() {
        _ if architecture.triple().is_none() => {}
        "armhf" => required.extend(ODROID.into_iter().chain([EMULATOR])),
        _ => required.extend(ARM64),
    }
    let image = image::ensure(0, &required)?;
    let package = pack::pack(architecture, &architecture.build()?, Some(&image), Small)?;
    inspect::inspect(architecture, &package, true)?;
    println!("{}", package.display());
    Ok(())
}

/// The architecture; `None` for help.
fn parse(arguments: &[String]) -> Result<Option<Option<&str>>, Failure> {
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        [] => Ok(Some(None)),
        ["--help" | "-h"] => Ok(None),
        ["--target", name] => Ok(Some(Some(name))),
        [one] if one.starts_with("--target=") => Ok(Some(one.strip_prefix("--target="))),
        _ => Err(Failure::new(format!(
            "unexpected arguments {arguments:?}\n\n{USAGE}"
        ))),
    }
}

/// Packs the programs of the release build for this machine, and checks the package. Without the
/// Arduino's part, the package has no image.
pub(crate) fn verify(release: Release) -> Result<(), Failure> {
    let image: Option<Image> = release.uno.then(|| release.image()).transpose()?;
    let daemon = release.path("singletrackd")?;
    let programs = daemon.parent().unwrap_or(root());
    let architecture = Architecture::find(None)?;
    let package = pack::pack(architecture, programs, image.as_ref(), Fast)?;
    inspect::inspect(architecture, &package, image.is_some())?;
    println!("{}", package.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(arguments: &[String]) -> Option<Option<&str>> {
        parse(arguments).unwrap()
    }

    #[test]
    fn the_architecture_has_two_forms() {
        let words =
            |line: &str| -> Vec<String> { line.split_whitespace().map(str::to_owned).collect() };
        assert_eq!(parsed(&words("--target arm64")), Some(Some("arm64")));
        assert_eq!(parsed(&words("--target=arm64")), Some(Some("arm64")));
        assert_eq!(parsed(&words("")), Some(None));
        assert_eq!(parsed(&words("--help")), None);
        for line in [
            "arm64",
            "--target",
            "--target arm64 armhf",
            "--traget=arm64",
        ] {
            let why = parse(&words(line)).unwrap_err().to_string();
            assert!(why.contains(USAGE), "{why}");
        }
    }

    #[test]
    fn the_package_has_the_version_of_the_workspace() {
        let read = |path: &str| std::fs::read_to_string(root().join(path)).unwrap();
        let manifest = read("Cargo.toml");
        let version = manifest
            .lines()
            .find_map(|line| line.strip_prefix("version = \"")?.strip_suffix('"'))
            .unwrap();
        let changelog = read("packaging/debian/changelog");
        assert!(
            changelog.starts_with(&format!("singletrack ({version}) ")),
            "{version}: {changelog}"
        );
    }

    #[test]
    fn the_library_of_each_exception_is_named_in_the_copyright() {
        let read = |path: &str| std::fs::read_to_string(root().join(path)).unwrap();
        let copyright = read("packaging/debian/copyright");
        let deny = read("deny.toml");
        // These are compiled into tests or into the compiler only.
        let elsewhere = ["unicode-ident", "amd", "libfuzzer-sys"];
        let mut named = 0;
        for line in deny.lines() {
            let Some((_, rest)) = line.split_once("crate = \"") else {
                continue;
            };
            let name = rest.split('"').next().unwrap();
            if !elsewhere.contains(&name) {
                assert!(copyright.contains(&format!("libraries/{name}/*")), "{name}");
                named += 1;
            }
        }
        assert!(named >= 4, "{named}");
    }
}
