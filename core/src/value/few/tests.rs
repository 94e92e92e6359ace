use proptest::prelude::*;

use super::*;
use crate::metrics::Family;
use crate::random::Pcg32;

fn lights() -> impl Strategy<Value = Vec<(u32, Vec3)>> {
    let light = (0.0_f32..1.0, 0.0_f32..1.0).prop_map(|(x, y)| Vec3::new(x, y, x * y));
    prop::collection::vec((0_u32..60, light), 0..60)
}

fn of(lights: &[(u32, Vec3)]) -> Few<Vec3> {
    lights.iter().fold(Few::default(), |mut value, (layer, light)| {
        value.add_to_layer(*layer, *light);
        value
    })
}

/// Sixty lamps, most of them weak, each summed up from places that see some of them.
#[test]
fn each_layer_is_right_on_average() {
    const LAYERS: usize = 60;
    const TRIALS: usize = 20_000;
    let mut rng = Pcg32::new(3, 1);
    let mut sums = vec![[0.0_f64; 2]; LAYERS];
    let mut truth = [0.0_f64; LAYERS];
    for _ in 0..TRIALS {
        let (mut sum, mut all) = (Few::default(), [0.0_f32; LAYERS]);
        for _ in 0..6 {
            let mut place = Few::default();
            for (layer, all) in all.iter_mut().enumerate().skip(1) {
                let light = rng.next_f32().powi(4) / (1.0 + layer as f32);
                *all += light;
                Value::add_to_layer(&mut place, layer as u32, Vec3::new(light, 0.5 * light, light));
            }
            sum += place.thinned();
        }
        let found = sum.thinned();
        for layer in 1..LAYERS {
            let off = f64::from(found.layer(layer).x - all[layer]);
            truth[layer] += f64::from(all[layer]);
            sums[layer] = [sums[layer][0] + off, sums[layer][1] + off * off];
        }
    }
    let mut family = Family::of_known_errors();
    for (layer, [sum, squares]) in sums.into_iter().enumerate().skip(1) {
        family.compare(format!("layer {layer}"), sum / truth[layer], squares.sqrt() / truth[layer]);
    }
    family.assert_agrees();
}

proptest! {
    #[test]
    fn no_light_is_lost(a in lights(), b in lights(), by in -2.0_f32..2.0) {
        let sum = of(&a) + of(&b) * by;
        let all = |lights: &[(u32, Vec3)]| -> Vec3 { lights.iter().map(|(_, light)| *light).sum() };
        let whole = all(&a) + all(&b) * by;
        let close = |a: Vec3, b: Vec3| a.abs_diff_eq(b, 1e-4);
        prop_assert!(close(sum.total(), whole) && close(sum.thinned().total(), whole));
        prop_assert!(close(sum.weighted(&[Vec3::ONE; 60]), whole));
        let other = sum.of_total(Vec3::new(3.0, 0.5, 0.0));
        prop_assert!(close(other.total(), Vec3::new(3.0, 0.5, 0.0)));
        let mut layers = Vec::new();
        Value::for_layers(&sum, |layer, _| layers.push(layer));
        prop_assert!(layers[0] == 0 && layers.is_sorted_by(|a, b| a < b) && layers.len() <= FEW + 1);
        let squares = sum.squares(3.0);
        for layer in 0..60 {
            let light = sum.layer(layer);
            prop_assert!((squares.of_layer(layer) - light.length_squared()).abs() < 1e-3);
        }
    }

    #[test]
    fn few_layers_are_all_told_apart(a in lights(), b in lights()) {
        let few = |lights: &[(u32, Vec3)]| lights.iter().map(|(layer, light)| (layer % FEW as u32, *light)).collect::<Vec<_>>();
        let (a, b) = (few(&a), few(&b));
        let difference = of(&a) - of(&b);
        for layer in 0..FEW {
            let of = |lights: &[(u32, Vec3)]| -> Vec3 {
                lights.iter().filter(|(own, _)| *own as usize == layer).map(|(_, light)| *light).sum()
            };
            prop_assert!(difference.layer(layer).abs_diff_eq(of(&a) - of(&b), 1e-4));
        }
    }
}
