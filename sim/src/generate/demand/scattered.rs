//! Single trips between dead ends drawn at random.

use super::VEHICLE_TYPE;
use crate::generate::grid::{GridOptions, Shape, edge_id, neighbour};
use crate::generate::xml::XmlFile;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::io::{self, Write};

/// How many trips an average rate makes.
pub(super) fn vehicles(per_hour: u32, duration: u32) -> u64 {
    (u64::from(per_hour) * u64::from(duration) + 1800) / 3600
}

/// Trips in order of departure. `rate` is the relative rate, between 0 and 1, at a share of the duration.
pub(super) fn trips<W: Write>(
    xml: &mut XmlFile<W>,
    options: &GridOptions,
    per_hour: u32,
    duration: u32,
    rate: impl Fn(f64) -> f64,
) -> io::Result<()> {
    let mut generator = ChaCha8Rng::seed_from_u64(options.seed);
    // Given their number, the departures of a Poisson process are independent draws from its rate.
    let mut departures: Vec<u32> = (0..vehicles(per_hour, duration))
        .map(|_| {
            loop {
                let share: f64 = generator.random();
                if generator.random::<f64>() < rate(share) {
                    break ((share * f64::from(duration)) as u32).min(duration - 1);
                }
            }
        })
        .collect();
    departures.sort_unstable();
    let ends = Shape::new(options).ends(options);
    for (number, depart) in departures.iter().enumerate() {
        let origin = generator.random_range(0..ends.len());
        // Any other end, each as likely: a grid has at least two.
        let destination = (origin + generator.random_range(1..ends.len())) % ends.len();
        let ((from, into), (to, back)) = (ends[origin], ends[destination]);
        xml.element(
            "trip",
            &[
                ("id", &number),
                ("type", &VEHICLE_TYPE),
                ("depart", depart),
                ("from", &edge_id(options, from, into)),
                ("to", &edge_id(options, neighbour(to, back), back.opposite())),
            ],
        )?;
    }
    Ok(())
}
