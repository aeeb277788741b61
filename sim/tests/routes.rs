//! Route files of anybody's: whatever is in them, counting their vehicles ends with a number or a sentence.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use cross_sim::scenario::Scenario;
use proptest::prelude::*;
use std::io::Write as _;

const ROUTES: &str = "<routes>\n<vehicle id=\"a\" depart=\"10\"/>\n<trip id=\"b\" depart=\"20.5\" from=\"x\" to=\"y\"/>\n\
    <flow id=\"c\" begin=\"0\" end=\"60\" number=\"7\"/>\n<flow id=\"d\" vehsPerHour=\"360\" begin=\"0\" end=\"50\"/>\n\
    <flow id=\"e\" period=\"exp(0.5)\" begin=\"5\" end=\"9\"/>\n</routes>\n";

/// A scenario of two minutes with this route file.
fn scenario(routes: &[u8]) -> (tempfile::TempDir, Scenario) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("town.net.xml"), "<net/>").unwrap();
    std::fs::write(folder.path().join("town.rou.xml"), routes).unwrap();
    let definition = "name = \"town\"\nnet = \"town.net.xml\"\nroutes = [\"town.rou.xml\"]\nend = 120\n";
    std::fs::write(folder.path().join("scenario.toml"), definition).unwrap();
    let scenario = Scenario::from_directory(folder.path()).unwrap();
    (folder, scenario)
}

/// Counts both ways; what is counted is a number, what is refused names the file.
fn count(routes: &[u8]) {
    let (_folder, scenario) = scenario(routes);
    if let Err(error) = scenario.vehicles() {
        assert!(error.to_string().contains("town.rou.xml"), "{error}");
    }
    match scenario.arrivals() {
        Ok(arrivals) => {
            assert_eq!(arrivals.per_minute.len(), 2);
            assert!(
                arrivals.per_minute.iter().all(|count| count.is_finite() && *count >= 0.0),
                "{arrivals:?}"
            );
            assert!(!arrivals.std().is_nan() && !arrivals.outside.is_nan(), "{arrivals:?}");
        }
        Err(error) => assert!(error.to_string().contains("town.rou.xml"), "{error}"),
    }
}

#[test]
fn a_flow_that_never_ends_counts_within_the_time() {
    let (_folder, scenario) =
        scenario(b"<routes><flow id=\"a\" begin=\"0\" end=\"1e300\" probability=\"0.5\"/></routes>");
    assert_eq!(scenario.arrivals().unwrap().per_minute, [30.0, 30.0]);
    assert_eq!(scenario.vehicles().unwrap(), 60);
}

#[test]
fn compressed_files_count_as_plain_ones() {
    let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gz.write_all(ROUTES.as_bytes()).unwrap();
    let compressed = gz.finish().unwrap();
    let vehicles = |routes: &[u8]| scenario(routes).1.vehicles().map_err(|error| error.to_string());
    let count = vehicles(ROUTES.as_bytes()).unwrap();
    assert_eq!(count, 1 + 1 + 7 + 5 + 2);
    assert_eq!(vehicles(&compressed), Ok(count));
    assert!(vehicles(&compressed[..compressed.len() / 2]).unwrap_err().contains("town.rou.xml"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn damaged_bytes_never_panic(damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8), length in 0_usize..500) {
        let mut bytes = ROUTES.as_bytes().to_vec();
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        bytes.truncate(length);
        count(&bytes);
    }

    #[test]
    fn odd_numbers_never_panic(values in prop::collection::vec(prop_oneof![any::<f64>().prop_map(|v| v.to_string()), "[-+]?[0-9]{0,20}(e[0-9]{1,3})?", "\\PC{0,6}"], 5)) {
        let [depart, begin, end, rate, other] = values.as_slice() else { return Ok(()) };
        let quoted = |text: &str| text.replace(['<', '&', '"'], "");
        let text = format!(
            "<routes><vehicle depart=\"{}\"/><flow begin=\"{}\" end=\"{}\" vehsPerHour=\"{}\"/><flow begin=\"{}\" number=\"{}\"/></routes>",
            quoted(depart), quoted(begin), quoted(end), quoted(rate), quoted(end), quoted(other)
        );
        count(text.as_bytes());
    }
}
