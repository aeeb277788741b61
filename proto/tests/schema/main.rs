//! Holds the schema to its promise: what was there stays, so that old and new peers, programs and scripts understand each
//! other.
//!
//! `schema.txt` lists every service, method, message, field, enum value and reservation. What is new is added to it by
//! `CROSS_REGENERATE=1 cargo test --release -p cross-proto`. Three rules decide what may go (buf's `WIRE_JSON`, and more):
//!
//! - Within a [`PROTOCOL_VERSION`](cross_proto::PROTOCOL_VERSION) nothing changes or vanishes.
//! - With a new one, what only actors use may: `Join` keeps the versions apart. What people and scripts call has no such
//!   guard and stays.
//! - A number or name that a message or enum used once is reserved when it goes, for ever.

#![expect(clippy::unwrap_used, reason = "a test's helpers fail the test")]

mod listing;
#[path = "../sources/mod.rs"]
mod sources;

use listing::{Item, PACKAGE, listing};
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorSet, ServiceDescriptorProto};
use std::collections::BTreeSet;
use std::path::Path;

/// Services whose callers do not say which version they speak.
const UNVERSIONED: [&str; 2] = ["cross.v1.Checkpoints", "cross.v1.Training"];

/// What a schema takes back of what another one promised: a sentence each, with the remedy.
fn broken(promised: &[String], present: &[String], new_version: bool) -> Vec<String> {
    let gone = promised.iter().filter(|line| !present.contains(line)).map(|line| Item::parse(line));
    let kept = reachable(promised, &UNVERSIONED);
    let present: Vec<Item<'_>> = present.iter().map(|line| Item::parse(line)).collect();
    gone.filter_map(|item| {
        let remedy = if item.kind == "reserved" {
            "what was used once stays reserved; put it back".to_owned()
        } else if kept.contains(item.owner) {
            "its callers tell no version; put it back, and offer what is new beside it".to_owned()
        } else if !new_version {
            "an older peer would misread it; put it back, or raise PROTOCOL_VERSION and reserve what goes"
                .to_owned()
        } else {
            unreserved(item, &present)?
        };
        Some(format!("{:?} has changed or gone: {remedy}", item.line))
    })
    .collect()
}

/// What has to be done where a field or value went.
fn unreserved(gone: Item<'_>, present: &[Item<'_>]) -> Option<String> {
    let number = gone.number?;
    let siblings = present.iter().filter(|item| item.owner == gone.owner);
    // With its whole message nothing is left that could use the number again.
    siblings.clone().next()?;
    let reserved = |what: &str| siblings.clone().any(|item| item.kind == "reserved" && item.name == what);
    let same_number = siblings.clone().find(|item| item.number == Some(number));
    let same_name = siblings.clone().any(|item| item.kind == gone.kind && item.name == gone.name);
    if let Some(other) = same_number.filter(|other| other.name != gone.name) {
        return Some(format!(
            "its number now means {:?}; give that one a number that was never used",
            other.name
        ));
    }
    if same_number.is_none() && !reserved(number) {
        return Some(format!("write `reserved {number};` where it was"));
    }
    (!same_name && !reserved(gone.name)).then(|| format!("write `reserved \"{}\";` where it was", gone.name))
}

/// The services, and every message and enum that their callers meet.
fn reachable<'a>(lines: &'a [String], services: &[&'a str]) -> BTreeSet<&'a str> {
    let mut found: BTreeSet<&str> = services.iter().copied().collect();
    loop {
        let items = lines.iter().map(|line| Item::parse(line));
        let more: BTreeSet<&str> =
            items.filter(|item| found.contains(item.owner)).flat_map(|item| item.types()).collect();
        let before = found.len();
        found.extend(more);
        if found.len() == before {
            return found;
        }
    }
}

#[test]
fn nothing_promised_changes() {
    let present = listing(&sources::descriptors());
    assert!(present.len() > 150, "the listing misses most of the schema");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("schema.txt");
    let committed = std::fs::read_to_string(&path).unwrap();
    let mut lines = committed.lines();
    let version = lines.next().and_then(|line| line.strip_prefix("protocol ")).unwrap();
    let version: u32 = version.parse().unwrap();
    let own = cross_proto::PROTOCOL_VERSION;
    assert!(version <= own, "PROTOCOL_VERSION was {version} before and cannot become {own}");
    let promised: Vec<String> = lines.map(str::to_owned).collect();
    let problems = broken(&promised, &present, version < own);
    assert!(
        problems.is_empty(),
        "the schema breaks what proto/schema.txt promises:\n{}",
        problems.join("\n")
    );
    if std::env::var_os("CROSS_REGENERATE").is_some() {
        std::fs::write(&path, format!("protocol {own}\n{}\n", present.join("\n"))).unwrap();
    } else {
        assert!(
            promised == present && version == own,
            "proto/schema.txt is behind the schema; run CROSS_REGENERATE=1 cargo test --release -p cross-proto"
        );
    }
}

type Change = fn(&mut FileDescriptorSet);

fn file(set: &mut FileDescriptorSet, name: &str) -> usize {
    set.file.iter().position(|file| file.name().ends_with(name)).unwrap()
}

fn message<'a>(set: &'a mut FileDescriptorSet, name: &str) -> &'a mut DescriptorProto {
    let files = set.file.iter_mut().filter(|file| file.package() == PACKAGE);
    files.flat_map(|file| &mut file.message_type).find(|message| message.name() == name).unwrap()
}

fn outcome(set: &mut FileDescriptorSet) -> &mut EnumDescriptorProto {
    let files = set.file.iter_mut().filter(|file| file.package() == PACKAGE);
    files.flat_map(|file| &mut file.enum_type).find(|item| item.name() == "Outcome").unwrap()
}

fn service<'a>(set: &'a mut FileDescriptorSet, name: &str) -> &'a mut ServiceDescriptorProto {
    let files = set.file.iter_mut();
    files.flat_map(|file| &mut file.service).find(|service| service.name() == name).unwrap()
}

fn reserve(message: &mut DescriptorProto, number: i32, name: &str) {
    let range = prost_types::descriptor_proto::ReservedRange { start: Some(number), end: Some(number + 1) };
    message.reserved_range.push(range);
    message.reserved_name.push(name.to_owned());
}

/// `Ack` without its second field, and with reservations of old.
fn without_sequence(set: &mut FileDescriptorSet) {
    assert_eq!(message(set, "Ack").field.remove(1).name(), "sequence");
}

#[test]
fn every_kind_of_break_is_noticed() {
    let mut before = sources::descriptors();
    reserve(message(&mut before, "Ack"), 90, "old");
    let promised = listing(&before);
    assert!(broken(&promised, &promised, false).is_empty());
    let changes: &[(&str, Change)] = &[
        ("field number", |set| message(set, "Ack").field[1].number = Some(77)),
        ("field name", |set| message(set, "Ack").field[1].name = Some("other".to_owned())),
        ("field type", |set| message(set, "Ack").field[1].set_type(Type::Double)),
        ("field repeated", |set| message(set, "Ack").field[1].set_label(Label::Repeated)),
        ("name in JSON", |set| message(set, "Ack").field[1].json_name = Some("seq".to_owned())),
        ("into a oneof", |set| {
            let ack = message(set, "Ack");
            ack.oneof_decl
                .push(prost_types::OneofDescriptorProto { name: Some("one".to_owned()), options: None });
            ack.field[1].oneof_index = Some(0);
        }),
        ("out of a oneof", |set| message(set, "StreamFragmentsResponse").field[2].oneof_index = None),
        ("field gone", without_sequence),
        ("field gone, reserved", |set| {
            without_sequence(set);
            reserve(message(set, "Ack"), 2, "sequence");
        }),
        ("reserved number gone", |set| message(set, "Ack").reserved_range.clear()),
        ("reserved name gone", |set| message(set, "Ack").reserved_name.clear()),
        ("empty message gone", |set| {
            let index = file(set, "learner.proto");
            set.file[index].message_type.retain(|message| message.name() != "Heartbeat");
        }),
        ("value renamed", |set| outcome(set).value[1].name = Some("OUTCOME_TAKEN".to_owned())),
        ("value renumbered", |set| outcome(set).value[1].number = Some(9)),
        ("value gone", |set| drop(outcome(set).value.remove(1))),
        ("enum gone", |set| {
            let index = file(set, "learner.proto");
            set.file[index].enum_type.retain(|item| item.name() != "Outcome");
        }),
        ("method gone", |set| drop(service(set, "Training").method.remove(0))),
        ("client streams", |set| service(set, "Training").method[0].client_streaming = Some(true)),
        ("server streams", |set| service(set, "Training").method[0].server_streaming = Some(true)),
        ("request type", |set| {
            service(set, "Training").method[0].input_type = Some(".cross.v1.PauseRequest".to_owned());
        }),
        ("response type", |set| {
            service(set, "Training").method[0].output_type = Some(".cross.v1.PauseResponse".to_owned());
        }),
        ("idempotency", |set| {
            let options = service(set, "Training").method[0].options.get_or_insert_default();
            options.set_idempotency_level(prost_types::method_options::IdempotencyLevel::Idempotent);
        }),
        ("service gone", |set| {
            let index = file(set, "training.proto");
            set.file[index].service.clear();
        }),
        ("package", |set| {
            let index = file(set, "training.proto");
            set.file[index].package = Some("cross.v2".to_owned());
        }),
    ];
    for (name, change) in changes {
        let mut after = before.clone();
        change(&mut after);
        let problems = broken(&promised, &listing(&after), false);
        assert!(!problems.is_empty(), "{name}: nothing was noticed");
    }
    // What is new breaks nothing.
    let mut after = before.clone();
    let mut field = message(&mut after, "Ack").field[1].clone();
    (field.name, field.json_name, field.number) = (Some("new".to_owned()), Some("new".to_owned()), Some(50));
    message(&mut after, "Ack").field.push(field);
    assert!(broken(&promised, &listing(&after), false).is_empty());
}

#[test]
fn a_new_protocol_version_frees_what_actors_use_and_keeps_numbers_and_callers() {
    let before = sources::descriptors();
    let promised = listing(&before);
    let problems = |change: Change| {
        let mut after = before.clone();
        change(&mut after);
        broken(&promised, &listing(&after), true).join("\n")
    };
    assert_eq!(problems(|set| message(set, "Ack").field[1].set_type(Type::Double)), "");
    assert_eq!(problems(|set| drop(service(set, "Learner").method.remove(0))), "");
    let said = problems(without_sequence);
    assert!(said.contains("write `reserved 2;`"), "{said}");
    let said = problems(|set| {
        without_sequence(set);
        reserve(message(set, "Ack"), 2, "other");
    });
    assert!(said.contains("write `reserved \"sequence\";`"), "{said}");
    let reserved = problems(|set| {
        without_sequence(set);
        reserve(message(set, "Ack"), 2, "sequence");
    });
    assert_eq!(reserved, "");
    let said = problems(|set| message(set, "Ack").field[1].name = Some("place".to_owned()));
    assert!(said.contains("its number now means \"place\""), "{said}");
    let said = problems(|set| drop(outcome(set).value.remove(1)));
    assert!(said.contains("write `reserved 1;`"), "{said}");
    // Nobody asks a person's script for its version.
    for change in [
        (|set| drop(service(set, "Training").method.remove(0))) as Change,
        |set| message(set, "TrainingStatus").field[2].set_type(Type::Double),
        |set| drop(message(set, "TensorInfo").field.remove(0)),
        |set| message(set, "TrainingStatus").enum_type[0].value[1].number = Some(9),
    ] {
        let said = problems(change);
        assert!(said.contains("its callers tell no version"), "{said:?}");
    }
}

#[test]
fn reflection_can_register_every_descriptor_set() {
    let sets = [
        cross_proto::FILE_DESCRIPTOR_SET,
        cross_proto::HEALTH_FILE_DESCRIPTOR_SET,
        cross_proto::ERROR_FILE_DESCRIPTOR_SET,
    ];
    let sets = sets.map(|set| FileDescriptorSet::decode(set).unwrap());
    for set in &sets {
        let names: Vec<_> = set.file.iter().map(|file| file.name()).collect();
        // An import that is missing would make a reflection client fail at the first file that needs it.
        for file in &set.file {
            for import in &file.dependency {
                assert!(
                    names.contains(&import.as_str()),
                    "{} imports {import}, which is not there",
                    file.name()
                );
            }
        }
    }
    let files = || sets.iter().flat_map(|set| &set.file);
    let services: Vec<_> = files()
        .flat_map(|file| {
            file.service.iter().map(move |service| format!("{}.{}", file.package(), service.name()))
        })
        .collect();
    for service in cross_proto::service::ALL.into_iter().chain(["grpc.health.v1.Health"]) {
        assert!(services.iter().any(|name| name == service), "{service}");
    }
    let messages: Vec<_> = files().flat_map(|file| &file.message_type).map(|m| m.name()).collect();
    for detail in ["ErrorInfo", "BadRequest", "RetryInfo"] {
        assert!(messages.contains(&detail), "{detail}");
    }
}
