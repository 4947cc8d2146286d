//! Invariants under random bytes, inputs and poll times.

use proptest::{prelude::*, test_runner::FileFailurePersistence};
use singletrack_board::{ImuSample, Outputs};
use singletrack_protocol::{
    Arm, BoardMode, Configuration, Configure, Disarm, Drive, EmergencyStop, EscCalibration,
    EscKind, FailsafeAction, Hello, ImuAxes, JOG_DRIVE_US, JOG_LIMIT_US, Jog, LONGEST_ROLL_OUT_MS,
    Sequence, ServoCalibration, SpeedLoop, UNNAMED, VERSION,
};

use crate::{MS, NEUTRAL, Rig, TTL, configuration};

#[derive(Clone, Debug)]
enum Step {
    Wait {
        polls: u32,
        poll_us: u32,
    },
    /// Time without a poll: what the next step sends arrives after it.
    Late(u32),
    Garbage(Vec<u8>),
    Greet {
        nonce: u32,
        version: u16,
    },
    Configure(Configuration),
    Arm {
        age_us: u32,
        right_hash: bool,
        again: bool,
    },
    Disarm,
    EmergencyStop,
    Drive {
        ahead: u8,
        age_us: u32,
        speed_mm_s: i16,
        steering_100urad: i16,
        pose_age_ms: u16,
        brake: bool,
    },
    /// A correct host for a while.
    DriveWell {
        commands: u32,
        speed_mm_s: i16,
        steering_100urad: i16,
    },
    Jog {
        ahead: u8,
        age_us: u32,
        servo_us: u16,
        esc_us: u16,
    },
    /// A correct host for a while.
    JogWell {
        commands: u32,
        servo_us: u16,
        esc_us: u16,
    },
    Wheels(Option<u32>),
    Motor {
        count: u16,
        last_edge_us: u32,
    },
    StopInput(bool),
    Imu {
        age_us: u32,
    },
    Line(bool),
}

fn age() -> impl Strategy<Value = u32> {
    prop_oneof![
        4 => Just(0),
        4 => 0..20 * MS,
        1 => TTL - 2..TTL + 3,
        1 => Just(u32::MAX),
        1 => any::<u32>(),
    ]
}

proptest! {
    /// Otherwise the tests would cover only refusals.
    #[test]
    fn the_generated_configurations_are_valid(configuration in any_configuration()) {
        prop_assert_eq!(configuration.validate(), Ok(()));
    }
}

fn any_configuration() -> impl Strategy<Value = Configuration> {
    let servo = (
        900..1_400_u16,
        1_600..2_100_u16,
        prop_oneof![-3_000..-50_i16, 50..3_000_i16],
        1..400_u16,
    );
    let esc = (
        -1_000..=1_000_i32,
        0..60_u16,
        900..1_300_u16,
        1_700..2_100_u16,
        1..1_400_u16,
        1_300..1_382_u16,
    );
    let speed = (
        100..20_000_u16,
        0..5_000_u16,
        0..5_000_u16,
        0..5_000_u16,
        0..700_u16,
    );
    let limits = (
        1..20_000_u16,
        prop_oneof![Just(0), 1..2_000_u16],
        1..=1_000_u16,
        any::<bool>(),
        any::<bool>(),
    );
    let rest = (prop::sample::select(EscKind::ALL.to_vec()), any::<bool>());
    (servo, esc, speed, limits, rest).prop_map(|(servo, esc, speed, limits, rest)| Configuration {
        servo: ServoCalibration {
            min_us: servo.0,
            max_us: servo.1,
            centre_us: 1_500,
            gain_us_per_rad: servo.2,
            slew_us_per_20ms: servo.3,
        },
        esc: EscCalibration {
            kind: rest.0,
            // The start pulse must lie in the deadband, or the board refuses it.
            neutral_us: (1_500 + i32::from(esc.1) * esc.0 / 1_000) as u16,
            deadband_us: esc.1,
            min_us: esc.2,
            max_us: esc.3,
            slew_us_per_20ms: esc.4,
            brake_us: esc.5,
        },
        speed: SpeedLoop {
            pulse_distance_um: speed.0,
            feed_forward_us_per_m_s: speed.1,
            proportional_us_per_m_s: speed.2,
            integral_us_per_m: speed.3,
            integral_limit_us: speed.4,
            // At most 12 pulses a millisecond.
            max_forward_mm_s: limits.0.min(speed.0.saturating_mul(12)),
            max_reverse_mm_s: match rest.0 {
                EscKind::Vesc => 0,
                EscKind::Car | EscKind::ForwardReverse => limits.1.min(speed.0.saturating_mul(12)),
            },
        },
        failsafe: if limits.3 && rest.0.has_brake() {
            FailsafeAction::Brake
        } else {
            FailsafeAction::Coast
        },
        max_pose_age_ms: limits.2,
        stop_input: limits.4,
        kill_output: rest.1,
        max_roll_out_ms: LONGEST_ROLL_OUT_MS,
        car_id: UNNAMED,
        imu_axes: ImuAxes::AS_PRINTED,
    })
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        8 => (1..60_u32, prop_oneof![8 => Just(MS), 1 => 1..300_u32, 1 => MS..200 * MS])
            .prop_map(|(polls, poll_us)| Step::Wait { polls, poll_us }),
        2 => Just(Step::Wait { polls: 2_200, poll_us: MS }),
        3 => prop_oneof![1..MS, MS..200 * MS].prop_map(Step::Late),
        2 => proptest::collection::vec(any::<u8>(), 0..100).prop_map(Step::Garbage),
        1 => (0..3_u32, prop_oneof![9 => Just(VERSION), 1 => any::<u16>()])
            .prop_map(|(nonce, version)| Step::Greet { nonce, version }),
        3 => any_configuration().prop_map(Step::Configure),
        1 => Just(Step::Configure(Configuration { max_pose_age_ms: 0, ..configuration() })),
        8 => (age(), any::<bool>(), any::<bool>())
            .prop_map(|(age_us, right, again)| Step::Arm { age_us, right_hash: right || again, again }),
        1 => Just(Step::Disarm),
        1 => prop_oneof![9 => Just(Step::Disarm), 1 => Just(Step::EmergencyStop)],
        6 => (0..130_u8, age(), any::<i16>(), any::<i16>(), 0..1_100_u16, any::<bool>()).prop_map(
            |(ahead, age_us, speed_mm_s, steering_100urad, pose_age_ms, brake)| Step::Drive {
                ahead, age_us, speed_mm_s, steering_100urad, pose_age_ms, brake,
            }
        ),
        8 => (1..100_u32, -3_000..6_000_i16, any::<i16>()).prop_map(
            |(commands, speed_mm_s, steering_100urad)| Step::DriveWell {
                commands, speed_mm_s, steering_100urad,
            }
        ),
        3 => (0..130_u8, age(), any::<u16>(), any::<u16>()).prop_map(
            |(ahead, age_us, servo_us, esc_us)| Step::Jog { ahead, age_us, servo_us, esc_us }
        ),
        6 => (1..100_u32, any::<u16>(), prop_oneof![1_300..1_700_u16, any::<u16>()]).prop_map(
            |(commands, servo_us, esc_us)| Step::JogWell { commands, servo_us, esc_us }
        ),
        1 => (1_300..1_700_u16).prop_map(
            |esc_us| Step::JogWell { commands: 1_200, servo_us: NEUTRAL, esc_us }
        ),
        6 => prop_oneof![Just(None), (200..60_000_u32).prop_map(Some)].prop_map(Step::Wheels),
        1 => (any::<u16>(), any::<u32>())
            .prop_map(|(count, last_edge_us)| Step::Motor { count, last_edge_us }),
        1 => prop_oneof![4 => Just(false), 1 => Just(true)].prop_map(Step::StopInput),
        1 => age().prop_map(|age_us| Step::Imu { age_us }),
        1 => any::<bool>().prop_map(Step::Line),
    ]
}

/// History that the checks need.
struct Watch {
    mode: BoardMode,
    outputs: Outputs,
    configuration: Option<Configuration>,
    time_us: u32,
    /// Time at the brake pulse.
    braked_us: u32,
    /// The brake pulse of the configuration in force at the last step.
    brake_us: Option<u16>,
    drove: bool,
    braked: bool,
    latched_us: u32,
    silent: bool,
    armed_us: u32,
    /// Whether the pulse is beyond the deadband, for how long it has been, and its
    /// longest since the last brake. A pulse holds from one poll to the next.
    forward: bool,
    forward_us: u32,
    earned_us: u32,
    /// Whether the motor is jogged, and for how long without a pause.
    jogs: bool,
    jogged_us: u32,
}

impl Watch {
    fn new(rig: &Rig) -> Self {
        Self {
            mode: rig.board.mode(),
            outputs: rig.outputs,
            configuration: None,
            time_us: rig.now,
            braked_us: 0,
            brake_us: None,
            drove: false,
            braked: false,
            latched_us: 0,
            silent: false,
            armed_us: 0,
            forward: false,
            forward_us: 0,
            earned_us: 0,
            jogs: false,
            jogged_us: 0,
        }
    }

    fn check(&mut self, rig: &Rig) {
        let (before, mode, outputs) = (self.mode, rig.board.mode(), rig.outputs);
        let elapsed_us = rig.now.wrapping_sub(self.time_us);
        // In a late poll, time changes the mode, and then a message does.
        let late = elapsed_us > MS;
        let follows = may_follow(before, mode)
            || late
                && BoardMode::ALL
                    .iter()
                    .any(|&between| may_follow(before, between) && may_follow(between, mode));
        assert!(follows, "{before:?} -> {mode:?}");
        assert_eq!(
            matches!(mode, BoardMode::Driving | BoardMode::Jogging),
            outputs.drive_deadline_us.is_some()
        );
        if let Some(deadline) = outputs.drive_deadline_us {
            assert!(
                deadline.wrapping_sub(rig.now) <= TTL,
                "a command beyond its time to live"
            );
        }
        let configuration = rig.board.configuration().copied();
        let Some(now) = configuration else {
            assert_eq!(outputs.servo_us, None);
            assert!(!outputs.power_on);
            self.check_silence(mode, &outputs, elapsed_us);
            if mode != BoardMode::EmergencyStopped {
                assert_eq!(outputs.esc_us, Some(NEUTRAL));
            }
            assert!(matches!(
                mode,
                BoardMode::Boot | BoardMode::Neutral | BoardMode::EmergencyStopped
            ));
            self.mode = mode;
            self.outputs = outputs;
            self.time_us = rig.now;
            return;
        };

        let servo_us = outputs.servo_us.unwrap_or(0);
        assert!((now.servo.min_us..=now.servo.max_us).contains(&servo_us));
        if self.configuration == configuration
            && let Some(servo_before_us) = self.outputs.servo_us
        {
            let slew = u64::from(now.servo.slew_us_per_20ms) * u64::from(elapsed_us.min(20_000));
            let change = u64::from(servo_us.abs_diff(servo_before_us));
            assert!(change <= slew / 20_000 + 1, "{change} in {elapsed_us} us");
        }

        let armed = matches!(
            mode,
            BoardMode::PoweringUp | BoardMode::Armed | BoardMode::Driving | BoardMode::Jogging
        );
        assert_eq!(outputs.power_on, armed && now.kill_output);
        self.armed_us = match (before, mode) {
            (BoardMode::Armed, BoardMode::Armed) => self.armed_us.saturating_add(elapsed_us),
            _ => 0,
        };
        assert!(self.armed_us < 1_000 * MS, "armed without a command");
        self.check_silence(mode, &outputs, elapsed_us);
        if mode != BoardMode::EmergencyStopped {
            self.check_esc(before, mode, &now, &outputs, elapsed_us);
        }
        self.mode = mode;
        self.outputs = outputs;
        self.configuration = configuration;
        self.time_us = rig.now;
    }
}

impl Watch {
    /// A latched stop gives a neutral pulse for 200 ms at most, and then none
    /// for ever. No other state is silent.
    fn check_silence(&mut self, mode: BoardMode, outputs: &Outputs, elapsed_us: u32) {
        if mode != BoardMode::EmergencyStopped {
            assert_ne!(outputs.esc_us, None);
            return;
        }
        assert_eq!(outputs.esc_neutral_us, NEUTRAL);
        if self.mode == BoardMode::EmergencyStopped {
            self.latched_us = self.latched_us.saturating_add(elapsed_us);
            assert!(self.outputs.esc_us.is_some() || outputs.esc_us.is_none());
        }
        match outputs.esc_us {
            Some(pulse) => assert_eq!(pulse, NEUTRAL),
            None => self.silent = true,
        }
        assert!(self.silent || self.latched_us < 200 * MS, "not silent");
    }

    fn check_esc(
        &mut self,
        before: BoardMode,
        mode: BoardMode,
        now: &Configuration,
        outputs: &Outputs,
        elapsed_us: u32,
    ) {
        let esc = &now.esc;
        let esc_us = outputs.esc_us.unwrap_or(0);
        assert_eq!(outputs.esc_neutral_us, esc.neutral_us);
        let brake_us = Some(esc.brake_us).filter(|_| esc.kind.has_brake());
        assert!((esc.min_us..=esc.max_us).contains(&esc_us) || Some(esc_us) == brake_us);
        // A brake goes on through a configuration, with the new pulse.
        let had_braked = self.outputs.esc_us.is_some() && self.outputs.esc_us == self.brake_us;
        let braked = had_braked && Some(esc_us) == brake_us;
        self.brake_us = brake_us;
        if self.forward {
            self.forward_us = self.forward_us.saturating_add(elapsed_us);
            self.earned_us = self.earned_us.max(self.forward_us);
        }
        self.forward = esc_us > esc.neutral_us + esc.deadband_us;
        if !self.forward {
            self.forward_us = 0;
        }
        self.braked_us = if braked {
            self.braked_us.saturating_add(elapsed_us)
        } else {
            0
        };
        let jogs = mode == BoardMode::Jogging && esc_us != esc.neutral_us;
        self.jogged_us = if self.jogs && jogs {
            self.jogged_us.saturating_add(elapsed_us)
        } else {
            0
        };
        self.jogs = jogs;
        assert!(self.jogged_us < JOG_DRIVE_US, "jogged for too long");
        if mode == BoardMode::Jogging {
            // What an ESC made of these pulses is not known.
            self.earned_us = 0;
            self.forward = false;
            self.forward_us = 0;
            self.braked_us = 0;
            assert!(
                esc_us.abs_diff(esc.neutral_us) <= JOG_LIMIT_US,
                "{esc_us} us while jogging"
            );
            return;
        }
        if before == BoardMode::Jogging {
            assert_eq!(esc_us, esc.neutral_us, "after jogging");
        }
        if Some(esc_us) == brake_us && !braked && now.speed.max_reverse_mm_s == 0 {
            // A car's ESC would take a second pulse for reverse.
            assert!(
                self.earned_us >= 60 * MS,
                "brakes after {} us",
                self.earned_us
            );
            self.earned_us = 0;
        }
        if mode == BoardMode::Driving {
            self.drove = true;
            if now.speed.max_reverse_mm_s != 0 {
                return;
            }
            assert!(
                esc_us >= esc.neutral_us || Some(esc_us) == brake_us,
                "reverse"
            );
        } else if esc_us != esc.neutral_us {
            // A stop brakes once, after driving.
            self.braked = true;
            assert_eq!(Some(esc_us), brake_us);
            match mode {
                BoardMode::Failsafe => assert_eq!(now.failsafe, FailsafeAction::Brake),
                // Disarmed while it rolled.
                _ => assert_eq!(mode, BoardMode::Neutral, "brakes"),
            }
            assert!(matches!(
                before,
                BoardMode::Driving | BoardMode::Failsafe | BoardMode::Neutral
            ));
        }
        assert!(
            self.braked_us < 500 * MS,
            "braked for {} us",
            self.braked_us
        );
    }
}

/// Whether one poll may change the mode in this way.
fn may_follow(before: BoardMode, after: BoardMode) -> bool {
    use BoardMode::{
        Armed, Boot, Driving, EmergencyStopped, Failsafe, Jogging, Neutral, PoweringUp,
    };
    before == after
        || after == EmergencyStopped
        || matches!(
            (before, after),
            (Boot, Neutral)
                | (Neutral, Boot | Armed | PoweringUp)
                | (PoweringUp, Armed | Neutral | Failsafe)
                | (Armed, Neutral | Driving | Jogging | Failsafe)
                | (Driving | Jogging, Neutral | Failsafe)
                | (Failsafe, Armed | PoweringUp)
                // The board stops the car; the arm request in the same poll claims
                // to know that.
                | (Driving | Jogging, Armed | PoweringUp)
        )
}

/// Runs one step, checking after every poll.
fn take(rig: &mut Rig, watch: &mut Watch, last_arm: &mut Sequence, step: Step) {
    match step {
        Step::Wait { polls, poll_us } => {
            rig.poll_us = poll_us;
            for _ in 0..polls {
                rig.run(poll_us);
                watch.check(rig);
            }
            rig.poll_us = MS;
        }
        Step::Garbage(bytes) => {
            rig.poll(&bytes);
        }
        Step::Greet { nonce, version } => {
            rig.send(Hello {
                protocol_version: version,
                software_version: [0; 3],
                nonce,
            });
        }
        Step::Configure(configuration) => {
            let request = rig.request();
            rig.send(Configure {
                request,
                configuration,
            });
        }
        Step::Arm {
            age_us,
            right_hash,
            again,
        } => {
            let mut arm = rig.arm_request();
            if again {
                arm.request = *last_arm;
            }
            *last_arm = arm.request;
            rig.send(Arm {
                telemetry_time_us: rig.now.wrapping_sub(age_us),
                configuration_hash: arm.configuration_hash ^ u32::from(!right_hash),
                ..arm
            });
        }
        Step::Disarm => {
            let request = rig.request();
            rig.send(Disarm { request });
        }
        Step::EmergencyStop => {
            let request = rig.request();
            rig.send(EmergencyStop { request });
        }
        Step::Drive {
            ahead,
            age_us,
            speed_mm_s,
            steering_100urad,
            pose_age_ms,
            brake,
        } => {
            rig.send(Drive {
                sequence: Sequence(rig.board.last_sequence().0.wrapping_add(ahead)),
                speed_mm_s,
                steering_100urad,
                telemetry_time_us: rig.now.wrapping_sub(age_us),
                pose_age_ms,
                brake,
            });
        }
        Step::Jog {
            ahead,
            age_us,
            servo_us,
            esc_us,
        } => {
            rig.send(Jog {
                sequence: Sequence(rig.board.last_sequence().0.wrapping_add(ahead)),
                telemetry_time_us: rig.now.wrapping_sub(age_us),
                servo_us,
                esc_us,
            });
        }
        Step::JogWell {
            commands,
            servo_us,
            esc_us,
        } => {
            for _ in 0..commands {
                let sequence = rig.board.last_sequence().next();
                rig.send(Jog {
                    sequence,
                    telemetry_time_us: rig.now,
                    servo_us,
                    esc_us,
                });
                watch.check(rig);
                for _ in 0..10 {
                    rig.run(MS);
                    watch.check(rig);
                }
            }
        }
        Step::DriveWell {
            commands,
            speed_mm_s,
            steering_100urad,
        } => {
            for _ in 0..commands {
                let sequence = rig.board.last_sequence().next();
                let mut command = rig.command(speed_mm_s, steering_100urad);
                command.sequence = sequence;
                command.pose_age_ms = 0;
                rig.send(command);
                watch.check(rig);
                for _ in 0..10 {
                    rig.run(MS);
                    watch.check(rig);
                }
            }
        }
        inputs => return set(rig, inputs),
    }
    watch.check(rig);
}

/// Changes what the next poll sees.
fn set(rig: &mut Rig, step: Step) {
    match step {
        Step::Late(us) => rig.now = rig.now.wrapping_add(us),
        Step::Wheels(period) => rig.pulse_period_us = period,
        Step::Motor {
            count,
            last_edge_us,
        } => {
            rig.pulse_period_us = None;
            rig.inputs.motor.count = count;
            rig.inputs.motor.last_edge_us = last_edge_us;
        }
        Step::StopInput(open) => rig.inputs.stop_input_open = open,
        Step::Imu { age_us } => {
            let time_us = rig.now.wrapping_sub(age_us);
            rig.inputs.imu = Some(ImuSample {
                time_us,
                ..ImuSample::default()
            });
        }
        Step::Line(open) => rig.line_open = open,
        other => unreachable!("{other:?} polls"),
    }
}

fn run(start: u32, ready: bool, steps: Vec<Step>) -> Watch {
    let mut rig = Rig::starting_at(start);
    rig.poll(&[]);
    let mut watch = Watch::new(&rig);
    let mut last_arm = Sequence(0);
    let opening = [
        Step::Configure(Configuration {
            failsafe: FailsafeAction::Brake,
            ..configuration()
        }),
        Step::Wait {
            polls: 2_100,
            poll_us: MS,
        },
        Step::Arm {
            age_us: 0,
            right_hash: true,
            again: false,
        },
        Step::Wheels(Some(5_000)),
        Step::DriveWell {
            commands: 20,
            speed_mm_s: 1_000,
            steering_100urad: 0,
        },
    ];
    let opening = opening.into_iter().filter(|_| ready);
    for step in opening.chain(steps) {
        take(&mut rig, &mut watch, &mut last_arm, step);
    }
    watch
}

fn start() -> impl Strategy<Value = u32> {
    prop_oneof![any::<u32>(), u32::MAX - 10_000 * MS..=u32::MAX]
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 128,
        failure_persistence: Some(Box::new(FileFailurePersistence::Direct(
            "tests/invariants.proptest-regressions",
        ))),
        ..ProptestConfig::default()
    })]

    #[test]
    fn invariants_hold_for_any_sequence_of_steps(
        start in start(),
        ready: bool,
        steps in proptest::collection::vec(step(), 1..60),
    ) {
        run(start, ready, steps);
    }

    #[test]
    fn random_bytes_do_not_move_the_car(
        start in start(),
        pieces in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..70), 0..50),
    ) {
        let mut rig = Rig::starting_at(start);
        for piece in pieces {
            rig.run(MS);
            rig.poll(&piece);
            prop_assert_eq!((rig.outputs.servo_us, rig.esc_us()), (None, NEUTRAL));
        }
    }
}

#[test]
fn the_generated_sequences_drive_and_brake() {
    // Otherwise the invariants would not be exercised.
    let watch = run(
        0,
        true,
        vec![Step::Wait {
            polls: 200,
            poll_us: MS,
        }],
    );
    assert!(watch.drove && watch.braked);
}
