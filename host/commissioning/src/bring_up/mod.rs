//! The bring-up of a car whose wheels are clear of the floor: it measures everything that servo
//! and ESC do before the car is put down.
//!
//! The kill switch comes first, then the ESC at rest, the servo, the motor, and every way to stop.
//! All pulses are jogs: the board holds them within its own limits, and ends them when the
//! command line, the daemon or the line is gone. The cameras watch the car in every tick, and an
//! emergency stop ends the step if it leaves its stand.
//!
//! "Now" and "just now" in a question are the moment of its answer. The servo stays where a jog left it:
//! angles are read while the car is disarmed.
//!
//! A step that measures puts its result in force, because later steps rely on it. An interrupted
//! bring-up continues after the last step that was completed.

mod car;
mod esc;
mod motor;
mod steering;
mod stops;

use std::borrow::Cow;

use self::{
    car::{Car, armed},
    motor::mean_speed,
};
use crate::{
    Answer, Answers, Bench, BoardReading, Finding, Inertial, Plot, PlotKind, PlotLine, Question,
    Step, Trouble, Verdict,
    finding::{change, failed, keys, require},
    imu_noise::{Comparison, NoiseLevel, compare},
};

/// The steps. The ESC is watched at neutral for a minute in each order, to find a motor that
/// turns only now and then.
pub const STEPS: &[Step] = &steps_with::<60>();

/// The steps; the ESC is watched at neutral for `NEUTRAL_S` seconds in each order.
pub const fn steps_with<const NEUTRAL_S: u32>() -> [Step; 16] {
    [
        Step::new("stand", "The car on its stand", find_stand).expecting(
            "All wheels are clear of the floor, the cameras see the car, and it stands still.",
        ),
        Step::new(
            "kill",
            "The kill switch of the ESC's supply",
            esc::find_kill,
        )
        .expecting("The supply of the ESC can be cut, also while its pulse drives the motor."),
        Step::new(
            "esc-neutral",
            "The ESC at neutral",
            esc::find_neutral::<NEUTRAL_S>,
        )
        .expecting(
            "No pulse of the motor at neutral, with the ESC switched on before and after the \
             board.",
        ),
        Step::new(
            "servo-direction",
            "Direction of the servo",
            steering::direction,
        )
        .expecting(
            "A longer pulse steers to the side that the sign of board.servo.gain_us_per_rad says.",
        ),
        Step::new("servo-centre", "Centre of the servo", steering::centre)
            .expecting("The front wheels point straight on at board.servo.centre_us."),
        Step::new("servo-stops", "End stops of the servo", steering::stops)
            .expecting("From board.servo.min_us to max_us the servo reaches no mechanical stop."),
        Step::new("servo-gain", "Gain of the servo", steering::gain)
            .expecting("The angle of the front wheels follows board.servo.gain_us_per_rad."),
        Step::new(
            "motor-direction",
            "Direction of the motor",
            motor::direction,
        )
        .expecting("A pulse above neutral drives forward, and the motor's pulses count."),
        Step::new("motor-map", "Deadband and speeds of the motor", motor::map).expecting(
            "The wheels stand at board.esc.neutral_us plus and minus deadband_us, and turn beyond.",
        ),
        Step::new(
            "esc-kind",
            "What a pulse below neutral does",
            esc::find_kind,
        )
        .expecting("board.esc.kind says what a pulse below neutral does."),
        Step::new("stop-silence", "Stop: no more jogs", stops::silence).expecting(
            "Without another jog the pulse is neutral within 0.45 s: the hold of 0.25 s, and \
             0.2 s.",
        ),
        Step::new("stop-disarm", "Stop: disarm", stops::disarm).expecting(
            "Disarming gives the neutral pulse within 0.2 s, and the ESC obeys within 0.2 s.",
        ),
        Step::new("stop-switch", "Stop: the stop switch", stops::switch).expecting(
            "The stop switch latches the board's emergency stop, and the ESC obeys within 0.2 s.",
        ),
        Step::new("stop-reset", "Stop: reset of the board", stops::reset)
            .expecting("A reset of the board stops the motor at once."),
        Step::new("stop-unplug", "Stop: the cable", stops::unplug)
            .expecting("A pulled cable stops the motor at once."),
        Step::new("stop-emergency", "Stop: emergency stop", stops::emergency).expecting(
            "An emergency stop gives the neutral pulse within 0.2 s, and the ESC obeys within \
             0.2 s.",
        ),
    ]
}

impl dyn Bench + '_ {
    /// Asks a question that must not be skipped.
    fn answer(
        &mut self,
        id: &'static str,
        text: impl Into<Cow<'static, str>>,
        answers: Answers,
    ) -> Result<Answer, Trouble> {
        let text = text.into();
        match self.ask(&Question { id, text, answers })? {
            Answer::Skip => Err(Trouble::Skipped),
            answer => Ok(answer),
        }
    }

    /// Waits until the operator is ready to do this, or has done it.
    fn ready(&mut self, id: &'static str, request: &'static str) -> Result<(), Trouble> {
        self.answer(id, request, Answers::Begin).map(drop)
    }

    /// Asks for yes or no.
    fn ask_yes(
        &mut self,
        id: &'static str,
        text: impl Into<Cow<'static, str>>,
    ) -> Result<bool, Trouble> {
        Ok(self.answer(id, text, Answers::YesNo)? == Answer::YesNo(true))
    }

    /// Asks for one of several words.
    fn ask_word(
        &mut self,
        id: &'static str,
        text: &'static str,
        words: &'static [&'static str],
    ) -> Result<&'static str, Trouble> {
        match self.answer(id, text, Answers::Choice(words))? {
            Answer::Choice(index) => words.get(index).copied().ok_or(Trouble::Skipped),
            _ => Err(Trouble::Skipped),
        }
    }
}

/// Time for which the car must be at rest, s.
const WATCHED_S: f64 = 2.0;

fn find_stand(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let text = "Put the car on a stand in view of the cameras, all wheels clear of everything, and \
                take your hands off. Does it stand so?";
    let is_on_stand = bench.ask_yes("on-stand", text)?;
    let fix = "Put a box under the chassis so that all wheels turn freely.";
    require(is_on_stand, "the car is not on a stand", fix)?;
    let mut car = Car::look(bench)?;
    let readings = car.watch(WATCHED_S, "standing")?;
    let turns = readings.iter().any(BoardReading::turns);
    let found = "the motor turns although the car is not armed";
    let fix = "Cut the supply of the ESC. Its neutral is not at 1500 us, or the pulse sensor picks \
               up interference: see docs/uno.md.";
    require(!turns, found, fix)?;
    Ok(Finding::good("the car stands still in view of the cameras"))
}

/// Time at rest, s.
const REST_S: f64 = 15.0;

/// Speeds of the wheels, m/s; the board ends a jog beyond 1.0.
const SPEEDS: [f64; 3] = [0.25, 0.5, 0.7];

/// Runs at each speed, and the time in which a speed settles and is measured, s. The board allows
/// 10 s of driving without a rest.
const RUNS: usize = 3;
const SETTLE_S: f64 = 1.0;
const MEASURE_S: f64 = 4.0;

pub(super) fn find_imu_noise(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    // In every run: the car may have been put down after an interruption.
    find_stand(bench)?;
    let kill = esc::find_kill(bench)?;
    let at_rest = Car::look(bench)?.watch(REST_S, "at rest")?;
    let mut levels = vec![noise_level(0.0, &[at_rest])?];
    for wanted in SPEEDS {
        let runs = armed(bench, |car| noise_runs(car, wanted))?;
        let speed = mean_speed(&runs.concat());
        levels.push(noise_level(speed, &runs)?);
    }
    let comparison = compare(&levels, &bench.configuration().estimator);
    bench.plot(&noise_plot(&levels));
    change(bench, &keys(&comparison.parameters))?;
    Ok(noise_finding(comparison, &kill))
}

/// The telemetry of some runs at about this speed, m/s.
fn noise_runs(car: &mut Car<'_>, wanted: f64) -> Result<Vec<Vec<BoardReading>>, Trouble> {
    let jog = car.spin(wanted)?;
    let rest = car.rest();
    let mut runs = Vec::new();
    for _ in 0..RUNS {
        car.hold_until_standing(rest, 0.8)?;
        car.hold(jog, SETTLE_S, "settling")?;
        runs.push(car.hold(jog, MEASURE_S, "measuring the IMU")?);
    }
    Ok(runs)
}

/// The noise in some runs.
fn noise_level(speed: f64, runs: &[Vec<BoardReading>]) -> Result<NoiseLevel, Trouble> {
    let samples: Vec<Vec<Inertial>> = runs
        .iter()
        .map(|run| run.iter().filter_map(|reading| reading.inertial).collect())
        .collect();
    NoiseLevel::of(speed, &samples).ok_or_else(|| {
        let count = samples.concat().len();
        let found = format!("{count} samples of the IMU at {speed:.2} m/s");
        let fix = "Look at the IMU's wires (SDA, SCL, 5 V, ground): docs/uno.md.";
        failed(found, fix)
    })
}

fn noise_finding(comparison: Comparison, kill: &Finding) -> Finding {
    let mut found = comparison.found;
    let mut fixes = Vec::new();
    if !comparison.too_small.is_empty() {
        let too_small = comparison.too_small.join(", ");
        found.push(format!(
            "too small: {too_small}; the measured values are in force"
        ));
        fixes.push(
            "The floor shakes more than a stand: compare `noise` of `singletrack judge` after the \
             first drive.",
        );
    }
    if kill.verdict == Verdict::Warning {
        found.push(kill.found.clone());
        fixes.push(&kill.fix);
    }
    let fix = fixes.join(" ");
    Finding::warning_if(!fixes.is_empty(), found.join("; "), &fix).with(comparison.parameters)
}

fn noise_plot(levels: &[NoiseLevel]) -> Plot {
    let line = |name, kind, density: fn(&NoiseLevel) -> f64| {
        let points = levels.iter().map(|level| [level.speed, density(level)]);
        PlotLine::new(name, kind, points.collect())
    };
    let forward = |level: &NoiseLevel| level.forward.density.value;
    let lines = vec![
        line("forward", PlotKind::Measured, forward),
        line("left", PlotKind::Other, |level| level.left.density.value),
    ];
    let title = "The accelerometer's noise with the wheels turning";
    let axes = [
        ("speed of the wheels", "m/s"),
        ("noise density", "m/s²/√Hz"),
    ];
    Plot::new("imu-noise", title, axes, lines)
}
