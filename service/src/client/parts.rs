//! A progressive picture as the service sends it: parts of a `multipart/x-mixed-replace` body, each with its length.

use reqwest::Response;

use super::ClientError;

/// Longest head of a part that is read.
const MAX_HEAD: usize = 4096;

/// One picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Names, in lower case, and values.
    pub headers: Vec<(String, String)>,
    /// The file.
    pub bytes: Vec<u8>,
}

/// Pictures as they arrive, each better than the one before.
#[derive(Debug)]
pub struct Parts {
    response: Response,
    splitter: Splitter,
}

impl Parts {
    pub(super) fn new(response: Response) -> Parts {
        Parts { response, splitter: Splitter::default() }
    }

    /// The answer's own headers.
    pub fn response(&self) -> &Response {
        &self.response
    }

    /// The next picture; none after the last one.
    ///
    /// # Errors
    /// [`ClientError`], also where the body ends early.
    pub async fn next(&mut self) -> Result<Option<Part>, ClientError> {
        loop {
            if let Some(found) = self.splitter.next()? {
                return Ok(found);
            }
            match self.response.chunk().await.map_err(ClientError::Http)? {
                Some(chunk) => self.splitter.bytes.extend_from_slice(&chunk),
                None => return Err(ClientError::Malformed("a picture that ended before its last part")),
            }
        }
    }
}

impl Part {
    /// A header's value; `name` in lower case.
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str())
    }
}

/// Cuts bytes into parts.
#[derive(Debug, Default)]
struct Splitter {
    bytes: Vec<u8>,
}

impl Splitter {
    /// None: more bytes are needed. Some(None): that was all.
    fn next(&mut self) -> Result<Option<Option<Part>>, ClientError> {
        let malformed = || ClientError::Malformed("a part of the picture");
        // A line break stands before every boundary but the first.
        let from = if self.bytes.starts_with(b"\r\n") { 2 } else { 0 };
        let Some(line) = find(&self.bytes[from..], b"\r\n") else { return Ok(None) };
        let boundary = &self.bytes[from..from + line];
        if !boundary.starts_with(b"--") {
            return Err(malformed());
        }
        if boundary.len() > 4 && boundary.ends_with(b"--") {
            return Ok(Some(None));
        }
        let head_from = from + line + 2;
        let Some(head) = find(&self.bytes[head_from..], b"\r\n\r\n") else {
            return if self.bytes.len() > MAX_HEAD { Err(malformed()) } else { Ok(None) };
        };
        let text = std::str::from_utf8(&self.bytes[head_from..head_from + head]).map_err(|_| malformed())?;
        let pair = |line: &str| {
            let (name, value) = line.split_once(':')?;
            Some((name.trim().to_ascii_lowercase(), value.trim().to_owned()))
        };
        let mut part = Part { headers: text.split("\r\n").filter_map(pair).collect(), bytes: Vec::new() };
        let length = part.header("content-length").and_then(|length| length.parse::<usize>().ok());
        let body_from = head_from + head + 4;
        let end = length.and_then(|length| body_from.checked_add(length)).ok_or_else(malformed)?;
        if self.bytes.len() < end {
            return Ok(None);
        }
        part.bytes = self.bytes[body_from..end].to_vec();
        self.bytes.drain(..end);
        Ok(Some(Some(part)))
    }
}

fn find(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).position(|window| window == what)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODY: &[u8] =
        b"--b\r\nContent-Length: 4\r\nX-A: 1\r\n\r\n\r\n--\r\n--b\r\ncontent-length: 0\r\n\r\n\r\n--b--\r\n";

    #[test]
    fn parts_come_out_whole_however_they_arrive() {
        let mut splitter = Splitter::default();
        let mut found = Vec::new();
        for byte in BODY {
            splitter.bytes.push(*byte);
            while let Some(next) = splitter.next().unwrap() {
                if next.is_none() {
                    assert_eq!(found.len(), 2);
                    return;
                }
                found.extend(next);
            }
            // A body may look like a boundary: its length counts.
            assert!(found.first().is_none_or(|part: &Part| part.bytes == b"\r\n--" && part.header("x-a") == Some("1")));
        }
        panic!("the end was not seen: {found:?}");
    }

    #[test]
    fn what_is_no_part_is_an_error() {
        for bytes in [&b"hello\r\n"[..], b"--b\r\nX: 1\r\n\r\n", b"--b\r\nContent-Length: x\r\n\r\n"] {
            let mut splitter = Splitter { bytes: bytes.to_vec() };
            assert!(matches!(splitter.next(), Err(ClientError::Malformed(_))), "{bytes:?}");
        }
    }
}
