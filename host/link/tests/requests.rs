//! Arming, stopping and driving.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use singletrack_link::{DriveCommand, DriveError, Event, JogCommand, NotReady};
use singletrack_protocol::{BoardMode, Drive, RefusalReason, Request, Sequence, ToBoard};

use crate::{Bench, MS, START_NS, configuration, to_board};

const COMMAND: DriveCommand = DriveCommand {
    speed_m_s: 0.4,
    steering_rad: 0.33,
    brake: false,
    pose_time_ns: None,
};

fn is_arm(message: &ToBoard) -> bool {
    matches!(message, ToBoard::Arm(_))
}

fn drive(bench: &mut Bench, command: DriveCommand) -> Drive {
    let frame = bench.session.drive(bench.now_ns, command).unwrap();
    match to_board(frame.as_bytes())[..] {
        [ToBoard::Drive(drive)] => drive,
        ref other => panic!("{other:?}"),
    }
}

#[test]
fn arming_carries_the_configurations_hash_and_the_newest_telemetry() {
    let mut bench = Bench::ready();
    let sequence = bench.session.arm(bench.now_ns).unwrap();
    bench.poll();
    let [(_, ToBoard::Arm(arm))] = bench.sent[..] else {
        panic!("{:?}", bench.sent);
    };
    assert_eq!(arm.request, sequence);
    assert_eq!(arm.configuration_hash, configuration().hash());
    assert_eq!(arm.telemetry_time_us, bench.board_time_us);
    bench.acknowledge(Request::Arm, sequence);
    assert!(bench.has(Event::Acknowledged {
        request: Request::Arm,
        sequence
    }));
    bench.pass(500 * MS);
    assert_eq!(bench.sent.len(), 1);
}

#[test]
fn an_unanswered_arm_is_sent_three_times_with_the_time_of_each_and_dropped() {
    let mut bench = Bench::ready();
    let start_ns = bench.now_ns;
    let sequence = bench.session.arm(bench.now_ns).unwrap();
    bench.poll();
    bench.pass(400 * MS);
    assert_eq!(bench.sent_ms(start_ns, is_arm), [0, 50, 100]);
    let times: Vec<_> = bench
        .sent
        .iter()
        .map(|(_, message)| match message {
            ToBoard::Arm(arm) => arm.telemetry_time_us,
            other => panic!("{other:?}"),
        })
        .collect();
    assert!(times.is_sorted_by(|a, b| a < b), "{times:?}");
    assert!(bench.has(Event::Unanswered {
        request: Request::Arm,
        sequence
    }));
    assert_eq!(bench.session.counters().requests_unanswered, 1);
    // It may be requested again.
    assert!(bench.session.arm(bench.now_ns).is_ok());
}

#[test]
fn a_refused_arm_reports_the_reason_and_is_not_repeated() {
    let mut bench = Bench::ready();
    let sequence = bench.session.arm(bench.now_ns).unwrap();
    bench.poll();
    let reason = RefusalReason::NotYetNeutral;
    bench.refuse(Request::Arm, sequence, reason);
    bench.pass(300 * MS);
    assert!(bench.has(Event::Refused {
        request: Request::Arm,
        sequence,
        reason
    }));
    assert_eq!(bench.sent.len(), 1);
}

#[test]
fn an_answer_to_an_earlier_request_is_ignored() {
    let mut bench = Bench::ready();
    let sequence = bench.session.arm(bench.now_ns).unwrap();
    bench.poll();
    bench.acknowledge(Request::Arm, Sequence(sequence.0.wrapping_sub(1)));
    bench.refuse(
        Request::Arm,
        Sequence(sequence.0.wrapping_add(1)),
        RefusalReason::Moving,
    );
    assert!(bench.events.is_empty());
    assert_eq!(bench.session.arm(bench.now_ns), Err(NotReady::ArmPending));
}

#[test]
fn a_board_that_telemetry_showed_armed_is_not_asked_again_after_it_stopped_itself() {
    let mut bench = Bench::ready();
    let sequence = bench.session.arm(bench.now_ns).unwrap();
    bench.poll();
    // The acknowledgement is lost; the board arms and then stops itself.
    bench.board_mode = BoardMode::Armed;
    bench.pass(20 * MS);
    bench.board_mode = BoardMode::Failsafe;
    bench.pass(300 * MS);
    assert!(bench.has(Event::Acknowledged {
        request: Request::Arm,
        sequence
    }));
    assert_eq!(bench.sent_ms(START_NS, is_arm).len(), 1);
}

#[test]
fn a_request_to_arm_survives_neither_loss_nor_restart_nor_stop_nor_hang_up() {
    for case in 0..4 {
        let mut bench = Bench::ready();
        bench.session.arm(bench.now_ns).unwrap();
        match case {
            0 => bench.pass_in_silence(250 * MS),
            1 => bench.announce_restart(),
            2 => {
                bench.session.disarm(bench.now_ns);
            }
            _ => {
                bench.session.handle_closed(bench.now_ns, &mut |_| {});
                bench.session.handle_opened(bench.now_ns);
                bench.poll();
            }
        }
        bench.sent.retain(|(_, message)| !is_arm(message));
        if case != 2 {
            bench.answer_hello();
            bench.answer_configure();
        }
        bench.pass(500 * MS);
        assert!(bench.is_ready(), "case {case}");
        assert_eq!(bench.sent_ms(START_NS, is_arm), [0; 0], "case {case}");
    }
}

#[test]
fn a_new_configuration_is_not_given_to_an_armed_board() {
    let mut bench = Bench::armed();
    assert!(
        bench
            .session
            .configure(bench.now_ns, configuration())
            .is_err()
    );
    assert!(bench.is_ready());
}

#[test]
fn a_disarm_is_repeated_until_telemetry_after_its_answer_shows_it() {
    let mut bench = Bench::armed();
    bench.board_mode = BoardMode::Driving;
    let start_ns = bench.now_ns;
    let sequence = bench.session.disarm(bench.now_ns);
    bench.poll();
    bench.pass(500 * MS);
    let disarms = bench.sent_ms(
        start_ns,
        |message| matches!(message, ToBoard::Disarm(disarm) if disarm.request == sequence),
    );
    assert_eq!(disarms, (0..=500).step_by(50).collect::<Vec<_>>());

    // The board may be neutral and still, without an answer, be about to arm.
    bench.board_mode = BoardMode::Neutral;
    bench.telemetry_and_stop_pending(true);
    bench.acknowledge(Request::Disarm, sequence);
    assert!(bench.session.is_stop_pending());
    bench.pass(10 * MS);
    assert!(!bench.session.is_stop_pending());
    assert!(bench.has(Event::StopConfirmed {
        request: Request::Disarm
    }));
}

#[test]
fn the_answer_to_an_earlier_stop_confirms_nothing() {
    let mut bench = Bench::ready();
    let sequence = bench.session.disarm(bench.now_ns);
    bench.acknowledge(Request::Disarm, Sequence(sequence.0.wrapping_sub(2)));
    bench.acknowledge(Request::EmergencyStop, sequence);
    bench.pass(100 * MS);
    assert!(bench.session.is_stop_pending());
    bench.acknowledge(Request::Disarm, sequence);
    bench.pass(10 * MS);
    assert!(!bench.session.is_stop_pending());
}

#[test]
fn while_a_stop_is_pending_nothing_drives_or_arms() {
    let mut bench = Bench::armed();
    bench.session.disarm(bench.now_ns);
    assert_eq!(
        bench.session.drive(bench.now_ns, COMMAND),
        Err(NotReady::StopPending.into())
    );
    assert_eq!(bench.session.arm(bench.now_ns), Err(NotReady::StopPending));
}

#[test]
fn a_stop_asked_twice_is_one_and_an_emergency_stop_takes_the_place_of_a_disarm() {
    let mut bench = Bench::armed();
    let start_ns = bench.now_ns;
    let disarm = bench.session.disarm(bench.now_ns);
    bench.poll();
    assert_eq!(bench.session.disarm(bench.now_ns), disarm);
    bench.sent.clear();
    let stop = bench.session.emergency_stop(bench.now_ns);
    assert_ne!(stop, disarm);
    bench.poll();
    bench.pass(120 * MS);
    let stops = bench.sent_ms(
        start_ns,
        |message| matches!(message, ToBoard::EmergencyStop(sent) if sent.request == stop),
    );
    assert_eq!(stops, [0, 50, 100]);
    assert_eq!(bench.sent.len(), stops.len());
}

#[test]
fn an_emergency_stop_is_sent_through_loss_and_hang_up_until_it_is_latched() {
    let mut bench = Bench::armed();
    bench.session.emergency_stop(bench.now_ns);
    bench.poll();
    // The board is silent for a second: the stop is still sent, in case it can hear.
    bench.sent.clear();
    bench.pass_in_silence(1_000 * MS);
    let stops = |message: &ToBoard| matches!(message, ToBoard::EmergencyStop(_));
    assert_eq!(bench.sent_ms(START_NS, stops).len(), 20);

    bench.session.handle_closed(bench.now_ns, &mut |_| {});
    bench.session.handle_opened(bench.now_ns);
    bench.poll();
    bench.sent.retain(|(_, message)| !stops(message));
    bench.answer_hello();
    assert_eq!(bench.sent_ms(START_NS, stops).len(), 1);
    bench.answer_configure();
    // A later disarm does not replace it.
    bench.session.disarm(bench.now_ns);
    bench.board_mode = BoardMode::EmergencyStopped;
    bench.pass(10 * MS);
    assert!(bench.has(Event::StopConfirmed {
        request: Request::EmergencyStop
    }));
    assert!(!bench.session.is_stop_pending());
}

#[test]
fn only_an_armed_board_is_driven() {
    let mut bench = Bench::opened();
    assert_eq!(
        bench.session.drive(bench.now_ns, COMMAND),
        Err(NotReady::NotConfigured.into())
    );
    bench.answer_hello();
    bench.answer_configure();
    assert_eq!(
        bench.session.drive(bench.now_ns, COMMAND),
        Err(NotReady::NoTelemetry.into())
    );
    bench.pass(10 * MS);
    assert_eq!(
        bench.session.drive(bench.now_ns, COMMAND),
        Err(NotReady::NotArmed {
            mode: BoardMode::Neutral
        }
        .into())
    );
}

#[test]
fn a_command_carries_the_age_of_its_inputs() {
    let mut bench = Bench::armed();
    bench.pass(1_000 * MS);
    let record_time_ns = bench.now_ns - 3_472_222;
    let newest_us = bench.board_time_us;
    // Time passes without telemetry: the board adds that itself.
    bench.pass_in_silence(60 * MS);
    let mut command = COMMAND;
    command.pose_time_ns = Some(record_time_ns - 20 * MS);
    let message = drive(&mut bench, command);
    assert_eq!(message.telemetry_time_us, newest_us);
    assert_eq!(message.pose_age_ms, 20);
    assert_eq!((message.speed_mm_s, message.steering_100urad), (400, 3_300));
    command.pose_time_ns = Some(record_time_ns - 20 * MS - 1_000);
    assert_eq!(drive(&mut bench, command).pose_age_ms, 21);
    command.pose_time_ns = Some(bench.now_ns);
    assert_eq!(drive(&mut bench, command).pose_age_ms, 0);
    assert_eq!(drive(&mut bench, COMMAND).pose_age_ms, u16::MAX);
}

#[test]
fn numbering_continues_from_the_last_accepted_command() {
    let mut bench = Bench::armed();
    let first = drive(&mut bench, COMMAND).sequence;
    assert!(first.is_newer_than(bench.last_sequence));
    assert_eq!(drive(&mut bench, COMMAND).sequence, first.next());
    // After any number of lost commands the next one is still newer.
    for _ in 0..976 {
        let sequence = drive(&mut bench, COMMAND).sequence;
        assert!(sequence.is_newer_than(bench.last_sequence));
    }
}

#[test]
fn a_command_that_cannot_be_sent_uses_up_no_number() {
    let mut bench = Bench::armed();
    let first = drive(&mut bench, COMMAND).sequence;
    let sent = bench.session.counters().frames_sent;
    for speed_m_s in [f64::NAN, f64::INFINITY, 33.0] {
        let command = DriveCommand {
            speed_m_s,
            ..COMMAND
        };
        assert!(matches!(
            bench.session.drive(bench.now_ns, command),
            Err(DriveError::NotFinite { .. } | DriveError::OutOfRange { .. })
        ));
    }
    assert_eq!(bench.session.counters().frames_sent, sent);
    assert_eq!(drive(&mut bench, COMMAND).sequence, first.next());
}

#[test]
fn commands_made_for_a_stuck_line_all_name_the_same_old_telemetry() {
    let mut bench = Bench::armed();
    let newest_us = bench.board_time_us;
    for _ in 0..15 {
        bench.pass_in_silence(10 * MS);
        let message = drive(&mut bench, COMMAND);
        assert_eq!(message.telemetry_time_us, newest_us);
        // The session itself sends nothing.
        assert!(bench.sent.is_empty());
    }
    // Then the session reports the loss.
    bench.pass_in_silence(60 * MS);
    assert_eq!(
        bench.session.drive(bench.now_ns, COMMAND),
        Err(NotReady::NotConfigured.into())
    );
}

#[test]
fn the_round_trip_is_measured_from_command_to_first_echo() {
    let mut bench = Bench::armed();
    assert_eq!(bench.session.round_trip(), None);
    for delay_ms in [12, 7, 9] {
        bench.last_sequence = drive(&mut bench, COMMAND).sequence;
        bench.pass_in_silence(delay_ms * MS);
        bench.telemetry();
        bench.pass_in_silence(10 * MS);
        bench.telemetry();
    }
    let round_trip = bench.session.round_trip().unwrap();
    assert_eq!(round_trip.min_ns, 7 * MS);
    assert_eq!(round_trip.last_ns, 9 * MS);
}

#[test]
fn an_echo_from_before_a_loss_measures_no_round_trip() {
    let mut bench = Bench::armed();
    bench.last_sequence = drive(&mut bench, COMMAND).sequence;
    bench.pass_in_silence(250 * MS);
    bench.answer_hello();
    bench.answer_configure();
    bench.pass(100 * MS);
    assert_eq!(bench.session.round_trip(), None);
}

#[test]
fn the_quality_of_the_line_is_that_of_the_last_second() {
    let mut bench = Bench::ready();
    assert_eq!(
        bench.session.line_quality(bench.now_ns).damaged_fraction(),
        None
    );
    for _ in 0..50 {
        bench.pass(10 * MS);
        bench.bytes(&[3, 1, 2, 0]);
    }
    let quality = bench.session.line_quality(bench.now_ns);
    assert!((quality.damaged_fraction().unwrap() - 0.5).abs() < 0.03);
    bench.pass(1_100 * MS);
    let quality = bench.session.line_quality(bench.now_ns);
    assert_eq!(quality.damaged_fraction(), Some(0.0));
}

impl Bench {
    fn telemetry_and_stop_pending(&mut self, pending: bool) {
        self.pass(10 * MS);
        assert_eq!(self.session.is_stop_pending(), pending);
    }
}

#[test]
fn a_board_that_powers_the_esc_up_is_armed_but_gets_no_commands() {
    let mut bench = Bench::ready();
    bench.telemetry();
    bench.session.arm(bench.now_ns).unwrap();
    bench.timeout();
    bench.pass_in_silence(MS);
    bench.board_mode = BoardMode::PoweringUp;
    bench.telemetry();
    // The telemetry stands for a lost acknowledgement.
    assert!(bench.events.iter().any(|event| matches!(
        event,
        Event::Acknowledged {
            request: Request::Arm,
            ..
        }
    )));
    assert_eq!(bench.session.arm(bench.now_ns), Err(NotReady::Armed));
    assert!(bench.session.drive(bench.now_ns, COMMAND).is_err());
    bench.board_mode = BoardMode::Armed;
    bench.pass_in_silence(10 * MS);
    bench.telemetry();
    let braking = DriveCommand {
        brake: true,
        ..COMMAND
    };
    let frame = bench.session.drive(bench.now_ns, braking).unwrap();
    let [ToBoard::Drive(drive)] = to_board(frame.as_bytes())[..] else {
        panic!("no command");
    };
    assert!(drive.brake);
}

#[test]
fn pulses_go_to_a_board_that_is_armed_or_jogs_and_to_no_other() {
    const PULSES: JogCommand = JogCommand {
        servo_us: 1_400,
        esc_us: 1_560,
    };
    for mode in BoardMode::ALL {
        let mut bench = Bench::armed();
        bench.board_mode = mode;
        bench.pass(10 * MS);
        let outcome = bench.session.jog(bench.now_ns, PULSES);
        if !matches!(mode, BoardMode::Armed | BoardMode::Jogging) {
            assert_eq!(outcome.unwrap_err(), NotReady::NotArmed { mode });
            continue;
        }
        let messages = to_board(outcome.unwrap().as_bytes());
        let [ToBoard::Jog(first)] = messages.as_slice() else {
            panic!("{messages:?}");
        };
        assert_eq!((first.servo_us, first.esc_us), (1_400, 1_560));
        let again = bench.session.jog(bench.now_ns, PULSES).unwrap();
        let messages = to_board(again.as_bytes());
        let [ToBoard::Jog(second)] = messages.as_slice() else {
            panic!("{messages:?}");
        };
        assert_eq!(second.sequence, first.sequence.next());
    }
    let mut bench = Bench::armed();
    bench.session.disarm(bench.now_ns);
    assert_eq!(
        bench.session.jog(bench.now_ns, PULSES).unwrap_err(),
        NotReady::StopPending
    );
}

#[test]
fn a_jogging_board_is_armed_and_takes_no_drive() {
    let mut bench = Bench::armed();
    bench.board_mode = BoardMode::Jogging;
    bench.pass(10 * MS);
    assert_eq!(
        bench.session.drive(bench.now_ns, COMMAND),
        Err(NotReady::NotArmed {
            mode: BoardMode::Jogging
        }
        .into())
    );
    assert_eq!(bench.session.arm(bench.now_ns), Err(NotReady::Armed));
    assert!(
        bench
            .session
            .configure(bench.now_ns, configuration())
            .is_err()
    );
}
