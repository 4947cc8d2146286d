//! The figures of a drive, each as in the paper's experimental section or about
//! how the controller ran.

use clap::ValueEnum;
use singletrack_control::{statistics::Distribution, words};

use crate::{
    figure::{Axis, Bar, Column, Curve, Figure, Look, Mark, MarkKind, Panel, Rule, Scale, Symbol},
    plot::drive::{Drive, Sample, TickSample},
};

/// What the shading of every figure means.
const LOST: &str = "markers lost";

words! {
    /// A figure of a drive, with its name on the command line and of its file; in the order of a
    /// report.
    #[derive(ValueEnum)]
    pub enum FigureKind {
        /// Nominal and actual path of P.
        Trajectory = "trajectory",
        /// Distance of P from where it should be.
        TrackingError = "tracking-error",
        /// x and y of P over time.
        Position = "position",
        /// The velocity commanded of P.
        CommandedVelocity = "commanded-velocity",
        /// The steering angle that the law asks for.
        Steering = "steering",
        /// The speed that the law asks for, and the car's.
        Speed = "speed",
        /// Sideslip angle and yaw rate.
        SideslipYawRate = "sideslip-yaw-rate",
        /// From mid-exposure to the command that rests on it.
        Latency = "latency",
        /// How late ticks began.
        Lateness = "lateness",
    }
}

impl FigureKind {
    /// The figures of a drive: all, without the lateness if it is always zero.
    pub fn of(drive: &Drive) -> impl Iterator<Item = Self> {
        let is_never_late = drive.is_never_late();
        let has = move |kind: &Self| *kind != Self::Lateness || !is_never_late;
        Self::ALL.into_iter().filter(has)
    }

    /// The name of its file.
    pub fn file_name(self) -> String {
        format!("{}.svg", self.name())
    }

    /// The figure of a drive.
    ///
    /// # Errors
    ///
    /// What the drive lacks for it.
    pub fn draw(self, drive: &Drive) -> Result<Figure, &'static str> {
        let figure = match self {
            Self::Trajectory => trajectory(drive),
            Self::Position => position(drive),
            Self::CommandedVelocity => commanded_velocity(drive),
            Self::Steering => steering(drive),
            Self::Speed => speed(drive),
            Self::SideslipYawRate => sideslip_and_yaw_rate(drive),
            Self::TrackingError => tracking_error(drive),
            Self::Latency => latency(drive),
            Self::Lateness => lateness(drive),
        };
        // The reference alone is not what it is about.
        let needs_point = matches!(self, Self::Trajectory | Self::Position);
        let has_point = drive.ticks.iter().any(|tick| tick.point[0].is_finite());
        let is_empty = figure.panels.iter().all(crate::figure::Panel::is_empty);
        if !is_empty && (has_point || !needs_point) {
            return Ok(figure);
        }
        Err(match self {
            Self::Trajectory | Self::Position => "no tick knows where P was",
            Self::CommandedVelocity => "no tick commands a velocity of P",
            Self::Steering => "no tick has a steering angle",
            Self::Speed => "no tick has a speed",
            Self::SideslipYawRate => "no tick has an estimate of the state",
            Self::TrackingError => "no tick knows both where P was and where it should be",
            Self::Latency => "no command rests on a new pose and was written",
            Self::Lateness => "there are no ticks",
        })
    }
}

/// The lowest tracking error on its logarithmic axis, in mm.
const LEAST_ERROR: f64 = 0.1;

/// Samples farther apart than this were not neighbours, in s: a line between them
/// would be invented.
const GAP: f64 = 0.25;

/// A panel over the time of the drive, with the spans without markers.
fn over_time(drive: &Drive, y: Axis, curves: Vec<Curve>) -> Panel {
    Panel {
        spans: drive.lost_markers(),
        span_name: LOST,
        curves,
        ..Panel::new(Axis::TIME, y)
    }
}

const fn axis(
    quantity: &'static str,
    letter: &'static str,
    below: &'static str,
    unit: &'static str,
) -> Axis {
    Axis::new(quantity, Some(Symbol::new(letter, below)), unit)
}

/// A number for each sample, with a gap where samples are missing.
fn column<S: Sample>(samples: &[S], value: impl Fn(&S) -> f64) -> Column {
    let neighbours = samples.chunk_by(|one, next| next.time() - one.time() <= GAP);
    let mut column = Vec::new();
    for run in neighbours {
        if !column.is_empty() {
            column.push(f64::NAN);
        }
        column.extend(run.iter().map(&value));
    }
    column.into()
}

/// A line through a number of each sample.
fn line<S: Sample>(
    samples: &[S],
    name: &'static str,
    look: Look,
    value: impl Fn(&S) -> f64,
) -> Curve {
    let time = column(samples, Sample::time);
    Curve::new(name, look, &time, column(samples, value))
}

/// A line through a place of each sample.
fn path<S: Sample>(
    samples: &[S],
    name: &'static str,
    look: Look,
    place: impl Fn(&S) -> [f64; 2],
) -> Curve {
    let [x, y] = [0, 1].map(|axis: usize| column(samples, |sample| place(sample)[axis]));
    Curve {
        time: Some(column(samples, Sample::time)),
        ..Curve::new(name, look, &x, y)
    }
}

/// A part of a caption that is not always true.
const fn only_if(is_so: bool, part: &str) -> &str {
    if is_so { part } else { "" }
}

fn commanded_velocity(drive: &Drive) -> Figure {
    let panel = |below, along: usize| {
        let y = axis("velocity", "v", below, "m/s");
        let velocity = |tick: &TickSample| tick.point_velocity[along];
        let curves = vec![line(&drive.ticks, "commanded", Look::Actual, velocity)];
        over_time(drive, y, curves)
    };
    Figure::page(
        "Commanded velocity of P",
        "The velocity that the position loop, or the reference alone, asks of the \
         point P along x and y: the input of the linearising law.",
        vec![panel("Px", 0), panel("Py", 1)],
    )
}

fn steering(drive: &Drive) -> Figure {
    let curves = vec![
        line(&drive.ticks, "commanded", Look::Actual, |it| it.steering),
        line(&drive.truth, "true", Look::Truth, |it| it.steering),
    ];
    Figure::column(
        "Steering angle commanded by the law",
        "The steering angle that the linearising law asks for, after the limits of \
         angle and rate; left is positive.",
        vec![over_time(drive, axis("steering", "δ", "", "rad"), curves)],
    )
}

fn speed(drive: &Drive) -> Figure {
    let (ticks, board) = (&drive.ticks, &drive.board);
    let curves = vec![
        line(ticks, "reference", Look::Nominal, |it| it.commanded_speed),
        line(ticks, "actual", Look::Actual, |it| it.speed),
        // Above what is estimated from them, which would hide them.
        line(board, "motor pulses", Look::Measured, |it| it.motor_speed),
        line(&drive.truth, "true", Look::Truth, |it| it.speed),
    ];
    let pulses = ", and of the rear axle as the motor's pulses measure it";
    let pulses = only_if(!drive.board.is_empty(), pulses);
    Figure::column(
        "Reference and actual speed",
        format!(
            "The speed of the centre of mass that the law asks for, after limits, and the car's: \
             as estimated{pulses}."
        ),
        vec![over_time(drive, axis("speed", "v", "", "m/s"), curves)],
    )
}

fn position(drive: &Drive) -> Figure {
    let panel = |letter, along: usize| {
        let (ticks, truth) = (&drive.ticks, &drive.truth);
        let curves = vec![
            line(ticks, "nominal", Look::Nominal, |it| it.nominal[along]),
            line(ticks, "actual", Look::Actual, |it| it.point[along]),
            line(truth, "true", Look::Truth, |it| it.point[along]),
        ];
        over_time(drive, axis("position", letter, "P", "m"), curves)
    };
    let wanted = match drive.has_positions() {
        true => "Where the reference wants P",
        false => "Where P would be if it integrated its commanded velocity",
    };
    let held = "; while the markers are lost the last pose is held and the curves stay level though \
                the car moves";
    let held = only_if(!drive.lost_markers().is_empty(), held);
    Figure::page(
        "Position of P over time",
        format!("{wanted}, and where P was{held}."),
        vec![panel("x", 0), panel("y", 1)],
    )
}

fn sideslip_and_yaw_rate(drive: &Drive) -> Figure {
    let sideslip = vec![
        line(&drive.ticks, "estimated", Look::Actual, |it| it.sideslip),
        line(&drive.truth, "true", Look::Truth, |it| it.sideslip),
    ];
    let gyro = line(&drive.board, "gyro", Look::Measured, |it| it.yaw_rate);
    let has_gyro = !gyro.is_empty();
    let yaw_rate = vec![
        gyro,
        line(&drive.ticks, "estimated", Look::Actual, |it| it.yaw_rate),
        line(&drive.truth, "true", Look::Truth, |it| it.yaw_rate),
    ];
    Figure::page(
        "Sideslip angle and yaw rate",
        format!(
            "The estimated angle from the car's axis to the velocity of its centre of mass, and \
             its yaw rate{}; left is positive.",
            only_if(has_gyro, " over the gyro's samples")
        ),
        vec![
            over_time(drive, axis("sideslip", "β", "", "rad"), sideslip),
            over_time(drive, axis("yaw rate", "r", "", "rad/s"), yaw_rate),
        ],
    )
}

fn tracking_error(drive: &Drive) -> Figure {
    let true_errors = drive.truth.iter().map(|sample| drive.true_error(sample));
    let errors = drive.ticks.iter().map(TickSample::error).chain(true_errors);
    let errors: Vec<f64> = errors.filter(|error| error.is_finite()).collect();
    let least = errors.iter().copied().fold(f64::INFINITY, f64::min);
    let most = errors.iter().copied().fold(0.0, f64::max);
    // The approach and the last millimetres on one axis; but errors of one size as they are.
    let is_wide = most > 10.0 * least;
    let y = Axis {
        scale: if is_wide { Scale::Log } else { Scale::Linear },
        include: (!is_wide).then_some(0.0),
        ..axis("tracking error", "e", "P", "mm")
    };
    let is_below = |error: f64| error * 1000.0 < LEAST_ERROR;
    let is_cut = is_below(least);
    // A comparison keeps the gaps, which `max` fills.
    let mm = |error: f64| match is_below(error) {
        true => LEAST_ERROR,
        false => error * 1000.0,
    };
    let (ticks, truth) = (&drive.ticks, &drive.truth);
    let curves = vec![
        line(ticks, "estimated", Look::Actual, |it| mm(it.error())),
        line(truth, "true", Look::Truth, |it| mm(drive.true_error(it))),
    ];
    Figure::column(
        "Tracking error of P",
        format!(
            "Distance from P to where it should be at that moment{}{}.",
            only_if(is_wide, ", on a logarithmic axis"),
            only_if(is_cut && is_wide, "; what is below 0.1 mm is drawn there")
        ),
        vec![over_time(drive, y, curves)],
    )
}

fn trajectory(drive: &Drive) -> Figure {
    let what = match drive.is_estimated() {
        true => "P",
        false => "the rigid body",
    };
    let end = match drive.ended {
        Some(_) => "drive ended",
        None => "record ends",
    };
    let places = drive.ticks.iter().map(|tick| tick.point);
    let mut seen = places.filter(|point| point[0].is_finite());
    let start = seen.next();
    let ends = [
        ("start", MarkKind::Start, start),
        ("end", MarkKind::End, seen.next_back().or(start)),
    ];
    let mark = |(name, kind, point): (_, _, Option<_>)| {
        Some(Mark {
            name,
            kind,
            point: point?,
        })
    };
    Figure::column(
        format!("Trajectory of {what}"),
        format!(
            "Where {what} should be and where it was on the floor, from the triangle to the circle, \
             where the {end}."
        ),
        vec![Panel {
            height_mm: 90.0,
            curves: vec![
                lost(drive),
                path(&drive.ticks, "nominal", Look::Nominal, |it| it.nominal),
                path(&drive.ticks, "actual", Look::Actual, |it| it.point),
                path(&drive.truth, "true", Look::Truth, |it| it.point),
            ],
            marks: ends.into_iter().filter_map(mark).collect(),
            ..Panel::floor("P")
        }],
    )
}

/// The path while the markers were lost: the true one if it is known, or what
/// the estimate held and then jumped to.
fn lost(drive: &Drive) -> Curve {
    let path: Vec<(f64, [f64; 2])> = match drive.truth.is_empty() {
        false => drive.truth.iter().map(|it| (it.time, it.point)).collect(),
        true => drive.ticks.iter().map(|it| (it.time, it.point)).collect(),
    };
    let mut points = Vec::new();
    for [from, to] in drive.lost_markers() {
        let first = path.partition_point(|(time, _)| *time < from);
        let end = path.partition_point(|(time, _)| *time <= to);
        // With the last point that was seen.
        points.extend(path.iter().take(end).skip(first.saturating_sub(1)));
        points.push((to, [f64::NAN; 2]));
    }
    let column = |axis: usize| -> Column { points.iter().map(|(_, point)| point[axis]).collect() };
    Curve {
        time: Some(points.iter().map(|(time, _)| *time).collect()),
        ..Curve::new(LOST, Look::Lost, &column(0), column(1))
    }
}

/// Bars in a linear histogram.
const BARS: usize = 50;
/// Bars in every decade of a logarithmic one.
const BARS_A_DECADE: i32 = 8;
/// What a histogram counts.
const PART: Axis = Axis::new("part of the ticks", None, "%");
/// Lateness below this is in the first bar, in µs.
const LEAST_LATENESS: f64 = 1.0;

fn latency(drive: &Drive) -> Figure {
    let values = drive.ticks.iter().map(|tick| tick.latency * 1000.0);
    let latency = Distribution::of(values);
    let mut panel = Panel::new(Axis::new("mid-exposure to command", None, "ms"), PART);
    let mut beyond = 0;
    if let (Some(least), Some(p99), Some(most)) =
        (latency.min(), latency.quantile(0.99), latency.max())
    {
        // A single outlier must not press all others into one bar.
        let end = if most > p99 + 2.0 * (p99 - least).max(0.1) {
            p99 + (p99 - least).max(0.1)
        } else {
            most
        };
        let (bars, outside) = linear(&latency, least.floor(), end.ceil());
        (panel.bars, beyond) = (bars, outside);
        panel.rules = rules(&latency, "ms", 1);
    }
    let beyond = match beyond {
        0 => String::new(),
        count => format!("; {count} more are beyond the axis"),
    };
    Figure::column(
        "Latency from capture to command",
        format!(
            "From the middle of the cameras' exposure to the drive command that rests on it \
             leaving for the board, in ticks with a new pose{beyond}."
        ),
        vec![panel],
    )
}

fn lateness(drive: &Drive) -> Figure {
    let values = drive.ticks.iter().map(|tick| tick.lateness * 1e6);
    let lateness = Distribution::of(values);
    let axis = Axis::new("lateness of a tick", None, "µs").including(LEAST_LATENESS);
    let mut panel = Panel::new(axis.logarithmic(), PART);
    panel.bars = logarithmic(&lateness);
    panel.rules = rules(&lateness, "µs", 0);
    for rule in &mut panel.rules {
        rule.value = rule.value.max(LEAST_LATENESS);
    }
    Figure::column(
        "Lateness of the control ticks",
        "How much later than scheduled the control thread woke up, on a logarithmic \
         axis; what is below 1 µs is in the first bar.",
        vec![panel],
    )
}

fn rules(distribution: &Distribution, unit: &str, decimals: usize) -> Vec<Rule> {
    [("median", 0.5), ("99 %", 0.99)]
        .into_iter()
        .filter_map(|(name, part)| {
            let value = distribution.quantile(part)?;
            Some(Rule {
                name: format!("{name}: {value:.decimals$} {unit}"),
                value,
            })
        })
        .collect()
}

/// Bars of equal width from `low` to `high`, in % of all values, and how many
/// values are outside.
fn linear(values: &Distribution, low: f64, high: f64) -> (Vec<Bar>, usize) {
    let high = high.max(low + 1.0);
    let edge = |index: usize| low + (high - low) * index as f64 / BARS as f64;
    let edges: Vec<f64> = (0..=BARS).map(edge).collect();
    let bars = bars(values, &edges);
    let beyond = values.count() - values.count_up_to(high);
    (bars, beyond)
}

/// Bars of equal width on a logarithmic axis from [`LEAST_LATENESS`] on, in % of
/// all values; those below it are in the first.
fn logarithmic(values: &Distribution) -> Vec<Bar> {
    let Some(most) = values.max() else {
        return Vec::new();
    };
    let decades = (most.max(10.0 * LEAST_LATENESS).log10().ceil()) as i32;
    let edge = |index: i32| 10_f64.powf(f64::from(index) / f64::from(BARS_A_DECADE));
    let edges: Vec<f64> = (0..=decades * BARS_A_DECADE).map(edge).collect();
    bars(values, &edges)
}

/// The bars of the values from one edge up to the next, which the last bar includes; the first
/// bar holds all values below it as well.
fn bars(values: &Distribution, edges: &[f64]) -> Vec<Bar> {
    let mut below = 0;
    let bars = edges.windows(2).enumerate().map(|(index, ends)| {
        let end = if index + 2 == edges.len() {
            values.count_up_to(ends[1])
        } else {
            values.count_below(ends[1])
        };
        let count = end - std::mem::replace(&mut below, end);
        Bar {
            span: [ends[0], ends[1]],
            height: 100.0 * count as f64 / values.count().max(1) as f64,
        }
    });
    bars.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_hold_all_values_once() {
        let values = Distribution::of((0..1000).map(|index| 8.0 + f64::from(index) * 0.004));
        let (bars, beyond) = linear(&values, 8.0, 12.0);
        let all: f64 = bars.iter().map(|bar| bar.height).sum();
        assert!((all - 100.0).abs() < 1e-9 && beyond == 0, "{all} {beyond}");
        let (bars, beyond) = linear(&values, 8.0, 10.0);
        let all: f64 = bars.iter().map(|bar| bar.height).sum();
        assert!(
            (all + 0.1 * beyond as f64 - 100.0).abs() < 1e-9,
            "{all} {beyond}"
        );
    }

    #[test]
    fn lateness_of_nothing_is_in_the_first_bar() {
        let bars = logarithmic(&Distribution::of([-3.0, 0.0, 0.5, 1000.0]));
        assert_eq!(bars[0].height, 75.0);
        assert_eq!(bars[bars.len() - 1].height, 25.0);
        assert_eq!(bars[bars.len() - 1].span[1], 1000.0);
    }
}
