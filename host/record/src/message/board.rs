//! The board's telemetry and status as it sends them: scaled integers with the unit in
//! the name.

use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, ResetCause, Status, StopCause, Telemetry,
};

use super::{
    code::Code,
    declare::{array, fields, message},
    field::{Group, Maybe},
};
use crate::{StatusRecord, TelemetryRecord};

message! {
    /// A telemetry record of the board, 100 Hz. Car axes: forward, left, up.
    TelemetryMessage as "Telemetry" of TelemetryRecord {
        /// When its last byte was received, in ns of the host's monotonic clock.
        receive_time_ns: u64,
        /// When the board made it, in ns of the host's monotonic clock.
        board_time_host_ns: u64,
        /// When the IMU took its sample, in ns of the host's monotonic clock.
        imu_time_host_ns: Maybe<u64>,
        telemetry: Group<TelemetryFields>,
    }
}

fields! {
    /// What the board sends in it.
    TelemetryFields of Telemetry {
        /// When the board made it, in us of the board's own clock, wrapping.
        board_time_us: u32,
        /// The safety machine.
        mode: Code<BoardMode>,
        /// Why it last went to neutral.
        stop_cause: Code<StopCause>,
        /// Number of the last drive command that was accepted.
        last_sequence: u8,
        /// Whether the IMU's values are new.
        imu: Code<ImuState>,
        /// Age of the IMU's sample at `board_time_us`, in units of 100 us, saturating.
        imu_age_100us: u8,
        /// Acceleration without gravity along the car's axes, in mm/s^2.
        linear_acceleration_mm_s2: Group<AccelerationFields>,
        /// Angular velocity about the car's axes, in mrad/s. Yaw rate: about up.
        angular_velocity_mrad_s: Group<AngularVelocityFields>,
        /// Attitude: a unit quaternion, scaled by 2^14.
        attitude_q14: Group<AttitudeFields>,
        /// Speed by the motor pulses, signed by the direction driven, in mm/s.
        motor_speed_mm_s: i16,
        /// Servo pulse, in us; zero while the servo is silent.
        servo_us: u16,
        /// ESC pulse, in us.
        esc_us: u16,
    }
}

array! {
    AccelerationFields of [i16; 3] {
        forward_acceleration_mm_s2,
        left_acceleration_mm_s2,
        up_acceleration_mm_s2,
    }
}

array! {
    AngularVelocityFields of [i16; 3] {
        roll_rate_mrad_s,
        pitch_rate_mrad_s,
        yaw_rate_mrad_s,
    }
}

array! {
    AttitudeFields of [i16; 4] {
        attitude_w_q14,
        attitude_x_q14,
        attitude_y_q14,
        attitude_z_q14,
    }
}

message! {
    /// A status record of the board, 5 Hz. Counters wrap.
    StatusMessage as "Status" of StatusRecord {
        /// When its last byte was received, in ns of the host's monotonic clock.
        receive_time_ns: u64,
        status: Group<StatusFields>,
    }
}

fields! {
    /// What the board sends in it.
    StatusFields of Status {
        /// When the board made it, in us of the board's own clock, wrapping.
        board_time_us: u32,
        /// Hash of the configuration in force; zero for none.
        configuration_hash: u32,
        /// Why the board last started.
        reset_cause: Code<ResetCause>,
        /// Whether the stop switch is open, if one is configured.
        stop_input_open: bool,
        /// Battery voltage, in mV.
        battery_mv: u16,
        /// Good frames received.
        frames_received: u16,
        /// Frames refused for CRC, COBS or length.
        frames_damaged: u16,
        /// Drive commands refused.
        drives_refused: u16,
        /// Why the last of them was.
        last_refusal: Code<RefusalReason>,
        /// Frames not sent because the line was full.
        frames_dropped: u16,
        /// Bytes lost by the receiver.
        bytes_overrun: u16,
        /// Errors on the bus to the IMU.
        imu_errors: u16,
        /// The processor's supply, in mV.
        supply_mv: u16,
        /// Whether the battery's input floats.
        battery_open: bool,
        /// Whether the kill output is held.
        power_on: bool,
        /// Milliseconds with more edges of the motor's sensor than the board takes.
        edges_refused: u16,
        /// The BNO055's register `CALIB_STAT`.
        imu_calibration: u8,
        /// The BNO055's register `SYS_STATUS`.
        imu_status: u8,
        /// The BNO055's register `SYS_ERR`.
        imu_error: u8,
        /// The BNO055's register `ST_RESULT`.
        imu_self_test: u8,
    }
}
