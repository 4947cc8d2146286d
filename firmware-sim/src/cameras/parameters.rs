//! What can be set of the cameras and of the tracked bodies.

use libm::{cos, sin};
use serde::{Deserialize, Serialize};

use crate::loss::{LossPattern, LossWindow};

/// The cameras and the tracked bodies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraParameters {
    /// Time between exposures on the server's clock, in µs.
    pub period_us: u64,
    /// Time of the first exposure on the server's clock since its start, in µs.
    pub phase_us: u64,
    /// Reading of the server's clock at simulation time zero, in µs.
    pub clock_offset_us: u64,
    /// Rate error of the server's clock, in ppm; positive is fast.
    pub clock_skew_ppm: i32,
    /// Mean time from mid-exposure to the packet on the network, in µs.
    pub latency_us: u64,
    /// Standard deviation of that time, in µs; truncated at three deviations.
    pub latency_jitter_us: u64,
    /// Standard deviation of each coordinate, in m.
    pub position_noise_m: f64,
    /// Standard deviation of roll, pitch and yaw, in rad.
    pub orientation_noise_rad: f64,
    /// The axes in which poses are streamed.
    pub up_axis: UpAxis,
    /// The car's rigid body.
    pub car: CarBody,
    /// Further rigid bodies, which do not move.
    pub decoys: Vec<DecoyBody>,
    /// Periodic losses.
    pub loss: Option<LossPattern>,
    /// Single losses.
    pub loss_windows: Vec<LossWindow>,
    /// Representation of a loss on the wire.
    pub loss_kind: LossKind,
    /// Error of the mid-exposure stamps, in ms. Positive is late: the pose is older than
    /// its stamp, and the frame leaves later by as much.
    pub stamp_bias_ms: f64,
    /// Growth of that error since the start of the simulation, in ppm.
    pub stamp_drift_ppm: f64,
    /// The stream's poses of the car are those of another body: the first of `decoys`, or
    /// one at the origin.
    pub other_body: bool,
    /// The same from this time on, in s.
    pub other_body_from_s: Option<f64>,
    /// From this time on, for `frozen_ms`, the pose of the car repeats bit by bit in new
    /// frames, in s.
    pub frozen_from_s: Option<f64>,
    /// Duration of that, in ms.
    pub frozen_ms: f64,
    /// From this time on, for good, the car's body is found turned by `flip_deg`, in s.
    pub flip_from_s: Option<f64>,
    /// Angle about the up axis by which it is turned, in degrees.
    pub flip_deg: f64,
    /// From this time on somebody else sends frames from the server's own address, in s.
    pub forged_from_s: Option<f64>,
    /// Position of the car in those frames less its true one, in m.
    pub forged_offset_m: [f64; 2],
    /// Growth of that difference, in m/s.
    pub forged_drift_m_s: [f64; 2],
}

impl Default for CameraParameters {
    fn default() -> Self {
        Self {
            period_us: 10_000,
            phase_us: 6_300,
            clock_offset_us: 86_400_000_000,
            clock_skew_ppm: 40,
            latency_us: 8_000,
            latency_jitter_us: 300,
            position_noise_m: 0.000_2,
            // 0.1 degrees.
            orientation_noise_rad: 0.001_745,
            up_axis: UpAxis::Y,
            car: CarBody::default(),
            decoys: vec![
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
            ],
            loss: None,
            loss_windows: Vec::new(),
            loss_kind: LossKind::Occluded,
            stamp_bias_ms: 0.0,
            stamp_drift_ppm: 0.0,
            other_body: false,
            other_body_from_s: None,
            frozen_from_s: None,
            frozen_ms: 1_000.0,
            flip_from_s: None,
            flip_deg: 180.0,
            forged_from_s: None,
            forged_offset_m: [0.5, 0.0],
            forged_drift_m_s: [0.0; 2],
        }
    }
}

/// The up axis of the streamed poses: a setting of the server that is not on
/// the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UpAxis {
    /// The server's default: the world's z is streamed as y.
    #[default]
    Y,
    /// The world's axes.
    Z,
}

impl UpAxis {
    /// The world's vector in the streamed axes.
    pub(super) fn stream(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Y => [x, z, -y],
            Self::Z => [x, y, z],
        }
    }
}

/// The car's rigid body: its name, and its pose on the car.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CarBody {
    /// Name in the model definitions.
    pub name: String,
    /// Streaming id.
    pub id: i32,
    /// Vector from the body's pivot to the centre of mass, forward and left along the
    /// body's axes, in m.
    pub to_centre_of_mass_m: [f64; 2],
    /// Yaw of the body's axes relative to the car's, in rad.
    pub yaw_rad: f64,
    /// Height of the pivot above the floor, in m.
    pub height_m: f64,
}

impl Default for CarBody {
    fn default() -> Self {
        Self {
            name: "car".to_owned(),
            id: 11,
            to_centre_of_mass_m: [0.0, 0.0],
            yaw_rad: 0.0,
            height_m: 0.12,
        }
    }
}

impl CarBody {
    /// Position of the pivot from the centre of mass: forward, left, in m.
    #[must_use]
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

/// Representation of a loss of the markers on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LossKind {
    /// The body keeps its old pose and the tracking-valid bit is cleared.
    #[default]
    Occluded,
    /// The body is not in the frame.
    Absent,
    /// No frame is sent.
    Silent,
}
