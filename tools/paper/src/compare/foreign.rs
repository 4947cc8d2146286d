//! Laws of the literature, to compare with: pure pursuit and Stanley.
//!
//! They drive the same car as the project's own: by steering and speed as a program outside
//! gives them to the pilot, whose supervisor, limits and board stand behind them. A set-point
//! acts in the tick after the one whose state it is computed from, so the state is predicted
//! by one tick.

use libm::{atan, atan2, cos, hypot, sin, tan};
use singletrack_control::{Estimate, VehicleParameters, wrap};

use super::course::Table;

/// A law and its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Law {
    /// Coulter (1992): the rear axle on an arc to the point that is `time` times the speed
    /// ahead on the path.
    PurePursuit { time: f64 },
    /// Hoffmann et al. (2007), the kinematic law: the front wheels along the path, plus the
    /// angle atan(`gain` e / v) towards it.
    Stanley { gain: f64 },
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
    /// Steering (rad) and speed of G (m/s), for `time` seconds after the start of the drive.
    pub(super) fn command(&mut self, estimate: &Estimate, time: f64, ahead: f64) -> [f64; 2] {
        let course = estimate.yaw + estimate.sideslip;
        let way = ahead * estimate.speed;
        let yaw = estimate.yaw + ahead * estimate.yaw_rate;
        let g = [
            estimate.position.x + way * cos(course),
            estimate.position.y + way * sin(course),
        ];
        let rear = self.vehicle.rear_axle_distance_m;
        let front = self.vehicle.front_axle_distance_m;
        let own = match self.law {
            Law::PurePursuit { .. } => -rear,
            Law::Stanley { .. } => front,
        };
        let point = [g[0] + own * cos(yaw), g[1] + own * sin(yaw)];
        self.index = self.table.nearest(point, self.index);
        let nearest = *self.table.get(self.index);
        let wanted = self.table.at(time);
        // Of the own point along the path.
        let behind = wanted.way - nearest.way;
        let speed = (wanted.speed + self.catch_up * behind).clamp(0.0, MOST_SPEED);
        let wheelbase = rear + front;
        let (steering, rear_speed) = match self.law {
            Law::PurePursuit { time } => {
                let ahead = LEAST_AHEAD.max(time * estimate.speed);
                let target = self.table.get(self.table.find(nearest.way + ahead));
                let [x, y] = [0, 1].map(|axis| target.position[axis] - point[axis]);
                let distance = hypot(x, y).max(0.5 * LEAST_AHEAD);
                let angle = wrap(atan2(y, x) - yaw);
                (atan(2.0 * wheelbase * sin(angle) / distance), speed)
            }
            Law::Stanley { gain } => {
                let [x, y] = [0, 1].map(|axis| point[axis] - nearest.position[axis]);
                let left = y * cos(nearest.heading) - x * sin(nearest.heading);
                let towards = atan(-gain * left / estimate.speed.max(LEAST_SPEED));
                let steering = wrap(nearest.heading - yaw) + towards;
                let steering = steering.clamp(-MOST_STEERING, MOST_STEERING);
                (steering, speed * cos(steering))
            }
        };
        let steering = steering.clamp(-MOST_STEERING, MOST_STEERING);
        let sideslip = atan(rear * tan(steering) / wheelbase);
        [steering, rear_speed / cos(sideslip)]
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
