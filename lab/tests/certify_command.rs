//! `singletrack certify` as a person sees it.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use std::{fs, path::Path, process::Command};

use singletrack_core::{Config, certificate::refusal};

/// Runs it for the example with these lines of its own, and returns the configuration's path, the
/// file's and what is on standard error.
fn certify(folder: &Path, lines: &str) -> (std::path::PathBuf, std::path::PathBuf, String) {
    let (config, out) = (folder.join("car.toml"), folder.join("certificate.json"));
    let example = include_str!("../../host/daemon/singletrackd.example.toml");
    let text = example.replace("[safety_filter]\n", &format!("[safety_filter]\n{lines}\n"));
    fs::write(&config, text).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_singletrack-lab"))
        .arg("certify")
        .arg(&config)
        .arg("--out")
        .arg(&out)
        .output()
        .unwrap();
    let errors = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.success(), errors.is_empty(), "{errors}");
    (config, out, errors)
}

#[test]
fn the_file_that_it_writes_lets_the_car_be_armed() {
    let folder = tempfile::tempdir().unwrap();
    let lines = "enabled = true\ncertificate = \"certificate.json\"";
    let (config, out, errors) = certify(folder.path(), lines);
    assert_eq!(errors, "");
    let config = Config::read(&config).unwrap();
    // The path starts at the folder of the configuration.
    assert_eq!(config.safety_filter.certificate.as_deref(), Some(&*out));
    assert_eq!(refusal(&config), None);
}

#[test]
fn a_configuration_without_the_filter_has_no_certificate() {
    let folder = tempfile::tempdir().unwrap();
    let (_, out, errors) = certify(folder.path(), "enabled = false");
    assert!(
        errors.contains("safety_filter.enabled is false"),
        "{errors}"
    );
    assert!(!out.exists());
}
