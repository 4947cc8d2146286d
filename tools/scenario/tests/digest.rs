//! The digest of a drive, and its record in memory.

use std::{io::Cursor, path::Path};

use singletrack_record::{Digest, Entry, Reader};
use singletrack_scenario::simulate::{
    Progress, RunOptions, Scenario, ScenarioRun, simulate_with, virtual_drive_config,
};

const SHORT: &str = "../scenarios/circle-car.toml";

#[test]
fn a_run_tick_by_tick_its_record_and_a_simulation_have_one_digest() {
    let mut scenario = Scenario::read(Path::new(SHORT)).unwrap();
    scenario.run.duration_s = 2.0;
    let options = RunOptions {
        digest: true,
        ..RunOptions::default()
    };
    let simulated = simulate_with(&scenario, options).unwrap();

    let (config, simulation) = virtual_drive_config(&scenario).unwrap();
    let options = RunOptions {
        in_memory: true,
        ..options
    };
    let mut run = ScenarioRun::begin(&scenario, &config, &simulation, options).unwrap();
    let mut rows = 0;
    while !run.is_complete() {
        rows += usize::from(matches!(run.advance().unwrap(), Progress::Row(_)));
    }
    assert_eq!(rows, simulated.rows.len());
    assert_eq!(run.laboratory.digest, simulated.digest);

    let record = run.laboratory.take_record().unwrap();
    let mut recorded = Digest::default();
    for entry in Reader::from_read(Cursor::new(record), Path::new("memory")).unwrap() {
        if let Entry::Tick(tick) = entry.unwrap() {
            recorded.add(&tick);
        }
    }
    assert_eq!(Some(recorded), simulated.digest);
}
