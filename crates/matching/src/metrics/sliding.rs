//! Foot sliding.

use kinegrad_motion::feet::{Leg, Standing, sliding};
use serde::Serialize;

/// Foot sliding in contact, before and after locking.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sliding {
    /// Fraction of the frames in contact, over all feet.
    pub in_contact: f64,
    /// Mean speed in contact before locking, in file units, or in metres
    /// ([`in_metres`](Self::in_metres)), a second.
    pub before: f64,
    /// The same after locking.
    pub after: f64,
}

impl Sliding {
    /// The speeds in metres, of motions in units of so many metres.
    #[must_use]
    pub fn in_metres(self, metres_per_unit: f64) -> Self {
        Self {
            before: metres_per_unit * self.before,
            after: metres_per_unit * self.after,
            ..self
        }
    }

    /// Sliding of legs in motions `[frames][joints]` whose contacts are those of `standing`.
    pub(crate) fn of(
        before: &[Vec<[f64; 3]>],
        after: &[Vec<[f64; 3]>],
        legs: &[Leg],
        standing: &Standing<'_>,
        frame_time: f64,
    ) -> Self {
        let speed = |places: &[Vec<[f64; 3]>]| {
            let of = |(leg, contacts): (&Leg, &Vec<bool>)| {
                let path: Vec<[f64; 3]> = places.iter().map(|frame| frame[leg.sole]).collect();
                sliding(&path, contacts, standing.up) / frame_time
            };
            legs.iter().zip(standing.contacts).map(of).sum::<f64>() / legs.len() as f64
        };
        let flags = standing.contacts.concat();
        let in_contact = flags.iter().filter(|&&contact| contact).count();
        Self {
            in_contact: in_contact as f64 / flags.len() as f64,
            before: speed(before),
            after: speed(after),
        }
    }
}
