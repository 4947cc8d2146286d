//! Checks of the image: forbidden symbols and size.

use std::{path::Path, process::Command};

use crate::process::{Failure, output};

/// Size of the image, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Size {
    /// Program, constants and initial values of variables.
    pub(crate) flash: u32,
    /// Static variables and constants. AVR programs have their constants in SRAM
    /// too.
    pub(crate) static_sram: u32,
}

/// Refuses symbols that are known to fail on an AVR.
pub(crate) fn refuse_forbidden(elf: &Path) -> Result<(), Failure> {
    let symbols = output(Command::new("avr-nm").arg(elf))?;
    forbidden(&String::from_utf8_lossy(&symbols))
        .map_err(|why| Failure::new(format!("{}: {why}", elf.display())))
}

fn forbidden(symbols: &str) -> Result<(), String> {
    let names = || {
        symbols
            .lines()
            .filter_map(|line| line.split_whitespace().last())
    };
    if !names().any(|name| name.starts_with("__vector_")) {
        return Err("no interrupt among its symbols, so it can't be checked".into());
    }
    if let Some(name) = names().find(|name| ["__mulosi4", "__mulodi4", "__muloti4"].contains(name))
    {
        return Err(format!(
            "it contains {name}, which is miscompiled on AVR: the caller has 2 bytes on its stack \
             for the overflow, the function writes 4. The image must not use checked_mul, \
             overflowing_mul or saturating_mul of i32 and wider, nor overflow checks: bound the \
             factors, or multiply in a wider type"
        ));
    }
    // The mangled path of core::fmt, and of its traits in implementations.
    if let Some(name) =
        names().find(|name| name.contains("4core3fmt") || name.contains("core..fmt.."))
    {
        return Err(format!(
            "it contains {name}: formatting takes 3 to 7 KB of flash, and the text is never shown. \
             Look for a derived Debug, unwrap, expect or an index that can panic"
        ));
    }
    Ok(())
}

/// Measures the size of the image.
pub(crate) fn size(elf: &Path) -> Result<Size, Failure> {
    let sections = output(Command::new("avr-size").arg("-A").arg(elf))?;
    size_of(&String::from_utf8_lossy(&sections)).ok_or_else(|| {
        Failure::new(format!(
            "{}: avr-size finds no section .text",
            elf.display()
        ))
    })
}

fn size_of(sections: &str) -> Option<Size> {
    let mut size = Size::default();
    for line in sections.lines() {
        let mut words = line.split_whitespace();
        let (Some(name), Some(Ok(bytes))) = (words.next(), words.next().map(str::parse::<u32>))
        else {
            continue;
        };
        match name {
            ".text" => size.flash += bytes,
            ".data" | ".rodata" => {
                size.flash += bytes;
                size.static_sram += bytes;
            }
            ".bss" | ".noinit" => size.static_sram += bytes,
            _ => {}
        }
    }
    (size.flash > 0).then_some(size)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECTIONS: &str = "\
uno.elf  :
section                     size      addr
.data                         62   8388864
.text                       6450         0
.bss                         220   8388926
.noinit                        7   8389146
.comment                      17         0
.note.gnu.avr.deviceinfo      64         0
.debug_info                 1500         0
Total                       8320
";

    #[test]
    fn initial_values_count_in_flash_and_in_sram() {
        assert_eq!(
            size_of(SECTIONS),
            Some(Size {
                flash: 6_512,
                static_sram: 289
            })
        );
    }

    #[test]
    fn a_file_without_a_program_has_no_size() {
        assert_eq!(size_of("section size addr\n.comment 17 0\n"), None);
    }

    #[test]
    fn a_clean_image_passes() {
        assert_eq!(
            forbidden("00000080 T __vector_1\n00000120 t _ZN15singletrack_uno4main17h0E\n"),
            Ok(())
        );
    }

    #[test]
    fn each_miscompiled_multiplication_is_reported() {
        for name in ["__mulosi4", "__mulodi4", "__muloti4"] {
            let symbols = format!("00000080 T __vector_1\n00000a12 T {name}\n");
            assert!(forbidden(&symbols).unwrap_err().contains(name));
        }
    }

    #[test]
    fn formatting_is_found_with_either_mangling() {
        for name in [
            "_ZN4core3fmt9Formatter3pad17h0123456789abcdefE",
            "_RNvNtCs1234_4core3fmt5write",
            "_ZN42_$LT$u8$u20$as$u20$core..fmt..Debug$GT$3fmt17h01E",
        ] {
            let symbols = format!("00000080 T __vector_1\n00000a12 T {name}\n");
            assert!(
                forbidden(&symbols).unwrap_err().contains("format"),
                "{name}"
            );
        }
    }

    #[test]
    fn a_stripped_image_is_refused() {
        assert!(forbidden("").is_err());
    }
}
