//! What the threads share: the options, the car by the configuration in force with its description (URDF),
//! what is passed on and what is not, and the drive that is held.

use core::f64::consts::FRAC_PI_2;
use std::{
    collections::{BTreeMap, BTreeSet},
    net::IpAddr,
    path::PathBuf,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

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
    max_age_ms: u64,
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

/// Distances of the axles from the centre of mass, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Car {
    front: f64,
    rear: f64,
}

impl Car {
    /// The car of a configuration with every key; none if the axles are not in it.
    pub(crate) fn of(configuration: &str) -> Option<Self> {
        let configuration: toml::Table = configuration.parse().ok()?;
        let axle = |key| configuration.get("vehicle")?.get(key)?.as_float();
        Some(Self {
            front: axle("front_axle_distance_m")?,
            rear: axle("rear_axle_distance_m")?,
        })
    }

    /// Distance between the axles, in m.
    pub(crate) fn wheelbase(self) -> f64 {
        self.front + self.rear
    }

    /// The URDF: one link, so that viewers need no transform but that of the car. Body and wheels are
    /// those of a usual 1:10 car at this wheelbase.
    pub(crate) fn urdf(self, base: &str) -> String {
        let scale = self.wheelbase() / 0.26;
        let [length, width, radius, tyre] = [0.4, 0.19, 0.033, 0.026].map(|size| size * scale);
        let visual = |[x, y, z]: [f64; 3], turned: f64, shape: String, colour: &str| {
            format!(
                "    <visual>\n      <origin xyz=\"{x:.4} {y:.4} {z:.4}\" rpy=\"{turned:.6} 0 0\"/>\n      \
                 <geometry><{shape}/></geometry>\n      <material name=\"{colour}\"/>\n    </visual>\n"
            )
        };
        let body = format!("box size=\"{length:.4} {width:.4} {:.4}\"", 2.0 * radius);
        let middle = [0.5 * (self.front - self.rear), 0.0, 2.0 * radius];
        let mut visuals = visual(middle, 0.0, body, "body");
        for x in [self.front, -self.rear] {
            for y in [0.5, -0.5].map(|side| side * (width - tyre)) {
                let wheel = format!("cylinder radius=\"{radius:.4}\" length=\"{tyre:.4}\"");
                visuals += &visual([x, y, radius], FRAC_PI_2, wheel, "tyre");
            }
        }
        format!(
            "<?xml version=\"1.0\"?>\n<robot name=\"singletrack\">\n  \
             <material name=\"body\"><color rgba=\"0.1 0.3 0.8 1\"/></material>\n  \
             <material name=\"tyre\"><color rgba=\"0.1 0.1 0.1 1\"/></material>\n  \
             <link name=\"{base}\">\n{visuals}  </link>\n</robot>\n"
        )
    }
}

/// A reason is logged once in this time.
const LOG_INTERVAL: Duration = Duration::from_secs(5);

/// The last set-point before an arm may be this old.
const ATTENDED: Duration = Duration::from_millis(500);

#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) arguments: Arguments,
    state: Mutex<State>,
}

/// What changes while the program runs.
#[derive(Debug, Default)]
pub(crate) struct State {
    /// The car, once the daemon has given its configuration.
    pub(crate) car: Option<Car>,
    pub(crate) counts: Counts,
    logged: BTreeMap<String, Instant>,
    /// What is warned of a single time.
    warned: BTreeSet<&'static str>,
    /// When a set-point was passed on, and when the daemon rejected one.
    pub(crate) passed: Option<Instant>,
    pub(crate) rejected: Option<Instant>,
    /// A drive of this process is being armed, or driven.
    pub(crate) is_held: bool,
}

/// The counts since the start.
#[derive(Clone, Debug, Default)]
pub(crate) struct Counts {
    /// Set-points that were passed on to the daemon.
    pub(crate) passed: u64,
    /// Set-points that this program refused, by code.
    pub(crate) refused: BTreeMap<&'static str, u64>,
    /// Set-points that the daemon rejected, by code.
    pub(crate) rejected: BTreeMap<&'static str, u64>,
    /// Set-points that did not reach the daemon.
    pub(crate) lost: u64,
    /// Entries of the record that this program was too slow for.
    pub(crate) missed: u64,
    /// Messages that were not published, because a reliable subscriber is too slow.
    pub(crate) held_up: u64,
}

impl Shared {
    pub(crate) fn new(arguments: Arguments) -> Self {
        let state = Mutex::default();
        Self { arguments, state }
    }

    pub(crate) fn state(&self) -> MutexGuard<'_, State> {
        // The state holds no invariant that a panic could break.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Warns of a reason, unless that was done a short while ago.
    pub(crate) fn warn(&self, reason: &str, text: &str) {
        if self.state().may_log(reason, Instant::now()) {
            tracing::warn!("{text}");
        }
    }

    /// Warns of each text the first time.
    pub(crate) fn warn_once(&self, texts: [Option<&'static str>; 2]) {
        for text in texts.into_iter().flatten() {
            if self.state().warned.insert(text) {
                tracing::warn!("{text}");
            }
        }
    }
}

impl State {
    /// Whether `reason` has not been logged for a while; it counts as logged now.
    fn may_log(&mut self, reason: &str, now: Instant) -> bool {
        let logged = self.logged.get(reason);
        let may = logged.is_none_or(|logged| now.duration_since(*logged) >= LOG_INTERVAL);
        if may {
            self.logged.insert(reason.to_owned(), now);
        }
        may
    }

    /// Why no drive may be armed now.
    pub(crate) fn refusal(&self, now: Instant) -> Option<&'static str> {
        let recent =
            |time: Option<Instant>| time.is_some_and(|time| now.duration_since(time) <= ATTENDED);
        if self.is_held {
            return Some("a drive of this node is under way");
        }
        if !recent(self.passed) {
            return Some(
                "no set-points come: send them to drive, cmd_vel, point_velocity or path first, then \
                 arm",
            );
        }
        if recent(self.rejected) {
            return Some(
                "the daemon rejects the set-points (see /diagnostics); is reference.kind \
                 \"external\"?",
            );
        }
        None
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
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

    #[test]
    fn the_description_has_the_axles_of_the_configuration() {
        let text = "[vehicle]\nfront_axle_distance_m = 0.1368\nrear_axle_distance_m = 0.1232\n";
        let car = Car::of(text).unwrap();
        assert!((car.wheelbase() - 0.26).abs() < 1e-12);
        let urdf = car.urdf("car7/base_link");
        assert!(urdf.contains("<link name=\"car7/base_link\">"));
        assert_eq!(urdf.matches("xyz=\"0.1368 ").count(), 2, "{urdf}");
        assert_eq!(urdf.matches("xyz=\"-0.1232 ").count(), 2, "{urdf}");
        assert_eq!(Car::of("[vehicle]\n"), None);
        assert_eq!(Car::of("not toml"), None);
    }

    #[test]
    fn a_reason_is_logged_once_in_a_while() {
        let mut state = State::default();
        let now = Instant::now();
        assert!(state.may_log("old", now));
        assert!(!state.may_log("old", now + Duration::from_millis(4_999)));
        assert!(state.may_log("frame", now));
        assert!(state.may_log("old", now + LOG_INTERVAL));
    }

    #[test]
    fn a_drive_is_armed_only_while_set_points_come_and_are_taken() {
        let now = Instant::now() + Duration::from_secs(10);
        let ago = |ms| Some(now - Duration::from_millis(ms));
        let refusal = |passed, rejected, is_held| {
            let state = State {
                passed,
                rejected,
                is_held,
                ..State::default()
            };
            state.refusal(now).unwrap_or("none").to_owned()
        };
        assert_eq!(refusal(ago(10), None, false), "none");
        assert_eq!(refusal(ago(10), ago(501), false), "none");
        assert!(refusal(ago(10), ago(10), false).contains("rejects"));
        assert!(refusal(ago(501), None, false).contains("no set-points"));
        assert!(refusal(None, None, false).contains("no set-points"));
        assert!(refusal(ago(10), None, true).contains("under way"));
    }
}
