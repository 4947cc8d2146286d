//! What a tick commands: reference, outer loop, safety filter, law and limits.

use libm::{cos, fabs, rint};
use singletrack_control::{
    Actuation, Ahead, Demand, Estimate, Governor, OuterLoop, ReferencePoint, Singularity, Time,
    TrackingInput, Velocity, front_point_velocity,
};

use super::{
    DriveCommand, Output, Pilot,
    compensation::{Course, PathAhead},
    safety::LawStep,
    sense::Sensed,
};
use crate::{
    learned::Learning,
    supervisor::{Mode, Reason},
    watch::FIRST_METRE,
};

/// A slower car learns nothing, m/s.
const LEARNS_ABOVE: f64 = 0.25;

impl Pilot {
    /// The command of the mode with what led there, and why there is none if the law is singular.
    pub(super) fn act(&mut self, sensed: &Sensed) -> (Output, Option<Reason>) {
        let mut output = Output {
            actuation: self.law.actuation(),
            filtered_ticks: self.safety.ticks,
            ..Output::neutral(self.supervisor.mode())
        };
        let Some(estimate) = &sensed.estimate else {
            return (output, None);
        };
        self.learn(sensed, estimate);
        let learned = self.learning.map(|learning| learning.in_force);
        let estimate = &learned.map_or(*estimate, |it| it.corrected(estimate));
        let law = self.law.law();
        output.point = Some(law.point(estimate.position, estimate.yaw, self.wheels()));
        // A sideslip that the car can't have is not acted on.
        let believed = Estimate {
            sideslip: if self.watches.drive.slide.is_beyond {
                0.0
            } else {
                estimate.sideslip
            },
            ..*estimate
        };
        let singular = match self.supervisor.mode() {
            Mode::Driving if self.drive_start.is_none() => {
                output.command = Some(command(&believed, &output.actuation, false));
                None
            }
            Mode::Driving => self.drive(sensed.now, &believed, &mut output).err(),
            Mode::Slowing | Mode::Stopping => {
                self.slow_down(sensed, &believed, &mut output);
                None
            }
            Mode::Disconnected
            | Mode::Idle
            | Mode::Ready
            | Mode::Arming
            | Mode::Fault
            | Mode::Jogging => None,
        };
        if let (Some(learned), Some(command)) = (learned, &mut output.command) {
            // Within the limits of the configured steering; what the law itself has limited is not
            // limited by its rounding again.
            let limits = &self.config.limits;
            let (last, most) = (self.commanded_steering, limits.max_steering);
            let change = (1.0 + 1e-9) * limits.max_steering_rate * self.config.period;
            command.steering = learned
                .command(command.steering)
                .clamp(last - change, last + change)
                .clamp(-most, most);
        }
        (output, singular)
    }

    /// What is learned moves on, in a drive in which nothing is doubted: the first metre proves
    /// the configured car.
    fn learn(&mut self, sensed: &Sensed, estimate: &Estimate) {
        let doubt = self.supervisor.mode() != Mode::Driving
            || estimate.speed < LEARNS_ABOVE
            || estimate.pose_age() > self.config.supervisor.fresh
            || self.law.is_turning_round()
            || self.watches.doubts_motion(sensed.now);
        if let Some(learning) = &mut self.learning
            && !doubt
        {
            learning.advance(sensed.now, self.config.period);
        }
    }

    /// A drive begins.
    pub(super) fn begin_drive(&mut self, sensed: &Sensed) {
        self.law.reset();
        self.tracking.reset();
        self.applied = Velocity::zeros();
        if let Some(governor) = &mut self.governor {
            governor.reset();
        }
        if let Some(compensator) = &mut self.compensator {
            compensator.begin(self.law.actuation().steering);
        }
        self.safety.begin(self.commanded_steering);
        self.obstacles.begin();
        self.waited = 0.0;
        // It begins as the configured car.
        self.learning = self.config.learns.then(Learning::default);
        let unproved = self.config.supervisor.prove && !self.proved;
        self.watches.begin(unproved);
        if let Some(estimate) = &sensed.estimate {
            let (yaw, law) = (estimate.yaw, self.law.law());
            let point = law.point(estimate.position, yaw, self.wheels());
            self.config.reference.begin(self.config.start, &point, yaw);
        }
    }

    /// A tick in [`Mode::Slowing`] or [`Mode::Stopping`].
    fn slow_down(&mut self, sensed: &Sensed, estimate: &Estimate, output: &mut Output) {
        let (now, period) = (sensed.now, self.config.period);
        // Ticks that are late or left out must not make the stop longer.
        let elapsed = sensed
            .last_tick
            .map_or(period, |last| now.seconds_since(last));
        let periods = rint(elapsed / period).max(1.0);
        let actuation = self
            .law
            .slow_down(self.config.stop_deceleration, periods * period);
        // P leaves its reference here; a drive that goes on begins to follow it again.
        self.tracking.reset();
        self.applied = self.given_by(estimate, &actuation);
        output.drive_time = self.drive_start.map(|start| now.seconds_since(start));
        output.actuation = actuation;
        output.command = Some(command(estimate, &actuation, true));
    }

    /// A tick in [`Mode::Driving`]: reference, position loop and law, or the actuation that a
    /// controller outside demands. Fails where the law is singular.
    fn drive(&mut self, now: Time, estimate: &Estimate, output: &mut Output) -> Result<(), Reason> {
        let elapsed = self
            .drive_start
            .map_or(0.0, |start| now.seconds_since(start));
        let time = elapsed - self.waited;
        self.delay = 0.0;
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
        match demand {
            _ if self.watches.drive.slide.is_beyond => {
                self.tracking.reset();
                Ok(self.law.actuation())
            }
            Demand::Point(reference) => {
                output.reference = Some(reference);
                self.follow(now, time, &reference, estimate, output)
            }
            Demand::Actuation { steering, speed } => {
                self.tracking.reset();
                self.step_demand(estimate, steering, speed.of_centre(estimate.sideslip))
            }
        }
        .map_err(|_| self.watches.across().unwrap_or(Reason::LawSingular))?;
        // Without a fresh pose the car must not accelerate.
        if estimate.pose_age() > self.config.supervisor.fresh {
            self.law.cap_speed(fabs(before));
        }
        let (coast, wave) = self.prove(now, estimate, output);
        self.wait_for_proof(estimate, output, coast);
        self.waited += self.config.period * self.delay;
        let actuation = self.law.actuation();
        self.applied = match output.reference {
            Some(_) => self.law.point_velocity(),
            None => self.given_by(estimate, &actuation),
        };
        if let Some(compensator) = &mut self.compensator {
            compensator.sent = actuation.speed;
        }
        output.drive_time = Some(elapsed);
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
    fn given_by(&self, estimate: &Estimate, actuation: &Actuation) -> Velocity {
        front_point_velocity(
            self.law.law(),
            &estimate.motion(),
            self.wheels(),
            actuation.speed,
            actuation.steering_rate,
        )
    }

    /// The angle of the front wheels, as far as is known, in rad.
    fn wheels(&self) -> f64 {
        let commanded = self.law.actuation().steering;
        self.compensator
            .as_ref()
            .filter(|_| self.watches.proving.is_none())
            .map_or(commanded, |it| it.predictor.wheels())
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
        let (law, period) = (*self.law.law(), config.period);
        let (tracking, imagined) = (&mut self.tracking, &mut self.imagined);
        let applied = self.applied;
        // What the first metre proves does not rest on a model; and the law would take the wave
        // of its steering for its own.
        let proves = self.watches.proving.is_some();
        let (motion, wheels, point, velocity, lead) = match &mut self.compensator {
            Some(compensator) if !proves => {
                let course = Course {
                    law: &law,
                    path,
                    limits: &config.limits,
                    period,
                };
                let (state, velocity, lead) =
                    compensator.look_ahead(estimate, &course, [tracking, imagined], applied)?;
                output.looked_ahead = Some(state.ahead);
                let point = law.point(state.position, state.motion.yaw, state.wheels);
                (state.motion, state.wheels, point, velocity, Some(lead))
            }
            _ => {
                let wheels = self.law.actuation().steering;
                let point = law.point(estimate.position, estimate.yaw, wheels);
                let velocity = tracking.step(&TrackingInput {
                    point,
                    reference: &|ahead| path.at(ahead).unwrap_or(*reference),
                    applied,
                    period,
                });
                (estimate.motion(), wheels, point, velocity, None)
            }
        };
        let step = LawStep {
            motion,
            wheels,
            ahead: Ahead {
                overtaken: reference.overtaken_by(&point),
                lead,
            },
        };
        self.step_law(estimate, &step, &velocity, output)
    }

    /// Lets the reference be no faster than the car may be until everything has been proved.
    fn wait_for_proof(&mut self, estimate: &Estimate, output: &Output, coast: bool) {
        let path = output.reference.filter(|it| it.position.is_some());
        if let (Some(reference), true) = (path, self.watches.proving.is_some()) {
            let speed = if coast {
                fabs(estimate.speed)
            } else {
                FIRST_METRE.speed
            };
            let share = speed / reference.velocity.norm();
            // NaN, where both stand, delays nothing.
            self.delay = self.delay.max(1.0 - share.min(1.0));
        }
    }

    /// A tick of the proving run: limits the speed, and returns whether the car is to roll at
    /// neutral and what to add to the steering. Without one, nothing changes.
    fn prove(&mut self, now: Time, estimate: &Estimate, output: &mut Output) -> (bool, f64) {
        let watches = &mut self.watches;
        let Some(proving) = &mut watches.proving else {
            return (false, 0.0);
        };
        let start_judged = watches.drive.start.is_judged;
        let tick = proving.tick(now, estimate.speed, self.config.braking, start_judged);
        if tick.coast {
            // The drive goes on from the speed to which the car has rolled.
            self.law.cap_speed(fabs(estimate.speed));
        }
        self.law.cap_speed(FIRST_METRE.speed);
        if let Some(measured) = tick.coasted {
            watches.stops.coasted(measured);
            output.braking_measured = Some(measured);
        }
        if tick.passed {
            self.proved = true;
            watches.proving = None;
            output.proved = true;
        }
        (tick.coast, tick.steering)
    }
}

/// The command for the board. The motor drives the rear axle, whose speed is the forward
/// component of G's: v cos β.
fn command(estimate: &Estimate, actuation: &Actuation, brake: bool) -> DriveCommand {
    DriveCommand {
        rear_speed: actuation.speed * cos(estimate.sideslip),
        steering: actuation.steering,
        pose_time: estimate.pose_time,
        brake,
    }
}
