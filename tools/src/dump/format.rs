//! How entries are printed.

use std::io::{self, BufWriter, Write};

use singletrack_record::{Entry, Shown, Topic, Value};

use super::{DumpError, Format};

/// Prints entries of one topic.
pub(super) struct Printer<W: Write> {
    output: Output<W>,
    /// The fields to print: their names, and which of the topic's they are.
    fields: Vec<(String, usize)>,
    /// Whether whole entries are printed as they are.
    whole: bool,
    topic: Topic,
    text: String,
}

enum Output<W: Write> {
    Table {
        output: BufWriter<W>,
        widths: Vec<usize>,
    },
    Json(BufWriter<W>),
    Csv(Box<csv::Writer<W>>),
}

/// What a table shows of a topic unless asked for more.
fn table_fields(topic: Topic) -> &'static [&'static str] {
    match topic {
        Topic::Tick => &[
            "index",
            "mode",
            "reason",
            "held",
            "point.x_m",
            "point.y_m",
            "reference.position.x_m",
            "reference.position.y_m",
            "estimate.yaw_rad",
            "estimate.speed_m_s",
            "actuation.steering_rad",
            "lateness_ns",
            "capture_to_command_ns",
        ],
        Topic::Telemetry => &[
            "receive_time_ns",
            "mode",
            "stop_cause",
            "last_sequence",
            "imu",
            "forward_acceleration_mm_s2",
            "left_acceleration_mm_s2",
            "yaw_rate_mrad_s",
            "motor_speed_mm_s",
            "servo_us",
            "esc_us",
        ],
        Topic::Pose => &[
            "frame_number",
            "receive_time_ns",
            "state",
            "rejected",
            "pose.x_m",
            "pose.y_m",
            "pose.yaw_rad",
            "pose.mean_error_m",
            "pose.capture_time_ns",
        ],
        Topic::Status | Topic::Log | Topic::Configuration | Topic::Drops => &[],
    }
}

impl<W: Write> Printer<W> {
    /// Prints `wanted` fields, or the format's default if there are none.
    pub(super) fn new(
        output: W,
        format: Format,
        topic: Topic,
        wanted: &[String],
    ) -> Result<Self, DumpError> {
        let known = topic.fields();
        let defaults: Vec<String> = match format {
            Format::Table => table_fields(topic)
                .iter()
                .map(ToString::to_string)
                .collect(),
            Format::Json | Format::Csv => Vec::new(),
        };
        let names = match (wanted.is_empty(), defaults.is_empty()) {
            (false, _) => wanted.to_vec(),
            (true, false) => defaults,
            (true, true) => known.clone(),
        };
        let fields = names
            .into_iter()
            .map(|name| match known.iter().position(|field| *field == name) {
                Some(index) => Ok((name, index)),
                None => Err(unknown_field(topic, name, &known)),
            })
            .collect::<Result<Vec<_>, _>>()?;
        let output = match format {
            Format::Table => Output::Table {
                output: BufWriter::new(output),
                widths: fields.iter().map(|(name, _)| name.len().max(8)).collect(),
            },
            Format::Json => Output::Json(BufWriter::new(output)),
            Format::Csv => Output::Csv(Box::new(csv::Writer::from_writer(output))),
        };
        Ok(Self {
            output,
            fields,
            whole: wanted.is_empty(),
            topic,
            text: String::new(),
        })
    }

    /// Prints the names of the fields, where the format has them.
    pub(super) fn begin(&mut self) -> Result<(), DumpError> {
        let names = self.fields.iter().map(|(name, _)| name);
        match &mut self.output {
            Output::Table { output, widths } => {
                write_row(output, &names.cloned().collect::<Vec<_>>(), widths)?;
            }
            Output::Json(_) => {}
            Output::Csv(output) => output.write_record(names).map_err(csv_error)?,
        }
        Ok(())
    }

    /// Prints an entry of the topic.
    pub(super) fn print(&mut self, entry: &Entry) -> Result<(), DumpError> {
        if self.whole
            && let Output::Json(output) = &mut self.output
        {
            self.text.clear();
            entry.write_json(&mut self.text);
            self.text.push('\n');
            return Ok(output.write_all(self.text.as_bytes())?);
        }
        self.print_values(&entry.values())
    }

    /// Prints an entry of the topic that came as a line of JSON.
    pub(super) fn print_line(&mut self, line: &str, shown: &Shown) -> Result<(), DumpError> {
        if self.whole
            && let Output::Json(output) = &mut self.output
        {
            return Ok(writeln!(output, "{line}")?);
        }
        self.print_values(&shown.values)
    }

    /// Hands everything printed so far to whoever reads it.
    pub(super) fn flush(&mut self) -> Result<(), DumpError> {
        Ok(match &mut self.output {
            Output::Table { output, .. } | Output::Json(output) => output.flush(),
            Output::Csv(output) => output.flush(),
        }?)
    }

    fn print_values(&mut self, values: &[Value]) -> Result<(), DumpError> {
        let chosen = self
            .fields
            .iter()
            .map(|(name, index)| (name, values.get(*index).unwrap_or(&Value::Absent)));
        match &mut self.output {
            Output::Table { output, widths } => {
                let cells: Vec<_> = chosen.map(|(_, value)| cell(value)).collect();
                for (width, cell) in widths.iter_mut().zip(&cells) {
                    *width = (*width).max(cell.chars().count());
                }
                write_row(output, &cells, widths)?;
            }
            Output::Json(output) => {
                let object = singletrack_record::json_object(
                    self.topic,
                    chosen.map(|(name, value)| (name.as_str(), value)),
                );
                writeln!(output, "{object}")?;
            }
            Output::Csv(output) => {
                for (_, value) in chosen {
                    use std::fmt::Write as _;
                    self.text.clear();
                    // Writing to a string does not fail.
                    let _ = write!(self.text, "{value}");
                    output.write_field(&self.text).map_err(csv_error)?;
                }
                output.write_record(None::<&[u8]>).map_err(csv_error)?;
            }
        }
        Ok(())
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

fn write_row(output: &mut impl Write, cells: &[String], widths: &[usize]) -> io::Result<()> {
    for (index, (cell, width)) in cells.iter().zip(widths).enumerate() {
        let gap = if index == 0 { "" } else { "  " };
        write!(output, "{gap}{cell:>width$}")?;
    }
    writeln!(output)
}

fn csv_error(error: csv::Error) -> DumpError {
    match error.into_kind() {
        csv::ErrorKind::Io(error) => DumpError::Output(error),
        other => DumpError::Output(io::Error::other(format!("{other:?}"))),
    }
}

fn unknown_field(topic: Topic, field: String, known: &[String]) -> DumpError {
    // The last part of a path is what people remember.
    let similar = known
        .iter()
        .find(|name| name.contains(&field) || field.contains(name.as_str()))
        .cloned();
    DumpError::UnknownField {
        topic,
        field,
        similar,
        known: known.to_vec(),
    }
}
