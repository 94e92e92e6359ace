//! Damaged files: any answer is right, a panic is not.

use super::*;
use crate::scene::Original;

/// A small generator; the tests need no more than that it repeats.
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn below(&mut self, end: usize) -> usize {
        // SplitMix64.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) % end.max(1) as u64) as usize
    }
}

#[test]
fn damaged_files_do_not_panic() {
    let sparse = "\"count\": 4, \"sparse\": {\"count\": 1, \"indices\": {\"bufferView\": 4, \"componentType\": 5125}, \
                  \"values\": {\"bufferView\": 4, \"byteOffset\": 4}}, \"type\": \"VEC3\", \"min\"";
    let whole = edited(&[("\"count\": 4, \"type\": \"VEC3\", \"min\"", sparse)]);
    assert!(load(&whole).is_ok());
    let mut random = Random(1);
    let mut accepted = 0;
    for _ in 0..20_000 {
        let mut file = whole.clone();
        for _ in 0..=random.below(4) {
            let at = random.below(file.len());
            file[at] = match random.below(3) {
                0 => random.below(256) as u8,
                // Digits for digits: keeps the JSON readable and the numbers wrong.
                1 if file[at].is_ascii_digit() => b'0' + random.below(10) as u8,
                _ => file[at] ^ (1 << random.below(8)),
            };
        }
        if random.below(8) == 0 {
            file.truncate(random.below(file.len()));
        }
        let is_accepted = load(&file).is_ok();
        accepted += usize::from(is_accepted);
        // What was accepted once can be written back.
        assert!(!is_accepted || Original::open(&file, &LoadLimits::default()).is_ok());
    }
    // Neither is everything refused at the door, nor nothing.
    assert!((500..19_500).contains(&accepted), "{accepted}");
}

/// Every number of the document replaced by numbers at the ends of all ranges.
#[test]
fn extreme_numbers_do_not_panic() {
    let extremes = [
        "0",
        "-1",
        "1",
        "255",
        "65535",
        "4294967295",
        "4294967296",
        "18446744073709551615",
        "1e308",
        "3e38",
        "-0.0",
        "null",
    ];
    let text = SQUARE.as_bytes();
    let mut at = 0;
    let mut numbers = 0;
    while at < text.len() {
        let is_start =
            text[at].is_ascii_digit() && !text[at - 1].is_ascii_alphanumeric() && !b"._\"".contains(&text[at - 1]);
        let length = text[at..].iter().take_while(|c| c.is_ascii_digit() || **c == b'.').count();
        if is_start {
            numbers += 1;
            for extreme in extremes {
                let json = format!("{}{extreme}{}", &SQUARE[..at], &SQUARE[at + length..]);
                let _ = load(&glb(&json, &square_data()));
            }
        }
        at += length.max(1);
    }
    assert!(numbers > 50, "{numbers}");
}
