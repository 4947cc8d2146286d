//! The file of answers.

use std::{collections::BTreeMap, fmt::Write as _};

use serde::Deserialize;
use toml::{Table, Value};

use super::{
    error::LabError,
    exercise::{Exercise, percent},
    exercises,
    student::Student,
    title,
};

/// What stands in place of a number that is not answered.
const OPEN: &str = "?";

/// A file of answers.
#[derive(Clone, Debug, PartialEq)]
pub struct Answers {
    /// The lab.
    pub lab: u8,
    /// The student.
    pub student: Student,
    /// The answers by key; questions that are still open are left out.
    pub values: BTreeMap<String, f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    lab: i64,
    student: String,
    answers: Table,
}

impl Answers {
    /// Reads a file of answers.
    ///
    /// # Errors
    ///
    /// It is no TOML, or names another lab, an unknown question, or an answer that is no number.
    pub fn from_toml(text: &str) -> Result<Self, LabError> {
        let file: File = toml::from_str(text)?;
        let lab = u8::try_from(file.lab).map_err(|_| LabError::NoSuchLab(file.lab))?;
        let student = Student::new(&file.student)?;
        let exercises = exercises(lab, &student)?;
        let mut values = BTreeMap::new();
        for (key, value) in file.answers {
            let mut asked = exercises.iter().flat_map(|exercise| &exercise.quantities);
            let Some(quantity) = asked.clone().find(|quantity| quantity.key == key) else {
                let known: Vec<_> = asked.by_ref().map(|quantity| quantity.key).collect();
                let known = known.join(", ");
                return Err(LabError::UnknownAnswer { key, lab, known });
            };
            let number = match &value {
                Value::String(text) if text.trim() == OPEN => continue,
                Value::Float(number) if number.is_finite() => *number,
                Value::Integer(number) => *number as f64,
                _ => {
                    let (value, unit) = (value.to_string(), quantity.unit);
                    return Err(LabError::NotANumber { key, value, unit });
                }
            };
            values.insert(key, number);
        }
        Ok(Self {
            lab,
            student,
            values,
        })
    }
}

/// A file of answers with every question open.
#[must_use]
pub fn template(lab: u8, student: &Student, exercises: &[Exercise]) -> String {
    let mut text = format!("# Lab {lab}: {}\n", title(lab));
    text.push_str(
        "# Replace each \"?\" by a number, without quotes. Then: singletrack lab mark FILE\n",
    );
    let name = Value::String(student.name().to_owned());
    let _ = write!(text, "lab = {lab}\nstudent = {name}\n\n[answers]\n");
    for exercise in exercises {
        let _ = writeln!(text, "# {} ({} points)", exercise.id, exercise.points);
        for line in exercise.text.lines() {
            let _ = writeln!(text, "# {line}");
        }
        for quantity in &exercise.quantities {
            let within = exercise.tolerance().map_or_else(String::new, |tolerance| {
                format!(", within {} %", percent(tolerance))
            });
            let _ = writeln!(
                text,
                "{} = \"{OPEN}\"  # {}{within}",
                quantity.key, quantity.unit
            );
        }
        text.push('\n');
    }
    text
}
