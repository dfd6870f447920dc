//! Named random streams: one seed per run, one stream per consumer.
//!
//! ChaCha with 8 rounds, a generator whose sequence is documented and never changes. The key is the run's seed
//! and a hash of the stream's name, so a draw added in one place leaves the numbers of all others alone.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Normal deviates drawn at a time.
const BLOCK: usize = 128;
/// The approximation in the centre of the normal distribution reaches this far from p = 0.5.
const CENTRE_HALF_WIDTH: f64 = 0.425;

/// One consumer's random numbers.
#[derive(Debug, Clone)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// The stream called `name` of the run with `seed`.
    #[must_use]
    pub fn new(seed: u64, name: &str) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8..16].copy_from_slice(&fnv1a(name.as_bytes()).to_le_bytes());
        Self(ChaCha8Rng::from_seed(key))
    }

    /// Uniform in the open interval (0, 1): a multiple of 2^-53 plus 2^-54.
    pub fn uniform(&mut self) -> f64 {
        unit(self.0.next_u64())
    }

    /// Uniform in (`low`, `high`).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform in 0..`n`, by the high half of a product; the bias is below n / 2^32. For `n` = 0 it is 0, too.
    pub fn below(&mut self, n: u32) -> u32 {
        ((u64::from(self.0.next_u32()) * u64::from(n)) >> 32) as u32
    }

    /// Uniform words of 32 bits, as many as there is room for.
    pub fn words(&mut self, words: &mut [u32]) {
        words.fill_with(|| self.0.next_u32());
    }

    /// A standard normal deviate: one uniform through the inverse of the normal distribution.
    pub fn normal(&mut self) -> f64 {
        normal_quantile(self.uniform())
    }

    /// As many standard normal deviates as there is room for: the numbers that [`normal`](Self::normal) would give.
    pub fn normals(&mut self, deviates: &mut [f64]) {
        for block in deviates.chunks_mut(BLOCK) {
            self.uniforms(block);
            let mut tails = Tails::default();
            let n = tails.find(block);
            block.iter_mut().for_each(|p| *p = centre(*p - 0.5));
            tails.fill(n, block);
        }
    }

    fn uniforms(&mut self, block: &mut [f64]) {
        let mut bytes = [0; 8 * BLOCK];
        let bytes = &mut bytes[..8 * block.len()];
        self.0.fill_bytes(bytes);
        for (p, bytes) in block.iter_mut().zip(bytes.as_chunks().0) {
            *p = unit(u64::from_le_bytes(*bytes));
        }
    }
}

fn unit(bits: u64) -> f64 {
    ((bits >> 11) as f64 + 0.5) * (1.0 / (1_u64 << 53) as f64)
}

/// The arguments of a block that lie in the tails, collected so that each step is taken by all, one after the other.
struct Tails {
    index: [u32; BLOCK],
    p: [f64; BLOCK],
}

impl Default for Tails {
    fn default() -> Self {
        Self { index: [0; BLOCK], p: [0.0; BLOCK] }
    }
}

impl Tails {
    /// Finds the tails among `p`. Written without a branch, which one in seven would take.
    fn find(&mut self, p: &[f64]) -> usize {
        let mut n = 0;
        for (i, p) in p.iter().enumerate() {
            self.index[n] = i as u32;
            self.p[n] = *p;
            n += usize::from((p - 0.5).abs() > CENTRE_HALF_WIDTH);
        }
        n
    }

    /// Writes the quantiles of the first `n` where they belong.
    fn fill(&mut self, n: usize, deviates: &mut [f64]) {
        let mut r = [0.0; BLOCK];
        for (r, p) in r.iter_mut().zip(&self.p[..n]) {
            *r = tail_r(*p);
        }
        let mut magnitude = [0.0; BLOCK];
        for (magnitude, r) in magnitude.iter_mut().zip(&r[..n]) {
            *magnitude = ratio(r - 1.6, &TAIL);
        }
        for k in 0..n {
            let magnitude = if r[k] <= 5.0 { magnitude[k] } else { far_tail(r[k]) };
            deviates[self.index[k] as usize] = if self.p[k] < 0.5 { -magnitude } else { magnitude };
        }
    }
}

/// FNV-1a, 64 bits.
fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

/// The standard normal quantile of `p` in (0, 1), to about 16 digits.
///
/// Wichura (1988), algorithm AS 241 (PPND16): rational approximations in three regions. Only the tails
/// (15 % of uniform arguments) need a logarithm.
#[must_use]
pub fn normal_quantile(p: f64) -> f64 {
    if (p - 0.5).abs() <= CENTRE_HALF_WIDTH { centre(p - 0.5) } else { tail(p) }
}

#[inline]
fn centre(q: f64) -> f64 {
    q * ratio(0.180_625 - q * q, &CENTRE)
}

fn tail(p: f64) -> f64 {
    let r = tail_r(p);
    let magnitude = if r <= 5.0 { ratio(r - 1.6, &TAIL) } else { far_tail(r) };
    if p < 0.5 { -magnitude } else { magnitude }
}

#[inline]
fn tail_r(p: f64) -> f64 {
    (-libm::log(if p < 0.5 { p } else { 1.0 - p })).sqrt()
}

#[cold]
fn far_tail(r: f64) -> f64 {
    ratio(r - 5.0, &FAR_TAIL)
}

/// Numerator and denominator, coefficients of rising powers.
type Rational = [[f64; 8]; 2];

#[inline]
fn ratio(r: f64, [numerator, denominator]: &Rational) -> f64 {
    horner(r, numerator) / horner(r, denominator)
}

#[inline]
fn horner(r: f64, coefficients: &[f64; 8]) -> f64 {
    let [lower @ .., highest] = coefficients;
    lower.iter().rev().fold(*highest, |sum, c| sum * r + c)
}

#[rustfmt::skip]
const CENTRE: Rational = [
    [3.387_132_872_796_366_5, 133.141_667_891_784_38, 1_971.590_950_306_551_3, 13_731.693_765_509_46,
     45_921.953_931_549_87, 67_265.770_927_008_7, 33_430.575_583_588_13, 2_509.080_928_730_122_7],
    [1.0, 42.313_330_701_600_91, 687.187_007_492_057_9, 5_394.196_021_424_751,
     21_213.794_301_586_597, 39_307.895_800_092_71, 28_729.085_735_721_943, 5_226.495_278_852_854],
];
#[rustfmt::skip]
const TAIL: Rational = [
    [1.423_437_110_749_683_5, 4.630_337_846_156_546, 5.769_497_221_460_691, 3.647_848_324_763_204_5,
     1.270_458_252_452_368_4, 0.241_780_725_177_450_6, 0.022_723_844_989_269_184, 7.745_450_142_783_414e-4],
    [1.0, 2.053_191_626_637_759, 1.676_384_830_183_803_8, 0.689_767_334_985_1,
     0.148_103_976_427_480_08, 0.015_198_666_563_616_457, 5.475_938_084_995_345e-4, 1.050_750_071_644_416_9e-9],
];
#[rustfmt::skip]
const FAR_TAIL: Rational = [
    [6.657_904_643_501_103, 5.463_784_911_164_114, 1.784_826_539_917_291_3, 0.296_560_571_828_504_87,
     0.026_532_189_526_576_124, 1.242_660_947_388_078_4e-3, 2.711_555_568_743_487_6e-5, 2.010_334_399_292_288_1e-7],
    [1.0, 0.599_832_206_555_887_9, 0.136_929_880_922_735_8, 0.014_875_361_290_850_615,
     7.868_691_311_456_133e-4, 1.846_318_317_510_054_8e-5, 1.421_511_758_316_446e-7, 2.044_263_103_389_939_8e-15],
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_normal_quantile_matches_published_values() {
        for (p, z) in [
            (0.5, 0.0),
            (0.841_344_746_068_542_9, 1.0),
            (0.975, 1.959_963_984_540_054),
            (1e-3, -3.090_232_306_167_813_5),
            (1e-12, -7.034_483_825_301_131),
            (1e-20, -9.262_340_089_798_408),
        ] {
            assert!((normal_quantile(p) - z).abs() < 1e-13 * z.abs().max(1.0), "{p}: {}", normal_quantile(p));
        }
    }

    #[test]
    fn normal_deviates_have_the_moments_of_a_normal() {
        let mut stream = Stream::new(1, "test");
        let n = 200_000;
        let mut sums = [0.0; 4];
        for _ in 0..n {
            let z = stream.normal();
            for (power, sum) in sums.iter_mut().enumerate() {
                *sum += z.powi(power as i32 + 1) / f64::from(n);
            }
        }
        for (moment, (expected, tolerance)) in sums.iter().zip([(0.0, 0.01), (1.0, 0.015), (0.0, 0.04), (3.0, 0.12)]) {
            assert!((moment - expected).abs() < tolerance, "{sums:?}");
        }
    }

    #[test]
    fn many_deviates_at_once_are_the_bits_of_one_by_one() {
        let (mut one_by_one, mut at_once) = (Stream::new(1, "test"), Stream::new(1, "test"));
        for n in (0..400).chain([20_000]) {
            // A half-used pair of words lies before every other call.
            assert_eq!(one_by_one.below(1000), at_once.below(1000));
            let mut deviates = vec![0.0; n];
            at_once.normals(&mut deviates);
            assert!(deviates.iter().all(|deviate| deviate.to_bits() == one_by_one.normal().to_bits()));
        }
    }

    #[test]
    fn tails_at_once_are_the_bits_of_one_by_one() {
        let p = [0.07, 1e-3, 0.5, 1e-12, 1e-300, 0.93, 1.0 - 1e-13, 0.075, 0.925];
        let (mut deviates, mut tails) = (p, Tails::default());
        let n = tails.find(&p);
        deviates.iter_mut().for_each(|p| *p = centre(*p - 0.5));
        tails.fill(n, &mut deviates);
        assert_eq!(deviates, p.map(normal_quantile));
    }

    #[test]
    fn streams_of_other_names_or_seeds_are_other_numbers() {
        let first = Stream::new(1, "lidar").uniform();
        assert_eq!(first, Stream::new(1, "lidar").uniform());
        assert_ne!(first, Stream::new(2, "lidar").uniform());
        assert_ne!(first, Stream::new(1, "field").uniform());
    }

    #[test]
    fn integers_below_n_cover_all_and_nothing_else() {
        let mut stream = Stream::new(3, "test");
        let mut seen = [0; 7];
        for _ in 0..7_000 {
            seen[stream.below(7) as usize] += 1;
        }
        assert!(seen.iter().all(|count| (850..1150).contains(count)), "{seen:?}");
    }
}
