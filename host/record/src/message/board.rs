//! What the board said, as it said it: scaled integers, units in the names.

use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, ResetCause, Sequence, Status, StopCause, Telemetry,
};

use super::{code::Code, field::Maybe, message};
use crate::{StatusRecord, TelemetryRecord};

message! {
    /// A telemetry record of the board, 100 Hz. Car axes: forward, left, up.
    TelemetryMessage as "Telemetry" {
        /// When its last byte was received, in ns of the host's monotonic clock.
        receive_time_ns: u64,
        /// When the board made it, in ns of the host's monotonic clock.
        board_time_host_ns: u64,
        /// When the IMU took its sample, in ns of the host's monotonic clock.
        imu_time_host_ns: Maybe<u64>,
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
        forward_acceleration_mm_s2: i16,
        left_acceleration_mm_s2: i16,
        up_acceleration_mm_s2: i16,
        /// Angular velocity about the car's axes, in mrad/s. Yaw rate: about up.
        roll_rate_mrad_s: i16,
        pitch_rate_mrad_s: i16,
        yaw_rate_mrad_s: i16,
        /// Attitude: a unit quaternion, scaled by 2^14.
        attitude_w_q14: i16,
        attitude_x_q14: i16,
        attitude_y_q14: i16,
        attitude_z_q14: i16,
        /// Speed by the motor pulses, signed by the direction driven, in mm/s.
        motor_speed_mm_s: i16,
        /// Servo pulse, in us; zero while the servo is silent.
        servo_us: u16,
        /// ESC pulse, in us.
        esc_us: u16,
    }
}

message! {
    /// A status record of the board, 5 Hz. Counters wrap.
    StatusMessage as "Status" {
        /// When its last byte was received, in ns of the host's monotonic clock.
        receive_time_ns: u64,
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
    }
}

impl From<&TelemetryRecord> for TelemetryMessage {
    fn from(record: &TelemetryRecord) -> Self {
        let telemetry = &record.telemetry;
        let [forward, left, up] = telemetry.linear_acceleration_mm_s2;
        let [roll_rate, pitch_rate, yaw_rate] = telemetry.angular_velocity_mrad_s;
        let [w, x, y, z] = telemetry.attitude_q14;
        Self {
            receive_time_ns: record.receive_time_ns,
            board_time_host_ns: record.board_time_host_ns,
            imu_time_host_ns: Maybe(record.imu_time_host_ns),
            board_time_us: telemetry.board_time_us,
            mode: Code(telemetry.mode),
            stop_cause: Code(telemetry.stop_cause),
            last_sequence: telemetry.last_sequence.0,
            imu: Code(telemetry.imu),
            imu_age_100us: telemetry.imu_age_100us,
            forward_acceleration_mm_s2: forward,
            left_acceleration_mm_s2: left,
            up_acceleration_mm_s2: up,
            roll_rate_mrad_s: roll_rate,
            pitch_rate_mrad_s: pitch_rate,
            yaw_rate_mrad_s: yaw_rate,
            attitude_w_q14: w,
            attitude_x_q14: x,
            attitude_y_q14: y,
            attitude_z_q14: z,
            motor_speed_mm_s: telemetry.motor_speed_mm_s,
            servo_us: telemetry.servo_us,
            esc_us: telemetry.esc_us,
        }
    }
}

impl From<TelemetryMessage> for TelemetryRecord {
    fn from(message: TelemetryMessage) -> Self {
        Self {
            receive_time_ns: message.receive_time_ns,
            board_time_host_ns: message.board_time_host_ns,
            imu_time_host_ns: message.imu_time_host_ns.0,
            telemetry: Telemetry {
                board_time_us: message.board_time_us,
                mode: message.mode.0,
                stop_cause: message.stop_cause.0,
                last_sequence: Sequence(message.last_sequence),
                imu: message.imu.0,
                imu_age_100us: message.imu_age_100us,
                linear_acceleration_mm_s2: [
                    message.forward_acceleration_mm_s2,
                    message.left_acceleration_mm_s2,
                    message.up_acceleration_mm_s2,
                ],
                angular_velocity_mrad_s: [
                    message.roll_rate_mrad_s,
                    message.pitch_rate_mrad_s,
                    message.yaw_rate_mrad_s,
                ],
                attitude_q14: [
                    message.attitude_w_q14,
                    message.attitude_x_q14,
                    message.attitude_y_q14,
                    message.attitude_z_q14,
                ],
                motor_speed_mm_s: message.motor_speed_mm_s,
                servo_us: message.servo_us,
                esc_us: message.esc_us,
            },
        }
    }
}

impl From<&StatusRecord> for StatusMessage {
    fn from(record: &StatusRecord) -> Self {
        let status = &record.status;
        Self {
            receive_time_ns: record.receive_time_ns,
            board_time_us: status.board_time_us,
            configuration_hash: status.configuration_hash,
            reset_cause: Code(status.reset_cause),
            stop_input_open: status.stop_input_open,
            battery_mv: status.battery_mv,
            frames_received: status.frames_received,
            frames_damaged: status.frames_damaged,
            drives_refused: status.drives_refused,
            last_refusal: Code(status.last_refusal),
            frames_dropped: status.frames_dropped,
            bytes_overrun: status.bytes_overrun,
            imu_errors: status.imu_errors,
        }
    }
}

impl From<StatusMessage> for StatusRecord {
    fn from(message: StatusMessage) -> Self {
        Self {
            receive_time_ns: message.receive_time_ns,
            status: Status {
                board_time_us: message.board_time_us,
                configuration_hash: message.configuration_hash,
                reset_cause: message.reset_cause.0,
                stop_input_open: message.stop_input_open,
                battery_mv: message.battery_mv,
                frames_received: message.frames_received,
                frames_damaged: message.frames_damaged,
                drives_refused: message.drives_refused,
                last_refusal: message.last_refusal.0,
                frames_dropped: message.frames_dropped,
                bytes_overrun: message.bytes_overrun,
                imu_errors: message.imu_errors,
            },
        }
    }
}
