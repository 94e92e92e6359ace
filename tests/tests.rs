//! Integration tests.

mod api;
mod oracle;
