//! Rig with a physical UNO, with the harness between it and the daemon.

use std::{
    io::{Read, Write},
    net::SocketAddrV4,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use serialport::{SerialPort, TTYPort};
use singletrack_control::statistics::Random;
use singletrack_protocol::{BoardMode, Decoder, ImuState, StopCause, Telemetry, ToHost};
use singletrack_sim::{LossKind, Pty, RealTimeConfig, RealTimeSimulator, Truth};

use super::{Canary, LineFaults, Need, Rig, raise_priority, simulated, uinput_lacks};
use crate::{Failure, Outcome, Pulses, Trace, settings, wait};

/// Baud rate of the firmware.
const BAUD: u32 = 115_200;
/// Timeout of a read from the UNO, after which the harness reads from the daemon.
const READ_TIMEOUT: Duration = Duration::from_millis(1);

/// Limit for the start: the bootloader after the reset by opening the port, and two
/// seconds of neutral for the ESC.
const START: Duration = Duration::from_secs(10);

/// Rig with a physical UNO, with the harness between it and the daemon.
///
/// The simulator provides the car and the cameras, with its own board switched off:
/// the pulses reported by the UNO move the car.
#[derive(Debug)]
pub struct PhysicalRig {
    link: PathBuf,
    car: Arc<RealTimeSimulator>,
    shared: Arc<Mutex<Shared>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    canary: Canary,
    /// Whether the board started when the port was opened.
    fresh: bool,
}

/// State shared by the line's thread and the test.
#[derive(Debug)]
struct Shared {
    pty: Option<Pty>,
    line: LineFaults,
    trace: Vec<Pulses>,
    newest: Option<(Telemetry, Instant)>,
    /// The record before the last one with a new command.
    last_command_us: u32,
    max_lateness: Duration,
    /// The error that ended the line's thread.
    broken: Option<String>,
}

impl PhysicalRig {
    /// Opens the UNO's port, which resets it, and the daemon's at `link`.
    ///
    /// # Errors
    ///
    /// Fails if the port, the pseudo-terminal or the simulator can't be opened.
    pub fn start(port: &Path, link: PathBuf, seed: u64) -> Outcome<Self> {
        let uno = serialport::new(port.to_string_lossy(), BAUD)
            .timeout(READ_TIMEOUT)
            .open_native()
            .map_err(|error| {
                Failure::new(format!(
                    "can't open {}: {error}; is the UNO plugged in, and are you in its group (dialout)?",
                    port.display()
                ))
            })?;
        // Discards bytes from before.
        let _ = uno.clear(serialport::ClearBuffer::All);
        let car = simulated::start(RealTimeConfig {
            simulation: settings::simulation(seed),
            ..RealTimeConfig::default()
        })?;
        car.with_world(|world| world.set_board_power(false))?;
        let car = Arc::new(car);
        let shared = Arc::new(Mutex::new(Shared {
            pty: Some(open(&link)?),
            line: LineFaults::default(),
            trace: Vec::new(),
            newest: None,
            last_command_us: 0,
            max_lateness: Duration::ZERO,
            broken: None,
        }));
        let stop = Arc::new(AtomicBool::new(false));
        let line = Line {
            uno,
            car: Arc::clone(&car),
            shared: Arc::clone(&shared),
            frames: Frames::default(),
            to_board: Vec::new(),
            to_host: Vec::new(),
            damage: Damage::new(seed),
        };
        let stopped = Arc::clone(&stop);
        let thread = thread::Builder::new()
            .name("line".to_owned())
            .spawn(move || {
                raise_priority();
                line.run(&stopped);
            })
            .map_err(Failure::system("can't start the line's thread"))?;
        let mut rig = Self {
            canary: Canary::start()?,
            fresh: false,
            link,
            car,
            shared,
            stop,
            thread: Some(thread),
        };
        rig.wait_until_at_rest()?;
        // The board's clock restarts with the board.
        rig.fresh = rig
            .newest()?
            .is_some_and(|telemetry| u128::from(telemetry.board_time_us) < START.as_micros());
        Ok(rig)
    }

    /// Waits until the UNO runs, the wheels stand still, and the simulated ESC has
    /// been at neutral long enough.
    fn wait_until_at_rest(&self) -> Outcome {
        let mut last = "no telemetry".to_owned();
        wait::until("a UNO at rest", START, || {
            let Some(telemetry) = self.newest()? else {
                return Ok(None);
            };
            last = format!("mode {:?}", telemetry.mode);
            let stopped = telemetry.mode == BoardMode::EmergencyStopped;
            let armed = self.car.with_world(|world| world.car.esc_is_armed())?;
            Ok((!stopped && armed && telemetry.motor_speed_mm_s == 0).then_some(()))
        })
        .map_err(|failure| {
            Failure::new(format!(
                "{failure} ({last}); is the firmware on it? An emergency stop ends with the reset button"
            ))
        })
    }

    fn shared(&self) -> Outcome<MutexGuard<'_, Shared>> {
        let shared = lock(&self.shared);
        match &shared.broken {
            None => Ok(shared),
            Some(broken) => Err(Failure::new(broken.clone())),
        }
    }

    fn newest(&self) -> Outcome<Option<Telemetry>> {
        // A board without telemetry counts as not running.
        Ok(self
            .shared()?
            .newest
            .filter(|(_, time)| time.elapsed() < Duration::from_millis(100))
            .map(|(telemetry, _)| telemetry))
    }
}

impl Drop for PhysicalRig {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // Its result is no longer needed.
            let _ = thread.join();
        }
    }
}

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn open(link: &Path) -> Outcome<Pty> {
    Pty::open(Some(link)).map_err(|error| Failure::new(error.to_string()))
}

impl Rig for PhysicalRig {
    fn port(&self) -> &Path {
        &self.link
    }

    fn cameras(&self) -> SocketAddrV4 {
        self.car.command_address
    }

    fn interrupt(&self) -> Outcome {
        self.shared()?.pty = None;
        Ok(())
    }

    fn plug(&self) -> Outcome {
        let pty = open(&self.link)?;
        self.shared()?.pty = Some(pty);
        Ok(())
    }

    fn set_line(&self, line: LineFaults) -> Outcome {
        self.shared()?.line = line;
        Ok(())
    }

    fn set_markers(&self, loss: Option<LossKind>) -> Outcome {
        Ok(self
            .car
            .with_world(move |world| world.cameras.faults.loss = loss)?)
    }

    fn truth(&self) -> Outcome<Truth> {
        Ok(self.car.truth()?.truth)
    }

    fn trace(&self) -> Outcome<Trace> {
        Ok(Trace(self.shared()?.trace.clone()))
    }

    fn board_time_us(&self) -> Outcome<Option<u32>> {
        Ok(self.newest()?.map(|telemetry| telemetry.board_time_us))
    }

    fn stop_cause(&self) -> Outcome<Option<StopCause>> {
        Ok(self.newest()?.map(|telemetry| telemetry.stop_cause))
    }

    /// Telemetry reports the last command, to the time of one record: the record
    /// before it is not too late.
    fn last_command_us(&self) -> Outcome<u32> {
        let mut last = self.shared()?.last_command_us;
        let mut since = Instant::now();
        let start = Instant::now();
        // No command for longer than the time to live.
        while since.elapsed() < Duration::from_millis(150) {
            thread::sleep(READ_TIMEOUT);
            let now = self.shared()?.last_command_us;
            if now != last {
                (last, since) = (now, Instant::now());
            }
            if start.elapsed() > Duration::from_secs(2) {
                return Err(Failure::new("commands still reach the board after 2 s"));
            }
        }
        Ok(last)
    }

    fn lateness(&self) -> Outcome<Duration> {
        Ok(self.shared()?.max_lateness.max(self.canary.lateness()))
    }

    fn lacks(&self, need: Need) -> Option<&'static str> {
        match need {
            Need::FreshBoard => (!self.fresh).then_some(
                "opening the port did not reset the board, so it is not in its initial state",
            ),
            _ => lacks(need),
        }
    }
}

/// Reason why a physical car lacks something, if it does.
pub(crate) fn lacks(need: Need) -> Option<&'static str> {
    match need {
        Need::Reset => Some("the harness has no reset line to a physical UNO"),
        Need::Power => Some("the harness can't pull the cable of a physical UNO"),
        Need::MotorSensor => Some("the harness can't cut the motor sensor of a physical car"),
        Need::StopSwitch => Some("the harness can't open the stop switch of a physical car"),
        Need::OtherCameras => Some("the cameras are there already"),
        Need::AnotherCar => Some("the harness can't give a physical UNO another car's number"),
        Need::Image => Some("the harness can't make the processor of a physical UNO fail"),
        Need::Fast => Some("the motor of a car on a stand turns up to the speed of the circle"),
        Need::Uinput => uinput_lacks(),
        Need::Newcomer | Need::Whole => Some("its car is lifted, rolled and turned by a simulator"),
        Need::FreshBoard | Need::Octave | Need::Browser => None,
    }
}

/// State of the line's thread.
struct Line {
    uno: TTYPort,
    car: Arc<RealTimeSimulator>,
    shared: Arc<Mutex<Shared>>,
    frames: Frames,
    to_board: Vec<u8>,
    to_host: Vec<u8>,
    damage: Damage,
}

impl Line {
    fn run(mut self, stop: &AtomicBool) {
        let mut rounds = 0_u64;
        while !stop.load(Ordering::Relaxed) {
            let begin = Instant::now();
            if let Err(broken) = self.round(rounds) {
                lock(&self.shared).broken = Some(broken);
                return;
            }
            rounds += 1;
            let lateness = begin.elapsed().saturating_sub(READ_TIMEOUT);
            let mut shared = lock(&self.shared);
            shared.max_lateness = shared.max_lateness.max(lateness);
        }
    }

    fn round(&mut self, rounds: u64) -> Result<(), String> {
        self.take_from_board()?;
        let shared = lock(&self.shared);
        let line = shared.line;
        if let Some(pty) = &shared.pty {
            if rounds.is_multiple_of(100) {
                pty.clear_exclusive();
            }
            // While the line is stuck, the host's writes stay in its driver.
            if !line.stuck {
                let mut buffer = [0; 1024];
                while let Ok(count @ 1..) = pty.read(&mut buffer) {
                    self.to_board
                        .extend_from_slice(buffer.get(..count).unwrap_or(&[]));
                }
                self.damage.apply(&mut self.to_host, line.corrupt);
                // Bytes that the daemon does not read are lost.
                let _ = pty.write(&self.to_host);
                self.to_host.clear();
            }
        } else {
            self.to_host.clear();
        }
        drop(shared);
        self.damage.apply(&mut self.to_board, line.corrupt);
        self.uno
            .write_all(&self.to_board)
            .map_err(|error| format!("can't write to the UNO: {error}"))?;
        self.to_board.clear();
        Ok(())
    }

    fn take_from_board(&mut self) -> Result<(), String> {
        let mut buffer = [0; 1024];
        let count = match self.uno.read(&mut buffer) {
            Ok(count) => count,
            Err(error) if error.kind() == std::io::ErrorKind::TimedOut => 0,
            Err(error) => return Err(format!("can't read from the UNO: {error}")),
        };
        let (car, shared) = (&self.car, &self.shared);
        let mut stopped = false;
        self.frames.pass(
            buffer.get(..count).unwrap_or(&[]),
            &mut self.to_host,
            |telemetry| {
                let (servo_us, esc_us) = (telemetry.servo_us, telemetry.esc_us);
                let truth = car.with_world(move |world| {
                    world.car.apply_pulses(servo_us, esc_us);
                    world.truth()
                });
                match truth {
                    Ok(truth) => replace_motion(telemetry, &truth),
                    Err(_) => stopped = true,
                }
                lock(shared).process(telemetry);
            },
        );
        if stopped {
            return Err("the simulator has stopped".to_owned());
        }
        Ok(())
    }
}

impl Shared {
    fn process(&mut self, telemetry: &Telemetry) {
        if let Some((before, _)) = &self.newest
            && before.last_sequence != telemetry.last_sequence
        {
            self.last_command_us = before.board_time_us;
        }
        self.newest = Some((*telemetry, Instant::now()));
        self.trace.push(Pulses {
            board_time_us: telemetry.board_time_us,
            servo_us: telemetry.servo_us,
            esc_us: telemetry.esc_us,
            cut: false,
        });
    }
}

/// Splits the bytes from the board into frames, and passes undecodable bytes
/// unchanged.
#[derive(Debug, Default)]
pub(super) struct Frames {
    decoder: Decoder,
    frame: Vec<u8>,
}

impl Frames {
    /// Processes bytes from the board and appends to `out` the bytes for the host:
    /// the same, except for telemetry, which `replace` may change.
    fn pass(&mut self, bytes: &[u8], out: &mut Vec<u8>, mut replace: impl FnMut(&mut Telemetry)) {
        for &byte in bytes {
            self.frame.push(byte);
            let message = match self.decoder.push(byte) {
                Some(Ok(packet)) => ToHost::decode(packet).ok(),
                Some(Err(_)) | None => None,
            };
            if let Some(ToHost::Telemetry(mut telemetry)) = message {
                replace(&mut telemetry);
                out.extend_from_slice(ToHost::Telemetry(telemetry).encode().as_bytes());
                self.frame.clear();
            } else if byte == 0 {
                out.append(&mut self.frame);
            }
        }
    }
}

/// Replaces the measured motion by the simulated car's: the car on the stand does
/// not move.
fn replace_motion(telemetry: &mut Telemetry, truth: &Truth) {
    let milli = |value: f64| (value * 1_000.0).round() as i16;
    telemetry.imu = ImuState::Fresh;
    telemetry.imu_age_100us = 0;
    telemetry.linear_acceleration_mm_s2 = [
        milli(truth.longitudinal_acceleration),
        milli(truth.lateral_acceleration),
        0,
    ];
    telemetry.angular_velocity_mrad_s = [0, 0, milli(truth.yaw_rate)];
    let (sine, cosine) = (0.5 * truth.yaw).sin_cos();
    let q14 = |value: f64| (value * 16_384.0).round() as i16;
    telemetry.attitude_q14 = [q14(cosine), 0, 0, q14(sine)];
}

/// Flips bits, reproducibly.
#[derive(Debug)]
pub(super) struct Damage(Random);

impl Damage {
    pub(super) const fn new(seed: u64) -> Self {
        Self(Random::new(seed))
    }

    /// Flips one bit of each byte with this probability.
    pub(super) fn apply(&mut self, bytes: &mut [u8], probability: f64) {
        for byte in bytes {
            if self.0.happens(probability) {
                *byte ^= 1 << self.0.below(8);
            }
        }
    }
}
