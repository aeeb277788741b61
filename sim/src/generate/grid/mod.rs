//! Grids of signalised crossings.
//!
//! Crossings are called `nt1`, `nt2`, ... from west to east and then from south to north; the dead ends around them `np1`,
//! `np2`, ... from the south-western corner: the southern ones eastward, the eastern ones northward, the northern ones
//! westward, the western ones southward. A road is called after its ends, as in `nt1_nt2`.

mod options;
mod roads;
mod shape;
mod signals;

pub(crate) use options::whole;
pub use options::{GridOptions, MAX_LANES, MAX_SIDE, RoadOptions};
pub(crate) use roads::{Heading, Place, edge_id, fringe, neighbour, places};
pub(crate) use shape::Shape;

use crate::generate::plain::PlainNet;

/// Width of all lanes, metres: SUMO's own default.
pub(crate) const LANE_WIDTH: f64 = 3.2;

/// The network of a grid; the options have been validated.
pub(crate) fn network(options: &GridOptions) -> PlainNet {
    let shape = Shape::new(options);
    PlainNet {
        nodes: roads::nodes(options, &shape),
        edges: roads::edges(options, &shape),
        connections: roads::connections(options, &shape),
        programs: signals::programs(options, &shape),
        lane_width: LANE_WIDTH,
    }
}
