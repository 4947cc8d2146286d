//! The results of a drive from the true states, or why it has none.

use libm::{cos, hypot, sin};
use serde::{Deserialize, Serialize};
use singletrack_control::statistics::{Distribution, RootMeanSquare};
use singletrack_control::{GRAVITY, LawError, Position, VehicleParameters, velocity_point};
use singletrack_core::ConfigError;
use singletrack_scenario::virtual_drive::VirtualDriveError;
use singletrack_sim::Truth;

use super::course::Table;

/// Why a drive can't be simulated.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The reference is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The host or the world is refused.
    #[error(transparent)]
    Drive(#[from] VirtualDriveError),
    /// A program's own controller is driven by that program.
    #[error("a controller of your own is compared by the Python package")]
    Yours,
    /// A law is refused.
    #[error(transparent)]
    Law(#[from] LawError),
}

/// The point whose errors are the controller's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OwnPoint {
    /// P, in front of the front axle.
    P,
    /// The front axle.
    FrontAxle,
    /// The rear axle.
    RearAxle,
    /// P of the appendix: ahead of G along its velocity.
    VelocityPoint,
}

impl OwnPoint {
    /// How far it is ahead of G on a straight line, in m.
    pub(super) fn reach(self, vehicle: &VehicleParameters) -> f64 {
        match self {
            Self::P => vehicle.front_axle_distance_m + POINT_DISTANCE_M,
            Self::FrontAxle => vehicle.front_axle_distance_m,
            Self::RearAxle => -vehicle.rear_axle_distance_m,
            Self::VelocityPoint => POINT_DISTANCE_M,
        }
    }
}

/// The distance of P from the front axle, in m.
pub(super) const POINT_DISTANCE_M: f64 = 0.35;

/// What became of a drive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveResult {
    /// Why the car stopped before the end; the errors are those until then.
    pub stopped: Option<String>,
    /// Error of the controller's own point: P, the rear axle, or the front axle.
    pub own: Option<Errors>,
    /// Distance of the front axle from the path, whenever it is where.
    pub front_axle: Option<Errors>,
    /// The largest acceleration of G over that of sliding tyres.
    pub tyre_use_max: f64,
    /// How much steering and speed move.
    pub effort: Option<Effort>,
    /// The result of the search for the delay, where it was searched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub added_delay: Option<AddedDelay>,
}

/// How much steering and speed of the true car move over the counted time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Effort {
    /// Root mean square of the steering rate of the front wheels, in rad/s.
    pub steering_rate_rms: f64,
    /// The largest steering rate, in rad/s.
    pub steering_rate_max: f64,
    /// Root mean square of the difference of the speed of G from its mean over the half second
    /// around, in m/s.
    pub speed_ripple: f64,
}

/// Which added delay a controller does not stand.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AddedDelay {
    /// The least one found to diverge, in ms; none up to the longest that is tried.
    pub diverges_ms: Option<u32>,
    /// How the drive with it ended: the supervisor's reason, or `diverged`.
    pub ended_by: Option<String>,
}

/// Errors over the counted time, in m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Errors {
    /// Root mean square.
    pub rms: f64,
    /// Exceeded in 1 % of the time.
    pub p99: f64,
    /// Largest.
    pub max: f64,
    /// Root mean square along the path; zero where time does not matter.
    pub along_rms: f64,
    /// Root mean square across it.
    pub across_rms: f64,
}

/// The mean of the speed for the ripple is taken over this time to both sides, in s.
const RIPPLE_HALF_S: f64 = 0.25;

/// The errors of a drive, from the true states.
pub(super) struct Counted<'a> {
    own: OwnPoint,
    /// The true car.
    vehicle: VehicleParameters,
    /// The time that is counted, in s.
    counted: [f64; 2],
    table: &'a Table,
    /// The place of the path's point that is nearest to the front axle.
    index: usize,
    /// Along and across the path, in m.
    errors: Vec<[f64; 2]>,
    /// The largest distance of the own point, in m.
    largest: f64,
    front_errors: Vec<[f64; 2]>,
    /// Time in s, steering angle in rad, and speed in m/s.
    motion: Vec<[f64; 3]>,
    tyre_use: f64,
}

impl<'a> Counted<'a> {
    pub(super) fn new(
        own: OwnPoint,
        vehicle: &VehicleParameters,
        counted: [f64; 2],
        table: &'a Table,
    ) -> Self {
        Self {
            own,
            vehicle: *vehicle,
            counted,
            table,
            index: 0,
            errors: Vec::new(),
            largest: 0.0,
            front_errors: Vec::new(),
            motion: Vec::new(),
            tyre_use: 0.0,
        }
    }

    pub(super) fn add(&mut self, time: f64, truth: &Truth) {
        let on_axis = |ahead: f64| {
            [
                truth.x + ahead * cos(truth.yaw),
                truth.y + ahead * sin(truth.yaw),
            ]
        };
        let front = on_axis(self.vehicle.front_axle_distance_m);
        self.index = self.table.nearest(front, self.index);
        let [from, until] = self.counted;
        if !(from..=until).contains(&time) {
            return;
        }
        let nearest = self.table.get(self.index);
        let [_, across] = error(front, nearest.position, nearest.heading);
        self.front_errors.push([0.0, across]);
        let own = match self.own {
            OwnPoint::P => truth.point_p(self.vehicle.front_axle_distance_m, POINT_DISTANCE_M),
            OwnPoint::FrontAxle | OwnPoint::RearAxle => on_axis(self.own.reach(&self.vehicle)),
            OwnPoint::VelocityPoint => {
                let centre = Position::new(truth.x, truth.y);
                let point = velocity_point(centre, truth.yaw, truth.sideslip, POINT_DISTANCE_M);
                [point.x, point.y]
            }
        };
        self.motion.push([time, truth.steering, truth.speed]);
        let wanted = self.table.at(time);
        let [along, across] = error(own, wanted.position, wanted.heading);
        self.errors.push([along, across]);
        self.largest = self.largest.max(hypot(along, across));
        let acceleration = hypot(truth.longitudinal_acceleration, truth.lateral_acceleration);
        let sliding = self.vehicle.friction * GRAVITY;
        self.tyre_use = self.tyre_use.max(acceleration / sliding);
    }

    /// When the path ends, in s; none if it does not.
    pub(super) fn path_duration(&self) -> Option<f64> {
        self.table.reference.duration()
    }

    /// The largest error so far, in m.
    pub(super) const fn largest_m(&self) -> f64 {
        self.largest
    }

    pub(super) fn result(&self, stopped: Option<String>) -> DriveResult {
        DriveResult {
            stopped,
            own: Errors::of(&self.errors),
            front_axle: Errors::of(&self.front_errors),
            tyre_use_max: self.tyre_use,
            effort: Effort::of(&self.motion),
            added_delay: None,
        }
    }
}

impl Effort {
    /// From times (s), steering angles (rad) and speeds (m/s) at equal intervals.
    fn of(motion: &[[f64; 3]]) -> Option<Self> {
        let rates = motion.windows(2).filter_map(|pair| match pair {
            [[from, before, _], [until, after, _]] => Some((after - before) / (until - from)),
            _ => None,
        });
        let rates = Distribution::of(rates.map(f64::abs));
        let period = match motion {
            [[first, ..], .., [last, ..]] => (last - first) / (motion.len() - 1) as f64,
            _ => return None,
        };
        let half = (RIPPLE_HALF_S / period) as usize;
        let ripple = motion.windows(2 * half + 1).filter_map(|around| {
            let mean = around.iter().map(|[.., speed]| speed).sum::<f64>() / around.len() as f64;
            around.get(half).map(|[.., speed]| speed - mean)
        });
        Some(Self {
            steering_rate_rms: rates.root_mean_square()?,
            steering_rate_max: rates.max()?,
            speed_ripple: RootMeanSquare::of(ripple).value()?,
        })
    }
}

/// The error along and across a direction, in m.
fn error(point: [f64; 2], wanted: [f64; 2], heading: f64) -> [f64; 2] {
    let [x, y] = [point[0] - wanted[0], point[1] - wanted[1]];
    let (sin, cos) = (sin(heading), cos(heading));
    [x * cos + y * sin, y * cos - x * sin]
}

impl Errors {
    fn of(errors: &[[f64; 2]]) -> Option<Self> {
        let distances =
            Distribution::of(errors.iter().map(|&[along, across]| hypot(along, across)));
        let part = |axis: usize| Distribution::of(errors.iter().map(|error| error[axis]));
        Some(Self {
            rms: distances.root_mean_square()?,
            p99: distances.quantile(0.99)?,
            max: distances.max()?,
            along_rms: part(0).root_mean_square()?,
            across_rms: part(1).root_mean_square()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rising_speed_has_no_ripple_and_a_wave_has() {
        let motion = |wave: f64| {
            let at = |index: u32| {
                let time = 0.01 * f64::from(index);
                [time, 0.2 * time, time + wave * sin(31.4 * time)]
            };
            Effort::of(&(0..400).map(at).collect::<Vec<_>>()).unwrap()
        };
        let calm = motion(0.0);
        assert!(calm.speed_ripple < 1e-12, "{calm:?}");
        assert!((calm.steering_rate_rms - 0.2).abs() < 1e-9, "{calm:?}");
        assert!((calm.steering_rate_max - 0.2).abs() < 1e-9, "{calm:?}");
        // 0.1/√2: the mean over half a second holds 2.5 waves.
        let wave = motion(0.1).speed_ripple;
        assert!((0.06..0.08).contains(&wave), "{wave}");
        assert_eq!(Effort::of(&[]), None);
    }
}
