//! Memory usage of an image.

use std::{fmt::Display, path::Path};

use object::{Architecture, Object, ObjectSection, SectionKind};

use super::UnoError;

/// Offset of data addresses in the ELF file.
const DATA_SPACE: u64 = 0x80_0000;

/// Memory usage of an image on the ATmega328P.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageSize {
    /// Program, constants and initial values, in bytes.
    pub flash_bytes: u64,
    /// Statically allocated SRAM, in bytes.
    pub static_bytes: u64,
}

impl ImageSize {
    /// Reads the sizes from the image's file.
    ///
    /// # Errors
    ///
    /// Fails if the file is not a readable image.
    pub fn read(image: &Path) -> Result<Self, UnoError> {
        let name = image.display();
        let unreadable =
            |reason: &dyn Display| UnoError(format!("can't read the image {name}: {reason}"));
        let bytes = std::fs::read(image).map_err(|error| unreadable(&error))?;
        let file = object::File::parse(bytes.as_slice()).map_err(|error| unreadable(&error))?;
        let mut size = Self::default();
        for section in file.sections() {
            let in_data_space = section.address() >= DATA_SPACE;
            let (flash, data) = match section.kind() {
                SectionKind::Text | SectionKind::ReadOnlyData => (true, in_data_space),
                SectionKind::Data => (true, true),
                SectionKind::UninitializedData => (false, true),
                _ => (false, false),
            };
            size.flash_bytes += if flash { section.size() } else { 0 };
            size.static_bytes += if data { section.size() } else { 0 };
        }
        // A program for another processor would give sizes, too.
        if file.architecture() != Architecture::Avr {
            return Err(unreadable(&"not for an AVR processor"));
        }
        Ok(size)
    }
}
