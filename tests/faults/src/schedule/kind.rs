//! Fault kinds.

/// The part that a fault affects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultTarget {
    /// Cameras, their server and the network.
    Cameras,
    /// The serial line.
    Line,
    /// The board with its sensors and actuators.
    Board,
    /// The car: servo, ESC, drive train.
    Car,
    /// The daemon and its computer.
    Host,
    /// The program that attends the drive.
    Operator,
}

macro_rules! kinds {
    ($($(#[$meaning:meta])* $kind:ident = $name:literal, $target:ident;)*) => {
        /// Kinds of faults; s is the severity, 1 to 1000.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum FaultKind {
            $($(#[$meaning])* $kind,)*
        }

        impl FaultKind {
            /// All kinds.
            pub const ALL: &[Self] = &[$(Self::$kind,)*];

            /// The name in a schedule.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)*
                }
            }

            /// The part that it affects.
            pub const fn target(self) -> FaultTarget {
                match self {
                    $(Self::$kind => FaultTarget::$target,)*
                }
            }
        }
    };
}

kinds! {
    /// The car is in the frames, marked as not tracked, with its last pose.
    CameraUntracked = "camera-untracked", Cameras;
    /// The car is not in the frames.
    CameraAbsent = "camera-absent", Cameras;
    /// s in 1000 frames are lost.
    CameraSilent = "camera-silent", Cameras;
    /// The car is sent with an unknown id.
    CameraHidden = "camera-hidden", Cameras;
    /// The last pose is repeated in new frames.
    CameraFrozen = "camera-frozen", Cameras;
    /// The car's pose is off by s mm.
    CameraJump = "camera-jump", Cameras;
    /// The car's pose is off by s mm in every third frame.
    CameraJumping = "camera-jumping", Cameras;
    /// The car and another body exchange ids.
    CameraSwapped = "camera-swapped", Cameras;
    /// The car and another body exchange names, with an announcement.
    CameraRenamed = "camera-renamed", Cameras;
    /// The car's yaw is off by s thousandths of half a turn.
    CameraFlip = "camera-flip", Cameras;
    /// Frames arrive s/2 ms later.
    CameraLate = "camera-late", Cameras;
    /// Every frame is delayed by a random time up to s/4 ms.
    CameraReordered = "camera-reordered", Cameras;
    /// Every frame arrives twice, the copy up to s ms later.
    CameraDuplicated = "camera-duplicated", Cameras;
    /// Position and attitude are NaN.
    CameraNotANumber = "camera-nan", Cameras;
    /// One coordinate is infinite.
    CameraInfinite = "camera-infinite", Cameras;
    /// Two bodies have the car's id, s mm apart.
    CameraDuplicateId = "camera-duplicate-id", Cameras;
    /// The server's clock steps back by s ms.
    CameraClockBackward = "camera-clock-backward", Cameras;
    /// The server's clock steps forward by s ms.
    CameraClockForward = "camera-clock-forward", Cameras;
    /// The car gets another id, announced and in the definitions, until the end.
    CameraModelChange = "camera-model-change", Cameras;
    /// The server restarts: clock and frame numbers start again.
    CameraServerRestart = "camera-server-restart", Cameras;
    /// s in 1000 frames are truncated or corrupted.
    CameraMalformed = "camera-malformed", Cameras;
    /// Somebody sends frames between the server's, from its own address, with the car off
    /// by s mm.
    CameraSpoofed = "camera-spoofed", Cameras;
    /// A spoofed frame with the next frame's number, so that the true frame seems a repetition, and
    /// with the car drifting away by s mm/s.
    CameraForged = "camera-forged", Cameras;
    /// All packets come from another address: the server has a second network card.
    CameraSecondCard = "camera-second-card", Cameras;
    /// The car's pose drifts away by s mm/s.
    CameraDrift = "camera-drift", Cameras;
    /// The car's pose is that of something else, s cm from where the car was, that stands there with
    /// noise of its own.
    CameraGhost = "camera-ghost", Cameras;
    /// The markers are seen in one frame of 2 + s/50 only.
    CameraRare = "camera-rare", Cameras;

    /// s in 5000 bytes are lost, both ways.
    LineDrop = "line-drop", Line;
    /// s in 5000 bytes have a bit flipped, both ways.
    LineCorrupt = "line-corrupt", Line;
    /// Nothing passes; the queued bytes follow at the end.
    LineStuck = "line-stuck", Line;
    /// Every byte takes s/5 ms longer.
    LineDelay = "line-delay", Line;
    /// The USB plug is pulled, or the hub or the host's computer loses its power: the board does
    /// too, unless it has a supply of its own.
    LineUnplugged = "line-unplugged", Line;

    /// Power-on reset.
    BoardPowerOn = "board-power-on", Board;
    /// External reset, as by the button.
    BoardReset = "board-reset", Board;
    /// Brown-out reset.
    BoardBrownOut = "board-brown-out", Board;
    /// Watchdog reset.
    BoardWatchdog = "board-watchdog", Board;
    /// The board is without power.
    BoardOff = "board-off", Board;
    /// The main loop hangs until the watchdog resets the board.
    BoardHang = "board-hang", Board;
    /// The ESC is without power; the board is not.
    EscOff = "esc-off", Board;
    /// The IMU gives no samples.
    ImuSilent = "imu-silent", Board;
    /// The IMU repeats its last sample.
    ImuStuck = "imu-stuck", Board;
    /// The gyroscope has a bias of s mrad/s, the accelerometer of s mm/s².
    ImuBiased = "imu-biased", Board;
    /// All IMU values are at full scale.
    ImuSaturated = "imu-saturated", Board;
    /// Every other IMU sample has its signs reversed.
    ImuErratic = "imu-erratic", Board;
    /// One IMU sample of 1020 - s has a wrong bit, one of the two highest.
    ImuWrongBit = "imu-wrong-bit", Board;
    /// The motor sensor gives no pulses.
    PulsesGone = "pulses-gone", Board;
    /// Every motor pulse is counted twice.
    PulsesDoubled = "pulses-doubled", Board;
    /// Every other motor pulse is missing.
    PulsesHalved = "pulses-halved", Board;
    /// Motor pulses are unevenly spaced.
    PulsesErratic = "pulses-erratic", Board;
    /// The stop switch is open.
    StopInputOpen = "stop-input-open", Board;
    /// The battery voltage drops by s/250 V.
    BatteryLow = "battery-low", Board;

    /// The wheels keep their steering angle, until the end of the drive.
    ServoStuck = "servo-stuck", Car;
    /// The throttle stays as it is, until the end of the drive; only a kill output ends it.
    EscStuck = "esc-stuck", Car;
    /// The ESC restarts and has no power meanwhile.
    EscReboot = "esc-reboot", Car;
    /// The supply of servo and IMU fails: the wheels keep their angle, the IMU restarts.
    BecDip = "bec-dip", Car;
    /// Somebody moves the car at (s - 500)/500 m/s.
    Push = "push", Car;
    /// s/2000 of the wheels' rotation slips, until the end of the drive.
    WheelSlip = "wheel-slip", Car;

    /// The daemon is suspended (SIGSTOP) and continued.
    DaemonPaused = "daemon-paused", Host;
    /// The daemon is killed (SIGKILL); another one starts at the end.
    DaemonKilled = "daemon-killed", Host;
    /// Every tick is late by a random time up to s/20 ms.
    TicksLate = "ticks-late", Host;
    /// The wall clock is off by s days, which must have no effect.
    WallClockStep = "wall-clock-step", Host;
    /// The program that sends set-points is silent.
    SetpointsGone = "setpoints-gone", Host;
    /// Set-points are no numbers.
    SetpointsNotANumber = "setpoints-nan", Host;
    /// Set-points were decided s ms ago.
    SetpointsOld = "setpoints-old", Host;
    /// Set-points are decided in s s.
    SetpointsFuture = "setpoints-future", Host;
    /// The program demands all speed and full steering, to the other side every s ms.
    SetpointsAtFullLock = "setpoints-full-lock", Host;
    /// The program demands all speed straight ahead.
    SetpointsOutward = "setpoints-outward", Host;
    /// The program demands trajectories straight out of the geofence.
    SetpointsTrajectory = "setpoints-trajectory", Host;
    /// The program sends anything, without a pause.
    SetpointsFlood = "setpoints-flood", Host;
    /// The outer loop wants P to move anywhere, elsewhere every s ms.
    LoopRandom = "loop-random", Host;
    /// The outer loop wants all speed to one side of the car, to the other every s ms.
    LoopBangBang = "loop-bang-bang", Host;
    /// The outer loop wants all speed at the nearest side of the geofence.
    LoopAtFence = "loop-at-fence", Host;
    /// The outer loop wants all speed along the nearest side, and suddenly at it every s ms.
    LoopFeint = "loop-feint", Host;
    /// Other clients send s/10 requests a millisecond: they renew the drive, and tune it.
    RequestFlood = "request-flood", Host;

    /// The program that attends the drive hangs: it renews nothing.
    OperatorHangs = "operator-hangs", Operator;
    /// The pulses of the operator who jogs are any numbers.
    JogWild = "jog-wild", Operator;
}

impl FaultKind {
    /// Whether the cameras report a false pose of the car.
    pub const fn falsifies_pose(self) -> bool {
        matches!(
            self,
            Self::CameraFrozen
                | Self::CameraJump
                | Self::CameraJumping
                | Self::CameraSwapped
                | Self::CameraRenamed
                | Self::CameraFlip
                | Self::CameraDrift
                | Self::CameraGhost
        )
    }

    /// Whether somebody else sends frames of the car.
    pub const fn forges_frames(self) -> bool {
        matches!(self, Self::CameraSpoofed | Self::CameraForged)
    }

    /// The subject of the fault, named by one of its kinds; only one fault per
    /// subject is in effect.
    #[must_use]
    pub const fn subject(self) -> Self {
        match self {
            Self::ImuStuck
            | Self::ImuBiased
            | Self::ImuSaturated
            | Self::ImuErratic
            | Self::ImuWrongBit => Self::ImuSilent,
            Self::PulsesDoubled | Self::PulsesHalved | Self::PulsesErratic => Self::PulsesGone,
            kind => kind,
        }
    }

    /// Whether the program that sends set-points is hostile. It is in schedules with such a
    /// program only.
    pub const fn is_hostile(self) -> bool {
        matches!(
            self,
            Self::SetpointsOld
                | Self::SetpointsFuture
                | Self::SetpointsAtFullLock
                | Self::SetpointsOutward
                | Self::SetpointsTrajectory
                | Self::SetpointsFlood
        )
    }

    /// Whether an outer loop, a program that sends velocities of P, is hostile. It is in
    /// schedules with such a loop only.
    pub const fn is_hostile_loop(self) -> bool {
        matches!(
            self,
            Self::LoopRandom | Self::LoopBangBang | Self::LoopAtFence | Self::LoopFeint
        )
    }

    /// Whether [`Schedule::generate`](super::Schedule::generate) draws it from a stream of its own.
    pub const fn is_drawn_apart(self) -> bool {
        matches!(
            self,
            Self::CameraGhost
                | Self::CameraRare
                | Self::ImuWrongBit
                | Self::RequestFlood
                | Self::OperatorHangs
                | Self::JogWild
        )
    }

    /// Whether the program sends no set-points, or others than it should.
    pub const fn changes_setpoints(self) -> bool {
        matches!(self, Self::SetpointsGone | Self::SetpointsNotANumber)
            || self.is_hostile()
            || self.is_hostile_loop()
    }

    /// Whether the host's threads run later or not at all.
    pub const fn delays_host(self) -> bool {
        matches!(
            self,
            Self::DaemonPaused | Self::DaemonKilled | Self::TicksLate
        )
    }

    /// Whether it happens once in a drive: only the first one counts.
    pub const fn happens_once(self) -> bool {
        matches!(self.target(), FaultTarget::Car)
    }

    /// Whether it lasts until the end of the drive, whatever its duration.
    pub const fn is_lasting(self) -> bool {
        matches!(self, Self::ServoStuck | Self::EscStuck | Self::WheelSlip)
    }

    /// Whether the fault is instantaneous.
    pub const fn is_momentary(self) -> bool {
        matches!(
            self,
            Self::BoardPowerOn
                | Self::BoardReset
                | Self::BoardBrownOut
                | Self::BoardWatchdog
                | Self::BoardHang
        )
    }
}
