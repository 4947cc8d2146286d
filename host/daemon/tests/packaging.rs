//! The files of the package agree with the daemon.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

use singletrack_core::Config;

const UNIT: &str = include_str!("../../../packaging/singletrackd.service");
const PAGE: &str = include_str!("../../../packaging/singletrack-page.service");
const LIVE: &str = include_str!("../../../packaging/singletrack-live.service");
const XU4: &str = include_str!("../../../packaging/singletrackd.service.d/xu4.conf");
const RULES: &str = include_str!("../../../packaging/99-singletrack.rules");
const SYSUSERS: &str = include_str!("../../../packaging/sysusers.d/singletrack.conf");
const MODULES: &str = include_str!("../../../packaging/modules-load.d/singletrack.conf");
const EXAMPLE: &str = include_str!("../singletrackd.example.toml");

/// The lines without comments and blank lines.
fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
}

/// The values of a key, in order.
fn values<'a>(text: &'a str, key: &str) -> Vec<&'a str> {
    lines(text)
        .filter_map(|line| line.split_once('='))
        .filter(|(name, _)| *name == key)
        .map(|(_, value)| value)
        .collect()
}

/// The value of a key that occurs once.
fn value<'a>(text: &'a str, key: &str) -> &'a str {
    match values(text, key)[..] {
        [value] => value,
        ref values => panic!("{key}: {values:?}"),
    }
}

fn daemon(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrackd"))
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn the_daemon_accepts_the_options_of_the_unit() {
    let mut words = value(UNIT, "ExecStart").split_whitespace();
    assert_eq!(words.next(), Some("/usr/bin/singletrackd"));
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("singletrackd.example.toml");
    let arguments: Vec<&str> = words
        .map(|word| match word {
            "/etc/singletrackd/singletrackd.toml" => example.to_str().unwrap(),
            option => option,
        })
        .chain(["--check"])
        .collect();
    let output = daemon(&arguments);
    assert!(output.status.success(), "{output:?}");
}

#[test]
fn the_service_never_arms_the_car_by_itself() {
    assert!(!UNIT.contains("--arm") && !XU4.contains("Exec"));
}

#[test]
fn the_default_folders_of_the_configuration_are_those_of_the_unit() {
    let config = Config::from_toml(EXAMPLE).unwrap();
    let runtime = Path::new("/run").join(value(UNIT, "RuntimeDirectory"));
    assert_eq!(config.socket.path.parent(), Some(&*runtime));
    let logs = Path::new("/var/log").join(value(UNIT, "LogsDirectory"));
    assert_eq!(config.record.directory, logs);
    let state = Path::new("/var/lib").join(value(UNIT, "StateDirectory"));
    assert_eq!(config.state.directory, state);
    for key in ["socket.path", "record.directory", "state.directory"] {
        let (_, name) = key.split_once('.').unwrap();
        assert!(EXAMPLE.contains(&format!("#{name} = ")), "{key}");
    }
}

#[test]
fn an_invalid_configuration_does_not_restart_the_daemon() {
    let output = daemon(&["--config", "/nowhere/singletrackd.toml"]);
    let status = output.status.code().unwrap().to_string();
    assert_eq!(value(UNIT, "RestartPreventExitStatus"), status);
    assert_eq!(value(UNIT, "Restart"), "on-failure");
}

#[test]
fn the_unit_grants_what_the_control_thread_needs() {
    let config = Config::from_toml(EXAMPLE).unwrap();
    let granted: u8 = value(UNIT, "LimitRTPRIO").parse().unwrap();
    assert!(granted >= config.control.realtime_priority);
    assert_eq!(value(UNIT, "LimitMEMLOCK"), "infinity");
    let calls = values(UNIT, "SystemCallFilter").join(" ");
    for call in ["sched_setscheduler", "mlockall"] {
        assert!(calls.contains(call), "{call}");
    }
    // Kernels with real-time group scheduling refuse it to services.
    assert!(lines(UNIT).all(|line| !line.starts_with("CPUScheduling")));
    // The cores of the Odroid do not exist on other computers.
    assert!(values(UNIT, "CPUAffinity").is_empty());
    assert_eq!(value(XU4, "CPUAffinity"), "4-7");
}

#[test]
fn the_timeouts_of_the_unit_are_longer_than_the_daemons() {
    assert_eq!(value(UNIT, "Type"), "notify");
    let seconds = |key| -> f64 { value(UNIT, key).parse().unwrap() };
    assert!(seconds("WatchdogSec") >= 1.0);
    // The daemon waits four seconds for its control thread.
    assert!(seconds("TimeoutStopSec") > 4.0);
}

#[test]
fn the_driver_of_every_device_is_loaded_before_the_unit_starts() {
    let modules: Vec<&str> = lines(MODULES).collect();
    let devices = values(UNIT, "DeviceAllow");
    // The last device has no driver to load.
    assert_eq!(
        devices,
        [
            "char-ttyACM rw",
            "char-ttyUSB rw",
            "/dev/cpu_dma_latency rw"
        ]
    );
    assert_eq!(modules, ["cdc_acm", "usbserial"]);
}

#[test]
fn the_socket_has_a_group_of_its_own_which_sysusers_makes() {
    let group = value(UNIT, "Group");
    assert_eq!(group, "singletrack");
    let made: Vec<_> = lines(SYSUSERS)
        .filter_map(|line| line.strip_prefix("g "))
        .filter_map(|rest| rest.split_whitespace().next())
        .collect();
    assert_eq!(made, [group]);
    // The serial ports are another matter.
    assert_eq!(value(UNIT, "SupplementaryGroups"), "dialout");
    for page in [
        include_str!("../../../docs/odroid.md"),
        include_str!("../../../docs/troubleshooting.md"),
    ] {
        assert!(page.contains("the group `singletrack`"));
    }
}

#[test]
fn a_viewer_is_sandboxed_as_the_daemon_is_and_has_no_devices_and_no_priority() {
    // What the daemon needs for the car.
    let of_the_car = [
        "DeviceAllow",
        "RestrictRealtime",
        "SystemCallFilter",
        "ProtectSystem",
    ];
    for (viewer, name) in [(PAGE, "page"), (LIVE, "live")] {
        let (_, sandbox) = UNIT.split_once("LimitCORE=0").unwrap();
        let (sandbox, _) = sandbox.split_once("[Install]").unwrap();
        for line in lines(sandbox) {
            let (key, _) = line.split_once('=').unwrap();
            // The live view listens on loopback alone.
            let is_tighter = key == "IPAddressAllow" && name == "live";
            if is_tighter {
                assert_eq!(value(viewer, key), "localhost");
            } else if !of_the_car.contains(&key) {
                assert!(lines(viewer).any(|other| other == line), "{name}: {line}");
            }
        }
        assert_eq!(value(viewer, "PrivateDevices"), "yes");
        assert_eq!(value(viewer, "RestrictRealtime"), "yes");
        assert_eq!(value(viewer, "ProtectSystem"), "strict");
        assert_eq!(
            values(viewer, "SystemCallFilter"),
            ["@system-service", "~@privileged @resources"]
        );
        assert!(value(viewer, "Nice").parse::<i32>().unwrap() > 0);
        // Of the daemon it takes the group of the socket, and the configuration.
        assert_eq!(value(viewer, "Group"), value(UNIT, "Group"));
        assert_ne!(value(viewer, "User"), value(UNIT, "User"));
        assert!(values(viewer, "SupplementaryGroups").is_empty());
        let command = value(viewer, "ExecStart");
        assert!(command.starts_with(&format!("/usr/bin/singletrack {name} --config ")));
        let config = "/etc/singletrackd/singletrackd.toml";
        assert!(command.ends_with(config) && value(UNIT, "ExecStart").ends_with(config));
    }
    // The example's token is where the unit may write.
    let folder = format!("/run/{}/", value(PAGE, "RuntimeDirectory"));
    assert!(EXAMPLE.contains(&format!("# token_file = \"{folder}")));
}

/// A rule for any UNO would bind another car's board.
#[test]
fn the_boards_name_is_given_by_serial_number_or_port_only() {
    let named = RULES
        .lines()
        .map(|line| line.trim_start_matches('#'))
        .filter(|line| line.contains("SYMLINK+="));
    for rule in named {
        assert!(
            rule.contains("ATTRS{serial}==") || rule.contains("KERNELS=="),
            "{rule}"
        );
    }
}

/// On Debian and Ubuntu, brltty takes these chips for Braille displays.
#[test]
fn brltty_is_kept_away_from_the_chips_that_it_takes() {
    for chip in ["1a86", "0403", "10c4"] {
        let of_chip = |rule: &&str| rule.contains(&format!("ATTR{{idVendor}}==\"{chip}\""));
        let mut rules = lines(RULES).filter(of_chip);
        let keeps_away = |rule: &str| {
            rule.contains("BRLTTY_BRAILLE_DRIVER}=\"\"") && rule.contains("SYSTEMD_WANTS}=\"\"")
        };
        assert!(rules.any(keeps_away), "{chip}");
    }
}

#[test]
fn every_udev_rule_is_well_formed() {
    let mut links = 0;
    for rule in lines(RULES) {
        for part in rule.split(", ") {
            let (key, quoted) = part.split_once('"').unwrap();
            assert!(
                quoted.ends_with('"') && quoted.matches('"').count() == 1,
                "{part}"
            );
            let key = key.trim_end_matches(['=', '+']);
            let (name, attribute) = key.split_once('{').unwrap_or((key, "}"));
            assert!(
                [
                    "ACTION",
                    "GROUP",
                    "KERNEL",
                    "MODE",
                    "SUBSYSTEM",
                    "DRIVER",
                    "ATTR",
                    "ATTRS",
                    "ENV",
                    "SYMLINK"
                ]
                .contains(&name),
                "{part}"
            );
            assert!(attribute.ends_with('}'), "{part}");
        }
        links += usize::from(rule.ends_with("SYMLINK+=\"singletrack-board\""));
    }
    assert!(links > 0);
    for page in [
        include_str!("../../../packaging/README.md"),
        include_str!("../../../docs/odroid.md"),
    ] {
        assert!(page.contains("/dev/singletrack-board"));
    }
}

#[test]
fn every_file_to_install_exists() {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    // The list, and the page with the commands.
    for page in [
        include_str!("../../../packaging/README.md"),
        include_str!("../../../docs/odroid.md"),
    ] {
        let files: Vec<&str> = page
            .split_whitespace()
            .filter_map(|word| word.split('=').next_back())
            .filter(|word| word.starts_with("packaging/") || word.starts_with("host/"))
            .collect();
        assert!(files.len() >= 5, "{files:?}");
        for file in files {
            assert!(root.join(file).is_file(), "{file}");
        }
    }
}
