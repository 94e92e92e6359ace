//! Light maps as bytes, little-endian: a magic, the number of slots and of layers, the values of the whole, then layer
//! after layer: its name, its lights with their reference strengths, the number of its blocks, and of every block its index
//! and its values. Values are direct, indirect and variance of all slots of the whole or a block, as `f32`. Maps of the
//! second format have all values of every layer, those of the first have no layers.

use std::sync::Arc;

use glam::Vec3;
use rebake_core::layers::{BLOCK_SLOTS, Layer, LayerLight, LightBlock, LightValues, SparseLight, blocks_of};

use crate::engine::LightMap;

const MAGIC: &[u8; 8] = b"RBKMAP03";
/// With values of all slots in every layer.
const MAGIC_2: &[u8; 8] = b"RBKMAP02";
/// Without layers, and without their number.
const MAGIC_1: &[u8; 8] = b"RBKMAP01";
const BYTES_PER_SLOT: usize = 28;

/// The bytes of a map.
pub(crate) fn encode_map(map: &LightMap) -> Vec<u8> {
    let layers: usize = map.layers.iter().map(|layer| 256 + layer.light.memory_bytes()).sum();
    let mut bytes = Vec::with_capacity(MAGIC.len() + 12 + map.len() * BYTES_PER_SLOT + layers);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&(map.len() as u64).to_le_bytes());
    put_count(&mut bytes, map.layers.len());
    let LightValues { direct, indirect, variance } = &map.light;
    put_values(&mut bytes, &LightBlock { direct, indirect, variance });
    for layer in &map.layers {
        put_name(&mut bytes, &layer.name);
        put_count(&mut bytes, layer.lights.len());
        for light in &layer.lights {
            put_name(&mut bytes, &light.name);
            put_vec3s(&mut bytes, &[light.reference]);
        }
        put_count(&mut bytes, layer.light.blocks().count());
        for (index, block) in layer.light.blocks() {
            put_count(&mut bytes, index);
            put_values(&mut bytes, &block);
        }
    }
    bytes
}

fn put_count(bytes: &mut Vec<u8>, count: usize) {
    bytes.extend_from_slice(&(count as u32).to_le_bytes());
}

fn put_name(bytes: &mut Vec<u8>, name: &str) {
    put_count(bytes, name.len());
    bytes.extend_from_slice(name.as_bytes());
}

fn put_vec3s(bytes: &mut Vec<u8>, values: &[Vec3]) {
    for value in values {
        value.to_array().iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    }
}

fn put_values(bytes: &mut Vec<u8>, light: &LightBlock<'_>) {
    put_vec3s(bytes, light.direct);
    put_vec3s(bytes, light.indirect);
    light.variance.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
}

/// The map of some bytes; none where they are not one.
pub(crate) fn decode_map(bytes: &[u8]) -> Option<LightMap> {
    let formats = [(MAGIC, Format::Blocks), (MAGIC_2, Format::Whole), (MAGIC_1, Format::NoLayers)];
    let (rest, format) = formats.into_iter().find_map(|(magic, format)| Some((bytes.strip_prefix(magic)?, format)))?;
    let mut reader = Reader { rest };
    let len = usize::try_from(u64::from_le_bytes(*reader.chunk::<8>()?)).ok()?;
    let count = if format == Format::NoLayers { 0 } else { reader.count()? };
    let light = reader.values(len)?;
    // A count that lies ends with the bytes.
    let layers = (0..count).map(|_| reader.layer(len, format).map(Arc::new)).collect::<Option<_>>()?;
    reader.rest.is_empty().then_some(LightMap { light, layers })
}

/// What stands there of layers.
#[derive(Clone, Copy, PartialEq)]
enum Format {
    NoLayers,
    Whole,
    Blocks,
}

struct Reader<'a> {
    rest: &'a [u8],
}

impl Reader<'_> {
    fn chunk<const N: usize>(&mut self) -> Option<&[u8; N]> {
        let (chunk, rest) = self.rest.split_first_chunk::<N>()?;
        self.rest = rest;
        Some(chunk)
    }

    fn bytes(&mut self, len: usize) -> Option<&[u8]> {
        let (bytes, rest) = self.rest.split_at_checked(len)?;
        self.rest = rest;
        Some(bytes)
    }

    fn count(&mut self) -> Option<usize> {
        Some(u32::from_le_bytes(*self.chunk::<4>()?) as usize)
    }

    fn name(&mut self) -> Option<String> {
        let len = self.count()?;
        std::str::from_utf8(self.bytes(len)?).ok().map(str::to_owned)
    }

    fn vec3(&mut self) -> Option<Vec3> {
        self.chunk::<12>().map(vec3)
    }

    fn layer(&mut self, len: usize, format: Format) -> Option<Layer> {
        let name = self.name()?;
        let lights = (0..self.count()?).map(|_| Some(LayerLight { name: self.name()?, reference: self.vec3()? }));
        let lights = lights.collect::<Option<_>>()?;
        let light = if format == Format::Blocks { self.blocks(len)? } else { self.values(len)?.into() };
        Some(Layer { name, lights, light })
    }

    fn blocks(&mut self, len: usize) -> Option<SparseLight> {
        let (mut blocks, mut next) = (Vec::new(), 0);
        for _ in 0..self.count()? {
            let index = self.count()?;
            (next..blocks_of(len)).contains(&index).then_some(())?;
            blocks.push((index, self.values(BLOCK_SLOTS.min(len - index * BLOCK_SLOTS))?));
            next = index + 1;
        }
        let blocks = blocks.iter().map(|(index, LightValues { direct, indirect, variance })| {
            (*index, LightBlock { direct, indirect, variance })
        });
        Some(SparseLight::of_blocks(len, blocks))
    }

    /// Direct, indirect and variance of `len` slots.
    fn values(&mut self, len: usize) -> Option<LightValues> {
        let bytes = self.bytes(len.checked_mul(BYTES_PER_SLOT)?)?;
        let (vectors, variance) = bytes.split_at(len * 24);
        let (direct, indirect) = vectors.split_at(len * 12);
        let (direct, indirect) = (vec3s(direct), vec3s(indirect));
        Some(LightValues { direct, indirect, variance: floats(variance).collect() })
    }
}

/// The bytes of versions per slot. Neighbours mostly have the same: zstd makes next to nothing of them.
pub(crate) fn encode_versions(versions: &[u64]) -> std::io::Result<Vec<u8>> {
    let bytes: Vec<u8> = versions.iter().flat_map(|version| version.to_le_bytes()).collect();
    zstd::bulk::compress(&bytes, 1)
}

/// The versions of some bytes; none where there are not `len` of them.
pub(crate) fn decode_versions(bytes: &[u8], len: usize) -> Option<Vec<u64>> {
    let bytes = zstd::bulk::decompress(bytes, len.checked_mul(8)?).ok()?;
    let (versions, rest) = bytes.as_chunks::<8>();
    (rest.is_empty() && versions.len() == len).then(|| versions.iter().map(|v| u64::from_le_bytes(*v)).collect())
}

fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> + '_ {
    bytes.as_chunks::<4>().0.iter().map(|x| f32::from_le_bytes(*x))
}

fn vec3(bytes: &[u8; 12]) -> Vec3 {
    let mut xyz = floats(bytes);
    Vec3::from_array(std::array::from_fn(|_| xyz.next().unwrap_or(0.0)))
}

fn vec3s(bytes: &[u8]) -> Vec<Vec3> {
    bytes.as_chunks::<12>().0.iter().map(vec3).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three slots with what JSON or arithmetic would lose.
    fn odd_map() -> LightMap {
        let mut map = LightMap::black(3);
        map.light.direct[1] = Vec3::new(1.0, -0.0, f32::MIN_POSITIVE);
        map.light.indirect[2] = Vec3::new(f32::INFINITY, 2.0, 3.0);
        map.light.variance[0] = 0.5;
        map
    }

    #[test]
    fn maps_come_back_bit_for_bit_with_their_layers() {
        let mut map = odd_map();
        let part = odd_map().light;
        for (name, lights) in [("Lampe über dem Tisch", &["a", "b"][..]), ("", &[])] {
            let light = |name: &&str| LayerLight { name: (*name).to_owned(), reference: Vec3::new(1.0, 0.0, 1e-30) };
            map.layers.push(Arc::new(Layer {
                name: name.to_owned(),
                lights: lights.iter().map(light).collect(),
                light: LightValues {
                    direct: part.indirect.clone(),
                    indirect: part.direct.clone(),
                    variance: vec![0.1, 0.2, 0.3],
                }
                .into(),
            }));
        }
        for layers in [0, 1, 2] {
            let mut map = map.clone();
            map.layers.truncate(layers);
            let bytes = encode_map(&map);
            let back = decode_map(&bytes).unwrap();
            assert!(back == map && back.light.direct[1].y.is_sign_negative());
            assert!(back.layers.iter().all(|layer| layer.light.at(1).1.y.is_sign_negative()));
            for cut in 0..bytes.len() {
                assert!(decode_map(&bytes[..cut]).is_none(), "{layers} layers, {cut} bytes");
            }
            assert!(decode_map(&[&bytes[..], &[0]].concat()).is_none(), "more than a map");
        }
    }

    #[test]
    fn only_blocks_with_light_are_kept() {
        let mut light = LightValues::black(3 * BLOCK_SLOTS + 5);
        let mut map = LightMap::from(light.clone());
        let empty = encode_map(&map).len();
        for slot in [BLOCK_SLOTS, 3 * BLOCK_SLOTS + 4] {
            light.direct[slot] = Vec3::X;
        }
        map.layers.push(Arc::new(Layer { light: light.into(), ..Layer::default() }));
        let bytes = encode_map(&map);
        // A name, lights, blocks, of which each has an index.
        assert_eq!(bytes.len(), empty + 3 * 4 + 2 * 4 + (BLOCK_SLOTS + 5) * BYTES_PER_SLOT);
        assert!(decode_map(&bytes).unwrap() == map);
        // Blocks that are not there, or not in their order.
        let first = empty + 3 * 4;
        for index in [3_u32, 4, u32::MAX] {
            let mut wrong = bytes.clone();
            wrong[first..first + 4].copy_from_slice(&index.to_le_bytes());
            assert!(decode_map(&wrong).is_none(), "{index}");
        }
    }

    #[test]
    fn maps_of_the_second_format_are_read() {
        let mut map = odd_map();
        map.layers.push(Arc::new(Layer { name: "a".to_owned(), light: odd_map().light.into(), ..Layer::default() }));
        let mut bytes = encode_map(&map);
        bytes[..8].copy_from_slice(MAGIC_2);
        assert!(decode_map(&bytes).is_none(), "the second format has no blocks");
        // The number of blocks, and the index of the only one.
        let blocks = bytes.len() - 3 * BYTES_PER_SLOT - 8;
        bytes.drain(blocks..blocks + 8);
        assert!(decode_map(&bytes).unwrap() == map);
        assert!(decode_map(&bytes[..bytes.len() - 1]).is_none());
    }

    #[test]
    fn maps_of_the_first_format_are_read() {
        let map = odd_map();
        let mut bytes = encode_map(&map);
        bytes[..8].copy_from_slice(MAGIC_1);
        assert!(decode_map(&bytes).is_none(), "the first format has no number of layers");
        bytes.drain(16..20);
        assert!(decode_map(&bytes).unwrap() == map);
        assert!(decode_map(&bytes[..bytes.len() - 1]).is_none());
    }

    #[test]
    fn versions_come_back_and_only_as_many_as_there_are() {
        let versions = [0, 7, 7, u64::MAX];
        let bytes = encode_versions(&versions).unwrap();
        assert_eq!(decode_versions(&bytes, 4).unwrap(), versions);
        assert!(decode_versions(&bytes, 3).is_none() && decode_versions(&bytes, 5).is_none());
        assert!(decode_versions(&bytes[1..], 4).is_none());
    }
}
