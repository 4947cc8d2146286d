//! `[fence]`, `[governor]`, `[safety_filter]` and `[neighbours]`: where the car may be, and what keeps it
//! able to stop there.

use std::path::PathBuf;

use singletrack_control::{
    ConvexArea, FrontPointLaw, GRAVITY, GovernorConfig, Limits, MAX_STEERING_TICKS,
    NeighbourConfig, Position, Room, SafetyConfig, SafetyFilter, VehicleParameters,
};
use singletrack_pilot::Fence;
use singletrack_settings::section;

use super::{Config, ConfigError};

section! {
    /// Where the centre of mass may be, and must be able to stop. A car that has to turn
    /// round first, which takes up to 2.7 m, needs a larger fence than the default, the
    /// paper's carpet.
    "fence" => pub FenceSection;
    [new];

    /// Corners of a polygon, 3 to 16, in order.
    corners_m: Vec<[f64; 2]> = square(2.0), in -1_000.0..=1_000.0;
    /// Distance kept from the sides. The default is half the length of a car, taken as
    /// 1.54 wheelbases: 0.2 m for the paper's.
    margin_m: Option<f64> = None, in 0.0..=10.0, otherwise 0.2;
    // Without a default: only the operator can measure it, and geofence and stop watch need it.
    /// Deceleration that the car really reaches with the motor at neutral. To measure it,
    /// let the car roll out on your floor, from 0.3 m/s and from the highest speed: v over
    /// the distance s gives v * v / (2 * s). Take the lowest of several, less 20 %.
    braking_m_s2: f64, in up_to(50.0), example 0.9;
}

/// The corners of a square of this width, in m, around the origin.
fn square(width_m: f64) -> Vec<[f64; 2]> {
    let h = 0.5 * width_m;
    vec![[-h, -h], [h, -h], [h, h], [-h, h]]
}

impl FenceSection {
    /// A square of this width, in m, around the origin, for a car with this deceleration.
    pub fn square(width_m: f64, braking_m_s2: f64) -> Self {
        Self {
            corners_m: square(width_m),
            ..Self::new(braking_m_s2)
        }
    }

    /// The distance kept from the sides, for this car, in m.
    pub fn margin_m(&self, vehicle: &VehicleParameters) -> f64 {
        let half = 0.5 * vehicle.body_length_m();
        self.margin_m.unwrap_or((half * 1_000.0).round() / 1_000.0)
    }

    /// Writes the margin for this car out, so that every reader of the configuration has it.
    pub(super) fn resolve(&mut self, vehicle: &VehicleParameters) {
        self.margin_m = Some(self.margin_m(vehicle));
    }

    /// For the controller of this car.
    ///
    /// # Errors
    ///
    /// A polygon without area, or whose sides cross.
    pub fn fence(&self, vehicle: &VehicleParameters) -> Result<Fence, ConfigError> {
        let corners = self.corners_m.iter().copied().map(Position::from);
        let corners: Vec<_> = corners.collect();
        Ok(Fence::new(&corners, self.margin_m(vehicle))?)
    }

    /// The area of the centre of mass, for a section that needs a convex one.
    ///
    /// # Errors
    ///
    /// As for [`FenceSection::fence`]; the polygon is not convex, or nothing is left of it.
    pub(super) fn convex(
        &self,
        vehicle: &VehicleParameters,
        section: &str,
    ) -> Result<ConvexArea, ConfigError> {
        let fence = self.fence(vehicle)?;
        let margin = self.margin_m(vehicle);
        let area = ConvexArea::new(fence.corners()).map_err(|error| {
            let corners = format!("{:?}", self.corners_m);
            let fix = format!(
                "{error}, and {section} needs a convex polygon; give its largest convex part, or \
                 set {section}.enabled = false"
            );
            ConfigError::value("fence.corners_m", corners, fix)
        })?;
        area.shrunk(margin).map_err(|error| {
            let fix = format!("{error}; lower it, or give a larger fence.corners_m");
            ConfigError::value("fence.margin_m", margin, fix)
        })
    }
}

section! {
    /// Makes the reference slower or wider where the car can't follow it, by the limits of
    /// `[limits]`, and slower where P is far behind or the car could not stop inside the geofence,
    /// which must be convex. A reference that the car can follow is not changed.
    "governor" => pub GovernorSection: Copy;
    [default];

    /// Whether the reference may be changed so. Set-points from outside and velocity steps never
    /// are.
    enabled: bool = false;
    /// Distance of P behind its reference from which on the reference slows down. At twice the
    /// distance it waits.
    behind_m: f64 = 0.5, in 0.05..=10.0;
}

/// The time before a stop begins, s: the reaction of the geofence's watch, the age of a pose, and
/// the lag of the car behind its reference.
const REACTION_S: f64 = 0.2;

impl GovernorSection {
    /// For the controller of this car; none if it is not enabled.
    ///
    /// # Errors
    ///
    /// The geofence is not convex, or nothing is left of it.
    pub(super) fn config(
        &self,
        config: &Config,
        law: FrontPointLaw,
        limits: Limits,
    ) -> Result<Option<GovernorConfig>, ConfigError> {
        if !self.enabled {
            return Ok(None);
        }
        let area = config.fence.convex(&config.vehicle, "governor")?;
        let braking = config.fence.braking_m_s2;
        let room = Room::new(&area, braking, REACTION_S).ok_or_else(|| {
            let value = config.fence.margin_m(&config.vehicle);
            let fix = "the governor keeps 5 cm more, and nothing is left; lower it, give a larger \
                       fence.corners_m, or set governor.enabled = false";
            ConfigError::value("fence.margin_m", value, fix)
        })?;
        Ok(Some(GovernorConfig {
            law,
            limits,
            behind: self.behind_m,
            room: Some(room),
        }))
    }
}

section! {
    /// Keeps the car able to stop inside the geofence, whatever an outer loop asks for: ours, a
    /// program's velocities, trajectories, or steering and speed. `docs/safety-filter.md` states
    /// the claim and what it rests on: these errors, `[actuators]`, and `fence.braking_m_s2` or
    /// what a stop has measured. It needs a convex geofence.
    "safety_filter" => pub SafetyFilterSection;
    [default];

    /// Whether there is one.
    enabled: bool = false;
    /// Time from a tick to when a car that is told to stop slows down at the latest. The default
    /// is the motor's dead time and lag, and 80 ms for line, board and the frame of the ESC.
    reaction_ms: Option<f64> = None, in 50.0..=2_000.0, example 196.0;
    /// The most by which a moving car becomes faster than it is measured and commanded. At least
    /// the braking within the motor's dead time and 40 ms counts.
    speed_error_m_s: f64 = 0.1, in 0.0..=1.0;
    /// Largest error of the estimated position: cameras, the body on the car, its stamps.
    position_error_m: f64 = 0.03, in 0.0..=0.5;
    /// Largest error of the direction of motion, beyond the sideslip of the rolling car and of
    /// the estimate.
    course_error_rad: f64 = 0.05, in 0.0..=0.5;
    /// Largest deviation of the path's curvature from that of the steering angle, up to a lateral
    /// acceleration of 2.45 m/s²: trim, play and gain of the servo, slip of the tyres, and what the
    /// servo still lacks after three lags. At least that counts: 0.21 1/m with the defaults.
    curvature_error_per_m: f64 = 0.5, in 0.0..=5.0;
    /// What each m/s² of lateral acceleration beyond adds to it. `singletrack judge` measures both.
    curvature_error_per_m_per_m_s2: f64 = 0.25, in 0.0..=5.0;
    /// File that `singletrack certify` has written for this configuration. The car is not armed
    /// without it, or after a change of a key that it rests on.
    certificate: Option<PathBuf> = None, example PathBuf::from("filter-certificate.json");
}

/// Line, board and the frame of a servo or an ESC, ms.
const LINE_MS: f64 = 40.0;
/// The lags of a servo after which it is where it was sent, but for a twentieth of the change.
const SETTLED: f64 = 3.0;

/// Errors that follow from `[actuators]`: those of `[safety_filter]` are no smaller.
pub(crate) struct Residuals {
    /// Deviation of the curvature by what the servo lacks after [`SETTLED`] lags, 1/m.
    pub(crate) curvature: f64,
    /// Deviation of the direction of motion by the same, rad.
    pub(crate) course: f64,
    /// Excess of a speed that is still on its way over what is known of it, m/s.
    pub(crate) speed: f64,
}

impl Config {
    /// What the filter has to allow for by itself.
    pub(crate) fn residuals(&self) -> Residuals {
        let (most, wheelbase) = (self.limits.max_steering_rad, self.vehicle.wheelbase_m());
        // Of a change from one stop to the other; the tangent is steepest there.
        let lacking = 2.0 * most * libm::exp(-SETTLED);
        let curvature = (libm::tan(most) - libm::tan(most - lacking)) / wheelbase;
        let of_rear = wheelbase - self.law.front_axle_distance_m;
        let delay_ms = self.actuators.speed_dead_time_ms + LINE_MS;
        Residuals {
            curvature,
            course: of_rear * curvature,
            speed: self.fence.braking_m_s2 * 1e-3 * delay_ms,
        }
    }

    /// Time after which the wheels are where they were sent, ms.
    pub fn steering_settles_ms(&self) -> f64 {
        let actuators = &self.actuators;
        actuators.steering_dead_time_ms + SETTLED * actuators.steering_lag_ms + LINE_MS
    }
}

impl SafetyFilterSection {
    /// Time from a tick to when this car slows down at the latest, ms.
    pub(crate) fn reaction_ms(&self, config: &Config) -> f64 {
        let actuators = &config.actuators;
        self.reaction_ms
            .unwrap_or(actuators.speed_dead_time_ms + actuators.speed_lag_ms + 2.0 * LINE_MS)
    }

    /// For the controller of this car; none if it is not enabled.
    ///
    /// # Errors
    ///
    /// The geofence is not convex or nothing is left of it, or the servo is slower than the
    /// filter follows it.
    pub(super) fn filter(&self, config: &Config) -> Result<Option<SafetyFilter>, ConfigError> {
        if !self.enabled {
            return Ok(None);
        }
        SafetyFilter::new(self.config(config)?)
            .map(Some)
            .map_err(|error| ConfigError::value("safety_filter", error.name, error.to_string()))
    }

    /// What the filter of this car rests on.
    ///
    /// # Errors
    ///
    /// The geofence is not convex or nothing is left of it, or the servo is slower than the
    /// filter follows it.
    pub(crate) fn config(&self, config: &Config) -> Result<SafetyConfig, ConfigError> {
        let area = config.fence.convex(&config.vehicle, "safety_filter")?;
        let actuators = &config.actuators;
        let settled_ms = config.steering_settles_ms();
        let period_ms = f64::from(config.control.period_ms);
        let ticks = (settled_ms / period_ms).ceil();
        let most = MAX_STEERING_TICKS - 1;
        if ticks > most as f64 {
            let value = actuators.steering_lag_ms;
            let fix = format!(
                "the servo needs {settled_ms} ms (its dead time, {SETTLED} lags and \
                 {LINE_MS} ms), and the safety filter follows it for {} ms at \
                 control.period_ms = {period_ms}; raise that, use a faster servo, or set \
                 safety_filter.enabled = false",
                most as f64 * period_ms
            );
            return Err(ConfigError::value("actuators.steering_lag_ms", value, fix));
        }
        let residuals = config.residuals();
        let limits = config.limits.limits(config.vehicle.wheelbase_m());
        Ok(SafetyConfig {
            area,
            reaction: 1e-3 * self.reaction_ms(config),
            steering_ticks: ticks as usize,
            position_error: self.position_error_m,
            course_error: self.course_error_rad.max(residuals.course),
            curvature_error: self.curvature_error_per_m.max(residuals.curvature),
            curvature_error_growth: self.curvature_error_per_m_per_m_s2,
            speed_error: self.speed_error_m_s.max(residuals.speed),
            max_speed: config.limits.max_speed_m_s,
            // The law keeps to the configured limit. Beyond that of the tyres they slide.
            max_lateral_acceleration: config.vehicle.friction * GRAVITY,
            slip: limits.with_tyres(&config.vehicle).slip.max(0.0),
            wheelbase: config.vehicle.wheelbase_m(),
        })
    }
}

section! {
    /// Keeps the car apart from every other rigid body that the cameras list: other cars, a wand on
    /// the floor, a person's cap. Where one may be when the car has stopped, the car slows down or
    /// waits (with `[safety_filter]`), and stops (always). `docs/neighbours.md` states what that
    /// rests on.
    "neighbours" => pub NeighboursSection;
    [default];

    /// Whether it does.
    @restart enabled: bool = false;
    /// Distance from the centre of mass to the body's origin within which they may touch. The
    /// default is the length of the car, and 0.1 m.
    clearance_m: Option<f64> = None, in 0.05..=5.0, example 0.5;
    /// The largest speed of another body.
    max_speed_m_s: f64 = 2.0, in up_to(20.0);
    /// The largest acceleration of another body.
    acceleration_m_s2: f64 = 2.0, in up_to(50.0);
    /// The deceleration with which another car stops. The default is `fence.braking_m_s2`.
    braking_m_s2: Option<f64> = None, in up_to(50.0), example 0.9;
    /// Time from a pose of another car until it brakes. The default is that of this car: as
    /// `safety_filter.reaction_ms`, and two periods.
    reaction_ms: Option<f64> = None, in 0.0..=2_000.0, example 216.0;
    /// How long the car waits for a body in its way before the drive ends.
    patience_s: f64 = 10.0, in 0.0..=3_600.0;
    /// The other cars, by the names of their rigid bodies; without one of them the car does not
    /// drive. It needs the safety filter. Each must have this section too, with this car in the
    /// list: of two, the one with the lower streaming id has the right of way.
    @restart expected: Vec<String> = Vec::new();
    /// Rigid bodies that are no obstacles, by their names.
    @restart ignored: Vec<String> = Vec::new();
}

impl NeighboursSection {
    /// For the controller of this car; none if it is not enabled.
    ///
    /// # Errors
    ///
    /// A body is both expected and ignored, or is the car's own; or others are expected without the
    /// safety filter.
    pub(super) fn config(&self, config: &Config) -> Result<Option<NeighbourConfig>, ConfigError> {
        const EXPECTED: &str = "neighbours.expected";
        let own = &config.motion_capture.rigid_body;
        for name in &self.expected {
            let fix = match self.ignored.contains(name) {
                true => "it is in neighbours.ignored too: remove it from one of them",
                false if name == own => "it is this car's own body: remove it",
                false => continue,
            };
            return Err(ConfigError::value(EXPECTED, format!("{name:?}"), fix));
        }
        if !self.enabled {
            return Ok(None);
        }
        // The car that has the right of way relies on the filter of the other one.
        if !self.expected.is_empty() && !config.safety_filter.enabled {
            let value = format!("{:?}", self.expected);
            let fix = "these cars rely on this one to wait for them: set safety_filter.enabled = \
                       true, or empty the list";
            return Err(ConfigError::value(EXPECTED, value, fix));
        }
        let reaction_ms = self.reaction_ms.unwrap_or_else(|| {
            config.safety_filter.reaction_ms(config) + 2.0 * f64::from(config.control.period_ms)
        });
        Ok(Some(NeighbourConfig {
            clearance: self
                .clearance_m
                .unwrap_or_else(|| config.vehicle.body_length_m() + 0.1),
            max_speed: self.max_speed_m_s,
            acceleration: self.acceleration_m_s2,
            braking: self.braking_m_s2.unwrap_or(config.fence.braking_m_s2),
            reaction: 1e-3 * reaction_ms,
            patience: self.patience_s,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(expected: &str, more: &str) -> String {
        let example = include_str!("../../../daemon/singletrackd.example.toml");
        let mut file: toml::Table = toml::from_str(example).unwrap();
        let text = format!("enabled = true\nexpected = {expected}\n{more}");
        file.insert(
            "neighbours".to_owned(),
            toml::from_str::<toml::Table>(&text).unwrap().into(),
        );
        let result = Config::from_toml(&toml::to_string(&file).unwrap());
        result.map_or_else(|error| error.to_string(), |_| String::new())
    }

    #[test]
    fn cars_that_can_not_be_kept_apart_from_are_refused_with_what_to_change() {
        for (expected, more, fix) in [
            ("[\"car2\"]", "", "safety_filter.enabled = true"),
            ("[\"car\"]", "", "this car's own body"),
            (
                "[\"car2\"]",
                "ignored = [\"car2\"]",
                "neighbours.ignored too",
            ),
        ] {
            let error = refused(expected, more);
            assert!(
                error.contains("neighbours.expected") && error.contains(fix),
                "{error}"
            );
        }
        assert_eq!(refused("[]", ""), "");
    }
}
