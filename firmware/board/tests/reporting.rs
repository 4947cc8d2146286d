//! Messages to the host.

use singletrack_board::{Board, ImuSample, Inputs};
use singletrack_protocol::{
    Decoder, Disarm, Hello, ImuState, Request, ResetCause, Sequence, ToBoard, ToHost, UNNAMED,
    UNSOLICITED, VERSION,
};

use crate::{MS, Rig, SOFTWARE_VERSION, configuration};

fn hellos(rig: &Rig) -> Vec<Hello> {
    rig.messages
        .iter()
        .filter_map(|(_, message)| match message {
            ToHost::Hello(hello) => Some(*hello),
            _ => None,
        })
        .collect()
}

fn times(rig: &Rig, filter: fn(&ToHost) -> bool) -> Vec<u32> {
    rig.messages
        .iter()
        .filter(|(_, message)| filter(message))
        .map(|(time, _)| *time)
        .collect()
}

#[test]
fn the_announcement_after_a_reset_within_a_frame_is_received() {
    let mut before = Board::new(ResetCause::PowerOn, SOFTWARE_VERSION, UNNAMED);
    let mut cut = Vec::new();
    before.poll(0, &Inputs::default(), &[], &mut |bytes: &[u8]| {
        cut.extend_from_slice(bytes);
        true
    });
    cut.pop();
    let mut decoder = Decoder::new();
    let decoded = cut
        .iter()
        .filter_map(|&byte| decoder.push(byte).map(|_| ()));
    assert!(decoded.count() >= 1);

    let mut after = Board::new(ResetCause::Watchdog, SOFTWARE_VERSION, UNNAMED);
    let mut hellos = Vec::new();
    after.poll(0, &Inputs::default(), &[], &mut |bytes: &[u8]| {
        for &byte in bytes {
            if let Some(Ok(packet)) = decoder.push(byte)
                && let Ok(ToHost::Hello(hello)) = ToHost::decode(packet)
            {
                hellos.push(hello.nonce);
            }
        }
        true
    });
    assert_eq!(hellos, [UNSOLICITED]);
}

#[test]
fn the_board_announces_its_start_once_before_other_messages() {
    let mut rig = Rig::new();
    rig.line_open = false;
    rig.run(50 * MS);
    rig.line_open = true;
    rig.run(3_000 * MS);
    let announcement = Hello {
        protocol_version: VERSION,
        software_version: SOFTWARE_VERSION,
        nonce: UNSOLICITED,
    };
    assert_eq!(hellos(&rig), [announcement]);
    assert_eq!(
        rig.messages.first().map(|message| message.1),
        Some(announcement.into())
    );
}

#[test]
fn a_greeting_of_any_version_is_answered_with_its_nonce() {
    for protocol_version in [VERSION, 0, 0xFFFF] {
        let mut rig = Rig::new();
        rig.poll(&[]);
        rig.messages.clear();
        rig.send(Hello {
            protocol_version,
            software_version: [0; 3],
            nonce: 42,
        });
        let nonces: Vec<_> = hellos(&rig).iter().map(|hello| hello.nonce).collect();
        assert_eq!(nonces, [42]);
        assert_eq!(hellos(&rig)[0].protocol_version, VERSION);
    }
}

#[test]
fn an_echoed_announcement_is_not_answered() {
    let mut rig = Rig::new();
    rig.poll(&[]);
    rig.messages.clear();
    rig.greet(UNSOLICITED);
    assert_eq!(hellos(&rig), []);
}

#[test]
fn telemetry_every_10_ms_and_status_every_200_ms_for_any_poll_rate() {
    for poll_us in [100, 700, 1_000, 3_000] {
        let mut rig = Rig::starting_at(u32::MAX - 500 * MS);
        rig.poll_us = poll_us;
        rig.run(2_000 * MS);
        let telemetry = times(&rig, |message| matches!(message, ToHost::Telemetry(_)));
        assert!(
            (199..=201).contains(&telemetry.len()),
            "{poll_us}: {}",
            telemetry.len()
        );
        for pair in telemetry.windows(2) {
            let gap = pair[1].wrapping_sub(pair[0]);
            assert!(gap.abs_diff(10 * MS) < poll_us.max(1), "{poll_us}: {gap}");
        }
        let status = times(&rig, |message| matches!(message, ToHost::Status(_)));
        assert!(
            (10..=11).contains(&status.len()),
            "{poll_us}: {}",
            status.len()
        );
    }
}

#[test]
fn a_full_line_drops_whole_records_and_counts_them() {
    let mut rig = Rig::ready_with(configuration());
    let before = rig.status().frames_dropped;
    rig.line_open = false;
    rig.run(100 * MS);
    rig.line_open = true;
    let dropped = rig.status().frames_dropped - before;
    assert!((10..=11).contains(&dropped), "{dropped}");
}

#[test]
fn every_request_is_answered_with_its_number_and_the_hash_in_force() {
    let mut rig = Rig::ready_with(configuration());
    rig.send(Disarm {
        request: Sequence(99),
    });
    let answered = rig
        .messages
        .iter()
        .rev()
        .find_map(|(_, message)| match message {
            ToHost::Acknowledgement(yes) => Some(*yes),
            _ => None,
        });
    let Some(yes) = answered else {
        panic!("no answer")
    };
    assert_eq!((yes.request, yes.sequence), (Request::Disarm, Sequence(99)));
    assert_eq!(yes.configuration_hash, configuration().hash());
}

#[test]
fn an_imu_sample_is_fresh_once_then_repeated_then_silent() {
    let mut rig = Rig::new();
    rig.run(100 * MS);
    assert_eq!(rig.telemetry().imu, ImuState::Silent);
    let sample = ImuSample {
        time_us: rig.now - 700,
        linear_acceleration_mm_s2: [1, 2, 3],
        angular_velocity_mrad_s: [4, 5, 6],
        attitude_q14: [7, 8, 9, 10],
    };
    rig.inputs.imu = Some(sample);
    rig.messages.clear();
    rig.run(70 * MS);
    let records: Vec<_> = rig
        .messages
        .iter()
        .filter_map(|(_, message)| match message {
            ToHost::Telemetry(telemetry) => Some(*telemetry),
            _ => None,
        })
        .collect();
    let states: Vec<_> = records.iter().map(|record| record.imu).collect();
    assert_eq!(states[0], ImuState::Fresh);
    assert_eq!(states[1..4], [ImuState::Repeated; 3]);
    assert_eq!(states[5..], [ImuState::Silent; 2]);
    for record in &records {
        assert_eq!(record.linear_acceleration_mm_s2, [1, 2, 3]);
        assert_eq!(record.angular_velocity_mrad_s, [4, 5, 6]);
        assert_eq!(record.attitude_q14, [7, 8, 9, 10]);
        let age = record.board_time_us.wrapping_sub(sample.time_us) / 100;
        assert_eq!(u32::from(record.imu_age_100us), age.min(255));
    }
}

#[test]
fn every_new_sample_is_fresh_and_replaces_the_one_before() {
    // The first sample has time zero, the value before any sample.
    let mut rig = Rig::starting_at(0);
    for time_us in [0, 40_000, 80_000] {
        rig.inputs.imu = Some(ImuSample {
            time_us,
            angular_velocity_mrad_s: [(time_us / MS) as i16, 0, 0],
            ..ImuSample::default()
        });
        let mut fresh = 0;
        while rig.now < time_us + 40 * MS {
            rig.run(10 * MS);
            let telemetry = rig.telemetry();
            fresh += u32::from(telemetry.imu == ImuState::Fresh);
            assert_ne!(telemetry.imu, ImuState::Silent);
            assert_eq!(
                telemetry.angular_velocity_mrad_s[0],
                (time_us / MS) as i16,
                "{time_us}"
            );
        }
        assert_eq!(fresh, 1, "{time_us}");
    }
}

#[test]
fn a_reset_cause_set_late_is_reported() {
    let mut rig = Rig::new();
    rig.board.set_reset_cause(ResetCause::BrownOut);
    assert_eq!(rig.status().reset_cause, ResetCause::BrownOut);
}

#[test]
fn a_sample_in_a_dropped_record_stays_fresh() {
    let mut rig = Rig::new();
    rig.run(100 * MS);
    rig.inputs.imu = Some(ImuSample {
        time_us: rig.now,
        ..ImuSample::default()
    });
    rig.line_open = false;
    rig.run(15 * MS);
    rig.line_open = true;
    rig.run(10 * MS);
    assert_eq!(rig.telemetry().imu, ImuState::Fresh);
}

#[test]
fn status_reports_inputs_and_counters() {
    let mut rig = Rig::ready_with(configuration());
    rig.inputs.battery_mv = 7_400;
    rig.inputs.bytes_overrun = 3;
    rig.inputs.imu_errors = 4;
    let before = rig.status();
    let mut damaged = ToBoard::from(Disarm {
        request: Sequence(1),
    })
    .encode()
    .as_bytes()
    .to_vec();
    damaged[2] ^= 0x10;
    rig.poll(&damaged);
    // A valid frame of a type that only the board sends.
    let echo = ToHost::from(singletrack_protocol::Refusal {
        request: Request::Arm,
        sequence: Sequence(1),
        reason: singletrack_protocol::RefusalReason::Busy,
    });
    rig.poll(echo.encode().as_bytes());
    rig.drive(1, 1);
    let status = rig.status();
    assert_eq!(status.battery_mv, 7_400);
    assert_eq!((status.bytes_overrun, status.imu_errors), (3, 4));
    assert_eq!(status.frames_damaged, before.frames_damaged + 2);
    assert_eq!(status.frames_received, before.frames_received + 1);
    assert_eq!(status.drives_refused, 1);
    assert_eq!(status.reset_cause, ResetCause::PowerOn);
    assert_eq!(status.configuration_hash, configuration().hash());
}
