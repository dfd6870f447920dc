//! Leaves that stand still: a fixed hash of plant and voxel says how far a ray gets in it.
//!
//! A voxel holds an optical depth, drawn from the exponential distribution with mean 1 by the hash. A ray that passes
//! it over a length d is stopped where k times the way inside reaches that depth. Over a chord the survival is then
//! the product of exp(-k d), exp(-k l) in all, and the density of the return's depth t is k exp(-k t): Beer and
//! Lambert, exactly, and a voxel that stops one ray stops the next one, too.

/// Side of a voxel \[m\].
pub(super) const VOXEL_M: f64 = 0.15;
const VOXELS_PER_M: f64 = 1.0 / VOXEL_M;
/// Different depths, a power of two.
const DEPTHS: usize = 1024;

/// The depths, by hash.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Leaves {
    depths: Vec<f32>,
}

impl Leaves {
    pub(super) fn new() -> Self {
        let depth = |i: usize| -libm::log((i as f64 + 0.5) / DEPTHS as f64) as f32;
        Self { depths: (0..DEPTHS).map(depth).collect() }
    }

    /// Where a ray meets a leaf of plant `seed` with leaf density `per_m` within `from` and `to`; infinity where it gets through.
    pub(super) fn meet(
        &self,
        (origin, direction): ([f64; 3], [f64; 3]),
        [from, to]: [f64; 2],
        per_m: f64,
        seed: u32,
    ) -> f64 {
        if from >= to || per_m <= 0.0 {
            return f64::INFINITY;
        }
        let mut axes = [0, 1, 2].map(|axis| Axis::new(origin[axis], direction[axis], PRIMES[axis], from));
        let mut enter = from;
        loop {
            let leave = axes[0].next.min(axes[1].next).min(axes[2].next).min(to);
            let depth = self.depth(axes[0].key ^ axes[1].key ^ axes[2].key ^ seed);
            if depth < per_m * (leave - enter) {
                return enter + depth / per_m;
            }
            if leave >= to {
                return f64::INFINITY;
            }
            enter = leave;
            for axis in &mut axes {
                axis.pass(leave);
            }
        }
    }

    #[inline]
    fn depth(&self, key: u32) -> f64 {
        f64::from(self.depths[(mixed(key) >> 22) as usize % DEPTHS])
    }
}

/// A plant's own seed.
pub(super) fn seed(field_seed: u64, plant: u32) -> u32 {
    let folded = (field_seed ^ (field_seed >> 32)) as u32;
    mixed(mixed(folded ^ 0x9e37_79b9).wrapping_add(plant.wrapping_mul(0x85eb_ca6b)))
}

/// Large odd numbers by which voxel numbers are multiplied.
const PRIMES: [u32; 3] = [0x8da6_b343, 0xd816_3841, 0xcb1a_b31f];

/// Spreads each bit over the whole word (the finaliser of MurmurHash3).
#[inline]
const fn mixed(mut key: u32) -> u32 {
    key ^= key >> 16;
    key = key.wrapping_mul(0x85eb_ca6b);
    key ^= key >> 13;
    key = key.wrapping_mul(0xc2b2_ae35);
    key ^ (key >> 16)
}

/// A ray's way from voxel to voxel along one axis.
struct Axis {
    /// The voxel's number times the axis' prime.
    key: u32,
    key_step: u32,
    /// Where along the ray the next voxel begins.
    next: f64,
    /// From voxel to voxel along the ray.
    every: f64,
}

impl Axis {
    #[inline]
    fn new(origin: f64, direction: f64, prime: u32, from: f64) -> Self {
        let voxel = floor((origin + from * direction) * VOXELS_PER_M);
        let forward = direction > 0.0;
        let per = 1.0 / direction;
        let edge = f64::from(voxel + i32::from(forward)) * VOXEL_M;
        Self {
            key: (voxel as u32).wrapping_mul(prime),
            key_step: if forward { prime } else { prime.wrapping_neg() },
            // A ray across the axis never gets there.
            next: if direction == 0.0 { f64::INFINITY } else { (edge - origin) * per },
            every: VOXEL_M * per.abs(),
        }
    }

    #[inline]
    fn pass(&mut self, at: f64) {
        let passes = self.next <= at;
        self.key = self.key.wrapping_add(if passes { self.key_step } else { 0 });
        self.next += if passes { self.every } else { 0.0 };
    }
}

#[inline]
fn floor(value: f64) -> i32 {
    let towards_zero = value as i32;
    towards_zero - i32::from(value < f64::from(towards_zero))
}
