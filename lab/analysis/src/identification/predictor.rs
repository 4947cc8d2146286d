//! The prediction errors along a drive, with their exact derivatives by the parameters, as
//! a least-squares problem.
//!
//! The gains are those of a run of the filter and constant. Their derivatives by the
//! parameters multiply innovations, whose mean is zero; without them the minimum is at the
//! same place, and its curvature the same up to noise.

use super::{
    data::{DriveData, ServoTarget, Span},
    filter::{Gain, Gains},
    model::Model,
    parameter::{Parameter, Values},
    problem::{Problem, Structure},
    timeline::{EventHandler, STATES, StateEstimate, replay},
};
use crate::dual::Dual;

/// The data, model and gains of a prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prediction<'a> {
    pub(super) data: &'a DriveData,
    pub(super) servo: &'a [ServoTarget],
    pub(super) spans: &'a [Span],
    pub(super) gains: &'a Gains,
    pub(super) start: &'a Values,
    pub(super) active: &'a [Parameter],
    pub(super) structure: Structure,
}

impl Prediction<'_> {
    /// Number of predicted measurements.
    pub(super) fn rows(&self) -> usize {
        2 * self.data.inertial.len() + 3 * self.data.poses.len()
    }

    /// The time of each predicted measurement, in s.
    pub(super) fn times(&self) -> Vec<f64> {
        let inertial = self.data.inertial.iter().flat_map(|i| [i.time_s; 2]);
        inertial
            .chain(self.data.poses.iter().flat_map(|p| [p.time_s; 3]))
            .collect()
    }
}

impl Problem for Prediction<'_> {
    fn errors<D: Dual>(&self, u: &[D]) -> Option<Vec<D>> {
        let parameters = self.start.moved(self.active, u);
        let zero = D::from(0.0);
        let mut predictor = Predictor {
            prediction: self,
            model: Model::new(self.start, parameters, self.structure),
            estimate: StateEstimate::of([zero; STATES], zero),
            errors: vec![zero; self.rows()],
        };
        let model = predictor.model;
        for span in self.spans {
            let order = &self.gains.order;
            replay(self.data, self.servo, *span, &model, order, &mut predictor)?;
        }
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
        if let Some(place) = self.errors.get_mut(row) {
            *place = error / gain.deviation;
        }
        let mut states = self.estimate.states();
        for (state, gain) in states.iter_mut().zip(gain.gain) {
            *state += error * gain;
        }
        self.estimate = StateEstimate::of(states, self.estimate.motion.steering);
    }
}

impl<D: Dual> EventHandler<D> for Predictor<'_, D> {
    fn begin(&mut self, estimate: StateEstimate<D>) {
        self.estimate = estimate;
    }

    fn advance(&mut self, step: D, target: f64, forward: [D; 2]) -> Option<()> {
        let bias = self.estimate.forward_bias;
        let forward = forward.map(|forward| forward - bias);
        self.estimate.motion = self
            .model
            .advance(self.estimate.motion, step, target, forward)?;
        Some(())
    }

    fn inertial(&mut self, index: usize, forward: D) {
        let prediction = self.prediction;
        let (Some(sample), Some([yaw_rate, left])) = (
            prediction.data.inertial.get(index),
            prediction.gains.inertial.get(index),
        ) else {
            return;
        };
        let scale = self.model.get(Parameter::GyroScale);
        let expected = self.estimate.motion.yaw_rate * scale + self.estimate.gyro_bias;
        self.correct(yaw_rate, 2 * index, -expected + sample.yaw_rate_rad_s);
        let forward = forward - self.estimate.forward_bias;
        let expected = self.model.left_acceleration(&self.estimate.motion, forward)
            + self.model.get(Parameter::LateralBias);
        self.correct(left, 2 * index + 1, -expected + sample.left_m_s2);
    }

    fn pose(&mut self, index: usize) {
        let prediction = self.prediction;
        let (Some(pose), Some([x, y, yaw])) = (
            prediction.data.poses.get(index),
            prediction.gains.poses.get(index),
        ) else {
            return;
        };
        let row = 2 * prediction.data.inertial.len() + 3 * index;
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
    use super::super::parameter::COUNT;
    use singletrack_control::{Tyres, VehicleParameters};

    use super::{
        super::{
            data::{Inertial, Pose},
            filter::run_filter,
            noise::NoiseLevels,
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
        for tyres in [Tyres::Saturating, Tyres::Linear] {
            let noise = NoiseLevels::usual();
            let run = run_filter(&data, &data.servo, &spans, &start, tyres.into(), &noise).unwrap();
            let prediction = Prediction {
                data: &data,
                servo: &data.servo,
                spans: &spans,
                gains: &run.gains,
                start: &start,
                active: &Parameter::ALL,
                structure: tyres.into(),
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
        let (tyres, noise) = (Tyres::Saturating, NoiseLevels::usual());
        let run = run_filter(&data, &data.servo, &spans, &start, tyres.into(), &noise).unwrap();
        let prediction = Prediction {
            data: &data,
            servo: &data.servo,
            spans: &spans,
            gains: &run.gains,
            start: &start,
            active: &[Parameter::FrontStiffness],
            structure: tyres.into(),
        };
        let sum = prediction.residuals(&[0.0]).unwrap().norm_squared();
        let innovations = run.innovations.iter();
        let expected: f64 = innovations
            .map(|innovation| innovation.value * innovation.value / innovation.variance)
            .sum();
        assert!((sum / expected - 1.0).abs() < 1e-9, "{sum} {expected}");
    }
}
