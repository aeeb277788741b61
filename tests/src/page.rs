//! A page of the documentation that shows commands and what they print: run, compared, and written anew.
//!
//! A block that begins with ```` ```console ```` holds commands after `$ `, which go on after a backslash at the end of a line, and
//! below each what it printed.

use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Stdio};

const FENCE: &str = "```";
/// Longer lines are cut.
const WIDTH: usize = 180;
/// So many elements of a list are shown.
const ELEMENTS: usize = 2;

/// A part of a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Part {
    /// Lines that are no command.
    Text(String),
    /// A command and its output, lines both.
    Command {
        /// As it is typed, without the prompt.
        typed: String,
        /// As the page shows it.
        output: String,
    },
}

/// Takes a page apart.
#[must_use]
pub fn parse(page: &str) -> Vec<Part> {
    let mut parts = Vec::new();
    let mut lines = page.lines().peekable();
    let mut console = false;
    while let Some(line) = lines.next() {
        match line.strip_prefix("$ ") {
            Some(first) if console => {
                let mut typed = first.to_owned();
                while typed.ends_with('\\') {
                    typed.push('\n');
                    typed.push_str(lines.next().unwrap_or_default());
                }
                let mut output = String::new();
                while let Some(line) =
                    lines.next_if(|line| !line.starts_with("$ ") && !line.starts_with(FENCE))
                {
                    output.push_str(line);
                    output.push('\n');
                }
                parts.push(Part::Command { typed, output });
            }
            _ => {
                if line.starts_with(FENCE) {
                    console = line == "```console";
                }
                match parts.last_mut() {
                    Some(Part::Text(text)) => text.extend([line, "\n"]),
                    _ => parts.push(Part::Text(format!("{line}\n"))),
                }
            }
        }
    }
    parts
}

/// Puts a page together again.
#[must_use]
pub fn render(parts: &[Part]) -> String {
    let text = |part: &Part| match part {
        Part::Text(text) => text.clone(),
        Part::Command { typed, output } => format!("$ {typed}\n{output}"),
    };
    parts.iter().map(text).collect()
}

/// Runs a command in a shell; all that it prints, errors among it. A command that sets a variable does so for those after it,
/// if it is given to them as `before`.
#[must_use]
pub fn run(folder: &Path, path: &str, before: &str, typed: &str) -> String {
    let (reader, writer) = std::io::pipe().unwrap();
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(format!("{before}\n{typed}")).current_dir(folder).env("PATH", path);
    shell.stdin(Stdio::null()).stdout(writer.try_clone().unwrap()).stderr(writer);
    let mut child = shell.spawn().unwrap();
    // It holds the ends to write to, and the output would have no end.
    drop(shell);
    let output = std::io::read_to_string(reader).unwrap();
    child.wait().unwrap();
    output
}

/// The output as a page shows it: long lines and long lists cut, and still JSON if it was.
#[must_use]
pub fn abridged(output: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    // Of each list that is open: its indentation, and the elements that began.
    let mut lists: Vec<(usize, usize)> = Vec::new();
    for line in output.lines() {
        let indentation = line.len() - line.trim_start().len();
        let closes = line.trim_start().starts_with([']', '}']);
        if let Some(&(list, elements)) = lists.last().filter(|list| list.0 == indentation && closes) {
            if elements > ELEMENTS {
                lines.push(format!("{}\"… {} more\"", " ".repeat(list + 2), elements - ELEMENTS));
            }
            lists.pop();
        } else if let Some((list, elements)) = lists.last_mut() {
            *elements += usize::from(indentation == *list + 2 && !closes);
        }
        if lists.iter().all(|(_, elements)| *elements <= ELEMENTS) {
            lines.push(cut(line));
        }
        if line.trim_end().ends_with('[') {
            lists.push((indentation, 0));
        }
    }
    lines.iter().flat_map(|line| [line.trim_end(), "\n"]).collect()
}

fn cut(line: &str) -> String {
    if line.chars().count() <= WIDTH {
        return line.to_owned();
    }
    let kept: String = line.chars().take(WIDTH).collect();
    // Not between a backslash and what it stands before.
    let kept = kept.trim_end_matches('\\');
    let end = [r#"","#, r#"""#].into_iter().find(|end| line.ends_with(end)).unwrap_or("");
    format!("{kept}…{end}")
}

/// Whether two outputs, both [`abridged`], tell the same: JSON with the same keys and types, or the same words around other
/// numbers. `free` are keys whose content depends on the moment.
///
/// # Errors
/// What differs.
pub fn compare(shown: &str, printed: &str, free: &[&str]) -> Result<(), String> {
    match (json(shown), json(printed)) {
        (Some(shown), Some(printed)) => {
            let (shown, printed) = (shape(&shown, free), shape(&printed, free));
            let lost: Vec<_> = shown.difference(&printed).collect();
            let new: Vec<_> = printed.difference(&shown).collect();
            if lost.is_empty() && new.is_empty() {
                return Ok(());
            }
            Err(format!("no longer printed: {lost:?}; not on the page: {new:?}"))
        }
        _ if without_numbers(shown) == without_numbers(printed) => Ok(()),
        _ => Err(format!("the page shows\n{shown}and printed was\n{printed}")),
    }
}

/// A text of nothing but JSON values.
fn json(text: &str) -> Option<Vec<Value>> {
    let values = serde_json::Deserializer::from_str(text).into_iter::<Value>();
    values.collect::<Result<Vec<_>, _>>().ok().filter(|values| values.iter().any(|value| !value.is_number()))
}

/// The paths of everything in it, with types.
fn shape(values: &[Value], free: &[&str]) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    values.iter().for_each(|value| walk("", value, free, &mut found));
    found
}

fn walk(path: &str, value: &Value, free: &[&str], found: &mut BTreeSet<String>) {
    match value {
        Value::Object(fields) => {
            found.insert(format!("{path}: object"));
            for (key, value) in fields {
                if !free.contains(&key.as_str()) {
                    walk(&format!("{path}.{key}"), value, free, found);
                }
            }
        }
        Value::Array(elements) => {
            found.insert(format!("{path}: list"));
            // What was cut says so in a text, which is no element.
            let elements = elements.iter().filter(|e| !e.as_str().is_some_and(|text| text.starts_with('…')));
            elements.for_each(|element| walk(&format!("{path}[]"), element, free, found));
        }
        Value::Null => drop(found.insert(format!("{path}: null"))),
        Value::Bool(_) => drop(found.insert(format!("{path}: bool"))),
        Value::Number(_) => drop(found.insert(format!("{path}: number"))),
        Value::String(_) => drop(found.insert(format!("{path}: text"))),
    }
}

/// Every word that is a number or a digest as `#`.
fn without_numbers(text: &str) -> String {
    let mut out = String::new();
    let mut word = String::new();
    for c in text.chars().chain([' ']) {
        if c.is_alphanumeric() {
            word.push(c);
            continue;
        }
        let digest = word.len() >= 16 && word.chars().all(|c| c.is_ascii_hexdigit());
        let number = !word.is_empty() && word.chars().all(|c| c.is_ascii_digit());
        out.push_str(if digest || number { "#" } else { &word });
        word.clear();
        out.push(c);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = "# A\n\n```sh\n$ not run\n```\n```console\n$ one\n1\n$ two \\\n  more\n```\nend\n";

    #[test]
    fn a_page_is_taken_apart_and_put_together() {
        let parts = parse(PAGE);
        assert_eq!(render(&parts), PAGE);
        let commands: Vec<_> = parts.iter().filter(|part| matches!(part, Part::Command { .. })).collect();
        let command =
            |typed: &str, output: &str| Part::Command { typed: typed.into(), output: output.into() };
        assert_eq!(commands, [&command("one", "1\n"), &command("two \\\n  more", "")]);
    }

    #[test]
    fn a_long_output_is_cut_and_stays_json() {
        let long = "\\\"x".repeat(100);
        let list =
            serde_json::json!({"a": [{"b": [1, 2, 3]}, {"b": []}, {"c": 4}, {"d": 5}], "e": long, "f": []});
        let cut = abridged(&serde_json::to_string_pretty(&list).unwrap());
        let value: Value = serde_json::from_str(&cut).unwrap();
        assert_eq!(value["a"].as_array().unwrap().len(), 3, "{cut}");
        assert_eq!(value["a"][0]["b"][2], "… 1 more");
        assert!(value["e"].as_str().unwrap().ends_with('…'));
        assert!(cut.lines().all(|line| line.chars().count() < WIDTH + 5));
    }

    #[test]
    fn other_numbers_are_the_same_and_other_keys_are_not() {
        assert!(compare("{\"a\": 1}\n{\"a\": 2}\n", "{\"a\": 3}\n", &[]).is_ok());
        assert!(compare("{\"a\": 1}\n", "{\"a\": \"1\"}\n", &[]).is_err());
        assert!(compare("{\"a\": 1}\n", "{\"b\": 1}\n", &[]).is_err());
        assert!(compare("{\"a\": {\"b\": 1}}\n", "{\"a\": {}}\n", &[]).is_err());
        assert!(compare("{\"a\": {\"b\": 1}}\n", "{\"a\": {}}\n", &["a"]).is_ok());
        assert!(compare("update 17\n", "update 4\n", &[]).is_ok());
        assert!(compare("update 17\n", "update x\n", &[]).is_err());
    }
}
