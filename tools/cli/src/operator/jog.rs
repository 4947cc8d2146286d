//! `singletrack jog`: bare pulses for servo and ESC, for as long as this command runs.
//!
//! A terminal does not say when a key is released. It repeats a key that is held: after a first
//! delay of 0.2 to 0.7 s, then some 30 times a second. The repetition is the dead-man switch of
//! the motor: it runs from the second event of a key on, and stops when none comes for 0.15 s. A
//! tap does not turn it. The servo keeps its position.

use std::{process::ExitCode, time::Duration};

use clap::Args;
use singletrack_api::{Arm, Attendance, RENEWAL, Request};
use singletrack_control::Time;
use singletrack_protocol::JOG_LIMIT_US;
use singletrackd::monotonic_ns;

use crate::{
    Result,
    interrupt::Interrupt,
    operator::{
        arm::{CTRL_C, Drive, parse_time},
        control::ControlArgs,
        terminal::{RawTerminal, read_now},
    },
};

/// Options of `singletrack jog`.
#[derive(Clone, Debug, Args)]
pub struct JogArgs {
    #[command(flatten)]
    control: ControlArgs,
    /// Pulse of the steering servo, in us
    #[arg(long = "servo", value_name = "US", value_parser = clap::value_parser!(u16).range(800..=2_200))]
    servo_us: u16,
    /// Pulse of the ESC, in us; the board gives at most 150 us more or less than neutral
    #[arg(long = "esc", value_name = "US", value_parser = clap::value_parser!(u16).range(800..=2_200))]
    esc_us: u16,
    /// End after this time, such as 2s; otherwise with Ctrl-C
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_time)]
    time: Option<Duration>,
    /// Jog with the keyboard: the servo begins with --servo, and --esc is the neutral. The arrow
    /// keys to the sides move the servo; the motor turns while the arrow up or down is held. + and
    /// - change its pulse, c centres the servo, q ends
    #[arg(long)]
    keys: bool,
}

/// Interval of the pulses from the keyboard.
const KEYS: Duration = Duration::from_millis(40);

/// Arms to jog and renews the pulses ten times a second. The motor goes to neutral 0.25 s after
/// the last renewal, however this command ends.
///
/// # Errors
///
/// When the board can't be armed, or the connection is lost; the reason is the daemon's.
pub fn run(args: &JogArgs) -> Result<ExitCode> {
    let interrupt = Interrupt::listen()?;
    // Before the board is armed: without a terminal it is not.
    let keyboard = args.keys.then(open_keyboard).transpose()?;
    let interval = if keyboard.is_some() { KEYS } else { RENEWAL };
    let mut drive = Drive::connect(&args.control, interrupt, "jogging", interval)?;
    drive.held.connection.send(&Request::Arm(Arm {
        attendance: Some(Attendance::Hold),
        jog: true,
        ..Arm::default()
    }))?;
    let (servo_us, esc_us) = (args.servo_us, args.esc_us);
    let begun = Pulses { servo_us, esc_us };
    // It takes keys one by one until it is dropped.
    let Some(_terminal) = keyboard else {
        return drive.attend(args.time, || Ok(Some((request(begun), CTRL_C.to_owned()))));
    };
    let mut keyboard = Keyboard::new(begun, Time(monotonic_ns()));
    let mut bytes = Vec::new();
    drive.attend(args.time, || {
        read_now(&mut bytes)?;
        let now = Time(monotonic_ns());
        while let Some(key) = next_key(&mut bytes) {
            keyboard.handle(now, key);
        }
        let pulses = keyboard.pulses(now);
        Ok(pulses.map(|pulses| (request(pulses), note(pulses, keyboard.throttle_us))))
    })
}

fn open_keyboard() -> Result<RawTerminal> {
    RawTerminal::open()?.ok_or_else(|| {
        "--keys needs a terminal: the repetition of a held key is the dead-man switch".into()
    })
}

/// The pulses for the person.
fn note(pulses: Pulses, throttle_us: u16) -> String {
    let Pulses { servo_us, esc_us } = pulses;
    format!("servo {servo_us} us, ESC {esc_us} us (arrows up, down: {throttle_us} us)")
}

/// The pulses for the daemon.
const fn request(pulses: Pulses) -> Request {
    let Pulses { servo_us, esc_us } = pulses;
    Request::Jog { servo_us, esc_us }
}

/// A key that counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// Motor forward, while it is held.
    Up,
    /// Motor backward, while it is held.
    Down,
    /// A step of the servo to smaller pulses.
    Left,
    /// A step of the servo to larger pulses.
    Right,
    /// A larger ESC pulse, for the next press.
    More,
    /// A smaller ESC pulse, for the next press.
    Less,
    /// The servo back to where it began.
    Centre,
    /// The end.
    Quit,
    /// Any other key: the motor stops.
    Other,
}

/// Pulses for servo and ESC, in us.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulses {
    /// Servo pulse.
    pub servo_us: u16,
    /// ESC pulse.
    pub esc_us: u16,
}

/// The longest delay before a terminal repeats a key that is held.
const FIRST_REPEAT: Duration = Duration::from_millis(800);
/// The longest time between two repetitions.
const REPEAT: Duration = Duration::from_millis(150);
/// Jogging ends this long after the last key.
const UNATTENDED: Duration = Duration::from_secs(60);

/// A step of the servo, and one of the ESC pulse's distance from neutral, in us.
const SERVO_STEP_US: u16 = 5;
const ESC_STEP_US: u16 = 5;
/// Distance of the first ESC pulse from neutral, in us.
const FIRST_US: u16 = 40;
/// The shortest and the longest servo pulse, in us.
const SERVO_US: [u16; 2] = [800, 2_200];

/// The keys of a person who jogs.
#[derive(Clone, Copy, Debug)]
pub struct Keyboard {
    begun: Pulses,
    servo_us: u16,
    /// Distance of the ESC pulse from neutral while a key is held, us.
    pub throttle_us: u16,
    /// The last key of the motor, its time, and whether it was a repetition.
    motor: Option<(Key, Time, bool)>,
    heard: Time,
    is_over: bool,
}

impl Keyboard {
    /// Begins with these pulses: that of the ESC is its neutral.
    pub const fn new(begun: Pulses, now: Time) -> Self {
        Self {
            begun,
            servo_us: begun.servo_us,
            throttle_us: FIRST_US,
            motor: None,
            heard: now,
            is_over: false,
        }
    }

    /// Handles a key that the terminal gave.
    pub fn handle(&mut self, now: Time, key: Key) {
        self.heard = now;
        let [least, most] = SERVO_US;
        if matches!(key, Key::Up | Key::Down) {
            let repeats = self.motor.is_some_and(|(last, at, repeated)| {
                let longest = if repeated { REPEAT } else { FIRST_REPEAT };
                last == key && since(now, at) <= longest
            });
            self.motor = Some((key, now, repeats));
            return;
        }
        // A terminal repeats one key at a time: the motor's is not held any more.
        self.motor = None;
        match key {
            Key::Left => self.servo_us = self.servo_us.saturating_sub(SERVO_STEP_US).max(least),
            Key::Right => self.servo_us = (self.servo_us + SERVO_STEP_US).min(most),
            Key::More => self.throttle_us = (self.throttle_us + ESC_STEP_US).min(JOG_LIMIT_US),
            Key::Less => self.throttle_us = self.throttle_us.saturating_sub(ESC_STEP_US),
            Key::Centre => self.servo_us = self.begun.servo_us,
            Key::Quit => self.is_over = true,
            Key::Other | Key::Up | Key::Down => {}
        }
    }

    /// The pulses at `now`; `None` once jogging is over.
    pub fn pulses(&self, now: Time) -> Option<Pulses> {
        if self.is_over || since(now, self.heard) > UNATTENDED {
            return None;
        }
        let neutral_us = self.begun.esc_us;
        let esc_us = match self.motor {
            Some((key, at, true)) if since(now, at) <= REPEAT => match key {
                Key::Down => neutral_us.saturating_sub(self.throttle_us),
                _ => neutral_us.saturating_add(self.throttle_us),
            },
            _ => neutral_us,
        };
        let servo_us = self.servo_us;
        Some(Pulses { servo_us, esc_us })
    }
}

fn since(now: Time, then: Time) -> Duration {
    Duration::from_nanos(now.0.saturating_sub(then.0))
}

/// Takes the next complete key from the bytes of a terminal. The beginning of an arrow key stays.
pub fn next_key(bytes: &mut Vec<u8>) -> Option<Key> {
    let (key, length) = match bytes[..] {
        [] | [0x1b] | [0x1b, b'[' | b'O'] => return None,
        [0x1b, b'[' | b'O', b'A', ..] => (Key::Up, 3),
        [0x1b, b'[' | b'O', b'B', ..] => (Key::Down, 3),
        [0x1b, b'[' | b'O', b'C', ..] => (Key::Right, 3),
        [0x1b, b'[' | b'O', b'D', ..] => (Key::Left, 3),
        [0x1b, b'[' | b'O', ..] => (Key::Other, 3),
        [b'+' | b'=', ..] => (Key::More, 1),
        [b'-', ..] => (Key::Less, 1),
        [b'c', ..] => (Key::Centre, 1),
        [b'q', ..] => (Key::Quit, 1),
        _ => (Key::Other, 1),
    };
    bytes.drain(..length);
    Some(key)
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn at(ms: u64) -> Time {
        Time(ms * 1_000_000)
    }

    const BEGUN: Pulses = Pulses {
        servo_us: 1_500,
        esc_us: 1_490,
    };

    fn esc(keyboard: &Keyboard, ms: u64) -> u16 {
        keyboard.pulses(at(ms)).unwrap().esc_us
    }

    #[test]
    fn a_tap_does_not_turn_the_motor_and_a_held_key_does_until_it_is_released() {
        let mut keyboard = Keyboard::new(BEGUN, at(0));
        keyboard.handle(at(100), Key::Up);
        assert_eq!(esc(&keyboard, 100), 1_490);
        // Two taps, further apart than the first delay.
        keyboard.handle(at(950), Key::Up);
        assert_eq!(esc(&keyboard, 950), 1_490);
        // Held: the first repetition comes after half a second.
        keyboard.handle(at(1_450), Key::Up);
        assert_eq!(esc(&keyboard, 1_450), 1_530);
        for ms in (1_480..3_000).step_by(30) {
            keyboard.handle(at(ms), Key::Up);
            assert_eq!(esc(&keyboard, ms + 29), 1_530);
        }
        assert_eq!(esc(&keyboard, 2_980 + 150), 1_530);
        assert_eq!(esc(&keyboard, 2_980 + 151), 1_490);
        // The next press must be held again.
        keyboard.handle(at(3_200), Key::Up);
        assert_eq!(esc(&keyboard, 3_200), 1_490);
    }

    #[test]
    fn any_other_key_stops_the_motor_at_once() {
        for other in [Key::Down, Key::Left, Key::More, Key::Other] {
            let mut keyboard = Keyboard::new(BEGUN, at(0));
            for ms in [0, 400, 430] {
                keyboard.handle(at(ms), Key::Up);
            }
            assert_eq!(esc(&keyboard, 440), 1_530);
            keyboard.handle(at(450), other);
            assert_eq!(esc(&keyboard, 450), 1_490, "{other:?}");
        }
    }

    #[test]
    fn backward_is_below_neutral_and_no_pulse_is_further_off_than_the_board_allows() {
        let mut keyboard = Keyboard::new(BEGUN, at(0));
        for _ in 0..100 {
            keyboard.handle(at(0), Key::More);
        }
        assert_eq!(keyboard.throttle_us, 150);
        for ms in [100, 500] {
            keyboard.handle(at(ms), Key::Down);
        }
        assert_eq!(esc(&keyboard, 500), 1_340);
        for _ in 0..100 {
            keyboard.handle(at(600), Key::Less);
        }
        assert_eq!(keyboard.throttle_us, 0);
    }

    #[test]
    fn the_servo_keeps_its_position_within_its_pulses_and_goes_back() {
        let mut keyboard = Keyboard::new(BEGUN, at(0));
        let servo = |keyboard: &Keyboard| keyboard.pulses(at(1)).unwrap().servo_us;
        keyboard.handle(at(0), Key::Left);
        assert_eq!(servo(&keyboard), 1_495);
        for _ in 0..1_000 {
            keyboard.handle(at(0), Key::Right);
        }
        assert_eq!(servo(&keyboard), 2_200);
        keyboard.handle(at(0), Key::Centre);
        assert_eq!(servo(&keyboard), 1_500);
        for _ in 0..1_000 {
            keyboard.handle(at(0), Key::Left);
        }
        assert_eq!(servo(&keyboard), 800);
    }

    #[test]
    fn it_ends_by_its_key_and_when_unattended() {
        let mut keyboard = Keyboard::new(BEGUN, at(0));
        assert!(keyboard.pulses(at(60_000)).is_some());
        assert_eq!(keyboard.pulses(at(60_001)), None);
        keyboard.handle(at(1), Key::Quit);
        assert_eq!(keyboard.pulses(at(1)), None);
    }

    #[test]
    fn the_bytes_of_a_terminal_are_keys_also_in_parts() {
        let mut bytes = b"\x1b[A\x1bOBq\x1b[5+".to_vec();
        let keys: Vec<Key> = std::iter::from_fn(|| next_key(&mut bytes)).collect();
        assert_eq!(keys, [Key::Up, Key::Down, Key::Quit, Key::Other, Key::More]);
        for part in [b"\x1b".as_slice(), b"[", b"C"] {
            assert_eq!(next_key(&mut bytes), None);
            bytes.extend(part);
        }
        assert_eq!(next_key(&mut bytes), Some(Key::Right));
        assert!(bytes.is_empty());
    }
}
