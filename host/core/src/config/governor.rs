//! `[governor]`: makes the reference slower or wider where the car cannot follow it.

use singletrack_control::{FrontPointLaw, GovernorConfig, Limits};

use super::section::section;

section! {
    /// Makes the reference slower or wider where the car cannot follow it, by the limits of
    /// `[limits]`, and slower where P is far behind. A reference that the car can follow is not
    /// changed.
    "governor" => pub GovernorSection: Copy;
    [default];

    /// Whether the reference may be changed so. Set-points from outside and velocity steps never
    /// are.
    enabled: bool = false;
    /// Distance of P behind its reference from which on the reference slows down. At twice the
    /// distance it waits.
    behind_m: f64 = 0.5, in 0.05..=10.0;
}

impl GovernorSection {
    pub(super) fn config(&self, law: FrontPointLaw, limits: Limits) -> Option<GovernorConfig> {
        self.enabled.then_some(GovernorConfig {
            law,
            limits,
            behind: self.behind_m,
        })
    }
}
