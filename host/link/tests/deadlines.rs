//! Nothing happens before the deadline, and something happens at it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use proptest::prelude::*;
use singletrack_protocol::{BoardMode, Configuration, RefusalReason, Request, Sequence, VERSION};

use crate::{Bench, MS, configuration};

/// An input, a request, or time that passes.
#[derive(Clone, Copy, Debug)]
enum Action {
    Open,
    Close,
    Hello { version: u16 },
    Restart,
    AcknowledgeConfigure,
    RefuseConfigure,
    Telemetry(BoardMode),
    Arm,
    AcknowledgeArm,
    Disarm,
    AcknowledgeDisarm,
    EmergencyStop,
    Configure { max_pose_age_ms: u16 },
    Noise(u8),
    Silence { us: u64 },
}

fn action() -> impl Strategy<Value = Action> {
    prop_oneof![
        1 => Just(Action::Open),
        1 => Just(Action::Close),
        1 => prop_oneof![Just(VERSION), Just(VERSION + 1)].prop_map(|version| Action::Hello { version }),
        1 => Just(Action::Restart),
        3 => Just(Action::AcknowledgeConfigure),
        1 => Just(Action::RefuseConfigure),
        6 => prop_oneof![
            Just(BoardMode::Neutral),
            Just(BoardMode::Armed),
            Just(BoardMode::Driving),
            Just(BoardMode::EmergencyStopped),
        ].prop_map(Action::Telemetry),
        3 => Just(Action::Arm),
        1 => Just(Action::AcknowledgeArm),
        1 => Just(Action::Disarm),
        1 => Just(Action::AcknowledgeDisarm),
        1 => Just(Action::EmergencyStop),
        1 => (100..900_u16).prop_map(|max_pose_age_ms| Action::Configure { max_pose_age_ms }),
        1 => any::<u8>().prop_map(Action::Noise),
        6 => (0..300_000_u64).prop_map(|us| Action::Silence { us }),
    ]
}

/// What the test remembers of the requests.
#[derive(Default)]
struct Numbers {
    arm: Option<Sequence>,
    stop: Option<Sequence>,
}

fn act(bench: &mut Bench, numbers: &mut Numbers, action: Action) {
    let greeted = !bench.sent.is_empty();
    match action {
        Action::Open => bench.session.handle_opened(bench.now_ns),
        Action::Close => bench.session.handle_closed(bench.now_ns, &mut |_| {}),
        Action::Hello { version } if greeted => bench.answer_hello_as(version),
        Action::Restart => bench.announce_restart(),
        Action::AcknowledgeConfigure if has_configure(bench) => bench.answer_configure(),
        Action::RefuseConfigure if has_configure(bench) => {
            let sequence = bench.last_configure().request;
            bench.refuse(
                Request::Configure,
                sequence,
                RefusalReason::ConfigurationDiffers,
            );
        }
        Action::Telemetry(mode) => {
            bench.board_mode = mode;
            bench.pass(10 * MS);
        }
        Action::Arm => numbers.arm = bench.session.arm(bench.now_ns).ok().or(numbers.arm),
        Action::AcknowledgeArm => {
            if let Some(arm) = numbers.arm {
                bench.acknowledge(Request::Arm, arm);
            }
        }
        Action::Disarm => numbers.stop = Some(bench.session.disarm(bench.now_ns)),
        Action::AcknowledgeDisarm => {
            if let Some(stop) = numbers.stop {
                bench.acknowledge(Request::Disarm, stop);
            }
        }
        Action::EmergencyStop => numbers.stop = Some(bench.session.emergency_stop(bench.now_ns)),
        Action::Configure { max_pose_age_ms } => {
            let configuration = Configuration {
                max_pose_age_ms,
                ..configuration()
            };
            // Refused while armed; nothing is changed then.
            let _ = bench.session.configure(bench.now_ns, configuration);
        }
        Action::Noise(byte) => bench.bytes(&[byte; 5]),
        Action::Silence { us } => bench.pass_in_silence(us * 1_000),
        Action::Hello { .. } | Action::AcknowledgeConfigure | Action::RefuseConfigure => {}
    }
    bench.timeout();
}

fn has_configure(bench: &Bench) -> bool {
    bench
        .sent
        .iter()
        .any(|(_, message)| matches!(message, singletrack_protocol::ToBoard::Configure(_)))
}

/// Asserts that the session does nothing by itself from now to its deadline.
#[track_caller]
fn assert_idle_until_deadline(bench: &mut Bench, part_way: f64) {
    let deadline_ns = bench.session.poll_timeout();
    let last_ns = deadline_ns.map_or(u64::MAX, |deadline_ns| deadline_ns - 1);
    let wait_ns = last_ns.checked_sub(bench.now_ns).unwrap();
    let before = format!("{:?}", bench.session);
    for at_ns in [
        bench.now_ns,
        bench.now_ns + (wait_ns as f64 * part_way) as u64,
        last_ns,
    ] {
        bench.session.handle_timeout(at_ns, &mut |event| {
            panic!("{event:?} at {at_ns}, due at {deadline_ns:?}");
        });
        assert_eq!(bench.session.poll_transmit(at_ns), None);
        assert_eq!(format!("{:?}", bench.session), before);
    }
}

proptest! {
    #[test]
    fn before_its_deadline_a_session_does_nothing(
        steps in prop::collection::vec((action(), 0.0..1.0_f64), 1..60),
    ) {
        let mut bench = Bench::opened();
        let mut numbers = Numbers::default();
        for (action, part_way) in steps {
            act(&mut bench, &mut numbers, action);
            assert_idle_until_deadline(&mut bench, part_way);
        }
    }

    #[test]
    fn at_its_deadline_a_session_acts(
        steps in prop::collection::vec(action(), 1..40),
    ) {
        let mut bench = Bench::opened();
        let mut numbers = Numbers::default();
        for action in steps {
            act(&mut bench, &mut numbers, action);
        }
        if let Some(deadline_ns) = bench.session.poll_timeout() {
            let before = format!("{:?}", bench.session);
            bench.pass_in_silence(deadline_ns - bench.now_ns);
            prop_assert_ne!(format!("{:?}", bench.session), before);
            prop_assert!(bench.session.poll_timeout() > Some(deadline_ns));
        }
    }
}
