//! `[serial]` and `[board]`: the line to the board, and what the board is given.

use core::num::NonZeroU32;
use std::path::PathBuf;

use singletrack_protocol::{
    Configuration, EscCalibration, EscKind, FailsafeAction, ImuAxes, ImuAxis, LONGEST_ROLL_OUT_MS,
    ServoCalibration, SpeedLoop,
};
use singletrack_settings::{Convert as _, Declared as _, Maps as _, section};

use super::{ConfigError, refuse_if};

/// The rate of the firmware, in baud.
const BAUD: NonZeroU32 = NonZeroU32::new(115_200).unwrap();

section! {
    /// The serial line to the board.
    "serial", restart => pub SerialSection: Eq;
    [new];

    /// The board's device. Use a link that stays the same when the board is plugged in again:
    /// /dev/serial/by-id/..., or one that a udev rule makes.
    port: PathBuf, example "/dev/serial/by-id/usb-Arduino_Uno-if00";
    /// Rate of the line, in baud; that of the firmware.
    baud: u32 = BAUD.get(), in 9_600..=2_000_000;
}

impl SerialSection {
    /// The rate, which [`validate`](Self::validate) has found in its range.
    pub(crate) fn baud(&self) -> NonZeroU32 {
        NonZeroU32::new(self.baud).unwrap_or(BAUD)
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let is_empty = self.port.as_os_str().is_empty();
        let fix = "name the board's device, such as \"/dev/ttyACM0\"";
        refuse_if(is_empty, "serial.port", "empty", fix)?;
        Ok(self.check()?)
    }
}

section! {
    /// What the board is given before it may be armed. The example's calibration is that of
    /// the simulated car: measure yours with the wheels off the ground.
    "board" => pub BoardSection: Copy, Eq;
    [];

    /// The car that this file is for: the number that the board's image was built with
    /// (`cargo uno --car-id 7`). The board refuses the configuration of another car.
    car_id: u16 = 0;
    /// When the board stops the car by itself: "coast" sends neutral; "brake" sends the
    /// braking pulse until the wheels stand, then neutral, and needs `esc.kind`.
    failsafe: FailsafeAction = FailsafeAction::Coast, words FailsafeAction;
    /// Oldest pose that the board obeys. At least the time that the host needs to hold and to
    /// stop, so that the host stops first.
    max_pose_age_ms: u16 = 950, text "1 to 1000";
    /// Whether a normally-closed stop switch is wired to the board.
    stop_input: bool = false;
    /// Whether the board switches the ESC's supply (pin D7): on only while it is armed and
    /// healthy. Arming then takes 2 s more.
    kill_output: bool = false;
    /// The steering servo.
    servo: ServoSection;
    /// The electronic speed controller.
    esc: EscSection;
    /// The speed loop.
    speed: SpeedSection;
    /// The mounting of the IMU.
    imu: ImuSection = ImuSection::default();
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
    [];

    /// What a pulse below neutral does. Needed for `failsafe = "brake"` and for reverse; left
    /// out, no pulse below neutral is ever sent.
    kind: Option<EscKind> = None, words EscKind, example EscKind::Car;
    /// Pulse at which the motor is free.
    neutral_us: u16, text "1500 - deadband_us to 1500 + deadband_us",
        example 1500;
    /// Half width of the band around neutral in which the motor does not turn.
    deadband_us: u16, text "0 to 200", example 30;
    /// Shortest pulse ever sent.
    min_us: u16, text "800 to neutral_us - deadband_us - 1", example 1200;
    /// Longest pulse ever sent; a car that drives has it beyond the band around neutral.
    max_us: u16, text "neutral_us + deadband_us to 2200", example 1700;
    /// Largest change of the pulse away from neutral in 20 ms; towards neutral it changes at
    /// once.
    slew_us_per_20ms: u16 = 40, text "1 to 1400";
    /// Pulse that brakes; needed for the kinds that have a brake.
    brake_us: Option<u16> = None, text "min_us to neutral_us - deadband_us - 1", example 1350;
}

section! {
    /// The mounting of the IMU: which axis, as printed on the chip, points where.
    "board.imu" => pub ImuSection: Copy, Eq;
    [maps ImuAxes = ImuAxes::AS_PRINTED];

    /// Points forward.
    forward: ImuAxis => forward, words ImuAxis;
    /// Points to the left.
    left: ImuAxis => left, words ImuAxis;
    /// Points up.
    up: ImuAxis => up, words ImuAxis;
}

section! {
    /// The speed loop that the board closes on the motor pulses.
    "board.speed" => pub SpeedSection: Copy, Eq;
    [maps SpeedLoop];

    /// Distance that the car rolls in one motor pulse.
    pulse_distance_um: u16 => pulse_distance_um, text "100 to 30000", example 3000;
    /// Feed-forward gain.
    feed_forward_us_per_m_s: u16 => feed_forward_us_per_m_s, text "0 to 5000", example 80;
    /// Proportional gain.
    proportional_us_per_m_s: u16 => proportional_us_per_m_s, text "0 to 5000", example 80;
    /// Integral gain.
    integral_us_per_m: u16 => integral_us_per_m, text "0 to 5000", example 250;
    /// Limit of the integral term.
    integral_limit_us: u16 => integral_limit_us, text "0 to 700", example 60;
    /// Top speed forward; faster commands are clamped. At most 12 mm/s for each
    /// micrometre of `pulse_distance_um`: the board can't count more pulses.
    max_forward_mm_s: u16 => max_forward_mm_s, text "1 to 20000", example 1500;
    /// Top speed in reverse; 0 refuses reverse. At most as for `max_forward_mm_s`.
    max_reverse_mm_s: u16 = 0 => max_reverse_mm_s, text "0 to 20000";
}

impl BoardSection {
    /// The configuration that is sent, but for the longest roll-out, which
    /// [`Config::board_configuration`](super::Config::board_configuration) knows.
    pub fn configuration(&self) -> Configuration {
        let esc = &self.esc;
        Configuration {
            servo: self.servo.to_inner("servo"),
            esc: EscCalibration {
                // Left out: no pulse ever brakes, and reverse is refused, see `validate`.
                kind: esc.kind.unwrap_or(EscKind::ForwardReverse),
                neutral_us: esc.neutral_us,
                deadband_us: esc.deadband_us,
                min_us: esc.min_us,
                max_us: esc.max_us,
                slew_us_per_20ms: esc.slew_us_per_20ms,
                brake_us: esc.brake_us.unwrap_or(esc.neutral_us),
            },
            speed: self.speed.to_inner("speed"),
            failsafe: self.failsafe,
            max_pose_age_ms: self.max_pose_age_ms,
            stop_input: self.stop_input,
            kill_output: self.kill_output,
            max_roll_out_ms: LONGEST_ROLL_OUT_MS,
            car_id: self.car_id,
            imu_axes: self.imu.apply_to(ImuAxes::AS_PRINTED),
        }
    }

    /// Refuses what the board would refuse, and what only the file can tell.
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        match self.contradiction() {
            Some(error) => Err(error),
            None => Ok(self.configuration().validate()?),
        }
    }

    /// What contradicts in the section that the board can't know.
    fn contradiction(&self) -> Option<ConfigError> {
        let esc = &self.esc;
        let brakes = self.failsafe == FailsafeAction::Brake;
        let reverse = self.speed.max_reverse_mm_s;
        let distance_um = self.speed.pulse_distance_um;
        let ImuSection { forward, left, up } = self.imu;
        let (key, value, fix) = match esc.kind {
            None if brakes || reverse != 0 => (
                "board.esc.kind",
                "missing".to_owned(),
                "failsafe = \"brake\" and reverse send pulses below neutral, whose meaning depends \
                 on the ESC: write \"car\", \"forward-reverse\" or \"vesc\"",
            ),
            _ if brakes && self.kill_output => (
                "board.failsafe",
                "brake".to_owned(),
                "board.kill_output takes the ESC's supply at once, and without it nothing brakes; \
                 use \"coast\"",
            ),
            Some(EscKind::ForwardReverse) if brakes => (
                "board.failsafe",
                "brake".to_owned(),
                "an ESC of board.esc.kind = \"forward-reverse\" has no brake: the pulse would \
                 drive the car backwards; use \"coast\"",
            ),
            Some(EscKind::Vesc) if reverse != 0 => (
                "board.speed.max_reverse_mm_s",
                reverse.to_string(),
                "an ESC of board.esc.kind = \"vesc\" brakes below neutral and has no reverse; \
                 use 0",
            ),
            Some(kind @ (EscKind::Car | EscKind::Vesc)) if esc.brake_us.is_none() => {
                let fix = format!("board.esc.kind = \"{kind}\" needs it");
                return Some(ConfigError::value("board.esc.brake_us", "missing", fix));
            }
            _ if !(100..=30_000).contains(&distance_um) => (
                "board.speed.pulse_distance_um",
                distance_um.to_string(),
                "must be 100 to 30000: with a longer distance the board can't tell a slow car from \
                 one that stands or whose sensor is dead; use a sensor with more edges per turn, \
                 or one on the motor instead of on the wheel",
            ),
            _ if !self.imu.apply_to(ImuAxes::AS_PRINTED).is_mounting() => (
                "board.imu",
                format!("{forward}, {left}, {up}"),
                "no chip can be mounted like this: each of x, y and z must point along one axis, \
                 and the three must be right-handed",
            ),
            _ => return None,
        };
        Some(ConfigError::value(key, value, fix))
    }
}

impl From<&Configuration> for BoardSection {
    fn from(board: &Configuration) -> Self {
        let esc = board.esc;
        Self {
            car_id: board.car_id,
            failsafe: board.failsafe,
            max_pose_age_ms: board.max_pose_age_ms,
            stop_input: board.stop_input,
            kill_output: board.kill_output,
            servo: ServoSection::from_inner(board.servo, "servo"),
            esc: EscSection {
                kind: Some(esc.kind),
                neutral_us: esc.neutral_us,
                deadband_us: esc.deadband_us,
                min_us: esc.min_us,
                max_us: esc.max_us,
                slew_us_per_20ms: esc.slew_us_per_20ms,
                brake_us: Some(esc.brake_us),
            },
            speed: SpeedSection::from_inner(board.speed, "speed"),
            imu: ImuSection {
                forward: board.imu_axes.forward,
                left: board.imu_axes.left,
                up: board.imu_axes.up,
            },
        }
    }
}
