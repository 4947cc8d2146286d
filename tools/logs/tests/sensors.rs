//! Samples: held values, delays, interpolation, units, the pose on the body, and the steering command as an
//! angle.

use std::f64::consts::{FRAC_PI_2, PI};

use singletrack_control::InertialSample;
use singletrack_mocap::PoseState;

use crate::bench::{MAP, imported, rounded, since_ms};

/// [`MAP`] with other lines for its section of the motor.
fn with_motor(lines: &str) -> String {
    MAP.replace("speed = \"v\"\n", &format!("speed = \"v\"\n{lines}\n"))
}

/// [`MAP`] with further lines for its section of the pose.
fn with_pose(lines: &str) -> String {
    MAP.replace("yaw = \"yaw\"\n", &format!("yaw = \"yaw\"\n{lines}\n"))
}

const IMU: &str = "\
[imu]
forward_acceleration = \"ax\"
left_acceleration = \"ay\"
yaw_rate = \"w\"
";

/// A sensor that is read every other row, beside a counter of its samples.
const HELD_LOG: &str = "\
t,x,y,yaw,v,s,n
0.00,0,0,0,9,0,7
0.01,0,0,0,9,0,7
0.02,0,0,0,1,0,8
0.03,0,0,0,1,0,8
0.04,0,0,0,1,0,9
0.05,0,0,0,3,0,10
";

#[test]
fn a_row_that_repeats_a_value_is_no_sample_and_neither_is_the_first_one() {
    let map = with_motor("new_when_changes = \"n\"");
    assert_eq!(
        imported(HELD_LOG, &map).motor_speeds(),
        [(20.0, 1.0), (40.0, 1.0), (50.0, 3.0)]
    );
}

#[test]
fn without_a_column_that_changes_every_row_is_a_sample() {
    let samples = imported(HELD_LOG, MAP).motor_speeds();
    assert_eq!(samples.len(), 6);
    assert_eq!(samples[0], (0.0, 9.0));
}

#[test]
fn a_sample_comes_when_it_was_measured() {
    let map = with_motor("new_when_changes = \"n\"\ndelay_s = 0.015");
    let imported = imported(HELD_LOG, &map);
    assert_eq!(
        imported.motor_speeds(),
        [(5.0, 1.0), (25.0, 1.0), (35.0, 3.0)]
    );
    // In the first tick that is not before it.
    let counts: Vec<_> = imported
        .ticks()
        .iter()
        .map(|tick| tick.events.len())
        .collect();
    // The link, and a pose each; then the board.
    assert_eq!(counts, [2, 2, 1, 2, 2, 1]);
}

#[test]
fn a_delayed_pose_arrives_with_its_row_and_was_captured_before() {
    let imported = imported(HELD_LOG, &with_pose("delay_s = 0.025"));
    let times: Vec<_> = imported
        .poses()
        .iter()
        .map(|pose| (since_ms(pose.capture.0), since_ms(pose.receive.0)))
        .collect();
    assert_eq!(times[0], (-25.0, 0.0));
    assert_eq!(times[5], (25.0, 50.0));
}

#[test]
fn held_poses_are_no_samples() {
    let imported = imported(HELD_LOG, &with_pose("new_when_changes = \"n\""));
    let frames: Vec<_> = imported
        .poses()
        .iter()
        .map(|pose| (pose.frame, since_ms(pose.receive.0)))
        .collect();
    assert_eq!(frames, [(0, 20.0), (1, 40.0), (2, 50.0)]);
}

#[test]
fn the_motor_is_interpolated_on_a_grid_except_in_long_gaps() {
    let log = "\
t,x,y,yaw,v,s
0.005,0,0,0,1,0
0.025,0,0,0,3,0
0.065,0,0,0,9,0
0.075,0,0,0,5,0
";
    let map = with_motor("interpolate_hz = 100\nlongest_gap_s = 0.03");
    // The first row is a point of the grid.
    assert_eq!(
        imported(log, &map).motor_speeds(),
        [
            (0.0, 1.0),
            (10.0, 2.0),
            (20.0, 3.0),
            (60.0, 9.0),
            (70.0, 5.0)
        ]
    );
    let map = with_motor("interpolate_hz = 100");
    let speeds = imported(log, &map).motor_speeds();
    assert_eq!(speeds.len(), 8);
    assert_eq!(speeds[4], (40.0, 6.0));
}

const IMU_LOG: &str = "\
t,x,y,yaw,v,s,ax,ay,w
0.00,0,0,0,1,0,1,10,100
0.02,0,0,0,3,0,3,30,300
0.04,0,0,0,5,0,5,50,500
";

#[test]
fn each_inertial_sample_makes_a_board_sample_with_the_speed_of_the_motor_in_force() {
    let imported = imported(IMU_LOG, &format!("{MAP}{IMU}delay_s = 0.01\n"));
    // That of -10 ms is before the first speed.
    assert_eq!(imported.motor_speeds(), [(10.0, 1.0), (30.0, 3.0)]);
    assert_eq!(imported.summary.without_motor_speed, 1);
    let last = imported.inertial()[1];
    let values = [
        last.forward_acceleration,
        last.left_acceleration,
        last.yaw_rate,
    ];
    assert_eq!(values, [5.0, 50.0, 500.0]);
    assert_eq!(since_ms(last.time.0), 30.0);
}

#[test]
fn the_motor_is_interpolated_at_the_times_of_the_inertial_samples() {
    let map = format!("{}{IMU}delay_s = 0.01\n", with_motor("interpolate_hz = 5"));
    assert_eq!(
        imported(IMU_LOG, &map).motor_speeds(),
        [(10.0, 2.0), (30.0, 4.0)]
    );
}

#[test]
fn the_imu_is_interpolated_in_all_its_axes() {
    let map = format!("{MAP}{IMU}interpolate_hz = 100\n");
    let imported = imported(IMU_LOG, &map);
    let values: Vec<_> = imported
        .inertial()
        .iter()
        .map(|sample| {
            [
                sample.forward_acceleration,
                sample.left_acceleration,
                sample.yaw_rate,
            ]
            .map(rounded)
        })
        .collect();
    let ramp = [1.0, 2.0, 3.0, 4.0, 5.0].map(|value| [value, value * 10.0, value * 100.0]);
    assert_eq!(values, ramp);
}

#[test]
fn a_row_whose_cells_of_a_sensor_are_empty_is_no_sample_of_it() {
    let log = "\
t,x,y,yaw,v,s,ax,ay,w
0.00,,,,1,0,,,
0.01,,,,,,4,5,6
0.02,7,8,0,,,,,
";
    let map = format!("{}{IMU}", with_pose("empty_rows = \"no-sample\""));
    let imported = imported(log, &map);
    assert_eq!(imported.motor_speeds(), [(10.0, 1.0)]);
    assert_eq!(imported.observations().len(), 1);
    assert_eq!(imported.summary.motor.count, 1);
    assert_eq!(imported.steering()[2], (20.0, 0.0));
}

#[test]
fn an_empty_pose_is_one_that_is_not_finite_unless_the_map_says_otherwise() {
    let log = "t,x,y,yaw,v,s\n0,,,,1,0\n0.01,1,,0,1,0\n0.02,1,inf,0,1,0\n0.03,1,2,0,1,0\n";
    let imported = imported(log, MAP);
    assert_eq!(imported.summary.rejected, 3);
    assert_eq!(imported.summary.poses.count, 1);
    assert_eq!(imported.poses()[0].frame, 3);
}

#[test]
fn units_scales_signs_and_offsets_give_si_units() {
    let log = "t,x,y,yaw,v,s,ax,ay,w\n0,1500,-2,90,3.6,0,1,2,180\n";
    let map = r#"
[time]
column = "t"
unit = "us"
unix = false
[pose]
x = { column = "x", unit = "mm", offset = 0.25 }
y = { column = "y", scale = -0.5 }
yaw = { column = "yaw", unit = "deg" }
[imu]
forward_acceleration = { column = "ax", unit = "g" }
left_acceleration = { column = "ay", unit = "mm/s2", scale = -1000, offset = 1 }
yaw_rate = { column = "w", unit = "deg/s", scale = -1 }
[motor]
speed = { column = "v", unit = "km/h" }
[steering]
column = "s"
radians_per_unit = 1
"#;
    let imported = imported(log, map);
    let pose = imported.poses()[0];
    assert_eq!((pose.position.x, pose.position.y), (1.75, 1.0));
    assert_eq!(rounded(pose.yaw), rounded(FRAC_PI_2));
    let sample = imported.inertial()[0];
    assert_eq!(sample.forward_acceleration, 9.80665);
    assert_eq!(sample.left_acceleration, -1.0);
    assert_eq!(rounded(sample.yaw_rate), rounded(-PI));
    assert_eq!(imported.motor_speeds(), [(0.0, 1.0)]);
}

#[test]
fn the_point_and_the_yaw_of_the_body_are_removed() {
    // The car points along y; the cameras see a point 0.3 m before and 0.1 m left of that of the
    // record, and a yaw that is 0.2 rad too large.
    let log = format!("t,x,y,yaw,v,s\n0,4.9,2.3,{},1,0\n", FRAC_PI_2 + 0.2);
    let imported = imported(&log, &with_pose("point_m = [0.3, 0.1]\nyaw_rad = 0.2"));
    let pose = imported.poses()[0];
    assert_eq!(rounded(pose.position.x), 5.0);
    assert_eq!(rounded(pose.position.y), 2.0);
    assert_eq!(rounded(pose.yaw), rounded(FRAC_PI_2));
}

#[test]
fn the_yaw_is_wrapped() {
    let log = format!(
        "t,x,y,yaw,v,s\n0,0,0,{},1,0\n0.01,0,0,-9,1,0\n",
        3.0 * PI + 0.5
    );
    let imported = imported(&log, MAP);
    let yaw: Vec<_> = imported
        .observations()
        .iter()
        .map(|observation| match observation.state {
            PoseState::Valid(pose) => rounded(pose.yaw_rad),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(yaw, [rounded(0.5 - PI), rounded(2.0 * PI - 9.0)]);
}

#[test]
fn driving_is_a_number_or_a_word_and_lasts_until_it_changes() {
    let log = "t,x,y,yaw,v,s,on\n0,0,0,0,1,0,\n0.01,0,0,0,1,0,True\n0.02,0,0,0,1,0,\n0.03,0,0,0,1,0,0.0\n";
    let map = format!("{MAP}[driving]\ncolumn = \"on\"\n");
    let imported = imported(log, &map);
    let modes: Vec<_> = imported
        .ticks()
        .iter()
        .map(|tick| tick.output.mode.name())
        .collect();
    assert_eq!(modes, ["ready", "driving", "driving", "ready"]);
}

#[test]
fn other_delimiters_spaces_quotes_and_a_byte_order_mark_are_read() {
    let log = "\u{feff}t;\"x, m\"; y ;yaw;v;s\r\n0; 1.5 ;\"2\";0;1;0\r\n\r\n0.01;1;2;0;1;0\r\n";
    let map = MAP.replace("x = \"x\"", "x = \"x, m\"");
    let imported = imported(log, &format!("delimiter = \";\"\n{map}"));
    assert_eq!(imported.poses()[0].position.x, 1.5);
    assert_eq!(imported.poses().len(), 2);
}

const STEERING_LOG: &str = "\
t,x,y,yaw,v,s
0.00,0,0,0,1,-2
0.01,0,0,0,1,-0.5
0.02,0,0,0,1,0
0.03,0,0,0,1,0.25
0.04,0,0,0,1,1
0.05,0,0,0,1,2
";

fn angles(steering: &str) -> Vec<f64> {
    let map = MAP.replace("radians_per_unit = 0.5\n", steering);
    let steering = imported(STEERING_LOG, &map).steering();
    steering.iter().map(|(_, angle)| *angle).collect()
}

#[test]
fn a_linear_map_has_a_gain_and_an_offset() {
    assert_eq!(
        angles("radians_per_unit = -0.4\noffset_rad = 0.1\n"),
        [0.9, 0.3, 0.1, 0.0, -0.3, -0.7]
    );
}

#[test]
fn a_table_is_linear_between_its_pairs_and_constant_beyond() {
    assert_eq!(
        angles("table = [[-1.0, -0.4], [0.0, 0.1], [0.5, 0.2], [1.0, 0.2]]\n"),
        [-0.4, -0.15, 0.1, 0.15, 0.2, 0.2]
    );
}

#[test]
fn a_command_is_in_force_from_its_time_until_the_next_one() {
    assert_eq!(
        angles("radians_per_unit = 1.0\ndelay_s = 0.015\n"),
        [-0.5, 0.0, 0.25, 1.0, 2.0, 2.0]
    );
}

#[test]
fn an_empty_command_is_that_of_the_row_before() {
    let log = "t,x,y,yaw,v,s\n0,0,0,0,1,\n0.01,0,0,0,1,1\n0.02,0,0,0,1,\n";
    assert_eq!(
        imported(log, MAP).steering(),
        [(0.0, 0.0), (10.0, 0.5), (20.0, 0.5)]
    );
}

#[test]
fn a_gyro_alone_has_no_accelerations() {
    let log = "t,x,y,yaw,v,s,w\n0,0,0,0,1,0,0.1\n0.01,0,0,0,1,0,0.2\n";
    let imported = imported(log, &format!("{MAP}[imu]\nyaw_rate = \"w\"\n"));
    let inertial = imported.inertial();
    let rates: Vec<f64> = inertial.iter().map(|sample| sample.yaw_rate).collect();
    assert_eq!(rates, [0.1, 0.2]);
    let are_nan = |sample: &InertialSample| {
        sample.forward_acceleration.is_nan() && sample.left_acceleration.is_nan()
    };
    assert!(inertial.iter().all(are_nan));
}
