//! Which row to follow, when it ends, and how to change to the next one; or a lane from here to its end; or all lanes of a nursery.

pub mod lane;
pub mod nursery;
pub mod row_by_row;

pub use lane::{LaneFollower, LaneParams};
pub use nursery::{NurseryMission, NurseryParams, NurserySight, NurseryStep};
pub use row_by_row::{RowByRow, RowByRowParams};

use crate::control::WheelSpeeds;

/// What a robot is told before it starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Brief {
    /// Inter-rows to drive through; the first new one lies to the left.
    pub inter_rows: u32,
}

/// What a mission wants after a control cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// Drive on with these wheel speeds.
    Drive(WheelSpeeds),
    /// The end of the last inter-row is reached.
    Finished,
    /// The robot does not know where it is, and stops.
    Lost,
}
