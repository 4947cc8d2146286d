//! Errors of the estimate on the simulated car.

use singletrack_control::statistics::RootMeanSquare;
use singletrack_control::{Estimate, wrap};
use singletrack_core::config::MarkerLoss;
use singletrack_pilot::Mode;
use singletrack_scenario::{
    simulate::{Scenario, SimulateError, virtual_drive_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{LossPattern, Truth};

/// Root-mean-square errors of the estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct EstimateErrors {
    /// Distance from the true G, in m.
    pub(crate) position_m: f64,
    /// Yaw, in rad.
    pub(crate) yaw_rad: f64,
    /// Yaw rate, in rad/s.
    pub(crate) yaw_rate_rad_s: f64,
    /// Sideslip, in rad.
    pub(crate) sideslip_rad: f64,
    /// Speed of G, in m/s.
    pub(crate) speed_m_s: f64,
}

/// Errors of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct EstimationStudy {
    /// Errors of the estimate over the counted ticks.
    pub(crate) errors: EstimateErrors,
    /// Largest distance of the estimated from the true G, in m.
    pub(crate) worst_position_m: f64,
    /// Root mean square of the distance from P to its reference, in m.
    pub(crate) tracking_m: f64,
    /// The number of counted ticks.
    pub(crate) ticks: u32,
}

/// The first part of a drive, which is not counted, in s: the car approaches the circle.
const SETTLING: f64 = 10.0;

/// Drives a scenario on the car with the marker losses `loss`, and compares estimate and
/// truth at every tick after the first 10 s.
///
/// # Errors
///
/// The car can't drive the scenario, or does not start.
pub(crate) fn study(
    scenario: &Scenario,
    loss: Option<LossPattern>,
    marker_loss: MarkerLoss,
) -> Result<EstimationStudy, SimulateError> {
    let (mut config, simulation) = virtual_drive_config(scenario)?;
    config.estimator.marker_loss = marker_loss;
    if let Some(loss) = loss {
        // The study needs the whole loss: the supervisor must not end the drive.
        let longest_ms = u32::try_from(loss.duration_us / 1_000).unwrap_or(u32::MAX);
        let supervisor = &mut config.supervisor;
        supervisor.hold_ms = supervisor.hold_ms.max(longest_ms.saturating_add(100));
    }
    let mut drive = VirtualDrive::new(config, scenario.run.seed, simulation)?;
    let first = drive.start()?;
    let epoch_us = first.now.0 / 1000;
    let cameras = &mut drive.world.cameras;
    cameras.parameters.loss = loss;
    cameras.loss_epoch_us = Some(epoch_us);

    let mut sum = Sum::default();
    loop {
        let tick = drive.step();
        let time = tick.now.seconds_since(first.now);
        if time > scenario.run.duration_s {
            return Ok(sum.study());
        }
        let output = &tick.tick.output;
        if time < SETTLING || output.mode != Mode::Driving {
            continue;
        }
        if let (Some(estimate), Some(reference)) = (&output.estimate, &output.reference) {
            let point = tick.truth.point_p(
                scenario.vehicle.front_axle_distance_m,
                scenario.law.point_distance_m,
            );
            let off = reference.position.map_or(0.0, |position| {
                libm::hypot(position.x - point[0], position.y - point[1])
            });
            sum.add(estimate, &tick.truth, off);
        }
    }
}

/// Errors of the estimate and of the tracking, summed over the ticks.
#[derive(Default)]
struct Sum {
    errors: [RootMeanSquare; 6],
    worst_position: f64,
    ticks: u32,
}

impl Sum {
    fn add(&mut self, estimate: &Estimate, truth: &Truth, tracking: f64) {
        let position = libm::hypot(estimate.position.x - truth.x, estimate.position.y - truth.y);
        let errors = [
            position,
            wrap(estimate.yaw - truth.yaw),
            estimate.yaw_rate - truth.yaw_rate,
            estimate.sideslip - truth.sideslip,
            estimate.speed - truth.speed,
            tracking,
        ];
        for (sum, error) in self.errors.iter_mut().zip(errors) {
            sum.add(error);
        }
        self.worst_position = self.worst_position.max(position);
        self.ticks += 1;
    }

    fn study(&self) -> EstimationStudy {
        let [
            position_m,
            yaw_rad,
            yaw_rate_rad_s,
            sideslip_rad,
            speed_m_s,
            tracking_m,
        ] = self.errors.map(|errors| errors.value().unwrap_or(0.0));
        EstimationStudy {
            errors: EstimateErrors {
                position_m,
                yaw_rad,
                yaw_rate_rad_s,
                sideslip_rad,
                speed_m_s,
            },
            worst_position_m: self.worst_position,
            tracking_m,
            ticks: self.ticks,
        }
    }
}
