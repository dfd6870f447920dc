//! A particle filter over offset, heading and lane width, weighted by the points of a scan.
//!
//! Ours, a baseline. The measurement model is a likelihood field (Thrun, Burgard and Fox, Probabilistic Robotics,
//! section 6.4) of two rows: a point's log-likelihood falls with the square of its distance to the nearer row, and is
//! cut off where the point may as well be a leaf's or the next row's. Such points are rarer inside the lane, so it is
//! cut off later there. The width varies about the nominal one (Ornstein-Uhlenbeck). A finder's view is not used.

mod likelihood_field;

use super::LaneEstimator;
use crate::control::Twist;
use crate::perception::{LaneEstimate, LaneView, Points};
use crate::random::Stream;
use likelihood_field::LikelihoodField;

crate::parameters! {
    /// Parameters of [`ParticleFilter`]. Ours.
    pub struct ParticleFilterParams {
        /// Number of particles. Ours.
        pub particles: u32 = 500, "1", [10, 100000];
        /// At the start: standard deviation of the offset from the lane's middle. Ours.
        pub start_offset_m: f64 = 0.1, "m", [0.0, 5.0];
        /// At the start: standard deviation of the heading. Ours.
        pub start_heading_rad: f64 = 0.2, "rad", [0.0, 1.5];
        /// Standard deviation of the lane's width about the nominal one. Ours.
        pub width_sd_m: f64 = 0.06, "m", [0.0, 5.0];
        /// Time over which the width keeps its deviation. Ours.
        pub width_time_s: f64 = 4.0, "s", [0.01, 1000.0];
        /// The offset's random walk, over one second: side-slip. Ours.
        pub offset_noise_m: f64 = 0.02, "m", [0.0, 5.0];
        /// The heading's, over one second. Ours.
        pub heading_noise_rad: f64 = 0.05, "rad", [0.0, 5.0];
        /// Points count from this far ahead. Ours.
        pub front_min_m: f64 = -0.3, "m", [-10.0, 10.0];
        /// Points count up to this far ahead. Ours.
        pub front_max_m: f64 = 2.5, "m", [0.1, 10.0];
        /// Of all points in a square cell of this size, one counts. Ours.
        pub cell_m: f64 = 0.05, "m", [0.01, 0.5];
        /// Standard deviation of a row's points about it. Ours.
        pub row_sd_m: f64 = 0.05, "m", [0.005, 0.5];
        /// Standard deviations beyond a row at which a point is as likely another thing's. Ours.
        pub cut_off: f64 = 1.5, "1", [0.1, 10.0];
        /// Likewise, inside the lane. Ours.
        pub cut_off_inside: f64 = 2.0, "1", [0.1, 10.0];
        /// How much of its information a point counts, for neighbours are not independent. Ours.
        pub point_weight: f64 = 0.3, "1", [0.001, 1.0];
        /// Way ahead after which a scan shows other leaves and stems, and counts in full; sooner it counts in proportion: a tenth
        /// at 0.7 m/s and 40 Hz, at least a fiftieth. Ours.
        pub fresh_view_m: f64 = 0.175, "m", [0.001, 10.0];
        /// Of the particles that are drawn anew, this share is drawn as at the start. Ours.
        pub fresh_share: f64 = 0.01, "1", [0.0, 1.0];
    }
}

/// No particle is turned more from the lane \[rad\].
const STEEPEST_RAD: f64 = 1.2;
/// A scan from the same place as the last counts so much.
const LEAST_SHARE: f64 = 0.02;

/// One guess.
#[derive(Debug, Clone, Copy, Default)]
struct Particle {
    /// To the left of the lane's middle \[m\].
    offset_m: f64,
    heading_rad: f64,
    width_m: f64,
}

/// The filter.
#[derive(Debug, Clone)]
pub struct ParticleFilter {
    params: ParticleFilterParams,
    lane_width_m: f64,
    field: LikelihoodField,
    particles: Vec<Particle>,
    weights: Vec<f64>,
    drawn: Vec<Particle>,
    deviates: Vec<f64>,
    estimate: LaneEstimate,
    /// Where to start; drawn with the first scan.
    start: Option<LaneEstimate>,
    /// Time since the last scan \[s\], and the way \[m\].
    blind_s: f64,
    moved_m: f64,
}

impl ParticleFilter {
    /// A filter that begins about `start`; its width is the lane's nominal one.
    #[must_use]
    pub fn new(params: &ParticleFilterParams, start: LaneEstimate) -> Self {
        let n = params.particles as usize;
        Self {
            params: params.clone(),
            lane_width_m: start.width_m(),
            field: LikelihoodField::new(params, start.width_m()),
            particles: vec![Particle::default(); n],
            weights: vec![1.0 / n as f64; n],
            drawn: vec![Particle::default(); n],
            deviates: vec![0.0; 3 * n],
            estimate: start,
            start: Some(start),
            blind_s: 0.0,
            moved_m: 0.0,
        }
    }

    /// The nominal lane's bounds, which keep a particle in the lane that the robot is in.
    fn bounded(&self, particle: Particle) -> Particle {
        let width_m = particle.width_m.clamp(0.5 * self.lane_width_m, 1.5 * self.lane_width_m);
        Particle {
            offset_m: particle.offset_m.clamp(-0.5 * width_m, 0.5 * width_m),
            heading_rad: particle.heading_rad.clamp(-STEEPEST_RAD, STEEPEST_RAD),
            width_m,
        }
    }

    fn scattered(&self, about: LaneEstimate, deviates: [f64; 3]) -> Particle {
        self.bounded(Particle {
            offset_m: about.cross_track_m() + self.params.start_offset_m * deviates[0],
            heading_rad: about.heading_rad + self.params.start_heading_rad * deviates[1],
            width_m: about.width_m() + self.params.width_sd_m * deviates[2],
        })
    }

    /// Spreads the particles: about the start if there is one, else for the time since the last scan.
    fn spread(&mut self, random: &mut Stream) {
        random.normals(&mut self.deviates);
        let root_s = self.blind_s.sqrt();
        let kept = libm::exp(-self.blind_s / self.params.width_time_s);
        let width_noise_m = self.params.width_sd_m * (1.0 - kept * kept).sqrt();
        let start = self.start.take();
        for i in 0..self.particles.len() {
            let deviates = [self.deviates[3 * i], self.deviates[3 * i + 1], self.deviates[3 * i + 2]];
            self.particles[i] = match start {
                Some(start) => self.scattered(start, deviates),
                None => self.bounded(Particle {
                    offset_m: self.particles[i].offset_m + root_s * self.params.offset_noise_m * deviates[0],
                    heading_rad: self.particles[i].heading_rad + root_s * self.params.heading_noise_rad * deviates[1],
                    width_m: self.lane_width_m
                        + kept * (self.particles[i].width_m - self.lane_width_m)
                        + width_noise_m * deviates[2],
                }),
            };
        }
        if start.is_some() {
            self.weights.fill(1.0 / self.particles.len() as f64);
        }
        self.blind_s = 0.0;
    }

    /// Weighs the particles by a scan that counts `share` of what one would that shows all anew.
    fn weigh(&mut self, share: f64) {
        let mut best = f64::NEG_INFINITY;
        for (particle, weight) in self.particles.iter().zip(&mut self.weights) {
            *weight = libm::log(*weight) + share * self.field.log_likelihood(*particle);
            best = best.max(*weight);
        }
        let mut sum = 0.0;
        for weight in &mut self.weights {
            *weight = libm::exp(*weight - best);
            sum += *weight;
        }
        self.weights.iter_mut().for_each(|weight| *weight = (*weight / sum).max(f64::MIN_POSITIVE));
    }

    fn mean(&self) -> LaneEstimate {
        let mut mean = Particle::default();
        for (particle, weight) in self.particles.iter().zip(&self.weights) {
            mean.offset_m += weight * particle.offset_m;
            mean.heading_rad += weight * particle.heading_rad;
            mean.width_m += weight * particle.width_m;
        }
        place(mean)
    }

    /// Draws the particles anew, systematically, once fewer than half of them count.
    fn resample(&mut self, random: &mut Stream) {
        let n = self.particles.len() as f64;
        let effective = 1.0 / self.weights.iter().map(|weight| weight * weight).sum::<f64>();
        if effective > 0.5 * n {
            return;
        }
        let fresh = (self.params.fresh_share * n) as usize;
        let offset = random.uniform();
        let (mut source, mut sum) = (0, self.weights[0]);
        for i in 0..self.drawn.len() {
            let target = (i as f64 + offset) / n;
            while sum < target && source + 1 < self.weights.len() {
                source += 1;
                sum += self.weights[source];
            }
            self.drawn[i] = self.particles[source];
        }
        std::mem::swap(&mut self.particles, &mut self.drawn);
        let middle = LaneEstimate::middle(self.lane_width_m);
        for k in 0..fresh {
            // Spread over all, for neighbours come from the same particle.
            let i = k * self.particles.len() / fresh;
            self.particles[i] = self.scattered(middle, [random.normal(), random.normal(), random.normal()]);
        }
        self.weights.fill(1.0 / n);
    }
}

impl LaneEstimator for ParticleFilter {
    fn predict(&mut self, measured: Twist, dt_s: f64) {
        let Some((ahead_m, turn_rad)) = measured.moved(dt_s) else { return };
        let moved = |offset_m: f64, heading_rad: f64, width_m: f64| Particle {
            offset_m: offset_m + ahead_m * libm::sin(heading_rad + 0.5 * turn_rad),
            heading_rad: heading_rad + turn_rad,
            width_m,
        };
        for i in 0..self.particles.len() {
            let Particle { offset_m, heading_rad, width_m } = self.particles[i];
            self.particles[i] = self.bounded(moved(offset_m, heading_rad, width_m));
        }
        let LaneEstimate { heading_rad, .. } = self.estimate;
        let mean = self.bounded(moved(self.estimate.cross_track_m(), heading_rad, self.estimate.width_m()));
        self.estimate = place(mean);
        self.start = self.start.map(|_| place(mean));
        self.blind_s += dt_s;
        self.moved_m += ahead_m.abs();
    }

    fn correct(&mut self, points: &Points, _view: LaneView, random: &mut Stream) {
        let is_first = self.start.is_some();
        self.spread(random);
        self.field.take(points);
        let share = if is_first { 1.0 } else { (self.moved_m / self.params.fresh_view_m).clamp(LEAST_SHARE, 1.0) };
        self.moved_m = 0.0;
        self.weigh(share);
        self.estimate = self.mean();
        self.resample(random);
    }

    fn estimate(&self) -> LaneEstimate {
        self.estimate
    }

    fn restart(&mut self, start: LaneEstimate) {
        self.estimate = start;
        self.start = Some(start);
        (self.blind_s, self.moved_m) = (0.0, 0.0);
    }
}

fn place(particle: Particle) -> LaneEstimate {
    LaneEstimate {
        left_m: 0.5 * particle.width_m - particle.offset_m,
        right_m: 0.5 * particle.width_m + particle.offset_m,
        heading_rad: particle.heading_rad,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::lane::simulated::Scene;

    const WIDTH_M: f64 = 0.75;
    const SEE_NOTHING: LaneView = LaneView::nothing(LaneEstimate::middle(WIDTH_M));

    fn filter(params: &ParticleFilterParams) -> ParticleFilter {
        ParticleFilter::new(params, LaneEstimate::middle(WIDTH_M))
    }

    fn at(offset_m: f64, heading_rad: f64, width_m: f64) -> LaneEstimate {
        place(Particle { offset_m, heading_rad, width_m })
    }

    fn assert_near(estimate: LaneEstimate, truth: LaneEstimate, [across_m, heading_rad]: [f64; 2]) {
        let off_m = (estimate.cross_track_m() - truth.cross_track_m()).abs();
        let off_rad = (estimate.heading_rad - truth.heading_rad).abs();
        assert!(off_m < across_m && off_rad < heading_rad, "{estimate:?} {truth:?}");
    }

    /// Drives at 0.7 m/s and 20 Hz on a winding way from `truth` on, and compares with it after one second.
    fn drive(filter: &mut ParticleFilter, mut truth: LaneEstimate, seed: u64) {
        let (mut noise, mut random) = (Stream::new(seed, "scan"), Stream::new(seed, "localization"));
        for step in 0..100 {
            let twist = Twist { linear_m_s: 0.7, angular_rad_s: 0.5 * libm::cos(0.15 * f64::from(step)) };
            let offset_m = truth.cross_track_m() + 0.7 * 0.05 * libm::sin(truth.heading_rad);
            truth = at(offset_m, truth.heading_rad + 0.05 * twist.angular_rad_s, truth.width_m());
            filter.predict(twist, 0.05);
            filter.correct(&Scene::new(truth, 1.0).scan(&mut noise), SEE_NOTHING, &mut random);
            if step >= 20 {
                assert_near(filter.estimate(), truth, [0.07, 0.08]);
            }
        }
    }

    #[test]
    fn it_follows_a_robot_through_lanes_of_other_than_nominal_width() {
        for (seed, width_m) in [(1, 0.65), (2, 0.75), (3, 0.85)] {
            let mut filter = filter(&ParticleFilterParams::default());
            drive(&mut filter, at(0.05, -0.1, width_m), seed);
            assert!((filter.estimate().width_m() - width_m).abs() < 0.05, "{:?}", filter.estimate());
        }
    }

    #[test]
    fn it_finds_its_way_back_from_a_wrong_start() {
        let mut filter = filter(&ParticleFilterParams { start_heading_rad: 0.15, ..Default::default() });
        filter.restart(at(-0.1, 0.6, WIDTH_M));
        drive(&mut filter, at(0.1, -0.1, WIDTH_M), 4);
    }

    #[test]
    fn without_scans_it_moves_as_the_robot_does() {
        let mut filter = filter(&ParticleFilterParams::default());
        filter.restart(at(0.0, 0.2, WIDTH_M));
        filter.predict(Twist { linear_m_s: 0.7, angular_rad_s: 0.4 }, 0.1);
        assert!((filter.estimate().cross_track_m() - 0.07 * libm::sin(0.22)).abs() < 1e-12);
        assert!((filter.estimate().heading_rad - 0.24).abs() < 1e-12);
    }

    #[test]
    fn scans_of_a_robot_that_hardly_moves_count_less_than_those_of_one_that_drives() {
        // What one more scan of a robot to the left of the middle teaches a filter that takes it to be on it.
        let learns = |moved_m: f64| {
            let params = ParticleFilterParams { particles: 20_000, offset_noise_m: 0.0, ..Default::default() };
            let mut filter = filter(&params);
            let mut random = Stream::new(1, "localization");
            filter.correct(&Points::default(), SEE_NOTHING, &mut random);
            filter.predict(Twist { linear_m_s: 10.0 * moved_m, angular_rad_s: 0.0 }, 0.1);
            filter.correct(&Scene::new(at(0.1, 0.0, WIDTH_M), 0.0).scan(&mut random), SEE_NOTHING, &mut random);
            filter.estimate().cross_track_m()
        };
        let [still, one_scan, slowly, far, farther] = [0.0, 0.0175, 0.05, 0.175, 0.4].map(learns);
        let rises = still < 0.7 * one_scan && one_scan < 0.9 * slowly && slowly < far - 0.002;
        assert!(0.0 < still && rises && (far - farther).abs() < 0.005, "{still} {one_scan} {slowly} {far} {farther}");
    }

    #[test]
    fn an_empty_scan_teaches_nothing() {
        let mut filter = filter(&ParticleFilterParams { particles: 20_000, ..Default::default() });
        filter.restart(at(0.05, 0.1, 0.8));
        filter.correct(&Points::default(), SEE_NOTHING, &mut Stream::new(1, "localization"));
        assert_near(filter.estimate(), at(0.05, 0.1, 0.8), [0.003, 0.006]);
    }

    #[test]
    fn the_same_stream_gives_the_same_estimate_and_another_one_another() {
        let points = Scene::new(at(0.1, 0.1, WIDTH_M), 1.0).scan(&mut Stream::new(1, "scan"));
        let estimate = |seed| {
            let mut filter = filter(&ParticleFilterParams::default());
            filter.correct(&points, SEE_NOTHING, &mut Stream::new(seed, "localization"));
            filter.estimate()
        };
        assert_eq!(estimate(1), estimate(1));
        assert_ne!(estimate(1), estimate(2));
    }
}
