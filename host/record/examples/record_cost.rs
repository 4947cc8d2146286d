//! What a record of ten minutes costs: on the thread that tells what happens, on
//! the thread that writes, and on the disk.
//!
//! ```text
//! cargo run --release -p singletrack-record --example record_cost [FOLDER]
//! ```
//!
//! 100 ticks a second with all their parts, 100 poses, 100 telemetry records and
//! 5 status records, in virtual time: as fast as the writer can.

use std::{
    collections::BTreeMap,
    error::Error,
    fs,
    hint::black_box,
    path::PathBuf,
    thread,
    time::{Duration, Instant},
};

use singletrack_control::{
    Actuation, BoardSample, BoardState, DriveCommand, Estimate, Event, InertialSample, Mode,
    Output, PoseSample, Position, ReferencePoint, Time, Velocity,
};
use singletrack_mocap::{CaptureTimeSource, Observation, Pose, PoseState};
use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, ResetCause, Sequence, Status, StopCause, Telemetry,
};
use singletrack_record::{
    ClockMapping, DriveWrite, Encoder, Entry, LinkPhase, Meta, Recorder, StatusRecord,
    TelemetryRecord, TickRecord, tick_feed,
};

const SECONDS: u64 = 600;
const RATE: u64 = 100;
const PERIOD_NS: u64 = 10_000_000;
const STATUS_EVERY: u64 = 20;
/// Ticks that the daemon's ring holds.
const RING: usize = 256;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).map_or_else(
        || std::env::temp_dir().join(format!("record-cost-{}", std::process::id())),
        PathBuf::from,
    );
    fs::create_dir_all(&folder)?;
    println!(
        "a tick is {} bytes in memory, an entry {}",
        size_of::<TickRecord>(),
        size_of::<Entry>()
    );
    println!("\nto hand over, ns           p50      p99    p99.9      max");
    pushes();
    encoder()?;
    println!("\nto write, us               p50      p99    p99.9      max");
    let path = folder.join("cost.mcap");
    let bytes = writer(&path)?;
    let entries = SECONDS * (3 * RATE + RATE / STATUS_EVERY);
    println!(
        "\n{} s: {entries} entries, {:.1} MB, {:.0} bytes an entry",
        SECONDS,
        bytes as f64 / 1e6,
        bytes as f64 / entries as f64
    );
    fs::remove_file(&path)?;
    // Not if it was there before, with something in it.
    let _ = fs::remove_dir(&folder);
    Ok(())
}

/// What a thread pays to push to a ring that another one empties: the control
/// thread its ticks, the collector its entries.
fn pushes() {
    // What the clock and the machine's other tenants cost.
    measure_pushes("nothing", false, |_| (Instant::now().elapsed(), true));
    for cold in [false, true] {
        let (mut input, mut output) = tick_feed(RING);
        let emptying = thread::spawn(move || {
            while !output.is_abandoned() {
                while let Some(tick) = output.pop() {
                    black_box(&tick);
                }
                thread::sleep(Duration::from_millis(1));
            }
        });
        let name = if cold { "tick, cold caches" } else { "tick" };
        measure_pushes(name, cold, |index| {
            let tick = tick(index);
            let start = Instant::now();
            let pushed = input.push(&tick);
            (start.elapsed(), pushed)
        });
        drop(input);
        // It ends when the ring is left alone.
        let _ = emptying.join();
    }
}

fn measure_pushes(name: &str, cold: bool, mut push: impl FnMut(u64) -> (Duration, bool)) {
    let mut took = Durations::default();
    let mut elsewhere = vec![0_u8; if cold { 4 << 20 } else { 0 }];
    let count = if cold { 10_000 } else { SECONDS * RATE };
    for index in 0..count {
        for byte in elsewhere.iter_mut().step_by(64) {
            *byte = byte.wrapping_add(1);
        }
        let (duration, pushed) = push(index);
        if pushed {
            took.0.push(duration);
        } else {
            thread::sleep(Duration::from_millis(2));
        }
    }
    black_box(&elsewhere);
    took.print(name, 1.0);
}

/// What it takes to make an entry's messages.
fn encoder() -> Result<(), Box<dyn Error>> {
    println!("\nto encode, us              p50      p99    p99.9      max");
    let mut encoder = Encoder::new(meta().start);
    let mut took = Durations::default();
    let (mut messages, mut bytes) = (0, 0);
    for index in 0..SECONDS * RATE {
        let entry = Entry::Tick(tick(index));
        let start = Instant::now();
        for publication in encoder.encode(&entry)? {
            messages += 1;
            bytes += publication.bytes.len();
        }
        took.0.push(start.elapsed());
    }
    took.print("tick", 1e3);
    let ticks = (SECONDS * RATE) as f64;
    println!(
        "{:.1} messages, {:.0} bytes a tick",
        f64::from(messages) / ticks,
        bytes as f64 / ticks
    );
    Ok(())
}

/// What the writing thread pays; the file's length.
fn writer(path: &std::path::Path) -> Result<u64, Box<dyn Error>> {
    let mut recorder = Recorder::create(path, &meta())?;
    let [mut ticks, mut others, mut flushes] = [const { Durations(Vec::new()) }; 3];
    for index in 0..SECONDS * RATE {
        let mut entries = vec![
            Entry::Pose(pose(index)),
            Entry::Telemetry(telemetry(index)),
            Entry::Tick(tick(index)),
        ];
        if index.is_multiple_of(STATUS_EVERY) {
            entries.push(Entry::Status(status(index)));
        }
        for entry in &entries {
            let start = Instant::now();
            recorder.write(entry)?;
            let took = start.elapsed();
            match entry {
                Entry::Tick(_) => ticks.0.push(took),
                _ => others.0.push(took),
            }
        }
        if index.is_multiple_of(RATE) {
            let start = Instant::now();
            recorder.flush()?;
            flushes.0.push(start.elapsed());
        }
    }
    ticks.print("tick", 1e3);
    others.print("other entry", 1e3);
    flushes.print("flush and sync, a second", 1e3);
    let written = ticks.sum() + others.sum() + flushes.sum();
    let finished = recorder.finish()?;
    println!(
        "{:.1} s in all: {:.2} % of a processor",
        written.as_secs_f64(),
        written.as_secs_f64() / SECONDS as f64 * 100.0
    );
    Ok(finished.bytes)
}

#[derive(Default)]
struct Durations(Vec<Duration>);

impl Durations {
    fn sum(&self) -> Duration {
        self.0.iter().sum()
    }

    fn print(&mut self, name: &str, unit_ns: f64) {
        self.0.sort_unstable();
        let last = self.0.len().saturating_sub(1);
        let at = |part: f64| {
            let index = (last as f64 * part) as usize;
            let duration = self.0.get(index).copied().unwrap_or_default();
            duration.as_nanos() as f64 / unit_ns
        };
        let [p50, p99, p999, max] = [0.5, 0.99, 0.999, 1.0].map(at);
        println!("{name:24}{p50:>8.1} {p99:>8.1} {p999:>8.1} {max:>8.1}");
    }
}

fn meta() -> Meta {
    Meta {
        configuration: String::new(),
        software: BTreeMap::new(),
        protocol_version: singletrack_protocol::VERSION,
        seed: Some(1),
        start: ClockMapping {
            monotonic_ns: 0,
            wall_ns: 1_780_000_000_000_000_000,
        },
    }
}

/// Digits that no compression foretells, as measurements have: -0.5 to 0.5.
fn noise(index: u64, which: u64) -> f64 {
    let mut bits = (index * 64 + which).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits ^= bits >> 32;
    bits = bits.wrapping_mul(0xd6e8_feb8_6659_fd93);
    bits ^= bits >> 32;
    (bits >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
}

/// The car on the paper's circle.
struct Car {
    time_ns: u64,
    angle: f64,
    index: u64,
}

impl Car {
    fn at(index: u64) -> Self {
        let time_ns = index * PERIOD_NS + (noise(index, 0).abs() * 1e5) as u64;
        Self {
            time_ns,
            angle: time_ns as f64 * 0.5e-9,
            index,
        }
    }

    fn position(&self, which: u64) -> Position {
        let (sin, cos) = self.angle.sin_cos();
        Position::new(
            0.8 * cos + 1e-3 * noise(self.index, which),
            0.8 * sin + 1e-3 * noise(self.index, which + 1),
        )
    }

    fn yaw(&self) -> f64 {
        self.angle + 1.5 + 1e-3 * noise(self.index, 9)
    }
}

fn tick(index: u64) -> TickRecord {
    let car = Car::at(index);
    let now = car.time_ns;
    let capture = Time(now.saturating_sub(6_000_000));
    let pose = Event::Pose(PoseSample {
        capture,
        receive: Time(now.saturating_sub(2_000_000)),
        frame: index as i32,
        position: car.position(1),
        yaw: car.yaw(),
    });
    let board = Event::Board(BoardSample {
        time: Time(now.saturating_sub(4_000_000)),
        inertial: Some(InertialSample {
            time: Time(now.saturating_sub(5_000_000)),
            yaw_rate: 0.5 + 1e-2 * noise(index, 3),
            forward_acceleration: 1e-1 * noise(index, 4),
            left_acceleration: 0.2 + 1e-1 * noise(index, 5),
        }),
        motor_speed: 0.4 + 1e-2 * noise(index, 6),
        state: BoardState::Driving,
    });
    TickRecord {
        index,
        scheduled_ns: index * PERIOD_NS,
        start_ns: now,
        finish_ns: now + 60_000,
        skipped: 0,
        pilot_time: Time(now),
        events: [pose, board].into_iter().collect(),
        events_dropped: 0,
        output: Output {
            mode: Mode::Driving,
            reason: None,
            estimate: Some(Estimate {
                time: Time(now),
                position: car.position(7),
                yaw: car.yaw(),
                yaw_rate: 0.5 + 1e-3 * noise(index, 10),
                sideslip: 0.15 + 1e-3 * noise(index, 11),
                speed: 0.4 + 1e-3 * noise(index, 12),
                pose_time: capture,
            }),
            held: false,
            drive_time: Some(now as f64 * 1e-9),
            reference: Some(ReferencePoint {
                position: Some(Position::new(car.angle.cos(), car.angle.sin())),
                velocity: Velocity::new(-0.5 * car.angle.sin(), 0.5 * car.angle.cos()),
            }),
            point: Some(car.position(13)),
            point_velocity: Some(Velocity::new(noise(index, 15), noise(index, 16))),
            actuation: Actuation {
                speed: 0.4 + 1e-3 * noise(index, 17),
                steering: 0.33 + 1e-3 * noise(index, 18),
                steering_rate: 1e-2 * noise(index, 19),
            },
            turning_round: false,
            command: Some(DriveCommand {
                rear_speed: 0.4 + 1e-3 * noise(index, 20),
                steering: 0.33 + 1e-3 * noise(index, 21),
                pose_time: capture,
            }),
            request: None,
        },
        drive: Some(DriveWrite {
            sequence: index as u8,
            written: true,
            time_ns: now + 55_000,
        }),
        link: LinkPhase::Ready,
    }
}

fn pose(index: u64) -> Observation {
    let car = Car::at(index);
    let position = car.position(22);
    Observation {
        frame_number: index as i32,
        receive_time_ns: car.time_ns,
        state: PoseState::Valid(Pose {
            x_m: position.x,
            y_m: position.y,
            z_m: 0.05 + 1e-4 * noise(index, 24),
            yaw_rad: car.yaw(),
            tilt_rad: 1e-2 * noise(index, 25).abs(),
            capture_time_ns: car.time_ns.saturating_sub(4_000_000),
            capture_uncertainty_ns: 100_000,
            capture_source: CaptureTimeSource::MidExposureEcho,
            receive_time_ns: car.time_ns,
            frame_number: index as i32,
            mean_error_m: 1e-3 * noise(index, 26).abs(),
            reacquired: false,
        }),
    }
}

fn telemetry(index: u64) -> TelemetryRecord {
    let car = Car::at(index);
    let small = |which| (noise(index, which) * 200.0) as i16;
    TelemetryRecord {
        receive_time_ns: car.time_ns,
        board_time_host_ns: car.time_ns.saturating_sub(4_000_000),
        imu_time_host_ns: Some(car.time_ns.saturating_sub(5_000_000)),
        telemetry: Telemetry {
            board_time_us: (car.time_ns / 1_000) as u32,
            mode: BoardMode::Driving,
            stop_cause: StopCause::None,
            last_sequence: Sequence(index as u8),
            imu: ImuState::Fresh,
            imu_age_100us: 10,
            linear_acceleration_mm_s2: [small(27), 200 + small(28), small(29)],
            angular_velocity_mrad_s: [small(30), small(31), 500 + small(32)],
            attitude_q14: [16_000 + small(33), small(34), small(35), small(36)],
            motor_speed_mm_s: 400 + small(37),
            servo_us: 1_600,
            esc_us: 1_560,
        },
    }
}

fn status(index: u64) -> StatusRecord {
    StatusRecord {
        receive_time_ns: Car::at(index).time_ns,
        status: Status {
            board_time_us: (index * 10_000) as u32,
            configuration_hash: 0xdead_beef,
            reset_cause: ResetCause::PowerOn,
            stop_input_open: false,
            battery_mv: 7_400 + (noise(index, 38) * 100.0) as u16,
            frames_received: index as u16,
            frames_damaged: 0,
            drives_refused: 0,
            last_refusal: RefusalReason::None,
            frames_dropped: 0,
            bytes_overrun: 0,
            imu_errors: 0,
        },
    }
}
