//! The true car, where it differs from what the configuration says.

use core::ops::RangeInclusive;
use std::collections::BTreeMap;

macro_rules! deviations {
    ($($(#[$meaning:meta])* $kind:ident = $name:literal, $tolerable:expr, of $possible:expr;)*) => {
        /// A property of the true car; v is its value.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Deviation {
            $($(#[$meaning])* $kind,)*
        }

        impl Deviation {
            /// All properties.
            pub const ALL: &[Self] = &[$(Self::$kind,)*];

            /// The name in a schedule.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)*
                }
            }

            /// The values that a calibrated car may have, and must be able to drive with.
            #[must_use]
            pub const fn tolerable(self) -> RangeInclusive<i32> {
                match self {
                    $(Self::$kind => $tolerable,)*
                }
            }

            /// The values that a schedule may state.
            #[must_use]
            pub const fn possible(self) -> RangeInclusive<i32> {
                match self {
                    $(Self::$kind => $possible,)*
                }
            }
        }
    };
}

deviations! {
    /// The pulse for straight wheels is v µs longer.
    ServoTrim = "servo-trim-us", -20..=20, of -200..=200;
    /// The servo's gain is v/1000 higher; -2000 reverses it.
    ServoGain = "servo-gain-permille", -80..=80, of -3_000..=1_000;
    /// The servo turns at most v mrad/s.
    ServoRate = "servo-rate-mrad-s", 5_000..=12_000, of 200..=20_000;
    /// The distance per motor pulse is v/1000 larger.
    PulseDistance = "pulse-distance-permille", -40..=40, of -500..=1_000;
    /// The wheels settle at a speed v/1000 higher.
    MotorGain = "motor-gain-permille", -200..=200, of -500..=1_000;
    /// Constant deceleration of the rolling car, in mm/s².
    Rolling = "rolling-mm-s2", 300..=1_500, of 0..=5_000;
    /// Deceleration of the rolling car per speed, in 1/1000 s.
    Viscous = "viscous-permille", 0..=1_000, of 0..=5_000;
    /// The pulse at which the ESC is neutral is v µs longer.
    EscNeutral = "esc-neutral-us", -10..=10, of -200..=200;
    /// The half width of the ESC's deadband is v µs larger.
    EscDeadband = "esc-deadband-us", -8..=8, of -26..=100;
    /// Time without pulses after which the ESC releases the motor, in ms.
    SignalLoss = "esc-signal-loss-ms", 100..=1_000, of 20..=3_000;
    /// The axes of the rigid body are turned by v mrad.
    BodyYaw = "body-yaw-mrad", -20..=20, of -3_142..=3_142;
    /// The pivot of the rigid body is v mm farther forward.
    PivotForward = "pivot-forward-mm", -10..=10, of -500..=500;
    /// The pivot of the rigid body is v mm farther to the left.
    PivotLeft = "pivot-left-mm", -10..=10, of -500..=500;
    /// The battery has given v mAh.
    Drained = "drained-mah", 0..=800, of 0..=3_000;
}

impl Deviation {
    /// The property with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|kind| kind.name() == name)
    }
}

/// The true car. What is not stated is as the simulated car's default.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TrueCar(pub BTreeMap<Deviation, i32>);

impl TrueCar {
    /// The stated value.
    #[must_use]
    pub fn get(&self, deviation: Deviation) -> Option<i32> {
        self.0.get(&deviation).copied()
    }

    /// Whether a calibrated car may be so, which must drive.
    #[must_use]
    pub fn is_tolerable(&self) -> bool {
        let within = |(kind, value): (&Deviation, &i32)| kind.tolerable().contains(value);
        self.0.iter().all(within)
    }
}
