//! What the pins tell the board, and what the board tells the pins.

/// The motor's pulses, as an interrupt counts them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotorPulses {
    /// Pulses so far, wrapping.
    pub count: u16,
    /// Board time of the newest one, in µs. Of no meaning until `count` has
    /// changed for the first time.
    pub last_edge_us: u32,
}

/// One sample of the inertial measurement unit, along the car's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImuSample {
    /// Board time at which it was taken, in µs; tells one sample from the next.
    pub time_us: u32,
    /// See [`singletrack_protocol::Telemetry::linear_acceleration_mm_s2`].
    pub linear_acceleration_mm_s2: [i16; 3],
    /// See [`singletrack_protocol::Telemetry::angular_velocity_mrad_s`].
    pub angular_velocity_mrad_s: [i16; 3],
    /// See [`singletrack_protocol::Telemetry::attitude_q14`].
    pub attitude_q14: [i16; 4],
}

/// Everything that the board senses, read shortly before the poll.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// The motor's pulses; count and time must belong together.
    pub motor: MotorPulses,
    /// The newest IMU sample. It may be given again at every poll until the
    /// next one, or only once.
    pub imu: Option<ImuSample>,
    /// Battery voltage, in mV.
    pub battery_mv: u16,
    /// Level of the normally-closed stop input; ignored unless configured.
    pub stop_input_open: bool,
    /// Bytes lost by the receiver so far, wrapping.
    pub bytes_overrun: u16,
    /// Errors on the bus to the IMU so far, wrapping.
    pub imu_errors: u16,
}

/// What the pins have to show until the next poll.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outputs {
    /// Servo pulse, in µs; `None`: no pulses at all.
    pub servo_us: Option<u16>,
    /// ESC pulse, in µs.
    pub esc_us: u16,
    /// The ESC's neutral pulse, in µs, for whoever has to stop the car without
    /// another poll.
    pub esc_neutral_us: u16,
    /// While driving: the board time, in µs, up to which the command is in
    /// force. Once it has passed without another poll, an independent
    /// supervisor (a timer interrupt) must give the ESC its neutral pulse.
    pub drive_deadline_us: Option<u32>,
}
