//! Damaged and random maps, files and messages: an error or a record, and nothing else.

use std::fs;

use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng as _, SeedableRng as _},
};

use super::build::{Bag, Folder, at, header, quaternion};

const MAP: &str = r#"
[pose]
topic = "/bodies"
x = "rigidbodies[rigid_body_name=car].pose.position.x"
y = "rigidbodies[rigid_body_name=car].pose.position.y"
yaw = "rigidbodies[rigid_body_name=car].pose.orientation"
[motor]
topic = "/joy"
speed = "axes[1]"
[steering]
topic = "/joy"
field = "buttons[0]"
radians_per_unit = 1.0
"#;

fn bag() -> Bag {
    let mut bag = Bag::new(&[
        ("/bodies", "mocap4r2_msgs/msg/RigidBodies"),
        ("/joy", "sensor_msgs/msg/Joy"),
    ]);
    for number in 0..20_u32 {
        let time_s = f64::from(number) * 0.01;
        let body = |name| {
            (
                name,
                vec![(1_i8, 2, "m", [0.5; 3])],
                [time_s; 3],
                quaternion(0.5),
            )
        };
        let bodies = vec![body("other"), body("car")];
        bag.send("/bodies", time_s, &(header(at(time_s)), number, bodies));
        bag.send(
            "/joy",
            time_s,
            &(header(at(time_s)), vec![0.5_f32; 4], vec![1; 6]),
        );
    }
    bag
}

struct Random(ChaCha8Rng);

impl Random {
    fn below(&mut self, end: usize) -> usize {
        self.0.next_u32() as usize % end.max(1)
    }

    /// Changes some bytes, with a preference for extreme ones, and now and then the length.
    fn damage(&mut self, bytes: &mut Vec<u8>) {
        for _ in 0..=self.below(4) {
            let (place, byte) = (self.below(bytes.len()), self.0.next_u32() as u8);
            match (self.below(8), bytes.get_mut(place)) {
                (0, _) => bytes.truncate(place),
                (1, _) => bytes.insert(place.min(bytes.len()), byte),
                (2, Some(one)) => *one = 0xff,
                (3, Some(one)) => *one ^= 1 << (byte % 8),
                // A false length.
                (4, Some(_)) => {
                    let end = bytes.len().min(place + 4 * (1 + self.below(2)));
                    bytes[place..end].fill(0xff);
                }
                (_, Some(one)) => *one = byte,
                (_, None) => bytes.push(byte),
            }
        }
    }
}

/// Fails if the process has reserved as much memory as a false length asks for, 4 GiB, since it began.
fn assert_little_memory() {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmPeak:"));
    let kilobytes: u64 = peak
        .unwrap()
        .trim()
        .trim_end_matches(" kB")
        .parse()
        .unwrap();
    assert!(kilobytes < 4 << 20, "{kilobytes} kB");
}

/// Imports; a record is removed again.
fn import(folder: &Folder, log: &str) -> bool {
    let is_imported = folder.import(&folder.path(log)).is_ok();
    if is_imported {
        fs::remove_file(folder.path("out.mcap")).unwrap();
    }
    is_imported
}

#[test]
fn damaged_messages_end_in_an_error_or_a_record() {
    let (folder, bag) = (Folder::new(MAP), bag());
    let mut random = Random(ChaCha8Rng::seed_from_u64(1));
    let mut imported = 0;
    for _ in 0..100 {
        let mut bag = bag.clone();
        let place = random.below(bag.messages.len());
        random.damage(&mut bag.messages[place].bytes);
        fs::write(folder.path("log.mcap"), bag.mcap()).unwrap();
        imported += u32::from(import(&folder, "log.mcap"));
    }
    assert!((5..95).contains(&imported), "{imported}");
    assert_little_memory();
}

#[test]
fn damaged_files_end_in_an_error_or_a_record() {
    let (folder, bag) = (Folder::new(MAP), bag());
    let mut random = Random(ChaCha8Rng::seed_from_u64(2));
    bag.write_sqlite(&folder.path("whole.db3"), true);
    let sqlite = fs::read(folder.path("whole.db3")).unwrap();
    let (mcap, bare) = (bag.mcap(), bag.bare_mcap());
    for (name, whole) in [("log.mcap", mcap), ("log.mcap", bare), ("log.db3", sqlite)] {
        for _ in 0..120 {
            let mut bytes = whole.clone();
            random.damage(&mut bytes);
            fs::write(folder.path(name), bytes).unwrap();
            import(&folder, name);
        }
    }
    assert_little_memory();
}

#[test]
fn damaged_definitions_and_maps_end_in_an_error_or_a_record() {
    let mut random = Random(ChaCha8Rng::seed_from_u64(3));
    let mut bag = bag();
    let text = "std_msgs/Header header\nfloat32[] axes\nint32[<=9] buttons\n";
    for round in 0..200 {
        let (mut definition, mut map) = (text.as_bytes().to_vec(), MAP.as_bytes().to_vec());
        random.damage(if round % 2 == 0 {
            &mut definition
        } else {
            &mut map
        });
        let folder = Folder::new(&String::from_utf8_lossy(&map));
        let definition = String::from_utf8_lossy(&definition).into_owned();
        bag.definitions.insert("sensor_msgs/msg/Joy", definition);
        fs::write(folder.path("log.mcap"), bag.mcap()).unwrap();
        import(&folder, "log.mcap");
        if round % 2 == 1 {
            fs::write(folder.path("log.csv"), "t,x\n0,1\n").unwrap();
            import(&folder, "log.csv");
        }
    }
    assert_little_memory();
}
