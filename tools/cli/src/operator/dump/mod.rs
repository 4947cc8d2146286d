//! `singletrack dump`: a record, the running daemon or the serial line, as a table, as
//! lines of JSON, as CSV, or as statistics.

mod line;
mod select;
mod source;
mod stats;

use std::{
    borrow::Cow,
    io::{self, IsTerminal, Write},
    path::PathBuf,
    task::Poll,
    time::{Duration, Instant},
};

use clap::{Args, ValueEnum};
use line::Line;
use select::{Filter, check_field};
use singletrack_core::config::SerialSection;
use singletrack_record::{Topic, Value, write_json_object};
use source::{Kind, Live, Place, Record, Row, Source, TIME};
use stats::Stats;

use crate::{
    Result, arguments::parse_duration, help::printable, interrupt::Interrupt,
    operator::control::ControlArgs,
};

pub use select::{Condition, Moment};

/// Options of `singletrack dump`.
#[derive(Clone, Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct DumpArgs {
    /// The source: a record, the running daemon, a serial port, or a capture of its bytes.
    ///
    /// drive.mcap, drive.mcap.part   a record, finished or not
    /// live                          the running daemon
    /// /dev/ttyUSB0                  a serial port: what the board sends, frame by frame
    /// line.bin, -                   a capture of the line's bytes, or standard input
    #[arg(required_unless_present = "serial", verbatim_doc_comment)]
    pub source: Option<PathBuf>,

    /// What to print, several with commas [default: telemetry of a record or of live, all of a
    /// line; of a record on a terminal, without other options, a summary].
    ///
    /// Of a record or live: tick, telemetry, status, pose, log, configuration, drops. Of a line:
    /// hello, telemetry, status, acknowledgement, refusal, and broken for bytes that are not a
    /// frame (to the board: hello, configure, arm, disarm, drive, emergency-stop, broken).
    #[arg(long, value_delimiter = ',')]
    pub topic: Vec<String>,

    /// How to print it [default: table on a terminal, csv elsewhere].
    #[arg(long, value_enum)]
    pub format: Option<Format>,

    /// Which fields, such as `tick,estimate.yaw_rad` [default: all; in a table, those that
    /// matter most].
    ///
    /// `time_s` is there for every topic: seconds since the record began, since dump began to
    /// listen, or, in a capture, since the board's first record by the board's clock.
    #[arg(long, value_delimiter = ',')]
    pub fields: Vec<String>,

    /// Only rows that meet a condition: `mode=driving`, `'lateness_ns>500000'`.
    ///
    /// Operators: = != < <= > >= (put < and > in quotes, for the shell). An absent value equals
    /// `none`. Of several conditions, all must be met.
    #[arg(long = "where", value_name = "CONDITION")]
    pub conditions: Vec<Condition>,

    /// Only from this time on: seconds since the start, or 2026-11-21T12:00:00Z.
    #[arg(long, value_name = "TIME")]
    pub from: Option<Moment>,

    /// Only until this time.
    #[arg(long, value_name = "TIME")]
    pub to: Option<Moment>,

    /// Count instead of printing: rates, gaps, losses, errors, latencies, modes.
    ///
    /// Counts all topics, or those of --topic. A source without an end is counted until Ctrl-C
    /// or for the time of --for.
    #[arg(long)]
    pub stats: bool,

    /// Wait for more at the end of a record or a capture that is being written.
    #[arg(long)]
    pub follow: bool,

    /// Stop after this time, such as `10s`.
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_duration)]
    pub duration: Option<Duration>,

    /// Listen to this serial port.
    ///
    /// dump writes nothing to the port and does not change its control lines. But Linux raises
    /// DTR when it opens a port that was closed, and DTR resets an Arduino UNO. A port that
    /// singletrackd uses is busy: use `live` instead.
    #[arg(long, value_name = "PORT", conflicts_with = "source")]
    pub serial: Option<PathBuf>,

    /// Rate of the serial port, in baud.
    #[arg(long, default_value_t = SerialSection::new("").baud)]
    pub baud: u32,

    /// Where `live` is.
    #[command(flatten)]
    pub control: ControlArgs,
}

impl DumpArgs {
    /// Whether the source is all that was said.
    fn is_bare(&self) -> bool {
        self.topic.is_empty()
            && self.fields.is_empty()
            && self.conditions.is_empty()
            && self.format.is_none()
            && self.from.is_none()
            && self.to.is_none()
            && self.duration.is_none()
            && !self.stats
            && !self.follow
    }
}

const EXAMPLES: &str = "\
Examples:
  singletrack dump drive.mcap
          on a terminal: how much of what, how long, modes and their reasons
  singletrack dump drive.mcap --stats
          one page: rates, gaps, losses, latencies, modes and their reasons
  singletrack dump drive.mcap --topic tick --format csv > ticks.csv
          every field of every tick, for a spreadsheet or Python
  singletrack dump drive.mcap --topic tick --where mode!=driving --fields time_s,mode,reason
          when and why the car did not drive
  singletrack dump drive.mcap --topic tick,log --format json --from 12 --to 13.5
          a second and a half, with all recorded fields
  singletrack dump live --topic tick
          the ticks of the running daemon
  singletrack dump /dev/ttyUSB0 --stats --for 10s
          the quality of the line from the board (stop the daemon first)
  singletrack dump line.bin --topic broken
          the damaged places of a capture of the line";

/// Prints to standard output. A closed pipe is no error.
///
/// # Errors
///
/// When the source can't be read, or a topic or a field does not exist.
pub fn run(args: &DumpArgs) -> Result<()> {
    let stdout = io::stdout();
    let is_terminal = stdout.is_terminal();
    // Thousands of rows are of no use to a person.
    let brief = is_terminal && args.is_bare() && Place::of(args).0 == Place::Record;
    let format = args.format.unwrap_or(if args.stats || is_terminal {
        Format::Table
    } else {
        Format::Csv
    });
    let printed = dump(args, format, brief, stdout.lock());
    printed.or_else(|error| match *error.downcast::<io::Error>()? {
        error if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        error => Err(format!("can't write to standard output: {error}").into()),
    })
}

/// Prints what is asked for to `output`, or counts it; `brief`: without the distributions.
///
/// # Errors
///
/// When the source can't be read, a topic or a field does not exist, or the
/// output can't be written.
pub fn dump(args: &DumpArgs, format: Format, brief: bool, mut output: impl Write) -> Result<()> {
    let counts = args.stats || brief;
    if counts && format == Format::Csv {
        return Err("--stats has no csv: use --format table or --format json".into());
    }
    let (place, path) = Place::of(args);
    let name = path.display().to_string();
    let of_record = matches!(place, Place::Record | Place::Live);
    let mut kinds = if of_record {
        Kind::topics()
    } else {
        line::kinds()
    };
    let topics = match args.topic.as_slice() {
        [] if of_record && !counts => &[Topic::Telemetry.name().to_owned()],
        topics => topics,
    };
    select::choose(&mut kinds, topics)?;
    let kinds = kinds.as_slice();
    // Mistakes on the command line are reported before anything is opened.
    let mut stats = Stats::new(kinds);
    let mut printer = (!counts)
        .then(|| Printer::new(&mut output, format, kinds, &args.fields))
        .transpose()?;
    // A port may reset its board when it is opened. A record says which times it has.
    if place != Place::Record {
        select::check_order(args)?;
    }
    let mut filter = Filter::new(kinds, &args.conditions)?;
    let mut source: Box<dyn Source + '_> = match place {
        Place::Record => Box::new(Record::open(path, kinds, args.follow)?),
        Place::Live => Box::new(Live::connect(&args.control.socket, kinds)?),
        line => Box::new(Line::open((line, path), args, kinds)?),
    };
    let source = source.as_mut();
    filter.range = select::range(args, &source.about(), &name)?;
    let end = args.duration.map(|duration| Instant::now() + duration);
    // Ctrl-C ends a process that prints, as it ends others.
    let interrupt = counts.then(Interrupt::listen).transpose()?;
    let interrupt = interrupt.unwrap_or_default();
    let is_over = || interrupt.is_raised() || end.is_some_and(|end| Instant::now() >= end);
    let pumped = pump(source, &mut printer, &mut stats, &filter, is_over);
    // The rows before a failure are printed as well.
    if let Some(mut printer) = printer {
        printer.flush()?;
    } else {
        let report = stats.report(&name, &source.about());
        let text = match format {
            Format::Json => serde_json::to_string_pretty(&report)?,
            Format::Table | Format::Csv => report.page(brief),
        };
        writeln!(output, "{text}")?;
        output.flush()?;
    }
    pumped?;
    if let Some(note) = source.about().note {
        eprintln!("singletrack: {name}: {note}");
    }
    Ok(())
}

/// Passes the rows of the source to the printer, or to the statistics if there is none, until its end
/// or until `is_over`.
fn pump<W: Write>(
    source: &mut dyn Source,
    printer: &mut Option<Printer<'_, W>>,
    stats: &mut Stats<'_>,
    filter: &Filter<'_>,
    is_over: impl Fn() -> bool,
) -> Result<()> {
    let mut values = Vec::new();
    printer.as_mut().map_or(Ok(()), Printer::flush)?;
    while !is_over() {
        let mut row = match source.next()? {
            Poll::Ready(None) => break,
            Poll::Pending => {
                printer.as_mut().map_or(Ok(()), Printer::flush)?;
                source.wait()?;
                continue;
            }
            Poll::Ready(Some(row)) => row,
        };
        match filter.covers(&row) {
            Some(true) => {}
            Some(false) => continue,
            None => break,
        }
        values.clear();
        if filter.accepts(&mut row, &mut values)? {
            match printer {
                Some(printer) => printer.print(row, &mut values)?,
                None => stats.add(row)?,
            }
        }
    }
    Ok(())
}

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
struct Printer<'a, W: Write> {
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
    fn new(
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
    fn print(&mut self, mut row: Row<'_>, values: &mut Vec<Value>) -> Result<()> {
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
    fn flush(&mut self) -> Result<()> {
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
