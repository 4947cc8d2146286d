//! An attended drive: the connection that armed it holds it.
//!
//! The control loop wants a renewal at least every 0.5 s, and every one comes from the client, which
//! may ask this thread to wait for less. If this thread dies, the renewals end too, and the car
//! stops. A connection that ends, also because its process was killed, ends the drive at once.

use std::{io, time::Duration};

use singletrack_api::{Answer, Code, Drive, Ended, Refused, Reply, SOCKET_VERSION};
use singletrack_pilot::{Mode, Output, PilotRequest, Reason};
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, BufReader},
    task::yield_now,
    time::{Instant, sleep_until},
};

use super::{
    answers::{end, no_command, status, tune},
    arm::{begin, begin_jogging, drive_begun},
    command::{Arm, Command},
    drives::{DriveWatch, Progress, Ticket},
    setpoint::SetpointStream,
    stream::{LONGEST_LINE, refuse_long_line, send},
    stream::{ReadHalf, WriteHalf},
};
use crate::{clock::monotonic_ns, handle::DaemonHandle};

/// The most frequent renewals that are passed on: a flood must not fill the ring of requests.
const LEAST_RENEWAL: Duration = Duration::from_millis(20);

/// Interval of the reports about a drive to the client that attends it. One that asks for a shorter
/// hold gets three in that time.
const REPORT: Duration = Duration::from_millis(200);

/// A client, with its connection.
pub(super) struct Client<'a> {
    pub(super) read: BufReader<ReadHalf>,
    pub(super) write: WriteHalf,
    pub(super) daemon: &'a DaemonHandle,
    pub(super) setpoints: SetpointStream,
}

/// Arms a drive and holds it for as long as the client renews it. Returns whether the
/// connection is still open.
pub(super) async fn hold(client: &mut Client<'_>, request: Arm) -> io::Result<bool> {
    let begun = tokio::select! {
        begun = begin(client.daemon, request) => begun,
        () = hung_up(&mut client.read) => return Ok(false),
    };
    attend(client, begun, false, request.hold).await
}

/// Arms to jog, and passes pulses on for as long as the client gives them. Returns whether the
/// connection is still open.
pub(super) async fn jog(client: &mut Client<'_>) -> io::Result<bool> {
    let begun = begin_jogging(client.daemon);
    attend(client, begun, true, None).await
}

/// A drive that a connection holds.
struct Attended {
    ticket: Ticket,
    /// Whether the client gives pulses in place of a drive.
    jogs: bool,
    /// The longest time between two renewals, if it is shorter than the pilot's.
    hold: Option<Duration>,
}

/// Returns when the client hangs up without having sent more; reads nothing.
pub(super) async fn hung_up(read: &mut BufReader<ReadHalf>) {
    match read.fill_buf().await {
        Ok([]) | Err(_) => {}
        // Its end is found once this has been read.
        Ok(_) => std::future::pending().await,
    }
}

/// Serves the client of a held drive until the drive has ended, or if it has not begun: true. False
/// if the connection ended before.
async fn attend(
    client: &mut Client<'_>,
    begun: Result<(Ticket, DriveWatch), Refused>,
    jogs: bool,
    hold: Option<Duration>,
) -> io::Result<bool> {
    let (ticket, watch) = match begun {
        Ok(begun) => begun,
        Err(refused) => {
            send(&mut client.write, &Answer::refusal(refused)).await?;
            return Ok(true);
        }
    };
    let drive = Attended { ticket, jogs, hold };
    let result = serve_drive(client, &drive, watch).await;
    if !matches!(result, Ok(true)) {
        // The client is gone, and the drive is not over.
        let _ = drive.ticket.push(client.daemon, PilotRequest::OperatorGone);
    }
    result
}

async fn serve_drive(
    client: &mut Client<'_>,
    drive: &Attended,
    mut watch: DriveWatch,
) -> io::Result<bool> {
    let Client {
        read,
        write,
        daemon,
        setpoints,
    } = client;
    let mut line = Vec::new();
    let mut was_driving = false;
    let mut reported = Instant::now();
    let mut renewed: Option<Instant> = None;
    let mut hold = drive.hold;
    let report_interval = drive.hold.map_or(REPORT, |hold| (hold / 3).min(REPORT));
    let begun = Instant::now();
    loop {
        let room = LONGEST_LINE.saturating_sub(line.len() as u64);
        let mut rest = (&mut *read).take(room);
        // What was read of a line stays in `line` if the other branch is first.
        let count = tokio::select! {
            count = rest.read_until(b'\n', &mut line) => count?,
            () = sleep_until(renewed.unwrap_or(begun) + hold.unwrap_or_default()), if hold.is_some() => {
                hold = None;
                // The report of the end follows from the next ticks.
                let _ = drive.ticket.push(daemon, PilotRequest::OperatorGone);
                continue;
            }
            progress = watch.next(daemon) => {
                let tick = match progress {
                    Progress::Arming => continue,
                    Progress::Driving(tick) => tick,
                    Progress::Refused(refused) => {
                        send(write, &Answer::refusal(refused)).await?;
                        return Ok(true);
                    }
                    Progress::Ended(mode, reason) => {
                        send(write, &ended(mode, reason)).await?;
                        return Ok(true);
                    }
                };
                if !was_driving {
                    was_driving = true;
                    let answer = match drive.jogs {
                        true => Answer::done(),
                        false => drive_begun(daemon),
                    };
                    send(write, &answer).await?;
                }
                if reported.elapsed() >= report_interval {
                    reported = Instant::now();
                    send(write, &report(&tick.output)).await?;
                }
                continue;
            }
        };
        if count == 0 {
            return Ok(false);
        }
        if !line.ends_with(b"\n") {
            if line.len() as u64 >= LONGEST_LINE {
                refuse_long_line(read, write).await?;
                line.clear();
            }
            continue;
        }
        let answer = match Command::parse(&line, monotonic_ns()) {
            Ok(Command::Hold) => {
                let is_due = renewed.is_none_or(|renewed| renewed.elapsed() >= LEAST_RENEWAL);
                let pushed = is_due.then(|| {
                    renewed = Some(Instant::now());
                    drive.ticket.push(daemon, PilotRequest::Hold)
                });
                pushed.and_then(Result::err).map(Answer::refusal)
            }
            Ok(Command::Jog(pulses)) if drive.jogs => {
                if drive.ticket.is_latest() {
                    daemon.jogs.send(pulses);
                }
                None
            }
            Ok(Command::Status) => Some(status(daemon)),
            Ok(Command::End(request)) => Some(end(request, daemon)),
            Ok(Command::Tune(tuning)) if !drive.jogs => Some(tune(tuning, daemon).await),
            Ok(Command::Setpoint(setpoint)) if !drive.jogs => setpoints.pass(daemon, &setpoint),
            Ok(_) => {
                let error = if drive.jogs {
                    "this connection jogs: it takes jog, hold, status, disarm and stop"
                } else {
                    "this connection holds a drive: it takes hold, status, disarm, stop, \
                     setpoint and tune"
                };
                Some(Answer::failure(Code::Occupied, error))
            }
            Err(error) => Some(no_command(daemon, &error)),
        };
        if let Some(answer) = answer {
            send(write, &answer).await?;
        }
        line.clear();
        yield_now().await;
    }
}

/// The report of a drive in progress.
fn report(output: &Output) -> Reply {
    Reply::Drive {
        drive: Drive {
            drive_time_s: output.drive_time,
            mode: output.mode.name().into(),
            reason: output.reason.map(|reason| reason.name().into()),
            speed_m_s: output.estimate.map(|estimate| estimate.speed),
        },
        version: SOCKET_VERSION,
    }
}

/// How a drive ended.
fn ended(mode: Mode, reason: Option<Reason>) -> Reply {
    Reply::Ended {
        ended: Ended {
            mode: mode.name().into(),
            reason: reason.map(|reason| reason.name().into()),
        },
        version: SOCKET_VERSION,
    }
}
