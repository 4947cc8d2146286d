//! Laws of the literature, to compare with: pure pursuit, Stanley, and that of the paper's appendix.
//!
//! They drive the same car as the project's own: by steering and speed as a program outside
//! gives them to the pilot, whose supervisor, limits and board stand behind them. A set-point
//! acts in the tick after the one whose state it is computed from, so the state is predicted
//! by one tick. With the compensation it is predicted to the moment at which the command acts,
//! by the pilot's own predictor, and steering and speed lead their lags.

use std::collections::VecDeque;

use libm::{atan, atan2, cos, hypot, sin, tan};
use singletrack_control::{
    ActuatorModel, Estimate, Motion, Position, Predicted, Predictor, ProportionalLoop, Singularity,
    VehicleParameters, Velocity, VelocityPointLaw, wrap,
};

use super::{counted::POINT_DISTANCE_M, course::Table};

/// A law and its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Law {
    /// Coulter (1992): the rear axle on an arc to the point that is `time` times the speed
    /// ahead on the path.
    PurePursuit { time: f64 },
    /// Hoffmann et al. (2007), the kinematic law: the front wheels along the path, plus the
    /// angle atan(`gain` e / v) towards it.
    Stanley { gain: f64 },
    /// The appendix of the paper: P on the velocity of G, `gain` (1/s) times its distance from the
    /// reference, and the velocity of that.
    Appendix { gain: f64 },
}

/// A law on its way along a path.
#[derive(Clone, Debug)]
pub(super) struct Foreign<'a> {
    pub(super) law: Law,
    /// Speed per distance that the car is behind the reference, in 1/s.
    pub(super) catch_up: f64,
    /// What is believed of the car.
    pub(super) vehicle: VehicleParameters,
    pub(super) table: &'a Table,
    /// The place of the nearest point.
    pub(super) index: usize,
    /// None to command as if steering and motor answered at once.
    pub(super) compensation: Option<Ahead>,
}

/// The compensation of the actuators, as the pilot's own loops have it.
#[derive(Clone, Debug)]
pub(super) struct Ahead {
    /// Its dead time is that from the tick whose state is known: a set-point acts a tick later.
    predictor: Predictor,
    model: ActuatorModel,
    period: f64,
    /// The speeds planned, with the times (s) at which the car should have them.
    planned: VecDeque<(f64, f64)>,
    /// The one that is due, and what its deviations have added to the command, in m/s.
    due: Option<f64>,
    integral: f64,
}

/// What a tick knows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Known<'a> {
    pub(super) estimate: &'a Estimate,
    /// The steering that the tick commanded, in rad.
    pub(super) steering: f64,
    /// The speed of G that the tick commanded, in m/s.
    pub(super) speed: f64,
    /// In s since the start of the drive.
    pub(super) time: f64,
}

/// The largest change of speed that is led, in m/s².
const MOST_ACCELERATION: f64 = 2.0;
/// The largest deviation of the speed that is integrated, in m/s.
const DEVIATION_M_S: f64 = 0.15;
/// The largest steering rate that is led, in rad/s.
const MOST_RATE: f64 = 5.0;

impl Ahead {
    /// For a car whose control has this period, in s.
    pub(super) fn new(model: ActuatorModel, vehicle: &VehicleParameters, period: f64) -> Self {
        let from_tick = ActuatorModel {
            steering_dead_time: model.steering_dead_time + period,
            ..model
        };
        Self {
            predictor: Predictor::new(from_tick, vehicle),
            model,
            period,
            planned: VecDeque::new(),
            due: None,
            integral: 0.0,
        }
    }

    /// What the deviation from the planned speed adds to the command, as in the pilot, in m/s.
    fn correction(&mut self, known: &Known<'_>) -> f64 {
        while let Some(&(time, planned)) = self.planned.front()
            && time <= known.time
        {
            self.due = Some(planned);
            self.planned.pop_front();
        }
        let Some(due) = self.due else { return 0.0 };
        let deviation = due - known.estimate.speed;
        let most = 0.05 + 0.25 * due.abs();
        if deviation.abs() < DEVIATION_M_S {
            let answer = (self.model.speed_dead_time + self.model.speed_lag).max(0.1);
            let change = 0.35 / answer * deviation * self.period;
            self.integral = (self.integral + change).clamp(-most, most);
        }
        let proportional = 0.5 * deviation.clamp(-DEVIATION_M_S, DEVIATION_M_S);
        (proportional + self.integral).clamp(-most, most)
    }

    /// The state at which the next command begins to turn the wheels.
    fn predict(&mut self, known: &Known<'_>) -> Predicted {
        let estimate = known.estimate;
        // The command of this tick acts a period before the next one.
        let given = estimate.time.before(self.period);
        self.predictor.commanded(given, known.steering);
        self.predictor.advance(estimate.time, estimate.speed);
        self.predictor.predict(estimate)
    }
}

/// The least distance ahead of pure pursuit, in m.
const LEAST_AHEAD: f64 = 0.2;
/// Stanley's speed is no less in its formula, in m/s.
const LEAST_SPEED: f64 = 0.2;
/// The largest demands, in rad and m/s. The pilot limits both to less, and refuses what no car
/// can do.
const MOST_STEERING: f64 = 0.6;
const MOST_SPEED: f64 = 3.0;

impl Foreign<'_> {
    /// Steering (rad) and speed of G (m/s) for the tick after one that knows this.
    pub(super) fn answer(&mut self, known: &Known<'_>, period: f64) -> [f64; 2] {
        let Some(ahead) = &mut self.compensation else {
            return self.command(known.estimate, known.time + period, period);
        };
        let state = ahead.predict(known);
        let model = ahead.model;
        let correction = ahead.correction(known);
        let acts = known.time + state.ahead;
        let [first, speed] = self.wanted(state.position, &state.motion, state.speed, acts);
        let rate = ((first - state.wheels) / period).clamp(-MOST_RATE, MOST_RATE);
        let next = state.after(period, rate, speed);
        let [next, _] = self.wanted(next.position, &next.motion, next.speed, acts + period);
        let rate = ((next - first) / period).clamp(-MOST_RATE, MOST_RATE);
        let steering = first + model.steering_lag * rate;
        // The motor acts later than the wheels.
        let later = (model.speed_dead_time - model.steering_dead_time).max(0.0);
        let state = state.after(later, rate, speed);
        let [_, speed] = self.wanted(state.position, &state.motion, state.speed, acts + later);
        if let Some(ahead) = &mut self.compensation {
            ahead.planned.push_back((acts + later, speed));
        }
        let state = state.after(period, rate, speed);
        let acts = acts + later + period;
        let [_, next] = self.wanted(state.position, &state.motion, state.speed, acts);
        let slope = ((next - speed) / period).clamp(-MOST_ACCELERATION, MOST_ACCELERATION);
        let speed = speed + model.speed_lag * slope + correction;
        [
            steering.clamp(-MOST_STEERING, MOST_STEERING),
            speed.clamp(0.0, MOST_SPEED),
        ]
    }

    /// The command from a state that goes on for `ahead` seconds without a change, for `time` seconds
    /// after the start of the drive.
    pub(super) fn command(&mut self, estimate: &Estimate, time: f64, ahead: f64) -> [f64; 2] {
        let course = estimate.yaw + estimate.sideslip;
        let way = ahead * estimate.speed;
        let g = estimate.position;
        let g = Position::new(g.x + way * cos(course), g.y + way * sin(course));
        let motion = Motion {
            yaw: estimate.yaw + ahead * estimate.yaw_rate,
            ..estimate.motion()
        };
        self.wanted(g, &motion, estimate.speed, time)
    }

    /// The angle of the front wheels (rad) and the speed of G (m/s) by the law, for a car whose G is
    /// there and moves like this, with a speed in m/s.
    fn wanted(&mut self, g: Position, motion: &Motion, pace: f64, time: f64) -> [f64; 2] {
        let yaw = motion.yaw;
        let rear = self.vehicle.rear_axle_distance_m;
        let front = self.vehicle.front_axle_distance_m;
        let own = match self.law {
            Law::PurePursuit { .. } => -rear,
            Law::Stanley { .. } | Law::Appendix { .. } => front,
        };
        let point = [g.x + own * cos(yaw), g.y + own * sin(yaw)];
        self.index = self.table.nearest(point, self.index);
        let nearest = *self.table.get(self.index);
        let wanted = self.table.at(time);
        // Of the own point along the path.
        let behind = wanted.way - nearest.way;
        let speed = (wanted.speed + self.catch_up * behind).clamp(0.0, MOST_SPEED);
        let wheelbase = rear + front;
        let (steering, rear_speed) = match self.law {
            Law::PurePursuit { time } => {
                let ahead = LEAST_AHEAD.max(time * pace);
                let target = self.table.get(self.table.find(nearest.way + ahead));
                let [x, y] = [0, 1].map(|axis| target.position[axis] - point[axis]);
                let distance = hypot(x, y).max(0.5 * LEAST_AHEAD);
                let angle = wrap(atan2(y, x) - yaw);
                (atan(2.0 * wheelbase * sin(angle) / distance), speed)
            }
            Law::Stanley { gain } => {
                let [x, y] = [0, 1].map(|axis| point[axis] - nearest.position[axis]);
                let left = y * cos(nearest.heading) - x * sin(nearest.heading);
                let towards = atan(-gain * left / pace.max(LEAST_SPEED));
                let steering = wrap(nearest.heading - yaw) + towards;
                let steering = steering.clamp(-MOST_STEERING, MOST_STEERING);
                (steering, speed * cos(steering))
            }
            Law::Appendix { gain } => return self.appendix(&g, motion, time, gain),
        };
        let steering = steering.clamp(-MOST_STEERING, MOST_STEERING);
        let sideslip = atan(rear * tan(steering) / wheelbase);
        [steering, rear_speed / cos(sideslip)]
    }

    /// The command by the law of the appendix; straight on where it is singular, near standstill.
    fn appendix(&self, g: &Position, motion: &Motion, time: f64, gain: f64) -> [f64; 2] {
        let Ok(law) = VelocityPointLaw::new(self.vehicle, POINT_DISTANCE_M) else {
            return [0.0; 2];
        };
        let tracking = ProportionalLoop {
            gain: Velocity::new(gain, gain),
            feed_forward: true,
        };
        let point = law.point(*g, motion.yaw, motion.sideslip);
        let wanted = tracking.velocity(&self.table.reference.at(time), &point);
        match law.command(motion, &wanted) {
            Ok(command) => [
                command.steering.clamp(-MOST_STEERING, MOST_STEERING),
                command.speed.clamp(0.0, MOST_SPEED),
            ],
            Err(Singularity::Standstill(speed)) => [0.0, speed.max(0.0)],
            Err(_) => [0.0; 2],
        }
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::{Position, Setpoint, SpeedDemand, SteeringDemand, Time};

    use super::super::course::{Course, PathName};
    use super::*;

    const TICK: f64 = 0.01;

    /// Drives a car without slip and lag from 0.1 m beside the path; the distance of the own
    /// point from the path, and from the reference in time, at the end.
    fn kinematic(law: Law, path: PathName, seconds: f64) -> [f64; 2] {
        let vehicle = VehicleParameters::paper();
        let (rear, front) = (vehicle.rear_axle_distance_m, vehicle.front_axle_distance_m);
        let own = if matches!(law, Law::Stanley { .. }) {
            front
        } else {
            -rear
        };
        let course = Course::new(path, 1.0);
        let table = Table::new(&course, seconds + 5.0).unwrap();
        let mut foreign = Foreign {
            law,
            catch_up: 1.0,
            vehicle,
            table: &table,
            index: 0,
            compensation: None,
        };
        let mut yaw = course.heading;
        let [x, y] = course.start;
        // Of the rear axle, to the left of the path.
        let back = own + rear;
        let mut r = [
            x - back * cos(yaw) - 0.1 * sin(yaw),
            y - back * sin(yaw) + 0.1 * cos(yaw),
        ];
        let (mut rear_speed, mut yaw_rate, mut sideslip, mut time) = (0.0, 0.0, 0.0, 0.0);
        while time < seconds {
            let estimate = Estimate {
                time: Time(0),
                position: Position::new(r[0] + rear * cos(yaw), r[1] + rear * sin(yaw)),
                yaw,
                yaw_rate,
                sideslip,
                speed: rear_speed / cos(sideslip),
                pose_time: Time(0),
            };
            let [steering, speed] = foreign.command(&estimate, time, 0.0);
            sideslip = atan(rear * tan(steering) / (rear + front));
            rear_speed = speed * cos(sideslip);
            yaw_rate = rear_speed * tan(steering) / (rear + front);
            r[0] += TICK * rear_speed * cos(yaw + 0.5 * TICK * yaw_rate);
            r[1] += TICK * rear_speed * sin(yaw + 0.5 * TICK * yaw_rate);
            yaw += TICK * yaw_rate;
            time += TICK;
        }
        let point = [r[0] + back * cos(yaw), r[1] + back * sin(yaw)];
        let from = |[x, y]: [f64; 2]| hypot(point[0] - x, point[1] - y);
        let nearest = table.get(table.nearest(point, foreign.index));
        [from(nearest.position), from(table.at(time).position)]
    }

    #[test]
    fn a_car_without_slip_and_lag_comes_to_the_path_and_to_the_reference() {
        for (law, most) in [
            (Law::PurePursuit { time: 0.3 }, 0.01),
            (Law::Stanley { gain: 2.0 }, 0.01),
        ] {
            for path in [PathName::Circle, PathName::Eight] {
                let [path_error, error] = kinematic(law, path, 15.0);
                assert!(path_error < most, "{law:?} {path:?} {path_error}");
                assert!(error < 2.0 * most, "{law:?} {path:?} {error}");
            }
        }
    }

    #[test]
    fn a_car_far_behind_demands_what_is_a_set_point() {
        let course = Course::new(PathName::LaneChange, 1.8);
        let table = Table::new(&course, 60.0).unwrap();
        let mut foreign = Foreign {
            law: Law::Stanley { gain: 16.0 },
            catch_up: 1_000.0,
            vehicle: VehicleParameters::paper(),
            table: &table,
            index: 0,
            compensation: None,
        };
        let [x, y] = course.start;
        let estimate = Estimate {
            time: Time(0),
            position: Position::new(x, y),
            yaw: course.heading,
            yaw_rate: 0.0,
            sideslip: 0.0,
            speed: 0.0,
            pose_time: Time(0),
        };
        let [steering, speed] = foreign.command(&estimate, 5.0, TICK);
        let demand = Setpoint::actuation(
            Time(0),
            SteeringDemand::Angle(steering),
            SpeedDemand::Speed(speed),
        );
        assert_eq!(demand.check(Time(0), 1.0), Ok(()));
        assert!(speed > 2.9, "{speed}");
    }
}
