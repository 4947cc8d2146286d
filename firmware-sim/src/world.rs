//! Board, car, serial line and cameras, in virtual time.

use std::{collections::VecDeque, net::SocketAddr};

use singletrack_protocol::ResetCause;
use singletrack_simavr::{BusFault, Motion};

use crate::{
    board::SimulatedBoard,
    cameras::{CameraFrame, Cameras},
    car::{Car, Imu, ImuFault, Truth},
    clock::Epoch,
    natnet_server::{Datagram, NatNetServer},
    parameters::{ConfigError, SimulationConfig},
    pulses::{PulseFilter, Unfiltered, push_bounded},
    wire::SerialWire,
};

/// Board, car, serial line and cameras, in virtual time.
///
/// Only [`advance_to`](Self::advance_to) advances time. Inputs of the host
/// ([`host_write`](Self::host_write), [`handle_datagram`](Self::handle_datagram))
/// take effect at the time reached; [`host_read`](Self::host_read) and
/// [`poll_datagram`](Self::poll_datagram) fetch the world's outputs. The same seed
/// and the same inputs at the same times give the same bits, for any number of
/// calls of `advance_to` in between.
#[derive(Debug)]
pub struct World {
    /// The present time, in µs.
    pub now_us: u64,
    /// The car at the last event of the board or of a sensor.
    pub car: Car,
    imu: Imu,
    imu_samples: u64,
    /// The fault of the IMU.
    pub imu_fault: ImuFault,
    /// The last sample taken without a fault.
    imu_last: Option<Motion>,
    /// The supply of servo and IMU.
    imu_supply: ImuSupply,
    /// Samples in transit to the board with their arrival times.
    imu_pending: VecDeque<(u64, Motion)>,
    /// The board.
    pub board: SimulatedBoard,
    /// The USB cable is plugged in.
    plugged: bool,
    /// The board's power is switched on, whatever it comes from.
    switched_on: bool,
    /// The serial line.
    pub wire: SerialWire,
    /// The cameras.
    pub cameras: Cameras,
    /// The NatNet server.
    pub natnet: NatNetServer,
    datagrams: VecDeque<Datagram>,
    frames: VecDeque<CameraFrame>,
    /// The configuration.
    pub config: SimulationConfig,
}

/// The supply of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ImuSupply {
    Good,
    Failed,
    /// Good again; the sensor starts until then.
    Starting {
        until_us: u64,
    },
}

/// Number of camera frames and datagrams kept until the host fetches them.
const QUEUE_CAPACITY: usize = 1_024;

impl World {
    /// A world at simulation time zero, with the board just powered on.
    ///
    /// # Errors
    ///
    /// Fails if the configuration is invalid or the UNO is not available.
    pub fn new(config: SimulationConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        let seed = config.seed;
        let mut car = Car::new(config.car.clone());
        car.seed(seed);
        Ok(Self {
            now_us: 0,
            car,
            imu: Imu::new(config.car.imu, seed),
            imu_samples: 0,
            imu_fault: ImuFault::None,
            imu_last: None,
            imu_supply: ImuSupply::Good,
            imu_pending: VecDeque::new(),
            board: SimulatedBoard::new(config.board, seed)?,
            plugged: true,
            switched_on: true,
            wire: SerialWire::new(&config.wire, seed),
            cameras: Cameras::new(config.cameras.clone(), seed),
            natnet: NatNetServer::new(config.natnet),
            datagrams: VecDeque::new(),
            frames: VecDeque::new(),
            config,
        })
    }

    /// Advances to `until_us`, including the events at that time. An earlier time
    /// has no effect.
    pub fn advance_to(&mut self, until_us: u64) {
        self.advance_filtered(until_us, &mut Unfiltered);
    }

    /// Like [`advance_to`](Self::advance_to), with a filter of the pulses.
    pub fn advance_filtered(&mut self, until_us: u64, filter: &mut dyn PulseFilter) {
        loop {
            let next_us = self.next_event_us();
            if next_us > until_us {
                break;
            }
            self.now_us = next_us;
            self.events_at(next_us, filter);
        }
        self.now_us = self.now_us.max(until_us);
    }

    fn next_event_us(&self) -> u64 {
        let arrival = self.imu_pending.front().map(|(arrival, _)| *arrival);
        let pending = [arrival, self.cameras.next_send_us()];
        let (imu, board) = (self.next_imu_us(), self.board.next_event_us());
        let next = imu.min(self.cameras.next_exposure_us).min(board);
        pending.into_iter().flatten().fold(next, u64::min)
    }

    fn next_imu_us(&self) -> u64 {
        let p = &self.config.car.imu;
        p.phase_us + self.imu_samples * p.period_us.max(1)
    }

    /// Processes simultaneous events in this order.
    fn events_at(&mut self, now_us: u64, filter: &mut dyn PulseFilter) {
        let board_is_due = self.board.next_event_us() <= now_us;
        let imu_is_due = self.next_imu_us() <= now_us;
        let exposure_is_due = self.cameras.next_exposure_us <= now_us;
        if board_is_due || imu_is_due || exposure_is_due {
            self.car.advance_to(now_us);
        }
        self.supply_imu(now_us);
        if imu_is_due {
            self.imu_samples += 1;
            let reading = self.imu.sample(&self.car.truth());
            if self.imu_fault == ImuFault::None {
                self.imu_last = Some(reading);
            }
            let arrival = now_us + self.config.car.imu.latency_us;
            let (fault, number) = (self.imu_fault, self.imu_samples);
            let sample = fault.falsify(reading, self.imu_last, number);
            if self.imu_supply == ImuSupply::Good {
                let pending = sample.map(|reading| (arrival, reading));
                self.imu_pending.extend(pending);
            }
        }
        let is_here = |(arrival, _): &mut (u64, Motion)| *arrival <= now_us;
        while let Some((_, reading)) = self.imu_pending.pop_front_if(is_here) {
            self.board.take_imu(now_us, reading);
        }
        if exposure_is_due {
            self.cameras.expose(&self.car.truth());
        }
        while let Some(frame) = self.cameras.take_frame(now_us) {
            self.send_frame(frame);
        }
        if board_is_due {
            self.board
                .events_at(now_us, &mut self.car, &mut self.wire, filter);
        }
    }

    /// A dip of its supply, or a board without power, restarts the IMU; the board finds it
    /// absent, then without its settings.
    fn supply_imu(&mut self, now_us: u64) {
        let fails = self.car.supply_dips() || !self.board.has_power();
        let supply = match (self.imu_supply, fails) {
            (ImuSupply::Failed, true) => return,
            (_, true) => {
                self.imu_pending.clear();
                self.board.set_imu_bus(BusFault::Absent);
                ImuSupply::Failed
            }
            (ImuSupply::Failed, false) => {
                let restart_us = self.config.car.imu.restart_ms * 1e3;
                let until_us = now_us + restart_us as u64;
                ImuSupply::Starting { until_us }
            }
            (ImuSupply::Starting { until_us }, false) if now_us >= until_us => {
                self.imu.restart();
                // Its settings are lost, which this fault does once.
                self.board.set_imu_bus(BusFault::Restarted);
                self.board.set_imu_bus(BusFault::None);
                ImuSupply::Good
            }
            (unchanged, false) => unchanged,
        };
        self.imu_supply = supply;
    }

    fn send_frame(&mut self, frame: CameraFrame) {
        let forged = self.cameras.forge(&frame);
        for sent in core::iter::once(&frame).chain(&forged) {
            for datagram in self.natnet.frame(self.now_us, sent) {
                push_bounded(&mut self.datagrams, datagram, QUEUE_CAPACITY);
            }
        }
        if !frame.silent {
            push_bounded(&mut self.frames, frame, QUEUE_CAPACITY);
        }
    }

    /// Sends bytes from the host to the board.
    pub fn host_write(&mut self, bytes: &[u8]) {
        self.wire.host_write(self.now_us, bytes);
    }

    /// Appends the bytes that have arrived from the board to `bytes`.
    pub fn host_read(&mut self, bytes: &mut Vec<u8>) {
        self.wire.host_read(self.now_us, bytes);
    }

    /// Passes a client's datagram to the NatNet server.
    pub fn handle_datagram(&mut self, from: SocketAddr, bytes: &[u8]) {
        self.handle_datagram_at(self.now_us, from, bytes);
    }

    /// Like [`handle_datagram`](Self::handle_datagram), at a time that the world
    /// has not reached yet. The server's clock must not lag while the world catches
    /// up, or clients would map it wrongly.
    pub(crate) fn handle_datagram_at(&mut self, now_us: u64, from: SocketAddr, bytes: &[u8]) {
        let (ticks, cameras) = (self.cameras.ticks(now_us), &self.cameras.parameters);
        let natnet = &mut self.natnet;
        if let Some(datagram) = natnet.handle_datagram(now_us, ticks, cameras, from, bytes) {
            push_bounded(&mut self.datagrams, datagram, QUEUE_CAPACITY);
        }
    }

    /// Whether [`poll_datagram`](Self::poll_datagram) has one.
    pub fn has_datagrams(&self) -> bool {
        !self.datagrams.is_empty()
    }

    /// The next datagram of the NatNet server, answer or frame.
    pub fn poll_datagram(&mut self) -> Option<Datagram> {
        self.datagrams.pop_front()
    }

    /// The next sent camera frame, for a host without NatNet.
    pub fn poll_camera_frame(&mut self) -> Option<CameraFrame> {
        self.frames.pop_front()
    }

    /// Ground truth.
    pub fn truth(&self) -> Truth {
        let mut car = self.car.clone();
        car.advance_to(self.now_us);
        car.truth()
    }

    /// Present bias of the gyroscope about the car's axes, in rad/s.
    pub const fn gyro_bias_rad_s(&self) -> [f64; 3] {
        self.imu.gyro_bias
    }

    /// Sets the zero of all times `..._at_s` and `..._from_s` of the configuration, in µs
    /// of the simulation; the default is its start. With `None` nothing of the kind
    /// happens until there is one.
    pub const fn set_epoch(&mut self, epoch_us: Option<u64>) {
        self.car.epoch = Epoch(epoch_us);
        self.cameras.epoch = Epoch(epoch_us);
    }

    /// Resets the board; it restarts after its start-up time.
    pub fn reset_board(&mut self, cause: ResetCause) {
        self.board.reset(self.now_us, cause, &mut self.car);
    }

    /// Presses the board's reset button; its bootloader runs first.
    pub fn press_reset(&mut self) {
        self.reset_board(ResetCause::External);
    }

    /// Switches the board's power; the ESC has its own supply.
    pub fn set_board_power(&mut self, on: bool) {
        self.switched_on = on;
        self.supply_board();
    }

    /// Pulls the USB cable, or plugs it in: the serial line, and the board's power if it has no
    /// supply of its own.
    pub fn set_cable(&mut self, plugged: bool) {
        self.plugged = plugged;
        self.set_wire_connected(plugged);
        self.supply_board();
    }

    fn supply_board(&mut self) {
        let supplied = self.plugged || self.config.board.own_supply;
        let on = self.switched_on && supplied;
        self.board.set_power(self.now_us, on, &mut self.car);
    }

    /// Interrupts the serial line, or closes it again; the board keeps its power.
    pub fn set_wire_connected(&mut self, connected: bool) {
        self.wire.set_connected(self.now_us, connected);
    }

    /// Changes the streaming id of the car's rigid body, as an operator can; the
    /// next frame announces the change.
    pub const fn set_car_body_id(&mut self, id: i32) {
        self.cameras.set_car_id(id);
        self.natnet.models_changed = true;
    }
}

#[cfg(test)]
mod tests {
    use singletrack_mocap::{
        codec::{BitstreamVersion, ClientMessage, ServerMessage},
        encode,
    };

    use singletrack_protocol::ImuState;

    use super::*;

    #[test]
    fn a_late_world_answers_echoes_with_the_present_time() {
        let mut world = World::new(SimulationConfig::default()).unwrap();
        world.advance_to(1_000_000);
        while world.poll_datagram().is_some() {}
        let mut request = [0; 64];
        let message = ClientMessage::EchoRequest { client_stamp: 77 };
        let length = encode::client_message(&message, &mut request).unwrap();
        let mut ticks_at = |now_us| {
            world.handle_datagram_at(now_us, ([127, 0, 0, 1], 4_000).into(), &request[..length]);
            let answer = world.poll_datagram().unwrap();
            match ServerMessage::decode(&answer.bytes, BitstreamVersion::V4_1) {
                Ok(ServerMessage::Echo(echo)) => echo.server_ticks,
                other => panic!("{other:?}"),
            }
        };
        // 12 ms in ticks of 100 ns; the clock is 40 ppm fast, which is 0.5 us here.
        let (then, now) = (ticks_at(1_000_000), ticks_at(1_012_000));
        assert_eq!(now - then, 120_000);
    }

    #[test]
    fn a_pulled_cable_takes_the_power_along_unless_the_board_has_its_own() {
        for own_supply in [false, true] {
            let mut config = SimulationConfig::default();
            config.board.own_supply = own_supply;
            let mut world = World::new(config).unwrap();
            world.advance_to(500_000);
            world.set_cable(false);
            world.advance_to(1_000_000);
            assert_eq!(world.board.is_running(), own_supply);
            let silent = world.board.pulses.last().unwrap().esc_us == 0;
            assert_eq!(silent, !own_supply);
            // A switch comes before either supply.
            world.set_board_power(false);
            world.set_cable(true);
            world.advance_to(1_500_000);
            assert!(!world.board.is_running());
            world.set_board_power(true);
            world.advance_to(2_000_000);
            assert!(world.board.is_running());
        }
    }

    #[test]
    fn a_dip_of_its_supply_silences_the_imu_until_it_has_restarted() {
        let mut config = SimulationConfig::default();
        config.car.battery.dip_at_s = Some(1.0);
        config.car.battery.dip_ms = 200.0;
        config.car.imu.restart_ms = 500.0;
        let mut world = World::new(config).unwrap();
        let mut samples = Vec::new();
        for ms in (0..3_000).step_by(10) {
            world.advance_to(ms * 1_000);
            if let Some(telemetry) = world.board.telemetry() {
                samples.push((ms, telemetry.imu != ImuState::Silent));
            }
        }
        // The board waits for 50 ms before it calls the IMU silent.
        let silent = |ms| (1_070..1_700).contains(&ms);
        let good = |ms| !(1_000..=1_750).contains(&ms);
        assert!(samples.iter().all(|&(ms, some)| !silent(ms) || !some));
        assert!(samples.iter().skip(5).all(|&(ms, some)| !good(ms) || some));
        assert!(samples.len() > 250);
    }

    #[test]
    fn a_second_network_card_and_a_server_that_is_off() {
        let connect = |natnet| {
            let mut world = World::new(SimulationConfig {
                natnet,
                ..SimulationConfig::default()
            })
            .unwrap();
            let mut request = [0; 512];
            let message = ClientMessage::EchoRequest { client_stamp: 1 };
            let length = encode::client_message(&message, &mut request).unwrap();
            world.handle_datagram(([127, 0, 0, 1], 4_000).into(), &request[..length]);
            world.poll_datagram()
        };
        let natnet = crate::NatNetParameters::default();
        assert_eq!(connect(natnet).unwrap().from, None);
        let second = Some([127, 0, 0, 2].into());
        let natnet = crate::NatNetParameters {
            sends_from: second,
            ..natnet
        };
        assert_eq!(connect(natnet).unwrap().from, second);
        let natnet = crate::NatNetParameters {
            is_off: true,
            ..natnet
        };
        assert_eq!(connect(natnet), None);
    }
}
