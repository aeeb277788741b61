//! SUMO alone: the same command line without a client, the signal plan as a file.

use super::cost::{Cost, measured};
use super::plan::Plan;
use crate::error::BenchError;
use cross_traci::SumoHome;
use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::{Command, Stdio};

/// What only a client needs; each is followed by a value.
const CLIENT: [&str; 2] = ["--remote-port", "--num-clients"];
const ADDITIONAL: &str = "--additional-files";
const TRIPS: &str = "--tripinfo-output";

/// The arguments of a running process, as the kernel has them.
pub(super) fn arguments(pid: u32) -> Result<Vec<OsString>, BenchError> {
    let path = format!("/proc/{pid}/cmdline");
    let bytes =
        std::fs::read(&path).map_err(|source| BenchError::CommandLine { path: path.into(), source })?;
    Ok(split(&bytes))
}

/// Arguments that each end with a zero byte; the first names the program.
fn split(bytes: &[u8]) -> Vec<OsString> {
    let bytes = bytes.strip_suffix(b"\0").unwrap_or(bytes);
    bytes.split(|&byte| byte == 0).skip(1).map(|part| OsStr::from_bytes(part).to_owned()).collect()
}

/// The same run without a client, to `end`, with a file of signal programs and another file of trips.
fn replayed(arguments: &[OsString], programs: &Path, trips: &Path, end: u32) -> Vec<OsString> {
    let mut out = Vec::new();
    let mut additional = OsString::new();
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        let text = argument.to_str().unwrap_or_default();
        if CLIENT.contains(&text) || text == TRIPS {
            rest.next();
        } else if text == ADDITIONAL {
            additional.push(rest.next().map_or(OsStr::new(""), OsString::as_os_str));
            additional.push(",");
        } else {
            out.push(argument.clone());
        }
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
    command.stdin(Stdio::null()).stdout(Stdio::null());
    let (output, cost) = measured(|| command.output().map_err(|source| BenchError::Sumo { source }))?;
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
    fn the_kernels_form_of_a_command_line_is_read() {
        assert_eq!(split(b"/bin/sumo\0-n\0a b.xml\0--x\0\0"), ["-n", "a b.xml", "--x", ""]);
        assert_eq!(split(b""), Vec::<OsString>::new());
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
