//! Reads an AVR ELF file: the contents of the flash and the end of the static data.

use std::{
    io,
    path::{Path, PathBuf},
};

const FLASH_BYTES: usize = 32 * 1024;
const EM_AVR: u16 = 83;
/// The processor family in the flags, and the ATmega328P's.
const FAMILY: u32 = 0x7F;
const AVR5: u32 = 5;
const PT_LOAD: u32 = 1;
const SHT_SYMTAB: u32 = 2;
/// The linker's offset of the data space.
const DATA_SPACE: u32 = 0x0080_0000;
const SRAM_START: u16 = 0x100;

/// A program for the ATmega328P.
#[derive(Debug)]
pub(crate) struct Image {
    pub(crate) flash: Vec<u8>,
    /// First address above the static data.
    pub(crate) static_end: u16,
}

/// Errors in the file of a program.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ImageError {
    #[error("cannot read {0}: {1}")]
    Read(PathBuf, #[source] io::Error),
    #[error("{0} is not an ELF file of 32 bits, little-endian")]
    NotElf(PathBuf),
    #[error("{0} is for machine {1}, not for the AVR ({EM_AVR})")]
    NotAvr(PathBuf, u16),
    #[error("{0} is for the processors avr{1}, not for avr{AVR5} (-mmcu=atmega328p)")]
    OtherFamily(PathBuf, u32),
    #[error("{0} is truncated or corrupted")]
    Damaged(PathBuf),
    #[error("{0} needs {1} bytes of flash, but there are {FLASH_BYTES}")]
    TooLarge(PathBuf, usize),
    #[error("{0} has no contents for the flash")]
    Empty(PathBuf),
}

struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn array<const N: usize>(&self, offset: usize) -> Option<[u8; N]> {
        self.slice(offset, N)?.try_into().ok()
    }

    fn slice(&self, offset: usize, length: usize) -> Option<&'a [u8]> {
        self.0.get(offset..offset.checked_add(length)?)
    }

    fn u16(&self, offset: usize) -> Option<u16> {
        self.array(offset).map(u16::from_le_bytes)
    }

    fn u32(&self, offset: usize) -> Option<u32> {
        self.array(offset).map(u32::from_le_bytes)
    }

    fn offset(&self, at: usize) -> Option<usize> {
        self.u32(at).map(|value| value as usize)
    }
}

impl Image {
    pub(crate) fn read(path: &Path) -> Result<Self, ImageError> {
        let bytes =
            std::fs::read(path).map_err(|error| ImageError::Read(path.to_owned(), error))?;
        Self::parse(&bytes, path)
    }

    fn parse(bytes: &[u8], path: &Path) -> Result<Self, ImageError> {
        let file = Bytes(bytes);
        if file.array(0) != Some(*b"\x7fELF\x01\x01") {
            return Err(ImageError::NotElf(path.to_owned()));
        }
        let damaged = || ImageError::Damaged(path.to_owned());
        let machine = file.u16(18).ok_or_else(damaged)?;
        if machine != EM_AVR {
            return Err(ImageError::NotAvr(path.to_owned(), machine));
        }
        let family = file.u32(36).ok_or_else(damaged)? & FAMILY;
        if family != AVR5 {
            return Err(ImageError::OtherFamily(path.to_owned(), family));
        }
        let mut flash = Vec::new();
        for (address, contents) in segments(&file).ok_or_else(damaged)? {
            let end = address + contents.len();
            if end > FLASH_BYTES {
                return Err(ImageError::TooLarge(path.to_owned(), end));
            }
            if flash.len() < end {
                flash.resize(end, 0xFF);
            }
            if let Some(place) = flash.get_mut(address..end) {
                place.copy_from_slice(contents);
            }
        }
        if flash.is_empty() {
            return Err(ImageError::Empty(path.to_owned()));
        }
        Ok(Self {
            flash,
            static_end: static_end(&file).ok_or_else(damaged)?,
        })
    }
}

/// Contents of the flash with their addresses. EEPROM and fuses have addresses
/// beyond the data space.
fn segments<'a>(file: &Bytes<'a>) -> Option<Vec<(usize, &'a [u8])>> {
    let table = file.offset(28)?;
    let size = usize::from(file.u16(42)?);
    let count = usize::from(file.u16(44)?);
    let mut segments = Vec::new();
    for index in 0..count {
        let header = table.checked_add(index * size)?;
        let length = file.offset(header + 16)?;
        let address = file.u32(header + 12)?;
        if file.u32(header)? == PT_LOAD && length > 0 && address < DATA_SPACE {
            segments.push((
                address as usize,
                file.slice(file.offset(header + 4)?, length)?,
            ));
        }
    }
    Some(segments)
}

/// The highest of the symbols that linker scripts define above the static data.
fn static_end(file: &Bytes<'_>) -> Option<u16> {
    let table = file.offset(32)?;
    let size = usize::from(file.u16(46)?);
    let count = usize::from(file.u16(48)?);
    let section = |index: usize| table.checked_add(index.checked_mul(size)?);
    let mut end = SRAM_START;
    for index in 0..count {
        let header = section(index)?;
        if file.u32(header + 4)? != SHT_SYMTAB {
            continue;
        }
        let (symbols, length) = (file.offset(header + 16)?, file.offset(header + 20)?);
        let names = file.offset(section(file.offset(header + 24)?)? + 16)?;
        for symbol in (symbols..symbols.checked_add(length)?).step_by(16) {
            let name = names.checked_add(file.offset(symbol)?)?;
            let is = |expected: &[u8]| file.slice(name, expected.len()) == Some(expected);
            let value = file.u32(symbol + 4)?;
            if value >= DATA_SPACE
                && [
                    &b"__data_end\0"[..],
                    b"__bss_end\0",
                    b"_end\0",
                    b"__noinit_end\0",
                ]
                .into_iter()
                .any(is)
            {
                end = end.max(u16::try_from(value - DATA_SPACE).ok()?);
            }
        }
    }
    Some(end)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file of one segment of four bytes at `address`, without symbols.
    fn file(machine: u16, family: u8, address: u32) -> Vec<u8> {
        let mut bytes = vec![0; 52 + 32];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(0, b"\x7fELF\x01\x01");
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

    fn parse(bytes: &[u8]) -> Result<Image, ImageError> {
        Image::parse(bytes, Path::new("uno.elf"))
    }

    #[test]
    fn segments_go_to_their_load_address() {
        let image = parse(&file(EM_AVR, 5, 2)).unwrap();
        assert_eq!(image.flash, [0xFF, 0xFF, 1, 2, 3, 4]);
        assert_eq!(image.static_end, SRAM_START);
    }

    #[test]
    fn files_that_are_not_images_have_distinct_errors() {
        let other = |bytes: &[u8]| parse(bytes).unwrap_err().to_string();
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
            assert!(parse(&whole[..length]).is_err(), "{length}");
        }
    }
}
