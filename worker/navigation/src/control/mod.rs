//! From the rows around the robot, its place in a lane or the line to follow, to commands.

pub mod fuzzy;
pub mod lane;
pub mod mid_line;

pub use fuzzy::{Fuzzy, FuzzyParams};
pub use lane::{LanePd, LanePdParams};
pub use mid_line::io_linearization::{IoLinearization, IoLinearizationParams};
pub use mid_line::pid::{MidLinePid, MidLinePidParams};
pub use mid_line::{MidLine, MidLineControl};

crate::kinds! {
    /// Which controller follows a row.
    pub enum ControlSpec {
        /// The fuzzy controller of Guyonneau et al. (2022), section 3.3.
        Fuzzy(FuzzyParams) = "fuzzy",
        /// Proportional and derivative control in a lane: Velasquez et al. (2022), section 3.4.
        LanePd(LanePdParams) = "lane-pd",
        /// Two PID loops along a mid line: Vintu (2018), section 2.5.1.
        Pid(MidLinePidParams) = "pid",
        /// Input-output linearization along a mid line: Vintu (2018), section 2.5.2.
        IoLinearization(IoLinearizationParams) = "io-linearization",
    }
}

impl ControlSpec {
    /// A controller that has seen no line yet; none for what follows no mid line.
    #[must_use]
    pub fn mid_line(&self) -> Option<Box<dyn MidLineControl>> {
        match self {
            Self::Fuzzy(_) | Self::LanePd(_) => None,
            Self::Pid(params) => Some(Box::new(MidLinePid::new(params))),
            Self::IoLinearization(params) => Some(Box::new(IoLinearization::new(params.clone()))),
        }
    }
}

/// How the robot moves, in its own frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Twist {
    /// Forward speed \[m/s\].
    pub linear_m_s: f64,
    /// Yaw rate \[rad/s\], counter-clockwise.
    pub angular_rad_s: f64,
}

impl Twist {
    /// The way ahead \[m\] and the turn \[rad\] in `dt_s` \[s\]; none if a number is not finite or beyond any robot's.
    #[must_use]
    pub fn moved(self, dt_s: f64) -> Option<(f64, f64)> {
        let moved = (self.linear_m_s * dt_s, self.angular_rad_s * dt_s);
        (moved.0.abs() <= FARTHEST && moved.1.abs() <= FARTHEST && dt_s >= 0.0).then_some(moved)
    }
}

/// No robot moves this far between two steps \[m or rad\].
const FARTHEST: f64 = 1e6;

/// Speeds of the two wheels [rad/s]; positive drives forward.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WheelSpeeds {
    /// Left wheel [rad/s].
    pub left_rad_s: f64,
    /// Right wheel [rad/s].
    pub right_rad_s: f64,
}

impl WheelSpeeds {
    /// Both wheels stand.
    pub const STOP: Self = Self::new(0.0, 0.0);

    /// Left and right [rad/s].
    #[must_use]
    pub const fn new(left_rad_s: f64, right_rad_s: f64) -> Self {
        Self { left_rad_s, right_rad_s }
    }

    /// Both speeds times `factor`.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self::new(self.left_rad_s * factor, self.right_rad_s * factor)
    }
}
