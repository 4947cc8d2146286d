//! `[limits]`: what the car may do.

use singletrack_control::Limits;
use singletrack_settings::{Maps as _, section};

section! {
    /// What the car may do.
    "limits" => pub LimitsSection: Copy;
    [maps Limits = Limits::paper()];

    /// Top speed forward.
    max_speed_m_s: f64 => max_speed, in up_to(20.0);
    /// Top speed in reverse, in which the law is unstable; 0 disables reverse.
    max_reverse_speed_m_s: f64 => max_reverse_speed, in 0.0..=20.0;
    /// Largest rate of change of the speed.
    max_acceleration_m_s2: f64 => max_acceleration, in up_to(50.0);
    /// Largest lateral acceleration, that of a steady bend with the tyres of `[vehicle]`. At
    /// most friction times gravity; beyond that the tyres slide.
    max_lateral_acceleration_m_s2: f64 => max_lateral_acceleration, in up_to(50.0);
    // The law is singular before 90 degrees.
    /// Largest steering angle to either side.
    max_steering_rad: f64 => max_steering, in up_to(1.2);
    /// Largest steering rate.
    max_steering_rate_rad_s: f64 => max_steering_rate, in up_to(50.0);
    /// Speed at which the car turns round when P should move backward. It brakes instead
    /// where P is ahead of a reference that moves forward and comes within a second.
    creep_speed_m_s: f64 => creep_speed, in up_to(max_speed_m_s);
    /// A wanted velocity below this is standstill.
    standstill_speed_m_s: f64 => standstill_speed, in up_to(max_speed_m_s);
}

impl LimitsSection {
    /// For the controller of a car with this wheelbase, in m.
    #[must_use]
    pub fn limits(&self, wheelbase: f64) -> Limits {
        self.apply_to(Limits {
            wheelbase,
            ..Limits::paper()
        })
    }
}
