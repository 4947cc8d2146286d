//! libFuzzer program of `singletrack_fuzz::configuration`.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    singletrack_fuzz::configuration(data);
});
