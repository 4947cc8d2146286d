//! Fuzz targets: lines from clients of the control socket, and heads of HTTP requests to the page.

use singletrack_control::Time;
use singletrack_pilot::PilotRequest;
use singletrack_viewers::page::Request;
use singletrackd::Command;

use crate::choices::Choices;

/// Time of reading the line, in ns of `CLOCK_MONOTONIC`.
const NOW_NS: u64 = 1_000_000_000_000;

/// Largest length of an error message, without the quoted line.
const MAX_ANSWER: usize = 1_024;

/// Keys of a line, and an unknown one.
const KEYS: [&str; 24] = [
    "version",
    "command",
    "topics",
    "reference",
    "velocity_m_s",
    "position_m",
    "attendance",
    "for_s",
    "time_ns",
    "kind",
    "uncalibrated",
    "procedure",
    "result",
    "jog",
    "servo_us",
    "esc_us",
    "steering_rad",
    "steering_rate_rad_s",
    "speed_m_s",
    "rear_speed_m_s",
    "acceleration_m_s2",
    "trajectory",
    "sequence",
    "surplus",
];

/// Values that are valid for some keys.
const VALUES: [&str; 32] = [
    "1",
    "3",
    "0",
    "-1",
    "null",
    "true",
    "\"status\"",
    "\"arm\"",
    "\"hold\"",
    "\"timed\"",
    "\"unattended\"",
    "\"disarm\"",
    "\"stop\"",
    "\"watch\"",
    "\"set-reference\"",
    "\"setpoint\"",
    "[0.5,-0.5]",
    "[1e308,1e308]",
    "[\"tick\",\"log\"]",
    "[]",
    "{}",
    "{\"kind\":\"circle\",\"radius_m\":1.0,\"angular_velocity_rad_s\":0.5}",
    "{\"kind\":\"external\"}",
    "{\"kind\":\"waypoints\",\"file\":\"nowhere\"}",
    "{\"kind\":\"velocity-steps\",\"steps\":[{\"duration_s\":1,\"v_x_m_s\":1,\"v_y_m_s\":0}]}",
    "18446744073709551615",
    "1000000000001",
    "\"jog\"",
    "\"reload\"",
    "1500",
    "[\"state\"]",
    "[{\"time_ns\":1000000000000,\"position_m\":[0,0],\"velocity_m_s\":[0,0]},{\"time_ns\":1000100000000,\"position_m\":[0,0],\"velocity_m_s\":[0,0]}]",
];

/// Parses lines from a client of the control socket.
///
/// The first byte selects the use of the rest: as the line itself, or as an object
/// of known keys with values of all kinds.
///
/// # Panics
///
/// If an accepted set-point is not finite, or lies in the future; if a command is
/// parsed from a line that does not contain its word, or of another version; if a
/// refusal has no message or one that is too long.
///
/// Returns the number of lines.
pub fn control_line(data: &[u8]) -> u64 {
    let mut choices = Choices::new(data);
    if choices.byte() & 1 == 0 {
        check(choices.rest());
    } else {
        check(object(&mut choices).as_bytes());
    }
    1
}

fn object(choices: &mut Choices<'_>) -> String {
    let mut entries = Vec::new();
    if choices.flag() {
        entries.push("\"version\":3".to_owned());
    }
    while !choices.is_empty() && entries.len() < 16 {
        let key = choices.one_of(KEYS);
        let value = match choices.byte() {
            byte @ 0..=200 => VALUES[usize::from(byte) % VALUES.len()].to_owned(),
            201..=220 => choices.u64().to_string(),
            221..=240 => format!("[{:?},{:?}]", choices.f64(), choices.f64()),
            _ => String::from_utf8_lossy(choices.bytes()).into_owned(),
        };
        entries.push(format!("\"{key}\":{value}"));
    }
    format!("{{{}}}\n", entries.join(","))
}

fn check(line: &[u8]) {
    match Command::parse(line, NOW_NS) {
        Ok(command) => check_accepted(&command, line),
        Err(error) => {
            let error = error.to_string();
            assert!(!error.trim().is_empty(), "refused without a message");
            assert!(
                error.len() <= MAX_ANSWER + 8 * line.len(),
                "{} bytes about {}",
                error.len(),
                line.len()
            );
        }
    }
}

fn check_accepted(command: &Command, line: &[u8]) {
    // No command by accident: the line must contain its word. (Or escapes of it.)
    let text = core::str::from_utf8(line).expect("JSON is UTF-8");
    assert!(text.contains('3'), "another version is accepted: {text}");
    let word = match command {
        Command::Status => "status",
        Command::End(PilotRequest::EmergencyStop) => "stop",
        Command::End(_) => "disarm",
        Command::Commissioned { .. } => "commissioned",
        Command::Arm(_) | Command::ArmJog => "arm",
        Command::Jog(_) => "jog",
        Command::Configuration => "configuration",
        Command::Reload => "reload",
        Command::Hold => "hold",
        Command::Tune(_) => "tune",
        Command::SetReference(_) => "set-reference",
        Command::Setpoint(_) => "setpoint",
        Command::Watch { .. } | Command::WatchState => "watch",
        Command::Messages { .. } => "messages",
        Command::Clock => "clock",
    };
    assert!(
        text.contains(word) || text.contains('\\'),
        "{word} is read from {text}"
    );
    if let Command::Setpoint(setpoint) = command {
        let checked = setpoint.check(Time(NOW_NS), f64::INFINITY);
        assert_eq!(checked, Ok(()), "{setpoint:?}");
        let decided = setpoint.stamp().time.0;
        assert!(decided <= NOW_NS, "a set-point from the future");
    }
}

const METHODS: [&str; 5] = ["GET", "HEAD", "POST", "get", ""];

const TARGETS: [&str; 7] = [
    "/",
    "/events?token=abc",
    "/setup.json?a&token=&token=x",
    "/../page.js",
    "*",
    "/?",
    "",
];

const HEADERS: [&str; 10] = [
    "Host: localhost:8767",
    "Host: 127.0.0.1",
    "host:[::1]:8767",
    "Host: evil.example",
    "HOST: localhost.evil.example",
    "Host: 127.0.0.1.evil.example:8767",
    "Host:",
    "Host: [evil.example]",
    " folded",
    "X: \u{e9}",
];

/// Reads a head as the page does, and as much of it as would have come before its end.
///
/// The first byte selects the use of the rest: as the head itself, or as choices of its parts.
///
/// # Panics
///
/// If a request is read from less than its whole head, or differs with what comes after it; if
/// its words are not the client's; if a name with a dot passes as this computer, but is no
/// address.
///
/// Returns the number of heads.
pub fn page_head(data: &[u8]) -> u64 {
    let mut choices = Choices::new(data);
    if choices.byte() & 1 == 0 {
        check_head(choices.rest());
    } else {
        check_head(&head(&mut choices));
    }
    1
}

fn head(choices: &mut Choices<'_>) -> Vec<u8> {
    let version = if choices.flag() { "1.1" } else { "1.0" };
    let (method, target) = (choices.one_of(METHODS), choices.one_of(TARGETS));
    let mut head = format!("{method} {target} HTTP/{version}\r\n").into_bytes();
    while !choices.is_empty() && head.len() < 2_048 {
        match choices.byte() {
            0..=220 => head.extend(choices.one_of(HEADERS).as_bytes()),
            _ => head.extend(choices.bytes()),
        }
        head.extend(b"\r\n");
    }
    head.extend(b"\r\n");
    head
}

fn check_head(head: &[u8]) {
    let Ok(Some(request)) = Request::parse(head) else {
        return;
    };
    // The end of the head: the first blank line after the first line.
    let end = (0..=head.len())
        .find(|end| !matches!(Request::parse(&head[..*end]), Ok(None)))
        .unwrap_or(head.len());
    assert!(
        head[..end].ends_with(b"\n\n") || head[..end].ends_with(b"\r\n\r\n"),
        "a request from the {end} bytes of {head:?}"
    );
    assert_eq!(
        Request::parse(&head[..end]),
        Ok(Some(request.clone())),
        "what follows the head changes it"
    );
    let text = String::from_utf8_lossy(&head[..end]);
    for word in [&request.method, &request.path]
        .into_iter()
        .chain(&request.token)
    {
        assert!(text.contains(word.as_str()), "{word:?} is not in {text:?}");
    }
    if request.names_no_other_host() {
        let other = text.lines().find_map(|line| {
            let (name, host) = line.split_once(':')?;
            let is_other = host.contains(".example") && !host.contains(['[', '\r']);
            (name.eq_ignore_ascii_case("host")).then_some(is_other)
        });
        assert_ne!(other, Some(true), "another computer's name: {text:?}");
    }
}

#[cfg(test)]
mod tests {
    use singletrackd::ParseError;

    use super::{Choices, Command, *};

    fn parse(data: &[u8]) -> Result<Command, ParseError> {
        Command::parse(object(&mut Choices::new(data)).as_bytes(), NOW_NS)
    }

    #[test]
    fn objects_of_choices_are_commands_of_every_kind() {
        assert!(matches!(parse(&[1, 1, 6]), Ok(Command::Status)));
        assert!(matches!(
            parse(&[1, 1, 13, 2, 18]),
            Ok(Command::Watch { .. })
        ));
        assert!(matches!(
            parse(&[1, 1, 14, 3, 21]),
            Ok(Command::SetReference(_))
        ));
        assert!(matches!(
            parse(&[1, 1, 15, 4, 16]),
            Ok(Command::Setpoint(_))
        ));
        assert!(matches!(parse(&[1, 1, 7, 6, 8]), Ok(Command::Arm(_))));
        assert!(matches!(parse(&[1, 1, 8]), Ok(Command::Hold)));
        assert!(parse(&[0, 1, 6]).is_err());
    }

    fn request(data: &[u8]) -> Request {
        let head = head(&mut Choices::new(data));
        Request::parse(&head).unwrap().unwrap()
    }

    #[test]
    fn choices_are_requests_to_this_computer_and_to_others() {
        let own = request(&[1, 0, 1, 0, 0]);
        assert_eq!((&*own.method, &*own.path), ("GET", "/events"));
        assert_eq!(own.token.as_deref(), Some("abc"));
        assert!(own.names_no_other_host());
        for stranger in [3, 4, 5] {
            assert!(!request(&[1, 0, 0, 0, stranger]).names_no_other_host());
        }
    }
}
