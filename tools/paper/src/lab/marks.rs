//! The marks for a file of answers.

use std::fmt;

use serde::Serialize;

use super::{
    answers::Answers,
    error::LabError,
    exercise::{Exercise, Finding, Judge, percent},
    exercises, title,
};

/// How an answer is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grade {
    /// Right: all points.
    Right,
    /// Wrong: no points.
    Wrong,
    /// No answer, or not all of it.
    Open,
}

/// The mark of one exercise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mark {
    /// The number of the exercise.
    pub exercise: &'static str,
    /// How the answer is.
    pub grade: Grade,
    /// The points for it.
    pub points: u32,
    /// The points of a right answer.
    pub of: u32,
    /// The answers, with key and unit.
    pub answers: Vec<String>,
    /// What is accepted, and for a choice what was found when it was tried.
    pub found: String,
    /// What helps, after a wrong answer.
    pub hint: Option<&'static str>,
}

/// The marks of a lab.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Marks {
    /// The lab.
    pub lab: u8,
    /// The student.
    pub student: String,
    /// The points.
    pub points: u32,
    /// The points of a lab without a mistake.
    pub of: u32,
    /// The exercises, in order.
    pub marks: Vec<Mark>,
}

/// Marks answers. The truth of each answered exercise is computed.
///
/// # Errors
///
/// The truth can't be computed.
pub fn mark(answers: &Answers) -> Result<Marks, LabError> {
    let exercises = exercises(answers.lab, &answers.student)?;
    let marks = exercises
        .iter()
        .map(|exercise| mark_one(exercise, answers))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Marks {
        lab: answers.lab,
        student: answers.student.name().to_owned(),
        points: marks.iter().map(|mark| mark.points).sum(),
        of: marks.iter().map(|mark| mark.of).sum(),
        marks,
    })
}

fn mark_one(exercise: &Exercise, answers: &Answers) -> Result<Mark, LabError> {
    let given: Vec<Option<f64>> = exercise
        .quantities
        .iter()
        .map(|quantity| answers.values.get(quantity.key).copied())
        .collect();
    let texts = exercise
        .quantities
        .iter()
        .zip(&given)
        .map(|(quantity, value)| {
            let value = value.map_or_else(|| "no answer".to_owned(), |value| value.to_string());
            format!("{} = {value} ({})", quantity.key, quantity.unit)
        });
    let texts = texts.collect();
    let (grade, found) = match given.iter().copied().collect::<Option<Vec<f64>>>() {
        Some(values) => judge(exercise, &values)?,
        None => (Grade::Open, "there is no answer yet".to_owned()),
    };
    let is_right = grade == Grade::Right;
    Ok(Mark {
        exercise: exercise.id,
        grade,
        points: if is_right { exercise.points } else { 0 },
        of: exercise.points,
        answers: texts,
        found,
        hint: (grade == Grade::Wrong).then_some(exercise.hint),
    })
}

fn judge(exercise: &Exercise, values: &[f64]) -> Result<(Grade, String), LabError> {
    let grade = |is_right| if is_right { Grade::Right } else { Grade::Wrong };
    match &exercise.judge {
        Judge::Number { truth, tolerance } => {
            let truth = truth()?;
            let is_right = values
                .iter()
                .all(|value| is_close(*value, truth, *tolerance));
            let found = format!("accepted within {} % of the truth", percent(*tolerance));
            Ok((grade(is_right), found))
        }
        Judge::Choice(trial) => {
            let findings = trial(values)?;
            let is_right = !findings.is_empty() && findings.iter().all(Finding::is_right);
            let found: Vec<String> = findings.iter().map(ToString::to_string).collect();
            Ok((grade(is_right), found.join("; ")))
        }
    }
}

/// Within a share of the truth; the last bits of a product do not count.
fn is_close(value: f64, truth: f64, tolerance: f64) -> bool {
    (value - truth).abs() <= tolerance * truth.abs() * (1.0 + 1e-9)
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} is {:.4}", self.what, self.value)?;
        match (self.least.is_finite(), self.most.is_finite()) {
            (true, true) => write!(f, ", wanted {:.4} to {:.4}", self.least, self.most),
            (true, false) => write!(f, ", wanted at least {:.4}", self.least),
            (false, true) => write!(f, ", wanted at most {:.4}", self.most),
            (false, false) => Ok(()),
        }
    }
}

impl fmt::Display for Marks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Lab {}: {}, {}", self.lab, title(self.lab), self.student)?;
        for mark in &self.marks {
            let grade = match mark.grade {
                Grade::Right => "right",
                Grade::Wrong => "wrong",
                Grade::Open => "open",
            };
            writeln!(
                f,
                "\n{}  {grade}, {} of {} points",
                mark.exercise, mark.points, mark.of
            )?;
            writeln!(f, "     {}", mark.answers.join(", "))?;
            writeln!(f, "     {}", mark.found)?;
            if let Some(hint) = mark.hint {
                writeln!(f, "     Hint: {hint}")?;
            }
        }
        writeln!(f, "\n{} of {} points", self.points, self.of)
    }
}
