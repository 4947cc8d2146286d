//! What a step asks of the operator and of the configuration.

use crate::{Answer, Bench, Question, Refused, Trouble, finding::failed};

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
