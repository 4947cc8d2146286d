//! libFuzzer program of `singletrack_fuzz::stream_messages`.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    singletrack_fuzz::stream_messages(data);
});
