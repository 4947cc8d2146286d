//! The judgement of what a car can do: references, limits and the geofence.

use core::f64::consts::PI;

use crate::simulated_drive::SimulatedDrive;
use clap::Parser as _;
use singletrack_core::{
    config::{
        Config, LimitsSection, OuterLoopSection, PathPoints, ReferenceSection, SECTIONS, Start,
    },
    feasibility::{Finding, Judgement, Severity, Stand, judge, judge_reference},
};
use singletrack_pilot::Mode;
use singletrack_sim::{Arguments, SimulationConfig, StartPose};

const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");

/// Less than what the simulated car brakes with at neutral, and not the example's value.
const BRAKING_M_S2: f64 = 0.85;

/// Half of a square fence, m.
const HALF_M: f64 = 1.0;

/// The example with values of a car, a server and a board that are not the example's.
pub(crate) fn own() -> Config {
    let mut config = Config::from_toml(EXAMPLE).unwrap();
    config.motion_capture.server = [10, 0, 0, 2].into();
    config.vehicle.mass_kg += 0.1;
    config.board.servo.centre_us += 1;
    config.board.esc.deadband_us += 1;
    config.board.speed.pulse_distance_um += 1;
    config.fence.corners_m = square(HALF_M);
    config.fence.margin_m = Some(0.2);
    config.fence.braking_m_s2 = BRAKING_M_S2;
    config
}

#[test]
fn the_speed_that_the_braking_allows_is_the_highest_that_is_accepted() {
    for braking in [1.0, 2.5, 8.5] {
        let mut config = own();
        config.board.max_pose_age_ms = 1_000;
        config.board.speed.max_forward_mm_s = 15_000;
        config.motion_capture.pose.max_speed_m_s = 15.0;
        config.control.stop_deceleration_m_s2 = braking;
        let fastest = config.fastest_stopped_m_s();
        config.limits.max_speed_m_s = fastest;
        assert!(config.validate().is_ok(), "{braking}: {fastest}");
        config.limits.max_speed_m_s = fastest + 0.01;
        let Err(error) = config.validate() else {
            panic!("{braking}: {fastest}");
        };
        let error = error.to_string();
        assert!(error.contains("board.max_pose_age_ms"), "{error}");
        let allowed = format!("allows {fastest:.2} m/s");
        assert!(error.contains(&allowed), "{error}");
    }
}

pub(crate) fn square(half: f64) -> Vec<[f64; 2]> {
    vec![[-half, -half], [half, -half], [half, half], [-half, half]]
}

pub(crate) fn circle(radius_m: f64, angular_velocity_rad_s: f64) -> ReferenceSection {
    ReferenceSection::Circle {
        radius_m,
        angular_velocity_rad_s,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    }
}

pub(crate) fn found(config: &Config) -> Judgement {
    judge(config, None).unwrap()
}

/// The only finding.
pub(crate) fn only(judgement: &Judgement) -> &Finding {
    match &judgement.findings[..] {
        [finding] => finding,
        findings => panic!("{findings:?}"),
    }
}

/// From the geometry: the rear axle, the front axle and P turn about one centre.
fn least_radius(config: &Config) -> f64 {
    let wheelbase = config.vehicle.front_axle_distance_m + config.vehicle.rear_axle_distance_m;
    let rear = wheelbase / config.limits.max_steering_rad.tan();
    (rear.powi(2) + wheelbase.powi(2) + config.law.point_distance_m.powi(2)).sqrt()
}

/// Drives the simulated car from `stand` for `seconds`; the modes after arming, and the share
/// of the time with the steering at its limit.
fn driven(config: &Config, stand: Stand, seconds: u64) -> (Vec<Mode>, f64) {
    let mut simulation = SimulationConfig::default();
    simulation.car.start = StartPose {
        x_m: stand.x_m,
        y_m: stand.y_m,
        yaw_rad: stand.yaw_rad,
    };
    let mut drive = SimulatedDrive::with(config.clone(), simulation);
    let (mut modes, mut ticks, mut limited) = (Vec::new(), 0.0, 0.0);
    for index in 1..=100 * (seconds + 4) {
        drive.run_until_tick(index);
        drive.tick(index);
        let output = drive.output().unwrap();
        let mode = output.mode;
        if mode == Mode::Driving || !modes.is_empty() {
            if modes.last() != Some(&mode) {
                println!(
                    "{mode:?} {:?} at {index} {:?}",
                    output.reason,
                    output.estimate.map(|e| (e.position, e.yaw, e.speed))
                );
                modes.push(mode);
            }
            ticks += 1.0;
            limited += f64::from(
                output.actuation.steering.abs() >= 0.999 * config.limits.max_steering_rad,
            );
        }
    }
    assert!(ticks > 90.0 * seconds as f64, "driven for {ticks} ticks");
    (modes, limited / ticks)
}

#[test]
fn the_simulated_car_drives_the_example_from_the_place_that_is_named() {
    let mut config = Config::from_toml(EXAMPLE).unwrap();
    config.fence.braking_m_s2 = BRAKING_M_S2;
    let judgement = found(&config);
    assert!(judgement.is_possible(), "{judgement:?}");
    let (modes, limited) = driven(&config, judgement.start.unwrap(), 30);
    assert_eq!(modes, [Mode::Driving]);
    // What is not yet a warning.
    assert!(limited < 0.1, "{limited}");
}

/// `singletrack-sim` without options, and the daemon with the example.
#[test]
fn the_simulator_starts_the_car_where_the_example_can_drive() {
    let simulator = Arguments::parse_from(["singletrack-sim"]).config().unwrap();
    let start = simulator.simulation.car.start;
    let stand = Stand {
        x_m: start.x_m,
        y_m: start.y_m,
        yaw_rad: start.yaw_rad,
    };
    let mut config = Config::from_toml(EXAMPLE).unwrap();
    assert!(judge(&config, Some(stand)).unwrap().is_possible());
    config.fence.braking_m_s2 = BRAKING_M_S2;
    let (modes, _) = driven(&config, stand, 30);
    assert_eq!(modes, [Mode::Driving]);
}

/// There the geofence relies on less braking, and the steering follows a wave.
#[test]
fn what_may_begin_is_not_stopped_at_the_fence_in_its_first_metre() {
    let mut config = own();
    config.fence.corners_m = square(1.28);
    let stand = Stand {
        x_m: 0.0,
        y_m: 0.0,
        yaw_rad: 0.0,
    };
    let mut allowed = [0; 2];
    for shift in 0..8 {
        config.reference = ReferenceSection::Circle {
            radius_m: 0.9,
            angular_velocity_rad_s: 0.5,
            centre_m: [0.05 * f64::from(shift), 0.0],
            start: Start::Nearest,
        };
        let [unproved, proved] = [true, false].map(|prove| {
            let mut config = config.clone();
            config.supervisor.prove_first_metre = prove;
            let judgement = judge_reference(&config, Some(stand), Some(8.0)).unwrap();
            judgement.is_possible()
        });
        allowed[0] += u32::from(unproved);
        allowed[1] += u32::from(proved);
        let mut simulation = SimulationConfig::default();
        simulation.car.start = StartPose::default();
        let mut drive = SimulatedDrive::with(config.clone(), simulation);
        let ends = (1..1_000).find_map(|index| {
            drive.run_until_tick(index);
            drive.tick(index);
            let output = drive.output()?;
            (output.proved || output.mode == Mode::Stopping).then_some(output.proved)
        });
        assert!(!unproved || ends == Some(true), "{shift}: {ends:?}");
    }
    assert!(0 < allowed[0] && allowed[0] < allowed[1], "{allowed:?}");
}

#[test]
fn a_car_that_stands_elsewhere_is_told_a_place_near_it_from_which_it_can_drive() {
    let mut config = own();
    config.reference = circle(0.85, 0.5);
    if let ReferenceSection::Circle { start, .. } = &mut config.reference {
        *start = Start::Nearest;
    }
    // Across the circle, at its far side.
    let here = Stand {
        x_m: -0.5,
        y_m: 0.0,
        yaw_rad: PI,
    };
    let judgement = judge_reference(&config, Some(here), None).unwrap();
    let place = judgement.start.unwrap();
    let finding = only(&judgement).to_string();
    let carry = format!(
        "Carry it to ({:.2}, {:.2}) m, {:.0} degrees",
        place.x_m,
        place.y_m,
        place.yaw_rad.to_degrees()
    );
    assert!(
        finding.starts_with(
            "reference.start is nearest: from here (centre of mass at (-0.50, 0.00) m"
        ) && finding.ends_with(&carry),
        "{finding}"
    );
    assert!(
        (place.x_m - here.x_m).hypot(place.y_m - here.y_m) < 0.7,
        "{finding}"
    );
    assert!(
        judge_reference(&config, Some(place), None)
            .unwrap()
            .is_possible()
    );
}

#[test]
fn a_circle_below_the_least_radius_of_p_is_impossible_and_one_above_is_not() {
    let mut config = own();
    let least = least_radius(&config);
    assert!((least - 0.69).abs() < 0.005, "{least}");
    // Without feed-forward P settles on a smaller circle: k over hypot(k, w).
    let factor = 1.0 / 1.0_f64.hypot(0.5);
    for (radius, possible) in [
        (0.6, false),
        (0.99 * least / factor, false),
        (1.01 * least / factor, true),
    ] {
        config.reference = circle(radius, 0.5);
        let judgement = found(&config);
        assert_eq!(judgement.is_possible(), possible, "{radius}: {judgement:?}");
        let finding = only(&judgement).to_string();
        assert!(finding.starts_with("reference.radius_m is"), "{finding}");
        if !possible {
            for part in ["0.69 m", "at least 0.78", "law.point_distance_m"] {
                assert!(finding.contains(part), "{finding}");
            }
        }
    }
}

#[test]
fn the_simulated_car_has_its_wheels_at_the_limit_on_a_circle_that_is_called_impossible() {
    let mut config = own();
    config.board = Config::from_toml(EXAMPLE).unwrap().board;
    config.fence.corners_m = square(3.0);
    config.reference = circle(0.6, 0.5);
    let start = Stand {
        x_m: 0.42,
        y_m: -0.45,
        yaw_rad: 1.2,
    };
    let (_, limited) = driven(&config, start, 20);
    assert!(limited > 0.8, "{limited}");
}

#[test]
fn a_circle_that_takes_all_of_the_steering_is_a_warning() {
    let mut config = own();
    config.reference = circle(0.78, 0.5);
    let judgement = found(&config);
    let finding = only(&judgement);
    assert_eq!(finding.severity, Severity::Warning);
    assert!(finding.what.fix.contains("corrections"), "{finding}");
    assert!(judgement.start.is_some());
}

#[test]
fn what_is_too_fast_for_the_limits_is_impossible() {
    for (limits, key, part) in [
        (
            LimitsSection {
                max_speed_m_s: 0.3,
                creep_speed_m_s: 0.2,
                ..LimitsSection::default()
            },
            "reference.angular_velocity_rad_s",
            "limits.max_speed_m_s is 0.3",
        ),
        (
            LimitsSection {
                max_lateral_acceleration_m_s2: 0.1,
                ..LimitsSection::default()
            },
            "reference.angular_velocity_rad_s",
            "limits.max_lateral_acceleration_m_s2 is 0.1",
        ),
    ] {
        let config = Config { limits, ..own() };
        let judgement = found(&config);
        let finding = only(&judgement);
        assert_eq!(
            (finding.severity, finding.what.key),
            (Severity::Impossible, key)
        );
        assert!(finding.what.fix.contains(part), "{finding}");
    }
}

#[test]
fn a_fence_that_the_car_cannot_stay_inside_is_impossible_and_a_larger_one_is_not() {
    let mut config = own();
    assert_eq!(found(&config).findings, []);
    // The centre of mass turns on at least 0.55 m; with the margin there is less.
    config.fence.corners_m = square(0.7);
    let judgement = found(&config);
    let finding = only(&judgement);
    assert_eq!(finding.what.key, "fence.corners_m");
    assert_eq!(finding.severity, Severity::Impossible);
    assert!(
        finding.what.fix.contains("fence.margin_m = 0.2"),
        "{finding}"
    );
    assert_eq!(judgement.start, None);
}

#[test]
fn a_circle_that_the_fence_has_no_room_for_names_the_radius_and_the_largest_one() {
    let mut config = own();
    config.reference = circle(1.2, 0.3);
    let judgement = found(&config);
    let finding = only(&judgement);
    assert_eq!(
        (finding.what.key, &*finding.what.value),
        ("reference.radius_m", "1.2")
    );
    let (_, rest) = finding.what.fix.split_once("give ").unwrap();
    let largest: f64 = rest.split(' ').next().unwrap().parse().unwrap();
    config.reference = circle(largest + 0.02, 0.3);
    assert_eq!(only(&found(&config)).what.key, "reference.radius_m");
    // From there on it is the way to the circle that takes room.
    config.reference = circle(largest - 0.02, 0.3);
    assert!(
        found(&config)
            .findings
            .iter()
            .all(|finding| finding.what.key != "reference.radius_m")
    );
}

#[test]
fn a_car_of_which_the_axles_are_known_is_the_papers_at_that_scale_with_a_warning() {
    let with = |keys: &str| {
        let axles = "front_axle_distance_m = 0.16\nrear_axle_distance_m = 0.16\n";
        let config = format!("{EXAMPLE}\n[vehicle]\n{axles}{keys}");
        let config = Config::from_toml(&config).unwrap();
        let warned = found(&config).findings.into_iter();
        let warned = warned.filter(|finding| finding.what.key.starts_with("vehicle"));
        (
            config,
            warned
                .map(|finding| finding.to_string())
                .collect::<Vec<_>>(),
        )
    };
    let (config, warned) = with("");
    assert!((config.vehicle.mass_kg - 1.9 * (0.32_f64 / 0.26).powi(3)).abs() < 1e-9);
    assert_eq!(config.vehicle.friction, 0.25);
    assert!(
        warned.len() == 1 && warned[0].starts_with("vehicle.mass_kg is 3.54: left out"),
        "{warned:?}"
    );
    // What is written is what a record has.
    let again = Config::from_toml(&config.to_toml().unwrap()).unwrap();
    assert_eq!(again.vehicle, config.vehicle);
    let (config, warned) = with("mass_kg = 3.0");
    assert_eq!((config.vehicle.mass_kg, warned), (3.0, vec![]));
}

#[test]
fn a_car_that_has_to_turn_round_first_is_told_so_from_where_it_stands() {
    let config = own();
    let good = found(&config).start.unwrap();
    assert_eq!(judge(&config, Some(good)).unwrap().start, Some(good));
    let turned = Stand {
        yaw_rad: good.yaw_rad + 3.0,
        ..good
    };
    for stand in [turned, Stand { x_m: 1.5, ..good }] {
        let judgement = judge(&config, Some(stand)).unwrap();
        assert!(!judgement.is_possible());
        let finding = only(&judgement).to_string();
        assert!(finding.contains("from here (centre of mass"), "{finding}");
    }
}

#[test]
fn a_figure_that_bends_too_much_is_told_by_the_share_of_the_drive() {
    let mut config = own();
    config.fence.corners_m = square(3.0);
    let eight = |half_length_m, half_width_m, rate| ReferenceSection::FigureOfEight {
        half_length_m,
        half_width_m,
        angular_velocity_rad_s: rate,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    };
    config.reference = eight(0.4, 0.2, 0.4);
    let judgement = found(&config);
    let finding = only(&judgement).to_string();
    assert!(!judgement.is_possible());
    assert!(finding.starts_with("limits.max_steering_rad is 0.45") && finding.contains('%'));
    config.fence.corners_m = square(4.0);
    config.reference = eight(3.0, 1.5, 0.25);
    assert_eq!(found(&config).findings, []);
}

/// An oval through points, of this length and width, in m.
fn oval(length: f64, width: f64, speed_m_s: f64) -> ReferenceSection {
    let points = (0..16).map(|index| {
        let angle = core::f64::consts::TAU * f64::from(index) / 16.0;
        [0.5 * length * angle.cos(), 0.5 * width * angle.sin()]
    });
    ReferenceSection::Path {
        points: PathPoints::Points(points.collect()),
        closed: true,
        speed_m_s,
        lateral_acceleration_m_s2: 1.0,
        acceleration_m_s2: 0.5,
        start: Start::Beginning,
    }
}

#[test]
fn a_path_is_judged_by_its_bends_and_by_the_fence() {
    let mut config = own();
    config.outer_loop =
        toml::from_str("kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\nfeed_forward = true")
            .unwrap();
    config.fence.corners_m = square(1.5);
    config.reference = oval(2.2, 1.8, 0.5);
    let judgement = found(&config);
    assert_eq!(judgement.findings, []);
    let (modes, limited) = driven(&config, judgement.start.unwrap(), 20);
    assert_eq!(modes, [Mode::Driving]);
    assert!(limited < 0.05, "{limited}");

    config.reference = oval(0.8, 0.6, 0.3);
    let judgement = found(&config);
    assert!(!judgement.is_possible());
    let finding = only(&judgement).to_string();
    assert!(
        finding.starts_with("limits.max_steering_rad is 0.45"),
        "{finding}"
    );

    config.reference = oval(2.2, 1.8, 0.5);
    config.fence.corners_m = square(1.0);
    let judgement = found(&config);
    assert_eq!(only(&judgement).what.key, "fence.corners_m");
    assert!(!judgement.is_possible());
}

#[test]
fn a_reference_from_outside_is_not_judged() {
    let mut config = own();
    config.reference = ReferenceSection::External {
        setpoint_timeout_ms: 200,
    };
    assert_eq!(found(&config), Judgement::default());
}

/// Straight on along x with 0.5 m/s.
fn straight(seconds: f64) -> Config {
    let text = EXAMPLE.replacen("\nkind = \"proportional\"\n", "\nkind = \"open-loop\"\n", 1);
    let step = singletrack_core::config::StepSection {
        duration_s: seconds,
        v_x_m_s: 0.5,
        v_y_m_s: 0.0,
    };
    Config {
        outer_loop: Config::from_toml(&text).unwrap().outer_loop,
        reference: ReferenceSection::VelocitySteps { steps: vec![step] },
        ..own()
    }
}

#[test]
fn velocity_steps_are_driven_from_anywhere_inside_the_fence() {
    assert!(found(&straight(1.0)).start.is_some());
    assert_eq!(only(&found(&straight(10.0))).what.key, "fence.corners_m");
}

#[test]
fn a_drive_that_leaves_the_fence_later_is_possible_for_a_shorter_time() {
    // 0.8 m to the margin at x = 0.8 m, at 0.5 m/s.
    let stand = Some(Stand {
        x_m: 0.0,
        y_m: 0.0,
        yaw_rad: 0.0,
    });
    let config = straight(10.0);
    let judged = |longest_s| judge_reference(&config, stand, longest_s).unwrap();
    assert_eq!(judged(Some(1.0)).findings, []);
    for longest_s in [Some(2.0), Some(100.0), None] {
        let finding = only(&judged(longest_s)).to_string();
        assert!(finding.ends_with("for a shorter time"), "{finding}");
    }
}

#[test]
fn the_judgement_of_the_reference_alone_knows_no_examples() {
    let config = Config::from_toml(EXAMPLE).unwrap();
    assert_eq!(judge_reference(&config, None, None).unwrap().findings, []);
}

#[test]
fn what_was_left_as_in_the_example_is_a_warning() {
    let judgement = found(&Config::from_toml(EXAMPLE).unwrap());
    let keys: Vec<_> = judgement
        .findings
        .iter()
        .map(|finding| finding.what.key)
        .collect();
    assert_eq!(
        keys,
        [
            "motion_capture.server",
            "vehicle",
            "fence.braking_m_s2",
            "board.servo",
            "board.esc",
            "board.speed"
        ]
    );
    assert!(judgement.is_possible());
    // The sections that are compared have values without a default.
    for key in ["board.servo", "board.esc", "board.speed"] {
        let section = SECTIONS.iter().find(|section| section.name == key).unwrap();
        assert!(section.keys.iter().any(|key| (key.example)().is_some()));
    }
}

#[test]
fn values_that_no_sane_car_has_are_named() {
    assert_eq!(found(&own()).findings, []);
    type Change = fn(&mut Config);
    let cases: [(&str, Change); 11] = [
        ("fence.braking_m_s2 is 50", |config| {
            config.fence.braking_m_s2 = 50.0;
        }),
        ("fence.corners_m is 3000 m by 3000 m", |config| {
            config.fence.corners_m = square(1_500.0);
        }),
        ("limits.max_speed_m_s is 20", |config| {
            config.limits.max_speed_m_s = 20.0;
        }),
        ("control.stop_deceleration_m_s2 is 9", |config| {
            config.control.stop_deceleration_m_s2 = 9.0;
            config.vehicle.friction = 0.25;
        }),
        ("law.point_distance_m is 0", |config| {
            config.law.point_distance_m = 1e-300;
        }),
        ("outer_loop.gain_per_s is [1000.0, 1.0]", |config| {
            config.outer_loop = OuterLoopSection::Proportional {
                gain_per_s: [1_000.0, 1.0],
                feed_forward: false,
            };
        }),
        ("motion_capture.timing.stamp_offset_ms is 200", |config| {
            config.motion_capture.timing.stamp_offset_ms = 200.0;
        }),
        ("motion_capture.pose is jump_margin_m = 1", |config| {
            config.motion_capture.pose.jump_margin_m = 1.0;
        }),
        (
            "motion_capture.pose is max_consecutive_rejects = 1000",
            |config| config.motion_capture.pose.max_consecutive_rejects = 1_000,
        ),
        ("watch is max_innovation = 1000000", |config| {
            config.watch.max_innovation = 1e6;
        }),
        ("watch is speed_margin_m_s = 2", |config| {
            config.watch.speed_margin_m_s = 2.0;
        }),
    ];
    for (expected, change) in cases {
        let mut config = own();
        // What it is to be wrong with is the value alone.
        config.vehicle.friction = 1.0;
        change(&mut config);
        let warnings = judge_unusual(&config);
        assert!(
            warnings.iter().any(|warning| warning.starts_with(expected)),
            "{expected}: {warnings:?}"
        );
    }
}

/// The warnings, whether or not the rest of the configuration fits.
fn judge_unusual(config: &Config) -> Vec<String> {
    let mut findings = Vec::new();
    singletrack_core::feasibility::warn_of_unusual(config, &mut findings);
    findings.iter().map(ToString::to_string).collect()
}
