//! What the planted bugs do.

use std::collections::VecDeque;

use singletrack_core::config::Config;
use singletrack_pilot::{Arming, Event, Learned, Mode, PilotRequest};
use singletrack_protocol::{Decoder, Drive, ToBoard};
use singletrack_record::TickRecord;
use singletrack_sim::PulseRecord;

use crate::tamper::Tamper;

/// Changes pulses.
pub(super) struct Pulses<F>(pub(super) F);

impl<F: FnMut(&mut PulseRecord)> Tamper for Pulses<F> {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        (self.0)(pulse);
    }
}

/// Stands in for a faulty pilot.
pub(super) struct Ticks<F>(pub(super) F);

impl<F: FnMut(&mut TickRecord)> Tamper for Ticks<F> {
    fn tick(&mut self, tick: &mut TickRecord) {
        (self.0)(tick);
    }

    fn is_replayed(&self) -> bool {
        false
    }
}

/// Changes the record of ticks.
pub(super) struct Records<F>(pub(super) F);

impl<F: FnMut(&mut TickRecord)> Tamper for Records<F> {
    fn tick(&mut self, tick: &mut TickRecord) {
        (self.0)(tick);
    }
}

/// A host that takes over another configuration than the one it was given.
pub(super) struct Configurations<F>(pub(super) F);

impl<F: FnMut(u32, &mut Config)> Tamper for Configurations<F> {
    fn configuration(&mut self, number: u32, config: &mut Config) {
        (self.0)(number, config);
    }

    fn is_replayed(&self) -> bool {
        false
    }
}

/// A host that runs with other values than its configuration's.
pub(super) struct Host<F>(pub(super) F);

impl<F: FnMut(&mut Config)> Tamper for Host<F> {
    fn host(&mut self, config: &mut Config) {
        (self.0)(config);
    }

    fn is_replayed(&self) -> bool {
        false
    }
}

/// A pilot that learns otherwise.
pub(super) struct Learns<F>(pub(super) F);

impl<F: FnMut(u64, &mut Learned)> Tamper for Learns<F> {
    fn learned(&mut self, index: u64, learned: &mut Learned) {
        (self.0)(index, learned);
    }
}

/// A host that writes other commands.
pub(super) struct Commands<F>(pub(super) F);

impl<F: FnMut(&mut Drive)> Tamper for Commands<F> {
    fn written(&mut self, _: u64, bytes: &mut Vec<u8>) {
        *bytes = frames(bytes)
            .flat_map(|(frame, message)| match message {
                Some(ToBoard::Drive(mut drive)) => {
                    (self.0)(&mut drive);
                    ToBoard::from(drive).encode().as_bytes().to_vec()
                }
                _ => frame.to_vec(),
            })
            .collect();
    }
}

/// The frames of what was written, with the messages in them.
fn frames(bytes: &[u8]) -> impl Iterator<Item = (&[u8], Option<ToBoard>)> {
    bytes.split_inclusive(|&byte| byte == 0).map(|frame| {
        let mut decoder = Decoder::new();
        let message = frame.iter().find_map(|&byte| {
            let packet = decoder.push(byte)?.ok()?;
            ToBoard::decode(packet).ok()
        });
        (frame, message)
    })
}

/// The pulses by which a bug tells what the board does: neutral in every schedule without
/// a misconfigured ESC, and the brake pulse.
pub(super) use crate::pins::START_PULSE_US as NEUTRAL_US;
const BRAKE_US: u16 = 1_350;
const DEADBAND_US: u16 = 30;

/// Changes the pulses that drive, from 6 s on.
pub(super) fn driving(mut change: impl FnMut(&mut PulseRecord)) -> impl Tamper {
    Pulses(move |pulse: &mut PulseRecord| {
        if pulse.time_us > 6_000_000 && pulse.esc_us > NEUTRAL_US {
            change(pulse);
        }
    })
}

/// Changes the ticks that command.
pub(super) fn commanding(mut change: impl FnMut(&mut TickRecord)) -> impl Tamper {
    Ticks(move |tick: &mut TickRecord| {
        if tick.index > 600 && tick.output.mode.commands() {
            change(tick);
        }
    })
}

/// A pilot that follows its reference whatever happens.
pub(super) fn drives_on() -> impl Tamper {
    commanding(|tick| {
        tick.output.mode = Mode::Driving;
        tick.output.reason = None;
    })
}

/// A pilot whose estimate leaves the car.
pub(super) fn wandering() -> impl Tamper {
    let mut metres = 0.0;
    commanding(move |tick| {
        if tick.output.mode == Mode::Driving
            && let Some(estimate) = &mut tick.output.estimate
        {
            metres += 0.01;
            estimate.position.x += metres;
        }
    })
}

/// A board that steers to a stop and back.
pub(super) fn steering_by_turns() -> impl Tamper {
    let mut left = false;
    driving(move |pulse| {
        left = !left;
        pulse.servo_us = if left { 1_900 } else { 1_100 };
    })
}

/// A board that drives slowly from a time on, without a command.
pub(super) fn creeping(from_us: u64) -> impl Tamper {
    let mut esc_us = NEUTRAL_US;
    Pulses(move |pulse: &mut PulseRecord| {
        if pulse.time_us > from_us && esc_us < 1_650 {
            esc_us += 30;
            pulse.esc_us = esc_us;
        }
    })
}

/// A board whose driving pulses continue `longer_us` too long.
pub fn prolonged(longer_us: u64) -> impl Tamper {
    let mut last = (0, NEUTRAL_US);
    Pulses(move |pulse: &mut PulseRecord| {
        let (driven_us, esc_us) = last;
        if pulse.esc_us > NEUTRAL_US {
            last = (pulse.time_us, pulse.esc_us);
        } else if driven_us > 0 && pulse.time_us <= driven_us + longer_us {
            pulse.esc_us = esc_us;
        }
    })
}

/// A board whose neutral after a drive is beyond the deadband, and which does not notice.
pub(super) fn creeping_after_a_stop() -> impl Tamper {
    let mut driven = false;
    Pulses(move |pulse: &mut PulseRecord| {
        driven |= pulse.esc_us > NEUTRAL_US + DEADBAND_US;
        let rests = pulse.esc_us == 0 || pulse.esc_us.abs_diff(NEUTRAL_US) <= DEADBAND_US;
        if driven && rests {
            pulse.esc_us = NEUTRAL_US + DEADBAND_US + 25;
        }
    })
}

/// A board that does not notice that the car runs at neutral.
pub(super) fn drives_at_neutral() -> impl Tamper {
    Pulses(|pulse: &mut PulseRecord| {
        if pulse.time_us > 3_000_000 && (pulse.esc_us == 0 || pulse.esc_us == NEUTRAL_US) {
            pulse.esc_us = NEUTRAL_US + DEADBAND_US + 20;
        }
    })
}

/// A board that brakes until it drives again.
#[derive(Default)]
pub(super) struct NeverReleases {
    brakes: bool,
}

impl Tamper for NeverReleases {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        if pulse.esc_us == BRAKE_US {
            self.brakes = true;
        } else if pulse.esc_us > NEUTRAL_US + DEADBAND_US {
            self.brakes = false;
        }
        if self.brakes {
            pulse.esc_us = BRAKE_US;
        }
    }
}

/// A board that brakes once more than it should.
pub(super) struct Brakes {
    driven: bool,
    /// Frames until it brakes.
    wait: u32,
    frames: u32,
    left: VecDeque<u16>,
}

impl Brakes {
    /// Brakes for some frames, `wait` frames after a drive.
    pub(super) fn after_driving(wait: u32, frames: u32) -> Self {
        Self {
            driven: false,
            wait,
            frames,
            left: VecDeque::new(),
        }
    }

    /// Brakes for ten frames after three seconds.
    pub(super) fn at_once() -> Self {
        let mut brakes = Self::after_driving(0, 0);
        brakes.left.extend([0; 145]);
        brakes.left.extend([BRAKE_US; 10]);
        brakes
    }
}

impl Tamper for Brakes {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        if pulse.esc_us > NEUTRAL_US + DEADBAND_US {
            self.driven = true;
            self.left.clear();
            return;
        }
        if core::mem::take(&mut self.driven) {
            self.left.extend((0..self.wait).map(|_| 0));
            self.left.extend((0..self.frames).map(|_| BRAKE_US));
        }
        match self.left.pop_front() {
            Some(0) | None => {}
            Some(us) => pulse.esc_us = us,
        }
    }
}

impl Brakes {
    /// Brakes for ten frames after the first frame of a drive.
    pub(super) fn after_one_frame() -> AfterOneFrame {
        AfterOneFrame { left: None }
    }
}

/// A board that brakes for ten frames after the first frame of a drive.
pub(super) struct AfterOneFrame {
    left: Option<u32>,
}

impl Tamper for AfterOneFrame {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        match &mut self.left {
            None if pulse.esc_us > NEUTRAL_US + DEADBAND_US => self.left = Some(10),
            Some(left) if *left > 0 => {
                *left -= 1;
                pulse.esc_us = BRAKE_US;
            }
            _ => {}
        }
    }
}

/// A board that gives ten frames of neutral too many before it is silent.
#[derive(Default)]
pub(super) struct LateSilence {
    given: u32,
}

impl Tamper for LateSilence {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        if pulse.esc_us == 0 && !pulse.cut && self.given < 10 {
            self.given += 1;
            pulse.esc_us = NEUTRAL_US;
        }
    }
}

/// A board configured with a neutral of 1440 µs that gives 1500 µs after a drive, for good: a
/// pulse that every configuration has in its deadband, and that drives this car.
#[derive(Default)]
pub(super) struct NeutralThatDrives {
    driven: bool,
}

impl Tamper for NeutralThatDrives {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        self.driven |= pulse.esc_us > NEUTRAL_US + DEADBAND_US;
        if self.driven && pulse.esc_us <= NEUTRAL_US {
            pulse.esc_us = NEUTRAL_US;
        }
    }
}

/// A board that drives from the request to arm on, and does not hear a disarm.
pub(super) struct DrivesWhileArming;

impl Tamper for DrivesWhileArming {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        if (4_500_000..5_500_000).contains(&pulse.time_us) {
            pulse.esc_us = NEUTRAL_US + DEADBAND_US + 40;
        }
    }

    fn to_board(&mut self, _: u64, bytes: &mut Vec<u8>) {
        *bytes = frames(bytes)
            .filter(|(_, message)| !matches!(message, Some(ToBoard::Disarm(_))))
            .flat_map(|(frame, _)| frame.to_vec())
            .collect();
    }
}

/// A pilot that takes its configuration for proved 0.4 s after it has begun to drive.
pub(super) fn proves_early() -> impl Tamper {
    let mut ticks = 0;
    Ticks(move |tick: &mut TickRecord| {
        if tick.output.mode == Mode::Driving {
            ticks += 1;
            tick.output.proved |= ticks == 40;
        }
    })
}

/// A board that holds the ESC's supply for good.
pub(super) struct Power;

impl Tamper for Power {
    fn power(&mut self, on: &mut bool) {
        *on = true;
    }
}

/// A host without its watches.
pub(super) fn unwatched(config: &mut Config) {
    config.supervisor.prove_first_metre = false;
    let watch = &mut config.watch;
    watch.speed_margin_m_s = 2.0;
    watch.speed_ratio = 0.9;
    watch.max_tilt_rad = 1.5;
    watch.max_tilt_difference_rad = 1.5;
    watch.max_sideslip_rad = 1.5;
    watch.max_acceleration_bias_m_s2 = 50.0;
    watch.max_innovation = 1e6;
    watch.max_gyro_bias_rad_s = 1.0;
}

/// A pilot that arms again after whatever ended a drive.
pub(super) fn arms_at_once() -> impl Tamper {
    Ticks(|tick: &mut TickRecord| {
        if tick
            .events
            .contains(&Event::Request(PilotRequest::Arm(Arming::Unattended)))
            && tick.output.mode == Mode::Idle
        {
            tick.output.mode = Mode::Arming;
        }
    })
}

/// A pilot whose fault lasts for half a second.
pub(super) fn forgets() -> impl Tamper {
    let mut ticks = 0;
    Ticks(move |tick: &mut TickRecord| {
        if tick.output.mode == Mode::Fault {
            ticks += 1;
            if ticks > 50 {
                tick.output.mode = Mode::Idle;
            }
        }
    })
}

/// A board that is never silent.
pub(super) struct NeutralForSilence;

impl Tamper for NeutralForSilence {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        if pulse.esc_us == 0 && !pulse.cut {
            pulse.esc_us = NEUTRAL_US;
        }
    }
}

/// A line that repeats the last command with a younger age.
#[derive(Default)]
pub(super) struct Repeats {
    last: Option<(u64, Drive)>,
    loses_disarm: bool,
}

impl Repeats {
    /// ... and loses requests to stop.
    pub(super) fn without_disarm() -> Self {
        Self {
            loses_disarm: true,
            ..Self::default()
        }
    }
}

impl Tamper for Repeats {
    fn to_board(&mut self, now_us: u64, bytes: &mut Vec<u8>) {
        let mut kept = Vec::new();
        for (frame, message) in frames(bytes) {
            match message {
                Some(ToBoard::Disarm(_) | ToBoard::EmergencyStop(_)) if self.loses_disarm => {
                    continue;
                }
                Some(ToBoard::Drive(drive)) => {
                    // The command to stand is lost too.
                    let stands = self.loses_disarm && drive.speed_mm_s < 300;
                    if stands && self.last.is_some() {
                        continue;
                    }
                    if !stands {
                        self.last = Some((now_us, drive));
                    }
                }
                _ => {}
            }
            kept.extend_from_slice(frame);
        }
        *bytes = kept;
        if let Some((then_us, drive)) = &mut self.last
            && now_us >= *then_us + 20_000
        {
            drive.telemetry_time_us = drive.telemetry_time_us.wrapping_add(20_000);
            drive.sequence = drive.sequence.next();
            drive.pose_age_ms = 5;
            *then_us = now_us;
            bytes.extend(ToBoard::from(*drive).encode().as_bytes());
        }
    }
}

/// A line that loses emergency stop requests.
pub(super) struct LosesStops;

impl Tamper for LosesStops {
    fn to_board(&mut self, _: u64, bytes: &mut Vec<u8>) {
        *bytes = frames(bytes)
            .filter(|(_, message)| !matches!(message, Some(ToBoard::EmergencyStop(_))))
            .flat_map(|(frame, _)| frame.to_vec())
            .collect();
    }
}

/// A host that goes on writing its last command.
#[derive(Default)]
pub(super) struct WritesOn {
    last: Option<(u64, Drive)>,
}

impl Tamper for WritesOn {
    fn written(&mut self, now_us: u64, bytes: &mut Vec<u8>) {
        for (_, message) in frames(bytes) {
            if let Some(ToBoard::Drive(drive)) = message {
                self.last = Some((now_us, drive));
            }
        }
        if let Some((then_us, drive)) = &mut self.last
            && now_us >= *then_us + 10_000
        {
            *then_us = now_us;
            bytes.extend(ToBoard::from(*drive).encode().as_bytes());
        }
    }
}
