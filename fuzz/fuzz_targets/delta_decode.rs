//! Delta streams: any bytes in pieces of any size give frames that are sound, or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rebake_core::delta::Decoder;

fuzz_target!(|data: &[u8]| {
    let Some((size, stream)) = data.split_first() else { return };
    let mut decoder = Decoder::new();
    for piece in stream.chunks(1 + usize::from(*size)) {
        decoder.push(piece);
        while let Ok(Some((frame, used))) = decoder.next_frame() {
            assert!(used <= stream.len());
            frame.validate().expect("what is decoded is sound");
            let mut map = Vec::new();
            // The length of the map is bounded by what the caller allows, whatever the frame says.
            let _ = frame.apply_within(&mut map, 1000);
            assert!(map.len() <= 1000);
        }
    }
});
