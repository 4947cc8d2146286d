//! `[compensation]`: what the controller corrects of clocks and actuators.

use singletrack_control::VehicleParameters;
use singletrack_pilot::Compensation;
use singletrack_settings::section;

use super::ActuatorsSection;

section! {
    /// What the controller corrects of the board's clock and of the actuators, with the
    /// values of `[actuators]`. Nothing that stops the car rests on it.
    "compensation" => pub CompensationSection: Copy;
    [default];

    /// Commands speeds in the time of the board's clock, whose rate the link measures.
    clock: bool = true;
    /// Predicts the car to the moment at which a command acts, and leads speed and steering
    /// by the lags of motor and servo.
    actuation: bool = true;
}

impl CompensationSection {
    /// For the controller of this vehicle with these actuators.
    pub(super) fn config(
        &self,
        actuators: &ActuatorsSection,
        vehicle: &VehicleParameters,
    ) -> Compensation {
        Compensation {
            clock: self.clock,
            actuation: self.actuation.then(|| actuators.model()),
            vehicle: *vehicle,
        }
    }
}
