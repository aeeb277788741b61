//! Two waves of through traffic, as in the MA2C benchmark (Chu et al., 2019).

use super::VEHICLE_TYPE;
use crate::generate::grid::{GridOptions, Heading, Place, edge_id, fringe, neighbour, places};
use crate::generate::xml::XmlFile;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::io::{self, Write};

/// Share of the peak in each slot, percent: the first wave, and the second.
const RATIOS: [[u64; 7]; 2] = [[40, 70, 90, 100, 75, 50, 25], [30, 80, 90, 100, 80, 60, 20]];
/// Slot in which the second wave begins.
const SECOND_BEGINS: usize = 3;
const SLOTS: usize = SECOND_BEGINS + 7;
/// North-south traffic per east-west traffic, percent.
const AVENUE_SHARE: u64 = 60;

/// A dead end and the heading that leads from it into the grid.
type End = (Place, Heading);

/// Vehicles that stand on every lane between two crossings at time 0, each lane's with one exit drawn at random.
pub(super) fn initial<W: Write>(
    xml: &mut XmlFile<W>,
    options: &GridOptions,
    vehicles: u32,
) -> io::Result<()> {
    if vehicles == 0 {
        return Ok(());
    }
    let mut generator = ChaCha8Rng::seed_from_u64(options.seed);
    let exits: Vec<_> = fringe(options).into_iter().map(|end| exit(options, end)).collect();
    let inside = |place: Place| {
        (1..=options.columns).contains(&place.column) && (1..=options.rows).contains(&place.row)
    };
    for place in places(options) {
        for heading in [Heading::East, Heading::West, Heading::North, Heading::South] {
            if !inside(neighbour(place, heading)) {
                continue;
            }
            let road = edge_id(options, place, heading);
            let is_street = matches!(heading, Heading::East | Heading::West);
            let lanes = if is_street { options.streets.lanes } else { options.avenues.lanes };
            for lane in 0..lanes {
                let to = &exits[generator.random_range(0..exits.len())];
                xml.element(
                    "flow",
                    &[
                        ("id", &format!("initial_{road}_{lane}")),
                        ("type", &VEHICLE_TYPE),
                        ("begin", &0),
                        ("end", &1),
                        ("number", &vehicles),
                        ("from", &road),
                        ("to", to),
                        ("departPos", &"random_free"),
                        ("departSpeed", &0),
                        ("departLane", &lane),
                    ],
                )?;
            }
        }
    }
    Ok(())
}

/// The flows of both waves, slot by slot.
pub(super) fn waves<W: Write>(
    xml: &mut XmlFile<W>,
    options: &GridOptions,
    peaks: [u32; 2],
    slot_seconds: u32,
) -> io::Result<()> {
    let pairs = pairs(options);
    for slot in 0..SLOTS {
        for wave in 0..2 {
            let Some(ratio) = slot.checked_sub(wave * SECOND_BEGINS).and_then(|slot| RATIOS[wave].get(slot))
            else {
                continue;
            };
            for (number, (from, to)) in pairs[wave].iter().enumerate() {
                let is_avenue = matches!(from.1, Heading::North | Heading::South);
                let share = if is_avenue { AVENUE_SHARE } else { 100 };
                // Whole vehicles an hour, cut off as the benchmark does.
                let rate = u64::from(peaks[wave]) * share * ratio / 10_000;
                if rate == 0 {
                    continue;
                }
                let begin = slot as u32 * slot_seconds;
                xml.element(
                    "flow",
                    &[
                        ("id", &format!("wave{}_{number}_{slot}", wave + 1)),
                        ("type", &VEHICLE_TYPE),
                        ("begin", &begin),
                        ("end", &(begin + slot_seconds)),
                        ("vehsPerHour", &rate),
                        ("from", &edge_id(options, from.0, from.1)),
                        ("to", &exit(options, *to)),
                        ("departPos", &"random_free"),
                    ],
                )?;
            }
        }
    }
    Ok(())
}

/// Origins and destinations of both waves, for grids of at least five columns and three rows.
///
/// The first wave crosses over: from the fourth avenue in the north to the second in the south, from the last street in
/// the west to the first in the east, and so on. The second goes straight.
fn pairs(options: &GridOptions) -> [Vec<(End, End)>; 2] {
    let (columns, rows) = (options.columns, options.rows);
    let avenues = [2, columns.div_ceil(2), columns - 1];
    let streets = [1, rows.div_ceil(2), rows];
    let north = |column| (Place { column, row: rows + 1 }, Heading::South);
    let south = |column| (Place { column, row: 0 }, Heading::North);
    let west = |row| (Place { column: 0, row }, Heading::East);
    let east = |row| (Place { column: columns + 1, row }, Heading::West);
    let crossing = |of: [u32; 3]| [(of[2], of[0]), (of[1], of[1]), (of[0], of[2])];
    let first = crossing(avenues)
        .map(|(from, to)| (north(from), south(to)))
        .into_iter()
        .chain(crossing(streets).map(|(from, to)| (west(from), east(to))));
    let second = avenues
        .map(|column| (south(column), north(column)))
        .into_iter()
        .chain(streets.map(|row| (east(row), west(row))));
    [first.collect(), second.collect()]
}

/// The road that leads to a dead end.
fn exit(options: &GridOptions, (place, inward): End) -> String {
    edge_id(options, neighbour(place, inward), inward.opposite())
}
