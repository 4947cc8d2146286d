//! Gathers readings for a time, or until a hand has finished a motion, and combines the checks of a
//! step into one finding.

use singletrack_control::{Time, wrap};
use singletrack_core::Config;
use singletrack_protocol::{BoardMode, Status, StopCause};

use crate::{
    Answer, Bench, Finding, Inertial, Interrupted, Parameter, PoseReading, Question, Refused,
    Trouble, Verdict, finding::keys, observed::Readings,
};

/// Angular velocity below which a gyro at rest stays, in rad/s: bias and noise.
const STILL_RAD_S: f64 = 0.08;
/// Movement of the body below which it stands, within [`STILL_S`], in m and in rad.
const STILL_M: f64 = 0.004;
const STILL_RAD: f64 = 0.02;
/// Time without movement after which a motion by hand has ended, in s.
const STILL_S: f64 = 0.8;
/// The longest time for a motion by hand, in s.
const PATIENCE_S: f64 = 90.0;

impl Readings {
    /// Time from the first tick to the last, in s.
    pub(super) fn duration(&self) -> f64 {
        ends(&self.ticks).map_or(0.0, |[first, last]| last.time.seconds_since(first.time))
    }

    /// Whether IMU and cameras have seen no movement for [`STILL_S`].
    fn is_still(&self) -> bool {
        let now = self.ticks.last().filter(|_| self.duration() >= STILL_S);
        let Some(now) = now.map(|tick| tick.time) else {
            return false;
        };
        let is_recent = |time: Time| now.seconds_since(time) < STILL_S;
        let newest_first = self.inertial().rev();
        let turns = newest_first
            .take_while(|inertial| is_recent(inertial.time))
            .any(|inertial| norm(inertial.angular_velocity) > STILL_RAD_S);
        let newest_first = self.poses.iter().rev();
        let mut recent = newest_first.take_while(|pose| is_recent(pose.capture));
        let moves = recent.next().is_some_and(|last| {
            recent.any(|pose| {
                distance(pose.position, last.position) > STILL_M
                    || wrap(pose.yaw - last.yaw).abs() > STILL_RAD
            })
        });
        !turns && !moves
    }

    /// Whether the board has mistaken wheels that a hand rolled for a running motor. It then stays
    /// stopped until its reset.
    pub(super) fn is_latched(&self) -> bool {
        self.boards.last().is_some_and(|board| {
            board.mode == BoardMode::EmergencyStopped
                && board.stop_cause == StopCause::RunsAtNeutral
        })
    }

    /// The board's newest condition.
    pub(super) fn status(&self) -> Option<Status> {
        self.health.last().map(|health| health.status)
    }

    /// The rise of one of the board's counters, which wrap.
    pub(super) fn risen(&self, counter: fn(&Status) -> u16) -> u16 {
        let counts = ends(&self.health).map(|ends| ends.map(|health| counter(&health.status)));
        counts.map_or(0, |[first, last]| last.wrapping_sub(first))
    }

    /// The distance of the body from where it was, in m.
    pub(super) fn moved(&self) -> f64 {
        let ends = ends(&self.poses);
        ends.map_or(0.0, |[first, last]| distance(first.position, last.position))
    }

    /// Yaw rates, each with the time in s at which the board read it.
    pub(super) fn gyro(&self) -> Vec<[f64; 2]> {
        let rate = |sample: Inertial| [self.at(sample.time), sample.angular_velocity[2]];
        self.inertial().map(rate).collect()
    }

    /// The longest time without a telemetry record that ended with one, in s. It may have begun
    /// before the first reading: a quick hand is faster than the terminal.
    pub(super) fn longest_silence(&self) -> f64 {
        let begin = self.ticks.first().map(|tick| tick.time);
        let heard = self.boards.iter().map(|board| board.receive);
        let heard: Vec<Time> = begin.into_iter().chain(heard).collect();
        let silences = heard.windows(2);
        silences
            .map(|pair| pair[1].seconds_since(pair[0]))
            .fold(0.0, f64::max)
    }
}

/// The request to press the reset button, right after the answer.
pub(super) const PRESS_RESET: &str = "Press Enter, then press the reset button of the board once.";

/// The angle turned by the body so far, in rad.
pub(super) fn turned(poses: &[PoseReading]) -> f64 {
    let steps = poses.windows(2);
    steps.map(|pair| wrap(pair[1].yaw - pair[0].yaw)).sum()
}

/// The first and the last.
pub(super) fn ends<T>(readings: &[T]) -> Option<[&T; 2]> {
    Some([readings.first()?, readings.last()?])
}

pub(super) fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// Distance on the floor, in m.
pub(super) fn distance(from: [f64; 3], to: [f64; 3]) -> f64 {
    (to[0] - from[0]).hypot(to[1] - from[1])
}

/// A step of the doctor: gathers readings, and keeps what its checks find.
pub(super) struct Checks<'a> {
    pub(super) bench: &'a mut dyn Bench,
    /// The verdict of each check, and what was found, was expected and is to be done.
    made: Vec<(Verdict, [String; 3])>,
    parameters: Vec<Parameter>,
}

impl<'a> Checks<'a> {
    pub(super) fn begin(bench: &'a mut dyn Bench) -> Self {
        Self {
            bench,
            made: Vec::new(),
            parameters: Vec::new(),
        }
    }

    /// The configuration in force.
    pub(super) fn config(&self) -> &Config {
        self.bench.configuration()
    }

    /// Gathers readings for a time.
    pub(super) fn for_time(&mut self, for_s: f64, what: &str) -> Result<Readings, Interrupted> {
        let (readings, _) = self.until(|readings| {
            let done = readings.duration() / for_s;
            (format!("{what}: {:.0} s", readings.duration()), done)
        })?;
        Ok(readings)
    }

    /// Gathers readings until `progress`, which also gives a text to show, reaches 1. The flag is
    /// false if that took longer than [`PATIENCE_S`].
    pub(super) fn until(
        &mut self,
        mut progress: impl FnMut(&Readings) -> (String, f64),
    ) -> Result<(Readings, bool), Interrupted> {
        let mut readings = Readings::default();
        let mut observed = Vec::new();
        loop {
            self.bench.wait(&mut observed)?;
            readings.take(&mut observed);
            let (text, done) = progress(&readings);
            self.bench.show(&text, done);
            if done >= 1.0 || readings.duration() > PATIENCE_S {
                return Ok((readings, done >= 1.0));
            }
        }
    }

    /// Gathers readings while a hand moves the car: until `progress` has reached 1 and the car
    /// stands again. The flag is as in [`Self::until`].
    pub(super) fn motion(
        &mut self,
        progress: impl Fn(&Readings) -> (String, f64),
    ) -> Result<(Readings, bool), Interrupted> {
        let mut reached = false;
        self.until(|readings| {
            let (text, done) = progress(readings);
            reached |= done >= 1.0;
            match reached && readings.is_still() {
                true => (text, 1.0),
                false => (text, done.min(0.99)),
            }
        })
    }

    /// Asks the operator to reset a board that is latched. Returns whether it is free now.
    pub(super) fn reset_if_stopped(&mut self) -> Result<bool, Interrupted> {
        /// The board holds neutral for two seconds after a reset, and is configured again.
        const SETTLED_S: f64 = 3.0;
        let mode = |readings: &Readings| readings.boards.last().map(|board| board.mode);
        let readings = self.for_time(0.3, "board")?;
        if mode(&readings) != Some(BoardMode::EmergencyStopped) {
            return Ok(true);
        }
        let request = Question::begin("press-reset", PRESS_RESET);
        if self.bench.ask(&request)? == Answer::Skip {
            return Ok(false);
        }
        // Nothing but a reset ends an emergency stop; the silence of the reset itself may have begun
        // before the first reading.
        let (_, is_reset) = self.until(|readings| {
            let mode = mode(readings);
            let is_reset = mode.is_some_and(|mode| mode != BoardMode::EmergencyStopped);
            ("reset".to_owned(), f64::from(u8::from(is_reset)))
        })?;
        self.for_time(SETTLED_S, "the board starts")?;
        Ok(is_reset)
    }

    /// Asks for an action that the operator begins right after the answer. Returns whether it was
    /// skipped.
    pub(super) fn skips(
        &mut self,
        what: &str,
        id: &'static str,
        request: &'static str,
    ) -> Result<bool, Interrupted> {
        let is_skipped = self.bench.ask(&Question::begin(id, request))? == Answer::Skip;
        if is_skipped {
            self.skipped(what);
        }
        Ok(is_skipped)
    }

    /// Asks for an action without which the step ends.
    pub(super) fn needs(
        &mut self,
        what: &str,
        id: &'static str,
        request: &'static str,
    ) -> Result<(), Trouble> {
        match self.skips(what, id, request)? {
            true => Err(self.ends()),
            false => Ok(()),
        }
    }

    /// Puts values in force. A stopped board accepts no configuration: it is reset first.
    pub(super) fn put_in_force(
        &mut self,
        values: &[(&str, toml_edit::Value)],
    ) -> Result<Result<(), Refused>, Interrupted> {
        if !self.reset_if_stopped()? {
            let reason = "the board is stopped: it accepts no configuration before its reset";
            return Ok(Err(Refused(reason.to_owned())));
        }
        Ok(self.bench.change(values))
    }

    /// A check that passed.
    pub(super) fn good(&mut self, found: impl Into<String>, expected: impl Into<String>) {
        self.add(Verdict::Good, found, expected, "");
    }

    /// A check that the operator skipped.
    pub(super) fn skipped(&mut self, what: &str) {
        self.add(Verdict::Skipped, format!("{what}: skipped"), "", "");
    }

    /// A check that passed or failed.
    pub(super) fn check(
        &mut self,
        is_good: bool,
        found: impl Into<String>,
        expected: impl Into<String>,
        fix: impl Into<String>,
    ) {
        self.add(Verdict::Failed.unless(is_good), found, expected, fix);
    }

    /// A failed check that ends the step.
    pub(super) fn fail(
        &mut self,
        found: impl Into<String>,
        expected: impl Into<String>,
        fix: impl Into<String>,
    ) -> Trouble {
        self.add(Verdict::Failed, found, expected, fix);
        self.ends()
    }

    /// The board has latched, because it mistook wheels that a hand rolled for a running motor.
    pub(super) fn latched(&mut self) {
        let found = "the board stopped: it mistook the rolled wheels for a running motor";
        let expected = "at most 1 m or 3 s of rolling without a pause";
        let fix = "press the reset button of the board";
        self.add(Verdict::Warning, found, expected, fix);
    }

    pub(super) fn measured(&mut self, parameter: Parameter) {
        self.parameters.push(parameter);
    }

    pub(super) fn has_failed(&self) -> bool {
        self.verdict() == Verdict::Failed
    }

    /// The worst verdict. A partly checked step does not count as skipped.
    fn verdict(&self) -> Verdict {
        let verdicts = self.made.iter().map(|(verdict, _)| *verdict);
        match verdicts.clone().max() {
            Some(Verdict::Skipped) => verdicts.min(),
            worst => worst,
        }
        .unwrap_or(Verdict::Skipped)
    }

    /// A check with this verdict. There is nothing to fix if it passed, or if the doctor has
    /// corrected what it found.
    pub(super) fn add(
        &mut self,
        verdict: Verdict,
        found: impl Into<String>,
        expected: impl Into<String>,
        fix: impl Into<String>,
    ) {
        let fix = match verdict {
            Verdict::Good => String::new(),
            _ => fix.into(),
        };
        self.made
            .push((verdict, [found.into(), expected.into(), fix]));
    }

    /// The early end of the step.
    pub(super) fn ends(&mut self) -> Trouble {
        match self.finding() {
            Ok(finding) => Trouble::Found(finding.into()),
            Err(trouble) => trouble,
        }
    }

    /// The finding of a step. Values that were measured are put into the configuration, unless
    /// the step failed.
    ///
    /// # Errors
    ///
    /// The operator interrupts, or the daemon is gone.
    pub(super) fn finding(&mut self) -> Result<Finding, Trouble> {
        let mut parameters = std::mem::take(&mut self.parameters);
        let values = keys(&parameters);
        if !values.is_empty()
            && !self.has_failed()
            && let Err(refused) = self.put_in_force(&values)?
        {
            let found = format!("the measured values are not in force: {refused}");
            let fix = "correct the value that the daemon refuses, and run this step again";
            self.add(Verdict::Failed, found, "in force", fix);
        }
        if self.has_failed() {
            // A value that is not in force must not count as written.
            for parameter in &mut parameters {
                parameter.key = None;
            }
        }
        let [found, expected, fix] = [0, 1, 2].map(|which| {
            let texts = self.made.iter().map(|(_, texts)| &*texts[which]);
            let texts: Vec<&str> = texts.filter(|text| !text.is_empty()).collect();
            texts.join("; ")
        });
        Ok(Finding {
            expected,
            parameters,
            ..Finding::new(self.verdict(), found, fix)
        })
    }
}
