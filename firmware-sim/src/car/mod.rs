//! The car: actuators, dynamics and sensors; its steering servo and its attitude; its parameters,
//! and what is true of it.

mod hands;
mod imu;
mod motor;
mod motor_sensor;
mod vehicle;

use libm::{sincos, sqrt};
use serde::{Deserialize, Serialize};
use singletrack_control::{
    Axles, RelaxedSingleTrack, SingleTrackState, SlipAngles, SteeringMap, SteeringTable, Tyres,
    VehicleParameters,
};
use singletrack_protocol::{ImuAxes, ImuAxis};
use singletrack_settings::section;
use singletrack_simavr::product;

use crate::ranges::{LAG, NOT_NEGATIVE, POSITIVE};

pub use hands::HandMotion;
pub(crate) use imu::Imu;
pub use imu::{ImuFault, ImuParameters};
pub use motor::{BatteryParameters, EscKind, MotorParameters, Push};
pub use motor_sensor::{MotorPulses, MotorSensorFault, MotorSensorParameters};
pub use vehicle::Car;

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

section! {
    /// True mapping of the steering servo from pulses to angles, and its dynamics.
    ///
    /// The defaults are the nominal calibration. To test calibration errors, change
    /// these values and keep the board's configuration.
    "car.servo" => pub ServoParameters;
    [default];

    /// Pulse for zero steering angle, in µs.
    centre_us: f64 = 1500.0;
    /// Pulse change per radian to the left, in µs/rad.
    gain_us_per_rad: f64 = -800.0, in in_words("finite and not zero", |x| x != 0.0);
    /// Angles over pulses, instead of that line.
    table: Option<SteeringTable> = None;
    /// Mechanical stop on both sides, in rad.
    stop_rad: f64 = 0.55, in in_words("between 0 and 1.5", |x| x > 0.0 && x < 1.5);
    /// Time constant of the first-order lag, in s.
    lag_s: f64 = 0.04, in LAG;
    /// Largest steering rate, in rad/s.
    max_rate_rad_s: f64 = 8.0, in POSITIVE;
    // The servo can measure a pulse only at its end.
    /// Time from the start of a pulse to the servo's response, in µs.
    dead_time_us: u64 = 2_000;
    /// Play: a change of direction moves the wheels only after this change of the
    /// pulse, in µs.
    backlash_us: f64 = 0.0, in NOT_NEGATIVE;
    /// From this time on the wheels keep their angle, in s.
    stuck_from_s: Option<f64> = None, in NOT_NEGATIVE;
    /// From this time on the horn has slipped, in s...
    slips_at_s: Option<f64> = None, in NOT_NEGATIVE;
    /// ...by this angle of the wheels, to the left, in rad.
    slip_rad: f64 = 0.05;
}

impl ServoParameters {
    /// Target angle of a pulse, in rad, within the mechanical stops.
    pub fn target(&self, pulse_us: u16) -> f64 {
        self.angle(f64::from(pulse_us))
    }

    fn angle(&self, pulse_us: f64) -> f64 {
        let stop_rad = self.stop_rad;
        self.free_angle(pulse_us).clamp(-stop_rad, stop_rad)
    }

    /// The angle of a pulse without the mechanical stops, in rad.
    pub(crate) fn free_angle(&self, pulse_us: f64) -> f64 {
        match &self.table {
            Some(table) => table.angle(pulse_us),
            None => (pulse_us - self.centre_us) / self.gain_us_per_rad,
        }
    }

    /// Follows this map without an error.
    pub fn follow(&mut self, map: &SteeringMap) {
        (self.centre_us, self.gain_us_per_rad) = (map.centre_us, map.gain_us_per_rad);
        self.table.clone_from(&map.table);
    }

    /// Target angle after a further pulse, in rad; `held_us` is the pulse that the
    /// wheels stand for.
    pub(crate) fn target_with_backlash(&self, held_us: &mut f64, pulse_us: u16) -> f64 {
        let pulse_us = f64::from(pulse_us);
        let half = self.backlash_us / 2.0;
        *held_us = held_us.clamp(pulse_us - half, pulse_us + half);
        self.angle(*held_us)
    }

    /// Steering rate towards a target, in rad/s.
    pub fn rate(&self, steering: f64, target: f64) -> f64 {
        ((target - steering) / self.lag_s).clamp(-self.max_rate_rad_s, self.max_rate_rad_s)
    }
}

/// Pulses beyond which no board steers, in µs.
pub const WIDE_US: [f64; 2] = [500.0, 2_500.0];

/// Pairs of pulse in µs and angle in rad between two pulses, for steering that differs from a line
/// with this centre in µs and gain in µs/rad: the wheels turn farther to the left by a fraction,
/// as much less far to the right, and there is a dead band of a width in µs.
pub fn crooked_steering(
    [centre_us, gain_us_per_rad]: [f64; 2],
    [first_us, last_us]: [f64; 2],
    [farther, band_us]: [f64; 2],
) -> Vec<[f64; 2]> {
    let half = 0.5 * band_us;
    let pair = |pulse_us: f64| {
        let beyond = pulse_us - centre_us;
        let angle = (beyond - beyond.clamp(-half, half)) / gain_us_per_rad;
        [pulse_us, angle * (1.0 + farther * angle.signum())]
    };
    let mut pulses = vec![first_us, centre_us - half, centre_us + half, last_us];
    pulses.dedup();
    pulses.into_iter().map(pair).collect()
}

/// A tilt beyond this is not small, in rad.
const SMALL: f64 = 0.1;

/// The unit quaternion w, x, y, z of a yaw after a roll and a pitch, in rad, of which only
/// one is not small.
pub(crate) fn quaternion_wxyz(yaw: f64, roll: f64, pitch: f64) -> [f64; 4] {
    let (s, c) = sincos(yaw / 2.0);
    let (mut a, mut b) = (roll / 2.0, pitch / 2.0);
    let half = libm::hypot(a, b);
    if 2.0 * half > SMALL {
        let scale = libm::tan(half) / half;
        (a, b) = (a * scale, b * scale);
    }
    let norm = sqrt(1.0 + a * a + b * b);
    [c, a * c - b * s, a * s + b * c, s].map(|part| part / norm)
}

/// How a sensor is turned on the car: a quaternion w, x, y, z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rotation([f64; 4]);

impl Rotation {
    /// Roll, pitch and yaw, in degrees; `None` if all are zero.
    pub(crate) fn from_degrees(angles: [f64; 3]) -> Option<Self> {
        if angles == [0.0; 3] {
            return None;
        }
        let [(sr, cr), (sp, cp), (sy, cy)] = angles.map(|angle| sincos(angle.to_radians() / 2.0));
        let about_z = [cy, 0.0, 0.0, sy];
        let about_y = [cp, 0.0, sp, 0.0];
        let about_x = [cr, sr, 0.0, 0.0];
        Some(Self(product(product(about_z, about_y), about_x)))
    }

    /// A vector of the car along the turned axes.
    pub(crate) fn into_turned(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [w, a, b, c] = self.0;
        let inverse = [w, -a, -b, -c];
        let [_, x, y, z] = product(product(inverse, [0.0, x, y, z]), self.0);
        [x, y, z]
    }

    /// The attitude of the turned axes on a car with this attitude.
    pub(crate) fn after(self, car_wxyz: [f64; 4]) -> [f64; 4] {
        product(car_wxyz, self.0)
    }
}

/// The angles of a sensor whose axes are mounted so.
pub(crate) fn mounting_deg(axes: ImuAxes) -> [f64; 3] {
    let direction = |axis: ImuAxis| {
        let mut direction = [0.0; 3];
        direction[usize::from(axis.index())] = if axis.is_negative() { -1.0 } else { 1.0 };
        direction
    };
    let right_angles = || [0.0, 90.0, 180.0, 270.0].into_iter();
    let mut mountings = right_angles().flat_map(|roll| {
        right_angles().flat_map(move |pitch| right_angles().map(move |yaw| [roll, pitch, yaw]))
    });
    mountings
        .find(|&angles| {
            // Without a rotation the axes are those of the car.
            let turned = |axis: [f64; 3]| {
                Rotation::from_degrees(angles).map_or(axis, |mounting| mounting.into_turned(axis))
            };
            [
                ([1.0, 0.0, 0.0], axes.forward),
                ([0.0, 1.0, 0.0], axes.left),
                ([0.0, 0.0, 1.0], axes.up),
            ]
            .into_iter()
            .all(|(axis, chip)| {
                let error = turned(axis).into_iter().zip(direction(chip));
                error.into_iter().all(|(a, b)| (a - b).abs() < 1e-6)
            })
        })
        // A left-handed set of axes, which the board refuses.
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use libm::{cos, sin};

    use super::*;

    #[test]
    fn crooked_steering_turns_farther_to_one_side_and_rests_in_its_dead_band() {
        let pairs = |farther, band| {
            crooked_steering([1_500.0, -800.0], [1_100.0, 1_900.0], [farther, band])
        };
        let crooked = [[1_100.0, 0.6], [1_500.0, 0.0], [1_900.0, -0.4]];
        assert_eq!(pairs(0.2, 0.0), crooked);
        let table = SteeringTable::new(&pairs(0.2, 80.0)).unwrap();
        for (pulse, angle) in [
            (1_460.0, 0.0),
            (1_540.0, 0.0),
            (1_380.0, 0.12),
            (1_620.0, -0.08),
        ] {
            assert!((table.angle(pulse) - angle).abs() < 1e-12, "{pulse}");
        }
    }

    #[test]
    fn backlash_is_lost_at_each_change_of_direction() {
        let servo = ServoParameters {
            backlash_us: 20.0,
            ..ServoParameters::default()
        };
        let mut held = servo.centre_us;
        let mut angle_us = |pulse| {
            let target = servo.target_with_backlash(&mut held, pulse);
            servo.centre_us + target * servo.gain_us_per_rad
        };
        for (pulse, wheels) in [
            (1_510, 1_500.0),
            (1_600, 1_590.0),
            (1_585, 1_590.0),
            (1_500, 1_510.0),
        ] {
            assert!((angle_us(pulse) - wheels).abs() < 1e-9, "{pulse}");
        }
    }

    #[test]
    fn the_quaternion_has_unit_length_and_rotates_by_the_yaw() {
        for yaw in [-3.0, -0.5, 0.0, 1.0, 2.5, 7.0] {
            let [w, x, y, z] = quaternion_wxyz(yaw, 0.01, -0.02);
            assert!((w * w + x * x + y * y + z * z - 1.0).abs() < 1e-12);
            // The forward axis, rotated.
            let forward = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)];
            assert!((forward[0] - cos(yaw)).abs() < 1e-3);
            assert!((forward[1] - sin(yaw)).abs() < 1e-3);
        }
    }

    #[test]
    fn all_mountings_at_right_angles_have_angles() {
        use singletrack_protocol::ImuAxis::{MinusX, MinusY, MinusZ, PlusX, PlusY, PlusZ};
        let axes = [PlusX, MinusX, PlusY, MinusY, PlusZ, MinusZ];
        let mut found = 0;
        for forward in axes {
            for left in axes {
                for up in axes {
                    let mounting = ImuAxes { forward, left, up };
                    found += u32::from(mounting_deg(mounting) != [0.0; 3]);
                }
            }
        }
        // And the one without a turn.
        assert_eq!(found, 23);
        let turned = ImuAxes {
            forward: MinusY,
            left: PlusX,
            up: PlusZ,
        };
        assert_eq!(mounting_deg(turned), [0.0, 0.0, 90.0]);
    }
}
