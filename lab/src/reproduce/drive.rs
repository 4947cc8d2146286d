//! Drives of experiments in virtual time, on either plant.

use singletrack_control::statistics::RootMeanSquare;
use singletrack_control::{Estimate, Position, front_point};
use singletrack_record::{Entry, Reader, Topic};
use singletrack_scenario::simulate::{
    self, ControlSection, HEADER, MarkerLoss, PlantKind, Row, Scenario, SimulateError,
};

use super::largest;
use crate::{Result, Table};

/// The state that the controller estimated at one time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) time: f64,
    /// P by the true `l_f` and the estimated pose, in m.
    pub(super) point: [f64; 2],
    pub(super) estimate: Estimate,
    /// The commanded steering angle, in rad.
    pub(super) steering: f64,
}

/// The result of a drive.
#[derive(Clone, Debug)]
pub(super) struct Run {
    /// Ground truth and the reference.
    pub(super) rows: Vec<Row>,
    /// The controller's estimates; empty on the ideal plant, where they equal the truth.
    pub(super) seen: Vec<Seen>,
    /// Intervals without markers, in s.
    pub(super) lost: Vec<[f64; 2]>,
    /// Why it ended early, if it did.
    pub(super) ended: Option<String>,
}

/// The plants, with their names in a file and in a sentence.
pub(super) const PLANTS: [(PlantKind, &str, &str); 2] = [
    (PlantKind::Ideal, "ideal", "ideal plant"),
    (PlantKind::Car, "car", "car"),
];

/// Drives by what was driven, and by the plant or the law.
#[derive(Debug, Default)]
pub(super) struct Drives(Vec<(String, &'static str, Run)>);

impl Drives {
    pub(super) fn add(&mut self, case: impl Into<String>, kind: &'static str, run: Option<Run>) {
        self.0.extend(run.map(|run| (case.into(), kind, run)));
    }

    pub(super) fn get(&self, case: &str, kind: &str) -> Option<&Run> {
        let found = self.iter().find(|own| (own.0, own.1) == (case, kind));
        found.map(|(_, _, run)| run)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, &'static str, &Run)> {
        let drives = self.0.iter();
        drives.map(|(case, kind, run)| (case.as_str(), *kind, run))
    }

    /// The drives on one plant, or under one law.
    pub(super) fn of(&self, kind: &str) -> impl Iterator<Item = (&str, &Run)> {
        let drives = self.iter().filter(move |(_, own, _)| *own == kind);
        drives.map(|(case, _, run)| (case, run))
    }
}

/// Period of the controller on the car, in ms.
const PERIOD_MS: u32 = 10;
/// Interval of the rows, in s.
const ROW_S: f64 = 0.05;

/// Drives an experiment on the paper's equations with continuous control, as far as they have a
/// solution, and without cameras.
pub(super) fn ideal(experiment: &Scenario) -> Result<Run> {
    let mut scenario = Scenario {
        marker_loss: Vec::new(),
        ..experiment.clone()
    };
    let mut ended = None;
    let rows = loop {
        match simulate::simulate(&scenario) {
            Ok(simulation) => break simulation.rows,
            // Without a solution, the result is the drive up to there.
            Err(error) => {
                let (time, what) = match &error {
                    SimulateError::Law { time, .. } => (*time, "the law has no answer"),
                    SimulateError::Integration(error) => {
                        (error.time, "the paper's equations have no solution")
                    }
                    _ => return Err(error.into()),
                };
                ended.get_or_insert_with(|| format!("{what} from t = {time:.2} s on"));
                let before = ((time / ROW_S).ceil() - 1.0) * ROW_S;
                if before < ROW_S || before >= scenario.run.duration_s {
                    return Err(error.into());
                }
                scenario.run.duration_s = before;
            }
        }
    };
    Ok(Run {
        rows,
        seen: Vec::new(),
        lost: Vec::new(),
        ended,
    })
}

/// Drives an experiment with the whole pilot on the simulated car, board and cameras.
pub(super) fn car(experiment: &Scenario) -> Result<Run> {
    // The paper's controller compensates neither clock nor actuators.
    let off = ["clock", "actuation"].map(|key| (key.to_owned(), false.into()));
    let mut scenario = experiment.clone();
    scenario.plant.kind = PlantKind::Car;
    scenario.control = ControlSection::new(PERIOD_MS);
    scenario.compensation = Some(off.into_iter().collect());
    let folder =
        tempfile::tempdir().map_err(|error| format!("can't make a temporary folder: {error}"))?;
    let path = folder.path().join("drive.mcap");
    let simulation = simulate::simulate_recorded(&scenario, &path)?;
    let mut seen = Vec::new();
    for entry in Reader::open(&path)?.only(&[Topic::Tick]) {
        let Entry::Tick(tick) = entry? else { continue };
        let output = &tick.output;
        let (Some(time), Some(estimate)) = (output.drive_time, output.estimate) else {
            continue;
        };
        let point: Position = front_point(
            estimate.position,
            estimate.yaw,
            output.actuation.steering,
            scenario.vehicle.front_axle_distance_m,
            scenario.law.point_distance_m,
        );
        seen.push(Seen {
            time,
            point: [point.x, point.y],
            estimate,
            steering: output.actuation.steering,
        });
    }
    Ok(Run {
        rows: simulation.rows,
        seen,
        lost: scenario.marker_loss.iter().map(span).collect(),
        ended: simulation.notes.into_iter().next(),
    })
}

fn span(loss: &MarkerLoss) -> [f64; 2] {
    let seconds = |tick: u64| (tick * u64::from(PERIOD_MS)) as f64 / 1000.0;
    [
        seconds(loss.first_tick),
        seconds(loss.first_tick + loss.ticks),
    ]
}

impl Run {
    /// The trajectory.
    pub(super) fn table(&self) -> Table {
        Table {
            header: HEADER.to_owned(),
            rows: self.rows.iter().map(|row| row.values().to_vec()).collect(),
        }
    }

    /// The distance from the true P to its reference at each row, in m.
    pub(super) fn deviations(&self) -> impl Iterator<Item = f64> + '_ {
        self.rows
            .iter()
            .map(|row| (row.x_p - row.x_ref).hypot(row.y_p - row.y_ref))
    }

    /// The largest of them, in m.
    pub(super) fn largest_deviation(&self) -> f64 {
        largest(self.deviations())
    }

    /// Their root mean square, in m.
    pub(super) fn rms_deviation(&self) -> f64 {
        RootMeanSquare::of(self.deviations()).value().unwrap_or(0.0)
    }

    /// The distance between its P and that of another drive of the same experiment at each row,
    /// in m.
    pub(super) fn differences<'a>(&'a self, other: &'a Self) -> impl Iterator<Item = f64> + 'a {
        let both = self.rows.iter().zip(&other.rows);
        both.map(|(one, other)| (one.x_p - other.x_p).hypot(one.y_p - other.y_p))
    }

    /// The largest of them, in m.
    pub(super) fn largest_difference(&self, other: &Self) -> f64 {
        largest(self.differences(other))
    }

    /// The largest steering angle, in rad.
    pub(super) fn steepest(&self) -> f64 {
        largest(self.rows.iter().map(|row| row.steering.abs()))
    }

    /// The length of P's path, in m.
    pub(super) fn path(&self) -> f64 {
        let steps = self.rows.iter().zip(self.rows.iter().skip(1));
        let lengths = steps.map(|(one, next)| (next.x_p - one.x_p).hypot(next.y_p - one.y_p));
        lengths.sum()
    }
}
