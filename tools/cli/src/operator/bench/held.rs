//! A drive that a connection holds, and the key that holds it.

use std::time::{Duration, Instant};

use singletrack_api::{
    Arm, ClientError, Code, Connection, HeldDrive, RENEWAL, Reply, Request, Setpoint,
};
use singletrack_commissioning::{Attendance, Refused};

use super::{AGAIN, ANSWER, LiveBench, PATIENCE};

/// Interval of the set-points of a car that stands, and how long they come before it is armed.
const SETPOINT: Duration = Duration::from_millis(50);
const SETTLES: Duration = Duration::from_millis(400);

/// The drive of a procedure.
pub(super) struct BenchDrive {
    pub(super) held: HeldDrive,
    /// Why it has ended.
    pub(super) ended: Option<String>,
}

impl LiveBench {
    /// Renews a held drive while its key is held, and takes what the daemon says of it.
    pub(super) fn renew(&mut self) {
        let drive = self.drive.as_mut().filter(|drive| drive.ended.is_none());
        let Some(drive) = drive else { return };
        drive.ended = match self.terminal.is_released() {
            Ok(false) => None,
            Ok(true) => Some("the space bar was released".to_owned()),
            Err(error) => Some(format!("the space bar can't be read: {error}")),
        };
        if drive.ended.is_some() {
            // Without a renewal it would end half a second later.
            let _ = drive.held.connection.send(&Request::DISARM);
            return;
        }
        drive.ended = drive.held.renew().err().map(|error| error.to_string());
        loop {
            match drive.held.connection.receive() {
                Ok(None) => return,
                Ok(Some(Reply::Ended { ended, .. })) => {
                    let why = ended.reason.unwrap_or("the drive has ended".into());
                    drive.ended = Some(why.into());
                }
                Ok(Some(Reply::Answer(answer))) if answer.error.is_some() => {
                    drive.ended = answer.error;
                }
                Ok(Some(_)) => {}
                Err(error) => {
                    drive.ended = Some(error.to_string());
                    return;
                }
            }
        }
    }

    /// Sends a command to the drive that is held.
    pub(super) fn command_drive(&mut self, request: &Request) -> Result<(), Refused> {
        self.renew();
        let Some(drive) = &mut self.drive else {
            return Err(Refused("the car is not armed".to_owned()));
        };
        if let Some(ended) = &drive.ended {
            return Err(Refused(ended.clone()));
        }
        let sent = drive.held.connection.send(request);
        sent.map_err(Refused::because)
    }

    /// Waits until the operator holds the space bar, which must have been released before.
    pub(super) fn wait_for_key(&mut self) -> Result<(), Refused> {
        self.terminal.await_release();
        let mut is_told = false;
        while !self.terminal.is_released().map_err(Refused::because)? {
            if !is_told && self.terminal.was_pressed() {
                is_told = true;
                self.terminal.say("Let go of the space bar first.");
            }
            self.pump().map_err(Refused::because)?;
        }
        self.terminal.await_press();
        self.terminal
            .say("Hold the space bar: the car is armed while it is held.");
        while !self.terminal.is_pressed().map_err(Refused::because)? {
            self.pump().map_err(Refused::because)?;
        }
        Ok(())
    }

    /// Ends the time in which the space bar is the dead-man switch.
    pub(super) fn release_key(&mut self) {
        if self.terminal.holds_key() {
            self.terminal.release_key();
            self.terminal.say("Let go of the space bar.");
        }
    }

    /// Arms when the space bar is held, with a connection that holds the drive.
    pub(super) fn arm_by_key(&mut self, attendance: Attendance) -> Result<BenchDrive, Refused> {
        loop {
            self.wait_for_key()?;
            if let Some(drive) = self.arm_held(attendance)? {
                return Ok(drive);
            }
            self.terminal
                .say("The space bar was released before the car was armed.");
        }
    }

    /// Arms while the space bar is held; none if it was released before.
    fn arm_held(&mut self, attendance: Attendance) -> Result<Option<BenchDrive>, Refused> {
        let arm = Request::Arm(Arm {
            attendance: Some(singletrack_api::Attendance::Hold),
            jog: attendance == Attendance::Jog,
            uncalibrated: attendance == Attendance::Drive,
            ..Arm::default()
        });
        let stand = Request::Setpoint(Setpoint {
            velocity_m_s: Some([0.0; 2]),
            ..Setpoint::default()
        });
        let mut connection = Connection::open(&self.socket, PATIENCE).map_err(Refused::because)?;
        let begun = Instant::now();
        let mut asked: Option<Instant> = None;
        let mut again = begun;
        let mut sent = begun - SETPOINT;
        loop {
            if sent.elapsed() >= SETPOINT {
                sent = Instant::now();
                let mut send = |request| connection.send(request).map_err(Refused::because);
                if attendance == Attendance::Drive {
                    // Without set-points the car can't be armed.
                    send(&stand)?;
                }
                let settled =
                    (attendance == Attendance::Jog || begun.elapsed() >= SETTLES) && again <= sent;
                if asked.is_some() {
                    send(&Request::Hold {})?;
                } else if settled {
                    asked = Some(sent);
                    send(&arm)?;
                }
            }
            if let Some(reply) = connection.receive::<Reply>().map_err(Refused::because)? {
                match reply.agreed() {
                    Ok(_) => {
                        return Ok(Some(BenchDrive {
                            held: HeldDrive::new(connection, RENEWAL),
                            ended: None,
                        }));
                    }
                    // Renewals that came after a refusal.
                    Err(ClientError::Refused(refused)) if refused.code == Code::NoDrive => {}
                    // The board is configured again after a reset and with another reference, and
                    // the estimate restarts. The operator need not let go for that.
                    Err(ClientError::Refused(_)) if begun.elapsed() < ANSWER => {
                        asked = None;
                        again = Instant::now() + AGAIN;
                    }
                    Err(error) => return Err(Refused::because(error)),
                }
            }
            // The connection ends with either, and with it the request.
            if self.terminal.is_released().unwrap_or(true) {
                return Ok(None);
            }
            if asked.is_some_and(|asked| asked.elapsed() > ANSWER) {
                return Err(Refused("the daemon does not answer".to_owned()));
            }
            self.pump().map_err(Refused::because)?;
        }
    }
}
