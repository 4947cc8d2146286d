//! `singletrack drive`: a game-pad as dead-man switch and for teleoperation.
//!
//! `pad` turns its events into requests; this module connects it to the clock, the device and the
//! daemon's control socket.

mod device;
pub mod pad;

use std::{
    os::fd::AsFd as _,
    path::{Path, PathBuf},
    process::ExitCode,
    thread,
    time::{Duration, Instant},
};

use clap::Args;
use serde_json::{Value, json};
use singletrack_api::{
    Answer, Arm, Attendance, ClientError, Code, Connection, Reply, Request, Setpoint, State,
    ask_within,
};
use singletrack_control::{Time, Velocity, direction};
use singletrack_core::{config::ReferenceSection, reasons::Why};
use singletrackd::monotonic_ns;

use crate::operator::{
    arm::ended_as_wanted,
    control::{ControlArgs, EMERGENCY_STOPPED, print, read_reference},
    terminal::wait_to_read,
};
use crate::{Result, arguments::duration_within, interrupt::Interrupt};
use device::Source;
use pad::{Driver, Pad, PadEvent, PadRequest};

/// The pad and its bounds.
#[derive(Clone, Debug, Args)]
#[command(after_help = "\
Hold the right shoulder button: the car drives its reference. Hold the left one, with the sticks \
at their centre: the left stick gives the speed, the right one the direction. Release it: the car \
slows down and stops. The right button (B) is the emergency stop. A pad that is pulled out, or \
silent for --silence, puts the motor to neutral at once. Find the device with `ls -l \
/dev/input/by-id/*-event-joystick`.")]
pub struct DriveArgs {
    /// The pad's event device, such as /dev/input/by-id/...-event-joystick; or a pipe with the
    /// bytes of one
    #[arg(long, value_name = "DEVICE")]
    pad: PathBuf,
    /// The reference that the car drives by itself, as for set-reference; otherwise that of the
    /// configuration
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// Highest speed by the sticks, in m/s
    #[arg(long, value_name = "M_S", default_value_t = 0.5)]
    speed: f64,
    /// The longest silence of the pad in a drive, such as 5s: a pad without contact gives no
    /// events. Move a stick now and then
    #[arg(long, value_name = "DURATION", default_value = "5s", value_parser = parse_silence)]
    silence: Duration,
    /// Arm also if doctor, bring-up and calibrate have not passed with this configuration on
    /// this car, as `singletrack arm --uncalibrated`
    #[arg(long)]
    uncalibrated: bool,
    #[command(flatten)]
    control: ControlArgs,
}

/// The longest wait for a daemon that does not read.
const PATIENCE: Duration = Duration::from_millis(20);

/// The longest wait for an event, so that renewals and Ctrl-C are not late.
const WAIT: Duration = Duration::from_millis(5);

/// The longest wait for the daemon's answer to a stop.
const ANSWER: Duration = Duration::from_millis(200);

/// Age from which a heading no longer serves to steer.
const HEADING_AGE: Duration = Duration::from_millis(100);

/// The longest time until a car whose reference was changed is ready.
const SETTLE: Duration = Duration::from_secs(5);

/// The longest wait for the end of a drive that was stopped.
const END: Duration = Duration::from_secs(10);

/// How long the reference of the configuration is asked for at the end, and how often.
const RESTORE: Duration = Duration::from_secs(3);
const AGAIN: Duration = Duration::from_millis(300);

/// Time-out of the set-points of the sticks: they come every 20 ms.
const SETPOINT_TIMEOUT_MS: u32 = 100;

/// Neutral at once.
const HALT: Request = Request::Disarm {
    at_once: true,
    carried: false,
};

/// Drives by the pad until Ctrl-C.
///
/// # Errors
///
/// When pad or daemon can't be reached, or the pad is lost; the car is stopped.
pub fn run(args: &DriveArgs) -> Result<ExitCode> {
    if !(args.speed > 0.0 && args.speed <= 5.0) {
        return Err(format!("--speed is {}: give above 0, to 5", args.speed).into());
    }
    let interrupt = Interrupt::listen()?;
    let (source, state) = Source::open(&args.pad)
        .map_err(|error| format!("can't open the pad {}: {error}", args.pad.display()))?;
    let reference = args.reference.as_deref().map(read_reference).transpose()?;
    let watch = Connection::watch_states(&args.control.socket, PATIENCE)?;
    let now = Time(monotonic_ns());
    let mut drive = DriveSession {
        pad: Pad::new(args.speed, args.silence, now),
        session: Connection::open(&args.control.socket, PATIENCE)?,
        watch,
        socket: &args.control.socket,
        stage: Stage::Off,
        is_asked: false,
        // Another program may have replaced the reference of the configuration.
        in_force: None,
        reference,
        uncalibrated: args.uncalibrated,
        car: None,
    };
    for event in state {
        drive.pad.handle(now, event);
    }
    print(&match source.name() {
        Some(name) => format!("{name}: hold a shoulder button to drive"),
        None => "hold a shoulder button to drive".to_owned(),
    })?;
    let result = drive.attend(source, &interrupt);
    let is_external = matches!(drive.in_force, Some((Driver::Sticks, _)));
    // Ends a drive that goes on after an error.
    drop(drive);
    if is_external {
        restore(&args.control.socket);
    }
    result
}

/// How far a drive is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// No button is held.
    Off,
    /// The daemon has been asked which configuration is in force, or for the reference of this
    /// driver.
    Changing(Driver),
    /// The car gets ready; since then.
    Settling(Driver, Instant),
    /// The daemon has been asked to arm.
    Arming(Driver),
    /// The car drives.
    Driving(Driver),
    /// The car has been asked to stop; since then.
    Ending(Instant),
}

impl Stage {
    /// After a request to stop: a drive has still to end.
    fn stopped(self) -> Self {
        match self {
            Self::Arming(_) | Self::Driving(_) | Self::Ending(_) => Self::Ending(Instant::now()),
            Self::Off | Self::Changing(_) | Self::Settling(..) => Self::Off,
        }
    }
}

struct DriveSession<'a> {
    pad: Pad,
    /// Holds the drive.
    session: Connection,
    watch: Connection,
    socket: &'a Path,
    stage: Stage,
    /// An answer about the configuration is still to come.
    is_asked: bool,
    /// The driver whose reference was put in force last, and the number of that configuration.
    in_force: Option<(Driver, u32)>,
    /// The reference of the pilot, if one was given.
    reference: Option<Value>,
    uncalibrated: bool,
    /// The last tick, and when it came.
    car: Option<(Instant, Box<State>)>,
}

impl DriveSession<'_> {
    fn attend(&mut self, mut source: Source, interrupt: &Interrupt) -> Result<ExitCode> {
        let mut events = Vec::new();
        let mut is_leaving = false;
        let mut was_driving = false;
        loop {
            let inputs = [source.as_fd(), self.session.as_fd(), self.watch.as_fd()];
            wait_to_read(inputs, WAIT)?;
            // The pad first: nothing else may delay a stop.
            if !self.pad.is_lost {
                source.read(&mut events);
            }
            for event in events.drain(..) {
                let holds = self.pad.driver().is_some();
                was_driving |= event == PadEvent::Lost && holds;
                if let Some(request) = self.pad.handle(Time(monotonic_ns()), event) {
                    self.act(request)?;
                }
            }
            while let Some(request) = self.pad.poll(Time(monotonic_ns())) {
                self.act(request)?;
            }
            while let Some(reply) = self.session.receive()? {
                self.answered(reply)?;
            }
            while let Some(reply) = self.watch.receive()? {
                match reply {
                    Reply::State(state) => self.car = Some((Instant::now(), state)),
                    // There may be too many watchers.
                    Reply::Answer(answer) => drop(answer.agreed()?),
                    _ => {}
                }
            }
            self.settle()?;
            if interrupt.is_raised() && !is_leaving {
                is_leaving = true;
                if self.pad.driver().is_some() {
                    self.pad.ended();
                    self.act(PadRequest::End)?;
                }
            }
            let is_over = match self.stage {
                Stage::Ending(since) => since.elapsed() > END,
                stage => stage == Stage::Off,
            };
            if is_over && self.pad.is_lost {
                let motor = was_driving.then_some(": the motor is at neutral");
                return Err(format!("the pad is gone{}", motor.unwrap_or_default()).into());
            }
            if is_over && is_leaving {
                let stopped = matches!(self.stage, Stage::Ending(_));
                return Ok(ended_as_wanted(!stopped));
            }
        }
    }

    fn act(&mut self, request: PadRequest) -> Result<()> {
        match request {
            PadRequest::Begin(driver) => return self.begin(driver),
            PadRequest::Hold => {
                if matches!(self.stage, Stage::Arming(_) | Stage::Driving(_)) {
                    self.session.send(&Request::Hold {})?;
                }
            }
            PadRequest::Velocity { speed, turn } => match self.stage {
                Stage::Driving(Driver::Sticks) => self.steer(speed, turn)?,
                // The car is armed with a fresh set-point, and at rest.
                Stage::Settling(Driver::Sticks, _) | Stage::Arming(Driver::Sticks) => {
                    self.steer(0.0, 0.0)?;
                }
                _ => {}
            },
            PadRequest::End => self.stop(&Request::DISARM)?,
            PadRequest::Halt => self.stop(&HALT)?,
            PadRequest::Stop => {
                self.ask(&Request::Stop {})?;
                self.stage = self.stage.stopped();
                print(EMERGENCY_STOPPED)?;
            }
            PadRequest::Note(note) => print(note)?,
        }
        Ok(())
    }

    fn begin(&mut self, driver: Driver) -> Result<()> {
        if matches!(self.stage, Stage::Ending(since) if since.elapsed() > END) {
            // Nothing was said of its end.
            self.stage = Stage::Off;
        }
        if self.stage != Stage::Off || self.is_asked {
            // The last drive has not ended yet.
            self.pad.ended();
            return Ok(());
        }
        self.stage = Stage::Changing(driver);
        if self.in_force.is_some_and(|(last, _)| last == driver) {
            // Another program may have changed it since.
            return self.question(&Request::Status {});
        }
        self.change(driver)
    }

    /// Asks for the reference of a driver.
    fn change(&mut self, driver: Driver) -> Result<()> {
        let change = match (driver, &self.reference) {
            (Driver::Sticks, _) => Request::SetReference {
                reference: json!(ReferenceSection::External {
                    setpoint_timeout_ms: SETPOINT_TIMEOUT_MS,
                }),
            },
            (Driver::Pilot, Some(reference)) => Request::SetReference {
                reference: reference.clone(),
            },
            (Driver::Pilot, None) => Request::Reload {},
        };
        self.in_force = None;
        self.question(&change)
    }

    /// Asks something about the configuration.
    fn question(&mut self, request: &Request) -> Result<()> {
        self.is_asked = true;
        Ok(self.session.send(request)?)
    }

    /// Arms a car that is ready.
    fn settle(&mut self) -> Result<()> {
        let Stage::Settling(driver, since) = self.stage else {
            return Ok(());
        };
        let car = self.car.as_ref().filter(|(at, _)| *at > since);
        if car.is_some_and(|(_, state)| state.mode == "ready") {
            self.stage = Stage::Arming(driver);
            return Ok(self.session.send(&Request::Arm(Arm {
                attendance: Some(Attendance::Hold),
                uncalibrated: self.uncalibrated,
                ..Arm::default()
            }))?);
        }
        if since.elapsed() > SETTLE {
            let reason = car.and_then(|(_, state)| state.preflight.clone());
            let reason = reason.unwrap_or("the daemon shows no state".into());
            self.refused(&format!("can't arm: {reason}"))?;
        }
        Ok(())
    }

    /// Stops a drive, or what leads to one.
    fn stop(&mut self, request: &Request) -> Result<()> {
        self.stage = self.stage.stopped();
        if self.stage == Stage::Off {
            return Ok(());
        }
        // If it fails, the end of this program ends the session, and with it the drive.
        self.ask(request)?;
        Ok(())
    }

    /// Asks on a connection of its own, for not too long: the session may wait for the board to
    /// arm.
    fn ask(&self, request: &Request) -> Result<Answer, ClientError> {
        ask_within(request, self.socket, ANSWER)
    }

    fn refused(&mut self, error: &str) -> Result<()> {
        self.pad.ended();
        self.stage = Stage::Off;
        print(error)
    }

    /// Handles a line of the session.
    fn answered(&mut self, reply: Reply) -> Result<()> {
        let answer = match reply {
            Reply::Answer(answer) => answer,
            Reply::Ended { ended, .. } => {
                self.pad.ended();
                self.stage = Stage::Off;
                let why = match ended.reason {
                    Some(word) if word == "requested" => word,
                    Some(word) => Why::of_word("host", &word).text.into(),
                    None => ended.mode,
                };
                return print(&format!("the drive has ended: {why}"));
            }
            _ => return Ok(()),
        };
        // The answer of a button that was released meanwhile.
        let is_asked = std::mem::take(&mut self.is_asked);
        let other_steers = answer.code == Some(Code::OtherSource);
        match (answer.agreed(), self.stage) {
            (Ok(answer), Stage::Changing(driver)) => {
                if let Some(number) = answer.configuration {
                    self.in_force = Some((driver, number));
                } else {
                    let number = answer.status.map(|status| status.configuration.number);
                    if self.in_force.map(|(_, ours)| ours) != number {
                        return self.change(driver);
                    }
                }
                self.stage = Stage::Settling(driver, Instant::now());
            }
            // The reference may have changed: ask again next time.
            (_, Stage::Off) if is_asked => self.in_force = None,
            (Ok(_), Stage::Arming(driver)) => {
                self.stage = Stage::Driving(driver);
                print(match driver {
                    Driver::Pilot => "the car drives itself",
                    Driver::Sticks => "the sticks drive the car",
                })?;
            }
            (Ok(_), _) => {}
            (Err(error), Stage::Driving(Driver::Sticks)) if other_steers => {
                // The sticks have no effect: a program drives the car.
                print(&error.to_string())?;
                self.stop(&HALT)?;
            }
            // A set-point without a reference for it, or a late renewal.
            (Err(_), Stage::Driving(_)) => {}
            (Err(error), _) => self.refused(&error.to_string())?,
        }
        Ok(())
    }

    /// Sends the velocity of P. Without a fresh heading none is sent, and the car stops.
    fn steer(&mut self, speed: f64, turn: f64) -> Result<()> {
        let car = self.car.as_ref();
        let car = car.filter(|(at, _)| at.elapsed() < HEADING_AGE);
        let Some(yaw) = car.and_then(|(_, state)| state.yaw_rad) else {
            return Ok(());
        };
        let velocity: Velocity = speed * direction(yaw + turn);
        Ok(self.session.send(&Request::Setpoint(Setpoint {
            velocity_m_s: Some([velocity.x, velocity.y]),
            time_ns: Some(monotonic_ns()),
            ..Setpoint::default()
        }))?)
    }
}

/// Puts the reference of the configuration in force again, as soon as the car stands.
fn restore(socket: &Path) {
    let begun = Instant::now();
    while ask_within(&Request::Reload {}, socket, ANSWER).is_err() && begun.elapsed() < RESTORE {
        thread::sleep(AGAIN);
    }
}

fn parse_silence(text: &str) -> Result<Duration, String> {
    duration_within(text, 0.2, 60.0)
}
