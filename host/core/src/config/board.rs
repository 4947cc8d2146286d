//! `[board]`: what the board must know about the car that it is built into.
//!
//! Calibration has no default: a wrong sign steers the car the wrong way. The ranges are
//! those of [`Configuration::validate`], which the board applies too; here they are text.

use singletrack_protocol::{
    Configuration, EscCalibration, FailsafeAction, ServoCalibration, SpeedLoop,
};

use super::{choice::choice, section::section, value::Convert as _};

section! {
    /// What the board is given before it may be armed. The example's calibration is that of
    /// the simulated car: measure yours with the wheels off the ground.
    "board" => pub BoardSection: Copy, Eq;
    [maps Configuration];

    /// When the board stops the car by itself: "coast" sends neutral; "brake" sends the
    /// braking pulse until the wheels stand, then neutral.
    failsafe: FailsafeKind = FailsafeKind::Coast => failsafe;
    /// Oldest pose that the board obeys. At least the time that the host needs to hold and to
    /// stop, so that the host stops first.
    max_pose_age_ms: u16 = 950 => max_pose_age_ms, text "1 to 1000";
    /// Whether a normally-closed stop switch is wired to the board.
    stop_input: bool = false => stop_input;
    /// The steering servo.
    servo: ServoSection => servo;
    /// The electronic speed controller.
    esc: EscSection => esc;
    /// The speed loop.
    speed: SpeedSection => speed;
}

choice! {
    /// What the ESC is given when the board stops the car by itself.
    pub FailsafeKind => FailsafeAction;
    /// Neutral.
    Coast = "coast";
    /// The braking pulse until the wheels stand, then neutral.
    Brake = "brake";
}

section! {
    /// The steering servo.
    "board.servo" => pub ServoSection: Copy, Eq;
    [maps ServoCalibration];

    /// Pulse that steers straight on.
    centre_us: u16 => centre_us, text "min_us to max_us", example 1500;
    /// Pulse change for one radian to the left; negative when the servo is mounted the other
    /// way round. A wrong sign steers the wrong way.
    gain_us_per_rad: i16 => gain_us_per_rad, text "50 to 5000 or -5000 to -50", example -800;
    /// Shortest pulse ever sent.
    min_us: u16 => min_us, text "800 to 2200", example 1080;
    /// Longest pulse ever sent.
    max_us: u16 => max_us, text "min_us to 2200", example 1920;
    // 6 rad/s with the paper's servo.
    /// Largest change of the pulse in 20 ms.
    slew_us_per_20ms: u16 = 96 => slew_us_per_20ms, text "1 to 1400";
}

section! {
    /// The electronic speed controller.
    "board.esc" => pub EscSection: Copy, Eq;
    [maps EscCalibration];

    /// Pulse at which the motor is free.
    neutral_us: u16 => neutral_us, text "1500 - deadband_us to 1500 + deadband_us",
        example 1500;
    /// Half width of the band around neutral in which the motor does not turn.
    deadband_us: u16 => deadband_us, text "0 to 200", example 30;
    /// Shortest pulse ever sent.
    min_us: u16 => min_us, text "800 to neutral_us - deadband_us - 1", example 1200;
    /// Longest pulse ever sent.
    max_us: u16 => max_us, text "neutral_us + deadband_us to 2200", example 1700;
    /// Largest change of the pulse away from neutral in 20 ms; towards neutral it changes at
    /// once.
    slew_us_per_20ms: u16 = 40 => slew_us_per_20ms, text "1 to 1400";
    /// Pulse that brakes.
    brake_us: u16 => brake_us, text "min_us to neutral_us - deadband_us - 1", example 1350;
}

section! {
    /// The speed loop that the board closes on the motor pulses.
    "board.speed" => pub SpeedSection: Copy, Eq;
    [maps SpeedLoop];

    /// Distance that the car rolls in one motor pulse.
    pulse_distance_um: u16 => pulse_distance_um, text "1 to 65535", example 3000;
    /// Feed-forward gain.
    feed_forward_us_per_m_s: u16 => feed_forward_us_per_m_s, text "0 to 5000", example 80;
    /// Proportional gain.
    proportional_us_per_m_s: u16 => proportional_us_per_m_s, text "0 to 5000", example 80;
    /// Integral gain.
    integral_us_per_m: u16 => integral_us_per_m, text "0 to 5000", example 250;
    /// Limit of the integral term.
    integral_limit_us: u16 => integral_limit_us, text "0 to 700", example 60;
    /// Top speed forward; faster commands are clamped.
    max_forward_mm_s: u16 => max_forward_mm_s, text "1 to 20000", example 1500;
    /// Top speed in reverse; 0 refuses reverse.
    max_reverse_mm_s: u16 = 0 => max_reverse_mm_s, text "0 to 20000";
}

impl BoardSection {
    /// As it is sent.
    #[must_use]
    pub fn configuration(&self) -> Configuration {
        self.to_inner("board")
    }
}

impl From<&Configuration> for BoardSection {
    fn from(configuration: &Configuration) -> Self {
        Self::from_inner(*configuration, "board")
    }
}
