//! Questions to the operator, and what the terminal shows meanwhile.

use std::borrow::Cow;

/// A question to the operator.
#[derive(Clone, Debug, PartialEq)]
pub struct Question {
    /// Its name, for scripts, such as `push-forward`. It never changes.
    pub id: &'static str,
    /// The question or the request, in whole sentences.
    pub text: Cow<'static, str>,
    /// The answers that it takes.
    pub answers: Answers,
}

impl Question {
    /// With a text that never changes.
    #[must_use]
    pub const fn new(id: &'static str, text: &'static str, answers: Answers) -> Self {
        Self {
            id,
            text: Cow::Borrowed(text),
            answers,
        }
    }

    /// With [`Answers::Begin`].
    #[must_use]
    pub const fn begin(id: &'static str, text: &'static str) -> Self {
        Self::new(id, text, Answers::Begin)
    }

    /// With [`Answers::YesNo`].
    pub(crate) const fn yes_no(id: &'static str, text: &'static str) -> Self {
        Self::new(id, text, Answers::YesNo)
    }
}

/// The answers that a question takes. Every question can also be skipped.
#[derive(Clone, Debug, PartialEq)]
pub enum Answers {
    /// The operator is ready to begin with what `text` asks for.
    Begin,
    /// Yes or no.
    YesNo,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// A number within the bounds, in the unit.
    Number {
        /// The unit, such as `deg`.
        unit: &'static str,
        /// The lowest and the highest.
        range: [f64; 2],
    },
}

/// The operator's answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer {
    /// Ready.
    Begin,
    /// Yes or no.
    YesNo(bool),
    /// The index of the word.
    Choice(usize),
    /// The number.
    Number(f64),
    /// The operator can't or won't do it.
    Skip,
}

/// A measurement that is under way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Live<'a> {
    /// The present values, in words and numbers, on one line.
    pub text: &'a str,
    /// How much of it is done, 0 to 1.
    pub done: f64,
}
