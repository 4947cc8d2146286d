//! Which of the pulses on the pins drive the car.

use singletrack_sim::PulseRecord;

use crate::spec::{Spec, TOLERANCE_US};

/// What an ESC pulse does, by the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    /// No pulse.
    Absent,
    /// The configured neutral, or the one before any configuration and after an emergency
    /// stop, which a configuration must have in its deadband.
    Neutral,
    /// The brake pulse of a board that may brake, after driving forward, for at most
    /// [`BRAKE_US`].
    Brake,
    /// Everything else: the ESC may drive the car.
    Drive,
}

/// A servo frame on the pins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Pulse {
    pub(crate) record: PulseRecord,
    pub(crate) effect: Effect,
}

impl core::ops::Deref for Pulse {
    type Target = PulseRecord;

    fn deref(&self) -> &PulseRecord {
        &self.record
    }
}

impl Pulse {
    /// Whether the ESC may drive the car.
    pub(crate) fn drives(&self) -> bool {
        self.effect == Effect::Drive
    }

    /// Whether an ESC that gets no further pulse drives the car until it notices the loss of
    /// the signal.
    ///
    /// That is the true ESC's affair. A slow car is driven with pulses near the deadband; where
    /// the true one is narrower than configured, a pulse between the two drives. A running board
    /// replaces it, a dead one can not.
    pub(crate) fn drives_on(&self, spec: &Spec) -> bool {
        let beyond_true = || {
            spec.true_neutral_us
                .is_some_and(|us| self.esc_us.abs_diff(us) > spec.true_deadband_us)
        };
        self.drives() && (!self.releases(spec) || beyond_true())
    }

    /// Whether the motor is free or brakes, by the configured deadband: a car that is too
    /// fast is given the edge of the deadband.
    pub(crate) fn releases(&self, spec: &Spec) -> bool {
        let esc = &spec.board.esc;
        !self.drives() || self.esc_us.abs_diff(esc.neutral_us) <= esc.deadband_us + TOLERANCE_US
    }
}

/// The longest brake pulse: half a second, begun a servo period and a round of the main
/// loop apart, on a clock that may be 0.5 % slow.
pub(crate) const BRAKE_US: u64 = 500_000 + 20_000 + 10_000 + 2_500;

/// The pulse before any configuration and after an emergency stop, which trusts none: the
/// neutral of most ESCs.
pub(crate) const START_PULSE_US: u16 = 1_500;

/// Frames beyond the deadband after which an ESC has seen that it is driven forward: 60 ms.
const DRIVEN_FRAMES: u8 = 3;

/// Whether an ESC has been driven forward, so that the next pulse below neutral brakes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Forward {
    frames: u8,
    driven: bool,
}

impl Forward {
    /// Takes a frame without a brake pulse.
    pub(crate) fn frame(&mut self, spec: &Spec, record: &PulseRecord) {
        let esc = &spec.board.esc;
        let drives = record.esc_us > esc.neutral_us + esc.deadband_us && !record.cut;
        self.frames = if drives {
            self.frames.saturating_add(1)
        } else {
            0
        };
        self.driven |= self.frames >= DRIVEN_FRAMES;
    }

    pub(crate) const fn has_driven(&self) -> bool {
        self.driven
    }
}

/// Follows the pulses.
#[derive(Debug, Default)]
pub(crate) struct Pins {
    /// Driven forward since the last brake pulse.
    forward: Forward,
    /// Start of the present brake pulse.
    brake_since_us: Option<u64>,
}

impl Pins {
    /// `jogs`: a jog has no brake pulse.
    pub(crate) fn observe(&mut self, spec: &Spec, record: PulseRecord, jogs: bool) -> Pulse {
        let effect = self.effect(spec, &record, jogs);
        if effect != Effect::Brake {
            if self.brake_since_us.take().is_some() {
                self.forward = Forward::default();
            }
            self.forward.frame(spec, &record);
        }
        Pulse { record, effect }
    }

    fn effect(&mut self, spec: &Spec, record: &PulseRecord, jogs: bool) -> Effect {
        let esc = &spec.board.esc;
        if record.esc_us == 0 {
            return Effect::Absent;
        }
        // A pulse cut by a reset drives only if it is longer than neutral.
        let short = record.cut && record.esc_us < esc.neutral_us;
        let is = |us: u16| record.esc_us.abs_diff(us) <= TOLERANCE_US;
        if short || is(esc.neutral_us) || is(START_PULSE_US) {
            return Effect::Neutral;
        }
        if jogs || !(spec.brakes() && record.esc_us.abs_diff(esc.brake_us) <= TOLERANCE_US) {
            return Effect::Drive;
        }
        let since_us = self.brake_since_us.or_else(|| {
            // Without a drive forward before it, the pulse is reverse.
            self.forward.has_driven().then_some(record.time_us)
        });
        match since_us {
            Some(since_us) if record.time_us - since_us <= BRAKE_US => {
                self.brake_since_us = Some(since_us);
                Effect::Brake
            }
            _ => Effect::Drive,
        }
    }
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::EscKind;

    use super::*;
    use crate::observation::scene::Scene;

    #[test]
    fn a_brake_pulse_counts_once_per_drive_forward_and_for_half_a_second() {
        let mut scene = Scene::new();
        let effects = |spec: &Spec, pulses: &[(u64, u16)]| {
            let mut pins = Pins::default();
            let effect = |&(ms, esc_us): &(u64, u16)| {
                let record = PulseRecord {
                    time_us: ms * 1_000,
                    esc_us,
                    ..scene_pulse()
                };
                pins.observe(spec, record, false).effect
            };
            pulses.iter().map(effect).collect::<Vec<_>>()
        };
        use Effect::{Absent, Brake, Drive, Neutral};
        let driven = [(0, 1_560), (20, 1_560), (40, 1_560)];
        let drive = |rest: &[(u64, u16)]| [&driven, rest].concat();
        let brakes = drive(&[(60, 1_350), (500, 1_350), (600, 1_350)]);
        scene.spec.board.esc.kind = EscKind::ForwardReverse;
        assert_eq!(
            effects(&scene.spec, &brakes),
            [Drive; 6],
            "an ESC without a brake"
        );
        scene.spec.board.esc.kind = EscKind::Car;
        assert_eq!(
            effects(&scene.spec, &brakes),
            [Drive, Drive, Drive, Brake, Brake, Drive],
            "too long"
        );
        let paused = [
            (0, 1_560),
            (20, 1_560),
            (40, 1_500),
            (60, 1_560),
            (80, 1_350),
        ];
        assert_eq!(
            effects(&scene.spec, &paused),
            [Drive, Drive, Neutral, Drive, Drive],
            "not driven for three frames without a pause"
        );
        assert_eq!(
            effects(&scene.spec, &[(0, 1_500), (20, 1_350)]),
            [Neutral, Drive],
            "never driven"
        );
        let twice = drive(&[(60, 1_350), (80, 1_500), (100, 1_350), (120, 0)]);
        assert_eq!(
            effects(&scene.spec, &twice)[3..],
            [Brake, Neutral, Drive, Absent]
        );
    }

    #[test]
    fn a_held_pulse_drives_beyond_either_deadband_unless_it_is_no_pulse_that_drives() {
        let mut scene = Scene::new();
        let spec = &mut scene.spec;
        (spec.board.esc.neutral_us, spec.board.esc.deadband_us) = (1_500, 30);
        let drives_on = |spec: &Spec, esc_us: u16, effect| {
            let record = PulseRecord {
                esc_us,
                ..scene_pulse()
            };
            Pulse { record, effect }.drives_on(spec)
        };
        for (neutral_us, deadband_us, pulse_us, expected) in [
            (Some(1_500), 25, 1_525, false),
            (Some(1_500), 25, 1_526, true),
            (Some(1_491), 30, 1_522, true),
            // As configured, whatever the true one is.
            (Some(1_500), 60, 1_531, false),
            (Some(1_500), 60, 1_532, true),
            // It learns its neutral.
            (None, 25, 1_526, false),
            (None, 25, 1_532, true),
        ] {
            (spec.true_neutral_us, spec.true_deadband_us) = (neutral_us, deadband_us);
            let found = drives_on(spec, pulse_us, Effect::Drive);
            assert_eq!(found, expected, "{neutral_us:?} {deadband_us} {pulse_us}");
            for effect in [Effect::Neutral, Effect::Brake, Effect::Absent] {
                assert!(!drives_on(spec, pulse_us, effect));
            }
        }
    }

    fn scene_pulse() -> PulseRecord {
        Scene::new().pulses[0].record
    }
}
