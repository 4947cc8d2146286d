//! Runs the targets on random bytes, for a few seconds with every `cargo test`.

use proptest::{collection::vec, prelude::*, test_runner::FileFailurePersistence};

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        failure_persistence: Some(Box::new(FileFailurePersistence::Direct(
            "tests/random.proptest-regressions",
        ))),
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(config(1_000))]

    #[test]
    fn random_bytes_to_the_board_violate_no_invariant(data in vec(any::<u8>(), 0..600)) {
        singletrack_fuzz::board_bytes(&data);
    }

    #[test]
    fn random_bytes_to_the_host_violate_no_invariant(data in vec(any::<u8>(), 0..600)) {
        singletrack_fuzz::host_bytes(&data);
    }

    #[test]
    fn random_datagrams_violate_no_invariant(data in vec(any::<u8>(), 0..600)) {
        singletrack_fuzz::natnet_packets(&data);
    }

    #[test]
    fn random_text_is_a_valid_configuration_or_refused_with_a_message(
        changes: bool,
        mut data in vec(any::<u8>(), 0..40),
    ) {
        data.insert(0, changes.into());
        singletrack_fuzz::configuration(&data);
    }

    #[test]
    fn random_lines_are_commands_or_refused_with_a_message(
        object: bool,
        mut data in vec(any::<u8>(), 0..60),
    ) {
        data.insert(0, object.into());
        singletrack_fuzz::control_line(&data);
    }

    #[test]
    fn random_heads_are_requests_or_refused(
        parts: bool,
        mut data in vec(any::<u8>(), 0..80),
    ) {
        data.insert(0, parts.into());
        singletrack_fuzz::page_head(&data);
    }

    #[test]
    fn random_messages_of_streams_make_no_false_pose(data in vec(any::<u8>(), 0..400)) {
        singletrack_fuzz::stream_messages(&data);
    }
}
