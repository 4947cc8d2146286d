//! Positions and velocities on the floor, and the gains between them.

use singletrack_control::{Position, Velocity};

use super::{
    declare::{fields, message},
    field::{InvalidMessage, Represents},
};

/// Declares a message that has the two parts of a vector.
macro_rules! vector {
    (
        $(#[doc = $about:literal])*
        $type:ident as $name:literal of $vector:ident { $x:ident, $y:ident }
    ) => {
        message! { $(#[doc = $about])* $type as $name { $x: f64, $y: f64, } }

        impl Represents<$vector> for $type {
            fn of(vector: &$vector) -> Self {
                Self { $x: vector.x, $y: vector.y }
            }

            fn value(self) -> Result<$vector, InvalidMessage> {
                Ok($vector::new(self.$x, self.$y))
            }
        }
    };
}

vector! {
    /// A position on the floor, world frame.
    PointMessage as "Point" of Position { x_m, y_m }
}

vector! {
    /// A velocity on the floor, world frame.
    VelocityMessage as "Velocity" of Velocity { x_m_s, y_m_s }
}

vector! {
    /// Gains of the position loop, world frame.
    GainMessage as "Gain" of Velocity { x_per_s, y_per_s }
}
