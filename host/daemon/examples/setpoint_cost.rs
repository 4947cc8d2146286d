//! What a line of the control socket costs: `cargo run --release -p singletrackd --example
//! setpoint_cost`.

#![allow(clippy::print_stdout, reason = "a program")]

use std::{hint::black_box, time::Instant};

use singletrackd::Command;

/// The time at which the lines are read, ns.
const NOW_NS: u64 = 1_000_000_000_000;

const REPETITIONS: u32 = 20_000;

fn main() {
    let point = |index: u32| {
        let time_ns = NOW_NS + u64::from(index) * 50_000_000;
        let x = f64::from(index) * 0.012_345_678_901_234_567;
        format!(r#"{{"time_ns":{time_ns},"position_m":[{x},{x}],"velocity_m_s":[{x},0.5]}}"#)
    };
    let trajectory = (0..100).map(point).collect::<Vec<_>>().join(",");
    let stamp = r#""time_ns":999999999999,"sequence":12345"#;
    for (name, keys) in [
        (
            "velocity",
            r#""velocity_m_s":[0.41234567890123,0.1]"#.to_owned(),
        ),
        (
            "actuation",
            r#""steering_rad":0.10123456789012,"speed_m_s":0.5"#.to_owned(),
        ),
        (
            "trajectory of 100",
            format!(r#""trajectory":[{trajectory}]"#),
        ),
    ] {
        let line = format!(r#"{{"version":3,"command":"setpoint",{keys},{stamp}}}"#);
        let begin = Instant::now();
        for _ in 0..REPETITIONS {
            let command = Command::parse(black_box(line.as_bytes()), NOW_NS);
            assert!(black_box(command).is_ok(), "{name}");
        }
        let ns = begin.elapsed().as_nanos() / u128::from(REPETITIONS);
        println!("{name}: {} bytes, {ns} ns to parse and check", line.len());
    }
}
