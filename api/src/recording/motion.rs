//! How the robot moves, from pose to pose.

use furrow_sim::Pose;
use furrow_sim::field::Field;
use furrow_sim::observer::Intervention;

use super::Run;
use super::facts::Motion;
use super::mount::Mount;

/// Looks at one pose after the other.
pub(super) struct Motions<'a> {
    field: &'a Field,
    interventions: &'a [Intervention],
    lidar: Option<Mount>,
    /// The pose before and its time \[s\]; none at the start, and where an operator moves the robot.
    before: Option<(f64, Pose)>,
    /// Along the lane \[m\].
    along_m: f64,
}

impl<'a> Motions<'a> {
    pub(super) fn new(run: &'a Run<'a>, field: &'a Field) -> Self {
        let lidar = Mount::all(run.scenario).into_iter().next();
        Self { field, interventions: &run.result.interventions, lidar, before: None, along_m: 0.0 }
    }

    /// The robot stands there now, wherever it was put from.
    pub(super) fn stands(&mut self, time_s: f64, pose: Pose) {
        self.before = Some((time_s, pose));
    }

    pub(super) fn at(&mut self, time_s: f64, pose: Pose) -> Motion {
        let since = |(then_s, before): (f64, Pose)| {
            let (ahead_m, _) = before.local(pose.x_m, pose.y_m);
            let turned_rad = pose.heading_rad - before.heading_rad;
            (ahead_m / (time_s - then_s), turned_rad / (time_s - then_s))
        };
        let rates = self.before.map(since);
        let moved = self.interventions.iter().any(|intervention| intervention.time_s == time_s);
        self.before = (!moved).then_some((time_s, pose));
        Motion {
            time_s,
            speed_m_s: rates.map(|(speed, _)| speed),
            yaw_rate_rad_s: rates.map(|(_, yaw_rate)| yaw_rate),
            cross_track_m: self.cross_track_m(pose),
        }
    }

    fn cross_track_m(&mut self, pose: Pose) -> Option<f64> {
        if let (Some(lane), Some(lidar)) = (&self.field.lane, &self.lidar) {
            let at = (lidar.world_from_lidar(pose), lidar.x_m);
            let place = lane.place(self.field, at, self.along_m);
            self.along_m = place.along_m;
            return Some(place.across_m);
        }
        let inside = self.field.middles.iter().map(|middle| middle.project(pose.x_m, pose.y_m));
        let inside = inside.filter(|on_middle| on_middle.is_inside(0.0)).map(|on_middle| on_middle.across_m);
        inside
            .min_by(|a, b| a.abs().total_cmp(&b.abs()))
            .filter(|across| across.abs() <= 0.5 * self.field.row_spacing_m)
    }
}
