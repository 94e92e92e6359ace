//! Textures: their means, their places, and what is not there.

use std::io::Cursor;

use glam::{Vec2, Vec3};
use image::ImageFormat;

use super::*;
use crate::scene::{AlphaMode, Wrap};

/// The square with a picture as its base colour and emissive texture, and texture coordinates that are its positions.
fn textured(image: &[u8], edits: &[(&str, &str)]) -> Vec<u8> {
    let mut bin = square_data();
    // The square's texture coordinates.
    bin.extend([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0_f32]].iter().flatten().flat_map(|c| c.to_le_bytes()));
    let start = bin.len();
    bin.extend(image);
    bin.resize(bin.len().next_multiple_of(4), 0);
    let texture =
        "\"emissiveTexture\": {\"index\": 0}, \"pbrMetallicRoughness\": {\"baseColorTexture\": {\"index\": 0}, ";
    let images =
        "\"textures\": [{\"source\": 0}], \"images\": [{\"bufferView\": 6, \"mimeType\": \"image/png\"}], \"meshes\"";
    let views = format!(
        "\"byteLength\": 16}}, {{\"buffer\": 0, \"byteOffset\": 128, \"byteLength\": 32}}, \
         {{\"buffer\": 0, \"byteOffset\": {start}, \"byteLength\": {}}}",
        image.len()
    );
    let texcoords =
        "\"type\": \"SCALAR\"}, {\"bufferView\": 5, \"componentType\": 5126, \"count\": 4, \"type\": \"VEC2\"}";
    let mut json = SQUARE
        .replace("\"pbrMetallicRoughness\": {", texture)
        .replace("\"meshes\"", images)
        .replace("\"NORMAL\": 1}", "\"NORMAL\": 1, \"TEXCOORD_0\": 3}")
        .replace("\"type\": \"SCALAR\"}", texcoords)
        .replace("\"byteLength\": 16}", &views)
        .replace("[{\"byteLength\": 128}]", &format!("[{{\"byteLength\": {}}}]", bin.len()));
    for (from, to) in edits {
        assert!(json.contains(from), "{from}: {json}");
        json = json.replace(from, to);
    }
    glb(&json, &bin)
}

/// Left half black, right half red.
fn encoded(format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let picture = image::RgbImage::from_fn(16, 8, |x, _| image::Rgb(if x < 8 { [0, 0, 0] } else { [255, 0, 0] }));
    picture.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// No material reads the second set; light maps may.
#[test]
fn second_coordinates_are_read_where_they_can_be() {
    let picture = encoded(ImageFormat::Png);
    let second = ("\"TEXCOORD_0\": 3}", "\"TEXCOORD_0\": 3, \"TEXCOORD_1\": 3}");
    let [without, with] = [&[][..], &[second]].map(|edits| load(&textured(&picture, edits)).unwrap());
    assert!(without.objects[0].mesh.texcoords[1].is_empty());
    assert_eq!(with.objects[0].mesh.texcoords[1], with.objects[0].mesh.texcoords[0]);
    // Normals are no texture coordinates.
    let wrong = ("\"TEXCOORD_0\": 3}", "\"TEXCOORD_0\": 3, \"TEXCOORD_1\": 1}");
    assert!(load(&textured(&picture, &[wrong])).unwrap().objects[0].mesh.texcoords[1].is_empty());
}

#[test]
fn embedded_textures_count_with_their_mean() {
    for (format, tolerance) in [(ImageFormat::Png, 1e-4), (ImageFormat::WebP, 1e-4), (ImageFormat::Jpeg, 0.02)] {
        let scene = load(&textured(&encoded(format), &[])).unwrap();
        let paint = scene.objects[0].materials[0];
        assert!(paint.albedo.distance(Vec3::new(0.25, 0.0, 0.0)) < tolerance, "{paint:?}");
        let shown = paint.emission * scene.objects[0].mean_emission(0);
        assert!(shown.distance(Vec3::new(1.5, 0.0, 0.0)) < 3.0 * tolerance, "{shown}");
        assert_eq!(paint.emission, Vec3::new(3.0, 1.5, 0.0));
        assert_eq!(scene.lights[0].strength(), paint.emission);
        assert!(scene.warnings.iter().any(|text| text.contains("mean colour")), "{:?}", scene.warnings);
    }
}

#[test]
fn places_of_textures_are_kept() {
    let scene = load(&textured(&encoded(ImageFormat::Png), &[])).unwrap();
    let (object, mesh) = (&scene.objects[0], &scene.objects[0].mesh);
    let look = object.looks[0].as_ref().unwrap();
    assert_eq!(
        (look.factor, look.emission, look.alpha_mode),
        (Vec3::new(0.5, 0.25, 0.125), Vec3::new(3.0, 1.5, 0.0), AlphaMode::Opaque)
    );
    assert_eq!((mesh.texcoords[0].len(), mesh.texcoords[1].len(), mesh.colors.len()), (4, 0, 0));
    let texture = look.base_color.as_ref().unwrap();
    assert_eq!(texture.wrap, [Wrap::Repeat; 2]);
    // The lower right triangle is red over three quarters.
    let corners = mesh.triangles[0].map(|corner| mesh.texcoords[0][corner as usize]);
    let mean = texture.mean_over(corners);
    assert!((mean.color - Vec3::X * 0.75).abs().max_element() < 1e-4, "{mean:?}");
    // The same picture is kept once.
    assert!(std::sync::Arc::ptr_eq(&texture.texture, &look.emissive.as_ref().unwrap().texture));
}

/// What shows a black part of its emissive texture is no light.
#[test]
fn what_shows_no_light_is_none() {
    let emissive = "\"emissiveTexture\": {\"index\": 0}";
    let part = |offset: f32| {
        let transform = format!("{{\"scale\": [0.4, 1], \"offset\": [{offset}, 0]}}");
        let extensions = format!("\"extensions\": {{\"KHR_texture_transform\": {transform}}}");
        let edit = emissive.replace("0}", &format!("0, {extensions}}}"));
        load(&textured(&encoded(ImageFormat::Png), &[(emissive, &edit)])).unwrap().lights.len()
    };
    assert_eq!(part(0.55), part(0.05) + 1);
}

/// Rotation turns counter-clockwise about the upper left corner, scale comes before it, offset behind.
#[test]
fn transforms_of_textures_are_read() {
    let transform = "\"baseColorTexture\": {\"index\": 0, \"texCoord\": 1, \"extensions\": {\"KHR_texture_transform\": \
                     {\"offset\": [0.25, 1], \"rotation\": 1.5707964, \"scale\": [0.5, 2], \"texCoord\": 0}}}";
    let scene =
        load(&textured(&encoded(ImageFormat::Png), &[("\"baseColorTexture\": {\"index\": 0}", transform)])).unwrap();
    let look = scene.objects[0].looks[0].as_ref().unwrap();
    let texture = look.base_color.as_ref().unwrap();
    assert_eq!(texture.texcoord, 0);
    for (from, to) in [(Vec2::ZERO, [0.25, 1.0]), (Vec2::X, [0.25, 0.5]), (Vec2::Y, [2.25, 1.0])] {
        assert!(texture.map(from).distance(Vec2::from_array(to)) < 1e-5, "{from}: {}", texture.map(from));
    }
}

#[test]
fn missing_textures_are_grey_unless_the_file_requires_them() {
    let elsewhere = ("{\"bufferView\": 6, \"mimeType\": \"image/png\"}", "{\"uri\": \"wood.png\"}");
    let avif = ("[{\"source\": 0}]", "[{\"extensions\": {\"EXT_texture_avif\": {\"source\": 0}}}]");
    let webp = ("[{\"source\": 0}]", "[{\"extensions\": {\"EXT_texture_webp\": {\"source\": 0}}}]");
    let png = encoded(ImageFormat::Png);
    for edit in [elsewhere, avif] {
        let scene = load(&textured(&png, &[edit])).unwrap();
        assert_eq!(scene.objects[0].materials[0].albedo, Vec3::new(0.25, 0.125, 0.0625));
        assert!(scene.warnings.iter().any(|text| text.contains("albedo")), "{:?}", scene.warnings);
    }
    let beside = "[{\"source\": 0, \"extensions\": {\"EXT_texture_avif\": {\"source\": 0}}}]";
    let scene = load(&textured(&png, &[("[{\"source\": 0}]", beside)])).unwrap();
    assert!(scene.objects[0].materials[0].albedo.distance(Vec3::X * 0.25) < 1e-4);
    assert!(scene.warnings.iter().any(|text| text.contains("other image")), "{:?}", scene.warnings);
    let required = |name: &str| format!("\"extensionsRequired\": [\"{name}\"], \"extensionsUsed\": [");
    let needs = required("EXT_texture_avif");
    let refused = load(&textured(&png, &[avif, ("\"extensionsUsed\": [", &needs)]));
    assert!(matches!(&refused, Err(LoadError::Unsupported(text)) if text.contains("EXT_texture_avif")));
    let needs = required("EXT_texture_webp");
    let webp = load(&textured(&encoded(ImageFormat::WebP), &[webp, ("\"extensionsUsed\": [", &needs)])).unwrap();
    assert!((webp.objects[0].materials[0].albedo - Vec3::X * 0.25).abs().max_element() < 1e-4);
    let odd = load(&textured(b"neither of them ", &[])).unwrap();
    assert!(odd.warnings.iter().any(|text| text.contains("neither PNG")), "{:?}", odd.warnings);
}

/// As its own image or as one beside it, required or not.
#[test]
fn ktx2_is_read() {
    let file: &[u8] = include_bytes!("ktx2/uastc.ktx2");
    let basis = "[{\"source\": 0}]";
    let of_extension = "[{\"extensions\": {\"KHR_texture_basisu\": {\"source\": 0}}}]";
    let required = "\"extensionsRequired\": [\"KHR_texture_basisu\"], \"extensionsUsed\": [";
    for edits in [&[][..], &[(basis, of_extension)], &[(basis, of_extension), ("\"extensionsUsed\": [", required)]] {
        let scene = load(&textured(file, edits)).unwrap();
        // Eight of eighteen columns are black; the factor is (0.5, 0.25, 0.125).
        assert!(scene.objects[0].materials[0].albedo.distance(Vec3::X * 0.5 * 10.0 / 18.0) < 1e-4, "{edits:?}");
        assert!(scene.warnings.iter().all(|text| !text.contains("not read")), "{:?}", scene.warnings);
    }
    let broken = load(&textured(&file[..200], &[]));
    assert!(matches!(&broken, Err(LoadError::Malformed(text)) if text.contains("image 0")), "{broken:?}");
}

/// Where a primitive has no texture coordinates, no texel is the right one.
#[test]
fn textures_without_a_place_count_with_their_mean() {
    let png = encoded(ImageFormat::Png);
    let both = ["\"baseColorTexture\": {\"index\": 0}", "\"emissiveTexture\": {\"index\": 0}"];
    let third = both.map(|texture| texture.replace("0}", "0, \"texCoord\": 2}"));
    for edits in [vec![(", \"TEXCOORD_0\": 3}", "}")], vec![(both[0], third[0].as_str()), (both[1], third[1].as_str())]]
    {
        let scene = load(&textured(&png, &edits)).unwrap();
        let object = &scene.objects[0];
        assert!(object.looks.is_empty() && object.mesh.texcoords[0].is_empty(), "{object:?}");
        assert!((object.materials[0].albedo - Vec3::X * 0.25).abs().max_element() < 1e-4, "{object:?}");
        let warned = scene.warnings.iter().any(|text| text.contains("without texture coordinates"));
        assert!(warned, "{:?}", scene.warnings);
    }
    // Beside a primitive that has them it is another material.
    let primitive = "{\"attributes\": {\"POSITION\": 0, \"NORMAL\": 1, \"TEXCOORD_0\": 3}, \"indices\": 2, \"material\": 0, \"mode\": 4}";
    let two = format!("{primitive}, {}", primitive.replace(", \"TEXCOORD_0\": 3", ""));
    let scene = load(&textured(&png, &[(primitive, &two)])).unwrap();
    let object = &scene.objects[0];
    assert_eq!(object.mesh.triangle_materials, [0, 0, 1, 1]);
    assert!(object.looks[0].is_some() && object.looks[1].is_none(), "{object:?}");
    assert_eq!(object.materials[0].albedo, object.materials[1].albedo);
    let means = [0, 1].map(|material| object.materials[material].emission * object.mean_emission(material));
    assert!(means[0].distance(means[1]) < 1e-4 && means[0].distance(Vec3::X * 1.5) < 1e-3, "{means:?}");
}

#[test]
fn texture_coordinates_that_are_no_numbers_count_as_zero() {
    let mut file = textured(&encoded(ImageFormat::Png), &[]);
    let start = file.windows(4).position(|four| four == b"BIN\0").unwrap() + 4 + 128;
    file[start + 8..start + 12].copy_from_slice(&f32::NAN.to_le_bytes());
    let scene = load(&file).unwrap();
    assert_eq!(scene.objects[0].mesh.texcoords[0], [Vec2::ZERO, Vec2::ZERO, Vec2::ONE, Vec2::Y]);
    assert!(scene.warnings.iter().any(|text| text.contains("coordinates")), "{:?}", scene.warnings);
}

/// Meshes keep two sets; whichever the file calls it, one that is read is kept.
#[test]
fn later_coordinates_are_read() {
    let png = encoded(ImageFormat::Png);
    let both = ["\"baseColorTexture\": {\"index\": 0}", "\"emissiveTexture\": {\"index\": 0}"];
    let [base, emissive] = both.map(|texture| texture.replace("0}", "0, \"texCoord\": 3}"));
    let sets = (", \"TEXCOORD_0\": 3}", ", \"TEXCOORD_0\": 1, \"TEXCOORD_3\": 3}");
    let [later, usual] = [&[sets, (both[0], base.as_str()), (both[1], emissive.as_str())][..], &[]]
        .map(|edits| load(&textured(&png, edits)).unwrap());
    assert_eq!(later.objects[0].mesh.texcoords, usual.objects[0].mesh.texcoords);
    let looks = [&later, &usual].map(|scene| scene.objects[0].looks[0].clone().unwrap());
    assert_eq!(looks[0], looks[1]);
    // Beside the first there is no room for it: its texture has no place.
    let mixed = load(&textured(
        &png,
        &[(", \"TEXCOORD_0\": 3}", ", \"TEXCOORD_0\": 3, \"TEXCOORD_3\": 3}"), (both[1], emissive.as_str())],
    ));
    let mixed = mixed.unwrap();
    let look = mixed.objects[0].looks[0].as_ref().unwrap();
    assert!(look.base_color.is_some() && look.emissive.is_none(), "{look:?}");
    assert!(mixed.warnings.iter().any(|text| text.contains("beyond TEXCOORD_1")), "{:?}", mixed.warnings);
}

#[test]
fn what_is_kept_of_textures_is_bounded() {
    let size = |max_kept_texels| {
        let limits = LoadLimits { max_kept_texels, ..LoadLimits::default() };
        let scene = super::super::load(&textured(&encoded(ImageFormat::Png), &[]), &limits).unwrap();
        scene.objects[0].looks[0].as_ref().unwrap().base_color.as_ref().unwrap().texture.size()
    };
    assert_eq!([0, 1 << 20].map(size), [(8, 4), (16, 8)]);
}

#[test]
fn broken_and_large_textures_are_refused() {
    let png = encoded(ImageFormat::Png);
    let load = |image: &[u8], limits| super::super::load(&textured(image, &[]), &limits).map(|_| ());
    let limits = LoadLimits::default();
    assert!(matches!(load(&png[..png.len() / 2], limits.clone()), Err(LoadError::Malformed(_))));
    assert!(matches!(load(b"RIFF\x0c\0\0\0WEBPVP8 ", limits.clone()), Err(LoadError::Malformed(_))));
    let small = LoadLimits { max_texture_pixels: 127, ..limits.clone() };
    assert!(matches!(load(&png, small), Err(LoadError::TooLarge(_))));
    let few = LoadLimits { max_total_texture_pixels: 127, ..limits };
    assert!(matches!(load(&png, few), Err(LoadError::TooLarge(_))));
    // Headers of billions of pixels: refused before memory is spent.
    let mut huge = png;
    for side in [60_000_u32, 65_535] {
        huge[16..20].copy_from_slice(&side.to_be_bytes());
        huge[20..24].copy_from_slice(&side.to_be_bytes());
        let checked = crc32fast::hash(&huge[12..29]);
        huge[29..33].copy_from_slice(&checked.to_be_bytes());
        let refused = load(&huge, LoadLimits::default());
        let words = format!("image 0: has {side} x {side} pixels");
        assert!(matches!(&refused, Err(LoadError::TooLarge(text)) if text.contains(&words)), "{refused:?}");
    }
}

#[test]
fn vertex_colours_are_kept() {
    let scene = load(&edited(&[("\"NORMAL\": 1}", "\"NORMAL\": 1, \"COLOR_0\": 1}")])).unwrap();
    assert_eq!(scene.objects[0].mesh.colors, [glam::Vec4::new(0.0, 0.0, 1.0, 1.0); 4]);
}

/// Left half clear, right half opaque.
fn cut_out() -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let picture = image::RgbaImage::from_fn(16, 8, |x, _| image::Rgba([255, 0, 0, if x < 8 { 102 } else { 255 }]));
    picture.write_to(&mut bytes, ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// What the first object's look says of its surface, and opacity on the left and on the right.
fn opacities(edits: &[(&str, &str)]) -> (AlphaMode, [f32; 2]) {
    let scene = load(&textured(&cut_out(), edits)).unwrap();
    let look = scene.objects[0].looks[0].as_ref().unwrap();
    let at = |u| look.passage(Vec2::new(u, 0.5), glam::Vec4::ONE, look.through([Vec2::ZERO; 2], Vec3::ONE)).opacity;
    assert!(
        !scene.warnings.iter().any(|text| text.contains("opaque") || text.contains("MASK")),
        "{:?}",
        scene.warnings
    );
    (look.alpha_mode, [at(0.2), at(0.8)])
}

#[test]
fn alpha_is_read_by_mode_and_cut_off() {
    let of = |mode: &str| opacities(&[("\"doubleSided\": true", mode)]);
    assert_eq!(of("\"alphaMode\": \"MASK\""), (AlphaMode::Mask(0.5), [0.0, 1.0]));
    assert_eq!(of("\"alphaMode\": \"MASK\", \"alphaCutoff\": 0.4"), (AlphaMode::Mask(0.4), [1.0, 1.0]));
    // Nothing of it is there.
    let hole = ("\"doubleSided\": true", "\"alphaMode\": \"MASK\", \"alphaCutoff\": 1.5");
    let hole = load(&textured(&cut_out(), &[hole])).unwrap();
    assert!(hole.objects[0].mesh.triangles.is_empty() && hole.lights.len() == 1, "{:?}", hole.lights);
    assert_eq!(of("\"alphaMode\": \"MASK\", \"alphaCutoff\": 0"), (AlphaMode::Opaque, [1.0, 1.0]));
    assert_eq!(of("\"alphaMode\": \"OPAQUE\""), (AlphaMode::Opaque, [1.0, 1.0]));
    let (mode, [left, right]) = of("\"alphaMode\": \"BLEND\"");
    assert!(mode == AlphaMode::Blend && (left - 0.4).abs() < 1e-4 && right == 1.0, "{left} and {right}");
    // The factor counts, too.
    let half = ("[0.5, 0.25, 0.125, 1]", "[0.5, 0.25, 0.125, 0.5]");
    let mask = ("\"doubleSided\": true", "\"alphaMode\": \"MASK\", \"alphaCutoff\": 0.3");
    assert_eq!(opacities(&[half, mask]).1, [0.0, 1.0]);
    let (_, [left, right]) = opacities(&[half, ("\"doubleSided\": true", "\"alphaMode\": \"BLEND\"")]);
    assert!((left - 0.2).abs() < 1e-4 && (right - 0.5).abs() < 1e-4, "{left} and {right}");
}

#[test]
fn glass_is_read_with_its_volume() {
    let glass = "\"extensions\": {\"KHR_materials_transmission\": {\"transmissionFactor\": 0.75}, \"KHR_materials_volume\": \
                 {\"thicknessFactor\": 0.5, \"attenuationDistance\": 2, \"attenuationColor\": [1, 0.5, 0.25]}}";
    let strength = ",\n    \"extensions\": {\"KHR_materials_emissive_strength\": {\"emissiveStrength\": 3}}";
    let scene = load(&edited(&[("\"doubleSided\": true", glass), (strength, "")])).unwrap();
    let look = scene.objects[0].looks[0].as_ref().unwrap();
    assert_eq!((look.transmission, look.thickness), (0.75, 0.5));
    let left = (-look.absorption * 2.0).exp();
    assert!(left.distance(Vec3::new(1.0, 0.5, 0.25)) < 1e-5, "{left}");
    let passage = look.passage(Vec2::ZERO, glam::Vec4::ONE, look.through([Vec2::ZERO; 2], left));
    assert!((passage.transmittance() - 0.75 * Vec3::new(0.5, 0.125, 0.03125)).abs().max_element() < 1e-5);
    assert_eq!(passage.opacity, 0.25);
}

#[test]
fn metal_lets_nothing_through() {
    let glass =
        ("\"doubleSided\": true", "\"extensions\": {\"KHR_materials_transmission\": {\"transmissionFactor\": 0.8}}");
    let strength = (",\n    \"extensions\": {\"KHR_materials_emissive_strength\": {\"emissiveStrength\": 3}}", "");
    for (metallic, transmission) in [("0", 0.8), ("0.25", 0.6), ("1", 0.0)] {
        let metallic = ("\"metallicFactor\": 0", format!("\"metallicFactor\": {metallic}"));
        let scene = load(&edited(&[glass, strength, (metallic.0, &metallic.1)])).unwrap();
        let found = scene.objects[0].looks.first().and_then(|look| look.as_ref()).map_or(0.0, |look| look.transmission);
        assert!((found - transmission).abs() < 1e-6, "{found} in place of {transmission}");
    }
}

/// Pictures of numbers are linear: red is what goes through, green how deep it goes.
#[test]
fn glass_is_read_with_its_pictures() {
    let mut bytes = Cursor::new(Vec::new());
    let pixel = |x, _| image::Rgb(if x < 8 { [0, 255, 9] } else { [51, 102, 9] });
    image::RgbImage::from_fn(16, 8, pixel).write_to(&mut bytes, ImageFormat::Png).unwrap();
    let strength = ",\n    \"extensions\": {\"KHR_materials_emissive_strength\": {\"emissiveStrength\": 3}}";
    let glass = |set: usize, color: &str| {
        let info = format!("{{\"index\": 0, \"texCoord\": {set}}}");
        let glass = format!(
            "\"extensions\": {{\"KHR_materials_transmission\": \
             {{\"transmissionFactor\": 1, \"transmissionTexture\": {info}}}, \
             \"KHR_materials_volume\": {{\"thicknessFactor\": 0.5, \"thicknessTexture\": {info}, \
             \"attenuationDistance\": 1, \"attenuationColor\": {color}}}}}"
        );
        let base = ("\"baseColorTexture\": {\"index\": 0}, \"baseColorFactor\": [0.5, 0.25, 0.125, 1],", "");
        let emissive = ("\"emissiveTexture\": {\"index\": 0}, ", "");
        let dark = ("\"emissiveFactor\": [1, 0.5, 0]", "\"emissiveFactor\": [0, 0, 0]");
        let edits = [base, emissive, dark, ("\"doubleSided\": true", &glass), (strength, "")];
        load(&textured(bytes.get_ref(), &edits)).unwrap()
    };
    let scene = glass(0, "[0.25, 0.25, 0.25]");
    let look = scene.objects[0].looks[0].as_ref().unwrap();
    for (u, share, depth) in [(0.25, 0.0, 1.0), (0.75, 0.2, 0.4_f32)] {
        let found = look.through([Vec2::new(u, 0.5); 2], Vec3::splat(0.5));
        assert!((found.share - share).abs() < 1e-4, "{found:?}");
        assert!((found.volume.x - 0.5_f32.powf(depth)).abs() < 1e-4, "{found:?}");
    }
    assert!((scene.objects[0].mean_opacity(0) - 0.9).abs() < 1e-4, "{}", scene.objects[0].mean_opacity(0));
    // A white pane with a picture is not clear all over.
    assert_eq!(scene.objects[0].mesh.triangles.len(), 2);
    assert!(!scene.warnings.iter().any(|text| text.contains("textures are not read")), "{:?}", scene.warnings);
    // Without a place the mean counts; what is not needed is not decoded.
    let scene = glass(1, "[0.25, 0.25, 0.25]");
    let look = scene.objects[0].looks[0].as_ref().unwrap();
    assert!(look.transmission_texture.is_none() && (look.transmission - 0.1).abs() < 1e-4, "{look:?}");
    assert!(look.thickness_texture.is_none() && (look.thickness - 0.35).abs() < 1e-4, "{look:?}");
    assert!(glass(0, "[1, 1, 1]").objects[0].looks[0].as_ref().unwrap().thickness_texture.is_none());
}

/// Light goes through clear glass as if it were not there; what it emits is there all the same.
#[test]
fn glass_that_shines_is_a_light() {
    let glass = |emissive: &str| {
        let extensions = "\"extensions\": {\"KHR_materials_transmission\": {\"transmissionFactor\": 1}}";
        let strength = ",\n    \"extensions\": {\"KHR_materials_emissive_strength\": {\"emissiveStrength\": 3}}";
        load(&edited(&[
            ("\"doubleSided\": true", extensions),
            (strength, ""),
            ("[0.5, 0.25, 0.125, 1]", "[1, 1, 1, 1]"),
            ("\"emissiveFactor\": [1, 0.5, 0]", emissive),
        ]))
        .unwrap()
    };
    let clear = glass("\"emissiveFactor\": [0, 0, 0]");
    assert!(clear.objects[0].mesh.triangles.is_empty() && clear.lights.len() == 1);
    let bulb = glass("\"emissiveFactor\": [1, 0.5, 0]");
    assert_eq!((bulb.objects[0].mesh.triangles.len(), bulb.lights.len()), (2, 2));
    assert_eq!(bulb.lights[0].strength(), Vec3::new(1.0, 0.5, 0.0));
}
