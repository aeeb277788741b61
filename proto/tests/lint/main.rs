//! The schema in good form: buf's categories `STANDARD` and `COMMENTS`, as far as they say anything about one package.

#![expect(clippy::unwrap_used, reason = "a test's helpers fail the test")]

mod rules;
#[path = "../sources/mod.rs"]
mod sources;

use prost_types::{EnumOptions, FileDescriptorProto, FileDescriptorSet};
use rules::{Problem, lint};

/// What breaks a rule for a reason: the rule, the place, the reason.
const EXCEPTIONS: [(&str, &str, &str); 3] = [
    ("SERVICE_SUFFIX", "cross.v1.Checkpoints", "the names of the services are fixed; people type them"),
    ("SERVICE_SUFFIX", "cross.v1.Learner", "likewise"),
    ("SERVICE_SUFFIX", "cross.v1.Training", "likewise"),
];

fn is_exception(problem: &Problem) -> bool {
    EXCEPTIONS.iter().any(|(rule, place, _)| (*rule, *place) == (problem.rule, problem.place.as_str()))
}

#[test]
fn the_schema_is_in_good_form() {
    let problems = lint(&sources::descriptors());
    let (expected, problems): (Vec<_>, Vec<_>) = problems.into_iter().partition(is_exception);
    let lines: Vec<String> =
        problems.iter().map(|p| format!("{}: {} ({})", p.place, p.remedy, p.rule)).collect();
    assert!(lines.is_empty(), "{}", lines.join("\n"));
    assert_eq!(expected.len(), EXCEPTIONS.len(), "an exception stands for nothing any more");
}

type Change = fn(&mut FileDescriptorProto);

#[test]
fn every_rule_finds_what_breaks_it() {
    // Each on the file of the learner.
    let changes: &[(&str, Change)] = &[
        ("SYNTAX_SPECIFIED", |file| file.syntax = None),
        ("PACKAGE_DIRECTORY_MATCH", |file| file.name = Some("cross/learner.proto".to_owned())),
        ("FILE_LOWER_SNAKE_CASE", |file| file.name = Some("cross/v1/Learner.proto".to_owned())),
        ("IMPORT_NO_PUBLIC", |file| file.public_dependency.push(0)),
        ("IMPORT_NO_WEAK", |file| file.weak_dependency.push(0)),
        ("IMPORT_USED", |file| file.dependency.push("cross/v1/training.proto".to_owned())),
        ("COMMENT_SERVICE", |file| uncomment(file, &[6, 0])),
        ("COMMENT_RPC", |file| uncomment(file, &[6, 0, 2, 1])),
        ("COMMENT_MESSAGE", |file| uncomment(file, &[4, 0])),
        ("COMMENT_FIELD", |file| uncomment(file, &[4, 0, 2, 0])),
        ("COMMENT_ENUM", |file| uncomment(file, &[5, 0])),
        ("COMMENT_ENUM_VALUE", |file| uncomment(file, &[5, 0, 2, 0])),
        ("COMMENT_ONEOF", |file| {
            let index = file.message_type.iter().position(|m| m.name() == "StreamFragmentsRequest").unwrap();
            uncomment(file, &[4, index as i32, 8, 0]);
        }),
        ("SERVICE_PASCAL_CASE", |file| file.service[0].name = Some("learner_Service".to_owned())),
        ("SERVICE_SUFFIX", |file| file.service[0].name = Some("Student".to_owned())),
        ("RPC_REQUEST_STANDARD_NAME", |file| {
            file.service[0].method[0].input_type = Some(".cross.v1.Limits".to_owned());
        }),
        ("RPC_RESPONSE_STANDARD_NAME", |file| {
            file.service[0].method[0].output_type = Some(".cross.v1.Limits".to_owned());
        }),
        ("FIELD_LOWER_SNAKE_CASE", |file| file.message_type[0].field[0].name = Some("actorId".to_owned())),
        ("MESSAGE_PASCAL_CASE", |file| file.message_type[0].name = Some("joinRequest".to_owned())),
        ("ENUM_PASCAL_CASE", |file| file.enum_type[0].name = Some("Fragment_End".to_owned())),
        ("ENUM_FIRST_VALUE_ZERO", |file| file.enum_type[0].value.swap(0, 1)),
        ("ENUM_NO_ALLOW_ALIAS", |file| {
            file.enum_type[0].options =
                Some(EnumOptions { allow_alias: Some(true), ..EnumOptions::default() });
        }),
        ("ENUM_VALUE_PREFIX", |file| file.enum_type[0].value[1].name = Some("CONTINUES".to_owned())),
        ("ENUM_VALUE_UPPER_SNAKE_CASE", |file| {
            file.enum_type[0].value[1].name = Some("FRAGMENT_END_Goes".to_owned());
        }),
        ("ENUM_ZERO_VALUE_SUFFIX", |file| {
            file.enum_type[0].value[0].name = Some("FRAGMENT_END_NONE".to_owned());
        }),
        ("PACKAGE_DEFINED", |file| file.package = None),
        ("PACKAGE_LOWER_SNAKE_CASE", |file| file.package = Some("Cross.v1".to_owned())),
        ("PACKAGE_VERSION_SUFFIX", |file| file.package = Some("cross".to_owned())),
        ("RPC_PASCAL_CASE", |file| file.service[0].method[0].name = Some("join".to_owned())),
        ("RPC_REQUEST_RESPONSE_UNIQUE", |file| {
            let first = file.service[0].method[0].input_type.clone();
            file.service[0].method[2].input_type = first;
        }),
        ("ONEOF_LOWER_SNAKE_CASE", |file| {
            let message = file.message_type.iter_mut().find(|m| m.name() == "StreamFragmentsRequest");
            message.unwrap().oneof_decl[0].name = Some("Message".to_owned());
        }),
    ];
    for (rule, change) in changes {
        let mut set: FileDescriptorSet = sources::descriptors();
        change(set.file.iter_mut().find(|file| file.name().ends_with("learner.proto")).unwrap());
        let found: Vec<_> = lint(&set).into_iter().filter(|problem| !is_exception(problem)).collect();
        assert!(found.iter().any(|problem| problem.rule == *rule), "{rule} was not found: {found:?}");
    }
}

fn uncomment(file: &mut FileDescriptorProto, path: &[i32]) {
    let locations = &mut file.source_code_info.as_mut().unwrap().location;
    locations.iter_mut().find(|location| location.path == path).unwrap().leading_comments = None;
}
