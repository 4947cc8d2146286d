//! What is said of a log or a map that can't be imported.

use std::fs;

use singletrack_logs::import::import;
use singletrack_mocap::{Observation, PoseState};

use crate::bench::{Bench, Imported, MAP, error, imported, read};

const LOG: &str = "t,x,y,yaw,v,s\n0,0,0,0,1,0\n0.01,0,0,0,1,0\n";

/// [`LOG`] with other last rows.
fn with_rows(rows: &str) -> String {
    format!("t,x,y,yaw,v,s\n0,0,0,0,1,0\n{rows}")
}

#[track_caller]
fn assert_log_error(rows: &str, expected: &str) {
    assert_eq!(error(&with_rows(rows), MAP), expected);
}

/// The import fails with a map in which `from` is replaced.
#[track_caller]
fn assert_map_error(from: &str, to: &str, expected: &str) {
    let map = MAP.replace(from, to);
    assert_ne!(map, MAP);
    let message = error(LOG, &map);
    assert!(
        message.starts_with("map.toml: ") && message.contains(expected),
        "{message}"
    );
}

#[test]
fn a_missing_column_is_named_with_those_that_are_there() {
    let map = MAP.replace("x = \"x\"", "x = \"vicon x\"");
    assert_eq!(
        error(LOG, &map),
        "log.csv has no column \"vicon x\", which pose.x in the map names; its columns are \"t\", \
         \"x\", \"y\", \"yaw\", \"v\", \"s\""
    );
}

#[test]
fn a_column_that_is_there_twice_is_refused() {
    assert_eq!(
        error("t,x,y,yaw,v,x,s\n0,0,0,0,1,1,0\n", MAP),
        "log.csv has 2 columns \"x\", and pose.x in the map names one: rename the others in the file"
    );
}

#[test]
fn a_decimal_comma_is_named_with_what_makes_points_of_all() {
    let map = format!("delimiter = \";\"\n{MAP}");
    let rows = "t;x;y;yaw;v;s\n0;0;0;0;1;0\n";
    let fix = "it has a decimal comma: replace those of the file, such as with `sed 's/,/./g'`";
    assert_eq!(
        error(&format!("{rows}0.01;1,25;0;0;1;0\n"), &map),
        format!("log.csv, line 3, column \"x\": \"1,25\" is not a number: {fix}")
    );
    assert_eq!(
        error(&format!("{rows}0,01;1;0;0;1;0\n"), &map),
        format!("log.csv, line 3, column \"t\": \"0,01\" is not a time as a decimal number: {fix}")
    );
}

#[test]
fn a_cell_that_is_no_number_is_named() {
    assert_log_error(
        "0.01,0,0,0,fast,0\n",
        "log.csv, line 3, column \"v\": \"fast\" is not a number: correct the cell or remove the row",
    );
    assert_log_error(
        "0.01,0,O,0,1,0\n",
        "log.csv, line 3, column \"y\": \"O\" is not a number: correct the cell or remove the row",
    );
    assert_log_error(
        "0.01,0,0,0,1,left\n",
        "log.csv, line 3, column \"s\": \"left\" is not a number: correct the cell or remove the row",
    );
}

#[test]
fn a_sensor_or_a_command_that_is_not_finite_is_refused() {
    assert_log_error(
        "0.01,0,0,0,nan,0\n",
        "log.csv, line 3, column \"v\": \"nan\" is not a finite number: correct the cell or remove the \
         row",
    );
    assert_log_error(
        "0.01,0,0,0,1,inf\n",
        "log.csv, line 3, column \"s\": \"inf\" is not a finite number: correct the cell or remove the \
         row",
    );
    let map = format!(
        "{MAP}[imu]\nforward_acceleration = \"x\"\nleft_acceleration = \"y\"\nyaw_rate = \"yaw\"\n"
    );
    assert_eq!(
        error(&with_rows("0.01,1,,0,1,0\n"), &map),
        "log.csv, line 3, column \"y\": \"\" is not a finite number: correct the cell or remove the row"
    );
}

#[test]
fn a_flag_is_a_number_or_a_word() {
    let log = "t,x,y,yaw,v,s,on\n0,0,0,0,1,0,yes\n";
    assert_eq!(
        error(log, &format!("{MAP}[driving]\ncolumn = \"on\"\n")),
        "log.csv, line 2, column \"on\": \"yes\" is not a number, true or false: correct the cell or \
         remove the row"
    );
    let map = MAP.replace("yaw = \"yaw\"\n", "yaw = \"yaw\"\ntracked = \"on\"\n");
    let message = error(&log.replace("yes", ""), &map);
    assert!(
        message.contains("column \"on\": \"\" is not a number"),
        "{message}"
    );
}

#[test]
fn a_time_that_is_no_number_is_named() {
    assert_log_error(
        "12:00,0,0,0,1,0\n",
        "log.csv, line 3, column \"t\": \"12:00\" is not a time as a decimal number: correct the cell, \
         remove the row, or name another time.column in the map",
    );
}

#[test]
fn time_that_goes_backwards_is_named_with_its_line() {
    assert_log_error(
        "0.5,0,0,0,1,0\n\n0.25,0,0,0,1,0\n",
        "log.csv, line 5, column \"t\": \"0.25\" is 250 ms before a row above: put the rows in the \
         order of time, or remove those of another log",
    );
}

#[test]
fn rows_a_hair_out_of_order_are_sorted_and_counted() {
    let log = "t,x,y,yaw,v,s\n0,0,0,0,1,0\n0.0104541,2,0,0,1,0\n0.01,1,0,0,1,0\n0.02,3,0,0,1,0\n";
    let imported = imported(log, MAP);
    assert_eq!(imported.summary.sorted, 1);
    let told = imported.summary.to_string();
    assert!(
        told.ends_with("; rows sorted into the order of their times: 1"),
        "{told}"
    );
    let x = |pose: &&Observation| match pose.state {
        PoseState::Valid(pose) => pose.x_m,
        _ => f64::NAN,
    };
    let poses: Vec<f64> = imported.observations().iter().map(x).collect();
    assert_eq!(poses, [0.0, 1.0, 2.0, 3.0]);
}

#[test]
fn time_that_jumps_is_named_with_its_line() {
    assert_log_error(
        "1700000000,0,0,0,1,0\n",
        "log.csv, line 3, column \"t\": \"1700000000\" is 1700000000 s after the row above: remove the \
         rows on one side of the gap, correct time.unit in the map, or raise its time.longest_gap_s",
    );
}

#[test]
fn a_negative_unix_time_is_refused() {
    let map = MAP.replace("unix = false", "unix = true");
    assert_eq!(
        error("t,x,y,yaw,v,s\n-1,0,0,0,1,0\n", &map),
        "log.csv, line 2, column \"t\": \"-1\" is before 1970: set time.unix = false in the map"
    );
}

#[test]
fn a_file_without_rows_is_said_to_be_one() {
    assert_eq!(
        error("", MAP),
        "log.csv is empty: it needs a line with the names of the columns, and a line for each sample"
    );
    assert_eq!(
        error("t,x,y,yaw,v,s\n", MAP),
        "log.csv has the names of the columns, but no rows: there is nothing to import"
    );
}

#[test]
fn a_row_of_another_length_is_named_with_its_line() {
    assert_log_error(
        "0.01,0,0,0,1,0\n\n0.02,0,0\n",
        "log.csv, line 5: the row has 3 cells and the header 6: correct or remove the row",
    );
}

#[test]
fn a_file_that_is_missing_or_no_text_is_named() {
    let bench = Bench::new(LOG, MAP);
    fs::write(bench.path("log.csv"), b"t,x,y,yaw,v,s\n0,\xff,0,0,1,0\n").unwrap();
    assert_eq!(
        bench.error(),
        "log.csv, line 2: the row is not UTF-8: convert the file, such as with `iconv -t UTF-8`"
    );
    fs::remove_file(bench.path("log.csv")).unwrap();
    let message = bench.error();
    assert!(message.starts_with("can't read log.csv: "), "{message}");
    fs::remove_file(bench.path("map.toml")).unwrap();
    let message = bench.error();
    assert!(message.starts_with("can't read map.toml: "), "{message}");
}

#[test]
fn a_record_that_is_there_is_kept() {
    let bench = Bench::new(LOG, MAP);
    for name in ["out.mcap", "out.mcap.part"] {
        fs::write(bench.path(name), "kept").unwrap();
        let message = bench.import("out.mcap").unwrap_err().to_string();
        assert!(message.contains("exists already"), "{message}");
        assert_eq!(fs::read_to_string(bench.path(name)).unwrap(), "kept");
        fs::remove_file(bench.path(name)).unwrap();
    }
}

#[test]
fn more_events_than_a_tick_holds_are_refused_with_its_time() {
    let rows: String = (1..=70)
        .map(|row| format!("0.0{:03},0,0,0,1,0\n", 100 + row))
        .collect();
    let bench = Bench::new(&with_rows(&rows), MAP);
    assert_eq!(
        bench.error(),
        "log.csv: more than 64 poses and samples fall in the tick 0.020 s after the first row: make \
         tick_ms in the map smaller, or interpolate the sensors at a lower rate"
    );
}

#[test]
fn an_unknown_key_is_refused_with_those_that_exist() {
    assert_map_error(
        "unix = false",
        "unix = false\nzero = 1",
        "unknown field `zero`",
    );
    assert_map_error(
        "\n[time]",
        "\nticks_ms = 1\n[time]",
        "unknown field `ticks_ms`",
    );
    assert_map_error(
        "x = \"x\"",
        "x = { column = \"x\", units = \"mm\" }",
        "unknown field `units`",
    );
}

#[test]
fn a_map_without_a_speed_of_the_motor_is_refused_with_the_reason() {
    let map = MAP.replace("[motor]\nspeed = \"v\"\n", "");
    assert_eq!(
        error(LOG, &map),
        "map.toml has no section [motor]: add it with the column of the speed of motor or wheels, which \
         the estimator needs; a log without one can't be imported"
    );
}

#[test]
fn a_unit_of_another_kind_is_refused_with_those_that_fit() {
    assert_map_error(
        "yaw = \"yaw\"",
        "yaw = { column = \"yaw\", unit = \"mm\" }",
        "unit is \"mm\": use one of rad, mrad, deg, or a scale to the first one",
    );
    assert_map_error("unit = \"s\"", "unit = \"min\"", "unknown variant `min`");
    assert_map_error(
        "x = \"x\"",
        "x = 1",
        "the name of a column, or a table with column",
    );
    assert_map_error(
        "x = \"x\"",
        "x = { column = \"x\", scale = 0 }",
        "scale is 0: use a finite number that is not 0",
    );
    assert_map_error(
        "x = \"x\"",
        "x = { column = \"x\", offset = inf }",
        "offset is inf: use a finite number",
    );
}

#[test]
fn values_out_of_range_are_refused_with_the_range() {
    let motor = |lines: &str| format!("speed = \"v\"\n{lines}\n");
    for (from, to, expected) in [
        (
            "\n[time]",
            "\ntick_ms = 0\n[time]",
            "tick_ms is 0: use 1 to 1000",
        ),
        (
            "\n[time]",
            "\ndelimiter = \"é\"\n[time]",
            "delimiter is 'é': use an ASCII character",
        ),
        (
            "unix = false",
            "unix = false\nlongest_gap_s = 0",
            "time.longest_gap_s is 0: use a number above 0",
        ),
        (
            "speed = \"v\"\n",
            &motor("delay_s = -0.1"),
            "motor.delay_s is -0.1: use 0 to 0.9, in s",
        ),
        (
            "speed = \"v\"\n",
            &motor("delay_s = nan"),
            "motor.delay_s is NaN: use 0 to 0.9, in s",
        ),
        (
            "speed = \"v\"\n",
            &motor("interpolate_hz = 2000"),
            "motor.interpolate_hz is 2000: use 1 to 1000",
        ),
        (
            "speed = \"v\"\n",
            &motor("longest_gap_s = 0.2"),
            "motor.longest_gap_s is 0.2: leave it out, or add motor.interpolate_hz",
        ),
        (
            "yaw = \"yaw\"",
            "yaw = \"yaw\"\npoint_m = [0.1, inf]",
            "pose.point_m is inf: use a finite number",
        ),
    ] {
        assert_map_error(from, to, expected);
    }
}

#[test]
fn a_steering_that_is_no_function_is_refused() {
    for (to, expected) in [
        (
            "",
            "[steering] is without an angle: give steering.table or steering.radians_per_unit",
        ),
        (
            "radians_per_unit = 1\ntable = [[0, 0], [1, 1]]",
            "[steering] is with two angles: give steering.table or steering.radians_per_unit, not both",
        ),
        (
            "radians_per_unit = 0",
            "steering.radians_per_unit is 0: use the angle of a command of 1",
        ),
        (
            "table = [[0, 0]]",
            "steering.table is a table of 1 pairs: give at least 2",
        ),
        (
            "table = [[0, 0], [2, 1], [1, 2]]",
            "steering.table is a table with 1 after 2: put the pairs in the order of the commands",
        ),
        (
            "table = [[0, 0], [0, 1]]",
            "steering.table is a table with 0 after 0",
        ),
        (
            "table = [[0, nan], [1, 1]]",
            "steering.table is [0.0, NaN]: use finite numbers",
        ),
        (
            "table = [[0, 0], [1, 1]]\noffset_rad = 1",
            "steering.offset_rad is 1: add it to the angles of the table instead",
        ),
    ] {
        assert_map_error("radians_per_unit = 0.5", to, expected);
    }
}

/// Imports the files `a.csv` and `b.csv` with these contents.
fn of_two(a: &str, b: &str) -> Result<Imported, String> {
    let bench = Bench::new("", MAP);
    let files = ["a.csv", "b.csv"].map(|name| bench.path(name));
    for (file, contents) in files.iter().zip([a, b]) {
        fs::write(file, contents).unwrap();
    }
    let out = bench.path("out.mcap");
    let result = import(&files, &bench.path("map.toml"), &out, |_, _| {});
    let folder = format!("{}/", bench.path("").display()).replace("//", "/");
    result
        .map(|summary| read(&out, summary))
        .map_err(|error| error.to_string().replace(&folder, ""))
}

const POSES: &str = "t,x,y,yaw\n0,0,0,0\n0.01,0.1,0,0\n0.02,0.2,0,0\n";

#[test]
fn several_files_of_a_drive_give_the_record_of_one() {
    let together = "t,x,y,yaw,v,s\n0,0,0,0,,\n0.005,,,,1,0.1\n0.01,0.1,0,0,,\n0.015,,,,2,0.2\n0.02,0.2,0,0,,\n";
    let map = MAP.replace("yaw = \"yaw\"", "yaw = \"yaw\"\nempty_rows = \"no-sample\"");
    let expected = imported(together, &map);
    let found = of_two(POSES, "t,v,s\n0.005,1,0.1\n0.015,2,0.2\n").unwrap();
    assert_eq!(found.entries, expected.entries);
    assert_eq!(found.summary, expected.summary);
}

#[test]
fn several_files_that_are_no_log_are_refused_by_name() {
    for (other, expected) in [
        (
            "t,x,v,s\n0,0,1,0\n",
            "b.csv has a column \"x\", as a.csv has, and pose.x in the map names one: rename it in one of the files",
        ),
        (
            "t,v,s\n100,1,0\n",
            "b.csv is 99.98 s apart from the files before it: the files of a drive need one clock in time.column",
        ),
        (
            "t,v\n0,1\n",
            "a.csv has no column \"s\", which steering.column in the map names; its columns are \"t\", \"x\", \
             \"y\", \"yaw\"",
        ),
    ] {
        assert_eq!(of_two(POSES, other).err().as_deref(), Some(expected));
    }
    let split = of_two("t,x,y\n0,0,0\n", "t,yaw,v,s\n0,0,1,0\n");
    let expected = "b.csv has the column of pose.yaw, and a.csv that of pose.x: put all columns of [pose] into \
                    one file";
    assert_eq!(split.err().as_deref(), Some(expected));
}
