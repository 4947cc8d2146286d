//! The paper's circle, to compare what a configuration makes of a car.

use singletrack_core::{
    Config,
    config::{OuterLoopSection, ReferenceSection, Start},
};
use singletrack_pilot::{Arming, Mode, PilotRequest, Reason};
use singletrack_scenario::virtual_drive::VirtualDrive;
use singletrack_sim::StartPose;

use crate::car::OnboardCar;

/// A drive along the circle.
#[derive(Clone, Debug)]
pub struct Circle {
    /// Root mean square of the true distance of P from its reference, in m; none if the drive
    /// did not last.
    pub error_m: Option<f64>,
    /// Why it ended early.
    pub ended: Option<&'static str>,
}

/// Radius of the circle, in m, and its angular velocity, in rad/s.
const RADIUS_M: f64 = 1.0;
const RATE_RAD_S: f64 = 0.6;
/// Duration of the drive, and the part of it before P has settled, in s.
const DRIVE_S: f64 = 25.0;
const SETTLED_S: f64 = 10.0;
/// Time for the start, in s.
const START_S: f64 = 12.0;

/// Drives the circle with this file; none if it is refused.
pub(crate) fn drive(car: &OnboardCar, file: &str) -> Option<Circle> {
    let mut config = Config::from_toml(file).ok()?;
    config.reference = ReferenceSection::Circle {
        radius_m: RADIUS_M,
        angular_velocity_rad_s: RATE_RAD_S,
        centre_m: [0.0; 2],
        start: Start::Beginning,
    };
    config.outer_loop = OuterLoopSection::Proportional {
        gain_per_s: [1.0; 2],
        feed_forward: true,
    };
    config.supervisor.prove_first_metre = false;
    let p = config.law.point_distance_m;
    let front = car.simulation.car.vehicle.front_axle_distance_m;
    let mut simulation = car.simulation.clone();
    simulation.car.start = StartPose {
        x_m: RADIUS_M,
        y_m: -p - front,
        yaw_rad: core::f64::consts::FRAC_PI_2,
    };
    let mut drive = VirtualDrive::new(config, car.seed, simulation).ok()?;
    let mut circle = Circle {
        error_m: None,
        ended: None,
    };
    let (mut armed, mut driven) = (false, false);
    let (mut sum, mut count) = (0.0, 0_u32);
    loop {
        let now_s = drive.next_tick_us() as f64 * 1e-6;
        if !armed && drive.mode() == Mode::Ready {
            armed = drive.request(PilotRequest::Arm(Arming::Unattended)).is_ok();
        }
        let tick = drive.step();
        let output = &tick.tick.output;
        let Some(time) = output.drive_time else {
            if driven || now_s > START_S {
                let reason = output.reason.or(output.preflight);
                circle.ended = Some(reason.map_or("not-started", Reason::name));
                return Some(circle);
            }
            continue;
        };
        driven = true;
        if time > SETTLED_S
            && let Some(wanted) = output.reference.and_then(|reference| reference.position)
        {
            let [x, y] = tick.truth.point_p(front, p);
            sum += (x - wanted.x).powi(2) + (y - wanted.y).powi(2);
            count += 1;
        }
        if time > DRIVE_S {
            circle.error_m = Some(libm::sqrt(sum / f64::from(count.max(1))));
            return Some(circle);
        }
    }
}

impl Circle {
    /// In words.
    #[must_use]
    pub fn text(&self) -> String {
        match (self.error_m, self.ended) {
            (Some(error), _) => format!("{:.1} mm", error * 1e3),
            (None, Some(reason)) => format!("ended: {reason}"),
            (None, None) => "not driven".into(),
        }
    }
}
