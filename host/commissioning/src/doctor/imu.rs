//! The IMU at rest and turned by hand.

use nalgebra::Vector3;
use singletrack_protocol::{ImuAxes, ImuAxis};

use super::gather::{Checks, norm};
use crate::{
    Bench, Finding, Inertial, Interval, Parameter, Plot, PlotKind, PlotLine, PoseReading, Trouble,
    Verdict::{Failed, Warning},
    fit::{block_means, mean, mean_interval, standard_deviation},
    imu_noise::{NoiseLevel, compare},
    observed::Readings,
};

/// Time at rest, in s.
const REST_S: f64 = 60.0;
/// Blocks of this time, for the interval of the bias.
const BLOCKS: usize = 10;
/// Half of the gyro's resolution, in rad/s: an error that all readings may share.
const HALF_STEP: f64 = 0.000_5;
/// The largest tilt of the IMU on a level floor, in rad: 5 degrees.
const MAX_TILT: f64 = 0.087;
/// The least rotation of a lift or turn, in rad.
const ENOUGH_RAD: f64 = 0.5;
/// Most of a lift's rotation that may remain once the car is put down, as a share.
const BACK: f64 = 0.4;

/// Registers, tilt, bias and noise of a car that stands.
pub(super) fn rest(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let mut checks = Checks::begin(bench);
    let request = "Put the car on a level floor, where the cameras see it. Press Enter, and do not \
                   touch it for a minute.";
    checks.needs("rest", "stand-still", request)?;
    // The hand leaves the car.
    checks.for_time(1.0, "wait")?;
    let readings = checks.for_time(REST_S, "rest")?;
    check_registers(&readings, &mut checks);
    let samples: Vec<Inertial> = readings.inertial().collect();
    let rate = samples.len() as f64 / readings.duration().max(1.0);
    let found = format!("{rate:.0} samples a second");
    let fix = "look at the IMU's wires (SDA, SCL, 5 V, ground), see docs/uno.md";
    checks.check(rate > 80.0, found, "100", fix);
    if samples.len() > 10 * BLOCKS {
        check_gyro(&samples, &mut checks);
        check_tilt(&samples, &readings.poses, &mut checks);
        check_noise(samples, &mut checks);
    }
    check_wheels(&readings, &mut checks);
    let lines = vec![PlotLine::new("gyro", PlotKind::Measured, readings.gyro())];
    let title = "The gyro at rest";
    let plot = Plot::new("rest", title, Plot::YAW_RATE, lines);
    checks.bench.plot(&plot);
    checks.finding()
}

fn check_registers(readings: &Readings, checks: &mut Checks<'_>) {
    let Some(status) = readings.status() else {
        return;
    };
    let [system, gyro, accelerometer] =
        [6, 4, 2].map(|shift| status.imu_calibration >> shift & 0b11);
    let errors = readings.risen(|status| status.imu_errors);
    // Accelerometer, gyro and controller; the magnetometer is not used. Zero: not read yet.
    let has_passed = matches!(status.imu_self_test & 0b1101, 0 | 0b1101);
    let is_good = status.imu_status != 1 && status.imu_error == 0 && has_passed;
    let found = format!(
        "IMU status {}, error {}, self-test {:04b}",
        status.imu_status, status.imu_error, status.imu_self_test
    );
    let fix = "switch the board off and on; if it stays, replace the IMU";
    checks.check(is_good, found, "status 5, error 0, self-test 1111", fix);
    if gyro < 3 {
        let found =
            format!("calibration: system {system}, gyro {gyro}, accelerometer {accelerometer}");
        let fix = "leave the car at rest for some seconds after each start";
        checks.add(Warning, found, "gyro 3", fix);
    } else {
        checks.good(format!("gyro calibrated ({gyro} of 3)"), "3");
    }
    if errors > 0 {
        let found = format!("{errors} errors on the bus to the IMU");
        let fix = "shorten its wires, and keep them away from the motor's";
        checks.add(Warning, found, "none", fix);
    }
}

fn check_gyro(samples: &[Inertial], checks: &mut Checks<'_>) {
    let rates = samples.iter().map(|sample| sample.angular_velocity[2]);
    let rates: Vec<f64> = rates.collect();
    let noise = standard_deviation(&rates).unwrap_or(0.0);
    // Noise of more than a step makes the mean finer than the steps.
    let steps = if noise > HALF_STEP { 0.1 } else { 1.0 } * HALF_STEP;
    let Some(bias) = mean_interval(block_means(&rates, BLOCKS), steps) else {
        return;
    };
    let limit = checks.config().watch.max_gyro_bias_rad_s / 4.0;
    let found = format!("gyro bias {:.4} rad/s", bias.value);
    let fix = "leave the car at rest while the IMU starts: it calibrates its gyro then";
    let is_good = bias.value.abs() < limit;
    checks.check(is_good, found, format!("below {limit:.3}"), fix);
    let found = format!("noise {noise:.4} rad/s");
    let fix = "fix the IMU to the chassis, and the car to a floor that does not shake";
    checks.check(noise < 0.02, found, "below 0.02", fix);
    checks.measured(Parameter::new("gyro-bias", "rad/s", bias));
    // The noise is white: the standard deviation's own error is 1 / sqrt(2 n).
    let spread = 1.96 * noise / (2.0 * rates.len() as f64).sqrt();
    let estimate = Interval::around(noise, spread).widened(0.3 * HALF_STEP);
    checks.measured(Parameter::new("gyro-noise", "rad/s", estimate));
}

/// The noise at rest, against what the estimator believes. It is larger while the wheels turn:
/// `doctor --stand`.
fn check_noise(samples: Vec<Inertial>, checks: &mut Checks<'_>) {
    let Some(level) = NoiseLevel::of(0.0, &[samples]) else {
        return;
    };
    let comparison = compare(&[level], &checks.config().estimator);
    let found = comparison.found.join("; ");
    let expected = "at most 1.3 times what [estimator] believes";
    if comparison.too_small.is_empty() {
        checks.good(found, expected);
    } else {
        let too_small = comparison.too_small.join(", ");
        let found = format!("{found}; too small: {too_small}: raised");
        checks.add(Warning, found, expected, "");
    }
    for parameter in comparison.parameters {
        checks.measured(parameter);
    }
}

fn check_tilt(samples: &[Inertial], poses: &[PoseReading], checks: &mut Checks<'_>) {
    let average = |part: fn(&Inertial) -> f64| mean(samples.iter().map(part)).unwrap_or(0.0);
    let roll = average(|sample| sample.roll);
    let pitch = average(|sample| sample.pitch);
    let [roll_deg, pitch_deg] = [roll, pitch].map(f64::to_degrees);
    let found = format!("IMU roll {roll_deg:.1}, pitch {pitch_deg:.1} degrees");
    let fix = "if the floor is level, the IMU is mounted askew or board.imu is wrong: see the next \
               step";
    checks.check(roll.hypot(pitch) < MAX_TILT, found, "below 5", fix);
    let body = |part: fn(&PoseReading) -> f64| mean(poses.iter().map(part));
    let (Some(of_roll), Some(of_pitch)) = (body(|pose| pose.roll), body(|pose| pose.pitch)) else {
        return;
    };
    let limit = checks.config().watch.max_tilt_difference_rad;
    let difference = (roll - of_roll).hypot(pitch - of_pitch);
    // The next steps show which of them is wrong.
    let found = format!("{:.1} degrees from the cameras", difference.to_degrees());
    let expected = format!("below {:.1}", limit.to_degrees());
    let fix = "define the rigid body in the cameras' program with the car level";
    checks.add(Warning.unless(difference < limit), found, expected, fix);
}

/// Wheels at rest must give no pulses.
fn check_wheels(readings: &Readings, checks: &mut Checks<'_>) {
    let moving = readings.boards.iter().filter(|board| board.turns()).count();
    let refused = readings.risen(|status| status.edges_refused);
    let is_good = moving == 0 && refused == 0;
    let found = match is_good {
        true => "no motor pulses at rest".to_owned(),
        false => format!("motor pulses at rest: {moving} readings, {refused} refused edges"),
    };
    let fix = "the wire to D2 picks up noise: 1 kOhm and 10 nF at the pin, see docs/uno.md";
    checks.check(is_good, found, "none", fix);
}

/// The axes by three motions. Wrong ones are corrected in the configuration, and tried again.
pub(super) fn axes(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let mut checks = Checks::begin(bench);
    let before = checks.config().board_configuration().imu_axes;
    let found = mounting(&mut checks)?;
    if found == before {
        checks.good(format!("axes are {}", words(found)), "as configured");
        return checks.finding();
    }
    let values = [
        ("board.imu.forward", found.forward),
        ("board.imu.left", found.left),
        ("board.imu.up", found.up),
    ]
    .map(|(key, axis)| (key, toml_edit::Value::from(axis.name())));
    let fix = "correct board.imu in the configuration, and run this step again";
    let [measured, configured] = [found, before].map(words);
    let text = format!("axes are {measured}, configured were {configured}");
    if let Err(refused) = checks.put_in_force(&values)? {
        let found = format!("{text}; not changed: {refused}");
        return Err(checks.fail(found, "as configured", fix));
    }
    // The board restarts the IMU with the new axes.
    checks.for_time(2.0, "the IMU starts with its new axes")?;
    let again = mounting(&mut checks)?;
    if again == found {
        checks.add(Warning, format!("{text}: corrected"), "as configured", "");
    } else {
        let found = format!("{text}; after the correction they are {}", words(again));
        checks.add(Failed, found, "as configured", fix);
    }
    checks.finding()
}

/// The mounting of the chip, by three motions.
fn mounting(checks: &mut Checks<'_>) -> Result<ImuAxes, Trouble> {
    // The car is put down again after a lift, but not turned back.
    let left_up = "Press Enter, then lift the left side of the car by about 45 degrees, hold it \
                   for a second, and put it down again.";
    let nose_up = "Press Enter, then lift the front of the car until its nose points up by about \
                   45 degrees, hold it for a second, and put it down again.";
    let turn = "Press Enter, then turn the car to the left (counter-clockwise from above) by about \
                90 degrees, flat on the floor, and let go.";
    let steps = [
        ("left-side-up", left_up, "left side up", true),
        ("nose-up", nose_up, "nose up", true),
        ("turn-left", turn, "turn to the left", false),
    ];
    let mut rotations = [[0.0; 3]; 3];
    for (rotation, (id, request, what, returns)) in rotations.iter_mut().zip(steps) {
        checks.needs(what, id, request)?;
        let (readings, is_done) = checks.motion(|readings| {
            let (largest, last) = rotations_of(readings).map(norm).into();
            let is_back = !returns || last < BACK * largest;
            let done = largest / ENOUGH_RAD;
            let text = format!("{what}: {:.0} degrees", largest.to_degrees());
            (text, if is_back { done } else { done.min(0.9) })
        })?;
        if !is_done {
            let degrees = norm(rotations_of(&readings)[0]).to_degrees();
            let found = format!("{what}: the IMU turned by {degrees:.0} degrees only");
            let fix = "repeat the motion; if it was done, the IMU does not measure it";
            return Err(checks.fail(found, "30 degrees or more", fix));
        }
        [*rotation, _] = rotations_of(&readings);
    }
    let [roll, nose_up, turn] = rotations;
    let axes = checks.config().board_configuration().imu_axes;
    // Along the chip's own axes, in the sense of forward, left and up.
    let measured = [roll, nose_up.map(|part| -part), turn].map(|vector| on_chip(axes, vector));
    nearest(measured).ok_or_else(|| {
        let found = "the three motions are not about the axes of the IMU";
        let fix = "mount the IMU along the axes of the car, and repeat the motions one axis at a \
                   time";
        checks.fail(found, "each within 35 degrees of one", fix)
    })
}

/// The largest rotation since the beginning, and the present one, as vectors in the configured
/// axes.
fn rotations_of(readings: &Readings) -> [[f64; 3]; 2] {
    let [mut largest, mut rotation] = [Vector3::zeros(); 2];
    let samples: Vec<Inertial> = readings.inertial().collect();
    for pair in samples.windows(2) {
        // A gap is no rotation.
        let step = pair[1].time.seconds_since(pair[0].time).clamp(0.0, 0.05);
        let rates = [pair[0], pair[1]].map(|sample| Vector3::from(sample.angular_velocity));
        rotation += 0.5 * step * (rates[0] + rates[1]);
        if rotation.norm() > largest.norm() {
            largest = rotation;
        }
    }
    [largest, rotation].map(Into::into)
}

/// A vector of readings, turned back to the chip's own axes.
fn on_chip(axes: ImuAxes, [forward, left, up]: [f64; 3]) -> [f64; 3] {
    let mut chip = [0.0; 3];
    for (part, axis) in [(forward, axes.forward), (left, axes.left), (up, axes.up)] {
        let (index, sign) = direction(axis);
        chip[index] += sign * part;
    }
    chip
}

/// The mounting whose axes are nearest to these directions of the chip; none if one of them is
/// far from all axes.
fn nearest(measured: [[f64; 3]; 3]) -> Option<ImuAxes> {
    /// Cosine of 35 degrees.
    const CLOSE: f64 = 0.82;
    let mut axes = [ImuAxis::PlusX; 3];
    for (axis, vector) in axes.iter_mut().zip(measured) {
        let length = norm(vector);
        *axis = ImuAxis::ALL.into_iter().find(|axis| {
            let (index, sign) = direction(*axis);
            sign * vector[index] > CLOSE * length
        })?;
    }
    let [forward, left, up] = axes;
    let axes = ImuAxes { forward, left, up };
    axes.is_mounting().then_some(axes)
}

/// The index and the sign of an axis.
fn direction(axis: ImuAxis) -> (usize, f64) {
    let sign = if axis.is_negative() { -1.0 } else { 1.0 };
    (axis.index().into(), sign)
}

fn words(axes: ImuAxes) -> String {
    [axes.forward, axes.left, axes.up]
        .map(ImuAxis::name)
        .join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all_mountings() -> Vec<ImuAxes> {
        let mut mountings = Vec::new();
        for forward in ImuAxis::ALL {
            for left in ImuAxis::ALL {
                for up in ImuAxis::ALL {
                    let axes = ImuAxes { forward, left, up };
                    if axes.is_mounting() {
                        mountings.push(axes);
                    }
                }
            }
        }
        mountings
    }

    /// What a chip that is mounted as `truth` reads in the axes that are configured.
    fn reads(truth: ImuAxes, configured: ImuAxes, car: [f64; 3]) -> [f64; 3] {
        let chip = on_chip(truth, car);
        [configured.forward, configured.left, configured.up].map(|axis| {
            let (index, sign) = direction(axis);
            sign * chip[index]
        })
    }

    #[test]
    fn every_mounting_is_found_from_every_configured_one() {
        assert_eq!(all_mountings().len(), 24);
        for truth in all_mountings() {
            for configured in all_mountings() {
                // Motions by hand are 10 degrees off their axis.
                let motions = [[0.8, 0.1, 0.1], [-0.1, -0.8, 0.1], [0.1, -0.1, 1.5]];
                let [roll, nose_up, turn] = motions.map(|car| reads(truth, configured, car));
                let found = nearest(
                    [roll, nose_up.map(|part| -part), turn]
                        .map(|vector| on_chip(configured, vector)),
                );
                assert_eq!(found, Some(truth));
            }
        }
    }

    #[test]
    fn motions_that_are_not_about_the_axes_give_no_mounting() {
        let straight = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert!(nearest(straight).is_some());
        let mut skew = straight;
        skew[1] = [0.7, 0.7, 0.0];
        assert!(nearest(skew).is_none());
        // The nose went down: the axes are left-handed then.
        let mut down = straight;
        down[1] = [0.0, -1.0, 0.0];
        assert!(nearest(down).is_none());
        let mut twice = straight;
        twice[1] = [1.0, 0.0, 0.0];
        assert!(nearest(twice).is_none());
    }
}
