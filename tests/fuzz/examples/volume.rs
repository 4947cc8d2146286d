//! Millions of hostile packets and bytes through the sessions, without a panic or
//! growing memory.
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

/// Number of random bytes per run of a target.
const CHUNK: usize = 4_096;

/// Send random packets and bytes to the sessions, and measure time and memory.
/// Fails if memory grows; a violated invariant is a panic.
#[derive(Parser)]
struct Arguments {
    /// Number of datagrams to the motion capture session.
    #[arg(long, default_value_t = 10_000_000)]
    packets: u64,
    /// Number of bytes over the serial line, in each direction.
    #[arg(long, default_value_t = 10_000_000)]
    bytes: u64,
    /// Seed of the random numbers.
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
    for (name, amount, unit) in [
        ("natnet_packets", packets, "packets"),
        ("board_bytes", bytes, "bytes"),
        ("host_bytes", bytes, "bytes"),
    ] {
        let target = TARGETS
            .into_iter()
            .find(|target| target.name == name)
            .ok_or("unknown target")?;
        grown += run_target(&target, amount, unit, seed)?;
    }
    if grown > 0 {
        return Err(format!("memory has grown by {grown} pages").into());
    }
    Ok(())
}

/// Sends an amount of input to a target; returns by how many pages the peak memory
/// of the second half exceeds that of the first. The first half covers initial
/// allocations, so that the difference shows leaks.
fn run_target(target: &Target, amount: u64, unit: &str, seed: u64) -> Result<u64, Box<dyn Error>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut chunk = vec![0; CHUNK];
    let mut done = 0;
    let mut percent = 0;
    let mut most = [0; 2];
    let began = Instant::now();
    while done < amount {
        random.fill_bytes(&mut chunk);
        done += (target.run)(&chunk);
        let now = (done * 100 / amount).min(100);
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

/// Resident pages that belong to this process alone: code loaded on its first use
/// does not count as growth.
fn own_pages() -> Result<u64, Box<dyn Error>> {
    let statm = fs::read_to_string("/proc/self/statm")?;
    let mut fields = statm.split_whitespace().skip(1).map(str::parse::<u64>);
    let (Some(resident), Some(shared)) = (fields.next(), fields.next()) else {
        return Err("/proc/self/statm is short".into());
    };
    Ok(resident? - shared?)
}
