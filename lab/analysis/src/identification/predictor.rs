//! The prediction errors along a drive, with their exact derivatives by the parameters, as
//! a least-squares problem.
//!
//! The gains are those of a run of the filter and constant. Their derivatives by the
//! parameters multiply innovations, whose mean is zero; without them the minimum is at the
//! same place, and its curvature the same up to noise.

use super::{
    data::{Drive, DriveData},
    filter::{Gain, Gains},
    least_squares::Problem,
    model::Model,
    parameter::Values,
    settings::Settings,
    timeline::{EventHandler, STATES, StateEstimate},
};
use crate::dual::Dual;

/// The data, model and gains of a prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prediction<'a> {
    pub(super) drive: Drive<'a>,
    pub(super) gains: &'a Gains,
    pub(super) start: &'a Values,
    pub(super) settings: &'a Settings,
}

impl Prediction<'_> {
    /// Number of predicted measurements.
    pub(super) fn rows(&self) -> usize {
        2 * self.drive.data.inertial.len() + 3 * self.drive.data.poses.len()
    }

    /// The time of each predicted measurement, in s.
    pub(super) fn times(&self) -> Vec<f64> {
        let DriveData {
            poses, inertial, ..
        } = self.drive.data;
        let inertial = inertial.iter().flat_map(|i| [i.time_s; 2]);
        let poses = poses.iter().flat_map(|p| [p.time_s; 3]);
        inertial.chain(poses).collect()
    }
}

impl Problem for Prediction<'_> {
    fn errors<D: Dual>(&self, u: &[D]) -> Option<Vec<D>> {
        let parameters = self.start.moved(&self.settings.parameters, u);
        let zero = D::from(0.0);
        let mut predictor = Predictor {
            prediction: self,
            model: Model::new(self.start, parameters, self.settings),
            estimate: StateEstimate::of([zero; STATES], zero),
            errors: vec![zero; self.rows()],
        };
        let model = predictor.model;
        let order = &self.gains.order;
        self.drive.replay(&model, order, &mut predictor)?;
        Some(predictor.errors)
    }
}

struct Predictor<'a, D> {
    prediction: &'a Prediction<'a>,
    model: Model<D>,
    estimate: StateEstimate<D>,
    errors: Vec<D>,
}

impl<D: Dual> Predictor<'_, D> {
    fn correct(&mut self, gain: &Gain, row: usize, error: D) {
        if gain.deviation <= 0.0 {
            return;
        }
        self.errors[row] = error / gain.deviation;
        let mut states = self.estimate.states();
        for (state, gain) in states.iter_mut().zip(gain.gain) {
            *state += error * gain;
        }
        self.estimate = StateEstimate::of(states, self.estimate.motion.steering);
    }
}

impl<D: Dual> EventHandler<D> for Predictor<'_, D> {
    fn begin(&mut self, _: f64, estimate: StateEstimate<D>) {
        self.estimate = estimate;
    }

    fn advance(&mut self, step: D, target: f64, forward: [D; 2]) -> Option<()> {
        let bias = self.estimate.forward_bias;
        let forward = forward.map(|forward| forward - bias);
        let motion = &mut self.estimate.motion;
        *motion = self.model.advance(*motion, step, target, forward)?;
        Some(())
    }

    fn inertial(&mut self, index: usize, forward: D) {
        let Prediction { drive, gains, .. } = self.prediction;
        let (sample, [yaw_rate, left]) = (&drive.data.inertial[index], &gains.inertial[index]);
        let expected = self.estimate.gyro(&self.model);
        self.correct(yaw_rate, 2 * index, -expected + sample.yaw_rate_rad_s);
        let expected = self.estimate.left(&self.model, forward);
        self.correct(left, 2 * index + 1, -expected + sample.left_m_s2);
    }

    fn pose(&mut self, index: usize) {
        let Prediction { drive, gains, .. } = self.prediction;
        let (pose, [x, y, yaw]) = (&drive.data.poses[index], &gains.poses[index]);
        let row = 2 * drive.data.inertial.len() + 3 * index;
        let error = -self.estimate.motion.x + pose.x_m;
        self.correct(x, row, error);
        let error = -self.estimate.motion.y + pose.y_m;
        self.correct(y, row + 1, error);
        let error = -self.estimate.motion.yaw + pose.yaw_rad;
        let turns = (error.re() / core::f64::consts::TAU).round();
        self.correct(yaw, row + 2, error - turns * core::f64::consts::TAU);
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::{Tyres, VehicleParameters};

    use super::{
        super::{
            data::{Inertial, Pose, ServoTarget, Span},
            filter::run_filter,
            parameter::{COUNT, Parameter},
            settings::NoiseLevels,
        },
        *,
    };

    /// An artificial drive: the test of the derivatives needs no realistic one.
    fn drive() -> DriveData {
        let mut data = DriveData::default();
        for index in 0..300_u64 {
            let time_s = 0.01 * index as f64;
            let yaw = 0.2 * (3.0 * time_s).sin();
            data.poses.push(Pose {
                time_s: time_s + 0.0061,
                x_m: 1.6 * time_s,
                y_m: 0.1 * (3.0 * time_s).sin(),
                yaw_rad: yaw,
            });
            data.inertial.push(Inertial {
                time_s: time_s + 0.0033,
                yaw_rate_rad_s: 0.6 * (3.0 * time_s).cos(),
                forward_m_s2: 0.3 * (5.0 * time_s).sin(),
                left_m_s2: (3.0 * time_s).cos(),
            });
            data.servo.push(ServoTarget {
                time_s,
                period: index,
                angle_rad: 0.15 * (4.0 * time_s).sin(),
            });
        }
        data
    }

    #[test]
    fn the_jacobian_is_the_derivative_of_the_prediction_errors() {
        let data = drive();
        let start = Values::of(&VehicleParameters::paper()).with(Parameter::InertialDelay, 0.001);
        let spans = [Span {
            start_s: 0.5,
            end_s: 2.8,
        }];
        let drive = Drive {
            data: &data,
            servo: &data.servo,
            spans: &spans,
        };
        for tyres in [Tyres::Saturating, Tyres::Linear] {
            let noise = NoiseLevels::usual();
            let settings = Settings {
                tyres,
                parameters: Parameter::ALL.to_vec(),
                ..Settings::default()
            };
            let run = run_filter(drive, &start, &settings, &noise).unwrap();
            let prediction = Prediction {
                drive,
                gains: &run.gains,
                start: &start,
                settings: &settings,
            };
            let u: Vec<f64> = (0..COUNT).map(|index| 0.01 * index as f64).collect();
            let jacobian = prediction.jacobian(&u).unwrap();
            for column in 0..COUNT {
                let moved = |by: f64| {
                    let mut u = u.clone();
                    u[column] += by;
                    prediction.residuals(&u).unwrap()
                };
                let h = 1e-5;
                let difference = (moved(h) - moved(-h)) / (2.0 * h);
                let exact = jacobian.column(column);
                let error = (&difference - exact).norm() / exact.norm();
                assert!(error < 1e-5, "{}: {error}", Parameter::ALL[column]);
            }
        }
    }

    #[test]
    fn the_prediction_errors_are_the_filters_innovations() {
        let data = drive();
        let start = Values::of(&VehicleParameters::paper());
        let spans = [Span {
            start_s: 0.5,
            end_s: 2.8,
        }];
        let drive = Drive {
            data: &data,
            servo: &data.servo,
            spans: &spans,
        };
        let settings = Settings {
            parameters: vec![Parameter::FrontStiffness],
            ..Settings::default()
        };
        let run = run_filter(drive, &start, &settings, &NoiseLevels::usual()).unwrap();
        let prediction = Prediction {
            drive,
            gains: &run.gains,
            start: &start,
            settings: &settings,
        };
        let sum = prediction.residuals(&[0.0]).unwrap().norm_squared();
        let innovations = run.innovations.iter();
        let expected: f64 = innovations
            .map(|innovation| innovation.value * innovation.value / innovation.variance)
            .sum();
        assert!((sum / expected - 1.0).abs() < 1e-9, "{sum} {expected}");
    }
}
