//! The targets on random bytes, for a few seconds with every `cargo test`.

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
    fn any_bytes_to_the_board_keep_its_promises(data in vec(any::<u8>(), 0..600)) {
        singletrack_fuzz::board_bytes(&data);
    }

    #[test]
    fn any_bytes_to_the_host_keep_its_promises(data in vec(any::<u8>(), 0..600)) {
        singletrack_fuzz::host_bytes(&data);
    }

    #[test]
    fn any_packets_of_the_cameras_keep_the_clients_promises(data in vec(any::<u8>(), 0..600)) {
        singletrack_fuzz::natnet_packets(&data);
    }

    #[test]
    fn any_text_is_a_good_configuration_or_is_refused_with_a_word(
        changes: bool,
        mut data in vec(any::<u8>(), 0..40),
    ) {
        data.insert(0, changes.into());
        singletrack_fuzz::configuration(&data);
    }

    #[test]
    fn any_line_of_a_client_is_a_command_or_is_refused_with_a_word(
        object: bool,
        mut data in vec(any::<u8>(), 0..60),
    ) {
        data.insert(0, object.into());
        singletrack_fuzz::control_line(&data);
    }
}
