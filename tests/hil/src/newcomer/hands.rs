//! The hands of `singletrack-sim`, by its socket.

use std::{
    collections::VecDeque,
    io::{self, Read as _, Write as _},
    os::unix::net::UnixStream,
    path::Path,
    time::{Duration, Instant},
};

use singletrack_onboard::Hands;
use singletrack_sim::{HandCommand, HandMotion, Seen};

use crate::{Failure, Outcome, wait};

/// A person's hands and eyes, on a car in another process.
#[derive(Debug)]
pub struct SocketHands {
    stream: UnixStream,
    received: Vec<u8>,
    seen: Seen,
    /// What is still to be done.
    commands: VecDeque<HandCommand>,
    /// What is being done.
    under_way: Option<HandCommand>,
    begun: Instant,
    rear_axle_m: f64,
}

impl SocketHands {
    /// Connects.
    ///
    /// # Errors
    ///
    /// Nothing listens within five seconds.
    pub fn connect(path: &Path, rear_axle_m: f64) -> Outcome<Self> {
        let stream = wait::until("the hands' socket", Duration::from_secs(5), || {
            Ok(UnixStream::connect(path).ok())
        })?;
        stream
            .set_nonblocking(true)
            .map_err(Failure::system("the hands' socket"))?;
        Ok(Self {
            stream,
            received: Vec::new(),
            seen: Seen::default(),
            commands: VecDeque::new(),
            under_way: None,
            begun: Instant::now(),
            rear_axle_m,
        })
    }

    /// Takes the answer, and goes on with the next command, or looks.
    ///
    /// # Errors
    ///
    /// The simulator has ended, or does not know a command.
    pub fn poll(&mut self) -> Outcome {
        let mut buffer = [0; 1_024];
        match self.stream.read(&mut buffer) {
            Ok(0) => return Err(Failure::new("the simulator has ended")),
            Ok(count) => self
                .received
                .extend_from_slice(buffer.get(..count).unwrap_or_default()),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(Failure::system("the hands' socket")(error)),
        }
        if let Some(end) = self.received.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = self.received.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line).into_owned();
            self.seen = line
                .strip_prefix("ok ")
                .and_then(seen)
                .ok_or_else(|| Failure::new(format!("the hands: {line}")))?;
            self.under_way = None;
        }
        if self.under_way.is_none() {
            let command = self.commands.pop_front().unwrap_or(HandCommand::Look);
            self.stream
                .write_all((line(command) + "\n").as_bytes())
                .map_err(Failure::system("the hands' socket"))?;
            self.under_way = Some(command);
        }
        Ok(())
    }
}

impl Hands for SocketHands {
    fn now_us(&self) -> u64 {
        self.begun.elapsed().as_micros() as u64
    }

    fn look(&self) -> Seen {
        self.seen
    }

    fn is_moving(&self) -> bool {
        !self.commands.is_empty() || matches!(self.under_way, Some(HandCommand::Move(_)))
    }

    fn apply(&mut self, command: HandCommand) {
        self.commands.push_back(command);
    }

    fn rear_axle_m(&self) -> f64 {
        self.rear_axle_m
    }
}

/// A command as `singletrack-sim` reads it.
fn line(command: HandCommand) -> String {
    let on = |on: bool| if on { "on" } else { "off" };
    match command {
        HandCommand::Move(motion) => {
            let (name, numbers) = words(motion);
            let numbers = numbers.iter().map(|number| format!(" {number}"));
            name.to_owned() + &numbers.collect::<String>()
        }
        HandCommand::Esc(is_on) => format!("esc {}", on(is_on)),
        HandCommand::Battery(is_on) => format!("battery {}", on(is_on)),
        HandCommand::Cable(is_on) => format!("cable {}", on(is_on)),
        HandCommand::StopSwitch(true) => "stop-switch open".to_owned(),
        HandCommand::StopSwitch(false) => "stop-switch closed".to_owned(),
        HandCommand::Markers(true) => "markers covered".to_owned(),
        HandCommand::Markers(false) => "markers visible".to_owned(),
        HandCommand::Reset => "reset".to_owned(),
        HandCommand::Look => "look".to_owned(),
    }
}

/// An angle in degrees, without the last digits, which the conversion makes up.
fn degrees(angle_rad: f64) -> f64 {
    (angle_rad.to_degrees() * 1e9).round() / 1e9
}

/// The name of a motion, and its numbers.
fn words(motion: HandMotion) -> (&'static str, Vec<f64>) {
    match motion {
        HandMotion::Lift { height_m } => ("lift", vec![height_m]),
        HandMotion::PutDown => ("put-down", Vec::new()),
        HandMotion::Roll {
            distance_m: distance,
            speed_m_s: speed,
        } => ("roll", vec![distance, speed]),
        HandMotion::Turn {
            angle_rad: angle,
            about_m: [forward, left],
            wander_m: wander,
            for_s,
        } => ("turn", vec![degrees(angle), forward, left, for_s, wander]),
        HandMotion::Twist {
            amplitude_rad: angle,
            about_m: [forward, left],
            period_s,
            for_s,
        } => (
            "twist",
            vec![degrees(angle), forward, left, period_s, for_s],
        ),
        HandMotion::Tilt {
            roll_rad: roll,
            pitch_rad: pitch,
            for_s,
        } => ("tilt", vec![degrees(roll), degrees(pitch), for_s]),
        HandMotion::Carry { to, for_s } => {
            ("carry", vec![to.x_m, to.y_m, degrees(to.yaw_rad), for_s])
        }
        HandMotion::Hold { for_s } => ("hold", vec![for_s]),
    }
}

/// What the simulator's answer says that is seen; none if it is no such line.
fn seen(line: &str) -> Option<Seen> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let word = |key: &str| {
        let mut pairs = words.chunks_exact(2);
        pairs.find_map(|pair| (pair[0] == key).then_some(pair[1]))
    };
    let number = |key: &str| word(key)?.parse::<f64>().ok();
    let flag = |key: &str| match word(key)? {
        "yes" | "on" => Some(true),
        "no" | "off" => Some(false),
        _ => None,
    };
    Some(Seen {
        steering_deg: number("steering_deg")?,
        wheels_m_s: number("wheels_m_s")?,
        driven: flag("driven")?,
        buzzes: flag("buzzes")?,
        esc: flag("esc")?,
        battery_v: number("battery_v")?,
        x_m: number("x_m")?,
        y_m: number("y_m")?,
        yaw_deg: number("yaw_deg")?,
        held: flag("held")?,
        wheels_up: flag("wheels_up")?,
    })
}

#[cfg(test)]
mod tests {
    use singletrack_sim::{SimulationConfig, UnknownHandCommand, World};

    use super::*;

    #[test]
    fn what_is_seen_is_read_as_it_is_written() {
        let mut world = World::new(SimulationConfig::default()).unwrap();
        for line in ["lift 0.1", "esc off", "battery off"] {
            line.parse::<HandCommand>().unwrap().apply(&mut world);
        }
        world.advance_to(1_100_000);
        let text = Seen::of(&world).to_string();
        assert_eq!(seen(&text).unwrap().to_string(), text);
        assert_eq!(seen("esc on"), None);
    }

    #[test]
    fn a_command_is_written_as_it_is_read() {
        for line in [
            "lift 0.1",
            "put-down",
            "roll -0.5 0.4",
            "turn 90 -0.1 0.02 3 0.004",
            "twist 30 0 0.01 1.1 12",
            "tilt 45 0 3",
            "carry 1 -0.5 90 4",
            "hold 2",
            "esc off",
            "battery on",
            "cable off",
            "stop-switch open",
            "markers covered",
            "reset",
            "look",
        ] {
            let command: HandCommand = line.parse().unwrap();
            assert_eq!(super::line(command), line);
        }
        let without: HandCommand = "turn 90 0 0 3".parse().unwrap();
        assert_eq!(line(without), "turn 90 0 0 3 0");
        assert_eq!(
            "turn 90 0 0 3 0 0".parse::<HandCommand>(),
            Err(UnknownHandCommand)
        );
    }
}
