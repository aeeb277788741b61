//! A check of JSON documents against the part of JSON Schema 2020-12 that the project's schemas use.
//!
//! A whole validator as a dependency would cost more to build than all other tests together. What keeps this one honest: a
//! keyword that it does not know ends the test, so that no part of a schema is passed over in silence.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a helper that fails ends its test")]

use serde_json::{Map, Value};
use std::collections::HashSet;

/// Keywords that say nothing about a document.
const ANNOTATIONS: [&str; 4] = ["$schema", "$defs", "title", "description"];

pub(crate) struct Schema {
    root: Value,
}

impl Schema {
    pub(crate) fn parse(text: &str) -> Self {
        Self { root: serde_json::from_str(text).unwrap() }
    }

    /// What is wrong with a document, each with its place; empty if it is valid.
    pub(crate) fn faults(&self, document: &Value) -> Vec<String> {
        let mut faults = Vec::new();
        self.check(&self.root, document, "$", &mut faults);
        faults
    }

    fn check(&self, schema: &Value, value: &Value, place: &str, faults: &mut Vec<String>) {
        let schema = schema.as_object().unwrap();
        for (keyword, wanted) in schema {
            let fault = match keyword.as_str() {
                "$ref" => {
                    let pointer = wanted.as_str().unwrap().strip_prefix('#').unwrap();
                    let target =
                        self.root.pointer(pointer).unwrap_or_else(|| panic!("{wanted} leads nowhere"));
                    self.check(target, value, place, faults);
                    None
                }
                "properties" => {
                    self.members(wanted.as_object().unwrap(), value, place, faults);
                    None
                }
                "items" => {
                    for (index, item) in value.as_array().into_iter().flatten().enumerate() {
                        self.check(wanted, item, &format!("{place}[{index}]"), faults);
                    }
                    None
                }
                "additionalProperties" => {
                    assert_eq!(*wanted, Value::Bool(false), "{place}: only false is known");
                    additional(schema, value)
                }
                annotation if ANNOTATIONS.contains(&annotation) => None,
                _ => simple(keyword, wanted, value),
            };
            faults.extend(fault.map(|fault| format!("{place}: {fault}")));
        }
    }

    fn members(&self, properties: &Map<String, Value>, value: &Value, place: &str, faults: &mut Vec<String>) {
        for (name, schema) in properties {
            if let Some(member) = value.get(name) {
                self.check(schema, member, &format!("{place}.{name}"), faults);
            }
        }
    }
}

fn additional(schema: &Map<String, Value>, value: &Value) -> Option<String> {
    let known = schema["properties"].as_object().unwrap();
    let unknown = value.as_object()?.keys().find(|name| !known.contains_key(*name))?;
    Some(format!("{unknown} is unknown"))
}

/// A keyword that looks at one value alone. Those about another type of value than this one let it pass.
fn simple(keyword: &str, wanted: &Value, value: &Value) -> Option<String> {
    let holds = match keyword {
        "type" => is_of_type(wanted.as_str().unwrap(), value),
        "const" => value == wanted,
        "enum" => wanted.as_array().unwrap().contains(value),
        "minimum" => value.as_f64().is_none_or(|number| number >= wanted.as_f64().unwrap()),
        "maximum" => value.as_f64().is_none_or(|number| number <= wanted.as_f64().unwrap()),
        "minLength" => {
            value.as_str().is_none_or(|text| text.chars().count() as u64 >= wanted.as_u64().unwrap())
        }
        "pattern" => value.as_str().is_none_or(|text| is_hexadecimal(text, wanted.as_str().unwrap())),
        "minItems" => value.as_array().is_none_or(|items| items.len() as u64 >= wanted.as_u64().unwrap()),
        "maxItems" => value.as_array().is_none_or(|items| items.len() as u64 <= wanted.as_u64().unwrap()),
        "uniqueItems" => value.as_array().is_none_or(|items| {
            let distinct: HashSet<_> = items.iter().map(Value::to_string).collect();
            !wanted.as_bool().unwrap() || distinct.len() == items.len()
        }),
        "required" => value.as_object().is_none_or(|members| {
            wanted.as_array().unwrap().iter().all(|name| members.contains_key(name.as_str().unwrap()))
        }),
        unknown => panic!("{unknown} is no keyword that this check knows"),
    };
    (!holds).then(|| format!("{keyword} {wanted} does not hold"))
}

fn is_of_type(name: &str, value: &Value) -> bool {
    match name {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "number" => value.is_number(),
        "integer" => value.as_f64().is_some_and(|number| number.fract() == 0.0),
        "boolean" => value.is_boolean(),
        unknown => panic!("{unknown} is no type that this check knows"),
    }
}

/// The one kind of pattern that is known: so many hexadecimal digits.
fn is_hexadecimal(text: &str, pattern: &str) -> bool {
    let digits = pattern.strip_prefix("^[0-9a-f]{").and_then(|rest| rest.strip_suffix("}$"));
    let digits: usize =
        digits.unwrap_or_else(|| panic!("{pattern} is no pattern that this check knows")).parse().unwrap();
    text.len() == digits && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}
