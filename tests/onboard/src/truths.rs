//! What is true of the parameters that the procedures measure.

use singletrack_sim::World;

/// The true value of a parameter, in the unit of the procedures; none if there is no such
/// parameter.
#[must_use]
pub fn truth_of(name: &str, procedure: &str, world: &World) -> Option<f64> {
    let simulation = world.config();
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
