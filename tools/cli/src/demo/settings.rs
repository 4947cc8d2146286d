//! The demo's folder and its files, its world, and the daemon's configuration.

use std::{
    fs::{File, TryLockError},
    io,
    net::Ipv4Addr,
    path::{Path, PathBuf},
};

use serde::Serialize;
use singletrack_core::config::{Config, OuterLoopSection, ReferenceSection, Start};
use singletrack_figures::{
    output::{WriteError, make_folder, write},
    plot::{ANIMATION, FigureKind, REPORT},
};
use singletrack_scenario::simulated::{self, daemon_config};
use singletrack_sim::{
    CarTruth, RealTimeConfig, RealTimeSimulator, SharedFloor, SimulationConfig, StartPose, Truth,
    UdpConfig,
};
use singletrackd::{Daemon, StartOptions};
use tempfile::TempDir;

use super::{Car, DemoArgs};
use crate::Result;

/// The paper's circle: radius in m, angular velocity in rad/s.
pub(super) const RADIUS: f64 = 1.0;
pub(super) const ANGULAR_VELOCITY: f64 = 0.5;
/// The paper's distance p, in m.
pub(super) const POINT_DISTANCE: f64 = 0.35;
/// Gain of the proportional loop, per second, in both axes.
const GAIN: f64 = 1.0;
/// Where P and the car start: position in m, yaw in degrees.
const START_POINT: [f64; 2] = [1.5, -0.5];
const START_YAW_DEG: f64 = 135.0;

impl Car {
    /// What is believed of a car that is not the paper's, and what is true of it.
    const fn files(self) -> Option<[&'static str; 2]> {
        match self {
            Self::Paper => None,
            Self::Dart => Some([
                include_str!("../../../real/dart.toml"),
                include_str!("../../../vehicles/dart-truth.toml"),
            ]),
            Self::Put => Some([
                include_str!("../../../real/put.toml"),
                include_str!("../../../vehicles/put-truth.toml"),
            ]),
        }
    }

    fn config(self) -> Result<Option<Config>> {
        let config = self.files().map(|[belief, _]| Config::from_toml(belief));
        Ok(config.transpose()?)
    }

    fn truth(self) -> Result<CarTruth> {
        let truth = self.files().map(|[_, truth]| toml::from_str(truth));
        Ok(truth.transpose()?.unwrap_or_default())
    }
}

/// Writes the simulated world into the folder, and returns it.
pub(super) fn write_simulation(args: &DemoArgs) -> Result<SimulationConfig> {
    let mut config = SimulationConfig {
        seed: args.seed,
        ..SimulationConfig::default()
    };
    args.car.truth()?.apply(&mut config)?;
    let yaw_rad = START_YAW_DEG.to_radians();
    let ahead = config.car.vehicle.front_axle_distance_m + POINT_DISTANCE;
    config.car.start = StartPose {
        x_m: START_POINT[0] - ahead * libm::cos(yaw_rad),
        y_m: START_POINT[1] - ahead * libm::sin(yaw_rad),
        yaw_rad,
    };
    config.cameras.loss = args.loss;
    config.board.kind = args.board;
    write(&args.out.join(SIMULATION), &toml::to_string(&config)?)?;
    Ok(config)
}

/// The simulator of a car in real time, whose serial port is in a private folder.
pub(super) fn simulator(
    simulation: SimulationConfig,
    floor: Option<SharedFloor>,
    private: &Path,
) -> Result<RealTimeSimulator> {
    Ok(RealTimeSimulator::start(RealTimeConfig {
        simulation,
        floor,
        pty_link: Some(private.join("board")),
        udp: UdpConfig {
            interface: Ipv4Addr::LOCALHOST,
            // Any free ones: two demos do not disturb each other.
            command_port: 0,
            data_port: 0,
        },
        ..RealTimeConfig::default()
    })?)
}

/// Starts the daemon of a simulated car, which keeps its sockets in a private folder; record and
/// configuration have the name of the car.
pub(super) fn start(
    args: &DemoArgs,
    name: &str,
    mut config: Config,
    seed: u64,
    simulator: &RealTimeSimulator,
    private: &Path,
) -> Result<Daemon> {
    config.serial.port = simulator.pty_path.to_owned();
    config.motion_capture.command_port = Some(simulator.command_address.port());
    config.motion_capture.data_port = simulator.data_address.port();
    config.state.directory = private.join("state");
    config.socket.path = socket(private);
    write_configuration(args, name, &config)?;
    let options = StartOptions {
        record: Some(record_of(args, name)),
        seed: Some(seed),
        ..StartOptions::default()
    };
    Ok(Daemon::start(config, options)?)
}

/// The control socket of the daemon with this private folder.
pub(super) fn socket(private: &Path) -> PathBuf {
    private.join("control.sock")
}

pub(super) fn daemon(args: &DemoArgs) -> Result<Config> {
    let car = args.car.config()?;
    let vehicle = car.as_ref().map(|car| car.vehicle);
    let mut drive = simulated::Drive::following(ReferenceSection::Circle {
        radius_m: RADIUS,
        angular_velocity_rad_s: ANGULAR_VELOCITY,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    });
    drive.vehicle = vehicle.unwrap_or(drive.vehicle);
    drive.law.point_distance_m = POINT_DISTANCE;
    drive.law.front_axle_distance_m = drive.vehicle.front_axle_distance_m;
    drive.outer_loop = OuterLoopSection::Proportional {
        gain_per_s: [GAIN, GAIN],
        feed_forward: args.feed_forward,
    };
    let mut config = daemon_config(drive);
    if let Some(car) = car {
        config.estimator = car.estimator;
        config.actuators = car.actuators;
        // The demo's servo reaches no farther.
        let most = &mut config.limits.max_steering_rad;
        *most = most.min(car.limits.max_steering_rad);
    }
    config.record.directory.clone_from(&args.out);
    Ok(config)
}

/// What theory expects of P once it has settled on the circle.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Expected {
    pub(super) amplitude_m: f64,
    pub(super) lag_rad: f64,
    /// Distance of P from its reference.
    pub(super) error_m: f64,
}

/// P is an integrator per axis in a proportional loop, driven along a circle: it follows as
/// a first-order low pass does, on a smaller circle and behind. With the reference's velocity
/// fed forward it follows exactly.
pub(super) fn expected(feed_forward: bool) -> Expected {
    if feed_forward {
        return Expected {
            amplitude_m: RADIUS,
            lag_rad: 0.0,
            error_m: 0.0,
        };
    }
    let corner = libm::hypot(GAIN, ANGULAR_VELOCITY);
    Expected {
        amplitude_m: RADIUS * GAIN / corner,
        lag_rad: libm::atan2(ANGULAR_VELOCITY, GAIN),
        error_m: RADIUS * ANGULAR_VELOCITY / corner,
    }
}

/// Where P should be `time` seconds after the first driving tick.
pub(super) fn reference(time: f64) -> [f64; 2] {
    let (sin, cos) = libm::sincos(ANGULAR_VELOCITY * time);
    [RADIUS * cos, RADIUS * sin]
}

/// The true P of a car with this distance from G to the front axle, in m.
pub(super) fn point(truth: &Truth, front_axle_distance_m: f64) -> [f64; 2] {
    truth.point_p(front_axle_distance_m, POINT_DISTANCE)
}

/// Distance of a true P from its reference, in m.
pub(super) fn tracking_error([x, y]: [f64; 2], time: f64) -> f64 {
    let [x_ref, y_ref] = reference(time);
    libm::hypot(x - x_ref, y - y_ref)
}

/// The files of a demo; those of its one car are named `DEMO`.
pub(super) const DEMO: &str = "demo";
pub(super) const RECORD: &str = "demo.mcap";
pub(super) const CONFIGURATION: &str = "demo.toml";
pub(super) const SIMULATION: &str = "simulation.toml";
pub(super) const SUMMARY: &str = "summary.json";
/// The most cars of a demo.
pub(super) const MAX_CARS: usize = 20;

/// The record of a car with this name.
pub(super) fn record_of(args: &DemoArgs, name: &str) -> PathBuf {
    args.out.join(format!("{name}.mcap"))
}

/// Writes the configuration of the daemon of a car with this name.
pub(super) fn write_configuration(args: &DemoArgs, name: &str, config: &Config) -> Result<()> {
    let path = args.out.join(format!("{name}.toml"));
    Ok(write(&path, &config.to_toml()?)?)
}

/// A folder.
pub(super) const FIGURES: &str = "figures";

/// Makes the folder of a demo its own until the result is dropped; removes what an earlier one left
/// there.
///
/// # Errors
///
/// It holds something else, or another demo writes to it.
pub(super) fn prepare(folder: &Path) -> Result<File> {
    make_folder(folder)?;
    let failed = || WriteError::of(folder);
    let own = File::open(folder).map_err(failed())?;
    match own.try_lock() {
        Err(TryLockError::WouldBlock) => {
            let folder = folder.display();
            return Err(
                format!("another demo writes to {folder}: give another folder with --out").into(),
            );
        }
        locked => locked.map_err(|error| failed()(error.into()))?,
    }
    let known = files();
    for entry in std::fs::read_dir(folder).map_err(failed())? {
        let name = entry.map_err(failed())?.file_name();
        if name != FIGURES && !known.iter().any(|file| file.as_os_str() == name) {
            return Err(format!(
                "{} holds {}, which no demo has written: give another folder with --out",
                folder.display(),
                name.display()
            )
            .into());
        }
    }
    clear(folder)?;
    Ok(own)
}

/// A folder for sockets and ports, which is removed when the result is dropped.
pub(super) fn private() -> Result<TempDir, String> {
    let folder = tempfile::Builder::new().prefix("singletrack-").tempdir();
    folder.map_err(|error| not_made(&error))
}

/// A temporary folder can't be made.
pub(super) fn not_made(error: &io::Error) -> String {
    format!("can't make a temporary folder: {error}")
}

/// Removes what a demo has written.
pub(super) fn clear(folder: &Path) -> Result<(), WriteError> {
    let figures = FigureKind::ALL.map(|kind| Path::new(FIGURES).join(kind.file_name()));
    for file in files().into_iter().chain(figures) {
        match std::fs::remove_file(folder.join(file)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(WriteError::of(folder)(error));
            }
            _ => {}
        }
    }
    Ok(())
}

/// The files of a demo, besides the figures.
fn files() -> Vec<PathBuf> {
    let cars = (1..=MAX_CARS).map(|number| format!("car{number}.mcap"));
    let records = cars.chain([RECORD.to_owned()]).map(PathBuf::from);
    let of_records = records.flat_map(|it| {
        [
            singletrack_record::part_path(&it),
            it.with_extension("toml"),
            it,
        ]
    });
    let others = [SIMULATION, SUMMARY, REPORT, ANIMATION].map(PathBuf::from);
    others.into_iter().chain(of_records).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_gain_without_feed_forward_leaves_447_mm_by_theory() {
        let expected = expected(false);
        assert!((expected.amplitude_m - 0.894_427).abs() < 1e-6);
        assert!((expected.lag_rad - 0.463_648).abs() < 1e-6);
        assert!((expected.error_m - 0.447_214).abs() < 1e-6);
    }
}
