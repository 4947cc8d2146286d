//! The servo of the sampled loop: its delay, and the ages of what the host knows.

use singletrack_control::VehicleParameters;

use super::SamplingError;

/// How old, at the tick, the values are that the law takes for the present ones, in s.
///
/// On the car the yaw rate is that of the newest inertial sample: it waits for the board's
/// telemetry, passes the serial line, and waits for the tick. Yaw and the velocity of G are
/// predicted to the tick by the estimator; their angle is the sideslip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ages {
    /// Of the yaw rate.
    pub yaw_rate: f64,
    /// Of the sideslip.
    pub sideslip: f64,
}

impl Ages {
    pub(super) fn validate(&self, most: f64) -> Result<(), SamplingError> {
        for (name, age) in [
            ("the age of the yaw rate in s", self.yaw_rate),
            ("the age of the sideslip in s", self.sideslip),
        ] {
            let is_valid = (0.0..=most).contains(&age);
            SamplingError::unless(is_valid, name, age, "between 0 and 1000 control periods")?;
        }
        Ok(())
    }
}

/// A delay in whole ticks and the rest, in s.
#[derive(Clone, Copy)]
pub(super) struct Delay {
    pub(super) ticks: usize,
    pub(super) late: f64,
}

impl Delay {
    pub(super) fn new(delay: f64, period: f64) -> Self {
        let ticks = (delay / period + 1e-9) as usize;
        Self {
            ticks,
            late: (delay - ticks as f64 * period).max(0.0),
        }
    }
}

/// A steering servo: a dead time, then a lag of first order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Servo {
    /// Time constant of the lag, in s.
    pub lag: f64,
    /// From a command at the servo until the wheels begin to move, in s.
    pub dead_time: f64,
}

impl Servo {
    pub(super) fn validate(&self) -> Result<(), SamplingError> {
        let Self { lag, dead_time } = *self;
        let (is_valid, rule) = (lag.is_finite() && lag > 0.0, "finite and above zero");
        SamplingError::unless(is_valid, "the lag of the servo in s", lag, rule)?;
        let is_valid = dead_time.is_finite() && dead_time >= 0.0;
        let rule = "finite and not negative";
        SamplingError::unless(is_valid, "the dead time of the servo in s", dead_time, rule)
    }
}

/// A controller that evaluates the law at the predicted state: the one at which its command
/// will act, `delay + lag` after the tick.
///
/// It knows the commands that are under way and runs them through its models of the servo and
/// of the car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// The lag of the servo as modelled, in s.
    pub lag: f64,
    /// From a tick until its command moves the wheels, as modelled, in s: the delay of the
    /// loop and the dead time of the servo.
    pub delay: f64,
    /// The car as modelled.
    pub vehicle: VehicleParameters,
}

impl Prediction {
    pub(super) fn validate(&self) -> Result<(), SamplingError> {
        Servo {
            lag: self.lag,
            dead_time: self.delay,
        }
        .validate()
    }

    /// How far it looks ahead, in s.
    #[must_use]
    pub fn horizon(&self) -> f64 {
        self.delay + self.lag
    }
}
