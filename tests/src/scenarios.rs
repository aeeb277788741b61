//! Scenarios that must be refused.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Writes a scenario with this text as its net into `parent/name`; its directory.
pub fn with_net(parent: &Path, name: &str, net: &str) -> PathBuf {
    let directory = parent.join(name);
    std::fs::create_dir_all(&directory).unwrap();
    std::fs::write(directory.join("net.net.xml"), net).unwrap();
    std::fs::write(directory.join("trips.rou.xml"), "<routes/>\n").unwrap();
    let definition = format!(
        "name = \"{name}\"\ndescription = \"for a test\"\nsource = \"made up\"\nnet = \"net.net.xml\"\n\
         routes = [\"trips.rou.xml\"]\nbegin = 0\nend = 3600\n"
    );
    std::fs::write(directory.join("scenario.toml"), definition).unwrap();
    directory
}

/// A net of one signalised junction, called `crossing`, with so many movements and green phases.
///
/// One street leads in, with a lane for each movement, and one leads out.
#[must_use]
pub fn junction(movements: usize, phases: usize) -> String {
    let mut lanes = String::new();
    let mut links = String::new();
    let mut names = Vec::new();
    for lane in 0..movements {
        let y = 3.2 * lane as f64;
        let _ = writeln!(
            lanes,
            "    <lane id=\"in_{lane}\" index=\"{lane}\" speed=\"13.9\" length=\"200\" shape=\"0,{y} 200,{y}\"/>"
        );
        let _ = writeln!(
            links,
            "  <connection from=\"in\" to=\"out\" fromLane=\"{lane}\" toLane=\"0\" tl=\"crossing\" linkIndex=\"{lane}\" dir=\"s\" state=\"o\"/>"
        );
        names.push(format!("in_{lane}"));
    }
    let mut program = String::new();
    for phase in 0..phases {
        let state = |green: char| -> String {
            (0..movements).map(|link| if link % phases == phase { green } else { 'r' }).collect()
        };
        let _ = writeln!(program, "    <phase duration=\"10\" state=\"{}\"/>", state('G'));
        let _ = writeln!(program, "    <phase duration=\"3\" state=\"{}\"/>", state('y'));
    }
    format!(
        "<net version=\"1.20\">\n  <location netOffset=\"0,0\" convBoundary=\"0,0,400,100\" origBoundary=\"0,0,400,100\" \
         projParameter=\"!\"/>\n  <edge id=\"in\" from=\"a\" to=\"crossing\" priority=\"1\">\n{lanes}  </edge>\n  \
         <edge id=\"out\" from=\"crossing\" to=\"b\" priority=\"1\">\n    <lane id=\"out_0\" index=\"0\" speed=\"13.9\" \
         length=\"200\" shape=\"200,0 400,0\"/>\n  </edge>\n  <tlLogic id=\"crossing\" type=\"static\" programID=\"0\" \
         offset=\"0\">\n{program}  </tlLogic>\n  <junction id=\"a\" type=\"dead_end\" x=\"0\" y=\"0\" incLanes=\"\" \
         intLanes=\"\" shape=\"0,0\"/>\n  <junction id=\"crossing\" type=\"traffic_light\" x=\"200\" y=\"0\" incLanes=\"{}\" \
         intLanes=\"\" shape=\"200,0\"/>\n  <junction id=\"b\" type=\"dead_end\" x=\"400\" y=\"0\" incLanes=\"out_0\" \
         intLanes=\"\" shape=\"400,0\"/>\n{links}</net>\n",
        names.join(" ")
    )
}
