//! Servo and ESC without the safety machine.

use singletrack_protocol::Configuration;

use crate::{
    esc::{Esc, Motion},
    steering::Steering,
};

/// Speed from which the wheels count as moving, in mm/s: the odometer's.
const MOVING_MM_S: i16 = 50;

/// The pulses of servo and ESC for a speed and a steering angle, as the board gives them
/// while it drives.
///
/// Mapping, slew limits and the speed loop are the board's. Link, deadlines and the safety
/// machine are left out: this is for simulations of the car alone, which train a policy,
/// and never for a car.
#[derive(Debug)]
pub struct Actuators {
    configuration: Configuration,
    steering: Steering,
    esc: Esc,
    target_mm_s: i16,
}

impl Actuators {
    /// Straight wheels, and the ESC at neutral. The configuration must be valid.
    pub fn new(configuration: Configuration) -> Self {
        let mut steering = Steering::new();
        steering.configure(&configuration.servo);
        let mut esc = Esc::new();
        esc.configure(&configuration);
        Self {
            configuration,
            steering,
            esc,
            target_mm_s: 0,
        }
    }

    /// Sets the targets: the speed of the rear axle in mm/s, limited as the board limits
    /// it, and the steering angle in units of 100 µrad, left positive.
    pub fn drive(&mut self, speed_mm_s: i16, steering_100urad: i16) {
        let speed = &self.configuration.speed;
        let most = |limit: u16| i16::try_from(limit).unwrap_or(i16::MAX);
        self.target_mm_s = speed_mm_s
            .min(most(speed.max_forward_mm_s))
            .max(-most(speed.max_reverse_mm_s));
        self.steering
            .steer(&self.configuration.servo, steering_100urad);
    }

    /// Runs one control period, `elapsed_us` after the last one, with the measured magnitude
    /// of the speed.
    pub fn control(&mut self, elapsed_us: u32, speed_mm_s: i16) {
        let motion = Motion {
            moving: speed_mm_s >= MOVING_MM_S,
            speed_mm_s,
            rolls: speed_mm_s >= MOVING_MM_S,
        };
        self.esc
            .control(&self.configuration, self.target_mm_s, speed_mm_s, false);
        self.steering.advance(elapsed_us);
        self.esc.advance_driving(
            &self.configuration.esc,
            elapsed_us,
            self.target_mm_s,
            false,
            motion,
        );
    }

    /// The pulses of servo and ESC, in µs.
    pub fn pulses_us(&self) -> [u16; 2] {
        [
            self.steering.pulse_us().unwrap_or(0),
            self.esc.pulse_us(&self.configuration.esc),
        ]
    }
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::{
        EscCalibration, EscKind, FailsafeAction, ImuAxes, LONGEST_ROLL_OUT_MS, ServoCalibration,
        SpeedLoop,
    };

    use super::*;

    const CONFIGURATION: Configuration = Configuration {
        servo: ServoCalibration {
            centre_us: 1_490,
            gain_us_per_rad: -800,
            min_us: 1_100,
            max_us: 1_800,
            slew_us_per_20ms: 90,
        },
        esc: EscCalibration {
            kind: EscKind::Car,
            neutral_us: 1_500,
            deadband_us: 30,
            min_us: 1_200,
            max_us: 1_700,
            slew_us_per_20ms: 40,
            brake_us: 1_350,
        },
        speed: SpeedLoop {
            pulse_distance_um: 5_000,
            feed_forward_us_per_m_s: 100,
            proportional_us_per_m_s: 50,
            integral_us_per_m: 200,
            integral_limit_us: 80,
            max_forward_mm_s: 1_500,
            max_reverse_mm_s: 0,
        },
        failsafe: FailsafeAction::Coast,
        max_pose_age_ms: 950,
        stop_input: false,
        kill_output: false,
        max_roll_out_ms: LONGEST_ROLL_OUT_MS,
        car_id: 0,
        imu_axes: ImuAxes::AS_PRINTED,
    };

    #[test]
    fn pulses_are_slewed_mapped_and_limited_as_by_the_board() {
        let mut actuators = Actuators::new(CONFIGURATION);
        assert_eq!(actuators.pulses_us(), [1_490, 1_500]);
        actuators.drive(1_000, 1_000);
        let mut last = 1_500;
        for _ in 0..100 {
            actuators.control(10_000, 1_000);
            let [_, esc] = actuators.pulses_us();
            assert!(esc <= last + 21, "the slew of 40 us in 20 ms");
            last = esc;
        }
        // The deadband and the feed-forward.
        assert_eq!(actuators.pulses_us(), [1_410, 1_630]);
        actuators.drive(i16::MAX, i16::MAX);
        for _ in 0..100 {
            actuators.control(10_000, 0);
        }
        assert_eq!(actuators.pulses_us(), [1_100, 1_700]);
        actuators.drive(-1_000, 0);
        actuators.control(10_000, 0);
        assert_eq!(actuators.pulses_us()[1], 1_500, "no reverse");
    }

    /// The ESC's pulses for a second at this measured speed.
    fn driven(actuators: &mut Actuators, measured: i16) -> [u16; 100] {
        core::array::from_fn(|_| {
            actuators.control(10_000, measured);
            actuators.pulses_us()[1]
        })
    }

    #[test]
    fn reverse_waits_for_standstill_and_has_its_limit() {
        let mut configuration = CONFIGURATION;
        configuration.speed.max_reverse_mm_s = 500;
        let mut reversed = |kind, wanted| {
            configuration.esc.kind = kind;
            let mut actuators = Actuators::new(configuration);
            actuators.drive(1_000, 0);
            driven(&mut actuators, 1_000);
            actuators.drive(wanted, 0);
            let moving = driven(&mut actuators, 1_000);
            let standing = driven(&mut actuators, 0);
            (moving, standing)
        };
        let (moving, standing) = reversed(EscKind::ForwardReverse, -800);
        assert!(moving.iter().all(|pulse| *pulse == 1_500), "{moving:?}");
        assert!(standing[99] < 1_470, "{standing:?}");
        assert_eq!(reversed(EscKind::ForwardReverse, -500).1, standing);
        // An ESC with a brake brakes first, if the wheels rolled.
        let (moving, _) = reversed(EscKind::Car, -800);
        assert_eq!(moving.iter().min(), Some(&1_350), "{moving:?}");
    }
}
