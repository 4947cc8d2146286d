//! `singletrack dump`: a record, the running daemon or the serial line, as a table, as
//! lines of JSON, as CSV, or as statistics.

mod format;
mod line;
mod select;
mod source;
mod stats;

use std::{
    io::{self, IsTerminal, Write},
    path::PathBuf,
    task::Poll,
    time::{Duration, Instant},
};

use clap::Args;
use format::Printer;
use line::Line;
use select::Filter;
use singletrack_core::config::SerialSection;
use singletrack_record::Topic;
use source::{Kind, Live, Place, Record, Source};
use stats::Stats;

use crate::{
    Result, arguments::parse_duration, interrupt::Interrupt, operator::control::ControlArgs,
};

pub use format::Format;
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
    let brief = is_terminal && args.is_bare() && matches!(Place::of(args), Place::Record(_));
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
    let place = Place::of(args);
    let name = place.to_string();
    let of_record = matches!(place, Place::Record(_) | Place::Live);
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
    if !matches!(place, Place::Record(_)) {
        select::check_order(args)?;
    }
    let mut filter = Filter::new(kinds, &args.conditions)?;
    let mut source: Box<dyn Source + '_> = match &place {
        Place::Record(path) => Box::new(Record::open(path, kinds, args.follow)?),
        Place::Live => Box::new(Live::connect(&args.control.socket, kinds)?),
        line => Box::new(Line::open(line, args, kinds)?),
    };
    let source = source.as_mut();
    filter.range = select::range(args, &source.about(), &name)?;
    let end = args.duration.map(|duration| Instant::now() + duration);
    // Ctrl-C ends a process that prints, as it ends others.
    let interrupt = counts
        .then(Interrupt::listen)
        .transpose()?
        .unwrap_or_default();
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
