//! The operator's terminal: questions, answers, a live line, and the held key.

use std::{
    io::{self, Write as _},
    time::{Duration, Instant},
};

use indicatif::ProgressBar;
use serde_json::{Value, json};
use singletrack_commissioning::{Answer, Answers, Question};

use crate::{
    operator::terminal::{RawTerminal, read_now},
    progress::progress_bar,
};

/// Time after the last press of the held key from which it counts as released. A key repeats 10
/// to 30 times a second, after a first pause of up to 0.66 s.
const FIRST_REPEAT: Duration = Duration::from_millis(750);
const REPEAT: Duration = Duration::from_millis(250);

/// Standard input, standard error and, for programs, standard output.
pub(super) struct Terminal {
    json: bool,
    pub(super) bar: ProgressBar,
    line: Vec<u8>,
    held: Option<HeldKey>,
}

/// The space bar while a car is armed.
struct HeldKey {
    _terminal: RawTerminal,
    pressed: Instant,
    presses: u32,
    repeats: bool,
}

impl Terminal {
    pub(super) fn new(json: bool) -> Self {
        let bar = progress_bar(1_000, "{bar:16} {percent:>3} %  {msg}");
        // It is drawn while something is measured.
        bar.finish_and_clear();
        Self {
            json,
            bar,
            line: Vec::new(),
            held: None,
        }
    }

    /// A line for people.
    pub(super) fn say(&self, text: &str) {
        if self.bar.is_finished() {
            eprintln!("{text}");
        } else {
            self.bar.suspend(|| eprintln!("{text}"));
        }
    }

    /// A line for programs.
    pub(super) fn tell(&self, object: &Value) -> io::Result<()> {
        if self.json {
            let mut output = io::stdout().lock();
            writeln!(output, "{object}")?;
            output.flush()?;
        }
        Ok(())
    }

    pub(super) fn show(&self, text: &str, done: f64) {
        if self.bar.is_finished() {
            self.bar.reset();
        }
        self.bar
            .set_position((done.clamp(0.0, 1.0) * 1_000.0) as u64);
        self.bar.set_message(text.to_owned());
    }

    /// Puts a question; the answer is then read with [`Terminal::answer`].
    pub(super) fn put(&mut self, question: &Question) -> io::Result<()> {
        self.bar.finish_and_clear();
        self.tell(&json!({
            "question": question.id,
            "text": question.text,
            "answers": expected(&question.answers),
        }))?;
        let text = &question.text;
        eprint!("\n{text}\n[{}, or s to skip] ", expected(&question.answers));
        io::stderr().flush()
    }

    /// The answer, if a line with one has arrived. A line that is none is answered with what it
    /// should be.
    pub(super) fn answer(&mut self, question: &Question) -> io::Result<Option<Answer>> {
        let Some(line) = self.read_line()? else {
            return Ok(None);
        };
        let answer = parse(&question.answers, line.trim());
        if answer.is_none() {
            let expected = expected(&question.answers);
            eprint!("Please answer with {expected}, or s to skip. ");
            io::stderr().flush()?;
        }
        Ok(answer)
    }

    fn read_line(&mut self) -> io::Result<Option<String>> {
        if let Some(end) = self.line.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = self.line.drain(..=end).collect();
            return Ok(Some(String::from_utf8_lossy(&line).into_owned()));
        }
        read_now(&mut self.line)?;
        Ok(None)
    }

    /// From now on the space bar is the dead-man switch.
    pub(super) fn hold_key(&mut self) -> io::Result<()> {
        // A jog that ended by itself has not given it back.
        self.release_key();
        let terminal = RawTerminal::open()?.ok_or_else(|| {
            io::Error::other("a terminal is needed: its space bar is the dead-man switch")
        })?;
        self.held = Some(HeldKey {
            _terminal: terminal,
            pressed: Instant::now(),
            presses: 0,
            repeats: false,
        });
        Ok(())
    }

    /// From now on the release of the key is awaited: one that is stuck must not arm a car.
    pub(super) fn await_release(&mut self) {
        if let Some(held) = &mut self.held {
            held.pressed = Instant::now();
            held.presses = 0;
            held.repeats = true;
        }
    }

    /// From now on a press is awaited.
    pub(super) fn await_press(&mut self) {
        if let Some(held) = &mut self.held {
            held.presses = 0;
            held.repeats = false;
        }
    }

    /// Whether a press has come since [`Terminal::await_release`].
    pub(super) fn was_pressed(&self) -> bool {
        self.held.as_ref().is_some_and(|held| held.presses > 0)
    }

    /// Whether a press of the space bar has arrived; another key is none.
    pub(super) fn is_pressed(&mut self) -> io::Result<bool> {
        let mut typed = Vec::new();
        read_now(&mut typed)?;
        let pressed = typed.contains(&b' ');
        if pressed && let Some(held) = &mut self.held {
            held.repeats |= held.presses > 0 && held.pressed.elapsed() < REPEAT;
            held.presses = held.presses.saturating_add(1);
            held.pressed = Instant::now();
        }
        Ok(pressed)
    }

    /// Whether the held key has been released.
    pub(super) fn is_released(&mut self) -> io::Result<bool> {
        if self.held.is_none() {
            return Ok(false);
        }
        self.is_pressed()?;
        Ok(self.held.as_ref().is_some_and(|held| {
            held.pressed.elapsed() > if held.repeats { REPEAT } else { FIRST_REPEAT }
        }))
    }

    /// Whether the space bar is the dead-man switch.
    pub(super) const fn holds_key(&self) -> bool {
        self.held.is_some()
    }

    /// Ends [`Terminal::hold_key`]. Presses that were not read are dropped.
    pub(super) fn release_key(&mut self) {
        self.held = None;
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.release_key();
        self.bar.finish_and_clear();
    }
}

/// The answers that a question takes, in words.
fn expected(answers: &Answers) -> String {
    match answers {
        Answers::Begin => "Enter".to_owned(),
        Answers::YesNo => "y or n".to_owned(),
        Answers::Choice(words) => words.join(", "),
        Answers::Number { unit, range } => format!("a number, {} to {} {unit}", range[0], range[1]),
    }
}

fn parse(answers: &Answers, line: &str) -> Option<Answer> {
    if matches!(line, "s" | "skip") {
        return Some(Answer::Skip);
    }
    match answers {
        Answers::Begin => line.is_empty().then_some(Answer::Begin),
        Answers::YesNo => match line.to_ascii_lowercase().as_str() {
            "y" | "yes" => Some(Answer::YesNo(true)),
            "n" | "no" => Some(Answer::YesNo(false)),
            _ => None,
        },
        Answers::Choice(words) => {
            // A word that begins so, if it is the only one.
            let mut matching = words.iter().enumerate().filter(|(_, word)| {
                !line.is_empty() && word.starts_with(&line.to_ascii_lowercase())
            });
            let exact = words.iter().position(|word| *word == line);
            let (index, _) = match exact {
                Some(index) => return Some(Answer::Choice(index)),
                None => matching.next()?,
            };
            matching.next().is_none().then_some(Answer::Choice(index))
        }
        Answers::Number { unit, range } => {
            let number = line.strip_suffix(unit).unwrap_or(line).trim();
            let value: f64 = number.replace(',', ".").parse().ok()?;
            let is_within = (range[0]..=range[1]).contains(&value);
            is_within.then_some(Answer::Number(value))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_read_as_people_type_them() {
        let volts = Answers::Number {
            unit: "V",
            range: [0.0, 60.0],
        };
        let words = Answers::Choice(&["left", "right", "neither"]);
        for (answers, line, answer) in [
            (&Answers::Begin, "", Some(Answer::Begin)),
            (&Answers::Begin, "x", None),
            (&Answers::YesNo, "Y", Some(Answer::YesNo(true))),
            (&Answers::YesNo, "no", Some(Answer::YesNo(false))),
            (&Answers::YesNo, "", None),
            (&words, "r", Some(Answer::Choice(1))),
            (&words, "neither", Some(Answer::Choice(2))),
            (&words, "", None),
            (&words, "up", None),
            (&volts, "7.41", Some(Answer::Number(7.41))),
            (&volts, "7,4 V", Some(Answer::Number(7.4))),
            (&volts, "61", None),
            (&volts, "nan", None),
            (&volts, "s", Some(Answer::Skip)),
        ] {
            assert_eq!(parse(answers, line), answer, "{answers:?} {line:?}");
        }
    }
}
