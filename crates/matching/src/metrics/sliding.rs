//! How far feet slide while they are in contact.

use kinegrad_motion::feet::{Leg, sliding};
use serde::Serialize;

/// How far feet slid in contact, before and after they were held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sliding {
    /// Part of the frames in which a foot is in contact, of all feet.
    pub in_contact: f64,
    /// Mean speed of feet in contact before, in the file's units a second.
    pub before: f64,
    /// The same after.
    pub after: f64,
}

impl Sliding {
    /// Of legs in motions `[frames][joints]`, one frame every `frame_time` seconds, whose feet are in
    /// contact as `contacts` say, `[legs][frames]`.
    pub(crate) fn of(
        before: &[Vec<[f64; 3]>],
        after: &[Vec<[f64; 3]>],
        legs: &[Leg],
        contacts: &[Vec<bool>],
        frame_time: f64,
    ) -> Self {
        let speed = |places: &[Vec<[f64; 3]>]| {
            let of = |(leg, contacts): (&Leg, &Vec<bool>)| {
                let path: Vec<[f64; 3]> = places.iter().map(|frame| frame[leg.sole]).collect();
                sliding(&path, contacts) / frame_time
            };
            legs.iter().zip(contacts).map(of).sum::<f64>() / legs.len() as f64
        };
        let flags = contacts.concat();
        let in_contact = flags.iter().filter(|&&contact| contact).count();
        Self {
            in_contact: in_contact as f64 / flags.len() as f64,
            before: speed(before),
            after: speed(after),
        }
    }
}
