//! The board and the car behind a pseudo-terminal, the cameras behind UDP.
//!
//! [`World`] is everything that is not the host, in virtual time: the real
//! board code, the car that it steers, the serial line between board and host,
//! and the cameras with their NatNet server. The same seed and the same inputs
//! at the same times give the same bits, on every machine and in every build.

mod attitude;
mod board;
mod cameras;
mod car;
mod clock;
mod firmware;
mod loss;
mod natnet_server;
mod parameters;
mod pulse_log;
mod random;
mod wire;
mod world;

pub use board::{BoardParameters, SERVO_FRAME_US, SimulatedBoard};
pub use cameras::{
    CameraCounters, CameraFaults, CameraFrame, CameraParameters, Cameras, CarBody, DecoyBody,
    LossKind, TICKS_PER_SECOND, UpAxis,
};
pub use car::{
    BatteryParameters, Car, CarParameters, ImuParameters, ImuReading, MotorParameters, MotorPulses,
    MotorSensorFault, MotorSensorParameters, ServoParameters, StartPose, Truth,
};
pub use clock::SkewedClock;
pub use loss::{LossPattern, LossPatternError, LossWindow, parse_duration_us};
pub use natnet_server::{
    Datagram, Destination, MULTICAST_GROUP, NatNetCounters, NatNetParameters, NatNetServer,
    parse_bitstream,
};
pub use parameters::{ConfigError, SimulationConfig};
pub use pulse_log::{PulseLog, PulseRecord};
pub use wire::{SerialWire, WireFaults, WireParameters};
pub use world::World;
