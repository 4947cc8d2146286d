//! libFuzzer program of `singletrack_fuzz::natnet_packets`.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    singletrack_fuzz::natnet_packets(data);
});
