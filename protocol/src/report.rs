//! Answers and records of the board.

use crate::{
    Sequence,
    codec::{enumeration, structure},
};

enumeration! {
    /// The state of the board's safety machine.
    pub enum BoardMode {
        /// ESC at neutral for its own arming, for two seconds: after a start, and
        /// after a change of the neutral pulse.
        Boot = "boot",
        /// ESC neutral; ready to be configured and armed.
        Neutral = "neutral",
        /// Armed; no [`crate::Drive`] or [`crate::Jog`] accepted yet, ESC neutral.
        Armed = "armed",
        /// Obeying [`crate::Drive`] commands.
        Driving = "driving",
        /// Stopped by the board itself; only an explicit [`crate::Arm`] leaves it.
        Failsafe = "failsafe",
        /// Stopped by an emergency stop; only a reset leaves it.
        EmergencyStopped = "emergency-stopped",
        /// Armed with a kill output: the ESC's supply has just been switched on, and
        /// its neutral is held for two seconds. No [`crate::Drive`] is obeyed yet.
        PoweringUp = "powering-up",
        /// Obeying [`crate::Jog`] commands.
        Jogging = "jogging",
    }
}

impl BoardMode {
    /// Whether it takes commands, or will without another request.
    pub const fn is_armed(self) -> bool {
        matches!(
            self,
            Self::Armed | Self::Driving | Self::PoweringUp | Self::Jogging
        )
    }
}

enumeration! {
    /// Why the board last went to neutral.
    pub enum StopCause {
        /// The board has not gone to neutral since it started.
        ///
        /// Effect: Nothing.
        ///
        /// Remedy: Nothing.
        None = "none",
        /// The host requested it.
        ///
        /// Remedy: Nothing.
        Disarmed = "disarmed",
        /// The last command is older than 95 ms, or none came for 1 s after arming (or
        /// `powering-up`).
        ///
        /// Effect: Neutral within 120 ms of the last command; kill output off at once.
        ///
        /// Remedy: Look in the log of `singletrackd` why it stopped sending.
        CommandTimeout = "command-timeout",
        /// The pose behind the commands is older than `board.max_pose_age_ms`.
        ///
        /// Remedy: The host should have stopped first: compare `supervisor.hold_ms` and the ramp.
        PoseTooOld = "pose-too-old",
        /// No motor pulse came while the motor was driven above the deadband: for 600 ms, or (not
        /// jogging) for 150 ms and a commanded travel of 15 mm and 2.5 pulse distances.
        ///
        /// Effect: A car that starts at 0.4 m/s goes 0.06 m with a pulse every 3 mm, 0.18 m with 25
        /// mm.
        ///
        /// Remedy: Check the pulse sensor and `board.speed.pulse_distance_um`. A blocked wheel, or
        /// a car slower than a pulse in 0.6 s, looks the same.
        MotorSensor = "motor-sensor",
        /// The stop switch opened.
        ///
        /// Effect: 1500 us for 200 ms, then no pulse; latched. Kill output off at once.
        ///
        /// Remedy: Close the switch, reset the board.
        StopInput = "stop-input",
        /// The host requested an emergency stop.
        ///
        /// Effect: As `stop-input`.
        ///
        /// Remedy: Reset the board.
        EmergencyStop = "emergency-stop",
        /// A new session greeted the armed board.
        ///
        /// Remedy: Look in the log of `singletrackd`: after `board lost: silence` the computer was busy
        /// or the cable is bad; otherwise the daemon restarted, or a second program uses the port.
        HostRestarted = "host-restarted",
        /// The wheels turn undriven: for 3 s and over 0.5 m (unconfigured: 50 pulses), or over 1 m;
        /// after a drive, for longer than the longest roll-out or without slowing down.
        ///
        /// Effect: No pulse; latched. Kill output off.
        ///
        /// Remedy: Check the ESC and `board.esc.neutral_us`; then reset the board. Pushing latches
        /// it too: let the car stand for a second every half metre, or lift it.
        RunsAtNeutral = "runs-at-neutral",
        /// The last pulses of jogging are older than 95 ms.
        ///
        /// Effect: Neutral within 120 ms of them; kill output off at once.
        ///
        /// Remedy: Look in the log of `singletrackd` why it stopped sending.
        JogTimeout = "jog-timeout",
        /// The wheels turned faster than 1 m/s while jogging.
        ///
        /// Effect: No brake.
        ///
        /// Remedy: Give pulses nearer to neutral.
        JogTooFast = "jog-too-fast",
        /// The motor was jogged for 10 s without a rest at neutral.
        ///
        /// Effect: No brake.
        ///
        /// Remedy: Let the wheels rest in between.
        JogTooLong = "jog-too-long",
    }
}

enumeration! {
    /// Why the board does not do what it was asked.
    pub enum RefusalReason {
        /// Nothing has been refused.
        ///
        /// Remedy: Nothing.
        None = "none",
        /// The board has no configuration.
        ///
        /// Remedy: Nothing: the host configures it again.
        NotConfigured = "not-configured",
        /// The board has another configuration than the host named.
        ///
        /// Remedy: Nothing: the host configures it again. If it stays, a second program uses the
        /// port.
        ConfigurationDiffers = "configuration-differs",
        /// A value of the configuration is out of range.
        ///
        /// Remedy: Correct `[board]`; flash the firmware of the host's release.
        InvalidConfiguration = "invalid-configuration",
        /// An armed board takes no configuration and no second arm; driving, no pulses; jogging, no
        /// drive.
        ///
        /// Effect: Continues.
        ///
        /// Remedy: Disarm first.
        Busy = "busy",
        /// The ESC has not been at neutral for 2 s (with a kill output: since its supply came on).
        ///
        /// Remedy: Wait.
        NotYetNeutral = "not-yet-neutral",
        /// The wheels are turning.
        ///
        /// Remedy: Let the car stand.
        Moving = "moving",
        /// The stop switch is open.
        ///
        /// Remedy: Close it.
        StopInputOpen = "stop-input-open",
        /// An emergency stop is latched.
        ///
        /// Remedy: Reset the board.
        EmergencyStopLatched = "emergency-stop-latched",
        /// The request rests on telemetry over 95 ms old, or from the future.
        ///
        /// Remedy: A single one is harmless; many mean a slow host or a stuck adapter.
        Stale = "stale",
        /// The frame's number is not newer than the last one: it came late or twice.
        ///
        /// Remedy: A single one is harmless.
        OutOfSequence = "out-of-sequence",
        /// The pose behind the command is older than `board.max_pose_age_ms`.
        ///
        /// Effect: Neutral 95 ms after the last good command.
        ///
        /// Remedy: As for the host's `pose-too-old`.
        PoseTooOld = "pose-too-old",
        /// A command came while the board was not armed.
        ///
        /// Remedy: Nothing: a command may be on its way at a stop.
        NotArmed = "not-armed",
        /// Reverse is disabled.
        ///
        /// Remedy: If the car may reverse, set `board.speed.max_reverse_mm_s`.
        ReverseDisabled = "reverse-disabled",
        /// The host greeted with another version.
        ///
        /// Remedy: As for the host's `version-differs`.
        VersionDiffers = "version-differs",
        /// The configuration's `board.car_id` is not that of the image.
        ///
        /// Remedy: Take this car's file, or flash with `cargo uno --car-id 7`.
        OtherCar = "other-car",
    }
}

enumeration! {
    /// Which kind of request an answer is about.
    pub enum Request {
        /// [`crate::Configure`].
        Configure = "configure",
        /// [`crate::Arm`].
        Arm = "arm",
        /// [`crate::Disarm`].
        Disarm = "disarm",
        /// [`crate::EmergencyStop`].
        EmergencyStop = "emergency-stop",
    }
}

structure! {
    /// The board has done what it was asked.
    pub struct Acknowledgement {
        /// The kind of request.
        pub request: Request,
        /// The number that the request carried.
        pub sequence: Sequence,
        /// Hash of the configuration in force; zero for none.
        pub configuration_hash: u32,
    }
}

structure! {
    /// The board does not do what it was asked.
    pub struct Refusal {
        /// The kind of request.
        pub request: Request,
        /// The number that the request carried.
        pub sequence: Sequence,
        /// Why not.
        pub reason: RefusalReason,
    }
}

enumeration! {
    /// The inertial measurement unit, as the board sees it.
    pub enum ImuState {
        /// No sample yet, or none for 50 ms; the values are the last ones.
        Silent = "silent",
        /// This record carries a sample that no record before it carried.
        Fresh = "fresh",
        /// This record carries the sample of the one before again.
        Repeated = "repeated",
    }
}

structure! {
    /// What control needs, at 100 Hz.
    pub struct Telemetry {
        /// Board time at which this record was made, in µs, wrapping.
        pub board_time_us: u32,
        /// The safety machine.
        pub mode: BoardMode,
        /// Why it last went to neutral.
        pub stop_cause: StopCause,
        /// The last [`crate::Drive`] or [`crate::Jog`] that was accepted.
        pub last_sequence: Sequence,
        /// Whether the IMU values are new.
        pub imu: ImuState,
        /// Age of the IMU sample at `board_time_us`, in units of 100 µs, saturating.
        pub imu_age_100us: u8,
        /// Acceleration without gravity along the car's axes (forward, left, up), in mm/s².
        pub linear_acceleration_mm_s2: [i16; 3],
        /// Angular velocity about the car's axes (forward, left, up), in mrad/s.
        pub angular_velocity_mrad_s: [i16; 3],
        /// Attitude as a unit quaternion w, x, y, z, scaled by 2^14.
        pub attitude_q14: [i16; 4],
        /// Speed measured from the motor pulses, in mm/s; signed by the direction driven.
        pub motor_speed_mm_s: i16,
        /// Servo pulse, in µs; zero while the servo is silent.
        pub servo_us: u16,
        /// ESC pulse, in µs.
        pub esc_us: u16,
    }
}

enumeration! {
    /// Why the board last started.
    pub enum ResetCause {
        /// The supply came up.
        PowerOn = "power-on",
        /// The reset pin: the button, or the host opened the port.
        External = "external",
        /// The supply dipped.
        BrownOut = "brown-out",
        /// The watchdog bit.
        Watchdog = "watchdog",
        /// Nothing that the board can tell.
        Unknown = "unknown",
    }
}

structure! {
    /// What a person wants to know, at 5 Hz. Counters wrap.
    pub struct Status {
        /// Board time at which this record was made, in µs, wrapping.
        pub board_time_us: u32,
        /// Hash of the configuration in force; zero for none.
        pub configuration_hash: u32,
        /// Why the board last started.
        pub reset_cause: ResetCause,
        /// Whether the stop switch is open, if one is configured.
        pub stop_input_open: bool,
        /// Battery voltage, in mV, measured against the processor's own reference.
        pub battery_mv: u16,
        /// Good frames received.
        pub frames_received: u16,
        /// Frames refused for CRC, COBS or length.
        pub frames_damaged: u16,
        /// [`crate::Drive`] and [`crate::Jog`] commands refused.
        pub drives_refused: u16,
        /// The reason of the last such refusal; [`RefusalReason::None`] so far.
        pub last_refusal: RefusalReason,
        /// Frames dropped because the line was full.
        pub frames_dropped: u16,
        /// Bytes lost by the receiver.
        pub bytes_overrun: u16,
        /// Errors on the bus to the IMU.
        pub imu_errors: u16,
        /// The processor's supply, in mV, measured against its own reference.
        pub supply_mv: u16,
        /// The battery's input floats: no divider is connected, and `battery_mv`
        /// means nothing.
        pub battery_open: bool,
        /// The kill output is held: the ESC has its supply. False without one.
        pub power_on: bool,
        /// Milliseconds in which the motor's sensor gave more edges than the board
        /// takes in one: interference.
        pub edges_refused: u16,
        /// The IMU's register `CALIB_STAT` (BNO055, 0x35): two bits each, from the
        /// highest, for system, gyro, accelerometer and magnetometer.
        pub imu_calibration: u8,
        /// The IMU's register `SYS_STATUS` (0x39).
        pub imu_status: u8,
        /// The IMU's register `SYS_ERR` (0x3A).
        pub imu_error: u8,
        /// The IMU's register `ST_RESULT` (0x36): bits 0 to 3 for accelerometer,
        /// magnetometer, gyro and controller.
        pub imu_self_test: u8,
    }
}
