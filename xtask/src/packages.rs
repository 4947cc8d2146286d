//! Packages built alone. In the workspace's build, a package has the features that all others ask
//! for, which hides missing ones.

use crate::{
    process::{Failure, check},
    target,
    workspace::cargo,
};

/// The packages without I/O, without those of [`PUBLISHED`], which are built alone.
const PURE: [&str; 5] = [
    "singletrack-protocol",
    "singletrack-board",
    "singletrack-pilot",
    "singletrack-link",
    "singletrack-analysis",
];

/// The packages with `publish = true`, each after those that it depends on.
pub(crate) const PUBLISHED: [&str; 3] = [
    "singletrack-words",
    "singletrack-control",
    "singletrack-mocap",
];

/// Packages with fewer features than the workspace builds them with: as `cargo demo` does, and
/// without any.
const FEATURES: [(&str, &str); 2] = [("singletrack", ""), ("singletrack-logs", "")];

/// Checks that the pure packages build without the others, and these without some of their features.
pub(crate) fn check_alone() -> Result<(), Failure> {
    let pure = PURE.iter().flat_map(|package| ["--package", package]);
    check(cargo().args(["check", "--quiet"]).args(pure))?;
    for (package, features) in FEATURES {
        let mut cargo = cargo();
        cargo.args(["check", "--quiet", "--package", package]);
        check(cargo.args(["--no-default-features", "--features", features]))?;
    }
    Ok(())
}

/// Checks that the packages for others can be published: `cargo package` packs each from its
/// `include` list and builds the result outside of the workspace. A file that is not packed, and a
/// dependency without a version, are errors there only.
pub(crate) fn check_published() -> Result<(), Failure> {
    let packages = PUBLISHED.iter().flat_map(|package| ["--package", package]);
    check(
        cargo()
            // The working tree may hold changes. Offline, the versions are those of the workspace,
            // and nothing waits for the registry: `check_alone` has downloaded what they need.
            .args(["package", "--quiet", "--offline", "--allow-dirty"])
            .args(packages)
            // A packed package is a workspace of its own. Its dependencies are built once for all
            // of them, and kept.
            .env("CARGO_TARGET_DIR", target::folder()?),
    )
}

#[cfg(test)]
mod tests {
    use std::fs;

    use crate::workspace;

    use super::*;

    #[test]
    fn every_package_that_may_be_published_is_checked() {
        let root = workspace::find().unwrap();
        let workspace = fs::read_to_string(root.join("Cargo.toml")).unwrap();
        let (_, members) = workspace.split_once("\nmembers = [").unwrap();
        let (members, _) = members.split_once(']').unwrap();
        let mut publishable: Vec<String> = members
            .lines()
            .filter_map(|line| line.trim().strip_prefix('"')?.strip_suffix("\","))
            .filter_map(|member| {
                let manifest = root.join(member).join("Cargo.toml");
                let manifest = fs::read_to_string(manifest).unwrap();
                let name = manifest
                    .lines()
                    .find_map(|line| line.strip_prefix("name = "))
                    .unwrap()
                    .trim_matches('"')
                    .to_owned();
                let publish = manifest.lines().any(|line| line == "publish = true");
                publish.then_some(name)
            })
            .collect();
        publishable.sort();
        let mut published = PUBLISHED;
        published.sort_unstable();
        assert_eq!(publishable, published);
    }
}
