//! Holds the schema to its promise: under one protocol version, nothing that was there changes or vanishes.
//!
//! `schema.txt` lists every method, field and enum value. What is new is added to it by
//! `CROSS_REGENERATE=1 cargo test --release -p cross-proto`; that refuses to lose or change a line unless
//! [`cross_proto::PROTOCOL_VERSION`] has grown.

#![expect(clippy::unwrap_used, reason = "a test's helpers fail the test")]

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorSet};
use std::path::Path;

const PACKAGE: &str = "cross.v1";

/// The schema as the `.proto` files have it now, so that one run can rewrite generated code and listing together.
fn sources() -> FileDescriptorSet {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("proto");
    protox::compile(
        ["cross/v1/learner.proto", "cross/v1/checkpoints.proto", "cross/v1/training.proto"],
        [root],
    )
    .unwrap()
}

/// The listing of a schema, one item a line, sorted.
fn listing(descriptors: &FileDescriptorSet) -> Vec<String> {
    let mut lines = Vec::new();
    for file in descriptors.file.iter().filter(|file| file.package() == PACKAGE) {
        for service in &file.service {
            for method in &service.method {
                let stream = |on: bool| if on { "stream " } else { "" };
                lines.push(format!(
                    "rpc {PACKAGE}.{}.{}({}{}) returns ({}{})",
                    service.name(),
                    method.name(),
                    stream(method.client_streaming()),
                    method.input_type(),
                    stream(method.server_streaming()),
                    method.output_type()
                ));
            }
        }
        file.message_type.iter().for_each(|message| list_message(PACKAGE, message, &mut lines));
        file.enum_type.iter().for_each(|item| list_enum(PACKAGE, item, &mut lines));
    }
    lines.sort_unstable();
    lines
}

fn list_message(scope: &str, message: &DescriptorProto, lines: &mut Vec<String>) {
    let name = format!("{scope}.{}", message.name());
    for field in &message.field {
        let label = if field.label() == Label::Repeated { "repeated " } else { "" };
        let kind = match field.r#type() {
            Type::Message | Type::Enum => field.type_name().to_owned(),
            scalar => scalar.as_str_name().trim_start_matches("TYPE_").to_lowercase(),
        };
        // `optional` is a oneof of its own making: the same bytes on the wire, so no part of the promise.
        let oneof = field.oneof_index.filter(|_| !field.proto3_optional());
        let oneof = oneof.map_or("", |index| message.oneof_decl[index as usize].name());
        let oneof = if oneof.is_empty() { String::new() } else { format!(" in {oneof}") };
        lines.push(format!("field {name}.{} = {} {label}{kind}{oneof}", field.name(), field.number()));
    }
    message.nested_type.iter().for_each(|nested| list_message(&name, nested, lines));
    message.enum_type.iter().for_each(|item| list_enum(&name, item, lines));
}

fn list_enum(scope: &str, item: &EnumDescriptorProto, lines: &mut Vec<String>) {
    for value in &item.value {
        lines.push(format!("value {scope}.{}.{} = {}", item.name(), value.name(), value.number()));
    }
}

/// Lines that were promised and are no longer there.
fn broken<'a>(promised: &'a [String], present: &[String]) -> Vec<&'a str> {
    promised.iter().filter(|line| !present.contains(line)).map(String::as_str).collect()
}

#[test]
fn nothing_promised_changes_within_a_protocol_version() {
    let present = listing(&sources());
    assert!(present.len() > 100, "the listing misses most of the schema");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("schema.txt");
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    let mut lines = committed.lines().map(str::to_owned);
    let version = format!("protocol {}", cross_proto::PROTOCOL_VERSION);
    let promised: Vec<String> =
        if lines.next() == Some(version.clone()) { lines.collect() } else { Vec::new() };
    let broken = broken(&promised, &present);
    assert!(
        broken.is_empty(),
        "an older peer would misread these, raise PROTOCOL_VERSION or keep them: {broken:#?}"
    );
    if std::env::var_os("CROSS_REGENERATE").is_some() {
        std::fs::write(&path, format!("{version}\n{}\n", present.join("\n"))).unwrap();
    } else {
        assert_eq!(
            promised, present,
            "proto/schema.txt is behind the schema; run CROSS_REGENERATE=1 cargo test --release -p cross-proto"
        );
    }
}

#[test]
fn a_renumbered_renamed_retyped_or_removed_field_is_noticed() {
    let present = listing(&sources());
    let changes: [fn(&mut FileDescriptorSet); 4] = [
        |set| first_message(set).field[0].number = Some(77),
        |set| first_message(set).field[0].name = Some("other".to_owned()),
        |set| first_message(set).field[0].set_type(Type::Double),
        |set| drop(first_message(set).field.remove(0)),
    ];
    for change in changes {
        let mut set = sources();
        change(&mut set);
        assert_eq!(broken(&present, &listing(&set)).len(), 1);
    }
    assert!(broken(&present, &present).is_empty());
}

fn first_message(set: &mut FileDescriptorSet) -> &mut DescriptorProto {
    let file = set.file.iter_mut().find(|file| file.package() == PACKAGE).unwrap();
    &mut file.message_type[0]
}

#[test]
fn reflection_can_register_both_descriptor_sets() {
    let set = FileDescriptorSet::decode(cross_proto::FILE_DESCRIPTOR_SET).unwrap();
    let names: Vec<_> = set.file.iter().map(|file| file.name()).collect();
    // An import that is missing would make a reflection client fail at the first file that needs it.
    for file in &set.file {
        for import in &file.dependency {
            assert!(names.contains(&import.as_str()), "{} imports {import}, which is not there", file.name());
        }
    }
    let services: Vec<_> = set.file.iter().flat_map(|file| &file.service).map(|s| s.name()).collect();
    for service in
        [cross_proto::service::LEARNER, cross_proto::service::CHECKPOINTS, cross_proto::service::TRAINING]
    {
        assert!(services.contains(&service.trim_start_matches("cross.v1.")), "{service}");
    }
    let health = FileDescriptorSet::decode(cross_proto::HEALTH_FILE_DESCRIPTOR_SET).unwrap();
    assert!(health.file.iter().any(|file| file.package() == "grpc.health.v1"));
}
