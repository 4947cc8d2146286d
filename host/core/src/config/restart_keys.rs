//! The keys of the configuration that are only read when the daemon starts.

use toml::Value;

use crate::config::{Config, SECTIONS, Section};

/// The keys in which `new` differs from `old` and that require a restart: first those of
/// sections that require a restart as a whole.
///
/// # Errors
///
/// A path is not UTF-8. No configuration file can contain one.
pub fn restart_keys(old: &Config, new: &Config) -> Result<Vec<String>, toml::ser::Error> {
    let (old, new) = (Value::try_from(old)?, Value::try_from(new)?);
    let (whole, partly): (Vec<&Section>, Vec<_>) =
        SECTIONS.iter().partition(|section| section.restart);
    let mut keys = Vec::new();
    for section in whole.into_iter().chain(partly) {
        for key in section.keys {
            let path = format!("{}.{}", section.name, key.name);
            // A section within this one is in the list itself.
            let is_section = SECTIONS.iter().any(|section| section.name == path);
            let takes_restart = section.restart || key.restart;
            if takes_restart && !is_section && at(&old, &path) != at(&new, &path) {
                keys.push(path);
            }
        }
    }
    Ok(keys)
}

/// The value at a path such as `motion_capture.pose.max_speed_m_s`.
fn at<'a>(config: &'a Value, path: &str) -> Option<&'a Value> {
    path.split('.')
        .try_fold(config, |value, name| value.get(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_takes_a_restart_is_named_and_nothing_else_is() {
        let old =
            Config::from_toml(include_str!("../../../daemon/singletrackd.example.toml")).unwrap();
        assert_eq!(restart_keys(&old, &old).unwrap(), [""; 0]);

        let mut new = old.clone();
        new.limits.max_speed_m_s = 1.0;
        new.control.stop_deceleration_m_s2 = 2.5;
        new.supervisor.hold_ms = 200;
        new.motion_capture.marker_yaw_rad = 0.1;
        new.motion_capture.timing.stamp_offset_ms = 2.0;
        assert_eq!(restart_keys(&old, &new).unwrap(), [""; 0]);

        new.serial.port = "/dev/ttyACM1".into();
        new.motion_capture.pose.max_speed_m_s = 6.0;
        new.control.period_ms = 20;
        new.socket.enabled = false;
        assert_eq!(
            restart_keys(&old, &new).unwrap(),
            [
                "serial.port",
                "socket.enabled",
                "motion_capture.pose.max_speed_m_s",
                "control.period_ms"
            ]
        );
    }
}
