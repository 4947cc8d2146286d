//! The car: actuators, dynamics and sensors.

mod hands;
mod imu;
mod motor;
mod motor_sensor;
mod servo;
mod vehicle;

pub use hands::HandMotion;
pub use imu::{ImuFault, ImuParameters, ImuReading};
pub use motor::{BatteryParameters, EscKind, MotorParameters, Push};
pub use motor_sensor::{MotorPulses, MotorSensorFault, MotorSensorParameters};
pub use servo::{ServoParameters, WIDE_US, crooked_steering};
pub use vehicle::{Car, CarParameters, StartPose, Truth};

pub(crate) use imu::Imu;
