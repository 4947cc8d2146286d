//! Fuzz target: heads of HTTP requests to the page.

use singletrack_viewers::page::Request;

use crate::choices::Choices;

const METHODS: [&str; 5] = ["GET", "HEAD", "POST", "get", ""];

const TARGETS: [&str; 7] = [
    "/",
    "/events?token=abc",
    "/setup.json?a&token=&token=x",
    "/../page.js",
    "*",
    "/?",
    "",
];

const HEADERS: [&str; 10] = [
    "Host: localhost:8767",
    "Host: 127.0.0.1",
    "host:[::1]:8767",
    "Host: evil.example",
    "HOST: localhost.evil.example",
    "Host: 127.0.0.1.evil.example:8767",
    "Host:",
    "Host: [evil.example]",
    " folded",
    "X: \u{e9}",
];

/// Reads a head as the page does, and as much of it as would have come before its end.
///
/// The first byte selects the use of the rest: as the head itself, or as choices of its parts.
///
/// # Panics
///
/// If a request is read from less than its whole head, or differs with what comes after it; if
/// its words are not the client's; if a name with a dot passes as this computer, but is no
/// address.
///
/// Returns the number of heads.
pub fn page_head(data: &[u8]) -> u64 {
    let mut choices = Choices::new(data);
    if choices.byte() & 1 == 0 {
        check(choices.rest());
    } else {
        check(&head(&mut choices));
    }
    1
}

fn head(choices: &mut Choices<'_>) -> Vec<u8> {
    let version = if choices.flag() { "1.1" } else { "1.0" };
    let (method, target) = (choices.one_of(METHODS), choices.one_of(TARGETS));
    let mut head = format!("{method} {target} HTTP/{version}\r\n").into_bytes();
    while !choices.is_empty() && head.len() < 2_048 {
        match choices.byte() {
            0..=220 => head.extend(choices.one_of(HEADERS).as_bytes()),
            _ => head.extend(choices.bytes()),
        }
        head.extend(b"\r\n");
    }
    head.extend(b"\r\n");
    head
}

fn check(head: &[u8]) {
    let Ok(Some(request)) = Request::parse(head) else {
        return;
    };
    // The end of the head: the first blank line after the first line.
    let end = (0..=head.len())
        .find(|end| !matches!(Request::parse(&head[..*end]), Ok(None)))
        .unwrap_or(head.len());
    assert!(
        head[..end].ends_with(b"\n\n") || head[..end].ends_with(b"\r\n\r\n"),
        "a request from the {end} bytes of {head:?}"
    );
    assert_eq!(
        Request::parse(&head[..end]),
        Ok(Some(request.clone())),
        "what follows the head changes it"
    );
    let text = String::from_utf8_lossy(&head[..end]);
    for word in [&request.method, &request.path]
        .into_iter()
        .chain(&request.token)
    {
        assert!(text.contains(word.as_str()), "{word:?} is not in {text:?}");
    }
    if request.names_no_other_host() {
        let other = text.lines().find_map(|line| {
            let (name, host) = line.split_once(':')?;
            let is_other = host.contains(".example") && !host.contains(['[', '\r']);
            (name.eq_ignore_ascii_case("host")).then_some(is_other)
        });
        assert_ne!(other, Some(true), "another computer's name: {text:?}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(data: &[u8]) -> Request {
        let head = head(&mut Choices::new(data));
        Request::parse(&head).unwrap().unwrap()
    }

    #[test]
    fn choices_are_requests_to_this_computer_and_to_others() {
        let own = request(&[1, 0, 1, 0, 0]);
        assert_eq!((&*own.method, &*own.path), ("GET", "/events"));
        assert_eq!(own.token.as_deref(), Some("abc"));
        assert!(own.names_no_other_host());
        for stranger in [3, 4, 5] {
            assert!(!request(&[1, 0, 0, 0, stranger]).names_no_other_host());
        }
    }
}
