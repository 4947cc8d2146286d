//! Scripts of `sh` with the functions of `prerequisites.sh`.

use std::process::{Command, Stdio};

/// A shell with the functions of the probes.
pub(crate) fn shell(script: &str) -> Command {
    let script = format!("{}\n{script}", include_str!("prerequisites.sh"));
    let mut shell = Command::new("/bin/sh");
    shell
        .args(["-c", &script])
        .env("OLDEST", env!("CARGO_PKG_RUST_VERSION"))
        .stdin(Stdio::null());
    shell
}

/// The output of a shell, or what it prints when it fails.
pub(crate) fn answer(command: &mut Command) -> Result<String, String> {
    let output = command
        .output()
        .map_err(|error| format!("sh does not start: {error}"))?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_owned();
    if output.status.success() {
        Ok(text(&output.stdout))
    } else {
        // The reason comes first.
        let why = text(&[output.stderr, output.stdout].concat());
        Err(if why.is_empty() {
            output.status.to_string()
        } else {
            why
        })
    }
}
