//! Placeholder until the fast one arrives.
use super::Point3;
/// x
#[derive(Debug, Clone, Default)]
pub struct OutlierRemoval {
    d: Vec<f64>,
}
impl OutlierRemoval {
    /// x
    pub fn statistical(&mut self, points: &mut Vec<Point3>, k: u32, m: f64) {
        if points.len() <= k as usize {
            return;
        }
        self.d.clear();
        let mut best: Vec<f64> = Vec::new();
        for p in points.iter() {
            best.clear();
            best.extend(points.iter().map(|q| p.squared_distance(q)));
            let (low, at, _) = best.select_nth_unstable_by(k as usize, f64::total_cmp);
            let sum: f64 = low.iter().map(|d| d.sqrt()).sum::<f64>() + at.sqrt();
            self.d.push(sum / f64::from(k));
        }
        let n = self.d.len() as f64;
        let mean = self.d.iter().sum::<f64>() / n;
        let sd = (self.d.iter().map(|d| (d - mean) * (d - mean)).sum::<f64>() / (n - 1.0)).sqrt();
        let mut i = 0;
        let d = &self.d;
        points.retain(|_| {
            i += 1;
            d[i - 1] <= mean + m * sd
        });
    }
    /// x
    pub fn radius(&mut self, points: &mut Vec<Point3>, k: u32, r: f64) {
        let all = points.clone();
        points.retain(|p| all.iter().filter(|q| p.squared_distance(q) <= r * r).count() > k as usize);
    }
}
