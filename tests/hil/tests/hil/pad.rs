//! `singletrack drive` with the shipped daemon: a game-pad is the dead-man switch.
//!
//! Its events come through a pipe, in the format of the kernel, so that every computer can run
//! these tests; where input devices can be made, one test uses such a device.

use std::{
    fs::{File, OpenOptions},
    io::Write as _,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use evdev::{
    AbsInfo, AbsoluteAxisCode, AttributeSet, EventType, InputEvent, KeyCode, UinputAbsSetup,
    uinput::VirtualDevice,
};
use rustix::fs::{CWD, mkfifoat};
use serde_json::json;
use singletrack_hil::{
    Failure, Outcome,
    bench::{Bench, NEUTRAL_LIMIT_MS},
    ensure,
    rig::Need,
};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new(
        "a_pad_that_is_pulled_out_gives_neutral_within_120_ms",
        pulled_out,
    ),
    Scenario::new(
        "a_pad_that_is_pulled_out_brakes_a_car_that_can",
        pulled_out_of_a_braking_car,
    ),
    Scenario::new("a_silent_pad_gives_neutral_and_starts_nothing", silent),
    Scenario::new(
        "a_pads_button_counts_after_it_was_released_once",
        stuck_button,
    ),
    Scenario::new("a_pads_sticks_drive_the_car_from_their_centre", sticks),
    Scenario::new(
        "a_pad_lets_the_car_drive_the_configurations_reference_whatever_was_in_force",
        other_reference,
    ),
    Scenario::new("a_pad_of_the_kernel_drives_and_is_pulled_out", uinput).needing(&[Need::Uinput]),
];

const DRIVE: KeyCode = KeyCode::BTN_TR;
const STICKS: KeyCode = KeyCode::BTN_TL;
const SPEED: AbsoluteAxisCode = AbsoluteAxisCode::ABS_Y;
const TURN: AbsoluteAxisCode = AbsoluteAxisCode::ABS_RX;

/// Time for the daemon's judgement, and for the board to arm.
const BEGIN: Duration = Duration::from_secs(6);

/// Time in which a drive would have begun.
const NOTHING: Duration = Duration::from_millis(1_500);

/// A pad that can be pulled out.
enum Plug {
    Pipe(File),
    Device(Box<VirtualDevice>),
}

/// A pad and the program that drives by it. Dropping it kills the program.
struct Pad {
    plug: Option<Plug>,
    program: Child,
}

impl Pad {
    /// A pad behind a pipe, whose buttons and sticks are at rest.
    fn at_rest(bench: &Bench, options: &[&str]) -> Outcome<Self> {
        let mut pad = Self::piped(bench, options)?;
        for button in [DRIVE, STICKS] {
            pad.button(button, false)?;
        }
        pad.stick(SPEED, 0)?;
        pad.stick(TURN, 0)?;
        Ok(pad)
    }

    /// A pad behind a pipe, of which nothing is known.
    fn piped(bench: &Bench, options: &[&str]) -> Outcome<Self> {
        let path = bench.folder().join("pad");
        mkfifoat(CWD, &path, 0o600.into())
            .map_err(|error| Failure::system("can't make a pipe")(error.into()))?;
        let program = start(bench, &path, options)?;
        // Waits for the program to read it.
        let pipe = OpenOptions::new()
            .write(true)
            .open(&path)
            .map_err(Failure::system("can't open the pipe"))?;
        Ok(Self {
            plug: Some(Plug::Pipe(pipe)),
            program,
        })
    }

    /// A pad of the kernel.
    fn device(bench: &Bench) -> Outcome<Self> {
        let system = || Failure::system("can't make an input device");
        let mut keys = AttributeSet::<KeyCode>::new();
        keys.insert(DRIVE);
        keys.insert(STICKS);
        let range = AbsInfo::new(0, -32_768, 32_767, 16, 128, 0);
        let mut device = VirtualDevice::builder()
            .and_then(|builder| {
                builder
                    .name("pad of a test")
                    .with_keys(&keys)?
                    .with_absolute_axis(&UinputAbsSetup::new(SPEED, range))?
                    .with_absolute_axis(&UinputAbsSetup::new(TURN, range))?
                    .build()
            })
            .map_err(system())?;
        let path = device
            .enumerate_dev_nodes_blocking()
            .map_err(system())?
            .flatten()
            .next()
            .ok_or_else(|| Failure::new("the input device has no name"))?;
        let program = start(bench, &path, &[])?;
        sleep(Duration::from_millis(300));
        Ok(Self {
            plug: Some(Plug::Device(Box::new(device))),
            program,
        })
    }

    fn button(&mut self, button: KeyCode, pressed: bool) -> Outcome {
        self.send(EventType::KEY, button.0, i32::from(pressed))
    }

    fn stick(&mut self, axis: AbsoluteAxisCode, value: i32) -> Outcome {
        self.send(EventType::ABSOLUTE, axis.0, value)
    }

    fn send(&mut self, kind: EventType, code: u16, value: i32) -> Outcome {
        let sent = match &mut self.plug {
            None => return Err(Failure::new("the pad was pulled out")),
            Some(Plug::Device(device)) => device.emit(&[InputEvent::new(kind.0, code, value)]),
            Some(Plug::Pipe(pipe)) => {
                let mut bytes = Vec::new();
                for (kind, code, value) in [(kind.0, code, value), (0, 0, 0)] {
                    bytes.extend([0; 2 * size_of::<usize>()]);
                    bytes.extend(kind.to_ne_bytes());
                    bytes.extend(code.to_ne_bytes());
                    bytes.extend(value.to_ne_bytes());
                }
                pipe.write_all(&bytes)
            }
        };
        sent.map_err(Failure::system("the pad can't be moved"))
    }

    fn pull_out(&mut self) {
        self.plug = None;
    }

    /// Whether the program ended by itself within this time, and with success.
    fn ends_within(&mut self, limit: Duration) -> Outcome<Option<bool>> {
        let begun = Instant::now();
        while begun.elapsed() < limit {
            let ended = self
                .program
                .try_wait()
                .map_err(Failure::system("no state of the pad's program"))?;
            if let Some(status) = ended {
                return Ok(Some(status.success()));
            }
            sleep(Duration::from_millis(10));
        }
        Ok(None)
    }
}

impl Drop for Pad {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

fn start(bench: &Bench, pad: &Path, options: &[&str]) -> Outcome<Child> {
    // Built next to the daemon.
    let tool: PathBuf = bench.program().with_file_name("singletrack");
    Command::new(&tool)
        .arg("drive")
        .arg("--pad")
        .arg(pad)
        .args(options)
        .arg("--socket")
        .arg(&bench.config().socket.path)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .map_err(Failure::system(format!("can't run {}", tool.display())))
}

/// Starts the daemon and drives by the pad for a while.
fn drives(bench: &mut Bench, pad: &mut Pad) -> Outcome {
    pad.button(DRIVE, true)?;
    bench.wait_for_mode("driving", BEGIN)?;
    bench.keep_driving(Duration::from_millis(700))
}

fn ended_by(bench: &mut Bench, reason: &str) -> Outcome {
    bench.wait_until_standing()?;
    let status = bench.status()?;
    ensure!(
        status.reason() == reason,
        "the reason for the stop: {}",
        status.text()
    );
    Ok(())
}

fn pulled_out(bench: &mut Bench) -> Outcome {
    // Without a brake the pulse is exactly neutral.
    bench.config_mut().board.esc.kind = None;
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let mut pad = Pad::at_rest(bench, &[])?;
    drives(bench, &mut pad)?;
    let pulled_us = bench.board_time_us()?;
    pad.pull_out();
    bench.neutral_within("after the pad was pulled out", pulled_us, NEUTRAL_LIMIT_MS)?;
    ended_by(bench, "operator-gone")?;
    let ended = pad.ends_within(Duration::from_secs(2))?;
    ensure!(ended == Some(false), "the pad's program: {ended:?}");
    Ok(())
}

fn pulled_out_of_a_braking_car(bench: &mut Bench) -> Outcome {
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let mut pad = Pad::at_rest(bench, &[])?;
    drives(bench, &mut pad)?;
    let pulled_us = bench.board_time_us()?;
    let place = bench.rig().trace()?.len();
    pad.pull_out();
    ended_by(bench, "operator-gone")?;
    let neutral_us = bench.config().board.esc.neutral_us;
    let trace = bench.rig().trace()?;
    let after = || trace.since(place).iter();
    let driven = after()
        .filter(|pulses| pulses.esc_us > neutral_us)
        .map(|pulses| f64::from(pulses.board_time_us.wrapping_sub(pulled_us) as i32) / 1_000.0)
        .fold(0.0, f64::max);
    bench.at_most(
        "the last pulse that drives after the pad was pulled out (board time)",
        driven,
        NEUTRAL_LIMIT_MS,
        "ms",
    )?;
    let brakes = after().any(|pulses| pulses.esc_us != 0 && pulses.esc_us < neutral_us);
    ensure!(brakes, "no pulse brakes");
    Ok(())
}

fn silent(bench: &mut Bench) -> Outcome {
    bench.config_mut().board.esc.kind = None;
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let mut pad = Pad::at_rest(bench, &["--silence", "1500ms"])?;
    pad.button(DRIVE, true)?;
    bench.wait_for_mode("driving", BEGIN)?;
    bench.keep_driving(Duration::from_millis(300))?;
    let spoken_us = bench.board_time_us()?;
    pad.stick(TURN, 100)?;
    bench.neutral_within(
        "after the last event of the pad, which may be silent for 1500 ms",
        spoken_us,
        1_500.0 + NEUTRAL_LIMIT_MS,
    )?;
    ended_by(bench, "operator-gone")?;
    // The button is still pressed.
    let place = bench.rig().trace()?.len();
    pad.stick(TURN, 0)?;
    sleep(NOTHING);
    bench.was_neutral_since(place)
}

fn stuck_button(bench: &mut Bench) -> Outcome {
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let mut pad = Pad::piped(bench, &[])?;
    let place = bench.rig().trace()?.len();
    pad.button(DRIVE, true)?;
    sleep(NOTHING);
    bench.was_neutral_since(place)?;
    pad.button(DRIVE, false)?;
    drives(bench, &mut pad)?;
    pad.button(DRIVE, false)?;
    ended_by(bench, "requested")
}

fn sticks(bench: &mut Bench) -> Outcome {
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let mut pad = Pad::at_rest(bench, &["--speed", "0.3"])?;
    let place = bench.rig().trace()?.len();
    // Not from their centre.
    pad.stick(SPEED, -20_000)?;
    pad.button(STICKS, true)?;
    sleep(NOTHING);
    bench.was_neutral_since(place)?;
    pad.stick(SPEED, 0)?;
    bench.wait_for_mode("driving", BEGIN)?;
    pad.stick(SPEED, -32_768)?;
    pad.stick(TURN, -20_000)?;
    bench.keep_driving(Duration::from_millis(1_000))?;
    let status = bench.status()?;
    let (speed, steering) = (
        status.number("/state/commanded_speed_m_s")?,
        status.number("/state/steering_rad")?,
    );
    ensure!(
        (0.2..0.35).contains(&speed) && steering > 0.05,
        "the sticks command {speed} m/s and {steering} rad"
    );
    pad.button(STICKS, false)?;
    ended_by(bench, "requested")?;
    // At its end the reference of the configuration is in force again: without set-points a car
    // with another one is not ready.
    pad.pull_out();
    let ended = pad.ends_within(Duration::from_secs(5))?;
    ensure!(ended == Some(false), "the pad's program: {ended:?}");
    bench.wait_until_ready().map(drop)
}

fn other_reference(bench: &mut Bench) -> Outcome {
    let external = json!({ "kind": "external", "setpoint_timeout_ms": 100 });
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let mut pad = Pad::at_rest(bench, &[])?;
    for _ in 0..2 {
        // Another program has put it in force: before the first drive, and between two.
        bench.client()?.set_reference(&external)?.accepted()?;
        drives(bench, &mut pad)?;
        pad.button(DRIVE, false)?;
        ended_by(bench, "requested")?;
        bench.wait_until_ready()?;
    }
    Ok(())
}

fn uinput(bench: &mut Bench) -> Outcome {
    bench.config_mut().board.esc.kind = None;
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let mut pad = Pad::device(bench)?;
    drives(bench, &mut pad)?;
    let pulled_us = bench.board_time_us()?;
    pad.pull_out();
    bench.neutral_within(
        "after the kernel's pad was pulled out",
        pulled_us,
        NEUTRAL_LIMIT_MS,
    )?;
    ended_by(bench, "operator-gone")
}
