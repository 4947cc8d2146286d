//! Random input from outside does not stop the simulator.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::net::SocketAddr;

use proptest::{collection::vec, prelude::*};
use singletrack_sim::{LossPattern, SimulationConfig, World, parse_duration_us};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_bytes_on_the_serial_line_disturb_the_world(
        writes in vec((0_u64..5_000, vec(any::<u8>(), 0..100)), 0..20),
    ) {
        let mut world = World::new(SimulationConfig::default()).unwrap();
        for (later_us, bytes) in writes {
            world.advance_to(world.now_us() + later_us);
            world.host_write(&bytes);
        }
        let end = world.now_us() + 500_000;
        world.advance_to(end);
        prop_assert_eq!(world.now_us(), end);
        prop_assert_eq!(world.truth().wheel_speed, 0.0);
        // Telemetry continues.
        let mut received = Vec::new();
        world.host_read(&mut received);
        prop_assert!(received.len() > 1_000);
    }

    #[test]
    fn no_datagram_disturbs_the_server(datagrams in vec(vec(any::<u8>(), 0..400), 0..20)) {
        let mut world = World::new(SimulationConfig::default()).unwrap();
        let from: SocketAddr = ([127, 0, 0, 1], 4000).into();
        for datagram in &datagrams {
            world.handle_datagram(from, datagram);
        }
        world.advance_to(100_000);
        let counters = world.natnet().counters();
        prop_assert_eq!(counters.requests + counters.malformed, datagrams.len() as u64);
        prop_assert_eq!(counters.unencodable, 0);
    }

    #[test]
    fn loss_patterns_round_trip_through_text(
        (duration, interval) in (1_u64..10_000_000).prop_flat_map(|d| (Just(d), d + 1..20_000_000)),
    ) {
        let pattern = LossPattern::new(duration, interval).unwrap();
        prop_assert_eq!(pattern.to_string().parse::<LossPattern>(), Ok(pattern));
    }

    #[test]
    fn no_text_makes_a_duration_panic(text in "\\PC{0,12}") {
        let _ = parse_duration_us(&text);
        let _ = text.parse::<LossPattern>();
    }
}
