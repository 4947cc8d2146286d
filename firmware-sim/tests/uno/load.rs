//! Limits on the image's use of processor, memory and line.

use singletrack_protocol::BoardMode;
use singletrack_sim::{ImageSize, Installation};

use super::{armed, config};

#[test]
fn a_drive_at_100_hz_leaves_80_percent_of_the_processor_and_600_bytes_of_memory() {
    let mut drive = armed(config(1));
    let before = drive.world.board_mut().figures().unwrap();
    drive.drive(1_000, 400, 800, |_| {});
    assert_eq!(drive.host.mode(), Some(BoardMode::Driving));
    let after = drive.world.board_mut().figures().unwrap();
    let cycles = after.cycles - before.cycles;
    // Ten seconds with an oscillator error of up to 0.5 %.
    assert!(cycles.abs_diff(160_000_000) < 1_000_000, "{cycles}");
    let busy = 1.0 - (after.cycles_asleep - before.cycles_asleep) as f64 / cycles as f64;
    assert!((0.01..=0.20).contains(&busy), "{busy}");
    let size = ImageSize::read(&Installation::find().unwrap().image).unwrap();
    assert!(size.flash_bytes <= 24 * 1_024, "{size:?}");
    let memory = size.static_bytes + u64::from(after.stack_bytes);
    assert!((200..=1_400).contains(&memory), "{size:?} {after:?}");
    // A byte takes 1,360 cycles: the longest delay loses none.
    let longest = |vector| {
        after
            .interrupts
            .iter()
            .find(|interrupt| interrupt.vector == vector)
            .unwrap()
    };
    for vector in [1, 14, 18, 19, 24] {
        let interrupt = longest(vector);
        assert!(interrupt.count > 100, "{interrupt:?}");
        assert!(interrupt.most_cycles < 400, "{interrupt:?}");
    }
    assert!(after.longest_critical_section < 200, "{after:?}");
    assert_eq!(drive.world.board().pulse_jitter_us(), Some(0.0));
}

#[test]
fn the_line_is_loaded_below_40_percent_in_both_directions() {
    let mut drive = armed(config(1));
    let mut received = 0;
    let mut sent = 0;
    for _ in 0..500 {
        let command = drive.host.drive(400, 800);
        sent += command.encode().as_bytes().len();
        drive.send(&command);
        let mut bytes = Vec::new();
        for _ in 0..10 {
            let next_us = drive.world.now_us() + 1_000;
            drive.world.advance_to(next_us);
            drive.world.host_read(&mut bytes);
        }
        drive.host.take(&bytes);
        received += bytes.len();
    }
    assert_eq!(drive.host.mode(), Some(BoardMode::Driving));
    // Five seconds at 115200 baud.
    let capacity = 5.0 * 11_520.0;
    let (back, out) = (received as f64 / capacity, sent as f64 / capacity);
    assert!((0.30..=0.40).contains(&back), "{back}");
    assert!((0.05..=0.40).contains(&out), "{out}");
}
