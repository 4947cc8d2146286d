//! Damaged conversations: no panic, and no pose that was not sent.

use crate::{
    bench::Bench,
    server::{KINDS, Kind, Sent},
};
use singletrack_mocap::planar::PoseState;

/// xorshift64*.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) as usize % bound.max(1)
    }
}

/// Flips bits, cuts, doubles, inserts or moves bytes.
fn damage(random: &mut Random, bytes: &mut Vec<u8>) {
    if bytes.is_empty() {
        return;
    }
    for _ in 0..=random.below(3) {
        let at = random.below(bytes.len());
        match random.below(6) {
            0 => bytes[at] ^= 1 << random.below(8),
            1 => bytes[at] = [0, 0xff, 0x7f, 0x80][random.below(4)],
            2 => bytes.truncate(at.max(1)),
            3 => bytes.insert(at, random.below(256) as u8),
            4 => {
                let tail = bytes[at..].to_vec();
                bytes.extend(tail);
            }
            _ => bytes.rotate_left(at),
        }
    }
}

/// Damaged packets a kind of server.
const PACKETS: usize = 20_000;

#[test]
fn damaged_packets_cause_no_panic_and_no_pose_that_is_none() {
    for (kind, seed) in KINDS.into_iter().zip(1_u64..) {
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let (mut packets, mut poses) = (0, 0);
        while packets < PACKETS {
            let mut bench = Bench::of(kind, "car");
            // Through TCP, bytes are not damaged by a network but by a wrong server.
            bench.run(random.below(400) as u64);
            for _ in 0..40 {
                let now_us = bench.now_us();
                let mut sent = match random.below(4) {
                    0 => bench.server.chatter(now_us),
                    1 => bench.server.renumber(),
                    _ => bench.server.frame(now_us, Bench::x_m(bench.now_ns)),
                };
                sent.datagrams
                    .iter_mut()
                    .for_each(|bytes| damage(&mut random, bytes));
                damage(&mut random, &mut sent.stream);
                if kind != Kind::NatNet && random.below(2) == 0 {
                    let datagrams = sent.datagrams.concat();
                    sent = Sent {
                        stream: datagrams,
                        datagrams: vec![sent.stream],
                    };
                }
                bench.deliver(&sent);
                packets += 1;
                bench.run(random.below(30) as u64);
            }
            for (at_ns, observation) in &bench.observations {
                let PoseState::Valid(pose) = observation.state else {
                    continue;
                };
                poses += 1;
                let numbers = [pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad, pose.tilt_rad];
                assert!(numbers.iter().all(|number| number.is_finite()), "{pose:?}");
                assert!(pose.capture_time_ns <= *at_ns, "{pose:?}");
                assert!(pose.tilt_rad <= 0.5, "{pose:?}");
            }
        }
        assert!(poses > 1_000, "{kind:?}: {poses}");
    }
}
