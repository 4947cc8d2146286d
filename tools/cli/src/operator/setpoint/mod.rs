//! `singletrack setpoint`: set-points of every level to the daemon.
//!
//! One that the options give, again and again; a trajectory from a file; or without options
//! those of standard input. The car stops soon after the last.

mod demand;
mod trajectory;

use std::{
    error::Error,
    io, iter, mem,
    path::{Path, PathBuf},
    sync::mpsc::{self, RecvTimeoutError},
    thread,
    time::{Duration, Instant},
};

use clap::Args;
use singletrack_api::{Answer, ClientError, Connection, Request, Setpoint, ask, explain};
use singletrackd::monotonic_ns;

use crate::operator::control::ControlArgs;
use demand::DemandArgs;
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
    ask(&Request::Status {}, socket).is_ok_and(|answer| {
        answer
            .status
            .is_some_and(|status| status.mode() == "driving")
    })
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
pub fn run(args: &SetpointArgs) -> Result<(), Box<dyn Error>> {
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
    let numbers = line
        .split_whitespace()
        .map(|word| match word.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(format!("{word:?} is no number")),
        })
        .collect::<Result<Vec<_>, _>>()?;
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
