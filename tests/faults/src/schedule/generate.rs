//! Generates schedules from seeds.

use singletrack_sim::{BoardKind, EscKind};

use super::{
    Deviation, Fault, FaultKind, OperatorRequest, ReferenceKind, Schedule, ScheduledRequest,
    Situation, TrueCar,
};
use crate::random::{Random, Stream};

/// Time of the first request to arm: board, ESC and estimator are ready.
const FIRST_ARM_MS: u32 = 3_200;

/// Earliest onset of a fault, before the car can drive.
const FIRST_FAULT_MS: u32 = 500;

/// Range of the time after the first request; shorter with the image, which
/// simulates slowly.
const NATIVE_MS: [u32; 2] = [10_000, 25_000];
const UNO_MS: [u32; 2] = [8_000, 16_000];

impl Default for Situation {
    /// A slow circle without disturbances.
    fn default() -> Self {
        Self {
            board: BoardKind::Native,
            reference: ReferenceKind::Circle,
            speed_mm_s: 500,
            coast: false,
            brake: false,
            stop_input: false,
            reset_on_open: false,
            own_supply: false,
            queue_shows: false,
            kill_output: false,
            proved: true,
            esc_kind: EscKind::Car,
            neutral_us: 1_500,
            fence_mm: 2_000,
            braking_mm_s2: 900,
            pulse_distance_um: 3_000,
            safety_filter: false,
            steering_table: false,
            tuning: false,
            live: false,
            attended: false,
            waits: false,
            camera_latency_ms: 8,
            serial_delay_us: 0,
            board_skew_ppm: 3_000,
            board_clock_ms: 0,
        }
    }
}

impl Schedule {
    /// The schedule of a seed.
    pub fn generate(seed: u64, board: BoardKind) -> Self {
        let random = &mut Random::new(seed, Stream::Schedule);
        let mut situation = situation(random, board);
        situation.live = seed.is_multiple_of(3);
        situation.waits = seed.is_multiple_of(7);
        situation.own_supply = seed % 5 < 2;
        let truth = true_car(random, &situation);
        believe(random, &mut situation, &truth);
        let [shortest, longest] = match board {
            BoardKind::Native => NATIVE_MS,
            BoardKind::Uno => UNO_MS,
        };
        let end_ms = FIRST_ARM_MS + random.between(shortest, longest);
        let count = random.between(1, 6);
        let mut faults: Vec<Fault> = (0..count).map(|_| fault(random, end_ms)).collect();
        if situation.reference == ReferenceKind::External && random.happens(500) {
            faults.push(Fault {
                kind: random.choose(FaultKind::SetpointsGone, &[FaultKind::SetpointsNotANumber]),
                at_ms: random.between(FIRST_ARM_MS, end_ms),
                for_ms: random.spread(150, 2_000),
                severity: Fault::WORST,
            });
        }
        if situation.neutral_us != 1_500 {
            faults.extend(neutrals(random, end_ms));
        }
        if situation.reference == ReferenceKind::External {
            hostile(seed, end_ms, &mut faults);
        }
        faults.sort_by_key(|fault| fault.at_ms);
        let mut once = Vec::new();
        faults.retain(|fault| {
            let again = once.contains(&fault.kind);
            once.push(fault.kind);
            !(again && fault.kind.happens_once())
        });
        let requests = requests(random, end_ms, &faults);
        let mut schedule = Self {
            seed,
            situation,
            truth,
            end_ms,
            requests,
            faults,
        };
        filter(&mut schedule);
        cameras_of_logs(&mut schedule);
        rare_and_many(&mut schedule);
        attended(&mut schedule);
        schedule
    }
}

impl Schedule {
    /// Hours of a calibrated car that is armed again and again, with every fault that ends by
    /// itself: four a minute, most of them short.
    pub fn soak(seed: u64, board: BoardKind, end_ms: u32) -> Self {
        let random = &mut Random::new(seed, Stream::Schedule);
        let situation = Situation {
            board,
            reference: ReferenceKind::External,
            safety_filter: true,
            tuning: true,
            attended: true,
            ..Situation::default()
        };
        let kinds = FaultKind::ALL.iter().copied();
        let kinds: Vec<_> = kinds.filter(|kind| !kind.happens_once()).collect();
        let times = |random: &mut Random, [least, most]: [u32; 2]| {
            let mut at_ms = FIRST_ARM_MS;
            let mut times = Vec::new();
            while at_ms < end_ms {
                times.push(at_ms);
                at_ms += random.between(least, most);
            }
            times
        };
        let faults = times(random, [5_000, 25_000]).into_iter().map(|at_ms| {
            let kind = random.choose(FaultKind::CameraUntracked, &kinds);
            let for_ms = if kind.is_momentary() {
                0
            } else {
                random.spread(20, 3_000)
            };
            Fault {
                kind,
                at_ms,
                for_ms,
                severity: random.spread(10, Fault::WORST),
            }
        });
        let faults = faults.collect();
        let requests = times(random, [1_000, 8_000]).into_iter().map(|at_ms| {
            let request = match random.between(0, 99) {
                0 => OperatorRequest::Stop,
                1..10 => OperatorRequest::Disarm,
                10..12 => OperatorRequest::Reload,
                12..14 => OperatorRequest::Carry,
                _ => OperatorRequest::Arm,
            };
            ScheduledRequest { request, at_ms }
        });
        let requests = requests.collect();
        Self {
            seed,
            situation,
            truth: TrueCar::default(),
            end_ms,
            requests,
            faults,
        }
    }
}

fn situation(random: &mut Random, board: BoardKind) -> Situation {
    Situation {
        board,
        reference: random.choose(
            ReferenceKind::Circle,
            &[
                ReferenceKind::Eight,
                ReferenceKind::Steps,
                ReferenceKind::External,
            ],
        ),
        speed_mm_s: random.between(300, 1_500),
        coast: random.happens(500),
        brake: random.happens(500),
        stop_input: random.happens(500),
        reset_on_open: random.happens(250),
        own_supply: false,
        queue_shows: random.happens(500),
        proved: false,
        kill_output: random.happens(300),
        esc_kind: random.choose(
            EscKind::Car,
            &[EscKind::Car, EscKind::ForwardReverse, EscKind::Vesc],
        ),
        neutral_us: 1_500,
        fence_mm: random.spread(300, 3_000) as i32,
        braking_mm_s2: 900,
        pulse_distance_um: 3_000,
        safety_filter: false,
        steering_table: random.happens(300),
        tuning: false,
        live: false,
        attended: false,
        waits: false,
        camera_latency_ms: random.between(3, 25),
        serial_delay_us: random.between(0, 8_000),
        board_skew_ppm: random.between(0, 10_000) as i32 - 5_000,
        board_clock_ms: match board {
            // The clock wraps every 4,295 s, sometimes during a drive.
            BoardKind::Native if random.happens(250) => random.between(4_270_000, 4_294_000),
            BoardKind::Native => random.between(0, 4_294_000),
            // The image's clock starts at zero.
            BoardKind::Uno => 0,
        },
    }
}

/// A car of which nothing is quite as configured, and sometimes one thing not at all.
fn true_car(random: &mut Random, situation: &Situation) -> TrueCar {
    let mut car = TrueCar::default();
    for &deviation in Deviation::ALL {
        let tolerable = deviation.tolerable();
        car.deviations.insert(
            deviation,
            random.signed(*tolerable.start(), *tolerable.end()),
        );
    }
    if situation.esc_kind == EscKind::Car && random.happens(200) {
        car.esc = Some(EscKind::LearnsNeutral);
    }
    if random.happens(300) {
        let (deviation, value) = gross(random, &car);
        car.deviations.insert(deviation, value);
    }
    if random.happens(100) {
        let kinds = [EscKind::Car, EscKind::ForwardReverse, EscKind::Vesc];
        let [first, second] = kinds
            .iter()
            .copied()
            .filter(|kind| *kind != situation.esc_kind)
            .collect::<Vec<_>>()
            .try_into()
            .unwrap_or([EscKind::ForwardReverse; 2]);
        car.esc = Some(random.choose(first, &[second]));
    }
    car
}

/// A property as no calibrated car has it.
fn gross(random: &mut Random, car: &TrueCar) -> (Deviation, i32) {
    use Deviation as D;
    let sign = if random.happens(500) { 1 } else { -1 };
    // What no plausible value of another sensor shows at once comes more often.
    let subtle = [D::ServoGain, D::GyroScale, D::ImuYaw, D::EscNeutral];
    let all: Vec<_> = Deviation::ALL
        .iter()
        .copied()
        // Every heading is tolerable.
        .filter(|kind| *kind != D::SlopeHeading)
        .chain(subtle)
        .collect();
    let kind = random.choose(D::ServoTrim, &all);
    let value = match kind {
        D::ServoTrim => sign * random.signed(25, 120),
        // Reversed, or by the wrong arm of the linkage.
        D::ServoGain => random.choose(-2_000, &[-2_080, -1_920, -400, -150, 150, 400]),
        D::ServoRate => random.spread(300, 4_000) as i32,
        D::PulseDistance => random.choose(-500, &[1_000, -300, 300, -100, 100]),
        D::MotorGain => random.choose(-500, &[-300, 300, 600, 1_000]),
        D::Rolling => random.choose(150, &[200, 250, 2_000, 4_000]),
        D::Viscous => random.signed(1_200, 5_000),
        // Farther off, no brake pulse fits below the deadband.
        D::EscNeutral => sign * random.signed(15, 70),
        D::EscDeadband => random.choose(-26, &[-15, 15, 30, 100]),
        D::EscDeadTime => random.choose(0, &[100, 150, 200]),
        D::MotorLag => random.choose(20, &[150, 250, 400]),
        D::SignalLoss => random.choose(20, &[50, 1_500, 2_000, 3_000]),
        D::BodyYaw => sign * random.spread(60, 3_142) as i32,
        D::PivotForward | D::PivotLeft => sign * random.spread(20, 400) as i32,
        D::ServoBacklash => random.signed(20, 120),
        // As steep as the car may stand on without rolling away.
        D::Slope => {
            let rolling = car.get(D::Rolling).unwrap_or(0);
            random.signed(55, (rolling - 100) * 100 / 171)
        }
        D::SlopeHeading => random.signed(0, 359),
        D::ImuYaw | D::ImuPitch | D::ImuRoll => random.choose(900, &[-900, 1_800, 300, -150, 50]),
        // Reversed, or off its scale.
        D::GyroScale => random.choose(-2_000, &[-1_990, -500, -200, 200, 500]),
        D::AccelerationScale => sign * random.signed(100, 900),
        D::ImuLeak => random.spread(100, 1_500) as i32,
        D::Vibration => random.spread(1_500, 20_000) as i32,
        D::StampBias => sign * random.spread(5_000, 100_000) as i32,
        D::StampDrift => sign * random.signed(100, 5_000),
        D::BodyHeight => random.choose(0, &[40, 250, 1_000]),
        D::Supply => random.choose(4_000, &[4_300, 5_400]),
        D::EmiDriven => random.signed(20, 2_000),
        D::EmiStanding => random.signed(5, 500),
        D::Ringing => random.signed(1, 3),
        D::Drained => random.signed(900, 3_000),
        D::ImuTorn => random.spread(1, 1_000) as i32,
        D::ImuCalibration => random.signed(0, 2),
        D::ImuStatus => random.choose(1, &[0, 2, 3, 4, 6]),
        D::ImuError => random.signed(1, 10),
        D::ImuSelfTest => random.signed(0, 14),
        D::ServoAsymmetry => sign * random.spread(100, 800) as i32,
        D::ServoDeadBand => random.signed(15, 150),
        D::DividerOpen => 1,
    };
    (kind, value)
}

/// `control.stop_deceleration_m_s2`, which a configuration must not exceed.
const MAX_BRAKING_MM_S2: u32 = 2_400;

/// What the operator has configured for this car.
fn believe(random: &mut Random, situation: &mut Situation, truth: &TrueCar) {
    let rolling = truth.deceleration_mm_s2().max(100);
    situation.braking_mm_s2 = if random.happens(850) {
        // As measured, less a fifth.
        rolling * 4 / 5
    } else {
        rolling * random.between(12, 40) / 10
    }
    .min(MAX_BRAKING_MM_S2);
    let true_neutral_us = truth.get(Deviation::EscNeutral).unwrap_or(0);
    let moved = !Deviation::EscNeutral.tolerable().contains(&true_neutral_us);
    if moved && random.happens(500) {
        // As it is: then the pulse before the configuration is the one that drives.
        situation.neutral_us = 1_500_u16.saturating_add_signed(true_neutral_us as i16);
    } else if random.happens(60) {
        situation.neutral_us = random.choose(1_550, &[1_560, 1_570, 1_440]);
    }
    // A car that fits its configuration may have been proved; another one has perhaps
    // changed since.
    let proved = random.happens(500);
    situation.proved = proved && (truth.is_tolerable() || random.happens(500));
    situation.pulse_distance_um = match random.between(0, 2) {
        0 => 3_000,
        1 => random.between(3_000, 12_000),
        _ => random.between(3_000, 30_000),
    };
    if random.happens(850) {
        // Room for a drive that can stop.
        let speed = situation.speed_mm_s;
        situation.fence_mm += (speed * speed / (2 * situation.braking_mm_s2) + speed / 5) as i32;
    }
    if random.happens(150) {
        // By mistake.
        situation.fence_mm = random.signed(-300, 200);
    }
}

/// How an ESC gets another neutral after it has armed: it arms at the board's pulse before
/// the configuration, or at the configured one and the board restarts.
fn neutrals(random: &mut Random, end_ms: u32) -> [Fault; 2] {
    let fault = |kind, at_ms, for_ms| Fault {
        kind,
        at_ms,
        for_ms,
        severity: Fault::WORST,
    };
    [
        // The daemon starts when the ESC has armed.
        fault(FaultKind::DaemonKilled, 1, random.between(1_500, 2_500)),
        fault(
            FaultKind::BoardReset,
            random.between(FIRST_ARM_MS + 2_000, end_ms),
            0,
        ),
    ]
}

/// What a program that turns hostile does, in most of the schedules with a program. The draws
/// are a stream of their own, so that they change nothing else of a schedule.
fn hostile(seed: u64, end_ms: u32, faults: &mut Vec<Fault>) {
    let random = &mut Random::new(seed, Stream::ProgramFaults);
    if random.happens(200) {
        return;
    }
    for _ in 0..random.between(1, 2) {
        let kinds = FaultKind::ALL.iter().copied();
        let kinds: Vec<_> = kinds.filter(|kind| kind.is_hostile()).collect();
        faults.push(Fault {
            kind: random.choose(FaultKind::SetpointsFlood, &kinds),
            at_ms: random.between(FIRST_ARM_MS, end_ms),
            for_ms: random.spread(150, 6_000),
            severity: random.spread(10, Fault::WORST),
        });
    }
}

/// The safety filter, and the hostile outer loops before it: in a part of the schedules, and in
/// half of those nothing else is wrong. The draws are a stream of their own, so that they change
/// nothing in the others.
fn filter(schedule: &mut Schedule) {
    let random = &mut Random::new(schedule.seed, Stream::HostileLoops);
    schedule.situation.safety_filter = random.happens(300);
    if !random.happens(250) {
        return;
    }
    let situation = &mut schedule.situation;
    situation.safety_filter = true;
    situation.reference = ReferenceKind::External;
    if random.happens(500) {
        schedule.faults.clear();
        calibrate(random, situation, &mut schedule.truth);
    }
    let kinds = FaultKind::ALL.iter().copied();
    let kinds: Vec<_> = kinds.filter(|kind| kind.is_hostile_loop()).collect();
    for _ in 0..random.between(1, 3) {
        schedule.faults.push(Fault {
            kind: random.choose(FaultKind::LoopAtFence, &kinds),
            at_ms: random.between(FIRST_ARM_MS, schedule.end_ms),
            for_ms: random.spread(500, 10_000),
            severity: random.spread(20, Fault::WORST),
        });
    }
    schedule.faults.sort_by_key(|fault| fault.at_ms);
}

/// What the cameras of a real car did, in a part of the schedules: jumps of centimetres and flips for a few
/// frames, another body under the car's name, and one that lives metres away. The draws are a stream
/// of their own, so that they change nothing in the others.
fn cameras_of_logs(schedule: &mut Schedule) {
    let random = &mut Random::new(schedule.seed, Stream::CamerasOfLogs);
    if !random.happens(300) {
        return;
    }
    let kinds = [
        FaultKind::CameraJump,
        FaultKind::CameraFlip,
        FaultKind::CameraSwapped,
        FaultKind::CameraGhost,
    ];
    for _ in 0..random.between(1, 3) {
        let kind = random.choose(FaultKind::CameraJump, &kinds);
        let severity = match kind {
            FaultKind::CameraJump => random.between(5, 80),
            FaultKind::CameraFlip => random.choose(640, &[Fault::WORST]),
            _ => random.spread(20, Fault::WORST),
        };
        schedule.faults.push(Fault {
            kind,
            at_ms: random.between(FIRST_ARM_MS, schedule.end_ms),
            for_ms: match kind {
                FaultKind::CameraGhost => random.spread(100, 8_000),
                // One to twenty frames.
                _ => 10 * random.between(1, 20),
            },
            severity,
        });
    }
    schedule.faults.sort_by_key(|fault| fault.at_ms);
}

/// Poses that are rare, and requests that are many, in a part of the schedules. The draws are a stream
/// of their own, so that they change nothing in the others.
fn rare_and_many(schedule: &mut Schedule) {
    let random = &mut Random::new(schedule.seed, Stream::RareAndMany);
    if random.happens(100) {
        let from_start = random.happens(500);
        schedule.faults.push(Fault {
            kind: FaultKind::CameraRare,
            at_ms: if from_start {
                FIRST_FAULT_MS
            } else {
                random.between(FIRST_ARM_MS, schedule.end_ms)
            },
            for_ms: if from_start {
                schedule.end_ms
            } else {
                random.spread(500, 10_000)
            },
            severity: random.between(1, Fault::WORST),
        });
    }
    if random.happens(150) {
        schedule.situation.tuning = schedule.situation.reference != ReferenceKind::Steps;
        schedule.faults.push(Fault {
            kind: FaultKind::RequestFlood,
            at_ms: random.between(FIRST_FAULT_MS, schedule.end_ms),
            for_ms: random.spread(100, 10_000),
            severity: random.spread(10, Fault::WORST),
        });
    }
    if random.happens(150) {
        schedule.faults.push(Fault {
            kind: FaultKind::ImuWrongBit,
            at_ms: random.between(FIRST_FAULT_MS, schedule.end_ms),
            for_ms: random.spread(100, 10_000),
            severity: random.between(1, Fault::WORST),
        });
    }
    schedule.faults.sort_by_key(|fault| fault.at_ms);
}

/// Attended drives, the usual way to drive, in most of the schedules, and jogging in a part of them. The
/// draws are a stream of their own, so that they change nothing else.
fn attended(schedule: &mut Schedule) {
    let random = &mut Random::new(schedule.seed, Stream::Attendance);
    let end_ms = schedule.end_ms;
    schedule.situation.attended = random.happens(600);
    if schedule.situation.attended {
        for request in [
            OperatorRequest::Gone,
            OperatorRequest::TimeUp,
            OperatorRequest::Halt,
        ] {
            if random.happens(250) {
                let at_ms = random.between(FIRST_ARM_MS, end_ms);
                schedule.requests.push(ScheduledRequest { request, at_ms });
            }
        }
        if random.happens(400) {
            let at_ms = random.between(FIRST_ARM_MS, end_ms);
            let for_ms = random.spread(50, 3_000);
            schedule
                .faults
                .push(of_operator(FaultKind::OperatorHangs, at_ms, for_ms));
        }
    }
    if random.happens(250) {
        jogging(random, schedule);
    }
    schedule.requests.sort_by_key(|ask| ask.at_ms);
    schedule.faults.sort_by_key(|fault| fault.at_ms);
}

const fn of_operator(kind: FaultKind, at_ms: u32, for_ms: u32) -> Fault {
    Fault {
        kind,
        at_ms,
        for_ms,
        severity: Fault::WORST,
    }
}

/// The operator jogs once: mostly after a disarm, and with the wheels off the floor; often nothing is armed
/// meanwhile.
fn jogging(random: &mut Random, schedule: &mut Schedule) {
    let end_ms = schedule.end_ms;
    let disarm_ms = random.between(FIRST_ARM_MS, end_ms);
    let lift_ms = disarm_ms + random.between(1_000, 3_000);
    let jog_ms = lift_ms + 1_200;
    let stop_ms = jog_ms + random.spread(200, 14_000);
    let down_ms = stop_ms + random.between(0, 1_000);
    if random.happens(800) {
        let armed = |ask: &ScheduledRequest| {
            ask.request == OperatorRequest::Arm && (disarm_ms..down_ms + 1_000).contains(&ask.at_ms)
        };
        // The first request is never left out.
        let mut first = true;
        schedule
            .requests
            .retain(|ask| core::mem::take(&mut first) || !armed(ask));
    }
    let mut add = |request, at_ms| {
        if at_ms < end_ms {
            schedule.requests.push(ScheduledRequest { request, at_ms });
        }
    };
    if random.happens(800) {
        add(OperatorRequest::Disarm, disarm_ms);
    }
    if random.happens(700) {
        add(OperatorRequest::Lift, lift_ms);
        add(OperatorRequest::PutDown, down_ms);
    }
    let jogs = random.choose(OperatorRequest::Jog, &[OperatorRequest::JogOn]);
    add(jogs, jog_ms);
    let stops = [
        OperatorRequest::Gone,
        OperatorRequest::Halt,
        OperatorRequest::TimeUp,
    ];
    let hangs = random.happens(200);
    if !hangs {
        add(random.choose(OperatorRequest::Disarm, &stops), stop_ms);
    }
    let mut fault = |kind, at_ms: u32, for_ms| {
        if at_ms < end_ms {
            schedule.faults.push(of_operator(kind, at_ms, for_ms));
        }
    };
    if hangs {
        fault(FaultKind::OperatorHangs, stop_ms, 1_000);
    }
    if random.happens(400) {
        fault(FaultKind::JogWild, jog_ms, random.spread(500, 4_000));
    }
}

/// Makes a car tolerable, with what is configured for it, and gives it room.
fn calibrate(random: &mut Random, situation: &mut Situation, truth: &mut TrueCar) {
    for (deviation, value) in &mut truth.deviations {
        let tolerable = deviation.tolerable();
        *value = (*value).clamp(*tolerable.start(), *tolerable.end());
    }
    truth.esc = truth.esc.filter(|kind| *kind == EscKind::LearnsNeutral);
    situation.neutral_us = 1_500;
    situation.braking_mm_s2 = (truth.deceleration_mm_s2() * 4 / 5).min(MAX_BRAKING_MM_S2);
    situation.fence_mm = random.spread(300, 2_000) as i32;
}

fn fault(random: &mut Random, end_ms: u32) -> Fault {
    let kinds = FaultKind::ALL.iter().copied();
    let kinds: Vec<_> = kinds
        .filter(|kind| !kind.is_hostile() && !kind.is_hostile_loop())
        .filter(|kind| !kind.is_drawn_apart())
        .collect();
    let kind = random.choose(FaultKind::CameraUntracked, kinds.get(1..).unwrap_or(&[]));
    let early = random.happens(100);
    let at_ms = if early {
        random.between(FIRST_FAULT_MS, FIRST_ARM_MS)
    } else {
        random.between(FIRST_ARM_MS, end_ms)
    };
    let for_ms = match kind {
        _ if kind.is_momentary() => 0,
        FaultKind::Push => random.choose(0, &[500, 2_000]),
        FaultKind::BecDip | FaultKind::EscReboot => random.spread(20, 1_000),
        // A body that stays turned.
        FaultKind::CameraFlip if random.happens(300) => end_ms,
        _ if kind.is_lasting() => end_ms,
        FaultKind::DaemonPaused => random.spread(20, 6_000),
        FaultKind::DaemonKilled => random.spread(300, 3_000),
        _ => random.spread(20, 4_000),
    };
    Fault {
        kind,
        at_ms,
        for_ms,
        severity: if random.happens(300) {
            Fault::WORST
        } else {
            random.spread(10, Fault::WORST)
        },
    }
}

/// The operator asks to arm from time to time, mostly after a fault and sometimes
/// during one.
fn requests(random: &mut Random, end_ms: u32, faults: &[Fault]) -> Vec<ScheduledRequest> {
    let mut requests = vec![ScheduledRequest {
        request: OperatorRequest::Arm,
        at_ms: FIRST_ARM_MS,
    }];
    let mut at_ms = FIRST_ARM_MS;
    loop {
        at_ms += random.spread(100, 4_000);
        if at_ms >= end_ms {
            break;
        }
        requests.push(ScheduledRequest {
            request: random.choose(
                OperatorRequest::Arm,
                &[
                    OperatorRequest::Arm,
                    OperatorRequest::Arm,
                    OperatorRequest::Arm,
                    OperatorRequest::Arm,
                    OperatorRequest::Disarm,
                ],
            ),
            at_ms,
        });
    }
    for fault in faults {
        if random.happens(300) {
            requests.push(ScheduledRequest {
                request: OperatorRequest::Arm,
                at_ms: fault.at_ms + random.between(0, fault.for_ms),
            });
        }
    }
    // A configuration is changed between two drives, or by mistake during one.
    if random.happens(500) {
        for _ in 0..random.between(1, 3) {
            requests.push(ScheduledRequest {
                request: OperatorRequest::Reload,
                at_ms: random.between(FIRST_FAULT_MS, end_ms),
            });
        }
    }
    if random.happens(250) {
        requests.push(ScheduledRequest {
            request: OperatorRequest::Stop,
            at_ms: random.between(FIRST_ARM_MS, end_ms),
        });
    }
    requests.sort_by_key(|ask| ask.at_ms);
    requests
}
