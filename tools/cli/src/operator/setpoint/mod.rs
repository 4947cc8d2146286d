//! `singletrack setpoint`: set-points of every level to the daemon.
//!
//! One that the options give, again and again; a trajectory from a file; or without options
//! those of standard input. The car stops soon after the last.

mod demand;
mod trajectory;

use std::{
    error::Error,
    io::{self, BufRead, BufReader, Write},
    net::Shutdown,
    os::unix::net::UnixStream,
    path::Path,
    sync::mpsc::{self, Receiver, Sender},
    thread,
    time::{Duration, Instant},
};

use clap::Args;
use singletrack_api::{Answer, ClientError, Request, Setpoint, ask, connect, explain};
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

/// Where the set-points come from.
enum Source {
    /// The lines of standard input.
    Input,
    /// One, for a time or for ever.
    Constant {
        setpoint: Setpoint,
        lasts: Option<Duration>,
    },
    /// The points of a file.
    Trajectory(TrajectoryFile),
}

impl Source {
    fn of(args: &DemandArgs) -> Result<Self, String> {
        if let Some(file) = &args.trajectory {
            let way = TrajectoryFile::read(file)
                .map_err(|error| format!("{}: {error}", file.display()))?;
            return Ok(Self::Trajectory(way));
        }
        let lasts = args.lasts;
        Ok(args
            .setpoint()
            .map_or(Self::Input, |setpoint| Self::Constant { setpoint, lasts }))
    }
}

/// Gives the same set-point again and again.
fn repeat(events: &Sender<Event>, setpoint: &Setpoint, lasts: Option<Duration>) {
    let begun = Instant::now();
    let goes_on = |_: &Setpoint| lasts.is_none_or(|lasts| begun.elapsed() < lasts);
    give_all(
        events,
        std::iter::repeat(setpoint.clone()).take_while(goes_on),
    );
}

/// Gives one set-point after the other, each after [`PERIOD`], until there is none or nobody takes
/// them any more.
fn give_all(events: &Sender<Event>, setpoints: impl Iterator<Item = Setpoint>) {
    for setpoint in setpoints {
        if !give(events, setpoint) {
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
    let setpoints = std::iter::from_fn(|| {
        let now_ns = monotonic_ns();
        if begun.is_none() && is_driving(socket) {
            begun = Some(now_ns);
        }
        way.window(begun.unwrap_or(now_ns + LEAD_NS), now_ns)
    });
    give_all(events, setpoints);
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

/// Hands a set-point over, decided now unless it says when; false if nobody takes it any more.
fn give(events: &Sender<Event>, mut setpoint: Setpoint) -> bool {
    setpoint.time_ns.get_or_insert_with(monotonic_ns);
    events.send(Event::Setpoint(setpoint)).is_ok()
}

/// An event on standard input or on the socket.
enum Event {
    Setpoint(Setpoint),
    Input(Result<(), String>),
    Answer(String),
    Closed(io::Result<()>),
}

/// Sends the set-points of the options, or those of standard input, until their end.
///
/// # Errors
///
/// The first one that is not a set-point, or that the daemon refuses.
pub fn run(args: &SetpointArgs) -> Result<(), Box<dyn Error>> {
    let source = Source::of(&args.demand)?;
    let mut stream = connect(&args.control.socket)?;
    let prepared = || -> io::Result<UnixStream> {
        stream.set_write_timeout(Some(PATIENCE))?;
        stream.try_clone()
    };
    let answers = prepared().map_err(ClientError::from)?;
    let (events_in, events) = mpsc::channel();
    let answers_in = events_in.clone();
    // Neither is waited for: both end with the process.
    thread::spawn(move || read_answers(answers, &answers_in));
    let socket = args.control.socket.clone();
    thread::spawn(move || match source {
        Source::Input => read_input(&events_in),
        Source::Constant { setpoint, lasts } => repeat(&events_in, &setpoint, lasts),
        Source::Trajectory(way) => follow(&events_in, &way, &socket),
    });
    for event in (Newest { events, next: None }) {
        match event {
            Event::Setpoint(setpoint) => send(&mut stream, setpoint)?,
            // The daemon sends its remaining answers and closes the connection.
            Event::Input(Ok(())) => stream
                .shutdown(Shutdown::Write)
                .map_err(ClientError::from)?,
            Event::Input(Err(error)) => return Err(error.into()),
            Event::Answer(answer) => check(&answer)?,
            Event::Closed(closed) => return Ok(closed.map_err(ClientError::from)?),
        }
    }
    Ok(())
}

fn send(stream: &mut UnixStream, setpoint: Setpoint) -> Result<(), ClientError> {
    let line = Request::Setpoint(setpoint).to_line()?;
    Ok(stream.write_all(line.as_bytes())?)
}

/// Fails with the daemon's reason if it refuses a set-point.
fn check(answer: &str) -> Result<(), ClientError> {
    serde_json::from_str::<Answer>(answer)?.agreed().map(drop)
}

/// The events in order; of the set-points that are waiting, only the last.
struct Newest {
    events: Receiver<Event>,
    /// What came after the last set-point.
    next: Option<Event>,
}

impl Iterator for Newest {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        let mut event = match self.next.take() {
            Some(event) => event,
            None => self.events.recv().ok()?,
        };
        while let Event::Setpoint(_) = event {
            match self.events.try_recv() {
                Ok(newer @ Event::Setpoint(_)) => event = newer,
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
    let mut lines = (1_u64..).zip(io::stdin().lock().lines());
    let ended = lines.try_for_each(|(number, line)| {
        let line = line.map_err(|error| format!("can't read standard input: {error}"))?;
        if line.trim().is_empty() {
            return Ok(());
        }
        match setpoint(&line) {
            // The receiver is gone when the process is about to end.
            Ok(setpoint) => drop(give(events, setpoint)),
            Err(reason) => {
                return Err(format!(
                    "line {number}: {line:?} is not a set-point: {reason}; write VX VY, or VX VY X Y, \
                     or a JSON object such as {{\"steering_rad\":0.1,\"speed_m_s\":0.5}}"
                ));
            }
        }
        Ok(())
    });
    let _ = events.send(Event::Input(ended));
}

fn read_answers(answers: UnixStream, events: &Sender<Event>) {
    let mut lines = BufReader::new(answers).lines();
    let closed = lines.try_for_each(|line| {
        let _ = events.send(Event::Answer(line?));
        Ok(())
    });
    let _ = events.send(Event::Closed(closed));
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
        let (sender, events) = mpsc::channel();
        let line = |number| {
            Event::Setpoint(Setpoint {
                sequence: Some(number),
                ..Setpoint::default()
            })
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
                Event::Setpoint(setpoint) => setpoint.sequence.unwrap().to_string(),
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
            let reason = setpoint(text).unwrap_err();
            assert!(reason.contains(part), "{text}: {reason}");
        }
    }
}
