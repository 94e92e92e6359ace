//! Random and low-discrepancy numbers as pure functions of (seed, element, pass, sample): the order in which threads
//! take up work cannot change a result.

/// PCG32 (O'Neill 2014): small state, good quality, reproducible.
#[derive(Clone, Debug)]
pub struct Pcg32 {
    state: u64,
    increment: u64,
}

/// A 64-bit finaliser (splitmix64, Steele et al. 2014).
#[inline]
pub fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Uniform in [0, 1), of 64 bits.
#[inline]
pub(crate) fn unit(bits: u64) -> f32 {
    unit_of_32((bits >> 32) as u32)
}

#[inline]
fn unit_of_32(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// A seed derived from a seed and a label: independent streams for passes and rounds.
#[inline]
pub fn subseed(seed: u64, label: u64) -> u64 {
    mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15).wrapping_mul(0xd134_2543_de82_ef95) ^ mix(label))
}

impl Pcg32 {
    /// The stream of `element` under `seed`.
    #[inline]
    pub fn new(seed: u64, element: u64) -> Pcg32 {
        let h = subseed(seed, element);
        let mut rng = Pcg32 { state: h, increment: (mix(h ^ 0x5851_f42d_4c95_7f2d) << 1) | 1 };
        rng.next_u32();
        rng
    }

    /// Uniform 32 bits.
    #[inline]
    pub fn next_u32(&mut self) -> u32 {
        let old = self.state;
        self.state = old.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(self.increment);
        let x = (((old >> 18) ^ old) >> 27) as u32;
        x.rotate_right((old >> 59) as u32)
    }

    /// Uniform among the first `count` integers.
    #[inline]
    pub(crate) fn next_below(&mut self, count: usize) -> usize {
        ((u64::from(self.next_u32()) * count as u64) >> 32) as usize
    }

    /// Uniform in [0, 1).
    #[inline]
    pub fn next_f32(&mut self) -> f32 {
        unit_of_32(self.next_u32())
    }

    /// Two independent uniforms.
    #[inline]
    pub fn next_2d(&mut self) -> [f32; 2] {
        [self.next_f32(), self.next_f32()]
    }
}

/// The R2 sequence (Roberts 2018) with a random shift per element (Cranley and Patterson 1976): each shift is an
/// unbiased replicate, and errors of different elements are independent.
#[derive(Clone, Copy, Debug)]
pub struct R2 {
    shift: [u32; 2],
}

/// 1/φ₂ and 1/φ₂² (φ₂ = 1.3247…, the plastic number) as 0.32 fixed point.
const X: u32 = 3_242_174_889;
const Y: u32 = 2_447_445_414;

impl R2 {
    /// A sequence with a shift drawn from `rng`.
    #[inline]
    pub fn new(rng: &mut Pcg32) -> R2 {
        R2 { shift: [rng.next_u32(), rng.next_u32()] }
    }

    /// An R2 sequence of the same shift whose first point is point `index` of this one.
    #[inline]
    pub fn from_point(self, index: u32) -> R2 {
        let [x, y] = self.shift;
        R2 { shift: [X.wrapping_mul(index).wrapping_add(x), Y.wrapping_mul(index).wrapping_add(y)] }
    }

    /// Point `index`, in [0, 1)².
    #[inline]
    pub fn get(&self, index: u32) -> [f32; 2] {
        let x = index.wrapping_mul(X).wrapping_add(self.shift[0]);
        let y = index.wrapping_mul(Y).wrapping_add(self.shift[1]);
        [unit_of_32(x), unit_of_32(y)]
    }
}

/// The seed of a part of a round. Parts go on with each other's low-discrepancy sequences: together they are as good as
/// if they had been one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PartSeed {
    /// Of the round.
    pub seed: u64,
    /// Parts before it; all have as many samples as it has, or a few more.
    pub part: u32,
}

impl PartSeed {
    /// Of a round that is not divided.
    pub(crate) fn whole(seed: u64) -> PartSeed {
        PartSeed { seed, part: 0 }
    }

    /// For one of the things that it does.
    pub(crate) fn of(self, label: u64) -> PartSeed {
        PartSeed { seed: subseed(self.seed, label), ..self }
    }

    /// The numbers of an element.
    #[inline]
    pub(crate) fn draws(self, element: u64) -> Draws {
        let PartSeed { seed, part } = self;
        let own = Pcg32::new(subseed(seed, 0x9a47 + u64::from(part)), element);
        Draws { of_round: Pcg32::new(seed, element), own, part }
    }
}

/// Random numbers of an element in a part of a round.
#[derive(Clone, Debug)]
pub(crate) struct Draws {
    /// Random numbers that all parts of the round draw alike.
    pub of_round: Pcg32,
    /// Random numbers that this part draws alone.
    pub own: Pcg32,
    part: u32,
}

impl Draws {
    /// The next sequence, of which every part takes `count` points.
    #[inline]
    pub(crate) fn sequence(&mut self, count: u32) -> R2 {
        R2::new(&mut self.of_round).from_point(self.part.wrapping_mul(count))
    }

    /// Points of a sequence that parts before this one have, where each takes `count`.
    #[inline]
    pub(crate) fn before(&self, count: u32) -> u32 {
        self.part.wrapping_mul(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::Family;

    #[test]
    fn parts_go_on_with_the_sequence_and_draw_the_rest_anew() {
        let draws = |part| PartSeed { seed: 5, part }.draws(7);
        let (whole, count) = (draws(0).sequence(12), 4);
        for part in 0..3 {
            let mut draws = draws(part);
            let sequence = draws.sequence(count);
            (0..count).for_each(|k| assert_eq!(sequence.get(k), whole.get(part * count + k)));
            assert_ne!(draws.sequence(count).get(0), sequence.get(0));
            assert_eq!(draws.before(count), part * count);
        }
        let own: Vec<u32> = (0..3).map(|part| draws(part).own.next_u32()).collect();
        assert!(own[0] != own[1] && own[1] != own[2] && own[0] != own[2]);
    }

    #[test]
    fn streams_are_reproducible_and_differ() {
        let take = |seed, element| {
            let mut rng = Pcg32::new(seed, element);
            (0..8).map(|_| rng.next_u32()).collect::<Vec<_>>()
        };
        assert_eq!(take(1, 2), take(1, 2));
        assert_ne!(take(1, 2), take(1, 3));
        assert_ne!(take(1, 2), take(2, 2));
    }

    #[test]
    fn uniforms_of_neighbouring_elements_have_the_right_mean_and_variance() {
        let n = 200_000;
        let (mut sum, mut squares) = (0.0f64, 0.0f64);
        for element in 0..n {
            let x = f64::from(Pcg32::new(7, element).next_f32());
            sum += x;
            squares += x * x;
        }
        let mean = sum / n as f64;
        let variance = squares / n as f64 - mean * mean;
        let mut family = Family::of_known_errors();
        family.compare("mean", mean - 0.5, (1.0 / 12.0f64 / n as f64).sqrt());
        family.compare("variance", variance - 1.0 / 12.0, (1.0 / 180.0f64 / n as f64).sqrt());
        family.assert_agrees();
    }

    #[test]
    fn r2_fills_cells_evenly() {
        let sequence = R2::new(&mut Pcg32::new(3, 0));
        let mut cells = [0u32; 64];
        for i in 0..6400 {
            let [x, y] = sequence.get(i);
            cells[(x * 8.0) as usize * 8 + (y * 8.0) as usize] += 1;
        }
        // A low-discrepancy set puts 100 ± a few points into each of 64 cells; random points would spread by ± 40.
        assert!(cells.iter().all(|&c| (90..=110).contains(&c)), "{cells:?}");
    }
}
