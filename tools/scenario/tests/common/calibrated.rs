//! Random cars that are as their configuration says, within what a calibration reaches, and
//! drives of them.

use std::{error::Error, f64::consts::FRAC_PI_2, path::Path};

use singletrack_pilot::{Mode, PilotRequest, Reason};
use singletrack_scenario::{
    simulate::{Scenario, virtual_drive_config},
    virtual_drive::VirtualDrive,
};

/// A car and its course.
pub(crate) struct CalibratedCar {
    seed: u64,
    text: String,
}

/// How a drive ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    /// By request, and the car can be armed again.
    AsRequested,
    /// For another reason.
    Alarm(&'static str),
}

/// What came of a drive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outcome {
    /// How it ended.
    pub(crate) ended: Ended,
    /// Whether the configuration was proved on the way.
    pub(crate) proved: bool,
    /// When it ended, s after its start.
    pub(crate) seconds: f64,
}

/// Seconds from the start to the disarm request, and from there until the car must be ready.
const DRIVEN_S: f64 = 12.0;
const SETTLED_S: f64 = 9.0;

impl CalibratedCar {
    /// The car of this seed.
    pub(crate) fn random(seed: u64) -> Self {
        let mut random = Random(seed);
        let (course, speed) = course(&mut random);
        let text = [course, car(&mut random, speed)].concat();
        Self { seed, text }
    }

    /// Its scenario, as TOML.
    pub(crate) fn describe(&self) -> &str {
        &self.text
    }

    /// Drives it, disarms it and waits until it can be armed again.
    pub(crate) fn drive(&self) -> Result<Outcome, Box<dyn Error>> {
        let scenario = Scenario::from_toml(&self.text, Path::new("calibrated.toml"))?;
        let (config, simulation) = virtual_drive_config(&scenario)?;
        let mut drive = VirtualDrive::new(config, self.seed, simulation)?;
        let start = drive.start()?.now;
        let mut outcome = Outcome {
            ended: Ended::AsRequested,
            proved: false,
            seconds: 0.0,
        };
        let mut disarmed = false;
        loop {
            let tick = drive.step();
            let output = &tick.tick.output;
            outcome.seconds = tick.now.seconds_since(start);
            outcome.proved |= output.proved;
            let over = outcome.seconds >= DRIVEN_S + SETTLED_S;
            let reason = output.reason.map_or("none", Reason::name);
            let alarm = match output.mode {
                Mode::Driving if !disarmed => false,
                Mode::Fault => true,
                _ if !disarmed => true,
                Mode::Ready => false,
                _ => over || output.reason != Some(Reason::Requested),
            };
            if alarm {
                outcome.ended = Ended::Alarm(reason);
            }
            if alarm || over {
                return Ok(outcome);
            }
            if !disarmed && outcome.seconds >= DRIVEN_S {
                drive.request(PilotRequest::Disarm)?;
                disarmed = true;
                // The tick of the request still drives.
                drive.step();
            }
        }
    }
}

/// The sections of law, reference, start and run, and the speed of the reference in m/s.
fn course(random: &mut Random) -> (String, f64) {
    let proportional = "kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\nfeed_forward = true\n";
    let (outer_loop, reference, [x, y], yaw, speed) = match random.below(3) {
        0 => {
            let radius = random.between(0.9, 2.0);
            let speed = random.between(0.1, (1.2 * radius).sqrt().min(1.5));
            let side = if random.below(2) == 0 { 1.0 } else { -1.0 };
            (
                proportional.to_owned(),
                format!(
                    "kind = \"circle\"\nradius_m = {radius}\nangular_velocity_rad_s = {}\n",
                    side * speed / radius
                ),
                [radius, 0.0],
                side * FRAC_PI_2,
                speed,
            )
        }
        1 => {
            let speed = random.between(0.1, 1.2);
            let length = 1.5 * (speed * speed / 1.2).max(0.9);
            (
                proportional.to_owned(),
                format!(
                    "kind = \"figure-of-eight\"\nhalf_length_m = {length}\nhalf_width_m = {}\n\
                     angular_velocity_rad_s = {}\n",
                    0.5 * length,
                    speed / (1.5 * length)
                ),
                [0.0, 0.0],
                0.785,
                speed,
            )
        }
        _ => {
            let speed = random.between(0.1, 1.5);
            let mut angle: f64 = 0.0;
            let steps: Vec<String> = (0..12)
                .map(|_| {
                    let (s, c) = angle.sin_cos();
                    angle += random.between(-1.0, 1.0);
                    format!(
                        "{{ duration_s = {}, v_x_m_s = {}, v_y_m_s = {} }}",
                        random.between(1.2, 3.0),
                        speed * c,
                        speed * s
                    )
                })
                .collect();
            (
                "kind = \"open-loop\"\n".to_owned(),
                format!(
                    "kind = \"velocity-steps\"\nsteps = [{}, {{ duration_s = 60.0, v_x_m_s = {speed}, v_y_m_s = 0.0 }}]\n",
                    steps.join(", ")
                ),
                [0.0, 0.0],
                0.0,
                speed,
            )
        }
    };
    let text = format!(
        "[law]\nkind = \"front-point\"\npoint_distance_m = 0.35\nfront_axle_distance_m = 0.1368\n\
         [outer_loop]\n{outer_loop}[reference]\n{reference}\
         [start]\npoint_p_m = [{x}, {y}]\nyaw_deg = {}\n\
         [control]\nperiod_ms = 10\n[plant]\nkind = \"car\"\n[run]\nduration_s = 20.0\nseed = {}\n\
         [supervisor]\nprove_first_metre = {}\n",
        yaw.to_degrees(),
        random.below(1_000_000),
        random.below(2) == 0,
    );
    (text, speed)
}

/// The sections of what is true of the car, and of what is believed where the two must
/// agree.
fn car(random: &mut Random, speed: f64) -> String {
    // The board takes a pulse in less than 0.6 s; in a turn the car is slower than P.
    let pulses_um = [1_000, 3_000, 3_000, 6_000, 12_000, 25_000];
    let usable = if speed < 0.3 { 4 } else { pulses_um.len() };
    let pulse_um = pulses_um[random.below(usable as u64)];
    let rolling = random.between(0.4, 2.0);
    let (kind, brakes) =
        [("car", true), ("forward-reverse", false), ("vesc", true)][random.below(3)];
    let leak = match random.below(3) {
        0 => format!("leak_s = {}\n", random.between(2.0, 6.0)),
        _ => String::new(),
    };
    let brake = if brakes { "brake_us = 1350\n" } else { "" };
    format!(
        "[fence]\ncorners_m = [[-200.0, -200.0], [200.0, -200.0], [200.0, 200.0], [-200.0, 200.0]]\n\
         braking_m_s2 = {}\n\
         [board]\nfailsafe = \"coast\"\n\
         [board.esc]\nkind = \"{kind}\"\n{brake}\
         [board.speed]\npulse_distance_um = {pulse_um}\n\
         [truth.esc]\nkind = \"{kind}\"\n\
         [truth.drive_train]\nrolling_m_s2 = {rolling}\nviscous_per_s = {}\n\
         [truth.motor_sensor]\npulse_distance_um = {}\n\
         [truth.servo]\ncentre_us = {}\ngain_us_per_rad = {}\nlag_ms = {}\nbacklash_us = {}\n\
         [truth.imu]\nmounting_deg = [{}, {}, {}]\nvibration_m_s2 = {}\nvibration_rad_s = {}\n{leak}\
         [truth.cameras]\nbody_yaw_deg = {}\npivot_m = [{}, {}]\nlatency_ms = {}\n\
         stamp_bias_ms = {}\nposition_noise_m = {}\n",
        0.8 * rolling,
        random.between(0.1, 1.0),
        f64::from(pulse_um) * random.between(0.97, 1.03),
        1_500.0 + random.between(-14.0, 14.0),
        -800.0 * random.between(0.94, 1.06),
        random.between(20.0, 60.0),
        random.between(0.0, 10.0),
        random.between(-2.0, 2.0),
        random.between(-2.0, 2.0),
        random.between(-3.0, 3.0),
        random.between(0.0, 1.0),
        random.between(0.0, 0.05),
        random.between(-1.5, 1.5),
        random.between(-0.005, 0.005),
        random.between(-0.005, 0.005),
        random.between(3.0, 12.0),
        random.between(-2.0, 2.0),
        random.between(0.0001, 0.0005),
    )
}

/// `SplitMix64`.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn below(&mut self, count: u64) -> usize {
        (self.next() % count) as usize
    }
}
