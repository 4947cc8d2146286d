//! The comparison of controllers: its table, and that parts of it give the same.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;

use clap::ValueEnum as _;
use singletrack_campaign::{Campaign, CampaignArgs};
use singletrack_lab::compare::{
    Comparison, Condition, ControllerName, DELAYS_HEADER, HEADER, PathName, csv, delays,
    delays_csv, delays_markdown, figure, lines, markdown,
};

fn plan(controllers: &[ControllerName], conditions: &[Condition]) -> Comparison {
    Comparison {
        controllers: controllers.iter().map(|&one| one.into()).collect(),
        paths: vec![PathName::LaneChange],
        speeds_m_s: vec![1.0],
        conditions: conditions.to_vec(),
        first_seed: 1,
        seeds: 2,
        delay_seeds: 2,
    }
}

/// The place of `stops` among the fields after the condition.
const STOPS: usize = 9;
/// That of `worst_condition`.
const WORST: usize = 13;

/// That of `rank`.
const RANK: usize = 14;

fn run(plan: &Comparison, arguments: &CampaignArgs) -> Campaign<Comparison> {
    Campaign::obtain(plan.clone(), arguments).unwrap()
}

/// The campaign in parts, of which each has a file.
fn merged(plan: &Comparison, parts: u32) -> Campaign<Comparison> {
    let folder = tempfile::tempdir().unwrap();
    let shards = (1..=parts).map(|index| {
        let path = folder.path().join(format!("{index}.jsonl"));
        let arguments = CampaignArgs {
            shard: Some(format!("{index}/{parts}").parse().unwrap()),
            json: Some(path.clone()),
            threads: Some(1),
            ..CampaignArgs::default()
        };
        run(plan, &arguments);
        path
    });
    let arguments = CampaignArgs {
        from: shards.collect(),
        ..CampaignArgs::default()
    };
    // The plan of the files counts, not this one.
    let other = Comparison {
        controllers: vec![ControllerName::P.into()],
        ..plan.clone()
    };
    run(&other, &arguments)
}

/// The lines of a table without its header, by the columns before the numbers.
fn rows(csv: &str) -> BTreeMap<String, Vec<String>> {
    let (header, rows) = csv.split_once('\n').unwrap();
    assert_eq!(header, HEADER);
    let rows = rows.lines().map(|line| {
        let fields: Vec<String> = line.split(',').map(str::to_owned).collect();
        assert_eq!(fields.len(), HEADER.split(',').count(), "{line}");
        (format!("{} {}", fields[0], fields[3]), fields[4..].to_vec())
    });
    rows.collect()
}

#[test]
fn every_controller_drives_the_lane_change_and_feed_forward_is_better() {
    let plan = plan(ControllerName::value_variants(), &[Condition::Nominal]);
    let all = run(&plan, &CampaignArgs::default());
    let table = csv(&lines(&plan, &all.results));
    let rows_of_all = rows(&table);
    assert_eq!(
        rows_of_all.len(),
        2 * ControllerName::value_variants().len()
    );
    let value = |row: &str, column: usize| rows_of_all[row][column].parse::<f64>().unwrap();
    for controller in ControllerName::value_variants() {
        let name = controller.name();
        for row in [
            format!("{name} nominal"),
            format!("{name} nominal@front-axle"),
        ] {
            assert_eq!(rows_of_all[&row].first().unwrap(), "2", "{row}");
            assert_eq!(rows_of_all[&row][STOPS], "0", "{row}: stops");
            let [rate, most_rate, ripple] = [10, 11, 12].map(|column| value(&row, column));
            assert!(
                0.0 < rate && rate < most_rate && ripple > 0.0,
                "{row}: {table}"
            );
            let [rms, low, high, p99, max] = [1, 2, 3, 4, 5].map(|column| value(&row, column));
            assert!(low <= rms && rms <= high && p99 <= max, "{row}: {table}");
            assert!(rms > 1e-4, "{row}: {table}");
        }
        let across = value(&format!("{name} nominal"), 7);
        let most = if name == "p" { 0.1 } else { 0.03 };
        assert!(across < most, "{name} {across}");
    }
    let rms = |row: &str| value(row, 1);
    // The plan has the front axle on the path, within what the car moves in a tenth of a period.
    assert!(rms("mpc-single-track nominal@front-axle") < 1e-3, "{table}");
    assert!(rms("p nominal") > 10.0 * rms("p-ff nominal"), "{table}");
    assert!(rms("p-tuned nominal") < rms("p-ff nominal"), "{table}");
    // The front axle cuts the corner that P drives.
    assert!(
        rms("p-ff nominal@front-axle") > rms("stanley nominal@front-axle"),
        "{table}"
    );

    let page = markdown(&lines(&plan, &all.results));
    let picture = figure(&lines(&plan, &all.results)).unwrap();
    let [panel] = picture.panels.as_slice() else {
        panic!("{} panels", picture.panels.len());
    };
    let names = ControllerName::value_variants()
        .iter()
        .map(|name| name.name());
    assert_eq!(panel.names, names.collect::<Vec<_>>());
    for (place, estimate) in panel.estimates.iter().enumerate() {
        assert!((estimate.x - place as f64).abs() < 1e-9, "{estimate:?}");
        let [low, high] = estimate.interval;
        assert!(low <= estimate.value && estimate.value <= high);
        let name = format!("{} nominal@front-axle", panel.names[place]);
        assert!((estimate.value - 1e3 * value(&name, 1)).abs() < 1e-9);
    }
    let best = page.lines().find(|line| line.contains(" of 2 |")).unwrap();
    assert!(
        best.starts_with("| 1 | ") && !best.contains("| p |"),
        "{page}"
    );
    let rank = |row: &str| rows_of_all[row][RANK].parse::<usize>().unwrap();
    assert_eq!(
        rank("p nominal@front-axle"),
        ControllerName::value_variants().len(),
        "{table}"
    );
}

#[test]
fn a_car_that_stops_is_counted_and_has_no_error() {
    let plan = Comparison {
        controllers: vec![ControllerName::PFf.into()],
        paths: vec![PathName::LaneChange],
        speeds_m_s: vec![1.0],
        conditions: vec![Condition::Nominal],
        first_seed: 1,
        seeds: 1,
        delay_seeds: 1,
    };
    let mut campaign = run(&plan, &CampaignArgs::default());
    campaign.results[0].1.stopped = Some("geofence".to_owned());
    let table = csv(&lines(&plan, &campaign.results));
    let rows = rows(&table);
    let row = &rows["p-ff nominal"];
    assert_eq!(row[1..8].join(","), ",,,,,,", "{table}");
    assert_eq!(row[STOPS], "1", "{table}");
    assert_eq!(row.last().unwrap(), "geofence 1", "{table}");
    let lines = lines(&plan, &campaign.results);
    assert!(
        markdown(&lines).contains("| 1 of 1: geofence 1 |"),
        "{}",
        markdown(&lines)
    );
    // The picture says so, too.
    let picture = figure(&lines).unwrap();
    assert_eq!(picture.panels[0].estimates, []);
    assert_eq!(picture.panels[0].marks.len(), 1);
}

#[test]
fn differences_that_say_nothing_are_not_ranked() {
    use ControllerName::{PCompensated, PFf, PTuned, Stanley};
    let plan = plan(&[PFf, PTuned, PCompensated, Stanley], &[Condition::Nominal]);
    let mut campaign = run(&plan, &CampaignArgs::default());
    // By controller, the RMS in mm with both seeds.
    let found = [[4.0, 6.0], [4.5, 5.6], [2.0, 2.2], [2.05, 2.25]];
    for (unit, result) in &mut campaign.results {
        let [controller, seed] = [*unit as usize / 2, *unit as usize % 2];
        result.front_axle.as_mut().unwrap().rms = 1e-3 * found[controller][seed];
    }
    let lines = lines(&plan, &campaign.results);
    let rows = rows(&csv(&lines));
    let rank = |name: &str| rows[&format!("{name} nominal@front-axle")][RANK].clone();
    // Less than the floor between the best, and an interval with zero between the others.
    assert_eq!(rank("p-compensated"), "1");
    assert_eq!(rank("stanley"), "1");
    assert_eq!(rank("p-ff"), "3");
    assert_eq!(rank("p-tuned"), "3");
    let page = markdown(&lines);
    assert!(page.contains("| same | stanley |"), "{page}");

    // One seed tells nothing.
    let single = Comparison { seeds: 1, ..plan };
    let results = campaign.results.iter().step_by(2).cloned();
    let results: Vec<_> = results
        .enumerate()
        .map(|(unit, (_, result))| (unit as u64, result))
        .collect();
    let page = markdown(&singletrack_lab::compare::lines(&single, &results));
    assert!(page.contains("| - | stanley |"), "{page}");
}

#[test]
fn the_compensation_makes_the_laws_of_the_literature_better() {
    use ControllerName::{PurePursuit, PurePursuitCompensated, Stanley, StanleyCompensated};
    let mut plan = plan(
        &[
            PurePursuit,
            PurePursuitCompensated,
            Stanley,
            StanleyCompensated,
        ],
        &[Condition::Nominal],
    );
    plan.paths = vec![PathName::WideEight];
    plan.speeds_m_s = vec![1.5];
    let table = csv(&lines(&plan, &run(&plan, &CampaignArgs::default()).results));
    let rows = rows(&table);
    let along = |name: &str| rows[&format!("{name} nominal")][6].parse::<f64>().unwrap();
    for name in ["pure-pursuit", "stanley"] {
        assert!(
            along(&format!("{name}-compensated")) < along(name),
            "{table}"
        );
    }
}

#[test]
fn a_plan_with_the_compensation_goes_on_from_what_the_motor_has_yet_to_do() {
    let mut plan = plan(&[ControllerName::MpcCompensated], &[Condition::Nominal]);
    plan.paths = vec![PathName::Stop, PathName::WideEight];
    plan.speeds_m_s = vec![1.9];
    let table = csv(&lines(&plan, &run(&plan, &CampaignArgs::default()).results));
    let of_point: Vec<_> = table
        .lines()
        .filter(|it| it.contains(",nominal,"))
        .collect();
    assert_eq!(of_point.len(), 2, "{table}");
    for line in of_point {
        let rms: f64 = line.split(',').nth(5).unwrap().parse().unwrap();
        // A plan that goes on from what it last wanted alone has 340 mm at the stop.
        assert!(rms < 0.03, "{table}");
    }
}

#[test]
fn the_worst_condition_has_a_row_that_names_it() {
    let conditions = [
        Condition::Nominal,
        Condition::SoftTyres,
        Condition::AxleLess,
    ];
    let plan = plan(&[ControllerName::PFf], &conditions);
    let table = csv(&lines(&plan, &run(&plan, &CampaignArgs::default()).results));
    let rows = rows(&table);
    let worst = &rows["p-ff worst-axle"];
    assert_eq!(worst[WORST], "axle-50mm", "{table}");
    assert_eq!(worst[..12], rows["p-ff axle-50mm"][..12], "{table}");
    assert!(rows.contains_key("p-ff worst-tyres@front-axle"), "{table}");
}

#[test]
fn laws_without_lag_and_noise_follow_exactly_on_the_ideal_plant() {
    use ControllerName::{Appendix, MpcSingleTrack, PFf, PTuned};
    let plan = plan(
        &[Appendix, PFf, PTuned, MpcSingleTrack],
        &[Condition::Nominal, Condition::IdealPlant],
    );
    let table = csv(&lines(&plan, &run(&plan, &CampaignArgs::default()).results));
    let rows = rows(&table);
    for name in ["appendix", "p-ff", "p-tuned", "mpc-single-track"] {
        let rms: f64 = rows[&format!("{name} ideal-plant")][1].parse().unwrap();
        assert!(rms < 2e-4, "{name} {rms}");
        // The seed makes no difference.
        assert_eq!(rows[&format!("{name} ideal-plant")][0], "1");
    }
}

#[test]
fn a_delay_diverges_and_is_in_a_table_of_its_own() {
    let mut plan = plan(
        &[ControllerName::PFf, ControllerName::PTuned],
        &[Condition::AddedDelay],
    );
    plan.seeds = 1;
    let results = run(&plan, &CampaignArgs::default()).results;
    assert_eq!(csv(&lines(&plan, &results)), format!("{HEADER}\n"));
    let lines = delays(&plan, &results);
    let table = delays_csv(&lines);
    let (header, rows) = table.split_once('\n').unwrap();
    assert_eq!(header, DELAYS_HEADER);
    let delay = |name: &str| {
        let row = rows.lines().find(|row| row.starts_with(name)).unwrap();
        row.split(',').nth(4).unwrap().parse::<f64>().unwrap()
    };
    // A higher gain stands less.
    assert!(delay("p-tuned") > 20.0, "{table}");
    assert!(delay("p-tuned") < delay("p-ff"), "{table}");
    // It is the loop that fails, not the standing start of a car that answers late.
    assert!(!table.contains("motor-sensor"), "{table}");
    assert!(table.lines().skip(1).all(|row| !row.ends_with(',')));
    assert!(delays_markdown(&lines).contains("| p-ff | p-tuned |"));
}

#[test]
fn a_car_that_still_turns_round_when_the_counting_begins_has_not_followed() {
    let mut plan = plan(
        &[ControllerName::PTuned, ControllerName::PFf],
        &[Condition::AxleMost],
    );
    plan.seeds = 1;
    let table = csv(&lines(&plan, &run(&plan, &CampaignArgs::default()).results));
    let rows = rows(&table);
    // P is believed to be 0.12 m ahead of where the reference begins: a high gain turns round.
    let turning = &rows["p-tuned axle+lr"];
    assert_eq!(turning[STOPS], "1", "{table}");
    assert_eq!(turning.last().unwrap(), "turning-round 1", "{table}");
    assert_eq!(rows["p-ff axle+lr"][STOPS], "0", "{table}");
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn a_plan_of_the_single_track_model_sees_corners_that_stanley_does_not() {
        use ControllerName::{MpcSingleTrack, StanleyCompensated};
        let mut plan = plan(&[MpcSingleTrack, StanleyCompensated], &[Condition::Nominal]);
        plan.paths = vec![PathName::Corners];
        plan.seeds = 1;
        let results = run(&plan, &CampaignArgs::default()).results;
        let rows = rows(&csv(&lines(&plan, &results)));
        let value = |name: &str, column: usize| {
            let row = &rows[&format!("{name} nominal@front-axle")];
            row[column].parse::<f64>().unwrap()
        };
        // A front axle that turns on a circle of the least radius of the wheels is this far beside a
        // corner of 30 degrees: R (1/cos 15° - 1), with R = L/sin(0.45).
        let radius = 0.26 / 0.45_f64.sin();
        let least = radius * (1.0 / 15_f64.to_radians().cos() - 1.0);
        assert!(value("mpc-single-track", 5) < 2.0 * least, "{rows:?}");
        assert!(3.0 * value("mpc-single-track", 1) < value("stanley-compensated", 1));
        // The wheels turn at most as fast as the limit of the commands, 5 rad/s.
        assert!(value("mpc-single-track", 11) < 5.0, "{rows:?}");
    }

    #[test]
    fn a_wrong_belief_costs_and_the_test_paths_are_driven() {
        let mut plan = plan(
            &[ControllerName::PCompensated],
            &[
                Condition::Nominal,
                Condition::WeakSteering,
                Condition::WrongTrim,
                Condition::LateStamps,
            ],
        );
        plan.paths = vec![
            PathName::Ellipse,
            PathName::DoubleLaneChange,
            PathName::Corners,
            PathName::WideEight,
            PathName::Stop,
        ];
        let table = csv(&lines(&plan, &run(&plan, &CampaignArgs::default()).results));
        for path in &plan.paths {
            let rms = |condition: &str| {
                let start = format!("p-compensated,{path},1,{condition},2,");
                let line = table.lines().find(|line| line.starts_with(&start)).unwrap();
                let rms = line.split(',').nth(5).unwrap();
                rms.parse::<f64>().unwrap_or_else(|_| panic!("{line}"))
            };
            let most = if *path == PathName::Corners {
                0.05
            } else {
                0.01
            };
            assert!(rms("nominal") < most, "{path}: {table}");
            assert!(rms("trim-3deg") > 1.5 * rms("nominal"), "{path}: {table}");
        }
    }

    #[test]
    fn shards_of_a_search_are_the_search_of_one_process_with_its_own_number_of_seeds() {
        let mut plan = plan(
            &[ControllerName::PTuned, ControllerName::Appendix],
            &[
                Condition::IdealPlant,
                Condition::AddedDelay,
                Condition::Nominal,
            ],
        );
        plan.seeds = 3;
        let whole = run(&plan, &CampaignArgs::default());
        let merged = merged(&plan, 4);
        assert_eq!(merged.experiment, plan);
        assert_eq!(merged.results, whole.results);
        let tables = |campaign: &Campaign<Comparison>| {
            let delays = delays(&campaign.experiment, &campaign.results);
            let lines = lines(&campaign.experiment, &campaign.results);
            let page = markdown(&lines) + &delays_markdown(&delays);
            (csv(&lines), page, delays_csv(&delays))
        };
        assert_eq!(tables(&merged), tables(&whole));
        let (table, _, delays) = tables(&whole);
        assert_eq!(rows(&table)["p-tuned nominal"][0], "3");
        assert_eq!(rows(&table)["appendix ideal-plant"][0], "1");
        let row = delays.lines().nth(1).unwrap();
        assert!(row.starts_with("p-tuned,lane-change,1,2,"), "{delays}");
    }

    #[test]
    fn a_row_does_not_depend_on_the_others_or_on_the_shard() {
        use ControllerName::{PFf, Stanley};
        let conditions = [Condition::Nominal, Condition::SoftTyres, Condition::Loss200];
        let both = plan(&[PFf, Stanley], &conditions);
        let table = csv(&lines(&both, &run(&both, &CampaignArgs::default()).results));
        let alone = plan(&[Stanley], &conditions);
        let single = csv(&lines(
            &alone,
            &run(&alone, &CampaignArgs::default()).results,
        ));
        let table_rows = rows(&table);
        for (row, values) in rows(&single) {
            assert_eq!(table_rows[&row], values, "{row}");
        }
        // What is true of the car, and what the cameras see, makes a difference.
        for other in ["tyres-50%", "loss-200ms"] {
            assert_ne!(
                table_rows["stanley nominal"],
                table_rows[&format!("stanley {other}")]
            );
        }

        let merged = merged(&both, 5);
        assert_eq!(merged.experiment, both);
        assert_eq!(csv(&lines(&merged.experiment, &merged.results)), table);
    }
}
