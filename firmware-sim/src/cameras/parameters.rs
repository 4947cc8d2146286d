//! What can be set of the cameras and of the tracked bodies, and the schedules of marker losses:
//! periodic (`200ms@2s`) and single.

use core::{fmt, str::FromStr};

use libm::{cos, sin};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use singletrack_control::words;
use singletrack_mocap::UpAxis;
use singletrack_settings::section;

use crate::ranges::{FINITE, NOT_NEGATIVE, PERIOD, POSITIVE};

section! {
    /// The cameras and the tracked bodies.
    "cameras" => pub CameraParameters;
    [default];

    /// Time between exposures on the server's clock, in µs.
    period_us: u64 = 10_000, in PERIOD;
    /// Time of the first exposure on the server's clock since its start, in µs.
    phase_us: u64 = 6_300;
    /// Reading of the server's clock at simulation time zero, in µs.
    clock_offset_us: u64 = 86_400_000_000;
    /// Rate error of the server's clock, in ppm; positive is fast.
    clock_skew_ppm: i32 = 40;
    /// Mean time from mid-exposure to the packet on the network, in µs.
    latency_us: u64 = 8_000;
    /// Standard deviation of that time, in µs; truncated at three deviations.
    latency_jitter_us: u64 = 300;
    /// Standard deviation of each coordinate, in m.
    position_noise_m: f64 = 0.000_2, in NOT_NEGATIVE;
    // 0.1 degrees.
    /// Standard deviation of roll, pitch and yaw, in rad.
    orientation_noise_rad: f64 = 0.001_745, in NOT_NEGATIVE;
    /// The axes in which poses are streamed.
    up_axis: UpAxis = UpAxis::Y;
    /// The car's rigid body.
    car: CarBody = CarBody::default();
    /// Further rigid bodies, which do not move.
    decoys: Vec<DecoyBody> = vec![
        DecoyBody {
            name: "wand".to_owned(),
            id: 3,
            position_m: [3.0, 2.0, 1.0],
        },
        DecoyBody {
            name: "carrier".to_owned(),
            id: 17,
            position_m: [-2.5, 2.5, 0.2],
        },
    ];
    /// Periodic losses.
    loss: Option<LossPattern> = None;
    /// Single losses.
    loss_windows: Vec<LossWindow> = Vec::new();
    /// Representation of a loss on the wire.
    loss_kind: LossKind = LossKind::Occluded;
    /// Error of the mid-exposure stamps, in ms. Positive is late: the pose is older than
    /// its stamp, and the frame leaves later by as much.
    stamp_bias_ms: f64 = 0.0, in in_words("from -10000 to 10000", |x| x.abs() <= 10_000.0);
    /// Growth of that error since the start of the simulation, in ppm.
    stamp_drift_ppm: f64 = 0.0, in in_words("from -100000 to 100000", |x| x.abs() <= 100_000.0);
    /// The stream's poses of the car are those of another body: the first of `decoys`, or
    /// one at the origin.
    other_body: bool = false;
    /// From this time on the poses of the car are those of another body, in s.
    other_body_from_s: Option<f64> = None, in NOT_NEGATIVE;
    /// From this time on, for `frozen_ms`, the pose of the car repeats bit by bit in new
    /// frames, in s.
    frozen_from_s: Option<f64> = None, in NOT_NEGATIVE;
    /// Duration of that, in ms.
    frozen_ms: f64 = 1_000.0, in POSITIVE;
    /// From this time on, for good, the car's body is found turned by `flip_deg`, in s.
    flip_from_s: Option<f64> = None, in NOT_NEGATIVE;
    /// Angle about the up axis by which it is turned, in degrees.
    flip_deg: f64 = 180.0, in FINITE;
    /// From this time on somebody else sends frames from the server's own address, in s.
    forged_from_s: Option<f64> = None, in NOT_NEGATIVE;
    /// Position of the car in those frames less its true one, in m.
    forged_offset_m: [f64; 2] = [0.5, 0.0], in FINITE;
    /// Growth of that difference, in m/s.
    forged_drift_m_s: [f64; 2] = [0.0; 2], in FINITE;
}

impl CameraParameters {
    /// Ids and names of all bodies, in the order of the server's list.
    pub fn names(&self) -> impl Iterator<Item = (i32, &str)> {
        let decoys = self.decoys.iter();
        decoys
            .map(|decoy| (decoy.id, decoy.name.as_str()))
            .chain([(self.car.id, self.car.name.as_str())])
    }
}

/// The world's vector in the streamed axes.
pub(super) fn stream(up_axis: UpAxis, [x, y, z]: [f64; 3]) -> [f64; 3] {
    match up_axis {
        UpAxis::Y => [x, z, -y],
        UpAxis::Z => [x, y, z],
    }
}

section! {
    /// The car's rigid body: its name, and its pose on the car.
    "cameras.car" => pub CarBody;
    [default];

    /// Name in the model definitions.
    name: String = "car".to_owned();
    /// Streaming id.
    id: i32 = 11;
    /// Vector from the body's pivot to the centre of mass, forward and left along the
    /// body's axes, in m.
    to_centre_of_mass_m: [f64; 2] = [0.0, 0.0];
    /// Yaw of the body's axes relative to the car's, in rad.
    yaw_rad: f64 = 0.0;
    /// Height of the pivot above the floor, in m.
    height_m: f64 = 0.12;
}

impl CarBody {
    /// Position of the pivot from the centre of mass: forward, left, in m.
    pub fn pivot(&self) -> [f64; 2] {
        let [forward, left] = self.to_centre_of_mass_m;
        let (c, s) = (cos(self.yaw_rad), sin(self.yaw_rad));
        [-(c * forward - s * left), -(s * forward + c * left)]
    }

    /// Sets the position of the pivot from the centre of mass: forward, left, in m.
    pub fn set_pivot(&mut self, [forward, left]: [f64; 2]) {
        let (c, s) = (cos(self.yaw_rad), sin(self.yaw_rad));
        self.to_centre_of_mass_m = [-(c * forward + s * left), -(c * left - s * forward)];
    }

    /// Turns the body about its pivot to this yaw on the car, in rad.
    pub fn set_yaw(&mut self, yaw_rad: f64) {
        let pivot = self.pivot();
        self.yaw_rad = yaw_rad;
        self.set_pivot(pivot);
    }
}

/// A rigid body at a fixed position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecoyBody {
    /// Name in the model definitions.
    pub name: String,
    /// Streaming id.
    pub id: i32,
    /// Position in the world, in m.
    pub position_m: [f64; 3],
}

words! {
    /// Representation of a loss of the markers on the wire.
    #[derive(Default)]
    pub enum LossKind: serde {
        /// The body keeps its old pose and the tracking-valid bit is cleared.
        #[default]
        Occluded = "occluded",
        /// The body is not in the frame.
        Absent = "absent",
        /// No frame is sent.
        Silent = "silent",
    }
}

words! {
    /// What the cameras' server speaks.
    pub enum ServerKind {
        /// OptiTrack Motive.
        NatNet = "natnet",
        /// Vicon and many others.
        Vrpn = "vrpn",
        /// Qualisys Track Manager.
        Qualisys = "qualisys",
    }
}

/// Periodic losses: of `duration_us` at every multiple of `interval_us`, starting
/// at `interval_us`.
///
/// The text form is `DURATION@INTERVAL`, for example `200ms@2s`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LossPattern {
    /// Duration of a loss, in µs.
    pub duration_us: u64,
    /// Time between the starts of two losses, in µs.
    pub interval_us: u64,
}

/// Why a loss pattern or a duration is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct LossPatternError(String);

impl LossPattern {
    /// A pattern with a loss of `duration_us` at every multiple of `interval_us`.
    ///
    /// # Errors
    ///
    /// If one is zero, or the duration is not shorter than the interval.
    pub fn new(duration_us: u64, interval_us: u64) -> Result<Self, LossPatternError> {
        for (name, value) in [("duration", duration_us), ("interval", interval_us)] {
            if value == 0 {
                return Err(LossPatternError(format!(
                    "the {name} of a loss pattern must be at least 1 us; it is zero"
                )));
            }
        }
        if duration_us >= interval_us {
            let [duration_s, interval_s] = [duration_us, interval_us].map(|us| us as f64 / 1e6);
            return Err(LossPatternError(format!(
                "a loss of {duration_s} s at every {interval_s} s never ends: make the duration \
                 shorter than the interval"
            )));
        }
        Ok(Self {
            duration_us,
            interval_us,
        })
    }

    /// Whether the markers are lost this long after the pattern's epoch, in µs.
    pub const fn is_lost(&self, since_epoch_us: u64) -> bool {
        since_epoch_us >= self.interval_us && since_epoch_us % self.interval_us < self.duration_us
    }
}

impl FromStr for LossPattern {
    type Err = LossPatternError;

    fn from_str(text: &str) -> Result<Self, LossPatternError> {
        let form = || {
            LossPatternError(format!(
                "{text:?} is not a loss pattern: write DURATION@INTERVAL, for instance 200ms@2s"
            ))
        };
        let (duration, interval) = text.split_once('@').ok_or_else(form)?;
        if interval.contains('@') {
            return Err(form());
        }
        Self::new(parse_duration_us(duration)?, parse_duration_us(interval)?)
    }
}

/// Parses a duration such as `200ms`, `0.2s` or `1500us`; returns µs.
///
/// # Errors
///
/// The number is negative or not finite, or the unit is unknown.
pub fn parse_duration_us(text: &str) -> Result<u64, LossPatternError> {
    let error = || {
        LossPatternError(format!(
            "{text:?} is not a duration: write a number and one of us, ms, s, for instance 200ms or \
             0.2s"
        ))
    };
    let trimmed = text.trim();
    let (number, microseconds) = [("us", 1.0), ("µs", 1.0), ("ms", 1e3), ("s", 1e6)]
        .into_iter()
        .find_map(|(unit, scale)| Some((trimmed.strip_suffix(unit)?, scale)))
        .ok_or_else(error)?;
    let number = number.trim_end();
    let is_written = |byte: u8| byte.is_ascii_digit() || byte == b'.';
    if !number.bytes().all(is_written) {
        return Err(error());
    }
    let value = number.parse::<f64>().map_err(|_| error())? * microseconds;
    // A year exceeds any run, and is exact in f64.
    if value <= 3.2e13 {
        return Ok((value + 0.5) as u64);
    }
    Err(error())
}

/// Formats a duration in the largest unit without a fraction.
fn format_duration(microseconds: u64) -> String {
    match microseconds {
        us if us % 1_000_000 == 0 => format!("{}s", us / 1_000_000),
        us if us % 1_000 == 0 => format!("{}ms", us / 1_000),
        us => format!("{us}us"),
    }
}

impl fmt::Display for LossPattern {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [duration, interval] = [self.duration_us, self.interval_us].map(format_duration);
        write!(formatter, "{duration}@{interval}")
    }
}

impl Serialize for LossPattern {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for LossPattern {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

/// A single loss, in simulation time since the schedule's epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LossWindow {
    /// First microsecond of the loss.
    pub start_us: u64,
    /// First microsecond after it.
    pub end_us: u64,
}

impl LossWindow {
    /// Whether the markers are lost this long after the schedule's epoch, in µs.
    pub const fn is_lost(&self, since_epoch_us: u64) -> bool {
        self.start_us <= since_epoch_us && since_epoch_us < self.end_us
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_start_at_the_first_interval_and_repeat() {
        let pattern: LossPattern = "200ms@2s".parse().unwrap();
        for (ms, lost) in [
            (0, false),
            (199, false),
            (1_999, false),
            (2_000, true),
            (2_199, true),
            (2_200, false),
            (4_000, true),
            (39_999, false),
        ] {
            assert_eq!(pattern.is_lost(ms * 1_000), lost, "{ms} ms");
        }
    }

    #[test]
    fn patterns_round_trip_through_text() {
        for text in ["200ms@2s", "50ms@1s", "1500us@20ms", "1s@3s"] {
            assert_eq!(text.parse::<LossPattern>().unwrap().to_string(), text);
        }
        assert_eq!(
            "0.2s@2 s".parse::<LossPattern>(),
            LossPattern::new(200_000, 2_000_000)
        );
    }

    #[test]
    fn errors_contain_the_text_and_the_expected_form() {
        for (text, part) in [
            ("200ms", "DURATION@INTERVAL"),
            ("200ms@2s@3s", "DURATION@INTERVAL"),
            ("200@2s", "\"200\" is not a duration"),
            ("ms@2s", "\"ms\" is not a duration"),
            ("-1ms@2s", "\"-1ms\" is not a duration"),
            ("1e300s@2s", "\"1e300s\" is not a duration"),
            ("200ms@2h", "\"2h\" is not a duration"),
            ("0ms@2s", "duration of a loss pattern"),
            ("2s@2s", "never ends"),
        ] {
            let message = text.parse::<LossPattern>().unwrap_err().to_string();
            assert!(message.contains(part), "{text}: {message}");
        }
    }
}
