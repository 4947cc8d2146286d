//! What a record has that was made of a log.

use std::fs;

use singletrack_control::{InertialSample, PoseSample, Position, Time};
use singletrack_mocap::{
    CaptureTimeSource, Observation, Pose as PlanarPose, PoseState, RejectReason,
};
use singletrack_pilot::{
    BoardSample, BoardState, DriveCommand, Event, LinkState, Mode, PoseMissing,
};
use singletrack_record::{ClockMapping, Entry, LinkPhase};

use crate::bench::{Bench, MAP, imported};

const FULL_LOG: &str = "\
time ms,x,y,yaw,ok,ax,ay,w,v,on,s,u
1700000000000,1.0,2.0,0.5,1,0.1,0.2,0.3,1.0,0,0.0,0.5
1700000000010,1.1,2.0,0.6,1,0.4,0.5,0.6,1.2,1,0.2,0.7
1700000000015,nan,2.0,0.7,1,0.7,0.8,0.9,1.4,1,0.4,0.9
1700000000025,1.3,2.0,0.8,0,1.0,1.1,1.2,1.6,1,0.6,1.1
";

const FULL_MAP: &str = r#"
[time]
column = "time ms"
unit = "ms"
unix = true
[pose]
x = "x"
y = "y"
yaw = "yaw"
tracked = "ok"
delay_s = 0.004
[imu]
forward_acceleration = "ax"
left_acceleration = "ay"
yaw_rate = "w"
delay_s = 0.002
[motor]
speed = "v"
delay_s = 0.002
[driving]
column = "on"
[steering]
column = "s"
radians_per_unit = 0.5
[speed_command]
speed = "u"
"#;

const MS: u64 = 1_000_000;
const START: u64 = 1_000 * MS;

fn board(time_ms: u64, [forward, left, rate]: [f64; 3], speed: f64, state: BoardState) -> Event {
    let time = Time(START - 2 * MS + time_ms * MS);
    Event::Board(BoardSample {
        time,
        inertial: Some(InertialSample {
            time,
            yaw_rate: rate,
            forward_acceleration: forward,
            left_acceleration: left,
        }),
        motor_speed: speed,
        state,
    })
}

fn pose(frame: i32, time_ms: u64, x: f64, yaw: f64) -> (Observation, Event) {
    let receive = START + time_ms * MS;
    let capture = receive - 4 * MS;
    let observation = Observation {
        frame_number: frame,
        receive_time_ns: receive,
        state: PoseState::Valid(PlanarPose {
            x_m: x,
            y_m: 2.0,
            z_m: 0.0,
            yaw_rad: yaw,
            tilt_rad: 0.0,
            roll_rad: 0.0,
            pitch_rad: 0.0,
            capture_time_ns: capture,
            capture_uncertainty_ns: 0,
            capture_source: CaptureTimeSource::FrameTimestamp,
            receive_time_ns: receive,
            frame_number: frame,
            mean_error_m: 0.0,
            reacquired: false,
        }),
    };
    let event = Event::Pose(PoseSample {
        capture: Time(capture),
        receive: Time(receive),
        frame,
        position: Position::new(x, 2.0),
        yaw,
    });
    (observation, event)
}

#[test]
fn a_log_becomes_observations_and_ticks_with_their_events() {
    let imported = imported(FULL_LOG, FULL_MAP);
    let (first, first_event) = pose(0, 0, 1.0, 0.5);
    let (second, second_event) = pose(1, 10, 1.1, 0.6);
    let missing = |frame_number, time_ms: u64, state| Observation {
        frame_number,
        receive_time_ns: START + time_ms * MS,
        state,
    };
    let not_finite = missing(2, 15, PoseState::Rejected(RejectReason::NotFinite));
    let untracked = missing(3, 25, PoseState::Untracked);
    let order: Vec<_> = imported
        .entries
        .iter()
        .map(|entry| match entry {
            Entry::Pose(observation) => Some(*observation),
            Entry::Tick(_) => None,
            other => panic!("{other:?}"),
        })
        .collect();
    let expected = [
        Some(first),
        None,
        Some(second),
        None,
        Some(not_finite),
        None,
        Some(untracked),
        None,
    ];
    assert_eq!(order, expected);
    let events: Vec<Vec<Event>> = imported
        .ticks()
        .iter()
        .map(|tick| tick.events.to_vec())
        .collect();
    let expected = [
        vec![
            Event::Link(LinkState::Ready),
            board(0, [0.1, 0.2, 0.3], 1.0, BoardState::Neutral),
            first_event,
        ],
        vec![
            // At 8 ms the car is not driven yet.
            board(10, [0.4, 0.5, 0.6], 1.2, BoardState::Neutral),
            second_event,
        ],
        vec![
            board(15, [0.7, 0.8, 0.9], 1.4, BoardState::Driving),
            Event::PoseMissing(PoseMissing::Rejected),
        ],
        vec![
            board(25, [1.0, 1.1, 1.2], 1.6, BoardState::Driving),
            Event::PoseMissing(PoseMissing::Untracked),
        ],
    ];
    assert_eq!(events, expected);
}

#[test]
fn ticks_are_on_a_grid_with_the_commands_in_force() {
    let imported = imported(FULL_LOG, FULL_MAP);
    let (ready, driving) = (Mode::Ready, Mode::Driving);
    let expected = [
        (0, ready, 0.0, 0.5, true),
        (10, driving, 0.1, 0.7, true),
        (20, driving, 0.2, 0.9, false),
        // The last row is before the last tick.
        (30, driving, 0.3, 1.1, false),
    ];
    let ticks = imported.ticks();
    assert_eq!(ticks.len(), expected.len());
    for (index, (tick, expected)) in ticks.iter().zip(expected).enumerate() {
        let (time_ms, mode, steering, speed, has_pose) = expected;
        let time_ns = START + time_ms * MS;
        let times = [
            tick.scheduled_ns,
            tick.start_ns,
            tick.finish_ns,
            tick.pilot_time.0,
        ];
        assert_eq!(times, [time_ns; 4]);
        assert_eq!(tick.index, index as u64);
        assert_eq!(tick.link, LinkPhase::Ready);
        assert_eq!(tick.drive, None);
        let output = &tick.output;
        assert_eq!(
            (output.mode, output.reason, output.estimate),
            (mode, None, None)
        );
        assert_eq!(output.held, !has_pose);
        assert_eq!(output.actuation.steering, steering);
        assert_eq!(output.actuation.speed, speed);
        let command = (mode == driving).then_some(DriveCommand {
            rear_speed: speed,
            steering,
            pose_time: Time(START + 6 * MS),
            brake: false,
        });
        assert_eq!(output.command, command);
    }
}

#[test]
fn the_metadata_name_the_files_and_the_wall_time_of_the_first_row() {
    let imported = imported(FULL_LOG, FULL_MAP);
    let version = env!("CARGO_PKG_VERSION");
    let meta = &imported.meta;
    assert_eq!(
        meta.configuration,
        format!(
            "# Imported by singletrack import {version} from log.csv with map.toml: no configuration\n"
        )
    );
    assert_eq!(meta.software["singletrack-import"], version);
    assert_eq!(meta.protocol_version, singletrack_protocol::VERSION);
    assert_eq!(meta.seed, None);
    let start = ClockMapping {
        monotonic_ns: START,
        wall_ns: 1_700_000_000_000 * MS,
    };
    assert_eq!(meta.start, start);
}

#[test]
fn a_log_without_unix_time_driving_and_speed_command_is_driven_from_its_start() {
    let log = "t,x,y,yaw,v,s\n-3.5,0,0,0,1,0\n-3.49,0,0,0,1,1\n";
    let imported = imported(log, MAP);
    assert_eq!(imported.meta.start.wall_ns, 0);
    for tick in imported.ticks() {
        assert_eq!(tick.output.mode, Mode::Driving);
        assert_eq!(tick.output.actuation.speed, 0.0);
        assert_eq!(tick.output.command, None);
    }
    let states: Vec<_> = imported.board().iter().map(|sample| sample.state).collect();
    assert_eq!(states, [BoardState::Driving; 2]);
}

#[test]
fn the_period_of_the_ticks_is_that_of_the_map() {
    let log = "t,x,y,yaw,v,s\n0,0,0,0,1,0\n0.1,0,0,0,1,1\n";
    let map = format!("tick_ms = 40\n{MAP}");
    let times: Vec<_> = imported(log, &map).steering();
    assert_eq!(times, [(0.0, 0.0), (40.0, 0.0), (80.0, 0.0), (120.0, 0.5)]);
}

#[test]
fn the_same_log_and_map_give_the_same_bytes() {
    let bench = Bench::new(FULL_LOG, FULL_MAP);
    bench.import("a.mcap").unwrap();
    bench.import("b.mcap").unwrap();
    let elsewhere = Bench::new(FULL_LOG, FULL_MAP);
    elsewhere.import("c.mcap").unwrap();
    let first = fs::read(bench.path("a.mcap")).unwrap();
    assert!(first == fs::read(bench.path("b.mcap")).unwrap());
    assert!(first == fs::read(elsewhere.path("c.mcap")).unwrap());
}

#[test]
fn the_summary_counts_what_was_made_and_names_the_largest_gaps() {
    let imported = imported(FULL_LOG, FULL_MAP);
    assert_eq!(
        imported.summary.to_string(),
        "0.03 s, 2 poses and 1 not finite and 1 not tracked, 4 board samples of 4 of the IMU and 4 of \
         the motor, 4 ticks; largest gaps: poses 0.010 s at 0.000 s, IMU 0.010 s at -0.002 s, \
         motor 0.010 s at -0.002 s, board samples 0.010 s at -0.002 s"
    );
}
