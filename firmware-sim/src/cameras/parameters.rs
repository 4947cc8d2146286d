//! What can be set of the cameras and of the tracked bodies.

use libm::{cos, sin};
use serde::{Deserialize, Serialize};
use singletrack_control::words;
use singletrack_mocap::UpAxis;
use singletrack_settings::section;

use crate::{
    loss::{LossPattern, LossWindow},
    ranges::{FINITE, NOT_NEGATIVE, PERIOD, POSITIVE},
};

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
