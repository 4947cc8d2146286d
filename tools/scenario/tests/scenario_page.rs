//! The reference of scenarios is generated from the declarations of their sections. With
//! `SINGLETRACK_RENEW=1` this test writes it.

use std::{fmt::Write as _, fs, path::Path};

use singletrack_scenario::simulate::{
    MarkerLoss, OperatorSection, PlantSection, RunSection, Scenario, StartSection, TuneSection,
};
use singletrack_settings::{Declared, Section};
use singletrack_sim::TRUTH_KEYS;

const HEADER: &str = "\
# Keys of a scenario

A scenario is one TOML file for [`singletrack simulate`](other-cars.md). The files in
`tools/scenarios` are to start from. A key's name ends with its unit; values are in SI units without
one. Unknown keys are refused, and so is a value outside its range, which stands in brackets.

Generated from the declarations in `tools/scenario` and `firmware-sim`; see
`tools/scenario/tests/scenario_page.rs`.

## Sections of the configuration

Their keys, ranges and defaults are those of the [configuration](configuration.md), unless said here.

- `[law]`, `[outer_loop]`, `[reference]`: mandatory. On the ideal plant `law.kind` may also be
  `\"velocity-point\"`, the law of the paper's appendix.
- `[control]`: `period_ms` is mandatory; on the ideal plant 0 is continuous control, and there are
  `delay_ticks` (0), from measurement to actuation, and `steering` (`\"ramp\"`; or `\"step\"`), how a
  steering rate acts over a period.
- `[vehicle]`: the car; the paper's if left out. `[believed_vehicle]`: that of the appendix's
  law; the true one if left out.

Only with `plant.kind = \"car\"`:

- `[governor]`, `[limits]`, `[fence]`, `[supervisor]`, `[estimator]`, `[watch]`, `[safety_filter]`,
  `[board]`, `[motion_capture]`, `[actuators]`, `[compensation]`, `[tuning]`,
  `[online_calibration]`: what the daemon believes. The default geofence is 20 m by 20 m, with `braking_m_s2 = 0.9`. With `[truth]` or
  `[simulation]`, the configuration is unproved, unless the scenario sets
  `supervisor.prove_first_metre`.
- `[simulation]`: the simulator's own sections `car`, `board`, `wire`, `cameras` and `natnet`
  (`firmware-sim/src/parameters`); `[truth]` overrides it.
- `[operator]`, `[[tune]]` and `[truth]`: below.
";

const TRUTH: &str = "
## `[truth]`

What is true of the simulated car, and differs from what the daemon believes. Every key is optional.
Without it, calibrated values (servo, ESC, pulse distance, IMU, kill relay, rigid body) are as
configured; the rest is the default simulated car. `singletrack-sim --config FILE.toml` takes this
table too; its times count from the start of the simulator.
";

fn section(section: &Section) -> String {
    let name = match section.name {
        list @ ("marker_loss" | "tune") => format!("[[{list}]]"),
        name => format!("[{name}]"),
    };
    let mut text = format!("\n## `{name}`\n\n{}\n\n", line(section.help));
    for key in section.keys {
        let default = match (key.default)() {
            Some(default) => format!(" (`{default}`)"),
            None if key.mandatory => " (mandatory)".to_owned(),
            None => String::new(),
        };
        writeln!(text, "- `{}`{default}: {}", key.name, line(key.help)).unwrap();
    }
    text
}

fn truth() -> String {
    let mut text = TRUTH.to_owned();
    let mut last = "";
    for key in TRUTH_KEYS {
        if key.section != last {
            last = key.section;
            write!(text, "\n### `[truth.{last}]`\n\n").unwrap();
        }
        let range: Vec<_> = key
            .range
            .split(' ')
            .map(|word| word.strip_suffix(".0").unwrap_or(word))
            .collect();
        let range = match key.range {
            "" => String::new(),
            _ => format!(" ({})", range.join(" ").replace(" to ", "…")),
        };
        writeln!(text, "- `{}`{range}: {}", key.name, line(key.help)).unwrap();
    }
    text
}

/// The help of a section or a key, on one line.
fn line(help: &str) -> String {
    help.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn the_reference_of_scenarios_is_that_of_the_declarations() {
    let sections = [
        PlantSection::SECTION,
        StartSection::SECTION,
        RunSection::SECTION,
        MarkerLoss::SECTION,
        OperatorSection::SECTION,
        TuneSection::SECTION,
    ];
    let page = HEADER.to_owned() + &sections.each_ref().map(section).concat() + &truth();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/scenarios.md");
    if std::env::var_os("SINGLETRACK_RENEW").is_some() {
        fs::write(&path, &page).unwrap();
    }
    assert!(
        fs::read_to_string(&path).unwrap_or_default() == page,
        "docs/scenarios.md is old: SINGLETRACK_RENEW=1 renews it"
    );
}

#[test]
fn the_reference_of_scenarios_names_every_section() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/scenarios.md");
    let page = fs::read_to_string(path).unwrap();
    let error = toml::from_str::<Scenario>("no_section = 1").unwrap_err();
    let sections: Vec<_> = error.message().split('`').skip(3).step_by(2).collect();
    assert!(sections.contains(&"law") && sections.contains(&"tuning"));
    for section in sections {
        assert!(page.contains(&format!("[{section}]")), "{section}");
    }
}
