//! Positions and velocities on the floor, and the gains between them.

use singletrack_control::{Position, Velocity};

use super::{
    declare::{fields, message},
    field::{InvalidMessage, Represents},
};

message! {
    /// A position on the floor, world frame.
    PointMessage as "Point" {
        x_m: f64,
        y_m: f64,
    }
}

message! {
    /// A velocity on the floor, world frame.
    VelocityMessage as "Velocity" {
        x_m_s: f64,
        y_m_s: f64,
    }
}

impl Represents<Position> for PointMessage {
    fn of(position: &Position) -> Self {
        Self {
            x_m: position.x,
            y_m: position.y,
        }
    }

    fn value(self) -> Result<Position, InvalidMessage> {
        Ok(Position::new(self.x_m, self.y_m))
    }
}

impl Represents<Velocity> for VelocityMessage {
    fn of(velocity: &Velocity) -> Self {
        Self {
            x_m_s: velocity.x,
            y_m_s: velocity.y,
        }
    }

    fn value(self) -> Result<Velocity, InvalidMessage> {
        Ok(Velocity::new(self.x_m_s, self.y_m_s))
    }
}

message! {
    /// Gains of the position loop, world frame.
    GainMessage as "Gain" {
        x_per_s: f64,
        y_per_s: f64,
    }
}

impl Represents<Velocity> for GainMessage {
    fn of(gain: &Velocity) -> Self {
        Self {
            x_per_s: gain.x,
            y_per_s: gain.y,
        }
    }

    fn value(self) -> Result<Velocity, InvalidMessage> {
        Ok(Velocity::new(self.x_per_s, self.y_per_s))
    }
}
