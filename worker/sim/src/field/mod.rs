//! Fields: plants, rows, and where the robot starts.

pub mod custom;
mod custom_schema;
pub mod guyonneau2022;
pub mod lane;
mod polyline;
pub mod velasquez2022;
pub mod vintu2018;

use serde::{Deserialize, Serialize};

pub use lane::Lane;
pub use polyline::{OnLine, Polyline};
pub use vintu2018::Nursery;

use crate::Pose;

furrow_navigation::kinds! {
    /// Which field the robot drives in.
    pub enum FieldSpec {
        /// Crops 1 to 4 of Guyonneau et al. (2022).
        Guyonneau2022(guyonneau2022::Guyonneau2022Params) = "guyonneau2022",
        /// Lanes of Velasquez et al. (2022).
        Velasquez2022(velasquez2022::Velasquez2022Params) = "velasquez2022",
        /// Tree nurseries and the test garden of Vintu (2018).
        Vintu2018(vintu2018::Vintu2018Params) = "vintu2018",
        /// A user's own field.
        Custom(custom::CustomField) = "custom",
    }
}

impl FieldSpec {
    /// Whether a robot can drive from inter-row to inter-row in it.
    #[must_use]
    pub const fn among_rows(&self) -> bool {
        matches!(self, Self::Guyonneau2022(_) | Self::Custom(_))
    }

    /// The field: a pure function of its parameters and, where these say so, the job's seed.
    #[must_use]
    pub fn build(&self, job_seed: u64) -> Field {
        match self {
            Self::Guyonneau2022(params) => guyonneau2022::build(params, job_seed),
            Self::Velasquez2022(params) => velasquez2022::build(params, job_seed),
            Self::Vintu2018(params) => vintu2018::build(params, job_seed),
            Self::Custom(custom) => custom.build(),
        }
    }
}

/// Where a field's randomness comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FieldSeed {
    /// The same field for every job: `{"fixed": 1}`.
    Fixed(u64),
    /// A field per job seed: `"job"`.
    Job,
}

impl FieldSeed {
    /// The seed to draw the field with.
    #[must_use]
    pub const fn resolve(self, job_seed: u64) -> u64 {
        match self {
            Self::Fixed(seed) => seed,
            Self::Job => job_seed,
        }
    }
}

impl furrow_navigation::parameters::ParameterType for FieldSeed {
    const SCHEMA: &'static str = r#"{"anyOf":[{"const":"job"},{"type":"object","properties":{"fixed":{"type":"integer","minimum":0}},"required":["fixed"],"additionalProperties":false}]}"#;
}

/// What grows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlantKind {
    /// To be kept.
    Crop,
    /// Seen by the LiDAR all the same.
    Weed,
}

/// A vertical stem; in a nursery a tree or shrub, seen from above.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plant {
    /// \[m\]
    pub x_m: f64,
    /// \[m\]
    pub y_m: f64,
    /// Radius of the stem, in a nursery of the crown \[m\].
    pub radius_m: f64,
    /// \[m\]
    pub height_m: f64,
    /// Crop or weed.
    pub kind: PlantKind,
    /// Index of its row; ignored for weeds.
    #[serde(default)]
    pub row: u32,
}

/// A field.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// For people.
    pub name: String,
    /// Nominal distance between rows \[m\].
    pub row_spacing_m: f64,
    /// Centre lines of the rows, in the order in which the robot meets them: from its right to its left,
    /// in a nursery perhaps the other way.
    pub rows: Vec<Polyline>,
    /// Middle lines of the inter-rows: number i lies between rows i and i + 1.
    pub middles: Vec<Polyline>,
    /// All plants.
    pub plants: Vec<Plant>,
    /// The robot at time 0, in the first inter-row.
    pub start: Pose,
    /// How many inter-rows the robot is to drive through.
    pub inter_rows: u32,
    /// Positions count into the squared error where x lies in this range \[m\]; none: 1 m inside the row's extent.
    pub error_range_x_m: Option<[f64; 2]>,
    /// The lane that the robot is to follow, where the field is one: not necessarily its first inter-row.
    pub lane: Option<Lane>,
    /// Plants in space, the ground and the map, where the field is a nursery.
    pub nursery: Option<Nursery>,
}

impl Field {
    /// Middle lines between neighbouring rows.
    fn middles(rows: &[Polyline]) -> Vec<Polyline> {
        rows.windows(2).map(|pair| Polyline::middle(&pair[0], &pair[1])).collect()
    }

    /// Whether the position is a sample of the squared error: inside the rows, away from their ends.
    #[must_use]
    pub fn counts_as_inside(&self, x_m: f64, on_middle: &OnLine) -> bool {
        match self.error_range_x_m {
            Some([from, to]) => (from..=to).contains(&x_m),
            None => on_middle.is_inside(1.0),
        }
    }
}
