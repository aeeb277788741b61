//! As much HTTP as the tests need: one request, one answer.

use std::fmt::Write as _;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// The body of `http://address/path` if the answer is 200; nothing if nobody answers, or anything else.
#[must_use]
pub fn get(address: &str, path: &str) -> Option<String> {
    let (status, body) = request("GET", address, path, "")?;
    (status == 200).then(|| String::from_utf8_lossy(&body).into_owned())
}

/// Status and body of an answer; nothing if nobody answers. Each further header ends in `\r\n`.
#[must_use]
pub fn request(method: &str, address: &str, path: &str, headers: &str) -> Option<(u16, Vec<u8>)> {
    let mut stream = TcpStream::connect(address).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(30))).ok()?;
    // Version 1.0: the answer is not cut into chunks, and its end is the connection's.
    let length = if method == "GET" { "" } else { "Content-Length: 0\r\n" };
    write!(stream, "{method} {path} HTTP/1.0\r\nHost: {address}\r\n{length}{headers}\r\n").ok()?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).ok()?;
    let end = answer.windows(4).position(|part| part == b"\r\n\r\n")?;
    let status = std::str::from_utf8(&answer[..end]).ok()?.split_whitespace().nth(1)?.parse().ok()?;
    Some((status, answer.split_off(end + 4)))
}

/// A text as part of a query.
#[must_use]
pub fn escaped(text: &str) -> String {
    text.bytes().fold(String::new(), |mut out, byte| {
        if byte.is_ascii_alphanumeric() {
            out.push(char::from(byte));
        } else {
            let _ = write!(out, "%{byte:02X}");
        }
        out
    })
}
