//! Set-points from outside, under a deadman's switch.

use super::{ReferenceError, ReferencePoint, positive};
use crate::{Setpoint, Time, Velocity};

/// Whatever was last sent from outside, for as long as it is renewed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct External {
    timeout: f64,
    newest: Option<Setpoint>,
}

impl External {
    /// Set-points of which each is in force for `timeout` seconds at most.
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

    /// Takes note of a set-point; one that is no number or older than the one in
    /// force changes nothing.
    pub fn handle(&mut self, setpoint: &Setpoint) {
        let is_newer = self
            .newest
            .is_none_or(|newest| setpoint.time >= newest.time);
        if setpoint.is_finite() && is_newer {
            self.newest = Some(*setpoint);
        }
    }

    /// Whether nobody has sent one for too long.
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
    fn a_set_point_is_in_force_until_the_deadman_lets_go() {
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
    fn neither_an_old_one_nor_one_that_is_no_number_takes_its_place() {
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
