//! A schema as lines of text, one item each, for people and programs to compare.

use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::method_options::IdempotencyLevel;
use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorSet, MethodDescriptorProto};

/// The package that makes the promise.
pub(crate) const PACKAGE: &str = "cross.v1";

/// The longest range of numbers that may be reserved: each is listed on a line of its own.
const LONGEST_RESERVATION: i32 = 1000;

/// A line, taken apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Item<'a> {
    /// The whole line.
    pub(crate) line: &'a str,
    /// `service`, `rpc`, `message`, `field`, `enum`, `value` or `reserved`.
    pub(crate) kind: &'a str,
    /// Full name of the service, message or enum that it is or belongs to.
    pub(crate) owner: &'a str,
    /// Its own name within that, or what is reserved; empty for a service, message or enum.
    pub(crate) name: &'a str,
    /// Number of a field or value.
    pub(crate) number: Option<&'a str>,
}

impl<'a> Item<'a> {
    /// Takes a line of [`listing`] apart.
    pub(crate) fn parse(line: &'a str) -> Self {
        let (kind, rest) = line.split_once(' ').unwrap_or((line, ""));
        let path = rest.split([' ', '(']).next().unwrap_or("");
        let word = |index| rest.split(' ').nth(index);
        let (owner, name, number) = match kind {
            "rpc" | "field" | "value" => {
                let (owner, name) = path.rsplit_once('.').unwrap_or(("", path));
                (owner, name, word(2).filter(|_| kind != "rpc"))
            }
            "reserved" => (path, word(1).unwrap_or(""), None),
            _ => (path, "", None),
        };
        Self { line, kind, owner, name, number }
    }

    /// Full names of the messages and enums that it mentions as types.
    pub(crate) fn types(self) -> impl Iterator<Item = &'a str> {
        let named = self.kind == "rpc" || self.kind == "field";
        let words = self.line.split([' ', '(', ')']).filter(move |_| named);
        words.filter_map(|word| word.strip_prefix('.'))
    }
}

/// The lines of a schema, sorted.
pub(crate) fn listing(descriptors: &FileDescriptorSet) -> Vec<String> {
    let mut lines = Vec::new();
    for file in descriptors.file.iter().filter(|file| file.package() == PACKAGE) {
        for service in &file.service {
            let name = format!("{PACKAGE}.{}", service.name());
            lines.extend(service.method.iter().map(|method| rpc(&name, method)));
            lines.push(format!("service {name}"));
        }
        file.message_type.iter().for_each(|message| list_message(PACKAGE, message, &mut lines));
        file.enum_type.iter().for_each(|item| list_enum(PACKAGE, item, &mut lines));
    }
    lines.sort_unstable();
    lines
}

fn rpc(service: &str, method: &MethodDescriptorProto) -> String {
    let stream = |on: bool| if on { "stream " } else { "" };
    let idempotency = match method.options.as_ref().map(|options| options.idempotency_level()) {
        None | Some(IdempotencyLevel::IdempotencyUnknown) => "",
        Some(IdempotencyLevel::NoSideEffects) => " without side effects",
        Some(IdempotencyLevel::Idempotent) => " idempotent",
    };
    format!(
        "rpc {service}.{}({}{}) returns ({}{}){idempotency}",
        method.name(),
        stream(method.client_streaming()),
        method.input_type(),
        stream(method.server_streaming()),
        method.output_type()
    )
}

fn list_message(scope: &str, message: &DescriptorProto, lines: &mut Vec<String>) {
    let name = format!("{scope}.{}", message.name());
    lines.push(format!("message {name}"));
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
        // A name of its own in JSON is one more thing that callers rely on.
        let json = field.json_name();
        let json =
            if json == camel_case(field.name()) { String::new() } else { format!(" as {json:?} in JSON") };
        lines.push(format!("field {name}.{} = {} {label}{kind}{oneof}{json}", field.name(), field.number()));
    }
    for range in &message.reserved_range {
        // The end of a message's range is past it.
        list_reserved(&name, range.start(), range.end() - 1, lines);
    }
    lines.extend(message.reserved_name.iter().map(|reserved| format!("reserved {name} {reserved}")));
    message.nested_type.iter().for_each(|nested| list_message(&name, nested, lines));
    message.enum_type.iter().for_each(|item| list_enum(&name, item, lines));
}

fn list_enum(scope: &str, item: &EnumDescriptorProto, lines: &mut Vec<String>) {
    let name = format!("{scope}.{}", item.name());
    lines.push(format!("enum {name}"));
    for value in &item.value {
        lines.push(format!("value {name}.{} = {}", value.name(), value.number()));
    }
    for range in &item.reserved_range {
        list_reserved(&name, range.start(), range.end(), lines);
    }
    lines.extend(item.reserved_name.iter().map(|reserved| format!("reserved {name} {reserved}")));
}

fn list_reserved(name: &str, first: i32, last: i32, lines: &mut Vec<String>) {
    assert!(
        last - first < LONGEST_RESERVATION,
        "{name} reserves {first} to {last}; reserve only what was used"
    );
    lines.extend((first..=last).map(|number| format!("reserved {name} {number}")));
}

/// The name that a field has in JSON if the schema says nothing else.
fn camel_case(name: &str) -> String {
    let mut upper = false;
    let mut out = String::new();
    for c in name.chars() {
        if c == '_' {
            upper = true;
        } else {
            out.push(if upper { c.to_ascii_uppercase() } else { c });
            upper = false;
        }
    }
    out
}
