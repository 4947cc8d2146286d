//! The figures of `singletrack stability`: that they show what its tables say.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use crate::picture::{Frame, attribute, covers, labels, pieces, titled};

fn stability(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack-lab"))
        .arg("stability")
        .args(arguments)
        .output()
        .unwrap()
}

fn printed(arguments: &[&str]) -> String {
    let output = stability(arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.is_empty(), "{said}");
    String::from_utf8(output.stdout).unwrap()
}

/// The rows of a table.
fn rows(arguments: &[&str]) -> Vec<Vec<f64>> {
    let text = printed(arguments);
    let lines = text.lines().skip(1);
    let row = |line: &str| {
        line.split(',')
            .map(|field| field.parse().unwrap_or(f64::NAN))
            .collect()
    };
    lines.map(row).collect()
}

const COARSE: [&str; 4] = ["--speeds", "0.5:8:0.25", "--dl", "-0.7:0.2:0.0125"];

/// The figures in a folder, drawn with these arguments.
fn drawn(folder: &Path, arguments: &[&str]) -> Vec<String> {
    let out = folder.to_str().unwrap();
    let mut all = vec!["figures", "--out", out];
    all.extend(arguments);
    let named = printed(&all);
    let file = |line: &str| {
        let path = Path::new(line);
        let svg = fs::read_to_string(path).unwrap();
        assert!(svg.starts_with("<svg xmlns") && svg.ends_with("</svg>\n"));
        assert!(svg.len() < 100_000 && !svg.contains("NaN"), "{line}");
        path.file_name().unwrap().to_str().unwrap().to_owned()
    };
    named.lines().map(file).collect()
}

#[test]
fn the_regions_are_those_of_the_table() {
    for (law, range) in [
        ("front-point", "-0.7:0.2:0.0125"),
        ("velocity-point", "-0.2:0.2:0.0125"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let speeds = "0.5:8:0.25";
        let grid = ["--speeds", speeds, "--dl", range, "--law", law];
        let figure = ["--figure", "region"];
        drawn(folder.path(), &[&grid[..], &figure].concat());
        let svg = fs::read_to_string(folder.path().join("region.svg")).unwrap();
        let ends: Vec<f64> = range.split(':').map(|part| part.parse().unwrap()).collect();
        let frame = Frame::of(&svg, 0, [0.5, 8.0], [ends[0], ends[1]]);
        let dark = titled(&svg, "shade dark", "unstable");
        let light = titled(&svg, "shade light", "stable");
        let mut unstable = 0;
        for row in rows(&[&["region"][..], &grid].concat()) {
            let [speed, dl, largest, stable] = row[..] else {
                panic!("{row:?}");
            };
            let edge = speed <= 0.5 || speed >= 8.0 || dl <= ends[0] || dl >= ends[1];
            // Less than a line's width from the boundary either may be drawn.
            if edge || largest.abs() < 0.05 {
                continue;
            }
            let place = frame.at([speed, dl]);
            assert_eq!(covers(dark, place), stable == 0.0, "{law} {row:?}");
            assert_eq!(covers(light, place), stable == 1.0, "{law} {row:?}");
            unstable += u32::from(stable == 0.0);
        }
        assert!(unstable > 100);
    }
}

#[test]
fn what_stands_along_the_hopf_curve_are_its_lyapunov_coefficients() {
    for law in ["front-point", "velocity-point"] {
        let svg = printed(&["hopf", "--law", law, "--format", "svg"]);
        let table = rows(&["hopf", "--law", law]);
        // Where the frame is in values follows from the first and the last point.
        let curve = pieces(titled(&svg, "boundary", "Hopf points"));
        let (first, last) = (curve[0][0], curve[0][curve[0].len() - 1]);
        let ends = [&table[0], &table[table.len() - 1]];
        let value = |place: [f64; 2], axis: usize| {
            let part = (place[axis] - first[axis]) / (last[axis] - first[axis]);
            ends[0][axis] + part * (ends[1][axis] - ends[0][axis])
        };
        let lines: Vec<&str> = svg.lines().collect();
        let mut told = 0;
        for (index, line) in lines.iter().enumerate() {
            if !line.starts_with("<circle class=\"point\"") || lines[index + 1].contains("<path") {
                continue;
            }
            let Some((text, _)) = labels(lines[index + 1]).into_iter().next() else {
                continue;
            };
            let place = ["cx", "cy"].map(|name| attribute(line, name).parse::<f64>().unwrap());
            let row = table
                .iter()
                .find(|row| (row[0] - value(place, 0)).abs() < 0.01)
                .unwrap();
            assert!((row[1] - value(place, 1)).abs() < 0.002, "{law} {row:?}");
            let expected = format!("{:.1e}", row[4]);
            let plain: f64 = match text.split_once("·10⁻") {
                Some((factor, power)) => {
                    let power = "⁰¹²³⁴⁵⁶⁷⁸⁹"
                        .chars()
                        .position(|digit| power == digit.to_string());
                    format!("{factor}e-{}", power.unwrap()).parse().unwrap()
                }
                None => text.parse().unwrap(),
            };
            assert_eq!(format!("{plain:.1e}"), expected, "{law} {row:?}");
            told += 1;
        }
        assert!(told >= 6, "{law}: {told}");
    }
}

#[test]
fn the_papers_range_and_limit_are_drawn_at_their_values() {
    let folder = tempfile::tempdir().unwrap();
    let law = ["--law", "front-point", "--figure", "region"];
    drawn(folder.path(), &[&COARSE[..], &law].concat());
    let svg = fs::read_to_string(folder.path().join("region.svg")).unwrap();
    let frame = Frame::of(&svg, 0, [0.5, 8.0], [-0.7, 0.2]);
    for (class, title, dl) in [
        ("range-end", "physically meaningful range: -0.1368", -0.1368),
        ("range-end", "physically meaningful range: 0.1232", 0.1232),
        ("asymptote", "v → ∞: -0.14272", -0.142_728),
    ] {
        let [_, y] = frame.at([1.0, dl]);
        let line = &pieces(titled(&svg, class, title))[0];
        assert!(line.iter().all(|place| (place[1] - y).abs() < 0.02));
    }
}

#[test]
fn a_folder_that_cannot_be_made_and_a_map_without_area_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let law = ["figures", "--law", "front-point", "--out"];
    for (out, more, words) in [
        (&file, &["--speeds", "1:2:1"][..], "file"),
        (
            &folder.path().join("out"),
            &["--speeds", "1"],
            "two values or more along x",
        ),
    ] {
        let output = stability(&[&law[..], &[out.to_str().unwrap()], more].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(words), "{said}");
    }
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn there_is_a_figure_of_region_and_eigenvalues_and_three_of_the_sampled_loop() {
        for law in ["front-point", "velocity-point"] {
            let folder = tempfile::tempdir().unwrap();
            // Few points: the sampled loop takes its time.
            let few = ["--speeds", "1:4:1", "--dl", "-0.1:0.1:0.05", "--law", law];
            let expected = [
                "region.svg",
                "eigenvalues.svg",
                "spectral-radius.svg",
                "delay-margin.svg",
                "marker-interval.svg",
            ];
            assert_eq!(drawn(folder.path(), &few), expected);
        }
    }
}
