//! Planted bugs: at least one for every invariant, in the board, the host, the line or the
//! allowance of an invariant.
//!
//! A bug of the board changes the pulses on the pins, and the car obeys them. A bug of the
//! host changes what it writes, its configuration, or its ticks as the invariants see them.
//! A bug of the allowance changes the configuration by which the invariants judge.

mod tampers;

use serde::{Deserialize, Serialize};
use singletrack_campaign::Experiment;
use singletrack_control::Time;
use singletrack_core::config::Config;
use singletrack_pilot::{Event, Learned, Mode, PilotRequest, Reason};
use singletrack_protocol::Drive;
use singletrack_record::TickRecord;
use singletrack_sim::{BoardKind, PulseRecord};

use crate::{
    SetupError, Until, Violation,
    campaign::attempt_until,
    schedule::{Schedule, ScheduleError},
    tamper::Tamper,
};

pub use tampers::prolonged;
use tampers::{
    Brakes, Commands, Configurations, DrivesWhileArming, Host, LateSilence, Learns, LosesStops,
    NEUTRAL_US, NeutralForSilence, NeutralThatDrives, NeverReleases, Power, Pulses, Records,
    Repeats, Ticks, WritesOn, arms_at_once, commanding, creeping, creeping_after_a_stop,
    drives_at_neutral, drives_on, driving, forgets, proves_early, steering_by_turns, unwatched,
    wandering,
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

/// Every bug, planted in every schedule of a range of seeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantedCampaign {
    /// First seed; the others follow consecutively.
    pub first_seed: u64,
    /// Number of seeds.
    pub count: u64,
}

impl Experiment for PlantedCampaign {
    const NAME: &'static str = "faults-planted";
    /// The names of the bugs that were found.
    type Result = Vec<String>;

    fn units(&self) -> u64 {
        self.count
    }

    fn run(&self, unit: u64) -> singletrack_campaign::Result<Vec<String>> {
        let seed = self.first_seed.wrapping_add(unit);
        let schedule = Schedule::generate(seed, BoardKind::Native);
        let mut found = Vec::new();
        for bug in BUGS {
            if bug.is_found(&schedule)?.0 {
                found.push(bug.name.to_owned());
            }
        }
        Ok(found)
    }
}

/// In how many of these schedules each bug was found.
pub fn count(results: &[(u64, Vec<String>)]) -> Vec<(&'static Bug, usize)> {
    let found = |bug: &Bug| {
        let schedules = results.iter();
        let with_bug = schedules.filter(|(_, names)| names.iter().any(|name| name == bug.name));
        with_bug.count()
    };
    BUGS.iter().map(|bug| (bug, found(bug))).collect()
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
    Board "gives neutral for longer after an emergency stop", "silent-stop", "ask stop at 6000",
        |_| LateSilence::default();
    Board "gives neutral after it has found that the car runs at neutral", "silent-stop",
        "neutral_us 1550; end_ms 16000; fault daemon-killed at 1 for 2200 severity 1",
        |_| LateSilence::default();
    Board "gives the configured neutral after an emergency stop", "silent-stop",
        "neutral_us 1450; truth esc-neutral-us -50; ask stop at 6000", |_| Pulses(|pulse: &mut PulseRecord| {
            if pulse.time_us > 6_000_000 && pulse.esc_us == NEUTRAL_US {
                pulse.esc_us = 1_450;
            }
        });
    Board "brakes after a single frame of driving", "brake-pulse", "brake true",
        |_| Brakes::after_one_frame();
    Board "gives 1500 µs for its neutral after a drive, and does not watch", "stands",
        "neutral_us 1440; truth esc-neutral-us -60; end_ms 14000; ask disarm at 6000",
        |_| NeutralThatDrives::default();
    Board "gives 1500 µs for its neutral outside of the fence, and does not watch", "fence",
        "neutral_us 1440; truth esc-neutral-us -60; end_ms 16000; reference steps; \
         fence_mm -200; speed_mm_s 800; ask arm at 5000", |_| NeutralThatDrives::default();
    Board "drives while it arms, and hears no disarm", "arming-motion", "kill_output true",
        |_| DrivesWhileArming;
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
    Host "drives before the start", "waits-still", "waits true", |_| Ticks(|tick: &mut TickRecord| {
        if let Some(command) = tick.output.command.as_mut().filter(|it| it.rear_speed == 0.0) {
            command.rear_speed = 0.1;
        }
    });
    Host "does not obey a disarm", "unasked-drive", "ask disarm at 6500", |_| drives_on();
    Host "renews a drive whose operator hangs", "dead-man",
        "attended true; fault operator-hangs at 6000 for 2000 severity 1", |_| drives_on();
    Line "repeats the last command of an operator who hangs", "dead-man",
        "attended true; fault operator-hangs at 6000 for 2000 severity 1",
        |_| Repeats::without_disarm();
    Host "does not obey an operator who is gone", "unasked-drive", "attended true; ask gone at 6500",
        |_| drives_on();
    Host "loses the end of the time among many requests", "unasked-drive",
        "attended true; tuning true; fault request-flood at 5000 for 3000 severity 500; \
         ask time-up at 6500",
        |_| commanding(|tick| {
            tick.output.mode = Mode::Driving;
            tick.events.retain(|event| *event != Event::Request(PilotRequest::TimeUp));
        });
    Host "slows down along a ramp when it is to halt", "unasked-drive",
        "attended true; ask halt at 6500", |_| Ticks(|tick: &mut TickRecord| {
            if tick.events.contains(&Event::Request(PilotRequest::Halt)) {
                tick.output.mode = Mode::Stopping;
            }
        });
    Line "repeats the last command after a halt", "at-once", "attended true; ask halt at 6000",
        |_| Repeats::without_disarm();
    Board "jogs on after the operator has let go", "at-once",
        "ask jog-on at 3200; ask gone at 6000", |_| prolonged(100_000);
    Board "jogs on while the operator hangs", "dead-man",
        "ask lift at 3200; ask jog-on at 4500; fault operator-hangs at 6500 for 2000 severity 1",
        |_| prolonged(400_000);
    Host "jogs on after the time is over", "unasked-drive",
        "ask lift at 3200; ask jog at 4500; ask time-up at 6500", |_| Ticks(|tick: &mut TickRecord| {
            if tick.index > 640 {
                tick.output.mode = Mode::Jogging;
            }
        });
    Board "jogs with more than it may", "jog-limits", "ask lift at 3200; ask jog-on at 4500",
        |_| driving(|pulse| pulse.esc_us = 1_655);
    Board "jogs for longer than it may", "jog-limits",
        "end_ms 17000; ask disarm at 3210; ask lift at 3300; ask jog-on at 4500",
        |_| Pulses(|pulse: &mut PulseRecord| {
            if (14_000_000..16_000_000).contains(&pulse.time_us) {
                pulse.esc_us = pulse.esc_us.max(1_550);
            }
        });
    Board "jogs on above its speed", "jog-limits",
        "truth motor-gain-permille 500; ask disarm at 3210; ask jog-on at 3500",
        |_| Pulses(|pulse: &mut PulseRecord| {
            if (6_000_000..8_000_000).contains(&pulse.time_us) {
                pulse.esc_us = 1_645;
            }
        });
    Host "drives on without poses", "host-hold",
        "fault camera-silent at 6500 for 900 severity 1000", |_| drives_on();
    Host "drives on by poses that are too rare to be compared", "compared",
        "fault camera-rare at 5000 for 4000 severity 550", |_| Ticks(|tick: &mut TickRecord| {
            if tick.index > 600 {
                tick.output.mode = Mode::Driving;
            }
        });
    Host "loses a disarm among many requests", "unasked-drive",
        "tuning true; fault request-flood at 5000 for 3000 severity 500; ask disarm at 6500",
        |_| commanding(|tick| {
            tick.output.mode = Mode::Driving;
            tick.events.retain(|event| *event != Event::Request(PilotRequest::Disarm));
        });
    Host "drives on without an IMU", "imu-silence", "fault imu-silent at 6500 for 900 severity 1",
        |_| drives_on();
    Host "drives on with a stuck IMU", "imu-stuck", "fault imu-stuck at 6500 for 900 severity 1",
        |_| drives_on();
    Host "drives on by old set-points", "setpoint-silence",
        "reference external; fault setpoints-gone at 6500 for 900 severity 1", |_| drives_on();
    Host "drives on by set-points from the future", "setpoint-silence",
        "reference external; fault setpoints-future at 6500 for 900 severity 1", |_| drives_on();
    Host "drives on by set-points that come late", "setpoint-silence",
        "reference external; fault setpoints-old at 6500 for 900 severity 400", |_| drives_on();
    Host "follows a program out of the geofence", "fence",
        "reference external; fence_mm 100; end_ms 12000; \
         fault setpoints-outward at 6500 for 5000 severity 1000",
        |_| Host(|config: &mut Config| {
            for corner in config.fence.corners_m.iter_mut().flatten() {
                *corner *= 3.0;
            }
        });
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
    Host "learns the wrong sign", "learned", "live true", |_| Learns(|_, learned: &mut Learned| {
        learned.steering_gain = -learned.steering_gain;
    });
    Host "learns beyond its bounds", "learned", "live true", |_| Learns(|_, learned: &mut Learned| {
        learned.body_yaw *= 4.0;
    });
    Host "learns from a stuck servo", "learned",
        "live true; end_ms 12000; fault servo-stuck at 6000 for 1 severity 1",
        |_| Learns(|index: u64, learned: &mut Learned| {
            learned.steering_trim += 1e-6 * index.saturating_sub(850) as f64;
        });
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
                pose.receive = Time(start - 1_200_000);
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
    Host "assumes that it stops at once", "fence",
        "esc_kind forward-reverse; reference steps; speed_mm_s 1500; fence_mm -2200",
        |_| Host(|config: &mut Config| {
            config.fence.braking_m_s2 = 50.0;
            config.control.stop_deceleration_m_s2 = 50.0;
        });
    Host "has another fence", "fence", "reference steps; speed_mm_s 1000; fence_mm -1000",
        |_| Host(|config: &mut Config| {
            for [x, y] in &mut config.fence.corners_m {
                *x *= 3.0;
                *y *= 3.0;
            }
        });
    Host "has a safety filter that passes everything, and no geofence", "filter",
        "reference external; safety_filter true; fault loop-at-fence at 4000 for 5000 severity 1000",
        |_| Host(|config: &mut Config| {
            config.safety_filter.enabled = false;
            for corner in config.fence.corners_m.iter_mut().flatten() {
                *corner *= 3.0;
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
    Host "proves its configuration after 0.1 m", "false-proof", "proved false",
        |_| proves_early();
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
