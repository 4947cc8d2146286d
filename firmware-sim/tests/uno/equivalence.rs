//! The native board and the image get the same minute of bytes and sensor values,
//! and give the same frames and pulses.
//!
//! Changes are compared with a tolerance of one control period of 10 ms: here the
//! native board is polled every millisecond; the image polls every 10 ms, at once
//! for a frame, and reads its IMU every 5 or 10 ms.

use std::{
    collections::VecDeque,
    process::{Child, Command, Stdio},
};

use singletrack_board::{Board, ImuSample, Inputs, MotorPulses, Outputs};
use singletrack_protocol::{
    Arm, BoardMode, Configure, Decoder, Disarm, Drive, EmergencyStop, Hello, Jog, ResetCause,
    Sequence, Status, StopCause, Telemetry, ToBoard, ToHost, UNNAMED, VERSION,
};
use singletrack_sim::{CYCLES_PER_US, Installation, default_board_configuration};
use singletrack_simavr::{Motion, Pin, Reply, Report, Request, ResetFlags, Run, receive, send};

const SECONDS: u64 = 60;

/// The image's first poll, the origin of its control periods.
const FIRST_POLL_MS: u64 = 5;

/// A byte at 115200 baud, in ns.
const BYTE_NS: u64 = 86_806;

/// Inputs of one millisecond.
#[derive(Default)]
struct Millisecond {
    /// Bytes with their arrival times, in µs.
    bytes: Vec<(u64, u8)>,
    /// Motor edges, in µs.
    edges: Vec<u64>,
    motion: Option<Motion>,
    stop_input_open: bool,
}

/// A script of host and car.
struct Script {
    sequence: Sequence,
    line: VecDeque<u8>,
    line_free_ns: u64,
    travel_um: f64,
}

impl Script {
    /// Driving times; in between, the car stands and is armed again.
    fn driving_ms(ms: u64) -> Option<u64> {
        (ms >= 4_000)
            .then_some(ms % 8_000)
            .filter(|at| (1_000..6_000).contains(at))
    }

    fn send(&mut self, ms: u64, message: &ToBoard, damage: bool) {
        let frame = message.encode();
        let mut bytes = frame.as_bytes().to_vec();
        if damage && let Some(byte) = bytes.get_mut((ms % 11) as usize + 1) {
            *byte ^= 0x10;
        }
        self.line_free_ns = self.line_free_ns.max(ms * 1_000_000);
        self.line.extend(bytes);
    }

    fn host(&mut self, ms: u64, telemetry_time_us: u32) {
        let configuration = default_board_configuration();
        let span = ms % 8_000;
        match (ms, span) {
            (200, _) => self.send(
                ms,
                &ToBoard::Hello(Hello {
                    protocol_version: VERSION,
                    software_version: [0, 1, 0],
                    nonce: 9,
                }),
                false,
            ),
            (250, _) => {
                let request = self.sequence.next();
                self.sequence = request;
                self.send(
                    ms,
                    &ToBoard::Configure(Configure {
                        request,
                        configuration,
                    }),
                    false,
                );
            }
            // While driving, and finally.
            (58_000, _) => {
                self.sequence = self.sequence.next();
                let request = self.sequence;
                self.send(
                    ms,
                    &ToBoard::EmergencyStop(EmergencyStop { request }),
                    false,
                );
            }
            // The first one is refused: neutral has not lasted long enough.
            (_, 900) => {
                self.sequence = self.sequence.next();
                let arm = Arm {
                    request: self.sequence,
                    configuration_hash: configuration.hash(),
                    telemetry_time_us,
                };
                self.send(ms, &ToBoard::Arm(arm), false);
            }
            (_, 6_500) => {
                self.sequence = self.sequence.next();
                let request = self.sequence;
                self.send(ms, &ToBoard::Disarm(Disarm { request }), false);
            }
            _ => {}
        }
        if let Some(at) = Self::driving_ms(ms)
            && ms % 10 == 3
        {
            self.sequence = self.sequence.next();
            let seconds = at as f64 * 1e-3;
            // Occasionally stale.
            let age_us = if at % 700 < 20 { 200_000 } else { 0 };
            let telemetry_time_us = telemetry_time_us.wrapping_sub(age_us);
            // Every third time it jogs.
            let command = if ms / 8_000 % 3 == 2 {
                ToBoard::Jog(Jog {
                    sequence: self.sequence,
                    telemetry_time_us,
                    servo_us: (1_500.0 + 600.0 * libm::sin(2.1 * seconds)) as u16,
                    esc_us: (1_500.0 + 200.0 * libm::sin(1.3 * seconds)) as u16,
                })
            } else {
                ToBoard::Drive(Drive {
                    sequence: self.sequence,
                    speed_mm_s: (400.0 + 150.0 * libm::sin(1.3 * seconds)) as i16,
                    steering_100urad: (3_000.0 * libm::sin(2.1 * seconds)) as i16,
                    telemetry_time_us,
                    pose_age_ms: 12,
                    brake: false,
                })
            };
            // Every ninth is corrupted.
            self.send(ms, &command, (ms / 10).is_multiple_of(9));
        }
    }

    fn next(&mut self, ms: u64, telemetry_time_us: u32) -> Millisecond {
        self.host(ms, telemetry_time_us);
        let mut now = Millisecond::default();
        // Bytes that arrive within this millisecond.
        while !self.line.is_empty() && self.line_free_ns + BYTE_NS <= (ms + 1) * 1_000_000 {
            self.line_free_ns += BYTE_NS;
            if let Some(byte) = self.line.pop_front() {
                now.bytes.push((self.line_free_ns / 1_000, byte));
            }
        }
        let speed_um_ms = match Self::driving_ms(ms) {
            Some(at) if at > 150 => 420.0 + 120.0 * libm::sin(at as f64 * 1.1e-3),
            _ => 0.0,
        };
        let before = self.travel_um;
        self.travel_um += speed_um_ms;
        if self.travel_um >= 3_000.0 {
            self.travel_um -= 3_000.0;
            let part = (3_000.0 - before) / speed_um_ms;
            now.edges.push(ms * 1_000 + (part * 1_000.0) as u64);
        }
        // The sensor takes a second to start and to be configured.
        if ms % 10 == 6 && ms > 1_500 {
            // Values that the sensor's units represent exactly.
            let wave = |rate: f64, size: f64| (size * libm::sin(rate * ms as f64 * 1e-3)) as i16;
            now.motion = Some(Motion {
                linear_acceleration_mm_s2: [
                    wave(2.0, 150.0) * 10,
                    wave(3.0, 120.0) * 10,
                    (ms / 10 % 7) as i16 * 10,
                ],
                angular_velocity_mrad_s: [
                    wave(1.0, 20.0) * 10,
                    wave(1.7, 30.0) * 10,
                    wave(0.7, 90.0) * 10,
                ],
                attitude_q14: [16_000, wave(0.3, 900.0), -200, wave(0.2, 3_000.0)],
            });
        }
        now.stop_input_open = ms > 30_000;
        now
    }
}

/// Frames with their times of completion, in µs.
#[derive(Default)]
struct Frames {
    decoder: Decoder,
    telemetry: Vec<Telemetry>,
    status: Vec<Status>,
    /// All other messages, as text.
    answers: Vec<String>,
}

impl Frames {
    fn take(&mut self, byte: u8) {
        match self.decoder.push(byte) {
            Some(Ok(packet)) => match ToHost::decode(packet).unwrap() {
                ToHost::Telemetry(telemetry) => self.telemetry.push(telemetry),
                ToHost::Status(status) => self.status.push(status),
                answer => self.answers.push(format!("{answer:?}")),
            },
            Some(Err(error)) => panic!("a corrupted frame: {error}"),
            None => {}
        }
    }
}

struct NativeBoard {
    board: Board,
    inputs: Inputs,
    frames: Frames,
    /// One for each millisecond.
    outputs: Vec<Outputs>,
}

impl NativeBoard {
    fn run(&mut self, ms: u64, now: &Millisecond) {
        if ms + 1 < FIRST_POLL_MS {
            return;
        }
        for &edge_us in &now.edges {
            self.inputs.motor = MotorPulses {
                count: self.inputs.motor.count.wrapping_add(1),
                last_edge_us: edge_us as u32,
            };
        }
        if let Some(motion) = now.motion {
            self.inputs.imu = Some(ImuSample {
                time_us: (ms * 1_000) as u32,
                linear_acceleration_mm_s2: motion.linear_acceleration_mm_s2,
                angular_velocity_mrad_s: motion.angular_velocity_mrad_s,
                attitude_q14: motion.attitude_q14,
            });
        }
        self.inputs.battery_mv = 7_400;
        self.inputs.stop_input_open = now.stop_input_open;
        let bytes: Vec<u8> = now.bytes.iter().map(|&(_, byte)| byte).collect();
        let frames = &mut self.frames;
        // At the end of the millisecond, with all its inputs.
        let outputs = self.board.poll(
            ((ms + 1) * 1_000) as u32,
            &self.inputs,
            &bytes,
            &mut |frame: &[u8]| {
                for &byte in frame {
                    frames.take(byte);
                }
                true
            },
        );
        self.outputs.push(outputs);
    }
}

struct ImageBoard {
    child: Child,
    frames: Frames,
    pulses: Vec<singletrack_simavr::Pulse>,
    report: Report,
}

impl ImageBoard {
    fn start() -> Self {
        let installation = Installation::find().unwrap();
        let child = Command::new(installation.program)
            .arg(installation.image)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut image = Self {
            child,
            frames: Frames::default(),
            pulses: Vec::new(),
            report: Report::default(),
        };
        image.ask(&Request::Start(ResetFlags::POWER_ON));
        image
    }

    fn ask(&mut self, request: &Request) -> Reply {
        send(self.child.stdin.as_mut().unwrap(), request).unwrap();
        receive(self.child.stdout.as_mut().unwrap())
            .unwrap()
            .unwrap()
    }

    fn run(&mut self, ms: u64, now: &Millisecond) {
        let cycle = |us: u64| us * CYCLES_PER_US;
        let run = Run {
            until: cycle((ms + 1) * 1_000),
            received: now
                .bytes
                .iter()
                .map(|&(us, byte)| (cycle(us), byte))
                .collect(),
            motor_edges: now.edges.iter().map(|&us| cycle(us)).collect(),
            motion: now
                .motion
                .map(|motion| (cycle(ms * 1_000), motion))
                .into_iter()
                .collect(),
            battery_mv: 7_400,
            stop_input_open: now.stop_input_open,
            ..Run::default()
        };
        let Reply::Ran(report) = self.ask(&Request::Run(run)) else {
            panic!("no report");
        };
        assert_eq!(report.watchdog_reset, None, "{ms} ms");
        for &(_, byte) in &report.transmitted {
            self.frames.take(byte);
        }
        self.pulses.extend(&report.pulses);
        self.report = report;
    }
}

impl Drop for ImageBoard {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn run() -> (NativeBoard, ImageBoard) {
    let mut script = Script {
        sequence: Sequence(0),
        line: VecDeque::new(),
        line_free_ns: 0,
        travel_um: 0.0,
    };
    let mut native = NativeBoard {
        board: Board::new(ResetCause::PowerOn, [0, 1, 0], UNNAMED),
        inputs: Inputs::default(),
        frames: Frames::default(),
        outputs: Vec::new(),
    };
    let mut image = ImageBoard::start();
    for ms in 0..SECONDS * 1_000 {
        // The host knows what left the board 5 ms ago.
        let telemetry_time_us = native
            .frames
            .telemetry
            .iter()
            .rev()
            .find(|telemetry| u64::from(telemetry.board_time_us) + 5_000 <= ms * 1_000)
            .map_or(0, |telemetry| telemetry.board_time_us);
        let now = script.next(ms, telemetry_time_us);
        native.run(ms, &now);
        image.run(ms, &now);
    }
    (native, image)
}

/// The native records at an index and its neighbours.
fn around(records: &[Telemetry], index: usize) -> &[Telemetry] {
    let end = records.len().min(index + 2);
    &records[index.saturating_sub(1)..end]
}

#[test]
fn the_same_inputs_give_the_same_frames_and_pulses() {
    let (native, image) = run();

    // The script covers all modes.
    let modes = |mode| {
        native
            .frames
            .telemetry
            .iter()
            .filter(|t| t.mode == mode)
            .count()
    };
    for mode in [
        BoardMode::Boot,
        BoardMode::Neutral,
        BoardMode::Armed,
        BoardMode::Failsafe,
        BoardMode::EmergencyStopped,
    ] {
        assert!(modes(mode) > 5, "{mode:?}: {}", modes(mode));
    }
    assert!(modes(BoardMode::Driving) > 2_000);
    assert!(modes(BoardMode::Jogging) > 500);
    let last = native.frames.telemetry.last().unwrap();
    assert_ne!(last.stop_cause, StopCause::None);
    assert!(native.frames.status.last().unwrap().frames_damaged > 100);
    assert!(native.frames.status.last().unwrap().drives_refused > 20);

    // Answers: the same ones, in the same order.
    assert_eq!(image.frames.answers, native.frames.answers);
    assert_eq!(image.report.bytes_overrun, 0);

    telemetry_agrees(&native.frames.telemetry, &image.frames.telemetry);
    status_agrees(&native.frames.status, &image.frames.status);
    pulses_agree(&native.outputs, &image.pulses);
    pulses_follow_records(&image);
}

/// A pulse begins 0.4 ms after a multiple of 20 ms of the board's clock, and is as long as the
/// last record before it says: 5.4 ms before. What is measured of servo and ESC rests on this.
fn pulses_follow_records(image: &ImageBoard) {
    let records = &image.frames.telemetry;
    let mut changes = 0;
    let mut before_us = 0;
    for pulse in image.pulses.iter().filter(|pulse| pulse.pin == Pin::Servo) {
        let begin_us = pulse.start / CYCLES_PER_US;
        let width_us = pulse.width / CYCLES_PER_US;
        let last = records.partition_point(|record| u64::from(record.board_time_us) <= begin_us);
        let record = &records[last - 1];
        assert!((300..600).contains(&(begin_us % 20_000)), "{begin_us}");
        if (5_300..5_600).contains(&(begin_us - u64::from(record.board_time_us))) {
            assert!(
                width_us.abs_diff(record.servo_us.into()) <= 1,
                "{width_us} us at {begin_us} us, {record:?}"
            );
            changes += usize::from(width_us != before_us);
        }
        before_us = width_us;
    }
    assert!(changes > 1_000, "{changes}");
}

fn telemetry_agrees(native: &[Telemetry], image: &[Telemetry]) {
    assert!(native.len().abs_diff(image.len()) <= 1);
    assert!(image.len() >= 5_990);
    for (index, found) in image.iter().enumerate().take(native.len()) {
        let neighbours = around(native, index);
        let expected = &native[index];
        let agrees = |what: &str, same: &dyn Fn(&Telemetry) -> bool| {
            assert!(
                neighbours.iter().any(same),
                "{what} of record {index}:\n{found:?}\n{expected:?}"
            );
        };
        assert!(
            found.board_time_us.abs_diff(expected.board_time_us) <= 1_100,
            "time of record {index}: {found:?} {expected:?}"
        );
        agrees("mode and cause", &|other| {
            (other.mode, other.stop_cause) == (found.mode, found.stop_cause)
        });
        agrees("sequence", &|other| {
            other.last_sequence == found.last_sequence
        });
        // After the configuration of the sensor, which the native board does not need.
        if found.board_time_us > 2_000_000 {
            agrees("state of the IMU", &|other| other.imu == found.imu);
        }
        // Each value on its own: the sensor may take a new sample while it is read,
        // and its first values may be mixed with the zeros before.
        let measures = found.board_time_us > 1_600_000;
        for axis in 0..3 * usize::from(measures) {
            agrees("acceleration", &|other| {
                other.linear_acceleration_mm_s2[axis] == found.linear_acceleration_mm_s2[axis]
            });
            agrees("angular velocity", &|other| {
                let (a, b) = (
                    &other.angular_velocity_mrad_s,
                    &found.angular_velocity_mrad_s,
                );
                // Rounded once more by the sensor's units.
                a[axis].abs_diff(b[axis]) <= 1
            });
        }
        for component in 0..4 * usize::from(measures) {
            agrees("attitude", &|other| {
                other.attitude_q14[component] == found.attitude_q14[component]
            });
        }
        // A tick matters where these change: compared with both neighbours.
        type Value = fn(&Telemetry) -> i32;
        let values: [(&str, Value, i32); 3] = [
            ("motor speed", |t| t.motor_speed_mm_s.into(), 4),
            ("servo pulse", |t| t.servo_us.into(), 5),
            ("ESC pulse", |t| t.esc_us.into(), 5),
        ];
        for (what, value, tolerance) in values {
            let others = || neighbours.iter().map(value);
            let lowest = others().min().unwrap() - tolerance;
            let highest = others().max().unwrap() + tolerance;
            assert!(
                (lowest..=highest).contains(&value(found)),
                "{what} of record {index}, not {lowest} to {highest}:\n{found:?}"
            );
        }
    }
}

fn status_agrees(native: &[Status], image: &[Status]) {
    assert!(native.len().abs_diff(image.len()) <= 1);
    for (found, expected) in image.iter().zip(native) {
        assert!(found.board_time_us.abs_diff(expected.board_time_us) <= 1_100);
        assert_eq!(found.configuration_hash, expected.configuration_hash);
        assert_eq!(found.reset_cause, expected.reset_cause);
        assert_eq!(found.stop_input_open, expected.stop_input_open);
        assert_eq!(found.last_refusal, expected.last_refusal);
        assert_eq!(found.frames_dropped, 0);
        assert_eq!(found.bytes_overrun, 0);
        assert!(found.frames_received.abs_diff(expected.frames_received) <= 1);
        assert!(found.frames_damaged.abs_diff(expected.frames_damaged) <= 1);
        assert!(found.drives_refused.abs_diff(expected.drives_refused) <= 1);
        // The first conversion of the converter takes some time.
        if found.board_time_us > 1_000_000 {
            assert!(found.battery_mv.abs_diff(7_400) <= 40, "{found:?}");
            assert!(found.supply_mv.abs_diff(5_000) <= 25, "{found:?}");
            assert!(!found.battery_open);
        }
    }
}

/// Each pulse matches the native board's output just before its start.
fn pulses_agree(native: &[Outputs], image: &[singletrack_simavr::Pulse]) {
    let mut counts = [0_usize; 2];
    for pulse in image {
        assert_eq!(pulse.width % CYCLES_PER_US, 0, "a whole number of us");
        let width_us = pulse.width / CYCLES_PER_US;
        let begin_ms = (pulse.start / CYCLES_PER_US / 1_000) as usize;
        // The image sets a pulse up to 2 ms before it, from a poll up to 10 ms
        // earlier.
        let index = |ms: usize| ms.saturating_sub(FIRST_POLL_MS as usize).min(native.len());
        let span = &native[index(begin_ms.saturating_sub(14))..index(begin_ms + 2).max(1)];
        let expected_width = |output: &Outputs| match pulse.pin {
            Pin::Servo => output.servo_us.map(u64::from),
            Pin::Esc => output.esc_us.map(u64::from),
        };
        let lowest = span.iter().filter_map(expected_width).min().unwrap();
        let highest = span.iter().filter_map(expected_width).max().unwrap();
        let neutral = u64::from(native[begin_ms].esc_neutral_us);
        // While slewing, the image may be ahead by the slew rate times the time
        // since its last poll. Neutral must match; the rest of the ESC's tolerance
        // is for the speed loop.
        let moves = u64::from(lowest != highest);
        let configuration = default_board_configuration();
        let tolerance = match pulse.pin {
            Pin::Servo => 1 + moves * u64::from(configuration.servo.slew_us_per_20ms / 2),
            Pin::Esc if (lowest, highest) == (neutral, neutral) => 0,
            Pin::Esc => 6 + moves * u64::from(configuration.esc.slew_us_per_20ms / 2),
        };
        assert!(
            (lowest.saturating_sub(tolerance)..=highest + tolerance).contains(&width_us),
            "{:?} at {begin_ms} ms: {width_us} us, not {lowest} to {highest}",
            pulse.pin
        );
        counts[usize::from(pulse.pin == Pin::Esc)] += 1;
    }
    // One every 20 ms on each pin; on the servo's from its configuration on.
    assert!((2_980..=3_000).contains(&counts[0]), "{counts:?}");
    // On the ESC's until the emergency stop has fallen silent.
    let silent_ms = native
        .iter()
        .filter(|output| output.esc_us.is_none())
        .count();
    assert!(silent_ms > 500, "{silent_ms}");
    let expected = 3_000 - silent_ms / 20;
    assert!(counts[1].abs_diff(expected) <= 5, "{counts:?} {expected}");
}
