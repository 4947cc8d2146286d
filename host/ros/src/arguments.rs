//! The command line.

use std::{net::IpAddr, path::PathBuf, time::Duration};

use clap::Parser;

use crate::frames::Frames;

/// The largest domain whose ports are below 65,536.
const LAST_DOMAIN: i64 = 232;

/// The car as a node of ROS 2, over the daemon's control socket
///
/// There is no authentication: every program that reaches the node can drive the car. By default only
/// this computer can.
#[derive(Clone, Debug, Parser)]
#[command(version)]
pub(crate) struct Arguments {
    /// The daemon's control socket
    #[arg(
        long,
        value_name = "PATH",
        env = "SINGLETRACK_SOCKET",
        hide_env_values = true,
        default_value = "/run/singletrackd/control.sock"
    )]
    pub(crate) socket: PathBuf,
    /// Namespace of the node, its topics and its services, such as /car7
    #[arg(long, value_name = "NAME", default_value = "/")]
    pub(crate) namespace: String,
    /// The domain of ROS [default: that of the environment (`ROS_DOMAIN_ID`), or 0]
    #[arg(long, value_name = "NUMBER",
          value_parser = clap::value_parser!(u16).range(0..=LAST_DOMAIN))]
    domain: Option<u16>,
    /// Address of a network interface of this computer that other computers may use; may be
    /// repeated
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) interface: Vec<IpAddr>,
    /// The largest age of a set-point by its stamp, in ms
    #[arg(long, value_name = "MS", default_value_t = 100,
          value_parser = clap::value_parser!(u64).range(1..=1_000))]
    pub(crate) max_age_ms: u64,
    #[command(flatten)]
    pub(crate) frames: Frames,
    /// Publish only: take no set-points and offer no services
    #[arg(long)]
    pub(crate) publish_only: bool,
}

impl Arguments {
    /// The domain, with `environment` as the value of `ROS_DOMAIN_ID`.
    pub(crate) fn domain(&self, environment: Option<&str>) -> Result<u16, String> {
        let text = match (self.domain, environment) {
            (Some(domain), _) => return Ok(domain),
            (None, None | Some("")) => return Ok(0),
            (None, Some(text)) => text,
        };
        let domain = text
            .parse()
            .ok()
            .filter(|&it: &u16| i64::from(it) <= LAST_DOMAIN);
        domain
            .ok_or_else(|| format!("ROS_DOMAIN_ID is {text:?}: give a number up to {LAST_DOMAIN}"))
    }

    pub(crate) const fn max_age(&self) -> Duration {
        Duration::from_millis(self.max_age_ms)
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_command_line_is_sound() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn without_options_only_this_computer_is_served() {
        let arguments = Arguments::parse_from(["singletrack-ros"]);
        assert!(arguments.interface.is_empty());
        assert_eq!(arguments.max_age(), Duration::from_millis(100));
    }

    #[test]
    fn the_domain_is_that_of_the_environment_unless_it_is_given() {
        let domain = |line: &[&str], environment| {
            let name = ["singletrack-ros"].iter().chain(line);
            Arguments::parse_from(name).domain(environment)
        };
        assert_eq!(domain(&[], None), Ok(0));
        assert_eq!(domain(&[], Some("7")), Ok(7));
        assert_eq!(domain(&["--domain", "8"], Some("7")), Ok(8));
        assert!(domain(&[], Some("233")).is_err());
        assert!(domain(&[], Some("seven")).is_err());
    }
}
