//! The Debian packages that a part of the project needs, and getting them.

use std::{
    fs, io,
    os::unix::fs::MetadataExt,
    process::{Command, Stdio},
};

use crate::step::Failure;

/// Packages that belong together, and what they are for.
pub(crate) struct Purpose {
    what: &'static str,
    packages: &'static [&'static str],
}

/// Compiler, core library and tools for the Arduino's processor: rustup's toolchains
/// have no core library for it, and Debian's compiler comes with its sources.
pub(crate) const IMAGE: Purpose = Purpose {
    what: "to build the Arduino's image",
    packages: &[
        "rustc-web",
        "rust-web-src",
        "gcc-avr",
        "avr-libc",
        "binutils-avr",
    ],
};

/// Clippy of the very compiler that builds the image.
pub(crate) const IMAGE_LINTS: Purpose = Purpose {
    what: "to lint the Arduino's image",
    packages: &["rust-web-clippy"],
};

/// What `singletrack-simavr` links.
pub(crate) const SIMULATOR: Purpose = Purpose {
    what: "to run the Arduino's image in simavr",
    packages: &["libsimavr-dev", "libelf-dev"],
};

/// What compiles for the Odroid and runs the result here.
pub(crate) const ODROID: Purpose = Purpose {
    what: "to build for the Odroid",
    packages: &[
        "rustc-web",
        "rust-web-src",
        "gcc-arm-linux-gnueabihf",
        "libc6-dev-armhf-cross",
        "qemu-user-static",
    ],
};

/// What judges the unit of the service.
pub(crate) const UNITS: Purpose = Purpose {
    what: "to check the service's unit",
    packages: &["systemd"],
};

/// What runs the readers of records that others wrote.
pub(crate) const PYTHON: Purpose = Purpose {
    what: "to read records with Python",
    packages: &["python3", "python3-venv"],
};

/// What writes the image into a board.
pub(crate) const FLASH: Purpose = Purpose {
    what: "to flash the Arduino",
    packages: &["avrdude"],
};

/// Installs what is missing, and says so on stderr.
pub(crate) fn ensure(purposes: &[Purpose]) -> Result<(), Failure> {
    let mut missing = missing(purposes)?;
    if missing.is_empty() {
        return Ok(());
    }
    for purpose in purposes {
        let lacking: Vec<&str> = purpose
            .packages
            .iter()
            .copied()
            .filter(|package| missing.contains(package))
            .collect();
        if !lacking.is_empty() {
            eprintln!(
                "Installing Debian packages {}: {}",
                purpose.what,
                lacking.join(" ")
            );
        }
    }
    install(&missing)?;
    missing = self::missing(purposes)?;
    if missing.is_empty() {
        Ok(())
    } else {
        Err(Failure::new(format!(
            "apt-get installed everything, and still these are missing: {}",
            missing.join(" ")
        )))
    }
}

/// Those of the packages that are not installed, each once.
fn missing(purposes: &[Purpose]) -> Result<Vec<&'static str>, Failure> {
    let mut wanted = Vec::new();
    for package in purposes.iter().flat_map(|purpose| purpose.packages) {
        if !wanted.contains(package) {
            wanted.push(*package);
        }
    }
    let query = Command::new("dpkg-query")
        .args(["--show", "--showformat=${db:Status-Status} ${Package}\n"])
        .args(&wanted)
        .stdin(Stdio::null())
        // It complains about packages that it has never heard of.
        .stderr(Stdio::null())
        .output();
    let answer = match query {
        Ok(output) => output.stdout,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Err(Failure::new(format!(
                "this needs the Debian packages {}, and there is no dpkg-query to look for them: \
                 run it on Debian 12, in a container if need be",
                wanted.join(" ")
            )));
        }
        Err(error) => return Err(Failure::new(format!("dpkg-query does not run: {error}"))),
    };
    Ok(not_installed(&wanted, &String::from_utf8_lossy(&answer)))
}

/// Those of the packages that dpkg-query's answer does not call installed.
fn not_installed<'a>(wanted: &[&'a str], answer: &str) -> Vec<&'a str> {
    wanted
        .iter()
        .copied()
        .filter(|package| {
            !answer
                .lines()
                .any(|line| line.strip_prefix("installed ") == Some(*package))
        })
        .collect()
}

/// Who may install packages.
#[derive(Clone, Copy)]
enum Rights {
    /// This process.
    Root,
    /// sudo, which asks for no password.
    Sudo,
}

fn install(packages: &[&str]) -> Result<(), Failure> {
    let by_hand = format!(
        "sudo apt-get update && sudo apt-get install --no-install-recommends {}",
        packages.join(" ")
    );
    let apt_get_version = Command::new("apt-get")
        .arg("--version")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .status();
    if apt_get_version.is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
        return Err(Failure::new(format!(
            "there is no apt-get to install them with; needed are {}, as Debian 12 has them",
            packages.join(" ")
        )));
    }
    let Some(rights) = rights() else {
        return Err(Failure::new(format!(
            "installing them takes root: type\n\n    {by_hand}\n"
        )));
    };
    let listed = package_lists_are_there();
    if !listed {
        apt_get(rights, &["update"])?;
    }
    let arguments: Vec<&str> = ["install", "--yes", "--no-install-recommends", "--no-remove"]
        .into_iter()
        .chain(packages.iter().copied())
        .collect();
    let mut result = apt_get(rights, &arguments);
    if result.is_err() && listed {
        eprintln!("The package lists may be out of date: trying once more with new ones");
        result = apt_get(rights, &["update"]).and_then(|()| apt_get(rights, &arguments));
    }
    result.map_err(|failure| {
        Failure::new(format!(
            "{failure}\nThe packages are those of Debian 12. To see what is wrong, type\n\n    {by_hand}\n"
        ))
    })
}

/// `None`: nobody who is asked nothing.
fn rights() -> Option<Rights> {
    // The files of a process belong to its effective user.
    if fs::metadata("/proc/self").is_ok_and(|process| process.uid() == 0) {
        return Some(Rights::Root);
    }
    let sudo = Command::new("sudo")
        .args(["-n", "true"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    sudo.is_ok_and(|status| status.success())
        .then_some(Rights::Sudo)
}

fn package_lists_are_there() -> bool {
    fs::read_dir("/var/lib/apt/lists").is_ok_and(|mut files| {
        files.any(|file| {
            file.is_ok_and(|file| file.file_name().to_string_lossy().contains("_Packages"))
        })
    })
}

fn apt_get(rights: Rights, arguments: &[&str]) -> Result<(), Failure> {
    let mut command = match rights {
        Rights::Root => Command::new("apt-get"),
        Rights::Sudo => {
            let mut command = Command::new("sudo");
            command.args(["-n", "env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]);
            command
        }
    };
    let status = command
        .env("DEBIAN_FRONTEND", "noninteractive")
        .args(["-qq", "-o", "Dpkg::Use-Pty=0"])
        // Somebody else may be installing something just now.
        .args(["-o", "DPkg::Lock::Timeout=120"])
        .args(arguments)
        .stdin(Stdio::null())
        // stdout belongs to whoever called this.
        .stdout(io::stderr())
        .status()
        .map_err(|error| Failure::new(format!("apt-get does not run: {error}")))?;
    if status.success() {
        Ok(())
    } else {
        Err(Failure::new(format!(
            "apt-get {}: {status}",
            arguments.join(" ")
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_packages_called_installed_count_as_installed() {
        let answer = "installed gcc-avr\nconfig-files avrdude\nnot-installed simavr\n";
        assert_eq!(
            not_installed(
                &["gcc-avr", "avrdude", "simavr", "gcc", "libelf-dev"],
                answer
            ),
            ["avrdude", "simavr", "gcc", "libelf-dev"]
        );
    }
}
