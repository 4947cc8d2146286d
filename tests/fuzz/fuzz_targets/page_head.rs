//! libFuzzer program of `singletrack_fuzz::page_head`.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    singletrack_fuzz::page_head(data);
});
