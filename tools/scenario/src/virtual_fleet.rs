//! Several cars in one world, each with a host and a board of its own, in virtual time.

use singletrack_core::config::Config;
use singletrack_pilot::{Arming, Mode, PilotRequest};
pub use singletrack_sim::Sight;
use singletrack_sim::{DecoyBody, Floor, SimulationConfig, StartPose};

use crate::{
    simulated::follow,
    virtual_drive::{READY_TIMEOUT, VirtualDrive, VirtualDriveError, VirtualTick},
};

/// The cars' places are exchanged as often, in µs. Between, each moves on as it did.
const EXCHANGE_US: u64 = 1_000;
/// The height of the markers of another car, in m.
const HEIGHT_M: f64 = 0.12;

/// A car of the fleet.
#[derive(Clone, Debug)]
pub struct FleetCar {
    /// The configuration of its daemon; its rigid body names the car.
    pub config: Config,
    /// Where it stands at first.
    pub start: StartPose,
    /// Seed of its noise.
    pub seed: u64,
}

/// The cars.
#[derive(Debug)]
pub struct VirtualFleet {
    /// The cars.
    pub cars: Vec<VirtualDrive>,
    floor: Floor,
    /// The present time of the simulation, in µs.
    pub now_us: u64,
}

impl VirtualFleet {
    /// Powers all cars on. Each sees the others as rigid bodies by their names.
    ///
    /// # Errors
    ///
    /// One of the parts refuses its configuration.
    pub fn new(cars: &[FleetCar]) -> Result<Self, VirtualDriveError> {
        let drive = |(index, car): (usize, &FleetCar)| {
            VirtualDrive::new(car.config.clone(), car.seed, fleet_simulation(cars, index))
        };
        let drives = cars.iter().enumerate().map(drive);
        Ok(Self {
            cars: drives.collect::<Result<_, _>>()?,
            floor: fleet_floor(cars),
            now_us: 0,
        })
    }

    /// Waits until all cars can drive, arms them at once, and goes on until all drive.
    ///
    /// # Errors
    ///
    /// One of them does not drive within 15 s.
    pub fn start(&mut self) -> Result<(), VirtualDriveError> {
        for wanted in [Mode::Ready, Mode::Driving] {
            while let Some(waits) = self.cars.iter().find(|car| car.mode() != wanted) {
                if self.now_us >= (READY_TIMEOUT * 1e6) as u64 {
                    return Err(waits.not_started());
                }
                self.advance_to(self.now_us + 10_000, &mut |_, _| {});
            }
            if wanted == Mode::Ready {
                for car in &self.cars {
                    // The ring is empty: every tick takes all requests.
                    let _ = car.request(PilotRequest::Arm(Arming::Unattended));
                }
            }
        }
        Ok(())
    }

    /// What the cameras of all others see of a car.
    pub fn show(&mut self, index: usize, seen: Sight) {
        self.floor.show(index, seen);
    }

    /// The least distance between two bodies so far, in m; negative if they have overlapped.
    pub const fn nearest_m(&self) -> f64 {
        self.floor.nearest_m
    }

    /// Advances all cars to `until_us` of the simulation. `on_tick` is given every tick with the
    /// car's index.
    pub fn advance_to(&mut self, until_us: u64, on_tick: &mut impl FnMut(usize, &VirtualTick)) {
        while self.now_us < until_us {
            self.exchange();
            self.now_us = (self.now_us + EXCHANGE_US).min(until_us);
            for (index, car) in self.cars.iter_mut().enumerate() {
                while !car.advance_to(self.now_us) {
                    on_tick(index, &car.step());
                }
            }
        }
    }

    /// Tells every car's cameras where the others are, and stops those that drive into another.
    fn exchange(&mut self) {
        for (index, car) in self.cars.iter_mut().enumerate() {
            if self.floor.place(index, 0, car.world.truth()) {
                car.world.car.collide();
            }
        }
        for (index, car) in self.cars.iter_mut().enumerate() {
            let decoys = self.floor.decoys(index, 0);
            car.world.cameras.move_decoys(decoys);
        }
    }
}

/// The floor of these cars.
pub fn fleet_floor(cars: &[FleetCar]) -> Floor {
    Floor::new(cars.iter().map(|car| {
        let vehicle = &car.config.vehicle;
        [vehicle.body_length_m(), vehicle.body_width_m()].map(|size| 0.5 * size)
    }))
}

/// The world of a car: the others are rigid bodies by their names, and every world's cameras
/// give each the same number.
pub fn fleet_simulation(cars: &[FleetCar], index: usize) -> SimulationConfig {
    let mut simulation = SimulationConfig::default();
    let bodies = (1..).zip(cars).map(|(id, car)| DecoyBody {
        name: car.config.motion_capture.rigid_body.clone(),
        id,
        position_m: [car.start.x_m, car.start.y_m, HEIGHT_M],
    });
    simulation.cameras.decoys = bodies.collect();
    if let Some(car) = cars.get(index) {
        follow(&car.config, &mut simulation);
        simulation.cameras.car.id = simulation.cameras.decoys.remove(index).id;
        simulation.seed = car.seed;
        simulation.car.start = car.start;
    }
    simulation
}
