//! Drives well calibrated cars of all kinds, at random, and counts the drives that a watch
//! ends: there must be none. At the end it prints how often each kind was drawn.
//!
//! ```sh
//! cargo run --release -p singletrack-scenario --example false_alarms -- --count 10000
//! ```

use std::{collections::BTreeMap, env, error::Error};

#[path = "../tests/common/calibrated.rs"]
mod calibrated;

use calibrated::{CalibratedCar, Ended};

fn main() -> Result<(), Box<dyn Error>> {
    let mut first = 1_u64;
    let mut count = 200_u64;
    let mut arguments = env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let value = arguments.next().ok_or("each option has a value")?;
        match argument.as_str() {
            "--first-seed" => first = value.parse()?,
            "--count" => count = value.parse()?,
            _ => return Err(format!("unknown option {argument}").into()),
        }
    }
    let mut alarms = 0;
    let mut proved = 0;
    // Drives and false alarms of each kind.
    let mut kinds: BTreeMap<String, [u64; 2]> = BTreeMap::new();
    for seed in first..first + count {
        let car = CalibratedCar::random(seed);
        let drive = car.drive()?;
        proved += u64::from(drive.proved);
        let alarm = matches!(drive.ended, Ended::Alarm(_));
        for kind in car.kinds() {
            let [drives, ended] = kinds.entry(kind.clone()).or_default();
            *drives += 1;
            *ended += u64::from(alarm);
        }
        if let Ended::Alarm(reason) = drive.ended {
            alarms += 1;
            println!(
                "seed {seed}: {reason} after {:.2} s\n{}",
                drive.seconds,
                car.describe()
            );
        }
        let done = seed + 1 - first;
        if done.is_multiple_of(100) {
            println!("{done} of {count} drives, {proved} proved, {alarms} false alarms");
        }
    }
    for (kind, [drives, ended]) in kinds {
        println!("{drives:>7} {ended:>4}  {kind}");
    }
    println!("{count} drives, {proved} proved, {alarms} false alarms");
    Ok(())
}
