//! A planar LiDAR among vertical stems: exact rays against circles, object by object.
//!
//! Beams begin at the closest range, so a stem that the LiDAR has just driven up to hides nothing: the robot
//! passes over weeds, which bend down before it.
//!
//! Each stem meets the beams in its window and perhaps a few beside it, which then miss it. The passes are kept
//! apart and free of branches, so that the compiler makes vector instructions of them.

use furrow_navigation::perception::{Beams, Scan};
use furrow_navigation::random::Stream;

use super::TwoPlanarLidarsParams;
use super::stems::Stems;
use crate::Pose;
use crate::field::Plant;

/// Most stems meet no more pairs of beams than that; always as many are tried, for no branch is then mispredicted.
const PAIRS_AT_ONCE: usize = 2;

/// The LiDAR and its last scan.
#[derive(Debug, Clone)]
pub struct PlanarLidar {
    beams: Beams,
    ranges_m: Vec<f64>,
    range_min_m: f64,
    range_max_m: f64,
    noise_m: f64,
    stems: Stems,
    /// The beams' directions, in pairs.
    cos: Vec<[f64; 2]>,
    sin: Vec<[f64; 2]>,
    /// Distance to the first stem on each beam of each pair; infinity where there is none \[m\].
    first_m: Vec<[f64; 2]>,
    /// Which beams have a return.
    hits: Vec<u32>,
    deviates: Vec<f64>,
}

impl PlanarLidar {
    /// A LiDAR with these parameters.
    #[must_use]
    pub fn new(params: &TwoPlanarLidarsParams) -> Self {
        let beams = Beams::new(params.beams as usize, params.field_of_view_rad);
        Self::with_beams(beams, [params.range_min_m, params.range_max_m], params.range_noise_m)
    }

    /// A LiDAR with these beams, closest and farthest range \[m\] and standard deviation of a range \[m\].
    pub(super) fn with_beams(beams: Beams, [range_min_m, range_max_m]: [f64; 2], noise_m: f64) -> Self {
        let (cos, sin) = (in_pairs(&beams.cos), in_pairs(&beams.sin));
        Self {
            ranges_m: vec![f64::INFINITY; beams.len()],
            range_min_m,
            range_max_m,
            noise_m,
            stems: Stems::new(&beams, range_max_m),
            first_m: vec![[f64::INFINITY; 2]; cos.len()],
            cos,
            sin,
            hits: vec![0; beams.len()],
            deviates: vec![0.0; beams.len()],
            beams,
        }
    }

    /// The ranges seen from `world_from_lidar`; no return is infinity.
    pub fn scan(&mut self, plants: &[Plant], world_from_lidar: Pose, random: &mut Stream) -> Scan<'_> {
        self.cast(plants, world_from_lidar);
        self.read(random)
    }

    /// The beams, and what is [cast](Self::cast) on each \[m\]: more may be put in their way.
    pub(super) fn beams_and_first(&mut self) -> (&Beams, &mut [f64]) {
        (&self.beams, &mut self.first_m.as_flattened_mut()[..self.ranges_m.len()])
    }

    /// Finds the first stem on each beam; plants that no beam can reach may be left out.
    pub(super) fn cast(&mut self, plants: &[Plant], world_from_lidar: Pose) {
        self.stems.look(plants, world_from_lidar);
        self.first_m.fill([f64::INFINITY; 2]);
        for (stem, first, end) in self.stems.iter() {
            for pair in (first / 2..end.div_ceil(2)).step_by(PAIRS_AT_ONCE) {
                let at_once = pair..pair + PAIRS_AT_ONCE;
                let first_m = &mut self.first_m[at_once.clone()];
                let beams = self.cos[at_once.clone()].iter().zip(&self.sin[at_once]);
                for (first_m, (cos, sin)) in first_m.iter_mut().zip(beams) {
                    meet(stem, *cos, *sin, self.range_min_m, first_m);
                }
            }
        }
    }

    /// Reads the ranges off the beams, each with its own noise, in the beams' order.
    pub(super) fn read(&mut self, random: &mut Stream) -> Scan<'_> {
        let first_m = &self.first_m.as_flattened()[..self.ranges_m.len()];
        let mut n = 0;
        for (i, first_m) in first_m.iter().enumerate() {
            self.hits[n] = i as u32;
            n += usize::from(*first_m <= self.range_max_m);
        }
        random.normals(&mut self.deviates[..n]);
        self.ranges_m.fill(f64::INFINITY);
        for (i, deviate) in self.hits.iter().zip(&self.deviates[..n]) {
            let range = first_m[*i as usize] + self.noise_m * deviate;
            self.ranges_m[*i as usize] = range.clamp(self.range_min_m, self.range_max_m);
        }
        Scan { beams: &self.beams, ranges_m: &self.ranges_m }
    }
}

/// Shortens two beams that begin at `range_min_m` to where they hit the stem at (x, y), if they do.
#[inline]
fn meet([x, y, radius2]: [f64; 3], cos: [f64; 2], sin: [f64; 2], range_min_m: f64, first_m: &mut [f64; 2]) {
    for i in 0..2 {
        let along = x * cos[i] + y * sin[i];
        let across = x * sin[i] - y * cos[i];
        // Not a number where the beam misses, and then no comparison holds.
        let range = along - (radius2 - across * across).sqrt();
        let hit = (along > 0.0) & (range >= range_min_m) & (range < first_m[i]);
        first_m[i] = if hit { range } else { first_m[i] };
    }
}

/// One value per beam, and zeros for beams that are not there: for a stem on the last beam. They hit nothing.
fn in_pairs(values: &[f64]) -> Vec<[f64; 2]> {
    let mut pairs = vec![[0.0; 2]; values.len().div_ceil(2) + PAIRS_AT_ONCE - 1];
    pairs.as_flattened_mut()[..values.len()].copy_from_slice(values);
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::PlantKind;
    use proptest::prelude::*;

    fn plant(x_m: f64, y_m: f64, radius_m: f64) -> Plant {
        Plant { x_m, y_m, radius_m, height_m: 1.0, kind: PlantKind::Crop, row: 0 }
    }

    fn exact() -> PlanarLidar {
        PlanarLidar::new(&TwoPlanarLidarsParams { range_noise_m: 0.0, ..Default::default() })
    }

    /// A LiDAR without noise, and the ranges it must give: every beam against every stem, without windows.
    fn brute_force(params: &TwoPlanarLidarsParams, plants: &[Plant], from: Pose) -> Vec<f64> {
        let beams = Beams::new(params.beams as usize, params.field_of_view_rad);
        let (sin, cos) = libm::sincos(from.heading_rad);
        let first = |(beam_cos, beam_sin): (&f64, &f64)| {
            let mut nearest = f64::INFINITY;
            for p in plants {
                let (dx, dy) = (p.x_m - from.x_m, p.y_m - from.y_m);
                let (x, y) = (cos * dx + sin * dy, cos * dy - sin * dx);
                let range = ray(x, y, p.radius_m, *beam_cos, *beam_sin);
                if range >= params.range_min_m && range <= params.range_max_m {
                    nearest = nearest.min(range);
                }
            }
            nearest
        };
        beams.cos.iter().zip(&beams.sin).map(first).collect()
    }

    fn ray(x: f64, y: f64, radius: f64, cos: f64, sin: f64) -> f64 {
        let (along, across) = (x * cos + y * sin, x * sin - y * cos);
        let depth2 = radius * radius - across * across;
        let inside = x * x + y * y <= radius * radius;
        if inside || depth2 < 0.0 || along <= 0.0 { f64::INFINITY } else { along - depth2.sqrt() }
    }

    /// Stems anywhere: ahead, behind, out of range, around the LiDAR; and close to touching it.
    fn stems() -> impl Strategy<Value = Vec<Plant>> {
        let anywhere = (-6.0..6.0_f64, -6.0..6.0_f64, 0.005..0.3_f64).prop_map(|(x, y, r)| plant(x, y, r));
        let touching = (-4.0..4.0_f64, 0.005..2.0_f64, -12.0..-1.0_f64).prop_map(|(bearing, r, exponent)| {
            let distance = r * (1.0 + libm::exp10(exponent));
            plant(distance * libm::cos(bearing), distance * libm::sin(bearing), r)
        });
        proptest::collection::vec(prop_oneof![9 => anywhere, 1 => touching], 0..60)
    }

    proptest! {
        #[test]
        fn windows_give_the_bits_that_brute_force_gives(
            plants in stems(),
            beams in prop_oneof![Just(360_u32), 2..3000_u32],
            field_of_view_rad in prop_oneof![Just(std::f64::consts::PI), 0.1..3.2_f64],
            range_min_m in prop_oneof![Just(0.1), Just(0.0)],
            way in proptest::collection::vec((-0.2..0.2_f64, -0.2..0.2_f64, -0.3..0.3_f64), 1..6),
        ) {
            let params = TwoPlanarLidarsParams { beams, field_of_view_rad, range_min_m, range_noise_m: 0.0, ..Default::default() };
            let mut lidar = PlanarLidar::new(&params);
            let mut pose = Pose::default();
            for (x_m, y_m, turn_rad) in way {
                let scan = lidar.scan(&plants, pose, &mut Stream::new(1, "lidar"));
                prop_assert_eq!(scan.ranges_m, brute_force(&params, &plants, pose));
                pose = Pose { x_m: pose.x_m + x_m, y_m: pose.y_m + y_m, heading_rad: pose.heading_rad + turn_rad };
            }
        }

        #[test]
        fn stems_at_the_ends_of_the_field_of_view_lose_no_beam(
            end in prop_oneof![Just(-1.0), Just(1.0)],
            beside_rad in -0.05..0.05_f64,
            distance in 0.05..4.1_f64,
            field_of_view_rad in prop_oneof![Just(std::f64::consts::PI), 0.1..3.2_f64],
        ) {
            let params = TwoPlanarLidarsParams { field_of_view_rad, range_noise_m: 0.0, ..Default::default() };
            let (sin, cos) = libm::sincos(end * 0.5 * field_of_view_rad + beside_rad);
            let plants = [plant(distance * cos, distance * sin, 0.02)];
            let mut lidar = PlanarLidar::new(&params);
            let scan = lidar.scan(&plants, Pose::default(), &mut Stream::new(1, "lidar"));
            prop_assert_eq!(scan.ranges_m, brute_force(&params, &plants, Pose::default()));
        }

        #[test]
        fn a_ray_ends_on_the_circle(x in -4.0..4.0_f64, y in -4.0..4.0_f64, r in 0.005..0.3_f64, aside in -1.0..1.0_f64) {
            let distance = libm::hypot(x, y);
            prop_assume!(distance > r);
            let (sin, cos) = libm::sincos(libm::atan2(y, x) + 0.99 * aside * libm::asin(r / distance));
            let range = ray(x, y, r, cos, sin);
            prop_assert!((libm::hypot(range * cos - x, range * sin - y) - r).abs() < 1e-9 && range < distance);
        }
    }

    #[test]
    fn a_lidar_inside_a_stem_sees_past_it() {
        let plants = [plant(0.05, 0.0, 0.1), plant(2.0, 0.0, 0.02)];
        let mut lidar = exact();
        let scan = lidar.scan(&plants, Pose::default(), &mut Stream::new(1, "lidar"));
        assert!(scan.ranges_m.iter().all(|range| *range > 1.9));
        assert!((1.98..1.99).contains(&scan.ranges_m[180]));
    }

    #[test]
    fn a_stem_ahead_is_seen_at_its_face_and_one_beyond_the_range_is_not() {
        let mut lidar = exact();
        let plants = [plant(2.0, 0.0, 0.02), plant(-2.0, 0.0, 0.02), plant(0.0, 4.5, 0.02)];
        let scan = lidar.scan(&plants, Pose::default(), &mut Stream::new(1, "lidar"));
        let hits: Vec<f64> = scan.ranges_m.iter().copied().filter(|range| range.is_finite()).collect();
        assert!(!hits.is_empty() && hits.iter().all(|range| (1.98..2.0).contains(range)), "{hits:?}");
    }

    #[test]
    fn noise_has_the_given_spread() {
        let mut lidar = PlanarLidar::new(&TwoPlanarLidarsParams::default());
        let wall: Vec<_> = (0..200).map(|i| plant(2.0, -1.0 + 0.01 * f64::from(i), 0.02)).collect();
        let mut random = Stream::new(1, "lidar");
        let clean = exact().scan(&wall, Pose::default(), &mut random.clone()).ranges_m.to_vec();
        let (mut sum, mut n) = (0.0, 0.0);
        for _ in 0..200 {
            let scan = lidar.scan(&wall, Pose::default(), &mut random);
            for (noisy, clean) in scan.ranges_m.iter().zip(&clean).filter(|(range, _)| range.is_finite()) {
                sum += (noisy - clean) * (noisy - clean);
                n += 1.0;
            }
        }
        let deviation = f64::sqrt(sum / n);
        assert!((deviation - 0.01).abs() < 0.0005, "{deviation}");
    }
}
