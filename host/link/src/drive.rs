//! Drive commands: from SI units to the wire, with the ages; and how long one takes to the board and
//! back.

use singletrack_protocol::words;
use singletrack_protocol::{BoardMode, Drive, Sequence};

/// The set points of the car until the next command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveCommand {
    /// Speed of the rear axle along the car, forward positive, in m/s.
    pub speed_m_s: f64,
    /// Steering angle of the front wheels, left positive, in radians.
    pub steering_rad: f64,
    /// Brake down to the speed where the ESC can; otherwise a car that is too fast
    /// gets neutral.
    pub brake: bool,
    /// Mid-exposure of the last accepted pose that the command rests on, in
    /// host nanoseconds; neither holding nor coasting renews it. `None` before the
    /// first accepted pose.
    pub pose_time_ns: Option<u64>,
}

/// Bare pulses for servo and ESC. The board clamps them to its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JogCommand {
    /// Servo pulse, in µs.
    pub servo_us: u16,
    /// ESC pulse, in µs.
    pub esc_us: u16,
}

words! {
    /// A quantity of a drive command.
    pub enum Quantity {
        /// [`DriveCommand::speed_m_s`].
        SpeedMetresPerSecond = "speed in m/s",
        /// [`DriveCommand::steering_rad`].
        SteeringRadians = "steering in rad",
    }
}

impl Quantity {
    /// Steps of the wire in one unit.
    const fn steps_per_unit(self) -> f64 {
        match self {
            Self::SpeedMetresPerSecond => 1_000.0,
            Self::SteeringRadians => 10_000.0,
        }
    }

    /// The largest magnitude that the wire can carry.
    pub fn limit(self) -> f64 {
        f64::from(i16::MAX) / self.steps_per_unit()
    }

    fn scale(self, value: f64) -> Result<i16, DriveError> {
        // NaN fails this comparison too.
        if value.abs() <= self.limit() {
            let steps = value * self.steps_per_unit();
            // To the nearest; `as` truncates, and the range has been checked.
            return Ok((steps + 0.5_f64.copysign(steps)) as i16);
        }
        let quantity = self;
        Err(if value.is_finite() {
            DriveError::OutOfRange { quantity, value }
        } else {
            DriveError::NotFinite { quantity, value }
        })
    }
}

/// Why the session can't carry out a request now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotReady {
    /// The board is not connected and configured.
    #[error("the board is not connected and configured: wait for ConfigurationAccepted")]
    NotConfigured,
    /// The board is configured, and no telemetry has arrived yet.
    #[error("no telemetry yet: it comes within 10 ms of ConfigurationAccepted")]
    NoTelemetry,
    /// The board would refuse it.
    #[error("the board is not armed (its mode is {mode:?}): arm first")]
    NotArmed {
        /// Its mode by the newest telemetry.
        mode: BoardMode,
    },
    /// Only possible while the board is not armed.
    #[error("the board is armed: disarm first")]
    Armed,
    /// The board has not answered the last request to arm.
    #[error("a request to arm is waiting for its answer")]
    ArmPending,
    /// A stop has been asked for and telemetry does not show it yet.
    #[error("a stop is waiting to be confirmed by telemetry")]
    StopPending,
}

/// Why a drive command is not sent.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum DriveError {
    /// Not in this state.
    #[error(transparent)]
    NotReady(#[from] NotReady),
    /// Not a number, or infinite.
    #[error("the {} is {value}", quantity.name())]
    NotFinite {
        /// The quantity.
        quantity: Quantity,
        /// Its value.
        value: f64,
    },
    /// Beyond the wire's range. (The board enforces the limits of the car.)
    #[error("the {} is {value}, beyond ±{} that can be sent", quantity.name(), quantity.limit())]
    OutOfRange {
        /// The quantity.
        quantity: Quantity,
        /// Its value.
        value: f64,
    },
}

/// The newest telemetry, as far as commands rest on it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NewestTelemetry {
    pub(crate) mode: BoardMode,
    pub(crate) last_sequence: Sequence,
    pub(crate) board_time_us: u32,
    pub(crate) host_time_ns: u64,
}

/// The message of a command that rests on the telemetry `newest`.
pub(crate) fn message(
    command: &DriveCommand,
    sequence: Sequence,
    newest: &NewestTelemetry,
) -> Result<Drive, DriveError> {
    Ok(Drive {
        sequence,
        speed_mm_s: Quantity::SpeedMetresPerSecond.scale(command.speed_m_s)?,
        steering_100urad: Quantity::SteeringRadians.scale(command.steering_rad)?,
        telemetry_time_us: newest.board_time_us,
        pose_age_ms: pose_age_ms(command.pose_time_ns, newest.host_time_ns),
        brake: command.brake,
    })
}

/// Age of the pose at the board time of the telemetry, to which the board adds the
/// telemetry's own age. It is rounded up, so that a pose is never taken for younger
/// than it is; zero when the pose is newer than the telemetry.
fn pose_age_ms(pose_time_ns: Option<u64>, telemetry_time_ns: u64) -> u16 {
    let Some(pose_time_ns) = pose_time_ns else {
        return u16::MAX;
    };
    let age_ns = telemetry_time_ns.saturating_sub(pose_time_ns);
    u16::try_from(age_ns.div_ceil(1_000_000)).unwrap_or(u16::MAX)
}

/// The number of the next command: the last one's successor, unless the board would
/// not take it for newer than the command it accepted last (from another run of the
/// host, or after more than 127 lost commands).
pub(crate) fn next_sequence(last_sent: Sequence, last_accepted: Sequence) -> Sequence {
    let next = last_sent.next();
    let newer = next.is_newer_than(last_accepted);
    if newer { next } else { last_accepted.next() }
}

/// Commands remembered until their echo: 320 ms at 100 Hz, more than the time to
/// live of a command on the board.
const REMEMBERED: usize = 32;

/// Time from handing out a [`Drive`] to the
/// arrival of the first telemetry that names it as accepted.
///
/// It includes both ways on the wire and up to one telemetry period of waiting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoundTrip {
    /// The shortest so far, in nanoseconds.
    pub min_ns: u64,
    /// The last, in nanoseconds.
    pub last_ns: u64,
}

/// Matches commands with their echoes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Latency {
    sent: [Option<(Sequence, u64)>; REMEMBERED],
    /// The time to the board and back; none before the first answer.
    pub(crate) round_trip: Option<RoundTrip>,
}

impl Latency {
    pub(crate) fn sent(&mut self, now_ns: u64, sequence: Sequence) {
        self.sent[slot(sequence)] = Some((sequence, now_ns));
    }

    /// Telemetry reports `sequence` as the last accepted command.
    pub(crate) fn echoed(&mut self, now_ns: u64, sequence: Sequence) {
        let sent = &mut self.sent[slot(sequence)];
        if let Some((_, sent_ns)) = sent.take_if(|(sent, _)| *sent == sequence) {
            let last_ns = now_ns.saturating_sub(sent_ns);
            let before_ns = self.round_trip.map_or(last_ns, |before| before.min_ns);
            let min_ns = before_ns.min(last_ns);
            self.round_trip = Some(RoundTrip { min_ns, last_ns });
        }
    }

    /// Forgets the commands that wait for an echo, and keeps the measured times.
    pub(crate) fn forget_sent(&mut self) {
        self.sent = [None; REMEMBERED];
    }
}

fn slot(sequence: Sequence) -> usize {
    usize::from(sequence.0) % REMEMBERED
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEWEST: NewestTelemetry = NewestTelemetry {
        mode: BoardMode::Armed,
        last_sequence: Sequence(0),
        board_time_us: 77,
        host_time_ns: 5_000_000_000,
    };

    fn command(speed_m_s: f64, steering_rad: f64) -> DriveCommand {
        DriveCommand {
            speed_m_s,
            steering_rad,
            brake: false,
            pose_time_ns: None,
        }
    }

    #[test]
    fn values_are_rounded_to_the_nearest_step_with_their_sign() {
        let drive = message(&command(0.397_455, -0.328_666), Sequence(3), &NEWEST).unwrap();
        assert_eq!((drive.speed_mm_s, drive.steering_100urad), (397, -3287));
        let drive = message(&command(-32.767, 3.2767), Sequence(3), &NEWEST).unwrap();
        assert_eq!(
            (drive.speed_mm_s, drive.steering_100urad),
            (-32_767, 32_767)
        );
    }

    #[test]
    fn a_value_that_cannot_be_sent_is_an_error_that_names_it() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(matches!(
                message(&command(bad, 0.0), Sequence(3), &NEWEST),
                Err(DriveError::NotFinite {
                    quantity: Quantity::SpeedMetresPerSecond,
                    ..
                })
            ));
            assert!(matches!(
                message(&command(0.0, bad), Sequence(3), &NEWEST),
                Err(DriveError::NotFinite {
                    quantity: Quantity::SteeringRadians,
                    ..
                })
            ));
        }
        assert!(matches!(
            message(&command(32.768, 0.0), Sequence(3), &NEWEST),
            Err(DriveError::OutOfRange { .. })
        ));
        assert!(matches!(
            message(&command(0.0, -3.2768), Sequence(3), &NEWEST),
            Err(DriveError::OutOfRange { .. })
        ));
    }

    #[test]
    fn the_pose_age_is_rounded_up_and_saturates() {
        let at = NEWEST.host_time_ns;
        assert_eq!(pose_age_ms(Some(at), at), 0);
        assert_eq!(pose_age_ms(Some(at + 3_000_000), at), 0);
        assert_eq!(pose_age_ms(Some(at - 1), at), 1);
        assert_eq!(pose_age_ms(Some(at - 8_000_000), at), 8);
        assert_eq!(pose_age_ms(Some(at - 8_000_001), at), 9);
        assert_eq!(pose_age_ms(Some(0), 70_000_000_000), u16::MAX);
        assert_eq!(pose_age_ms(None, at), u16::MAX);
    }

    #[test]
    fn every_number_is_newer_than_the_last_accepted_one() {
        for sent in 0..=u8::MAX {
            for accepted in 0..=u8::MAX {
                let next = next_sequence(Sequence(sent), Sequence(accepted));
                assert!(next.is_newer_than(Sequence(accepted)));
            }
        }
        assert_eq!(next_sequence(Sequence(41), Sequence(40)), Sequence(42));
    }

    #[test]
    fn the_first_echo_counts_and_repeats_do_not() {
        let mut latency = Latency::default();
        latency.sent(1_000, Sequence(7));
        latency.echoed(9_000, Sequence(7));
        latency.echoed(19_000, Sequence(7));
        latency.sent(20_000, Sequence(8));
        latency.echoed(25_000, Sequence(8));
        assert_eq!(
            latency.round_trip,
            Some(RoundTrip {
                min_ns: 5_000,
                last_ns: 5_000
            })
        );
    }

    #[test]
    fn an_echo_of_another_session_measures_nothing() {
        let mut latency = Latency::default();
        latency.sent(1_000, Sequence(7));
        latency.echoed(9_000, Sequence(39));
        latency.forget_sent();
        latency.echoed(9_000, Sequence(7));
        assert_eq!(latency.round_trip, None);
    }
}
