//! The kill output, the car's identity, and what the board reports of its health.

use singletrack_board::{Board, ImuHealth, Inputs};
use singletrack_protocol::{
    BoardMode, Configuration, RefusalReason, ResetCause, StopCause, ToHost,
};

use crate::{MS, NEUTRAL, Rig, SOFTWARE_VERSION, configuration};

fn with_kill_output() -> Configuration {
    Configuration {
        kill_output: true,
        ..configuration()
    }
}

/// Armed, with the ESC started.
fn powered() -> Rig {
    let mut rig = Rig::armed_with(with_kill_output());
    rig.run(2_000 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Armed);
    rig
}

#[test]
fn without_a_kill_output_the_pin_stays_off() {
    let mut rig = Rig::driving_with(configuration());
    assert!(!rig.outputs.power_on);
    assert!(!rig.status().power_on);
}

#[test]
fn the_supply_is_on_from_arming_and_neutral_is_held_for_two_seconds() {
    let mut rig = Rig::ready_with(with_kill_output());
    assert!(!rig.outputs.power_on);
    assert_eq!(rig.arm(), Ok(()));
    assert_eq!(rig.board.mode(), BoardMode::PoweringUp);
    for _ in 0..199 {
        assert!(rig.outputs.power_on);
        assert_eq!(rig.esc_us(), NEUTRAL);
        rig.run(10 * MS);
        rig.drive(1_000, 0);
        assert_eq!(rig.board.mode(), BoardMode::PoweringUp);
    }
    rig.run(10 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Armed);
    assert!(rig.status().power_on);
    assert_eq!(rig.status().last_refusal, RefusalReason::NotYetNeutral);
    rig.drive(1_000, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
    assert!(rig.outputs.power_on);
}

#[test]
fn everything_that_ends_a_drive_switches_the_supply_off_at_once() {
    type End = fn(&mut Rig);
    let ends: [(End, StopCause); 4] = [
        (|rig| rig.disarm(), StopCause::Disarmed),
        (|rig| rig.emergency_stop(), StopCause::EmergencyStop),
        (|rig| rig.greet(99), StopCause::HostRestarted),
        (|rig| rig.run(96 * MS), StopCause::CommandTimeout),
    ];
    for (end, cause) in ends {
        let mut rig = powered();
        rig.drive(500, 0);
        assert!(rig.outputs.power_on);
        end(&mut rig);
        assert_eq!(rig.board.stop_cause(), cause);
        assert!(!rig.outputs.power_on, "{cause:?}");
        rig.run(1_000 * MS);
        assert!(!rig.outputs.power_on, "{cause:?}");
    }
}

#[test]
fn a_host_that_is_gone_does_not_leave_the_supply_on() {
    let mut rig = powered();
    rig.run(999 * MS);
    assert!(rig.outputs.power_on);
    rig.run(MS);
    assert!(!rig.outputs.power_on);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    assert_eq!(rig.board.stop_cause(), StopCause::CommandTimeout);
}

#[test]
fn the_stop_switch_cuts_the_supply_while_the_esc_starts() {
    let mut rig = Rig::armed_with(Configuration {
        stop_input: true,
        ..with_kill_output()
    });
    rig.inputs.stop_input_open = true;
    rig.run(1);
    assert_eq!(rig.board.mode(), BoardMode::EmergencyStopped);
    assert!(!rig.outputs.power_on);
}

#[test]
fn a_request_to_arm_that_is_repeated_while_the_esc_starts_is_answered() {
    let mut rig = Rig::ready_with(with_kill_output());
    let arm = rig.arm_request();
    assert_eq!(rig.arm_as(arm), Ok(()));
    rig.run(50 * MS);
    assert_eq!(rig.arm_as(arm), Ok(()));
    assert_eq!(rig.arm(), Err(RefusalReason::Busy));
    assert_eq!(rig.configure(configuration()), Err(RefusalReason::Busy));
}

#[test]
fn the_configuration_of_another_car_is_refused() {
    let mut rig = Rig::new();
    rig.poll(&[]);
    let other = Configuration {
        car_id: 7,
        ..configuration()
    };
    assert_eq!(rig.configure(other), Err(RefusalReason::OtherCar));
    assert_eq!(rig.board.configuration(), None);
    rig.board = Board::new(ResetCause::PowerOn, SOFTWARE_VERSION, 7);
    rig.poll(&[]);
    assert_eq!(rig.configure(configuration()), Err(RefusalReason::OtherCar));
    assert_eq!(rig.configure(other), Ok(()));
}

#[test]
fn every_greeting_is_followed_by_the_identity() {
    let mut rig = Rig::new();
    rig.board = Board::new(ResetCause::PowerOn, SOFTWARE_VERSION, 0x4711);
    rig.poll(&[]);
    rig.greet(77);
    let names: Vec<_> = rig
        .messages
        .iter()
        .filter_map(|(_, message)| match message {
            ToHost::Hello(hello) => Some(hello.nonce),
            ToHost::Identity(identity) => Some(u32::from(identity.car_id)),
            _ => None,
        })
        .collect();
    assert_eq!(names, [0, 0x4711, 77, 0x4711]);
}

#[test]
fn an_identity_that_did_not_fit_the_line_follows_later() {
    let mut board = Board::new(ResetCause::PowerOn, SOFTWARE_VERSION, 5);
    let mut sent = Vec::new();
    // Room for the zero and the greeting.
    let mut room = 2;
    for poll in 0..20 {
        if poll == 10 {
            room = usize::MAX;
        }
        board.poll(poll * MS, &Inputs::default(), &[], &mut |frame: &[u8]| {
            let fits = room > 0;
            if fits {
                room -= 1;
                sent.push((poll, frame.to_vec()));
            }
            fits
        });
    }
    let [(0, _), (0, _), (10, identity), ..] = &sent[..] else {
        panic!("{sent:?}")
    };
    assert_eq!(identity[1], 0x24);
}

#[test]
fn the_status_has_supply_battery_input_and_the_imus_registers() {
    let mut rig = Rig::ready_with(configuration());
    rig.inputs.supply_mv = 4_600;
    rig.inputs.battery_open = true;
    rig.inputs.edges_refused = 9;
    rig.inputs.imu_health = ImuHealth {
        calibration: 0x31,
        self_test: 0x0B,
        status: 5,
        error: 3,
    };
    let status = rig.status();
    assert_eq!(
        (status.supply_mv, status.battery_open, status.edges_refused),
        (4_600, true, 9)
    );
    assert_eq!(
        (
            status.imu_calibration,
            status.imu_self_test,
            status.imu_status,
            status.imu_error
        ),
        (0x31, 0x0B, 5, 3)
    );
}
