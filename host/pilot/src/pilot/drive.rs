//! A tick of a drive: reference, outer loop, law and limits.

use libm::{cos, fabs};
use singletrack_control::{
    Actuation, Ahead, Demand, Estimate, Governor, OuterLoop, Reference, ReferencePoint,
    Singularity, Time, TrackingInput, Velocity, front_point_velocity,
};

use super::{
    Compensator, DriveCommand, Output, PROVING_SPEED, Pilot, Reason, compensation::Course,
    safety::LawStep,
};

/// The reference from now on.
#[derive(Clone, Copy)]
pub(super) struct PathAhead<'a> {
    reference: &'a Reference,
    governor: Option<&'a Governor>,
    now: Time,
    /// Time since the start of the drive, s.
    time: f64,
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

impl Pilot {
    /// A tick in [`Mode::Driving`]: reference, position loop and law, or the actuation that a
    /// controller outside demands. Fails where the law is singular.
    pub(super) fn drive(
        &mut self,
        now: Time,
        estimate: &Estimate,
        output: &mut Output,
    ) -> Result<(), Reason> {
        let time = self
            .drive_start
            .map_or(0.0, |start| now.seconds_since(start));
        let before = self.law.actuation().speed;
        let wanted = &self.config.reference;
        output.path = Some(match (&mut self.governor, output.point) {
            (Some(governor), Some(point)) => governor.advance(time, wanted, &point),
            _ => time,
        });
        let governor = self.governor.as_ref();
        output.slowed_by = governor.and_then(Governor::slowed_by);
        let demand = match governor {
            Some(governor) => Demand::Point(governor.at(wanted, 0.0)),
            None => wanted.demand(now, time),
        };
        let actuation = match demand {
            _ if self.slide.is_beyond() => {
                self.tracking.reset();
                Ok(self.law.actuation())
            }
            Demand::Point(reference) => {
                output.reference = Some(reference);
                self.follow(now, time, &reference, estimate, output)
            }
            Demand::Actuation { steering, speed } => {
                self.tracking.reset();
                self.step_demand(estimate, steering, speed)
            }
        }
        .map_err(|_| match &self.proving {
            Some(proving) if proving.moves_across() => Reason::BodyYawWrong,
            _ => Reason::LawSingular,
        })?;
        // Without a fresh pose the car must not accelerate.
        let actuation = if estimate.pose_age() > self.config.supervisor.fresh {
            self.law.cap_speed(fabs(before));
            self.law.actuation()
        } else {
            actuation
        };
        let (actuation, coast, wave) = self.prove(now, estimate, actuation, output);
        self.applied = match output.reference {
            Some(_) => self.law.point_velocity(),
            None => self.given_by(estimate, &actuation),
        };
        if let Some(compensator) = &mut self.compensator {
            compensator.sent(actuation.speed);
        }
        output.drive_time = Some(time);
        output.actuation = actuation;
        output.turning_round = self.law.is_turning_round();
        (output.filtering, output.filtered_ticks) = (self.safety.filtering, self.safety.ticks);
        let mut command = command(estimate, &actuation, false);
        if coast {
            command.rear_speed = 0.0;
        }
        if wave != 0.0 {
            let most = self.config.limits.max_steering;
            command.steering = (command.steering + wave).clamp(-most, most);
        }
        output.command = Some(command);
        Ok(())
    }

    /// The velocity (m/s) that a command gives P which the law has not computed.
    pub(super) fn given_by(&self, estimate: &Estimate, actuation: &Actuation) -> Velocity {
        front_point_velocity(
            self.law.law(),
            &estimate.motion(),
            self.wheels(),
            actuation.speed,
            actuation.steering_rate,
        )
    }

    /// The angle of the front wheels, as far as is known, in rad.
    pub(super) fn wheels(&self) -> f64 {
        let commanded = self.law.actuation().steering;
        self.compensator
            .as_ref()
            .filter(|_| self.proving.is_none())
            .map_or(commanded, Compensator::wheels)
    }

    /// The actuation with which P follows its reference.
    fn follow(
        &mut self,
        now: Time,
        time: f64,
        reference: &ReferencePoint,
        estimate: &Estimate,
        output: &mut Output,
    ) -> Result<Actuation, Singularity> {
        let config = &self.config;
        let path = PathAhead {
            reference: &config.reference,
            governor: self.governor.as_ref(),
            now,
            time,
        };
        let (limits, period) = (&config.limits, config.period);
        let law = *self.law.law();
        // What the first metre proves does not rest on a model; and the law would take the wave
        // of its steering for its own.
        let compensator = self.compensator.as_mut();
        let Some(compensator) = compensator.filter(|_| self.proving.is_none()) else {
            let steering = self.law.actuation().steering;
            let point = law.point(estimate.position, estimate.yaw, steering);
            let velocity = self.tracking.step(&TrackingInput {
                point,
                reference: &|ahead| path.at(ahead).unwrap_or(*reference),
                applied: self.applied,
                period,
            });
            let ahead = Ahead {
                overtaken: reference.overtaken_by(&point),
                lead: None,
            };
            let step = LawStep {
                motion: estimate.motion(),
                wheels: steering,
                ahead,
            };
            return self.step_law(estimate, &step, &velocity, output);
        };
        let course = Course {
            law: &law,
            path,
            max_speed: limits.max_speed,
            max_steering_rate: limits.max_steering_rate,
            max_acceleration: limits.max_acceleration,
            now,
            period,
        };
        let (tracking, measured) = (&mut self.tracking, self.imu_time);
        let (state, velocity, lead) =
            compensator.look_ahead(estimate, measured, &course, tracking, self.applied)?;
        output.looked_ahead = Some(state.ahead);
        let point = law.point(state.position, state.motion.yaw, state.wheels);
        let ahead = Ahead {
            overtaken: reference.overtaken_by(&point),
            lead: Some(lead),
        };
        let step = LawStep {
            motion: state.motion,
            wheels: state.wheels,
            ahead,
        };
        self.step_law(estimate, &step, &velocity, output)
    }

    /// A tick of the proving run: limits the speed, and returns whether the car is to roll at
    /// neutral and what to add to the steering. Without one, nothing changes.
    fn prove(
        &mut self,
        now: Time,
        estimate: &Estimate,
        actuation: Actuation,
        output: &mut Output,
    ) -> (Actuation, bool, f64) {
        let Some(proving) = &mut self.proving else {
            return (actuation, false, 0.0);
        };
        let start_judged = self.start.is_judged();
        let tick = proving.tick(now, estimate.speed, self.config.braking, start_judged);
        if tick.coast {
            // The drive goes on from the speed to which the car has rolled.
            self.law.cap_speed(fabs(estimate.speed));
        }
        self.law.cap_speed(PROVING_SPEED);
        if let Some(measured) = tick.coasted {
            self.stops.coasted(measured);
            output.braking_measured = Some(measured);
        }
        if tick.passed {
            self.proved = true;
            self.proving = None;
            output.proved = true;
        }
        (self.law.actuation(), tick.coast, tick.steering)
    }
}

/// The command for the board. The motor drives the rear axle, whose speed is the forward
/// component of G's: v cos β.
pub(super) fn command(estimate: &Estimate, actuation: &Actuation, brake: bool) -> DriveCommand {
    DriveCommand {
        rear_speed: actuation.speed * cos(estimate.sideslip),
        steering: actuation.steering,
        pose_time: estimate.pose_time,
        brake,
    }
}
