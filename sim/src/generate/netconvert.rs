//! Building a net with SUMO's `netconvert`.

use super::GenerateError;
use super::plain::PlainNet;
use cross_traci::sumo::SumoHome;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Far more than the largest grid that the generator allows needs on a slow machine.
const DEADLINE: Duration = Duration::from_secs(600);
const LONGEST_REPORT: usize = 2_000;

/// Builds `net` into the file `target`; `folder` holds netconvert's input and what it says.
///
/// The same network gives the same file with the same version of netconvert: the comment with date and paths that it
/// writes is taken out.
pub(crate) fn build(
    home: &SumoHome,
    net: &PlainNet,
    folder: &Path,
    target: &Path,
) -> Result<(), GenerateError> {
    write(&folder.join("plain.nod.xml"), |file| net.write_nodes(file))?;
    write(&folder.join("plain.edg.xml"), |file| net.write_edges(file))?;
    write(&folder.join("plain.con.xml"), |file| net.write_connections(file))?;
    write(&folder.join("plain.tll.xml"), |file| net.write_programs(file))?;
    let mut arguments: Vec<&OsStr> = Vec::new();
    for (option, value) in [
        ("--node-files", "plain.nod.xml"),
        ("--edge-files", "plain.edg.xml"),
        ("--connection-files", "plain.con.xml"),
        ("--tllogic-files", "plain.tll.xml"),
        ("--output-file", "plain.net.xml"),
        ("--no-turnarounds", "true"),
        // Positions stay as they were given.
        ("--offset.disable-normalization", "true"),
        // What was just written needs no check against schemas, which may not even be there.
        ("--xml-validation", "never"),
    ] {
        arguments.extend([OsStr::new(option), OsStr::new(value)]);
    }
    run(home, &arguments, folder)?;
    let raw = folder.join("plain.net.xml");
    let text = std::fs::read_to_string(&raw).map_err(GenerateError::write(&raw))?;
    std::fs::write(target, without_header(&text)).map_err(GenerateError::write(target))
}

/// Writes a file through a buffer.
pub(crate) fn write(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), GenerateError> {
    let result = File::create(path).and_then(|file| {
        let mut file = BufWriter::new(file);
        content(&mut file)?;
        file.into_inner()?.sync_all()
    });
    result.map_err(GenerateError::write(path))
}

fn run(home: &SumoHome, arguments: &[&OsStr], folder: &Path) -> Result<(), GenerateError> {
    let binary = home.binary("netconvert");
    let report = folder.join("netconvert.log");
    let log = File::create(&report).map_err(GenerateError::write(&report))?;
    let started = log.try_clone().and_then(|both| {
        home.command("netconvert")
            .args(arguments)
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(both)
            .stderr(log)
            .spawn()
    });
    let mut child = started.map_err(|source| GenerateError::Start { binary: binary.clone(), source })?;
    let deadline = Instant::now() + DEADLINE;
    let outcome = loop {
        match child.try_wait() {
            Ok(Some(status)) if status.success() => return Ok(()),
            Ok(Some(status)) => break status.to_string(),
            Ok(None) if Instant::now() < deadline => std::thread::sleep(Duration::from_millis(10)),
            Ok(None) => break format!("not done after {} s", DEADLINE.as_secs()),
            Err(error) => break error.to_string(),
        }
    };
    // It may have ended in the meantime; what matters is that it is gone.
    let _ = child.kill();
    let _ = child.wait();
    let said = std::fs::read(&report).unwrap_or_default();
    let said = String::from_utf8_lossy(&said);
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    let said = said.chars().take(LONGEST_REPORT).collect();
    Err(GenerateError::Netconvert { binary, outcome, said })
}

/// Takes out comments before the root element.
fn without_header(text: &str) -> String {
    let Some(root) = text.find("<net ") else { return text.to_owned() };
    let (mut rest, net) = text.split_at(root);
    let mut head = String::new();
    while let Some(start) = rest.find("<!--") {
        head.push_str(&rest[..start]);
        // The configuration in that comment begins with <netconvertConfiguration, never with the root itself.
        rest = rest[start..].find("-->").map_or("", |end| &rest[start + end + 3..]);
    }
    head.push_str(rest);
    format!("{}\n\n{net}", head.trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_comment_with_date_and_paths_goes() {
        let text = "<?xml version=\"1.0\"?>\n\n<!-- generated on 2026-01-01 <netconvertConfiguration/> -->\n\n<net version=\"1\">\n</net>\n";
        assert_eq!(without_header(text), "<?xml version=\"1.0\"?>\n\n<net version=\"1\">\n</net>\n");
    }
}
