//! Reads the image's ELF file: the bytes of the flash and the end of the static data.

use std::path::Path;

use object::{
    LittleEndian,
    elf::{EF_AVR_ARCH, EF_AVR_ARCH_AVR5, EM_AVR, FileHeader32, PT_LOAD, SHT_SYMTAB},
    read::elf::{FileHeader as _, ProgramHeader as _, Sym as _},
};

const FLASH_BYTES: usize = 32 * 1024;
/// Where the linker puts the data space.
const DATA_SPACE: u32 = 0x0080_0000;
const SRAM_START: u16 = 0x100;
/// The symbols that linker scripts put above the static data.
const ENDS: [&[u8]; 4] = [b"__data_end", b"__bss_end", b"_end", b"__noinit_end"];

/// A part of the file is missing or contradicts another.
const DAMAGED: &str = "is truncated or corrupted";

type Header = FileHeader32<LittleEndian>;

/// A program for the ATmega328P.
#[derive(Debug)]
pub(crate) struct Image {
    pub(crate) flash: Vec<u8>,
    /// First address above the static data.
    pub(crate) static_end: u16,
}

impl Image {
    /// Reads a file, or says why it is not a program for the board.
    pub(crate) fn read(path: &Path) -> Result<Self, String> {
        let name = path.display();
        let bytes = std::fs::read(path).map_err(|error| format!("can't read {name}: {error}"))?;
        Self::parse(&bytes).map_err(|why| format!("{name} {why}"))
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let header =
            Header::parse(bytes).map_err(|_| "is not an ELF file of 32 bits, little-endian")?;
        let machine = header.e_machine(LittleEndian);
        if machine != EM_AVR {
            let why = format!("is for machine {machine}, not for the AVR ({EM_AVR})");
            return Err(why);
        }
        let family = header.e_flags(LittleEndian) & EF_AVR_ARCH;
        if family != EF_AVR_ARCH_AVR5 {
            return Err(format!(
                "is for the processors avr{family}, not for avr{EF_AVR_ARCH_AVR5} (-mmcu=atmega328p)"
            ));
        }
        let mut flash = Vec::new();
        let segments = header.program_headers(LittleEndian, bytes);
        for segment in segments.map_err(|_| DAMAGED)? {
            let is_empty = segment.p_filesz(LittleEndian) == 0;
            let address = segment.p_paddr(LittleEndian);
            // EEPROM and fuses have addresses beyond the data space.
            if segment.p_type(LittleEndian) != PT_LOAD || is_empty || address >= DATA_SPACE {
                continue;
            }
            let contents = segment.data(LittleEndian, bytes).map_err(|()| DAMAGED)?;
            let address = address as usize;
            let end = address + contents.len();
            if end > FLASH_BYTES {
                let why = format!("needs {end} bytes of flash, but there are {FLASH_BYTES}");
                return Err(why);
            }
            if flash.len() < end {
                flash.resize(end, 0xFF);
            }
            if let Some(place) = flash.get_mut(address..end) {
                place.copy_from_slice(contents);
            }
        }
        if flash.is_empty() {
            return Err("has no contents for the flash".to_owned());
        }
        Ok(Self {
            flash,
            static_end: static_end(header, bytes).ok_or(DAMAGED)?,
        })
    }
}

/// The highest of the symbols above the static data; none of a damaged file.
fn static_end(header: &Header, bytes: &[u8]) -> Option<u16> {
    let sections = header.sections(LittleEndian, bytes).ok()?;
    let symbols = sections.symbols(LittleEndian, bytes, SHT_SYMTAB).ok()?;
    let mut end = SRAM_START;
    for symbol in symbols.iter() {
        let name = symbol.name(LittleEndian, symbols.strings()).ok()?;
        let value = symbol.st_value(LittleEndian);
        if value >= DATA_SPACE && ENDS.contains(&name) {
            end = end.max(u16::try_from(value - DATA_SPACE).ok()?);
        }
    }
    Some(end)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with one segment of four bytes at `address`, without symbols.
    fn file(machine: u16, family: u8, address: u32) -> Vec<u8> {
        let mut bytes = vec![0; 52 + 32];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(0, b"\x7fELF\x01\x01\x01");
        put(18, &machine.to_le_bytes());
        put(28, &52_u32.to_le_bytes());
        put(36, &[family]);
        put(42, &32_u16.to_le_bytes());
        put(44, &1_u16.to_le_bytes());
        put(52, &PT_LOAD.to_le_bytes());
        put(56, &84_u32.to_le_bytes());
        put(64, &address.to_le_bytes());
        put(68, &4_u32.to_le_bytes());
        bytes.extend([1, 2, 3, 4]);
        bytes
    }

    #[test]
    fn segments_go_to_their_load_address() {
        let image = Image::parse(&file(EM_AVR, 5, 2)).unwrap();
        assert_eq!(image.flash, [0xFF, 0xFF, 1, 2, 3, 4]);
        assert_eq!(image.static_end, SRAM_START);
    }

    #[test]
    fn files_that_are_not_images_have_distinct_errors() {
        let other = |bytes: &[u8]| Image::parse(bytes).unwrap_err();
        assert!(other(b"#!/bin/sh").contains("not an ELF file"));
        assert!(other(&file(62, 5, 0)).contains("for machine 62"));
        assert!(other(&file(EM_AVR, 6, 0)).contains("for the processors avr6"));
        assert!(other(&file(EM_AVR, 5, 32_765)).contains("needs 32769 bytes"));
        assert!(other(&file(EM_AVR, 5, 0x81_0000)).contains("no contents for the flash"));
    }

    #[test]
    fn a_file_truncated_anywhere_is_refused() {
        let whole = file(EM_AVR, 5, 0);
        for length in 0..whole.len() {
            assert!(Image::parse(&whole[..length]).is_err(), "{length}");
        }
    }
}
