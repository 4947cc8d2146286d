//! Millions of hostile packets and bytes through the sessions: no panic, and no
//! memory that grows.
//!
//! ```text
//! cargo run --release -p singletrack-fuzz --example volume
//! ```

use std::{
    error::Error,
    fs,
    io::{self, Write as _},
    time::Instant,
};

use clap::Parser;
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use singletrack_fuzz::{TARGETS, Target};

/// Random bytes to begin a conversation from, each time.
const CHUNK: usize = 4_096;

/// Pushes random packets and bytes through the sessions, and measures time and
/// memory. Ends with an error when memory grows; a broken promise is a panic.
#[derive(Parser)]
struct Arguments {
    /// Datagrams to the motion capture session.
    #[arg(long, default_value_t = 10_000_000)]
    packets: u64,
    /// Bytes over the serial line, each way.
    #[arg(long, default_value_t = 10_000_000)]
    bytes: u64,
    /// Seeds the random numbers.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let Arguments {
        packets,
        bytes,
        seed,
    } = Arguments::parse();
    let mut grown = 0;
    for (name, wanted, unit) in [
        ("natnet_packets", packets, "packets"),
        ("board_bytes", bytes, "bytes"),
        ("host_bytes", bytes, "bytes"),
    ] {
        let target = TARGETS
            .into_iter()
            .find(|target| target.name == name)
            .ok_or("no such target")?;
        grown += push(&target, wanted, unit, seed)?;
    }
    if grown > 0 {
        return Err(format!("memory has grown by {grown} pages").into());
    }
    Ok(())
}

/// Pushes so much through a target; returns by how many pages the most memory of
/// the second half exceeds that of the first. What is used once, and how the
/// allocator places it, is over by then; what leaks is not.
fn push(target: &Target, wanted: u64, unit: &str, seed: u64) -> Result<u64, Box<dyn Error>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut chunk = vec![0; CHUNK];
    let mut done = 0;
    let mut percent = 0;
    let mut most = [0; 2];
    let began = Instant::now();
    while done < wanted {
        random.fill_bytes(&mut chunk);
        done += (target.run)(&chunk);
        let now = (done * 100 / wanted).min(100);
        if now > percent {
            percent = now;
            eprint!("\r{}: {percent} %", target.name);
            io::stderr().flush()?;
            let pages = own_pages()?;
            let [first, second] = &mut most;
            let half = if percent <= 50 { first } else { second };
            *half = pages.max(*half);
        }
    }
    eprintln!();
    let seconds = began.elapsed().as_secs_f64();
    let [first, second] = most;
    let grown = second.saturating_sub(first);
    println!(
        "{}: {done} {unit} in {seconds:.1} s ({:.0} a second), 0 panics, at most {first} pages in the first \
         half, {second} in the second: grown by {grown}",
        target.name,
        done as f64 / seconds,
    );
    Ok(grown)
}

/// Pages of this process in memory that are its own: code that is read from its
/// file when it is first run is no growth.
fn own_pages() -> Result<u64, Box<dyn Error>> {
    let statm = fs::read_to_string("/proc/self/statm")?;
    let mut fields = statm.split_whitespace().skip(1).map(str::parse::<u64>);
    let (Some(resident), Some(shared)) = (fields.next(), fields.next()) else {
        return Err("/proc/self/statm is short".into());
    };
    Ok(resident? - shared?)
}
