//! The laws of deltas and what malformed bytes may do: be refused.

use glam::Vec3;
use proptest::prelude::*;

use super::*;

/// Any bits at all: NaN with payloads, infinities, subnormals, −0; often equal ones.
fn float() -> impl Strategy<Value = f32> {
    prop_oneof![
        any::<u32>().prop_map(f32::from_bits),
        Just(0.0),
        Just(-0.0),
        Just(f32::NAN),
        (0u8..4).prop_map(|x| f32::from(x) * 0.5),
    ]
}

fn value() -> impl Strategy<Value = Vec3> {
    (float(), float(), float()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
}

fn map(max: usize) -> impl Strategy<Value = Vec<Vec3>> {
    prop::collection::vec(value(), 0..max)
}

/// A valid frame over the first few dozen elements: gaps of 0 make touching runs, which the format allows.
fn frame() -> impl Strategy<Value = Frame> {
    let runs = prop::collection::vec((0u32..6, 1u32..7), 0..8);
    (runs, any::<(bool, bool)>(), prop::collection::vec(value(), 56)).prop_map(|(runs, (half, replace_all), pool)| {
        let mut frame = Frame { flags: FrameFlags { last: true, replace_all, half: false }, ..Frame::default() };
        let mut at = 0;
        for (gap, count) in runs {
            frame.runs.push(Run { first: at + gap, count });
            at += gap + count;
        }
        let count = frame.runs.iter().map(|run| run.count as usize).sum();
        frame.values = pool[..count].to_vec();
        frame.base = 1;
        frame.new = 2;
        if half { frame.halved() } else { frame }
    })
}

/// Frames that follow each other from version 1 on.
fn chain(len: usize) -> impl Strategy<Value = Vec<Frame>> {
    prop::collection::vec(frame(), len).prop_map(|mut frames| {
        for (i, frame) in frames.iter_mut().enumerate() {
            frame.base = if frame.flags.replace_all { 0 } else { i as u64 + 1 };
            frame.new = i as u64 + 2;
        }
        frames
    })
}

fn bits(map: &[Vec3]) -> Vec<[u32; 3]> {
    map.iter().map(|v| v.to_array().map(f32::to_bits)).collect()
}

fn applied(frames: &[&Frame], map: &[Vec3]) -> Vec<[u32; 3]> {
    let mut map = map.to_vec();
    for frame in frames {
        frame.apply(&mut map).expect("a valid frame applies");
    }
    bits(&map)
}

/// Recomputes the checksum, so that a tampered payload gets past it.
fn resealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let checksum = crc32fast::hash(&bytes[HEADER_BYTES..]);
    bytes[36..40].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

fn sample() -> Frame {
    let values: Vec<Vec3> = (0..10).map(|i| Vec3::splat(i as f32)).collect();
    Frame::from_changed(&values, |i| i % 5 < 2, 3, 4)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn decode_inverts_encode(frame in frame(), more in prop::collection::vec(any::<u8>(), 0..20)) {
        let mut bytes = frame.encode();
        prop_assert_eq!(bytes.len(), frame.encoded_bytes());
        let len = bytes.len();
        bytes.extend(more);
        prop_assert_eq!(Frame::decode(&bytes), Ok((frame, len)));
    }

    #[test]
    fn merging_is_applying_in_turn(frames in chain(2), map in map(40)) {
        let merged = Frame::merge(&frames[0], &frames[1]).expect("a chain merges");
        prop_assert_eq!(merged.validate(), Ok(()));
        prop_assert_eq!(applied(&[&merged], &map), applied(&[&frames[0], &frames[1]], &map));
    }

    #[test]
    fn merging_is_associative(frames in chain(3)) {
        let [a, b, c] = [&frames[0], &frames[1], &frames[2]];
        let left = Frame::merge(&Frame::merge(a, b).expect("merges"), c).expect("merges");
        let right = Frame::merge(a, &Frame::merge(b, c).expect("merges")).expect("merges");
        prop_assert_eq!(left, right);
    }

    #[test]
    fn nothing_lies_between_equals(map in map(40)) {
        prop_assert!(Frame::between(&map, &map, 1, 2).is_empty());
    }

    #[test]
    fn between_leads_from_old_to_new(
        old in map(40), new in map(40), copied in prop::collection::vec(any::<bool>(), 40)
    ) {
        let mut new = new;
        for ((n, o), copied) in new.iter_mut().zip(&old).zip(copied) {
            if copied { *n = *o; }
        }
        let frame = Frame::between(&old, &new, 1, 2);
        prop_assert_eq!(frame.validate(), Ok(()));
        prop_assert_eq!(applied(&[&frame], &old), bits(&new));
        prop_assert_eq!(applied(&[&Frame::whole(&new, 2)], &old), bits(&new));
    }

    #[test]
    fn between_is_as_small_as_can_be(old in map(40), new in map(40)) {
        prop_assume!(new.len() >= old.len());
        let frame = Frame::between(&old, &new, 1, 2);
        let changed = (0..new.len()).filter(|i| *i >= old.len() || !same_bits(old[*i], new[*i])).count();
        prop_assert_eq!(frame.values.len(), changed);
        prop_assert!(frame.runs.windows(2).all(|pair| pair[0].end() < u64::from(pair[1].first)));
    }

    #[test]
    fn parts_make_the_whole(frame in frame(), max in 1usize..9, map in map(40)) {
        let parts = frame.clone().split(max);
        prop_assert!(parts.iter().all(|part| part.values.len() <= max && part.validate().is_ok()));
        prop_assert!(parts.iter().rev().skip(1).all(|part| !part.flags.last));
        prop_assert!(parts.iter().skip(1).all(|part| !part.flags.replace_all));
        prop_assert!(parts.last().is_some_and(|part| part.flags.last));
        prop_assert_eq!(applied(&parts.iter().collect::<Vec<_>>(), &map), applied(&[&frame], &map));
        let merged = parts[1..].iter().try_fold(parts[0].clone(), |all, part| Frame::merge(&all, part));
        prop_assert_eq!(applied(&[&merged.expect("parts merge")], &map), applied(&[&frame], &map));
    }

    #[test]
    fn a_stream_in_pieces_gives_the_same_frames(frames in chain(4), piece in 1usize..97) {
        let bytes: Vec<u8> = frames.iter().flat_map(Frame::encode).collect();
        let mut decoder = Decoder::new();
        let mut found = Vec::new();
        for piece in bytes.chunks(piece) {
            decoder.push(piece);
            while let Some((frame, _)) = decoder.next_frame().expect("well-formed") {
                found.push(frame);
            }
        }
        prop_assert_eq!(found, frames);
        prop_assert_eq!(decoder.pending_bytes(), 0);
    }

    #[test]
    fn halving_is_done_once_and_close(frame in frame()) {
        let once = frame.clone().halved();
        prop_assert_eq!(&once.clone().halved(), &once);
        for (a, b) in frame.values.iter().zip(&once.values) {
            for (a, b) in a.to_array().into_iter().zip(b.to_array()) {
                prop_assert_eq!(a.is_finite(), b.is_finite());
                prop_assert!(!(6.2e-5..65504.0).contains(&a.abs()) || (a - b).abs() <= a.abs() / 2048.0);
            }
        }
    }

    #[test]
    fn random_bytes_are_refused(bytes in prop::collection::vec(any::<u8>(), 0..120)) {
        prop_assert!(Frame::decode(&bytes).is_err());
    }

    #[test]
    fn random_headers_and_payloads_are_refused_or_valid(
        flags in 0u16..8,
        counts in (0u32..4, 0u32..8, prop_oneof![Just(None), any::<u32>().prop_map(Some)]),
        payload in prop::collection::vec(prop_oneof![0u8..3, any::<u8>()], 0..130),
    ) {
        let (runs, values, claimed) = counts;
        let sum = runs * 8 + values * if flags & 4 != 0 { 6 } else { 12 };
        let mut bytes = Frame::default().encode();
        bytes[6..8].copy_from_slice(&flags.to_le_bytes());
        bytes[24..28].copy_from_slice(&runs.to_le_bytes());
        bytes[28..32].copy_from_slice(&values.to_le_bytes());
        bytes[32..36].copy_from_slice(&claimed.unwrap_or(sum).to_le_bytes());
        bytes.extend(payload.iter().cycle().take(sum as usize));
        if let Ok((frame, used)) = Frame::decode(&resealed(bytes.clone())) {
            prop_assert_eq!(frame.validate(), Ok(()));
            prop_assert_eq!(used, bytes.len());
        }
    }

    #[test]
    fn a_cut_frame_says_how_much_is_missing(frame in frame(), at in any::<prop::sample::Index>()) {
        let bytes = frame.encode();
        let cut = at.index(bytes.len());
        let needed = if cut < HEADER_BYTES { HEADER_BYTES } else { bytes.len() };
        prop_assert_eq!(Frame::decode(&bytes[..cut]), Err(DeltaError::Incomplete { needed }));
    }

    #[test]
    fn any_damage_to_the_payload_is_seen(frame in frame(), at in any::<prop::sample::Index>(), bit in 0u8..8) {
        let mut bytes = frame.encode();
        prop_assume!(bytes.len() > HEADER_BYTES);
        let at = HEADER_BYTES + at.index(bytes.len() - HEADER_BYTES);
        bytes[at] ^= 1 << bit;
        let checksum = matches!(Frame::decode(&bytes), Err(DeltaError::Checksum { .. }));
        prop_assert!(checksum);
    }
}

#[test]
fn the_header_is_as_documented() {
    let frame = Frame {
        flags: FrameFlags { last: true, replace_all: false, half: false },
        base: 0x0102_0304_0506_0708,
        new: 9,
        runs: vec![Run { first: 7, count: 1 }],
        values: vec![Vec3::new(1.0, 2.0, -0.0)],
    };
    let mut expected = b"RBKD\x01\0\x01\0\x08\x07\x06\x05\x04\x03\x02\x01\x09\0\0\0\0\0\0\0".to_vec();
    expected.extend(b"\x01\0\0\0\x01\0\0\0\x14\0\0\0");
    let payload = b"\x07\0\0\0\x01\0\0\0\0\0\x80\x3f\0\0\0\x40\0\0\0\x80";
    // CRC-32 of the payload from Python's zlib.crc32.
    expected.extend(0xe23f_71e4_u32.to_le_bytes());
    expected.extend(payload);
    assert_eq!(frame.encode(), expected);
    let half = Frame { flags: FrameFlags { half: true, ..frame.flags }, ..frame }.encode();
    assert_eq!(half[6..8], [5, 0]);
    assert_eq!(half[48..], [0, 0x3c, 0, 0x40, 0, 0x80]);
}

#[test]
fn wrong_magic_version_and_flags_are_refused() {
    let bytes = sample().encode();
    let with = |at: usize, byte: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = byte;
        Frame::decode(&bytes)
    };
    assert_eq!(with(0, b'X'), Err(DeltaError::Magic));
    assert_eq!(Frame::decode(b"GL"), Err(DeltaError::Magic));
    assert_eq!(with(4, 2), Err(DeltaError::Version(2)));
    assert_eq!(with(6, 0x10), Err(DeltaError::Flags(0x10)));
    assert_eq!(Frame::decode(b""), Err(DeltaError::Incomplete { needed: HEADER_BYTES }));
}

#[test]
fn huge_counts_are_refused_before_anything_is_allocated() {
    let with_counts = |runs: u32, values: u32, payload: u32| {
        let mut bytes = Frame::default().encode();
        bytes[24..28].copy_from_slice(&runs.to_le_bytes());
        bytes[28..32].copy_from_slice(&values.to_le_bytes());
        bytes[32..36].copy_from_slice(&payload.to_le_bytes());
        Frame::decode(&bytes)
    };
    assert!(matches!(with_counts(u32::MAX, u32::MAX, u32::MAX), Err(DeltaError::TooLong { .. })));
    assert!(matches!(with_counts(u32::MAX, 1, u32::MAX), Err(DeltaError::Malformed(_))));
    assert!(matches!(with_counts(1, 1, u32::MAX), Err(DeltaError::Malformed(_))));
    // 8 · r + 12 · v wraps to 20 in 32 bits.
    assert!(matches!(with_counts(0x2000_0001, 0x2000_0001, 20), Err(DeltaError::TooLong { .. })));
    let most = MAX_ELEMENTS as u32;
    let needed = HEADER_BYTES + 8 + MAX_ELEMENTS * 12;
    assert_eq!(with_counts(1, most, 8 + 12 * most), Err(DeltaError::Incomplete { needed }));
}

#[test]
fn runs_that_lie_are_refused() {
    let decode = |runs: &[(u32, u32)], values: usize| {
        let frame = Frame { values: vec![Vec3::ONE; values], ..Frame::default() };
        let mut bytes = frame_bytes_unchecked(&frame, runs);
        bytes = resealed(bytes);
        Frame::decode(&bytes).map(|_| ())
    };
    assert_eq!(decode(&[(0, 2), (2, 1)], 3), Ok(()), "touching runs are allowed");
    assert!(matches!(decode(&[(0, 2), (1, 1)], 3), Err(DeltaError::Malformed(_))), "overlap");
    assert!(matches!(decode(&[(5, 1), (0, 2)], 3), Err(DeltaError::Malformed(_))), "order");
    assert!(matches!(decode(&[(0, 0), (0, 3)], 3), Err(DeltaError::Malformed(_))), "empty run");
    assert!(matches!(decode(&[(0, 2)], 3), Err(DeltaError::Malformed(_))), "too few");
    assert!(matches!(decode(&[(0, u32::MAX)], 3), Err(DeltaError::Malformed(_))), "too many");
    assert!(matches!(decode(&[(u32::MAX, 3)], 3), Err(DeltaError::TooLong { .. })), "past u32");
    assert!(matches!(decode(&[(MAX_ELEMENTS as u32 - 2, 3)], 3), Err(DeltaError::TooLong { .. })), "past the limit");
}

/// Encodes `frame`'s values with runs that need not be valid.
fn frame_bytes_unchecked(frame: &Frame, runs: &[(u32, u32)]) -> Vec<u8> {
    let mut bytes = Frame::default().encode();
    let payload = (runs.len() * 8 + frame.values.len() * 12) as u32;
    bytes[24..28].copy_from_slice(&(runs.len() as u32).to_le_bytes());
    bytes[28..32].copy_from_slice(&(frame.values.len() as u32).to_le_bytes());
    bytes[32..36].copy_from_slice(&payload.to_le_bytes());
    for (first, count) in runs {
        bytes.extend(first.to_le_bytes());
        bytes.extend(count.to_le_bytes());
    }
    for value in &frame.values {
        bytes.extend(value.to_array().into_iter().flat_map(f32::to_le_bytes));
    }
    bytes
}

#[test]
fn a_refused_frame_leaves_the_map_alone() {
    let mut map = vec![Vec3::ONE; 4];
    let frame = Frame { runs: vec![Run { first: 0, count: 3 }], values: vec![Vec3::ZERO; 2], ..Frame::default() };
    assert!(matches!(frame.apply(&mut map), Err(DeltaError::Malformed(_))));
    let frame = Frame::whole(&[Vec3::ZERO; 9], 1);
    assert_eq!(frame.apply_within(&mut map, 8), Err(DeltaError::TooLong { end: 9, limit: 8 }));
    assert_eq!(map, vec![Vec3::ONE; 4]);
}

#[test]
fn a_gap_between_versions_does_not_merge() {
    let a = Frame { new: 5, ..sample() };
    let b = Frame { base: 6, new: 7, ..sample() };
    assert_eq!(Frame::merge(&a, &b), Err(DeltaError::Gap { version: 5, base: 6 }));
    assert!(Frame::merge(&a, &Frame::whole(&[Vec3::ONE], 9)).is_ok());
}

#[test]
fn parts_merge_in_any_grouping() {
    let map: Vec<Vec3> = (0..10).map(|i| Vec3::splat(i as f32)).collect();
    let before = Frame::from_changed(&map, |i| i == 3, 2, 3);
    let parts = sample().split(2);
    assert_eq!(parts.len(), 2);
    let left = Frame::merge(&Frame::merge(&before, &parts[0]).unwrap(), &parts[1]).unwrap();
    let right = Frame::merge(&before, &Frame::merge(&parts[0], &parts[1]).unwrap()).unwrap();
    assert_eq!(left, right);
    assert!(left.flags.last);
    assert_eq!((left.base, left.new), (2, 4));
}

#[test]
fn an_empty_map_is_a_frame_too() {
    let mut map = vec![Vec3::ONE];
    let whole = Frame::whole(&[], 3);
    assert!(!whole.is_empty(), "it empties the map");
    whole.apply(&mut map).unwrap();
    assert!(map.is_empty());
}
