//! Why the car does not drive, or stopped.

use crate::words::words;

words! {
    /// Why the car does not drive, or stopped. One word in status, log and record.
    pub enum Reason {
        /// No board answers.
        LinkDown = "link-down",
        /// The board speaks another version of the protocol.
        VersionDiffers = "version-differs",
        /// The board does not take its configuration.
        ConfigurationRefused = "configuration-refused",
        /// The board is starting up.
        BoardBooting = "board-booting",
        /// The board is still armed from before.
        BoardArmed = "board-armed",
        /// The board stopped the car by itself.
        BoardFailsafe = "board-failsafe",
        /// An emergency stop is latched until the board is reset.
        EmergencyStop = "emergency-stop",
        /// The stop switch on the board is open.
        StopInputOpen = "stop-input-open",
        /// The board refused to arm.
        BoardRefused = "board-refused",
        /// The board did not answer in time.
        BoardTimeout = "board-timeout",
        /// Too many frames on the line to the board are damaged.
        LineNoisy = "line-noisy",
        /// The board has not told the battery's voltage.
        BatteryUnknown = "battery-unknown",
        /// The battery is low.
        BatteryLow = "battery-low",
        /// Nobody has said whether the controller runs in real time.
        RealTimeUnknown = "real-time-unknown",
        /// The system did not grant what the configuration demands: real-time
        /// scheduling and locked memory.
        RealTimeRefused = "real-time-refused",
        /// The controller was late: too long once, or too often.
        DeadlineMissed = "deadline-missed",
        /// No inertial sample for too long.
        ImuSilent = "imu-silent",
        /// The inertial samples can't be: out of range, or the gyro's bias is.
        ImuImplausible = "imu-implausible",
        /// The inertial samples repeat themselves: the sensor hangs.
        ImuStuck = "imu-stuck",
        /// The IMU feels movement before the car was armed.
        ImuNotStill = "imu-not-still",
        /// No pose yet.
        NoPose = "no-pose",
        /// The last accepted pose is too old.
        PoseTooOld = "pose-too-old",
        /// The car has gone too far since the last accepted pose.
        BlindTooFar = "blind-too-far",
        /// Too many poses in a row were implausible.
        PoseImplausible = "pose-implausible",
        /// The car is outside the fence, or could not stop inside.
        OutsideFence = "outside-fence",
        /// The estimate has not settled.
        EstimateUnsettled = "estimate-unsettled",
        /// The car moves before it was armed.
        Moving = "moving",
        /// The motor's pulses and the cameras tell different speeds.
        MotorSpeedMismatch = "motor-speed-mismatch",
        /// The car is much faster than it may be.
        Overspeed = "overspeed",
        /// No set-point for too long: whoever sends them has stopped, or not begun.
        SetpointStale = "setpoint-stale",
        /// The reference has come to its end.
        ReferenceFinished = "reference-finished",
        /// Someone asked.
        Requested = "requested",
        /// The law has no answer at this state.
        LawSingular = "law-singular",
    }
}
