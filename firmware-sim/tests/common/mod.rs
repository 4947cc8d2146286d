//! A small host for the simulated board: enough to configure, arm and drive.

#![allow(dead_code, reason = "not every test uses every part")]
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use singletrack_protocol::{
    Arm, BoardMode, Configuration, Configure, Decoder, Drive, Hello, RefusalReason, Sequence,
    Status, Telemetry, ToBoard, ToHost, VERSION,
};
use singletrack_sim::{SimulationConfig, World, default_board_configuration};

/// What a host remembers of the board.
pub(crate) struct Host {
    decoder: Decoder,
    pub(crate) telemetry: Option<Telemetry>,
    pub(crate) status: Option<Status>,
    pub(crate) records: u64,
    pub(crate) damaged: u64,
    pub(crate) refusals: Vec<RefusalReason>,
    pub(crate) hellos: Vec<Hello>,
    sequence: Sequence,
}

impl Host {
    pub(crate) fn new() -> Self {
        Self {
            decoder: Decoder::new(),
            telemetry: None,
            status: None,
            records: 0,
            damaged: 0,
            refusals: Vec::new(),
            hellos: Vec::new(),
            sequence: Sequence(0),
        }
    }

    pub(crate) fn take(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            let message = match self.decoder.push(byte) {
                None => continue,
                Some(Err(_)) => {
                    self.damaged += 1;
                    continue;
                }
                Some(Ok(packet)) => ToHost::decode(packet),
            };
            match message {
                Ok(ToHost::Telemetry(telemetry)) => {
                    self.telemetry = Some(telemetry);
                    self.records += 1;
                }
                Ok(ToHost::Status(status)) => self.status = Some(status),
                Ok(ToHost::Refusal(refusal)) => self.refusals.push(refusal.reason),
                Ok(ToHost::Hello(hello)) => self.hellos.push(hello),
                Ok(ToHost::Acknowledgement(_)) => {}
                Err(_) => self.damaged += 1,
            }
        }
    }

    pub(crate) fn next_sequence(&mut self) -> Sequence {
        self.sequence = self.sequence.next();
        self.sequence
    }

    pub(crate) fn telemetry_time_us(&self) -> u32 {
        self.telemetry
            .map_or(0, |telemetry| telemetry.board_time_us)
    }

    pub(crate) fn mode(&self) -> Option<BoardMode> {
        self.telemetry.map(|telemetry| telemetry.mode)
    }

    pub(crate) fn drive(&mut self, speed_mm_s: i16, steering_100urad: i16) -> Vec<u8> {
        let sequence = self.next_sequence();
        bytes(&ToBoard::Drive(Drive {
            sequence,
            speed_mm_s,
            steering_100urad,
            telemetry_time_us: self.telemetry_time_us(),
            pose_age_ms: 10,
        }))
    }
}

pub(crate) fn bytes(message: &ToBoard) -> Vec<u8> {
    message.encode().as_bytes().to_vec()
}

/// A world and its host, in step.
pub(crate) struct Bench {
    pub(crate) world: World,
    pub(crate) host: Host,
    pub(crate) configuration: Configuration,
}

impl Bench {
    pub(crate) fn new(config: SimulationConfig) -> Self {
        Self {
            world: World::new(config).unwrap(),
            host: Host::new(),
            configuration: default_board_configuration(),
        }
    }

    pub(crate) fn send(&mut self, message: &ToBoard) {
        self.world.host_write(&bytes(message));
    }

    /// Lets time pass by whole milliseconds, the host listening.
    pub(crate) fn run_ms(&mut self, ms: u64) {
        let start = self.world.now_us();
        for i in 1..=ms {
            self.world.advance_to(start + i * 1_000);
            self.listen();
        }
    }

    pub(crate) fn listen(&mut self) {
        let mut received = Vec::new();
        self.world.host_read(&mut received);
        self.host.take(&received);
    }

    /// Powers up, configures and arms.
    pub(crate) fn armed(config: SimulationConfig) -> Self {
        let mut bench = Self::new(config);
        bench.run_ms(200);
        bench.configure();
        bench.run_ms(2_800);
        bench.arm();
        assert_eq!(
            bench.host.mode(),
            Some(BoardMode::Armed),
            "{:?}",
            bench.host.refusals
        );
        bench
    }

    pub(crate) fn configure(&mut self) {
        self.send(&ToBoard::Hello(Hello {
            protocol_version: VERSION,
            software_version: [0, 1, 0],
            nonce: 7,
        }));
        self.run_ms(20);
        let configuration = self.configuration;
        let request = self.host.next_sequence();
        self.send(&ToBoard::Configure(Configure {
            request,
            configuration,
        }));
        self.run_ms(20);
    }

    pub(crate) fn arm(&mut self) {
        let request = self.host.next_sequence();
        let arm = Arm {
            request,
            configuration_hash: self.configuration.hash(),
            telemetry_time_us: self.host.telemetry_time_us(),
        };
        self.send(&ToBoard::Arm(arm));
        self.run_ms(40);
    }

    /// Drives for whole ticks of 10 ms; `each` sees the bench after every one.
    pub(crate) fn drive(
        &mut self,
        ticks: u64,
        speed_mm_s: i16,
        steering_100urad: i16,
        mut each: impl FnMut(&mut Self),
    ) {
        for _ in 0..ticks {
            let command = self.host.drive(speed_mm_s, steering_100urad);
            self.world.host_write(&command);
            self.run_ms(10);
            each(self);
        }
    }
}
