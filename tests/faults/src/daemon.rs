//! The daemon of a drive: the host loop in virtual time.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use singletrack_core::{
    HostOptions, VirtualHost, config::Config, reconfigure::CHANGE_TIMEOUT_NS,
    setpoint::SetpointCommand,
};
use singletrack_pilot::{Jog, Learned, PilotRequest, Tuning};
use singletrack_record::TickRecord;

use crate::{
    SetupError,
    network::HostSockets,
    port::{Port, WriteHalf},
};

/// The host's clock at the start of the simulation, in ns.
const EPOCH_NS: u64 = 1_000_000_000_000;

/// The host's clock at a simulation time.
pub(crate) const fn host_ns(now_us: u64) -> u64 {
    EPOCH_NS + now_us * 1_000
}

/// A running daemon.
#[derive(Debug)]
pub(crate) struct Daemon {
    host: Box<VirtualHost<WriteHalf>>,
    /// The source address of its datagrams.
    pub(crate) address: SocketAddr,
}

impl Daemon {
    /// The `number`-th daemon of a drive, started at `now_us`.
    pub(crate) fn start(
        config: &Config,
        nonce_seed: u64,
        number: u16,
        now_us: u64,
    ) -> Result<Self, SetupError> {
        let options = HostOptions {
            nonce_seed,
            arm_when_ready: false,
            ..HostOptions::default()
        };
        Ok(Self {
            host: Box::new(
                VirtualHost::new(config.clone(), options, host_ns(now_us))
                    .map_err(SetupError::Config)?,
            ),
            address: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 40_000 + number),
        })
    }

    /// Simulation time of the next tick, in µs, rounded up.
    pub(crate) const fn next_tick_us(&self) -> u64 {
        (self.host.next_tick_ns() - EPOCH_NS).div_ceil(1_000)
    }

    /// Runs the serial reader. Returns whether it read bytes.
    pub(crate) fn poll_serial(&mut self, now_us: u64, port: &mut Port) -> bool {
        self.host.poll_serial(host_ns(now_us), port)
    }

    /// Runs the camera receiver.
    pub(crate) fn poll_cameras(&mut self, now_us: u64, sockets: &mut HostSockets<'_>) {
        self.host
            .poll_cameras(host_ns(now_us), sockets, &mut |_| {});
    }

    /// Sends a request, as a client of the control socket. Returns false if the control
    /// loop has no room.
    pub(crate) fn request(&self, request: PilotRequest) -> bool {
        self.host.request(request).is_ok()
    }

    /// Sends pulses, as a client that jogs.
    pub(crate) fn jog(&self, jog: Jog) {
        self.host.parts().jogs.send(jog);
    }

    /// Arms a car that waits until `begin_ns`. Without room, it is not armed.
    pub(crate) fn arm_at(&self, begin_ns: u64) {
        let _ = self.host.arm_at(begin_ns);
    }

    /// Sends values to tune, as a client of the control socket. A refusal has no effect.
    pub(crate) fn tune(&self, gain: f64) {
        let _ = self.host.tune(Tuning {
            gain: Some([gain, gain].into()),
            point_distance: None,
        });
    }

    /// Tells the pilot what is learned, as the daemon's own learner.
    pub(crate) fn tell(&self, learned: Learned) {
        // A full ring takes none.
        let _ = self.host.learned(learned);
    }

    /// The corrections in force.
    pub(crate) fn learned(&self) -> Option<Learned> {
        self.host.controller().pilot().learned()
    }

    /// Sends a set-point, as a client of the control socket.
    pub(crate) fn send(&self, sent: &SetpointCommand) {
        self.host.parts().setpoints.pass(sent);
    }

    /// Reloads the configuration. A refusal has no effect; the daemon would log it.
    pub(crate) fn reload(&mut self, now_us: u64, config: &Config) {
        let until_ns = host_ns(now_us) + CHANGE_TIMEOUT_NS;
        let _ = self.host.reconfigure(config.clone(), until_ns);
    }

    /// The configuration that came into force since the last call, with its number.
    pub(crate) fn settled(&mut self) -> Option<(u32, &Config)> {
        let number = self.host.settle()?.ok()?;
        Some((number, self.host.parts().configurations.in_force()))
    }

    /// Runs a tick of the control loop.
    pub(crate) fn tick(&mut self, now_us: u64) -> Option<TickRecord> {
        self.host.tick(host_ns(now_us));
        self.host.next_tick()
    }
}
