//! `docs/weights.md` against the networks: every parameter by name and shape, in every form, and the example in it.
//!
//! After a change of the networks, rewrite its tables with
//! `CROSS_REGENERATE=1 cargo test --release -p cross-model --test weights`.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

use cross_config::{Config, Gfe, LaneGreen};
use cross_model::features::FeatureSizes;
use cross_model::net::{Net, Role};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Columns of a table: heading, `model.pcc`, `model.moe`.
const VARIANTS: [(&str, bool, bool); 4] = [
    ("shape", true, true),
    ("`pcc = false`", false, true),
    ("`moe = false`", true, false),
    ("both `false`", false, false),
];
/// Modules in the order of the data's way through them.
const MODULES: [&str; 4] = ["gfe", "pcc", "moe", "head"];

fn page() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/weights.md")
}

/// Names without the network's, and shapes, in order of creation; actor and critic have the same.
fn parameters(gfe: Gfe, pcc: bool, moe: bool) -> Vec<(String, Vec<i64>)> {
    let mut config = Config::default();
    (config.model.gfe, config.model.pcc, config.model.moe) = (gfe, pcc, moe);
    let sizes = FeatureSizes::new(&config.env, &config.model);
    let [actor, critic] = [Role::Actor, Role::Critic].map(|role| {
        let net = Net::new(role, &config.model, &sizes, &mut ChaCha8Rng::seed_from_u64(0));
        let own = |name: &str| name.strip_prefix(&format!("{}.", role.name())).unwrap().to_owned();
        net.params().iter().map(|(name, tensor)| (own(name), tensor.size())).collect::<Vec<_>>()
    });
    assert_eq!(actor, critic);
    actor
}

fn module(name: &str) -> usize {
    MODULES.iter().position(|module| name.split('.').next() == Some(module)).unwrap()
}

fn table(gfe: Gfe) -> String {
    let columns = VARIANTS.map(|(_, pcc, moe)| parameters(gfe, pcc, moe));
    let mut names: Vec<&String> = Vec::new();
    for (name, _) in columns.iter().flatten() {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names.sort_by_key(|name| module(name));
    let mut text = String::from("| parameter |");
    for (heading, _, _) in VARIANTS {
        let _ = write!(text, " {heading} |");
    }
    text.push_str("\n|---|---|---|---|---|\n");
    for name in names {
        let _ = write!(text, "| `actor.{name}`, `critic.{name}` |");
        for column in &columns {
            let shape = column.iter().find(|(own, _)| own == name).map(|(_, shape)| {
                let sides: Vec<String> = shape.iter().map(ToString::to_string).collect();
                sides.join(" x ")
            });
            let _ = write!(text, " {} |", shape.unwrap_or_else(|| "none".to_owned()));
        }
        text.push('\n');
    }
    let scalars = columns.map(|column| {
        let count: i64 = column.iter().map(|(_, shape)| shape.iter().product::<i64>()).sum();
        count.to_string()
    });
    let _ = writeln!(text, "| numbers in each of the two networks | {} |", scalars.join(" | "));
    text
}

/// The page with what stands between `<!-- NAME -->` and `<!-- end -->` replaced.
fn with_block(page: &str, name: &str, content: &str) -> String {
    let start = format!("<!-- {name} -->\n");
    let (before, rest) = page.split_once(&start).unwrap();
    let (_, after) = rest.split_once("<!-- end -->").unwrap();
    format!("{before}{start}{content}<!-- end -->{after}")
}

#[test]
fn the_page_lists_every_parameter() {
    let written = std::fs::read_to_string(page()).unwrap();
    let mut wanted = with_block(&written, "movement", &table(Gfe::Movement));
    wanted = with_block(&wanted, "paper", &table(Gfe::Paper));
    if std::env::var_os("CROSS_REGENERATE").is_some() {
        std::fs::write(page(), &wanted).unwrap();
    } else if written != wanted {
        let differs = written.lines().zip(wanted.lines()).find(|(a, b)| a != b);
        panic!(
            "docs/weights.md is not what the networks are, first at {differs:?}; rewrite it with CROSS_REGENERATE=1"
        );
    }
}

#[test]
fn the_example_of_the_page_is_the_file_that_was_run() {
    let written = std::fs::read_to_string(page()).unwrap();
    let (_, rest) = written.split_once("```python\n").unwrap();
    let (example, _) = rest.split_once("```").unwrap();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/reference/load_checkpoint.py");
    assert_eq!(example, std::fs::read_to_string(file).unwrap());
}

#[test]
fn the_number_of_parameters_is_known_before_they_are_made() {
    for gfe in [Gfe::Paper, Gfe::Movement] {
        for (_, pcc, moe) in VARIANTS {
            let mut config = Config::default();
            let model = &mut config.model;
            (model.gfe, model.pcc, model.moe) = (gfe, pcc, moe);
            (model.hidden, model.latent, model.heads) = (24, 5, 3);
            (model.experts, model.top_k, model.clusters) = (7, 3, 11);
            (config.env.max_movements, config.env.max_phases) = (13, 9);
            let sizes = FeatureSizes::new(&config.env, &config.model);
            let net = Net::new(Role::Actor, &config.model, &sizes, &mut ChaCha8Rng::seed_from_u64(0));
            assert_eq!(
                Net::scalars(&config.model, &sizes),
                net.params().scalars() as i64,
                "{:?}",
                config.model
            );
        }
    }
}

#[test]
fn a_file_of_a_version_that_did_not_know_a_key_keeps_what_that_version_did() {
    let config = Config::default();
    let mut model = serde_json::to_value(&config.model).unwrap();
    let described = |model: &serde_json::Value| {
        let keys = [
            ("format", "cross-policy".to_owned()),
            ("format_version", "1".to_owned()),
            ("policy_version", "1".to_owned()),
            ("env", serde_json::to_string(&config.env).unwrap()),
            ("model", model.to_string()),
        ];
        let metadata = serde_json::to_string(&std::collections::BTreeMap::from(keys)).unwrap();
        let nothing = Vec::<(String, safetensors::tensor::TensorView<'_>)>::new();
        let file = safetensors::serialize(nothing, Some([("cross".to_owned(), metadata)].into())).unwrap();
        cross_model::snapshot::read_metadata(&file).map(|metadata| metadata.model.lane_green)
    };
    assert_eq!(described(&model).unwrap(), LaneGreen::Mean);
    model.as_object_mut().unwrap().remove("lane_green");
    assert_eq!(described(&model).unwrap(), LaneGreen::Strongest);
    model["lane_green"] = "weakest".into();
    assert!(described(&model).unwrap_err().to_string().contains("weakest"));
}

#[test]
fn a_small_file_that_describes_large_networks_is_refused_before_they_are_built() {
    let described = |hidden: i64| {
        let config = Config::default();
        let model = cross_config::ModelConfig { hidden, experts: 1024, ..config.model };
        let metadata = std::collections::BTreeMap::from([
            ("format", "cross-policy".to_owned()),
            ("format_version", "1".to_owned()),
            ("policy_version", "1".to_owned()),
            ("env", serde_json::to_string(&config.env).unwrap()),
            ("model", serde_json::to_string(&model).unwrap()),
        ]);
        let metadata = [("cross".to_owned(), serde_json::to_string(&metadata).unwrap())].into();
        let nothing = Vec::<(String, safetensors::tensor::TensorView<'_>)>::new();
        safetensors::serialize(nothing, Some(metadata)).unwrap()
    };
    // 275 GB of weights, in 500 bytes.
    let error = cross_model::Policy::from_snapshot(&described(4096)).unwrap_err().to_string();
    assert!(error.contains("weights alone take"), "{error}");
    // What no configuration may say, libtorch would answer with a panic.
    let error = cross_model::Policy::from_snapshot(&described(1 << 40)).unwrap_err().to_string();
    assert!(error.contains("model.hidden"), "{error}");
}
