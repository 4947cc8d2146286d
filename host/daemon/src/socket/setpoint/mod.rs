//! Set-points of a client: the checks that need more than the line.

mod rejection;
mod source;

use singletrack_api::{Answer, Code, Refused};
use singletrack_control::Time;
use singletrack_core::setpoint::{SetpointCommand, code};

use crate::{clock::monotonic_ns, handle::DaemonHandle};

pub use rejection::SetpointFigures;
pub(super) use rejection::unreadable;
pub(crate) use source::SetpointSource;
use source::{Identity, Newest};

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
        // Held until it is passed on, so that the newest one is also the last one in the slot.
        let mut newest = daemon.source.lock();
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

#[cfg(test)]
mod tests {
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
}
