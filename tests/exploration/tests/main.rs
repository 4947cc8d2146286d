//! The exploration: what it claims, and that it finds mistakes.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_core::Config;
use singletrack_exploration::{
    Action, Counterexample, Explored, Explorer, Limits, Planted, Setting, Stopped, Theme,
};
use singletrack_faults::schedule::Schedule;
use singletrack_pilot::Mode;
use singletrack_protocol::BoardMode;

fn setting(planted: Option<Planted>) -> Setting {
    let text = include_str!("../../../host/daemon/singletrackd.example.toml");
    let mut setting = Setting::of(&Config::from_toml(text).unwrap()).unwrap();
    setting.planted = planted;
    setting
}

fn explore(setting: &Setting, theme: Theme, states: usize) -> Result<Explored, Stopped> {
    let limits = Limits {
        theme,
        burst: 1,
        states,
    };
    Explorer::new(setting, limits).run(|_, _| {})
}

fn found(planted: Planted, theme: Theme) -> Counterexample {
    match explore(&setting(Some(planted)), theme, 12_000) {
        Err(Stopped::Violated(found)) => *found,
        other => panic!("{planted:?} was not found: {other:?}"),
    }
}

#[test]
fn no_claim_is_violated_by_whatever_happens_first() {
    for theme in Theme::ALL {
        let explored = explore(&setting(None), theme, 1_500).unwrap();
        assert!(explored.complete_depth >= 3, "{theme:?}: {explored}");
        assert!(explored.merges > 500, "{theme:?}: {explored}");
        assert!(explored.compared > 0, "{theme:?}: {explored}");
    }
}

#[test]
fn a_drive_is_among_what_happens() {
    let explored = explore(&setting(None), Theme::Frames, 6_000).unwrap();
    for modes in [
        (Mode::Driving, BoardMode::Driving),
        (Mode::Fault, BoardMode::EmergencyStopped),
        (Mode::Disconnected, BoardMode::Failsafe),
    ] {
        assert!(explored.modes.contains(&modes), "{modes:?}");
    }
}

#[test]
fn planted_mistakes_are_found_and_named() {
    for (planted, theme, claims) in [
        (Planted::StopIgnored, Theme::Frames, &["stop"][..]),
        (Planted::CommandRenewed, Theme::Wires, &["command-age"]),
        (Planted::DisarmArms, Theme::Frames, &["unasked"]),
        (
            Planted::DisarmLost,
            Theme::Frames,
            &["stop", "drives-again"],
        ),
    ] {
        let found = found(planted, theme);
        let claim = found.violation.claim;
        assert!(claims.contains(&claim), "{planted:?}: {found}");
    }
}

#[test]
fn a_mistake_comes_with_the_shortest_way_to_it_as_a_schedule_of_the_campaign() {
    let found = found(Planted::StopIgnored, Theme::Frames);
    let actions: Vec<Action> = found
        .trace
        .actions()
        .iter()
        .map(|(_, action)| *action)
        .collect();
    assert!(actions.len() <= 8, "{actions:?}");
    let schedule: Schedule = found.trace.schedule().parse().unwrap();
    let asked = actions
        .iter()
        .filter(|action| format!("{action:?}").contains("Request"));
    assert_eq!(schedule.requests.len(), asked.count());
}
