//! The reasons why the car does not drive, or stopped.

use crate::words::words;

words! {
    /// Why the car does not drive, or stopped. Each reason has one word, the same in
    /// status, log and record; `docs/reasons.md` lists them.
    pub enum Reason {
        /// No board answers.
        LinkDown = "link-down",
        /// The board speaks another version of the protocol.
        VersionDiffers = "version-differs",
        /// The board refuses its configuration.
        ConfigurationRefused = "configuration-refused",
        /// The board is starting up.
        BoardBooting = "board-booting",
        /// The board is still armed from an earlier drive.
        BoardArmed = "board-armed",
        /// The board stopped the car by itself.
        BoardFailsafe = "board-failsafe",
        /// An emergency stop is latched until the board is reset.
        EmergencyStop = "emergency-stop",
        /// The stop switch on the board is open.
        StopInputOpen = "stop-input-open",
        /// The board refused to arm.
        BoardRefused = "board-refused",
        /// The board did not arm within `arm_timeout`.
        BoardTimeout = "board-timeout",
        /// Too many frames on the serial line are damaged, in one direction or both.
        LineNoisy = "line-noisy",
        /// No recent status message: battery and stop switch are unknown.
        BatteryUnknown = "battery-unknown",
        /// The battery's voltage is below its limit.
        BatteryLow = "battery-low",
        /// The control thread has not yet reported what the system granted it.
        RealTimeUnknown = "real-time-unknown",
        /// The configuration requires real-time scheduling and locked memory, and the
        /// system did not grant both.
        RealTimeRefused = "real-time-refused",
        /// One tick came much too late, or too many were missed in a second.
        DeadlineMissed = "deadline-missed",
        /// No inertial sample for too long.
        ImuSilent = "imu-silent",
        /// The inertial samples or the gyro's bias are out of range.
        ImuImplausible = "imu-implausible",
        /// The inertial samples are equal to the last bit: the sensor hangs.
        ImuStuck = "imu-stuck",
        /// The IMU measures movement before the car is armed.
        ImuNotStill = "imu-not-still",
        /// No pose has been accepted yet.
        NoPose = "no-pose",
        /// The last accepted pose is too old.
        PoseTooOld = "pose-too-old",
        /// The car has gone too far since the last accepted pose.
        BlindTooFar = "blind-too-far",
        /// Poses are so far apart that the sensors can't be compared.
        PosesTooRare = "poses-too-rare",
        /// Too many poses in a row were implausible.
        PoseImplausible = "pose-implausible",
        /// The car is outside the geofence, or could not stop inside it.
        OutsideFence = "outside-fence",
        /// The estimate has not had enough poses yet.
        EstimateUnsettled = "estimate-unsettled",
        /// The car moves before it is armed.
        Moving = "moving",
        /// The motor pulses and the cameras measure different speeds.
        MotorSpeedMismatch = "motor-speed-mismatch",
        /// The car is faster than its limit by more than the margin.
        Overspeed = "overspeed",
        /// The last external set-point is too old, or none has come.
        SetpointStale = "setpoint-stale",
        /// The reference has ended.
        ReferenceFinished = "reference-finished",
        /// A disarm was requested.
        Requested = "requested",
        /// The law is singular at this state.
        LawSingular = "law-singular",
        /// The operator who held the drive is gone.
        OperatorGone = "operator-gone",
        /// The time of the drive is over.
        TimeUp = "time-up",
        /// The car did not slow down after the motor was put to neutral.
        StopNotObeyed = "stop-not-obeyed",
        /// The measured deceleration of stops is below the configured one.
        BrakesLessThanConfigured = "brakes-less-than-configured",
        /// The car turns to the other side than its wheels are steered.
        SteeringReversed = "steering-reversed",
        /// The car turns much more or much less than its steering should make it.
        SteeringDiffers = "steering-differs",
        /// Gyro and cameras measure different yaw rates.
        GyroDiffers = "gyro-differs",
        /// The car moves in another direction than the yaw of the rigid body explains.
        BodyYawWrong = "body-yaw-wrong",
        /// The accelerometer contradicts the speed of the car, or has a large bias.
        AccelerometerDiffers = "accelerometer-differs",
        /// The poses repeat to the last bit while frames arrive.
        PoseFrozen = "pose-frozen",
        /// The rigid body is outside its height band.
        PoseHeight = "pose-height",
        /// The IMU is tilted before the car is armed.
        ImuTilted = "imu-tilted",
        /// IMU and cameras measure different roll or pitch.
        TiltDiffers = "tilt-differs",
        /// The sideslip is larger than the steering and the tyres explain.
        SideslipImplausible = "sideslip-implausible",
        /// The poses differ from their predictions by more than their noise explains.
        EstimateInconsistent = "estimate-inconsistent",
        /// The mid-exposure of the poses is not known well enough.
        CaptureTimeUncertain = "capture-time-uncertain",
        /// The board has latched a stop because the motor ran at neutral.
        RunsAtNeutral = "runs-at-neutral",
        /// Nothing is connected to the input that measures the battery.
        BatteryOpen = "battery-open",
        /// The IMU reports an error, or failed its self-test.
        ImuFault = "imu-fault",
    }
}

impl Reason {
    /// Whether poses contradicted what the other sensors and the car's dynamics allow.
    pub(crate) const fn doubts_cameras(self) -> bool {
        matches!(
            self,
            Self::PoseImplausible
                | Self::BodyYawWrong
                | Self::SideslipImplausible
                | Self::EstimateInconsistent
        )
    }

    /// Whether the word, found in a drive of a proved configuration, contradicts its proof: a
    /// person must look at the car, and say so by a disarm request, before it drives again.
    /// (Of an unproved configuration every contradiction does.)
    pub(super) const fn contradicts_proof(self) -> bool {
        matches!(
            self,
            Self::SteeringDiffers
                | Self::GyroDiffers
                | Self::AccelerometerDiffers
                | Self::SideslipImplausible
        )
    }
}
