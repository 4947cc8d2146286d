//! How a step asks the operator, who must not skip the question.
//!
//! "Now" and "just now" in a question are the moment of its answer. The servo stays where a jog
//! left it: angles are read while the car is disarmed.

use std::borrow::Cow;

use crate::{Answer, Answers, Bench, Question, Trouble};

impl dyn Bench + '_ {
    /// Asks a question.
    pub(super) fn answer(
        &mut self,
        id: &'static str,
        text: impl Into<Cow<'static, str>>,
        answers: Answers,
    ) -> Result<Answer, Trouble> {
        let text = text.into();
        match self.ask(&Question { id, text, answers })? {
            Answer::Skip => Err(Trouble::Skipped),
            answer => Ok(answer),
        }
    }

    /// Waits until the operator is ready to do this, or has done it.
    pub(super) fn ready(&mut self, id: &'static str, request: &'static str) -> Result<(), Trouble> {
        self.answer(id, request, Answers::Begin).map(drop)
    }

    /// Asks for yes or no.
    pub(super) fn ask_yes(
        &mut self,
        id: &'static str,
        text: impl Into<Cow<'static, str>>,
    ) -> Result<bool, Trouble> {
        Ok(self.answer(id, text, Answers::YesNo)? == Answer::YesNo(true))
    }

    /// Asks for one of several words.
    pub(super) fn ask_word(
        &mut self,
        id: &'static str,
        text: &'static str,
        words: &'static [&'static str],
    ) -> Result<&'static str, Trouble> {
        match self.answer(id, text, Answers::Choice(words))? {
            Answer::Choice(index) => words.get(index).copied().ok_or(Trouble::Skipped),
            _ => Err(Trouble::Skipped),
        }
    }
}
