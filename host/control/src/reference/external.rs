//! Set-points from another program, with a deadman's switch.

use super::{ReferenceError, ReferencePoint, positive};
use crate::{Setpoint, Time, Velocity};

/// The newest set-point, valid until a time-out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct External {
    timeout: f64,
    newest: Option<Setpoint>,
}

impl External {
    /// Set-points that are valid for `timeout` seconds each.
    ///
    /// # Errors
    ///
    /// A time-out that is not finite and above zero.
    pub fn new(timeout: f64) -> Result<Self, ReferenceError> {
        Ok(Self {
            timeout: positive("setpoint_timeout", timeout)?,
            newest: None,
        })
    }

    /// Stores a set-point, unless it is not finite or older than the stored one.
    pub fn handle(&mut self, setpoint: &Setpoint) {
        let is_newer = self
            .newest
            .is_none_or(|newest| setpoint.time >= newest.time);
        if setpoint.is_finite() && is_newer {
            self.newest = Some(*setpoint);
        }
    }

    /// Whether the newest set-point is older than the time-out, or there is none.
    #[must_use]
    pub fn is_stale(&self, now: Time) -> bool {
        self.newest
            .is_none_or(|newest| now.seconds_since(newest.time) > self.timeout)
    }

    /// The newest set-point; standstill before the first.
    #[must_use]
    pub fn newest(&self) -> ReferencePoint {
        self.newest.map_or(
            ReferencePoint {
                position: None,
                velocity: Velocity::zeros(),
            },
            |newest| ReferencePoint {
                position: newest.position,
                velocity: newest.velocity,
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Position;

    fn setpoint(ms: u64, v_x: f64) -> Setpoint {
        Setpoint {
            time: Time(ms * 1_000_000),
            position: None,
            velocity: Velocity::new(v_x, 0.0),
        }
    }

    #[test]
    fn a_set_point_is_valid_until_the_time_out() {
        let mut external = External::new(0.2).unwrap();
        let at = |ms: u64| Time(ms * 1_000_000);
        assert!(external.is_stale(at(0)));
        assert_eq!(external.newest().velocity, Velocity::zeros());
        external.handle(&setpoint(1_000, 0.5));
        assert!(!external.is_stale(at(1_200)));
        assert!(external.is_stale(at(1_201)));
        assert_eq!(external.newest().velocity.x, 0.5);
    }

    #[test]
    fn an_older_or_non_finite_set_point_is_ignored() {
        let mut external = External::new(0.2).unwrap();
        external.handle(&setpoint(1_000, 0.5));
        external.handle(&setpoint(900, 0.1));
        external.handle(&setpoint(1_100, f64::NAN));
        external.handle(&Setpoint {
            position: Some(Position::new(0.0, f64::INFINITY)),
            ..setpoint(1_100, 0.1)
        });
        assert_eq!(external.newest().velocity.x, 0.5);
        external.handle(&setpoint(1_100, 0.2));
        assert_eq!(external.newest().velocity.x, 0.2);
        assert!(External::new(0.0).is_err() && External::new(f64::NAN).is_err());
    }
}
