//! Turning the motor in an armed jog.

use singletrack_protocol::{JOG_LIMIT_US, StopCause};

use super::car::Car;
use crate::{BoardReading, Jog, Trouble, finding::failed};

/// Speed of the wheels in most steps, m/s: it comes to about 0.5.
pub(super) const SPIN_M_S: f64 = 0.4;

/// Speed below which wheels that slow down count as standing, m/s.
pub(super) const CREEPS: f64 = 0.12;

impl Car<'_> {
    /// Turns the motor forward, beginning just beyond its deadband, at this speed of its wheels at
    /// least if 150 us reach it; gives the pulse.
    pub(super) fn spin(&mut self, wanted: f64) -> Result<Jog, Trouble> {
        let from_us = self.beyond_deadband();
        self.spin_from(from_us, wanted)?.ok_or_else(never_turned)
    }

    /// Where the search for the first turn begins once the deadband is known, beyond neutral, us.
    pub(super) fn beyond_deadband(&mut self) -> u16 {
        self.bench().configuration().board.esc.deadband_us + 4
    }

    /// [`Self::spin`] that begins `from_us` beyond neutral; nothing if the motor does not turn.
    ///
    /// The ESC is driven in bursts until the first pulses come: after 0.6 s of driving without a
    /// pulse the board assumes a dead sensor.
    pub(super) fn spin_from(&mut self, from_us: u16, wanted: f64) -> Result<Option<Jog>, Trouble> {
        let Some(mut jog) = self.first_turn(true, from_us)? else {
            return Ok(None);
        };
        let highest = jog.esc_us.max(self.rest().esc_us + JOG_LIMIT_US);
        let begin = self.now;
        let mut before = 0.0;
        loop {
            let readings = self.hold(jog, 0.4, "spinning up")?;
            let speed = mean_speed(&readings[readings.len() / 2..]);
            let late = self.now.seconds_since(begin) > 5.0;
            if speed >= wanted || late || jog.esc_us >= highest {
                return Ok(Some(jog));
            }
            // Smaller steps where the last one raised the speed by more than 0.15 m/s.
            let step_us = if speed - before > 0.15 { 3 } else { 8 };
            before = speed;
            jog.esc_us = (jog.esc_us + step_us).min(highest);
        }
    }

    /// Turns the motor until the jog ends, the wheels stand, or the time is over. A hand may stop it
    /// as soon as the wheels turn.
    pub(super) fn spin_for_hand(
        &mut self,
        from_us: u16,
        seconds: f64,
        what: &str,
    ) -> Result<Spun, Trouble> {
        let mut jog = self.first_turn(true, from_us)?.ok_or_else(never_turned)?;
        let highest = self.rest().esc_us + JOG_LIMIT_US;
        let begin = self.now;
        let mut spun = Spun::default();
        while self.now.seconds_since(begin) < seconds {
            let held = self.hold_until(jog, 0.1, what, |reading| !reading.turns());
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
            // Not while the hand slows it down.
            if last < 0.4 && last >= 0.9 * spun.fastest() {
                jog.esc_us = (jog.esc_us + 4).min(highest);
            }
        }
        Ok(spun)
    }

    /// Drives in bursts of 0.5 s, each 8 us farther from neutral, until the wheels turn; gives
    /// that pulse, which is still held.
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
            let esc_us = beyond(rest.esc_us, offset_us, forward);
            let jog = Jog { esc_us, ..rest };
            let what = "looking for the first turn";
            let readings = self.hold_until(jog, 0.5, what, BoardReading::turns)?;
            if readings.iter().any(BoardReading::turns) {
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
        if self.board.is_some_and(|board| board.turns()) {
            self.hold_until(jog, 8.0, "rolling out", |reading| !reading.turns())?;
            // The reported speed is zero half a second after the last pulse. Where pulses are far
            // apart, the board needs longer to take the wheels for standing.
            self.hold(jog, 0.3, "neutral")?;
        }
        Ok(())
    }
}

/// A motor that was turned until a hand stopped it.
#[derive(Debug, Default)]
pub(super) struct Spun {
    /// The telemetry until then.
    pub(super) readings: Vec<BoardReading>,
    /// The board's reason, if the jog ended.
    pub(super) ended: Option<StopCause>,
}

impl Spun {
    /// Highest speed, m/s.
    pub(super) fn fastest(&self) -> f64 {
        let readings = self.readings.iter();
        let speeds = readings.map(|reading| reading.motor_speed.abs());
        speeds.fold(0.0, f64::max)
    }

    /// Speed before the end, m/s.
    pub(super) fn last_speed(&self) -> f64 {
        let from = self.readings.len().saturating_sub(20);
        mean_speed(&self.readings[from..])
    }

    /// Whether the wheels came to rest while their pulse still drove them.
    pub(super) fn stopped_under_drive(&self) -> bool {
        let stands = self.readings.last().is_some_and(|last| !last.turns());
        // The board can't distinguish a motor that does not turn from a dead sensor.
        stands || self.ended == Some(StopCause::MotorSensor)
    }
}

/// The pulse at this distance from neutral.
pub(super) fn beyond(neutral_us: u16, offset_us: u16, forward: bool) -> u16 {
    if forward {
        neutral_us + offset_us
    } else {
        neutral_us.saturating_sub(offset_us)
    }
}

/// Mean magnitude of the speed; zero without telemetry.
pub(super) fn mean_speed(readings: &[BoardReading]) -> f64 {
    let speeds = readings.iter().map(|reading| reading.motor_speed.abs());
    speeds.sum::<f64>() / readings.len().max(1) as f64
}

/// The way of wheels that slow down, m. The board takes half a second to report that they
/// stand: what is slower than [`CREEPS`] does not count.
pub(super) fn way(readings: &[BoardReading]) -> f64 {
    readings
        .windows(2)
        .take_while(|pair| pair[1].motor_speed.abs() > CREEPS)
        .map(|pair| pair[1].motor_speed.abs() * pair[1].receive.seconds_since(pair[0].receive))
        .sum()
}

/// The trouble of a motor that gave no pulse as far from neutral as the board allows.
pub(super) fn never_turned() -> Trouble {
    let found = format!("no motor pulse up to {JOG_LIMIT_US} us beyond neutral");
    let fix = "Is the ESC on and started, with its battery charged? Are servo (D9) and ESC (D10) \
               swapped? Does the pulse sensor count when the wheels are turned by hand \
               (`singletrack doctor`)?";
    failed(found, fix)
}
