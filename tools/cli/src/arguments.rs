//! What all options of the command line have in common.

use std::{any::TypeId, ffi::OsString, path::PathBuf, time::Duration};

use clap::{
    Arg, Args, Command,
    builder::{OsStringValueParser, TypedValueParser},
};
use singletrack_core::config::SocketSection;
use singletrack_sim::parse_duration_us;

/// The variable of the environment that stands for --socket.
const SOCKET_VARIABLE: &str = "SINGLETRACK_SOCKET";

/// Where the daemon listens.
#[derive(Clone, Debug, Args)]
pub struct ControlArgs {
    /// The daemon's control socket
    #[arg(long, value_name = "PATH", env = SOCKET_VARIABLE, hide_env_values = true)]
    #[arg(value_parser = socket_parser(), default_value_os_t = SocketSection::default().path)]
    pub(crate) socket: PathBuf,
}

/// Where the daemon of a configuration listens.
#[derive(Clone, Debug, Args)]
pub struct ConfiguredSocket {
    /// The daemon's control socket [default: socket.path of --config]
    #[arg(long, value_name = "PATH", env = SOCKET_VARIABLE, hide_env_values = true)]
    #[arg(value_parser = socket_parser())]
    socket: Option<PathBuf>,
}

impl ConfiguredSocket {
    /// Its path, or that of the configuration.
    pub(crate) fn or(&self, configured: PathBuf) -> PathBuf {
        self.socket.clone().unwrap_or(configured)
    }
}

/// Takes a path from the command line or the environment.
fn socket_parser() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().try_map(|path: OsString| {
        if path.is_empty() {
            return Err(format!("give a path, or unset {SOCKET_VARIABLE}"));
        }
        Ok(path.into())
    })
}

/// Lets the options that take numbers, durations or times take negative ones, in all
/// subcommands: their own check then refuses it by the name of the option and with the value,
/// where the parser would see an unknown option.
pub fn take_negative_numbers(command: Command) -> Command {
    command
        .mut_args(|argument| {
            if takes_number(&argument) {
                argument.allow_hyphen_values(true)
            } else {
                argument
            }
        })
        .mut_subcommands(take_negative_numbers)
}

/// A duration such as `2.5s`, `500ms` or `5m`; a bare number is in seconds.
///
/// # Errors
///
/// When it is neither, or negative; in words.
pub fn parse_duration(text: &str) -> Result<Duration, String> {
    let text = text.trim();
    let minutes = text.strip_suffix('m');
    let minutes = minutes.and_then(|number| number.parse::<f64>().ok());
    let seconds = minutes.map(|minutes| 60.0 * minutes).or(text.parse().ok());
    if let Some(duration) = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()) {
        return Ok(duration);
    }
    let micros = parse_duration_us(text).map_err(|error| error.to_string())?;
    Ok(Duration::from_micros(micros))
}

/// A duration of at least `least_s` and at most `most_s` seconds.
pub(crate) fn duration_within(text: &str, least_s: f64, most_s: f64) -> Result<Duration, String> {
    let duration = parse_duration(text)?;
    match (least_s..=most_s).contains(&duration.as_secs_f64()) {
        true => Ok(duration),
        false => Err(format!("give {least_s} to {most_s} s")),
    }
}

/// Whether it is an option that must have a value which is no name: not of a file, of a thing, or
/// of one of a few.
pub fn takes_number(argument: &Arg) -> bool {
    // Of an optional value, the next option would be taken for it.
    let values = argument.get_num_args();
    let is_optional = values.is_some_and(|range| range.min_values() == 0);
    let parser = argument.get_value_parser();
    let names = [TypeId::of::<PathBuf>(), TypeId::of::<String>()];
    let is_name =
        parser.possible_values().is_some() || names.iter().any(|name| parser.type_id() == *name);
    argument.get_action().takes_values() && !argument.is_positional() && !is_optional && !is_name
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn a_duration_has_a_unit_or_is_in_seconds() {
        for (text, milliseconds) in [
            ("2.5s", 2_500),
            ("500ms", 500),
            ("10", 10_000),
            ("5m", 300_000),
            ("0.5m", 30_000),
            ("0.2", 200),
        ] {
            let duration = parse_duration(text).unwrap();
            assert_eq!(duration.as_millis(), milliseconds, "{text}");
        }
        for text in ["-5", "-5s", "-5m", "m", "soon", "inf", "NaN", "", "1e30"] {
            let error = parse_duration(text).unwrap_err();
            assert!(error.contains("is not a duration"), "{text}: {error}");
        }
    }
}
