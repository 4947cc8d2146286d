//! How good the identification is, over many seeds:
//! `cargo run --release -p singletrack-paper --example identification_study -- 100`.

use indicatif::ProgressBar;
use singletrack_paper::identify::study::{StudyError, run_study};

fn main() -> Result<(), StudyError> {
    let count = std::env::args().nth(1).and_then(|count| count.parse().ok());
    let seeds: Vec<u64> = (1..=count.unwrap_or(10)).collect();
    let bar = ProgressBar::new(seeds.len() as u64);
    let study = run_study(&seeds, |done| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    println!(
        "{:4} {:>10} {:>11} {:>10} {:>8} {:>10} {:>10} {:>8}",
        "", "truth", "mean", "deviation", "worst", "stated", "bound", "covered"
    );
    for summary in study.summaries() {
        println!(
            "{:4} {:>10} {:>11.6} {:>10.2e} {:>6.2} % {:>10.2e} {:>10.2e} {:>4} of {}",
            summary.parameter.name(),
            summary.truth,
            summary.mean,
            summary.deviation,
            100.0 * summary.worst_relative_error,
            summary.stated_deviation,
            summary.bound,
            summary.covered,
            seeds.len(),
        );
    }
    let [identification, validation] = study.nmpe();
    println!("NMPE {identification:.4} identification, {validation:.4} validation");
    for result in &study.seeds {
        for warning in &result.identification.warnings {
            println!("seed {}: warning: {warning}", result.seed);
        }
    }
    Ok(())
}
