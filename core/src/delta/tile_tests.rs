//! The laws of tiles, and what malformed bytes may do: be refused.

use glam::Vec3;
use proptest::prelude::*;

use super::tiles::{MAX_TEXELS, Tile, TileFrame, TilePage, grid};
use super::wire::to_half;
use super::*;

const SIDE: u32 = 4;

/// Any bits at all, and often equal ones.
fn value() -> impl Strategy<Value = Vec3> {
    let float = prop_oneof![
        any::<u32>().prop_map(f32::from_bits),
        Just(0.0),
        Just(-0.0),
        Just(f32::NAN),
        (0u8..3).prop_map(f32::from)
    ];
    prop::array::uniform3(float).prop_map(Vec3::from)
}

fn page() -> impl Strategy<Value = TilePage> {
    (1u32..11, 1u32..11).prop_flat_map(|(width, height)| {
        let texel = (value(), any::<bool>());
        prop::collection::vec(texel, (width * height) as usize).prop_map(move |texels| {
            let (values, valid) = texels.into_iter().unzip();
            TilePage { size: [width, height], values, valid }
        })
    })
}

fn tiles_of(index: usize, page: &TilePage) -> Vec<Tile> {
    let texels = (page.size[0] as usize, &page.values[..], &page.valid[..]);
    grid(page.size, SIDE).map(|(corner, size)| Tile::cut(index as u32, texels, corner, size)).collect()
}

/// All tiles in which pages differ; all of a page that is new or has another size.
fn between(old: &[TilePage], new: &[TilePage]) -> TileFrame {
    let tiles = new.iter().enumerate().flat_map(|(index, page)| {
        let known = old.get(index).filter(|known| known.size == page.size).map(|known| tiles_of(index, known));
        let is_new = move |(k, tile): &(usize, Tile)| known.as_ref().is_none_or(|known| known[*k] != *tile);
        tiles_of(index, page).into_iter().enumerate().filter(is_new).map(|(_, tile)| tile).collect::<Vec<_>>()
    });
    let flags = FrameFlags { last: true, ..FrameFlags::default() };
    TileFrame { flags, base: 1, new: 2, tiles: tiles.collect(), pages: new.iter().map(|page| page.size).collect() }
}

fn sample() -> TileFrame {
    let mut page = TilePage::empty([6, 5]);
    (0..30).for_each(|k| (page.values[k], page.valid[k]) = (Vec3::splat(k as f32), k % 3 == 0));
    between(&[], &[page])
}

/// Recomputes the checksum, so that a tampered payload gets past it.
fn resealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let checksum = crc32fast::hash(&bytes[HEADER_BYTES..]);
    bytes[36..40].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn decode_inverts_encode(
        pages in prop::collection::vec(page(), 0..4), (half, last, replace_all) in any::<(bool, bool, bool)>(),
        more in prop::collection::vec(any::<u8>(), 0..20)
    ) {
        let mut frame = between(&[], &pages);
        frame.flags = FrameFlags { last, replace_all, half };
        if half {
            let halve = |value: &mut Vec3| *value = value.to_array().map(|x| to_half(x).to_f32()).into();
            frame.tiles.iter_mut().for_each(|tile| tile.values.iter_mut().for_each(halve));
        }
        let mut bytes = frame.encode();
        prop_assert_eq!(bytes.len(), frame.encoded_bytes());
        let len = bytes.len();
        bytes.extend(more);
        prop_assert_eq!(TileFrame::decode(&bytes), Ok((frame, len)));
    }

    #[test]
    fn what_differs_leads_from_old_to_new(
        old in prop::collection::vec(page(), 0..4), new in prop::collection::vec(page(), 0..4),
        is_like in prop::collection::vec(any::<bool>(), 4), changed in prop::collection::vec((any::<u16>(), value()), 0..4)
    ) {
        let mut new = new;
        for (k, is_like) in is_like.into_iter().enumerate().take(old.len().min(new.len())) {
            if is_like {
                new[k] = old[k].clone();
            }
        }
        for (at, value) in changed {
            if let Some(page) = new.first_mut() {
                let at = usize::from(at) % page.values.len();
                page.values[at] = value;
            }
        }
        let mut client = old.clone();
        between(&old, &new).apply(&mut client).expect("it is valid");
        prop_assert_eq!(&client, &new);
        prop_assert!(between(&new, &client).tiles.is_empty());
        // From nothing, empty tiles need not be told.
        let mut whole = between(&[], &new);
        whole.flags.replace_all = true;
        whole.tiles.retain(|tile| !tile.is_empty());
        let mut client = old;
        whole.apply(&mut client).expect("it is valid");
        prop_assert_eq!(client, new);
    }

    #[test]
    fn noise_is_refused(noise in prop::collection::vec(any::<u8>(), 0..200), at in 0usize..200, byte: u8) {
        let _ = TileFrame::decode(&noise);
        // Whatever is changed in a frame that still has a right checksum: refused, or a valid frame.
        let mut bytes = sample().encode();
        let at = at % bytes.len();
        bytes[at] = byte;
        if let Ok((frame, _)) = TileFrame::decode(&resealed(bytes)) {
            prop_assert_eq!(frame.validate(), Ok(()));
        }
    }

    #[test]
    fn tiles_of_a_grid_cover_a_page_once(width in 0u32..40, height in 0u32..40, side in 1u32..9) {
        let mut hits = vec![0; (width * height) as usize];
        for ([x, y], [w, h]) in grid([width, height], side) {
            prop_assert!((1..=side).contains(&w) && (1..=side).contains(&h));
            (y..y + h).for_each(|row| (x..x + w).for_each(|column| hits[(row * width + column) as usize] += 1));
        }
        prop_assert!(hits.iter().all(|hits| *hits == 1));
    }
}

#[test]
fn what_is_cut_short_waits_and_what_is_damaged_is_refused() {
    let good = sample().encode();
    for length in 0..good.len() {
        let needed = if length < HEADER_BYTES { HEADER_BYTES } else { good.len() };
        assert_eq!(TileFrame::decode(&good[..length]), Err(DeltaError::Incomplete { needed }), "{length}");
    }
    let broken = |at: usize, byte: u8| {
        let mut bytes = good.clone();
        bytes[at] = byte;
        TileFrame::decode(&bytes).unwrap_err()
    };
    assert!(matches!(broken(0, b'x'), DeltaError::Malformed(_)));
    assert!(matches!(broken(3, b'D'), DeltaError::Malformed(_)), "frames of elements are something else");
    assert_eq!(broken(4, 2), DeltaError::Version(2));
    assert_eq!(broken(6, 8), DeltaError::Flags(8));
    assert!(matches!(broken(good.len() - 1, 77), DeltaError::Checksum { .. }));
    assert!(matches!(broken(27, 255), DeltaError::Malformed(_)), "more pages than bytes");
    assert!(matches!(broken(31, 255), DeltaError::Malformed(_)), "more tiles than bytes");
}

#[test]
fn places_off_the_pages_are_refused_and_change_nothing() {
    let frame = |change: &dyn Fn(&mut TileFrame)| {
        let mut frame = sample();
        change(&mut frame);
        frame
    };
    let bad = [
        frame(&|frame| frame.tiles[0].page = 1),
        frame(&|frame| frame.tiles[0].corner[0] = u32::MAX),
        frame(&|frame| frame.tiles[1].corner[1] = 2),
        frame(&|frame| frame.tiles[0].size[0] = 0),
        frame(&|frame| frame.pages[0] = [3, 5]),
        frame(&|frame| frame.pages.push([1 << 14, (MAX_TEXELS >> 14) as u32])),
        frame(&|frame| _ = frame.tiles[0].values.pop()),
        frame(&|frame| frame.tiles[0].valid.push(true)),
    ];
    for frame in bad {
        let mut pages = vec![TilePage::empty([2, 2])];
        assert!(matches!(frame.apply(&mut pages), Err(DeltaError::Malformed(_))), "{frame:?}");
        assert_eq!(pages, [TilePage::empty([2, 2])]);
    }
}

#[test]
fn pages_that_grow_keep_what_they_have_and_pages_that_go_are_dropped() {
    let (mut pages, frame) = (Vec::new(), sample());
    frame.apply(&mut pages).unwrap();
    let small = pages[0].clone();
    let sizes = |pages: Vec<[u32; 2]>| TileFrame { pages, flags: frame.flags, ..TileFrame::default() };
    sizes(vec![[8, 7], [2, 2]]).apply(&mut pages).unwrap();
    assert_eq!(
        (pages.len(), pages[0].values[8 * 3 + 2], pages[0].values[8 * 6 + 7]),
        (2, small.values[6 * 3 + 2], Vec3::ZERO)
    );
    assert_eq!(pages[1], TilePage::empty([2, 2]));
    sizes(vec![[6, 5]]).apply(&mut pages).unwrap();
    assert_eq!(pages, [small]);
}
