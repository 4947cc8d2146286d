//! Set-points of a client: the checks that need more than the line, which connection gives them, and the
//! count of those that have no effect.

use std::{
    collections::BTreeMap,
    sync::{Arc, PoisonError, Weak},
};

use serde::Serialize;
use serde_json::Value;
use singletrack_api::{Answer, Code, Refused, has_null, is_too_large};
use singletrack_control::Time;
use singletrack_core::setpoint::{SetpointCommand, code};
use singletrack_pilot::SetpointRefusal;

use crate::{clock::monotonic_ns, handle::DaemonHandle};

/// The set-points of one connection.
#[derive(Debug, Default)]
pub(super) struct SetpointStream {
    identity: Identity,
    /// The number of the last one that was accepted.
    sequence: Option<u32>,
}

impl SetpointStream {
    /// Passes a set-point on; `None` unless it has no effect, which is then answered.
    pub(super) fn pass(
        &mut self,
        daemon: &DaemonHandle,
        command: &SetpointCommand,
    ) -> Option<Answer> {
        let timeout = daemon.reconfigurer.published().setpoint_timeout();
        // Held until it is passed on, so that the newest one is also the last one in the slot. It is
        // replaced as a whole: a panic leaves none that is half new.
        let mut newest = daemon
            .newest_setpoint
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if let Err(rejected) = self.admit(command, &mut newest, Time(monotonic_ns()), timeout) {
            return Some(reject(daemon, &rejected));
        }
        daemon.setpoints.pass(command);
        daemon.status.tally().figures.setpoints.accepted += 1;
        None
    }

    /// Checks what the line alone does not tell, and takes note of a set-point that passes;
    /// `timeout` is `None` if no set-points are obeyed.
    fn admit(
        &mut self,
        command: &SetpointCommand,
        newest: &mut Newest,
        now: Time,
        timeout: Option<f64>,
    ) -> Result<(), Refused> {
        let timeout = timeout.ok_or_else(|| {
            Refused::new(
                Code::NotExternal,
                "set-points are not in use: reference.kind is not \"external\"; change it with \
                 set-reference or in the configuration",
            )
        })?;
        let stamp = command.stamp();
        stamp.check(now, timeout).map_err(|error| {
            let age_ms = now.seconds_since(stamp.time) * 1e3;
            Refused::new(
                code(error),
                format_args!(
                    "the set-point is {age_ms:.0} ms old: reference.setpoint_timeout_ms is {:.0}",
                    timeout * 1e3
                ),
            )
        })?;
        newest.admits(&self.identity, now, timeout)?;
        if let (Some(last), Some(sequence)) = (self.sequence, stamp.sequence)
            && sequence <= last
        {
            return Err(Refused::new(
                Code::Sequence,
                format_args!("sequence is {sequence}: the last one of this connection was {last}"),
            ));
        }
        self.sequence = stamp.sequence.or(self.sequence);
        newest.replace(&self.identity, stamp.time);
        Ok(())
    }
}

/// Counts a rejected set-point. Returns the answer.
pub(super) fn reject(daemon: &DaemonHandle, rejected: &Refused) -> Answer {
    let mut tally = daemon.status.tally();
    tally.figures.setpoints.reject(rejected.code);
    Answer {
        rejected: true,
        ..Answer::refusal(rejected.clone())
    }
}

/// A connection, for as long as it exists.
type Identity = Arc<()>;

/// The newest set-point that was accepted: when it was decided, and of which connection it is.
///
/// Two programs that steer at the same time would drive the car by turns. So one connection is
/// the source: the one that gave the newest set-point, for as long as it is connected and that
/// set-point is younger than the time-out. It need not be the one that holds the drive: a person
/// may hold it while a program steers.
#[derive(Debug, Default)]
pub(crate) struct Newest(Option<(Time, Weak<()>)>);

impl Newest {
    /// Whether a set-point of `connection` may replace it at `now`.
    fn admits(&self, connection: &Identity, now: Time, timeout: f64) -> Result<(), Refused> {
        let Self(Some((newest, source))) = self else {
            return Ok(());
        };
        let is_other = source
            .upgrade()
            .is_some_and(|source| !Arc::ptr_eq(&source, connection));
        if is_other && now.seconds_since(*newest) <= timeout {
            return Err(Refused::new(
                Code::OtherSource,
                format_args!(
                    "another connection gives the set-points: end that program, or wait until it \
                     has given none for {:.0} ms (reference.setpoint_timeout_ms)",
                    timeout * 1e3
                ),
            ));
        }
        Ok(())
    }

    /// Takes note of a set-point that was decided at `time`.
    fn replace(&mut self, connection: &Identity, time: Time) {
        let Self(newest) = self;
        // The pilot refuses one that was decided before the newest.
        if newest.as_ref().is_none_or(|(newest, _)| *newest <= time) {
            *newest = Some((time, Arc::downgrade(connection)));
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
    /// Accepted, and refused by the pilot at its tick; by the pilot's word.
    pub refused: BTreeMap<&'static str, u64>,
}

impl SetpointFigures {
    fn reject(&mut self, why: Code) {
        *self.rejected.entry(why.name()).or_default() += 1;
    }

    /// The pilot refused one that was accepted.
    pub(crate) fn refuse(&mut self, why: SetpointRefusal) {
        *self.refused.entry(why.name()).or_default() += 1;
    }
}

/// Why a line that does not parse is rejected as a set-point; `None` if it is none.
///
/// JSON has no word for what is not finite. Programs write `NaN` or `Infinity`, which is no
/// JSON, `null`, or a number that is too large.
pub(super) fn unreadable(line: &[u8]) -> Option<Code> {
    let contains = |part: &[u8]| line.windows(part.len()).any(|window| window == part);
    contains(b"\"setpoint\"").then(|| {
        let is_number = match serde_json::from_slice::<Value>(line) {
            // The null of a key counts as left out.
            Ok(Value::Object(keys)) => keys.values().any(|it| !it.is_null() && has_null(it)),
            Ok(_) => false,
            Err(error) => is_too_large(&error),
        };
        let is_word = [&b"NaN"[..], b"nan", b"Infinity", b"inf"];
        if is_number || is_word.into_iter().any(contains) {
            Code::NotFinite
        } else {
            Code::Invalid
        }
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const SECOND: u64 = 1_000_000_000;
    const NOW: Time = Time(100 * SECOND);
    const TIMEOUT: f64 = 0.2;

    const fn after(ms: u64) -> Time {
        Time(NOW.0 + ms * 1_000_000)
    }

    const fn before(ms: u64) -> Time {
        Time(NOW.0 - ms * 1_000_000)
    }

    fn command(time: Time, sequence: Option<u32>) -> SetpointCommand {
        let keys = singletrack_api::Setpoint {
            velocity_m_s: Some([0.1, 0.0]),
            time_ns: Some(time.0),
            sequence,
            ..Default::default()
        };
        SetpointCommand::of(keys, time).unwrap()
    }

    /// What becomes of a set-point that was decided at `time` and is read at `now`.
    fn admit(
        stream: &mut SetpointStream,
        newest: &mut Newest,
        (time, sequence): (Time, Option<u32>),
        now: Time,
    ) -> Result<(), Code> {
        let admitted = stream.admit(&command(time, sequence), newest, now, Some(TIMEOUT));
        admitted.map_err(|rejected| rejected.code)
    }

    #[test]
    fn numbers_must_grow_within_a_connection_and_may_be_left_out() {
        let (mut stream, mut newest) = (SetpointStream::default(), Newest::default());
        let mut admit = |sequence| admit(&mut stream, &mut newest, (NOW, sequence), NOW);
        for sequence in [Some(0), Some(7), None, Some(8), Some(u32::MAX)] {
            assert_eq!(admit(sequence), Ok(()), "{sequence:?}");
        }
        for sequence in [u32::MAX, 8, 0] {
            assert_eq!(admit(Some(sequence)), Err(Code::Sequence));
        }
        assert_eq!(admit(None), Ok(()));
    }

    #[test]
    fn a_set_point_older_than_the_time_out_or_without_use_is_rejected_and_takes_no_number() {
        let (mut stream, mut newest) = (SetpointStream::default(), Newest::default());
        let mut admit = |ms, timeout| {
            let setpoint = command(before(ms), Some(1));
            let admitted = stream.admit(&setpoint, &mut newest, NOW, timeout);
            admitted.map_err(|rejected| rejected.code)
        };
        assert_eq!(admit(201, Some(TIMEOUT)), Err(Code::Old));
        assert_eq!(admit(0, None), Err(Code::NotExternal));
        assert_eq!(admit(200, Some(TIMEOUT)), Ok(()));
        assert_eq!(admit(0, Some(TIMEOUT)), Err(Code::Sequence));
    }

    #[test]
    fn while_one_connection_gives_set_points_those_of_another_are_rejected() {
        let mut newest = Newest::default();
        let (mut one, mut other) = (SetpointStream::default(), SetpointStream::default());
        for ms in 0..50 {
            let now = after(10 * ms);
            let number = Some(ms as u32 + 1);
            assert_eq!(admit(&mut one, &mut newest, (now, None), now), Ok(()));
            assert_eq!(
                admit(&mut other, &mut newest, (now, number), now),
                Err(Code::OtherSource)
            );
        }
        // Its last one is of 490 ms. A rejected one has taken no number.
        let refused = admit(&mut other, &mut newest, (after(690), Some(1)), after(690));
        assert_eq!(refused, Err(Code::OtherSource));
        let taken = admit(&mut other, &mut newest, (after(691), Some(1)), after(691));
        assert_eq!(taken, Ok(()));
        let refused = admit(&mut one, &mut newest, (after(692), None), after(692));
        assert_eq!(refused, Err(Code::OtherSource));
    }

    #[test]
    fn a_connection_that_has_ended_gives_way_at_once() {
        let mut newest = Newest::default();
        let (mut one, mut other) = (SetpointStream::default(), SetpointStream::default());
        assert_eq!(admit(&mut one, &mut newest, (NOW, None), NOW), Ok(()));
        drop(one);
        let later = after(1);
        assert_eq!(admit(&mut other, &mut newest, (later, None), later), Ok(()));
    }

    #[test]
    fn the_age_of_the_source_is_that_of_its_newest_set_point_in_whatever_order_they_come() {
        let mut newest = Newest::default();
        let (mut one, mut other) = (SetpointStream::default(), SetpointStream::default());
        for ms in [50, 150] {
            let given = admit(&mut one, &mut newest, (before(ms), None), NOW);
            assert_eq!(given, Ok(()));
        }
        for (ms, result) in [(150, Err(Code::OtherSource)), (151, Ok(()))] {
            let now = after(ms);
            assert_eq!(admit(&mut other, &mut newest, (now, None), now), result);
        }
    }

    #[test]
    fn every_rejection_and_refusal_is_counted_by_its_word() {
        let mut figures = SetpointFigures::default();
        let codes = [
            Code::Invalid,
            Code::NotFinite,
            Code::OutOfRange,
            Code::Future,
            Code::Old,
            Code::Sequence,
            Code::OtherSource,
            Code::NotExternal,
        ];
        for (count, why) in (1..).zip(codes) {
            for _ in 0..count {
                figures.reject(why);
            }
        }
        for (count, why) in (1..).zip(SetpointRefusal::ALL) {
            for _ in 0..count {
                figures.refuse(why);
            }
        }
        assert_eq!(
            serde_json::to_value(figures).unwrap(),
            json!({
                "accepted": 0,
                "rejected": {
                    "invalid": 1, "not-finite": 2, "out-of-range": 3, "future": 4, "old": 5,
                    "sequence": 6, "other-source": 7, "not-external": 8,
                },
                "refused": {
                    "not-finite": 1, "out-of-range": 2, "future": 3, "old": 4, "superseded": 5,
                    "incomplete": 6, "not-external": 7,
                },
            })
        );
    }
}
