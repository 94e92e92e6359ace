//! Pages of lists, newest first. A cursor is opaque to clients: the number of the last entry they have.

use super::problem::{ApiResult, Kind, Problem};
use crate::config::Config;

/// One page to fetch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Page {
    /// Entries with smaller numbers only.
    pub(crate) before: u64,
    pub(crate) limit: usize,
}

impl Page {
    pub(crate) fn new(config: &Config, limit: Option<usize>, cursor: Option<&str>) -> ApiResult<Page> {
        let max = config.limits.page;
        let limit = limit.unwrap_or(config.defaults.page);
        if !(1..=max).contains(&limit) {
            return Err(Problem::field(Kind::InvalidQuery, "limit", format!("must be 1 to {max}, not {limit}")));
        }
        let before = match cursor {
            None => u64::MAX,
            Some(cursor) => {
                decode(cursor).ok_or_else(|| Problem::field(Kind::InvalidQuery, "cursor", "is not one of this list"))?
            }
        };
        Ok(Page { before, limit })
    }

    /// Cuts what was fetched (one more than `limit`) to the page, with the cursor of the next.
    pub(crate) fn cut<T>(&self, mut items: Vec<T>, number_of: impl Fn(&T) -> u64) -> (Vec<T>, Option<String>) {
        let has_more = items.len() > self.limit;
        items.truncate(self.limit);
        let next = items.last().filter(|_| has_more).map(|last| encode(number_of(last)));
        (items, next)
    }
}

fn encode(number: u64) -> String {
    format!("b{number:x}")
}

fn decode(cursor: &str) -> Option<u64> {
    let number = u64::from_str_radix(cursor.strip_prefix('b')?, 16).ok()?;
    (encode(number) == cursor).then_some(number)
}
