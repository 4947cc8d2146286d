//! Known cars that take seconds to identify, from drives with noise.

use super::*;

#[test]
fn a_servo_that_answers_after_20_to_150_ms_is_identified() {
    // The longest is pulled by its prior, which the yaw inertia makes good.
    for (delay, within) in [(0.02, 0.1), (0.08, 0.1), (0.15, 0.25)] {
        let course = Course {
            steering_delay: delay,
            ..Course::weaving(21, 20.0)
        };
        let settings = Settings {
            frames: Some(ServoFrames::Even),
            ..Settings::default()
        };
        let found = identify(&course.drive(), &wrong(), &settings).unwrap();
        let estimate = found.estimate(Parameter::SteeringDelay).unwrap();
        assert!(
            (estimate.value - delay).abs() < 0.003,
            "{delay}: {estimate:?}"
        );
        for parameter in Parameter::VEHICLE {
            let error = relative_error(&found, &course, parameter);
            assert!(error < within, "{delay}, {parameter}: {error}");
        }
    }
}

#[test]
fn linear_tyres_underestimate_the_stiffness_of_a_sliding_car() {
    let course = Course::weaving(4, 15.0);
    let data = course.drive();
    let settings = |tyres| Settings {
        tyres,
        frames: Some(ServoFrames::Even),
        ..Settings::default()
    };
    let right = identify(&data, &course.vehicle, &settings(Tyres::Saturating)).unwrap();
    let linear = identify(&data, &course.vehicle, &settings(Tyres::Linear)).unwrap();
    for parameter in [Parameter::FrontStiffness, Parameter::RearStiffness] {
        let [right, linear] = [&right, &linear].map(|found| found.estimate(parameter).unwrap());
        assert!(
            linear.value < 0.95 * right.value,
            "{parameter}: {} {}",
            linear.value,
            right.value
        );
    }
    // The errors and the noise levels show it.
    assert!(linear.score.nmpe > 1.2 * right.score.nmpe);
    assert!(linear.noise.force_density > 10.0 * right.noise.force_density);
    assert!(
        linear
            .warnings
            .iter()
            .any(|warning| matches!(warning, Warning::LinearTyres(share) if *share > 0.5)),
        "{:?}",
        linear.warnings
    );
    // The sensors do not become perfect.
    assert!(linear.noise.left_m_s2 > 0.5 * course.noise.left_m_s2);
    assert!(linear.noise.yaw_rate_rad_s > 0.5 * course.noise.yaw_rate_rad_s);
}

#[test]
fn a_steering_that_is_known_roughly_is_found_beyond_what_a_servo_usually_takes() {
    let course = Course {
        steering_delay: 0.26,
        ..Course::weaving(21, 20.0)
    };
    let settings = Settings {
        frames: Some(ServoFrames::Even),
        steering: Some([0.24, 0.06]),
        ..Settings::default()
    };
    let found = identify(&course.drive(), &wrong(), &settings).unwrap();
    let estimate = found.estimate(Parameter::SteeringDelay).unwrap();
    assert_eq!(estimate.start, 0.24);
    assert!((estimate.value - 0.26).abs() < 0.003, "{estimate:?}");
}

#[test]
fn the_centre_of_mass_and_the_steering_gain_can_be_identified() {
    let course = Course {
        vehicle: VehicleParameters::paper().with_centre_of_mass_at(0.13),
        steering_gain: 1.04,
        speed: [1.5, 0.4],
        ..Course::weaving(3, 20.0)
    };
    let asked = [
        Parameter::FrontStiffness,
        Parameter::RearStiffness,
        Parameter::YawInertia,
        Parameter::FrontAxleDistance,
        Parameter::SteeringGain,
    ];
    let found = identify(
        &course.drive(),
        &VehicleParameters::paper(),
        &Settings::of(&asked),
    )
    .unwrap();
    for parameter in asked {
        let estimate = found.estimate(parameter).unwrap();
        let error = (estimate.value - truth(&course, parameter)).abs();
        assert!(
            error < 3.5 * estimate.standard_deviation,
            "{parameter}: {estimate:?}"
        );
    }
    let front_axle = found.estimate(Parameter::FrontAxleDistance).unwrap();
    assert!((front_axle.value - 0.13).abs() < 1e-3, "{front_axle:?}");
    // The wheelbase keeps its value.
    assert!((found.vehicle().wheelbase_m() - 0.26).abs() < 1e-12);
}

#[test]
fn a_wrong_centre_of_mass_causes_a_warning_of_unexplained_forces() {
    let course = Course::weaving(15, 21.0);
    let wrong = course.vehicle.with_centre_of_mass_at(0.1418);
    let settings = |parameters: &[Parameter]| Settings {
        frames: Some(ServoFrames::Even),
        ..Settings::of(parameters)
    };
    let data = course.drive();
    let found = identify(&data, &wrong, &settings(&Parameter::VEHICLE)).unwrap();
    let unexplained = |warning: &Warning| matches!(warning, Warning::Unexplained(_));
    assert!(
        found.warnings.iter().any(unexplained),
        "{:?} {:?}",
        found.warnings,
        found.noise
    );
    // Joint estimation, which the warning recommends, finds it.
    let mut asked = Parameter::VEHICLE.to_vec();
    asked.extend([Parameter::FrontAxleDistance, Parameter::Friction]);
    let found = identify(&data, &wrong, &settings(&asked)).unwrap();
    assert!(
        !found.warnings.iter().any(unexplained),
        "{:?}",
        found.warnings
    );
    let error = relative_error(&found, &course, Parameter::RearStiffness);
    assert!(error < 0.03, "{error}");
}

#[test]
fn a_short_drive_and_a_slow_drive_cause_a_warning() {
    let short = identify(
        &Course::weaving(6, 8.0).drive(),
        &VehicleParameters::paper(),
        &Settings::default(),
    )
    .unwrap();
    assert!(
        matches!(short.warnings[..], [Warning::Short(seconds)] if (7.0..8.0).contains(&seconds)),
        "{:?}",
        short.warnings
    );
    let slow = Course {
        speed: [0.7, 0.1],
        ..Course::weaving(7, 22.0)
    };
    let slow = identify(&slow.drive(), &slow.vehicle, &Settings::default()).unwrap();
    assert!(
        slow.warnings
            .iter()
            .any(|warning| matches!(warning, Warning::Slow(_))),
        "{:?}",
        slow.warnings
    );
}

/// A drive in which the body sways on its springs: what it measures is neither noise nor the model's motion.
fn swaying(course: &Course) -> DriveData {
    let mut data = course.drive();
    for (index, sample) in data.inertial.iter_mut().enumerate() {
        let wave = (0.037 * index as f64).sin();
        sample.left_m_s2 += 1.5 * wave;
        sample.yaw_rate_rad_s += 0.3 * wave;
    }
    data
}

#[test]
fn a_fit_by_simulation_finds_the_delays_that_its_filter_uses_as_well() {
    let course = Course {
        speed: [1.6, 0.9],
        trim: 0.05,
        ..real_sensors(18, 60.0)
    };
    let settings = Settings {
        criterion: Some(Criterion::Simulation),
        ..Settings::default()
    };
    let found = identify(&swaying(&course), &wrong(), &settings).unwrap();
    for estimate in &found.estimates {
        let [low, high] = estimate.interval;
        let truth = truth(&course, estimate.parameter);
        assert!(
            (low..=high).contains(&truth),
            "{}: {low} to {high}, true {truth}",
            estimate.parameter
        );
    }
}

#[test]
fn a_car_that_the_model_does_not_describe_is_identified_by_its_simulation() {
    let course = Course::weaving(18, 21.0);
    let data = swaying(&course);
    let found = identify(&data, &wrong(), &Settings::default()).unwrap();
    assert_eq!(
        found.criterion,
        Criterion::Simulation,
        "{:?}",
        found.warnings
    );
    assert!(
        found
            .warnings
            .iter()
            .any(|warning| matches!(warning, Warning::Simulated { .. })),
        "{:?}",
        found.warnings
    );
    for parameter in Parameter::VEHICLE {
        let error = relative_error(&found, &course, parameter);
        assert!(error < 0.15, "{parameter}: {error}");
    }
}

#[test]
fn a_car_is_identified_from_a_distant_start_jointly_with_noise_and_servo() {
    let course = Course::weaving(1, 21.0);
    let found = identify(&course.drive(), &wrong(), &Settings::default()).unwrap();
    for (parameter, within) in [
        (Parameter::FrontStiffness, 0.01),
        (Parameter::RearStiffness, 0.02),
        (Parameter::YawInertia, 0.01),
        (Parameter::ServoLag, 0.02),
    ] {
        let error = relative_error(&found, &course, parameter);
        assert!(error < within, "{parameter}: {error}");
    }
    assert_eq!(found.frames, ServoFrames::Even);
    for (name, found, truth) in [
        ("position", found.noise.position_m, course.noise.position_m),
        ("yaw", found.noise.yaw_rad, course.noise.yaw_rad),
        (
            "gyro",
            found.noise.yaw_rate_rad_s,
            course.noise.yaw_rate_rad_s,
        ),
        ("left", found.noise.left_m_s2, course.noise.left_m_s2),
    ] {
        assert!(
            (found / truth - 1.0).abs() < 0.06,
            "{name}: {found} {truth}"
        );
    }
    assert_eq!(found.warnings, []);
    // Other parameters keep their values.
    assert_eq!(found.vehicle().mass_kg, course.vehicle.mass_kg);
    assert_eq!(
        found.vehicle().front_axle_distance_m,
        course.vehicle.front_axle_distance_m
    );
}

#[test]
fn a_body_that_is_elsewhere_for_a_while_and_poses_that_are_held_split_a_drive() {
    let course = Course::weaving(21, 20.0);
    let mut data = course.drive();
    for pose in &mut data.poses {
        if (6.0..6.5).contains(&pose.time_s) {
            pose.x_m += 5.0;
        }
    }
    let held = data
        .poses
        .iter()
        .position(|pose| pose.time_s > 12.0)
        .unwrap();
    for index in held + 1..held + 60 {
        let Pose { time_s, .. } = data.poses[index];
        data.poses[index] = Pose {
            time_s,
            ..data.poses[held]
        };
    }
    let found = identify(&data, &wrong(), &Settings::default()).unwrap();
    assert_eq!(found.stretches.len(), 3, "{:?}", found.stretches);
    let error = relative_error(&found, &course, Parameter::RearStiffness);
    assert!(error < 0.03, "{error}");
}

#[test]
fn intervals_of_95_percent_contain_the_truth_in_at_least_90_percent_of_the_drives() {
    let drives: u32 = match std::env::var("IDENTIFICATION_DRIVES") {
        Ok(number) => number.parse().unwrap(),
        // Enough to detect intervals that are a third too narrow. The documentation has the
        // figures of 100 drives.
        Err(_) => 40,
    };
    let settings = Settings {
        frames: Some(ServoFrames::Even),
        noise: Course::weaving(0, 0.0).noise,
        estimate_noise: false,
        ..Settings::default()
    };
    let start = wrong();
    let mut covered = vec![0; settings.parameters.len()];
    let mut squares = vec![0.0; settings.parameters.len()];
    for seed in 0..u64::from(drives) {
        let course = Course::weaving(seed, 6.5);
        let found = identify(&course.drive(), &start, &settings).unwrap();
        for (index, estimate) in found.estimates.iter().enumerate() {
            let error = estimate.value - truth(&course, estimate.parameter);
            let [low, high] = estimate.interval;
            covered[index] += u32::from((low..=high).contains(&truth(&course, estimate.parameter)));
            squares[index] += (error / estimate.white_deviation).powi(2);
        }
    }
    for ((parameter, covered), squares) in settings.parameters.iter().zip(covered).zip(squares) {
        assert!(
            10 * covered >= 9 * drives,
            "{parameter}: {covered} of {drives}"
        );
        // The intervals are not too wide either: the expected ratio is 1.
        let ratio = (squares / f64::from(drives)).sqrt();
        assert!((0.75..1.3).contains(&ratio), "{parameter}: {ratio}");
    }
}

#[test]
fn an_accelerometer_with_the_wrong_sign_causes_a_warning() {
    let mut data = Course::weaving(20, 12.0).drive();
    for sample in &mut data.inertial {
        sample.left_m_s2 *= -1.0;
    }
    match identify(&data, &VehicleParameters::paper(), &Settings::default()) {
        Ok(found) => assert!(
            found.warnings.iter().any(|warning| matches!(
                warning,
                Warning::Unfitted(output, _) if output.name() == "left_acceleration"
            )),
            "{:?}",
            found.warnings
        ),
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn an_answer_at_the_end_of_its_range_is_an_error() {
    // Start values that no car near the true one has.
    let course = Course::weaving(16, 12.0);
    let start = VehicleParameters {
        front_cornering_stiffness_n_rad: 0.01 * course.vehicle.front_cornering_stiffness_n_rad,
        rear_cornering_stiffness_n_rad: 0.01 * course.vehicle.rear_cornering_stiffness_n_rad,
        ..course.vehicle
    };
    let error = identify(&course.drive(), &start, &Settings::default()).unwrap_err();
    assert!(
        matches!(
            error,
            IdentificationError::AtBound { .. }
                | IdentificationError::NotSettled(_)
                | IdentificationError::Diverged(_)
        ),
        "{error}"
    );
}

#[test]
fn another_drive_with_other_biases_is_predicted_as_well() {
    let settings = Settings::default();
    let course = Course::weaving(10, 15.0);
    let found = identify(&course.drive(), &wrong(), &settings).unwrap();
    let other = Course {
        left_bias: -0.1,
        gyro_bias: -0.01,
        inertial_delay: 0.0022,
        ..Course::weaving(11, 12.0)
    };
    let validated = validate(&other.drive(), &found, &settings).unwrap();
    let ratio = validated.score.nmpe / found.score.nmpe;
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
    assert_eq!(validated.vehicle(), found.vehicle());
    let bias = validated.estimate(Parameter::LateralBias).unwrap().value;
    assert!((bias + 0.1).abs() < 0.01, "{bias}");
    // Another car is predicted less well.
    let heavy = Course {
        vehicle: VehicleParameters {
            rear_cornering_stiffness_n_rad: 90.0,
            ..other.vehicle
        },
        ..other
    };
    let validated = validate(&heavy.drive(), &found, &settings).unwrap();
    assert!(validated.score.nmpe > 1.5 * found.score.nmpe);
}

/// The accelerometer of a car that drives measures 2.1 m/s² of vibration. As an input of the model alone
/// it biased `C_f`, `C_r` and `I_z` by 0.9, 0.8 and 0.7 stated deviations.
#[test]
fn vibration_biases_no_estimate_by_a_third_of_its_deviation() {
    let settings = Settings {
        frames: Some(ServoFrames::Even),
        ..Settings::default()
    };
    let drives = 20;
    let mut errors = [[0.0; 3]; 3];
    for seed in 100..100 + drives {
        let weaving = Course::weaving(seed, 20.0);
        let course = Course {
            noise: NoiseLevels {
                yaw_rate_rad_s: 0.076,
                left_m_s2: 2.1,
                forward_density: 0.21,
                ..weaving.noise
            },
            ..weaving
        };
        let found = identify(&course.drive(), &wrong(), &settings).unwrap();
        assert_eq!(found.criterion, Criterion::Prediction, "{seed}");
        for (sums, parameter) in errors.iter_mut().zip(Parameter::VEHICLE) {
            let estimate = found.estimate(parameter).unwrap();
            let truth = truth(&course, parameter);
            let [low, high] = estimate.interval;
            sums[0] += (estimate.value - truth) / drives as f64;
            sums[1] += estimate.standard_deviation / drives as f64;
            sums[2] += f64::from(u8::from((low..=high).contains(&truth)));
        }
    }
    for ([bias, stated, covered], parameter) in errors.into_iter().zip(Parameter::VEHICLE) {
        println!(
            "{parameter}: {:.2} deviations, {covered} of {drives}",
            bias / stated
        );
        assert!(bias.abs() < stated / 3.0, "{parameter}: {bias} {stated}");
        assert!(covered >= 0.9 * drives as f64, "{parameter}: {covered}");
    }
}

#[test]
fn the_intervals_hold_with_the_sensors_of_a_real_car() {
    let drives = 30;
    let settings = Settings {
        frames: Some(ServoFrames::Even),
        noise: real_sensors(0, 0.0).noise,
        estimate_noise: false,
        ..Settings::default()
    };
    let mut covered = vec![0; settings.parameters.len()];
    for seed in 100..100 + drives {
        let course = real_sensors(seed, 9.0);
        let found = identify(&tied(&course), &wrong(), &settings).unwrap();
        assert_eq!(found.criterion, Criterion::Prediction);
        for (covered, estimate) in covered.iter_mut().zip(&found.estimates) {
            let [low, high] = estimate.interval;
            *covered += u64::from((low..=high).contains(&truth(&course, estimate.parameter)));
        }
    }
    for (parameter, covered) in settings.parameters.iter().zip(covered) {
        assert!(
            10 * covered >= 9 * drives,
            "{parameter}: {covered} of {drives}"
        );
    }
}

#[test]
fn an_answer_that_is_the_start_is_an_error_that_says_what_to_drive() {
    let course = Course {
        steering: 0.0,
        trim: 0.0,
        ..Course::weaving(5, 12.0)
    };
    let error = identify(&course.drive(), &course.vehicle, &Settings::default()).unwrap_err();
    let IdentificationError::NotDetermined(parameters) = &error else {
        panic!("{error}");
    };
    assert!(parameters.contains(&Parameter::FrontStiffness), "{error}");
    let text = error.to_string();
    assert!(text.contains("c_f") && text.contains("weave"), "{text}");
}
