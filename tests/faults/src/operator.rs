//! The operator's program: it holds the drive that it has armed, or gives the pulses of a jog.

use singletrack_pilot::Jog;
use singletrack_protocol::Configuration;

use crate::{
    random::{Random, Stream},
    schedule::{Fault, FaultKind},
};

/// Intervals of the renewals, in µs: as `singletrack` sends them.
const HOLD_US: u64 = 100_000;
const JOG_US: u64 = 50_000;

/// Half a period of throttle and steering by turns, in µs.
const TAP_US: u64 = 500_000;

/// Pulse of the throttle beyond the configured deadband, and steering beside the centre, in µs.
const THROTTLE_US: u16 = 25;
const STEERING_US: u16 = 150;

/// What the program attends to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Attends {
    /// A drive.
    Drive,
    /// Jogging, with throttle and steering by turns.
    Taps,
    /// Jogging, with the throttle held.
    Throttle,
}

/// What the program sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Renewal {
    Hold,
    Jog(Jog),
}

/// When the daemon was last sent a renewal, in µs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Renewed {
    /// A request of any kind: each renews a held drive.
    pub(crate) drive_us: Option<u64>,
    /// Pulses, which alone renew a jog.
    pub(crate) jog_us: Option<u64>,
}

/// The operator's program.
#[derive(Debug)]
pub(crate) struct Operator {
    random: Random,
    attends: Option<Attends>,
    since_us: u64,
    sent_us: u64,
    renewed: Renewed,
}

impl Operator {
    pub(crate) fn new(seed: u64) -> Self {
        Self {
            random: Random::new(seed, Stream::Operator),
            attends: None,
            since_us: 0,
            sent_us: 0,
            renewed: Renewed::default(),
        }
    }

    pub(crate) const fn renewed(&self) -> Renewed {
        self.renewed
    }

    /// The program has asked to arm, and renews what it has asked for from now on.
    pub(crate) const fn attend(&mut self, now_us: u64, attends: Attends) {
        self.attends = Some(attends);
        self.since_us = now_us;
        self.sent_us = now_us;
        self.renewed.drive_us = Some(now_us);
    }

    /// The program has ended the drive, or its connection is lost.
    pub(crate) const fn leave(&mut self) {
        self.attends = None;
    }

    /// Another client has renewed the drive.
    pub(crate) const fn was_renewed(&mut self, now_us: u64) {
        self.renewed.drive_us = Some(now_us);
    }

    /// What the program sends now.
    pub(crate) fn poll(
        &mut self,
        now_us: u64,
        faults: &[Fault],
        board: &Configuration,
    ) -> Option<Renewal> {
        let attends = self.attends?;
        let is_active = |kind| faults.iter().any(|fault| fault.kind == kind);
        let interval_us = match attends {
            Attends::Drive => HOLD_US,
            Attends::Taps | Attends::Throttle => JOG_US,
        };
        if is_active(FaultKind::OperatorHangs) || now_us < self.sent_us + interval_us {
            return None;
        }
        self.sent_us = now_us;
        self.renewed.drive_us = Some(now_us);
        if attends == Attends::Drive {
            return Some(Renewal::Hold);
        }
        self.renewed.jog_us = Some(now_us);
        if is_active(FaultKind::JogWild) {
            let mut any = || self.random.between(0, u16::MAX.into()) as u16;
            return Some(Renewal::Jog(Jog {
                servo_us: any(),
                esc_us: any(),
            }));
        }
        let half = (now_us - self.since_us) / TAP_US;
        let drives = attends == Attends::Throttle || half.is_multiple_of(2);
        let (servo, esc) = (&board.servo, &board.esc);
        let beside = if (half / 2).is_multiple_of(2) { -1 } else { 1 } * STEERING_US.cast_signed();
        Some(Renewal::Jog(Jog {
            servo_us: servo.centre_us.saturating_add_signed(beside),
            esc_us: esc.neutral_us + u16::from(drives) * (esc.deadband_us + THROTTLE_US),
        }))
    }
}
