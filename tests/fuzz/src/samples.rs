//! The calibration of board and session.

use singletrack_protocol::{
    Configuration, EscCalibration, EscKind, FailsafeAction, ImuAxes, LONGEST_ROLL_OUT_MS,
    ServoCalibration, SpeedLoop,
};

/// A valid configuration.
pub(crate) const CONFIGURATION: Configuration = Configuration {
    servo: ServoCalibration {
        centre_us: 1_500,
        gain_us_per_rad: 800,
        min_us: 1_080,
        max_us: 1_920,
        slew_us_per_20ms: 96,
    },
    esc: EscCalibration {
        kind: EscKind::Car,
        neutral_us: 1_500,
        deadband_us: 30,
        min_us: 1_200,
        max_us: 1_700,
        slew_us_per_20ms: 40,
        brake_us: 1_350,
    },
    speed: SpeedLoop {
        pulse_distance_um: 3_000,
        feed_forward_us_per_m_s: 80,
        proportional_us_per_m_s: 80,
        integral_us_per_m: 250,
        integral_limit_us: 60,
        max_forward_mm_s: 1_500,
        max_reverse_mm_s: 0,
    },
    failsafe: FailsafeAction::Coast,
    max_pose_age_ms: 950,
    stop_input: false,
    kill_output: false,
    max_roll_out_ms: LONGEST_ROLL_OUT_MS,
    car_id: 0,
    imu_axes: ImuAxes::AS_PRINTED,
};
