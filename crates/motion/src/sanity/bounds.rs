//! Bounds of a measure from its values in reference motion.

use super::Threshold;

/// Allowed factor beyond the 1st and 99th percentile of the reference motion.
pub(crate) const FACTOR: f64 = 2.0;

/// The sides on which a measure is compared with reference motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bounds {
    /// At least the 1st percentile divided by the factor, and at most the 99th times it.
    Both(f64),
    /// At most the 99th percentile times the factor.
    Upper(f64),
    /// The same, but values up to `harmless` are always allowed.
    UpperBeyond {
        /// Multiple of the 99th percentile.
        factor: f64,
        /// Value that is always allowed, in the measure's unit.
        harmless: f64,
        /// Largest possible value of the measure. The bound lies at most half of the distance from the
        /// reference to it.
        end: f64,
    },
    /// Within both percentiles and the margin.
    Around(Margin),
    /// At least the 1st percentile minus the margin.
    NotBelow(Margin),
    /// At most the 99th percentile plus the margin.
    NotAbove(Margin),
    /// Not compared: it depends on the motion's length.
    Unchecked,
}

/// Allowed distance beyond a percentile: a share of the 99th, and not less than `least`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// Share of the 99th percentile.
    pub share: f64,
    /// Smallest distance, in the measure's unit.
    pub least: f64,
}

impl Bounds {
    /// The allowed values of a measure whose 1st and 99th percentile in reference motion are given.
    /// A motion `shorter` than the reference by that factor may be so much less or more lively.
    pub(super) fn threshold(self, [low, high]: [f64; 2], shorter: f64) -> Option<Threshold> {
        let beyond = |margin: Margin| shorter * (margin.share * high.abs()).max(margin.least);
        match self {
            Self::Both(factor) => {
                let factor = factor * shorter;
                Some(Threshold::Within([low / factor, high * factor]))
            }
            Self::Upper(factor) => Some(Threshold::AtMost(high * factor)),
            Self::UpperBeyond {
                factor,
                harmless,
                end,
            } => {
                let most = (high + end) / 2.0;
                Some(Threshold::AtMost((high * factor).max(harmless).min(most)))
            }
            Self::Around(margin) => {
                let margin = beyond(margin);
                Some(Threshold::Within([low - margin, high + margin]))
            }
            Self::NotBelow(margin) => Some(Threshold::AtLeast(low - beyond(margin))),
            Self::NotAbove(margin) => Some(Threshold::AtMost(high + beyond(margin))),
            Self::Unchecked => None,
        }
    }
}
