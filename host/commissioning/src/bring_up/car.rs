//! The car on its stand: armed jogs, and the watch over it.

use singletrack_control::Time;
use singletrack_protocol::{BoardMode, Status, StopCause};

use crate::{
    Answer, Attendance, Bench, BoardReading, Finding, Interrupted, Jog, Live, Observation,
    Parameter, PoseReading, Question, Refused, Verdict,
};

/// Way by which a car on its stand may shake, m, in several poses and in one.
const SHAKES_M: f64 = 0.02;
const JUMPS_M: f64 = 0.06;

/// Turn by which it may shake, rad.
const SHAKES_RAD: f64 = 0.1;

/// Poses in a row beyond the limits that are a car that moves.
const MOVING_POSES: u32 = 3;

/// For how long the cameras may lose a car whose wheels turn, s.
const UNSEEN_S: f64 = 0.5;

/// Poses from which the place of the stand is known.
const PLACE_POSES: u32 = 10;

/// Renewal of the jog, s; the hold ends after 0.25 s.
const RENEWAL_S: f64 = 0.04;

/// Time for arming, with a kill output that first starts the ESC, s.
const ARMING_S: f64 = 12.0;

/// Time without telemetry after which the line is lost, s.
const SILENT_S: f64 = 0.3;

/// Waits without any news after which there is no time to go by.
const SILENT_WAITS: u32 = 3_000;

/// Jogs that are begun again after they were let go.
const ATTEMPTS: u32 = 3;

/// Why a step does not come to its end.
#[derive(Debug)]
pub(super) enum Trouble {
    /// The procedure ends.
    Interrupted(Interrupted),
    /// The step fails.
    Failed {
        /// What was found.
        found: String,
        /// What to do.
        fix: String,
    },
    /// The operator skipped a question without which the step makes no sense.
    Skipped,
    /// The jog ended by itself.
    Ended {
        /// The board's word.
        cause: StopCause,
        /// The whole reason.
        why: String,
    },
}

impl From<Interrupted> for Trouble {
    fn from(interrupted: Interrupted) -> Self {
        Self::Interrupted(interrupted)
    }
}

pub(super) fn failed(found: impl Into<String>, fix: impl Into<String>) -> Trouble {
    Trouble::Failed {
        found: found.into(),
        fix: fix.into(),
    }
}

/// What a step comes to, if it comes to its end.
#[derive(Debug)]
pub(super) struct Outcome {
    pub(super) verdict: Verdict,
    pub(super) found: String,
    pub(super) fix: String,
    pub(super) parameters: Vec<Parameter>,
}

impl Outcome {
    pub(super) fn good(found: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Good,
            found: found.into(),
            fix: String::new(),
            parameters: Vec::new(),
        }
    }

    pub(super) fn warning(found: impl Into<String>, fix: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Warning,
            fix: fix.into(),
            ..Self::good(found)
        }
    }

    pub(super) fn with(mut self, parameters: Vec<Parameter>) -> Self {
        self.parameters = parameters;
        self
    }
}

/// Makes a finding of what a step came to, and leaves a car that is disarmed.
pub(super) fn conclude(
    bench: &mut dyn Bench,
    step: &'static str,
    expected: &str,
    outcome: Result<Outcome, Trouble>,
) -> Result<Finding, Interrupted> {
    let outcome = match outcome {
        Ok(outcome) => outcome,
        Err(trouble) => {
            // Refused where there is nothing to disarm.
            let _ = bench.disarm();
            let (verdict, found, fix) = match trouble {
                Trouble::Interrupted(interrupted) => return Err(interrupted),
                Trouble::Failed { found, fix } => (Verdict::Failed, found, fix),
                Trouble::Skipped => (Verdict::Skipped, "skipped".into(), String::new()),
                Trouble::Ended { why, .. } => (
                    Verdict::Failed,
                    format!("the jog ended: {why}"),
                    "See docs/reasons.md for the word, and run the bring-up again.".into(),
                ),
            };
            Outcome {
                verdict,
                found,
                fix,
                parameters: Vec::new(),
            }
        }
    };
    Ok(Finding {
        step,
        verdict: outcome.verdict,
        found: outcome.found,
        expected: expected.into(),
        fix: outcome.fix,
        parameters: outcome.parameters,
    })
}

/// Puts values in force.
pub(super) fn change(
    bench: &mut dyn Bench,
    values: &[(&str, toml_edit::Value)],
) -> Result<(), Trouble> {
    bench.change(values).map_err(|Refused(why)| {
        let keys: Vec<_> = values.iter().map(|(key, _)| *key).collect();
        failed(
            format!("{} can't be changed: {why}", keys.join(", ")),
            "Correct the configuration file as the message says, and run the bring-up again.",
        )
    })
}

/// Asks a question to which there must be an answer.
pub(super) fn ask(bench: &mut dyn Bench, question: &Question) -> Result<Answer, Trouble> {
    match bench.ask(question)? {
        Answer::Skip => Err(Trouble::Skipped),
        answer => Ok(answer),
    }
}

/// Asks for yes or no.
pub(super) fn ask_yes(bench: &mut dyn Bench, question: &Question) -> Result<bool, Trouble> {
    Ok(ask(bench, question)? == Answer::YesNo(true))
}

/// Asks for one of several words.
pub(super) fn ask_word<'a>(
    bench: &mut dyn Bench,
    question: &Question,
    words: &[&'a str],
) -> Result<&'a str, Trouble> {
    match ask(bench, question)? {
        Answer::Choice(index) => words.get(index).copied().ok_or(Trouble::Skipped),
        _ => Err(Trouble::Skipped),
    }
}

/// Asks for a number.
pub(super) fn ask_number(bench: &mut dyn Bench, question: &Question) -> Result<f64, Trouble> {
    match ask(bench, question)? {
        Answer::Number(number) => Ok(number),
        _ => Err(Trouble::Skipped),
    }
}

/// Where the car stands by the cameras.
#[derive(Debug, Default)]
struct Stand {
    poses: u32,
    sum: [f64; 3],
    yaw: f64,
    off: u32,
    /// How far it has moved, m, when it has left its place.
    left: Option<f64>,
    seen: Option<Time>,
}

impl Stand {
    fn see(&mut self, pose: &PoseReading) {
        self.seen = Some(pose.receive);
        if self.poses < PLACE_POSES {
            if self.poses == 0 {
                self.yaw = pose.yaw;
            }
            self.poses += 1;
            for (sum, value) in self.sum.iter_mut().zip(pose.position) {
                *sum += value;
            }
            return;
        }
        let poses = f64::from(self.poses);
        let squares: f64 = self
            .sum
            .iter()
            .zip(pose.position)
            .map(|(sum, value)| (value - sum / poses).powi(2))
            .sum();
        let way = squares.sqrt();
        let turn = (pose.yaw - self.yaw).sin().abs();
        self.off = if way > SHAKES_M || turn > SHAKES_RAD {
            self.off + 1
        } else {
            0
        };
        if self.off >= MOVING_POSES || way > JUMPS_M {
            self.left = Some(way);
        }
    }

    fn is_known(&self) -> bool {
        self.poses >= PLACE_POSES
    }
}

/// The car on its stand.
///
/// Every tick looks whether it stays there. A car that moves is stopped by an emergency
/// stop at once: it would drive off.
pub(super) struct Car<'a> {
    bench: &'a mut dyn Bench,
    observed: Vec<Observation>,
    readings: Vec<BoardReading>,
    stand: Stand,
    now: Option<Time>,
    silent_waits: u32,
    renewed: Option<(Time, Jog)>,
    /// The newest telemetry.
    pub(super) board: Option<BoardReading>,
    /// The newest record of the board's condition.
    pub(super) status: Option<Status>,
    /// Whether the line to the board is ready, as far as is known.
    pub(super) linked: bool,
}

impl<'a> Car<'a> {
    /// Looks at the car until its place and the board's telemetry are known.
    pub(super) fn look(bench: &'a mut dyn Bench) -> Result<Self, Trouble> {
        let mut car = Self {
            bench,
            observed: Vec::new(),
            readings: Vec::new(),
            stand: Stand::default(),
            now: None,
            silent_waits: 0,
            renewed: None,
            board: None,
            status: None,
            linked: true,
        };
        car.tick()?;
        let until = car.now()?.after(10.0);
        while car.board.is_none() || !car.stand.is_known() {
            if car.now()? >= until {
                return Err(if car.board.is_none() {
                    failed(
                        "the board sends no telemetry",
                        "Check the serial line with `singletrack doctor`.",
                    )
                } else {
                    failed(
                        "the cameras do not see the car: nothing would notice that it leaves its \
                         stand",
                        "Put the stand where the cameras see the car's markers.",
                    )
                });
            }
            car.tick()?;
        }
        Ok(car)
    }

    /// The time of the last tick.
    pub(super) fn now(&self) -> Result<Time, Trouble> {
        self.now.ok_or_else(no_news)
    }

    /// Lets a tick pass; gives the telemetry that came in it.
    pub(super) fn tick(&mut self) -> Result<&[BoardReading], Trouble> {
        self.observed.clear();
        self.readings.clear();
        let before = self.now;
        self.bench.wait(&mut self.observed)?;
        for observation in &self.observed {
            let at = match observation {
                Observation::Board(reading) => {
                    self.readings.push(*reading);
                    self.board = Some(*reading);
                    self.linked = true;
                    reading.receive
                }
                Observation::Health(health) => {
                    self.status = Some(health.status);
                    health.receive
                }
                Observation::Pose(pose) => {
                    self.stand.see(pose);
                    pose.receive
                }
                Observation::NoPose { receive, .. } => *receive,
                Observation::Tick(tick) => tick.time,
                Observation::Link(ready) => {
                    self.linked = *ready;
                    continue;
                }
            };
            self.now = self.now.max(Some(at));
        }
        self.silent_waits = if self.now > before {
            0
        } else {
            self.silent_waits + 1
        };
        if self.silent_waits > SILENT_WAITS {
            return Err(no_news());
        }
        Ok(&self.readings)
    }

    /// Watches for a time without a request; gives the telemetry.
    pub(super) fn watch(&mut self, seconds: f64, what: &str) -> Result<Vec<BoardReading>, Trouble> {
        if self.now.is_none() {
            self.tick()?;
        }
        let begin = self.now()?;
        let mut all = Vec::new();
        loop {
            let done = self.now()?.seconds_since(begin) / seconds;
            if done >= 1.0 {
                return Ok(all);
            }
            self.tick()?;
            all.extend_from_slice(&self.readings);
            self.show(what, done);
        }
    }

    /// Shows the present values.
    pub(super) fn show(&mut self, what: &str, done: f64) {
        let text = match &self.board {
            Some(board) => format!(
                "{what}: servo {} us, ESC {} us, motor {:.2} m/s",
                board.servo_us, board.esc_us, board.motor_speed
            ),
            None => what.into(),
        };
        self.bench.show(&Live { text: &text, done });
    }

    /// The pulses at rest: the servo as it stands, the ESC at its configured neutral.
    pub(super) fn rest(&self) -> Jog {
        let board = &self.bench.configuration().board;
        let servo_us = match self.board {
            Some(reading) if reading.servo_us != 0 => reading.servo_us,
            _ => board.servo.centre_us,
        };
        Jog {
            servo_us,
            esc_us: board.esc.neutral_us,
        }
    }

    /// Arms, and waits until the board takes jogs.
    pub(super) fn arm(&mut self) -> Result<(), Trouble> {
        let until = self.now()?.after(ARMING_S);
        loop {
            match self.bench.arm(Attendance::Jog) {
                Ok(()) => break,
                Err(Refused(why)) if self.now()? >= until => {
                    return Err(failed(
                        format!("the car can't be armed: {why}"),
                        "See docs/reasons.md for the word.",
                    ));
                }
                Err(_) => {
                    self.watch(0.2, "arming")?;
                }
            }
        }
        self.renewed = None;
        // The hand took its time.
        self.tick()?;
        let until = self.now()?.after(ARMING_S);
        let rest = self.rest();
        while !self.jogs() {
            if self.now()? >= until {
                return Err(failed(
                    "the board does not take the jog after it was armed",
                    "See the log of the daemon.",
                ));
            }
            // The daemon takes none until the board is armed.
            let _ = self.bench.jog(rest);
            self.tick()?;
            self.show("arming", 0.0);
        }
        Ok(())
    }

    /// Whether the board is in an armed jog.
    pub(super) fn jogs(&self) -> bool {
        self.board
            .is_some_and(|reading| reading.mode == BoardMode::Jogging)
    }

    /// Holds these pulses for a time; gives the telemetry.
    pub(super) fn hold(
        &mut self,
        jog: Jog,
        seconds: f64,
        what: &str,
    ) -> Result<Vec<BoardReading>, Trouble> {
        self.hold_until(jog, seconds, what, |_| false)
    }

    /// As [`Self::hold`], and ends when `ends` says so of a tick's telemetry.
    pub(super) fn hold_until(
        &mut self,
        jog: Jog,
        seconds: f64,
        what: &str,
        mut ends: impl FnMut(&BoardReading) -> bool,
    ) -> Result<Vec<BoardReading>, Trouble> {
        let begin = self.now()?;
        let mut all = Vec::new();
        loop {
            let now = self.now()?;
            let done = now.seconds_since(begin) / seconds;
            if done >= 1.0 {
                return Ok(all);
            }
            self.renew(jog, now)?;
            self.tick()?;
            if !self.jogs() {
                return Err(self.ended(None));
            }
            if self.is_silent_for(SILENT_S)? {
                return Err(self.ended(Some("the board sends nothing".into())));
            }
            let turns = jog.esc_us != self.rest().esc_us;
            self.check_stand(turns)?;
            self.show(what, done);
            all.extend_from_slice(&self.readings);
            if self.readings.iter().any(&mut ends) {
                return Ok(all);
            }
        }
    }

    fn renew(&mut self, jog: Jog, now: Time) -> Result<(), Trouble> {
        let is_recent =
            |(at, last): &(Time, Jog)| *last == jog && now.seconds_since(*at) < RENEWAL_S;
        if self.renewed.as_ref().is_some_and(is_recent) {
            return Ok(());
        }
        if let Err(Refused(why)) = self.bench.jog(jog) {
            // What the board says comes a moment later.
            for _ in 0..5 {
                self.tick()?;
            }
            return Err(self.ended(Some(why)));
        }
        self.renewed = Some((now, jog));
        Ok(())
    }

    fn ended(&self, refused: Option<String>) -> Trouble {
        let cause = self.board.map_or(StopCause::None, |board| board.stop_cause);
        Trouble::Ended {
            cause,
            why: refused.unwrap_or_else(|| cause.name().into()),
        }
    }

    /// Stops a car that leaves its stand.
    pub(super) fn check_stand(&mut self, turns: bool) -> Result<(), Trouble> {
        if let Some(way) = self.stand.left {
            let _ = self.bench.emergency_stop();
            return Err(failed(
                format!(
                    "the cameras saw the car move by {:.0} mm: emergency stop",
                    way * 1e3
                ),
                "Put the car on its stand so that nothing can move it, press the reset of the \
                 board, and run the bring-up again.",
            ));
        }
        let unseen = match (self.stand.seen, self.now) {
            (Some(seen), Some(now)) => now.seconds_since(seen),
            _ => f64::INFINITY,
        };
        if turns && unseen > UNSEEN_S {
            let _ = self.bench.disarm();
            return Err(failed(
                "the cameras lost the car while its wheels turned",
                "Put the stand where the cameras see the car's markers.",
            ));
        }
        Ok(())
    }

    /// Ends the jog at neutral, and waits until the wheels stand.
    pub(super) fn end(&mut self) -> Result<(), Trouble> {
        let rest = self.rest();
        if self.jogs() {
            self.hold(rest, 0.1, "neutral")?;
            self.disarm()?;
        }
        self.until_standing(8.0)
    }

    /// Asks for the end of the jog, and waits for it.
    pub(super) fn disarm(&mut self) -> Result<(), Trouble> {
        self.request_disarm()?;
        let until = self.now()?.after(3.0);
        while self.jogs() {
            if self.now()? >= until {
                return Err(failed(
                    "the board is still armed 3 s after the disarm request",
                    "Cut the supply of the ESC. See the log of the daemon.",
                ));
            }
            self.tick()?;
        }
        Ok(())
    }

    /// Requests the end of the jog.
    pub(super) fn request_disarm(&mut self) -> Result<(), Trouble> {
        self.bench.disarm().map_err(|Refused(why)| {
            failed(
                format!("the disarm request was refused: {why}"),
                "Cut the supply of the ESC.",
            )
        })
    }

    /// Requests an emergency stop.
    pub(super) fn request_emergency_stop(&mut self) -> Result<(), Trouble> {
        self.bench.emergency_stop().map_err(|Refused(why)| {
            failed(
                format!("the emergency stop was refused: {why}"),
                "Cut the supply of the ESC.",
            )
        })
    }

    /// Whether the board has sent nothing for this long.
    pub(super) fn is_silent_for(&self, seconds: f64) -> Result<bool, Trouble> {
        let now = self.now()?;
        let heard = self.board.map_or(now, |board| board.receive);
        Ok(!self.linked || now.seconds_since(heard) >= seconds)
    }

    /// Waits until the board sends telemetry again, 15 s at most.
    pub(super) fn wait_for_board(bench: &mut dyn Bench) -> Result<(), Trouble> {
        let lost = || {
            failed(
                "the board does not come back",
                "Check the serial line with `singletrack doctor`.",
            )
        };
        let mut first = None;
        let mut observed = Vec::new();
        for _ in 0..SILENT_WAITS {
            observed.clear();
            bench.wait(&mut observed)?;
            for observation in &observed {
                match observation {
                    Observation::Board(_) => return Ok(()),
                    Observation::Tick(tick) => {
                        let first = *first.get_or_insert(tick.time);
                        if tick.time.seconds_since(first) > 15.0 {
                            return Err(lost());
                        }
                    }
                    _ => {}
                }
            }
        }
        Err(lost())
    }

    /// Waits until the motor's pulses have ceased.
    fn until_standing(&mut self, seconds: f64) -> Result<(), Trouble> {
        let until = self.now()?.after(seconds);
        while self.board.is_some_and(|board| board.motor_speed != 0.0) {
            if self.now()? >= until {
                return Err(failed(
                    format!("the motor still turns {seconds} s after its pulse went to neutral"),
                    "Cut the supply of the ESC. Its neutral is another than \
                     board.esc.neutral_us, or it is stuck.",
                ));
            }
            self.tick()?;
        }
        Ok(())
    }

    /// Turns the motor forward at about 0.5 m/s of its wheels, beginning `from_us` beyond
    /// neutral; gives the pulse, or nothing if it does not turn.
    ///
    /// Until the first pulses come the ESC is driven in bursts: the board takes a motor
    /// that is driven for 0.6 s without a pulse for a dead sensor.
    pub(super) fn spin(&mut self, from_us: u16) -> Result<Option<Jog>, Trouble> {
        self.spin_at(0.4, from_us)
    }

    /// As [`Self::spin`], at this speed at least if 150 us reach it.
    pub(super) fn spin_at(&mut self, wanted: f64, from_us: u16) -> Result<Option<Jog>, Trouble> {
        let Some(mut jog) = self.first_turn(true, from_us)? else {
            return Ok(None);
        };
        let highest = jog.esc_us.max(self.rest().esc_us + JOG_LIMIT_US);
        let begin = self.now()?;
        let mut before = 0.0;
        loop {
            let readings = self.hold(jog, 0.4, "spinning up")?;
            let speed = mean_speed(&readings[readings.len() / 2..]);
            let late = self.now()?.seconds_since(begin) > 5.0;
            if speed >= wanted || late || jog.esc_us >= highest {
                return Ok(Some(jog));
            }
            // Steps of 0.15 m/s at most, as far as the last one tells.
            let step_us = if speed - before > 0.15 { 3 } else { 8 };
            before = speed;
            jog.esc_us = (jog.esc_us + step_us).min(highest);
        }
    }

    /// Turns the motor while a hand is about to stop it, which may come as soon as the wheels
    /// turn, and watches until the jog ends, the wheels stand, or the time is over.
    pub(super) fn spin_for_hand(
        &mut self,
        from_us: u16,
        seconds: f64,
        what: &str,
    ) -> Result<Spun, Trouble> {
        let mut jog = self
            .first_turn(true, from_us)?
            .ok_or_else(|| super::kill::never_turned(JOG_LIMIT_US))?;
        let highest = self.rest().esc_us + JOG_LIMIT_US;
        let begin = self.now()?;
        let mut spun = Spun::default();
        while self.now()?.seconds_since(begin) < seconds {
            let held = self.hold_until(jog, 0.1, what, |reading| reading.motor_speed == 0.0);
            match held {
                Ok(readings) => spun.readings.extend(readings),
                Err(Trouble::Ended { cause, .. }) => {
                    spun.ended = Some(cause);
                    break;
                }
                Err(trouble) => return Err(trouble),
            }
            let Some(last) = spun.readings.last().map(|last| last.motor_speed.abs()) else {
                continue;
            };
            if last == 0.0 {
                break;
            }
            // Not while it slows down: that is the hand.
            if last < 0.4 && last >= 0.9 * spun.fastest() {
                jog.esc_us = (jog.esc_us + 4).min(highest);
            }
        }
        Ok(spun)
    }

    /// Drives in bursts of 0.5 s, each 8 us farther from neutral, until the wheels turn;
    /// gives the pulse that does, which is still held.
    pub(super) fn first_turn(
        &mut self,
        forward: bool,
        from_us: u16,
    ) -> Result<Option<Jog>, Trouble> {
        let rest = self.rest();
        let mut offset_us = from_us.min(JOG_LIMIT_US);
        loop {
            // The board forgets the burst before after 0.6 s, and a car's ESC takes a second
            // pulse below neutral for reverse.
            self.hold_until_standing(rest, 0.7)?;
            let jog = Jog {
                esc_us: beyond(rest.esc_us, offset_us, forward),
                ..rest
            };
            let readings = self.hold_until(jog, 0.5, "looking for the first turn", |reading| {
                reading.motor_speed != 0.0
            })?;
            if readings.iter().any(|reading| reading.motor_speed != 0.0) {
                return Ok(Some(jog));
            }
            if offset_us >= JOG_LIMIT_US {
                self.hold(rest, 0.1, "neutral")?;
                return Ok(None);
            }
            offset_us = (offset_us + 8).min(JOG_LIMIT_US);
        }
    }

    /// Holds these pulses for a time at least, and until the wheels stand, 8 s at most.
    pub(super) fn hold_until_standing(&mut self, jog: Jog, seconds: f64) -> Result<(), Trouble> {
        self.hold(jog, seconds, "neutral")?;
        if self.board.is_some_and(|board| board.motor_speed != 0.0) {
            self.hold_until(jog, 8.0, "rolling out", |reading| {
                reading.motor_speed == 0.0
            })?;
            // The speed is zero half a second after the last pulse. The board takes longer to
            // believe that the wheels stand where the pulses are far apart.
            self.hold(jog, 0.3, "neutral")?;
        }
        Ok(())
    }

    /// What the bench believes.
    pub(super) fn bench(&mut self) -> &mut dyn Bench {
        self.bench
    }
}

/// A motor that was turned until a hand stopped it.
#[derive(Debug, Default)]
pub(super) struct Spun {
    /// The telemetry until then.
    pub(super) readings: Vec<BoardReading>,
    /// The board's word, if the jog ended.
    pub(super) ended: Option<StopCause>,
}

impl Spun {
    /// Highest speed, m/s.
    pub(super) fn fastest(&self) -> f64 {
        let speeds = self
            .readings
            .iter()
            .map(|reading| reading.motor_speed.abs());
        speeds.fold(0.0, f64::max)
    }

    /// Speed before the end, m/s.
    pub(super) fn last_speed(&self) -> f64 {
        let from = self.readings.len().saturating_sub(20);
        mean_speed(&self.readings[from..])
    }

    /// Whether the wheels came to rest while their pulse still drove them.
    pub(super) fn stopped_under_drive(&self) -> bool {
        let stands = self
            .readings
            .last()
            .is_some_and(|reading| reading.motor_speed == 0.0);
        // The board takes a motor that does not turn for one without a sensor.
        stands
            || self
                .ended
                .is_some_and(|cause| cause == StopCause::MotorSensor)
    }
}

/// Speed below which wheels that slow down count as standing, m/s.
pub(super) const CREEPS: f64 = 0.12;

/// The farthest from neutral that the board lets an ESC be jogged, us.
pub(super) const JOG_LIMIT_US: u16 = 150;

/// The pulse so far beyond neutral.
pub(super) fn beyond(neutral_us: u16, offset_us: u16, forward: bool) -> u16 {
    if forward {
        neutral_us + offset_us
    } else {
        neutral_us.saturating_sub(offset_us)
    }
}

/// Mean magnitude of the speed; zero without telemetry.
pub(super) fn mean_speed(readings: &[BoardReading]) -> f64 {
    let sum: f64 = readings
        .iter()
        .map(|reading| reading.motor_speed.abs())
        .sum();
    sum / readings.len().max(1) as f64
}

/// The way of wheels that slow down, m. The board takes half a second to report that they
/// stand: what is slower than [`CREEPS`] does not count.
pub(super) fn way(readings: &[BoardReading]) -> f64 {
    readings
        .windows(2)
        .take_while(|pair| pair[1].motor_speed.abs() > CREEPS)
        .map(|pair| {
            let elapsed = pair[1].receive.seconds_since(pair[0].receive);
            pair[1].motor_speed.abs() * elapsed
        })
        .sum()
}

/// Runs an armed jog, and again if it was let go.
pub(super) fn armed<T>(
    bench: &mut dyn Bench,
    mut jog: impl FnMut(&mut Car<'_>) -> Result<T, Trouble>,
) -> Result<T, Trouble> {
    let mut attempt = 1;
    loop {
        let mut car = Car::look(bench)?;
        let result = car.arm().and_then(|()| jog(&mut car));
        let result = result.and_then(|value| car.end().map(|()| value));
        match result {
            Err(Trouble::Ended {
                cause: StopCause::CommandTimeout | StopCause::JogTimeout | StopCause::Disarmed,
                ..
            }) if attempt < ATTEMPTS => attempt += 1,
            result => return result,
        }
    }
}

fn no_news() -> Trouble {
    failed(
        "the daemon sends nothing",
        "Check that singletrackd runs: `singletrack status`.",
    )
}
