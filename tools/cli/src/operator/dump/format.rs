//! Prints rows.

use std::{
    borrow::Cow,
    io::{self, IsTerminal as _, Write},
};

use clap::ValueEnum;
use singletrack_record::{Value, write_json_object};

use super::{
    select::check_field,
    source::{Kind, Row, TIME},
};
use crate::{Result, help::printable};

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
pub(super) struct Printer<'a, W: Write> {
    output: W,
    format: Format,
    /// The columns of each kind.
    columns: Vec<(&'a Kind, Vec<Column<'a>>)>,
    /// Whether a row writes itself as JSON, with all its fields.
    whole: bool,
    widths: Vec<usize>,
    /// What is printed and not yet handed over.
    text: String,
    /// The cell that is being made.
    cell: String,
}

/// What stands in a column.
enum Column<'a> {
    /// The name of the row's kind.
    Topic(&'a str),
    /// The field with this name and index, if the kind has it.
    Field(Option<(&'a str, usize)>),
    /// Fields, each with its name.
    Content(Vec<(&'a str, usize)>),
}

impl<'a, W: Write> Printer<'a, W> {
    /// Prints the chosen of the `kinds`: the fields that are `wanted`, or those that the format
    /// prints by itself if there are none.
    pub(super) fn new(
        output: W,
        format: Format,
        kinds: &'a [Kind],
        wanted: &[String],
    ) -> Result<Self, String> {
        for name in wanted {
            check_field(kinds, name)?;
        }
        let shown = |kind: &'a Kind| match format {
            Format::Table => kind.brief.as_slice(),
            Format::Json | Format::Csv => kind.own_fields(),
        };
        let chosen: Vec<_> = kinds.iter().filter(|kind| kind.chosen).collect();
        let several = chosen.len() != 1;
        let header: Vec<_> = match (chosen.as_slice(), wanted) {
            ([only], []) => shown(only).to_vec(),
            ([_], wanted) => wanted.to_vec(),
            (_, []) => {
                // Every frame has an offset and a length.
                let in_all = |name: &&str| kinds.iter().all(|kind| kind.index(name).is_some());
                let leading = [TIME, "offset", "length"].into_iter().filter(in_all);
                let header = leading.chain(["topic", "content"]);
                header.map(ToOwned::to_owned).collect()
            }
            (_, wanted) => [&["topic".to_owned()], wanted].concat(),
        };
        let column = |kind: &'a Kind, name: &str| match name {
            "topic" if several => Column::Topic(kind.name),
            "content" if several => {
                let content = shown(kind).iter().filter(|name| !header.contains(name));
                Column::Content(content.filter_map(|name| kind.field(name)).collect())
            }
            name => Column::Field(kind.field(name)),
        };
        let columns = |kind: &'a Kind| {
            let columns = header.iter().map(|name| column(kind, name));
            (kind, columns.collect())
        };
        let mut printer = Self {
            output,
            format,
            whole: format == Format::Json && wanted.is_empty(),
            widths: header.iter().map(|name| name.len().max(8)).collect(),
            text: String::new(),
            cell: String::new(),
            columns: kinds.iter().map(columns).collect(),
        };
        let text = &mut printer.text;
        match format {
            Format::Table => {
                let first = printer.columns.first().into_iter();
                let columns = first.flat_map(|(_, columns)| columns);
                let cells = header.iter().zip(columns).zip(&mut printer.widths);
                for (index, ((name, column), width)) in cells.enumerate() {
                    push_cell(text, name, index, column, width);
                }
                text.push('\n');
            }
            Format::Json => {}
            Format::Csv => *text = header.join(",") + "\n",
        }
        Ok(printer)
    }

    /// Prints a row. Reads its `values` if they are needed and not yet read.
    pub(super) fn print(&mut self, mut row: Row<'_>, values: &mut Vec<Value>) -> Result<()> {
        let Some((kind, columns)) = self.columns.get(row.kind) else {
            return Ok(());
        };
        if !self.whole {
            row.read_values(values)?;
        }
        let text = &mut self.text;
        let begin = text.len();
        match self.format {
            _ if self.whole => row.write_json(text)?,
            Format::Json => {
                let fields = columns.iter().filter_map(|column| match *column {
                    Column::Field(Some((name, at))) => Some((name, values.get(at)?)),
                    _ => None,
                });
                write_json_object(text, kind.name, fields);
            }
            Format::Csv => {
                for (index, column) in columns.iter().enumerate() {
                    if index > 0 {
                        text.push(',');
                    }
                    match column {
                        Column::Field(at) => match value(values, *at) {
                            Value::Text(value) => push_csv_text(text, value),
                            value => value.push_to(text),
                        },
                        column => {
                            self.cell.clear();
                            column.push_to(&mut self.cell, values, Value::push_to);
                            push_csv_text(text, &self.cell);
                        }
                    }
                }
                if text.len() == begin {
                    // An empty line is not a row in CSV.
                    text.push_str("\"\"");
                }
            }
            Format::Table => {
                let columns = columns.iter().zip(&mut self.widths).enumerate();
                for (index, (column, width)) in columns {
                    self.cell.clear();
                    column.push_to(&mut self.cell, values, push_for_person);
                    push_cell(text, &self.cell, index, column, width);
                }
            }
        }
        text.push('\n');
        if text.len() >= BLOCK {
            self.flush()?;
        }
        Ok(())
    }

    /// Passes all text so far to the reader.
    pub(super) fn flush(&mut self) -> Result<()> {
        // Also after a failure: the text must not be printed twice.
        let text = if self.format == Format::Csv && !io::stdout().is_terminal() {
            Cow::Borrowed(self.text.as_str())
        } else {
            printable(&self.text)
        };
        let written = self.output.write_all(text.as_bytes());
        self.text.clear();
        written?;
        Ok(self.output.flush()?)
    }
}

impl Column<'_> {
    /// Adds its cell in a row with these values, each as `push` writes it.
    fn push_to(&self, cell: &mut String, values: &[Value], push: impl Fn(&Value, &mut String)) {
        match self {
            Self::Topic(name) => cell.push_str(name),
            Self::Field(field) => push(value(values, *field), cell),
            Self::Content(fields) => {
                for field in fields {
                    let value = value(values, Some(*field));
                    if *value == Value::Absent {
                        continue;
                    }
                    let gap = if cell.is_empty() { "" } else { " " };
                    for part in [gap, field.0, "="] {
                        cell.push_str(part);
                    }
                    push(value, cell);
                }
            }
        }
    }
}

/// The value of a field, if the kind has it.
fn value<'a>(values: &'a [Value], field: Option<(&str, usize)>) -> &'a Value {
    let value = field.and_then(|(_, at)| values.get(at));
    value.unwrap_or(&Value::Absent)
}

/// Adds a value as a person reads it.
fn push_for_person(value: &Value, cell: &mut String) {
    match value {
        Value::Absent => cell.push('-'),
        Value::Float(value) => cell.push_str(&format!("{value:.6}")),
        Value::Text(text) => {
            for character in text.chars() {
                // A line of the log must not break out of its row.
                match character.is_control() {
                    true => cell.extend(character.escape_default()),
                    false => cell.push(character),
                }
            }
        }
        other => other.push_to(cell),
    }
}

/// Adds a cell to a row of a table: right-aligned, but for the content at the end.
fn push_cell(text: &mut String, cell: &str, index: usize, column: &Column<'_>, width: &mut usize) {
    if index > 0 {
        text.push_str("  ");
    }
    if matches!(column, Column::Content(_)) {
        text.push_str(cell);
    } else {
        *width = (*width).max(cell.chars().count());
        text.push_str(&format!("{cell:>0$}", *width));
    }
}

/// Adds a text in quotes where RFC 4180 requires them. Not by `csv::Writer`, which takes 1.5 times
/// as long for a row of numbers: it looks for quotes in every digit.
fn push_csv_text(csv: &mut String, text: &str) {
    if !text.contains([',', '"', '\r', '\n']) {
        csv.push_str(text);
        return;
    }
    csv.push('"');
    csv.push_str(&text.replace('"', "\"\""));
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
