//! A log and a map in a folder, and what their import gives.

use std::{
    fs,
    path::{Path, PathBuf},
};

use singletrack_control::{InertialSample, PoseSample};
use singletrack_logs::import::{ImportError, Summary, import};
use singletrack_mocap::Observation;
use singletrack_pilot::{BoardSample, Event};
use singletrack_record::{Entry, Meta, Reader, TickRecord, part_path};
use tempfile::TempDir;

/// A map for [`LOG`]. Sections of tests are added to it.
pub(crate) const MAP: &str = r#"
[time]
column = "t"
unit = "s"
unix = false
[pose]
x = "x"
y = "y"
yaw = "yaw"
[motor]
speed = "v"
[steering]
column = "s"
radians_per_unit = 0.5
"#;

/// A folder that is removed in the end.
pub(crate) struct Bench(TempDir);

impl Bench {
    /// With these contents of `log.csv` and `map.toml`.
    pub(crate) fn new(log: &str, map: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("log.csv"), log).unwrap();
        fs::write(folder.path().join("map.toml"), map).unwrap();
        Self(folder)
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Imports to the file `name`.
    pub(crate) fn import(&self, name: &str) -> Result<Summary, ImportError> {
        let (log, map) = (self.path("log.csv"), self.path("map.toml"));
        import(&[log], &map, &self.path(name), |_, _| {})
    }

    /// The message of an import that fails and leaves nothing, without the folder's name.
    pub(crate) fn error(&self) -> String {
        let error = self.import("out.mcap").unwrap_err().to_string();
        assert!(!self.path("out.mcap").exists(), "{error}");
        assert!(!part_path(&self.path("out.mcap")).exists(), "{error}");
        error.replace(&format!("{}/", self.0.path().display()), "")
    }
}

/// What a record holds.
pub(crate) struct Imported {
    pub(crate) summary: Summary,
    pub(crate) meta: Meta,
    pub(crate) entries: Vec<Entry>,
}

/// Imports a log; the import must succeed.
pub(crate) fn imported(log: &str, map: &str) -> Imported {
    let bench = Bench::new(log, map);
    let summary = match bench.import("out.mcap") {
        Ok(summary) => summary,
        Err(error) => panic!("{error}"),
    };
    read(&bench.path("out.mcap"), summary)
}

/// What the record at a path holds.
pub(crate) fn read(path: &Path, summary: Summary) -> Imported {
    let reader = Reader::open(path).unwrap();
    let meta = reader.meta.clone();
    Imported {
        summary,
        meta,
        entries: reader.map(Result::unwrap).collect(),
    }
}

/// The message of an import that fails.
pub(crate) fn error(log: &str, map: &str) -> String {
    Bench::new(log, map).error()
}

impl Imported {
    pub(crate) fn ticks(&self) -> Vec<&TickRecord> {
        let entries = self.entries.iter();
        let ticks = entries.filter_map(|entry| match entry {
            Entry::Tick(tick) => Some(tick),
            _ => None,
        });
        ticks.collect()
    }

    pub(crate) fn observations(&self) -> Vec<&Observation> {
        let entries = self.entries.iter();
        let observations = entries.filter_map(|entry| match entry {
            Entry::Pose(observation) => Some(observation),
            _ => None,
        });
        observations.collect()
    }

    pub(crate) fn events(&self) -> Vec<Event> {
        let ticks = self.ticks();
        ticks.iter().flat_map(|tick| tick.events.clone()).collect()
    }

    pub(crate) fn poses(&self) -> Vec<PoseSample> {
        let pose = |event| match event {
            Event::Pose(pose) => Some(pose),
            _ => None,
        };
        self.events().into_iter().filter_map(pose).collect()
    }

    pub(crate) fn board(&self) -> Vec<BoardSample> {
        let sample = |event| match event {
            Event::Board(sample) => Some(sample),
            _ => None,
        };
        self.events().into_iter().filter_map(sample).collect()
    }

    pub(crate) fn inertial(&self) -> Vec<InertialSample> {
        let board = self.board();
        board.iter().filter_map(|sample| sample.inertial).collect()
    }

    /// Time in ms since the first row and speed of the samples of the board.
    pub(crate) fn motor_speeds(&self) -> Vec<(f64, f64)> {
        let row = |sample: &BoardSample| (since_ms(sample.time.0), rounded(sample.motor_speed));
        self.board().iter().map(row).collect()
    }

    /// Time in ms since the first row and steering angle of the ticks.
    pub(crate) fn steering(&self) -> Vec<(f64, f64)> {
        let row = |tick: &&TickRecord| {
            let angle = tick.output.actuation.steering;
            (since_ms(tick.scheduled_ns), rounded(angle))
        };
        self.ticks().iter().map(row).collect()
    }
}

/// A time of the record in ms since the first row.
pub(crate) fn since_ms(time_ns: u64) -> f64 {
    (time_ns as f64 - 1e9) / 1e6
}

/// Without the last digits, which are of the decimal fractions.
pub(crate) fn rounded(number: f64) -> f64 {
    (number * 1e9).round() / 1e9
}
