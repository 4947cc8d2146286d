//! When somebody else sends to the daemon.

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
    "a_flood_of_foreign_datagrams_changes_nothing_about_the_drive",
    flooded,
)
.alone()];

/// For so long, and so many each millisecond.
const FLOOD: Duration = Duration::from_secs(5);
const PER_MILLISECOND: u32 = 20;

/// An address of this machine that is not the cameras'.
const STRANGER: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 2);

/// A tick in a hundred may be later than this: others use the processors.
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
                        // What finds no room is no flood that got through.
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
        "{foreign} of {sent} datagrams were counted as a stranger's"
    );
    bench.at_most(
        "lateness of a tick in a hundred",
        status.figure("/lateness_us/p99")?,
        LATENESS_LIMIT_US,
        "us",
    )?;
    // The cameras are still heard, and it is still them that it believes.
    bench.keep_driving(Duration::from_secs(1))?;
    bench.was_within_limits(&bench.rig().trace()?)
}

/// The begin of a frame of mocap data, with a number; then nothing that fits.
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
        .map_err(Failure::system(format!("cannot read {folder}")))?
        .flatten()
        .filter_map(|entry| {
            let target = std::fs::read_link(entry.path()).ok()?;
            let inode = target.to_str()?.strip_prefix("socket:[")?;
            Some(inode.strip_suffix(']')?.to_owned())
        })
        .collect();
    let table = format!("/proc/{process}/net/udp");
    let text =
        std::fs::read_to_string(&table).map_err(Failure::system(format!("cannot read {table}")))?;
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
