//! Set-points of a client: their keys, the checks, and the count of those rejected.

use core::{fmt, sync::atomic::AtomicU64};
use std::{collections::BTreeMap, sync::atomic::Ordering};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use singletrack_control::{
    Demand, MAX_TRAJECTORY_POINTS, Position, ReferencePoint, Setpoint, SetpointError,
    SetpointStamp, SpeedDemand, SteeringDemand, Time, Trajectory, TrajectoryPoint, Velocity,
};

use super::command::SOCKET_VERSION;
use crate::{clock::monotonic_ns, handle::DaemonHandle};

/// A set-point of a client.
#[derive(Clone, Debug, PartialEq)]
pub enum SetpointCommand {
    /// A velocity of P, or steering and speed.
    Setpoint(Setpoint),
    /// Points in time.
    Trajectory(Box<Trajectory>),
}

/// The keys of a set-point.
#[derive(Debug, Default)]
pub(super) struct SetpointKeys {
    pub(super) velocity_m_s: Option<[f64; 2]>,
    pub(super) position_m: Option<[f64; 2]>,
    pub(super) steering_rad: Option<f64>,
    pub(super) steering_rate_rad_s: Option<f64>,
    pub(super) speed_m_s: Option<f64>,
    pub(super) acceleration_m_s2: Option<f64>,
    pub(super) trajectory: Option<Vec<PointKeys>>,
    pub(super) time_ns: Option<u64>,
    pub(super) sequence: Option<u32>,
}

/// A point of a trajectory, as a client writes it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PointKeys {
    time_ns: u64,
    position_m: [f64; 2],
    velocity_m_s: [f64; 2],
}

/// Why a set-point has no effect, as a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejection {
    /// The line is no set-point.
    Invalid,
    /// A value is infinite or not a number.
    NotFinite,
    /// A value is beyond that of any car, or a trajectory is not one.
    OutOfRange,
    /// It was decided later than now, or its trajectory begins too late.
    Future,
    /// It is older than the time-out, or its trajectory is over.
    Old,
    /// Its number is not above the last one of this connection.
    Sequence,
    /// The reference in force is not external.
    NotExternal,
}

impl Rejection {
    const ALL: [Self; 7] = [
        Self::Invalid,
        Self::NotFinite,
        Self::OutOfRange,
        Self::Future,
        Self::Old,
        Self::Sequence,
        Self::NotExternal,
    ];

    /// The word in answers and figures.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Invalid => "invalid",
            Self::NotFinite => "not-finite",
            Self::OutOfRange => "out-of-range",
            Self::Future => "future",
            Self::Old => "old",
            Self::Sequence => "sequence",
            Self::NotExternal => "not-external",
        }
    }
}

/// Why a set-point has no effect: the text of the answer and the word.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Rejected {
    pub(super) why: Rejection,
    pub(super) text: String,
}

impl Rejected {
    fn new(why: Rejection, text: impl fmt::Display) -> Self {
        Self {
            why,
            text: text.to_string(),
        }
    }
}

/// Counts of set-points since the daemon started.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SetpointFigures {
    /// Passed on to the control thread.
    pub accepted: u64,
    /// Rejected, by the word of the answer; without the words that never occurred.
    pub rejected: BTreeMap<&'static str, u64>,
}

/// Counts set-points.
#[derive(Debug, Default)]
pub(crate) struct SetpointCounters {
    accepted: AtomicU64,
    rejected: [AtomicU64; Rejection::ALL.len()],
}

impl SetpointCounters {
    /// The counts so far.
    pub(crate) fn figures(&self) -> SetpointFigures {
        let rejected = Rejection::ALL.into_iter().zip(&self.rejected);
        SetpointFigures {
            accepted: self.accepted.load(Ordering::Relaxed),
            rejected: rejected
                .map(|(why, count)| (why.name(), count.load(Ordering::Relaxed)))
                .filter(|(_, count)| *count > 0)
                .collect(),
        }
    }

    fn reject(&self, why: Rejection) {
        let counters = Rejection::ALL.into_iter().zip(&self.rejected);
        for (_, counter) in counters.filter(|(other, _)| *other == why) {
            counter.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The set-points of one connection.
#[derive(Debug, Default)]
pub(super) struct SetpointStream {
    /// The number of the last one that was accepted.
    sequence: Option<u32>,
}

impl SetpointStream {
    /// Passes a set-point on; `None` unless it has no effect, which is then answered.
    pub(super) fn pass(
        &mut self,
        daemon: &DaemonHandle,
        command: &SetpointCommand,
    ) -> Option<Value> {
        let timeout = daemon.reconfigurer.setpoint_timeout();
        if let Err(rejected) = self.admit(command, Time(monotonic_ns()), timeout) {
            return Some(reject(daemon, &rejected));
        }
        match command {
            SetpointCommand::Setpoint(setpoint) => daemon.setpoints.send(setpoint),
            SetpointCommand::Trajectory(trajectory) => daemon.setpoints.send_trajectory(trajectory),
        }
        let counters = &daemon.status.setpoints;
        counters.accepted.fetch_add(1, Ordering::Relaxed);
        None
    }

    /// Checks what the line alone does not tell; `timeout` is `None` if no set-points are obeyed.
    fn admit(
        &mut self,
        command: &SetpointCommand,
        now: Time,
        timeout: Option<f64>,
    ) -> Result<(), Rejected> {
        let timeout = timeout.ok_or_else(|| {
            Rejected::new(
                Rejection::NotExternal,
                "set-points are not in use: reference.kind is not \"external\"; change it with \
                 set-reference or in the configuration",
            )
        })?;
        let stamp = match command {
            SetpointCommand::Setpoint(setpoint) => setpoint.stamp,
            SetpointCommand::Trajectory(trajectory) => trajectory.stamp,
        };
        stamp.check(now, timeout).map_err(|error| {
            let age_ms = now.seconds_since(stamp.time) * 1e3;
            Rejected::new(
                word(error),
                format_args!(
                    "the set-point is {age_ms:.0} ms old: reference.setpoint_timeout_ms is {:.0}",
                    timeout * 1e3
                ),
            )
        })?;
        match (self.sequence, stamp.sequence) {
            (Some(last), Some(sequence)) if sequence <= last => Err(Rejected::new(
                Rejection::Sequence,
                format_args!("sequence is {sequence}: the last one of this connection was {last}"),
            )),
            (_, sequence) => {
                self.sequence = sequence.or(self.sequence);
                Ok(())
            }
        }
    }
}

/// Counts a rejected set-point. Returns the answer.
pub(super) fn reject(daemon: &DaemonHandle, rejected: &Rejected) -> Value {
    daemon.status.setpoints.reject(rejected.why);
    json!({
        "version": SOCKET_VERSION,
        "ok": false,
        "error": rejected.text,
        "rejected": rejected.why.name(),
    })
}

/// Why a line that does not parse is rejected as a set-point; `None` if it is none.
///
/// JSON has no word for what is not finite. Programs write `NaN` or `Infinity`, which is no
/// JSON, `null`, or a number that is too large.
pub(super) fn unreadable(line: &[u8], error: &serde_json::Error) -> Option<Rejection> {
    let contains = |part: &[u8]| line.windows(part.len()).any(|window| window == part);
    contains(b"\"setpoint\"").then(|| {
        let text = error.to_string();
        let is_number = text.contains("invalid type: null, expected f64")
            || text.contains("number out of range");
        let is_word = [&b"NaN"[..], b"nan", b"Infinity", b"inf"];
        if is_number || is_word.into_iter().any(contains) {
            Rejection::NotFinite
        } else {
            Rejection::Invalid
        }
    })
}

impl SetpointKeys {
    /// The set-point of a line that was read at `now_ns`.
    pub(super) fn parse(self, now_ns: u64) -> Result<SetpointCommand, Rejected> {
        let now = Time(now_ns);
        let stamp = SetpointStamp {
            time: self.time_ns.map_or(now, Time),
            sequence: self.sequence,
        };
        let command = self.command(stamp)?;
        let checked = match &command {
            SetpointCommand::Setpoint(setpoint) => setpoint.check(now, f64::INFINITY),
            SetpointCommand::Trajectory(trajectory) => trajectory.check(now, f64::INFINITY),
        };
        checked.map_err(|error| {
            let why = word(error);
            match (error, &command) {
                (SetpointError::Future, _) if stamp.time > now => Rejected::new(
                    why,
                    format_args!(
                        "time_ns is {}: CLOCK_MONOTONIC of this computer says {now_ns}",
                        stamp.time.0
                    ),
                ),
                (SetpointError::Future, _) => Rejected::new(
                    why,
                    format_args!(
                        "the trajectory begins more than a second after now, which is {now_ns}"
                    ),
                ),
                (SetpointError::Old, SetpointCommand::Trajectory(_)) => Rejected::new(
                    why,
                    format_args!("the trajectory ends before now, which is {now_ns}"),
                ),
                _ => Rejected::new(why, error),
            }
        })?;
        Ok(command)
    }

    fn command(self, stamp: SetpointStamp) -> Result<SetpointCommand, Rejected> {
        let invalid = |text: &str| Rejected::new(Rejection::Invalid, text);
        let acts = self.steering_rad.is_some()
            || self.steering_rate_rad_s.is_some()
            || self.speed_m_s.is_some()
            || self.acceleration_m_s2.is_some();
        let points = self.velocity_m_s.is_some() || self.position_m.is_some();
        let demand = match (points, acts, self.trajectory) {
            (false, false, Some(points)) => {
                if points.len() > MAX_TRAJECTORY_POINTS {
                    return Err(Rejected::new(
                        Rejection::OutOfRange,
                        format_args!("a trajectory has at most {MAX_TRAJECTORY_POINTS} points"),
                    ));
                }
                let points = points.iter().map(PointKeys::point).collect();
                let trajectory = Trajectory { stamp, points };
                return Ok(SetpointCommand::Trajectory(Box::new(trajectory)));
            }
            (true, false, None) => Demand::Point(ReferencePoint {
                position: self.position_m.map(|[x, y]| Position::new(x, y)),
                velocity: self
                    .velocity_m_s
                    .map(|[x, y]| Velocity::new(x, y))
                    .ok_or_else(|| invalid("position_m needs velocity_m_s, such as [0.0,0.0]"))?,
            }),
            (false, true, None) => Demand::Actuation {
                steering: match (self.steering_rad, self.steering_rate_rad_s) {
                    (Some(angle), None) => SteeringDemand::Angle(angle),
                    (None, Some(rate)) => SteeringDemand::Rate(rate),
                    _ => {
                        return Err(invalid(
                            "setpoint needs steering_rad or steering_rate_rad_s",
                        ));
                    }
                },
                speed: match (self.speed_m_s, self.acceleration_m_s2) {
                    (Some(speed), None) => SpeedDemand::Speed(speed),
                    (None, Some(acceleration)) => SpeedDemand::Acceleration(acceleration),
                    _ => return Err(invalid("setpoint needs speed_m_s or acceleration_m_s2")),
                },
            },
            _ => {
                return Err(invalid(
                    "setpoint needs velocity_m_s, such as [0.4,0.0]; or steering_rad and \
                     speed_m_s; or trajectory",
                ));
            }
        };
        Ok(SetpointCommand::Setpoint(Setpoint { stamp, demand }))
    }
}

impl PointKeys {
    const fn point(&self) -> TrajectoryPoint {
        let ([x, y], [v_x, v_y]) = (self.position_m, self.velocity_m_s);
        TrajectoryPoint {
            time: Time(self.time_ns),
            position: Position::new(x, y),
            velocity: Velocity::new(v_x, v_y),
        }
    }
}

const fn word(error: SetpointError) -> Rejection {
    match error {
        SetpointError::NotFinite => Rejection::NotFinite,
        SetpointError::OutOfRange(_) | SetpointError::Incomplete => Rejection::OutOfRange,
        SetpointError::Future => Rejection::Future,
        SetpointError::Old | SetpointError::Superseded => Rejection::Old,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;
    const NOW: Time = Time(100 * SECOND);

    fn command(time: Time, sequence: Option<u32>) -> SetpointCommand {
        let keys = SetpointKeys {
            velocity_m_s: Some([0.1, 0.0]),
            time_ns: Some(time.0),
            sequence,
            ..SetpointKeys::default()
        };
        keys.parse(NOW.0).unwrap()
    }

    #[test]
    fn numbers_must_grow_within_a_connection_and_may_be_left_out() {
        let mut stream = SetpointStream::default();
        let mut admit = |sequence| {
            let admitted = stream.admit(&command(NOW, sequence), NOW, Some(0.2));
            admitted.map_err(|rejected| rejected.why)
        };
        for sequence in [Some(0), Some(7), None, Some(8), Some(u32::MAX)] {
            assert_eq!(admit(sequence), Ok(()), "{sequence:?}");
        }
        for sequence in [u32::MAX, 8, 0] {
            assert_eq!(admit(Some(sequence)), Err(Rejection::Sequence));
        }
        assert_eq!(admit(None), Ok(()));
    }

    #[test]
    fn a_set_point_older_than_the_time_out_or_without_use_is_rejected_and_takes_no_number() {
        let mut stream = SetpointStream::default();
        let early = |ms: u64| Time(NOW.0 - ms * 1_000_000);
        let mut admit = |ms, timeout| {
            let admitted = stream.admit(&command(early(ms), Some(1)), NOW, timeout);
            admitted.map_err(|rejected| rejected.why)
        };
        assert_eq!(admit(201, Some(0.2)), Err(Rejection::Old));
        assert_eq!(admit(0, None), Err(Rejection::NotExternal));
        assert_eq!(admit(200, Some(0.2)), Ok(()));
        assert_eq!(admit(0, Some(0.2)), Err(Rejection::Sequence));
    }

    #[test]
    fn every_rejection_is_counted_by_its_word() {
        let counters = SetpointCounters::default();
        for (count, why) in (1..).zip(Rejection::ALL) {
            for _ in 0..count {
                counters.reject(why);
            }
        }
        let figures = serde_json::to_value(counters.figures()).unwrap();
        assert_eq!(
            figures["rejected"],
            json!({
                "invalid": 1, "not-finite": 2, "out-of-range": 3, "future": 4, "old": 5,
                "sequence": 6, "not-external": 7,
            })
        );
    }
}
