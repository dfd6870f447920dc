//! Scans of a planar LiDAR, and their points.

/// The fixed geometry of a planar LiDAR's beams.
#[derive(Debug, Clone, PartialEq)]
pub struct Beams {
    /// Direction of the first beam \[rad\], counter-clockwise from the x axis of the LiDAR.
    pub angle_min_rad: f64,
    /// From one beam to the next \[rad\].
    pub angle_increment_rad: f64,
    /// Cosine of each beam's direction.
    pub cos: Vec<f64>,
    /// Sine of each beam's direction.
    pub sin: Vec<f64>,
}

impl Beams {
    /// `n` beams spread evenly over `field_of_view_rad`, both ends included, symmetric about the x axis.
    #[must_use]
    pub fn new(n: usize, field_of_view_rad: f64) -> Self {
        let angle_min_rad = -0.5 * field_of_view_rad;
        let angle_increment_rad = field_of_view_rad / (n.max(2) - 1) as f64;
        let (sin, cos) = (0..n).map(|i| libm::sincos(angle_min_rad + i as f64 * angle_increment_rad)).unzip();
        Self { angle_min_rad, angle_increment_rad, cos, sin }
    }

    /// Number of beams.
    #[must_use]
    pub fn len(&self) -> usize {
        self.cos.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.cos.is_empty()
    }
}

/// One turn of a planar LiDAR: a range per beam, in the LiDAR's frame.
#[derive(Debug, Clone, Copy)]
pub struct Scan<'a> {
    /// The beams' directions.
    pub beams: &'a Beams,
    /// Range per beam \[m\]; anything but a positive number up to 1000 km means no return.
    pub ranges_m: &'a [f64],
}

/// No LiDAR reaches farther \[m\]; sums of squares stay far from overflow.
const FARTHEST_M: f64 = 1e6;

fn is_return(range_m: f64) -> bool {
    range_m > 0.0 && range_m <= FARTHEST_M
}

/// Points in the plane, coordinates apart.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Points {
    /// x of each point \[m\].
    pub x_m: Vec<f64>,
    /// y of each point \[m\].
    pub y_m: Vec<f64>,
}

impl Points {
    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.x_m.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.x_m.is_empty()
    }

    /// Forgets all points and keeps the memory.
    pub fn clear(&mut self) {
        self.x_m.clear();
        self.y_m.clear();
    }

    /// Appends a point.
    pub fn push(&mut self, x_m: f64, y_m: f64) {
        self.x_m.push(x_m);
        self.y_m.push(y_m);
    }

    /// All points, in order.
    pub fn iter(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.x_m.iter().copied().zip(self.y_m.iter().copied())
    }

    /// Writes the coordinates in single precision, good to 0.2 um at 4 m.
    pub(super) fn in_single_precision(&self, x_m: &mut Vec<f32>, y_m: &mut Vec<f32>) {
        x_m.clear();
        x_m.extend(self.x_m.iter().map(|x| *x as f32));
        y_m.clear();
        y_m.extend(self.y_m.iter().map(|y| *y as f32));
    }

    /// Replaces the points by the scan's returns (the set Z), in the order of the beams.
    pub fn read_scan(&mut self, scan: &Scan<'_>) {
        self.clear();
        for ((range, cos), sin) in scan.ranges_m.iter().zip(&scan.beams.cos).zip(&scan.beams.sin) {
            if is_return(*range) {
                self.push(range * cos, range * sin);
            }
        }
    }

    /// Replaces the points by one per run of neighbouring returns (the set Z*).
    ///
    /// Guyonneau et al. (2022), algorithm 2: the beams are walked in order; a return joins the running cluster
    /// if it lies within `fuse_distance_m` of its mean.
    ///
    /// Deviation: the printed algorithm halves towards each new point; the program behind the tables keeps the
    /// true mean of the cluster, and so does this.
    pub fn read_scan_fused(&mut self, scan: &Scan<'_>, fuse_distance_m: f64) {
        self.clear();
        let limit = fuse_distance_m * fuse_distance_m;
        let mut cluster = (0.0, 0.0, 0.0);
        for ((range, cos), sin) in scan.ranges_m.iter().zip(&scan.beams.cos).zip(&scan.beams.sin) {
            if !is_return(*range) {
                continue;
            }
            let (x, y) = (range * cos, range * sin);
            let (mean_x, mean_y, n) = cluster;
            let (dx, dy) = (x - mean_x, y - mean_y);
            if n > 0.0 && dx * dx + dy * dy <= limit {
                cluster = (mean_x + dx / (n + 1.0), mean_y + dy / (n + 1.0), n + 1.0);
            } else {
                if n > 0.0 {
                    self.push(mean_x, mean_y);
                }
                cluster = (x, y, 1.0);
            }
        }
        if cluster.2 > 0.0 {
            self.push(cluster.0, cluster.1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan(beams: &Beams, ranges: &[f64]) -> (Points, Points) {
        let scan = Scan { beams, ranges_m: ranges };
        let (mut raw, mut fused) = (Points::default(), Points::default());
        raw.read_scan(&scan);
        fused.read_scan_fused(&scan, 0.05);
        (raw, fused)
    }

    #[test]
    fn beams_are_symmetric_and_include_both_ends() {
        let beams = Beams::new(360, std::f64::consts::PI);
        assert!((beams.sin[0] + 1.0).abs() < 1e-15 && (beams.sin[359] - 1.0).abs() < 1e-15);
        assert!((beams.cos[100] - beams.cos[259]).abs() < 1e-12);
    }

    #[test]
    fn beams_without_a_return_give_no_point() {
        let beams = Beams::new(6, 1.0);
        let (raw, fused) = scan(&beams, &[f64::INFINITY, f64::NAN, -1.0, 1e200, 0.0, 2.0]);
        assert_eq!((raw.len(), fused.len()), (1, 1));
    }

    #[test]
    fn neighbouring_returns_fuse_to_their_true_mean() {
        let beams = Beams { angle_min_rad: 0.0, angle_increment_rad: 0.0, cos: vec![1.0; 4], sin: vec![0.0; 4] };
        let (raw, fused) = scan(&beams, &[1.0, 1.03, 1.04, 2.0]);
        assert_eq!(raw.len(), 4);
        assert_eq!(fused.len(), 2);
        assert!((fused.x_m[0] - (1.0 + 1.03 + 1.04) / 3.0).abs() < 1e-15 && fused.x_m[1] == 2.0);
    }
}
