//! From an open port to a configured board, and back when it is lost.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use singletrack_link::{Event, LossCause, RestartEvidence, Session, Side, State};
use singletrack_protocol::{
    Acknowledgement, BoardMode, Identity, RefusalReason, Request, ResetCause, Sequence, Status,
    ToBoard, VERSION,
};

use crate::{Bench, MS, START_NS, configuration, session_config, telemetry};

fn is_hello(message: &ToBoard) -> bool {
    matches!(message, ToBoard::Hello(_))
}

fn is_configure(message: &ToBoard) -> bool {
    matches!(message, ToBoard::Configure(_))
}

#[test]
fn nothing_is_sent_through_a_closed_port() {
    let mut bench = Bench::new();
    bench.poll();
    assert_eq!(bench.session.poll_timeout(), None);
    bench.session.disarm(bench.now_ns);
    bench.pass_in_silence(1_000 * MS);
    assert!(bench.sent.is_empty());
    assert_eq!(bench.session.state(), State::Disconnected);
}

#[test]
fn a_configuration_that_every_board_would_refuse_is_an_error() {
    let mut config = session_config();
    config.configuration.max_pose_age_ms = 5_000;
    assert!(Session::new(config).is_err());
}

#[test]
fn the_first_byte_on_the_line_is_a_zero() {
    let mut bench = Bench::new();
    bench.session.handle_opened(bench.now_ns);
    let transmit = bench.session.poll_transmit(bench.now_ns).unwrap();
    assert_eq!(transmit.as_bytes()[0], 0);
}

#[test]
fn a_board_that_the_port_has_reset_is_greeted_until_it_answers() {
    let mut bench = Bench::opened();
    bench.pass_in_silence(1_000 * MS);
    // The bootloader uses another protocol at another rate.
    bench.bytes(&[0x14, 0x10, 0xff, 0xf8, 0x00, 0x80, 0x03, 0x00, 0x7e]);
    bench.pass_in_silence(1_000 * MS);
    let times = bench.sent_ms(START_NS, is_hello);
    assert_eq!(times, (0..=2_000).step_by(100).collect::<Vec<_>>());
    assert!(matches!(bench.session.state(), State::Greeting { since_ns } if since_ns == START_NS));

    // The board has started: it is greeted at once, not at the next interval.
    bench.pass_in_silence(30 * MS);
    bench.bytes(&[0]); // Ends the bootloader's last frame.
    bench.announce_restart();
    assert_eq!(bench.sent.last().unwrap().0, bench.now_ns);
    bench.answer_hello();
    assert!(bench.has(Event::Connected {
        board_software_version: [9, 8, 7]
    }));
    assert_eq!(bench.last_configure().configuration, configuration());
    assert_eq!(bench.session.state(), State::Configuring);
    bench.answer_configure();
    assert_eq!(bench.session.state(), State::Ready { mode: None });
    assert!(bench.has(Event::ConfigurationAccepted {
        hash: configuration().hash()
    }));
    assert_eq!(bench.session.counters().board_restarts, 0);
}

#[test]
fn telemetry_before_the_answer_to_the_greeting_is_ignored() {
    let mut bench = Bench::opened();
    bench.telemetry();
    assert!(bench.events.is_empty());
    assert_eq!(bench.session.counters().frames_ignored, 1);
}

#[test]
fn the_answer_to_another_greeting_is_ignored() {
    let mut bench = Bench::opened();
    let old = bench.nonce();
    bench.session.handle_closed(bench.now_ns, &mut |_| {});
    bench.session.handle_opened(bench.now_ns);
    bench.poll();
    assert_ne!(bench.nonce(), old);
    bench.hear(singletrack_protocol::Hello {
        protocol_version: VERSION,
        software_version: [0; 3],
        nonce: old,
    });
    assert!(matches!(bench.session.state(), State::Greeting { .. }));
}

#[test]
fn a_version_mismatch_names_both_versions_and_the_side_to_update() {
    let mut bench = Bench::opened();
    bench.answer_hello_as(VERSION + 1);
    let State::VersionMismatch(mismatch) = bench.session.state() else {
        panic!("{:?}", bench.session.state());
    };
    assert_eq!(mismatch.outdated(), Side::Host);
    let text = mismatch.to_string();
    assert!(text.contains(&format!("speaks protocol {}", VERSION + 1)));
    assert!(text.contains(&format!("speaks protocol {VERSION}")));
    assert!(text.contains("9.8.7") && text.contains("install the host software"));

    // Greeted again once a second, reported once, and sent nothing else.
    bench.sent.clear();
    for _ in 0..3 {
        bench.pass_in_silence(1_000 * MS);
        bench.answer_hello_as(VERSION + 1);
    }
    bench.session.emergency_stop(bench.now_ns);
    bench.pass_in_silence(500 * MS);
    assert_eq!(bench.sent.len(), 3);
    assert!(bench.sent.iter().all(|(_, message)| is_hello(message)));
    let reported = bench.events.iter();
    let reported = reported.filter(|event| matches!(event, Event::VersionMismatch(_)));
    assert_eq!(reported.count(), 1);
    assert!(bench.session.arm(bench.now_ns).is_err());

    // An older board must be flashed; a matching one connects.
    bench.pass_in_silence(500 * MS);
    bench.answer_hello_as(VERSION - 1);
    let State::VersionMismatch(mismatch) = bench.session.state() else {
        panic!("{:?}", bench.session.state());
    };
    assert_eq!(mismatch.outdated(), Side::Board);
    assert!(mismatch.to_string().contains("flash the board"));
    bench.pass_in_silence(1_000 * MS);
    bench.answer_hello();
    assert_eq!(bench.session.state(), State::Configuring);
}

#[test]
fn a_refused_configuration_is_a_state_with_its_reason() {
    let mut bench = Bench::opened();
    bench.answer_hello();
    let refused = RefusalReason::InvalidConfiguration;
    let sequence = bench.last_configure().request;
    bench.refuse(Request::Configure, sequence, refused);
    let state = State::ConfigurationRefused { reason: refused };
    assert_eq!(bench.session.state(), state);

    // Offered again after a second, reported once.
    bench.sent.clear();
    bench.pass(1_000 * MS);
    assert_eq!(bench.sent.len(), 1);
    let sequence = bench.last_configure().request;
    bench.refuse(Request::Configure, sequence, refused);
    assert_eq!(bench.session.state(), state);
    let reported = bench.events.iter();
    let reported = reported.filter(|event| matches!(event, Event::ConfigurationRefused { .. }));
    assert_eq!(reported.count(), 1);
    assert!(bench.session.arm(bench.now_ns).is_err());

    // Another configuration is offered at once.
    let mut other = configuration();
    other.max_pose_age_ms = 500;
    bench.session.configure(bench.now_ns, other).unwrap();
    bench.poll();
    assert_eq!(bench.last_configure().configuration, other);
    bench.answer_configure();
    assert!(bench.has(Event::ConfigurationAccepted { hash: other.hash() }));
}

#[test]
fn an_acknowledgement_of_another_configuration_is_not_ready() {
    let mut bench = Bench::opened();
    bench.answer_hello();
    let sequence = bench.last_configure().request;
    bench.hear(Acknowledgement {
        request: Request::Configure,
        sequence,
        configuration_hash: bench.session.configuration_hash() ^ 1,
    });
    assert_eq!(
        bench.session.state(),
        State::ConfigurationRefused {
            reason: RefusalReason::ConfigurationDiffers
        }
    );
}

#[test]
fn an_unanswered_configuration_is_sent_three_times_and_then_the_board_is_greeted_again() {
    let mut bench = Bench::opened();
    bench.answer_hello();
    let sequence = bench.last_configure().request;
    bench.pass(160 * MS);
    assert_eq!(bench.sent_ms(START_NS, is_configure), [0, 50, 100]);
    assert!(bench.has(Event::Unanswered {
        request: Request::Configure,
        sequence
    }));
    assert_eq!(bench.sent_ms(START_NS, is_hello), [0, 150]);
}

#[test]
fn the_link_is_lost_after_200_ms_and_found_again() {
    let mut bench = Bench::ready();
    bench.pass(1_000 * MS);
    bench.pass_in_silence(199 * MS);
    assert!(bench.is_ready());
    bench.sent.clear();
    let lost_ns = bench.now_ns + MS;
    bench.pass_in_silence(MS);
    assert!(bench.has(Event::Lost {
        cause: LossCause::Silence
    }));
    assert!(matches!(bench.session.state(), State::Greeting { .. }));
    bench.pass_in_silence(300 * MS);
    assert_eq!(bench.sent_ms(lost_ns, is_hello), [0, 100, 200, 300]);

    bench.answer_hello();
    bench.answer_configure();
    bench.board_mode = BoardMode::Failsafe;
    bench.telemetry();
    assert_eq!(
        bench.session.state(),
        State::Ready {
            mode: Some(BoardMode::Failsafe)
        }
    );
    assert_eq!(bench.session.counters().links_lost, 1);
}

#[test]
fn a_board_that_refused_the_configuration_can_be_lost_too() {
    let mut bench = Bench::opened();
    bench.answer_hello();
    let sequence = bench.last_configure().request;
    bench.refuse(Request::Configure, sequence, RefusalReason::Busy);
    bench.pass_in_silence(200 * MS);
    assert!(bench.has(Event::Lost {
        cause: LossCause::Silence
    }));
    assert!(matches!(bench.session.state(), State::Greeting { .. }));
}

#[test]
fn bytes_that_waited_for_a_late_owner_do_not_count_as_silence() {
    let mut bench = Bench::ready();
    bench.now_ns += 300 * MS;
    bench.board_time_us += 300_000;
    bench.telemetry();
    bench.timeout();
    assert!(bench.is_ready());
}

#[test]
fn damaged_frames_do_not_keep_the_link_alive() {
    let mut bench = Bench::ready();
    for _ in 0..20 {
        bench.pass_in_silence(10 * MS);
        bench.bytes(&[3, 1, 2, 0]);
    }
    assert!(bench.has(Event::Lost {
        cause: LossCause::Silence
    }));
}

#[test]
fn a_hang_up_is_a_loss_and_opening_again_recovers() {
    let mut bench = Bench::ready();
    let mut events = Vec::new();
    bench
        .session
        .handle_closed(bench.now_ns, &mut |event| events.push(event));
    bench
        .session
        .handle_closed(bench.now_ns, &mut |event| events.push(event));
    assert_eq!(
        events,
        [Event::Lost {
            cause: LossCause::HangUp
        }]
    );
    assert_eq!(bench.session.counters().hang_ups, 1);
    bench.session.handle_opened(bench.now_ns);
    bench.poll();
    bench.answer_hello();
    bench.answer_configure();
    assert!(bench.is_ready());
}

#[test]
fn an_unsolicited_hello_while_driving_configures_the_board_again_and_waits() {
    let mut bench = Bench::armed();
    bench.board_mode = BoardMode::Driving;
    bench.pass(500 * MS);
    bench.sent.clear();
    bench.announce_restart();
    assert!(bench.has(Event::BoardRestarted {
        evidence: RestartEvidence::Announced
    }));
    bench.answer_hello();
    bench.answer_configure();
    bench.board_mode = BoardMode::Neutral;
    bench.pass(1_000 * MS);
    assert_eq!(
        bench.session.state(),
        State::Ready {
            mode: Some(BoardMode::Neutral)
        }
    );
    let kinds: Vec<_> = bench.sent.iter().map(|(_, message)| *message).collect();
    assert!(matches!(
        kinds[..],
        [ToBoard::Hello(_), ToBoard::Configure(_)]
    ));
    assert_eq!(bench.session.counters().board_restarts, 1);
}

#[test]
fn a_restart_that_is_announced_after_the_loss_is_reported_once() {
    let mut bench = Bench::ready();
    bench.pass_in_silence(300 * MS);
    let nonce = bench.nonce();
    bench.announce_restart();
    bench.announce_restart();
    assert_ne!(bench.nonce(), nonce);
    assert_eq!(bench.session.counters().board_restarts, 1);
    bench.answer_hello();
    bench.answer_configure();
    assert!(bench.is_ready());
}

#[test]
fn the_bytes_of_a_bootloader_do_not_count_against_the_line() {
    let mut bench = Bench::opened();
    for _ in 0..50 {
        bench.bytes(&[3, 1, 2, 0]);
    }
    bench.answer_hello();
    let quality = bench.session.line_quality(bench.now_ns);
    assert_eq!(quality.damaged, 0);
    assert_eq!(bench.session.counters().crc_errors, 0);
    assert_eq!(bench.session.counters().decode_errors, 50);
}

#[test]
fn a_restart_without_an_announcement_is_detected_by_the_boards_clock() {
    let mut bench = Bench::armed();
    bench.board_time_us = 500;
    bench.pass(20 * MS);
    assert!(bench.has(Event::BoardRestarted {
        evidence: RestartEvidence::ClockRestarted
    }));
    assert!(matches!(bench.session.state(), State::Greeting { .. }));
}

#[test]
fn a_board_without_its_configuration_is_a_restarted_board() {
    let mut bench = Bench::ready();
    let status = Status {
        board_time_us: bench.board_time_us,
        configuration_hash: 0,
        reset_cause: ResetCause::Watchdog,
        stop_input_open: false,
        battery_mv: 7_400,
        frames_received: 0,
        frames_damaged: 0,
        drives_refused: 0,
        last_refusal: RefusalReason::None,
        frames_dropped: 0,
        bytes_overrun: 0,
        imu_errors: 0,
        supply_mv: 5_000,
        battery_open: false,
        power_on: false,
        edges_refused: 0,
        imu_calibration: 0xFF,
        imu_status: 5,
        imu_error: 0,
        imu_self_test: 0x0F,
    };
    bench.hear(status);
    assert!(bench.has(Event::Status(status)));
    assert!(bench.has(Event::BoardRestarted {
        evidence: RestartEvidence::ConfigurationGone
    }));
}

#[test]
fn a_session_that_was_not_polled_has_queued_nothing() {
    let mut bench = Bench::opened();
    bench.sent.clear();
    bench.now_ns += 10_000 * MS;
    bench.poll();
    assert_eq!(bench.sent.len(), 1);
}

#[test]
fn missing_and_impossible_records_are_counted() {
    let mut bench = Bench::ready();
    bench.pass(100 * MS);
    bench.pass_in_silence(40 * MS);
    bench.telemetry();
    assert_eq!(bench.session.counters().telemetry_missing, 3);
    let heard = bench.events.len();
    bench.hear(telemetry(
        bench.board_time_us.wrapping_sub(1),
        BoardMode::Driving,
        Sequence(0),
    ));
    assert_eq!(bench.session.counters().telemetry_implausible, 1);
    assert_eq!(bench.events.len(), heard);
}

#[test]
fn telemetry_comes_with_its_times() {
    let mut bench = Bench::ready();
    bench.pass(2_000 * MS);
    let Some(Event::Telemetry(record)) = bench.events.last() else {
        panic!("{:?}", bench.events.last());
    };
    assert_eq!(record.receive_time_ns, bench.now_ns);
    // 40 bytes of 10 bits at 115200 baud.
    let on_line_ns = record.receive_time_ns - record.board_time_host_ns;
    assert!((3_472_000..3_473_000).contains(&on_line_ns), "{on_line_ns}");
    assert_eq!(
        record.imu_time_host_ns,
        Some(record.board_time_host_ns - 4_200_000)
    );
    assert!(record.has_fresh_imu_sample());
}

#[test]
fn a_line_that_echoes_is_not_a_board() {
    let mut bench = Bench::opened();
    for _ in 0..300 {
        // Everything that is sent comes back, the greetings too.
        let sent: Vec<ToBoard> = bench.sent.drain(..).map(|(_, message)| message).collect();
        assert!(sent.iter().all(is_hello), "{sent:?}");
        for message in sent {
            bench.bytes(message.encode().as_bytes());
        }
        bench.pass_in_silence(10 * MS);
    }
    assert!(matches!(bench.session.state(), State::Greeting { since_ns } if since_ns == START_NS));
    assert!(bench.events.is_empty(), "{:?}", bench.events);
}

#[test]
fn a_board_whose_identity_is_lost_is_asked_again() {
    let mut bench = Bench::opened();
    let answer = singletrack_protocol::Hello {
        protocol_version: VERSION,
        software_version: [9, 8, 7],
        nonce: bench.nonce(),
    };
    bench.hear(answer);
    bench.telemetry();
    assert!(bench.events.is_empty(), "{:?}", bench.events);
    bench.sent.clear();
    bench.pass_in_silence(100 * MS);
    assert!(bench.sent.iter().any(|(_, message)| is_hello(message)));
    bench.hear(answer);
    bench.hear(Identity { car_id: 7 });
    assert!(bench.has(Event::Identified { car_id: 7 }));
    assert_eq!(bench.session.state(), State::Configuring);
}

#[test]
fn the_board_names_its_car_after_the_greeting() {
    let mut bench = Bench::opened();
    bench.poll();
    // Before the answer, only the greeting means anything.
    bench.hear(Identity { car_id: 3 });
    assert!(!bench.has(Event::Identified { car_id: 3 }));
    bench.answer_hello();
    bench.hear(Identity { car_id: 7 });
    assert!(bench.has(Event::Identified { car_id: 7 }));
}
