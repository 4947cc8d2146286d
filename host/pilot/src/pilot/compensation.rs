//! The compensation of the actuators: what is commanded is what is wanted when it acts.

use heapless::Deque;
use libm::fabs;
use singletrack_control::{
    ActuatorModel, Estimate, FrontPointCommand, FrontPointLaw, Governor, Lead, Limits, OuterLoop,
    Predicted, Predictor, Reference, ReferencePoint, Singularity, Time, TrackingInput,
    TrackingLoop, VehicleParameters, Velocity, front_point_velocity,
};

/// What the pilot compensates, and by which model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compensation {
    /// Commands the speed in the board's clock, whose rate the link measures.
    pub clock: bool,
    /// The model of the actuators; none to command as if they had neither dead time nor lag.
    pub actuation: Option<ActuatorModel>,
    /// The car as it is believed to be.
    pub vehicle: VehicleParameters,
}

/// Planned speeds kept: those of the longest dead time at the shortest period.
const PLANNED: usize = 128;

/// The longest dead time of the motor that is looked over, s.
const FARTHEST: f64 = 0.4;

/// Change of the commanded speed for each m/s of the speed's deviation.
const PROPORTIONAL: f64 = 0.5;

/// Change of the commanded speed for each m of the speed's deviation over time, over the time in
/// which the motor answers: the slower it is, the slower the deviation is taken away.
const INTEGRAL: f64 = 0.35;

/// The shortest of these times that counts, s.
const QUICKEST: f64 = 0.1;

/// The largest deviation of the speed that is integrated, m/s: a car that has yet to speed up
/// is no deviation.
const DEVIATION: f64 = 0.15;

/// A speed that was sent counts as limited if it differs by this from what was asked for, m/s.
const LIMITED: f64 = 0.005;

/// The most by which the deviation changes the command: this, and this part of the speed.
const MOST: f64 = 0.05;
const MOST_PART: f64 = 0.25;

/// The state of the compensation.
#[derive(Clone, Debug)]
pub(super) struct Compensator {
    /// The front wheels and the motor by the model.
    pub(super) predictor: Predictor,
    /// The speeds planned, with the times at which the car should have them.
    planned: Deque<(Time, f64), PLANNED>,
    /// The one that is due, m/s.
    due: Option<f64>,
    integral: f64,
    /// The speed that was asked for in the last tick, and what the limits left of it, m/s.
    asked: f64,
    pub(super) sent: f64,
}

/// Where P should go, as the outer loop says.
pub(super) struct Course<'a> {
    pub(super) law: &'a FrontPointLaw,
    pub(super) path: PathAhead<'a>,
    pub(super) limits: &'a Limits,
    pub(super) period: f64,
}

impl Course<'_> {
    /// The wanted velocity of P in this state, and the law's command for it. `applied` is the
    /// velocity that P was given a period before.
    fn at(
        &self,
        state: &Predicted,
        tracking: &mut TrackingLoop,
        applied: Velocity,
    ) -> Result<(Velocity, FrontPointCommand), Singularity> {
        let reference = |later: f64| self.path.at(state.ahead + later);
        let present = reference(0.0).ok_or(Singularity::NotFinite)?;
        let point = self
            .law
            .point(state.position, state.motion.yaw, state.wheels);
        let wanted = tracking.step(&TrackingInput {
            point,
            reference: &|later| reference(later).unwrap_or(present),
            applied,
            period: self.period,
        });
        let pace = wanted.norm();
        let limited = if pace > self.limits.max_speed {
            wanted * (self.limits.max_speed / pace)
        } else {
            wanted
        };
        let command = self.law.command(&state.motion, state.wheels, &limited)?;
        Ok((wanted, command))
    }

    /// The state after a period with this command, and the velocity that P is given in it. `planned`
    /// is the speed (m/s) that was commanded before for this period.
    fn next(
        &self,
        state: &Predicted,
        command: &FrontPointCommand,
        planned: Option<f64>,
    ) -> (Predicted, Velocity) {
        let most = self.limits.max_steering_rate;
        let rate = command.steering_rate.clamp(-most, most);
        let change = self.limits.max_acceleration * self.period;
        let speed = planned.unwrap_or_else(|| {
            let wanted = command.speed;
            wanted.clamp(state.speed - change, state.speed + change)
        });
        let applied = front_point_velocity(self.law, &state.motion, state.wheels, speed, rate);
        (state.after(self.period, rate, speed), applied)
    }
}

impl Compensator {
    /// None if the actuators are not compensated.
    pub(super) fn of(config: &Compensation) -> Option<Self> {
        let model = config.actuation?;
        Some(Self {
            predictor: Predictor::new(model, &config.vehicle),
            planned: Deque::new(),
            due: None,
            integral: 0.0,
            asked: 0.0,
            sent: 0.0,
        })
    }

    /// A drive begins, with the wheels at `steering` (rad).
    pub(super) fn begin(&mut self, steering: f64) {
        self.predictor.reset(steering);
        self.planned.clear();
        self.due = None;
        self.integral = 0.0;
        (self.asked, self.sent) = (0.0, 0.0);
    }

    /// The state at which the command acts, the wanted velocity of P there, and the lead over
    /// the actuators. `imagined` is for the loop's steps that are not commanded, and `applied` the
    /// velocity that P was given in the last tick.
    ///
    /// # Errors
    ///
    /// Where the law is singular.
    pub(super) fn look_ahead(
        &mut self,
        estimate: &Estimate,
        course: &Course<'_>,
        [tracking, imagined]: [&mut TrackingLoop; 2],
        applied: Velocity,
    ) -> Result<(Predicted, Velocity, Lead), Singularity> {
        let state = self.predictor.predict(estimate);
        let model = *self.predictor.model();
        let far = model.speed_dead_time.min(FARTHEST);
        // A loop that plans goes on from what P is given. The motor has yet to act on the speeds of
        // its dead time, which what is wanted now does not change: the two differ by no more than the
        // speed can change in it.
        let plans = tracking.plans();
        let planned = |state: &Predicted| {
            let speed = self.planned_for(course.path.now.after(state.ahead), course.period)?;
            let limits = course.limits;
            let most = limits.max_speed.min(limits.speed_in_bend(state.wheels));
            plans.then_some(speed.clamp(-most, most))
        };
        let applied = match planned(&state) {
            None => applied,
            Some(speed) => {
                let (motion, wheels) = (&state.motion, state.wheels);
                let given = course.law.command(motion, wheels, &applied)?;
                let near = course.limits.max_acceleration * far;
                let speed = given.speed.clamp(speed - near, speed + near);
                front_point_velocity(course.law, motion, wheels, speed, given.steering_rate)
            }
        };
        let (wanted, first) = course.at(&state, tracking, applied)?;
        // The motor acts later than the wheels: the speed is the one that is wanted then. The
        // loop's steps until then are only imagined, so they are those of a copy.
        imagined.assign(tracking);
        let (mut later, mut command) = (state, first);
        while later.ahead + 0.5 * course.period < far {
            let (after, given) = course.next(&later, &command, planned(&later));
            later = after;
            command = course.at(&later, imagined, given)?.1;
        }
        let (after, given) = course.next(&later, &command, planned(&later));
        let (_, next) = course.at(&after, imagined, given)?;
        let most = course.limits.max_acceleration;
        let slope = ((next.speed - command.speed) / course.period).clamp(-most, most);
        let correction = self.correction(course, estimate.speed);
        self.plan(course.path.now.after(later.ahead), command.speed);
        let asked = command.speed + model.speed_lag * slope + correction;
        (self.asked, self.sent) = (asked, asked);
        let lead = Lead {
            wheels: state.wheels,
            steering: self.predictor.command_for(0.0, 1.0, course.period),
            speed: asked - first.speed,
        };
        Ok((state, wanted, lead))
    }

    /// The speed that was planned for this time, m/s, if any was in the last period.
    fn planned_for(&self, time: Time, period: f64) -> Option<f64> {
        let mut planned = self.planned.iter().rev();
        let close = time.after(0.5 * period);
        let (since, speed) = *planned.find(|(planned, _)| *planned <= close)?;
        (time.seconds_since(since) < 1.5 * period).then_some(speed)
    }

    /// What the deviation from the planned speed adds to the command, m/s.
    fn correction(&mut self, course: &Course<'_>, speed: f64) -> f64 {
        while let Some(&(time, planned)) = self.planned.front()
            && time <= course.path.now
        {
            self.due = Some(planned);
            self.planned.pop_front();
        }
        let Some(due) = self.due else { return 0.0 };
        let deviation = due - speed;
        let most = MOST + MOST_PART * fabs(due);
        // What a limit keeps the car from is no deviation either.
        let is_limited = (self.sent - self.asked) * deviation < -LIMITED * fabs(deviation);
        if fabs(deviation) < DEVIATION && !is_limited {
            let model = self.predictor.model();
            let answer = (model.speed_dead_time + model.speed_lag).max(QUICKEST);
            let change = INTEGRAL / answer * deviation * course.period;
            self.integral = (self.integral + change).clamp(-most, most);
        }
        let proportional = PROPORTIONAL * deviation.clamp(-DEVIATION, DEVIATION);
        (proportional + self.integral).clamp(-most, most)
    }

    fn plan(&mut self, time: Time, speed: f64) {
        if self.planned.is_full() {
            self.planned.pop_front();
        }
        // There is room: see above.
        let _ = self.planned.push_back((time, speed));
    }
}

/// The reference from now on.
#[derive(Clone, Copy)]
pub(super) struct PathAhead<'a> {
    pub(super) reference: &'a Reference,
    pub(super) governor: Option<&'a Governor>,
    pub(super) now: Time,
    /// Time since the start of the drive, s.
    pub(super) time: f64,
}

impl PathAhead<'_> {
    /// The point that is demanded `ahead` seconds from now; none where steering and speed are.
    pub(super) fn at(&self, ahead: f64) -> Option<ReferencePoint> {
        match self.governor {
            Some(governor) => Some(governor.at(self.reference, ahead)),
            None => self.reference.point_ahead(self.now, self.time, ahead),
        }
    }
}
