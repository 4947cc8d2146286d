//! How fast records are printed: a minute of driving at 100 Hz, as records a
//! second, on one core.

#![allow(clippy::disallowed_methods, reason = "a benchmark repeats no bits")]
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a bench may fail")]

use std::{collections::BTreeMap, io, path::Path, time::Duration};

use clap::Parser;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use singletrack::operator::dump::{DumpArgs, Format, dump};
use singletrack_control::{
    Actuation, Covariance, Estimate, InertialSample, PoseSample, Position, ReferencePoint, Time,
    Velocity,
};
use singletrack_pilot::{BoardSample, BoardState, DriveCommand, Event, Filtering, Mode, Output};
use singletrack_protocol::{BoardMode, ImuState, Sequence, StopCause, Telemetry};
use singletrack_record::{
    ClockMapping, DriveWrite, Entry, LinkPhase, Meta, Recorder, TelemetryRecord, TickRecord,
};

const TICKS: u64 = 6_000;
const START_NS: u64 = 120_000_000_000;
const PERIOD_NS: u64 = 10_000_000;

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    dump: DumpArgs,
}

/// A number that has all of its digits, as measured ones do.
fn noisy(index: u64, scale: f64) -> f64 {
    scale * (1.0 + index as f64).sin()
}

fn tick(index: u64) -> Entry {
    let now = START_NS + PERIOD_NS * index;
    let pose_time = Time(now - 8_000_000);
    let position = Position::new(noisy(index, 1.0), noisy(index + 1, 1.0));
    let velocity = Velocity::new(noisy(index + 2, 0.5), noisy(index + 3, 0.5));
    Entry::Tick(TickRecord {
        index,
        scheduled_ns: now,
        start_ns: now + 60_000 + index % 977,
        finish_ns: now + 95_000 + index % 991,
        skipped: 0,
        pilot_time: Time(now),
        events: [
            Event::Pose(PoseSample {
                capture: pose_time,
                receive: Time(now - 500_000),
                frame: index as i32,
                position,
                yaw: noisy(index + 4, 3.0),
            }),
            Event::Board(BoardSample {
                time: Time(now - 1_000_000),
                inertial: Some(InertialSample {
                    time: Time(now - 2_000_000),
                    yaw_rate: noisy(index + 5, 0.5),
                    forward_acceleration: noisy(index + 6, 0.1),
                    left_acceleration: noisy(index + 7, 0.2),
                }),
                motor_speed: 0.393,
                state: BoardState::Driving,
            }),
        ]
        .into_iter()
        .collect(),
        events_dropped: 0,
        output: Output {
            mode: Mode::Driving,
            reason: None,
            estimate: Some(Estimate {
                time: Time(now),
                position,
                yaw: noisy(index + 8, 30.0),
                yaw_rate: noisy(index + 9, 0.5),
                sideslip: noisy(index + 10, 1e-3),
                speed: noisy(index + 11, 0.4),
                pose_time,
            }),
            covariance: Some(Covariance {
                pose: [noisy(index + 12, 1e-6); 6],
                twist: [noisy(index + 13, 1e-4); 6],
            }),
            held: false,
            drive_time: Some(index as f64 * 0.01),
            reference: Some(ReferencePoint {
                position: Some(position),
                velocity,
            }),
            point: Some(position),
            point_velocity: Some(velocity),
            actuation: Actuation {
                speed: noisy(index + 12, 0.4),
                steering: noisy(index + 13, 0.3),
                steering_rate: noisy(index + 14, 0.1),
            },
            turning_round: false,
            looked_ahead: None,
            path: None,
            slowed_by: None,
            command: Some(DriveCommand {
                rear_speed: noisy(index + 15, 0.4),
                steering: noisy(index + 16, 0.3),
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
        drive: Some(DriveWrite {
            sequence: index as u8,
            written: true,
            time_ns: now + 92_000,
        }),
        link: LinkPhase::Ready,
    })
}

fn telemetry(index: u64) -> Entry {
    let now = START_NS + PERIOD_NS * index;
    let scaled = |offset: u64, scale: f64| noisy(index + offset, scale) as i16;
    Entry::Telemetry(TelemetryRecord {
        receive_time_ns: now + 4_100_000 + index % 983,
        board_time_host_ns: now,
        imu_time_host_ns: Some(now - 1_200_000),
        telemetry: Telemetry {
            board_time_us: (now / 1_000) as u32,
            mode: BoardMode::Driving,
            stop_cause: StopCause::None,
            last_sequence: Sequence(index as u8),
            imu: ImuState::Fresh,
            imu_age_100us: 12,
            linear_acceleration_mm_s2: [scaled(0, 90.0), scaled(1, 190.0), scaled(2, 9.0)],
            angular_velocity_mrad_s: [scaled(3, 9.0), scaled(4, 9.0), scaled(5, 500.0)],
            attitude_q14: [16_384, scaled(6, 99.0), scaled(7, 99.0), scaled(8, 999.0)],
            motor_speed_mm_s: scaled(9, 400.0),
            servo_us: 1_604,
            esc_us: 1_561,
        },
    })
}

fn record(path: &Path) {
    let meta = Meta {
        configuration: String::new(),
        software: BTreeMap::new(),
        protocol_version: 1,
        seed: None,
        start: ClockMapping {
            monotonic_ns: START_NS,
            wall_ns: 1_780_000_000_000_000_000,
        },
    };
    let mut recorder = Recorder::create(path, &meta).unwrap();
    for index in 0..TICKS {
        recorder.write(&telemetry(index)).unwrap();
        recorder.write(&tick(index)).unwrap();
    }
    recorder.finish().unwrap();
}

fn dumps(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    record(&path);
    let source = path.to_str().expect("a name in UTF-8");
    let mut group = criterion.benchmark_group("dump");
    group.measurement_time(Duration::from_secs(5));
    for (name, arguments, format, records) in [
        ("ticks, csv", &["--topic=tick"][..], Format::Csv, TICKS),
        ("telemetry, csv", &["--topic=telemetry"], Format::Csv, TICKS),
        (
            "both, csv",
            &["--topic=tick,telemetry"],
            Format::Csv,
            2 * TICKS,
        ),
        ("ticks, json", &["--topic=tick"], Format::Json, TICKS),
        (
            "ticks, three fields of few, csv",
            &[
                "--topic=tick",
                "--fields=tick,mode,lateness_ns",
                "--where=lateness_ns>60900",
            ],
            Format::Csv,
            TICKS,
        ),
        ("all, counted", &["--stats"], Format::Table, 2 * TICKS),
    ] {
        let arguments = [&["dump", source], arguments].concat();
        let args = Cli::parse_from(arguments).dump;
        group.throughput(Throughput::Elements(records));
        group.bench_function(name, |bencher| {
            bencher.iter(|| dump(&args, format, false, io::sink()).unwrap());
        });
    }
    group.finish();
}

criterion_group!(benches, dumps);
criterion_main!(benches);
