//! `singletrack setpoint`: set-points of every level to the daemon.
//!
//! One that the options give, again and again; a trajectory from a file; or without options
//! those of standard input. The car stops soon after the last.

mod trajectory;

use std::{
    io, iter, mem,
    path::{Path, PathBuf},
    sync::mpsc::{self, RecvTimeoutError},
    thread,
    time::{Duration, Instant},
};

use clap::{ArgGroup, Args};
use singletrack_api::{Answer, ClientError, Connection, Request, Setpoint, ask, explain};
use singletrackd::monotonic_ns;

use crate::{
    Result,
    arguments::parse_duration,
    operator::control::{ControlArgs, finite},
};
use trajectory::TrajectoryFile;

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

/// Time limit for a write to a daemon that does not read.
const PATIENCE: Duration = Duration::from_secs(1);

/// Interval of the set-points of the options: four within the usual time-out.
const PERIOD: Duration = Duration::from_millis(50);

/// The longest wait for the next set-point, so that an answer is not looked at late.
const WAIT: Duration = Duration::from_millis(20);

/// Set-points one by one, when it is time for each; or why one can't be read.
type Setpoints = Box<dyn Iterator<Item = Result<Setpoint, String>> + Send>;

/// The set-points that the options ask for.
fn setpoints(args: &DemandArgs, socket: PathBuf) -> Result<Setpoints, String> {
    if let Some(file) = &args.trajectory {
        let way =
            TrajectoryFile::read(file).map_err(|error| format!("{}: {error}", file.display()))?;
        return Ok(Box::new(paced(follow(way, socket))));
    }
    Ok(match args.setpoint() {
        Some(setpoint) => Box::new(paced(repeat(setpoint, args.lasts))),
        None => Box::new(input()),
    })
}

/// The set-points of `next`, each after [`PERIOD`].
fn paced(
    mut next: impl FnMut() -> Option<Setpoint>,
) -> impl Iterator<Item = Result<Setpoint, String>> {
    let mut pause = Duration::ZERO;
    iter::from_fn(move || {
        thread::sleep(mem::replace(&mut pause, PERIOD));
        next().map(Ok)
    })
}

/// One set-point again and again, for a time or for ever.
fn repeat(setpoint: Setpoint, lasts: Option<Duration>) -> impl FnMut() -> Option<Setpoint> {
    let mut begun = None;
    move || {
        let begun = begun.get_or_insert_with(Instant::now);
        let goes_on = lasts.is_none_or(|lasts| begun.elapsed() < lasts);
        goes_on.then(|| setpoint.clone())
    }
}

/// The next points of a trajectory, from its first point until its last one is over. The car stands
/// at the first one until it drives.
fn follow(way: TrajectoryFile, socket: PathBuf) -> impl FnMut() -> Option<Setpoint> {
    let mut begun = None;
    move || {
        let now_ns = monotonic_ns();
        if begun.is_none() && is_driving(&socket) {
            begun = Some(now_ns);
        }
        way.window(begun.unwrap_or(now_ns + LEAD_NS), now_ns)
    }
}

/// How far in the future a trajectory begins that waits for the car, ns: the daemon takes one
/// second at most, and it is sent again before this time is over.
const LEAD_NS: u64 = 500_000_000;

/// Whether the car drives. A daemon that does not answer shows on the other connection.
fn is_driving(socket: &Path) -> bool {
    let answer = ask(&Request::Status {}, socket).ok();
    let status = answer.and_then(|answer| answer.status);
    status.is_some_and(|status| status.mode() == "driving")
}

/// The set-points of standard input.
fn input() -> impl Iterator<Item = Result<Setpoint, String>> {
    let lines = (1_u64..).zip(iter::from_fn(|| io::stdin().lines().next()));
    lines.filter_map(|(number, line)| match line {
        Ok(line) if line.trim().is_empty() => None,
        Ok(line) => Some(setpoint(&line).map_err(|reason| {
            format!(
                "line {number}: {line:?} is not a set-point: {reason}; write VX VY, or VX VY X Y, \
                 or a JSON object such as {{\"steering_rad\":0.1,\"speed_m_s\":0.5}}"
            )
        })),
        Err(error) => Some(Err(format!("can't read standard input: {error}"))),
    })
}

/// Sends the set-points of the options, or those of standard input, until their end.
///
/// # Errors
///
/// The first one that is not a set-point, or that the daemon refuses.
pub fn run(args: &SetpointArgs) -> Result<()> {
    let source = setpoints(&args.demand, args.control.socket.clone())?;
    let mut connection = Connection::open(&args.control.socket, PATIENCE)?;
    let (given, setpoints) = mpsc::channel();
    // It is not waited for: it ends with the process.
    thread::spawn(move || {
        for mut setpoint in source {
            if let Ok(setpoint) = &mut setpoint {
                // Decided now, unless it says when.
                setpoint.time_ns.get_or_insert_with(monotonic_ns);
            }
            if given.send(setpoint).is_err() {
                return;
            }
        }
    });
    let mut next = setpoints.recv_timeout(WAIT);
    while next != Err(RecvTimeoutError::Disconnected) {
        if let Some(setpoint) = newest(next.into_iter().chain(setpoints.try_iter()))? {
            connection.send(&Request::Setpoint(setpoint))?;
        }
        if is_closed(&mut connection)? {
            return Ok(());
        }
        next = setpoints.recv_timeout(WAIT);
    }
    // The daemon sends its remaining answers and closes the connection.
    connection.end_requests()?;
    while !is_closed(&mut connection)? {
        thread::sleep(WAIT);
    }
    Ok(())
}

/// The last of the set-points that are waiting.
fn newest(
    mut waiting: impl Iterator<Item = Result<Setpoint, String>>,
) -> Result<Option<Setpoint>, String> {
    waiting.try_fold(None, |_, setpoint| setpoint.map(Some))
}

/// Looks at the answers; fails with the daemon's reason if it refuses a set-point. Whether the daemon
/// has closed the connection.
fn is_closed(connection: &mut Connection) -> Result<bool, ClientError> {
    loop {
        match connection.receive::<Answer>() {
            Ok(Some(answer)) => drop(answer.agreed()?),
            Ok(None) => return Ok(false),
            Err(ClientError::Ended) => return Ok(true),
            Err(error) => return Err(error),
        }
    }
}

/// The set-point of a line.
fn setpoint(line: &str) -> Result<Setpoint, String> {
    if let Ok(Request::Setpoint(setpoint)) = Request::parse(line.as_bytes()) {
        // A whole line of the socket.
        return Ok(setpoint);
    }
    if line.trim_start().starts_with('{') {
        return serde_json::from_str(line).map_err(|error| {
            let keys = serde_json::from_str(line).ok();
            keys.and_then(|keys| explain::<Setpoint>(&keys, &[], ""))
                .unwrap_or_else(|| error.to_string())
        });
    }
    let number = |word: &str| match word.parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("{word:?} is no number")),
    };
    let numbers = line.split_whitespace().map(number);
    let numbers = numbers.collect::<Result<Vec<_>, _>>()?;
    let (velocity, position) = match numbers[..] {
        [v_x, v_y] => ([v_x, v_y], None),
        [v_x, v_y, x, y] => ([v_x, v_y], Some([x, y])),
        _ => return Err(format!("it has {} numbers", numbers.len())),
    };
    Ok(Setpoint {
        velocity_m_s: Some(velocity),
        position_m: position,
        ..Setpoint::default()
    })
}

/// What the car should do; without any of these, the set-points of standard input.
#[derive(Clone, Debug, Default, Args)]
#[command(
    group(ArgGroup::new("steers").requires("drives").conflicts_with("trajectory")),
    group(ArgGroup::new("drives").requires("steers")),
)]
pub(super) struct DemandArgs {
    /// Velocity of P, in m/s, in the frame of the cameras
    #[arg(long, num_args = 2, value_names = ["VX", "VY"], value_parser = finite)]
    #[arg(conflicts_with_all = ["steers", "drives", "trajectory"])]
    velocity: Option<Vec<f64>>,

    /// Position of P as well, in m: the outer loop tracks it
    #[arg(long, num_args = 2, value_names = ["X", "Y"], value_parser = finite)]
    #[arg(requires = "velocity")]
    position: Option<Vec<f64>>,

    /// Steering angle in place of the law, in rad; positive to the left
    #[arg(long, value_name = "RAD", value_parser = finite, group = "steers")]
    steering: Option<f64>,

    /// Steering rate in place of the angle, in rad/s
    #[arg(long, value_name = "RAD_S", value_parser = finite, group = "steers")]
    steering_rate: Option<f64>,

    /// Speed of the centre of mass, in m/s; negative in reverse
    #[arg(long, value_name = "M_S", value_parser = finite, group = "drives")]
    speed: Option<f64>,

    /// Change of the speed in place of the speed, in m/s2
    #[arg(long, value_name = "M_S2", value_parser = finite, group = "drives")]
    acceleration: Option<f64>,

    /// File of a trajectory of P, CSV or JSON
    #[arg(long, value_name = "FILE")]
    pub(super) trajectory: Option<PathBuf>,

    /// How long the set-point is sent, such as 2.5s; otherwise until Ctrl-C
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_duration, conflicts_with = "trajectory")]
    pub(super) lasts: Option<Duration>,
}

impl DemandArgs {
    /// The set-point of the options; `None` if they have none.
    pub(super) fn setpoint(&self) -> Option<Setpoint> {
        let pair = |values: &Option<Vec<f64>>| values.as_deref()?.try_into().ok();
        let setpoint = Setpoint {
            velocity_m_s: pair(&self.velocity),
            position_m: pair(&self.position),
            steering_rad: self.steering,
            steering_rate_rad_s: self.steering_rate,
            speed_m_s: self.speed,
            acceleration_m_s2: self.acceleration,
            ..Setpoint::default()
        };
        (setpoint != Setpoint::default()).then_some(setpoint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_numbers_and_one_of_json_are_the_same_set_point() {
        let both = Setpoint {
            velocity_m_s: Some([0.5, -1.0]),
            position_m: Some([2.0, 3.0]),
            ..Setpoint::default()
        };
        assert_eq!(setpoint(" 0.5 -1\t2 3 "), Ok(both.clone()));
        let line = r#"{"velocity_m_s":[0.5,-1.0],"position_m":[2.0,3.0]}"#;
        assert_eq!(setpoint(line), Ok(both));
        let line = format!(r#"{{"version":3,"command":"setpoint",{}"#, &line[1..]);
        assert_eq!(setpoint(&line), setpoint(" 0.5 -1 2 3"));
        let velocity = Setpoint {
            velocity_m_s: Some([0.0, 0.25]),
            ..Setpoint::default()
        };
        assert_eq!(setpoint("0 0.25"), Ok(velocity));
    }

    #[test]
    fn of_set_points_that_wait_the_newest_is_sent_and_nothing_else_is_lost() {
        let line = |number| {
            Ok(Setpoint {
                sequence: Some(number),
                ..Setpoint::default()
            })
        };
        let sent = |waiting: Vec<_>| {
            let newest = newest(waiting.into_iter());
            newest.map(|setpoint| setpoint.and_then(|setpoint| setpoint.sequence))
        };
        assert_eq!(sent(vec![line(1), line(2)]), Ok(Some(2)));
        assert_eq!(sent(vec![]), Ok(None));
        let wrong = "line 3".to_owned();
        assert_eq!(sent(vec![line(1), Err(wrong.clone()), line(4)]), Err(wrong));
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
            let reason = setpoint(text).unwrap_err();
            assert!(reason.contains(part), "{text}: {reason}");
        }
    }
}

#[cfg(test)]
mod demand_tests {
    use clap::{CommandFactory as _, FromArgMatches as _, Parser, error::ErrorKind};
    use serde_json::json;

    use super::*;
    use crate::arguments::take_negative_numbers;

    #[derive(Debug, Parser)]
    struct Program {
        #[command(flatten)]
        demand: DemandArgs,
    }

    fn parse(options: &str) -> Result<DemandArgs, clap::Error> {
        let words = ["setpoint"].into_iter().chain(options.split(' '));
        let command = take_negative_numbers(Program::command());
        let matches = command.try_get_matches_from(words)?;
        Ok(Program::from_arg_matches(&matches)?.demand)
    }

    #[test]
    fn every_level_has_its_options() {
        for (options, keys) in [
            (
                "--velocity 0.4 -0.1",
                json!({ "velocity_m_s": [0.4, -0.1] }),
            ),
            (
                "--velocity 0 0 --position -1 2.5",
                json!({ "velocity_m_s": [0.0, 0.0], "position_m": [-1.0, 2.5] }),
            ),
            (
                "--steering -0.1 --speed 0.5",
                json!({ "steering_rad": -0.1, "speed_m_s": 0.5 }),
            ),
            (
                "--steering-rate 0.2 --acceleration -0.5 --for 2",
                json!({ "steering_rate_rad_s": 0.2, "acceleration_m_s2": -0.5 }),
            ),
        ] {
            let setpoint = parse(options).unwrap().setpoint().unwrap();
            assert_eq!(json!(setpoint), keys, "{options}");
        }
        assert_eq!(parse("--for 2").unwrap().setpoint(), None);
        let way = parse("--trajectory way.csv").unwrap();
        assert_eq!(
            (way.setpoint(), way.trajectory),
            (None, Some("way.csv".into()))
        );
    }

    #[test]
    fn half_a_set_point_and_two_at_once_are_refused_with_the_options_that_are_missing() {
        for (options, kind, part) in [
            (
                "--steering 0.1",
                ErrorKind::MissingRequiredArgument,
                "--speed",
            ),
            (
                "--speed 0.1",
                ErrorKind::MissingRequiredArgument,
                "--steering",
            ),
            (
                "--position 1 1",
                ErrorKind::MissingRequiredArgument,
                "--velocity",
            ),
            ("--velocity 1", ErrorKind::WrongNumberOfValues, "2 values"),
            (
                "--velocity 1 0 --steering 0.1 --speed 1",
                ErrorKind::ArgumentConflict,
                "--velocity",
            ),
            (
                "--trajectory a.csv --velocity 1 0",
                ErrorKind::ArgumentConflict,
                "--trajectory",
            ),
            (
                "--steering 0.1 --steering-rate 0.1 --speed 1",
                ErrorKind::ArgumentConflict,
                "--steering-rate",
            ),
            (
                "--velocity nan 0",
                ErrorKind::ValueValidation,
                "finite number",
            ),
            ("--velocity 1 0 --for -1", ErrorKind::ValueValidation, "-1"),
        ] {
            let error = parse(options).unwrap_err();
            let text = error.to_string();
            assert!(text.contains(part), "{options}: {text}");
            assert_eq!(error.kind(), kind, "{options}: {text}");
        }
    }
}
