//! What is said of a bag that can't be imported.

use std::{fs, slice};

use super::build::{Bag, Folder, STORAGES, Storage, at, header, quaternion, stamp};
use crate::bench;

const MAP: &str = r#"
[pose]
topic = "/pose"
x = "pose.position.x"
y = "pose.position.y"
yaw = "pose.orientation"
[motor]
topic = "/speed"
stamp = "receive"
speed = "data"
[steering]
topic = "/speed"
stamp = "receive"
field = "data"
radians_per_unit = 1.0
"#;

/// Ten messages for [`MAP`] on each topic, a hundredth of a second apart.
fn bag() -> Bag {
    let mut bag = Bag::new(&[
        ("/pose", "geometry_msgs/msg/PoseStamped"),
        ("/speed", "std_msgs/msg/Float64"),
        ("/text", "std_msgs/msg/String"),
    ]);
    for number in 0..10_u32 {
        let time_s = f64::from(number) * 0.01;
        let pose = (header(at(time_s)), [time_s, 2.0, 0.0], quaternion(0.5));
        bag.send("/pose", time_s, &pose);
        bag.send("/speed", time_s, &time_s);
    }
    bag
}

/// The error of a bag with a map, which is the same in every storage.
fn error(bag: &Bag, map: &str) -> String {
    let mut errors = STORAGES.map(|storage| {
        let folder = Folder::new(map);
        let log = folder.write(slice::from_ref(bag), storage);
        folder.error(&log)
    });
    let [first, others @ ..] = &mut errors;
    for other in others {
        assert_eq!(first, other);
    }
    first.clone()
}

#[track_caller]
fn assert_map_error(from: &str, to: &str, expected: &str) {
    let map = MAP.replace(from, to);
    assert_ne!(map, MAP);
    assert_eq!(error(&bag(), &map), expected);
}

/// The number of the message of `/pose` that is changed.
fn assert_pose_error(change: impl Fn(&mut Vec<u8>, f64), expected: &str) {
    let mut bag = bag();
    let mut poses = bag.messages.iter_mut().filter(|sent| sent.topic == "/pose");
    change(&mut poses.nth(6).unwrap().bytes, 0.06);
    let message = "bag, topic \"/pose\", message 7 (received at 1700000000.062000000 s)";
    assert_eq!(error(&bag, MAP), format!("{message}{expected}"));
}

#[test]
fn a_bag_without_mistakes_is_imported() {
    let folder = Folder::new(MAP);
    let log = folder.write(&[bag()], Storage::Mcap);
    assert_eq!(folder.import(&log).unwrap().poses().len(), 10);
}

#[test]
fn an_unknown_topic_is_named_with_those_that_are_there() {
    let topics = "its topics are \"/pose\" (geometry_msgs/PoseStamped), \"/speed\" (std_msgs/Float64), \
                  \"/text\" (std_msgs/String)";
    assert_map_error(
        "topic = \"/pose\"",
        "topic = \"/poses\"",
        &format!("bag has no topic \"/poses\", which pose.topic in the map names; {topics}"),
    );
    let mut silent = bag();
    silent.messages.retain(|sent| sent.topic != "/pose");
    assert_eq!(
        error(&silent, MAP),
        format!(
            "bag has no messages on the topic \"/pose\", which pose.topic in the map names; {topics}"
        )
    );
}

#[test]
fn an_unknown_field_is_named_with_those_that_are_there() {
    assert_map_error(
        "pose.position.y",
        "pose.position.up",
        "bag, topic \"/pose\" of type geometry_msgs/PoseStamped: pose.y in the map names \
         \"pose.position.up\": geometry_msgs/Point has no up, its fields are x, y, z",
    );
    assert_map_error(
        "stamp = \"receive\"\nspeed",
        "speed",
        "bag, topic \"/speed\" of type std_msgs/Float64: motor.stamp in the map names \"header.stamp\": \
         std_msgs/Float64 has no header, its fields are data",
    );
    assert_map_error(
        "field = \"data\"",
        "field = \"data[\"",
        "steering.column in the map is \"data[\": write a field as a.b, a[0].b or a[name=x].b",
    );
}

#[test]
fn a_field_of_a_wrong_type_is_named_with_its_type() {
    let topic = "bag, topic \"/pose\" of type geometry_msgs/PoseStamped: pose.";
    for (from, to, expected) in [
        (
            "pose.position.x",
            "pose.orientation",
            "x in the map names \"pose.orientation\": it is a geometry_msgs/Quaternion, not a number",
        ),
        (
            "pose.position.x",
            "header.frame_id",
            "x in the map names \"header.frame_id\": it is a text, not a number",
        ),
        (
            "pose.orientation",
            "pose",
            "yaw in the map names \"pose\": it is a geometry_msgs/Pose, not a number or a quaternion",
        ),
        (
            "[pose]",
            "[pose]\nstamp = \"pose.position.x\"",
            "stamp in the map names \"pose.position.x\": it is a number, not a builtin_interfaces/Time",
        ),
    ] {
        assert_map_error(from, to, &format!("{topic}{expected}"));
    }
}

#[test]
fn a_type_that_is_not_known_is_named() {
    let message = assert_type_error("std_msgs/msg/String", "/text");
    assert!(
        message.starts_with(
            "bag, topic \"/text\" of type std_msgs/String: std_msgs/String is not defined; \
             convert the bag"
        ),
        "{message}"
    );
}

fn assert_type_error(kind: &'static str, topic: &'static str) -> String {
    let mut bag = bag();
    bag.topics[2] = (topic, kind);
    let map = MAP.replace(
        "[motor]\ntopic = \"/speed\"",
        &format!("[motor]\ntopic = \"{topic}\""),
    );
    error(&bag, &map)
}

#[test]
fn a_message_that_does_not_fit_its_type_is_named_with_its_number() {
    let short = " has 75 bytes, and its type needs more: the bag is damaged, or has another version of the \
                 type";
    assert_pose_error(|bytes, _| bytes.truncate(bytes.len() - 1), short);
    assert_pose_error(
        |bytes, _| bytes.extend([0; 8]),
        " has 8 bytes more than its type: the bag has another version of the type; convert it with `ros2 \
         bag convert` to MCAP, which holds the definitions",
    );
    assert_pose_error(
        |bytes, _| bytes[1] = 7,
        " begins with [00, 07, 00, 00], which is not the header of plain CDR: convert the bag with `ros2 \
         bag convert`",
    );
    assert_pose_error(
        |bytes, _| *bytes = vec![0x28, 0xb5, 0x2f, 0xfd, 1, 2, 3],
        " is compressed with zstd: convert the bag with `ros2 bag convert` to one without compression",
    );
    assert_pose_error(
        |bytes, _| bytes.clear(),
        " begins with [], which is not the header of plain CDR: convert the bag with `ros2 bag convert`",
    );
}

#[test]
fn a_value_that_is_not_finite_is_named_with_its_field() {
    let mut bag = bag();
    bag.send("/speed", 0.1, &f64::NAN);
    assert_eq!(
        error(&bag, MAP),
        "bag, topic \"/speed\", message 11 (received at 1700000000.102000000 s), field \"data\": NaN is not a \
         finite number: leave the time of the message out of the bag with `ros2 bag convert`"
    );
}

#[test]
fn times_that_can_not_be_right_are_named() {
    let with_stamp = |bytes: &mut Vec<u8>, time_ns: u64| {
        let (seconds, nanoseconds) = stamp(time_ns);
        bytes[4..8].copy_from_slice(&seconds.to_le_bytes());
        bytes[8..12].copy_from_slice(&nanoseconds.to_le_bytes());
    };
    assert_pose_error(
        |bytes, time_s| with_stamp(bytes, at(time_s - 0.0125)),
        ": its header.stamp is 0.002500000 s before that of the message before: two nodes publish on the \
         topic, or a clock was set; stamp = \"receive\" in the map takes the time of reception",
    );
    assert_pose_error(
        |bytes, _| with_stamp(bytes, 0),
        ": its header.stamp is 0: its node does not set it; stamp = \"receive\" in the map takes the time of \
         reception",
    );
    assert_pose_error(
        |bytes, _| bytes[4..8].copy_from_slice(&(-1_i32).to_le_bytes()),
        ": its header.stamp is before 1970: the message is damaged, or of another version of its type",
    );
    let mut bag = bag();
    for sent in bag.messages.iter_mut().filter(|sent| sent.topic == "/pose") {
        with_stamp(&mut sent.bytes, sent.receive_ns + 20_000_000_000);
    }
    assert_eq!(
        error(&bag, MAP),
        "bag, topic \"/pose\", message 1 (received at 1700000000.002000000 s): its header.stamp is \
         19.910000000 s after that of message 10 of \"/speed\", the one before: if the two have other clocks, \
         use stamp = \"receive\" in the map; if the bag has a gap, import a part of it or raise \
         time.longest_gap_s"
    );
}

#[test]
fn a_body_that_is_in_no_message_is_named_with_those_that_are() {
    let mut bag = bag();
    bag.topics[0] = ("/pose", "tf2_msgs/msg/TFMessage");
    bag.messages.retain(|sent| sent.topic != "/pose");
    for body in ["lidar", "wand", "lidar"] {
        let transform = (header(at(0.0)), body, [0.0; 3], quaternion(0.0));
        bag.send("/pose", 0.0, &vec![transform]);
    }
    let mut map = MAP.replace(
        "pose.position",
        "transforms[child_frame_id=car].transform.translation",
    );
    map = map.replace(
        "pose.orientation",
        "transforms[child_frame_id=car].transform.rotation",
    );
    map = map.replace("[pose]", "[pose]\nstamp = \"receive\"");
    assert_eq!(
        error(&bag, &map),
        "bag, topic \"/pose\" of type tf2_msgs/TFMessage: no message has the element that pose.x in the map \
         names, \"transforms[child_frame_id=car].transform.translation.x\"; there are \"lidar\", \"wand\""
    );
}

#[test]
fn a_folder_that_is_no_bag_says_what_is_missing() {
    let folder = Folder::new(MAP);
    let log = folder.write(&[bag(), bag()], Storage::Sqlite);
    let metadata = log.join("metadata.yaml");
    let text = fs::read_to_string(&metadata).unwrap();
    fs::remove_file(&metadata).unwrap();
    assert_eq!(
        folder.error(&log),
        "can't read bag as a bag: it has no metadata.yaml: write it with `ros2 bag reindex`, or import one \
         of its files, bag_0.db3, bag_1.db3"
    );
    fs::write(&metadata, "rosbag2_bagfile_information:\n  version: 9\n").unwrap();
    assert_eq!(
        folder.error(&log),
        "can't read bag as a bag: its metadata.yaml has no list relative_file_paths: write it with `ros2 bag \
         reindex`"
    );
    fs::write(&metadata, text.replace("mode: \"\"", "mode: \"MESSAGE\"")).unwrap();
    assert_eq!(
        folder.error(&log),
        "can't read bag as a bag: it is compressed (MESSAGE mode): convert it with `ros2 bag convert` to one \
         without compression"
    );
    fs::write(&metadata, text.replace("bag_1", "bag_2")).unwrap();
    let message = folder.error(&log);
    assert!(
        message.starts_with("can't read bag/bag_2.db3: "),
        "{message}"
    );
}

#[test]
fn a_file_that_is_no_bag_says_what_it_is() {
    let folder = Folder::new(MAP);
    for (name, expected) in [
        (
            "log.mcap",
            "can't read log.mcap as a bag: Bad magic number: it is no MCAP file, or its end is missing: `mcap \
             recover` repairs it",
        ),
        (
            "log.db3",
            "can't read log.db3 as a bag: file is not a database: it is damaged, or no sqlite file",
        ),
        (
            "log.db3.zstd",
            "can't read log.db3.zstd as a bag: it is compressed: decompress it with `zstd -d`, and import the \
             file that it makes",
        ),
        (
            "log.zip",
            "can't read log.zip as a bag: it is an archive: unpack it with `unzip`, and import the bag's folder \
             in it",
        ),
        (
            "log.bag",
            "can't read log.bag as a bag: it is a bag of ROS 1: convert it with `rosbags-convert`",
        ),
    ] {
        let log = folder.path(name);
        fs::write(&log, "no bag, but a long enough text".repeat(50)).unwrap();
        assert_eq!(folder.error(&log), expected);
    }
    let cut = folder.path("cut.mcap");
    let bytes = bag().mcap();
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let message = folder.error(&cut);
    assert!(
        message.ends_with("`mcap recover` saves what can be read"),
        "{message}"
    );
    let empty = folder.path("empty.db3");
    fs::write(&empty, "").unwrap();
    assert_eq!(
        folder.error(&empty),
        "can't read empty.db3 as a bag: it has no tables `topics` and `messages`: it is no bag of ROS 2"
    );
}

#[test]
fn a_map_is_for_bags_or_for_csv_files() {
    let message = bench::error("t,x\n0,0\n", MAP);
    assert_eq!(
        message,
        "map.toml: time.column is missing: name the column of the time of a row"
    );
    let csv = format!(
        "{}{MAP}",
        "[time]\ncolumn = \"t\"\nunit = \"s\"\nunix = true\n"
    );
    assert_eq!(
        bench::error("t,x\n0,0\n", &csv),
        "map.toml: pose.topic is \"/pose\": remove it: a CSV file has no topics"
    );
    let message = error(&bag(), &csv);
    assert!(
        message.starts_with("map.toml: time.column is \"t\": remove it"),
        "{message}"
    );
    assert_map_error(
        "topic = \"/pose\"\n",
        "",
        "map.toml: pose.topic is missing: name the topic whose messages have the fields of this section",
    );
}

/// The bag with `/pose` of a type that is not built in, defined in this language.
fn bag_of_own_type(language: &'static str) -> Bag {
    let mut bag = bag();
    bag.topics[0] = ("/pose", "own_msgs/msg/Pose");
    bag.definitions
        .insert("own_msgs/msg/Pose", "module own_msgs {};".to_owned());
    bag.language = language;
    bag
}

#[test]
fn a_definition_in_another_language_is_named_with_what_to_do() {
    let folder = Folder::new(MAP);
    let log = folder.write(&[bag_of_own_type("ros2idl")], Storage::Mcap);
    assert_eq!(
        folder.error(&log),
        "bag, topic \"/pose\" of type own_msgs/Pose: own_msgs/Pose is not defined; its definition is in \
         \"ros2idl\", which is not read: publish it as a type that has a .msg file, or make a CSV file of it"
    );
}

/// The log time of a recorder whose clock was before 1970, ns.
const ROLLED_OVER_NS: u64 = 0_u64.wrapping_sub(7_500_000_000);

/// The bag whose seventh message on the topic was received then.
fn rolled_over(topic: &str, keeps_order: bool) -> Bag {
    let mut bag = bag();
    bag.keeps_order = keeps_order;
    let mut sent = bag.messages.iter_mut().filter(|sent| sent.topic == topic);
    sent.nth(6).unwrap().receive_ns = ROLLED_OVER_NS;
    bag
}

#[test]
fn a_wrong_time_of_reception_does_not_matter_to_messages_with_a_stamp() {
    for keeps_order in [true, false] {
        let folder = Folder::new(MAP);
        let log = folder.write(&[rolled_over("/pose", keeps_order)], Storage::Mcap);
        let imported = folder.import(&log).unwrap();
        assert_eq!(imported.poses().len(), 10);
    }
    // A clock that was set while it recorded.
    let mut bag = bag();
    bag.keeps_order = true;
    let mut poses = bag.messages.iter_mut().filter(|sent| sent.topic == "/pose");
    poses.nth(6).unwrap().receive_ns -= 3_600_000_000_000;
    let folder = Folder::new(MAP);
    let log = folder.write(&[bag], Storage::Mcap);
    assert_eq!(folder.import(&log).unwrap().poses().len(), 10);
}

#[test]
fn a_wrong_time_of_reception_that_is_the_time_of_a_message_is_named() {
    let folder = Folder::new(MAP);
    let log = folder.write(&[rolled_over("/speed", true)], Storage::Mcap);
    let error = folder.error(&log);
    let place = "bag, topic \"/speed\", message 7 (received at 18446744066.209551616 s)";
    assert!(error.starts_with(place), "{error}");
    for part in [
        "its time of reception is later than the year 2262",
        "mcap filter",
    ] {
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn a_sqlite_file_that_keeps_a_log_of_its_own_is_read_and_left_as_it_is() {
    let names = |folder: &std::path::Path| {
        let entries = fs::read_dir(folder).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<_> = names.collect();
        names.sort();
        names
    };
    let folder = Folder::new(MAP);
    let log = folder.write(&[bag()], Storage::Sqlite);
    // A name that a URI escapes.
    let file = log.join("bag 100%?#.db3");
    fs::rename(log.join("bag_0.db3"), &file).unwrap();
    let connection = rusqlite::Connection::open(&file).unwrap();
    let mode = |row: &rusqlite::Row<'_>| row.get::<_, String>(0);
    let mode = connection.query_row("PRAGMA journal_mode = WAL", [], mode);
    assert_eq!(mode.unwrap(), "wal");
    drop(connection);
    let before = names(&log);
    let imported = folder.import(&file).unwrap();
    assert_eq!(imported.poses().len(), 10);
    assert_eq!(names(&log), before);
    // Its recorder was killed: messages are in the log.
    fs::write(log.join("bag 100%?#.db3-wal"), [1; 64]).unwrap();
    let before = names(&log);
    fs::remove_file(folder.path("out.mcap")).unwrap();
    let error = folder.error(&file);
    assert!(error.contains("wal_checkpoint"), "{error}");
    assert_eq!(names(&log), before);
}
