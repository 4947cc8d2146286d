//! `singletrack setpoint`: set-points of every level to the daemon.
//!
//! One that the options give, again and again; a trajectory from a file; or without options
//! those of standard input. The car stops soon after the last.

mod demand;
mod trajectory;

use std::{
    io::{self, BufRead, BufReader, Write},
    net::Shutdown,
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    sync::mpsc::{self, Receiver, Sender},
    thread,
    time::{Duration, Instant},
};

use clap::Args;
use serde_json::{Map, Value, json};
use singletrackd::{SOCKET_VERSION, monotonic_ns};

use crate::control::{self, ControlArgs, ControlError};
use demand::DemandArgs;
use trajectory::TrajectoryFile;
pub use trajectory::TrajectoryFileError;

/// The set-points, and where the daemon is.
#[derive(Clone, Debug, Args)]
#[command(after_help = "\
With a set-point in the options it is sent every 50 ms, for --for or until Ctrl-C:

  singletrack setpoint --velocity 0.4 0.0                    velocity of P, m/s
  singletrack setpoint --velocity 0 0 --position 1.0 0.5     and its position, m
  singletrack setpoint --steering 0.1 --speed 0.5            rad, m/s
  singletrack setpoint --steering-rate 0.2 --acceleration -0.5
  singletrack setpoint --trajectory way.csv                  begins when the car drives

A trajectory is CSV with the columns t_s,x_m,y_m and perhaps vx_m_s,vy_m_s, or JSON: a list of \
{\"t_s\":0.0,\"position_m\":[0.0,0.0],\"velocity_m_s\":[0.4,0.0]}. Without velocities they are those \
between the neighbours of a point.

Without options each line of standard input is a set-point: VX VY, or VX VY X Y; or a JSON \
object with the keys of the control socket, of any level:

  {\"velocity_m_s\":[0.4,0.0],\"position_m\":[1.0,0.0]}
  {\"steering_rad\":0.1,\"speed_m_s\":0.5}
  {\"steering_rate_rad_s\":0.2,\"acceleration_m_s2\":-0.5}
  {\"trajectory\":[{\"time_ns\":81234567890,\"position_m\":[0,0],\"velocity_m_s\":[0.4,0]},...]}

Of lines that come at once the newest is sent. The car stops reference.setpoint_timeout_ms after \
the last. The reference must be external: see set-reference. Start this first, then arm.")]
pub struct SetpointArgs {
    #[command(flatten)]
    demand: DemandArgs,

    #[command(flatten)]
    control: ControlArgs,
}

/// Why set-points no longer reach the daemon.
#[derive(Debug, thiserror::Error)]
pub enum SetpointError {
    /// A line that is not a set-point.
    #[error(
        "line {number}: {line:?} is not a set-point: {reason}; write VX VY, or VX VY X Y, or a JSON \
         object such as {{\"steering_rad\":0.1,\"speed_m_s\":0.5}}"
    )]
    Line {
        /// From 1.
        number: u64,
        /// What it says.
        line: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The lines can't be read.
    #[error("can't read standard input: {0}")]
    Input(io::Error),
    /// The file of a trajectory is not one.
    #[error("{}: {error}", .file.display())]
    Trajectory {
        /// The file.
        file: PathBuf,
        /// What is wrong with it, and what to write.
        error: TrajectoryFileError,
    },
    /// The daemon refuses or does not answer.
    #[error(transparent)]
    Control(#[from] ControlError),
}

/// Time limit for a write to a daemon that does not read.
const PATIENCE: Duration = Duration::from_secs(1);

/// Interval of the set-points of the options: four within the usual time-out.
const PERIOD: Duration = Duration::from_millis(50);

/// Where the set-points come from.
enum Source {
    /// The lines of standard input.
    Input,
    /// One, as a line of JSON, for a time or for ever.
    Constant {
        text: String,
        lasts: Option<Duration>,
    },
    /// The points of a file.
    Trajectory(TrajectoryFile),
}

impl Source {
    fn of(args: &DemandArgs) -> Result<Self, SetpointError> {
        if let Some(file) = &args.trajectory {
            let way = TrajectoryFile::read(file).map_err(|error| SetpointError::Trajectory {
                file: file.clone(),
                error,
            })?;
            return Ok(Self::Trajectory(way));
        }
        Ok(args.keys().map_or(Self::Input, |keys| Self::Constant {
            text: keys.to_string(),
            lasts: args.lasts,
        }))
    }
}

/// Gives the same set-point again and again.
fn repeat(events: &Sender<Event>, text: &str, lasts: Option<Duration>) {
    let begun = Instant::now();
    let mut number = 0;
    while lasts.is_none_or(|lasts| begun.elapsed() < lasts) {
        number += 1;
        if !line(events, number, text.to_owned()) {
            return;
        }
        thread::sleep(PERIOD);
    }
    let _ = events.send(Event::Input(Ok(())));
}

/// Gives the next points of a trajectory, from its first point until its last one is over. The
/// car stands at the first one until it drives.
fn follow(events: &Sender<Event>, way: &TrajectoryFile, socket: &Path) {
    let mut begun = None;
    for number in 1.. {
        let now_ns = monotonic_ns();
        if begun.is_none() && is_driving(socket) {
            begun = Some(now_ns);
        }
        let begin_ns = begun.unwrap_or(now_ns + LEAD_NS);
        let Some(keys) = way.window(begin_ns, now_ns) else {
            break;
        };
        if !line(events, number, keys.to_string()) {
            return;
        }
        thread::sleep(PERIOD);
    }
    let _ = events.send(Event::Input(Ok(())));
}

/// How far in the future a trajectory begins that waits for the car, ns: the daemon takes one
/// second at most, and it is sent again before this time is over.
const LEAD_NS: u64 = 500_000_000;

/// Whether the car drives. A daemon that does not answer shows on the other connection.
fn is_driving(socket: &Path) -> bool {
    let status = json!({ "version": SOCKET_VERSION, "command": "status" });
    control::ask(&status, socket).is_ok_and(|answer| {
        answer
            .pointer("/status/mode")
            .is_some_and(|mode| mode == "driving")
    })
}

/// Hands a line over; false if nobody takes it any more.
fn line(events: &Sender<Event>, number: u64, text: String) -> bool {
    let time_ns = monotonic_ns();
    let line = Event::Line {
        number,
        text,
        time_ns,
    };
    events.send(line).is_ok()
}

/// An event on standard input or on the socket.
enum Event {
    Line {
        number: u64,
        text: String,
        time_ns: u64,
    },
    Input(io::Result<()>),
    Answer(String),
    Closed(io::Result<()>),
}

/// Sends the set-points of the options, or those of standard input, until their end.
///
/// # Errors
///
/// The first one that is not a set-point, or that the daemon refuses.
pub fn run(args: &SetpointArgs) -> Result<(), SetpointError> {
    let source = Source::of(&args.demand)?;
    let mut stream = control::connect(&args.control.socket)?;
    let prepared = || -> io::Result<UnixStream> {
        stream.set_write_timeout(Some(PATIENCE))?;
        stream.try_clone()
    };
    let answers = prepared().map_err(ControlError::from)?;
    let (events_in, events) = mpsc::channel();
    let answers_in = events_in.clone();
    // Neither is waited for: both end with the process.
    thread::spawn(move || read_answers(answers, &answers_in));
    let socket = args.control.socket.clone();
    thread::spawn(move || match source {
        Source::Input => read_input(&events_in),
        Source::Constant { text, lasts } => repeat(&events_in, &text, lasts),
        Source::Trajectory(way) => follow(&events_in, &way, &socket),
    });

    for event in (Newest { events, next: None }) {
        match event {
            Event::Line {
                number,
                text,
                time_ns,
            } => {
                let line = setpoint(&text, time_ns).map_err(|reason| SetpointError::Line {
                    number,
                    line: text,
                    reason,
                })?;
                stream
                    .write_all(format!("{line}\n").as_bytes())
                    .map_err(ControlError::from)?;
            }
            Event::Input(Ok(())) => {
                // The daemon sends its remaining answers and closes the connection.
                stream
                    .shutdown(Shutdown::Write)
                    .map_err(ControlError::from)?;
            }
            Event::Input(Err(error)) => return Err(SetpointError::Input(error)),
            Event::Answer(answer) => {
                let answer = serde_json::from_str(&answer).map_err(ControlError::from)?;
                control::agreed(answer)?;
            }
            Event::Closed(Ok(())) => break,
            Event::Closed(Err(error)) => return Err(ControlError::from(error).into()),
        }
    }
    Ok(())
}

/// The events in order; of the lines that are waiting, only the last.
struct Newest {
    events: Receiver<Event>,
    /// What came after the last line.
    next: Option<Event>,
}

impl Iterator for Newest {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        let mut event = match self.next.take() {
            Some(event) => event,
            None => self.events.recv().ok()?,
        };
        while let Event::Line { .. } = event {
            match self.events.try_recv() {
                Ok(line @ Event::Line { .. }) => event = line,
                next => {
                    self.next = next.ok();
                    break;
                }
            }
        }
        Some(event)
    }
}

fn read_input(events: &Sender<Event>) {
    let mut ended = Ok(());
    for (number, read) in (1..).zip(io::stdin().lock().lines()) {
        match read {
            Ok(text) if text.trim().is_empty() => {}
            Ok(text) => {
                // The receiver is gone when the process is about to end.
                line(events, number, text);
            }
            Err(error) => {
                ended = Err(error);
                break;
            }
        }
    }
    let _ = events.send(Event::Input(ended));
}

fn read_answers(answers: UnixStream, events: &Sender<Event>) {
    let mut closed = Ok(());
    for line in BufReader::new(answers).lines() {
        match line {
            Ok(line) => drop(events.send(Event::Answer(line))),
            Err(error) => {
                closed = Err(error);
                break;
            }
        }
    }
    let _ = events.send(Event::Closed(closed));
}

/// The daemon's command for a line that was read at `time_ns`.
fn setpoint(line: &str, time_ns: u64) -> Result<Value, String> {
    let keys = if line.trim_start().starts_with('{') {
        serde_json::from_str(line).map_err(|error| error.to_string())?
    } else {
        numbers(line)?
    };
    let mut command = Map::new();
    command.insert("version".to_owned(), SOCKET_VERSION.into());
    command.insert("command".to_owned(), "setpoint".into());
    command.insert("time_ns".to_owned(), time_ns.into());
    command.extend(keys);
    Ok(Value::Object(command))
}

fn numbers(line: &str) -> Result<Map<String, Value>, String> {
    let numbers = line
        .split_whitespace()
        .map(|word| match word.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(format!("{word:?} is no number")),
        })
        .collect::<Result<Vec<_>, _>>()?;
    let keys = match numbers[..] {
        [v_x, v_y] => json!({ "velocity_m_s": [v_x, v_y] }),
        [v_x, v_y, x, y] => json!({ "velocity_m_s": [v_x, v_y], "position_m": [x, y] }),
        _ => return Err(format!("it has {} numbers", numbers.len())),
    };
    match keys {
        Value::Object(keys) => Ok(keys),
        _ => Ok(Map::new()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_numbers_and_one_of_json_are_the_same_set_point() {
        let both = json!({
            "version": 2, "command": "setpoint", "time_ns": 7,
            "velocity_m_s": [0.5, -1.0], "position_m": [2.0, 3.0],
        });
        assert_eq!(setpoint(" 0.5 -1\t2 3 ", 7), Ok(both.clone()));
        let line = r#"{"velocity_m_s":[0.5,-1.0],"position_m":[2.0,3.0]}"#;
        assert_eq!(setpoint(line, 7), Ok(both));
        let velocity = json!({
            "version": 2, "command": "setpoint", "time_ns": 8, "velocity_m_s": [0.0, 0.25],
        });
        assert_eq!(setpoint("0 0.25", 8), Ok(velocity));
    }

    #[test]
    fn of_lines_that_wait_the_newest_is_sent_and_nothing_else_is_lost() {
        let (sender, events) = mpsc::channel();
        let line = |number| Event::Line {
            number,
            text: String::new(),
            time_ns: 0,
        };
        for event in [
            line(1),
            line(2),
            Event::Answer("a".to_owned()),
            line(3),
            line(4),
            Event::Input(Ok(())),
        ] {
            sender.send(event).unwrap();
        }
        drop(sender);
        let told: Vec<String> = Newest { events, next: None }
            .map(|event| match event {
                Event::Line { number, .. } => number.to_string(),
                Event::Answer(answer) => answer,
                Event::Input(_) => "end".to_owned(),
                Event::Closed(_) => "closed".to_owned(),
            })
            .collect();
        assert_eq!(told, ["2", "a", "4", "end"]);
    }

    #[test]
    fn a_line_that_is_not_a_set_point_is_reported_with_the_reason() {
        for (text, part) in [
            ("0.5", "it has 1 numbers"),
            ("0.5 0 0", "it has 3 numbers"),
            ("left right", "\"left\" is no number"),
            ("nan 0", "\"nan\" is no number"),
            ("1e999 0", "is no number"),
            ("{\"velocity_m_s\"", "EOF"),
        ] {
            let reason = setpoint(text, 0).unwrap_err();
            assert!(reason.contains(part), "{text}: {reason}");
        }
    }
}
