//! `singletrack plot`: what is drawn of a record whose every number is known.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use singletrack_figures::plot::FigureKind;
use singletrack_record::part_path;

use crate::recorded::{self, PERIOD_NS, STOPPING, Script};

/// A record in a folder of its own, and what plotting it said.
struct Plot {
    folder: tempfile::TempDir,
    output: Output,
}

impl Plot {
    fn of(script: &Script, options: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let record = folder.path().join("drive.mcap");
        recorded::write(&record, script);
        let output = plot(&record, options);
        Self { folder, output }
    }

    fn said(&self) -> String {
        String::from_utf8_lossy(&self.output.stderr).into_owned()
    }

    /// A figure's file, of a plot that went well.
    fn svg(&self, kind: FigureKind) -> String {
        assert!(self.output.status.success(), "{}", self.said());
        fs::read_to_string(self.path(&kind.file_name())).unwrap()
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join("drive").join(name)
    }
}

fn plot(record: &Path, options: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("plot")
        .arg(record)
        .args(options)
        .output()
        .unwrap()
}

fn has_path(svg: &str, class: &str) -> bool {
    svg.contains(&format!("<path class=\"{class}\""))
}

/// The numbers of the report's script, decoded from its base 64.
fn embedded(html: &str) -> (serde_json::Value, Vec<Vec<f32>>) {
    let (_, rest) = html.split_once("id=\"data\">").unwrap();
    let (json, _) = rest.split_once("</script>").unwrap();
    let data: serde_json::Value = serde_json::from_str(json).unwrap();
    let columns = data["columns"].as_array().unwrap().iter();
    let columns = columns.map(|text| floats(text.as_str().unwrap())).collect();
    (data, columns)
}

fn floats(text: &str) -> Vec<f32> {
    let value = |letter: u8| match letter {
        b'A'..=b'Z' => u32::from(letter - b'A'),
        b'a'..=b'z' => u32::from(letter - b'a') + 26,
        b'0'..=b'9' => u32::from(letter - b'0') + 52,
        b'+' => 62,
        b'/' => 63,
        _ => 0,
    };
    let bytes: Vec<u8> = text
        .as_bytes()
        .chunks(4)
        .flat_map(|group| {
            let bits = group
                .iter()
                .fold(0, |bits, letter| bits << 6 | value(*letter));
            [(bits >> 16) as u8, (bits >> 8) as u8, bits as u8]
        })
        .collect();
    let floats = bytes.chunks_exact(4);
    floats
        .map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()))
        .collect()
}

/// The texts of the titles of the elements of a class.
fn titles<'a>(svg: &'a str, class: &str) -> Vec<&'a str> {
    svg.lines()
        .filter(|line| line.contains(&format!("class=\"{class}\"")))
        .filter_map(|line| line.split_once("<title>")?.1.split_once("</title>"))
        .map(|(title, _)| title)
        .collect()
}

#[test]
fn every_figure_becomes_a_file_that_is_named() {
    let plot = Plot::of(&Script::default(), &["--format", "svg"]);
    let named = String::from_utf8_lossy(&plot.output.stdout).into_owned();
    for kind in FigureKind::ALL {
        let svg = plot.svg(kind);
        assert!(svg.starts_with("<svg xmlns") && svg.ends_with("</svg>\n"));
        assert!(svg.len() < 100_000, "{}: {} B", kind.name(), svg.len());
        assert!(
            !svg.contains("NaN") && !svg.contains("inf"),
            "{}",
            kind.name()
        );
        let path = plot.path(&kind.file_name());
        assert!(named.lines().any(|line| Path::new(line) == path), "{named}");
    }
    assert_eq!(plot.said(), "", "nothing is odd about this record");
}

#[test]
fn figures_for_the_screen_are_twice_as_large_and_light_or_dark() {
    let plot = Plot::of(&Script::default(), &["--format", "screen"]);
    for kind in FigureKind::ALL {
        let path = plot.path("screen").join(kind.file_name());
        let svg = fs::read_to_string(path).unwrap();
        let (head, rest) = svg.split_once('>').unwrap();
        assert!(head.contains("class=\"static\"") && !head.contains("mm\""));
        assert!(
            head.contains("width=\"642.52\" viewBox=\"0 0 85 ")
                || head.contains("width=\"1345.51\" viewBox=\"0 0 178 "),
            "{head}"
        );
        assert!(rest.contains("prefers-color-scheme: dark"));
    }
}

#[test]
fn a_virtual_drive_has_no_time_of_day_and_no_lateness() {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("drive.mcap");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let simulated = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("simulate")
        .arg(root.join("tools/scenarios/circle-car.toml"))
        .arg("--record")
        .arg(&record)
        .output()
        .unwrap();
    assert!(simulated.status.success());
    let output = plot(&record, &[]);
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    let html = fs::read_to_string(folder.path().join("drive/report.html")).unwrap();
    for part in ["2000-01-01", "ateness", "class=\"note\"", "stopped"] {
        let own = html.replace("never stopped", "");
        let own = own.split("<h2>Configuration").next().unwrap();
        assert!(!own.contains(part), "{part}");
    }
    assert!(html.contains("where the record ends."));
    assert!(!folder.path().join("drive/lateness.svg").exists());
}

#[test]
fn figures_have_the_curves_of_the_paper() {
    let plot = Plot::of(&Script::default(), &["--format", "svg"]);
    for (kind, curves) in [
        (FigureKind::Trajectory, &["nominal", "actual"][..]),
        (FigureKind::Position, &["nominal", "actual"]),
        (FigureKind::CommandedVelocity, &["actual"]),
        (FigureKind::Steering, &["actual"]),
        (FigureKind::Speed, &["nominal", "actual", "measured"]),
        (FigureKind::SideslipYawRate, &["actual", "measured"]),
        (FigureKind::TrackingError, &["actual"]),
    ] {
        let svg = plot.svg(kind);
        for curve in ["nominal", "actual", "measured", "truth"] {
            let expected = curves.contains(&curve);
            assert_eq!(has_path(&svg, curve), expected, "{} {curve}", kind.name());
        }
    }
    for (kind, word) in [
        (FigureKind::CommandedVelocity, ">Px</tspan>"),
        (FigureKind::CommandedVelocity, "(m/s)"),
        (FigureKind::Steering, ">δ</tspan>"),
        (FigureKind::SideslipYawRate, ">β</tspan>"),
        (FigureKind::Latency, "median: 12.0 ms"),
        (FigureKind::Lateness, "median: 60 µs"),
        (FigureKind::Lateness, "99 %: 60 µs"),
    ] {
        assert!(plot.svg(kind).contains(word), "{}: {word}", kind.name());
    }
}

#[test]
fn the_trajectory_starts_at_the_triangle_and_ends_at_the_circle() {
    let script = Script::default();
    let plot = Plot::of(&script, &["--figure", "trajectory"]);
    let svg = plot.svg(FigureKind::Trajectory);
    let end = (script.drives[0] + STOPPING - 1) as f64 * PERIOD_NS as f64 * 1e-9;
    for (class, name, time) in [("mark start", "start", 0.0), ("mark end", "end", end)] {
        let [x, y] = recorded::point(time);
        assert_eq!(titles(&svg, class), [format!("{name} ({x:.3}, {y:.3})")]);
    }
    assert!(
        !plot.path("position.svg").exists(),
        "only what was asked for"
    );
}

#[test]
fn lost_markers_are_shaded_when_they_were_lost() {
    let plot = Plot::of(&Script::default(), &["--format", "svg"]);
    let position = plot.svg(FigureKind::Position);
    // Once in each of the two panels.
    let shaded = "markers lost: 2.000 to 2.200";
    assert_eq!(titles(&position, "span"), [shaded; 2]);
    assert!(
        position.contains(">markers lost</text>"),
        "and the legend says so"
    );
    assert!(has_path(&plot.svg(FigureKind::Trajectory), "lost"));

    let seen = Script {
        lost: 200..201,
        ..Script::default()
    };
    let plot = Plot::of(&seen, &["--format", "svg"]);
    assert!(!plot.svg(FigureKind::Position).contains("markers lost"));
}

#[test]
fn a_shaded_span_lies_where_the_time_axis_has_its_time() {
    let plot = Plot::of(&Script::default(), &["--figure", "steering"]);
    let svg = plot.svg(FigureKind::Steering);
    let attribute = |line: &str, name: &str| -> f64 {
        let (_, rest) = line.split_once(&format!(" {name}=\"")).unwrap();
        rest.split_once('"').unwrap().0.parse().unwrap()
    };
    let line = |part: &str| svg.lines().find(|line| line.contains(part)).unwrap();
    let (frame, span) = (line("class=\"frame\""), line("markers lost:"));
    let end = (1_000 + STOPPING - 1) as f64 * 0.01;
    let left = attribute(frame, "x") + attribute(frame, "width") * 2.0 / end;
    assert!((attribute(span, "x") - left).abs() < 0.02, "{frame} {span}");
    let width = attribute(frame, "width") * 0.2 / end;
    assert!((attribute(span, "width") - width).abs() < 0.02);
}

#[test]
fn of_several_drives_the_operators_last_is_drawn_unless_one_is_chosen() {
    let script = Script {
        drives: vec![300, 600, 500],
        ..Script::default()
    };
    let plot = Plot::of(&script, &["--figure", "trajectory"]);
    let ends_at = |plot: &Plot, ticks: u64| {
        let [x, y] = recorded::point((ticks + STOPPING - 1) as f64 * 0.01);
        let svg = plot.svg(FigureKind::Trajectory);
        assert_eq!(titles(&svg, "mark end"), [format!("end ({x:.3}, {y:.3})")]);
    };
    ends_at(&plot, 500);
    assert!(plot.said().contains("drive 3 of 3"), "{}", plot.said());
    let plot = Plot::of(&script, &["--figure", "trajectory", "--drive", "1"]);
    ends_at(&plot, 300);
    for number in ["0", "4"] {
        let plot = Plot::of(&script, &["--drive", number]);
        assert!(!plot.output.status.success());
        assert!(plot.said().contains("from 1 to 3"), "{}", plot.said());
    }
}

#[test]
fn of_several_records_every_drive_has_a_number_and_a_line() {
    let folder = tempfile::tempdir().unwrap();
    let paths = ["one.mcap", "two.mcap", "none.mcap"].map(|name| folder.path().join(name));
    for (path, drives) in paths.iter().zip([vec![300, 600], vec![400], vec![]]) {
        let script = Script {
            drives,
            ..Script::default()
        };
        recorded::write(path, &script);
    }
    let [one, two, none] = &paths;
    let more = [two.to_str().unwrap(), none.to_str().unwrap()];
    let listed = plot(one, &[&more[..], &["--list"]].concat());
    let text = String::from_utf8(listed.stdout).unwrap();
    let lines: Vec<_> = text.lines().collect();
    assert_eq!(lines.len(), 3, "{text}");
    assert!(
        lines[2].contains("   3  ") && lines[2].ends_with("two.mcap"),
        "{text}"
    );
    assert!(lines[1].contains("circle"), "{text}");
    let plotted = plot(one, &[&more[..], &["--figure", "trajectory"]].concat());
    assert!(plotted.status.success());
    assert!(folder.path().join("two/trajectory.svg").exists());
    let plotted = plot(
        one,
        &[&more[..], &["--figure", "trajectory", "--drive", "1"]].concat(),
    );
    assert!(plotted.status.success());
    assert!(folder.path().join("one/trajectory.svg").exists());
}

#[test]
fn a_record_without_a_drive_says_what_there_is_instead() {
    let script = Script {
        drives: vec![],
        ..Script::default()
    };
    let plot = Plot::of(&script, &[]);
    assert!(!plot.output.status.success());
    let said = plot.said();
    assert!(
        said.contains("drive.mcap") && said.contains("last mode was ready"),
        "{said}"
    );
    assert!(!plot.folder.path().join("drive").exists());
}

#[test]
fn figures_that_lack_something_are_named_and_the_others_drawn() {
    let script = Script {
        estimate: false,
        ..Script::default()
    };
    let plot = Plot::of(&script, &["--format", "svg"]);
    for missing in ["trajectory", "position", "tracking-error"] {
        assert!(
            plot.said().contains(&format!("no figure {missing}:")),
            "{}",
            plot.said()
        );
        assert!(!plot.path(&format!("{missing}.svg")).exists());
    }
    assert!(has_path(&plot.svg(FigureKind::Steering), "actual"));
    assert!(has_path(&plot.svg(FigureKind::Speed), "measured"));
}

#[test]
fn an_unfinished_record_is_drawn_as_far_as_it_goes() {
    let script = Script {
        finished: false,
        ..Script::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("drive.mcap");
    recorded::write(&record, &script);
    assert!(part_path(&record).exists());
    // By the name that it will have, and by the one that it has.
    for name in [record.clone(), part_path(&record)] {
        let output = plot(&name, &["--figure", "position"]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{said}");
        assert!(said.contains("unfinished"), "{said}");
        let svg = fs::read_to_string(folder.path().join("drive/position.svg")).unwrap();
        assert!(has_path(&svg, "actual"));
    }
}

/// The middle of the last chunk that begins before `before`: an index may be damaged
/// without any harm.
fn within_a_chunk(bytes: &[u8], before: usize) -> usize {
    const MAGIC_LENGTH: usize = 8;
    const CHUNK: u8 = 6;
    let mut at = MAGIC_LENGTH;
    let mut place = None;
    while at < before {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap());
        let length = usize::try_from(length).unwrap();
        if bytes[at] == CHUNK {
            place = Some(at + 9 + length / 2);
        }
        at += 9 + length;
    }
    place.unwrap()
}

#[test]
fn a_damaged_record_is_drawn_up_to_the_damage() {
    let script = Script {
        drives: vec![6_000],
        ..Script::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("drive.mcap");
    recorded::write(&record, &script);
    let mut bytes = fs::read(&record).unwrap();
    let place = within_a_chunk(&bytes, bytes.len() * 3 / 4);
    bytes[place] ^= 0xff;
    fs::write(&record, bytes).unwrap();
    let output = plot(&record, &["--format", "html"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("is damaged after"), "{said}");
    let html = fs::read_to_string(folder.path().join("drive/report.html")).unwrap();
    assert!(html.contains("is damaged after"), "the report says so, too");
    assert!(html.contains("never stopped; the record ends while the car is driven"));
}

#[test]
fn a_folder_that_can_not_be_written_is_named_with_the_fix() {
    let folder = tempfile::tempdir().unwrap();
    let taken = folder.path().join("taken");
    fs::write(&taken, "a file").unwrap();
    let record = folder.path().join("drive.mcap");
    recorded::write(&record, &Script::default());
    let output = plot(&record, &["--out", taken.to_str().unwrap()]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success());
    assert!(said.contains("taken") && said.contains("--out"), "{said}");
}

#[test]
fn the_report_is_one_file_with_summary_figures_and_numbers() {
    let plot = Plot::of(&Script::default(), &[]);
    assert!(plot.output.status.success(), "{}", plot.said());
    let html = fs::read_to_string(plot.path("report.html")).unwrap();
    for kind in FigureKind::ALL {
        let figure = format!("<figure id=\"{}\"", kind.name());
        assert_eq!(html.matches(&figure).count(), 1, "{figure}");
    }
    for outside in ["http://", "https://", "src=", "href=", "@import", "url("] {
        let own = html.replace("http://www.w3.org/2000/svg", "");
        // The animation is in the file.
        let own = own.replace("src=\"data:image/svg+xml;base64,", "");
        assert!(!own.contains(outside), "needs nothing else: {outside}");
    }
    let line = |name: &str| {
        let start = format!("<th scope=\"row\">{name}</th><td>");
        let (_, rest) = html.split_once(&start).unwrap_or_else(|| panic!("{name}"));
        rest.split_once("</td>").unwrap().0
    };
    let error = {
        // Two points at 1 m and 0.9 m, 0.4 rad apart.
        let (radius, driven) = (recorded::RADIUS, recorded::DRIVEN_RADIUS);
        (radius.powi(2) + driven.powi(2) - 2.0 * radius * driven * recorded::LAG.cos()).sqrt()
    };
    for (name, words) in [
        ("begun", "2023-11-14 22:13:20 UTC"),
        (
            "duration",
            "10.19 s, of which P followed its reference for 9.99 s",
        ),
        ("ended", "stopped on request at 10.00 s; then ready"),
        ("tracking error", &format!("{:.1} mm RMS", error * 1000.0)),
        ("speed", "0.400 m/s at the median"),
        ("markers", "lost once, for 200 ms at most; 20 frames"),
        ("ticks", "1020, 0 deadlines missed"),
        (
            "lateness",
            "60 µs at the median, 60 µs at 99 %, 2000 µs at most",
        ),
        ("capture to command", "12.0 ms at the median"),
        (
            "law",
            "p = 0.35 m, estimated l_f = 0.1368 m (dl = 0.0000 m)",
        ),
        ("reference", "circle: angular_velocity_rad_s = 0.5"),
        ("versions", "singletrackd 0.1.0, protocol 1"),
        ("seed of the simulation", "7"),
        ("log", "1 warning, 0 errors"),
    ] {
        assert!(line(name).contains(words), "{name}: {}", line(name));
    }
    assert!(html.contains("<td>10.000</td><td>stopping</td><td>requested</td>"));
    assert!(
        html.contains("point_distance_m = 0.35"),
        "the configuration"
    );

    let (data, columns) = embedded(&html);
    let figures = data["figures"].as_array().unwrap();
    let map = figures
        .iter()
        .find(|figure| figure["id"] == "trajectory")
        .unwrap();
    let curve = &map["panels"][0]["curves"][2];
    assert_eq!(curve["look"], "actual");
    let column = |axis: &str| &columns[usize::try_from(curve[axis].as_u64().unwrap()).unwrap()];
    let [x, y] = recorded::point(5.0);
    assert_eq!(column("x").len(), 1_020);
    assert!((f64::from(column("time")[500]) - 5.0).abs() < 1e-6);
    assert!((f64::from(column("x")[500]) - x).abs() < 1e-6);
    assert!((f64::from(column("y")[500]) - y).abs() < 1e-6);
    let spans = &figures[2]["panels"][0]["spans"];
    assert_eq!(*spans, serde_json::json!([[2.0, 2.2]]));
}

#[test]
fn what_a_record_says_is_text_in_the_report_whatever_it_is() {
    let evil = "</script><img src=x onerror=alert(1)>&amp;\u{1b}[31m";
    let script = Script {
        log: evil.to_owned(),
        ..Script::default()
    };
    let plot = Plot::of(&script, &["--format", "html"]);
    assert!(plot.output.status.success(), "{}", plot.said());
    let html = fs::read_to_string(plot.path("report.html")).unwrap();
    assert!(html.contains("&lt;/script&gt;&lt;img src=x onerror=alert(1)&gt;&amp;amp;"));
    assert_eq!(html.matches("<img").count(), 1, "the animation");
    assert!(!html.contains('\u{1b}'));
    assert_eq!(html.matches("</script>").count(), 2, "those of the page");
    assert!(
        !plot.path("position.svg").exists(),
        "html alone was asked for"
    );
}

#[test]
fn a_reference_that_is_a_velocity_is_integrated_to_the_nominal_path() {
    let script = Script {
        velocity_only: true,
        lost: 0..0,
        ..Script::default()
    };
    let plot = Plot::of(&script, &[]);
    let html = fs::read_to_string(plot.path("report.html")).unwrap();
    let (data, columns) = embedded(&html);
    let curve = &data["figures"][0]["panels"][0]["curves"][0];
    assert_eq!(curve["look"], "nominal");
    let column = |axis: &str| &columns[usize::try_from(curve[axis].as_u64().unwrap()).unwrap()];
    // From where P was at first along the circle of the commanded velocity.
    let ([x, y], [from_x, from_y]) = (recorded::point(0.0), recorded::reference(0.0));
    let [to_x, to_y] = recorded::reference(9.99);
    let (end_x, end_y) = (f64::from(column("x")[999]), f64::from(column("y")[999]));
    assert!((end_x - (x + to_x - from_x)).abs() < 0.005, "{end_x}");
    assert!((end_y - (y + to_y - from_y)).abs() < 0.005, "{end_y}");
    assert!(
        column("x")[1_000].is_nan(),
        "once it stops there is no reference"
    );
}

#[test]
fn a_drive_is_reported_with_its_own_configuration() {
    let script = Script {
        drives: vec![300, 200],
        other_distance: Some(0.5),
        ..Script::default()
    };
    for (drive, distance) in [("1", "p = 0.35 m"), ("2", "p = 0.5 m")] {
        let plot = Plot::of(&script, &["--drive", drive]);
        let html = fs::read_to_string(plot.path("report.html")).unwrap();
        assert!(html.contains(distance), "drive {drive}: {distance}");
    }
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn ten_minutes_fit_into_a_report_of_ten_megabytes() {
        let script = Script {
            drives: vec![60_000],
            ..Script::default()
        };
        let plot = Plot::of(&script, &[]);
        assert!(plot.output.status.success(), "{}", plot.said());
        let bytes = fs::metadata(plot.path("report.html")).unwrap().len();
        assert!(bytes < 10_000_000, "{bytes} B");
        for kind in FigureKind::ALL {
            let bytes = plot.svg(kind).len();
            assert!(bytes < 200_000, "{}: {bytes} B", kind.name());
        }
    }
}
