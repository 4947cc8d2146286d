//! What a person does to a simulated car, as lines of text.

use core::{fmt, str::FromStr};

use crate::{HandMotion, LossKind, StartPose, World};

/// A line that says what a person does, such as `roll 0.5 0.4`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HandCommand {
    /// The car is moved: see [`HAND_COMMANDS`].
    Move(HandMotion),
    /// The switch of the ESC.
    Esc(bool),
    /// The plug of the battery.
    Battery(bool),
    /// The plug of the board's USB.
    Cable(bool),
    /// The stop switch: whether it is open.
    StopSwitch(bool),
    /// Something over the markers: whether they are covered.
    Markers(bool),
    /// The board's reset button.
    Reset,
    /// Nothing: what is seen is the answer to every command.
    Look,
}

/// The commands, for people. Lengths are in m, angles in degrees, times in s; a point is given
/// from the centre of mass, forward and left.
pub const HAND_COMMANDS: &str = "\
lift HEIGHT | put-down | roll DISTANCE SPEED | turn ANGLE FORWARD LEFT TIME [WANDER] | \
twist ANGLE FORWARD LEFT PERIOD TIME | tilt ROLL PITCH TIME | carry X Y YAW TIME | hold TIME | \
esc on/off | battery on/off | cable on/off | stop-switch open/closed | markers covered/visible | \
reset | look";

/// A line that is no command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown command; known: {HAND_COMMANDS}")]
pub struct UnknownHandCommand;

impl FromStr for HandCommand {
    type Err = UnknownHandCommand;

    fn from_str(line: &str) -> Result<Self, UnknownHandCommand> {
        let mut words = line.split_whitespace();
        let name = words.next().ok_or(UnknownHandCommand)?;
        let words: Vec<&str> = words.collect();
        let finite = |word: &&str| word.parse().ok().filter(|number: &f64| number.is_finite());
        let numbers: Option<Vec<f64>> = words.iter().map(finite).collect();
        if let Some(motion) = numbers.and_then(|numbers| motion(name, &numbers)) {
            return Ok(Self::Move(motion));
        }
        Ok(match (name, words.as_slice()) {
            ("esc", [state]) => Self::Esc(is(state, ["on", "off"])?),
            ("battery", [state]) => Self::Battery(is(state, ["on", "off"])?),
            ("cable", [state]) => Self::Cable(is(state, ["on", "off"])?),
            ("stop-switch", [state]) => Self::StopSwitch(is(state, ["open", "closed"])?),
            ("markers", [state]) => Self::Markers(is(state, ["covered", "visible"])?),
            ("reset", []) => Self::Reset,
            ("look", []) => Self::Look,
            _ => return Err(UnknownHandCommand),
        })
    }
}

/// Whether a word is the first of two.
fn is(word: &str, [yes, no]: [&str; 2]) -> Result<bool, UnknownHandCommand> {
    match word {
        word if word == yes => Ok(true),
        word if word == no => Ok(false),
        _ => Err(UnknownHandCommand),
    }
}

fn motion(name: &str, numbers: &[f64]) -> Option<HandMotion> {
    Some(match (name, numbers) {
        ("lift", &[height_m]) => HandMotion::Lift { height_m },
        ("put-down", &[]) => HandMotion::PutDown,
        ("roll", &[distance_m, speed_m_s]) => HandMotion::Roll {
            distance_m,
            speed_m_s,
        },
        ("turn", &[angle, forward, left, for_s, ref wander @ ..]) if wander.len() < 2 => {
            HandMotion::Turn {
                angle_rad: angle.to_radians(),
                about_m: [forward, left],
                wander_m: wander.first().copied().unwrap_or_default(),
                for_s,
            }
        }
        ("twist", &[angle, forward, left, period_s, for_s]) => HandMotion::Twist {
            amplitude_rad: angle.to_radians(),
            about_m: [forward, left],
            period_s,
            for_s,
        },
        ("tilt", &[roll, pitch, for_s]) => HandMotion::Tilt {
            roll_rad: roll.to_radians(),
            pitch_rad: pitch.to_radians(),
            for_s,
        },
        ("carry", &[x_m, y_m, yaw, for_s]) => HandMotion::Carry {
            to: StartPose {
                x_m,
                y_m,
                yaw_rad: yaw.to_radians(),
            },
            for_s,
        },
        ("hold", &[for_s]) => HandMotion::Hold { for_s },
        _ => return None,
    })
}

impl HandCommand {
    /// Does it, or begins with it.
    pub fn apply(self, world: &mut World) {
        match self {
            Self::Move(motion) => world.car.begin_by_hand(motion),
            Self::Esc(on) => world.car.set_esc_power(on),
            Self::Battery(on) => world.car.set_battery_plugged(on),
            Self::Cable(on) => world.set_cable(on),
            Self::StopSwitch(open) => world.board.stop_input_open = open,
            Self::Markers(covered) => {
                world.cameras.faults.loss = covered.then_some(LossKind::Occluded);
            }
            Self::Reset => world.press_reset(),
            Self::Look => {}
        }
    }
}

/// What a person sees of the car. Nothing of it is misread.
///
/// Its text is `key value` pairs on one line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Angle of the front wheels, in degrees; positive is to the left.
    pub steering_deg: f64,
    /// Speed of the driven wheels, in m/s.
    pub wheels_m_s: f64,
    /// Whether the motor is driven.
    pub driven: bool,
    /// Whether the servo buzzes against a stop.
    pub buzzes: bool,
    /// Whether the ESC has its supply.
    pub esc: bool,
    /// Voltage of the battery, in V.
    pub battery_v: f64,
    /// Position of the centre of mass along x, in m.
    pub x_m: f64,
    /// Position of the centre of mass along y, in m.
    pub y_m: f64,
    /// Yaw of the car, in degrees.
    pub yaw_deg: f64,
    /// Whether the car is in hands or on a stand.
    pub held: bool,
    /// Whether its wheels turn freely.
    pub wheels_up: bool,
}

impl Seen {
    /// What is seen now.
    pub fn of(world: &World) -> Self {
        let (truth, car) = (world.truth(), &world.car);
        Self {
            steering_deg: truth.steering.to_degrees(),
            wheels_m_s: truth.wheel_speed,
            driven: car.is_driven(),
            buzzes: car.servo_strains(),
            esc: car.esc_has_power(),
            battery_v: truth.battery_v,
            x_m: truth.x,
            y_m: truth.y,
            yaw_deg: truth.yaw.to_degrees(),
            held: truth.held,
            wheels_up: car.wheels_are_up(),
        }
    }
}

impl fmt::Display for Seen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let yes = |is: bool| if is { "yes" } else { "no" };
        write!(
            f,
            "steering_deg {:.2} wheels_m_s {:.3} driven {} buzzes {} esc {} battery_v {:.2} \
             x_m {:.4} y_m {:.4} yaw_deg {:.2} held {} wheels_up {}",
            self.steering_deg,
            self.wheels_m_s,
            yes(self.driven),
            yes(self.buzzes),
            if self.esc { "on" } else { "off" },
            self.battery_v,
            self.x_m,
            self.y_m,
            self.yaw_deg,
            yes(self.held),
            yes(self.wheels_up),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_commands_and_everything_else_is_refused() {
        assert_eq!(
            "roll -0.5 0.4".parse(),
            Ok(HandCommand::Move(HandMotion::Roll {
                distance_m: -0.5,
                speed_m_s: 0.4
            }))
        );
        assert_eq!(
            "put-down".parse(),
            Ok(HandCommand::Move(HandMotion::PutDown))
        );
        assert_eq!("  esc   off ".parse(), Ok(HandCommand::Esc(false)));
        assert_eq!(
            "stop-switch open".parse(),
            Ok(HandCommand::StopSwitch(true))
        );
        for line in [
            "",
            "roll 1",
            "roll a b",
            "roll nan 1",
            "esc maybe",
            "fly",
            "look here",
        ] {
            assert_eq!(
                line.parse::<HandCommand>(),
                Err(UnknownHandCommand),
                "{line}"
            );
        }
    }

    #[test]
    fn what_is_done_is_seen() {
        let mut world = World::new(crate::SimulationConfig::default()).unwrap();
        for line in ["lift 0.1", "esc off", "battery off"] {
            line.parse::<HandCommand>().unwrap().apply(&mut world);
        }
        world.advance_to(1_100_000);
        let text = Seen::of(&world).to_string();
        assert!(
            text.contains("esc off") && text.contains("battery_v 0.00"),
            "{text}"
        );
        assert!(text.ends_with("held yes wheels_up yes"), "{text}");
    }
}
