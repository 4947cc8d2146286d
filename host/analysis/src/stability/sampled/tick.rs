//! The linear map of one tick.

use nalgebra::{DMatrix, DVector};
use singletrack_control::VehicleParameters;

use super::{
    SampledLoop,
    plant::{POSITION, Plant, STEERING, Steering, YAW},
    servo::Prediction,
};
use crate::stability::closed_loop::{Belief, ClosedLoop, Law};

/// A delay in whole ticks and the rest, in s.
#[derive(Clone, Copy)]
struct Delay {
    ticks: usize,
    late: f64,
}

impl Delay {
    fn new(delay: f64, period: f64) -> Self {
        let ticks = (delay / period + 1e-9) as usize;
        Self {
            ticks,
            late: (delay - ticks as f64 * period).max(0.0),
        }
    }
}

/// Where the state of the loop has what. The states of the plant are first.
struct Layout {
    /// The steering angle as the predictor models it.
    modelled: Option<usize>,
    /// The pending commands, from the newest to the oldest.
    commands: usize,
    pending: usize,
    /// The held pose: position and yaw.
    held: usize,
    size: usize,
}

impl SampledLoop {
    /// The map of one tick on the car's state, the pending commands from the newest to the
    /// oldest, and the held pose (position, yaw).
    pub(super) fn tick(&self, has_pose: bool) -> DMatrix<f64> {
        let (law, speed) = (self.closed_loop.law, self.closed_loop.speed);
        let steering = match (self.servo, law) {
            (Some(servo), _) => Steering::Servo(servo.lag),
            (None, Law::FrontPoint) => Steering::Rate,
            (None, Law::VelocityPoint) => Steering::Angle,
        };
        let plant = Plant::new(&self.closed_loop.vehicle, speed, steering);
        let delay = Delay::new(
            self.delay + self.servo.map_or(0.0, |servo| servo.dead_time),
            self.period,
        );
        let modelled_delay = self
            .prediction
            .map(|prediction| Delay::new(prediction.delay, self.period));

        let states = plant.states();
        let pending = 1 + modelled_delay.map_or(delay.ticks, |other| other.ticks.max(delay.ticks));
        let commands = states + usize::from(self.prediction.is_some());
        let layout = Layout {
            modelled: self.prediction.map(|_| states),
            commands,
            pending,
            held: commands + pending,
            size: commands + pending + 2,
        };

        let command = self.command(&layout, steering, has_pose);
        let mut map = DMatrix::<f64>::zeros(layout.size, layout.size);
        map.view_mut((0, 0), (states, states))
            .copy_from(&plant.transition(self.period));
        let inputs = plant.split_input(self.period, delay.late);
        add_input(&mut map, &layout, &command, 0, delay.ticks, &inputs);
        if let (Some(row), Some(delay), Some(prediction)) =
            (layout.modelled, modelled_delay, self.prediction)
        {
            let follows = |time: f64| 1.0 - libm::exp(-time / prediction.lag);
            let rest = self.period - delay.late;
            map[(row, row)] = libm::exp(-self.period / prediction.lag);
            let inputs = [
                libm::exp(-rest / prediction.lag) * follows(delay.late),
                follows(rest),
            ]
            .map(|input| DVector::from_element(1, input));
            add_input(&mut map, &layout, &command, row, delay.ticks, &inputs);
        }
        map.row_mut(layout.commands).copy_from(&command.transpose());
        for age in 1..layout.pending {
            map[(layout.commands + age, layout.commands + age - 1)] = 1.0;
        }
        for pose in [POSITION, YAW] {
            let from = if has_pose { pose } else { layout.held + pose };
            map[(layout.held + pose, from)] = 1.0;
        }
        if self.position_gain == 0.0 {
            // Without the outer loop nothing depends on the position.
            map = map
                .remove_rows_at(&[POSITION, layout.held + POSITION])
                .remove_columns_at(&[POSITION, layout.held + POSITION]);
        }
        map
    }

    /// The new command as a linear combination of the state of the loop.
    fn command(&self, layout: &Layout, steering: Steering, has_pose: bool) -> DVector<f64> {
        // What the controller measures: position, yaw, yaw rate, sideslip, steering.
        let mut measured = DMatrix::<f64>::zeros(STEERING + 1, layout.size);
        for state in 0..STEERING {
            let is_pose = state == POSITION || state == YAW;
            let from = if is_pose && !has_pose {
                layout.held + state
            } else {
                state
            };
            measured[(state, from)] = 1.0;
        }
        let angle = match (steering, layout.modelled) {
            (_, Some(modelled)) => modelled,
            // The controller's own integral of the rate.
            (Steering::Servo(_), None) => layout.commands,
            (Steering::Rate, None) => STEERING,
            // The law has no use for it.
            (Steering::Angle, None) => layout.commands,
        };
        measured[(STEERING, angle)] = 1.0;
        let measured = match &self.prediction {
            Some(prediction) => self.predicted(prediction, measured, layout),
            None => measured,
        };
        let command = measured.transpose() * self.gains();
        if self.closed_loop.law == Law::FrontPoint && steering != Steering::Rate {
            // The law's rate is integrated to an angle, which is sent at once.
            let mut angle = command * self.period;
            angle[layout.commands] += 1.0;
            angle
        } else {
            command
        }
    }

    /// The state when a command of this tick acts, by the models of servo and car, under the
    /// commands that are pending; the newest of them is held.
    fn predicted(
        &self,
        prediction: &Prediction,
        measured: DMatrix<f64>,
        layout: &Layout,
    ) -> DMatrix<f64> {
        let model = Plant::new(
            &prediction.vehicle,
            self.closed_loop.speed,
            Steering::Servo(prediction.lag),
        );
        let delay = Delay::new(prediction.delay, self.period);
        let mut predicted = measured;
        let mut left = prediction.horizon();
        for age in (1..=delay.ticks + 1).rev() {
            let time = if age == 1 {
                left
            } else if age == delay.ticks + 1 {
                delay.late
            } else {
                self.period
            };
            if time > 0.0 {
                predicted = model.transition(time) * predicted;
                let mut column = predicted.column_mut(layout.commands + age - 1);
                column += model.held(time);
                left -= time;
            }
        }
        predicted
    }

    /// The linearised law: the command as a linear combination of position, yaw, yaw rate,
    /// sideslip and steering.
    fn gains(&self) -> DVector<f64> {
        let ClosedLoop {
            vehicle,
            law,
            belief,
            point_distance: p,
            speed: v,
            deviation,
        } = self.closed_loop;
        let VehicleParameters {
            mass_kg: m,
            front_cornering_stiffness_n_rad: c_f,
            rear_cornering_stiffness_n_rad: c_r,
            ..
        } = vehicle;
        let l_f = vehicle.front_axle_distance_m + deviation;
        let gain = self.position_gain;
        DVector::from_vec(match law {
            // u = (v_Py - v (yaw + sideslip) - l_f r) / p - r, with
            // v_Py = -gain (y + l_f yaw + p (yaw + steering)).
            Law::FrontPoint => vec![
                -gain / p,
                -(gain * (l_f + p) + v) / p,
                -l_f / p - 1.0,
                -v / p,
                -gain,
            ],
            // turn rate = (v_Py - v (yaw + sideslip)) / p, with
            // v_Py = -gain (y + p (yaw + sideslip)).
            Law::VelocityPoint => {
                let l_r = match belief {
                    Belief::CentreOfMass => vehicle.rear_axle_distance_m - deviation,
                    Belief::FrontAxle => vehicle.rear_axle_distance_m,
                };
                let turning = m * v / c_f;
                let course = -turning * (gain + v / p);
                vec![
                    -turning * gain / p,
                    course,
                    -(c_r * l_r - c_f * l_f) / (c_f * v),
                    course + (c_r + c_f) / c_f,
                    0.0,
                ]
            }
        })
    }
}

/// Adds the input of a tick to the states from `row` on: the command at its beginning is one
/// older than the one at its end, which is `ticks` old.
fn add_input(
    map: &mut DMatrix<f64>,
    layout: &Layout,
    command: &DVector<f64>,
    row: usize,
    ticks: usize,
    [begin, end]: &[DVector<f64>; 2],
) {
    for (input, age) in [(begin, ticks + 1), (end, ticks)] {
        if age == 0 {
            let mut rows = map.rows_mut(row, input.len());
            rows += input * command.transpose();
        } else {
            let mut column = map.view_mut((row, layout.commands + age - 1), (input.len(), 1));
            column += input;
        }
    }
}
