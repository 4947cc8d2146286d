//! One message of every type, with distinct values.

#![allow(dead_code, reason = "each test and bench uses its own part")]

use singletrack_protocol::{
    Acknowledgement, Arm, BoardMode, Configuration, Configure, DecodeError, Disarm, Drive,
    EmergencyStop, EscCalibration, EscKind, FailsafeAction, Frame, Hello, Identity, ImuAxes,
    ImuAxis, ImuState, Jog, Packet, Refusal, RefusalReason, Request, ResetCause, Sequence,
    ServoCalibration, SpeedLoop, Status, StopCause, Telemetry, ToBoard, ToHost,
};

/// A message in one of the two directions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Either {
    /// From the host.
    ToBoard(ToBoard),
    /// From the board.
    ToHost(ToHost),
}

/// A message with a name for test output.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    /// Type, and direction where it is ambiguous.
    pub(crate) name: &'static str,
    /// The message.
    pub(crate) message: Either,
}

impl Sample {
    /// The message as a frame.
    pub(crate) fn frame(&self) -> Frame {
        match self.message {
            Either::ToBoard(message) => message.encode(),
            Either::ToHost(message) => message.encode(),
        }
    }

    /// Decodes a packet in the direction of this message.
    pub(crate) fn decode_same_direction(&self, packet: Packet<'_>) -> Result<Either, DecodeError> {
        match self.message {
            Either::ToBoard(_) => ToBoard::decode(packet).map(Either::ToBoard),
            Either::ToHost(_) => ToHost::decode(packet).map(Either::ToHost),
        }
    }
}

/// The configuration of the samples.
pub(crate) fn configuration() -> Configuration {
    Configuration {
        servo: ServoCalibration {
            centre_us: 1_490,
            gain_us_per_rad: -815,
            min_us: 1_100,
            max_us: 1_905,
            slew_us_per_20ms: 90,
        },
        esc: EscCalibration {
            kind: EscKind::Car,
            neutral_us: 1_500,
            deadband_us: 25,
            min_us: 1_150,
            max_us: 1_800,
            slew_us_per_20ms: 40,
            brake_us: 1_300,
        },
        speed: SpeedLoop {
            pulse_distance_um: 8_400,
            feed_forward_us_per_m_s: 60,
            proportional_us_per_m_s: 80,
            integral_us_per_m: 120,
            integral_limit_us: 100,
            max_forward_mm_s: 2_500,
            max_reverse_mm_s: 600,
        },
        failsafe: FailsafeAction::Brake,
        max_pose_age_ms: 900,
        stop_input: true,
        kill_output: true,
        max_roll_out_ms: 2_700,
        car_id: 0x4711,
        imu_axes: ImuAxes {
            forward: ImuAxis::MinusY,
            left: ImuAxis::PlusX,
            up: ImuAxis::PlusZ,
        },
    }
}

/// One message of every type and direction.
pub(crate) fn samples() -> Vec<Sample> {
    let hello = Hello {
        protocol_version: 3,
        software_version: [0, 1, 2],
        nonce: 0xA1B2_C3D4,
    };
    let to_board = [
        ("hello to the board", hello.into()),
        (
            "configure",
            Configure {
                request: Sequence(3),
                configuration: configuration(),
            }
            .into(),
        ),
        (
            "arm",
            Arm {
                request: Sequence(4),
                configuration_hash: 0x1122_3344,
                telemetry_time_us: 0x5566_7788,
            }
            .into(),
        ),
        (
            "disarm",
            Disarm {
                request: Sequence(5),
            }
            .into(),
        ),
        (
            "drive",
            Drive {
                sequence: Sequence(200),
                speed_mm_s: 397,
                steering_100urad: -3_286,
                telemetry_time_us: 0xFFFF_FF00,
                pose_age_ms: 12,
                brake: true,
            }
            .into(),
        ),
        (
            "emergency stop",
            EmergencyStop {
                request: Sequence(6),
            }
            .into(),
        ),
        (
            "jog",
            Jog {
                sequence: Sequence(201),
                telemetry_time_us: 0x0A0B_0C0D,
                servo_us: 1_380,
                esc_us: 1_545,
            }
            .into(),
        ),
    ];
    let to_host = [
        ("hello to the host", hello.into()),
        (
            "telemetry",
            Telemetry {
                board_time_us: 0x0012_3456,
                mode: BoardMode::Driving,
                stop_cause: StopCause::CommandTimeout,
                last_sequence: Sequence(200),
                imu: ImuState::Fresh,
                imu_age_100us: 37,
                linear_acceleration_mm_s2: [-120, 981, 14],
                angular_velocity_mrad_s: [5, -6, 499],
                attitude_q14: [16_383, -3, 44, -2_048],
                motor_speed_mm_s: 401,
                servo_us: 1_222,
                esc_us: 1_561,
            }
            .into(),
        ),
        (
            "status",
            Status {
                board_time_us: 0x0012_3460,
                configuration_hash: 0x99AA_BBCC,
                reset_cause: ResetCause::Watchdog,
                stop_input_open: true,
                battery_mv: 7_412,
                frames_received: 1_001,
                frames_damaged: 12,
                drives_refused: 3,
                last_refusal: RefusalReason::OutOfSequence,
                frames_dropped: 4,
                bytes_overrun: 5,
                imu_errors: 6,
                supply_mv: 4_987,
                battery_open: true,
                power_on: true,
                edges_refused: 7,
                imu_calibration: 0x3C,
                imu_status: 5,
                imu_error: 2,
                imu_self_test: 0x0B,
            }
            .into(),
        ),
        (
            "acknowledgement",
            Acknowledgement {
                request: Request::Arm,
                sequence: Sequence(4),
                configuration_hash: 0x1122_3344,
            }
            .into(),
        ),
        (
            "refusal",
            Refusal {
                request: Request::Configure,
                sequence: Sequence(3),
                reason: RefusalReason::OtherCar,
            }
            .into(),
        ),
        ("identity", Identity { car_id: 0x4711 }.into()),
    ];
    to_board
        .map(|(name, message)| Sample {
            name,
            message: Either::ToBoard(message),
        })
        .into_iter()
        .chain(to_host.map(|(name, message)| Sample {
            name,
            message: Either::ToHost(message),
        }))
        .collect()
}
