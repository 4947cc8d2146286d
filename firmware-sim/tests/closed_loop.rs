//! The real board code drives the simulated car.

mod common;

use common::Bench;
use singletrack_protocol::{BoardMode, ImuState, ResetCause, StopCause};
use singletrack_sim::{MotorSensorFault, SimulationConfig};

#[test]
fn a_step_to_0_4_m_s_settles_within_a_second() {
    for seed in 1..=3 {
        let mut bench = Bench::armed(SimulationConfig {
            seed,
            ..SimulationConfig::default()
        });
        let start = bench.world.now_us();
        let mut speeds = Vec::new();
        bench.drive(400, 400, 0, |bench| {
            let truth = bench.world.truth();
            speeds.push((truth.time_us - start, truth.wheel_speed));
        });
        assert_eq!(bench.host.mode(), Some(BoardMode::Driving));
        for (us, v) in speeds.iter().step_by(5) { println!("{us} {v:.4}"); }
        for (time_us, speed) in speeds.iter().filter(|(time_us, _)| *time_us >= 1_000_000) {
            assert!((speed - 0.4).abs() <= 0.008, "{time_us} us: {speed} m/s");
        }
        let highest = speeds.iter().fold(0.0_f64, |most, (_, speed)| most.max(*speed));
        assert!(highest < 0.46, "overshoot to {highest} m/s");
    }
}
