//! Light maps as bytes: a magic, the number of slots, then direct, indirect and variance, little-endian `f32`.

use glam::Vec3;

use crate::engine::LightMap;

const MAP_MAGIC: &[u8; 8] = b"RBKMAP01";
const BYTES_PER_SLOT: usize = 28;

/// The bytes of a map.
pub(super) fn encode_map(map: &LightMap) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(MAP_MAGIC.len() + 8 + map.len() * BYTES_PER_SLOT);
    bytes.extend_from_slice(MAP_MAGIC);
    bytes.extend_from_slice(&(map.len() as u64).to_le_bytes());
    for value in map.direct.iter().chain(&map.indirect) {
        value.to_array().iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    }
    map.variance.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    bytes
}

/// The map of some bytes; none where they are not one.
pub(super) fn decode_map(bytes: &[u8]) -> Option<LightMap> {
    let rest = bytes.strip_prefix(MAP_MAGIC)?;
    let (len, rest) = rest.split_first_chunk::<8>()?;
    let len = usize::try_from(u64::from_le_bytes(*len)).ok()?;
    if len.checked_mul(BYTES_PER_SLOT)? != rest.len() {
        return None;
    }
    let (vectors, variance) = rest.split_at(len * 24);
    let (direct, indirect) = vectors.split_at(len * 12);
    Some(LightMap {
        direct: vec3s(direct),
        indirect: vec3s(indirect),
        variance: floats(variance).collect(),
        layers: Vec::new(),
    })
}

/// The bytes of versions per slot. Neighbours mostly have the same: zstd makes next to nothing of them.
pub(super) fn encode_versions(versions: &[u64]) -> std::io::Result<Vec<u8>> {
    let bytes: Vec<u8> = versions.iter().flat_map(|version| version.to_le_bytes()).collect();
    zstd::bulk::compress(&bytes, 1)
}

/// The versions of some bytes; none where there are not `len` of them.
pub(super) fn decode_versions(bytes: &[u8], len: usize) -> Option<Vec<u64>> {
    let bytes = zstd::bulk::decompress(bytes, len.checked_mul(8)?).ok()?;
    let (versions, rest) = bytes.as_chunks::<8>();
    (rest.is_empty() && versions.len() == len).then(|| versions.iter().map(|v| u64::from_le_bytes(*v)).collect())
}

fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> + '_ {
    bytes.as_chunks::<4>().0.iter().map(|x| f32::from_le_bytes(*x))
}

fn vec3s(bytes: &[u8]) -> Vec<Vec3> {
    let read = |at: &[u8; 12]| {
        let mut xyz = floats(at);
        Vec3::from_array(std::array::from_fn(|_| xyz.next().unwrap_or(0.0)))
    };
    bytes.as_chunks::<12>().0.iter().map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_and_versions_come_back_bit_for_bit() {
        let mut map = LightMap::black(3);
        map.direct[1] = Vec3::new(1.0, -0.0, f32::MIN_POSITIVE);
        map.indirect[2] = Vec3::new(f32::INFINITY, 2.0, 3.0);
        map.variance[0] = 0.5;
        let bytes = encode_map(&map);
        let back = decode_map(&bytes).unwrap();
        assert!(back == map && back.direct[1].y.is_sign_negative());
        for cut in 0..bytes.len() {
            assert!(decode_map(&bytes[..cut]).is_none());
        }
        let versions = [0, 7, 7, u64::MAX];
        let bytes = encode_versions(&versions).unwrap();
        assert_eq!(decode_versions(&bytes, 4).unwrap(), versions);
        assert!(decode_versions(&bytes, 3).is_none() && decode_versions(&bytes, 5).is_none());
        assert!(decode_versions(&bytes[1..], 4).is_none());
    }
}
