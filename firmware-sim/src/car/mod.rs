//! The car: actuators, dynamics and sensors; its parameters, and what is true of it.

mod hands;
mod imu;
mod motor;
mod motor_sensor;
mod servo;
mod vehicle;

use libm::sincos;
use serde::{Deserialize, Serialize};
use singletrack_control::{
    Axles, RelaxedSingleTrack, SingleTrackState, SlipAngles, Tyres, VehicleParameters,
};

pub use hands::HandMotion;
pub use imu::{ImuFault, ImuParameters, ImuReading};
pub use motor::{BatteryParameters, EscKind, MotorParameters, Push};
pub use motor_sensor::{MotorPulses, MotorSensorFault, MotorSensorParameters};
pub use servo::{ServoParameters, WIDE_US, crooked_steering};
pub use vehicle::Car;

pub(crate) use imu::Imu;

/// Parameters of the car.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CarParameters {
    /// Masses, lengths, tyres.
    pub vehicle: VehicleParameters,
    /// The curve of the lateral forces over the slip angles.
    pub tyre_curve: Tyres,
    /// How slip angles and forces follow from sideslip and steering.
    pub slip_angles: SlipAngles,
    /// The steering servo.
    pub servo: ServoParameters,
    /// ESC, motor and gears.
    pub motor: MotorParameters,
    /// The motor's pulse sensor.
    pub motor_sensor: MotorSensorParameters,
    /// The inertial measurement unit.
    pub imu: ImuParameters,
    /// The battery.
    pub battery: BatteryParameters,
    /// Initial pose of the car.
    pub start: StartPose,
    /// The plugs of servo and ESC have been exchanged: each gets the other's pulses.
    pub swapped_wires: bool,
}

impl CarParameters {
    /// The vehicle model.
    fn model(&self) -> RelaxedSingleTrack {
        let axles = Axles::new(self.vehicle, self.tyre_curve);
        RelaxedSingleTrack::with_axles(axles.with_slip_angles(self.slip_angles))
    }
}

/// Initial pose of the car.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StartPose {
    /// Position of the centre of mass along x, in m.
    pub x_m: f64,
    /// Position of the centre of mass along y, in m.
    pub y_m: f64,
    /// Yaw, in rad.
    pub yaw_rad: f64,
}

/// Ground truth at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Simulation time, in µs.
    pub time_us: u64,
    /// Position of the centre of mass G along x, in m.
    pub x: f64,
    /// Position of the centre of mass G along y, in m.
    pub y: f64,
    /// Yaw, in rad, not wrapped.
    pub yaw: f64,
    /// Yaw rate, in rad/s.
    pub yaw_rate: f64,
    /// Sideslip: the angle from the car's axis to the velocity of G, in rad.
    pub sideslip: f64,
    /// Steering angle of the front wheels, left positive, in rad.
    pub steering: f64,
    /// Speed of G along its course, reverse negative, in m/s.
    pub speed: f64,
    /// Speed of the rear wheels along the car, in m/s.
    pub wheel_speed: f64,
    /// Acceleration of G along the car, in m/s².
    pub longitudinal_acceleration: f64,
    /// Acceleration of G to the car's left, in m/s².
    pub lateral_acceleration: f64,
    /// Voltage at the battery's terminals, in V.
    pub battery_v: f64,
    /// Way of G so far, in m; it grows in both directions, but not in hands.
    pub way: f64,
    /// Roll on a slope or in hands, in rad; left side up is positive.
    pub roll: f64,
    /// Pitch on a slope or in hands, in rad; nose down is positive.
    pub pitch: f64,
    /// Whether the car is in hands or on a stand.
    pub held: bool,
    /// Height of the wheels above the floor, in m.
    pub height: f64,
    /// Rate of the roll, in rad/s.
    pub roll_rate: f64,
    /// Rate of the pitch, in rad/s.
    pub pitch_rate: f64,
}

impl Truth {
    /// The point P, `point_distance_m` beyond the front axle in the direction
    /// of the front wheels, when the front axle is `front_axle_distance_m`
    /// ahead of G: x and y in m.
    #[must_use]
    pub fn point_p(&self, front_axle_distance_m: f64, point_distance_m: f64) -> [f64; 2] {
        let (sin_yaw, cos_yaw) = sincos(self.yaw);
        let (sin_course, cos_course) = sincos(self.yaw + self.steering);
        [
            self.x + front_axle_distance_m * cos_yaw + point_distance_m * cos_course,
            self.y + front_axle_distance_m * sin_yaw + point_distance_m * sin_course,
        ]
    }
}

/// The integrated state.
#[derive(Clone, Copy, Debug, Default)]
struct CarState {
    track: SingleTrackState,
    steering: f64,
    wheel_speed: f64,
}

impl CarState {
    fn plus(&self, d: &Self, h: f64) -> Self {
        let (a, b) = (&self.track, &d.track);
        Self {
            track: SingleTrackState {
                x: a.x + h * b.x,
                y: a.y + h * b.y,
                yaw: a.yaw + h * b.yaw,
                yaw_rate: a.yaw_rate + h * b.yaw_rate,
                sideslip: a.sideslip + h * b.sideslip,
            },
            steering: self.steering + h * d.steering,
            wheel_speed: self.wheel_speed + h * d.wheel_speed,
        }
    }
}
