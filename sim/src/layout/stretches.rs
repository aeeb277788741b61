//! What lies behind an incoming lane and beyond an outgoing one: the same street, under other names.
//!
//! ```text
//!   a ══════> b ═══> c ═| stop line      c is the incoming lane; b and a lead nowhere else, and are behind it
//!   d ════╗
//!         ╠═> e ═|                       d leads to two lanes of one road, and is behind both
//!         ╚═> f ═|
//!   |═> g ══> h ════| stop line          h is beyond the outgoing lane g, as all is that vehicles come to next
//! ```

use super::Stretch;
use crate::lanes::FAR_METRES;
use crate::net::Net;
use std::collections::{HashMap, HashSet};

/// Most lanes behind or beyond one; the maps that come with the set-up have up to nine. A map of lanes without length must not take
/// memory for each pair of them.
const MOST_STRETCHES: usize = 16;

/// Edge and lane, as indices into [`Net::edges`] and its lanes.
type At = (usize, usize);

/// How lanes follow each other where no signal is between them and a lane leads to one road alone.
pub(super) struct Street {
    before: HashMap<At, Vec<At>>,
    after: HashMap<At, Vec<At>>,
}

impl Street {
    pub(super) fn new(net: &Net) -> Self {
        let links = net.traffic_lights.iter().flat_map(|light| &light.links);
        let signalised: HashSet<At> = links.map(|link| link.from).collect();
        // The road that a lane leads to, none if there are several.
        let mut roads: HashMap<At, Option<usize>> = HashMap::new();
        for join in &net.joins {
            let road = roads.entry(join.from).or_insert(Some(join.to.0));
            *road = road.filter(|&road| road == join.to.0);
        }
        let mut street = Self { before: HashMap::new(), after: HashMap::new() };
        for join in &net.joins {
            if roads[&join.from].is_some() && !signalised.contains(&join.from) {
                street.before.entry(join.to).or_default().push(join.from);
                street.after.entry(join.from).or_default().push(join.to);
            }
        }
        street
    }

    /// The lanes behind an incoming lane.
    pub(super) fn behind(&self, net: &Net, incoming: At) -> Vec<Stretch> {
        let found = follow(net, &self.before, incoming, net.lane(incoming).length);
        found.into_iter().map(|(at, before)| stretch(net, at, before)).collect()
    }

    /// The lanes beyond an outgoing lane.
    pub(super) fn beyond(&self, net: &Net, outgoing: At) -> Vec<Stretch> {
        let found = follow(net, &self.after, outgoing, 0.0);
        let past = |&(at, before): &(At, f64)| before + net.lane(at).length;
        let end = found.iter().map(past).fold(0.0, f64::max);
        found.iter().map(|own| stretch(net, own.0, end - past(own))).collect()
    }
}

/// The lanes that follow one by the shortest ways, the nearest first, with the metres to where each begins; at most
/// [`MOST_STRETCHES`], and none that begins [`FAR_METRES`] away.
fn follow(net: &Net, next: &HashMap<At, Vec<At>>, from: At, metres: f64) -> Vec<(At, f64)> {
    let mut found = Vec::new();
    // Ways part and meet again.
    let mut seen = HashSet::new();
    // Each with the metres to where it begins and to where it ends.
    let mut open = vec![(from, metres, metres)];
    while let Some(nearest) = (0..open.len()).min_by(|&a, &b| open[a].1.total_cmp(&open[b].1)) {
        let (at, begins, ends) = open.swap_remove(nearest);
        if !seen.insert(at) {
            continue;
        }
        if at != from {
            found.push((at, begins));
        }
        if found.len() == MOST_STRETCHES {
            break;
        }
        if ends < FAR_METRES {
            let onwards = next.get(&at).into_iter().flatten();
            open.extend(onwards.map(|&lane| (lane, ends, ends + net.lane(lane).length)));
        }
    }
    found
}

fn stretch(net: &Net, at: At, metres: f64) -> Stretch {
    let lane = net.lane(at);
    Stretch { id: lane.id.clone(), length: lane.length as f32, metres: metres as f32 }
}
