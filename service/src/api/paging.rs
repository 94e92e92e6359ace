//! Pages of lists. A cursor is opaque to clients: the number of the last entry they have.

use super::problem::{ApiResult, Kind, Problem};
use crate::config::Config;

/// One page to fetch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Page {
    /// Entries with smaller numbers only.
    pub(crate) before: u64,
    pub(crate) limit: usize,
}

/// One page to fetch of a list with the newest last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Onward {
    /// Entries with greater numbers only.
    pub(crate) after: u64,
    pub(crate) limit: usize,
}

impl Page {
    pub(crate) fn new(config: &Config, limit: Option<usize>, cursor: Option<&str>) -> ApiResult<Page> {
        let limit = check_limit(config, limit)?;
        Ok(Page { before: cursor.map_or(Ok(u64::MAX), decode)?, limit })
    }

    /// Cuts what was fetched (one more than `limit`) to the page, with the cursor of the next.
    pub(crate) fn cut<T>(&self, items: Vec<T>, number_of: impl Fn(&T) -> u64) -> (Vec<T>, Option<String>) {
        cut(self.limit, items, number_of)
    }
}

impl Onward {
    pub(crate) fn new(config: &Config, limit: Option<usize>, cursor: Option<&str>) -> ApiResult<Onward> {
        let limit = check_limit(config, limit)?;
        Ok(Onward { after: cursor.map_or(Ok(0), decode)?, limit })
    }

    /// Cuts what was fetched (one more than `limit`) to the page, with the cursor of the next.
    pub(crate) fn cut<T>(&self, items: Vec<T>, number_of: impl Fn(&T) -> u64) -> (Vec<T>, Option<String>) {
        cut(self.limit, items, number_of)
    }
}

fn check_limit(config: &Config, limit: Option<usize>) -> ApiResult<usize> {
    let max = config.limits.page;
    let limit = limit.unwrap_or(config.defaults.page);
    if !(1..=max).contains(&limit) {
        return Err(Problem::field(Kind::InvalidQuery, "limit", format!("must be 1 to {max}, not {limit}")));
    }
    Ok(limit)
}

fn cut<T>(limit: usize, mut items: Vec<T>, number_of: impl Fn(&T) -> u64) -> (Vec<T>, Option<String>) {
    let has_more = items.len() > limit;
    items.truncate(limit);
    let next = items.last().filter(|_| has_more).map(|last| encode(number_of(last)));
    (items, next)
}

fn encode(number: u64) -> String {
    format!("b{number:x}")
}

fn decode(cursor: &str) -> ApiResult<u64> {
    let number = cursor.strip_prefix('b').and_then(|hex| u64::from_str_radix(hex, 16).ok());
    let number = number.filter(|number| encode(*number) == cursor);
    number.ok_or_else(|| Problem::field(Kind::InvalidQuery, "cursor", "is not one of this list"))
}
