//! `cargo deb`: Debian packages for this machine and for ARM computers.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    notes::{self, VERSION},
    options,
    prerequisites::Part,
    process::{At as _, Result, check, command, failure, require, silent, text},
    programs::{INSTALLED, NODE, Packages, program_options, release_build},
    target,
    toolchain::{AARCH64, ARMHF, Target},
    uno,
    workspace::{root, script},
};

pub(crate) const USAGE: &str = "\
usage: cargo deb [--target ARCHITECTURE]

Build the Debian packages singletrack and singletrack-ros, check them with lintian, run their
programs, and print their paths in target/debian/. Installs missing Debian packages.

  --target ARCHITECTURE   amd64, arm64 or armhf [default: that of this machine]; programs for
                          another architecture run in an emulator
  -h, --help              print this help
";

/// For a package that is to be installed; and for one that is only checked: a third larger, in an
/// eighth of the time.
const SMALL: &str = "6";
const FAST: &str = "1";

/// Debian's build profile that leaves out the package of the node.
const WITHOUT_NODE: &str = "pkg.singletrack.noros";

/// What a package is made for.
struct Architecture {
    /// Debian's name.
    name: String,
    /// If it is not that of this machine.
    foreign: Option<Target>,
}

impl Architecture {
    /// The one of this name, or that of this machine.
    fn find(name: Option<&str>) -> Result<Self> {
        let this = text(&mut command("dpkg --print-architecture"))?;
        let this = this.trim().to_owned();
        let name = name.unwrap_or(&this).to_owned();
        let mut others = [ARMHF, AARCH64].into_iter();
        let foreign = others.find(|other| other.architecture == name && name != this);
        let known = name == this && ["amd64", "arm64", "armhf"].contains(&this.as_str());
        require!(
            known || foreign.is_some(),
            "no package for {name:?} on {this}: it is made for arm64 and armhf, and for amd64 on \
             such a machine"
        );
        Ok(Self { name, foreign })
    }

    /// Builds the programs and returns their folder. The node is built apart: it must not change the
    /// features of the others' libraries.
    fn build(&self) -> Result<PathBuf> {
        let mut folder = PathBuf::new();
        for programs in [&INSTALLED[..], &[NODE]] {
            let mut cargo;
            (cargo, folder) = match self.foreign {
                None => release_build()?,
                Some(foreign) => foreign.build("release")?,
            };
            check(cargo.args(program_options(programs)).stdout(Stdio::null()))?;
        }
        Ok(folder)
    }

    /// Makes the packages in `target/debian`, which holds nothing but packages, and checks them;
    /// returns their paths. That of the node is left out of a check.
    fn pack(&self, programs: &Path, image: Option<&Path>, has_node: bool) -> Result<Vec<PathBuf>> {
        let folder = target::folder()?;
        let packages = folder.join("debian");
        let stage = folder.join("debian-stage").join(&self.name);
        let date = notes::newest()?.date;
        let mut lay_out = script("xtask/src/debian.sh");
        lay_out.args([&stage, &packages]);
        silent(lay_out.args([&self.name, VERSION, date.as_deref().unwrap_or("now")]))?;
        let mut contents = vec![("singletrack", &INSTALLED[..])];
        if has_node {
            contents.push((NODE.0, &[NODE]));
        }
        let triples = self.foreign.map(|foreign| foreign.triple);
        for (package, programs) in &contents {
            let licences = notes::licences(programs, triples.as_slice())?;
            let file = stage.join(package).join("libraries.txt");
            fs::write(&file, licences).at(&file)?;
        }
        let profiles = if has_node { "" } else { WITHOUT_NODE };
        let emulator = self.foreign.map(|foreign| foreign.emulator());
        let mut pack = Command::new("dpkg-architecture");
        silent(
            pack.current_dir(&stage)
                .env("DEB_RULES_REQUIRES_ROOT", "no")
                // There is nothing to test.
                .env("DEB_BUILD_OPTIONS", "nocheck")
                .env("DEB_BUILD_PROFILES", profiles)
                .env("COMPRESSION", if has_node { SMALL } else { FAST })
                .env("SOURCE", root())
                .env("PROGRAMS", programs)
                .env("EMULATOR", emulator.unwrap_or_default())
                .env("IMAGE", image.unwrap_or(Path::new("")))
                .args(["--host-arch", &self.name, "--force"])
                .args(["--command", "debian/rules", "binary", "inspect"]),
        )?;
        let file = |(package, _): &(&str, _)| {
            packages.join(format!("{package}_{VERSION}_{}.deb", self.name))
        };
        Ok(contents.iter().map(file).collect())
    }
}

pub(crate) fn main(arguments: &[String]) -> Result {
    for package in make(parse(arguments)?)? {
        println!("{}", package.display());
    }
    Ok(())
}

/// Makes the packages for an architecture, or for this machine, and returns their paths.
pub(crate) fn make(name: Option<&str>) -> Result<Vec<PathBuf>> {
    let architecture = Architecture::find(name)?;
    let required: &[&str] = match architecture.foreign {
        None => &["debian"],
        Some(ARMHF) => &["debian", "odroid"],
        Some(_) => &["debian", "arm64"],
    };
    let image = uno::ensure(0, required)?.join(uno::IMAGE);
    architecture.pack(&architecture.build()?, Some(&image), true)
}

/// The architecture, if it is named.
fn parse(arguments: &[String]) -> Result<Option<&str>> {
    match options(arguments, &["--target"])[..] {
        [] => Ok(None),
        [("--target", Some(name))] => Ok(Some(name)),
        _ => Err(failure!("unexpected arguments {arguments:?}\n\n{USAGE}")),
    }
}

/// Packs the tested programs for this machine, and checks the package. Without the Arduino's part, the
/// package has no image.
pub(crate) fn verify(packages: &Packages) -> Result {
    let image = packages.has(Part::Uno).then(|| packages.image());
    let image = image.transpose()?.map(|folder| folder.join(uno::IMAGE));
    Architecture::find(None)?
        .pack(&packages.path("")?, image.as_deref(), false)
        .map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(arguments: &[String]) -> Option<&str> {
        parse(arguments).unwrap()
    }

    #[test]
    fn the_architecture_has_two_forms() {
        let words =
            |line: &str| -> Vec<String> { line.split_whitespace().map(str::to_owned).collect() };
        assert_eq!(parsed(&words("--target arm64")), Some("arm64"));
        assert_eq!(parsed(&words("--target=arm64")), Some("arm64"));
        assert_eq!(parsed(&words("")), None);
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
    fn the_library_of_each_exception_is_named_in_the_copyright() {
        let read = |path: &str| std::fs::read_to_string(root().join(path)).unwrap();
        let copyright = read("packaging/debian/copyright");
        let deny = read("deny.toml");
        let (packaged, _elsewhere) = deny.split_once("# Not in the Debian packages:").unwrap();
        let mut named = 0;
        for line in packaged.lines() {
            let Some((_, rest)) = line.split_once("crate = \"") else {
                continue;
            };
            let name = rest.split('"').next().unwrap();
            assert!(copyright.contains(&format!("libraries/{name}/*")), "{name}");
            named += 1;
        }
        assert!(named >= 4, "{named}");
    }
}
