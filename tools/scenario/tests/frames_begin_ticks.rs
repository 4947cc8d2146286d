//! A frame begins the tick that waits for it; the deadlines stay where they are.

use singletrack_core::config::{Config, ReferenceSection, StepSection};
use singletrack_pilot::Event;
use singletrack_record::TickRecord;
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{LossKind, LossWindow, SimulationConfig};

const PERIOD_NS: u64 = 10_000_000;
/// A frame may begin a tick so long before its deadline.
const WINDOW_NS: u64 = 3_000_000;
/// While the car drives, the deadlines move by this much a tick at most.
const SLIDE_NS: u64 = PERIOD_NS / 500;

fn config() -> Config {
    daemon_config(Drive::following(ReferenceSection::VelocitySteps {
        steps: vec![StepSection {
            duration_s: 60.0,
            v_x_m_s: 0.2,
            v_y_m_s: 0.0,
        }],
    }))
}

/// The ticks of a drive of 10 s, from its third second on. The camera stream is silent from
/// `silent` on (s after the drive began, and for how long).
fn ticks(
    config: Config,
    simulation: SimulationConfig,
    silent: Option<[f64; 2]>,
) -> Vec<TickRecord> {
    let mut drive = VirtualDrive::new(config, 7, simulation).unwrap();
    let start_us = drive.start().unwrap().now.0 / 1_000;
    if let Some([from, seconds]) = silent {
        let start_us = start_us + (from * 1e6) as u64;
        let end_us = start_us + (seconds * 1e6) as u64;
        let window = LossWindow { start_us, end_us };
        drive.world.cameras.parameters.loss_windows.push(window);
    }
    let mut ticks = Vec::new();
    while drive.now_us() < start_us + 10_000_000 {
        let tick = drive.step();
        if tick.now.0 / 1_000 > start_us + 3_000_000 {
            ticks.push(tick.tick);
        }
    }
    ticks
}

/// When the frames of a tick arrived, ns.
fn arrivals(tick: &TickRecord) -> impl DoubleEndedIterator<Item = u64> {
    tick.events.iter().filter_map(|event| match event {
        Event::Pose(pose) => Some(pose.receive.0),
        _ => None,
    })
}

#[test]
fn a_tick_begins_when_its_frame_arrives() {
    for seed in 0..4 {
        let simulation = SimulationConfig {
            seed,
            ..SimulationConfig::default()
        };
        let ticks = ticks(config(), simulation, None);
        for tick in &ticks {
            let mut frames = arrivals(tick);
            let frame = frames.next().unwrap();
            assert_eq!(frames.next(), None, "two frames, tick {}", tick.index);
            assert_eq!(frame, tick.scheduled_ns, "tick {}", tick.index);
            assert_eq!(tick.start_ns, tick.scheduled_ns);
        }
        // No deadline is lost, and none is added.
        let [first, last] = [ticks.first().unwrap(), ticks.last().unwrap()];
        let lasted_ns = last.scheduled_ns - first.scheduled_ns;
        let periods_ns = (last.index - first.index) * PERIOD_NS;
        let slides_ns = (last.index - first.index) * SLIDE_NS;
        assert!(lasted_ns.abs_diff(periods_ns) < WINDOW_NS + slides_ns);
    }
}

#[test]
fn without_frames_the_ticks_keep_their_deadlines() {
    let mut simulation = SimulationConfig::default();
    simulation.cameras.loss_kind = LossKind::Silent;
    let ticks = ticks(config(), simulation, Some([5.0, 0.3]));
    let mut silent = 0;
    for pair in ticks.windows(2) {
        let [before, tick] = pair else { continue };
        if arrivals(before).count() == 0 && arrivals(tick).count() == 0 {
            silent += 1;
            assert_eq!(tick.scheduled_ns, before.scheduled_ns + PERIOD_NS);
        }
    }
    assert!((25..=32).contains(&silent), "{silent}");
}

#[test]
fn more_frames_than_ticks_begin_no_more_ticks() {
    for period_us in [1_000, 2_778, 4_167, 8_333] {
        let mut simulation = SimulationConfig::default();
        simulation.cameras.period_us = period_us;
        let ticks = ticks(config(), simulation, None);
        for pair in ticks.windows(2) {
            let [before, tick] = pair else { continue };
            let apart_ns = tick.start_ns - before.start_ns;
            let allowed = PERIOD_NS - WINDOW_NS - SLIDE_NS..=PERIOD_NS + WINDOW_NS + SLIDE_NS;
            assert!(allowed.contains(&apart_ns), "{period_us}: {apart_ns}");
            // A frame is taken that is no older than two periods of the cameras, or the window.
            let newest = arrivals(tick).next_back().unwrap();
            let oldest_ns = WINDOW_NS.max(2_000 * period_us);
            assert!(tick.start_ns - newest <= oldest_ns, "{period_us}");
        }
        let count = ticks.len();
        assert!((695..=705).contains(&count), "{period_us}: {count} ticks");
    }
}

#[test]
fn without_alignment_frames_do_not_matter() {
    let mut config = config();
    config.control.align_to_cameras = false;
    let ticks = ticks(config, SimulationConfig::default(), None);
    for pair in ticks.windows(2) {
        let [before, tick] = pair else { continue };
        assert_eq!(tick.scheduled_ns, before.scheduled_ns + PERIOD_NS);
    }
}
