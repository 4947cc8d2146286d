//! Whether a car can do what its configuration asks for.
//!
//! [`Config::validate`] refuses values that contradict each other. A valid configuration may
//! still ask for a circle that the wheels can't steer, or for one that leads out of the
//! geofence. [`judge`] finds that before the car moves. It is a pure function: `singletrackd
//! --check` prints what it returns, and other tools may call it.

mod drive;
mod values;

use core::{
    f64::consts::{FRAC_PI_4, PI},
    fmt,
};

use drive::{Car, Ended, Governed, SteadyCircle};
use serde::Serialize;
use singletrack_control::{GovernorConfig, Position, Reference, Velocity, direction, words, wrap};
use singletrack_pilot::{Fence, PilotConfig};
use singletrack_settings::ValueError;

use crate::config::{Config, ConfigError, ReferenceSection};

use values::warn_of_examples;
pub use values::warn_of_unusual;

/// Distance that the path must keep from the geofence beyond its margin, in m. The model of
/// [`judge`] knows no noise, no lag and no slip; the speed by which the watch judges errs by 4 cm/s
/// on a car that vibrates, which is up to 7 cm of a stop.
const RESERVE_M: f64 = 0.08;

/// The share of a drive in which a limit may be reached before it is a warning, and before
/// the reference counts as impossible.
const SATURATED_WARNING: f64 = 0.1;
const SATURATED_ERROR: f64 = 0.5;

/// A governed reference is followed for this many times its time at most, to judge the geofence.
const LONGER: f64 = 3.0;

/// The first metre takes no longer, in s; a slower reference is never proved.
const FIRST_METRE_S: f64 = 10.0;

/// A governed reference that is nearer to its path than this, in m, counts as on it.
const BESIDE_M: f64 = 0.01;

words! {
    /// Whether the car can drive in spite of a finding.
    pub enum Severity {
        /// It can drive; the value should be looked at.
        Warning = "warning",
        /// It can't do what is asked.
        Impossible = "impossible",
    }
}

/// A value of the configuration that should be changed: key, value and fix.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Whether the car can drive in spite of it.
    pub severity: Severity,
    /// Key or section, value, and what is wrong with it and what to do.
    pub what: ValueError,
}

impl Finding {
    /// A finding about a value that should be looked at.
    pub fn warning(key: &'static str, value: impl fmt::Display, fix: impl Into<String>) -> Self {
        Self::new(Severity::Warning, key, value, fix)
    }

    /// A finding about a value with which the car can't do what is asked.
    fn impossible(key: &'static str, value: impl fmt::Display, fix: impl Into<String>) -> Self {
        Self::new(Severity::Impossible, key, value, fix)
    }

    fn new(
        severity: Severity,
        key: &'static str,
        value: impl fmt::Display,
        fix: impl Into<String>,
    ) -> Self {
        Self {
            severity,
            what: ValueError::new(key, value, fix),
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.what.fmt(formatter)
    }
}

/// Where a car stands with straight wheels: its centre of mass, and its heading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Stand {
    /// Position of the centre of mass, in m.
    pub x_m: f64,
    /// Position of the centre of mass, in m.
    pub y_m: f64,
    /// Heading, in rad.
    pub yaw_rad: f64,
}

impl fmt::Display for Stand {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "centre of mass at ({:.2}, {:.2}) m, heading {:.0} degrees",
            self.x_m,
            self.y_m,
            self.yaw_rad.to_degrees()
        )
    }
}

/// What [`judge`] found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Judgement {
    /// The findings; empty if there is nothing to say.
    pub findings: Vec<Finding>,
    /// A place from which the car drives its reference inside the geofence: where it stands, or
    /// else another one. `None` if there is none, or if the reference comes from outside.
    pub start: Option<Stand>,
}

impl Judgement {
    /// Whether the car can do what is asked.
    pub fn is_possible(&self) -> bool {
        self.findings
            .iter()
            .all(|finding| finding.severity == Severity::Warning)
    }
}

/// Judges a valid configuration. With `stand`, the geofence is judged from where the car
/// stands, otherwise from where it could start.
///
/// The car of the judgement follows the law without slip, lag and noise: what it can't do,
/// a real car can't do. With `[governor]` it follows the governed reference. Unless
/// `supervisor.prove_first_metre` is off, it must come over the first metre with the speed and the
/// braking of an unproved configuration as well.
///
/// # Errors
///
/// The configuration is invalid, or its waypoints can't be read.
pub fn judge(config: &Config, stand: Option<Stand>) -> Result<Judgement, ConfigError> {
    let mut judgement = judge_reference(config, stand, None)?;
    let mut findings = Vec::new();
    warn_of_examples(config, &mut findings);
    warn_of_unusual(config, &mut findings);
    findings.append(&mut judgement.findings);
    judgement.findings = findings;
    Ok(judgement)
}

/// Judges only whether the car can drive its reference, for `longest_s` at most; values that
/// were left as in the example are not reported. It takes 10 to 300 ms, and with a governor up to
/// some seconds: call it off the control thread. With `[tuning]` it takes up to five times as long:
/// the car must also be able to drive with the values at the ends of their bounds.
///
/// # Errors
///
/// The errors of [`judge`].
pub fn judge_reference(
    config: &Config,
    stand: Option<Stand>,
    longest_s: Option<f64>,
) -> Result<Judgement, ConfigError> {
    config.validate()?;
    let mut judgement = judge_untuned(config, stand, longest_s)?;
    if judgement.is_possible() {
        for extreme in config.extremes() {
            let found = judge_untuned(&extreme.config, stand, longest_s)?.findings;
            let impossible = found
                .into_iter()
                .filter(|finding| finding.severity == Severity::Impossible);
            judgement.findings.extend(impossible.map(|finding| {
                let fix = format!("with {}: {finding}; or narrow the bounds", extreme.place);
                Finding::impossible(extreme.key, &extreme.bounds, fix)
            }));
        }
    }
    Ok(judgement)
}

/// Judges with the values as they are.
fn judge_untuned(
    config: &Config,
    stand: Option<Stand>,
    longest_s: Option<f64>,
) -> Result<Judgement, ConfigError> {
    let pilot = &config.pilot()?;
    let mut judgement = Judgement::default();
    if matches!(config.reference, ReferenceSection::External { .. }) {
        return Ok(judgement);
    }
    let drive = Drive { config, pilot };
    drive.judge_reference(&mut judgement.findings);
    // Where the reference can't be steered, the geofence is not the problem.
    if judgement.is_possible() {
        drive.judge_fence(stand, longest_s, &mut judgement);
    }
    Ok(judgement)
}

/// A drive as it is asked for.
struct Drive<'a> {
    config: &'a Config,
    pilot: &'a PilotConfig,
}

impl Drive<'_> {
    /// Tells where the car can't follow the reference, wherever that is.
    fn judge_reference(&self, findings: &mut Vec<Finding>) {
        let pilot = self.pilot;
        let governor = pilot.governor.as_ref();
        let governor = governor.filter(|_| pilot.governor().is_some());
        let governed = governor.and_then(|governor| self.judge_governed(governor, findings));
        if let Some((circle, asked)) = self.circle(governor.zip(governed)) {
            let rear = circle.judge_radius(asked, findings);
            if let Some(rear) = rear.filter(|_| governed.is_none()) {
                circle.judge_pace(rear, findings);
            }
        } else if governor.is_none() {
            self.judge_saturation(findings);
        }
    }

    /// The circle that is asked for, as it is governed, and the radius that is asked for, m.
    fn circle(
        &self,
        governed: Option<(&GovernorConfig, Governed)>,
    ) -> Option<(SteadyCircle<'_>, f64)> {
        let ReferenceSection::Circle {
            radius_m,
            angular_velocity_rad_s,
            ..
        } = self.config.reference
        else {
            return None;
        };
        let rate = angular_velocity_rad_s.abs();
        let (radius, rate) = match governed {
            Some((governor, governed)) => (
                radius_m.max(governor.least_radius()),
                rate / governed.longer,
            ),
            None => (radius_m, rate),
        };
        let circle = SteadyCircle::of(self.config, &self.pilot.limits, radius, rate);
        Some((circle, radius_m))
    }

    fn car(&self, start: Stand) -> Car {
        Car::new(self.pilot, &self.config.vehicle, start)
    }

    fn margin_m(&self) -> f64 {
        self.config.fence.margin_m(&self.config.vehicle)
    }

    /// Tells what the governor makes of the reference.
    fn judge_governed(
        &self,
        governor: &GovernorConfig,
        findings: &mut Vec<Finding>,
    ) -> Option<Governed> {
        let start = self.starts_on(&self.pilot.reference).next()?;
        let governed = self.car(start).governed();
        let Some(by) = governed.by else {
            return Some(governed);
        };
        let Governed { longer, beside, .. } = governed;
        let asks = format!("the reference asks too much ({by})");
        let wide = if beside > BESIDE_M {
            format!(
                ", and P is led up to {beside:.2} m beside the path (the smallest circle that it \
                 is led on has a radius of {:.2} m)",
                governor.least_radius()
            )
        } else {
            String::new()
        };
        findings.push(if governed.waits {
            let corners = self.pilot.fence.corners().iter();
            let corners: Vec<_> = corners.map(|at| [at.x, at.y]).collect();
            let fix = "the reference leads out of it, and governed it waits there for ever; widen \
                       the fence, or give a reference that stays inside";
            Finding::impossible("fence.corners_m", format!("{corners:?}"), fix)
        } else if governed.ends {
            let fix = format!(
                "{asks}: governed it takes {longer:.1} times as long{wide}; give a slower or wider \
                 one to have it followed as it is"
            );
            Finding::warning("governor.enabled", true, fix)
        } else {
            let fix = format!(
                "{asks}, and governed it does not come to its end{wide}; give a slower or wider one"
            );
            Finding::impossible("governor.enabled", true, fix)
        });
        Some(governed)
    }

    /// For how much of the drive a limit is in the way of the reference.
    fn judge_saturation(&self, findings: &mut Vec<Finding>) {
        let Some(start) = self.starts_on(&self.pilot.reference).next() else {
            return;
        };
        let limits = &self.pilot.limits;
        let shares = self.car(start).saturated();
        for (share, (key, value, what)) in shares.into_iter().zip([
            ("limits.max_steering_rad", limits.max_steering, "steering"),
            ("limits.max_speed_m_s", limits.max_speed, "speed"),
            (
                "limits.max_lateral_acceleration_m_s2",
                limits.max_lateral_acceleration,
                "lateral acceleration",
            ),
        ]) {
            let severity = match share {
                share if share > SATURATED_ERROR => Severity::Impossible,
                share if share > SATURATED_WARNING => Severity::Warning,
                _ => continue,
            };
            let fix = format!(
                "the reference keeps the {what} at this limit for {:.0} % of the drive; give a \
                 slower or wider reference",
                100.0 * share
            );
            findings.push(Finding::new(severity, key, value, fix));
        }
    }

    fn judge_fence(&self, stand: Option<Stand>, longest_s: Option<f64>, judgement: &mut Judgement) {
        let pilot = self.pilot;
        let until = duration(&pilot.reference);
        // A governed reference may take longer.
        let longest = longest_s.unwrap_or(LONGER * until);
        let ends = |fence: &Fence, start| match self.car(start).drive(fence, until, longest) {
            Ended::Inside if pilot.supervisor.prove => self
                .car(start)
                .drive_first_metre(fence, longest.min(FIRST_METRE_S)),
            ended => ended,
        };
        let left = stand.map(|stand| (stand, ends(&pilot.fence, stand)));
        if let Some((stand, Ended::Inside)) = left {
            judgement.start = Some(stand);
            return;
        }
        // Where the reference would begin from here, the way to carry the car is short.
        let reference = stand.map_or_else(|| pilot.reference.clone(), |stand| begun(pilot, stand));
        let candidates = || {
            let inside = starts_inside(&pilot.fence, heading(&reference));
            self.starts_on(&reference).chain(inside)
        };
        let find = |fence: &Fence| candidates().find(|start| ends(fence, *start) == Ended::Inside);
        let with_reserve = Fence::new(pilot.fence.corners(), self.margin_m() + RESERVE_M);
        let safe = with_reserve.ok().as_ref().and_then(find);
        judgement.start = safe.or_else(|| find(&pilot.fence));
        let finding = match (left, judgement.start) {
            (Some((stand, left)), Some(place)) => Some(self.elsewhere(&left, stand, place)),
            (Some((stand, left)), None) => Some(self.leaves(&left, Some(stand))),
            (None, Some(_)) if safe.is_some() => None,
            (None, Some(_)) => {
                let value = format!("less than {RESERVE_M} m from the car's path");
                let fix = "noise and lag of a real car take it out; widen the fence or choose a \
                           smaller reference";
                Some(Finding::warning("fence.corners_m", value, fix))
            }
            (None, None) => self.too_large().or_else(|| {
                // The attempt that lasted longest explains best where the fence is too narrow.
                let longest = candidates()
                    .map(|start| ends(&pilot.fence, start))
                    .max_by(|a, b| a.time().total_cmp(&b.time()));
                longest.map(|left| self.leaves(&left, None))
            }),
        };
        judgement.findings.extend(finding);
    }

    /// The car can't drive from where it stands, but from another place.
    fn elsewhere(&self, ended: &Ended, stand: Stand, place: Stand) -> Finding {
        let shorter = match self.pilot.reference {
            Reference::Circle(_) => "",
            _ => ", or drive for a shorter time",
        };
        let fix = format!(
            "from here ({stand}) {}. Carry it to ({:.2}, {:.2}) m, {:.0} degrees{shorter}",
            ended.how(),
            place.x_m,
            place.y_m,
            place.yaw_rad.to_degrees()
        );
        Finding::impossible("reference.start", self.pilot.start, fix)
    }

    fn leaves(&self, ended: &Ended, stand: Option<Stand>) -> Finding {
        let from = match stand {
            Some(stand) => format!("from here ({stand})"),
            None => "from every start inside it".to_owned(),
        };
        let (circle, shorter) = match self.config.reference {
            ReferenceSection::Circle { .. } => (
                " (the smallest circle that the car can drive may still be too large)",
                "",
            ),
            _ => ("", ", or for a shorter time"),
        };
        let fix = format!(
            "{from} {}. Widen the fence, lower fence.margin_m = {} if the car is shorter, move or \
             shrink the reference{circle}, or drive more slowly{shorter}",
            ended.how(),
            self.margin_m()
        );
        let corners = format!("{:?}", self.config.fence.corners_m);
        Finding::impossible("fence.corners_m", corners, fix)
    }

    /// A circle that the fence has no room for, however the car comes to it.
    fn too_large(&self) -> Option<Finding> {
        let ReferenceSection::Circle {
            centre_m: [x, y], ..
        } = self.config.reference
        else {
            return None;
        };
        let (circle, radius_m) = self.circle(None)?;
        let room = self.pilot.fence.clearance(&Position::new(x, y));
        let centre_of_mass = circle.centre_of_mass()?;
        // Where no circle fits, the fence is too small.
        let most = circle.largest(room)?;
        (centre_of_mass > room).then(|| {
            let fix = format!(
                "the centre of mass drives a circle of {centre_of_mass:.2} m, and fence.corners_m \
                 leaves {room:.2} m around ({x}, {y}) m within fence.margin_m = {}; give {most:.2} \
                 or less, move reference.centre_m, or widen the fence",
                self.margin_m()
            );
            Finding::impossible("reference.radius_m", radius_m, fix)
        })
    }

    /// Stands with P at the start of the reference or a little behind it, looking along it.
    fn starts_on(&self, reference: &Reference) -> impl Iterator<Item = Stand> + use<> {
        let heading = heading(reference);
        // Without a position the car may start anywhere.
        let first = reference.at(0.0).position.unwrap_or_default();
        let law = &self.pilot.law;
        let ahead = self.config.vehicle.front_axle_distance_m + law.point_distance();
        let turns = [0.0, -0.25, 0.25, -0.5, 0.5, -0.75, 0.75];
        turns.into_iter().flat_map(move |turn| {
            [0.0, 0.15, 0.3].into_iter().map(move |behind| {
                let yaw = heading + turn;
                let centre = first - (ahead + behind) * direction(yaw);
                Stand {
                    x_m: centre.x,
                    y_m: centre.y,
                    yaw_rad: wrap(yaw),
                }
            })
        })
    }
}

/// The reference of a drive from there.
fn begun(pilot: &PilotConfig, stand: Stand) -> Reference {
    let centre = Position::new(stand.x_m, stand.y_m);
    let point = pilot.law.point(centre, stand.yaw_rad, 0.0);
    let mut reference = pilot.reference.clone();
    reference.begin(pilot.start, &point, stand.yaw_rad);
    reference
}

/// The direction in which the reference begins, rad.
fn heading(reference: &Reference) -> f64 {
    let first = reference.at(0.0);
    // It may stand at its very beginning.
    let way = match (first.position, reference.at(0.5).position) {
        (Some(first), Some(later)) => later - first,
        _ => first.velocity,
    };
    libm::atan2(way.y, way.x)
}

/// A grid of stands in the box around the geofence; [`Car::drive`] refuses those outside.
fn starts_inside(fence: &Fence, heading: f64) -> impl Iterator<Item = Stand> + use<> {
    const STEPS: usize = 7;
    let corners = fence.corners();
    let least = |part: fn(&Position) -> f64| corners.iter().map(part).fold(f64::MAX, f64::min);
    let most = |part: fn(&Position) -> f64| corners.iter().map(part).fold(f64::MIN, f64::max);
    let low = Velocity::new(least(|corner| corner.x), least(|corner| corner.y));
    let high = Velocity::new(most(|corner| corner.x), most(|corner| corner.y));
    let place = move |low: f64, high: f64, step: usize| {
        low + (high - low) * (step as f64 + 0.5) / STEPS as f64
    };
    (0..STEPS * STEPS).flat_map(move |cell| {
        (0..8_u8).map(move |turn| Stand {
            x_m: place(low.x, high.x, cell % STEPS),
            y_m: place(low.y, high.y, cell / STEPS),
            yaw_rad: wrap(heading + f64::from(turn) * FRAC_PI_4),
        })
    })
}

/// How long a reference is followed, in s: two turns of one that never ends.
fn duration(reference: &Reference) -> f64 {
    const LONGEST_S: f64 = 60.0;
    let period = match reference {
        Reference::Circle(circle) => 2.0 * PI / circle.angular_velocity().abs().max(0.01),
        Reference::Path(path) => path.lap_time(),
        _ => LONGEST_S / 2.0,
    };
    reference.duration().unwrap_or(2.0 * period).min(LONGEST_S)
}
