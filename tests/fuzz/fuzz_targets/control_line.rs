//! libFuzzer program of `singletrack_fuzz::control_line`.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    singletrack_fuzz::control_line(data);
});
