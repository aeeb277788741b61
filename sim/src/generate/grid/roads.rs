//! Crossings, roads between them, and which lane leads where.

use super::GridOptions;
use super::shape::Shape;
use crate::generate::plain::{Connection, Edge, Node, NodeKind};

/// A place of the grid: crossings have columns 1 to `columns` and rows 1 to `rows`, dead ends lie one further out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) struct Place {
    pub(crate) column: u32,
    pub(crate) row: u32,
}

/// The way a vehicle goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Heading {
    North,
    East,
    South,
    West,
}

/// How a vehicle leaves a crossing, in the order of lanes from the outermost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turn {
    Right,
    Straight,
    Left,
}

/// A link of a crossing: where it comes from and goes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct GridLink {
    pub(super) heading: Heading,
    pub(super) turn: Turn,
    pub(super) from_lane: u32,
    pub(super) to_lane: u32,
}

impl Heading {
    /// The headings of traffic that comes from the north, east, south and west: clockwise, as signal states count.
    pub(super) const APPROACHES: [Self; 4] = [Self::South, Self::West, Self::North, Self::East];

    pub(super) fn is_street(self) -> bool {
        matches!(self, Self::East | Self::West)
    }

    fn after(self, turn: Turn) -> Self {
        const CLOCKWISE: [Heading; 4] = [Heading::North, Heading::East, Heading::South, Heading::West];
        let quarter = match turn {
            Turn::Right => 1,
            Turn::Straight => 0,
            Turn::Left => 3,
        };
        CLOCKWISE[(self as usize + quarter) % 4]
    }

    pub(crate) fn opposite(self) -> Self {
        match self {
            Self::North => Self::South,
            Self::East => Self::West,
            Self::South => Self::North,
            Self::West => Self::East,
        }
    }
}

impl Place {
    fn id(self, options: &GridOptions) -> String {
        let (columns, rows) = (options.columns, options.rows);
        if !is_outside(self, options) {
            return format!("nt{}", columns * (self.row - 1) + self.column);
        }
        let number = if self.row == 0 {
            self.column
        } else if self.column > columns {
            columns + self.row
        } else if self.row > rows {
            columns + rows + (columns + 1 - self.column)
        } else {
            2 * columns + rows + (rows + 1 - self.row)
        };
        format!("np{number}")
    }

    /// Metres east and north of the south-western dead ends' corner.
    fn at(self, options: &GridOptions) -> (f64, f64) {
        let along = |index: u32, count: u32| {
            let (fringe, spacing) = (options.fringe, options.spacing);
            match index {
                0 => 0.0,
                _ if index <= count => fringe + spacing * f64::from(index - 1),
                _ => 2.0 * fringe + spacing * f64::from(count - 1),
            }
        };
        (along(self.column, options.columns), along(self.row, options.rows))
    }
}

/// Whether a place is a dead end.
pub(super) fn is_outside(place: Place, options: &GridOptions) -> bool {
    place.column == 0 || place.row == 0 || place.column > options.columns || place.row > options.rows
}

/// The crossings, from west to east and then from south to north.
pub(crate) fn places(options: &GridOptions) -> impl Iterator<Item = Place> + use<> {
    let columns = options.columns;
    (1..=options.rows).flat_map(move |row| (1..=columns).map(move |column| Place { column, row }))
}

/// The dead ends in the order of their numbers, each with the heading that leads into the grid.
pub(crate) fn fringe(options: &GridOptions) -> Vec<(Place, Heading)> {
    let (columns, rows) = (options.columns, options.rows);
    let south = (1..=columns).map(|column| (Place { column, row: 0 }, Heading::North));
    let east = (1..=rows).map(|row| (Place { column: columns + 1, row }, Heading::West));
    let north = (1..=columns).rev().map(|column| (Place { column, row: rows + 1 }, Heading::South));
    let west = (1..=rows).rev().map(|row| (Place { column: 0, row }, Heading::East));
    south.chain(east).chain(north).chain(west).collect()
}

/// The place next to a crossing, or to a dead end on its way into the grid.
pub(crate) fn neighbour(place: Place, heading: Heading) -> Place {
    let Place { column, row } = place;
    match heading {
        Heading::North => Place { column, row: row + 1 },
        Heading::East => Place { column: column + 1, row },
        // Crossings have columns and rows from 1, and dead ends are only left inwards.
        Heading::South => Place { column, row: row.saturating_sub(1) },
        Heading::West => Place { column: column.saturating_sub(1), row },
    }
}

/// Id of the road from a place to its neighbour.
pub(crate) fn edge_id(options: &GridOptions, from: Place, heading: Heading) -> String {
    format!("{}_{}", from.id(options), neighbour(from, heading).id(options))
}

pub(super) fn light_id(options: &GridOptions, place: Place) -> String {
    place.id(options)
}

pub(super) fn nodes(options: &GridOptions, shape: &Shape) -> Vec<Node> {
    let signal = if options.right_on_red { NodeKind::SignalWithRightOnRed } else { NodeKind::Signal };
    let inside = places(options).map(|place| (place, signal));
    let outside = shape.ends(options).into_iter().map(|(place, _)| (place, NodeKind::Priority));
    inside
        .chain(outside)
        .map(|(place, kind)| {
            let ((x, y), (east, north)) = (place.at(options), shape.moved(place));
            Node { id: place.id(options), at: (x + east, y + north), kind }
        })
        .collect()
}

pub(super) fn edges(options: &GridOptions, shape: &Shape) -> Vec<Edge> {
    let mut edges = Vec::new();
    let mut push = |from: Place, heading: Heading| {
        let road = if heading.is_street() { &options.streets } else { &options.avenues };
        edges.push(Edge {
            id: edge_id(options, from, heading),
            from: from.id(options),
            to: neighbour(from, heading).id(options),
            priority: if heading.is_street() { 2 } else { 1 },
            lane_speeds: vec![road.speed; road.lanes as usize],
            bends: Vec::new(),
        });
    };
    for place in places(options) {
        for heading in Heading::APPROACHES.into_iter().filter(|&heading| shape.is_open(place, heading)) {
            push(place, heading);
        }
    }
    for (place, heading) in shape.ends(options) {
        push(place, heading);
    }
    edges
}

/// The links of a crossing in the order of their letters.
///
/// One lane serves all turns. Of two lanes, the inner one is for left turns alone. From three on the outermost is for
/// right turns alone as well. Who turns stays on the side of the turn. Where a road is missing, the lanes of the turn into it
/// are for those who go straight, or, where nobody can, for left turns, as many as lanes lead on; what is left leads nowhere.
pub(super) fn links(options: &GridOptions, shape: &Shape, place: Place) -> Vec<GridLink> {
    let lanes_of = |heading: Heading| {
        if heading.is_street() { options.streets.lanes } else { options.avenues.lanes }
    };
    let mut links = Vec::new();
    for heading in Heading::APPROACHES.into_iter().filter(|from| shape.is_open(place, from.opposite())) {
        let leads = |turn| shape.is_open(place, heading.after(turn));
        let (right, straight, left) = (leads(Turn::Right), leads(Turn::Straight), leads(Turn::Left));
        let innermost = lanes_of(heading) - 1;
        let mut push = |turn, from_lane, to_lane| {
            links.push(GridLink { heading, turn, from_lane, to_lane });
        };
        if right {
            push(Turn::Right, 0, 0);
        }
        if straight {
            let outer = u32::from(right && innermost >= 2);
            let inner = innermost.saturating_sub(u32::from(left));
            for lane in outer..=inner {
                push(Turn::Straight, lane, lane);
            }
        }
        if left {
            let target = lanes_of(heading.after(Turn::Left)) - 1;
            // Those from further out keep further out, as long as there are lanes for them.
            let beside = if straight { 0 } else { innermost.saturating_sub(1).min(target) };
            for out in (0..=beside).rev() {
                push(Turn::Left, innermost - out, target - out);
            }
        }
    }
    links
}

pub(super) fn connections(options: &GridOptions, shape: &Shape) -> Vec<Connection> {
    let mut connections = Vec::new();
    for place in places(options) {
        for (index, link) in links(options, shape, place).into_iter().enumerate() {
            let before = neighbour(place, link.heading.opposite());
            connections.push(Connection {
                from: edge_id(options, before, link.heading),
                from_lane: link.from_lane as usize,
                to: edge_id(options, place, link.heading.after(link.turn)),
                to_lane: link.to_lane as usize,
                signal: Some((light_id(options, place), index)),
            });
        }
    }
    connections
}
