//! The probe that writes what it sees.

use std::io::Write;

use foxglove::messages::{FrameTransform, FrameTransforms, LaserScan, PointCloud, SceneUpdate};
use furrow_navigation::perception::Points;
use furrow_sim::field::Field;
use furrow_sim::run::STEPS_PER_S;
use furrow_sim::{Detection, InSpace, Part, Pose, Probe, Scan};
use mcap::McapError;

use super::facts::{Motion, Outcome, metadata};
use super::file::{File, Topic};
use super::messages::{BASE, WORLD, laser_scan, point_cloud, transform};
use super::motion::Motions;
use super::mount::Mount;
use super::space::SpaceEye;
use super::{Run, scene};

/// One step of the loop.
pub(super) const STEP_NS: u64 = 1_000_000_000 / STEPS_PER_S as u64;

/// The topics of one LiDAR.
struct Eye {
    mount: Mount,
    scan: Topic<LaserScan>,
    points: Topic<PointCloud>,
    lines: Topic<SceneUpdate>,
}

/// Writes a run while it is simulated; after an error it asks to stop.
pub(super) struct Recorder<'a, W: Write> {
    run: &'a Run<'a>,
    file: File<W>,
    eyes: Vec<Eye>,
    space: Option<SpaceEye>,
    transforms: Topic<FrameTransform>,
    motions: Topic<Motion>,
    interventions: Topic<SceneUpdate>,
    outcome: Topic<Outcome>,
    motion: Motions<'a>,
    /// Steps that were driven.
    step: u64,
    /// LiDARs that have looked in this step.
    looked: usize,
    /// Where the robot is, until that is written.
    standing: Option<Pose>,
    told: usize,
    points: Points,
    failure: Option<McapError>,
}

impl<'a, W: Write> Recorder<'a, W> {
    /// A file that says which run it is, and holds what does not move.
    pub(super) fn begin(run: &'a Run<'a>, field: &'a Field, out: W) -> Result<Self, McapError> {
        let mut file = File::begin(out)?;
        file.metadata("furrow", metadata(run))?;
        let eyes: Vec<Eye> =
            Mount::all(run.scenario).into_iter().map(|mount| Eye::new(mount, &mut file)).collect::<Result<_, _>>()?;
        let mounts = eyes
            .iter()
            .map(|Eye { mount, .. }| transform(0, [BASE, mount.frame], mount.robot_from_lidar(), mount.height_m));
        let in_space = SpaceEye::mount(run.scenario);
        let space = in_space.is_some().then(|| SpaceEye::new(&mut file)).transpose()?;
        let fixed = FrameTransforms { transforms: mounts.chain(in_space).collect() };
        let mut topic = file.topic("/tf_static")?;
        file.write(&mut topic, 0, &fixed)?;
        let mut topic = file.topic("/field")?;
        file.write(&mut topic, 0, &scene::field(field, &run.result.damaged))?;
        let mut topic = file.topic("/robot/body")?;
        file.write(&mut topic, 0, &scene::robot(run.scenario))?;
        Ok(Self {
            run,
            transforms: file.topic("/tf")?,
            motions: file.json_topic("/robot/motion")?,
            interventions: file.topic("/interventions")?,
            outcome: file.json_topic("/metrics")?,
            motion: Motions::new(run, field),
            file,
            eyes,
            space,
            step: 0,
            looked: 0,
            standing: None,
            told: 0,
            points: Points::default(),
            failure: None,
        })
    }

    /// What came out, and the end of the file.
    pub(super) fn finish(mut self) -> Result<(), McapError> {
        self.stand()?;
        self.tell(f64::INFINITY)?;
        if let Some(failure) = self.failure {
            return Err(failure);
        }
        self.file.write_json(&mut self.outcome, self.step * STEP_NS, &Outcome::of(self.run))?;
        self.file.end()
    }

    fn attempt(&mut self, work: impl FnOnce(&mut Self) -> Result<(), McapError>) {
        if self.failure.is_none() {
            self.failure = work(self).err();
        }
    }

    /// Writes where the robot is in this step, once.
    fn stand(&mut self) -> Result<(), McapError> {
        let Some(pose) = self.standing.take() else { return Ok(()) };
        let time_ns = self.step * STEP_NS;
        self.file.write(&mut self.transforms, time_ns, &transform(time_ns, [WORLD, BASE], pose, 0.0))
    }

    /// Writes the interventions up to a moment \[s\].
    fn tell(&mut self, time_s: f64) -> Result<(), McapError> {
        let all = &self.run.result.interventions;
        let told = all.iter().take_while(|intervention| intervention.time_s <= time_s).count();
        if told == self.told {
            return Ok(());
        }
        self.told = told;
        let time_ns = self.step * STEP_NS;
        self.file.write(&mut self.interventions, time_ns, &scene::interventions(time_ns, &all[..told]))
    }

    fn posed(&mut self, time_s: f64, pose: Pose) -> Result<(), McapError> {
        self.standing = Some(pose);
        self.tell(time_s)?;
        self.file.write_json(&mut self.motions, self.step * STEP_NS, &self.motion.at(time_s, pose))
    }

    fn saw(&mut self, world_from_lidar: Pose, scan: &Scan<'_>, found: Detection<'_>) -> Result<(), McapError> {
        if self.looked == 0 {
            // An operator may have moved the robot since its pose was shown.
            let pose = self.eyes[0].mount.world_from_robot(world_from_lidar);
            self.standing = Some(pose);
            self.motion.stands(self.step as f64 / f64::from(STEPS_PER_S), pose);
            self.stand()?;
        }
        let time_ns = self.step * STEP_NS;
        let Some(eye) = self.eyes.get_mut(self.looked) else { return Ok(()) };
        self.looked += 1;
        let points = match found {
            Detection::Lines(found) => found.points,
            Detection::Lane(_) => {
                self.points.read_scan(scan);
                &self.points
            }
        };
        self.file.write(&mut eye.scan, time_ns, &laser_scan(time_ns, eye.mount.frame, scan))?;
        self.file.write(&mut eye.points, time_ns, &point_cloud(time_ns, eye.mount.frame, points))?;
        self.file.write(&mut eye.lines, time_ns, &scene::found(time_ns, &eye.mount, found))
    }
}

impl<W: Write> Probe for Recorder<'_, W> {
    fn pose(&mut self, time_s: f64, world_from_robot: Pose) {
        self.attempt(|recorder| recorder.posed(time_s, world_from_robot));
    }

    fn scanned(&mut self, world_from_lidar: Pose, scan: &Scan<'_>, found: Detection<'_>) {
        self.attempt(|recorder| recorder.saw(world_from_lidar, scan, found));
    }

    fn scanned_in_space(&mut self, _world_from_robot: Pose, sight: &InSpace<'_>) {
        self.attempt(|recorder| {
            recorder.stand()?;
            let time_ns = recorder.step * STEP_NS;
            recorder.space.as_mut().map_or(Ok(()), |space| space.write(&mut recorder.file, time_ns, sight))
        });
    }

    /// The robot drives on once in every step, which is how time goes by.
    fn begin(&mut self, part: Part) {
        if part == Part::Drive {
            self.attempt(Self::stand);
            self.step += 1;
            self.looked = 0;
        }
    }

    fn stop(&mut self) -> bool {
        self.failure.is_some()
    }
}

impl Eye {
    fn new<W: Write>(mount: Mount, file: &mut File<W>) -> Result<Self, McapError> {
        let name = |what: &str| format!("/lidar/{}/{what}", mount.name);
        Ok(Self {
            scan: file.topic(&name("scan"))?,
            points: file.topic(&name("points"))?,
            lines: file.topic(&name("lines"))?,
            mount,
        })
    }
}
