//! Planted bugs: at least one for every invariant, in the board, the host, the line or the
//! allowance of an invariant.
//!
//! A bug of the board changes the pulses on the pins, and the car obeys them. A bug of the
//! host changes what it writes, its configuration, or its ticks as the invariants see them.
//! A bug of the allowance changes the configuration by which the invariants judge.

use std::{
    collections::VecDeque,
    sync::atomic::{AtomicU64, Ordering},
    thread,
};

use singletrack_control::Time;
use singletrack_core::config::Config;
use singletrack_pilot::{Event, Mode, PilotRequest, Reason};
use singletrack_protocol::{Decoder, Drive, ToBoard};
use singletrack_record::TickRecord;
use singletrack_sim::{BoardKind, PulseRecord};

use crate::{
    SetupError, Until, Violation,
    campaign::attempt_until,
    schedule::{Schedule, ScheduleError},
    tamper::Tamper,
};

/// Where a bug is planted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The board's pins.
    Board,
    /// The host.
    Host,
    /// The serial line.
    Line,
    /// What the invariants allow.
    Allowance,
}

impl Part {
    /// Its name in the table.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Board => "board",
            Self::Host => "host",
            Self::Line => "line",
            Self::Allowance => "allowance",
        }
    }
}

/// A planted bug.
#[derive(Clone, Copy, Debug)]
pub struct Bug {
    /// What is wrong.
    pub name: &'static str,
    /// Where.
    pub part: Part,
    /// The invariant that must find it.
    pub invariant: &'static str,
    /// Entries of a schedule in which it is found.
    pub example: &'static str,
    make: fn(&Schedule) -> Box<dyn Tamper>,
}

impl Bug {
    /// The bug, for a drive by this schedule.
    #[must_use]
    pub fn plant(&self, schedule: &Schedule) -> Box<dyn Tamper> {
        (self.make)(schedule)
    }

    /// The schedule of [`Bug::example`].
    ///
    /// # Errors
    ///
    /// It does not parse.
    pub fn schedule(&self) -> Result<Schedule, ScheduleError> {
        format!("seed 5; end_ms 9000; ask arm at 3200; {}", self.example).parse()
    }

    /// Whether its invariant finds it, and the first violation of any.
    ///
    /// # Errors
    ///
    /// The schedule can't be set up.
    pub fn is_found(&self, schedule: &Schedule) -> Result<(bool, Option<Violation>), SetupError> {
        let outcome = attempt_until(schedule, &mut *self.plant(schedule), Until::End)?;
        Ok((outcome.violated.contains(self.invariant), outcome.violation))
    }
}

/// In how many of `count` random schedules from `first_seed` on each bug is found; calls
/// `progress` after each.
///
/// # Errors
///
/// A schedule can't be set up.
pub fn count(
    first_seed: u64,
    count: u64,
    threads: usize,
    progress: &(impl Fn() + Sync),
) -> Result<Vec<(&'static Bug, u64)>, SetupError> {
    let next = AtomicU64::new(0);
    let found: Vec<_> = BUGS.iter().map(|_| AtomicU64::new(0)).collect();
    let run = || -> Result<(), SetupError> {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                return Ok(());
            }
            let seed = first_seed.wrapping_add(number);
            let schedule = Schedule::generate(seed, BoardKind::Native);
            for (bug, found) in BUGS.iter().zip(&found) {
                let (is_found, _) = bug.is_found(&schedule)?;
                found.fetch_add(is_found.into(), Ordering::Relaxed);
                progress();
            }
        }
    };
    thread::scope(|scope| {
        let threads: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(run)).collect();
        threads.into_iter().try_for_each(|thread| {
            thread.join().unwrap_or_else(|_| {
                Err(SetupError::Other {
                    part: "a planted bug",
                    reason: "it panicked".to_owned(),
                })
            })
        })
    })?;
    let found = found.iter().map(|found| found.load(Ordering::Relaxed));
    Ok(BUGS.iter().zip(found).collect())
}

macro_rules! bugs {
    ($($part:ident $name:literal, $invariant:literal, $example:literal, $make:expr;)*) => {
        /// All planted bugs.
        pub const BUGS: &[Bug] = &[$(Bug {
            name: $name,
            part: Part::$part,
            invariant: $invariant,
            example: $example,
            make: |schedule| Box::new(($make)(schedule)),
        },)*];
    };
}

bugs! {
    Board "drives with 200 µs more", "pulse-limits", "", |_| driving(|pulse| pulse.esc_us += 200);
    Board "drives in reverse", "pulse-limits", "", |_| driving(|pulse| pulse.esc_us = 1_400);
    Board "steers at once", "servo-slew", "", |_| steering_by_turns();
    Board "gives full throttle at once", "esc-slew", "", |_| driving(|pulse| pulse.esc_us = 1_700);
    Board "creeps while the ESC arms", "neutral-first", "", |_| creeping(500_000);
    Board "creeps before it is armed", "unarmed-drive", "", |_| creeping(2_500_000);
    Board "drives 60 ms too long", "command-age",
        "fault daemon-paused at 6000 for 900 severity 500", |_| prolonged(60_000);
    Board "drives on while its main loop hangs", "main-loop",
        "fault board-hang at 6000 for 0 severity 1", |_| prolonged(60_000);
    Board "drives on after an open stop switch", "unarmed-drive",
        "stop_input true; fault stop-input-open at 6000 for 900 severity 1", |_| prolonged(81_000);
    Board "drives on after an emergency stop", "latched-stop", "ask stop at 6000",
        |_| prolonged(61_000);
    Board "drives on without motor pulses", "motor-pulses",
        "fault pulses-gone at 6000 for 900 severity 1", |_| prolonged(800_000);
    Board "creeps after a stop", "stands",
        "esc_kind forward-reverse; ask disarm at 6000", |_| creeping_after_a_stop();
    Board "holds its last pulse for a second after a stop", "stands",
        "speed_mm_s 1000; fault daemon-paused at 6000 for 2500 severity 500",
        |_| prolonged(1_000_000);
    Board "never releases the brake", "brake-pulse",
        "brake true; speed_mm_s 1200; fault daemon-paused at 6000 for 2500 severity 500",
        |_| NeverReleases::default();
    Board "never releases the brake, which is reverse", "backward",
        "brake true; truth esc-kind forward-reverse; fault daemon-paused at 6000 for 2500 severity 500",
        |_| NeverReleases::default();
    Board "brakes on an ESC without a brake", "brake-pulse",
        "esc_kind forward-reverse; ask disarm at 6000", |_| Brakes::after_driving(0, 20);
    Board "brakes again after standing", "brake-pulse", "brake true; ask disarm at 6000",
        |_| Brakes::after_driving(100, 15);
    Board "brakes without a drive before", "brake-pulse", "", |_| Brakes::at_once();
    Board "gives neutral instead of silence after an emergency stop", "silent-stop",
        "ask stop at 6000", |_| NeutralForSilence;
    Board "takes a pulse that drives for neutral", "unarmed-motion", "end_ms 16000",
        |_| drives_at_neutral();
    Line "repeats the last command as a new one", "host-silence",
        "fault daemon-killed at 6000 for 1500 severity 1", |_| Repeats::default();
    Line "repeats the last command and loses requests to stop", "pose-age",
        "fault camera-silent at 5000 for 3000 severity 1000", |_| Repeats::without_disarm();
    Line "loses emergency stops", "emergency-stop", "ask stop at 6000", |_| LosesStops;
    Line "repeats the last command after a disarm", "disarm", "ask disarm at 5000",
        |_| Repeats::without_disarm();
    Host "starts by itself", "unasked-drive", "", |_| Ticks(|tick: &mut TickRecord| {
        if tick.index > 280 && tick.output.mode == Mode::Ready {
            tick.output.mode = Mode::Arming;
        }
    });
    Host "does not obey a disarm", "unasked-drive", "ask disarm at 6500", |_| drives_on();
    Host "drives on without poses", "host-hold",
        "fault camera-silent at 6500 for 900 severity 1000", |_| drives_on();
    Host "drives on without an IMU", "imu-silence", "fault imu-silent at 6500 for 900 severity 1",
        |_| drives_on();
    Host "drives on with a stuck IMU", "imu-stuck", "fault imu-stuck at 6500 for 900 severity 1",
        |_| drives_on();
    Host "drives on by old set-points", "setpoint-silence",
        "reference external; fault setpoints-gone at 6500 for 900 severity 1", |_| drives_on();
    Host "commands 100 m/s", "command-limits", "", |_| Commands(|drive: &mut Drive| {
        drive.speed_mm_s = i16::MAX;
    });
    Host "commands a jump of the steering", "command-rate", "", |_| commanding(|tick| {
        if tick.index.is_multiple_of(50) {
            tick.output.actuation.steering += 0.1;
        }
    });
    Host "gives no reason", "mode-and-reason", "",
        |_| commanding(|tick| tick.output.mode = Mode::Stopping);
    Host "computes NaN", "finite", "", |_| commanding(|tick| {
        tick.output.drive_time = Some(f64::NAN);
    });
    Host "writes to a silent board", "no-queue", "fault board-off at 6000 for 1000 severity 1",
        |_| WritesOn::default();
    Host "takes over a configuration during a drive", "reconfigured-underway", "", |_| {
        commanding(|tick| {
            if tick.index.is_multiple_of(50) {
                let _ = tick.events.push(Event::Reconfigured(2));
            }
        })
    };
    Host "ticks off its grid", "tick-grid", "", |_| commanding(|tick| {
        if tick.index > 650 {
            tick.scheduled_ns -= 60_000;
        }
    });
    Host "does not follow the cameras", "camera-alignment", "end_ms 14000", |_| commanding(|tick| {
        let start = tick.start_ns;
        for event in &mut tick.events {
            if let Event::Pose(pose) = event {
                pose.receive = Time(start - 100_000);
            }
        }
    });
    Host "records another output", "replayed", "", |_| Records(|tick: &mut TickRecord| {
        if tick.index == 700
            && let Some(estimate) = &mut tick.output.estimate
        {
            estimate.yaw = f64::from_bits(estimate.yaw.to_bits() ^ 1);
        }
    });
    Host "follows a false estimate", "estimate", "", |_| wandering();
    Host "assumes that it brakes ten times as well", "fence",
        "esc_kind forward-reverse; reference steps; speed_mm_s 1500; fence_mm -2200",
        |_| Host(|config: &mut Config| {
            config.fence.braking_m_s2 *= 10.0;
            config.control.stop_deceleration_m_s2 *= 10.0;
        });
    Host "has another fence", "fence", "reference steps; speed_mm_s 1000; fence_mm -1000",
        |_| Host(|config: &mut Config| {
            for [x, y] in &mut config.fence.corners_m {
                *x *= 3.0;
                *y *= 3.0;
            }
        });
    Host "declares no fault", "stop-not-obeyed",
        "fault esc-stuck at 6000 for 1 severity 1; ask disarm at 6100",
        |_| Ticks(|tick: &mut TickRecord| {
            if tick.output.mode == Mode::Fault {
                tick.output.mode = Mode::Idle;
            }
        });
    Board "holds the kill output", "kill-output", "kill_output true; ask disarm at 8000",
        |_| Power;
    Host "does not prove its configuration", "proving-speed", "proved false",
        |_| Host(|config: &mut Config| config.supervisor.prove_first_metre = false);
    Host "neither proves nor watches", "steering-sign",
        "proved false; truth servo-gain-permille -2000; fence_mm 4000", |_| Host(unwatched);
    Host "turns the gyroscope's sign", "gyro-sign", "", |_| commanding(|tick| {
        for event in &mut tick.events {
            if let Event::Board(sample) = event
                && let Some(inertial) = &mut sample.inertial
            {
                inertial.yaw_rate = -inertial.yaw_rate;
            }
        }
    });
    Host "arms after a contradiction", "acknowledged",
        "proved false; truth servo-gain-permille -2000; ask arm at 8000", |_| arms_at_once();
    Host "forgets a stop that was not obeyed", "fault-clears",
        "fault esc-stuck at 6000 for 1 severity 1; ask disarm at 6100", |_| forgets();
    Host "takes a calibrated car for a wrong one", "false-alarm", "", |_| commanding(|tick| {
        if tick.index.is_multiple_of(50) {
            tick.output.reason = Some(Reason::SteeringDiffers);
        }
    });
    Allowance "a configuration taken over by halves", "command-rate",
        "ask reload at 2000; ask disarm at 6000",
        |_| Configurations(|number: u32, config: &mut Config| {
            if number == 2 {
                config.limits.max_acceleration_m_s2 *= 0.9;
                config.control.stop_deceleration_m_s2 *= 0.9;
            }
        });
    Allowance "a configuration that the board did not get", "armed-configuration",
        "ask reload at 2000; ask disarm at 6000",
        |_| Configurations(|number: u32, config: &mut Config| {
            if number == 2 {
                config.board.speed.max_forward_mm_s += 1;
            }
        });
    Allowance "a fence half a metre smaller", "fence",
        "reference steps; speed_mm_s 800; fence_mm -500",
        |_| Configurations(|_: u32, config: &mut Config| {
            for corner in config.fence.corners_m.iter_mut().flatten() {
                *corner -= corner.signum() * 0.5;
            }
        });
    Allowance "three times the braking", "weak-brakes",
        "esc_kind forward-reverse; speed_mm_s 1000; end_ms 12000; ask disarm at 6000; ask arm at 9000",
        |_| Configurations(|_: u32, config: &mut Config| config.fence.braking_m_s2 *= 3.0);
}

/// Changes pulses.
struct Pulses<F>(F);

impl<F: FnMut(&mut PulseRecord)> Tamper for Pulses<F> {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        (self.0)(pulse);
    }
}

/// Stands in for a faulty pilot.
struct Ticks<F>(F);

impl<F: FnMut(&mut TickRecord)> Tamper for Ticks<F> {
    fn tick(&mut self, tick: &mut TickRecord) {
        (self.0)(tick);
    }

    fn is_replayed(&self) -> bool {
        false
    }
}

/// Changes the record of ticks.
struct Records<F>(F);

impl<F: FnMut(&mut TickRecord)> Tamper for Records<F> {
    fn tick(&mut self, tick: &mut TickRecord) {
        (self.0)(tick);
    }
}

/// A host that takes over another configuration than the one it was given.
struct Configurations<F>(F);

impl<F: FnMut(u32, &mut Config)> Tamper for Configurations<F> {
    fn configuration(&mut self, number: u32, config: &mut Config) {
        (self.0)(number, config);
    }

    fn is_replayed(&self) -> bool {
        false
    }
}

/// A host that runs with other values than its configuration's.
struct Host<F>(F);

impl<F: FnMut(&mut Config)> Tamper for Host<F> {
    fn host(&mut self, config: &mut Config) {
        (self.0)(config);
    }

    fn is_replayed(&self) -> bool {
        false
    }
}

/// A host that writes other commands.
struct Commands<F>(F);

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
const NEUTRAL_US: u16 = 1_500;
const BRAKE_US: u16 = 1_350;
const DEADBAND_US: u16 = 30;

/// Changes the pulses that drive, from 6 s on.
fn driving(mut change: impl FnMut(&mut PulseRecord)) -> impl Tamper {
    Pulses(move |pulse: &mut PulseRecord| {
        if pulse.time_us > 6_000_000 && pulse.esc_us > NEUTRAL_US {
            change(pulse);
        }
    })
}

/// Changes the ticks that command.
fn commanding(mut change: impl FnMut(&mut TickRecord)) -> impl Tamper {
    Ticks(move |tick: &mut TickRecord| {
        if tick.index > 600 && tick.output.mode.commands() {
            change(tick);
        }
    })
}

/// A pilot that follows its reference whatever happens.
fn drives_on() -> impl Tamper {
    commanding(|tick| {
        tick.output.mode = Mode::Driving;
        tick.output.reason = None;
    })
}

/// A pilot whose estimate leaves the car.
fn wandering() -> impl Tamper {
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
fn steering_by_turns() -> impl Tamper {
    let mut left = false;
    driving(move |pulse| {
        left = !left;
        pulse.servo_us = if left { 1_900 } else { 1_100 };
    })
}

/// A board that drives slowly from a time on, without a command.
fn creeping(from_us: u64) -> impl Tamper {
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
fn creeping_after_a_stop() -> impl Tamper {
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
fn drives_at_neutral() -> impl Tamper {
    Pulses(|pulse: &mut PulseRecord| {
        if pulse.time_us > 3_000_000 && (pulse.esc_us == 0 || pulse.esc_us == NEUTRAL_US) {
            pulse.esc_us = NEUTRAL_US + DEADBAND_US + 20;
        }
    })
}

/// A board that brakes until it drives again.
#[derive(Default)]
struct NeverReleases {
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
struct Brakes {
    driven: bool,
    /// Frames until it brakes.
    wait: u32,
    frames: u32,
    left: VecDeque<u16>,
}

impl Brakes {
    /// Brakes for some frames, `wait` frames after a drive.
    fn after_driving(wait: u32, frames: u32) -> Self {
        Self {
            driven: false,
            wait,
            frames,
            left: VecDeque::new(),
        }
    }

    /// Brakes for ten frames after three seconds.
    fn at_once() -> Self {
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

/// A board that holds the ESC's supply for good.
struct Power;

impl Tamper for Power {
    fn power(&mut self, on: &mut bool) {
        *on = true;
    }
}

/// A host without its watches.
fn unwatched(config: &mut Config) {
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
fn arms_at_once() -> impl Tamper {
    Ticks(|tick: &mut TickRecord| {
        if tick.events.contains(&Event::Request(PilotRequest::Arm))
            && tick.output.mode == Mode::Idle
        {
            tick.output.mode = Mode::Arming;
        }
    })
}

/// A pilot whose fault lasts for half a second.
fn forgets() -> impl Tamper {
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
struct NeutralForSilence;

impl Tamper for NeutralForSilence {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        if pulse.esc_us == 0 && !pulse.cut {
            pulse.esc_us = NEUTRAL_US;
        }
    }
}

/// A line that repeats the last command with a younger age.
#[derive(Default)]
struct Repeats {
    last: Option<(u64, Drive)>,
    loses_disarm: bool,
}

impl Repeats {
    /// ... and loses requests to stop.
    fn without_disarm() -> Self {
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
struct LosesStops;

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
struct WritesOn {
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
