//! Effects of faults on the simulated world: line, board, sensors, supply.

use singletrack_protocol::ResetCause;
use singletrack_sim::{Hang, ImuFault, MotorSensorFault, NatNetServer, WireFaults, World};

use crate::{
    schedule::{Fault, FaultKind, Situation},
    setting,
};

/// The car's streaming id, and the one it gets by [`FaultKind::CameraModelChange`].
pub(crate) const CAR_IDS: [i32; 2] = [CAR_ID, OTHER_CAR_ID];
const CAR_ID: i32 = 11;
const OTHER_CAR_ID: i32 = 12;

/// Charge that lowers the battery voltage by 1 V, in Ah; see `BatteryParameters`.
const AH_PER_VOLT: f64 = 2.0;

/// Applies the onset of a fault.
pub(crate) fn begin(world: &mut World, fault: &Fault) {
    match fault.kind {
        FaultKind::BoardPowerOn => world.reset_board(ResetCause::PowerOn),
        FaultKind::BoardReset => world.reset_board(ResetCause::External),
        FaultKind::BoardBrownOut => world.reset_board(ResetCause::BrownOut),
        FaultKind::BoardWatchdog => world.reset_board(ResetCause::Watchdog),
        FaultKind::BoardHang if world.board().is_running() => {
            world.board_mut().hang(Hang::MainLoop);
        }
        FaultKind::CameraModelChange => world.set_car_body_id(OTHER_CAR_ID),
        FaultKind::BatteryLow => world.car_mut().drain_battery(charge_ah(fault)),
        _ => {}
    }
}

/// Reverts a fault at its end.
pub(crate) fn end(world: &mut World, fault: &Fault) {
    match fault.kind {
        FaultKind::CameraModelChange => world.set_car_body_id(CAR_ID),
        FaultKind::CameraServerRestart => {
            let parameters = *world.natnet().parameters();
            *world.natnet_mut() = NatNetServer::new(parameters);
        }
        FaultKind::BatteryLow => world.car_mut().drain_battery(-charge_ah(fault)),
        _ => {}
    }
}

fn charge_ah(fault: &Fault) -> f64 {
    AH_PER_VOLT * f64::from(fault.severity) / 250.0
}

/// Sets the continuous effects of the active faults. Of several faults on one
/// subject, the latest wins.
pub(crate) fn hold(world: &mut World, situation: &Situation, faults: &[Fault]) {
    let is_active = |kind| faults.iter().any(|fault| fault.kind == kind);
    let mut wire = setting::wire_faults(situation);
    let mut imu = ImuFault::None;
    let mut motor = MotorSensorFault::None;
    for fault in faults {
        let s = fault.severity;
        match fault.kind {
            FaultKind::LineDrop => wire.drop = f64::from(s) / 5_000.0,
            FaultKind::LineCorrupt => wire.corrupt = f64::from(s) / 5_000.0,
            FaultKind::LineDelay => wire.delay_us += u64::from(s) * 200,
            FaultKind::LineStuck => {
                wire = WireFaults {
                    stuck: true,
                    ..wire
                };
            }
            FaultKind::ImuSilent => imu = ImuFault::Silent,
            FaultKind::ImuStuck => imu = ImuFault::Stuck,
            FaultKind::ImuBiased => {
                let bias = i16::try_from(s).unwrap_or(i16::MAX);
                imu = ImuFault::Biased {
                    yaw_rate_mrad_s: bias,
                    forward_mm_s2: bias,
                };
            }
            FaultKind::ImuSaturated => imu = ImuFault::Saturated,
            FaultKind::ImuErratic => imu = ImuFault::Erratic,
            FaultKind::ImuWrongBit => {
                let every = 1_020_u16.saturating_sub(u16::try_from(s).unwrap_or(u16::MAX));
                imu = ImuFault::WrongBit { every };
            }
            FaultKind::PulsesGone => motor = MotorSensorFault::Gone,
            FaultKind::PulsesDoubled => motor = MotorSensorFault::Doubled,
            FaultKind::PulsesHalved => motor = MotorSensorFault::Halved,
            FaultKind::PulsesErratic => motor = MotorSensorFault::Erratic,
            _ => {}
        }
    }
    *world.wire_mut().faults_mut() = wire;
    world.set_cable(!is_active(FaultKind::LineUnplugged));
    world.set_board_power(!is_active(FaultKind::BoardOff));
    world.set_imu_fault(imu);
    world.car_mut().set_motor_sensor_fault(motor);
    world.car_mut().set_esc_power(!is_active(FaultKind::EscOff));
    world
        .board_mut()
        .set_stop_input_open(is_active(FaultKind::StopInputOpen));
}
