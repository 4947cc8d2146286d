//! A car that something else drives: what the pilot senses of it, and what would end a drive.

use singletrack_control::{Estimate, Estimator, PoseSample, PoseVerdict, Time};

use super::Pilot;
use crate::{event::Event, supervisor::Reason};

/// What something else commands a car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Commanded {
    /// Steering angle, rad; positive to the left.
    pub steering: f64,
    /// Speed of the rear axle, m/s; none if it is not known.
    pub speed: Option<f64>,
    /// Whether the car is driven. Where that begins, a drive begins.
    pub drives: bool,
}

/// What the pilot has seen of a car in a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observed {
    /// The estimated state.
    pub estimate: Option<Estimate>,
    /// What would end the drive; none if nothing would, or the car is not driven.
    pub stop: Option<Reason>,
}

impl Pilot {
    /// A tick of a car that something else drives, in place of [`Pilot::step`]: handles the events,
    /// and says what would end a drive. Nothing is commanded. `judged` is told of each pose, of
    /// the estimator's verdict, and of its normalised innovation squared before any weighting.
    ///
    /// What has no input is not judged: the board's status without one, and whatever belongs to
    /// commands that were not given, such as arming, the proving run and the stop.
    pub fn observe<'a>(
        &mut self,
        now: Time,
        events: impl IntoIterator<Item = &'a Event>,
        commanded: &Commanded,
        mut judged: impl FnMut(&PoseSample, PoseVerdict, f64),
    ) -> Observed {
        self.commanded_steering = commanded.steering;
        let foreign = (commanded.steering, commanded.speed.unwrap_or(0.0));
        let sensed = self.sense(now, events, Some(foreign), |pilot, event, verdict| {
            if let Event::Pose(pose) = event {
                judged(pose, verdict, pilot.estimator.innovation());
            }
        });
        if self.supervisor.observe(commanded.drives, now) {
            self.watches.begin(false);
            // A drive of ours is armed only where they are not too rare.
            self.watches.steps.begin(now);
            // Not so a drive of ours, which begins with a car at rest.
            if self.motor_speed.abs() >= self.config.supervisor.standing_speed {
                self.watches.drive.start.skip();
            }
        }
        let conditions = self.conditions(&sensed);
        Observed {
            estimate: sensed.estimate,
            stop: self.supervisor.observed(&conditions),
        }
    }

    /// A person says that the body which the cameras show is the car: see
    /// [`PilotRequest::Carried`](crate::PilotRequest::Carried).
    pub fn carried(&mut self) {
        if self.estimator.implausible_in_a_row() > 0 {
            self.estimator.reset();
        }
    }

    /// The estimator.
    #[must_use]
    pub const fn estimator(&self) -> &Estimator {
        &self.estimator
    }
}
