//! The reasons why the car does not drive, or stopped.

use singletrack_control::words;

words! {
    /// Why the car does not drive, or stopped. Each reason has one word, the same in
    /// status, log and record; `docs/reasons.md` lists them.
    pub enum Reason {
        /// No board answers for 200 ms, or the port hung up.
        ///
        /// Effect: Refuses. Driving: a board with power is at neutral 120 ms after the last command.
        ///
        /// Remedy: Plug the board in; check `serial.port` and its permissions.
        LinkDown = 1 "link-down",
        /// The board speaks another protocol version.
        ///
        /// Effect: Refuses.
        ///
        /// Remedy: Flash the firmware of the host's release.
        VersionDiffers = 17 "version-differs",
        /// The board refuses its configuration.
        ///
        /// Effect: Refuses; retried every second.
        ///
        /// Remedy: Correct `[board]`: the log has the board's refusal.
        ConfigurationRefused = 18 "configuration-refused",
        /// The board has just started: it holds the ESC at neutral for 2 s.
        ///
        /// Effect: Refuses.
        ///
        /// Remedy: Wait. If it repeats, the supply dips: see `reset_cause`.
        BoardBooting = 2 "board-booting",
        /// The board is still armed from before.
        ///
        /// Effect: Refuses.
        ///
        /// Remedy: Disarm, then arm.
        BoardArmed = 16 "board-armed",
        /// The board stopped the car by itself.
        ///
        /// Effect: Neutral already.
        ///
        /// Remedy: Read `board.stop_cause`.
        BoardFailsafe = 3 "board-failsafe",
        /// A client or the switch made an emergency stop, or one is latched.
        ///
        /// Effect: Neutral within 36 ms.
        ///
        /// Remedy: Find the cause; then reset the board.
        EmergencyStop = 4 "emergency-stop",
        /// The stop switch on the board is open.
        ///
        /// Effect: Refuses. Driving: the board latches an emergency stop.
        ///
        /// Remedy: Close the switch; check its wire. Without a switch, set
        /// `board.stop_input = false`.
        StopInputOpen = 19 "stop-input-open",
        /// The board refused to arm.
        ///
        /// Effect: Refuses.
        ///
        /// Remedy: Read the board's refusal in the log.
        BoardRefused = 5 "board-refused",
        /// The board did not answer an arm request for 0.5 s.
        ///
        /// Effect: Refuses, and disarms the board.
        ///
        /// Remedy: Look at the line's damaged frames.
        BoardTimeout = 6 "board-timeout",
        /// Over half of a second's frames, either way, were damaged.
        ///
        /// Remedy: Use another cable, away from the motor's; add a ferrite; check the baud rate.
        LineNoisy = 20 "line-noisy",
        /// No report of battery and stop switch for 1 s.
        ///
        /// Remedy: Wait; if it stays, the line loses frames.
        BatteryUnknown = 21 "battery-unknown",
        /// The battery is below `supervisor.arm_battery_v`, or driving below `min_battery_v` in
        /// three reports.
        ///
        /// Effect: Refuses, or stops within 0.6 s.
        ///
        /// Remedy: Charge it. Without a voltage divider, set both to 0.
        BatteryLow = 22 "battery-low",
        /// The control thread has not yet reported what the system granted it.
        ///
        /// Effect: Refuses.
        ///
        /// Remedy: Wait for the first tick.
        RealTimeUnknown = 23 "real-time-unknown",
        /// The system refused real-time scheduling or locked memory
        /// (`supervisor.require_real_time`).
        ///
        /// Remedy: Grant `LimitRTPRIO` and `LimitMEMLOCK`, as the shipped unit does.
        RealTimeRefused = 24 "real-time-refused",
        /// A tick came over 80 ms after the last, or over 20 were missed in a second.
        ///
        /// Remedy: Stop other programs on that core; see the figures in status.
        DeadlineMissed = 25 "deadline-missed",
        /// No inertial sample for 100 ms.
        ///
        /// Remedy: Check the IMU's bus and supply; see `imu_errors`.
        ImuSilent = 7 "imu-silent",
        /// Five samples in a row exceed the car's rates or accelerations, or the gyro's bias 0.2
        /// rad/s.
        ///
        /// Effect: Refuses, or stops within 50 ms.
        ///
        /// Remedy: Check the IMU's mounting and supply; switch it on at rest.
        ImuImplausible = 26 "imu-implausible",
        /// Twenty-five samples are equal: the sensor hangs.
        ///
        /// Effect: Refuses, or stops within 0.25 s.
        ///
        /// Remedy: Reset the board; check the bus.
        ImuStuck = 27 "imu-stuck",
        /// The IMU measures movement.
        ///
        /// Effect: Refuses, until none for 0.2 s.
        ///
        /// Remedy: Put the car down, and let it stand.
        ImuNotStill = 28 "imu-not-still",
        /// No pose yet.
        ///
        /// Effect: Refuses.
        ///
        /// Remedy: Start streaming; check `motion_capture.server` and `rigid_body`; look at the
        /// camera messages in the log.
        NoPose = 8 "no-pose",
        /// The last accepted pose is too old.
        ///
        /// Effect: Refuses beyond 50 ms. Driving: slows beyond 300 ms, stops beyond 600 ms.
        ///
        /// Remedy: Look at `cameras` in status: markers and view, but also frame rate, latency and clock.
        PoseTooOld = 9 "pose-too-old",
        /// The car has gone too far since the last accepted pose.
        ///
        /// Effect: Slows beyond 0.15 m, stops beyond 0.45 m.
        ///
        /// Remedy: Add markers, improve the cameras' view, or drive more slowly there.
        BlindTooFar = 29 "blind-too-far",
        /// For 1.2 s no two poses were 40 to 120 ms apart: the sensors can't be checked.
        ///
        /// Remedy: Raise the cameras' frame rate; add markers.
        PosesTooRare = 53 "poses-too-rare",
        /// Twenty poses in a row were implausible, or the body is locked out.
        ///
        /// Effect: Refuses, or stops (0.2 s at 100 Hz).
        ///
        /// Remedy: Look for another body with the car's markers, and at `rejected`. Only if it is
        /// the car, carried there: `singletrack disarm --carried`.
        PoseImplausible = 10 "pose-implausible",
        /// The car is outside the geofence, could not stop inside it, or the safety filter stopped
        /// it.
        ///
        /// Effect: Refuses, or stops: inside, if it brakes with `fence.braking_m_s2`.
        ///
        /// Remedy: Carry it back; check `[fence]` and the reference.
        OutsideFence = 30 "outside-fence",
        /// The estimate needs 50 accepted poses.
        ///
        /// Effect: Refuses for 0.5 s.
        ///
        /// Remedy: Wait.
        EstimateUnsettled = 11 "estimate-unsettled",
        /// The car moves, has not stood for 0.2 s since its last stop, or is faster than 0.1 m/s
        /// while the board arms.
        ///
        /// Effect: Refuses, or disarms the board.
        ///
        /// Remedy: Let it stand. If it set off by itself, cut the motor's supply: the throttle is
        /// stuck.
        Moving = 12 "moving",
        /// Motor pulses and cameras disagree: in speed over two spans of 0.2 s, or in distance on
        /// an unproved car's first metre.
        ///
        /// Effect: Stops within 0.5 s; unproved: needs a disarm.
        ///
        /// Remedy: Check the pulse sensor and `board.speed.pulse_distance_um`; the wheels may spin.
        MotorSpeedMismatch = 31 "motor-speed-mismatch",
        /// For five ticks the car was over 0.4 m/s faster than `limits.max_speed_m_s` (unproved:
        /// than 0.3 m/s).
        ///
        /// Effect: Stops within 50 ms.
        ///
        /// Remedy: Check the gains in `[board.speed]`.
        Overspeed = 32 "overspeed",
        /// No set-point for 200 ms.
        ///
        /// Remedy: Start the sender; then arm.
        SetpointStale = 33 "setpoint-stale",
        /// The reference has come to its end.
        ///
        /// Effect: Stops.
        ///
        /// Remedy: Nothing.
        ReferenceFinished = 13 "reference-finished",
        /// A client requested a disarm, or the daemon ends.
        ///
        /// Effect: Stops.
        ///
        /// Remedy: Nothing.
        Requested = 14 "requested",
        /// The law has no answer (the wheels stand across the velocity), or the outer loop's
        /// velocity is not finite.
        ///
        /// Effect: Neutral; mode `fault`. With the safety filter, a velocity that is not finite
        /// only stops the car.
        ///
        /// Remedy: Disarm. Look in the record for a slide, a crash or a wrong yaw.
        LawSingular = 15 "law-singular",
        /// The operator let go, or did not renew the drive for 0.5 s (jogging: 0.25 s).
        ///
        /// Effect: Stops; jogging: neutral within 0.3 s.
        ///
        /// Remedy: Arm again, and let the command that arms run.
        OperatorGone = 34 "operator-gone",
        /// The time that was given with the arm request is over.
        ///
        /// Effect: Stops.
        ///
        /// Remedy: Nothing.
        TimeUp = 35 "time-up",
        /// The motor is at neutral, and the car does not slow down.
        ///
        /// Effect: Emergency stop; mode `fault` until a disarm at standstill.
        ///
        /// Remedy: Cut the motor's supply by hand. Find the cause before you drive: the ESC ignores
        /// its pulse, or the car rolls downhill.
        StopNotObeyed = 36 "stop-not-obeyed",
        /// The last stop was weaker than `fence.braking_m_s2` promises; the log has the deceleration.
        ///
        /// Effect: Refuses until the value fits these stops. First metre: needs a disarm.
        ///
        /// Remedy: Set `fence.braking_m_s2` to the logged deceleration, and reload; disarm if the
        /// drive was stopped. If the brakes are mended, or it came with `motor-speed-mismatch` whose
        /// cause is corrected, restart the daemon: it forgets these stops.
        BrakesLessThanConfigured = 37 "brakes-less-than-configured",
        /// The car turned against its steering.
        ///
        /// Effect: Needs a disarm.
        ///
        /// Remedy: Change the sign of `board.servo.gain_us_per_rad`.
        SteeringReversed = 38 "steering-reversed",
        /// The car turned much more or less than steered; with the safety filter, for 0.2 s by more
        /// than `safety_filter.curvature_error_per_m`.
        ///
        /// Effect: Needs a disarm.
        ///
        /// Remedy: If it turns to the other side, change the sign of `board.servo.gain_us_per_rad`; else measure
        /// it, `centre_us` and the axles in `[vehicle]`, and check servo and linkage.
        SteeringDiffers = 39 "steering-differs",
        /// Gyro and cameras measured different rotations.
        ///
        /// Effect: Needs a disarm.
        ///
        /// Remedy: Check the axes in `[board.imu]`, and `motion_capture.up_axis`.
        GyroDiffers = 40 "gyro-differs",
        /// The direction of motion contradicts the rigid body's yaw.
        ///
        /// Effect: Needs a disarm.
        ///
        /// Remedy: Define the rigid body with x forward, or set `motion_capture.marker_yaw_rad`.
        BodyYawWrong = 41 "body-yaw-wrong",
        /// The accelerometer contradicts the car's speed, or its bias is too large.
        ///
        /// Effect: Needs a disarm.
        ///
        /// Remedy: Check the axes in `[board.imu]` and the mounting.
        AccelerometerDiffers = 42 "accelerometer-differs",
        /// The poses repeat to the last bit for 0.3 s while frames arrive.
        ///
        /// Remedy: Restart the motion capture: it streams an old pose.
        PoseFrozen = 43 "pose-frozen",
        /// The rigid body is outside `motion_capture.pose.height_m`.
        ///
        /// Effect: Refuses.
        ///
        /// Remedy: Check `motion_capture.up_axis`, the ground plane and the body's pivot.
        PoseHeight = 44 "pose-height",
        /// The IMU is tilted by more than `watch.max_tilt_rad`.
        ///
        /// Effect: Refuses.
        ///
        /// Remedy: Put the car on a level floor; check the axes in `[board.imu]`.
        ImuTilted = 45 "imu-tilted",
        /// IMU and cameras differ in roll or pitch by more than `watch.max_tilt_difference_rad`.
        ///
        /// Effect: Refuses.
        ///
        /// Remedy: Check the axes in `[board.imu]`; define the rigid body while the car stands on
        /// the floor.
        TiltDiffers = 46 "tilt-differs",
        /// The car slips more than its steering explains, or the cameras erred for some frames.
        ///
        /// Effect: Needs a disarm.
        ///
        /// Remedy: Drive more slowly. If it happens at any speed, correct the rigid body's yaw.
        SideslipImplausible = 47 "sideslip-implausible",
        /// Poses differ from their predictions by much more than noise.
        ///
        /// Effect: Stops.
        ///
        /// Remedy: Check the IMU's axes, the marker offset and `[estimator]`.
        EstimateInconsistent = 48 "estimate-inconsistent",
        /// The poses' mid-exposure is less certain than `watch.max_capture_uncertainty_ms`.
        ///
        /// Effect: Refuses, or stops after 0.5 s.
        ///
        /// Remedy: Look for load on the cameras' network.
        CaptureTimeUncertain = 49 "capture-time-uncertain",
        /// The board latched a stop: the motor ran undriven.
        ///
        /// Effect: Neutral.
        ///
        /// Remedy: Check `board.esc.neutral_us` and the ESC; then reset the board.
        RunsAtNeutral = 50 "runs-at-neutral",
        /// Nothing is wired to the battery input (A0).
        ///
        /// Effect: Refuses unless `supervisor.arm_battery_v` and `min_battery_v` are 0; stops
        /// within 0.2 s unless the latter is.
        ///
        /// Remedy: Connect the voltage divider, or set both to 0.
        BatteryOpen = 51 "battery-open",
        /// The IMU reports an error, or failed its self-test.
        ///
        /// Effect: Refuses; twice in a row (0.2 s) stops.
        ///
        /// Remedy: Reset the board; replace the IMU if it returns.
        ImuFault = 52 "imu-fault",
        /// The cameras list another rigid body, and have never seen it; a body of
        /// `neighbours.expected` is not listed; or there are more than 24.
        ///
        /// Effect: Refuses. Driving: stops.
        ///
        /// Remedy: Look for the body's markers; correct `neighbours.expected`; remove bodies that
        /// are not on the floor, or name them in `neighbours.ignored`.
        NeighbourUnknown = 54 "neighbour-unknown",
        /// Another rigid body is where the car may not stop before it, or has stood in its way
        /// for `neighbours.patience_s`.
        ///
        /// Effect: Stops.
        ///
        /// Remedy: Move the car or the body away; arm again.
        NeighbourNear = 55 "neighbour-near",
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
