//! Which keys of the configuration are only read when the daemon starts.

use toml::{Table, Value};

use crate::config::Config;

/// Sections that threads, devices and files were opened with.
const SECTIONS: [&str; 5] = ["serial", "motion_capture", "record", "socket", "live"];

/// Of `[control]`, what the control thread does not take over while it runs.
const CONTROL: &str = "control";
const CONTROL_TAKEN_OVER: [&str; 1] = ["stop_deceleration_m_s2"];

/// The keys in which `new` differs from `old` and which take a restart.
///
/// # Errors
///
/// A path that is not UTF-8, which no file can have named.
pub fn restart_keys(old: &Config, new: &Config) -> Result<Vec<String>, toml::ser::Error> {
    let (old, new) = (Table::try_from(old)?, Table::try_from(new)?);
    let mut keys = Vec::new();
    for section in SECTIONS.into_iter().chain([CONTROL]) {
        differing(section, old.get(section), new.get(section), &mut keys);
    }
    keys.retain(|key| {
        CONTROL_TAKEN_OVER
            .iter()
            .all(|name| *key != format!("{CONTROL}.{name}"))
    });
    Ok(keys)
}

/// Adds the keys below `key` that differ.
fn differing(key: &str, old: Option<&Value>, new: Option<&Value>, keys: &mut Vec<String>) {
    match (old, new) {
        (Some(Value::Table(old)), Some(Value::Table(new))) => {
            let added = new.keys().filter(|name| !old.contains_key(*name));
            for name in old.keys().chain(added) {
                let key = format!("{key}.{name}");
                differing(&key, old.get(name), new.get(name), keys);
            }
        }
        (old, new) if old == new => {}
        _ => keys.push(key.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_takes_a_restart_is_named_and_nothing_else_is() {
        let old =
            Config::from_toml(include_str!("../../daemon/singletrackd.example.toml")).unwrap();
        assert_eq!(restart_keys(&old, &old).unwrap(), [""; 0]);

        let mut new = old.clone();
        new.limits.max_speed_m_s = 1.0;
        new.control.stop_deceleration_m_s2 = 2.5;
        new.supervisor.hold_ms = 200;
        assert_eq!(restart_keys(&old, &new).unwrap(), [""; 0]);

        new.serial.port = "/dev/ttyACM1".into();
        new.motion_capture.pose.max_speed_m_s = 6.0;
        new.control.period_ms = 20;
        new.socket.enabled = false;
        assert_eq!(
            restart_keys(&old, &new).unwrap(),
            [
                "serial.port",
                "motion_capture.pose.max_speed_m_s",
                "socket.enabled",
                "control.period_ms"
            ]
        );
    }
}
