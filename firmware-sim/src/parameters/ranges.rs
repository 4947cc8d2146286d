//! The ranges of the settings.

use super::{ConfigError, SimulationConfig};

impl SimulationConfig {
    /// Checks all settings against their ranges.
    ///
    /// # Errors
    ///
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let Self {
            car,
            board,
            wire,
            cameras,
            ..
        } = self;
        car.vehicle.validate()?;
        let positive = "finite and above zero";
        let probability = "a probability from 0 to 1";
        let not_negative = "finite and not negative";
        let edge_rate = "between 0 and 100000";
        let at_least_one = |value: u64| value as f64;
        for (name, value, valid, rule) in [
            check(
                "car.servo.gain_us_per_rad",
                car.servo.gain_us_per_rad,
                |x| x != 0.0,
                "finite and not zero",
            ),
            check(
                "car.servo.lag_s",
                car.servo.lag_s,
                |x| x >= 0.002,
                "0.002 or more",
            ),
            check(
                "car.servo.max_rate_rad_s",
                car.servo.max_rate_rad_s,
                above_zero,
                positive,
            ),
            check(
                "car.servo.stop_rad",
                car.servo.stop_rad,
                |x| x > 0.0 && x < 1.5,
                "between 0 and 1.5",
            ),
            check(
                "car.motor.lag_s",
                car.motor.lag_s,
                |x| x >= 0.002,
                "0.002 or more",
            ),
            check(
                "car.motor.saturation_us",
                car.motor.saturation_us,
                above_zero,
                positive,
            ),
            check(
                "car.motor.gain_m_s_per_us",
                car.motor.gain_m_s_per_us,
                above_zero,
                positive,
            ),
            check(
                "car.motor.coasting_m_s2",
                car.motor.coasting_m_s2,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.motor.viscous_per_s",
                car.motor.viscous_per_s,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.motor_sensor.pulse_distance_um",
                car.motor_sensor.pulse_distance_um,
                |x| x >= 10.0,
                "10 or more",
            ),
            check(
                "car.battery.nominal_v",
                car.battery.nominal_v,
                above_zero,
                positive,
            ),
            check(
                "car.imu.period_us",
                at_least_one(car.imu.period_us),
                |x| x >= 1_000.0,
                "1000 or more",
            ),
            check(
                "cameras.period_us",
                at_least_one(cameras.period_us),
                |x| x >= 1_000.0,
                "1000 or more",
            ),
            check(
                "board.poll_period_us",
                at_least_one(board.poll_period_us),
                |x| x >= 100.0,
                "100 or more",
            ),
            check(
                "car.servo.backlash_us",
                car.servo.backlash_us,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.motor.reboot_ms",
                car.motor.reboot_ms,
                above_zero,
                positive,
            ),
            check(
                "car.motor.slope_deg",
                car.motor.slope_deg,
                |x| (-45.0..=45.0).contains(&x),
                "from -45 to 45",
            ),
            check(
                "car.motor.slope_heading_deg",
                car.motor.slope_heading_deg,
                |_| true,
                "finite",
            ),
            check(
                "car.motor.slip",
                car.motor.slip,
                |x| (0.0..1.0).contains(&x),
                "from 0 to below 1",
            ),
            check(
                "car.motor.push.speed_m_s",
                car.motor.push.map_or(0.0, |push| push.speed_m_s),
                |_| true,
                "finite",
            ),
            check(
                "car.motor.push.for_s",
                car.motor.push.map_or(0.0, |push| push.for_s),
                zero_or_more,
                not_negative,
            ),
            check(
                "car.motor_sensor.emi_driven_hz",
                car.motor_sensor.emi_driven_hz,
                is_edge_rate,
                edge_rate,
            ),
            check(
                "car.motor_sensor.emi_standstill_hz",
                car.motor_sensor.emi_standstill_hz,
                is_edge_rate,
                edge_rate,
            ),
            check(
                "car.motor_sensor.ringing_edges",
                f64::from(car.motor_sensor.ringing_edges),
                |x| x <= 1_000.0,
                "1000 or less",
            ),
            check(
                "car.battery.supply_v",
                car.battery.supply_v,
                above_zero,
                positive,
            ),
            check(
                "car.battery.dip_ms",
                car.battery.dip_ms,
                above_zero,
                positive,
            ),
            check(
                "car.imu.mounting_deg",
                car.imu.mounting_deg.iter().sum(),
                |_| true,
                "finite",
            ),
            check("car.imu.gyro_scale", car.imu.gyro_scale, |_| true, "finite"),
            check(
                "car.imu.acceleration_scale",
                car.imu.acceleration_scale,
                |_| true,
                "finite",
            ),
            check(
                "car.imu.vibration_m_s2",
                car.imu.vibration_m_s2,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.imu.vibration_rad_s",
                car.imu.vibration_rad_s,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.imu.vibration_m_s2_per_m_s",
                car.imu.vibration_m_s2_per_m_s,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.imu.vibration_rad_s_per_m_s",
                car.imu.vibration_rad_s_per_m_s,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.imu.leak_s",
                car.imu.leak_s.unwrap_or(1.0),
                above_zero,
                positive,
            ),
            check("car.imu.torn", car.imu.torn, is_probability, probability),
            check(
                "car.imu.calibration",
                car.imu
                    .calibration
                    .iter()
                    .copied()
                    .max()
                    .unwrap_or(0)
                    .into(),
                |x| x <= 3.0,
                "0 to 3",
            ),
            check(
                "car.imu.restart_ms",
                car.imu.restart_ms,
                zero_or_more,
                not_negative,
            ),
            check(
                "cameras.stamp_bias_ms",
                cameras.stamp_bias_ms,
                |x| x.abs() <= 10_000.0,
                "from -10000 to 10000",
            ),
            check(
                "cameras.stamp_drift_ppm",
                cameras.stamp_drift_ppm,
                |x| x.abs() <= 100_000.0,
                "from -100000 to 100000",
            ),
            check("cameras.frozen_ms", cameras.frozen_ms, above_zero, positive),
            check("cameras.flip_deg", cameras.flip_deg, |_| true, "finite"),
            check(
                "cameras.forged_offset_m",
                cameras.forged_offset_m.iter().sum(),
                |_| true,
                "finite",
            ),
            check(
                "cameras.forged_drift_m_s",
                cameras.forged_drift_m_s.iter().sum(),
                |_| true,
                "finite",
            ),
            check(
                "wire.baud",
                f64::from(wire.baud),
                |x| x >= 300.0,
                "300 or more",
            ),
            check(
                "wire.faults.drop",
                wire.faults.drop,
                is_probability,
                probability,
            ),
            check(
                "wire.faults.corrupt",
                wire.faults.corrupt,
                is_probability,
                probability,
            ),
            check(
                "cameras.position_noise_m",
                cameras.position_noise_m,
                zero_or_more,
                not_negative,
            ),
            check(
                "cameras.orientation_noise_rad",
                cameras.orientation_noise_rad,
                zero_or_more,
                not_negative,
            ),
        ] {
            if !valid {
                return Err(ConfigError::OutOfRange { name, value, rule });
            }
        }
        for (name, time_s) in [
            ("car.servo.stuck_from_s", car.servo.stuck_from_s),
            ("car.motor.stuck_from_s", car.motor.stuck_from_s),
            ("car.motor.reboot_at_s", car.motor.reboot_at_s),
            ("car.motor.slip_from_s", car.motor.slip_from_s),
            ("car.motor.push.at_s", car.motor.push.map(|push| push.at_s)),
            ("car.battery.dip_at_s", car.battery.dip_at_s),
            ("cameras.other_body_from_s", cameras.other_body_from_s),
            ("cameras.frozen_from_s", cameras.frozen_from_s),
            ("cameras.flip_from_s", cameras.flip_from_s),
            ("cameras.forged_from_s", cameras.forged_from_s),
        ] {
            let (name, value, valid, rule) =
                check(name, time_s.unwrap_or(0.0), zero_or_more, not_negative);
            if !valid {
                return Err(ConfigError::OutOfRange { name, value, rule });
            }
        }
        Ok(())
    }
}

fn check(
    name: &'static str,
    value: f64,
    rule: fn(f64) -> bool,
    words: &'static str,
) -> (&'static str, f64, bool, &'static str) {
    (name, value, value.is_finite() && rule(value), words)
}

fn above_zero(x: f64) -> bool {
    x > 0.0
}

fn zero_or_more(x: f64) -> bool {
    x >= 0.0
}

fn is_edge_rate(x: f64) -> bool {
    (0.0..=100_000.0).contains(&x)
}

fn is_probability(x: f64) -> bool {
    (0.0..=1.0).contains(&x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_keys_and_invalid_values_are_reported_by_name() {
        let error = toml::from_str::<SimulationConfig>("[car.servo]\nlagg_s = 1").unwrap_err();
        assert!(error.to_string().contains("lagg_s"), "{error}");
        let config: SimulationConfig = toml::from_str("[wire.faults]\ncorrupt = 1.5").unwrap();
        assert_eq!(
            config.validate().unwrap_err().to_string(),
            "wire.faults.corrupt is 1.5: it must be a probability from 0 to 1"
        );
        let error = toml::from_str::<SimulationConfig>("[cameras]\nloss = \"1s\"").unwrap_err();
        assert!(error.to_string().contains("DURATION@INTERVAL"), "{error}");
        let error =
            toml::from_str::<SimulationConfig>("[natnet]\nbitstream = \"2.5\"").unwrap_err();
        assert!(error.to_string().contains("2.5"), "{error}");
    }
}
