//! The car on its stand: armed jogs, and the watch over it, which ends a step when the car leaves
//! its place.

use nalgebra::Vector3;
use singletrack_control::Time;
use singletrack_protocol::{BoardMode, Status, StopCause};

use crate::{
    Attendance, Bench, BoardReading, Jog, Observation, PoseReading, Refused, Trouble,
    finding::{failed, require},
};

/// The longest time for which the cameras may lose a car whose wheels turn, s.
const UNSEEN_S: f64 = 0.5;

/// Renewal of the jog, s; the hold ends after 0.25 s.
const RENEWAL_S: f64 = 0.04;

/// Time for arming, with a kill output that first starts the ESC, s.
const ARMING_S: f64 = 12.0;

/// Time without telemetry after which the line is lost, s.
const SILENT_S: f64 = 0.3;

/// Waits without an observation after which the daemon counts as silent: without ticks there is
/// no clock.
const SILENT_WAITS: u32 = 3_000;

const IN_VIEW: &str = "Put the stand where the cameras see the car's markers.";
pub(super) const CHECK_LINE: &str = "Check the serial line with `singletrack doctor`.";

/// Attempts at a jog that the operator lets go.
const ATTEMPTS: u32 = 3;

/// The car on its stand.
///
/// Every tick checks that it stays there. A car that moves may drive off: it gets an emergency
/// stop at once.
pub(super) struct Car<'a> {
    bench: &'a mut dyn Bench,
    observed: Vec<Observation>,
    readings: Vec<BoardReading>,
    place: Place,
    /// The time of the last tick.
    pub(super) now: Time,
    silent_waits: u32,
    renewed: Option<(Time, Jog)>,
    /// The newest telemetry.
    pub(super) board: Option<BoardReading>,
    /// The board's newest condition.
    pub(super) status: Option<Status>,
    /// Whether the line to the board is ready.
    linked: bool,
}

impl<'a> Car<'a> {
    /// Lets ticks pass until the time is known.
    fn begin(bench: &'a mut dyn Bench) -> Result<Self, Trouble> {
        let mut car = Self {
            bench,
            observed: Vec::new(),
            readings: Vec::new(),
            place: Place::default(),
            now: Time(0),
            silent_waits: 0,
            renewed: None,
            board: None,
            status: None,
            linked: true,
        };
        while car.now == Time(0) {
            car.tick()?;
        }
        Ok(car)
    }

    /// Waits until the place of the car and the board's telemetry are known.
    pub(super) fn look(bench: &'a mut dyn Bench) -> Result<Self, Trouble> {
        let mut car = Self::begin(bench)?;
        let is_unknown = |car: &Self| car.board.is_none() || car.place.poses < PLACE_POSES;
        car.wait_while(10.0, is_unknown, |car| match car.board {
            None => failed("the board sends no telemetry", CHECK_LINE),
            Some(_) => failed(
                "the cameras do not see the car: nothing would notice that it leaves its stand",
                IN_VIEW,
            ),
        })?;
        Ok(car)
    }

    /// Waits until the board sends telemetry again, 15 s at most.
    pub(super) fn wait_for_board(bench: &'a mut dyn Bench) -> Result<(), Trouble> {
        let is_silent = |car: &Self| car.board.is_none();
        let trouble = |_: &Self| failed("the board does not come back", CHECK_LINE);
        Self::begin(bench)?.wait_while(15.0, is_silent, trouble)
    }

    /// Waits while something holds; fails if it holds for too long.
    fn wait_while(
        &mut self,
        seconds: f64,
        holds: impl Fn(&Self) -> bool,
        trouble: impl FnOnce(&Self) -> Trouble,
    ) -> Result<(), Trouble> {
        let until = self.now.after(seconds);
        while holds(self) {
            if self.now >= until {
                return Err(trouble(self));
            }
            self.tick()?;
        }
        Ok(())
    }

    /// Lets a tick pass.
    fn tick(&mut self) -> Result<(), Trouble> {
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
                    Time(health.receive_time_ns)
                }
                Observation::Pose(pose) => {
                    self.place.see(pose);
                    pose.receive
                }
                Observation::NoPose { receive, .. } => *receive,
                Observation::Tick(tick) => tick.time,
                Observation::Link(ready) => {
                    self.linked = *ready;
                    continue;
                }
            };
            self.now = self.now.max(at);
        }
        self.silent_waits = match self.now > before {
            true => 0,
            false => self.silent_waits + 1,
        };
        let fix = "Check that singletrackd runs: `singletrack status`.";
        let is_heard = self.silent_waits <= SILENT_WAITS;
        require(is_heard, "the daemon sends nothing", fix)?;
        self.check_place()
    }

    /// Waits for a time without a request; returns the telemetry.
    pub(super) fn watch(&mut self, seconds: f64, what: &str) -> Result<Vec<BoardReading>, Trouble> {
        self.pass(seconds, what, |car| car.tick().map(|()| false))
    }

    /// Lets a time pass, each tick of it in `tick`, which may end it early; returns the telemetry.
    fn pass(
        &mut self,
        seconds: f64,
        what: &str,
        mut tick: impl FnMut(&mut Self) -> Result<bool, Trouble>,
    ) -> Result<Vec<BoardReading>, Trouble> {
        let begin = self.now;
        let mut all = Vec::new();
        let mut has_ended = false;
        while !has_ended {
            let done = self.now.seconds_since(begin) / seconds;
            if done >= 1.0 {
                break;
            }
            has_ended = tick(self)?;
            all.extend_from_slice(&self.readings);
            self.show(what, done);
        }
        Ok(all)
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
        self.bench.show(&text, done);
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
        let until = self.now.after(ARMING_S);
        loop {
            match self.bench.arm(Attendance::Jog) {
                Ok(()) => break,
                Err(Refused(why)) if self.now >= until => {
                    let found = format!("the car can't be armed: {why}");
                    return Err(failed(found, "Correct it and run the bring-up again."));
                }
                Err(_) => {
                    self.watch(0.2, "arming")?;
                }
            }
        }
        self.renewed = None;
        // The hand took its time.
        self.tick()?;
        let until = self.now.after(ARMING_S);
        let rest = self.rest();
        while !self.jogs() {
            let found = "the board does not take the jog after it was armed";
            require(self.now < until, found, "See the log of the daemon.")?;
            // Refused until the board is armed.
            let _ = self.bench.jog(rest);
            self.tick()?;
            self.show("arming", 0.0);
        }
        Ok(())
    }

    /// Whether the board is in an armed jog.
    pub(super) fn jogs(&self) -> bool {
        self.is_in(BoardMode::Jogging)
    }

    /// Whether the board holds an emergency stop.
    pub(super) fn is_latched(&self) -> bool {
        self.is_in(BoardMode::EmergencyStopped)
    }

    fn is_in(&self, mode: BoardMode) -> bool {
        self.board.is_some_and(|reading| reading.mode == mode)
    }

    /// Holds these pulses for a time; returns the telemetry.
    pub(super) fn hold(
        &mut self,
        jog: Jog,
        seconds: f64,
        what: &str,
    ) -> Result<Vec<BoardReading>, Trouble> {
        self.hold_until(jog, seconds, what, |_| false)
    }

    /// [`Self::hold`] that ends when `ends` is true for a record of the telemetry.
    pub(super) fn hold_until(
        &mut self,
        jog: Jog,
        seconds: f64,
        what: &str,
        mut ends: impl FnMut(&BoardReading) -> bool,
    ) -> Result<Vec<BoardReading>, Trouble> {
        self.pass(seconds, what, |car| {
            car.renew(jog)?;
            car.tick()?;
            if !car.jogs() {
                return Err(car.ended("by itself"));
            }
            if car.is_silent() {
                return Err(car.ended("the board sends nothing"));
            }
            if jog.esc_us != car.rest().esc_us {
                car.check_seen()?;
            }
            Ok(car.readings.iter().any(&mut ends))
        })
    }

    fn renew(&mut self, jog: Jog) -> Result<(), Trouble> {
        let now = self.now;
        let last = self.renewed.filter(|(_, last)| *last == jog);
        if last.is_some_and(|(at, _)| now.seconds_since(at) < RENEWAL_S) {
            return Ok(());
        }
        if let Err(Refused(why)) = self.bench.jog(jog) {
            // The board's reason arrives a moment later.
            for _ in 0..5 {
                self.tick()?;
            }
            return Err(self.ended(why));
        }
        self.renewed = Some((now, jog));
        Ok(())
    }

    fn ended(&self, why: impl Into<String>) -> Trouble {
        let cause = self.board.map_or(StopCause::None, |board| board.stop_cause);
        let why = why.into();
        Trouble::Ended { cause, why }
    }

    /// Stops a car that has left its stand.
    fn check_place(&mut self) -> Result<(), Trouble> {
        let Some(way) = self.place.left else {
            return Ok(());
        };
        let _ = self.bench.emergency_stop();
        let mm = way * 1e3;
        let found = format!("the cameras saw the car move by {mm:.0} mm: emergency stop");
        let fix = "Put the car on its stand so that nothing can move it, press the reset of the \
                   board, and run the bring-up again.";
        Err(failed(found, fix))
    }

    /// Disarms a car whose wheels may turn and which the cameras do not see.
    fn check_seen(&mut self) -> Result<(), Trouble> {
        let seen = self.place.seen;
        if seen.is_some_and(|seen| self.now.seconds_since(seen) <= UNSEEN_S) {
            return Ok(());
        }
        let _ = self.bench.disarm();
        let found = "the cameras lost the car while its wheels turned";
        Err(failed(found, IN_VIEW))
    }

    /// Ends the jog at neutral, and waits until the wheels stand.
    pub(super) fn end(&mut self) -> Result<(), Trouble> {
        let rest = self.rest();
        if self.jogs() {
            self.hold(rest, 0.1, "neutral")?;
            self.disarm()?;
        }
        let turns = |car: &Self| car.board.is_some_and(|board| board.turns());
        self.wait_while(8.0, turns, |_| {
            let found = "the motor still turns 8 s after its pulse went to neutral";
            let fix = "Cut the supply of the ESC. Its neutral is another than \
                       board.esc.neutral_us, or it is stuck.";
            failed(found, fix)
        })
    }

    /// Asks for the end of the jog, and waits for it.
    pub(super) fn disarm(&mut self) -> Result<(), Trouble> {
        self.request_disarm()?;
        self.wait_while(3.0, Self::jogs, |_| {
            let fix = "Cut the supply of the ESC. See the log of the daemon.";
            failed("the board is still armed 3 s after the disarm request", fix)
        })
    }

    /// Requests the end of the jog.
    pub(super) fn request_disarm(&mut self) -> Result<(), Trouble> {
        granted("disarm request", self.bench.disarm())
    }

    /// Requests an emergency stop.
    pub(super) fn request_emergency_stop(&mut self) -> Result<(), Trouble> {
        granted("emergency stop", self.bench.emergency_stop())
    }

    /// Whether the board has sent nothing for [`SILENT_S`].
    fn is_silent(&self) -> bool {
        let heard = self.board.map_or(self.now, |board| board.receive);
        !self.linked || self.now.seconds_since(heard) >= SILENT_S
    }

    /// The bench, for its configuration.
    pub(super) fn bench(&mut self) -> &mut dyn Bench {
        self.bench
    }
}

/// Runs an armed jog, and repeats it if the operator let go or the daemon lost the board for a moment.
pub(super) fn armed<T>(
    bench: &mut dyn Bench,
    mut jog: impl FnMut(&mut Car<'_>) -> Result<T, Trouble>,
) -> Result<T, Trouble> {
    use StopCause::{CommandTimeout, Disarmed, HostRestarted, JogTimeout};
    let mut attempt = 1;
    loop {
        let mut car = Car::look(bench)?;
        let result = car.arm().and_then(|()| jog(&mut car));
        let result = result.and_then(|value| car.end().map(|()| value));
        let Err(Trouble::Ended { cause, .. }) = &result else {
            return result;
        };
        let may_pass = matches!(
            cause,
            CommandTimeout | JogTimeout | Disarmed | HostRestarted
        );
        if !may_pass || attempt == ATTEMPTS {
            return result;
        }
        attempt += 1;
    }
}

/// Nothing, or the failure of a stop that the daemon refused.
fn granted(what: &str, answer: Result<(), Refused>) -> Result<(), Trouble> {
    answer.map_err(|Refused(why)| {
        let found = format!("the {what} was refused: {why}");
        failed(found, "Cut the supply of the ESC.")
    })
}

/// Way by which a car on its stand may shake, m, in several poses and in one.
const SHAKES_M: f64 = 0.02;
const JUMPS_M: f64 = 0.06;

/// Turn by which it may shake, rad.
const SHAKES_RAD: f64 = 0.1;

/// Poses in a row beyond these limits after which the car counts as moving.
const MOVING_POSES: u32 = 3;

/// Poses whose mean is the place of the car.
const PLACE_POSES: u32 = 10;

/// The place of a car, which it must not leave.
#[derive(Debug, Default)]
pub(super) struct Place {
    poses: u32,
    sum: Vector3<f64>,
    yaw: f64,
    off: u32,
    /// How far the car has moved when it has left its place, m.
    pub(super) left: Option<f64>,
    /// When the last pose arrived.
    pub(super) seen: Option<Time>,
}

impl Place {
    pub(super) fn see(&mut self, pose: &PoseReading) {
        self.seen = Some(pose.receive);
        let position = Vector3::from(pose.position);
        if self.poses < PLACE_POSES {
            if self.poses == 0 {
                self.yaw = pose.yaw;
            }
            self.poses += 1;
            self.sum += position;
            return;
        }
        let way = (position - self.sum / f64::from(self.poses)).norm();
        let turn = (pose.yaw - self.yaw).sin().abs();
        self.off = match way > SHAKES_M || turn > SHAKES_RAD {
            true => self.off + 1,
            false => 0,
        };
        if self.off >= MOVING_POSES || way > JUMPS_M {
            self.left = Some(way);
        }
    }
}
