//! Checks the services in `packaging/` with systemd.

use std::{fs, io, path::Path, process::Command};

use crate::{
    process::{Failure, failure, text},
    target,
    workspace::root,
};

/// The units, one of them also with its drop-in for the Odroid.
const UNITS: [(&str, Option<&str>); 4] = [
    ("singletrackd.service", None),
    (
        "singletrackd.service",
        Some("singletrackd.service.d/xu4.conf"),
    ),
    ("singletrack-page.service", None),
    ("singletrack-live.service", None),
];

/// Limit for systemd's exposure level, 0 to 10. gpsd has 9.6, chrony 3.7.
const MAX_EXPOSURE: f64 = 1.6;

/// Verifies the units and their exposure.
pub(crate) fn check() -> Result<(), Failure> {
    let folder = target::folder()?.join("units");
    for (name, drop_in) in UNITS {
        let folder = folder.join(drop_in.map_or("plain", |_| "xu4"));
        let unit = lay_out(&folder, name, drop_in)
            .map_err(|error| failure!("{}: {error}", folder.display()))?;
        verify(&unit)?;
        let exposure = exposure(&unit)?;
        if exposure > MAX_EXPOSURE {
            return Err(failure!(
                "{name} has an exposure level of {exposure}, above {MAX_EXPOSURE}; \
                 `systemd-analyze security --offline=yes packaging/{name}` lists the reasons"
            ));
        }
        println!("{}: verified, exposure {exposure}", drop_in.unwrap_or(name));
    }
    Ok(())
}

/// Places the unit where systemd finds it with its drop-in. The program is replaced
/// by an existing one, because the package need not be installed.
fn lay_out(folder: &Path, name: &str, drop_in: Option<&str>) -> io::Result<std::path::PathBuf> {
    let packaging = root().join("packaging");
    let unit = folder.join(name);
    fs::create_dir_all(folder)?;
    let mut text = fs::read_to_string(packaging.join(name))?;
    for program in ["singletrackd", "singletrack"] {
        text = text.replace(&format!("=/usr/bin/{program} "), "=/bin/true ");
    }
    fs::write(&unit, text)?;
    if let Some(drop_in) = drop_in {
        let to = folder.join(drop_in);
        if let Some(folder) = to.parent() {
            fs::create_dir_all(folder)?;
        }
        fs::copy(packaging.join(drop_in), to)?;
    }
    Ok(unit)
}

/// Checks that systemd prints nothing: it succeeds even with unknown keys.
fn verify(unit: &Path) -> Result<(), Failure> {
    let verified = Command::new("systemd-analyze")
        .args(["verify", "--man=no"])
        .arg(unit)
        .output()
        .map_err(|error| failure!("systemd-analyze does not start: {error}"))?;
    let text = [verified.stdout, verified.stderr].concat();
    if verified.status.success() && text.is_empty() {
        return Ok(());
    }
    Err(failure!(
        "systemd-analyze verify {}: {}\n{}",
        unit.display(),
        verified.status,
        String::from_utf8_lossy(&text)
    ))
}

fn exposure(unit: &Path) -> Result<f64, Failure> {
    let mut security = Command::new("systemd-analyze");
    security.args(["security", "--offline=yes", "--no-pager"]);
    let report = text(security.arg(unit))?;
    level(&report).ok_or_else(|| failure!("`systemd-analyze security` prints no exposure level"))
}

fn level(report: &str) -> Option<f64> {
    let (_, rest) = report.split_once("Overall exposure level for ")?;
    let (_, rest) = rest.split_once(": ")?;
    rest.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::level;

    #[test]
    fn the_level_is_the_number_after_the_units_name() {
        let report = "✗ PrivateNetwork=   0.5\n\n\
                      → Overall exposure level for singletrackd.service: 1.4 OK 🙂\n";
        assert_eq!(level(report), Some(1.4));
        assert_eq!(level("no unit"), None);
    }
}
