//! Server-sent events (WHATWG HTML, section 9.2.6).

use std::collections::VecDeque;

use reqwest::Response;

use super::ClientError;

/// Longest event that is put together.
const MAX_EVENT_BYTES: usize = 1 << 20;

/// One event.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Event {
    /// The last id the stream gave, to resume after.
    pub id: Option<String>,
    /// The event's type; `message` where the stream does not say.
    pub event: String,
    /// The data lines, joined by line feeds.
    pub data: String,
}

/// Turns bytes, in pieces of any size, into events.
#[derive(Debug, Default)]
pub struct SseParser {
    line: Vec<u8>,
    /// A carriage return ended the last line: a line feed right behind it belongs to it.
    after_cr: bool,
    started: bool,
    id: Option<String>,
    event: String,
    data: String,
    has_data: bool,
    ready: VecDeque<Event>,
}

impl SseParser {
    /// A parser at the beginning of a stream.
    pub fn new() -> SseParser {
        SseParser::default()
    }

    /// Takes the next piece of the stream.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(), ClientError> {
        for &byte in bytes {
            match byte {
                b'\n' if self.after_cr => self.after_cr = false,
                b'\n' | b'\r' => {
                    self.after_cr = byte == b'\r';
                    self.end_line();
                }
                _ => {
                    self.after_cr = false;
                    self.line.push(byte);
                    if self.line.len() + self.data.len() > MAX_EVENT_BYTES {
                        return Err(ClientError::TooLong { limit: MAX_EVENT_BYTES });
                    }
                }
            }
        }
        Ok(())
    }

    /// The next complete event.
    pub fn next_event(&mut self) -> Option<Event> {
        self.ready.pop_front()
    }

    fn end_line(&mut self) {
        let line = std::mem::take(&mut self.line);
        let mut line = String::from_utf8_lossy(&line).into_owned();
        if !self.started {
            self.started = true;
            if let Some(rest) = line.strip_prefix('\u{feff}') {
                line = rest.to_owned();
            }
        }
        if line.is_empty() {
            self.dispatch();
            return;
        }
        let (field, value) = line.split_once(':').unwrap_or((&line, ""));
        let value = value.strip_prefix(' ').unwrap_or(value);
        match field {
            "event" => value.clone_into(&mut self.event),
            "data" => {
                if self.has_data {
                    self.data.push('\n');
                }
                self.has_data = true;
                self.data.push_str(value);
            }
            "id" if !value.contains('\0') => self.id = Some(value.to_owned()),
            // Comments (an empty field), `retry` and fields to come.
            _ => {}
        }
    }

    fn dispatch(&mut self) {
        let mut event = std::mem::take(&mut self.event);
        let data = std::mem::take(&mut self.data);
        if !std::mem::take(&mut self.has_data) {
            return;
        }
        if event.is_empty() {
            "message".clone_into(&mut event);
        }
        self.ready.push_back(Event { id: self.id.clone(), event, data });
    }
}

/// Events of one connection.
#[derive(Debug)]
pub struct EventStream {
    response: Response,
    parser: SseParser,
}

impl EventStream {
    pub(super) fn new(response: Response) -> EventStream {
        EventStream { response, parser: SseParser::new() }
    }

    /// The next event; `None` when the service ends the stream. May be dropped at any time without losing an event.
    pub async fn next(&mut self) -> Result<Option<Event>, ClientError> {
        loop {
            if let Some(event) = self.parser.next_event() {
                return Ok(Some(event));
            }
            match self.response.chunk().await.map_err(ClientError::Http)? {
                Some(chunk) => self.parser.push(&chunk)?,
                None => return Ok(None),
            }
        }
    }
}
