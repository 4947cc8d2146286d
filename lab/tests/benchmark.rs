//! What `singletrack-lab benchmark` says of a folder that does not have the logs.

use std::process::Command;

#[test]
fn a_log_that_is_missing_is_named_with_where_it_is_public() {
    let folder = tempfile::tempdir().unwrap();
    let cars = crate::judge::in_repository("tools/real/benchmark.toml");
    let output = Command::new(env!("CARGO_BIN_EXE_singletrack-lab"))
        .arg("benchmark")
        .arg(folder.path())
        .arg("--cars")
        .arg(cars)
        .output()
        .unwrap();
    assert!(!output.status.success());
    assert!(output.stdout.is_empty());
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        said.contains("car_1_Datarecording_09_04_2024_12_37_59.csv")
            && said.contains("https://github.com/Lorenzo-Lyons/DART"),
        "{said}"
    );
}
