//! What the daemon reports, as observations of the car.

use serde_json::Value;
use singletrack_commissioning::{
    BoardReading, Health, Inertial, Observation, PoseReading, TickReading,
};
use singletrack_control::{Position, Time};
use singletrack_core::controller::imu_tilt;
use singletrack_pilot::{Mode, Reason};
use singletrack_protocol::{BoardMode, RefusalReason, ResetCause, Status, StopCause};

/// The topics that are watched.
pub(super) const TOPICS: [&str; 4] = ["tick", "telemetry", "status", "pose"];

/// What a frame without a pose may be.
const STATES: [&str; 7] = [
    "no-frames",
    "unbound",
    "untracked",
    "absent",
    "rejected",
    "locked-out",
    "stale",
];

/// The observation in an entry of the record; none if there is none in it, or if the daemon is
/// of another release.
pub(super) fn observation(entry: &Value) -> Option<Observation> {
    match entry.get("topic")?.as_str()? {
        "tick" => tick(entry).map(Observation::Tick),
        "telemetry" => telemetry(entry).map(Observation::Board),
        "status" => status(entry).map(Observation::Health),
        "pose" => pose(entry),
        _ => None,
    }
}

/// Whether the line to the board is ready, in an entry of a tick.
pub(super) fn link_is_ready(entry: &Value) -> Option<bool> {
    Some(entry.get("link")?.as_str()? == "ready")
}

fn tick(entry: &Value) -> Option<TickReading> {
    let estimate = entry.get("estimate").filter(|value| value.is_object());
    let command = entry.get("command").filter(|value| value.is_object());
    let point = entry.get("point").filter(|value| value.is_object());
    Some(TickReading {
        time: time(entry, "pilot_time_ns")?,
        mode: word(entry, "mode", Mode::ALL, Mode::name)?,
        reason: word(entry, "reason", Reason::ALL, Reason::name),
        preflight: word(entry.get("preflight")?, "reason", Reason::ALL, Reason::name),
        pose: estimate.and_then(|estimate| {
            let position = [number(estimate, "x_m")?, number(estimate, "y_m")?];
            Some((position, number(estimate, "yaw_rad")?))
        }),
        command: command.and_then(|command| {
            Some((
                number(command, "rear_speed_m_s")?,
                number(command, "steering_rad")?,
            ))
        }),
        point: point
            .and_then(|point| Some(Position::new(number(point, "x_m")?, number(point, "y_m")?))),
        braking_measured: number(entry, "braking_measured_m_s2"),
    })
}

fn telemetry(entry: &Value) -> Option<BoardReading> {
    let milli = |key| Some(number(entry, key)? / 1_000.0);
    let part = |key| i16::try_from(entry.get(key)?.as_i64()?).ok();
    let board_us = u32::try_from(entry.get("board_time_us")?.as_u64()?).ok()?;
    let is_fresh = entry.get("imu")?.as_str()? == "fresh";
    let inertial = || {
        let tilt = imu_tilt([
            part("attitude_w_q14")?,
            part("attitude_x_q14")?,
            part("attitude_y_q14")?,
            part("attitude_z_q14")?,
        ]);
        Some(Inertial {
            time: time(entry, "imu_time_host_ns")?,
            board_us: board_us.wrapping_sub(100 * u32::from(small(entry, "imu_age_100us")?)),
            acceleration: [
                milli("forward_acceleration_mm_s2")?,
                milli("left_acceleration_mm_s2")?,
                milli("up_acceleration_mm_s2")?,
            ],
            angular_velocity: [
                milli("roll_rate_mrad_s")?,
                milli("pitch_rate_mrad_s")?,
                milli("yaw_rate_mrad_s")?,
            ],
            roll: tilt.roll,
            pitch: tilt.pitch,
        })
    };
    Some(BoardReading {
        time: time(entry, "board_time_host_ns")?,
        board_us,
        receive: time(entry, "receive_time_ns")?,
        inertial: if is_fresh { inertial() } else { None },
        motor_speed: milli("motor_speed_mm_s")?,
        servo_us: small(entry, "servo_us")?,
        esc_us: small(entry, "esc_us")?,
        mode: word(entry, "mode", BoardMode::ALL, BoardMode::name)?,
        stop_cause: word(entry, "stop_cause", StopCause::ALL, StopCause::name)?,
    })
}

fn status(entry: &Value) -> Option<Health> {
    let flag = |key| entry.get(key)?.as_bool();
    let wide = |key| u32::try_from(entry.get(key)?.as_u64()?).ok();
    let byte = |key| u8::try_from(entry.get(key)?.as_u64()?).ok();
    Some(Health {
        receive: time(entry, "receive_time_ns")?,
        status: Status {
            board_time_us: wide("board_time_us")?,
            configuration_hash: wide("configuration_hash")?,
            reset_cause: word(entry, "reset_cause", ResetCause::ALL, ResetCause::name)?,
            stop_input_open: flag("stop_input_open")?,
            battery_mv: small(entry, "battery_mv")?,
            frames_received: small(entry, "frames_received")?,
            frames_damaged: small(entry, "frames_damaged")?,
            drives_refused: small(entry, "drives_refused")?,
            last_refusal: word(
                entry,
                "last_refusal",
                RefusalReason::ALL,
                RefusalReason::name,
            )?,
            frames_dropped: small(entry, "frames_dropped")?,
            bytes_overrun: small(entry, "bytes_overrun")?,
            imu_errors: small(entry, "imu_errors")?,
            supply_mv: small(entry, "supply_mv")?,
            battery_open: flag("battery_open")?,
            power_on: flag("power_on")?,
            edges_refused: small(entry, "edges_refused")?,
            imu_calibration: byte("imu_calibration")?,
            imu_status: byte("imu_status")?,
            imu_error: byte("imu_error")?,
            imu_self_test: byte("imu_self_test")?,
        },
    })
}

fn pose(entry: &Value) -> Option<Observation> {
    let state = entry.get("state")?.as_str()?;
    let receive = time(entry, "receive_time_ns")?;
    let Some(pose) = entry.get("pose").filter(|pose| pose.is_object()) else {
        let state = STATES.into_iter().find(|word| *word == state)?;
        return Some(Observation::NoPose { receive, state });
    };
    Some(Observation::Pose(PoseReading {
        capture: time(pose, "capture_time_ns")?,
        receive,
        uncertainty: number(pose, "capture_uncertainty_ns")? * 1e-9,
        frame: i32::try_from(pose.get("frame_number")?.as_i64()?).ok()?,
        position: [
            number(pose, "x_m")?,
            number(pose, "y_m")?,
            number(pose, "z_m")?,
        ],
        yaw: number(pose, "yaw_rad")?,
        roll: number(pose, "roll_rad")?,
        pitch: number(pose, "pitch_rad")?,
        mean_error: number(pose, "mean_error_m")?,
    }))
}

fn number(object: &Value, key: &str) -> Option<f64> {
    object.get(key)?.as_f64()
}

fn time(object: &Value, key: &str) -> Option<Time> {
    object.get(key)?.as_u64().map(Time)
}

fn small(object: &Value, key: &str) -> Option<u16> {
    u16::try_from(object.get(key)?.as_u64()?).ok()
}

/// The value with the word of a key.
fn word<T: Copy>(
    object: &Value,
    key: &str,
    all: impl IntoIterator<Item = T>,
    name: impl Fn(T) -> &'static str,
) -> Option<T> {
    let word = object.get(key)?.as_str()?;
    all.into_iter().find(|value| name(*value) == word)
}

#[cfg(test)]
mod tests {
    use singletrack_mocap::{Observation as Frame, PoseState};
    use singletrack_protocol::{ImuState, Telemetry};
    use singletrack_record::{Entry, StatusRecord, TelemetryRecord};

    use super::*;

    /// As the daemon writes an entry for its watchers.
    fn line(entry: &Entry) -> Value {
        let mut json = String::new();
        entry.write_json(&mut json);
        serde_json::from_str(&json).unwrap()
    }

    #[test]
    fn telemetry_is_read_as_the_daemon_writes_it() {
        let telemetry = Telemetry {
            board_time_us: 1,
            mode: BoardMode::Neutral,
            stop_cause: StopCause::Disarmed,
            last_sequence: singletrack_protocol::Sequence(3),
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
        let Some(Observation::Board(reading)) = observation(&line(&Entry::Telemetry(record)))
        else {
            panic!("no reading");
        };
        assert_eq!((reading.time, reading.receive), (Time(70), Time(90)));
        assert_eq!((reading.servo_us, reading.esc_us), (1_500, 1_490));
        assert_eq!(reading.motor_speed, 0.25);
        let inertial = reading.inertial.unwrap();
        assert_eq!(inertial.angular_velocity, [0.001, 0.002, -0.5]);
        assert_eq!(inertial.acceleration, [0.01, -0.02, 0.03]);
        assert!((inertial.pitch - 0.2).abs() < 1e-3 && inertial.roll.abs() < 1e-9);

        record.telemetry.imu = ImuState::Repeated;
        let Some(Observation::Board(reading)) = observation(&line(&Entry::Telemetry(record)))
        else {
            panic!("no reading");
        };
        assert_eq!(reading.inertial, None);
    }

    #[test]
    fn status_and_frames_are_read_as_the_daemon_writes_them() {
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
        let entry = Entry::Status(StatusRecord {
            receive_time_ns: 9,
            status,
        });
        let receive = Time(9);
        assert_eq!(
            observation(&line(&entry)),
            Some(Observation::Health(Health { receive, status }))
        );
        let entry = Entry::Pose(Frame {
            frame_number: 4,
            receive_time_ns: 9,
            state: PoseState::Untracked,
        });
        assert_eq!(
            observation(&line(&entry)),
            Some(Observation::NoPose {
                receive,
                state: "untracked"
            })
        );
    }

    #[test]
    fn what_is_no_observation_is_passed_over() {
        for line in [
            r#"{"topic":"log","text":"x"}"#,
            r#"{"topic":"tick","mode":"dancing"}"#,
            r#"{"version":2,"missed":3}"#,
        ] {
            assert_eq!(observation(&serde_json::from_str(line).unwrap()), None);
        }
    }
}
