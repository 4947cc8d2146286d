//! The bits of the controller belong to its number.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_control::{
    ActuatorModel, Circle, FigureOfEight, Position, Reference, VehicleParameters,
};
use singletrack_pilot::{Arming, CONTROLLER, Compensation, Mode, PilotConfig, PilotRequest};

use crate::bench::{Bench, config};

/// Ticks of a drive.
const TICKS: u32 = 1_500;

/// The outputs of a drive, of its stop, and of another one, as a number.
fn outputs(config: PilotConfig) -> u64 {
    let mut bench = Bench::with(config);
    // FNV-1a.
    let mut driven = 0;
    let mut sum = 0xcbf2_9ce4_8422_2325_u64;
    for tick in 0..TICKS {
        // A gyro that is a little off, and a car that does not quite follow.
        bench.gyro_bias = 0.002;
        bench.speed *= 0.998;
        let request = match tick {
            100 | 1_100 => Some(PilotRequest::Arm(Arming::Unattended)),
            900 => Some(PilotRequest::Disarm),
            _ => None,
        };
        let output = bench.step_with(request);
        driven += u32::from(output.mode == Mode::Driving);
        let actuation = &output.actuation;
        let estimate = output.estimate.map(|estimate| {
            let position = estimate.position;
            let motion = [estimate.speed, estimate.yaw_rate, estimate.sideslip];
            ([position.x, position.y, estimate.yaw], motion)
        });
        let (pose, motion) = estimate.unwrap_or_default();
        let sent = [actuation.speed, actuation.steering];
        for value in sent.into_iter().chain(pose).chain(motion) {
            for byte in value.to_bits().to_le_bytes() {
                sum = (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
            }
        }
    }
    assert!(driven > 1_000, "{driven}");
    sum
}

fn circle() -> Reference {
    Reference::Circle(Circle::new(Position::origin(), 1.0, 0.5).unwrap())
}

#[test]
fn the_outputs_of_drives_have_the_bits_of_this_controller() {
    let compensated = PilotConfig {
        reference: circle(),
        compensation: Compensation {
            clock: true,
            actuation: Some(ActuatorModel {
                steering_dead_time: 0.03,
                steering_lag: 0.02,
                speed_dead_time: 0.05,
                speed_lag: 0.1,
            }),
            vehicle: VehicleParameters::paper(),
        },
        ..config()
    };
    let eight = PilotConfig {
        reference: Reference::FigureOfEight(
            FigureOfEight::new(Position::origin(), 1.5, 0.75, 0.4).unwrap(),
        ),
        ..compensated.clone()
    };
    let plain = PilotConfig {
        reference: circle(),
        ..config()
    };
    let found = [plain, compensated, eight].map(outputs);
    assert_eq!(
        (CONTROLLER, found),
        (
            16,
            [
                17_567_031_296_879_523_504,
                15_705_677_852_906_822_981,
                5_658_629_218_043_773_377
            ]
        ),
        "the outputs have other bits: raise CONTROLLER, and write down both"
    );
}
