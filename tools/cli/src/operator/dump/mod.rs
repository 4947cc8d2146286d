//! `singletrack dump`: a record, the running daemon or the serial line, as a table, as
//! lines of JSON, as CSV, or as statistics.

mod format;
mod line;
mod select;
mod source;
mod stats;

use std::{
    error::Error,
    fs::File,
    io::{self, IsTerminal, Write},
    os::fd::AsFd as _,
    path::PathBuf,
    time::{Duration, Instant},
};

use clap::Args;
use format::Printer;
use line::{Input, Line};
use select::{Filter, Range};
use singletrack_core::config::SerialSection;
use singletrack_record::{Topic, Value};
use source::{Close, Kind, Live, Next, Place, Record, Row, Source};
use stats::Stats;

use crate::{arguments::parse_duration, interrupt::Interrupt, operator::control::ControlArgs};

pub use format::Format;
pub use select::{Condition, Moment};

/// Why a dump failed, in words for the user.
pub type DumpError = Box<dyn Error>;

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

    /// Whether --stats leaves out the distributions.
    #[arg(skip)]
    pub brief: bool,
}

impl DumpArgs {
    /// What is to be read.
    fn place(&self) -> Place {
        match (&self.serial, &self.source) {
            (Some(port), _) => Place::Serial(port.clone()),
            (None, Some(path)) => Place::of(path),
            (None, None) => Place::Stdin,
        }
    }

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
pub fn run(args: &DumpArgs) -> Result<(), DumpError> {
    let stdout = io::stdout();
    // Thousands of rows are of no use to a person.
    if stdout.is_terminal() && args.is_bare() && matches!(args.place(), Place::Record(_)) {
        let summarised = DumpArgs {
            stats: true,
            brief: true,
            ..args.clone()
        };
        return dump(&summarised, Format::Table, stdout.lock());
    }
    let format = args
        .format
        .unwrap_or(if args.stats || stdout.is_terminal() {
            Format::Table
        } else {
            Format::Csv
        });
    let Err(error) = dump(args, format, stdout.lock()) else {
        return Ok(());
    };
    match *error.downcast::<io::Error>()? {
        error if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        error => Err(format!("can't write to standard output: {error}").into()),
    }
}

/// Prints what is asked for to `output`.
///
/// # Errors
///
/// When the source can't be read, a topic or a field does not exist, or the
/// output can't be written.
pub fn dump(args: &DumpArgs, format: Format, output: impl Write) -> Result<(), DumpError> {
    if args.stats && format == Format::Csv {
        return Err("--stats has no csv: use --format table or --format json".into());
    }
    let place = args.place();
    let of_record = matches!(place, Place::Record(_) | Place::Live);
    let mut kinds = if of_record {
        Kind::topics()
    } else {
        line::kinds()
    };
    let topics = match args.topic.as_slice() {
        [] if of_record && !args.stats => &[Topic::Telemetry.name().to_owned()],
        topics => topics,
    };
    select::choose(&mut kinds, topics)?;
    let kinds = kinds.as_slice();
    // Mistakes on the command line are reported before anything is opened.
    let mut sink = if args.stats {
        Sink::Count(Box::new(Stats::new(kinds, args.brief)), output)
    } else {
        let printer = Printer::new(output, format, kinds, &args.fields, of_record)?;
        Sink::Print(printer)
    };
    let range = Range {
        from: args.from,
        to: args.to,
    };
    // A port may reset its board when it is opened. A record says which times it has.
    if !matches!(place, Place::Record(_)) {
        range.check_order()?;
    }
    let mut filter = Filter::new(kinds, &args.conditions)?;
    let mut source = open(args, &place, kinds)?;
    let source = source.as_mut();
    filter.range = range.since(&source.times(), &place.to_string())?;
    let end = args.duration.map(|duration| Instant::now() + duration);
    let interrupt = if args.stats {
        Interrupt::listen()?
    } else {
        // Ctrl-C ends the process, as it ends others.
        Interrupt::default()
    };
    let is_over = || interrupt.is_raised() || end.is_some_and(|end| Instant::now() >= end);
    sink.flush()?;
    let pumped = pump(source, &mut sink, kinds, &filter, is_over);
    // The rows before a failure are printed as well.
    let close = source.close();
    sink.end(format, &place.to_string(), &close)?;
    pumped?;
    if let Some(note) = close.note {
        eprintln!("singletrack: {note}");
    }
    Ok(())
}

/// Receives the rows.
enum Sink<'a, W: Write> {
    Print(Printer<'a, W>),
    Count(Box<Stats<'a>>, W),
}

impl<W: Write> Sink<'_, W> {
    const fn needs_values(&self) -> bool {
        match self {
            Self::Print(printer) => printer.needs_values(),
            Self::Count(..) => false,
        }
    }

    fn take(
        &mut self,
        row: &Row,
        values: &[Value],
        source: &mut dyn Source,
    ) -> Result<(), DumpError> {
        match self {
            Self::Print(printer) => printer.print(row, values, source)?,
            Self::Count(stats, _) => {
                source.take_message(&mut |message| stats.add(row, message))?;
            }
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), DumpError> {
        match self {
            Self::Print(printer) => printer.flush(),
            Self::Count(..) => Ok(()),
        }
    }

    fn end(&mut self, format: Format, name: &str, close: &Close) -> Result<(), DumpError> {
        let Self::Count(stats, output) = self else {
            return self.flush();
        };
        let report = stats.report(name, close);
        let text = match format {
            Format::Json => serde_json::to_string_pretty(&report).map_err(io::Error::from)?,
            Format::Table | Format::Csv => report.to_string(),
        };
        writeln!(output, "{text}")?;
        Ok(output.flush()?)
    }
}

/// Passes the rows of the source to the sink, until its end or until `is_over`.
fn pump<W: Write>(
    source: &mut dyn Source,
    sink: &mut Sink<'_, W>,
    kinds: &[Kind],
    filter: &Filter<'_>,
    is_over: impl Fn() -> bool,
) -> Result<(), DumpError> {
    let needs_values = sink.needs_values() || filter.needs_values();
    let mut values = Vec::new();
    while !is_over() {
        let row = match source.next()? {
            Next::End => break,
            Next::Pending => {
                sink.flush()?;
                source.wait()?;
                continue;
            }
            Next::Row(row) => row,
        };
        if !kinds.get(row.kind).is_some_and(|kind| kind.chosen) {
            continue;
        }
        if filter.is_over(&row) {
            break;
        }
        if !filter.covers(&row) {
            continue;
        }
        if needs_values {
            source.read_values(&mut values)?;
            let time_s = row.time_ns.map(|ns| ns as f64 / 1e9);
            values.push(time_s.map_or(Value::Absent, Value::Float));
        }
        if filter.accepts(row.kind, &values) {
            sink.take(&row, &values, source)?;
        }
    }
    Ok(())
}

fn open<'a>(
    args: &DumpArgs,
    place: &Place,
    kinds: &'a [Kind],
) -> Result<Box<dyn Source + 'a>, DumpError> {
    let name = place.to_string();
    let (input, follow) = match place {
        Place::Record(path) => return Ok(Box::new(Record::open(path, kinds, args.follow)?)),
        Place::Live => return Ok(Box::new(Live::connect(&args.control.socket, kinds)?)),
        Place::Serial(path) => (Input::serial(path, args.baud)?, false),
        Place::Raw(path) => (Input::capture(&name, File::open(path))?, args.follow),
        Place::Stdin => {
            let file = io::stdin().as_fd().try_clone_to_owned().map(File::from);
            (Input::capture(&name, file)?, false)
        }
    };
    let line = Line::new(name, input, kinds, follow);
    Ok(Box::new(line))
}
