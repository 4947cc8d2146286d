//! A minimal host for the simulated board, which configures, arms and drives.

use singletrack_protocol::{
    Arm, BoardMode, Configuration, Configure, Decoder, Drive, Hello, RefusalReason, Sequence,
    Status, Telemetry, ToBoard, ToHost, VERSION,
};

use crate::{ConfigError, SimulationConfig, World, default_board_configuration};

/// A minimal host.
#[derive(Debug, Default)]
pub struct ScriptedHost {
    decoder: Decoder,
    /// The last telemetry record.
    pub telemetry: Option<Telemetry>,
    /// The last status record.
    pub status: Option<Status>,
    /// Number of telemetry records.
    pub records: u64,
    /// Number of corrupted or invalid frames.
    pub damaged: u64,
    /// Refused requests.
    pub refusals: Vec<RefusalReason>,
    /// Number of answered requests, refused or not.
    pub answers: u64,
    /// Number of greetings, answered and unsolicited.
    pub hellos: Vec<Hello>,
    /// The car that the board named last.
    pub car_id: Option<u16>,
    sequence: Sequence,
}

impl ScriptedHost {
    /// Processes bytes from the board.
    pub fn take(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            let Some(packet) = self.decoder.push(byte) else {
                continue;
            };
            match packet.map(ToHost::decode) {
                Ok(Ok(ToHost::Telemetry(telemetry))) => {
                    self.telemetry = Some(telemetry);
                    self.records += 1;
                }
                Ok(Ok(ToHost::Status(status))) => self.status = Some(status),
                Ok(Ok(ToHost::Refusal(refusal))) => {
                    self.refusals.push(refusal.reason);
                    self.answers += 1;
                }
                Ok(Ok(ToHost::Hello(hello))) => self.hellos.push(hello),
                Ok(Ok(ToHost::Identity(identity))) => self.car_id = Some(identity.car_id),
                Ok(Ok(ToHost::Acknowledgement(_))) => self.answers += 1,
                Err(_) | Ok(Err(_)) => self.damaged += 1,
            }
        }
    }

    /// A new sequence number.
    pub fn next_sequence(&mut self) -> Sequence {
        self.sequence = self.sequence.next();
        self.sequence
    }

    /// Board time of the newest telemetry, in µs; zero before the first.
    pub fn telemetry_time_us(&self) -> u32 {
        self.telemetry.map_or(0, |newest| newest.board_time_us)
    }

    /// The board's last reported mode.
    pub fn mode(&self) -> Option<BoardMode> {
        self.telemetry.map(|telemetry| telemetry.mode)
    }

    /// The next command, as a message.
    pub fn drive(&mut self, speed_mm_s: i16, steering_100urad: i16) -> ToBoard {
        ToBoard::Drive(Drive {
            sequence: self.next_sequence(),
            speed_mm_s,
            steering_100urad,
            telemetry_time_us: self.telemetry_time_us(),
            pose_age_ms: 10,
            brake: false,
        })
    }
}

/// A world and a scripted host, in step, in virtual time.
#[derive(Debug)]
pub struct ScriptedDrive {
    /// The world.
    pub world: World,
    /// The host.
    pub host: ScriptedHost,
    /// Configuration of the board.
    pub configuration: Configuration,
}

impl ScriptedDrive {
    /// A world whose board has just been powered on.
    ///
    /// # Errors
    ///
    /// Fails if the configuration is invalid.
    pub fn new(config: SimulationConfig) -> Result<Self, ConfigError> {
        Ok(Self {
            world: World::new(config)?,
            host: ScriptedHost::default(),
            configuration: default_board_configuration(),
        })
    }

    /// Powers up, configures and arms; the host's mode shows whether that
    /// succeeded.
    ///
    /// # Errors
    ///
    /// Fails if the configuration is invalid.
    pub fn armed(config: SimulationConfig) -> Result<Self, ConfigError> {
        let mut drive = Self::new(config)?;
        drive.run_ms(200);
        drive.prepare();
        Ok(drive)
    }

    /// Configures, waits until the ESC has been at neutral long enough, and arms.
    pub fn prepare(&mut self) {
        self.configure();
        self.run_ms(2_800);
        self.arm();
    }

    /// Sends a message to the board.
    pub fn send(&mut self, message: &ToBoard) {
        self.world.host_write(message.encode().as_bytes());
    }

    /// Advances time by whole milliseconds while the host receives.
    pub fn run_ms(&mut self, ms: u64) {
        let start = self.world.now_us;
        for i in 1..=ms {
            self.world.advance_to(start + i * 1_000);
            self.listen();
        }
    }

    /// Lets the host process the received bytes.
    pub fn listen(&mut self) {
        let mut received = Vec::new();
        self.world.host_read(&mut received);
        self.host.take(&received);
    }

    /// Greets and configures the board.
    pub fn configure(&mut self) {
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

    /// Sends an arm request to the board.
    pub fn arm(&mut self) {
        let request = self.host.next_sequence();
        let arm = Arm {
            request,
            configuration_hash: self.configuration.hash(),
            telemetry_time_us: self.host.telemetry_time_us(),
        };
        self.send(&ToBoard::Arm(arm));
        self.run_ms(40);
    }

    /// Drives for ticks of 10 ms; calls `each` after every one.
    pub fn drive(
        &mut self,
        ticks: u64,
        speed_mm_s: i16,
        steering_100urad: i16,
        mut each: impl FnMut(&mut Self),
    ) {
        for _ in 0..ticks {
            let command = self.host.drive(speed_mm_s, steering_100urad);
            self.send(&command);
            self.run_ms(10);
            each(self);
        }
    }
}
