//! The laboratory in a browser: host, board, cameras and car in virtual time, compiled to
//! WebAssembly, and what verifies a record.
//!
//! It imports nothing. A caller writes to [`input`], calls [`ask`] with a line of JSON or [`replay`]
//! with a record, and reads the answer at [`output`]: JSON, or bytes where a request says so.

mod session;

use std::cell::RefCell;

use session::{Answer, Session};

#[derive(Default)]
struct Buffers {
    input: Vec<u8>,
    output: Vec<u8>,
    session: Session,
}

thread_local! {
    static BUFFERS: RefCell<Buffers> = RefCell::default();
}

/// Makes room for an input of this length, in bytes, and returns where to write it.
#[expect(unsafe_code, reason = "an export has a name of its own")]
// SAFETY: no other item of the program has this name.
#[unsafe(no_mangle)]
pub extern "C" fn input(length: usize) -> *mut u8 {
    BUFFERS.with_borrow_mut(|buffers| {
        buffers.input = vec![0; length];
        buffers.input.as_mut_ptr()
    })
}

/// Where the answer is.
#[expect(unsafe_code, reason = "an export has a name of its own")]
// SAFETY: no other item of the program has this name.
#[unsafe(no_mangle)]
pub extern "C" fn output() -> *const u8 {
    BUFFERS.with_borrow(|buffers| buffers.output.as_ptr())
}

/// Length of the answer, in bytes.
#[expect(unsafe_code, reason = "an export has a name of its own")]
// SAFETY: no other item of the program has this name.
#[unsafe(no_mangle)]
pub extern "C" fn output_length() -> usize {
    BUFFERS.with_borrow(|buffers| buffers.output.len())
}

/// Answers the request in the input. Returns 1; 0 if the answer is the text of an error.
#[expect(unsafe_code, reason = "an export has a name of its own")]
// SAFETY: no other item of the program has this name.
#[unsafe(no_mangle)]
pub extern "C" fn ask() -> u32 {
    answer(|session, request| session.ask(&request))
}

/// Replays the record in the input. Returns as [`ask`].
#[expect(unsafe_code, reason = "an export has a name of its own")]
// SAFETY: no other item of the program has this name.
#[unsafe(no_mangle)]
pub extern "C" fn replay() -> u32 {
    answer(|_, record| session::replay(record))
}

fn answer(work: impl FnOnce(&mut Session, Vec<u8>) -> Answer) -> u32 {
    BUFFERS.with_borrow_mut(|buffers| {
        let input = std::mem::take(&mut buffers.input);
        let answer = work(&mut buffers.session, input);
        let is_good = answer.is_ok();
        buffers.output = answer.unwrap_or_else(|error| error.to_string().into_bytes());
        u32::from(is_good)
    })
}
