//! Remarks for the person who uploads: one text per kind, with the places it applies to.

/// Places named per remark before the rest is only counted.
const PLACES_SHOWN: usize = 4;

/// Remarks in the order of their first appearance.
#[derive(Debug, Default)]
pub(super) struct Warnings {
    entries: Vec<Entry>,
}

#[derive(Debug)]
struct Entry {
    text: String,
    places: Vec<String>,
    hidden: usize,
}

impl Warnings {
    /// Adds `text`, which must not vary with the place, and the place it applies to (may be empty).
    pub(super) fn add(&mut self, text: impl Into<String>, place: impl Into<String>) {
        let (text, place) = (text.into(), place.into());
        let known = self.entries.iter().position(|entry| entry.text == text);
        let index = known.unwrap_or_else(|| {
            self.entries.push(Entry { text, places: Vec::new(), hidden: 0 });
            self.entries.len() - 1
        });
        let entry = &mut self.entries[index];
        if place.is_empty() || entry.places.contains(&place) {
        } else if entry.places.len() < PLACES_SHOWN {
            entry.places.push(place);
        } else {
            entry.hidden += 1;
        }
    }

    /// One line per remark.
    pub(super) fn into_texts(self) -> Vec<String> {
        self.entries.into_iter().map(Entry::into_text).collect()
    }
}

impl Entry {
    fn into_text(self) -> String {
        match (self.places.is_empty(), self.hidden) {
            (true, _) => self.text,
            (false, 0) => format!("{}: {}", self.text, self.places.join(", ")),
            (false, hidden) => format!("{}: {} and {hidden} more", self.text, self.places.join(", ")),
        }
    }
}
