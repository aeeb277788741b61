//! The rules, by the names that buf has for them.

use prost_types::{
    DescriptorProto, EnumDescriptorProto, FileDescriptorProto, FileDescriptorSet, ServiceDescriptorProto,
};
use std::collections::{BTreeMap, BTreeSet};

// Numbers of the descriptor's own fields, of which the paths to comments are made.
const MESSAGE: i32 = 4;
const ENUM: i32 = 5;
const SERVICE: i32 = 6;
const METHOD: i32 = 2;
const FIELD: i32 = 2;
const NESTED_MESSAGE: i32 = 3;
const NESTED_ENUM: i32 = 4;
const ONEOF: i32 = 8;
const VALUE: i32 = 2;

/// A broken rule.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Problem {
    /// Name of the rule.
    pub(crate) rule: &'static str,
    /// What breaks it.
    pub(crate) place: String,
    /// What to do.
    pub(crate) remedy: String,
}

/// Every problem of our own files.
pub(crate) fn lint(set: &FileDescriptorSet) -> Vec<Problem> {
    let mut homes = BTreeMap::new();
    for file in &set.file {
        let scope = format!(".{}", file.package());
        file.message_type.iter().for_each(|message| home(&scope, message, file.name(), &mut homes));
        homes.extend(file.enum_type.iter().map(|e| (format!("{scope}.{}", e.name()), file.name())));
    }
    let mut lint = Lint { problems: Vec::new(), comments: BTreeSet::new() };
    let mut used_by_rpcs = BTreeSet::new();
    for file in set.file.iter().filter(|file| !file.name().starts_with("google/")) {
        let info = file.source_code_info.as_ref();
        let commented = info.iter().flat_map(|info| &info.location);
        let commented = commented.filter(|l| !l.leading_comments().trim().is_empty());
        lint.comments = commented.map(|location| location.path.clone()).collect();
        lint.file(file);
        lint.imports(file, &homes);
        for (index, service) in file.service.iter().enumerate() {
            lint.service(file.package(), index, service, &mut used_by_rpcs);
        }
        for (index, message) in file.message_type.iter().enumerate() {
            lint.message(file.package(), &[MESSAGE, index as i32], message);
        }
        for (index, item) in file.enum_type.iter().enumerate() {
            lint.enumeration(file.package(), &[ENUM, index as i32], item);
        }
    }
    lint.problems
}

/// In which file each type is at home.
fn home<'a>(scope: &str, message: &DescriptorProto, file: &'a str, homes: &mut BTreeMap<String, &'a str>) {
    let name = format!("{scope}.{}", message.name());
    message.nested_type.iter().for_each(|nested| home(&name, nested, file, homes));
    homes.extend(message.enum_type.iter().map(|item| (format!("{name}.{}", item.name()), file)));
    homes.insert(name, file);
}

struct Lint {
    problems: Vec<Problem>,
    /// Paths of the present file's items that have a comment before them.
    comments: BTreeSet<Vec<i32>>,
}

impl Lint {
    fn expect(&mut self, holds: bool, rule: &'static str, place: &str, remedy: impl FnOnce() -> String) {
        if !holds {
            self.problems.push(Problem { rule, place: place.to_owned(), remedy: remedy() });
        }
    }

    fn comment(&mut self, rule: &'static str, place: &str, path: &[i32]) {
        let there = self.comments.contains(path);
        self.expect(there, rule, place, || "say in a comment before it what it is".to_owned());
    }

    fn file(&mut self, file: &FileDescriptorProto) {
        let (name, package) = (file.name(), file.package());
        self.expect(file.syntax() == "proto3", "SYNTAX_SPECIFIED", name, || {
            "begin with syntax = \"proto3\";".to_owned()
        });
        self.expect(!package.is_empty(), "PACKAGE_DEFINED", name, || "name its package".to_owned());
        let (folder, base) = name.rsplit_once('/').unwrap_or(("", name));
        let wanted = package.replace('.', "/");
        self.expect(folder == wanted, "PACKAGE_DIRECTORY_MATCH", name, || {
            format!("package {package} belongs in folder {wanted}")
        });
        let base = base.trim_end_matches(".proto");
        self.expect(is_lower_snake(base), "FILE_LOWER_SNAKE_CASE", name, || "write_it_like_this".to_owned());
        self.expect(package.split('.').all(is_lower_snake), "PACKAGE_LOWER_SNAKE_CASE", name, || {
            "write.it.like_this".to_owned()
        });
        let version = package.rsplit('.').next().and_then(|last| last.strip_prefix('v'));
        let version = version.is_some_and(|n| n.parse::<u32>().is_ok_and(|n| n > 0));
        self.expect(version, "PACKAGE_VERSION_SUFFIX", name, || {
            "end the package in its version, as .v1".to_owned()
        });
        let no_public = file.public_dependency.is_empty();
        self.expect(no_public, "IMPORT_NO_PUBLIC", name, || "import without public".to_owned());
        let no_weak = file.weak_dependency.is_empty();
        self.expect(no_weak, "IMPORT_NO_WEAK", name, || "import without weak".to_owned());
    }

    fn imports(&mut self, file: &FileDescriptorProto, homes: &BTreeMap<String, &str>) {
        let mut types = BTreeSet::new();
        let methods = file.service.iter().flat_map(|service| &service.method);
        types.extend(methods.flat_map(|method| [method.input_type(), method.output_type()]));
        let mut messages: Vec<&DescriptorProto> = file.message_type.iter().collect();
        while let Some(message) = messages.pop() {
            types.extend(message.field.iter().map(|field| field.type_name()));
            messages.extend(&message.nested_type);
        }
        let used: BTreeSet<&str> = types.into_iter().filter_map(|name| homes.get(name).copied()).collect();
        for import in &file.dependency {
            let place = format!("{}: {import}", file.name());
            self.expect(used.contains(import.as_str()), "IMPORT_USED", &place, || {
                "take the import out".to_owned()
            });
        }
    }

    fn service<'a>(
        &mut self,
        package: &str,
        index: usize,
        service: &'a ServiceDescriptorProto,
        used: &mut BTreeSet<&'a str>,
    ) {
        let place = format!("{package}.{}", service.name());
        self.comment("COMMENT_SERVICE", &place, &[SERVICE, index as i32]);
        self.pascal("SERVICE_PASCAL_CASE", &place, service.name());
        self.expect(service.name().ends_with("Service"), "SERVICE_SUFFIX", &place, || {
            "end its name in Service".to_owned()
        });
        for (number, method) in service.method.iter().enumerate() {
            let place = format!("{place}.{}", method.name());
            self.comment("COMMENT_RPC", &place, &[SERVICE, index as i32, METHOD, number as i32]);
            self.pascal("RPC_PASCAL_CASE", &place, method.name());
            let ends = [
                ("RPC_REQUEST_STANDARD_NAME", method.input_type(), "Request"),
                ("RPC_RESPONSE_STANDARD_NAME", method.output_type(), "Response"),
            ];
            for (rule, given, suffix) in ends {
                let wanted = format!("{}{suffix}", method.name());
                let fits = given.rsplit('.').next() == Some(wanted.as_str());
                self.expect(fits, rule, &place, || format!("give it a message {wanted} of its own"));
                self.expect(used.insert(given), "RPC_REQUEST_RESPONSE_UNIQUE", &place, || {
                    format!("another method has {given} already; give each its own, so that both can grow")
                });
            }
        }
    }

    fn message(&mut self, scope: &str, path: &[i32], message: &DescriptorProto) {
        // The entries of a map have no text of their own.
        if message.options.as_ref().is_some_and(|options| options.map_entry()) {
            return;
        }
        let place = format!("{scope}.{}", message.name());
        self.comment("COMMENT_MESSAGE", &place, path);
        self.pascal("MESSAGE_PASCAL_CASE", &place, message.name());
        let below = |kind: i32, index: usize| [path, &[kind, index as i32]].concat();
        for (index, field) in message.field.iter().enumerate() {
            let place = format!("{place}.{}", field.name());
            self.comment("COMMENT_FIELD", &place, &below(FIELD, index));
            self.snake("FIELD_LOWER_SNAKE_CASE", &place, field.name());
        }
        let optional: BTreeSet<i32> =
            message.field.iter().filter(|f| f.proto3_optional()).filter_map(|f| f.oneof_index).collect();
        for (index, oneof) in message.oneof_decl.iter().enumerate() {
            // The compiler's own, one for each optional field.
            if optional.contains(&(index as i32)) {
                continue;
            }
            let place = format!("{place}.{}", oneof.name());
            self.comment("COMMENT_ONEOF", &place, &below(ONEOF, index));
            self.snake("ONEOF_LOWER_SNAKE_CASE", &place, oneof.name());
        }
        for (index, nested) in message.nested_type.iter().enumerate() {
            self.message(&place, &below(NESTED_MESSAGE, index), nested);
        }
        for (index, item) in message.enum_type.iter().enumerate() {
            self.enumeration(&place, &below(NESTED_ENUM, index), item);
        }
    }

    fn enumeration(&mut self, scope: &str, path: &[i32], item: &EnumDescriptorProto) {
        let place = format!("{scope}.{}", item.name());
        self.comment("COMMENT_ENUM", &place, path);
        self.pascal("ENUM_PASCAL_CASE", &place, item.name());
        let alias = item.options.as_ref().is_some_and(|options| options.allow_alias());
        self.expect(!alias, "ENUM_NO_ALLOW_ALIAS", &place, || "give each number one name".to_owned());
        let prefix = format!("{}_", upper_snake(item.name()));
        let zero = item.value.first();
        self.expect(zero.is_some_and(|value| value.number() == 0), "ENUM_FIRST_VALUE_ZERO", &place, || {
            "begin with the value 0".to_owned()
        });
        for (index, value) in item.value.iter().enumerate() {
            let place = format!("{place}.{}", value.name());
            self.comment("COMMENT_ENUM_VALUE", &place, &[path, &[VALUE, index as i32]].concat());
            let upper =
                value.name().chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_');
            self.expect(upper, "ENUM_VALUE_UPPER_SNAKE_CASE", &place, || "WRITE_IT_LIKE_THIS".to_owned());
            self.expect(value.name().starts_with(&prefix), "ENUM_VALUE_PREFIX", &place, || {
                format!("begin its name with {prefix}, names of values are shared with other enums")
            });
            let unspecified = value.name().ends_with("_UNSPECIFIED");
            self.expect(unspecified || value.number() != 0, "ENUM_ZERO_VALUE_SUFFIX", &place, || {
                format!("call it {prefix}UNSPECIFIED: it stands for a field that nobody set")
            });
        }
    }

    fn pascal(&mut self, rule: &'static str, place: &str, name: &str) {
        let holds = name.starts_with(|c: char| c.is_ascii_uppercase())
            && name.chars().all(|c| c.is_ascii_alphanumeric());
        self.expect(holds, rule, place, || "WriteItLikeThis".to_owned());
    }

    fn snake(&mut self, rule: &'static str, place: &str, name: &str) {
        self.expect(is_lower_snake(name), rule, place, || "write_it_like_this".to_owned());
    }
}

fn is_lower_snake(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
}

/// `FragmentEnd` as `FRAGMENT_END`.
fn upper_snake(name: &str) -> String {
    let mut out = String::new();
    for (index, c) in name.char_indices() {
        if c.is_ascii_uppercase() && index > 0 {
            out.push('_');
        }
        out.push(c.to_ascii_uppercase());
    }
    out
}
