//! A car that differs from what is believed of it: the table `[truth]`, and the file of a
//! simulation, which may have it.
//!
//! Every key is optional. What is left out is as in the simulation's configuration, which
//! agrees with the default configuration of the daemon.

use std::{net::Ipv4Addr, path::Path};

use serde::{Deserialize, Serialize};

use singletrack_control::{SlipAngles, SteeringTable, Tyres};
use singletrack_mocap::UpAxis;
use singletrack_settings::{check, explain, in_words, section};

use crate::{
    board::BoardParameters,
    cameras::CameraParameters,
    car::{CarParameters, EscKind, Push},
    natnet_server::NatNetParameters,
    parameters::{ConfigError, SimulationConfig},
    wire::WireParameters,
};

/// A key of the table `[truth]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TruthKey {
    /// Name of the section, such as `servo`.
    pub section: &'static str,
    /// Name of the key.
    pub name: &'static str,
    /// Range of its numbers; empty if every value is valid.
    pub range: &'static str,
    /// Meaning.
    pub help: &'static str,
}

macro_rules! truth {
    ($(
        $(#[doc = $section_help:literal])+
        $section:ident: $Section:ident {
            $(
                $(#[doc = $help:literal])+
                $key:ident: $type:ty
                    $(, in $low:literal to $high:literal $(of $numbers:expr)?)?
                    $(=> $($field:ident).+)? $(=> |$config:ident, $value:ident| $apply:expr)?;
            )+
        }
    )+) => {
        /// What is true of a car, of its electronics and of the cameras.
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct CarTruth {
            $($(#[doc = $section_help])+ pub $section: $Section,)+
        }

        $(
            $(#[doc = $section_help])+
            #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
            #[serde(deny_unknown_fields, default)]
            pub struct $Section {
                $($(#[doc = $help])+ pub $key: Option<$type>,)+
            }
        )+

        /// All keys of the table `[truth]`, in the order of its sections.
        pub const TRUTH_KEYS: &[TruthKey] = &[
            $($(TruthKey {
                section: stringify!($section),
                name: stringify!($key),
                range: concat!($(stringify!($low), " to ", stringify!($high))?),
                help: concat!($($help),+),
            },)+)+
        ];

        impl CarTruth {
            /// Makes a simulation that of this car.
            ///
            /// # Errors
            ///
            /// The first key that is out of range.
            pub fn apply(&self, simulation: &mut SimulationConfig) -> Result<(), ConfigError> {
                $($(
                    if let Some(value) = &self.$section.$key {
                        $(
                            let numbers = value;
                            $(let numbers = &$numbers(numbers);)?
                            check(
                                concat!("truth.", stringify!($section), ".", stringify!($key)),
                                numbers,
                                &in_words(
                                    concat!(
                                        "between ", stringify!($low), " and ", stringify!($high)
                                    ),
                                    |x| ($low..=$high).contains(&x),
                                ),
                            )?;
                        )?
                        $(simulation.$($field).+ = value.clone().into();)?
                        $(
                            let $config = &mut *simulation;
                            let $value = value.clone();
                            $apply;
                        )?
                    }
                )+)+
                simulation.validate()
            }
        }
    };
}

truth! {
    /// Masses, lengths, tyres.
    vehicle: VehicleTruth {
        /// Mass.
        mass_kg: f64, in 0.1 to 100.0 => car.vehicle.mass_kg;
        /// Yaw moment of inertia about the centre of mass.
        yaw_inertia_kg_m2: f64, in 0.001 to 10.0 => car.vehicle.yaw_inertia_kg_m2;
        /// Distance of the front axle from the centre of mass.
        front_axle_distance_m: f64, in 0.01 to 2.0 => car.vehicle.front_axle_distance_m;
        /// Distance of the rear axle from the centre of mass.
        rear_axle_distance_m: f64, in 0.01 to 2.0 => car.vehicle.rear_axle_distance_m;
        /// Friction coefficient between tyre and ground.
        friction: f64, in 0.01 to 2.0 => car.vehicle.friction;
        /// Cornering stiffness of the front axle.
        front_cornering_stiffness_n_rad: f64, in 0.1 to 10000.0
            => car.vehicle.front_cornering_stiffness_n_rad;
        /// Cornering stiffness of the rear axle.
        rear_cornering_stiffness_n_rad: f64, in 0.1 to 10000.0
            => car.vehicle.rear_cornering_stiffness_n_rad;
        /// Curve of an axle's lateral force over its slip angle. "saturating": a hyperbolic
        /// tangent up to friction times load (the default). "magic-formula": Pacejka's
        /// D sin(C atan(B α)) with the same stiffness and peak and C = 1.3: beyond the peak it
        /// falls, to 0.89 of it. "linear": without a limit.
        tyre_curve: Tyres => car.tyre_curve;
        /// "small": those of the paper's equation 1, sin x = x and cos x = 1 (the default).
        /// "exact": the angles between the wheels and the velocities of their axles, and cos δ
        /// of the front force acts across the car.
        slip_angles: SlipAngles => car.slip_angles;
    }

    /// The steering servo.
    servo: ServoTruth {
        /// Pulse change for one radian to the left; the sign of the simulated car is negative,
        /// so a positive value is an inverted servo.
        gain_us_per_rad: f64, in -5000.0 to 5000.0 => car.servo.gain_us_per_rad;
        /// Pulse that steers straight on (trim).
        centre_us: f64, in 800.0 to 2200.0 => car.servo.centre_us;
        /// Pairs of pulse, in us, and angle, in rad, instead of that line: 2 to 32, in the order
        /// of the pulses, the angles all rising or all falling.
        table: SteeringTable, in -3000.0 to 3000.0 of |table: &SteeringTable| table.pairs().concat()
            => car.servo.table;
        /// Mechanical stop on both sides.
        stop_deg: f64, in 0.1 to 80.0 => |c, v| c.car.servo.stop_rad = v.to_radians();
        /// Time constant of its lag.
        lag_ms: f64, in 2.0 to 2000.0 => |c, v| c.car.servo.lag_s = v * 1e-3;
        /// Largest steering rate; a slow servo has a low one.
        max_rate_rad_s: f64, in 0.001 to 100.0 => car.servo.max_rate_rad_s;
        /// Play: pulse change that is lost at every change of direction.
        backlash_us: f64, in 0.0 to 500.0 => car.servo.backlash_us;
        /// From this time on the wheels keep their angle.
        stuck_from_s: f64, in 0.0 to 86400.0 => car.servo.stuck_from_s;
        /// From this time on its horn has slipped, by `slip_deg`.
        slips_at_s: f64, in 0.0 to 86400.0 => car.servo.slips_at_s;
        /// Angle of the wheels, to the left, by which its horn slips.
        slip_deg: f64, in -45.0 to 45.0 => |c, v| c.car.servo.slip_rad = v.to_radians();
    }

    /// The electronic speed controller.
    esc: EscTruth {
        /// "car": below neutral brakes after driving forward, and drives in reverse after
        /// standstill and neutral. "forward-reverse": below neutral drives in reverse at once,
        /// there is no brake. "vesc": below neutral brakes, never reverse, time-out 1000 ms.
        /// "learns-neutral": as "car", with the mean of the first ten pulses after it is
        /// switched on as neutral.
        kind: EscKind => |c, v| {
            c.car.motor.kind = v;
            c.car.motor.signal_loss_us = v.signal_loss_us();
        };
        /// Pulse without drive or brake.
        neutral_us: u16, in 800.0 to 2200.0 => car.motor.neutral_us;
        /// Half width of the band around neutral without drive.
        deadband_us: u16, in 0.0 to 500.0 => car.motor.deadband_us;
        /// Speed for each microsecond of pulse beyond the deadband, near zero.
        gain_m_s_per_us: f64, in 0.0001 to 1.0 => car.motor.gain_m_s_per_us;
        /// Largest acceleration.
        max_acceleration_m_s2: f64, in 0.1 to 50.0 => car.motor.max_acceleration_m_s2;
        /// Largest braking; 0 is an ESC that does not brake.
        max_brake_m_s2: f64, in 0.0 to 50.0 => car.motor.max_brake_m_s2;
        /// Time from a pulse to the motor's response.
        dead_time_ms: f64, in 0.0 to 1000.0
            => |c, v| c.car.motor.dead_time_us = (v * 1e3) as u64;
        /// Time at neutral that it needs after it is switched on.
        arming_ms: f64, in 0.0 to 60000.0 => |c, v| c.car.motor.arming_us = (v * 1e3) as u64;
        /// Time for which it goes on with the last pulse when the pulses stop; then the motor is
        /// free. 100, or 1000 for "vesc", if left out.
        signal_loss_ms: f64, in 0.0 to 600000.0
            => |c, v| c.car.motor.signal_loss_us = (v * 1e3) as u64;
        /// From this time on its throttle stays as it is, with any pulse and without pulses.
        /// Only cutting its supply helps.
        stuck_from_s: f64, in 0.0 to 86400.0 => car.motor.stuck_from_s;
        /// When it restarts: it has no power for `reboot_ms`, then needs neutral, or learns it.
        reboot_at_s: f64, in 0.0 to 86400.0 => car.motor.reboot_at_s;
        /// Time without power when it restarts (300).
        reboot_ms: f64, in 1.0 to 600000.0 => car.motor.reboot_ms;
        /// Its supply runs through a relay, normally open, that the board's kill output holds.
        kill_relay: bool => car.motor.kill_relay;
    }

    /// Motor, gears, wheels and floor.
    drive_train: DriveTrainTruth {
        /// Deceleration of the rolling car, constant part (0.8).
        rolling_m_s2: f64, in 0.0 to 20.0 => car.motor.coasting_m_s2;
        /// Deceleration of the rolling car for each m/s (1.0).
        viscous_per_s: f64, in 0.0 to 20.0 => car.motor.viscous_per_s;
        /// Slope of the floor. It acts along the car only.
        slope_deg: f64, in -30.0 to 30.0 => car.motor.slope_deg;
        /// Direction in which the floor rises, from the world's x axis to its y axis.
        slope_heading_deg: f64, in -360.0 to 360.0 => car.motor.slope_heading_deg;
        /// The part of the driven wheels' rotation that does not move the car.
        slip: f64, in 0.0 to 0.9 => car.motor.slip;
        /// The slip begins at this time; always there if left out.
        slip_from_s: f64, in 0.0 to 86400.0 => car.motor.slip_from_s;
        /// A push along the car: `at_s`, `speed_m_s`, and `for_s`. With `for_s = 0`, the
        /// default, a blow that changes the speed by `speed_m_s`; otherwise the car is moved at
        /// that speed for so long.
        push: Push, in -86400.0 to 86400.0 of |push: &Push| [push.at_s, push.speed_m_s, push.for_s]
            => car.motor.push;
    }

    /// The battery, and the supply of servo and IMU.
    battery: BatteryTruth {
        /// Voltage without load at the start.
        start_v: f64, in 0.0 to 60.0 => car.battery.start_v;
        /// Voltage of the USB that supplies the board's processor; its converter's reference.
        supply_v: f64, in 4.0 to 5.5 => car.battery.supply_v;
        /// The battery is not connected to the board: the input floats.
        divider_open: bool => car.battery.divider_open;
        /// Begin of a dip of the ESC's supply for servo and IMU: the wheels keep their angle,
        /// no inertial sample arrives, and the IMU restarts without its settings.
        dip_at_s: f64, in 0.0 to 86400.0 => car.battery.dip_at_s;
        /// Duration of the dip (150).
        dip_ms: f64, in 1.0 to 600000.0 => car.battery.dip_ms;
        /// Voltage of the battery during the dip; it stays as it is if left out.
        dip_v: f64, in 0.0 to 60.0 => car.battery.dip_v;
    }

    /// The board.
    board: BoardTruth {
        /// Number of the car that it is built into; the image's is built in.
        car_id: u16, in 0.0 to 65535.0 => board.car_id;
        /// Whether it has a supply of its own; otherwise the USB cable takes its power along
        /// (false).
        own_supply: bool => board.own_supply;
        /// Rate error of its clock; positive is fast.
        clock_skew_ppm: f64, in -50000.0 to 50000.0 => |c, v| c.board.clock_skew_ppm = v as i32;
    }

    /// The motor's pulse sensor.
    motor_sensor: MotorSensorTruth {
        /// Distance that the car rolls in one motor pulse.
        pulse_distance_um: f64, in 500.0 to 65000.0 => car.motor_sensor.pulse_distance_um;
        /// Mean number of edges by interference while the ESC drives, per second.
        emi_driven_hz: f64, in 0.0 to 100000.0 => car.motor_sensor.emi_driven_hz;
        /// Mean number of edges by interference while it does not drive, per second.
        emi_standstill_hz: f64, in 0.0 to 100000.0 => car.motor_sensor.emi_standstill_hz;
        /// Further edges after each true one.
        ringing_edges: u16, in 0.0 to 1000.0 => car.motor_sensor.ringing_edges;
        /// Duration of the ringing (40).
        ringing_us: f64, in 0.0 to 1000.0 => |c, v| c.car.motor_sensor.ringing_us = v as u64;
    }

    /// The inertial measurement unit.
    imu: ImuTruth {
        /// How the sensor is turned on the car: roll, pitch, yaw, in this order about its own
        /// forward, left and up axis, the yaw first.
        mounting_deg: [f64; 3], in -360.0 to 360.0 => car.imu.mounting_deg;
        /// Measured over true angular velocity.
        gyro_scale: f64, in -10.0 to 10.0 => car.imu.gyro_scale;
        /// Measured over true acceleration.
        acceleration_scale: f64, in -10.0 to 10.0 => car.imu.acceleration_scale;
        /// Standard deviation of the constant bias of the angular velocity.
        gyro_bias_rad_s: f64, in 0.0 to 10.0 => car.imu.gyro_bias_rad_s;
        /// Standard deviation of the constant bias of the acceleration.
        acceleration_bias_m_s2: f64, in 0.0 to 50.0 => car.imu.acceleration_bias_m_s2;
        /// Standard deviation of the acceleration by vibration while the wheels turn.
        vibration_m_s2: f64, in 0.0 to 100.0 => car.imu.vibration_m_s2;
        /// Standard deviation of the angular velocity by vibration while the wheels turn.
        vibration_rad_s: f64, in 0.0 to 30.0 => car.imu.vibration_rad_s;
        /// What each m/s of the wheels' speed adds to that of the acceleration.
        vibration_m_s2_per_m_s: f64, in 0.0 to 100.0 => car.imu.vibration_m_s2_per_m_s;
        /// What each m/s of the wheels' speed adds to that of the angular velocity.
        vibration_rad_s_per_m_s: f64, in 0.0 to 30.0 => car.imu.vibration_rad_s_per_m_s;
        /// Time constant with which a lasting acceleration leaks out of the linear acceleration
        /// and tilts the attitude; never if left out.
        leak_s: f64, in 0.05 to 3600.0 => car.imu.leak_s;
        /// Probability that a sample is torn: the low bytes are those of the one before.
        torn: f64, in 0.0 to 1.0 => car.imu.torn;
        /// Calibration of system, gyroscope and accelerometer, 0 (none) to 3 (full, the default).
        calibration: [u8; 3], in 0.0 to 3.0 => car.imu.calibration;
        /// Register `SYS_STATUS` (5: the fusion runs).
        system_status: u8, in 0.0 to 255.0 => car.imu.system_status;
        /// Register `SYS_ERR` (0: no error).
        system_error: u8, in 0.0 to 255.0 => car.imu.system_error;
        /// Register `ST_RESULT` (15: all self-tests passed).
        self_test: u8, in 0.0 to 255.0 => car.imu.self_test;
        /// Time from the return of its supply to the first sample (650).
        restart_ms: f64, in 0.0 to 600000.0 => car.imu.restart_ms;
    }

    /// The cameras, their server and the rigid body on the car.
    cameras: CamerasTruth {
        /// Yaw of the rigid body on the car.
        body_yaw_deg: f64, in -360.0 to 360.0 => |c, v| c.cameras.car.set_yaw(v.to_radians());
        /// Position of the body's pivot from the centre of mass: forward, left.
        pivot_m: [f64; 2], in -5.0 to 5.0 => |c, v| c.cameras.car.set_pivot(v);
        /// Height of the pivot above the floor (0.12).
        height_m: f64, in -10.0 to 10.0 => cameras.car.height_m;
        /// Name of the rigid body in the server's list ("car").
        body_name: String => cameras.car.name;
        /// The axis that points up in the stream: "y" or "z".
        up_axis: UpAxis => cameras.up_axis;
        /// Frames a second (100).
        rate_hz: f64, in 1.0 to 1000.0 => |c, v| c.cameras.period_us = (1e6 / v).round() as u64;
        /// Error of the mid-exposure stamps. Positive is late: the pose is older than its stamp,
        /// and the frame leaves later by as much.
        stamp_bias_ms: f64, in -1000.0 to 1000.0 => cameras.stamp_bias_ms;
        /// Growth of that error since the start of the simulation.
        stamp_drift_ppm: f64, in -10000.0 to 10000.0 => cameras.stamp_drift_ppm;
        /// Mean time from mid-exposure to the packet on the network.
        latency_ms: f64, in 0.0 to 1000.0
            => |c, v| c.cameras.latency_us = (v * 1e3) as u64;
        /// Standard deviation of each coordinate.
        position_noise_m: f64, in 0.0 to 1.0 => cameras.position_noise_m;
        /// The wrong body is streamed under the car's name, one that stands still.
        other_body: bool => cameras.other_body;
        /// From this time on the wrong body is streamed under the car's name.
        other_body_from_s: f64, in 0.0 to 86400.0 => cameras.other_body_from_s;
        /// From this time on the car's pose repeats bit by bit, in new frames.
        frozen_from_s: f64, in 0.0 to 86400.0 => cameras.frozen_from_s;
        /// Duration of that (1000).
        frozen_ms: f64, in 1.0 to 86400000.0 => cameras.frozen_ms;
        /// From this time on, for good, the body is found turned by `flip_deg`.
        flip_from_s: f64, in 0.0 to 86400.0 => cameras.flip_from_s;
        /// Angle about the up axis by which it is turned (180).
        flip_deg: f64, in -360.0 to 360.0 => cameras.flip_deg;
        /// From this time on frames are forged with the server's own address.
        forged_from_s: f64, in 0.0 to 86400.0 => cameras.forged_from_s;
        /// Position of the car in the forged frames less its true one ([0.5, 0.0]).
        forged_offset_m: [f64; 2], in -1000.0 to 1000.0 => cameras.forged_offset_m;
        /// Growth of that difference.
        forged_drift_m_s: [f64; 2], in -100.0 to 100.0 => cameras.forged_drift_m_s;
        /// The server has a second network card and sends from its address, 127.0.0.2.
        second_network_card: bool
            => |c, v| c.natnet.sends_from = v.then_some(Ipv4Addr::new(127, 0, 0, 2));
        /// The server is not running: no packet arrives.
        server_off: bool => natnet.is_off;
    }
}

/// What is wrong with the file of a simulation.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SimulationFileError(String);

section! {
    /// The file of a simulation: its configuration, and what is true of the car beside it.
    "simulation" => SimulationFile;
    [];

    /// See [`SimulationConfig`].
    seed: u64 = SimulationConfig::default().seed;
    /// See [`SimulationConfig`].
    car: CarParameters = CarParameters::default();
    /// See [`SimulationConfig`].
    board: BoardParameters = BoardParameters::default();
    /// See [`SimulationConfig`].
    wire: WireParameters = WireParameters::default();
    /// See [`SimulationConfig`].
    cameras: CameraParameters = CameraParameters::default();
    /// See [`SimulationConfig`].
    natnet: NatNetParameters = NatNetParameters::default();
    /// The car.
    truth: CarTruth = CarTruth::default();
}

impl SimulationConfig {
    /// Reads and checks a file: the sections of a simulation, and a table `[truth]`, which
    /// replaces what they say.
    ///
    /// # Errors
    ///
    /// The file can't be read, has an unknown key, or a value out of range.
    // Compiled where it is called: a parser of this many types takes as long as all that computes here.
    #[inline]
    pub fn read(path: &Path) -> Result<Self, SimulationFileError> {
        let name = path.display();
        let text = std::fs::read_to_string(path)
            .map_err(|source| SimulationFileError(format!("can't read {name}: {source}")))?;
        let wrong = |why: String| SimulationFileError(format!("{name}: {why}"));
        let read = toml::from_str(&text);
        let file: SimulationFile = read.map_err(|error| wrong(explain(&text, &error)))?;
        let mut simulation = Self {
            seed: file.seed,
            car: file.car,
            board: file.board,
            wire: file.wire,
            cameras: file.cameras,
            natnet: file.natnet,
        };
        let applied = file.truth.apply(&mut simulation);
        applied.map_err(|error| wrong(error.to_string()))?;
        Ok(simulation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_table_changes_nothing() {
        let mut simulation = SimulationConfig::default();
        CarTruth::default().apply(&mut simulation).unwrap();
        assert_eq!(simulation, SimulationConfig::default());
    }

    #[test]
    fn a_value_out_of_range_and_an_unknown_key_are_named() {
        let truth: CarTruth = toml::from_str("[esc]\nneutral_us = 300").unwrap();
        let error = truth.apply(&mut SimulationConfig::default()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "truth.esc.neutral_us is 300: it must be between 800.0 and 2200.0"
        );
        let error = toml::from_str::<CarTruth>("[servo]\nlagg_ms = 1").unwrap_err();
        assert!(error.to_string().contains("lagg_ms"), "{error}");
    }

    #[test]
    fn the_pivot_is_where_it_is_said_to_be_whatever_the_bodys_yaw() {
        for text in [
            "[cameras]\nbody_yaw_deg = 90.0\npivot_m = [0.02, 0.01]",
            "[cameras]\npivot_m = [0.02, 0.01]\nbody_yaw_deg = 90.0",
        ] {
            let mut simulation = SimulationConfig::default();
            let truth: CarTruth = toml::from_str(text).unwrap();
            truth.apply(&mut simulation).unwrap();
            let [forward, left] = simulation.cameras.car.to_centre_of_mass_m;
            // The body's forward axis is the car's left.
            assert!((forward + 0.01).abs() < 1e-12 && (left - 0.02).abs() < 1e-12);
        }
    }

    #[test]
    fn a_vesc_has_its_own_time_out_unless_one_is_written() {
        for (text, signal_loss_us) in [
            ("kind = \"vesc\"", 1_000_000),
            ("kind = \"car\"", 100_000),
            ("kind = \"vesc\"\nsignal_loss_ms = 50.0", 50_000),
        ] {
            let mut simulation = SimulationConfig::default();
            let truth: CarTruth = toml::from_str(&format!("[esc]\n{text}")).unwrap();
            truth.apply(&mut simulation).unwrap();
            assert_eq!(simulation.car.motor.signal_loss_us, signal_loss_us);
        }
    }

    #[test]
    fn a_file_takes_the_sections_of_the_simulation_and_the_truth() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("car.toml");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            SimulationConfig::read(&path).map_err(|error| error.to_string())
        };
        let text = "seed = 7\n[car.servo]\nlag_s = 0.1\n[truth.servo]\ncentre_us = 1540\n";
        let simulation = read(text).unwrap();
        assert_eq!(simulation.seed, 7);
        assert_eq!(simulation.car.servo.lag_s, 0.1);
        assert_eq!(simulation.car.servo.centre_us, 1540.0);
        for (text, name) in [
            ("[truth.servo]\ncentre = 1", "centre"),
            ("[truht]", "truht"),
            ("[truth.servo]\ncentre_us = 1", "truth.servo.centre_us"),
            ("[car.motor]\nslip = 2.0", "car.motor.slip"),
        ] {
            let error = read(text).unwrap_err();
            assert!(
                error.contains(name) && error.contains("car.toml"),
                "{error}"
            );
        }
    }
}
