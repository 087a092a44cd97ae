//! Measures of how a body moves, from the positions of its joints.

mod statue;
mod time_direction;
mod value;

use crate::sanity::{Bounds, FACTOR, Margin};

/// A measure of how a body moves.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum BodyMeasure {
    /// Largest speed of the root on the ground, metres per second.
    FastestRoot,
    /// Mean speed of the joints, metres per second.
    MeanSpeed,
    /// 99th percentile over joints and frames of the speed, metres per second.
    Speed99,
    /// Largest speed of a joint, metres per second.
    FastestJoint,
    /// Mean jerk norm of the joints, metres per second cubed.
    MeanJerk,
    /// 99th percentile over joints and frames of the jerk norm, metres per second cubed.
    Jerk99,
    /// Largest jerk norm of a joint, metres per second cubed.
    LargestJerk,
    /// Largest angle between the axes across hips and shoulders of neighbouring frames, degrees per
    /// second.
    LargestTurn,
    /// Largest acceleration of the root, metres per second squared. A jump to another place has a
    /// large value, however short.
    RootAcceleration,
    /// Largest change of the turn rate ([`LargestTurn`](Self::LargestTurn)) from frame to frame,
    /// degrees per second squared.
    TurnAcceleration,
    /// Share of the steps between frames in which no joint moves.
    StillShare,
    /// Mean speed of the root on the ground divided by the mean speed of the joints around it, to
    /// which 0.05 m/s are added. A statue that is carried around has a large value.
    Glide,
    /// Longest time in which both feet move while the pose stays the same, seconds: a statue that is
    /// carried around or sways.
    Statue,
    /// How much more abruptly the ankles start and rise than stop and fall. Feet land faster than
    /// they lift: walks and runs are negative, and in reverse order positive. 0 of a body that does
    /// not travel.
    TimeDirection,
    /// Share of the steps in which a foot slides ([`sliding_ratio`](crate::metrics::sliding_ratio)).
    Skating,
    /// Lowest height of a joint, metres.
    Lowest,
    /// Median over the frames of the lowest joint's height, metres: a body that hangs over the floor
    /// has a large value.
    Floating,
    /// Longest time in which every joint is more than 0.1 m above the lowest joint's usual height,
    /// seconds.
    LongestFlight,
    /// Median height of the root, in lengths of the leg.
    RootHeight,
    /// Length of the legs, metres.
    LegLength,
}

/// A value of a [`BodyMeasure`], with the frame and joint of an extreme.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyValue {
    /// The value, in the measure's unit.
    pub value: f64,
    /// The frame of an extreme; of a step the frame that it ends in.
    pub frame: Option<usize>,
    /// The joint, if the value is an extreme over joints.
    pub joint: Option<usize>,
}

impl BodyMeasure {
    /// All measures.
    pub const ALL: [Self; 20] = [
        Self::FastestRoot,
        Self::MeanSpeed,
        Self::Speed99,
        Self::FastestJoint,
        Self::MeanJerk,
        Self::Jerk99,
        Self::LargestJerk,
        Self::LargestTurn,
        Self::RootAcceleration,
        Self::TurnAcceleration,
        Self::StillShare,
        Self::Glide,
        Self::Statue,
        Self::TimeDirection,
        Self::Skating,
        Self::Lowest,
        Self::Floating,
        Self::LongestFlight,
        Self::RootHeight,
        Self::LegLength,
    ];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::FastestRoot => "fastest_root",
            Self::MeanSpeed => "mean_speed",
            Self::Speed99 => "speed_p99",
            Self::FastestJoint => "fastest_joint",
            Self::MeanJerk => "mean_jerk",
            Self::Jerk99 => "jerk_p99",
            Self::LargestJerk => "largest_jerk",
            Self::LargestTurn => "largest_turn",
            Self::RootAcceleration => "root_acceleration",
            Self::TurnAcceleration => "turn_acceleration",
            Self::StillShare => "still_share",
            Self::Glide => "glide",
            Self::Statue => "statue",
            Self::TimeDirection => "time_direction",
            Self::Skating => "skating",
            Self::Lowest => "floor",
            Self::Floating => "floating",
            Self::LongestFlight => "flight",
            Self::RootHeight => "root_height",
            Self::LegLength => "leg_length",
        }
    }

    /// Its description, for messages.
    pub fn title(self) -> &'static str {
        match self {
            Self::FastestRoot => "largest speed of the root",
            Self::MeanSpeed => "mean speed of the joints",
            Self::Speed99 => "99th percentile of the joints' speed",
            Self::FastestJoint => "largest speed of a joint",
            Self::MeanJerk => "mean jerk of the joints",
            Self::Jerk99 => "99th percentile of the joints' jerk",
            Self::LargestJerk => "largest jerk of a joint",
            Self::LargestTurn => "largest turn rate of the body",
            Self::RootAcceleration => "largest acceleration of the root",
            Self::TurnAcceleration => "largest change of the body's turn rate",
            Self::StillShare => "share of the steps without movement",
            Self::Glide => "speed of the root relative to that of the limbs",
            Self::Statue => "longest time in which both feet move and the pose stays the same",
            Self::TimeDirection => {
                "how much more abruptly ankles lift than land (as in motion in reverse order)"
            }
            Self::Skating => "share of the steps in which a foot slides",
            Self::Lowest => "height of the lowest joint",
            Self::Floating => "median height of the lowest joint",
            Self::LongestFlight => "longest time above the floor",
            Self::RootHeight => "median height of the root in lengths of the leg",
            Self::LegLength => "length of the legs",
        }
    }

    /// Its unit, empty for a ratio.
    pub fn unit(self) -> &'static str {
        match self {
            Self::FastestRoot | Self::MeanSpeed | Self::Speed99 | Self::FastestJoint => "m/s",
            Self::MeanJerk | Self::Jerk99 | Self::LargestJerk => "m/s^3",
            Self::LargestTurn => "degrees/s",
            Self::RootAcceleration => "m/s^2",
            Self::TurnAcceleration => "degrees/s^2",
            Self::Statue | Self::LongestFlight => "s",
            Self::Lowest | Self::Floating | Self::LegLength => "m",
            Self::StillShare
            | Self::Glide
            | Self::TimeDirection
            | Self::Skating
            | Self::RootHeight => "",
        }
    }

    /// The sides on which it is checked, and by which factor.
    pub fn bounds(self) -> Bounds {
        let margin = |share, least| Margin { share, least };
        let upper_beyond = |harmless| Bounds::UpperBeyond {
            factor: FACTOR,
            harmless,
            end: f64::INFINITY,
        };
        match self {
            Self::FastestRoot => upper_beyond(1.0),
            Self::FastestJoint => upper_beyond(3.0),
            Self::LargestTurn => upper_beyond(360.0),
            Self::RootAcceleration => upper_beyond(20.0),
            Self::TurnAcceleration => upper_beyond(5000.0),
            Self::Jerk99 | Self::LargestJerk => Bounds::Upper(FACTOR),
            // The extremes are checked, and the mean jerk against the 95th percentile.
            Self::MeanSpeed | Self::Speed99 | Self::MeanJerk => Bounds::Unchecked,
            Self::Glide => Bounds::Upper(FACTOR),
            Self::Statue => Bounds::NotAbove(margin(0.0, 1.0)),
            Self::TimeDirection => Bounds::NotAbove(margin(0.0, 0.75)),
            Self::StillShare => Bounds::NotAbove(margin(0.0, 0.3)),
            Self::Skating => Bounds::NotAbove(margin(0.0, 0.2)),
            Self::Lowest => Bounds::NotBelow(margin(0.0, 0.04)),
            Self::Floating => Bounds::NotAbove(margin(0.0, 0.05)),
            Self::LongestFlight => Bounds::NotAbove(margin(0.0, 0.3)),
            Self::RootHeight => Bounds::Around(margin(0.2, 0.0)),
            Self::LegLength => Bounds::Around(margin(0.15, 0.0)),
        }
    }

    /// Whether it exists of a lone root.
    fn is_of_a_root(self) -> bool {
        matches!(self, Self::FastestRoot | Self::Jerk99)
    }

    /// Whether it is a speed or a jerk. Motion beyond [`FAR`](Self::FAR) times their bound is not
    /// usable.
    pub fn is_of_speed(self) -> bool {
        let jerk = matches!(self, Self::Jerk99 | Self::LargestJerk);
        jerk || matches!(self, Self::FastestRoot | Self::FastestJoint)
    }

    /// Multiple of the bound of a speed or a jerk from which on a motion is not usable.
    pub const FAR: f64 = 2.0;
}
