//! The kinds of faults.

/// What a fault falsifies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultTarget {
    /// Cameras, their server and the network.
    Cameras,
    /// The serial line.
    Line,
    /// The board with what hangs on it.
    Board,
    /// The daemon and its computer.
    Host,
}

macro_rules! kinds {
    ($($(#[$meaning:meta])* $kind:ident = $name:literal, $target:ident;)*) => {
        /// What can go wrong. With s the severity, 1 to 1000.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum FaultKind {
            $($(#[$meaning])* $kind,)*
        }

        impl FaultKind {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$kind,)*];

            /// The name in a schedule.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)*
                }
            }

            /// What it falsifies.
            #[must_use]
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
    /// s in 1000 frames do not come.
    CameraSilent = "camera-silent", Cameras;
    /// The car goes under an id that nobody knows.
    CameraHidden = "camera-hidden", Cameras;
    /// The last pose is repeated as a new one.
    CameraFrozen = "camera-frozen", Cameras;
    /// The car seems s mm away from where it is.
    CameraJump = "camera-jump", Cameras;
    /// The same in every third frame only.
    CameraJumping = "camera-jumping", Cameras;
    /// Car and another body have each other's pose.
    CameraSwapped = "camera-swapped", Cameras;
    /// Car and another body have each other's name, first announced.
    CameraRenamed = "camera-renamed", Cameras;
    /// The car seems turned by s thousandths of half a turn.
    CameraFlip = "camera-flip", Cameras;
    /// Frames arrive s/2 ms later.
    CameraLate = "camera-late", Cameras;
    /// Every frame arrives later by up to s/4 ms, each by its own time.
    CameraReordered = "camera-reordered", Cameras;
    /// Every frame comes again, up to s ms later.
    CameraDuplicated = "camera-duplicated", Cameras;
    /// Position and attitude are no numbers.
    CameraNotANumber = "camera-nan", Cameras;
    /// One coordinate is infinite.
    CameraInfinite = "camera-infinite", Cameras;
    /// Two bodies have the car's id, s mm apart.
    CameraDuplicateId = "camera-duplicate-id", Cameras;
    /// The server's clock is s ms behind what it was.
    CameraClockBackward = "camera-clock-backward", Cameras;
    /// The server's clock is s ms ahead of what it was.
    CameraClockForward = "camera-clock-forward", Cameras;
    /// The car gets another id, announced and in the definitions; then its own again.
    CameraModelChange = "camera-model-change", Cameras;
    /// The server is gone, and comes back with clock and numbers from the beginning.
    CameraServerRestart = "camera-server-restart", Cameras;
    /// s in 1000 datagrams are cut short or have bytes changed.
    CameraMalformed = "camera-malformed", Cameras;
    /// Somebody else sends frames too, as from the server, with the car s mm away.
    CameraSpoofed = "camera-spoofed", Cameras;

    /// s in 5000 bytes are lost, both ways.
    LineDrop = "line-drop", Line;
    /// s in 5000 bytes have a bit flipped, both ways.
    LineCorrupt = "line-corrupt", Line;
    /// Nothing passes; afterwards everything that waited.
    LineStuck = "line-stuck", Line;
    /// Every byte takes s/5 ms longer.
    LineDelay = "line-delay", Line;
    /// The plug is pulled.
    LineUnplugged = "line-unplugged", Line;

    /// The supply comes up anew, at once.
    BoardPowerOn = "board-power-on", Board;
    /// The reset button.
    BoardReset = "board-reset", Board;
    /// The supply dips.
    BoardBrownOut = "board-brown-out", Board;
    /// The watchdog bites.
    BoardWatchdog = "board-watchdog", Board;
    /// The board has no supply.
    BoardOff = "board-off", Board;
    /// The main loop hangs, until the watchdog bites.
    BoardHang = "board-hang", Board;
    /// The ESC has no supply; the board has.
    EscOff = "esc-off", Board;
    /// No samples of the IMU.
    ImuSilent = "imu-silent", Board;
    /// The IMU repeats its last sample.
    ImuStuck = "imu-stuck", Board;
    /// The gyroscope is off by s mrad/s, the accelerometer by s mm/s².
    ImuBiased = "imu-biased", Board;
    /// All values of the IMU are at the end of their scales.
    ImuSaturated = "imu-saturated", Board;
    /// Every other sample of the IMU has its signs reversed.
    ImuErratic = "imu-erratic", Board;
    /// No motor pulse comes.
    PulsesGone = "pulses-gone", Board;
    /// Every motor pulse comes twice.
    PulsesDoubled = "pulses-doubled", Board;
    /// Every other motor pulse is missing.
    PulsesHalved = "pulses-halved", Board;
    /// Motor pulses come at uneven distances.
    PulsesErratic = "pulses-erratic", Board;
    /// The stop switch is open.
    StopInputOpen = "stop-input-open", Board;
    /// The battery has s/250 V less than it had.
    BatteryLow = "battery-low", Board;

    /// The daemon is stopped (SIGSTOP), and goes on.
    DaemonPaused = "daemon-paused", Host;
    /// The daemon is killed (SIGKILL), and another one starts.
    DaemonKilled = "daemon-killed", Host;
    /// Every tick is late by up to s/20 ms.
    TicksLate = "ticks-late", Host;
    /// The wall clock is off by s days, of which nothing must be noticed.
    WallClockStep = "wall-clock-step", Host;
    /// The program that sends set-points is silent.
    SetpointsGone = "setpoints-gone", Host;
    /// Set-points are no numbers.
    SetpointsNotANumber = "setpoints-nan", Host;
}

impl FaultKind {
    /// Whether it makes the cameras tell a pose that is none of the car's.
    #[must_use]
    pub const fn falsifies_pose(self) -> bool {
        matches!(
            self,
            Self::CameraFrozen
                | Self::CameraJump
                | Self::CameraJumping
                | Self::CameraSwapped
                | Self::CameraRenamed
                | Self::CameraFlip
        )
    }

    /// What it has in common with others, of which only one can be in force.
    #[must_use]
    pub const fn subject(self) -> Self {
        match self {
            Self::ImuStuck | Self::ImuBiased | Self::ImuSaturated | Self::ImuErratic => {
                Self::ImuSilent
            }
            Self::PulsesDoubled | Self::PulsesHalved | Self::PulsesErratic => Self::PulsesGone,
            kind => kind,
        }
    }

    /// Whether the host's threads run later or not at all.
    #[must_use]
    pub const fn delays_host(self) -> bool {
        matches!(
            self,
            Self::DaemonPaused | Self::DaemonKilled | Self::TicksLate
        )
    }

    /// Whether it happens in a moment.
    #[must_use]
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
