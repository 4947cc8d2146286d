//! What a run came to, in numbers.

use std::path::PathBuf;

use serde::Serialize;
use singletrack_core::LineCounters;
use singletrack_mocap::planar::PlanarCounters as MocapCounters;
use singletrack_pilot::{Event, Mode};
use singletrack_record::TickRecord;
use singletrack_statistics::{DurationHistogram, Percentiles};

use crate::realtime::RealTimeStatus;

/// What a run came to.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The figures.
    #[serde(flatten)]
    pub figures: Figures,
    /// What the system granted the control thread.
    pub realtime: RealTimeStatus,
    /// The record, if there is one.
    pub record: Option<PathBuf>,
    /// Why there is no complete record although there should be one.
    pub record_error: Option<String>,
}

/// Counts and times since the daemon started.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Control ticks.
    pub ticks: u64,
    /// Of those, ticks that drove the car.
    pub driving_ticks: u64,
    /// Points of the control grid at which no tick ran.
    pub deadline_misses: u64,
    /// How late ticks began.
    pub lateness_us: Percentiles,
    /// From mid-exposure to the command that rests on it leaving; ticks without
    /// a new pose are not in it.
    pub capture_to_command_us: Percentiles,
    /// How long ticks took.
    pub tick_duration_us: Percentiles,
    /// The line to the board.
    pub frames: Frames,
    /// The cameras.
    pub mocap: MocapFigures,
    /// What found no room somewhere on its way; zeros are good.
    pub dropped: Dropped,
}

/// The line to the board, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Frames {
    /// Frames made for the board.
    pub sent: u64,
    /// Good frames from the board.
    pub received: u64,
    /// Frames whose checksum was wrong.
    pub crc_errors: u64,
    /// Frames damaged otherwise.
    pub decode_errors: u64,
    /// Drive commands that were written.
    pub drives_written: u64,
    /// Drive commands that were not, because the line was stuck, silent or closed.
    pub drives_withheld: u64,
    /// Telemetry records that the board made and the host never saw.
    pub telemetry_missing: u64,
    /// Times that the board was silent for too long.
    pub links_lost: u64,
    /// Times that the port hung up.
    pub hang_ups: u64,
    /// Times that the board restarted.
    pub board_restarts: u64,
    /// Requests that the board never answered.
    pub requests_unanswered: u64,
}

/// The cameras, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MocapFigures {
    /// Frames taken.
    pub frames: u64,
    /// Frames that never came.
    pub lost: u64,
    /// Driving ticks with no new valid pose since the tick before.
    pub held_ticks: u64,
    /// Frames without a valid pose that driving ticks saw.
    pub missing_while_driving: u64,
    /// Frames with a valid pose.
    pub valid: u64,
    /// Frames with the body untracked.
    pub untracked: u64,
    /// Frames without the body.
    pub absent: u64,
    /// Frames with a pose not believed.
    pub rejected: u64,
    /// Frames older than the newest.
    pub late: u64,
    /// Frames that came twice.
    pub duplicates: u64,
    /// Datagrams that could not be decoded.
    pub malformed: u64,
    /// Datagrams from another address.
    pub wrong_source: u64,
    /// Times the stream became silent.
    pub stale: u64,
    /// Times the session began anew.
    pub restarts: u64,
}

/// What found no room, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Dropped {
    /// Events that a tick could not take in.
    pub events: u64,
    /// Observations on their way to the control thread; known at the end.
    pub observations: u64,
    /// Bytes of the line on their way to the control thread; known at the end.
    pub serial_bytes: u64,
    /// Reports of the control thread.
    pub reports: u64,
    /// Entries that the record does not hold.
    pub record_entries: u64,
}

/// [`Figures`] in the making.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tally {
    figures: Figures,
    lateness: DurationHistogram,
    latency: DurationHistogram,
    duration: DurationHistogram,
}

impl Tally {
    pub(crate) fn tick(&mut self, tick: &TickRecord) {
        let figures = &mut self.figures;
        figures.ticks += 1;
        figures.deadline_misses += u64::from(tick.skipped);
        figures.dropped.events += u64::from(tick.events_dropped);
        self.lateness
            .add(u64::try_from(tick.lateness_ns()).unwrap_or(0));
        self.duration
            .add(tick.finish_ns.saturating_sub(tick.start_ns));
        if tick.output.mode == Mode::Driving {
            figures.driving_ticks += 1;
            figures.mocap.held_ticks += u64::from(tick.output.held);
            let missing = tick.events.iter();
            figures.mocap.missing_while_driving += missing
                .filter(|event| matches!(event, Event::PoseMissing(_)))
                .count() as u64;
        }
        if !tick.output.held
            && let Some(latency) = tick.capture_to_command_ns()
        {
            self.latency.add(u64::try_from(latency).unwrap_or(0));
        }
    }

    pub(crate) fn line(&mut self, counters: &LineCounters) {
        let link = &counters.link;
        self.figures.dropped.reports = counters.reports_dropped;
        self.figures.frames = Frames {
            sent: link.frames_sent,
            received: link.frames_received,
            crc_errors: link.crc_errors,
            decode_errors: link.decode_errors,
            drives_written: counters.drives_written,
            drives_withheld: counters.drives_withheld,
            telemetry_missing: link.telemetry_missing,
            links_lost: link.links_lost,
            hang_ups: link.hang_ups,
            board_restarts: link.board_restarts,
            requests_unanswered: link.requests_unanswered,
        };
    }

    pub(crate) fn mocap(&mut self, counters: &MocapCounters) {
        let session = &counters.session;
        self.figures.mocap = MocapFigures {
            frames: session.frames,
            lost: session.lost,
            held_ticks: self.figures.mocap.held_ticks,
            missing_while_driving: self.figures.mocap.missing_while_driving,
            valid: counters.valid,
            untracked: counters.untracked,
            absent: counters.absent,
            rejected: counters.rejected.total(),
            late: session.late,
            duplicates: session.duplicates,
            malformed: session.malformed,
            wrong_source: session.wrong_source,
            stale: session.stale,
            restarts: session.restarts,
        };
    }

    pub(crate) fn record_dropped(&mut self, entries: u64) {
        self.figures.dropped.record_entries = entries;
    }

    pub(crate) fn dropped_on_the_way(&mut self, observations: u64, serial_bytes: u64) {
        self.figures.dropped.observations = observations;
        self.figures.dropped.serial_bytes = serial_bytes;
    }

    pub(crate) fn figures(&self) -> Figures {
        Figures {
            lateness_us: self.lateness.percentiles(),
            capture_to_command_us: self.latency.percentiles(),
            tick_duration_us: self.duration.percentiles(),
            ..self.figures.clone()
        }
    }
}
