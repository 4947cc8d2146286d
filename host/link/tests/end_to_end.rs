//! The session and the real board, with a bad line between them.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use proptest::{prelude::*, test_runner::FileFailurePersistence};
use singletrack_control::statistics::Random;
use singletrack_link::{DriveCommand, Event, LossCause, RestartEvidence, Session, State};
use singletrack_protocol::{BoardMode, Configuration, Request};

use crate::{Faults, MS, START_NS, TestBoard, Wire, configuration, session_config};

/// The board's clock runs fast by this fraction.
const SKEW: f64 = 0.004;

struct World {
    now_ns: u64,
    session: Session,
    board: Option<TestBoard>,
    to_board: Wire,
    to_host: Wire,
    events: Vec<Event>,
    /// Whether the owner drives whenever it can.
    driving: bool,
    arms_asked: u32,
    /// Largest error of a telemetry stamp since the last look.
    worst_stamp_ns: u64,
}

impl World {
    fn new(seed: u64, faults: Faults) -> Self {
        Self {
            now_ns: START_NS,
            session: Session::new(session_config()).unwrap(),
            board: None,
            to_board: Wire::new(seed, faults),
            to_host: Wire::new(!seed, faults),
            events: Vec::new(),
            driving: false,
            arms_asked: 0,
            worst_stamp_ns: 0,
        }
    }

    /// A configured board after its boot time.
    fn ready(seed: u64) -> Self {
        let mut world = Self::new(seed, Faults::default());
        world.board = Some(TestBoard::started());
        world.session.handle_opened(world.now_ns);
        world.run(2_500);
        world
    }

    fn driving(seed: u64) -> Self {
        let mut world = Self::ready(seed);
        world.arm();
        world.driving = true;
        world.run(100);
        assert_eq!(world.board_mode(), BoardMode::Driving);
        world
    }

    fn board_us(&self) -> u32 {
        // Wraps 7 seconds after the start.
        let since_us = (self.now_ns - START_NS) as f64 / 1_000.0 * (1.0 + SKEW);
        (u32::MAX - 7_000_000).wrapping_add(since_us as u32)
    }

    fn board_mode(&self) -> BoardMode {
        self.board.as_ref().expect("a board").mode()
    }

    fn arm(&mut self) {
        if self.session.arm(self.now_ns).is_ok() {
            self.arms_asked += 1;
        }
    }

    fn reset_board(&mut self) {
        self.board = None;
        self.to_board.clear();
    }

    fn run(&mut self, milliseconds: u64) {
        for _ in 0..milliseconds {
            self.now_ns += MS;
            self.step();
        }
    }

    fn step(&mut self) {
        let now_ns = self.now_ns;
        let board_us = self.board_us();
        let heard = self.to_board.take(now_ns);
        if let Some(board) = &mut self.board {
            let said = board.poll(board_us, &heard);
            self.to_host.put(now_ns, &said);
        }

        let bytes = self.to_host.take(now_ns);
        let first_new = self.events.len();
        let events = &mut self.events;
        let mut on_event = |event| events.push(event);
        self.session.handle_bytes(now_ns, &bytes, &mut on_event);
        self.session.handle_timeout(now_ns, &mut on_event);
        for event in &self.events[first_new..] {
            if let Event::Telemetry(record) = event {
                let age_us = board_us.wrapping_sub(record.telemetry.board_time_us);
                let made_ns = now_ns - (f64::from(age_us) * 1_000.0 / (1.0 + SKEW)) as u64;
                let error_ns = made_ns.abs_diff(record.board_time_host_ns);
                self.worst_stamp_ns = self.worst_stamp_ns.max(error_ns);
            }
        }
        if self.driving && now_ns.is_multiple_of(10 * MS) {
            let command = DriveCommand {
                speed_m_s: 0.4,
                steering_rad: 0.1,
                brake: false,
                pose_time_ns: Some(now_ns - 8 * MS),
            };
            if let Ok(frame) = self.session.drive(now_ns, command) {
                self.to_board.put(now_ns, frame.as_bytes());
            }
        }
        while let Some(transmit) = self.session.poll_transmit(now_ns) {
            self.to_board.put(now_ns, transmit.as_bytes());
        }
        assert!(self.session.poll_timeout().is_none_or(|wake| wake > now_ns));
    }

    /// The invariants for every line.
    fn check(&self) {
        if let (State::Ready { .. }, Some(board)) = (self.session.state(), &self.board) {
            let restarted = board.configuration().is_none();
            // A board that has just restarted has not reported it yet.
            let hash = board.configuration().map(Configuration::hash);
            assert!(
                restarted || hash == Some(self.session.configuration_hash()),
                "ready with {hash:?}"
            );
        }
        if let Some(board) = &self.board {
            assert!(board.armed <= 3 * self.arms_asked, "armed unasked");
        }
    }

    fn count(&self, is: impl Fn(&Event) -> bool) -> usize {
        self.events.iter().filter(|event| is(event)).count()
    }
}

#[test]
fn a_board_that_boots_for_three_seconds_is_configured_armed_and_driven() {
    let mut world = World::new(1, Faults::default());
    world.session.handle_opened(world.now_ns);
    world.to_host.put(world.now_ns, &[0xff, 0x14, 0x80, 0x10]);
    world.run(3_000);
    assert!(matches!(world.session.state(), State::Greeting { .. }));
    world.board = Some(TestBoard::started());
    world.run(100);
    assert_eq!(
        world.session.state(),
        State::Ready {
            mode: Some(BoardMode::Boot)
        }
    );
    world.run(2_000);
    world.arm();
    world.driving = true;
    world.run(2_000);
    assert_eq!(world.board_mode(), BoardMode::Driving);
    let driven = world.board.as_ref().unwrap().driven;
    assert!((195..=200).contains(&driven), "{driven} commands obeyed");
    let round_trip = world.session.round_trip().unwrap();
    assert!(
        (5 * MS..16 * MS).contains(&round_trip.min_ns),
        "{round_trip:?}"
    );
    let counters = world.session.counters();
    assert_eq!(counters.telemetry_missing + counters.links_lost, 0);
}

#[test]
fn telemetry_stamps_are_right_to_a_millisecond_over_the_wrap() {
    let mut world = World::driving(2);
    world.worst_stamp_ns = 0;
    world.run(10_000);
    assert!(world.board_us() < 10_000_000, "the counter has wrapped");
    assert_eq!(world.board_mode(), BoardMode::Driving);
    // The bench itself polls once a millisecond.
    assert!(
        world.worst_stamp_ns < MS + MS / 2,
        "{} ns",
        world.worst_stamp_ns
    );
}

#[test]
fn a_board_that_restarts_while_driving_is_configured_again_and_stays_idle() {
    let mut world = World::driving(3);
    world.events.clear();
    world.board = Some(TestBoard::started());
    world.run(5_000);
    assert_eq!(
        world.count(|event| matches!(
            event,
            Event::BoardRestarted {
                evidence: RestartEvidence::Announced
            }
        )),
        1
    );
    assert_eq!(world.board_mode(), BoardMode::Neutral);
    assert_eq!(world.board.as_ref().unwrap().armed, 0);
    assert!(world.board.as_ref().unwrap().configuration().is_some());
    // Driving again takes an explicit request, and then works.
    world.arm();
    world.run(100);
    assert_eq!(world.board_mode(), BoardMode::Driving);
}

#[test]
fn an_unplugged_line_is_lost_in_200_ms_and_the_board_waits_to_be_armed_again() {
    let mut world = World::driving(4);
    world.events.clear();
    world.to_board.faults.drop = 1.0;
    world.to_host.faults.drop = 1.0;
    world.run(220);
    assert_eq!(world.board_mode(), BoardMode::Failsafe);
    assert_eq!(
        world.count(|event| matches!(
            event,
            Event::Lost {
                cause: LossCause::Silence
            }
        )),
        1
    );
    world.to_board.faults.drop = 0.0;
    world.to_host.faults.drop = 0.0;
    world.run(1_000);
    assert_eq!(
        world.session.state(),
        State::Ready {
            mode: Some(BoardMode::Failsafe)
        }
    );
    assert_eq!(world.board.as_ref().unwrap().armed, 1);
}

#[test]
fn commands_from_a_line_that_was_stuck_drive_nothing() {
    let mut world = World::driving(5);
    world.to_board.stuck = true;
    world.run(9_760);
    assert_eq!(world.board_mode(), BoardMode::Failsafe);
    let driven = world.board.as_ref().unwrap().driven;
    world.driving = false;
    world.to_board.stuck = false;
    world.run(200);
    let board = world.board.as_ref().unwrap();
    assert_eq!((board.driven, board.armed), (driven, 1));
    assert_eq!(board.mode(), BoardMode::Failsafe);
}

#[test]
fn stops_get_through_a_line_that_loses_nine_frames_in_ten() {
    for seed in 0..10 {
        for emergency in [false, true] {
            let mut world = World::driving(seed);
            world.to_board.faults.corrupt = 0.3;
            let request = if emergency {
                world.session.emergency_stop(world.now_ns);
                Request::EmergencyStop
            } else {
                world.session.disarm(world.now_ns);
                Request::Disarm
            };
            world.run(10_000);
            assert!(!world.session.is_stop_pending(), "seed {seed}");
            assert_eq!(
                world.count(|event| *event == Event::StopConfirmed { request }),
                1
            );
            assert_eq!(world.board_mode() == BoardMode::EmergencyStopped, emergency);
        }
    }
}

/// The fractions of damaged frames to the host and to the board, averaged over
/// ten seconds.
fn damaged_fractions(corrupt: f64) -> (f32, f32) {
    let mut world = World::driving(6);
    world.to_board.faults.corrupt = corrupt;
    world.to_host.faults.corrupt = corrupt;
    let (mut here, mut there) = (Vec::new(), Vec::new());
    for _ in 0..10 {
        world.run(1_000);
        world.arm();
        here.extend(world.session.line_quality(world.now_ns).damaged_fraction());
        there.extend(
            world
                .session
                .board_line_quality()
                .and_then(|quality| quality.damaged_fraction()),
        );
    }
    let mean = |them: &[f32]| them.iter().sum::<f32>() / them.len() as f32;
    (mean(&here), mean(&there))
}

#[test]
fn half_a_percent_of_damaged_bytes_keeps_driving_and_five_is_recognisable() {
    let (clean, _) = damaged_fractions(0.0);
    let (slight, slight_there) = damaged_fractions(0.005);
    let (bad, _) = damaged_fractions(0.05);
    println!("0 %: {clean}, 0.5 %: {slight} / {slight_there}, 5 %: {bad}");
    assert!(clean == 0.0);
    assert!((0.1..0.3).contains(&slight), "{slight}");
    assert!((0.04..0.16).contains(&slight_there), "{slight_there}");
    assert!(bad > 0.7, "{bad}");

    let mut world = World::driving(7);
    world.to_board.faults.corrupt = 0.005;
    world.to_host.faults.corrupt = 0.005;
    world.run(20_000);
    assert_eq!(world.board_mode(), BoardMode::Driving);
    assert_eq!(world.session.counters().links_lost, 0);
}

#[derive(Clone, Debug)]
enum Action {
    Run(u64),
    Line(f64, f64),
    Unstick(bool),
    Arm,
    Disarm,
    Configure(u16),
    ResetBoard,
    StartBoard,
    Reopen,
    Garbage(Vec<u8>),
}

fn action() -> impl Strategy<Value = Action> {
    prop_oneof![
        6 => (1_u64..600).prop_map(Action::Run),
        2 => (0.0..0.08, 0.0..0.05).prop_map(|(corrupt, drop)| Action::Line(corrupt, drop)),
        1 => any::<bool>().prop_map(Action::Unstick),
        3 => Just(Action::Arm),
        1 => Just(Action::Disarm),
        2 => (1_u16..1_000).prop_map(Action::Configure),
        1 => Just(Action::ResetBoard),
        2 => Just(Action::StartBoard),
        1 => Just(Action::Reopen),
        1 => prop::collection::vec(any::<u8>(), 1..100).prop_map(Action::Garbage),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        failure_persistence: Some(Box::new(FileFailurePersistence::WithSource("regressions"))),
        ..ProptestConfig::default()
    })]

    #[test]
    fn on_any_line_the_board_is_never_ready_with_another_configuration_or_armed_without_a_request(
        seed in any::<u64>(),
        never_arm in any::<bool>(),
        actions in prop::collection::vec(action(), 1..40),
    ) {
        let mut world = World::new(seed, Faults::default());
        world.board = Some(TestBoard::started());
        world.driving = true;
        world.session.handle_opened(world.now_ns);
        for action in actions {
            match action {
                Action::Run(milliseconds) => {
                    for _ in 0..milliseconds {
                        world.run(1);
                        world.check();
                    }
                }
                Action::Line(corrupt, drop) => {
                    world.to_board.faults = Faults { corrupt, drop };
                    world.to_host.faults = Faults { corrupt, drop };
                }
                Action::Unstick(unstick) => world.to_board.stuck = !unstick,
                Action::Arm if never_arm => {}
                Action::Arm => world.arm(),
                Action::Disarm => {
                    world.session.disarm(world.now_ns);
                }
                Action::Configure(max_pose_age_ms) => {
                    let configuration = Configuration { max_pose_age_ms, ..configuration() };
                    // Refused while armed, which changes nothing.
                    let _ = world.session.configure(world.now_ns, configuration);
                }
                Action::ResetBoard => world.reset_board(),
                Action::StartBoard => {
                    world.to_board.clear();
                    world.arms_asked = 0;
                    world.board = Some(TestBoard::started());
                    // A request that is still pending may be sent to this one
                    // before its greeting is heard; it has no configuration.
                }
                Action::Reopen => {
                    let events = &mut world.events;
                    world.session.handle_closed(world.now_ns, &mut |event| events.push(event));
                    world.session.handle_opened(world.now_ns);
                }
                Action::Garbage(bytes) => world.to_host.put(world.now_ns, &bytes),
            }
            world.check();
        }
        // On a good line it always recovers.
        world.to_board.faults = Faults::default();
        world.to_host.faults = Faults::default();
        world.to_board.stuck = false;
        if world.board.is_none() {
            world.board = Some(TestBoard::started());
        }
        world.run(3_000);
        world.check();
        let is_ready = matches!(world.session.state(), State::Ready { .. });
        prop_assert!(is_ready, "{:?}", world.session.state());
    }

    #[test]
    fn random_bytes_never_panic_nor_connect(seed in any::<u64>(), length in 0_usize..5_000) {
        let mut noise = Random::new(seed);
        let mut session = Session::new(session_config()).unwrap();
        session.handle_opened(START_NS);
        let bytes: Vec<u8> = (0..length).map(|_| noise.bits() as u8).collect();
        let mut events = 0;
        for chunk in bytes.chunks(64) {
            session.handle_bytes(START_NS, chunk, &mut |_| events += 1);
        }
        prop_assert_eq!(events, 0);
        let is_greeting = matches!(session.state(), State::Greeting { .. });
        prop_assert!(is_greeting);
    }
}
