//! Uneven ground: it tilts the robot, and turns and shifts it as it drives.

use furrow_navigation::random::Stream;

use crate::field::lane::{Ground, TERRAIN_STEP_M};

/// Correlation length of roll and pitch \[m\]. Ours.
const TILT_LENGTH_M: f64 = 0.5;
/// Heading and drift of a skid-steered robot on soil, each drawn anew every 0.1 m: standard deviation per way ahead
/// \[rad/m\], \[m/m\]. As for the odometry of this kind of robot.
const YAW_SD: f64 = 0.02;
const SLIP_SD: f64 = 0.02;
/// From one bump to the next \[m\], and how long a bump is, in pieces of ground. Ours.
const BUMP_EVERY_M: [f64; 2] = [3.0, 5.0];
const BUMP_PIECES: usize = 3;
/// A bump's largest roll and pitch, its kick to the heading, and its push to the side: standard deviations
/// \[rad\], \[rad\], \[m\]. Ours.
const BUMP_TILT_RAD: f64 = 0.1;
const BUMP_YAW_RAD: f64 = 0.14;
const BUMP_SLIP_M: f64 = 0.015;
/// No bump is higher than so many standard deviations. Ours.
const BUMP_LIMIT: f64 = 2.0;

/// The ground of a lane of `length_m`: roll and pitch of `tilt_rad`, and bumps in the first `bumps_m`.
pub(super) fn terrain(length_m: f64, tilt_rad: f64, bumps_m: f64, factor: f64, seed: u64) -> Vec<Ground> {
    let mut random = Stream::new(seed, "field-terrain");
    let keeps = libm::exp(-TERRAIN_STEP_M / TILT_LENGTH_M);
    let fresh = (1.0 - keeps * keeps).sqrt();
    let mut tilt = [random.normal(), random.normal()];
    let pieces = (length_m / TERRAIN_STEP_M).ceil() as usize + 1;
    let piece = |_| {
        let [roll_rad, pitch_rad] = tilt.map(|tilt| factor * tilt_rad * tilt);
        tilt = tilt.map(|tilt| keeps * tilt + fresh * random.normal());
        let [yaw_rad_per_m, slip_m_per_m] = [YAW_SD, SLIP_SD].map(|sd| factor * sd * random.normal());
        Ground { roll_rad, pitch_rad, yaw_rad_per_m, slip_m_per_m }
    };
    let mut terrain: Vec<_> = (0..pieces).map(piece).collect();
    add_bumps(&mut terrain, bumps_m, factor, &mut Stream::new(seed, "field-bumps"));
    terrain
}

fn add_bumps(terrain: &mut [Ground], bumps_m: f64, factor: f64, random: &mut Stream) {
    let mut along_m = 0.0;
    loop {
        along_m += random.between(BUMP_EVERY_M[0], BUMP_EVERY_M[1]);
        if along_m >= bumps_m {
            return;
        }
        let scales = [BUMP_TILT_RAD, BUMP_TILT_RAD, BUMP_YAW_RAD, BUMP_SLIP_M];
        let [roll_rad, pitch_rad, yaw_rad, slip_m] =
            scales.map(|sd| factor * sd * random.normal().clamp(-BUMP_LIMIT, BUMP_LIMIT));
        let length_m = BUMP_PIECES as f64 * TERRAIN_STEP_M;
        let first = (along_m / TERRAIN_STEP_M) as usize;
        for ground in terrain.iter_mut().skip(first).take(BUMP_PIECES) {
            ground.roll_rad += roll_rad;
            ground.pitch_rad += pitch_rad;
            ground.yaw_rad_per_m += yaw_rad / length_m;
            ground.slip_m_per_m += slip_m / length_m;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sd(values: impl Iterator<Item = f64>) -> f64 {
        let values: Vec<_> = values.collect();
        (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
    }

    #[test]
    fn ground_tilts_as_much_as_it_should_and_turns_two_degrees_in_thirty_metres() {
        let ground = terrain(10_000.0, 0.02, 0.0, 1.0, 1);
        assert!((sd(ground.iter().map(|g| g.roll_rad)) - 0.02).abs() < 0.001);
        let turns = ground.chunks_exact(300).map(|g| g.iter().map(|g| g.yaw_rad_per_m * TERRAIN_STEP_M).sum());
        assert!((sd(turns).to_degrees() - 1.98).abs() < 0.2);
    }

    #[test]
    fn bumps_kick_by_eight_degrees_and_end_where_they_should() {
        let kicks = (0..200).flat_map(|seed| {
            let ground = terrain(60.0, 0.0, 30.0, 1.0, seed);
            assert!(ground[305..].iter().all(|g| g.roll_rad == 0.0));
            let bumped: Vec<_> = ground.into_iter().filter(|g| g.roll_rad != 0.0).collect();
            let mean = |bump: &[Ground]| 0.3 * bump.iter().map(|g| g.yaw_rad_per_m).sum::<f64>() / 3.0;
            bumped.chunks_exact(3).map(mean).collect::<Vec<_>>()
        });
        assert!((sd(kicks).to_degrees() - 8.0).abs() < 0.4);
    }
}
