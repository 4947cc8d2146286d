//! An invented drive on the circle of the paper: entries of every kind, as long and as hard
//! to compress as real ones.

#![allow(dead_code, reason = "not every user needs everything")]

use std::collections::BTreeMap;

use singletrack_control::{
    Actuation, Covariance, Estimate, InertialSample, PoseSample, Position, ReferencePoint, Time,
    Velocity,
};
use singletrack_mocap::{CaptureTimeSource, Observation, Pose, PoseState};
use singletrack_pilot::{BoardSample, BoardState, DriveCommand, Event, Filtering, Mode, Output};
use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, ResetCause, Sequence, Status, StopCause, Telemetry,
};
use singletrack_record::{
    ClockMapping, DriveWrite, LinkPhase, Meta, StatusRecord, TelemetryRecord, TickRecord,
};

pub(crate) fn meta() -> Meta {
    Meta {
        configuration: String::new(),
        software: BTreeMap::new(),
        protocol_version: singletrack_protocol::VERSION,
        seed: Some(1),
        start: ClockMapping {
            monotonic_ns: 0,
            wall_ns: 1_780_000_000_000_000_000,
        },
    }
}

/// Noise from -0.5 to 0.5, as hard to compress as that of a measurement.
pub(crate) fn noise(index: u64, which: u64) -> f64 {
    let mut bits = (index * 64 + which).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits ^= bits >> 32;
    bits = bits.wrapping_mul(0xd6e8_feb8_6659_fd93);
    bits ^= bits >> 32;
    (bits >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
}

/// The car on the circle of the paper.
struct Car {
    time_ns: u64,
    angle: f64,
    index: u64,
}

impl Car {
    fn at(index: u64, time_ns: u64) -> Self {
        Self {
            time_ns,
            angle: time_ns as f64 * 0.5e-9,
            index,
        }
    }

    fn position(&self, which: u64) -> Position {
        let (sin, cos) = libm::sincos(self.angle);
        Position::new(
            0.8 * cos + 1e-3 * noise(self.index, which),
            0.8 * sin + 1e-3 * noise(self.index, which + 1),
        )
    }

    fn yaw(&self) -> f64 {
        self.angle + 1.5 + 1e-3 * noise(self.index, 9)
    }
}

/// A tick with all its parts.
pub(crate) fn tick(index: u64, time_ns: u64) -> TickRecord {
    let car = Car::at(index, time_ns);
    let now = car.time_ns;
    let capture = Time(now.saturating_sub(6_000_000));
    let pose = Event::Pose(PoseSample {
        capture,
        receive: Time(now.saturating_sub(2_000_000)),
        frame: index as i32,
        position: car.position(1),
        yaw: car.yaw(),
    });
    let board = Event::Board(BoardSample {
        time: Time(now.saturating_sub(4_000_000)),
        inertial: Some(InertialSample {
            time: Time(now.saturating_sub(5_000_000)),
            yaw_rate: 0.5 + 1e-2 * noise(index, 3),
            forward_acceleration: 1e-1 * noise(index, 4),
            left_acceleration: 0.2 + 1e-1 * noise(index, 5),
        }),
        motor_speed: 0.4 + 1e-2 * noise(index, 6),
        state: BoardState::Driving,
    });
    TickRecord {
        index,
        scheduled_ns: now.saturating_sub(50_000),
        start_ns: now,
        finish_ns: now + 60_000,
        skipped: 0,
        pilot_time: Time(now),
        events: [pose, board].into_iter().collect(),
        events_dropped: 0,
        output: Output {
            mode: Mode::Driving,
            reason: None,
            estimate: Some(Estimate {
                time: Time(now),
                position: car.position(7),
                yaw: car.yaw(),
                yaw_rate: 0.5 + 1e-3 * noise(index, 10),
                sideslip: 0.15 + 1e-3 * noise(index, 11),
                speed: 0.4 + 1e-3 * noise(index, 12),
                pose_time: capture,
            }),
            covariance: Some(Covariance {
                pose: [0, 1, 2, 3, 4, 5].map(|at| 1e-6 * noise(index, 20 + at)),
                twist: [0, 1, 2, 3, 4, 5].map(|at| 1e-4 * noise(index, 26 + at)),
            }),
            held: false,
            drive_time: Some(now as f64 * 1e-9),
            reference: Some(ReferencePoint {
                position: Some(Position::new(libm::cos(car.angle), libm::sin(car.angle))),
                velocity: Velocity::new(-0.5 * libm::sin(car.angle), 0.5 * libm::cos(car.angle)),
            }),
            point: Some(car.position(13)),
            point_velocity: Some(Velocity::new(noise(index, 15), noise(index, 16))),
            actuation: Actuation {
                speed: 0.4 + 1e-3 * noise(index, 17),
                steering: 0.33 + 1e-3 * noise(index, 18),
                steering_rate: 1e-2 * noise(index, 19),
            },
            turning_round: false,
            looked_ahead: None,
            path: None,
            slowed_by: None,
            command: Some(DriveCommand {
                rear_speed: 0.4 + 1e-3 * noise(index, 20),
                steering: 0.33 + 1e-3 * noise(index, 21),
                pose_time: capture,
                brake: false,
            }),
            request: None,
            proved: false,
            disproved: false,
            braking_measured: None,
            setpoint_refused: None,
            filtering: Filtering::None,
            filtered_ticks: 0,
            tuned: None,
            setpoint: None,
            preflight: None,
            jog: None,
        },
        drive: Some(DriveWrite {
            sequence: index as u8,
            written: true,
            time_ns: now + 55_000,
        }),
        link: LinkPhase::Ready,
    }
}

/// A valid pose.
pub(crate) fn pose(index: u64, time_ns: u64) -> Observation {
    let car = Car::at(index, time_ns);
    let position = car.position(22);
    Observation {
        frame_number: index as i32,
        receive_time_ns: car.time_ns,
        state: PoseState::Valid(Pose {
            x_m: position.x,
            y_m: position.y,
            z_m: 0.05 + 1e-4 * noise(index, 24),
            yaw_rad: car.yaw(),
            tilt_rad: 1e-2 * noise(index, 25).abs(),
            roll_rad: 0.0,
            pitch_rad: 0.0,
            capture_time_ns: car.time_ns.saturating_sub(4_000_000),
            capture_uncertainty_ns: 100_000,
            capture_source: CaptureTimeSource::MidExposureEcho,
            receive_time_ns: car.time_ns,
            frame_number: index as i32,
            mean_error_m: 1e-3 * noise(index, 26).abs(),
            reacquired: false,
        }),
    }
}

/// Telemetry with a new sample of the IMU.
pub(crate) fn telemetry(index: u64, time_ns: u64) -> TelemetryRecord {
    let car = Car::at(index, time_ns);
    let small = |which| (noise(index, which) * 200.0) as i16;
    TelemetryRecord {
        receive_time_ns: car.time_ns,
        board_time_host_ns: car.time_ns.saturating_sub(4_000_000),
        imu_time_host_ns: Some(car.time_ns.saturating_sub(5_000_000)),
        telemetry: Telemetry {
            board_time_us: (car.time_ns / 1_000) as u32,
            mode: BoardMode::Driving,
            stop_cause: StopCause::None,
            last_sequence: Sequence(index as u8),
            imu: ImuState::Fresh,
            imu_age_100us: 10,
            linear_acceleration_mm_s2: [small(27), 200 + small(28), small(29)],
            angular_velocity_mrad_s: [small(30), small(31), 500 + small(32)],
            attitude_q14: [16_000 + small(33), small(34), small(35), small(36)],
            motor_speed_mm_s: 400 + small(37),
            servo_us: 1_600,
            esc_us: 1_560,
        },
    }
}

/// A status record.
pub(crate) fn status(index: u64, time_ns: u64) -> StatusRecord {
    StatusRecord {
        receive_time_ns: time_ns,
        status: Status {
            board_time_us: (time_ns / 1_000) as u32,
            configuration_hash: 0xdead_beef,
            reset_cause: ResetCause::PowerOn,
            stop_input_open: false,
            battery_mv: 7_400 + (noise(index, 38) * 100.0) as u16,
            frames_received: index as u16,
            frames_damaged: 0,
            drives_refused: 0,
            last_refusal: RefusalReason::None,
            frames_dropped: 0,
            bytes_overrun: 0,
            imu_errors: 0,
            supply_mv: 5_000,
            battery_open: false,
            power_on: false,
            edges_refused: 0,
            imu_calibration: 0xFF,
            imu_status: 5,
            imu_error: 0,
            imu_self_test: 0x0F,
        },
    }
}
