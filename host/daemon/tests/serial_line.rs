//! The serial line on a pseudo-terminal: hang-ups, missing ports and full queues.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{net::Ipv4Addr, path::Path, time::Duration};

use singletrack_core::{
    Config,
    line::{Line, Sent},
};
use singletrack_protocol::{
    Acknowledgement, BoardMode, Decoder, Hello, Identity, ImuState, Request, StopCause, Telemetry,
    ToBoard, ToHost, VERSION,
};
use singletrack_record::LinkPhase;
use singletrackd::{Daemon, StartOptions, serial_port};

use crate::common::wait_for;
use crate::terminal::Terminal;

fn config(port: &Path) -> Config {
    let mut config = Config::from_toml(include_str!("../singletrackd.example.toml")).unwrap();
    config.serial.port = port.to_owned();
    config.motion_capture.server = Ipv4Addr::LOCALHOST;
    // No server listens there.
    config.motion_capture.command_port = Some(9);
    config.control.realtime_priority = 0;
    config.record.enabled = false;
    config.socket.enabled = false;
    config
}

fn start(port: &Path) -> Daemon {
    Daemon::start(config(port), StartOptions::default()).unwrap()
}

fn link(daemon: &Daemon) -> Option<LinkPhase> {
    daemon.snapshot().latest.tick.map(|tick| tick.link)
}

/// A board that answers greeting and configuration, and sends telemetry at neutral.
struct Board {
    terminal: Terminal,
    decoder: Decoder,
    configuration_hash: u32,
    time_us: u32,
    drives: usize,
}

impl Board {
    fn new(terminal: Terminal) -> Self {
        Self {
            terminal,
            decoder: Decoder::new(),
            configuration_hash: 0,
            time_us: 1_000_000,
            drives: 0,
        }
    }

    fn send(&self, message: impl Into<ToHost>) {
        self.terminal.write(message.into().encode().as_bytes());
    }

    fn answer(&mut self) {
        for byte in self.terminal.read() {
            let Some(Ok(packet)) = self.decoder.push(byte) else {
                continue;
            };
            match ToBoard::decode(packet).unwrap() {
                ToBoard::Hello(hello) => {
                    self.send(Hello {
                        protocol_version: VERSION,
                        software_version: [0, 1, 0],
                        nonce: hello.nonce,
                    });
                    self.send(Identity { car_id: 0 });
                }
                ToBoard::Configure(configure) => {
                    self.configuration_hash = configure.configuration.hash();
                    self.send(Acknowledgement {
                        request: Request::Configure,
                        sequence: configure.request,
                        configuration_hash: self.configuration_hash,
                    });
                }
                ToBoard::Drive(_) => self.drives += 1,
                _ => {}
            }
        }
    }

    fn send_telemetry(&mut self) {
        self.time_us += 10_000;
        self.send(Telemetry {
            board_time_us: self.time_us,
            mode: BoardMode::Neutral,
            stop_cause: StopCause::None,
            last_sequence: singletrack_protocol::Sequence(0),
            imu: ImuState::Silent,
            imu_age_100us: 0,
            linear_acceleration_mm_s2: [0; 3],
            angular_velocity_mrad_s: [0; 3],
            attitude_q14: [1 << 14, 0, 0, 0],
            motor_speed_mm_s: 0,
            servo_us: 1_500,
            esc_us: 1_500,
        });
    }

    fn connect(&mut self, daemon: &Daemon) {
        wait_for("connected", || {
            self.answer();
            if self.configuration_hash != 0 {
                self.send_telemetry();
            }
            link(daemon) == Some(LinkPhase::Ready)
        });
    }
}

#[test]
fn a_hang_up_is_detected_at_once_and_the_port_is_opened_again() {
    let folder = tempfile::tempdir().unwrap();
    let port = folder.path().join("board");
    let terminal = Terminal::open();
    terminal.link(&port);
    let daemon = start(&port);
    let mut board = Board::new(terminal);
    board.connect(&daemon);

    drop(board);
    let detected = wait_for("hang-up detected", || {
        link(&daemon) == Some(LinkPhase::Disconnected)
    });
    assert!(detected < Duration::from_millis(50), "{detected:?}");

    let terminal = Terminal::open();
    terminal.link(&port);
    let reopened = wait_for("port open again", || {
        link(&daemon) == Some(LinkPhase::Greeting)
    });
    assert!(reopened < Duration::from_secs(1), "{reopened:?}");
    let mut board = Board::new(terminal);
    board.connect(&daemon);

    let summary = daemon.stop().unwrap();
    assert_eq!(summary.figures.frames.hang_ups, 1);
    assert_eq!(summary.figures.dropped, Default::default());
}

#[test]
fn a_daemon_whose_car_stands_ends_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let port = folder.path().join("board");
    let terminal = Terminal::open();
    terminal.link(&port);
    let daemon = start(&port);
    let mut board = Board::new(terminal);
    board.connect(&daemon);
    // That it takes one tick is tested in virtual time: a busy machine takes longer.
    let summary = daemon.stop().unwrap();
    assert!(summary.figures.ticks > 0);
    assert_eq!(summary.figures.driving_ticks, 0);
}

#[test]
fn a_missing_port_is_opened_when_it_appears() {
    let folder = tempfile::tempdir().unwrap();
    let port = folder.path().join("board");
    let daemon = start(&port);
    wait_for("ticks without a port", || {
        daemon.snapshot().figures.ticks > 5
    });
    assert_eq!(link(&daemon), Some(LinkPhase::Disconnected));
    let terminal = Terminal::open();
    terminal.link(&port);
    Board::new(terminal).connect(&daemon);
}

#[test]
fn an_error_of_opening_says_what_to_do() {
    let missing = serial_port::open("/dev/no-such-port".as_ref(), 115_200).unwrap_err();
    assert!(missing.contains("no such device"), "{missing}");
    assert!(missing.contains("/dev/no-such-port"));
    assert!(missing.contains("plug the board in"));

    let file = tempfile::NamedTempFile::new().unwrap();
    let no_port = serial_port::open(file.path(), 115_200).unwrap_err();
    assert!(
        no_port.contains("is it the board's serial port"),
        "{no_port}"
    );

    let terminal = Terminal::open();
    let _first = serial_port::open(terminal.device(), 115_200).unwrap();
    let second = serial_port::open(terminal.device(), 115_200).unwrap_err();
    assert!(second.contains("in use by another program"), "{second}");
}

#[test]
fn a_full_line_drops_whole_frames_without_waiting() {
    let terminal = Terminal::open();
    let (_read, mut write) = serial_port::open(terminal.device(), 115_200).unwrap();
    let frame = [0x55; 15].iter().chain(&[0]).copied().collect::<Vec<u8>>();
    let begin = std::time::Instant::now();
    let mut whole = 0;
    while write.write_frame(&frame) == Sent::Whole {
        whole += 1;
    }
    assert_eq!(write.write_frame(&frame), Sent::Dropped);
    assert!(begin.elapsed() < Duration::from_secs(2));
    // When there is room again, no part of a dropped frame is joined to a new one: between
    // two zeros there is a whole frame or a partial one.
    let mut received = terminal.read();
    assert_eq!(write.write_frame(&frame), Sent::Whole);
    wait_for("the last frame", || {
        received.extend(terminal.read());
        received.ends_with(&frame)
    });
    let frames = received
        .split(|&byte| byte == 0)
        .filter(|part| part.len() == 15)
        .count();
    assert_eq!(frames, whole + 1);
    assert!(
        received
            .split(|&byte| byte == 0)
            .all(|part| part.len() <= 15)
    );
}
