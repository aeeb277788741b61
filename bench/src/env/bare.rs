//! SUMO alone: the same command line without a client, the signal plan as a file.

use super::plan::Plan;
use crate::command_line::{CLIENT, without};
use crate::cost::{Cost, measured};
use crate::error::BenchError;
use cross_traci::SumoHome;
use cross_traci::sumo::spawn_tied;
use std::ffi::OsString;
use std::path::Path;
use std::process::{Child, Command, Stdio};

const ADDITIONAL: &str = "--additional-files";
const TRIPS: &str = "--tripinfo-output";

/// The same run without a client, to `end`, with a file of signal programs and another file of trips.
fn replayed(arguments: &[OsString], programs: &Path, trips: &Path, end: u32) -> Vec<OsString> {
    let mut out = without(arguments, &[CLIENT[0], CLIENT[1], TRIPS, ADDITIONAL]);
    let mut additional = OsString::new();
    for pair in arguments.windows(2).filter(|pair| pair[0] == ADDITIONAL) {
        additional.push(&pair[1]);
        additional.push(",");
    }
    // SUMO runs the program that it loads last.
    additional.push(programs);
    for (option, value) in
        [(ADDITIONAL, additional), (TRIPS, trips.into()), ("--end", end.to_string().into())]
    {
        out.extend([option.into(), value]);
    }
    out
}

/// Runs SUMO alone as `arguments` ran it with a client, under a plan; `folder` takes its files.
pub(super) fn replay(
    home: &SumoHome,
    arguments: &[OsString],
    plan: &Plan,
    end: u32,
    folder: &Path,
    trips: &Path,
) -> Result<Cost, BenchError> {
    let programs = folder.join("replay.add.xml");
    std::fs::write(&programs, plan.xml())
        .map_err(|source| BenchError::Write { path: programs.clone(), source })?;
    let arguments = replayed(arguments, &programs, trips, end);
    let mut command = Command::new(home.binary("sumo"));
    command.args(arguments).env("SUMO_HOME", home.path()).env("LC_ALL", "C");
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    // As our own SUMO is: whatever ends this process ends it.
    let run = || spawn_tied(command).and_then(Child::wait_with_output);
    let (output, cost) = measured(|| run().map_err(|source| BenchError::Sumo { source }))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let last = said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("nothing");
        return Err(BenchError::Replay { status: output.status, said: last.to_owned() });
    }
    Ok(cost)
}

/// The records of two files of trips, if they are the same ones.
pub(super) fn same_trips(ours: &Path, bare: &Path) -> Result<usize, BenchError> {
    let (ours, bare) = (records(ours)?, records(bare)?);
    let different = ours.iter().zip(&bare).filter(|(a, b)| a != b).count() + ours.len().abs_diff(bare.len());
    match different {
        0 => Ok(ours.len()),
        _ => Err(BenchError::OtherTraffic { different, ours: ours.len(), bare: bare.len() }),
    }
}

/// The lines that tell of a vehicle; the rest of the file names the run.
fn records(path: &Path) -> Result<Vec<String>, BenchError> {
    let text =
        std::fs::read_to_string(path).map_err(|source| BenchError::Read { path: path.to_owned(), source })?;
    Ok(text.lines().filter(|line| line.trim_start().starts_with("<tripinfo ")).map(str::to_owned).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<OsString> {
        text.split(' ').map(OsString::from).collect()
    }

    #[test]
    fn a_replay_has_everything_but_the_client() {
        let ours = words(
            "-n a.net.xml --additional-files b.xml,c.xml --seed 3 --tripinfo-output t.xml --remote-port 7 --num-clients 1",
        );
        let bare = replayed(&ours, Path::new("p.xml"), Path::new("u.xml"), 3600);
        let wanted =
            "-n a.net.xml --seed 3 --additional-files b.xml,c.xml,p.xml --tripinfo-output u.xml --end 3600";
        assert_eq!(bare, words(wanted));
    }

    #[test]
    fn trips_are_compared_one_by_one() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let a = file(
            "a",
            "<!-- 7 -->\n<tripinfos>\n  <tripinfo id=\"1\"/>\n  <tripinfo id=\"2\"/>\n</tripinfos>",
        );
        let same = file(
            "b",
            "<!-- 8 -->\n<tripinfos>\n  <tripinfo id=\"1\"/>\n  <tripinfo id=\"2\"/>\n</tripinfos>",
        );
        let other = file(
            "c",
            "<tripinfos>\n  <tripinfo id=\"1\"/>\n  <tripinfo id=\"3\"/>\n  <tripinfo id=\"4\"/>\n",
        );
        assert_eq!(same_trips(&a, &same).unwrap(), 2);
        let error = same_trips(&a, &other).unwrap_err();
        assert!(matches!(error, BenchError::OtherTraffic { different: 2, ours: 2, bare: 3 }), "{error}");
    }
}
