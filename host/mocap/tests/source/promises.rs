//! What every source promises, even of damaged conversations: no panic, and no pose that was not sent.

use singletrack_mocap::{
    Binding, Input, Phase, RestartReason, SessionEvent, Transport,
    planar::{PlanarPose, PoseState},
};

use crate::{
    Bench, LATENCY_MS, MS, config,
    server::{KINDS, Kind, STREAMS, Sent, place},
};

/// The car's pose at its capture, and nobody else's.
#[track_caller]
fn assert_true(pose: &PlanarPose) {
    assert!((pose.y_m - place("car")).abs() < 1e-6, "{pose:?}");
    let off_m = pose.x_m - Bench::x_m(pose.capture_time_ns);
    let bound_m = 0.5e-9 * pose.capture_uncertainty_ns as f64 + 1e-6;
    assert!(
        off_m.abs() <= bound_m,
        "{off_m} m beyond {bound_m} m: {pose:?}"
    );
}

#[test]
fn poses_arrive_with_a_capture_time_whose_error_is_within_its_bound() {
    for kind in KINDS {
        let mut bench = Bench::of(kind, "car");
        bench.run(3_000);
        let poses = bench.poses(0);
        assert!(poses.len() > 280, "{kind:?}: {} poses", poses.len());
        poses.iter().for_each(|(_, pose)| assert_true(pose));
        let (at_ns, last) = poses.last().unwrap();
        let bound_us = last.capture_uncertainty_ns / 1_000;
        match kind {
            // QTM's clock can't be asked: what is assumed of its latency is the bound.
            Kind::Qualisys(_) => assert!((4_000..=4_500).contains(&bound_us), "{bound_us}"),
            Kind::NatNet | Kind::Vrpn => assert!(bound_us < 100, "{kind:?}: {bound_us}"),
        }
        assert!(at_ns - last.capture_time_ns <= (LATENCY_MS + 1) * MS);
    }
}

#[test]
fn a_wrong_name_is_missing_and_the_servers_names_are_known() {
    for kind in KINDS {
        let mut bench = Bench::of(kind, "kart");
        bench.run(2_000);
        assert!(bench.poses(0).is_empty());
        assert_eq!(
            bench.session.tracker().binding,
            Binding::Missing,
            "{kind:?}"
        );
        assert_eq!(
            bench.session.tracker().names.to_string(),
            "\"wand\", \"car\""
        );
        // The operator renames the body.
        bench.server.bodies = vec!["wand", "kart"];
        bench.server.renumber();
        let sent = bench.server.renumber();
        bench.deliver(&sent);
        bench.run(2_000);
        assert!(
            matches!(bench.session.tracker().binding, Binding::Bound { .. }),
            "{kind:?}"
        );
    }
}

#[test]
fn a_name_that_is_not_utf_8_hides_no_other_body_and_is_shown() {
    for kind in KINDS {
        let mut bench = Bench::of(kind, "car");
        bench.server.bodies = vec!["t@r", "car"];
        bench.run(2_000);
        let poses = bench.poses(0);
        assert!(poses.len() > 150, "{kind:?}: {} poses", poses.len());
        poses.iter().for_each(|(_, pose)| assert_true(pose));
        let names = bench.session.tracker().names.to_string();
        assert_eq!(names, r#""t\xfcr", "car""#, "{kind:?}");
        // One that appears later ends no drive.
        bench.server.bodies.push("a t@r");
        let sent = bench.server.renumber();
        bench.deliver(&sent);
        bench.run(3_000);
        let before = bench.observations.len();
        bench.run(1_000);
        assert!(bench.poses(before).len() > 90, "{kind:?}");
    }
}

#[test]
fn a_body_that_is_not_seen_has_no_pose() {
    for (kind, zeros) in KINDS
        .map(|kind| (kind, false))
        .into_iter()
        .chain([(Kind::Vrpn, true)])
    {
        let mut bench = Bench::of(kind, "car");
        bench.server.zeros = zeros;
        bench.run(1_000);
        let before = bench.observations.len();
        assert!(before > 50);
        bench.server.unseen = vec!["car"];
        bench.run(400);
        assert!(bench.poses(before).is_empty(), "{kind:?}");
        let state = bench.session.pose_state(bench.now_ns);
        let is_known = match (kind, zeros) {
            (Kind::Vrpn, false) => matches!(state, PoseState::Stale { .. }),
            _ => state == PoseState::Untracked,
        };
        assert!(is_known, "{kind:?}: {state:?}");
        bench.server.unseen.clear();
        bench.run(100);
        assert!(bench.poses(before).len() > 5, "{kind:?}");
        assert_eq!(bench.session.counters().session.restarts, 0, "{kind:?}");
    }
}

#[test]
fn a_server_that_restarts_with_another_clock_is_followed_again() {
    for kind in KINDS {
        for offset_us in [1, 900_000_000_000, 1_800_000_000_000_000] {
            let mut bench = Bench::of(kind, "car");
            bench.run(1_500);
            bench.break_down();
            bench.run(3_000);
            let before = bench.observations.len();
            bench.is_down = false;
            bench.server.offset_us = offset_us;
            bench.run(4_000);
            let poses = bench.poses(before);
            assert!(poses.len() > 100, "{kind:?} {offset_us}: {}", poses.len());
            poses.iter().for_each(|(_, pose)| assert_true(pose));
        }
    }
}

#[test]
fn stamps_that_jump_give_no_wrong_capture_time_and_the_server_is_followed_again() {
    for kind in KINDS {
        for jump_us in [-3_600_000_000_i64, -50_000, 50_000, 3_600_000_000] {
            let mut bench = Bench::of(kind, "car");
            bench.run(2_000);
            let before = bench.observations.len();
            bench.server.offset_us = bench.server.offset_us.saturating_add_signed(jump_us);
            bench.run(6_000);
            let poses = bench.poses(before);
            assert!(poses.len() > 200, "{kind:?} {jump_us}: {}", poses.len());
            // Until it is noticed, a small jump is wrong by itself at most.
            for (at_ns, pose) in &poses {
                let age_ms = (at_ns - pose.capture_time_ns) / MS;
                assert!(age_ms <= 120, "{kind:?} {jump_us}: {age_ms} ms");
            }
            let settled = poses.iter().rev().take(50);
            settled.for_each(|(_, pose)| assert_true(pose));
        }
    }
}

#[test]
fn bodies_that_change_their_numbers_are_not_taken_for_the_car() {
    for kind in KINDS {
        let mut bench = Bench::of(kind, "car");
        bench.run(1_000);
        for _ in 0..3 {
            let before = bench.observations.len();
            let sent = bench.server.renumber();
            bench.deliver(&sent);
            bench.run(1_000);
            let poses = bench.poses(before);
            assert!(poses.len() > 40, "{kind:?}: {}", poses.len());
            poses.iter().for_each(|(_, pose)| assert_true(pose));
        }
    }
}

#[test]
fn what_is_no_pose_is_passed_over() {
    for kind in KINDS {
        let mut bench = Bench::of(kind, "car");
        bench.run(1_000);
        let before = bench.observations.len();
        for _ in 0..50 {
            let chatter = bench.server.chatter(bench.now_us());
            bench.deliver(&chatter);
            bench.run(10);
        }
        assert!(bench.poses(before).len() >= 48, "{kind:?}");
        assert_eq!(bench.session.counters().session.restarts, 0, "{kind:?}");
    }
}

#[test]
fn a_stream_that_stops_is_stale_and_the_session_connects_again() {
    for kind in KINDS {
        let mut bench = Bench::of(kind, "car");
        bench.run(1_000);
        // In the middle of a message.
        let whole = bench.server.frame(bench.now_us(), 0.0);
        let cut = [&whole.stream[..], &whole.datagrams.concat()].concat();
        if kind != Kind::NatNet {
            bench.deliver_stream(&cut[..cut.len() / 2]);
        }
        bench.is_down = true;
        bench.run(150);
        assert!(
            matches!(
                bench.session.pose_state(bench.now_ns),
                PoseState::Stale { .. }
            ),
            "{kind:?}"
        );
        assert!(bench.events.contains(&SessionEvent::Stale));
        bench.run(4_000);
        bench.is_down = false;
        let before = bench.observations.len();
        bench.run(4_000);
        assert!(bench.poses(before).len() > 100, "{kind:?}");
    }
}

#[test]
fn where_no_datagram_arrives_the_frames_come_over_the_stream_and_that_is_said() {
    for kind in STREAMS {
        let mut bench = Bench::of(kind, "car");
        bench.blocks_udp = true;
        bench.run(4_000);
        let poses = bench.poses(0);
        assert!(poses.len() > 150, "{kind:?}: {}", poses.len());
        poses.iter().for_each(|(_, pose)| assert_true(pose));
        let told = |event| bench.events.iter().filter(|said| **said == event).count();
        assert_eq!(told(SessionEvent::DatagramsBlocked), 1, "{kind:?}");
        let why = SessionEvent::Restarted(RestartReason::NoDatagrams);
        assert_eq!(told(why), 1, "{kind:?}");
        assert_eq!(bench.session.counters().session.restarts, 1, "{kind:?}");
    }
}

#[test]
fn frames_that_are_wanted_over_the_stream_come_at_once() {
    for kind in STREAMS {
        let mut bench = Bench::with(config(kind, "car", Transport::Stream), kind);
        bench.blocks_udp = true;
        bench.run(1_000);
        assert!(bench.poses(0).len() > 80, "{kind:?}");
        assert!(!bench.events.contains(&SessionEvent::DatagramsBlocked));
    }
}

#[test]
fn another_program_at_the_port_is_named_once_and_never_believed() {
    let answers = [
        "HTTP/1.1 400 Bad Request\r\n\r\n",
        "vrpn: ver. 06.12  0\0\0\0\0\0",
        "\0\0\0\0\0\0\0\0\0\0",
        // It waits for the client to say something that it knows.
        "",
    ];
    for kind in STREAMS {
        for answer in answers {
            let mut bench = Bench::of(kind, "car");
            bench.impostor = Some(answer);
            bench.run(6_000);
            let is_foreign = |event: &&SessionEvent| **event == SessionEvent::Foreign;
            let times = bench.events.iter().filter(is_foreign).count();
            assert_eq!(times, 1, "{kind:?} {answer:?}: {:?}", bench.events);
            assert_eq!(bench.session.source().phase(), Phase::Foreign);
            assert!(bench.observations.is_empty());
            // Tried again all the time, in case the right one starts.
            bench.impostor = None;
            bench.run(4_000);
            assert!(bench.poses(0).len() > 50, "{kind:?}");
        }
    }
}

#[test]
fn a_second_sender_with_the_servers_address_is_not_believed() {
    for kind in STREAMS {
        let mut bench = Bench::of(kind, "car");
        bench.run(1_000);
        let before = bench.poses(0).len();
        let mut forger = bench.server.clone();
        for _ in 0..20 {
            let forged = forger.frame(bench.now_us(), 50.0);
            for bytes in &forged.datagrams {
                let source = std::net::SocketAddr::new(crate::SERVER, 9_999);
                bench.input(Input::Datagram { source, bytes });
            }
            bench.run(10);
        }
        let poses = bench.poses(0);
        assert_eq!(poses.len(), before + 20, "{kind:?}");
        poses.iter().for_each(|(_, pose)| assert_true(pose));
        assert_eq!(bench.session.counters().session.wrong_source, 20);
    }
}

#[test]
fn a_closed_session_wants_nothing() {
    for kind in KINDS {
        let mut bench = Bench::of(kind, "car");
        bench.run(1_000);
        bench.session.close();
        let _ = bench.session.poll_transmit(bench.now_ns);
        let _ = bench.session.poll_transmit(bench.now_ns);
        assert_eq!(bench.session.poll_timeout(), None, "{kind:?}");
        assert_eq!(bench.session.stream(), None, "{kind:?}");
    }
}

#[test]
fn a_delay_that_is_added_shows_as_age() {
    for kind in KINDS {
        let mut bench = Bench::of(kind, "car");
        bench.run(2_000);
        bench.delay_ms = 150;
        bench.run(4_000);
        let poses = bench.poses(0);
        let (at_ns, last) = poses.last().unwrap();
        let age_ms = (at_ns - last.capture_time_ns) / MS;
        assert!((148..=160).contains(&age_ms), "{kind:?}: {age_ms} ms");
    }
}

#[test]
fn a_server_that_ignores_some_pings_is_asked_again() {
    let mut bench = Bench::of(Kind::Vrpn, "car");
    bench.server.ignored_pings = 2;
    bench.run(4_000);
    let (_, last) = *bench.poses(0).last().unwrap();
    assert!(last.capture_uncertainty_ns < MS, "{last:?}");
    assert_true(&last);
}

#[test]
fn a_car_that_appears_later_is_no_closed_firewall() {
    for kind in STREAMS {
        let mut bench = Bench::of(kind, "car");
        bench.server.unseen = vec!["car"];
        bench.run(6_000);
        bench.server.unseen.clear();
        bench.run(1_000);
        assert!(bench.poses(0).len() > 50, "{kind:?}");
        assert_eq!(bench.session.counters().session.restarts, 0, "{kind:?}");
        // Nor is a floor where nobody was seen for long.
        let mut bench = Bench::of(kind, "car");
        bench.is_paused = true;
        bench.run(6_000);
        bench.is_paused = false;
        bench.run(1_000);
        assert!(bench.poses(0).len() > 50, "{kind:?}");
        assert!(!bench.events.contains(&SessionEvent::DatagramsBlocked));
    }
}

#[test]
fn datagrams_that_stop_later_are_replaced_by_the_stream() {
    for kind in STREAMS {
        let mut bench = Bench::of(kind, "car");
        bench.run(3_000);
        bench.blocks_udp = true;
        let before = bench.observations.len();
        bench.run(4_000);
        assert!(bench.poses(before).len() > 100, "{kind:?}");
        assert!(
            bench.events.contains(&SessionEvent::DatagramsBlocked),
            "{kind:?}"
        );
    }
}

#[test]
fn strangers_are_named_once_each_and_four_at_most() {
    for kind in STREAMS {
        let mut bench = Bench::of(kind, "car");
        bench.run(1_000);
        let before = bench.events.len();
        for turn in 0..40 {
            let source = std::net::SocketAddr::from(([10, 0, 0, turn % 8], 1_000));
            bench.input(Input::Datagram {
                source,
                bytes: &[0; 64],
            });
        }
        assert_eq!(bench.events.len() - before, 4, "{kind:?}");
    }
}

#[test]
fn names_come_on_the_stream_alone() {
    for kind in STREAMS {
        let mut bench = Bench::of(kind, "car");
        bench.run(1_000);
        let bound = bench.session.tracker().binding;
        let renamed = bench.server.renumber();
        let answer = bench.server.chatter(bench.now_us());
        for bytes in [renamed.stream, answer.stream] {
            let source = std::net::SocketAddr::new(crate::SERVER, 1_510);
            bench.input(Input::Datagram {
                source,
                bytes: &bytes,
            });
        }
        assert_eq!(bench.session.tracker().binding, bound, "{kind:?}");
    }
}

#[test]
fn a_list_that_does_not_fit_the_frames_binds_nothing_and_is_asked_for_twice_a_second() {
    for kind in STREAMS.into_iter().skip(1) {
        let mut bench = Bench::of(kind, "car");
        bench.server.lists_more = true;
        bench.run(5_000);
        assert!(
            bench.poses(0).len() <= 1,
            "{kind:?}: {}",
            bench.poses(0).len()
        );
        assert!(bench.bindings.len() <= 3, "{:?}", bench.bindings);
        assert!(bench.server.questions <= 12, "{}", bench.server.questions);
        bench.server.lists_more = false;
        bench.run(1_500);
        assert!(bench.poses(0).len() > 50, "{kind:?}");
    }
}

#[test]
fn a_strangers_text_with_the_servers_address_does_not_keep_its_frames_out() {
    let mut bench = Bench::of(Kind::Vrpn, "car");
    bench.is_paused = true;
    bench.run(60);
    // Before the first frame of the server.
    let text = bench.server.chatter(bench.now_us()).stream;
    bench.input(Input::Datagram {
        source: std::net::SocketAddr::new(crate::SERVER, 9_999),
        bytes: &text,
    });
    bench.is_paused = false;
    bench.run(500);
    assert!(bench.poses(0).len() > 40, "{}", bench.poses(0).len());
}

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
