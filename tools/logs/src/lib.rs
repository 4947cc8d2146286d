//! Logs of cars: foreign ones become records, and what the pilot would have said of a drive.

pub mod import;
pub mod judge;
