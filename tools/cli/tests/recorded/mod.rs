//! Records of drives that are known to the digit.

#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::panic,
    reason = "not every test uses all of it, and a test may fail"
)]

use std::{collections::BTreeMap, f64::consts::TAU, path::Path};

use singletrack_control::{
    Actuation, Estimate, InertialSample, Position, ReferencePoint, Time, VehicleParameters,
    Velocity,
};
use singletrack_core::config::{LawKind, LawSection, OuterLoopSection, ReferenceSection, Start};
use singletrack_pilot::{
    BoardSample, BoardState, DriveCommand, Event, Filtering, Mode, Output, PoseMissing, Reason,
};
use singletrack_record::{
    ClockMapping, ConfigurationRecord, DriveWrite, Entry, Level, LinkPhase, Log, Meta, Recorder,
    TickRecord,
};
use singletrack_scenario::simulated::{Drive, daemon_config};

/// The control period, in ns.
pub(crate) const PERIOD_NS: u64 = 10_000_000;
/// When the first tick of a record is scheduled.
pub(crate) const BEGIN_NS: u64 = 50_000_000_000;
/// The circle of the reference, and the one that P drives on, in m.
pub(crate) const RADIUS: f64 = 1.0;
pub(crate) const DRIVEN_RADIUS: f64 = 0.9;
/// In rad/s.
pub(crate) const ANGULAR_VELOCITY: f64 = 0.5;
/// How far P is behind, in rad.
pub(crate) const LAG: f64 = 0.4;

/// What a record is about.
#[derive(Clone, Debug)]
pub(crate) struct Script {
    /// For how long the car drives, in ticks, one drive after the other.
    pub(crate) drives: Vec<u64>,
    /// Ticks of each drive in which no pose comes.
    pub(crate) lost: std::ops::Range<u64>,
    /// Whether the reference is a velocity alone.
    pub(crate) velocity_only: bool,
    /// Whether the pilot has an estimate.
    pub(crate) estimate: bool,
    /// A line of the log.
    pub(crate) log: String,
    /// Another p from the second drive on, in m.
    pub(crate) other_distance: Option<f64>,
    /// Whether the record is finished.
    pub(crate) finished: bool,
}

impl Default for Script {
    fn default() -> Self {
        Self {
            drives: vec![1_000],
            lost: 200..220,
            velocity_only: false,
            estimate: true,
            log: "all is well".to_owned(),
            other_distance: None,
            finished: true,
        }
    }
}

/// Ticks of standing before each drive, and of stopping after it.
pub(crate) const STANDING: u64 = 50;
pub(crate) const STOPPING: u64 = 20;

/// Where P is `time` seconds after the first driving tick.
pub(crate) fn point(time: f64) -> [f64; 2] {
    let phase = ANGULAR_VELOCITY * time - LAG;
    [DRIVEN_RADIUS * phase.cos(), DRIVEN_RADIUS * phase.sin()]
}

/// Where it should be.
pub(crate) fn reference(time: f64) -> [f64; 2] {
    let phase = ANGULAR_VELOCITY * time;
    [RADIUS * phase.cos(), RADIUS * phase.sin()]
}

/// Writes the record.
pub(crate) fn write(path: &Path, script: &Script) {
    let config = daemon_config(Drive {
        vehicle: VehicleParameters::paper(),
        law: LawSection {
            kind: LawKind::FrontPoint,
            point_distance_m: 0.35,
            front_axle_distance_m: 0.1368,
        },
        outer_loop: OuterLoopSection::Proportional {
            gain_per_s: [1.0, 1.0],
            feed_forward: false,
        },
        reference: ReferenceSection::Circle {
            radius_m: RADIUS,
            angular_velocity_rad_s: ANGULAR_VELOCITY,
            centre_m: [0.0, 0.0],
            start: Start::Beginning,
        },
    });
    let meta = Meta {
        configuration: config.to_toml().unwrap(),
        software: BTreeMap::from([("singletrackd".to_owned(), "0.1.0".to_owned())]),
        protocol_version: 1,
        seed: Some(7),
        start: ClockMapping {
            monotonic_ns: BEGIN_NS,
            wall_ns: 1_700_000_000_000_000_000,
        },
    };
    let mut recorder = Recorder::create(path, &meta).unwrap();
    recorder
        .write(&Entry::Log(Log {
            time_ns: BEGIN_NS,
            level: Level::Warning,
            text: script.log.clone(),
        }))
        .unwrap();
    for tick in ticks(script) {
        let time_ns = tick.finish_ns;
        let reconfigured = tick.events.contains(&Event::Reconfigured(2));
        recorder.write(&Entry::Tick(tick)).unwrap();
        if let (true, Some(distance)) = (reconfigured, script.other_distance) {
            let mut config = config.clone();
            config.law.point_distance_m = distance;
            let entry = ConfigurationRecord {
                time_ns,
                number: 2,
                toml: config.to_toml().unwrap(),
            };
            recorder.write(&Entry::Configuration(entry)).unwrap();
        }
    }
    if script.finished {
        recorder.finish().unwrap();
    } else {
        recorder.flush().unwrap();
        // As if the process had been killed: dropped, it would complete the file.
        std::mem::forget(recorder);
    }
}

/// All ticks of a script.
pub(crate) fn ticks(script: &Script) -> Vec<TickRecord> {
    let mut index = 0;
    let mut ticks = Vec::new();
    for (drive, driving) in script.drives.iter().enumerate() {
        for number in 0..STANDING {
            let mut tick = tick(index, script, None);
            if drive == 1 && number == 10 && script.other_distance.is_some() {
                let _ = tick.events.push(Event::Reconfigured(2));
            }
            ticks.push(tick);
            index += 1;
        }
        for number in 0..driving + STOPPING {
            ticks.push(tick(index, script, Some((number, *driving))));
            index += 1;
        }
    }
    ticks.push(tick(index, script, None));
    ticks
}

/// The tick `index` of the record; `driving` says which of the drive it is, and how
/// many ticks that drives.
fn tick(index: u64, script: &Script, driving: Option<(u64, u64)>) -> TickRecord {
    let scheduled_ns = BEGIN_NS + index * PERIOD_NS;
    // Every hundredth tick is late.
    let start_ns = scheduled_ns + if index % 100 == 99 { 2_000_000 } else { 60_000 };
    let pilot_time = Time(scheduled_ns);
    let number = driving.map(|(number, _)| number);
    let time = number.map(|number| number as f64 * PERIOD_NS as f64 * 1e-9);
    let held = number.is_some_and(|number| script.lost.contains(&number));
    let mode = match driving {
        None => Mode::Ready,
        Some((number, driving)) if number < driving => Mode::Driving,
        Some(_) => Mode::Stopping,
    };
    let [x, y] = point(time.unwrap_or(0.0));
    let [reference_x, reference_y] = reference(time.unwrap_or(0.0));
    let velocity = Velocity::new(-0.5 * reference_y, 0.5 * reference_x);
    let board = BoardSample {
        time: Time(scheduled_ns - 2_000_000),
        inertial: Some(InertialSample {
            time: Time(scheduled_ns - 3_000_000),
            yaw_rate: ANGULAR_VELOCITY,
            forward_acceleration: 0.0,
            left_acceleration: 0.2,
        }),
        motor_speed: 0.39,
        state: BoardState::Driving,
    };
    let mut events = heapless_events([Event::Board(board)]);
    if held {
        let _ = events.push(Event::PoseMissing(PoseMissing::Untracked));
    }
    let is_driving = mode == Mode::Driving;
    let pose_time = Time(start_ns - 12_000_000);
    TickRecord {
        index,
        scheduled_ns,
        start_ns,
        finish_ns: start_ns + 40_000,
        skipped: 0,
        pilot_time,
        events,
        events_dropped: 0,
        output: Output {
            mode,
            reason: (mode == Mode::Stopping).then_some(Reason::Requested),
            estimate: script.estimate.then(|| Estimate {
                time: pilot_time,
                position: Position::new(x - 0.4, y),
                yaw: time.unwrap_or(0.0) * ANGULAR_VELOCITY % TAU,
                yaw_rate: ANGULAR_VELOCITY,
                sideslip: 0.15,
                speed: 0.4,
                pose_time,
            }),
            covariance: None,
            held,
            drive_time: time,
            reference: is_driving.then(|| ReferencePoint {
                position: (!script.velocity_only).then(|| Position::new(reference_x, reference_y)),
                velocity,
            }),
            point: script.estimate.then(|| Position::new(x, y)),
            point_velocity: is_driving.then_some(velocity),
            actuation: Actuation {
                speed: 0.41,
                steering: 0.33,
                steering_rate: 0.0,
            },
            turning_round: false,
            looked_ahead: None,
            path: None,
            slowed_by: None,
            command: time.map(|_| DriveCommand {
                rear_speed: 0.4,
                steering: 0.33,
                pose_time,
                brake: false,
            }),
            request: None,
            proved: false,
            disproved: false,
            braking_measured: None,
            setpoint_refused: None,
            filtering: Filtering::None,
            filtered_ticks: 0,
            tuned: None,
            setpoint: None,
            preflight: None,
            jog: None,
        },
        drive: time.map(|_| DriveWrite {
            sequence: index as u8,
            written: true,
            time_ns: start_ns + 30_000,
        }),
        link: LinkPhase::Ready,
    }
}

/// The events of a tick.
fn heapless_events<const N: usize>(events: [Event; N]) -> singletrack_core::controller::Events {
    events.into_iter().collect()
}
