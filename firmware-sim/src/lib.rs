//! Simulator of board, car and cameras.
//!
//! [`World`] simulates everything except the host, in virtual time: the real board
//! code, the car, the serial line between board and host, and the cameras with
//! their NatNet server. The same seed and the same inputs at the same times give
//! the same bits, on every machine and in every build.
//!
//! ```
//! use singletrack_sim::{SimulationConfig, World};
//!
//! let mut world = World::new(SimulationConfig::default())?;
//! let mut bytes = Vec::new();
//! for tick in 1..=100 {
//!     world.advance_to(tick * 10_000);
//!     world.host_read(&mut bytes); // frames of singletrack-protocol
//!     while let Some(frame) = world.poll_camera_frame() {
//!         assert!(frame.sent_us <= world.now_us);
//!     }
//! }
//! assert!(!bytes.is_empty());
//! # Ok::<(), singletrack_sim::ConfigError>(())
//! ```
//!
//! [`RealTimeSimulator`] runs a world on its own thread, with a pseudo-terminal and
//! UDP sockets for a host in another process.

#[cfg(feature = "real-time")]
mod arguments;
mod board;
mod by_hand;
mod cameras;
mod car;
mod clock;
mod floor;
pub mod integrator;
mod natnet_server;
mod parameters;
#[cfg(feature = "real-time")]
mod ports;
mod pulses;
mod random;
mod ranges;
#[cfg(feature = "real-time")]
mod real_time;
mod scripted;
#[cfg(feature = "real-time")]
mod stream_servers;
mod truth;
mod wire;
mod world;

#[cfg(feature = "real-time")]
pub use arguments::Arguments;
#[cfg(feature = "real-time")]
pub use board::ImageSize;
pub use board::{
    BoardKind, BoardParameters, Installation, ReceivedMessage, SimulatedBoard, UnoError,
};
pub use by_hand::{HAND_COMMANDS, HandCommand, Seen, UnknownHandCommand};
pub use cameras::{
    CameraCounters, CameraFaults, CameraFrame, CameraParameters, Cameras, CarBody, DecoyBody,
    DecoyMotion, LossKind, LossPattern, LossPatternError, LossWindow, ServerKind, Sight,
    TICKS_PER_SECOND, parse_duration_us,
};
pub use car::{
    BatteryParameters, Car, CarParameters, EscKind, HandMotion, ImuFault, ImuParameters,
    MotorParameters, MotorPulses, MotorSensorFault, MotorSensorParameters, Push, ServoParameters,
    StartPose, Truth, WIDE_US, crooked_steering,
};
pub use clock::SkewedClock;
pub use floor::Floor;
pub use natnet_server::{
    Datagram, Destination, NatNetCounters, NatNetParameters, NatNetServer, parse_bitstream,
};
pub use parameters::{ConfigError, SimulationConfig, default_board_configuration};
#[cfg(feature = "real-time")]
pub use ports::{Pty, PtyError, UdpConfig, UdpError};
pub use pulses::{PulseFilter, PulseLog, PulseRecord, SERVO_FRAME_US};
#[cfg(feature = "real-time")]
pub use real_time::{
    Finished, RealTimeConfig, RealTimeCounters, RealTimeError, RealTimeSimulator, SharedFloor,
    TimedTruth,
};
pub use scripted::{ScriptedDrive, ScriptedHost};
pub use singletrack_mocap::UpAxis;
pub use singletrack_simavr::{BusFault, CYCLES_PER_US, Cost, Figures, Hang};
pub use truth::{CarTruth, SimulationFileError, TRUTH_KEYS, TruthKey};
pub use wire::{SerialWire, WireFaults, WireParameters};
pub use world::World;
