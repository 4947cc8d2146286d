//! libFuzzer program of `singletrack_fuzz::host_bytes`.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    singletrack_fuzz::host_bytes(data);
});
