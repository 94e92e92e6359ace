//! Bearer tokens: who may do what.
//!
//! A token file has one token per line: the token, white space, its scopes separated by commas. `#` begins a comment.
//! `edit` includes `read`, `admin` includes both.

use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use axum::http::uri::Authority;
use subtle::{Choice, ConditionallySelectable, ConstantTimeEq};

/// What a token allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Scope {
    /// Look at everything.
    Read = 1,
    /// Upload, edit, cancel.
    Edit = 2,
    /// Delete scenes and assets.
    Admin = 3,
}

impl Scope {
    /// The word in a token file.
    pub fn as_str(self) -> &'static str {
        match self {
            Scope::Read => "read",
            Scope::Edit => "edit",
            Scope::Admin => "admin",
        }
    }

    fn parse(word: &str) -> Option<Scope> {
        [Scope::Read, Scope::Edit, Scope::Admin].into_iter().find(|scope| scope.as_str() == word)
    }
}

/// Why a token file cannot be used. Never holds a token.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// It cannot be read.
    #[error("cannot read the token file {path}: {source}")]
    Read {
        /// Where it should be.
        path: PathBuf,
        /// What went wrong.
        source: io::Error,
    },
    /// A line is not as it should be.
    #[error("line {line} of the token file: {reason}")]
    Line {
        /// From 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// There is no token in it.
    #[error("the token file holds no token")]
    Empty,
}

/// Shortest token that is accepted.
const MIN_CHARS: usize = 16;

/// The tokens of a file, as hashes: a core dump tells none.
#[derive(Clone, Debug)]
pub struct Tokens {
    path: PathBuf,
    held: Arc<RwLock<Vec<Token>>>,
}

#[derive(Clone, Debug)]
struct Token {
    hash: [u8; 32],
    scope: Scope,
}

impl Tokens {
    /// Reads a token file.
    pub fn read(path: &Path) -> Result<Tokens, TokenError> {
        let tokens = Tokens { path: path.to_owned(), held: Arc::default() };
        tokens.reload()?;
        Ok(tokens)
    }

    /// Reads the file again; on an error the tokens stay as they are. Answers how many there are.
    pub fn reload(&self) -> Result<usize, TokenError> {
        let text = std::fs::read_to_string(&self.path)
            .map_err(|source| TokenError::Read { path: self.path.clone(), source })?;
        let tokens = parse(&text)?;
        let count = tokens.len();
        *self.held.write().unwrap_or_else(PoisonError::into_inner) = tokens;
        Ok(count)
    }

    /// What a token allows; nothing where it is not known. Takes as long for every token: all are compared in full.
    pub(crate) fn scope_of(&self, token: &str) -> Option<Scope> {
        let hash = blake3::hash(token.as_bytes());
        let held = self.held.read().unwrap_or_else(PoisonError::into_inner);
        let mut level = 0u8;
        for token in &*held {
            let is_it: Choice = token.hash.ct_eq(hash.as_bytes());
            level.conditional_assign(&(token.scope as u8), is_it);
        }
        [Scope::Read, Scope::Edit, Scope::Admin].into_iter().find(|scope| *scope as u8 == level)
    }
}

fn parse(text: &str) -> Result<Vec<Token>, TokenError> {
    let mut tokens: Vec<Token> = Vec::new();
    for (line, content) in (1..).zip(text.lines()) {
        let content = content.split('#').next().unwrap_or_default().trim();
        if content.is_empty() {
            continue;
        }
        let fault = |reason: String| TokenError::Line { line, reason };
        let mut words = content.split_whitespace();
        let (Some(token), Some(scopes), None) = (words.next(), words.next(), words.next()) else {
            return Err(fault("expected a token and its scopes, separated by commas".to_owned()));
        };
        if token.len() < MIN_CHARS || !token.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err(fault(format!("a token has at least {MIN_CHARS} visible ASCII characters")));
        }
        let scopes: Option<Vec<Scope>> = scopes.split(',').map(Scope::parse).collect();
        let scope = scopes.and_then(|scopes| scopes.into_iter().max());
        let scope = scope.ok_or_else(|| fault("a scope is none of read, edit and admin".to_owned()))?;
        let hash = *blake3::hash(token.as_bytes()).as_bytes();
        if tokens.iter().any(|known| known.hash == hash) {
            return Err(fault("the token stands in an earlier line too".to_owned()));
        }
        tokens.push(Token { hash, scope });
    }
    if tokens.is_empty() { Err(TokenError::Empty) } else { Ok(tokens) }
}

/// Whether the host of `authority` is this machine, the address `own` holds that the service listens on, or another
/// name in `own`; `*` in it means all. Where the service listens on all addresses it answers to every one of them,
/// since what names an address was not resolved by anybody's name server.
pub(crate) fn is_own_host(authority: &str, own: &[String]) -> bool {
    let Ok(authority) = authority.parse::<Authority>() else { return false };
    let host = authority.host().trim_start_matches('[').trim_end_matches([']', '.']);
    let named = own.iter().any(|name| name == "*" || name.trim_end_matches('.').eq_ignore_ascii_case(host));
    let is_address = host.parse::<IpAddr>().is_ok_and(|address| {
        let on_all = || own.iter().any(|name| name.parse::<IpAddr>().is_ok_and(|own| own.is_unspecified()));
        address.to_canonical().is_loopback() || on_all()
    });
    named || is_address || host.eq_ignore_ascii_case("localhost")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_hosts() {
        let own = |host: &str, own: &[&str]| is_own_host(host, &own.iter().map(|&s| s.to_owned()).collect::<Vec<_>>());
        for host in ["localhost", "LOCALHOST:7878", "localhost.", "127.0.0.1:80", "127.8.0.1", "[::1]:7878"] {
            assert!(own(host, &[]), "{host}");
        }
        for host in
            ["", "x", "evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "10.0.0.7", "a b", "@"]
        {
            assert!(!own(host, &["192.168.1.2"]), "{host}");
        }
        assert!(own("192.168.1.2:7878", &["192.168.1.2"]) && own("Bake.Studio:1", &["bake.studio"]));
        assert!(own("10.0.0.7", &["0.0.0.0"]) && own("[fe80::1]", &["::"]) && !own("evil.example", &["0.0.0.0"]));
        assert!(own("evil.example", &["*"]));
    }

    #[test]
    fn token_files() {
        let tokens = parse("# tokens\n0123456789abcdef read,edit # of the studio\n\nfedcba9876543210\tread\n").unwrap();
        assert_eq!(tokens.iter().map(|token| token.scope).collect::<Vec<_>>(), [Scope::Edit, Scope::Read]);
        for (text, reason) in [
            ("", "no token"),
            ("# nothing", "no token"),
            ("0123456789abcdef", "line 1"),
            ("0123456789abcdef read edit", "line 1"),
            ("\n0123456789abcdef write", "line 2"),
            ("0123456789abcdef read,", "none of"),
            ("short read", "at least 16"),
            ("0123456789abcdef read\n0123456789abcdef edit", "earlier"),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(reason) && !error.contains("0123"), "{text:?}: {error}");
        }
    }
}
