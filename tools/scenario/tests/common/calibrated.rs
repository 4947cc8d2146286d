//! Random cars that are as their configuration says, within what a calibration reaches, and
//! drives of them.

use std::{error::Error, f64::consts::FRAC_PI_2, path::Path};

use singletrack_control::statistics::Random;
use singletrack_control::{Position, Setpoint, Time, Velocity};
use singletrack_pilot::{Arming, Mode, PilotRequest, Reason};
use singletrack_scenario::{
    simulate::{Scenario, virtual_drive_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{LossPattern, WIDE_US, crooked_steering};

/// A car and its course.
pub(crate) struct CalibratedCar {
    seed: u64,
    text: String,
    stream: Option<Stream>,
    loss: Option<LossPattern>,
    kinds: Vec<String>,
}

/// How a drive ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    /// The request ended it, and the car can be armed again.
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
/// Time of a pulse at the speed of P, at most. The board takes a pulse in less than 0.6 s, and
/// in a turn the car is much slower than P.
const LONGEST_PULSE_S: f64 = 0.1;
/// Ticks from power-on within which the car must drive.
const START_TICKS: u64 = 1_500;

impl CalibratedCar {
    /// The car of this seed.
    pub(crate) fn random(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let course = course(&mut random);
        let loss = loss(&mut random, &course);
        let (car, mut kinds) = car(&mut random, course.speed);
        kinds.extend(course.kinds);
        kinds.extend(loss.map(|_| "markers lost now and then".to_owned()));
        kinds.sort();
        Self {
            seed,
            text: [course.text, car].concat(),
            stream: course.stream,
            loss,
            kinds,
        }
    }

    /// Its scenario, as TOML, and what a scenario does not hold.
    pub(crate) fn describe(&self) -> String {
        format!("{}# {:?} {:?}\n", self.text, self.stream, self.loss)
    }

    /// What was drawn, by name.
    pub(crate) fn kinds(&self) -> &[String] {
        &self.kinds
    }

    /// Drives it, disarms it and waits until it can be armed again.
    pub(crate) fn drive(&self) -> Result<Outcome, Box<dyn Error>> {
        let scenario = Scenario::from_toml(&self.text, Path::new("calibrated.toml"))?;
        let (config, simulation) = virtual_drive_config(&scenario)?;
        let mut drive = VirtualDrive::new(config, self.seed, simulation)?;
        let mut outcome = Outcome {
            ended: Ended::AsRequested,
            proved: false,
            seconds: 0.0,
        };
        let Some(start) = self.start(&mut drive)? else {
            let reason = drive.controller().pilot.reason();
            outcome.ended = Ended::Alarm(reason.map_or("not-started", Reason::name));
            return Ok(outcome);
        };
        let cameras = &mut drive.world.cameras;
        cameras.loss_epoch_us = Some(start.0 / 1_000);
        cameras.parameters.loss = self.loss;
        let mut disarmed = false;
        for number in 0_u64.. {
            self.send(&drive, number, outcome.seconds);
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
                break;
            }
            if !disarmed && outcome.seconds >= DRIVEN_S {
                drive.request(PilotRequest::Disarm)?;
                disarmed = true;
                drive.world.cameras.parameters.loss = None;
                // The tick of the request still drives.
                self.send(&drive, 0, outcome.seconds);
                drive.step();
            }
        }
        Ok(outcome)
    }

    /// Arms the car when it is ready. The time of the first driving tick; none if the car
    /// does not start.
    fn start(&self, drive: &mut VirtualDrive) -> Result<Option<Time>, Box<dyn Error>> {
        let mut armed = false;
        for number in 0..START_TICKS {
            if !armed && drive.mode() == Mode::Ready {
                drive.request(PilotRequest::Arm(Arming::Unattended))?;
                armed = true;
            }
            self.send(drive, number, 0.0);
            let tick = drive.step();
            if tick.tick.output.mode == Mode::Driving {
                return Ok(Some(tick.now));
            }
        }
        Ok(None)
    }

    /// Sends the set-point of this moment of the drive, if one is due at this tick.
    fn send(&self, drive: &VirtualDrive, number: u64, seconds: f64) {
        if let Some(stream) = &self.stream
            && number.is_multiple_of(stream.every_ticks)
        {
            let now = Time(drive.now_us() * 1_000);
            drive.send_setpoint(&stream.setpoint(now, seconds));
        }
    }
}

/// Set-points from outside: P on a circle.
#[derive(Clone, Copy, Debug)]
struct Stream {
    radius: f64,
    rate: f64,
    has_position: bool,
    every_ticks: u64,
}

impl Stream {
    fn setpoint(&self, time: Time, seconds: f64) -> Setpoint {
        let (s, c) = libm::sincos(self.rate * seconds);
        let speed = self.rate * self.radius;
        let position = self
            .has_position
            .then(|| Position::new(self.radius * c, self.radius * s));
        Setpoint::point(time, position, Velocity::new(-speed * s, speed * c))
    }
}

/// A reference, and where the car starts on it.
struct Course {
    /// The sections of law, outer loop, reference, start and run.
    text: String,
    stream: Option<Stream>,
    /// Speed of the reference, m/s.
    speed: f64,
    /// Highest speed of P, m/s: that of the reference, or while P catches up with it.
    top_speed: f64,
    kinds: Vec<String>,
}

fn course(random: &mut Random) -> Course {
    let mut outer_loop = "kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\n".to_owned();
    let mut feed_forward = true;
    let mut stream = None;
    // The circle of all references that have one.
    let radius = random.between(0.9, 2.0);
    let around = random.between(0.1, (1.2 * radius).sqrt().min(1.5));
    let side = if random.below(2) == 0 { 1.0 } else { -1.0 };
    let rate = side * around / radius;
    let (name, reference, start, yaw, speed) = match random.below(5) {
        0 => {
            feed_forward = rate.abs() > 0.6 || random.below(3) > 0;
            let circle = format!(
                "kind = \"circle\"\nradius_m = {radius}\nangular_velocity_rad_s = {rate}\n"
            );
            ("circle", circle, [radius, 0.0], side * FRAC_PI_2, around)
        }
        1 => {
            let speed = random.between(0.1, 1.2);
            let length = 1.5 * (speed * speed / 1.2).max(0.9);
            let eight = format!(
                "kind = \"figure-of-eight\"\nhalf_length_m = {length}\nhalf_width_m = {}\n\
                 angular_velocity_rad_s = {}\n",
                0.5 * length,
                speed / (1.5 * length)
            );
            ("figure of eight", eight, [0.0, 0.0], 0.785, speed)
        }
        2 => {
            let speed = random.between(0.1, 1.5);
            outer_loop = "kind = \"open-loop\"\n".to_owned();
            ("velocity steps", steps(random, speed), [0.0; 2], 0.0, speed)
        }
        3 => {
            let points: Vec<String> = (0..100)
                .map(|index| {
                    let time = 0.4 * f64::from(index);
                    let (s, c) = libm::sincos(rate * time);
                    format!(
                        "{{ t_s = {time}, x_m = {}, y_m = {} }}",
                        radius * c,
                        radius * s
                    )
                })
                .collect();
            let list = format!(
                "kind = \"waypoints\"\nwaypoints = [{}]\n",
                points.join(", ")
            );
            ("waypoints", list, [radius, 0.0], side * FRAC_PI_2, around)
        }
        _ => {
            let has_position = random.below(2) == 0;
            stream = Some(Stream {
                radius,
                rate,
                has_position,
                every_ticks: 1 + random.below(10) as u64,
            });
            let external = "kind = \"external\"\nsetpoint_timeout_ms = 200\n".to_owned();
            let name = match has_position {
                true => "external, positions",
                false => "external, velocities alone",
            };
            (name, external, [radius, 0.0], side * FRAC_PI_2, around)
        }
    };
    if outer_loop.contains("proportional") {
        outer_loop.push_str(&format!("feed_forward = {feed_forward}\n"));
    }
    let starts_on_path = random.below(3) > 0;
    let off = |random: &mut Random, most: f64| match starts_on_path {
        true => 0.0,
        false => random.between(-most, most),
    };
    let [x, y] = start.map(|coordinate| coordinate + off(random, 0.3));
    let yaw = yaw + off(random, 0.5);
    let proves = random.below(2) == 0;
    let text = format!(
        "[law]\nkind = \"front-point\"\npoint_distance_m = 0.35\nfront_axle_distance_m = 0.1368\n\
         [outer_loop]\n{outer_loop}[reference]\n{reference}\
         [start]\npoint_p_m = [{x}, {y}]\nyaw_deg = {}\n\
         [control]\nperiod_ms = 10\n[plant]\nkind = \"car\"\n[run]\nduration_s = 20.0\nseed = {}\n\
         [supervisor]\nprove_first_metre = {proves}\n",
        yaw.to_degrees(),
        random.below(1_000_000),
    );
    let mut kinds = vec![
        format!("reference: {name}"),
        format!("speed: {:.1} m/s and more", (speed / 0.3).floor() * 0.3),
        format!("first metre to be proved: {proves}"),
        format!("starts on its path: {starts_on_path}"),
    ];
    let top_speed = match starts_on_path && !proves {
        true => speed,
        false => 1.5,
    };
    if !feed_forward {
        kinds.push("without feed-forward".to_owned());
    }
    Course {
        text,
        stream,
        speed,
        top_speed,
        kinds,
    }
}

fn steps(random: &mut Random, speed: f64) -> String {
    let mut angle: f64 = 0.0;
    let steps: Vec<String> = (0..12)
        .map(|_| {
            let (s, c) = libm::sincos(angle);
            angle += random.between(-1.0, 1.0);
            format!(
                "{{ duration_s = {}, v_x_m_s = {}, v_y_m_s = {} }}",
                random.between(1.2, 3.0),
                speed * c,
                speed * s
            )
        })
        .collect();
    format!(
        "kind = \"velocity-steps\"\nsteps = [{}, {{ duration_s = 60.0, v_x_m_s = {speed}, v_y_m_s = 0.0 }}]\n",
        steps.join(", ")
    )
}

/// Losses of the markers that a drive outlives without slowing down: of 0.2 s and 70 mm at
/// most.
fn loss(random: &mut Random, course: &Course) -> Option<LossPattern> {
    let longest_ms = (0.07 / course.top_speed * 1e3).min(200.0);
    let (loss_ms, interval_ms) = (random.between(20.0, longest_ms), random.between(1e3, 4e3));
    if random.below(3) > 0 {
        return None;
    }
    format!("{loss_ms:.0}ms@{interval_ms:.0}ms").parse().ok()
}

/// The sections of what is true of the car, and of what is believed where the two must
/// agree; and what was drawn.
fn car(random: &mut Random, speed: f64) -> (String, Vec<String>) {
    let mut pulses_um = vec![1_000_u16, 3_000, 3_000, 6_000, 12_000, 25_000, 30_000];
    pulses_um.retain(|&pulse_um| f64::from(pulse_um) * 1e-6 < LONGEST_PULSE_S * speed);
    let pulse_um = pulses_um[random.below(pulses_um.len())];
    let rolling = random.between(0.4, 2.0);
    // What is believed, what is true, and whether a pulse below neutral brakes. A car whose
    // kind is left out is driven as one that has no brake.
    let (kind, true_kind, brakes) = [
        ("car", "car", true),
        ("car", "learns-neutral", true),
        ("forward-reverse", "forward-reverse", false),
        ("forward-reverse", "car", false),
        ("vesc", "vesc", true),
    ][random.below(5)];
    let failsafe = if brakes && random.below(3) == 0 {
        "brake"
    } else {
        "coast"
    };
    let kill = failsafe == "coast" && random.below(4) == 0;
    let leaks = random.below(3) == 0;
    let leak = match leaks {
        true => format!("leak_s = {}\n", random.between(2.0, 6.0)),
        false => String::new(),
    };
    let brake = if brakes { "brake_us = 1350\n" } else { "" };
    let turned = random.below(4) == 0;
    let (axes, imu_yaw_deg) = match turned {
        true => ("[board.imu]\nforward = \"-y\"\nleft = \"+x\"\n", 90.0),
        false => ("", 0.0),
    };
    let marker_loss = ["hold", "dead-reckon"][random.below(2)];
    let mut text = format!(
        "[fence]\ncorners_m = [[-200.0, -200.0], [200.0, -200.0], [200.0, 200.0], [-200.0, 200.0]]\n\
         braking_m_s2 = {}\n\
         [estimator]\nmarker_loss = \"{marker_loss}\"\n\
         [board]\nfailsafe = \"{failsafe}\"\nkill_output = {kill}\n\
         [board.esc]\nkind = \"{kind}\"\n{brake}\
         [board.speed]\npulse_distance_um = {pulse_um}\n{axes}\
         [truth.esc]\nkind = \"{true_kind}\"\n\
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
        imu_yaw_deg + random.between(-3.0, 3.0),
        random.between(0.0, 1.0),
        random.between(0.0, 0.05),
        random.between(-1.5, 1.5),
        random.between(-0.005, 0.005),
        random.between(-0.005, 0.005),
        random.between(3.0, 12.0),
        random.between(-2.0, 2.0),
        random.between(0.0001, 0.0005),
    );
    let crooked = random.below(3) == 0;
    if crooked {
        text = crooked_car(random, &text);
    }
    // Up to the IMU of tools/vehicles/dart-truth.toml.
    let shakes = random.between(0.0, 1.0);
    let of_speed = format!(
        "[truth.imu]\ngyro_scale = {}\nvibration_m_s2_per_m_s = {}\nvibration_rad_s_per_m_s = {}\n",
        random.between(0.97, 1.03),
        0.8 * shakes,
        0.016 * shakes,
    );
    text = text.replace("[truth.imu]\n", &of_speed);
    let mut kinds = vec![
        format!("ESC: {kind}, truly {true_kind}"),
        format!(
            "vibration by speed: {:.1} and more",
            0.5 * (2.0 * shakes).floor()
        ),
        format!("failsafe: {failsafe}"),
        format!("pulse: {:02} mm", pulse_um / 1_000),
        format!("markers lost: {marker_loss}"),
    ];
    for (drawn, name) in [
        (kill, "kill output"),
        (crooked, "crooked steering, as configured"),
        (leaks, "leaking accelerometer"),
        (turned, "IMU turned by 90 degrees, as configured"),
    ] {
        kinds.extend(drawn.then(|| name.to_owned()));
    }
    (text, kinds)
}

/// Steering that is not symmetric and has a dead band, known with the errors of a calibration.
fn crooked_car(random: &mut Random, text: &str) -> String {
    let shape = [random.between(-0.2, 0.2), random.between(2.0, 12.0)];
    let known = crooked_steering([1_500.0, -800.0], [1_080.0, 1_920.0], shape);
    let centre_us = 1_500.0 + random.between(-14.0, 14.0);
    let gain_us_per_rad = -800.0 * random.between(0.94, 1.06);
    let own = crooked_steering([centre_us, gain_us_per_rad], WIDE_US, shape);
    text.replace(
        "[truth.servo]\n",
        &format!("[truth.servo]\ntable = {own:?}\n"),
    ) + &format!("[limits]\nmax_steering_rad = 0.35\n[actuators]\nsteering_table = {known:?}\n")
}
