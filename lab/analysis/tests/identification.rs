//! Known cars, identified from drives with noise.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use crate::synthetic::Course;
use singletrack_analysis::identification::{
    Channel, Criterion, DriveData, Identification, IdentificationError, NoiseLevels, Parameter,
    Pose, ServoFrames, Settings, Tyres, Values, Warning, cramer_rao, identify, validate,
};
use singletrack_control::VehicleParameters;

/// Start values far from the true car.
fn wrong() -> VehicleParameters {
    let car = VehicleParameters::paper();
    VehicleParameters {
        front_cornering_stiffness_n_rad: 1.5 * car.front_cornering_stiffness_n_rad,
        rear_cornering_stiffness_n_rad: 0.6 * car.rear_cornering_stiffness_n_rad,
        yaw_inertia_kg_m2: 1.6 * car.yaw_inertia_kg_m2,
        ..car
    }
}

fn truth(course: &Course, parameter: Parameter) -> f64 {
    match parameter {
        Parameter::SteeringGain => course.steering_gain,
        Parameter::ServoLag => course.servo_lag,
        Parameter::SteeringDelay => course.steering_delay,
        Parameter::SteeringTrim => course.trim,
        Parameter::InertialDelay => course.inertial_delay,
        Parameter::LateralBias => course.left_bias,
        Parameter::GyroScale => course.gyro_scale,
        vehicle => Values::of(&course.vehicle).get(vehicle),
    }
}

fn relative_error(found: &Identification, course: &Course, parameter: Parameter) -> f64 {
    let truth = truth(course, parameter);
    (found.estimate(parameter).unwrap().value - truth).abs() / truth
}

/// The sensors of a small real car: ten inertial samples a second with the noise of a car that drives, a
/// gyro whose scale is wrong, late time stamps, and samples with the time stamp of a pose.
fn real_sensors(seed: u64, seconds: f64) -> Course {
    let weaving = Course::weaving(seed, seconds);
    Course {
        inertial_period_ms: 100,
        // A sample 3 ms after a pose's period began is stamped as the pose 7 ms after it.
        inertial_delay: 0.004,
        steering_delay: 0.02,
        gyro_scale: 1.028,
        noise: NoiseLevels {
            yaw_rate_rad_s: 0.03,
            left_m_s2: 0.5,
            forward_density: 0.03,
            ..weaving.noise
        },
        ..weaving
    }
}

/// The samples, of which many have exactly the time stamps of poses.
fn tied(course: &Course) -> DriveData {
    let mut data = course.drive();
    for sample in &mut data.inertial {
        sample.time_s = (sample.time_s / 0.001).round() * 0.001;
    }
    let ties = data.inertial.iter();
    let ties = ties.filter(|sample| data.poses.iter().any(|pose| pose.time_s == sample.time_s));
    assert!(ties.count() > 50);
    data
}

#[test]
fn the_simulations_parameters_are_those_of_the_car_where_the_model_is_right() {
    let course = real_sensors(17, 30.0);
    let settings = Settings {
        frames: Some(ServoFrames::Even),
        criterion: Some(Criterion::Simulation),
        ..Settings::default()
    };
    let found = identify(&tied(&course), &wrong(), &settings).unwrap();
    assert_eq!(found.criterion, Criterion::Simulation);
    for (parameter, within) in [
        (Parameter::FrontStiffness, 0.05),
        (Parameter::RearStiffness, 0.05),
        (Parameter::YawInertia, 0.1),
        (Parameter::GyroScale, 0.01),
    ] {
        let error = relative_error(&found, &course, parameter);
        assert!(error < within, "{parameter}: {error}");
    }
}

#[test]
fn a_car_without_an_imu_is_identified_by_cameras_and_steering() {
    let course = Course::weaving(23, 30.0);
    let mut data = course.drive();
    data.inertial.clear();
    data.take_acceleration_of_poses();
    let settings = Settings {
        frames: Some(ServoFrames::Even),
        ..Settings::default()
    };
    let found = identify(&data, &wrong(), &settings).unwrap();
    for parameter in Parameter::VEHICLE {
        let error = relative_error(&found, &course, parameter);
        assert!(error < 0.05, "{parameter}: {error}");
    }
    for sensor in [
        Parameter::GyroScale,
        Parameter::LateralBias,
        Parameter::InertialDelay,
    ] {
        assert!(found.estimate(sensor).is_none(), "{sensor}");
    }
    let measured = found.score.outputs.map(|output| !output.rms.is_nan());
    // Yaw rate and sideslip by the cameras, and no acceleration to the left.
    assert_eq!(measured, [true, true, false]);
}

#[test]
fn no_standard_deviation_is_below_the_cramer_rao_bound() {
    let course = Course::weaving(2, 10.0);
    let data = course.drive();
    let settings = Settings {
        frames: Some(ServoFrames::Even),
        ..Settings::default()
    };
    let found = identify(&data, &course.vehicle, &settings).unwrap();
    let bounds = cramer_rao(
        &data,
        &found.values,
        &course.noise,
        ServoFrames::Even,
        &settings,
    )
    .unwrap();
    for (estimate, bound) in found.estimates.iter().zip(bounds) {
        // Without the least deviation that is stated in any case.
        let deviation = estimate.white_deviation.max(estimate.robust_deviation);
        assert!(estimate.standard_deviation >= deviation);
        let ratio = deviation / bound;
        // The noise level is an estimate and may be somewhat too small.
        assert!(
            (0.9..2.0).contains(&ratio),
            "{}: {ratio}",
            estimate.parameter
        );
    }
}

#[test]
fn unmodelled_behaviour_causes_a_warning_of_coloured_errors() {
    // An oscillation of the gyro with a period of four samples.
    let mut data = Course::weaving(8, 10.0).drive();
    for (sample, sign) in data
        .inertial
        .iter_mut()
        .zip([1.0, 1.0, -1.0, -1.0].iter().cycle())
    {
        sample.yaw_rate_rad_s += 0.01 * sign;
    }
    let found = identify(&data, &VehicleParameters::paper(), &Settings::default()).unwrap();
    assert!(
        found.warnings.iter().any(|warning| matches!(
            warning,
            Warning::Coloured {
                channel: Channel::YawRate,
                ..
            }
        )),
        "{:?}",
        found.warnings
    );
}

#[test]
fn lost_markers_split_a_drive_without_harm() {
    let course = Course::weaving(9, 20.0);
    let mut data = course.drive();
    data.poses
        .retain(|pose| !(6.0..6.5).contains(&pose.time_s) && !(11.0..11.2).contains(&pose.time_s));
    let found = identify(&data, &wrong(), &Settings::default()).unwrap();
    // A gap of 0.2 s is bridged, a gap of 0.5 s is not.
    assert_eq!(found.stretches.len(), 2, "{:?}", found.stretches);
    let error = relative_error(&found, &course, Parameter::RearStiffness);
    assert!(error < 0.02, "{error}");
}

fn rejection(data: &DriveData) -> IdentificationError {
    match identify(data, &VehicleParameters::paper(), &Settings::default()) {
        Err(error) => error,
        Ok(found) => panic!("{:?}", found.estimates),
    }
}

#[test]
fn an_unusable_drive_is_rejected_by_name() {
    let data = Course::weaving(12, 6.0).drive();
    let without = |change: fn(&mut DriveData)| {
        let mut data = data.clone();
        change(&mut data);
        rejection(&data).to_string()
    };
    let text = without(|data| data.inertial.clear());
    assert!(text.contains("0 samples of the IMU"), "{text}");
    let text = without(|data| data.poses.clear());
    assert!(text.contains("0 poses of the motion capture"), "{text}");
    let text = without(|data| data.servo.clear());
    assert!(text.contains("0 servo pulses"), "{text}");
    let text = without(|data| data.poses[17].x_m = f64::NAN);
    assert!(text.contains("number 17 of the poses"), "{text}");
    let text = without(|data| data.inertial.swap(3, 4));
    assert!(
        text.contains("number 4 of the samples of the IMU"),
        "{text}"
    );
    let text = without(|data| data.poses.truncate(400));
    assert!(
        text.contains("only 3.9 s") || text.contains("only 4.0 s"),
        "{text}"
    );
    let slow = Course {
        speed: [0.3, 0.05],
        ..Course::weaving(13, 8.0)
    };
    let text = rejection(&slow.drive()).to_string();
    assert!(text.contains("never faster than 0.3"), "{text}");
    let nothing = Settings {
        parameters: Vec::new(),
        ..Settings::default()
    };
    assert_eq!(
        identify(&data, &VehicleParameters::paper(), &nothing).err(),
        Some(IdentificationError::NoParameter)
    );
}

#[test]
fn sensors_that_contradict_each_other_are_named_before_anything_is_fitted() {
    let data = Course::weaving(19, 8.0).drive();
    let with = |change: fn(&mut DriveData)| {
        let mut data = data.clone();
        change(&mut data);
        rejection(&data)
    };
    let error = with(|data| {
        for pose in &mut data.poses {
            pose.x_m *= 1e3;
            pose.y_m *= 1e3;
        }
    });
    assert!(matches!(error, IdentificationError::TooFast(_)), "{error}");
    let error = with(|data| {
        for pose in &mut data.poses {
            pose.yaw_rad += 3.0;
        }
    });
    assert!(
        matches!(error, IdentificationError::YawDiffers(_)),
        "{error}"
    );
    let error = with(|data| {
        for sample in &mut data.inertial {
            sample.yaw_rate_rad_s *= -1.0;
        }
    });
    assert!(
        matches!(error, IdentificationError::GyroDiffers(ratio) if ratio < -0.9),
        "{error}"
    );
    let error = with(|data| {
        for sample in &mut data.inertial {
            sample.yaw_rate_rad_s = sample.yaw_rate_rad_s.to_degrees();
        }
    });
    assert!(
        matches!(error, IdentificationError::GyroDiffers(ratio) if ratio > 50.0),
        "{error}"
    );
    let error = with(|data| {
        for target in &mut data.servo {
            target.angle_rad *= -1.0;
        }
    });
    assert!(
        matches!(error, IdentificationError::SteeringOpposes(_)),
        "{error}"
    );
    let error = with(|data| {
        for sample in &mut data.inertial {
            sample.left_m_s2 = 0.0;
        }
    });
    assert!(matches!(error, IdentificationError::Dead(..)), "{error}");
}

#[test]
fn the_same_drive_gives_the_same_bits() {
    let data = Course::weaving(14, 6.0).drive();
    let once = || {
        identify(&data, &wrong(), &Settings::default())
            .unwrap()
            .values
    };
    assert_eq!(once(), once());
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough;
