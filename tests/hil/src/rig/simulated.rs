//! Rig with simulated board, car and cameras.

use std::{
    net::SocketAddrV4,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use singletrack_protocol::{COMMAND_TIME_TO_LIVE_US, ResetCause, StopCause};
use singletrack_sim::{
    BoardKind, BusFault, Hang, LossKind, MotorSensorFault, RealTimeConfig, RealTimeSimulator,
    ServerKind, Truth,
};

use super::{Canary, LineFaults, Need, Rig, raise_priority, uinput_lacks};
use crate::{Failure, Outcome, Pulses, Trace, settings};

/// Rig with simulated board, car and cameras.
#[derive(Debug)]
pub struct SimulatedRig {
    simulator: RealTimeSimulator,
    canary: Canary,
    board: BoardKind,
}

impl SimulatedRig {
    /// Powers everything on, with the board's port at `link`; the board is that of car `car_id`.
    ///
    /// # Errors
    ///
    /// Fails if the simulator does not start.
    pub fn start(link: PathBuf, seed: u64, board: BoardKind, car_id: u16) -> Outcome<Self> {
        Self::with_cameras(link, seed, board, car_id, ServerKind::NatNet)
    }

    /// A rig with cameras whose server speaks this.
    ///
    /// # Errors
    ///
    /// Fails if the simulator does not start.
    pub fn with_cameras(
        link: PathBuf,
        seed: u64,
        board: BoardKind,
        car_id: u16,
        cameras: ServerKind,
    ) -> Outcome<Self> {
        let mut simulation = settings::simulation(seed);
        simulation.board.kind = board;
        simulation.board.car_id = car_id;
        let config = RealTimeConfig {
            simulation,
            pty_link: Some(link),
            cameras,
            ..RealTimeConfig::default()
        };
        Ok(Self {
            simulator: start(config)?,
            canary: Canary::start()?,
            board,
        })
    }
}

/// Reason why a simulated board lacks something, if it does.
pub(crate) fn lacks(board: BoardKind, need: Need) -> Option<&'static str> {
    match (board, need) {
        (BoardKind::Native, Need::Image) => {
            Some("only the image has a watchdog and a bus: --board uno")
        }
        (_, Need::Uinput) => uinput_lacks(),
        (BoardKind::Uno, Need::Newcomer | Need::Whole) => {
            Some("it has a simulator of its own, with the board's code")
        }
        (BoardKind::Uno, Need::AnotherCar) => Some("the image was built for a car"),
        _ => None,
    }
}

/// Starts the simulator on a thread with raised priority.
pub(super) fn start(config: RealTimeConfig) -> Outcome<RealTimeSimulator> {
    thread::spawn(move || {
        raise_priority();
        RealTimeSimulator::start(config)
    })
    .join()
    .map_err(|_| Failure::new("the simulator's start panicked"))?
    .map_err(Failure::from)
}

impl Rig for SimulatedRig {
    fn port(&self) -> &Path {
        &self.simulator.pty_path
    }

    fn cameras(&self) -> SocketAddrV4 {
        self.simulator.command_address
    }

    fn interrupt(&self) -> Outcome {
        Ok(self.simulator.interrupt()?)
    }

    fn unplug(&self) -> Outcome {
        Ok(self.simulator.unplug()?)
    }

    fn plug(&self) -> Outcome {
        self.simulator.plug()?;
        Ok(())
    }

    fn set_line(&self, line: LineFaults) -> Outcome {
        Ok(self.simulator.with_world(move |world| {
            let faults = &mut world.wire.faults;
            faults.corrupt = line.corrupt;
            faults.stuck = line.stuck;
        })?)
    }

    fn set_markers(&self, loss: Option<LossKind>) -> Outcome {
        Ok(self
            .simulator
            .with_world(move |world| world.cameras.faults.loss = loss)?)
    }

    fn truth(&self) -> Outcome<Truth> {
        Ok(self.simulator.truth()?.truth)
    }

    fn trace(&self) -> Outcome<Trace> {
        Ok(Trace(self.simulator.with_world(|world| {
            world
                .board
                .pulses
                .iter()
                .map(|record| Pulses {
                    board_time_us: record.board_time_us,
                    servo_us: record.servo_us,
                    esc_us: record.esc_us,
                    cut: record.cut,
                })
                .collect()
        })?))
    }

    fn board_time_us(&self) -> Outcome<Option<u32>> {
        Ok(self
            .simulator
            .with_world(|world| world.board.board_time_us(world.now_us))?)
    }

    fn stop_cause(&self) -> Outcome<Option<StopCause>> {
        Ok(self.simulator.with_world(|world| {
            let telemetry = world.board.telemetry();
            telemetry.map(|telemetry| telemetry.stop_cause)
        })?)
    }

    /// The time to live of a command starts at the telemetry behind it.
    fn last_command_us(&self) -> Outcome<u32> {
        let start = Instant::now();
        loop {
            let (now, last) = self.simulator.with_world(|world| {
                let board = &world.board;
                (board.board_time_us(world.now_us), board.last_command_us())
            })?;
            let (Some(now), Some(last)) = (now, last) else {
                return Err(Failure::new("the board has had no command"));
            };
            if now.wrapping_sub(last) > COMMAND_TIME_TO_LIVE_US {
                return Ok(last);
            }
            if start.elapsed() > Duration::from_secs(2) {
                return Err(Failure::new("commands still reach the board after 2 s"));
            }
            thread::sleep(Duration::from_millis(1));
        }
    }

    fn lateness(&self) -> Outcome<Duration> {
        let simulator = Duration::from_micros(self.simulator.counters()?.max_lateness_us);
        Ok(simulator.max(self.canary.lateness()))
    }

    fn lacks(&self, need: Need) -> Option<&'static str> {
        lacks(self.board, need)
    }

    fn hang(&self, hang: Hang) -> Outcome {
        Ok(self
            .simulator
            .with_world(move |world| world.board.hang(hang))?)
    }

    fn break_imu_bus(&self, fault: BusFault) -> Outcome {
        Ok(self
            .simulator
            .with_world(move |world| world.board.set_imu_bus(fault))?)
    }

    fn reset(&self, cause: ResetCause) -> Outcome {
        Ok(self
            .simulator
            .with_world(move |world| world.reset_board(cause))?)
    }

    fn cut_motor_sensor(&self) -> Outcome {
        Ok(self.simulator.with_world(|world| {
            world.car.sensor_fault = MotorSensorFault::Gone;
        })?)
    }

    fn open_stop_switch(&self) -> Outcome {
        Ok(self
            .simulator
            .with_world(|world| world.board.stop_input_open = true)?)
    }
}
