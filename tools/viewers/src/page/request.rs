//! Reads the head of a request.

use std::{io, net::IpAddr, time::Duration};

use tokio::{
    io::{AsyncRead, AsyncReadExt as _},
    time::timeout,
};

/// The longest head, in bytes.
const LONGEST_HEAD: usize = 8_192;

/// The longest wait for the whole head.
const HEAD_TIMEOUT: Duration = Duration::from_secs(5);

/// The largest number of headers.
const HEADERS: usize = 64;

/// What a browser asks the page for: the head of a request of HTTP/1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// The method, such as `GET`.
    pub method: String,
    /// The path, without the query.
    pub path: String,
    /// `token` of the query.
    pub token: Option<String>,
    host: Option<String>,
}

/// Why a request is not answered with what it asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadRequest {
    /// It is no head of HTTP/1.
    Malformed,
    /// Its head, or the number of its headers, is beyond what a browser sends.
    TooLong,
}

impl Request {
    /// Reads a head. `None` if the client leaves or is silent before its end.
    pub(super) async fn read(
        mut stream: impl AsyncRead + Unpin,
    ) -> io::Result<Option<Result<Self, BadRequest>>> {
        let mut head = Vec::new();
        let read = async {
            loop {
                match Self::parse(&head) {
                    Ok(None) if head.len() >= LONGEST_HEAD => {
                        return Ok(Some(Err(BadRequest::TooLong)));
                    }
                    Ok(None) => {}
                    parsed => return Ok(parsed.transpose()),
                }
                let room = LONGEST_HEAD.saturating_sub(head.len());
                if (&mut stream).take(room as u64).read_buf(&mut head).await? == 0 {
                    return Ok(None);
                }
            }
        };
        timeout(HEAD_TIMEOUT, read).await.unwrap_or(Ok(None))
    }

    /// The request, as soon as its head is complete; `None` before.
    ///
    /// # Errors
    ///
    /// When it is no head, or one with too many headers.
    pub fn parse(head: &[u8]) -> Result<Option<Self>, BadRequest> {
        let mut headers = [httparse::EMPTY_HEADER; HEADERS];
        let mut request = httparse::Request::new(&mut headers);
        match request.parse(head) {
            Ok(httparse::Status::Complete(_)) => {}
            Ok(httparse::Status::Partial) => return Ok(None),
            Err(httparse::Error::TooManyHeaders) => return Err(BadRequest::TooLong),
            Err(_) => return Err(BadRequest::Malformed),
        }
        let (Some(method), Some(target)) = (request.method, request.path) else {
            return Err(BadRequest::Malformed);
        };
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        let token = query
            .split('&')
            .find_map(|pair| pair.strip_prefix("token="))
            .map(str::to_owned);
        let host = request
            .headers
            .iter()
            .find(|header| header.name.eq_ignore_ascii_case("host"))
            .and_then(|header| str::from_utf8(header.value).ok())
            .map(|host| host.trim().to_owned());
        Ok(Some(Self {
            method: method.to_owned(),
            path: path.to_owned(),
            token,
            host,
        }))
    }

    /// Whether the request names this computer by an address or as `localhost`, and not by a name
    /// that another web page may have given it.
    pub fn names_no_other_host(&self) -> bool {
        let Some(host) = &self.host else {
            // Browsers always name one.
            return true;
        };
        let name = match host.strip_prefix('[') {
            Some(rest) => rest.split_once(']').map_or("", |(name, _)| name),
            None => host.split(':').next().unwrap_or(host),
        };
        name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    fn parsed(head: &str) -> Result<Option<Request>, BadRequest> {
        Request::parse(head.as_bytes())
    }

    #[test]
    fn a_head_is_taken_apart_when_it_is_complete() {
        let head = "GET /events?a=1&token=abc HTTP/1.1\r\nhost: localhost:8767\r\n\r\n";
        for end in 0..head.len() {
            assert_eq!(parsed(&head[..end]), Ok(None), "{end}");
        }
        let request = parsed(head).unwrap().unwrap();
        assert_eq!(request.method, "GET");
        assert_eq!(request.path, "/events");
        assert_eq!(request.token.as_deref(), Some("abc"));
        assert!(request.names_no_other_host());
        assert_eq!(
            parsed("no request at all\r\n\r\n"),
            Err(BadRequest::Malformed)
        );
        let many = "X: y\r\n".repeat(HEADERS + 1);
        assert_eq!(
            parsed(&format!("GET / HTTP/1.1\r\n{many}\r\n")),
            Err(BadRequest::TooLong)
        );
    }

    #[test]
    fn only_addresses_and_localhost_are_this_computer() {
        let own = |host: &str| {
            let request = parsed(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n"));
            request.unwrap().unwrap().names_no_other_host()
        };
        for host in [
            "127.0.0.1:8767",
            "LOCALHOST",
            "localhost:1",
            "[::1]:8767",
            "10.0.0.7",
        ] {
            assert!(own(host), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:8767",
            "127.0.0.1.evil.example",
            "[",
            "",
        ] {
            assert!(!own(host), "{host}");
        }
    }
}
