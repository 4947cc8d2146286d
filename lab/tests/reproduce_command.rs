//! `singletrack reproduce` as a person or a script sees it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::OnceLock,
};

fn reproduce(out: &Path, options: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack-lab"))
        .args(["reproduce", "--quick", "--out"])
        .arg(out)
        .args(options)
        .output()
        .unwrap()
}

/// One run for all tests that only look: it takes a while.
struct Reproduced {
    _folder: tempfile::TempDir,
    out: PathBuf,
    output: Output,
}

impl Reproduced {
    fn get() -> &'static Self {
        static ONCE: OnceLock<Reproduced> = OnceLock::new();
        ONCE.get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let out = folder.path().join("reproduction");
            let output = reproduce(&out, &[]);
            Self {
                _folder: folder,
                out,
                output,
            }
        })
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.out.join(name)).unwrap()
    }

    fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.read("claims.json")).unwrap()
    }

    fn claim(&self, id: &str) -> serde_json::Value {
        let json = self.json();
        let claims = json["claims"].as_array().unwrap();
        let claim = claims.iter().find(|claim| claim["id"] == id);
        claim.unwrap_or_else(|| panic!("no claim {id}")).clone()
    }

    fn files(&self, folder: &str) -> Vec<PathBuf> {
        fs::read_dir(self.out.join(folder))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect()
    }
}

/// Every tag is closed, in order: an XML reader's first demand.
fn assert_well_formed(svg: &str, path: &Path) {
    let mut open = Vec::new();
    let mut rest = svg;
    while let Some((text, after)) = rest.split_once('<') {
        assert!(!text.contains('>'), "{}: {text}", path.display());
        let (tag, after) = after.split_once('>').unwrap();
        let name = tag
            .trim_start_matches('/')
            .split([' ', '/'])
            .next()
            .unwrap();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "{}", path.display());
        } else if !tag.ends_with('/') {
            open.push(name);
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "{}: {tag}", path.display());
        rest = after;
    }
    assert!(open.is_empty(), "{}: {open:?}", path.display());
}

#[test]
fn a_folder_with_foreign_files_is_refused_before_anything_is_computed() {
    let folder = tempfile::tempdir().unwrap();
    let thesis = folder.path().join("thesis.tex");
    fs::write(&thesis, "mine").unwrap();
    let output = reproduce(folder.path(), &[]);
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success());
    assert!(
        error.contains("thesis.tex") && error.contains("--out"),
        "{error}"
    );
    assert_eq!(fs::read_to_string(thesis).unwrap(), "mine");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_file_in_the_place_of_the_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "mine").unwrap();
    for out in [file.clone(), file.join("below")] {
        let output = reproduce(&out, &[]);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success());
        assert!(error.contains("file") && error.contains("--out"), "{error}");
    }
    assert_eq!(fs::read_to_string(file).unwrap(), "mine");
}

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tools/vehicles")
        .join(name)
}

#[test]
fn a_car_that_is_none_is_refused_by_name_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let broken = folder.path().join("broken.toml");
    let paper = fs::read_to_string(shipped("paper.toml")).unwrap();
    for (text, word) in [
        (paper.replace("mass_kg", "weight_kg"), "weight_kg"),
        (paper.replace("mass_kg = 1.9", "mass_kg = -1.9"), "mass_kg"),
        ("[car]".to_owned(), "[vehicle]"),
    ] {
        fs::write(&broken, text).unwrap();
        let output = reproduce(&out, &["--vehicle", broken.to_str().unwrap()]);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && !out.exists());
        assert!(
            error.contains(word) && error.contains("broken.toml"),
            "{error}"
        );
    }
    let output = reproduce(&out, &["--vehicle", "nowhere.toml"]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("nowhere.toml"));
    assert!(!out.exists());
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn the_papers_slips_differ_and_say_what_is_so_instead() {
        let run = Reproduced::get();
        for (id, measured, tolerance) in [
            ("circle-amplitude", 0.894_427_191, 1e-5),
            ("circle-lag", 0.463_647_609, 1e-5),
            ("steps-uncertain-integrators", 0.2464, 1e-4),
            ("singularity", 0.0, 1e-15),
            ("eigenvalues-appendix-count", 3.0, 0.0),
            ("appendix-threshold-front-only", 0.442_195, 1e-4),
        ] {
            let claim = run.claim(id);
            assert_eq!(claim["verdict"], "differs", "{id}");
            let value = claim["measured"][0]["value"].as_f64().unwrap();
            assert!((value - measured).abs() <= tolerance, "{id}: {value}");
            assert!(claim["measured"][0]["should_be"].is_string(), "{id}");
            assert!(!claim["why"].as_str().unwrap().is_empty(), "{id}");
        }
    }

    #[test]
    fn every_claim_has_a_name_a_number_and_a_reason_and_only_slips_differ() {
        let json = Reproduced::get().json();
        let claims = json["claims"].as_array().unwrap();
        let ids: BTreeSet<_> = claims.iter().map(|claim| claim["id"].to_string()).collect();
        assert_eq!(ids.len(), claims.len());
        for claim in claims {
            let id = &claim["id"];
            let numbers = claim["measured"].as_array().unwrap();
            assert!(!numbers.is_empty(), "{id}");
            for text in ["claim", "paper", "why"].map(|key| claim[key].as_str().unwrap()) {
                assert!(
                    !text.is_empty() && !text.contains(['{', '\n']),
                    "{id}: {text}"
                );
                assert!(!text.contains("</"), "{id}: {text}");
            }
            let is_slip = numbers.iter().any(|number| !number["should_be"].is_null());
            assert_eq!(claim["verdict"] == "differs", is_slip, "{id}");
        }
    }

    #[test]
    fn the_documentation_has_every_claim_that_does_not_agree_and_the_number_of_those_that_do() {
        let page = include_str!("../../docs/reproduction.md");
        let json = Reproduced::get().json();
        let claims = json["claims"].as_array().unwrap();
        let mut agree = 0;
        for claim in claims {
            let (section, text) = (&claim["section"], claim["claim"].as_str().unwrap());
            let verdict = match claim["verdict"].as_str().unwrap() {
                "agrees" => {
                    agree += 1;
                    continue;
                }
                "agrees-in-simulation" => "in simulation",
                "not-comparable" => "**n/a**",
                _ => "**differs**",
            };
            let row = format!("| {section} | {text} | {verdict} |\n");
            assert!(page.contains(&row), "docs/reproduction.md lacks {row}");
        }
        let count = format!("Of {} claims {agree} agree;", claims.len());
        assert!(page.contains(&count), "docs/reproduction.md lacks {count}");
    }

    #[test]
    fn what_the_paper_says_of_stability_agrees() {
        let run = Reproduced::get();
        for id in [
            "hopf-negative",
            "hopf-outside",
            "hopf-subcritical",
            "structurally-stable",
            "eigenvalues-negative",
            "appendix-threshold",
            "appendix-subcritical",
            "steps-integrators",
            "compare-parameters",
        ] {
            assert_eq!(run.claim(id)["verdict"], "agrees", "{id}");
        }
        let threshold = run.claim("appendix-threshold");
        let value = threshold["measured"][0]["value"].as_f64().unwrap();
        assert!((value - 0.135_977_266).abs() < 1e-6, "{value}");
        let limit = run.claim("hopf-outside");
        let value = limit["measured"][1]["value"].as_f64().unwrap();
        assert!((value + 0.142_728).abs() < 1e-6, "{value}");
    }

    #[test]
    fn the_simulated_car_does_what_the_equations_say() {
        let run = Reproduced::get();
        for (id, index, measured, tolerance) in [
            ("circle-amplitude", 1, 0.894_4, 0.01),
            ("circle-lag", 1, 0.463_6, 0.01),
            ("circle-linear-tools", 1, 0.0, 0.01),
            ("steps-losses", 0, 0.0, 0.05),
        ] {
            let claim = run.claim(id);
            let value = claim["measured"][index]["value"].as_f64().unwrap();
            assert!((value - measured).abs() <= tolerance, "{id}: {value}");
        }
    }

    #[test]
    fn the_claims_are_the_same_in_json_csv_table_and_report() {
        let run = Reproduced::get();
        let json = run.json();
        let claims = json["claims"].as_array().unwrap();
        let mut reader = csv::Reader::from_path(run.out.join("claims.csv")).unwrap();
        let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        let report = run.read("report.html");
        let numbers: usize = claims
            .iter()
            .map(|claim| claim["measured"].as_array().unwrap().len())
            .sum();
        assert_eq!(rows.len(), numbers);
        for claim in claims {
            let id = claim["id"].as_str().unwrap();
            let row = rows.iter().find(|row| &row[0] == id).unwrap();
            let verdict = claim["verdict"].as_str().unwrap();
            let name = verdict.replace("not-comparable", "n/a").replace('-', " ");
            assert_eq!(&row[9], name, "{id}");
            assert!(report.contains(&format!("<tr id=\"{id}\"")), "{id}");
        }
        let table = String::from_utf8_lossy(&run.output.stdout);
        assert!(table.contains(&format!("{} claims:", claims.len())));
    }

    #[test]
    fn every_figure_of_the_report_says_what_the_papers_shows_and_what_ours_shows() {
        let run = Reproduced::get();
        let report = run.read("report.html");
        let figures = report.matches("<figure").count();
        assert!(figures >= 20, "only {figures} figures");
        for figure in report.split("<figure").skip(1) {
            let figure = figure.split("</figure>").next().unwrap();
            let (_, caption) = figure.split_once("<figcaption>").unwrap();
            let (paper, ours) = caption.split_once("<b>Ours.</b>").unwrap();
            let paper = paper.split_once("<b>The paper.</b>").unwrap().1;
            assert!(
                paper.trim().len() > 12 && ours.trim().len() > 40,
                "{caption}"
            );
            assert!(figure.contains("<svg"), "no picture: {caption}");
            assert!(
                !ours.contains("NaN") && !ours.contains("not a number") && !ours.contains("(not "),
                "{ours}"
            );
        }
    }

    #[test]
    fn the_report_needs_no_network_and_no_script() {
        let report = Reproduced::get().read("report.html");
        assert!(!report.contains("<script"));
        for part in ["src=", "@import", "url(", "<link", "<iframe", "<object"] {
            assert!(!report.contains(part), "{part}");
        }
        // A name space is no address.
        let addresses = report.replace("http://www.w3.org/2000/svg", "");
        assert!(!addresses.contains("http"), "an address");
    }

    #[test]
    fn every_picture_is_a_file_and_every_link_to_data_leads_somewhere() {
        let run = Reproduced::get();
        let report = run.read("report.html");
        let pictures = run.files("figures");
        assert_eq!(report.matches("<svg").count(), pictures.len());
        for picture in pictures {
            let svg = fs::read_to_string(&picture).unwrap();
            assert_well_formed(&svg, &picture);
            assert!(!svg.contains("NaN"), "{}", picture.display());
        }
        let links: Vec<&str> = report
            .split("<a href=\"data/")
            .skip(1)
            .map(|rest| rest.split('"').next().unwrap())
            .collect();
        assert_eq!(links.len(), run.files("data").len());
        for link in links {
            let path = run.out.join("data").join(link);
            let mut reader = csv::Reader::from_path(&path).unwrap();
            assert!(reader.records().all(|row| row.is_ok()), "{link}");
        }
    }

    #[test]
    fn the_data_hold_the_trajectories_and_the_curves() {
        let run = Reproduced::get();
        for (name, header, least) in [
            ("steps-dl-rear-car", "t,yaw,", 361),
            ("circle-outside-ideal", "t,yaw,", 601),
            ("hopf-front-point", "speed_m_s,dl_hopf_m,", 40),
            ("eigenvalues-velocity-point", "speed_m_s,dl_m,re1,im1,", 600),
        ] {
            let csv = run.read(&format!("data/{name}.csv"));
            assert!(csv.starts_with(header), "{name}");
            assert!(csv.lines().count() > least, "{name}");
        }
    }

    #[test]
    fn every_claim_comes_out_as_expected_and_the_command_succeeds() {
        let run = Reproduced::get();
        let error = String::from_utf8_lossy(&run.output.stderr);
        let table = String::from_utf8_lossy(&run.output.stdout);
        assert!(run.output.status.success(), "{error}\n{table}");
        assert!(error.is_empty(), "{error}");
        assert!(table.contains("all as expected"), "{table}");
        assert!(
            table.trim_end().ends_with("report.html"),
            "the report is named last"
        );
    }

    /// The reproduction for another car, in the folder of an earlier one with a note and an old picture.
    fn for_another_car() -> &'static Reproduced {
        static ONCE: OnceLock<Reproduced> = OnceLock::new();
        ONCE.get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let mut copy = Command::new("cp");
            copy.arg("-r").arg(&Reproduced::get().out);
            assert!(copy.arg(folder.path()).status().unwrap().success());
            let out = folder.path().join("reproduction");
            fs::write(out.join(NOTES), "mine").unwrap();
            fs::write(out.join(PICTURE), "an old picture").unwrap();
            let vehicle = shipped("bmw-320i.toml");
            let output = reproduce(&out, &["--vehicle", vehicle.to_str().unwrap()]);
            Reproduced {
                _folder: folder,
                out,
                output,
            }
        })
    }

    const NOTES: &str = "notes.txt";
    const PICTURE: &str = "figures/circle-trajectory-ideal.svg";

    #[test]
    fn a_reproduction_replaces_an_earlier_one_and_nothing_else() {
        let run = for_another_car();
        assert!(run.output.status.success());
        assert_eq!(run.read(NOTES), "mine");
        assert!(run.read(PICTURE).starts_with("<svg"));
    }

    #[test]
    fn for_another_car_everything_is_computed_and_the_papers_numbers_are_not_compared() {
        let run = for_another_car();
        let error = String::from_utf8_lossy(&run.output.stderr);
        assert!(run.output.status.success(), "{error}");
        let json = run.json();
        let claim = |id: &str| {
            let mut claims = json["claims"].as_array().unwrap().iter();
            claims.find(|claim| claim["id"] == id).unwrap()
        };
        let wheelbase = 2.5789;
        assert_eq!(claim("appendix-threshold")["verdict"], "not-comparable");
        // Ten times as large, and the same law.
        let amplitude = claim("circle-amplitude");
        assert_eq!(amplitude["verdict"], "differs");
        let value = amplitude["measured"][0]["value"].as_f64().unwrap();
        assert!(
            (value / wheelbase * 0.26 - 0.894_427).abs() < 1e-4,
            "{value}"
        );
        assert_eq!(claim("steps-integrators")["verdict"], "agrees");
        let report = run.read("report.html");
        assert!(report.contains("bmw-320i.toml") && report.contains("not driven"));
    }
}
