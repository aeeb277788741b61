//! Grids that a definition describes instead of naming files: built on first use and kept.

use super::folder::NewFolder;
use super::grid::{self, GridOptions};
use super::{GenerateError, NET_FILE, ROUTES_FILE, build_grid, demand};
use cross_traci::sumo::SumoHome;
use sha2::{Digest, Sha256};
use std::io;
use std::path::{Path, PathBuf};

/// Net and routes of a grid on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GeneratedFiles {
    /// The net.
    pub net: PathBuf,
    /// The route file.
    pub routes: PathBuf,
}

/// The files of a grid below `place`, made now if they are not there.
///
/// They lie in a folder named after what they are made from, so that a changed option or a changed generator never meets
/// old files, and several processes may ask at once.
pub(crate) fn cached(options: &GridOptions, place: &Path) -> Result<GeneratedFiles, GenerateError> {
    options.validate()?;
    let folder = place.join(format!("grid-{}", key(options).map_err(GenerateError::write(place))?));
    let files = GeneratedFiles { net: folder.join(NET_FILE), routes: folder.join(ROUTES_FILE) };
    if files.net.is_file() && files.routes.is_file() {
        return Ok(files);
    }
    let home = SumoHome::locate(None)?;
    let built = NewFolder::start(&folder, false).and_then(|draft| {
        build_grid(&home, options, draft.path())?;
        draft.finish()
    });
    match built {
        // Somebody else built it meanwhile; the same options give the same files.
        Ok(_) | Err(GenerateError::Exists { .. }) => Ok(files),
        Err(error) => Err(error),
    }
}

/// Hash of everything that the net and the routes are made from.
fn key(options: &GridOptions) -> io::Result<String> {
    let network = grid::network(options);
    let mut text = Vec::new();
    network.write_nodes(&mut text)?;
    network.write_edges(&mut text)?;
    network.write_connections(&mut text)?;
    network.write_programs(&mut text)?;
    demand::write(options, &mut text)?;
    Ok(hex::encode(&Sha256::digest(&text)[..8]))
}
