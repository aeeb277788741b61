//! Every key is documented with its true default, and nothing is documented that does not exist.

use cross_config::Config;
use std::collections::BTreeMap;

#[test]
fn every_key_is_documented_with_its_default() {
    let tree: toml::Table = toml::from_str(&Config::default().to_toml()).unwrap();
    let mut actual = BTreeMap::new();
    for (key, value) in tree {
        match value {
            toml::Value::Table(section) => {
                for (name, value) in section {
                    actual.insert(format!("{key}.{name}"), value.to_string());
                }
            }
            value => {
                actual.insert(key, value.to_string());
            }
        }
    }
    let page = include_str!("../../docs/configuration.md");
    let documented: BTreeMap<String, String> = page
        .lines()
        .take_while(|line| !line.starts_with("## Environment variables"))
        .filter_map(|line| {
            let mut cells = line.strip_prefix("| `")?.split(" | ");
            let key = cells.next()?.trim_end_matches('`');
            let default = cells.next()?.trim_matches('`');
            Some((key.to_owned(), default.to_owned()))
        })
        .collect();
    assert_eq!(documented, actual, "docs/configuration.md (left) and Config::default() (right) differ");
}
