//! Every question of the bring-up, in the order in which they come, and how a step asks them.
//!
//! Each comment says what the operator does or sees; "now" is the moment of the answer. The servo
//! stays where a jog left it: angles are read while the car is disarmed.

use crate::{Answer, Answers, Bench, Question, Refused, Trouble, finding::failed};

/// The car is lifted onto its stand. It stays there to the end of the bring-up.
pub(super) const ON_STAND: Question = Question::yes_no(
    "on-stand",
    "Put the car on a stand in view of the cameras, all wheels clear of everything, and take \
         your hands off. Does it stand so?",
);

/// With a kill output: whether the ESC is without supply now.
pub(super) const ESC_DARK: Question = Question::yes_no(
    "esc-dark",
    "The car is disarmed. Is the ESC off: no light, no sound?",
);

/// With a kill output: whether the ESC had its supply in the last armed jog.
pub(super) const ESC_WOKE: Question = Question::yes_no(
    "esc-woke",
    "The car was armed until a moment ago. Was the ESC on during that time?",
);

/// Without a kill output: whether there is a switch in the ESC's supply.
pub(super) const KILL_SWITCH: Question = Question::yes_no(
    "kill-switch",
    "Can you cut the supply of the ESC without the board: a radio relay, a plug that you \
         reach with the wheels turning?",
);

/// The operator cuts the supply of the ESC about a second after the wheels begin to turn.
pub(super) const CUT_SUPPLY: Question = Question::begin(
    "cut-supply",
    "The wheels will turn. Cut the supply of the ESC a second after they begin. Ready?",
);

/// The supply of the ESC is on again, and the ESC ready, when this is answered.
pub(super) const RESTORE_SUPPLY: Question = Question::begin(
    "restore-supply",
    "Switch the supply of the ESC on again, and wait until the ESC has started. Done?",
);

/// The operator switches the ESC off, presses the board's reset, waits for two seconds,
/// and switches the ESC on.
pub(super) const ESC_AFTER_BOARD: Question = Question::begin(
    "esc-after-board",
    "Switch the ESC off. Press the reset of the board, wait for three seconds, switch the \
         ESC on. Done?",
);

/// The operator presses the board's reset while the ESC stays on, and waits for three
/// seconds.
pub(super) const BOARD_AFTER_ESC: Question = Question::begin(
    "board-after-esc",
    "Leave the ESC on, and press the reset of the board. Done?",
);

/// Whether the driven wheels stood still since the last `Begin`.
pub(super) const WHEELS_STILL: Question = Question::yes_no(
    "wheels-still",
    "Did the driven wheels stand still all the time?",
);

/// To which side the front wheels point now, seen from behind the car.
pub(super) const SIDES: &[&str] = &["left", "straight", "right"];

/// To which side the front wheels point now.
pub(super) const FRONT_WHEELS: Question = Question::new(
    "front-wheels",
    "Look from behind the car, in the direction of driving: where do the front wheels \
         point?",
    Answers::Choice(SIDES),
);

/// The angle of the front wheels now, left positive.
pub(super) const WHEEL_ANGLE: Question = Question::new(
    "wheel-angle",
    "Read the angle of the front wheels with a protractor, left is positive: the mean of the \
         left and the right wheel.",
    Answers::Number {
        unit: "deg",
        range: [-60.0, 60.0],
    },
);

/// Whether the wheels reached a mechanical stop at any moment since the last question.
pub(super) fn at_stop(pulse_us: u16) -> Question {
    Question {
        id: "at-stop",
        text: format!(
            "The servo was at {pulse_us} us for a moment. Did it buzz, or did the wheels not \
             follow to the end?"
        )
        .into(),
        answers: Answers::YesNo,
    }
}

/// The answers to [`DRIVEN_WHEELS`].
pub(super) const WAYS: &[&str] = &["forward", "backward", "stood"];

/// How the driven wheels turned in the last jog.
pub(super) const DRIVEN_WHEELS: Question = Question::new(
    "driven-wheels",
    "How did the driven wheels turn just now: as for driving forward, or backward?",
    Answers::Choice(WAYS),
);

/// The operator opens the stop switch about a second after the wheels begin to turn.
pub(super) const OPEN_SWITCH: Question = Question::begin(
    "open-switch",
    "The wheels will turn. Press the stop switch a second after they begin. Ready?",
);

/// The stop switch is closed again, and the board was reset.
pub(super) const CLOSE_SWITCH: Question = Question::begin(
    "close-switch",
    "Release the stop switch and press the reset of the board. Done?",
);

/// The operator pulls the serial cable about a second after the wheels begin to turn.
pub(super) const UNPLUG: Question = Question::begin(
    "unplug",
    "The wheels will turn. Pull the USB cable of the board a second after they begin. Ready?",
);

/// The cable is plugged in again.
pub(super) const PLUG_IN: Question =
    Question::begin("plug-in", "Plug the USB cable in again. Done?");

/// The operator presses the board's reset about a second after the wheels begin to turn.
pub(super) const RESET_AT_SPEED: Question = Question::begin(
    "reset-at-speed",
    "The wheels will turn. Press the reset of the board a second after they begin. Ready?",
);

/// The board was reset: an emergency stop is latched until then.
pub(super) const CLEAR_LATCH: Question = Question::begin(
    "clear-latch",
    "Press the reset of the board: the emergency stop is latched until then. Done?",
);

/// The answers to [`STOPPED_HOW`].
pub(super) const STOPS: &[&str] = &["at-once", "late", "not"];

/// When the motor stopped driving, counted from the operator's own action, be the cable plugged in
/// again or not.
pub(super) const STOPPED_HOW: Question = Question::new(
    "stopped-how",
    "Did the motor stop driving at once (the wheels may roll on), later (it drove on for half \
         a second or more), or not?",
    Answers::Choice(STOPS),
);

/// Puts values in force.
pub(super) fn change(
    bench: &mut dyn Bench,
    values: &[(&str, toml_edit::Value)],
) -> Result<(), Trouble> {
    bench.change(values).map_err(|Refused(why)| {
        let keys: Vec<_> = values.iter().map(|(key, _)| *key).collect();
        let fix = "Correct the configuration file as the message says, and run the bring-up again.";
        failed(format!("{} can't be changed: {why}", keys.join(", ")), fix)
    })
}

/// Asks a question that must not be skipped.
pub(super) fn ask(bench: &mut dyn Bench, question: &Question) -> Result<Answer, Trouble> {
    match bench.ask(question)? {
        Answer::Skip => Err(Trouble::Skipped),
        answer => Ok(answer),
    }
}

/// Asks for yes or no.
pub(super) fn ask_yes(bench: &mut dyn Bench, question: &Question) -> Result<bool, Trouble> {
    Ok(ask(bench, question)? == Answer::YesNo(true))
}

/// Asks for one of several words.
pub(super) fn ask_word<'a>(
    bench: &mut dyn Bench,
    question: &Question,
    words: &[&'a str],
) -> Result<&'a str, Trouble> {
    match ask(bench, question)? {
        Answer::Choice(index) => words.get(index).copied().ok_or(Trouble::Skipped),
        _ => Err(Trouble::Skipped),
    }
}

/// Asks for a number.
pub(super) fn ask_number(bench: &mut dyn Bench, question: &Question) -> Result<f64, Trouble> {
    match ask(bench, question)? {
        Answer::Number(number) => Ok(number),
        _ => Err(Trouble::Skipped),
    }
}
