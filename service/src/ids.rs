//! What clients call scenes, jobs and events by.

use std::hash::{BuildHasher, Hasher, RandomState};

/// Ids that clients see: a letter, a number, and a suffix of this life of the service, so that an id (and with it a
/// version or an event id) that a client kept from an earlier life is unknown instead of meaning something else.
#[derive(Clone, Debug)]
pub(crate) struct Ids {
    suffix: String,
    /// Ids of this life's events rise from the one after it.
    pub(crate) first_event: u64,
}

impl Ids {
    /// Those of a service that keeps nothing.
    pub(crate) fn new() -> Ids {
        Ids { suffix: new_suffix(), first_event: 0 }
    }

    /// Those of a data directory in its `life`-th life, with the suffix that it keeps.
    pub(crate) fn of_life(suffix: String, life: u64) -> Ids {
        // Far enough apart that no life reaches the next one's ids, and exact in JSON for two million lives.
        Ids { suffix, first_event: (life - 1) << 32 }
    }

    /// Those of another service, which this one follows.
    pub(crate) fn of_service(suffix: String, first_event: u64) -> Ids {
        Ids { suffix, first_event }
    }

    /// How all ids end.
    pub(crate) fn suffix(&self) -> &str {
        &self.suffix
    }

    pub(crate) fn scene(&self, number: u64) -> String {
        format!("s{number}-{}", self.suffix)
    }

    pub(crate) fn job(&self, number: u64) -> String {
        format!("j{number}-{}", self.suffix)
    }

    pub(crate) fn parse_scene(&self, id: &str) -> Option<u64> {
        self.parse(id, 's')
    }

    pub(crate) fn parse_job(&self, id: &str) -> Option<u64> {
        self.parse(id, 'j')
    }

    fn parse(&self, id: &str, letter: char) -> Option<u64> {
        let (number, suffix) = id.strip_prefix(letter)?.split_once('-')?;
        let canonical = !number.starts_with(['0', '+']) && suffix == self.suffix;
        canonical.then(|| number.parse().ok()).flatten()
    }
}

/// A suffix that no other service has, most likely.
pub(crate) fn new_suffix() -> String {
    const DIGITS: &[u8; 32] = b"0123456789abcdefghjkmnpqrstvwxyz";
    // The standard library's hasher keys are random per process: enough for ids, which are no secrets.
    let mut random = RandomState::new().build_hasher();
    random.write_i128(jiff::Timestamp::now().as_nanosecond());
    let bits = random.finish();
    (0..6).map(|i| char::from(DIGITS[(bits >> (5 * i)) as usize & 31])).collect()
}
