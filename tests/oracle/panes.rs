//! Panes of glass with pictures of how they let light through, and panes that shine: against closed forms and path
//! tracing.

use std::sync::Arc;

use glam::Vec3;
use rebake_core::scene::{Look, Material, Object, Texture, TextureUse, Wrap};
use rebake_core::{Unobserved, bake};
use rebake_lab::path::path_trace;

use super::see_through::{blend, budget, floor, glass, lit, of_look, plainly, sheet, slots_of, sun};

/// The red of one picture is the share that goes through, the green of another the depth of the volume: exactly, by
/// place, each by texture coordinates of its own.
#[test]
fn glass_lets_light_through_by_its_pictures() {
    // Of 2 × 1 texels.
    let picture = |left: [u8; 4], right: [u8; 4], set: usize| {
        let texture = Texture::of_numbers(2, 1, &[left, right].concat(), 1 << 20);
        Some(TextureUse { texcoord: set, wrap: [Wrap::Clamp; 2], ..plainly(Arc::new(texture)) })
    };
    let tint = Vec3::new(0.2, 0.5, 1.0);
    let absorption = Vec3::new(1.0, 4.0, 0.0);
    let shares = picture([0, 255, 255, 255], [51, 0, 0, 0], 1);
    let depths = picture([255, 51, 0, 255], [0, 255, 0, 0], 0);
    let deep = Look { absorption, thickness: 0.25, ..glass(tint, 0.5) };
    let volume = |depth: f32| (-absorption * 0.25 * depth).exp();
    let cases = [
        ("shares", Look { transmission_texture: shares.clone(), ..glass(tint, 0.5) }, [Vec3::ZERO, 0.1 * tint]),
        (
            "depths",
            Look { thickness_texture: depths.clone(), ..deep.clone() },
            [0.2, 1.0].map(|d| 0.5 * tint * volume(d)),
        ),
        (
            "shares and depths",
            Look { transmission_texture: shares, thickness_texture: depths, ..deep },
            [Vec3::ZERO, 0.1 * tint * volume(1.0)],
        ),
    ];
    for (name, look, [left, right]) in cases {
        let mut mesh = sheet(1.0, 1.0);
        mesh.texcoords[1] = mesh.texcoords[0].clone();
        let world = lit(vec![floor(), of_look("pane", mesh, look)], [sun()], 0.05);
        let map = bake(&world, &budget(8), 1, &Unobserved).expect("nobody cancels");
        let slots: Vec<u32> = slots_of(&world, "floor").map(|slot| slot as u32).collect();
        let traced = path_trace(&world, &slots, 16, 1, &Unobserved).expect("nobody cancels").0;
        for (slot, traced) in slots_of(&world, "floor").zip(traced) {
            let x = world.positions()[slot].x;
            if x.abs() > 0.01 {
                let expected = if x < 0.0 { left } else { right };
                for found in [map.light.direct[slot], traced.direct] {
                    assert!((found - expected).abs().max_element() < 1e-5, "{name} at {x}: {found}, {expected}");
                }
            }
        }
    }
}

/// A pane sends out what it emits as far as it is there: what goes through takes nothing of that. Baked, where light is
/// aimed at, and path traced, where rays meet it by chance as well.
#[test]
fn panes_shine_as_much_as_they_are_there() {
    let mean = |look: Option<Look>| {
        let mut panel =
            Object::new("panel", sheet(1.0, 1.0).inside_out(), Material::emissive(Vec3::new(2.0, 1.0, 0.5)));
        panel.looks = look.map(|look| Some(Arc::new(look))).into_iter().collect();
        let world = lit(vec![floor(), panel], [], 0.1);
        let map = bake(&world, &budget(64), 1, &Unobserved).expect("nobody cancels");
        let slots = slots_of(&world, "floor");
        let ids: Vec<u32> = slots.clone().map(|slot| slot as u32).collect();
        let traced = path_trace(&world, &ids, 1024, 1, &Unobserved).expect("nobody cancels").0;
        let count = ids.len() as f32;
        let baked: Vec3 = slots.map(|slot| map.light.direct[slot]).sum();
        [baked / count, traced.iter().map(|value| value.direct).sum::<Vec3>() / count]
    };
    let [baked, traced] = mean(None);
    assert!((traced / baked - 1.0).abs().max_element() < 0.02, "{traced} {baked}");
    let tint = Vec3::new(0.2, 0.5, 1.0);
    for (name, look, there) in [
        ("milky glass", glass(Vec3::ONE, 0.5), 1.0),
        ("tinted glass", glass(tint, 0.75), 1.0),
        ("a veil", blend(0.5), 0.5),
        ("a veil of milky glass", Look { transmission: 0.5, ..blend(0.5) }, 0.5),
    ] {
        for (found, (what, tolerance)) in mean(Some(look)).into_iter().zip([("baked", 1e-3), ("traced", 0.04)]) {
            let ratio = found / (baked * there);
            assert!((ratio - 1.0).abs().max_element() < tolerance, "{name}, {what}: {ratio}");
        }
    }
}
