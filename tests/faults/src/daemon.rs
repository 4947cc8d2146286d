//! The daemon of a drive: the host loop in virtual time; its records; and its serial port as the
//! kernel implements it: it is plugged in or not, takes whole frames, and keeps unread bytes.

use std::{
    collections::VecDeque,
    mem,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use singletrack_core::{
    ControlRequest, HostOptions, VirtualHost,
    config::Config,
    line::{Line, OutputQueue, PortRead, Sent},
    reconfigure::CHANGE_TIMEOUT_NS,
    record_meta,
    setpoint::SetpointCommand,
};
use singletrack_pilot::{Jog, Learned, PilotRequest, Tuning};
use singletrack_record::{
    ClockMapping, ConfigurationRecord, Entry, RecordError, Recorder, TickRecord,
};

use crate::{
    SetupError, network::HostSockets, schedule::Schedule, setting::Reported, tamper::Tamper,
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
        (self.host.due_ns - EPOCH_NS).div_ceil(1_000)
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
        let request = ControlRequest::Pilot(request);
        self.host.parts.requests.push(request).is_ok()
    }

    /// Sends pulses, as a client that jogs.
    pub(crate) fn jog(&self, jog: Jog) {
        self.host.parts.jogs.send(jog);
    }

    /// Arms a car that waits until `begin_ns`. Without room, it is not armed.
    pub(crate) fn arm_at(&self, begin_ns: u64) {
        let request = ControlRequest::ArmAt(begin_ns);
        let _ = self.host.parts.requests.push(request);
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
        let request = ControlRequest::Learned(learned);
        let _ = self.host.parts.requests.push(request);
    }

    /// The corrections in force.
    pub(crate) fn learned(&self) -> Option<Learned> {
        self.host.parts.control.controller.pilot.learned()
    }

    /// Sends a set-point, as a client of the control socket.
    pub(crate) fn send(&self, sent: &SetpointCommand) {
        self.host.parts.setpoints.pass(sent);
    }

    /// Reloads the configuration. A refusal has no effect; the daemon would log it.
    pub(crate) fn reload(&mut self, now_us: u64, config: &Config) {
        let until_ns = host_ns(now_us) + CHANGE_TIMEOUT_NS;
        let host = &mut self.host.parts;
        let _ = host
            .configurations
            .begin(config.clone(), until_ns, &host.requests);
    }

    /// The configuration that came into force since the last call, with its number.
    pub(crate) fn settled(&mut self) -> Option<(u32, &Config)> {
        let number = self.host.parts.configurations.settle()?.ok()?;
        Some((number, &self.host.parts.configurations.in_force))
    }

    /// Runs a tick of the control loop.
    pub(crate) fn tick(&mut self, now_us: u64) -> Option<TickRecord> {
        self.host.tick(host_ns(now_us));
        self.host.next_tick()
    }
}

/// A transfer of a genuine UNO as its driver counts it, however short it is, in bytes, and the
/// bytes that the UNO's serial chip takes before a transfer waits.
const TRANSFER: usize = 1_280;
const CHIP: usize = 128;

/// The bytes that Linux keeps until they are read: 4095 in the line discipline and
/// 64 KiB in the buffers before it. Further bytes are lost.
const UNREAD: usize = 4_095 + 65_536;

#[derive(Debug, Default)]
struct State {
    plugged: bool,
    reported: Reported,
    /// Bytes in the output queue at the last query of the world, and those written since.
    queued: usize,
    /// Writes since then.
    writes: usize,
    written: Vec<u8>,
}

/// The port.
#[derive(Debug)]
pub(crate) struct Port {
    state: Arc<Mutex<State>>,
    unread: VecDeque<u8>,
    opened: bool,
}

/// The half that the control thread writes. It checks the queue as that of the daemon does, see
/// `singletrackd::serial_port`.
#[derive(Debug)]
pub(crate) struct WriteHalf {
    state: Arc<Mutex<State>>,
    queue: OutputQueue,
}

fn lock(state: &Arc<Mutex<State>>) -> MutexGuard<'_, State> {
    // One thread has both ends.
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Port {
    pub(crate) fn new(reported: Reported) -> Self {
        let state = State {
            plugged: true,
            reported,
            ..State::default()
        };
        Self {
            state: Arc::new(Mutex::new(state)),
            unread: VecDeque::new(),
            opened: false,
        }
    }

    pub(crate) fn set_plugged(&mut self, plugged: bool) {
        lock(&self.state).plugged = plugged;
        if !plugged {
            self.unread.clear();
        }
    }

    fn is_plugged(&self) -> bool {
        lock(&self.state).plugged
    }

    pub(crate) fn set_queued(&self, bytes: usize) {
        let mut state = lock(&self.state);
        (state.queued, state.writes) = (bytes, 0);
    }

    /// Takes the bytes that the daemon has written since the last call.
    pub(crate) fn take_written(&self, into: &mut Vec<u8>) {
        into.append(&mut lock(&self.state).written);
    }

    /// Bytes have come from the board.
    pub(crate) fn receive(&mut self, bytes: &[u8]) {
        let room = UNREAD.saturating_sub(self.unread.len());
        self.unread.extend(bytes.iter().take(room));
    }

    /// Whether the port was opened since the last call.
    pub(crate) const fn take_opened(&mut self) -> bool {
        core::mem::replace(&mut self.opened, false)
    }
}

impl singletrack_core::line::Port for Port {
    type Line = WriteHalf;

    /// Drops unread bytes: they belong to an earlier connection.
    fn open(&mut self) -> Option<WriteHalf> {
        if !self.is_plugged() {
            return None;
        }
        self.unread.clear();
        self.opened = true;
        Some(WriteHalf {
            state: Arc::clone(&self.state),
            queue: OutputQueue::default(),
        })
    }

    fn read(&mut self, buffer: &mut [u8]) -> PortRead {
        if !self.is_plugged() {
            return PortRead::HungUp;
        }
        let count = buffer.len().min(self.unread.len());
        for (to, from) in buffer.iter_mut().zip(self.unread.drain(..count)) {
            *to = from;
        }
        match count {
            0 => PortRead::Nothing,
            count => PortRead::Bytes(count),
        }
    }

    fn close(&mut self) {}
}

impl Line for WriteHalf {
    fn write_frame(&mut self, frame: &[u8]) -> Sent {
        let mut state = lock(&self.state);
        let queued = match state.reported {
            Reported::Nothing => 0,
            Reported::Bytes => state.queued,
            Reported::Transfers => {
                let waiting = state.queued.saturating_sub(CHIP).div_ceil(frame.len());
                (waiting + state.writes) * TRANSFER
            }
        };
        if !state.plugged || !self.queue.has_room(queued) {
            return Sent::Dropped;
        }
        self.queue.wrote(frame.len());
        state.queued += frame.len();
        state.writes += 1;
        state.written.extend_from_slice(frame);
        Sent::Whole
    }
}

/// The wall clock at the start of the simulation, in ns since 1970.
const WALL_NS: u64 = 1_700_000_000_000_000_000;

/// Collects the ticks of a drive. It changes nothing.
#[derive(Debug, Default)]
pub struct Recording {
    /// One for each daemon that was started.
    daemons: Vec<DaemonRecord>,
    /// A configuration that comes into force with the next tick.
    changed: Option<(u32, Config)>,
}

#[derive(Debug)]
struct DaemonRecord {
    config: Config,
    entries: Vec<Entry>,
}

impl Tamper for Recording {
    fn configuration(&mut self, number: u32, config: &mut Config) {
        if number == 1 {
            self.daemons.push(DaemonRecord {
                config: config.clone(),
                entries: Vec::new(),
            });
        } else {
            self.changed = Some((number, config.clone()));
        }
    }

    fn tick(&mut self, tick: &mut TickRecord) {
        let Some(daemon) = self.daemons.last_mut() else {
            return;
        };
        daemon.entries.push(Entry::Tick(tick.clone()));
        if let Some((number, config)) = self.changed.take()
            && let Ok(toml) = config.to_toml()
        {
            daemon
                .entries
                .push(Entry::Configuration(ConfigurationRecord {
                    time_ns: tick.start_ns,
                    number,
                    toml,
                }));
        }
    }
}

/// Why a record was not written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The configuration of the schedule is invalid.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The file can't be written.
    #[error(transparent)]
    Record(#[from] RecordError),
}

impl Recording {
    /// Writes `seed-N.mcap`, and `seed-N-2.mcap` for a second daemon and so on.
    ///
    /// # Errors
    ///
    /// A file exists or can't be written.
    pub fn write(
        &mut self,
        folder: &Path,
        schedule: &Schedule,
    ) -> Result<Vec<PathBuf>, RecordingError> {
        let seed = schedule.seed;
        let mut paths = Vec::new();
        for (index, daemon) in mem::take(&mut self.daemons).into_iter().enumerate() {
            let path = folder.join(match index {
                0 => format!("seed-{seed}.mcap"),
                index => format!("seed-{seed}-{}.mcap", index + 1),
            });
            let start = ClockMapping {
                monotonic_ns: match daemon.entries.first() {
                    Some(Entry::Tick(tick)) => tick.start_ns,
                    _ => 0,
                },
                wall_ns: WALL_NS,
            };
            let meta = record_meta(&daemon.config, Some(seed), start).map_err(|error| {
                SetupError::Other {
                    part: "the daemon's configuration",
                    reason: error.to_string(),
                }
            })?;
            let mut recorder = Recorder::create(&path, &meta)?;
            for entry in &daemon.entries {
                recorder.write(entry)?;
            }
            recorder.finish()?;
            paths.push(path);
        }
        Ok(paths)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use singletrack_core::line::{Line, Port as _, Sent};
    use singletrack_protocol::{Drive, Message, frame_length};

    use super::{Port, Reported};

    const DRIVE: [u8; frame_length(Drive::PAYLOAD_LENGTH)] =
        [1; frame_length(Drive::PAYLOAD_LENGTH)];

    #[test]
    fn every_port_takes_a_second_frame_in_a_tick_and_no_third_unless_it_hides_its_queue() {
        for reported in [Reported::Nothing, Reported::Bytes, Reported::Transfers] {
            let mut port = Port::new(reported);
            let mut line = port.open().unwrap();
            for _ in 0..3 {
                port.set_queued(0);
                let sent = [(); 3].map(|()| line.write_frame(&DRIVE));
                let third = if reported == Reported::Nothing {
                    Sent::Whole
                } else {
                    Sent::Dropped
                };
                assert_eq!(sent, [Sent::Whole, Sent::Whole, third], "{reported:?}");
            }
        }
    }
}
