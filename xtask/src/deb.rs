//! `cargo deb`: Debian packages for this machine and for ARM computers.

use std::path::{Path, PathBuf};

use crate::{
    notes::{self, VERSION},
    options,
    prerequisites::{AARCH64, ARMHF, Target, release_build},
    process::{Result, command, failure, require, silent, text},
    programs::{INSTALLED, NODE, Packages},
    uno,
    workspace::{emptied, script, target, write},
};

pub(crate) const USAGE: &str = "\
usage: cargo deb [--target ARCHITECTURE]

Build the Debian packages singletrack and singletrack-ros, check them with lintian, run their
programs, and print their paths in target/debian/. Installs missing Debian packages.

  --target ARCHITECTURE   amd64, arm64 or armhf [default: that of this machine]; programs for
                          another architecture run in an emulator
  -h, --help              print this help
";

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
        let options = |(program, package)| ["--package", package, "--bin", program];
        release_build(self.foreign, &INSTALLED.map(options).concat())?;
        release_build(self.foreign, &options(NODE))
    }

    /// Makes the packages in `target/debian`, which holds nothing but packages, and checks them;
    /// returns their paths. That of the node is left out of a check.
    fn pack(&self, programs: &Path, image: Option<&Path>, has_node: bool) -> Result<Vec<PathBuf>> {
        let (name, packages) = (&self.name, target()?.join("debian"));
        let stage = emptied(&format!("debian-stage/{name}"))?;
        let all = [("singletrack", &INSTALLED[..]), (NODE.0, &[NODE])];
        // The build profile leaves out the package of the node.
        let (contents, profile) = match has_node {
            true => (&all[..], ""),
            false => (&all[..1], "pkg.singletrack.noros"),
        };
        let triple = self.foreign.map(|foreign| foreign.triple);
        for (package, programs) in contents {
            let licences = notes::licences(programs, triple.as_slice())?;
            write(&stage.join(package).join("libraries.txt"), licences)?;
        }
        let date = notes::newest()?.date.unwrap_or("now".to_owned());
        let emulator = self.foreign.map(|foreign| foreign.emulator());
        let mut pack = script("xtask/src/debian.sh");
        pack.args([&stage, &packages]);
        pack.args([name, VERSION, &date, profile]);
        pack.env("PROGRAMS", programs);
        pack.env("EMULATOR", emulator.unwrap_or_default());
        silent(pack.env("IMAGE", image.unwrap_or(Path::new(""))))?;
        let file =
            |(package, _): &(&str, _)| packages.join(format!("{package}_{VERSION}_{name}.deb"));
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
    let image = packages.has("uno").then(|| packages.image());
    let image = image.transpose()?.map(|folder| folder.join(uno::IMAGE));
    Architecture::find(None)?
        .pack(&packages.path("")?, image.as_deref(), false)
        .map(drop)
}

#[cfg(test)]
mod tests {
    use crate::workspace::root;

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
