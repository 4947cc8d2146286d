//! Random cars of newcomers: what is true of each, and what its owner first writes down.

use core::fmt;

use singletrack_control::SteeringTable;
use singletrack_core::config::{Config, ConfigError};
use singletrack_sim::{
    EscKind, SimulationConfig, StartPose, UpAxis, WIDE_US, World, crooked_steering,
};
use toml_edit::{Array, DocumentMut, Item, Table, Value};

use crate::Random;

/// The example that a newcomer begins with.
const EXAMPLE: &str = include_str!("../../../host/daemon/singletrackd.example.toml");

/// A fault that is planted in a car.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlantedFault {
    /// The plugs of servo and ESC are exchanged.
    SwappedWires,
    /// The cameras stream another body under the car's name.
    WrongBody,
    /// The IMU is mounted upside down, and believed to lie as printed.
    ImuUpsideDown,
    /// The relay in the ESC's supply is stuck: the kill output does not cut it.
    DeadKill,
    /// The servo turns the other way round than the configuration says.
    WrongSign,
}

impl PlantedFault {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::SwappedWires,
        Self::WrongBody,
        Self::ImuUpsideDown,
        Self::DeadKill,
        Self::WrongSign,
    ];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SwappedWires => "swapped-wires",
            Self::WrongBody => "wrong-body",
            Self::ImuUpsideDown => "imu-upside-down",
            Self::DeadKill => "dead-kill",
            Self::WrongSign => "wrong-sign",
        }
    }
}

impl fmt::Display for PlantedFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A car that has just been put together.
#[derive(Clone, Debug)]
pub struct OnboardCar {
    /// Its seed.
    pub seed: u64,
    /// What is true of it.
    pub simulation: SimulationConfig,
    /// What its owner has written down: the file of the configuration.
    pub file: DocumentMut,
    /// What is wrong with it.
    pub fault: Option<PlantedFault>,
}

/// The share of cars with a planted fault.
const FAULTY: f64 = 0.1;

/// The share of cars whose steering is no straight line.
const CROOKED: f64 = 0.2;

/// The hall: half its length and half its width, in m.
pub const HALL_M: [f64; 2] = [3.5, 3.0];

/// A number with at most this many digits after the point, as a person writes it.
fn written(value: f64, digits: i32) -> Value {
    let scale = libm::pow(10.0, f64::from(digits));
    Value::from((value * scale).round() / scale)
}

impl OnboardCar {
    /// A random car.
    pub fn random(seed: u64) -> Self {
        let mut random = Random::new(seed.wrapping_mul(0x5851_f42d_4c95_7f2d) ^ 0x0b0a);
        let fault = random
            .happens(FAULTY)
            .then(|| PlantedFault::ALL[random.below(PlantedFault::ALL.len())]);
        Self::with_fault(seed, fault, &mut random)
    }

    /// A random car with this fault, or with none.
    pub fn planted(seed: u64, fault: Option<PlantedFault>) -> Self {
        let mut random = Random::new(seed.wrapping_mul(0x5851_f42d_4c95_7f2d) ^ 0x0b0b);
        Self::with_fault(seed, fault, &mut random)
    }

    fn with_fault(seed: u64, fault: Option<PlantedFault>, random: &mut Random) -> Self {
        let mut simulation = SimulationConfig {
            seed,
            ..SimulationConfig::default()
        };
        let mut file = example();
        let mut set = |key: &str, value: Value| write_key(&mut file, key, value);

        // The owner measures the axles with a ruler, and weighs them.
        let car = &mut simulation.car;
        let scale = random.between(0.92, 1.15);
        let v = &mut car.vehicle;
        for (key, length) in [
            ("front_axle_distance_m", &mut v.front_axle_distance_m),
            ("rear_axle_distance_m", &mut v.rear_axle_distance_m),
        ] {
            *length *= scale;
            let measured = written(*length + random.between(-0.001, 0.001), 3);
            set(&format!("vehicle.{key}"), measured.clone());
            if key.starts_with("front") {
                set("law.front_axle_distance_m", measured);
            }
        }
        let mass_scale = random.between(0.85, 1.4);
        v.mass_kg *= mass_scale;
        v.yaw_inertia_kg_m2 *= mass_scale * scale * scale;
        set("vehicle.mass_kg", written(v.mass_kg, 2));
        set("vehicle.yaw_inertia_kg_m2", written(v.yaw_inertia_kg_m2, 4));
        set("vehicle.friction", Value::from(v.friction));
        set(
            "vehicle.front_cornering_stiffness_n_rad",
            Value::from(v.front_cornering_stiffness_n_rad),
        );
        set(
            "vehicle.rear_cornering_stiffness_n_rad",
            Value::from(v.rear_cornering_stiffness_n_rad),
        );
        v.friction = random.between(0.3, 0.8);
        v.front_cornering_stiffness_n_rad *= mass_scale * random.between(0.8, 1.3);
        v.rear_cornering_stiffness_n_rad *= mass_scale * random.between(0.8, 1.3);

        let side = if random.happens(0.5) { 1.0 } else { -1.0 };
        let servo = &mut car.servo;
        servo.centre_us = 1_500.0 + random.normal(35.0).clamp(-80.0, 80.0);
        servo.gain_us_per_rad = side * random.between(550.0, 950.0);
        servo.stop_rad = random.between(0.42, 0.58);
        servo.lag_s = random.between(0.02, 0.07);
        servo.max_rate_rad_s = random.between(4.0, 10.0);
        servo.dead_time_us = random.between(2_000.0, 12_000.0) as u64;
        servo.backlash_us = random.between(0.0, 8.0);

        let motor = &mut car.motor;
        motor.kind = [EscKind::Car, EscKind::ForwardReverse, EscKind::Vesc][random.below(3)];
        motor.signal_loss_us = motor.kind.signal_loss_us();
        motor.reverse = random.happens(0.7);
        motor.deadband_us = random.between(18.0, 45.0) as u16;
        motor.breakaway_us = random.between(2.0, 6.0);
        // A pulse of 1500 us is neutral to it, or it would run before it is configured.
        let offset = random.normal(8.0).clamp(-14.0, 14.0);
        motor.neutral_us = (1_500.0 + offset) as u16;
        motor.gain_m_s_per_us = random.between(0.007, 0.016);
        motor.saturation_us = random.between(300.0, 600.0);
        motor.lag_s = random.between(0.05, 0.14);
        motor.dead_time_us = random.between(10_000.0, 40_000.0) as u64;
        motor.max_acceleration_m_s2 = random.between(2.0, 5.0);
        motor.max_brake_m_s2 = random.between(2.0, 5.0);
        motor.coasting_m_s2 = random.between(0.4, 1.4);
        motor.viscous_per_s = random.between(0.3, 1.2);

        let pulse_um = libm::exp(random.between(libm::log(1_000.0), libm::log(30_000.0)));
        car.motor_sensor.pulse_distance_um = pulse_um;
        // From the wheels and the gears of a data sheet.
        let nominal = pulse_um * random.between(0.75, 1.3);
        set(
            "board.speed.pulse_distance_um",
            Value::from(nominal.clamp(500.0, 30_000.0).round() as i64),
        );

        let imu = &mut car.imu;
        imu.gyro_bias_rad_s = random.between(0.001, 0.01);
        imu.gyro_noise_rad_s = random.between(0.001_5, 0.005);
        imu.vibration_m_s2 = random.between(0.0, 0.6);
        imu.vibration_rad_s = random.between(0.0, 0.02);
        let turned = 90.0 * random.below(4) as f64;
        imu.mounting_deg = [0.0, 0.0, turned].map(|angle| angle + random.normal(1.2));

        let cameras = &mut simulation.cameras;
        cameras.up_axis = UpAxis::Y;
        cameras.car.height_m = random.between(0.08, 0.2);
        let right_angle = match random.below(10) {
            0 => 90.0,
            1 => 180.0,
            2 => -90.0,
            _ => 0.0,
        };
        let yaw_deg: f64 = right_angle + random.normal(5.0).clamp(-15.0, 15.0);
        cameras.car.set_yaw(yaw_deg.to_radians());
        cameras
            .car
            .set_pivot([random.between(-0.08, 0.1), random.between(-0.03, 0.03)]);
        cameras.stamp_bias_ms = random.normal(3.0).clamp(-8.0, 8.0);
        cameras.latency_us = random.between(4_000.0, 12_000.0) as u64;
        cameras.position_noise_m = random.between(0.000_1, 0.000_4);
        cameras.orientation_noise_rad = random.between(0.001, 0.002_5);
        cameras.clock_skew_ppm = random.between(-60.0, 60.0) as i32;

        let kill = random.happens(0.5) || fault == Some(PlantedFault::DeadKill);
        simulation.car.motor.kill_relay = kill;
        set("board.kill_output", Value::from(kill));
        set("board.stop_input", Value::from(random.happens(0.5)));
        simulation.car.start = StartPose {
            x_m: random.between(-0.5, 0.5),
            y_m: random.between(-0.5, 0.5),
            yaw_rad: random.between(-3.1, 3.1),
        };
        match fault {
            None => {}
            Some(PlantedFault::SwappedWires) => simulation.car.swapped_wires = true,
            Some(PlantedFault::WrongBody) => simulation.cameras.other_body = true,
            Some(PlantedFault::ImuUpsideDown) => {
                simulation.car.imu.mounting_deg = [180.0, 0.0, 0.0].map(|x| x + random.normal(1.2));
            }
            Some(PlantedFault::DeadKill) => simulation.car.motor.kill_relay = false,
            Some(PlantedFault::WrongSign) => {
                // The example's, to the other side than the car's.
                let gain = 800.0_f64.copysign(-simulation.car.servo.gain_us_per_rad);
                set("board.servo.gain_us_per_rad", Value::from(gain as i64));
            }
        }
        if random.happens(CROOKED) {
            let shape = [random.between(-0.15, 0.15), random.between(0.0, 8.0)];
            let servo = &mut simulation.car.servo;
            let line = [servo.centre_us, servo.gain_us_per_rad];
            servo.table = SteeringTable::new(&crooked_steering(line, WIDE_US, shape)).ok();
        }
        Self {
            seed,
            simulation,
            file,
            fault,
        }
    }

    /// The configuration that the owner begins with.
    ///
    /// # Errors
    ///
    /// The file is refused.
    pub fn configuration(&self) -> Result<Config, ConfigError> {
        Config::from_toml(&self.file.to_string())
    }
}

/// The example, with what every owner knows: the cameras, the hall, that nothing is measured.
fn example() -> DocumentMut {
    // The example is tested to be valid.
    let mut file: DocumentMut = EXAMPLE.parse().unwrap_or_default();
    let [x, y] = HALL_M;
    let corners: Array = [[-x, -y], [x, -y], [x, y], [-x, y]]
        .into_iter()
        .map(|corner| corner.into_iter().collect::<Array>())
        .collect();
    for (key, value) in [
        ("serial.port", Value::from("simulated")),
        ("motion_capture.server", Value::from("127.0.0.1")),
        ("fence.corners_m", Value::Array(corners)),
        ("fence.braking_m_s2", Value::from(0.3)),
        ("reference.radius_m", Value::from(1.0)),
        ("limits.max_speed_m_s", Value::from(1.0)),
    ] {
        write_key(&mut file, key, value);
    }
    for key in ["kind", "brake_us"] {
        if let Some(table) = file["board"]["esc"].as_table_mut() {
            table.remove(key);
        }
    }
    file
}

/// Writes a value at a dotted key; a section that is not there is added.
fn write_key(file: &mut DocumentMut, key: &str, mut value: Value) {
    let (path, name) = key.rsplit_once('.').unwrap_or(("", key));
    let mut table: &mut Table = file.as_table_mut();
    for part in path.split('.').filter(|part| !part.is_empty()) {
        let item = table
            .entry(part)
            .or_insert_with(|| Item::Table(Table::new()));
        if !item.is_table() {
            *item = Item::Table(Table::new());
        }
        let Some(inner) = item.as_table_mut() else {
            return;
        };
        table = inner;
    }
    if let Some(old) = table.get(name).and_then(Item::as_value) {
        *value.decor_mut() = old.decor().clone();
    }
    table.insert(name, Item::Value(value));
}

/// The true value of a parameter, in the unit of the procedures; none if there is no such
/// parameter.
pub fn truth_of(name: &str, procedure: &str, world: &World) -> Option<f64> {
    let simulation = &world.config;
    let car = &simulation.car;
    let cameras = &simulation.cameras;
    let motor = &car.motor;
    let ms = |us: u64| us as f64 * 1e-3;
    Some(match name {
        // Of no straight line there is none.
        "servo-centre" | "servo-gain" if car.servo.table.is_some() => return None,
        "servo-centre" => car.servo.centre_us,
        "servo-gain" => car.servo.gain_us_per_rad,
        "servo-lag" => car.servo.lag_s * 1e3,
        "servo-dead-time" => ms(car.servo.dead_time_us),
        "pulse-distance" => car.motor_sensor.pulse_distance_um,
        "body-yaw" => cameras.car.yaw_rad,
        "body-forward" => cameras.car.pivot()[0],
        "body-left" => cameras.car.pivot()[1],
        "camera-latency" => cameras.stamp_bias_ms,
        "gyro-noise" => {
            // With the step of the protocol, 1 mrad/s.
            libm::hypot(car.imu.gyro_noise_rad_s, 1e-3 / libm::sqrt(12.0))
        }
        "esc-neutral" => motor.neutral_us.into(),
        // The band in which the wheels stand: with what the drive train holds.
        "esc-deadband" => f64::from(motor.deadband_us) + motor.breakaway_us,
        // Of the slowest roll-out, from 0.3 m/s: v² over twice the way.
        "braking" => {
            let (v, rolling, viscous) = (0.3, motor.coasting_m_s2, motor.viscous_per_s);
            let share = viscous * v / rolling;
            let way = v * v / rolling * (share - libm::log1p(share)) / (share * share);
            v * v / (2.0 * way)
        }
        // With the battery, which gives way while the car accelerates to 0.3 m/s.
        "motor-lag" => {
            let battery = &car.battery;
            let fall_v_s2_m = battery.resistance_ohm * battery.motor_a_per_m_s2;
            1e3 * (motor.lag_s + 0.3 * fall_v_s2_m / world.truth().battery_v)
        }
        "motor-dead-time" => ms(motor.dead_time_us),
        "feed-forward" => {
            // Pulse beyond the deadband for a speed, with the battery as it is.
            let share = world.truth().battery_v / car.battery.nominal_v;
            let pulse = |speed: f64| {
                let settled = speed / share;
                settled / (motor.gain_m_s_per_us - settled / motor.saturation_us)
            };
            match procedure {
                // The slope over the speeds at which it drives.
                "calibrate" => (pulse(0.3) - pulse(0.15)) / 0.15,
                // From standstill to this speed.
                _ => pulse(0.5) / 0.5,
            }
        }
        _ => return None,
    })
}
