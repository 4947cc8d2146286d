//! Nothing happens before the deadline.

use proptest::prelude::*;
use singletrack_mocap::Transport;

use crate::world::{Frame, MS, UNICAST, World, config, jitter};

/// Asserts that the session does nothing by itself from now to its deadline.
#[track_caller]
fn assert_idle_until_deadline(world: &World, part_way: f64) {
    let deadline_ns = world.session.poll_timeout();
    let last_ns = deadline_ns.map_or(u64::MAX, |deadline_ns| deadline_ns - 1);
    let wait_ns = last_ns.checked_sub(world.now_ns).unwrap();
    for at_ns in [
        world.now_ns,
        world.now_ns + (wait_ns as f64 * part_way) as u64,
        last_ns,
    ] {
        let mut session = world.session.clone();
        session.handle_timeout(at_ns, &mut |event| {
            panic!("{event:?} at {at_ns}, due at {deadline_ns:?}");
        });
        assert_eq!(session.poll_transmit(at_ns), None, "due at {deadline_ns:?}");
        assert_eq!(format!("{session:?}"), format!("{:?}", world.session));
    }
}

proptest! {
    #[test]
    fn before_its_deadline_a_session_does_nothing(
        options in any::<[bool; 4]>(),
        native in prop::sample::select(vec![[2, 5], [2, 9], [3, 0], [4, 1], [4, 3], [4, 5]]),
        bitstream_status in prop::sample::select(vec![Some(0), Some(1), None]),
        loses_one_in in prop::sample::select(vec![1_u64, 2, 1_000]),
        seed: u64,
        steps in prop::collection::vec((0..8_u8, 0..400_u64, 0.0..1.0_f64), 1..40),
    ) {
        let [multicast, binds, echoes, answers] = options;
        let mut world = World::new(config(if multicast { Transport::Multicast } else { UNICAST }));
        world.server.native = native;
        world.server.bitstream_status = bitstream_status;
        world.server.answers_echo = echoes;
        world.server.answers = answers;
        if !binds {
            world.server.models.clear();
        }
        let mut random = jitter(seed);
        world.network = Box::new(move |_| (random(loses_one_in) != 0).then_some(100_000));
        let mut number = 0;
        for (operation, span_ms, part_way) in steps {
            match operation {
                0 => world.server.answers = !world.server.answers,
                1 => world.session.close(),
                _ => {
                    number += 1;
                    world.frame(&Frame::at_rest(number));
                }
            }
            world.run(span_ms * MS);
            assert_idle_until_deadline(&world, part_way);
        }
    }
}
