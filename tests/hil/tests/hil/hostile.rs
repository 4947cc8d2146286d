//! Datagrams from other hosts.

use std::{
    collections::HashSet,
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
    thread,
    time::{Duration, Instant},
};

use singletrack_hil::{Failure, Outcome, bench::Bench, ensure};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[Scenario::new(
    "a_flood_of_foreign_datagrams_does_not_affect_driving",
    flooded,
)
.alone()];

/// Duration and rate of the flood.
const FLOOD: Duration = Duration::from_secs(5);
const PER_MILLISECOND: u32 = 20;

/// An address of this machine other than the cameras'.
const STRANGER: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 2);

/// Limit for the 99th percentile of the lateness; the processors are shared.
const LATENESS_LIMIT_US: f64 = 5_000.0;

fn flooded(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    let ports = udp_ports(bench.daemon()?.id())?;
    ensure!(!ports.is_empty(), "the daemon has no UDP socket");
    let stranger = UdpSocket::bind((STRANGER, 0)).map_err(Failure::system("no socket"))?;
    stranger
        .set_nonblocking(true)
        .map_err(Failure::system("no socket that does not wait"))?;
    let before = bench.status()?.figure("/mocap/wrong_source")?;

    let (done, sent) = (AtomicBool::new(false), AtomicU64::new(0));
    thread::scope(|scope| {
        let flood = scope.spawn(|| {
            let mut next = Instant::now();
            let mut number = 0_u32;
            while !done.load(Ordering::Relaxed) {
                for _ in 0..PER_MILLISECOND {
                    number = number.wrapping_add(1);
                    let datagram = frame_of(number);
                    for port in &ports {
                        let to = SocketAddr::from((Ipv4Addr::LOCALHOST, *port));
                        // Only datagrams that were accepted count.
                        if stranger.send_to(&datagram, to).is_ok() {
                            sent.fetch_add(1, Ordering::Relaxed);
                        }
                    }
                }
                next += Duration::from_millis(1);
                thread::sleep(next.saturating_duration_since(Instant::now()));
            }
        });
        let driven = bench.keep_driving(FLOOD);
        done.store(true, Ordering::Relaxed);
        let ended = flood.join();
        driven?;
        ended.map_err(|_| Failure::new("the flood has panicked"))
    })?;

    let status = bench.status()?;
    let foreign = status.figure("/mocap/wrong_source")? - before;
    let sent = sent.load(Ordering::Relaxed) as f64;
    ensure!(
        sent > 1_000.0 && foreign > 0.5 * sent,
        "{foreign} of {sent} datagrams were counted as from a wrong source"
    );
    bench.at_most(
        "99th percentile of the ticks' lateness",
        status.figure("/lateness_us/p99")?,
        LATENESS_LIMIT_US,
        "us",
    )?;
    // Poses of the cameras are still received and used.
    bench.keep_driving(Duration::from_secs(1))?;
    bench.was_within_limits(&bench.rig().trace()?)
}

/// The start of a frame of mocap data, with a number, followed by invalid bytes.
fn frame_of(number: u32) -> Vec<u8> {
    const FRAME_OF_DATA: [u8; 2] = [7, 0];
    let mut datagram = Vec::with_capacity(64);
    datagram.extend(FRAME_OF_DATA);
    datagram.extend([60, 0]);
    datagram.extend(number.to_le_bytes());
    datagram.extend((0..56_u32).map(|index| (number.wrapping_mul(index + 1) >> 8) as u8));
    datagram
}

/// The UDP ports of a process.
fn udp_ports(process: u32) -> Outcome<Vec<u16>> {
    let folder = format!("/proc/{process}/fd");
    let inodes: HashSet<String> = std::fs::read_dir(&folder)
        .map_err(Failure::system(format!("can't read {folder}")))?
        .flatten()
        .filter_map(|entry| {
            let target = std::fs::read_link(entry.path()).ok()?;
            let inode = target.to_str()?.strip_prefix("socket:[")?;
            Some(inode.strip_suffix(']')?.to_owned())
        })
        .collect();
    let table = format!("/proc/{process}/net/udp");
    let text =
        std::fs::read_to_string(&table).map_err(Failure::system(format!("can't read {table}")))?;
    // sl local_address rem_address st queues tr tm->when retrnsmt uid timeout inode
    Ok(text
        .lines()
        .filter_map(|line| {
            let words: Vec<_> = line.split_whitespace().collect();
            let inode = words.get(9)?;
            let (_, port) = words.get(1)?.split_once(':')?;
            inodes
                .contains(*inode)
                .then(|| u16::from_str_radix(port, 16).ok())?
        })
        .collect())
}
