//! Prints how far the estimate is from the truth on the circle at 0.4 m/s:
//! without losses, and for losses of four lengths every 2 s, held and coasted.

#[path = "../tests/common/estimation.rs"]
mod estimation;

use std::path::Path;

use singletrack_core::config::MarkerLoss;
use singletrack_scenario::simulate::Scenario;
use singletrack_sim::LossPattern;

use estimation::{EstimationStudy, study};

fn main() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/circle-car.toml");
    let scenario = match Scenario::read(&path) {
        Ok(scenario) => scenario,
        Err(error) => return eprintln!("{error}"),
    };
    println!(
        "RMS errors of the estimate on the circle at 0.4 m/s, 0.2 mm / 0.1 deg cameras, 8 ms latency"
    );
    println!(
        "{:>8} {:>6} | {:>11} {:>9} {:>10} {:>12} {:>11} | {:>12} {:>10}",
        "loss",
        "mode",
        "position mm",
        "yaw deg",
        "slip deg",
        "rate rad/s",
        "speed mm/s",
        "worst pos mm",
        "track mm"
    );
    for loss in [
        None,
        Some("50ms@2s"),
        Some("100ms@2s"),
        Some("200ms@2s"),
        Some("500ms@2s"),
    ] {
        let pattern = loss.and_then(|text| text.parse::<LossPattern>().ok());
        for (name, mode) in [
            ("hold", MarkerLoss::Hold),
            ("coast", MarkerLoss::DeadReckon),
        ] {
            match study(&scenario, pattern, mode) {
                Ok(study) => print(loss.unwrap_or("none"), name, &study),
                Err(error) => eprintln!("{error}"),
            }
        }
    }
}

fn print(loss: &str, mode: &str, study: &EstimationStudy) {
    let errors = &study.errors;
    println!(
        "{loss:>8} {mode:>6} | {:>11.2} {:>9.3} {:>10.3} {:>12.4} {:>11.2} | {:>12.1} {:>10.1}",
        errors.position_m * 1e3,
        errors.yaw_rad.to_degrees(),
        errors.sideslip_rad.to_degrees(),
        errors.yaw_rate_rad_s,
        errors.speed_m_s * 1e3,
        study.worst_position_m * 1e3,
        study.tracking_m * 1e3,
    );
}
