//! Bags in the layouts of `f1tenth_system`, `vicon_bridge`, `mocap4ros2` and `natnet_ros2`: what goes
//! in comes out.

use std::{f64::consts::TAU, fs};

use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng as _, SeedableRng as _},
};
use singletrack_mocap::{PoseState, RejectReason};
use singletrack_pilot::{BoardState, Mode};

use super::build::{
    Bag, Folder, STORAGES, Storage, at, encoded_big, header, imported, quaternion, stamp,
};
use crate::{
    bench::{Imported, since_ms},
    in_repository,
};

const TOPICS: [(&str, &str); 6] = [
    ("/vicon/car/car", "geometry_msgs/msg/TransformStamped"),
    ("/sensors/core", "vesc_msgs/msg/VescStateStamped"),
    ("/sensors/imu/raw", "sensor_msgs/msg/Imu"),
    ("/sensors/servo_position_command", "std_msgs/msg/Float64"),
    ("/commands/motor/speed", "std_msgs/msg/Float64"),
    ("/joy", "sensor_msgs/msg/Joy"),
];

/// A car at a moment, as its sensors see it.
#[derive(Clone, Copy, Debug, Default)]
struct Moment {
    pose: [f64; 3],
    /// Forward, left, and about the vertical.
    inertial: [f64; 3],
    speed: f64,
    steering: f64,
    speed_command: f64,
    driven: bool,
}

fn f1tenth_map() -> String {
    fs::read_to_string(in_repository("tools/real/f1tenth-vicon.toml")).unwrap()
}

/// The definitions of a bag: those that the importer brings, in the order of a bag's text.
fn with_definitions(mut bag: Bag) -> Bag {
    let built_in = include_str!("../../src/import/bag/definitions.msg");
    for (_, kind) in &bag.topics {
        let name = kind.replace("/msg/", "/");
        let parts: Vec<_> = built_in.split("================\n").collect();
        let (own, others): (Vec<&str>, Vec<&str>) = parts
            .iter()
            .partition(|part| part.starts_with(&format!("MSG: {name}\n")));
        let root = own[0].split_once('\n').unwrap().1;
        let line = format!("{}\n", "=".repeat(80));
        let text = format!("# a comment\n{root}{line}{}", others.join(&line));
        bag.definitions.insert(kind, text);
    }
    bag
}

/// Half a second in which every value changes.
fn moment(time_s: f64) -> Moment {
    Moment {
        pose: [1.0 + time_s, -2.0 + 3.0 * time_s, 3.0 + time_s],
        inertial: [0.5 + time_s, -0.25 - time_s, 1.5 * time_s],
        speed: 1.0 + 2.0 * time_s,
        steering: 0.3 - time_s,
        speed_command: 2.0 - time_s,
        driven: time_s >= 0.2,
    }
}

/// The messages of an f1tenth car: the cameras at 100 Hz, all else at 50 Hz.
fn f1tenth_bag(duration_ms: u32, moment: impl Fn(f64) -> Moment) -> Bag {
    let mut bag = Bag::new(&TOPICS);
    for ms in (0..duration_ms).step_by(10) {
        let time_s = f64::from(ms) * 1e-3;
        let time = at(time_s);
        let now = moment(time_s);
        let [x, y, yaw] = now.pose;
        let transform = (header(time), "car", [x, y, 0.1], quaternion(yaw));
        bag.send("/vicon/car/car", time_s, &transform);
        if ms % 20 != 0 {
            continue;
        }
        let [forward, left, rate] = now.inertial;
        let imu = (
            header(time),
            [0.0, 0.0, 0.0, 1.0],
            [0.0; 9],
            [0.0, 0.0, rate.to_degrees()],
            [0.0; 9],
            [forward / 9.80665, left / 9.80665, 1.0],
            [0.0; 9],
        );
        bag.send("/sensors/imu/raw", time_s, &imu);
        let after_speed = ([12.0, 0.0, 0.0, 0.0, 0.0], [7, 8, 0], 0.5, 3, [0.0; 5]);
        let state = (header(time), [0.0; 7], now.speed * 4614.0, after_speed);
        bag.send("/sensors/core", time_s, &state);
        // Sent two milliseconds before, to be received at the time.
        let servo = 0.5304 - 1.2135 * now.steering;
        bag.send("/sensors/servo_position_command", time_s - 0.002, &servo);
        let command = now.speed_command * 4614.0;
        bag.send("/commands/motor/speed", time_s - 0.002, &command);
        let buttons = vec![0, 0, 0, 0, 0, i32::from(now.driven)];
        bag.send("/joy", time_s, &(header(time), vec![0.5_f32; 3], buttons));
    }
    bag
}

#[track_caller]
fn assert_near(values: &[f64], expected: &[f64]) {
    let near = |(one, other): (&f64, &f64)| (one - other).abs() < 1e-9;
    assert!(
        values.len() == expected.len() && values.iter().zip(expected).all(near),
        "{values:?} {expected:?}"
    );
}

/// Compares an import with what the sensors saw.
fn assert_moments(imported: &Imported, moment: impl Fn(f64) -> Moment) {
    let poses = imported.poses();
    assert_eq!(poses.len(), 50);
    for (pose, ms) in poses.iter().zip((0..).step_by(10)) {
        let time_s = f64::from(ms) * 1e-3;
        assert_eq!(since_ms(pose.capture.0), f64::from(ms));
        let [x, y, yaw] = moment(time_s).pose;
        let turned = (pose.yaw - yaw).rem_euclid(TAU);
        assert_near(
            &[pose.position.x, pose.position.y, turned.min(TAU - turned)],
            &[x, y, 0.0],
        );
    }
    let board = imported.board();
    assert_eq!(board.len(), 25);
    for (sample, ms) in board.iter().zip((0..).step_by(20)) {
        let now = moment(f64::from(ms) * 1e-3);
        assert_eq!(since_ms(sample.time.0), f64::from(ms));
        let inertial = sample.inertial.unwrap();
        let values = [
            inertial.forward_acceleration,
            inertial.left_acceleration,
            inertial.yaw_rate,
            sample.motor_speed,
        ];
        let [forward, left, rate] = now.inertial;
        assert_near(&values, &[forward, left, rate, now.speed]);
        let state = if now.driven {
            BoardState::Driving
        } else {
            BoardState::Neutral
        };
        assert_eq!(sample.state, state);
    }
    for tick in imported.ticks() {
        let ms = since_ms(tick.scheduled_ns);
        let held = moment((ms / 20.0).floor() * 0.02);
        let output = &tick.output;
        let actuation = [output.actuation.steering, output.actuation.speed];
        assert_near(&actuation, &[held.steering, held.speed_command]);
        let mode = if held.driven {
            Mode::Driving
        } else {
            Mode::Ready
        };
        assert_eq!(output.mode, mode);
    }
}

#[test]
fn f1tenth_under_vicon_in_every_storage() {
    let bag = with_definitions(f1tenth_bag(500, moment));
    for storage in STORAGES {
        let imported = imported(&bag, &f1tenth_map(), storage);
        assert_moments(&imported, moment);
        assert_eq!(imported.meta.start.wall_ns, at(0.0));
    }
    // Without definitions in the file, as some writers do, the built-in ones are used.
    let bare = f1tenth_bag(500, moment);
    assert_moments(&imported(&bare, &f1tenth_map(), Storage::Mcap), moment);
}

#[test]
fn a_bag_of_several_files_is_one_log_and_a_file_alone_is_one_too() {
    let bag = f1tenth_bag(500, moment);
    for storage in STORAGES {
        let (mut first, mut second) = (bag.clone(), bag.clone());
        first.messages.retain(|sent| sent.receive_ns < at(0.25));
        second.messages.retain(|sent| sent.receive_ns >= at(0.25));
        let folder = Folder::new(&f1tenth_map());
        let log = folder.write(&[first, second], storage);
        assert_moments(&folder.import(&log).unwrap(), moment);
        fs::remove_file(folder.path("out.mcap")).unwrap();
        let extension = if storage == Storage::Mcap {
            "mcap"
        } else {
            "db3"
        };
        let half = folder
            .import(&log.join(format!("bag_0.{extension}")))
            .unwrap();
        assert_eq!(half.poses().len(), 25);
    }
}

#[test]
fn the_time_of_a_message_is_its_stamp_or_its_reception() {
    let mut bag = f1tenth_bag(100, moment);
    for sent in &mut bag.messages {
        sent.receive_ns += 5_000_000;
    }
    let map = f1tenth_map().replace("[pose]", "[pose]\nstamp = \"receive\"");
    let imported = imported(&bag, &map, Storage::Mcap);
    let times: Vec<_> = imported
        .poses()
        .iter()
        .map(|pose| since_ms(pose.capture.0))
        .collect();
    // The first message is that of the motor, at its stamp.
    assert_eq!(times[..3], [7.0, 17.0, 27.0]);
    assert_eq!(since_ms(imported.board()[0].time.0), 0.0);
}

#[test]
fn the_other_byte_order_is_read() {
    let mut bag = f1tenth_bag(500, moment);
    let is_pose = |topic: &str| topic == "/vicon/car/car";
    bag.messages.retain(|sent| !is_pose(sent.topic));
    for ms in (0..500).step_by(10) {
        let time_s = f64::from(ms) * 1e-3;
        let [x, y, yaw] = moment(time_s).pose;
        bag.send("/vicon/car/car", time_s, &0);
        let transform = (header(at(time_s)), "car", [x, y, 0.1], quaternion(yaw));
        bag.messages.last_mut().unwrap().bytes = encoded_big(&transform);
    }
    assert_moments(&imported(&bag, &f1tenth_map(), Storage::Mcap), moment);
}

#[test]
fn the_imu_of_a_vesc_is_read_without_definitions() {
    let mut bag = f1tenth_bag(500, moment);
    bag.messages.retain(|sent| sent.topic != "/sensors/imu/raw");
    bag.topics
        .push(("/sensors/imu", "vesc_msgs/msg/VescImuStamped"));
    for ms in (0..500).step_by(20) {
        let time_s = f64::from(ms) * 1e-3;
        let [forward, left, rate] = moment(time_s).inertial;
        let acceleration = [forward / 9.80665, left / 9.80665, 1.0];
        let turned = [0.0, 0.0, rate.to_degrees()];
        let imu = (
            header(at(time_s)),
            [0.0; 3],
            acceleration,
            turned,
            [0.0; 3],
            [0.0; 4],
        );
        bag.send("/sensors/imu", time_s, &imu);
    }
    let map = f1tenth_map().replace("/sensors/imu/raw", "/sensors/imu");
    let map = map.replace("\"linear_acc", "\"imu.linear_acc");
    let map = map.replace("\"angular_vel", "\"imu.angular_vel");
    assert_moments(&imported(&bag, &map, Storage::OldSqlite), moment);
}

/// The map of f1tenth with the section `[pose]` that the documentation has for other cameras.
fn map_with_pose(of: &str) -> String {
    let documentation = fs::read_to_string(in_repository("docs/import.md")).unwrap();
    let mut blocks = documentation.split("```toml\n").skip(1);
    let block = blocks.find(|block| block.starts_with(&format!("# {of}")));
    let pose = block.unwrap().split("```").next().unwrap();
    let map = f1tenth_map();
    let (before, after) = map.split_once("[pose]").unwrap();
    let (_, after) = after.split_once("[imu]").unwrap();
    format!("{before}{pose}[imu]{after}")
}

#[test]
fn natnet_ros2_publishes_a_pose_for_each_body() {
    let mut bag = f1tenth_bag(500, moment);
    bag.topics[0] = ("/natnet_ros/car/pose", "geometry_msgs/msg/PoseStamped");
    bag.messages.retain(|sent| sent.topic != "/vicon/car/car");
    for ms in (0..500).step_by(10) {
        let time_s = f64::from(ms) * 1e-3;
        let [x, y, yaw] = moment(time_s).pose;
        let pose = (header(at(time_s)), [x, y, 0.1], quaternion(yaw));
        bag.send("/natnet_ros/car/pose", time_s, &pose);
    }
    for storage in STORAGES {
        let map = map_with_pose("natnet_ros2");
        assert_moments(
            &imported(&with_definitions(bag.clone()), &map, storage),
            moment,
        );
    }
}

/// A `mocap4r2_msgs/RigidBody` with two markers.
type RigidBody = (
    &'static str,
    Vec<(i8, i32, &'static str, [f64; 3])>,
    [f64; 3],
    [f64; 4],
);

fn rigid_body(name: &'static str, [x, y, yaw]: [f64; 3]) -> RigidBody {
    let marker = (1, 7, "", [x, y, 0.2]);
    (name, vec![marker; 2], [x, y, 0.1], quaternion(yaw))
}

/// The messages of mocap4ros2, with the bodies that it sees.
fn mocap4ros2_bag(bodies: impl Fn(u32, [f64; 3]) -> Vec<RigidBody>) -> Bag {
    let mut bag = f1tenth_bag(500, moment);
    bag.topics[0] = ("/rigid_bodies", "mocap4r2_msgs/msg/RigidBodies");
    bag.messages.retain(|sent| sent.topic != "/vicon/car/car");
    for ms in (0..500).step_by(10) {
        let time_s = f64::from(ms) * 1e-3;
        let bodies = bodies(ms, moment(time_s).pose);
        bag.send("/rigid_bodies", time_s, &(header(at(time_s)), ms, bodies));
    }
    with_definitions(bag)
}

#[test]
fn mocap4ros2_has_several_bodies_in_a_message() {
    let bag = mocap4ros2_bag(|_, pose| {
        vec![
            rigid_body("wand", [9.0, 9.0, 1.0]),
            rigid_body("car", pose),
            rigid_body("car2", [8.0, 8.0, 2.0]),
        ]
    });
    for storage in STORAGES {
        let imported = imported(&bag, &map_with_pose("mocap4ros2"), storage);
        assert_moments(&imported, moment);
    }
}

#[test]
fn a_body_that_is_not_seen_for_a_while_is_a_pose_that_is_not_finite() {
    let bag = mocap4ros2_bag(|ms, pose| match ms {
        100..150 => vec![rigid_body("wand", pose)],
        // A lost body is all zeros for some drivers.
        200 => vec![("car", vec![], [0.0; 3], [0.0; 4])],
        _ => vec![rigid_body("car", pose)],
    });
    let imported = imported(&bag, &map_with_pose("mocap4ros2"), Storage::Mcap);
    let observations = imported.observations();
    assert_eq!(observations.len(), 50);
    for (observation, ms) in observations.iter().zip((0..).step_by(10)) {
        let is_lost = matches!(ms, 100..150 | 200);
        let lost = PoseState::Rejected(RejectReason::NotFinite);
        assert_eq!(observation.state == lost, is_lost, "{ms}");
    }
}

#[test]
fn odometry_drive_commands_and_transforms_of_others_are_read() {
    let mut bag = Bag::new(&[
        ("/tf", "tf2_msgs/msg/TFMessage"),
        ("/odom", "nav_msgs/msg/Odometry"),
        ("/drive", "ackermann_msgs/msg/AckermannDriveStamped"),
    ]);
    for ms in (0..500).step_by(10) {
        let time_s = f64::from(ms) * 1e-3;
        let (time, now) = (at(time_s), moment(time_s));
        let [x, y, yaw] = now.pose;
        let body = |name, x, yaw| (header(time), name, [x, y, 0.0], quaternion(yaw));
        bag.send("/tf", time_s, &vec![body("lidar", 7.0, 1.0)]);
        bag.send(
            "/tf",
            time_s,
            &vec![body("lidar", 7.0, 1.0), body("car", x, yaw)],
        );
        if ms % 20 == 0 {
            let pose = ([9.0; 3], quaternion(1.0), [[0.0; 18]; 2]);
            let twist = ([now.speed, 0.0, 0.0], [0.0; 3], [[0.0; 18]; 2]);
            bag.send("/odom", time_s, &(header(time), "base", pose, twist));
            let drive = [now.steering as f32, 0.0, now.speed_command as f32, 0.0, 0.0];
            bag.send("/drive", time_s, &(header(time), drive));
        }
    }
    let map = r#"
[pose]
topic = "/tf"
stamp = "transforms[child_frame_id=car].header.stamp"
x = "transforms[child_frame_id=car].transform.translation.x"
y = "transforms[child_frame_id=car].transform.translation.y"
yaw = "transforms[child_frame_id=car].transform.rotation"
[motor]
topic = "/odom"
speed = "twist.twist.linear.x"
[steering]
topic = "/drive"
field = "drive.steering_angle"
radians_per_unit = 1.0
[speed_command]
topic = "/drive"
speed = "drive.speed"
"#;
    for storage in STORAGES {
        let imported = imported(&with_definitions(bag.clone()), map, storage);
        let speeds: Vec<_> = imported.motor_speeds();
        assert_eq!(speeds.len(), 25);
        assert_eq!(speeds[5], (100.0, 1.2));
        assert_eq!(imported.poses().len(), 50);
        let last = imported.ticks()[49];
        let [steering, speed] = [last.output.actuation.steering, last.output.actuation.speed];
        assert_eq!(
            [steering, speed],
            [(0.3 - 0.48_f64) as f32, (2.0 - 0.48_f64) as f32].map(f64::from)
        );
    }
}

/// The same rows in a CSV file and in a bag of a type that only the bag defines.
#[test]
fn a_bag_gives_the_record_of_a_csv_file_with_the_same_rows() {
    let csv_map = r#"
[time]
column = "t"
unit = "s"
unix = true
[pose]
x = { column = "x", unit = "mm" }
y = "y"
yaw = { column = "yaw", unit = "deg" }
tracked = "tracked"
point_m = [0.1, 0.2]
yaw_rad = 0.1
delay_s = 0.01
exposures_hz = 100
[imu]
forward_acceleration = { column = "ax", unit = "g", scale = -1 }
left_acceleration = "ay"
yaw_rate = "w"
new_when_changes = "n"
delay_s = 0.05
interpolate_hz = 100
[motor]
speed = "v"
new_when_changes = "n"
delay_s = 0.04
interpolate_hz = 100
[driving]
column = "on"
[steering]
column = "s"
table = [[-1.0, -0.4], [0.1, 0.0], [1.0, 0.3]]
[speed_command]
speed = { column = "u", unit = "km/h" }
delay_s = 0.02
"#;
    let time = "[time]\ncolumn = \"t\"\nunit = \"s\"\nunix = true\n";
    let mut bag_map = csv_map.replace(time, "").replace("column = ", "field = ");
    for section in [
        "pose",
        "imu",
        "motor",
        "driving",
        "steering",
        "speed_command",
    ] {
        let topic = "topic = \"/row\"\nstamp = \"stamp\"";
        bag_map = bag_map.replace(&format!("[{section}]"), &format!("[{section}]\n{topic}"));
    }
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut uniform = || (random.next_u32() >> 8) as f32 / (1 << 24) as f32 - 0.5;
    let mut csv = "t,x,y,yaw,tracked,ax,ay,w,n,v,on,s,u\n".to_owned();
    let mut bag = Bag::new(&[("/row", "my_msgs/msg/Row")]);
    let names = "x y yaw ax ay w v s u";
    let fields = names.split(' ').map(|name| format!("float32 {name}\n"));
    let text = format!(
        "builtin_interfaces/Time stamp\nbool tracked\nuint8 n\nint16 on\n{}",
        fields.collect::<String>()
    );
    bag.definitions.insert("my_msgs/msg/Row", text);
    for row in 0..200_u32 {
        let time_s = f64::from(row) * 0.01;
        let [x, y, yaw, ax, ay, w, v, s, u] = std::array::from_fn(|_| uniform());
        let (tracked, n, on) = (row != 50, (row / 10) as u8, i16::from(row > 20));
        let message = (
            stamp(at(time_s)),
            tracked,
            n,
            on,
            [x, y, yaw, ax, ay, w, v, s, u],
        );
        let [x, y, yaw, ax, ay, w, v, s, u] = message.4.map(f64::from);
        let (seconds, nanoseconds) = message.0;
        csv.push_str(&format!(
            "{seconds}.{nanoseconds:09},{x},{y},{yaw},{tracked},{ax},{ay},{w},{n},{v},{on},{s},{u}\n"
        ));
        bag.send("/row", time_s, &message);
    }
    let from_csv = crate::bench::imported(&csv, csv_map);
    for storage in [Storage::Mcap, Storage::Sqlite] {
        let from_bag = imported(&bag, &bag_map, storage);
        assert_eq!(from_bag.summary, from_csv.summary);
        assert_eq!(from_bag.meta.start, from_csv.meta.start);
        for (one, other) in from_bag.entries.iter().zip(&from_csv.entries) {
            let near = format!("{one:?}") == format!("{other:?}");
            assert!(near, "{one:?}\n{other:?}");
        }
        assert_eq!(from_bag.entries.len(), from_csv.entries.len());
    }
}

#[test]
fn a_compressed_file_may_hold_messages_that_are_longer_than_itself() {
    let mut bag = f1tenth_bag(500, moment);
    bag.topics.push(("/map", "nav_msgs/msg/OccupancyGrid"));
    // Of a topic that the map does not name.
    bag.send("/map", 0.3, &vec![0_u8; 4 << 20]);
    assert!(bag.mcap().len() < 2 << 20);
    assert_moments(&imported(&bag, &f1tenth_map(), Storage::Mcap), moment);
}
