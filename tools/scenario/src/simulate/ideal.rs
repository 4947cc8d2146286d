//! Outer loop and law on the paper's model: no estimator, supervisor, limits,
//! lag or noise.

use singletrack_control::{
    FrontPointLaw, Motion, OuterLoop as _, Position, Reference, ReferencePoint, SingleTrack,
    SingleTrackState, Singularity, TrackingInput, TrackingLoop, Velocity, VelocityPointLaw,
    direction, front_point, velocity_point,
};
use singletrack_core::config::LawKind;
use singletrack_sim::integrator::Integrator;

use super::{
    SimulateError,
    scenario::{Scenario, ScenarioError, SteeringHold},
    summary::{Row, row_time},
};

/// x, y, yaw, yaw rate, sideslip, steering.
type Vector = [f64; 6];

/// Runs a scenario on the ideal plant.
///
/// # Errors
///
/// The scenario can't be run, or meets a singularity; the error has its time.
pub(super) fn simulate(scenario: &Scenario) -> Result<Vec<Row>, SimulateError> {
    let simulation = Simulation::new(scenario)?;
    if scenario.control.period_ms == 0 {
        simulation.continuous()
    } else {
        simulation.sampled()
    }
}

/// Either law, with commands of one type.
enum Law {
    FrontPoint(FrontPointLaw),
    VelocityPoint(VelocityPointLaw),
}

/// The command of a law: speed, and steering rate or angle; with an angle the rate is 0.
#[derive(Clone, Copy)]
struct Command {
    speed: f64,
    rate: f64,
    angle: Option<f64>,
}

impl Law {
    /// P as the controller computes it.
    fn point(&self, state: &SingleTrackState, steering: f64) -> Position {
        let centre = Position::new(state.x, state.y);
        match self {
            Self::FrontPoint(law) => law.point(centre, state.yaw, steering),
            Self::VelocityPoint(law) => law.point(centre, state.yaw, state.sideslip),
        }
    }

    fn command(
        &self,
        state: &SingleTrackState,
        steering: f64,
        velocity: &Velocity,
    ) -> Result<Command, Singularity> {
        let motion = Motion {
            yaw: state.yaw,
            yaw_rate: state.yaw_rate,
            sideslip: state.sideslip,
        };
        Ok(match self {
            Self::FrontPoint(law) => {
                let command = law.command(&motion, steering, velocity)?;
                Command {
                    speed: command.speed,
                    rate: command.steering_rate,
                    angle: None,
                }
            }
            Self::VelocityPoint(law) => {
                let command = law.command(&motion, velocity)?;
                Command {
                    speed: command.speed,
                    rate: 0.0,
                    angle: Some(command.steering),
                }
            }
        })
    }
}

struct Simulation<'a> {
    scenario: &'a Scenario,
    model: SingleTrack,
    law: Law,
    tracking: TrackingLoop,
    reference: Reference,
    start: Position,
    initial: Vector,
}

impl<'a> Simulation<'a> {
    fn new(scenario: &'a Scenario) -> Result<Self, ScenarioError> {
        let model = SingleTrack::new(scenario.vehicle);
        let p = scenario.law.point_distance_m;
        let [x, y] = scenario.start.point_p_m;
        let start = Position::new(x, y);
        let yaw = scenario.start.yaw_deg.to_radians();
        let believed = scenario.believed_vehicle.as_ref();
        let believed = believed.unwrap_or(&scenario.vehicle);
        let (law, centre) = match scenario.law.kind {
            LawKind::FrontPoint => (
                Law::FrontPoint(scenario.law.front_point_law(&scenario.vehicle)?),
                start - (scenario.vehicle.front_axle_distance_m + p) * direction(yaw),
            ),
            LawKind::VelocityPoint => (
                Law::VelocityPoint(scenario.law.velocity_point_law(believed)?),
                start - p * direction(yaw),
            ),
        };
        let mut reference = scenario.reference()?;
        reference.begin(scenario.reference.start(), &start, yaw);
        Ok(Self {
            scenario,
            model,
            law,
            tracking: scenario.tracking_loop()?,
            reference,
            start,
            initial: [centre.x, centre.y, yaw, 0.0, 0.0, 0.0],
        })
    }

    /// The law evaluated inside the right-hand side.
    fn continuous(&self) -> Result<Vec<Row>, SimulateError> {
        let mut rows = Vec::new();
        let mut vector = self.initial;
        let mut integrator = Integrator::new();
        let mut time = 0.0;
        for index in 0..=self.scenario.run.last_row() {
            let end = row_time(index);
            while time < end {
                let switch = self.reference.next_switch(time);
                let stop = switch.map_or(end, |switch| switch.min(end));
                let begin = time;
                integrator.advance(&mut vector, begin, stop, |t, vector| {
                    // The step ends where the reference switches: its stages must use
                    // the reference before that.
                    let reference = match t > begin {
                        true => self.reference.before(t),
                        false => self.reference.at(t),
                    };
                    let reference = self.placed(t, reference);
                    let (_, command) = self.decide(t, vector, &reference)?;
                    Ok::<_, SimulateError>(self.slope(vector, &command))
                })?;
                time = stop;
            }
            let (velocity, command) = self.decide(end, &vector, &self.reference_at(end))?;
            vector[5] = command.angle.unwrap_or(vector[5]);
            rows.push(self.row(end, &vector, command.speed, command.rate, &velocity));
        }
        Ok(rows)
    }

    /// The law evaluated at ticks, acting after a delay.
    fn sampled(&self) -> Result<Vec<Row>, SimulateError> {
        let control = &self.scenario.control;
        let period = f64::from(control.period_ms) / 1000.0;
        let tick_time = |tick: u64| (tick * u64::from(control.period_ms)) as f64 / 1000.0;
        let delay = usize::try_from(control.delay_ticks).unwrap_or(usize::MAX);

        let mut rows = Vec::new();
        let mut vector = self.initial;
        let mut integrator = Integrator::new();
        let mut next_row = 0;
        let mut measured = split(&vector).0;
        let mut waiting = std::collections::VecDeque::with_capacity(delay + 1);
        // Speed and steering rate that act on the plant.
        let (mut speed, mut acting_rate) = (0.0, 0.0);
        let mut tracking = self.tracking.clone();
        let mut applied = Velocity::zeros();

        for tick in 0.. {
            let (begin, end) = (tick_time(tick), tick_time(tick + 1));
            let (state, steering) = split(&vector);
            measured = if self.scenario.is_lost(tick) {
                SingleTrackState {
                    x: measured.x,
                    y: measured.y,
                    yaw: measured.yaw,
                    ..state
                }
            } else {
                state
            };
            let at = |source| SimulateError::Law {
                time: begin,
                source,
            };
            // Nothing limits the ideal car: P is given what was wanted.
            applied = tracking.step(&TrackingInput {
                point: self.law.point(&measured, steering),
                reference: &|ahead| self.reference_at(begin + ahead),
                applied,
                period,
            });
            let velocity = applied;
            let command = self.law.command(&measured, steering, &velocity);
            let command = command.map_err(at)?;
            if tick == 0 {
                speed = command.speed;
            }
            waiting.push_back(command);
            if waiting.len() > delay
                && let Some(command) = waiting.pop_front()
            {
                speed = command.speed;
                let turned = command.angle.map(|angle| (angle - steering) / period);
                acting_rate = turned.unwrap_or(command.rate);
            }

            // Rows at this tick show the steering before it jumps.
            let last = self.scenario.run.last_row();
            if next_row <= last && row_time(next_row) <= begin {
                rows.push(self.row(begin, &vector, speed, acting_rate, &velocity));
                next_row += 1;
            }
            if next_row > last {
                break;
            }
            let rate = match control.steering {
                SteeringHold::Ramp => acting_rate,
                SteeringHold::Step => {
                    vector[5] += period * acting_rate;
                    0.0
                }
            };
            let command = Command {
                speed,
                rate,
                angle: None,
            };
            let mut time = begin;
            while time < end {
                let row_due = row_time(next_row);
                let stop = if next_row <= last {
                    row_due.min(end)
                } else {
                    end
                };
                integrator.advance(&mut vector, time, stop, |_, vector| {
                    Ok::<_, SimulateError>(self.slope(vector, &command))
                })?;
                time = stop;
                if next_row <= last && row_due < end && time >= row_due {
                    rows.push(self.row(time, &vector, speed, acting_rate, &velocity));
                    next_row += 1;
                }
            }
        }
        Ok(rows)
    }

    /// The controller's command at the true state.
    fn decide(
        &self,
        time: f64,
        vector: &Vector,
        reference: &ReferencePoint,
    ) -> Result<(Velocity, Command), SimulateError> {
        let (state, steering) = split(vector);
        let velocity = self
            .tracking
            .velocity(reference, &self.law.point(&state, steering))
            // A loop with a state is refused where there are no ticks.
            .unwrap_or(reference.velocity);
        let command = self.law.command(&state, steering, &velocity);
        let command = command.map_err(|source| SimulateError::Law { time, source });
        Ok((velocity, command?))
    }

    /// The paper's model under a command.
    fn slope(&self, vector: &Vector, command: &Command) -> Vector {
        let (state, steering) = split(vector);
        let steering = command.angle.unwrap_or(steering);
        let it = self.model.derivative(&state, command.speed, steering);
        [it.x, it.y, it.yaw, it.yaw_rate, it.sideslip, command.rate]
    }

    fn row(
        &self,
        time: f64,
        vector: &Vector,
        speed: f64,
        steering_rate: f64,
        velocity: &Velocity,
    ) -> Row {
        let (state, steering) = split(vector);
        let centre = Position::new(state.x, state.y);
        let front = self.scenario.vehicle.front_axle_distance_m;
        let p = self.scenario.law.point_distance_m;
        let point = match self.law {
            Law::FrontPoint(_) => front_point(centre, state.yaw, steering, front, p),
            Law::VelocityPoint(_) => velocity_point(centre, state.yaw, state.sideslip, p),
        };
        let reference = self.reference_at(time).position.unwrap_or(self.start);
        Row {
            t: time,
            yaw: state.yaw,
            yaw_rate: state.yaw_rate,
            sideslip: state.sideslip,
            steering,
            x_g: state.x,
            y_g: state.y,
            speed,
            steering_rate,
            x_p: point.x,
            y_p: point.y,
            x_ref: reference.x,
            y_ref: reference.y,
            v_px: velocity.x,
            v_py: velocity.y,
            path_s: time,
        }
    }

    fn reference_at(&self, time: f64) -> ReferencePoint {
        self.placed(time, self.reference.at(time))
    }

    /// Velocity steps get the position of an ideal integrator that starts with P.
    fn placed(&self, time: f64, reference: ReferencePoint) -> ReferencePoint {
        match &self.reference {
            Reference::VelocitySteps(steps) => ReferencePoint {
                position: Some(steps.integrate(self.start, time)),
                ..reference
            },
            _ => reference,
        }
    }
}

fn split(vector: &Vector) -> (SingleTrackState, f64) {
    let [x, y, yaw, yaw_rate, sideslip, steering] = *vector;
    let state = SingleTrackState {
        x,
        y,
        yaw,
        yaw_rate,
        sideslip,
    };
    (state, steering)
}
