//! Prints rows.

use std::{
    borrow::Cow,
    io::{self, IsTerminal as _, Write},
};

use clap::ValueEnum;
use singletrack_record::{Value, write_json_object};

use crate::help::printable;

use super::{
    error::DumpError,
    kind::{Kind, Place, TIME, check_field},
    source::{Row, Source},
};

/// Bytes that are printed at once, unless a reader waits for them.
const BLOCK: usize = 64 << 10;

/// How rows are printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Columns for a person; quantities to six digits.
    Table,
    /// One object a line, every digit.
    Json,
    /// One line a row, every digit.
    Csv,
}

/// Prints rows.
pub(super) struct Printer<W: Write> {
    output: W,
    format: Format,
    /// What is printed and not yet handed over.
    text: String,
    /// A cell that is made of many values.
    content: String,
    header: Vec<String>,
    /// The columns of each kind.
    columns: Vec<Vec<Column>>,
    /// The name of each kind.
    names: Vec<&'static str>,
    /// Whether whole rows are printed as JSON.
    whole: bool,
    widths: Vec<usize>,
}

/// What stands in a column.
enum Column {
    /// The name of the row's kind.
    Topic,
    /// A field, under this name.
    Value(String, Place),
    /// Fields, each with its name.
    Content(Vec<(String, Place)>),
    /// The kind has no such field.
    Nothing,
}

impl<W: Write> Printer<W> {
    /// Prints the `chosen` of the `kinds`: the fields that are `wanted`, or those
    /// that the format prints by itself if there are none.
    pub(super) fn new(
        output: W,
        format: Format,
        kinds: &[Kind],
        chosen: &[usize],
        wanted: &[String],
    ) -> Result<Self, DumpError> {
        let chosen_kinds = chosen.iter().filter_map(|index| kinds.get(*index));
        for name in wanted {
            check_field(chosen_kinds.clone(), name)?;
        }
        let (header, columns) = if let [only] = chosen
            && let Some(kind) = kinds.get(*only)
        {
            let names = if wanted.is_empty() {
                own_fields(kind, format)
            } else {
                wanted.to_vec()
            };
            let columns = kinds.iter().map(|kind| values(kind, &names)).collect();
            (names, columns)
        } else if !wanted.is_empty() {
            let columns = kinds.iter().map(|kind| {
                let topic = (format != Format::Json).then_some(Column::Topic);
                topic.into_iter().chain(values(kind, wanted)).collect()
            });
            let topic = ["topic".to_owned()];
            (
                topic.into_iter().chain(wanted.iter().cloned()).collect(),
                columns.collect(),
            )
        } else {
            let mut leading = vec![TIME.to_owned()];
            // Every frame has the two.
            for name in ["offset", "length"] {
                if kinds.iter().all(|kind| kind.index(name).is_some()) {
                    leading.push(name.to_owned());
                }
            }
            let columns = kinds.iter().map(|kind| {
                let mut columns = values(kind, &leading);
                let mut content = own_fields(kind, format);
                content.retain(|name| !leading.contains(name));
                let content = content
                    .into_iter()
                    .filter_map(|name| kind.place(&name).map(|place| (name, place)));
                columns.extend([Column::Topic, Column::Content(content.collect())]);
                columns
            });
            let columns = columns.collect();
            leading.extend(["topic".to_owned(), "content".to_owned()]);
            (leading, columns)
        };
        Ok(Self {
            output,
            format,
            text: String::new(),
            content: String::new(),
            widths: header.iter().map(|name| name.len().max(8)).collect(),
            header,
            columns,
            names: kinds.iter().map(|kind| kind.name).collect(),
            whole: format == Format::Json && wanted.is_empty(),
        })
    }

    /// Prints the names of the columns, where the format has them.
    pub(super) fn begin(&mut self) -> Result<(), DumpError> {
        let header = std::mem::take(&mut self.header);
        match self.format {
            Format::Table => self.table_row(&header),
            Format::Json => {}
            Format::Csv => {
                self.text.push_str(&header.join(","));
                self.text.push('\n');
            }
        }
        self.flush()
    }

    /// Whether it looks at the fields of a row.
    pub(super) fn needs_values(&self) -> bool {
        !self.whole
    }

    /// Prints the row that the source is at; `values` are its fields, if it needs
    /// them.
    pub(super) fn print(
        &mut self,
        row: &Row,
        values: &[Value],
        source: &mut dyn Source,
    ) -> Result<(), DumpError> {
        if self.whole {
            source.write_json(&mut self.text)?;
            self.text.push('\n');
        } else {
            match self.format {
                Format::Table => self.print_table(row, values),
                Format::Json => self.print_json(row, values),
                Format::Csv => self.print_csv(row, values),
            }
        }
        if self.text.len() >= BLOCK {
            self.hand_over()?;
        }
        Ok(())
    }

    /// Passes all text so far to the reader.
    pub(super) fn flush(&mut self) -> Result<(), DumpError> {
        self.hand_over()?;
        Ok(self.output.flush()?)
    }

    fn hand_over(&mut self) -> Result<(), DumpError> {
        // Also after a failure: the text must not be printed twice.
        let text = if self.format == Format::Csv && !io::stdout().is_terminal() {
            Cow::Borrowed(self.text.as_str())
        } else {
            printable(&self.text)
        };
        let written = self.output.write_all(text.as_bytes());
        self.text.clear();
        Ok(written?)
    }

    fn print_csv(&mut self, row: &Row, values: &[Value]) {
        let Some(columns) = self.columns.get(row.kind) else {
            return;
        };
        let (begin, time) = (self.text.len(), row.time());
        for (index, column) in columns.iter().enumerate() {
            if index > 0 {
                self.text.push(',');
            }
            match column {
                Column::Topic => self.text.push_str(name(&self.names, row)),
                Column::Value(_, place) => match place.value(&time, values) {
                    Value::Text(text) => push_csv_text(&mut self.text, text),
                    value => value.push_to(&mut self.text),
                },
                Column::Content(fields) => {
                    self.content.clear();
                    push_content(&mut self.content, fields, &time, values, Value::push_to);
                    push_csv_text(&mut self.text, &self.content);
                }
                Column::Nothing => {}
            }
        }
        if self.text.len() == begin {
            // An empty line is not a row in CSV.
            self.text.push_str("\"\"");
        }
        self.text.push('\n');
    }

    fn print_json(&mut self, row: &Row, values: &[Value]) {
        let time = row.time();
        let columns = self.columns.get(row.kind).map_or(&[][..], Vec::as_slice);
        let fields = columns.iter().filter_map(|column| match column {
            Column::Value(name, place) => Some((name.as_str(), place.value(&time, values))),
            _ => None,
        });
        write_json_object(&mut self.text, name(&self.names, row), fields);
        self.text.push('\n');
    }

    fn print_table(&mut self, row: &Row, values: &[Value]) {
        let time = row.time();
        let columns = self.columns.get(row.kind).map_or(&[][..], Vec::as_slice);
        let cells: Vec<_> = columns
            .iter()
            .map(|column| match column {
                Column::Topic => name(&self.names, row).to_owned(),
                Column::Value(_, place) => cell(place.value(&time, values)),
                Column::Content(fields) => {
                    let mut text = String::new();
                    push_content(&mut text, fields, &time, values, |value, text| {
                        text.push_str(&cell(value));
                    });
                    text
                }
                Column::Nothing => cell(&Value::Absent),
            })
            .collect();
        self.table_row(&cells);
    }

    /// Right-aligned, but for sentences at the end.
    fn table_row(&mut self, cells: &[String]) {
        let last = cells.len().saturating_sub(1);
        let sentences = matches!(
            self.columns.first().and_then(|columns| columns.last()),
            Some(Column::Content(_))
        );
        for (index, (cell, width)) in cells.iter().zip(&mut self.widths).enumerate() {
            if index > 0 {
                self.text.push_str("  ");
            }
            if sentences && index == last {
                self.text.push_str(cell);
                continue;
            }
            let length = cell.chars().count();
            *width = (*width).max(length);
            self.text.extend(std::iter::repeat_n(' ', *width - length));
            self.text.push_str(cell);
        }
        self.text.push('\n');
    }
}

/// The fields that a format prints of a kind by itself.
fn own_fields(kind: &Kind, format: Format) -> Vec<String> {
    if format == Format::Table && !kind.brief.is_empty() {
        kind.brief.iter().map(ToString::to_string).collect()
    } else {
        kind.fields.clone()
    }
}

/// A column for each of the fields.
fn values(kind: &Kind, names: &[String]) -> Vec<Column> {
    names
        .iter()
        .map(|name| match kind.place(name) {
            Some(place) => Column::Value(name.clone(), place),
            None => Column::Nothing,
        })
        .collect()
}

fn name(names: &[&'static str], row: &Row) -> &'static str {
    names.get(row.kind).copied().unwrap_or_default()
}

/// Adds the fields that have a value, with their names.
fn push_content(
    text: &mut String,
    fields: &[(String, Place)],
    time: &Value,
    values: &[Value],
    push: impl Fn(&Value, &mut String),
) {
    let mut gap = "";
    for (name, place) in fields {
        let value = place.value(time, values);
        if *value == Value::Absent {
            continue;
        }
        for part in [gap, name, "="] {
            text.push_str(part);
        }
        push(value, text);
        gap = " ";
    }
}

/// A value for a person.
fn cell(value: &Value) -> String {
    match value {
        Value::Absent => "-".to_owned(),
        Value::Float(value) => format!("{value:.6}"),
        Value::Text(text) => text
            .chars()
            .map(|character| {
                // A line of the log must not break out of its row.
                if character.is_control() {
                    character.escape_default().to_string()
                } else {
                    character.to_string()
                }
            })
            .collect(),
        other => other.to_string(),
    }
}

/// In quotes where RFC 4180 requires them. Not by `csv::Writer`, which takes 1.5 times as
/// long for a row of numbers: it looks for quotes in every digit.
fn push_csv_text(csv: &mut String, text: &str) {
    if !text.contains([',', '"', '\r', '\n']) {
        csv.push_str(text);
        return;
    }
    csv.push('"');
    for character in text.chars() {
        if character == '"' {
            csv.push('"');
        }
        csv.push(character);
    }
    csv.push('"');
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn every_text_survives_csv(texts in prop::collection::vec(any::<String>(), 2..5)) {
            let mut csv = String::new();
            for (index, text) in texts.iter().enumerate() {
                if index > 0 {
                    csv.push(',');
                }
                push_csv_text(&mut csv, text);
            }
            csv.push('\n');
            let mut reader = csv::ReaderBuilder::new()
                .has_headers(false)
                .from_reader(csv.as_bytes());
            let row = reader.records().next().unwrap().unwrap();
            prop_assert_eq!(row.iter().collect::<Vec<_>>(), texts);
        }
    }
}
