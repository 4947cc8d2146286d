//! What the daemon records, as observations of the car.

use singletrack_control::{InertialSample, Time};
use singletrack_core::{config::WatchSection, controller::imu_tilt};
use singletrack_mocap::{Observation as Frame, PoseState};
use singletrack_record::{Entry, StatusRecord, TelemetryRecord, TickRecord};

use crate::{BoardReading, Inertial, Observation, PoseReading, TickReading};

impl Observation {
    /// The observation in an entry of the record, if there is one; of the IMU only what `watch` calls
    /// possible. A change of the line is in two ticks, and in none of them alone.
    pub fn of(entry: &Entry, watch: &WatchSection) -> Option<Self> {
        Some(match entry {
            Entry::Tick(TickRecord {
                pilot_time, output, ..
            }) => Self::Tick(TickReading {
                time: *pilot_time,
                mode: output.mode,
                reason: output.reason,
                preflight: output.preflight,
                pose: output
                    .estimate
                    .map(|estimate| (estimate.position.into(), estimate.yaw)),
                point: output.point,
            }),
            Entry::Telemetry(record) => Self::Board(BoardReading::of(record, watch)),
            Entry::Status(record) => Self::Health(*record),
            Entry::Pose(frame) => Self::of_frame(frame),
            Entry::Log(_) | Entry::Configuration(_) | Entry::Drops(_) => return None,
        })
    }

    fn of_frame(frame: &Frame) -> Self {
        let receive = Time(frame.receive_time_ns);
        let state = match frame.state {
            PoseState::Valid(pose) => {
                return Self::Pose(PoseReading {
                    capture: Time(pose.capture_time_ns),
                    receive,
                    uncertainty: pose.capture_uncertainty_ns as f64 * 1e-9,
                    position: [pose.x_m, pose.y_m, pose.z_m],
                    yaw: pose.yaw_rad,
                    roll: pose.roll_rad,
                    pitch: pose.pitch_rad,
                    mean_error: pose.mean_error_m,
                });
            }
            PoseState::NoFrames => "no-frames",
            PoseState::Unbound(_) => "unbound",
            PoseState::Untracked => "untracked",
            PoseState::Absent => "absent",
            PoseState::Rejected(reason) | PoseState::LockedOut(reason) => reason.name(),
            PoseState::Stale { .. } => "stale",
        };
        Self::NoPose { receive, state }
    }
}

impl BoardReading {
    fn of(record: &TelemetryRecord, watch: &WatchSection) -> Self {
        let telemetry = &record.telemetry;
        let board_us = telemetry.board_time_us;
        Self {
            time: Time(record.board_time_host_ns),
            board_us,
            receive: Time(record.receive_time_ns),
            inertial: record.new_imu_time_ns().and_then(|time_ns| {
                let tilt = imu_tilt(telemetry.attitude_q14)?;
                let acceleration = record.linear_acceleration_m_s2();
                let angular_velocity = record.angular_velocity_rad_s();
                let [forward_acceleration, left_acceleration, _] = acceleration;
                let time = Time(time_ns);
                // Which axis is the vertical one is to be found out.
                let is_possible = angular_velocity.iter().all(|&yaw_rate| {
                    watch.is_possible(&InertialSample {
                        time,
                        yaw_rate,
                        forward_acceleration,
                        left_acceleration,
                    })
                });
                is_possible.then_some(Inertial {
                    time,
                    board_us: board_us.wrapping_sub(100 * u32::from(telemetry.imu_age_100us)),
                    acceleration,
                    angular_velocity,
                    roll: tilt.roll,
                    pitch: tilt.pitch,
                })
            }),
            motor_speed: f64::from(telemetry.motor_speed_mm_s) / 1_000.0,
            servo_us: telemetry.servo_us,
            esc_us: telemetry.esc_us,
            mode: telemetry.mode,
            stop_cause: telemetry.stop_cause,
        }
    }
}

/// Observations of a time, each kind in the order of its arrival.
#[derive(Clone, Debug, Default)]
pub(crate) struct Readings {
    pub(crate) boards: Vec<BoardReading>,
    pub(crate) health: Vec<StatusRecord>,
    pub(crate) poses: Vec<PoseReading>,
    /// The states of frames without a pose.
    pub(crate) lost: Vec<&'static str>,
    pub(crate) ticks: Vec<TickReading>,
    pub(crate) links: Vec<bool>,
}

impl Readings {
    pub(crate) fn take(&mut self, observed: &mut Vec<Observation>) {
        for observation in observed.drain(..) {
            match observation {
                Observation::Board(reading) => self.boards.push(reading),
                Observation::Health(health) => self.health.push(health),
                Observation::Pose(pose) => self.poses.push(pose),
                Observation::NoPose { state, .. } => self.lost.push(state),
                Observation::Tick(tick) => self.ticks.push(tick),
                Observation::Link(ready) => self.links.push(ready),
            }
        }
    }

    /// The samples of the IMU.
    pub(crate) fn inertial(&self) -> impl DoubleEndedIterator<Item = Inertial> {
        self.boards.iter().filter_map(|board| board.inertial)
    }

    /// A time in s since the first record of the board; without one since the first pose.
    pub(crate) fn at(&self, time: Time) -> f64 {
        let board = self.boards.first().map(|board| board.time);
        let begin = board.or(self.poses.first().map(|pose| pose.capture));
        begin.map_or(0.0, |begin| time.seconds_since(begin))
    }
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::{
        BoardMode, ImuState, RefusalReason, ResetCause, Sequence, Status, StopCause, Telemetry,
    };
    use singletrack_record::Drops;

    use super::*;

    fn of(entry: &Entry) -> Option<Observation> {
        Observation::of(entry, &WatchSection::default())
    }

    #[test]
    fn telemetry_is_read_in_si_units_and_a_repeated_sample_is_none() {
        let telemetry = Telemetry {
            board_time_us: 1,
            mode: BoardMode::Neutral,
            stop_cause: StopCause::Disarmed,
            last_sequence: Sequence(3),
            imu: ImuState::Fresh,
            imu_age_100us: 12,
            linear_acceleration_mm_s2: [10, -20, 30],
            angular_velocity_mrad_s: [1, 2, -500],
            // Nose down by 0.2 rad.
            attitude_q14: [16_302, 0, 1_636, 0],
            motor_speed_mm_s: 250,
            servo_us: 1_500,
            esc_us: 1_490,
        };
        let mut record = TelemetryRecord {
            receive_time_ns: 90,
            board_time_host_ns: 70,
            imu_time_host_ns: Some(60),
            telemetry,
        };
        let reading = |record| match of(&Entry::Telemetry(record)) {
            Some(Observation::Board(reading)) => reading,
            other => panic!("{other:?}"),
        };
        let board = reading(record);
        assert_eq!((board.time, board.receive), (Time(70), Time(90)));
        assert_eq!((board.servo_us, board.esc_us), (1_500, 1_490));
        assert_eq!(board.motor_speed, 0.25);
        let inertial = board.inertial.unwrap();
        assert_eq!(inertial.time, Time(60));
        assert_eq!(inertial.angular_velocity, [0.001, 0.002, -0.5]);
        assert_eq!(inertial.acceleration, [0.01, -0.02, 0.03]);
        assert!((inertial.pitch - 0.2).abs() < 1e-3 && inertial.roll.abs() < 1e-9);

        record.telemetry.imu = ImuState::Repeated;
        assert_eq!(reading(record).inertial, None);

        // A wrong bit of the yaw rate, or of the attitude.
        record.telemetry.imu = ImuState::Fresh;
        record.telemetry.angular_velocity_mrad_s[2] ^= 1 << 14;
        assert_eq!(reading(record).inertial, None);
        record.telemetry.angular_velocity_mrad_s[2] ^= 1 << 14;
        record.telemetry.attitude_q14[3] ^= 1 << 14;
        assert_eq!(reading(record).inertial, None);
    }

    #[test]
    fn status_and_frames_are_observed_and_other_entries_are_not() {
        let status = Status {
            board_time_us: 5,
            configuration_hash: 77,
            reset_cause: ResetCause::External,
            stop_input_open: true,
            battery_mv: 7_400,
            frames_received: 1,
            frames_damaged: 2,
            drives_refused: 3,
            last_refusal: RefusalReason::None,
            frames_dropped: 4,
            bytes_overrun: 5,
            imu_errors: 6,
            supply_mv: 4_900,
            battery_open: false,
            power_on: true,
            edges_refused: 7,
            imu_calibration: 255,
            imu_status: 5,
            imu_error: 0,
            imu_self_test: 15,
        };
        let record = StatusRecord {
            receive_time_ns: 9,
            status,
        };
        assert_eq!(
            of(&Entry::Status(record)),
            Some(Observation::Health(record))
        );
        let receive = Time(9);
        let entry = Entry::Pose(Frame {
            frame_number: 4,
            receive_time_ns: 9,
            state: PoseState::Untracked,
        });
        assert_eq!(
            of(&entry),
            Some(Observation::NoPose {
                receive,
                state: "untracked"
            })
        );
        let drops = Drops {
            time_ns: 9,
            entries: 1,
        };
        assert_eq!(of(&Entry::Drops(drops)), None);
    }
}
