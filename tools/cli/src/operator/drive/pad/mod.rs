//! Turns the events of a game-pad into requests to the daemon, without a device or a clock: `now`
//! is an argument.
//!
//! While one button is held, the car drives itself; while another one is held, the sticks drive
//! it. A button counts only after it was seen released, so that a stuck one starts nothing; after
//! every drive both must be released again. The sticks must be at their centre when they take
//! over. A pad that is lost, or silent for too long, halts the car.

use std::time::Duration;

use singletrack_control::Time;

/// What counts of a pad, by the codes of the kernel's input events, from
/// `linux/input-event-codes.h`: the button for an emergency stop (`BTN_EAST`), the one that gives
/// the sticks (`BTN_TL`), the one that lets the car drive itself (`BTN_TR`), the stick for the
/// speed (`ABS_Y`; up is forward) and the one for the direction (`ABS_RX`).
pub(crate) const BTN_EAST: u16 = 0x131;
pub(crate) const BTN_TL: u16 = 0x136;
pub(crate) const BTN_TR: u16 = 0x137;
pub(crate) const ABS_Y: u16 = 0x01;
pub(crate) const ABS_RX: u16 = 0x03;

/// Angle between the heading and the velocity of P at the end of the stick, rad.
const MAX_TURN: f64 = 0.4;

/// An event of a pad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PadEvent {
    /// A button was pressed or released.
    Button {
        /// Its code.
        code: u16,
        /// Whether it is pressed now.
        pressed: bool,
    },
    /// A stick moved.
    Axis {
        /// Its code.
        code: u16,
        /// -1 to 1; zero at rest. Up and left are negative.
        value: f64,
    },
    /// Any other event: the pad is still there.
    Other,
    /// Events were lost: the state of buttons and sticks is unknown.
    Dropped,
    /// The pad is gone.
    Lost,
}

/// Who steers the car.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Driver {
    /// The pilot, along its reference.
    Pilot,
    /// The sticks.
    Sticks,
}

/// A request of the pad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PadRequest {
    /// Arm the car for this driver, and hold the drive.
    Begin(Driver),
    /// Renew the drive.
    Hold,
    /// The velocity of P while the sticks drive: relative to the heading of the car.
    Velocity {
        /// m/s, not negative.
        speed: f64,
        /// From the heading to the velocity, rad; positive to the left.
        turn: f64,
    },
    /// The button was released: slow down, stop and disarm.
    End,
    /// The pad is lost: neutral at once.
    Halt,
    /// The stop button: neutral until the board is reset.
    Stop,
    /// A note for the operator; the car is not affected.
    Note(&'static str),
}

/// Why a button has no effect: it was pressed from the beginning, or since the last drive.
pub const RELEASE_FIRST: &str = "release both shoulder buttons first";
/// The note that both buttons are pressed.
pub const ONE_BUTTON: &str = "hold one shoulder button, not both";
/// The note that the sticks are not at their centre.
pub const CENTRE_STICKS: &str = "let the sticks go to their centre first";
/// The note that the pad was silent.
pub const SILENT: &str = "the pad was silent for too long";

/// Dead zone of a stick, as a share of its way.
const CENTRE: f64 = 0.15;

/// Interval of the renewals, and of the velocities.
const RENEWAL: Duration = Duration::from_millis(50);
const VELOCITY: Duration = Duration::from_millis(20);

/// A button that is held to drive.
#[derive(Clone, Copy, Debug, Default)]
struct DeadMan {
    pressed: bool,
    /// Whether it has been seen released since the last drive.
    released: bool,
}

impl DeadMan {
    const fn set(&mut self, pressed: bool) {
        self.pressed = pressed;
        if !pressed {
            self.released = true;
        }
    }

    /// Whether it asks for a drive.
    const fn counts(self) -> bool {
        self.pressed && self.released
    }
}

/// A drive that the pad holds.
#[derive(Clone, Copy, Debug)]
struct Held {
    driver: Driver,
    renewed: Time,
    steered: Time,
}

/// A pad.
#[derive(Clone, Debug, Default)]
pub struct Pad {
    /// Speed of P at the end of the stick, m/s.
    max_speed: f64,
    /// The longest silence while it holds a drive.
    silence: Duration,
    drive: DeadMan,
    sticks: DeadMan,
    /// Positions of the sticks; `None` until they are known.
    speed: Option<f64>,
    turn: Option<f64>,
    heard: Time,
    held: Option<Held>,
    /// Whether the pad is gone.
    pub is_lost: bool,
    /// The last note, so that each is given once.
    note: Option<&'static str>,
    /// The pad was silent, which is still to be said.
    was_silent: bool,
}

impl Pad {
    /// A pad in an unknown state: no button counts before its first release. At the end of the
    /// stick P has `max_speed`, m/s; a pad that holds a drive may be silent for `silence`.
    pub fn new(max_speed: f64, silence: Duration, now: Time) -> Self {
        Self {
            max_speed,
            silence,
            heard: now,
            ..Self::default()
        }
    }

    /// The driver whose drive the pad holds.
    pub fn driver(&self) -> Option<Driver> {
        self.held.map(|held| held.driver)
    }

    /// The drive has ended, or did not begin: the next one needs a new press.
    pub const fn ended(&mut self) {
        self.held = None;
        self.drive.released = !self.drive.pressed;
        self.sticks.released = !self.sticks.pressed;
    }

    /// Handles an event. Returns a request that can't wait for the next [`poll`](Self::poll).
    pub fn handle(&mut self, now: Time, event: PadEvent) -> Option<PadRequest> {
        match event {
            PadEvent::Lost => {
                self.is_lost = true;
                return self.let_go(PadRequest::Halt);
            }
            PadEvent::Dropped => {
                let request = self.let_go(PadRequest::Halt);
                // An unknown button does not count as released.
                self.drive = DeadMan::default();
                self.sticks = DeadMan::default();
                (self.speed, self.turn) = (None, None);
                return request;
            }
            PadEvent::Button { code, pressed } => match code {
                BTN_EAST if pressed => {
                    self.ended();
                    return Some(PadRequest::Stop);
                }
                BTN_TR => self.drive.set(pressed),
                BTN_TL => self.sticks.set(pressed),
                _ => {}
            },
            PadEvent::Axis { code, value } => {
                // A value that is not finite counts as an unknown position.
                let value = value.is_finite().then(|| value.clamp(-1.0, 1.0));
                match code {
                    ABS_Y => self.speed = value,
                    ABS_RX => self.turn = value,
                    _ => {}
                }
            }
            PadEvent::Other => {}
        }
        self.heard = now;
        let held = self.held?;
        let goes_on = match held.driver {
            Driver::Pilot => self.drive.pressed && !self.sticks.pressed,
            Driver::Sticks => self.sticks.pressed && !self.drive.pressed,
        };
        if goes_on {
            None
        } else {
            self.let_go(PadRequest::End)
        }
    }

    /// The next request that is due at `now`; call it until there is none.
    pub fn poll(&mut self, now: Time) -> Option<PadRequest> {
        if self.is_lost {
            return None;
        }
        let Some(mut held) = self.held else {
            return self.begin(now);
        };
        if since(now, self.heard) > self.silence {
            self.ended();
            self.was_silent = true;
            return Some(PadRequest::Halt);
        }
        if since(now, held.renewed) >= RENEWAL {
            held.renewed = now;
            self.held = Some(held);
            return Some(PadRequest::Hold);
        }
        if held.driver == Driver::Sticks && since(now, held.steered) >= VELOCITY {
            held.steered = now;
            self.held = Some(held);
            return Some(self.velocity());
        }
        None
    }

    fn begin(&mut self, now: Time) -> Option<PadRequest> {
        if std::mem::take(&mut self.was_silent) {
            self.note = Some(SILENT);
            return Some(PadRequest::Note(SILENT));
        }
        let driver = match (self.drive.pressed, self.sticks.pressed) {
            (false, false) => {
                self.note = None;
                return None;
            }
            (true, true) => return self.noted(ONE_BUTTON),
            (true, false) if self.drive.counts() => Driver::Pilot,
            (false, true) if self.sticks.counts() => {
                if !(is_centred(self.speed) && is_centred(self.turn)) {
                    return self.noted(CENTRE_STICKS);
                }
                Driver::Sticks
            }
            _ => return self.noted(RELEASE_FIRST),
        };
        self.note = None;
        self.held = Some(Held {
            driver,
            renewed: now,
            steered: now,
        });
        Some(PadRequest::Begin(driver))
    }

    /// Each note once, until the buttons are released.
    fn noted(&mut self, note: &'static str) -> Option<PadRequest> {
        if self.note == Some(note) || self.note == Some(SILENT) {
            return None;
        }
        self.note = Some(note);
        Some(PadRequest::Note(note))
    }

    fn let_go(&mut self, request: PadRequest) -> Option<PadRequest> {
        let held = self.held.is_some();
        self.ended();
        held.then_some(request)
    }

    /// At rest while a stick is unknown.
    fn velocity(&self) -> PadRequest {
        let (speed, turn) = self.speed.zip(self.turn).unwrap_or_default();
        // Never backward: the law would turn the car round.
        let speed = self.max_speed * beyond_centre(-speed).max(0.0);
        let turn = MAX_TURN * beyond_centre(-turn);
        PadRequest::Velocity { speed, turn }
    }
}

fn since(now: Time, then: Time) -> Duration {
    Duration::from_nanos(now.0.saturating_sub(then.0))
}

fn is_centred(axis: Option<f64>) -> bool {
    axis.is_some_and(|axis| axis.abs() < CENTRE)
}

/// The position of a stick, zero at the edge of its dead zone.
fn beyond_centre(axis: f64) -> f64 {
    let way = (axis.abs() - CENTRE).max(0.0) / (1.0 - CENTRE);
    way.copysign(axis)
}

#[cfg(test)]
mod tests;
