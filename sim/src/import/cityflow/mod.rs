//! Scenarios from CityFlow's two files, `roadnet` and `flow`.
//!
//! Roads, lanes, turns and signals keep their ids and geometry. Signals keep their phases in order, without the one in which
//! only those go that always go. Every flow becomes single vehicles on fixed routes. Vehicles are SUMO's default cars:
//! CityFlow's parameters belong to another car-following model and slow SUMO's down, and published figures on these data sets
//! were made without them.

mod convert;
mod error;
mod flow;
mod input;
mod report;
mod roadnet;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests;

pub use error::ImportError;
pub use report::Item;

use crate::generate::folder::NewFolder;
use crate::generate::plain::PlainNet;
use crate::generate::xml::{XmlFile, number};
use crate::generate::{NET_FILE, NewScenario, ROUTES_FILE, build_net, netconvert, write_definition};
use crate::net::Net;
use cross_traci::sumo::SumoHome;
use flow::Demand;
use roadnet::RoadNet;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// A scenario that was imported.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Imported {
    /// Its folder.
    pub folder: PathBuf,
    /// What was kept, changed or lost.
    pub report: Vec<Item>,
}

/// Imports a road network and its flows as a scenario folder.
///
/// # Errors
/// [`ImportError`] names the file and what is wrong with it; nothing is left behind.
pub fn import(
    home: &SumoHome,
    roadnet: &Path,
    flow: &Path,
    new: &NewScenario,
) -> Result<Imported, ImportError> {
    let roads = RoadNet::read(roadnet)?;
    let demand = flow::read(flow, &roads, f64::from(new.end))?;
    let mut converted = convert::convert(&roads);
    let folder = NewFolder::start(&new.folder, new.replace)?;
    build_net(home, &converted.net, folder.path())?;
    compare(&Net::read(&folder.path().join(NET_FILE))?, &converted.net, &mut converted.items);
    netconvert::write(&folder.path().join(ROUTES_FILE), |file| write_routes(&roads, &demand, file))?;
    write_definition(folder.path(), new)?;
    converted.items.extend(demand_items(&demand, new.end));
    Ok(Imported { folder: folder.finish()?, report: converted.items })
}

/// What an import would make of the two texts, until SUMO's netconvert takes over; `end` is the time at which the simulation
/// ends, seconds. Errors call them `roadnet` and `flow`.
///
/// # Errors
/// [`ImportError`] as of [`import`].
pub fn check(roadnet: impl Read, flow: impl Read, end: u32) -> Result<Vec<Item>, ImportError> {
    let roads = RoadNet::parse(roadnet, Path::new("roadnet"))?;
    let demand = flow::parse(flow, Path::new("flow"), &roads, f64::from(end))?;
    let mut converted = convert::convert(&roads);
    let written = converted.net.write_nodes(io::sink());
    let written = written.and_then(|()| converted.net.write_edges(io::sink()));
    let written = written.and_then(|()| converted.net.write_connections(io::sink()));
    let written = written.and_then(|()| converted.net.write_programs(io::sink()));
    let written = written.and_then(|()| write_routes(&roads, &demand, io::sink()));
    written.map_err(|source| ImportError::Read { path: "roadnet".into(), source })?;
    converted.items.extend(demand_items(&demand, end));
    Ok(converted.items)
}

/// Counts what netconvert left out of the net it was asked for.
fn compare(built: &Net, asked: &PlainNet, items: &mut [Item]) {
    let lanes = built.edges.iter().map(|edge| edge.lanes.len()).sum();
    let links = built.traffic_lights.iter().map(|light| light.links.len()).sum();
    for (what, asked, built) in [
        ("signals", asked.programs.len(), built.traffic_lights.len()),
        ("roads", asked.edges.len(), built.edges.len()),
        ("lanes", asked.edges.iter().map(|edge| edge.lane_speeds.len()).sum(), lanes),
        ("lane links", asked.connections.iter().filter(|link| link.signal.is_some()).count(), links),
    ] {
        let Some(item) = items.iter_mut().find(|item| item.what == what) else { continue };
        let missing = asked.saturating_sub(built) as u64;
        item.kept = item.kept.saturating_sub(missing);
        item.keep(0, missing, "that netconvert left out");
    }
}

fn demand_items(demand: &Demand, end: u32) -> [Item; 2] {
    let mut flows = Item::new("flows");
    flows.read = demand.flows;
    flows.keep(demand.flows, 0, "");
    let mut vehicles = Item::new("vehicles");
    let kept = demand.vehicles.len() as u64;
    vehicles.read = kept + demand.too_late;
    vehicles.keep(kept, demand.too_late, &format!("that depart at {end} s or later; --end keeps them"));
    vehicles.change(
        kept,
        "into SUMO's default car: length, acceleration, headway and speed of the file are not used",
    );
    [flows, vehicles]
}

fn write_routes(roads: &RoadNet, demand: &Demand, target: impl Write) -> io::Result<()> {
    let mut xml = XmlFile::start(target, "routes")?;
    for (number, route) in demand.routes.iter().enumerate() {
        let edges = route.iter().map(|&road| roads.roads[road].id.as_str()).collect::<Vec<_>>().join(" ");
        xml.element("route", &[("id", &format!("route_{number}")), ("edges", &edges)])?;
    }
    for vehicle in &demand.vehicles {
        let number_in_flow = vehicle.number.map(|number| format!(".{number}")).unwrap_or_default();
        xml.element(
            "vehicle",
            &[
                ("id", &format!("flow_{}{number_in_flow}", vehicle.flow)),
                ("route", &format!("route_{}", vehicle.route)),
                ("depart", &number(vehicle.depart)),
            ],
        )?;
    }
    xml.finish().map(drop)
}
