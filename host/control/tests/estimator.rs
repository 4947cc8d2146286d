//! The estimate of a car that slips a little, vibrates, and may be steered otherwise than was sent.

use singletrack_control::{
    Covariance, Estimate, Estimator, EstimatorConfig, InertialSample, MarkerLoss, PoseSample,
    PoseVerdict, Position, Time, VehicleParameters, wrap,
};

/// Period of commands, poses and samples, s, and the age of a pose when it arrives.
const PERIOD: f64 = 0.01;
const LATENCY: f64 = 0.006;
/// Lateral slip of the rear axle per lateral acceleration and speed, s²/m.
const COMPLIANCE: f64 = 0.01;
/// From here on it brakes, s.
const BRAKES_FROM: f64 = 10.0;
/// From here on the start no longer counts, s.
const SETTLED: f64 = 4.0;

/// What is true of a car.
#[derive(Clone, Copy, Debug)]
struct Truth {
    /// Noise of a gyro sample, rad/s.
    gyro: f64,
    /// Angle of the wheels for that sent, and of straight ones, rad.
    steering: [f64; 2],
    /// Time constant of the wheels, s.
    lag: f64,
    /// From here on the servo stands still, s.
    frozen: f64,
    /// Speed, m/s; negative in reverse.
    speed: f64,
    /// Deceleration from 10 s on, m/s².
    braking: f64,
}

const CAR: Truth = Truth {
    gyro: 0.06,
    steering: [1.0, 0.0],
    lag: 0.04,
    frozen: f64::INFINITY,
    speed: 1.0,
    braking: 0.0,
};

/// Normal numbers, always the same.
struct Random(u64);

impl Random {
    fn normal(&mut self) -> f64 {
        // The sum of twelve uniform numbers.
        let sum: f64 = (0..12)
            .map(|_| {
                self.0 = self
                    .0
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (self.0 >> 11) as f64 / (1_u64 << 53) as f64
            })
            .sum();
        sum - 6.0
    }
}

/// A moment of the drive.
struct Moment {
    time: f64,
    truth: Estimate,
    estimate: Estimate,
    deviation: f64,
    covariance: Covariance,
    verdict: Option<PoseVerdict>,
}

/// Drives for 20 s and steers to and fro. `cameras` changes a pose, or takes it away.
fn drive(
    truth: Truth,
    marker_loss: MarkerLoss,
    cameras: impl Fn(f64, &mut PoseSample) -> bool,
) -> Vec<Moment> {
    let vehicle = VehicleParameters::paper();
    let config = EstimatorConfig {
        marker_loss,
        ..EstimatorConfig::for_vehicle(&vehicle)
    };
    let (wheelbase, rear) = (vehicle.wheelbase_m(), vehicle.rear_axle_distance_m);
    let mut estimator = Estimator::new(config);
    let mut random = Random(7);
    let begin = Time(1_000_000_000);
    let (mut position, mut yaw, mut wheels) = (Position::origin(), 0.0, 0.0);
    let mut sent: Vec<(f64, f64)> = Vec::new();
    let mut waiting: Vec<PoseSample> = Vec::new();
    let mut moments = Vec::new();
    const STEPS: u32 = 20;
    for tick in 0..2_000_u32 {
        let now = f64::from(tick) * PERIOD;
        // The car from the tick before to this one.
        let (mut yaw_rate, mut left, mut speed) = (0.0, 0.0, 0.0);
        for step in 0..STEPS {
            let dt = PERIOD / f64::from(STEPS);
            let time = now - PERIOD + f64::from(step + 1) * dt;
            let due = sent.iter().rev().find(|(from, _)| *from + 0.018 <= time);
            if time < truth.frozen {
                let servo = due.map_or(0.0, |(_, angle)| *angle);
                let [gain, trim] = truth.steering;
                wheels += (gain * servo + trim - wheels) * dt / truth.lag;
            }
            let pace = truth.speed.abs() - truth.braking * (time - BRAKES_FROM).max(0.0);
            speed = pace.max(0.0).copysign(truth.speed) * (time / 1.5).clamp(0.0, 1.0);
            yaw_rate = speed * f64::tan(wheels) / wheelbase;
            left = (rear - COMPLIANCE * speed * speed) * yaw_rate;
            let (s, c) = f64::sin_cos(yaw);
            position.x += dt * (speed * c - left * s);
            position.y += dt * (speed * s + left * c);
            yaw += yaw_rate * dt;
        }
        let time = begin.after(now);
        let inertial = InertialSample {
            time,
            yaw_rate: yaw_rate + 0.01 + truth.gyro * random.normal(),
            forward_acceleration: -left * yaw_rate + 1.5 * random.normal(),
            left_acceleration: speed * yaw_rate + 1.5 * random.normal(),
        };
        estimator.handle_inertial(inertial, Some(speed + 0.01 * random.normal()));
        for pose in waiting.drain(..) {
            let verdict = estimator.handle_pose(&pose);
            if let Some(last) = moments.last_mut() {
                let last: &mut Moment = last;
                last.verdict = Some(verdict);
            }
        }
        let mut pose = PoseSample {
            capture: time,
            receive: time.after(LATENCY),
            frame: 0,
            position: position + 2e-4 * nalgebra::Vector2::new(random.normal(), random.normal()),
            yaw: yaw + 1.7e-3 * random.normal(),
        };
        if cameras(now, &mut pose) {
            waiting.push(pose);
        }
        let estimate = estimator.estimate(time);
        if let (Some(estimate), Some(covariance)) = (estimate, estimator.covariance()) {
            moments.push(Moment {
                time: now,
                truth: Estimate {
                    time,
                    position,
                    yaw,
                    yaw_rate,
                    sideslip: f64::atan2(left * speed.signum(), speed.abs()),
                    speed: f64::hypot(speed, left).copysign(speed),
                    pose_time: time,
                },
                estimate,
                deviation: estimator.sideslip_variance().sqrt(),
                covariance,
                verdict: None,
            });
        }
        let angle = 0.25 * f64::sin(1.3 * now) + 0.1 * f64::sin(4.1 * now);
        estimator.send(time, angle);
        sent.push((now, angle));
    }
    moments
}

fn seen(truth: Truth) -> Vec<Moment> {
    drive(truth, MarkerLoss::Hold, |_, _| true)
}

/// Root mean square of an error once the estimate has settled.
fn error(moments: &[Moment], of: impl Fn(&Moment) -> f64) -> f64 {
    let settled: Vec<f64> = moments
        .iter()
        .filter(|moment| moment.time > SETTLED)
        .map(|moment| of(moment).powi(2))
        .collect();
    (settled.iter().sum::<f64>() / settled.len() as f64).sqrt()
}

fn yaw_rate_error(moments: &[Moment]) -> f64 {
    error(moments, |it| it.estimate.yaw_rate - it.truth.yaw_rate)
}

fn sideslip_error(moments: &[Moment]) -> f64 {
    error(moments, |it| wrap(it.estimate.sideslip - it.truth.sideslip))
}

#[test]
fn the_estimate_is_several_times_quieter_than_the_gyro_of_a_car_that_vibrates() {
    let moments = seen(CAR);
    let (yaw_rate, sideslip) = (yaw_rate_error(&moments), sideslip_error(&moments));
    assert!(yaw_rate < 0.35 * CAR.gyro, "{yaw_rate}");
    assert!(sideslip < 0.004, "{sideslip}");
    assert!(
        moments
            .iter()
            .filter_map(|it| it.verdict)
            .all(|it| it == PoseVerdict::Accepted)
    );
}

#[test]
fn steering_that_is_other_than_was_sent_costs_accuracy_and_nothing_else() {
    let cars = [
        (
            "30 % less",
            Truth {
                steering: [0.7, 0.0],
                ..CAR
            },
        ),
        (
            "trim",
            Truth {
                steering: [1.0, 0.05],
                ..CAR
            },
        ),
        ("twice the lag", Truth { lag: 0.08, ..CAR }),
        ("frozen", Truth { frozen: 8.0, ..CAR }),
        (
            "reversed",
            Truth {
                steering: [-1.0, 0.0],
                ..CAR
            },
        ),
        (
            "no servo",
            Truth {
                steering: [0.0, 0.1],
                ..CAR
            },
        ),
    ];
    for (name, truth) in cars {
        let moments = seen(truth);
        let (yaw_rate, sideslip) = (yaw_rate_error(&moments), sideslip_error(&moments));
        assert!(yaw_rate < 0.6 * CAR.gyro, "{name}: {yaw_rate}");
        assert!(sideslip < 0.02, "{name}: {sideslip}");
        let refused = moments
            .iter()
            .filter(|it| it.verdict == Some(PoseVerdict::Implausible));
        assert_eq!(refused.count(), 0, "{name}");
    }
}

#[test]
fn a_gyro_that_is_quiet_is_believed_although_it_is_said_to_be_noisy() {
    let moments = seen(Truth { gyro: 0.003, ..CAR });
    let error = yaw_rate_error(&moments);
    assert!(error < 1.1 * 0.003, "{error}");
}

#[test]
fn the_stated_deviation_of_the_sideslip_holds() {
    for gyro in [0.003, 0.06, 0.3] {
        let moments = seen(Truth { gyro, ..CAR });
        let settled = moments.iter().filter(|it| it.time > SETTLED);
        let within = settled.clone().filter(|it| {
            wrap(it.estimate.sideslip - it.truth.sideslip).abs() <= 1.96 * it.deviation
        });
        let share = within.count() as f64 / settled.count() as f64;
        assert!(share > 0.9, "{gyro}: {share}");
    }
}

/// Errors of x, y, yaw, speed forward and to the left, and yaw rate, each with its variance.
fn errors(moment: &Moment) -> [(f64, f64); 6] {
    let numbers = |it: &Estimate| {
        let (s, c) = f64::sin_cos(it.sideslip);
        let twist = [it.speed * c, it.speed * s, it.yaw_rate];
        (it.position.coords, it.yaw, twist)
    };
    let ((at, yaw, twist), (true_at, true_yaw, true_twist)) =
        (numbers(&moment.estimate), numbers(&moment.truth));
    let off = at - true_at;
    let [x, _, _, y, _, of_yaw] = moment.covariance.pose;
    let [forward, _, _, left, _, rate] = moment.covariance.twist;
    [
        (off.x, x),
        (off.y, y),
        (wrap(yaw - true_yaw), of_yaw),
        (twist[0] - true_twist[0], forward),
        (twist[1] - true_twist[1], left),
        (twist[2] - true_twist[2], rate),
    ]
}

#[test]
fn the_stated_covariances_hold_and_are_not_too_large() {
    // With a gyro of 0.003 rad/s, the deviation of the yaw rate is a third too small.
    for (gyro, speed) in [(0.06, 1.0), (0.06, 2.0), (0.3, 1.0)] {
        let moments = seen(Truth { gyro, speed, ..CAR });
        let settled: Vec<_> = moments.iter().filter(|it| it.time > SETTLED).collect();
        for axis in 0..6 {
            let all = || settled.iter().map(|moment| errors(moment)[axis]);
            let within = all().filter(|(error, variance)| error * error <= 3.84 * variance);
            let share = within.count() as f64 / settled.len() as f64;
            let sum = |of: fn((f64, f64)) -> f64| all().map(of).sum::<f64>();
            let ratio = (sum(|(_, variance)| variance) / sum(|(error, _)| error * error)).sqrt();
            assert!(
                share > 0.9 && ratio < 3.0,
                "{gyro} {speed} {axis}: {share} {ratio}"
            );
        }
    }
}

#[test]
fn the_covariance_of_a_pose_that_is_held_counts_how_far_the_car_has_gone() {
    let dark = |time: f64, _: &mut PoseSample| !(10.0..10.5).contains(&time);
    let moments = drive(CAR, MarkerLoss::Hold, dark);
    let held = |it: &&Moment| (10.1..10.5).contains(&it.time);
    for moment in moments.iter().filter(held) {
        for (error, variance) in &errors(moment)[..3] {
            assert!(
                error.abs() < 2.0 * variance.sqrt(),
                "{}: {error}",
                moment.time
            );
        }
    }
    assert!(
        moments
            .iter()
            .filter(held)
            .any(|it| it.covariance.pose[0] > 0.01)
    );
}

#[test]
fn a_jump_of_the_cameras_for_some_frames_moves_the_estimate_little() {
    let jumps = |time: f64, pose: &mut PoseSample| {
        if (10.0..10.045).contains(&time) {
            pose.position.x += 0.05;
        }
        true
    };
    let moments = drive(CAR, MarkerLoss::Hold, jumps);
    let farthest = moments
        .iter()
        .filter(|moment| (9.9..11.0).contains(&moment.time))
        .map(|moment| (moment.estimate.position - moment.truth.position).norm())
        .fold(0.0, f64::max);
    assert!(farthest < 0.004, "{farthest}");
}

#[test]
fn a_car_without_markers_is_reckoned_from_its_wheels_and_its_gyro() {
    let moments = drive(CAR, MarkerLoss::DeadReckon, |time, _| {
        !(10.0..10.3).contains(&time)
    });
    let farthest = moments
        .iter()
        .filter(|moment| (10.0..10.3).contains(&moment.time))
        .map(|moment| (moment.estimate.position - moment.truth.position).norm())
        .fold(0.0, f64::max);
    assert!(farthest < 0.008, "{farthest}");
}

#[test]
fn a_car_in_reverse_is_estimated_as_well() {
    let moments = seen(Truth { speed: -0.6, ..CAR });
    let (yaw_rate, sideslip) = (yaw_rate_error(&moments), sideslip_error(&moments));
    assert!(yaw_rate < 0.3 * CAR.gyro, "{yaw_rate}");
    assert!(sideslip < 0.02, "{sideslip}");
}

#[test]
fn the_speed_of_a_car_that_brakes_is_followed() {
    for braking in [1.0, 1.5, 3.0, 8.0] {
        let moments = seen(Truth { braking, ..CAR });
        let stops = moments
            .iter()
            .filter(|it| (BRAKES_FROM..BRAKES_FROM + 1.2 / braking).contains(&it.time));
        let off = stops
            .map(|it| it.estimate.speed - it.truth.speed)
            .fold(0.0_f64, |most, off| most.max(off.abs()));
        assert!(off < 0.04 + 0.02 * braking, "{braking}: {off}");
    }
}
