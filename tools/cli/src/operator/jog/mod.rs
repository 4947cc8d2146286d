//! `singletrack jog`: bare pulses for servo and ESC, for as long as this command runs.

pub mod keys;

use std::{error::Error, process::ExitCode, time::Duration};

use clap::Args;
use singletrack_api::{Arm, Attendance, RENEWAL, Request};
use singletrack_control::Time;
use singletrackd::monotonic_ns;

use keys::{Keyboard, Pulses, next_key};

use crate::interrupt::Interrupt;
use crate::operator::{
    arm::{Drive, parse_time},
    control::ControlArgs,
    terminal::{RawTerminal, read_now},
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
pub fn run(args: &JogArgs) -> Result<ExitCode, Box<dyn Error>> {
    let interrupt = Interrupt::listen()?;
    // Before the board is armed: without a terminal it is not.
    let keyboard = args.keys.then(open_keyboard).transpose()?;
    let interval = if keyboard.is_some() { KEYS } else { RENEWAL };
    let mut drive = Drive::connect(&args.control, "jogging", interval)?;
    drive.held.connection.send(&Request::Arm(Arm {
        attendance: Some(Attendance::Hold),
        jog: true,
        ..Arm::default()
    }))?;
    let begun = Pulses {
        servo_us: args.servo_us,
        esc_us: args.esc_us,
    };
    // It takes keys one by one until it is dropped.
    let Some(_terminal) = keyboard else {
        return drive.attend(&interrupt, &request(begun), args.time);
    };
    let mut keyboard = Keyboard::new(begun, Time(monotonic_ns()));
    let mut bytes = Vec::new();
    drive.attend_with(&interrupt, args.time, || {
        read_now(&mut bytes)?;
        let now = Time(monotonic_ns());
        while let Some(key) = next_key(&mut bytes) {
            keyboard.handle(now, key);
        }
        let pulses = keyboard.pulses(now);
        Ok(pulses.map(|pulses| (request(pulses), note(pulses, keyboard.throttle_us))))
    })
}

fn open_keyboard() -> Result<RawTerminal, Box<dyn Error>> {
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
