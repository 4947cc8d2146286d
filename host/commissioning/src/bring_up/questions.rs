//! Every question of the bring-up, in the order in which they come.
//!
//! Each comment says what the operator does or sees; "now" is the moment of the answer. The servo
//! stays where a jog left it: angles are read while the car is disarmed.

use crate::{Answers, Question};

const fn question(id: &'static str, text: String, answers: Answers) -> Question {
    Question { id, text, answers }
}

/// The car is lifted onto its stand. It stays there to the end of the bring-up.
pub(super) fn on_stand() -> Question {
    question(
        "on-stand",
        "Put the car on a stand in view of the cameras, all wheels clear of everything, and take \
         your hands off. Does it stand so?"
            .into(),
        Answers::YesNo,
    )
}

/// With a kill output: whether the ESC is without supply now.
pub(super) fn esc_dark() -> Question {
    question(
        "esc-dark",
        "The car is disarmed. Is the ESC off: no light, no sound?".into(),
        Answers::YesNo,
    )
}

/// With a kill output: whether the ESC had its supply in the last armed jog.
pub(super) fn esc_woke() -> Question {
    question(
        "esc-woke",
        "The car was armed until a moment ago. Was the ESC on during that time?".into(),
        Answers::YesNo,
    )
}

/// Without a kill output: whether there is a switch in the ESC's supply.
pub(super) fn kill_switch() -> Question {
    question(
        "kill-switch",
        "Can you cut the supply of the ESC without the board: a radio relay, a plug that you \
         reach with the wheels turning?"
            .into(),
        Answers::YesNo,
    )
}

/// The operator cuts the supply of the ESC about a second after the wheels begin to turn.
pub(super) fn cut_supply() -> Question {
    question(
        "cut-supply",
        "The wheels will turn. Cut the supply of the ESC a second after they begin. Ready?".into(),
        Answers::Begin,
    )
}

/// The supply of the ESC is on again, and the ESC ready, when this is answered.
pub(super) fn restore_supply() -> Question {
    question(
        "restore-supply",
        "Switch the supply of the ESC on again, and wait until the ESC has started. Done?".into(),
        Answers::Begin,
    )
}

/// The operator switches the ESC off, presses the board's reset, waits for two seconds,
/// and switches the ESC on.
pub(super) fn esc_after_board() -> Question {
    question(
        "esc-after-board",
        "Switch the ESC off. Press the reset of the board, wait for three seconds, switch the \
         ESC on. Done?"
            .into(),
        Answers::Begin,
    )
}

/// The operator presses the board's reset while the ESC stays on, and waits for three
/// seconds.
pub(super) fn board_after_esc() -> Question {
    question(
        "board-after-esc",
        "Leave the ESC on, and press the reset of the board. Done?".into(),
        Answers::Begin,
    )
}

/// Whether the driven wheels stood still since the last `Begin`.
pub(super) fn wheels_still() -> Question {
    question(
        "wheels-still",
        "Did the driven wheels stand still all the time?".into(),
        Answers::YesNo,
    )
}

/// To which side the front wheels point now, seen from behind the car.
pub(super) const SIDES: &[&str] = &["left", "straight", "right"];

/// To which side the front wheels point now.
pub(super) fn front_wheels() -> Question {
    question(
        "front-wheels",
        "Look from behind the car, in the direction of driving: where do the front wheels \
         point?"
            .into(),
        Answers::Choice(SIDES),
    )
}

/// The angle of the front wheels now, left positive.
pub(super) fn wheel_angle() -> Question {
    question(
        "wheel-angle",
        "Read the angle of the front wheels with a protractor, left is positive: the mean of the \
         left and the right wheel."
            .into(),
        Answers::Number {
            unit: "deg",
            range: [-60.0, 60.0],
        },
    )
}

/// Whether the wheels reached a mechanical stop at any moment since the last question.
pub(super) fn at_stop(pulse_us: u16) -> Question {
    question(
        "at-stop",
        format!(
            "The servo was at {pulse_us} us for a moment. Did it buzz, or did the wheels not \
             follow to the end?"
        ),
        Answers::YesNo,
    )
}

/// The answers to [`driven_wheels`].
pub(super) const WAYS: &[&str] = &["forward", "backward", "stood"];

/// How the driven wheels turned in the last jog.
pub(super) fn driven_wheels() -> Question {
    question(
        "driven-wheels",
        "How did the driven wheels turn just now: as for driving forward, or backward?".into(),
        Answers::Choice(WAYS),
    )
}

/// The operator opens the stop switch about a second after the wheels begin to turn.
pub(super) fn open_switch() -> Question {
    question(
        "open-switch",
        "The wheels will turn. Press the stop switch a second after they begin. Ready?".into(),
        Answers::Begin,
    )
}

/// The stop switch is closed again, and the board was reset.
pub(super) fn close_switch() -> Question {
    question(
        "close-switch",
        "Release the stop switch and press the reset of the board. Done?".into(),
        Answers::Begin,
    )
}

/// The operator pulls the serial cable about a second after the wheels begin to turn.
pub(super) fn unplug() -> Question {
    question(
        "unplug",
        "The wheels will turn. Pull the USB cable of the board a second after they begin. Ready?"
            .into(),
        Answers::Begin,
    )
}

/// The cable is plugged in again.
pub(super) fn plug_in() -> Question {
    question(
        "plug-in",
        "Plug the USB cable in again. Done?".into(),
        Answers::Begin,
    )
}

/// The operator presses the board's reset about a second after the wheels begin to turn.
pub(super) fn reset_at_speed() -> Question {
    question(
        "reset-at-speed",
        "The wheels will turn. Press the reset of the board a second after they begin. Ready?"
            .into(),
        Answers::Begin,
    )
}

/// The board was reset: an emergency stop is latched until then.
pub(super) fn clear_latch() -> Question {
    question(
        "clear-latch",
        "Press the reset of the board: the emergency stop is latched until then. Done?".into(),
        Answers::Begin,
    )
}

/// The answers to [`stopped_how`].
pub(super) const STOPS: &[&str] = &["at-once", "late", "not"];

/// When the motor stopped driving, counted from the operator's own action.
pub(super) fn stopped_how() -> Question {
    question(
        "stopped-how",
        "Did the motor stop driving at once (the wheels may roll on), later (it drove on for half \
         a second or more), or not?"
            .into(),
        Answers::Choice(STOPS),
    )
}
